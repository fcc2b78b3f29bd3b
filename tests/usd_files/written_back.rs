//! A bake over an asset of payloads, references, variants and instances, made by the program and opened by usd-core: it
//! adds what was baked and nothing else, and the asset's files stay as they were.

use crate::json;
use crate::program::{self, surflux};
use crate::python::run_python;
use serde_json::Value as Json;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A square below a payload that a reference brings in, at `y` = 0.
const PART: &str = r#"#usda 1.0
( defaultPrim = "part" )
def Xform "part" ( payload = @./square.usda@</square> ) { }
"#;

const SQUARE: &str = r#"#usda 1.0
def Xform "square" {
    def Mesh "face" {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)]
        uniform token subdivisionScheme = "none"
    }
}
"#;

/// The variants of `/shot/choice` have a mesh of the same path with three and with four points.
const SHOT: &str = r#"#usda 1.0
( defaultPrim = "shot"
  subLayers = [@./layout.usda@] )
over "shot" {
    def "referenced" ( references = @./part.usda@ ) { }
    def Xform "choice" ( variants = { string shape = "four" }
                         prepend variantSets = "shape" ) {
        variantSet "shape" = {
            "three" {
                def Mesh "face" {
                    int[] faceVertexCounts = [3]
                    int[] faceVertexIndices = [0, 1, 2]
                    point3f[] points = [(0, 1, 0), (0, 1, 1), (1, 1, 1)]
                    uniform token subdivisionScheme = "none"
                }
            }
            "four" {
                def Mesh "face" {
                    int[] faceVertexCounts = [4]
                    int[] faceVertexIndices = [0, 1, 2, 3]
                    point3f[] points = [(0, 2, 0), (0, 2, 1), (1, 2, 1), (1, 2, 0)]
                    uniform token subdivisionScheme = "none"
                }
            }
        }
    }
}
"#;

const LAYOUT: &str = r#"#usda 1.0
def Xform "shot" {
    def "one" ( instanceable = true
                references = @./part.usda@ ) {
        double3 xformOp:translate = (5, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def "two" ( instanceable = true
                references = @./part.usda@ ) {
        double3 xformOp:translate = (5, 0.5, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}
"#;

fn asset() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in [
        ("shot.usda", SHOT),
        ("layout.usda", LAYOUT),
        ("part.usda", PART),
        ("square.usda", SQUARE),
    ] {
        fs::write(folder.path().join(name), text).expect("written");
    }
    folder
}

/// Bytes and time of change of every file of the asset.
fn state(folder: &Path) -> BTreeMap<String, (Vec<u8>, std::time::SystemTime)> {
    let names = ["shot.usda", "layout.usda", "part.usda", "square.usda"];
    let of = |name: &str| {
        let path = folder.join(name);
        let changed = fs::metadata(&path).and_then(|about| about.modified());
        let bytes = fs::read(&path).expect("readable");
        (name.to_owned(), (bytes, changed.expect("a time")))
    };
    names.into_iter().map(of).collect()
}

/// `surflux bake` of occlusion with `more`; the layer it wrote.
fn bake(folder: &Path, more: &[&str]) -> PathBuf {
    let before = state(folder);
    let out = folder.join("out.usdc");
    let output = surflux()
        .args(["bake", "--aov", "occlusion", "--usd", "native"])
        .args(["--rays", "16", "-q", "--json"])
        .args(more)
        .arg("-o")
        .args([&out, &folder.join("shot.usda")])
        .output()
        .expect("the program starts");
    program::json(&output);
    assert_eq!(state(folder), before, "the asset was touched");
    out
}

/// What the layer itself says: specifiers, fields of prims besides them, names of properties, layers it refers to.
const CONTENT: &str = r#"
import json, sys
from pxr import Sdf
layer = Sdf.Layer.FindOrOpen(sys.argv[1])
prims, fields, properties = {}, set(), {}
def visit(path):
    if path.IsPrimPath():
        spec = layer.GetPrimAtPath(path)
        prims[str(path)] = spec.specifier.displayName
        fields.update(set(spec.ListInfoKeys()) - {"specifier"})
    elif path.IsPropertyPath():
        properties.setdefault(str(path.GetPrimPath()), []).append(path.name)
layer.Traverse("/", visit)
print(json.dumps({"prims": prims, "fields": sorted(fields), "properties": properties,
    "outside": list(layer.GetExternalReferences()), "variants": sorted({p for p in prims if "{" in p})}))
"#;

fn content(layer: &Path) -> Json {
    json(&run_python(CONTENT, &[layer]))
}

/// Every mesh of the layers `sys.argv[2:]`, strongest first, with the variant `sys.argv[1]` chosen on top if there is one:
/// number of points and of baked values, whether it is shared, and the layers that its points come from.
const COMPOSED: &str = r#"
import json, os, sys
from pxr import Sdf, Usd, UsdGeom
root = Sdf.Layer.CreateAnonymous(".usda")
root.subLayerPaths = sys.argv[2:]
stage = Usd.Stage.Open(root)
if sys.argv[1]:
    stage.GetPrimAtPath("/shot/choice").GetVariantSet("shape").SetVariantSelection(sys.argv[1])
meshes = {}
for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
    if prim.GetTypeName() == "Mesh":
        points = prim.GetAttribute("points")
        baked = UsdGeom.PrimvarsAPI(prim).GetPrimvar("occlusion")
        meshes[str(prim.GetPath())] = [len(points.Get()), len(baked.Get() or []) if baked else None, prim.IsInstanceProxy(),
            [os.path.basename(spec.layer.identifier) for spec in points.GetPropertyStack()]]
print(json.dumps(meshes))
"#;

fn composed(variant: &str, layers: &[PathBuf]) -> Json {
    let names = layers.iter().map(|layer| layer.display().to_string());
    let arguments: Vec<String> = [variant.to_owned()].into_iter().chain(names).collect();
    json(&run_python(COMPOSED, &arguments))
}

fn names(list: &Json) -> BTreeSet<&str> {
    let values: Vec<&Json> = match list {
        Json::Array(values) => values.iter().collect(),
        Json::Object(map) => return map.keys().map(String::as_str).collect(),
        other => panic!("{other} is no list"),
    };
    values.into_iter().filter_map(Json::as_str).collect()
}

/// Asserts that `layer` holds primvars of `meshes` and of nothing else.
#[track_caller]
fn holds_only(layer: &Path, meshes: &[&str], fields: &[&str]) {
    let content = content(layer);
    assert_eq!(
        names(&content["properties"]),
        meshes.iter().copied().collect()
    );
    for of_mesh in content["properties"].as_object().expect("a map").values() {
        let expected = [
            "primvars:displayColor",
            "primvars:displayColor:indices",
            "primvars:occlusion",
        ];
        assert_eq!(names(of_mesh), expected.into_iter().collect());
    }
    assert_eq!(names(&content["fields"]), fields.iter().copied().collect());
    assert_eq!(content["outside"], serde_json::json!([]));
    assert_eq!(content["variants"], serde_json::json!([]));
    for (path, specifier) in content["prims"].as_object().expect("a map") {
        let is_class = !path.starts_with("/shot") && path.matches('/').count() == 1;
        let expected = if is_class { "Class" } else { "Over" };
        assert_eq!(specifier, expected, "{path}");
    }
}

#[test]
fn shared_instances_get_a_class_and_everything_else_only_overs() {
    let folder = asset();
    let out = bake(folder.path(), &[]);
    let class = {
        let content = content(&out);
        let prims = content["prims"].as_object().expect("a map");
        let class = prims.iter().find(|(_, kind)| **kind == "Class");
        class.expect("one for the instances").0.clone()
    };
    let shared = format!("{class}/face");
    let meshes = ["/shot/choice/face", "/shot/referenced/face", &shared];
    holds_only(&out, &meshes, &["inheritPaths"]);
    let layers = [out, folder.path().join("shot.usda")];
    let expected = serde_json::json!({
        "/shot/choice/face": [4, 4, false, ["shot.usda"]],
        "/shot/one/face": [4, 4, true, ["square.usda"]],
        "/shot/referenced/face": [4, 4, false, ["square.usda"]],
        "/shot/two/face": [4, 4, true, ["square.usda"]],
    });
    assert_eq!(composed("", &layers), expected);
}

#[test]
fn deinstanced_instances_get_overs_of_their_own() {
    let folder = asset();
    let out = bake(folder.path(), &["--instances", "deinstance"]);
    let meshes = [
        "/shot/choice/face",
        "/shot/one/face",
        "/shot/referenced/face",
        "/shot/two/face",
    ];
    holds_only(&out, &meshes, &["instanceable"]);
    let composed = composed("", &[out, folder.path().join("shot.usda")]);
    for mesh in meshes {
        let source = if mesh.contains("choice") {
            "shot.usda"
        } else {
            "square.usda"
        };
        assert_eq!(
            composed[mesh],
            serde_json::json!([4, 4, false, [source]]),
            "{mesh}"
        );
    }
}

#[test]
fn skipped_instances_and_masked_prims_are_not_in_the_layer() {
    let folder = asset();
    let out = bake(folder.path(), &["--instances", "skip"]);
    holds_only(&out, &["/shot/choice/face", "/shot/referenced/face"], &[]);
    let composed = composed("", &[out, folder.path().join("shot.usda")]);
    assert_eq!(
        composed["/shot/one/face"],
        serde_json::json!([4, null, true, ["square.usda"]])
    );
    let out = bake(folder.path(), &["--mask", "/shot/referenced"]);
    holds_only(&out, &["/shot/referenced/face"], &[]);
}

#[test]
fn the_variant_that_was_baked_is_chosen_and_the_asset_s_own_choice_stays_open() {
    let folder = asset();
    let out = bake(folder.path(), &["--variant", "/shot/choice{shape=three}"]);
    let shown = folder.path().join("out_baked.usda");
    let face = "/shot/choice/face";
    let baked = serde_json::json!([3, 3, false, ["shot.usda"]]);
    assert_eq!(composed("", &[shown])[face], baked);
    // the layer alone chooses nothing: sublayered, the asset's choice holds, and another can be made
    assert!(names(&content(&out)["fields"]).is_disjoint(&["variantSelection"].into()));
    let layers = [out, folder.path().join("shot.usda")];
    assert_eq!(composed("three", &layers)[face], baked);
}
