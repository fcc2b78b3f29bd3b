//! `surflux convert` against other programs: Blender, usd-core, and small readers and writers in Python.

mod blender;
mod glb;
mod gltf;
mod las;
mod ply;
mod ptc;
mod skins;
mod splats;

#[allow(dead_code, reason = "for other tests")]
#[path = "../support/program.rs"]
mod program;
#[path = "../support/python.rs"]
mod python;

use program::{ROOM, files, run, stderr};
use python::run_python;
use serde_json::Value as Json;
use std::path::Path;

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// Converts, and returns the statistics.
fn convert(from: &Path, to: &Path, more: &[&str]) -> Json {
    let mut args = vec!["convert", text(from), text(to), "--json"];
    args.extend(more);
    program::json(&run(&args))
}

/// The example's room baked to `path` by few rays, and as `more` says.
fn bake_room(path: &Path, more: &[&str]) {
    let mut args = vec!["bake", ROOM, "--usd", "native", "--rays", "16", "-q"];
    args.extend(["-o", text(path)]);
    args.extend(more);
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
}

/// The script's last line as JSON.
fn python_json(script: &str, args: &[&Path]) -> Json {
    let output = run_python(script, args);
    serde_json::from_str(output.lines().last().expect("a line")).expect("JSON")
}

/// A conversion of `bytes` named `name` that must fail with one of ours (never a panic), leaving nothing.
fn must_fail(name: &str, bytes: &[u8], word: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    let from = folder.path().join(name);
    std::fs::write(&from, bytes).expect("writable");
    let to = folder.path().join("out.usdc");
    let result = run(&["convert", text(&from), text(&to)]);
    assert_eq!(result.status.code(), Some(1), "{}", stderr(&result));
    assert!(
        stderr(&result).contains(word),
        "no {word:?} in {}",
        stderr(&result)
    );
    assert!(!stderr(&result).contains("panicked"), "{}", stderr(&result));
    assert_eq!(files(folder.path()), [name]);
}

/// Cuts and flipped bits of a file: an exit code of 0 or 1, never a panic.
fn survives(name: &str, bytes: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder");
    let from = folder.path().join(name);
    let to = folder.path().join("out.usda");
    let mut seed = 12345_usize;
    for round in 0..40 {
        let mut damaged = bytes.to_vec();
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let at = (seed >> 16) % damaged.len();
        if round % 2 == 0 {
            damaged.truncate(at);
        } else {
            damaged[at] ^= 1 << (round % 8);
        }
        std::fs::write(&from, &damaged).expect("writable");
        let result = run(&["convert", text(&from), text(&to), "-q"]);
        let code = result.status.code();
        assert!(
            matches!(code, Some(0 | 1)),
            "round {round}, byte {at}: {code:?} {}",
            stderr(&result)
        );
        assert!(
            !stderr(&result).contains("panicked"),
            "round {round}: {}",
            stderr(&result)
        );
    }
}
