//! Pixels from files: textures with mip levels, and latlong environments.
//!
//! Files: PNG, JPEG, TGA, BMP, TIFF, Radiance HDR and OpenEXR, also inside `.usdz` packages (`a.usdz[b.png]`), and
//! UDIM sets (`<UDIM>` in the name). Values are linear after loading, primaries are taken as Rec.709.

mod codes;
mod decode;
mod exr_file;
mod latlong;
mod lookup;
mod probe;
mod pyramid;
mod texture;

pub use codes::{Codes, Use, bytes_of, png_of_codes};
pub use latlong::Latlong;
pub use lookup::Image;
pub use probe::{Probe, probe, tiles};
pub use texture::Texture;

use std::path::PathBuf;

/// Why an image cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file, or the package around it, cannot be read.
    #[error("cannot read {path}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// No tile of a UDIM set exists.
    #[error("no tile 1001 to 1100 of {path} exists")]
    NoTiles {
        /// The file name with `<UDIM>`.
        path: PathBuf,
    },
    /// The contents are not an image that can be decoded.
    #[error("{path}: {message}")]
    Undecodable {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
}
