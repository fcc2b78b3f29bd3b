//! The scripts of `examples/blender`, run in Blender.

use super::ply::{READ_USD, cloud, numbers};
use super::{bake_room, convert, python_json, text};
use std::path::Path;

/// Makes `show` and `export_cloud` importable; arguments: files.
const BEGIN: &str = concat!(
    "import sys, json\nsys.path.insert(0, '",
    env!("CARGO_MANIFEST_DIR"),
    "/examples/blender')\nimport bpy\nbpy.ops.wm.read_factory_settings(use_empty=True)\nimport show, export_cloud\n"
);

fn near(a: &serde_json::Value, b: &serde_json::Value, tolerance: f64) {
    let (a, b) = (numbers(a), numbers(b));
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(&b) {
        assert!((a - b).abs() <= tolerance, "{a} {b}");
    }
}

/// Shows a cloud and exports it.
const ROUND_TRIP: &str = "
o = show.cloud(sys.argv[1])[0]
points, attributes = o.data.points, o.data.attributes
out = {'P': [list(p.co) for p in points], 'radius': [p.radius for p in points],
       'color': [list(d.color)[:3] for d in attributes['displayColor'].data]}
export_cloud.export(o, sys.argv[2])
print()
print(json.dumps(out))
";

#[test]
fn a_cloud_comes_back_from_blender_to_the_bit_and_is_gathered_from() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(folder.path());
    let exported = folder.path().join("exported.usdc");
    let script = BEGIN.to_owned() + ROUND_TRIP;
    let blender = python_json(&script, &[&cloud, &exported]);
    let usd = python_json(READ_USD, &[&cloud]);
    near(&blender["P"], &usd["points"], 0.0);
    near(&blender["color"], &usd["primvars:displayColor"], 0.0);
    let radii: Vec<f64> = numbers(&usd["widths"])
        .iter()
        .map(|width| 0.5 * width)
        .collect();
    near(&blender["radius"], &radii.into(), 0.0);
    // what Blender wrote has the same points and colors for surflux, which gathers from it
    let back = folder.path().join("back.usdc");
    convert(&exported, &back, &[]);
    let after = python_json(READ_USD, &[&back]);
    for name in ["widths", "primvars:displayColor"] {
        near(&after[name], &usd[name], 1e-6);
    }
    // Blender's stages have z up
    assert_eq!(after["upAxis"], "Z");
    for name in ["points", "normals"] {
        let turned = numbers(&usd[name]);
        let turned = turned.chunks_exact(3).flat_map(|v| [v[0], -v[2], v[1]]);
        near(&after[name], &turned.collect::<Vec<f64>>().into(), 1e-6);
    }
    let bake = folder.path().join("b.usdc");
    bake_room(
        &bake,
        &["--aov", "irradiance_indirect", "--cloud", text(&exported)],
    );
}

#[test]
fn a_bake_is_shown_with_the_values_that_usd_core_reads() {
    let folder = tempfile::tempdir().unwrap();
    let bake = folder.path().join("bake.usdc");
    bake_room(
        &bake,
        &["--surfels", "2000", "--aov", "irradiance,occlusion"],
    );
    let stage = folder.path().join("bake_baked.usda");
    let script = BEGIN.to_owned()
        + "
meshes = show.bake(sys.argv[1], 'occlusion')
floor = [o for o in meshes if o.name.startswith('floor')][0]
material = floor.material_slots[0].material
print()
print(json.dumps({'occlusion': [d.value for d in floor.data.attributes['occlusion'].data],
    'color': [list(d.color)[:3] for d in floor.data.attributes['irradiance'].data],
    'material': [n.attribute_name for n in material.node_tree.nodes if n.type == 'ATTRIBUTE']}))
";
    let blender = python_json(&script, &[&stage]);
    const READ: &str = "
import sys, json
from pxr import Usd
stage = Usd.Stage.Open(sys.argv[1])
get = lambda n: stage.GetPrimAtPath('/Room/floor').GetAttribute('primvars:' + n).Get()
print(json.dumps({'occlusion': list(get('occlusion')), 'color': [list(c) for c in get('irradiance')]}))
";
    let usd = python_json(READ, &[Path::new(&stage)]);
    near(&blender["occlusion"], &usd["occlusion"], 0.0);
    near(&blender["color"], &usd["color"], 0.0);
    assert_eq!(blender["material"][0], "occlusion");
}

/// Shows a cloud and renders it from the front.
const RENDER: &str = "
show.cloud(sys.argv[1])
show.plain_colors()
camera = bpy.data.objects.new('eye', bpy.data.cameras.new('eye'))
scene = bpy.context.scene
scene.collection.objects.link(camera)
scene.camera = camera
camera.location, camera.rotation_euler = (0, -4, 0), (1.5707963, 0, 0)
scene.render.engine, scene.cycles.samples, scene.cycles.device = 'CYCLES', 1, 'CPU'
scene.render.resolution_x = scene.render.resolution_y = 32
scene.render.filepath = sys.argv[2]
bpy.ops.render.render(write_still=True)
print()
print('{}')
";

#[test]
fn blender_renders_a_cloud_in_its_colors_with_no_hand_work() {
    let folder = tempfile::tempdir().unwrap();
    let in_folder = |name: &str| folder.path().join(name);
    let (ply, usd, picture) = (
        in_folder("c.ply"),
        in_folder("c.usdc"),
        in_folder("seen.png"),
    );
    let names = "x y z nx ny nz radius displayColor_r displayColor_g displayColor_b".split(' ');
    let names: String = names
        .map(|name| format!("property float {name}\n"))
        .collect();
    let rows = (0..400).map(|i| (f64::from(i % 20 - 10), f64::from(i / 20 - 10)));
    let rows: String = rows
        .map(|(x, z)| format!("{} 0 {} 0 -1 0 0.1 0.8 0.1 0.3\n", 0.1 * x, 0.1 * z))
        .collect();
    let text = format!("ply\nformat ascii 1.0\nelement vertex 400\n{names}end_header\n{rows}");
    std::fs::write(&ply, text).unwrap();
    convert(&ply, &usd, &["--up-axis", "z"]);
    python_json(&(BEGIN.to_owned() + RENDER), &[&usd, &picture]);
    let seen = image::open(&picture).unwrap().to_rgb8();
    // IEC 61966-2-1 of 0.8, 0.1 and 0.3
    let pixel = seen.get_pixel(16, 16).0;
    for (shown, truth) in pixel.into_iter().zip([231_u8, 89, 149]) {
        assert!(shown.abs_diff(truth) <= 2, "{pixel:?}");
    }
}
