//! Receivers → cells: runs of an order in which neighbors of one kind that look the same way follow each other.

use super::Kind;
use crate::math::Bounds3;
use crate::receivers::Receivers;
use glam::Vec3;
use std::ops::Range;

/// Receivers of the largest cells, at most.
pub(super) const LARGEST: usize = 64;

/// Receivers of a kind, at least, for some to speak for others.
const FEWEST: usize = 32;

/// Cosine between a normal of a run and their mean: where one is smaller, the run is split by normals and not by place.
const ONE_SIDE: f32 = 0.7;

/// Runs longer than this are split by two threads.
const PARALLEL: usize = 4096;

/// An order of receivers, and cells in it.
///
/// The order is one of halves: each run is split at its middle along the axis on which it is longest, so that the halves of
/// a cell, and theirs, are as compact as it is.
#[derive(Debug)]
pub(super) struct Cells {
    /// Indices of receivers.
    pub(super) order: Vec<u32>,
    /// Runs of `order`, all of it together: each of one kind, at most [`LARGEST`] long.
    pub(super) largest: Vec<Range<usize>>,
    /// The other receivers: those without a kind, and of kinds that have only a few.
    pub(super) alone: Vec<u32>,
}

impl Cells {
    /// Cells of `receivers`, at most `u32::MAX`, each of the `kind` told.
    pub(super) fn new(receivers: &Receivers, kind: &dyn Fn(u32) -> Kind) -> Self {
        let count = u32::try_from(receivers.len()).expect("receivers are counted by u32");
        let of_one_kind = |&a: &u32, &b: &u32| kind(a) == kind(b);
        let mut by_kind: Vec<u32> = (0..count).collect();
        by_kind.sort_by_key(|&i| kind(i));
        let is_many = |run: &&[u32]| run.len() >= FEWEST && kind(run[0]).is_some();
        let (many, few): (Vec<&[u32]>, Vec<&[u32]>) =
            (by_kind.chunk_by(of_one_kind)).partition(is_many);
        let (mut order, alone) = (many.concat(), few.concat());
        let mut largest = Vec::new();
        let mut start = 0;
        for run in order.chunk_by_mut(of_one_kind) {
            sort(receivers, run);
            cut(start..start + run.len(), &mut largest);
            start += run.len();
        }
        Self {
            order,
            largest,
            alone,
        }
    }
}

/// Both halves of a run of more than one.
pub(super) fn halves(run: &Range<usize>) -> [Range<usize>; 2] {
    let middle = run.start + run.len() / 2;
    [run.start..middle, middle..run.end]
}

fn cut(run: Range<usize>, cells: &mut Vec<Range<usize>>) {
    if run.len() <= LARGEST {
        cells.push(run);
        return;
    }
    for half in halves(&run) {
        cut(half, cells);
    }
}

/// Put `run` into an order of halves.
fn sort(receivers: &Receivers, run: &mut [u32]) {
    if run.len() < 2 {
        return;
    }
    let (column, axis) = longest_axis(receivers, run);
    let middle = run.len() / 2;
    run.select_nth_unstable_by(middle, |&a, &b| {
        let [x, y] = [a, b].map(|i| column[i as usize][axis]);
        x.total_cmp(&y).then(a.cmp(&b))
    });
    let (low, high) = run.split_at_mut(middle);
    if high.len() > PARALLEL {
        rayon::join(|| sort(receivers, low), || sort(receivers, high));
    } else {
        sort(receivers, low);
        sort(receivers, high);
    }
}

/// What a run is split by: the column of positions or normals, and an axis of it.
fn longest_axis<'a>(receivers: &'a Receivers, run: &[u32]) -> (&'a [Vec3], usize) {
    let normals = || run.iter().map(|&i| receivers.normal[i as usize]);
    let mean = normals().sum::<Vec3>().normalize_or_zero();
    let column = if normals().all(|normal| normal.dot(mean) > ONE_SIDE) {
        &receivers.position
    } else {
        &receivers.normal
    };
    let bounds = Bounds3::around(run.iter().map(|&i| column[i as usize]));
    (column, (bounds.max - bounds.min).max_position())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::testing::receivers_at;

    /// A grid of 64 × 64 receivers on each side of a sheet, all of one prim.
    fn sheet() -> Receivers {
        let places = (0..8192_i16).map(|i| {
            let (x, z, side) = (i % 64, i / 64 % 64, i / 4096);
            let normal = if side == 0 { Vec3::Y } else { -Vec3::Y };
            (Vec3::new(f32::from(x), 0.0, f32::from(z)), normal)
        });
        receivers_at(&places.collect::<Vec<_>>())
    }

    #[test]
    fn every_receiver_is_in_one_cell_and_cells_are_compact_and_of_one_side() {
        let receivers = sheet();
        let cells = Cells::new(&receivers, &|_| Some(0));
        let mut all = cells.order.clone();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..8192) && cells.alone.is_empty());
        let mut end = 0;
        for cell in &cells.largest {
            assert!(cell.start == end && cell.len() <= LARGEST && !cell.is_empty());
            end = cell.end;
            let all: Vec<usize> = cells.order[cell.clone()]
                .iter()
                .map(|&i| i as usize)
                .collect();
            let bounds = Bounds3::around(all.iter().map(|&i| receivers.position[i]));
            assert!(bounds.diagonal() <= 7.0 * 2.0_f32.sqrt(), "{bounds:?}");
            assert!(
                all.iter()
                    .all(|&i| receivers.normal[i] == receivers.normal[all[0]])
            );
        }
        assert_eq!(end, 8192);
    }

    #[test]
    fn few_receivers_of_a_kind_and_those_without_stay_alone() {
        let receivers = sheet();
        let few = |i: u32| Some(if (5..25).contains(&i) { 7 } else { 0 });
        let cells = Cells::new(&receivers, &few);
        assert_eq!(cells.alone, (5..25).collect::<Vec<_>>());
        assert_eq!(cells.order.len(), 8192 - 20);
        let none = |i: u32| (i >= 1000).then_some(3);
        let cells = Cells::new(&receivers, &none);
        assert_eq!(cells.alone, (0..1000).collect::<Vec<_>>());
        let nobody = Cells::new(&receivers_at(&[]), &|_| Some(0));
        assert!(nobody.order.is_empty());
    }
}
