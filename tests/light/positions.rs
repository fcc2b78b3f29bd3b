//! `surflux bake --positions`: results at points of a file, against closed forms.

use crate::program::{run, stage, stderr};
use std::f32::consts::PI;
use std::fs;
use std::path::Path;
use surflux::math::sh::{CLAMPED_COSINE, Sh9};

/// A ball of radius 1, moved far off, under a sky of radiance 1 and a sun from +Z.
const STAGE: &str = r#"#usda 1.0
( metersPerUnit = 1
  upAxis = "Y" )
def Xform "World"
{
    def Sphere "ball"
    {
        double radius = 1
        double3 xformOp:translate = (5000, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def DomeLight "sky" { float inputs:intensity = 1 }
    def DistantLight "sun"
    {
        float inputs:intensity = 2
        float inputs:angle = 0
        bool inputs:normalize = 1
    }
}
"#;

/// At distance 3 facing the ball, facing away, and in its shadow; the last faces nowhere.
const POINTS: &str = r#"#usda 1.0
( metersPerUnit = 1
  upAxis = "Y" )
def Xform "set"
{
    double3 xformOp:translate = (5000, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Points "p"
    {
        point3f[] points = [(3, 0, 0), (3, 0, 0), (0, 0, -3), (0, 4, 0)]
        normal3f[] normals = [(-1, 0, 0), (1, 0, 0), (0, 0, 1), (0, 0, 0)] (interpolation = "vertex")
        float[] widths = [0.5] (interpolation = "constant")
        int[] primvars:number = [7, 8, 9, 10] (interpolation = "vertex")
    }
}
"#;

fn baked(points: &str, aovs: &str) -> (std::process::Output, String) {
    baked_on(STAGE, points, aovs)
}

fn baked_on(text: &str, points: &str, aovs: &str) -> (std::process::Output, String) {
    let (folder, path) = stage(text);
    let (cloud, out) = (
        folder.path().join("points.usda"),
        folder.path().join("out.usda"),
    );
    fs::write(&cloud, points).expect("written");
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let args = [
        "bake",
        &text(&path),
        "-o",
        &text(&out),
        "--positions",
        &text(&cloud),
        "--aov",
        aovs,
        "--usd",
        "native",
    ];
    let done = run(&args);
    assert_eq!(done.status.success(), out.exists());
    (done, fs::read_to_string(out).unwrap_or_default())
}

fn numbers(layer: &str, name: &str) -> Vec<f32> {
    let name = format!("{name} = [");
    let values = &layer[layer.find(&name).expect("the primvar") + name.len()..];
    let values = &values[..values.find(']').expect("an end")];
    (values.split([',', '(', ')']))
        .filter_map(|word| word.trim().parse().ok())
        .collect()
}

#[test]
fn points_off_all_surfaces_see_what_closed_forms_say_and_keep_what_they_had() {
    let aovs = "occlusion,irradiance_environment,irradiance_direct,bent_normal,visibility_sh";
    let (done, layer) = baked(POINTS, aovs);
    assert!(done.status.success(), "{}", stderr(&done));
    assert!(
        stderr(&done).contains("1 of its 4 points have no normal"),
        "{}",
        stderr(&done)
    );
    let near = |found: f32, exact: f32, tolerance: f32| {
        assert!((found - exact).abs() <= tolerance, "{found} {exact}");
    };
    for (found, exact) in
        numbers(&layer, "primvars:occlusion")
            .into_iter()
            .zip([1.0 / 9.0, 0.0, 1.0 / 9.0, 0.0])
    {
        near(found, exact, 3e-3);
    }
    let sky = numbers(&layer, "primvars:irradiance_environment");
    for (found, exact) in sky
        .chunks_exact(3)
        .zip([PI * 8.0 / 9.0, PI, PI * 8.0 / 9.0, 0.0])
    {
        near(found[0], exact, 0.01);
    }
    // The sun is behind the ball for the third, whose normal faces it, and beside the others.
    assert!(
        numbers(&layer, "primvars:irradiance_direct")
            .iter()
            .all(|value| *value == 0.0)
    );
    let bent = numbers(&layer, "primvars:bent_normal");
    near(bent[3], 1.0, 2e-3);
    assert_eq!(numbers(&layer, "primvars:visibility_sh0").len(), 4);
    assert_eq!(numbers(&layer, "primvars:number"), [7.0, 8.0, 9.0, 10.0]);
    assert_eq!(numbers(&layer, "point3f[] points").len(), 12);
    let open = POINTS.replace("(0, 0, -3)", "(2, 0, -3)");
    let (_, layer) = baked(&open, "irradiance_direct");
    near(numbers(&layer, "primvars:irradiance_direct")[6], 2.0, 1e-3);
}

/// A colored floor and a ball on it in the sun, and a wall that faces it.
const LIT: &str = r#"#usda 1.0
( metersPerUnit = 1
  upAxis = "Y" )
def Xform "World"
{
    def Mesh "floor"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4)]
        color3f[] primvars:displayColor = [(0.8, 0.5, 0.2)]
    }
    def Mesh "wall"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-4, 0, -4), (4, 0, -4), (4, 4, -4), (-4, 4, -4)]
        color3f[] primvars:displayColor = [(0.2, 0.4, 0.8)]
    }
    def Sphere "ball"
    {
        double radius = 1
        double3 xformOp:translate = (2, 1, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def DistantLight "sun"
    {
        float inputs:intensity = 2
        float inputs:angle = 0
        bool inputs:normalize = 1
        float xformOp:rotateX = -50
        uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }
}
"#;

/// One place, seen above and below its first normal, and along six others.
const TURNED: &str = r#"#usda 1.0
( metersPerUnit = 1
  upAxis = "Y" )
def Points "p"
{
    point3f[] points = [(0, 1.5, 0), (0, 1.5, 0), (0, 1.5, 0), (0, 1.5, 0), (0, 1.5, 0), (0, 1.5, 0), (0, 1.5, 0), (0, 1.5, 0)]
    normal3f[] normals = [(0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0.6, -0.8, 0), (0, -0.6, -0.8)] (interpolation = "vertex")
    float[] widths = [0.1] (interpolation = "constant")
}
"#;

#[test]
fn harmonics_of_reflected_light_light_whatever_is_put_in_their_place() {
    let aovs = "irradiance_indirect,radiance_sh";
    let (done, layer) = baked_on(LIT, TURNED, aovs);
    assert!(done.status.success(), "{}", stderr(&done));
    let coefficients: Vec<Vec<f32>> = (0..9)
        .map(|k| numbers(&layer, &format!("color3f[] primvars:radiance_sh{k}")))
        .collect();
    let normals = numbers(&layer, "normal3f[] normals");
    let light = numbers(&layer, "primvars:irradiance_indirect");
    let brightest = light.iter().copied().fold(0.0, f32::max);
    assert!(brightest > 0.5 && normals.len() == 24, "{light:?}");
    for channel in 0..3 {
        // What comes from above the first normal, and what comes from below it.
        let whole = Sh9(std::array::from_fn(|k| {
            coefficients[k][channel] + coefficients[k][3 + channel]
        }));
        let irradiance = whole.convolved(CLAMPED_COSINE);
        for (normal, light) in normals.chunks_exact(3).zip(light.chunks_exact(3)) {
            let told = irradiance.evaluate(glam::Vec3::from_slice(normal));
            // Nine coefficients of a clamped cosine are off by up to 1/16.
            let off = (told - light[channel]).abs();
            assert!(
                off < 0.04 * brightest,
                "{normal:?}: {told} {}",
                light[channel]
            );
        }
    }
}

#[test]
fn what_points_cannot_have_is_told_before_anything_is_computed() {
    let (done, _) = baked(POINTS, "diffuse_direct");
    assert_eq!(done.status.code(), Some(2));
    assert!(
        stderr(&done).contains("diffuse_direct"),
        "{}",
        stderr(&done)
    );
    let bare = POINTS.replace("normal3f[] normals", "normal3f[] primvars:other");
    let (done, _) = baked(&bare, "occlusion");
    assert_eq!(done.status.code(), Some(1));
    assert!(stderr(&done).contains("normal"), "{}", stderr(&done));
    let (done, _) = baked("#usda 1.0\n", "occlusion");
    assert_eq!(done.status.code(), Some(1), "{}", stderr(&done));
}
