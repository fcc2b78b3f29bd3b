//! The native door: the `openusd` crate, no Python.

use super::raw::{RawStage, Request};
use super::{Error, Source};
use crate::diagnostics::Diagnostics;
use std::path::Path;

/// A stage opened with the `openusd` crate.
#[derive(Debug)]
pub struct NativeSource {}

impl NativeSource {
    /// Open the root layer at `path`.
    ///
    /// # Errors
    /// When it is missing, unreadable, or cannot be parsed.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let _ = path;
        todo!("native helper")
    }
}

impl Source for NativeSource {
    fn load(&mut self, request: &Request, diagnostics: &Diagnostics) -> Result<RawStage, Error> {
        let _ = (request, diagnostics);
        todo!("native helper")
    }

    fn name(&self) -> &'static str {
        "native"
    }
}
