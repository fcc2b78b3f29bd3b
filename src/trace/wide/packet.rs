//! Up to 64 rays of one direction through the tree at once.
//!
//! A node is made ready for the direction once, its children are compared with the box around all origins, and those that
//! remain with sixteen rays at a time.

use super::boxes::{Boxes, Stored};
use super::{LEAF, Leaf, Node, STACK_SIZE, WIDTH, Wide, put};
use crate::trace::ray::{FAR_MARGIN, Line, ORIGIN_MARGIN};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, mask32x16};

/// Rays of a packet.
pub(in crate::trace) const PACKET_SIZE: usize = LANES * ROWS;
/// Rays of one instruction.
pub(in crate::trace) const LANES: usize = 16;
/// Instructions of a packet.
pub(in crate::trace) const ROWS: usize = 4;
/// Up to this many rays are compared with the eight children of a node, more with one child after the other.
const FEW: u32 = 4;

/// A number for every ray.
pub(in crate::trace) type Column<T> = [[T; LANES]; ROWS];

/// Rays of one direction.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub(in crate::trace) struct Packet {
    pub(in crate::trace) line: Line,
    /// As in [`crate::trace::ray::Ray::place`].
    pub(in crate::trace) place: [Column<f64>; 3],
    pub(in crate::trace) max_distance: Column<f32>,
    pub(in crate::trace) before: Column<u32>,
    /// Bit i is set where ray i is still searching.
    pub(in crate::trace) active: u64,
    /// Distances of the origins from 0 along every axis.
    start: [Column<f32>; 3],
    /// The least and greatest of the rays that were active at first.
    range: [[f32; 3]; 2],
    /// What boxes grow by for roundings that depend on the origins.
    margin: f32,
    /// The largest of the distances.
    limit: f32,
}

/// Bits of row `row` of `lanes`.
#[inline(always)]
pub(in crate::trace) const fn row_of(lanes: u64, row: usize) -> u64 {
    lanes >> (row * LANES) & 0xffff
}

impl Packet {
    /// Rays from `origins` (per axis); those of `active` with finite origins are active. Distances are positive.
    #[inline(always)]
    pub(in crate::trace) fn new<S: Simd>(
        simd: S,
        line: Line,
        origins: &[Column<f32>; 3],
        (max_distance, before): (&Column<f32>, &Column<u32>),
        active: u64,
    ) -> Self {
        let mut packet = Self {
            line,
            place: [[[0.0; LANES]; ROWS]; 3],
            max_distance: *max_distance,
            before: *before,
            active: 0,
            start: [[[0.0; LANES]; ROWS]; 3],
            range: [[0.0; 3]; 2],
            margin: 0.0,
            limit: 0.0,
        };
        let all = f32x16::splat(simd, f32::INFINITY);
        let (mut low, mut high) = ([all; 3], [-all; 3]);
        let mut largest = f32x16::splat(simd, 0.0);
        for row in 0..ROWS {
            let bits = row_of(active, row);
            if bits == 0 {
                continue;
            }
            let x = load(simd, &origins[0], row);
            let y = load(simd, &origins[1], row);
            let z = load(simd, &origins[2], row);
            // 0 unless a number is not finite.
            let nothing = x * 0.0 + y * 0.0 + z * 0.0;
            let is_valid =
                mask32x16::from_bitmask(simd, bits) & nothing.simd_eq(f32x16::splat(simd, 0.0));
            packet.active |= is_valid.to_bitmask() << (row * LANES);
            let most = x.abs().max(y.abs()).max(z.abs());
            largest = is_valid.select(largest.max(most), largest);
            let origin = [x, y, z];
            for axis in 0..3 {
                let start = origin[axis] * line.inverse[axis];
                start.store_slice(&mut packet.start[axis][row]);
                low[axis] = is_valid.select(low[axis].min(start), low[axis]);
                high[axis] = is_valid.select(high[axis].max(start), high[axis]);
            }
            packet.put(row, origins);
        }
        for axis in 0..3 {
            packet.range[0][axis] = -most(-low[axis]);
            packet.range[1][axis] = most(high[axis]);
        }
        packet.margin = ORIGIN_MARGIN * most(largest);
        packet.limit(simd);
        packet
    }

    /// Shears the origins of row `row`: [`Line::place`] in plain loops over lanes.
    #[inline(always)]
    fn put(&mut self, row: usize, origins: &[Column<f32>; 3]) {
        let Line { axes, slope, .. } = self.line;
        let [x, y, z] = axes.map(|axis| &origins[axis][row]);
        for lane in 0..LANES {
            let depth = self.line.sign * f64::from(z[lane]);
            self.place[0][row][lane] = f64::from(x[lane]) - slope[0] * depth;
            self.place[1][row][lane] = f64::from(y[lane]) - slope[1] * depth;
            self.place[2][row][lane] = depth;
        }
    }

    /// Sheared origin of ray `i`.
    #[inline(always)]
    pub(in crate::trace) fn place_of(&self, i: usize) -> [f64; 3] {
        let (row, column) = (i / LANES, i % LANES);
        [
            self.place[0][row][column],
            self.place[1][row][column],
            self.place[2][row][column],
        ]
    }

    /// Where ray `i` ends: a distance, and the triangle before which others count at that distance.
    #[inline(always)]
    pub(in crate::trace) fn end_of(&self, i: usize) -> (f32, u32) {
        let (row, column) = (i / LANES, i % LANES);
        (self.max_distance[row][column], self.before[row][column])
    }

    /// Looks for the largest limit anew, after rays became shorter.
    #[inline(always)]
    pub(in crate::trace) fn limit<S: Simd>(&mut self, simd: S) {
        let zero = f32x16::splat(simd, 0.0);
        let mut largest = zero;
        for row in 0..ROWS {
            let is_active = mask32x16::from_bitmask(simd, row_of(self.active, row));
            largest = largest.max(is_active.select(load(simd, &self.max_distance, row), zero));
        }
        self.limit = most(largest) * FAR_MARGIN;
    }

    /// Those of `lanes` that may meet child `child` of `boxes`; as [`Boxes::meet`] for one ray.
    #[inline(always)]
    fn lanes_in<S: Simd>(&self, simd: S, lanes: u64, boxes: &Stored, child: usize) -> u64 {
        let mut inside = 0;
        for row in 0..ROWS {
            let bits = row_of(lanes, row);
            if bits == 0 {
                continue;
            }
            let mut near = f32x16::splat(simd, 0.0);
            let mut far = load(simd, &self.max_distance, row) * FAR_MARGIN;
            for axis in 0..3 {
                let start = load(simd, &self.start[axis], row);
                near = near.max(f32x16::splat(simd, boxes.enter[axis][child]) - start);
                far = far.min(f32x16::splat(simd, boxes.leave[axis][child]) - start);
            }
            inside |= (near.simd_le(far).to_bitmask() & bits) << (row * LANES);
        }
        inside
    }
}

#[inline(always)]
pub(in crate::trace) fn load<S: Simd>(simd: S, column: &Column<f32>, row: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &column[row])
}

/// Largest number of a vector.
#[inline(always)]
fn most<S: Simd>(vector: f32x16<S>) -> f32 {
    let lanes: [f32; LANES] = vector.into();
    let mut most = lanes[0];
    for lane in lanes {
        most = if lane > most { lane } else { most };
    }
    most
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    child: u32,
    near: f32,
    lanes: u64,
}

impl Wide {
    /// Calls `leaf` with the rays that may meet it, the children of a node in `ORDER`. `leaf` may take rays out of
    /// [`Packet::active`] and shorten them.
    #[inline(always)]
    pub(in crate::trace) fn traverse_packet<const ORDER: bool, S: Simd>(
        &self,
        simd: S,
        packet: &mut Packet,
        mut leaf: impl FnMut(Leaf, u64, &mut Packet),
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let root = Entry {
            child: 0,
            near: 0.0,
            lanes: packet.active,
        };
        let mut stack = [root; STACK_SIZE];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let entry = stack[top];
            let lanes = entry.lanes & packet.active;
            if lanes == 0 || entry.near > packet.limit {
                continue;
            }
            if entry.child & LEAF != 0 {
                leaf(Leaf::of(entry.child), lanes, packet);
                continue;
            }
            let node = &self.nodes[entry.child as usize];
            let (near, inside) = node.lanes_in_children(simd, lanes, packet);
            let first = top;
            for child in 0..WIDTH {
                if inside[child] != 0 {
                    let entry = Entry {
                        child: node.children[child],
                        near: near[child],
                        lanes: inside[child],
                    };
                    put::<ORDER, _>(&mut stack, first..top, entry, |entry| entry.near);
                    top += 1;
                }
            }
        }
    }
}

impl Node {
    /// Depth of every child's near end, and those of `lanes` that may meet it.
    #[inline(always)]
    fn lanes_in_children<S: Simd>(
        &self,
        simd: S,
        lanes: u64,
        packet: &Packet,
    ) -> ([f32; WIDTH], [u64; WIDTH]) {
        let boxes = Boxes::of(simd, self, &packet.line, packet.margin);
        let (near, mut children) = boxes.meet(simd, packet.range, packet.limit);
        let mut inside = [0; WIDTH];
        if lanes.count_ones() <= FEW {
            let mut rest = lanes;
            while rest != 0 {
                let lane = rest.trailing_zeros() as usize;
                let (row, column) = (lane / LANES, lane % LANES);
                let start = [
                    packet.start[0][row][column],
                    packet.start[1][row][column],
                    packet.start[2][row][column],
                ];
                let limit = packet.max_distance[row][column] * FAR_MARGIN;
                let (_, mut children) = boxes.meet(simd, [start; 2], limit);
                while children != 0 {
                    inside[children.trailing_zeros() as usize] |= 1 << lane;
                    children &= children - 1;
                }
                rest &= rest - 1;
            }
            return (near.into(), inside);
        }
        let stored = boxes.stored();
        while children != 0 {
            let child = children.trailing_zeros() as usize;
            inside[child] = packet.lanes_in(simd, lanes, &stored, child);
            children &= children - 1;
        }
        (near.into(), inside)
    }
}
