//! The errors of maps themselves, measured with few directions and told for many.
//!
//! Two sets of directions are drawn. What is wrong at a receiver in both of them is wrong there with any: the mean of the
//! products of both errors is the square of the part that stays. The rest, errors of single pixels and outlines, is
//! independent from direction to direction: its square falls with their number. So told, errors of 64 directions met those
//! of 256 and 1024 in a box with two spheres, a bunny and a scan where a fixed law was off by factors of 2.3 and 0.5.

use super::along::along_axes;
use super::spread::Spread;
use super::{Asked, DETAILS, Question, SkyBid, Start, round, worst};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::maps::{self, MapsPlan, MapsSettings, MapsSky, SkyWanted, Visibility, Wanted};
use crate::pilot::clock::Clock;
use crate::pilot::error::Weighted;

/// Directions of each set of a trial over those of the run, at least and at most so many.
const SHARE: f64 = 0.0625;
const DIRECTIONS: (f64, f64) = (12.0, 32.0);

/// Directions of the second set over the first: no axis of one is near that of the other all over.
const OTHER: f64 = 1.17;

/// One of the sets of directions that are tried.
pub(super) struct Set {
    directions: f64,
    sky: Option<MapsSky>,
    /// What rays along them see, of each thing asked for.
    truth: Vec<Vec<f64>>,
}

/// Both sets, for a run of about `guess` directions.
pub(super) fn sets(question: &Question<'_>, start: &Start<'_>, guess: f64) -> [Set; 2] {
    let first = (SHARE * guess).clamp(DIRECTIONS.0, DIRECTIONS.1);
    [first, OTHER * first].map(|directions| {
        let directions = directions.round();
        let sky = question.sky(&start.settings(DETAILS[0], directions));
        let count = round(directions);
        let truth = along_axes(question, count, start.max_distance, sky.as_ref());
        Set {
            directions,
            sky,
            truth,
        }
    })
}

/// Processor seconds that [`Attempt::make`] is expected to take.
pub(super) fn expected_seconds(
    question: &Question<'_>,
    (plan, settings): Drawing<'_>,
    sets: &[Set; 2],
) -> f64 {
    let of = |set: &Set| maps::seconds(plan, question.few.len(), &settings(set.directions));
    sets.iter().map(of).sum()
}

/// A detail of maps that was tried.
pub(super) struct Attempt {
    /// Of the second set, as the cost is.
    settings: MapsSettings,
    own: Vec<Own>,
    seconds: f64,
    /// Share of receivers handed over.
    ambiguous: f64,
}

/// Squared relative error of maps against rays along the same directions.
struct Own {
    /// The part that stays with any number of directions.
    lasting: f64,
    /// The rest, times the number of directions.
    scattered: f64,
}

impl Own {
    /// Of errors over the mean of the truth, with two sets of so many directions.
    fn of([first, second]: [&[f64]; 2], directions: [f64; 2], weighted: Weighted<'_>) -> Self {
        let mean = |a: &[f64], b: &[f64]| weighted.mean(a.iter().zip(b).map(|(a, b)| a * b));
        let squares = [mean(first, first), mean(second, second)];
        let lasting = mean(first, second).clamp(0.0, squares[0].min(squares[1]));
        let scattered = |k: usize| directions[k] * (squares[k] - lasting);
        Self {
            lasting,
            scattered: 0.5 * (scattered(0) + scattered(1)),
        }
    }

    fn error(&self, directions: f64) -> f64 {
        (self.lasting + self.scattered / directions).sqrt()
    }
}

/// The maps, and their settings for a number of directions.
type Drawing<'a> = (&'a MapsPlan<'a>, &'a dyn Fn(f64) -> MapsSettings);

impl Attempt {
    pub(super) fn make(
        question: &Question<'_>,
        (plan, settings): Drawing<'_>,
        sets: &[Set; 2],
        diagnostics: &Diagnostics,
    ) -> Result<Self, Cancelled> {
        let mut errors: [Vec<Vec<f64>>; 2] = Default::default();
        let (mut seconds, mut ambiguous) = (0.0, 0.0);
        for (set, errors) in sets.iter().zip(&mut errors) {
            let clock = Clock::start();
            let wanted = Wanted {
                environment: set.sky.as_ref().map(|sky| SkyWanted {
                    sky,
                    with_direction: false,
                }),
                ..Wanted::default()
            };
            let settings = settings(set.directions);
            let seen = maps::visibility(plan, question.few, &settings, &wanted, diagnostics)?;
            seconds = clock.seconds();
            let handed_over = seen.ambiguous.iter().map(|&yes| f64::from(u8::from(yes)));
            ambiguous = question.weighted.mean(handed_over);
            let asked = question.asked.iter().zip(&set.truth);
            *errors = asked
                .map(|(asked, truth)| differences(asked, &seen, truth))
                .collect();
        }
        let directions = [sets[0].directions, sets[1].directions];
        let [first, second] = &errors;
        let own = first.iter().zip(second);
        Ok(Self {
            settings: settings(directions[1]),
            own: own
                .map(|(first, second)| Own::of([first, second], directions, question.weighted))
                .collect(),
            seconds,
            ambiguous,
        })
    }

    fn own_errors(&self, directions: f64) -> Vec<f64> {
        self.own.iter().map(|own| own.error(directions)).collect()
    }

    /// As many directions as the tolerance needs, and what they cost.
    pub(super) fn bid(
        &self,
        question: &Question<'_>,
        (plan, settings): Drawing<'_>,
        spread: &Spread,
    ) -> SkyBid {
        let directions = spread.needed(&|directions| self.own_errors(directions), question);
        let own_errors = self.own_errors(directions);
        let chosen = settings(directions);
        let handed_over = self.ambiguous * question.total as f64 * question.handed_over_seconds;
        let errors = spread.with(&own_errors, directions);
        SkyBid {
            settings: chosen,
            seconds: self.shared_seconds(plan, &chosen)
                + looks(plan, question.total, &chosen)
                + question.image_seconds
                + handed_over,
            ratio: worst(&errors, question),
            own_ratio: worst(&own_errors, question),
            errors,
        }
    }

    /// Seconds for drawing, as measured: what does not grow with the directions, and what does.
    fn shared_seconds(&self, plan: &MapsPlan<'_>, chosen: &MapsSettings) -> f64 {
        let drawing = maps::seconds(plan, 0, &self.settings).min(self.seconds);
        let ratio = f64::from(chosen.directions) / f64::from(self.settings.directions);
        self.seconds - drawing + ratio * drawing
    }
}

/// What maps have wrong of `asked`, over its mean; nothing where rays look instead.
fn differences(asked: &Asked, seen: &Visibility, truth: &[f64]) -> Vec<f64> {
    let found: Vec<f64> = if asked.is_image {
        let light = seen.environment.iter().flat_map(|light| light.to_array());
        light.map(f64::from).collect()
    } else {
        seen.visibility.iter().copied().map(f64::from).collect()
    };
    let components = (truth.len() / seen.ambiguous.len().max(1)).max(1);
    let scale = if asked.mean > 0.0 {
        1.0 / asked.mean
    } else {
        1.0
    };
    let pairs = found.iter().zip(truth).enumerate();
    pairs
        .map(|(i, (found, truth))| match seen.ambiguous[i / components] {
            true => 0.0,
            false => scale * (found - truth),
        })
        .collect()
}

/// Seconds that the looks of `receivers` take.
fn looks(plan: &MapsPlan<'_>, receivers: usize, settings: &MapsSettings) -> f64 {
    maps::seconds(plan, receivers, settings) - maps::seconds(plan, 0, settings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_two_sets_have_wrong_alike_stays_and_the_rest_falls_with_the_root_of_their_number() {
        // 3 % stays; 8 % and 4 % at 25 and 100 directions change from set to set, independently.
        let errors = |scattered: f64, signs: [f64; 4]| signs.map(|sign| 0.03 + sign * scattered);
        let first = errors(0.08, [1.0, -1.0, 1.0, -1.0]);
        let second = errors(0.04, [1.0, 1.0, -1.0, -1.0]);
        let own = Own::of([&first, &second], [25.0, 100.0], Weighted(&[1.0; 4]));
        for (directions, expected) in [(25.0, 0.08), (100.0, 0.04), (400.0, 0.02)] {
            let error = own.error(directions);
            assert!(
                (error - f64::hypot(0.03, expected)).abs() < 1e-9,
                "{directions}: {error}"
            );
        }
        // Opposite errors: nothing stays, and no root of a negative number is taken.
        let own = Own::of(
            [&[0.1, -0.1], &[-0.1, 0.1]],
            [10.0, 10.0],
            Weighted(&[1.0; 2]),
        );
        assert!((own.error(1000.0) - 0.01).abs() < 1e-9);
    }
}
