//! Bytes of an image file → pixels.

use super::{Error, exr_file};
use crate::files::package;
use half::f16;
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Longest edge accepted, pixels.
pub(super) const MAX_EDGE: u32 = 65_536;

/// Most memory for one decoded image, bytes.
pub(super) const MAX_BYTES: u64 = 8 << 30;

/// No format packs pixels tighter than this (constant images come close): a header that claims more bytes of pixels
/// for each byte of the file is damaged, and nothing is allocated for it.
const MAX_COMPRESSION: u64 = 20_000;

/// Samples as the file has them: 1 to 4 interleaved channels, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Samples {
    /// 8 bits, 0 to 255 meaning 0 to 1.
    Bytes(Vec<u8>),
    /// Half precision; also 16-bit integers, as fractions of 65535.
    Half(Vec<f16>),
    /// Single precision.
    Float(Vec<f32>),
}

/// An image as decoded. Not linear yet: see [`super::Image`].
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Decoded {
    pub(super) width: usize,
    pub(super) height: usize,
    /// 1 gray, 2 gray and alpha, 3 RGB, 4 RGBA.
    pub(super) channels: usize,
    pub(super) samples: Samples,
}

/// Decode the file at `path`.
pub(super) fn file(path: &Path) -> Result<Decoded, Error> {
    let bytes = package::read(path).map_err(|source| Error::Unreadable {
        path: path.to_owned(),
        source,
    })?;
    let undecodable = |message: String| Error::Undecodable {
        path: path.to_owned(),
        message,
    };
    let decoded = decode(&bytes, &name(path)).map_err(undecodable)?;
    if decoded.width == 0 || decoded.height == 0 {
        return Err(undecodable("the image is empty".to_owned()));
    }
    Ok(decoded)
}

/// File name without a package around it.
fn name(path: &Path) -> PathBuf {
    PathBuf::from(path.to_string_lossy().trim_end_matches(']'))
}

fn decode(bytes: &[u8], name: &Path) -> Result<Decoded, String> {
    if exr_file::is_exr(bytes) {
        return exr_file::decode(bytes);
    }
    let format = image::guess_format(bytes).or_else(|_| ImageFormat::from_path(name));
    let format =
        format.map_err(|_| "not a PNG, JPEG, TGA, BMP, TIFF, HDR or EXR file".to_owned())?;
    let reader = || ImageReader::with_format(Cursor::new(bytes), format);
    let (width, height) = reader()
        .into_dimensions()
        .map_err(|error| error.to_string())?;
    check_size(width as usize, height as usize, 1, bytes.len())?;
    let mut reader = reader();
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_EDGE);
    limits.max_image_height = Some(MAX_EDGE);
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let image = reader.decode().map_err(|error| error.to_string())?;
    Ok(from_image(image))
}

/// Refuse sizes that cannot be true of a file of `file_bytes`.
pub(super) fn check_size(
    width: usize,
    height: usize,
    pixel_bytes: u64,
    file_bytes: usize,
) -> Result<(), String> {
    let limit = MAX_EDGE as usize;
    if width > limit || height > limit {
        return Err(format!(
            "{width} × {height} pixels are more than {limit} on a side"
        ));
    }
    let bytes = (width as u64) * (height as u64) * pixel_bytes;
    if bytes > MAX_BYTES || bytes / MAX_COMPRESSION > file_bytes as u64 {
        return Err(format!(
            "{width} × {height} pixels cannot be in {file_bytes} bytes"
        ));
    }
    Ok(())
}

fn from_image(image: DynamicImage) -> Decoded {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let channels = usize::from(image.color().channel_count());
    let fractions = |samples: Vec<u16>| {
        let fraction = |sample: u16| f16::from_f32(f32::from(sample) / 65_535.0);
        Samples::Half(samples.into_iter().map(fraction).collect())
    };
    let samples = match image {
        DynamicImage::ImageLuma8(image) => Samples::Bytes(image.into_raw()),
        DynamicImage::ImageLumaA8(image) => Samples::Bytes(image.into_raw()),
        DynamicImage::ImageRgb8(image) => Samples::Bytes(image.into_raw()),
        DynamicImage::ImageRgba8(image) => Samples::Bytes(image.into_raw()),
        DynamicImage::ImageLuma16(image) => fractions(image.into_raw()),
        DynamicImage::ImageLumaA16(image) => fractions(image.into_raw()),
        DynamicImage::ImageRgb16(image) => fractions(image.into_raw()),
        DynamicImage::ImageRgba16(image) => fractions(image.into_raw()),
        DynamicImage::ImageRgb32F(image) => Samples::Float(image.into_raw()),
        other => {
            let image = other.into_rgba32f();
            return Decoded {
                width,
                height,
                channels: 4,
                samples: Samples::Float(image.into_raw()),
            };
        }
    };
    Decoded {
        width,
        height,
        channels,
        samples,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::pyramid;

    /// A small file of every format.
    fn files() -> Vec<(&'static str, Vec<u8>)> {
        let folder = tempfile::tempdir().unwrap();
        let code = |x: u32| u8::try_from(x).unwrap();
        let pixels = image::RgbImage::from_fn(9, 7, |x, y| image::Rgb([code(x * y), code(x), 7]));
        let floats = DynamicImage::ImageRgb8(pixels.clone()).into_rgb32f();
        let names = [
            "a.png", "a.jpg", "a.bmp", "a.tga", "a.tiff", "a.hdr", "a.exr",
        ];
        let write = |name: &'static str| {
            let path = folder.path().join(name);
            match name {
                "a.exr" => {
                    exr::prelude::write_rgb_file(&path, 9, 7, |x, y| (x as f32, y as f32, 0.5))
                        .unwrap();
                }
                "a.hdr" => floats.save(&path).unwrap(),
                _ => pixels.save(&path).unwrap(),
            }
            (name, std::fs::read(&path).unwrap())
        };
        names.into_iter().map(write).collect()
    }

    #[test]
    fn truncated_and_flipped_files_do_not_panic() {
        for (name, good) in files() {
            assert!(decode(&good, Path::new(name)).is_ok(), "{name}");
            let try_bytes = |bytes: &[u8]| {
                if let Ok(decoded) = decode(bytes, Path::new(name)) {
                    assert!(
                        decoded.width * decoded.height < 20_000 * bytes.len(),
                        "{name}"
                    );
                    if decoded.width * decoded.height < 10_000 && decoded.width * decoded.height > 0
                    {
                        pyramid::build(decoded, true);
                    }
                }
            };
            for cut in 0..good.len() {
                try_bytes(&good[..cut]);
            }
            for bit in 0..good.len().min(500) * 8 {
                let mut bad = good.clone();
                bad[bit / 8] ^= 1 << (bit % 8);
                try_bytes(&bad);
            }
        }
    }

    #[test]
    fn headers_that_promise_more_than_the_file_can_hold_are_refused() {
        assert!(check_size(1024, 1024, 4, 100_000).is_ok());
        assert!(check_size(60_000, 60_000, 4, 100).is_err());
        assert!(check_size(70_000, 1, 1, 1 << 30).is_err());
        assert!(check_size(usize::MAX, usize::MAX, 8, 1 << 30).is_err());
    }
}
