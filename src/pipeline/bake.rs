//! `surflux bake`: light at the points of meshes, as primvars.

use super::gather::record;
use super::groups::gather_parts;
use super::job::{BakeJob, BakeView};
use super::report::{Report, peak_memory_bytes, timed};
use super::view;
use super::world::{Needs, World, with_world};
use super::{Error, gather, outputs, provenance, shots, source_of};
use crate::diagnostics::Diagnostics;
use crate::receivers::{Receivers, primvar};
use crate::results::{Aov, Results, Target};
use crate::scene::camera::Projection;
use crate::scene::{Camera, PrimId, Scene};
use crate::stage::Source;
use crate::writers::usd::layer::{BakeOptions, LayerWriter};
use glam::{DVec3, Vec3};
use std::path::{Path, PathBuf};
use std::time::Instant;

pub(super) fn run(
    job: &BakeJob,
    opened: Option<Box<dyn Source>>,
    diagnostics: &Diagnostics,
) -> Result<Report, Error> {
    let mut report = Report::new(&job.stage.command);
    let path = job.output.path.as_deref();
    let path = path.unwrap_or_else(|| Path::new("bake.usdc"));
    let planned = files(path);
    outputs::check(&job.output, &planned)?;
    if job.output.dry_run {
        report.outputs = planned;
        return Ok(report);
    }
    record(&job.gather, &job.gather.aovs, &mut report);
    let mut source = source_of(&job.stage, opened, diagnostics)?;
    let needs = match job.view {
        Some(_) => Needs::of_seen(&job.gather.aovs),
        None => Needs::of(&job.gather.aovs),
    };
    let mut writer: Option<LayerWriter> = None;
    let mut plain: Option<(Aov, LayerWriter)> = None;
    let mut camera = None;
    for time in job.stage.times() {
        with_world(
            &mut source,
            (&job.stage, time, needs.within(job.gather.tolerance)),
            &mut report,
            diagnostics,
            |world, report| {
                let (receivers, results) = bake(world, job, (&mut *report, diagnostics))?;
                camera = camera.take().or_else(|| shots::camera_of(world.scene()));
                if writer.is_none() && job.output.report.is_some() {
                    plain = timed(&mut report.seconds.pictures, || {
                        without_reflections(world, job, &receivers, (time, diagnostics))
                    })?;
                }
                let target = receivers.target;
                let Target::Primvars(spans) = &target else {
                    unreachable!("points of meshes are primvar receivers")
                };
                let writer = writer
                    .get_or_insert_with(|| LayerWriter::new(&world.scene().stage, options(job)));
                timed(&mut report.seconds.write, || {
                    writer.add((world.scene(), spans), &results, time, diagnostics);
                });
                Ok(())
            },
        )?;
    }
    report.peak_memory_bytes = peak_memory_bytes(source.source());
    let Some(writer) = writer else {
        return Err(Error::NothingToBake {
            path: job.stage.path.clone(),
        });
    };
    report.outputs = timed(&mut report.seconds.write, || {
        let _phase = diagnostics.phase("write", "file", 0);
        writer.write(path)
    })?;
    if job.output.is_pictured() {
        picture((job, camera), plain, &mut report, diagnostics)?;
    }
    Ok(report)
}

/// The layer of overs and the stage that shows it.
fn files(layer: &Path) -> Vec<PathBuf> {
    let stem = layer.file_stem().unwrap_or_default().to_string_lossy();
    vec![
        layer.to_path_buf(),
        layer.with_file_name(format!("{stem}_baked.usda")),
    ]
}

fn options(job: &BakeJob) -> BakeOptions {
    BakeOptions {
        aovs: job.gather.aovs.clone(),
        display_color: job.display_color,
        instances: job.instances,
        provenance: provenance(&job.stage),
    }
}

/// Gather at all points of one frame.
fn bake(
    world: &World<'_>,
    job: &BakeJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<(Receivers, Results), Error> {
    let scene = world.scene();
    let prims: Vec<PrimId> = (0_u32..).map(PrimId).take(scene.prims.len()).collect();
    let mut receivers = timed(&mut report.seconds.gather, || {
        primvar::place(scene, &prims, job.interpolation)
    });
    if let Some(view) = &job.view {
        look_from(view, scene, &mut receivers)?;
    }
    if receivers.is_empty() {
        return Err(Error::NothingToBake {
            path: scene.stage.path.clone(),
        });
    }
    let results = gather_parts(
        world,
        &receivers,
        &job.gather.aovs,
        &job.gather,
        (report, diagnostics),
    )?;
    Ok((receivers, results))
}

/// What a page shows beside the results, as a bake of its own.
fn without_reflections(
    world: &World<'_>,
    job: &BakeJob,
    receivers: &Receivers,
    (time, diagnostics): (Option<f64>, &Diagnostics),
) -> Result<Option<(Aov, LayerWriter)>, Error> {
    let Some(aov) = shots::paired(&job.gather.aovs, &job.gather) else {
        return Ok(None);
    };
    let Target::Primvars(spans) = &receivers.target else {
        return Ok(None);
    };
    let asked = shots::without_reflections(&job.gather, aov);
    let mut scratch = Report::new(&[]);
    let run = (&mut scratch, diagnostics);
    let results = gather::gather(world, receivers, &asked.aovs, &asked, run)?;
    let scene = world.scene();
    let options = BakeOptions {
        aovs: vec![aov],
        ..options(job)
    };
    let mut writer = LayerWriter::new(&scene.stage, options);
    let silent = Diagnostics::default();
    writer.add((scene, spans), &results, time, &silent);
    Ok(Some((aov, writer)))
}

/// Show the bake on the page, beside the one without reflections.
fn picture(
    (job, camera): (&BakeJob, Option<Camera>),
    plain: Option<(Aov, LayerWriter)>,
    report: &mut Report,
    diagnostics: &Diagnostics,
) -> Result<(), Error> {
    let start = Instant::now();
    let Some(shown) = report.outputs.get(1).cloned() else {
        return Ok(());
    };
    let scratch = |source| Error::WritePage {
        path: std::env::temp_dir(),
        source,
    };
    let folder = tempfile::tempdir().map_err(scratch)?;
    let without = match plain {
        Some((aov, writer)) => {
            let files = writer.write(&folder.path().join("plain.usdc"))?;
            files.into_iter().nth(1).map(|file| (aov, file))
        }
        None => None,
    };
    let without = without.as_ref().map(|(aov, file)| (*aov, file.as_path()));
    shots::of_bake((job, &shown, camera), without, report, diagnostics);
    report.seconds.pictures += start.elapsed().as_secs_f64();
    Ok(())
}

/// Tell `receivers` where the eye is.
fn look_from(view: &BakeView, scene: &Scene, receivers: &mut Receivers) -> Result<(), Error> {
    receivers.toward_eye = match view {
        BakeView::Along(direction) => vec![-*direction; receivers.len()],
        BakeView::Camera(name) => {
            let camera = view::camera(scene, Some(name))?;
            let along = camera.world_from_camera.transform_vector3(DVec3::NEG_Z);
            let eye = camera.world_from_camera.translation;
            let toward = |position: &Vec3| match camera.projection {
                Projection::Perspective => (eye - scene.origin - position.as_dvec3()).as_vec3(),
                Projection::Orthographic => -along.as_vec3(),
            };
            let unit = |position| toward(position).normalize_or(Vec3::Y);
            receivers.position.iter().map(unit).collect()
        }
    };
    Ok(())
}
