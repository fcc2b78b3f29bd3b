//! Dome lights that do not light every prim, or that not every prim blocks: each set of links has a sky of its own.

use super::environment::{Environment, EnvironmentSet, SkyLight};
use super::stand::Stand;
use super::{ShadePoint, in_blocks};
use crate::diagnostics::Diagnostics;
use crate::scene::{Light, LightKind, Linked, PrimId, Scene};
use crate::trace::{Opacity, Tracer};
use glam::Vec3;
use std::sync::Arc;

/// All domes of a scene with links that leave something out.
#[derive(Debug)]
pub struct LinkedDomes(Vec<Group>);

/// Domes with the same links.
#[derive(Debug)]
struct Group {
    environment: Environment,
    /// For receivers, and for surfels.
    skies: [EnvironmentSet; 2],
    lit: Linked,
    /// Of the prims that block them; `None` = everything does.
    tracer: Option<Tracer>,
}

/// Which sky of a group.
#[derive(Debug, Clone, Copy)]
pub(super) enum Fineness {
    Receivers,
    Surfels,
}

/// True if `light` is one of [`LinkedDomes`].
pub(super) fn is_linked(light: &Light) -> bool {
    matches!(light.kind, LightKind::Dome { .. })
        && (light.lit != Linked::All || light.blockers != Linked::All)
}

impl LinkedDomes {
    /// Those among `all` lights of `scene`, whose surfaces stop as much as `opacity` says; their skies in about `counts` cells.
    /// A hierarchy is built for each set of prims that alone blocks some dome.
    pub(super) fn new<'a>(
        (scene, opacity): (&Scene, Option<Arc<dyn Opacity>>),
        all: impl Iterator<Item = &'a Light>,
        counts: [u32; 2],
        diagnostics: &Diagnostics,
    ) -> Self {
        let mut sets: Vec<Vec<&Light>> = Vec::new();
        for light in all.filter(|light| is_linked(light)) {
            let has_same = |set: &Vec<&Light>| {
                (&set[0].lit, &set[0].blockers) == (&light.lit, &light.blockers)
            };
            match sets.iter().position(has_same) {
                Some(known) => sets[known].push(light),
                None => sets.push(vec![light]),
            }
        }
        let group = |set: Vec<&Light>| {
            let environment = Environment::new(set.iter().copied(), diagnostics);
            let first = set[0];
            let blockers = Some(&first.blockers).filter(|blockers| **blockers != Linked::All);
            environment.is_lit().then(|| Group {
                skies: environment.sets(counts),
                environment,
                lit: first.lit.clone(),
                tracer: blockers.map(|blockers| {
                    Tracer::among(scene, opacity.clone(), |prim| blockers.contains(prim))
                }),
            })
        };
        Self(sets.into_iter().filter_map(group).collect())
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Add their light at each of `points`, receivers, to `light`, one value for each. Nothing beyond `reach` hides it.
    pub fn add_light(&self, tracer: &Tracer, asked: (&[ShadePoint], f32), light: &mut [SkyLight]) {
        self.add(Fineness::Receivers, tracer, asked, light);
    }

    /// [`Self::add_light`] by the sky of some fineness.
    pub(super) fn add(
        &self,
        fineness: Fineness,
        tracer: &Tracer,
        (points, reach): (&[ShadePoint], f32),
        light: &mut [SkyLight],
    ) {
        for group in &self.0 {
            let lit: Vec<usize> = (0..points.len())
                .filter(|&i| group.lights(points[i].prim))
                .collect();
            let few: Vec<ShadePoint> = lit.iter().map(|&i| points[i]).collect();
            let sky = group.sky(fineness);
            let tracer = group.tracer.as_ref().unwrap_or(tracer);
            let found = in_blocks(tracer, (&few, reach), |stands| {
                group.environment.block(sky, stands)
            });
            for (i, found) in lit.into_iter().zip(found) {
                light[i].irradiance += found.irradiance;
                light[i].direction += found.direction;
            }
        }
    }

    /// As [`Environment::glimpse`].
    pub(super) fn glimpse(&self, stand: &Stand<'_>, number: u32) -> Vec3 {
        let groups = self.0.iter().filter(|group| group.lights(stand.point.prim));
        let light = groups.map(|group| {
            let sky = group.sky(Fineness::Receivers);
            match &group.tracer {
                Some(tracer) => {
                    let stand = Stand::new(tracer, stand.point);
                    group.environment.glimpse(sky, &stand, number)
                }
                None => group.environment.glimpse(sky, stand, number),
            }
        });
        light.sum()
    }

    /// Radiance from unit `direction` of those that light `prim`, of all without one.
    pub(super) fn radiance(&self, prim: Option<PrimId>, direction: Vec3) -> Vec3 {
        let groups = self.0.iter().filter(|group| group.lights(prim));
        groups
            .map(|group| group.environment.radiance(direction))
            .sum()
    }
}

impl Group {
    fn lights(&self, prim: Option<PrimId>) -> bool {
        prim.is_none_or(|prim| self.lit.contains(prim))
    }

    fn sky(&self, fineness: Fineness) -> &EnvironmentSet {
        match fineness {
            Fineness::Receivers => &self.skies[0],
            Fineness::Surfels => &self.skies[1],
        }
    }
}
