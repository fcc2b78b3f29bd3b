//! Points in space → those nearest to another that pass a test.

use crate::math::Bounds3;
use glam::Vec3;
use std::ops::Range;

/// Points that a search looks at one by one.
const LEAF: usize = 8;

/// Points as a tree of halves: each run of more than [`LEAF`] is cut at its middle along the axis on which it is longest.
#[derive(Debug)]
pub(super) struct Places {
    /// Point and number.
    points: Vec<(Vec3, u32)>,
    /// Axis and place of the cut of each run that is halved; halves of cut `i` have cuts `2 i + 1` and `2 i + 2`.
    cuts: Vec<(usize, f32)>,
}

impl Places {
    /// Points with the numbers that they are found by, each its own. In O(n log n).
    pub(super) fn new(mut points: Vec<(Vec3, u32)>) -> Self {
        let mut count = 0;
        while points.len() > LEAF << count {
            count += 1;
        }
        let mut cuts = vec![(0, 0.0); (1 << count) - 1];
        halve(&mut points, &mut cuts, (0, count));
        Self { points, cuts }
    }

    /// Write the numbers of up to `count` points nearest to `place` that `is_taken`, nearest first, to `found`; of equally
    /// far ones those of lower numbers.
    pub(super) fn nearest(
        &self,
        place: Vec3,
        count: usize,
        is_taken: impl Fn(u32) -> bool,
        found: &mut Vec<(f32, u32)>,
    ) {
        found.clear();
        if count == 0 {
            return;
        }
        let mut search = Search {
            places: self,
            place,
            count,
            is_taken,
            found,
        };
        search.visit(0, 0..self.points.len(), Vec3::ZERO);
    }
}

/// Sort `points` and tell `cuts` of them, from cut `i` on; those of the last level are `level` levels below it. Cuts of a
/// level follow each other.
fn halve(points: &mut [(Vec3, u32)], cuts: &mut [(usize, f32)], (i, level): (usize, u32)) {
    if level == 0 || points.len() <= LEAF {
        return;
    }
    let bounds = Bounds3::around(points.iter().map(|point| point.0));
    let axis = (bounds.max - bounds.min).max_position();
    let middle = points.len() / 2;
    let (_, point, _) = points.select_nth_unstable_by(middle, |a, b| {
        a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
    });
    cuts[i] = (axis, point.0[axis]);
    let (low, high) = points.split_at_mut(middle);
    halve(low, cuts, (2 * i + 1, level - 1));
    halve(high, cuts, (2 * i + 2, level - 1));
}

/// A search under way.
struct Search<'a, T> {
    places: &'a Places,
    place: Vec3,
    count: usize,
    is_taken: T,
    /// Distance squared and number, in order.
    found: &'a mut Vec<(f32, u32)>,
}

impl<T: Fn(u32) -> bool> Search<'_, T> {
    /// Look at the points of `run`, which cut `i` halves if it is longer than a leaf; they are at least `beyond` away, by axis.
    fn visit(&mut self, i: usize, run: Range<usize>, beyond: Vec3) {
        if run.len() <= LEAF {
            let places = self.places;
            for &(point, number) in &places.points[run] {
                self.offer((point.distance_squared(self.place), number));
            }
            return;
        }
        let (axis, at) = self.places.cuts[i];
        let middle = run.start + run.len() / 2;
        let halves = [(2 * i + 1, run.start..middle), (2 * i + 2, middle..run.end)];
        let [low, high] = halves;
        let past = self.place[axis] - at;
        let (near, far) = if past < 0.0 { (low, high) } else { (high, low) };
        self.visit(near.0, near.1, beyond);
        let mut farther = beyond;
        farther[axis] = past.abs();
        if self.found.len() < self.count || farther.length_squared() <= self.found[self.count - 1].0
        {
            self.visit(far.0, far.1, farther);
        }
    }

    /// Put a point in its place among those found, if it is near enough and passes the test.
    fn offer(&mut self, point: (f32, u32)) {
        let is_before = |other: &(f32, u32)| {
            other
                .0
                .total_cmp(&point.0)
                .then(other.1.cmp(&point.1))
                .is_lt()
        };
        let is_full = self.found.len() == self.count;
        if is_full && self.found.last().is_some_and(is_before) || !(self.is_taken)(point.1) {
            return;
        }
        if is_full {
            self.found.pop();
        }
        let at = self.found.partition_point(is_before);
        self.found.insert(at, point);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::testing::Random;

    /// All of them by distance and number: what a search is to find.
    fn sorted(points: &[(Vec3, u32)], place: Vec3, is_taken: impl Fn(u32) -> bool) -> Vec<u32> {
        let mut all: Vec<(f32, u32)> = (points.iter())
            .filter(|point| is_taken(point.1))
            .map(|point| (point.0.distance_squared(place), point.1))
            .collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.into_iter().map(|point| point.1).collect()
    }

    fn assert_finds(points: &[(Vec3, u32)], is_taken: impl Fn(u32) -> bool + Copy) {
        let tree = Places::new(points.to_vec());
        let mut random = Random(11);
        let mut found = Vec::new();
        for count in [1, 5, 24] {
            for _ in 0..50 {
                let place = random.vector() * 1.5;
                tree.nearest(place, count, is_taken, &mut found);
                let numbers: Vec<u32> = found.iter().map(|point| point.1).collect();
                let all = sorted(points, place, is_taken);
                assert_eq!(numbers, all[..count.min(all.len())]);
            }
        }
    }

    #[test]
    fn the_nearest_that_pass_are_found_in_order() {
        let mut random = Random(3);
        for count in [0, 1, 7, 8, 9, 17, 100, 1000] {
            let points: Vec<_> = (0..count).map(|i| (random.vector(), i)).collect();
            assert_finds(&points, |_| true);
            assert_finds(&points, |i| i % 3 == 0);
            assert_finds(&points, |_| false);
        }
    }

    #[test]
    fn equally_far_points_come_by_number() {
        let place = |i: u16| Vec3::new(f32::from(i % 10), f32::from(i / 10), 0.0) / 5.0;
        let points: Vec<_> = (0..100_u16)
            .map(|i| (place(99 - i) - Vec3::ONE, u32::from(i)))
            .collect();
        assert_finds(&points, |_| true);
        let one: Vec<_> = (0..40).map(|i| (Vec3::X, (i * 7) % 40)).collect();
        assert_finds(&one, |i| i != 5);
    }
}
