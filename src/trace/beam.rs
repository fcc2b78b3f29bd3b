//! Rays that lie close together, as those of a pixel: one way through the hierarchy for all of them, the same hits.

use super::ray::Ray;
use super::triangles::LocalHit;
use super::{Hit, Tracer};
use fearless_simd::{Simd, dispatch};
use glam::Vec3;

/// Rays and what they hit first. Kept from one pixel to the next, it allocates nothing.
#[derive(Debug, Default)]
pub struct Beam {
    pub(super) rays: Vec<Ray>,
    /// Of each ray as it was pushed: its place in `rays`; `None` where a number is not finite.
    places: Vec<Option<usize>>,
    pub(super) local: Vec<Option<LocalHit>>,
    hits: Vec<Option<Hit>>,
}

impl Beam {
    /// Forget all rays.
    pub fn clear(&mut self) {
        self.rays.clear();
        self.places.clear();
        self.local.clear();
        self.hits.clear();
    }

    /// Another ray, from `origin` along the unit `direction`, which ends at `max_distance` (may be infinite).
    pub fn push(&mut self, origin: Vec3, direction: Vec3, max_distance: f32) {
        let ray = Ray::new(origin, direction, max_distance);
        self.places.push(ray.is_some().then_some(self.rays.len()));
        self.rays.extend(ray);
    }

    /// What ray `i`, as they were pushed, hit when the tracer last looked.
    ///
    /// # Panics
    /// If there are not so many, or the tracer has not looked since.
    pub fn hit(&self, i: usize) -> Option<Hit> {
        self.hits[self.places[i]?]
    }
}

impl Tracer {
    /// [`Self::solid_closest`] for all rays of `beam`, to the last bit. Soonest for rays between which there is little room.
    pub fn solid_closest_in(&self, beam: &mut Beam) {
        dispatch!(self.level, simd => self.find_closest_in(simd, beam));
    }

    #[inline(always)]
    fn find_closest_in<S: Simd>(&self, simd: S, beam: &mut Beam) {
        beam.local.clear();
        beam.local.resize(beam.rays.len(), None);
        let triangles = &self.world.triangles;
        triangles.closest_in(simd, (&mut beam.rays, &mut beam.local));
        beam.hits.clear();
        for (ray, local) in beam.rays.iter_mut().zip(&beam.local) {
            let own = local.map(|hit| self.world.resolve(hit));
            beam.hits.push(self.nearer_occurrence(simd, ray, own));
        }
    }
}
