//! `surflux bake`: light at the points of meshes, as primvars.

use super::gather::record;
use super::groups::gather_parts;
use super::job::{BakeJob, BakeView};
use super::report::{Report, peak_memory_bytes, timed};
use super::view::camera;
use super::world::{Needs, World, with_world};
use super::{Error, outputs, provenance};
use crate::diagnostics::Diagnostics;
use crate::receivers::{Receivers, primvar};
use crate::results::{Results, Target};
use crate::scene::camera::Projection;
use crate::scene::{PrimId, Scene};
use crate::stage;
use crate::writers::usd::layer::{BakeOptions, LayerWriter};
use glam::{DVec3, Vec3};
use std::path::{Path, PathBuf};

pub(super) fn run(job: &BakeJob, diagnostics: &Diagnostics) -> Result<Report, Error> {
    let mut report = Report::new(&job.stage.command);
    let path = job
        .output
        .path
        .as_deref()
        .unwrap_or_else(|| Path::new("bake.usdc"));
    let planned = files(path);
    outputs::check(&job.output, &planned)?;
    if job.output.dry_run {
        report.outputs = planned;
        return Ok(report);
    }
    record(&job.gather, &job.gather.aovs, &mut report);
    let mut source = stage::open(&job.stage.path, job.stage.door, diagnostics)?;
    source.expect_loads(job.stage.times().len());
    let needs = match job.view {
        Some(_) => Needs::of_seen(&job.gather.aovs),
        None => Needs::of(&job.gather.aovs),
    };
    let mut writer: Option<LayerWriter> = None;
    for time in job.stage.times() {
        with_world(
            source.as_mut(),
            (&job.stage, time, needs),
            &mut report,
            diagnostics,
            |world, report| {
                let (target, results) = bake(world, job, (&mut *report, diagnostics))?;
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
    report.peak_memory_bytes = peak_memory_bytes(source.as_ref());
    let Some(writer) = writer else {
        return Err(Error::NothingToBake {
            path: job.stage.path.clone(),
        });
    };
    report.outputs = timed(&mut report.seconds.write, || {
        let _phase = diagnostics.phase("write", "file", 0);
        writer.write(path)
    })?;
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
) -> Result<(Target, Results), Error> {
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
    Ok((receivers.target, results))
}

/// Tell `receivers` where the eye is.
fn look_from(view: &BakeView, scene: &Scene, receivers: &mut Receivers) -> Result<(), Error> {
    receivers.toward_eye = match view {
        BakeView::Along(direction) => vec![-*direction; receivers.len()],
        BakeView::Camera(name) => {
            let camera = camera(scene, Some(name))?;
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
