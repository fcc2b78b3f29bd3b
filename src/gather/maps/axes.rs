//! The directions of the maps: axes spread over half the sphere, each looked along both ways.

use crate::math::{Frame, sequence};
use glam::{Mat3, Quat, Vec2, Vec3};
use std::f32::consts::TAU;

/// One axis and how its map lies across it. The three vectors are orthonormal.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Axis {
    /// Its place among all.
    pub(super) number: usize,
    /// Along the rows of the map.
    pub(super) right: Vec3,
    /// Along its columns.
    pub(super) up: Vec3,
    /// The axis, unit.
    pub(super) direction: Vec3,
    /// Where the grid begins within a pixel, 0…1 of it.
    pub(super) shift: Vec2,
}

/// Turns the spiral off the world's axes, where walls have their normals; any turn without symmetry does.
fn turn() -> Quat {
    Quat::from_xyzw(0.183_013, 0.365_148, 0.547_723, 0.730_297).normalize()
}

/// `count` axes. Both directions of all of them are spread evenly over the sphere, so every hemisphere holds exactly
/// `count`. Grids are turned and shifted from one axis to the next, so that their errors are independent.
pub(super) fn axes(count: u32) -> Vec<Axis> {
    let turn = Mat3::from_quat(turn());
    (0..count)
        .map(|i| {
            let direction = (turn * sequence::spiral_sphere(i, 2 * count)).normalize();
            let frame = Frame::about(direction);
            let shift = sequence::sobol_owen(i, 1);
            let (sin, cos) = (TAU * sequence::sobol_owen(i, 2).x).sin_cos();
            Axis {
                number: i as usize,
                right: frame.tangent * cos + frame.bitangent * sin,
                up: frame.bitangent * cos - frame.tangent * sin,
                direction,
                shift,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_orthonormal_and_weigh_every_normal_alike() {
        for count in [1_u32, 64, 257] {
            let axes = axes(count);
            for axis in &axes {
                assert!(axis.right.cross(axis.up).dot(axis.direction) > 0.999_99);
                assert!(axis.right.dot(axis.up).abs() < 1e-5);
            }
            if count < 64 {
                continue;
            }
            // The mean of |n·ω| over the sphere is 1/2; 64 random axes would miss it by 0.036.
            for i in 0..50 {
                let normal = sequence::spiral_sphere(i, 50);
                let sum: f32 = axes.iter().map(|a| a.direction.dot(normal).abs()).sum();
                let mean = sum / count as f32;
                assert!((mean - 0.5).abs() < 0.012, "{count}: {mean}");
            }
        }
    }
}
