//! Emissive `Points` of a stage: each point is one source of light, not the triangles that it is drawn with.
//!
//! A cloud of a hundred thousand sparks has two million triangles, of which a receiver sees half of each spark's. As
//! balls they are a twentieth of the sources, and no side of them has to be looked for.
//!
//! Where they are so dense that most of them are hidden by others, few of the rays to single ones would get there. There
//! rays look into the cone that holds a cluster, or all around, and what they meet of it shines.

use super::emitters::has_constant_emission;
use super::particles::{Crowd, Particles};
use super::pattern;
use super::stand::Stand;
use crate::math::Frame;
use crate::scene::{PlacedMesh, Prim, PrimId, Scene};
use crate::shading::{Shader, SurfacePoint};
use crate::trace::{Beam, TOGETHER};
use glam::{DVec3, Mat3A, Vec2, Vec3};
use std::f32::consts::TAU;
use std::f64::consts::PI;

/// Fewer balls of a prim are seen as their triangles, from which nothing of them is hidden by the receiver's horizon wrongly.
const FEWEST: usize = 64;

/// Axes of a ball may differ by this part.
const ROUND: f32 = 1e-3;

/// A ball beyond its triangles, which must not hide it.
const MARGIN: f64 = 1e-4;

/// A point of constant radiance, in world space relative to the scene's origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ball {
    pub(super) prim: PrimId,
    /// The first of its triangles.
    pub(super) triangle: u32,
    pub(super) center: Vec3,
    /// Of the sphere with the area of its triangles.
    pub(super) radius: f32,
    /// Of the sphere that holds these.
    pub(super) shell: f32,
    /// Times the part of the surface that there is.
    pub(super) radiance: Vec3,
}

/// Part of the rays that a crowd asks for that is enough for it, since there are powers of two only; and most of them.
const NEARLY: f32 = 0.75;
const MOST_RAYS: u32 = 1 << 20;

/// Number of a point that is no source.
const NONE: u32 = u32::MAX;

/// All emissive points of some prims.
#[derive(Debug)]
pub(super) struct Balls {
    particles: Particles,
    /// By prim and point, which source that is, or [`NONE`]; without prims where rays do not meet them.
    sources: Vec<Vec<u32>>,
}

/// Patterns of 4, 8, 16, … rays into a cone or all around.
#[derive(Debug)]
pub(super) struct Cones {
    patterns: Vec<Vec<Vec2>>,
    /// For all of the light.
    rays: f32,
}

impl Cones {
    /// `rays`, about.
    pub(super) fn new(rays: u32) -> Self {
        let most = rays.clamp(4, MOST_RAYS).next_power_of_two().ilog2();
        Self {
            patterns: (2..=most).map(pattern::blocks).collect(),
            #[expect(clippy::cast_precision_loss, reason = "at most 2^20 rays")]
            rays: rays as f32,
        }
    }

    /// For a cone that holds such a share of the light.
    fn of(&self, share: f32) -> &[Vec2] {
        #[expect(clippy::cast_precision_loss, reason = "at most 2^20 rays")]
        let is_enough = |cone: &&Vec<Vec2>| cone.len() as f32 >= NEARLY * share * self.rays;
        let last = &self.patterns[self.patterns.len() - 1];
        self.patterns.iter().find(is_enough).unwrap_or(last)
    }
}

impl Balls {
    /// Of `balls` of `scene`; `are_met`: rays meet all of them. Cost O(n log n).
    pub(super) fn new(scene: &Scene, balls: &[Ball], are_met: bool) -> Self {
        let particles = Particles::of_balls(balls);
        let mut sources = Vec::new();
        if are_met && !balls.is_empty() {
            sources = scene.prims.iter().map(|_| Vec::new()).collect();
            for (source, number) in particles.numbers().zip(0..) {
                let ball = &balls[source as usize];
                let mesh = scene.mesh_of(&scene.prims[ball.prim.index()]);
                let point = mesh.triangle_faces[ball.triangle as usize] as usize;
                let of_prim: &mut Vec<u32> = &mut sources[ball.prim.index()];
                of_prim.resize(of_prim.len().max(point + 1), NONE);
                of_prim[point] = number;
            }
        }
        Self { particles, sources }
    }

    /// True if there are none.
    pub(super) fn is_empty(&self) -> bool {
        self.particles.is_empty()
    }

    /// Irradiance; rays go to the balls that `picks` pick, and into `cones`.
    pub(super) fn irradiance(
        &self,
        (picks, cones): (&[Vec2], &Cones),
        scene: &Scene,
        stand: &Stand<'_>,
    ) -> Vec3 {
        let looks_into_cones = !self.sources.is_empty() && !stand.tracer.has_screens();
        let (parts, crowds) = self.particles.parts(stand, looks_into_cones);
        let alone: f32 = parts.iter().map(|part| part.irradiance).sum();
        let total = crowds.iter().map(|crowd| crowd.irradiance).sum::<f32>() + alone;
        let mut sum = self.particles.of_parts(&parts, stand, picks);
        let mut beam = Beam::default();
        for crowd in &crowds {
            let cone = cones.of(crowd.irradiance / total);
            sum += self.seen_of(crowd, (scene, stand), cone, &mut beam);
        }
        sum
    }

    /// Irradiance by what is seen of `crowd` along rays in the pattern `cone`.
    fn seen_of(
        &self,
        crowd: &Crowd,
        (scene, stand): (&Scene, &Stand<'_>),
        cone: &[Vec2],
        beam: &mut Beam,
    ) -> Vec3 {
        let fan = Fan::new(crowd, stand.point.normal);
        let mut sum = Vec3::ZERO;
        let mut weights = [0.0; TOGETHER];
        for some in cone.chunks(TOGETHER) {
            beam.clear();
            let mut count = 0;
            for place in some {
                let (direction, weight) = fan.direction(*place);
                if let Some(start) = stand.start(direction).filter(|_| weight > 0.0) {
                    beam.push(start, direction, f32::INFINITY);
                    weights[count] = weight;
                    count += 1;
                }
            }
            stand.tracer.solid_closest_in(beam);
            for (i, weight) in weights.iter().enumerate().take(count) {
                let source = beam.hit(i).and_then(|hit| {
                    let point = scene.mesh_of(&scene.prims[hit.prim.index()]).triangle_faces
                        [hit.triangle as usize];
                    self.sources[hit.prim.index()].get(point as usize).copied()
                });
                if let Some(source) = source.filter(|&source| crowd.holds(source)) {
                    sum += self.particles.radiance(source) * *weight;
                }
            }
        }
        #[expect(clippy::cast_precision_loss, reason = "at most 2^20 rays")]
        let rays = cone.len() as f32;
        sum / rays
    }
}

/// Directions that a crowd is looked for along.
struct Fan {
    frame: Frame,
    normal: Vec3,
    /// Of the cap of the unit sphere; `None`: a hemisphere, by the cosine.
    height: Option<f32>,
}

impl Fan {
    fn new(crowd: &Crowd, normal: Vec3) -> Self {
        Self {
            frame: Frame::about(crowd.cone.map_or(normal, |(towards, _)| towards)),
            normal,
            height: (crowd.cone).map(|(_, sine)| sine * sine / (1.0 + (1.0 - sine * sine).sqrt())),
        }
    }

    /// The unit direction at `place` of the unit square, and the cosine there over the density, per sr.
    fn direction(&self, place: Vec2) -> (Vec3, f32) {
        let Some(height) = self.height else {
            let up = (1.0 - place.x).max(0.0).sqrt();
            let direction = self.frame.to_world(pattern::disk(place).extend(up));
            return (direction, std::f32::consts::PI);
        };
        let up = 1.0 - height * place.x;
        let aside = Vec2::from_angle(TAU * place.y) * (1.0 - up * up).max(0.0).sqrt();
        let direction = self.frame.to_world(aside.extend(up));
        (direction, TAU * height * self.normal.dot(direction))
    }
}

/// True if the emissive points of `prim` are sources as balls.
pub(super) fn shines_as_balls(shader: &Shader<'_>, prim: &Prim) -> bool {
    let mesh = shader.scene().mesh_of(prim);
    let mut points = mesh.triangle_faces.chunk_by(|a, b| a == b);
    mesh.is_of_balls()
        && is_similarity(prim.world_from_object.matrix3)
        && points.nth(FEWEST - 1).is_some()
}

/// All balls that emit the same all over them, in order of prims and points.
pub(super) fn emissive_balls(shader: &Shader<'_>) -> Vec<Ball> {
    let scene = shader.scene();
    let mut all = Vec::new();
    for (prim, id) in scene.prims.iter().zip((0..).map(PrimId)) {
        if !shines_as_balls(shader, prim) {
            continue;
        }
        let world = PlacedMesh::new(scene, prim);
        let mut first = 0;
        for faces in world.mesh.triangle_faces.chunk_by(|a, b| a == b) {
            let next = first + u32::try_from(faces.len()).expect("triangles have 32 bits");
            let is_lit = shader.may_emit(id, first);
            if is_lit && has_constant_emission(scene, id, first as usize) {
                all.extend(ball(shader, &world, (id, first..next)));
            }
            first = next;
        }
    }
    all
}

/// The ball of `triangles`, if it shines.
#[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
fn ball(
    shader: &Shader<'_>,
    world: &PlacedMesh<'_>,
    (prim, triangles): (PrimId, std::ops::Range<u32>),
) -> Option<Ball> {
    let first = triangles.start;
    let corners = || (triangles.clone()).flat_map(|t| world.corners(t).map(Vec3::as_dvec3));
    let area: f64 = triangles.clone().map(|t| world.area(t)).sum();
    let center = corners().sum::<DVec3>() / (3 * triangles.len()) as f64;
    let reach = corners().map(|corner| corner.distance(center));
    let shell = (1.0 + MARGIN) * reach.fold(0.0, f64::max);
    let surface = shader.surface(&SurfacePoint {
        prim,
        triangle: first,
        u: 1.0 / 3.0,
        v: 1.0 / 3.0,
        footprint: area.sqrt() as f32,
    });
    let radiance = surface.emission * surface.opacity;
    (area > 0.0 && radiance != Vec3::ZERO).then_some(Ball {
        prim,
        triangle: first,
        center: center.as_vec3(),
        radius: (area / (4.0 * PI)).sqrt() as f32,
        shell: shell as f32,
        radiance,
    })
}

/// True if balls stay balls.
fn is_similarity(matrix: Mat3A) -> bool {
    let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
    let size = axes[0].length_squared();
    let is_alike = |i: usize, j: usize| {
        let expected = if i == j { size } else { 0.0 };
        (axes[i].dot(axes[j]) - expected).abs() <= ROUND * size
    };
    (0..3).all(|i| (i..3).all(|j| is_alike(i, j)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3A;

    #[test]
    fn turned_mirrored_and_scaled_balls_are_balls_and_stretched_ones_not() {
        let turned = Mat3A::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 1.0);
        assert!(is_similarity(turned * 3.0));
        assert!(is_similarity(
            turned * Mat3A::from_diagonal(Vec3::new(-2.0, 2.0, 2.0))
        ));
        assert!(!is_similarity(
            turned * Mat3A::from_diagonal(Vec3::new(1.0, 1.0, 1.1))
        ));
        let sheared = Mat3A::from_cols(Vec3A::X, Vec3A::new(0.1, 1.0, 0.0), Vec3A::Z);
        assert!(!is_similarity(sheared));
    }
}
