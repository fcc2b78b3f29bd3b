//! `run(Job)`: the steps in order; the only module that knows them all.

mod bake;
mod bounces;
mod choice;
mod convert;
mod gather;
mod gloss;
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
mod sheet;
mod shots;
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
pub use shots::Shot;
pub use validate::{CheckSummary, ValidationReport, validate};
pub use verify::verify;

use self::world::Frames;
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::stage::{self, Source};
use crate::writers::image::{annotated, thumbnail};
use crate::writers::write_whole;
use std::path::{Path, PathBuf};

/// Why a job failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The stage could not be read.
    #[error(transparent)]
    Stage(#[from] stage::Error),
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
    run_opened(job, None, diagnostics)
}

/// [`run`] with the job's stage, if it is open already.
///
/// # Errors
/// As [`run`].
pub fn run_opened(
    job: &Job,
    opened: Option<Box<dyn Source>>,
    diagnostics: &Diagnostics,
) -> Result<Report, Error> {
    let start = std::time::Instant::now();
    if let Some((_, output)) = told(job) {
        outputs::check(output, output.report.as_slice())?;
    }
    let done = match job {
        Job::Points(job) => points::run(job, opened, diagnostics),
        Job::Bake(job) => match &job.positions {
            Some(path) => positions::run((job, path), opened, diagnostics),
            None => bake::run(job, opened, diagnostics),
        },
        Job::Render(job) => render::run(job, opened, diagnostics),
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
    if let Some((stage, output)) = told(job) {
        tell(stage, output, &mut report)?;
    }
    Ok(report)
}

/// `opened`, or the stage of `job` opened, for reading at all its times.
fn source_of(
    job: &StageJob,
    opened: Option<Box<dyn Source>>,
    diagnostics: &Diagnostics,
) -> Result<Frames, Error> {
    let source = match opened {
        Some(source) => source,
        None => stage::open(&job.path, job.door, diagnostics)?,
    };
    Ok(Frames::of(source, job.times().len()))
}

/// The stage and the outputs of jobs that have pages and thumbnails.
fn told(job: &Job) -> Option<(&StageJob, &OutputJob)> {
    match job {
        Job::Points(job) => Some((&job.stage, &job.output)),
        Job::Bake(job) => Some((&job.stage, &job.output)),
        Job::Render(job) => Some((&job.stage, &job.output)),
        Job::View(_) | Job::Convert(_) | Job::Info(_) | Job::Validate(_) | Job::Verify(_) => None,
    }
}

/// Write the thumbnail and the page that `output` asks for.
fn tell(stage: &StageJob, output: &OutputJob, report: &mut Report) -> Result<(), Error> {
    let write = |path: &Path, bytes: &[u8]| {
        write_whole(path, bytes).map_err(|source| Error::WritePage {
            path: path.to_path_buf(),
            source,
        })
    };
    let first = report.outputs.first().filter(|_| output.thumbnail);
    if let Some(path) = first.map(|first| outputs::thumbnail_path(first)) {
        if !output.dry_run {
            outputs::check(output, std::slice::from_ref(&path))?;
            if let Some(shot) = report.shots.first() {
                let about = provenance(stage);
                let png = thumbnail(&shot.png, THUMBNAIL_WIDTH);
                let (program, words) = (about.program(), about.words());
                write(&path, &annotated(png, &made_by(&program, &words)))?;
            }
        }
        report.outputs.push(path);
    }
    if let Some(page) = &output.report {
        let name = stage.path.file_name().unwrap_or_default().to_string_lossy();
        if !output.dry_run {
            write(page, sheet::sheet(report, &name, page).as_bytes())?;
        }
        report.outputs.push(page.clone());
    }
    Ok(())
}

/// Pixels across.
const THUMBNAIL_WIDTH: u32 = 256;

/// What a picture tells of itself.
fn made_by<'a>(program: &'a str, words: &'a str) -> [(&'static str, &'a str); 2] {
    [("Software", program), ("Comment", words)]
}

/// Where an output of `job` comes from, as written into it.
fn provenance(job: &StageJob) -> crate::writers::usd::Provenance {
    crate::writers::usd::Provenance {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        command: job.command.clone(),
        comment: None,
    }
}
