//! `surflux verify`: speed against error of every engine, on the scene that is given.

use super::choice::{self, PAPER_KNOBS, paper_knobs};
use super::gather::{Light, Stand, light};
use super::job::VerifyJob;
use super::report::Report;
use super::view::camera;
use super::world::{Needs, World, with_world};
use super::{Error, outputs};
use crate::diagnostics::Diagnostics;
use crate::gather::estimate::spread;
use crate::gather::{GatherScene, RaysSettings};
use crate::lighting::{LightSamples, Lighting};
use crate::pilot::Method;
use crate::pilot::error::Truth;
use crate::receivers::lens::Frame;
use crate::receivers::{self, Receivers, primvar};
use crate::results::Aov;
use crate::scene::PrimId;
use crate::stage;
use crate::verify::{
    Auto, ErrorPicture, Machine, Question, Set, Subject, VerifyReport, label, look, measure, page,
    picture, signed, truth,
};
use crate::writers::write_whole;
use std::time::Instant;

/// Tolerances that `auto` is asked for.
const TOLERANCES: [f64; 3] = [0.05, 0.02, 0.01];

/// Rays a receiver that are swept.
const RAYS: [u32; 5] = [16, 64, 256, 1024, 4096];

/// Knobs of the paper's engine that are swept besides those that `auto` knows.
const MORE_PAPER_KNOBS: [(f32, u32); 1] = [(0.3, 6)];

/// Pixels across of the camera's set and pictures; the height follows the aperture.
const PICTURE_WIDTH: u32 = 64;

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
    let mut source = stage::open(&job.stage.path, job.stage.door, diagnostics)?;
    let time = job.stage.frames.first().copied();
    let work = |world: &World<'_>, report: &mut Report| sweep(world, job, (report, diagnostics));
    let mut found = with_world(
        source.as_mut(),
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
        (report, diagnostics),
    )?;
    if let Light::Baked(baked) = &lit {
        populations.push(("surfels", receivers::surfel::place(&baked.cloud)));
    }
    let mut found = empty(job, world, lit.len());
    let finer = Lighting::new(world.shader, truth_samples(), diagnostics);
    let asked = asked(world);
    let arena = Arena {
        world,
        job,
        lit: &lit,
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
    let camera = camera(scene, job.camera.as_deref())?;
    let aspect = if camera.horizontal_aperture > 0.0 {
        camera.vertical_aperture / camera.horizontal_aperture
    } else {
        1.0
    };
    let frame = Frame::new(PICTURE_WIDTH, picture_height(aspect));
    let pixels = receivers::camera::place(scene, &world.tracer, &camera, frame, 1);
    let mut populations = vec![("points", points), ("pixels", pixels)];
    populations.retain(|(_, all)| !all.is_empty());
    if populations.is_empty() {
        return Err(Error::NothingToBake {
            path: scene.stage.path.clone(),
        });
    }
    Ok(populations)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 1…256"
)]
fn picture_height(aspect: f64) -> u32 {
    (f64::from(PICTURE_WIDTH) * aspect)
        .round()
        .clamp(1.0, 256.0) as u32
}

/// What all measurements share.
struct Arena<'a> {
    world: &'a World<'a>,
    job: &'a VerifyJob,
    lit: &'a Light,
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
        let none = Light::None;
        // Rays that need not know what they hit are faster: visibility is measured as occlusion bakes compute it.
        let dark = !aov.needs_indirect();
        let light = if dark { &none } else { self.lit };
        let stand = Stand::new(self.world, light, all, &aovs, &self.job.gather);
        let mut question = self.question(aov, &stand);
        for tolerance in TOLERANCES {
            question
                .subjects
                .push(auto(&stand, tolerance, diagnostics)?);
        }
        let set = Set {
            name,
            receivers: all.subset(&spread(all.len(), self.job.receivers)),
            population: all.len(),
        };
        let (summary, rows) = measure(&question, &set, diagnostics)?;
        found.truth.push(summary);
        found.rows.extend(rows);
        if name == "pixels" {
            let pictures = pictures(&question, all, self.job.truth_rays, &stand, diagnostics)?;
            found.pictures.extend(pictures);
        }
        Ok(())
    }

    fn question<'s>(&'s self, aov: Aov, stand: &'s Stand<'_>) -> Question<'s> {
        let half = |turn: f32| {
            let settings = RaysSettings {
                turn,
                ..stand.rays_settings(self.job.truth_rays)
            };
            Box::new(stand.rays_with(settings)) as Box<dyn Method + 's>
        };
        let rays = RAYS.iter().map(|&rays| Subject {
            engine: "rays",
            knobs: vec![("rays", f64::from(rays))],
            method: Box::new(stand.rays_with(stand.rays_settings(rays))) as Box<dyn Method + 's>,
            auto: None,
        });
        let paper = MORE_PAPER_KNOBS
            .iter()
            .chain(&PAPER_KNOBS)
            .map(|&knobs| Subject {
                engine: "paper",
                knobs: paper_knobs(knobs),
                method: Box::new(self.surfels.paper(knobs)) as Box<dyn Method + 's>,
                auto: None,
            });
        Question {
            aov,
            scene: stand.scene(),
            truth_scene: GatherScene {
                lighting: Some(self.finer),
                ..stand.scene()
            },
            // Turns that neither the run's pattern (0) nor the pilot's (multiples of 1/√2) have.
            truth: [half(0.3), half(0.58)],
            subjects: rays.chain(paper).collect(),
        }
    }
}

/// What `--tolerance` picks for all of `stand`'s receivers.
fn auto<'s>(
    stand: &'s Stand<'_>,
    tolerance: f64,
    diagnostics: &Diagnostics,
) -> Result<Subject<'s>, Error> {
    let outcome = choice::look(stand, tolerance, diagnostics)?;
    let auto = Auto {
        tolerance,
        estimate: outcome.worst(),
        pilot_microseconds: 1e6 * outcome.seconds / stand.receivers.len().max(1) as f64,
    };
    let rays = outcome.rays.unwrap_or(RAYS[0]);
    let (engine, knobs, method): (_, _, Box<dyn Method + 's>) = match outcome.candidate {
        Some(i) => (
            "paper",
            paper_knobs(PAPER_KNOBS[i]),
            Box::new(stand.paper(PAPER_KNOBS[i])),
        ),
        None => (
            "rays",
            vec![("rays", f64::from(rays))],
            Box::new(stand.rays_with(stand.rays_settings(rays))),
        ),
    };
    Ok(Subject {
        engine,
        knobs,
        method,
        auto: Some(auto),
    })
}

/// Rays of the truth of a whole picture, at most: it is there to look at.
const PICTURE_RAYS: u32 = 2048;

/// Error at full color, at least, and at most.
const SCALES: (f64, f64) = (0.01, 0.2);

/// Errors of few and many rays and of the paper's engine as a camera sees them.
fn pictures(
    question: &Question<'_>,
    all: &Receivers,
    truth_rays: u32,
    stand: &Stand<'_>,
    diagnostics: &Diagnostics,
) -> Result<Vec<ErrorPicture>, Error> {
    let half = |turn: f32| {
        let settings = RaysSettings {
            turn,
            ..stand.rays_settings(truth_rays.min(PICTURE_RAYS))
        };
        Box::new(stand.rays_with(settings)) as Box<dyn Method + '_>
    };
    let shown = Question {
        aov: question.aov,
        scene: question.scene,
        truth_scene: question.truth_scene,
        truth: [half(0.3), half(0.58)],
        subjects: Vec::new(),
    };
    let truth: Truth = truth(&shown, all, diagnostics)?;
    let wanted = |subject: &&Subject<'_>| {
        let knob = |name| subject.knobs.iter().find(|(knob, _)| *knob == name);
        let rays = knob("rays").is_some_and(|(_, n)| [64.0, 256.0].contains(n));
        subject.auto.is_none()
            && (rays || knob("raster_resolution").is_some_and(|(_, n)| *n == 12.0))
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
