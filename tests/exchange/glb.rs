//! Baked USD → GLB, opened in Blender.

use super::ply::numbers;
use super::{bake_room, convert, python_json};
use serde_json::Value as Json;

const STAGE: &str = r#"#usda 1.0
(
    defaultPrim = "World"
    upAxis = "Z"
    metersPerUnit = 0.5
)
def Xform "World"
{
    def Mesh "quad" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        double3 xformOp:translate = (10, 20, 30)
        float3 xformOp:rotateXYZ = (0, 0, 90)
        float3 xformOp:scale = (1, 2, 3)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.5)]
        color3f[] primvars:displayColor = [(0.1, 0.2, 0.3), (1, 0.5, 0.25), (0, 1, 0), (2, 0, 0)] (interpolation = "vertex")
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "varying")
        rel material:binding = </World/paint>
    }
    def Mesh "sheared"
    {
        matrix4d xformOp:transform = ((1, 0, 0, 0), (0.5, 1, 0, 0), (0, 0, 1, 0), (5, 0, 0, 1))
        uniform token[] xformOpOrder = ["xformOp:transform"]
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
        color3f[] primvars:displayColor = [(0.25, 0.5, 0.75)] (interpolation = "constant")
    }
    def Material "paint"
    {
        token outputs:surface.connect = </World/paint/s.outputs:surface>
        def Shader "s"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.3, 0.6, 0.9)
            float inputs:metallic = 0.25
            float inputs:roughness = 0.75
            color3f inputs:emissiveColor = (4, 2, 1)
            token outputs:surface
        }
    }
}
"#;

/// Blender keeps vertex colors of glTF as 8-bit sRGB: half a code where that is steepest, and its rounding.
const BYTE: f64 = 5e-3;

const BLENDER: &str = "
import sys, json, bpy, addon_utils
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable('io_scene_gltf2')
bpy.ops.import_scene.gltf(filepath=sys.argv[1])
out = {}
for o in bpy.data.objects:
    if o.type != 'MESH': continue
    mesh = o.data
    name = mesh.color_attributes[0].name if mesh.color_attributes else None
    rows = []
    for p in mesh.polygons:
        for l in p.loop_indices:
            v = mesh.loops[l].vertex_index
            row = list(o.matrix_world @ mesh.vertices[v].co)
            if name:
                a = mesh.attributes[name]
                row += list(a.data[l if a.domain == 'CORNER' else v].color)[:3]
            if mesh.uv_layers:
                row += list(mesh.uv_layers[0].data[l].uv)
            rows.append([round(x, 4) + 0.0 for x in row])
    entry = {'rows': sorted(rows), 'normals': [[round(x, 4) + 0.0 for x in (o.matrix_world.to_3x3().inverted().transposed() @ p.normal).normalized()] for p in mesh.polygons]}
    if o.material_slots:
        s = [n for n in o.material_slots[0].material.node_tree.nodes if n.type == 'BSDF_PRINCIPLED']
        if s:
            s = s[0].inputs
            entry['metallic'], entry['roughness'] = s['Metallic'].default_value, s['Roughness'].default_value
            entry['base'] = list(s['Base Color'].default_value)[:3]
            entry['emission'] = [x * s['Emission Strength'].default_value for x in list(s['Emission Color'].default_value)[:3]]
    out[o.name] = entry
print(json.dumps(out))
";

#[test]
fn blender_reads_places_colors_coordinates_and_materials_back() {
    let (folder, stage) = crate::program::stage(STAGE);
    let glb = folder.path().join("out.glb");
    convert(&stage, &glb, &["--usd", "native"]);
    let read = python_json(BLENDER, &[&glb]);
    // half a meter a unit; Blender's z is up as the stage's: (x, y, z) · scale, turned by 90° about z, moved
    let place = |x: f64, y: f64, z: f64| {
        [
            0.5 * (10.0 - 2.0 * y),
            0.5 * (20.0 + x),
            0.5 * (30.0 + 3.0 * z),
        ]
    };
    let corners = [
        (place(0.0, 0.0, 0.0), [0.1, 0.2, 0.3], [0.0, 0.0]),
        (place(1.0, 0.0, 0.0), [1.0, 0.5, 0.25], [1.0, 0.0]),
        (place(1.0, 1.0, 0.0), [0.0, 1.0, 0.0], [1.0, 1.0]),
        // Blender keeps vertex colors up to 1
        (place(0.0, 1.0, 0.5), [1.0, 0.0, 0.0], [0.0, 1.0]),
    ];
    let rows = read["quad"]["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 6);
    for row in rows {
        let row = numbers(row);
        let found = corners.iter().any(|(place, color, st)| {
            let truth = [&place[..], color, st].concat();
            row.iter().zip(&truth).all(|(a, b)| (a - b).abs() < BYTE)
        });
        assert!(found, "{row:?}");
    }
    let near = |value: &Json, truth: &[f64]| {
        for (value, truth) in numbers(value).iter().zip(truth) {
            assert!((value - truth).abs() < 1e-4, "{value} {truth}");
        }
    };
    near(&read["quad"]["metallic"], &[0.25]);
    near(&read["quad"]["roughness"], &[0.75]);
    near(&read["quad"]["emission"], &[4.0, 2.0, 1.0]);
    // sheared transforms are applied to points; a constant color is the material's
    let sheared = numbers(&read["sheared"]["rows"]);
    near(
        &Json::from(sheared),
        &[2.5, 0.0, 0.0, 2.75, 0.5, 0.0, 3.0, 0.0, 0.0],
    );
    near(&read["sheared"]["base"], &[0.25, 0.5, 0.75]);
    near(&read["sheared"]["normals"], &[0.0, 0.0, 1.0]);
}

#[test]
fn a_bake_goes_to_blender_with_its_vertex_colors() {
    let folder = tempfile::tempdir().unwrap();
    let bake = folder.path().join("bake.usdc");
    bake_room(&bake, &["--surfels", "2000", "--aov", "irradiance"]);
    let glb = folder.path().join("bake.glb");
    let report = convert(
        &folder.path().join("bake_baked.usda"),
        &glb,
        &["--usd", "native"],
    );
    assert!(report["counts"]["prims"].as_u64().unwrap() > 3);
    let read = python_json(BLENDER, &[&glb]);
    let floor = numbers(&read["floor"]["rows"][0]);
    let name = read
        .as_object()
        .unwrap()
        .keys()
        .cloned()
        .collect::<Vec<_>>();
    assert!(floor.len() >= 6, "{name:?}");
    // lit, in the scene's linear light
    let colors: Vec<f64> = read["floor"]["rows"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| numbers(row)[3])
        .collect();
    assert!(colors.iter().copied().fold(0.0, f64::max) > 0.05);
}
