//! The built program, run as a user runs it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The example of the repository: a room with gprims, a point instancer, a lamp and a camera.
pub(crate) const ROOM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/room.usda");

/// The program, deaf to the settings of the person who runs the tests.
pub(crate) fn surflux() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_surflux"));
    command
        .env_remove("SURFLUX_USD")
        .env_remove("SURFLUX_THREADS");
    command
}

/// What the program says to `args`.
pub(crate) fn run<A: AsRef<std::ffi::OsStr>>(args: &[A]) -> Output {
    surflux().args(args).output().expect("the program starts")
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The JSON on stdout of a run that must have succeeded.
pub(crate) fn json(output: &Output) -> serde_json::Value {
    assert!(output.status.success(), "{}", stderr(output));
    serde_json::from_slice(&output.stdout).expect("stdout is JSON")
}

/// A stage file with `text` in a folder of its own.
pub(crate) fn stage(text: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("stage.usda");
    fs::write(&path, text).expect("writable");
    (folder, path)
}

/// Names in `folder`, sorted.
pub(crate) fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("readable");
    let mut names: Vec<String> = entries
        .map(|entry| {
            let name = entry.expect("entry").file_name();
            name.to_string_lossy().into_owned()
        })
        .collect();
    names.sort();
    names
}
