//! What glossy surfaces reflect, as a part of `color`.

use super::Error;
use super::choice;
use super::gather::gather_on;
use super::job::{GatherJob, Part};
use super::report::{Report, timed};
use super::spacing::{self, Asked};
use super::stand::Stand;
use super::world::World;
use crate::diagnostics::Diagnostics;
use crate::pilot::error::{mean_magnitude, relative, values};
use crate::pilot::{self, Method};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};

/// What surfaces reflect glossily.
pub(super) const AOV: Aov = Aov::SpecularIndirect;

/// Compute `aovs`, among them `color`, and [`AOV`] as well as `color` needs it, by the light of the same surfels: what it errs
/// by counts by the mean of the color.
pub(super) fn gather_beside(
    world: &World<'_>,
    receivers: &Receivers,
    (aovs, part): (&[Aov], Part),
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let asked = Asked {
        receivers,
        aovs,
        beside: &[AOV],
    };
    let lit = spacing::lit(world, asked, job, (&mut *report, diagnostics))?;
    let name = Aov::Color.name();
    let before = report.error.aovs.remove(name);
    let stand = Stand::new(world, &lit, receivers, aovs, job).about(part);
    let mut results = gather_on(&stand, (&mut *report, diagnostics))?;
    choice::judge(report, diagnostics);
    let mean = mean_of(&results, Aov::Color);
    let part = job.occlusion.part_of(AOV);
    let stand = Stand::new(world, &lit, receivers, &[AOV], job).about(part);
    let mut own = report.part();
    let job = timed(&mut own.seconds.gather, || {
        job_beside(&stand, mean, diagnostics)
    })?;
    own.set("rays", job.rays);
    own.error.tolerance = job.tolerance;
    let gloss = gather_on(&stand.asked_as(&job), (&mut own, diagnostics))?;
    own.rename_setting("rays", "rays_of_gloss");
    let error_of_gloss = own.error.aovs.get(AOV.name()).copied();
    report.add_part(own);
    if let Some(error) = report.error.aovs.get(name).copied() {
        let of_gloss = mean_of(&gloss, AOV);
        let error_of_gloss = error_of_gloss.unwrap_or(0.0) * of_gloss;
        let both = relative((error * mean).hypot(error_of_gloss), mean + of_gloss);
        let is_news = report.error.tolerance.is_some_and(|most| error <= most);
        report.error.put(name, both.max(before.unwrap_or(0.0)));
        if is_news {
            choice::judge(report, diagnostics);
        }
    }
    results.buffers.extend(gloss.buffers);
    Ok(results)
}

/// Mean magnitude of the values of `aov`.
fn mean_of(results: &Results, aov: Aov) -> f64 {
    mean_magnitude(&values(results, aov).unwrap_or_default())
}

/// Of the error that a tolerance allows `color`, what gloss may add: as much as the square leaves that the pilot keeps free.
const SHARE_OF_GLOSS: f64 = 0.4;

/// Gloss that is little of the color may err by so many times the tolerance of itself: a small thing that shines, which
/// the few receivers of a pilot do not meet, should show no pattern of its rays.
const LOOSEST_GLOSS: f64 = 3.0;

/// Rays that tell, at the few receivers of a pilot, how much of the color gloss is.
const RAYS_OF_MEAN: u32 = 32;

/// The job of gloss that is part of a color of mean `whole`: it may err by so much relative to itself, or without a tolerance
/// has so many rays, that it adds little to what the color errs by.
fn job_beside(
    stand: &Stand<'_>,
    whole: f64,
    diagnostics: &Diagnostics,
) -> Result<GatherJob, Error> {
    let few = (stand.receivers).subset(&pilot::picks(stand.receivers.len()));
    let engine = stand.rays_with(stand.rays_settings(RAYS_OF_MEAN));
    let results = Method::gather(&engine, stand.scene(), &few, stand.aovs, diagnostics)?;
    let times = SHARE_OF_GLOSS * whole / mean_of(&results, AOV).max(f64::MIN_POSITIVE);
    let times = times.clamp(1.0, LOOSEST_GLOSS);
    Ok(GatherJob {
        tolerance: stand.job.tolerance.map(|tolerance| times * tolerance),
        rays: pilot::rays_with_errors(stand.job.rays, times),
        ..stand.job.clone()
    })
}

/// Add `specular_indirect` to `color`.
pub(super) fn add(results: &mut Results) {
    let Some(gloss) = results.get(Aov::SpecularIndirect) else {
        return;
    };
    let gloss = gloss.data.clone();
    let colors = (results.buffers.iter_mut()).filter(|buffer| buffer.aov == Aov::Color);
    for color in colors {
        let colors = color.data.chunks_exact_mut(Aov::Color.components());
        for (color, gloss) in colors.zip(gloss.as_chunks::<3>().0) {
            for (sum, more) in color.iter_mut().zip(gloss) {
                *sum += more;
            }
        }
    }
}
