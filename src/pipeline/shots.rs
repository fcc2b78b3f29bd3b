//! Pictures of what a run made, for its page and its thumbnail: of the first frame, with and without reflected light.

use super::report::Report;
use super::view::View;
use super::{BakeJob, EngineChoice, GatherJob, RenderJob, StageJob, show};
use crate::bounce::Bounces;
use crate::diagnostics::{Diagnostics, Silent};
use crate::receivers::camera::camera_around;
use crate::receivers::lens::Frame;
use crate::results::{Aov, AovImage};
use crate::scene::{Camera, Scene};
use crate::view::{Channel, PictureSettings, Subject, picture};
use crate::writers::image::png_to_look_at;
use std::path::Path;

/// Pixels across, at most.
const WIDTH: u32 = 640;

/// Rays a receiver of a picture without reflected light: enough to look at.
const RAYS: u32 = 256;

/// Samples along a pixel's side of such a picture, at most.
pub(super) const PIXEL_SAMPLES: u32 = 2;

/// Title of the picture without reflected light.
const WITHOUT: &str = "without reflected light";

/// One picture.
#[derive(Debug, Clone)]
pub struct Shot {
    /// What it shows.
    pub title: String,
    /// A PNG of at most 640 pixels across.
    pub png: Vec<u8>,
    /// True for the two that stand side by side, with and without reflected light.
    pub is_of_pair: bool,
}

impl Shot {
    fn new(title: impl Into<String>, png: Vec<u8>) -> Self {
        Self {
            title: title.into(),
            png,
            is_of_pair: false,
        }
    }

    fn pair(self) -> Self {
        Self {
            is_of_pair: true,
            ..self
        }
    }
}

/// What of `aovs` is shown with and without reflected light; `None` where nothing is, or where nothing is reflected.
pub(super) fn paired(aovs: &[Aov], job: &GatherJob) -> Option<Aov> {
    let all = [Aov::Color, Aov::Irradiance];
    let reflects = job.bounces != Bounces::Count(0);
    all.into_iter().find(|aov| reflects && aovs.contains(aov))
}

/// `job` for what light is before it is reflected, good enough to look at.
pub(super) fn without_reflections(job: &GatherJob, aov: Aov) -> GatherJob {
    GatherJob {
        aovs: vec![aov],
        bounces: Bounces::Count(0),
        engine: EngineChoice::Rays,
        tolerance: None,
        rays: RAYS,
        clouds: Vec::new(),
        splits_clouds: false,
        ..job.clone()
    }
}

/// `view` small, for `aov` alone.
pub(super) fn small(view: &View, aov: Aov) -> View {
    let Frame { width, height, .. } = view.frame;
    let across = width.min(WIDTH);
    let down = u64::from(height) * u64::from(across) / u64::from(width.max(1));
    View {
        camera: view.camera.clone(),
        frame: Frame {
            width: across,
            height: u32::try_from(down).unwrap_or(height).max(1),
            ..view.frame
        },
        aovs: vec![aov],
        output: view.output.clone(),
    }
}

/// Show what a render wrote, and `without`, the first of the two that stand side by side.
pub(super) fn of_render(
    images: &[AovImage],
    without: Option<&AovImage>,
    (job, name): (&RenderJob, &Path),
    report: &mut Report,
) {
    let several = job.output.path.is_none();
    let label = |image: &AovImage| match several {
        true => format!("{} ({})", image.name(), name.display()),
        false => image.name().into_owned(),
    };
    let shot = |image: &AovImage| Shot::new(label(image), png_to_look_at(image, None, WIDTH));
    let with = |image: &&AovImage| {
        without.is_some_and(|other| image.aov == other.aov && image.group.is_none())
    };
    if let Some((with, without)) = images.iter().find(with).zip(without) {
        let png = png_to_look_at(without, Some(with), WIDTH);
        report.shots.push(shot(with).pair());
        let title = format!("{} {WITHOUT}", label(with));
        report.shots.push(Shot::new(title, png).pair());
    }
    let others = images.iter().filter(|image| !with(image));
    report.shots.extend(others.map(shot));
}

/// What the page looks through: the camera of the stage's render settings, else its first; `None` without cameras.
pub(super) fn camera_of(scene: &Scene) -> Option<Camera> {
    let named = |path: &String| scene.cameras.iter().find(|camera| camera.path == *path);
    let mut settings = scene.render_settings.iter();
    let of_settings = settings.find_map(|settings| {
        let products = settings.products.iter();
        let mut asked = settings
            .camera
            .iter()
            .chain(products.filter_map(|product| product.camera.as_ref()));
        asked.find_map(named)
    });
    of_settings.or_else(|| scene.cameras.first()).cloned()
}

/// Show the cloud `file` as `camera` sees it, or from where all of it is seen.
pub(super) fn of_points(
    (stage, file, camera): (&StageJob, &Path, Option<Camera>),
    report: &mut Report,
    diagnostics: &Diagnostics,
) {
    let Some(subject) = subject(stage, file, diagnostics) else {
        return;
    };
    let names = ["displayColor", "albedo", "emission", "area", "N"];
    let channels = names.iter().filter_map(|name| subject.channel(name));
    let camera = camera.unwrap_or_else(|| around(&subject));
    for channel in channels.filter(|channel| channel.values.iter().any(|x| *x != 0.0)) {
        let png = seen(&subject, channel, (&camera, None));
        report.shots.push(Shot::new(channel.name.clone(), png));
    }
}

/// Show the bake that the stage `file` shows, and the one in `without`, as [`of_points`] does.
pub(super) fn of_bake(
    (job, file, camera): (&BakeJob, &Path, Option<Camera>),
    without: Option<(Aov, &Path)>,
    report: &mut Report,
    diagnostics: &Diagnostics,
) {
    let Some(subject) = subject(&job.stage, file, diagnostics) else {
        return;
    };
    let camera = camera.unwrap_or_else(|| around(&subject));
    if let Some((aov, file)) = without
        && let Some(other) = self::subject(&job.stage, file, diagnostics)
        && let Some((with, plain)) = subject.channel(aov.name()).zip(other.channel(aov.name()))
    {
        let exposure = Some(with.exposure());
        let png = seen(&subject, with, (&camera, exposure));
        report.shots.push(Shot::new(aov.name(), png).pair());
        let png = seen(&other, plain, (&camera, exposure));
        let title = format!("{} {WITHOUT}", aov.name());
        report.shots.push(Shot::new(title, png).pair());
    }
    let paired = without.map(|(aov, _)| aov.name());
    for aov in &job.gather.aovs {
        let of_group = |name: &str| {
            let group = name
                .strip_prefix(aov.name())
                .and_then(|rest| rest.strip_prefix('_'));
            group.is_some_and(|group| {
                group == "default"
                    || (job.stage.light_groups.iter()).any(|choice| choice.name() == group)
            })
        };
        let is_shown = |channel: &&Channel| {
            let name = channel.name.as_str();
            (name == aov.name() && Some(name) != paired)
                || aov.part_names().first() == Some(&name)
                || of_group(name)
        };
        for channel in subject.channels.iter().filter(is_shown) {
            let png = seen(&subject, channel, (&camera, None));
            report.shots.push(Shot::new(channel.name.clone(), png));
        }
    }
}

/// What `file` holds at the run's first frame. What is odd about it was told when it was made: nothing is told twice.
fn subject(stage: &StageJob, file: &Path, diagnostics: &Diagnostics) -> Option<Subject> {
    let stage = StageJob {
        path: file.to_path_buf(),
        ..stage.clone()
    };
    let time = stage.frames.first().copied();
    let silent = Diagnostics::new(Box::new(Silent), diagnostics.cancel_token().clone());
    let mut scratch = Report::new(&[]);
    match show::read((&stage, None), time, &mut scratch, &silent) {
        Ok((subject, _)) => (!subject.is_empty()).then_some(subject),
        Err(error) => {
            let message = format!("it is not shown on the page: {error}");
            diagnostics.warn("no-picture", file.display().to_string(), message);
            None
        }
    }
}

fn around(subject: &Subject) -> Camera {
    camera_around(subject.bounds(), subject.origin, subject.up)
}

fn seen(
    subject: &Subject,
    channel: &Channel,
    (camera, exposure): (&Camera, Option<f32>),
) -> Vec<u8> {
    let settings = PictureSettings {
        size: (WIDTH, show::height_of(WIDTH, camera)),
        range: None,
        exposure,
        both_sides: false,
    };
    picture(subject, channel, camera, &settings)
}
