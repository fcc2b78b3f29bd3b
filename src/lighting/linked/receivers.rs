//! Irradiance at a receiver from any number of lights, without chance, for about as many shadow rays as one light takes.
//!
//! Strong lights are looked at on their own, each by as many rays as its share of the light asks for. All others are groups of
//! neighbors, halved until none would give more than a small part of the light if nothing were in the way; a group is as visible
//! as one place on one of its lights: exact where nothing is in the way. Where something is, groups are a quarter as strong, and
//! weaker still where little arrives. They are the same for receivers side by side, so that these err alike.

use super::{FEW, LinkedLight, LinkedLights};
use crate::lighting::lights::{AreaLight, Pattern, Patterns};
use crate::lighting::stand::Stand;
use crate::math::bits::{MORTON_CELLS, morton};
use crate::math::{Bounds3, sequence};
use crate::trace::{TOGETHER, Way};
use glam::{DVec3, Vec3};

/// Lights that give no less than this share of what there is without shadows are looked at on their own.
const OWN_SHARE: f64 = 1.0 / 16.0;

/// Times the looks where not all is seen.
const FINER: usize = 4;

/// Part of the light, one over it, that arrives at least where no more looks are taken than that; and most times as many.
const DEEP: f64 = 2.0;
const MOST_DEEP: f64 = 16.0;

/// Kept from receiver to receiver.
#[derive(Debug, Default)]
pub(in crate::lighting) struct Scratch {
    /// What each light gives if nothing is in the way; black for those that were looked at.
    open: Vec<Vec3>,
    /// Lights that are looked at on their own.
    own: Vec<usize>,
    /// What the first of the others give, in the order of `by_place`.
    sums: Vec<DVec3>,
}

/// Indices of `lights` along a Morton curve; those infinitely far at its beginning.
pub(super) fn by_place(lights: &[LinkedLight]) -> Vec<usize> {
    let center = |index: usize| Some(lights[index].light.beacon()?.center);
    let bounds = Bounds3::around((0..lights.len()).filter_map(center));
    let size = (bounds.max - bounds.min).max_element();
    let scale = if size > 0.0 { MORTON_CELLS / size } else { 0.0 };
    let mut order: Vec<usize> = (0..lights.len()).collect();
    order.sort_by_key(|&index| center(index).map(|center| morton((center - bounds.min) * scale)));
    order
}

/// Of irradiance, its channels summed.
fn weight(light: Vec3) -> f64 {
    light.element_sum().into()
}

impl LinkedLight {
    /// False if a place on it stands for others too: what is in its way is in theirs.
    fn is_apart(&self) -> bool {
        self.blockers.is_some() || !self.light.casts_shadows()
    }
}

impl LinkedLights {
    /// Irradiance of the receiver at `stand`. A light that is all there is takes the rays of `patterns`, and fewer where
    /// these agree.
    pub(in crate::lighting) fn irradiance(
        &self,
        patterns: &Patterns,
        stand: &Stand<'_>,
        scratch: &mut Scratch,
    ) -> Vec3 {
        let Scratch { open, own, sums } = scratch;
        open.clear();
        open.extend(self.lights.iter().map(|linked| {
            if linked.lights(stand) {
                linked.light.open(patterns, stand.point)
            } else {
                Vec3::ZERO
            }
        }));
        let mut lit = Vec3::ZERO;
        loop {
            let whole = weight(lit) + open.iter().copied().map(weight).sum::<f64>();
            lit += self.strong((patterns, whole), (open, own), stand);
            let left = weight(lit) + open.iter().copied().map(weight).sum::<f64>();
            // Others are strong where much was hidden.
            if own.is_empty() || left > 0.5 * whole {
                break;
            }
        }
        sums.clear();
        sums.push(DVec3::ZERO);
        let mut sum = DVec3::ZERO;
        for &index in &self.by_place {
            sum += open[index].as_dvec3();
            sums.push(sum);
        }
        lit + self.shared((patterns, sums), (stand, weight(lit)))
    }

    /// Irradiance from the lights that give a good part of `whole` if nothing is in the way, and from those that are apart, which
    /// are taken out of `open`.
    fn strong(
        &self,
        (patterns, mut whole): (&Patterns, f64),
        (open, own): (&mut [Vec3], &mut Vec<usize>),
        stand: &Stand<'_>,
    ) -> Vec3 {
        let are_few = self.lights.len() <= FEW;
        let least = if are_few { 0.0 } else { OWN_SHARE * whole };
        let is_own = |&index: &usize| {
            let weight = weight(open[index]);
            weight > 0.0 && (weight >= least || self.lights[index].is_apart())
        };
        own.clear();
        own.extend((0..self.lights.len()).filter(is_own));
        let stronger = |a: usize, b: usize| weight(open[b]).total_cmp(&weight(open[a]));
        own.sort_unstable_by(|&a, &b| stronger(a, b).then(a.cmp(&b)));
        let mut lit = Vec3::ZERO;
        for &index in &*own {
            let light = std::mem::take(&mut open[index]);
            let pattern = patterns.of_share(weight(light) / whole);
            let visible = |area: &AreaLight, stand: &Stand<'_>| area.visible_part(pattern, stand);
            let arrived = light * self.ask(&self.lights[index], stand, &visible);
            lit += arrived;
            whole -= weight(light) - weight(arrived);
        }
        lit
    }

    /// Irradiance from lights that give, as far as each place of `by_place`, `sums` if nothing is in the way; `lit` arrives from
    /// others.
    fn shared(
        &self,
        (patterns, sums): (&Patterns, &[DVec3]),
        (stand, lit): (&Stand<'_>, f64),
    ) -> Vec3 {
        let rest = sums[sums.len() - 1].element_sum();
        if rest <= 0.0 {
            return Vec3::ZERO;
        }
        let share = rest / (lit + rest);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "part of a few hundred"
        )]
        let looks = (share * (patterns.rays() / FINER) as f64).ceil().max(1.0) as usize;
        let coarse = self.by_groups((patterns.finest(), sums), looks, stand);
        if coarse.is_all_open() {
            return coarse.lit;
        }
        let fine = self.by_groups((patterns.finest(), sums), FINER * looks, stand);
        // Where little arrives what one look is wrong by is much of it.
        let arrived = (lit + weight(fine.lit)) / (lit + rest);
        if !fine.is_any_open || arrived >= 1.0 / DEEP {
            return fine.lit;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to 16"
        )]
        let times = (1.0 / (DEEP * arrived)).ceil().min(MOST_DEEP) as usize;
        (self.by_groups((patterns.finest(), sums), times * FINER * looks, stand)).lit
    }

    /// The same by looks that each stand for no more light than one of so many.
    fn by_groups(
        &self,
        (pattern, sums): (&Pattern, &[DVec3]),
        looks: usize,
        stand: &Stand<'_>,
    ) -> Looks {
        #[expect(clippy::cast_precision_loss, reason = "a few hundred")]
        let most = sums[sums.len() - 1].element_sum() / looks as f64;
        let mut found = Looks::default();
        // Halves wait; there are no more than lights have bits.
        let (mut waiting, mut count) = ([(0, 0); usize::BITS as usize], 1);
        waiting[0] = (0, self.by_place.len());
        while count > 0 {
            count -= 1;
            let (start, end) = waiting[count];
            let light = sums[end] - sums[start];
            let weight = light.element_sum();
            if weight <= 0.0 {
                continue;
            }
            let middle = start.midpoint(end);
            if weight > most && end - start > 1 {
                (waiting[count], waiting[count + 1]) = ((middle, end), (start, middle));
                count += 2;
                continue;
            }
            // Any that gives something: those in the middle of all groups would lie in rows, and shadows fall between them.
            let first = start + any_below(end - start, (start, end));
            let shines = |&place: &usize| sums[place + 1] != sums[place];
            let Some(place) = (first..end).chain(start..first).find(shines) else {
                continue;
            };
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a few, one at least"
            )]
            let times = (weight / most).ceil().max(1.0) as u32;
            let index = self.by_place[place];
            let part = (light / f64::from(times)).as_vec3();
            for turn in 0..times as usize {
                // The first look at a light is at a place of its own, whoever looks.
                let way = self.lights[index].light.way(pattern, stand, index + turn);
                found.look(stand, part, way);
            }
        }
        found.finish(stand);
        found
    }
}

/// A number below `count` that follows no pattern, but is always the same for a group from `start` to `end`.
fn any_below(count: usize, (start, end): (usize, usize)) -> usize {
    #[expect(clippy::cast_possible_truncation, reason = "any bits will do")]
    let hash = sequence::hash(sequence::hash(start as u32) ^ end as u32);
    hash as usize % count
}

/// Looks along some ways, which are waited for until there are enough.
#[derive(Debug)]
struct Looks {
    ways: [Way; TOGETHER],
    light: [Vec3; TOGETHER],
    count: usize,
    /// What arrived.
    lit: Vec3,
    /// Somewhere something, or everything, arrived.
    is_any_open: bool,
    is_any_blocked: bool,
}

impl Default for Looks {
    fn default() -> Self {
        Self {
            ways: [Way::NONE; TOGETHER],
            light: [Vec3::ZERO; TOGETHER],
            count: 0,
            lit: Vec3::ZERO,
            is_any_open: false,
            is_any_blocked: false,
        }
    }
}

impl Looks {
    /// `light` comes along `way`, or not at all.
    fn look(&mut self, stand: &Stand<'_>, light: Vec3, way: Option<Way>) {
        let Some(way) = way else {
            self.is_any_blocked |= light != Vec3::ZERO;
            return;
        };
        (self.ways[self.count], self.light[self.count]) = (way, light);
        self.count += 1;
        if self.count == TOGETHER {
            self.finish(stand);
        }
    }

    /// Look along those that wait.
    fn finish(&mut self, stand: &Stand<'_>) {
        let open = stand.tracer.transmittances(&self.ways[..self.count]);
        for (&light, open) in self.light.iter().zip(open).take(self.count) {
            self.lit += light * open;
            self.is_any_open |= open > 0.0;
            self.is_any_blocked |= open < 1.0;
        }
        self.count = 0;
    }

    fn is_all_open(&self) -> bool {
        !self.is_any_blocked
    }
}
