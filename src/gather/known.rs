//! Answers that are known already, as an [`Engine`]: what hangs on them is computed as if they had been seen.

use super::{Engine, Hemisphere};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::receivers::Receivers;
use glam::Vec3;
use std::borrow::Cow;
use std::f32::consts::PI;
use std::ops::Range;

/// Occlusion and reflected light of all receivers of a run, without directions: good for irradiance, and for what only hangs
/// on how much is open.
#[derive(Debug)]
pub struct KnownEngine<'a> {
    /// 0…1, by receiver; `None`: all is covered.
    pub occlusion: Option<Cow<'a, [f32]>>,
    /// Irradiance by receiver, radiance·sr; `None`: black.
    pub indirect: Option<Cow<'a, [Vec3]>>,
    /// Nothing beyond it was seen, stage units.
    pub max_distance: f32,
    /// Of the engine that found it out.
    pub name: &'static str,
}

impl Engine for KnownEngine<'_> {
    fn see(
        &self,
        receivers: &Receivers,
        block: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    ) {
        for i in block {
            let covered = self.occlusion.as_ref().map_or(1.0, |all| all[i]);
            let irradiance = self.indirect.as_ref().map_or(Vec3::ZERO, |all| all[i]);
            two_directions(receivers.normal[i], (covered, irradiance), scratch);
            visit(i, scratch);
        }
    }

    fn max_distance(&self) -> f32 {
        self.max_distance
    }

    fn name(&self) -> &'static str {
        self.name
    }

    fn survey(
        &self,
        _receivers: &Receivers,
        _diagnostics: &Diagnostics,
    ) -> Result<Option<Box<dyn Engine + '_>>, Cancelled> {
        Ok(Some(Box::new(KnownEngine {
            occlusion: self.occlusion.as_deref().map(Cow::Borrowed),
            indirect: self.indirect.as_deref().map(Cow::Borrowed),
            ..*self
        })))
    }
}

/// A hemisphere that tells no more than how much is covered, and the irradiance of reflected light: one direction that is
/// covered and sends all the light, and one that is open.
pub(super) fn two_directions(
    normal: Vec3,
    (covered, irradiance): (f32, Vec3),
    seen: &mut Hemisphere,
) {
    // Light without anything that covers: rounding, or a blend of receivers that see a little.
    let least = if irradiance == Vec3::ZERO {
        0.0
    } else {
        f32::EPSILON
    };
    let weight = PI * covered.max(least);
    let radiance = if weight > 0.0 {
        irradiance / weight
    } else {
        Vec3::ZERO
    };
    seen.clear();
    for (weight, coverage, distance, radiance) in [
        (weight, 1.0, 0.0, radiance),
        (PI - weight, 0.0, f32::INFINITY, Vec3::ZERO),
    ] {
        seen.direction.push(normal);
        seen.weight.push(weight);
        seen.coverage.push(coverage);
        seen.distance.push(distance);
        seen.reflected.push(radiance);
        seen.emitted.push(Vec3::ZERO);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Placed;
    use super::super::quantities::{irradiance, occlusion};
    use super::super::testing::receivers_at;
    use super::*;

    fn known() -> KnownEngine<'static> {
        KnownEngine {
            occlusion: Some(vec![0.0, 0.25, 1.0].into()),
            indirect: Some(vec![Vec3::X, Vec3::Y, Vec3::ZERO].into()),
            max_distance: f32::INFINITY,
            name: "known",
        }
    }

    /// Occlusion and irradiance that `engine` tells of `block`.
    fn seen(engine: &dyn Engine, receivers: &Receivers, block: Range<usize>) -> Vec<(f32, Vec3)> {
        let mut all = Vec::new();
        let mut visit = |_, seen: &Hemisphere| {
            all.push((occlusion::occlusion(seen), irradiance::indirect(seen)));
        };
        engine.see(receivers, block, &mut Hemisphere::default(), &mut visit);
        all
    }

    #[test]
    fn what_is_known_is_read_off_again_even_light_where_nothing_covers() {
        let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y); 3]);
        let exact = [(0.0, Vec3::X), (0.25, Vec3::Y), (1.0, Vec3::ZERO)];
        let found = seen(&known(), &receivers, 0..3);
        for ((covered, light), (exact, exact_light)) in found.into_iter().zip(exact) {
            assert!((covered - exact).abs() < 1e-6, "{covered} {exact}");
            assert!(light.abs_diff_eq(exact_light, 1e-5), "{light}");
        }
    }

    /// As a gather asks that hands neighbors over together: it once got the answers of the first ones.
    #[test]
    fn receivers_in_another_order_get_their_own_answers() {
        let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y); 3]);
        let (engine, places) = (known(), [2, 1]);
        let placed = Placed {
            engine: &engine,
            receivers: &receivers,
            places: &places,
        };
        let found = seen(&placed, &receivers.subset(&places), 0..2);
        assert_eq!(found[0], (1.0, Vec3::ZERO));
        assert!((found[1].0 - 0.25).abs() < 1e-6 && found[1].1.abs_diff_eq(Vec3::Y, 1e-5));
    }
}
