//! All receivers of a run → windows that overlap: a core of neighbors, and guests around it; and those that stand alone.
//!
//! What a window finds out holds for its guests too, the less the farther off they are: the light of a receiver is a weighted
//! mean over all windows that it is in. The weight falls to nothing at the edge of a window, so that none of them has a border
//! that could be seen. Receivers that do not see each other share nothing, however near they are: both sides of a wall, two
//! floors. Where too few of them are neighbors for a window to pay, receivers are in the core of none.

use super::group::MOST;
use crate::gather::neighbors;
use crate::math::{Bounds3, Frame, sequence};
use crate::receivers::Receivers;
use crate::trace::Tracer;
use glam::Vec3;
use rayon::prelude::*;

/// Radius of a window over that of its core.
const SPREAD: f32 = 1.3;

/// Normals of a window are within 45° of that of its first receiver.
const LEAST_COSINE: f32 = 0.7;

/// Members off the plane of a window count as this much farther away: light changes faster across a surface than along it.
const STRETCH: f32 = 2.0;

/// Least weight of a member of the core: its window is the only one it is sure to be in.
const LEAST_WEIGHT: f32 = 1e-3;

/// Whether neighbors see each other is asked this part of their distance above them: curved surfaces are not in the way.
const RISE: f32 = 0.1;

/// Receivers along the curve that are sorted into cores together, and so the most of a core.
const RUN: usize = 8192;

/// Fewest receivers of a core: a window costs about as much as rays for so many.
const FEWEST: usize = MOST;

/// Halvings of a core whose window has to be smaller.
const HALVINGS: u32 = 2;

/// How large cores may be.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    /// Largest radius, stage units.
    pub(super) max_radius: f32,
    /// Largest radius over the harmonic mean of the distances to what is seen from there: close to things that cast
    /// shadows, light changes fast.
    pub(super) max_share: f32,
    /// Rays that find these distances out.
    pub(super) probes: u32,
}

/// Receivers that share a cut.
#[derive(Debug)]
pub(super) struct Window {
    /// The core first.
    pub(super) members: Vec<usize>,
    /// How many of them are the core.
    pub(super) core: usize,
    /// What each member's light counts, above 0.
    pub(super) weights: Vec<f32>,
    pub(super) center: Vec3,
    /// Of the ball about the center that holds all members.
    pub(super) radius: f32,
    /// Places of the members across the normal of the middle one, about the center, in units of the radius.
    pub(super) across: Vec<[f32; 2]>,
}

/// Neighbors that look alike and see each other.
#[derive(Debug, Clone)]
pub(super) struct Core {
    /// The middle one first.
    members: Vec<usize>,
    /// How far they are from that, as [`Windows::distance`] has it.
    radius: f32,
}

/// Receivers, sorted.
#[derive(Debug, Default)]
pub(super) struct Sorted {
    pub(super) cores: Vec<Core>,
    /// Those in no core.
    pub(super) alone: Vec<usize>,
}

impl Sorted {
    /// Adds those of `more`.
    pub(super) fn extend(&mut self, more: Self) {
        self.cores.extend(more.cores);
        self.alone.extend(more.alone);
    }
}

/// All windows of a run.
#[derive(Debug)]
pub(super) struct Windows<'a> {
    tracer: &'a Tracer,
    receivers: &'a Receivers,
    /// Neighbors, all receivers together: members of cores, and others.
    packs: Vec<Vec<usize>>,
    /// Boxes around packs, around two of these, and so on to one box around all.
    boxes: Vec<Vec<Bounds3>>,
}

impl<'a> Windows<'a> {
    /// Over all of `receivers`, and these, sorted.
    pub(super) fn new(
        tracer: &'a Tracer,
        receivers: &'a Receivers,
        sizes: Sizes,
    ) -> (Self, Sorted) {
        let order = neighbors::order(&receivers.position, &receivers.normal);
        let mut windows = Self {
            tracer,
            receivers,
            packs: Vec::new(),
            boxes: Vec::new(),
        };
        let runs: Vec<Sorted> = (order.par_chunks(RUN))
            .map(|run| windows.sorted(run, sizes))
            .collect();
        let mut sorted = Sorted::default();
        for run in runs {
            let of_cores = run.cores.iter().map(|core| core.members.clone());
            let others = run.alone.chunks(FEWEST).map(<[_]>::to_vec);
            windows.packs.extend(of_cores.chain(others));
            sorted.extend(run);
        }
        let around =
            |pack: &Vec<usize>| Bounds3::around(pack.iter().map(|&i| receivers.position[i]));
        let mut level: Vec<Bounds3> = windows.packs.par_iter().map(around).collect();
        while level.len() > 1 {
            let pair =
                |pair: &[Bounds3]| pair.iter().fold(Bounds3::EMPTY, |all, one| all.union(*one));
            let above = level.chunks(2).map(pair).collect();
            windows.boxes.push(std::mem::replace(&mut level, above));
        }
        windows.boxes.push(level);
        (windows, sorted)
    }

    /// The window about `core`.
    pub(super) fn window(&self, core: &Core) -> Window {
        let positions = &self.receivers.position;
        let middle = core.members[0];
        let reach = SPREAD * core.radius;
        let mut guests = Vec::new();
        if reach > 0.0 {
            let mut own = core.members.clone();
            own.sort_unstable();
            self.guests_in((self.boxes.len() - 1, 0), (middle, reach), &mut guests);
            guests.retain(|i| own.binary_search(i).is_err() && self.sees(middle, *i));
        }
        let core_size = core.members.len();
        let members: Vec<usize> = core.members.iter().copied().chain(guests).collect();
        let weight = |(k, &i): (usize, &usize)| {
            let least = if k < core_size {
                LEAST_WEIGHT
            } else {
                f32::MIN_POSITIVE
            };
            self.weight(middle, i, reach).max(least)
        };
        let center = positions[middle];
        let distance = |&i: &usize| positions[i].distance(center);
        let radius = members.iter().map(distance).fold(0.0, f32::max);
        let frame = Frame::about(self.receivers.normal[middle]);
        let across = |&i: &usize| {
            let offset = (positions[i] - center) / radius.max(f32::MIN_POSITIVE);
            [offset.dot(frame.tangent), offset.dot(frame.bitangent)]
        };
        Window {
            weights: members.iter().enumerate().map(weight).collect(),
            across: members.iter().map(across).collect(),
            members,
            core: core_size,
            center,
            radius,
        }
    }

    /// Cores of the parts of `core`.
    pub(super) fn split(&self, core: &Core) -> Sorted {
        let mut sorted = Sorted::default();
        let mut parts = vec![core.members.clone()];
        for _ in 0..HALVINGS {
            parts = parts
                .into_iter()
                .flat_map(|part| self.halves(part))
                .collect();
        }
        for part in parts {
            self.part(part, &mut sorted);
        }
        sorted
    }

    /// Receivers below a box that look as `middle` does and are within `reach` of it.
    fn guests_in(
        &self,
        (level, place): (usize, usize),
        (middle, reach): (usize, f32),
        guests: &mut Vec<usize>,
    ) {
        let position = self.receivers.position[middle];
        let Some(bounds) = self.boxes[level].get(place) else {
            return;
        };
        if position.clamp(bounds.min, bounds.max).distance(position) >= reach {
            return;
        }
        if level > 0 {
            for child in [2 * place, 2 * place + 1] {
                self.guests_in((level - 1, child), (middle, reach), guests);
            }
        } else {
            let axis = self.receivers.normal[middle];
            let is_guest = |&i: &usize| {
                self.distance(middle, i) < reach
                    && self.receivers.normal[i].dot(axis) > LEAST_COSINE
            };
            guests.extend(self.packs[place].iter().copied().filter(is_guest));
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

    fn sorted(&self, run: &[usize], sizes: Sizes) -> Sorted {
        let normals = &self.receivers.normal;
        let mut sorted = Sorted::default();
        let mut left = run.to_vec();
        while let Some(&first) = left.first() {
            let is_alike =
                |i: &usize| *i == first || normals[*i].dot(normals[first]) > LEAST_COSINE;
            let (alike, rest): (Vec<usize>, Vec<usize>) = left.into_iter().partition(is_alike);
            self.halve(alike, sizes, &mut sorted);
            left = rest;
        }
        sorted
    }

    /// Cut `members` in two until they are near enough to make cores, or too few.
    fn halve(&self, members: Vec<usize>, sizes: Sizes, sorted: &mut Sorted) {
        if members.len() < FEWEST {
            sorted.alone.extend(members);
            return;
        }
        let middle = self.middle_of(&members);
        let distance = |&i: &usize| self.distance(middle, i);
        let radius = members.iter().map(distance).fold(0.0, f32::max);
        let room = || self.room_above(middle, sizes.probes);
        if radius <= sizes.max_radius && radius <= sizes.max_share * room() {
            self.part(members, sorted);
            return;
        }
        for half in self.halves(members) {
            self.halve(half, sizes, sorted);
        }
    }

    /// Both halves of `members` along their box's longest side.
    fn halves(&self, mut members: Vec<usize>) -> [Vec<usize>; 2] {
        let positions = &self.receivers.position;
        let bounds = Bounds3::around(members.iter().map(|&i| positions[i]));
        let size = bounds.max - bounds.min;
        let axis = usize::from(size.y > size.x);
        let axis = if size.z > size[axis] { 2 } else { axis };
        let at = |i: usize| positions[i][axis];
        let half = members.len() / 2;
        if half > 0 {
            let by_place = |&a: &usize, &b: &usize| at(a).total_cmp(&at(b)).then(a.cmp(&b));
            members.select_nth_unstable_by(half, by_place);
        }
        let upper = members.split_off(half);
        [members, upper]
    }

    /// Cores of those of `members` that see each other.
    fn part(&self, mut members: Vec<usize>, sorted: &mut Sorted) {
        while members.len() >= FEWEST {
            let middle = self.middle_of(&members);
            let is_seen = |i: &usize| *i == middle || self.sees(middle, *i);
            let (mut seen, rest): (Vec<usize>, Vec<usize>) = members.into_iter().partition(is_seen);
            if seen.len() < FEWEST {
                sorted.alone.extend(seen);
            } else {
                let place = seen.iter().position(|&i| i == middle);
                seen.swap(0, place.expect("the middle one sees itself"));
                let distance = |&i: &usize| self.distance(middle, i);
                sorted.cores.push(Core {
                    radius: seen.iter().map(distance).fold(0.0, f32::max),
                    members: seen,
                });
            }
            members = rest;
        }
        sorted.alone.extend(members);
    }

    /// The one of `members` that is closest to their mean.
    fn middle_of(&self, members: &[usize]) -> usize {
        let positions = members.iter().map(|&i| self.receivers.position[i]);
        let center = positions.sum::<Vec3>() / members.len() as f32;
        let off = |i: usize| self.receivers.position[i].distance_squared(center);
        let middle =
            (members.iter().copied()).min_by(|&a, &b| off(a).total_cmp(&off(b)).then(a.cmp(&b)));
        middle.expect("there are members")
    }

    /// Harmonic mean of the distances to what receiver `i` sees.
    fn room_above(&self, i: usize, probes: u32) -> f32 {
        let start = (self.tracer).lift(self.receivers.position[i], self.receivers.rim_normal(i));
        let frame = Frame::about(self.receivers.normal[i]);
        let nearness = |k: u32| {
            let local = sequence::cosine_hemisphere(sequence::fibonacci(k, probes));
            let hit = (self.tracer).closest(start, frame.to_world(local), f32::INFINITY);
            hit.map_or(0.0, |hit| hit.distance.max(f32::MIN_POSITIVE).recip())
        };
        probes as f32 / (0..probes).map(nearness).sum::<f32>()
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
        probes: 16,
    };

    const RECEIVERS: usize = 12_000;

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
        let places: Vec<_> = (0..RECEIVERS)
            .map(|_| (random.vector() * Vec3::new(1.0, 0.0, 1.0), Vec3::Y))
            .collect();
        (Tracer::new(&scene(meshes, &prims)), receivers_at(&places))
    }

    #[test]
    fn every_receiver_is_in_one_core_of_neighbors_or_stands_alone() {
        let (tracer, receivers) = floor(false);
        let (windows, Sorted { cores, alone }) = Windows::new(&tracer, &receivers, SIZES);
        let mut seen = vec![0; receivers.len()];
        for core in &cores {
            let window = windows.window(core);
            assert!(window.core >= FEWEST);
            assert!(window.weights.iter().all(|&weight| weight > 0.0));
            for &i in &window.members[..window.core] {
                seen[i] += 1;
                let distance = receivers.position[i].distance(window.center);
                assert!(distance <= SIZES.max_radius, "{distance}");
            }
        }
        assert!(alone.len() < RECEIVERS / 4, "{}", alone.len());
        alone.iter().for_each(|&i| seen[i] += 1);
        assert!(seen.iter().all(|&count| count == 1));
    }

    #[test]
    fn few_receivers_stand_alone_and_so_do_the_parts_of_small_cores() {
        let (tracer, receivers) = floor(false);
        let few = receivers.subset(&(0..FEWEST - 1).collect::<Vec<_>>());
        let (_, Sorted { cores, alone }) = Windows::new(&tracer, &few, SIZES);
        assert!(cores.is_empty() && alone.len() == FEWEST - 1);
        let (windows, sorted) = Windows::new(&tracer, &receivers, SIZES);
        for core in &sorted.cores {
            let Sorted { cores, mut alone } = windows.split(core);
            alone.extend(cores.iter().flat_map(|core| &core.members));
            alone.sort_unstable();
            let mut all = core.members.clone();
            all.sort_unstable();
            assert!(cores.iter().all(|part| part.members.len() >= FEWEST));
            assert_eq!(alone, all);
        }
    }

    #[test]
    fn all_that_a_window_reaches_are_its_guests_and_the_last_ones_count_little() {
        let (tracer, receivers) = floor(false);
        let (windows, sorted) = Windows::new(&tracer, &receivers, SIZES);
        for core in sorted.cores.iter().step_by(3) {
            let window = windows.window(core);
            let distance = |i: &usize| receivers.position[*i].distance(window.center);
            let own = window.members[..window.core].iter().map(distance);
            let reach = SPREAD * own.fold(0.0, f32::max);
            let within = (0..receivers.len()).filter(|i| distance(i) < reach).count();
            assert_eq!(window.members.len(), within);
            for (i, weight) in window.members.iter().zip(&window.weights) {
                let part = distance(i) / reach;
                assert!(part < 0.97 || *weight < 0.01, "{part} {weight}");
                assert!(part > 0.2 || *weight > 0.9, "{part} {weight}");
            }
            let farthest = window
                .across
                .iter()
                .map(|[x, y]| x.hypot(*y))
                .fold(0.0, f32::max);
            assert!((farthest - 1.0).abs() < 1e-3, "{farthest}");
        }
    }

    #[test]
    fn nobody_shares_a_window_through_a_wall() {
        let (tracer, receivers) = floor(true);
        let (windows, sorted) = Windows::new(&tracer, &receivers, SIZES);
        let mut together = 0;
        for core in &sorted.cores {
            let members = windows.window(core).members;
            let side = |i: &usize| receivers.position[*i].x > 0.0;
            assert!(members.iter().all(|i| side(i) == side(&members[0])));
            together += members.len();
        }
        assert!(together > RECEIVERS / 2, "{together}");
    }

    #[test]
    fn receivers_stand_alone_where_there_is_little_room() {
        let (tracer, receivers) = floor(true);
        let sizes = Sizes {
            max_radius: 0.2,
            max_share: 0.2,
            probes: 64,
        };
        let (_, Sorted { cores, alone }) = Windows::new(&tracer, &receivers, sizes);
        let is_near = |i: &usize| receivers.position[*i].x.abs() < 0.1;
        let members = cores.iter().flat_map(|core| &core.members);
        let together = members.filter(|i| is_near(i)).count();
        let near = together + alone.iter().filter(|i| is_near(i)).count();
        assert!(
            near > RECEIVERS / 20 && together < near / 4,
            "{together} {near}"
        );
        assert!(alone.len() < RECEIVERS);
    }
}
