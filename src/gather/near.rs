//! Light where surfels are too coarse to tell it: in gaps between surfaces that are thinner than surfels are wide.
//!
//! The foot of a chess piece almost touches the board. The surfels of the board under its rim have their centers in the
//! open, so whoever looks at them from within the gap would see them lit. Where a hit is near and something stands
//! between it and the place in front of its surfel that the surfel's light was found at, light is found anew at the hit.

use crate::lighting::{Lighting, ShadePoint, SurfelLighting};
use crate::surfels::SurfelCloud;
use crate::trace::{Hit, Tracer};
use glam::Vec3;

/// Hits farther than this many radii of their surfel are not in a gap that matters. On a bunny of 70 000 triangles and
/// 100 000 surfels 1.5 takes 2.5 % of error down to 1.05 %, for 1.4 times the time.
const NEAR_RADII: f32 = 1.5;

/// Height over the surfel's center of the place that a hit has to see, in radii: what a wide source lights the surfel
/// through.
const PLACE_RADII: f32 = 0.5;

/// Finds the light of single places.
#[derive(Debug, Clone, Copy)]
pub struct NearLight<'a> {
    tracer: &'a Tracer,
    lighting: SurfelLighting<'a>,
}

impl<'a> NearLight<'a> {
    /// `None` where single places can't be lit by a few rays: emissive surfaces take many.
    pub fn new(tracer: &'a Tracer, lighting: &'a Lighting) -> Option<Self> {
        (!lighting.has_emitters()).then(|| Self {
            tracer,
            lighting: lighting.for_surfels(),
        })
    }

    /// Reflected radiance at `hit`, which lies at `position` on surfel `i` of `cloud`; `None`: that of the surfel.
    pub(super) fn reflected(
        &self,
        (cloud, i): (&SurfelCloud, usize),
        hit: &Hit,
        position: Vec3,
    ) -> Option<Vec3> {
        let (normal, radius) = (cloud.normal[i], cloud.radius[i]);
        // Dark surfels are left alone: most of them are inside of things, and so are those who look at them.
        if hit.distance > NEAR_RADII * radius || cloud.radiosity[i] == Vec3::ZERO {
            return None;
        }
        let place = cloud.position[i] + normal * (PLACE_RADII * radius);
        let start = self.tracer.lift(position, normal);
        let way = place - start;
        let distance = way.length();
        if !(distance > 0.0 && self.tracer.occluded(start, way / distance, distance)) {
            return None;
        }
        let point = ShadePoint {
            position,
            normal,
            geometric_normal: normal,
            smooth_offset: None,
        };
        let irradiance = self.lighting.glimpse(self.tracer, &point, number(hit));
        Some(cloud.albedo[i] * irradiance * std::f32::consts::FRAC_1_PI)
    }
}

/// Another one for every hit, so that what few rays to the lights miss at one, they find at its neighbors.
fn number(hit: &Hit) -> usize {
    let bits = hit.u.to_bits() ^ hit.v.to_bits().rotate_left(16) ^ hit.triangle;
    (bits.wrapping_mul(0x9e37_79b9) >> 20) as usize
}
