//! Native instances unfolded, transforms, visibility and purpose inherited: every prim once for each time it occurs.

use super::super::ReadSettings;
use super::super::raw::RawStage;
use crate::diagnostics::Diagnostics;
use crate::scene::{PrimSource, Purpose};
use glam::DMat4;

/// One occurrence of a prim on the flattened stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Occurrence {
    /// Index into `RawStage::prims`. For a native instance: the instance prim itself (its prototype root adds no
    /// occurrence of its own; the prototype's children follow as children of the instance).
    pub prim: usize,
    /// Occurrence index of the parent.
    pub parent: Option<usize>,
    /// Stage path (instance-proxy path below instances).
    pub path: String,
    /// Absolute world transform, column vectors.
    pub world_from_local: DMat4,
    /// Inherited visibility.
    pub visible: bool,
    /// Inherited purpose.
    pub purpose: Purpose,
    /// Where it comes from (never `PointInstance` here).
    pub source: PrimSource,
}

/// Flatten `raw`. Subtrees of `PointInstancer` prims are included like any other (the geometry pass decides that
/// prototypes below an instancer are not drawn by themselves); invisible prims are included with `visible = false`.
pub fn flatten(
    raw: &RawStage,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Vec<Occurrence> {
    let _ = (raw, settings, diagnostics);
    todo!("geometry helper")
}
