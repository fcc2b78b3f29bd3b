//! Light that comes straight from its source: UsdLux lights, the environment, emissive surfaces; with ray-traced
//! shadows and without noise.

use crate::diagnostics::Diagnostics;
use crate::shading::Shader;
use crate::trace::Tracer;
use glam::Vec3;

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

/// All sources of a scene, prepared for sampling.
#[derive(Debug)]
pub struct Lighting {}

impl Lighting {
    /// Prepare the scene's lights and emissive surfaces; textures are read here (missing ones are warnings).
    pub fn new(shader: &Shader<'_>, samples: LightSamples, diagnostics: &Diagnostics) -> Self {
        let _ = (shader, samples, diagnostics);
        todo!("lighting helper")
    }

    /// Irradiance from all UsdLux lights but domes: closed form where unshadowed, times the ray-traced visible part.
    pub fn lights(&self, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        let _ = (tracer, point);
        todo!("lighting helper")
    }

    /// Irradiance from dome lights along unblocked directions; exact when nothing blocks.
    pub fn environment(&self, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        let _ = (tracer, point);
        todo!("lighting helper")
    }

    /// Radiance of the environment from unit `direction` (towards the sky), summed over domes.
    pub fn environment_radiance(&self, direction: Vec3) -> Vec3 {
        let _ = direction;
        todo!("lighting helper")
    }

    /// The environment's radiance if it is the same in all directions (then irradiance = π · L · visibility).
    pub fn uniform_environment(&self) -> Option<Vec3> {
        todo!("lighting helper")
    }

    /// True if there are dome lights that are not black.
    pub fn has_environment(&self) -> bool {
        todo!("lighting helper")
    }

    /// True if some surface emits.
    pub fn has_emitters(&self) -> bool {
        todo!("lighting helper")
    }

    /// Irradiance from emissive surfaces, complete: hemisphere and area samples combined by the balance heuristic.
    pub fn emitters(&self, shader: &Shader<'_>, tracer: &Tracer, point: &ShadePoint) -> Vec3 {
        let _ = (shader, tracer, point);
        todo!("lighting helper")
    }
}
