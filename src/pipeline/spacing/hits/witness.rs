//! A few of the run's receivers, or many, and how far what they read from surfels is from light found anew.

use super::super::super::Error;
use super::super::super::gather::{errors_of_surfels, read_surfels, relight};
use super::super::{Ladder, Relit, is_measured, judged_as};
use super::{Judged, Noise};
use crate::bake::Baked;
use crate::bounce::Bounces;
use crate::diagnostics::Diagnostics;
use crate::gather::{self, GatherScene, RadianceSource, RaysEngine, RaysSettings};
use crate::pilot::error::{mean_magnitude, relative, rms_difference, values};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use rayon::prelude::*;
use std::f64::consts::SQRT_2;

/// Receivers that look at a time.
const PART: usize = 8;

/// Rays of a set at each of the few receivers: the finer the tolerance the more, since one set of many leaves less noise
/// than several of few.
const RAYS: (f64, f64) = (64.0, 256.0);
/// Those of a tolerance of 1.
const RAYS_OF_ONE: f64 = 5.12;

/// Rays of all sets at most.
const MOST_RAYS: f64 = 2_097_152.0;

/// Pairs of sets at few receivers, where there are many: what these do not tell hangs on which receivers look. In a room with
/// pebbles (1024², 2 %) one of 128 receivers told 2.0 % of surfels that leave 1.2, and rays had to make up for it: 40 s, not 12.
const PAIRS_OF_FEW: usize = 2;

/// Rays that judge surfels over those of the run, beyond what leaves no more in doubt than what is allowed; each takes about twice the time, since its neighbors are far.
/// In a Cornell box with two balls (13 480 points, one bounce, 1 %) sets without end took 3.9 s to tell 0.67 from 0.6 %
/// before a run of 3.3 s.
const JUDGING: f64 = 0.05;

/// Turn of the pattern from one set to the next: no multiple is one of the run (0), the pilot or `verify`.
const TURN: f32 = 0.267_949_2;

/// Standard errors between the estimate and what is allowed that are enough to tell.
const SURE: f64 = 2.0;

/// So small a standard error, in squares of what is allowed, needs no more sets: a tenth of the tolerance, more or less. With 0.5 a
/// Cornell box under a dome, 512², 2 %, was looked at eight times as often, for 4 s of 8.
const SMALL: f64 = 0.6;

/// Part of the standard error that counts as error where it could not be told.
const DOUBT: f64 = 0.5;

/// Components of a carrier.
const COLORS: f64 = 3.0;

/// Values of each carrier, in order.
pub(super) type Values = Vec<Vec<f64>>;

/// What a few receivers see, lit anew.
pub(super) struct Witness<'a> {
    ladder: &'a Ladder<'a>,
    /// AOVs that hold all of the surfels' error in those that are asked for.
    carriers: Vec<Aov>,
    /// The few receivers, and the many, some at a time.
    few: Vec<Receivers>,
    many: Vec<Receivers>,
    /// Of a set.
    rays: f64,
    /// Mean magnitude of what each AOV of the run is judged as.
    means: Vec<f64>,
    /// Two sets with all hits lit anew, once asked for: the same for all clouds.
    at_hits: Vec<Values>,
}

impl<'a> Witness<'a> {
    pub(super) fn new(ladder: &'a Ladder<'a>) -> Self {
        let mut carriers: Vec<Aov> = ladder.looked_at().into_iter().map(carrier).collect();
        carriers.sort();
        carriers.dedup();
        Self {
            ladder,
            carriers,
            few: in_parts(ladder.few),
            many: in_parts(ladder.many),
            rays: (RAYS_OF_ONE / ladder.tolerance)
                .clamp(RAYS.0, RAYS.1)
                .round(),
            means: Vec::new(),
            at_hits: Vec::new(),
        }
    }

    /// Two sets that light no hit anew, and so differ by the pattern of rays alone.
    pub(super) fn patterns(
        &self,
        baked: &Baked,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Values>, Error> {
        let unlit = read_surfels(baked, self.ladder.world, (Bounces::Count(1), 0.0));
        self.two_sets(&unlit, diagnostics)
    }

    /// What the surfels of `baked`, with these [`Self::patterns`], leave in each of the run's AOVs where hits nearer than
    /// `near_radii` of theirs are lit anew.
    pub(super) fn judge(
        &mut self,
        (baked, patterns): (&Baked, &[Values]),
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
            noise: self.noise([&reads, patterns]),
            relit_share,
        };
        let worth = JUDGING * self.ladder.rays_of_run(&unjudged);
        let errors = errors_of_surfels(baked, self.ladder.world, near_radii);
        let squares = self.errors(errors.as_ref(), worth, diagnostics)?;
        Ok(Judged {
            errors: squares.iter().map(told).collect(),
            sure: squares.iter().map(sure).collect(),
            ..unjudged
        })
    }

    /// Mean square of the relative error of each of the run's AOVs by that `of` surfels, and its standard error: what few
    /// receivers tell, or many if that is not enough. Ends when it is, or after as many rays as are `worth` it, once no more
    /// is in doubt than what is allowed.
    fn errors(
        &self,
        of: Option<&RadianceSource<'_>>,
        worth: f64,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<(f64, f64)>, Error> {
        let has_many = self.many.len() > self.few.len();
        if has_many {
            let few = (&self.few[..], PAIRS_OF_FEW, worth);
            let (found, is_known) = self.errors_at(few, of, diagnostics)?;
            if is_known {
                return Ok(found);
            }
        }
        let most = self.pairs_of(MOST_RAYS, self.ladder.many.len());
        let all = (&self.many[..], most, worth);
        Ok(self.errors_at(all, of, diagnostics)?.0)
    }

    /// The same by receivers in `parts`, after so many pairs of sets at most, and whether that is enough.
    fn errors_at(
        &self,
        (parts, most, worth): (&[Receivers], usize, f64),
        of: Option<&RadianceSource<'_>>,
        diagnostics: &Diagnostics,
    ) -> Result<(Vec<(f64, f64)>, bool), Error> {
        let allowed = self.ladder.allowed.powi(2);
        let count = parts.iter().map(Receivers::len).sum();
        let worth = self.pairs_of(worth / (1.0 + self.ladder.rays_of_hit()), count);
        let mut sums: [Values; 2] = [Vec::new(), Vec::new()];
        let mut found = Vec::new();
        for pair in 0..most.max(PAIRS_OF_FEW) {
            for (half, sum) in sums.iter_mut().enumerate() {
                let set = 2 * pair + half;
                let results = self.look((of, parts), set, &self.carriers, diagnostics)?;
                add(sum, &self.of_carriers(&results));
            }
            found = self.squares(&sums, (pair + 1) as f64);
            let is_known = |&(square, error): &(f64, f64)| {
                self.is_sure((square, error)) || (pair + 1 >= worth && error < allowed)
            };
            if pair > 0 && found.iter().take(self.ladder.bound).all(is_known) {
                return Ok((found, true));
            }
        }
        Ok((found, false))
    }

    /// Surfels leave no error where none is read. `None` where a few rays can't light a hit.
    pub(super) fn all_anew(
        &mut self,
        (baked, patterns): (&Baked, &[Values]),
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
            noise: self.noise([&self.at_hits, patterns]),
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

    /// What rays leave in each of the run's AOVs that bind it: of two kinds of sets the first two of one differ by all of it, those
    /// of the other by the pattern's part.
    fn noise(&self, kinds: [&[Values]; 2]) -> Vec<Noise> {
        let square = |sets: &[Values], c: usize, mean: f64| match sets {
            [a, b, ..] => {
                let noise = relative(rms_difference(&a[c], &b[c]), mean) / SQRT_2;
                (noise / self.ladder.tolerance).powi(2)
            }
            _ => 0.0,
        };
        let aovs = self.ladder.aovs.iter().zip(&self.means);
        let bound = aovs.take(self.ladder.bound);
        let noise = |(&aov, &mean): (&Aov, &f64)| {
            let c = self.carrier_index(aov)?;
            let [all, pattern] = kinds.map(|sets| square(sets, c, mean));
            Some(Noise::of((all, pattern), self.rays))
        };
        bound.filter_map(noise).collect()
    }

    /// Two sets by `source`.
    fn two_sets(
        &self,
        source: &RadianceSource<'_>,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Values>, Error> {
        let look = |set| {
            let asked = (Some(source), &self.few[..]);
            let results = self.look(asked, set, &self.carriers, diagnostics)?;
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
        let results = self.look((Some(source), &self.few), 0, &looked_at, diagnostics)?;
        let mean =
            |&aov: &Aov| mean_magnitude(&values(&results, judged_as(aov)).unwrap_or_default());
        self.means = self.ladder.aovs.iter().map(mean).collect();
        Ok(())
    }

    fn of_carriers(&self, results: &Results) -> Values {
        let of = |&aov: &Aov| values(results, aov).unwrap_or_default();
        self.carriers.iter().map(of).collect()
    }

    /// What receivers in `parts` see: all of them at once would be one block, one thread's work.
    fn look(
        &self,
        (source, parts): (Option<&RadianceSource<'_>>, &[Receivers]),
        set: usize,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Error> {
        let engine = self.engine(source.cloned(), set);
        let look =
            |some: &Receivers| gather::gather(self.scene(), &engine, some, aovs, diagnostics);
        let parts: Vec<Results> = parts.par_iter().map(look).collect::<Result<_, _>>()?;
        let mut parts = parts.into_iter();
        let mut all = parts.next().unwrap_or_default();
        for part in parts {
            for (buffer, more) in all.buffers.iter_mut().zip(part.buffers) {
                buffer.data.extend(more.data);
            }
        }
        Ok(all)
    }

    /// Pairs of sets at `count` receivers that make so many rays.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a part of the rays of a run"
    )]
    fn pairs_of(&self, rays: f64, count: usize) -> usize {
        (rays / (2.0 * self.rays * count.max(1) as f64)) as usize
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

/// Some of `receivers` at a time.
fn in_parts(receivers: &Receivers) -> Vec<Receivers> {
    let all: Vec<usize> = (0..receivers.len()).collect();
    let parts = all.chunks(PART);
    parts.map(|part| receivers.subset(part)).collect()
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
