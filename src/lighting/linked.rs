//! Lights with the prims that they are linked to: those they light, and those that block them.

use super::beacons::Beacons;
use super::lights::{AreaLight, Patterns};
use super::stand::Stand;
use crate::diagnostics::Diagnostics;
use crate::math::sequence;
use crate::scene::{Light, Linked, Scene};
use crate::trace::{Opacity, Tracer};
use glam::Vec3;
use std::sync::Arc;

/// All lights of a scene but domes and emissive surfaces.
#[derive(Debug)]
pub(super) struct LinkedLights {
    lights: Vec<LinkedLight>,
    beacons: Beacons,
    /// For lights that only some prims block, one for each such set.
    tracers: Vec<Tracer>,
}

/// Lights that are looked at one by one, if there are no more, from places that few rays light.
const FEW: usize = 4;

/// The same from surfels.
const FEW_OF_SURFELS: usize = 16;

/// Looks from a surfel at the lights that each give it little.
const LOOKS: f32 = 16.0;

/// Shares of all light at a surfel, about, between which a light passes from those that are looked at by chance to those that
/// are looked at one by one.
const LITTLE: (f32, f32) = (1.0 / 32.0, 1.0 / 16.0);

/// Lights, of those that there are, that such a place weighs against each other.
const MOST_WEIGHED: usize = 128;

#[derive(Debug)]
struct LinkedLight {
    light: AreaLight,
    lit: Linked,
    /// Index into `tracers`; `None` = everything blocks it.
    blockers: Option<usize>,
}

impl LinkedLights {
    /// The lights `all` of `scene`, whose surfaces stop as much as `opacity` says. A hierarchy is built for each set of prims that alone blocks some light.
    pub(super) fn new<'a>(
        (scene, opacity): (&Scene, Option<Arc<dyn Opacity>>),
        all: impl Iterator<Item = &'a Light>,
        diagnostics: &Diagnostics,
    ) -> Self {
        let (mut sets, mut tracers): (Vec<&Linked>, _) = (Vec::new(), Vec::new());
        let mut lights = Vec::new();
        for light in all {
            let Some(area) = AreaLight::new(light, diagnostics) else {
                continue;
            };
            let blockers = (light.blockers != Linked::All).then(|| {
                let known = sets.iter().position(|set| **set == light.blockers);
                known.unwrap_or_else(|| {
                    sets.push(&light.blockers);
                    tracers.push(Tracer::among(scene, opacity.clone(), |prim| {
                        light.blockers.contains(prim)
                    }));
                    tracers.len() - 1
                })
            });
            lights.push(LinkedLight {
                light: area,
                lit: light.lit.clone(),
                blockers,
            });
        }
        Self {
            beacons: Beacons::new(lights.iter().map(|linked| linked.light.beacon())),
            lights,
            tracers,
        }
    }

    pub(super) fn count(&self) -> usize {
        self.lights.len()
    }

    pub(super) fn all(&self) -> impl Iterator<Item = &AreaLight> {
        self.lights.iter().map(|linked| &linked.light)
    }

    /// What `of` says of the lights that light the receiver at `stand`, each with its own blockers, summed.
    pub(super) fn sum(
        &self,
        stand: &Stand<'_>,
        of: impl Fn(&AreaLight, &Stand<'_>) -> Vec3,
    ) -> Vec3 {
        let lights = self.lights.iter().filter(|linked| linked.lights(stand));
        lights.map(|linked| self.ask(linked, stand, &of)).sum()
    }

    /// The sum of what `of` says of lights, by one look a light or, where there are many, by one in all: at one of those that
    /// would give most if nothing were in the way, in proportion to that, about. `number` chooses it; in the mean over all numbers
    /// all are looked at.
    pub(super) fn glimpse(
        &self,
        patterns: &Patterns,
        stand: &Stand<'_>,
        number: u32,
        of: &impl Fn(&AreaLight, &Stand<'_>) -> Vec3,
    ) -> Vec3 {
        let count = self.lights.len();
        if count <= FEW {
            return self.sum(stand, of);
        }
        let weighed = count.min(MOST_WEIGHED);
        let start = fraction(sequence::hash(number));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "rounded down on purpose, from 0 to below count"
        )]
        let light = |k: usize| {
            let place = (k as f32 + start) * (count as f32 / weighed as f32);
            (place as usize).min(count - 1)
        };
        let mut weights = [0.0_f32; MOST_WEIGHED];
        let weights = &mut weights[..weighed];
        if weighed == count {
            self.beacons.weigh(stand.point, weights);
        } else {
            let each = weights.iter_mut().enumerate();
            each.for_each(|(k, weight)| *weight = self.beacons.at(light(k), stand.point));
        }
        if !self.beacons.far().is_empty() {
            let far = (0..weighed).filter(|&k| self.beacons.far().binary_search(&light(k)).is_ok());
            far.for_each(|k| weights[k] = self.far_weight(light(k), patterns, stand));
        }
        let chosen = Chosen {
            weights,
            light: &light,
            part: &|_| 1.0,
            looks: 1.0,
        };
        self.looked_at(&chosen, stand, number, of) * (count as f32 / weighed as f32)
    }

    /// Weight of a light that is infinitely far, as those of [`Beacons::at`].
    fn far_weight(&self, index: usize, patterns: &Patterns, stand: &Stand<'_>) -> f32 {
        let light = &self.lights[index].light;
        light.open(patterns, stand.point).element_sum()
    }

    /// Sum of what `of` says of lights, by a few looks at those chosen by `number`, in proportion to their weights.
    fn looked_at(
        &self,
        chosen: &Chosen<'_>,
        stand: &Stand<'_>,
        number: u32,
        of: &impl Fn(&AreaLight, &Stand<'_>) -> Vec3,
    ) -> Vec3 {
        let step = chosen.weights.iter().sum::<f32>() / chosen.looks;
        let mut next = fraction(sequence::hash(!number)) * step;
        let (mut sum, mut passed) = (Vec3::ZERO, 0.0);
        for (k, &weight) in chosen.weights.iter().enumerate() {
            passed += weight;
            let mut looks = 0.0;
            while next < passed {
                looks += 1.0;
                next += step;
            }
            let linked = &self.lights[(chosen.light)(k)];
            if looks > 0.0 && linked.lights(stand) {
                let times = looks * step * (chosen.part)(k) / weight;
                sum += self.ask(linked, stand, of) * times;
            }
        }
        sum
    }

    /// What `of` says of the lights that give a surfel at `stand` much of its light, as [`Self::sum`] does; where there are few
    /// lights, of all. Lights that are neither count in part: the rest of them is in [`Self::add_minor`].
    pub(super) fn major(
        &self,
        stand: &Stand<'_>,
        of: impl Fn(&AreaLight, &Stand<'_>) -> Vec3,
    ) -> Vec3 {
        if self.lights.len() <= FEW_OF_SURFELS {
            return self.sum(stand, of);
        }
        let beacon = |index: usize| self.beacons.at(index, stand.point);
        let all: f32 = (0..self.lights.len()).map(beacon).sum();
        let mut far = self.beacons.far().iter().peekable();
        let mut sum = Vec3::ZERO;
        for (index, linked) in self.lights.iter().enumerate() {
            let is_far = far.next_if(|&&far| far == index).is_some();
            let part = if is_far {
                1.0
            } else {
                major_part(beacon(index), all)
            };
            if part > 0.0 && linked.lights(stand) {
                sum += part * self.ask(linked, stand, &of);
            }
        }
        sum
    }

    /// Add the irradiance of the other lights to `light`, one value for each of the surfels at `stands`, by few looks each: true in the mean over
    /// neighbors.
    pub(super) fn add_minor<'a>(
        &self,
        patterns: &Patterns,
        stands: impl Iterator<Item = Stand<'a>>,
        light: &mut [Vec3],
    ) {
        if self.lights.len() <= FEW_OF_SURFELS {
            return;
        }
        let mut weights = vec![0.0; self.lights.len()];
        for ((number, light), stand) in (0..).zip(light).zip(stands) {
            self.beacons.weigh(stand.point, &mut weights);
            let all: f32 = weights.iter().sum();
            let minor = |weight: f32| 1.0 - major_part(weight, all);
            weights
                .iter_mut()
                .for_each(|weight| *weight *= minor(*weight));
            let chosen = Chosen {
                weights: &weights,
                light: &|k| k,
                part: &|k| minor(self.beacons.at(k, stand.point)),
                looks: LOOKS,
            };
            let glance = |light: &AreaLight, stand: &Stand<'_>| {
                light.glance(patterns, stand, number as usize)
            };
            *light += self.looked_at(&chosen, &stand, number, &glance);
        }
    }

    fn ask(
        &self,
        linked: &LinkedLight,
        stand: &Stand<'_>,
        of: &impl Fn(&AreaLight, &Stand<'_>) -> Vec3,
    ) -> Vec3 {
        match linked.blockers {
            None => of(&linked.light, stand),
            Some(blockers) => {
                let tracer = &self.tracers[blockers];
                of(&linked.light, &Stand::new(tracer, stand.point))
            }
        }
    }
}

/// Lights of which a few are looked at.
struct Chosen<'a> {
    weights: &'a [f32],
    /// Index of the light that has weight `k`.
    light: &'a dyn Fn(usize) -> usize,
    /// How much of it counts, 0…1; weights have it already.
    part: &'a dyn Fn(usize) -> f32,
    looks: f32,
}

/// Part of a light of `weight` among `all` of a surfel that is looked at on its own, 0…1.
fn major_part(weight: f32, all: f32) -> f32 {
    let (none, whole) = LITTLE;
    ((weight - none * all) / ((whole - none) * all).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0)
}

impl LinkedLight {
    fn lights(&self, stand: &Stand<'_>) -> bool {
        stand.point.prim.is_none_or(|prim| self.lit.contains(prim))
    }
}

/// 0 to below 1.
#[expect(clippy::cast_precision_loss, reason = "24 bits are exact")]
fn fraction(bits: u32) -> f32 {
    (bits >> 8) as f32 / (1 << 24) as f32
}
