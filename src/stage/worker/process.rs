//! A worker process: started, asked line by line, watched while it works, and never left behind.

use crate::diagnostics::{Cancelled, Diagnostics};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value as Json;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The whole worker, of parts that each use the names of those before; given to the interpreter on its command line, so
/// that no file has to be found at run time.
const PROGRAM: &str = concat!(
    include_str!("program/start.py"),
    include_str!("program/values.py"),
    include_str!("program/loader.py"),
    include_str!("program/worker.py"),
);

/// How often a waiting run looks whether it was cancelled.
const POLL: Duration = Duration::from_millis(20);

/// A process that has closed its output is dead after this time, or is ended.
const FAREWELL: Duration = Duration::from_secs(2);

/// Bytes of stderr kept to be shown when the worker fails: about one traceback.
const STDERR_KEPT: usize = 4096;

/// Why no answer came.
#[derive(Debug)]
pub(super) enum Failure {
    /// The process ended, or never spoke the protocol.
    Worker(String),
    /// The worker is well and says what is wrong with the stage (or with its imports).
    Refused(String),
    /// The user cancelled; the process was ended.
    Cancelled(Cancelled),
}

/// One line of the worker.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Reply<T> {
    Ok(T),
    Error(String),
}

/// A running worker; dropping it ends the process and waits for it.
#[derive(Debug)]
pub(super) struct Process {
    child: Child,
    requests: ChildStdin,
    replies: Receiver<Vec<u8>>,
    stderr: Arc<Mutex<VecDeque<u8>>>,
    stderr_reader: JoinHandle<()>,
}

impl Process {
    /// Start `interpreter` with the worker program. It has not answered yet: see [`Self::wait`].
    pub(super) fn start(interpreter: &Path) -> Result<Self, Failure> {
        let mut child = Command::new(interpreter)
            .args(["-c", PROGRAM])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| Failure::Worker(format!("cannot be started: {error}")))?;
        let piped = "the child was started with pipes";
        let requests = child.stdin.take().expect(piped);
        let replies = read_lines(child.stdout.take().expect(piped));
        let stderr = Arc::new(Mutex::new(VecDeque::new()));
        let stderr_reader = keep_end(child.stderr.take().expect(piped), Arc::clone(&stderr));
        Ok(Self {
            child,
            requests,
            replies,
            stderr,
            stderr_reader,
        })
    }

    /// Process id, for tests that kill it.
    pub(super) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Send `request` and wait for its answer as long as it takes; looks at `diagnostics` for cancellation.
    pub(super) fn ask<T: DeserializeOwned>(
        &mut self,
        request: &Json,
        diagnostics: &Diagnostics,
    ) -> Result<T, Failure> {
        let line = format!("{request}\n");
        let sent = self.requests.write_all(line.as_bytes());
        if sent.and_then(|()| self.requests.flush()).is_err() {
            return Err(self.ended(diagnostics));
        }
        self.wait(None, diagnostics)
    }

    /// Wait for one answer, at most `limit`; it must be `{"ok": …}` or `{"error": …}`.
    pub(super) fn wait<T: DeserializeOwned>(
        &mut self,
        limit: Option<Duration>,
        diagnostics: &Diagnostics,
    ) -> Result<T, Failure> {
        let start = Instant::now();
        loop {
            match self.replies.recv_timeout(POLL) {
                Ok(line) => return self.parse(&line),
                Err(RecvTimeoutError::Disconnected) => return Err(self.ended(diagnostics)),
                Err(RecvTimeoutError::Timeout) => {}
            }
            if let Err(cancelled) = diagnostics.check() {
                self.end();
                return Err(Failure::Cancelled(cancelled));
            }
            if limit.is_some_and(|limit| start.elapsed() > limit) {
                self.end();
                let seconds = limit.unwrap_or_default().as_secs();
                return Err(Failure::Worker(format!("gave no answer for {seconds} s")));
            }
        }
    }

    fn parse<T: DeserializeOwned>(&mut self, line: &[u8]) -> Result<T, Failure> {
        match serde_json::from_slice(line) {
            Ok(Reply::Ok(result)) => Ok(result),
            Ok(Reply::Error(message)) => Err(Failure::Refused(message)),
            Err(error) => {
                self.end();
                let start = String::from_utf8_lossy(&line[..line.len().min(80)]).into_owned();
                Err(Failure::Worker(format!(
                    "does not speak the worker's language: {error} in {start:?}"
                )))
            }
        }
    }

    /// Why there is no answer and never will be. An interrupt from a terminal ends the worker too, and that may be seen
    /// sooner than the interrupt is heard.
    fn ended(&mut self, diagnostics: &Diagnostics) -> Failure {
        let death = self.death();
        std::thread::sleep(POLL);
        match diagnostics.check() {
            Ok(()) => death,
            Err(cancelled) => Failure::Cancelled(cancelled),
        }
    }

    /// How the process ended, with the end of what it wrote to stderr.
    fn death(&mut self) -> Failure {
        let start = Instant::now();
        let mut status = None;
        while status.is_none() && start.elapsed() < FAREWELL {
            status = self.child.try_wait().ok().flatten();
            std::thread::sleep(Duration::from_millis(1));
        }
        let how = status.map_or("closed its output".to_owned(), describe);
        self.end();
        while !self.stderr_reader.is_finished() && start.elapsed() < FAREWELL {
            std::thread::sleep(Duration::from_millis(1));
        }
        let kept: Vec<u8> = self
            .stderr
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .iter()
            .copied()
            .collect();
        let said = String::from_utf8_lossy(&kept);
        Failure::Worker(match said.trim() {
            "" => format!("{how} without a word"),
            said => format!("{how}; the end of its stderr:\n{said}"),
        })
    }

    fn end(&mut self) {
        // Both fail only for a process that is gone already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.end();
    }
}

fn describe(status: ExitStatus) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        return format!("was killed by signal {signal}");
    }
    match status.code() {
        Some(code) => format!("ended with exit code {code}"),
        None => "ended".to_owned(),
    }
}

/// Every line of `output`, sent on as it comes; the channel closes when the output does.
fn read_lines(output: ChildStdout) -> Receiver<Vec<u8>> {
    let (sender, receiver): (Sender<Vec<u8>>, _) = channel();
    std::thread::spawn(move || {
        let mut output = BufReader::new(output);
        loop {
            let mut line = Vec::new();
            match output.read_until(b'\n', &mut line) {
                Ok(count) if count > 0 && sender.send(line).is_ok() => {}
                _ => break,
            }
        }
    });
    receiver
}

/// Read `stderr` to its end, so that the process never blocks on it, keeping the last [`STDERR_KEPT`] bytes.
fn keep_end(mut stderr: ChildStderr, kept: Arc<Mutex<VecDeque<u8>>>) -> JoinHandle<()> {
    std::thread::spawn(move || {
        let mut chunk = [0_u8; 4096];
        while let Ok(count) = stderr.read(&mut chunk) {
            if count == 0 {
                break;
            }
            let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
            kept.extend(&chunk[..count]);
            let surplus = kept.len().saturating_sub(STDERR_KEPT);
            kept.drain(..surplus);
        }
    })
}
