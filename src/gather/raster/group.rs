//! Receivers of a window that stand for all of it, and share a cut.

use super::windows::Window;
use crate::math::Bounds3;
use crate::receivers::Receivers;
use crate::trace::Tracer;
use glam::Vec3;

/// Most members of a group: one in each of so many cells across the window, as many along each side.
pub(super) const MOST: usize = SIDE * SIDE;
const SIDE: usize = 7;

/// Boxes around all of a window, as many along each side of it.
const BOXES: usize = BOX_SIDE * BOX_SIDE;
const BOX_SIDE: usize = 4;

/// Share of its radius that an element rises over a horizon before it counts as above: rounding lifts coplanar ones.
const RISE: f32 = 1e-4;

const LANES: usize = 16;

/// A surfel, and what is near to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Disk {
    pub(super) position: Vec3,
    pub(super) normal: Vec3,
    pub(super) radius: f32,
    /// Receivers in front of it within this distance are near.
    pub(super) reach: f32,
}

/// Members of a [`Window`] that are spread over it, at most [`MOST`].
#[derive(Debug)]
pub(super) struct Group {
    /// Their places in the window.
    pub(super) picked: Vec<usize>,
    pub(super) positions: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    /// Where rays start, but for [`Self::start`].
    pub(super) origins: Vec<Vec3>,
    /// How far they are lifted there.
    lifts: Vec<f32>,
    pub(super) center: Vec3,
    /// Of a ball about `center` around all of the window.
    pub(super) radius: f32,
    /// Places as [`Window::across`] has them.
    pub(super) across: Vec<[f32; 2]>,
    /// Positions and normals by component, the last receiver repeated.
    rows: Vec<Row>,
    /// Boxes around all of the window: lower and upper corner by component, one of them repeated.
    boxes: [[[f32; BOXES]; 3]; 2],
}

/// Some receivers by component.
#[derive(Debug)]
struct Row {
    place: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
}

impl Group {
    /// Out of the members of `window`, which are some of `receivers`.
    pub(super) fn new(tracer: &Tracer, receivers: &Receivers, window: &Window) -> Self {
        let grid = Grid::around(&window.across);
        let picked = grid.picks(&window.across);
        let members: Vec<usize> = picked.iter().map(|&k| window.members[k]).collect();
        let pick = |column: &[Vec3]| -> Vec<Vec3> { members.iter().map(|&i| column[i]).collect() };
        let (positions, normals) = (pick(&receivers.position), pick(&receivers.normal));
        let lift = |&i: &usize| tracer.lift(receivers.position[i], receivers.rim_normal(i));
        let rows = positions.chunks(LANES).zip(normals.chunks(LANES));
        let rows = rows.map(|(places, normals)| Row::new(places, normals));
        let mut boxes = [Bounds3::EMPTY; BOXES];
        for (&i, &place) in window.members.iter().zip(&window.across) {
            let own = &mut boxes[grid.cell(place, BOX_SIDE)];
            *own = own.union(Bounds3::around([receivers.position[i]]));
        }
        Self {
            across: picked.iter().map(|&k| window.across[k]).collect(),
            origins: members.iter().map(lift).collect(),
            lifts: positions.iter().map(|&p| tracer.lift_height(p)).collect(),
            center: window.center,
            radius: window.radius,
            boxes: by_component(&boxes),
            rows: rows.collect(),
            picked,
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

    /// Squared distance of `point` from the nearest receiver of the window; a little less where they have gaps.
    #[inline(always)]
    pub(super) fn nearest_squared(&self, point: Vec3) -> f32 {
        let mut squared = [0.0_f32; BOXES];
        let [lower, upper] = &self.boxes;
        for (axis, x) in point.to_array().into_iter().enumerate() {
            for lane in 0..BOXES {
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

/// Corners of `boxes` by component, an empty one as some other.
fn by_component(boxes: &[Bounds3; BOXES]) -> [[[f32; BOXES]; 3]; 2] {
    let some = boxes.iter().find(|bounds| !bounds.is_empty());
    let filled = boxes.map(|bounds| match some {
        Some(&other) if bounds.is_empty() => other,
        _ => bounds,
    });
    let corner = |of: fn(&Bounds3) -> Vec3| {
        [0, 1, 2].map(|axis| std::array::from_fn(|i| of(&filled[i])[axis]))
    };
    [corner(|bounds| bounds.min), corner(|bounds| bounds.max)]
}

/// Cells across a window.
struct Grid {
    min: [f32; 2],
    size: [f32; 2],
}

impl Grid {
    fn around(across: &[[f32; 2]]) -> Self {
        let along = |axis: usize| across.iter().map(move |place| place[axis]);
        let least = |axis| along(axis).fold(f32::INFINITY, f32::min);
        let most = |axis| along(axis).fold(f32::NEG_INFINITY, f32::max);
        let min = [least(0), least(1)];
        Self {
            min,
            size: [most(0) - min[0], most(1) - min[1]].map(|size| size.max(f32::MIN_POSITIVE)),
        }
    }

    /// Column or row of `place` along `axis`, of `side` of them, with a fraction.
    fn steps(&self, place: [f32; 2], side: usize) -> [f32; 2] {
        [0, 1].map(|axis| (place[axis] - self.min[axis]) / self.size[axis] * side as f32)
    }

    /// The cell of `place`, of `side`².
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "rounded down on purpose, at least 0"
    )]
    fn cell(&self, place: [f32; 2], side: usize) -> usize {
        let [column, row] = self
            .steps(place, side)
            .map(|step| (step as usize).min(side - 1));
        column + side * row
    }

    /// Of all places those nearest to the middle of each cell, of [`MOST`].
    fn picks(&self, across: &[[f32; 2]]) -> Vec<usize> {
        let mut nearest: [Option<(f32, usize)>; MOST] = [None; MOST];
        for (k, &place) in across.iter().enumerate() {
            let cell = self.cell(place, SIDE);
            let [x, y] = self.steps(place, SIDE);
            let (x, y) = (
                x - (cell % SIDE) as f32 - 0.5,
                y - (cell / SIDE) as f32 - 0.5,
            );
            let off = x * x + y * y;
            if nearest[cell].is_none_or(|(known, _)| off < known) {
                nearest[cell] = Some((off, k));
            }
        }
        nearest.into_iter().flatten().map(|(_, k)| k).collect()
    }
}
