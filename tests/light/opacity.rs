//! Surfaces that let light through: cut-outs and partial opacity of UsdPreviewSurface, end to end, against closed forms.

use crate::program::{json, run, stage, stderr};
use glam::{Vec3, Vec4};
use std::f32::consts::PI;
use std::fs;
use std::path::Path;

/// Half the edge of what stands for an endless plane.
const FAR: f32 = 1e4;

/// A floor 1 wide at the origin, facing up, its points at (±0.5, 0, ±0.5), and `more`.
fn scene(more: &str) -> String {
    crate::floors::floor(0.5, 0.0, more)
}

/// A level card at `height` of half edge `half` that faces down, with material inputs; its st are 0…1 across it.
fn card(name: &str, height: f32, half: f32, inputs: &str) -> String {
    format!(
        r#"def Mesh "{name}" (prepend apiSchemas = ["MaterialBindingAPI"])
    {{
        point3f[] points = [(-{half}, {height}, -{half}), ({half}, {height}, -{half}), ({half}, {height}, {half}), (-{half}, {height}, {half})]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = "none"
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        float[] primvars:veil = [0, 1, 1, 0] (interpolation = "vertex")
        rel material:binding = </World/{name}/Look>
        def Material "Look"
        {{
            token outputs:surface.connect = </World/{name}/Look/surface.outputs:surface>
            def Shader "surface"
            {{
                uniform token info:id = "UsdPreviewSurface"
                {inputs}
                token outputs:surface
            }}
            def Shader "tex"
            {{
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @./mask.png@
                token inputs:wrapS = "repeat"
                token inputs:wrapT = "repeat"
                token inputs:sourceColorSpace = "raw"
                float2 inputs:st.connect = </World/{name}/Look/st.outputs:result>
                float outputs:r
            }}
            def Shader "st"
            {{
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname = "st"
                float2 outputs:result
            }}
            def Shader "veil"
            {{
                uniform token info:id = "UsdPrimvarReader_float"
                string inputs:varname = "veil"
                float outputs:result
            }}
        }}
    }}"#
    )
}

/// What connects the opacity of card `name` to its image, cut at one half.
fn cut_out(name: &str) -> String {
    format!(
        "float inputs:opacity.connect = </World/{name}/Look/tex.outputs:r>\nfloat inputs:opacityThreshold = 0.5"
    )
}

/// Light 1 per area straight down, or up.
fn sun(up: bool) -> String {
    let turn = if up { 90 } else { -90 };
    format!(
        "def DistantLight \"sun\" {{ float inputs:intensity = 1\nfloat inputs:angle = 0\nbool inputs:normalize = 1\nfloat xformOp:rotateX = {turn}\nuniform token[] xformOpOrder = [\"xformOp:rotateX\"] }}"
    )
}

const SKY: &str = "def DomeLight \"sky\" { float inputs:intensity = 1 }";

/// Values of `aovs` at the floor's points, a list each.
fn baked(
    text: &str,
    mask: Option<&image::GrayImage>,
    aovs: &str,
    flags: &[&str],
) -> Vec<Vec<Vec3>> {
    let (folder, path) = stage(text);
    if let Some(mask) = mask {
        mask.save(folder.path().join("mask.png")).expect("written");
    }
    let layer = bake(folder.path(), &path, aovs, flags);
    aovs.split(',').map(|aov| values(&layer, aov)).collect()
}

/// The layer that baking `aovs` at the stage `path` results in.
pub(crate) fn bake(folder: &Path, path: &Path, aovs: &str, flags: &[&str]) -> String {
    let out = folder.join("out.usda");
    let mut args = vec!["bake", path.to_str().expect("UTF-8"), "--usd", "native"];
    args.extend(["-o", out.to_str().expect("UTF-8"), "--aov", aovs]);
    args.extend(flags);
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
    fs::read_to_string(out).expect("a layer")
}

/// Values of `aov` at the floor's four points; single numbers are gray.
fn values(layer: &str, aov: &str) -> Vec<Vec3> {
    values_of("floor", layer, aov)
}

/// The same at those of the square `mesh`.
pub(crate) fn values_of(mesh: &str, layer: &str, aov: &str) -> Vec<Vec3> {
    let over = &layer[layer.find(&format!("\"{mesh}\"")).expect("the mesh")..];
    let name = format!("primvars:{aov} = [");
    let values = &over[over.find(&name).expect("the primvar") + name.len()..];
    let values = &values[..values.find(']').expect("an end")];
    let numbers: Vec<f32> = (values.split([',', '(', ')']))
        .filter_map(|word| word.trim().parse().ok())
        .collect();
    let of = |numbers: &[f32]| match numbers {
        [one] => Vec3::splat(*one),
        _ => Vec3::from_slice(numbers),
    };
    numbers.chunks_exact(numbers.len() / 4).map(of).collect()
}

fn assert_all(found: &[Vec3], exact: f32, tolerance: f32, what: &str) {
    for value in found {
        let off = (*value - exact).abs().max_element();
        assert!(off <= tolerance, "{what}: {value} should be {exact}");
    }
}

/// Squares of `cell` texels, black and white in turn.
fn checker(size: u32, cell: u32) -> image::GrayImage {
    image::GrayImage::from_fn(size, size, |x, y| {
        image::Luma([if (x / cell + y / cell).is_multiple_of(2) {
            255
        } else {
            0
        }])
    })
}

#[test]
fn what_is_half_open_lets_half_of_the_sky_through_everywhere_and_two_of_them_less() {
    let half = card("half", 1.0, FAR, "float inputs:opacity = 0.5");
    let less = card("less", 2.0, FAR, "float inputs:opacity = 0.4");
    let aovs = "occlusion,visibility,irradiance_environment,reflection_occlusion";
    for (more, open) in [(half.clone(), 0.5), (format!("{half}\n{less}"), 0.3)] {
        let found = baked(&scene(&format!("{more}\n{SKY}")), None, aovs, &[]);
        assert_all(&found[0], 1.0 - open, 1e-4, "occlusion");
        assert_all(&found[1], open, 1e-4, "visibility");
        assert_all(&found[2], PI * open, 1e-3, "environment");
        assert_all(&found[3], 1.0 - open, 1e-4, "reflection occlusion");
    }
}

#[test]
fn few_rays_an_image_of_the_sky_and_a_tolerance_see_through_as_well() {
    let half = card("half", 1.0, FAR, "float inputs:opacity = 0.5");
    let text = scene(&format!("{half}\n{SKY}"));
    for flags in [
        &["--rays", "16"][..],
        &["--tolerance", "0.02"],
        &["--gather", "maps"],
    ] {
        let found = baked(&text, None, "visibility", flags);
        assert_all(&found[0], 0.5, 1e-4, "visibility");
    }
    // An importance sampled sky: black but for one texel.
    let (folder, path) = stage(&scene(&format!(
        "{half}\ndef DomeLight \"sky\" {{ float inputs:intensity = 1\nasset inputs:texture:file = @./sky.exr@ }}"
    )));
    let lit = |x: usize, y: usize| if (x, y) == (20, 4) { 1000.0_f32 } else { 0.0 };
    exr::prelude::write_rgb_file(folder.path().join("sky.exr"), 64, 32, |x, y| {
        (lit(x, y), lit(x, y), lit(x, y))
    })
    .expect("written");
    let through = values(
        &bake(folder.path(), &path, "irradiance_environment", &[]),
        "irradiance_environment",
    );
    let opened = fs::read_to_string(&path)
        .expect("text")
        .replace("opacity = 0.5", "opacity = 0");
    fs::write(&path, opened).expect("written");
    let open = values(
        &bake(folder.path(), &path, "irradiance_environment", &[]),
        "irradiance_environment",
    );
    assert!(open[0].x > 0.1, "{}", open[0]);
    for (through, open) in through.iter().zip(open) {
        assert!(
            through.abs_diff_eq(0.5 * open, 1e-3 * open.x),
            "{through} {open}"
        );
    }
}

#[test]
fn shadows_are_as_deep_as_opacity_says_be_it_a_number_a_primvar_or_an_image() {
    let of = |inputs: &str, mask: Option<&image::GrayImage>| {
        let text = scene(&format!(
            "{}\n{}",
            card("card", 1.0, 1.0, inputs),
            sun(false)
        ));
        baked(&text, mask, "irradiance_direct", &[]).remove(0)
    };
    let open = of("float inputs:opacity = 0", None)[0].x;
    assert!((open - 1.0).abs() < 1e-3, "{open}");
    assert_all(
        &of("float inputs:opacity = 0.3", None),
        0.7,
        1e-3,
        "a number",
    );
    // Below the threshold nothing is there, above it all.
    let cut = |opacity: &str| {
        of(
            &format!("float inputs:opacity = {opacity}\nfloat inputs:opacityThreshold = 0.4"),
            None,
        )
    };
    assert_all(&cut("0.3"), 1.0, 1e-3, "below the threshold");
    assert_all(&cut("0.5"), 0.0, 0.0, "above the threshold");
    // The floor's points lie below x = ∓0.5 and are lit a little inside of it: st 0.25 and 0.75, where the primvar is the
    // same.
    let veiled = of(
        "float inputs:opacity.connect = </World/card/Look/veil.outputs:result>",
        None,
    );
    for (value, exact) in veiled.iter().zip([0.75, 0.25, 0.25, 0.75]) {
        assert!((value.x - exact).abs() < 6e-3, "{value} {exact}");
    }
    // Two by two cells: the floor's points lie below the middles of cells. Texture rows run from the top, t upwards.
    let cut = of(&cut_out("card"), Some(&checker(64, 32)));
    // points: (-, +), (+, +), (+, -), (-, -); t grows with z.
    for (value, exact) in cut.iter().zip([0.0, 1.0, 0.0, 1.0]) {
        assert!((value.x - exact).abs() < 1e-3, "{cut:?}");
    }
    let ramp = image::GrayImage::from_fn(256, 1, |x, _| {
        image::Luma([u8::try_from(x).expect("a byte")])
    });
    let partial = of(
        "float inputs:opacity.connect = </World/card/Look/tex.outputs:r>",
        Some(&ramp),
    );
    for (value, exact) in partial.iter().zip([0.75, 0.25, 0.25, 0.75]) {
        assert!((value.x - exact).abs() < 6e-3, "{value} {exact}");
    }
}

#[test]
fn a_checker_of_holes_opens_half_of_the_sky() {
    let checkered = card("card", 1.0, FAR, &cut_out("card"));
    // Cells 0.2 wide: 100 000 to the card, so st are scaled in the primvar.
    let scaled = checkered.replace(
        "[(0, 0), (1, 0), (1, 1), (0, 1)]",
        "[(0, 0), (50000, 0), (50000, 50000), (0, 50000)]",
    );
    let text = scene(&format!("{scaled}\n{SKY}"));
    let mask = checker(64, 32);
    let found = baked(
        &text,
        Some(&mask),
        "visibility,irradiance_environment",
        &["--rays", "16384"],
    );
    assert_all(&found[0], 0.5, 0.01, "visibility");
    assert_all(&found[1], 0.5 * PI, 0.01 * PI, "environment");
}

#[test]
fn emission_comes_from_what_there_is_and_through_what_there_is_not() {
    let glow = |opacity: &str| {
        format!(
            "color3f inputs:diffuseColor = (0, 0, 0)\ncolor3f inputs:emissiveColor = (2, 2, 2)\n{opacity}"
        )
    };
    let ceiling = card(
        "ceiling",
        2.0,
        FAR,
        "color3f inputs:diffuseColor = (0, 0, 0)\ncolor3f inputs:emissiveColor = (3, 3, 3)",
    );
    let veil = card("veil", 1.0, FAR, &glow("float inputs:opacity = 0.5"));
    let alone = baked(&scene(&veil), None, "irradiance_direct", &[]).remove(0);
    assert_all(&alone, PI, 0.01 * PI, "a veil");
    let both = baked(
        &scene(&format!("{veil}\n{ceiling}")),
        None,
        "irradiance_direct",
        &[],
    )
    .remove(0);
    assert_all(&both, 2.5 * PI, 0.02 * PI, "a veil before a ceiling");
    // Half of it cut out.
    let text = scene(&card("veil", 1.0, 2.0, &glow(&cut_out("veil"))));
    let cut = baked(&text, Some(&checker(64, 4)), "irradiance_direct", &[]).remove(0);
    let whole = baked(
        &scene(&card("veil", 1.0, 2.0, &glow(""))),
        None,
        "irradiance_direct",
        &[],
    )
    .remove(0);
    for (cut, whole) in cut.iter().zip(whole) {
        assert!((cut.x / whole.x - 0.5).abs() < 0.03, "{cut} {whole}");
    }
}

/// Light from below falls on a veil, and what passes on a ceiling; the floor sees both.
#[test]
fn reflected_light_comes_from_veils_and_what_is_behind_them() {
    let surface = |albedo: f32, opacity: &str| {
        format!("color3f inputs:diffuseColor = ({albedo}, {albedo}, {albedo})\n{opacity}")
    };
    let ceiling = card("ceiling", 20.0, FAR, &surface(0.6, ""));
    let exact = 0.5 * 0.8 + 0.5 * 0.6 * 0.5;
    let veil = card(
        "veil",
        10.0,
        FAR,
        &surface(0.8, "float inputs:opacity = 0.5"),
    );
    let text = scene(&format!("{veil}\n{ceiling}\n{}", sun(true)));
    for flags in [&[][..], &["--rays", "16"]] {
        let found = baked(&text, None, "irradiance_indirect,occlusion", flags);
        assert_all(&found[0], exact, 0.01 * exact, "a veil");
        assert_all(&found[1], 1.0, 1e-4, "covered");
    }
}

#[test]
fn cut_surfels_have_the_area_of_what_is_left_of_them() {
    let half = card(
        "card",
        1.0,
        1.0,
        &format!(
            "color3f inputs:diffuseColor = (0.8, 0.8, 0.8)\n{}",
            cut_out("card")
        ),
    );
    let (folder, path) = stage(&scene(&format!("{half}\n{}", sun(true))));
    checker(64, 4)
        .save(folder.path().join("mask.png"))
        .expect("written");
    let out = folder.path().join("cloud.ply");
    let cloud = folder.path().join("cloud.usdc");
    let (cloud, out) = (cloud.to_str().expect("UTF-8"), out.to_str().expect("UTF-8"));
    let done = run(&[
        "points",
        path.to_str().expect("UTF-8"),
        "-o",
        cloud,
        "--surfels",
        "4000",
        "--usd",
        "native",
    ]);
    assert!(done.status.success(), "{}", stderr(&done));
    let done = run(&["convert", cloud, out, "--ascii"]);
    assert!(done.status.success(), "{}", stderr(&done));
    let text = fs::read_to_string(out).expect("text");
    let (header, rows) = text.split_once("end_header\n").expect("a header");
    let names: Vec<&str> = header
        .lines()
        .filter_map(|line| line.strip_prefix("property ")?.split(' ').nth(1))
        .collect();
    let column = |name: &str| names.iter().position(|other| *other == name).expect(name);
    let rows: Vec<Vec<f32>> = rows
        .lines()
        .map(|row| row.split(' ').filter_map(|x| x.parse().ok()).collect())
        .collect();
    let sum = |of: &dyn Fn(&[f32]) -> f32| {
        rows.iter()
            .filter(|row| row[column("y")] > 0.5 && row[column("ny")] < 0.0)
            .map(|row| of(row))
            .sum::<f32>()
    };
    let area = sum(&|row| row[column("area")]);
    assert!((area - 2.0).abs() < 0.02, "{area}");
    let power = sum(&|row| row[column("area")] * row[column("radiosity_r")]);
    // The floor shades a quarter of it.
    assert!((power - 1.2).abs() < 0.03, "{power}");
}

#[test]
fn cameras_see_layers_in_their_shares_and_the_sky_behind_them() {
    let glow = |color: &str, opacity: &str| {
        format!(
            "color3f inputs:diffuseColor = (0, 0, 0)\nint inputs:useSpecularWorkflow = 1\ncolor3f inputs:emissiveColor = {color}\n{opacity}"
        )
    };
    let front = card(
        "front",
        1.0,
        5.0,
        &glow("(2, 0, 0)", "float inputs:opacity = 0.25"),
    );
    let back = card("back", 2.0, 5.0, &glow("(0, 3, 0)", ""));
    let camera = "def Camera \"cam\" { double3 xformOp:translate = (0, -3, 0)\nfloat xformOp:rotateX = 90\nuniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:rotateX\"]\nfloat horizontalAperture = 1\nfloat verticalAperture = 1\nfloat focalLength = 20 }";
    let sky = "def DomeLight \"sky\" { color3f inputs:color = (0, 0, 1) }";
    for (more, exact) in [
        (format!("{front}\n{back}"), Vec4::new(0.5, 2.25, 0.0, 1.0)),
        (front.clone(), Vec4::new(0.5, 0.0, 0.0, 0.25)),
        (format!("{front}\n{sky}"), Vec4::new(0.5, 0.0, 0.75, 0.25)),
    ] {
        let text = scene(&format!("{more}\n{camera}"))
            .replace("def Mesh \"floor\"", "def Mesh \"floor\" (active = false)");
        let (folder, path) = stage(&text);
        let out = folder.path().join("out.exr");
        let args = [
            "render",
            path.to_str().expect("UTF-8"),
            "-o",
            out.to_str().expect("UTF-8"),
            "--aov",
            "color",
            "--image-width",
            "4",
            "--usd",
            "native",
            "--camera",
            "/World/cam",
        ];
        let done = run(&args);
        assert!(done.status.success(), "{}", stderr(&done));
        let image = exr::prelude::read_first_rgba_layer_from_file(
            &out,
            |size, _| vec![vec![Vec4::ZERO; size.width()]; size.height()],
            |pixels: &mut Vec<Vec<Vec4>>, at, (r, g, b, a): (f32, f32, f32, f32)| {
                pixels[at.y()][at.x()] = Vec4::new(r, g, b, a);
            },
        )
        .expect("an image");
        for pixel in image.layer_data.channel_data.pixels.iter().flatten() {
            assert!(pixel.abs_diff_eq(exact, 2e-3), "{pixel} {exact}");
        }
    }
}

#[test]
fn an_occlusion_bake_decodes_images_of_opacity_alone_and_only_where_it_can_be_below_one() {
    let color = "color3f inputs:diffuseColor.connect = </World/card/Look/tex.outputs:rgb>";
    let count = |inputs: &str| {
        let (folder, path) = stage(&scene(&card("card", 1.0, 1.0, inputs)));
        checker(8, 4)
            .save(folder.path().join("mask.png"))
            .expect("written");
        let out = folder.path().join("out.usda");
        let args = [
            "bake",
            path.to_str().expect("UTF-8"),
            "-o",
            out.to_str().expect("UTF-8"),
            "--aov",
            "occlusion",
            "--usd",
            "native",
            "--json",
        ];
        json(&run(&args))["read"]["textures"]
            .as_u64()
            .expect("a number")
    };
    assert_eq!(count(color), 0);
    assert_eq!(
        count(&format!(
            "{color}\nfloat inputs:opacity = 1\nfloat inputs:opacityThreshold = 0.5"
        )),
        0
    );
    assert_eq!(count(&format!("{color}\nfloat inputs:opacity = 0.5")), 0);
    assert_eq!(count(&cut_out("card")), 1);
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let cut = card("cut", 1.0, 2.0, &cut_out("cut"));
    let veil = card("veil", 1.5, 2.0, "float inputs:opacity = 0.3");
    let (folder, path) = stage(&scene(&format!("{cut}\n{veil}\n{SKY}\n{}", sun(false))));
    checker(64, 4)
        .save(folder.path().join("mask.png"))
        .expect("written");
    let aovs = "occlusion,irradiance_direct,irradiance_environment,irradiance_indirect";
    let of = |threads: &str| {
        bake(
            folder.path(),
            &path,
            aovs,
            &["--threads", threads, "--surfels", "2000"],
        )
    };
    let strip = |text: String| {
        text.lines()
            .filter(|line| !line.contains("--threads"))
            .collect::<Vec<_>>()
            .join("\n")
    };
    assert_eq!(strip(of("1")), strip(of("4")));
}
