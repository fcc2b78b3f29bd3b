//! Results → how wrong they probably are: a few receivers are gathered again with a better engine.
//!
//! The engine's own share is measured: what covers and lights the hemisphere. Errors that the run and its reference
//! have in common (direct light's own samples, the surfels' spacing) are not.

use super::{Engine, GatherScene, Thinning, gather};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::math::sequence;
use crate::receivers::Receivers;
use crate::results::{Aov, Results};

/// Error of one AOV over the receivers of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorEstimate {
    /// Which AOV; [`Aov::Visibility`] stands for occlusion too, which is measured as visibility.
    pub aov: Aov,
    /// rms(error) / mean |value|; 0 where all values are zero in both.
    pub relative_rmse: f64,
    /// Receivers it was measured at.
    pub receivers: usize,
}

/// The better engine.
#[derive(Debug, Clone, Copy)]
pub struct Reference<'a> {
    /// It.
    pub engine: &'a dyn Engine,
    /// Its cost a receiver over that of the run's engine.
    pub cost: u32,
    /// Its expected squared error over that of the run's engine, 0…1; 0 = without error, which makes the estimate
    /// an upper bound. [`super::RaysSettings::REFERENCE_ERROR_SHARE`] for rays judging rays.
    pub error_share: f64,
    /// How rays of the run saw where pixels have many receivers.
    pub thinning: Option<&'a Thinning>,
}

/// Most receivers to measure at: their mean square is then known to within about 10 %.
const MOST: usize = 256;

/// With fewer receivers than this an estimate would be mere chance: none is made.
const FEWEST: usize = 16;

/// The estimate may cost this fraction of the run.
const SHARE_OF_RUN: usize = 10;

/// Estimate the error of `results` for each AOV whose value depends on the hemisphere, in order; empty when the run is
/// too small for a tenth of its cost to buy an estimate.
///
/// Method: receivers spread over the run (at most 256) are gathered again by the reference. Run and reference err
/// independently, so the expected square of their difference is the sum of both squares, and the run's part of it is
/// 1/(1 + error share).
///
/// # Errors
/// When cancelled.
pub fn estimate(
    scene: GatherScene<'_>,
    reference: Reference<'_>,
    receivers: &Receivers,
    results: &Results,
    diagnostics: &Diagnostics,
) -> Result<Vec<ErrorEstimate>, Cancelled> {
    let picked = pick(receivers.len(), reference.cost);
    let uniform = scene
        .lighting
        .is_some_and(|light| light.has_environment() && light.uniform_environment().is_some());
    let aovs = measured(results, uniform);
    if picked.is_empty() || aovs.is_empty() {
        return Ok(Vec::new());
    }
    let few = receivers.subset(&picked);
    let truth = gather(scene, reference.engine, &few, &aovs, diagnostics)?;
    Ok(compare(results, (&truth, &picked), reference))
}

/// AOVs of `results` that a better look at the hemisphere can change. Not directions: where next to nothing is
/// open a single ray decides its direction, so that its error says nothing that the visibility's does not say better.
/// Nor harmonics, whose coefficients have no mean to compare with.
/// Nor direct light, nor an environment unless it is `uniform`: they have samples of their own.
fn measured(results: &Results, uniform: bool) -> Vec<Aov> {
    let depends = |&aov: &Aov| {
        if aov.error_of().is_some() || aov == Aov::RadianceSh {
            return false;
        }
        let open = [Aov::Occlusion, Aov::Visibility, Aov::ReflectionOcclusion];
        open.contains(&aov)
            || aov.needs_indirect()
            || (uniform && aov.needs_environment() && aov != Aov::IlluminationDirection)
    };
    results
        .buffers
        .iter()
        .map(|buffer| buffer.aov)
        .filter(depends)
        .collect()
}

/// Indices of receivers spread over all `count`, as many as the budget allows; empty below [`FEWEST`].
fn pick(count: usize, cost: u32) -> Vec<usize> {
    let affordable = count / (SHARE_OF_RUN * (cost.max(1) as usize));
    let picks = affordable.min(MOST);
    if picks < FEWEST {
        return Vec::new();
    }
    spread(count, picks)
}

/// `picks` ascending indices (all, if there are no more) below `count`. One from each of equal runs, at golden-ratio
/// places: equal steps would fall into step with the rows of a grid.
pub fn spread(count: usize, picks: usize) -> Vec<usize> {
    if picks >= count {
        return (0..count).collect();
    }
    let run = count / picks.max(1);
    (0..picks)
        .zip(0..)
        .map(|(k, point)| {
            let place = sequence::fibonacci(point, 1).y;
            k * count / picks + at_fraction(place, run)
        })
        .collect()
}

/// The index at `fraction` (0…1) of `count`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "rounded down on purpose, at least 0, below count"
)]
fn at_fraction(fraction: f32, count: usize) -> usize {
    ((f64::from(fraction) * count as f64) as usize).min(count.saturating_sub(1))
}

fn compare(
    results: &Results,
    (truth, picked): (&Results, &[usize]),
    reference: Reference<'_>,
) -> Vec<ErrorEstimate> {
    let weights = |&i: &usize| {
        (reference.thinning).map_or((1.0, 1.0), |thinning| {
            let part = f64::from(thinning.part(i));
            (part, part * thinning.evened(i))
        })
    };
    let weights: Vec<(f64, f64)> = picked.iter().map(weights).collect();
    truth
        .buffers
        .iter()
        .filter_map(|buffer| {
            let run = results.get(buffer.aov)?;
            let n = buffer.aov.components();
            let pairs = picked.iter().enumerate().flat_map(|(k, &i)| {
                (0..n).map(move |c| (run.data[i * n + c], buffer.data[k * n + c]))
            });
            let (aov, flip) = match buffer.aov {
                Aov::Occlusion => (Aov::Visibility, true),
                Aov::ReflectionOcclusion => (buffer.aov, true),
                other => (other, false),
            };
            let as_measured = |x: f32| f64::from(if flip { 1.0 - x } else { x });
            let pairs = pairs.map(|(run, truth)| (as_measured(run), as_measured(truth)));
            let weights = weights
                .iter()
                .flat_map(|&weights| (0..n).map(move |_| weights));
            let error = relative_rmse(pairs.zip(weights));
            Some(ErrorEstimate {
                aov,
                relative_rmse: error / (1.0 + reference.error_share).sqrt(),
                receivers: picked.len(),
            })
        })
        .collect()
}

/// rms(a − b) / mean |b| over pairs (a, b), each with what it counts, and what its square does; the rms itself where b is zero
/// throughout.
fn relative_rmse(pairs: impl Iterator<Item = ((f64, f64), (f64, f64))>) -> f64 {
    let (mut square, mut size, mut count) = (0.0, 0.0, 0.0);
    for ((a, b), (weight, of_square)) in pairs {
        square += of_square * (a - b) * (a - b);
        size += weight * b.abs();
        count += weight;
    }
    if count == 0.0 {
        return 0.0;
    }
    let (rms, mean) = ((square / count).sqrt(), size / count);
    if mean > 0.0 { rms / mean } else { rms }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::KnownEngine;
    use crate::gather::testing::pixels_of;
    use crate::results::AovBuffer;

    /// A reference that is right but for this share, and sees nothing.
    fn by(error_share: f64) -> Reference<'static> {
        const NOTHING: KnownEngine<'_> = KnownEngine {
            occlusion: None,
            indirect: None,
            max_distance: f32::INFINITY,
            name: "nothing",
        };
        Reference {
            engine: &NOTHING,
            cost: 1,
            error_share,
            thinning: None,
        }
    }

    fn one(aov: Aov, data: Vec<f32>) -> Results {
        Results {
            buffers: vec![AovBuffer { aov, data }],
            ..Results::default()
        }
    }

    #[test]
    fn occlusion_is_measured_as_visibility() {
        let results = one(Aov::Occlusion, vec![0.9, 0.0, 0.9, 0.0]);
        let truth = one(Aov::Occlusion, vec![0.8, 0.8]);
        let [estimate] = compare(&results, (&truth, &[0, 2]), by(0.0))[..] else {
            panic!("one AOV, one estimate");
        };
        assert_eq!(estimate.aov, Aov::Visibility);
        assert!((estimate.relative_rmse - 0.5).abs() < 1e-6);
    }

    /// One receiver of each of two pixels of four.
    #[test]
    fn receivers_of_one_pixel_even_out_what_few_rays_err_by() {
        let thinning = Thinning::of(&pixels_of(&[4, 4]), 8, 0.75);
        let results = one(
            Aov::Visibility,
            vec![0.7, 0.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0],
        );
        let truth = one(Aov::Visibility, vec![0.5, 0.5]);
        let thinned = Reference {
            thinning: thinning.as_ref(),
            ..by(0.0)
        };
        let told = |reference| compare(&results, (&truth, &[0, 5]), reference)[0].relative_rmse;
        let (each, pixels) = (told(by(0.0)), told(thinned));
        assert!(
            (each - 0.4).abs() < 1e-6 && (pixels - 0.2).abs() < 1e-6,
            "{each} {pixels}"
        );
    }

    #[test]
    fn the_reference_error_is_taken_out_of_the_difference() {
        let results = one(Aov::IrradianceIndirect, vec![3.0, 3.0, 3.0]);
        let truth = one(Aov::IrradianceIndirect, vec![2.0, 2.0, 2.0]);
        let estimate = compare(&results, (&truth, &[0]), by(0.125))[0];
        assert!((estimate.relative_rmse - 0.5 / 1.125_f64.sqrt()).abs() < 1e-9);
        let black = one(Aov::IrradianceIndirect, vec![0.0; 3]);
        assert_eq!(
            compare(&black, (&black, &[0]), by(0.0))[0].relative_rmse,
            0.0
        );
    }

    #[test]
    fn picks_are_spread_affordable_and_none_for_tiny_runs() {
        assert!(pick(0, 4).is_empty() && pick(639, 4).is_empty());
        assert_eq!(pick(640, 4).len(), 16);
        let many = pick(1_000_000, 4);
        assert_eq!(many.len(), 256);
        assert!(many[0] < 4000 && many[255] > 996_000 && many[255] < 1_000_000);
        assert!(many.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
