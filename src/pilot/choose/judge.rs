//! The rays that the ladder promised, against a reference at all of the pilot's receivers.

use super::{AIM, Bench, FEWEST_RAYS, Judge, LAW, MOST_RAYS, REFERENCE, round, turn};
use crate::diagnostics::Cancelled;
use crate::pilot::Trial;
use crate::pilot::error::Weighted;
use crate::results::Results;

/// Where the error of the rays chosen promises that so small a part of them would do, these are looked at too: the ladder's
/// few receivers and rays can be far off (the room of `examples`, 2 %: 2568 rays, of which 1109 do). Where it is more, the law of
/// errors tells what will come of it.
const FAR_FEWER: f64 = 0.75;

/// Of the reference's rays, so many are told by it at most: its share of the difference, 0.42 of the square, is known from
/// the law of their errors to a few percent.
const REUSED: f64 = 0.8;

/// So many times, the second time by the power that the first one told.
const TRIES: u32 = 2;

/// Rays that judge others, and the power that errors fall with.
struct Reference {
    rays: f64,
    results: Results,
    law: f64,
}

impl Reference {
    /// Squared error over that of so many `rays`.
    fn share(&self, rays: f64) -> f64 {
        (self.rays / rays).powf(-2.0 * self.law)
    }
}

/// What so many rays hold.
struct Held {
    rays: f64,
    /// Processor seconds of a receiver without neighbors.
    lone_seconds: f64,
    errors: Vec<f64>,
    /// The worst of them over what is allowed.
    ratio: f64,
}

impl Held {
    /// As many rays as are needed to come as close as is aimed at, if these are closer: errors fall with the power `law` of their
    /// number. Not below what that is known for.
    fn trim(&mut self, law: f64) {
        let fewer = self.rays * (self.ratio / AIM).powf(1.0 / law);
        let fewer = fewer.max(FAR_FEWER * self.rays).max(FEWEST_RAYS);
        if fewer < self.rays {
            let more = (self.rays / fewer).powf(law);
            self.lone_seconds *= fewer / self.rays;
            self.errors.iter_mut().for_each(|error| *error *= more);
            self.ratio *= more;
            self.rays = fewer;
        }
    }
}

impl Bench<'_, '_, '_> {
    /// Gather the reference and check the rays chosen at all pilot receivers; more rays where they do not hold what the
    /// ladder promised, fewer where they hold much more.
    pub(super) fn judge(&mut self, rays: f64, law: f64) -> Result<Judge, Cancelled> {
        let mut reference = Reference {
            rays: REFERENCE * rays,
            results: self.rays(REFERENCE * rays, turn(0), &self.few)?.results,
            law,
        };
        let mut held = self.hold(rays, &reference)?;
        let next = |held: &Held| held.rays * (held.ratio / AIM).powf(1.0 / law);
        while held.ratio > 1.0 && next(&held).min(MOST_RAYS) > held.rays {
            let more = next(&held).min(MOST_RAYS);
            if more > REUSED * reference.rays {
                reference.rays = REFERENCE * more;
                reference.results = self.rays(reference.rays, turn(0), &self.few)?.results;
            }
            held = self.hold(more, &reference)?;
        }
        let mut law = LAW;
        for _ in 0..TRIES {
            let fewer = held.rays * (held.ratio / AIM).powf(1.0 / law);
            if fewer.max(FEWEST_RAYS) >= FAR_FEWER * held.rays {
                break;
            }
            let other = self.hold(fewer.max(FEWEST_RAYS), &reference)?;
            if other.ratio <= 1.0 {
                held = other;
                break;
            }
            law = (other.ratio / held.ratio).ln() / (held.rays / other.rays).ln();
        }
        held.trim(law);
        let crowd = self.rays(held.rays, 0.0, &self.crowd)?.seconds_per_receiver;
        let seconds_per_receiver = crowd.min(held.lone_seconds);
        self.trials.push(Trial {
            engine: "rays",
            knobs: vec![("rays", f64::from(round(held.rays)))],
            seconds_per_receiver,
            error_over_tolerance: Some(held.ratio),
        });
        Ok(Judge {
            law: reference.law,
            share: reference.share(held.rays),
            rays: held.rays,
            seconds_per_receiver,
            lone_seconds: held.lone_seconds,
            errors: held.errors,
            reference: reference.results,
        })
    }

    /// What so many rays hold at all pilot receivers.
    fn hold(&self, rays: f64, reference: &Reference) -> Result<Held, Cancelled> {
        let look = self.rays(rays, 0.0, &self.few)?;
        let both = (&look.results, &reference.results);
        let weighted = Weighted(&self.sample.weights);
        let errors = self.errors(both, reference.share(rays), weighted);
        Ok(Held {
            rays,
            lone_seconds: look.seconds_per_receiver,
            ratio: self.ratio(&errors),
            errors,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_beyond_what_is_aimed_at_are_left_out() {
        let held = |ratio: f64| Held {
            rays: 800.0,
            lone_seconds: 8.0,
            errors: vec![0.5 * ratio, ratio],
            ratio,
        };
        let mut one = held(0.8);
        one.trim(LAW);
        assert!((one.ratio - AIM).abs() < 1e-12 && (one.errors[0] - 0.5 * AIM).abs() < 1e-12);
        assert!((one.rays - 800.0 * (0.8_f64 / 0.9).powf(4.0 / 3.0)).abs() < 1e-9);
        assert!((one.lone_seconds - 0.01 * one.rays).abs() < 1e-12);
        let mut close = held(0.95);
        close.trim(LAW);
        assert_eq!((close.rays, close.ratio), (800.0, 0.95));
        // Never far, whatever the error was; and where fewer are known to err much more, hardly.
        let mut none = held(0.0);
        none.trim(LAW);
        assert_eq!((none.rays, none.ratio), (600.0, 0.0));
        let mut steep = held(0.8);
        steep.trim(3.0);
        assert!(steep.rays > 760.0 && (steep.ratio - AIM).abs() < 1e-12);
    }
}
