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

/// Power of the number of surfels that the share of hits nearer than a few radii falls with, at least (measured, from 20 000
/// to 300 000: scan 0.53, chessmen 0.27, hair 0.17, leaves 0.16).
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

/// Fewest rays of a receiver, and most.
const FEWEST_RAYS: f64 = 16.0;
const LIMIT_OF_RAYS: f64 = 1e6;

/// Power of the rays that the square of a pattern's error falls with (measured: 64 to 4096 rays), and that of noise at
/// hits. Few hits may make most of the noise: one in 25 asked for 9900 rays on a scan under a sky with small bright areas.
const PATTERN_LAW: f64 = 1.5;
const HITS_LAW: f64 = 1.0;

/// What surfels leave, and how it comes to that.
#[derive(Debug, Clone, Default)]
struct Judged {
    errors: Vec<f64>,
    /// What of them is beyond doubt: surfels are not to blame for the rest, which would make the run dear.
    sure: Vec<f64>,
    relit: Relit,
    /// What rays leave in each of the run's AOVs that bind it.
    noise: Vec<Noise>,
    /// Share of rays whose hits are lit anew.
    relit_share: f64,
}

/// Squares of what rays err by, over those of the tolerance, if a receiver had one ray.
#[derive(Debug, Clone, Copy, Default)]
struct Noise {
    /// Of the pattern.
    pattern: f64,
    /// Of light found anew at hits.
    hits: f64,
}

impl Noise {
    /// By two parts found with so many `rays`: all of the square, and that of the pattern.
    fn of((all, pattern): (f64, f64), rays: f64) -> Self {
        Self {
            pattern: pattern.min(all) * rays.powf(PATTERN_LAW),
            hits: (all - pattern).max(0.0) * rays.powf(HITS_LAW),
        }
    }

    /// What so many rays leave.
    fn left_by(&self, rays: f64) -> f64 {
        self.pattern * rays.powf(-PATTERN_LAW) + self.hits * rays.powf(-HITS_LAW)
    }

    /// Rays that leave the square of `allowed`, of the tolerance.
    fn rays_for(&self, allowed: f64) -> f64 {
        let (mut few, mut many) = (FEWEST_RAYS, LIMIT_OF_RAYS);
        if self.left_by(few) <= allowed * allowed {
            return few;
        }
        while many > 1.001 * few {
            let middle = (few * many).sqrt();
            if self.left_by(middle) <= allowed * allowed {
                many = middle;
            } else {
                few = middle;
            }
        }
        many
    }
}

impl Judged {
    /// What is to be expected of `growth` times as many surfels, if the share of hits lit anew falls with that power of them.
    fn of_finer(&self, growth: f64, share_law: f64) -> Self {
        let (error, share) = (growth.powf(-0.5 * LAW), growth.powf(-share_law));
        let less = |errors: &[f64]| errors.iter().map(|all| all * error).collect();
        let noise = |one: &Noise| Noise {
            hits: one.hits * share,
            ..*one
        };
        Self {
            errors: less(&self.errors),
            sure: less(&self.sure),
            relit: self.relit,
            noise: self.noise.iter().map(noise).collect(),
            relit_share: self.relit_share * share,
        }
    }

    /// Rays of a receiver that leave the square of `allowed`, of the tolerance, in all AOVs.
    fn rays_for(&self, allowed: f64) -> f64 {
        let rays = self.noise.iter().map(|noise| noise.rays_for(allowed));
        rays.fold(FEWEST_RAYS, f64::max)
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
        let patterns = witness.patterns(baked, diagnostics)?;
        let cloud = (baked, &patterns[..]);
        for radii in NEAR_RADII {
            let judged = witness.judge(cloud, radii, diagnostics)?;
            let is_enough = self.worst(&judged.errors) <= 1.0;
            all.push(judged);
            if is_enough || !self.job.bounces.is_at_most_once() {
                return Ok(all);
            }
        }
        if !self.is_fixed() {
            all.extend(witness.all_anew(cloud, diagnostics)?);
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

    /// How many surfels are tried after `count` of them that were `judged`, and rays with these, if they are good enough: as many
    /// as that takes, or the most that are tried next, whichever takes fewer rays.
    fn finer(&self, judged: &[Judged], count: usize) -> (usize, f64) {
        let read = judged.iter().filter(|one| one.relit != Relit::All);
        let candidates = read.zip(share_laws(judged)).flat_map(|(one, share_law)| {
            [self.worst(&one.errors), f64::INFINITY].map(|excess| {
                let next = more(count, excess);
                let finer = one.of_finer(next as f64 / count.max(1) as f64, share_law);
                let rays = self.rays_of_dicing(next) + self.rays_of_run(&finer);
                (next, rays, self.worst(&finer.errors) <= 1.0)
            })
        });
        let best = candidates.min_by(|a, b| b.2.cmp(&a.2).then(a.1.total_cmp(&b.1)));
        match best {
            Some((next, rays, true)) => (next, rays),
            Some((next, ..)) => (next, f64::INFINITY),
            None => (count, f64::INFINITY),
        }
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
        let of_hits = judged.relit_share * self.rays_of_hit();
        self.receivers as f64 * judged.rays_for(left.min(RAYS_SHARE)) * (1.0 + of_hits)
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

/// Powers of the number of surfels that the share of hits lit anew falls with, in the order of [`NEAR_RADII`]. That of hits
/// within the most radii becomes that within the fewest, where surfels are as much smaller; and nearer to surfaces it falls faster.
fn share_laws(judged: &[Judged]) -> [f64; NEAR_RADII.len()] {
    let [fewest, most] = NEAR_RADII;
    let [near, far, ..] = judged else {
        return [SHARE_LAW; 2];
    };
    let spans = 2.0 * f64::from(most / fewest).ln();
    let law = (far.relit_share / near.relit_share).ln() / spans;
    let law = if law.is_finite() { law } else { SHARE_LAW };
    [law.max(SHARE_LAW), law]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_leave_what_is_allowed_of_noise_of_either_kind() {
        let only = |pattern, hits| Noise::of((pattern + hits, pattern), 256.0);
        // A square sixteen times too large.
        assert!((only(0.16, 0.0).rays_for(0.1) / 256.0 - 16_f64.powf(1.0 / 1.5)).abs() < 0.01);
        assert!((only(0.0, 0.16).rays_for(0.1) / 256.0 - 16.0).abs() < 0.1);
        let both = only(0.08, 0.08);
        assert!((both.left_by(both.rays_for(0.1)) / 0.01 - 1.0).abs() < 0.01);
        assert_eq!(only(0.0, 0.0).rays_for(0.1), FEWEST_RAYS);
        assert!(only(1e9, 1e9).rays_for(1e-3) >= LIMIT_OF_RAYS / 1.001);
    }

    fn judged(relit_share: f64) -> Judged {
        Judged {
            errors: vec![0.04],
            sure: vec![0.02],
            relit: Relit::default(),
            noise: vec![Noise::of((0.16, 0.08), 256.0)],
            relit_share,
        }
    }

    #[test]
    fn finer_surfels_are_expected_to_err_less_and_leave_fewer_hits_to_light() {
        let judged = judged(0.4);
        let finer = judged.of_finer(16.0, 0.25);
        assert!((finer.errors[0] - 0.01).abs() < 1e-9 && finer.sure[0] < 0.0051);
        assert!((finer.relit_share - 0.2).abs() < 1e-9);
        assert!(finer.rays_for(0.1) < judged.rays_for(0.1));
    }

    #[test]
    fn surfels_of_a_quarter_of_the_radius_leave_far_what_was_near() {
        let [near, far] = [0.3, 0.5].map(judged);
        let [law_near, law_far] = share_laws(&[near, far.clone()]);
        assert!((far.of_finer(16.0, law_far).relit_share - 0.3).abs() < 1e-9);
        assert_eq!(law_near, law_far, "near hits fall no slower than far ones");
        assert_eq!(share_laws(&[judged(0.45), judged(0.5)])[0], SHARE_LAW);
        for known in [vec![], vec![judged(0.3)], vec![judged(0.0), judged(0.0)]] {
            assert_eq!(share_laws(&known), [SHARE_LAW; 2]);
        }
    }
}
