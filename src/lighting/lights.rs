//! UsdLux lights other than domes, prepared for shading: irradiance = unshadowed irradiance × visible fraction.

use super::latlong::Picture;
use super::pattern;
use super::shape::{Ellipsoid, LightSample, Shape};
use super::shaping::WorldShaping;
use super::{ShadePoint, end_before};
use crate::diagnostics::Diagnostics;
use crate::scene::{Light, LightKind};
use crate::trace::Tracer;
use glam::{Affine3A, Vec2, Vec3};

/// Samples of an unshadowed irradiance without a closed form; they cost no rays.
const UNSHADOWED_SAMPLES: u32 = 256;

/// A light in world space.
#[derive(Debug)]
pub(super) struct AreaLight {
    shape: Shape,
    /// After `normalize`.
    radiance: Vec3,
    shaping: Option<WorldShaping>,
    texture: Option<Picture>,
    casts_shadows: bool,
}

/// Patterns shared by all lights.
#[derive(Debug)]
pub(super) struct Patterns {
    shadow: Vec<Vec2>,
    unshadowed: Vec<Vec2>,
}

impl Patterns {
    /// `per_light` shadow rays, rounded up to a power of four.
    pub(super) fn new(per_light: u32) -> Self {
        Self {
            shadow: pattern::square(per_light),
            unshadowed: pattern::square(UNSHADOWED_SAMPLES),
        }
    }
}

impl AreaLight {
    /// `None` for domes and for lights that give nothing (a warning says why, except where they are simply black).
    pub(super) fn new(light: &Light, diagnostics: &Diagnostics) -> Option<Self> {
        if matches!(light.kind, LightKind::Dome { .. }) || light.radiance == Vec3::ZERO {
            return None;
        }
        let warn = |message: &str| diagnostics.warn("degenerate-light", &light.path, message);
        if !light.radiance.is_finite() || !light.world_from_light.is_finite() {
            warn("intensity or transform is not finite: the light is left out");
            return None;
        }
        let Some(shape) = shape_of(light) else {
            warn("the light's transform or size has no area: it gives no light");
            return None;
        };
        let size = shape.size_factor();
        let radiance = match (light.normalize, &shape) {
            // a point's irradiance is radiance × a quarter of its area, which cancels
            (true, Shape::Point { .. }) => light.radiance,
            (true, _) => light.radiance / size,
            (false, _) => light.radiance,
        };
        let shape = match shape {
            Shape::Point { position, .. } if light.normalize => Shape::Point {
                position,
                area: 0.25,
            },
            other => other,
        };
        if size <= 0.0 && !light.normalize || !radiance.is_finite() {
            warn("the light's size is 0 and it is not treated as a point: it gives no light");
            return None;
        }
        let axis = light.world_from_light.transform_vector3(-Vec3::Z);
        Some(Self {
            shape,
            radiance,
            shaping: (light.shaping).map(|s| WorldShaping::new(s, axis.normalize_or_zero())),
            texture: texture_of(light, diagnostics),
            casts_shadows: light.casts_shadows,
        })
    }

    /// Irradiance at `point`, shadows included; shadow rays start at `origin` (the lifted position).
    pub(super) fn irradiance(
        &self,
        tracer: &Tracer,
        patterns: &Patterns,
        point: &ShadePoint,
        origin: Vec3,
    ) -> Vec3 {
        let unshadowed = self.unshadowed(patterns, point) * self.radiance;
        if unshadowed == Vec3::ZERO {
            return Vec3::ZERO;
        }
        if matches!(self.shape, Shape::Point { .. } | Shape::Parallel { .. }) {
            let is_lit = (self.shape.sample(point, Vec2::ZERO))
                .is_some_and(|sample| self.is_visible(tracer, &sample, point, origin));
            return if is_lit { unshadowed } else { Vec3::ZERO };
        }
        unshadowed * self.visible_fraction(tracer, &patterns.shadow, point, origin)
    }

    /// For radiance 1: the closed form, or the mean of many samples; with shaping and texture.
    fn unshadowed(&self, patterns: &Patterns, point: &ShadePoint) -> Vec3 {
        let closed = self.shape.irradiance(point);
        let is_plain = self.shaping.is_none() && self.texture.is_none();
        match closed {
            Some(irradiance) if is_plain || irradiance <= 0.0 => Vec3::splat(irradiance),
            Some(irradiance)
                if matches!(self.shape, Shape::Point { .. } | Shape::Parallel { .. }) =>
            {
                let sample = self.shape.sample(point, Vec2::ZERO);
                sample.map_or(Vec3::ZERO, |s| self.factor(&s)) * irradiance
            }
            _ => {
                let (mut plain, mut colored) = (0.0, Vec3::ZERO);
                for &square in &patterns.unshadowed {
                    if let Some(sample) = self.shape.sample(point, square) {
                        plain += sample.weight;
                        colored += sample.weight * self.factor(&sample);
                    }
                }
                #[expect(clippy::cast_precision_loss, reason = "a few hundred samples")]
                let total = patterns.unshadowed.len() as f32;
                match closed {
                    Some(irradiance) if plain > 0.0 => colored * (irradiance / plain),
                    _ => colored / total,
                }
            }
        }
    }

    /// Share of the irradiance that arrives, a channel each; a quarter of the rays if these agree.
    fn visible_fraction(
        &self,
        tracer: &Tracer,
        squares: &[Vec2],
        point: &ShadePoint,
        origin: Vec3,
    ) -> Vec3 {
        let quarter = squares.len().div_ceil(4);
        let (mut all, mut lit) = (Vec3::ZERO, Vec3::ZERO);
        for (index, &square) in squares.iter().enumerate() {
            let is_unanimous = lit == Vec3::ZERO || lit == all;
            if index == quarter && is_unanimous && all != Vec3::ZERO {
                break;
            }
            let Some(sample) = self.shape.sample(point, square) else {
                continue;
            };
            let weight = sample.weight * self.factor(&sample);
            if weight == Vec3::ZERO {
                continue;
            }
            all += weight;
            if self.is_visible(tracer, &sample, point, origin) {
                lit += weight;
            }
        }
        let share = |lit: f32, all: f32| if all > 0.0 { lit / all } else { 0.0 };
        Vec3::new(
            share(lit.x, all.x),
            share(lit.y, all.y),
            share(lit.z, all.z),
        )
    }

    fn is_visible(
        &self,
        tracer: &Tracer,
        sample: &LightSample,
        point: &ShadePoint,
        origin: Vec3,
    ) -> bool {
        if point.geometric_normal.dot(sample.to_light) <= 0.0 {
            return false;
        }
        if !self.casts_shadows {
            return true;
        }
        match sample.position {
            None => !tracer.occluded(origin, sample.to_light, f32::INFINITY),
            Some(position) => {
                let offset = position - origin;
                let distance = offset.length();
                distance == 0.0 || !tracer.occluded(origin, offset / distance, end_before(distance))
            }
        }
    }

    fn factor(&self, sample: &LightSample) -> Vec3 {
        let shaping = self
            .shaping
            .map_or(Vec3::ONE, |s| s.factor(-sample.to_light));
        // UsdLuxRectLight: the texture's first texel is at +X, +Y
        let texture = self.texture.as_ref().map_or(Vec3::ONE, |texture| {
            texture.at(0.5 - 0.5 * sample.local.x, 0.5 - 0.5 * sample.local.y)
        });
        shaping * texture
    }
}

/// `None` if it has no extent where it should.
fn shape_of(light: &Light) -> Option<Shape> {
    let transform = &light.world_from_light;
    let scaled = |scale: Vec3| Ellipsoid::new(*transform * Affine3A::from_scale(scale));
    match &light.kind {
        LightKind::Dome { .. } => None,
        LightKind::Distant { angle } => {
            let to_light = transform.transform_vector3(Vec3::Z).try_normalize()?;
            let half_angle = (0.5 * angle).clamp(0.0, std::f32::consts::PI);
            Some(if half_angle > 0.0 {
                Shape::Sky {
                    to_light,
                    half_angle,
                }
            } else {
                Shape::Parallel { to_light }
            })
        }
        LightKind::Sphere {
            radius,
            treat_as_point,
        } => {
            let is_point = *treat_as_point || *radius <= 0.0;
            if is_point {
                // the mean projected area of a convex body is a quarter of its area (Cauchy)
                let area = scaled(Vec3::splat(*radius)).map_or(0.0, |body| 0.25 * body.area());
                let position = transform.transform_point3(Vec3::ZERO);
                return Some(Shape::Point { position, area });
            }
            scaled(Vec3::splat(*radius)).map(Shape::Ellipsoid)
        }
        LightKind::Rect { width, height, .. } => with_area(Shape::plane(
            transform,
            0.5 * Vec2::new(*width, *height),
            false,
        )),
        LightKind::Disk { radius } => {
            with_area(Shape::plane(transform, Vec2::splat(*radius), true))
        }
        LightKind::Cylinder { radius, length } => {
            let body = scaled(Vec3::splat(*radius))?;
            let half_length = 0.5 * length / radius;
            with_area(Shape::Tube { body, half_length })
        }
    }
}

fn with_area(shape: Shape) -> Option<Shape> {
    (shape.size_factor() > 0.0).then_some(shape)
}

fn texture_of(light: &Light, diagnostics: &Diagnostics) -> Option<Picture> {
    let LightKind::Rect {
        texture: Some(path),
        ..
    } = &light.kind
    else {
        return None;
    };
    Picture::load_or_warn(path, &light.path, diagnostics)
}
