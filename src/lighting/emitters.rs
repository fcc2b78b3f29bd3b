//! Emissive surfaces: large plane ones in closed form, others of constant radiance as clusters, both with ray-traced
//! visibility; points as balls; textured ones sampled.

use super::balls::{Ball, Balls, Cones, shines_as_balls};
use super::clusters::Clusters;
use super::panels::{Panel, PanelBuilder};
use super::particles::Particles;
use super::pattern;
use super::sampled::SampledEmitters;
use super::stand::Stand;
use crate::math::Frame;
use crate::scene::{Input, Interpolation, ParticleSet, PrimId, Scene};
use crate::shading::{Shader, SurfacePoint};
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// At most so many panels; a panel gives at least this part of all emitted power, else it is sampled with the rest.
const MOST_PANELS: usize = 64;
/// Panels with longer outlines cost more than sampling them.
const MOST_EDGES: usize = 1024;
/// Panels that fill more of the cosine-weighted hemisphere than this are tested along hemisphere directions, smaller
/// ones along rays to points spread over them.
const LARGE_PANEL: f32 = 0.25;
/// So many rays that agree decide that a panel is wholly visible or wholly hidden.
const DECISIVE: usize = 16;
/// Above this number of emissive triangles none are joined to panels: as clusters they are as exact.
const MOST_JOINED: usize = 1 << 16;

/// A triangle that emits from its front side, in world space, corners counter-clockwise as seen from there.
#[derive(Debug, Clone, Copy)]
pub(super) struct EmissiveTriangle {
    pub(super) prim: PrimId,
    pub(super) triangle: u32,
    pub(super) corners: [Vec3; 3],
    /// Radiance (at the centroid), times the part of the surface that there is.
    pub(super) emission: Vec3,
    /// The same radiance all over it.
    pub(super) is_constant: bool,
    /// World area.
    pub(super) area: f32,
}

/// All emissive surfaces of a scene.
#[derive(Debug)]
pub(super) struct Emitters {
    panels: Vec<Panel>,
    clusters: Clusters,
    balls: Balls,
    particles: Particles,
    sampled: SampledEmitters,
}

/// Patterns of rays to emissive surfaces.
#[derive(Debug)]
pub(super) struct EmitterPatterns {
    pub(super) hemisphere: Vec<Vec3>,
    pub(super) squares: Vec<Vec2>,
    picks: Vec<Vec2>,
    cones: Cones,
}

impl EmitterPatterns {
    /// `rays` of each kind.
    pub(super) fn new(rays: u32) -> Self {
        Self {
            hemisphere: pattern::hemisphere(rays),
            squares: pattern::square(rays),
            picks: pattern::picks(rays),
            cones: Cones::new(rays),
        }
    }

    /// Half as many of each.
    pub(super) fn halves(&self) -> (&[Vec3], &[Vec2]) {
        let half = |count: usize| count.div_ceil(2);
        (
            &self.hemisphere[..half(self.hemisphere.len())],
            &self.squares[..half(self.squares.len())],
        )
    }
}

impl Emitters {
    /// Of `triangles`, `balls` and `particles`, sets and factors on their radiance; linear in all. `are_met`: rays of receivers
    /// meet all balls.
    pub(super) fn new(
        shader: &Shader<'_>,
        triangles: Vec<EmissiveTriangle>,
        (balls, are_met): (&[Ball], bool),
        particles: &[(&ParticleSet, Vec3)],
    ) -> Self {
        let (panels, rest) = if triangles.len() > MOST_JOINED {
            (Vec::new(), triangles)
        } else {
            PanelBuilder::new(MOST_PANELS, MOST_EDGES).build(triangles)
        };
        let (mut constant, textured): (Vec<_>, Vec<_>) =
            rest.into_iter().partition(|triangle| triangle.is_constant);
        let particles = || particles.iter().copied();
        constant.extend(particles().flat_map(|(set, factor)| glowing_disks(set, factor)));
        let spheres = particles().filter(|(set, _)| set.normal.is_empty());
        Self {
            panels,
            clusters: Clusters::new(&constant),
            balls: Balls::new(shader.scene(), balls, are_met),
            particles: Particles::new(spheres),
            sampled: SampledEmitters::new(shader.scene(), &textured),
        }
    }

    /// True if nothing emits.
    pub(super) fn is_empty(&self) -> bool {
        self.panels.is_empty()
            && self.clusters.is_empty()
            && self.balls.is_empty()
            && self.particles.is_empty()
            && self.sampled.is_empty()
    }

    /// Irradiance.
    pub(super) fn irradiance(
        &self,
        patterns: &EmitterPatterns,
        shader: &Shader<'_>,
        stand: &Stand<'_>,
    ) -> Vec3 {
        let stand = stand.moved_to(self.off_panels(stand));
        let unoccluded: Vec<f32> = (self.panels.iter())
            .map(|panel| panel.irradiance(stand.origin, stand.point.normal))
            .collect();
        let total: f32 = unoccluded.iter().sum();
        let mut sum = Vec3::ZERO;
        for (panel, &irradiance) in self.panels.iter().zip(&unoccluded) {
            if irradiance > 0.0 {
                let visible = if irradiance > PI * LARGE_PANEL {
                    visible_of_large(panel, &stand, &patterns.hemisphere)
                } else {
                    visible_of_small(panel, &stand, &patterns.squares, irradiance / total)
                };
                sum += panel.emission * irradiance * visible;
            }
        }
        if !self.clusters.is_empty() {
            sum += self.clusters.irradiance(&stand, &patterns.picks);
        }
        if !self.balls.is_empty() {
            sum +=
                (self.balls).irradiance((&patterns.picks, &patterns.cones), shader.scene(), &stand);
        }
        if !self.particles.is_empty() {
            sum += self.particles.irradiance(&stand, &patterns.picks);
        }
        if !self.sampled.is_empty() {
            sum += self.sampled.irradiance(shader, &stand, patterns.halves());
        }
        sum
    }

    /// A receiver on the edge of a panel lies in its plane, where its irradiance jumps: it is seen from the front side.
    fn off_panels(&self, stand: &Stand<'_>) -> Vec3 {
        let height = stand.tracer.lift_height(stand.point.position);
        self.panels.iter().fold(stand.origin, |origin, panel| {
            let distance = panel.distance(origin);
            let is_own = panel.normal.dot(stand.point.geometric_normal).abs() > 0.999;
            if distance.abs() < height && !is_own {
                origin + panel.normal * (height - distance)
            } else {
                origin
            }
        })
    }
}

fn visible_of_large(panel: &Panel, stand: &Stand<'_>, hemisphere: &[Vec3]) -> f32 {
    let frame = Frame::about(stand.point.normal);
    let rays = hemisphere.iter().map(|&local| {
        let direction = frame.to_world(local);
        let distance = panel.hit(stand.origin, direction)?;
        Some((direction, distance, 1.0))
    });
    visible_share(panel, stand, rays)
}

fn visible_of_small(panel: &Panel, stand: &Stand<'_>, squares: &[Vec2], share: f32) -> f32 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "a part of the samples"
    )]
    let count = {
        let wanted = share * panel.squares_a_point() * squares.len() as f32;
        let least = (DECISIVE as f32 * panel.squares_a_point()) as usize;
        (wanted as usize).clamp(least, squares.len().max(least))
    };
    let rays = squares.iter().take(count).enumerate();
    let rays = rays.map(|(index, &square)| {
        let offset = panel.place(index, square)? - stand.origin;
        let squared = offset.length_squared();
        let direction = offset.try_normalize()?;
        let cosines =
            stand.point.normal.dot(direction).max(0.0) * -panel.normal.dot(direction).min(0.0);
        (cosines > 0.0).then(|| (direction, squared.sqrt(), cosines / squared))
    });
    visible_share(panel, stand, rays)
}

/// Weighted share of unblocked rays (direction, distance, weight), a quarter of them if these agree.
fn visible_share(
    panel: &Panel,
    stand: &Stand<'_>,
    rays: impl ExactSizeIterator<Item = Option<(Vec3, f32, f32)>>,
) -> f32 {
    let quarter = rays.len().div_ceil(4);
    let (mut all, mut lit, mut blocked) = (0.0, 0.0, 0.0);
    let met = rays
        .enumerate()
        .filter_map(|(index, ray)| ray.map(|ray| (index, ray)));
    for (count, (index, (direction, distance, weight))) in met.enumerate() {
        let is_enough = index >= quarter && count >= DECISIVE.min(quarter);
        if is_enough && (lit == 0.0 || blocked == 0.0) {
            break;
        }
        all += weight;
        let place = stand.origin + direction * distance;
        let open = stand.sees_surface(place, direction, -panel.normal.dot(direction));
        lit += weight * open;
        blocked += weight * (1.0 - open);
    }
    if all > 0.0 { lit / all } else { 0.0 }
}

/// Particles that face somewhere, as triangles of their area.
fn glowing_disks(set: &ParticleSet, factor: Vec3) -> impl Iterator<Item = EmissiveTriangle> {
    let disks = set.normal.iter().zip(&set.position);
    let disks = disks.zip(set.radius.iter().zip(&set.radiance));
    disks.filter_map(move |((&normal, &center), (&radius, &radiance))| {
        let area = PI * radius * radius;
        // From the center of an equilateral triangle of this area to its corners.
        let reach = (area * 4.0 / (3.0 * 3.0_f32.sqrt())).sqrt();
        let frame = Frame::about(normal);
        let corner = |turn: f32| {
            let (sin, cos) = (turn * TAU / 3.0).sin_cos();
            center + reach * (frame.tangent * cos + frame.bitangent * sin)
        };
        let emission = radiance * factor;
        let shines = emission.max_element() > 0.0 && area > 0.0;
        shines.then_some(EmissiveTriangle {
            prim: PrimId(0),
            triangle: 0,
            corners: [corner(0.0), corner(1.0), corner(2.0)],
            emission,
            is_constant: true,
            area,
        })
    })
}

/// All triangles that emit and are not part of a ball that does, in order of prims and triangles.
pub(super) fn emissive_triangles(shader: &Shader<'_>) -> Vec<EmissiveTriangle> {
    let scene = shader.scene();
    let mut all = Vec::new();
    for (prim, index) in scene.prims.iter().zip(0..) {
        let id = PrimId(index);
        let is_mirrored = prim.world_from_object.matrix3.determinant() < 0.0;
        let mesh = scene.mesh_of(prim);
        let has_balls = shines_as_balls(shader, prim);
        for (t, triangle) in (0..mesh.triangles.len()).zip(0_u32..) {
            if !shader.may_emit(id, triangle) {
                continue;
            }
            let mut corners = mesh
                .corners(t)
                .map(|p| prim.world_from_object.transform_point3(p));
            if is_mirrored {
                corners.swap(1, 2);
            }
            let [a, b, c] = corners.map(|p| p.as_dvec3());
            #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
            let area = 0.5 * (b - a).cross(c - a).length() as f32;
            let centroid = SurfacePoint {
                prim: id,
                triangle,
                u: 1.0 / 3.0,
                v: 1.0 / 3.0,
                footprint: area.sqrt(),
            };
            let is_constant = has_constant_emission(scene, id, t);
            if is_constant && has_balls {
                continue;
            }
            let surface = shader.surface(&centroid);
            let emission = surface.emission * surface.opacity;
            if area > 0.0 && !(is_constant && emission == Vec3::ZERO) {
                all.push(EmissiveTriangle {
                    prim: id,
                    triangle,
                    corners,
                    emission,
                    is_constant,
                    area,
                });
            }
        }
    }
    all
}

/// True if triangle `t` of `prim` emits the same all over.
pub(super) fn has_constant_emission(scene: &Scene, prim: PrimId, t: usize) -> bool {
    let prim = &scene.prims[prim.index()];
    let mesh = scene.mesh_of(prim);
    (prim.materials.of_face(mesh.triangle_faces[t])).is_some_and(|id| {
        let material = &scene.materials[id.index()];
        let inputs = [
            &material.emissive_color,
            &material.opacity,
            &material.opacity_threshold,
        ];
        inputs.into_iter().all(|input| match input {
            Input::Constant(_) => true,
            Input::Primvar { name, .. } => mesh.primvar(name).is_none_or(|primvar| {
                let kind = &primvar.interpolation;
                matches!(kind, Interpolation::Constant | Interpolation::Uniform)
            }),
            Input::Texture(_) => false,
        })
    })
}

/// Unit normal on the front side; zero without area.
pub(super) fn front_normal(corners: &[Vec3; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    (b - a).cross(c - a).normalize_or_zero()
}
