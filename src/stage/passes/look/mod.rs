//! Materials and their bindings, lights, cameras, render settings.

use super::super::ReadSettings;
use super::super::raw::RawStage;
use super::flatten::Occurrence;
use crate::diagnostics::Diagnostics;
use crate::scene::{Camera, Light, Material, MaterialId, RenderSettings};
use glam::DVec3;

/// Everything of a stage that is not geometry.
#[derive(Debug, Clone, Default)]
pub struct Look {
    /// Materials that some prim binds, in order of first use.
    pub materials: Vec<Material>,
    /// For each occurrence, the material that applies to it (meaningful for gprims and GeomSubsets: the strongest of
    /// direct, inherited and collection bindings, purposes `full` then all-purpose).
    pub binding: Vec<Option<MaterialId>>,
    /// Visible lights.
    pub lights: Vec<Light>,
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// Render settings, the stage's own choice first.
    pub render_settings: Vec<RenderSettings>,
    /// Names of primvars (without prefix) that the bound materials read, sorted; always includes `displayColor` and
    /// `displayOpacity` when materials are wanted.
    pub primvars: Vec<String>,
}

/// Resolve the look of the flattened stage. `origin` is subtracted from light transforms.
pub fn resolve(
    raw: &RawStage,
    occurrences: &[Occurrence],
    origin: DVec3,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Look {
    let _ = (raw, occurrences, origin, settings, diagnostics);
    todo!("look helper")
}
