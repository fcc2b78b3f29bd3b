//! How finely surfaces are diced for a tolerance, and what error that leaves in reflected light.
//!
//! Every ray that meets a surfel reads one radiance for all of it, so reflected light errs by a part that more rays do
//! not remove. How large it is a few receivers tell, by light found anew at what they see ([`hits`]), or where that
//! takes too long, by clouds of two sizes ([`pairs`]).

mod hits;
mod pairs;

use super::Error;
use super::gather::{Light, bounce, light, needs_surfels};
use super::job::{EngineChoice, GatherJob};
use super::report::Report;
use super::world::World;
use crate::bake::Baked;
use crate::diagnostics::Diagnostics;
use crate::gather::HitLight;
use crate::pilot::picks;
use crate::receivers::Receivers;
use crate::results::Aov;

/// Share of the tolerance that surfels may use up; rays have 80 % of it left.
const SHARE: f64 = 0.6;

/// Fewest surfels to aim at, and most: 16 million take about 1.5 GB.
const FEWEST: usize = 4_000;
const MOST: usize = 4_000_000;

/// Growth from one cloud to the next, at least and at most.
const GROWTH: (f64, f64) = (4.0, 16.0);

/// Power of the spacing that the error falls with.
const LAW: f64 = 1.0;

/// Below this power of the spacing finer clouds hardly help: what is left hangs on single receivers in gaps between
/// surfaces, thinner than any surfel would be. Four times the surfels take a fifth off the error then.
const STALLED: f64 = 0.3;

/// Which hits are lit anew, rather than read from surfels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Relit {
    /// Those nearer than so many radii of their surfel.
    Near(f32),
    /// All: surfels only tell which sides reflect.
    All,
}

impl Default for Relit {
    fn default() -> Self {
        Self::Near(HitLight::NEAR_RADII)
    }
}

impl Relit {
    /// As reports tell it: radii, or `all`.
    fn name(self) -> serde_json::Value {
        match self {
            Self::Near(radii) => f64::from(radii).into(),
            Self::All => "all".into(),
        }
    }
}

/// Surfels, and the error they leave.
pub(super) struct Lit {
    pub(super) light: Light,
    /// Relative RMSE of each AOV, in order; empty where it was not measured.
    pub(super) errors: Vec<f64>,
    pub(super) relit: Relit,
    /// Processor seconds that finding out took, this cloud's own aside.
    pub(super) judging: f64,
}

impl From<Light> for Lit {
    fn from(light: Light) -> Self {
        Self {
            light,
            errors: Vec::new(),
            relit: Relit::default(),
            judging: 0.0,
        }
    }
}

/// What was found to meet a tolerance, to be kept for all frames.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dicing {
    surfels: usize,
    relit: Relit,
}

/// A cloud that is fine enough, or as fine as it gets.
struct Climbed {
    baked: Baked,
    /// See [`Lit`].
    errors: Vec<f64>,
    relit: Relit,
    judging: f64,
}

/// The surfels `aovs` need, as many as the tolerance asks for, if there is one.
pub(super) fn lit(
    world: &World<'_>,
    (receivers, aovs): (&Receivers, &[Aov]),
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Lit, Error> {
    let run = (&mut *report, diagnostics);
    let is_asked =
        job.clouds.is_empty() && !matches!(job.engine, EngineChoice::Raster | EngineChoice::Paper);
    let Some(tolerance) = job.tolerance.filter(|_| is_asked) else {
        return Ok(light(world, receivers, aovs, job, run)?.into());
    };
    if !needs_surfels(world, aovs, job) {
        return Ok(Light::None.into());
    }
    if let Some(&dicing) = report.dicings.get(aovs) {
        // The same at every frame: results then differ only where the scene does.
        let again = GatherJob {
            surfels: Some(dicing.surfels),
            ..job.clone()
        };
        return Ok(Lit {
            relit: dicing.relit,
            ..light(world, receivers, aovs, &again, (report, diagnostics))?.into()
        });
    }
    let few = picks(receivers.len());
    let few: Vec<usize> = few.into_iter().step_by(2).collect();
    let ladder = Ladder {
        world,
        receivers: receivers.len(),
        few: &receivers.subset(&few),
        aovs,
        job,
        tolerance,
        allowed: SHARE * tolerance,
    };
    let climbed = if world.lighting.has_emitters() {
        ladder.climb_by_pairs((&mut *report, diagnostics))?
    } else {
        ladder.climb_by_hits((&mut *report, diagnostics))?
    };
    if job.spacing.is_none() {
        let dicing = Dicing {
            surfels: job.surfels.unwrap_or(climbed.baked.cloud.len()),
            relit: climbed.relit,
        };
        report.dicings.insert(aovs.to_vec(), dicing);
    }
    Ok(Lit {
        light: bounce(world, climbed.baked, job, (report, diagnostics))?,
        errors: climbed.errors,
        relit: climbed.relit,
        judging: climbed.judging,
    })
}

struct Ladder<'a> {
    world: &'a World<'a>,
    /// How many the run has.
    receivers: usize,
    few: &'a Receivers,
    aovs: &'a [Aov],
    job: &'a GatherJob,
    tolerance: f64,
    /// Part of the tolerance for surfels.
    allowed: f64,
}

impl Ladder<'_> {
    /// True if the user said how finely to dice.
    fn is_fixed(&self) -> bool {
        self.job.surfels.is_some() || self.job.spacing.is_some()
    }

    fn asked(&self) -> impl Iterator<Item = Aov> {
        self.aovs.iter().copied().filter(|&aov| is_measured(aov))
    }

    /// The largest of `errors` over what is allowed.
    fn worst(&self, errors: &[f64]) -> f64 {
        errors.iter().copied().fold(0.0, f64::max) / self.allowed
    }
}

fn is_measured(aov: Aov) -> bool {
    aov.needs_indirect() && aov.error_of().is_none()
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
