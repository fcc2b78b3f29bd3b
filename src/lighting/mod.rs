//! Light that comes straight from its source: UsdLux lights, the environment, emissive surfaces; with ray-traced
//! shadows and without noise.

mod cells;
mod emitters;
mod environment;
mod form_factor;
mod latlong;
mod lights;
mod panels;
mod pattern;
mod sampled;
mod shape;
mod shaping;

use crate::diagnostics::Diagnostics;
use crate::shading::Shader;
use crate::trace::Tracer;
use emitters::Emitters;
use environment::Environment;
use glam::Vec3;
use lights::{AreaLight, Patterns};

/// A point that receives light on one side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShadePoint {
    /// World position relative to the scene's origin, on the surface (it is lifted here where needed).
    pub position: Vec3,
    /// Unit shading normal.
    pub normal: Vec3,
    /// Unit normal of the plane it lies on, same side as `normal`.
    pub geometric_normal: Vec3,
}

/// How finely extended lights are sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LightSamples {
    /// Shadow rays to each extended light in penumbrae (a quarter decides whether it is one).
    pub per_light: u32,
    /// Rays to emissive surfaces.
    pub emissive: u32,
    /// World-fixed directions that sample a textured environment.
    pub environment: u32,
}

impl Default for LightSamples {
    fn default() -> Self {
        Self {
            per_light: 256,
            emissive: 256,
            environment: 512,
        }
    }
}

impl LightSamples {
    /// For surfels: their error averages out over many.
    pub const SURFEL: Self = Self {
        per_light: 16,
        emissive: 64,
        environment: 128,
    };
}

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
    lights: Vec<AreaLight>,
    patterns: Patterns,
    environment: Environment,
    emitters: Emitters,
}

impl Lighting {
    /// Prepare the scene's lights and emissive surfaces; textures are read here (missing ones are warnings).
    pub fn new(shader: &Shader<'_>, samples: LightSamples, diagnostics: &Diagnostics) -> Self {
        let lights = &shader.scene().lights;
        Self {
            lights: (lights.iter())
                .filter_map(|light| AreaLight::new(light, diagnostics))
                .collect(),
            patterns: Patterns::new(samples.per_light),
            environment: Environment::new(lights, samples, diagnostics),
            emitters: Emitters::new(shader, samples),
        }
    }

    /// Irradiance from all UsdLux lights but domes: closed form where unshadowed, times the ray-traced visible part.
    pub fn lights(&self, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        let origin = tracer.lift(point.position, point.geometric_normal);
        (self.lights.iter())
            .map(|light| light.irradiance(tracer, &self.patterns, point, origin))
            .sum()
    }

    /// Irradiance from dome lights along unblocked directions; exact when nothing blocks.
    pub fn environment(&self, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        let origin = tracer.lift(point.position, point.geometric_normal);
        self.environment.irradiance(tracer, point, origin)
    }

    /// Radiance of the environment from unit `direction` (towards the sky), summed over domes.
    pub fn environment_radiance(&self, direction: Vec3) -> Vec3 {
        self.environment.radiance(direction)
    }

    /// The environment's radiance if it is the same in all directions (then irradiance = π · L · visibility); black
    /// without domes.
    pub fn uniform_environment(&self) -> Option<Vec3> {
        self.environment.uniform
    }

    /// True if there are dome lights that are not black.
    pub fn has_environment(&self) -> bool {
        self.environment.is_lit()
    }

    /// True if nothing shines: no light that is not black, no environment, no emissive surface.
    pub fn is_dark(&self) -> bool {
        self.lights.is_empty() && !self.has_environment() && !self.has_emitters()
    }

    /// True if some surface emits.
    pub fn has_emitters(&self) -> bool {
        !self.emitters.is_empty()
    }

    /// Irradiance from emissive surfaces, complete: plane ones in closed form times their visible part, all others by
    /// hemisphere and area samples combined by the balance heuristic.
    pub fn emitters(&self, shader: &Shader<'_>, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        if self.emitters.is_empty() {
            return Vec3::ZERO;
        }
        let origin = tracer.lift(point.position, point.geometric_normal);
        self.emitters.irradiance(shader, tracer, point, origin)
    }
}

#[cfg(test)]
mod tests;
