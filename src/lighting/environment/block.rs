//! The environment's light at a block of receivers: each direction is looked along once for all of them.

use super::EnvironmentSet;
use super::set::EnvironmentCell;
use crate::lighting::stand::Stand;
use crate::lighting::{ShadePoint, in_blocks};
use crate::math::luminance;
use crate::trace::Tracer;
use glam::Vec3;

/// Most receivers of a block: one bit each.
pub(in crate::lighting) const MOST: usize = 64;

/// Light of the environment at a receiver.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SkyLight {
    /// Along unblocked directions, radiance·sr.
    pub irradiance: Vec3,
    /// Mean of the unblocked directions weighted by the luminance of the irradiance from there; of any length.
    pub direction: Vec3,
}

impl EnvironmentSet {
    /// Light from [`Self::importance`] alone at each of `points`: for engines that see the even part in another way.
    /// Nothing beyond `reach` hides it. Faster where neighbors follow each other. Black under an even sky, which has no
    /// such part.
    pub fn importance_light(
        &self,
        tracer: &Tracer,
        points: &[ShadePoint],
        reach: f32,
    ) -> Vec<SkyLight> {
        in_blocks(tracer, (points, reach), |stands| {
            light(self.importance(), stands)
        })
    }
}

/// Light of `cells` at each of `stands`, at most 64, near each other for speed.
pub(in crate::lighting) fn light(cells: &[EnvironmentCell], stands: &[Stand<'_>]) -> Vec<SkyLight> {
    assert!(stands.len() <= MOST, "a block holds at most 64 receivers");
    let mut sums = vec![SkyLight::default(); stands.len()];
    let mut packet = Packet::default();
    for cell in cells {
        packet.gather(cell, stands, &mut sums);
    }
    sums
}

/// Every n-th of `cells` at most, so that about so many are looked at.
const GLIMPSED: usize = 8;

/// Irradiance of `cells` at `stand` by a few of them, which `number` chooses: in the mean over all numbers that of
/// [`light`].
pub(in crate::lighting) fn glimpse(
    cells: &[EnvironmentCell],
    stand: &Stand<'_>,
    number: usize,
) -> Vec3 {
    let stride = (cells.len() / GLIMPSED).max(1);
    let chosen = cells.iter().skip(number % stride).step_by(stride);
    let lit = unblocked(chosen, stand).map(|(irradiance, _)| irradiance);
    stride as f32 * lit.sum::<Vec3>()
}

/// Irradiance of those of `cells` that `stand` sees, and the direction it comes from.
fn unblocked<'a>(
    cells: impl Iterator<Item = &'a EnvironmentCell>,
    stand: &Stand<'_>,
) -> impl Iterator<Item = (Vec3, Vec3)> {
    cells.filter_map(|cell| {
        let arrival = cell.arrival(stand.point.normal)?;
        let direction = arrival.bent.unwrap_or(cell.direction());
        (stand.sees_sky(direction)).then_some((arrival.irradiance, direction))
    })
}

impl SkyLight {
    /// One receiver on its own: the definition of [`light`].
    pub(in crate::lighting) fn at(set: &EnvironmentSet, stand: &Stand<'_>) -> Self {
        let mut sum = Self::default();
        for (irradiance, direction) in unblocked(set.cells().iter(), stand) {
            sum.add(irradiance, direction);
        }
        sum
    }

    fn add(&mut self, irradiance: Vec3, direction: Vec3) {
        self.irradiance += irradiance;
        self.direction += direction * luminance(irradiance);
    }
}

/// Receivers that look along one direction.
#[derive(Default)]
struct Packet {
    origins: Vec<Vec3>,
    /// Receiver and irradiance of each origin.
    waiting: Vec<(usize, Vec3)>,
}

impl Packet {
    fn gather(&mut self, cell: &EnvironmentCell, stands: &[Stand<'_>], sums: &mut [SkyLight]) {
        self.origins.clear();
        self.waiting.clear();
        for (i, stand) in stands.iter().enumerate() {
            let Some(arrival) = cell.arrival(stand.point.normal) else {
                continue;
            };
            if let Some(bent) = arrival.bent {
                if stand.sees_sky(bent) {
                    sums[i].add(arrival.irradiance, bent);
                }
            } else if let Some(start) = stand.start(cell.direction()) {
                self.origins.push(start);
                self.waiting.push((i, arrival.irradiance));
            }
        }
        let (Some(first), count) = (stands.first(), self.origins.len()) else {
            return;
        };
        if count == 0 {
            return;
        }
        let all = u64::MAX >> (MOST - count);
        let blocked =
            (first.tracer).occluded_along(cell.direction(), &self.origins, first.reach, all);
        for (k, &(i, irradiance)) in self.waiting.iter().enumerate() {
            if blocked >> k & 1 == 0 {
                sums[i].add(irradiance, cell.direction());
            }
        }
    }
}
