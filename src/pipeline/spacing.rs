//! How finely surfaces are diced for a tolerance, and what error that leaves in reflected light.
//!
//! Every ray that meets a surfel reads one radiance for all of it, so reflected light errs by a part that more rays do
//! not remove. Two clouds are gathered from at a few receivers by the same rays: what differs is the surfels' alone.

use super::Error;
use super::gather::{Light, bounce, dice, light, needs_surfels};
use super::job::{EngineChoice, GatherJob};
use super::report::Report;
use super::world::World;
use crate::bake::{BakeSettings, Baked};
use crate::diagnostics::Diagnostics;
use crate::gather::{self, GatherScene, RaysEngine, RaysSettings};
use crate::pilot::error::{mean_magnitude, relative, rms_difference, values};
use crate::pilot::picks;
use crate::receivers::Receivers;
use crate::results::{Aov, Results};

/// Share of the tolerance that surfels may use up; rays have 80 % of it left.
const SHARE: f64 = 0.6;

/// Surfels of the first two clouds over those of a run without tolerance.
const FIRST: [usize; 2] = [16, 4];

/// Fewest surfels to aim at, and most: 16 million take about 1.5 GB.
const FEWEST: usize = 4_000;
const MOST: usize = 4_000_000;

/// Growth from one cloud to the next, at least and at most.
const GROWTH: (f64, f64) = (4.0, 16.0);

/// Rays at each of the few receivers: the same ones for all clouds, so that their own error cancels.
const RAYS: u32 = 256;

/// Power of the spacing that the error falls with.
const LAW: f64 = 1.0;

/// Below this power of the spacing finer clouds hardly help: what is left hangs on single receivers in gaps between
/// surfaces, thinner than any surfel would be. Four times the surfels take a fifth off the error then.
const STALLED: f64 = 0.3;

/// Clouds whose spacings differ by less than this cannot judge each other.
const LEAST_RATIO: f64 = 1.25;

/// Surfels, and the error they leave.
pub(super) struct Lit {
    pub(super) light: Light,
    /// Relative RMSE of each AOV, in order; empty where it was not measured.
    pub(super) errors: Vec<f64>,
}

impl From<Light> for Lit {
    fn from(light: Light) -> Self {
        Self {
            light,
            errors: Vec::new(),
        }
    }
}

/// The surfels `aovs` need, as many as the tolerance asks for, if there is one.
pub(super) fn lit(
    world: &World<'_>,
    (receivers, aovs): (&Receivers, &[Aov]),
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Lit, Error> {
    let run = (&mut *report, diagnostics);
    let is_asked = job.clouds.is_empty() && job.engine != EngineChoice::Paper;
    let Some(tolerance) = job.tolerance.filter(|_| is_asked) else {
        return Ok(light(world, receivers, aovs, job, run)?.into());
    };
    if !needs_surfels(world, aovs, job) {
        return Ok(Light::None.into());
    }
    if let Some(&surfels) = report.surfels.get(aovs) {
        // The same at every frame: results then differ only where the scene does.
        let again = GatherJob {
            surfels: Some(surfels),
            ..job.clone()
        };
        return Ok(light(world, receivers, aovs, &again, (report, diagnostics))?.into());
    }
    let few = picks(receivers.len());
    let few: Vec<usize> = few.into_iter().step_by(2).collect();
    let ladder = Ladder {
        world,
        few: &receivers.subset(&few),
        aovs,
        job,
        allowed: SHARE * tolerance,
    };
    let (baked, errors) = ladder.climb(receivers.len(), (&mut *report, diagnostics))?;
    if job.spacing.is_none() {
        let surfels = job.surfels.unwrap_or(baked.cloud.len());
        report.surfels.insert(aovs.to_vec(), surfels);
    }
    let light = bounce(world, baked, job, (report, diagnostics))?;
    Ok(Lit { light, errors })
}

struct Ladder<'a> {
    world: &'a World<'a>,
    few: &'a Receivers,
    aovs: &'a [Aov],
    job: &'a GatherJob,
    allowed: f64,
}

impl Ladder<'_> {
    /// Finer and finer clouds, until one is fine enough. What was asked for by name stays: a coarser cloud tells its
    /// error.
    fn climb(
        &self,
        receivers: usize,
        (report, diagnostics): (&mut Report, &Diagnostics),
    ) -> Result<(Baked, Vec<f64>), Error> {
        let usual = self.job.bake_settings(receivers);
        let is_fixed = self.job.surfels.is_some() || self.job.spacing.is_some();
        let fewest = if is_fixed { 1 } else { FEWEST };
        let coarsen = |settings: BakeSettings, by: usize| BakeSettings {
            spacing: settings.spacing.map(|spacing| spacing * (by as f32).sqrt()),
            surfels: (settings.surfels / by).max(fewest),
        };
        let [first, second] = if is_fixed { [4, 1] } else { FIRST };
        let mut coarse = self.look(&coarsen(usual, first), (&mut *report, diagnostics))?;
        let mut settings = coarsen(usual, second);
        let mut before = None;
        loop {
            let fine = self.look(&settings, (&mut *report, diagnostics))?;
            let errors = if is_fixed && !is_finer(&coarse, &fine) {
                // Already as coarse as faces allow: a finer cloud tells the error.
                let more = BakeSettings {
                    spacing: settings.spacing.map(|spacing| 0.5 * spacing),
                    surfels: 4 * fine.baked.cloud.len(),
                };
                let finer = self.look(&more, (&mut *report, diagnostics))?;
                let ratio = ratio(&fine, &finer).powf(LAW);
                let errors = self.errors(&fine, &finer).into_iter();
                errors.map(|error| ratio * error).collect()
            } else {
                self.errors(&coarse, &fine)
            };
            let worst = errors.iter().copied().fold(0.0, f64::max) / self.allowed;
            let count = fine.baked.cloud.len();
            let is_stalled = before.is_some_and(|before| law((before, (count, worst))) < STALLED);
            if worst <= 1.0 || is_fixed || is_stalled || count >= MOST {
                report.set("spacing", f64::from(fine.baked.cloud.spacing));
                report.set("surfel_error", worst * self.allowed);
                return Ok((fine.baked, errors));
            }
            settings.surfels = more(count, worst);
            before = Some((count, worst));
            coarse = fine;
        }
    }

    fn look(
        &self,
        settings: &BakeSettings,
        (report, diagnostics): (&mut Report, &Diagnostics),
    ) -> Result<Look, Error> {
        let baked = dice(self.world, settings, (report, diagnostics))?;
        let light = Light::Baked(Box::new(baked));
        let rays = RaysSettings {
            rays: RAYS,
            max_distance: self.job.max_distance,
            ..RaysSettings::default()
        };
        let engine = RaysEngine::new(&self.world.tracer, light.source(self.world, 1), rays);
        let scene = GatherScene {
            shader: self.world.shader,
            tracer: &self.world.tracer,
            lighting: Some(&self.world.lighting),
        };
        let aovs: Vec<Aov> = self.asked().collect();
        let results = gather::gather(scene, &engine, self.few, &aovs, diagnostics)?;
        drop(engine);
        let Light::Baked(baked) = light else {
            unreachable!("it was made so")
        };
        Ok(Look {
            baked: *baked,
            results,
        })
    }

    fn asked(&self) -> impl Iterator<Item = Aov> {
        self.aovs.iter().copied().filter(|&aov| is_measured(aov))
    }

    /// Relative error that the finer of two clouds leaves in each AOV.
    fn errors(&self, coarse: &Look, fine: &Look) -> Vec<f64> {
        let left = 1.0 / (ratio(coarse, fine).powf(LAW) - 1.0);
        let of = |&aov: &Aov| {
            let found = [coarse, fine].map(|look| values(&look.results, aov).unwrap_or_default());
            let mean = mean_magnitude(&found[1]);
            if is_measured(aov) {
                left * relative(rms_difference(&found[0], &found[1]), mean)
            } else {
                0.0
            }
        };
        self.aovs.iter().map(of).collect()
    }
}

fn is_measured(aov: Aov) -> bool {
    aov.needs_indirect() && aov.error_of().is_none()
}

/// A cloud and what the few receivers see of it.
struct Look {
    baked: Baked,
    results: Results,
}

/// Spacing of the coarse cloud over that of the fine one.
fn ratio(coarse: &Look, fine: &Look) -> f64 {
    let counts = [coarse, fine].map(|look| look.baked.cloud.len().max(1) as f64);
    (counts[1] / counts[0]).sqrt().max(LEAST_RATIO)
}

fn is_finer(coarse: &Look, fine: &Look) -> bool {
    ratio(coarse, fine) > LEAST_RATIO
}

/// Power of the spacing that errors fell with from one cloud to the next: surfels and error of each.
fn law((before, after): ((usize, f64), (usize, f64))) -> f64 {
    let finer = 0.5 * (after.0.max(1) as f64 / before.0.max(1) as f64).ln();
    if finer > 0.0 && after.1 > 0.0 {
        (before.1 / after.1).ln() / finer
    } else {
        LAW
    }
}

/// Surfels that bring down an error `excess` times too large.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "at most 4 million"
)]
fn more(count: usize, excess: f64) -> usize {
    let growth = excess.powf(2.0 / LAW).clamp(GROWTH.0, GROWTH.1);
    ((count as f64 * growth) as usize).min(MOST + MOST / 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_law_is_the_slope_of_the_error_over_the_spacing() {
        assert!((law(((1000, 0.08), (4000, 0.04))) - 1.0).abs() < 1e-12);
        assert!((law(((1000, 0.08), (16_000, 0.04))) - 0.5).abs() < 1e-12);
        assert!(law(((1000, 0.08), (4000, 0.08))).abs() < 1e-12);
        assert!(
            law(((1000, 0.08), (1000, 0.04))) >= STALLED,
            "no slope to tell"
        );
    }

    #[test]
    fn surfels_grow_with_the_square_of_the_error_within_limits() {
        assert_eq!(more(10_000, 3.0), 90_000);
        assert_eq!(more(10_000, 1.1), 40_000);
        assert_eq!(more(10_000, 100.0), 160_000);
        assert!(more(MOST - 1, 100.0) >= MOST);
    }
}
