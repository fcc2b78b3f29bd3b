//! The native reader against Pixar's usd-core (`support/dump_stage.py`): every prim, attribute, value, target and
//! connection of real stages and of small ones that each hold one composition feature; and damaged files.
//!
//! The comparisons need a Python with usd-core in `SURFLUX_TEST_PYTHON` and are skipped without it.

use serde_json::{Value as Json, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use surflux::diagnostics::Diagnostics;
use surflux::stage::native::NativeSource;
use surflux::stage::raw::{RawAttribute, RawPrim, RawStage, Request, Value};
use surflux::stage::{Error, Source};

/// Two sums of the same numbers in another order, or one value interpolated in another width, may differ by this much
/// of the sum of their magnitudes: a few roundings of single precision.
const INTERPOLATED: f64 = 4e-7;
/// Values that were only copied: sums in double precision.
const COPIED: f64 = 1e-12;

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
            values_not_needed: Vec::new(),
        }
    }
}

fn python() -> Option<PathBuf> {
    let python = std::env::var_os("SURFLUX_TEST_PYTHON").map(PathBuf::from);
    if python.is_none() {
        println!("skipped: set SURFLUX_TEST_PYTHON to a Python with usd-core and numpy");
    }
    python
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

fn truths(python: &Path, cases: &[Case]) -> Vec<Json> {
    let requests: Vec<Json> = cases
        .iter()
        .map(|case| json!({"path": case.path, "time": case.time, "mask": case.mask}))
        .collect();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/dump_stage.py");
    let mut child = Command::new(python)
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("Python starts");
    let mut stdin = child.stdin.take().expect("stdin is piped");
    let requests = Json::Array(requests).to_string();
    stdin.write_all(requests.as_bytes()).expect("the script reads");
    drop(stdin);
    let output = child.wait_with_output().expect("the script ends");
    let text = String::from_utf8(output.stdout).expect("JSON is UTF-8");
    let answers: Vec<Json> = text
        .lines()
        .map(|line| serde_json::from_str(line).expect("one JSON object a line"))
        .collect();
    assert_eq!(answers.len(), cases.len(), "the script answers every request");
    answers
}

fn native(case: &Case, diagnostics: &Diagnostics) -> Result<RawStage, Error> {
    NativeSource::open(&case.path)?.load(&case.request(), diagnostics)
}

/// What was compared.
#[derive(Default)]
struct Tally {
    stages: usize,
    prims: usize,
    values: usize,
    facts: usize,
    /// Stages whose lists of layers are the same.
    same_layers: usize,
    different: Vec<String>,
}

impl Tally {
    fn fact<T: PartialEq + std::fmt::Debug>(&mut self, what: &str, ours: &T, truth: &T) {
        self.facts += 1;
        if ours != truth {
            self.different.push(format!("{what}: {ours:?}, usd-core {truth:?}"));
        }
    }

    fn stage(&mut self, case: &Case, ours: &RawStage, truth: &Json) {
        self.stages += 1;
        let name = case.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let time = case.time.map_or(String::new(), |time| format!("@{time}"));
        let name = format!("{name}{time}");
        let truth_text = renamed(&truth["prims"].to_string(), &prototype_names(truth));
        let truth_prims: Vec<Json> = serde_json::from_str(&truth_text).expect("renaming keeps JSON");
        let names: Vec<&str> = ours.prims[ours.prototype_start..]
            .iter()
            .filter(|prim| prim.parent.is_none())
            .map(|prim| prim.path.as_str())
            .collect();
        let ours_paths: Vec<String> = ours.prims.iter().map(|prim| renamed(&prim.path, &names)).collect();
        let truth_paths: Vec<&str> = truth_prims.iter().filter_map(|prim| prim["path"].as_str()).collect();
        self.fact(&format!("{name} prims"), &ours_paths.iter().map(String::as_str).collect(), &truth_paths);
        self.fact(&format!("{name} prototypeStart"), &json!(ours.prototype_start), &truth["prototypeStart"]);
        self.fact(&format!("{name} upAxis"), &json!(ours.meta.up_axis), &truth["upAxis"]);
        self.fact(&format!("{name} metersPerUnit"), &json!(ours.meta.meters_per_unit), &truth["metersPerUnit"]);
        self.fact(&format!("{name} defaultPrim"), &json!(ours.meta.default_prim), &truth["defaultPrim"]);
        self.fact(&format!("{name} start"), &json!(ours.meta.start_time_code), &truth["startTimeCode"]);
        self.fact(&format!("{name} end"), &json!(ours.meta.end_time_code), &truth["endTimeCode"]);
        let mut layers: Vec<String> = ours.meta.layers.iter().map(|layer| real(layer)).collect();
        layers.sort();
        self.layers(&name, &layers, &keys(&truth["layers"]));
        for (index, prim) in ours.prims.iter().enumerate() {
            if let Some(at) = truth_paths.iter().position(|path| *path == ours_paths[index]) {
                self.prims += 1;
                self.prim(&format!("{name} {}", prim.path), ours, prim, &truth_prims[at], &names, case.time.is_some());
            }
        }
    }

    /// usd-core also composes what is never seen (undefined prims) and counts the layers met there.
    fn layers(&mut self, name: &str, ours: &[String], truth: &[String]) {
        self.facts += 1;
        self.same_layers += usize::from(ours == truth);
        for layer in ours.iter().filter(|layer| !truth.contains(layer)) {
            self.different.push(format!("{name} layers: usd-core does not use {layer}"));
        }
    }

    fn prim(&mut self, name: &str, stage: &RawStage, ours: &RawPrim, truth: &Json, names: &[&str], timed: bool) {
        let path_of = |index: Option<usize>| json!(index.map(|index| renamed(&stage.prims[index].path, names)));
        self.fact(&format!("{name} type"), &json!(ours.type_name), &truth["type"]);
        self.fact(&format!("{name} parent"), &path_of(ours.parent), &truth["parent"]);
        self.fact(&format!("{name} apiSchemas"), &json!(ours.api_schemas), &truth["apiSchemas"]);
        self.fact(&format!("{name} prototype"), &path_of(ours.prototype), &truth["prototype"]);
        self.fact(&format!("{name} kind"), &json!(ours.kind), &truth["kind"]);
        self.fact(&format!("{name} attributes"), &keys(&json!(ours.attributes.keys().collect::<Vec<_>>())), &sorted_keys(&truth["attributes"]));
        self.fact(&format!("{name} relationships"), &keys(&json!(ours.relationships.keys().collect::<Vec<_>>())), &sorted_keys(&truth["relationships"]));
        for (key, relationship) in &ours.relationships {
            let truth = &truth["relationships"][key];
            let targets: Vec<String> = relationship.targets.iter().map(|path| renamed(path, names)).collect();
            self.fact(&format!("{name}.{key} targets"), &json!(targets), &truth["targets"]);
            self.fact(&format!("{name}.{key} bindMaterialAs"), &json!(relationship.bind_material_as), &truth["bindMaterialAs"]);
        }
        for (key, attribute) in &ours.attributes {
            self.attribute(&format!("{name}.{key}"), attribute, &truth["attributes"][key], names, timed);
        }
    }

    fn attribute(&mut self, name: &str, ours: &RawAttribute, truth: &Json, names: &[&str], timed: bool) {
        let connections: Vec<String> = ours.connections.iter().map(|path| renamed(path, names)).collect();
        self.fact(&format!("{name} type"), &json!(ours.type_name), &truth["type"]);
        self.fact(&format!("{name} interpolation"), &json!(ours.interpolation), &truth["interpolation"]);
        self.fact(&format!("{name} elementSize"), &json!(ours.element_size), &truth["elementSize"]);
        self.fact(&format!("{name} colorSpace"), &json!(ours.color_space), &truth["colorSpace"]);
        self.fact(&format!("{name} connections"), &json!(connections), &truth["connections"]);
        self.fact(&format!("{name} varying"), &json!(ours.varying), &truth["varying"]);
        self.values += 1;
        let tolerance = if timed { INTERPOLATED } else { COPIED };
        if !same_value(ours.value.as_ref(), &truth["value"], tolerance) {
            let ours = ours.value.as_ref().map(encode);
            self.different.push(format!("{name} value: {ours:?}, usd-core {}", truth["value"]));
        }
    }
}

fn keys(list: &Json) -> Vec<String> {
    let names = list.as_array().into_iter().flatten();
    names.filter_map(|name| name.as_str().map(str::to_owned)).collect()
}

fn sorted_keys(object: &Json) -> Vec<String> {
    let mut names: Vec<String> = object.as_object().map(|map| map.keys().cloned().collect()).unwrap_or_default();
    names.sort();
    names
}

fn real(path: &str) -> String {
    let path = match path.split_once('[') {
        Some((package, _)) => package,
        None => path,
    };
    let real = std::fs::canonicalize(path).unwrap_or_else(|_| PathBuf::from(path));
    real.to_string_lossy().into_owned()
}

/// Names of the prototype roots of a dump, in the order they come.
fn prototype_names(truth: &Json) -> Vec<&str> {
    let start = usize::try_from(truth["prototypeStart"].as_u64().unwrap_or(0)).expect("fits");
    let prims = truth["prims"].as_array().expect("a list of prims");
    prims[start..]
        .iter()
        .filter(|prim| prim["parent"].is_null())
        .filter_map(|prim| prim["path"].as_str())
        .collect()
}

/// `text` with the prototypes numbered in the order they come: readers number them as they like.
fn renamed(text: &str, names: &[&str]) -> String {
    let mut pieces = text.split("/__Prototype_");
    let mut out = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let digits = piece.len() - piece.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let name = format!("/__Prototype_{}", &piece[..digits]);
        let order = names.iter().position(|known| *known == name);
        out += &order.map_or(name, |order| format!("/__P{order}"));
        out += &piece[digits..];
    }
    out
}

fn encode(value: &Value) -> Json {
    match value {
        Value::Bool(v) => json!({"number": i64::from(*v)}),
        Value::Int(v) => json!({"number": v}),
        Value::Float(v) => json!({"number": finite(*v)}),
        Value::Token(v) => json!({"text": v}),
        Value::Asset { authored, resolved } => json!({"asset": [authored, resolved]}),
        Value::Vec2(v) => numbers(&v.to_array()),
        Value::Vec3(v) => numbers(&v.to_array()),
        Value::Vec4(v) => numbers(&v.to_array()),
        Value::Quat(v) => numbers(&v.to_array()),
        Value::Matrix(v) => numbers(&v.to_cols_array()),
        Value::IntArray(v) => array(v.iter().map(|&x| f64::from(x)), 1),
        Value::Int64Array(v) => array(v.iter().map(|&x| x as f64), 1),
        Value::FloatArray(v) => array(v.iter().map(|&x| f64::from(x)), 1),
        Value::Vec2Array(v) => array(v.iter().flat_map(|v| v.to_array()).map(f64::from), 2),
        Value::Vec3Array(v) => array(v.iter().flat_map(|v| v.to_array()).map(f64::from), 3),
        Value::Vec4Array(v) | Value::QuatArray(v) => array(v.iter().flat_map(|v| v.to_array()).map(f64::from), 4),
        Value::MatrixArray(v) => array(v.iter().flat_map(|v| v.to_cols_array()), 16),
        Value::TokenArray(v) => json!({"texts": v}),
    }
}

fn finite(x: f64) -> Json {
    match x {
        x if x.is_nan() => json!("nan"),
        x if x.is_infinite() => json!(if x > 0.0 { "inf" } else { "-inf" }),
        x => json!(x),
    }
}

fn numbers(list: &[f64]) -> Json {
    json!({"numbers": list.iter().map(|&x| finite(x)).collect::<Vec<_>>()})
}

fn array(list: impl Iterator<Item = f64>, width: usize) -> Json {
    let list: Vec<f64> = list.collect();
    let weighted = list.iter().enumerate().map(|(i, x)| x * (1 + i % 97) as f64).sum();
    let size = list.iter().map(|x| x.abs()).sum();
    json!({"array": {
        "count": list.len() / width,
        "width": width,
        "sum": finite(list.iter().sum()),
        "weighted": finite(weighted),
        "size": finite(size),
    }})
}

fn same_value(ours: Option<&Value>, truth: &Json, tolerance: f64) -> bool {
    let Some(ours) = ours else {
        return truth.is_null() || !truth["other"].is_null();
    };
    let encoded = encode(ours);
    if let (Value::Asset { authored, resolved }, Some(theirs)) = (ours, truth["asset"].as_array()) {
        let udim = authored.contains("<UDIM>");
        let same = theirs[1].as_str() == Some(&real_asset(resolved));
        return theirs[0].as_str() == Some(authored) && (udim || same);
    }
    if let (Some(ours), Some(theirs)) = (encoded["array"].as_object(), truth["array"].as_object()) {
        let scale = ours["size"].as_f64().unwrap_or(0.0);
        // an empty array has no width in numpy
        let shape = ours["count"] == theirs["count"] && (ours["width"] == theirs["width"] || ours["count"] == 0);
        let close = |key: &str, scale: f64| near(&ours[key], &theirs[key], tolerance * scale);
        return shape && close("sum", scale) && close("weighted", scale * 97.0) && close("size", scale);
    }
    if let (Some(ours), Some(theirs)) = (encoded["numbers"].as_array(), truth["numbers"].as_array()) {
        let size = ours.iter().filter_map(Json::as_f64).fold(0.0, |sum, x| sum + x.abs());
        return ours.len() == theirs.len() && ours.iter().zip(theirs).all(|(a, b)| near(a, b, tolerance * size));
    }
    if let Some(size) = encoded["number"].as_f64() {
        return near(&encoded["number"], &truth["number"], tolerance * size.abs());
    }
    encoded == *truth
}

fn real_asset(path: &str) -> String {
    match path.split_once('[') {
        Some((package, inner)) => format!("{}[{inner}", real(package)),
        None if path.is_empty() => String::new(),
        None => real(path),
    }
}

fn near(ours: &Json, truth: &Json, tolerance: f64) -> bool {
    match (ours.as_f64(), truth.as_f64()) {
        (Some(ours), Some(truth)) => (ours - truth).abs() <= tolerance,
        _ => ours == truth,
    }
}

fn compare(python: &Path, cases: &[Case]) -> Tally {
    let mut tally = Tally::default();
    for (case, truth) in cases.iter().zip(truths(python, cases)) {
        match (native(case, &Diagnostics::default()), truth["error"].as_str()) {
            (Ok(stage), None) => tally.stage(case, &stage, &truth),
            (Err(_), Some(_)) => {}
            (Ok(_), Some(error)) => tally.different.push(format!("{}: usd-core refuses: {error}", case.path.display())),
            (Err(error), None) => tally.different.push(format!("{}: we refuse: {error}", case.path.display())),
        }
    }
    println!(
        "{} stages, {} prims, {} values and {} other facts compared; {} different; {} lists of layers the same",
        tally.stages, tally.prims, tally.values, tally.facts, tally.different.len(), tally.same_layers
    );
    tally
}

fn stages_below(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("the folder is readable")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            stages_below(&path, found);
        } else if path.extension().is_some_and(|e| ["usd", "usda", "usdc", "usdz"].iter().any(|usd| e == *usd)) {
            found.push(path);
        }
    }
}

#[test]
fn real_stages_read_like_usd_core_reads_them() {
    let (Some(python), Some(shared)) = (python(), shared()) else {
        return;
    };
    let mut paths = Vec::new();
    stages_below(&shared.join("assets"), &mut paths);
    stages_below(&shared.join("truth"), &mut paths);
    let cases: Vec<Case> = paths
        .iter()
        .flat_map(|path| [None, Some(12.3)].map(|time| Case::new(path, time)))
        .collect();
    let tally = compare(&python, &cases);
    assert!(tally.different.is_empty(), "{}", tally.different.join("\n"));
}
