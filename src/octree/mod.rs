//! [`SurfelCloud`] → [`Octree`]: Morton order, bottom-up aggregates, 9 spherical harmonics. PBGI §5.

use crate::surfels::SurfelCloud;

/// An octree over a cloud, aggregated.
#[derive(Debug, Clone)]
pub struct Octree {}

impl Octree {
    /// Build and aggregate; the cloud's surfels are copied in leaf order.
    pub fn new(cloud: &SurfelCloud) -> Self {
        let _ = cloud;
        todo!("octree helper")
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        todo!("octree helper")
    }
}
