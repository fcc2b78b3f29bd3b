//! All receivers of a run → windows that overlap: a core of neighbors, and guests around it.
//!
//! Every receiver is in one core. What a window finds out holds for its guests too, the less the farther off they are: the
//! light of a receiver is a weighted mean over all windows that it is in. The weight falls to nothing at the edge of a
//! window, so that none of them has a border that could be seen. Receivers that do not see each other share nothing,
//! however near they are: both sides of a wall, two floors.

use super::group::CORE;
use crate::gather::neighbors;
use crate::math::{Bounds3, Frame, sequence};
use crate::receivers::Receivers;
use crate::trace::Tracer;
use glam::Vec3;
use rayon::prelude::*;

/// Radius of a window over that of its core.
const SPREAD: f32 = 1.3;

/// Most members of a window.
pub(super) const MOST: usize = 256;

/// Normals of a window are within 45° of that of its first receiver.
const LEAST_COSINE: f32 = 0.7;

/// Members off the plane of a window count as this much farther away: light changes faster across a surface than along it.
const STRETCH: f32 = 2.0;

/// Least weight of a member of the core: its window is the only one it is sure to be in.
const LEAST_WEIGHT: f32 = 1e-3;

/// Whether neighbors see each other is asked this part of their distance above them: curved surfaces are not in the way.
const RISE: f32 = 0.1;

/// Rays that find out how much room there is above a core.
const PROBES: u32 = 16;

/// Receivers along the curve that are sorted into cores together.
const RUN: usize = 256;

/// How large cores may be.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    /// Largest radius, stage units.
    pub(super) max_radius: f32,
    /// Largest radius over the harmonic mean of the distances to what is seen from there: close to things that cast
    /// shadows, light changes fast.
    pub(super) max_share: f32,
}

/// Receivers that share a cut.
#[derive(Debug)]
pub(super) struct Window {
    /// The core first.
    pub(super) members: Vec<usize>,
    /// How many of them are the core, 1…[`CORE`].
    pub(super) core: usize,
    /// What each member's light counts, above 0.
    pub(super) weights: Vec<f32>,
    pub(super) center: Vec3,
}

/// Neighbors that look alike and see each other.
#[derive(Debug)]
struct Core {
    /// The middle one first.
    members: Vec<usize>,
    /// How far they are from that, as [`Windows::distance`] has it.
    radius: f32,
}

/// All windows of a run.
#[derive(Debug)]
pub(super) struct Windows<'a> {
    tracer: &'a Tracer,
    receivers: &'a Receivers,
    cores: Vec<Core>,
    /// Boxes around cores, around two of these, and so on to one box around all.
    boxes: Vec<Vec<Bounds3>>,
}

impl<'a> Windows<'a> {
    /// Over all of `receivers`.
    pub(super) fn new(tracer: &'a Tracer, receivers: &'a Receivers, sizes: Sizes) -> Self {
        let order = neighbors::order(&receivers.position, &receivers.normal);
        let mut windows = Self {
            tracer,
            receivers,
            cores: Vec::new(),
            boxes: Vec::new(),
        };
        let runs: Vec<Vec<Core>> = (order.par_chunks(RUN))
            .map(|run| windows.cores_of(run, sizes))
            .collect();
        windows.cores = runs.into_iter().flatten().collect();
        let around =
            |core: &Core| Bounds3::around(core.members.iter().map(|&i| receivers.position[i]));
        let mut level: Vec<Bounds3> = windows.cores.par_iter().map(around).collect();
        while level.len() > 1 {
            let pair =
                |pair: &[Bounds3]| pair.iter().fold(Bounds3::EMPTY, |all, one| all.union(*one));
            let above = level.chunks(2).map(pair).collect();
            windows.boxes.push(std::mem::replace(&mut level, above));
        }
        windows.boxes.push(level);
        windows
    }

    /// Number of windows.
    pub(super) fn len(&self) -> usize {
        self.cores.len()
    }

    /// The `index`th window.
    pub(super) fn window(&self, index: usize) -> Window {
        let core = &self.cores[index];
        let middle = core.members[0];
        let mut reach = SPREAD * core.radius;
        let mut guests = Vec::new();
        if reach > 0.0 {
            self.guests_in((self.boxes.len() - 1, 0), (index, reach), &mut guests);
            guests.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            if let Some(&(distance, _)) = guests.get(MOST - core.members.len()) {
                reach = distance;
                guests.truncate(MOST - core.members.len());
            }
            guests.retain(|&(distance, i)| distance < reach && self.sees(middle, i));
        }
        let mut members = core.members.clone();
        members.extend(guests.iter().map(|&(_, i)| i));
        let weight = |(k, &i): (usize, &usize)| {
            let least = if k < core.members.len() {
                LEAST_WEIGHT
            } else {
                f32::MIN_POSITIVE
            };
            self.weight(middle, i, reach).max(least)
        };
        Window {
            weights: members.iter().enumerate().map(weight).collect(),
            members,
            core: core.members.len(),
            center: self.receivers.position[middle],
        }
    }

    /// Receivers of other cores below a box that are within `reach` of the middle of core `index`, and how far.
    fn guests_in(
        &self,
        (level, place): (usize, usize),
        (index, reach): (usize, f32),
        guests: &mut Vec<(f32, usize)>,
    ) {
        let middle = self.cores[index].members[0];
        let position = self.receivers.position[middle];
        let Some(bounds) = self.boxes[level].get(place) else {
            return;
        };
        if position.clamp(bounds.min, bounds.max).distance(position) >= reach {
            return;
        }
        if level > 0 {
            for child in [2 * place, 2 * place + 1] {
                self.guests_in((level - 1, child), (index, reach), guests);
            }
        } else if place != index {
            let axis = self.receivers.normal[middle];
            let near = self.cores[place].members.iter().filter_map(|&i| {
                let distance = self.distance(middle, i);
                let is_alike = self.receivers.normal[i].dot(axis) > LEAST_COSINE;
                (is_alike && distance < reach).then_some((distance, i))
            });
            guests.extend(near);
        }
    }

    fn weight(&self, middle: usize, i: usize, reach: f32) -> f32 {
        let normals = &self.receivers.normal;
        let part = self.distance(middle, i) / reach.max(f32::MIN_POSITIVE);
        let near = (1.0 - part * part).max(0.0);
        let alike = (normals[middle].dot(normals[i]) - LEAST_COSINE) / (1.0 - LEAST_COSINE);
        (near * alike.clamp(0.0, 1.0)).powi(2)
    }

    /// Distance of receiver `i` from `middle`, longer off its plane.
    fn distance(&self, middle: usize, i: usize) -> f32 {
        let offset = self.receivers.position[i] - self.receivers.position[middle];
        let height = offset.dot(self.receivers.normal[middle]);
        (offset.length_squared() + (STRETCH * STRETCH - 1.0) * height * height).sqrt()
    }

    fn sees(&self, a: usize, b: usize) -> bool {
        let above = |i: usize, height: f32| {
            let lifted =
                (self.tracer).lift(self.receivers.position[i], self.receivers.rim_normal(i));
            lifted + self.receivers.normal[i] * height
        };
        let height = RISE * self.receivers.position[a].distance(self.receivers.position[b]);
        let (start, end) = (above(a, height), above(b, height));
        let (way, distance) = (end - start, end.distance(start));
        way.try_normalize()
            .is_none_or(|direction| !self.tracer.occluded(start, direction, distance))
    }

    fn cores_of(&self, run: &[usize], sizes: Sizes) -> Vec<Core> {
        let normals = &self.receivers.normal;
        let mut cores = Vec::new();
        let mut left = run.to_vec();
        while let Some(&first) = left.first() {
            let is_alike =
                |i: &usize| *i == first || normals[*i].dot(normals[first]) > LEAST_COSINE;
            let (alike, rest): (Vec<usize>, Vec<usize>) = left.into_iter().partition(is_alike);
            self.halve(alike, sizes, &mut cores);
            left = rest;
        }
        cores
    }

    /// Cut `members` in two along their box's longest side until they are few and near enough to make cores.
    fn halve(&self, mut members: Vec<usize>, sizes: Sizes, cores: &mut Vec<Core>) {
        let positions = &self.receivers.position;
        let bounds = Bounds3::around(members.iter().map(|&i| positions[i]));
        let radius = 0.5 * bounds.diagonal();
        let is_small = members.len() <= CORE && radius <= sizes.max_radius;
        let has_room = || {
            radius <= sizes.max_share * self.room_above(self.middle_of(&members, bounds.center()))
        };
        if members.len() == 1 || (is_small && has_room()) {
            self.part(members, cores);
            return;
        }
        let size = bounds.max - bounds.min;
        let axis = usize::from(size.y > size.x);
        let axis = if size.z > size[axis] { 2 } else { axis };
        let at = |i: usize| positions[i][axis];
        members.sort_by(|&a, &b| at(a).total_cmp(&at(b)).then(a.cmp(&b)));
        let upper = members.split_off(members.len() / 2);
        self.halve(members, sizes, cores);
        self.halve(upper, sizes, cores);
    }

    /// Cores of those of `members` that see each other.
    fn part(&self, mut members: Vec<usize>, cores: &mut Vec<Core>) {
        let positions = &self.receivers.position;
        while !members.is_empty() {
            let center = members.iter().map(|&i| positions[i]).sum::<Vec3>() / members.len() as f32;
            let middle = self.middle_of(&members, center);
            let is_seen = |i: &usize| *i == middle || self.sees(middle, *i);
            let (mut seen, rest): (Vec<usize>, Vec<usize>) = members.into_iter().partition(is_seen);
            let place = seen.iter().position(|&i| i == middle);
            seen.swap(0, place.expect("the middle one sees itself"));
            let distance = |&i: &usize| self.distance(middle, i);
            cores.push(Core {
                radius: seen.iter().map(distance).fold(0.0, f32::max),
                members: seen,
            });
            members = rest;
        }
    }

    /// The one of `members` that is closest to `center`.
    fn middle_of(&self, members: &[usize], center: Vec3) -> usize {
        let off = |i: usize| self.receivers.position[i].distance_squared(center);
        let middle =
            (members.iter().copied()).min_by(|&a, &b| off(a).total_cmp(&off(b)).then(a.cmp(&b)));
        middle.expect("there are members")
    }

    /// Harmonic mean of the distances to what receiver `i` sees.
    fn room_above(&self, i: usize) -> f32 {
        let start = (self.tracer).lift(self.receivers.position[i], self.receivers.rim_normal(i));
        let frame = Frame::about(self.receivers.normal[i]);
        let nearness = |k: u32| {
            let local = sequence::cosine_hemisphere(sequence::fibonacci(k, PROBES));
            let hit = (self.tracer).closest(start, frame.to_world(local), f32::INFINITY);
            hit.map_or(0.0, |hit| hit.distance.max(f32::MIN_POSITIVE).recip())
        };
        PROBES as f32 / (0..PROBES).map(nearness).sum::<f32>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::testing::receivers_at;
    use crate::trace::testing::{Random, mesh, scene};
    use glam::Affine3A;

    const SIZES: Sizes = Sizes {
        max_radius: 0.2,
        max_share: 1.0,
    };

    /// Receivers on a floor of side 2 that a wall across it parts, if there is one.
    fn floor(has_wall: bool) -> (Tracer, Receivers) {
        let corner = |y: f32, z: f32| Vec3::new(0.0, y, z);
        let wall = mesh(&[[corner(-1.0, -9.0), corner(9.0, 0.0), corner(-1.0, 9.0)]]);
        let (meshes, prims) = if has_wall {
            (vec![wall], vec![(0, Affine3A::IDENTITY)])
        } else {
            (Vec::new(), Vec::new())
        };
        let mut random = Random(7);
        let places: Vec<_> = (0..3000)
            .map(|_| (random.vector() * Vec3::new(1.0, 0.0, 1.0), Vec3::Y))
            .collect();
        (Tracer::new(&scene(meshes, &prims)), receivers_at(&places))
    }

    #[test]
    fn every_receiver_is_in_one_core_of_neighbors() {
        let (tracer, receivers) = floor(false);
        let windows = Windows::new(&tracer, &receivers, SIZES);
        let mut seen = vec![0; receivers.len()];
        for index in 0..windows.len() {
            let window = windows.window(index);
            assert!(window.core <= CORE && window.members.len() <= MOST);
            assert!(window.weights.iter().all(|&weight| weight > 0.0));
            for &i in &window.members[..window.core] {
                seen[i] += 1;
                let distance = receivers.position[i].distance(window.center);
                assert!(distance <= 2.0 * SIZES.max_radius, "{distance}");
            }
        }
        assert!(seen.iter().all(|&count| count == 1));
    }

    #[test]
    fn all_that_a_window_reaches_are_its_guests_and_the_last_ones_count_little() {
        let (tracer, receivers) = floor(false);
        let windows = Windows::new(&tracer, &receivers, SIZES);
        for index in (0..windows.len()).step_by(7) {
            let window = windows.window(index);
            let distance = |i: &usize| receivers.position[*i].distance(window.center);
            let core = window.members[..window.core].iter().map(distance);
            let reach = SPREAD * core.fold(0.0, f32::max);
            let within = (0..receivers.len()).filter(|i| distance(i) < reach).count();
            assert_eq!(window.members.len(), within);
            for (i, weight) in window.members.iter().zip(&window.weights) {
                let part = distance(i) / reach;
                assert!(part < 0.97 || *weight < 0.01, "{part} {weight}");
                assert!(part > 0.2 || *weight > 0.9, "{part} {weight}");
            }
        }
    }

    #[test]
    fn nobody_shares_a_window_through_a_wall() {
        let (tracer, receivers) = floor(true);
        let windows = Windows::new(&tracer, &receivers, SIZES);
        let mut together = 0;
        for index in 0..windows.len() {
            let members = windows.window(index).members;
            let side = |i: &usize| receivers.position[*i].x > 0.0;
            assert!(members.iter().all(|i| side(i) == side(&members[0])));
            together += members.len();
        }
        assert!(together > 2 * receivers.len(), "{together}");
    }

    #[test]
    fn windows_shrink_where_there_is_little_room() {
        let (tracer, receivers) = floor(true);
        let sizes = Sizes {
            max_radius: 0.2,
            max_share: 0.2,
        };
        let windows = Windows::new(&tracer, &receivers, sizes);
        let radius = |near: bool| {
            let all = windows
                .cores
                .iter()
                .filter(|core| (receivers.position[core.members[0]].x.abs() < 0.1) == near);
            let (sum, count) = all.fold((0.0, 0), |(sum, n), core| (sum + core.radius, n + 1));
            sum / count as f32
        };
        assert!(radius(true) < 0.5 * radius(false));
    }
}
