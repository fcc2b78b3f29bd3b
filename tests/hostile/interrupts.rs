//! Ctrl-C in every phase and through both doors, and workers that die: the run ends with a message, and nothing of it
//! stays behind.

use super::program::{ROOM, files, stderr};
use super::trial::surflux_by;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// An interrupted run must end in this time, on a loaded machine too.
const PATIENCE: Duration = Duration::from_secs(30);

/// A run in a process group of its own, as a terminal has it, with its temporary files in `folder`/tmp.
struct Run {
    child: Child,
    folder: TempDir,
}

impl Run {
    fn start(folder: TempDir, mut command: Command) -> Self {
        let temporary = folder.path().join("tmp");
        fs::create_dir(&temporary).expect("made");
        let child = command
            .args(["--progress", "json"])
            .env("TMPDIR", temporary)
            .process_group(0)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        Self { child, folder }
    }

    /// Read stderr until `phase` begins; what came until then.
    fn reach(&mut self, phase: &str) -> String {
        let mut said = String::new();
        let stderr = self.child.stderr.as_mut().expect("piped");
        // One byte at a time: whatever a buffer had taken in advance would be lost to `end`.
        let mut reader = BufReader::with_capacity(1, stderr);
        let wanted = format!("\"phase\":\"{phase}\"");
        while reader.read_line(&mut said).expect("readable") > 0 {
            if said.contains(&wanted) {
                return said;
            }
        }
        panic!("{phase} was never reached: {said}");
    }

    /// Ctrl-C as a terminal sends it: to the whole group.
    fn interrupt(&self) {
        signal("-INT", &format!("-{}", self.child.id()));
    }

    /// Processes that it started and that still run.
    fn children(&self) -> Vec<u32> {
        let path = format!("/proc/{0}/task/{0}/children", self.child.id());
        let list = fs::read_to_string(path).unwrap_or_default();
        list.split_whitespace()
            .map(|id| id.parse().expect("a process id"))
            .collect()
    }

    /// Wait for the end: cancelled or done, no temporary file left.
    fn ends_either_way(mut self) -> TempDir {
        let output = {
            let status = self.child.wait().expect("ended");
            let mut said = String::new();
            let mut rest = self.child.stderr.take().expect("piped");
            rest.read_to_string(&mut said).expect("text");
            (status.code(), said)
        };
        let cancelled = output.0 == Some(1) && output.1.contains("cancelled");
        assert!(cancelled || output.0 == Some(0), "{output:?}");
        let left = files(self.folder.path());
        assert_eq!(left.iter().find(|name| name.starts_with('.')), None);
        self.folder
    }

    /// Wait for the end: exit code 1, `word` in the message, no file, no process of `children` left.
    fn ends_with(self, word: &str, children: &[u32]) {
        let folder = self.ends(word, children);
        let left = files(folder.path());
        let output = left.iter().find(|name| name.starts_with("out"));
        assert_eq!(output, None);
    }

    /// Wait for the end: exit code 1, `word` in the message, no temporary file, no process of `children` left.
    fn ends(mut self, word: &str, children: &[u32]) -> TempDir {
        let start = Instant::now();
        while self.child.try_wait().expect("waitable").is_none() {
            if start.elapsed() > PATIENCE {
                signal("-KILL", &format!("-{}", self.child.id()));
                panic!("no end after {PATIENCE:?}");
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let mut said = String::new();
        let mut rest = self.child.stderr.take().expect("piped");
        rest.read_to_string(&mut said).expect("text");
        let status = self.child.wait().expect("ended");
        assert_eq!(status.code(), Some(1), "{said}");
        assert!(said.contains(word), "no {word:?} in: {said}");
        assert!(!said.contains("panicked"), "{said}");
        assert!(
            children.iter().all(|id| !is_alive(*id)),
            "an orphan is left"
        );
        let left = files(self.folder.path());
        assert_eq!(left.iter().find(|name| name.starts_with('.')), None);
        assert_eq!(files(&self.folder.path().join("tmp")), Vec::<String>::new());
        self.folder
    }
}

fn signal(name: &str, process: &str) {
    let status = Command::new("kill").args([name, "--", process]).status();
    assert!(status.expect("kill runs").success());
}

fn is_alive(process: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let state = stat.rsplit(')').next().unwrap_or_default();
    !state.is_empty() && !state.trim_start().starts_with('Z')
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

/// A bake of the room that would take minutes.
fn long_bake(folder: &Path, door: &str, engine: &str) -> Command {
    let mut command = surflux_by(door, "bake");
    command.args([ROOM, "-o"]).arg(folder.join("out.usdc"));
    command.args(["--rays", "1048576", "--gather", engine]);
    command.args(["--max-solid-angle", "0.0001"]);
    command
}

#[test]
fn an_interrupted_gather_ends_by_both_doors_and_engines() {
    for (door, engine) in [
        ("native", "rays"),
        ("native", "paper"),
        ("usd-core", "rays"),
    ] {
        let folder = folder();
        let command = long_bake(folder.path(), door, engine);
        let mut run = Run::start(folder, command);
        run.reach("gather");
        let children = run.children();
        run.interrupt();
        run.ends_with("cancelled", &children);
    }
}

#[test]
fn an_interrupted_dicing_ends_by_both_doors() {
    for door in ["native", "usd-core"] {
        let folder = folder();
        let mut command = surflux_by(door, "points");
        command.args([ROOM, "--surfels", "5000000", "-o"]);
        command.arg(folder.path().join("out.usdc"));
        let mut run = Run::start(folder, command);
        run.reach("points");
        let children = run.children();
        run.interrupt();
        run.ends_with("cancelled", &children);
    }
}

/// A stage of one grid of `cells`² quads.
fn grid(folder: &Path, cells: usize) -> PathBuf {
    let side = cells + 1;
    let points: Vec<String> = (0..side * side)
        .map(|i| format!("({},0,{})", i % side, i / side))
        .collect();
    let corners = (0..cells).flat_map(|z| (0..cells).map(move |x| z * side + x));
    let corners: Vec<String> = corners
        .map(|i| format!("{},{},{},{}", i, i + side, i + side + 1, i + 1))
        .collect();
    let text = format!(
        "#usda 1.0\ndef Mesh \"grid\"\n{{\npoint3f[] points = [{}]\nint[] faceVertexCounts = [{}]\nint[] faceVertexIndices = [{}]\nuniform token subdivisionScheme = \"none\"\n}}\n",
        points.join(","),
        vec!["4"; cells * cells].join(","),
        corners.join(",")
    );
    let path = folder.join("grid.usda");
    fs::write(&path, text).expect("written");
    path
}

#[test]
fn an_interrupted_read_ends_by_the_native_door() {
    let folder = folder();
    let mut command = surflux_by("native", "bake");
    command.arg(grid(folder.path(), 500)).arg("-o");
    command.arg(folder.path().join("out.usdc"));
    let mut run = Run::start(folder, command);
    run.reach("read");
    run.interrupt();
    run.ends_with("cancelled", &[]);
}

#[test]
fn an_interrupted_write_leaves_a_whole_file_or_none() {
    for extension in ["usda", "usdc"] {
        let folder = folder();
        let mut command = surflux_by("native", "bake");
        command.arg(grid(folder.path(), 400)).arg("-o");
        let output = folder.path().join("out").with_extension(extension);
        command.arg(&output).args(["--aov", "N,P,primId"]);
        command.args(["--display-color", "none"]);
        let mut run = Run::start(folder, command);
        run.reach("write");
        run.interrupt();
        // The file may be complete before the interrupt arrives: then the run is a success.
        let _folder = run.ends_either_way();
        if output.exists() {
            let read = surflux_by("native", "info").arg(&output).output();
            let read = read.expect("the program starts");
            assert!(read.status.success(), "{}", stderr(&read));
        }
    }
}

/// Python that stops for a minute where `when` says, leaving a file `reached` behind.
fn stopping(folder: &Path, when: &str) -> PathBuf {
    let reached = folder.join("reached");
    let patch = format!(
        "import sys, time\ndef stop():\n    open({reached:?}, 'w').close()\n    time.sleep(60)\n{when}\n"
    );
    fs::write(folder.join("sitecustomize.py"), patch).expect("written");
    reached
}

const IMPORTING: &str = "if 'WORKER' in str(sys.orig_argv) or 'Read USD stages for surflux' in str(sys.orig_argv): stop()";

const OPENING: &str = "from pxr import Sdf
Sdf.Layer.FindOrOpen = lambda *a: stop()";

const LOADING: &str = "from pxr import Usd
Usd.Stage.OpenMasked = lambda *a: stop()";

/// A run whose worker has stopped at `when`, and its processes.
fn stopped(when: &str) -> (Run, Vec<u32>) {
    let folder = folder();
    let reached = stopping(folder.path(), when);
    let mut command = surflux_by("usd-core", "bake");
    command.env("PYTHONPATH", folder.path());
    command
        .args([ROOM, "-o"])
        .arg(folder.path().join("out.usdc"));
    let run = Run::start(folder, command);
    let start = Instant::now();
    while !reached.exists() {
        assert!(start.elapsed() < PATIENCE, "the worker never got there");
        std::thread::sleep(Duration::from_millis(5));
    }
    let children = run.children();
    assert!(!children.is_empty(), "the worker is a child");
    (run, children)
}

#[test]
fn an_interrupted_worker_ends_with_the_run() {
    for when in [IMPORTING, OPENING, LOADING] {
        let (run, children) = stopped(when);
        run.interrupt();
        run.ends_with("cancelled", &children);
    }
}

#[test]
fn a_worker_that_is_killed_is_an_error_that_says_so() {
    for when in [IMPORTING, OPENING, LOADING] {
        let (run, children) = stopped(when);
        for child in &children {
            signal("-KILL", &child.to_string());
        }
        run.ends_with("killed by signal 9", &children);
    }
}

#[test]
fn a_worker_outlives_no_run_that_was_killed() {
    let folder = folder();
    let mut run = Run::start(folder, {
        let mut command = surflux_by("usd-core", "points");
        command.args([ROOM, "--surfels", "5000000", "-o", "out.usdc"]);
        command
    });
    run.reach("points");
    let children = run.children();
    run.child.kill().expect("killed");
    run.child.wait().expect("ended");
    let start = Instant::now();
    while children.iter().any(|id| is_alive(*id)) {
        assert!(start.elapsed() < PATIENCE, "the worker lives on");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(stderr_is_quiet(&mut run), "a traceback for nobody");
}

/// Nothing like a traceback came after the end.
fn stderr_is_quiet(run: &mut Run) -> bool {
    let mut said = String::new();
    let mut rest = run.child.stderr.take().expect("piped");
    rest.read_to_string(&mut said).is_ok() && !said.contains("Traceback")
}

/// True once the process handles interrupts itself.
fn handles_interrupts(process: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    let mask = caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 0b10 != 0)
}

/// A stage that nobody writes into the pipe never opens: nothing looks at the first interrupt.
#[test]
fn a_second_interrupt_ends_what_does_not_listen() {
    let folder = folder();
    let stage = folder.path().join("pipe.usda");
    let made = Command::new("mkfifo").arg(&stage).status();
    assert!(made.expect("mkfifo runs").success());
    let mut command = surflux_by("native", "bake");
    command.arg(&stage).arg("-o");
    command.arg(folder.path().join("out.usdc"));
    let mut run = Run::start(folder, command);
    let start = Instant::now();
    while !handles_interrupts(run.child.id()) {
        assert!(start.elapsed() < PATIENCE, "it never got there");
        std::thread::sleep(Duration::from_millis(5));
    }
    run.interrupt();
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(run.child.try_wait().expect("waitable"), None);
    run.interrupt();
    run.ends_with("", &[]);
}
