//! Lights with the prims that they are linked to: those they light, and those that block them.

use super::lights::{AreaLight, Beacon, Patterns};
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
    /// Theirs, side by side: places weigh all lights.
    beacons: Vec<Option<Beacon>>,
    /// For lights that only some prims block, one for each such set.
    tracers: Vec<Tracer>,
}

/// Looks at lights from a place that few rays light; each light is looked at where there are no more.
const LOOKS: usize = 4;

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
            beacons: lights.iter().map(|linked| linked.light.beacon()).collect(),
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

    /// Irradiance by one look a light or, where there are many, by four: at those that would give most if nothing were in
    /// the way, about in proportion. `number` chooses them and the places on them; the mean over all numbers is the truth.
    pub(super) fn glimpse(&self, patterns: &Patterns, stand: &Stand<'_>, number: u32) -> Vec3 {
        let glance =
            |light: &AreaLight, stand: &Stand<'_>| light.glance(patterns, stand, number as usize);
        let count = self.lights.len();
        if count <= LOOKS {
            return self.sum(stand, glance);
        }
        let weighed = count.min(MOST_WEIGHED);
        let (start, mut next) = (
            fraction(sequence::hash(number)),
            fraction(sequence::hash(!number)),
        );
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
        for (k, weight) in weights[..weighed].iter_mut().enumerate() {
            let i = light(k);
            *weight = match self.beacons[i] {
                Some(beacon) => beacon.at(stand.point),
                None => self.lights[i]
                    .light
                    .open(patterns, stand.point)
                    .element_sum(),
            };
        }
        let step = weights.iter().sum::<f32>() / LOOKS as f32;
        let (mut sum, mut passed) = (Vec3::ZERO, 0.0);
        next *= step;
        for (k, &weight) in weights[..weighed].iter().enumerate() {
            passed += weight;
            let mut looks = 0.0;
            while next < passed {
                looks += 1.0;
                next += step;
            }
            let linked = &self.lights[light(k)];
            if looks > 0.0 && linked.lights(stand) {
                sum += self.ask(linked, stand, &glance) * (looks * step / weight);
            }
        }
        sum * (count as f32 / weighed as f32)
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
