//! Clouds and bakes of ours, opened with the programs they are for: Pixar's usd-core and Blender.

#[path = "support/program.rs"]
#[expect(dead_code, reason = "for other tests")]
mod program;
#[path = "support/python.rs"]
mod python;

use glam::{Affine3A, DVec3, Vec3};
use python::run_python;
use serde_json::Value as Json;
use std::collections::BTreeMap;
use std::f32::consts::PI;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use surflux::diagnostics::Diagnostics;
use surflux::results::{Aov, AovBuffer, BakeInterpolation, PrimvarSpan, Results};
use surflux::scene::{
    EnclosingInstance, FaceMaterials, MeshId, Prim, PrimId, PrimSource, Purpose, Scene, StageInfo,
    UpAxis,
};
use surflux::stage::cloud::read_cloud;
use surflux::surfels::SurfelCloud;
use surflux::writers::usd::cloud::{self, CloudOptions};
use surflux::writers::usd::layer::{BakeOptions, InstancePolicy, LayerWriter};
use surflux::writers::usd::{Error, Provenance};
use tempfile::TempDir;

fn stage_info(path: &Path) -> StageInfo {
    StageInfo {
        path: path.to_owned(),
        up_axis: UpAxis::Z,
        meters_per_unit: 0.1,
        default_prim: Some("World".to_owned()),
        time_range: None,
        time_codes_per_second: 25.0,
        time: None,
        layers: Vec::new(),
        variants: Vec::new(),
        reader: "usd-core".to_owned(),
    }
}

fn provenance() -> Provenance {
    Provenance {
        version: "1.2.3".to_owned(),
        command: ["surflux", "bake", "a \"b\""].map(str::to_owned).to_vec(),
        comment: Some("a note".to_owned()),
    }
}

fn json(text: &str) -> Json {
    serde_json::from_str(text.lines().last().expect("a line")).expect("JSON")
}

fn floats(value: &Json) -> Vec<f32> {
    match value {
        Json::Array(values) => values.iter().flat_map(floats).collect(),
        other => vec![single(other.as_f64().expect("a number"))],
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "values are compared in single precision"
)]
fn single(value: f64) -> f32 {
    value as f32
}

fn flat(values: &[Vec3]) -> Vec<f32> {
    values.iter().flat_map(|v| v.to_array()).collect()
}

// ---- clouds ----

/// Numbers without structure, the same every time.
fn noise(seed: u32) -> f32 {
    let mut x = seed.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    x = (x ^ (x >> 15)).wrapping_mul(0x2C1B_3C6D);
    x = (x ^ (x >> 12)).wrapping_mul(0x297A_2D39);
    ((x ^ (x >> 15)) >> 8) as f32 / (1 << 24) as f32
}

fn noise3(seed: u32) -> Vec3 {
    Vec3::new(noise(3 * seed), noise(3 * seed + 1), noise(3 * seed + 2))
}

fn some_cloud(count: u32) -> SurfelCloud {
    let each = |salt: u32| (0..count).map(move |i| noise3(i * 7 + salt));
    SurfelCloud {
        origin: DVec3::ZERO,
        position: each(0).map(|v| v * 100.0 - 50.0).collect(),
        normal: each(1).map(|v| (v - 0.5).normalize_or(Vec3::Y)).collect(),
        radius: each(2).map(|v| v.x + 0.01).collect(),
        area: each(2).map(|v| PI * v.x * v.x).collect(),
        radiosity: each(3).map(|v| v * 1000.0).collect(),
        albedo: each(4).collect(),
        emission: each(5).collect(),
        prim: (0..count).map(|i| i % 3).collect(),
        prim_paths: ["/World/a", "/World/b", "/World/c"]
            .map(str::to_owned)
            .to_vec(),
        spacing: 0.25,
    }
}

fn write_cloud(cloud: &SurfelCloud, path: &Path) {
    let options = CloudOptions {
        provenance: provenance(),
        light_group: Some("key".to_owned()),
    };
    cloud::write(cloud, &stage_info(Path::new("shot.usda")), path, &options).expect("written");
}

#[test]
fn a_cloud_comes_back_to_the_bit_from_binary_and_text() {
    let folder = tempfile::tempdir().expect("folder");
    let origin = DVec3::new(1e9, -2.5, 1e-3);
    for (name, origin) in [
        ("a.usdc", DVec3::ZERO),
        ("b.usda", origin),
        ("c.usd", origin),
    ] {
        let path = folder.path().join(name);
        let cloud = SurfelCloud {
            origin,
            ..some_cloud(200)
        };
        write_cloud(&cloud, &path);
        let diagnostics = Diagnostics::default();
        let back = read_cloud(&path, origin, &diagnostics).expect("read");
        assert_eq!(back.normal, cloud.normal, "{name}");
        assert_eq!(back.radius, cloud.radius, "{name}");
        assert_eq!(back.area, cloud.area, "{name}");
        assert_eq!(back.prim_paths, cloud.prim_paths, "{name}");
        assert_eq!(back.spacing, cloud.spacing, "{name}");
        assert!(back == cloud, "{name}");
        assert_eq!(diagnostics.warnings(), []);
    }
}

#[test]
fn a_cloud_read_about_another_origin_stands_where_it_stood() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("c.usdc");
    let cloud = SurfelCloud {
        origin: DVec3::new(64.0, 0.0, -8.0),
        ..some_cloud(50)
    };
    write_cloud(&cloud, &path);
    let back =
        read_cloud(&path, DVec3::new(60.0, 1.0, 0.0), &Diagnostics::default()).expect("read");
    for (there, here) in cloud.position.iter().zip(&back.position) {
        // exact up to one rounding to f32 of numbers below 128
        assert!((*there + Vec3::new(4.0, -1.0, -8.0) - *here).length() < 1e-5);
    }
}

#[test]
fn the_empty_cloud_is_a_valid_file() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("empty.usdc");
    let empty = SurfelCloud {
        prim_paths: Vec::new(),
        ..some_cloud(0)
    };
    write_cloud(&empty, &path);
    assert_eq!(
        read_cloud(&path, DVec3::ZERO, &Diagnostics::default()).expect("read"),
        empty
    );
}

const READ_CLOUD: &str = r#"
import json, sys
from pxr import Usd, UsdGeom
stage = Usd.Stage.Open(sys.argv[1])
points = UsdGeom.Points(stage.GetPrimAtPath("/root/surfels"))
prim = points.GetPrim()
primvars = UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
plain = lambda v: [list(x) if hasattr(x, "__len__") else x for x in v]
computed = UsdGeom.Points.ComputeExtent(points.GetPointsAttr().Get(), points.GetWidthsAttr().Get())
root = stage.GetRootLayer()
print(json.dumps({
    "values": {p.GetPrimvarName(): plain(p.Get()) for p in primvars},
    "kinds": {p.GetPrimvarName(): [str(p.GetTypeName()), p.GetInterpolation(), p.GetAttr().HasAuthoredMetadata("interpolation")] for p in primvars},
    "points": plain(points.GetPointsAttr().Get()), "widths": plain(points.GetWidthsAttr().Get()),
    "normals": plain(points.GetNormalsAttr().Get()),
    "authored": [points.GetWidthsAttr().GetMetadata("interpolation"), points.GetNormalsAttr().GetMetadata("interpolation")],
    "extent": plain(points.GetExtentAttr().Get()), "computed_extent": plain(computed),
    "paths": list(prim.GetCustomDataByKey("surflux:primPaths")), "group": prim.GetAttribute("surflux:lightGroup").Get(),
    "apis": prim.GetPrimTypeInfo().GetAppliedAPISchemas() , "layer": [root.customLayerData["surflux"]["version"],
        root.customLayerData["surflux"]["command"], root.customLayerData["surflux"]["comment"]],
    "meta": [UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage), stage.GetTimeCodesPerSecond(), str(stage.GetDefaultPrim().GetPath())],
    "world": list(UsdGeom.XformCache().GetLocalToWorldTransform(prim).ExtractTranslation()),
}))
"#;

#[test]
fn usd_core_reads_every_value_of_a_cloud() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("c.usdc");
    let origin = DVec3::new(1e9, 0.0, -0.125);
    let cloud = SurfelCloud {
        origin,
        ..some_cloud(1000)
    };
    write_cloud(&cloud, &path);
    let read = json(&run_python(READ_CLOUD, &[&path]));
    assert_eq!(floats(&read["points"]), flat(&cloud.position));
    assert_eq!(floats(&read["normals"]), flat(&cloud.normal));
    let widths: Vec<f32> = cloud.radius.iter().map(|radius| 2.0 * radius).collect();
    assert_eq!(floats(&read["widths"]), widths);
    let values = &read["values"];
    assert_eq!(floats(&values["N"]), flat(&cloud.normal));
    assert_eq!(floats(&values["radiosity"]), flat(&cloud.radiosity));
    assert_eq!(floats(&values["albedo"]), flat(&cloud.albedo));
    assert_eq!(floats(&values["emission"]), flat(&cloud.emission));
    assert_eq!(floats(&values["area"]), cloud.area);
    let ids: Vec<f32> = cloud.prim.iter().map(|&id| id as f32).collect();
    assert_eq!(floats(&values["sourcePrim"]), ids);
    for (shown, radiosity) in floats(&values["displayColor"])
        .iter()
        .zip(flat(&cloud.radiosity))
    {
        assert!((shown * PI - radiosity).abs() <= 1e-6 * radiosity);
    }
    for (name, type_name) in [
        ("N", "normal3f[]"),
        ("displayColor", "color3f[]"),
        ("area", "float[]"),
        ("sourcePrim", "int[]"),
    ] {
        assert_eq!(
            read["kinds"][name],
            serde_json::json!([type_name, "vertex", true]),
            "{name}"
        );
    }
    assert_eq!(read["extent"], read["computed_extent"]);
    assert_eq!(read["authored"], serde_json::json!(["vertex", "vertex"]));
    assert_eq!(read["paths"], serde_json::json!(cloud.prim_paths));
    assert_eq!(read["group"], "key");
    assert_eq!(
        read["layer"],
        serde_json::json!(["1.2.3", "surflux bake a \"b\"", "a note"])
    );
    assert_eq!(read["meta"], serde_json::json!(["Z", 0.1, 25.0, "/root"]));
    assert_eq!(read["world"], serde_json::json!([1e9, 0.0, -0.125]));
}

const BLENDER_CLOUD: &str = r#"
import bpy, json, numpy, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.usd_import(filepath=sys.argv[1])
cloud = next(o for o in bpy.data.objects if o.type == "POINTCLOUD").data
def column(name, field, width):
    data = cloud.attributes[name].data
    values = numpy.empty(len(data) * width, dtype=numpy.float32 if field != "value_int" else numpy.int32)
    data.foreach_get("value" if field == "value_int" else field, values)
    return values.tolist()
print()
print(json.dumps({"position": column("position", "vector", 3), "radius": column("radius", "value", 1), "N": column("N", "vector", 3),
    "radiosity": column("radiosity", "color", 4), "area": column("area", "value", 1), "sourcePrim": column("sourcePrim", "value_int", 1),
    "names": sorted(a.name for a in cloud.attributes)}))
"#;

#[test]
fn blender_imports_every_value_of_a_cloud() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("c.usdc");
    let cloud = some_cloud(500);
    write_cloud(&cloud, &path);
    let read = json(&run_python(BLENDER_CLOUD, &[&path]));
    assert_eq!(floats(&read["position"]), flat(&cloud.position));
    assert_eq!(floats(&read["radius"]), cloud.radius);
    assert_eq!(floats(&read["N"]), flat(&cloud.normal));
    assert_eq!(floats(&read["area"]), cloud.area);
    let ids: Vec<f32> = cloud.prim.iter().map(|&id| id as f32).collect();
    assert_eq!(floats(&read["sourcePrim"]), ids);
    let colors: Vec<f32> = cloud
        .radiosity
        .iter()
        .flat_map(|c| [c.x, c.y, c.z, 1.0])
        .collect();
    assert_eq!(floats(&read["radiosity"]), colors);
}

const VALIDATE: &str = r#"
import sys
from pxr import Usd, UsdValidation
stage = Usd.Stage.Open(sys.argv[1])
registry = UsdValidation.ValidationRegistry()
context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
for error in context.Validate(stage):
    print(error.GetName(), error.GetMessage())
"#;

#[test]
fn the_validators_of_usd_find_nothing_in_a_cloud() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("c.usdc");
    write_cloud(&some_cloud(100), &path);
    assert_eq!(run_python(VALIDATE, &[&path]), "");
}

#[test]
fn clouds_of_other_programs_are_understood() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("blender.usda");
    let text = r#"#usda 1.0
def Xform "PointCloud" {
    double3 xformOp:translate = (1, 2, 3)
    float3 xformOp:rotateXYZ = (0, 0, 90)
    float3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
    def Points "PointCloud" {
        point3f[] points = [(1, 0, 0), (0, 1, 0), (5, 5, 5)]
        float[] widths = [0.5, 1, 0]
        float3[] primvars:N = [(0, 0, 2), (1, 0, 0), (1, 0, 0)] (interpolation = "varying")
        color4f[] primvars:displayColor = [(0.1, 0.2, 0.3, 1), (1, 1, 1, 0.5)] (interpolation = "varying")
        int[] primvars:displayColor:indices = [1, 0, 0]
    }
}
def Points "other" {
    point3f[] points = [(0, 0, 0)]
    normal3f[] normals = [(0, 1, 0)]
    float[] widths = [2] (interpolation = "constant")
    float[] primvars:area = [7]
}
def Points "faceless" {
    point3f[] points = [(0, 0, 0)]
}
"#;
    fs::write(&path, text).expect("written");
    let diagnostics = Diagnostics::default();
    let cloud = read_cloud(&path, DVec3::ZERO, &diagnostics).expect("read");
    let close = |a: Vec3, b: Vec3| assert!((a - b).length() < 1e-5, "{a} {b}");
    assert_eq!(cloud.len(), 3);
    close(cloud.position[0], Vec3::new(1.0, 4.0, 3.0));
    close(cloud.position[1], Vec3::new(-1.0, 2.0, 3.0));
    close(cloud.normal[0], Vec3::Z);
    close(cloud.normal[1], Vec3::Y);
    assert!((cloud.radius[0] - 0.5).abs() < 1e-6 && (cloud.radius[1] - 1.0).abs() < 1e-6);
    assert!((cloud.area[1] - PI).abs() < 1e-5, "π r² after scaling");
    close(cloud.radiosity[0], Vec3::splat(PI));
    close(cloud.radiosity[1], Vec3::new(0.1, 0.2, 0.3) * PI);
    assert_eq!(cloud.prim_paths, ["/PointCloud/PointCloud", "/other"]);
    assert_eq!((cloud.prim[0], cloud.prim[2]), (0, 1));
    assert_eq!((cloud.area[2], cloud.radius[2]), (7.0, 1.0));
    let prims: Vec<_> = diagnostics.warnings().into_iter().map(|w| w.prim).collect();
    assert_eq!(prims, ["/PointCloud/PointCloud", "/faceless", "/other"]);
}

#[test]
fn arrays_that_do_not_fit_are_errors_that_say_what_would() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("bad.usda");
    let read = |body: &str| {
        fs::write(&path, format!("#usda 1.0\n{body}\n")).expect("written");
        let error = read_cloud(&path, DVec3::ZERO, &Diagnostics::default());
        error.expect_err("refused").to_string()
    };
    let points = |rest: &str| {
        format!(
            "def Points \"p\" {{\n point3f[] points = [(0,0,0),(1,0,0),(2,0,0)]\n normal3f[] normals = [(0,1,0)]\n {rest}\n}}"
        )
    };
    let wrong = read(&points("float[] widths = [1, 2]"));
    assert!(
        wrong.contains("/p.widths should have 3 values (or 1), not 2"),
        "{wrong}"
    );
    let nan = read(&points("float[] widths = [1, nan, 2]"));
    assert!(nan.contains("/p.widths[1] is not a finite number"), "{nan}");
    let sizeless = read(&points(""));
    assert!(sizeless.contains("widths"), "{sizeless}");
    let typed = read(&points("string[] widths = [\"a\"]"));
    assert!(typed.contains("/p.widths"), "{typed}");
    let none = read("def Xform \"x\" {}");
    assert!(none.contains("no Points prim"), "{none}");
    let composed = read("def \"x\" (references = @other.usd@) {}");
    assert!(composed.contains("flatten"), "{composed}");
    let nonsense = read("def {");
    assert!(nonsense.contains("bad.usda"), "{nonsense}");
}

#[test]
fn files_that_cannot_be_written_leave_nothing_behind() {
    let folder = tempfile::tempdir().expect("folder");
    let write = |name: &str| {
        let info = stage_info(Path::new("a.usda"));
        cloud::write(
            &some_cloud(3),
            &info,
            &folder.path().join(name),
            &CloudOptions::default(),
        )
    };
    assert!(matches!(
        write("missing/c.usdc"),
        Err(Error::Unwritable { .. })
    ));
    assert!(matches!(write("c.abc"), Err(Error::Extension { .. })));
    fs::create_dir(folder.path().join("taken.usdc")).expect("folder");
    assert!(matches!(write("taken.usdc"), Err(Error::Unwritable { .. })));
    let left: Vec<_> = fs::read_dir(&folder)
        .expect("folder")
        .flatten()
        .map(|e| e.file_name())
        .collect();
    assert_eq!(left, ["taken.usdc"]);
}

// ---- bakes ----

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
            path: root.to_owned(),
            first: "/World/i1".to_owned(),
        }]),
        shared_path: "/World/i1/quad".to_owned(),
    };
    (format!("{root}/quad"), source)
}

fn point(index: u32) -> (String, PrimSource) {
    let source = PrimSource::PointInstance {
        instancer: "/World/I".to_owned(),
        index,
        shared_path: "/World/I/P/quad".to_owned(),
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
    let prim = |(path, source)| Prim {
        path,
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
    Results { buffers }
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
