//! A subject → one page that needs nothing else: its data as text, drawn with WebGL2 by `page.js`.
//!
//! Positions are 16 bits an axis over the bounds (1.5e-5 of the size), directions 8 bits, radii and values half
//! precision (3 digits) with a power of two of each channel's own in front (−65504 = none), ids single precision.

use super::channels::{self, Channel, ChannelKind};
use super::colors::SCALE;
use super::subject::{Shape, Subject};
use crate::scene::Camera;
use crate::writers::base64;
use crate::writers::page::document;
use glam::Vec3;
use half::f16;
use maud::{PreEscaped, html};
use serde_json::{Value, json};

const STYLE: &str = include_str!("page.css");
const PROGRAM: &str = include_str!("page.js");

/// Values up to this stay as they are; half precision ends at 65504.
const LARGEST_HALF: f32 = 32_768.0;

/// The page as HTML; it opens with `first` in view, beside light without reflections where there are both, through
/// `camera` if one was asked for. `made` tells what made it: it is shown at the title.
pub fn page(subject: &Subject, first: &str, camera: Option<&Camera>, made: &str) -> String {
    let mut data = Data::default();
    let about = about(subject, &mut data, first, camera);
    // a script ends at the first "</", wherever it stands
    let about = about.to_string().replace('<', "\\u003c");
    let body = html! {
        canvas id="canvas" {}
        div id="panel" {
            b title=(made) { (subject.title) }
            span id="counts" {}
            label { "shown " select id="left" {} }
            label { "beside " select id="right" {} }
            label { "stops " input id="stops" type="range" min="-10" max="10" step="0.1"; }
            label { "size " input id="size" type="range" min="0.25" max="3" step="0.05" value="1"; }
            label { input id="back" type="checkbox"; " back faces" }
            button id="home" { "whole" }
        }
        div id="scales" {}
        pre id="values" { "drag: orbit · shift or right button: move · wheel: zoom · click: values" }
        script id="about" type="application/json" { (PreEscaped(about)) }
        script id="data" type="text/plain" { (PreEscaped(base64(&data.bytes))) }
        script { (PreEscaped(PROGRAM)) }
    };
    document(&format!("surflux view: {}", subject.title), STYLE, &body)
}

/// Everything but the arrays: where these are in `data`, and how to look.
fn about(subject: &Subject, data: &mut Data, first: &str, camera: Option<&Camera>) -> Value {
    let bounds = subject.bounds();
    let (low, size) = match bounds.is_empty() {
        true => (Vec3::ZERO, Vec3::ZERO),
        false => (bounds.min, bounds.max - bounds.min),
    };
    let positions = data.positions(&subject.positions, (low, size));
    let normals = subject
        .normals
        .as_ref()
        .map(|normals| data.directions(normals));
    let (radii, triangles) = match &subject.shape {
        Shape::Disks(radii) => (Some(data.halves(radii)), None),
        Shape::Triangles(triangles) => (None, Some(data.indices(triangles))),
    };
    let channels: Vec<Value> = subject
        .channels
        .iter()
        .map(|channel| data.channel(channel))
        .collect();
    let pair = channels::with_and_without(&subject.channels);
    let (left, right) = match pair {
        Some((with, without)) if first == with => (with, Some(without)),
        _ => (first, None),
    };
    let scale: Vec<[f32; 3]> = SCALE.map(|c| c.map(|c| f32::from(c) / 255.0)).to_vec();
    json!({
        "title": subject.title,
        "count": subject.len(),
        "origin": subject.origin.to_array(),
        "up": subject.up.to_array(),
        "low": low.to_array(),
        "size": size.to_array(),
        "positions": positions,
        "normals": normals,
        "radii": radii,
        "triangles": triangles,
        "owners": data.owners(&subject.owners),
        "ownerPaths": subject.owner_paths,
        "channels": channels,
        "scale": scale,
        "left": left,
        "right": right,
        "camera": camera.map(|camera| self::camera(camera, subject)),
    })
}

/// Place, axes and the tangent of half the vertical angle.
fn camera(camera: &Camera, subject: &Subject) -> Value {
    let matrix = camera.world_from_camera.matrix3;
    let place = camera.world_from_camera.translation - subject.origin;
    json!({
        "place": place.to_array(),
        "right": matrix.x_axis.normalize_or_zero().to_array(),
        "up": matrix.y_axis.normalize_or_zero().to_array(),
        "back": matrix.z_axis.normalize_or_zero().to_array(),
        "slope": 0.5 * camera.vertical_aperture / camera.focal_length.max(1e-6),
    })
}

/// Arrays one after the other, each beginning at a multiple of four bytes.
#[derive(Debug, Default)]
struct Data {
    bytes: Vec<u8>,
}

impl Data {
    /// Where the next array begins.
    fn begin(&mut self) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.bytes.len()
    }

    /// Three parts of 65535 of the bounds, and two bytes of nothing.
    fn positions(&mut self, positions: &[Vec3], (low, size): (Vec3, Vec3)) -> usize {
        let start = self.begin();
        let inverse = size.map(|size| if size > 0.0 { size.recip() } else { 0.0 });
        for position in positions {
            let part = (*position - low) * inverse;
            for part in part.extend(0.0).to_array() {
                self.bytes.extend(sixteen_bits(part).to_le_bytes());
            }
        }
        start
    }

    /// Three parts of 127, and a byte of nothing.
    fn directions(&mut self, directions: &[Vec3]) -> usize {
        let start = self.begin();
        for direction in directions {
            let part = direction.extend(0.0).to_array().map(eight_bits);
            self.bytes.extend(part.map(|part| part.to_le_bytes()[0]));
        }
        start
    }

    fn halves(&mut self, values: &[f32]) -> Value {
        let start = self.begin();
        let finite = values
            .iter()
            .map(|value| value.abs())
            .filter(|size| size.is_finite());
        let scale = power_of_two(finite.fold(0.0, f32::max));
        for value in values {
            let value = if value.is_nan() {
                f16::MIN
            } else {
                f16::from_f32(value / scale)
            };
            self.bytes.extend(value.to_le_bytes());
        }
        json!({ "at": start, "scale": scale })
    }

    fn indices(&mut self, triangles: &[[u32; 3]]) -> Value {
        let start = self.begin();
        for index in triangles.iter().flatten() {
            self.bytes.extend(index.to_le_bytes());
        }
        json!({ "at": start, "count": 3 * triangles.len() })
    }

    /// Where owners begin: the first element of each run and its owner.
    fn owners(&mut self, owners: &[u32]) -> Vec<[usize; 2]> {
        let mut runs: Vec<[usize; 2]> = Vec::new();
        for (i, &owner) in owners.iter().enumerate() {
            let owner = owner as usize;
            if runs.last().is_none_or(|run| run[1] != owner) {
                runs.push([i, owner]);
            }
        }
        runs
    }

    fn channel(&mut self, channel: &Channel) -> Value {
        let is_id = channel.kind == ChannelKind::Id;
        let place = match is_id {
            true => {
                let start = self.begin();
                let bytes = channel.values.iter().flat_map(|id| id.to_le_bytes());
                self.bytes.extend(bytes);
                json!({ "at": start, "scale": 1.0 })
            }
            false => self.halves(&channel.values),
        };
        let (low, high) = channel.scale();
        json!({
            "name": channel.name,
            "kind": channel.kind.word(),
            "components": channel.kind.components(),
            "at": place["at"],
            "scale": place["scale"],
            "range": [low, high],
            "stops": channel.exposure(),
        })
    }
}

/// What brings values up to `largest` into half precision; small ones too, whose digits it would lose.
fn power_of_two(largest: f32) -> f32 {
    if largest > 0.0 && largest.is_finite() {
        (largest / LARGEST_HALF)
            .log2()
            .ceil()
            .clamp(-100.0, 100.0)
            .exp2()
    } else {
        1.0
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 0…65535"
)]
fn sixteen_bits(part: f32) -> u16 {
    (part.clamp(0.0, 1.0) * 65_535.0).round() as u16
}

#[expect(clippy::cast_possible_truncation, reason = "clamped to −127…127")]
fn eight_bits(part: f32) -> i8 {
    (part.clamp(-1.0, 1.0) * 127.0).round() as i8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_any_size_keep_three_digits() {
        for largest in [1e-20_f32, 1.0, 1e6, 1e30] {
            let mut data = Data::default();
            let place = data.halves(&[largest, 0.37 * largest]);
            let scale = place["scale"].as_f64().unwrap();
            let read = |at: usize| {
                let bits = [data.bytes[at], data.bytes[at + 1]];
                f64::from(f16::from_le_bytes(bits)) * scale
            };
            for (at, value) in [(0, largest), (2, 0.37 * largest)] {
                // half precision has 11 bits
                assert!(
                    (read(at) / f64::from(value) - 1.0).abs() < 5e-4,
                    "{largest}"
                );
            }
        }
    }

    #[test]
    fn names_cannot_end_the_script() {
        let subject = Subject {
            title: "</script><b>".to_owned(),
            up: Vec3::Y,
            origin: glam::DVec3::ZERO,
            positions: Vec::new(),
            normals: None,
            shape: Shape::Disks(Vec::new()),
            channels: Vec::new(),
            owners: Vec::new(),
            owner_paths: vec!["/a</script>".to_owned()],
        };
        let page = page(&subject, "", None, "surflux 1");
        assert_eq!(page.matches("</script>").count(), 3);
        assert!(!page.contains("<b><"));
    }
}
