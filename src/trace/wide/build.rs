//! Boxes to a tree: the binned surface area heuristic.
//!
//! Wald, *On fast Construction of SAH-based Bounding Volume Hierarchies* (2007). Binning centroids, unlike PLOC, keeps
//! coplanar axis-aligned boxes compact, and no step uses an absolute tolerance.

use super::{EMPTY, Item, LEAF, LEAF_SIZE, Node, WIDTH, Wide, leaf_reference};
use crate::math::Bounds3;
use glam::Vec3;
use rayon::prelude::*;

const BINS: usize = 16;
/// Below this depth items are halved by count, which bounds the depth (and the stack) for any input.
pub(super) const MAX_SAH_DEPTH: usize = 16;
/// Subtrees of at least this many items are built in parallel.
const PARALLEL_ITEMS: usize = 8192;

struct Subtree {
    nodes: Vec<Node>,
    /// Leaves' items, each leaf padded to [`LEAF_SIZE`] by `u32::MAX`.
    order: Vec<u32>,
}

impl Wide {
    /// Build over `items` (reordered on the way). The same tree for any number of threads.
    ///
    /// # Panics
    /// With more than 2^29 items.
    pub(in crate::trace) fn build(mut items: Vec<Item>) -> Self {
        assert!(
            items.len() < 1 << 29,
            "a hierarchy holds at most 2^29 items"
        );
        if items.is_empty() {
            return Self::default();
        }
        let tree = build_node(&mut items, 0);
        Self {
            nodes: tree.nodes,
            order: tree.order,
        }
    }
}

impl Item {
    fn center(&self) -> Vec3 {
        self.bounds.center()
    }
}

fn build_node(items: &mut [Item], depth: usize) -> Subtree {
    let ranges = split_into_children(items, depth);
    let mut node = Node {
        slabs: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3],
        children: [EMPTY; WIDTH],
    };
    let mut slices = Vec::with_capacity(WIDTH);
    let mut rest = items;
    for (lane, length) in ranges.into_iter().enumerate() {
        let (slice, tail) = rest.split_at_mut(length);
        rest = tail;
        let bounds = bounds_of(slice);
        for axis in 0..3 {
            node.slabs[axis][0][lane] = bounds.min[axis];
            node.slabs[axis][1][lane] = bounds.max[axis];
        }
        slices.push(slice);
    }
    let total: usize = slices.iter().map(|slice| slice.len()).sum();
    let build = |slice: &mut &mut [Item]| -> Subtree {
        if slice.len() <= LEAF_SIZE {
            leaf(slice)
        } else {
            build_node(slice, depth + 1)
        }
    };
    let subtrees: Vec<Subtree> = if total >= PARALLEL_ITEMS {
        slices.par_iter_mut().map(build).collect()
    } else {
        slices.iter_mut().map(build).collect()
    };
    join(node, subtrees)
}

fn leaf(items: &[Item]) -> Subtree {
    let mut order = vec![u32::MAX; LEAF_SIZE];
    for (slot, item) in order.iter_mut().zip(items) {
        *slot = item.index;
    }
    Subtree {
        nodes: Vec::new(),
        order,
    }
}

/// Appends the subtrees below `node`, shifting their references.
#[expect(
    clippy::cast_possible_truncation,
    reason = "counts are bounded by 2^29 items"
)]
fn join(node: Node, subtrees: Vec<Subtree>) -> Subtree {
    let mut all = Subtree {
        nodes: vec![node],
        order: Vec::new(),
    };
    for (lane, subtree) in subtrees.into_iter().enumerate() {
        let first_node = all.nodes.len() as u32;
        let first_block = (all.order.len() / LEAF_SIZE) as u32;
        all.nodes[0].children[lane] = if subtree.nodes.is_empty() {
            let count = (subtree.order.iter())
                .filter(|&&index| index != u32::MAX)
                .count();
            leaf_reference(first_block, count as u32)
        } else {
            first_node
        };
        all.order.extend(subtree.order);
        all.nodes.extend(subtree.nodes.into_iter().map(|mut node| {
            for child in &mut node.children {
                if *child & LEAF != 0 {
                    *child += first_block * LEAF_SIZE as u32;
                } else if *child != EMPTY {
                    *child += first_node;
                }
            }
            node
        }));
    }
    all
}

/// Reorders `items` into up to [`WIDTH`] runs, splitting the one of largest area again and again (far down: the longest,
/// so that depth stays bounded); their lengths.
fn split_into_children(items: &mut [Item], depth: usize) -> Vec<usize> {
    let mut runs = vec![(0, items.len(), half_area(&bounds_of(items)))];
    while runs.len() < WIDTH {
        let widest = (0..runs.len())
            .filter(|&i| runs[i].1 > LEAF_SIZE)
            .max_by(|&a, &b| {
                if depth < MAX_SAH_DEPTH {
                    runs[a].2.total_cmp(&runs[b].2)
                } else {
                    runs[a].1.cmp(&runs[b].1)
                }
            });
        let Some(widest) = widest else { break };
        let (start, length, _) = runs[widest];
        let slice = &mut items[start..start + length];
        let left = split(slice, depth);
        let (a, b) = slice.split_at(left);
        let areas = (half_area(&bounds_of(a)), half_area(&bounds_of(b)));
        runs[widest] = (start, left, areas.0);
        runs.insert(widest + 1, (start + left, length - left, areas.1));
    }
    runs.into_iter().map(|(_, length, _)| length).collect()
}

/// Reorders `items` (at least two) into two runs; length of the first, never 0 or all.
fn split(items: &mut [Item], depth: usize) -> usize {
    let centers = Bounds3::around(items.iter().map(Item::center));
    if depth < MAX_SAH_DEPTH
        && let Some((axis, bin)) = best_split(items, &centers)
    {
        let left = partition(items, |item| bin_of(item.center(), &centers, axis) <= bin);
        if left > 0 && left < items.len() {
            return left;
        }
    }
    let axis = longest_axis(&centers);
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        (a.center()[axis].total_cmp(&b.center()[axis])).then(a.index.cmp(&b.index))
    });
    middle
}

/// Axis and last bin of the left side of the cheapest split, if any separates the centers.
fn best_split(items: &[Item], centers: &Bounds3) -> Option<(usize, usize)> {
    let mut bins = [[(Bounds3::EMPTY, 0_usize); BINS]; 3];
    for item in items {
        let center = item.center();
        for (axis, bins) in bins.iter_mut().enumerate() {
            let bin = &mut bins[bin_of(center, centers, axis)];
            *bin = (bin.0.union(item.bounds), bin.1 + 1);
        }
    }
    let mut best = None;
    let mut lowest = f32::INFINITY;
    for (axis, bins) in bins.iter().enumerate() {
        let mut right = [(Bounds3::EMPTY, 0); BINS];
        let mut sum = (Bounds3::EMPTY, 0);
        for bin in (1..BINS).rev() {
            sum = (sum.0.union(bins[bin].0), sum.1 + bins[bin].1);
            right[bin - 1] = sum;
        }
        let mut left = (Bounds3::EMPTY, 0);
        for bin in 0..BINS - 1 {
            left = (left.0.union(bins[bin].0), left.1 + bins[bin].1);
            if left.1 > 0 && right[bin].1 > 0 {
                let cost = cost_of(left) + cost_of(right[bin]);
                if cost < lowest {
                    lowest = cost;
                    best = Some((axis, bin));
                }
            }
        }
    }
    best
}

/// Leaves hold blocks of [`LEAF_SIZE`], so a started block costs as much as a full one.
#[expect(clippy::cast_precision_loss, reason = "a cost estimate")]
fn cost_of((bounds, count): (Bounds3, usize)) -> f32 {
    half_area(&bounds) * count.div_ceil(LEAF_SIZE) as f32
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "clamped to the bins"
)]
fn bin_of(center: Vec3, centers: &Bounds3, axis: usize) -> usize {
    let extent = centers.max[axis] - centers.min[axis];
    if extent > 0.0 {
        let place = (center[axis] - centers.min[axis]) / extent * BINS as f32;
        (place.max(0.0) as usize).min(BINS - 1)
    } else {
        0
    }
}

/// Stable two-sided partition in place would need memory; order within a side is fixed by the input all the same.
fn partition(items: &mut [Item], is_left: impl Fn(&Item) -> bool) -> usize {
    let mut left = 0;
    for i in 0..items.len() {
        if is_left(&items[i]) {
            items.swap(left, i);
            left += 1;
        }
    }
    left
}

fn longest_axis(bounds: &Bounds3) -> usize {
    let size = bounds.max - bounds.min;
    (0..3)
        .max_by(|&a, &b| size[a].total_cmp(&size[b]))
        .expect("there are three axes")
}

fn bounds_of(items: &[Item]) -> Bounds3 {
    items
        .iter()
        .fold(Bounds3::EMPTY, |all, item| all.union(item.bounds))
}

fn half_area(bounds: &Bounds3) -> f32 {
    if bounds.is_empty() {
        return 0.0;
    }
    let size = bounds.max - bounds.min;
    size.x * size.y + size.y * size.z + size.z * size.x
}
