//! Emissive surfaces with the prims that they are linked to, those of mesh lights: each set of links has emitters of its own.

use super::emitters::{EmissiveTriangle, EmitterPatterns, Emitters, emissive_triangles};
use super::stand::Stand;
use crate::scene::{LightKind, LightLinks, Linked};
use crate::shading::Shader;
use crate::trace::Tracer;
use glam::Vec3;

/// All that emits in a scene but lights with a shape of their own.
#[derive(Debug)]
pub(super) struct LinkedEmitters {
    /// Of those that light everybody and that everything blocks.
    free: Emitters,
    groups: Vec<Group>,
}

/// Emitters with the same links.
#[derive(Debug)]
struct Group {
    emitters: Emitters,
    lit: Linked,
    /// Of the prims that block them; `None` = everything does.
    tracer: Option<Tracer>,
}

impl LinkedEmitters {
    /// Find them; cost linear in the triangles of emissive materials. A hierarchy is built for each set of prims that alone
    /// blocks some of them.
    pub(super) fn new(shader: &Shader<'_>) -> Self {
        let mut free = Vec::new();
        let mut sets: Vec<(LightLinks, Vec<EmissiveTriangle>)> = Vec::new();
        for triangle in emissive_triangles(shader) {
            let links = shader.emission_links(triangle.prim, triangle.triangle);
            let Some(links) = links.filter(|links| **links != LightLinks::default()) else {
                free.push(triangle);
                continue;
            };
            match sets.iter_mut().find(|(known, _)| known == links) {
                Some((_, triangles)) => triangles.push(triangle),
                None => sets.push((links.clone(), vec![triangle])),
            }
        }
        let particles = shader.lights().filter_map(|light| match &light.kind {
            LightKind::Particles(set) => Some((&**set, light.radiance)),
            _ => None,
        });
        let group = |(links, triangles): (LightLinks, _)| {
            let (blockers, opacity) = (&links.blockers, shader.opacity());
            let is_blocked_by_some = *blockers != Linked::All;
            Group {
                emitters: Emitters::new(shader, triangles, &[]),
                tracer: is_blocked_by_some.then(|| {
                    Tracer::among(shader.scene(), opacity, |prim| blockers.contains(prim))
                }),
                lit: links.lit,
            }
        };
        Self {
            free: Emitters::new(shader, free, &particles.collect::<Vec<_>>()),
            groups: sets.into_iter().map(group).collect(),
        }
    }

    /// True if nothing emits.
    pub(super) fn is_empty(&self) -> bool {
        self.free.is_empty() && self.groups.is_empty()
    }

    /// Irradiance, of those that light the prim that `stand` is on.
    pub(super) fn irradiance(
        &self,
        patterns: &EmitterPatterns,
        shader: &Shader<'_>,
        stand: &Stand<'_>,
    ) -> Vec3 {
        let mut sum = match self.free.is_empty() {
            true => Vec3::ZERO,
            false => self.free.irradiance(patterns, shader, stand),
        };
        let prim = stand.point.prim;
        let lights = |group: &&Group| prim.is_none_or(|prim| group.lit.contains(prim));
        for group in self.groups.iter().filter(lights) {
            sum += match &group.tracer {
                Some(tracer) => {
                    let stand = Stand::new(tracer, stand.point);
                    group.emitters.irradiance(patterns, shader, &stand)
                }
                None => group.emitters.irradiance(patterns, shader, stand),
            };
        }
        sum
    }
}
