//! Material and textures at a point of a surface: albedo and emission, averaged over a footprint.

use crate::diagnostics::Diagnostics;
use crate::scene::{PrimId, Scene};
use glam::Vec3;

/// A point on a prim's triangle, with the size of the area it stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The prim.
    pub prim: PrimId,
    /// Triangle of the prim's mesh.
    pub triangle: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2.
    pub v: f32,
    /// Edge length, in world units, of the square to average textures over; 0 = point-sampled at full resolution.
    pub footprint: f32,
}

/// What a surface does with light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Diffuse albedo, clamped to 0…1: `diffuseColor · (1 − metallic)` (all of it in the specular workflow), times opacity.
    pub albedo: Vec3,
    /// Emitted radiance of the front side, ≥ 0, finite.
    pub emission: Vec3,
    /// 0…1 after the cut-out threshold.
    pub opacity: f32,
}

/// Evaluates materials of a scene; textures are decoded once.
#[derive(Debug)]
pub struct Shader<'a> {
    scene: &'a Scene,
}

impl<'a> Shader<'a> {
    /// Decode the textures that the scene's prims use. Missing or broken files become warnings naming file and
    /// material, and their reads give the fallback value.
    pub fn new(scene: &'a Scene, diagnostics: &Diagnostics) -> Self {
        let _ = diagnostics;
        Self { scene }
    }

    /// The scene it shades.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// The surface at `point`. Prims without material: `displayColor`, else 0.18 gray.
    pub fn surface(&self, point: &SurfacePoint) -> Surface {
        let _ = point;
        todo!("look helper")
    }

    /// True if triangle `triangle` of `prim` may emit (its material's emission is not constantly black).
    pub fn may_emit(&self, prim: PrimId, triangle: u32) -> bool {
        let _ = (prim, triangle);
        todo!("look helper")
    }
}
