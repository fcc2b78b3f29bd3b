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
pub enum Element {
    /// A cluster, small and outside its own ball.
    Cluster(Node),
    /// A surfel of a leaf, by its index in leaf order.
    Surfel(usize, Node),
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
pub fn traverse(
    octree: &Octree,
    (position, normal): (Vec3, Vec3),
    settings: &CutSettings,
    mut visit: impl FnMut(Element),
) -> CutCounts {
    let mut counts = CutCounts::default();
    let mut pending: Vec<usize> = (0..octree.node_count().min(1)).collect();
    while let Some(index) = pending.pop() {
        let node = octree.node(index);
        counts.nodes += 1;
        if is_unseen(&node, position, normal, settings.max_distance) {
            continue;
        }
        if is_small(&node, position, settings.max_solid_angle) {
            counts.clusters += 1;
            visit(Element::Cluster(node));
            continue;
        }
        match node.kind() {
            NodeKind::Inner(children) => pending.extend(children.rev()),
            NodeKind::Leaf(surfels) => {
                for surfel in surfels {
                    if is_surfel_seen(octree, surfel, (position, normal), settings.max_distance) {
                        counts.surfels += 1;
                        visit(Element::Surfel(surfel, node));
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
    let offset = surfels.position(surfel) - position;
    surfels.normal(surfel).dot(offset) < 0.0
        && offset.dot(normal) + surfels.radius(surfel) > 0.0
        && offset.length_squared() <= max_distance * max_distance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surfels::SurfelCloud;

    /// A grid of `side`² unit squares at `height`, facing down.
    fn ceiling(side: usize, height: f32) -> Octree {
        let count = side * side;
        let place = |i: usize| Vec3::new((i % side) as f32, (i / side) as f32, height);
        Octree::new(&SurfelCloud {
            position: (0..count).map(place).collect(),
            normal: vec![Vec3::NEG_Z; count],
            radius: vec![0.75; count],
            area: vec![1.0; count],
            radiosity: vec![Vec3::ONE; count],
            albedo: vec![Vec3::ONE; count],
            emission: vec![Vec3::ZERO; count],
            prim: vec![0; count],
            ..SurfelCloud::default()
        })
    }

    fn cut(octree: &Octree, place: (Vec3, Vec3), settings: CutSettings) -> (f32, CutCounts) {
        let mut area = 0.0;
        let counts = traverse(octree, place, &settings, |element| {
            area += match element {
                Element::Cluster(node) => node.area,
                Element::Surfel(surfel, _) => octree.surfels().area(surfel),
            };
        });
        (area, counts)
    }

    /// Areas of surfels are kept as ratios off by at most that.
    const AREA_ROUNDING: f32 = 1.0 / 8192.0;

    const FINE: CutSettings = CutSettings {
        max_solid_angle: 0.03,
        max_distance: f32::INFINITY,
    };

    #[test]
    fn every_cut_through_what_is_visible_holds_all_of_its_area() {
        let octree = ceiling(64, 50.0);
        let below = (Vec3::new(30.0, 30.0, 0.0), Vec3::Z);
        for max_solid_angle in [0.0, 0.01, 0.03, 0.3] {
            let (area, counts) = cut(
                &octree,
                below,
                CutSettings {
                    max_solid_angle,
                    ..FINE
                },
            );
            assert!((area / 4096.0 - 1.0).abs() < AREA_ROUNDING, "{area}");
            assert_eq!(counts.surfels == 4096, max_solid_angle == 0.0);
        }
    }

    #[test]
    fn coarser_cuts_visit_fewer_nodes() {
        let octree = ceiling(64, 50.0);
        let below = (Vec3::new(30.0, 30.0, 0.0), Vec3::Z);
        let visited = |max_solid_angle| {
            cut(
                &octree,
                below,
                CutSettings {
                    max_solid_angle,
                    ..FINE
                },
            )
            .1
        };
        assert!(visited(0.3).nodes < visited(0.03).nodes);
        assert!(visited(0.03).nodes < visited(0.01).nodes);
    }

    #[test]
    fn what_is_behind_averted_or_too_far_is_left_out() {
        let octree = ceiling(16, 5.0);
        let looking_down = (Vec3::new(8.0, 8.0, 0.0), Vec3::NEG_Z);
        let above = (Vec3::new(8.0, 8.0, 30.0), Vec3::NEG_Z);
        let far = (Vec3::new(8.0, 8.0, 0.0), Vec3::Z);
        assert_eq!(cut(&octree, looking_down, FINE).0, 0.0);
        assert_eq!(cut(&octree, above, FINE).0, 0.0);
        let near_only = CutSettings {
            max_distance: 5.2,
            ..FINE
        };
        let (area, _) = cut(&octree, far, near_only);
        // The disk of radius √(5.2² − 5²) on the ceiling has the area 6.4.
        assert!(
            (4.0..=9.0 * (1.0 + AREA_ROUNDING)).contains(&area),
            "{area}"
        );
    }
}
