//! Octree or scene × [`Receivers`] → [`Results`]. PBGI §6.
//!
//! An [`Engine`] fills a [`Hemisphere`] for every receiver; the quantities read AOVs off it.

pub mod paper;
pub mod traverse;

use crate::diagnostics::{Cancelled, Diagnostics};
use crate::lighting::Lighting;
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use crate::shading::Shader;
use crate::trace::Tracer;
use glam::Vec3;
use std::fmt::Debug;
use std::ops::Range;

/// What one receiver sees: directions that share its hemisphere.
#[derive(Debug, Clone, Default)]
pub struct Hemisphere {
    /// Unit world directions from the receiver.
    pub direction: Vec<Vec3>,
    /// Cosine-weighted solid angle of each, sr; all sum to π.
    pub weight: Vec<f32>,
    /// How much of it is covered by surfaces, 0…1 (rays: 0 or 1).
    pub coverage: Vec<f32>,
    /// Distance to what covers it, `INFINITY` where nothing does.
    pub distance: Vec<f32>,
    /// Reflected radiance (without emission) that arrives from what covers it, already times `coverage`.
    pub reflected: Vec<Vec3>,
    /// Emitted radiance that arrives from what covers it, already times `coverage`.
    pub emitted: Vec<Vec3>,
}

impl Hemisphere {
    /// Forget all directions, keep the memory.
    pub fn clear(&mut self) {
        self.direction.clear();
        self.weight.clear();
        self.coverage.clear();
        self.distance.clear();
        self.reflected.clear();
        self.emitted.clear();
    }
}

/// How receivers see the scene.
pub trait Engine: Sync + Debug {
    /// Fill a hemisphere for each receiver of `block` in turn and hand it to `visit` with the receiver's index.
    /// `scratch` is reused between blocks of one thread.
    fn see(
        &self,
        receivers: &Receivers,
        block: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    );

    /// `rays`, `paper`, …
    fn name(&self) -> &'static str;
}

/// What a gather works with.
#[derive(Debug, Clone, Copy)]
pub struct GatherScene<'a> {
    /// Materials.
    pub shader: &'a Shader<'a>,
    /// Rays.
    pub tracer: &'a Tracer,
    /// Sources; `None` when no AOV asks for light.
    pub lighting: Option<&'a Lighting>,
}

/// Compute `aovs` at every receiver.
///
/// # Errors
/// When cancelled.
pub fn gather(
    scene: GatherScene<'_>,
    engine: &dyn Engine,
    receivers: &Receivers,
    aovs: &[Aov],
    diagnostics: &Diagnostics,
) -> Result<Results, Cancelled> {
    let _ = (scene, engine, receivers, aovs, diagnostics);
    todo!("gather helper")
}
