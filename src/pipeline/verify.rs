//! `surflux verify`: speed against error of every engine, on the scene that is given.

mod subjects;

use super::gather::{Light, light};
use super::job::{GatherJob, VerifyJob};
use super::report::Report;
use super::spacing::{self, Asked, Lit};
use super::stand::Stand;
use super::view::camera;
use super::world::{Frames, Needs, World, with_world};
use super::{Error, outputs};
use crate::diagnostics::Diagnostics;
use crate::gather::estimate::spread;
use crate::gather::{GatherScene, RaysEngine, RaysSettings};
use crate::lighting::{LightSamples, Lighting};
use crate::pilot::Method;
use crate::pilot::error::Truth;
use crate::receivers::lens::Frame;
use crate::receivers::{self, Receivers, primvar};
use crate::results::Aov;
use crate::scene::PrimId;
use crate::stage;
use crate::verify::{
    ErrorPicture, Machine, Question, Set, Subject, VerifyReport, label, look, measure, page,
    picture, signed, truth,
};
use crate::writers::write_whole;
use std::time::Instant;
use subjects::{Swept, auto};

/// Pixels across of the camera's set; the height follows the aperture.
const SET_WIDTH: u32 = 512;

/// Pixels across of pictures of errors: their truth takes a few thousand rays a pixel.
const PICTURE_WIDTH: u32 = 64;

/// Times the surfels in the truth, and how many at most: where errors fall with the spacing, theirs is a third.
const FINER: f32 = 8.0;
const MOST_SURFELS: usize = 1_000_000;

/// Times the usual light samples in the truth.
const TRUTH_LIGHT: u32 = 16;

/// Measure, and write the page if one is wanted.
///
/// # Errors
/// The first thing that went wrong.
pub fn verify(job: &VerifyJob, diagnostics: &Diagnostics) -> Result<VerifyReport, Error> {
    let start = Instant::now();
    let planned: Vec<_> = job.output.path.iter().cloned().collect();
    outputs::check(&job.output, &planned)?;
    let mut report = Report::new(&job.stage.command);
    let source = stage::open(&job.stage.path, job.stage.door, diagnostics)?;
    let mut source = Frames::of(source, 1);
    let time = job.stage.frames.first().copied();
    let work = |world: &World<'_>, report: &mut Report| sweep(world, job, (report, diagnostics));
    let mut found = with_world(
        &mut source,
        (&job.stage, time, Needs::ALL),
        &mut report,
        diagnostics,
        work,
    )?;
    found.seconds = start.elapsed().as_secs_f64();
    found.warnings = diagnostics.warnings();
    if let Some(path) = job.output.path.as_ref().filter(|_| !job.output.dry_run) {
        write_whole(path, page(&found).as_bytes()).map_err(|source| Error::WritePage {
            path: path.clone(),
            source,
        })?;
    }
    Ok(found)
}

fn sweep(
    world: &World<'_>,
    job: &VerifyJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<VerifyReport, Error> {
    let mut populations = populations(world, job)?;
    let placed = populations[0].1.clone();
    let indirect = [Aov::IrradianceIndirect];
    let lit = light(
        world,
        &placed,
        &indirect,
        &job.gather,
        (&mut *report, diagnostics),
    )?;
    let lit = Lit::from(lit);
    let finer = Lighting::new(world.shader, truth_samples(), diagnostics);
    let is_exact = Stand::new(world, &lit, &placed, &indirect, &job.gather)
        .rays_lit_at_hits(&finer, RaysSettings::default())
        .is_some();
    // Where light can be found at hits, the truth has no surfels.
    let finest = if is_exact {
        Lit::from(Light::None)
    } else {
        let finer = GatherJob {
            spacing: job.gather.spacing.map(|spacing| spacing / FINER.sqrt()),
            surfels: Some(finer_count(lit.light.len())),
            ..job.gather.clone()
        };
        let run = (report, diagnostics);
        Lit::from(light(world, &placed, &indirect, &finer, run)?)
    };
    if let Light::Baked(baked) = &lit.light {
        populations.push(("surfels", receivers::surfel::place(&baked.cloud)));
    }
    let is_wanted = |name: &str| job.sets.is_empty() || job.sets.iter().any(|set| set == name);
    populations.retain(|(name, _)| is_wanted(name));
    if populations.is_empty() {
        return Err(Error::NothingToBake {
            path: world.scene().stage.path.clone(),
        });
    }
    let mut found = empty(job, world, lit.light.len());
    let mut asked = asked(world);
    asked.retain(|aov| job.gather.aovs.is_empty() || job.gather.aovs.contains(aov));
    let arena = Arena {
        world,
        job,
        lit: &lit,
        finest: &finest,
        surfels: &Stand::new(world, &lit, &placed, &indirect, &job.gather),
        finer: &finer,
    };
    let phase = diagnostics.phase("verify", "sets", (asked.len() * populations.len()) as u64);
    for &aov in &asked {
        for (name, all) in &populations {
            arena.run((name, all), aov, &mut found, diagnostics)?;
            phase.advance(1);
        }
    }
    Ok(found)
}

/// Surfels of the truth for `count` of the run.
fn finer_count(count: usize) -> usize {
    (8 * count).min(MOST_SURFELS.max(count))
}

fn empty(job: &VerifyJob, world: &World<'_>, surfels: usize) -> VerifyReport {
    let scene = world.scene();
    VerifyReport {
        surflux: env!("CARGO_PKG_VERSION"),
        command: job.stage.command.clone(),
        stage: scene.stage.path.display().to_string(),
        usd: scene.stage.reader.clone(),
        machine: Machine::here(),
        triangles: scene.triangle_count(),
        surfels,
        truth: Vec::new(),
        rows: Vec::new(),
        seconds: 0.0,
        warnings: Vec::new(),
        pictures: Vec::new(),
    }
}

fn truth_samples() -> LightSamples {
    let usual = LightSamples::default();
    LightSamples {
        environment: usual.environment * TRUTH_LIGHT,
        ..usual
    }
}

/// AOVs that engines differ in.
fn asked(world: &World<'_>) -> Vec<Aov> {
    let mut aovs = vec![Aov::Visibility, Aov::IrradianceIndirect];
    if world.lighting.has_environment() {
        aovs.push(Aov::IrradianceEnvironment);
    }
    aovs
}

/// All points of meshes and all pixels of the camera.
fn populations(
    world: &World<'_>,
    job: &VerifyJob,
) -> Result<Vec<(&'static str, Receivers)>, Error> {
    let scene = world.scene();
    let prims: Vec<PrimId> = (0_u32..).map(PrimId).take(scene.prims.len()).collect();
    let points = primvar::place(scene, &prims, crate::results::BakeInterpolation::Vertex);
    let pixels = pixels(world, job, SET_WIDTH)?;
    let mut populations = vec![("points", points), ("pixels", pixels)];
    populations.retain(|(_, all)| !all.is_empty());
    if populations.is_empty() {
        return Err(Error::NothingToBake {
            path: scene.stage.path.clone(),
        });
    }
    Ok(populations)
}

/// What the camera sees, `width` pixels across.
fn pixels(world: &World<'_>, job: &VerifyJob, width: u32) -> Result<Receivers, Error> {
    let scene = world.scene();
    let camera = camera(scene, job.camera.as_deref())?;
    let aspect = if camera.horizontal_aperture > 0.0 {
        camera.vertical_aperture / camera.horizontal_aperture
    } else {
        1.0
    };
    let frame = Frame::new(width, height(width, aspect));
    Ok(receivers::camera::place(
        scene,
        &world.tracer,
        &camera,
        frame,
        1,
    ))
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 1…1024"
)]
fn height(width: u32, aspect: f64) -> u32 {
    (f64::from(width) * aspect).round().clamp(1.0, 1024.0) as u32
}

/// What all measurements share.
struct Arena<'a> {
    world: &'a World<'a>,
    job: &'a VerifyJob,
    lit: &'a Lit,
    /// Surfels of the truth, where it needs some.
    finest: &'a Lit,
    /// For the octree, which all share.
    surfels: &'a Stand<'a>,
    finer: &'a Lighting,
}

impl Arena<'_> {
    /// Measure `aov` at one population; pictures too where a camera placed it.
    fn run(
        &self,
        (name, all): (&'static str, &Receivers),
        aov: Aov,
        found: &mut VerifyReport,
        diagnostics: &Diagnostics,
    ) -> Result<(), Error> {
        let aovs = [aov];
        let none = Light::None.into();
        // Rays that need not know what they hit are faster: visibility is measured as occlusion bakes compute it.
        let dark = !aov.needs_indirect();
        let lit = if dark { &none } else { self.lit };
        let finest = if dark { &none } else { self.finest };
        let stand = Stand::new(self.world, lit, all, &aovs, &self.job.gather);
        let truth = Stand::new(self.world, finest, all, &aovs, &self.job.gather);
        let tuned = self.tuned(all, aov, diagnostics)?;
        let stand_on = |tuned| Stand::new(self.world, tuned, all, &aovs, &self.job.gather);
        let stands: Vec<Stand<'_>> = tuned.iter().map(stand_on).collect();
        let mut question = self.question(aov, &stand, &truth, diagnostics);
        for ((stand, lit), &tolerance) in stands.iter().zip(&tuned).zip(&self.job.tolerances) {
            let subject = auto(stand, tolerance, lit.judging, diagnostics)?;
            question.subjects.push(subject);
        }
        let set = Set::new(name, all, spread(all.len(), self.job.receivers));
        let (summary, rows) = measure(&question, &set, diagnostics)?;
        found.truth.push(summary);
        found.rows.extend(rows);
        if name == "pixels" && !self.job.only_auto {
            let seen = pixels(self.world, self.job, PICTURE_WIDTH)?;
            let half = |turn: f32| {
                let settings = RaysSettings {
                    turn,
                    ..truth.rays_settings((self.job.truth_rays / 4).min(PICTURE_RAYS))
                };
                Box::new(self.truth((&stand, &truth), settings)) as Box<dyn Method + '_>
            };
            let halves = [half(0.3), half(0.58)];
            let pictures = pictures(&question, &seen, halves, diagnostics)?;
            found.pictures.extend(pictures);
        }
        Ok(())
    }

    /// Surfels as each tolerance asks for them.
    fn tuned(
        &self,
        all: &Receivers,
        aov: Aov,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Lit>, Error> {
        let tune = |&tolerance: &f64| {
            let job = GatherJob {
                tolerance: Some(tolerance),
                ..self.job.gather.clone()
            };
            let mut report = Report::new(&[]);
            let run = (&mut report, diagnostics);
            let asked = Asked {
                receivers: all,
                aovs: &[aov],
                beside: &[],
            };
            spacing::lit(self.world, asked, &job, run)
        };
        self.job.tolerances.iter().map(tune).collect()
    }

    /// Rays that find light anew at every hit, on the sides that have surfels on `stand`; or that read the finest surfels.
    fn truth<'s>(
        &'s self,
        (stand, finest): (&'s Stand<'_>, &'s Stand<'_>),
        settings: RaysSettings,
    ) -> RaysEngine<'s> {
        let exact = stand.rays_lit_at_hits(self.finer, settings);
        exact.unwrap_or_else(|| finest.rays_with(settings))
    }

    fn question<'s>(
        &'s self,
        aov: Aov,
        stand: &'s Stand<'_>,
        truth: &'s Stand<'_>,
        diagnostics: &Diagnostics,
    ) -> Question<'s> {
        let half = |turn: f32| {
            let settings = RaysSettings {
                turn,
                ..truth.rays_settings(self.job.truth_rays)
            };
            Box::new(self.truth((stand, truth), settings)) as Box<dyn Method + 's>
        };
        let swept = Swept {
            world: self.world,
            surfels: self.surfels,
            max_distance: self.job.gather.max_distance,
        };
        Question {
            aov,
            scene: stand.scene(),
            truth_scene: GatherScene {
                lighting: Some(self.finer),
                ..stand.scene()
            },
            // Turns that neither the run's pattern (0) nor the pilot's (multiples of 1/√2) have.
            truth: [half(0.3), half(0.58)],
            subjects: if self.job.only_auto {
                Vec::new()
            } else {
                swept.subjects(aov, stand, diagnostics)
            },
        }
    }
}

/// Rays of the truth of a whole picture, at most: it is there to look at.
const PICTURE_RAYS: u32 = 2048;

/// Error at full color, at least, and at most.
const SCALES: (f64, f64) = (0.01, 0.2);

/// Errors of few and many rays and of the paper's engine as a camera sees them.
fn pictures<'s>(
    question: &'s Question<'_>,
    all: &Receivers,
    halves: [Box<dyn Method + 's>; 2],
    diagnostics: &Diagnostics,
) -> Result<Vec<ErrorPicture>, Error> {
    let shown = Question {
        aov: question.aov,
        scene: question.scene,
        truth_scene: question.truth_scene,
        truth: halves,
        subjects: Vec::new(),
    };
    let truth: Truth = truth(&shown, all, diagnostics)?;
    let wanted = |subject: &&Subject<'_>| {
        let is = |name, value: f64| subject.knobs.contains(&(name, value));
        let maps = is("directions", 256.0) && is("pixel", 1.0);
        let paper = is("raster_resolution", 12.0);
        subject.auto.is_none() && (is("rays", 64.0) || is("rays", 256.0) || maps || paper)
    };
    let mut errors = Vec::new();
    for subject in question.subjects.iter().filter(wanted) {
        let values = look(question, subject.method.as_ref(), all, diagnostics)?;
        let title = format!(
            "{}: {}",
            question.aov.name(),
            label(subject.engine, &subject.knobs)
        );
        errors.push((title, signed(&values, &truth)));
    }
    // One scale for all, so that they can be compared: twice the middle one's rms.
    let mut sizes: Vec<f64> = errors.iter().map(|(_, errors)| rms(errors)).collect();
    sizes.sort_by(f64::total_cmp);
    let middle = sizes.get(sizes.len() / 2).copied().unwrap_or(SCALES.0);
    let scale = (2.0 * middle).clamp(SCALES.0, SCALES.1);
    Ok(errors
        .into_iter()
        .filter_map(|(title, errors)| picture(title, &errors, &all.target, scale))
        .collect())
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len().max(1) as f64).sqrt()
}
