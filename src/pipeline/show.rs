//! `surflux view`: a cloud or a baked stage as a picture or as a page.

use super::report::{Report, timed};
use super::world::{Needs, read_settings};
use super::{Error, StageJob, ViewJob, made_by, outputs, provenance, view};
use crate::diagnostics::Diagnostics;
use crate::receivers::camera::camera_around;
use crate::scene::Camera;
use crate::stage::cloud::{self, Found};
use crate::stage::{self, ReadSettings};
use crate::view::{Channel, PictureSettings, Subject, page, picture};
use crate::writers::image::annotated;
use crate::writers::write_whole;
use std::path::Path;

/// Pixels across when nothing says: usdrecord's.
const DEFAULT_WIDTH: u32 = 960;

/// Most pixels down.
const MOST_HEIGHT: f64 = 65_536.0;

pub(super) fn run(job: &ViewJob, diagnostics: &Diagnostics) -> Result<Report, Error> {
    let mut report = Report::new(&job.stage.command);
    let default = Path::new("view.png");
    let output = job.output.path.as_deref().unwrap_or(default);
    let time = job.stage.frames.first().copied();
    let output = outputs::frame_path(output, time);
    report.outputs = vec![output.clone()];
    outputs::check(&job.output, &report.outputs)?;
    if job.output.dry_run {
        return Ok(report);
    }
    let mut seconds = 0.0;
    let read = timed(&mut seconds, || {
        let asked = (&job.stage, job.camera.as_deref());
        read(asked, time, &mut report, diagnostics)
    });
    report.seconds.read = seconds;
    let (subject, camera) = read?;
    if subject.is_empty() {
        let path = job.stage.path.clone();
        return Err(Error::NothingToShow { path });
    }
    diagnostics.check()?;
    let channel = channel(job, &subject)?;
    report.set("aov", channel.name.clone());
    let known: Vec<&str> = subject
        .channels
        .iter()
        .map(|channel| channel.name.as_str())
        .collect();
    report.set("aovs", known);
    let is_page = output
        .extension()
        .is_some_and(|extension| extension == "html");
    let about = provenance(&job.stage);
    timed(&mut report.seconds.write, || {
        let _phase = diagnostics.phase("write", "file", 0);
        let bytes = match is_page {
            true => {
                let made = format!("{}: {}", about.program(), about.words());
                page(&subject, &channel.name, camera.as_ref(), &made).into_bytes()
            }
            false => {
                let png = picture_of(job, &subject, channel, camera);
                annotated(png, &made_by(&about.program(), &about.words()))
            }
        };
        write_whole(&output, &bytes)
    })
    .map_err(|source| Error::WritePage {
        path: output,
        source,
    })?;
    Ok(report)
}

/// What of the cloud or stage is shown, and the camera if one was asked for, by path or name.
pub(super) fn read(
    (stage, named): (&StageJob, Option<&str>),
    time: Option<f64>,
    report: &mut Report,
    diagnostics: &Diagnostics,
) -> Result<(Subject, Option<Camera>), Error> {
    let path = &stage.path;
    let _phase = diagnostics.phase("read", "file", 0);
    if let Found::Points(points, about) = cloud::find(path, diagnostics)? {
        if let Some(name) = named {
            let (name, known) = (name.to_owned(), "none (a cloud has no cameras)".to_owned());
            return Err(Error::NoCamera { name, known });
        }
        report.usd.clone_from(&about.reader);
        report.counts.surfels = points.len();
        return Ok((Subject::of_points(points, &about), None));
    }
    let mut source = stage::open(path, stage.door, diagnostics)?;
    let nothing = Needs {
        materials: false,
        solidity: false,
        lights: false,
        gloss: false,
        tolerance: None,
    };
    let settings = ReadSettings {
        all_primvars: true,
        ..read_settings(stage, time, nothing)
    };
    let scene = stage::read(source.as_mut(), &settings, diagnostics)?;
    report.usd.clone_from(&scene.stage.reader);
    report.counts.prims = scene.prims.len();
    report.counts.triangles = scene.triangle_count();
    let camera = named
        .map(|name| view::camera(&scene, Some(name)))
        .transpose()?;
    Ok((Subject::of_scene(&scene, diagnostics), camera))
}

fn channel<'a>(job: &ViewJob, subject: &'a Subject) -> Result<&'a Channel, Error> {
    let missing = |name: &str| {
        let known = subject.channels.iter().map(|channel| channel.name.as_str());
        Error::NoChannel {
            path: job.stage.path.clone(),
            name: name.to_owned(),
            known: known.collect::<Vec<_>>().join(" "),
        }
    };
    match &job.channel {
        Some(name) => subject.channel(name).ok_or_else(|| missing(name)),
        None => subject
            .channels
            .first()
            .ok_or_else(|| missing("displayColor")),
    }
}

fn picture_of(
    job: &ViewJob,
    subject: &Subject,
    channel: &Channel,
    camera: Option<Camera>,
) -> Vec<u8> {
    let camera =
        camera.unwrap_or_else(|| camera_around(subject.bounds(), subject.origin, subject.up));
    let width = job.image_width.unwrap_or(DEFAULT_WIDTH);
    let settings = PictureSettings {
        size: (width, height_of(width, &camera)),
        range: job.range,
        exposure: job.exposure,
        both_sides: job.both_sides,
    };
    picture(subject, channel, &camera, &settings)
}

/// Pixels down of a picture that is `width` across.
pub(super) fn height_of(width: u32, camera: &Camera) -> u32 {
    let aspect = match camera.horizontal_aperture > 0.0 && camera.vertical_aperture > 0.0 {
        true => camera.vertical_aperture / camera.horizontal_aperture,
        false => 1.0,
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 1…65536"
    )]
    let height = (f64::from(width) * aspect).round().clamp(1.0, MOST_HEIGHT) as u32;
    height
}
