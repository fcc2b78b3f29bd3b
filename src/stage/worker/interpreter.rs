//! Which Python the worker runs in.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Names the interpreter to use; wins over everything else.
const VARIABLE: &str = "SURFLUX_USD_PYTHON";

/// An interpreter that has not imported USD after this time is taken for one that cannot.
/// Importing takes 0.2 s from a warm disk; a network disk may need some seconds.
const IMPORT_TIMEOUT: Duration = Duration::from_secs(30);

/// Imports what the worker imports, with the current folder out of the way as in `program/start.py`.
const IMPORTS: &str =
    "import sys; sys.path[:] = [p for p in sys.path if p]; from pxr import Usd; import numpy";

/// Names of an interpreter in the folder where a wheel puts this program.
const NEIGHBORS: [&str; 2] = ["python3", "python.exe"];

/// `SURFLUX_USD_PYTHON`, else `.venv/bin/python` where it exists, else the Python beside this program where there is one
/// (`pip install` puts the program there), else `python3`.
pub(super) fn find() -> PathBuf {
    choose(
        std::env::var_os(VARIABLE),
        Path::new(".venv/bin/python").is_file(),
        std::env::current_exe()
            .ok()
            .and_then(|program| beside(&program)),
    )
}

fn choose(variable: Option<OsString>, has_venv: bool, beside: Option<PathBuf>) -> PathBuf {
    match variable.filter(|value| !value.is_empty()) {
        Some(interpreter) => interpreter.into(),
        None if has_venv => PathBuf::from(".venv/bin/python"),
        None => beside.unwrap_or_else(|| PathBuf::from("python3")),
    }
}

/// The interpreter in the folder of `program`.
fn beside(program: &Path) -> Option<PathBuf> {
    let found = NEIGHBORS.map(|name| program.with_file_name(name));
    found.into_iter().find(|python| python.is_file())
}

/// True if `interpreter` starts and can import what the worker needs.
pub(super) fn can_import(interpreter: &Path) -> bool {
    let silent = Command::new(interpreter)
        .args(["-c", IMPORTS])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    let Ok(mut child) = silent else {
        return false;
    };
    let start = Instant::now();
    while start.elapsed() < IMPORT_TIMEOUT {
        match child.try_wait() {
            Ok(Some(status)) => return status.success(),
            Ok(None) => std::thread::sleep(Duration::from_millis(5)),
            Err(_) => break,
        }
    }
    // Nothing to do about failures here: the process is given up either way.
    let _ = child.kill();
    let _ = child.wait();
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_variable_wins_over_the_folder_over_the_neighbor_over_the_system() {
        let variable = || Some(OsString::from("hython"));
        let beside = || Some(PathBuf::from("/wheel/bin/python3"));
        assert_eq!(choose(variable(), true, beside()), Path::new("hython"));
        assert_eq!(choose(None, true, beside()), Path::new(".venv/bin/python"));
        assert_eq!(
            choose(None, false, beside()),
            Path::new("/wheel/bin/python3")
        );
        assert_eq!(
            choose(Some(OsString::new()), false, None),
            Path::new("python3"),
            "an empty variable is unset"
        );
    }

    #[test]
    fn the_neighbor_is_a_file_in_the_folder_of_the_program() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("surflux");
        std::fs::create_dir(folder.path().join("python3")).unwrap();
        assert_eq!(beside(&program), None);
        let python = folder.path().join("python.exe");
        std::fs::write(&python, "").unwrap();
        assert_eq!(beside(&program), Some(python));
    }

    #[test]
    fn a_program_that_is_no_python_cannot_import() {
        assert!(!can_import(Path::new("/nonexistent/python")));
        assert!(!can_import(Path::new("/bin/false")));
    }
}
