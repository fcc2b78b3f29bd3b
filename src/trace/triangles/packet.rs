//! The triangle test for rays of one direction: four triangles against a ray or a triangle against eight rays,
//! whichever takes fewer steps; the bits are the same.

use super::{LEAF_SIZE, LocalHit, Met, Sheared, Triangles, counts, single_precision};
use crate::math::bits::bits_of;
use crate::trace::wide::{Column, FARTHEST_FIRST, LANES, NEAREST_FIRST, PACKET_SIZE, Packet, ROWS};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f64x4, f64x8};

/// Up to this many rays of a leaf are tested against four triangles at a time, more with a triangle after the other.
/// Occlusion on the bunny: 3, 8, 16, 32, all rays take 80, 72, 69, 67, 67 ns a ray; three boxes of 36 triangles, whose
/// leaves are met by whole packets: 32, all rays 12, 13 ns.
const FEW: u32 = 32;
/// The same for closest hits: 2, 4, 8, 24, all rays take 129, 119, 106, 102, 101 ns; the three boxes 23 or 26 ns.
const FEW_CLOSEST: u32 = 24;
/// Rays that are tested against a triangle at a time.
const RAYS: usize = 8;

/// What the rays of a packet hit first, in the space of the triangles.
#[derive(Debug, Clone)]
#[repr(align(64))]
pub(in crate::trace) struct PacketHits {
    /// Bit i is set where ray i hit something.
    pub(in crate::trace) found: u64,
    /// Bit i is set where it was seen counter-clockwise.
    front: u64,
    /// As in [`LocalHit`].
    u: Column<f32>,
    v: Column<f32>,
}

impl PacketHits {
    /// No hits.
    pub(in crate::trace) const NONE: Self = Self {
        found: 0,
        front: 0,
        u: [[0.0; LANES]; ROWS],
        v: [[0.0; LANES]; ROWS],
    };

    /// The hit of ray `i` of `packet`, which found one.
    #[inline(always)]
    pub(in crate::trace) fn get(&self, packet: &Packet, i: usize) -> LocalHit {
        let (row, lane) = (i / LANES, i % LANES);
        LocalHit {
            distance: packet.max_distance[row][lane],
            triangle: packet.before[row][lane],
            u: self.u[row][lane],
            v: self.v[row][lane],
            front: self.front >> i & 1 == 1,
        }
    }

    /// Keeps `hit` of ray `i`, which it shortens.
    #[inline(always)]
    fn keep(&mut self, packet: &mut Packet, i: usize, hit: LocalHit) {
        let (row, lane) = (i / LANES, i % LANES);
        packet.max_distance[row][lane] = hit.distance;
        packet.before[row][lane] = hit.triangle;
        self.u[row][lane] = hit.u;
        self.v[row][lane] = hit.v;
        self.front = self.front & !(1 << i) | u64::from(hit.front) << i;
        self.found |= 1 << i;
    }
}

impl Triangles {
    /// Takes the rays that hit anything out of `packet.active`.
    #[inline(always)]
    pub(in crate::trace) fn occluded_packet<S: Simd>(&self, simd: S, packet: &mut Packet) {
        (self.tree).traverse_packet::<FARTHEST_FIRST, S>(
            simd,
            packet,
            #[inline(always)]
            |leaf, lanes, packet| {
                let sheared = self.blocks[leaf.block].sheared(simd, &packet.line);
                packet.active &= !if lanes.count_ones() <= FEW {
                    sheared.block_each(simd, lanes, packet)
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
        (self.tree).traverse_packet::<NEAREST_FIRST, S>(
            simd,
            packet,
            #[inline(always)]
            |leaf, lanes, packet| {
                let sheared = self.blocks[leaf.block].sheared(simd, &packet.line);
                let first = leaf.block * LEAF_SIZE;
                let indices = &self.tree.order[first..first + leaf.count];
                let nearer = if lanes.count_ones() <= FEW_CLOSEST {
                    sheared.shorten_each(simd, indices, lanes, (packet, hits))
                } else {
                    sheared.shorten_rows(simd, indices, lanes, (packet, hits))
                };
                if nearer {
                    packet.limit(simd);
                }
            },
        );
    }
}

impl<S: Simd> Sheared<S> {
    /// Those of `lanes` that any triangle blocks, one ray after the other.
    #[inline(always)]
    fn block_each(&self, simd: S, lanes: u64, packet: &Packet) -> u64 {
        let mut blocked = 0;
        for i in bits_of(lanes) {
            if let Some(met) = self.meet(simd, packet.place_of(i), packet.line.scale) {
                let max_distance = packet.max_distance[i / LANES][i % LANES];
                blocked |= u64::from(met.any_before(max_distance)) << i;
            }
        }
        blocked
    }

    /// The same, eight rays at a time.
    #[inline(always)]
    fn block_rows(&self, simd: S, count: usize, lanes: u64, packet: &Packet) -> u64 {
        let mut left = lanes;
        for triangle in 0..count {
            for first in (0..PACKET_SIZE).step_by(RAYS) {
                let bits = left >> first & 0xff;
                if bits == 0 {
                    continue;
                }
                let Some(met) = self.meet_rays(simd, (triangle, first), packet) else {
                    continue;
                };
                let distance = met.distances();
                for k in bits_of(met.inside & bits) {
                    let i = first + k;
                    let max_distance = packet.max_distance[i / LANES][i % LANES];
                    let hit = 0.0 < distance[k] && distance[k] < max_distance;
                    left &= !(u64::from(hit) << i);
                }
            }
        }
        lanes & !left
    }

    /// Shortens those of `lanes` for which a hit of the triangles `indices` counts, one after the other; true if any.
    #[inline(always)]
    fn shorten_each(
        &self,
        simd: S,
        indices: &[u32],
        lanes: u64,
        (packet, hits): (&mut Packet, &mut PacketHits),
    ) -> bool {
        let mut nearer = false;
        for i in bits_of(lanes) {
            let Some(met) = self.meet(simd, packet.place_of(i), packet.line.scale) else {
                continue;
            };
            if let Some(hit) = met.first(indices, packet.end_of(i)) {
                hits.keep(packet, i, hit);
                nearer = true;
            }
        }
        nearer
    }

    /// The same, eight rays at a time.
    #[inline(always)]
    fn shorten_rows(
        &self,
        simd: S,
        indices: &[u32],
        lanes: u64,
        (packet, hits): (&mut Packet, &mut PacketHits),
    ) -> bool {
        let mut nearer = false;
        for (triangle, &index) in indices.iter().enumerate() {
            for first in (0..PACKET_SIZE).step_by(RAYS) {
                let bits = lanes >> first & 0xff;
                if bits == 0 {
                    continue;
                }
                let Some(met) = self.meet_rays(simd, (triangle, first), packet) else {
                    continue;
                };
                let distances = met.distances();
                for k in bits_of(met.inside & bits) {
                    if counts((distances[k], index), packet.end_of(first + k)) {
                        hits.keep(packet, first + k, met.hit(k, distances[k], index));
                        nearer = true;
                    }
                }
            }
        }
        nearer
    }

    /// Triangle `triangle` against the rays from `first` on; `None` if it meets none.
    #[inline(always)]
    fn meet_rays(
        &self,
        simd: S,
        (triangle, first): (usize, usize),
        packet: &Packet,
    ) -> Option<Met<f64x8<S>>> {
        let sides = (
            less_rays(simd, &self.x, triangle, (&packet.place[0], first)),
            less_rays(simd, &self.y, triangle, (&packet.place[1], first)),
        );
        Met::of(
            simd,
            sides,
            #[inline(always)]
            || less_rays(simd, &self.depth, triangle, (&packet.place[2], first)),
            packet.line.scale,
        )
    }
}

/// Coordinates of the corners of triangle `triangle` relative to those of rays from `first` on.
#[inline(always)]
fn less_rays<S: Simd>(
    simd: S,
    corners: &[f64x4<S>; 3],
    triangle: usize,
    (places, first): (&Column<f64>, usize),
) -> [f64x8<S>; 3] {
    let (row, lane) = (first / LANES, first % LANES);
    let places = f64x8::from_slice(simd, &places[row][lane..lane + RAYS]);
    [
        f64x8::splat(simd, corners[0][triangle]) - places,
        f64x8::splat(simd, corners[1][triangle]) - places,
        f64x8::splat(simd, corners[2][triangle]) - places,
    ]
}

impl<S: Simd> Met<f64x8<S>> {
    #[inline(always)]
    fn distances(&self) -> [f32; RAYS] {
        let mut distances = [0.0; RAYS];
        for (lane, distance) in distances.iter_mut().enumerate() {
            *distance = single_precision(self.distance[lane]);
        }
        distances
    }
}
