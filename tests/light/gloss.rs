//! Glossy reflection, end to end, against closed forms.

use crate::program::{json, run, stage, stderr};
use glam::{DVec3, Vec3};
use std::fs;

/// A floor that looks like this, as the inputs of UsdPreviewSurface say, under a sky of radiance 1 or what `more` has; a
/// camera straight above it.
fn floor(inputs: &str, more: &str) -> String {
    format!(
        r#"#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{{
    def Mesh "floor" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        point3f[] points = [(-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Look>
    }}
    def Camera "cam"
    {{
        double3 xformOp:translate = (0, 1000, 0)
        float xformOp:rotateX = -90
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    }}
    def Material "Look"
    {{
        token outputs:surface.connect = </World/Look/surface.outputs:surface>
        def Shader "surface"
        {{
            uniform token info:id = "UsdPreviewSurface"
            {inputs}
            token outputs:surface
        }}
    }}
    {more}
}}
"#
    )
}

/// A wall at x = 3 that faces −x and looks like this, as the inputs of UsdPreviewSurface say, and what `more` has below it.
fn wall(inputs: &str, more: &str) -> String {
    format!(
        r#"def Mesh "wall" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        point3f[] points = [(3, -50, -50), (3, -50, 50), (3, 50, 50), (3, 50, -50)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/wall/Look>
        def Material "Look"
        {{
            token outputs:surface.connect = </World/wall/Look/surface.outputs:surface>
            def Shader "surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                {inputs}
                token outputs:surface
            }}
        }}
        {more}
    }}"#
    )
}

const SKY: &str = "def DomeLight \"sky\" { float inputs:intensity = 1 }";

const MIRROR: &str = "color3f inputs:diffuseColor = (0.9, 0.7, 0.5)\nfloat inputs:metallic = 1\nfloat inputs:roughness = 0";

/// Gray metal.
fn metal(roughness: f64) -> String {
    format!(
        "color3f inputs:diffuseColor = (0.5, 0.5, 0.5)\nfloat inputs:metallic = 1\nfloat inputs:roughness = {roughness}"
    )
}

/// A panel of 2 by 2 and radiance 4 at x = 2, y = 5 that faces the wall.
const LAMP: &str = r#"def RectLight "lamp"
    {
        float inputs:intensity = 4
        float inputs:width = 2
        float inputs:height = 2
        double3 xformOp:translate = (2, 5, 0)
        float xformOp:rotateY = -90
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY"]
    }"#;

/// What a bake of `text` seen from `view` finds at the four points of the floor.
fn baked(text: &str, view: &str) -> Vec<Vec3> {
    values(text, "specular_indirect", &["--view", view])
}

/// Colors of `aov` at the four points of the floor; alpha left out.
fn values(text: &str, aov: &str, flags: &[&str]) -> Vec<Vec3> {
    let (folder, path) = stage(text);
    let out = folder.path().join("out.usda");
    let mut args = vec!["bake", path.to_str().expect("UTF-8"), "--usd", "native"];
    args.extend(["-o", out.to_str().expect("UTF-8"), "--aov", aov, "--mask"]);
    args.push("/World/floor,/World/wall,/World/sky,/World/Look,/World/cam");
    args.extend(flags);
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
    let layer = fs::read_to_string(out).expect("a layer");
    let over = &layer[layer.find("\"floor\"").expect("the floor")..];
    let name = format!("primvars:{aov} = [");
    let values = &over[over.find(&name).expect("the primvar") + name.len()..];
    let values = &values[..values.find(']').expect("an end")];
    let numbers: Vec<f32> = (values.split([',', '(', ')']))
        .filter_map(|word| word.trim().parse().ok())
        .collect();
    (numbers.chunks_exact(numbers.len() / 4))
        .map(Vec3::from_slice)
        .collect()
}

#[test]
fn color_is_what_leaves_towards_the_eye_and_diffuse_where_there_is_none() {
    let look =
        "color3f inputs:diffuseColor = (0.2, 0.4, 0.6)\ncolor3f inputs:emissiveColor = (0.1, 0, 0)";
    let text = floor(look, SKY);
    for view in ["0,-1,0", "0.8660254,-0.5,0"] {
        let of = |aov| values(&text, aov, &["--view", view])[2];
        let parts = of("emission") + of("diffuse_direct") + of("diffuse_indirect");
        let gloss = of("specular_indirect");
        assert!(gloss.min_element() > 0.02, "{gloss}");
        // Of gloss alone color asks for fewer rays.
        let color = of("color");
        assert!(color.abs_diff_eq(parts + gloss, 1e-3), "{view}: {color}");
        assert!(values(&text, "color", &[])[2].abs_diff_eq(parts, 1e-6));
    }
}

#[test]
fn a_metal_mirror_shows_a_white_sky_in_its_color_and_its_back_shows_nothing() {
    for view in ["0,-1,0", "cam"] {
        for value in baked(&floor(MIRROR, SKY), view) {
            assert!(
                value.abs_diff_eq(Vec3::new(0.9, 0.7, 0.5), 2e-3),
                "{view}: {value}"
            );
        }
    }
    assert_eq!(baked(&floor(MIRROR, SKY), "0,1,0"), [Vec3::ZERO; 4]);
}

#[test]
fn a_dielectric_reflects_by_its_index_and_more_at_grazing_angles() {
    let glass = "float inputs:ior = 2\nfloat inputs:roughness = 0";
    let straight = baked(&floor(glass, SKY), "0,-1,0")[0];
    assert!((straight.x - 1.0 / 9.0).abs() < 1e-3, "{straight}");
    // Schlick at 60°: f + (1 − f) / 32.
    let slant = baked(&floor(glass, SKY), "0.8660254,-0.5,0")[0];
    let exact = 1.0 / 9.0 + 8.0 / 9.0 / 32.0;
    assert!((slant.x - exact).abs() < 2e-3, "{slant} {exact}");
    let black = "int inputs:useSpecularWorkflow = 1\ncolor3f inputs:specularColor = (0, 0, 0)";
    assert_eq!(baked(&floor(black, SKY), "0,-1,0"), [Vec3::ZERO; 4]);
    let coated = format!("{black}\nfloat inputs:clearcoat = 0.5");
    let coat = baked(&floor(&coated, SKY), "0,-1,0")[0];
    assert!((coat.x - 0.02).abs() < 1e-3, "{coat}");
}

/// A wall of radiance 2, made of emission alone, is what a mirror before it shows: from where it stands under 45°.
#[test]
fn a_mirror_shows_the_wall_behind_the_eye() {
    let bright =
        "color3f inputs:diffuseColor = (0, 0, 0)\ncolor3f inputs:emissiveColor = (2, 2, 2)";
    let text = floor(MIRROR, &wall(bright, ""));
    for value in baked(&text, "1,-1,0") {
        assert!(value.abs_diff_eq(Vec3::new(1.8, 1.4, 1.0), 5e-3), "{value}");
    }
    assert_eq!(baked(&text, "-1,-1,0"), [Vec3::ZERO; 4]);
}

/// Surfels of metal are black: what it reflects is found along the ray.
#[test]
fn a_mirror_shows_what_a_mirror_shows() {
    let text = floor(MIRROR, &format!("{}\n{SKY}", wall(&metal(0.0), "")));
    for value in baked(&text, "1,-1,0") {
        let exact = Vec3::new(0.45, 0.35, 0.25);
        assert!(value.abs_diff_eq(exact, 5e-3), "{value}");
    }
}

/// What a wall at x = 3 with a metal lobe (0.5 straight on) of width `alpha` reflects at `place` towards the unit `view` of a panel
/// of 2 by 2 and radiance 4 at x = 2, y = 5 that faces it: D·F·G₂ / (4 cos cos), summed over small squares of the panel.
fn reflected_panel(place: DVec3, view: DVec3, alpha: f64) -> f64 {
    let masked = |cosine: f64| 0.5 * ((1.0 + alpha * alpha * (cosine.powi(-2) - 1.0)).sqrt() - 1.0);
    let side = 100;
    let square = 2.0 / f64::from(side);
    let mut sum = 0.0;
    for (i, k) in (0..side).flat_map(|i| (0..side).map(move |k| (i, k))) {
        let at = |i: i32| -1.0 + (f64::from(i) + 0.5) * square;
        let way = DVec3::new(2.0, 5.0 + at(i), at(k)) - place;
        let light = way.normalize();
        // The wall faces −x, the panel +x.
        let (to_light, to_eye) = (-light.x, -view.x);
        let facet = (light + view).normalize();
        let spread = facet.x * facet.x * (alpha * alpha - 1.0) + 1.0;
        let density = alpha * alpha / (std::f64::consts::PI * spread * spread);
        let open = 1.0 / (1.0 + masked(to_light) + masked(to_eye));
        let fresnel = 0.5 + 0.5 * (1.0 - view.dot(facet)).powi(5);
        let brdf = density * fresnel * open / (4.0 * to_light * to_eye);
        sum += 4.0 * brdf * to_light * to_light * square * square / way.length_squared();
    }
    sum
}

/// Wide lobes look at lamps; narrow ones meet them, by chance.
#[test]
fn a_mirror_shows_what_rough_metal_reflects_of_a_lamp() {
    for (roughness, most) in [(0.3, 0.08), (0.6, 0.02), (0.9, 0.02)] {
        let text = floor(MIRROR, &wall(&metal(roughness), LAMP));
        let found = baked(&text, "1,-1,0");
        let corners = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];
        for ((x, z), value) in corners.into_iter().zip(found) {
            let place = DVec3::new(3.0, 3.0 - x, z);
            let view = DVec3::new(-1.0, -1.0, 0.0).normalize();
            let exact = reflected_panel(place, view, roughness * roughness);
            let tint = DVec3::new(0.9, 0.7, 0.5);
            let error = value.as_dvec3() / (exact * tint) - 1.0;
            assert!(error.abs().max_element() < most, "{roughness}: {error}");
        }
    }
}

#[test]
fn a_bake_without_an_eye_is_a_usage_error() {
    let (folder, path) = stage(&floor(MIRROR, SKY));
    let out = folder.path().join("out.usda");
    let arguments = |more: &[&str]| {
        let mut all = vec!["bake", path.to_str().expect("UTF-8"), "-o"];
        all.push(out.to_str().expect("UTF-8"));
        all.extend(["--aov", "specular_indirect"]);
        all.extend(more);
        run(&all)
    };
    for (more, code, word) in [
        (&[][..], 2, "--view"),
        (&["--view", "0,0,0"][..], 2, "--view"),
        (&["--view", "1,x,0"][..], 2, "--view"),
        (&["--view", "nobody"][..], 1, "nobody"),
    ] {
        let result = arguments(more);
        assert_eq!(
            result.status.code(),
            Some(code),
            "{more:?} {}",
            stderr(&result)
        );
        assert!(stderr(&result).contains(word), "{}", stderr(&result));
        assert!(!out.exists());
    }
}

/// A folder with a render of `text`, `out.exr`, and what the run tells.
fn rendered(text: &str, flags: &[&str]) -> (tempfile::TempDir, serde_json::Value) {
    let (folder, path) = stage(text);
    let out = folder.path().join("out.exr");
    let mut args = vec!["render", path.to_str().expect("UTF-8"), "-o"];
    args.extend([out.to_str().expect("UTF-8"), "--usd", "native", "--json"]);
    args.extend(flags);
    let report = json(&run(&args));
    (folder, report)
}

#[test]
fn a_render_tells_its_error_and_meets_a_tolerance() {
    let rough = MIRROR.replace("roughness = 0", "roughness = 0.4");
    let ball = "def Sphere \"ball\" { double radius = 0.5\ndouble3 xformOp:translate = (0, 0.6, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"] }";
    let text = floor(&rough, &format!("{SKY}\n{ball}"));
    let aovs = ["--aov", "specular_indirect,occlusion"];
    let flags = [&aovs[..], &["--tolerance", "0.02", "--image-width", "96"]].concat();
    let (_folder, report) = rendered(&text, &flags);
    let error = report["error"]["aovs"]["specular_indirect"].as_f64();
    assert!(
        error.is_some_and(|error| error > 0.0 && error <= 0.02),
        "{error:?}"
    );
    assert!(report["error"]["aovs"]["visibility"].as_f64().is_some());
}

/// A picture of a rough ball on such a floor, and what the run tells.
fn picture(inputs: &str, aovs: &str) -> (Vec<f32>, serde_json::Value) {
    let ball = "def Sphere \"ball\" { double radius = 0.5\nrel material:binding = </World/Look>\ndouble3 xformOp:translate = (0, 0.5, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"] }";
    let near = "def Camera \"near\" { double3 xformOp:translate = (0, 0.4, 6)\nuniform token[] xformOpOrder = [\"xformOp:translate\"] }";
    let text = floor(inputs, &format!("{SKY}\n{ball}\n{near}"));
    let shot = ["--camera", "/World/near", "--image-width", "64"];
    let flags = [&shot[..], &["--aov", aovs, "--tolerance", "0.01"]].concat();
    let (folder, report) = rendered(&text, &flags);
    let out = folder.path().join("out.exr");
    let image = exr::prelude::read_first_rgba_layer_from_file(
        &out,
        |size, _| (size.width(), vec![0.0; 3 * size.area()]),
        |(width, pixels): &mut (usize, Vec<f32>), at, (r, g, b, _): (f32, f32, f32, f32)| {
            let first = 3 * (at.y() * *width + at.x());
            pixels[first..first + 3].copy_from_slice(&[r, g, b]);
        },
    );
    let (_, pixels) = image.expect("a picture").layer_data.channel_data.pixels;
    (pixels, report)
}

#[test]
fn gloss_is_as_exact_as_the_color_it_is_part_of_needs() {
    let inputs = "color3f inputs:diffuseColor = (0.7, 0.6, 0.5)\nfloat inputs:roughness = 0.6";
    let (part, told) = picture(inputs, "color");
    let (strict, of_both) = picture(inputs, "color,specular_indirect");
    let aovs = |report: &serde_json::Value| {
        let aovs = report["error"]["aovs"].as_object().expect("errors");
        aovs.keys().cloned().collect::<Vec<_>>()
    };
    assert_eq!(aovs(&told), ["color"], "what is in the picture");
    assert_eq!(aovs(&of_both), ["color", "specular_indirect"]);
    let estimate = told["error"]["estimate"].as_f64().expect("an estimate");
    assert!(estimate > 0.0 && estimate <= 0.01, "{estimate}");
    let mean = strict.iter().sum::<f32>() / strict.len() as f32;
    let squares = part.iter().zip(&strict).map(|(a, b)| (a - b).powi(2));
    let error = (squares.sum::<f32>() / strict.len() as f32).sqrt() / mean;
    // Diffuse light is the same; gloss is allowed 0.4 of the tolerance.
    assert!(error > 0.0 && error < 0.4 * 0.01, "{error}");
}

#[test]
fn gloss_that_is_little_of_the_color_of_a_light_group_misses_no_tolerance() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out.exr");
    let report = json(&run(&[
        "render",
        concat!(env!("CARGO_MANIFEST_DIR"), "/examples/teapots_lights.usda"),
        "-o",
        out.to_str().expect("UTF-8"),
        "--usd",
        "native",
        "--aov",
        "color",
        "--tolerance",
        "0.05",
        "--image-width",
        "48",
        "--light-groups",
        "warm=/Box/ball",
        "--json",
    ]));
    assert_eq!(report["warnings"], serde_json::json!([]));
    let estimate = report["error"]["estimate"].as_f64().expect("an estimate");
    assert!(estimate > 0.0 && estimate <= 0.05, "{estimate}");
}
