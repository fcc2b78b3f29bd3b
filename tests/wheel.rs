//! `pip install` of a wheel that carries the program, where nothing else is installed.

#[allow(dead_code, reason = "for other tests")]
#[path = "support/python.rs"]
mod python;

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The program that all tests are run with.
const PROGRAM: &str = env!("CARGO_BIN_EXE_surflux");

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// What `command` says; it must succeed.
fn run(command: &mut Command) -> Output {
    let output = command.output().expect("it starts");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}:\n{stderr}");
    output
}

/// Makes the wheel in `folder` with maturin, of what `cargo test` has compiled: nothing is compiled anew. Cargo loads crates of
/// other platforms for that, which it needs to tell what it would compile.
fn wheel(folder: &Path) -> PathBuf {
    let profile = Path::new(PROGRAM).parent().expect("a folder");
    let name = match profile.file_name().and_then(OsStr::to_str) {
        Some("debug") => "dev",
        name => name.expect("a profile"),
    };
    let mut maturin = Command::new(python::tools().join("bin/maturin"));
    maturin.current_dir(ROOT).args(["build", "--locked"]);
    maturin.args(["--compatibility", "linux", "--profile", name]);
    maturin
        .arg("--target-dir")
        .arg(profile.parent().expect("a target folder"));
    maturin.arg("--out").arg(folder);
    run(&mut maturin);
    let wheels = fs::read_dir(folder).expect("readable");
    let mut wheels = wheels.map(|wheel| wheel.expect("an entry").path());
    let wheel = wheels.next().expect("a wheel");
    assert_eq!(wheels.next(), None);
    wheel
}

/// A clean environment with the wheel in it and nothing else; returns its folder of programs.
fn installed(folder: &Path, wheel: &Path) -> PathBuf {
    let environment = folder.join("environment");
    run(Command::new(python::python())
        .args(["-m", "venv"])
        .arg(&environment));
    let programs = environment.join("bin");
    run(Command::new(programs.join("pip"))
        .args(["install", "--quiet", "--no-index"])
        .arg(wheel));
    programs
}

/// Lets the Python in `programs` import what the tests' own has.
fn lend_packages(programs: &Path) {
    const SITE: &str = "import sysconfig; print(sysconfig.get_path('purelib'))";
    let site = |python: &Path| {
        let output = run(Command::new(python).args(["-c", SITE]));
        String::from_utf8(output.stdout).expect("UTF-8")
    };
    let own = site(&programs.join("python3"));
    let lent = site(&python::python());
    fs::write(Path::new(own.trim()).join("lent.pth"), lent).expect("writable");
}

#[test]
fn a_wheel_of_the_tested_program_runs_where_nothing_else_is_installed() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let wheel = wheel(&folder.path().join("wheels"));
    let programs = installed(folder.path(), &wheel);
    let program = programs.join("surflux");
    assert_eq!(
        fs::read(&program).expect("installed"),
        fs::read(PROGRAM).expect("built"),
        "the wheel has another program than the tests"
    );
    let surflux = || {
        let mut command = Command::new(&program);
        command.env_clear().current_dir(folder.path());
        command
    };
    let version = run(surflux().arg("--version")).stdout;
    let version = String::from_utf8(version).expect("UTF-8");
    assert_eq!(
        version.trim(),
        concat!("surflux ", env!("CARGO_PKG_VERSION"))
    );
    let stage = Path::new(ROOT).join("examples/room.usda");
    run(surflux()
        .arg("points")
        .arg(&stage)
        .args(["-o", "cloud.usdc", "--surfels", "500", "-q"])
        .args(["--usd", "native"]));
    // the usd-core of the environment is found without it being activated
    let told = |command: &mut Command| command.output().expect("it starts").status.success();
    let mut info = surflux();
    info.arg("info")
        .arg("cloud.usdc")
        .args(["--usd", "usd-core"]);
    assert!(!told(&mut info), "the environment is not clean");
    lend_packages(&programs);
    assert!(
        told(&mut info),
        "{}",
        String::from_utf8_lossy(&info.output().expect("it starts").stderr)
    );
}
