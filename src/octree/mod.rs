//! [`SurfelCloud`] → [`Octree`]: Morton order, bottom-up aggregates, 9 spherical harmonics. PBGI §5.
//!
//! One thing differs from the paper: the root's children are one octree for each of six classes of normals, so that
//! the two sides of a wall never share a node and the side that faces away can be culled whole.

mod aggregate;
pub mod node;
mod order;
mod split;

pub use node::{Lobes, Node, NodeKind};

use crate::math::Bounds3;
use crate::surfels::SurfelCloud;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Most surfels of a leaf. PBGI §5: "less than e.g. 16 surfels".
pub const LEAF_SURFEL_COUNT: usize = 16;

/// The surfels of an octree, as columns in leaf order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LeafSurfels {
    /// Index of the surfel in the cloud.
    pub id: Vec<u32>,
    /// Centers, relative to the tree's origin.
    pub position: Vec<Vec3>,
    /// Unit normals.
    pub normal: Vec<Vec3>,
    /// Radius of the disk that covers the micropolygon.
    pub radius: Vec<f32>,
    /// True area.
    pub area: Vec<f32>,
    /// Reflected radiance: reflected radiosity / π.
    pub reflected: Vec<Vec3>,
    /// Emitted radiance: emission / π.
    pub emitted: Vec<Vec3>,
}

impl LeafSurfels {
    fn new(cloud: &SurfelCloud, id: Vec<u32>) -> Self {
        fn column<T: Send>(id: &[u32], value: impl Fn(usize) -> T + Sync) -> Vec<T> {
            id.par_iter().map(|&i| value(i as usize)).collect()
        }
        let per_steradian = std::f32::consts::FRAC_1_PI;
        Self {
            position: column(&id, |i| cloud.position[i]),
            normal: column(&id, |i| cloud.normal[i]),
            radius: column(&id, |i| cloud.radius[i]),
            area: column(&id, |i| cloud.area[i]),
            reflected: column(&id, |i| cloud.reflected(i) * per_steradian),
            emitted: column(&id, |i| cloud.emission[i] * per_steradian),
            id,
        }
    }

    /// Number of surfels.
    pub fn len(&self) -> usize {
        self.id.len()
    }

    /// True without surfels.
    pub fn is_empty(&self) -> bool {
        self.id.is_empty()
    }
}

/// An octree over a cloud, aggregated.
///
/// Promises: every surfel is in exactly one leaf, a leaf holds 1 to [`LEAF_SURFEL_COUNT`] of them; children stand side
/// by side behind their parent; area and power of a node are the sums over its children. The same cloud gives the same
/// bits for any number of threads.
#[derive(Debug, Clone, Default)]
pub struct Octree {
    origin: DVec3,
    nodes: Vec<Node>,
    lobes: Vec<Lobes>,
    surfels: LeafSurfels,
}

impl Octree {
    /// Build and aggregate; the cloud's surfels are copied in leaf order. O(n log n) time; coincident surfels are
    /// split by index, so any cloud ends in leaves of at most [`LEAF_SURFEL_COUNT`].
    pub fn new(cloud: &SurfelCloud) -> Self {
        let sorted = order::sort(cloud);
        let keys: Vec<u64> = sorted.par_iter().map(|entry| entry.key).collect();
        let id = sorted.into_par_iter().map(|entry| entry.id).collect();
        let surfels = LeafSurfels::new(cloud, id);
        let levels = split::levels(&keys);
        let (nodes, lobes) = aggregate::aggregate(&levels, &surfels);
        Self {
            origin: cloud.origin,
            nodes,
            lobes,
            surfels,
        }
    }

    /// World position that all positions are relative to.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// All nodes, breadth first; the root comes first. Empty for an empty cloud.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// The surfels in leaf order.
    pub fn surfels(&self) -> &LeafSurfels {
        &self.surfels
    }

    /// Direction-dependent area and power of a node of spread normals; `None` for a flat one.
    pub fn lobes(&self, node: &Node) -> Option<&Lobes> {
        node.lobes_index().map(|index| &self.lobes[index])
    }

    /// The box around all disks, relative to the origin.
    pub fn bounds(&self) -> Bounds3 {
        self.nodes
            .first()
            .map_or(Bounds3::EMPTY, |root| root.bounds)
    }

    /// Bytes held by nodes, lobes and surfels.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>()
            + self.lobes.len() * size_of::<Lobes>()
            + self.surfels.len() * (4 * size_of::<Vec3>() + 2 * size_of::<f32>() + size_of::<u32>())
    }
}
