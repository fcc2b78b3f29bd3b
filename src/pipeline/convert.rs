//! `surflux convert`: one format into another, by the names' endings and what is in the files.

use super::report::{Report, timed};
use super::world::{Needs, read_settings};
use super::{ConvertJob, Error, outputs, provenance};
use crate::diagnostics::Diagnostics;
use crate::exchange::{glb, gltf, las, ply, ptc};
use crate::scene::{Scene, StageInfo, UpAxis};
use crate::stage::cloud::{self, Found};
use crate::stage::{self, ReadSettings};
use crate::surfels::points::PointSet;
use crate::surfels::splats::Splats;
use crate::writers::usd;
use std::path::Path;

/// Meters a unit of formats that have none.
const METER: f64 = 1.0;

/// What can be made of what.
const WAYS: &str = "there are ways from .gltf and .glb to USD, from USD stages to .glb, between USD clouds, .ply and .ptc, and from .las and .laz to all three";

/// What was read.
enum Read {
    Points(PointSet, StageInfo),
    Splats(Splats, StageInfo),
    Scene(Box<Scene>),
}

pub(super) fn run(job: &ConvertJob, diagnostics: &Diagnostics) -> Result<Report, Error> {
    let mut report = Report::new(&job.stage.command);
    let output = job.output.path.clone().unwrap_or_default();
    report.outputs = vec![output.clone()];
    outputs::check(&job.output, &report.outputs)?;
    if job.output.dry_run {
        return Ok(report);
    }
    if matches!(ending(&job.stage.path).as_str(), "glb" | "gltf") {
        return gltf_to_usd(job, report, diagnostics);
    }
    let mut seconds = 0.0;
    let read = timed(&mut seconds, || read(job, &mut report, diagnostics));
    report.seconds.read = seconds;
    let read = read?;
    diagnostics.check()?;
    let mut seconds = 0.0;
    timed(&mut seconds, || write(job, read, &output, diagnostics))?;
    report.seconds.write = seconds;
    Ok(report)
}

fn gltf_to_usd(
    job: &ConvertJob,
    mut report: Report,
    diagnostics: &Diagnostics,
) -> Result<Report, Error> {
    let output = job.output.path.clone().unwrap_or_default();
    if !ending(&output).starts_with("usd") {
        return Err(no_way(job));
    }
    let _phase = diagnostics.phase("write", "file", 0);
    let mut seconds = 0.0;
    let converted = timed(&mut seconds, || {
        gltf::to_usd(
            (&job.stage.path, &output),
            &provenance(&job.stage),
            diagnostics,
        )
    })?;
    report.seconds.write = seconds;
    report.outputs = converted.outputs;
    report.counts.prims = converted.prims;
    report.counts.triangles = converted.triangles;
    Ok(report)
}

fn ending(path: &Path) -> String {
    let ending = path.extension().unwrap_or_default();
    ending.to_string_lossy().to_ascii_lowercase()
}

fn read(job: &ConvertJob, report: &mut Report, diagnostics: &Diagnostics) -> Result<Read, Error> {
    let path = &job.stage.path;
    let _phase = diagnostics.phase("read", "file", 0);
    let read = match ending(path).as_str() {
        "ply" if ply::splats::is_splats(path) => {
            Read::Splats(ply::splats::read(path)?, said(job, None))
        }
        "ply" => {
            let (points, about) = ply::read(path, diagnostics)?;
            Read::Points(points, said(job, about))
        }
        "ptc" => Read::Points(ptc::read(path, diagnostics)?, said(job, None)),
        "las" | "laz" => {
            let mut about = said(job, None);
            about.up_axis = job.up_axis.unwrap_or(UpAxis::Z);
            Read::Points(las::read(path, diagnostics)?, about)
        }
        "usd" | "usda" | "usdc" | "usdz" => read_usd(job, diagnostics)?,
        _ => return Err(no_way(job)),
    };
    match &read {
        Read::Points(points, about) => {
            report.usd.clone_from(&about.reader);
            report.counts.surfels = points.len();
        }
        Read::Splats(splats, about) => {
            report.usd.clone_from(&about.reader);
            report.counts.surfels = splats.len();
        }
        Read::Scene(scene) => {
            report.usd.clone_from(&scene.stage.reader);
            report.counts.prims = scene.prims.len();
            report.counts.triangles = scene.triangle_count();
        }
    }
    Ok(read)
}

/// A cloud, splats, or for GLB the surfaces of a stage.
fn read_usd(job: &ConvertJob, diagnostics: &Diagnostics) -> Result<Read, Error> {
    let path = &job.stage.path;
    let output = job.output.path.clone().unwrap_or_default();
    if ending(&output) != "glb" {
        return Ok(match cloud::find(path, diagnostics)? {
            Found::Points(points, about) => Read::Points(points, about),
            Found::Splats(splats, about) => Read::Splats(splats, about),
            // it says why not
            Found::Neither => {
                let (points, about) = cloud::read_points(path, diagnostics)?;
                Read::Points(points, about)
            }
        });
    }
    let needs = Needs {
        materials: true,
        solidity: false,
        lights: false,
        gloss: true,
        tolerance: None,
    };
    let time = job.stage.frames.first().copied();
    let settings = ReadSettings {
        all_primvars: true,
        ..read_settings(&job.stage, time, needs)
    };
    let mut source = stage::open(path, job.stage.door, diagnostics)?;
    let scene = stage::read(source.as_mut(), &settings, diagnostics)?;
    if scene.triangle_count() == 0 {
        return Err(Error::NothingToShow { path: path.clone() });
    }
    Ok(Read::Scene(Box::new(scene)))
}

fn no_way(job: &ConvertJob) -> Error {
    Error::NoWay {
        from: job.stage.path.clone(),
        to: job.output.path.clone().unwrap_or_default(),
        reason: WAYS.to_owned(),
    }
}

/// Axis and units as the file says, else as the user does, else +Y up and meters.
fn said(job: &ConvertJob, about: Option<(UpAxis, f64)>) -> StageInfo {
    let (axis, unit) = about.unzip();
    StageInfo {
        path: job.stage.path.clone(),
        up_axis: axis.or(job.up_axis).unwrap_or_default(),
        meters_per_unit: unit.or(job.meters_per_unit).unwrap_or(METER),
        default_prim: None,
        time_range: None,
        time_codes_per_second: 24.0,
        time: None,
        layers: Vec::new(),
        variants: Vec::new(),
        reader: String::new(),
    }
}

fn write(
    job: &ConvertJob,
    read: Read,
    output: &Path,
    diagnostics: &Diagnostics,
) -> Result<(), Error> {
    let _phase = diagnostics.phase("write", "file", 0);
    let provenance = provenance(&job.stage);
    let ending = ending(output);
    match (read, ending.as_str()) {
        (Read::Points(set, about), "ply") => {
            ply::write(&set, &about, output, job.encoding, &provenance)?;
        }
        (Read::Points(set, _), "ptc") => ptc::write(&set, output, diagnostics)?,
        (Read::Points(set, about), "usdc" | "usda" | "usd") if job.display_mesh => {
            usd::points::write_display_mesh(&set, &about, &provenance, output)?;
        }
        (Read::Points(set, about), "usdc" | "usda" | "usd") => {
            usd::points::write(set, &about, &provenance, output)?;
        }
        (Read::Splats(splats, _), "ply") => ply::splats::write(&splats, output, &provenance)?,
        (Read::Splats(splats, about), "usdc" | "usda" | "usd") => {
            usd::splats::write(splats, &about, &provenance, output)?;
        }
        (Read::Scene(scene), "glb") => glb::write(&scene, output, &provenance, diagnostics)?,
        _ => return Err(no_way(job)),
    }
    Ok(())
}
