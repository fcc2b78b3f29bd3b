//! Results and better ones → errors, and what the tolerance makes of them.

use super::{Bench, Judge, Measured};
use crate::pilot::error::{Weighted, relative, values};
use crate::results::Results;

impl Bench<'_, '_, '_> {
    /// Relative error of `run` for each AOV, when `truth`'s squared error is `share` times its own; both of receivers that count as
    /// `weighted` says.
    pub(super) fn errors(
        &self,
        (run, truth): (&Results, &Results),
        share: f64,
        weighted: Weighted<'_>,
    ) -> Vec<f64> {
        let of = |one: &Measured| {
            let run = values(run, one.aov).unwrap_or_default();
            let truth = values(truth, one.aov).unwrap_or_default();
            // The means of an engine that sees little light are that of all light: what is asked for.
            let mean = if one.mean > 0.0 {
                one.mean
            } else {
                weighted.mean_magnitude(&truth)
            };
            relative(weighted.rms_difference(&run, &truth), mean) / (1.0 + share).sqrt()
        };
        self.aovs.iter().map(of).collect()
    }

    /// Each of `errors` over what is allowed of rays.
    pub(super) fn ratios(&self, errors: &[f64]) -> Vec<f64> {
        let aovs = errors.iter().zip(&self.aovs);
        aovs.map(|(error, one)| error / (one.evened * one.allowed))
            .collect()
    }

    /// The worst of [`Self::ratios`].
    pub(super) fn ratio(&self, errors: &[f64]) -> f64 {
        self.ratios(errors).into_iter().fold(0.0, f64::max)
    }

    /// The worst of `errors` over what is allowed of an engine whose errors no neighbor evens out.
    pub(super) fn ratio_alone(&self, errors: &[f64]) -> f64 {
        let aovs = errors.iter().zip(&self.aovs);
        aovs.map(|(error, one)| error / one.allowed)
            .fold(0.0, f64::max)
    }

    /// Errors of `run` against the `reference` of a judge, whose own (known from that of the chosen rays) is subtracted.
    pub(super) fn without_reference(
        &self,
        run_and_reference: (&Results, &Results),
        judge: &Judge,
        weighted: Weighted<'_>,
    ) -> Vec<f64> {
        self.errors(run_and_reference, 0.0, weighted)
            .iter()
            .zip(&judge.errors)
            .map(|(both, rays)| (both * both - judge.share * rays * rays).max(0.0).sqrt())
            .collect()
    }
}
