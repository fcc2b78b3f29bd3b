//! Triangles under a hierarchy: the bottom level, and the watertight triangle test.
//!
//! Woop, Benthin, Wald, *Watertight Ray/Triangle Intersection* (2013), with every corner sheared before the ray's origin
//! is taken off, so that rays of one direction share the shear: a corner has one place along a direction, for all
//! triangles that meet there and for all rays. A rounded edge function can be zero where the exact one is not, but never
//! has the wrong sign, and zero counts as inside: no ray slips through a shared edge or vertex.
//!
//! All of it is in `f64`: in `f32` the places would be rounded relative to the scene's origin, as coarsely as
//! [`super::Tracer::lift`] lifts, and faces around a receiver that its rays pass edge-on would hide what they do not. Four
//! doubles fill a register, so that four triangles take as long as in `f32`.

mod packet;

use super::ray::{Line, Ray};
use super::wide::{FARTHEST_FIRST, Item, LEAF_SIZE, Leaf, NEAREST_FIRST, NONE, Wide};
use crate::math::Bounds3;
use crate::math::bits::bits_of;
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, f64x4};
use glam::Vec3;
pub(super) use packet::PacketHits;
use rayon::prelude::*;
use std::ops::Deref;

/// Boxes grow by this part of the largest coordinate, more than the roundings of their distances.
const BOX_MARGIN: f32 = 8.0 * f32::EPSILON;

/// Of the boxes of what is all within `all`.
pub(super) fn margin_of(all: Bounds3) -> f32 {
    if all.is_empty() {
        0.0
    } else {
        BOX_MARGIN * all.min.abs().max(all.max.abs()).max_element()
    }
}

/// A box, `margin` wider on all sides, and its number.
pub(super) fn item((index, bounds): (u32, Bounds3), margin: f32) -> Item {
    Item {
        bounds: Bounds3 {
            min: bounds.min - margin,
            max: bounds.max + margin,
        },
        index,
    }
}

/// Fewer triangles or leaves are not worth a thread.
const FEW: usize = 2048;

/// Leaves that are tested against all rays of a beam; where they are not enough, each ray looks for itself.
const MOST_LEAVES: usize = 12;

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
    /// Build over the triangles below `count` by their `corners`, which are asked for twice and kept nowhere else; those
    /// without area can never be hit.
    pub(super) fn new(count: u32, corners: &(impl Fn(u32) -> [Vec3; 3] + Sync)) -> Self {
        let all = || (0..count).into_par_iter().with_min_len(FEW);
        let around = |index| Bounds3::around(corners(index));
        let finite = |bounds: &Bounds3| bounds.min.is_finite() && bounds.max.is_finite();
        let whole = (all().map(around).filter(finite)).reduce(|| Bounds3::EMPTY, Bounds3::union);
        let margin = margin_of(whole);
        let tree = Wide::build_at_once(all().map(|index| item((index, around(index)), margin)));
        let leaves = tree.order.par_chunks_exact(LEAF_SIZE).with_min_len(FEW);
        let blocks = leaves.map(|lanes| Block::new(lanes, corners)).collect();
        Self { tree, blocks }
    }

    /// The first hit that counts for `ray`, which it shortens to it; of several at the same distance the one of the
    /// first triangle.
    #[inline(always)]
    pub(super) fn closest<S: Simd>(&self, simd: S, ray: &mut Ray) -> Option<LocalHit> {
        let mut best = None;
        self.tree.traverse::<NEAREST_FIRST, S>(
            simd,
            ray,
            #[inline(always)]
            |leaf, ray| {
                let sheared = self.blocks[leaf.block].sheared(simd, &ray.line);
                let Some(lanes) = sheared.meet(simd, ray.place, ray.line.scale) else {
                    return false;
                };
                let first = leaf.block * LEAF_SIZE;
                let indices = &self.tree.order[first..first + leaf.count];
                if let Some(hit) = lanes.first(indices, (ray.max_distance, ray.before)) {
                    (ray.max_distance, ray.before) = (hit.distance, hit.triangle);
                    best = Some(hit);
                }
                false
            },
        );
        best
    }

    /// [`Self::closest`] for all of `rays`, which lie close together; `hits` where one is nearer.
    #[inline(always)]
    pub(super) fn closest_in<S: Simd>(
        &self,
        simd: S,
        (rays, hits): (&mut [Ray], &mut [Option<LocalHit>]),
    ) {
        let is_done = self.tree.traverse_beam(
            simd,
            rays,
            MOST_LEAVES,
            #[inline(always)]
            |leaf, rays| {
                let first = leaf.block * LEAF_SIZE;
                let indices = &self.tree.order[first..first + leaf.count];
                for (ray, hit) in rays.iter_mut().zip(hits.iter_mut()) {
                    let sheared = self.blocks[leaf.block].sheared(simd, &ray.line);
                    let lanes = sheared.meet(simd, ray.place, ray.line.scale);
                    let end = (ray.max_distance, ray.before);
                    if let Some(found) = lanes.and_then(|lanes| lanes.first(indices, end)) {
                        (ray.max_distance, ray.before) = (found.distance, found.triangle);
                        *hit = Some(found);
                    }
                }
            },
        );
        if !is_done {
            for (ray, hit) in rays.iter_mut().zip(hits) {
                *hit = self.closest(simd, ray).or(*hit);
            }
        }
    }

    /// [`Self::occluded`] for all of `rays`, which lie close together, into `is_blocked`. Those that are lose their length.
    #[inline(always)]
    pub(super) fn occluded_in<S: Simd>(
        &self,
        simd: S,
        (rays, is_blocked): (&mut [Ray], &mut [bool]),
    ) {
        let is_done = self.tree.traverse_beam(
            simd,
            rays,
            MOST_LEAVES,
            #[inline(always)]
            |leaf, rays| {
                for (ray, is_blocked) in rays.iter_mut().zip(is_blocked.iter_mut()) {
                    if *is_blocked {
                        continue;
                    }
                    let sheared = self.blocks[leaf.block].sheared(simd, &ray.line);
                    let lanes = sheared.meet(simd, ray.place, ray.line.scale);
                    if lanes.is_some_and(|lanes| lanes.any_before(ray.max_distance)) {
                        (ray.max_distance, *is_blocked) = (0.0, true);
                    }
                }
            },
        );
        if !is_done {
            for (ray, is_blocked) in rays.iter_mut().zip(is_blocked) {
                *is_blocked = *is_blocked || self.occluded(simd, ray);
            }
        }
    }

    /// True if anything is hit closer than the ray's limit.
    #[inline(always)]
    pub(super) fn occluded<S: Simd>(&self, simd: S, ray: &mut Ray) -> bool {
        let mut hit = false;
        self.tree.traverse::<FARTHEST_FIRST, S>(
            simd,
            ray,
            #[inline(always)]
            |leaf, ray| {
                let sheared = self.blocks[leaf.block].sheared(simd, &ray.line);
                let lanes = sheared.meet(simd, ray.place, ray.line.scale);
                hit = lanes.is_some_and(|lanes| lanes.any_before(ray.max_distance));
                hit
            },
        );
        hit
    }

    /// Hands the hits in `leaf` closer than the ray's limit, which may be drawn nearer, to `keep`.
    #[inline(always)]
    pub(super) fn each_hit<S: Simd>(
        &self,
        simd: S,
        leaf: Leaf,
        ray: &mut Ray,
        mut keep: impl FnMut(LocalHit, &mut Ray),
    ) {
        let sheared = self.blocks[leaf.block].sheared(simd, &ray.line);
        let Some(lanes) = sheared.meet(simd, ray.place, ray.line.scale) else {
            return;
        };
        for lane in bits_of(lanes.met.inside) {
            let distance = lanes.distance[lane];
            if 0.0 < distance && distance < ray.max_distance {
                let triangle = self.tree.order[leaf.block * LEAF_SIZE + lane];
                keep(lanes.met.hit(lane, distance, triangle), ray);
            }
        }
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.tree.bytes() + self.blocks.capacity() * size_of::<Block>()
    }
}

/// Triangles along a direction, `[corner]`.
struct Sheared<S: Simd> {
    x: [f64x4<S>; 3],
    y: [f64x4<S>; 3],
    depth: [f64x4<S>; 3],
}

impl Block {
    /// Of a leaf's triangles, [`NONE`] where there is none.
    fn new(lanes: &[u32], corners_of: &impl Fn(u32) -> [Vec3; 3]) -> Self {
        let mut corners = [[[f32::NAN; LEAF_SIZE]; 3]; 3];
        for (lane, &index) in lanes.iter().enumerate() {
            if index == NONE {
                continue;
            }
            for (corner, position) in corners_of(index).iter().enumerate() {
                for axis in 0..3 {
                    corners[corner][axis][lane] = position[axis];
                }
            }
        }
        Self { corners }
    }

    #[inline(always)]
    fn sheared<S: Simd>(&self, simd: S, line: &Line) -> Sheared<S> {
        let [kx, ky, kz] = line.axes;
        let zero = f64x4::splat(simd, 0.0);
        let (mut x, mut y, mut depth) = ([zero; 3], [zero; 3], [zero; 3]);
        for (corner, place) in self.corners.iter().enumerate() {
            depth[corner] = doubled(simd, &place[kz]) * line.sign;
            x[corner] = doubled(simd, &place[kx]) - depth[corner] * line.slope[0];
            y[corner] = doubled(simd, &place[ky]) - depth[corner] * line.slope[1];
        }
        Sheared { x, y, depth }
    }
}

impl<S: Simd> Sheared<S> {
    /// The triangles against the ray from `place`; `None` if it meets none.
    #[inline(always)]
    fn meet(&self, simd: S, place: [f64; 3], scale: f64) -> Option<Lanes<S>> {
        let sides = (less(&self.x, place[0]), less(&self.y, place[1]));
        let met = Met::of(
            simd,
            sides,
            #[inline(always)]
            || less(&self.depth, place[2]),
            scale,
        )?;
        Some(Lanes {
            distance: simd.narrow_f64x4(met.distance, met.distance),
            met,
        })
    }
}

#[inline(always)]
fn doubled<S: Simd>(simd: S, numbers: &[f32; LEAF_SIZE]) -> f64x4<S> {
    let [a, b, c, d] = *numbers;
    f64x4::simd_from(simd, [a.into(), b.into(), c.into(), d.into()])
}

/// Coordinates of corners relative to `place`.
#[inline(always)]
fn less<S: Simd>(corners: &[f64x4<S>; 3], place: f64) -> [f64x4<S>; 3] {
    [corners[0] - place, corners[1] - place, corners[2] - place]
}

/// What is met, a lane each.
struct Met<V> {
    /// Edge functions: unnormalised weights of corners 1 and 2, and the sum of all three.
    v: V,
    w: V,
    sum: V,
    /// In lengths of the direction, in front or behind.
    distance: V,
    /// Bits of the lanes whose ray passes through the triangle.
    inside: u64,
}

impl<V> Met<V> {
    /// Triangles `[corner]` relative to rays; `None` if no ray passes through any.
    #[inline(always)]
    fn of<S: Simd>(
        simd: S,
        (x, y): ([V; 3], [V; 3]),
        depth: impl FnOnce() -> [V; 3],
        scale: f64,
    ) -> Option<Self>
    where
        V: SimdFloat<S, Element = f64>,
    {
        let u = x[2] * y[1] - y[2] * x[1];
        let v = x[0] * y[2] - y[0] * x[2];
        let w = x[1] * y[0] - y[1] * x[0];
        let zero = V::splat(simd, 0.0);
        let inside = u.min(v).min(w).simd_ge(zero) | u.max(v).max(w).simd_le(zero);
        let inside = inside.to_bitmask();
        if inside == 0 {
            return None;
        }
        let z = depth();
        let sum = u + v + w;
        let distance = (u * z[0] + v * z[1] + w * z[2]) * scale / sum;
        Some(Self {
            v,
            w,
            sum,
            distance,
            inside,
        })
    }
}

impl<V: Deref<Target = [f64; N]>, const N: usize> Met<V> {
    /// The hit of lane `lane` at `distance`.
    #[inline(always)]
    fn hit(&self, lane: usize, distance: f32, triangle: u32) -> LocalHit {
        let sum = self.sum[lane];
        LocalHit {
            distance,
            triangle,
            u: single_precision(self.v[lane] / sum),
            v: single_precision(self.w[lane] / sum),
            front: sum > 0.0,
        }
    }
}

/// What one ray meets of four triangles.
struct Lanes<S: Simd> {
    met: Met<f64x4<S>>,
    /// Rounded, twice the same four: what counts of a hit.
    distance: f32x8<S>,
}

impl<S: Simd> Lanes<S> {
    /// True if there is a hit in front of the ray and closer than `max_distance`.
    #[inline(always)]
    fn any_before(&self, max_distance: f32) -> bool {
        let is_hit = self.distance.simd_gt(0.0) & self.distance.simd_lt(max_distance);
        is_hit.to_bitmask() & self.met.inside != 0
    }

    /// The first hit that counts for a ray that ends at `end`: a distance, and a triangle at that distance.
    #[inline(always)]
    fn first(&self, indices: &[u32], mut end: (f32, u32)) -> Option<LocalHit> {
        let mut best = None;
        for lane in bits_of(self.met.inside) {
            let (distance, index) = (self.distance[lane], indices[lane]);
            if counts((distance, index), end) {
                end = (distance, index);
                best = Some(lane);
            }
        }
        best.map(|lane| self.met.hit(lane, end.0, end.1))
    }
}

/// True if a hit of a triangle at a distance is in front of a ray and before its `end`.
#[inline(always)]
fn counts((distance, index): (f32, u32), end: (f32, u32)) -> bool {
    distance > 0.0 && (distance < end.0 || distance == end.0 && index < end.1)
}

#[expect(clippy::cast_possible_truncation, reason = "rounds")]
#[inline(always)]
const fn single_precision(x: f64) -> f32 {
    x as f32
}

#[cfg(test)]
impl Triangles {
    /// What `ray` hits of one triangle, without a hierarchy: the definition, in plain numbers.
    pub(super) fn single(corners: [Vec3; 3], ray: &Ray) -> Option<LocalHit> {
        let [a, b, c] = corners.map(|corner| {
            let place = ray.line.place(corner.to_array());
            [0, 1, 2].map(|axis| place[axis] - ray.place[axis])
        });
        let edge = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
        let (u, v, w) = (edge(c, b), edge(a, c), edge(b, a));
        let sum = u + v + w;
        let distance = (u * a[2] + v * b[2] + w * c[2]) * ray.line.scale / sum;
        let distance = single_precision(distance);
        let inside = u.min(v).min(w) >= 0.0 || u.max(v).max(w) <= 0.0;
        (inside && distance > 0.0 && distance < ray.max_distance).then(|| LocalHit {
            distance,
            triangle: 0,
            u: single_precision(v / sum),
            v: single_precision(w / sum),
            front: sum > 0.0,
        })
    }
}
