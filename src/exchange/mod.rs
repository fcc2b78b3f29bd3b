//! Other formats ↔ points, meshes and materials.
//!
//! | format | read as | written from |
//! |---|---|---|
//! | glTF, GLB | a USD asset: meshes, materials, lights, cameras, animation | |
//! | GLB | as glTF | a [`Scene`](crate::scene::Scene) |
//! | PLY | [`PointSet`](crate::surfels::points::PointSet) or [`Splats`](crate::surfels::splats::Splats) | the same |
//! | `.ptc` | [`PointSet`](crate::surfels::points::PointSet) | the same |
//!
//! What a format cannot hold is a warning of kind `lost`, once for each thing lost. Files are checked against their own
//! size before memory is asked for, so that damaged ones are errors and nothing else.

pub mod glb;
pub mod gltf;
pub mod ply;
pub mod ptc;
mod srgb;

use std::path::{Path, PathBuf};

/// Why a file could not be converted. Nothing was written then.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file does not exist or is not readable.
    #[error("cannot read {path}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The folder does not exist, is not writable, or the disk is full.
    #[error("cannot write {path}")]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// It is not what its name says, or is damaged.
    #[error("{path}: {message}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what would have been right.
        message: String,
    },
    /// The USD file made of it could not be written.
    #[error(transparent)]
    Usd(#[from] crate::writers::usd::Error),
    /// What is to be written does not fit the format.
    #[error("{path}: {message}")]
    Unsuitable {
        /// The file.
        path: PathBuf,
        /// Why not.
        message: String,
    },
}

fn read_file(path: &Path) -> Result<Vec<u8>, Error> {
    std::fs::read(path).map_err(|source| Error::Unreadable {
        path: path.to_owned(),
        source,
    })
}

/// An [`Error::Malformed`] of `path`.
fn malformed(path: &Path) -> impl Fn(String) -> Error {
    move |message| Error::Malformed {
        path: path.to_owned(),
        message,
    }
}
