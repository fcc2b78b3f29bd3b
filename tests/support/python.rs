//! The Python that tests check surflux's files with: `SURFLUX_TEST_PYTHON`, else an environment of its own below
//! `target/`, made once from `tests/requirements.txt`.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

const REQUIREMENTS: &str = include_str!("../requirements.txt");
const TOOLS: &str = include_str!("../requirements-tools.txt");

/// A Python that has everything in `tests/requirements.txt`.
///
/// The first caller on a fresh checkout waits for the installation; other test binaries wait for it at a lock. An
/// environment that was left half made, or made from other requirements, is made anew.
pub(crate) fn python() -> PathBuf {
    static PYTHON: OnceLock<PathBuf> = OnceLock::new();
    PYTHON
        .get_or_init(|| match std::env::var_os("SURFLUX_TEST_PYTHON") {
            Some(ready) => ready.into(),
            None => environment(&Path::new(env!("CARGO_MANIFEST_DIR")).join("target")),
        })
        .clone()
}

/// What `script` prints to stdout, run with `args` in `sys.argv[1:]`. Panics with its stderr if it fails.
pub(crate) fn run_python<A: AsRef<OsStr>>(script: &str, args: &[A]) -> String {
    let output = Command::new(python())
        .args(["-c", script])
        .args(args)
        .output()
        .expect("the test Python starts");
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        output.status.success(),
        "the Python script failed ({}):\n{stdout}\n{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    stdout
}

/// A folder for `PYTHONPATH` that has everything in `tests/requirements-tools.txt`; made once, below `target/`.
#[allow(dead_code, reason = "few tests make schemas and wheels")]
pub(crate) fn tools() -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = root.join("target").join("test-tools");
    let python = python();
    let lock = File::create(root.join("target/test-tools.lock")).expect("the lock can be made");
    lock.lock().expect("the lock can be taken");
    let marker = folder.join("complete.txt");
    if fs::read_to_string(&marker).is_ok_and(|made_from| made_from == TOOLS) {
        return folder;
    }
    if folder.exists() {
        fs::remove_dir_all(&folder).expect("old tools can be removed");
    }
    run(Command::new(python)
        .args(["-m", "pip", "install", "--quiet", "--target"])
        .arg(&folder)
        .arg("-r")
        .arg(root.join("tests/requirements-tools.txt")));
    fs::write(&marker, TOOLS).expect("the marker can be written");
    folder
}

fn environment(target: &Path) -> PathBuf {
    fs::create_dir_all(target).expect("the target folder can be made");
    let lock = File::create(target.join("test-venv.lock")).expect("the lock file can be made");
    lock.lock().expect("the lock can be taken");
    let folder = target.join("test-venv");
    // written last: it stands for a complete environment, and names what is in it
    let marker = folder.join("complete.txt");
    let python = folder.join("bin").join("python");
    if fs::read_to_string(&marker).is_ok_and(|made_from| made_from == REQUIREMENTS) {
        return python;
    }
    if folder.exists() {
        fs::remove_dir_all(&folder).expect("the old test environment can be removed");
    }
    run(Command::new(base_python())
        .args(["-m", "venv"])
        .arg(&folder));
    let requirements = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/requirements.txt");
    run(Command::new(&python)
        .args(["-m", "pip", "install", "--quiet", "-r"])
        .arg(requirements));
    fs::write(&marker, REQUIREMENTS).expect("the marker can be written");
    python
}

/// `python3.11` where there is one, since that is what the requirements are for.
fn base_python() -> &'static str {
    let exact = "python3.11";
    let found = Command::new(exact).arg("--version").output();
    match found.is_ok_and(|output| output.status.success()) {
        true => exact,
        false => "python3",
    }
}

fn run(command: &mut Command) {
    let output = command.output().expect("Python starts");
    assert!(
        output.status.success(),
        "{command:?} failed; set SURFLUX_TEST_PYTHON to a Python 3.11 with tests/requirements.txt installed:\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
}
