//! `surflux validate`: our own files pass, and each kind of damage is told in its words.

use crate::program::{ROOM, json, stderr, surflux};
use crate::python::{python, run_python};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use surflux::diagnostics::Diagnostics;
use surflux::stage::Door;
use surflux::stage::validate::{Check, Finding, Kind, Severity, Validation, validate};
use tempfile::TempDir;

const DOORS: [&str; 2] = ["native", "usd-core"];

fn by(door: &str) -> Command {
    let mut program = surflux();
    program.env("SURFLUX_USD_PYTHON", python());
    program.args(["validate", "--usd", door]);
    program
}

fn on(door: &str, args: &[&str]) -> Output {
    let mut program = surflux();
    program.env("SURFLUX_USD_PYTHON", python());
    program.args(args).args(["--usd", door]);
    program.output().expect("the program starts")
}

/// A cloud of the room in a folder of its own.
fn cloud() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("cloud.usdc");
    let name = path.to_string_lossy().into_owned();
    let made = on("native", &["points", ROOM, "-o", &name, "--surfels", "500"]);
    assert!(made.status.success(), "{}", stderr(&made));
    (folder, path)
}

/// A bake of the room, with its instances' shared values, in a folder of its own: the layer, and what shows it.
fn bake(frames: &[&str]) -> (TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bake.usdc");
    let name = path.to_string_lossy().into_owned();
    let aovs = "occlusion,irradiance,bent_normal";
    let args = [
        "bake",
        ROOM,
        "-o",
        &name,
        "--aov",
        aovs,
        "--rays",
        "16",
        "--surfels",
        "200",
    ];
    let made = on("native", &[&args[..], frames].concat());
    assert!(made.status.success(), "{}", stderr(&made));
    let shown = folder.path().join("bake_baked.usda");
    (folder, path, shown)
}

/// `file` after `edit`, Python that finds the layer as `layer` and its `Points` prim's spec as `points`.
fn broken(file: &Path, edit: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("broken.usda");
    let script = format!(
        r#"
import sys
from pxr import Gf, Sdf, Vt
layer = Sdf.Layer.FindOrOpen(sys.argv[1])
points = layer.GetPrimAtPath("/root/surfels")
def value(name):
    return points.attributes[name].default
def put(name, new):
    points.attributes[name].default = new
def changed(name, index, new):
    values = list(value(name))
    values[index] = new
    put(name, type(value(name))(values))
{edit}
assert layer.Export(sys.argv[2])
"#
    );
    run_python(&script, &[file, &path]);
    (folder, path)
}

fn look(path: &Path) -> Validation {
    validate(path, Door::Native, &Diagnostics::default()).expect("it can be read")
}

/// The only finding of `check`, which names `place` and says all `words`.
fn finds(found: &Validation, check: Check, severity: Severity, place: &str, words: &[&str]) {
    let of_check: Vec<&Finding> = found.findings.iter().filter(|f| f.check == check).collect();
    let [finding] = of_check[..] else {
        panic!("{check:?} at {place}: {:#?}", found.findings);
    };
    assert_eq!(finding.severity, severity, "{finding:?}");
    assert_eq!(finding.place, place);
    for word in words {
        assert!(finding.message.contains(word), "no {word:?} in {finding:?}");
    }
}

#[test]
fn our_own_clouds_are_valid() {
    let (_folder, path) = cloud();
    for door in DOORS {
        let output = by(door).arg(&path).arg("--json").output();
        let report = json(&output.expect("the program starts"));
        assert_eq!(report["kind"], "cloud");
        assert_eq!(report["findings"], serde_json::json!([]), "{door}");
        let asked = report["validators"].as_str();
        assert_eq!(asked.is_some(), door == "usd-core", "{asked:?}");
        for check in report["checks"].as_array().expect("a list") {
            let looked_at = check["looked_at"].as_u64().expect("a number");
            assert!(looked_at > 0 || check["check"] == "usd", "{check}");
        }
    }
}

#[test]
fn our_own_bakes_are_valid_whether_the_layer_or_what_shows_it_is_named() {
    for frames in [&[][..], &["--frames", "1:2"]] {
        let (_folder, layer, shown) = bake(frames);
        for (door, path) in [("native", &layer), ("native", &shown), ("usd-core", &shown)] {
            let output = by(door).arg(path).arg("--json").output();
            let report = json(&output.expect("the program starts"));
            assert_eq!(report["kind"], "bake");
            assert_eq!(
                report["findings"],
                serde_json::json!([]),
                "{door} {frames:?}"
            );
            assert_eq!(report["layer"], layer.to_string_lossy().as_ref());
            assert_eq!(report["stage"], shown.to_string_lossy().as_ref());
        }
    }
}

type CloudCase = (
    &'static str,
    Check,
    Severity,
    &'static str,
    &'static [&'static str],
);

/// Edits of a cloud, and what is wrong then: where in `/root/surfels` (`/`: in the layer's metadata), and words of the message.
const CLOUD_CASES: [CloudCase; 18] = [
    (
        "put('widths', value('widths')[:-1])",
        Check::Length,
        Severity::Error,
        "widths",
        &["needs"],
    ),
    (
        "put('primvars:albedo', value('primvars:albedo')[:3])",
        Check::Length,
        Severity::Error,
        "primvars:albedo",
        &["3 values", "vertex"],
    ),
    (
        "points.attributes['primvars:N'].SetInfo('interpolation', 'faceVarying')",
        Check::Interpolation,
        Severity::Error,
        "primvars:N",
        &["faceVarying", "right: vertex"],
    ),
    (
        "points.attributes['widths'].ClearInfo('interpolation')",
        Check::Interpolation,
        Severity::Error,
        "widths",
        &["constant"],
    ),
    (
        "changed('extent', 1, Gf.Vec3f(0.0))",
        Check::Extent,
        Severity::Error,
        "extent",
        &["beyond"],
    ),
    (
        "changed('extent', 1, Gf.Vec3f(1e4))",
        Check::Extent,
        Severity::Warning,
        "extent",
        &["larger"],
    ),
    (
        "put('extent', value('extent')[:1])",
        Check::Extent,
        Severity::Error,
        "extent",
        &["2 corners"],
    ),
    (
        "changed('primvars:emission', 7, Gf.Vec3f(float('nan'), 0, 0))",
        Check::NonFinite,
        Severity::Error,
        "primvars:emission",
        &["1 of", "value 7"],
    ),
    (
        "changed('points', 3, Gf.Vec3f(float('inf')))",
        Check::NonFinite,
        Severity::Error,
        "points",
        &["3 of", "value 3"],
    ),
    (
        "changed('widths', 5, 0.0)",
        Check::Widths,
        Severity::Error,
        "widths",
        &["1 of", "above 0"],
    ),
    (
        "changed('normals', 5, Gf.Vec3f(0))",
        Check::Normals,
        Severity::Error,
        "normals",
        &["1 vectors are zero"],
    ),
    (
        "changed('normals', 5, Gf.Vec3f(0, 2, 0))",
        Check::Normals,
        Severity::Warning,
        "normals",
        &["vector 5", "length 2"],
    ),
    (
        "changed('primvars:sourcePrim', 2, 10000)",
        Check::Ids,
        Severity::Error,
        "primvars:sourcePrim",
        &["point 2", "10000"],
    ),
    (
        "changed('primvars:emission', 0, Gf.Vec3f(0, -1, 0))",
        Check::Range,
        Severity::Error,
        "primvars:emission",
        &["below 0"],
    ),
    (
        "changed('primvars:albedo', 4, Gf.Vec3f(1.5))",
        Check::Range,
        Severity::Error,
        "primvars:albedo",
        &["value 4 is 1.5"],
    ),
    (
        "put('primvars:displayColor', value('primvars:radiosity'))",
        Check::Range,
        Severity::Warning,
        "primvars:displayColor",
        &["radiosity / π"],
    ),
    (
        "layer.pseudoRoot.ClearInfo('metersPerUnit')",
        Check::Units,
        Severity::Warning,
        "/",
        &["metersPerUnit"],
    ),
    (
        "del points.properties['primvars:area']",
        Check::Structure,
        Severity::Error,
        "primvars:area",
        &["SurfluxCloudAPI"],
    ),
];

#[test]
fn clouds_with_one_thing_wrong_are_told_what() {
    let (_folder, file) = cloud();
    for (edit, check, severity, name, words) in CLOUD_CASES {
        let place = match name {
            "/" => "/".to_owned(),
            _ => format!("/root/surfels.{name}"),
        };
        let (_folder, path) = broken(&file, edit);
        let found = look(&path);
        assert_eq!(found.kind, Kind::Cloud);
        finds(&found, check, severity, &place, words);
        assert_eq!(found.findings.len(), 1, "{edit}: {:#?}", found.findings);
    }
}

#[test]
fn a_wrong_cloud_ends_with_exit_code_one_and_says_where() {
    let (_folder, file) = cloud();
    let (_broken, path) = broken(&file, "changed('widths', 5, -1.0)");
    for json in [true, false] {
        let mut program = by("native");
        program.arg(&path);
        let output = program
            .args(json.then_some("--json"))
            .output()
            .expect("starts");
        assert_eq!(output.status.code(), Some(1));
        let told = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(told.contains("/root/surfels.widths"), "{told}");
        assert!(stderr(&output).contains("1 errors"), "{}", stderr(&output));
    }
}

/// What `validate` says of the bake after `edit` of its layer (as in [`broken`]), composed over the asset again.
fn broken_bake((layer, shown): (&Path, &Path), edit: &str) -> Validation {
    let (folder, path) = broken(layer, edit);
    let text = fs::read_to_string(shown).expect("readable");
    let there = shown.with_file_name("").join(".");
    let room = format!("@{ROOM}@");
    let at = text.find("subLayers").expect("sublayers");
    let end = at + text[at..].find(']').expect("a list");
    let text = format!(
        "{}subLayers = [@./broken.usda@, {room}{}",
        &text[..at],
        &text[end..]
    );
    assert!(there.is_dir());
    let shown = folder.path().join("broken_baked.usda");
    fs::write(&shown, text).expect("written");
    let of_layer = look(&path);
    assert_eq!(of_layer.findings, look(&shown).findings, "{edit}");
    of_layer
}

/// Some mesh of the room that has a primvar of its own: its path, and how many points it has.
fn mesh(layer: &Path) -> String {
    let script = "import sys
from pxr import Sdf
layer = Sdf.Layer.FindOrOpen(sys.argv[1])
found = []
layer.Traverse('/', lambda path: found.append(path) if path.name == 'primvars:occlusion' else None)
print(sorted(str(path.GetPrimPath()) for path in found if not str(path).startswith('/_surflux'))[0], end='')";
    run_python(script, &[layer])
}

type BakeCase = (&'static str, Check, &'static str, &'static [&'static str]);

/// Edits of a bake, and what is wrong then: which property of a mesh (none: the mesh; `/`: the layer's metadata), and words of
/// the message.
const BAKE_CASES: [BakeCase; 10] = [
    (
        "put('primvars:occlusion', value('primvars:occlusion')[:-1])",
        Check::Length,
        ".primvars:occlusion",
        &["vertex on this Mesh needs"],
    ),
    (
        "points.attributes['primvars:occlusion'].SetInfo('interpolation', 'uniform')",
        Check::Length,
        ".primvars:occlusion",
        &["uniform on this Mesh needs"],
    ),
    (
        "points.attributes['primvars:occlusion'].SetInfo('interpolation', 'every')",
        Check::Interpolation,
        ".primvars:occlusion",
        &["every"],
    ),
    (
        "changed('primvars:occlusion', 1, float('nan'))",
        Check::NonFinite,
        ".primvars:occlusion",
        &["value 1"],
    ),
    (
        "changed('primvars:occlusion', 1, 1.01)",
        Check::Range,
        ".primvars:occlusion",
        &["above 1"],
    ),
    (
        "changed('primvars:irradiance', 1, Gf.Vec3f(-1))",
        Check::Range,
        ".primvars:irradiance",
        &["below 0"],
    ),
    (
        "layer.pseudoRoot.SetInfo('metersPerUnit', 2.5)",
        Check::Units,
        "/",
        &["2.5"],
    ),
    (
        "points.specifier = Sdf.SpecifierDef",
        Check::Structure,
        "",
        &["overs only"],
    ),
    (
        "Sdf.AttributeSpec(points, 'visibility', Sdf.ValueTypeNames.Token).default = 'invisible'",
        Check::Structure,
        ".visibility",
        &["only primvars"],
    ),
    (
        "points.referenceList.Append(Sdf.Reference('other.usda', '/a'))",
        Check::Structure,
        "",
        &["references"],
    ),
];

#[test]
fn bakes_with_one_thing_wrong_are_told_what() {
    let (_folder, layer, shown) = bake(&[]);
    let mesh = mesh(&layer);
    let edit = |rest: &str| format!("points = layer.GetPrimAtPath('{mesh}')\n{rest}");
    for (change, check, property, words) in BAKE_CASES {
        let place = match property {
            "/" => "/".to_owned(),
            _ => format!("{mesh}{property}"),
        };
        if change.contains("references") || change.contains("other.usda") {
            // the reference is broken too, which the native door refuses: the layer alone is looked at
            let (_folder, path) = broken(&layer, &edit(change));
            let found = look(&path);
            assert!(
                found
                    .findings
                    .iter()
                    .any(|f| f.check == check && f.place == place && f.message.contains(words[0])),
                "{:#?}",
                found.findings
            );
            continue;
        }
        let found = broken_bake((&layer, &shown), &edit(change));
        finds(&found, check, Severity::Error, &place, words);
    }
}

#[test]
fn values_for_prims_that_the_asset_lacks_are_an_error() {
    let (_folder, layer, shown) = bake(&[]);
    let mesh = mesh(&layer);
    let edit = format!("assert Sdf.CopySpec(layer, '{mesh}', layer, '/gone')");
    let found = broken_bake((&layer, &shown), &edit);
    finds(
        &found,
        Check::Structure,
        Severity::Error,
        "/gone",
        &["no such prim"],
    );
}

#[test]
fn a_layer_of_values_alone_is_checked_as_far_as_it_goes() {
    let (folder, layer, shown) = bake(&[]);
    fs::remove_file(shown).expect("removed");
    let found = look(&layer);
    assert_eq!((found.kind, found.stage.as_deref()), (Kind::Bake, None));
    finds(
        &found,
        Check::Structure,
        Severity::Warning,
        "/",
        &["NAME_baked.usda"],
    );
    drop(folder);
}

#[test]
fn files_that_are_neither_or_damaged_are_refused() {
    let (folder, path) = crate::program::stage("#usda 1.0\ndef Xform \"x\"\n{\n}\n");
    let refused = |path: &Path| {
        let found = validate(path, Door::Native, &Diagnostics::default());
        found.expect_err("refused").to_string()
    };
    assert!(refused(&path).contains("neither a cloud"));
    let (_cloud, file) = cloud();
    let whole = fs::read(&file).expect("readable");
    let cut = folder.path().join("cut.usdc");
    for part in 1..20 {
        fs::write(&cut, &whole[..whole.len() * part / 20]).expect("written");
        assert!(refused(&cut).contains("cut.usdc"));
    }
    assert!(!refused(Path::new("gone.usdc")).is_empty());
}

#[test]
fn the_report_keeps_to_its_schema() {
    let (_folder, file) = cloud();
    let (_broken, path) = broken(&file, "changed('widths', 5, -1.0)");
    for path in [&file, &path] {
        let output = by("native").arg(path).arg("--json").output();
        let told = String::from_utf8(output.expect("starts").stdout).expect("text");
        let schema = concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/validate.schema.json");
        let script = "import json, jsonschema, sys
jsonschema.Draft202012Validator.check_schema(json.load(open(sys.argv[1])))
jsonschema.validate(json.loads(sys.argv[2]), json.load(open(sys.argv[1])))";
        run_python(script, &[schema, &told]);
    }
}
