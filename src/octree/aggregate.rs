//! The tree's shape and its surfels → [`Node`]s with sums and bounds, from the leaves up.
//!
//! Sums are f64, added in the order of the children; second moments are carried about each node's own center, so that
//! nothing cancels.

use super::lobe_sums::LobeSums;
use super::node::{NO_LOBES, Node};
use super::packed::{PackedLobes, PackedNode};
use super::split::Cell;
use super::{FEW, LEAF_SURFEL_COUNT, LeafSurfels};
use crate::math::Bounds3;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Up to here, as |Σ area·normal| / Σ area, the normals of a node are "similar" (PBGI §5) and one disk stands for it.
/// A cap of half-angle 26° has 0.95. At 0.9 the occlusion by a sphere of 5000 surfels, four radii away, is 5 % low.
const LEAST_FLATNESS: f64 = 0.95;

/// Least thickness of a scattered cluster: its variance along the mean normal by that across it. A ball of leaves has 1,
/// the part of a sphere that falls into one class of normals at most 0.1.
const SCATTERED_THICKNESS: f64 = 0.3;

/// Least absolute [`Part::convexity`] of a surface. Sixteen leaves have 0 ± 0.15.
const SCATTERED_CONVEXITY: f64 = 0.3;

/// Second moments: xx, yy, zz, xy, xz, yz.
type Moments = [f64; 6];

/// What a node or a surfel adds to its parent.
#[derive(Debug, Clone)]
struct Part {
    area: f64,
    center: DVec3,
    /// Area · covariance about `center`.
    moments: Moments,
    /// Σ area · normal.
    facing: DVec3,
    /// Σ area · normal · (position − `center`): three times the volume, for a closed surface.
    outward: f64,
    reflected_power: DVec3,
    emitted_power: DVec3,
    bounds: Bounds3,
    /// Radius about `center`.
    radius: f32,
    normal: Vec3,
    spread: f32,
    /// If its normals are spread.
    lobes: Option<Box<LobeSums>>,
}

/// All there is to know but the surfels.
#[derive(Debug, Default)]
pub(super) struct Aggregate {
    /// Breadth first.
    pub nodes: Vec<PackedNode>,
    pub lobes: PackedLobes,
    pub bounds: Bounds3,
}

/// Aggregate all cells, from the leaves up.
pub(super) fn aggregate(levels: &[Vec<Cell>], surfels: &LeafSurfels) -> Aggregate {
    let mut whole = Aggregate::default();
    let mut nodes_of_level: Vec<Vec<PackedNode>> = Vec::with_capacity(levels.len());
    let mut below: Vec<Part> = Vec::new();
    let mut first_below: usize = levels.iter().map(Vec::len).sum();
    whole.nodes.reserve_exact(first_below);
    for cells in levels.iter().rev() {
        let sums = cells.par_iter().with_min_len(FEW);
        let parts: Vec<Part> = sums.map(|cell| sum_cell(cell, surfels, &below)).collect();
        let places = store_lobes(&parts, &mut whole.lobes);
        let rows = parts.par_iter().zip(cells).zip(&places);
        let pack = |((part, cell), &lobes): ((&Part, &Cell), &u32)| {
            PackedNode::of(&part.node(cell, (first_below, lobes)))
        };
        nodes_of_level.push(rows.with_min_len(FEW).map(pack).collect());
        first_below -= cells.len();
        let used = std::mem::replace(&mut below, parts);
        used.into_par_iter().with_min_len(FEW).for_each(drop);
    }
    for nodes in nodes_of_level.into_iter().rev() {
        whole.nodes.par_extend(nodes);
    }
    whole.bounds = below.first().map_or(Bounds3::EMPTY, |root| root.bounds);
    whole
}

/// Append the lobes of `parts`; for each part their place or [`NO_LOBES`].
fn store_lobes(parts: &[Part], all: &mut PackedLobes) -> Vec<u32> {
    let mut next = all.len();
    let place = |part: &Part| match part.lobes {
        None => NO_LOBES,
        Some(_) => {
            next += 1;
            index(next - 1)
        }
    };
    let places = parts.iter().map(place).collect();
    let spread = parts.iter().filter_map(|part| part.lobes.as_deref());
    all.append(&spread.collect::<Vec<_>>());
    places
}

/// A count of nodes, lobes or surfels as stored.
fn index(value: usize) -> u32 {
    u32::try_from(value)
        .expect("a tree has fewer nodes than surfels, and a cloud less than 2³² of those")
}

/// The aggregate of one cell, from its surfels or from its children `below`; with lobes if its normals are spread.
fn sum_cell(cell: &Cell, surfels: &LeafSurfels, below: &[Part]) -> Part {
    let is_spread = |sum: &Part| sum.facing.length() < LEAST_FLATNESS * sum.area;
    if cell.children.is_empty() {
        let mut own = [Surfel::default(); LEAF_SURFEL_COUNT];
        let own = &mut own[..cell.surfels.len()];
        for (surfel, i) in own.iter_mut().zip(cell.surfels.clone()) {
            *surfel = Surfel::of(surfels, i);
        }
        let sum = Part::of_leaf(own);
        let lobes = is_spread(&sum).then(|| Box::new(lobes_of_leaf(own)));
        return Part { lobes, ..sum };
    }
    let parts = &below[cell.children.clone()];
    let sum = Part::sum(parts);
    let lobes = is_spread(&sum).then(|| Box::new(lobes_of(parts)));
    Part { lobes, ..sum }
}

/// Lobes of all parts: their own, or those of a flat part.
fn lobes_of(parts: &[Part]) -> LobeSums {
    let mut sum = LobeSums::default();
    for part in parts {
        match &part.lobes {
            Some(own) => sum.add_child(own),
            None => part.add_flat_lobes(&mut sum),
        }
    }
    sum
}

/// Lobes of a leaf.
fn lobes_of_leaf(surfels: &[Surfel]) -> LobeSums {
    let mut sum = LobeSums::default();
    for one in surfels {
        let power = (one.reflected * PI, one.emitted * PI);
        sum.add_disk(one.normal, one.area, power);
    }
    sum
}

/// A surfel of a leaf, unpacked.
#[derive(Debug, Clone, Copy, Default)]
struct Surfel {
    position: Vec3,
    normal: Vec3,
    radius: f32,
    area: f32,
    reflected: Vec3,
    emitted: Vec3,
}

impl Surfel {
    fn of(surfels: &LeafSurfels, i: usize) -> Self {
        Self {
            position: surfels.position(i),
            normal: surfels.normal(i),
            radius: surfels.radius(i),
            area: surfels.area(i),
            reflected: surfels.reflected(i),
            emitted: surfels.emitted(i),
        }
    }
}

impl Part {
    /// The sum of the surfels of a leaf (at least one). Moments are taken about the first and moved.
    fn of_leaf(surfels: &[Surfel]) -> Self {
        let about = surfels[0].position;
        let (mut area, mut shift, mut moments) = (0.0, DVec3::ZERO, [0.0; 6]);
        let (mut facing, mut outward) = (DVec3::ZERO, 0.0);
        let (mut reflected, mut emitted) = (DVec3::ZERO, DVec3::ZERO);
        let mut bounds = Bounds3::EMPTY;
        for one in surfels {
            let (own, normal) = (f64::from(one.area), one.normal.as_dvec3());
            let offset = (one.position - about).as_dvec3();
            area += own;
            shift += offset * own;
            facing += normal * own;
            outward += normal.dot(offset) * own;
            reflected += one.reflected.as_dvec3() * own;
            emitted += one.emitted.as_dvec3() * own;
            let (place, square) = (products(offset), square_moments(own, normal));
            for (sum, (place, square)) in moments.iter_mut().zip(place.iter().zip(square)) {
                *sum += own * place + square;
            }
            let reach = (Vec3::ONE - one.normal * one.normal).max(Vec3::ZERO);
            let reach = one.radius * reach.map(f32::sqrt);
            bounds.min = bounds.min.min(one.position - reach);
            bounds.max = bounds.max.max(one.position + reach);
        }
        let shift = if area > 0.0 {
            shift / area
        } else {
            (bounds.center() - about).as_dvec3()
        };
        let center = about.as_dvec3() + shift;
        let moved = products(shift);
        let normal = facing
            .as_vec3()
            .try_normalize()
            .unwrap_or(surfels[0].normal);
        Self {
            area,
            center,
            moments: std::array::from_fn(|i| moments[i] - area * moved[i]),
            facing,
            outward: outward - facing.dot(shift),
            reflected_power: reflected * std::f64::consts::PI,
            emitted_power: emitted * std::f64::consts::PI,
            bounds,
            radius: radius_of_leaf(center.as_vec3(), surfels, &bounds),
            normal,
            spread: spread_of_leaf(normal, surfels),
            lobes: None,
        }
    }

    /// The sum of `parts` (at least one) in their order, without lobes.
    fn sum(parts: &[Self]) -> Self {
        let total = |value: fn(&Self) -> DVec3| parts.iter().map(value).sum::<DVec3>();
        let area: f64 = parts.iter().map(|part| part.area).sum();
        let bounds = parts
            .iter()
            .fold(Bounds3::EMPTY, |all, part| all.union(part.bounds));
        let center = if area > 0.0 {
            total(|part| part.center * part.area) / area
        } else {
            bounds.center().as_dvec3()
        };
        let facing = total(|part| part.facing);
        let normal = facing.as_vec3().try_normalize().unwrap_or(parts[0].normal);
        Self {
            area,
            center,
            moments: parts.iter().fold([0.0; 6], |sum, part| {
                let shifted = part.moments_about(center);
                std::array::from_fn(|i| sum[i] + shifted[i])
            }),
            facing,
            outward: parts
                .iter()
                .map(|part| part.outward + part.facing.dot(part.center - center))
                .sum(),
            reflected_power: total(|part| part.reflected_power),
            emitted_power: total(|part| part.emitted_power),
            bounds,
            radius: radius_about(center.as_vec3(), parts, &bounds),
            normal,
            spread: spread_about(normal, parts),
            lobes: None,
        }
    }

    /// Area · covariance about `center` instead of the own center (Steiner).
    fn moments_about(&self, center: DVec3) -> Moments {
        let outer = products(self.center - center);
        std::array::from_fn(|i| self.moments[i] + self.area * outer[i])
    }

    /// How much the normals point away from the center: mean of normal · (position − center) by the surfels' rms distance
    /// from it. 1 for a sphere, 0 for leaves, −1 for a hollow seen from inside.
    fn convexity(&self) -> f64 {
        let [xx, yy, zz, ..] = self.moments;
        let scale = (self.area * (xx + yy + zz)).sqrt();
        if scale > 0.0 {
            self.outward / scale
        } else {
            0.0
        }
    }

    /// See [`Node::is_scattered`], but for flat ones.
    fn is_scattered(&self) -> bool {
        let [xx, yy, zz, xy, xz, yz] = self.moments;
        let n = self.normal.as_dvec3();
        let thickness = xx * n.x * n.x
            + yy * n.y * n.y
            + zz * n.z * n.z
            + 2.0 * (xy * n.x * n.y + xz * n.x * n.z + yz * n.y * n.z);
        let width = 0.5 * (xx + yy + zz - thickness);
        thickness > SCATTERED_THICKNESS * width && self.convexity().abs() < SCATTERED_CONVEXITY
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "f64 sums are stored as f32"
    )]
    fn add_flat_lobes(&self, sum: &mut LobeSums) {
        let flatness = if self.area > 0.0 {
            self.facing.length() / self.area
        } else {
            1.0
        };
        let about = (self.normal, flatness.min(1.0) as f32);
        let power = (self.reflected_power.as_vec3(), self.emitted_power.as_vec3());
        sum.add_flat(about, self.area as f32, power);
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "f64 sums are stored as f32"
    )]
    fn node(&self, cell: &Cell, (first_below, lobes): (usize, u32)) -> Node {
        let per_area = if self.area > 0.0 {
            1.0 / self.area
        } else {
            0.0
        };
        let is_leaf = cell.children.is_empty();
        let (first, count) = if is_leaf {
            (cell.surfels.start, cell.surfels.len())
        } else {
            (first_below + cell.children.start, cell.children.len())
        };
        Node {
            center: self.center.as_vec3(),
            radius: self.radius,
            normal: self.normal,
            spread: self.spread,
            area: self.area as f32,
            facing_area: self.facing.length() as f32,
            size: self.bounds.max - self.bounds.min,
            covariance: self.moments.map(|moment| (moment * per_area) as f32),
            reflected_power: self.reflected_power.as_vec3(),
            emitted_power: self.emitted_power.as_vec3(),
            first: index(first),
            count: index(count),
            is_leaf,
            is_scattered: lobes != NO_LOBES && self.is_scattered(),
            lobes,
        }
    }
}

/// Radius of a ball about `center` around all parts: the smaller of the one around their balls and around the box.
fn radius_about(center: Vec3, parts: &[Part], bounds: &Bounds3) -> f32 {
    let around_balls = parts.iter().fold(0.0_f32, |radius, part| {
        radius.max(part.center.as_vec3().distance(center) + part.radius)
    });
    let farthest_corner = (bounds.max - center).max(center - bounds.min);
    around_balls.min(farthest_corner.length())
}

/// Radius of a ball about `center` around all disks: the smaller of the one around their balls and around the box.
fn radius_of_leaf(center: Vec3, surfels: &[Surfel], bounds: &Bounds3) -> f32 {
    let around_balls = surfels.iter().fold(0.0_f32, |radius, one| {
        radius.max(center.distance(one.position) + one.radius)
    });
    let farthest_corner = (bounds.max - center).max(center - bounds.min);
    around_balls.min(farthest_corner.length())
}

/// Half-angle of a cone about `normal` around all normals, by the longest chord: exact for small angles too.
fn spread_of_leaf(normal: Vec3, surfels: &[Surfel]) -> f32 {
    let chord = |one: &Surfel| one.normal.distance_squared(normal);
    let longest = surfels.iter().map(chord).fold(0.0, f32::max).sqrt();
    2.0 * (0.5 * longest).min(1.0).asin()
}

/// Half-angle of a cone about `normal` around the cones of all parts, at most π.
fn spread_about(normal: Vec3, parts: &[Part]) -> f32 {
    parts.iter().fold(0.0_f32, |spread, part| {
        let angle = normal
            .cross(part.normal)
            .length()
            .atan2(normal.dot(part.normal));
        spread.max((angle + part.spread).min(PI))
    })
}

/// Area · covariance of a square of `area` across `normal`.
fn square_moments(area: f64, normal: DVec3) -> Moments {
    let outer = products(normal);
    let variance = area / 12.0;
    std::array::from_fn(|i| {
        let identity = if i < 3 { 1.0 } else { 0.0 };
        area * variance * (identity - outer[i])
    })
}

/// The products of the components of `v`, in the order of [`Moments`].
fn products(v: DVec3) -> Moments {
    [
        v.x * v.x,
        v.y * v.y,
        v.z * v.z,
        v.x * v.y,
        v.x * v.z,
        v.y * v.z,
    ]
}
