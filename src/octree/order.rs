//! [`SurfelCloud`] → surfels in the order of the tree: by class of normal, then along the Morton curve.

use super::radix;
use crate::math::{Bounds3, bits};
use crate::surfels::SurfelCloud;
use glam::Vec3;
use rayon::prelude::*;

/// Levels of octants in a key: 60 bits, below the 3 bits of the normal's class.
const POSITION_LEVELS: u32 = 20;

/// Where the class of the normal begins in a key.
pub(super) const CLASS_SHIFT: u32 = 3 * POSITION_LEVELS;

/// Cells along one edge of the root cube.
const CELLS: f32 = (1_u32 << POSITION_LEVELS) as f32;

/// Axes of the normals' classes, two classes each (±). Orthonormal and turned against the world, so that walls along
/// the axes, at 45° and on the cube's diagonals fall into one class each and not, by rounding, into two.
const CLASS_AXES: [Vec3; 3] = [
    Vec3::new(0.927_184, 0.374_607, 0.0),
    Vec3::new(-0.351_840, 0.870_825, 0.343_297),
    Vec3::new(0.128_601, -0.318_299, 0.939_227),
];

/// A surfel's place in the tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Entry {
    /// Class of the normal (3 bits), then the octant on each level, from the root down.
    pub key: u64,
    /// Index in the cloud.
    pub id: u32,
}

/// All surfels of `cloud`, sorted by (key, id): a total order, so the result does not depend on threads.
pub(super) fn sort(cloud: &SurfelCloud) -> Vec<Entry> {
    let bounds = (cloud.position.par_chunks(CHUNK))
        .map(|chunk| Bounds3::around(chunk.iter().copied()))
        .reduce(|| Bounds3::EMPTY, Bounds3::union);
    let edge = (bounds.max - bounds.min).max_element();
    let cells_per_unit = if edge > 0.0 { CELLS / edge } else { 0.0 };
    let count = u32::try_from(cloud.len()).expect("a cloud has less than 2³² surfels");
    let entries = (0..count).into_par_iter().map(|id| {
        let cell = (cloud.position[id as usize] - bounds.min) * cells_per_unit;
        Entry {
            key: class(cloud.normal[id as usize]) << CLASS_SHIFT | morton(cell),
            id,
        }
    });
    radix::sort(entries.collect())
}

/// Positions looked at in one go.
const CHUNK: usize = 1 << 14;

/// Which of the six [`CLASS_AXES`] directions is the nearest, 0…5. Normals of one class lie within 55° of its axis.
fn class(normal: Vec3) -> u64 {
    let components = CLASS_AXES.map(|axis| axis.dot(normal));
    let mut largest = 0;
    for axis in 1..3 {
        if components[axis].abs() > components[largest].abs() {
            largest = axis;
        }
    }
    2 * largest as u64 + u64::from(components[largest] < 0.0)
}

/// Place along the curve; coordinates outside the cube are moved onto it.
fn morton(cell: Vec3) -> u64 {
    bits::morton(cell.min(Vec3::splat(CELLS - 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_axes_are_orthonormal() {
        for (i, a) in CLASS_AXES.iter().enumerate() {
            for (j, b) in CLASS_AXES.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((a.dot(*b) - expected).abs() < 1e-4, "{i} {j} {}", a.dot(*b));
            }
        }
    }

    #[test]
    fn opposed_normals_never_share_a_class_and_common_walls_are_clear_of_its_borders() {
        for x in -2..=2 {
            for y in -2..=2 {
                for z in -2..=2 {
                    let normal = Vec3::new(x as f32, y as f32, z as f32);
                    if normal == Vec3::ZERO
                        || normal.abs().max_element() == 2.0 && normal.abs().element_sum() == 2.0
                    {
                        continue;
                    }
                    let n = normal.normalize();
                    assert_ne!(class(n), class(-n));
                    for tilt in [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z] {
                        assert_eq!(class(n), class((n + tilt * 1e-5).normalize()), "{normal}");
                    }
                }
            }
        }
    }

    #[test]
    fn keys_equal_interleaving_bit_by_bit() {
        for cell in [
            [0_u32, 0, 0],
            [1, 2, 3],
            [0xf_ffff, 0x5_5555, 0xa_aaaa],
            [123_456, 7, 999_999],
        ] {
            let mut expected = 0_u64;
            for bit in 0..20 {
                for (axis, coordinate) in cell.iter().enumerate() {
                    expected |= u64::from(coordinate >> bit & 1) << (3 * bit + axis);
                }
            }
            let [x, y, z] = cell.map(|c| c as f32);
            assert_eq!(morton(Vec3::new(x, y, z)), expected);
        }
        assert_eq!(morton(Vec3::splat(1e9)), (1 << 60) - 1);
    }
}
