//! What surfels' size costs, told by light found anew at what a few receivers see.
//!
//! Where rays read surfels their hits are lit anew; what differs on the way to the mean over many rays is the surfels'
//! error. Light at a hit is itself noisy, so two independent sets of rays are compared: the product of both differences
//! is in the mean the square of the error, with no part of the noise in it. More receivers look, and sets are added, until the
//! noise left tells on which side of the allowed error the surfels are.
//!
//! Hits near surfels that are too coarse can be lit anew farther out, all hits can, or surfels can be finer: whatever
//! takes the fewest rays.

mod witness;

use super::super::Error;
use super::super::gather::{dice, surfel_samples};
use super::super::report::Report;
use super::{Climbed, FEWEST, LAW, Ladder, MOST, Relit, STALLED, law, more};
use crate::bake::Baked;
use crate::diagnostics::Diagnostics;
use crate::gather::HitLight;
use crate::pilot::clock::Clock;
use witness::Witness;

/// Tolerance that a run's usual surfels suit, about: the Cornell box of the README takes 0.3 times as many.
const USUAL: f64 = 0.01;

/// Radii within which hits are lit anew, from few to many. Surfels' error at the points of Nefertiti (scan, 100 000
/// triangles) under a sky with four small bright areas, by 1.5, 4, 12 and 40 radii: 1.7, 0.7, 0.8, 0.8 % of 25 000
/// surfels, 2.5, 0.9, 0.75, 0.8 % of 103 000 (no more than 0.7 % could be told).
const NEAR_RADII: [f32; 2] = [HitLight::NEAR_RADII, 6.0];

/// Part of the tolerance that rays may use up beside surfels.
const RAYS_SHARE: f64 = 0.8;

/// Part of its square that is left to them at least, whatever surfels take.
const LEAST_LEFT: f64 = 0.25;

/// Rays that light a finer cloud, over those of the run, that are worth trying where it is in doubt whether it is needed.
const WORTH: f64 = 0.25;

/// Power of the number of surfels that the share of hits lit anew falls with, at least (measured, from 20 000 to 300 000:
/// chessmen 0.27, hair 0.17, leaves 0.16).
const SHARE_LAW: f64 = 0.15;

/// Surfels that are fine enough give way to finer ones that bring down the rays of the run to this part, with their own:
/// judging takes some too.
const FEWER: f64 = 0.8;

/// Rays traced, in those of a run: to find the sky's light at a surfel, for each of its directions (half of them are below the
/// horizon, and 64 surfels look along one together), and at a hit, and each light's. Counted, not timed: a run chooses the same on
/// every machine.
const SKY_RAYS_A_DIRECTION: f64 = 0.25;
const SKY_RAYS_A_HIT: f64 = 4.0;
const LIGHT_RAYS: f64 = 1.0;

/// Fewest rays of a run.
const FEWEST_RAYS: f64 = 16.0;

/// Power of the rays that the square of a pattern's error falls with (measured: 64 to 4096 rays), and that of noise at
/// hits.
const PATTERN_LAW: f64 = 1.5;
const HITS_LAW: f64 = 1.0;

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

impl Judged {
    /// What is to be expected of `growth` times as many surfels.
    fn of_finer(&self, growth: f64) -> Self {
        let less = |errors: &[f64]| {
            (errors.iter())
                .map(|e| e * growth.powf(-0.5 * LAW))
                .collect()
        };
        Self {
            errors: less(&self.errors),
            sure: less(&self.sure),
            relit_share: self.relit_share * growth.powf(-SHARE_LAW),
            ..*self
        }
    }
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
            let baked = dice(
                self.world,
                (&settings, self.job.tolerance),
                (&mut *report, diagnostics),
            )?;
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
            let is_good = is_enough && FEWER * self.rays_of_run(&best) <= rays_with_finer;
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

    /// How many surfels are tried after `count` of them that were `judged`, and rays with these: as many as are good enough, or
    /// the most that are tried next, whichever takes fewer.
    fn finer(&self, judged: &[Judged], count: usize) -> (usize, f64) {
        let read = judged.iter().filter(|one| one.relit != Relit::All);
        let rays = read.flat_map(|one| {
            [self.worst(&one.errors), f64::INFINITY].map(|excess| {
                let next = more(count, excess);
                let finer = one.of_finer(next as f64 / count.max(1) as f64);
                (next, self.rays_of_dicing(next) + self.rays_of_run(&finer))
            })
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
        let of_sky =
            SKY_RAYS_A_DIRECTION * f64::from(surfel_samples(self.job.tolerance).environment);
        surfels as f64 * (1.0 + lights + of_sky * sky)
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

/// Power of the rays that squared errors fall with where light is found anew in the hits of `relit_share`.
fn law_of_squares(relit_share: f64) -> f64 {
    PATTERN_LAW + (HITS_LAW - PATTERN_LAW) * relit_share
}
