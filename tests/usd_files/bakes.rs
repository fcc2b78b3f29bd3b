//! Bakes composed over their assets: every value where it belongs.

use crate::python::run_python;
use crate::{VALIDATE, floats, json, noise, program, provenance, single, stage_info};
use glam::{Affine3A, DVec3};
use serde_json::Value as Json;
use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use surflux::diagnostics::Diagnostics;
use surflux::results::{Aov, AovBuffer, BakeInterpolation, PrimvarSpan, Results};
use surflux::scene::{
    EnclosingInstance, FaceMaterials, MeshId, Prim, PrimId, PrimSource, Purpose, Scene, StageInfo,
};
use surflux::writers::usd::layer::{BakeOptions, InstancePolicy, LayerWriter};
use tempfile::TempDir;

/// An asset with references, a payload, a variant, native instances and an instancer.
fn asset() -> TempDir {
    let folder = tempfile::tempdir().expect("folder");
    fs::create_dir(folder.path().join("parts")).expect("folder");
    let quad = "int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0, 1, 2, 3]\n \
                point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0)]\n uniform token subdivisionScheme = \"none\"\n \
                color3f[] primvars:displayColor = [(1,0,0), (0,1,0)] (interpolation = \"vertex\")\n \
                int[] primvars:displayColor:indices = [0, 1, 0, 1]";
    let part =
        "#usda 1.0\n( defaultPrim = \"p\" )\ndef Xform \"p\" ( payload = @./mesh.usda@</m> ) {}\n";
    fs::write(folder.path().join("parts/part.usda"), part).expect("written");
    let mesh = format!("#usda 1.0\ndef Xform \"m\" {{\n def Mesh \"quad\" {{\n {quad}\n }}\n}}\n");
    fs::write(folder.path().join("parts/mesh.usda"), mesh).expect("written");
    let asset = format!(
        r#"#usda 1.0
( defaultPrim = "World"
  upAxis = "Z"
  metersPerUnit = 0.1
  timeCodesPerSecond = 25 )
def Xform "World" {{
    def "direct" ( references = @./parts/part.usda@ ) {{}}
    def "i1" ( instanceable = true
               references = @./parts/part.usda@ ) {{}}
    def "i2" ( instanceable = true
               references = @./parts/part.usda@ ) {{}}
    def Xform "v" ( variants = {{ string shape = "quad" }}
              prepend variantSets = "shape" ) {{
        variantSet "shape" = {{
            "quad" {{
                def Mesh "quad" {{
                    {quad}
                    rel material:binding = </World/look>
                    uniform token subsetFamily:materialBind:familyType = "nonOverlapping"
                    def GeomSubset "s" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {{
                        uniform token elementType = "face"
                        uniform token familyName = "materialBind"
                        int[] indices = [0]
                        rel material:binding = </World/look>
                    }}
                }}
            }}
        }}
    }}
    def Material "look" {{}}
    def PointInstancer "I" {{
        rel prototypes = </World/I/P>
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 0, 0), (5, 0, 0)]
        def Xform "P" {{
            def Mesh "quad" {{
                {quad}
            }}
        }}
    }}
}}
"#
    );
    fs::write(folder.path().join("asset.usda"), asset).expect("written");
    folder
}

fn native(root: &str) -> (String, PrimSource) {
    let source = PrimSource::NativeInstance {
        instances: Arc::new([EnclosingInstance {
            path_length: root.len(),
            first: "/World/i1".into(),
        }]),
        shared_path: "/World/i1/quad".into(),
    };
    (format!("{root}/quad"), source)
}

fn point(index: u32) -> (String, PrimSource) {
    let source = PrimSource::PointInstance {
        instancer: "/World/I".into(),
        index,
        shared_path: "/World/I/P/quad".into(),
    };
    (format!("/World/I[{index}]/quad"), source)
}

fn scene(info: &StageInfo) -> Scene {
    let direct = |path: &str| (path.to_owned(), PrimSource::Direct);
    let occurrences = vec![
        direct("/World/direct/quad"),
        native("/World/i1"),
        native("/World/i2"),
        direct("/World/v/quad"),
        point(0),
        point(1),
    ];
    let prim = |(path, source): (String, PrimSource)| Prim {
        path: path.into(),
        mesh: MeshId(0),
        world_from_object: Affine3A::IDENTITY,
        materials: FaceMaterials::Whole(None),
        purpose: Purpose::Default,
        source,
    };
    Scene {
        stage: info.clone(),
        origin: DVec3::ZERO,
        meshes: Vec::new(),
        prims: occurrences.into_iter().map(prim).collect(),
        materials: Vec::new(),
        lights: Vec::new(),
        cameras: Vec::new(),
        render_settings: Vec::new(),
    }
}

/// Four values a prim; receivers in reverse order, so that the map matters.
fn spans(prims: u32) -> Vec<PrimvarSpan> {
    let span = |prim: u32| PrimvarSpan {
        prim: PrimId(prim),
        interpolation: BakeInterpolation::Vertex,
        receiver_of_value: (0..4).map(|i| prim * 4 + 3 - i).collect(),
    };
    (0..prims).map(span).collect()
}

fn results(prims: u32, salt: u32) -> Results {
    let buffer = |aov: Aov| AovBuffer {
        aov,
        data: (0..prims * 4 * u32::try_from(aov.components()).expect("few"))
            .map(|i| noise(i + salt))
            .collect(),
    };
    let id = AovBuffer {
        aov: Aov::PrimId,
        data: (0..prims * 4).map(|i| (i / 4) as f32).collect(),
    };
    let aovs = [
        Aov::Occlusion,
        Aov::Irradiance,
        Aov::BentNormal,
        Aov::Color,
        Aov::VisibilitySh,
    ];
    let mut buffers: Vec<_> = aovs.map(buffer).into();
    buffers.push(id);
    Results {
        buffers,
        ..Results::default()
    }
}

fn value(results: &Results, aov: Aov, prim: u32, point: u32) -> &[f32] {
    let width = aov.components();
    let at = (prim * 4 + 3 - point) as usize * width;
    &results.get(aov).expect("there").data[at..at + width]
}

fn bake(folder: &TempDir, name: &str, instances: InstancePolicy) -> (Vec<PathBuf>, Diagnostics) {
    let info = stage_info(&folder.path().join("asset.usda"));
    let options = BakeOptions {
        aovs: results(1, 0).buffers.iter().map(|b| b.aov).collect(),
        display_color: Some(Aov::Occlusion),
        instances,
        provenance: provenance(),
    };
    let diagnostics = Diagnostics::default();
    let mut writer = LayerWriter::new(&info, options);
    let scene = scene(&info);
    writer.add((&scene, &spans(6)), &results(6, 0), None, &diagnostics);
    let outputs = writer.write(&folder.path().join(name)).expect("written");
    (outputs, diagnostics)
}

const READ_BAKE: &str = r#"
import json, sys
from pxr import Usd, UsdGeom, UsdShade
stage = Usd.Stage.Open(sys.argv[1])
time = Usd.TimeCode(float(sys.argv[2])) if len(sys.argv) > 2 else Usd.TimeCode.Default()
plain = lambda v: [list(x) if hasattr(x, "__len__") else x for x in v]
meshes = {}
for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
    if prim.GetTypeName() != "Mesh":
        continue
    primvars = {}
    for p in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues():
        primvars[p.GetPrimvarName()] = [str(p.GetTypeName()), p.GetInterpolation(), plain(p.ComputeFlattened(time))]
    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    subset = prim.GetChild("s")
    meshes[str(prim.GetPath())] = {"primvars": primvars, "proxy": prim.IsInstanceProxy(), "points": len(prim.GetAttribute("points").Get()),
        "material": str(bound.GetPath()),
        "subset": str(UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()[0].GetPath()) if subset else ""}
print(json.dumps({"meshes": meshes, "prototypes": len(stage.GetPrototypes()), "sublayers": list(stage.GetRootLayer().subLayerPaths),
    "meta": [UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage), stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode(),
        str(stage.GetDefaultPrim().GetPath())],
    "specifiers": sorted({str(p.specifier) for p in [stage.GetRootLayer().GetPrimAtPath(x) for x in ["/World"]] if p})}))
"#;

fn primvar<'a>(read: &'a Json, mesh: &str, name: &str) -> &'a Json {
    &read["meshes"][mesh]["primvars"][name]
}

fn has_values(read: &Json, mesh: &str, prims: &[u32]) {
    let results = results(6, 0);
    for (aov, type_name) in [
        (Aov::Occlusion, "float[]"),
        (Aov::Irradiance, "color3f[]"),
        (Aov::Color, "color4f[]"),
    ] {
        let entry = primvar(read, mesh, aov.name());
        assert_eq!(entry[0], type_name, "{mesh} {aov}");
        assert_eq!(entry[1], "vertex");
        let read = floats(&entry[2]);
        assert_eq!(read.len(), 4 * aov.components(), "{mesh} {aov}");
        for (i, read) in (0..).zip(read.chunks(aov.components())) {
            for (c, &read) in read.iter().enumerate() {
                let one = |&prim: &u32| f64::from(value(&results, aov, prim, i)[c]);
                let mean = prims.iter().map(one).sum::<f64>() / prims.len() as f64;
                assert_eq!(read, single(mean), "{mesh} {aov} {i} {c}");
            }
        }
    }
    let occlusion = floats(&primvar(read, mesh, "occlusion")[2]);
    let shown: Vec<f32> = occlusion.iter().flat_map(|&v| [v; 3]).collect();
    assert_eq!(
        floats(&primvar(read, mesh, "displayColor")[2]),
        shown,
        "not by the asset's indices"
    );
}

#[test]
fn a_bake_over_its_asset_has_every_value_and_shared_instances_their_average() {
    let folder = asset();
    let (outputs, diagnostics) = bake(&folder, "out.usdc", InstancePolicy::Shared);
    assert_eq!(
        outputs,
        [
            folder.path().join("out.usdc"),
            folder.path().join("out_baked.usda")
        ]
    );
    assert_eq!(diagnostics.warnings(), []);
    let read = json(&run_python(READ_BAKE, &[&outputs[1]]));
    assert_eq!(
        read["sublayers"],
        serde_json::json!(["./out.usdc", "./asset.usda"])
    );
    assert_eq!(
        read["meta"],
        serde_json::json!(["Z", 0.1, 25.0, 0.0, 0.0, "/World"])
    );
    assert_eq!(read["prototypes"], 1, "instances stay instances");
    has_values(&read, "/World/direct/quad", &[0]);
    has_values(&read, "/World/v/quad", &[3]);
    has_values(&read, "/World/i1/quad", &[1, 2]);
    has_values(&read, "/World/i2/quad", &[1, 2]);
    has_values(&read, "/World/I/P/quad", &[4, 5]);
    for (mesh, about) in read["meshes"].as_object().expect("meshes") {
        assert_eq!(about["points"], 4);
        assert_eq!(about["material"], "/World/surflux_display", "{mesh}");
    }
    let subset = &read["meshes"]["/World/v/quad"]["subset"];
    assert_eq!(
        subset, "/World/surflux_display",
        "the subset's own look gives way"
    );
    assert_eq!(
        primvar(&read, "/World/direct/quad", "bent_normal")[0],
        "normal3f[]"
    );
    let whole = primvar(&read, "/World/v/quad", "visibility_sh");
    assert!(whole.is_null(), "USD has no type for nine floats");
    for k in 0..9 {
        let name = format!("visibility_sh{k}");
        let entry = primvar(&read, "/World/v/quad", &name);
        assert_eq!(entry[0], "float[]");
        let results = results(6, 0);
        let expected = (0..4).map(|i| value(&results, Aov::VisibilitySh, 3, i)[k]);
        assert_eq!(floats(&entry[2]), expected.collect::<Vec<_>>(), "{name}");
    }
    assert_eq!(
        floats(&primvar(&read, "/World/v/quad", "primId")[2]),
        [3.0; 4]
    );
}

#[test]
fn deinstanced_instances_have_values_of_their_own() {
    let folder = asset();
    let (outputs, diagnostics) = bake(&folder, "own.usda", InstancePolicy::Deinstance);
    let read = json(&run_python(READ_BAKE, &[&outputs[1]]));
    assert_eq!(read["prototypes"], 0);
    has_values(&read, "/World/i1/quad", &[1]);
    has_values(&read, "/World/i2/quad", &[2]);
    assert!(primvar(&read, "/World/I/P/quad", "occlusion").is_null());
    let warned: Vec<_> = diagnostics.warnings().into_iter().map(|w| w.prim).collect();
    assert_eq!(warned, ["/World/I"]);
}

#[test]
fn skipped_instances_are_warned_of_and_keep_their_look() {
    let folder = asset();
    let (outputs, diagnostics) = bake(&folder, "skip.usdc", InstancePolicy::Skip);
    let read = json(&run_python(READ_BAKE, &[&outputs[1]]));
    has_values(&read, "/World/direct/quad", &[0]);
    assert!(primvar(&read, "/World/i1/quad", "occlusion").is_null());
    let warned: Vec<_> = diagnostics.warnings().into_iter().map(|w| w.prim).collect();
    assert_eq!(warned, ["/World/I", "/World/i1", "/World/i2"]);
}

#[test]
fn the_bake_holds_only_overs_and_classes() {
    let folder = asset();
    let (outputs, _) = bake(&folder, "out.usdc", InstancePolicy::Shared);
    let script = "import sys; from pxr import Sdf\nlayer = Sdf.Layer.FindOrOpen(sys.argv[1])\n\
                  kinds = set(); layer.Traverse('/', lambda p: kinds.add(str(layer.GetPrimAtPath(p).specifier)) if p.IsPrimPath() else None)\n\
                  print(sorted(kinds), layer.pseudoRoot.GetInfo('upAxis'), layer.pseudoRoot.GetInfo('metersPerUnit'))";
    let kinds = run_python(script, &[&outputs[0]]);
    assert_eq!(
        kinds.trim(),
        "['Sdf.SpecifierClass', 'Sdf.SpecifierOver'] Z 0.1"
    );
}

#[test]
fn several_frames_become_samples_of_one_layer() {
    let folder = asset();
    let info = stage_info(&folder.path().join("asset.usda"));
    let options = BakeOptions {
        aovs: vec![Aov::Occlusion],
        display_color: None,
        ..BakeOptions::default()
    };
    let mut writer = LayerWriter::new(&info, options);
    let scene = scene(&info);
    let diagnostics = Diagnostics::default();
    let frame = |salt| results(1, salt);
    writer.add((&scene, &spans(1)), &frame(90), Some(103.5), &diagnostics);
    writer.add((&scene, &spans(1)), &frame(50), Some(101.0), &diagnostics);
    let outputs = writer
        .write(&folder.path().join("anim.usdc"))
        .expect("written");
    for (time, salt) in [("101", 50), ("103.5", 90)] {
        let arguments = [outputs[1].to_str().expect("UTF-8"), time];
        let read = json(&run_python(READ_BAKE, &arguments));
        let expected: Vec<f32> = (0..4)
            .map(|i| value(&frame(salt), Aov::Occlusion, 0, i)[0])
            .collect();
        assert_eq!(
            floats(&primvar(&read, "/World/direct/quad", "occlusion")[2]),
            expected
        );
        assert_eq!(read["meta"][3], 101.0);
        assert_eq!(read["meta"][4], 103.5);
        let asset_color = floats(&primvar(&read, "/World/direct/quad", "displayColor")[2]);
        assert_eq!(
            asset_color[..6],
            [1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            "the asset's own stays"
        );
        assert_eq!(read["meshes"]["/World/v/quad"]["material"], "/World/look");
    }
}

#[test]
fn the_validators_of_usd_find_nothing_structural_in_a_bake() {
    let folder = asset();
    let (outputs, _) = bake(&folder, "out.usdc", InstancePolicy::Shared);
    assert_eq!(run_python(VALIDATE, &[&outputs[1]]), "");
    // overs alone have no prim to be the default one
    assert_eq!(run_python(VALIDATE, &[&outputs[0]]).lines().count(), 1);
}

const BLENDER_BAKE: &str = r#"
import bpy, json, numpy, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=sys.argv[1], merge_parent_xform=False)
out = {}
for o in bpy.data.objects:
    if o.type != "MESH":
        continue
    mesh = o.data
    entry = {"active": mesh.color_attributes.active_color.name if mesh.color_attributes.active_color else None,
             "emission": None}
    for name, field, width in (("occlusion", "value", 1), ("irradiance", "color", 4)):
        if name in mesh.attributes:
            values = numpy.empty(len(mesh.attributes[name].data) * width, dtype=numpy.float32)
            mesh.attributes[name].data.foreach_get(field, values)
            entry[name] = values.tolist()
    for material in mesh.materials:
        for node in material.node_tree.nodes:
            if node.type == "ATTRIBUTE":
                entry["emission"] = [node.attribute_name, sorted(l.to_socket.name for l in node.outputs["Color"].links)]
    out.setdefault(o.parent.name if o.parent else "", entry)
print()
print(json.dumps(out))
"#;

#[test]
fn blender_shows_the_bake_with_every_value() {
    let folder = asset();
    let (outputs, _) = bake(&folder, "out.usdc", InstancePolicy::Deinstance);
    let read = json(&run_python(BLENDER_BAKE, &[&outputs[1]]));
    let results = results(6, 0);
    for (parent, prim) in [("direct", 0), ("i1", 1), ("i2", 2), ("v", 3)] {
        let entry = &read[parent];
        assert!(entry["occlusion"].is_array(), "{parent}: {read}");
        let expected: Vec<f32> = (0..4)
            .map(|i| value(&results, Aov::Occlusion, prim, i)[0])
            .collect();
        assert_eq!(floats(&entry["occlusion"]), expected, "{parent}: {read}");
        let color = |i| {
            let c = value(&results, Aov::Irradiance, prim, i);
            [c[0], c[1], c[2], 1.0]
        };
        let expected: Vec<f32> = (0..4).flat_map(color).collect();
        assert_eq!(floats(&entry["irradiance"]), expected, "{parent}");
        assert_eq!(entry["active"], "displayColor");
        assert_eq!(
            entry["emission"],
            serde_json::json!(["displayColor", ["Emission Color"]])
        );
    }
}

/// Three walls in a row, each two instances deep, and one instance of the inner kind by itself.
const NESTED: &str = r#"#usda 1.0
( defaultPrim = "World" )
def Xform "World" {
    def "a" ( instanceable = true
              references = </Kit/outer> ) {}
    def "b" ( instanceable = true
              references = </Kit/outer> ) { double3 xformOp:translate = (4, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]; }
    def "c" ( instanceable = true
              references = </Kit/inner> ) { double3 xformOp:translate = (0, 0, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]; }
}
class "Kit" {
    def Xform "outer" {
        def "left" ( instanceable = true
                     references = </Kit/inner> ) {}
        def "right" ( instanceable = true
                      references = </Kit/inner> ) { double3 xformOp:translate = (2, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]; }
        def Mesh "post" {
            int[] faceVertexCounts = [4]
            int[] faceVertexIndices = [0, 1, 2, 3]
            point3f[] points = [(0,0,0.5), (1,0,0.5), (1,1,0.5), (0,1,0.5)]
            uniform token subdivisionScheme = "none"
        }
    }
    def Xform "inner" {
        def Mesh "quad" {
            int[] faceVertexCounts = [4]
            int[] faceVertexIndices = [0, 1, 2, 3]
            point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0)]
            uniform token subdivisionScheme = "none"
        }
    }
}
"#;

/// Occlusion of every mesh as usd-core reads the bake of [`NESTED`]; they must all be below instances, or none.
fn nested_bake(policy: &str, instanced: bool) -> BTreeMap<String, Vec<f32>> {
    let (folder, stage) = program::stage(NESTED);
    let out = folder.path().join("out.usdc");
    let arguments = [
        "bake",
        "--aov",
        "occlusion",
        "--usd",
        "native",
        "--rays",
        "64",
    ];
    let output = program::surflux()
        .args(arguments)
        .args(["--instances", policy, "-q", "--json", "-o"])
        .args([&out, &stage])
        .output()
        .expect("the program starts");
    assert_eq!(program::json(&output)["warnings"], serde_json::json!([]));
    let read = json(&run_python(
        READ_BAKE,
        &[folder.path().join("out_baked.usda")],
    ));
    let meshes = read["meshes"].as_object().expect("meshes");
    meshes
        .iter()
        .filter(|(path, _)| path.starts_with("/World"))
        .map(|(path, about)| {
            assert_eq!(about["proxy"], instanced, "{path}");
            (path.clone(), floats(&primvar(&read, path, "occlusion")[2]))
        })
        .collect()
}

#[test]
fn instances_inside_instances_keep_their_values() {
    let own = nested_bake("deinstance", false);
    let quads = ["a/left", "a/right", "b/left", "b/right", "c"].map(|p| format!("/World/{p}/quad"));
    assert_eq!(own.len(), 7);
    assert!(own.values().all(|values| values.len() == 4));
    assert!(
        own[&quads[0]] != own[&quads[1]],
        "only the left one has something above it"
    );
    let shared = nested_bake("shared", true);
    for i in 0..4 {
        let mean = quads.iter().map(|quad| own[quad][i]).sum::<f32>() / 5.0;
        for quad in &quads {
            assert!((shared[quad][i] - mean).abs() < 1e-6, "{quad}");
        }
        let posts = ["/World/a/post", "/World/b/post"];
        let mean = posts.iter().map(|&post| own[post][i]).sum::<f32>() / 2.0;
        assert!(
            posts
                .iter()
                .all(|&post| (shared[post][i] - mean).abs() < 1e-6)
        );
    }
}
