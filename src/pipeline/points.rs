//! `surflux points`: direct light baked into a cloud. PBGI §4.

use super::gather::dice;
use super::job::PointsJob;
use super::report::{Report, peak_memory_bytes, timed};
use super::world::{Needs, with_world};
use super::{Error, outputs, provenance, shots, source_of};
use crate::diagnostics::Diagnostics;
use crate::stage::Source;
use crate::writers::usd::cloud::{CloudOptions, write};
use std::path::Path;

pub(super) fn run(
    job: &PointsJob,
    opened: Option<Box<dyn Source>>,
    diagnostics: &Diagnostics,
) -> Result<Report, Error> {
    let mut report = Report::new(&job.stage.command);
    let pattern = job
        .output
        .path
        .as_deref()
        .unwrap_or_else(|| Path::new("cloud.usdc"));
    let frames: Vec<_> = job
        .stage
        .times()
        .into_iter()
        .map(|time| (time, outputs::frame_path(pattern, time)))
        .collect();
    report.outputs = frames.iter().map(|(_, path)| path.clone()).collect();
    outputs::check(&job.output, &report.outputs)?;
    if job.output.dry_run {
        return Ok(report);
    }
    let mut source = source_of(&job.stage, opened, diagnostics)?;
    let mut camera = None;
    for (time, path) in &frames {
        with_world(
            &mut source,
            (&job.stage, *time, Needs::ALL),
            &mut report,
            diagnostics,
            |world, report| {
                camera = camera.take().or_else(|| shots::camera_of(world.scene()));
                let baked = dice(world, (&job.bake, None), (&mut *report, diagnostics))?;
                let cloud = baked.cloud.without_holes();
                report.counts.surfels = report.counts.surfels.max(cloud.len());
                report.set("spacing", f64::from(cloud.spacing));
                timed(&mut report.seconds.write, || {
                    let _phase = diagnostics.phase("write", "file", 0);
                    let options = CloudOptions {
                        provenance: provenance(&job.stage),
                        ..CloudOptions::default()
                    };
                    write(&cloud, &world.scene().stage, path, &options)
                })?;
                Ok(())
            },
        )?;
    }
    if let Some((_, path)) = frames.first().filter(|_| job.output.is_pictured()) {
        let mut seconds = 0.0;
        timed(&mut seconds, || {
            shots::of_points((&job.stage, path, camera), &mut report, diagnostics);
        });
        report.seconds.pictures += seconds;
    }
    report.peak_memory_bytes = peak_memory_bytes(source.source());
    Ok(report)
}
