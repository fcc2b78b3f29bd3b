//! Settings that are not typed: SurfluxBakeSettings on the stage, `--config`, variables; who wins, and what
//! `--print-config` tells of it. The schema against usdGenSchema and usd-core.

use crate::program::{json, stderr};
use crate::python::{python, run_python, tools};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const SCHEMAS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/surflux");

/// A sheet below a lid and a camera; settings below `/Render`, and others elsewhere.
const STAGE: &str = r#"#usda 1.0
(
    upAxis = "Y"
)
def Mesh "sheet" {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)]
    uniform token subdivisionScheme = "none"
}
def Mesh "lid" {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0)]
    uniform token subdivisionScheme = "none"
}
def Camera "cam" {
    double3 xformOp:translate = (0.5, 0.5, 4)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def Scope "Render" {
    def SurfluxBakeSettings "draft" {
        uniform token[] surflux:aov = ["visibility", "bent_normal"]
        uniform int surflux:bounces = -1
        uniform float surflux:maxDistance = 0.7
        uniform token surflux:gather = "rays"
        uniform int surflux:rays = 48
        uniform int surflux:surfels = 900
        uniform int surflux:pixelSamples = 2
        uniform bool surflux:hideLights = true
        uniform token[] includedPurposes = ["default", "proxy"]
        uniform int2 resolution = (24, 12)
        rel camera = </cam>
        rel products = </Render/image>
    }
    def RenderProduct "image" {
        uniform token productName = "product.exr"
    }
    def SurfluxBakeSettings "final" {
        uniform double surflux:tolerance = 0.02
    }
}
"#;

/// The program, with a Python for the door of usd-core.
fn surflux() -> Command {
    let mut program = crate::program::surflux();
    program.env("SURFLUX_USD_PYTHON", python());
    program
}

fn run<A: AsRef<std::ffi::OsStr>>(args: &[A]) -> Output {
    surflux().args(args).output().expect("the program starts")
}

fn stage(text: &str) -> (tempfile::TempDir, PathBuf) {
    crate::program::stage(text)
}

/// What `--print-config` tells of `command` on `stage`.
fn told(command: &str, stage: &Path, more: &[&str], variables: &[(&str, &str)]) -> Value {
    let mut program = surflux();
    program.args([command]).arg(stage).arg("--print-config");
    let output = program.args(more).envs(variables.iter().copied());
    let told = json(&output.output().expect("the program starts"));
    told[command].clone()
}

/// The value and the source of a setting.
fn setting(told: &Value, flag: &str) -> (Value, String) {
    let from = told[flag]["from"].as_str().expect("a source").to_owned();
    (told[flag]["value"].clone(), from)
}

#[test]
fn what_is_typed_wins_over_variables_these_over_the_stage_it_over_the_file() {
    let (folder, path) = stage(STAGE);
    let config = folder.path().join("mine.json");
    fs::write(
        &config,
        r#"{"rays": 500, "usd": "native", "render": {"pixel-samples": 8, "image-width": 99}, "max-solid-angle": 0.25,
            "view": {"range": "0:1"}, "spacing": 0.5}"#,
    )
    .expect("writable");
    let config = config.to_str().expect("UTF-8");
    let typed = ["--config", config, "--bounces", "3"];
    let told = told("render", &path, &typed, &[("SURFLUX_RAYS", "77")]);
    let place = |attribute: &str| format!("{}: /Render/draft.{attribute}", path.display());
    let in_file = |key: &str| format!("{config}: {key}");
    let expected = [
        ("bounces", json!(3), "typed".to_owned()),
        ("rays", json!(77), "SURFLUX_RAYS".to_owned()),
        ("max-distance", json!(0.7), place("surflux:maxDistance")),
        ("pixel-samples", json!(2), place("surflux:pixelSamples")),
        ("hide-lights", json!(true), place("surflux:hideLights")),
        (
            "purposes",
            json!(["default", "proxy"]),
            place("includedPurposes"),
        ),
        (
            "aov",
            json!(["visibility", "bent_normal"]),
            place("surflux:aov"),
        ),
        // the stage has surfels, which exclude a spacing
        ("spacing", Value::Null, "not set".to_owned()),
        ("usd", json!("native"), in_file("usd")),
        ("image-width", json!(99), in_file("render.image-width")),
        ("max-solid-angle", json!(0.25), in_file("max-solid-angle")),
        ("map-pixel", json!("1"), "default".to_owned()),
    ];
    for (flag, value, from) in expected {
        let (found, place) = setting(&told, flag);
        let found = match (flag, found) {
            ("map-pixel", Value::Number(number)) => json!(number.to_string()),
            (_, found) => found,
        };
        assert_eq!((found, place), (value, from), "{flag}");
    }
}

#[test]
fn what_is_told_is_a_configuration_that_says_the_same() {
    let (folder, path) = stage(STAGE);
    let mut program = surflux();
    program.arg("bake").arg(&path).args([
        "--print-config",
        "--rays",
        "33",
        "-vv",
        "--usd",
        "native",
    ]);
    let first = program.output().expect("the program starts");
    let value = json(&first);
    let file = folder.path().join("told.json");
    fs::write(&file, &first.stdout).expect("writable");
    let file = file.to_str().expect("UTF-8");
    let again = told(
        "bake",
        &path,
        &["--config", file, "--settings", "none"],
        &[],
    );
    for (flag, setting) in value["bake"].as_object().expect("flags") {
        if flag != "settings" {
            assert_eq!(again[flag]["value"], setting["value"], "{flag}");
        }
    }
    let schema = concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/config.schema.json");
    const CHECK: &str = "
import sys, json, jsonschema
schema = json.load(open(sys.argv[1]))
jsonschema.Draft202012Validator.check_schema(schema)
jsonschema.validate(json.load(open(sys.argv[2])), schema)
";
    run_python(CHECK, &[schema, file]);
}

/// The lines of a bake that hold results.
fn baked_lines(name: &str) -> Vec<String> {
    let text = fs::read_to_string(name).expect("readable");
    let is_result = |line: &&str| line.contains("primvars:") || line.contains("displayColor");
    text.lines().filter(is_result).map(str::to_owned).collect()
}

#[test]
fn settings_on_the_stage_drive_bakes_and_renders_as_flags_do_through_both_doors() {
    let (folder, path) = stage(STAGE);
    let stage = path.to_str().expect("UTF-8");
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let flags = [
        "--max-distance",
        "0.7",
        "--gather",
        "rays",
        "--rays",
        "48",
        "--surfels",
        "900",
        "--bounces",
        "auto",
    ];
    for door in ["native", "usd-core"] {
        let run = |command: &str, out: &str, more: &[&str]| {
            let fixed = [command, stage, "-o", out, "--usd", door, "--json"];
            json(&run(&[&fixed[..], more].concat()))
        };
        let (by_stage, by_flags) = (at("by_stage.usda"), at("by_flags.usda"));
        run("bake", &by_stage, &[]);
        let aov = [
            "--settings",
            "none",
            "--aov",
            "visibility,bent_normal",
            "--purposes",
            "proxy",
        ];
        run("bake", &by_flags, &[&flags[..], &aov].concat());
        assert!(
            baked_lines(&by_stage).len() >= 4,
            "{door}: two results on two meshes"
        );
        assert_eq!(baked_lines(&by_stage), baked_lines(&by_flags), "{door}");

        let image = run("render", &at("i.exr"), &[]);
        assert_eq!(image["settings"]["image"], json!([24, 12]), "{door}");
        assert_eq!(image["settings"]["camera"], "/cam");
        assert_eq!(image["settings"]["pixel_samples"], 2);
        assert_eq!(image["settings"]["rays"], 48);
        let fine = run(
            "render",
            &at("f.exr"),
            &[
                "--settings",
                "/Render/final",
                "--aov",
                "visibility",
                "--image-width",
                "8",
            ],
        );
        assert_eq!(fine["error"]["tolerance"], 0.02, "{door}: the other prim");
    }
}

#[test]
fn the_settings_that_the_stage_names_are_taken_wherever_they_are() {
    let named = STAGE.replacen(
        "upAxis",
        "renderSettingsPrimPath = \"/elsewhere/mine\"\n    upAxis",
        1,
    );
    let named = named
        + "def Scope \"elsewhere\" {\n def SurfluxBakeSettings \"mine\" {\n uniform int surflux:rays = 21\n }\n}\n";
    let (_folder, path) = stage(&named);
    for door in ["native", "usd-core"] {
        let told = told("bake", &path, &["--usd", door], &[]);
        assert_eq!(told["rays"]["value"], 21, "{door}");
        assert_eq!(told["max-distance"]["value"], Value::Null, "{door}");
    }
}

#[test]
fn what_no_flag_takes_is_told_with_its_place_and_nothing_is_written() {
    let wrong = [
        (
            "uniform int surflux:rays = 48",
            "uniform int surflux:rays = 3",
            "/Render/draft.surflux:rays: invalid value '3'",
        ),
        (
            "surflux:maxDistance = 0.7",
            "surflux:maxDistanse = 0.7",
            "/Render/draft.surflux:maxDistanse: SurfluxBakeSettings has no such attribute",
        ),
        (
            "uniform int surflux:rays = 48",
            "float3 surflux:rays = (1, 2, 3)",
            "a value of type float3 says nothing about --rays",
        ),
        (
            "surflux:gather = \"rays\"",
            "surflux:gather = \"magic\"",
            "/Render/draft.surflux:gather: invalid value 'magic'",
        ),
    ];
    for (right, odd, message) in wrong {
        let (folder, path) = stage(&STAGE.replacen(right, odd, 1));
        let out = folder.path().join("o.usdc");
        for door in ["native", "usd-core"] {
            let output = surflux()
                .arg("bake")
                .arg(&path)
                .arg("-o")
                .arg(&out)
                .args(["--usd", door])
                .output()
                .expect("the program starts");
            assert_eq!(output.status.code(), Some(1), "{door} {odd}");
            assert!(
                stderr(&output).contains(message),
                "{door}: {}",
                stderr(&output)
            );
            assert!(!out.exists());
        }
    }
    let (_folder, path) = stage(STAGE);
    let path = path.to_str().expect("UTF-8");
    let output = run(&[
        "bake",
        path,
        "-o",
        "x.usdc",
        "--settings",
        "/Render/gone",
        "--usd",
        "native",
    ]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("--settings /Render/gone: there is no SurfluxBakeSettings prim")
    );
}

#[test]
fn a_configuration_that_says_what_no_command_takes_is_refused() {
    let (folder, path) = stage(STAGE);
    let file = folder.path().join("c.json");
    let path = path.to_str().expect("UTF-8");
    let name = file.to_str().expect("UTF-8");
    let wrong = [
        ("{\"raise\": 3}", "raise: no command has a flag --raise"),
        (
            "{\"bake\": {\"camera\": \"x\"}}",
            "bake.camera: bake has no flag --camera",
        ),
        ("{\"bake\": 3}", "bake: an object of flags is needed"),
        ("{\"rays\": {\"from\": \"x\"}}", "rays: a value is needed"),
        (
            "{\"rays\": [[1]]}",
            "rays: text, a number, true, false, or a list",
        ),
        ("{\"rays\": 3}", "rays: invalid value '3'"),
        (
            "{\"preview\": 2, \"json\": \"maybe\"}",
            "json: true or false is needed",
        ),
        ("[1]", "is no JSON object"),
        ("{", "is no JSON object"),
    ];
    for (text, message) in wrong {
        fs::write(&file, text).expect("writable");
        let output = run(&["bake", path, "-o", "x.usdc", "--config", name]);
        assert_eq!(output.status.code(), Some(2), "{text}: {}", stderr(&output));
        assert!(
            stderr(&output).contains(message),
            "{text}: {}",
            stderr(&output)
        );
    }
    let over = run(&["bake", path, "-o", path, "--usd", "native"]);
    assert_eq!(over.status.code(), Some(2));
    assert!(stderr(&over).contains("that is the file that is read"));
    let gone = run(&["bake", path, "-o", "x.usdc", "--config", "gone.json"]);
    assert!(
        stderr(&gone).contains("cannot read --config gone.json"),
        "{}",
        stderr(&gone)
    );
}

/// `usdGenSchema` of `schema.usda` is what lies beside it.
#[test]
fn the_schemas_are_what_usd_makes_of_their_source() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let made = Command::new(python())
        .env("PYTHONPATH", tools())
        .args(["-m", "pxr.Usd.usdGenSchema"])
        .arg(Path::new(SCHEMAS).join("schema.usda"))
        .arg(folder.path())
        .output()
        .expect("Python starts");
    assert!(made.status.success(), "{}", stderr(&made));
    let read = |path: &Path| fs::read_to_string(path).expect("readable");
    let generated = read(&folder.path().join("generatedSchema.usda"));
    assert_eq!(
        generated,
        read(&Path::new(SCHEMAS).join("generatedSchema.usda"))
    );
    let plugin = read(&folder.path().join("plugInfo.json"))
        .replace("@PLUG_INFO_LIBRARY_PATH@", "")
        .replace("@PLUG_INFO_RESOURCE_PATH@", ".")
        .replace("@PLUG_INFO_ROOT@", ".");
    assert_eq!(plugin, read(&Path::new(SCHEMAS).join("plugInfo.json")));
}

/// The schema is a UsdRender Settings, has an attribute for each that surflux reads, of the type of its flag, and surflux
/// reads a stage that was authored with it, fallbacks and all.
#[test]
fn usd_knows_settings_as_render_settings_and_surflux_reads_what_it_authors() {
    const ASK: &str = "
import os, sys, json
os.environ['PXR_PLUGINPATH_NAME'] = sys.argv[1]
from pxr import Gf, Usd, UsdRender, UsdGeom, Sdf
stage = Usd.Stage.CreateNew(sys.argv[2])
UsdGeom.Cube.Define(stage, '/cube')
prim = stage.DefinePrim('/Render/s', 'SurfluxBakeSettings')
assert prim.IsA(UsdRender.Settings), 'IsA'
UsdRender.Settings(prim).GetResolutionAttr().Set(Gf.Vec2i(8, 4))
prim.GetAttribute('surflux:rays').Set(29)
prim.GetAttribute('surflux:cloud').Set(Sdf.AssetPath('c.usdc'))
prim.GetAttribute('surflux:gather').Block()
stage.GetRootLayer().Save()
schema = Usd.SchemaRegistry().FindConcretePrimDefinition('SurfluxBakeSettings')
names = [name for name in schema.GetPropertyNames() if name.startswith('surflux:')]
print(json.dumps({name: str(schema.GetSchemaAttributeSpec(name).typeName) for name in names}))
";
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("s.usda");
    fs::write(folder.path().join("c.usdc"), "").expect("writable");
    let types = run_python(ASK, &[Path::new(SCHEMAS), &path]);
    let types: Value = serde_json::from_str(&types).expect("JSON");
    let types = types.as_object().expect("attributes");
    let mut read: Vec<String> = surflux::stage::bake_settings::attributes().collect();
    read.sort();
    let known: Vec<&String> = types.keys().collect();
    assert_eq!(known, read.iter().collect::<Vec<_>>());
    for door in ["native", "usd-core"] {
        // registered, and not
        for plugins in ["", SCHEMAS] {
            let told = told(
                "bake",
                &path,
                &["--usd", door],
                &[("PXR_PLUGINPATH_NAME", plugins)],
            );
            assert_eq!(told["rays"]["value"], 29, "{door}");
            let cloud = told["cloud"]["value"][0].as_str().expect("a cloud");
            assert_eq!(
                Path::new(cloud).canonicalize().ok(),
                folder.path().join("c.usdc").canonicalize().ok()
            );
            assert_eq!(told["gather"]["from"], "default", "{door}: blocked");
            assert_eq!(told["purposes"]["from"], "default", "{door}: a fallback");
        }
    }
}
