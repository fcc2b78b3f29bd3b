//! Receivers that share a cut.

use crate::receivers::Receivers;
use crate::trace::Tracer;
use glam::Vec3;
use std::ops::Range;

/// Most receivers of a group.
pub(super) const MOST: usize = 64;

/// Normals of a group are within 45° of that of its first receiver.
const LEAST_COSINE: f32 = 0.7;

/// Share of its radius that an element rises over a horizon before it counts as above: rounding lifts coplanar ones.
const RISE: f32 = 1e-4;

const LANES: usize = 16;

/// Neighbors turned to the same side, up to [`MOST`].
#[derive(Debug)]
pub(super) struct Group {
    pub(super) positions: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    /// Where rays start.
    pub(super) origins: Vec<Vec3>,
    pub(super) center: Vec3,
    /// Of a ball about `center` around all positions.
    pub(super) radius: f32,
    /// Positions and normals by component, the last receiver repeated.
    place: [[f32; MOST]; 3],
    normal: [[f32; MOST]; 3],
}

/// The receivers of `block` in groups of at most `most`, each in their order.
pub(super) fn alike(receivers: &Receivers, block: Range<usize>, most: usize) -> Vec<Vec<usize>> {
    let mut groups = Vec::new();
    let mut left: Vec<usize> = block.collect();
    while let Some(&first) = left.first() {
        let axis = receivers.normal[first];
        let is_alike = |i: &usize| *i == first || receivers.normal[*i].dot(axis) > LEAST_COSINE;
        let (group, rest): (Vec<usize>, Vec<usize>) = left.into_iter().partition(is_alike);
        groups.extend(group.chunks(most).map(<[usize]>::to_vec));
        left = rest;
    }
    groups
}

impl Group {
    /// Of `members` (1…[`MOST`]) of `receivers`.
    pub(super) fn new(tracer: &Tracer, receivers: &Receivers, members: &[usize]) -> Self {
        let pick = |column: &[Vec3]| -> Vec<Vec3> { members.iter().map(|&i| column[i]).collect() };
        let (positions, normals) = (pick(&receivers.position), pick(&receivers.normal));
        let lift = |&i: &usize| tracer.lift(receivers.position[i], receivers.rim_normal(i));
        let center = positions.iter().sum::<Vec3>() / positions.len() as f32;
        let distance = |p: &Vec3| p.distance(center);
        let last = positions.len() - 1;
        let by_component = |column: &[Vec3]| {
            [0, 1, 2].map(|axis| std::array::from_fn(|i| column[i.min(last)][axis]))
        };
        Self {
            origins: members.iter().map(lift).collect(),
            center,
            radius: positions.iter().map(distance).fold(0.0, f32::max),
            place: by_component(&positions),
            normal: by_component(&normals),
            positions,
            normals,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.positions.len()
    }

    /// Squared distance of `point` from the nearest receiver.
    #[inline(always)]
    pub(super) fn nearest_squared(&self, point: Vec3) -> f32 {
        let mut least = [f32::INFINITY; LANES];
        for row in (0..MOST).step_by(LANES) {
            for (lane, least) in least.iter_mut().enumerate() {
                let [x, y, z] = self.offset_to(row + lane, point);
                let squared = x * x + y * y + z * z;
                *least = if squared < *least { squared } else { *least };
            }
        }
        least.into_iter().fold(f32::INFINITY, f32::min)
    }

    /// True if part of a disk or, with a `normal` of length 0, of a ball lies above the horizon of some receiver.
    #[inline(always)]
    pub(super) fn is_above(&self, point: Vec3, normal: Vec3, radius: f32) -> bool {
        let mut most = [f32::NEG_INFINITY; LANES];
        for row in (0..MOST).step_by(LANES) {
            for (lane, most) in most.iter_mut().enumerate() {
                let i = row + lane;
                let [x, y, z] = self.offset_to(i, point);
                let n = [self.normal[0][i], self.normal[1][i], self.normal[2][i]];
                let cosine = n[0] * normal.x + n[1] * normal.y + n[2] * normal.z;
                let squared = 1.0 - cosine * cosine;
                let sine = if squared > 0.0 { squared.sqrt() } else { 0.0 };
                let top = n[0] * x + n[1] * y + n[2] * z + radius * sine;
                *most = if top > *most { top } else { *most };
            }
        }
        most.into_iter().fold(f32::NEG_INFINITY, f32::max) > RISE * radius
    }

    /// True if some receiver lies in front of the disk.
    #[inline(always)]
    pub(super) fn is_faced_by(&self, point: Vec3, normal: Vec3, radius: f32) -> bool {
        let mut most = [f32::NEG_INFINITY; LANES];
        for row in (0..MOST).step_by(LANES) {
            for (lane, most) in most.iter_mut().enumerate() {
                let [x, y, z] = self.offset_to(row + lane, point);
                let height = -(normal.x * x + normal.y * y + normal.z * z);
                *most = if height > *most { height } else { *most };
            }
        }
        most.into_iter().fold(f32::NEG_INFINITY, f32::max) > RISE * radius
    }

    /// Bits of receivers in front of the disk and within `reach` of its center.
    pub(super) fn within(&self, (point, normal, radius): (Vec3, Vec3, f32), reach: f32) -> u64 {
        let is_near = |&(_, place): &(usize, &Vec3)| {
            let offset = *place - point;
            offset.length_squared() < reach * reach && normal.dot(offset) > RISE * radius
        };
        let near = self.positions.iter().enumerate().filter(is_near);
        near.fold(0, |mask, (i, _)| mask | 1 << i)
    }

    #[inline(always)]
    fn offset_to(&self, i: usize, point: Vec3) -> [f32; 3] {
        [
            point.x - self.place[0][i],
            point.y - self.place[1][i],
            point.z - self.place[2][i],
        ]
    }
}
