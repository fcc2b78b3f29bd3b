//! Directions, colors and ratios in fewer bits.

use glam::Vec3;

/// Steps on either side of 0 of the two coordinates of a packed direction.
const U_STEPS: f32 = 32_767.0;
const V_STEPS: f32 = 16_383.0;

/// A packed direction is off by no more than this; radians. Half a step of either coordinate moves a place on a face of
/// the octahedron, whose middle is 1/√3 from the center, by up to 0.000 067 as seen from there.
pub const DIRECTION_ERROR: f32 = 7e-5;

/// The unit vector `direction` in 32 bits: its place on the upper half of an octahedron, that half turned by 45° into a
/// square, and whether it is opposed to that. Axes stay exact, and opposed vectors stay opposed to the last bit.
#[expect(clippy::cast_sign_loss, reason = "kept in two's complement")]
pub fn pack_direction(direction: Vec3) -> u32 {
    let Vec3 { x, y, z } = direction;
    let is_lower = z < 0.0 || z == 0.0 && (y < 0.0 || y == 0.0 && x < 0.0);
    let upper = if is_lower { -direction } else { direction };
    let flat = upper.truncate() / upper.abs().element_sum();
    let u = rounded((flat.x + flat.y) * U_STEPS) as u16;
    let v = rounded((flat.x - flat.y) * V_STEPS) as u16;
    u32::from(u) | u32::from(v & 0x7fff) << 16 | u32::from(is_lower) << 31
}

/// `value` rounded, halves away from 0; at the ends of i16, those. Without a call to a library's rounding, which takes
/// longer than all else in packing a node.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "casts of floats saturate")]
pub fn rounded(value: f32) -> i16 {
    (value + 0.5_f32.copysign(value)) as i16
}

/// The unit vector in `packed`.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "parts of 32 bits")]
pub fn unpack_direction(packed: u32) -> Vec3 {
    let u = f32::from((packed as u16).cast_signed()) / U_STEPS;
    // Shifted to drop the sign, and back to spread that of `v`.
    let v = f32::from(((packed >> 16 << 1) as u16).cast_signed() >> 1) / V_STEPS;
    let upper = Vec3::new(0.5 * (u + v), 0.5 * (u - v), 1.0 - u.abs().max(v.abs())).normalize();
    if packed >> 31 == 1 { -upper } else { upper }
}

/// Bits of a shared exponent.
const EXPONENT_BITS: u32 = 8;

/// Bits of a color packed with mantissas of `mantissa_bits`.
pub const fn color_bits(mantissa_bits: u32) -> u32 {
    3 * mantissa_bits + EXPONENT_BITS
}

/// `color` (no channel below 0) with one exponent for all channels: each is off by at most 2^−`mantissa_bits` of the
/// largest one. At most 18 bits. Black stays black; what f32 holds is in range, its subnormals as black.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "rounded, and clamped to the bits there are"
)]
pub fn pack_color(color: Vec3, mantissa_bits: u32) -> u64 {
    let largest = color.max_element();
    if largest < f32::MIN_POSITIVE {
        return 0;
    }
    let most = ((1_u64 << mantissa_bits) - 1) as f32;
    // f32's own exponent: that of the greatest power of two below the largest channel, plus 127. Scaled in two steps,
    // either of which is in range.
    let biased = u64::from(largest.to_bits() >> 23);
    let below_one = color * 0.25 * power_of_two(128 - biased as i32);
    let scale = power_of_two(mantissa_bits.cast_signed());
    let mantissa = |channel: f32| u64::from((channel * scale + 0.5).clamp(0.0, most) as u32);
    let [red, green, blue] = below_one.to_array().map(mantissa);
    red | green << mantissa_bits | blue << (2 * mantissa_bits) | biased << (3 * mantissa_bits)
}

/// The color in the lowest [`color_bits`] of `packed`.
#[inline(always)]
pub fn unpack_color(packed: u64, mantissa_bits: u32) -> Vec3 {
    let mask = (1_u64 << mantissa_bits) - 1;
    let mantissa = |channel: u32| (packed >> (channel * mantissa_bits) & mask) as f32;
    let biased = (packed >> (3 * mantissa_bits) & ((1 << EXPONENT_BITS) - 1)) as i32;
    // In two factors: either alone is a normal number.
    let scale = power_of_two(biased - 127);
    let per_mantissa = power_of_two(1 - mantissa_bits.cast_signed());
    Vec3::new(mantissa(0), mantissa(1), mantissa(2)) * per_mantissa * scale
}

/// 2 to the power of `exponent`, −126…127; below, 0.
#[inline(always)]
#[expect(clippy::cast_sign_loss, reason = "clamped to 0")]
pub fn power_of_two(exponent: i32) -> f32 {
    f32::from_bits(((exponent + 127).max(0) as u32) << 23)
}

/// Bits of a packed ratio.
pub const RATIO_BITS: u32 = 17;

/// Mantissa bits of f32 that a packed ratio leaves out.
const RATIO_SHIFT: u32 = 11;

/// The least positive ratio that is told from 0.
const LEAST_RATIO: f32 = 1.0 / (1_u32 << 27) as f32;

/// A ratio of 0, or 7e−9 to 31.99, in [`RATIO_BITS`]; off by at most 1/8192 of itself. Ratios beyond are moved to
/// the ends, all but 0 itself.
pub fn pack_ratio(ratio: f32) -> u32 {
    if ratio <= 0.0 {
        return 0;
    }
    let least = LEAST_RATIO.to_bits() >> RATIO_SHIFT;
    let rounded = (ratio.max(LEAST_RATIO).to_bits() + (1 << (RATIO_SHIFT - 1))) >> RATIO_SHIFT;
    (rounded - least + 1).min((1 << RATIO_BITS) - 1)
}

/// The ratio in `packed`.
#[inline(always)]
pub fn unpack_ratio(packed: u32) -> f32 {
    let least = LEAST_RATIO.to_bits() >> RATIO_SHIFT;
    if packed == 0 {
        0.0
    } else {
        f32::from_bits((packed - 1 + least) << RATIO_SHIFT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn axes_are_exact() {
        for axis in Vec3::AXES {
            assert_eq!(unpack_direction(pack_direction(axis)), axis);
            assert_eq!(unpack_direction(pack_direction(-axis)), -axis);
        }
    }

    #[test]
    fn black_stays_black_and_the_ends_of_the_range_come_back() {
        assert_eq!(unpack_color(pack_color(Vec3::ZERO, 13), 13), Vec3::ZERO);
        for size in [1e-30_f32, 1e-3, 1.0, 1e6, 1e30, 3e38] {
            let back = unpack_color(pack_color(Vec3::splat(size), 13), 13);
            assert!((back.x / size - 1.0).abs() < 2e-4, "{size}: {back}");
        }
    }

    #[test]
    fn ratios_beyond_the_range_are_moved_to_its_ends_and_zero_stays() {
        assert_eq!(unpack_ratio(pack_ratio(0.0)), 0.0);
        assert!(unpack_ratio(pack_ratio(1e-20)) > 0.0);
        assert!((unpack_ratio(pack_ratio(1e9)) - 32.0).abs() < 0.01);
    }

    proptest! {
        #[test]
        fn directions_come_back_to_within_their_error(x in -1.0_f32..1.0, y in -1.0_f32..1.0, z in -1.0_f32..1.0) {
            prop_assume!(Vec3::new(x, y, z).length() > 0.01);
            let direction = Vec3::new(x, y, z).normalize();
            let back = unpack_direction(pack_direction(direction));
            prop_assert!(back.distance(direction) < DIRECTION_ERROR);
            prop_assert!((back.length() - 1.0).abs() < 1e-6);
            prop_assert_eq!(unpack_direction(pack_direction(-direction)), -back);
        }

        #[test]
        fn colors_and_ratios_come_back_to_within_their_error(
            r in 0.0_f32..1.0, g in 0.0_f32..1.0, b in 0.0_f32..1.0, exponent in -60_i32..60,
        ) {
            let color = Vec3::new(r, g, b) * power_of_two(exponent);
            for bits in [10, 13, 18] {
                let error = (unpack_color(pack_color(color, bits), bits) - color).abs().max_element();
                prop_assert!(error <= color.max_element() * power_of_two(-bits.cast_signed()) * 1.001);
            }
            let ratio = LEAST_RATIO + 15.9 * r * g * b;
            prop_assert!((unpack_ratio(pack_ratio(ratio)) / ratio - 1.0).abs() < 1.3e-4);
        }
    }
}
