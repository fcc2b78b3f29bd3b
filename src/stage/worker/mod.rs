//! The usd-core door: a persistent Python process that reads the stage with Pixar's USD, answers in JSON lines and
//! hands arrays over in one flat memory-mapped file a load.

use super::raw::{RawStage, Request};
use super::{Error, Source};
use crate::diagnostics::Diagnostics;
use std::path::Path;

/// A stage opened in a usd-core worker process; the process ends when this is dropped.
#[derive(Debug)]
pub struct WorkerSource {}

impl WorkerSource {
    /// True if an interpreter that can import `pxr` and `numpy` is found (`SURFLUX_USD_PYTHON`, else
    /// `.venv/bin/python`, else `python3`).
    pub fn available() -> bool {
        todo!("worker helper")
    }

    /// Start a worker and open the stage at `path` in it.
    ///
    /// # Errors
    /// When no interpreter can import `pxr`, or the stage cannot be opened.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let _ = path;
        todo!("worker helper")
    }
}

impl Source for WorkerSource {
    fn load(&mut self, request: &Request, diagnostics: &Diagnostics) -> Result<RawStage, Error> {
        let _ = (request, diagnostics);
        todo!("worker helper")
    }

    fn name(&self) -> &'static str {
        "usd-core"
    }
}
