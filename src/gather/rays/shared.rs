//! Rays in directions that all receivers share: packets of neighbors, one direction after the other.
//!
//! The set is fixed in the world, evenly spread over the sphere; a receiver takes those above its horizon and weighs them
//! by their cosine. Every receiver has the same set, so there are no seams, and what it sees does not depend on which
//! others are seen with it.

use super::stand::Stand;
use super::through::{Look, Sight};
use crate::gather::Hemisphere;
use crate::gather::radiance::Outgoing;
use crate::gather::ray_query::RayQuery;
use crate::math::bits::bits_of;
use crate::math::sequence;
use crate::receivers::Receivers;
use crate::trace::{Hit, Tracer};
use glam::{Mat3, Vec3};
use std::f32::consts::{PI, TAU};
use std::ops::Range;

/// Receivers of a packet.
pub(super) const PACKET: usize = 64;

/// Turns the spiral's axis away from those of walls and objects.
const TILT: Mat3 = Mat3::from_cols(
    Vec3::new(0.8, 0.0, 0.6),
    Vec3::new(0.36, 0.8, -0.48),
    Vec3::new(-0.48, 0.6, 0.64),
);

/// `count` unit directions over the sphere, turned by `turn` turns about the axis of their spiral.
pub(super) fn directions(count: u32, turn: f32) -> Vec<Vec3> {
    let turned = TILT * Mat3::from_rotation_z(TAU * turn.rem_euclid(1.0));
    (0..count)
        .map(|i| (turned * sequence::spiral_sphere(i, count)).normalize())
        .collect()
}

/// What neighbors are asked to look at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Looks<'a> {
    pub(super) look: Look<'a>,
    pub(super) directions: &'a [Vec3],
}

/// Up to [`PACKET`] receivers.
struct Packet {
    stands: Vec<Stand>,
    origins: Vec<Vec3>,
    /// How far they lie above the receivers.
    lifts: Vec<f32>,
    normals: Vec<Vec3>,
    /// Bits of receivers that mirror directions at their plane.
    mirroring: u64,
}

/// What each of a packet hits along one direction.
type Found = [Option<Hit>; PACKET];

/// What a packet sees along one direction.
#[derive(Debug, Clone, Copy)]
struct Along {
    /// Bits of the receivers that are turned towards it.
    facing: u64,
    /// Bits of those whose view is covered.
    covered: u64,
}

impl Looks<'_> {
    /// Hand what each receiver of `range` sees to `visit`, in turn.
    pub(super) fn see(
        &self,
        receivers: &Receivers,
        range: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    ) {
        let (mut hits, mut sights) = (Vec::new(), Vec::new());
        let mut found = [None; PACKET];
        for start in range.clone().step_by(PACKET) {
            let end = (start + PACKET).min(range.end);
            let packet = Packet::new(self.look.query, receivers, start..end);
            let count = end - start;
            hits.iter_mut().for_each(Vec::clear);
            hits.resize_with(count, Vec::new);
            if let Some(tracer) = self.look.query.screens() {
                self.see_through(tracer, &packet, &mut sights);
                for (i, sights) in sights.iter().enumerate().take(count) {
                    self.fill_sights((&packet, i), sights, scratch);
                    visit(start + i, scratch);
                }
                continue;
            }
            let along: Vec<_> = (self.directions.iter())
                .map(|&direction| self.along(&packet, direction, (&mut found, &mut hits)))
                .collect();
            for (i, hits) in hits.iter().enumerate() {
                self.fill((&packet, i), &along, hits, scratch);
                visit(start + i, scratch);
            }
        }
    }

    /// Sends a packet along `direction`; appends distance and radiance to the `hits` of those that are covered, if
    /// there is a source. `found` is room for what they hit.
    fn along(
        &self,
        packet: &Packet,
        direction: Vec3,
        (found, hits): (&mut Found, &mut [Vec<(f32, Outgoing)>]),
    ) -> Along {
        let facing = packet.facing(direction);
        let mirrored = packet.below_plane(direction) & facing;
        let straight = facing & !mirrored;
        let mut covered = 0;
        let Look {
            query,
            source,
            max_distance: max,
        } = self.look;
        if let Some(source) = source {
            query.closest_along(direction, &packet.origins, (max, straight), found);
            for i in bits_of(facing) {
                let (origin, own) = (packet.origins[i], packet.stands[i].above_horizon(direction));
                if mirrored >> i & 1 == 1 {
                    found[i] = query.closest(origin, own, max);
                }
                if let Some(hit) = found[i] {
                    covered |= 1 << i;
                    let lit = self.past_plane((packet, i), own, hit);
                    let light = lit.map(|hit| source.radiance(&hit, origin, own));
                    hits[i].push((hit.distance, light.unwrap_or(Outgoing::BLACK)));
                }
            }
        } else {
            let origins = &packet.origins;
            covered = query.occluded_along(direction, origins, max, straight);
            for i in bits_of(mirrored) {
                let own = packet.stands[i].above_horizon(direction);
                covered |= u64::from(query.occluded(origins[i], own, max)) << i;
            }
        }
        Along { facing, covered }
    }

    /// Where the light along `direction` comes from that receiver `i` sees covered by `hit`: what lies beyond, if the
    /// receiver lies in the plane of what was hit, as on the edge of a room whose walls are prims of their own. Whether it
    /// is on this side of it or that is a matter of rounding.
    fn past_plane(&self, (packet, i): (&Packet, usize), direction: Vec3, hit: Hit) -> Option<Hit> {
        let (from, lift) = (packet.origins[i], packet.lifts[i]);
        if hit.distance >= lift {
            return Some(hit);
        }
        let (start, max) = (from + direction * lift, self.look.max_distance - lift);
        let query = self.look.query;
        let beyond = match query.screens() {
            Some(tracer) => tracer.solid_closest(start, direction, max),
            None => query.closest(start, direction, max),
        }?;
        Some(Hit {
            distance: beyond.distance + lift,
            ..beyond
        })
    }

    /// Where there are surfaces that let light through: what each receiver sees along each direction that it is turned
    /// towards, into `sights`.
    fn see_through(&self, tracer: &Tracer, packet: &Packet, sights: &mut Vec<Vec<Sight>>) {
        sights.iter_mut().for_each(Vec::clear);
        if sights.len() < packet.stands.len() {
            sights.resize_with(packet.stands.len(), Vec::new);
        }
        let mut layers = Vec::new();
        for &direction in self.directions {
            let facing = packet.facing(direction);
            let mirrored = packet.below_plane(direction) & facing;
            let solid = self.behind(tracer, packet, (direction, facing, mirrored));
            for i in bits_of(facing) {
                let (origin, own) = (packet.origins[i], packet.stands[i].above_horizon(direction));
                let ray = (origin, own);
                sights[i].push(self.look.through(tracer, ray, solid[i], &mut layers));
            }
        }
    }

    /// What the receivers of `facing` see that lets nothing through, those of `mirrored` along directions of their own.
    fn behind(
        &self,
        tracer: &Tracer,
        packet: &Packet,
        (direction, facing, mirrored): (Vec3, u64, u64),
    ) -> [Sight; PACKET] {
        let mut sights = [Sight::NOTHING; PACKET];
        let (max, origins, straight) =
            (self.look.max_distance, &packet.origins, facing & !mirrored);
        let Some(source) = self.look.source else {
            let mut covered = tracer.solid_occluded_along(direction, origins, max, straight);
            for i in bits_of(mirrored) {
                let own = packet.stands[i].above_horizon(direction);
                covered |= u64::from(tracer.solid_occluded(origins[i], own, max)) << i;
            }
            for i in bits_of(covered) {
                sights[i] = Sight::covered(0.0, Outgoing::BLACK);
            }
            return sights;
        };
        let mut found = [None; PACKET];
        tracer.solid_closest_along(direction, origins, (max, straight), &mut found);
        for i in bits_of(facing) {
            let (origin, own) = (origins[i], packet.stands[i].above_horizon(direction));
            if mirrored >> i & 1 == 1 {
                found[i] = tracer.solid_closest(origin, own, max);
            }
            if let Some(hit) = found[i] {
                let lit = self.past_plane((packet, i), own, hit);
                let light = lit.map(|hit| source.radiance(&hit, origin, own));
                sights[i] = Sight::covered(hit.distance, light.unwrap_or(Outgoing::BLACK));
            }
        }
        sights
    }

    fn fill_sights(&self, (packet, i): (&Packet, usize), sights: &[Sight], seen: &mut Hemisphere) {
        seen.clear();
        let (normal, stand) = (packet.normals[i], packet.stands[i]);
        let facing = self.directions.iter().filter(|way| normal.dot(**way) > 0.0);
        for (&direction, sight) in facing.zip(sights) {
            seen.direction.push(stand.above_horizon(direction));
            seen.weight.push(normal.dot(direction));
            seen.coverage.push(sight.coverage);
            seen.distance.push(sight.distance);
            seen.reflected.push(sight.light.reflected);
            seen.emitted.push(sight.light.emitted);
        }
        normalize(seen);
    }

    fn fill(
        &self,
        (packet, i): (&Packet, usize),
        along: &[Along],
        hits: &[(f32, Outgoing)],
        seen: &mut Hemisphere,
    ) {
        seen.clear();
        let (normal, stand) = (packet.normals[i], packet.stands[i]);
        let facing = |along: &&Along| along.facing >> i & 1 == 1;
        let count = along.iter().filter(facing).count();
        seen.direction.reserve(count);
        seen.weight.reserve(count);
        seen.coverage.reserve(count);
        let rows = self.directions.iter().zip(along);
        for (&direction, along) in rows.filter(|(_, along)| facing(along)) {
            let covered = along.covered >> i & 1 == 1;
            seen.direction.push(stand.above_horizon(direction));
            seen.weight.push(normal.dot(direction));
            seen.coverage.push(if covered { 1.0 } else { 0.0 });
        }
        if self.look.source.is_some() {
            fill_light(hits, seen);
        } else {
            let distance = |&coverage: &f32| if coverage > 0.0 { 0.0 } else { f32::INFINITY };
            seen.distance.extend(seen.coverage.iter().map(distance));
            seen.reflected.resize(count, Vec3::ZERO);
            seen.emitted.resize(count, Vec3::ZERO);
        }
        normalize(seen);
    }
}

/// Weights that sum to π.
fn normalize(seen: &mut Hemisphere) {
    let scale = PI / seen.weight.iter().sum::<f32>();
    seen.weight.iter_mut().for_each(|weight| *weight *= scale);
}

/// Distances and light of what covers directions, in the order of the directions.
fn fill_light(hits: &[(f32, Outgoing)], seen: &mut Hemisphere) {
    let mut hits = hits.iter();
    for &coverage in &seen.coverage {
        let hit = if coverage > 0.0 { hits.next() } else { None };
        let &(distance, light) = hit.unwrap_or(&(f32::INFINITY, Outgoing::BLACK));
        seen.distance.push(distance);
        seen.reflected.push(light.reflected);
        seen.emitted.push(light.emitted);
    }
}

impl Packet {
    fn new(query: &dyn RayQuery, receivers: &Receivers, range: Range<usize>) -> Self {
        let stands: Vec<_> = range.clone().map(|i| Stand::of(receivers, i)).collect();
        let origins: Vec<Vec3> = (range.clone().zip(&stands))
            .map(|(i, stand)| query.lift(receivers.position[i], stand.lift))
            .collect();
        let positions = &receivers.position[range.clone()];
        let lift = |(origin, position): (&Vec3, &Vec3)| origin.distance(*position);
        let lifts = origins.iter().zip(positions).map(lift).collect();
        let mirroring = mask_of(&stands, |stand| stand.mirror.is_some());
        Self {
            stands,
            origins,
            lifts,
            normals: receivers.normal[range].to_vec(),
            mirroring,
        }
    }

    fn facing(&self, direction: Vec3) -> u64 {
        mask_of(&self.normals, |normal| normal.dot(direction) > 0.0)
    }

    /// Bits of receivers that mirror `direction`.
    fn below_plane(&self, direction: Vec3) -> u64 {
        if self.mirroring == 0 {
            return 0;
        }
        mask_of(&self.stands, |stand| {
            stand.mirror.is_some_and(|plane| plane.dot(direction) < 0.0)
        })
    }
}

fn mask_of<T>(items: &[T], is_set: impl Fn(&T) -> bool) -> u64 {
    (items.iter().enumerate()).fold(0, |mask, (i, item)| mask | u64::from(is_set(item)) << i)
}
