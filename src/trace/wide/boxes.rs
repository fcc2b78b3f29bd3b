//! The children of a node: boxes against a ray, and against rays of one direction.
//!
//! Slabs, made conservative in the manner of Ize, *Robust BVH Ray Traversal* (2013): every box is a margin too large.

use super::{Node, WIDTH};
use crate::trace::ray::{FAR_MARGIN, Line, Ray};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8};

impl Node {
    /// Distance of every child from `ray`, and a bit for each that it may meet.
    #[inline(always)]
    pub(super) fn meet<S: Simd>(&self, simd: S, ray: &Ray) -> (f32x8<S>, u64) {
        let mut near = f32x8::splat(simd, 0.0);
        let mut far = f32x8::splat(simd, ray.limit());
        for axis in 0..3 {
            let inverse = ray.line.inverse[axis];
            let backward = ray.line.backward[axis];
            let enter = (self.load(simd, axis, backward) - ray.enter[axis]) * inverse;
            let leave = (self.load(simd, axis, 1 - backward) - ray.leave[axis]) * inverse;
            near = near.max(enter);
            far = far.min(leave * FAR_MARGIN);
        }
        (near, near.simd_le(far).to_bitmask())
    }

    #[inline(always)]
    pub(super) fn load<S: Simd>(&self, simd: S, axis: usize, side: usize) -> f32x8<S> {
        f32x8::from_slice(simd, &self.slabs[axis][side])
    }
}

/// The children of a node along a direction: distances from 0 by which it enters and leaves each along every axis.
/// Those of an origin are less by its own, so that boxes are sheared once for all rays of the direction.
#[derive(Clone, Copy)]
pub(super) struct Boxes<S: Simd> {
    enter: [f32x8<S>; 3],
    leave: [f32x8<S>; 3],
}

/// The same in memory, `[axis][child]`.
pub(super) struct Stored {
    pub(super) enter: [[f32; WIDTH]; 3],
    pub(super) leave: [[f32; WIDTH]; 3],
}

impl<S: Simd> Boxes<S> {
    /// Boxes grown by `margin` (a length).
    #[inline(always)]
    pub(super) fn of(simd: S, node: &Node, line: &Line, margin: f32) -> Self {
        let zero = f32x8::splat(simd, 0.0);
        let (mut enter, mut leave) = ([zero; 3], [zero; 3]);
        for axis in 0..3 {
            let (inverse, backward) = (line.inverse[axis], line.backward[axis]);
            let margin = margin * inverse.abs();
            enter[axis] = node.load(simd, axis, backward) * inverse - margin;
            leave[axis] = node.load(simd, axis, 1 - backward) * inverse + margin;
        }
        Self { enter, leave }
    }

    /// Distance of every child from the origins between `low` and `high` (distances from 0, as the boxes'), and a bit
    /// for each that a ray from them may meet.
    #[inline(always)]
    pub(super) fn meet(&self, simd: S, [low, high]: [[f32; 3]; 2], limit: f32) -> (f32x8<S>, u64) {
        let mut near = f32x8::splat(simd, 0.0);
        let mut far = f32x8::splat(simd, limit);
        for axis in 0..3 {
            near = near.max(self.enter[axis] - high[axis]);
            far = far.min(self.leave[axis] - low[axis]);
        }
        (near, near.simd_le(far).to_bitmask())
    }

    #[inline(always)]
    pub(super) fn stored(&self) -> Stored {
        let [ex, ey, ez] = self.enter;
        let [lx, ly, lz] = self.leave;
        Stored {
            enter: [ex.into(), ey.into(), ez.into()],
            leave: [lx.into(), ly.into(), lz.into()],
        }
    }
}
