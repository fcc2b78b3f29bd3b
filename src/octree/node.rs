//! A node: where a cluster of surfels lies, how large it looks and how much it shines from a direction.

use super::Octree;
use crate::math::sh::Sh9;
use glam::Vec3;
use std::f32::consts::{FRAC_1_PI, FRAC_PI_2, PI};
use std::ops::Range;

/// A spread node that turns less than this share of its area towards the viewer is not seen: below, the ringing of
/// nine harmonics (up to 6 %) outweighs the area itself, and radiance, a quotient of two such series, means nothing.
const LEAST_SEEN_SHARE: f32 = 0.01;

/// What a node's range refers to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NodeKind {
    /// Indices of nodes.
    Inner(Range<usize>),
    /// Indices of surfels in leaf order.
    Leaf(Range<usize>),
}

/// A cluster of surfels, aggregated. Space: relative to the tree's origin.
///
/// It is stored in 64 bytes: sums are off by up to 2e−5 of themselves, emitted power by 0.1 %; what bounds is rounded up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Mean position, weighted by area.
    pub center: Vec3,
    /// Radius of a ball about `center` that holds all disks.
    pub radius: f32,
    /// Mean normal, weighted by area; unit.
    pub normal: Vec3,
    /// No surfel's normal is farther than this from `normal`; radians, 0…π.
    pub spread: f32,
    /// Sum of the true areas.
    pub area: f32,
    /// Length of Σ area·normal: the area projected along `normal` when all surfels face one way.
    pub facing_area: f32,
    /// Edges of the box around the disks.
    pub size: Vec3,
    /// Covariance of the covered surface about `center`: xx, yy, zz, xy, xz, yz. A square of side `s` has `s²/12`
    /// along each of its edges.
    pub covariance: [f32; 6],
    /// Sum of area · reflected radiosity.
    pub reflected_power: Vec3,
    /// Sum of area · emission.
    pub emitted_power: Vec3,
    /// True if the surfels are scattered through a volume, like leaves, rather than parts of one surface: their normals
    /// differ but do not follow from their places, and the cluster is thick along the mean normal. They overlap at
    /// random, and cover less than the sum of their areas.
    pub is_scattered: bool,
    pub(super) first: u32,
    pub(super) count: u32,
    pub(super) is_leaf: bool,
    pub(super) lobes: u32,
}

/// Value of `Node::lobes` for flat nodes.
pub(super) const NO_LOBES: u32 = u32::MAX;

/// Projected area and power in a direction from the cluster, for nodes of spread normals. PBGI §5.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Lobes {
    /// Σ area · max(0, normal·ω).
    pub area: Sh9,
    /// Σ area · reflected radiosity · max(0, normal·ω), a channel each.
    pub reflected: [Sh9; 3],
    /// Σ area · emission · max(0, normal·ω), a channel each.
    pub emitted: [Sh9; 3],
}

/// A cluster as seen from one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance {
    /// Area projected onto the plane across the direction. Never more than the box around the cluster projects to:
    /// what a cluttered node covers, not the sum of what overlaps in it.
    pub projected_area: f32,
    /// Mean reflected radiance.
    pub reflected: Vec3,
    /// Mean emitted radiance.
    pub emitted: Vec3,
}

impl Node {
    /// Its children or its surfels.
    pub fn kind(&self) -> NodeKind {
        let range = self.first as usize..(self.first + self.count) as usize;
        if self.is_leaf {
            NodeKind::Leaf(range)
        } else {
            NodeKind::Inner(range)
        }
    }

    /// True when it stands for its surfels as one disk, false when [`Lobes`] do.
    pub fn is_flat(&self) -> bool {
        self.lobes == NO_LOBES
    }

    pub(super) fn lobes_index(&self) -> Option<u32> {
        (!self.is_flat()).then_some(self.lobes)
    }

    /// Area of the square with the covered surface's second moments: its area where it is a compact patch, more where
    /// it is scattered.
    pub fn extent_area(&self) -> f32 {
        let [xx, yy, zz, ..] = self.covariance;
        6.0 * (xx + yy + zz)
    }

    /// True if no point of no surfel can face `position`.
    pub fn is_averted_from(&self, position: Vec3) -> bool {
        let offset = position - self.center;
        let nearest_angle = offset.angle_between(self.normal) - self.spread;
        let distance = offset.length();
        distance > self.radius && distance * nearest_angle.max(0.0).cos() + self.radius <= 0.0
    }

    /// What surfels of `area` in all, projected along the unit vector `direction`, cover when they overlap at random: of
    /// an ellipse with their second moments, all but exp(−area / ellipse). The ellipse is 5 % larger than a box along one
    /// of its edges and 10 % smaller than what acts like a ball.
    fn covered_at_random(&self, area: f32, direction: Vec3) -> f32 {
        let [xx, yy, zz, xy, xz, yz] = self.covariance;
        let (a, b, c) = (yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy);
        let (d, e, f) = (xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - yz * xx);
        let Vec3 { x, y, z } = direction;
        // The determinant of the projected covariance.
        let squared = a * x * x + b * y * y + c * z * z + 2.0 * (d * x * y + e * x * z + f * y * z);
        let ellipse = 4.0 * PI * squared.max(0.0).sqrt();
        if ellipse > 0.0 {
            -ellipse * (-area / ellipse).exp_m1()
        } else {
            area
        }
    }

    /// Projected area of the box along the unit vector `direction`.
    fn box_silhouette(&self, direction: Vec3) -> f32 {
        let size = self.size;
        let faces = Vec3::new(size.y * size.z, size.z * size.x, size.x * size.y);
        faces.dot(direction.abs())
    }
}

impl Octree {
    /// How `node` looks from far away in the direction of the unit vector `toward` (from the cluster); `None` when it
    /// shows no front. The area is exact where all its surfels face the viewer.
    pub fn appearance(&self, node: &Node, toward: Vec3) -> Option<Appearance> {
        let cos = node.normal.dot(toward);
        let seen = match self.lobes(node) {
            None => flat_appearance(node, cos),
            Some(lobes) => spread_appearance(node, &lobes, toward),
        }?;
        let area = seen.projected_area;
        let covered = if node.is_scattered {
            node.covered_at_random(area, toward)
        } else {
            area
        };
        Some(Appearance {
            projected_area: covered.min(node.box_silhouette(toward)),
            ..seen
        })
    }
}

/// The node as one disk.
fn flat_appearance(node: &Node, cos: f32) -> Option<Appearance> {
    if cos <= 0.0 || node.facing_area <= 0.0 {
        return None;
    }
    let per_area = FRAC_1_PI / node.area;
    Some(Appearance {
        projected_area: node.facing_area * cos,
        reflected: node.reflected_power * per_area,
        emitted: node.emitted_power * per_area,
    })
}

/// The node as harmonics; where all its surfels face the viewer, as the vectors in their first band, which is exact.
fn spread_appearance(node: &Node, lobes: &Lobes, toward: Vec3) -> Option<Appearance> {
    let angle = node.normal.angle_between(toward);
    if angle - node.spread >= FRAC_PI_2 {
        return None;
    }
    let value: fn(&Sh9, Vec3) -> f32 = if angle + node.spread <= FRAC_PI_2 {
        |lobe, toward| lobe.cosine_vector().dot(toward)
    } else {
        |lobe, toward| lobe.evaluate(toward)
    };
    let area = value(&lobes.area, toward);
    if area <= LEAST_SEEN_SHARE * node.area {
        return None;
    }
    let radiance = |power: &[Sh9; 3]| {
        let per_channel = power.each_ref().map(|lobe| value(lobe, toward).max(0.0));
        Vec3::from_array(per_channel) * (FRAC_1_PI / area)
    };
    Some(Appearance {
        projected_area: area,
        reflected: radiance(&lobes.reflected),
        emitted: radiance(&lobes.emitted),
    })
}
