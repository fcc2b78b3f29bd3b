//! Scene → [`SurfelCloud`]: dice every surface, shade every micropolygon, light it. PBGI §4.

use crate::diagnostics::{Cancelled, Diagnostics};
use crate::lighting::Lighting;
use crate::shading::Shader;
use crate::surfels::{DiceMap, SurfelCloud};
use crate::trace::Tracer;

/// How finely to dice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BakeSettings {
    /// Edge length of a micropolygon, stage units; `None` = from `surfels`.
    pub spacing: Option<f32>,
    /// Number of surfels aimed at when no spacing is given. Every triangle has at least one.
    pub surfels: usize,
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self {
            spacing: None,
            surfels: 200_000,
        }
    }
}

/// A cloud and the way from a point on a surface to its surfel.
#[derive(Debug)]
pub struct Baked {
    /// The surfels.
    pub cloud: SurfelCloud,
    /// Which surfel covers which part of which triangle.
    pub dice: DiceMap,
}

/// Dice, shade and light the scene of `shader`.
///
/// # Errors
/// When cancelled.
pub fn bake(
    shader: &Shader<'_>,
    tracer: &Tracer,
    lighting: &Lighting,
    settings: &BakeSettings,
    diagnostics: &Diagnostics,
) -> Result<Baked, Cancelled> {
    let _ = (shader, tracer, lighting, settings, diagnostics);
    todo!("bake helper")
}
