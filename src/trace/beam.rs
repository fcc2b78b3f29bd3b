//! Rays that lie close together, as those of a pixel or those to a light: one way through the hierarchy for all of them, the
//! same hits.

use super::ray::Ray;
use super::triangles::LocalHit;
use super::{Hit, Tracer};
use fearless_simd::{Simd, dispatch};
use glam::Vec3;

/// Rays and what they hit first. Kept from one pixel to the next, it allocates nothing.
#[derive(Debug, Default)]
pub struct Beam {
    rays: Vec<Ray>,
    /// Of each ray as it was pushed: its place in `rays`; `None` where a number is not finite.
    places: Vec<Option<usize>>,
    local: Vec<Option<LocalHit>>,
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

/// What is asked about at a time.
pub const TOGETHER: usize = 16;

/// The way from `origin` along the unit `direction` for `max_distance` (may be infinite).
#[derive(Debug, Clone, Copy)]
pub struct Way {
    /// World position relative to the scene's origin.
    pub origin: Vec3,
    /// Unit.
    pub direction: Vec3,
    /// Stage units.
    pub max_distance: f32,
}

impl Way {
    /// Nowhere.
    pub const NONE: Self = Self {
        origin: Vec3::ZERO,
        direction: Vec3::ZERO,
        max_distance: 0.0,
    };
}

impl Tracer {
    /// [`Self::transmittance`] of each of up to [`TOGETHER`] ways, to the last bit. Soonest for ways between which there is
    /// little room.
    ///
    /// # Panics
    /// If there are more.
    pub fn transmittances(&self, ways: &[Way]) -> [f32; TOGETHER] {
        let blocked = dispatch!(self.level, simd => self.find_blocked(simd, ways));
        let mut open = [0.0; TOGETHER];
        for ((i, way), open) in ways.iter().enumerate().zip(&mut open) {
            if blocked >> i & 1 == 0 {
                *open = self.screened((way.origin, way.direction), way.max_distance);
            }
        }
        open
    }

    /// A bit for each of `ways` that something solid blocks.
    #[inline(always)]
    fn find_blocked<S: Simd>(&self, simd: S, ways: &[Way]) -> u32 {
        let ray = |way: &Way| Ray::new(way.origin, way.direction, way.max_distance);
        let mut all = ways
            .iter()
            .enumerate()
            .filter_map(|(i, way)| Some((i, ray(way)?)));
        let Some((first, one)) = all.next() else {
            return 0;
        };
        let (mut rays, mut places, mut count) = ([one; TOGETHER], [first; TOGETHER], 1);
        for (i, ray) in all {
            (rays[count], places[count]) = (ray, i);
            count += 1;
        }
        let rays = &mut rays[..count];
        let mut is_blocked = [false; TOGETHER];
        let triangles = &self.world.triangles;
        triangles.occluded_in(simd, (rays, &mut is_blocked));
        let mut blocked = 0;
        for ((ray, is_blocked), place) in rays.iter_mut().zip(is_blocked).zip(places) {
            if is_blocked || self.meets_occurrence(simd, ray) {
                blocked |= 1 << place;
            }
        }
        blocked
    }
}
