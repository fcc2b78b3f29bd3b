//! Rays that lie close together through the tree: boxes against what all of them span.

use super::{LEAF, Leaf, Node, STACK_SIZE, WIDTH, Wide, put};
use crate::trace::ray::{FAR_MARGIN, Ray};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8};

/// What rays span along an axis, least and most: what [`Node::meet`] takes of each. Sums and products grow with each of
/// their terms even when rounded, so that no box is missed which a ray meets.
struct Span {
    enter: [f32; 2],
    leave: [f32; 2],
    /// Of one sign.
    inverse: [f32; 2],
    backward: usize,
}

impl Span {
    /// `None` if directions are of both signs.
    #[inline(always)]
    fn of(rays: &[Ray], axis: usize) -> Option<Self> {
        let first = rays.first()?;
        let mut span = Self {
            enter: [first.enter[axis]; 2],
            leave: [first.leave[axis]; 2],
            inverse: [first.line.inverse[axis]; 2],
            backward: first.line.backward[axis],
        };
        for ray in &rays[1..] {
            if ray.line.backward[axis] != span.backward {
                return None;
            }
            include(&mut span.enter, ray.enter[axis]);
            include(&mut span.leave, ray.leave[axis]);
            include(&mut span.inverse, ray.line.inverse[axis]);
        }
        Some(span)
    }

    /// Of the least and most origin, that from which a box lies nearest when entered and farthest when left.
    #[inline(always)]
    fn origins(&self) -> (f32, f32) {
        let ahead = 1 - self.backward;
        (self.enter[ahead], self.leave[self.backward])
    }
}

#[inline(always)]
fn include(range: &mut [f32; 2], value: f32) {
    range[0] = range[0].min(value);
    range[1] = range[1].max(value);
}

/// Where the farthest of rays ends, as [`Ray::limit`].
#[inline(always)]
fn limit_of(rays: &[Ray]) -> f32 {
    rays.iter().map(Ray::limit).fold(0.0, f32::max)
}

impl Wide {
    /// Calls `leaf` with leaves that any of `rays` may meet, the nearest first; it may shorten them. True once none is left,
    /// false if the rays are no beam, or `most` leaves were not enough.
    #[inline(always)]
    pub(in crate::trace) fn traverse_beam<S: Simd>(
        &self,
        simd: S,
        rays: &mut [Ray],
        most: usize,
        mut leaf: impl FnMut(Leaf, &mut [Ray]),
    ) -> bool {
        if self.nodes.is_empty() || rays.is_empty() {
            return true;
        }
        let (Some(x), Some(y), Some(z)) = (Span::of(rays, 0), Span::of(rays, 1), Span::of(rays, 2))
        else {
            return false;
        };
        let spans = [x, y, z];
        let mut limit = limit_of(rays);
        let mut left = most;
        let mut stack = [(0_u32, 0.0_f32); STACK_SIZE];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (child, near) = stack[top];
            if near > limit {
                continue;
            }
            if child & LEAF != 0 {
                if left == 0 {
                    return false;
                }
                left -= 1;
                leaf(Leaf::of(child), rays);
                limit = limit_of(rays);
                continue;
            }
            let node = &self.nodes[child as usize];
            let (near, mut children) = node.meet_spans(simd, &spans, limit);
            let near: [f32; WIDTH] = near.into();
            let first = top;
            while children != 0 {
                let child = children.trailing_zeros() as usize;
                children &= children - 1;
                let entry = (node.children[child], near[child]);
                put::<true, _>(&mut stack, first..top, entry, |entry| entry.1);
                top += 1;
            }
        }
        true
    }
}

impl Node {
    /// [`Self::meet`] for all rays between: the least distance of every child, and a bit for each that any may meet.
    #[inline(always)]
    fn meet_spans<S: Simd>(&self, simd: S, spans: &[Span; 3], limit: f32) -> (f32x8<S>, u64) {
        let mut near = f32x8::splat(simd, 0.0);
        let mut far = f32x8::splat(simd, limit);
        for (axis, span) in spans.iter().enumerate() {
            let (enter, leave) = span.origins();
            let enter = self.load(simd, axis, span.backward) - enter;
            let leave = self.load(simd, axis, 1 - span.backward) - leave;
            let [least, most] = span.inverse;
            near = near.max((enter * least).min(enter * most));
            far = far.min((leave * least).max(leave * most) * FAR_MARGIN);
        }
        (near, near.simd_le(far).to_bitmask())
    }
}
