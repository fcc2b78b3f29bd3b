//! Damaged files through the native door: an error or a warning, never a panic, an abort, a hang or memory without bound.
//!
//! `cargo test --test fuzz` reads for some seconds; `SURFLUX_FUZZ_SECONDS=3600 SURFLUX_FUZZ_SEED=7 cargo test --test fuzz
//! -- --nocapture` for an hour. Cases are read in a process of their own, which is started anew behind the case that it
//! did not survive; that case's folder is kept below `target/fuzz`.

#![expect(
    clippy::print_stdout,
    reason = "what is found is told while it is found"
)]

mod case;
mod corpus;
mod mutate;
mod random;
mod reader;
mod sections;

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

/// A case that takes longer than this on a busy machine will not end; [`reader::MOST_CPU`] is the limit that counts.
const PATIENCE: Duration = Duration::from_secs(30);

/// Address space of the reading process, KiB: twice the reader's 1 GiB of stack, which it does not touch, and what is
/// far more than a small file needs.
const ADDRESS_KIB: u32 = 5 << 20;

/// Seconds that `cargo test` spends here when nobody asks for more.
const USUAL_SECONDS: u64 = 10;

/// A process that reads cases, and what it says.
struct Reading {
    child: Child,
    lines: Receiver<String>,
}

impl Reading {
    fn start(seed: u64, first: u64, folder: &Path) -> Self {
        let program = std::env::current_exe().expect("the test itself");
        let limited = format!("ulimit -v {ADDRESS_KIB}; exec \"$0\" \"$@\"");
        let mut child = Command::new("sh")
            .args(["-c", &limited])
            .arg(program)
            .args(["--ignored", "--exact", "reader::reads_cases", "--nocapture"])
            .env(reader::FOLDER, folder)
            .env(reader::SEED, seed.to_string())
            .env(reader::FIRST, first.to_string())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the test starts itself");
        let stdout = BufReader::new(child.stdout.take().expect("piped"));
        let (to, lines) = channel();
        thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                if to.send(line).is_err() {
                    break;
                }
            }
        });
        Self { child, lines }
    }

    fn end(mut self) {
        // it may have ended by itself
        let _ = self.child.kill();
        self.child.wait().expect("ended");
    }
}

/// Cases read so far, and what was found.
#[derive(Debug, Default)]
struct Tally {
    next: u64,
    accepted: u64,
    found: Vec<String>,
}

impl Tally {
    fn keep(&mut self, what: &str, folder: &Path, into: &Path) {
        let label = format!("case {}: {what}", self.next);
        println!("{label}");
        let kept = into.join(self.next.to_string());
        fs::create_dir_all(&kept).expect("made");
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            // the next case may be replacing it
            let _ = fs::copy(entry.path(), kept.join(entry.file_name()));
        }
        fs::write(kept.join("finding.txt"), what).expect("written");
        self.found.push(label);
    }

    /// Follow one process until it ends, does not end a case, or `until`.
    fn follow(&mut self, reading: Reading, until: Instant, (folder, into): (&Path, &Path)) {
        let mut began = false;
        loop {
            let line = match reading.lines.recv_timeout(PATIENCE) {
                Ok(line) => line,
                Err(problem) => {
                    assert!(began, "the reading process does not start");
                    let what = match problem {
                        RecvTimeoutError::Timeout => "it does not end",
                        RecvTimeoutError::Disconnected => "the process died",
                    };
                    self.keep(what, folder, into);
                    self.next += 1;
                    return reading.end();
                }
            };
            let mut words = line.splitn(3, ' ');
            let case = (
                words.next(),
                words.next().and_then(|number| number.parse().ok()),
            );
            match case {
                (Some("begin"), Some(case)) => {
                    self.next = case;
                    began = true;
                    if Instant::now() > until {
                        return reading.end();
                    }
                }
                (Some("read"), Some(_)) => self.accepted += 1,
                (Some("found"), Some(_)) => {
                    self.keep(words.next().unwrap_or_default(), folder, into);
                }
                _ => {}
            }
        }
    }
}

fn number_in(variable: &str, usual: u64) -> u64 {
    let set = std::env::var(variable).ok();
    set.map_or(usual, |text| text.parse().expect("a whole number"))
}

#[test]
fn damaged_files_are_read_or_refused_in_bounded_time_and_memory() {
    let seconds = number_in("SURFLUX_FUZZ_SECONDS", USUAL_SECONDS);
    let seed = number_in("SURFLUX_FUZZ_SEED", 1);
    let until = Instant::now() + Duration::from_secs(seconds);
    let scratch = tempfile::tempdir().expect("a folder");
    let folder = scratch.path().join("case");
    let into = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("target/fuzz/{seed}"));
    let mut tally = Tally {
        next: number_in("SURFLUX_FUZZ_FIRST", 0),
        ..Tally::default()
    };
    while Instant::now() < until {
        let reading = Reading::start(seed, tally.next, &folder);
        tally.follow(reading, until, (&folder, &into));
    }
    println!(
        "seed {seed}: {} cases in {seconds} s, {} of them were read",
        tally.next, tally.accepted
    );
    assert!(tally.next > 0, "no case was read");
    assert!(tally.found.is_empty(), "{}", tally.found.join("\n"));
}
