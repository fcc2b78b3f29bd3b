//! A ray with what boxes and triangles need of it, computed once.

use glam::Vec3;

/// A ray towards `direction` (of any length: distances count in it), ready for boxes and triangles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
    /// Componentwise inverse of `direction`, finite.
    pub(super) inverse: [f32; 3],
    /// 1 where the direction's component is negative.
    pub(super) backward: [usize; 3],
    /// Axes for the triangle test: the two lesser ones and the one in which the direction is longest.
    pub(super) axes: [usize; 3],
    /// Shears the direction onto that axis, and scales it to 1.
    pub(super) shear: [f32; 3],
    /// Hits at this distance or beyond do not count.
    pub(super) max_distance: f32,
}

/// A component below this part of the longest one cannot cross a box in a lifetime of floats; it stands in for 0, whose
/// inverse would make `0 · ∞`.
const LEAST_COMPONENT: f32 = 1e-18;

impl Ray {
    /// `None` if a number is not finite, the direction is zero, or no distance is left (`max_distance` may be infinite).
    #[inline(always)]
    pub(super) fn new(origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Self> {
        let longest = direction.abs().max_element();
        let is_valid = origin.is_finite() && direction.is_finite() && longest > 0.0;
        if !is_valid || max_distance.is_nan() || max_distance <= 0.0 {
            return None;
        }
        let z = (0..3).find(|&axis| direction[axis].abs() == longest)?;
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let least = longest * LEAST_COMPONENT;
        let inverse = |d: f32| {
            1.0 / if d.abs() < least {
                least.copysign(d)
            } else {
                d
            }
        };
        Some(Self {
            origin,
            direction,
            inverse: direction.to_array().map(inverse),
            backward: direction
                .to_array()
                .map(|d| usize::from(d.is_sign_negative())),
            axes: [x, y, z],
            shear: [
                direction[x] / direction[z],
                direction[y] / direction[z],
                1.0 / direction[z],
            ],
            max_distance: max_distance.min(f32::MAX),
        })
    }
}
