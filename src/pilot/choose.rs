//! The choice itself.

use super::clock::Clock;
use super::error::{mean_magnitude, measured_as, relative, rms_difference, values};
use super::light::{self, LightError, LightScenes};
use super::{Candidate, Knobs, Method};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::estimate::spread;
use crate::gather::{ErrorEstimate, GatherScene};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};

/// Power of the number of rays (or light samples) that their error falls with: measured from 64 to 4096 lattice rays.
pub(super) const LAW: f64 = 0.75;

/// Range in which a measured power is believed: random rays have 0.5, smooth integrands 1.
const LAWS: (f64, f64) = (0.5, 1.0);

/// Fewest and most rays that are chosen; the reference may have [`REFERENCE`] times as many.
const FEWEST_RAYS: f64 = 16.0;
const MOST_RAYS: f64 = 16_384.0;

/// The ladder's first rung and the ratio of its rungs.
const FIRST_RUNG: u32 = 32;
const RUNG: u32 = 4;

/// Rays of the reference over the chosen number.
const REFERENCE: f64 = 4.0;

/// Share of the tolerance aimed at: the error of a few receivers is that of all within about a tenth.
const AIM: f64 = 0.9;

/// The pilot looks at one in so many receivers: the reference and the check cost about five times the run's rays there,
/// so 8 % of the run.
const ONE_IN: usize = 64;

/// Pilot receivers at least (if there are so many) and at most.
const FEWEST: usize = 48;
const MOST: usize = 256;

/// Receivers that tell whether a candidate's cost is worth a closer look.
const GLANCE: usize = 16;

/// What to choose for.
pub struct Pilot<'a, 'c> {
    /// Geometry, materials, lights.
    pub scenes: LightScenes<'a>,
    /// All receivers of the run.
    pub receivers: &'a Receivers,
    /// All AOVs of the run.
    pub aovs: &'a [Aov],
    /// Relative RMSE to meet, above 0.
    pub tolerance: f64,
    /// Rays: how many, and the turn of their pattern (0 = the run's).
    pub rays: &'a dyn Fn(u32, f32) -> Box<dyn Method + 'a>,
    /// Everything else that could do the job, cheap settings of an engine before dear ones.
    pub candidates: &'a [Candidate<'c>],
}

impl std::fmt::Debug for Pilot<'_, '_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pilot")
            .field("receivers", &self.receivers.len())
            .field("aovs", &self.aovs)
            .field("tolerance", &self.tolerance)
            .field("candidates", &self.candidates)
            .finish_non_exhaustive()
    }
}

/// One candidate as measured.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Trial {
    /// Engine.
    pub engine: &'static str,
    /// Settings.
    #[serde(serialize_with = "knobs_as_map")]
    pub knobs: Knobs,
    /// Processor seconds of gathering a receiver.
    pub seconds_per_receiver: f64,
    /// Relative RMSE over that allowed, of the worst AOV; none where the cost alone ruled it out.
    pub error_over_tolerance: Option<f64>,
}

fn knobs_as_map<S: serde::Serializer>(knobs: &Knobs, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(knobs.iter().copied())
}

/// What the pilot found.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Index of the chosen candidate; `None`: rays.
    pub candidate: Option<usize>,
    /// Rays that meet the tolerance, whether chosen or not; `None` if no AOV depends on them.
    pub rays: Option<u32>,
    /// Times the usual light samples that the tolerance needs.
    pub light_scale: u32,
    /// Expected error of the run, one an AOV that has any.
    pub errors: Vec<ErrorEstimate>,
    /// Everything measured; the last one of its engine is the one to compare.
    pub trials: Vec<Trial>,
    /// Receivers looked at.
    pub receivers: usize,
    /// Processor seconds it all took.
    pub seconds: f64,
}

impl Outcome {
    /// The largest of [`Self::errors`]; `None` without any.
    pub fn worst(&self) -> Option<f64> {
        self.errors
            .iter()
            .map(|error| error.relative_rmse)
            .reduce(f64::max)
    }
}

/// The cheapest way to meet the tolerance, or the most exact one if none does. Deterministic but for the choice between
/// engines, which hangs on measured time.
///
/// # Errors
/// When cancelled.
pub fn choose(pilot: &Pilot<'_, '_>, diagnostics: &Diagnostics) -> Result<Outcome, Cancelled> {
    let start = Clock::start();
    let count = pilot.receivers.len();
    let picks = (count / ONE_IN).clamp(FEWEST, MOST).min(count);
    let few = pilot.receivers.subset(&spread(count, picks));
    let light = {
        let coarse = (pilot.rays)(FIRST_RUNG, 0.0);
        light::measure(pilot, coarse.as_ref(), &few, diagnostics)?
    };
    let mut bench = Bench::new(pilot, few, light, diagnostics);
    let mut outcome = bench.choose()?;
    outcome.seconds = start.seconds();
    Ok(outcome)
}

/// The pilot at work.
struct Bench<'b, 'a, 'c> {
    pilot: &'b Pilot<'a, 'c>,
    diagnostics: &'b Diagnostics,
    scene: GatherScene<'a>,
    /// The pilot's receivers, and every other one of them.
    few: Receivers,
    half: Receivers,
    light: LightError,
    /// AOVs that depend on the engine, as they are measured, their means and what error of the engine they allow.
    aovs: Vec<Aov>,
    means: Vec<f64>,
    allowed: Vec<f64>,
    trials: Vec<Trial>,
}

/// Results of one method, and what they cost.
struct Look {
    results: Results,
    seconds_per_receiver: f64,
}

/// Rays that were chosen and what judges everything else.
struct Judge {
    rays: f64,
    seconds_per_receiver: f64,
    errors: Vec<f64>,
    reference: Results,
    /// Squared error of the reference over that of the chosen rays.
    share: f64,
}

impl<'b, 'a, 'c> Bench<'b, 'a, 'c> {
    fn new(
        pilot: &'b Pilot<'a, 'c>,
        few: Receivers,
        light: LightError,
        diagnostics: &'b Diagnostics,
    ) -> Self {
        let half = few.subset(&(0..few.len()).step_by(2).collect::<Vec<_>>());
        let mut bench = Self {
            scene: pilot.scenes.engine(),
            pilot,
            diagnostics,
            few,
            half,
            light,
            aovs: Vec::new(),
            means: Vec::new(),
            allowed: Vec::new(),
            trials: Vec::new(),
        };
        for (i, &aov) in pilot.aovs.iter().enumerate() {
            let measured = measured_as(aov);
            if !pilot.scenes.depends_on_engine(aov) || bench.aovs.contains(&measured) {
                continue;
            }
            let left = pilot.tolerance.powi(2) - bench.light.relative[i].powi(2);
            bench.aovs.push(measured);
            bench.means.push(bench.light.means[i]);
            // Light that misses the tolerance on its own leaves nothing: the engine then does not add much.
            let least = 0.25 * pilot.tolerance * pilot.tolerance;
            bench.allowed.push(left.max(least).sqrt());
        }
        bench
    }

    fn choose(&mut self) -> Result<Outcome, Cancelled> {
        if self.aovs.is_empty() || self.few.is_empty() {
            return Ok(self.outcome(None, None, &[]));
        }
        let (needed, law) = self.climb()?;
        let judge = self.judge(needed, law)?;
        let mut best = (
            None,
            self.run_seconds(judge.seconds_per_receiver),
            judge.errors.clone(),
        );
        for (i, candidate) in self.pilot.candidates.iter().enumerate() {
            if let Some((seconds, errors)) = self.try_candidate(candidate, &judge, best.1)? {
                best = (Some(i), seconds, errors);
            }
        }
        Ok(self.outcome(best.0, Some(round(judge.rays)), &best.2))
    }

    fn run_seconds(&self, seconds_per_receiver: f64) -> f64 {
        seconds_per_receiver * self.pilot.receivers.len() as f64
    }

    fn rays(&self, count: f64, turn: f32, receivers: &Receivers) -> Result<Look, Cancelled> {
        self.look((self.pilot.rays)(round(count), turn).as_ref(), receivers)
    }

    fn look(&self, method: &dyn Method, receivers: &Receivers) -> Result<Look, Cancelled> {
        let start = Clock::start();
        let results = method.gather(self.scene, receivers, &self.aovs, self.diagnostics)?;
        Ok(Look {
            results,
            seconds_per_receiver: start.seconds() / receivers.len().max(1) as f64,
        })
    }

    /// Relative error of `run` for each AOV, when `truth`'s squared error is `share` times its own.
    fn errors(&self, run: &Results, truth: &Results, share: f64) -> Vec<f64> {
        let of = |(&aov, &mean): (&Aov, &f64)| {
            let run = values(run, aov).unwrap_or_default();
            let truth = values(truth, aov).unwrap_or_default();
            // The means of an engine that sees little light are that of all light: what is asked for.
            let mean = if mean > 0.0 {
                mean
            } else {
                mean_magnitude(&truth)
            };
            relative(rms_difference(&run, &truth), mean) / (1.0 + share).sqrt()
        };
        self.aovs.iter().zip(&self.means).map(of).collect()
    }

    /// The worst of `errors` over what is allowed.
    fn ratio(&self, errors: &[f64]) -> f64 {
        errors
            .iter()
            .zip(&self.allowed)
            .map(|(error, allowed)| error / allowed)
            .fold(0.0, f64::max)
    }

    /// Double and redouble rays at half of the receivers until the number that the tolerance needs is in sight; that
    /// number, and the power that the error falls with.
    fn climb(&self) -> Result<(f64, f64), Cancelled> {
        let mut rays = FIRST_RUNG;
        let mut law = LAW;
        let mut before: Option<f64> = None;
        let mut low = self.rays(f64::from(rays), turn(1), &self.half)?.results;
        for rung in 2.. {
            let high = self
                .rays(f64::from(rays * RUNG), turn(rung), &self.half)?
                .results;
            let share = f64::from(RUNG).powf(-2.0 * law);
            let ratio = self.ratio(&self.errors(&low, &high, share));
            if let Some(before) = before.filter(|_| ratio > 0.0) {
                law = ((before / ratio).ln() / f64::from(RUNG).ln()).clamp(LAWS.0, LAWS.1);
            }
            let needed = f64::from(rays) * (ratio / AIM).powf(1.0 / law);
            if needed <= f64::from(2 * RUNG * rays) || f64::from(rays * RUNG) >= MOST_RAYS {
                return Ok((needed.clamp(FEWEST_RAYS, MOST_RAYS), law));
            }
            (before, low, rays) = (Some(ratio), high, rays * RUNG);
        }
        unreachable!("the ladder ends")
    }

    /// Gather the reference and check the rays chosen at all pilot receivers; more rays where they do not hold what the
    /// ladder promised.
    fn judge(&mut self, mut rays: f64, law: f64) -> Result<Judge, Cancelled> {
        let reference_rays = REFERENCE * rays;
        let reference = self.rays(reference_rays, turn(0), &self.few)?.results;
        loop {
            let look = self.rays(rays, 0.0, &self.few)?;
            let share = (reference_rays / rays).powf(-2.0 * law);
            let errors = self.errors(&look.results, &reference, share);
            let ratio = self.ratio(&errors);
            self.trials.push(Trial {
                engine: "rays",
                knobs: vec![("rays", f64::from(round(rays)))],
                seconds_per_receiver: look.seconds_per_receiver,
                error_over_tolerance: Some(ratio),
            });
            let more = (rays * (ratio / AIM).powf(1.0 / law)).min(MOST_RAYS);
            // Beyond the reference's own number of rays the reference could not tell.
            if ratio <= 1.0 || more <= rays || more > 0.5 * reference_rays {
                return Ok(Judge {
                    rays,
                    seconds_per_receiver: look.seconds_per_receiver,
                    errors,
                    reference,
                    share,
                });
            }
            rays = more;
        }
    }

    /// Processor seconds of the run and errors if `candidate` meets the tolerance in less than `best` seconds.
    fn try_candidate(
        &mut self,
        candidate: &Candidate<'_>,
        judge: &Judge,
        best: f64,
    ) -> Result<Option<(f64, Vec<f64>)>, Cancelled> {
        if candidate.preparation >= best {
            return Ok(None);
        }
        let start = Clock::start();
        let method = (candidate.make)();
        let preparation = start.seconds();
        let glance = self
            .few
            .subset(&spread(self.few.len(), GLANCE.min(self.few.len())));
        let glance = self.look(method.as_ref(), &glance)?;
        let mut trial = Trial {
            engine: candidate.engine,
            knobs: candidate.knobs.clone(),
            seconds_per_receiver: glance.seconds_per_receiver,
            error_over_tolerance: None,
        };
        if preparation + self.run_seconds(glance.seconds_per_receiver) >= best {
            self.trials.push(trial);
            return Ok(None);
        }
        let look = self.look(method.as_ref(), &self.few)?;
        let errors = self.without_reference(&look.results, judge);
        let ratio = self.ratio(&errors);
        trial.seconds_per_receiver = look.seconds_per_receiver;
        trial.error_over_tolerance = Some(ratio);
        self.trials.push(trial);
        let seconds = preparation + self.run_seconds(look.seconds_per_receiver);
        Ok((ratio <= AIM && seconds < best).then_some((seconds, errors)))
    }

    /// Errors of `run` against the reference, whose own (known from that of the chosen rays) is subtracted.
    fn without_reference(&self, run: &Results, judge: &Judge) -> Vec<f64> {
        self.errors(run, &judge.reference, 0.0)
            .iter()
            .zip(&judge.errors)
            .map(|(both, rays)| (both * both - judge.share * rays * rays).max(0.0).sqrt())
            .collect()
    }

    fn outcome(&mut self, candidate: Option<usize>, rays: Option<u32>, engine: &[f64]) -> Outcome {
        let mut errors: Vec<ErrorEstimate> = Vec::new();
        for (i, &aov) in self.pilot.aovs.iter().enumerate() {
            let measured = measured_as(aov);
            let engine = self
                .aovs
                .iter()
                .position(|&one| one == measured)
                .and_then(|k| engine.get(k))
                .copied();
            let light = self.light.relative[i];
            let known = engine.is_some() || light > 0.0;
            if known && errors.iter().all(|error| error.aov != measured) {
                errors.push(ErrorEstimate {
                    aov: measured,
                    relative_rmse: engine.unwrap_or(0.0).hypot(light),
                    receivers: self.few.len(),
                });
            }
        }
        Outcome {
            candidate,
            rays,
            light_scale: self.light.scale,
            errors,
            trials: std::mem::take(&mut self.trials),
            receivers: self.few.len(),
            seconds: 0.0,
        }
    }
}

/// Turn of the pattern of rung `k`, none near 0, which is the run's: multiples of 1/√2 never repeat.
fn turn(k: u16) -> f32 {
    ((f32::from(k) + 1.0) * std::f32::consts::FRAC_1_SQRT_2).fract()
}

/// Rays as a number.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "between 16 and 4 · 16384"
)]
fn round(rays: f64) -> u32 {
    rays.clamp(FEWEST_RAYS, REFERENCE * MOST_RAYS).ceil() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_rungs_share_a_pattern_with_each_other_or_the_run() {
        let turns: Vec<f32> = (0..8).map(turn).collect();
        for (i, a) in turns.iter().enumerate() {
            assert!((0.05..0.97).contains(a), "{a}");
            assert!(turns[..i].iter().all(|b| (a - b).abs() > 0.02));
        }
    }

    #[test]
    fn rays_are_whole_and_within_their_range() {
        assert_eq!((round(0.0), round(16.1), round(1e9)), (16, 17, 65_536));
    }
}
