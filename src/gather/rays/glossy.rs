//! Light of surfaces that are seen in glossy ones, with what they reflect glossily themselves: metal in metal.
//!
//! Surfels hold what is reflected diffusely, which of metal is nothing. So a ray that a lobe sent out goes on where it meets
//! a surface with lobes: by one direction of one of them, and again, a few times. Which direction hangs on the number of the
//! ray alone, in an evenly spread sequence: all receivers take the same ones, and there is no noise from one to the next.
//! Weak lobes, those of plastic, are followed by fewer of the rays, which count for more.

use super::lobe::Lobes;
use super::through::Radiates;
use crate::gather::radiance::{Outgoing, RadianceSource};
use crate::gather::ray_query::RayQuery;
use crate::math::sequence;
use crate::scene::{PlacedMesh, on_the_side_of};
use crate::shading::SurfacePoint;
use crate::trace::Hit;
use glam::Vec3;

/// Glossy reflections that are followed beyond the receiver's own. Four more would add 0.9⁵ of a closed box of metal to what is
/// there, and nothing visible elsewhere.
const MOST: u32 = 4;

/// Lobes that reflect this part of the light, or more, are followed by every ray.
const STRONG: f32 = 0.25;

/// Light that arrives at a receiver's lobe along its ray numbered `number`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Glossy<'a> {
    pub(super) query: &'a dyn RayQuery,
    pub(super) source: &'a RadianceSource<'a>,
    pub(super) lobes: Lobes<'a>,
    pub(super) max_distance: f32,
    pub(super) number: u32,
}

/// A reflected ray.
struct Turned {
    start: Vec3,
    direction: Vec3,
    /// What the lobe makes of the light from there.
    share: Vec3,
}

impl Radiates for Glossy<'_> {
    fn radiance(&self, hit: &Hit, origin: Vec3, direction: Vec3) -> Outgoing {
        let mut light = self.source.radiance(hit, origin, direction);
        light.reflected += self.reflection(*hit, direction);
        light
    }
}

impl Glossy<'_> {
    /// What `hit` reflects glossily towards where the unit `direction` came from.
    fn reflection(&self, mut hit: Hit, mut direction: Vec3) -> Vec3 {
        let (mut light, mut part) = (Vec3::ZERO, Vec3::ONE);
        for depth in 0..MOST {
            let Some(turned) = self.turn(&hit, direction, (depth, part)) else {
                break;
            };
            part *= turned.share;
            let (start, next) = (turned.start, turned.direction);
            let found = self.query.closest(start, next, self.max_distance);
            let reach = found.map_or(f32::INFINITY, |hit| hit.distance);
            let lighting = self.lobes.lighting;
            let seen = lighting.and_then(|lighting| lighting.seen(start, next, reach));
            if let Some((_, radiance)) = seen {
                light += part * radiance;
                break;
            }
            let Some(met) = found else {
                let sky =
                    |lighting: &crate::lighting::Lighting| lighting.environment_radiance(next);
                light += part * lighting.map_or(Vec3::ZERO, sky);
                break;
            };
            let of_surface = self.source.radiance(&met, start, next);
            light += part * (of_surface.reflected + of_surface.emitted);
            (hit, direction) = (met, next);
        }
        light
    }

    /// Where a ray of which `part` is left goes on from `hit`, if it does.
    fn turn(&self, hit: &Hit, direction: Vec3, (depth, part): (u32, Vec3)) -> Option<Turned> {
        let shader = self.lobes.shader;
        let point = SurfacePoint {
            prim: hit.prim,
            triangle: hit.triangle,
            u: hit.u,
            v: hit.v,
            footprint: 0.0,
        };
        let gloss = shader.gloss(&point);
        let world = PlacedMesh::of(shader.scene(), hit.prim);
        let side = if hit.front { 1.0 } else { -1.0 };
        let plane = world.plane_normal(hit.triangle).try_normalize()? * side;
        let shading = world.shading_normal(hit.triangle, hit.u, hit.v) * side;
        let frame = sequence::transported_frame(on_the_side_of(plane, shading));
        let view = frame.to_local(-direction);
        let strength = |cosine: f32| {
            move |lobe: &crate::shading::gloss::Lobe| lobe.fresnel(cosine).max_element()
        };
        let all: f32 = gloss.lobes().map(strength(view.z)).sum();
        if view.z <= 0.0 || all <= 0.0 {
            return None;
        }
        let followed = (part.max_element() * all / STRONG).min(1.0);
        let mut pick = sequence::sobol_owen(self.number, seed(depth, 1)).x / followed * all;
        let (place, mut lobes) = (
            sequence::sobol_owen(self.number, seed(depth, 0)),
            gloss.lobes(),
        );
        let lobe = lobes.find(|lobe| {
            let own = strength(view.z)(lobe);
            let is_picked = pick < own;
            pick -= own;
            is_picked
        })?;
        let (local, share) = lobe.sample(view, place)?;
        let out = frame.to_world(local);
        let height = out.dot(plane);
        let out = if height < 0.0 {
            out - plane * (2.0 * height)
        } else {
            out
        };
        let position = world.position(hit.triangle, hit.u, hit.v);
        Some(Turned {
            start: self.query.lift(position, plane),
            direction: out,
            share: share * (all / (strength(view.z)(lobe) * followed)),
        })
    }
}

/// Numbers of a sequence for each reflection and each thing that is chosen there.
fn seed(depth: u32, what: u32) -> u32 {
    sequence::hash(2 * depth + what + 1)
}
