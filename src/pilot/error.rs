//! Results and their truth → how wrong they are: one number to compare with a tolerance, and the statistics of a report.

use crate::results::{Aov, Results};

/// The AOV whose error stands for that of `aov`: occlusion is measured as visibility, and so are its harmonics and the
/// bent normal, which where next to nothing is open hangs on a single ray; the direction of the light as its strength;
/// harmonics of radiance as the irradiance.
pub fn measured_as(aov: Aov) -> Aov {
    match aov {
        Aov::Occlusion | Aov::BentNormal | Aov::VisibilitySh => Aov::Visibility,
        Aov::IlluminationDirection => Aov::IrradianceEnvironment,
        Aov::RadianceSh => Aov::IrradianceIndirect,
        other => other,
    }
}

/// Values of `aov`, all components (alpha left out) of one receiver after the other; `None` if it was not computed.
/// Visibility is read off occlusion where only that was computed; of occlusion of reflections it is what is open.
pub fn values(results: &Results, aov: Aov) -> Option<Vec<f64>> {
    if let Some(buffer) = results.get(aov).filter(|_| aov == Aov::ReflectionOcclusion) {
        return Some(buffer.data.iter().map(|&x| 1.0 - f64::from(x)).collect());
    }
    if let Some(buffer) = results.get(aov) {
        let colors = buffer.aov.components().min(3);
        return Some(
            buffer
                .data
                .chunks_exact(buffer.aov.components())
                .flat_map(|value| value[..colors].iter().map(|&x| f64::from(x)))
                .collect(),
        );
    }
    let occlusion = (aov == Aov::Visibility).then(|| results.get(Aov::Occlusion))??;
    Some(occlusion.data.iter().map(|&x| 1.0 - f64::from(x)).collect())
}

/// Root of the mean square of `a − b`; 0 without values.
pub fn rms_difference(a: &[f64], b: &[f64]) -> f64 {
    let square: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
    (square / a.len().max(1) as f64).sqrt()
}

/// What receivers count, whose values, all components of one after the other, are compared.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weighted<'a>(pub(super) &'a [f64]);

impl Weighted<'_> {
    /// [`rms_difference`] by weight.
    pub(super) fn rms_difference(self, a: &[f64], b: &[f64]) -> f64 {
        let squares = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
        self.mean(squares).sqrt()
    }

    /// [`mean_magnitude`] by weight.
    pub(super) fn mean_magnitude(self, values: &[f64]) -> f64 {
        self.mean(values.iter().map(|x| x.abs()))
    }

    /// Sum of each value times its receiver's weight, over how many there are; 0 without values.
    pub(super) fn mean(self, values: impl ExactSizeIterator<Item = f64>) -> f64 {
        let count = values.len();
        let components = (count / self.0.len().max(1)).max(1);
        let weighted = |(i, value): (usize, f64)| value * self.0[i / components];
        values.enumerate().map(weighted).sum::<f64>() / count.max(1) as f64
    }
}

/// Mean magnitude; 0 without values.
pub fn mean_magnitude(values: &[f64]) -> f64 {
    values.iter().map(|x| x.abs()).sum::<f64>() / values.len().max(1) as f64
}

/// `error` over `mean`; `error` itself where everything is black.
pub fn relative(error: f64, mean: f64) -> f64 {
    if mean > 0.0 { error / mean } else { error }
}

/// Converged values and how sure they are.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Values as [`values`] orders them.
    pub values: Vec<f64>,
    /// Root mean square of their standard errors.
    pub standard_error: f64,
    /// Mean magnitude.
    pub mean: f64,
}

impl Truth {
    /// The mean of two independent halves of equal effort; their difference tells its standard error.
    pub fn of_halves(a: &[f64], b: &[f64]) -> Self {
        let values: Vec<f64> = a.iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect();
        Self {
            standard_error: 0.5 * rms_difference(a, b),
            mean: mean_magnitude(&values),
            values,
        }
    }
}

/// Error of one AOV over a set of receivers; all relative.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ErrorStatistics {
    /// rms(x − truth) / mean |truth|, the truth's own error taken out.
    pub relative_rmse: f64,
    /// mean(x − truth) / mean |truth|.
    pub bias: f64,
    /// 99th percentile of [`local_error`].
    pub p99: f64,
    /// Largest [`local_error`].
    pub max: f64,
    /// Values that are NaN or infinite; they count in nothing else.
    pub non_finite: usize,
}

/// Truths smaller than this share of their mean count as that: next to zero, relative errors mean nothing.
const SMALLEST_TRUTH: f64 = 0.1;

/// |x − truth| / max(|truth|, a tenth of its mean).
pub fn local_error(x: f64, truth: f64, mean: f64) -> f64 {
    relative((x - truth).abs(), truth.abs().max(SMALLEST_TRUTH * mean))
}

/// Statistics of `run` against `truth`; all zero without values.
pub fn statistics(run: &[f64], truth: &Truth) -> ErrorStatistics {
    let (mut square, mut sum) = (0.0, 0.0);
    let mut local = Vec::with_capacity(run.len());
    for (&x, &t) in run.iter().zip(&truth.values) {
        if x.is_finite() {
            square += (x - t) * (x - t);
            sum += x - t;
            local.push(local_error(x, t, truth.mean));
        }
    }
    local.sort_by(f64::total_cmp);
    let count = local.len().max(1) as f64;
    let square = (square / count - truth.standard_error.powi(2)).max(0.0);
    ErrorStatistics {
        relative_rmse: relative(square.sqrt(), truth.mean),
        bias: relative(sum / count, truth.mean),
        p99: local
            .get(local.len() * 99 / 100)
            .or(local.last())
            .copied()
            .unwrap_or(0.0),
        max: local.last().copied().unwrap_or(0.0),
        non_finite: run.len() - local.len(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::AovBuffer;

    #[test]
    fn occlusion_is_read_as_visibility_and_alpha_is_no_color() {
        let buffer = |aov, data: Vec<f32>| AovBuffer { aov, data };
        let results = Results {
            buffers: vec![
                buffer(Aov::Occlusion, vec![0.25, 1.0]),
                buffer(Aov::Color, vec![1.0, 2.0, 3.0, 1.0]),
            ],
            ..Results::default()
        };
        assert_eq!(values(&results, Aov::Visibility).unwrap(), [0.75, 0.0]);
        assert_eq!(values(&results, Aov::Color).unwrap(), [1.0, 2.0, 3.0]);
        assert!(values(&results, Aov::Irradiance).is_none());
    }

    #[test]
    fn statistics_of_known_errors() {
        // Truth 1 with standard error 0: errors +0.1, −0.1, 0, 0 have rms 0.1/√2 and no bias.
        let truth = Truth::of_halves(&[1.0; 4], &[1.0; 4]);
        let found = statistics(&[1.1, 0.9, 1.0, 1.0], &truth);
        assert!((found.relative_rmse - 0.1 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert!(found.bias.abs() < 1e-12 && (found.max - 0.1).abs() < 1e-12);
        assert_eq!(found.non_finite, 0);
    }

    #[test]
    fn the_truths_own_error_is_taken_out_and_bad_values_are_counted_only() {
        // Halves 0.9 and 1.1: the mean's standard error is 0.1. A run that is 0.1 off is as good as the truth.
        let truth = Truth::of_halves(&[0.9, 1.1], &[1.1, 0.9]);
        assert!((truth.standard_error - 0.1).abs() < 1e-12);
        let found = statistics(&[1.1, f64::NAN], &truth);
        assert!(found.relative_rmse < 1e-6 && found.non_finite == 1);
        let none = statistics(&[], &Truth::of_halves(&[], &[]));
        assert_eq!((none.relative_rmse, none.max), (0.0, 0.0));
    }

    #[test]
    fn local_errors_next_to_zero_are_against_a_tenth_of_the_mean() {
        assert!((local_error(0.01, 0.0, 1.0) - 0.1).abs() < 1e-12);
        assert!((local_error(2.0, 1.0, 1.0) - 1.0).abs() < 1e-12);
        assert_eq!(local_error(0.0, 0.0, 0.0), 0.0);
    }
}
