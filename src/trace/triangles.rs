//! Triangles under a hierarchy: the bottom level, and the watertight triangle test.
//!
//! Woop, Benthin, Wald, *Watertight Ray/Triangle Intersection* (2013), with every corner sheared before the ray's origin
//! is taken off, so that rays of one direction share the shear: a corner has one place along a direction, for all
//! triangles that meet there and for all rays. A rounded edge function can be zero where the exact one is not, but never
//! has the wrong sign, and zero counts as inside: no ray slips through a shared edge or vertex.

mod packet;

use super::ray::{Line, Ray};
use super::wide::{Item, LEAF_SIZE, Wide};
use crate::math::Bounds3;
use fearless_simd::Simd;
use glam::Vec3;
pub(super) use packet::PacketHits;

/// Boxes grow by this part of the largest coordinate, more than the roundings of a sheared corner and of its box.
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

    /// The first hit that counts for `ray`, which it shortens to it; of several at the same distance the one of the
    /// first triangle.
    #[inline(always)]
    pub(super) fn closest<S: Simd>(&self, simd: S, ray: &mut Ray) -> Option<LocalHit> {
        let mut best = None;
        self.tree.traverse(
            simd,
            ray,
            #[inline(always)]
            |leaf, ray| {
                let sheared = self.blocks[leaf.block].sheared(&ray.line);
                let lanes = sheared.intersect(ray.place, ray.line.scale);
                let first = leaf.block * LEAF_SIZE;
                let indices = &self.tree.order[first..first + leaf.count];
                if let Some(lane) = lanes.first(indices, (ray.max_distance, ray.before)) {
                    (ray.max_distance, ray.before) = (lanes.distance[lane], indices[lane]);
                    best = Some(lanes.local_hit(lane, indices[lane]));
                }
                false
            },
        );
        best
    }

    /// True if anything is hit closer than the ray's limit.
    #[inline(always)]
    pub(super) fn occluded<S: Simd>(&self, simd: S, ray: &mut Ray) -> bool {
        let mut hit = false;
        self.tree.traverse(
            simd,
            ray,
            #[inline(always)]
            |leaf, ray| {
                let sheared = self.blocks[leaf.block].sheared(&ray.line);
                let lanes = sheared.intersect(ray.place, ray.line.scale);
                for lane in 0..LEAF_SIZE {
                    hit |= lanes.hit[lane] & (lanes.distance[lane] < ray.max_distance);
                }
                hit
            },
        );
        hit
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.tree.bytes() + self.blocks.capacity() * size_of::<Block>()
    }
}

/// Triangles along a direction: `[corner][lane]`.
struct Sheared {
    x: [[f32; LEAF_SIZE]; 3],
    y: [[f32; LEAF_SIZE]; 3],
    depth: [[f32; LEAF_SIZE]; 3],
}

/// Edge functions (unnormalised weights of corners 1 and 2), the sum of all three, and the distance, a lane each.
struct Lanes {
    v: [f32; LEAF_SIZE],
    w: [f32; LEAF_SIZE],
    sum: [f32; LEAF_SIZE],
    distance: [f32; LEAF_SIZE],
    /// In front of the ray, at whatever distance.
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
    fn sheared(&self, line: &Line) -> Sheared {
        let [kx, ky, kz] = line.axes;
        let mut all = Sheared {
            x: [[0.0; LEAF_SIZE]; 3],
            y: [[0.0; LEAF_SIZE]; 3],
            depth: [[0.0; LEAF_SIZE]; 3],
        };
        for (corner, place) in self.corners.iter().enumerate() {
            for (lane, &z) in place[kz].iter().enumerate() {
                let depth = line.sign * z;
                all.x[corner][lane] = place[kx][lane] - line.slope[0] * depth;
                all.y[corner][lane] = place[ky][lane] - line.slope[1] * depth;
                all.depth[corner][lane] = depth;
            }
        }
        all
    }
}

impl Sheared {
    /// The scalar definition of the test; `packet` has its twin.
    #[inline(always)]
    fn intersect(&self, place: [f32; 3], scale: f32) -> Lanes {
        let mut lanes = Lanes {
            v: [0.0; LEAF_SIZE],
            w: [0.0; LEAF_SIZE],
            sum: [0.0; LEAF_SIZE],
            distance: [0.0; LEAF_SIZE],
            hit: [false; LEAF_SIZE],
        };
        let [px, py, depth] = place;
        for i in 0..LEAF_SIZE {
            let x = [self.x[0][i] - px, self.x[1][i] - px, self.x[2][i] - px];
            let y = [self.y[0][i] - py, self.y[1][i] - py, self.y[2][i] - py];
            let z = [
                self.depth[0][i] - depth,
                self.depth[1][i] - depth,
                self.depth[2][i] - depth,
            ];
            let u = x[2] * y[1] - y[2] * x[1];
            let v = x[0] * y[2] - y[0] * x[2];
            let w = x[1] * y[0] - y[1] * x[0];
            let sum = u + v + w;
            let distance = (u * z[0] + v * z[1] + w * z[2]) * scale / sum;
            let inside =
                (u >= 0.0) & (v >= 0.0) & (w >= 0.0) | (u <= 0.0) & (v <= 0.0) & (w <= 0.0);
            lanes.v[i] = v;
            lanes.w[i] = w;
            lanes.sum[i] = sum;
            lanes.distance[i] = distance;
            lanes.hit[i] = inside & (distance > 0.0);
        }
        lanes
    }
}

impl Lanes {
    /// The lane of the first hit that counts for a ray that ends at `end`: a distance, and a triangle at that distance.
    #[inline(always)]
    fn first(&self, indices: &[u32], mut end: (f32, u32)) -> Option<usize> {
        let mut best = None;
        for (lane, &index) in indices.iter().enumerate() {
            let distance = self.distance[lane];
            let is_nearer = distance < end.0 || distance == end.0 && index < end.1;
            if self.hit[lane] && is_nearer {
                end = (distance, index);
                best = Some(lane);
            }
        }
        best
    }

    #[inline(always)]
    fn local_hit(&self, lane: usize, triangle: u32) -> LocalHit {
        let sum = self.sum[lane];
        LocalHit {
            distance: self.distance[lane],
            triangle,
            u: self.v[lane] / sum,
            v: self.w[lane] / sum,
            front: sum > 0.0,
        }
    }
}

#[cfg(test)]
impl Triangles {
    /// What `ray` hits of one triangle, without a hierarchy.
    pub(super) fn single(corners: [Vec3; 3], ray: &Ray) -> Option<LocalHit> {
        let lanes = Block::new(&[0], &[corners]).sheared(&ray.line);
        let lanes = lanes.intersect(ray.place, ray.line.scale);
        (lanes.first(&[0], (ray.max_distance, 0))).map(|lane| lanes.local_hit(lane, 0))
    }
}
