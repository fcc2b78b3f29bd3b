//! Rays between receivers of a group and surfels of a cluster: who sees how much of it.

use super::RasterEngine;
use super::group::{Disk, Group};
use crate::octree::LeafSurfels;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

/// Rays end this many radii above the surfel they are sent to: centers of clustered triangles lie below the surface.
const LIFT_RADII: f32 = 0.05;

/// Rays end this part of their way before their target.
const REACH: f32 = 0.9999;

/// Tries for each ray that is sent: what lies below the horizon or averted is no answer.
const TRIES: usize = 6;

/// Where rays to a surfel end.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub(super) struct Target {
    position: Vec3,
    normal: Vec3,
    /// Radiance, all channels added.
    brightness: f32,
}

/// Where rays to clusters end.
#[derive(Debug)]
pub(super) struct Targets {
    /// Of all surfels, in leaf order.
    all: Vec<Target>,
    /// Of one in [`RUN`] of them, which stand for large clusters and stay in the cache.
    few: Vec<Target>,
}

/// Surfels that one stands for.
const RUN: u32 = 8;

/// Clusters of fewer surfels are asked about all of them.
const LARGE: u32 = 8 * RUN;

impl Targets {
    pub(super) fn new(surfels: &LeafSurfels) -> Self {
        let target = |i: usize| Target {
            position: surfels.position(i) + surfels.normal(i) * (LIFT_RADII * surfels.radius(i)),
            normal: surfels.normal(i),
            brightness: surfels.reflected(i).element_sum(),
        };
        let all: Vec<Target> = (0..surfels.len()).into_par_iter().map(target).collect();
        let one_of = |(run, number): (&[Target], u32)| {
            // Equal steps would fall into step with the rows of a grid.
            run[mixed(number) as usize % run.len()]
        };
        let few = all.chunks_exact(RUN as usize).zip(0..).map(one_of);
        Self {
            few: few.collect(),
            all,
        }
    }

    /// What stands for `surfels`, in their order.
    fn of(&self, surfels: &Range<u32>) -> &[Target] {
        if surfels.len() < LARGE as usize {
            return &self.all[surfels.start as usize..surfels.end as usize];
        }
        let (start, end) = (surfels.start.div_ceil(RUN), surfels.end / RUN);
        &self.few[start as usize..end as usize]
    }
}

/// A member that looked at a cluster.
#[derive(Debug, Clone, Copy)]
struct Answer {
    member: u8,
    is_seen: bool,
    /// Brightness that it speaks for, over the mean of the cluster.
    weight: f32,
}

/// What members of a group were told about a cluster.
#[derive(Debug, Clone, Default)]
pub(super) struct Answers(Vec<Answer>);

impl Answers {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// What all agree on.
    pub(super) fn verdict(&self) -> Option<bool> {
        let first = self.0.first()?.is_seen;
        (self.0.iter())
            .all(|answer| answer.is_seen == first)
            .then_some(first)
    }

    /// Share that every member of `group` sees, by the plane that fits best through all answers.
    pub(super) fn fitted(&self, group: &Group) -> Fit {
        // Weight, x, y, seen; then their products about the means.
        let points = self.0.iter().map(|answer| {
            let seen = f32::from(u8::from(answer.is_seen));
            (answer.weight, group.across[answer.member as usize], seen)
        });
        let [mut total, mut x0, mut y0, mut s0] = [0.0_f32; 4];
        for (weight, [x, y], seen) in points.clone() {
            total += weight;
            x0 += weight * x;
            y0 += weight * y;
            s0 += weight * seen;
        }
        let [x0, y0, s0] = [x0, y0, s0].map(|sum| sum / total);
        let [mut xx, mut yy] = [RIDGE; 2];
        let [mut xy, mut xs, mut ys] = [0.0; 3];
        for (weight, [x, y], seen) in points {
            let (x, y, s) = (x - x0, y - y0, seen - s0);
            xx += weight * x * x;
            xy += weight * x * y;
            yy += weight * y * y;
            xs += weight * x * s;
            ys += weight * y * s;
        }
        let determinant = xx * yy - xy * xy;
        let slope = [
            (yy * xs - xy * ys) / determinant,
            (xx * ys - xy * xs) / determinant,
        ];
        Fit {
            level: s0 - slope[0] * x0 - slope[1] * y0,
            slope,
        }
    }
}

/// Answers at one radius from the group's center that a slope of 0 has by itself.
const RIDGE: f32 = 1.0;

/// A share that changes evenly across a group.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    level: f32,
    slope: [f32; 2],
}

impl Fit {
    /// At a member's place across its group.
    pub(super) fn at(&self, [x, y]: [f32; 2]) -> f32 {
        (self.level + self.slope[0] * x + self.slope[1] * y).clamp(0.0, 1.0)
    }
}

/// Surfels in leaf order, and their mean brightness.
pub(super) type Cluster<'a> = (&'a Range<u32>, f32);

/// Send `rays` between members of `group` (but those near to `left_out`) and bright surfels of a cluster.
pub(super) fn ask(
    engine: &RasterEngine<'_>,
    group: &Group,
    cluster: Cluster<'_>,
    (rays, left_out): (usize, Option<&Disk>),
) -> Answers {
    let mut answers = Answers(Vec::with_capacity(rays));
    more(engine, group, cluster, (rays, left_out), &mut answers);
    answers
}

/// As [`ask`], behind the `answers` that are there.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a few rays, at most 256 members"
)]
pub(super) fn more(
    engine: &RasterEngine<'_>,
    group: &Group,
    (surfels, mean): Cluster<'_>,
    (rays, left_out): (usize, Option<&Disk>),
    answers: &mut Answers,
) {
    let targets = engine.targets.of(surfels);
    let first = mixed(surfels.start ^ (answers.0.len() as u32) << 24);
    let mut sent = 0;
    for turn in 0..TRIES * rays {
        // Members and surfels alike are spread over the whole.
        let member = (first as usize + turn * group.len() / rays + turn / rays) % group.len();
        let part = (fraction(first) + turn as f32 * GOLDEN).fract();
        if left_out.is_some_and(|disk| group.is_near(member, disk)) {
            continue;
        }
        let target = pick(targets, part);
        // A visible dark surface does not speak for a bright one behind it: dim surfels are asked the less often.
        let brightness = target.brightness / mean;
        if brightness < fraction(mixed(first ^ turn as u32)) {
            continue;
        }
        if let Some(is_seen) = look(engine, (group, member), target) {
            answers.0.push(Answer {
                member: member as u8,
                is_seen,
                weight: brightness.max(1.0),
            });
            sent += 1;
            if sent == rays {
                break;
            }
        }
    }
}

/// Spreads surfels evenly, whatever the number of rays.
const GOLDEN: f32 = 0.618_034;

/// Whether a member of a group sees the front of a surfel; `None` if it lies below the horizon or averted.
fn look(
    engine: &RasterEngine<'_>,
    (group, member): (&Group, usize),
    target: &Target,
) -> Option<bool> {
    let offset = target.position - group.origins[member];
    if group.normals[member].dot(offset) <= 0.0 || target.normal.dot(offset) >= 0.0 {
        return None;
    }
    let distance = offset.length();
    let direction = offset / distance;
    let start = group.start(member, direction);
    Some(!(engine.tracer).occluded(start, direction, distance * REACH))
}

/// The one at `part` (0…1) of `targets`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "rounded down on purpose, at least 0, clamped"
)]
fn pick(targets: &[Target], part: f32) -> &Target {
    let place = (f64::from(part) * targets.len() as f64) as usize;
    &targets[place.min(targets.len() - 1)]
}

/// Of [0, 1].
fn fraction(bits: u32) -> f32 {
    bits as f32 / u32::MAX as f32
}

/// A well mixed number for `x` (the finalizer of `MurmurHash3`).
fn mixed(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x85EB_CA6B);
    let x = (x ^ (x >> 13)).wrapping_mul(0xC2B2_AE35);
    x ^ (x >> 16)
}
