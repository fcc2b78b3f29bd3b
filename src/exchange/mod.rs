//! Other formats ↔ points, meshes and materials.
//!
//! | format | read as | written from |
//! |---|---|---|
//! | glTF, GLB | a USD asset: meshes, materials, lights, cameras, animation | |
//! | GLB | as glTF | a [`Scene`](crate::scene::Scene) |
//! | PLY | [`PointSet`](crate::surfels::points::PointSet) or [`Splats`](crate::surfels::splats::Splats) | the same |
//! | LAS, LAZ | [`PointSet`](crate::surfels::points::PointSet) | |
//! | `.ptc` | [`PointSet`](crate::surfels::points::PointSet) | the same |
//!
//! What a format cannot hold is a warning of kind `lost`, once for each thing lost. Files are checked against their own
//! size before memory is asked for, so that damaged ones are errors and nothing else.

pub mod glb;
pub mod gltf;
pub mod las;
pub mod ply;
pub mod ptc;
mod srgb;

use crate::files::Bytes;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
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

fn read_file(path: &Path) -> Result<Bytes, Error> {
    Bytes::of(path).map_err(|source| Error::Unreadable {
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

/// Coordinates of double precision beyond this are kept relative to an origin: single precision has steps of 5e-4
/// there.
const FAR: f64 = 4096.0;

fn not_finite(at: usize) -> String {
    format!("the position of point {at} is not finite")
}

/// `absolute` relative to an origin, which is 0 unless something is far off it.
fn single_precision(absolute: &[DVec3]) -> Result<(DVec3, Vec<Vec3>), String> {
    let points = absolute.par_iter();
    if let Some(at) = points.position_first(|p| !p.as_vec3().is_finite()) {
        return Err(not_finite(at));
    }
    let bounds = |f: fn(DVec3, DVec3) -> DVec3| {
        let points = absolute.par_iter().copied();
        points.reduce_with(f).unwrap_or_default()
    };
    let (low, high) = (bounds(DVec3::min), bounds(DVec3::max));
    let is_far = low.abs().max(high.abs()).max_element() > FAR;
    let origin = if is_far {
        (0.5 * (low + high)).round()
    } else {
        DVec3::ZERO
    };
    let relative = absolute.par_iter().map(|p| (*p - origin).as_vec3());
    Ok((origin, relative.collect()))
}
