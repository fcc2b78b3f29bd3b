//! `run(Job)`: the steps in order; the only module that knows them all.

mod bake;
mod choice;
mod convert;
mod gather;
mod groups;
mod info;
mod interpolated;
mod job;
mod maps;
mod outputs;
mod points;
mod positions;
mod raster;
mod render;
mod report;
mod show;
mod spacing;
mod stand;
mod validate;
mod verify;
mod view;
mod world;

pub use crate::bounce::Bounces;
pub use crate::exchange::ply::Encoding;
pub use crate::gather::maps::MapsSettings;
pub use crate::gather::rays::cone::Falloff;
pub use info::{
    AnimationSummary, BrokenReference, GeometrySummary, JobReads, LightSummary, MaterialSummary,
    RenderSummary, StageSummary, Suspicion, TextureSummary, TreeEntry, info,
};
pub use job::{
    BakeJob, BakeView, ConvertJob, Dome, EngineChoice, GatherJob, InfoJob, Job, OcclusionKind,
    OutputJob, Part, PointsJob, Purposed, RenderJob, StageJob, VerifyJob, ViewJob,
};
pub use positions::unknown_at_points;
pub use report::{Counts, ErrorReport, ReadReport, Report, Seconds};
pub use validate::{CheckSummary, ValidationReport, validate};
pub use verify::verify;

use crate::diagnostics::{Cancelled, Diagnostics};
use std::path::PathBuf;

/// Why a job failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The stage could not be read.
    #[error(transparent)]
    Stage(#[from] crate::stage::Error),
    /// A USD file could not be written.
    #[error(transparent)]
    WriteUsd(#[from] crate::writers::usd::Error),
    /// A file of another format could not be read or written.
    #[error(transparent)]
    Exchange(#[from] crate::exchange::Error),
    /// There is no way from the one to the other.
    #[error("{} cannot be converted to {}: {reason}", from.display(), to.display())]
    NoWay {
        /// What was to be read.
        from: PathBuf,
        /// What was to be written.
        to: PathBuf,
        /// What would have been possible.
        reason: String,
    },
    /// An image could not be written.
    #[error(transparent)]
    WriteImage(#[from] crate::writers::image::Error),
    /// The user cancelled; nothing partial stays.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// There is nothing to work on.
    #[error("{}: no visible surface is on the stage (wanted: meshes or gprims, of purpose default or one in --purposes, below --mask)", path.display())]
    NothingToLight {
        /// The stage.
        path: PathBuf,
    },
    /// Light groups and a cloud with surfels.
    #[error("--light-groups: {} holds surfels, whose light is of all groups together (use --split-clouds with a cloud for each group)", path.display())]
    GroupsOfCloud {
        /// The cloud.
        path: PathBuf,
    },
    /// An output exists and `--no-clobber` was given.
    #[error("{} exists already, and --no-clobber was given", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// An output's folder is missing.
    #[error("cannot write {}: {} is not a folder (create it first)", path.display(), folder.display())]
    NoFolder {
        /// The file.
        path: PathBuf,
        /// Its folder.
        folder: PathBuf,
    },
    /// No such camera.
    #[error("no camera {name} is on the stage; there are: {known}")]
    NoCamera {
        /// As asked for.
        name: String,
        /// Paths of all.
        known: String,
    },
    /// A render without a name to write to.
    #[error("render needs --output NAME.exr: the stage has no render product that names a file")]
    NoProduct,
    /// A page could not be written.
    #[error("cannot write {}", path.display())]
    WritePage {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// There are no points and no meshes.
    #[error("{}: nothing is there to show (wanted: Points, or a stage with visible meshes or gprims)", path.display())]
    NothingToShow {
        /// The file.
        path: PathBuf,
    },
    /// No such values.
    #[error("{}: it has no values called {name}; there are: {known}", path.display())]
    NoChannel {
        /// The file.
        path: PathBuf,
        /// As asked for.
        name: String,
        /// Names of all.
        known: String,
    },
    /// Positions to bake at that face nowhere.
    #[error("{}: no point has a normal, which says where the hemisphere is that light comes from", path.display())]
    NoNormals {
        /// The file of points.
        path: PathBuf,
    },
    /// A bake without meshes.
    #[error("{}: no mesh is on the stage that values could be written to", path.display())]
    NothingToBake {
        /// The stage.
        path: PathBuf,
    },
}

/// Do `job`; returns its statistics. [`fn@info`] and [`fn@verify`] have reports of their own.
///
/// # Errors
/// The first thing that went wrong; files already complete stay, nothing partial does.
pub fn run(job: &Job, diagnostics: &Diagnostics) -> Result<Report, Error> {
    let start = std::time::Instant::now();
    let done = match job {
        Job::Points(job) => points::run(job, diagnostics),
        Job::Bake(job) => match &job.positions {
            Some(path) => positions::run(job, path, diagnostics),
            None => bake::run(job, diagnostics),
        },
        Job::Render(job) => render::run(job, diagnostics),
        Job::View(job) => show::run(job, diagnostics),
        Job::Convert(job) => convert::run(job, diagnostics),
        Job::Info(InfoJob { stage, .. })
        | Job::Validate(stage)
        | Job::Verify(VerifyJob { stage, .. }) => Ok(Report::new(&stage.command)),
    };
    // An interrupt reaches the worker process too: what it says of its end is no news then.
    let mut report = done.map_err(|error| {
        if diagnostics.check().is_err() {
            Error::Cancelled(Cancelled)
        } else {
            error
        }
    })?;
    // Who interrupts the last write is not told of a success; its file is complete.
    diagnostics.check()?;
    report.seconds.total = start.elapsed().as_secs_f64();

    report.warnings = diagnostics.warnings();
    Ok(report)
}

/// Where an output of `job` comes from, as written into it.
fn provenance(job: &StageJob) -> crate::writers::usd::Provenance {
    crate::writers::usd::Provenance {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        command: job.command.clone(),
        comment: None,
    }
}
