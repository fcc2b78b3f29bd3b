//! One AOV → PNG, to look at: sRGB with a plain exposure, no look.
//!
//! Colors are scaled so that the 95th percentile of the brightest component of pixels that are not black becomes white, then
//! encoded as sRGB and clipped; values are never brightened more than 2^10 times. Fractions (`occlusion`,
//! `visibility`) are grays as they are, encoded too; depth runs from white (near) to black (far); directions are
//! `0.5 n + 0.5` without encoding, positions 0…1 over their bounds; ids get distinct colors. Of harmonics the first
//! coefficient is shown, white where all is open.

use super::{Error, write_whole};
use crate::math::srgb;
use crate::results::resolve::FAR_DEPTH;
use crate::results::{Aov, AovImage, ValueType};
use ::image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::path::Path;

/// Share of pixel values that are not clipped: a lamp in view may take the rest.
const WHITE_PERCENTILE: f32 = 0.95;

/// Darker images stay dark: it is noise that would be shown.
const MOST_EXPOSURE: f32 = 1024.0;

/// Coefficient (0,0) of a function that is 1 over a hemisphere: 2π · √(1/4π).
const OPEN_HARMONIC: f32 = 1.772_453_9;

/// Write `image` as an 8-bit PNG `path`, under a temporary name first.
///
/// # Errors
/// If it has no pixels or the file cannot be written; nothing is left behind then.
pub fn write_png(path: &Path, image: &AovImage) -> Result<(), Error> {
    let color = match image.aov.value_type() {
        ValueType::Float | ValueType::Harmonics => ExtendedColorType::L8,
        _ => ExtendedColorType::Rgb8,
    };
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&pixels(image), image.width, image.height, color)
        .map_err(|source| Error::Png {
            path: path.to_owned(),
            source,
        })?;
    write_whole(path, &bytes)
}

/// 8-bit sRGB pixels, rows from the top, as a PNG in memory; empty if `rgb` is not `width · height · 3` bytes.
pub fn png_of_rgb(width: u32, height: u32, rgb: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    if rgb.len() != width as usize * height as usize * 3 {
        return bytes;
    }
    let encoder = PngEncoder::new(&mut bytes);
    match encoder.write_image(rgb, width, height, ExtendedColorType::Rgb8) {
        Ok(()) => bytes,
        Err(_) => Vec::new(),
    }
}

/// 8 bits a channel.
fn pixels(image: &AovImage) -> Vec<u8> {
    match (image.aov, image.aov.value_type()) {
        (Aov::Depth, _) => depth(&image.data),
        (_, ValueType::Float) => image.data.iter().map(|value| srgb::code(*value)).collect(),
        (_, ValueType::Color | ValueType::ColorAlpha) => colors(image),
        (_, ValueType::Normal) => image
            .data
            .iter()
            .map(|x| srgb::byte(0.5 * x + 0.5))
            .collect(),
        (_, ValueType::Point) => positions(&image.data),
        (_, ValueType::Harmonics) => {
            let open = image.data.iter().step_by(image.aov.components());
            open.map(|value| srgb::code(value / OPEN_HARMONIC))
                .collect()
        }
        (_, ValueType::Id) => image.data.iter().flat_map(|id| id_color(*id)).collect(),
    }
}

/// Exposed and encoded, over black: color is premultiplied, and a sky shines where nothing covers.
fn colors(image: &AovImage) -> Vec<u8> {
    let components = image.aov.components();
    let exposure = exposure(&image.data, components);
    let encode = |pixel: &[f32]| [0, 1, 2].map(|channel| srgb::code(pixel[channel] * exposure));
    image
        .data
        .chunks_exact(components)
        .flat_map(encode)
        .collect()
}

/// What brings the percentile to 1.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "an index of a list, rounded"
)]
fn exposure(data: &[f32], components: usize) -> f32 {
    let brightest = |pixel: &[f32]| pixel[..3].iter().copied().fold(0.0, f32::max);
    let mut values: Vec<f32> = data
        .chunks_exact(components)
        .map(brightest)
        .filter(|value| *value > 0.0)
        .collect();
    if values.is_empty() {
        return 1.0;
    }
    let index = ((values.len() - 1) as f32 * WHITE_PERCENTILE).round() as usize;
    let (_, white, _) = values.select_nth_unstable_by(index, f32::total_cmp);
    (1.0 / *white).min(MOST_EXPOSURE)
}

/// Lowest and highest of some values; 0 and 1 for none.
fn range(values: impl Iterator<Item = f32>) -> (f32, f32) {
    let (low, high) = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

/// 0…1 within a range; 0 in an empty one.
fn within((low, high): (f32, f32), value: f32) -> f32 {
    if high > low {
        (value - low) / (high - low)
    } else {
        0.0
    }
}

/// Near is white; the background is black.
fn depth(data: &[f32]) -> Vec<u8> {
    let seen = range(data.iter().copied().filter(|depth| *depth < FAR_DEPTH));
    // The farthest surface stays apart from the background.
    data.iter()
        .map(|d| {
            if *d < FAR_DEPTH {
                srgb::byte(1.0 - 0.9 * within(seen, *d))
            } else {
                0
            }
        })
        .collect()
}

fn positions(data: &[f32]) -> Vec<u8> {
    let axis = |axis: usize| range(data.iter().copied().skip(axis).step_by(3));
    let ranges = [axis(0), axis(1), axis(2)];
    data.iter()
        .enumerate()
        .map(|(i, x)| srgb::byte(within(ranges[i % 3], *x)))
        .collect()
}

/// Hues in steps of the golden angle: neighbors differ; black for none.
fn id_color(id: f32) -> [u8; 3] {
    if id < 0.0 {
        return [0; 3];
    }
    srgb::of_id(id)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(aov: Aov, data: &[f32]) -> AovImage {
        let width = u32::try_from(data.len() / aov.components()).unwrap();
        AovImage {
            aov,
            group: None,
            width,
            height: 1,
            data: data.to_vec(),
        }
    }

    #[test]
    fn bright_pixels_are_white_and_edges_are_over_black() {
        let mut data = [2.0, 1.0, 0.0, 1.0].repeat(200);
        data.extend([1.0, 0.5, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1e6, 1e6, 1e6, 1.0]);
        let pixels = pixels(&image(Aov::Color, &data));
        assert_eq!(pixels[..3], [255, 188, 0]);
        assert_eq!(pixels[600..609], [188, 137, 0, 0, 0, 0, 255, 255, 255]);
    }

    #[test]
    fn data_is_shown_as_documented() {
        assert_eq!(
            pixels(&image(Aov::Normal, &[0.0, 0.0, 1.0])),
            [128, 128, 255]
        );
        assert_eq!(pixels(&image(Aov::Occlusion, &[0.0, 1.0])), [0, 255]);
        assert_eq!(
            pixels(&image(Aov::Depth, &[1.0, 3.0, FAR_DEPTH])),
            [255, 26, 0]
        );
        assert_eq!(
            pixels(&image(Aov::Position, &[0.0, 5.0, 1.0, 2.0, 5.0, 0.0])),
            [0, 0, 255, 255, 0, 0]
        );
        let ids = pixels(&image(Aov::PrimId, &[-1.0, 0.0, 1.0]));
        assert_eq!(ids[..3], [0, 0, 0]);
        assert!(ids[3..6] != ids[6..9]);
        assert_eq!(pixels(&image(Aov::Irradiance, &[0.0; 3])), [0, 0, 0]);
    }

    #[test]
    fn a_written_file_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("n.png");
        write_png(&path, &image(Aov::Normal, &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0])).unwrap();
        let read = ::image::open(&path).unwrap().to_rgb8();
        assert_eq!(read.dimensions(), (2, 1));
        assert_eq!(read.into_raw(), [128, 128, 255, 255, 128, 128]);
    }
}
