//! Pictures of light, read with the crate's own decoders: textures of rect lights, latlong maps of domes.

use crate::diagnostics::Diagnostics;
use crate::image::{Error, Latlong, Texture};
use crate::scene::{ColorSpace, Wrap};
use glam::{Mat2, Vec2, Vec3};
use std::path::Path;

/// Wider maps are averaged down: a texel is then a third of the sun's disk wide.
const MAX_MAP_WIDTH: usize = 4096;

/// The latlong map at `path`; what fails is a warning for `prim`, and `None`.
pub(super) fn map(path: &Path, prim: &str, diagnostics: &Diagnostics) -> Option<Latlong> {
    let loaded = Latlong::load(path, MAX_MAP_WIDTH);
    let map = or_warn(loaded, path, prim, diagnostics)?;
    warn_repaired(map.repaired, path, prim, diagnostics);
    Some(map)
}

/// A rect light's picture.
#[derive(Debug)]
pub(super) struct Picture(Texture);

impl Picture {
    /// The picture at `path`; what fails is a warning for `prim`, and `None`.
    pub(super) fn load(path: &Path, prim: &str, diagnostics: &Diagnostics) -> Option<Self> {
        let loaded = Texture::load(path, ColorSpace::Auto);
        let texture = or_warn(loaded, path, prim, diagnostics)?;
        warn_repaired(texture.repaired(), path, prim, diagnostics);
        Some(Self(texture))
    }

    /// Mean color of the square of side `width` (1 = the whole light) around `local`, the place on the light, −1…1.
    /// `UsdLuxRectLight`: seen from in front of the light the picture stands upright, so its left edge is at +X.
    pub(super) fn color(&self, local: Vec2, width: f32) -> Vec3 {
        let st = Vec2::new(0.5 - 0.5 * local.x, 0.5 + 0.5 * local.y);
        let footprint = Mat2::from_diagonal(Vec2::splat(width));
        (self.0.sample(st, footprint, [Wrap::Clamp; 2]))
            .map_or(Vec3::ZERO, |color| color.truncate().max(Vec3::ZERO))
    }
}

fn or_warn<T>(
    loaded: Result<T, Error>,
    path: &Path,
    prim: &str,
    diagnostics: &Diagnostics,
) -> Option<T> {
    match loaded {
        Ok(loaded) => Some(loaded),
        Err(error) => {
            let cause = std::error::Error::source(&error)
                .map_or(String::new(), |cause| format!(" ({cause})"));
            let message = format!(
                "texture {} cannot be read ({error}{cause}): the light shines evenly in its own color",
                path.display()
            );
            diagnostics.warn("missing-texture", prim, message);
            None
        }
    }
}

fn warn_repaired(repaired: usize, path: &Path, prim: &str, diagnostics: &Diagnostics) {
    if repaired > 0 {
        let message = format!(
            "{} has {repaired} samples that are negative or not finite: they count as 0",
            path.display()
        );
        diagnostics.warn("invalid-texture", prim, message);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Red top left, green top right, blue below.
    fn write(path: &Path) {
        exr::prelude::write_rgb_file(path, 2, 2, |x, y| match (x, y) {
            (0, 0) => (8.0_f32, 0.0, 0.0),
            (1, 0) => (0.0, 8.0, 0.0),
            _ => (0.0, 0.0, f32::from(u8::from(x == 0)) * f32::NAN),
        })
        .unwrap();
    }

    #[test]
    fn the_first_texel_of_an_exr_is_at_plus_x_plus_y_and_bad_texels_are_warnings() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("light.exr");
        write(&path);
        let diagnostics = Diagnostics::default();
        let picture = Picture::load(&path, "/light", &diagnostics).unwrap();
        assert_eq!(picture.color(Vec2::new(0.5, 0.5), 0.0), Vec3::X * 8.0);
        assert_eq!(picture.color(Vec2::new(-0.5, 0.5), 0.0), Vec3::Y * 8.0);
        assert_eq!(picture.color(Vec2::ZERO, 1.0), Vec3::new(2.0, 2.0, 0.0));
        assert_eq!(diagnostics.warnings()[0].kind, "invalid-texture");
    }

    #[test]
    fn files_that_cannot_be_read_are_warnings() {
        let diagnostics = Diagnostics::default();
        let path = Path::new("no/such/file.exr");
        assert!(Picture::load(path, "/light", &diagnostics).is_none());
        assert!(map(path, "/dome", &diagnostics).is_none());
        assert_eq!(diagnostics.warnings()[0].kind, "missing-texture");
        assert!(diagnostics.warnings()[0].message.contains("own color"));
    }
}
