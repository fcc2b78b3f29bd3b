//! Light of an environment with an image: what its own samples by rays cost, against which maps may be cheaper.

use super::choose::AIM_OF_MAPS;
use super::clock::Clock;
use super::crowd::crowd;
use super::error::values;
use super::light::LightError;
use super::sky::Asked;
use super::{Maps, Method, Pilot, check};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::maps::{self, MapsSettings, MapsSky};
use crate::results::{Aov, AovBuffer};

/// Maps are not tried for an image whose samples cost less than so many divisions of the sky: the pilot makes up to five.
const WORTH: f64 = 20.0;

/// What the pilot knows about it.
#[derive(Debug)]
pub(super) struct Image {
    /// Its irradiance at the pilot's receivers.
    pub(super) asked: Asked,
    /// Processor seconds a receiver: of the samples of all the sky, and of those of its bright areas.
    pub(super) seconds: f64,
    pub(super) bright_seconds: f64,
    /// Processor seconds to divide the sky for maps.
    pub(super) set_up_seconds: f64,
    truth: AovBuffer,
}

impl Image {
    /// `None` if nobody asks for it, its truth is not known, or it is alone and too cheap to think about.
    pub(super) fn measure(
        pilot: &Pilot<'_, '_>,
        engine: &dyn Method,
        light: &LightError,
        diagnostics: &Diagnostics,
    ) -> Result<Option<Self>, Cancelled> {
        let scene = pilot.scenes.run;
        let asks = |&aov: &Aov| maps::needs_sky(aov, scene.lighting);
        let place = pilot.aovs.iter().position(asks);
        let (Some(i), Some((finer, errors))) = (place, &light.finer) else {
            return Ok(None);
        };
        let aov = Aov::IrradianceEnvironment;
        let Some(truth) = finer.get(aov).cloned() else {
            return Ok(None);
        };
        let neighbors = crowd(pilot.receivers);
        let each = f64::from(light.scale) / neighbors.len().max(1) as f64;
        let clock = Clock::start();
        engine.gather(scene, &neighbors, &[aov], diagnostics)?;
        let seconds = each * clock.seconds();
        let clock = Clock::start();
        let sky = (scene.lighting).map(|light| MapsSky::new(light, &MapsSettings::default()));
        let set_up_seconds = clock.seconds();
        // Beside visibility maps may be taken in any case: then what they make of the image has to be known.
        let is_alone = !pilot.aovs.iter().any(|aov| aov.is_openness());
        let is_cheap = seconds * (pilot.receivers.len() as f64) < WORTH * set_up_seconds;
        if is_alone && is_cheap && matches!(pilot.maps, Maps::IfCheaper(..)) {
            return Ok(None);
        }
        let clock = Clock::start();
        if let Some(sky) = sky {
            let place = (scene.shader.scene(), scene.tracer);
            sky.bright_light(place, &neighbors, diagnostics)?;
        }
        Ok(Some(Self {
            asked: Asked {
                is_image: true,
                truth: values(finer, aov).unwrap_or_default(),
                mean: light.means[i],
                truth_error: errors[i],
                allowed: AIM_OF_MAPS * pilot.tolerance,
            },
            seconds,
            bright_seconds: each * clock.seconds(),
            set_up_seconds,
            truth,
        }))
    }

    /// What judges the run, if maps look at it.
    pub(super) fn known(&self) -> (check::Known, AovBuffer) {
        let known = check::Known {
            aov: self.truth.aov,
            mean: self.asked.mean,
            fixed: 0.0,
            reference: self.asked.truth_error,
        };
        (known, self.truth.clone())
    }
}
