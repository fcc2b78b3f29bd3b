//! The native door: a USD file → [`RawStage`] with the `openusd` crate, no Python.
//!
//! Composition (which layers and prims there are) is the crate's; values are resolved here, site by site, because the
//! crate lets time samples of a weak layer win over the default of a strong one. What the crate reads wrongly without
//! saying so is repaired (`text`) or refused; what it cannot read is an error that names the layer.

mod ahead;
mod arc_cycles;
mod class_cycles;
mod complaints;
mod convert;
mod crate_check;
mod crate_values;
mod interpolate;
mod kept;
mod layer_files;
mod package;
mod properties;
mod session;
mod text;
mod traverse;
mod twin_keys;
mod twins;

use super::raw::{RawStage, Request};
use super::{Error, Source};
use crate::diagnostics::{CancelToken, Diagnostics, Warning};
use session::Session;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;

/// What to try when this door cannot read a stage; ends every refusal.
const OTHER_DOOR: &str = "`--usd usd-core` may read it";

/// Name of the thread that holds the stage.
pub const THREAD_NAME: &str = "openusd";

/// Stack of the thread that holds the stage, bytes: the crate recurses with the depth of prims and arcs. It is
/// reserved address space, touched only as far as it is used.
pub(super) const STACK_BYTES: usize = 1 << 30;

/// A stage opened with the `openusd` crate. It lives in a thread of its own (the crate's stage cannot be sent between
/// threads and recurses deeply) that ends when this is dropped.
#[derive(Debug)]
pub struct NativeSource {
    path: PathBuf,
    jobs: Sender<Job>,
    /// Several loads will come that differ in time only.
    keeps: bool,
}

/// One order to the thread that holds the stage; `request` is `None` for "open it".
struct Job {
    request: Option<Request>,
    /// What does not vary with time is kept for further loads.
    keeps: bool,
    cancel: CancelToken,
    reply: Sender<Outcome>,
}

/// What the thread answers: the stage (empty for "open it") and the warnings met.
type Outcome = Result<(RawStage, Vec<Warning>), Error>;

impl NativeSource {
    /// Open the root layer at `path`.
    ///
    /// # Errors
    /// When it is missing, unreadable, or cannot be parsed.
    pub fn open(path: &Path) -> Result<Self, Error> {
        std::fs::File::open(path).map_err(|source| Error::Unreadable {
            path: path.to_owned(),
            source,
        })?;
        let (jobs, orders) = mpsc::channel();
        let root = path.to_owned();
        thread::Builder::new()
            .name(THREAD_NAME.to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || serve(&root, &orders))
            .map_err(|source| Error::Unreadable {
                path: path.to_owned(),
                source,
            })?;
        let source = Self {
            path: path.to_owned(),
            jobs,
            keeps: false,
        };
        source.order(None, CancelToken::default())?;
        Ok(source)
    }

    fn order(&self, request: Option<Request>, cancel: CancelToken) -> Outcome {
        let (reply, answer) = mpsc::channel();
        let job = Job {
            request,
            keeps: self.keeps,
            cancel,
            reply,
        };
        let died = || Error::Layer {
            path: self.path.clone(),
            message: format!("the native reader's thread ended; {OTHER_DOOR}"),
        };
        self.jobs.send(job).map_err(|_| died())?;
        answer.recv().map_err(|_| died())?
    }
}

impl Source for NativeSource {
    fn load(&mut self, request: &Request, diagnostics: &Diagnostics) -> Result<RawStage, Error> {
        let cancel = diagnostics.cancel_token().clone();
        let (stage, warnings) = self.order(Some(request.clone()), cancel)?;
        for warning in warnings {
            diagnostics.warn(&warning.kind, warning.prim, warning.message);
        }
        Ok(stage)
    }

    fn name(&self) -> &'static str {
        "native"
    }

    fn expect_loads(&mut self, count: usize) {
        self.keeps = count > 1;
    }
}

/// What the crate can be trusted with of a layer's `bytes`: its text, repaired; `None` if it is binary and sound.
///
/// # Errors
/// What is damaged.
pub(super) fn checked_layer(bytes: &[u8]) -> Result<Option<String>, String> {
    if bytes.starts_with(layer_files::CRATE_MAGIC) {
        return crate_check::check(bytes).map(|_| None);
    }
    let text = std::str::from_utf8(bytes).map_err(|_| "neither binary nor text USD".to_owned())?;
    let repaired = text::repaired(text)?;
    Ok(Some(repaired.unwrap_or_else(|| text.to_owned())))
}

fn serve(root: &Path, orders: &Receiver<Job>) {
    let mut session = Session::new(root);
    while let Ok(job) = orders.recv() {
        let outcome = match &job.request {
            None => session.open().map(|()| (RawStage::default(), Vec::new())),
            Some(request) => session.load(request, job.keeps, &job.cancel),
        };
        // a dropped receiver means the asker is gone: nobody is left to tell
        let _ = job.reply.send(outcome);
    }
}
