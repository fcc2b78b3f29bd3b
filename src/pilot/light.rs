//! How wrong direct light is at its own sample counts, which no engine changes, and how many samples a tolerance needs.

use super::error::{Weighted, measured_as, relative, values};
use super::{Method, Pilot};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::{GatherScene, RaysSettings};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};

/// The scene as the pilot looks at it.
#[derive(Debug, Clone, Copy)]
pub struct LightScenes<'a> {
    /// With the lights of the run.
    pub run: GatherScene<'a>,
    /// With four times their samples; `None`: the light's own error is not looked at.
    pub finer: Option<GatherScene<'a>>,
}

/// Most times the usual samples.
const MOST_SCALE: u32 = 16;

/// Share of the tolerance that light may use up; the engine has √(1 − its square), 87 %. Where nothing hangs on that, light has
/// all that may be aimed at.
const LIGHT_SHARE: f64 = 0.5;
const SHARE_ALONE: f64 = super::choose::AIM;

/// Error of direct light.
#[derive(Debug, Clone)]
pub(super) struct LightError {
    /// Times the run's samples that it needs.
    pub(super) scale: u32,
    /// What is left of it then: relative RMSE of each AOV, in order.
    pub(super) relative: Vec<f64>,
    /// Mean magnitude of each AOV.
    pub(super) means: Vec<f64>,
    /// What surfaces reflect diffusely in `color`, if that is among them.
    pub(super) reflected: Option<Reflected>,
    /// The light with four times the samples, if it was looked at, and the relative error of each AOV there.
    pub(super) finer: Option<(Results, Vec<f64>)>,
}

/// A part of the color.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reflected {
    /// Mean magnitude.
    pub(super) mean: f64,
    /// How much of the color it is at single receivers: root of the mean square, 0…1.
    pub(super) share: f64,
}

impl Reflected {
    /// That of `values` in the `colors` of the same receivers.
    fn of(values: &[f64], colors: &[f64], weighted: Weighted<'_>) -> Self {
        let share = |(&part, &whole): (&f64, &f64)| {
            if whole > 0.0 {
                (part / whole).clamp(0.0, 1.0)
            } else {
                0.0
            }
        };
        let squares = (values.iter().zip(colors)).map(|it| share(it).powi(2));
        Self {
            mean: weighted.mean_magnitude(values),
            share: weighted.mean(squares).sqrt(),
        }
    }
}

impl<'a> LightScenes<'a> {
    /// Without the lights, where these are no business of the engine: it then has less to compute.
    pub(super) fn engine(&self) -> GatherScene<'a> {
        let uniform = self
            .run
            .lighting
            .is_some_and(|light| light.has_environment() && light.uniform_environment().is_some());
        GatherScene {
            lighting: self.run.lighting.filter(|_| uniform),
            ..self.run
        }
    }

    /// True if a better look at the hemisphere can change `aov`.
    pub(super) fn depends_on_engine(&self, aov: Aov) -> bool {
        aov.is_openness()
            || aov == Aov::ReflectionOcclusion
            || aov.needs_indirect()
            || (aov.needs_environment() && self.engine().lighting.is_some())
    }
}

/// True if `aov` holds light that is sampled on its own.
fn is_lit(aov: Aov) -> bool {
    aov.needs_direct() || aov.needs_environment()
}

/// Measure direct light at `receivers`, which count as much as `weighted` says.
pub(super) fn measure(
    pilot: &Pilot<'_, '_>,
    engine: &dyn Method,
    (receivers, weighted): (&Receivers, Weighted<'_>),
    diagnostics: &Diagnostics,
) -> Result<LightError, Cancelled> {
    let aovs = pilot.aovs;
    let mut looked_at = aovs.to_vec();
    let measured = aovs.iter().map(|&aov| measured_as(aov));
    looked_at.extend(measured.filter(|aov| aov.needs_environment() && !aovs.contains(aov)));
    let color = aovs.iter().position(|&aov| aov == Aov::Color);
    if color.is_some() && !looked_at.contains(&Aov::DiffuseIndirect) {
        looked_at.push(Aov::DiffuseIndirect);
    }
    let look = |scene: GatherScene<'_>| -> Result<Results, Cancelled> {
        engine.gather(scene, receivers, &looked_at, diagnostics)
    };
    let run = look(pilot.scenes.run)?;
    let columns: Vec<Vec<f64>> = aovs
        .iter()
        .map(|&aov| values(&run, measured_as(aov)).unwrap_or_default())
        .collect();
    let means: Vec<f64> = columns
        .iter()
        .map(|column| weighted.mean_magnitude(column))
        .collect();
    let reflected = color.and_then(|color| {
        let reflected = values(&run, Aov::DiffuseIndirect)?;
        Some(Reflected::of(&reflected, &columns[color], weighted))
    });
    let mut errors = vec![0.0; aovs.len()];
    let lit = aovs.iter().any(|&aov| is_lit(aov));
    let finer = pilot.scenes.finer.filter(|_| lit).map(look).transpose()?;
    if let Some(finer) = &finer {
        for (i, &aov) in aovs.iter().enumerate() {
            if let Some(better) = values(finer, measured_as(aov)) {
                let both = weighted.rms_difference(&columns[i], &better);
                let own = both / (1.0 + RaysSettings::REFERENCE_ERROR_SHARE).sqrt();
                errors[i] = relative(own, means[i]);
            }
        }
    }
    let worst = errors.iter().copied().fold(0.0, f64::max);
    let is_alone = !aovs.iter().any(|&aov| pilot.scenes.depends_on_engine(aov));
    let share = if is_alone { SHARE_ALONE } else { LIGHT_SHARE };
    let scale = scale(worst / (share * pilot.tolerance));
    let reference = RaysSettings::REFERENCE_ERROR_SHARE.sqrt();
    let finer = finer.map(|finer| (finer, errors.iter().map(|own| reference * own).collect()));
    let left = f64::from(scale).powf(-super::choose::LAW);
    errors.iter_mut().for_each(|error| *error *= left);
    Ok(LightError {
        scale,
        relative: errors,
        means,
        reflected,
        finer,
    })
}

/// Times the samples that bring an error `excess` times too large down to 1.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to 1…16"
)]
fn scale(excess: f64) -> u32 {
    excess
        .powf(1.0 / super::choose::LAW)
        .ceil()
        .clamp(1.0, f64::from(MOST_SCALE)) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_the_color_is_told_by_its_mean_and_its_share_at_single_receivers() {
        // All of one color, a tenth of a bright one, and nothing in the dark.
        let found = Reflected::of(&[0.2, 0.4, 0.0], &[0.2, 4.0, 0.0], Weighted(&[1.0; 3]));
        assert!((found.mean - 0.2).abs() < 1e-12);
        assert!((found.share - (1.01_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!(Reflected::of(&[], &[], Weighted(&[])).share, 0.0);
    }

    #[test]
    fn samples_grow_with_the_error_to_the_power_of_four_thirds() {
        assert_eq!(scale(0.0), 1);
        assert_eq!(scale(1.0), 1);
        assert_eq!(scale(2.0), 3);
        assert_eq!(scale(1e9), MOST_SCALE);
    }
}
