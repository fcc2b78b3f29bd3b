//! The passes that turn a composed stage into a [`Scene`], the same for both doors.

pub mod flatten;
pub mod geometry;
pub mod look;

use super::raw::RawStage;
use super::{Error, ReadSettings};
use crate::diagnostics::Diagnostics;
use crate::scene::Scene;

/// Resolve `raw` into a scene.
///
/// # Errors
/// Meshes with invalid topology.
pub fn scene(
    raw: &RawStage,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Result<Scene, Error> {
    let _ = (raw, settings, diagnostics);
    todo!("geometry helper: flatten, look::resolve, geometry")
}
