//! Linear values ↔ sRGB (IEC 61966-2-1), and 8-bit codes.

/// sRGB-encoded to linear, continued beyond 1; negative values stay linear.
pub fn to_linear(encoded: f32) -> f32 {
    if encoded <= 0.040_45 {
        encoded / 12.92
    } else {
        ((encoded + 0.055) / 1.055).powf(2.4)
    }
}

/// The sRGB code of a linear value, which is clipped to 0…1; NaN is 0.
pub fn code(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    byte(if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    })
}

/// The 8-bit code of a value in 0…1, clipped; NaN is 0.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0…255; NaN becomes 0"
)]
pub fn byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// A color for `id`, ≥ 0: hues in steps of the golden angle, so that those of neighbors differ.
pub fn of_id(id: f32) -> [u8; 3] {
    let hue = (id * 0.618_034).fract() * 6.0;
    let channel = |offset: f32| {
        let k = (offset + hue) % 6.0;
        byte(0.95 - 0.6 * k.min(4.0 - k).clamp(0.0, 1.0))
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_have_the_values_of_the_standard_and_go_back_to_what_they_came_from() {
        assert_eq!(
            [0.0, 0.003_130_8, 0.18, 0.5, 1.0, 7.0, -1.0].map(code),
            [0, 10, 118, 188, 255, 255, 0]
        );
        assert_eq!(code(f32::NAN), 0);
        for encoded in 0..=u8::MAX {
            assert_eq!(code(to_linear(f32::from(encoded) / 255.0)), encoded);
        }
        assert!((to_linear(2.0) - 4.953_8).abs() < 1e-3);
    }

    #[test]
    fn neighbors_have_different_colors() {
        let colors: Vec<_> = (0..16_u8).map(|id| of_id(f32::from(id))).collect();
        assert!(colors.windows(2).all(|pair| pair[0] != pair[1]));
    }
}
