//! What surfels' size costs, told by light found anew at what a few receivers see.
//!
//! The same rays read surfels and light hits anew; what differs on the way to the mean over many rays is the surfels'
//! error. Light at a hit is itself noisy, so two independent sets of rays are compared: the product of both differences
//! is in the mean the square of the error, with no part of the noise in it. Sets are added until the noise left tells on
//! which side of the allowed error the surfels are.
//!
//! Where only very many surfels would do, the run lights all its hits anew, if that takes fewer rays.

use super::super::Error;
use super::super::gather::{dice, read_surfels, relight};
use super::super::report::Report;
use super::{Climbed, FEWEST, Ladder, MOST, Relit, STALLED, is_measured, law, more};
use crate::bake::Baked;
use crate::diagnostics::Diagnostics;
use crate::gather::{self, GatherScene, HitLight, RadianceSource, RaysEngine, RaysSettings};
use crate::pilot::error::{mean_magnitude, relative, rms_difference, values};
use crate::results::Aov;

/// Tolerance that a run's usual surfels suit, about: the Cornell box of the README takes 0.3 times as many.
const USUAL: f64 = 0.01;

/// Radii within which hits are lit anew, from few to many. Surfels' error at the points of Nefertiti (scan, 100 000
/// triangles) under a sky with four small bright areas, by 1.5, 4, 12 and 40 radii: 1.7, 0.7, 0.8, 0.8 % of 25 000
/// surfels, 2.5, 0.9, 0.75, 0.8 % of 103 000 (no more than 0.7 % could be told).
const NEAR_RADII: [f32; 2] = [HitLight::NEAR_RADII, 6.0];

/// Rays of a set at each of the few receivers.
const RAYS: u32 = 256;

/// Pairs of sets at most: two million rays at 128 receivers.
const MOST_PAIRS: usize = 32;

/// Turn of the pattern from one set to the next: no multiple is one of the run (0), the pilot or `verify`.
const TURN: f32 = 0.267_949_2;

/// Standard errors between the estimate and what is allowed that are enough to tell.
const SURE: f64 = 2.0;

/// So small a standard error, in squares of what is allowed, needs no more sets.
const SMALL: f64 = 0.25;

/// Part of the tolerance that rays may use up beside surfels.
const RAYS_SHARE: f64 = 0.8;

/// Rays traced, in those of a run: to find the sky's light at a surfel (half of its directions are below the horizon, and
/// 64 surfels look along one together) and at a hit, and each light's. Counted, not timed: a run chooses the same on
/// every machine.
const SKY_RAYS_A_SURFEL: f64 = 32.0;
const SKY_RAYS_A_HIT: f64 = 4.0;
const LIGHT_RAYS: f64 = 1.0;

/// Fewest rays of a run.
const FEWEST_RAYS: f64 = 16.0;

/// Power of the rays that the square of a pattern's error falls with (measured: 64 to 4096 rays); noise at hits falls with
/// the first.
const PATTERN_LAW: f64 = 1.5;

/// Components of a carrier.
const COLORS: f64 = 3.0;

/// What surfels leave, and how it comes to that.
struct Judged {
    errors: Vec<f64>,
    relit: Relit,
}

impl Judged {
    /// Surfels leave no error where none is read.
    const ALL: Self = Self {
        errors: Vec::new(),
        relit: Relit::All,
    };
}

impl Ladder<'_> {
    /// Finer and finer clouds, until one is fine enough or lighting all hits anew is cheaper. What was asked for by name
    /// stays.
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
        loop {
            let baked = dice(self.world, &settings, (&mut *report, diagnostics))?;
            let found = self.nearest_relit(&mut witness, &baked, diagnostics)?;
            let (worst, count) = (self.worst(&found.errors), baked.cloud.len());
            let is_stalled = before.is_some_and(|before| law((before, (count, worst))) < STALLED);
            let next = more(count, worst);
            let is_enough = worst <= 1.0 || self.is_fixed();
            let is_last = is_stalled || count >= MOST;
            let all = !is_enough
                && self.job.bounces <= 1
                && (is_last || self.is_cheaper_at_hits(&witness, next));
            if is_enough || is_last || all {
                let found = if all { Judged::ALL } else { found };
                report.set("spacing", f64::from(baked.cloud.spacing));
                report.set("surfel_error", self.worst(&found.errors) * self.allowed);
                report.set("relit", found.relit.name());
                return Ok(Climbed {
                    baked,
                    errors: found.errors,
                    relit: found.relit,
                });
            }
            settings.surfels = next;
            before = Some((count, worst));
        }
    }

    /// How far hits have to be lit anew so that the surfels of `baked` are good enough, or the farthest that is tried.
    fn nearest_relit(
        &self,
        witness: &mut Witness<'_>,
        baked: &Baked,
        diagnostics: &Diagnostics,
    ) -> Result<Judged, Error> {
        let tried = if self.job.bounces <= 1 {
            NEAR_RADII.as_slice()
        } else {
            &NEAR_RADII[..1]
        };
        let mut best: Option<Judged> = None;
        for &radii in tried {
            let judged = Judged {
                errors: witness.judge(baked, radii, diagnostics)?,
                relit: Relit::Near(radii),
            };
            let worst = self.worst(&judged.errors);
            if best
                .as_ref()
                .is_none_or(|best| worst < self.worst(&best.errors))
            {
                best = Some(judged);
            }
            if worst <= 1.0 {
                break;
            }
        }
        Ok(best.unwrap_or(Judged::ALL))
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

    /// True if the run traces fewer rays when it lights all hits anew than with `surfels` of them.
    fn is_cheaper_at_hits(&self, witness: &Witness<'_>, surfels: usize) -> bool {
        let lighting = &self.world.lighting;
        let lights = LIGHT_RAYS * lighting.light_count() as f64;
        let sky = f64::from(u8::from(lighting.has_environment()));
        let [by_surfels, at_hits] = witness.rays_needed(RAYS_SHARE * self.tolerance);
        let receivers = self.receivers as f64;
        let with_surfels =
            surfels as f64 * (1.0 + lights + SKY_RAYS_A_SURFEL * sky) + receivers * by_surfels;
        receivers * at_hits * (1.0 + lights + SKY_RAYS_A_HIT * sky) < with_surfels
    }
}

/// Values of each carrier, in order.
type Values = Vec<Vec<f64>>;

/// What a few receivers see, lit anew.
struct Witness<'a> {
    ladder: &'a Ladder<'a>,
    /// AOVs that hold all of the surfels' error in those that are asked for.
    carriers: Vec<Aov>,
    /// Mean magnitude of each AOV asked for.
    means: Vec<f64>,
    /// By set.
    at_hits: Vec<Values>,
    /// Mean square of the noise of each carrier's set, by surfels and lit anew.
    noise: Vec<[f64; 2]>,
}

impl<'a> Witness<'a> {
    fn new(ladder: &'a Ladder<'a>) -> Self {
        let mut carriers: Vec<Aov> = ladder.asked().map(carrier).collect();
        carriers.sort();
        carriers.dedup();
        Self {
            ladder,
            carriers,
            means: Vec::new(),
            at_hits: Vec::new(),
            noise: Vec::new(),
        }
    }

    /// Relative error that the surfels of `baked` leave in each of the run's AOVs where hits nearer than `near_radii` of
    /// theirs are lit anew.
    fn judge(
        &mut self,
        baked: &Baked,
        near_radii: f32,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<f64>, Error> {
        let by_surfels = read_surfels(baked, self.ladder.world, (1, near_radii));
        if self.means.is_empty() {
            self.means = self.measure_means(baked, diagnostics)?;
        }
        let mut sums: [Values; 2] = [Vec::new(), Vec::new()];
        let mut found = Vec::new();
        for pair in 0..MOST_PAIRS {
            let mut reads = Vec::new();
            for (half, sum) in sums.iter_mut().enumerate() {
                let set = 2 * pair + half;
                if self.at_hits.len() <= set {
                    let anew = self.look(self.anew(baked), set, diagnostics)?;
                    self.at_hits.push(anew);
                }
                let read = self.look(Some(by_surfels.clone()), set, diagnostics)?;
                add_differences(sum, (&read, &self.at_hits[set]));
                reads.push(read);
            }
            if pair == 0 {
                self.note_noise(&reads);
            }
            found = self.squares(&sums, (pair + 1) as f64);
            if pair > 0 && found.iter().all(|&square| self.is_sure(square)) {
                break;
            }
        }
        let error = |(square, error): (f64, f64)| (square.max(0.0) + error).sqrt();
        Ok(found.into_iter().map(error).collect())
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
        let is_told = |&c: &Aov| is_measured(aov) && c == carrier(aov);
        self.carriers.iter().position(is_told)
    }

    /// Note the noise of single sets: two of `reads` by surfels, and the first two lit anew.
    fn note_noise(&mut self, reads: &[Values]) {
        let noise = |sets: &[Values], c: usize| match sets {
            [a, b, ..] => 0.5 * rms_difference(&a[c], &b[c]).powi(2),
            _ => 0.0,
        };
        self.noise = (0..self.carriers.len())
            .map(|c| [noise(reads, c), noise(&self.at_hits, c)])
            .collect();
    }

    /// Rays that bring the noise down to the relative error `allowed`: by surfels and lit anew.
    fn rays_needed(&self, allowed: f64) -> [f64; 2] {
        let mut most = [FEWEST_RAYS; 2];
        for (&aov, &mean) in self.ladder.aovs.iter().zip(&self.means) {
            let Some(c) = self.carrier_index(aov) else {
                continue;
            };
            let square = |x: f64| relative(relative(x, mean), mean) / (allowed * allowed);
            let [surfels, hits] = self.noise[c].map(square);
            let needed = [surfels.powf(1.0 / PATTERN_LAW), hits];
            most = [0, 1].map(|i| most[i].max(f64::from(RAYS) * needed[i]));
        }
        most
    }

    fn anew<'b>(&'b self, baked: &'b Baked) -> Option<RadianceSource<'b>> {
        let world = self.ladder.world;
        relight(baked, world, &world.lighting).map(RadianceSource::AtHits)
    }

    fn measure_means(&self, baked: &Baked, diagnostics: &Diagnostics) -> Result<Vec<f64>, Error> {
        let engine = self.engine(self.anew(baked), 0);
        let aovs: Vec<Aov> = self.ladder.asked().collect();
        let results = gather::gather(self.scene(), &engine, self.ladder.few, &aovs, diagnostics)?;
        let mean = |&aov: &Aov| mean_magnitude(&values(&results, aov).unwrap_or_default());
        Ok(self.ladder.aovs.iter().map(mean).collect())
    }

    fn look(
        &self,
        source: Option<RadianceSource<'_>>,
        set: usize,
        diagnostics: &Diagnostics,
    ) -> Result<Values, Error> {
        let engine = self.engine(source, set);
        let few = self.ladder.few;
        let results = gather::gather(self.scene(), &engine, few, &self.carriers, diagnostics)?;
        let of = |&aov: &Aov| values(&results, aov).unwrap_or_default();
        Ok(self.carriers.iter().map(of).collect())
    }

    fn engine<'s>(&self, source: Option<RadianceSource<'s>>, set: usize) -> RaysEngine<'s>
    where
        'a: 's,
    {
        let settings = RaysSettings {
            rays: RAYS,
            max_distance: self.ladder.job.max_distance,
            turn: TURN * (set + 1) as f32,
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

/// The AOV by which `aov` errs as surfels do.
fn carrier(aov: Aov) -> Aov {
    match aov {
        Aov::Irradiance => Aov::IrradianceIndirect,
        Aov::Color => Aov::DiffuseIndirect,
        other => other,
    }
}

/// Add `read − anew` to `sums`, each carrier's.
fn add_differences(sums: &mut Values, (read, anew): (&Values, &Values)) {
    sums.resize(read.len(), Vec::new());
    for (sum, (read, anew)) in sums.iter_mut().zip(read.iter().zip(anew)) {
        sum.resize(read.len(), 0.0);
        for (sum, (read, anew)) in sum.iter_mut().zip(read.iter().zip(anew)) {
            *sum += read - anew;
        }
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
    fn differences_add_up() {
        let mut sums = Vec::new();
        let (read, anew) = (vec![vec![3.0, 1.0]], vec![vec![1.0, 2.0]]);
        add_differences(&mut sums, (&read, &anew));
        add_differences(&mut sums, (&read, &anew));
        assert_eq!(sums, [[4.0, -2.0]]);
    }
}
