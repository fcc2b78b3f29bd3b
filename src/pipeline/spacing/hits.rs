//! What surfels' size costs, told by light found anew at what a few receivers see.
//!
//! Where rays read surfels their hits are lit anew; what differs on the way to the mean over many rays is the surfels'
//! error. Light at a hit is itself noisy, so two independent sets of rays are compared: the product of both differences
//! is in the mean the square of the error, with no part of the noise in it. Sets are added until the noise left tells on
//! which side of the allowed error the surfels are.
//!
//! Hits near surfels that are too coarse can be lit anew farther out, all hits can, or surfels can be finer: whatever
//! takes the fewest rays.

use super::super::Error;
use super::super::gather::{dice, errors_of_surfels, read_surfels, relight};
use super::super::report::Report;
use super::{Climbed, FEWEST, Ladder, MOST, Relit, STALLED, is_measured, judged_as, law, more};
use crate::bake::Baked;
use crate::bounce::Bounces;
use crate::diagnostics::Diagnostics;
use crate::gather::{self, GatherScene, HitLight, RadianceSource, RaysEngine, RaysSettings};
use crate::pilot::clock::Clock;
use crate::pilot::error::{mean_magnitude, relative, rms_difference, values};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use rayon::prelude::*;
use std::f64::consts::SQRT_2;

/// Receivers that look at a time.
const PART: usize = 8;

/// Tolerance that a run's usual surfels suit, about: the Cornell box of the README takes 0.3 times as many.
const USUAL: f64 = 0.01;

/// Radii within which hits are lit anew, from few to many. Surfels' error at the points of Nefertiti (scan, 100 000
/// triangles) under a sky with four small bright areas, by 1.5, 4, 12 and 40 radii: 1.7, 0.7, 0.8, 0.8 % of 25 000
/// surfels, 2.5, 0.9, 0.75, 0.8 % of 103 000 (no more than 0.7 % could be told).
const NEAR_RADII: [f32; 2] = [HitLight::NEAR_RADII, 6.0];

/// Rays of a set at each of the few receivers: the finer the tolerance the more, since one set of many leaves less noise
/// than several of few.
const RAYS: (f64, f64) = (64.0, 256.0);
/// Those of a tolerance of 1.
const RAYS_OF_ONE: f64 = 5.12;

/// Rays at each of the few receivers at most, of all sets: two million at 128 receivers.
const MOST_RAYS: f64 = 16_384.0;

/// Rays that judge surfels over those of the run, beyond what leaves no more in doubt than what is allowed; each takes about twice the time, since its neighbors are far.
/// In a Cornell box with two balls (13 480 points, one bounce, 1 %) sets without end took 3.9 s to tell 0.67 from 0.6 %
/// before a run of 3.3 s.
const JUDGING: f64 = 0.05;

/// Turn of the pattern from one set to the next: no multiple is one of the run (0), the pilot or `verify`.
const TURN: f32 = 0.267_949_2;

/// Standard errors between the estimate and what is allowed that are enough to tell.
const SURE: f64 = 2.0;

/// So small a standard error, in squares of what is allowed, needs no more sets.
const SMALL: f64 = 0.5;

/// Part of the standard error that counts as error where it could not be told.
const DOUBT: f64 = 0.5;

/// Part of the tolerance that rays may use up beside surfels.
const RAYS_SHARE: f64 = 0.8;

/// Part of its square that is left to them at least, whatever surfels take.
const LEAST_LEFT: f64 = 0.25;

/// Rays that light a finer cloud, over those of the run, that are worth trying where it is in doubt whether it is needed.
const WORTH: f64 = 0.25;

/// Rays traced, in those of a run: to find the sky's light at a surfel (half of its directions are below the horizon, and
/// 64 surfels look along one together) and at a hit, and each light's. Counted, not timed: a run chooses the same on
/// every machine.
const SKY_RAYS_A_SURFEL: f64 = 32.0;
const SKY_RAYS_A_HIT: f64 = 4.0;
const LIGHT_RAYS: f64 = 1.0;

/// Fewest rays of a run.
const FEWEST_RAYS: f64 = 16.0;

/// Power of the rays that the square of a pattern's error falls with (measured: 64 to 4096 rays), and that of noise at
/// hits.
const PATTERN_LAW: f64 = 1.5;
const HITS_LAW: f64 = 1.0;

/// Components of a carrier.
const COLORS: f64 = 3.0;

/// What surfels leave, and how it comes to that.
#[derive(Debug, Default)]
struct Judged {
    errors: Vec<f64>,
    /// What of them is beyond doubt: surfels are not to blame for the rest, which would make the run dear.
    sure: Vec<f64>,
    relit: Relit,
    /// Rays that a receiver of the run needs.
    rays: f64,
    /// Share of them whose hits are lit anew.
    relit_share: f64,
}

impl Ladder<'_> {
    /// Finer and finer clouds, until one is fine enough and a finer one would take more rays than lighting more hits anew.
    /// What was asked for by name stays.
    pub(super) fn climb_by_hits(
        &self,
        (report, diagnostics): (&mut Report, &Diagnostics),
    ) -> Result<Climbed, Error> {
        let mut settings = self.job.bake_settings(self.receivers);
        if !self.is_fixed() {
            settings.surfels = self.first(settings.surfels);
        }
        let mut witness = Witness::new(self);
        let mut before = None;
        let start = Clock::start();
        loop {
            let dicing = Clock::start();
            let baked = dice(self.world, &settings, (&mut *report, diagnostics))?;
            let dicing = dicing.seconds();
            let judged = self.judge_all(&mut witness, &baked, diagnostics)?;
            let (worst, count) = (self.least(&judged), baked.cloud.len());
            let is_stalled = before.is_some_and(|before| law((before, (count, worst))) < STALLED);
            let is_last = self.is_fixed() || is_stalled || count >= MOST;
            let (next, rays_with_finer) = self.finer(&judged, count);
            let best = self.best(judged);
            let is_enough = self.worst(&best.errors) <= 1.0;
            let is_cheap = self.rays_of_dicing(next) <= WORTH * self.rays_of_run(&best);
            let is_doubtful = self.worst(&best.sure) <= 1.0;
            let is_good = is_enough && self.rays_of_run(&best) <= rays_with_finer;
            if is_last || is_good || (is_doubtful && !is_cheap) {
                report.set("spacing", f64::from(baked.cloud.spacing));
                report.set("surfel_error", self.worst(&best.errors) * self.allowed);
                report.set("relit", best.relit.name());
                return Ok(Climbed {
                    baked,
                    errors: best.errors,
                    relit: best.relit,
                    judging: start.seconds() - dicing,
                });
            }
            settings.surfels = next;
            before = Some((count, worst));
        }
    }

    /// What the surfels of `baked` leave, the nearest hits lit anew first; farther ones only where the nearer do not do.
    fn judge_all(
        &self,
        witness: &mut Witness<'_>,
        baked: &Baked,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Judged>, Error> {
        let mut all = Vec::new();
        for radii in NEAR_RADII {
            let judged = witness.judge(baked, radii, diagnostics)?;
            let is_enough = self.worst(&judged.errors) <= 1.0;
            all.push(judged);
            if is_enough || !self.job.bounces.is_at_most_once() {
                return Ok(all);
            }
        }
        if !self.is_fixed() {
            all.extend(witness.all_anew(baked, diagnostics)?);
        }
        Ok(all)
    }

    /// The least of the worst errors that surfels leave.
    fn least(&self, judged: &[Judged]) -> f64 {
        let read = judged.iter().filter(|one| one.relit != Relit::All);
        let worst = read.map(|one| self.worst(&one.errors));
        worst.fold(f64::INFINITY, f64::min)
    }

    /// The one that is good enough with the fewest rays, or else the best.
    fn best(&self, judged: Vec<Judged>) -> Judged {
        let rank = |one: &Judged| {
            let worst = self.worst(&one.sure);
            if worst <= 1.0 {
                (0.0, self.rays_of_run(one))
            } else {
                (worst, 0.0)
            }
        };
        let best = judged.into_iter().min_by(|a, b| {
            let ((a, rays_a), (b, rays_b)) = (rank(a), rank(b));
            a.total_cmp(&b).then(rays_a.total_cmp(&rays_b))
        });
        best.unwrap_or_default()
    }

    /// How many surfels are tried after `count` of them that were `judged`, and rays with these, if they are good enough.
    fn finer(&self, judged: &[Judged], count: usize) -> (usize, f64) {
        let read = judged.iter().filter(|one| one.relit != Relit::All);
        let rays = read.map(|one| {
            let next = more(count, self.worst(&one.errors));
            (next, self.rays_of_dicing(next) + self.rays_of_run(one))
        });
        rays.min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((count, f64::INFINITY))
    }

    /// Surfels to begin with.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "part of a count"
    )]
    fn first(&self, usual: usize) -> usize {
        let part = (USUAL / self.tolerance).min(1.0);
        ((usual as f64 * part) as usize).max(FEWEST)
    }

    /// Rays that light `surfels`.
    fn rays_of_dicing(&self, surfels: usize) -> f64 {
        let (lights, sky) = self.lights();
        surfels as f64 * (1.0 + lights + SKY_RAYS_A_SURFEL * sky)
    }

    /// Rays of all receivers, as many as meet the tolerance beside the surfels' error, and those that light their hits.
    fn rays_of_run(&self, judged: &Judged) -> f64 {
        let error = self.worst(&judged.errors) * self.allowed / self.tolerance;
        let left = (1.0 - error * error).max(LEAST_LEFT).sqrt();
        let more = (RAYS_SHARE / left).max(1.0);
        let more = more.powf(2.0 / law_of_squares(judged.relit_share));
        let of_hits = judged.relit_share * self.rays_of_hit();
        self.receivers as f64 * judged.rays * more * (1.0 + of_hits)
    }

    /// Rays that light a hit anew.
    fn rays_of_hit(&self) -> f64 {
        let (lights, sky) = self.lights();
        lights + SKY_RAYS_A_HIT * sky
    }

    /// Rays to lights from each place, and 1 where there is a sky.
    fn lights(&self) -> (f64, f64) {
        let lighting = &self.world.lighting;
        let sky = f64::from(u8::from(lighting.has_environment()));
        (LIGHT_RAYS * lighting.light_count() as f64, sky)
    }
}

/// Values of each carrier, in order.
type Values = Vec<Vec<f64>>;

/// What a few receivers see, lit anew.
struct Witness<'a> {
    ladder: &'a Ladder<'a>,
    /// AOVs that hold all of the surfels' error in those that are asked for.
    carriers: Vec<Aov>,
    /// The few receivers, some at a time.
    parts: Vec<Receivers>,
    /// Of a set.
    rays: f64,
    /// Mean magnitude of what each AOV of the run is judged as.
    means: Vec<f64>,
    /// Two sets with all hits lit anew, once asked for: the same for all clouds.
    at_hits: Vec<Values>,
}

impl<'a> Witness<'a> {
    fn new(ladder: &'a Ladder<'a>) -> Self {
        let mut carriers: Vec<Aov> = ladder.looked_at().into_iter().map(carrier).collect();
        carriers.sort();
        carriers.dedup();
        let few: Vec<usize> = (0..ladder.few.len()).collect();
        let parts = few.chunks(PART).map(|part| ladder.few.subset(part));
        let parts = parts.collect();
        Self {
            ladder,
            carriers,
            parts,
            rays: (RAYS_OF_ONE / ladder.tolerance)
                .clamp(RAYS.0, RAYS.1)
                .round(),
            means: Vec::new(),
            at_hits: Vec::new(),
        }
    }

    /// What the surfels of `baked` leave in each of the run's AOVs where hits nearer than `near_radii` of theirs are lit
    /// anew.
    fn judge(
        &mut self,
        baked: &Baked,
        near_radii: f32,
        diagnostics: &Diagnostics,
    ) -> Result<Judged, Error> {
        let by_surfels = read_surfels(baked, self.ladder.world, (Bounces::Count(1), near_radii));
        if self.means.is_empty() {
            self.measure_means(&by_surfels, diagnostics)?;
        }
        let reads = self.two_sets(&by_surfels, diagnostics)?;
        let relit_share = self.relit_share(&by_surfels);
        let unjudged = Judged {
            errors: Vec::new(),
            sure: Vec::new(),
            relit: Relit::Near(near_radii),
            rays: self.rays_needed(&reads, relit_share),
            relit_share,
        };
        let pairs = self.pairs_worth(self.ladder.rays_of_run(&unjudged));
        let errors = errors_of_surfels(baked, self.ladder.world, near_radii);
        let squares = self.errors(errors.as_ref(), pairs, diagnostics)?;
        Ok(Judged {
            errors: squares.iter().map(told).collect(),
            sure: squares.iter().map(sure).collect(),
            ..unjudged
        })
    }

    /// Mean square of the relative error of each of the run's AOVs by that `of` surfels, and its standard error. Ends when
    /// these tell enough, or after as many pairs of sets as are `worth` it, once no more is in doubt than what is allowed.
    fn errors(
        &self,
        of: Option<&RadianceSource<'_>>,
        worth: usize,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<(f64, f64)>, Error> {
        let allowed = self.ladder.allowed.powi(2);
        let mut sums: [Values; 2] = [Vec::new(), Vec::new()];
        let mut found = Vec::new();
        for pair in 0..self.most_pairs() {
            for (half, sum) in sums.iter_mut().enumerate() {
                let set = 2 * pair + half;
                let results = self.look(of, set, &self.carriers, diagnostics)?;
                add(sum, &self.of_carriers(&results));
            }
            found = self.squares(&sums, (pair + 1) as f64);
            let is_known = |&(square, error): &(f64, f64)| {
                self.is_sure((square, error)) || (pair + 1 >= worth && error < allowed)
            };
            if pair > 0 && found.iter().take(self.ladder.bound).all(is_known) {
                break;
            }
        }
        Ok(found)
    }

    /// Surfels leave no error where none is read. `None` where a few rays can't light a hit.
    fn all_anew(
        &mut self,
        baked: &Baked,
        diagnostics: &Diagnostics,
    ) -> Result<Option<Judged>, Error> {
        let world = self.ladder.world;
        let Some(light) = relight(baked, world, &world.lighting) else {
            return Ok(None);
        };
        let anew = RadianceSource::AtHits(light);
        let relit_share = self.relit_share(&anew);
        if self.at_hits.is_empty() {
            self.at_hits = self.two_sets(&anew, diagnostics)?;
        }
        Ok(Some(Judged {
            errors: Vec::new(),
            sure: Vec::new(),
            relit: Relit::All,
            rays: self.rays_needed(&self.at_hits, relit_share),
            relit_share,
        }))
    }

    fn relit_share(&self, source: &RadianceSource<'_>) -> f64 {
        source.relit_share(&self.ladder.world.tracer, self.ladder.few)
    }

    /// True if a squared error with this standard error is known well enough.
    fn is_sure(&self, (square, error): (f64, f64)) -> bool {
        let allowed = self.ladder.allowed.powi(2);
        let is_more = square - SURE * error > allowed;
        let is_less = square + SURE * error < allowed && error < allowed;
        is_more || is_less || error < SMALL * allowed
    }

    /// Mean square of the relative error of each of the run's AOVs and its standard error, from the sums of the
    /// differences at both halves of `pairs` pairs.
    fn squares(&self, sums: &[Values; 2], pairs: f64) -> Vec<(f64, f64)> {
        let of = |(&aov, &mean): (&Aov, &f64)| {
            let Some(c) = self.carrier_index(aov) else {
                return (0.0, 0.0);
            };
            let (middle, error) = mean_square([&sums[0][c], &sums[1][c]]);
            let square = |x: f64| relative(relative(x, mean), mean) / (pairs * pairs);
            (square(middle), square(error))
        };
        self.ladder.aovs.iter().zip(&self.means).map(of).collect()
    }

    /// Which carrier tells the error of `aov`; `None` if surfels leave none in it.
    fn carrier_index(&self, aov: Aov) -> Option<usize> {
        let is_told = |&c: &Aov| is_measured(aov) && c == carrier(judged_as(aov));
        self.carriers.iter().position(is_told)
    }

    /// Rays that bring the noise of `sets`, the first two of which are looked at, down to what the tolerance leaves for them;
    /// in the hits of `relit_share` light is found anew.
    fn rays_needed(&self, sets: &[Values], relit_share: f64) -> f64 {
        let [a, b, ..] = sets else {
            return FEWEST_RAYS;
        };
        let allowed = RAYS_SHARE * self.ladder.tolerance;
        let law = law_of_squares(relit_share);
        let needed = |(&aov, &mean): (&Aov, &f64)| {
            let c = self.carrier_index(aov)?;
            let noise = relative(rms_difference(&a[c], &b[c]), mean) / SQRT_2;
            Some(self.rays * (noise / allowed).powf(2.0 / law))
        };
        let aovs = self.ladder.aovs.iter().zip(&self.means);
        let bound = aovs.take(self.ladder.bound);
        bound.filter_map(needed).fold(FEWEST_RAYS, f64::max)
    }

    /// Two sets by `source`.
    fn two_sets(
        &self,
        source: &RadianceSource<'_>,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Values>, Error> {
        let look = |set| {
            let results = self.look(Some(source), set, &self.carriers, diagnostics)?;
            Ok(self.of_carriers(&results))
        };
        [0, 1].into_iter().map(look).collect()
    }

    fn measure_means(
        &mut self,
        source: &RadianceSource<'_>,
        diagnostics: &Diagnostics,
    ) -> Result<(), Error> {
        let looked_at = self.ladder.looked_at();
        let results = self.look(Some(source), 0, &looked_at, diagnostics)?;
        let mean =
            |&aov: &Aov| mean_magnitude(&values(&results, judged_as(aov)).unwrap_or_default());
        self.means = self.ladder.aovs.iter().map(mean).collect();
        Ok(())
    }

    fn of_carriers(&self, results: &Results) -> Values {
        let of = |&aov: &Aov| values(results, aov).unwrap_or_default();
        self.carriers.iter().map(of).collect()
    }

    /// Some of the few receivers at a time: all of them would be one block, one thread's work.
    fn look(
        &self,
        source: Option<&RadianceSource<'_>>,
        set: usize,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Error> {
        let engine = self.engine(source.cloned(), set);
        let look =
            |some: &Receivers| gather::gather(self.scene(), &engine, some, aovs, diagnostics);
        let parts: Vec<Results> = self.parts.par_iter().map(look).collect::<Result<_, _>>()?;
        let mut parts = parts.into_iter();
        let mut all = parts.next().unwrap_or_default();
        for part in parts {
            for (buffer, more) in all.buffers.iter_mut().zip(part.buffers) {
                buffer.data.extend(more.data);
            }
        }
        Ok(all)
    }

    /// Pairs of sets that a run of so many rays is worth.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "part of a count"
    )]
    fn pairs_worth(&self, rays_of_run: f64) -> usize {
        let of_ray = 1.0 + self.ladder.rays_of_hit();
        let of_pair = 2.0 * self.rays * of_ray * self.ladder.few.len() as f64;
        (JUDGING * rays_of_run / of_pair) as usize
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at most 128"
    )]
    fn most_pairs(&self) -> usize {
        (0.5 * MOST_RAYS / self.rays) as usize
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at most 256"
    )]
    fn engine<'s>(&self, source: Option<RadianceSource<'s>>, set: usize) -> RaysEngine<'s>
    where
        'a: 's,
    {
        let settings = RaysSettings {
            rays: self.rays as u32,
            max_distance: self.ladder.job.max_distance,
            turn: TURN * (set + 1) as f32,
            cone: None,
        };
        RaysEngine::new(&self.ladder.world.tracer, source, settings)
    }

    fn scene(&self) -> GatherScene<'a> {
        let world = self.ladder.world;
        GatherScene {
            shader: world.shader,
            tracer: &world.tracer,
            lighting: Some(&world.lighting),
        }
    }
}

/// Power of the rays that squared errors fall with where light is found anew in the hits of `relit_share`.
fn law_of_squares(relit_share: f64) -> f64 {
    PATTERN_LAW + (HITS_LAW - PATTERN_LAW) * relit_share
}

/// Error as it is reported, from its square and the standard error of that: doubt counts.
fn told(&(square, error): &(f64, f64)) -> f64 {
    (square.max(0.0) + DOUBT * error).sqrt()
}

/// Error beyond doubt, from its square and the standard error of that.
fn sure(&(square, error): &(f64, f64)) -> f64 {
    (square - error).max(0.0).sqrt()
}

/// The part of `aov` that errs as surfels do.
fn carrier(aov: Aov) -> Aov {
    match aov {
        Aov::Irradiance => Aov::IrradianceIndirect,
        Aov::Color => Aov::DiffuseIndirect,
        other => other,
    }
}

/// Add `values` to `sums`, each carrier's.
fn add(sums: &mut Values, values: &Values) {
    sums.resize(values.len(), Vec::new());
    for (sum, values) in sums.iter_mut().zip(values) {
        sum.resize(values.len(), 0.0);
        sum.iter_mut().zip(values).for_each(|(sum, x)| *sum += x);
    }
}

/// Mean of the products of two independent findings of the same values, and its standard error: in the mean that of the
/// values' squares, whatever the noise of each.
fn mean_square([a, b]: [&[f64]; 2]) -> (f64, f64) {
    let products: Vec<f64> = a.iter().zip(b).map(|(a, b)| a * b).collect();
    let count = products.len().max(1) as f64;
    let middle = products.iter().sum::<f64>() / count;
    let spread: f64 = products.iter().map(|x| (x - middle) * (x - middle)).sum();
    // colors of one receiver are one finding
    let findings = (count / COLORS).max(1.0);
    (middle, (spread / count / findings).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sequence::fibonacci;

    #[test]
    fn noise_much_larger_than_the_error_is_no_part_of_its_square() {
        // an error of 0.01 under independent noise with rms 0.1/√3 each
        let count = 3 * 20_000;
        let noise = |of: fn(glam::Vec2) -> f32| -> Vec<f64> {
            let value = |i| 0.01 + 0.1 * (2.0 * f64::from(of(fibonacci(i, count))) - 1.0);
            (0..count).map(value).collect()
        };
        let (square, error) = mean_square([&noise(|p| p.x), &noise(|p| p.y)]);
        let expected = 0.1_f64.powi(2) / 3.0 / 20_000_f64.sqrt();
        assert!((error / expected - 1.0).abs() < 0.1, "{error} {expected}");
        assert!((square - 1e-4).abs() < 2.0 * error, "{square} ± {error}");
    }

    #[test]
    fn values_of_sets_add_up() {
        let mut sums = Vec::new();
        add(&mut sums, &vec![vec![3.0, 1.0]]);
        add(&mut sums, &vec![vec![1.0, -2.0]]);
        assert_eq!(sums, [[4.0, -1.0]]);
    }
}
