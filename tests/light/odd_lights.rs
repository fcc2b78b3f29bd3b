//! Lights where nobody should put them and of any brightness: results are finite and what closed forms say.

use crate::program::{run, stage, stderr};
use std::fs;

/// A white floor 2 wide at the origin, facing up, and `more`.
fn scene(more: &str) -> String {
    crate::floors::floor(1.0, 0.8, more)
}

/// A square of half edge `half` around (`x`, `y`, 0), level, seen and shining from below: an image, or a constant.
fn panel(name: &str, (x, y, half): (f32, f32, f32), emission: &str) -> String {
    let corner = |sx: f32, sz: f32| format!("({}, {y}, {})", x + sx * half, sz * half);
    let corners =
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(sx, sz)| corner(sx, sz));
    format!(
        r#"def Mesh "{name}" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        point3f[] points = [{}]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = "none"
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        rel material:binding = </World/{name}/Glow>
        def Material "Glow"
        {{
            token outputs:surface.connect = </World/{name}/Glow/surface.outputs:surface>
            def Shader "surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor = (0, 0, 0)
                color3f inputs:emissiveColor{emission}
                token outputs:surface
            }}
            def Shader "tex"
            {{
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @./glow.exr@
                token inputs:wrapS = "clamp"
                token inputs:wrapT = "clamp"
                float2 inputs:st.connect = </World/{name}/Glow/st.outputs:result>
                float3 outputs:rgb
            }}
            def Shader "st"
            {{
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname = "st"
                float2 outputs:result
            }}
        }}
    }}"#,
        corners.join(", ")
    )
}

/// Red of `aov` at the floor's points, all of whose numbers are finite, and what was said; `glow` is the image at hand.
fn baked(
    text: &str,
    aov: &str,
    glow: Option<&(dyn Fn(usize, usize) -> f32 + Sync)>,
) -> (Vec<f32>, String) {
    let (folder, path) = stage(text);
    if let Some(glow) = glow {
        let file = folder.path().join("glow.exr");
        exr::prelude::write_rgb_file(file, 16, 16, |x, y| (glow(x, y), glow(x, y), glow(x, y)))
            .expect("written");
    }
    let out = folder.path().join("out.usda");
    let args = [
        "bake",
        path.to_str().expect("UTF-8"),
        "-o",
        out.to_str().expect("UTF-8"),
        "--aov",
        aov,
        "--surfels",
        "2000",
        "--usd",
        "native",
    ];
    let done = run(&args);
    assert!(done.status.success(), "{}", stderr(&done));
    let layer = fs::read_to_string(out).expect("a layer");
    assert!(!layer.contains("nan") && !layer.contains("inf,"), "{layer}");
    let over = &layer[layer.find("\"floor\"").expect("the floor")..];
    let name = format!("primvars:{aov} = [");
    let values = &over[over.find(&name).expect("the primvar") + name.len()..];
    let values = &values[..values.find(']').expect("an end")];
    let numbers: Vec<f32> = (values.split([',', '(', ')']))
        .filter_map(|word| word.trim().parse().ok())
        .collect();
    assert!(
        numbers.iter().all(|number| number.is_finite()),
        "{numbers:?}"
    );
    (numbers.iter().copied().step_by(3).collect(), stderr(&done))
}

const BALL: &str = "def Sphere \"ball\" { double radius = 0.5\ndouble3 xformOp:translate = (0, 2, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"] }";

fn lamp(intensity: &str, height: f32) -> String {
    format!(
        "def SphereLight \"lamp\" {{ float inputs:intensity = {intensity}\nfloat inputs:radius = 0.1\ndouble3 xformOp:translate = (0, {height}, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"] }}"
    )
}

#[test]
fn a_lamp_inside_a_ball_lights_nothing_outside_and_one_that_sticks_out_some_of_it() {
    let inside = scene(&format!("{BALL}\n{}", lamp("1000", 2.0)));
    for aov in ["irradiance_direct", "irradiance_indirect"] {
        assert_eq!(baked(&inside, aov, None).0, [0.0; 4], "{aov}");
    }
    // Its lower half is out of the ball: the points of the floor see that, and some of the rest.
    let out = scene(&format!("{BALL}\n{}", lamp("1000", 1.5)));
    let free = scene(&lamp("1000", 1.5));
    for (out, free) in (baked(&out, "irradiance_direct", None).0.iter())
        .zip(baked(&free, "irradiance_direct", None).0)
    {
        let share = out / free;
        assert!(0.5 < share && share < 0.99, "{out} {free}");
    }
}

#[test]
fn a_lamp_that_sits_on_a_surface_or_around_a_point_gives_finite_light() {
    for height in [0.0, 0.05, 1e-6] {
        let (values, _) = baked(&scene(&lamp("10", height)), "irradiance", None);
        assert!(values.iter().all(|value| *value >= 0.0), "{values:?}");
    }
    // Lamps shine outwards: within one it is dark.
    let around = "def SphereLight \"lamp\" { float inputs:intensity = 3\nfloat inputs:radius = 5 }";
    assert_eq!(baked(&scene(around), "irradiance_direct", None).0, [0.0; 4]);
}

/// The bright panel is seen from nowhere on the floor, then by all of it: the dim one must be found in either case.
#[test]
fn what_is_a_million_times_as_bright_hides_nothing_of_what_is_dim() {
    let dim = panel("dim", (0.0, 1.0, 0.5), " = (1, 1, 1)");
    let bright = |y: f32| panel("bright", (0.0, y, 0.5), " = (1000000, 1000000, 1000000)");
    let of = |more: &str| baked(&scene(more), "irradiance_direct", None).0;
    let alone = of(&dim);
    assert!(alone.iter().all(|value| *value > 0.05), "{alone:?}");
    // Behind the dim panel and as wide: all of its rays meet that one.
    for (found, exact) in of(&format!("{dim}\n{}", bright(1.0001))).iter().zip(&alone) {
        assert!((found / exact - 1.0).abs() < 2e-3, "{found} {exact}");
    }
    let beside = panel("bright", (3.0, 1.0, 0.5), " = (1000000, 1000000, 1000000)");
    let (both, lone) = (of(&format!("{dim}\n{beside}")), of(&beside));
    for ((both, lone), dim) in both.iter().zip(&lone).zip(&alone) {
        assert!(
            (both / (lone + dim) - 1.0).abs() < 2e-3,
            "{both} {lone} {dim}"
        );
    }
    // Lamps: a thousand dim ones beside a bright one add what they are worth.
    let lamps: String = (0..10)
        .map(|i| lamp("0.1", 1.0).replace("\"lamp\"", &format!("\"lamp{i}\"")))
        .collect::<Vec<_>>()
        .join("\n");
    let ten = of(&lamps);
    for (ten, one) in ten.iter().zip(of(&lamp("1", 1.0))) {
        assert!((ten / one - 1.0).abs() < 1e-3, "{ten} {one}");
    }
}

#[test]
fn texels_that_are_no_numbers_are_black_and_warned_of() {
    let shining = scene(&panel(
        "glow",
        (0.0, 1.0, 1.0),
        ".connect = </World/glow/Glow/tex.outputs:rgb>",
    ));
    let whole = baked(&shining, "irradiance_direct", Some(&|_, _| 2.0)).0;
    let holed = |x: usize, y: usize| match (x, y) {
        (3, 4) => f32::NAN,
        (9, 9) => f32::INFINITY,
        _ => 2.0,
    };
    let (broken, said) = baked(&shining, "irradiance_direct", Some(&holed));
    assert!(
        said.contains("not finite") && said.contains("glow.exr"),
        "{said}"
    );
    for (broken, whole) in broken.iter().zip(&whole) {
        // 2 of 256 texels, whichever side of the panel is nearest.
        assert!(
            broken <= whole && *broken > 0.95 * whole,
            "{broken} {whole}"
        );
    }
    let lamp = r#"def RectLight "lamp" { float inputs:intensity = 1
float inputs:width = 2
float inputs:height = 2
asset inputs:texture:file = @./glow.exr@
double3 xformOp:translate = (0, 1, 0)
float xformOp:rotateX = -90
uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"] }"#;
    let (_, said) = baked(&scene(lamp), "irradiance_direct", Some(&holed));
    assert!(said.contains("not finite"), "{said}");
}
