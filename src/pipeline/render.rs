//! `surflux render`: light seen by a camera. PBGI §6.

use super::gather::record;
use super::groups::gather_parts;
use super::job::RenderJob;
use super::report::{Report, peak_memory_bytes, timed};
use super::view::{View, views};
use super::world::{Needs, World, with_world};
use super::{Error, gather, made_by, outputs, provenance, shots, source_of};
use crate::diagnostics::Diagnostics;
use crate::receivers::camera::{CameraRay, Sights};
use crate::receivers::lens::Lens;
use crate::receivers::sampling::Sampling;
use crate::receivers::{Receivers, camera};
use crate::results::{Aov, AovImage, Target, resolve};
use crate::stage::Source;
use crate::trace::Hit;
use crate::writers::image::{ExrInfo, ExrLayout, write_exr, write_png};
use glam::{Vec3, Vec4};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub(super) fn run(
    job: &RenderJob,
    opened: Option<Box<dyn Source>>,
    diagnostics: &Diagnostics,
) -> Result<Report, Error> {
    let mut report = Report::new(&job.stage.command);
    let times = job.stage.times();
    if let Some(pattern) = &job.output.path {
        let planned: Vec<_> = times
            .iter()
            .flat_map(|time| files(&outputs::frame_path(pattern, *time), job))
            .collect();
        outputs::check(&job.output, &planned)?;
        if job.output.dry_run {
            report.outputs = planned;
            return Ok(report);
        }
    }
    let mut source = source_of(&job.stage, opened, diagnostics)?;
    // Without --aov the stage's render settings decide, and they are known only after reading.
    let needs = if job.gather.aovs.is_empty() {
        Needs::ALL
    } else {
        Needs::of_seen(&job.gather.aovs)
    };
    for (index, time) in times.into_iter().enumerate() {
        let is_first = index == 0;
        with_world(
            &mut source,
            (&job.stage, time, needs.within(job.gather.tolerance)),
            &mut report,
            diagnostics,
            |world, report| {
                for view in views(job, world.scene(), diagnostics)? {
                    let written = files(&outputs::frame_path(&view.output, time), job);
                    outputs::check(&job.output, &written)?;
                    if !job.output.dry_run {
                        let shown = is_first && job.output.is_pictured();
                        let asked = (job, shown);
                        render(world, &view, asked, &written, (&mut *report, diagnostics))?;
                    }
                    report.outputs.extend(written);
                }
                Ok(())
            },
        )?;
    }
    report.peak_memory_bytes = peak_memory_bytes(source.source());
    Ok(report)
}

/// The EXR and, if asked, the PNG beside it.
fn files(exr: &Path, job: &RenderJob) -> Vec<PathBuf> {
    let mut files = vec![exr.to_path_buf()];
    if job.preview {
        files.push(exr.with_extension("png"));
    }
    files
}

fn render(
    world: &World<'_>,
    view: &View,
    (job, shown): (&RenderJob, bool),
    files: &[PathBuf],
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<(), Error> {
    record(&job.gather, &view.aovs, report);
    report.set(
        "camera",
        if view.camera.path.is_empty() {
            "automatic"
        } else {
            view.camera.path.as_str()
        },
    );
    report.set("image", vec![view.frame.width, view.frame.height]);
    report.set("pixel_samples", job.pixel_samples);
    let sampling = timed(&mut report.seconds.gather, || sampling(world, view, job));
    let receivers = timed(&mut report.seconds.gather, || {
        place(world, view, job, &sampling)
    });
    let results = gather_parts(
        world,
        &receivers,
        &view.aovs,
        &job.gather,
        (&mut *report, diagnostics),
    )?;
    let images = timed(&mut report.seconds.write, || {
        let _phase = diagnostics.phase("write", "file", 0);
        let mut images = resolve(&results, &receivers.target);
        if !job.hide_lights {
            let seen = (view, &sampling, &receivers.target);
            add_lights(&mut images, (world, None), seen);
            for group in world.groups {
                let shader = world.shader.of_group(group);
                let part = world.lit_by(&shader, diagnostics);
                add_lights(&mut images, (world, Some((&group.name, &part))), seen);
            }
        }
        write(&images, &info(world, view, job), job, files)?;
        Ok::<_, Error>(images)
    })?;
    if shown {
        let pair = shots::paired(&view.aovs, &job.gather).filter(|_| job.output.report.is_some());
        let mut seconds = 0.0;
        let plain = timed(&mut seconds, || {
            pair.map(|aov| without_reflections(world, view, (job, aov), diagnostics))
        });
        let plain = plain.transpose()?.flatten();
        timed(&mut seconds, || {
            shots::of_render(&images, plain.as_ref(), (job, &view.output), report);
        });
        report.seconds.pictures += seconds;
    }
    Ok(())
}

/// What a page shows beside `aov`: the same, small, before light is reflected.
fn without_reflections(
    world: &World<'_>,
    view: &View,
    (job, aov): (&RenderJob, Aov),
    diagnostics: &Diagnostics,
) -> Result<Option<AovImage>, Error> {
    let view = &shots::small(view, aov);
    let job = &RenderJob {
        pixel_samples: job.pixel_samples.min(shots::PIXEL_SAMPLES),
        ..job.clone()
    };
    let sampling = sampling(world, view, job);
    let receivers = place(world, view, job, &sampling);
    let asked = shots::without_reflections(&job.gather, aov);
    let mut scratch = Report::new(&[]);
    let run = (&mut scratch, diagnostics);
    let results = gather::gather(world, &receivers, &asked.aovs, &asked, run)?;
    let mut images = resolve(&results, &receivers.target);
    if !job.hide_lights {
        add_lights(
            &mut images,
            (world, None),
            (view, &sampling, &receivers.target),
        );
    }
    Ok(images.into_iter().next())
}

fn write(
    images: &[AovImage],
    info: &ExrInfo,
    job: &RenderJob,
    files: &[PathBuf],
) -> Result<(), Error> {
    let layout = if job.multipart {
        ExrLayout::MultiPart
    } else {
        ExrLayout::SinglePart
    };
    write_exr(&files[0], images, info, layout)?;
    if let Some(png) = files.get(1) {
        let shown = images
            .iter()
            .find(|image| image.aov == Aov::Color)
            .unwrap_or(&images[0]);
        let about = provenance(&job.stage);
        write_png(png, shown, &made_by(&about.program(), &about.words()))?;
    }
    Ok(())
}

/// What the header says.
fn info(world: &World<'_>, view: &View, job: &RenderJob) -> ExrInfo {
    let stage = &world.scene().stage;
    let lens = Lens::new(&view.camera, view.frame);
    let mut texts = BTreeMap::from([
        ("usd/stage".to_owned(), stage.path.display().to_string()),
        ("usd/camera".to_owned(), view.camera.path.clone()),
        ("surflux/command".to_owned(), job.stage.command.join(" ")),
    ]);
    if let Some(time) = stage.time {
        texts.insert("usd/timeCode".to_owned(), time.to_string());
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "EXR keeps it in single precision"
    )]
    let pixel_aspect_ratio = lens.pixel_aspect_ratio() as f32;
    ExrInfo {
        pixel_aspect_ratio,
        world_to_camera: Some(lens.world_to_camera()),
        world_to_ndc: Some(lens.world_to_ndc()),
        clipping_range: Some(view.camera.clipping_range),
        frames_per_second: stage.time.map(|_| stage.time_codes_per_second),
        texts,
        ..ExrInfo::default()
    }
}

/// Where in its pixels the camera looks.
fn sampling(world: &World<'_>, view: &View, job: &RenderJob) -> Sampling {
    if job.hide_lights {
        return Sampling::uniform(job.pixel_samples);
    }
    let is_lit = |ray: &CameraRay| {
        let CameraRay {
            origin,
            direction,
            length,
        } = *ray;
        let met = (world.lighting).seen(origin, direction, length);
        met.is_some_and(|(distance, _)| {
            let solid = (world.tracer).solid_closest(origin, direction, length);
            solid.is_none_or(|hit| distance < hit.distance)
                && (world.tracer).layers((origin, direction), distance, &mut Vec::new()) > 0.0
        })
    };
    let (scene, samples) = (world.scene(), job.pixel_samples);
    camera::finer_at_lights(scene, &is_lit, (&view.camera, view.frame), samples)
}

/// Receivers on the surfaces that the camera sees; lights in front hide them.
fn place(world: &World<'_>, view: &View, job: &RenderJob, sampling: &Sampling) -> Receivers {
    let cast = |sights: &mut Sights| {
        sights.see_through(&world.tracer);
        if job.hide_lights {
            return;
        }
        for (ray, found) in sights.rays.iter().zip(&mut sights.layers) {
            let Some(last) = found.last() else {
                continue;
            };
            let light = (world.lighting).seen(ray.origin, ray.direction, last.hit.distance);
            if let Some((distance, _)) = light {
                found.retain(|layer| layer.hit.distance < distance);
            }
        }
    };
    camera::place_with(world.scene(), &cast, (&view.camera, view.frame), sampling)
}

/// A light group's name, and the world where nothing else shines.
type Part<'a> = (&'a str, &'a World<'a>);

/// What shines by itself along a ray before what stops it (`solid`) and how far it covers what is behind: the shape of a
/// light, or the sky, which does not cover. Of a part only its own lights, where no others hide them, and its sky.
fn glow(
    (world, part): (&World<'_>, Option<Part<'_>>),
    sky: bool,
    (ray, solid): (&CameraRay, Option<Hit>),
) -> Vec4 {
    let CameraRay {
        origin,
        direction,
        length,
    } = *ray;
    let length = solid.map_or(length, |hit| hit.distance);
    let shown = part.map_or(world, |(_, part)| part);
    let light = world.lighting.seen(origin, direction, length);
    let end = light.map_or(length, |(distance, _)| distance);
    let is_sky = light.is_none() && solid.is_none() && sky;
    if light.is_none() && !is_sky {
        return Vec4::ZERO;
    }
    let open = (world.tracer).layers((origin, direction), end, &mut Vec::new());
    match light {
        Some(nearest) => {
            let own = (shown.lighting).seen(origin, direction, length);
            let own = own.filter(|own| *own == nearest);
            let radiance = own.map_or(Vec3::ZERO, |(_, radiance)| radiance);
            (radiance * open).extend(open)
        }
        None => (shown.lighting.environment_radiance(None, direction) * open).extend(0.0),
    }
}

/// Add what shines into the camera by itself to the images of `part`: the shapes of lights to `color` (covering) and
/// `emission`, the sky to `color` (not covering).
fn add_lights(
    images: &mut [AovImage],
    (world, part): (&World<'_>, Option<Part<'_>>),
    (view, sampling, target): (&View, &Sampling, &Target),
) {
    let name = part.map(|(name, _)| name);
    let shown = |image: &&mut AovImage| {
        matches!(image.aov, Aov::Color | Aov::Emission) && image.group.as_deref() == name
    };
    for image in images.iter_mut().filter(shown) {
        let sky = image.aov == Aov::Color;
        let glow = |ray: &CameraRay, solid| glow((world, part), sky, (ray, solid));
        let seen = (&view.camera, view.frame);
        let backdrop = camera::backdrop(
            world.scene(),
            &world.tracer,
            &glow,
            seen,
            (sampling, target),
        );
        for (pixel, light) in image
            .data
            .chunks_exact_mut(image.aov.components())
            .zip(backdrop)
        {
            for (value, more) in pixel.iter_mut().zip(light.to_array()) {
                *value += more;
            }
        }
    }
}
