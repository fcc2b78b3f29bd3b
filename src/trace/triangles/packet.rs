//! The triangle test for rays of one direction: four triangles against a ray or a triangle against sixteen rays,
//! whichever takes fewer steps; the bits are those of [`super::Sheared::intersect`].

use super::{LEAF_SIZE, LocalHit, Sheared, Triangles};
use crate::trace::wide::{Column, LANES, Packet, ROWS, load, row_of};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, mask32x16, u32x16};

/// Up to this many rays of a leaf are tested against four triangles at a time, more with a triangle after the other.
/// Occlusion of a box and a displaced ball of 200 000 triangles: 3, 8, 16 rays take 89, 73 and 72 ns a ray.
const FEW: u32 = 8;
/// The same for closest hits, where every hit of the four has to be looked at: 3, 8, 16 rays take 91, 89 and 95 ns.
const FEW_CLOSEST: u32 = 4;

/// What the rays of a packet hit first, in the space of the triangles.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub(in crate::trace) struct PacketHits {
    /// Bit i is set where ray i hit something.
    pub(in crate::trace) found: u64,
    /// Edge functions as in [`super::Lanes`].
    v: Column<f32>,
    w: Column<f32>,
    sum: Column<f32>,
}

impl PacketHits {
    /// No hits.
    pub(in crate::trace) const NONE: Self = Self {
        found: 0,
        v: [[0.0; LANES]; ROWS],
        w: [[0.0; LANES]; ROWS],
        sum: [[0.0; LANES]; ROWS],
    };

    /// The hit of ray `i` of `packet`, which found one.
    #[inline(always)]
    pub(in crate::trace) fn get(&self, packet: &Packet, i: usize) -> LocalHit {
        let (row, lane) = (i / LANES, i % LANES);
        let sum = self.sum[row][lane];
        LocalHit {
            distance: packet.max_distance[row][lane],
            triangle: packet.before[row][lane],
            u: self.v[row][lane] / sum,
            v: self.w[row][lane] / sum,
            front: sum > 0.0,
        }
    }
}

impl Triangles {
    /// Takes the rays that hit anything out of `packet.active`.
    #[inline(always)]
    pub(in crate::trace) fn occluded_packet<S: Simd>(&self, simd: S, packet: &mut Packet) {
        (self.tree).traverse_packet(
            simd,
            packet,
            #[inline(always)]
            |leaf, lanes, packet| {
                let sheared = self.blocks[leaf.block].sheared(&packet.line);
                packet.active &= !if lanes.count_ones() <= FEW {
                    sheared.block_each(lanes, packet)
                } else {
                    sheared.block_rows(simd, leaf.count, lanes, packet)
                };
            },
        );
    }

    /// Finds what the active rays of `packet` hit first and shortens them to it.
    #[inline(always)]
    pub(in crate::trace) fn closest_packet<S: Simd>(
        &self,
        simd: S,
        packet: &mut Packet,
        hits: &mut PacketHits,
    ) {
        (self.tree).traverse_packet(
            simd,
            packet,
            #[inline(always)]
            |leaf, lanes, packet| {
                let sheared = self.blocks[leaf.block].sheared(&packet.line);
                let first = leaf.block * LEAF_SIZE;
                let indices = &self.tree.order[first..first + leaf.count];
                let nearer = if lanes.count_ones() <= FEW_CLOSEST {
                    sheared.shorten_each(indices, lanes, (packet, hits))
                } else {
                    sheared.shorten_rows(simd, indices, lanes, (packet, hits))
                };
                hits.found |= nearer;
                if nearer != 0 {
                    packet.limit(simd);
                }
            },
        );
    }
}

/// Twin of [`super::Lanes`]: one triangle, sixteen rays.
struct Tested<S: Simd> {
    v: f32x16<S>,
    w: f32x16<S>,
    sum: f32x16<S>,
    distance: f32x16<S>,
    hit: mask32x16<S>,
}

impl Sheared {
    /// Those of `lanes` that any triangle blocks, one ray after the other.
    #[inline(always)]
    fn block_each(&self, lanes: u64, packet: &Packet) -> u64 {
        let (mut blocked, mut rest) = (0, lanes);
        while rest != 0 {
            let i = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let (row, column) = (i / LANES, i % LANES);
            let tested = self.intersect(packet.place_of(i), packet.line.scale);
            let max_distance = packet.max_distance[row][column];
            let mut hit = false;
            for lane in 0..LEAF_SIZE {
                hit |= tested.hit[lane] & (tested.distance[lane] < max_distance);
            }
            blocked |= u64::from(hit) << i;
        }
        blocked
    }

    /// The same, sixteen rays at a time.
    #[inline(always)]
    fn block_rows<S: Simd>(&self, simd: S, count: usize, lanes: u64, packet: &Packet) -> u64 {
        let mut left = lanes;
        for triangle in 0..count {
            for row in 0..ROWS {
                let bits = row_of(left, row);
                if bits != 0
                    && let Some(tested) = self.test(simd, (triangle, row), bits, packet)
                {
                    let max_distance = load(simd, &packet.max_distance, row);
                    let hit = tested.hit & tested.distance.simd_lt(max_distance);
                    left &= !((hit.to_bitmask() & bits) << (row * LANES));
                }
            }
        }
        lanes & !left
    }

    /// Shortens those of `lanes` for which a hit of the triangles `indices` counts, one after the other; their bits.
    #[inline(always)]
    fn shorten_each(
        &self,
        indices: &[u32],
        lanes: u64,
        (packet, hits): (&mut Packet, &mut PacketHits),
    ) -> u64 {
        let (mut nearer, mut rest) = (0, lanes);
        while rest != 0 {
            let i = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let (row, column) = (i / LANES, i % LANES);
            let tested = self.intersect(packet.place_of(i), packet.line.scale);
            let end = (packet.max_distance[row][column], packet.before[row][column]);
            if let Some(lane) = tested.first(indices, end) {
                packet.max_distance[row][column] = tested.distance[lane];
                packet.before[row][column] = indices[lane];
                hits.v[row][column] = tested.v[lane];
                hits.w[row][column] = tested.w[lane];
                hits.sum[row][column] = tested.sum[lane];
                nearer |= 1 << i;
            }
        }
        nearer
    }

    /// The same, sixteen rays at a time.
    #[inline(always)]
    fn shorten_rows<S: Simd>(
        &self,
        simd: S,
        indices: &[u32],
        lanes: u64,
        (packet, hits): (&mut Packet, &mut PacketHits),
    ) -> u64 {
        let mut nearer = 0;
        for (triangle, &index) in indices.iter().enumerate() {
            for row in 0..ROWS {
                let bits = row_of(lanes, row);
                if bits != 0
                    && let Some(tested) = self.test(simd, (triangle, row), bits, packet)
                {
                    let lanes = tested.keep(simd, (row, bits), index, (packet, hits));
                    nearer |= lanes << (row * LANES);
                }
            }
        }
        nearer
    }

    /// One coordinate of the corners of triangle `triangle`, relative to `places`.
    #[inline(always)]
    fn corners<S: Simd>(
        &self,
        simd: S,
        corners: &[[f32; LEAF_SIZE]; 3],
        triangle: usize,
        places: f32x16<S>,
    ) -> [f32x16<S>; 3] {
        [
            f32x16::splat(simd, corners[0][triangle]) - places,
            f32x16::splat(simd, corners[1][triangle]) - places,
            f32x16::splat(simd, corners[2][triangle]) - places,
        ]
    }

    /// Triangle `triangle` against row `row` of `packet`; `None` if none of its rays `bits` is inside.
    #[inline(always)]
    fn test<S: Simd>(
        &self,
        simd: S,
        (triangle, row): (usize, usize),
        bits: u64,
        packet: &Packet,
    ) -> Option<Tested<S>> {
        let (px, py) = (
            load(simd, &packet.place[0], row),
            load(simd, &packet.place[1], row),
        );
        let x = self.corners(simd, &self.x, triangle, px);
        let y = self.corners(simd, &self.y, triangle, py);
        let u = x[2] * y[1] - y[2] * x[1];
        let v = x[0] * y[2] - y[0] * x[2];
        let w = x[1] * y[0] - y[1] * x[0];
        let zero = f32x16::splat(simd, 0.0);
        let least = u.min(v).min(w);
        let most = u.max(v).max(w);
        let inside = least.simd_ge(zero) | most.simd_le(zero);
        if inside.to_bitmask() & bits == 0 {
            return None;
        }
        let z = self.corners(
            simd,
            &self.depth,
            triangle,
            load(simd, &packet.place[2], row),
        );
        let sum = u + v + w;
        let distance = (u * z[0] + v * z[1] + w * z[2]) * packet.line.scale / sum;
        Some(Tested {
            v,
            w,
            sum,
            distance,
            hit: inside & distance.simd_gt(zero),
        })
    }
}

impl<S: Simd> Tested<S> {
    /// Shortens those of the rays `bits` of row `row` for which this hit of triangle `index` counts; their bits.
    #[inline(always)]
    fn keep(
        self,
        simd: S,
        (row, bits): (usize, u64),
        index: u32,
        (packet, hits): (&mut Packet, &mut PacketHits),
    ) -> u64 {
        let max = f32x16::from_slice(simd, &packet.max_distance[row]);
        let before = u32x16::from_slice(simd, &packet.before[row]);
        let ours = u32x16::splat(simd, index);
        let tie = self.distance.simd_eq(max) & ours.simd_lt(before);
        let nearer =
            self.hit & (self.distance.simd_lt(max) | tie) & mask32x16::from_bitmask(simd, bits);
        let lanes = nearer.to_bitmask();
        if lanes == 0 {
            return 0;
        }
        store(simd, nearer, self.distance, &mut packet.max_distance[row]);
        store(simd, nearer, self.v, &mut hits.v[row]);
        store(simd, nearer, self.w, &mut hits.w[row]);
        store(simd, nearer, self.sum, &mut hits.sum[row]);
        nearer
            .select(ours, before)
            .store_slice(&mut packet.before[row]);
        lanes
    }
}

#[inline(always)]
fn store<S: Simd>(simd: S, mask: mask32x16<S>, value: f32x16<S>, place: &mut [f32; LANES]) {
    (mask.select(value, f32x16::from_slice(simd, place))).store_slice(place);
}
