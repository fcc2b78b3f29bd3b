//! What a group of receivers sees of the octree: areas in full view, areas partly hidden, surfels that are near.

use super::RasterEngine;
use super::group::Group;
use super::transport::Area;
use crate::octree::{Node, NodeKind};
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};
use std::ops::Range;

/// Surfels closer than this many of their radii are seen by short rays.
pub(super) const NEAR_RADII: f32 = 3.0;

/// Clusters closer than this many of their radii are opened.
const OPENED_RADII: f32 = 1.5;

/// Rays end this many radii above the surfel they are sent to: centers of clustered triangles lie below the surface.
const LIFT_RADII: f32 = 0.05;

/// Rays end this part of their way before their target.
const REACH: f32 = 0.9999;

/// An area that part of a group does not see.
#[derive(Debug)]
pub(super) struct Doubtful {
    area: Area,
    surfels: Range<u32>,
    /// Share of its light that the group sees, a channel each.
    share: Vec3,
    /// Bits of receivers that see it by short rays.
    near: u64,
}

/// The cut of a group.
#[derive(Debug, Default)]
pub(super) struct Cut {
    pub(super) seen: Vec<Area>,
    pub(super) doubtful: Vec<Doubtful>,
    /// Surfels by their place in leaf order, and the receivers that they are near to.
    pub(super) near: Vec<(u32, u64)>,
}

/// Cut the octree for `group`.
#[inline(always)]
pub(super) fn find(engine: &RasterEngine<'_>, group: &Group) -> Cut {
    let mut cut = Cut::default();
    let mut pending = vec![(0_usize, false)];
    if engine.octree.node_count() == 0 {
        return cut;
    }
    while let Some((index, is_seen)) = pending.pop() {
        let node = &engine.octree.node(index);
        if is_dark(node, group) {
            continue;
        }
        let squared = group.nearest_squared(node.center);
        if squared.sqrt() - node.radius > engine.knobs.max_distance {
            continue;
        }
        let solid_angle = node.area.max(node.extent_area()) / squared;
        let is_outside = squared > (OPENED_RADII * node.radius).powi(2);
        let (mut share, mut has_answer) = (Vec3::ONE, is_seen);
        if !is_seen && is_outside && solid_angle <= engine.knobs.max_asked {
            let mean = node.reflected_power.element_sum() / (PI * node.area);
            let answer = ask(engine, group, (&engine.surfels[index], mean), 0);
            has_answer = answer.is_some();
            share = answer.unwrap_or(Vec3::ONE);
            if share == Vec3::ZERO {
                continue;
            }
        }
        if is_outside && solid_angle <= engine.knobs.max_solid_angle {
            // Without an answer all of it is below the horizons but for what no ray met.
            if let Some(area) = area_of(engine, node, group.center).filter(|_| has_answer) {
                cut.add(area, share, (engine.surfels[index].clone(), 0));
            }
            continue;
        }
        // Doubt about a cluster is doubt about each of its parts.
        let is_seen = share == Vec3::ONE && has_answer;
        match node.kind() {
            NodeKind::Inner(children) => pending.extend(children.map(|child| (child, is_seen))),
            NodeKind::Leaf(surfels) => {
                for surfel in surfels {
                    cut.add_surfel(engine, group, (surfel, is_seen));
                }
            }
        }
    }
    cut
}

impl Cut {
    fn add(&mut self, area: Area, share: Vec3, (surfels, near): (Range<u32>, u64)) {
        if share == Vec3::ONE && near == 0 {
            self.seen.push(area);
        } else {
            self.doubtful.push(Doubtful {
                area,
                surfels,
                share,
                near,
            });
        }
    }

    #[inline(always)]
    fn add_surfel(
        &mut self,
        engine: &RasterEngine<'_>,
        group: &Group,
        (i, is_seen): (usize, bool),
    ) {
        let surfels = engine.octree.surfels();
        let disk = (surfels.position(i), surfels.normal(i), surfels.radius(i));
        let (position, normal, radius) = disk;
        if surfels.reflected(i) == Vec3::ZERO
            || !group.is_above(position, normal, radius)
            || !group.is_faced_by(position, normal, radius)
        {
            return;
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "surfels have 32-bit numbers"
        )]
        let place = i as u32;
        let reach = engine.knobs.near_radii * radius;
        let mut near = 0;
        if group.nearest_squared(position) < reach * reach {
            near = group.within(disk, reach);
            if near != 0 {
                self.near.push((place, near));
            }
        }
        let share = if is_seen {
            Some(Vec3::ONE)
        } else {
            let mean = surfels.reflected(i).element_sum();
            ask(engine, group, (&(place..place + 1), mean), near)
        };
        if let Some(share) = share.filter(|&share| share != Vec3::ZERO) {
            let area = Area {
                position,
                normal,
                area: surfels.area(i),
                light: surfels.reflected(i),
            };
            self.add(area, share, (place..place + 1, near));
        }
    }
}

/// True if nothing of `node` sends light to any receiver.
#[inline(always)]
fn is_dark(node: &Node, group: &Group) -> bool {
    if node.reflected_power == Vec3::ZERO || !group.is_above(node.center, Vec3::ZERO, node.radius) {
        return true;
    }
    let offset = group.center - node.center;
    let (distance, around) = (offset.length(), node.radius + group.radius);
    distance > around
        && offset.angle_between(node.normal) - node.spread - (around / distance).asin() >= FRAC_PI_2
}

/// `node` as one area.
fn area_of(engine: &RasterEngine<'_>, node: &Node, viewer: Vec3) -> Option<Area> {
    let toward = (viewer - node.center).try_normalize()?;
    if node.is_flat() {
        let light = node.reflected_power / (PI * node.area);
        return (node.area > 0.0).then_some(Area {
            position: node.center,
            normal: node.normal,
            area: node.facing_area,
            light,
        });
    }
    let seen = engine.octree.appearance(node, toward)?;
    Some(Area {
        position: node.center,
        normal: Vec3::ZERO,
        area: seen.projected_area,
        light: seen.reflected,
    })
}

/// Rays tried for each that is sent.
const TRIES: usize = 6;

/// Share of the light of `surfels` (of `mean` radiance, all channels added) that members of `group` see, those of `left_out` not asked; exactly 1 if all do.
/// `None` if all that was tried lies below the horizon or averted.
fn ask(
    engine: &RasterEngine<'_>,
    group: &Group,
    (surfels, mean): (&Range<u32>, f32),
    left_out: u64,
) -> Option<Vec3> {
    let (mut sent, mut seen) = (Vec3::ZERO, Vec3::ZERO);
    let (mut asked, mut answered) = (0, 0);
    let rays = engine.knobs.rays;
    let first = mixed(surfels.start) as usize;
    let surfels_of_tree = engine.octree.surfels();
    for turn in 0..TRIES * rays {
        // Members and surfels alike are spread over the whole.
        let member = (first + turn * group.len() / rays + turn / rays) % group.len();
        #[expect(clippy::cast_possible_truncation, reason = "a few rays")]
        let seed = mixed(surfels.start.wrapping_mul(31).wrapping_add(turn as u32));
        let part = ((turn % rays) as f32 + fraction(seed)) / rays as f32;
        if left_out >> member & 1 == 1 {
            continue;
        }
        let surfel = pick(surfels, part);
        // A visible dark surface does not speak for a bright one behind it: dim surfels are asked the less often.
        let reflected = surfels_of_tree.reflected(surfel);
        let chance = (reflected.element_sum() / mean).min(1.0);
        if chance < fraction(mixed(seed)) {
            continue;
        }
        if let Some(is_seen) = look(engine, (group, member), surfel) {
            asked += 1;
            answered += usize::from(is_seen);
            let radiance = reflected / chance;
            sent += radiance;
            seen += if is_seen { radiance } else { Vec3::ZERO };
            if asked == rays {
                break;
            }
        }
    }
    (asked > 0).then(|| share_of((asked, answered), sent, seen))
}

/// Light seen of light sent; where a channel has none, the share of the rays.
fn share_of((asked, answered): (usize, usize), sent: Vec3, seen: Vec3) -> Vec3 {
    if answered == asked {
        return Vec3::ONE;
    }
    if answered == 0 {
        return Vec3::ZERO;
    }
    let share = answered as f32 / asked as f32;
    let of_channel = |axis: usize| {
        if sent[axis] > 0.0 {
            (seen[axis] / sent[axis]).min(PARTLY)
        } else {
            share
        }
    };
    Vec3::from([0, 1, 2].map(of_channel))
}

/// Largest share of what is partly hidden.
const PARTLY: f32 = 1.0 - f32::EPSILON;

/// Whether a member of a group sees the front of a surfel, by its place in leaf order; `None` if it lies below the
/// horizon or averted.
fn look(
    engine: &RasterEngine<'_>,
    (group, member): (&Group, usize),
    surfel: usize,
) -> Option<bool> {
    let surfels = engine.octree.surfels();
    let normal = surfels.normal(surfel);
    let target = surfels.position(surfel) + normal * (LIFT_RADII * surfels.radius(surfel));
    let offset = target - group.origins[member];
    if group.normals[member].dot(offset) <= 0.0 || normal.dot(offset) >= 0.0 {
        return None;
    }
    let distance = offset.length();
    let direction = offset / distance;
    Some(!(engine.tracer).occluded(group.origins[member], direction, distance * REACH))
}

/// `sum`, what member `member` of `group` receives otherwise, and light from areas that are partly hidden.
pub(super) fn add_doubtful(
    engine: &RasterEngine<'_>,
    (group, member): (&Group, usize),
    doubtful: &[Doubtful],
    sum: Vec3,
) -> Vec3 {
    let (position, normal) = (group.positions[member], group.normals[member]);
    let is_far = |one: &&Doubtful| one.near >> member & 1 == 0;
    let parts: Vec<(&Doubtful, f32)> = (doubtful.iter().filter(is_far))
        .map(|one| {
            let max_distance = engine.knobs.max_distance;
            (one, one.area.seen_from(position, normal, max_distance))
        })
        .collect();
    let shared = |(one, seen): &(&Doubtful, f32)| one.area.light * one.share * *seen;
    let total = sum + parts.iter().map(shared).sum::<Vec3>();
    let least = engine.knobs.least_share * total.element_sum();
    parts.iter().fold(sum, |sum, part| {
        let (one, seen) = part;
        if one.share == Vec3::ONE || one.area.light.element_sum() * seen <= least {
            return sum + shared(part);
        }
        sum + own_light(engine, (group, member), &one.surfels).map_or(shared(part), |l| l * *seen)
    })
}

/// Mean radiance of `surfels` as a member of a group sees them by rays of its own.
fn own_light(
    engine: &RasterEngine<'_>,
    (group, member): (&Group, usize),
    surfels: &Range<u32>,
) -> Option<Vec3> {
    let place = group.positions[member].to_array().map(f32::to_bits);
    let own = mixed(place[0] ^ place[1].rotate_left(11) ^ place[2].rotate_left(22));
    let (mut light, mut count) = (Vec3::ZERO, 0.0);
    for turn in 0..engine.knobs.own_rays {
        let seed = mixed(own ^ mixed(surfels.start ^ turn << 27));
        let part = (turn as f32 + fraction(seed)) / engine.knobs.own_rays as f32;
        let surfel = pick(surfels, part);
        if let Some(is_seen) = look(engine, (group, member), surfel) {
            count += 1.0;
            if is_seen {
                light += engine.octree.surfels().reflected(surfel);
            }
        }
    }
    (count > 0.0).then(|| light / count)
}

/// The surfel at `part` (0…1) of `surfels`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "rounded down on purpose, at least 0, clamped"
)]
fn pick(surfels: &Range<u32>, part: f32) -> usize {
    let count = surfels.end - surfels.start;
    let place = (f64::from(part) * f64::from(count)) as u32;
    (surfels.start + place.min(count - 1)) as usize
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_whole_only_where_all_rays_agree() {
        let light = Vec3::new(4.0, 2.0, 0.0);
        assert_eq!(share_of((4, 4), light, light), Vec3::ONE);
        assert_eq!(share_of((4, 0), light, Vec3::ZERO), Vec3::ZERO);
        let partly = share_of((4, 3), light, Vec3::new(4.0, 1.0, 0.0));
        assert!(partly.x < 1.0 && partly.abs_diff_eq(Vec3::new(1.0, 0.5, 0.75), 1e-6));
    }

    #[test]
    fn picks_stay_inside() {
        assert_eq!(pick(&(5..6), 1.0), 5);
        assert_eq!((pick(&(5..9), 0.0), pick(&(5..9), 1.0)), (5, 8));
        assert!(fraction(u32::MAX) <= 1.0 && fraction(0) == 0.0);
    }
}
