//! Sorted keys → the tree's shape, level by level.

use super::LEAF_SURFEL_COUNT;
use super::order::CLASS_SHIFT;
use rayon::prelude::*;
use std::ops::Range;

/// A node's surfels (in leaf order) and its children (within the next level; empty for a leaf).
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Cell {
    pub surfels: Range<usize>,
    pub children: Range<usize>,
}

/// Most children of a node.
const MOST: usize = 8;

/// Where the parts of a range end; none for a leaf.
#[derive(Debug, Clone, Copy, Default)]
struct Parts {
    ends: [usize; MOST],
    count: usize,
}

impl Parts {
    fn push(&mut self, end: usize) {
        self.ends[self.count] = end;
        self.count += 1;
    }

    /// The parts, the first of which begins at `start`.
    fn ranges(&self, start: usize) -> impl Iterator<Item = Range<usize>> {
        let ends = &self.ends[..self.count];
        let starts = std::iter::once(start).chain(ends.iter().copied());
        starts.zip(ends).map(|(start, &end)| start..end)
    }
}

/// All levels of the tree over the sorted `keys`, the root's first; the cells of a level in the order of the keys.
/// No level for no key.
pub(super) fn levels(keys: &[u64]) -> Vec<Vec<Cell>> {
    let mut levels = Vec::new();
    let whole = 0..keys.len();
    let mut ranges = vec![whole];
    if keys.is_empty() {
        return levels;
    }
    while !ranges.is_empty() {
        let split = |range: &Range<usize>| children(keys, range);
        let parts: Vec<Parts> = ranges.par_iter().with_min_len(FEW).map(split).collect();
        let mut below = Vec::with_capacity(parts.iter().map(|parts| parts.count).sum());
        let cells = ranges.into_iter().zip(&parts).map(|(surfels, parts)| {
            let first = below.len();
            below.extend(parts.ranges(surfels.start));
            Cell {
                surfels,
                children: first..below.len(),
            }
        });
        levels.push(cells.collect());
        ranges = below;
    }
    levels
}

/// Fewer cells than this are not worth a thread.
const FEW: usize = 64;

/// The non-empty parts of `range`; none when it is a leaf. Classes of normals are split however few surfels there are,
/// octants with one part only are skipped, and equal keys are cut by index.
fn children(keys: &[u64], range: &Range<usize>) -> Parts {
    let (first, last) = (keys[range.start], keys[range.end - 1]);
    let one_class = first >> CLASS_SHIFT == last >> CLASS_SHIFT;
    if range.len() <= LEAF_SURFEL_COUNT && one_class {
        return Parts::default();
    }
    match (first ^ last).checked_ilog2() {
        Some(highest_bit) => octants(keys, range, highest_bit / 3 * 3),
        None => eighths(range),
    }
}

/// Split where the key's bits from `shift` up change.
fn octants(keys: &[u64], range: &Range<usize>, shift: u32) -> Parts {
    let mut parts = Parts::default();
    let mut start = range.start;
    while start < range.end {
        let octant = keys[start] >> shift;
        start += keys[start..range.end].partition_point(|key| key >> shift == octant);
        parts.push(start);
    }
    parts
}

/// Split coincident surfels into up to eight parts whose sizes differ by one at most.
fn eighths(range: &Range<usize>) -> Parts {
    let mut parts = Parts::default();
    let count = range.len().div_ceil(LEAF_SURFEL_COUNT).min(MOST);
    for i in 1..=count {
        parts.push(range.start + range.len() * i / count);
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_million_equal_keys_end_in_leaves_of_sixteen() {
        let levels = levels(&vec![42; 1_000_000]);
        let leaves = levels
            .iter()
            .flatten()
            .filter(|cell| cell.children.is_empty());
        let counts: Vec<usize> = leaves.map(|cell| cell.surfels.len()).collect();
        assert_eq!(counts.iter().sum::<usize>(), 1_000_000);
        assert!(counts.iter().all(|&n| n > 0 && n <= LEAF_SURFEL_COUNT));
        assert!(levels.len() < 8, "{}", levels.len());
    }

    #[test]
    fn two_classes_are_split_even_when_few() {
        let levels = levels(&[1, 2, 1 << CLASS_SHIFT]);
        assert_eq!(levels.len(), 2);
        assert_eq!(levels[1][0].surfels, 0..2);
        assert_eq!(levels[1][1].surfels, 2..3);
    }

    #[test]
    fn no_keys_make_no_level_and_one_key_one_leaf() {
        assert!(levels(&[]).is_empty());
        assert_eq!(
            levels(&[7]),
            [[Cell {
                surfels: 0..1,
                children: 0..0
            }]]
        );
    }
}
