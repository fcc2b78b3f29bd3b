//! Receivers that share a cut.

use crate::math::{Bounds3, Frame};
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
    /// Where rays start, but for [`Self::start`].
    pub(super) origins: Vec<Vec3>,
    /// How far they are lifted there.
    lifts: Vec<f32>,
    pub(super) center: Vec3,
    /// Of a ball about `center` around all positions.
    pub(super) radius: f32,
    /// Places across the mean normal, about `center`, in units of `radius`.
    pub(super) across: Vec<[f32; 2]>,
    /// [`LANES`] receivers each.
    rows: usize,
    /// Positions and normals by component, the last receiver repeated.
    place: [[f32; MOST]; 3],
    normal: [[f32; MOST]; 3],
}

/// The receivers of `block` in groups of at most [`MOST`] within `max_radius` of each other's middle.
pub(super) fn alike(
    receivers: &Receivers,
    block: Range<usize>,
    max_radius: f32,
) -> Vec<Vec<usize>> {
    let mut groups = Vec::new();
    let mut left: Vec<usize> = block.collect();
    while let Some(&first) = left.first() {
        let axis = receivers.normal[first];
        let is_alike = |i: &usize| *i == first || receivers.normal[*i].dot(axis) > LEAST_COSINE;
        let (group, rest): (Vec<usize>, Vec<usize>) = left.into_iter().partition(is_alike);
        for members in group.chunks(MOST) {
            halve(
                &receivers.position,
                members.to_vec(),
                max_radius,
                &mut groups,
            );
        }
        left = rest;
    }
    groups
}

/// Cut `members` in two along their box's longest side until none is farther than `max_radius` from its center.
fn halve(
    positions: &[Vec3],
    mut members: Vec<usize>,
    max_radius: f32,
    groups: &mut Vec<Vec<usize>>,
) {
    let bounds = Bounds3::around(members.iter().map(|&i| positions[i]));
    if members.len() == 1 || 0.5 * bounds.diagonal() <= max_radius {
        groups.push(members);
        return;
    }
    let size = bounds.max - bounds.min;
    let axis = usize::from(size.y > size.x);
    let axis = if size.z > size[axis] { 2 } else { axis };
    let at = |i: usize| positions[i][axis];
    members.sort_by(|&a, &b| at(a).total_cmp(&at(b)).then(a.cmp(&b)));
    let upper = members.split_off(members.len() / 2);
    halve(positions, members, max_radius, groups);
    halve(positions, upper, max_radius, groups);
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
        let radius = positions.iter().map(distance).fold(0.0, f32::max);
        let mean = normals.iter().sum::<Vec3>().normalize_or(normals[0]);
        let frame = Frame::about(mean);
        let across = |p: &Vec3| {
            let offset = (*p - center) / radius.max(f32::MIN_POSITIVE);
            [offset.dot(frame.tangent), offset.dot(frame.bitangent)]
        };
        Self {
            across: positions.iter().map(across).collect(),
            origins: members.iter().map(lift).collect(),
            lifts: positions.iter().map(|&p| tracer.lift_height(p)).collect(),
            center,
            radius,
            rows: positions.len().div_ceil(LANES),
            place: by_component(&positions),
            normal: by_component(&normals),
            positions,
            normals,
        }
    }

    /// Where a ray of member `i` along the unit `direction` starts: a receiver on the edge of a room lies in the wall's
    /// plane, and whether it is on this side of it or that is a matter of rounding.
    pub(super) fn start(&self, i: usize, direction: Vec3) -> Vec3 {
        self.origins[i] + direction * self.lifts[i]
    }

    pub(super) fn len(&self) -> usize {
        self.positions.len()
    }

    /// Squared distance of `point` from the nearest receiver.
    #[inline(always)]
    pub(super) fn nearest_squared(&self, point: Vec3) -> f32 {
        let mut least = [f32::INFINITY; LANES];
        for row in (0..self.rows * LANES).step_by(LANES) {
            for (lane, least) in least.iter_mut().enumerate() {
                let [x, y, z] = self.offset_to(row + lane, point);
                let squared = x * x + y * y + z * z;
                *least = if squared < *least { squared } else { *least };
            }
        }
        least.into_iter().fold(f32::INFINITY, f32::min)
    }

    /// True if part of a slab lies above the horizon of some receiver: what is within `radius` of `center` and no farther
    /// than `height` from the plane through it across the unit `axis`. A disk has no height.
    #[inline(always)]
    pub(super) fn is_above(&self, center: Vec3, axis: Vec3, (radius, height): (f32, f32)) -> bool {
        let least = RISE * radius;
        let mut above = [false; LANES];
        for row in (0..self.rows * LANES).step_by(LANES) {
            for (lane, above) in above.iter_mut().enumerate() {
                let i = row + lane;
                let [x, y, z] = self.offset_to(i, center);
                let n = [self.normal[0][i], self.normal[1][i], self.normal[2][i]];
                let cosine = n[0] * axis.x + n[1] * axis.y + n[2] * axis.z;
                let squared = 1.0 - cosine * cosine;
                let sine = if squared > 0.0 { squared.sqrt() } else { 0.0 };
                let reach = height * cosine.abs() + radius * sine;
                let reach = if reach < radius { reach } else { radius };
                *above = n[0] * x + n[1] * y + n[2] * z + reach > least;
            }
            // Most of what is above is so for all.
            if above.contains(&true) {
                return true;
            }
        }
        false
    }

    /// True if some receiver lies in front of the disk.
    #[inline(always)]
    pub(super) fn is_faced_by(&self, point: Vec3, normal: Vec3, radius: f32) -> bool {
        let least = RISE * radius;
        let mut facing = [false; LANES];
        for row in (0..self.rows * LANES).step_by(LANES) {
            for (lane, facing) in facing.iter_mut().enumerate() {
                let [x, y, z] = self.offset_to(row + lane, point);
                *facing = -(normal.x * x + normal.y * y + normal.z * z) > least;
            }
            if facing.contains(&true) {
                return true;
            }
        }
        false
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
