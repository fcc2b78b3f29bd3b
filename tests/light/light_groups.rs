//! Light of groups of sources, end to end: parts are what each source does alone, and their sum is the whole.

use crate::program::{ROOM, run, stage, stderr};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// The box under a ball, a disk and a glowing panel, and a sky that looks in; a collection of the disk and the sky.
const GROUPED: &str = r#"#usda 1.0
(
    defaultPrim = "Box"
    metersPerUnit = 1
    upAxis = "Y"
    subLayers = [@EXAMPLES/teapots_lights.usda@]
)
over "Box" (
    prepend apiSchemas = ["CollectionAPI:cold"]
)
{
    rel collection:cold:includes = [</Box/disk>, </Box/sky>]
    def DomeLight "sky" { float inputs:intensity = 0.2 }
}
"#;

fn grouped() -> (tempfile::TempDir, String) {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let (folder, path) = stage(&GROUPED.replace("EXAMPLES", examples.to_str().expect("UTF-8")));
    (folder, path.to_str().expect("UTF-8").to_owned())
}

/// Colors that a bake of the floor and one teapot of `stage` wrote, by primvar, all meshes after each other.
fn baked(stage: &str, flags: &[&str]) -> BTreeMap<String, Vec<f32>> {
    baked_by(stage, &["--rays", "32", "--surfels", "5000"], flags)
}

/// The same by other means than few rays and surfels.
fn baked_by(stage: &str, means: &[&str], flags: &[&str]) -> BTreeMap<String, Vec<f32>> {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out.usda");
    let mut args = vec!["bake", stage, "-o", out.to_str().expect("UTF-8")];
    args.extend(["--usd", "native"]);
    args.extend(means);
    args.extend(["--bounces", "2", "--view", "0,-1,-1"]);
    args.extend(flags);
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
    let layer = fs::read_to_string(out).expect("a layer");
    let mut all: BTreeMap<String, Vec<f32>> = BTreeMap::new();
    for line in layer.lines() {
        let Some((declaration, values)) = line.split_once(" = [") else {
            continue;
        };
        let Some((_, name)) = declaration.split_once("primvars:") else {
            continue;
        };
        let numbers = values.split(['(', ')', ',', ']', ' ']);
        let numbers = numbers.filter_map(|word| word.parse::<f32>().ok());
        all.entry(name.to_owned()).or_default().extend(numbers);
    }
    all
}

const GROUPS: [&str; 3] = ["--light-groups=cold", "--light-groups", "warm=/Box/ball"];

#[test]
fn at_points_the_parts_add_up_to_the_whole() {
    let (_folder, stage) = grouped();
    let aovs = "irradiance,irradiance_indirect,irradiance_environment,diffuse_direct,specular_indirect,color,occlusion";
    let all = baked(&stage, &[&GROUPS[..], &["--aov", aovs]].concat());
    assert!(!all.contains_key("occlusion_cold"));
    for aov in aovs.split(',').filter(|&aov| aov != "occlusion") {
        let whole = &all[aov];
        let parts = ["cold", "warm", "default"].map(|group| &all[&format!("{aov}_{group}")]);
        assert!(whole.len() >= 60 && whole.iter().any(|&x| x > 0.0), "{aov}");
        for (i, &whole) in whole.iter().enumerate() {
            if aov == "color" && i % 4 == 3 {
                continue;
            }
            let sum: f32 = parts.iter().map(|part| part[i]).sum();
            assert!(
                (sum - whole).abs() <= 1e-5 * whole.abs(),
                "{aov} {i}: {sum} {whole}"
            );
        }
    }
}

/// A pilot measures for the whole; its parts are gathered with what it found.
#[test]
fn with_a_tolerance_the_parts_add_up_and_the_whole_keeps_it() {
    let (_folder, stage) = grouped();
    let aovs = ["--aov", "irradiance_direct,irradiance_indirect"];
    let groups = ["--light-groups", "cold", "--light-groups", "warm=/Box/ball"];
    let found = baked_by(
        &stage,
        &["--tolerance", "0.05"],
        &[&aovs[..], &groups].concat(),
    );
    let exact = baked_by(&stage, &["--rays", "2048", "--surfels", "50000"], &aovs);
    for aov in ["irradiance_direct", "irradiance_indirect"] {
        let whole = &found[aov];
        let parts = ["cold", "warm", "default"].map(|part| &found[&format!("{aov}_{part}")]);
        let most = whole
            .iter()
            .fold(0.0_f32, |most, value| most.max(value.abs()));
        for (i, value) in whole.iter().enumerate() {
            let sum: f32 = parts.iter().map(|part| part[i]).sum();
            assert!((sum - value).abs() <= 1e-5 * most, "{aov}: {sum} {value}");
        }
        let square = |x: f32| f64::from(x).powi(2);
        let off: f64 = whole
            .iter()
            .zip(&exact[aov])
            .map(|(a, b)| square(a - b))
            .sum();
        let mean: f64 = exact[aov].iter().map(|value| f64::from(*value)).sum();
        let count = whole.len() as f64;
        let relative = (off / count).sqrt() / (mean / count);
        assert!(relative < 0.06, "{aov}: {relative}");
    }
}

#[test]
fn a_part_is_what_its_sources_do_alone_and_the_sum_what_all_do() {
    let (folder, stage) = grouped();
    let aovs = ["--aov", "irradiance_direct,irradiance_indirect"];
    let all = baked(&stage, &[&GROUPS[..], &aovs].concat());
    let without = |names: &[&str]| {
        let over: String = (names.iter())
            .map(|name| format!("over \"{name}\" (active = false) {{}}\n"))
            .collect();
        let layer = folder.path().join("session.usda");
        fs::write(&layer, format!("#usda 1.0\nover \"Box\" {{\n{over}}}\n")).expect("writable");
        baked(
            &stage,
            &[
                &["--session-layer", layer.to_str().expect("UTF-8")],
                &aovs[..],
            ]
            .concat(),
        )
    };
    // The panel is geometry: left in the scene it shades, taken out it does not. It is the group of the rest.
    let others: [(&str, &[&str]); 1] = [("default", &["ball", "disk", "sky"])];
    for (group, names) in others {
        let alone = without(names);
        for aov in ["irradiance_direct", "irradiance_indirect"] {
            assert_eq!(all[&format!("{aov}_{group}")], alone[aov], "{aov}_{group}");
        }
    }
    let whole = baked(&stage, &aovs);
    for aov in ["irradiance_direct", "irradiance_indirect"] {
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let squared: Vec<f32> = (all[aov].iter().zip(&whole[aov]))
            .map(|(sum, whole)| (sum - whole).powi(2))
            .collect();
        // The same scene with other places on panels and other directions to the sky.
        let error = mean(&squared).sqrt() / mean(&whole[aov]);
        assert!(error < 0.02, "{aov}: {error}");
    }
}

#[test]
fn in_pixels_the_parts_add_up_to_the_whole_lights_and_sky_included() {
    let (folder, stage) = grouped();
    let out = folder.path().join("out.exr");
    let mut args = vec!["render", &stage, "-o", out.to_str().expect("UTF-8")];
    args.extend(["--usd", "native", "--rays", "16", "--surfels", "5000"]);
    args.extend([
        "--bounces",
        "2",
        "--image-width",
        "40",
        "--aov",
        "color,irradiance_indirect",
    ]);
    args.extend(GROUPS);
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
    let read = exr::prelude::read_all_flat_layers_from_file(&out).expect("a readable EXR");
    let channels: BTreeMap<String, Vec<f32>> = (read.layer_data.iter())
        .flat_map(|layer| &layer.channel_data.list)
        .map(|channel| {
            (
                channel.name.to_string(),
                channel.sample_data.values_as_f32().collect(),
            )
        })
        .collect();
    for (whole, part) in [
        ("G", "color"),
        ("irradiance_indirect.G", "irradiance_indirect"),
    ] {
        let parts =
            ["cold", "warm", "default"].map(|group| &channels[&format!("{part}_{group}.G")]);
        for (i, &whole) in channels[whole].iter().enumerate() {
            let sum: f32 = parts.iter().map(|part| part[i]).sum();
            // Each is rounded to half a unit in the last of eleven bits.
            assert!(
                (sum - whole).abs() <= 1e-3 * whole + 1e-6,
                "{part} {i}: {sum} {whole}"
            );
        }
    }
    assert!(
        channels["color_cold.A"]
            .iter()
            .all(|&a| (0.0..=1.0).contains(&a))
    );
}

#[test]
fn clouds_are_told_apart_by_their_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let (one, two) = (path("key.usdc"), path("fill light.usdc"));
    for (cloud, lamp) in [(&one, "1"), (&two, "0.5")] {
        let result = run(&[
            "points",
            ROOM,
            "-o",
            cloud,
            "--usd",
            "native",
            "--surfels",
            "3000",
            "--dome",
            lamp,
        ]);
        assert!(result.status.success(), "{}", stderr(&result));
    }
    let aov = ["--aov", "irradiance_indirect"];
    let split = ["--cloud", &one, "--sources", &two, "--split-clouds"];
    let all = baked(ROOM, &[&split[..], &aov].concat());
    let alone = baked(ROOM, &[&["--cloud", &two][..], &aov].concat());
    let out = path("out.usda");
    let grouped = ["bake", ROOM, "-o", &out, "--usd", "native", "--cloud", &one];
    let refused = run(&[&grouped[..], &aov, &["--light-groups", "a=/Room"]].concat());
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        stderr(&refused).contains("key.usdc"),
        "{}",
        stderr(&refused)
    );
    assert_eq!(
        all["irradiance_indirect_fill_light"],
        alone["irradiance_indirect"]
    );
    for (i, whole) in all["irradiance_indirect"].iter().enumerate() {
        let sum = all["irradiance_indirect_key"][i] + all["irradiance_indirect_fill_light"][i];
        assert!((sum - whole).abs() <= 1e-5 * whole, "{i}: {sum} {whole}");
    }
}

#[test]
fn a_group_without_sources_is_black_and_warned_of_and_names_must_be_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out.usda");
    let bake = |group: &str| {
        let out = out.to_str().expect("UTF-8");
        run(&[
            "bake",
            ROOM,
            "-o",
            out,
            "--usd",
            "native",
            "--rays",
            "16",
            "--aov",
            "irradiance_direct",
            "--light-groups",
            group,
        ])
    };
    let result = bake("none=/nowhere");
    assert!(result.status.success(), "{}", stderr(&result));
    assert!(stderr(&result).contains("none"), "{}", stderr(&result));
    let layer = fs::read_to_string(&out).expect("a layer");
    assert!(
        layer.contains("irradiance_direct_none") && layer.contains("irradiance_direct_default")
    );
    assert_eq!(bake("a b=/x").status.code(), Some(2));
}
