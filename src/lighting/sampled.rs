//! Textured emissive surfaces: cosine-weighted rays that meet them, and points picked by power,
//! combined by the balance heuristic (Veach 1997, §9.2).

use super::emitters::EmissiveTriangle;
use super::panels::barycentrics;
use super::stand::Stand;
use crate::math::{Frame, luminance};
use crate::scene::{PrimId, Scene};
use crate::shading::{Shader, SurfacePoint};
use crate::trace::Hit;
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI, SQRT_2};

/// Fraction of the golden ratio: an additive third dimension to pick triangles with.
pub(super) const GOLDEN: f32 = 0.618_034;

/// A triangle to be sampled.
#[derive(Debug, Clone, Copy)]
struct Source {
    prim: PrimId,
    triangle: u32,
    corners: [Vec3; 3],
    is_mirrored: bool,
    /// Running sum of the pick probabilities, ending with 1.
    cumulative: f32,
}

/// Emissive triangles that are no panels.
#[derive(Debug)]
pub(super) struct SampledEmitters {
    sources: Vec<Source>,
    /// Pick density (per area) of every triangle of a prim, 0 where it does not emit; empty for other prims.
    densities: Vec<Vec<f32>>,
}

impl SampledEmitters {
    /// Cost O(n).
    pub(super) fn new(scene: &Scene, triangles: &[EmissiveTriangle]) -> Self {
        // textured triangles may shine where their centroid is black
        let mean = triangles.iter().map(|t| luminance(t.emission)).sum::<f32>();
        #[expect(clippy::cast_precision_loss, reason = "a count")]
        let floor = 0.05 * mean / triangles.len().max(1) as f32;
        let power = |t: &EmissiveTriangle| {
            let bright = luminance(t.emission);
            f64::from(t.area)
                * f64::from(if t.is_constant {
                    bright
                } else {
                    bright.max(floor)
                })
        };
        let total: f64 = triangles.iter().map(power).sum();
        let mut densities: Vec<Vec<f32>> = vec![Vec::new(); scene.prims.len()];
        let mut sources = Vec::new();
        let mut sum = 0.0;
        for triangle in triangles {
            let share = power(triangle) / total;
            if share.is_nan() || share <= 0.0 {
                continue;
            }
            sum += share;
            let prim = &scene.prims[triangle.prim.index()];
            let list = &mut densities[triangle.prim.index()];
            list.resize(scene.mesh_of(prim).triangles.len(), 0.0);
            #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
            let (density, cumulative) = ((share / f64::from(triangle.area)) as f32, sum as f32);
            list[triangle.triangle as usize] = density;
            sources.push(Source {
                prim: triangle.prim,
                triangle: triangle.triangle,
                corners: triangle.corners,
                is_mirrored: prim.world_from_object.matrix3.determinant() < 0.0,
                cumulative,
            });
        }
        Self { sources, densities }
    }

    /// True if there is nothing to sample.
    pub(super) fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }

    /// Irradiance by both kinds of samples.
    pub(super) fn irradiance(
        &self,
        shader: &Shader<'_>,
        stand: &Stand<'_>,
        (hemisphere, squares): (&[Vec3], &[Vec2]),
    ) -> Vec3 {
        let view = View { shader, stand };
        let found = self.hemisphere_hits(&view, hemisphere);
        if let Some(irradiance) = surrounded(&view, &found, hemisphere.len()) {
            return irradiance;
        }
        let (by_ray, by_area) = counts(hemisphere, squares);
        let mut sum = Vec3::ZERO;
        let view = &view;
        for found in &found {
            sum += found.light(view, (by_ray, by_area));
        }
        for (&square, pick) in squares.iter().zip(0_u16..) {
            let pick = (f32::from(pick) * GOLDEN).fract();
            if let Some(found) = self.area_sample(view, square, pick) {
                sum += found.light(view, (by_ray, by_area));
            }
        }
        sum
    }

    /// All emission that the rays along `hemisphere` meet, several times along one where they pass screens.
    fn hemisphere_hits(&self, view: &View<'_>, hemisphere: &[Vec3]) -> Vec<Found> {
        let frame = Frame::about(view.stand.point.normal);
        let tracer = view.stand.tracer;
        let (mut all, mut layers) = (Vec::new(), Vec::new());
        for &local in hemisphere {
            let direction = frame.to_world(local);
            let Some(start) = view.stand.start(direction) else {
                continue;
            };
            let mut see = |hit: Hit, open: f32| {
                all.extend(self.found(view, &hit, (direction, local.z, open)));
            };
            let solid = tracer.solid_closest(start, direction, f32::INFINITY);
            let end = solid.map_or(f32::INFINITY, |hit| hit.distance);
            let open = tracer.layers_and_holes((start, direction), end, &mut layers);
            let mut before = 1.0;
            for layer in &layers {
                see(layer.hit, before);
                before *= 1.0 - layer.opacity;
            }
            if let Some(hit) = solid.filter(|_| open > 0.0) {
                see(hit, open);
            }
        }
        all
    }

    /// What a ray along a direction at a cosine to the normal meets, of which the part `open` is seen.
    fn found(
        &self,
        view: &View<'_>,
        hit: &Hit,
        (direction, cosine, open): (Vec3, f32, f32),
    ) -> Option<Found> {
        let density = *self.densities[hit.prim.index()].get(hit.triangle as usize)?;
        if !hit.front || density <= 0.0 {
            return None;
        }
        let corners = view.corners(hit.prim, hit.triangle);
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        Some(Found {
            place: (hit.prim, hit.triangle, (hit.u, hit.v)),
            corners,
            open,
            cosine,
            leaving: normal.dot(direction).abs().max(f32::MIN_POSITIVE),
            squared: hit.distance * hit.distance,
            density,
        })
    }

    fn area_sample(&self, view: &View<'_>, square: Vec2, pick: f32) -> Option<Found> {
        let last = self.sources.len() - 1;
        let index = self
            .sources
            .partition_point(|source| source.cumulative <= pick)
            .min(last);
        let source = &self.sources[index];
        let (u, v) = barycentrics(square);
        let [a, b, c] = source.corners;
        let offset = a * (1.0 - u - v) + b * u + c * v - view.stand.origin;
        let squared = offset.length_squared();
        let direction = offset.try_normalize()?;
        let cosine = view.stand.point.normal.dot(direction);
        let leaving = -(b - a).cross(c - a).normalize_or_zero().dot(direction);
        let place = view.stand.origin + offset;
        if cosine <= 0.0 || leaving <= 0.0 {
            return None;
        }
        let open = view.stand.sees(place, direction);
        if open <= 0.0 {
            return None;
        }
        let weights = if source.is_mirrored { (v, u) } else { (u, v) };
        Some(Found {
            place: (source.prim, source.triangle, weights),
            corners: view.corners(source.prim, source.triangle),
            open,
            cosine,
            leaving,
            squared,
            density: self.densities[source.prim.index()][source.triangle as usize],
        })
    }
}

struct View<'a> {
    shader: &'a Shader<'a>,
    stand: &'a Stand<'a>,
}

/// A sample that meets an emitter.
struct Found {
    place: (PrimId, u32, (f32, f32)),
    /// Of its triangle, world space.
    corners: [Vec3; 3],
    /// Part of its light that comes through what is before it.
    open: f32,
    /// At the receiver.
    cosine: f32,
    /// Cosine at the emitter.
    leaving: f32,
    /// Squared distance.
    squared: f32,
    /// Of picking this point, per area.
    density: f32,
}

impl Found {
    /// What it adds to the irradiance, where so many rays and points are tried.
    fn light(&self, view: &View<'_>, (by_ray, by_area): (f32, f32)) -> Vec3 {
        // density of either kind per solid angle
        let ray = by_ray * self.cosine * FRAC_1_PI;
        let area = by_area * self.density * self.squared / self.leaving;
        let on_surface = (ray + area) * self.leaving / self.squared;
        self.emission(view, on_surface) * (self.cosine / (ray + area))
    }

    /// What is emitted towards the receiver, averaged over the surface that the sample stands for where there are so many
    /// per area, as far as it lies on its triangle.
    fn emission(&self, view: &View<'_>, density: f32) -> Vec3 {
        let (prim, triangle, (u, v)) = self.place;
        let [a, b, c] = self.corners;
        let twice = (b - a).cross(c - a).length();
        let edges = [(c - b, 1.0 - u - v), (c - a, u), (b - a, v)];
        let inside = edges
            .map(|(edge, weight)| twice * weight / edge.length())
            .into_iter()
            .fold(f32::INFINITY, f32::min);
        let surface = view.shader.surface(&SurfacePoint {
            prim,
            triangle,
            u,
            v,
            footprint: density.recip().sqrt().min(SQRT_2 * inside.max(0.0)),
        });
        surface.emission * (surface.opacity * self.open)
    }
}

impl View<'_> {
    fn corners(&self, prim: PrimId, triangle: u32) -> [Vec3; 3] {
        let scene = self.shader.scene();
        let prim = &scene.prims[prim.index()];
        let corners = scene.mesh_of(prim).corners(triangle as usize);
        corners.map(|p| prim.world_from_object.transform_point3(p))
    }
}

#[expect(clippy::cast_precision_loss, reason = "a few hundred samples")]
fn counts(hemisphere: &[Vec3], squares: &[Vec2]) -> (f32, f32) {
    (hemisphere.len() as f32, squares.len() as f32)
}

/// If every one of `rays` rays meets the same radiance, that is all there is.
fn surrounded(view: &View<'_>, found: &[Found], rays: usize) -> Option<Vec3> {
    let sharp = |found: &Found| found.emission(view, f32::INFINITY);
    if found.len() != rays {
        return None;
    }
    let first = sharp(found.first()?);
    let is_all = found.iter().all(|found| sharp(found) == first);
    is_all.then_some(PI * first)
}
