//! Triangles under a hierarchy: the bottom level, and the watertight triangle test.
//!
//! Woop, Benthin, Wald, *Watertight Ray/Triangle Intersection* (2013), four triangles at a time. A rounded edge function
//! can be zero where the exact one is not, but never has the wrong sign, and zero counts as inside: no ray slips through
//! a shared edge or vertex.

use super::ray::Ray;
use super::wide::{Item, LEAF_SIZE, Wide};
use crate::math::Bounds3;
use glam::Vec3;

/// Boxes grow by this part of the largest coordinate, more than the roundings of a sheared vertex.
const BOX_MARGIN: f32 = 8.0 * f32::EPSILON;

/// Up to four triangles of one leaf; unused lanes are NaN and never hit.
#[derive(Debug, Clone)]
struct Block {
    /// `[corner][axis][lane]`.
    corners: [[[f32; LEAF_SIZE]; 3]; 3],
}

/// A hit in the space of the triangles.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalHit {
    /// In lengths of the ray's direction.
    pub(super) distance: f32,
    /// Index of the triangle as given to [`Triangles::new`].
    pub(super) triangle: u32,
    /// Weight of corner 1.
    pub(super) u: f32,
    /// Weight of corner 2.
    pub(super) v: f32,
    /// Seen counter-clockwise.
    pub(super) front: bool,
}

/// Triangles, searchable by rays.
#[derive(Debug, Clone, Default)]
pub(super) struct Triangles {
    pub(super) tree: Wide,
    blocks: Vec<Block>,
}

impl Triangles {
    /// Build over triangles given by their corners; those without area can never be hit.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "Wide::build asserts the count"
    )]
    pub(super) fn new(corners: &[[Vec3; 3]]) -> Self {
        let all = Bounds3::around(corners.iter().flatten().copied());
        let margin = if all.is_empty() {
            0.0
        } else {
            BOX_MARGIN * all.min.abs().max(all.max.abs()).max_element()
        };
        let items = corners.iter().enumerate().map(|(index, corners)| {
            let bounds = Bounds3::around(*corners);
            Item {
                bounds: Bounds3 {
                    min: bounds.min - margin,
                    max: bounds.max + margin,
                },
                index: index as u32,
            }
        });
        let tree = Wide::build(items.collect());
        let blocks = (tree.order.chunks_exact(LEAF_SIZE))
            .map(|lanes| Block::new(lanes, corners))
            .collect();
        Self { tree, blocks }
    }

    /// The nearest hit closer than the ray's limit.
    #[inline(always)]
    pub(super) fn closest(&self, ray: &mut Ray) -> Option<LocalHit> {
        let mut best = None;
        self.tree.traverse(ray, |block, ray| {
            if let Some((hit, lane)) = self.blocks[block].closest(ray) {
                ray.max_distance = hit.distance;
                let triangle = self.tree.order[block * LEAF_SIZE + lane];
                best = Some(LocalHit { triangle, ..hit });
            }
            false
        });
        best
    }

    /// True if anything is hit closer than the ray's limit.
    #[inline(always)]
    pub(super) fn occluded(&self, ray: &mut Ray) -> bool {
        let mut hit = false;
        self.tree.traverse(ray, |block, ray| {
            hit = self.blocks[block].intersect(ray).hit.contains(&true);
            hit
        });
        hit
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.tree.bytes() + self.blocks.capacity() * size_of::<Block>()
    }
}

/// Edge functions (unnormalised weights of corners 0, 1, 2), their sum and the distance, a lane each.
struct Lanes {
    v: [f32; LEAF_SIZE],
    w: [f32; LEAF_SIZE],
    sum: [f32; LEAF_SIZE],
    distance: [f32; LEAF_SIZE],
    hit: [bool; LEAF_SIZE],
}

impl Block {
    fn new(lanes: &[u32], triangles: &[[Vec3; 3]]) -> Self {
        let mut corners = [[[f32::NAN; LEAF_SIZE]; 3]; 3];
        for (lane, &index) in lanes.iter().enumerate() {
            let Some(triangle) = triangles.get(index as usize) else {
                continue;
            };
            for (corner, position) in triangle.iter().enumerate() {
                for axis in 0..3 {
                    corners[corner][axis][lane] = position[axis];
                }
            }
        }
        Self { corners }
    }

    #[inline(always)]
    fn intersect(&self, ray: &Ray) -> Lanes {
        let [kx, ky, kz] = ray.axes;
        let [sx, sy, sz] = ray.shear;
        let mut x = [[0.0_f32; LEAF_SIZE]; 3];
        let mut y = [[0.0_f32; LEAF_SIZE]; 3];
        let mut z = [[0.0_f32; LEAF_SIZE]; 3];
        for corner in 0..3 {
            for lane in 0..LEAF_SIZE {
                let at = |axis: usize| self.corners[corner][axis][lane] - ray.origin[axis];
                z[corner][lane] = at(kz);
                x[corner][lane] = at(kx) - sx * z[corner][lane];
                y[corner][lane] = at(ky) - sy * z[corner][lane];
            }
        }
        let mut lanes = Lanes {
            v: [0.0; LEAF_SIZE],
            w: [0.0; LEAF_SIZE],
            sum: [0.0; LEAF_SIZE],
            distance: [0.0; LEAF_SIZE],
            hit: [false; LEAF_SIZE],
        };
        for i in 0..LEAF_SIZE {
            let u = x[2][i] * y[1][i] - y[2][i] * x[1][i];
            let v = x[0][i] * y[2][i] - y[0][i] * x[2][i];
            let w = x[1][i] * y[0][i] - y[1][i] * x[0][i];
            let sum = u + v + w;
            let distance = (u * z[0][i] + v * z[1][i] + w * z[2][i]) * sz / sum;
            let inside =
                (u >= 0.0) & (v >= 0.0) & (w >= 0.0) | (u <= 0.0) & (v <= 0.0) & (w <= 0.0);
            lanes.v[i] = v;
            lanes.w[i] = w;
            lanes.sum[i] = sum;
            lanes.distance[i] = distance;
            lanes.hit[i] = inside & (distance > 0.0) & (distance < ray.max_distance);
        }
        lanes
    }

    #[inline(always)]
    fn closest(&self, ray: &Ray) -> Option<(LocalHit, usize)> {
        let lanes = self.intersect(ray);
        let mut best: Option<usize> = None;
        for lane in 0..LEAF_SIZE {
            let is_nearer = |other: usize| lanes.distance[lane] < lanes.distance[other];
            if lanes.hit[lane] && best.is_none_or(is_nearer) {
                best = Some(lane);
            }
        }
        best.map(|lane| {
            let sum = lanes.sum[lane];
            let hit = LocalHit {
                distance: lanes.distance[lane],
                triangle: u32::MAX,
                u: lanes.v[lane] / sum,
                v: lanes.w[lane] / sum,
                front: sum > 0.0,
            };
            (hit, lane)
        })
    }
}
