//! Finding the surfel at a point of space, for clouds that come from files.

use super::SurfelCloud;
use glam::Vec3;

/// A uniform hash grid over a cloud.
#[derive(Debug, Clone)]
pub struct NearestMap {}

impl NearestMap {
    /// Index the cloud.
    pub fn new(cloud: &SurfelCloud) -> Self {
        let _ = cloud;
        todo!("bake helper")
    }

    /// The surfel whose disk lies closest to `position` (in its own radii) among those facing `normal`; `None` if none
    /// is within two radii.
    pub fn surfel_at(&self, cloud: &SurfelCloud, position: Vec3, normal: Vec3) -> Option<u32> {
        let _ = (cloud, position, normal);
        todo!("bake helper")
    }
}
