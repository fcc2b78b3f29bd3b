//! A direction and a ray along it: what boxes and triangles need of them, computed once.
//!
//! Boxes take distances along the three axes. Triangles are sheared: the axis in which the direction is longest stays,
//! the other two slide so that the direction becomes that axis, and rays are points in two coordinates: of corners and
//! origins in `f64`, whose rounding is a billionth of that they came with.

use glam::Vec3;

/// A direction (of any length: distances count in it), ready for boxes and triangles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    pub(super) direction: Vec3,
    /// Componentwise inverse of `direction`, finite.
    pub(super) inverse: [f32; 3],
    /// 1 where the direction's component is negative.
    pub(super) backward: [usize; 3],
    /// Two lesser axes and the one in which the direction is longest; in an order that keeps triangles that face
    /// against the direction counter-clockwise.
    pub(super) axes: [usize; 3],
    /// Depth is the coordinate of the longest axis times this, 1 or −1, so that it grows along the direction.
    pub(super) sign: f64,
    /// The lesser coordinates of the direction for a unit of depth, −1…1.
    pub(super) slope: [f64; 2],
    /// Distance for a unit of depth.
    pub(super) scale: f64,
}

/// A component below this part of the longest one cannot cross a box in a lifetime of floats; it stands in for 0, whose
/// inverse would make `0 · ∞`.
const LEAST_COMPONENT: f32 = 1e-18;

/// Of the largest coordinate of an origin: what boxes are too large for the roundings of its distances to them, 1.5 ε.
pub(super) const ORIGIN_MARGIN: f32 = 4.0 * f32::EPSILON;

/// One rounding lies between a corner and the distance of a hit and three in that of a box, half of ε each.
pub(super) const FAR_MARGIN: f32 = 1.0 + 8.0 * f32::EPSILON;

impl Line {
    /// `None` if a number is not finite or the direction is zero.
    #[inline(always)]
    pub(super) fn new(direction: Vec3) -> Option<Self> {
        let longest = direction.abs().max_element();
        if !(direction.is_finite() && longest > 0.0) {
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
        let unit = 1.0 / f64::from(longest);
        Some(Self {
            direction,
            inverse: direction.to_array().map(inverse),
            backward: direction
                .to_array()
                .map(|d| usize::from(d.is_sign_negative())),
            axes: [x, y, z],
            sign: 1.0_f64.copysign(direction[z].into()),
            slope: [x, y].map(|axis| f64::from(direction[axis]) * unit),
            scale: unit,
        })
    }

    /// Sheared coordinates and depth of `point`.
    #[inline(always)]
    pub(super) fn place(&self, point: [f32; 3]) -> [f64; 3] {
        let [kx, ky, kz] = self.axes;
        let (x, y, z) = (
            f64::from(point[kx]),
            f64::from(point[ky]),
            f64::from(point[kz]),
        );
        let depth = self.sign * z;
        [x - self.slope[0] * depth, y - self.slope[1] * depth, depth]
    }
}

/// A ray.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    pub(super) line: Line,
    pub(super) origin: Vec3,
    /// The origin as seen from the sides by which the ray enters boxes and by which it leaves them.
    pub(super) enter: [f32; 3],
    pub(super) leave: [f32; 3],
    /// The origin, sheared.
    pub(super) place: [f64; 3],
    /// Hits beyond this distance do not count.
    pub(super) max_distance: f32,
    /// Of hits at `max_distance` those of triangles before this one count: ties are independent of the order of search.
    pub(super) before: u32,
}

impl Ray {
    /// `None` if a number is not finite, the direction is zero, or no distance is left (`max_distance` may be infinite).
    #[inline(always)]
    pub(super) fn new(origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Self> {
        let line = Line::new(direction)?;
        if !origin.is_finite() || max_distance.is_nan() || max_distance <= 0.0 {
            return None;
        }
        let margin = ORIGIN_MARGIN * origin.abs().max_element();
        let (mut enter, mut leave) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let ahead = margin.copysign(direction[axis]);
            enter[axis] = origin[axis] + ahead;
            leave[axis] = origin[axis] - ahead;
        }
        Some(Self {
            line,
            origin,
            enter,
            leave,
            place: line.place(origin.to_array()),
            max_distance: max_distance.min(f32::MAX),
            before: 0,
        })
    }

    /// Boxes farther than this cannot hold anything that counts.
    #[inline(always)]
    pub(super) fn limit(&self) -> f32 {
        self.max_distance * FAR_MARGIN
    }
}
