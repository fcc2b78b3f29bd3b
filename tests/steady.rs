//! Two frames of a camera that moves a little: what a fixed point of a surface gets does not change by more than the
//! tolerance allows. Engines look along directions that are fixed in the world, whatever the camera does.

#[allow(dead_code, reason = "every test file uses some of the helpers")]
#[path = "support/program.rs"]
mod program;

use glam::{Vec2, Vec3};
use program::{json, run};
use std::collections::HashMap;
use std::path::Path;

const WIDTH: usize = 160;

const TOLERANCE: f64 = 0.02;

/// Where the example's camera stands at frames 1 and 2: one hundredth of its distance apart.
const PLACES: [Vec3; 2] = [Vec3::new(0.0, 1.0, 4.7), Vec3::new(0.045, 1.015, 4.69)];

/// Focal length over half an aperture.
const ZOOM: f32 = 3.5;

fn stage() -> String {
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/room.usda");
    let [a, b] = PLACES.map(|p| format!("({}, {}, {})", p.x, p.y, p.z));
    format!(
        "#usda 1.0\n(\n    subLayers = [@{}@]\n    defaultPrim = \"Room\"\n    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\
         over \"Room\"\n{{\n    over \"cam\"\n    {{\n        double3 xformOp:translate.timeSamples = {{ 1: {a}, 2: {b} }}\n    }}\n}}\n",
        room.display()
    )
}

/// What one frame saw, by pixel.
struct Frame {
    position: Vec<Vec3>,
    visibility: Vec<f32>,
    prim: Vec<f32>,
}

impl Frame {
    fn read(path: &Path) -> Self {
        let image = exr::prelude::read_all_flat_layers_from_file(path).expect("a readable EXR");
        let mut channels = HashMap::new();
        for layer in &image.layer_data {
            for channel in &layer.channel_data.list {
                let prefix = (layer.attributes.layer_name.as_ref())
                    .map_or(String::new(), |name| format!("{name}."));
                let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
                assert_eq!(values.len(), WIDTH * WIDTH);
                channels.insert(format!("{prefix}{}", channel.name), values);
            }
        }
        let find = |ends: &str| {
            let found = channels.iter().find(|(name, _)| name.ends_with(ends));
            found
                .unwrap_or_else(|| panic!("no {ends} in {:?}", channels.keys()))
                .1
                .clone()
        };
        let [x, y, z] = ["P.X", "P.Y", "P.Z"].map(find);
        Self {
            position: (0..x.len()).map(|i| Vec3::new(x[i], y[i], z[i])).collect(),
            visibility: find("visibility.Y"),
            prim: find("primId.id"),
        }
    }

    /// Position and visibility between the four pixels around `at`, if these show one prim.
    fn between(&self, at: Vec2) -> Option<(Vec3, f32)> {
        let (corner, part) = (at.floor(), at - at.floor());
        let last = (WIDTH - 2) as f32;
        if corner.min_element() < 0.0 || corner.max_element() > last {
            return None;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within the image"
        )]
        let [column, row] = [corner.x as usize, corner.y as usize];
        let first = row * WIDTH + column;
        let pixels = [first, first + 1, first + WIDTH, first + WIDTH + 1];
        let weights = [
            (1.0 - part.x) * (1.0 - part.y),
            part.x * (1.0 - part.y),
            (1.0 - part.x) * part.y,
            part.x * part.y,
        ];
        let is_one = pixels.iter().all(|&i| self.prim[i] == self.prim[first]);
        let sum = pixels.iter().zip(weights);
        let sum = sum.fold((Vec3::ZERO, 0.0), |sum, (&i, weight)| {
            (
                sum.0 + self.position[i] * weight,
                sum.1 + self.visibility[i] * weight,
            )
        });
        is_one.then_some(sum)
    }
}

/// Pixel of the second frame that shows `point`.
fn pixel_of(point: Vec3) -> Vec2 {
    let way = point - PLACES[1];
    let on_screen = Vec2::new(way.x, -way.y) * (ZOOM / -way.z);
    (on_screen * 0.5 + 0.5) * WIDTH as f32 - 0.5
}

/// Change of visibility at each point of the first frame that the second one sees as well, and the visibility.
fn changes([first, second]: &[Frame; 2]) -> Vec<Option<(f64, f64)>> {
    let pixel = 2.0 * PLACES[0].z / (ZOOM * WIDTH as f32);
    let of = |i: usize| {
        if first.prim[i] < 0.0 {
            return None;
        }
        let (position, visibility) = second.between(pixel_of(first.position[i]))?;
        let is_same = position.distance(first.position[i]) < 0.2 * pixel;
        let [now, then] = [visibility, first.visibility[i]].map(f64::from);
        is_same.then_some((now - then, then))
    };
    (0..first.position.len()).map(of).collect()
}

/// Both frames, gathered with `flags`.
fn frames(stage: &Path, flags: &[&str]) -> [Frame; 2] {
    let folder = stage.parent().expect("a folder");
    let pattern = folder.join("frame.#.exr");
    let [stage, pattern] = [stage, &pattern].map(|path| path.to_str().expect("UTF-8"));
    let width = WIDTH.to_string();
    let mut args = vec!["render", stage, "-o", pattern, "--image-width", &width];
    let fixed = "--usd native --frames 1:2 --aov visibility,P,primId --camera /Room/cam --json";
    args.extend(fixed.split(' ').chain(flags.iter().copied()));
    json(&run(&args));
    [1, 2].map(|n| Frame::read(&folder.join(format!("frame.{n}.exr"))))
}

#[test]
fn a_fixed_point_keeps_its_value_when_the_camera_moves() {
    let (_folder, stage) = program::stage(&stage());
    // What pixels themselves change by, since they are not where they were: 2 % of the mean, at corners above all.
    let truth = changes(&frames(&stage, &["--gather", "rays", "--rays", "2048"]));
    for engine in ["auto", "rays", "maps"] {
        let flags = ["--gather", engine, "--tolerance", "0.02"];
        let found = changes(&frames(&stage, &flags));
        let both = found.iter().zip(&truth);
        let both: Vec<_> = both.filter_map(|(a, b)| Some(((*a)?, (*b)?))).collect();
        let count = both.len() as f64;
        assert!(both.len() > WIDTH * WIDTH / 3, "{engine}: {count} points");
        let mean = both.iter().map(|(_, truth)| truth.1).sum::<f64>() / count;
        let excess = |(a, b): &((f64, f64), (f64, f64))| (a.0 - b.0).powi(2);
        let rms = (both.iter().map(excess).sum::<f64>() / count).sqrt();
        assert!(rms <= TOLERANCE * mean, "{engine}: {rms} of {mean}");
    }
}

/// As many surfels as the tolerance needs are looked for at the first frame.
#[test]
fn frames_of_a_still_scene_are_the_same_to_the_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let pattern = folder.path().join("frame.#.exr");
    let args = "render examples/room.usda --usd native --frames 1:2 --aov irradiance_indirect --tolerance 0.02 --image-width 128";
    let mut args: Vec<&str> = args.split(' ').collect();
    args.extend(["--json", "-o", pattern.to_str().expect("UTF-8")]);
    json(&run(&args));
    let [one, two] = [1, 2].map(|n| {
        let path = folder.path().join(format!("frame.{n}.exr"));
        let image = exr::prelude::read_all_flat_layers_from_file(path).expect("a readable EXR");
        let channels = image.layer_data.iter();
        let channels = channels.flat_map(|layer| layer.channel_data.list.iter());
        let bits =
            channels.flat_map(|channel| channel.sample_data.values_as_f32().map(f32::to_bits));
        bits.collect::<Vec<u32>>()
    });
    assert!(one.len() >= 3 * 128 * 128 && one == two);
}
