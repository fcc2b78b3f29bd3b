//! Textured emissive surfaces: cosine-weighted rays that meet them, and points picked by power,
//! combined by the balance heuristic (Veach 1997, §9.2).

use super::emitters::EmissiveTriangle;
use super::panels::barycentrics;
use super::stand::Stand;
use crate::math::{Frame, luminance};
use crate::scene::Scene;
use crate::shading::{Shader, SurfacePoint};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, PI};

/// Fraction of the golden ratio: an additive third dimension to pick triangles with.
pub(super) const GOLDEN: f32 = 0.618_034;

/// A triangle to be sampled.
#[derive(Debug, Clone, Copy)]
struct Source {
    prim: crate::scene::PrimId,
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
        let found: Vec<Option<Found>> = self.hemisphere_hits(&view, hemisphere);
        if let Some(irradiance) = surrounded(&found) {
            return irradiance;
        }
        let (by_ray, by_area) = counts(hemisphere, squares);
        let mut sum = Vec3::ZERO;
        for found in found.iter().flatten() {
            // density of either kind per solid angle
            let ray = by_ray * found.cosine * FRAC_1_PI;
            let area = by_area * found.density * found.squared / found.leaving;
            sum += found.emission * (found.cosine / (ray + area));
        }
        for (&square, pick) in squares.iter().zip(0_u16..) {
            if let Some(found) = self.area_sample(&view, square, (f32::from(pick) * GOLDEN).fract())
            {
                let ray = by_ray * found.cosine * FRAC_1_PI;
                let area = by_area * found.density * found.squared / found.leaving;
                sum += found.emission * (found.cosine / (ray + area));
            }
        }
        sum
    }

    fn hemisphere_hits(&self, view: &View<'_>, hemisphere: &[Vec3]) -> Vec<Option<Found>> {
        let frame = Frame::about(view.stand.point.normal);
        (hemisphere.iter())
            .map(|&local| {
                let direction = frame.to_world(local);
                let start = view.stand.start(direction)?;
                let hit = (view.stand.tracer).closest(start, direction, f32::INFINITY)?;
                let density = *self.densities[hit.prim.index()].get(hit.triangle as usize)?;
                if !hit.front || density <= 0.0 {
                    return None;
                }
                let normal = view.world_normal(hit.prim, hit.triangle);
                Some(Found {
                    emission: view.emission(hit.prim, hit.triangle, (hit.u, hit.v)),
                    cosine: local.z,
                    leaving: normal.dot(direction).abs().max(f32::MIN_POSITIVE),
                    squared: hit.distance * hit.distance,
                    density,
                })
            })
            .collect()
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
        let is_facing = cosine > 0.0 && leaving > 0.0;
        if !is_facing || !view.stand.sees(place, direction) {
            return None;
        }
        let weights = if source.is_mirrored { (v, u) } else { (u, v) };
        Some(Found {
            emission: view.emission(source.prim, source.triangle, weights),
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

/// A sample that sees emission.
struct Found {
    emission: Vec3,
    /// At the receiver.
    cosine: f32,
    /// Cosine at the emitter.
    leaving: f32,
    /// Squared distance.
    squared: f32,
    /// Of picking this point, per area.
    density: f32,
}

impl View<'_> {
    fn emission(&self, prim: crate::scene::PrimId, triangle: u32, (u, v): (f32, f32)) -> Vec3 {
        let surface = SurfacePoint {
            prim,
            triangle,
            u,
            v,
            footprint: 0.0,
        };
        self.shader.surface(&surface).emission
    }

    fn world_normal(&self, prim: crate::scene::PrimId, triangle: u32) -> Vec3 {
        let scene = self.shader.scene();
        let prim = &scene.prims[prim.index()];
        let [a, b, c] = (scene.mesh_of(prim).corners(triangle as usize))
            .map(|p| prim.world_from_object.transform_point3(p));
        (b - a).cross(c - a).normalize_or_zero()
    }
}

#[expect(clippy::cast_precision_loss, reason = "a few hundred samples")]
fn counts(hemisphere: &[Vec3], squares: &[Vec2]) -> (f32, f32) {
    (hemisphere.len() as f32, squares.len() as f32)
}

/// If every ray meets the same radiance, that is all there is.
fn surrounded(found: &[Option<Found>]) -> Option<Vec3> {
    let first = found.first()?.as_ref()?.emission;
    (found.iter())
        .all(|found| found.as_ref().is_some_and(|found| found.emission == first))
        .then_some(PI * first)
}
