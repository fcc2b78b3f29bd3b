//! One AOV → PNG, to look at: sRGB with a plain exposure, no look.
//!
//! Colors are scaled so that the 95th percentile of the brightest component of pixels that are not black becomes white, then
//! encoded as sRGB and clipped; values are never brightened more than 2^10 times. Fractions (`occlusion`,
//! `visibility`) are grays as they are, encoded too; depth runs from white (near) to black (far); directions are
//! `0.5 n + 0.5` without encoding, positions 0…1 over their bounds; ids get distinct colors. Of harmonics the first
//! coefficient is shown, white where all is open.

use super::png_text::annotated;
use super::{Error, write_whole};
use crate::math::srgb;
use crate::results::resolve::FAR_DEPTH;
use crate::results::{Aov, AovImage, ValueType};
use ::image::{ExtendedColorType, ImageEncoder, RgbImage, codecs::png::PngEncoder};
use std::path::Path;

/// Share of pixel values that are not clipped: a lamp in view may take the rest.
const WHITE_PERCENTILE: f32 = 0.95;

/// Darker images stay dark: it is noise that would be shown.
const MOST_EXPOSURE: f32 = 1024.0;

/// Coefficient (0,0) of a function that is 1 over a hemisphere: 2π · √(1/4π).
const OPEN_HARMONIC: f32 = 1.772_453_9;

/// Write `image` as an 8-bit PNG `path` with `texts` ([`annotated`]), under a temporary name first.
///
/// # Errors
/// If it has no pixels or the file cannot be written; nothing is left behind then.
pub fn write_png(path: &Path, image: &AovImage, texts: &[(&str, &str)]) -> Result<(), Error> {
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
    write_whole(path, &annotated(bytes, texts))
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

/// `image` as a PNG in memory, as [`write_png`] shows it, at most `most` pixels wide; colors exposed as those of `like`.
/// Empty if it has no pixels.
pub fn png_to_look_at(image: &AovImage, like: Option<&AovImage>, most: u32) -> Vec<u8> {
    let shown = pixels_like(image, like.unwrap_or(image));
    let rgb = match image.aov.value_type() {
        ValueType::Float | ValueType::Harmonics => {
            shown.iter().flat_map(|&gray| [gray; 3]).collect()
        }
        _ => shown,
    };
    match RgbImage::from_raw(image.width, image.height, rgb) {
        Some(rgb) => png_at_most(&rgb, most),
        None => Vec::new(),
    }
}

/// The picture in `png`, at most `most` pixels wide, as a PNG in memory; empty if it is none.
pub fn thumbnail(png: &[u8], most: u32) -> Vec<u8> {
    match ::image::load_from_memory(png) {
        Ok(image) => png_at_most(&image.to_rgb8(), most),
        Err(_) => Vec::new(),
    }
}

fn png_at_most(image: &RgbImage, most: u32) -> Vec<u8> {
    let (width, height) = image.dimensions();
    if width <= most || width == 0 {
        return png_of_rgb(width, height, image.as_raw());
    }
    let scaled = u64::from(height) * u64::from(most) / u64::from(width);
    let height = u32::try_from(scaled).unwrap_or(height).max(1);
    let small = ::image::imageops::thumbnail(image, most, height);
    png_of_rgb(most, height, small.as_raw())
}

/// 8 bits a channel.
fn pixels(image: &AovImage) -> Vec<u8> {
    pixels_like(image, image)
}

fn pixels_like(image: &AovImage, like: &AovImage) -> Vec<u8> {
    match (image.aov, image.aov.value_type()) {
        (Aov::Depth, _) => depth(&image.data),
        (_, ValueType::Float) => image.data.iter().map(|value| srgb::code(*value)).collect(),
        (_, ValueType::Color | ValueType::ColorAlpha | ValueType::ColorHarmonics) => {
            colors(image, exposure(&like.data, like.aov.components()))
        }
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
fn colors(image: &AovImage, exposure: f32) -> Vec<u8> {
    let components = image.aov.components();
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
    fn a_picture_to_look_at_is_small_and_exposed_as_another() {
        let (bright, dark) = ([0.5; 3].repeat(64), [0.25; 3].repeat(64));
        let (bright, dark) = (
            image(Aov::Irradiance, &bright),
            image(Aov::Irradiance, &dark),
        );
        let read = |png: &[u8]| ::image::load_from_memory(png).unwrap().to_rgb8();
        let alone = read(&png_to_look_at(&dark, None, 16));
        assert_eq!(
            (alone.dimensions(), alone.get_pixel(3, 0).0),
            ((16, 1), [255; 3])
        );
        // half of white, encoded
        let beside = read(&png_to_look_at(&dark, Some(&bright), 64));
        assert_eq!(
            (beside.dimensions(), beside.get_pixel(3, 0).0),
            ((64, 1), [188; 3])
        );
        let small = read(&thumbnail(&png_to_look_at(&dark, Some(&bright), 64), 8));
        assert_eq!(
            (small.dimensions(), small.get_pixel(3, 0).0),
            ((8, 1), [188; 3])
        );
        assert!(thumbnail(b"no picture", 8).is_empty());
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
        let normals = image(Aov::Normal, &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0]);
        write_png(&path, &normals, &[("Software", "surflux")]).unwrap();
        let read = ::image::open(&path).unwrap().to_rgb8();
        assert_eq!(read.dimensions(), (2, 1));
        assert_eq!(read.into_raw(), [128, 128, 255, 255, 128, 128]);
    }
}
