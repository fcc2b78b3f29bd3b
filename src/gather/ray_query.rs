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
    /// [`Self::occluded`] for up to 64 rays of one direction: those of `active` that are blocked, a bit each.
    fn occluded_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        max_distance: f32,
        active: u64,
    ) -> u64 {
        let is_blocked = |&(i, &origin): &(usize, &Vec3)| {
            active >> i & 1 == 1 && self.occluded(origin, direction, max_distance)
        };
        (origins.iter().enumerate().filter(is_blocked)).fold(0, |mask, (i, _)| mask | 1 << i)
    }
    /// [`Self::closest`] for up to 64 rays of one direction, those of `active`, into `hits`.
    fn closest_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        (max_distance, active): (f32, u64),
        hits: &mut [Option<Hit>],
    ) {
        for (i, (&origin, hit)) in origins.iter().zip(hits).enumerate() {
            *hit = (active >> i & 1 == 1)
                .then(|| self.closest(origin, direction, max_distance))
                .flatten();
        }
    }
    /// The tracer that knows what lies behind surfaces that let light through; `None` where there are no such.
    fn screens(&self) -> Option<&Tracer> {
        None
    }
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

    fn occluded_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        max_distance: f32,
        active: u64,
    ) -> u64 {
        Self::occluded_along(self, direction, origins, max_distance, active)
    }

    fn closest_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        asked: (f32, u64),
        hits: &mut [Option<Hit>],
    ) {
        Self::closest_along(self, direction, origins, asked, hits);
    }

    fn screens(&self) -> Option<&Tracer> {
        self.has_screens().then_some(self)
    }

    fn lift(&self, position: Vec3, normal: Vec3) -> Vec3 {
        Self::lift(self, position, normal)
    }
}
