//! What a glossy surface reflects towards the eye: rays spread as its lobes are. PBGI §6.2.

use super::glossy::Glossy;
use super::{Hemisphere, Look, Pattern, RaysEngine, Stand};
use crate::lighting::Lighting;
use crate::math::sequence;
use crate::receivers::Receivers;
use crate::scene::PrimId;
use crate::shading::gloss::Gloss;
use crate::shading::{Shader, SurfacePoint};
use crate::trace::Tracer;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use std::hash::{DefaultHasher, Hash, Hasher};

/// What lobes need besides rays.
#[derive(Debug, Clone, Copy)]
pub struct Lobes<'a> {
    /// Tells what reflects at receivers.
    pub shader: &'a Shader<'a>,
    /// Its environment is seen where nothing is; `None`: black.
    pub lighting: Option<&'a Lighting>,
    /// What lies between surfaces and lamps.
    pub tracer: &'a Tracer,
}

/// `count` points in [0, 1)², turned by `turn` turns.
pub(super) fn points(count: u32, turn: f32) -> Vec<Vec2> {
    let point = |i| {
        let point = sequence::fibonacci(i, count);
        Vec2::new(point.x, (point.y + turn).rem_euclid(1.0))
    };
    (0..count).map(point).collect()
}

/// Narrower lobes (`alpha`) show edges: no neighbor knows where.
const TELLING: f32 = 0.1;

impl RaysEngine<'_> {
    /// Which of `receivers` reflect alike, a number each: those of one prim with the very same lobes. `None` for those with narrow
    /// lobes, or without any. `None` if the engine is not asked about lobes.
    pub fn kinds(&self, receivers: &Receivers) -> Option<Vec<Option<u32>>> {
        let Pattern::Lobes(lobes, _) = &self.pattern else {
            return None;
        };
        let key = |(surface, &prim): (&SurfacePoint, &u32)| {
            let gloss = lobes.shader.gloss(surface);
            let tells = gloss.lobes().count() > 0 && gloss.lobes().all(|l| l.alpha >= TELLING);
            tells.then(|| hash_of(prim, &gloss))
        };
        let surfaces = receivers.surface.par_iter();
        let keys: Vec<Option<u64>> = surfaces.zip(&receivers.prim).map(key).collect();
        let mut known: Vec<u64> = keys.iter().flatten().copied().collect();
        known.par_sort_unstable();
        known.dedup();
        let number = |key: u64| known.binary_search(&key).ok()?.try_into().ok();
        Some(keys.into_par_iter().map(|key| number(key?)).collect())
    }

    /// What receiver `i` reflects towards the eye, the same rays for every lobe: the light of a direction, in `reflected`, is
    /// already times what a lobe makes of it. Nothing where the eye does not see the receiver's front, or there is none.
    pub(super) fn fill_lobes(
        &self,
        (lobes, points): (&Lobes<'_>, &[Vec2]),
        (receivers, i): (&Receivers, usize),
        seen: &mut Hemisphere,
    ) {
        seen.clear();
        let normal = receivers.normal[i];
        let Some(&eye) = receivers.toward_eye.get(i) else {
            return;
        };
        let frame = sequence::transported_frame(normal);
        let view = frame.to_local(eye);
        if view.z <= 0.0 {
            return;
        }
        let stand = Stand::of(receivers, i);
        let origin = self.query.lift(receivers.position[i], stand.lift);
        let gloss = lobes.shader.gloss(&receivers.surface[i]);
        let prim = Some(PrimId(receivers.prim[i]));
        let mut layers = Vec::new();
        for lobe in gloss.lobes() {
            for (&point, number) in points.iter().zip(0..) {
                let Some((local, share)) = lobe.sample(view, point) else {
                    continue;
                };
                let direction = stand.above_horizon(frame.to_world(local));
                let glossy = self.source.as_ref().map(|source| Glossy {
                    query: self.query,
                    source,
                    lobes: *lobes,
                    max_distance: self.max_distance,
                    number,
                });
                let look = Look {
                    query: self.query,
                    source: glossy.as_ref(),
                    max_distance: self.max_distance,
                };
                let sight = look.along(origin, direction, &mut layers);
                let open = 1.0 - sight.coverage;
                let mut light = sight.light.reflected + sight.light.emitted;
                if let Some(lighting) = lobes.lighting.filter(|_| open > 0.0) {
                    light += lighting.environment_radiance(prim, direction) * open;
                }
                seen.direction.push(direction);
                seen.weight.push(1.0 / points.len() as f32);
                seen.coverage.push(sight.coverage);
                seen.distance.push(sight.distance);
                seen.reflected.push(share * light);
                seen.emitted.push(Vec3::ZERO);
            }
        }
    }
}

/// The same for the same prim and lobes.
fn hash_of(prim: u32, gloss: &Gloss) -> u64 {
    let mut hasher = DefaultHasher::new();
    prim.hash(&mut hasher);
    for lobe in [&gloss.base, &gloss.coat] {
        let numbers = [lobe.f0.to_array(), lobe.f90.to_array()];
        numbers
            .map(|color| color.map(f32::to_bits))
            .hash(&mut hasher);
        lobe.alpha.to_bits().hash(&mut hasher);
    }
    hasher.finish()
}
