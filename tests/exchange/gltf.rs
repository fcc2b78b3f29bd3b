//! glTF → USD: against Blender's own importer of glTF, usd-core, and what the file was made with.

use super::ply::numbers;
use super::{convert, must_fail, python_json, survives};
use crate::python::run_python;
use serde_json::Value as Json;
use std::fs;
use std::path::{Path, PathBuf};

const MAKE: &str = include_str!("make_gltf.py");

/// The sample in `folder`.
fn sample(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(name);
    run_python(MAKE, &[&path]);
    path
}

fn assert_near(a: &Json, b: &Json, tolerance: f64) {
    let (x, y) = (numbers(a), numbers(b));
    assert_eq!(x.len(), y.len(), "{a} {b}");
    for (p, q) in x.iter().zip(&y) {
        assert!((p - q).abs() <= tolerance, "{a} {b}");
    }
}

#[test]
fn pixars_validators_find_nothing_wrong() {
    let folder = tempfile::tempdir().unwrap();
    for (name, to) in [("s.glb", "s.usdc"), ("s.gltf", "s.usda")] {
        let (from, to) = (sample(folder.path(), name), folder.path().join(to));
        let report = convert(&from, &to, &[]);
        assert_eq!(report["outputs"].as_array().unwrap().len(), 2);
        const VALIDATE: &str = "
import sys, json
from pxr import Usd, UsdValidation
stage = Usd.Stage.Open(sys.argv[1])
context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
print(json.dumps([e.GetName() + ' ' + e.GetMessage() for e in context.Validate(stage)]))
";
        assert_eq!(python_json(VALIDATE, &[&to]), Json::Array(Vec::new()));
    }
}

/// All triangles and their colors in world space, as Blender draws them: sorted, rounded to what single precision
/// leaves of transforms. Objects with instances included.
const SEEN: &str = "
import sys, json, bpy, addon_utils
bpy.ops.wm.read_factory_settings(use_empty=True)
path = sys.argv[1]
if path.endswith('.glb'):
    addon_utils.enable('io_scene_gltf2')
    bpy.ops.import_scene.gltf(filepath=path)
else:
    bpy.ops.wm.usd_import(filepath=path)
bpy.context.scene.frame_set(int(sys.argv[2]))
triangles = []
for i in bpy.context.evaluated_depsgraph_get().object_instances:
    if i.object.type != 'MESH':
        continue
    mesh = i.object.data
    mesh.calc_loop_triangles()
    for t in mesh.loop_triangles:
        corners = [i.matrix_world @ mesh.vertices[v].co for v in t.vertices]
        triangles.append(sorted([round(x, 4) + 0.0 for x in c] for c in corners))
print(json.dumps(sorted(triangles)))
";

#[test]
fn blender_sees_the_same_triangles_as_through_its_own_importer() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, usd) = (sample(folder.path(), "s.glb"), folder.path().join("s.usdc"));
    convert(&glb, &usd, &[]);
    // frames of Blender's scene at 24 a second: the first key, the middle, the last
    for frame in ["0", "6", "12", "24"] {
        let frame = Path::new(frame);
        let (theirs, ours) = (
            python_json(SEEN, &[&glb, frame]),
            python_json(SEEN, &[&usd, frame]),
        );
        assert!(theirs.as_array().unwrap().len() > 10);
        // Blender reads the half precision rotations of instances: 11 bits, on squares of 2 units
        assert_near(&ours, &theirs, 1e-3);
    }
}

#[test]
fn blender_has_the_same_material_values_colors_and_coordinates() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, usd) = (sample(folder.path(), "s.glb"), folder.path().join("s.usdc"));
    convert(&glb, &usd, &[]);
    const LOOKS: &str = "
import sys, json, bpy, addon_utils
bpy.ops.wm.read_factory_settings(use_empty=True)
path = sys.argv[1]
ours = not path.endswith('.glb')
if ours:
    bpy.ops.wm.usd_import(filepath=path, import_all_materials=True)
else:
    addon_utils.enable('io_scene_gltf2')
    bpy.ops.import_scene.gltf(filepath=path)
out = {}
for m in bpy.data.materials:
    nodes = [n for n in m.node_tree.nodes if n.type == 'BSDF_PRINCIPLED']
    if not nodes or m.name.startswith('flat'):
        continue
    s = nodes[0].inputs
    name = m.name.replace('_vertex_colors', '')
    emission = [x * s['Emission Strength'].default_value for x in list(s['Emission Color'].default_value)[:3]]
    out[name] = {k: s[k].default_value for k in ['Metallic', 'Roughness', 'IOR', 'Coat Weight', 'Coat Roughness'] if not s[k].is_linked}
    if not s['Base Color'].is_linked:
        out[name]['Base Color'] = list(s['Base Color'].default_value)[:3]
    if not s['Emission Color'].is_linked:
        out[name]['Emission'] = emission
    out[name]['linked'] = sorted(k for k in ['Metallic', 'Roughness', 'Normal'] if s[k].is_linked)
meshes = [o.data for o in bpy.data.objects if o.type == 'MESH' and len(o.data.vertices) == 4]
mesh = [m for m in meshes if ('COLOR_0' in m.attributes if ours else m.color_attributes)][0]
name = 'COLOR_0' if ours else mesh.color_attributes[0].name
color = mesh.attributes[name]
uv = mesh.uv_layers[0].data
corners = []
for p in mesh.polygons:
    for l in p.loop_indices:
        v = mesh.loops[l].vertex_index
        c = color.data[l if color.domain == 'CORNER' else v].color
        corners.append([round(x, 3) for x in list(c) + list(uv[l].uv)])
out['corners'] = sorted(corners)
print(json.dumps(out))
";
    let (theirs, ours) = (python_json(LOOKS, &[&glb]), python_json(LOOKS, &[&usd]));
    // theirs are 8-bit sRGB: half a code where that is steepest, and its rounding
    assert_near(&ours["corners"], &theirs["corners"], 5e-3);
    for name in ["painted", "glow", "textured"] {
        for (input, value) in theirs[name].as_object().unwrap() {
            match input.as_str() {
                "linked" => assert_eq!(&ours[name]["linked"], value, "{name}"),
                // linked in ours, a factor of white in theirs
                "Base Color" if name == "painted" => {}
                _ => assert_near(&ours[name][input], value, 1e-5),
            }
        }
    }
}

/// What usd-core makes of the converted sample.
const READ: &str = "
import sys, json, math
from pxr import Usd, UsdGeom, UsdLux, UsdShade, Gf
stage = Usd.Stage.Open(sys.argv[1])
def get(path, *names):
    prim = stage.GetPrimAtPath(path)
    plain = lambda v: v if isinstance(v, (bool, int, float, str)) or v is None else [plain(x) for x in v]
    return [plain(prim.GetAttribute(n).Get()) for n in names]
out = {'up': UsdGeom.GetStageUpAxis(stage), 'unit': UsdGeom.GetStageMetersPerUnit(stage)}
out['bulb'] = get('/root/bulb/Light', 'inputs:intensity', 'inputs:normalize', 'inputs:color', 'treatAsPoint')
out['spot'] = get('/root/spot/Light', 'inputs:intensity', 'inputs:shaping:cone:angle', 'inputs:shaping:cone:softness')
out['sun'] = get('/root/sun/Light', 'inputs:intensity', 'inputs:normalize', 'inputs:angle')
camera = UsdGeom.Camera(stage.GetPrimAtPath('/root/eye/Camera')).GetCamera(0)
out['fov'] = [math.radians(camera.GetFieldOfView(Gf.Camera.FOVVertical)), camera.aspectRatio]
out['dots'] = get('/root/dots/dots', 'points', 'widths', 'primvars:COLOR_0')
out['scattered'] = get('/root/scattered/Instances', 'positions', 'scales', 'protoIndices')
i = UsdGeom.PointInstancer(stage.GetPrimAtPath('/root/scattered/Instances'))
out['matrices'] = [[list(r) for r in m] for m in i.ComputeInstanceTransformsAtTime(0, 0)]
looks = '/root/Looks/textured/'
out['transform'] = get(looks + 'base_color_transform', 'inputs:scale', 'inputs:rotation', 'inputs:translation')
out['base'] = get(looks + 'base_color', 'inputs:sourceColorSpace', 'inputs:scale', 'inputs:wrapS', 'inputs:wrapT')
out['normal'] = get(looks + 'normal', 'inputs:sourceColorSpace', 'inputs:scale', 'inputs:bias')
out['occlusion'] = get(looks + 'occlusion', 'inputs:scale', 'inputs:bias')
out['threshold'] = get(looks + 'surface', 'inputs:opacityThreshold')
surface = UsdShade.Shader(stage.GetPrimAtPath(looks + 'surface'))
out['sources'] = {n: surface.GetInput(n).GetConnectedSources()[0][0].sourceName for n in ['diffuseColor', 'opacity', 'metallic', 'roughness', 'occlusion']}
out['unlit'] = get('/root/Looks/flat/surface', 'inputs:emissiveColor', 'inputs:diffuseColor', 'inputs:specularColor')
def network(name):
    surface, values = UsdShade.Shader(stage.GetPrimAtPath(f'/root/Looks/{name}/surface')), {}
    for i in surface.GetInputs():
        sources = i.GetConnectedSources()[0]
        value = i.Get() if not sources else [sources[0].sourceName] + get(str(sources[0].source.GetPath()),
            'inputs:sourceColorSpace', 'inputs:scale', 'inputs:bias')
        values[i.GetBaseName()] = value if isinstance(value, (int, float)) else list(value)
    return values
out['coated'], out['glossy'] = network('coated'), network('glossy')
out['moved coat'] = get('/root/Looks/coated/clearcoatRoughness_transform', 'inputs:scale')
out['file'] = stage.GetPrimAtPath(looks + 'base_color').GetAttribute('inputs:file').Get().resolvedPath
out['double'] = [UsdGeom.Mesh(stage.GetPrimAtPath(p)).GetDoubleSidedAttr().Get() for p in ['/root/moved_001/square', '/root/unlit/unlit']]
print(json.dumps(out))
";

/// Each of the values of `key` is the one of `truth`.
fn expect(read: &Json, key: &str, truth: &Json) {
    let values = read[key].as_array().expect("a list").iter();
    for (value, truth) in values.zip(truth.as_array().expect("a list")) {
        match truth {
            Json::String(_) | Json::Bool(_) => assert_eq!(value, truth, "{key}"),
            _ => assert_near(value, truth, 1e-5),
        }
    }
}

#[test]
fn usd_core_reads_lights_cameras_and_points_as_the_file_means_them() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, usd) = (sample(folder.path(), "s.glb"), folder.path().join("s.usda"));
    convert(&glb, &usd, &[]);
    let read = python_json(READ, &[&usd]);
    assert_eq!(
        (read["up"].as_str(), read["unit"].as_f64()),
        (Some("Y"), Some(1.0))
    );
    expect(
        &read,
        "bulb",
        &serde_json::json!([100.0, true, [1.0, 0.5, 0.25], true]),
    );
    expect(&read, "spot", &serde_json::json!([160.0, 22.918_312, 0.5]));
    expect(&read, "sun", &serde_json::json!([3.0, true, 0.0]));
    expect(&read, "fov", &serde_json::json!([0.8, 1.5]));
    expect(
        &read,
        "dots",
        &serde_json::json!([
            [[0.0, 3.0, 0.0], [0.5, 3.0, 0.0], [1.0, 3.5, 0.0]],
            [0.2, 0.4, 0.1],
            [
                [0.1, 0.2, 0.3, 1.0],
                [1.0, 0.5, 0.0, 1.0],
                [0.0, 0.25, 2.0, 1.0]
            ]
        ]),
    );
    expect(
        &read,
        "scattered",
        &serde_json::json!([
            [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [3.0, 0.0, 1.0]],
            [[1.0, 1.0, 1.0], [0.5, 0.5, 0.5], [1.0, 2.0, 0.25]],
            [0, 0, 0]
        ]),
    );
    // the second turns x to -z and halves
    assert_near(
        &read["matrices"][1][0],
        &serde_json::json!([0.0, 0.0, -0.5, 0.0]),
        1e-6,
    );
}

#[test]
fn usd_core_reads_materials_and_textures_as_the_file_means_them() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, usd) = (sample(folder.path(), "s.glb"), folder.path().join("s.usda"));
    let report = convert(&glb, &usd, &[]);
    let read = python_json(READ, &[&usd]);
    expect(
        &read,
        "base",
        &serde_json::json!(["sRGB", [1.0, 0.5, 1.0, 1.0], "clamp", "mirror"]),
    );
    expect(
        &read,
        "normal",
        &serde_json::json!(["raw", [2.0, 2.0, 2.0, 1.0], [-1.0, -1.0, -1.0, 0.0]]),
    );
    let lost = report["warnings"].as_array().unwrap().iter();
    let lost: Vec<&Json> = lost.filter(|warning| warning["kind"] == "lost").collect();
    assert_eq!(lost.len(), 1, "{lost:?}");
    assert!(lost[0]["message"].as_str().unwrap().contains("scale 0.5"));
    expect(
        &read,
        "occlusion",
        &serde_json::json!([[0.6, 0.6, 0.6, 1.0], [0.4, 0.4, 0.4, 0.0]]),
    );
    expect(&read, "threshold", &serde_json::json!([0.4]));
    expect(
        &read,
        "transform",
        &serde_json::json!([
            [2.0, 3.0],
            0.5_f64.to_degrees(),
            [0.25 + 3.0 * 0.5_f64.sin(), 0.5 - 3.0 * 0.5_f64.cos()]
        ]),
    );
    let sources = serde_json::json!({"diffuseColor": "rgb", "opacity": "a", "metallic": "b", "roughness": "g", "occlusion": "r"});
    assert_eq!(read["sources"], sources);
    expect(
        &read,
        "unlit",
        &serde_json::json!([[0.1, 0.6, 0.3], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    );
    assert_eq!(read["double"], serde_json::json!([true, false]));
    // the packed image is beside it, byte for byte a PNG
    let image = fs::read(read["file"].as_str().unwrap()).unwrap();
    assert!(image.starts_with(b"\x89PNG"));
    assert_eq!(
        report["outputs"][1]
            .as_str()
            .map(|name| name.ends_with("0_corner_colors.png")),
        Some(true)
    );
}

#[test]
fn usd_core_reads_coats_and_specular_gloss_as_the_file_means_them() {
    let folder = tempfile::tempdir().unwrap();
    let (glb, usd) = (sample(folder.path(), "s.glb"), folder.path().join("s.usda"));
    convert(&glb, &usd, &[]);
    let read = python_json(READ, &[&usd]);
    assert_eq!(read["moved coat"], serde_json::json!([[2.0, 3.0]]));
    for (key, values) in read["coated"].as_object().unwrap() {
        let factor = |x: f32| serde_json::json!([x, x, x, x]);
        let truth = match key.as_str() {
            "clearcoat" => serde_json::json!(["r", "raw", factor(0.7), null]),
            "clearcoatRoughness" => serde_json::json!(["g", "raw", factor(0.4), null]),
            _ => continue,
        };
        assert_eq!(values, &truth);
    }
    let glossy = serde_json::json!({
        "diffuseColor": [0.2_f32, 0.4_f32, 0.6_f32],
        "opacity": 0.5,
        "useSpecularWorkflow": 1,
        "specularColor": ["rgb", "sRGB", [0.5, 0.25, 1.0, -0.75], [0.0, 0.0, 0.0, 1.0]],
        "roughness": ["a", "sRGB", [0.5, 0.25, 1.0, -0.75], [0.0, 0.0, 0.0, 1.0]]
    });
    assert_eq!(read["glossy"], glossy);
}

/// Vertices of every curve of the sample's strip in order, closed ones with the first again; and what Pixar's validators say.
const CURVES: &str = "
import sys, json
from pxr import Usd, UsdGeom, UsdValidation
stage = Usd.Stage.Open(sys.argv[1])
curves = [UsdGeom.BasisCurves(p) for p in stage.Traverse() if p.IsA(UsdGeom.BasisCurves)][0]
points, at, out = [list(p) for p in curves.GetPointsAttr().Get()], 0, []
for count in curves.GetCurveVertexCountsAttr().Get():
    curve = points[at:at + count]
    out.append(curve + curve[:1] if curves.GetWrapAttr().Get() == 'periodic' else curve)
    at += count
context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
print(json.dumps({'curves': out, 'type': curves.GetTypeAttr().Get(), 'widths': list(curves.GetWidthsAttr().Get()),
    'errors': [e.GetName() for e in context.Validate(stage)]}))
";

#[test]
fn usd_core_reads_lines_as_the_file_connects_them() {
    let folder = tempfile::tempdir().unwrap();
    let text = fs::read_to_string(sample(folder.path(), "s.gltf")).unwrap();
    let at = [
        [0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [2.0, 0.0, 0.5],
    ];
    let [a, b, c, d, e] = at;
    let truths = [
        ("1", serde_json::json!([[a, b], [c, d]])),
        ("2", serde_json::json!([[a, b, c, d, e, a]])),
        ("3", serde_json::json!([[a, b, c, d, e]])),
    ];
    for (mode, truth) in truths {
        let from = folder.path().join("lines.gltf");
        let to = folder.path().join("lines.usda");
        let lines = text.replacen("\"mode\": 5", &format!("\"mode\": {mode}"), 1);
        assert_ne!(lines, text);
        fs::write(&from, lines).unwrap();
        let report = convert(&from, &to, &[]);
        assert!(report.to_string().contains("no width"), "{report}");
        let read = python_json(CURVES, &[&to]);
        assert_eq!(read["curves"], truth, "mode {mode}");
        assert_eq!(read["type"], "linear");
        assert_eq!(read["errors"], Json::Array(Vec::new()));
        assert_eq!(read["widths"].as_array().unwrap().len(), 1);
    }
}

/// What the file may leave out: bounds of accessors, nodes of a scene, what kind of image a view holds, the image of a texture.
#[test]
fn what_may_be_left_out_is_no_flaw() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (
        sample(folder.path(), "s.gltf"),
        folder.path().join("s.usda"),
    );
    let mut root: Json = serde_json::from_slice(&fs::read(&from).unwrap()).unwrap();
    let prims = convert(&from, &to, &[])["counts"]["prims"].clone();
    for accessor in root["accessors"].as_array_mut().unwrap() {
        let accessor = accessor.as_object_mut().unwrap();
        accessor.retain(|key, _| key != "min" && key != "max");
    }
    let scenes = root["scenes"].as_array_mut().unwrap();
    scenes.push(serde_json::json!({"name": "nothing"}));
    root["images"][0]
        .as_object_mut()
        .unwrap()
        .remove("mimeType");
    root["textures"]
        .as_array_mut()
        .unwrap()
        .push(Json::from(serde_json::Map::<String, Json>::default()));
    root["materials"][2]["normalTexture"]["index"] = Json::from(1);
    fs::write(&from, root.to_string()).unwrap();
    let report = convert(&from, &to, &[]);
    assert_eq!(report["counts"]["prims"], prims);
    assert_eq!(report["outputs"].as_array().unwrap().len(), 2);
    assert!(report["warnings"].to_string().contains("texture 1 has no"));
}

#[test]
fn damaged_files_are_errors_and_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let glb = fs::read(sample(folder.path(), "s.glb")).unwrap();
    let text = fs::read_to_string(sample(folder.path(), "s.gltf")).unwrap();
    must_fail("a.glb", b"", "JSON");
    must_fail("a.glb", &glb[..11], "GLB");
    must_fail("a.glb", &glb[..glb.len() / 2], "GLB");
    must_fail("a.glb", b"glTF\x01\0\0\0\x20\0\0\0", "glTF 1.0");
    must_fail("a.gltf", b"{\"nodes\": {\"box\": {}}}", "glTF 1.0");
    must_fail("a.gltf", b"{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [{\"children\": [1]}, {\"children\": [0]}], \
        \"scenes\": [{\"nodes\": [0]}]}", "below itself");
    must_fail("a.gltf", b"{\"asset\": {\"version\": \"2.0\"}, \"extensionsRequired\": [\"KHR_draco_mesh_compression\"]}", "draco");
    must_fail("a.gltf", b"{\"asset\": {\"version\": \"2.0\"}, \"buffers\": [{\"byteLength\": 4, \"uri\": \"missing.bin\"}]}", "missing.bin");
    let changed = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1).into_bytes()
    };
    must_fail(
        "a.gltf",
        &changed("\"count\": 4", "\"count\": 4000000000000"),
        "do not fit",
    );
    must_fail(
        "a.gltf",
        &changed("\"count\": 4", "\"count\": 3"),
        "are needed",
    );
    must_fail(
        "a.gltf",
        &changed("\"type\": \"perspective\"", "\"type\": \"orthographic\""),
        "no lens",
    );
    must_fail(
        "a.gltf",
        &changed("\"images\": [{", "\"images\": [{}, {"),
        "neither uri nor",
    );
    must_fail("a.gltf", &changed("\"mesh\": 0", "\"mesh\": 99"), "valid");
    must_fail(
        "a.gltf",
        &changed("\"byteOffset\": 0", "\"byteOffset\": 9999999"),
        "reaches to byte",
    );
    survives("a.glb", &glb);
    survives("a.gltf", text.as_bytes());
}
