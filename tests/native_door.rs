//! The native reader against Pixar's usd-core (`support/dump_stage.py`): every prim, attribute, value, target and
//! connection of real stages and of small ones that each hold one composition feature; and damaged files.
//!
//! The comparisons need a Python with usd-core in `SURFLUX_TEST_PYTHON` and are skipped without it.

#![expect(
    clippy::print_stdout,
    reason = "skipped tests say so, comparisons say how much they compared"
)]

use serde_json::{Value as Json, json};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use surflux::diagnostics::Diagnostics;
use surflux::stage::Composition;
use surflux::stage::native::NativeSource;
use surflux::stage::raw::{RawAttribute, RawPrim, RawStage, Request, Value};
use surflux::stage::{Error, Source};

/// Two sums of the same numbers in another order, or one value interpolated in another width, may differ by this much
/// of the sum of their magnitudes: a few roundings of single precision.
const INTERPOLATED: f64 = 4e-7;
/// The same in half precision.
const HALF: f64 = 1e-3;
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
            composition: Composition::default(),
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
            self.different
                .push(format!("{what}: {ours:?}, usd-core {truth:?}"));
        }
    }

    /// `pairs`: key in the truth, and what we have for it.
    fn all(&mut self, name: &str, truth: &Json, pairs: &[(&str, Json)]) {
        for (key, ours) in pairs {
            self.fact(&format!("{name} {key}"), ours, &truth[key]);
        }
    }

    fn stage(&mut self, case: &Case, ours: &RawStage, truth: &Json) {
        self.stages += 1;
        let file = case.path.file_name().unwrap_or_default().to_string_lossy();
        let name = format!(
            "{file}{}",
            case.time.map_or(String::new(), |time| format!("@{time}"))
        );
        let text = renamed(&truth["prims"].to_string(), &prototype_names(truth));
        let theirs: Vec<Json> = serde_json::from_str(&text).expect("renaming keeps JSON");
        let look = Look {
            stage: ours,
            names: our_prototypes(ours),
            timed: case.time.is_some(),
        };
        let paths: Vec<String> = ours
            .prims
            .iter()
            .map(|prim| look.named(&prim.path))
            .collect();
        let their_paths: Vec<&str> = theirs
            .iter()
            .filter_map(|prim| prim["path"].as_str())
            .collect();
        self.fact(&format!("{name} prims"), &json!(paths), &json!(their_paths));
        let meta = &ours.meta;
        let pairs = [
            ("prototypeStart", json!(ours.prototype_start)),
            ("upAxis", json!(meta.up_axis)),
            ("metersPerUnit", json!(meta.meters_per_unit)),
            ("defaultPrim", json!(meta.default_prim)),
            ("startTimeCode", json!(meta.start_time_code)),
            ("endTimeCode", json!(meta.end_time_code)),
        ];
        self.all(&name, truth, &pairs);
        let mut layers: Vec<String> = meta.layers.iter().map(|layer| real(layer)).collect();
        layers.sort();
        layers.dedup();
        self.layers(&name, &layers, &keys(&truth["layers"]));
        for ((prim, path), theirs) in ours.prims.iter().zip(&paths).zip(&theirs) {
            if theirs["path"].as_str() == Some(path) {
                self.prims += 1;
                self.prim(&format!("{name} {path}"), &look, prim, theirs);
            }
        }
    }

    /// usd-core also composes what is never seen (undefined prims) and counts the layers met there.
    fn layers(&mut self, name: &str, ours: &[String], truth: &[String]) {
        self.facts += 1;
        self.same_layers += usize::from(ours == truth);
        for layer in ours.iter().filter(|layer| !truth.contains(layer)) {
            self.different
                .push(format!("{name} layers: usd-core does not use {layer}"));
        }
    }

    fn prim(&mut self, name: &str, look: &Look<'_>, ours: &RawPrim, truth: &Json) {
        let pairs = [
            ("type", json!(ours.type_name)),
            ("parent", look.path_of(ours.parent)),
            ("apiSchemas", json!(ours.api_schemas)),
            ("prototype", look.path_of(ours.prototype)),
            ("kind", json!(ours.kind)),
        ];
        self.all(name, truth, &pairs);
        let listed: Vec<&String> = ours.attributes.keys().collect();
        self.fact(
            &format!("{name} attributes"),
            &json!(listed),
            &sorted_keys(&truth["attributes"]),
        );
        let listed: Vec<&String> = ours.relationships.keys().collect();
        self.fact(
            &format!("{name} relationships"),
            &json!(listed),
            &sorted_keys(&truth["relationships"]),
        );
        for (key, relationship) in &ours.relationships {
            let pairs = [
                ("targets", look.all_named(&relationship.targets)),
                ("bindMaterialAs", json!(relationship.bind_material_as)),
            ];
            self.all(
                &format!("{name}.{key}"),
                &truth["relationships"][key],
                &pairs,
            );
        }
        for (key, attribute) in &ours.attributes {
            self.attribute(
                &format!("{name}.{key}"),
                look,
                attribute,
                &truth["attributes"][key],
            );
        }
    }

    fn attribute(&mut self, name: &str, look: &Look<'_>, ours: &RawAttribute, truth: &Json) {
        let pairs = [
            ("type", json!(ours.type_name)),
            ("interpolation", json!(ours.interpolation)),
            ("elementSize", json!(ours.element_size)),
            ("colorSpace", json!(ours.color_space)),
            ("connections", look.all_named(&ours.connections)),
            ("varying", json!(ours.varying)),
        ];
        self.all(name, truth, &pairs);
        self.values += 1;
        let tolerance = match look.timed {
            false => COPIED,
            true if ours.type_name.contains('h') => HALF,
            true => INTERPOLATED,
        };
        if !same_value(ours.value.as_ref(), &truth["value"], tolerance) {
            let ours = ours.value.as_ref().map(encode);
            self.different.push(format!(
                "{name} value: {ours:?}, usd-core {}",
                truth["value"]
            ));
        }
    }
}

/// How one stage of ours is looked at.
struct Look<'a> {
    stage: &'a RawStage,
    /// Its prototype roots, in order.
    names: Vec<&'a str>,
    timed: bool,
}

impl Look<'_> {
    fn named(&self, path: &str) -> String {
        renamed(path, &self.names)
    }

    fn all_named(&self, paths: &[String]) -> Json {
        json!(
            paths
                .iter()
                .map(|path| self.named(path))
                .collect::<Vec<_>>()
        )
    }

    fn path_of(&self, index: Option<usize>) -> Json {
        json!(index.map(|index| self.named(&self.stage.prims[index].path)))
    }
}

fn our_prototypes(stage: &RawStage) -> Vec<&str> {
    let prims = stage.prims[stage.prototype_start..].iter();
    prims
        .filter(|prim| prim.parent.is_none())
        .map(|prim| prim.path.as_str())
        .collect()
}

fn keys(list: &Json) -> Vec<String> {
    let names = list.as_array().into_iter().flatten();
    names
        .filter_map(|name| name.as_str().map(str::to_owned))
        .collect()
}

fn sorted_keys(object: &Json) -> Json {
    let mut names: Vec<String> = object
        .as_object()
        .map(|map| map.keys().cloned().collect())
        .unwrap_or_default();
    names.sort();
    json!(names)
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
        Value::Vec4Array(v) | Value::QuatArray(v) => {
            array(v.iter().flat_map(|v| v.to_array()).map(f64::from), 4)
        }
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
    let weighted = list
        .iter()
        .enumerate()
        .map(|(i, x)| x * (1 + i % 97) as f64)
        .sum();
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
        let shape = ours["count"] == theirs["count"]
            && (ours["width"] == theirs["width"] || ours["count"] == 0);
        let close = |key: &str, scale: f64| near(&ours[key], &theirs[key], tolerance * scale);
        return shape
            && close("sum", scale)
            && close("weighted", scale * 97.0)
            && close("size", scale);
    }
    if let (Some(ours), Some(theirs)) = (encoded["numbers"].as_array(), truth["numbers"].as_array())
    {
        let size = ours
            .iter()
            .filter_map(Json::as_f64)
            .fold(0.0, |sum, x| sum + x.abs());
        return ours.len() == theirs.len()
            && ours
                .iter()
                .zip(theirs)
                .all(|(a, b)| near(a, b, tolerance * size));
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
        match (
            native(case, &Diagnostics::default()),
            truth["error"].as_str(),
        ) {
            (Ok(stage), None) => tally.stage(case, &stage, &truth),
            (Err(_), Some(_)) => {}
            (Ok(_), Some(error)) => tally.different.push(format!(
                "{}: usd-core refuses: {error}",
                case.path.display()
            )),
            (Err(error), None) => tally
                .different
                .push(format!("{}: we refuse: {error}", case.path.display())),
        }
    }
    for line in &tally.different {
        println!("  {line}");
    }
    println!(
        "{} stages, {} prims, {} values and {} other facts compared; {} different; {} lists of layers the same",
        tally.stages,
        tally.prims,
        tally.values,
        tally.facts,
        tally.different.len(),
        tally.same_layers
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
        } else if path
            .extension()
            .is_some_and(|e| ["usd", "usda", "usdc", "usdz"].iter().any(|usd| e == *usd))
        {
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

/// A small stage: its files (the first is the root) and what it is about.
struct Feature {
    name: &'static str,
    files: &'static [(&'static str, &'static str)],
}

/// One composition feature each.
const FEATURES: &[Feature] = &[
    Feature {
        name: "references, with list ops, offsets and paths mapped",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(defaultPrim = "World"
upAxis = "Z"
metersPerUnit = 0.01
startTimeCode = 1
endTimeCode = 24
timeCodesPerSecond = 24)
def Xform "World" {
    def "A" (prepend references = @./asset.usda@) {
double speed = 3
}
    def "B" (references = [@./asset.usda@</Other>, @./asset.usda@ (offset = 10; scale = 2)]) {}
    def "C" (delete references = @./asset.usda@
prepend references = </World/A>) {
over "Geo" {
double radius = 7
}
}
}
"#,
            ),
            (
                "asset.usda",
                r#"#usda 1.0
(defaultPrim = "Asset"
timeCodesPerSecond = 48)
def Xform "Asset" (kind = "component"
prepend apiSchemas = ["MaterialBindingAPI"]) {
    double speed = 1
    double x.timeSamples = { 0: 0, 10: 10, 20: 40
}
    rel material:binding = </Asset/Looks/M> (bindMaterialAs = "strongerThanDescendants")
    def Sphere "Geo" {
double radius = 2
double radius.timeSamples = { 4: 1, 8: 3
}
rel to = [</Asset/Looks>, </Asset.speed>]
}
    def Scope "Looks" {
def Material "M" {
token outputs:surface.connect = </Asset/Looks/M/S.outputs:surface>
        def Shader "S" {
uniform token info:id = "UsdPreviewSurface"
token outputs:surface
}
}
}
}
def Xform "Other" {
double speed = 2
double y = 5
}
"#,
            ),
        ],
    },
    Feature {
        name: "sublayers with offsets: a default in a strong layer hides samples in a weak one",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(subLayers = [@./strong.usda@, @./weak.usda@ (offset = 5; scale = 0.5)])
over "P" {
double b.timeSamples = { 0: 1, 10: 2
}
double d = None
}
"#,
            ),
            (
                "strong.usda",
                r#"#usda 1.0
over "P" {
double a = 100
double e = 4
double e.timeSamples = { 0: 8
}
}
"#,
            ),
            (
                "weak.usda",
                r#"#usda 1.0
def Xform "P" {
double a.timeSamples = { 0: 1, 20: 2
}
double b = 7
double c.timeSamples = { 0: 0, 20: 20
}
double d = 9
    float2 blocked.timeSamples = { 0: (1, 1), 10: None, 20: (3, 3)
}
int held.timeSamples = { 0: 1, 20: 5
}
    double e = 5
timecode when = 3
}
"#,
            ),
        ],
    },
    Feature {
        name: "variants, nested and without a selection",
        files: &[(
            "root.usda",
            r#"#usda 1.0
def Xform "P" (variants = {
string shape = "ball"
string nothing = "missing"
}
prepend variantSets = ["shape", "unselected", "nothing"]) {
    variantSet "shape" = {
        "ball" (prepend variantSets = "size"
variants = {
string size = "big"
}) {
def Sphere "Geo" {}
variantSet "size" = { "big" {
over "Geo" {
double radius = 9
}
}
"small" { }
}
}
        "box" {
def Cube "Geo" {}
}
    }
    variantSet "unselected" = { "a" {
def Cone "A" {}
}
"b" {
def Cone "B" {}
}
}
    variantSet "nothing" = { "c" {
def Cone "C" {}
}
}
}
"#,
        )],
    },
    Feature {
        name: "inherits and specializes",
        files: &[(
            "root.usda",
            r#"#usda 1.0
class "_Class" {
double a = 1
double b = 1
def Sphere "In" {
double radius = 4
}
}
class Xform "_Base" {
double b = 2
double c = 2
rel r = </_Base/X>
def "X" {}
}
def Xform "P" (inherits = </_Class>
specializes = </_Base>) {
over "In" {
token visibility = "invisible"
}
}
def Xform "Q" (specializes = </_Base>
references = </R>) { }
def "R" {
double c = 3
double b = 3
}
"#,
        )],
    },
    Feature {
        name: "payloads, inactive, over, class, untyped",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
def "P" (payload = @./p.usda@</Pay>) {
over "Off" (active = false) {}
over "New" {
def Sphere "Lost" {}
}
}
over "Only" {
def Sphere "Unseen" {}
}
class "Abstract" {
def Sphere "Unseen" {}
}
def "Many" (payload = [@./p.usda@</Pay>, @./p.usda@</Pay2>]) {}
"#,
            ),
            (
                "p.usda",
                r#"#usda 1.0
def Xform "Pay" {
def Sphere "Off" {}
def Sphere "On" (hidden = true) {}
}
def "Pay2" {
def Cube "Second" {}
}
"#,
            ),
        ],
    },
    Feature {
        name: "native instances: shared, nested, different variants, overridden at the root, targets inside and outside",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
def Xform "World" {
    def "I1" (instanceable = true
references = @./asset.usda@) {
double3 xformOp:translate = (1, 0, 0)
uniform token[] xformOpOrder = ["xformOp:translate"]
rel out = </World/Free>
}
    def "I2" (instanceable = true
references = @./asset.usda@) {
over "Geo" {
double radius = 99
}
def Sphere "Ignored" {}
}
    def "I3" (instanceable = true
references = @./asset.usda@
variants = {
string v = "two"
}) { }
    def "Free" (instanceable = false
references = @./asset.usda@) {
over "Geo" {
double radius = 5
}
}
    def "NoArc" (instanceable = true) {
def Sphere "Seen" {}
}
    rel into = [</World/I1/Geo>, </World/I1>]
}
"#,
            ),
            (
                "asset.usda",
                r#"#usda 1.0
(defaultPrim = "Asset")
def Xform "Asset" (kind = "component"
variants = {
string v = "one"
}
prepend variantSets = "v") {
    double inherited = 1
    def Sphere "Geo" {
double radius = 1
rel material:binding = </Asset/Looks/M>
rel self = </Asset>
}
    def Scope "Looks" {
def Material "M" {
token outputs:surface.connect = </Asset/Looks/M/S.outputs:surface>
def Shader "S" {
token outputs:surface
}
}
}
    def "Nested1" (instanceable = true
references = </Leaf>) {}
    def "Nested2" (instanceable = true
references = </Leaf>) {}
    variantSet "v" = { "one" {
def Cube "One" {}
}
"two" {
def Cube "Two" {}
}
}
}
def Xform "Leaf" {
def Cone "Tip" {
rel up = </Leaf>
}
}
"#,
            ),
        ],
    },
    Feature {
        name: "every kind of value",
        files: &[(
            "root.usda",
            r#"#usda 1.0
def "P" {
    bool b = true
bool[] bs = [true, false]
uchar uc = 200
uchar[] ucs = [1, 255]
int i = -3
int[] is = [1, -2, 3]
    uint u = 4000000000
int64 l = -9007199254740993
int64[] ls = [1, -2]
uint64 ul = 7
    half h = 0.1
half[] hs = [0.1, 0.2]
float f = 0.1
float[] fs = [0.1, 2]
double d = 0.1
double[] ds = [0.1, 1e300]
    string s = "say \"hi\""
string[] ss = ["a", 'b']
token t = "tok"
token[] ts = ["x", "y"]
timecode tc = 4
    float2 f2 = (1, 2)
double2[] d2s = [(0.1, 2)]
half2 h2 = (0.1, 0.2)
int2 i2 = (3, 4)
texCoord2f[] st = [(0, 1), (2, 3)]
    float3 f3 = (1, 2, 3)
point3f[] p = [(1, 2, 3), (4, 5, 6)]
normal3h[] n = [(0.1, 0.2, 0.3)]
color3f c = (0.1, 0.2, 0.3)
vector3d v = (1, 2, 3)
int3 i3 = (1, 2, 3)
    float4 f4 = (1, 2, 3, 4)
color4f[] c4 = [(0.1, 0.2, 0.3, 0.4)]
double4 d4 = (1, 2, 3, 4)
half4[] h4 = [(1, 2, 3, 0.1)]
int4[] i4 = [(1, 2, 3, 4)]
    quatf q = (1, 2, 3, 4)
quath[] qh = [(1, 0, 0, 0.1)]
quatd qd = (0.5, 0.5, 0.5, 0.5)
    matrix4d m = ((1, 2, 3, 4), (5, 6, 7, 8), (9, 10, 11, 12), (13, 14, 15, 16))
matrix4d[] ms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (5, 6, 7, 1))]
    asset a = @./root.usda@
asset missing = @./nowhere.png@
asset[] as = [@a.png@, @b.png@]
float[] empty = []
float declared
    float nan = nan
float[] infs = [inf, -inf]
opaque o
double e = -1.5e-3
    float[] primvars:x = [1, 2, 3] (interpolation = "vertex"
elementSize = 3)
color3f[] primvars:c = [(1, 1, 1)] (colorSpace = "lin_rec709")
    int[] primvars:x:indices = [0]
}
"#,
        )],
    },
    Feature {
        name: "interpolation of every kind",
        files: &[(
            "root.usda",
            r#"#usda 1.0
def "P" {
    half h.timeSamples = { 0: 0.1, 10: 7.3
}
float f.timeSamples = { 0: 0.1, 10: 7.3
}
double d.timeSamples = { 0: 0.1, 10: 7.3
}
    float3 v.timeSamples = { 0: (0, 1, 2), 10: (3, 5, 9)
}
point3f[] p.timeSamples = { 0: [(0, 1, 2)], 10: [(3, 5, 9)]
}
    quatf q.timeSamples = { 0: (1, 0, 0, 0), 10: (0, 1, 0, 0)
}
quath[] qs.timeSamples = { 0: [(1, 0, 0, 0)], 10: [(-0.6, 0.8, 0, 0)]
}
    quatd same.timeSamples = { 0: (1, 0, 0, 0), 10: (1, 0, 0, 0)
}
    matrix4d m.timeSamples = { 0: ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)), 10: ((2, 0, 0, 0), (0, 2, 0, 0), (0, 0, 2, 0), (1, 2, 3, 1))
}
    float[] grows.timeSamples = { 0: [1], 10: [2, 3]
}
int i.timeSamples = { 0: 1, 10: 9
}
token t.timeSamples = { 0: "a", 10: "b"
}
bool b.timeSamples = { 0: 0, 10: 1
}
    int2 held.timeSamples = { 0: (0, 0), 10: (5, 5)
}
double one.timeSamples = { 3: 4
}
double none.timeSamples = {}
asset a.timeSamples = { 0: @./root.usda@, 10: @./x.usda@
}
    half3[] hv.timeSamples = { 0: [(0.1, 0.2, 0.3)], 10: [(1, 2, 3)]
}
double block.timeSamples = { 0: 1, 2: None, 8: 5
}
double tail.timeSamples = { 0: 1, 20: None
}
}
"#,
        )],
    },
    Feature {
        name: "list ops of relationships, connections and API schemas across layers",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(subLayers = [@./weak.usda@])
def "P" (prepend apiSchemas = ["A1"] ) {
prepend rel r = </X>
append float in.connect = </Y.out>
delete rel gone = </B>
rel empty = None
}
"#,
            ),
            (
                "weak.usda",
                r#"#usda 1.0
def "P" (append apiSchemas = ["A2", "A1"]) {
rel r = [</A>, </X>]
float in.connect = [</A.out>]
rel gone = [</A>, </B>]
rel empty = </A>
float in = 3
rel declared
}
def "X" {}
"#,
            ),
        ],
    },
    Feature {
        name: "reordering, relocates, names",
        files: &[(
            "root.usda",
            r#"#usda 1.0
reorder rootPrims = ["B", "A"]
def "A" {
reorder nameChildren = ["y", "x"]
def "x" {}
def "y" {}
reorder properties = ["q", "p"]
int p = 1
int q = 2
}
def "B" {
def "_under_score9" {
int a:b:c = 1
}
}
def "Élan" {}
"#,
        )],
    },
    Feature {
        name: "relocates",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(relocates = { </W/A/x>: </W/moved>
})
def "W" {
def "A" (references = @./a.usda@</A>) {}
}
"#,
            ),
            (
                "a.usda",
                r#"#usda 1.0
def "A" {
def Sphere "x" {
double radius = 3
rel t = </A/x>
}
rel t = </A/x>
}
"#,
            ),
        ],
    },
    Feature {
        name: "missing layers and paths are dropped",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(subLayers = [@./gone.usda@])
def "P" (references = [@./gone.usda@, @./a.usda@</Nothing>, @./a.usda@, </Nowhere>]) {
int kept = 1
}
def "Q" (payload = @./gone.mtlx@) { }
"#,
            ),
            (
                "a.usda",
                r#"#usda 1.0
def "A" {}
"#,
            ),
        ],
    },
    Feature {
        name: "cycles are cut",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(subLayers = [@./root.usda@])
def "P" (references = @./b.usda@</B>) {
int kept = 1
}
def "Self" (references = </Self>) {
def "Child" {}
}
def "Up" {
def "Down" (references = </Up>) {
int n = 1
}
}
def "I" (inherits = </J>) {}
def "J" (inherits = </I>) {
int j = 1
}
"#,
            ),
            (
                "b.usda",
                r#"#usda 1.0
def "B" (references = @./root.usda@</P>) {
int b = 2
}
"#,
            ),
        ],
    },
    Feature {
        name: "value clips",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
def "M" (clips = {
dictionary default = {
asset[] assetPaths = [@./c1.usda@, @./c2.usda@]
asset manifestAssetPath = @./manifest.usda@
string primPath = "/M"
    double2[] active = [(0, 0), (10, 1)]
double2[] times = [(0, 0), (10, 10), (20, 20)]
}
}) {
double a
double still = 5
def "K" {
double b
}
}
"#,
            ),
            (
                "manifest.usda",
                r#"#usda 1.0
def "M" {
double a
def "K" {
double b
}
}
"#,
            ),
            (
                "c1.usda",
                r#"#usda 1.0
def "M" {
double a.timeSamples = { 0: 0, 10: 10
}
def "K" {
double b.timeSamples = { 0: 1, 10: 2
}
}
}
"#,
            ),
            (
                "c2.usda",
                r#"#usda 1.0
def "M" {
double a.timeSamples = { 10: 100, 20: 200
}
def "K" {
double b.timeSamples = { 10: 3, 20: 4
}
}
}
"#,
            ),
        ],
    },
    Feature {
        name: "variable expressions",
        files: &[
            (
                "root.usda",
                r#"#usda 1.0
(expressionVariables = {
string WHICH = "a"
})
def "P" (references = @`"./${WHICH}.usda"`@</A>) {}
"#,
            ),
            (
                "a.usda",
                r#"#usda 1.0
def "A" {
int found = 1
}
"#,
            ),
        ],
    },
    Feature {
        name: "text that only Pixar's parser takes",
        files: &[(
            "root.usda",
            r#"#usda 1.0
( metersPerUnit = .01 )
def "P" ( active = True
kind = "component" ) {
    double a = .5
double b = 5.
float3 c = (.1, -.2, 0.)
float[] d = [1., .5, -.25, 2.e1]
asset e = "./root.usda"
asset[] f = ["a.png", 'b.png']
    // a comment
    double g.timeSamples = { .5: .25, 1.: 2.
}
    string h = "keep .5 and 5. and // this"
asset i = @./keep.5.@  # .5
}
def "Off" ( active = False ) {}
"#,
        )],
    },
];

#[test]
fn composition_features_read_like_usd_core_reads_them() {
    let Some(python) = python() else {
        return;
    };
    let mut failed = Vec::new();
    for feature in FEATURES {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (name, text) in feature.files {
            std::fs::write(folder.path().join(name), text).expect("a file");
        }
        let root = folder.path().join(feature.files[0].0);
        let cases =
            [None, Some(-1.0), Some(3.0), Some(6.5), Some(12.0)].map(|time| Case::new(&root, time));
        println!("{}:", feature.name);
        let tally = compare(&python, &cases);
        if !tally.different.is_empty() {
            failed.push(format!(
                "{}:\n  {}",
                feature.name,
                tally.different.join("\n  ")
            ));
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

/// A layer with what crate files encode in different ways: compressed and plain arrays, samples, list ops,
/// dictionaries, strings, variants.
const RICH: &str = r#"#usda 1.0
(defaultPrim = "World" customLayerData = { string tool = "t" dictionary more = { int n = 3 } })
def Xform "World" (kind = "group" prepend apiSchemas = ["MaterialBindingAPI"] variants = { string v = "a" } prepend variantSets = "v"
    inherits = </K> references = </K> payload = </K>) {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)]
    int[] faceVertexCounts = [3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3]
    float[] widths = [1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3]
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 5: (1, 2, 3) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
    string text = "hello"
    asset file = @./a.png@
    rel to = [</World/C>, </World>]
    def Sphere "C" { double radius = 2 color3f[] primvars:displayColor = [(1, 0, 0)] (interpolation = "constant") }
    variantSet "v" = { "a" { int chosen = 1 } "b" { int chosen = 2 } }
}
class "K" { def "Part" (inherits = </K/Base>) { double d = 1 } class "Base" {} }
"#;

fn binary(text: &str) -> Vec<u8> {
    let data = openusd::usda::parse(text).expect("the text is right");
    let mut bytes = std::io::Cursor::new(Vec::new());
    openusd::usdc::CrateWriter::write(&data, &mut bytes).expect("it can be written");
    bytes.into_inner()
}

/// Read `bytes` as a file called `name`, at two times; whatever is wrong with them must come back as an `Err`.
fn survive(folder: &Path, name: &str, bytes: &[u8]) {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a file");
    for time in [None, Some(2.0)] {
        let _ = native(&Case::new(&path, time), &Diagnostics::default());
    }
}

#[test]
fn truncated_files_are_errors() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let binary = binary(RICH);
    for length in (0..binary.len()).step_by(7) {
        survive(folder.path(), "cut.usdc", &binary[..length]);
    }
    for length in (0..RICH.len()).step_by(7) {
        survive(folder.path(), "cut.usda", &RICH.as_bytes()[..length]);
    }
}

/// Before version 0.4 tables were not compressed; the crate does not read those.
#[test]
fn old_binary_layers_are_refused_with_the_way_out() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("old.usdc");
    let mut bytes = binary(RICH);
    bytes[8..11].copy_from_slice(&[0, 3, 0]);
    std::fs::write(&path, bytes).expect("a file");
    let refused = native(&Case::new(&path, None), &Diagnostics::default());
    let message = refused.expect_err("too old").to_string();
    assert!(
        message.contains("old.usdc") && message.contains("--usd usd-core"),
        "{message}"
    );
}

#[test]
fn bit_flips_are_survived() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let binary = binary(RICH);
    for at in (0..binary.len()).step_by(3) {
        for flip in [0x01, 0xff] {
            let mut bytes = binary.clone();
            bytes[at] ^= flip;
            survive(folder.path(), "flipped.usdc", &bytes);
        }
    }
}

#[test]
fn class_arcs_in_circles_are_an_error_that_names_the_layer() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("circle.usda");
    for text in [
        "def \"W\" { def \"a\" (inherits = </W/b>) {} def \"b\" (inherits = </W/a>) {} }",
        "def \"W\" (inherits = </K> references = </K/P>) {}\n\
         class \"K\" { def \"P\" (inherits = </K/B>) {} class \"B\" {} }",
    ] {
        std::fs::write(&path, format!("#usda 1.0\n{text}\n")).expect("a file");
        let result = native(&Case::new(&path, None), &Diagnostics::default());
        let message = result.expect_err("a circle").to_string();
        let named = message.contains("circle.usda") && message.contains("run in circles");
        assert!(named, "{message}");
    }
}

#[test]
fn an_unreadable_referenced_layer_is_an_error_and_a_missing_one_a_warning() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let root = folder.path().join("root.usda");
    let write = |reference: &str| {
        let text = format!("#usda 1.0\ndef \"P\" (references = @./{reference}@</A>) {{}}\n");
        std::fs::write(&root, text).expect("a file");
        let diagnostics = Diagnostics::default();
        let result = native(&Case::new(&root, None), &diagnostics);
        (result, diagnostics.warnings())
    };
    std::fs::write(
        folder.path().join("bad.usda"),
        "#usda 1.0\ndef \"A\" { int a = }\n",
    )
    .expect("a file");
    let message = write("bad.usda").0.expect_err("a parse error").to_string();
    assert!(
        message.contains("bad.usda") && message.contains("--usd usd-core"),
        "{message}"
    );
    let (stage, warnings) = write("gone.usda");
    assert_eq!(stage.expect("the rest is read").prims.len(), 1);
    assert_eq!(warnings[0].kind, "missing-layer");
    assert!(
        warnings[0].message.contains("gone.usda"),
        "{}",
        warnings[0].message
    );
}

#[test]
fn masks_and_packages_read_like_usd_core_reads_them() {
    let Some(python) = python() else {
        return;
    };
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
    let tally = compare(&python, &cases);
    assert!(tally.different.is_empty(), "{}", tally.different.join("\n"));
}
