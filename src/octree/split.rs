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
        let parts: Vec<Vec<Range<usize>>> = ranges
            .par_iter()
            .map(|range| children(keys, range))
            .collect();
        let mut next = 0;
        let cells = ranges.into_iter().zip(&parts).map(|(surfels, parts)| {
            let first = next;
            next += parts.len();
            Cell {
                surfels,
                children: first..next,
            }
        });
        levels.push(cells.collect());
        ranges = parts.into_iter().flatten().collect();
    }
    levels
}

/// The non-empty parts of `range`; none when it is a leaf. Classes of normals are split however few surfels there are,
/// octants with one part only are skipped, and equal keys are cut by index.
fn children(keys: &[u64], range: &Range<usize>) -> Vec<Range<usize>> {
    let (first, last) = (keys[range.start], keys[range.end - 1]);
    let one_class = first >> CLASS_SHIFT == last >> CLASS_SHIFT;
    if range.len() <= LEAF_SURFEL_COUNT && one_class {
        return Vec::new();
    }
    match (first ^ last).checked_ilog2() {
        Some(highest_bit) => octants(keys, range, highest_bit / 3 * 3),
        None => eighths(range),
    }
}

/// Split where the key's bits from `shift` up change.
fn octants(keys: &[u64], range: &Range<usize>, shift: u32) -> Vec<Range<usize>> {
    let mut parts = Vec::new();
    let mut start = range.start;
    while start < range.end {
        let octant = keys[start] >> shift;
        let length = keys[start..range.end].partition_point(|key| key >> shift == octant);
        parts.push(start..start + length);
        start += length;
    }
    parts
}

/// Split coincident surfels into up to eight parts whose sizes differ by one at most.
fn eighths(range: &Range<usize>) -> Vec<Range<usize>> {
    let count = range.len().div_ceil(LEAF_SURFEL_COUNT).min(8);
    (0..count)
        .map(|i| range.start + range.len() * i / count..range.start + range.len() * (i + 1) / count)
        .collect()
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
