//! The native door: a USD file → [`RawStage`] with the `openusd` crate, no Python.
//!
//! Composition (which layers and prims there are) is the crate's; values are resolved here, site by site, because the
//! crate lets time samples of a weak layer win over the default of a strong one. What the crate reads wrongly without
//! saying so is repaired (`text`) or refused; what it cannot read is an error that names the layer.

mod ahead;
mod arc_cycles;
mod child_table;
mod class_cycles;
mod complaints;
mod convert;
mod crate_check;
mod crate_values;
mod instance_key;
mod interpolate;
mod kept;
mod layer_assets;
mod layer_files;
mod list_ops;
mod long_arrays;
mod properties;
mod pulse;
mod session;
mod sites;
mod specs;
mod text;
mod traverse;
mod twin_keys;
mod twins;

use super::raw::{RawStage, Request};
use super::{Error, Source};
use crate::diagnostics::{CancelToken, Cancelled, Diagnostics, Warning};
use pulse::Pulse;
use session::Session;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

/// What to try when this door cannot read a stage; ends every refusal.
const OTHER_DOOR: &str = "`--usd usd-core` may read it";

/// Name of the thread that holds the stage.
pub const THREAD_NAME: &str = "openusd";

/// Stack of the thread that holds the stage, bytes: the crate recurses with the depth of prims and arcs. It is
/// reserved address space, touched only as far as it is used.
pub(super) const STACK_BYTES: usize = 1 << 30;

/// How long after a cancellation the thread is waited for; it looks at the token between prims.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// A stage opened with the `openusd` crate. It lives in a thread of its own (the crate's stage cannot be sent between
/// threads and recurses deeply) that ends when this is dropped. Where the crate does not come to an end, orders fail, and
/// the thread is left behind: it ends with the process.
#[derive(Debug)]
pub struct NativeSource {
    path: PathBuf,
    jobs: Sender<Job>,
    /// Several loads will come that differ in time only.
    keeps: bool,
    pulse: Arc<Pulse>,
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
        Self::open_until(path, &CancelToken::default())
    }

    /// Open the root layer at `path`, unless `cancel` comes before.
    ///
    /// # Errors
    /// See [`Self::open`]; cancellation.
    pub fn open_until(path: &Path, cancel: &CancelToken) -> Result<Self, Error> {
        std::fs::File::open(path).map_err(|source| Error::Unreadable {
            path: path.to_owned(),
            source,
        })?;
        let (jobs, orders) = mpsc::channel();
        let root = path.to_owned();
        let pulse = Arc::new(Pulse::default());
        let of_thread = Arc::clone(&pulse);
        thread::Builder::new()
            .name(THREAD_NAME.to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || serve(&root, &orders, &of_thread))
            .map_err(|source| Error::Unreadable {
                path: path.to_owned(),
                source,
            })?;
        let source = Self {
            path: path.to_owned(),
            jobs,
            keeps: false,
            pulse,
        };
        source.order(None, cancel.clone())?;
        Ok(source)
    }

    fn order(&self, request: Option<Request>, cancel: CancelToken) -> Outcome {
        let (reply, answer) = mpsc::channel();
        let job = Job {
            request,
            keeps: self.keeps,
            cancel: cancel.clone(),
            reply,
        };
        if self.pulse.is_lost() {
            return Err(self.failed("the native reader was given up"));
        }
        let ended = || self.failed("the native reader's thread ended");
        self.jobs.send(job).map_err(|_| ended())?;
        let mut watch = self.pulse.watch();
        let mut cancelled: Option<Instant> = None;
        loop {
            match answer.recv_timeout(pulse::EVERY) {
                Ok(outcome) => return outcome,
                Err(RecvTimeoutError::Disconnected) => return Err(ended()),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if cancel.is_cancelled()
                && cancelled.get_or_insert_with(Instant::now).elapsed() > LAST_WORDS
            {
                self.pulse.give_up();
                return Err(Cancelled.into());
            }
            if let Some(what) = watch.judge() {
                self.pulse.give_up();
                return Err(self.failed(&what));
            }
        }
    }

    fn failed(&self, what: &str) -> Error {
        Error::Layer {
            path: self.path.clone(),
            message: format!("{what}; {OTHER_DOOR}"),
        }
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

fn serve(root: &Path, orders: &Receiver<Job>, pulse: &Arc<Pulse>) {
    pulse.is_of_this_thread();
    let mut session = Session::new(root, pulse);
    while let Ok(job) = orders.recv() {
        pulse.prims(1);
        let outcome = match &job.request {
            None => session.open().map(|()| (RawStage::default(), Vec::new())),
            Some(request) => session.load(request, job.keeps, &job.cancel),
        };
        // a dropped receiver means the asker is gone: nobody is left to tell
        let _ = job.reply.send(outcome);
    }
}
