//! What maps are asked, and what their answer means for the run.

use super::{AIM_OF_MAPS, Bench, Best, Judge, LAW, Ladder, Measured, round};
use crate::diagnostics::Cancelled;
use crate::pilot::error::{Weighted, values};
use crate::pilot::sky::{self, SkyBid};
use crate::pilot::{Maps, Pick};
use crate::results::Aov;

/// Directions of maps that are tried first where an image of the sky is all that is asked for.
const IMAGE_DIRECTIONS: f64 = 128.0;

impl Bench<'_, '_, '_> {
    /// Maps for the sky and rays for the rest, if that takes less than `best` seconds and those of an environment with
    /// an image (or has to be). `by_rays`: where some AOV depends on the engine.
    pub(super) fn try_maps(
        &mut self,
        by_rays: Option<(&Ladder, &Judge)>,
        best: f64,
    ) -> Result<Option<Best>, Cancelled> {
        let image_seconds = self.image.as_ref().map_or(0.0, |image| image.seconds);
        let limit = best + self.run_seconds(image_seconds);
        let (plan, max_distance, limit) = match self.pilot.maps {
            Maps::Never => return Ok(None),
            Maps::IfCheaper(plan, max_distance) => (plan, max_distance, limit),
            Maps::Always(plan, max_distance) => (plan, max_distance, f64::INFINITY),
        };
        let need = |is_sky: bool| {
            let aovs = self.aovs.iter().zip(&by_rays?.0.needed);
            let asked = aovs.filter(|(one, _)| one.is_sky == is_sky);
            asked.map(|(_, &rays)| rays).reduce(f64::max)
        };
        let (sky_rays, others) = (need(true), need(false));
        if sky_rays.is_none() && self.image.is_none() {
            return Ok(None);
        }
        // A ray costs the same for the sky and for light, about.
        let a_ray = |seconds: fn(&Judge) -> f64| {
            by_rays.map_or(0.0, |(_, judge)| seconds(judge) / judge.rays)
        };
        let ray = a_ray(|judge| judge.seconds_per_receiver);
        let others_seconds = others.map_or(0.0, |others| self.rays_seconds(ray * others));
        // Rays for light that are enough for the sky too tell it for nothing.
        let is_free = others.is_some_and(|others| others >= sky_rays.unwrap_or(0.0));
        if limit.is_finite() && (others_seconds >= limit || (is_free && self.image.is_none())) {
            return Ok(None);
        }
        let mut trials = std::mem::take(&mut self.trials);
        // Those handed over have no neighbors.
        let lone_ray = a_ray(|judge| judge.lone_seconds);
        let handed_over_seconds = lone_ray * sky_rays.unwrap_or(0.0) + image_seconds;
        let question = self.sky(by_rays.map(|(_, judge)| judge), handed_over_seconds);
        let start = sky::Start {
            plan,
            max_distance,
            directions: sky_rays.unwrap_or(IMAGE_DIRECTIONS),
            limit: limit - others_seconds,
        };
        let bid = sky::search(&question, &start, &mut trials, self.diagnostics)?;
        self.trials = trials;
        let judge = by_rays.map(|(_, judge)| judge);
        Ok(bid.map(|bid| self.with_maps(bid, (sky_rays, others), judge)))
    }

    /// What maps are asked at the pilot's receivers: visibility first, if it is.
    fn sky(&self, judge: Option<&Judge>, handed_over_seconds: f64) -> sky::Question<'_> {
        let open = judge.and_then(|judge| self.open(judge));
        let image = self.image.as_ref();
        sky::Question {
            scene: self.pilot.scenes.run,
            few: &self.few,
            weighted: Weighted(&self.sample.weights),
            total: self.pilot.receivers.len(),
            asked: open
                .into_iter()
                .chain(image.map(|image| image.asked.clone()))
                .collect(),
            handed_over_seconds,
            image_seconds: image.map_or(0.0, |image| {
                image.set_up_seconds + self.run_seconds(image.bright_seconds)
            }),
        }
    }

    /// Visibility, if something hangs on it.
    fn open(&self, judge: &Judge) -> Option<sky::Asked> {
        let aovs = self.aovs.iter().zip(&judge.errors);
        let (first, error) = aovs.into_iter().find(|(one, _)| one.is_sky)?;
        let truth = values(&judge.reference, first.aov).unwrap_or_default();
        // Irradiance of a uniform sky is visibility, but for a factor that relative errors do not see.
        let components = (truth.len() / self.few.len().max(1)).max(1);
        let full = if first.aov == Aov::Visibility {
            1.0
        } else {
            self.full_sky()
        };
        let visibility = |value: &[f64]| value.iter().sum::<f64>() / full;
        let truth: Vec<f64> = truth.chunks(components).map(visibility).collect();
        Some(sky::Asked {
            is_image: false,
            mean: Weighted(&self.sample.weights).mean_magnitude(&truth),
            truth,
            truth_error: judge.share.sqrt() * error,
            allowed: AIM_OF_MAPS * first.allowed,
        })
    }

    /// Sum over the channels of the irradiance of an open receiver.
    fn full_sky(&self) -> f64 {
        let sky = self
            .scene
            .lighting
            .and_then(|light| light.uniform_environment());
        let radiance = sky.map_or(0.0, |sky| f64::from(sky.element_sum()));
        std::f64::consts::PI * radiance.max(f64::MIN_POSITIVE)
    }

    fn with_maps(
        &self,
        mut bid: SkyBid,
        (sky_rays, others): (Option<f64>, Option<f64>),
        judge: Option<&Judge>,
    ) -> Best {
        let image = self.image.as_ref().and_then(|_| bid.errors.pop());
        let errors = judge.iter().flat_map(|judge| {
            let rays = others.unwrap_or(judge.rays) / judge.rays;
            let of = |(one, error): (&Measured, &f64)| match bid.errors.first() {
                Some(&sky) if one.is_sky => sky,
                _ => error * rays.powf(-LAW),
            };
            let aovs = self.aovs.iter().zip(&judge.errors);
            aovs.map(of).collect::<Vec<_>>()
        });
        Best {
            pick: Pick::Maps {
                settings: bid.settings,
                handed_over: round(sky_rays.unwrap_or(0.0)),
                others: others.map(round),
            },
            seconds: bid.seconds,
            errors: errors.collect(),
            image,
        }
    }
}
