//! What a ray sees through surfaces that let light through: each gives its part, and lets the rest of what lies beyond pass.

use crate::gather::radiance::{Outgoing, RadianceSource};
use crate::gather::ray_query::RayQuery;
use crate::trace::{Hit, Layer, Tracer};
use glam::Vec3;

/// What is seen along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sight {
    /// Part of the direction that is covered, 0…1.
    pub(super) coverage: f32,
    /// To the first thing that covers some of it; `INFINITY` for nothing, 0 where that was not asked.
    pub(super) distance: f32,
    /// Times the part that each of its sources covers.
    pub(super) light: Outgoing,
}

impl Sight {
    pub(super) const NOTHING: Self = Self {
        coverage: 0.0,
        distance: f32::INFINITY,
        light: Outgoing::BLACK,
    };

    /// All covered by something at `distance`.
    pub(super) fn covered(distance: f32, light: Outgoing) -> Self {
        Self {
            coverage: 1.0,
            distance,
            light,
        }
    }
}

/// Tells the light of what rays meet.
pub(super) trait Radiates {
    /// Radiance from `hit` back to `origin`, from which the unit `direction` met it.
    fn radiance(&self, hit: &Hit, origin: Vec3, direction: Vec3) -> Outgoing;
}

impl Radiates for RadianceSource<'_> {
    #[inline]
    fn radiance(&self, hit: &Hit, origin: Vec3, direction: Vec3) -> Outgoing {
        RadianceSource::radiance(self, hit, origin, direction)
    }
}

/// A ray that looks for light, or only for what covers it, as far as a distance.
#[derive(Debug)]
pub(super) struct Look<'a, S = RadianceSource<'a>> {
    pub(super) query: &'a dyn RayQuery,
    pub(super) source: Option<&'a S>,
    pub(super) max_distance: f32,
}

impl<S> Clone for Look<'_, S> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<S> Copy for Look<'_, S> {}

impl<S: Radiates> Look<'_, S> {
    /// What is seen from `origin` in the unit `direction`.
    pub(super) fn along(&self, origin: Vec3, direction: Vec3, layers: &mut Vec<Layer>) -> Sight {
        let max = self.max_distance;
        let screens = self.query.screens();
        let Some(source) = self.source else {
            return match screens {
                None if self.query.occluded(origin, direction, max) => {
                    Sight::covered(0.0, Outgoing::BLACK)
                }
                None => Sight::NOTHING,
                Some(tracer) if tracer.solid_occluded(origin, direction, max) => {
                    Sight::covered(0.0, Outgoing::BLACK)
                }
                Some(tracer) => self.through(tracer, (origin, direction), Sight::NOTHING, layers),
            };
        };
        let lit = |hit: Hit| Sight::covered(hit.distance, source.radiance(&hit, origin, direction));
        let Some(tracer) = screens else {
            let hit = self.query.closest(origin, direction, max);
            return hit.map_or(Sight::NOTHING, lit);
        };
        let solid = tracer.solid_closest(origin, direction, max);
        let behind = solid.map_or(Sight::NOTHING, lit);
        self.through(tracer, (origin, direction), behind, layers)
    }

    /// What is seen of `behind` and of the screens before it.
    pub(super) fn through(
        &self,
        tracer: &Tracer,
        (origin, direction): (Vec3, Vec3),
        behind: Sight,
        layers: &mut Vec<Layer>,
    ) -> Sight {
        let end = self.max_distance.min(behind.distance);
        let open = tracer.layers((origin, direction), end, layers);
        let Some(first) = layers.first() else {
            return behind;
        };
        let mut sight = Sight {
            coverage: 1.0 - open * (1.0 - behind.coverage),
            distance: self.source.map_or(0.0, |_| first.hit.distance),
            light: behind.light.times(open),
        };
        if let Some(source) = self.source {
            let mut before = 1.0;
            for layer in layers.iter() {
                let light = source.radiance(&layer.hit, origin, direction);
                sight.light = sight.light.plus(light.times(before * layer.opacity));
                before *= 1.0 - layer.opacity;
            }
        }
        sight
    }
}
