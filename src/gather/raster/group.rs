//! Receivers that share a cut.

use super::windows::{MOST, Window};
use crate::math::{Bounds3, Frame};
use crate::receivers::Receivers;
use crate::trace::Tracer;
use glam::Vec3;

/// Most receivers of the core of a group.
pub(super) const CORE: usize = 64;

/// Share of its radius that an element rises over a horizon before it counts as above: rounding lifts coplanar ones.
const RISE: f32 = 1e-4;

const LANES: usize = 16;

/// Rows of the largest group.
const ROWS: usize = MOST / LANES;

/// A surfel, and what is near to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Disk {
    pub(super) position: Vec3,
    pub(super) normal: Vec3,
    pub(super) radius: f32,
    /// Receivers in front of it within this distance are near.
    pub(super) reach: f32,
}

/// The members of a [`Window`].
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
    /// The first of them are the core, at most [`CORE`].
    pub(super) core: usize,
    /// Positions and normals by component, the last receiver repeated.
    rows: Vec<Row>,
    /// Boxes around the rows: lower and upper corner by component, the last one repeated.
    boxes: [[[f32; ROWS]; 3]; 2],
}

/// Some receivers by component.
#[derive(Debug)]
struct Row {
    place: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
}

impl Group {
    /// The members of `window`, out of `receivers`.
    pub(super) fn new(tracer: &Tracer, receivers: &Receivers, window: &Window) -> Self {
        let members = &window.members;
        let pick = |column: &[Vec3]| -> Vec<Vec3> { members.iter().map(|&i| column[i]).collect() };
        let (positions, normals) = (pick(&receivers.position), pick(&receivers.normal));
        let lift = |&i: &usize| tracer.lift(receivers.position[i], receivers.rim_normal(i));
        let center = window.center;
        let distance = |p: &Vec3| p.distance(center);
        let radius = positions.iter().map(distance).fold(0.0, f32::max);
        let mean = normals.iter().sum::<Vec3>().normalize_or(normals[0]);
        let frame = Frame::about(mean);
        let across = |p: &Vec3| {
            let offset = (*p - center) / radius.max(f32::MIN_POSITIVE);
            [offset.dot(frame.tangent), offset.dot(frame.bitangent)]
        };
        let rows = positions.chunks(LANES).zip(normals.chunks(LANES));
        Self {
            across: positions.iter().map(across).collect(),
            origins: members.iter().map(lift).collect(),
            lifts: positions.iter().map(|&p| tracer.lift_height(p)).collect(),
            center,
            radius,
            core: window.core,
            boxes: boxes(&positions),
            rows: rows
                .map(|(places, normals)| Row::new(places, normals))
                .collect(),
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

    /// Squared distance of `point` from the nearest receiver; a little less where rows of them have gaps.
    #[inline(always)]
    pub(super) fn nearest_squared(&self, point: Vec3) -> f32 {
        let mut squared = [0.0_f32; ROWS];
        let [lower, upper] = &self.boxes;
        for (axis, x) in point.to_array().into_iter().enumerate() {
            for lane in 0..ROWS {
                let below = lower[axis][lane] - x;
                let above = x - upper[axis][lane];
                let out = if below > above { below } else { above };
                let out = if out > 0.0 { out } else { 0.0 };
                squared[lane] += out * out;
            }
        }
        squared.into_iter().fold(f32::INFINITY, f32::min)
    }

    /// True if part of a slab lies above the horizon of some receiver: what is within `radius` of `center` and no farther
    /// than `height` from the plane through it across the unit `axis`. A disk has no height.
    #[inline(always)]
    pub(super) fn is_above(&self, center: Vec3, axis: Vec3, (radius, height): (f32, f32)) -> bool {
        let least = RISE * radius;
        let mut above = [false; LANES];
        for row in &self.rows {
            for (lane, above) in above.iter_mut().enumerate() {
                let [x, y, z] = row.offset_to(lane, center);
                let n = row.normal.map(|component| component[lane]);
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
        for row in &self.rows {
            for (lane, facing) in facing.iter_mut().enumerate() {
                let [x, y, z] = row.offset_to(lane, point);
                *facing = -(normal.x * x + normal.y * y + normal.z * z) > least;
            }
            if facing.contains(&true) {
                return true;
            }
        }
        false
    }

    /// True if member `i` is near to `disk`. It is the same in every group.
    #[inline(always)]
    pub(super) fn is_near(&self, i: usize, disk: &Disk) -> bool {
        let offset = self.positions[i] - disk.position;
        offset.length_squared() < disk.reach * disk.reach
            && disk.normal.dot(offset) > RISE * disk.radius
    }
}

impl Row {
    /// Of up to [`LANES`] receivers.
    fn new(places: &[Vec3], normals: &[Vec3]) -> Self {
        let last = places.len() - 1;
        let by_component = |column: &[Vec3]| {
            [0, 1, 2].map(|axis| std::array::from_fn(|i| column[i.min(last)][axis]))
        };
        Self {
            place: by_component(places),
            normal: by_component(normals),
        }
    }

    #[inline(always)]
    fn offset_to(&self, lane: usize, point: Vec3) -> [f32; 3] {
        [
            point.x - self.place[0][lane],
            point.y - self.place[1][lane],
            point.z - self.place[2][lane],
        ]
    }
}

/// Boxes around rows of `positions`.
fn boxes(positions: &[Vec3]) -> [[[f32; ROWS]; 3]; 2] {
    let around = |row: &[Vec3]| Bounds3::around(row.iter().copied());
    let rows: Vec<Bounds3> = positions.chunks(LANES).map(around).collect();
    let last = rows.len() - 1;
    let corner = |of: fn(&Bounds3) -> Vec3| {
        [0, 1, 2].map(|axis| std::array::from_fn(|i| of(&rows[i.min(last)])[axis]))
    };
    [corner(|row| row.min), corner(|row| row.max)]
}
