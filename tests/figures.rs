//! The figures of the paper, small: what must be true of them whatever they look like.

#[allow(dead_code, reason = "every test file uses some of the helpers")]
#[path = "support/program.rs"]
mod program;

use program::{json, run, stderr};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Pixels across and down.
const SIZE: usize = 48;

/// Channels of an image by name, row after row.
type Channels = BTreeMap<String, Vec<f32>>;

/// Renders `scene` of the examples.
fn figure(scene: &str, flags: &str) -> Channels {
    let folder = tempfile::tempdir().expect("a folder");
    let image = folder.path().join("figure.exr");
    let stage = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("examples")
        .join(format!("{scene}.usda"));
    let size = SIZE.to_string();
    let mut args = vec!["render", stage.to_str().expect("UTF-8")];
    args.extend(["-o", image.to_str().expect("UTF-8"), "--usd", "native"]);
    args.extend(["--image-width", &size, "--tolerance", "0.02"]);
    args.extend(flags.split(' '));
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
    channels(&image)
}

/// All channels of a file.
fn channels(image: &Path) -> Channels {
    let read = exr::prelude::read_all_flat_layers_from_file(image).expect("a readable EXR");
    let channels = read
        .layer_data
        .iter()
        .flat_map(|layer| &layer.channel_data.list);
    channels
        .map(|channel| {
            let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
            assert!(values.iter().all(|value| value.is_finite()));
            (channel.name.to_string(), values)
        })
        .collect()
}

/// Mean of the columns and rows (parts of the image) of a channel.
fn mean(channel: &[f32], columns: [f32; 2], rows: [f32; 2]) -> f32 {
    let inside = |i: usize, [low, high]: [f32; 2]| {
        let place = (i as f32 + 0.5) / SIZE as f32;
        low < place && place < high
    };
    let pixels = (0..SIZE * SIZE).filter(|i| inside(i % SIZE, columns) && inside(i / SIZE, rows));
    let values: Vec<f32> = pixels.map(|i| channel[i]).collect();
    values.iter().sum::<f32>() / values.len() as f32
}

const ALL: [f32; 2] = [0.0, 1.0];

#[test]
fn every_reflection_adds_less_light_than_the_one_before() {
    let of = |bounces: u32| {
        let image = figure("teapots", &format!("--aov color --bounces {bounces}"));
        mean(&image["G"], ALL, [0.3, 1.0])
    };
    let [none, one, two, three] = [0, 1, 2, 3].map(of);
    assert!(none > 0.05, "{none}");
    let added = [one - none, two - one, three - two];
    assert!(
        added[0] > added[1] && added[1] > added[2] && added[2] > 0.0,
        "{added:?}"
    );
    // No surface reflects more than three quarters.
    assert!(
        added[1] < 0.75 * added[0] && added[2] < 0.75 * added[1],
        "{added:?}"
    );
}

#[test]
fn colored_walls_bleed_onto_what_is_next_to_them() {
    let image = figure("teapots", "--aov irradiance_indirect");
    let floor = |channel: &str, columns| {
        mean(
            &image[&format!("irradiance_indirect.{channel}")],
            columns,
            [0.88, 0.96],
        )
    };
    let (left, right) = ([0.08, 0.3], [0.7, 0.92]);
    let ratio = |columns| floor("R", columns) / floor("B", columns);
    assert!(
        ratio(left) > 1.1 * ratio(right),
        "{} {}",
        ratio(left),
        ratio(right)
    );
}

#[test]
fn area_lights_are_seen_and_shine_in_their_colors() {
    let image = figure("teapots_lights", "--aov color,irradiance_direct");
    // The ball, warm, is in the picture with its radiance; so is the panel, which is a mesh.
    let ball = [[0.25, 0.30], [0.27, 0.32]];
    assert!(mean(&image["R"], ball[0], ball[1]) > 10.0);
    let panel = [[0.46, 0.54], [0.43, 0.45]];
    assert!((mean(&image["G"], panel[0], panel[1]) - 4.0).abs() < 0.2);
    let direct = |channel: &str, columns| {
        mean(
            &image[&format!("irradiance_direct.{channel}")],
            columns,
            [0.25, 0.6],
        )
    };
    let warmth = |columns| direct("R", columns) / direct("B", columns);
    assert!(warmth([0.03, 0.15]) > 1.5 * warmth([0.85, 0.97]));
}

#[test]
fn an_even_sky_lights_what_it_sees() {
    let image = figure("teapots_sky", "--aov irradiance_environment,visibility");
    for (channel, radiance) in [("R", 0.75), ("G", 0.87), ("B", 1.0)] {
        let light = &image[&format!("irradiance_environment.{channel}")];
        for (light, open) in light.iter().zip(&image["visibility.Y"]) {
            let exact = std::f32::consts::PI * radiance * open;
            assert!(
                (light - exact).abs() < 0.01 * exact.max(0.1),
                "{light} {exact}"
            );
        }
    }
    // In the shade between the floor and a pot less is open than in the open.
    let row = [0.9, 1.0];
    assert!(mean(&image["visibility.Y"], ALL, row) > 0.97);
    assert!(
        image["visibility.Y"]
            .iter()
            .any(|&open| open > 0.0 && open < 0.6)
    );
}

#[test]
fn reflections_are_covered_where_the_mirror_shows_a_wall() {
    let image = figure("teapots", "--aov occlusion,reflection_occlusion");
    let (all, mirror) = (&image["occlusion.Y"], &image["reflection_occlusion.Y"]);
    // The side walls mirror the back wall, its middle the open front.
    assert!(mean(mirror, [0.04, 0.12], [0.4, 0.6]) > 0.97);
    assert!(mean(mirror, [0.45, 0.55], [0.45, 0.55]) < 0.3);
    // Corners are darker than the middle of a wall.
    let open = |columns, rows| 1.0 - mean(all, columns, rows);
    assert!(open([0.2, 0.25], [0.2, 0.25]) < 0.9 * open([0.45, 0.55], [0.3, 0.4]));
}

/// One bounce under the sky, 512 pixels wide: receivers, how many of them were gathered at, and the values.
fn bounce_under_the_sky(flags: &[&str]) -> (u64, u64, Vec<f32>) {
    let folder = tempfile::tempdir().expect("a folder");
    let image = folder.path().join("sky.exr");
    let stage = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("examples/teapots_sky.usda");
    let mut args = vec!["render", stage.to_str().expect("UTF-8")];
    args.extend(["-o", image.to_str().expect("UTF-8"), "--usd", "native"]);
    args.extend(["--aov", "irradiance_indirect", "--image-width", "512"]);
    args.extend(["--pixel-samples", "1", "--json"]);
    args.extend(flags);
    let told = json(&run(&args));
    let count = |name: &str| told["counts"][name].as_u64().expect("a count");
    let green = channels(&image)
        .into_iter()
        .find(|(name, _)| name.ends_with('G'));
    let (_, values) = green.expect("a color");
    (count("receivers"), count("gathered"), values)
}

#[test]
fn pixels_of_a_curved_lip_under_the_sky_speak_for_each_other_and_none_is_far_off() {
    let (receivers, gathered, found) = bounce_under_the_sky(&["--tolerance", "0.05"]);
    assert!(4 * gathered < receivers, "{gathered} of {receivers}");
    let (_, _, truth) = bounce_under_the_sky(&["--gather", "rays", "--interpolate", "never"]);
    let lit = truth
        .iter()
        .filter(|value| value.is_finite() && **value > 0.0);
    let mean = lit.clone().sum::<f32>() / lit.count() as f32;
    let off = (found.iter().zip(&truth)).filter(|(a, b)| (**a - **b).abs() > mean);
    let count = off.count();
    assert!(count < 20, "{count} pixels are off by more than {mean}");
}
