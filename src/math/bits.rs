//! Bits of masks and of places along the Morton curve.

use glam::Vec3;

/// Cells along one axis of a Morton curve of three axes in 64 bits: 2²¹.
pub const MORTON_CELLS: f32 = 2_097_152.0;

/// Place along the Morton curve of the cell that `cell`, in cells, lies in: the bits of its coordinates interleaved, x
/// lowest. Coordinates outside 0…[`MORTON_CELLS`] are moved to its ends.
pub fn morton(cell: Vec3) -> u64 {
    let spread = cell.min(Vec3::splat(MORTON_CELLS - 1.0)).to_array();
    let [x, y, z] = spread.map(spread_bits);
    x | y << 1 | z << 2
}

/// The lowest 21 bits of `coordinate`, two zero bits put behind each.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer casts saturate, which is what is wanted here"
)]
fn spread_bits(coordinate: f32) -> u64 {
    let mut bits = u64::from(coordinate as u32);
    bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
    bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
    bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
    bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
    (bits | bits << 2) & 0x1249_2492_4924_9249
}

/// Places of the bits set in `mask`, the lowest first.
#[inline(always)]
pub fn bits_of(mut mask: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = mask.trailing_zeros() as usize;
        (mask != 0).then(|| {
            mask &= mask - 1;
            bit
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_interleaved_bit_by_bit_and_kept_in_the_cube() {
        assert_eq!(morton(Vec3::new(1.0, 2.0, 4.9)), 0b100_010_001);
        assert_eq!(morton(Vec3::splat(-7.0)), 0);
        assert_eq!(morton(Vec3::splat(1e9)), (1 << 63) - 1);
    }

    #[test]
    fn bits_are_told_from_the_lowest() {
        let bits: Vec<_> = bits_of(1 | 1 << 5 | 1 << 63).collect();
        assert_eq!(bits, [0, 5, 63]);
        assert_eq!(bits_of(0).count(), 0);
    }
}
