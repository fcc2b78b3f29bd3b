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

/// Two quads with textures: the second is cut out by the alpha of its color.
const TEXTURED: &str = r#"#usda 1.0
(
    defaultPrim = "World"
    upAxis = "Y"
    metersPerUnit = 1
)
def Xform "World"
{
    def Mesh "painted" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        rel material:binding = </World/paint>
    }
    def Mesh "cut" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(2, 0, 0), (3, 0, 0), (3, 1, 0), (2, 1, 0)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        rel material:binding = </World/leaf>
    }
    def Material "paint"
    {
        token outputs:surface.connect = </World/paint/s.outputs:surface>
        def Shader "s"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/paint/color.outputs:rgb>
            float inputs:metallic.connect = </World/paint/metal.outputs:b>
            float inputs:roughness.connect = </World/paint/rough.outputs:r>
            color3f inputs:emissiveColor.connect = </World/paint/glow.outputs:rgb>
            normal3f inputs:normal.connect = </World/paint/bumps.outputs:rgb>
            token outputs:surface
        }
        def Shader "st"
        {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }
        def Shader "moved"
        {
            uniform token info:id = "UsdTransform2d"
            float2 inputs:in.connect = </World/paint/st.outputs:result>
            float2 inputs:scale = (2, 0.5)
            float inputs:rotation = 30
            float2 inputs:translation = (0.1, 0.2)
            float2 outputs:result
        }
        def Shader "color"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @color.png@
            float2 inputs:st.connect = </World/paint/moved.outputs:result>
            token inputs:wrapS = "repeat"
            token inputs:wrapT = "mirror"
            float3 outputs:rgb
        }
        def Shader "metal"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @metal.png@
            token inputs:sourceColorSpace = "raw"
            float2 inputs:st.connect = </World/paint/st.outputs:result>
            float outputs:b
        }
        def Shader "rough"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @rough.png@
            token inputs:sourceColorSpace = "raw"
            float2 inputs:st.connect = </World/paint/st.outputs:result>
            float4 inputs:scale = (0.5, 1, 1, 1)
            float4 inputs:bias = (0.25, 0, 0, 0)
            float outputs:r
        }
        def Shader "glow"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @glow.png@
            float2 inputs:st.connect = </World/paint/st.outputs:result>
            float4 inputs:scale = (4, 4, 4, 1)
            float3 outputs:rgb
        }
        def Shader "bumps"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @bumps.png@
            token inputs:sourceColorSpace = "raw"
            float2 inputs:st.connect = </World/paint/st.outputs:result>
            float4 inputs:scale = (2, 2, 2, 1)
            float4 inputs:bias = (-1, -1, -1, 0)
            float3 outputs:rgb
        }
    }
    def Material "leaf"
    {
        token outputs:surface.connect = </World/leaf/s.outputs:surface>
        def Shader "s"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/leaf/color.outputs:rgb>
            float inputs:opacity.connect = </World/leaf/color.outputs:a>
            float inputs:opacityThreshold = 0.5
            token outputs:surface
        }
        def Shader "st"
        {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }
        def Shader "color"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @leaf.png@
            float2 inputs:st.connect = </World/leaf/st.outputs:result>
            float3 outputs:rgb
            float outputs:a
        }
    }
}
"#;

/// Writes the textures, and tells which codes they hold.
const PAINT: &str = "
import sys, json, numpy as np, OpenImageIO as oiio
folder = sys.argv[1] + '/'
r = np.random.default_rng(7)
out = {}
for name, shape in (('color', (4, 8, 3)), ('metal', (8, 4, 3)), ('rough', (4, 4, 1)), ('glow', (4, 4, 3)), ('bumps', (4, 4, 3)), ('leaf', (4, 4, 4))):
    codes = r.integers(0, 256, shape, dtype=np.uint8)
    spec = oiio.ImageSpec(shape[1], shape[0], shape[2], 'uint8')
    spec['oiio:UnassociatedAlpha'] = 1
    file = oiio.ImageOutput.create(folder + name + '.png')
    assert file.open(folder + name + '.png', spec) and file.write_image(codes)
    file.close()
    out[name] = codes.tolist()
print(json.dumps(out))
";

/// What Blender makes of the materials: codes of images, rows from the top, and how coordinates are moved.
const LOOKS: &str = "
import sys, json, bpy, addon_utils
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable('io_scene_gltf2')
bpy.ops.import_scene.gltf(filepath=sys.argv[1])
def codes(image):
    w, h = image.size
    rows = [[[round(255 * x) for x in image.pixels[4 * (y * w + x):4 * (y * w + x) + 4]] for x in range(w)] for y in range(h)]
    return rows[::-1]
def behind(socket):
    node = socket.links[0].from_node if socket.links else None
    while node and node.type != 'TEX_IMAGE':
        sockets = [s for s in node.inputs if s.links and s.name in ('Color', 'Image', 'Normal', 'A', 'Value')] or [s for s in node.inputs if s.links]
        node = sockets[0].links[0].from_node if sockets else None
    return node
out = {}
for m in bpy.data.materials:
    p = [n for n in m.node_tree.nodes if n.type == 'BSDF_PRINCIPLED'][0].inputs
    entry = {'alpha': bool(p['Alpha'].links), 'strength': p['Emission Strength'].default_value}
    for name in ('Base Color', 'Metallic', 'Roughness', 'Emission Color', 'Normal'):
        node = behind(p[name])
        if not node: continue
        entry[name] = {'codes': codes(node.image), 'space': node.image.colorspace_settings.name, 'extension': node.extension}
        mapping = node.inputs['Vector'].links[0].from_node if node.inputs['Vector'].links else None
        while mapping and mapping.type != 'MAPPING':
            linked = [s for s in mapping.inputs if s.links]
            mapping = linked[0].links[0].from_node if linked else None
        if mapping:
            entry[name]['mapping'] = [*mapping.inputs['Location'].default_value[:2], mapping.inputs['Rotation'].default_value[2], *mapping.inputs['Scale'].default_value[:2]]
    out[m.name] = entry
print(json.dumps(out))
";

fn codes(value: &Json) -> Vec<Vec<Vec<u64>>> {
    serde_json::from_value(value.clone()).expect("rows of pixels")
}

/// Roughness and metallic of `paint`, packed, against the images in `files`.
fn check_packed(paint: &Json, files: &Json) {
    // roughness in green and metallic in blue of one image as high as the higher and as wide as the wider of the two
    let packed = codes(&paint["Roughness"]["codes"]);
    assert_eq!(packed, codes(&paint["Metallic"]["codes"]));
    let (metal, rough) = (codes(&files["metal"]), codes(&files["rough"]));
    assert_eq!((packed.len(), packed[0].len()), (8, 4));
    for (y, row) in packed.iter().enumerate() {
        for (x, pixel) in row.iter().enumerate() {
            let roughness = (rough[y / 2][x][0] as f64 * 0.5 + 0.25 * 255.0).round();
            assert!((pixel[1] as f64 - roughness).abs() <= 1.0, "{x} {y}");
            assert_eq!(pixel[2], metal[y][x][2], "{x} {y}");
        }
    }
}

#[test]
fn blender_reads_textures_as_the_stage_has_them() {
    let (folder, stage) = crate::program::stage(TEXTURED);
    let files = python_json(PAINT, &[folder.path()]);
    let glb = folder.path().join("out.glb");
    let report = convert(&stage, &glb, &["--usd", "native"]);
    assert_eq!(report["warnings"], Json::Array(Vec::new()));
    let read = python_json(LOOKS, &[&glb]);
    let paint = &read["paint"];
    let rgb = |of: &Json| -> Vec<Vec<Vec<u64>>> {
        let rows = codes(of);
        let row = |row: Vec<Vec<u64>>| row.into_iter().map(|p| p[..3].to_vec()).collect();
        rows.into_iter().map(row).collect()
    };
    assert_eq!(rgb(&paint["Base Color"]["codes"]), codes(&files["color"]));
    assert_eq!(paint["Base Color"]["space"], "sRGB");
    assert_eq!(rgb(&paint["Normal"]["codes"]), codes(&files["bumps"]));
    assert_eq!(paint["Normal"]["space"], "Non-Color");
    assert_eq!(
        rgb(&paint["Emission Color"]["codes"]),
        codes(&files["glow"])
    );
    assert!((paint["strength"].as_f64().unwrap() - 4.0).abs() < 1e-6);
    check_packed(paint, &files);
    // where the corners of the quad are in the image: as UsdTransform2d says
    let mapping = numbers(&paint["Base Color"]["mapping"]);
    let turned = |scale: [f64; 2], angle: f64, moved: [f64; 2], st: [f64; 2]| {
        let (x, y) = (scale[0] * st[0], scale[1] * st[1]);
        let (sin, cos) = angle.sin_cos();
        [cos * x - sin * y + moved[0], sin * x + cos * y + moved[1]]
    };
    for st in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.25, 0.75]] {
        let truth = turned([2.0, 0.5], 30_f64.to_radians(), [0.1, 0.2], st);
        let found = turned(
            [mapping[3], mapping[4]],
            mapping[2],
            [mapping[0], mapping[1]],
            st,
        );
        assert!(
            (truth[0] - found[0]).abs() < 1e-5 && (truth[1] - found[1]).abs() < 1e-5,
            "{st:?}: {truth:?} {found:?}"
        );
    }
    // the leaf's file is in the GLB as it is, its alpha cuts
    assert_eq!(
        codes(&read["leaf"]["Base Color"]["codes"]),
        codes(&files["leaf"])
    );
    assert_eq!(read["leaf"]["alpha"], true);
    let json = json_of(&glb);
    assert_eq!(json["materials"][1]["alphaMode"], "MASK", "{json}");
    assert_eq!(json["materials"][1]["alphaCutoff"], 0.5);
    let glb = std::fs::read(&glb).unwrap();
    let leaf = std::fs::read(folder.path().join("leaf.png")).unwrap();
    assert!(glb.windows(leaf.len()).any(|bytes| bytes == leaf));
}

/// The JSON of a GLB.
fn json_of(glb: &std::path::Path) -> Json {
    let bytes = std::fs::read(glb).expect("written");
    let length = u32::from_le_bytes(bytes[12..16].try_into().expect("four bytes")) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).expect("JSON")
}

#[test]
fn textures_that_glb_cannot_have_are_told() {
    // a file that is not there, images of one that lie differently, what is no texture; how many images are left
    let missing = ("@metal.png@", "@missing.png@", "missing.png", 4);
    let st = "\"raw\"\n            float2 inputs:st.connect = </World/paint/st.outputs";
    let moved = st.replace("paint/st.", "paint/moved.");
    let apart = (st, moved.as_str(), "lie on the surface differently", 4);
    let surface = "token outputs:surface.connect = </World/paint/s.outputs:surface>";
    let displaced = format!(
        "{surface}\n        token outputs:displacement.connect = </World/paint/d.outputs:displacement>
        def Shader \"d\" {{ uniform token info:id = \"UsdPreviewSurface\"\nfloat inputs:displacement = 0.1 }}"
    );
    let displaced = (
        surface,
        displaced.as_str(),
        "its displacement is left out",
        5,
    );
    for (from, to, word, images) in [missing, apart, displaced] {
        let (folder, stage) = crate::program::stage(&TEXTURED.replacen(from, to, 1));
        python_json(PAINT, &[folder.path()]);
        let glb = folder.path().join("out.glb");
        let report = convert(&stage, &glb, &["--usd", "native"]);
        let warnings = report["warnings"].as_array().unwrap().iter();
        let mut told = warnings.map(|warning| warning["message"].as_str().unwrap());
        assert!(told.any(|told| told.contains(word)), "{report}");
        let json = json_of(&glb);
        assert_eq!(json["images"].as_array().unwrap().len(), images, "{json}");
    }
}

/// Coordinates that Blender places the images of `paint` by, and all that its mesh has: `x y u v` of each corner.
const PLACED: &str = "
import sys, json, bpy, addon_utils
bpy.ops.wm.read_factory_settings(use_empty=True)
addon_utils.enable('io_scene_gltf2')
bpy.ops.import_scene.gltf(filepath=sys.argv[1])
mesh = [o.data for o in bpy.data.objects if o.type == 'MESH' and o.name.startswith('painted')][0]
def layer(data):
    corners = []
    for p in mesh.polygons:
        for l in p.loop_indices:
            x, _, y = mesh.vertices[mesh.loops[l].vertex_index].co
            corners.append([x, y, *data[l].uv])
    return sorted(corners)
def placed(socket):
    node = socket.links[0].from_node
    while node.type != 'TEX_IMAGE':
        node = [s for s in node.inputs if s.links][0].links[0].from_node
    while node.type != 'UVMAP':
        linked = [s for s in node.inputs if s.links]
        if not linked:
            return layer(mesh.uv_layers[0].data)
        node = linked[0].links[0].from_node
    return layer(mesh.uv_layers[node.uv_map].data)
shader = [n for n in bpy.data.materials['paint'].node_tree.nodes if n.type == 'BSDF_PRINCIPLED'][0]
print(json.dumps({'color': placed(shader.inputs['Base Color']), 'bumps': placed(shader.inputs['Normal']), 'sets': [layer(l.data) for l in mesh.uv_layers]}))
";

#[test]
fn blender_places_textures_by_the_primvars_that_the_stage_does() {
    // color by map1, bumps by map2, and st that nothing reads
    let st =
        "texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = \"vertex\")";
    let more = "texCoord2f[] primvars:map1 = [(0, 0.25), (0.5, 0.25), (0.5, 0.75), (0, 0.75)] (interpolation = \"vertex\")
        texCoord2f[] primvars:map2 = [(0, 0), (0, 1), (1, 1), (1, 0)] (interpolation = \"vertex\")";
    let reader = "        def Shader \"st\"
        {
            uniform token info:id = \"UsdPrimvarReader_float2\"
            string inputs:varname = \"st\"";
    let other =
        reader
            .replace("\"st\"", "\"st2\"")
            .replacen("varname = \"st2\"", "varname = \"map2\"", 1)
            + "\n            float2 outputs:result\n        }\n";
    let own = other.clone() + &reader.replace("varname = \"st\"", "varname = \"map1\"");
    let bumps = TEXTURED.find("@bumps.png@").expect("a texture");
    let mut text = TEXTURED.to_owned();
    let after = text.split_off(bumps);
    text += &after.replacen("paint/st.outputs", "paint/st2.outputs", 1);
    let text = text
        .replacen(st, &format!("{st}\n        {more}"), 1)
        .replacen(reader, &own, 1);
    let (folder, stage) = crate::program::stage(&text);
    python_json(PAINT, &[folder.path()]);
    let glb = folder.path().join("out.glb");
    let report = convert(&stage, &glb, &["--usd", "native"]);
    assert_eq!(report["warnings"], Json::Array(Vec::new()));
    let read = python_json(PLACED, &[&glb]);
    let check = |corners: &Json, place: &dyn Fn(f64, f64) -> [f64; 2]| {
        let corners = numbers(corners);
        assert_eq!(corners.len(), 6 * 4);
        for corner in corners.chunks_exact(4) {
            let truth = place(corner[0], corner[1]);
            assert!((corner[2] - truth[0]).abs() < 1e-6, "{corner:?} {truth:?}");
            assert!((corner[3] - truth[1]).abs() < 1e-6, "{corner:?} {truth:?}");
        }
    };
    check(&read["color"], &|x, y| [0.5 * x, 0.25 + 0.5 * y]);
    check(&read["bumps"], &|x, y| [y, x]);
    check(&read["sets"][2], &|x, y| [x, y]);
}
