//! Prims composed many at a time, so that the layers they bring in are opened together.
//!
//! The crate wires all layers anew each time it opens some: opened one by one, 2000 referenced layers take seven times
//! as long as 1000. It opens those together that one question misses, and one question is about many prims: where a
//! relationship's targets lead. A relationship of the session layer's, which no file holds, asks it.

use super::layer_files::LayerFiles;
use super::sites::Sites;
use super::twins::Siblings;
use crate::diagnostics::CancelToken;
use openusd::sdf::{self, FieldKey};
use openusd::usd::Stage;

/// Prim of the session layer that asks. It is not defined, so it is no part of the stage.
pub(super) const ASKING_PRIM: &str = "/__surflux_ahead";

/// Its relationship, and the name of a property that prims are asked for: none has it.
const ASKED: &str = "surflux:ahead";

/// Layers that may be opened one by one, which is quick with few, until the rest is composed ahead.
const FEW_LAYERS: usize = 64;

/// Composes ahead of a walk, where there are many layers.
pub(super) struct Ahead<'a> {
    stage: &'a Stage,
    files: &'a LayerFiles,
    cancel: &'a CancelToken,
    /// Of instances beside each other that compose the same, the walk composes one.
    finds_twins: bool,
    loads_payloads: bool,
    /// Compose ahead when there are more layers than this.
    threshold: usize,
}

impl<'a> Ahead<'a> {
    /// For a walk over `stage`, which finds twins if that is `finds_twins`.
    pub(super) fn new(
        (stage, files): (&'a Stage, &'a LayerFiles),
        cancel: &'a CancelToken,
        (finds_twins, loads_payloads): (bool, bool),
    ) -> Self {
        Self {
            stage,
            files,
            cancel,
            finds_twins,
            loads_payloads,
            threshold: FEW_LAYERS,
        }
    }

    /// Every prim is composed, as a walk without twins does.
    pub(super) fn without_twins(self) -> Self {
        Self {
            finds_twins: false,
            ..self
        }
    }

    /// True if so many layers were opened that the rest should be opened together.
    pub(super) fn is_due(&self) -> bool {
        self.stage.layer_count() > self.threshold
    }

    /// Compose the prims at `level` and all below them, level by level. What is wrong with them is told when they are
    /// visited.
    pub(super) fn compose(&mut self, mut level: Vec<sdf::Path>) {
        while !level.is_empty() && !self.cancel.is_cancelled() {
            self.files.pulse().prims(level.len());
            if self.ask(&level).is_err() {
                break;
            }
            let below = level.iter().flat_map(|path| self.below(path));
            level = below.collect();
        }
        let count = self.stage.layer_count();
        // further ones, inside prototypes, are opened one by one only as far as that is a part of the whole
        self.threshold = count + count / 4 + FEW_LAYERS;
    }

    /// Compose the prims at `paths`.
    fn ask(&self, paths: &[sdf::Path]) -> anyhow::Result<()> {
        let Some(session) = self.stage.edit_target_session() else {
            return Ok(());
        };
        let asked = paths.iter().map(|path| path.append_property(ASKED));
        let asked: Vec<sdf::Path> = asked.collect::<Result<_, _>>()?;
        let _context = self.stage.edit_context(session)?;
        self.stage.override_prim(ASKING_PRIM)?;
        let path = sdf::Path::new(ASKING_PRIM)?.append_property(ASKED)?;
        let relationship = self.stage.create_relationship(path)?;
        relationship.set_targets(asked)?.forwarded_targets()?;
        Ok(())
    }

    /// The children of the prim at `path` that a walk will compose.
    fn below(&self, path: &sdf::Path) -> Vec<sdf::Path> {
        self.files.pulse().prim(path);
        let children = self.children(path);
        children.unwrap_or_default()
    }

    fn children(&self, path: &sdf::Path) -> anyhow::Result<Vec<sdf::Path>> {
        let prim = self.stage.prim(path.clone());
        let is_left_out = || -> anyhow::Result<bool> {
            Ok(!self.loads_payloads && !prim.is_loaded()?
                || prim.specifier()? != Some(sdf::Specifier::Def)
                || !prim.is_active()?
                || prim.is_instance()?)
        };
        if !is_prototype(path) && is_left_out()? {
            return Ok(Vec::new());
        }
        let names = prim.child_names()?;
        let children = names
            .iter()
            .filter_map(|name| path.append_path(name.as_str()).ok());
        let mut children: Vec<sdf::Path> = children.collect();
        // refuses where the descent would not end
        let sites = Sites::of(self.stage, path)?;
        let has_clips = sites.has_prim_field(self.stage, FieldKey::Clips.as_str());
        if self.finds_twins && !has_clips && children.len() > 1 {
            let mut siblings = Siblings::new(sites, self.stage);
            children.retain(|child| siblings.is_new(self.stage, child));
        }
        Ok(children)
    }
}

/// True for the root of a prototype, as the crate names it.
fn is_prototype(path: &sdf::Path) -> bool {
    let name = path.name().unwrap_or_default();
    path.prim_element_count() == 1 && name.starts_with("__Prototype_")
}
