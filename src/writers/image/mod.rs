//! Pixels → image files: all AOVs in an EXR, one AOV as a PNG to look at.

pub mod exr;
mod exr_header;
pub mod png;
mod png_text;

pub use exr::{ExrInfo, ExrLayout, write_exr};
pub use png::{png_of_rgb, png_to_look_at, thumbnail, write_png};
pub use png_text::annotated;

use std::path::{Path, PathBuf};

/// An image could not be written. No file was left behind, and an older one of that name is untouched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The system said no.
    #[error("{path}: cannot be written")]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Encoding failed.
    #[error("{path}: cannot be encoded as EXR")]
    Exr {
        /// The file.
        path: PathBuf,
        /// Why.
        source: ::exr::error::Error,
    },
    /// Encoding failed.
    #[error("{path}: cannot be encoded as PNG")]
    Png {
        /// The file.
        path: PathBuf,
        /// Why.
        source: ::image::ImageError,
    },
    /// There is nothing to write, or the images differ in size.
    #[error("{path}: {problem}")]
    Unsuitable {
        /// The file.
        path: PathBuf,
        /// What is wrong and what would be right.
        problem: String,
    },
}

/// Write `bytes` as `path`, whole or not at all.
fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    super::write_whole(path, bytes).map_err(|source| Error::Io {
        path: path.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_no_file_and_names_the_path() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing/out.exr");
        let error = write_whole(&path, b"x").unwrap_err();
        assert!(error.to_string().contains("out.exr"));
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
        write_whole(&folder.path().join("out.exr"), b"x").unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
