//! Clouds ↔ PLY.

use super::{convert, must_fail, python_json, survives, text};
use crate::program::{ROOM, run, stderr};
use serde_json::Value as Json;
use std::fs;
use std::path::{Path, PathBuf};

/// Reads a cloud with usd-core.
pub(super) const READ_USD: &str = "
import sys, json
from pxr import Usd, UsdGeom
stage = Usd.Stage.Open(sys.argv[1])
prim = stage.GetPrimAtPath('/root/surfels')
out = {'upAxis': UsdGeom.GetStageUpAxis(stage), 'metersPerUnit': UsdGeom.GetStageMetersPerUnit(stage)}
for attribute in prim.GetAttributes():
    value = attribute.Get()
    if attribute.HasAuthoredValue() and hasattr(value, '__len__') and not isinstance(value, str):
        out[attribute.GetName()] = [list(v) if hasattr(v, '__len__') else v for v in value]
        out['interpolation ' + attribute.GetName()] = attribute.GetMetadata('interpolation')
print(json.dumps(out))
";

/// Reads a PLY with numpy and nothing of ours.
const READ_PLY: &str = "
import sys, json, numpy as np
data = open(sys.argv[1], 'rb').read()
head, body = data.split(b'end_header\\n', 1)
lines = head.decode().split('\\n')
order = {'binary_little_endian': '<', 'binary_big_endian': '>', 'ascii': ''}[lines[1].split()[1]]
kinds = {'float': 'f4', 'double': 'f8', 'int': 'i4', 'uchar': 'u1'}
props = [(l.split()[2], kinds[l.split()[1]]) for l in lines if l.startswith('property')]
if order:
    table = np.frombuffer(body, [(n, order + k) for n, k in props])
    columns = {n: table[n].tolist() for n, _ in props}
else:
    rows = [l.split() for l in body.decode().split('\\n') if l]
    columns = {n: [float(np.float32(r[i])) if k == 'f4' else float(r[i]) for r in rows] for i, (n, k) in enumerate(props)}
print(json.dumps(columns))
";

pub(super) fn cloud(folder: &Path) -> PathBuf {
    let path = folder.join("cloud.usdc");
    let args = [
        "points",
        ROOM,
        "--usd",
        "native",
        "--surfels",
        "600",
        "-q",
        "-o",
        text(&path),
    ];
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
    path
}

/// All numbers of a value, in single precision: digits of JSON are read a last bit off.
#[expect(
    clippy::cast_possible_truncation,
    reason = "arrays are single precision"
)]
pub(super) fn numbers(value: &Json) -> Vec<f64> {
    match value {
        Json::Array(values) => values.iter().flat_map(numbers).collect(),
        other => {
            let number = other
                .as_f64()
                .unwrap_or_else(|| panic!("a number, not {other}"));
            vec![f64::from(number as f32)]
        }
    }
}

#[test]
fn a_cloud_in_ply_has_the_numbers_that_usd_core_reads_in_every_encoding() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(folder.path());
    let usd = python_json(READ_USD, &[&cloud]);
    for flag in [None, Some("--ascii"), Some("--big-endian")] {
        let ply = folder.path().join("cloud.ply");
        convert(&cloud, &ply, flag.as_slice());
        let read = python_json(READ_PLY, &[&ply]);
        let triples = [
            ("points", ["x", "y", "z"]),
            ("normals", ["nx", "ny", "nz"]),
            (
                "primvars:radiosity",
                ["radiosity_r", "radiosity_g", "radiosity_b"],
            ),
            (
                "primvars:displayColor",
                ["displayColor_r", "displayColor_g", "displayColor_b"],
            ),
        ];
        for (name, columns) in triples {
            for (k, column) in columns.iter().enumerate() {
                let truth: Vec<f64> = numbers(&usd[name]).into_iter().skip(k).step_by(3).collect();
                assert_eq!(numbers(&read[*column]), truth, "{flag:?} {column}");
            }
        }
        assert_eq!(
            numbers(&read["primvars:area".trim_start_matches("primvars:")]),
            numbers(&usd["primvars:area"])
        );
        assert_eq!(
            numbers(&read["sourcePrim"]),
            numbers(&usd["primvars:sourcePrim"])
        );
        let radii: Vec<f64> = numbers(&usd["widths"])
            .iter()
            .map(|width| 0.5 * width)
            .collect();
        assert_eq!(numbers(&read["radius"]), radii);
        let srgb = |x: f64| {
            let x = x.clamp(0.0, 1.0);
            let encoded = if x <= 0.003_130_8 {
                12.92 * x
            } else {
                1.055 * x.powf(1.0 / 2.4) - 0.055
            };
            (255.0 * encoded).round()
        };
        let red: Vec<f64> = numbers(&usd["primvars:displayColor"])
            .into_iter()
            .step_by(3)
            .map(srgb)
            .collect();
        assert_eq!(numbers(&read["red"]), red);
    }
}

#[test]
fn a_cloud_comes_back_from_ply_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(folder.path());
    let before = python_json(READ_USD, &[&cloud]);
    for flag in [None, Some("--ascii"), Some("--big-endian")] {
        let (ply, back) = (folder.path().join("c.ply"), folder.path().join("back.usdc"));
        convert(&cloud, &ply, flag.as_slice());
        let report = convert(&ply, &back, &[]);
        assert_eq!(report["warnings"], Json::Array(Vec::new()));
        let after = python_json(READ_USD, &[&back]);
        for (name, value) in before.as_object().unwrap() {
            match value {
                Json::Array(_) if value[0].is_number() || value[0].is_array() => {
                    assert_eq!(numbers(value), numbers(&after[name]), "{flag:?} {name}");
                }
                _ => assert_eq!(value, &after[name], "{flag:?} {name}"),
            }
        }
    }
}

#[test]
fn blender_reads_the_same_positions_and_colors() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(folder.path());
    let ply = folder.path().join("cloud.ply");
    convert(&cloud, &ply, &[]);
    const BLENDER: &str = "
import sys, json, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.ply_import(filepath=sys.argv[1], forward_axis='Y', up_axis='Z')
mesh = bpy.context.selected_objects[0].data
out = {'P': [list(v.co) for v in mesh.vertices]}
for a in mesh.attributes:
    if a.data_type == 'FLOAT':
        out[a.name] = [d.value for d in a.data]
    elif a.data_type == 'FLOAT_COLOR':
        out[a.name] = [list(d.color)[:3] for d in a.data]
print(json.dumps(out))
";
    let blender = python_json(BLENDER, &[&ply]);
    let usd = python_json(READ_USD, &[&cloud]);
    assert_eq!(numbers(&blender["P"]), numbers(&usd["points"]));
    assert_eq!(numbers(&blender["area"]), numbers(&usd["primvars:area"]));
    // what it decodes from sRGB codes: half a code off, 0.4 % of white at its steepest
    let pairs = numbers(&blender["Col"])
        .into_iter()
        .zip(numbers(&usd["primvars:displayColor"]));
    for (shown, truth) in pairs {
        assert!((shown - truth.min(1.0)).abs() < 0.005, "{shown} {truth}");
    }
}

#[test]
fn points_of_other_programs_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let ply = folder.path().join("scan.ply");
    let text = "ply\nformat ascii 1.0\ncomment other\nelement vertex 2\nproperty double x\nproperty double y\nproperty double z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\nproperty float confidence\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n\
        500000.25 4000000.5 10 255 0 128 255 0.5\n500001.25 4000001.5 11 0 255 64 0 0.25\n3 0 1 1\n";
    fs::write(&ply, text).unwrap();
    let usd = folder.path().join("scan.usdc");
    let report = convert(&ply, &usd, &["--up-axis", "z", "--meters-per-unit", "0.1"]);
    let warnings = report["warnings"].as_array().unwrap();
    assert_eq!(warnings.len(), 1);
    assert_eq!(warnings[0]["kind"], "lost");
    let read = python_json(READ_USD, &[&usd]);
    assert_eq!(read["upAxis"], "Z");
    assert_eq!(read["metersPerUnit"], 0.1);
    assert_eq!(numbers(&read["primvars:confidence"]), [0.5, 0.25]);
    let color = numbers(&read["primvars:displayColor"]);
    // IEC 61966-2-1 of 255, 0 and 128
    for (value, truth) in color.iter().zip([1.0, 0.0, 0.215_860_5]) {
        assert!((value - truth).abs() < 1e-6, "{value} {truth}");
    }
    const PLACES: &str = "
import sys, json
from pxr import Usd, UsdGeom
stage = Usd.Stage.Open(sys.argv[1])
prim = UsdGeom.Points(stage.GetPrimAtPath('/root/surfels'))
m = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)
print(json.dumps([list(m.Transform(p)) for p in prim.GetPointsAttr().Get()]))
";
    let places = numbers(&python_json(PLACES, &[&usd]));
    assert_eq!(
        places,
        [500_000.25, 4_000_000.5, 10.0, 500_001.25, 4_000_001.5, 11.0]
    );
}

#[test]
fn a_display_mesh_is_drawn_by_blender_in_the_cloud_s_colors() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(folder.path());
    let mesh = folder.path().join("mesh.usdc");
    convert(&cloud, &mesh, &["--display-mesh"]);
    const BLENDER: &str = "
import sys, json, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=sys.argv[1])
o = [o for o in bpy.context.scene.objects if o.type == 'MESH'][0]
mesh = o.data
color = mesh.attributes['displayColor']
material = o.material_slots[0].material
emission = [n for n in material.node_tree.nodes if n.type == 'BSDF_PRINCIPLED'][0].inputs['Emission Color']
print(json.dumps({'centers': [list(p.center) for p in mesh.polygons], 'normals': [list(p.normal) for p in mesh.polygons],
    'areas': [p.area for p in mesh.polygons],
    'colors': [list(color.data[p.loop_indices[0]].color)[:3] for p in mesh.polygons], 'lit': emission.is_linked}))
";
    let blender = python_json(BLENDER, &[&mesh]);
    let usd = python_json(READ_USD, &[&cloud]);
    assert_eq!(blender["lit"], true);
    let near = |a: &Json, b: &Json, tolerance: f64| {
        let (a, b) = (numbers(a), numbers(b));
        assert_eq!(a.len(), b.len());
        for (a, b) in a.iter().zip(&b) {
            assert!((a - b).abs() <= tolerance, "{a} {b}");
        }
    };
    // a hundredth of the radius towards the normal; sums of four corners in single precision, of a room 4 units wide
    let radii = numbers(&usd["widths"]);
    let lifted = numbers(&usd["points"])
        .into_iter()
        .zip(numbers(&usd["normals"]));
    let lifted = lifted
        .enumerate()
        .map(|(i, (p, n))| p + 0.005 * radii[i / 3] * n);
    near(
        &blender["centers"],
        &lifted.collect::<Vec<f64>>().into(),
        2e-6,
    );
    near(&blender["normals"], &usd["normals"], 2e-3);
    near(&blender["colors"], &usd["primvars:displayColor"], 1e-6);
    let areas: Vec<f64> = numbers(&usd["widths"])
        .iter()
        .map(|width| width * width)
        .collect();
    for (area, truth) in numbers(&blender["areas"]).iter().zip(&areas) {
        assert!((area / truth - 1.0).abs() < 1e-3, "{area} {truth}");
    }
}

#[test]
fn damaged_files_are_errors_and_write_nothing() {
    let head = "ply\nformat binary_little_endian 1.0\nelement vertex ";
    let tail = "\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let with = |count: &str, data: &[u8]| {
        [head.as_bytes(), count.as_bytes(), tail.as_bytes(), data].concat()
    };
    must_fail("a.ply", b"", "first line");
    must_fail("a.ply", b"not a ply at all", "first line");
    must_fail(
        "a.ply",
        &with("1000000000000000000", &[0; 64]),
        "ends too early",
    );
    must_fail(
        "a.ply",
        &with("18446744073709551615", &[0; 64]),
        "ends too early",
    );
    must_fail("a.ply", &with("2", &[0; 23]), "ends too early");
    must_fail(
        "a.ply",
        &with("1", &[0, 0, 0x80, 0x7F, 0, 0, 0, 0, 0, 0, 0, 0]),
        "not finite",
    );
    must_fail("a.ply", b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n", "ends too early");
    must_fail("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 three\n", "three");
    must_fail(
        "a.ply",
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
        "no x, y and z",
    );
    must_fail("a.xyz", b"1 2 3", ".ply");
    let good = [with("3", &[1; 36])].concat();
    survives("a.ply", &good);
}
