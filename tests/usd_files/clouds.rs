//! Clouds: what is written is read back, here and elsewhere.

use crate::python::run_python;
use crate::{VALIDATE, floats, json, noise, provenance, stage_info};
use glam::{DVec3, Vec3};
use std::f32::consts::PI;
use std::fs;
use std::path::Path;
use surflux::diagnostics::Diagnostics;
use surflux::stage::cloud::{read_cloud, read_particles};
use surflux::surfels::SurfelCloud;
use surflux::writers::usd::Error;
use surflux::writers::usd::cloud::{self, CloudOptions};

fn flat(values: &[Vec3]) -> Vec<f32> {
    values.iter().flat_map(|v| v.to_array()).collect()
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

#[test]
fn the_validators_of_usd_find_nothing_in_a_cloud() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("c.usdc");
    write_cloud(&some_cloud(100), &path);
    assert_eq!(run_python(VALIDATE, &[&path]), "");
}

#[test]
fn usd_knows_the_schema_of_clouds_and_every_attribute_that_is_written() {
    const ASK: &str = "
import os, sys, json
os.environ['PXR_PLUGINPATH_NAME'] = sys.argv[2]
from pxr import Usd, UsdGeom, UsdValidation
schema = Usd.SchemaRegistry().FindAppliedAPIPrimDefinition('SurfluxCloudAPI')
known = {name: str(schema.GetSchemaAttributeSpec(name).typeName) for name in schema.GetPropertyNames()}
stage = Usd.Stage.Open(sys.argv[1])
prim = stage.GetPrimAtPath('/root/surfels')
written = {a.GetName(): str(a.GetTypeName()) for a in prim.GetAttributes() if a.GetName().startswith('surflux:')}
mesh = UsdGeom.Mesh.Define(stage, '/mesh').GetPrim()
kind = Usd.SchemaRegistry.GetTypeFromSchemaTypeName('SurfluxCloudAPI')
print(json.dumps({'known': known, 'written': written, 'applied': 'SurfluxCloudAPI' in prim.GetAppliedSchemas(),
    'can': [bool(p.CanApplyAPI(kind)) for p in [prim, mesh]]}))
";
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("c.usdc");
    let options = CloudOptions {
        provenance: provenance(),
        light_group: Some("key".to_owned()),
    };
    let info = stage_info(Path::new("a.usda"));
    cloud::write(&some_cloud(3), &info, &path, &options).expect("writable");
    let schemas = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/surflux"));
    let answer = json(&run_python(ASK, &[&path, schemas]));
    assert_eq!(answer["applied"], true);
    assert_eq!(
        answer["known"].as_object().map(|known| known.len()),
        Some(4)
    );
    assert_eq!(answer["written"], answer["known"]);
    assert_eq!(answer["can"], serde_json::json!([true, false]));
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
    point3f[] points = [(0, 0, 9)]
    float[] widths = [3]
    color3f[] primvars:displayColor = [(1, 2, 3)]
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
    assert_eq!(prims, ["/PointCloud/PointCloud", "/other"]);
    // What faces nowhere is no surfel but a particle, which shines in its color.
    let found = read_particles(&path, DVec3::ZERO, &diagnostics).expect("read");
    assert_eq!(found.len(), 1);
    let (prim, glowing) = &found[0];
    assert_eq!(
        (prim.as_str(), &glowing.radius[..]),
        ("/faceless", &[1.5][..])
    );
    close(glowing.position[0], Vec3::new(0.0, 0.0, 9.0));
    close(glowing.radiance[0], Vec3::new(1.0, 2.0, 3.0));
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
