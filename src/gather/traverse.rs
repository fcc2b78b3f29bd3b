//! The cut through the octree that one receiver sees: clusters where they are small enough, else single surfels.
//! PBGI §6.1.

use crate::octree::{Node, NodeKind, Octree};
use glam::Vec3;

/// What decides how deep the tree is opened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutSettings {
    /// Largest solid angle (sr) of a cluster that stands for its children: its area, or that of the patch it is
    /// scattered over, by squared distance. Not foreshortened: a wall seen at a grazing angle must be opened too.
    pub max_solid_angle: f32,
    /// What lies farther away is not seen.
    pub max_distance: f32,
}

/// A part of the cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Element<'a> {
    /// A cluster, small and outside its own ball.
    Cluster(&'a Node),
    /// A surfel, by its index in leaf order.
    Surfel(usize),
}

/// Work done for a receiver, or for many.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CutCounts {
    /// Nodes looked at.
    pub nodes: u64,
    /// Clusters in the cut.
    pub clusters: u64,
    /// Surfels in the cut.
    pub surfels: u64,
}

/// Hand every element of the cut seen from `position` to `visit`, in the order of the tree. Elements wholly under the
/// horizon of the unit `normal`, wholly averted or too far away are left out.
pub fn traverse<'a>(
    octree: &'a Octree,
    (position, normal): (Vec3, Vec3),
    settings: &CutSettings,
    mut visit: impl FnMut(Element<'a>),
) -> CutCounts {
    let mut counts = CutCounts::default();
    let mut pending: Vec<&Node> = octree.nodes().first().into_iter().collect();
    while let Some(node) = pending.pop() {
        counts.nodes += 1;
        if is_unseen(node, position, normal, settings.max_distance) {
            continue;
        }
        if is_small(node, position, settings.max_solid_angle) {
            counts.clusters += 1;
            visit(Element::Cluster(node));
            continue;
        }
        match node.kind() {
            NodeKind::Inner(children) => pending.extend(octree.nodes()[children].iter().rev()),
            NodeKind::Leaf(surfels) => {
                for surfel in surfels {
                    if is_surfel_seen(octree, surfel, (position, normal), settings.max_distance) {
                        counts.surfels += 1;
                        visit(Element::Surfel(surfel));
                    }
                }
            }
        }
    }
    counts
}

/// True if nothing of `node` can be seen.
fn is_unseen(node: &Node, position: Vec3, normal: Vec3, max_distance: f32) -> bool {
    let offset = node.center - position;
    offset.dot(normal) + node.radius <= 0.0
        || offset.length() - node.radius > max_distance
        || node.is_averted_from(position)
}

/// True if `node` may stand for its children.
fn is_small(node: &Node, position: Vec3, max_solid_angle: f32) -> bool {
    let squared_distance = node.center.distance_squared(position);
    squared_distance > node.radius * node.radius
        && node.area.max(node.extent_area()) <= max_solid_angle * squared_distance
}

/// True if the front of the surfel is seen, and part of its disk lies above the horizon.
fn is_surfel_seen(
    octree: &Octree,
    surfel: usize,
    (position, normal): (Vec3, Vec3),
    max_distance: f32,
) -> bool {
    let surfels = octree.surfels();
    let offset = surfels.position[surfel] - position;
    surfels.normal[surfel].dot(offset) < 0.0
        && offset.dot(normal) + surfels.radius[surfel] > 0.0
        && offset.length_squared() <= max_distance * max_distance
}
