//! How finely surfaces are diced for a tolerance, and what error that leaves in reflected light.
//!
//! Every ray that meets a surfel reads one radiance for all of it, so reflected light errs by a part that more rays do
//! not remove. How large it is a few receivers tell, by light found anew at what they see ([`hits`]), or where that
//! takes too long, by clouds of two sizes ([`pairs`]).

mod hits;
mod pairs;

use super::Error;
use super::bounces::bounced;
use super::gather::{Light, light, needs_surfels};
use super::job::{EngineChoice, GatherJob};
use super::report::Report;
use super::world::World;
use crate::bake::Baked;
use crate::diagnostics::Diagnostics;
use crate::gather::HitLight;
use crate::gather::estimate::spread;
use crate::pilot::picks;
use crate::receivers::Receivers;
use crate::results::Aov;
use std::time::Instant;

/// Share of the tolerance that surfels may use up; rays have 80 % of it left.
const SHARE: f64 = 0.6;

/// Where few receivers can't tell what surfels leave, at most one in so many of a run's does, and so many at most.
const ONE_IN: usize = 128;
const MANY: usize = 1024;

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
    /// Relative RMSE of AOVs; empty where it was not measured.
    pub(super) errors: Vec<(Aov, f64)>,
    pub(super) relit: Relit,
    /// Processor seconds that finding out took, this cloud's own aside.
    pub(super) judging: f64,
}

impl Lit {
    /// Relative RMSE that surfels leave in `aov`; 0 where it was not measured.
    pub(super) fn error_of(&self, aov: Aov) -> f64 {
        let of = self.errors.iter().find(|(known, _)| *known == aov);
        of.map_or(0.0, |&(_, error)| error)
    }
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
    /// Of the surfels, where their number was not asked for.
    spacing: f32,
    relit: Relit,
}

/// A cloud that is fine enough, or as fine as it gets.
struct Climbed {
    baked: Baked,
    /// Relative RMSE of each AOV of a [`Ladder`], in order.
    errors: Vec<f64>,
    relit: Relit,
    /// See [`Lit`].
    judging: f64,
}

/// What surfels are for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Asked<'a> {
    pub(super) receivers: &'a Receivers,
    pub(super) aovs: &'a [Aov],
    /// AOVs that read the same surfels, and ask for none of their own: what they err by is told.
    pub(super) beside: &'a [Aov],
}

/// The surfels that are asked for, as many as the tolerance needs, if there is one.
pub(super) fn lit(
    world: &World<'_>,
    asked: Asked<'_>,
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Lit, Error> {
    let Asked {
        receivers,
        aovs,
        beside,
    } = asked;
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
            spacing: job.surfels.is_none().then_some(dicing.spacing),
            ..job.clone()
        };
        return Ok(Lit {
            relit: dicing.relit,
            ..light(world, receivers, aovs, &again, (report, diagnostics))?.into()
        });
    }
    let few = picks(receivers.len());
    let few: Vec<usize> = few.into_iter().step_by(2).collect();
    let many = (receivers.len() / ONE_IN).clamp(few.len(), MANY);
    let many = spread(receivers.len(), many);
    let ladder = Ladder {
        world,
        receivers: receivers.len(),
        few: &receivers.subset(&few),
        many: &receivers.subset(&many),
        aovs: &[aovs, beside].concat(),
        bound: aovs.len(),
        job,
        tolerance,
        allowed: SHARE * tolerance,
    };
    let (start, points) = (Instant::now(), report.seconds.points);
    let climbed = if world.lighting.has_emitters() {
        ladder.climb_by_pairs((&mut *report, diagnostics))?
    } else {
        ladder.climb_by_hits((&mut *report, diagnostics))?
    };
    let dicing = report.seconds.points - points;
    report.seconds.gather += start.elapsed().as_secs_f64() - dicing;
    if job.spacing.is_none() {
        let dicing = Dicing {
            spacing: climbed.baked.cloud.spacing,
            relit: climbed.relit,
        };
        report.dicings.insert(aovs.to_vec(), dicing);
    }
    Ok(Lit {
        light: bounced(world, climbed.baked, job, (report, diagnostics))?,
        errors: ladder.aovs.iter().copied().zip(climbed.errors).collect(),
        relit: climbed.relit,
        judging: climbed.judging,
    })
}

struct Ladder<'a> {
    world: &'a World<'a>,
    /// How many the run has.
    receivers: usize,
    few: &'a Receivers,
    /// More of them, for whom it hangs on few that see what others don't.
    many: &'a Receivers,
    /// AOVs whose error is told.
    aovs: &'a [Aov],
    /// So many of them, the first, bind it.
    bound: usize,
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

    /// What is looked at for it.
    fn looked_at(&self) -> Vec<Aov> {
        let measured = self.aovs.iter().filter(|&&aov| is_measured(aov));
        let mut looked_at: Vec<Aov> = measured.map(|&aov| judged_as(aov)).collect();
        looked_at.sort();
        looked_at.dedup();
        looked_at
    }

    /// The largest of `errors`, of those that bind it, over what is allowed.
    fn worst(&self, errors: &[f64]) -> f64 {
        let bound = errors.iter().take(self.bound);
        bound.copied().fold(0.0, f64::max) / self.allowed
    }
}

/// The AOV whose relative error by surfels is that of `aov`: what a lobe sees is part of what the hemisphere does, and
/// harmonics tell from where.
fn judged_as(aov: Aov) -> Aov {
    match aov {
        Aov::SpecularIndirect | Aov::RadianceSh => Aov::IrradianceIndirect,
        other => other,
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
