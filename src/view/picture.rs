//! A subject → pixels: a channel seen by a camera, with a scale below.

use super::channels::{Channel, ChannelKind};
use super::colors::{BACKGROUND, Look, false_color};
use super::glyphs;
use super::raster::{NOTHING, Seen, SidesShown, rasterize};
use super::subject::{Shape, Subject};
use crate::receivers::lens::{Frame, Lens};
use crate::scene::Camera;
use crate::writers::image::png_of_rgb;
use glam::Vec3;
use rayon::prelude::*;

/// Samples of a pixel along each axis.
const SAMPLES: usize = 2;

/// Color of labels.
const INK: [u8; 3] = [225, 225, 225];

/// How to look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PictureSettings {
    /// Pixels, without the scale below.
    pub size: (u32, u32),
    /// Ends of false colors; `None` = from the values.
    pub range: Option<(f32, f32)>,
    /// Stops for colors; `None` = from the values.
    pub exposure: Option<f32>,
    /// Disks that face away are drawn too.
    pub both_sides: bool,
}

/// `channel` of `subject` as `camera` sees it, as a PNG in memory. The image is higher than asked for by its scale.
pub fn picture(
    subject: &Subject,
    channel: &Channel,
    camera: &Camera,
    settings: &PictureSettings,
) -> Vec<u8> {
    let (width, height) = (settings.size.0 as usize, settings.size.1 as usize);
    let lens = Lens::new(camera, Frame::new(settings.size.0, settings.size.1));
    let sides = match settings.both_sides {
        true => SidesShown::Both,
        false => SidesShown::Front,
    };
    let fine = (width * SAMPLES, height * SAMPLES);
    let seen = rasterize(subject, &lens, fine, sides);
    let look = Look::new(channel, settings.range, settings.exposure);
    let mut rgb = resolve(&seen, fine, |seen| {
        look.color(value(subject, channel, seen))
    });
    let legend = Legend::new(channel, settings, width);
    rgb.extend(legend.pixels());
    let rows = u32::try_from(rgb.len() / 3 / width.max(1)).unwrap_or(0);
    png_of_rgb(settings.size.0, rows, &rgb)
}

fn value(subject: &Subject, channel: &Channel, seen: &Seen) -> Vec3 {
    let index = seen.index as usize;
    match &subject.shape {
        Shape::Disks(_) => channel.at(index),
        Shape::Triangles(triangles) => {
            let [a, b, c] = triangles[index].map(|i| channel.at(i as usize));
            let (u, v) = (seen.weights.x, seen.weights.y);
            match channel.kind {
                ChannelKind::Id => a,
                ChannelKind::Direction => (a * (1.0 - u - v) + b * u + c * v).normalize_or_zero(),
                ChannelKind::Color | ChannelKind::Scalar => a * (1.0 - u - v) + b * u + c * v,
            }
        }
    }
}

/// Mean color of the samples of each pixel.
fn resolve(
    seen: &[Seen],
    (width, height): (usize, usize),
    color: impl Fn(&Seen) -> [u8; 3] + Sync,
) -> Vec<u8> {
    let row = |y: usize| {
        let pixel = |x: usize| {
            let mut sum = [0_usize; 3];
            for (i, j) in (0..SAMPLES).flat_map(|i| (0..SAMPLES).map(move |j| (i, j))) {
                let seen = &seen[(y * SAMPLES + j) * width + x * SAMPLES + i];
                let color = if seen.index == NOTHING {
                    BACKGROUND
                } else {
                    color(seen)
                };
                for (sum, value) in sum.iter_mut().zip(color) {
                    *sum += usize::from(value);
                }
            }
            let count = SAMPLES * SAMPLES;
            sum.map(|sum| u8::try_from((sum + count / 2) / count).unwrap_or(u8::MAX))
        };
        (0..width / SAMPLES).flat_map(pixel).collect::<Vec<u8>>()
    };
    let rows: Vec<Vec<u8>> = (0..height / SAMPLES).into_par_iter().map(row).collect();
    rows.concat()
}

/// The strip below the picture: what is shown, and what its colors mean.
struct Legend {
    width: usize,
    zoom: usize,
    title: String,
    /// Ends of the false colors.
    scale: Option<(f32, f32)>,
}

impl Legend {
    fn new(channel: &Channel, settings: &PictureSettings, width: usize) -> Self {
        let stops = settings.exposure.unwrap_or_else(|| channel.exposure());
        let title = match channel.kind {
            ChannelKind::Color if stops != 0.0 => format!("{} {stops:+.1} stops", channel.name),
            _ => channel.name.clone(),
        };
        let is_scalar = channel.kind == ChannelKind::Scalar;
        let has_missing = channel.values.iter().any(|value| value.is_nan());
        Self {
            width,
            zoom: (width / 240).clamp(1, 6),
            title: title + if has_missing { " (gray: none)" } else { "" },
            scale: is_scalar.then(|| settings.range.unwrap_or_else(|| channel.scale())),
        }
    }

    fn pixels(&self) -> Vec<u8> {
        let line = glyphs::height(self.zoom);
        let margin = self.margin();
        let title = self.title_lines();
        let top = line + 2 * line * title.len();
        let bar = if self.scale.is_some() { 3 * line } else { 0 };
        let mut strip = Strip {
            rgb: BACKGROUND.repeat(self.width * (top + bar)),
            width: self.width,
        };
        for (k, text) in title.iter().enumerate() {
            strip.text(text, (margin, line + 2 * line * k), self.zoom);
        }
        if let Some((low, high)) = self.scale {
            let (left, right) = (margin, self.width.saturating_sub(margin).max(margin + 1));
            for x in left..right.min(self.width) {
                let at = fraction(x - left, right - left);
                let rows = top - line..top;
                rows.for_each(|y| strip.dot(x, y + line / 2, false_color(at)));
            }
            for (x, label) in self.labels((low, high), (left, right)) {
                strip.text(&label, (x, top + line), self.zoom);
            }
        }
        strip.rgb
    }

    /// Pixels left free at both sides.
    fn margin(&self) -> usize {
        (2 * glyphs::height(self.zoom)).min(self.width / 8)
    }

    /// The title in as many lines as its letters need.
    fn title_lines(&self) -> Vec<String> {
        let room = self.width.saturating_sub(self.margin());
        let mut lines = vec![String::new()];
        for letter in self.title.chars() {
            let last = lines.len() - 1;
            let longer = format!("{}{letter}", lines[last]);
            match glyphs::width(&longer, self.zoom) <= room || lines[last].is_empty() {
                true => lines[last] = longer,
                false => lines.push(letter.to_string().trim_start().to_owned()),
            }
        }
        lines
    }

    /// Where each label begins, and what it says: five, three or two of them, as many as stand apart; else that of the upper
    /// end.
    fn labels(
        &self,
        (low, high): (f32, f32),
        (left, right): (usize, usize),
    ) -> Vec<(usize, String)> {
        let gap = 2 * self.zoom;
        let of = |parts: u8| -> Vec<(usize, String)> {
            let label = |k: u8| {
                let at = f32::from(k) / f32::from(parts);
                let text = number(low + (high - low) * at);
                let width = glyphs::width(&text, self.zoom);
                let tick = left + (right - left) * usize::from(k) / usize::from(parts);
                let most = self.width.saturating_sub(width);
                (tick.saturating_sub(width / 2).min(most), text)
            };
            (0..=parts).map(label).collect()
        };
        let stand_apart = |labels: &[(usize, String)]| {
            labels
                .windows(2)
                .all(|pair| pair[0].0 + glyphs::width(&pair[0].1, self.zoom) + gap <= pair[1].0)
        };
        let mut tried = [4, 2, 1].into_iter().map(of);
        tried
            .find(|labels| stand_apart(labels))
            .unwrap_or_else(|| of(1).split_off(1))
    }
}

#[expect(clippy::cast_precision_loss, reason = "pixels of an image")]
fn fraction(part: usize, whole: usize) -> f32 {
    (part as f32 + 0.5) / whole as f32
}

/// Three digits, with an exponent for what is very large or small.
fn number(value: f32) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".to_owned()
    } else if (1e-3..1e5).contains(&size) {
        let digits = match size {
            size if size >= 100.0 => 0,
            size if size >= 10.0 => 1,
            size if size >= 0.1 => 2,
            _ => 4,
        };
        let text = format!("{value:.digits$}");
        match text.contains('.') {
            true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
            false => text,
        }
    } else {
        format!("{value:.2e}")
    }
}

struct Strip {
    rgb: Vec<u8>,
    width: usize,
}

impl Strip {
    fn dot(&mut self, x: usize, y: usize, color: [u8; 3]) {
        let at = 3 * (y * self.width + x);
        if let Some(pixel) = self.rgb.get_mut(at..at + 3).filter(|_| x < self.width) {
            pixel.copy_from_slice(&color);
        }
    }

    fn text(&mut self, text: &str, (x, y): (usize, usize), zoom: usize) {
        for (dx, dy) in glyphs::dots(text, zoom) {
            self.dot(x + dx, y + dy, INK);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::colors::MISSING;
    use super::*;
    use crate::scene::camera::Projection;
    use glam::{DAffine3, DVec3};

    fn camera(projection: Projection) -> Camera {
        Camera {
            path: String::new(),
            world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 0.0, 10.0)),
            projection,
            // 4 units wide at the subject's distance
            horizontal_aperture: 40.0,
            vertical_aperture: 40.0,
            horizontal_aperture_offset: 0.0,
            vertical_aperture_offset: 0.0,
            focal_length: 100.0,
            clipping_range: (0.1, 100.0),
            exposure: 0.0,
        }
    }

    fn disk(normal: Vec3) -> Subject {
        Subject {
            title: String::new(),
            up: Vec3::Y,
            origin: DVec3::ZERO,
            positions: vec![Vec3::ZERO],
            normals: Some(vec![normal.normalize()]),
            shape: Shape::Disks(vec![1.0]),
            channels: vec![Channel {
                name: "x".to_owned(),
                kind: ChannelKind::Scalar,
                values: vec![1.0],
            }],
            owners: vec![0],
            owner_paths: vec!["/a".to_owned()],
        }
    }

    /// Part of the image that is covered.
    fn coverage(subject: &Subject, projection: Projection) -> f32 {
        let size = (400, 400);
        let lens = Lens::new(&camera(projection), Frame::new(400, 400));
        let seen = rasterize(subject, &lens, size, SidesShown::Front);
        let covered: u16 = seen.iter().filter(|seen| seen.index == 0).map(|_| 1).sum();
        f32::from(covered) / 160_000.0
    }

    #[test]
    fn a_disk_covers_its_projected_area() {
        // 400² pixels see 4 units: π·100² of 160 000 pixels; the edge is a pixel uncertain: 2π·100/160000 · 0.5
        let tolerance = 0.002;
        let whole = std::f32::consts::PI / 16.0;
        for projection in [Projection::Orthographic, Projection::Perspective] {
            let facing = coverage(&disk(Vec3::Z), projection);
            assert!((facing - whole).abs() < tolerance, "{facing}");
        }
        let tilted = coverage(
            &disk(Vec3::new(3.0_f32.sqrt(), 0.0, 1.0)),
            Projection::Orthographic,
        );
        assert!((tilted - 0.5 * whole).abs() < tolerance, "{tilted}");
        assert_eq!(coverage(&disk(Vec3::NEG_Z), Projection::Orthographic), 0.0);
    }

    #[test]
    fn a_triangle_across_the_camera_is_cut_and_not_turned_around() {
        let mut subject = disk(Vec3::Z);
        // the right half of the floor below, from behind the camera to far ahead
        subject.positions = [(-1e3, 1e3), (1e3, 1e3), (0.0, -1e6)]
            .map(|(x, z)| Vec3::new(x, -1.0, z))
            .to_vec();
        subject.shape = Shape::Triangles(vec![[0, 1, 2]]);
        let lens = Lens::new(&camera(Projection::Perspective), Frame::new(64, 64));
        let seen = rasterize(&subject, &lens, (64, 64), SidesShown::Front);
        let covered = |y: usize| {
            seen[y * 64..(y + 1) * 64]
                .iter()
                .all(|seen| seen.index == 0)
        };
        assert!((34..64).all(covered));
        assert!(seen[..32 * 64].iter().all(|seen| seen.index == NOTHING));
    }

    #[test]
    fn labels_have_the_digits_that_matter() {
        let texts = [0.0, 1.0, 0.25, 123.4, 1e-5, 2.5e7, -3.25].map(number);
        assert_eq!(
            texts,
            ["0", "1", "0.25", "123", "1.00e-5", "2.50e7", "-3.25"]
        );
    }

    #[test]
    fn missing_values_are_told_apart_and_the_scale_is_below() {
        let mut subject = disk(Vec3::Z);
        subject.channels[0].values = vec![f32::NAN];
        let settings = PictureSettings {
            size: (64, 64),
            range: Some((0.0, 2.0)),
            exposure: None,
            both_sides: false,
        };
        let camera = camera(Projection::Perspective);
        let png = picture(&subject, &subject.channels[0], &camera, &settings);
        let image = ::image::load_from_memory(&png).unwrap().to_rgb8();
        assert_eq!(image.dimensions(), (64, 64 + 6 * 5));
        assert_eq!(image.get_pixel(32, 32).0, MISSING);
        assert_eq!(image.get_pixel(0, 0).0, BACKGROUND);
        assert_eq!(image.get_pixel(8, 64 + 14).0, false_color(0.5 / 48.0));
    }

    #[test]
    fn labels_are_whole_and_apart_at_any_width() {
        for width in [24, 48, 64, 100, 240, 640, 1920] {
            for scale in [(0.0, 1.0), (-1.2345e-7, 9.8765e-7), (0.125, 1234.5)] {
                let legend = Legend {
                    width,
                    zoom: (width / 240).clamp(1, 6),
                    title: "irradiance_indirect_key (gray: none)".to_owned(),
                    scale: Some(scale),
                };
                let margin = legend.margin();
                let labels = legend.labels(scale, (margin, width - margin));
                let mut free = 0;
                for (x, text) in &labels {
                    let end = x + glyphs::width(text, legend.zoom);
                    let is_alone = labels.len() == 1;
                    assert!(
                        *x >= free && (end <= width || is_alone),
                        "{width} {labels:?}"
                    );
                    free = end + 1;
                }
                assert!(width < 64 || labels.len() > 1, "{width} {labels:?}");
                let lines = legend.title_lines();
                let fits = |line: &String| margin + glyphs::width(line, legend.zoom) <= width;
                assert!(lines.iter().all(fits), "{width} {lines:?}");
                let letters = |text: &str| text.replace(' ', "");
                assert_eq!(letters(&lines.concat()), letters(&legend.title));
            }
        }
    }
}
