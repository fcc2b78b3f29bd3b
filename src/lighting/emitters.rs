//! Emissive surfaces: large plane ones in closed form with ray-traced visibility, all others sampled.

use super::panels::{Panel, PanelBuilder};
use super::sampled::SampledEmitters;
use super::{LightSamples, ShadePoint, end_before, pattern};
use crate::math::Frame;
use crate::scene::{Input, PrimId, Scene};
use crate::shading::{Shader, SurfacePoint};
use crate::trace::Tracer;
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::PI;

/// At most so many panels; a panel gives at least this part of all emitted power, else it is sampled with the rest.
const MOST_PANELS: usize = 64;
/// Panels with longer outlines cost more than sampling them.
const MOST_EDGES: usize = 1024;
/// Panels that fill more of the cosine-weighted hemisphere than this are tested along hemisphere directions, smaller
/// ones along rays to points spread over them.
const LARGE_PANEL: f32 = 0.04;
/// Rays to a panel end at least this many lifting heights (along its normal) before it: the panel itself must not
/// block them.
const CLEARANCE: f32 = 0.5;

/// A triangle that emits from its front side, in world space, corners counter-clockwise as seen from there.
#[derive(Debug, Clone, Copy)]
pub(super) struct EmissiveTriangle {
    pub(super) prim: PrimId,
    pub(super) triangle: u32,
    pub(super) corners: [Vec3; 3],
    /// Radiance (at the centroid).
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
    sampled: SampledEmitters,
    hemisphere: Vec<Vec3>,
    squares: Vec<Vec2>,
}

impl Emitters {
    /// Find the emissive triangles; cost linear in the triangles of emissive materials.
    pub(super) fn new(shader: &Shader<'_>, samples: LightSamples) -> Self {
        let triangles = emissive_triangles(shader);
        let (panels, rest) = PanelBuilder::new(MOST_PANELS, MOST_EDGES).build(triangles);
        Self {
            panels,
            sampled: SampledEmitters::new(shader.scene(), &rest, samples.emissive),
            hemisphere: pattern::hemisphere(samples.emissive),
            squares: pattern::square(samples.emissive),
        }
    }

    /// True if nothing emits.
    pub(super) fn is_empty(&self) -> bool {
        self.panels.is_empty() && self.sampled.is_empty()
    }

    /// Irradiance at `point`; rays start at `origin` (the lifted position).
    pub(super) fn irradiance(
        &self,
        shader: &Shader<'_>,
        tracer: &Tracer,
        point: &ShadePoint,
        origin: Vec3,
    ) -> Vec3 {
        let receiver = Receiver {
            point,
            origin: self.off_panels(tracer, point, origin),
            clearance: CLEARANCE * tracer.lift_height(point.position),
        };
        let unoccluded: Vec<f32> = (self.panels.iter())
            .map(|panel| panel.irradiance(receiver.origin, point.normal))
            .collect();
        let total: f32 = unoccluded.iter().sum();
        let mut sum = Vec3::ZERO;
        for (panel, &irradiance) in self.panels.iter().zip(&unoccluded) {
            if irradiance > 0.0 {
                let visible = if irradiance > PI * LARGE_PANEL {
                    self.visible_of_large(panel, tracer, &receiver)
                } else {
                    self.visible_of_small(panel, tracer, &receiver, irradiance / total)
                };
                sum += panel.emission * irradiance * visible;
            }
        }
        sum + self
            .sampled
            .irradiance(shader, tracer, point, receiver.origin)
    }

    /// A receiver on the edge of a panel lies in its plane, where its irradiance jumps: it is seen from the front side.
    fn off_panels(&self, tracer: &Tracer, point: &ShadePoint, origin: Vec3) -> Vec3 {
        let height = tracer.lift_height(point.position);
        self.panels.iter().fold(origin, |origin, panel| {
            let distance = panel.distance(origin);
            let is_own = panel.normal.dot(point.geometric_normal).abs() > 0.999;
            if distance.abs() < height && !is_own {
                origin + panel.normal * (height - distance)
            } else {
                origin
            }
        })
    }

    fn visible_of_large(&self, panel: &Panel, tracer: &Tracer, receiver: &Receiver<'_>) -> f32 {
        let frame = Frame::about(receiver.point.normal);
        let rays = self.hemisphere.iter().map(|&local| {
            let direction = frame.to_world(local);
            let distance = panel.hit(receiver.origin, direction)?;
            Some((direction, distance, 1.0))
        });
        receiver.visible_share(panel, tracer, rays)
    }

    fn visible_of_small(
        &self,
        panel: &Panel,
        tracer: &Tracer,
        receiver: &Receiver<'_>,
        share: f32,
    ) -> f32 {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "a part of the samples"
        )]
        let count =
            ((share * self.squares.len() as f32) as usize).clamp(16, self.squares.len().max(16));
        let rays = self.squares.iter().take(count).map(|&square| {
            let offset = panel.place(square) - receiver.origin;
            let squared = offset.length_squared();
            let direction = offset.try_normalize()?;
            let cosines = receiver.point.normal.dot(direction).max(0.0)
                * -panel.normal.dot(direction).min(0.0);
            (cosines > 0.0).then(|| (direction, squared.sqrt(), cosines / squared))
        });
        receiver.visible_share(panel, tracer, rays)
    }
}

struct Receiver<'a> {
    point: &'a ShadePoint,
    origin: Vec3,
    clearance: f32,
}

impl Receiver<'_> {
    /// Weighted share of unblocked rays (direction, distance, weight), a quarter of them if these agree.
    fn visible_share(
        &self,
        panel: &Panel,
        tracer: &Tracer,
        rays: impl ExactSizeIterator<Item = Option<(Vec3, f32, f32)>>,
    ) -> f32 {
        let quarter = rays.len().div_ceil(4);
        let (mut all, mut lit, mut blocked) = (0.0, 0.0, 0.0);
        for (index, ray) in rays.enumerate() {
            if index == quarter && all > 0.0 && (lit == 0.0 || blocked == 0.0) {
                break;
            }
            let Some((direction, distance, weight)) = ray else {
                continue;
            };
            all += weight;
            if self.is_visible(panel, tracer, direction, distance) {
                lit += weight;
            } else {
                blocked += weight;
            }
        }
        if all > 0.0 { lit / all } else { 0.0 }
    }

    fn is_visible(&self, panel: &Panel, tracer: &Tracer, direction: Vec3, distance: f32) -> bool {
        if self.point.geometric_normal.dot(direction) <= 0.0 {
            return false;
        }
        let slope = -panel.normal.dot(direction);
        let end =
            end_before(distance).min(distance - self.clearance / slope.max(f32::MIN_POSITIVE));
        end <= 0.0 || !tracer.occluded(self.origin, direction, end)
    }
}

/// All triangles that emit, in order of prims and triangles.
fn emissive_triangles(shader: &Shader<'_>) -> Vec<EmissiveTriangle> {
    let scene = shader.scene();
    let mut all = Vec::new();
    for (prim, index) in scene.prims.iter().zip(0..) {
        let id = PrimId(index);
        let is_mirrored = prim.world_from_object.matrix3.determinant() < 0.0;
        let mesh = scene.mesh_of(prim);
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
            let emission = shader.surface(&centroid).emission;
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

fn has_constant_emission(scene: &Scene, prim: PrimId, t: usize) -> bool {
    let prim = &scene.prims[prim.index()];
    let face = scene.mesh_of(prim).triangle_faces[t];
    (prim.materials.of_face(face)).is_some_and(|id| {
        matches!(
            scene.materials[id.index()].emissive_color,
            Input::Constant(_)
        )
    })
}

/// Unit normal on the front side; zero without area.
pub(super) fn front_normal(corners: &[Vec3; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    (b - a).cross(c - a).normalize_or_zero()
}
