//! What surfels' size costs, told by two clouds: where no single hit can be lit as an exact one.

use super::super::Error;
use super::super::gather::{dice, read_surfels};
use super::super::report::Report;
use super::{
    Climbed, FEWEST, LAW, Ladder, MOST, Relit, STALLED, is_measured, judged_as, law, more,
};
use crate::bake::{BakeSettings, Baked};
use crate::bounce::Bounces;
use crate::diagnostics::Diagnostics;
use crate::gather::{self, GatherScene, HitLight, RaysEngine, RaysSettings};
use crate::pilot::clock::Clock;
use crate::pilot::error::{mean_magnitude, relative, rms_difference, values};
use crate::results::{Aov, Results};

/// Surfels of the first two clouds over those of a run without tolerance.
const FIRST: [usize; 2] = [16, 4];

/// Rays at each of the few receivers: the same ones for all clouds, so that their own error cancels.
const RAYS: u32 = 256;

/// Clouds whose spacings differ by less than this cannot judge each other.
const LEAST_RATIO: f64 = 1.25;

impl Ladder<'_> {
    /// Finer and finer clouds, until one is fine enough. What was asked for by name stays: a coarser cloud tells its
    /// error.
    pub(super) fn climb_by_pairs(
        &self,
        (report, diagnostics): (&mut Report, &Diagnostics),
    ) -> Result<Climbed, Error> {
        let usual = self.job.bake_settings(self.receivers);
        let is_fixed = self.is_fixed();
        let fewest = if is_fixed { 1 } else { FEWEST };
        let coarsen = |settings: BakeSettings, by: usize| BakeSettings {
            spacing: settings.spacing.map(|spacing| spacing * (by as f32).sqrt()),
            surfels: (settings.surfels / by).max(fewest),
            ..settings
        };
        let [first, second] = if is_fixed { [4, 1] } else { FIRST };
        let mut coarse = self.look(&coarsen(usual, first), (&mut *report, diagnostics))?;
        let mut settings = coarsen(usual, second);
        let mut before = None;
        let start = Clock::start();
        loop {
            let fine = self.look(&settings, (&mut *report, diagnostics))?;
            let errors = if is_fixed && !is_finer(&coarse, &fine) {
                // Already as coarse as faces allow: a finer cloud tells the error.
                let more = BakeSettings {
                    spacing: settings.spacing.map(|spacing| 0.5 * spacing),
                    surfels: 4 * fine.baked.cloud.len(),
                    ..settings
                };
                let finer = self.look(&more, (&mut *report, diagnostics))?;
                let ratio = ratio(&fine, &finer).powf(LAW);
                let errors = self.errors(&fine, &finer).into_iter();
                errors.map(|error| ratio * error).collect()
            } else {
                self.errors(&coarse, &fine)
            };
            let worst = self.worst(&errors);
            let count = fine.baked.cloud.len();
            let is_stalled = before.is_some_and(|before| law((before, (count, worst))) < STALLED);
            if worst <= 1.0 || is_fixed || is_stalled || count >= MOST {
                report.set("spacing", f64::from(fine.baked.cloud.spacing));
                report.set("surfel_error", worst * self.allowed);
                return Ok(Climbed {
                    baked: fine.baked,
                    errors,
                    relit: Relit::Near(HitLight::NEAR_RADII),
                    judging: start.seconds() - fine.dicing,
                });
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
        let dicing = Clock::start();
        let baked = dice(
            self.world,
            (settings, self.job.tolerance),
            (report, diagnostics),
        )?;
        let dicing = dicing.seconds();
        let rays = RaysSettings {
            rays: RAYS,
            max_distance: self.job.max_distance,
            ..RaysSettings::default()
        };
        let source = read_surfels(
            &baked,
            self.world,
            (Bounces::Count(1), HitLight::NEAR_RADII),
        );
        let engine = RaysEngine::new(&self.world.tracer, Some(source), rays);
        let scene = GatherScene {
            shader: self.world.shader,
            tracer: &self.world.tracer,
            lighting: Some(&self.world.lighting),
        };
        let aovs = self.looked_at();
        let results = gather::gather(scene, &engine, self.few, &aovs, diagnostics)?;
        drop(engine);
        Ok(Look {
            baked,
            dicing,
            results,
        })
    }

    /// Relative error that the finer of two clouds leaves in each AOV.
    fn errors(&self, coarse: &Look, fine: &Look) -> Vec<f64> {
        let left = 1.0 / (ratio(coarse, fine).powf(LAW) - 1.0);
        let of = |&aov: &Aov| {
            let found = [coarse, fine].map(|look| look.values(judged_as(aov)));
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

/// A cloud and what the few receivers see of it.
struct Look {
    baked: Baked,
    /// Processor seconds that this took.
    dicing: f64,
    results: Results,
}

impl Look {
    fn values(&self, aov: Aov) -> Vec<f64> {
        values(&self.results, aov).unwrap_or_default()
    }
}

/// Spacing of the coarse cloud over that of the fine one.
fn ratio(coarse: &Look, fine: &Look) -> f64 {
    let counts = [coarse, fine].map(|look| look.baked.cloud.len().max(1) as f64);
    (counts[1] / counts[0]).sqrt().max(LEAST_RATIO)
}

fn is_finer(coarse: &Look, fine: &Look) -> bool {
    ratio(coarse, fine) > LEAST_RATIO
}
