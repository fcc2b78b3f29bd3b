//! The stage kept open between loads: one per population mask, reopened when the mask changes.

use super::complaints;
use super::layer_files::{LayerFiles, SharedFiles};
use super::traverse::Traversal;
use super::{OTHER_DOOR, Outcome};
use crate::diagnostics::{CancelToken, Warning};
use crate::stage::Error;
use crate::stage::raw::Request;
use openusd::usd::{Stage, StagePopulationMask};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// A root layer, and its composed stage once it was opened.
pub(super) struct Session {
    root: PathBuf,
    files: Rc<LayerFiles>,
    open: Option<(Vec<String>, Stage)>,
}

impl Session {
    pub(super) fn new(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
            files: Rc::new(LayerFiles::new()),
            open: None,
        }
    }

    /// Open the stage without a mask; layers behind references are not read yet.
    ///
    /// # Errors
    /// When the root layer or one of its sublayers cannot be parsed.
    pub(super) fn open(&mut self) -> Result<(), Error> {
        self.guarded(|session| session.stage(&[]).map(drop))
    }

    /// Compose, traverse and read everything `request` asks for.
    ///
    /// # Errors
    /// See [`crate::stage::Source::load`].
    pub(super) fn load(&mut self, request: &Request, cancel: &CancelToken) -> Outcome {
        self.guarded(|session| {
            let stage = session.stage(&request.mask)?;
            let (raw, mut warnings) =
                Traversal::new(&stage, &session.files, request, cancel).run(&session.root)?;
            let errors = stage.composition_errors();
            warnings.extend(session.judge(&errors)?);
            Ok((raw, warnings))
        })
    }

    fn stage(&mut self, mask: &[String]) -> Result<Stage, Error> {
        if let Some((of, stage)) = &self.open
            && of == mask
        {
            return Ok(stage.clone());
        }
        let mut builder = Stage::builder().resolver(SharedFiles(Rc::clone(&self.files)));
        if !mask.is_empty() {
            builder = builder.mask(population(mask, &self.root)?);
        }
        let root = self.root.to_string_lossy();
        let stage = builder
            .open(&root)
            .map_err(|error| self.unreadable(&format!("{error:#}")))?;
        let errors = stage.composition_errors();
        self.judge(&errors)?;
        self.open = Some((mask.to_vec(), stage.clone()));
        Ok(stage)
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

fn population(mask: &[String], root: &Path) -> Result<StagePopulationMask, Error> {
    let mut population = StagePopulationMask::empty();
    for path in mask {
        let prim = openusd::sdf::Path::new(path).ok();
        let prim = prim.filter(|prim| prim.is_abs() && !prim.is_property_path());
        let prim = prim.ok_or_else(|| Error::Layer {
            path: root.to_owned(),
            message: format!(
                "population mask {path:?} is not an absolute prim path like /World/Hero"
            ),
        })?;
        population.add_path(prim);
    }
    Ok(population)
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("unknown cause")
}
