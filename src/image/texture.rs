//! A texture as a material names it: one image, or a UDIM set of them.

use super::{Error, Image};
use crate::files::package;
use crate::scene::{ColorSpace, Wrap};
use glam::{Mat2, Vec2, Vec4};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// What stands for the tile number in the file name of a UDIM set.
const UDIM: &str = "<UDIM>";

/// Number of the tile at (0, 0); tiles go 10 to a row.
const FIRST_TILE: usize = 1001;
const TILE_COLUMNS: usize = 10;
const TILE_ROWS: usize = 10;

/// One image, or the tiles of a UDIM set.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    tiles: Tiles,
}

#[derive(Debug, Clone, PartialEq)]
enum Tiles {
    One(Image),
    /// Tiles 1001 to 1100.
    Udim(Vec<Option<Image>>),
}

impl Texture {
    /// Read the file at `path`, or all existing tiles of the set if its name contains `<UDIM>`.
    ///
    /// # Errors
    /// Missing or undecodable files; a set without any tile, or with one that cannot be decoded.
    pub fn load(path: &Path, color_space: ColorSpace) -> Result<Self, Error> {
        let pattern = path.to_string_lossy();
        if !pattern.contains(UDIM) {
            let tiles = Tiles::One(Image::load(path, color_space)?);
            return Ok(Self { tiles });
        }
        let tile = |index: usize| {
            let number = (FIRST_TILE + index).to_string();
            let file = PathBuf::from(pattern.replace(UDIM, &number));
            let exists = package::exists(&file);
            exists.then(|| Image::load(&file, color_space)).transpose()
        };
        let images: Vec<Option<Image>> = (0..TILE_COLUMNS * TILE_ROWS)
            .into_par_iter()
            .map(tile)
            .collect::<Result<_, _>>()?;
        if images.iter().all(Option::is_none) {
            return Err(Error::NoTiles {
                path: path.to_owned(),
            });
        }
        Ok(Self {
            tiles: Tiles::Udim(images),
        })
    }

    /// See [`Image::sample`]. In a UDIM set `st` chooses the tile and `wrap` is not used; `None` where there is no tile.
    pub fn sample(&self, st: Vec2, footprint: Mat2, wrap: [Wrap; 2]) -> Option<Vec4> {
        match &self.tiles {
            Tiles::One(image) => Some(image.sample(st, footprint, wrap)),
            Tiles::Udim(images) => {
                let tile = st.floor();
                let inside = tile.cmpge(Vec2::ZERO).all()
                    && tile.x < TILE_COLUMNS as f32
                    && tile.y < TILE_ROWS as f32;
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "0 to 99"
                )]
                let index = inside.then(|| tile.x as usize + TILE_COLUMNS * tile.y as usize)?;
                let image = images[index].as_ref()?;
                Some(image.sample(st - tile, footprint, [Wrap::Clamp; 2]))
            }
        }
    }

    /// The images: one, or the tiles in order.
    pub fn images(&self) -> impl Iterator<Item = &Image> {
        let (one, tiles) = match &self.tiles {
            Tiles::One(image) => (Some(image), &[][..]),
            Tiles::Udim(images) => (None, images.as_slice()),
        };
        one.into_iter().chain(tiles.iter().flatten())
    }

    /// True if it is a set of tiles, between which there may be nothing.
    pub fn is_udim(&self) -> bool {
        matches!(self.tiles, Tiles::Udim(_))
    }

    /// How many samples were NaN or infinite; they are 0.
    pub fn repaired(&self) -> usize {
        self.images().map(Image::repaired).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::package::tests::stored_zip;

    fn load(path: &Path) -> Image {
        Image::load(path, ColorSpace::Auto).unwrap()
    }

    #[test]
    fn integer_formats_are_read_with_their_values() {
        let folder = tempfile::tempdir().unwrap();
        let code = |x: u32| u8::try_from(x).unwrap();
        for name in ["a.png", "a.tga", "a.bmp", "a.tiff"] {
            let path = folder.path().join(name);
            let pixels = image::RgbImage::from_fn(3, 2, |x, y| {
                image::Rgb([188, code(x * 60), code(y * 100)])
            });
            pixels.save(&path).unwrap();
            let read = load(&path);
            assert_eq!((read.width(), read.height()), (3, 2), "{name}");
            assert!((read.pixel(1, 0).x - 0.502_886).abs() < 1e-5, "{name}");
            assert!(
                read.pixel(0, 0).z == 0.0 && read.pixel(0, 1).z > 0.1,
                "{name}: rows from the top"
            );
        }
        let path = folder.path().join("gray.jpg");
        image::GrayImage::from_pixel(16, 16, image::Luma([128]))
            .save(&path)
            .unwrap();
        let jpg = load(&path).mean();
        assert!((jpg.x - 128.0 / 255.0).abs() < 0.01 && jpg.x == jpg.z && jpg.w == 1.0);
    }

    #[test]
    fn sixteen_bit_and_float_files_are_linear() {
        let folder = tempfile::tempdir().unwrap();
        let png = folder.path().join("a16.png");
        image::ImageBuffer::from_pixel(2, 2, image::Rgb([32768_u16, 0, 65535]))
            .save(&png)
            .unwrap();
        let pixel = load(&png).pixel(0, 0);
        assert!((pixel.x - 0.5).abs() < 1e-3 && pixel.z == 1.0);
        let hdr = folder.path().join("a.hdr");
        image::Rgb32FImage::from_pixel(4, 4, image::Rgb([8.0, 0.5, 100.0]))
            .save(&hdr)
            .unwrap();
        let pixel = load(&hdr).pixel(3, 3);
        // Radiance RGBE shares one exponent: 8 bits of the largest component.
        assert!(
            (pixel.x - 8.0).abs() < 0.5 && (pixel.z - 100.0).abs() < 0.5,
            "{pixel}"
        );
    }

    #[test]
    fn exr_files_give_rgb_alpha_and_luminance() {
        use exr::prelude::*;
        let folder = tempfile::tempdir().unwrap();
        let rgba = folder.path().join("rgba.exr");
        write_rgba_file(&rgba, 4, 2, |x, y| {
            (
                f16::from_f32(x as f32),
                f16::from_f32(y as f32),
                f16::from_f32(1000.0),
                f16::from_f32(0.5),
            )
        })
        .unwrap();
        let image = load(&rgba);
        assert_eq!(image.pixel(3, 1), Vec4::new(3.0, 1.0, 1000.0, 0.5));
        let rgb = folder.path().join("rgb.exr");
        write_rgb_file(&rgb, 2, 2, |_, _| (1e6_f32, 0.25, 0.125)).unwrap();
        assert_eq!(load(&rgb).pixel(1, 1), Vec4::new(1e6, 0.25, 0.125, 1.0));
        let y = folder.path().join("y.exr");
        let channel = AnyChannel::new("Y", FlatSamples::F32(vec![1.0, 2.0, 3.0, 4.0]));
        let channels = AnyChannels::sort([channel].into_iter().collect());
        Image::from_channels((2, 2), channels)
            .write()
            .to_file(&y)
            .unwrap();
        assert_eq!(load(&y).pixel(1, 1), Vec4::new(4.0, 4.0, 4.0, 1.0));
    }

    #[test]
    fn udim_sets_have_the_tiles_that_exist() {
        let folder = tempfile::tempdir().unwrap();
        for (number, code) in [(1001, 51), (1012, 255)] {
            let path = folder.path().join(format!("t.{number}.png"));
            image::GrayImage::from_pixel(4, 4, image::Luma([code]))
                .save(path)
                .unwrap();
        }
        let set = Texture::load(&folder.path().join("t.<UDIM>.png"), ColorSpace::Auto).unwrap();
        let at = |s: f32, t: f32| {
            set.sample(Vec2::new(s, t), Mat2::ZERO, [Wrap::Black; 2])
                .map(|v| v.x)
        };
        assert_eq!(at(0.01, 0.99), Some(0.2));
        assert_eq!(at(1.5, 1.5), Some(1.0));
        assert_eq!(
            [
                at(1.5, 0.5),
                at(-0.1, 0.5),
                at(12.0, 0.0),
                at(f32::NAN, 0.0)
            ],
            [None; 4]
        );
        let none = Texture::load(&folder.path().join("u.<UDIM>.png"), ColorSpace::Auto);
        assert!(matches!(none, Err(Error::NoTiles { .. })));
    }

    #[test]
    fn images_in_packages_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let png = folder.path().join("a.png");
        image::GrayImage::from_pixel(2, 2, image::Luma([255]))
            .save(&png)
            .unwrap();
        let package = folder.path().join("p.usdz");
        std::fs::write(
            &package,
            stored_zip(&[("0/a.png", &std::fs::read(&png).unwrap())]),
        )
        .unwrap();
        let inside = PathBuf::from(format!("{}[0/a.png]", package.display()));
        assert_eq!(load(&inside).mean(), Vec4::ONE);
    }

    #[test]
    fn missing_files_and_other_formats_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let missing = Image::load(&folder.path().join("none.png"), ColorSpace::Auto);
        assert!(matches!(missing, Err(Error::Unreadable { .. })));
        let text = folder.path().join("a.txt");
        std::fs::write(&text, "no image").unwrap();
        let text = Image::load(&text, ColorSpace::Auto);
        assert!(matches!(text, Err(Error::Undecodable { .. })));
    }
}
