//! Pythons that cannot read USD.

use super::program::{ROOM, stderr, surflux};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Output;
use std::time::{Duration, Instant};

fn info(interpreter: &Path, door: &str) -> Output {
    surflux()
        .env("SURFLUX_USD_PYTHON", interpreter)
        .args(["info", ROOM, "--usd", door])
        .output()
        .expect("the program starts")
}

/// A program of that text in `folder`.
fn script(folder: &Path, text: &str) -> std::path::PathBuf {
    let path = folder.join("python");
    fs::write(&path, text).expect("written");
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("executable");
    path
}

#[test]
fn pythons_that_are_none_are_named_with_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let scripts = [
        "#!/bin/sh\nexit 0\n",
        "#!/bin/sh\necho hello\nsleep 60\n",
        "#!/bin/sh\nexit 7\n",
        "#!/bin/sh\necho '{\"error\": \"cannot import pxr\"}'\nexit 1\n",
        "#!/bin/sh\necho '{\"ok\": {}}'\nexit 1\n",
        "not a program",
    ];
    for text in scripts {
        let interpreter = script(folder.path(), text);
        let start = Instant::now();
        let output = info(&interpreter, "usd-core");
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{text:?}: {said}");
        assert!(said.contains("usd-core worker"), "{text:?}: {said}");
        assert!(
            said.contains(&*interpreter.to_string_lossy()),
            "{text:?}: {said}"
        );
        assert!(start.elapsed() < Duration::from_secs(20), "{text:?} hung");
    }
    let gone = info(&folder.path().join("gone"), "usd-core");
    assert_eq!(gone.status.code(), Some(1));
    assert!(stderr(&gone).contains("--usd native"), "{}", stderr(&gone));
}

#[test]
fn without_a_python_that_reads_usd_the_native_door_is_taken() {
    let folder = tempfile::tempdir().expect("a folder");
    let interpreter = script(folder.path(), "#!/bin/sh\nexit 1\n");
    let output = info(&interpreter, "auto");
    assert!(output.status.success(), "{}", stderr(&output));
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(told.contains("read with native"), "{told}");
}
