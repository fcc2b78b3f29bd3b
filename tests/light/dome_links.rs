//! `lightLink` and `shadowLink` of domes, against closed forms, whatever engine gathers.

use crate::floors::floor;
use crate::opacity::{bake, values_of};
use crate::program::stage;
use glam::Vec3;
use std::f32::consts::PI;

const ENGINES: [&[&str]; 2] = [&["--gather", "rays"], &["--gather", "maps"]];

/// A square like the floor's, at height `y`, with its points in the same order.
pub(crate) fn square(name: &str, x: f32, y: f32) -> String {
    let corner = |sx: f32, sz: f32| format!("({}, {y}, {sz})", x + sx);
    let corners =
        [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(sx, sz)| corner(sx, sz));
    format!(
        "def Mesh \"{name}\" {{ point3f[] points = [{}]
int[] faceVertexCounts = [4]
int[] faceVertexIndices = [0, 1, 2, 3]
uniform token subdivisionScheme = \"none\"
color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)] }}",
        corners.join(", ")
    )
}

fn dome(name: &str, radiance: f32, links: &str) -> String {
    format!("def DomeLight \"{name}\" {{ float inputs:intensity = {radiance}\n{links} }}")
}

/// Radius 0.5, 2 above the floor.
pub(crate) const BALL: &str = "def Sphere \"ball\" { double radius = 0.5
double3 xformOp:translate = (0, 2, 0)
uniform token[] xformOpOrder = [\"xformOp:translate\"] }";

/// Values of `aov` at the points of each of `meshes`.
pub(crate) fn lit(more: &str, meshes: &[&str], aov: &str, flags: &[&str]) -> Vec<Vec<Vec3>> {
    let (folder, path) = stage(&floor(1.0, 0.5, more));
    let layer = bake(folder.path(), &path, aov, flags);
    meshes
        .iter()
        .map(|mesh| values_of(mesh, &layer, aov))
        .collect()
}

#[track_caller]
pub(crate) fn assert_all(found: &[Vec3], exact: f32, tolerance: f32) {
    for value in found {
        let off = (*value - exact).abs().max_element();
        assert!(off <= tolerance * exact, "{value} should be {exact}");
    }
}

#[test]
fn a_dome_lights_the_prims_of_its_light_link_and_no_others() {
    let far = square("far", 50.0, 0.0);
    let without_floor = "rel collection:lightLink:excludes = </World/floor>";
    for flags in ENGINES {
        let alone = format!("{far}\n{}", dome("sky", 2.0, without_floor));
        let found = lit(&alone, &["floor", "far"], "irradiance_environment", flags);
        assert_eq!(found[0], [Vec3::ZERO; 4], "{flags:?}");
        assert_all(&found[1], 2.0 * PI, 0.01);
        let both = format!("{alone}\n{}", dome("rest", 1.0, ""));
        let found = lit(&both, &["floor", "far"], "irradiance_environment", flags);
        assert_all(&found[0], PI, 0.01);
        assert_all(&found[1], 3.0 * PI, 0.01);
    }
}

#[test]
fn a_dome_is_blocked_by_the_prims_of_its_shadow_link_and_no_others() {
    let without_ball = "rel collection:shadowLink:excludes = </World/ball>";
    // the form factor of the ball from a corner of the floor
    let distance_squared = 1.0 + 4.0 + 1.0_f32;
    let hidden = 0.25 / distance_squared * (2.0 / distance_squared.sqrt());
    for flags in ENGINES {
        for (links, open) in [(without_ball, 1.0), ("", 1.0 - hidden)] {
            let more = format!("{BALL}\n{}", dome("sky", 1.0, links));
            let found = lit(&more, &["floor"], "irradiance_environment", flags);
            assert_all(&found[0], PI * open, 0.01);
        }
    }
}

#[test]
fn light_of_a_dome_is_reflected_only_by_what_it_lights() {
    // nothing but the lid sees the floor, and the other way round
    let lid = square("lid", 0.0, 0.5);
    let of = |links: &str| {
        let more = format!("{lid}\n{}", dome("sky", 1.0, links));
        lit(
            &more,
            &["floor"],
            "irradiance_indirect",
            &["--surfels", "2000"],
        )
        .remove(0)
    };
    let (all, none) = (
        of(""),
        of("rel collection:lightLink:excludes = </World/lid>"),
    );
    assert!(
        all.iter().all(|value| value.min_element() > 0.05),
        "{all:?}"
    );
    assert_eq!(none, [Vec3::ZERO; 4]);
}
