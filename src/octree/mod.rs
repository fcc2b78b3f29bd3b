//! [`SurfelCloud`] → [`Octree`]: Morton order, bottom-up aggregates, 9 spherical harmonics. PBGI §5.
//!
//! One thing differs from the paper: the root's children are one octree for each of six classes of normals, so that
//! the two sides of a wall never share a node and the side that faces away can be culled whole.

mod aggregate;
mod leaf;
mod lobe_sums;
pub mod node;
mod order;
mod packed;
mod radix;
mod split;

pub use leaf::LeafSurfels;
pub use node::{Lobes, Node, NodeKind};

use crate::math::Bounds3;
use crate::surfels::SurfelCloud;
use glam::DVec3;
use packed::{PackedLobes, PackedNode};
use rayon::prelude::*;

/// Most surfels of a leaf. PBGI §5: "less than e.g. 16 surfels".
pub const LEAF_SURFEL_COUNT: usize = 16;

/// Fewer nodes than this are not worth a thread.
const FEW: usize = 32;

/// An octree over a cloud, aggregated.
///
/// Promises: every surfel is in exactly one leaf, a leaf holds 1 to [`LEAF_SURFEL_COUNT`] of them; children stand side
/// by side behind their parent; area and power of a node are the sums over its children. The same cloud gives the same
/// bits for any number of threads.
#[derive(Debug, Clone, Default)]
pub struct Octree {
    origin: DVec3,
    bounds: Bounds3,
    nodes: Vec<PackedNode>,
    lobes: PackedLobes,
    surfels: LeafSurfels,
}

impl Octree {
    /// Build and aggregate; the cloud's surfels are copied in leaf order. O(n log n) time; coincident surfels are
    /// split by index, so any cloud ends in leaves of at most [`LEAF_SURFEL_COUNT`].
    pub fn new(cloud: &SurfelCloud) -> Self {
        let sorted = order::sort(cloud);
        let (keys, ids): (Vec<u64>, Vec<u32>) =
            (sorted.into_par_iter().map(|entry| (entry.key, entry.id))).unzip();
        let (surfels, levels) =
            rayon::join(|| LeafSurfels::new(cloud, &ids), || split::levels(&keys));
        let aggregate = aggregate::aggregate(&levels, &surfels);
        Self {
            origin: cloud.origin,
            bounds: aggregate.bounds,
            nodes: aggregate.nodes,
            lobes: aggregate.lobes,
            surfels,
        }
    }

    /// World position that all positions are relative to.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Node `index`, breadth first; 0 is the root.
    #[inline(always)]
    pub fn node(&self, index: usize) -> Node {
        self.nodes[index].unpack()
    }

    /// All nodes, breadth first; the root comes first. None for an empty cloud.
    pub fn nodes(&self) -> impl DoubleEndedIterator<Item = Node> + ExactSizeIterator {
        self.nodes.iter().map(PackedNode::unpack)
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
    pub fn lobes(&self, node: &Node) -> Option<Lobes> {
        node.lobes_index().map(|index| self.lobes.get(index))
    }

    /// The box around all disks, relative to the origin.
    pub fn bounds(&self) -> Bounds3 {
        self.bounds
    }

    /// Bytes held by nodes, lobes and surfels.
    pub fn bytes(&self) -> usize {
        self.nodes.len() * size_of::<PackedNode>() + self.lobes.bytes() + self.surfels.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Frame;
    use glam::Vec3;
    use proptest::prelude::*;
    use std::ops::Range;

    fn cloud(surfels: impl IntoIterator<Item = (Vec3, Vec3, f32, Vec3)>) -> SurfelCloud {
        let mut cloud = SurfelCloud::default();
        for (position, normal, area, light) in surfels {
            cloud.position.push(position);
            cloud.normal.push(normal.normalize());
            cloud.area.push(area);
            cloud.radius.push((0.6 * area.sqrt()).max(1e-3));
            cloud.emission.push(light * 0.25);
            cloud.radiosity.push(light);
            cloud.albedo.push(Vec3::ZERO);
            cloud.prim.push(0);
        }
        cloud
    }

    /// The surfels below a node.
    fn surfels_of(tree: &Octree, node: &Node) -> Range<usize> {
        match node.kind() {
            NodeKind::Leaf(range) => range,
            NodeKind::Inner(children) => {
                let first = surfels_of(tree, &tree.node(children.start));
                let last = surfels_of(tree, &tree.node(children.end - 1));
                first.start..last.end
            }
        }
    }

    /// Panics where `tree` breaks a promise of its own docs.
    fn check(tree: &Octree, cloud: &SurfelCloud) {
        let mut ids = Vec::new();
        let mut reached = 1;
        for node in tree.nodes() {
            match node.kind() {
                NodeKind::Leaf(range) => {
                    assert!(!range.is_empty() && range.len() <= LEAF_SURFEL_COUNT);
                    ids.extend(range.map(|place| tree.surfels().id(place)));
                }
                NodeKind::Inner(children) => {
                    assert_eq!(children.start, reached, "children stand in order");
                    assert!(children.len() >= 2 && children.len() <= 8);
                    reached = children.end;
                    let children: Vec<Node> = children.map(|child| tree.node(child)).collect();
                    check_sums(&node, &children);
                }
            }
            check_bounds(tree, &node);
        }
        assert_eq!(reached, tree.node_count().max(1));
        ids.sort_unstable();
        assert!(
            ids.iter().map(|&id| id as usize).eq(0..cloud.len()),
            "every surfel in one leaf"
        );
        for place in 0..tree.surfels().len() {
            check_surfel(tree.surfels(), place, cloud);
        }
    }

    fn check_surfel(surfels: &LeafSurfels, place: usize, cloud: &SurfelCloud) {
        let i = surfels.id(place) as usize;
        assert_eq!(surfels.position(place), cloud.position[i]);
        assert_eq!(surfels.radius(place), cloud.radius[i]);
        assert!(surfels.normal(place).distance(cloud.normal[i]) < 7e-5);
        let area = surfels.area(place);
        // Areas below 7e−9 of the squared radius are stored as that.
        let least = 1e-8 * cloud.radius[i].powi(2);
        assert!((area - cloud.area[i]).abs() <= 1.3e-4 * area + least);
        let off = surfels.reflected(place) * std::f32::consts::PI - cloud.reflected(i);
        assert!(off.abs().max_element() <= 1.3e-4 * cloud.reflected(i).max_element());
        let off = surfels.emitted(place) * std::f32::consts::PI - cloud.emission[i];
        assert!(off.abs().max_element() <= 1e-6 * cloud.emission[i].max_element());
    }

    fn check_sums(node: &Node, children: &[Node]) {
        let area: f32 = children.iter().map(|child| child.area).sum();
        assert!(
            (area - node.area).abs() <= 1e-5 * node.area,
            "{area} {}",
            node.area
        );
        let reflected: Vec3 = children.iter().map(|child| child.reflected_power).sum();
        assert!(reflected.abs_diff_eq(node.reflected_power, 2e-5 * reflected.length()));
        let emitted: Vec3 = children.iter().map(|child| child.emitted_power).sum();
        assert!(emitted.abs_diff_eq(node.emitted_power, 2e-3 * emitted.length()));
    }

    fn check_bounds(tree: &Octree, node: &Node) {
        // Rounding of sizes, and of coordinates far from zero.
        let magnitude = tree
            .bounds()
            .max
            .abs()
            .max(tree.bounds().min.abs())
            .max_element();
        let slack =
            1e-5 * (tree.bounds().diagonal() + node.radius) + 4.0 * f32::EPSILON * magnitude;
        let first = surfels_of(tree, node).start;
        for i in surfels_of(tree, node) {
            let (position, normal) = (tree.surfels().position(i), tree.surfels().normal(i));
            let frame = Frame::about(normal);
            for rim in [
                frame.tangent,
                -frame.tangent,
                frame.bitangent,
                -frame.bitangent,
            ] {
                let point = position + rim * tree.surfels().radius(i);
                assert!(node.center.distance(point) <= node.radius + slack);
            }
            let places = [position, tree.surfels().position(first)];
            let apart = Bounds3::around(places);
            assert!((apart.max - apart.min).cmple(node.size + slack).all());
            assert!(node.normal.dot(normal).clamp(-1.0, 1.0).acos() <= node.spread + 2e-3);
        }
        assert!(node.center.is_finite() && node.covariance.iter().all(|c| c.is_finite()));
        assert!(node.extent_area() >= 0.0);
    }

    fn vector(size: f32) -> impl Strategy<Value = Vec3> {
        let range = || -size..size;
        (range(), range(), range()).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn every_surfel_is_in_one_leaf_and_sums_are_those_of_the_children(
            surfels in prop::collection::vec(
                (vector(3.0), vector(1.0).prop_filter("a normal", |n| n.length() > 0.1), 0.0_f32..0.1, vector(1.0).prop_map(Vec3::abs)),
                0..600,
            ),
            flatten in prop::bool::ANY,
            offset in prop_oneof![Just(0.0_f32), Just(1e4)],
        ) {
            let squash = if flatten { Vec3::new(1.0, 1.0, 0.0) } else { Vec3::ONE };
            let cloud = cloud(surfels.into_iter().map(|(p, n, a, l)| (p * squash + Vec3::splat(offset), n, a, l)));
            check(&Octree::new(&cloud), &cloud);
        }
    }

    #[test]
    fn no_surfel_one_surfel_a_line_and_coincident_ones_keep_the_promises() {
        let one = (Vec3::ONE, Vec3::Z, 0.25, Vec3::ONE);
        for count in [0_usize, 1, 16, 17, 5_000] {
            let coincident = cloud(std::iter::repeat_n(one, count));
            let tree = Octree::new(&coincident);
            check(&tree, &coincident);
            assert_eq!(tree.node_count() == 0, count == 0);
            let line = cloud((0..count).map(|i| (Vec3::X * i as f32, Vec3::Z, 0.5, Vec3::ONE)));
            check(&Octree::new(&line), &line);
        }
        assert!(Octree::new(&SurfelCloud::default()).bounds().is_empty());
    }

    #[test]
    fn areas_of_zero_give_finite_nodes() {
        let dust = cloud((0..100).map(|i| (Vec3::splat(i as f32), -Vec3::Y, 0.0, Vec3::ZERO)));
        let tree = Octree::new(&dust);
        check(&tree, &dust);
        for node in tree.nodes() {
            assert!(tree.appearance(&node, -Vec3::Y).is_none());
        }
    }

    #[test]
    fn two_sides_of_a_sheet_share_no_node_below_the_root() {
        let sheet = cloud((0..4_000).map(|i| {
            let side = if i % 2 == 0 { 1.0 } else { -1.0 };
            let (x, y) = ((i / 2 % 50) as f32, (i / 100) as f32);
            (Vec3::new(x, y, 0.0), Vec3::Z * side, 1.0, Vec3::ONE)
        }));
        let tree = Octree::new(&sheet);
        check(&tree, &sheet);
        for node in tree.nodes().skip(1) {
            assert!(node.is_flat() && node.spread < 1e-3);
            assert!(node.is_averted_from(node.center - node.normal * (1.01 * node.radius)));
        }
    }

    #[test]
    fn a_ball_of_leaves_is_scattered_and_a_sphere_is_not() {
        let hash = |i: usize| {
            let x = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let x = (x ^ (x >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            (x >> 40) as f32 / (1 << 24) as f32 - 0.5
        };
        let vector = |i: usize| Vec3::new(hash(3 * i), hash(3 * i + 1), hash(3 * i + 2));
        let sphere = cloud((0..2_000).map(|i| (vector(i).normalize(), vector(i), 0.01, Vec3::ONE)));
        let leaves = cloud((0..2_000).map(|i| (vector(i), vector(i + 5_000), 0.01, Vec3::ONE)));
        let (sphere, leaves) = (Octree::new(&sphere), Octree::new(&leaves));
        let scattered = |tree: &Octree| tree.nodes().filter(|node| node.is_scattered).count();
        assert_eq!(scattered(&sphere), 0);
        assert!(
            scattered(&leaves) > leaves.node_count() / 2,
            "{}",
            scattered(&leaves)
        );
    }

    #[test]
    fn a_square_patch_has_its_own_area_as_extent() {
        let patch = cloud((0..400).map(|i| {
            (
                Vec3::new((i % 20) as f32, (i / 20) as f32, 0.0),
                Vec3::Z,
                1.0,
                Vec3::ONE,
            )
        }));
        let root = Octree::new(&patch).node(0);
        // Covariances are stored in 15 bits, areas of surfels in 12.
        assert!((root.extent_area() / 400.0 - 1.0).abs() < 2e-4);
        assert!((root.area / 400.0 - 1.0).abs() < 1.3e-4);
    }

    #[test]
    fn a_node_all_of_whose_surfels_face_the_viewer_shows_their_exact_sum() {
        // A shallow and a steep roof, lit differently: spread, but both sides face up.
        let roof = cloud((0..40).map(|i| {
            let (normal, light) = if i % 2 == 0 {
                (Vec3::new(0.8, 0.0, 0.6), Vec3::X)
            } else {
                (Vec3::new(-0.6, 0.0, 0.8), Vec3::Y)
            };
            (Vec3::new(0.0, i as f32, 0.0), normal, 0.5, light)
        }));
        let tree = Octree::new(&roof);
        let root = tree.node(0);
        assert!(!root.is_flat());
        let seen = tree.appearance(&root, Vec3::Z).unwrap();
        // 20 · 0.5 · (0.6 + 0.8); radiance = Σ area · cos · radiosity / π, by the projected area.
        assert!((seen.projected_area - 14.0).abs() < 1e-3);
        let reflected = Vec3::new(0.75 * 6.0, 0.75 * 8.0, 0.0) / (14.0 * std::f32::consts::PI);
        assert!(
            seen.reflected.abs_diff_eq(reflected, 1e-4),
            "{}",
            seen.reflected
        );
    }

    /// 0…1, for each `i` another.
    fn hash(i: usize) -> f32 {
        let x = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let x = (x ^ (x >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (x >> 40) as f32 / (1 << 24) as f32
    }

    fn hash3(i: usize) -> Vec3 {
        Vec3::new(hash(3 * i), hash(3 * i + 1), hash(3 * i + 2))
    }

    /// Area of the plane across `frame.normal` that `covers` (of a ray's place in the plane, about the middle of the unit
    /// cube) says is covered: by 400² parallel rays.
    fn covered(covers: impl Fn(glam::Vec2) -> bool) -> f32 {
        let place = |i: usize| 2.0 * ((i as f32 + 0.5) / 400.0) - 1.0;
        let rays = (0..160_000).map(|i| glam::Vec2::new(place(i % 400), place(i / 400)));
        4.0 * rays.filter(|&ray| covers(ray)).count() as f32 / 160_000.0
    }

    /// What the root of `tree` shows in directions for which `is_asked`, by what `truth` finds in the plane of a frame.
    fn check_root(tree: &Octree, is_asked: fn(Vec3) -> bool, truth: impl Fn(Frame) -> f32) {
        let root = tree.node(0);
        assert!(root.is_scattered);
        for i in 0..12 {
            let direction = (hash3(i + 900) - 0.5).normalize();
            if is_asked(direction) {
                let seen = tree
                    .appearance(&root, direction)
                    .expect("clutter shows")
                    .projected_area;
                let truth = truth(Frame::about(direction));
                assert!(
                    (seen / truth - 1.0).abs() < 0.1,
                    "{direction}: {seen} of {truth}"
                );
            }
        }
    }

    #[test]
    fn a_box_of_random_disks_that_cover_three_tenths_is_one_node_right_to_ten_percent() {
        let radius = 0.034_f32;
        let disks: Vec<(Vec3, Vec3)> = (0..200)
            .map(|i| (hash3(i), (hash3(i + 300) - 0.5).normalize()))
            .collect();
        let area = std::f32::consts::PI * radius * radius;
        let sides = disks.iter().flat_map(|&(p, n)| [(p, n), (p, -n)]);
        let tree = Octree::new(&cloud(sides.map(|(p, n)| (p, n, area, Vec3::ONE))));
        check_root(
            &tree,
            |_| true,
            |frame| {
                let across =
                    |v: Vec3| glam::Vec2::new(v.dot(frame.tangent), v.dot(frame.bitangent));
                let flat: Vec<_> = (disks.iter())
                    .map(|&(p, n)| (across(p - 0.5), across(n), n.dot(frame.normal)))
                    .collect();
                let share = covered(|ray| {
                    flat.iter().any(|&(middle, n, cos)| {
                        let offset = ray - middle;
                        let along = n.dot(offset) / cos;
                        offset.length_squared() + along * along < radius * radius
                    })
                });
                assert!((0.2..0.5).contains(&share), "{share}");
                share
            },
        );
    }

    #[test]
    fn a_tuft_of_hair_is_one_node_right_to_ten_percent_from_its_sides() {
        let (radius, pieces) = (0.006_f32, 20);
        let hairs: Vec<(Vec3, Vec3)> = (0..40)
            .map(|i| {
                let root = hash3(i) * Vec3::new(1.0, 1.0, 0.0);
                (
                    root,
                    (hash3(i + 100) - 0.5) * Vec3::new(0.5, 0.5, 0.0) + Vec3::Z,
                )
            })
            .collect();
        let surfels = hairs.iter().enumerate().flat_map(|(i, &(root, along))| {
            let frame = Frame::about(along.normalize());
            let area = along.length() / pieces as f32 * std::f32::consts::FRAC_PI_2 * radius;
            (0..4 * pieces).map(move |k| {
                let at = root + along * (((k / 4) as f32 + 0.5) / pieces as f32);
                let turn =
                    std::f32::consts::FRAC_PI_2 * ((k % 4) as f32 + hash(i * pieces + k / 4));
                let out = frame.tangent * turn.cos() + frame.bitangent * turn.sin();
                (at + out * radius, out, area, Vec3::ONE)
            })
        });
        let tree = Octree::new(&cloud(surfels));
        let from_the_side = |direction: Vec3| direction.z.abs() < 0.7;
        check_root(&tree, from_the_side, |frame| {
            let across = |v: Vec3| glam::Vec2::new(v.dot(frame.tangent), v.dot(frame.bitangent));
            let flat: Vec<_> = (hairs.iter())
                .map(|&(p, v)| (across(p - 0.5), across(v)))
                .collect();
            covered(|ray| {
                flat.iter().any(|&(root, along)| {
                    let part = (ray - root).dot(along) / along.length_squared();
                    (ray - root - along * part.clamp(0.0, 1.0)).length() < radius
                })
            })
        });
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let hash = |i: u64| (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f32 / (1 << 24) as f32;
        let cloud = cloud((0..100_000).map(|i| {
            let v = |k: u64| Vec3::new(hash(9 * i + k), hash(9 * i + k + 1), hash(9 * i + k + 2));
            (v(0), v(3) - 0.5, 1e-4 * hash(i), v(6))
        }));
        let with_threads = |count| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(count)
                .build()
                .unwrap();
            pool.install(|| Octree::new(&cloud))
        };
        let one = with_threads(1);
        for other in [with_threads(2), with_threads(8)] {
            assert!(one.nodes == other.nodes && one.lobes == other.lobes);
            assert!(one.surfels == other.surfels && one.bounds == other.bounds);
        }
    }
}
