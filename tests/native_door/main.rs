//! The native reader against Pixar's usd-core (`support/dump_stage.py`): every prim, attribute, value, target and
//! connection of real stages and of small ones that each hold one composition feature; and damaged files.

#![expect(
    clippy::print_stdout,
    reason = "skipped tests say so, comparisons say how much they compared"
)]

mod circles;
mod compare;
mod crowds;
mod damaged;
mod features;
mod frames;
mod layers;
mod values;

#[path = "../support/python.rs"]
mod python;
#[path = "../support/stages.rs"]
mod stages;

use compare::compare;
use python::python;
use serde_json::{Value as Json, json};
use stages::stages_below;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use surflux::diagnostics::Diagnostics;
use surflux::stage::native::NativeSource;
use surflux::stage::raw::{RawStage, Request};
use surflux::stage::{Composition, Error, Source};

/// A stage to read.
#[derive(Clone)]
struct Case {
    path: PathBuf,
    time: Option<f64>,
    mask: Vec<String>,
}

impl Case {
    fn new(path: &Path, time: Option<f64>) -> Self {
        Self {
            path: path.to_owned(),
            time,
            mask: Vec::new(),
        }
    }

    fn request(&self) -> Request {
        Request {
            time: self.time,
            mask: self.mask.clone(),
            attributes: vec!["*".to_owned()],
            composition: Composition::default(),
            values_not_needed: Vec::new(),
        }
    }
}

fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("SURFLUX_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")),
        PathBuf::from,
    );
    let found = folder.join("assets").is_dir();
    if !found {
        println!("skipped: no folder {}", folder.display());
    }
    found.then_some(folder)
}

fn truths(cases: &[Case]) -> Vec<Json> {
    let requests: Vec<Json> = cases
        .iter()
        .map(|case| json!({"path": case.path, "time": case.time, "mask": case.mask}))
        .collect();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/dump_stage.py");
    let mut child = Command::new(python())
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("Python starts");
    let mut stdin = child.stdin.take().expect("stdin is piped");
    let requests = Json::Array(requests).to_string();
    stdin
        .write_all(requests.as_bytes())
        .expect("the script reads");
    drop(stdin);
    let output = child.wait_with_output().expect("the script ends");
    let text = String::from_utf8(output.stdout).expect("JSON is UTF-8");
    let answers: Vec<Json> = text
        .lines()
        .map(|line| serde_json::from_str(line).expect("one JSON object a line"))
        .collect();
    assert_eq!(
        answers.len(),
        cases.len(),
        "the script answers every request"
    );
    answers
}

fn native(case: &Case, diagnostics: &Diagnostics) -> Result<RawStage, Error> {
    NativeSource::open(&case.path)?.load(&case.request(), diagnostics)
}

#[test]
fn real_stages_read_like_usd_core_reads_them() {
    let Some(shared) = shared() else {
        return;
    };
    let mut paths = Vec::new();
    stages_below(&shared.join("assets"), &mut paths);
    stages_below(&shared.join("truth"), &mut paths);
    let cases: Vec<Case> = paths
        .iter()
        .flat_map(|path| [None, Some(12.3)].map(|time| Case::new(path, time)))
        .collect();
    let tally = compare(&cases);
    assert!(tally.different.is_empty(), "{}", tally.different.join("\n"));
}

#[test]
fn masks_and_packages_read_like_usd_core_reads_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let package = folder.path().join("p.usdz");
    let mut writer = openusd::usdz::ArchiveWriter::create(&package).expect("a package");
    let root =
        "#usda 1.0\ndef \"R\" (references = @./parts/a.usda@</A>) {\nasset tex = @tex/t.png@\n}\n";
    writer
        .add_layer("root.usda", root.as_bytes())
        .expect("an entry");
    let part = "#usda 1.0\ndef \"A\" { asset near = @../tex/t.png@\nasset gone = @./t.png@\n}\n";
    writer
        .add_layer("parts/a.usda", part.as_bytes())
        .expect("an entry");
    writer.add_layer("tex/t.png", b"png").expect("an entry");
    writer.finish().expect("a package");
    let outer = folder.path().join("outer.usda");
    let text = "#usda 1.0\ndef \"O\" (references = @./p.usdz@</R>) {\nasset inner = @./p.usdz[tex/t.png]@\n}\n";
    std::fs::write(&outer, text).expect("a file");
    let masked = folder.path().join("masked.usda");
    let text = "#usda 1.0\ndef \"W\" { def \"A\" { def \"B\" {}\n}\ndef \"C\" { def \"D\" {}\n}\n\
                def \"I\" (\ninstanceable = true\nreferences = </W/A>\n) {}\n}\ndef \"X\" {}\n";
    std::fs::write(&masked, text).expect("a file");
    let mut cases = vec![Case::new(&package, None), Case::new(&outer, None)];
    for mask in [vec!["/W/A"], vec!["/W/C/D", "/X"], vec!["/W/I"]] {
        cases.push(Case {
            mask: mask.into_iter().map(str::to_owned).collect(),
            ..Case::new(&masked, None)
        });
    }
    let tally = compare(&cases);
    assert!(tally.different.is_empty(), "{}", tally.different.join("\n"));
}
