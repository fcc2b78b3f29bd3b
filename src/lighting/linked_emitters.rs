//! Emissive surfaces with the prims that they are linked to, those of mesh lights: each set of links has emitters of its own.

use super::balls::{Ball, emissive_balls};
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

/// What emits, before it is made ready.
#[derive(Debug, Default)]
struct Sources {
    triangles: Vec<EmissiveTriangle>,
    balls: Vec<Ball>,
}

/// All of it, by links.
#[derive(Debug, Default)]
struct Sets {
    free: Sources,
    linked: Vec<(LightLinks, Sources)>,
}

impl Sets {
    /// Those with these `links`.
    fn of(&mut self, links: Option<&LightLinks>) -> &mut Sources {
        let Some(links) = links.filter(|links| **links != LightLinks::default()) else {
            return &mut self.free;
        };
        let known = self.linked.iter().position(|(known, _)| known == links);
        let place = known.unwrap_or_else(|| {
            self.linked.push((links.clone(), Sources::default()));
            self.linked.len() - 1
        });
        &mut self.linked[place].1
    }
}

impl LinkedEmitters {
    /// Find them; cost linear in the triangles of emissive materials. A hierarchy is built for each set of prims that alone
    /// blocks some of them.
    pub(super) fn new(shader: &Shader<'_>) -> Self {
        let mut sets = Sets::default();
        for triangle in emissive_triangles(shader) {
            let links = shader.emission_links(triangle.prim, triangle.triangle);
            sets.of(links).triangles.push(triangle);
        }
        for ball in emissive_balls(shader) {
            let links = shader.emission_links(ball.prim, ball.triangle);
            sets.of(links).balls.push(ball);
        }
        let particles = shader.lights().filter_map(|light| match &light.kind {
            LightKind::Particles(set) => Some((&**set, light.radiance)),
            _ => None,
        });
        let emitters = |sources: Sources, are_met: bool, particles: &[_]| {
            let balls = (&sources.balls[..], are_met);
            Emitters::new(shader, sources.triangles, balls, particles)
        };
        let group = |(links, sources): (LightLinks, Sources)| {
            let (blockers, opacity) = (&links.blockers, shader.opacity());
            let is_blocked_by_some = *blockers != Linked::All;
            Group {
                emitters: emitters(sources, !is_blocked_by_some, &[]),
                tracer: is_blocked_by_some.then(|| {
                    Tracer::among(shader.scene(), opacity, |prim| blockers.contains(prim))
                }),
                lit: links.lit,
            }
        };
        Self {
            free: emitters(sets.free, true, &particles.collect::<Vec<_>>()),
            groups: sets.linked.into_iter().map(group).collect(),
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
