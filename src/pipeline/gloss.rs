//! What glossy surfaces reflect, as a part of `color`.

use super::Error;
use super::choice;
use super::gather::{gather_each, gather_group};
use super::job::GatherJob;
use super::report::Report;
use super::stand::Stand;
use super::world::World;
use crate::diagnostics::Diagnostics;
use crate::pilot::error::{mean_magnitude, relative, values};
use crate::pilot::{self, Method};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};

/// Compute `aovs`, among them `color`, and `specular_indirect` as well as `color` needs it: what it errs by counts by the
/// mean of the color.
pub(super) fn gather_beside(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let name = Aov::Color.name();
    let before = report.error.aovs.remove(name);
    let mut results = gather_each(world, receivers, aovs, job, (&mut *report, diagnostics))?;
    let mean = mean_of(&results, Aov::Color);
    let mut part = Report::new(&[]);
    part.choices = std::mem::take(&mut report.choices);
    part.dicings = std::mem::take(&mut report.dicings);
    part.error.tolerance = report.error.tolerance;
    let asked = (receivers, job.occlusion.part_of(Aov::SpecularIndirect));
    let aov = [Aov::SpecularIndirect];
    let run = (&mut part, diagnostics);
    let gloss = gather_group(world, asked, (&aov, Some(mean)), job, run)?;
    report.choices = std::mem::take(&mut part.choices);
    report.dicings = std::mem::take(&mut part.dicings);
    let own = part.error.aovs.get(aov[0].name()).copied();
    let of_gloss = own.unwrap_or(0.0) * mean_of(&gloss, aov[0]);
    report.add_part(part);
    results.buffers.extend(gloss.buffers);
    if let Some(own) = report.error.aovs.get(name).copied() {
        let whole = mean + mean_of(&results, aov[0]);
        let both = relative((own * mean).hypot(of_gloss), whole);
        let is_news = report.error.tolerance.is_some_and(|most| own <= most);
        report.error.put(name, both.max(before.unwrap_or(0.0)));
        if is_news {
            choice::judge(report, diagnostics);
        }
    }
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
const LOOSEST_GLOSS: f64 = 5.0;

/// Receivers and rays that tell how much of the color gloss is.
const RAYS_OF_MEAN: u32 = 32;

/// What `aovs`, which are part of a color of mean `whole`, may err by relative to themselves.
pub(super) fn tolerance_beside(
    stand: &Stand<'_>,
    whole: f64,
    diagnostics: &Diagnostics,
) -> Result<Option<f64>, Error> {
    let Some(tolerance) = stand.job.tolerance else {
        return Ok(None);
    };
    let few = (stand.receivers).subset(&pilot::picks(stand.receivers.len()));
    let engine = stand.rays_with(stand.rays_settings(RAYS_OF_MEAN));
    let results = Method::gather(&engine, stand.scene(), &few, stand.aovs, diagnostics)?;
    let own = mean_of(&results, stand.aovs[0]);
    let times = SHARE_OF_GLOSS * whole / own.max(f64::MIN_POSITIVE);
    Ok(Some(tolerance * times.clamp(1.0, LOOSEST_GLOSS)))
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
