//! What the rays engine asks of geometry: the seam where tests put shapes in closed form.

use crate::trace::{Hit, Tracer};
use glam::Vec3;
use std::fmt::Debug;

/// Rays against some geometry; the contract is that of [`Tracer`]'s methods of the same names.
pub(super) trait RayQuery: Sync + Debug {
    /// First hit along the unit `direction` closer than `max_distance`.
    fn closest(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit>;
    /// True if anything lies along the unit `direction` closer than `max_distance`.
    fn occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool;
    /// `position` lifted along the unit `normal` so that rays do not meet the surface they start from.
    fn lift(&self, position: Vec3, normal: Vec3) -> Vec3;
}

impl RayQuery for Tracer {
    fn closest(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit> {
        Self::closest(self, origin, direction, max_distance)
    }

    fn occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        Self::occluded(self, origin, direction, max_distance)
    }

    fn lift(&self, position: Vec3, normal: Vec3) -> Vec3 {
        Self::lift(self, position, normal)
    }
}
