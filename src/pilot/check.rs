//! Results of the whole run → their error, by the pilot's reference at its few receivers.

use super::error::{Weighted, relative, values};
use super::sample::Sample;
use crate::gather::{ErrorEstimate, Thinning};
use crate::results::{Aov, Results};

/// What the pilot knows about the truth at its receivers.
#[derive(Debug, Clone)]
pub struct Check {
    /// Receivers of the run.
    pub(super) sample: Sample,
    /// See [`Thinning::evened`], of each; empty: 1.
    pub(super) evened: Vec<f64>,
    pub(super) aovs: Vec<Known>,
    /// Values of `aovs` there, almost converged.
    pub(super) truth: Results,
}

/// One AOV of a [`Check`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    pub(super) aov: Aov,
    /// Mean magnitude; 0: that of the truth.
    pub(super) mean: f64,
    /// Relative error that truth and run have in common: of direct light's own samples and of the surfels.
    pub(super) fixed: f64,
    /// Relative error of the truth.
    pub(super) reference: f64,
}

impl Check {
    /// For results that rays saw as `thinning` says, if anything.
    #[must_use]
    pub fn thinned(mut self, thinning: Option<&Thinning>) -> Self {
        let of = |thinning: &Thinning| {
            let picks = self.sample.picks.iter();
            picks.map(|&i| thinning.evened(i)).collect()
        };
        self.evened = thinning.map(of).unwrap_or_default();
        self
    }

    /// Error of `results`, one estimate an AOV of theirs that the pilot measured. Costs next to nothing: the values are
    /// there.
    pub fn errors(&self, results: &Results) -> Vec<ErrorEstimate> {
        self.errors_at_picks(&results.subset(&self.sample.picks))
    }

    /// The receivers of the run that it looks at.
    pub fn picks(&self) -> &[usize] {
        &self.sample.picks
    }

    /// The same of results at [`picks`](Self::picks) alone.
    pub fn errors_at_picks(&self, few: &Results) -> Vec<ErrorEstimate> {
        let weighted = Weighted(&self.sample.weights);
        let squares: Vec<f64> = match self.evened.is_empty() {
            true => self.sample.weights.clone(),
            false => (self.sample.weights.iter().zip(&self.evened))
                .map(|(weight, evened)| weight * evened)
                .collect(),
        };
        let of_all = |weights: &[f64]| weights.iter().sum::<f64>();
        // The truth's own error counts as the run's does.
        let truths = of_all(&squares) / of_all(&self.sample.weights).max(f64::MIN_POSITIVE);
        let estimate = |known: &Known| {
            let run = values(few, known.aov)?;
            let truth = values(&self.truth, known.aov)?;
            let mean = if known.mean > 0.0 {
                known.mean
            } else {
                weighted.mean_magnitude(&truth)
            };
            let both = relative(Weighted(&squares).rms_difference(&run, &truth), mean);
            let engine = (both * both - truths * known.reference * known.reference).max(0.0);
            Some(ErrorEstimate {
                aov: known.aov,
                relative_rmse: engine.sqrt().hypot(known.fixed),
                receivers: self.sample.picks.len(),
            })
        };
        self.aovs.iter().filter_map(estimate).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::testing::pixels_of;
    use crate::results::AovBuffer;

    fn one(aov: Aov, data: &[f32]) -> Results {
        Results {
            buffers: vec![AovBuffer {
                aov,
                data: data.to_vec(),
            }],
            ..Results::default()
        }
    }

    #[test]
    fn errors_are_those_at_the_pilots_receivers_without_the_truths_own() {
        let known = Known {
            aov: Aov::Visibility,
            mean: 0.5,
            fixed: 0.0,
            reference: 0.06,
        };
        let mut check = Check {
            sample: Sample {
                picks: vec![0, 2],
                weights: vec![1.0; 2],
            },
            evened: Vec::new(),
            aovs: vec![known],
            truth: one(Aov::Visibility, &[0.5, 0.5]),
        };
        // Off by 0.05 twice: 10 % of the mean; √(0.1² − 0.06²) = 8 % is the run's own.
        let results = one(Aov::Occlusion, &[0.55, 9.0, 0.45]);
        let found = check.errors(&results)[0];
        assert!((found.relative_rmse - 0.08).abs() < 1e-6 && found.receivers == 2);
        // What no engine changes comes on top: 6 % and 8 % make 10 %.
        check.aovs[0].fixed = 0.06;
        assert!((check.errors(&results)[0].relative_rmse - 0.1).abs() < 1e-6);
        assert!(check.errors(&Results::default()).is_empty());
        // One that stands for three times as many, and is right: the other's tenth is that of a quarter.
        check.aovs[0].fixed = 0.0;
        check.aovs[0].reference = 0.0;
        check.sample.weights = vec![1.5, 0.5];
        let results = one(Aov::Occlusion, &[0.5, 9.0, 0.45]);
        let found = check.errors(&results)[0].relative_rmse;
        assert!((found - 0.1 * 0.25_f64.sqrt()).abs() < 1e-6, "{found}");
    }
    /// Four receivers in one pixel, and one in another; picked: the one, and one of four.
    #[test]
    fn receivers_of_one_pixel_even_out_what_few_rays_err_by() {
        let thinning = Thinning::of(&pixels_of(&[1, 4]), 5, 0.75);
        let check = Check {
            sample: Sample {
                picks: vec![0, 3],
                weights: vec![1.0; 2],
            },
            evened: Vec::new(),
            aovs: vec![Known {
                aov: Aov::Visibility,
                mean: 0.5,
                fixed: 0.0,
                reference: 0.0,
            }],
            truth: one(Aov::Visibility, &[0.5, 0.5]),
        };
        let results = one(Aov::Visibility, &[0.55, 9.0, 9.0, 0.6, 9.0]);
        let told = |check: &Check| check.errors(&results)[0].relative_rmse;
        // Off by 0.1 and 0.2 of the mean; four independent ones of 0.2 are off by 0.1 together.
        assert!((told(&check) - 0.025_f64.sqrt()).abs() < 1e-6);
        let thinned = check.thinned(thinning.as_ref());
        assert!((told(&thinned) - 0.1).abs() < 1e-6, "{}", told(&thinned));
    }
}
