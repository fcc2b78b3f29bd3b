//! Groups of sources whose light is told apart. PBGI §7.2.

use super::{PrimId, Scene};
use std::sync::Arc;

/// Name of a group, and whether a source with a stage path belongs to it.
pub type GroupRule<'a> = (Arc<str>, &'a dyn Fn(&str) -> bool);

/// Lights and emissive prims of a scene that belong together; every source is in one group of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LightGroup {
    /// What results of its light are called after: `irradiance_NAME`.
    pub name: Arc<str>,
    /// By index among the lights of the scene.
    pub lights: Vec<bool>,
    /// By [`PrimId`]: whose emission counts.
    pub prims: Vec<bool>,
}

impl LightGroup {
    /// Name of the group of all sources that are in no other.
    pub const DEFAULT: &'static str = "default";

    /// True if the emission of `prim` is part of it.
    pub fn has_prim(&self, prim: PrimId) -> bool {
        self.prims.get(prim.index()).copied().unwrap_or(false)
    }

    /// The sources of `scene` shared out: each goes to the first of `groups` that wants it, the rest to one called
    /// [`Self::DEFAULT`], which comes last.
    pub fn partition(scene: &Scene, groups: &[GroupRule<'_>]) -> Vec<Self> {
        let place = |path: &str| {
            let found = groups.iter().position(|(_, wants)| wants(path));
            found.unwrap_or(groups.len())
        };
        let lights: Vec<usize> = (scene.lights.iter())
            .map(|light| place(&light.path))
            .collect();
        let prims: Vec<usize> = scene.prims.iter().map(|prim| place(&prim.path)).collect();
        let names = groups.iter().map(|(name, _)| name.clone());
        (names.chain([Self::DEFAULT.into()]).enumerate())
            .map(|(group, name)| Self {
                name,
                lights: lights.iter().map(|&of| of == group).collect(),
                prims: prims.iter().map(|&of| of == group).collect(),
            })
            .collect()
    }
}
