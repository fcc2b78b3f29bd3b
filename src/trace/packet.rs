//! Rays of one direction against the scene, up to 64 at once: the same hits as one at a time, sooner.

use super::ray::Line;
use super::screens::MOST_OPEN;
use super::triangles::PacketHits;
use super::wide::{
    Column, FARTHEST_FIRST, LANES, NEAREST_FIRST, PACKET_SIZE, Packet, ROWS, load, row_of,
};
use super::{Hit, Occurrence, Tracer, end_of};
use crate::math::bits::bits_of;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, dispatch};
use glam::Vec3;

/// A packet in the world, and where its rays come from.
struct Query {
    origins: [Column<f32>; 3],
    packet: Packet,
}

impl Tracer {
    /// [`Self::occluded`] for up to 64 rays of one unit `direction`: bit i of the result is set where bit i of `active` is
    /// and the ray from `origins[i]` is blocked closer than `max_distance`. Fastest for origins that are neighbors.
    ///
    /// # Panics
    /// With more than 64 origins.
    pub fn occluded_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        max_distance: f32,
        active: u64,
    ) -> u64 {
        let mut blocked = self.solid_occluded_along(direction, origins, max_distance, active);
        if let Some(screens) = &self.screens {
            let mut layers = Vec::new();
            for i in bits_of(active & !blocked & mask_of(origins.len())) {
                let open = screens.pass((origins[i], direction), max_distance, &mut layers);
                blocked |= u64::from(open <= MOST_OPEN) << i;
            }
        }
        blocked
    }

    /// [`Self::occluded_along`] by surfaces that let nothing through.
    ///
    /// # Panics
    /// With more than 64 origins.
    pub fn solid_occluded_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        max_distance: f32,
        active: u64,
    ) -> u64 {
        dispatch!(self.level, simd => {
            match Query::new(simd, (direction, origins), max_distance, active) {
                Some(query) => self.find_any_of(simd, query),
                None => 0,
            }
        })
    }

    /// [`Self::closest`] for up to 64 rays of one unit `direction`: `hits[i]` becomes the first hit of the ray from
    /// `origins[i]`, or `None` without one or where bit i of `active` is not set. Fastest for origins that are neighbors.
    ///
    /// # Panics
    /// With more than 64 origins, or fewer hits than origins.
    pub fn closest_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        (max_distance, active): (f32, u64),
        hits: &mut [Option<Hit>],
    ) {
        self.solid_closest_along(direction, origins, (max_distance, active), hits);
        if let Some(screens) = &self.screens {
            let mut layers = Vec::new();
            for i in bits_of(active & mask_of(origins.len())) {
                let end = end_of(hits[i], max_distance);
                screens.pass((origins[i], direction), end, &mut layers);
                hits[i] = Self::hides_most(&layers, hits[i]);
            }
        }
    }

    /// [`Self::closest_along`] among surfaces that let nothing through.
    ///
    /// # Panics
    /// With more than 64 origins, or fewer hits than origins.
    pub fn solid_closest_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        (max_distance, active): (f32, u64),
        hits: &mut [Option<Hit>],
    ) {
        hits[..origins.len()].fill(None);
        dispatch!(self.level, simd => {
            if let Some(query) = Query::new(simd, (direction, origins), max_distance, active) {
                self.find_closest_of(simd, query, hits);
            }
        });
    }

    #[inline(always)]
    fn find_any_of<S: Simd>(&self, simd: S, mut query: Query) -> u64 {
        let (origins, packet) = (&query.origins, &mut query.packet);
        let asked = packet.active;
        self.world.triangles.occluded_packet(simd, packet);
        (self.top).traverse_packet::<FARTHEST_FIRST, S>(
            simd,
            packet,
            #[inline(always)]
            |leaf, lanes, packet| {
                for occurrence in self.occurrences_of(leaf) {
                    let lanes = lanes & packet.active;
                    let ends = (&packet.max_distance, &NONE_BEFORE);
                    let rays = (packet.line.direction, origins);
                    if let Some(mut local) = occurrence.local_packet(simd, rays, ends, lanes) {
                        let tested = local.active;
                        (self.shared[occurrence.mesh]).occluded_packet(simd, &mut local);
                        packet.active &= !(tested & !local.active);
                    }
                }
            },
        );
        asked & !packet.active
    }

    #[inline(always)]
    fn find_closest_of<S: Simd>(&self, simd: S, mut query: Query, hits: &mut [Option<Hit>]) {
        let (origins, packet) = (&query.origins, &mut query.packet);
        let mut found = PacketHits::NONE;
        (self.world.triangles).closest_packet(simd, packet, &mut found);
        for i in bits_of(found.found) {
            hits[i] = Some(self.world.resolve(found.get(packet, i)));
        }
        (self.top).traverse_packet::<NEAREST_FIRST, S>(
            simd,
            packet,
            #[inline(always)]
            |leaf, lanes, packet| {
                for occurrence in self.occurrences_of(leaf) {
                    let before = occurrence.before_column(hits);
                    let ends = (&packet.max_distance, &before);
                    let rays = (packet.line.direction, origins);
                    let Some(mut local) = occurrence.local_packet(simd, rays, ends, lanes) else {
                        continue;
                    };
                    let mut found = PacketHits::NONE;
                    (self.shared[occurrence.mesh]).closest_packet(simd, &mut local, &mut found);
                    for i in bits_of(found.found) {
                        let hit = found.get(&local, i);
                        packet.max_distance[i / LANES][i % LANES] = hit.distance;
                        hits[i] = Some(hit.of_prim(occurrence.prim, hit.triangle));
                    }
                    packet.limit(simd);
                }
            },
        );
    }
}

/// Bits of the first `count` rays.
fn mask_of(count: usize) -> u64 {
    if count < PACKET_SIZE {
        (1 << count) - 1
    } else {
        u64::MAX
    }
}

const NONE_BEFORE: Column<u32> = [[0; LANES]; ROWS];

impl Query {
    /// `None` where no ray can hit anything.
    #[inline(always)]
    fn new<S: Simd>(
        simd: S,
        (direction, places): (Vec3, &[Vec3]),
        max_distance: f32,
        active: u64,
    ) -> Option<Self> {
        assert!(
            places.len() <= PACKET_SIZE,
            "a packet holds at most 64 rays"
        );
        let line = Line::new(direction)?;
        if max_distance.is_nan() || max_distance <= 0.0 {
            return None;
        }
        let mut origins = [[[0.0; LANES]; ROWS]; 3];
        for (i, place) in places.iter().enumerate() {
            for (axis, column) in origins.iter_mut().enumerate() {
                column[i / LANES][i % LANES] = place[axis];
            }
        }
        let given = mask_of(places.len());
        let ends = ([[max_distance.min(f32::MAX); LANES]; ROWS], NONE_BEFORE);
        let packet = Packet::new(simd, line, &origins, (&ends.0, &ends.1), active & given);
        Some(Self { origins, packet })
    }
}

impl Occurrence {
    /// Rays `lanes` in object space, if there are any: twin of [`Self::local`].
    #[inline(always)]
    fn local_packet<S: Simd>(
        &self,
        simd: S,
        (direction, origins): (Vec3, &[Column<f32>; 3]),
        ends: (&Column<f32>, &Column<u32>),
        lanes: u64,
    ) -> Option<Packet> {
        if lanes == 0 {
            return None;
        }
        let line = Line::new(self.local_direction(direction))?;
        let mut places = [[[0.0; LANES]; ROWS]; 3];
        for row in (0..ROWS).filter(|&row| row_of(lanes, row) != 0) {
            let x = load(simd, &origins[0], row);
            let y = load(simd, &origins[1], row);
            let z = load(simd, &origins[2], row);
            for (place, [a, b, c, offset]) in places.iter_mut().zip(self.object_from_world) {
                (x * a + y * b + z * c + offset).store_slice(&mut place[row]);
            }
        }
        Some(Packet::new(simd, line, &places, ends, lanes))
    }

    /// [`Self::before`] for every ray.
    #[inline(always)]
    fn before_column(&self, hits: &[Option<Hit>]) -> Column<u32> {
        let mut before = NONE_BEFORE;
        for (i, hit) in hits.iter().enumerate().take(PACKET_SIZE) {
            before[i / LANES][i % LANES] = self.before(hit.map_or(0, |hit| hit.prim.0));
        }
        before
    }
}
