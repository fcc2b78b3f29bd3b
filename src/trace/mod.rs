//! Rays against a scene: closest hits and occlusion, two-level where meshes are shared.

use crate::scene::{PrimId, Scene};
use glam::Vec3;

/// Where a ray meets the scene first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Along the unit direction, stage units.
    pub distance: f32,
    /// The prim.
    pub prim: PrimId,
    /// Triangle of its mesh.
    pub triangle: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2.
    pub v: f32,
    /// True if the ray came from the front side (counter-clockwise in world space after undoing mirroring: the side
    /// the object-space normal points to).
    pub front: bool,
}

/// Acceleration structure over all prims of a scene.
#[derive(Debug)]
pub struct Tracer {}

impl Tracer {
    /// Build it; cost O(n log n) in triangles, instances share theirs.
    pub fn new(scene: &Scene) -> Self {
        let _ = scene;
        todo!("trace helper")
    }

    /// First hit along the unit `direction` with distance in (0, `max_distance`).
    pub fn closest(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit> {
        let _ = (origin, direction, max_distance);
        todo!("trace helper")
    }

    /// True if anything lies along the unit `direction` closer than `max_distance`.
    pub fn occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        let _ = (origin, direction, max_distance);
        todo!("trace helper")
    }

    /// `position` lifted off its surface along the unit `geometric_normal` just enough that rays do not meet the
    /// surface itself: relative to the magnitude of the coordinates and the scene, far below 1e-4 of its size.
    pub fn lift(&self, position: Vec3, geometric_normal: Vec3) -> Vec3 {
        let _ = (position, geometric_normal);
        todo!("trace helper")
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        0
    }
}
