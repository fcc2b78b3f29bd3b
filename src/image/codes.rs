//! An image file → 8-bit codes, for files of other formats.

use super::Error;
use super::decode::{self, Samples};
use crate::files::package;
use crate::math::srgb;
use crate::scene::ColorSpace;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use std::path::Path;

/// Pixels as 8-bit codes, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Codes {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Red, green, blue, alpha of each pixel; grays in all three, 255 where there is no alpha.
    pub pixels: Vec<[u8; 4]>,
    /// True if red, green and blue are sRGB-encoded; alpha never is.
    pub is_srgb: bool,
    /// True if the file has an alpha channel.
    pub has_alpha: bool,
}

/// What the codes of files of more than 8 bits a channel are to be good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// Colors: linear values are encoded.
    Color,
    /// Numbers: values are kept as they are.
    Data,
}

impl Codes {
    /// The image at `path`, which says `color_space` of its values. Values beyond 0…1 are clipped.
    ///
    /// # Errors
    /// Files that cannot be read or decoded.
    pub fn load(path: &Path, color_space: ColorSpace, used_as: Use) -> Result<Self, Error> {
        let decoded = decode::file(path)?;
        let channels = decoded.channels;
        let is_color_code = channels >= 3 && matches!(decoded.samples, Samples::Bytes(_));
        let says_srgb = match color_space {
            ColorSpace::Auto => is_color_code,
            ColorSpace::Raw => false,
            ColorSpace::SRgb => true,
        };
        let encodes = !says_srgb && used_as == Use::Color;
        let is_alpha = |at: usize| channels.is_multiple_of(2) && at % channels == channels - 1;
        let code = |(at, value): (usize, f32)| match encodes && !is_alpha(at) {
            true => srgb::code(value),
            false => srgb::byte(value),
        };
        let (codes, is_srgb): (Vec<u8>, bool) = match decoded.samples {
            Samples::Bytes(bytes) => (bytes, says_srgb),
            Samples::Half(values) => {
                let values = values.into_iter().map(f32::from).enumerate();
                (values.map(code).collect(), says_srgb || encodes)
            }
            Samples::Float(values) => {
                let values = values.into_iter().enumerate();
                (values.map(code).collect(), says_srgb || encodes)
            }
        };
        let pixel = |pixel: &[u8]| match *pixel {
            [gray] => [gray, gray, gray, u8::MAX],
            [gray, alpha] => [gray, gray, gray, alpha],
            [r, g, b] => [r, g, b, u8::MAX],
            [r, g, b, a, ..] => [r, g, b, a],
            [] => [0; 4],
        };
        Ok(Self {
            width: decoded.width,
            height: decoded.height,
            pixels: codes.chunks_exact(channels).map(pixel).collect(),
            is_srgb,
            has_alpha: channels.is_multiple_of(2),
        })
    }
}

/// `pixels` (red, green, blue, alpha; rows from the top) as a PNG, without alpha where it is 255 everywhere.
///
/// # Errors
/// Sizes that PNG does not have.
pub fn png_of_codes(
    (width, height): (usize, usize),
    pixels: &[[u8; 4]],
) -> Result<Vec<u8>, String> {
    let wrong = || format!("{width} × {height} pixels are no PNG");
    let (Ok(width), Ok(height)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(wrong());
    };
    let is_opaque = pixels.iter().all(|pixel| pixel[3] == u8::MAX);
    let (codes, color): (Vec<u8>, _) = match is_opaque {
        true => {
            let rgb = pixels.iter().flat_map(|&[r, g, b, _]| [r, g, b]);
            (rgb.collect(), ExtendedColorType::Rgb8)
        }
        false => (pixels.concat(), ExtendedColorType::Rgba8),
    };
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(&codes, width, height, color)
        .map_err(|error| error.to_string())?;
    Ok(png)
}

/// The file at `path` as it is, inside a package too.
///
/// # Errors
/// Files that cannot be read.
pub fn bytes_of(path: &Path) -> Result<Vec<u8>, Error> {
    package::read(path).map_err(|source| Error::Unreadable {
        path: path.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_the_file_and_of_its_values() {
        let folder = tempfile::tempdir().unwrap();
        let png = folder.path().join("a.png");
        let pixels = [[10, 20, 30, 40], [250, 128, 0, 255]];
        let image = image::RgbaImage::from_raw(2, 1, pixels.concat()).unwrap();
        image.save(&png).unwrap();
        let codes = Codes::load(&png, ColorSpace::Auto, Use::Color).unwrap();
        assert_eq!(codes.pixels, pixels);
        assert!(codes.is_srgb && codes.has_alpha);
        let raw = Codes::load(&png, ColorSpace::Raw, Use::Data).unwrap();
        assert_eq!((raw.pixels, raw.is_srgb), (pixels.to_vec(), false));
        let hdr = folder.path().join("a.hdr");
        let light = image::Rgb32FImage::from_raw(1, 1, vec![0.5, 2.0, 0.0]).unwrap();
        light.save(&hdr).unwrap();
        // 0.5 is 188 of 255 in sRGB, half of it as a number
        let color = Codes::load(&hdr, ColorSpace::Auto, Use::Color).unwrap();
        assert_eq!((color.pixels[0], color.is_srgb), ([188, 255, 0, 255], true));
        let data = Codes::load(&hdr, ColorSpace::Auto, Use::Data).unwrap();
        assert_eq!((data.pixels[0], data.is_srgb), ([128, 255, 0, 255], false));
    }
}
