//! Outputs that cannot be written.

use super::program::{ROOM, files, run, stderr};
use std::fs;

/// A command whose output cannot be written ends with 1 and names the output; `folder` stays as it was.
fn must_not_write(command: &str, output: &std::path::Path, folder: &std::path::Path) {
    let before = files(folder);
    let result = run(&[
        command,
        ROOM,
        "-o",
        &output.to_string_lossy(),
        "--usd",
        "native",
        "--surfels",
        "500",
    ]
    .into_iter()
    .chain(
        match command {
            "points" => [].as_slice(),
            "render" => &["--rays", "16", "--image-width", "8"],
            _ => &["--rays", "16", "--aov", "occlusion"],
        }
        .iter()
        .copied(),
    )
    .collect::<Vec<_>>());
    let said = stderr(&result);
    assert_eq!(result.status.code(), Some(1), "{command}: {said}");
    assert!(
        said.contains(&*output.to_string_lossy()),
        "{command}: {said}"
    );
    assert_eq!(files(folder), before, "{command}");
}

const KINDS: [(&str, &str); 3] = [
    ("points", "out.usdc"),
    ("bake", "out.usda"),
    ("render", "out.exr"),
];

#[test]
fn a_folder_that_is_missing_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    for (command, name) in KINDS {
        must_not_write(command, &folder.path().join("no").join(name), folder.path());
    }
}

#[test]
fn an_output_that_is_a_folder_is_left_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    for (command, name) in KINDS {
        let output = folder.path().join(name);
        fs::create_dir(&output).expect("made");
        fs::write(output.join("kept"), "").expect("written");
        must_not_write(command, &output, folder.path());
        assert_eq!(files(&output), ["kept"]);
    }
}

#[test]
fn a_parent_that_is_a_file_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("file");
    fs::write(&file, "kept").expect("written");
    for (command, name) in KINDS {
        must_not_write(command, &file.join(name), folder.path());
    }
    assert_eq!(fs::read_to_string(&file).expect("kept"), "kept");
}
