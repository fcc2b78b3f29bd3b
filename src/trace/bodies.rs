//! Bodies of any shape, told by the boxes around them, and the nearest that a ray meets.

use super::ray::Ray;
use super::triangles::{item, margin_of};
use super::wide::{LEAF_SIZE, NEAREST_FIRST, Wide};
use crate::math::Bounds3;
use fearless_simd::{Level, Simd, dispatch};
use glam::Vec3;

/// The boxes around some bodies, under a hierarchy.
#[derive(Debug)]
pub struct Bodies {
    tree: Wide,
    level: Level,
}

impl Bodies {
    /// Of the boxes around them, a number each, which need not be those of all bodies.
    pub fn new(boxes: &[(u32, Bounds3)]) -> Self {
        let all = (boxes.iter()).fold(Bounds3::EMPTY, |all, (_, bounds)| all.union(*bounds));
        let margin = margin_of(all);
        Self {
            tree: Wide::build(boxes.iter().map(|&numbered| item(numbered, margin))),
            level: Level::new(),
        }
    }

    /// Distance and number of the body that the ray from `origin` along the unit `direction` meets first, nearer than
    /// `max_distance`; of several at the same distance the first. `meet` tells the distance to a body, `None` where the ray
    /// misses it; it is asked only about bodies whose boxes the ray meets. None if a number is not finite (`max_distance` may
    /// be infinite).
    pub fn first(
        &self,
        (origin, direction): (Vec3, Vec3),
        max_distance: f32,
        meet: impl Fn(u32) -> Option<f32>,
    ) -> Option<(f32, u32)> {
        let mut ray = Ray::new(origin, direction, max_distance)?;
        dispatch!(self.level, simd => self.find_first(simd, &mut ray, &meet))
    }

    #[inline(always)]
    fn find_first<S: Simd>(
        &self,
        simd: S,
        ray: &mut Ray,
        meet: &impl Fn(u32) -> Option<f32>,
    ) -> Option<(f32, u32)> {
        let mut best = None;
        self.tree
            .traverse::<NEAREST_FIRST, S>(simd, ray, |leaf, ray| {
                let first = leaf.block * LEAF_SIZE;
                for &index in &self.tree.order[first..first + leaf.count] {
                    let nearer = meet(index).filter(|&distance| {
                        distance < ray.max_distance
                            || distance == ray.max_distance && index < ray.before
                    });
                    if let Some(distance) = nearer {
                        (ray.max_distance, ray.before) = (distance, index);
                        best = Some((distance, index));
                    }
                }
                false
            });
        best
    }
}
