//! Skins and morph targets → `UsdSkel`: against glTF's own rules in numpy, `UsdSkel` of usd-core, Blender's importer of glTF, and
//! what surflux reads of the result.

use super::ply::numbers;
use super::{convert, must_fail, program, python_json, stderr, text};
use crate::python::{python, run_python};
use serde_json::Value as Json;
use std::fs;
use std::path::{Path, PathBuf};

const MAKE: &str = include_str!("skin.py");

/// The sample in `folder`.
fn sample(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(name);
    run_python(MAKE, &[&path]);
    path
}

/// Corners of all triangles at `frame`.
fn truth(frame: &str) -> Vec<[f64; 3]> {
    corners(&python_json(MAKE, &[Path::new("truth"), Path::new(frame)]))
}

fn corners(triangles: &Json) -> Vec<[f64; 3]> {
    let flat = numbers(triangles);
    flat.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
}

/// Every point of the one is a point of the other and the other way around, within `tolerance`.
fn assert_same_points(a: &[[f64; 3]], b: &[[f64; 3]], tolerance: f64) {
    assert!(!a.is_empty() && !b.is_empty());
    let distance = |p: &[f64; 3], q: &[f64; 3]| {
        let squares = p.iter().zip(q).map(|(x, y)| (x - y) * (x - y));
        squares.sum::<f64>().sqrt()
    };
    for (from, to) in [(a, b), (b, a)] {
        for p in from {
            let nearest = to.iter().map(|q| distance(p, q)).fold(f64::MAX, f64::min);
            assert!(
                nearest <= tolerance,
                "{p:?} is {nearest} from any of {to:?}"
            );
        }
    }
}

/// Triangles as `UsdSkel` bakes them, from values of the animation at one time.
const BAKED_BY_USD: &str = "
import sys, json
from pxr import Gf, Usd, UsdGeom, UsdSkel
stage, frame = Usd.Stage.Open(sys.argv[1]), float(sys.argv[2])
for prim in stage.Traverse():
    if prim.IsA(UsdSkel.Animation):
        for attribute in prim.GetAuthoredAttributes():
            value = attribute.Get(frame)
            attribute.Clear()
            attribute.Set(value)
assert UsdSkel.BakeSkinning(UsdSkel.Root.Get(stage, '/root'), Gf.Interval.GetFullInterval())
triangles = []
for prim in stage.Traverse():
    if prim.IsA(UsdGeom.Mesh):
        mesh = UsdGeom.Mesh(prim)
        world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(frame)
        points = [world.Transform(Gf.Vec3d(p)) for p in mesh.GetPointsAttr().Get(frame)]
        triangles.append([list(points[k]) for k in mesh.GetFaceVertexIndicesAttr().Get()])
print(json.dumps(triangles))
";

#[test]
fn usd_core_poses_what_gltf_means() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, usd) = (sample(folder.path(), "s.glb"), folder.path().join("s.usdc"));
    let report = convert(&glb, &usd, &[]);
    assert_eq!(report["warnings"], Json::Array(Vec::new()));
    for frame in ["0", "6", "12", "15", "24"] {
        let posed = corners(&python_json(BAKED_BY_USD, &[&usd, Path::new(frame)]));
        let truth = truth(frame);
        assert_eq!(posed.len(), truth.len());
        // single precision of points up to 5 units away
        assert_same_points(&posed, &truth, 2e-6);
    }
}

/// As Blender shows the file through its own importer, +Y up again.
const SEEN_IN_BLENDER: &str = "
import sys, json, bpy, addon_utils
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable('io_scene_gltf2')
bpy.ops.import_scene.gltf(filepath=sys.argv[1])
bpy.context.scene.frame_set(int(sys.argv[2]))
points = []
graph = bpy.context.evaluated_depsgraph_get()
for thing in bpy.context.scene.objects:
    if thing.type == 'MESH' and not thing.name.startswith('Icosphere'):
        seen = thing.evaluated_get(graph)
        for v in seen.data.vertices:
            x, y, z = seen.matrix_world @ v.co
            points.append([x, z, -y])
print(json.dumps(points))
";

#[test]
fn blenders_importer_of_gltf_agrees_at_the_keys() {
    let folder = tempfile::tempdir().unwrap();
    let glb = sample(folder.path(), "s.glb");
    for frame in ["0", "12", "24"] {
        let seen = corners(&python_json(SEEN_IN_BLENDER, &[&glb, Path::new(frame)]));
        // single precision matrices of bones
        assert_same_points(&seen, &truth(frame), 1e-4);
    }
}

#[test]
fn surflux_reads_the_same_through_both_doors() {
    const POINTS: &str = "
import sys, json
from pxr import Usd
stage = Usd.Stage.Open(sys.argv[1])
found = [prim.GetAttribute('primvars:P') for prim in stage.TraverseAll() if prim.GetAttribute('primvars:P')]
print(json.dumps([[list(p) for p in attribute.Get(float(sys.argv[2]))] for attribute in found]))
";
    let folder = tempfile::tempdir().unwrap();
    let (glb, usd) = (sample(folder.path(), "s.glb"), folder.path().join("s.usdc"));
    convert(&glb, &usd, &[]);
    for (door, frame) in [("native", "6"), ("usd-core", "6"), ("native", "24")] {
        let baked = folder.path().join("baked.usdc");
        let args = ["bake", text(&usd), "-o", text(&baked), "--aov", "P", "-q"];
        let more = ["--usd", door, "--frames", frame];
        let mut program = program::surflux();
        program.env("SURFLUX_USD_PYTHON", python());
        let result = program.args(args).args(more).output().unwrap();
        assert!(result.status.success(), "{}", stderr(&result));
        let points = corners(&python_json(POINTS, &[&baked, Path::new(frame)]));
        // receivers stand off corners and edges by a hundredth of these faces, which moves them by several tenths
        assert_same_points(&points, &truth(frame), 0.03);
    }
}

#[test]
fn pixars_validators_find_nothing_wrong_with_skeletons() {
    const VALIDATE: &str = "
import sys, json
from pxr import Usd, UsdValidation
stage = Usd.Stage.Open(sys.argv[1])
context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
print(json.dumps([e.GetName() + ' ' + e.GetMessage() for e in context.Validate(stage)]))
";
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (
        sample(folder.path(), "s.gltf"),
        folder.path().join("s.usda"),
    );
    convert(&from, &to, &[]);
    assert_eq!(python_json(VALIDATE, &[&to]), Json::Array(Vec::new()));
}

#[test]
fn damaged_skins_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = sample(folder.path(), "s.gltf");
    let whole: Json = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    let fails = |word: &str, damage: &dyn Fn(&mut Json)| {
        let mut damaged = whole.clone();
        damage(&mut damaged);
        must_fail("a.gltf", damaged.to_string().as_bytes(), word);
    };
    let binds = whole["skins"][0]["inverseBindMatrices"].as_u64().unwrap();
    let binds = usize::try_from(binds).unwrap();
    fails("out of range, its skin has 1", &|gltf| {
        gltf["skins"][0]["joints"] = serde_json::json!([2]);
    });
    fails("for 2 joints", &|gltf| {
        gltf["accessors"][binds]["count"] = 1.into();
    });
    fails("not both", &|gltf| {
        let attributes = &mut gltf["meshes"][0]["primitives"][0]["attributes"];
        attributes.as_object_mut().unwrap().remove("WEIGHTS_0");
    });
    fails("no JOINTS_0", &|gltf| {
        let attributes = gltf["meshes"][0]["primitives"][0]["attributes"].as_object_mut();
        attributes.unwrap().retain(|name, _| name == "POSITION");
    });
    fails("a morph target has", &|gltf| {
        let face = gltf["meshes"][1]["primitives"][0]["attributes"]["POSITION"].clone();
        gltf["meshes"][0]["primitives"][0]["targets"][0]["POSITION"] = face;
    });
    fails("below itself", &|gltf| {
        gltf["nodes"][2]["children"] = serde_json::json!([1]);
    });
    fails("not finite", &|gltf| {
        gltf["nodes"][1]["scale"] = serde_json::json!([1e39, 1, 1]);
    });
    fails("weights for", &|gltf| {
        let animation = &gltf["animations"][0];
        let channels = animation["channels"].as_array().unwrap();
        let is_shaped = |channel: &&Json| channel["target"]["path"] == "weights";
        let sampler = channels.iter().find(is_shaped).unwrap()["sampler"]
            .as_u64()
            .unwrap();
        let output = animation["samplers"][usize::try_from(sampler).unwrap()]["output"].as_u64();
        let count = &mut gltf["accessors"][usize::try_from(output.unwrap()).unwrap()]["count"];
        *count = (count.as_u64().unwrap() - 1).into();
    });
}
