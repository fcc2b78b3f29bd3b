//! The environment's light at a block of receivers: each direction is looked along once for all of them.

use super::EnvironmentSet;
use super::set::EnvironmentCell;
use crate::lighting::stand::Stand;
use crate::lighting::{ShadePoint, in_blocks};
use crate::math::{Frame, luminance, sequence};
use crate::trace::{Layer, Tracer};
use glam::{Vec2, Vec3};

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

/// Cells looked at in a glimpse, those of much light more often than others.
const GLIMPSED: u32 = 8;

/// From one place to the next, which fills the unit square evenly: powers of one over the plastic number.
const STEP: Vec2 = Vec2::new(0.754_877_7, 0.569_840_3);

/// As many rays above the horizon of an even sky.
const GLIMPSED_EVEN: u32 = 4;

/// Irradiance of the sky at `stand` by a place in a few cells, which `number` chooses: in the mean over all numbers that of
/// the whole sky, without the steps that fixed directions leave in shadows. No place tells more than its share of all light,
/// so that none stands out.
pub(in crate::lighting) fn glimpse(set: &EnvironmentSet, stand: &Stand<'_>, number: u32) -> Vec3 {
    let (shift, first) = (
        sequence::sobol_owen(0, !number).x,
        sequence::sobol_owen(0, number),
    );
    let lit = (0..GLIMPSED).filter_map(|i| {
        let (cell, share) = set.cell_at((i as f32 + shift) / GLIMPSED as f32)?;
        let place = (first + i as f32 * STEP).fract();
        let (direction, irradiance) = cell.part_at(place, stand.point.normal)?;
        Some(irradiance * (stand.sees_sky(direction) / share))
    });
    lit.sum::<Vec3>() / GLIMPSED as f32
}

/// Part of the cosine-weighted hemisphere over `stand` that is open, 0…1, by a few rays which `number` chooses: in the mean
/// over all numbers the truth.
pub(in crate::lighting) fn glimpse_even(stand: &Stand<'_>, number: u32) -> f32 {
    let frame = Frame::about(stand.point.normal);
    let open = |i: u32| {
        let local = sequence::cosine_hemisphere(sequence::sobol_owen(i, number));
        stand.sees_sky(frame.to_world(local))
    };
    (0..GLIMPSED_EVEN).map(open).sum::<f32>() / GLIMPSED_EVEN as f32
}

/// Irradiance of those of `cells` that `stand` sees, and the direction it comes from.
fn unblocked<'a>(
    cells: impl Iterator<Item = &'a EnvironmentCell>,
    stand: &Stand<'_>,
) -> impl Iterator<Item = (Vec3, Vec3)> {
    cells.filter_map(|cell| {
        let arrival = cell.arrival(stand.point.normal)?;
        let direction = arrival.bent.unwrap_or(cell.direction());
        let open = stand.sees_sky(direction);
        (open > 0.0).then_some((arrival.irradiance * open, direction))
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
    layers: Vec<Layer>,
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
                let open = stand.sees_sky(bent);
                if open > 0.0 {
                    sums[i].add(arrival.irradiance * open, bent);
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
        let (tracer, direction) = (first.tracer, cell.direction());
        let blocked = tracer.solid_occluded_along(direction, &self.origins, first.reach, all);
        for (k, &(i, irradiance)) in self.waiting.iter().enumerate() {
            if blocked >> k & 1 == 0 {
                let ray = (self.origins[k], direction);
                let open = tracer.layers(ray, first.reach, &mut self.layers);
                sums[i].add(irradiance * open, direction);
            }
        }
    }
}
