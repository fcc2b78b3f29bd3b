//! Light that comes straight from its source: UsdLux lights, the environment, emissive surfaces; with ray-traced
//! shadows and without noise.

mod balls;
mod beacons;
mod clusters;
mod emitters;
mod environment;
mod form_factor;
mod lights;
mod linked;
mod linked_domes;
mod linked_emitters;
mod panels;
mod particles;
mod pattern;
mod pictures;
mod sampled;
mod shape;
mod shaping;
mod stand;
mod tree;

pub use environment::{EnvironmentCell, EnvironmentSet, SkyLight};
pub use linked_domes::LinkedDomes;

use crate::diagnostics::Diagnostics;
use crate::scene::{PlacedMesh, PrimId, Scene, on_the_side_of};
use crate::shading::{Shader, SurfacePoint};
use crate::trace::{Hit, Tracer};
use emitters::EmitterPatterns;
use environment::Environment;
use glam::Vec3;
use lights::{AreaLight, Patterns};
use linked::{LinkedLights, Scratch};
use linked_domes::{Fineness, is_linked};
use linked_emitters::LinkedEmitters;
use stand::Stand;
use std::sync::Arc;

/// A point that receives light on one side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShadePoint {
    /// World position relative to the scene's origin, on the surface (it is lifted here where needed).
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit normal of the plane it lies on, same side as `normal`.
    pub geometric_normal: Vec3,
    /// From `position` to the smooth surface that the plane stands for, if it does for one; see [`smooth_offset`].
    /// Light from below the plane and above the horizon of `normal` arrives there; `None` = it does not arrive.
    pub smooth_offset: Option<Vec3>,
    /// The prim it lies on; lights that are linked to others do not reach it. `None` = they all do.
    pub prim: Option<PrimId>,
}

impl ShadePoint {
    /// The point with barycentric `weights` of triangle `t` of `world`, whose front side has the unit normal `plane`; on
    /// its back if `back`. The cosine to lights is taken with the shading normal, as a renderer does; shadows and the
    /// side that is lit go by the plane.
    pub fn on_side(
        world: &PlacedMesh<'_>,
        (t, weights): (u32, Vec3),
        plane: Vec3,
        back: bool,
    ) -> Self {
        let corners = world.corners(t);
        let [a, b, c] = corners;
        let sign = if back { -1.0 } else { 1.0 };
        let shading = on_the_side_of(plane, world.shading_normal(t, weights.y, weights.z));
        let normal = shading * sign;
        let smooth_offset = (shading != plane)
            .then(|| world.corner_normals(t))
            .flatten()
            .map(|normals| smooth_offset(&corners, &normals, weights, normal));
        Self {
            position: a * weights.x + b * weights.y + c * weights.z,
            normal,
            geometric_normal: plane * sign,
            smooth_offset,
            prim: None,
        }
    }

    /// Where a ray met `world`, on the side that it met; `plane` is the unit normal of the triangle's plane on that side.
    pub fn at_hit(world: &PlacedMesh<'_>, hit: &Hit, plane: Vec3) -> Self {
        let weights = Vec3::new(1.0 - hit.u - hit.v, hit.u, hit.v);
        let front = if hit.front { plane } else { -plane };
        Self::on_side(world, (hit.triangle, weights), front, !hit.front).of_prim(hit.prim)
    }

    /// The same point as one of `prim`.
    pub fn of_prim(self, prim: PrimId) -> Self {
        Self {
            prim: Some(prim),
            ..self
        }
    }

    /// The point `surface` with the unit normals (shading, plane) of the side that is lit.
    pub fn on_mesh(
        scene: &Scene,
        surface: &SurfacePoint,
        position: Vec3,
        (normal, geometric_normal): (Vec3, Vec3),
    ) -> Self {
        let smooth = || {
            let prim = &scene.prims[surface.prim.index()];
            let matrix = prim.world_from_object;
            let mesh = scene.mesh_of(prim);
            let t = surface.triangle as usize;
            let normals = mesh.corner_normals(t)?;
            let corners = mesh.corners(t).map(|p| matrix.transform_point3(p));
            let to_world = matrix.matrix3.inverse().transpose();
            let weights = Vec3::new(1.0 - surface.u - surface.v, surface.u, surface.v);
            let normals = normals.map(|n| Vec3::from(to_world * glam::Vec3A::from(n)));
            Some(smooth_offset(&corners, &normals, weights, normal))
        };
        Self {
            position,
            normal,
            geometric_normal,
            smooth_offset: (normal != geometric_normal).then(smooth).flatten(),
            prim: (surface.prim != PrimId::NONE).then_some(surface.prim),
        }
    }
}

/// From the point with `weights` of the corners of a triangle to the smooth surface that it stands for: the mean over
/// the corners of its feet on the planes through them at right angles to their `normals` (of any length and side),
/// where these lie above it on the side of the unit `normal`. Zero at the corners, and on hollow surfaces. Hanika 2021.
pub fn smooth_offset(
    corners: &[Vec3; 3],
    normals: &[Vec3; 3],
    weights: Vec3,
    normal: Vec3,
) -> Vec3 {
    let point = corners[0] * weights.x + corners[1] * weights.y + corners[2] * weights.z;
    let mean = normals[0] * weights.x + normals[1] * weights.y + normals[2] * weights.z;
    let side = if mean.dot(normal) < 0.0 { -1.0 } else { 1.0 };
    let rise = |corner: usize| {
        let up = normals[corner].normalize_or_zero() * side;
        up * (corners[corner] - point).dot(up).max(0.0)
    };
    let offset = rise(0) * weights.x + rise(1) * weights.y + rise(2) * weights.z;
    if offset.is_finite() {
        offset
    } else {
        Vec3::ZERO
    }
}

/// How finely extended lights are sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LightSamples {
    /// Shadow rays in penumbrae (fewer decide whether a receiver lies in one) to an extended light that is all there is.
    /// Of several each has its share, 4 or more; weak ones have one for some together, where there are more than 4. Surfels send
    /// so many to each light.
    pub per_light: u32,
    /// Rays to emissive surfaces.
    pub emissive: u32,
    /// World-fixed directions that sample a textured environment, about. Error of its irradiance by 64, 128, 256 and
    /// 512 on a bunny on a plane under a sky with a sun and four small bright areas: 1.8, 0.95, 0.57, 0.44 %; without
    /// the sun 3.2, 1.6, 1.0, 0.7 %.
    pub environment: u32,
}

impl Default for LightSamples {
    fn default() -> Self {
        Self {
            per_light: 256,
            emissive: 256,
            environment: 256,
        }
    }
}

impl LightSamples {
    /// For receivers of results that may err by `tolerance`, if there is one: few shadow rays are far better than 2 %.
    pub fn within(tolerance: Option<f64>) -> Self {
        let usual = Self::default();
        let is_wide = tolerance.is_some_and(|tolerance| tolerance >= COARSE);
        Self {
            per_light: if is_wide {
                usual.per_light / 4
            } else {
                usual.per_light
            },
            ..usual
        }
    }

    /// The lesser of each.
    fn at_most(self, other: Self) -> Self {
        Self {
            per_light: self.per_light.min(other.per_light),
            emissive: self.emissive.min(other.emissive),
            environment: self.environment.min(other.environment),
        }
    }

    /// For surfels: their error averages out over many.
    pub const SURFEL: Self = Self {
        per_light: 16,
        emissive: 64,
        environment: 128,
    };
}

/// Least tolerance for which a quarter of the usual shadow rays is tried: bands in wide penumbrae can just be seen then.
const COARSE: f64 = 0.03;

/// Shadow rays of surfels to many lights together.
const OF_MANY: u32 = 64;

/// Rays to a light end this part of their length before it, more than the rounding of a hit distance, so that a surface
/// in which the light lies does not block it.
const END_MARGIN: f32 = 256.0 * f32::EPSILON;

/// How far a shadow ray goes to something at `distance`.
fn end_before(distance: f32) -> f32 {
    distance * (1.0 - END_MARGIN)
}

/// All sources of a scene, prepared for sampling.
#[derive(Debug)]
pub struct Lighting {
    lights: LinkedLights,
    /// Domes without links.
    environment: Environment,
    linked_domes: Arc<LinkedDomes>,
    emitters: LinkedEmitters,
    /// For receivers.
    fine: Detail,
    /// For surfels.
    coarse: Detail,
    /// For surfels that look at every light, where these are many.
    of_many: Patterns,
}

/// The patterns of one [`LightSamples`].
#[derive(Debug)]
struct Detail {
    lights: Patterns,
    sky: EnvironmentSet,
    emitters: EmitterPatterns,
}

impl Detail {
    fn new(samples: LightSamples, sky: EnvironmentSet) -> Self {
        Self {
            lights: Patterns::new(samples.per_light),
            sky,
            emitters: EmitterPatterns::new(samples.emissive),
        }
    }
}

impl Lighting {
    /// Prepare the scene's lights and emissive surfaces; textures are read here (missing ones are warnings). `samples`
    /// are those for receivers; surfels have at most [`LightSamples::SURFEL`].
    pub fn new(shader: &Shader<'_>, samples: LightSamples, diagnostics: &Diagnostics) -> Self {
        let coarse = samples.at_most(LightSamples::SURFEL);
        Self::with(shader, (samples, coarse), diagnostics)
    }

    /// The same where surfels have as many `samples` as receivers.
    pub fn of_surfels(
        shader: &Shader<'_>,
        samples: LightSamples,
        diagnostics: &Diagnostics,
    ) -> Self {
        Self::with(shader, (samples, samples), diagnostics)
    }

    /// With samples for receivers, and for surfels.
    fn with(
        shader: &Shader<'_>,
        (samples, coarse): (LightSamples, LightSamples),
        diagnostics: &Diagnostics,
    ) -> Self {
        let everywhere = shader.lights().filter(|light| !is_linked(light));
        let environment = Environment::new(everywhere, diagnostics);
        let counts = [samples.environment, coarse.environment];
        let [fine_sky, coarse_sky] = environment.sets(counts);
        let surfaces = || (shader.scene(), shader.opacity());
        let linked = LinkedDomes::new(surfaces(), shader.lights(), counts, diagnostics);
        Self {
            linked_domes: Arc::new(linked),
            lights: LinkedLights::new(surfaces(), shader.lights(), diagnostics),
            emitters: LinkedEmitters::new(shader),
            fine: Detail::new(samples, fine_sky),
            coarse: Detail::new(coarse, coarse_sky),
            of_many: Patterns::new(OF_MANY),
            environment,
        }
    }

    /// The same sources with the samples of surfels. With `every_light`, more than 16 lights light a surfel as they do a receiver;
    /// without, those of them that each give it little of its light are looked at by chance, 16 at a time: right in the mean over
    /// neighbors, not at each surfel.
    pub fn for_surfels(&self, every_light: bool) -> SurfelLighting<'_> {
        SurfelLighting {
            lighting: self,
            every_light,
        }
    }

    /// Irradiance from all UsdLux lights but domes: closed form where unshadowed, times the ray-traced visible part.
    pub fn lights(&self, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        self.lights_at(tracer, std::slice::from_ref(point))[0]
    }

    /// [`Self::lights`] at each of `points`.
    pub fn lights_at(&self, tracer: &Tracer, points: &[ShadePoint]) -> Vec<Vec3> {
        let (patterns, mut scratch) = (&self.fine.lights, Scratch::default());
        let stands = points.iter().map(|point| Stand::new(tracer, point));
        let lights = &self.lights;
        stands
            .map(|stand| lights.irradiance(patterns, &stand, &mut scratch))
            .collect()
    }

    /// Irradiance from dome lights along unblocked directions; exact when nothing blocks.
    pub fn environment(&self, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        self.environment_by(&self.fine, tracer, point)
    }

    /// [`Self::environment`], and the direction it comes from, at each of `points`; faster where neighbors follow each
    /// other, since they look along each direction together. Nothing beyond `reach` hides the environment.
    pub fn environment_of(
        &self,
        tracer: &Tracer,
        points: &[ShadePoint],
        reach: f32,
    ) -> Vec<SkyLight> {
        self.skies_of(Fineness::Receivers, tracer, (points, reach))
    }

    fn skies_of(
        &self,
        fineness: Fineness,
        tracer: &Tracer,
        (points, reach): (&[ShadePoint], f32),
    ) -> Vec<SkyLight> {
        let sky = match fineness {
            Fineness::Receivers => &self.fine.sky,
            Fineness::Surfels => &self.coarse.sky,
        };
        let mut light = in_blocks(tracer, (points, reach), |stands| {
            self.environment.block(sky, stands)
        });
        (self.linked_domes).add(fineness, tracer, (points, reach), &mut light);
        light
    }

    /// The sky divided anew, for engines that look along directions of their own: [`EnvironmentSet::even`] then has one
    /// cell for each of the unit `directions`, in their order, and [`EnvironmentSet::importance`] about `share` times as
    /// many as [`Self::environment_set`]. Costs tens of milliseconds for a large map.
    pub fn environment_along(&self, directions: &[Vec3], share: f32) -> EnvironmentSet {
        let usual = self.fine.sky.importance().len();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "part of a small count"
        )]
        let importance = (usual as f32 * share).ceil() as usize;
        self.environment.set_along(directions, importance)
    }

    /// The directions that all receivers look at the environment along, domes with links apart; empty without others.
    pub fn environment_set(&self) -> &EnvironmentSet {
        &self.fine.sky
    }

    /// Domes that are in no [`EnvironmentSet`] of this.
    pub fn linked_domes(&self) -> &Arc<LinkedDomes> {
        &self.linked_domes
    }

    /// Radiance of the environment from unit `direction` (towards the sky), summed over the domes that light `prim`; over all
    /// domes for whoever lies on none.
    pub fn environment_radiance(&self, prim: Option<PrimId>, direction: Vec3) -> Vec3 {
        self.environment.radiance(direction) + self.linked_domes.radiance(prim, direction)
    }

    /// The environment's radiance if it is the same in all directions and for all prims (then irradiance = π · L · visibility);
    /// black without domes.
    pub fn uniform_environment(&self) -> Option<Vec3> {
        (self.environment.uniform).filter(|_| self.linked_domes.is_empty())
    }

    /// Distance and radiance of the nearest light whose shape lies along the unit `direction` closer than `max_distance`.
    /// Lights are no geometry: this is how a camera sees them.
    pub fn seen(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<(f32, Vec3)> {
        self.lights.seen(origin, direction, max_distance)
    }

    /// True if nothing shines at all: no lights, no environment, no emissive surface.
    pub fn is_dark(&self) -> bool {
        self.lights.count() == 0 && !self.has_environment() && !self.has_emitters()
    }

    /// Lights that shadow rays go to one by one: all but domes and emissive surfaces.
    pub fn light_count(&self) -> usize {
        self.lights.count()
    }

    /// True if there are dome lights that are not black.
    pub fn has_environment(&self) -> bool {
        self.environment.is_lit() || !self.linked_domes.is_empty()
    }

    /// True if some surface emits.
    pub fn has_emitters(&self) -> bool {
        !self.emitters.is_empty()
    }

    /// Irradiance from emissive surfaces, complete: those of constant radiance almost exact where unoccluded, times
    /// their visible part; textured ones by hemisphere and area samples combined by the balance heuristic.
    pub fn emitters(&self, shader: &Shader<'_>, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        self.emitters_by(&self.fine, shader, &Stand::new(tracer, point))
    }

    /// Irradiance from all lights and domes by one ray a light, of more than four by one in all, and
    /// by a few to the sky, all of which `number` chooses: in the mean over all numbers the truth. Emissive surfaces are
    /// left out.
    pub fn glimpse(&self, tracer: &Tracer, point: &ShadePoint, number: u32) -> Vec3 {
        let stand = Stand::new(tracer, point);
        let sky = if self.has_environment() {
            let linked = self.linked_domes.glimpse(&stand, number);
            self.environment.glimpse(&self.fine.sky, &stand, number) + linked
        } else {
            Vec3::ZERO
        };
        let patterns = &self.fine.lights;
        let of =
            |light: &AreaLight, stand: &Stand<'_>| light.glance(patterns, stand, number as usize);
        (self.lights).glimpse(patterns, &stand, number, &of) + sky
    }

    /// What a lobe reflects of all lights, by the rays of [`Self::glimpse`]: `brdf` (1/sr) tells how much of the light from a
    /// unit direction. Domes and emissive surfaces are left out.
    pub fn glint(
        &self,
        tracer: &Tracer,
        point: &ShadePoint,
        number: u32,
        brdf: &dyn Fn(Vec3) -> Vec3,
    ) -> Vec3 {
        let patterns = &self.fine.lights;
        let of = |light: &AreaLight, stand: &Stand<'_>| {
            light.glint(patterns, stand, number as usize, brdf)
        };
        (self.lights).glimpse(patterns, &Stand::new(tracer, point), number, &of)
    }

    fn environment_by(&self, detail: &Detail, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        let stand = Stand::new(tracer, point);
        let mut light = [self.environment.light(&detail.sky, &stand)];
        let asked = (std::slice::from_ref(point), f32::INFINITY);
        self.linked_domes.add_light(tracer, asked, &mut light);
        light[0].irradiance
    }

    fn emitters_by(&self, detail: &Detail, shader: &Shader<'_>, stand: &Stand<'_>) -> Vec3 {
        if self.emitters.is_empty() {
            return Vec3::ZERO;
        }
        (self.emitters).irradiance(&detail.emitters, shader, stand)
    }
}

/// `work` on as many receivers at a time as can look together.
fn in_blocks(
    tracer: &Tracer,
    (points, reach): (&[ShadePoint], f32),
    work: impl Fn(&[Stand<'_>]) -> Vec<SkyLight>,
) -> Vec<SkyLight> {
    let block = |points: &[ShadePoint]| {
        let stands: Vec<_> = (points.iter())
            .map(|point| Stand::new(tracer, point).reaching(reach))
            .collect();
        work(&stands)
    };
    points.chunks(environment::MOST).flat_map(block).collect()
}

/// A [`Lighting`] sampled as coarsely as surfels allow. Its methods are those of the same names there.
#[derive(Debug, Clone, Copy)]
pub struct SurfelLighting<'a> {
    lighting: &'a Lighting,
    every_light: bool,
}

impl SurfelLighting<'_> {
    /// Irradiance from all UsdLux lights but domes and those that [`Self::wide`] has.
    pub fn lights(&self, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        let patterns = &self.lighting.coarse.lights;
        self.sum(&Stand::new(tracer, point), |light, stand| {
            light.irradiance(patterns, stand)
        })
    }

    /// The same with one ray a light, to a place on it that `number` chooses: exact out of penumbrae; in them either
    /// nothing or all of the light, and in the mean over all numbers the truth.
    pub fn glance(&self, tracer: &Tracer, point: &ShadePoint, number: usize) -> Vec3 {
        let patterns = &self.lighting.coarse.lights;
        self.sum(&Stand::new(tracer, point), |light, stand| {
            light.glance(patterns, stand, number)
        })
    }

    /// What `of` says of the lights, summed, but where every one of many is looked at, which takes fewer rays.
    fn sum(&self, stand: &Stand<'_>, of: impl Fn(&AreaLight, &Stand<'_>) -> Vec3) -> Vec3 {
        let lights = &self.lighting.lights;
        match (self.every_light, lights.are_many()) {
            (true, true) => {
                lights.irradiance(&self.lighting.of_many, stand, &mut Scratch::default())
            }
            (true, false) => lights.sum(stand, of),
            (false, _) => lights.major(stand, of),
        }
    }

    /// Irradiance at each of `points` from dome lights and emissive surfaces, and from lights that are looked at by chance;
    /// faster where neighbors follow each other.
    pub fn wide(&self, shader: &Shader<'_>, tracer: &Tracer, points: &[ShadePoint]) -> Vec<Vec3> {
        let (lighting, detail) = (self.lighting, &self.lighting.coarse);
        let mut light = if lighting.has_environment() {
            let sky = lighting.skies_of(Fineness::Surfels, tracer, (points, f32::INFINITY));
            sky.into_iter().map(|light| light.irradiance).collect()
        } else {
            vec![Vec3::ZERO; points.len()]
        };
        if lighting.has_emitters() {
            for (light, point) in light.iter_mut().zip(points) {
                *light += lighting.emitters_by(detail, shader, &Stand::new(tracer, point));
            }
        }
        if !self.every_light {
            let stands = points.iter().map(|point| Stand::new(tracer, point));
            (lighting.lights).add_minor(&detail.lights, stands, &mut light);
        }
        light
    }
}

#[cfg(test)]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "numbers of tests are small"
)]
mod tests;
