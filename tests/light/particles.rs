//! Particles of clouds as sources of light, end to end, against closed forms.

use crate::program::{run, stage, stderr};
use glam::Vec3;
use std::f32::consts::PI;
use std::fs;

/// A floor under whatever shines.
const FLOOR: &str = r#"#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{
    def Mesh "floor"
    {
        point3f[] points = [(0, 0, 0), (-1, 0, 1), (1, 0, 1), (1, 0, -1), (-1, 0, -1)]
        int[] faceVertexCounts = [3, 3, 3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 1]
        uniform token subdivisionScheme = "none"
    }
    def Mesh "lid" (active = false)
    {
        point3f[] points = [(-9, 1, 9), (9, 1, 9), (9, 1, -9), (-9, 1, -9)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = "none"
    }
}
"#;

/// Points that hang twice as high as they say.
fn fire(points: &str) -> String {
    format!(
        r#"#usda 1.0
(
    defaultPrim = "root"
    upAxis = "Y"
)
def Xform "root"
{{
    double3 xformOp:translate = (0, 1, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Points "fire"
    {{
        {points}
    }}
}}
"#
    )
}

/// Direct light at the points of the floor, its middle first, under `cloud`, and what is said of it.
fn baked(floor: &str, cloud: &str) -> (Vec<Vec3>, String) {
    let (folder, path) = stage(floor);
    let file = folder.path().join("fire.usda");
    fs::write(&file, cloud).expect("writable");
    let out = folder.path().join("out.usda");
    let [path, file, out_path] = [&path, &file, &out].map(|path| path.to_str().expect("UTF-8"));
    let result = run(&[
        "bake",
        path,
        "-o",
        out_path,
        "--cloud",
        file,
        "--usd",
        "native",
        "--aov",
        "irradiance_direct",
    ]);
    assert!(result.status.success(), "{}", stderr(&result));
    let layer = fs::read_to_string(&out).expect("a layer");
    let name = "primvars:irradiance_direct = [";
    let values = &layer[layer.find(name).expect("the primvar") + name.len()..];
    let values = &values[..values.find(']').expect("an end")];
    let numbers: Vec<f32> = (values.split([',', '(', ')']))
        .filter_map(|word| word.trim().parse().ok())
        .collect();
    let colors = numbers.chunks_exact(3).map(Vec3::from_slice).collect();
    (colors, stderr(&result))
}

const SPHERE: &str = "point3f[] points = [(0, 1, 0)]\nfloat[] widths = [0.4]\n\
    color3f[] primvars:displayColor = [(3, 2, 1)] (interpolation = \"vertex\")";

#[test]
fn a_point_with_a_width_and_a_color_shines_like_a_sphere() {
    let (colors, _) = baked(FLOOR, &fire(SPHERE));
    // Radius 0.2, two above the middle of the floor.
    let truth = PI * 0.04 / 4.0;
    assert_eq!(colors.len(), 5);
    let error = colors[0] / (truth * Vec3::new(3.0, 2.0, 1.0)) - 1.0;
    assert!(error.abs().max_element() < 1e-3, "{} {truth}", colors[0]);
    // Corners are √6 away, receivers a little nearer: they stand inside of their faces.
    let truth = PI * 0.04 / 6.0 * (2.0 / 6.0_f32.sqrt());
    for color in &colors[1..] {
        let error = *color / (truth * Vec3::new(3.0, 2.0, 1.0)) - 1.0;
        assert!(error.abs().max_element() < 0.03, "{color} {truth}");
    }
}

#[test]
fn points_with_emission_and_normals_shine_like_disks_to_their_front() {
    let disk = |normal: &str| {
        fire(&format!(
            "point3f[] points = [(0, 1, 0)]\nfloat[] widths = [0.04]\nnormal3f[] normals = [{normal}]\n\
             color3f[] primvars:emission = [(3, 2, 1)] (interpolation = \"vertex\")"
        ))
    };
    // Emission is radiosity: a πth of it is radiance.
    let truth = 0.0004 / 4.0;
    let color = baked(FLOOR, &disk("(0, -1, 0)")).0[0];
    let error = color / (truth * Vec3::new(3.0, 2.0, 1.0)) - 1.0;
    assert!(error.abs().max_element() < 1e-3, "{color} {truth}");
    for color in baked(FLOOR, &disk("(0, 1, 0)")).0 {
        assert_eq!(color, Vec3::ZERO);
    }
}

#[test]
fn surfaces_hide_particles() {
    let lid = FLOOR.replace(" (active = false)", "");
    let (colors, _) = baked(&lid, &fire(SPHERE));
    assert!(
        colors.iter().all(|color| *color == Vec3::ZERO),
        "{colors:?}"
    );
}

#[test]
fn black_negative_and_flat_points_give_nothing_and_a_warning() {
    for points in [
        SPHERE.replace("[0.4]", "[0]"),
        SPHERE.replace("(3, 2, 1)", "(0, 0, 0)"),
        SPHERE.replace("(3, 2, 1)", "(-3, 0, 0)"),
        "point3f[] points = []".to_owned(),
    ] {
        let (colors, said) = baked(FLOOR, &fire(&points));
        assert!(colors.iter().all(|color| *color == Vec3::ZERO), "{points}");
        assert!(said.contains("fire"), "{said}");
    }
}

#[test]
fn points_of_the_stage_cover_as_spheres_and_as_disks_where_they_have_normals() {
    // Seen from the middle of the floor, and from a corner: as much of the sky as a sphere, a disk takes.
    let corner = 0.25 / 3.0_f32.powf(1.5);
    for (normals, expected) in [
        ("", [0.25, corner]),
        ("normal3f[] normals = [(0, -1, 0)]", [0.2, 0.0]),
    ] {
        let points = format!(
            "def Points \"ball\" {{ point3f[] points = [(0, 1, 0)]\nfloat[] widths = [1]\n{normals} }}"
        );
        let floor = FLOOR.replace(
            "def Mesh \"lid\"",
            &format!("{points}\n    def Mesh \"lid\""),
        );
        let (folder, path) = stage(&floor);
        let out = folder.path().join("out.usda");
        let [path, out_path] = [&path, &out].map(|path| path.to_str().expect("UTF-8"));
        let flags = ["--aov", "occlusion", "--rays", "4096", "--usd", "native"];
        let result = run(&[&["bake", path, "-o", out_path][..], &flags[..]].concat());
        assert!(result.status.success(), "{}", stderr(&result));
        let layer = fs::read_to_string(&out).expect("a layer");
        let values = &layer[layer.find("primvars:occlusion = [").expect("baked") + 22..];
        let values: Vec<f32> = (values[..values.find(']').expect("an end")].split(','))
            .map(|value| value.trim().parse().expect("a number"))
            .collect();
        // A polyhedron: its outline is not round.
        assert!((values[0] - expected[0]).abs() < 0.01, "{values:?}");
        if expected[1] > 0.0 {
            let off = values[1..].iter().map(|value| (value - expected[1]).abs());
            assert!(off.fold(0.0, f32::max) < 0.003, "{values:?} {corner}");
        }
    }
}
