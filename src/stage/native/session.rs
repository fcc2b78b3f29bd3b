//! The stage kept open between loads: one per population mask and composition, reopened when these change.

use super::ahead::ASKING_PRIM;
use super::complaints;
use super::kept::Kept;
use super::layer_files::{EMPTY_SESSION, LayerFiles, SharedFiles};
use super::pulse::Pulse;
use super::sites::Sites;
use super::traverse::Traversal;
use super::{OTHER_DOOR, Outcome};
use crate::diagnostics::{CancelToken, Warning};
use crate::stage::composition::{self, ChoiceOutcome};
use crate::stage::raw::{RawStage, Request};
use crate::stage::{Composition, Error, Load, VariantChoice};
use openusd::sdf::{self, FieldKey};
use openusd::usd::{InitialLoadSet, Stage, StageBuilder, StagePopulationMask};
use std::any::Any;
use std::collections::{HashMap, HashSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

/// A root layer, and its composed stage once it was opened.
pub(super) struct Session {
    root: PathBuf,
    files: Rc<LayerFiles>,
    open: Option<Open>,
}

/// A composed stage, and for what it was.
struct Open {
    mask: Vec<String>,
    composition: Composition,
    stage: Stage,
    kept: Option<Kept>,
}

impl Session {
    pub(super) fn new(root: &Path, pulse: &Arc<Pulse>) -> Self {
        Self {
            root: root.to_owned(),
            files: Rc::new(LayerFiles::new(Arc::clone(pulse))),
            open: None,
        }
    }

    /// Open the stage without a mask; layers behind references are not read yet. What is wrong with sublayers waits for
    /// the first load, which knows whether they are muted.
    ///
    /// # Errors
    /// When the root layer cannot be parsed.
    pub(super) fn open(&mut self) -> Result<(), Error> {
        self.guarded(|session| {
            let root = session.identifier();
            match session.stage(&[], &Composition::default()) {
                Err(Error::Layer { path, .. })
                    if path != Path::new(&root) && path != session.root =>
                {
                    Ok(())
                }
                other => other.map(drop),
            }
        })
    }

    /// Compose, traverse and read everything `request` asks for, or what of it an earlier load has not `kept`.
    ///
    /// # Errors
    /// See [`crate::stage::Source::load`].
    pub(super) fn load(&mut self, request: &Request, keeps: bool, cancel: &CancelToken) -> Outcome {
        self.guarded(|session| {
            let stage = session.stage(&request.mask, &request.composition)?;
            let kept = session.open.as_ref().and_then(|open| open.kept.as_ref());
            if let Some(kept) = kept.filter(|kept| kept.serves(request)) {
                return kept.at((&stage, &session.files), request, cancel);
            }
            let traversal = || Traversal::new(&stage, &session.files, request, cancel);
            let mut walked = traversal().run(&session.root)?;
            let mut errors = stage.composition_errors();
            if !errors.is_empty() && shares_prototypes(&walked.raw) {
                walked = traversal().without_twins().run(&session.root)?;
                errors = stage.composition_errors();
            }
            session.files.pulse().prims(walked.raw.prims.len());
            let choices = session.judge_choices(&stage, &request.composition.variants)?;
            walked.warnings.extend(choices);
            walked.warnings.extend(session.judge(&errors)?);
            if let Some(open) = session.open.as_mut().filter(|_| keeps) {
                open.kept = Kept::new(request, &walked);
            }
            Ok((walked.raw, walked.warnings))
        })
    }

    fn stage(&mut self, mask: &[String], composition: &Composition) -> Result<Stage, Error> {
        if let Some(open) = &self.open
            && open.mask == mask
            && open.composition == *composition
        {
            return Ok(open.stage.clone());
        }
        let builder = Stage::builder().resolver(SharedFiles(Rc::clone(&self.files)));
        let mut builder = self.composed_by(builder, composition)?;
        if !mask.is_empty() {
            builder = builder.mask(population(mask, &self.root)?);
        }
        let root = self.root.to_string_lossy();
        let unreadable = |error: anyhow::Error| self.unreadable(&format!("{error:#}"));
        if composition.session_layer.is_none() {
            self.files.expect_variables_of(&self.identifier());
        }
        let opened = builder.open(&root);
        self.files.let_go();
        let stage = opened.map_err(unreadable)?;
        choose(&stage, &composition.variants).map_err(unreadable)?;
        let errors = stage.composition_errors();
        self.judge(&errors)?;
        self.open = Some(Open {
            mask: mask.to_vec(),
            composition: composition.clone(),
            stage: stage.clone(),
            kept: None,
        });
        Ok(stage)
    }

    fn composed_by(
        &self,
        builder: StageBuilder,
        composition: &Composition,
    ) -> Result<StageBuilder, Error> {
        let root = self.identifier();
        for layer in &composition.muted_layers {
            let identifier = self.files.anchored(layer, Some(&root));
            if identifier == root {
                return Err(self.refused(&format!("the root layer {layer} cannot be muted")));
            }
            if !self.files.exists(&identifier) {
                return Err(self.refused(&format!("there is no layer {layer} to mute")));
            }
        }
        let mut builder = builder.mute(&composition.muted_layers);
        if composition.load == Load::None {
            builder = builder.load(InitialLoadSet::LoadNone);
        }
        if let Some(session) = &composition.session_layer {
            let session = session.to_string_lossy();
            if !self.files.exists(&self.files.anchored(&session, None)) {
                return Err(self.refused(&format!("there is no session layer {session}")));
            }
            builder = builder.session_layer(session);
        } else {
            // to write variant choices and questions into
            builder = builder.session_layer(EMPTY_SESSION);
        }
        Ok(builder)
    }

    /// Identifier of the root layer.
    fn identifier(&self) -> String {
        self.files.anchored(&self.root.to_string_lossy(), None)
    }

    fn refused(&self, message: &str) -> Error {
        Error::Layer {
            path: self.root.clone(),
            message: message.to_owned(),
        }
    }

    fn judge_choices(
        &self,
        stage: &Stage,
        choices: &[VariantChoice],
    ) -> Result<Vec<Warning>, Error> {
        let mut outcomes = Vec::new();
        for choice in choices {
            let outcome = outcome(stage, choice);
            outcomes.push((
                choice,
                outcome.map_err(|e| self.unreadable(&format!("{e:#}")))?,
            ));
        }
        let complaints = composition::judge(outcomes.into_iter());
        let complaints = complaints.map_err(|message| self.refused(&message))?;
        let warning = |(prim, message)| Warning {
            kind: "variant-choice".to_owned(),
            prim,
            message,
        };
        Ok(complaints.into_iter().map(warning).collect())
    }

    fn judge(&self, errors: &[openusd::pcp::Error]) -> Result<Vec<Warning>, Error> {
        let mut warnings = Vec::new();
        for error in errors {
            warnings.extend(complaints::judge(error, &self.root)?);
        }
        Ok(warnings)
    }

    /// Run `work`; a panic of the crate is an error that names the layer read last, and drops the stage.
    fn guarded<T>(&mut self, work: impl FnOnce(&mut Self) -> Result<T, Error>) -> Result<T, Error> {
        let result = catch_unwind(AssertUnwindSafe(|| work(self)));
        result.unwrap_or_else(|panic| {
            self.open = None;
            Err(self.unreadable(&format!("the reader failed: {}", panic_text(&*panic))))
        })
    }

    /// The error for a layer the crate gave up on: the last one it asked for.
    fn unreadable(&self, message: &str) -> Error {
        Error::Layer {
            path: self
                .files
                .last_opened()
                .unwrap_or_else(|| self.root.clone()),
            message: format!("{message}; {OTHER_DOOR}"),
        }
    }
}

/// True if two instances have one prototype.
fn shares_prototypes(raw: &RawStage) -> bool {
    let mut met = HashSet::new();
    let mut prototypes = raw.prims.iter().filter_map(|prim| prim.prototype);
    prototypes.any(|prototype| !met.insert(prototype))
}

/// Write `choices` into the stage's session layer, in memory.
fn choose(stage: &Stage, choices: &[VariantChoice]) -> anyhow::Result<()> {
    let Some(session) = stage.edit_target_session().filter(|_| !choices.is_empty()) else {
        return Ok(());
    };
    stage.set_edit_target(session)?;
    for choice in choices {
        let prim = stage.override_prim(choice.prim.as_str())?;
        prim.update_metadata(FieldKey::VariantSelection.as_str(), |authored| {
            let mut all = match authored {
                Some(sdf::Value::VariantSelectionMap(all)) => all,
                _ => HashMap::new(),
            };
            all.insert(choice.set.clone(), choice.choice.clone());
            sdf::Value::VariantSelectionMap(all)
        })?;
    }
    Ok(())
}

fn outcome(stage: &Stage, choice: &VariantChoice) -> anyhow::Result<ChoiceOutcome> {
    let path = sdf::Path::new(&choice.prim)?;
    let prim = stage.prim(path.clone());
    if !prim.is_defined()? || !prim.is_loaded()? {
        return Ok(ChoiceOutcome::NoPrim);
    }
    let variants = Sites::of(stage, &path)?.variants(stage);
    let Some(names) = variants.get(&choice.set) else {
        return Ok(ChoiceOutcome::NoSet(variants.into_keys().collect()));
    };
    if !names.contains(&choice.choice) {
        return Ok(ChoiceOutcome::NoVariant(names.iter().cloned().collect()));
    }
    Ok(match prim.is_instance_proxy()? {
        true => ChoiceOutcome::BelowInstance,
        false => ChoiceOutcome::Applied,
    })
}

fn population(mask: &[String], root: &Path) -> Result<StagePopulationMask, Error> {
    let mut population = StagePopulationMask::empty();
    for path in mask {
        let prim = sdf::Path::new(path).ok();
        let prim = prim.filter(|prim| prim.is_abs() && !prim.is_property_path());
        let prim = prim.ok_or_else(|| Error::Layer {
            path: root.to_owned(),
            message: format!(
                "population mask {path:?} is not an absolute prim path like /World/Hero"
            ),
        })?;
        population.add_path(prim);
    }
    population.add_path(ASKING_PRIM);
    Ok(population)
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("unknown cause")
}
