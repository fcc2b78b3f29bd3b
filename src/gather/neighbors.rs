//! Receivers in an order in which those next to each other in space, and turned to the same side, follow each other.

use crate::math::Bounds3;
use crate::math::bits::{MORTON_CELLS, morton};
use glam::Vec3;
use rayon::prelude::*;

/// Neighbors are sorted by the octant of their normals in groups of this many along the curve, so that both sides of a
/// thin wall end in packets of their own without being taken far from their neighbors.
const GROUP: usize = 256;

/// Indices of the receivers at `positions` with unit `normals`.
pub(super) fn order(positions: &[Vec3], normals: &[Vec3]) -> Vec<usize> {
    let bounds = Bounds3::around(positions.iter().copied());
    let extent = (bounds.max - bounds.min).max_element();
    let scale = if extent > 0.0 {
        MORTON_CELLS / extent
    } else {
        0.0
    };
    let key = |position: &Vec3| morton((*position - bounds.min) * scale);
    let mut keys: Vec<(u64, usize)> = (positions.par_iter().map(key))
        .zip(0..positions.len())
        .collect();
    keys.par_sort_unstable();
    let mut order: Vec<usize> = keys.into_iter().map(|(_, i)| i).collect();
    (order.par_chunks_mut(GROUP)).for_each(|group| group.sort_by_key(|&i| octant(normals[i])));
    order
}

/// Values of the receivers in `order`, `components` each, back in the receivers' own order.
pub(super) fn undo(order: &[usize], values: &[f32], components: usize) -> Vec<f32> {
    let mut out = vec![0.0; values.len()];
    for (&i, value) in order.iter().zip(values.chunks_exact(components)) {
        out[i * components..(i + 1) * components].copy_from_slice(value);
    }
    out
}

fn octant(normal: Vec3) -> u8 {
    let bit = |x: f32| u8::from(x < 0.0);
    bit(normal.x) | bit(normal.y) << 1 | bit(normal.z) << 2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::testing::Random;

    #[test]
    fn blocks_are_small_and_every_receiver_is_in_one() {
        let mut random = Random(3);
        let positions: Vec<_> = (0..64 * 512).map(|_| random.vector()).collect();
        let normals = vec![Vec3::Y; positions.len()];
        let order = order(&positions, &normals);
        let mut seen = order.clone();
        seen.sort_unstable();
        assert!(seen.into_iter().eq(0..positions.len()));
        let size: f32 = order
            .chunks(64)
            .map(|block| {
                let bounds = Bounds3::around(block.iter().map(|&i| positions[i]));
                bounds.diagonal()
            })
            .sum::<f32>()
            / 512.0;
        // 512 cubes of side 1/4 fill the cube of side 2; runs of the curve straddle two.
        assert!(size < 2.0 * 0.25 * 3.0_f32.sqrt(), "{size}");
    }

    #[test]
    fn both_sides_of_a_wall_come_apart() {
        let mut random = Random(4);
        let positions: Vec<_> = (0..4096)
            .map(|_| random.vector() * Vec3::new(1.0, 0.0, 1.0))
            .collect();
        let normals: Vec<_> = (0..4096)
            .map(|i| if i % 2 == 0 { Vec3::Y } else { -Vec3::Y })
            .collect();
        let order = order(&positions, &normals);
        let mixed = (order.chunks(64))
            .filter(|block| block.iter().any(|i| i % 2 != block[0] % 2))
            .count();
        assert!(mixed <= 16, "{mixed} of 64");
    }

    #[test]
    fn undoing_an_order_gives_every_receiver_its_own_values() {
        let positions: Vec<_> = (0..100)
            .map(|i| Vec3::X * ((i * 37) % 100) as f32)
            .collect();
        let order = order(&positions, &vec![Vec3::Y; 100]);
        let values: Vec<f32> = order.iter().flat_map(|&i| [positions[i].x, 7.0]).collect();
        for (position, value) in positions.iter().zip(undo(&order, &values, 2).chunks(2)) {
            assert_eq!(value, [position.x, 7.0]);
        }
        assert!(super::order(&[], &[]).is_empty());
        assert_eq!(super::order(&[Vec3::ONE; 3], &[Vec3::Y; 3]), [0, 1, 2]);
    }
}
