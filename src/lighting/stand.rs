//! How a receiver stands on its surface: where its shadow rays start.
//!
//! Directions under the plane of the receiver's triangle and yet above its shading horizon occur on coarse smooth
//! meshes. Rays along them would meet the triangle itself, which prints the facets into the shadow's edge. They start
//! where the smooth surface is that the triangle stands for: Hanika, *Hacking the Shadow Terminator* (2021). Directions
//! above the plane start on the triangle, so that nothing else changes.

use super::{ShadePoint, end_before};
use crate::trace::{Tracer, Way};
use glam::Vec3;
use std::cell::OnceCell;

/// Rays to an emissive surface end at least this many lifting heights (along its normal) before it: it must not block
/// them itself.
const CLEARANCE: f32 = 0.5;

/// A receiver with the places its rays start from.
#[derive(Debug)]
pub(super) struct Stand<'a> {
    pub(super) tracer: &'a Tracer,
    pub(super) point: &'a ShadePoint,
    /// Start of rays above the plane.
    pub(super) origin: Vec3,
    /// How far away what hides the environment may be.
    pub(super) reach: f32,
    /// Start of those below it, once asked for; `None` = they see nothing.
    below: OnceCell<Option<Vec3>>,
}

impl<'a> Stand<'a> {
    pub(super) fn new(tracer: &'a Tracer, point: &'a ShadePoint) -> Self {
        Self {
            tracer,
            point,
            origin: tracer.lift(point.position, point.geometric_normal),
            reach: f32::INFINITY,
            below: OnceCell::new(),
        }
    }

    /// The same receiver, from which nothing beyond `reach` hides the environment.
    pub(super) fn reaching(self, reach: f32) -> Self {
        Self { reach, ..self }
    }

    /// The same receiver with rays above the plane starting at `origin`.
    pub(super) fn moved_to(&self, origin: Vec3) -> Self {
        Self {
            origin,
            below: OnceCell::new(),
            ..*self
        }
    }

    fn below(&self) -> Option<Vec3> {
        *self.below.get_or_init(|| {
            let offset = self.point.smooth_offset?;
            let smooth = self
                .tracer
                .lift(self.point.position + offset, self.point.normal);
            let way = smooth - self.origin;
            let distance = way.length();
            // a surface that touches the triangle may lie in between
            let is_free =
                distance == 0.0 || !self.tracer.occluded(self.origin, way / distance, distance);
            is_free.then_some(smooth)
        })
    }

    /// Where a ray towards unit `direction` starts, if it leaves the surface.
    pub(super) fn start(&self, direction: Vec3) -> Option<Vec3> {
        if self.point.geometric_normal.dot(direction) > 0.0 {
            Some(self.origin)
        } else {
            (self.point.normal.dot(direction) > 0.0)
                .then(|| self.below())
                .flatten()
        }
    }

    /// Part of the light from unit `direction` that comes through what is within reach, 0…1.
    pub(super) fn sees_sky(&self, direction: Vec3) -> f32 {
        self.start(direction).map_or(0.0, |start| {
            self.tracer.transmittance(start, direction, self.reach)
        })
    }

    /// Part of the light that comes through what is between the receiver and `position` on an emissive surface, which lies
    /// in unit `direction` and whose normal makes the cosine `leaving` with the way back.
    pub(super) fn sees_surface(&self, position: Vec3, direction: Vec3, leaving: f32) -> f32 {
        let way = self.way_to_surface(position, direction, leaving);
        way.map_or(0.0, |way| self.passes(&way))
    }

    /// The way there; `None` where the surface of the receiver itself hides it.
    pub(super) fn way_to_surface(
        &self,
        position: Vec3,
        direction: Vec3,
        leaving: f32,
    ) -> Option<Way> {
        let clearance = CLEARANCE * self.tracer.lift_height(self.point.position);
        let before = clearance / leaving.max(f32::MIN_POSITIVE);
        let end = |distance: f32| end_before(distance).min(distance - before);
        Some(Self::towards(
            (self.start(direction)?, direction),
            position,
            end,
        ))
    }

    /// The way from a place to `position`, which lies in unit direction, as far as the `end` of one that long says. At the end
    /// nothing is in between: a way of no length is open.
    fn towards((origin, direction): (Vec3, Vec3), position: Vec3, end: impl Fn(f32) -> f32) -> Way {
        let offset = position - origin;
        let distance = offset.length();
        let max_distance = end(distance).max(0.0);
        Way {
            origin,
            direction: if max_distance > 0.0 {
                offset / distance
            } else {
                direction
            },
            max_distance,
        }
    }

    /// Part of the light that comes along `way`, 0…1.
    fn passes(&self, way: &Way) -> f32 {
        (self.tracer).transmittance(way.origin, way.direction, way.max_distance)
    }

    /// Part of the light that comes through what is between the receiver and `position`, which lies in unit `direction`.
    pub(super) fn sees(&self, position: Vec3, direction: Vec3) -> f32 {
        let way = self.way(Some(position), direction);
        way.map_or(0.0, |way| self.passes(&way))
    }

    /// The way to `position`, or as far as the sky is where there is none, in unit `direction`; `None` where the surface itself
    /// hides it.
    pub(super) fn way(&self, position: Option<Vec3>, direction: Vec3) -> Option<Way> {
        let origin = self.start(direction)?;
        let Some(position) = position else {
            return Some(Way {
                origin,
                direction,
                max_distance: self.reach,
            });
        };
        Some(Self::towards((origin, direction), position, end_before))
    }
}
