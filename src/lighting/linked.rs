//! Lights with the prims that they are linked to: those they light, and those that block them.

mod receivers;

use super::beacons::Beacons;
use super::lights::{AreaLight, Patterns};
use super::stand::Stand;
use crate::diagnostics::Diagnostics;
use crate::math::{Bounds3, sequence};
use crate::scene::{Light, Linked, Scene};
use crate::trace::{Bodies, Opacity, Tracer};
use glam::Vec3;
pub(super) use receivers::Scratch;
use receivers::by_place;
use std::sync::Arc;

/// All lights of a scene but domes and emissive surfaces.
#[derive(Debug)]
pub(super) struct LinkedLights {
    /// Row after row, see [`rows_of`].
    lights: Vec<LinkedLight>,
    beacons: Beacons,
    /// Indices of `lights`, neighbors near each other.
    by_place: Vec<usize>,
    /// Lights with an extent, by their places in `lights`.
    bodies: Bodies,
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
        // Neighbors are dealt to different rows, so that each row lights a place about as all do.
        let rows = rows_of(lights.len());
        let mut dealt: Vec<_> = lights.into_iter().enumerate().collect();
        dealt.sort_by_key(|(index, _)| index % rows);
        let lights: Vec<_> = dealt.into_iter().map(|(_, linked)| linked).collect();
        Self {
            beacons: Beacons::new(lights.iter().map(|linked| linked.light.beacon())),
            by_place: by_place(&lights),
            bodies: bodies_of(&lights),
            lights,
            tracers,
        }
    }

    /// True if surfels need not look at each on its own.
    pub(super) fn are_many(&self) -> bool {
        self.lights.len() > FEW_OF_SURFELS
    }

    pub(super) fn count(&self) -> usize {
        self.lights.len()
    }

    /// Distance and radiance of the nearest along the unit `direction`, closer than `max_distance`; of several at one distance the
    /// same one always.
    pub(super) fn seen(
        &self,
        origin: Vec3,
        direction: Vec3,
        max_distance: f32,
    ) -> Option<(f32, Vec3)> {
        let light = |index: u32| &self.lights[index as usize].light;
        let distance = |index| light(index).distance(origin, direction);
        let (_, first) = (self.bodies).first((origin, direction), max_distance, distance)?;
        light(first).seen(origin, direction)
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
        let rows = rows_of(count);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "rounded down on purpose, from 0 to below the count of rows"
        )]
        let (times, row) = {
            let rows = rows as f32;
            (rows, (fraction(sequence::hash(number)) * rows) as usize)
        };
        let row = first_of_row(count, row)..first_of_row(count, row + 1);
        let mut weights = [0.0_f32; MOST_WEIGHED];
        let weights = &mut weights[..row.len()];
        self.beacons.weigh(stand.point, row.start, weights);
        let far = (self.beacons.far().iter()).filter(|far| row.contains(far));
        far.for_each(|&far| weights[far - row.start] = self.far_weight(far, patterns, stand));
        let chosen = Chosen {
            weights,
            first: row.start,
            part: &|_| 1.0,
            looks: 1.0,
        };
        self.looked_at(&chosen, stand, number, of) * times
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
            let linked = &self.lights[chosen.first + k];
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
        if !self.are_many() {
            return self.sum(stand, of);
        }
        let mut all = 0.0;
        (self.beacons).for_each(stand.point, |_, weight| all += weight);
        let mut far = self.beacons.far().iter().peekable();
        let mut sum = Vec3::ZERO;
        self.beacons.for_each(stand.point, |index, weight| {
            let is_far = far.next_if(|&&far| far == index).is_some();
            let part = if is_far { 1.0 } else { major_part(weight, all) };
            let linked = &self.lights[index];
            if part > 0.0 && linked.lights(stand) {
                sum += part * self.ask(linked, stand, &of);
            }
        });
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
        if !self.are_many() {
            return;
        }
        let mut weights = vec![0.0; self.lights.len()];
        for ((number, light), stand) in (0..).zip(light).zip(stands) {
            self.beacons.weigh(stand.point, 0, &mut weights);
            let all: f32 = weights.iter().sum();
            let minor = |weight: f32| 1.0 - major_part(weight, all);
            weights
                .iter_mut()
                .for_each(|weight| *weight *= minor(*weight));
            let chosen = Chosen {
                weights: &weights,
                first: 0,
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

/// Rows of about as many lights, [`MOST_WEIGHED`] at most, into which `count` lights are dealt.
fn rows_of(count: usize) -> usize {
    count.div_ceil(MOST_WEIGHED).max(1)
}

/// Index of the first of `count` lights that lies in `row`: the first rows have one more, if they are not equal.
fn first_of_row(count: usize, row: usize) -> usize {
    let rows = rows_of(count);
    row * (count / rows) + row.min(count % rows)
}

/// Lights of which a few are looked at.
struct Chosen<'a> {
    weights: &'a [f32],
    /// Index of the light that has the first weight; the others follow it.
    first: usize,
    /// How much of it counts, 0…1; weights have it already.
    part: &'a dyn Fn(usize) -> f32,
    looks: f32,
}

/// Part of a light of `weight` among `all` of a surfel that is looked at on its own, 0…1.
fn major_part(weight: f32, all: f32) -> f32 {
    let (none, whole) = LITTLE;
    ((weight - none * all) / ((whole - none) * all).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0)
}

/// Those that a ray can meet.
fn bodies_of(lights: &[LinkedLight]) -> Bodies {
    let with_ball = |(index, linked): (u32, &LinkedLight)| {
        let ball = linked.light.beacon()?;
        let around = Bounds3::around([ball.center - ball.radius, ball.center + ball.radius]);
        (ball.radius > 0.0).then_some((index, around))
    };
    let boxes: Vec<_> = (0..).zip(lights).filter_map(with_ball).collect();
    Bodies::new(&boxes)
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
