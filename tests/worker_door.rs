//! The usd-core door against stages whose composed values are known by hand, and against dying workers.

#[path = "support/python.rs"]
mod python;

use glam::{DMat4, DQuat, DVec2, DVec3, Vec2, Vec3, Vec4};
use python::{python, run_python};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use surflux::diagnostics::{CancelToken, Diagnostics, Silent};
use surflux::stage::Composition;
use surflux::stage::raw::{RawPrim, RawStage, Request, Value};
use surflux::stage::worker::WorkerSource;
use surflux::stage::{Error, Source};
use tempfile::TempDir;

struct Files(TempDir);

impl Files {
    fn new(files: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().expect("temp folder");
        for (name, text) in files {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().expect("in the folder")).expect("folder");
            // usda wants every prim to end its line
            let text = text.replace("} }", "}\n}").replace("} }", "}\n}");
            fs::write(path, format!("#usda 1.0\n{text}")).expect("written");
        }
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn open(&self, name: &str) -> WorkerSource {
        WorkerSource::open_with(&python(), &self.path(name), &Diagnostics::default())
            .expect("the stage opens")
    }

    fn load(&self, name: &str, request: &Request) -> (RawStage, Diagnostics) {
        let diagnostics = Diagnostics::default();
        let stage = self
            .open(name)
            .load(request, &diagnostics)
            .expect("the stage loads");
        (stage, diagnostics)
    }
}

fn everything(time: Option<f64>) -> Request {
    Request {
        time,
        mask: Vec::new(),
        attributes: vec!["*".to_owned()],
        composition: Composition::default(),
        values_not_needed: Vec::new(),
    }
}

fn prim<'a>(stage: &'a RawStage, path: &str) -> &'a RawPrim {
    let index = stage.find(path).unwrap_or_else(|| panic!("no prim {path}"));
    &stage.prims[index]
}

fn value<'a>(stage: &'a RawStage, path: &str, name: &str) -> Option<&'a Value> {
    prim(stage, path).attributes[name].value.as_ref()
}

const VALUES: &str = r#"
def "p" {
    bool b = 1
    uchar uc = 200
    int64 i = -5000000000
    uint64 u = 18446744073709551615
    half h = 0.5
    double d = 0.1
    double infinite = inf
    timecode t = 4
    token k = "word"
    string s = "a \"b\""
    double3 v = (0.1, 2, 3)
    int2 v2 = (1, 2)
    quatf q = (1, 2, 3, 4)
    matrix4d m = ((1,2,3,4),(5,6,7,8),(9,10,11,12),(13,14,15,16))
    bool[] ba = [1, 0]
    uchar[] uca = [255, 0]
    uint[] ua = [7]
    int64[] ia = [-5000000000]
    half[] ha = [0.5, 2]
    double[] da = [0.1]
    timecode[] ta = [1, 2]
    texCoord2f[] v2a = [(1, 2)]
    double3[] v3a = [(0.1, 2, 3), (4, 5, 6)]
    color4h[] v4a = [(1, 2, 3, 4)]
    int3[] vi = [(1, 2, 3)]
    quath[] qa = [(1, 2, 3, 4)]
    matrix4d[] ma = [((1,2,3,4),(5,6,7,8),(9,10,11,12),(13,14,15,16))]
    token[] ka = ["x", "y"]
    string[] sa = ["z"]
    point3f[] none = []
    float3 blocked = None
    asset file = @tex.png@
    asset tiles = @maps/c.<UDIM>.png@ ( colorSpace = "raw" )
    asset tiles_missing = @gone/c.<UDIM>.png@
    asset file_missing = @gone.png@
    float[] primvars:x = [1, 2] ( interpolation = "vertex"; elementSize = 2 )
    rel r = [</p>, </q.a>]
}
def "q" { float a.connect = </p.d>; }
"#;

fn value_is(stage: &RawStage, name: &str, expected: Value) {
    assert_eq!(value(stage, "/p", name), Some(&expected), "{name}");
}

fn counting() -> [f64; 16] {
    std::array::from_fn(|i| i as f64 + 1.0)
}

#[test]
fn single_values_of_every_type_arrive_as_authored() {
    let files = Files::new(&[("all.usda", VALUES)]);
    let (stage, _) = files.load("all.usda", &everything(None));
    let is = |name: &str, expected: Value| value_is(&stage, name, expected);
    is("b", Value::Bool(true));
    is("uc", Value::Int(200));
    is("i", Value::Int(-5_000_000_000));
    is("u", Value::Int(i64::MAX));
    is("h", Value::Float(0.5));
    is("d", Value::Float(0.1));
    is("infinite", Value::Float(f64::INFINITY));
    is("t", Value::Float(4.0));
    is("k", Value::Token("word".to_owned()));
    is("s", Value::Token("a \"b\"".to_owned()));
    is("v", Value::Vec3(DVec3::new(0.1, 2.0, 3.0)));
    is("v2", Value::Vec2(DVec2::new(1.0, 2.0)));
    is("q", Value::Quat(DQuat::from_xyzw(2.0, 3.0, 4.0, 1.0)));
    is(
        "m",
        Value::Matrix(Box::new(DMat4::from_cols_array(&counting()))),
    );
}

#[test]
fn arrays_of_every_type_arrive_as_authored() {
    let files = Files::new(&[("all.usda", VALUES)]);
    let (stage, _) = files.load("all.usda", &everything(None));
    let is = |name: &str, expected: Value| value_is(&stage, name, expected);
    let vec3 = |x, y, z| Vec3::new(x, y, z);
    is("ba", Value::IntArray(vec![1, 0]));
    is("uca", Value::IntArray(vec![255, 0]));
    is("ua", Value::IntArray(vec![7]));
    is("ia", Value::Int64Array(vec![-5_000_000_000]));
    is("ha", Value::FloatArray(vec![0.5, 2.0]));
    is("da", Value::FloatArray(vec![0.1]));
    is("ta", Value::FloatArray(vec![1.0, 2.0]));
    is("v2a", Value::Vec2Array(vec![Vec2::new(1.0, 2.0)]));
    is(
        "v3a",
        Value::Vec3Array(vec![vec3(0.1, 2.0, 3.0), vec3(4.0, 5.0, 6.0)]),
    );
    is("v4a", Value::Vec4Array(vec![Vec4::new(1.0, 2.0, 3.0, 4.0)]));
    is("vi", Value::Vec3Array(vec![vec3(1.0, 2.0, 3.0)]));
    is("qa", Value::QuatArray(vec![Vec4::new(2.0, 3.0, 4.0, 1.0)]));
    is(
        "ma",
        Value::MatrixArray(vec![DMat4::from_cols_array(&counting())]),
    );
    is(
        "ka",
        Value::TokenArray(vec!["x".to_owned(), "y".to_owned()]),
    );
    is("sa", Value::TokenArray(vec!["z".to_owned()]));
    is("none", Value::Vec3Array(Vec::new()));
}

#[test]
fn assets_resolve_next_to_their_layer_and_patterns_stay() {
    let files = Files::new(&[
        ("all.usda", VALUES),
        ("maps/c.1002.png", ""),
        ("tex.png", ""),
    ]);
    let (stage, diagnostics) = files.load("all.usda", &everything(None));
    let is = |name: &str, authored: &str, resolved: &str| {
        let expected = Value::Asset {
            authored: authored.to_owned(),
            resolved: match resolved {
                "" => String::new(),
                file => files.path(file).display().to_string(),
            },
        };
        value_is(&stage, name, expected);
    };
    is("file", "tex.png", "tex.png");
    is("file_missing", "gone.png", "");
    is("tiles", "maps/c.<UDIM>.png", "maps/c.<UDIM>.png");
    is("tiles_missing", "gone/c.<UDIM>.png", "gone/c.<UDIM>.png");
    assert_eq!(diagnostics.warnings(), []);
}

#[test]
fn what_is_authored_about_a_value_comes_with_it() {
    let files = Files::new(&[("all.usda", VALUES)]);
    let (stage, _) = files.load("all.usda", &everything(None));
    assert_eq!(value(&stage, "/p", "blocked"), None);
    let p = prim(&stage, "/p");
    assert_eq!(p.attributes["tiles"].color_space.as_deref(), Some("raw"));
    assert_eq!(
        p.attributes["primvars:x"].interpolation.as_deref(),
        Some("vertex")
    );
    assert_eq!(p.attributes["primvars:x"].element_size, Some(2));
    assert_eq!(p.relationships["r"].targets, ["/p", "/q.a"]);
    let q = &prim(&stage, "/q").attributes["a"];
    assert_eq!(
        (q.connections.as_slice(), &q.value),
        (["/p.d".to_owned()].as_slice(), &None)
    );
}

const ARCS: &[(&str, &str)] = &[
    (
        "root.usda",
        r#"( subLayers = [ @over.usda@ (offset = 10; scale = 2) ]; defaultPrim = "w"; upAxis = "Z"; metersPerUnit = 0.1
                 startTimeCode = 1; endTimeCode = 2.5; timeCodesPerSecond = 24; renderSettingsPrimPath = "/Render/s" )
class "_c" { double size = 3; double base = 1; }
def Cube "w" ( prepend references = @asset.usda@</a>; inherits = </_c>; variants = { string v = "red" }; kind = "component"
               prepend apiSchemas = ["MaterialBindingAPI", "CollectionAPI:plasticStuff"] ) {
    rel material:binding = </w/inside> ( bindMaterialAs = "strongerThanDescendants" )
    rel material:binding:preview = </w/inside>
}
def "off" ( active = false ) { def "below" {} }
over "undefined" { float a = 1; }
def Sphere "s" { double radius.timeSamples = { 1: 2, 3: 4 }; double fixed.timeSamples = { 1: 7 }; }
"#,
    ),
    (
        "over.usda",
        r#"over "w" { double moving.timeSamples = { 0: 0, 10: 10 }; }"#,
    ),
    (
        "asset.usda",
        r#"def "a" ( prepend payload = @payload.usda@</p>; append variantSets = "v" ) {
    double base = 5
    variantSet "v" = { "red" { double size = 9; string from = "red"; } "blue" { string from = "blue"; } }
}"#,
    ),
    ("payload.usda", r#"def "p" { def "inside" { int i = 1; } }"#),
];

#[test]
fn arcs_compose_and_samples_follow_layer_offsets() {
    let files = Files::new(ARCS);
    let (stage, diagnostics) = files.load("root.usda", &everything(Some(15.0)));
    assert_eq!(diagnostics.warnings(), []);
    let paths: Vec<_> = stage.prims.iter().map(|prim| prim.path.as_str()).collect();
    assert_eq!(
        paths,
        ["/w", "/w/inside", "/s"],
        "active, defined, not abstract, depth first"
    );
    assert_eq!(stage.prototype_start, 3);
    assert_eq!(stage.prims[1].parent, Some(0));
    assert_eq!(
        (
            stage.prims[0].type_name.as_str(),
            stage.prims[0].kind.as_deref()
        ),
        ("Cube", Some("component"))
    );
    // a class is stronger than a variant, a variant than a reference
    assert_eq!(value(&stage, "/w", "size"), Some(&Value::Float(3.0)));
    assert_eq!(value(&stage, "/w", "base"), Some(&Value::Float(1.0)));
    assert_eq!(
        value(&stage, "/w", "from"),
        Some(&Value::Token("red".to_owned()))
    );
    // stage time 15 is layer time (15 - 10) / 2
    assert_eq!(value(&stage, "/w", "moving"), Some(&Value::Float(2.5)));
    assert!(prim(&stage, "/w").attributes["moving"].varying);
    let binding = &prim(&stage, "/w").relationships["material:binding"];
    assert_eq!(
        binding.bind_material_as.as_deref(),
        Some("strongerThanDescendants")
    );
    assert_eq!(
        prim(&stage, "/w").relationships["material:binding:preview"].bind_material_as,
        None
    );
    assert_eq!(
        prim(&stage, "/w").api_schemas,
        ["MaterialBindingAPI", "CollectionAPI:plasticStuff"]
    );
}

#[test]
fn stage_metadata_and_layers_are_told() {
    let files = Files::new(ARCS);
    let (stage, _) = files.load("root.usda", &everything(None));
    let meta = &stage.meta;
    assert_eq!(
        (meta.up_axis.as_deref(), meta.meters_per_unit),
        (Some("Z"), Some(0.1))
    );
    assert_eq!(
        (meta.start_time_code, meta.end_time_code),
        (Some(1.0), Some(2.5))
    );
    assert_eq!(meta.time_codes_per_second, Some(24.0));
    assert_eq!(meta.render_settings_prim_path.as_deref(), Some("/Render/s"));
    assert_eq!(meta.default_prim.as_deref(), Some("w"));
    let names: Vec<_> = meta
        .layers
        .iter()
        .filter_map(|layer| Path::new(layer).file_name())
        .collect();
    assert_eq!(
        names,
        ["asset.usda", "over.usda", "payload.usda", "root.usda"]
    );
}

#[test]
fn samples_interpolate_at_fractional_times_and_are_no_default() {
    let files = Files::new(&[(
        "t.usda",
        "def Sphere \"s\" { double radius.timeSamples = { 1: 2, 3: 4 }; double one.timeSamples = { 1: 7 }; }\n",
    )]);
    let mut source = files.open("t.usda");
    let diagnostics = Diagnostics::default();
    let mut at = |time| {
        let stage = source.load(&everything(time), &diagnostics).expect("loads");
        value(&stage, "/s", "radius").cloned()
    };
    assert_eq!(at(Some(1.5)), Some(Value::Float(2.5)));
    assert_eq!(
        at(Some(9.0)),
        Some(Value::Float(4.0)),
        "held after the last sample"
    );
    assert_eq!(at(None), None, "the fallback of the schema is not authored");
    let stage = source.load(&everything(None), &diagnostics).expect("loads");
    assert!(stage.meta.start_time_code.is_none() && stage.meta.up_axis.is_none());
    let unread = &prim(&stage, "/s").attributes["one"];
    assert!(
        unread.varying && unread.value.is_none(),
        "its sample is told of"
    );
    let read = source
        .load(&everything(Some(1.0)), &diagnostics)
        .expect("loads");
    assert!(
        !prim(&read, "/s").attributes["one"].varying,
        "one sample is the same at all times"
    );
}

const INSTANCES: &str = r#"
def "A" ( instanceable = true; prepend references = </_inner> ) {}
def "B" ( instanceable = true; prepend references = </_outer> ) {}
def "C" ( instanceable = true; prepend references = </_outer> ) { float own = 1; }
def PointInstancer "I" {
    rel prototypes = </I/P>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(0, 0, 0), (1, 2, 3)]
    def "P" { def Mesh "m" { int[] faceVertexCounts = [3]; } }
}
class "_outer" { def "nested" ( instanceable = true; prepend references = </_inner> ) {}
    def "twice" ( instanceable = true; prepend references = </_inner> ) {} }
class "_inner" { def Mesh "leaf" { rel to = </_inner/leaf>; float a = 1; } }
"#;

#[test]
fn prims_below_instances_appear_once_below_their_prototype() {
    let files = Files::new(&[("i.usda", INSTANCES)]);
    let (stage, _) = files.load("i.usda", &everything(None));
    let paths: Vec<_> = stage.prims.iter().map(|prim| prim.path.as_str()).collect();
    assert_eq!(
        paths,
        [
            "/A",
            "/B",
            "/C",
            "/I",
            "/I/P",
            "/I/P/m",
            "/__Prototype_1",
            "/__Prototype_1/leaf",
            "/__Prototype_2",
            "/__Prototype_2/nested",
            "/__Prototype_2/twice"
        ]
    );
    assert_eq!(stage.prototype_start, 6);
    let prototype = |path| {
        prim(&stage, path)
            .prototype
            .map(|i| stage.prims[i].path.as_str())
    };
    assert_eq!(prototype("/A"), Some("/__Prototype_1"));
    assert_eq!(
        (prototype("/B"), prototype("/C")),
        (Some("/__Prototype_2"), Some("/__Prototype_2"))
    );
    assert_eq!(prototype("/__Prototype_2/nested"), Some("/__Prototype_1"));
    assert_eq!(prototype("/I"), None);
    assert_eq!(prim(&stage, "/__Prototype_1").parent, None);
    assert_eq!(
        prim(&stage, "/__Prototype_1/leaf").relationships["to"].targets,
        ["/__Prototype_1/leaf"]
    );
    assert_eq!(
        prim(&stage, "/I").relationships["prototypes"].targets,
        ["/I/P"]
    );
    let positions = Value::Vec3Array(vec![Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0)]);
    assert_eq!(value(&stage, "/I", "positions"), Some(&positions));
}

#[test]
fn two_workers_agree_to_the_bit() {
    let files = Files::new(&[("i.usda", INSTANCES)]);
    let load = || files.load("i.usda", &everything(None)).0;
    assert_eq!(load(), load());
}

#[test]
fn only_what_the_request_wants_is_read() {
    let files = Files::new(&[(
        "r.usda",
        "def \"p\" { float[] primvars:a = [1]; float[] primvars:b = [2]; float other = 3; float size = 4; }\n",
    )]);
    let request = Request {
        time: None,
        mask: Vec::new(),
        attributes: vec!["primvars:*".to_owned(), "size".to_owned()],
        composition: Composition::default(),
        values_not_needed: vec!["primvars:b".to_owned()],
    };
    let (stage, _) = files.load("r.usda", &request);
    assert_eq!(
        value(&stage, "/p", "primvars:a"),
        Some(&Value::FloatArray(vec![1.0]))
    );
    assert_eq!(value(&stage, "/p", "primvars:b"), None);
    assert_eq!(
        prim(&stage, "/p").attributes["primvars:b"].type_name,
        "float[]"
    );
    assert_eq!(value(&stage, "/p", "size"), Some(&Value::Float(4.0)));
    assert_eq!(prim(&stage, "/p").unread, ["other"]);
}

#[test]
fn a_mask_keeps_the_prims_asked_for_and_the_materials_they_need() {
    let files = Files::new(&[(
        "m.usda",
        r#"
def "world" {
    def "kept" { def "below" { rel material:binding = </looks/a>; } }
    def "dropped" { rel material:binding = </looks/b>; }
}
def "looks" {
    def Material "a" { token outputs:surface.connect = </shaders/s.outputs:out>; }
    def Material "b" {}
}
def "shaders" { def Shader "s" { token outputs:out; }
 def Shader "unused" {} }
"#,
    )]);
    let request = Request {
        mask: vec!["/world/kept".to_owned()],
        ..everything(None)
    };
    let (stage, _) = files.load("m.usda", &request);
    let paths: Vec<_> = stage.prims.iter().map(|prim| prim.path.as_str()).collect();
    assert_eq!(
        paths,
        [
            "/world",
            "/world/kept",
            "/world/kept/below",
            "/looks",
            "/looks/a",
            "/shaders",
            "/shaders/s"
        ]
    );
}

#[test]
fn missing_layers_are_warned_of_once_each() {
    let files = Files::new(&[(
        "w.usda",
        "def \"p\" ( prepend payload = @gone.usda@ ) {}\ndef \"q\" ( prepend references = @away.usda@ ) {}\n",
    )]);
    let mut source = files.open("w.usda");
    let diagnostics = Diagnostics::default();
    for _ in 0..2 {
        let stage = source.load(&everything(None), &diagnostics).expect("loads");
        assert_eq!(stage.prims.len(), 2);
    }
    let warnings = diagnostics.warnings();
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    let about = |prim: &str, file: &str| {
        warnings.iter().any(|w| {
            w.kind == "usd"
                && w.prim == prim
                && w.message.contains(file)
                && !w.message.contains("0x")
        })
    };
    assert!(
        about("/p", "gone.usda") && about("/q", "away.usda"),
        "{warnings:?}"
    );
}

#[test]
fn files_that_are_missing_or_broken_are_told_apart() {
    let files = Files::new(&[("broken.usda", "def \"p\" { float a = \n}\n")]);
    let open = |name: &str| {
        WorkerSource::open_with(&python(), &files.path(name), &Diagnostics::default())
            .expect_err("no stage")
            .to_string()
    };
    assert!(matches!(
        WorkerSource::open_with(
            &python(),
            &files.path("absent.usda"),
            &Diagnostics::default()
        ),
        Err(Error::Unreadable { .. })
    ));
    let broken = open("broken.usda");
    let names_line = broken.contains("broken.usda:2:") || broken.contains("line 2");
    assert!(names_line, "{broken}");

    let whole = files.path("whole.usdc");
    run_python(
        "import sys; from pxr import Usd, Sdf; s = Usd.Stage.CreateNew(sys.argv[1])\n\
         p = s.DefinePrim('/p'); p.CreateAttribute('a', Sdf.ValueTypeNames.FloatArray).Set([float(i) for i in range(1000)]); s.Save()",
        &[&whole],
    );
    let bytes = fs::read(&whole).expect("written");
    fs::write(files.path("truncated.usdc"), &bytes[..bytes.len() / 2]).expect("written");
    let error = WorkerSource::open_with(
        &python(),
        &files.path("truncated.usdc"),
        &Diagnostics::default(),
    )
    .expect_err("no stage");
    assert!(
        matches!(&error, Error::Layer { message, .. } if !message.is_empty()),
        "{error}"
    );
}

#[test]
fn interpreters_that_cannot_do_it_are_named_with_a_remedy() {
    let files = Files::new(&[("s.usda", "")]);
    let script = |name: &str, text: &str| {
        let path = files.path(name);
        fs::write(&path, text).expect("written");
        #[cfg(unix)]
        fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o755))
            .expect("mode");
        path
    };
    let plain = script(
        "plain",
        &format!("#!/bin/sh\nexec {} -I -S \"$@\"\n", python().display()),
    );
    let talker = script("talker", "#!/bin/sh\necho hello; cat\n");
    let crasher = script(
        "crasher",
        "#!/bin/sh\necho broken installation >&2; exit 3\n",
    );
    for (interpreter, said) in [
        (PathBuf::from("/nonexistent/python"), "cannot be started"),
        (plain, "cannot import pxr and numpy"),
        (talker, "hello"),
        (
            crasher,
            "exit code 3; the end of its stderr:\nbroken installation",
        ),
    ] {
        let start = Instant::now();
        let error =
            WorkerSource::open_with(&interpreter, &files.path("s.usda"), &Diagnostics::default())
                .expect_err("no worker");
        assert!(matches!(error, Error::Worker { .. }));
        let text = error.to_string();
        assert!(
            text.contains(said) && text.contains("SURFLUX_USD_PYTHON"),
            "{text}"
        );
        assert!(start.elapsed() < Duration::from_secs(20));
    }
}

fn is_running(pid: u32) -> bool {
    Path::new(&format!("/proc/{pid}")).exists()
}

#[cfg(target_os = "linux")]
#[test]
fn a_killed_worker_is_an_error_and_a_dropped_one_is_gone() {
    let files = Files::new(&[("i.usda", INSTANCES)]);
    let mut source = files.open("i.usda");
    let pid = source.process_id();
    assert!(is_running(pid));
    let killed = Command::new("kill")
        .args(["-9", &pid.to_string()])
        .status()
        .expect("kill runs");
    assert!(killed.success());
    let error = source
        .load(&everything(None), &Diagnostics::default())
        .expect_err("dead");
    assert!(error.to_string().contains("killed by signal 9"), "{error}");
    drop(source);
    assert!(!is_running(pid), "reaped, not left as a zombie");

    let source = files.open("i.usda");
    let pid = source.process_id();
    drop(source);
    assert!(!is_running(pid));
}

/// Root layer whose composition takes usd-core many seconds: each level references the one below ten times.
fn endless(files: &Files) -> PathBuf {
    let mut text = String::from("#usda 1.0\nclass \"c0\" { float a = 1\n}\n");
    for level in 1..7 {
        let children: String = (0..10)
            .map(|i| {
                format!(
                    "def \"x{i}\" ( prepend references = </c{}> ) {{}}\n",
                    level - 1
                )
            })
            .collect();
        text += &format!("class \"c{level}\" {{ {children} }}\n");
    }
    text += "def \"all\" ( prepend references = </c6> ) {}\n";
    let path = files.path("endless.usda");
    fs::write(&path, text).expect("written");
    path
}

#[cfg(target_os = "linux")]
#[test]
fn cancelling_ends_a_worker_in_the_middle_of_its_work() {
    let files = Files::new(&[]);
    let mut source = WorkerSource::open_with(&python(), &endless(&files), &Diagnostics::default())
        .expect("opens");
    let pid = source.process_id();
    let token = CancelToken::default();
    let diagnostics = Diagnostics::new(Box::new(Silent), token.clone());
    let canceller = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(300));
        token.cancel();
    });
    let start = Instant::now();
    let result = source.load(&everything(None), &diagnostics);
    assert!(
        matches!(result, Err(Error::Cancelled(_))),
        "{:?}",
        result.map(|s| s.prims.len())
    );
    assert!(start.elapsed() < Duration::from_secs(3));
    assert!(!is_running(pid));
    canceller.join().expect("joined");
}

#[cfg(target_os = "linux")]
#[test]
fn a_worker_killed_half_way_fails_the_load_at_once() {
    let files = Files::new(&[]);
    let mut source = WorkerSource::open_with(&python(), &endless(&files), &Diagnostics::default())
        .expect("opens");
    let pid = source.process_id();
    let killer = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(300));
        Command::new("kill")
            .args(["-9", &pid.to_string()])
            .status()
            .expect("kill runs");
    });
    let start = Instant::now();
    let error = source
        .load(&everything(None), &Diagnostics::default())
        .expect_err("killed");
    assert!(matches!(error, Error::Worker { .. }), "{error}");
    assert!(start.elapsed() < Duration::from_secs(4));
    killer.join().expect("joined");
}
