//! Lights with the prims that they are linked to: those they light, and those that block them.

use super::lights::AreaLight;
use super::stand::Stand;
use crate::diagnostics::Diagnostics;
use crate::scene::{Light, Linked, Scene};
use crate::trace::{Opacity, Tracer};
use glam::Vec3;
use std::sync::Arc;

/// All lights of a scene but domes and emissive surfaces.
#[derive(Debug)]
pub(super) struct LinkedLights {
    lights: Vec<LinkedLight>,
    /// For lights that only some prims block, one for each such set.
    tracers: Vec<Tracer>,
}

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
        Self { lights, tracers }
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
        let prim = stand.point.prim;
        let lights = self.lights.iter();
        let lights = lights.filter(|linked| prim.is_none_or(|prim| linked.lit.contains(prim)));
        lights
            .map(|linked| match linked.blockers {
                None => of(&linked.light, stand),
                Some(blockers) => {
                    let tracer = &self.tracers[blockers];
                    of(&linked.light, &Stand::new(tracer, stand.point))
                }
            })
            .sum()
    }
}
