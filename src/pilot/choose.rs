//! The choice itself.

mod by_maps;
mod errors;
mod groups;
mod judge;

use super::check::Check;
use super::clock::Clock;
use super::crowd::crowd;
use super::error::{Weighted, measured_as};
use super::image::Image;
use super::light::{self, LightError};
use super::sample::Sample;
use super::{Candidate, Maps, Method, Outcome, Pick, Pilot, Trial};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::estimate::spread;
use crate::gather::maps::{self, MapsSettings};
use crate::gather::{ErrorEstimate, GatherScene, RaysSettings, Thinning};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};

pub(crate) const LAW: f64 = RaysSettings::LAW;

/// Range in which a measured power is believed: random rays have 0.5, smooth integrands 1.
const LAWS: (f64, f64) = (0.5, 1.0);

/// Fewest and most rays that are chosen; the reference may have [`REFERENCE`] times as many.
const FEWEST_RAYS: f64 = 16.0;
const MOST_RAYS: f64 = 65_536.0;

/// The ladder's first rung and the ratio of its rungs.
const FIRST_RUNG: u32 = 32;
const RUNG: u32 = 4;

/// Rays of the reference over the chosen number. Its own error, half of the run's squared, is known: more rays tell the
/// run's hardly better, since what is uncertain comes of the few receivers.
const REFERENCE: f64 = 1.5;

/// Engines beside rays and maps are looked at where what they stand on takes at most this share of the run: in none of
/// the scenes of the README did one win at 5 % or less, and trying them took a sixth of the pilot.
const TRYING: f64 = 0.01;

/// Of `color`, what surfaces reflect may be off by so many times the tolerance of the color at single receivers, root of the
/// mean square: where no lamp shines it is all there is, and 5 % of a picture full of lamplight are blotches there. Under an
/// open sky it is little everywhere.
const LOOSEST_REFLECTION: f64 = 1.0;

/// Share of the tolerance aimed at: the error of a few receivers is that of all within about a tenth.
pub(super) const AIM: f64 = 0.9;

/// The same of maps: what maps have wrong hangs on few receivers, and maps that do not keep what they promise
/// take the time of others beside their own. At the 13 480 points of the Cornell box 120 receivers told 1.8 %, and all had more
/// than 2; at the pixels of two teapots in a box 256 told 1.7, and all 2.05.
pub(super) const AIM_OF_MAPS: f64 = 0.75;

/// The same where members of a group err alike, and only few groups are looked at.
const AIM_OF_GROUPS: f64 = 0.75;

/// The pilot looks at one in so many receivers: the reference and the check cost about two and a half times the run's rays
/// there, without neighbors seven times: 7 % of a run in which rays see for all receivers.
const ONE_IN: usize = 112;

/// Pilot receivers at least (if there are so many) and at most.
const FEWEST: usize = 48;
const MOST: usize = 256;

/// What a receiver costs that speaks for others, over one of all: it has no neighbors; what it costs to blend one, in processor
/// seconds; and how much more than that it may come to be, where not all of it is true. Cornell box, teapots, bunny, room,
/// 512², visibility at 5 and 1 %, AVX-512.
const APART: f64 = 2.0;
const BLENDING: f64 = 1.7e-6;
const DOUBT: f64 = 1.15;

/// Processor seconds of maps that are too few to find out whether rays at few receivers take less.
const SOON: f64 = 1.0;

/// Receivers that tell whether a candidate's cost is worth a closer look.
const GLANCE: usize = 16;

/// The cheapest way to meet the tolerance, or the most exact one if none does. Deterministic but for the choice between
/// engines, which hangs on measured time.
///
/// # Errors
/// When cancelled.
pub fn choose(pilot: &Pilot<'_, '_>, diagnostics: &Diagnostics) -> Result<Outcome, Cancelled> {
    let start = Clock::start();
    let coarse = (pilot.rays)(FIRST_RUNG, 0.0);
    let count = looked_at(pilot.receivers.len());
    let sample = Sample::of_run(pilot, coarse.as_ref(), count, diagnostics)?;
    let few = pilot.receivers.subset(&sample.picks);
    let looked = (&few, Weighted(&sample.weights));
    let light = light::measure(pilot, coarse.as_ref(), looked, diagnostics)?;
    let image = match pilot.maps {
        Maps::Never => None,
        _ => Image::measure(pilot, coarse.as_ref(), &light, diagnostics)?,
    };
    let mut bench = Bench::new(pilot, (sample, few), (light, image), diagnostics);
    let mut outcome = bench.choose()?;
    outcome.seconds = start.seconds();
    Ok(outcome)
}

/// Receivers spread over `count` of them, as many as a pilot looks at.
pub fn picks(count: usize) -> Vec<usize> {
    spread(count, looked_at(count))
}

/// How many receivers a pilot looks at, of `count`.
fn looked_at(count: usize) -> usize {
    (count / ONE_IN).clamp(FEWEST, MOST).min(count)
}

/// Rays that err by so many `times` what `rays` do; 16 at least, or `rays`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "part of a count"
)]
pub fn rays_with_errors(rays: u32, times: f64) -> u32 {
    let fewer = f64::from(rays) * times.powf(-1.0 / LAW);
    (fewer.ceil() as u32).max(rays.min(FEWEST_RAYS as u32))
}

/// What `fewer` rays err by, in times what `rays` do; not below 1.
pub fn errors_with_rays(fewer: u32, rays: u32) -> f64 {
    (f64::from(rays) / f64::from(fewer.max(1)))
        .powf(LAW)
        .max(1.0)
}

/// The pilot at work.
struct Bench<'b, 'a, 'c> {
    pilot: &'b Pilot<'a, 'c>,
    diagnostics: &'b Diagnostics,
    scene: GatherScene<'a>,
    /// The pilot's receivers, which of all they are, and every other one of them with its weight.
    few: Receivers,
    sample: Sample,
    half: (Receivers, Vec<f64>),
    /// Neighbors, which tell what a receiver of the run costs.
    crowd: Receivers,
    light: LightError,
    /// An environment with an image that maps could see.
    image: Option<Image>,
    aovs: Vec<Measured>,
    trials: Vec<Trial>,
    /// Share of all receivers that rays would see for, where maps could do so instead.
    share: Option<f64>,
    /// Neighbors of the pilot's receivers, once a candidate needs them.
    groups: Option<groups::Groups>,
}

/// An AOV that depends on the engine.
#[derive(Debug, Clone, Copy)]
struct Measured {
    /// As it is measured.
    aov: Aov,
    mean: f64,
    /// What error of the engine it allows.
    allowed: f64,
    /// How many times that of rays.
    evened: f64,
    /// Its error that no engine changes.
    fixed: f64,
    /// True if it only asks for the sky, which maps see too.
    is_sky: bool,
}

/// Results of one method, and what they cost.
struct Look {
    results: Results,
    seconds_per_receiver: f64,
}

/// Rays that were chosen and what judges everything else.
struct Judge {
    rays: f64,
    /// See [`Ladder::law`].
    law: f64,
    seconds_per_receiver: f64,
    /// The same of a receiver without neighbors.
    lone_seconds: f64,
    errors: Vec<f64>,
    reference: Results,
    /// Squared error of the reference over that of the chosen rays.
    share: f64,
}

/// Rays that each AOV needs, and the power that their error falls with.
struct Ladder {
    needed: Vec<f64>,
    /// Of the largest error, as far as it was measured.
    law: f64,
}

impl Ladder {
    fn most(&self) -> f64 {
        self.needed.iter().copied().fold(FEWEST_RAYS, f64::max)
    }
}

/// What is best so far.
struct Best {
    pick: Pick,
    /// Without those of an environment with an image, unless it is maps that see it.
    seconds: f64,
    errors: Vec<f64>,
    /// Error of maps in such an environment.
    image: Option<f64>,
}

impl Best {
    /// Nothing depends on the engine.
    fn light_alone() -> Self {
        Self {
            pick: Pick::Rays,
            seconds: 0.0,
            errors: Vec::new(),
            image: None,
        }
    }
}

impl<'b, 'a, 'c> Bench<'b, 'a, 'c> {
    fn new(
        pilot: &'b Pilot<'a, 'c>,
        (sample, few): (Sample, Receivers),
        (light, image): (LightError, Option<Image>),
        diagnostics: &'b Diagnostics,
    ) -> Self {
        let half = few.subset(&(0..few.len()).step_by(2).collect::<Vec<_>>());
        let weights = sample.weights.iter().step_by(2).copied().collect();
        let mut bench = Self {
            scene: pilot.scenes.engine(),
            pilot,
            diagnostics,
            few,
            sample,
            half: (half, weights),
            crowd: crowd(pilot.receivers),
            light,
            image,
            aovs: Vec::new(),
            trials: Vec::new(),
            share: None,
            groups: None,
        };
        for i in 0..pilot.aovs.len() {
            bench.measure(i);
        }
        bench
    }

    /// Add AOV `i` of the run to those that are measured, if it depends on the engine.
    fn measure(&mut self, i: usize) {
        let aov = self.pilot.aovs[i];
        let measured = measured_as(aov);
        let known = self.aovs.iter().any(|one| one.aov == measured);
        if known || aov.error_of().is_some() || !self.pilot.scenes.depends_on_engine(aov) {
            return;
        }
        let tolerance = self.pilot.tolerance;
        let fixed = self.fixed(i);
        let left = tolerance.powi(2) - fixed.powi(2);
        // Light that misses the tolerance on its own leaves nothing: the engine then does not add much.
        let least = 0.25 * tolerance * tolerance;
        let mean = self.light.means[i];
        let reflected = self.light.reflected.filter(|_| aov == Aov::Color);
        let most = reflected
            .filter(|reflected| reflected.mean > 0.0 && reflected.share > 0.0 && mean > 0.0)
            .map_or(f64::INFINITY, |reflected| {
                LOOSEST_REFLECTION * tolerance / reflected.share * reflected.mean / mean
            });
        let is_sky = maps::supports(aov);
        self.aovs.push(Measured {
            aov: measured,
            mean,
            allowed: left.max(least).sqrt().min(most),
            evened: if is_sky { self.pilot.evened } else { 1.0 },
            fixed,
            is_sky,
        });
    }

    /// Error of AOV `i` of the run that no engine changes: of direct light, and of the surfels.
    fn fixed(&self, i: usize) -> f64 {
        let surfels = self.pilot.surfel_errors.get(i).copied().unwrap_or(0.0);
        self.light.relative[i].hypot(surfels)
    }

    fn choose(&mut self) -> Result<Outcome, Cancelled> {
        if self.few.is_empty() || (self.aovs.is_empty() && self.image.is_none()) {
            return Ok(self.outcome(&Best::light_alone(), None));
        }
        if self.aovs.is_empty() {
            let maps = self.try_maps(None, 0.0)?;
            return Ok(self.outcome(&maps.unwrap_or_else(Best::light_alone), None));
        }
        let mut ladder = self.climb()?;
        let judge = self.judge(ladder.most(), ladder.law)?;
        // What the check of the whole asks for, its hungriest AOV needs; the others what they were seen to need there.
        let grown = judge.rays / ladder.most();
        let ratios = self.ratios(&judge.errors);
        for (rays, ratio) in ladder.needed.iter_mut().zip(ratios) {
            let seen = judge.rays * (ratio / AIM).powf(1.0 / LAW);
            *rays = (*rays * grown).max(seen).min(judge.rays);
        }
        if self.by_maps(judge.rays) > SOON && self.aovs.iter().any(|one| one.is_sky) {
            self.share = (self.pilot.share)(round(judge.rays))?;
        }
        let mut best = Best {
            pick: Pick::Rays,
            seconds: self.rays_seconds(judge.seconds_per_receiver),
            errors: judge.errors.clone(),
            image: None,
        };
        let mut too_dear = None;
        for (i, candidate) in self.pilot.candidates.iter().enumerate() {
            if too_dear == Some(candidate.engine) {
                continue;
            }
            if let Some((seconds, errors)) = self.try_candidate(candidate, &judge, best.seconds)? {
                best = Best {
                    pick: Pick::Candidate(i),
                    seconds,
                    errors,
                    image: None,
                };
            }
            // The next settings of this engine are dearer still.
            let last = self.trials.last();
            let is_enough = matches!(best.pick, Pick::Candidate(chosen) if chosen == i);
            let is_dear = |trial: &&Trial| trial.error_over_tolerance.is_none() || is_enough;
            too_dear = last.filter(is_dear).map(|trial| trial.engine);
        }
        if let Some(better) = self.try_maps(Some((&ladder, &judge)), best.seconds)? {
            best = better;
        }
        Ok(self.outcome(&best, Some(judge)))
    }

    fn run_seconds(&self, seconds_per_receiver: f64) -> f64 {
        seconds_per_receiver * self.pilot.receivers.len() as f64
    }

    /// Processor seconds that maps will probably take where so many `rays` do; 0 where they may not.
    fn by_maps(&self, rays: f64) -> f64 {
        let Maps::IfCheaper(plan, _) = self.pilot.maps else {
            return 0.0;
        };
        let settings = MapsSettings {
            directions: round(rays),
            ..MapsSettings::SMOOTH
        };
        maps::seconds(plan, self.pilot.receivers.len(), &settings)
    }

    /// [`Self::run_seconds`] of rays, fewer where receivers speak for each other.
    fn rays_seconds(&self, seconds_per_receiver: f64) -> f64 {
        let each = self.run_seconds(seconds_per_receiver);
        let all = each * self.pilot.thinning.map_or(1.0, Thinning::cost);
        let blended = |share| DOUBT * (APART * share * each + self.run_seconds(BLENDING));
        self.share.map_or(all, |share| all.min(blended(share)))
    }

    fn rays(&self, count: f64, turn: f32, receivers: &Receivers) -> Result<Look, Cancelled> {
        self.look((self.pilot.rays)(round(count), turn).as_ref(), receivers)
    }

    fn look(&self, method: &dyn Method, receivers: &Receivers) -> Result<Look, Cancelled> {
        let aovs: Vec<Aov> = self.aovs.iter().map(|one| one.aov).collect();
        let start = Clock::start();
        let results = method.gather(self.scene, receivers, &aovs, self.diagnostics)?;
        Ok(Look {
            results,
            seconds_per_receiver: start.seconds() / receivers.len().max(1) as f64,
        })
    }

    /// Double and redouble rays at half of the receivers until the number that the tolerance needs is in sight.
    fn climb(&self) -> Result<Ladder, Cancelled> {
        let (half, weights) = &self.half;
        let weighted = Weighted(weights);
        let mut rays = FIRST_RUNG;
        let mut law = LAW;
        let mut before: Option<f64> = None;
        let mut low = self.rays(f64::from(rays), turn(1), half)?.results;
        for rung in 2.. {
            let high = self.rays(f64::from(rays * RUNG), turn(rung), half)?.results;
            let share = f64::from(RUNG).powf(-2.0 * law);
            let errors = self.errors((&low, &high), share, weighted);
            let ratio = self.ratio(&errors);
            if let Some(before) = before.filter(|_| ratio > 0.0) {
                law = ((before / ratio).ln() / f64::from(RUNG).ln()).clamp(LAWS.0, LAWS.1);
            }
            let needed = |ratio: f64| f64::from(rays) * (ratio / AIM).powf(1.0 / law);
            // So far the law is relied on.
            let known = f64::from(2 * RUNG * rays);
            if needed(ratio).min(MOST_RAYS) <= known {
                let ratios = self.ratios(&errors).into_iter();
                let needed = ratios.map(|ratio| needed(ratio).clamp(FEWEST_RAYS, MOST_RAYS));
                let needed = needed.collect();
                return Ok(Ladder { needed, law });
            }
            (before, low, rays) = (Some(ratio), high, rays * RUNG);
        }
        unreachable!("the ladder ends")
    }

    /// Processor seconds of the run and errors if `candidate` meets the tolerance in less than `best` seconds.
    fn try_candidate(
        &mut self,
        candidate: &Candidate<'_>,
        judge: &Judge,
        best: f64,
    ) -> Result<Option<(f64, Vec<f64>)>, Cancelled> {
        if candidate.preparation >= TRYING * best {
            return Ok(None);
        }
        let start = Clock::start();
        let method = (candidate.make)();
        let preparation = start.seconds();
        let glance = if candidate.sees_groups {
            self.glanced(method.as_ref())?
        } else {
            let some = spread(self.few.len(), GLANCE.min(self.few.len()));
            let look = self.look(method.as_ref(), &self.few.subset(&some))?;
            look.seconds_per_receiver
        };
        let mut trial = Trial {
            engine: candidate.engine,
            knobs: candidate.knobs.clone(),
            seconds_per_receiver: glance,
            error_over_tolerance: None,
        };
        if preparation + self.run_seconds(glance) >= best {
            self.trials.push(trial);
            return Ok(None);
        }
        let (seconds_per_receiver, errors) = self.tried((candidate, method.as_ref()), judge)?;
        let ratio = self.ratio_alone(&errors);
        trial.seconds_per_receiver = seconds_per_receiver;
        trial.error_over_tolerance = Some(ratio);
        self.trials.push(trial);
        let seconds = preparation + self.run_seconds(seconds_per_receiver);
        let aim = if candidate.sees_groups {
            AIM_OF_GROUPS
        } else {
            AIM
        };
        Ok((ratio <= aim && seconds < best).then_some((seconds, errors)))
    }

    fn outcome(&mut self, best: &Best, judge: Option<Judge>) -> Outcome {
        let mut errors: Vec<ErrorEstimate> = Vec::new();
        for (i, &aov) in self.pilot.aovs.iter().enumerate() {
            let measured = measured_as(aov);
            let place = self.aovs.iter().position(|one| one.aov == measured);
            let engine = place.and_then(|k| best.errors.get(k)).copied();
            let sky = best
                .image
                .filter(|_| measured == Aov::IrradianceEnvironment);
            // Maps' error is measured with that of the light's samples.
            let (engine, fixed) = match sky {
                Some(sky) => (Some(sky), 0.0),
                None => (engine, self.fixed(i)),
            };
            let known = engine.is_some() || fixed > 0.0;
            if known && errors.iter().all(|error| error.aov != measured) {
                errors.push(ErrorEstimate {
                    aov: measured,
                    relative_rmse: engine.unwrap_or(0.0).hypot(fixed),
                    receivers: self.few.len(),
                });
            }
        }
        Outcome {
            pick: best.pick,
            rays: judge.as_ref().map(|judge| round(judge.rays)),
            law: judge.as_ref().map_or(LAW, |judge| judge.law),
            light_scale: self.light.scale,
            errors,
            trials: std::mem::take(&mut self.trials),
            receivers: self.few.len(),
            share: self.share,
            seconds: 0.0,
            check: self.check(judge),
        }
    }

    /// True if the reference, which may have been seen without lights, tells all of `aov`.
    fn holds_all_light(&self, aov: Aov) -> bool {
        self.scene.lighting.is_some() || !(aov.needs_direct() || aov.needs_environment())
    }

    fn check(&self, judge: Option<Judge>) -> Option<Check> {
        let of = |(one, error): (&Measured, &f64), share: f64| super::check::Known {
            aov: one.aov,
            mean: one.mean,
            fixed: one.fixed,
            reference: share.sqrt() * error,
        };
        let image = self.image.as_ref().map(Image::known);
        if judge.is_none() && image.is_none() {
            return None;
        }
        let (mut aovs, mut truth) = (Vec::new(), Results::default());
        if let Some(judge) = judge {
            let known = self.aovs.iter().zip(&judge.errors);
            let known = known.filter(|(one, _)| self.holds_all_light(one.aov));
            aovs.extend(known.map(|one| of(one, judge.share)));
            truth = judge.reference;
        }
        if let Some((known, values)) = image {
            aovs.push(known);
            truth.buffers.push(values);
        }
        Some(Check {
            evened: Vec::new(),
            sample: self.sample.clone(),
            aovs,
            truth,
        })
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
    reason = "between 16 and 1.5 · 65536"
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
    fn errors_and_rays_tell_each_other() {
        let times = errors_with_rays(100, 1600);
        assert!((times - 8.0).abs() < 1e-9);
        // Rounded up.
        assert!((100..=101).contains(&rays_with_errors(1600, times)));
        assert_eq!(errors_with_rays(64, 16), 1.0);
    }

    #[test]
    fn rays_are_whole_and_within_their_range() {
        assert_eq!((round(0.0), round(16.1), round(1e9)), (16, 17, 98_304));
    }
}
