//! Displacement of UsdPreviewSurface, end to end, against closed forms.

use crate::program::{json, run, stage, stderr};
use glam::Vec3;
use std::f32::consts::PI;
use std::fs;
use std::path::Path;

/// A card of half edge 1 in the plane y = 0 that faces up, `more` beside it; `displacement` is its material's input, and
/// `output` what makes it one that counts. Its st are 0…1 along x and −z.
fn card(displacement: &str, output: &str, more: &str) -> String {
    format!(
        r#"#usda 1.0
( defaultPrim = "World"
  metersPerUnit = 1 )
def Xform "World"
{{
    def Mesh "card" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        point3f[] points = [(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = "none"
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        float[] primvars:height = [0, 2, 2, 0] (interpolation = "vertex")
        rel material:binding = </World/Look>
    }}
    def Material "Look"
    {{
        token outputs:surface.connect = </World/Look/surface.outputs:surface>
        {output}
        def Shader "surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Look/paint.outputs:rgb>
            {displacement}
            token outputs:surface
        }}
        def Shader "relief"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./relief.exr@
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float2 inputs:st.connect = </World/Look/st.outputs:result>
            float outputs:r
        }}
        def Shader "paint"
        {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./paint.exr@
            float2 inputs:st.connect = </World/Look/st.outputs:result>
            float3 outputs:rgb
        }}
        def Shader "st"
        {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
        def Shader "height"
        {{
            uniform token info:id = "UsdPrimvarReader_float"
            string inputs:varname = "height"
            float outputs:result
        }}
    }}
    {more}
}}
"#
    )
}

const OUTPUT: &str =
    "token outputs:displacement.connect = </World/Look/surface.outputs:displacement>";
const RELIEF: &str = "float inputs:displacement.connect = </World/Look/relief.outputs:r>";
const SUN: &str = "def DistantLight \"sun\" { float inputs:intensity = 1\nfloat inputs:angle = 0\nbool inputs:normalize = 1\nfloat xformOp:rotateX = -90\nuniform token[] xformOpOrder = [\"xformOp:rotateX\"] }";

/// Height of the relief, and its slope along x, over the card.
fn wave(x: f32) -> (f32, f32) {
    (0.1 * (1.0 + (PI * x).sin()), 0.1 * PI * (PI * x).cos())
}

/// The files of [`card`]: a wave along x, and white paint.
fn images(folder: &Path) {
    let size = 512;
    let height = |x: usize, _: usize| {
        let (height, _) = wave((x as f32 + 0.5) / size as f32 * 2.0 - 1.0);
        (height, height, height)
    };
    exr::prelude::write_rgb_file(folder.join("relief.exr"), size, size, height).expect("written");
    exr::prelude::write_rgb_file(folder.join("paint.exr"), 4, 4, |_, _| {
        (1.0_f32, 1.0_f32, 1.0_f32)
    })
    .expect("written");
}

/// Vectors of the array `name` of `layer`.
fn vectors(layer: &str, name: &str) -> Vec<Vec3> {
    let start = layer
        .find(name)
        .unwrap_or_else(|| panic!("no {name} in {layer}"));
    let values = &layer[start + name.len()..];
    let values = &values[values.find('[').expect("an array")..];
    let values = &values[..values.find(']').expect("an end")];
    let numbers: Vec<f32> = (values.split(['[', ',', '(', ')']))
        .filter_map(|word| word.trim().parse().ok())
        .collect();
    numbers.chunks_exact(3).map(Vec3::from_slice).collect()
}

/// What `args` write of `stage`, as text, and what they say.
fn made(path: &Path, args: &[&str]) -> (String, serde_json::Value) {
    let out = path.with_file_name("out.usda");
    let mut all = vec![
        args[0],
        path.to_str().expect("UTF-8"),
        "--usd",
        "native",
        "--json",
    ];
    all.extend(["-o", out.to_str().expect("UTF-8")]);
    all.extend(&args[1..]);
    let result = run(&all);
    assert!(result.status.success(), "{}", stderr(&result));
    (fs::read_to_string(out).expect("a layer"), json(&result))
}

#[test]
fn surfels_lie_on_the_relief_of_an_image_and_face_as_it_does() {
    let (folder, path) = stage(&card(RELIEF, OUTPUT, SUN));
    images(folder.path());
    let (layer, _) = made(&path, &["points", "--surfels", "3000"]);
    let (points, normals) = (
        vectors(&layer, "point3f[] points"),
        vectors(&layer, "normal3f[] normals"),
    );
    assert!(points.len() > 1500 && points.len() == normals.len());
    for (point, normal) in points.iter().zip(&normals) {
        let (height, slope) = wave(point.x);
        assert!((point.y - height).abs() < 1e-4, "{point} {height}");
        let expected = Vec3::new(-slope, 1.0, 0.0).normalize();
        // Of both sides; at the rim the image ends in a flat edge.
        assert!(normal.dot(expected).abs() > 0.9998, "{normal} {expected}");
    }
}

#[test]
fn a_plane_tilted_by_a_primvar_gets_the_sun_of_a_tilted_plane_and_a_flat_one_the_whole() {
    let height = "float inputs:displacement.connect = </World/Look/height.outputs:result>";
    for (displacement, output, expected) in [
        (height, OUTPUT, 0.5_f32.sqrt()),
        ("float inputs:displacement = 0.5", OUTPUT, 1.0),
        // Nothing says that it counts.
        (height, "", 1.0),
    ] {
        let (folder, path) = stage(&card(displacement, output, SUN));
        images(folder.path());
        let (layer, _) = made(&path, &["bake", "--aov", "irradiance_direct"]);
        for light in vectors(&layer, "primvars:irradiance_direct") {
            assert!(
                (light - expected).abs().max_element() < 1e-4,
                "{displacement}: {light}"
            );
        }
    }
}

#[test]
fn occlusion_opens_the_height_and_no_other_image_and_none_of_what_is_flat() {
    let (folder, path) = stage(&card(RELIEF, OUTPUT, ""));
    images(folder.path());
    let (layer, report) = made(&path, &["bake", "--aov", "occlusion", "--rays", "1024"]);
    assert!(layer.contains("primvars:occlusion"));
    assert_eq!(report["read"]["textures"], 1);
    let files = report["read"]["files"].to_string();
    assert!(
        files.contains("relief.exr") && !files.contains("paint.exr"),
        "{files}"
    );
    let (folder, path) = stage(&card("float inputs:displacement = 0", OUTPUT, ""));
    images(folder.path());
    let (_, report) = made(&path, &["bake", "--aov", "occlusion", "--rays", "16"]);
    assert_eq!(report["read"]["textures"], 0);
}

#[test]
fn a_sphere_grows_by_its_displacement_and_instances_by_the_same_in_the_world() {
    let instancer = r#"def PointInstancer "balls"
    {
        rel prototypes = [</World/balls/ball>]
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 0, 0), (10, 0, 0)]
        float3[] scales = [(1, 1, 1), (2, 2, 2)]
        def Sphere "ball" (prepend apiSchemas = ["MaterialBindingAPI"])
        {
            double radius = 1
            rel material:binding = </World/Look>
        }
    }"#;
    let text = card("float inputs:displacement = 0.25", OUTPUT, instancer).replace(
        "def Mesh \"card\" (",
        "def Mesh \"card\" ( active = false\n",
    );
    let (folder, path) = stage(&text);
    images(folder.path());
    let (layer, _) = made(&path, &["points", "--surfels", "4000"]);
    let points = vectors(&layer, "point3f[] points");
    let (near, far): (Vec<Vec3>, Vec<Vec3>) = points.iter().partition(|point| point.x < 5.0);
    assert!(near.len() > 500 && far.len() > 500);
    let radius = |points: &[Vec3], center: Vec3| {
        let sum: f32 = points.iter().map(|point| point.distance(center)).sum();
        sum / points.len() as f32
    };
    // Facets lie below the sphere by a little.
    let radii = (
        radius(&near, Vec3::ZERO),
        radius(&far, Vec3::new(10.0, 0.0, 0.0)),
    );
    assert!(
        (radii.0 - 1.25).abs() < 3e-3 && (radii.1 - 2.25).abs() < 6e-3,
        "{radii:?}"
    );
}

#[test]
fn what_takes_too_many_triangles_is_cut_less_with_a_warning() {
    // Each size is a mesh of its own: 20 times a quarter of a million.
    let copy = |k: u32| {
        let scale = 1.0 + 0.01 * f64::from(k);
        format!(
            "def Xform \"c{k}\" {{ float3 xformOp:scale = ({scale}, {scale}, {scale})
            uniform token[] xformOpOrder = [\"xformOp:scale\"]
            def \"copy\" (prepend references = </World/card>) {{ }} }}\n"
        )
    };
    let copies: String = (1..20).map(copy).collect();
    let (folder, path) = stage(&card(RELIEF, OUTPUT, &copies));
    images(folder.path());
    let (_, report) = made(&path, &["points", "--surfels", "100"]);
    let triangles = report["counts"]["triangles"].as_u64().expect("counted");
    assert!((500_000..=2_000_000).contains(&triangles), "{triangles}");
    let warnings = report["warnings"].to_string();
    assert!(
        warnings.contains("displaced triangles are cut to edges of"),
        "{warnings}"
    );
}

#[test]
fn a_displacement_shader_that_is_not_known_is_a_warning() {
    let output = "token outputs:displacement.connect = </World/Look/relief.outputs:r>";
    let (folder, path) = stage(&card("", output, SUN));
    images(folder.path());
    let (layer, report) = made(&path, &["bake", "--aov", "irradiance_direct"]);
    for light in vectors(&layer, "primvars:irradiance_direct") {
        assert!((light - 1.0).abs().max_element() < 1e-4, "{light}");
    }
    let warnings = report["warnings"].to_string();
    assert!(
        warnings.contains("displacement shader `UsdUVTexture`"),
        "{warnings}"
    );
}

#[test]
fn a_height_image_that_is_missing_is_a_warning_and_gives_its_fallback() {
    let (_folder, path) = stage(&card(RELIEF, OUTPUT, SUN));
    let (layer, report) = made(&path, &["bake", "--aov", "occlusion", "--rays", "16"]);
    assert!(layer.contains("primvars:occlusion"));
    let warnings = report["warnings"].to_string();
    assert!(
        warnings.contains("missing-texture") && warnings.contains("relief.exr"),
        "{warnings}"
    );
}
