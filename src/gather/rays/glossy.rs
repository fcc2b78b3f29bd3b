//! Light of surfaces that are seen in glossy ones, with what they reflect glossily themselves: metal in metal.
//!
//! Surfels hold what is reflected diffusely, which of metal is nothing. So a ray that a lobe sent out goes on where it meets
//! a surface with lobes: by one direction of one of them, and again, a few times. Which direction hangs on the number of the
//! ray alone, in an evenly spread sequence: all receivers take the same ones, and there is no noise from one to the next.
//! Weak lobes, those of plastic, are followed by fewer of the rays, which count for more. Wide lobes seldom meet a lamp, which
//! then is very bright: for them lamps are looked at on purpose, and rays pass these.

use super::lobe::Lobes;
use super::through::Radiates;
use crate::gather::radiance::{Outgoing, RadianceSource};
use crate::gather::ray_query::RayQuery;
use crate::lighting::ShadePoint;
use crate::math::{Frame, sequence};
use crate::scene::{PlacedMesh, on_the_side_of};
use crate::shading::SurfacePoint;
use crate::shading::gloss::Lobe;
use crate::trace::Hit;
use glam::{Vec2, Vec3};

/// Glossy reflections that are followed beyond the receiver's own. Four more would add 0.9⁵ of a closed box of metal to what is
/// there, and nothing visible elsewhere.
const MOST: u32 = 4;

/// Lobes that reflect this part of the light, or more, are followed by every ray.
const STRONG: f32 = 0.25;

/// Width (`alpha`) from which lamps are looked at on purpose. For the plastic of two teapots below a panel (roughness 1) 1024
/// rays then err by 1.2 % instead of 3.9; lobes much narrower than lamps are served better by their own rays.
const WIDE: f32 = 0.1;

/// Light that arrives at a receiver's lobe along its ray numbered `number`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Glossy<'a> {
    pub(super) query: &'a dyn RayQuery,
    pub(super) source: &'a RadianceSource<'a>,
    pub(super) lobes: Lobes<'a>,
    pub(super) max_distance: f32,
    pub(super) number: u32,
}

/// A surface as a ray met it, with the one of its lobes that sends the ray on.
struct Met {
    lobe: Lobe,
    /// What the lobe reflects counts so many times: for other lobes, and for rays that end here.
    times: f32,
    position: Vec3,
    /// Unit, on the side that was met.
    plane: Vec3,
    /// About the shading normal on that side.
    frame: Frame,
    /// Unit, to where the ray came from, in the frame; Z is above 0.
    view: Vec3,
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
            let Some(met) = self.meet(&hit, direction, (depth, part)) else {
                break;
            };
            let lighting = self.lobes.lighting;
            let is_wide = met.lobe.alpha >= WIDE;
            if is_wide {
                light += part * self.lamps(&hit, &met, depth);
            }
            let place = sequence::sobol_owen(self.number, seed(depth, 0));
            let Some((next, share)) = met.turn(place) else {
                break;
            };
            part *= share;
            let start = self.query.lift(met.position, met.plane);
            let found = self.query.closest(start, next, self.max_distance);
            let reach = found.map_or(f32::INFINITY, |hit| hit.distance);
            let of_lamp = lighting.filter(|_| !is_wide);
            let lamp = of_lamp.and_then(|lighting| lighting.seen(start, next, reach));
            if let Some((_, radiance)) = lamp {
                light += part * radiance;
                break;
            }
            let Some(further) = found else {
                let sky =
                    lighting.map(|lighting| lighting.environment_radiance(Some(hit.prim), next));
                light += part * sky.unwrap_or(Vec3::ZERO);
                break;
            };
            let of_surface = self.source.radiance(&further, start, next);
            light += part * (of_surface.reflected + of_surface.emitted);
            (hit, direction) = (further, next);
        }
        light
    }

    /// What a ray of which `part` is left met, if it is followed further.
    fn meet(&self, hit: &Hit, direction: Vec3, (depth, part): (u32, Vec3)) -> Option<Met> {
        let shader = self.lobes.shader;
        let gloss = shader.gloss(&SurfacePoint::of_hit(hit, 0.0));
        let world = PlacedMesh::of(shader.scene(), hit.prim);
        let side = if hit.front { 1.0 } else { -1.0 };
        let plane = world.plane_normal(hit.triangle).try_normalize()? * side;
        let shading = world.shading_normal(hit.triangle, hit.u, hit.v) * side;
        let frame = sequence::transported_frame(on_the_side_of(plane, shading));
        let view = frame.to_local(-direction);
        let strength = |lobe: &Lobe| lobe.fresnel(view.z).max_element();
        let all: f32 = gloss.lobes().map(strength).sum();
        if view.z <= 0.0 || all <= 0.0 {
            return None;
        }
        let followed = (part.max_element() * all / STRONG).min(1.0);
        let mut pick = sequence::sobol_owen(self.number, seed(depth, 1)).x / followed * all;
        let lobe = gloss.lobes().find(|lobe| {
            let own = strength(lobe);
            let is_picked = pick < own;
            pick -= own;
            is_picked
        })?;
        Some(Met {
            lobe: *lobe,
            times: all / (strength(lobe) * followed),
            position: world.position(hit.triangle, hit.u, hit.v),
            plane,
            frame,
            view,
        })
    }

    /// What `met` reflects of lamps, by a few rays to these.
    fn lamps(&self, hit: &Hit, met: &Met, depth: u32) -> Vec3 {
        let Some(lighting) = self.lobes.lighting else {
            return Vec3::ZERO;
        };
        let world = PlacedMesh::of(self.lobes.shader.scene(), hit.prim);
        let point = ShadePoint::at_hit(&world, hit, met.plane);
        let share = |to_light: Vec3| {
            let light = met.frame.to_local(to_light);
            met.lobe.brdf(met.view, light) * met.times
        };
        let number = self.number.wrapping_add(seed(depth, 2));
        lighting.glint(self.lobes.tracer, &point, number, &share)
    }
}

impl Met {
    /// Where the lobe sends a ray on to, a unit vector, and what it makes of the light from there; `point` in [0, 1)² chooses it.
    fn turn(&self, point: Vec2) -> Option<(Vec3, Vec3)> {
        let (local, share) = self.lobe.sample(self.view, point)?;
        let out = self.frame.to_world(local);
        let height = out.dot(self.plane);
        let out = if height < 0.0 {
            out - self.plane * (2.0 * height)
        } else {
            out
        };
        Some((out, share * self.times))
    }
}

/// Numbers of a sequence for each reflection and each thing that is chosen there.
fn seed(depth: u32, what: u32) -> u32 {
    sequence::hash(3 * depth + what + 1)
}
