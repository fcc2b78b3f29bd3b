//! What a run tells while it works: warnings (collected, never printed here), progress and cancellation.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// One flaw of the user's data that still allowed a sensible result.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub struct Warning {
    /// Stable slug to group and filter by: `unsupported-prim`, `missing-texture`, …
    pub kind: String,
    /// Path of the prim concerned, or of the file when there is no prim; may be empty.
    pub prim: String,
    /// What is wrong and what follows from it for the result.
    pub message: String,
}

/// Set by Ctrl-C or by the host program; looked at between blocks of work.
#[derive(Debug, Clone, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    /// Ask the run to end; it does so at the next block of work, leaving no partial file.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// True once [`Self::cancel`] was called.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// The run was cancelled by the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// Receives progress; implemented by the command line (bar, plain lines, JSON, `OpenJD`).
pub trait ProgressSink: Send + Sync {
    /// A phase (`read`, `points`, `octree`, `gather`, `write`) begins; `total` units of `unit` are to be done, 0 = unknown.
    fn begin(&self, phase: &str, unit: &str, total: u64);
    /// `done` of the phase's units are finished. Called from any thread, at most a few thousand times a phase.
    fn advance(&self, done: u64);
    /// The phase ended.
    fn end(&self);
}

/// Shows nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl ProgressSink for Silent {
    fn begin(&self, _phase: &str, _unit: &str, _total: u64) {}
    fn advance(&self, _done: u64) {}
    fn end(&self) {}
}

/// Warnings, progress and cancellation of one run; shared by reference between steps and threads.
pub struct Diagnostics {
    warnings: Mutex<BTreeSet<Warning>>,
    progress: Box<dyn ProgressSink>,
    cancel: CancelToken,
}

impl fmt::Debug for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Diagnostics")
            .field("warnings", &self.warnings)
            .finish_non_exhaustive()
    }
}

impl Default for Diagnostics {
    fn default() -> Self {
        Self::new(Box::new(Silent), CancelToken::default())
    }
}

impl Diagnostics {
    /// Diagnostics that report progress to `progress` and listen to `cancel`.
    pub fn new(progress: Box<dyn ProgressSink>, cancel: CancelToken) -> Self {
        Self {
            warnings: Mutex::default(),
            progress,
            cancel,
        }
    }

    /// Record a warning. An identical one (kind, prim and message) is kept once.
    pub fn warn(&self, kind: &str, prim: impl Into<String>, message: impl Into<String>) {
        let warning = Warning {
            kind: kind.to_owned(),
            prim: prim.into(),
            message: message.into(),
        };
        self.warnings
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(warning);
    }

    /// All warnings so far, sorted by kind, prim and message: the same order for any thread count.
    pub fn warnings(&self) -> Vec<Warning> {
        self.warnings
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .iter()
            .cloned()
            .collect()
    }

    /// Begin a phase of `total` units (0 = unknown); it ends when the returned guard is dropped.
    pub fn phase(&self, phase: &str, unit: &str, total: u64) -> Phase<'_> {
        self.progress.begin(phase, unit, total);
        Phase {
            diagnostics: self,
            done: AtomicU64::new(0),
        }
    }

    /// # Errors
    /// [`Cancelled`] once the user asked the run to end.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.cancel.is_cancelled() {
            Err(Cancelled)
        } else {
            Ok(())
        }
    }

    /// The token this run listens to.
    pub fn cancel_token(&self) -> &CancelToken {
        &self.cancel
    }
}

/// A running phase; dropping it ends the phase.
pub struct Phase<'a> {
    diagnostics: &'a Diagnostics,
    done: AtomicU64,
}

impl fmt::Debug for Phase<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Phase")
            .field("done", &self.done)
            .finish_non_exhaustive()
    }
}

impl Phase<'_> {
    /// `count` more units are finished; callable from any thread.
    pub fn advance(&self, count: u64) {
        let done = self.done.fetch_add(count, Ordering::Relaxed) + count;
        self.diagnostics.progress.advance(done);
    }
}

impl Drop for Phase<'_> {
    fn drop(&mut self) {
        self.diagnostics.progress.end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identical_warnings_are_kept_once_and_come_sorted() {
        let diagnostics = Diagnostics::default();
        diagnostics.warn("b", "/x", "m");
        diagnostics.warn("a", "/x", "m");
        diagnostics.warn("b", "/x", "m");
        let kinds: Vec<_> = diagnostics.warnings().into_iter().map(|w| w.kind).collect();
        assert_eq!(kinds, ["a", "b"]);
    }

    #[test]
    fn a_cancelled_token_fails_the_check() {
        let diagnostics = Diagnostics::default();
        assert!(diagnostics.check().is_ok());
        diagnostics.cancel_token().cancel();
        assert_eq!(diagnostics.check(), Err(Cancelled));
    }
}
