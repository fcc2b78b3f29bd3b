//! The tree's shape and its surfels → [`Node`]s with sums and bounds, from the leaves up.
//!
//! Sums are f64, added in the order of the children; second moments are carried about each node's own center, so that
//! nothing cancels.

use super::node::{Lobes, NO_LOBES, Node};
use super::split::Cell;
use super::{LeafSurfels, NodeKind};
use crate::math::Bounds3;
use crate::math::sh::{CLAMPED_COSINE, Sh9};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Up to here, as |Σ area·normal| / Σ area, the normals of a node are "similar" (PBGI §5) and one disk stands for it.
/// A cap of half-angle 26° has 0.95. At 0.9 the occlusion by a sphere of 5000 surfels, four radii away, is 5 % low.
const LEAST_FLATNESS: f64 = 0.95;

/// Second moments: xx, yy, zz, xy, xz, yz.
type Moments = [f64; 6];

/// What a node or a surfel adds to its parent.
#[derive(Debug, Clone, Copy)]
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
    lobes: u32,
}

/// All nodes, breadth first, and the lobes that they refer to.
pub(super) fn aggregate(levels: &[Vec<Cell>], surfels: &LeafSurfels) -> (Vec<Node>, Vec<Lobes>) {
    let mut lobes = Vec::new();
    let mut nodes_of_level: Vec<Vec<Node>> = Vec::with_capacity(levels.len());
    let mut below: Vec<Part> = Vec::new();
    for (depth, cells) in levels.iter().enumerate().rev() {
        let first_below: usize = levels[..=depth].iter().map(Vec::len).sum();
        let mut summed: Vec<(Part, Option<Lobes>)> = cells
            .par_iter()
            .map(|cell| sum_cell(cell, surfels, &below, &lobes))
            .collect();
        for (part, own_lobes) in &mut summed {
            if let Some(own_lobes) = own_lobes {
                part.lobes = index(lobes.len());
                lobes.push(*own_lobes);
            }
        }
        below = summed.into_iter().map(|(part, _)| part).collect();
        let nodes = below.par_iter().zip(cells);
        nodes_of_level.push(
            nodes
                .map(|(part, cell)| part.node(cell, first_below))
                .collect(),
        );
    }
    nodes_of_level.reverse();
    (nodes_of_level.into_iter().flatten().collect(), lobes)
}

/// A count of nodes, lobes or surfels as stored.
fn index(value: usize) -> u32 {
    u32::try_from(value)
        .expect("a tree has fewer nodes than surfels, and a cloud less than 2³² of those")
}

/// The aggregate of one cell, from its surfels or from its children in `below`; lobes if its normals are spread.
fn sum_cell(
    cell: &Cell,
    surfels: &LeafSurfels,
    below: &[Part],
    lobes: &[Lobes],
) -> (Part, Option<Lobes>) {
    let leaf_parts: Vec<Part>;
    let parts = if cell.children.is_empty() {
        leaf_parts = cell
            .surfels
            .clone()
            .map(|i| Part::of_surfel(surfels, i))
            .collect();
        &leaf_parts
    } else {
        &below[cell.children.clone()]
    };
    let sum = Part::sum(parts);
    let is_flat = sum.facing.length() >= LEAST_FLATNESS * sum.area;
    (sum, (!is_flat).then(|| sum_lobes(parts, lobes)))
}

/// Lobes of all parts: their own, or those of a flat part.
fn sum_lobes(parts: &[Part], lobes: &[Lobes]) -> Lobes {
    let mut sum = Lobes::default();
    for part in parts {
        let own = match part.lobes {
            NO_LOBES => part.flat_lobes(),
            index => lobes[index as usize],
        };
        sum.area += own.area;
        for channel in 0..3 {
            sum.reflected[channel] += own.reflected[channel];
            sum.emitted[channel] += own.emitted[channel];
        }
    }
    sum
}

impl Part {
    fn of_surfel(surfels: &LeafSurfels, i: usize) -> Self {
        let (position, normal) = (surfels.position[i], surfels.normal[i]);
        let (area, radius) = (f64::from(surfels.area[i]), surfels.radius[i]);
        let power = |radiance: Vec3| radiance.as_dvec3() * (area * std::f64::consts::PI);
        let reach = radius * (Vec3::ONE - normal * normal).max(Vec3::ZERO).map(f32::sqrt);
        Self {
            area,
            center: position.as_dvec3(),
            moments: square_moments(area, normal.as_dvec3()),
            facing: normal.as_dvec3() * area,
            outward: 0.0,
            reflected_power: power(surfels.reflected[i]),
            emitted_power: power(surfels.emitted[i]),
            bounds: Bounds3 {
                min: position - reach,
                max: position + reach,
            },
            radius,
            normal,
            spread: 0.0,
            lobes: NO_LOBES,
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
            lobes: NO_LOBES,
        }
    }

    /// Area · covariance about `center` instead of the own center (Steiner).
    fn moments_about(&self, center: DVec3) -> Moments {
        let outer = products(self.center - center);
        std::array::from_fn(|i| self.moments[i] + self.area * outer[i])
    }

    /// See [`Node::convexity`].
    fn convexity(&self) -> f64 {
        let [xx, yy, zz, ..] = self.moments;
        let scale = (self.area * (xx + yy + zz)).sqrt();
        if scale > 0.0 {
            self.outward / scale
        } else {
            0.0
        }
    }

    /// The lobes of a flat part. Normals scattered about their mean, of mean length f, weaken band l of the clamped
    /// cosine as diffusion on the sphere does, by f^(l(l+1)/2): band 0, the sum of the areas, stays exact.
    fn flat_lobes(&self) -> Lobes {
        let flatness = if self.area > 0.0 {
            self.facing.length() / self.area
        } else {
            1.0
        };
        #[expect(
            clippy::cast_possible_truncation,
            reason = "f64 sums are stored as f32"
        )]
        let (area, f) = (self.area as f32, flatness.min(1.0) as f32);
        let [band0, band1, band2] = CLAMPED_COSINE;
        let cosine = Sh9::zonal(self.normal, [band0, band1 * f, band2 * f.powi(3)]);
        let scaled = |power: DVec3| power.as_vec3().to_array().map(|value| cosine * value);
        Lobes {
            area: cosine * area,
            reflected: scaled(self.reflected_power),
            emitted: scaled(self.emitted_power),
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "f64 sums are stored as f32"
    )]
    fn node(&self, cell: &Cell, first_below: usize) -> Node {
        let per_area = if self.area > 0.0 {
            1.0 / self.area
        } else {
            0.0
        };
        let kind = if cell.children.is_empty() {
            NodeKind::Leaf(cell.surfels.clone())
        } else {
            NodeKind::Inner(first_below + cell.children.start..first_below + cell.children.end)
        };
        let is_leaf = matches!(kind, NodeKind::Leaf(_));
        let (NodeKind::Leaf(range) | NodeKind::Inner(range)) = kind;
        Node {
            bounds: self.bounds,
            center: self.center.as_vec3(),
            radius: self.radius,
            normal: self.normal,
            spread: self.spread,
            area: self.area as f32,
            facing_area: self.facing.length() as f32,
            convexity: self.convexity() as f32,
            covariance: self.moments.map(|moment| (moment * per_area) as f32),
            reflected_power: self.reflected_power.as_vec3(),
            emitted_power: self.emitted_power.as_vec3(),
            first: index(range.start),
            count: index(range.len()),
            is_leaf,
            lobes: self.lobes,
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
