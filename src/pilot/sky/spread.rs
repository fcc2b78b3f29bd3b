//! The error of a set of directions, measured with rays along them.

use super::along::along_axes;
use super::{Asked, DETAILS, DIRECTIONS, OWN_SHARE, Question, Start, round, worst};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::pilot::choose;
use crate::pilot::error::relative;

/// Relative error of the set of directions, of each thing asked for.
pub(super) struct Spread {
    errors: Vec<f64>,
    directions: f64,
}

/// Measurements at most until the number of directions is that which they ask for.
const MOST_LOOKS: u32 = 3;

/// Numbers of directions over one another between which the law of their error is relied on for an image, part of whose
/// error, that of its bright areas, falls with nothing.
const NEAR: (f64, f64) = (0.7, 1.4);

/// Numbers of directions are looked for in steps of this ratio.
const RUNG: f64 = 1.03;

impl Spread {
    /// Measured at about as many directions as are needed, where an image is asked for.
    pub(super) fn settled(
        question: &Question<'_>,
        guess: f64,
        start: &Start<'_>,
        diagnostics: &Diagnostics,
    ) -> Result<Self, Cancelled> {
        let is_image = question.asked.iter().any(|asked| asked.is_image);
        let mut directions = guess;
        let mut looks = 1;
        loop {
            let spread = Self::measure(question, directions, start, diagnostics)?;
            let needed = spread.least(question);
            let is_near = (NEAR.0..NEAR.1).contains(&(needed / directions));
            if !is_image || is_near || looks == MOST_LOOKS {
                return Ok(spread);
            }
            directions = needed;
            looks += 1;
        }
    }

    fn measure(
        question: &Question<'_>,
        directions: f64,
        start: &Start<'_>,
        diagnostics: &Diagnostics,
    ) -> Result<Self, Cancelled> {
        let sky = question.sky(&start.settings(DETAILS[0], directions));
        let mut found = along_axes(
            question,
            round(directions),
            start.max_distance,
            sky.as_ref(),
        );
        if let Some(sky) = &sky {
            let scene = (question.scene.shader.scene(), question.scene.tracer);
            let bright = sky.bright_light(scene, question.few, diagnostics)?;
            let images = found.iter_mut().zip(&question.asked);
            for (values, _) in images.filter(|(_, asked)| asked.is_image) {
                let bright = bright.iter().flat_map(|light| light.irradiance.to_array());
                (values.iter_mut().zip(bright)).for_each(|(sum, x)| *sum += f64::from(x));
            }
        }
        let error = |(found, asked): (&Vec<f64>, &Asked)| {
            let both = relative(
                question.weighted.rms_difference(found, &asked.truth),
                asked.mean,
            );
            let own = both * both - asked.truth_error * asked.truth_error;
            // Less than a quarter of what was measured is not told by subtraction.
            own.max(both * both / 16.0).sqrt()
        };
        Ok(Self {
            errors: found.iter().zip(&question.asked).map(error).collect(),
            directions,
        })
    }

    /// The fewest directions for maps without errors of their own.
    pub(super) fn least(&self, question: &Question<'_>) -> f64 {
        self.needed(&|_| vec![0.0; self.errors.len()], question)
    }

    fn at(&self, directions: f64) -> impl Iterator<Item = f64> {
        let left = (directions / self.directions).powf(-choose::LAW);
        self.errors.iter().map(move |error| error * left)
    }

    /// Errors of so many directions together with those of maps, `own`.
    pub(super) fn with(&self, own: &[f64], directions: f64) -> Vec<f64> {
        let both = self.at(directions).zip(own);
        both.map(|(spread, own)| spread.hypot(*own)).collect()
    }

    /// The fewest directions that leave room for errors of maps, `own` of them the relative ones of each thing asked for
    /// at some number of directions, and keep these below [`OWN_SHARE`] of what is allowed; else without the second, and
    /// else those that make theirs small beside them.
    pub(super) fn needed(&self, own: &dyn Fn(f64) -> Vec<f64>, question: &Question<'_>) -> f64 {
        let ladder = || {
            let rungs = (DIRECTIONS.1 / DIRECTIONS.0).log(RUNG).ceil();
            let directions = |rung: u32| DIRECTIONS.0 * RUNG.powf(f64::from(rung));
            (0..=round(rungs)).map(move |rung| directions(rung).min(DIRECTIONS.1))
        };
        let fits =
            |&directions: &f64| worst(&self.with(&own(directions), directions), question) <= 1.0;
        let is_told = |directions: &f64| worst(&own(*directions), question) <= OWN_SHARE;
        let is_small = |&directions: &f64| {
            let spread: Vec<f64> = self.at(directions).collect();
            worst(&spread, question) <= 0.5
        };
        (ladder().find(|n| fits(n) && is_told(n)))
            .or_else(|| ladder().find(fits))
            .or_else(|| ladder().find(is_small))
            .unwrap_or(DIRECTIONS.1)
    }
}
