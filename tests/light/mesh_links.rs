//! `lightLink` and `shadowLink` of meshes that are lights, against closed forms.

use crate::dome_links::{BALL, assert_all, lit, square};
use std::f32::consts::PI;

/// Irradiance at the corners of the floor, each below one of a square as large, 2 above it, of radiance 3: the form factor of
/// a square with sides as long as its distance. Corners are lit from a little inside, where there is 1.3 % more.
const BELOW_A_CORNER: f32 = 3.0 * PI * 0.138_534;

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
    assert_all(&all[0], BELOW_A_CORNER, 0.02);
    let linked = of("rel collection:lightLink:excludes = </World/floor>");
    assert!(linked[0].iter().all(|value| *value == glam::Vec3::ZERO));
    assert_all(&linked[1], BELOW_A_CORNER, 0.02);
}

#[test]
fn a_mesh_light_is_blocked_by_the_prims_of_its_shadow_link_and_no_others() {
    let ball = BALL.replace("(0, 2, 0)", "(0, 1, 0)");
    let of = |links: &str| {
        let more = format!("{ball}\n{}", panel(links));
        lit(&more, &["floor"], "irradiance_direct", &[]).remove(0)
    };
    assert_all(
        &of("rel collection:shadowLink:excludes = </World/ball>"),
        BELOW_A_CORNER,
        0.02,
    );
    for value in of("") {
        assert!(value.x < 0.9 * BELOW_A_CORNER && value.x > 0.0, "{value}");
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
    assert!(without.iter().all(|value| *value == glam::Vec3::ZERO));
}
