//! An eight-way bounding volume hierarchy, and rays through it to its leaves.

mod beam;
mod boxes;
mod build;
mod extent;
mod packet;

use super::ray::Ray;
use crate::math::Bounds3;
use fearless_simd::Simd;
pub(super) use packet::{Column, LANES, PACKET_SIZE, Packet, ROWS, load, row_of};
use std::ops::Range;

/// Most items of one leaf.
pub(super) const LEAF_SIZE: usize = 4;
const WIDTH: usize = 8;
/// `WIDTH - 1` entries a level: [`build::MAX_SAH_DEPTH`] levels and 11 that halve three times each (2^33 items).
const STACK_SIZE: usize = (WIDTH - 1) * (build::MAX_SAH_DEPTH + 11) + 1;

/// Order of children in which a search ends soonest for the closest hit.
pub(super) const NEAREST_FIRST: bool = true;
/// The same for any hit. Rays start on surfaces, whose own neighborhood holds many boxes and seldom blocks: packets end
/// 1.3 (bunny, box) to 1.7 times (teapots, displaced ball) as soon as with the nearest first, 0.8 to 0.9 times among
/// leaves that block from near (foliage). Children by their area gain less: 1.1 (teapots) to 1.4.
pub(super) const FARTHEST_FIRST: bool = false;

/// A box to be put into the tree.
#[derive(Debug, Clone, Copy)]
pub(super) struct Item {
    /// Its extent.
    pub(super) bounds: Bounds3,
    /// What it stands for.
    pub(super) index: u32,
}

/// Stands for no item where a leaf has fewer than [`LEAF_SIZE`].
pub(super) const NONE: u32 = u32::MAX;

/// Child references: inner node index, or `LEAF | block << 2 | count - 1`, or `EMPTY`.
const LEAF: u32 = 1 << 31;
const EMPTY: u32 = u32::MAX >> 1;

/// Of the `count` items at place `block * LEAF_SIZE`.
const fn leaf_reference(block: u32, count: u32) -> u32 {
    LEAF | (block << LEAF_SIZE.trailing_zeros()) | (count - 1)
}

/// Some items next to each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leaf {
    /// `block * LEAF_SIZE` is its place in [`Wide::order`].
    pub(super) block: usize,
    /// Its items, 1…[`LEAF_SIZE`].
    pub(super) count: usize,
}

impl Leaf {
    #[inline(always)]
    const fn of(reference: u32) -> Self {
        let place = (reference & !LEAF) as usize;
        Self {
            block: place / LEAF_SIZE,
            count: place % LEAF_SIZE + 1,
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
struct Node {
    /// `[axis][low, high][child]`; unused children have inverted boxes.
    slabs: [[[f32; WIDTH]; 2]; 3],
    children: [u32; WIDTH],
}

/// The tree. Items of a leaf are contiguous in [`Self::order`].
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Wide {
    nodes: Vec<Node>,
    /// Item indices (`Item::index`) in leaf order; [`NONE`] pads every leaf to `LEAF_SIZE`.
    pub(super) order: Vec<u32>,
}

impl Wide {
    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>() + self.order.capacity() * size_of::<u32>()
    }

    /// Calls `leaf` for the leaves that `ray` may meet, the children of a node in `ORDER`. `leaf` may shorten the ray; it
    /// returns true to end the search.
    #[inline(always)]
    pub(super) fn traverse<const ORDER: bool, S: Simd>(
        &self,
        simd: S,
        ray: &mut Ray,
        mut leaf: impl FnMut(Leaf, &mut Ray) -> bool,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let mut stack = [(0_u32, 0.0_f32); STACK_SIZE];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (child, near) = stack[top];
            if near > ray.limit() {
                continue;
            }
            if child & LEAF != 0 {
                if leaf(Leaf::of(child), ray) {
                    return;
                }
                continue;
            }
            let node = &self.nodes[child as usize];
            let (near, mut children) = node.meet(simd, ray);
            let near: [f32; WIDTH] = near.into();
            let first = top;
            while children != 0 {
                let child = children.trailing_zeros() as usize;
                children &= children - 1;
                let entry = (node.children[child], near[child]);
                put::<ORDER, _>(&mut stack, first..top, entry, |entry| entry.1);
                top += 1;
            }
        }
    }
}

/// Put `entry` among those of `stack` at `places`, which `ORDER` holds for, and push those behind it on by one: the nearest is
/// taken off first, or last where `ORDER` is false.
#[inline(always)]
fn put<const ORDER: bool, E: Copy>(
    stack: &mut [E; STACK_SIZE],
    places: Range<usize>,
    entry: E,
    near: impl Fn(&E) -> f32,
) {
    let mut at = places.end;
    while at > places.start && (near(&stack[at - 1]) < near(&entry)) == ORDER {
        stack[at] = stack[at - 1];
        at -= 1;
    }
    stack[at] = entry;
}
