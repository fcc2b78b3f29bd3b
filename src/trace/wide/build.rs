//! Boxes to a tree: the binned surface area heuristic.
//!
//! Wald, *On fast Construction of SAH-based Bounding Volume Hierarchies* (2007). Binning centroids, unlike PLOC, keeps
//! coplanar axis-aligned boxes compact, and no step uses an absolute tolerance.

use super::extent::{Bound, Extent};
use super::{EMPTY, Item, LEAF, LEAF_SIZE, NONE, Node, WIDTH, Wide, leaf_reference};
use glam::Vec4;
use rayon::prelude::*;

/// Bins along an axis, and of runs of at most [`SHORT`] items: most splits are of those. With 8 of 16 for all, rays took
/// as long.
const BINS: usize = 16;
const FEW_BINS: usize = 8;
const SHORT: usize = 16;
/// Below this depth items are halved by count, which bounds the depth (and the stack) for any input.
pub(super) const MAX_SAH_DEPTH: usize = 16;
/// Subtrees of at least this many items are built in parallel.
const PARALLEL_ITEMS: usize = 8192;
/// About so many items of a run tell where to split it. Of a ball of 1.08 M triangles the hierarchy is built in 0.9 of the
/// time, and rays take as long as with all.
const SAMPLE: usize = 1024;

#[derive(Default)]
struct Subtree {
    nodes: Vec<Node>,
    /// Leaves' items, each leaf padded to [`LEAF_SIZE`] by [`NONE`].
    order: Vec<u32>,
}

/// Neighbors in the order of items.
#[derive(Debug, Clone, Copy)]
struct Run {
    start: usize,
    length: usize,
    extent: Extent,
}

/// A place between two bins.
#[derive(Debug, Clone, Copy)]
struct Split {
    axis: usize,
    /// The last on the left.
    bin: usize,
}

impl Wide {
    /// Build over `items`, of which those with a bound that is not finite are left out. The same tree for any number of
    /// threads.
    ///
    /// # Panics
    /// With more than 2^29 items.
    pub(in crate::trace) fn build(items: impl IntoIterator<Item = Item>) -> Self {
        Self::over(items.into_iter().map(Bound::of).collect())
    }

    /// [`Self::build`] over items that are made by all threads.
    pub(in crate::trace) fn build_at_once(
        items: impl IndexedParallelIterator<Item = Item>,
    ) -> Self {
        Self::over(items.map(Bound::of).collect())
    }

    fn over(mut bounds: Vec<Bound>) -> Self {
        bounds.retain(Bound::is_finite);
        assert!(
            bounds.len() < 1 << 29,
            "a hierarchy holds at most 2^29 items"
        );
        if bounds.is_empty() {
            return Self::default();
        }
        let extents = (bounds.par_chunks(PARALLEL_ITEMS)).map(Extent::around);
        let extent = extents.reduce(|| Extent::EMPTY, Extent::union);
        let mut tree = Subtree::default();
        tree.grow(&mut bounds, extent, 0);
        Self {
            nodes: tree.nodes,
            order: tree.order,
        }
    }
}

impl Subtree {
    /// Append a node over `items` and all below it.
    fn grow(&mut self, items: &mut [Bound], extent: Extent, depth: usize) {
        let (runs, count) = split_into_children(items, extent, depth);
        let runs = &runs[..count];
        let at = self.nodes.len();
        self.nodes.push(node_around(runs));
        if items.len() < PARALLEL_ITEMS {
            for (lane, run) in runs.iter().enumerate() {
                let child = self.reference(run.length);
                self.nodes[at].children[lane] = child;
                self.grow_child(&mut items[run.start..][..run.length], run.extent, depth);
            }
            return;
        }
        let mut rest = items;
        let mut slices = Vec::with_capacity(WIDTH);
        for run in runs {
            let (slice, tail) = rest.split_at_mut(run.length);
            slices.push((slice, run.extent));
            rest = tail;
        }
        let build = |(slice, extent): (&mut [Bound], Extent)| {
            let mut subtree = Self::default();
            subtree.grow_child(slice, extent, depth);
            subtree
        };
        let subtrees: Vec<Self> = slices.into_par_iter().map(build).collect();
        for (lane, (subtree, run)) in subtrees.into_iter().zip(runs).enumerate() {
            let child = self.reference(run.length);
            self.nodes[at].children[lane] = child;
            self.append(subtree);
        }
    }

    /// Append what stands for a child of a node at `depth`.
    fn grow_child(&mut self, items: &mut [Bound], extent: Extent, depth: usize) {
        if items.len() > LEAF_SIZE {
            self.grow(items, extent, depth + 1);
            return;
        }
        let first = self.order.len();
        self.order.resize(first + LEAF_SIZE, NONE);
        for (slot, item) in self.order[first..].iter_mut().zip(items) {
            *slot = item.index();
        }
    }

    /// What a node calls a child of so many items that is appended next.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "counts are bounded by 2^29 items"
    )]
    fn reference(&self, length: usize) -> u32 {
        if length > LEAF_SIZE {
            self.nodes.len() as u32
        } else {
            leaf_reference((self.order.len() / LEAF_SIZE) as u32, length as u32)
        }
    }

    /// Append a subtree, shifting its references.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "counts are bounded by 2^29 items"
    )]
    fn append(&mut self, subtree: Self) {
        let (first_node, first_item) = (self.nodes.len() as u32, self.order.len() as u32);
        self.order.extend(subtree.order);
        self.nodes.extend(subtree.nodes.into_iter().map(|mut node| {
            for child in &mut node.children {
                if *child & LEAF != 0 {
                    *child += first_item;
                } else if *child != EMPTY {
                    *child += first_node;
                }
            }
            node
        }));
    }
}

/// A node whose children are these runs, but for what it calls them.
fn node_around(runs: &[Run]) -> Node {
    let mut node = Node {
        slabs: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3],
        children: [EMPTY; WIDTH],
    };
    for (lane, run) in runs.iter().enumerate() {
        for axis in 0..3 {
            node.slabs[axis][0][lane] = run.extent.low[axis];
            node.slabs[axis][1][lane] = run.extent.high[axis];
        }
    }
    node
}

/// Reorders `items` into up to [`WIDTH`] runs, splitting the one of largest area again and again (far down: the longest,
/// so that depth stays bounded).
fn split_into_children(items: &mut [Bound], extent: Extent, depth: usize) -> ([Run; WIDTH], usize) {
    let whole = Run {
        start: 0,
        length: items.len(),
        extent,
    };
    let mut runs = [whole; WIDTH];
    let mut areas = [extent.half_area(); WIDTH];
    let mut count = 1;
    while count < WIDTH {
        let widest = (0..count)
            .filter(|&i| runs[i].length > LEAF_SIZE)
            .max_by(|&a, &b| {
                if depth < MAX_SAH_DEPTH {
                    areas[a].total_cmp(&areas[b])
                } else {
                    runs[a].length.cmp(&runs[b].length)
                }
            });
        let Some(widest) = widest else { break };
        let Run {
            start,
            length,
            extent,
        } = runs[widest];
        let (left, sides) = split(&mut items[start..][..length], extent, depth);
        let halves = [(start, left), (start + left, length - left)];
        runs.copy_within(widest + 1..count, widest + 2);
        areas.copy_within(widest + 1..count, widest + 2);
        for (side, ((start, length), extent)) in halves.into_iter().zip(sides).enumerate() {
            runs[widest + side] = Run {
                start,
                length,
                extent,
            };
            areas[widest + side] = extent.half_area();
        }
        count += 1;
    }
    (runs, count)
}

/// Reorders `items` (at least two) into two runs; length of the first, never 0 or all, and what each spans.
fn split(items: &mut [Bound], extent: Extent, depth: usize) -> (usize, [Extent; 2]) {
    if depth < MAX_SAH_DEPTH {
        let found = if items.len() <= SHORT {
            divide::<FEW_BINS>(items, &extent)
        } else {
            divide::<BINS>(items, &extent)
        };
        if let Some(found) = found {
            return found;
        }
    }
    let axis = extent.longest_axis();
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        (a.center()[axis].total_cmp(&b.center()[axis])).then(a.index().cmp(&b.index()))
    });
    let (left, right) = items.split_at(middle);
    (middle, [Extent::around(left), Extent::around(right)])
}

/// The same at the cheapest place between bins; `None` if no place separates the centers.
fn divide<const BINS: usize>(items: &mut [Bound], extent: &Extent) -> Option<(usize, [Extent; 2])> {
    let grid = Grid::<BINS>::over(extent);
    let step = items.len().div_ceil(SAMPLE);
    let Split { axis, bin } = (grid.best_split(items, step))
        .or_else(|| (step > 1).then(|| grid.best_split(items, 1)).flatten())?;
    let left = grid.partition(items, Split { axis, bin });
    (left > 0 && left < items.len()).then(|| {
        let (first, second) = items.split_at(left);
        (left, [Extent::around(first), Extent::around(second)])
    })
}

/// Bins over the centers of items, along each axis.
#[derive(Debug, Clone, Copy)]
struct Grid<const BINS: usize> {
    low: Vec4,
    /// Bins a length; 0 along axes on which all centers are one.
    scale: Vec4,
}

impl<const BINS: usize> Grid<BINS> {
    #[expect(clippy::cast_precision_loss, reason = "a few bins")]
    fn over(extent: &Extent) -> Self {
        let size = extent.high_center - extent.low_center;
        let scale = size.map(|size| match BINS as f32 / size {
            scale if scale.is_finite() => scale,
            _ => 0.0,
        });
        Self {
            low: extent.low_center,
            scale,
        }
    }

    /// The bin of an item along each axis.
    fn bins_of(&self, item: Bound) -> [usize; 3] {
        let place = (item.center() - self.low) * self.scale;
        let [x, y, z, _] = place.as_uvec4().to_array();
        [x, y, z].map(|bin| (bin as usize).min(BINS - 1))
    }

    /// Reorders `items` so that those up to a place come first; their number. Without a branch: which side an item is on
    /// cannot be foretold. The order within a side is fixed by that of the items.
    #[expect(clippy::cast_precision_loss, reason = "a few bins")]
    fn partition(&self, items: &mut [Bound], Split { axis, bin }: Split) -> usize {
        let (low, scale, limit) = (self.low[axis], self.scale[axis], (bin + 1) as f32);
        let mut left = 0;
        for i in 0..items.len() {
            let item = items[i];
            let place = (item.low[axis] + item.high[axis] - low) * scale;
            items[i] = items[left];
            items[left] = item;
            left += usize::from(place < limit);
        }
        left
    }

    /// The cheapest place for every `step`th item, if any separates the centers of these.
    fn best_split(&self, items: &[Bound], step: usize) -> Option<Split> {
        let mut bins = [[(Extent::NO_BOX, 0_u32); BINS]; 3];
        for &item in items.iter().step_by(step) {
            for (bins, bin) in bins.iter_mut().zip(self.bins_of(item)) {
                let (sum, count) = &mut bins[bin];
                *sum = joined(*sum, (item.low, item.high));
                *count += 1;
            }
        }
        let mut best = None;
        let mut lowest = f32::INFINITY;
        for (axis, bins) in bins.iter().enumerate() {
            if self.scale[axis] == 0.0 {
                continue;
            }
            let mut right = [f32::INFINITY; BINS];
            let mut sum = (Extent::NO_BOX, 0);
            for bin in (1..BINS).rev() {
                sum = (joined(sum.0, bins[bin].0), sum.1 + bins[bin].1);
                right[bin - 1] = cost_of(sum);
            }
            let mut left = (Extent::NO_BOX, 0);
            for bin in 0..BINS - 1 {
                left = (joined(left.0, bins[bin].0), left.1 + bins[bin].1);
                let cost = cost_of(left) + right[bin];
                if cost < lowest {
                    lowest = cost;
                    best = Some(Split { axis, bin });
                }
            }
        }
        best
    }
}

fn joined(a: (Vec4, Vec4), b: (Vec4, Vec4)) -> (Vec4, Vec4) {
    (a.0.min(b.0), a.1.max(b.1))
}

/// Leaves hold blocks of [`LEAF_SIZE`], so a started block costs as much as a full one; no items are no side.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "a cost estimate; a leaf is small"
)]
fn cost_of(((low, high), count): ((Vec4, Vec4), u32)) -> f32 {
    if count == 0 {
        return f32::INFINITY;
    }
    super::extent::half_area(high - low) * count.div_ceil(LEAF_SIZE as u32) as f32
}
