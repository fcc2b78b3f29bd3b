//! Who may import whom: the pipeline's arrows as a table. To change the rule, change the table in the same commit.

use std::fs;
use std::path::{Path, PathBuf};

/// Module → the modules it may name after `crate::`.
const ALLOWED: &[(&str, &[&str])] = &[
    // vocabulary
    ("math", &[]),
    ("diagnostics", &[]),
    ("files", &[]),
    ("scene", &["math"]),
    ("surfels", &["math"]),
    ("results", &["math", "scene"]),
    // tools
    ("image", &["math", "diagnostics", "files", "scene"]),
    ("trace", &["math", "scene"]),
    (
        "shading",
        &["math", "diagnostics", "scene", "image", "trace"],
    ),
    (
        "lighting",
        &["math", "diagnostics", "scene", "image", "shading", "trace"],
    ),
    (
        "displacement",
        &["diagnostics", "scene", "shading", "trace"],
    ),
    // steps
    (
        "stage",
        &["math", "diagnostics", "files", "scene", "surfels"],
    ),
    (
        "bake",
        &[
            "math",
            "diagnostics",
            "scene",
            "shading",
            "lighting",
            "trace",
            "surfels",
        ],
    ),
    ("octree", &["math", "diagnostics", "surfels"]),
    (
        "receivers",
        &[
            "math",
            "diagnostics",
            "scene",
            "shading",
            "trace",
            "surfels",
            "results",
        ],
    ),
    (
        "gather",
        &[
            "math",
            "diagnostics",
            "scene",
            "shading",
            "lighting",
            "trace",
            "octree",
            "surfels",
            "receivers",
            "results",
        ],
    ),
    (
        "bounce",
        &[
            "math",
            "diagnostics",
            "bake",
            "lighting",
            "shading",
            "trace",
            "surfels",
            "receivers",
            "gather",
            "results",
        ],
    ),
    (
        "interpolate",
        &[
            "math",
            "diagnostics",
            "trace",
            "receivers",
            "gather",
            "results",
        ],
    ),
    (
        "writers",
        &["math", "diagnostics", "scene", "surfels", "results"],
    ),
    ("pilot", &["diagnostics", "receivers", "gather", "results"]),
    (
        "verify",
        &[
            "diagnostics",
            "receivers",
            "gather",
            "pilot",
            "results",
            "writers",
        ],
    ),
    (
        "exchange",
        &[
            "math",
            "diagnostics",
            "files",
            "image",
            "scene",
            "surfels",
            "writers",
        ],
    ),
    (
        "view",
        &[
            "math",
            "diagnostics",
            "scene",
            "surfels",
            "receivers",
            "writers",
        ],
    ),
    // beside the pipeline: runs of it, in processes of their own
    ("recipes", &["diagnostics"]),
    // the whole
    (
        "pipeline",
        &[
            "math",
            "diagnostics",
            "scene",
            "surfels",
            "results",
            "image",
            "shading",
            "lighting",
            "displacement",
            "trace",
            "stage",
            "bake",
            "octree",
            "receivers",
            "gather",
            "interpolate",
            "bounce",
            "writers",
            "pilot",
            "verify",
            "view",
            "exchange",
        ],
    ),
    (
        "cli",
        &[
            "exchange",
            "pipeline",
            "recipes",
            "diagnostics",
            "bake",
            "results",
            "scene",
            "stage",
            "writers",
            "verify",
        ],
    ),
];

/// External crates with one door each: crate → modules that may use it.
const DOORS: &[(&str, &[&str])] = &[
    ("openusd", &["stage", "writers"]),
    ("opensubdiv_rs", &["stage"]),
    ("exr", &["image", "writers"]),
    ("image", &["image", "writers"]),
    ("fearless_simd", &["trace", "gather"]),
    ("clap", &["cli"]),
    ("indicatif", &["cli"]),
    ("ctrlc", &["cli"]),
    ("anyhow", &["cli", "writers"]),
    ("gltf", &["exchange"]),
    ("maud", &["verify", "view", "writers", "pipeline"]),
    ("rustix", &["pilot", "stage", "recipes"]),
    ("glob", &["recipes"]),
    ("twox_hash", &["recipes"]),
];

fn sources() -> Vec<(String, PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    collect(&root, &mut files);
    files
        .into_iter()
        .filter_map(|path| {
            let relative = path.strip_prefix(&root).expect("below src").to_path_buf();
            let module = relative
                .components()
                .next()?
                .as_os_str()
                .to_str()?
                .trim_end_matches(".rs")
                .to_owned();
            let text = fs::read_to_string(&path).expect("readable source");
            (!["lib", "main"].contains(&module.as_str())).then_some((
                module,
                relative,
                code_of(&text),
            ))
        })
        .collect()
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("readable folder") {
        let path = entry.expect("entry").path();
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
}

/// The code before `mod tests`, without comments.
fn code_of(text: &str) -> String {
    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
    code.lines()
        .map(|line| line.split("//").next().unwrap_or_default())
        .collect::<Vec<_>>()
        .join("\n")
}

/// First path segments after every `prefix`, braces included: `crate::{a::B, c}` → a, c.
fn segments(code: &str, prefix: &str) -> Vec<String> {
    let word = |text: &str| {
        text.trim_start()
            .chars()
            .take_while(|c| c.is_alphanumeric() || *c == '_')
            .collect()
    };
    let mut found: Vec<String> = Vec::new();
    for (start, _) in code.match_indices(prefix) {
        let rest = &code[start + prefix.len()..];
        let Some(group) = rest.strip_prefix('{') else {
            found.push(word(rest));
            continue;
        };
        let mut depth = 0;
        let mut item_start = 0;
        for (i, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => {
                    found.push(word(&group[item_start..i]));
                    break;
                }
                '}' => depth -= 1,
                ',' if depth == 0 => {
                    found.push(word(&group[item_start..i]));
                    item_start = i + 1;
                }
                _ => {}
            }
        }
    }
    found.retain(|segment| !segment.is_empty());
    found
}

#[test]
fn modules_import_only_what_the_table_allows() {
    let mut wrong = Vec::new();
    for (module, path, code) in sources() {
        let Some((_, allowed)) = ALLOWED.iter().find(|(name, _)| *name == module) else {
            wrong.push(format!(
                "{}: module {module} is not in the table",
                path.display()
            ));
            continue;
        };
        for segment in segments(&code, "crate::") {
            if segment != module && !allowed.contains(&segment.as_str()) {
                wrong.push(format!("{}: {module} imports {segment}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn external_crates_are_used_behind_their_doors_only() {
    let mut wrong = Vec::new();
    for (module, path, code) in sources() {
        for (name, doors) in DOORS {
            let used = code.lines().any(|line| {
                let line = line.trim_start();
                line.starts_with(&format!("use {name}::")) || line.contains(&format!(" ::{name}::"))
            });
            if used && !doors.contains(&module.as_str()) {
                wrong.push(format!("{}: {module} uses {name}", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_reader_of_imports_sees_groups_and_single_paths() {
    let code = "use crate::{a::{B, C}, d};\nlet x = crate::e::f();";
    assert_eq!(segments(code, "crate::"), ["a", "d", "e"]);
}

#[test]
fn no_source_file_exceeds_six_hundred_lines_of_code() {
    let is_test = |path: &Path| path.ends_with("tests.rs") || path.ends_with("testing.rs");
    for (_, path, code) in sources().into_iter().filter(|(_, path, _)| !is_test(path)) {
        let lines = code.lines().count();
        assert!(lines <= 600, "{}: {lines} lines: split it", path.display());
    }
}
