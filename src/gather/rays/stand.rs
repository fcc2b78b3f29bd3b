//! Where a receiver's rays start, and which of its directions they take.

use crate::receivers::Receivers;
use crate::shading::SurfacePoint;
use glam::Vec3;

/// How a receiver stands on its triangle: what is done about directions above the shading horizon and yet below the
/// triangle's plane.
///
/// Inside a triangle such directions see nothing but the triangle itself, which the smooth surface it stands for would
/// not: they are mirrored at its plane, to what lies just above the horizon. (Counted as covered they would print the
/// facets of coarse smooth meshes into the occlusion, by (1 − cos θ)/2 for an angle θ between the normals.) On the rim,
/// at a vertex, the receiver's triangle is only one of those around it; there the rays themselves find out what is
/// free, which on convex corners is everything and in concave ones is not.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stand {
    /// Direction to lift the rays' origin along.
    pub(super) lift: Vec3,
    /// Plane normal to mirror at, if any.
    pub(super) mirror: Option<Vec3>,
}

/// Closer to a corner or edge than this in barycentric weight a receiver counts as lying on the rim.
const RIM: f32 = 1e-4;

impl Stand {
    pub(super) fn of(receivers: &Receivers, i: usize) -> Self {
        let (shading, plane) = (receivers.normal[i], receivers.geometric_normal[i]);
        let SurfacePoint { u, v, .. } = receivers.surface[i];
        let on_rim = u.min(v).min(1.0 - u - v) < RIM;
        if on_rim {
            Self {
                lift: receivers.rim_normal(i),
                mirror: None,
            }
        } else {
            Self {
                lift: plane,
                mirror: (shading != plane).then_some(plane),
            }
        }
    }

    pub(super) fn above_horizon(&self, direction: Vec3) -> Vec3 {
        let Some(plane) = self.mirror else {
            return direction;
        };
        let height = direction.dot(plane);
        if height < 0.0 {
            direction - plane * (2.0 * height)
        } else {
            direction
        }
    }
}
