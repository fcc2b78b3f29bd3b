//! `lightLink` and `shadowLink` of meshes that are lights, against closed forms.

use crate::dome_links::{BALL, lit, square};
use glam::Vec3;
use std::f32::consts::PI;

/// Irradiance at (x, 0, z) below the panel: the form factors of the four rectangles that meet above it.
fn below(x: f32, z: f32) -> f32 {
    let part = |a: f32, b: f32| {
        let by = |a: f32, b: f32| a / a.hypot(2.0) * (b / a.hypot(2.0)).atan();
        (by(a, b) + by(b, a)) / (2.0 * PI)
    };
    let sides = |x: f32| [1.0 + x, 1.0 - x];
    let all = sides(x).map(|a| sides(z).map(|b| part(a, b)).iter().sum::<f32>());
    3.0 * PI * all.iter().sum::<f32>()
}

/// The same at the points of the floor, which are lit from 1.5 % of the way into a triangle.
fn at_corners() -> [f32; 4] {
    [(-0.98, 0.99), (0.99, 0.99), (0.99, -0.98), (-0.99, -0.99)].map(|(x, z)| below(x, z))
}

#[track_caller]
fn assert_below(found: &[Vec3]) {
    for (value, exact) in found.iter().zip(at_corners()) {
        assert!(
            (*value - exact).abs().max_element() < 2e-3 * exact,
            "{value} {exact}"
        );
    }
}

/// A square of radiance 3 that looks down on the floor from twice its half width, and has these links.
fn panel(links: &str) -> String {
    format!(
        "def Mesh \"panel\" ( apiSchemas = [\"MeshLightAPI\"] ) {{
point3f[] points = [(-1, 2, 1), (-1, 2, -1), (1, 2, -1), (1, 2, 1)]
int[] faceVertexCounts = [4]
int[] faceVertexIndices = [0, 1, 2, 3]
uniform token subdivisionScheme = \"none\"
uniform token light:materialSyncMode = \"independent\"
float inputs:intensity = 3
{links} }}"
    )
}

#[test]
fn a_mesh_light_lights_the_prims_of_its_light_link_and_no_others() {
    let beside = square("beside", 0.0, 0.0).replace("0.5, 0.5, 0.5", "0.2, 0.2, 0.2");
    let of = |links: &str| {
        let more = format!("{beside}\n{}", panel(links));
        lit(&more, &["floor", "beside"], "irradiance_direct", &[])
    };
    let all = of("");
    assert_below(&all[0]);
    let linked = of("rel collection:lightLink:excludes = </World/floor>");
    assert!(linked[0].iter().all(|value| *value == Vec3::ZERO));
    assert_eq!(linked[1], all[1]);
}

#[test]
fn a_mesh_light_is_blocked_by_the_prims_of_its_shadow_link_and_no_others() {
    let ball = BALL.replace("(0, 2, 0)", "(0, 1, 0)");
    let of = |more: &str| lit(more, &["floor"], "irradiance_direct", &[]).remove(0);
    let alone = of(&panel(""));
    assert_below(&alone);
    let without_ball = "rel collection:shadowLink:excludes = </World/ball>";
    let linked = of(&format!("{ball}\n{}", panel(without_ball)));
    for (value, alone) in linked.iter().zip(&alone) {
        assert!(value.abs_diff_eq(*alone, 1e-4 * alone.x), "{value} {alone}");
    }
    let blocked = of(&format!("{ball}\n{}", panel("")));
    for (value, alone) in blocked.iter().zip(alone) {
        assert!(value.x < 0.9 * alone.x && value.x > 0.0, "{value}");
    }
}

#[test]
fn light_of_a_mesh_is_reflected_only_by_what_it_lights() {
    let wall = "def Mesh \"wall\" {
point3f[] points = [(-1, 0, -1), (1, 0, -1), (1, 2, -1), (-1, 2, -1)]
int[] faceVertexCounts = [4]
int[] faceVertexIndices = [0, 1, 2, 3]
uniform token subdivisionScheme = \"none\"
color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)] }";
    let of = |links: &str| {
        let more = format!("{wall}\n{}", panel(links));
        let flags = ["--surfels", "2000"];
        lit(&more, &["floor"], "irradiance_indirect", &flags).remove(0)
    };
    assert!(of("").iter().any(|value| value.min_element() > 0.02));
    let without = of("rel collection:lightLink:excludes = </World/wall>");
    assert!(without.iter().all(|value| *value == Vec3::ZERO));
}
