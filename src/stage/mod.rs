//! USD → [`crate::scene::Scene`]: two doors (native `openusd`; a worker process with Pixar's usd-core) behind one
//! [`raw::RawStage`] of composed prims and resolved values, then the same passes for both.

pub mod attributes;
pub mod bake_settings;
pub mod cloud;
mod composition;
pub mod displacement;
pub mod materialx;
pub mod native;
pub mod opacity;
pub mod passes;
pub mod raw;
pub mod validate;
pub mod worker;

pub use composition::{Composition, Load, VariantChoice};
pub use passes::LightGroupChoice;

use crate::diagnostics::{Cancelled, Diagnostics};
use crate::scene::Scene;
use raw::{RawStage, Request};
use std::path::{Path, PathBuf};

/// Which door to read through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Door {
    /// usd-core when an interpreter that can import `pxr` is found, else native.
    #[default]
    Auto,
    /// The `openusd` crate, no Python.
    Native,
    /// Pixar's usd-core in a Python process.
    UsdCore,
}

/// Why a stage could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The root layer does not exist or is not readable.
    #[error("cannot read {path}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// A layer cannot be parsed or composed.
    #[error("{path}: {message}")]
    Layer {
        /// The root layer or the layer at fault.
        path: PathBuf,
        /// What is wrong and, for the native door, which other door may read it.
        message: String,
    },
    /// A mesh's arrays contradict each other.
    #[error("mesh {prim}: {message}")]
    Mesh {
        /// Prim path.
        prim: String,
        /// What is wrong, and what would have been right.
        message: String,
    },
    /// The usd-core worker could not be started, failed or died.
    #[error("usd-core worker ({interpreter}): {message}")]
    Worker {
        /// The Python interpreter.
        interpreter: String,
        /// What happened, with the end of its stderr.
        message: String,
    },
    /// The user cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// An open stage that can be read at several time codes.
pub trait Source: std::fmt::Debug {
    /// Composed prims and resolved values at `request.time`; only what the request asks for.
    ///
    /// # Errors
    /// Any composition error the door meets (a missing payload, a bad reference): never a smaller stage in silence,
    /// unless usd-core too would go on with a warning — then it is a warning.
    fn load(&mut self, request: &Request, diagnostics: &Diagnostics) -> Result<RawStage, Error>;

    /// `native` or `usd-core`.
    fn name(&self) -> &'static str;

    /// `count` loads will come: what they share may be kept.
    fn expect_loads(&mut self, _count: usize) {}

    /// What Pixar's validators say of the whole stage; `None` where this door has none.
    ///
    /// # Errors
    /// When the stage cannot be opened, or the worker fails.
    fn validate(&mut self, _diagnostics: &Diagnostics) -> Result<Option<UsdVerdict>, Error> {
        Ok(None)
    }

    /// Peak resident memory, bytes, of a process of its own that the source reads with, if it has one and the system
    /// tells.
    fn peak_memory_bytes(&self) -> Option<u64> {
        None
    }
}

/// What Pixar's validators say of a stage.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
pub struct UsdVerdict {
    /// Who was asked: `UsdValidation of usd-core 26.11`.
    pub validators: String,
    /// How many validators or rules there are.
    pub count: usize,
    /// What they complain of.
    pub complaints: Vec<UsdComplaint>,
}

/// One complaint of a validator.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
pub struct UsdComplaint {
    /// Name of the error.
    pub name: String,
    /// True for an error, false for a warning.
    pub is_error: bool,
    /// Prim or property path, `/` for the stage as a whole.
    pub place: String,
    /// What is wrong.
    pub message: String,
}

/// Open the stage at `path` through `door`.
///
/// # Errors
/// When the root layer is missing or unreadable, or the worker asked for cannot be started.
pub fn open(path: &Path, door: Door, diagnostics: &Diagnostics) -> Result<Box<dyn Source>, Error> {
    let cancel = diagnostics.cancel_token();
    match door {
        Door::Native => Ok(Box::new(native::NativeSource::open_until(path, cancel)?)),
        Door::UsdCore => Ok(Box::new(worker::WorkerSource::open(path, diagnostics)?)),
        Door::Auto => match worker::WorkerSource::available() {
            true => Ok(Box::new(worker::WorkerSource::open(path, diagnostics)?)),
            false => {
                log::info!(
                    "no Python with usd-core found: reading {} natively",
                    path.display()
                );
                Ok(Box::new(native::NativeSource::open_until(path, cancel)?))
            }
        },
    }
}

/// What a job needs of a stage; everything else is neither read nor resolved.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadSettings {
    /// Time code; `None` = the default time.
    pub time: Option<f64>,
    /// Purposes to include besides `default`.
    pub purposes: Vec<crate::scene::Purpose>,
    /// Only these prims and what is below them (and their ancestors); empty = everything.
    pub mask: Vec<String>,
    /// Payloads, variants, session and muted layers.
    pub composition: Composition,
    /// Materials, displayColor and the primvars they read.
    pub materials: bool,
    /// What tells whether anything lets light through ([`opacity::may_pass`]) or is displaced
    /// ([`displacement::may_displace`]), where materials are not read.
    pub solidity: bool,
    /// Lights.
    pub lights: bool,
    /// Every primvar of meshes that is one of numbers, not only those that materials read.
    pub all_primvars: bool,
    /// Longest edge a refined subdivision face should have, stage units; `None` = chosen from the scene's size.
    pub refine_edge: Option<f32>,
    /// The render settings prim to take instead of the one that the stage names.
    pub render_settings: Option<String>,
}

impl Default for ReadSettings {
    fn default() -> Self {
        Self {
            time: None,
            purposes: vec![crate::scene::Purpose::Render],
            mask: Vec::new(),
            composition: Composition::default(),
            materials: true,
            solidity: false,
            lights: true,
            all_primvars: false,
            refine_edge: None,
            render_settings: None,
        }
    }
}

/// Read `source` at `settings.time` into a [`Scene`].
///
/// # Errors
/// Whatever [`Source::load`] reports, and meshes whose topology is invalid.
pub fn read(
    source: &mut dyn Source,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Result<Scene, Error> {
    let mut raw = compose(source, settings, diagnostics)?;
    passes::scene_of_spent(&mut raw, settings, diagnostics)
}

/// Read `source` at `settings.time` as far as no geometry is made of it: what [`read`] hands to [`passes::scene`].
///
/// # Errors
/// Whatever [`Source::load`] reports.
pub fn compose(
    source: &mut dyn Source,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Result<RawStage, Error> {
    let mut raw = source.load(&Request::for_settings(settings), diagnostics)?;
    if let Some(chosen) = &settings.render_settings {
        raw.meta.render_settings_prim_path = Some(chosen.clone());
    }
    let raw = match settings.materials || settings.solidity {
        true => materialx::graft(raw, diagnostics),
        false => raw,
    };
    let raw = passes::skinning::pose(raw, diagnostics);
    Ok(passes::hermite::as_bezier(raw, diagnostics))
}

/// Peak resident memory, bytes, of the process `id` (`self` = this one) where `/proc` tells.
pub fn process_peak_memory(id: impl std::fmt::Display) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}
