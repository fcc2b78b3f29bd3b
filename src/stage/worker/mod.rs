//! The usd-core door: a persistent Python process that reads the stage with Pixar's USD, answers in JSON lines and
//! hands arrays over in one flat memory-mapped file a load.
//!
//! `program/` (Python) does all traversal, so that a load is one message whatever the size of the stage. What USD warns of
//! while it composes comes back with the answer and becomes warnings of kind `usd`.

mod array_file;
mod index;
mod interpreter;
mod process;

use super::composition::{self, ChoiceOutcome};
use super::raw::{RawStage, Request};
use super::{Composition, Error, Load, Source, UsdVerdict};
use crate::diagnostics::Diagnostics;
use array_file::ArrayFile;
use index::{Arrays, Index};
use process::{Failure, Process};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;
use tempfile::TempDir;

/// Time a worker may take until it has imported USD, plug-ins and all.
const START_LIMIT: Duration = Duration::from_secs(120);

/// What can be done when no worker runs.
const REMEDY: &str =
    "set SURFLUX_USD_PYTHON to a Python with usd-core and numpy, or read with --usd native";

/// A stage opened in a usd-core worker process; the process ends when this is dropped.
#[derive(Debug)]
pub struct WorkerSource {
    path: PathBuf,
    interpreter: PathBuf,
    process: Process,
    /// Where the worker may leave its file of arrays, best first; removed with this source.
    scratch: Vec<TempDir>,
    /// Several loads will come that differ in time only.
    keeps: bool,
    /// Arrays of the first of them.
    kept: Option<ArrayFile>,
}

/// The Python that workers run in: `SURFLUX_USD_PYTHON`, else `.venv/bin/python` in the current folder, else the one
/// beside this program, else `python3`.
pub fn python() -> PathBuf {
    interpreter::find()
}

impl WorkerSource {
    /// True if [`python`] can import `pxr` and `numpy`. Found out once a process, by starting it (0.2 s).
    pub fn available() -> bool {
        static AVAILABLE: OnceLock<bool> = OnceLock::new();
        *AVAILABLE.get_or_init(|| interpreter::can_import(&interpreter::find()))
    }

    /// Start a worker and open the root layer at `path` in it; the stage is composed by the first load, which knows
    /// the population mask.
    ///
    /// # Errors
    /// When no interpreter can import `pxr`, or the root layer is missing or cannot be parsed; cancellation.
    pub fn open(path: &Path, diagnostics: &Diagnostics) -> Result<Self, Error> {
        Self::open_with(&interpreter::find(), path, diagnostics)
    }

    /// [`Self::open`] with the Python at `interpreter`.
    ///
    /// # Errors
    /// See [`Self::open`].
    pub fn open_with(
        interpreter: &Path,
        path: &Path,
        diagnostics: &Diagnostics,
    ) -> Result<Self, Error> {
        check_readable(path)?;
        let scratch = scratch_folders().map_err(|error| unable(interpreter, error.to_string()))?;
        let mut source = Self {
            path: path.to_owned(),
            interpreter: interpreter.to_owned(),
            process: started(interpreter, diagnostics)?,
            scratch,
            keeps: false,
            kept: None,
        };
        let folders: Vec<_> = source.scratch.iter().map(TempDir::path).collect();
        let request = json!({"open": path, "scratch": folders});
        let opened: Result<serde_json::Value, Failure> = source.process.ask(&request, diagnostics);
        match opened {
            Ok(_) => Ok(source),
            Err(failure) => Err(source.error(failure)),
        }
    }

    /// Id of the worker process.
    pub fn process_id(&self) -> u32 {
        self.process.id()
    }

    fn error(&self, failure: Failure) -> Error {
        match failure {
            Failure::Refused(message) => Error::Layer {
                path: self.path.clone(),
                message,
            },
            Failure::Worker(message) => self.worker_error(message),
            Failure::Cancelled(cancelled) => cancelled.into(),
        }
    }

    fn worker_error(&self, message: String) -> Error {
        Error::Worker {
            interpreter: self.interpreter.display().to_string(),
            message,
        }
    }

    fn stage_of(&mut self, index: Index) -> Result<RawStage, String> {
        let path = &index.arrays;
        let is_fresh = index.fresh;
        let is_read_again = is_fresh && self.keeps;
        let file = match path.as_os_str().is_empty() {
            true => None,
            false => Some(
                ArrayFile::open_and_remove(path, is_read_again)
                    .map_err(|error| format!("cannot open {}: {error}", path.display()))?,
            ),
        };
        let arrays = Arrays {
            new: file.as_ref(),
            kept: self.kept.as_ref(),
        };
        let stage = index.into_stage(&self.path, arrays)?;
        if is_fresh {
            self.kept = file.filter(|_| self.keeps);
        }
        Ok(stage)
    }
}

impl Source for WorkerSource {
    fn load(&mut self, request: &Request, diagnostics: &Diagnostics) -> Result<RawStage, Error> {
        let message = json!({"load": {
            "time": request.time,
            "mask": request.mask,
            "attributes": request.attributes,
            "values_not_needed": request.values_not_needed,
            "composition": spelled(&request.composition),
            "keep": self.keeps,
        }});
        let index: Index = self
            .process
            .ask(&message, diagnostics)
            .map_err(|failure| self.error(failure))?;
        for warning in index
            .warnings
            .iter()
            .filter(|warning| !is_of_materialx(warning))
        {
            let (prim, message) = clean(warning);
            diagnostics.warn("usd", prim, message);
        }
        let outcomes = index.variants.iter().map(outcome);
        let choices = request.composition.variants.iter();
        let warnings = composition::judge(choices.zip(outcomes));
        let refused = |message| self.error(Failure::Refused(message));
        for (prim, message) in warnings.map_err(refused)? {
            diagnostics.warn("variant-choice", prim, message);
        }
        self.stage_of(index)
            .map_err(|problem| self.worker_error(problem))
    }

    fn name(&self) -> &'static str {
        "usd-core"
    }

    fn validate(&mut self, diagnostics: &Diagnostics) -> Result<Option<UsdVerdict>, Error> {
        let asked = self.process.ask(&json!({"validate": {}}), diagnostics);
        asked.map(Some).map_err(|failure| self.error(failure))
    }

    fn expect_loads(&mut self, count: usize) {
        self.keeps = count > 1;
    }

    fn peak_memory_bytes(&self) -> Option<u64> {
        super::process_peak_memory(self.process_id())
    }
}

/// `composition` as the worker takes it.
fn spelled(composition: &Composition) -> serde_json::Value {
    let choices = composition.variants.iter();
    let choices = choices.map(|choice| [&choice.prim, &choice.set, &choice.choice]);
    json!({
        "load": match composition.load {
            Load::All => "all",
            Load::None => "none",
        },
        "variants": choices.collect::<Vec<_>>(),
        "session": composition.session_layer,
        "muted": composition.muted_layers,
    })
}

/// What the worker says of a variant choice.
fn outcome((kind, names): &(String, Vec<String>)) -> ChoiceOutcome {
    match kind.as_str() {
        "prim" => ChoiceOutcome::NoPrim,
        "set" => ChoiceOutcome::NoSet(names.clone()),
        "variant" => ChoiceOutcome::NoVariant(names.clone()),
        "instance" => ChoiceOutcome::BelowInstance,
        _ => ChoiceOutcome::Applied,
    }
}

/// A worker that has imported USD and waits for requests.
fn started(interpreter: &Path, diagnostics: &Diagnostics) -> Result<Process, Error> {
    let failed = |failure| match failure {
        Failure::Worker(message) | Failure::Refused(message) => unable(interpreter, message),
        Failure::Cancelled(cancelled) => cancelled.into(),
    };
    let mut process = Process::start(interpreter).map_err(failed)?;
    let hello: serde_json::Value = process
        .wait(Some(START_LIMIT), diagnostics)
        .map_err(failed)?;
    log::debug!("worker {}: {hello}", interpreter.display());
    Ok(process)
}

/// The error for a worker that never came to work.
fn unable(interpreter: &Path, message: String) -> Error {
    Error::Worker {
        interpreter: interpreter.display().to_string(),
        message: format!("{message}; {REMEDY}"),
    }
}

/// A path that the operating system knows must be readable; others (resolver URIs, files in packages) are USD's business.
fn check_readable(path: &Path) -> Result<(), Error> {
    let text = path.to_string_lossy();
    if text.contains("://") || text.contains('[') {
        return Ok(());
    }
    match std::fs::File::open(path) {
        Ok(_) => Ok(()),
        Err(source) => Err(Error::Unreadable {
            path: path.to_owned(),
            source,
        }),
    }
}

/// Memory-backed where the system has it (arrays never touch a disk), then the temporary folder.
fn scratch_folders() -> std::io::Result<Vec<TempDir>> {
    let new = |parent: &Path| {
        tempfile::Builder::new()
            .prefix("surflux-")
            .tempdir_in(parent)
    };
    let mut folders: Vec<TempDir> = new(Path::new("/dev/shm")).into_iter().collect();
    folders.push(new(&std::env::temp_dir())?);
    Ok(folders)
}

/// True where USD lacks the plug-in for a MaterialX document: its materials are read without it, and what cannot be
/// read is reported there.
fn is_of_materialx(warning: &str) -> bool {
    warning.contains(".mtlx") && warning.contains("Cannot determine file format")
}

/// A warning of USD split into the prim it is about (empty if it names none) and its text on one line, without the
/// addresses of objects and the note which stage was being made, which say nothing to a user.
fn clean(warning: &str) -> (String, String) {
    let text = warning.split_whitespace().collect::<Vec<_>>().join(" ");
    let text = text
        .split(" (instantiating stage on")
        .next()
        .unwrap_or_default();
    let text = text
        .split(" (recomposing stage on")
        .next()
        .unwrap_or_default();
    let prim = text
        .split_once("</")
        .and_then(|(_, rest)| rest.split_once('>'))
        .map_or(String::new(), |(path, _)| format!("/{path}"));
    (prim, text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_composition_warning_is_told_by_prim_and_without_addresses() {
        let (prim, text) = clean(
            "In </W/m>: Could not open asset @missing.usd@ for payload introduced by @a.usda@</W/m>. \
             (instantiating stage on stage @a.usda@ <0x55d0c8>)",
        );
        assert_eq!(prim, "/W/m");
        assert_eq!(
            text,
            "In </W/m>: Could not open asset @missing.usd@ for payload introduced by @a.usda@</W/m>."
        );
    }

    #[test]
    fn a_warning_without_a_prim_has_none() {
        assert_eq!(
            clean("out of\n luck"),
            (String::new(), "out of luck".to_owned())
        );
    }
}
