//! Light of surfels that are near: too near for their outline not to matter. Short rays against the scene itself, in
//! directions that all receivers share.
//!
//! What is split between rays and areas are pairs of a receiver and a surfel: a ray counts for the surfel that it meets,
//! if that is near to its receiver. Nothing counts twice, and nothing is left out.

use super::RasterEngine;
use super::group::{Group, MOST};
use crate::gather::radiance::surfel_of;
use crate::math::bits::bits_of;
use crate::math::sequence;
use glam::{Mat3, Vec3};
use std::f32::consts::PI;

/// Directions over the sphere for a raster of one pixel.
const DIRECTIONS: u32 = 4;

/// Turns the spiral's axis away from those of walls and objects.
const TILT: Mat3 = Mat3::from_cols(
    Vec3::new(0.8, 0.0, 0.6),
    Vec3::new(0.36, 0.8, -0.48),
    Vec3::new(-0.48, 0.6, 0.64),
);

/// Unit directions evenly spread over the sphere.
#[derive(Debug)]
pub(super) struct Directions(Vec<Vec3>);

impl Directions {
    /// As many as a raster of `resolution`² pixels on each side of a cube has, about.
    pub(super) fn new(resolution: u32) -> Self {
        let count = resolution
            .saturating_mul(resolution)
            .saturating_mul(DIRECTIONS)
            .min(1 << 20);
        let direction = |i| (TILT * sequence::spiral_sphere(i, count)).normalize();
        Self((0..count).map(direction).collect())
    }
}

/// Irradiance of each member of `group` from the surfels that are `near` to it: places in leaf order and
/// receivers.
pub(super) fn irradiance(
    engine: &RasterEngine<'_>,
    group: &Group,
    near: &[(u32, u64)],
) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; group.len()];
    if near.is_empty() {
        return sums;
    }
    let mut near = near.to_vec();
    near.sort_unstable();
    let (asking, reach) = who_asks(engine, group, &near);
    let reach = reach.min(engine.knobs.max_distance);
    let surfels = engine.octree.surfels();
    let mut hits = [None; MOST];
    let mut starts = [Vec3::ZERO; MOST];
    for (&direction, &asking) in engine.directions.0.iter().zip(&asking) {
        if asking == 0 {
            continue;
        }
        let starts = &mut starts[..group.len()];
        for (i, start) in starts.iter_mut().enumerate() {
            *start = group.start(i, direction);
        }
        (engine.tracer).closest_along(direction, starts, (reach, asking), &mut hits);
        for i in bits_of(asking) {
            let Some(hit) = hits[i] else { continue };
            let id = surfel_of(engine.surfels.dice(), &hit);
            let Some(place) = id.map(|id| engine.place[id as usize]) else {
                continue;
            };
            let found = near.binary_search_by_key(&place, |&(place, _)| place);
            if found.is_ok_and(|k| near[k].1 >> i & 1 == 1) {
                let radius = surfels.radius(place as usize);
                let anew = (engine.surfels.near()).filter(|light| light.is_near(&hit, radius));
                let light = anew.map(|light| light.reflected(&hit));
                let light = light.unwrap_or(surfels.reflected(place as usize));
                sums[i] += light * group.normals[i].dot(direction);
            }
        }
    }
    let anyone = near.iter().fold(0, |all, (_, mask)| all | mask);
    for i in bits_of(anyone) {
        sums[i] *= PI / cosines(&engine.directions, group.normals[i]);
    }
    sums
}

/// Sum of the cosines of all directions above the horizon of `normal`.
fn cosines(directions: &Directions, normal: Vec3) -> f32 {
    let cosine = |direction: &Vec3| normal.dot(*direction).max(0.0);
    directions.0.iter().map(cosine).sum()
}

/// For every direction the receivers that may meet a surfel of theirs along it, and the longest way to one.
fn who_asks(engine: &RasterEngine<'_>, group: &Group, near: &[(u32, u64)]) -> (Vec<u64>, f32) {
    let surfels = engine.octree.surfels();
    let mut asking = vec![0_u64; engine.directions.0.len()];
    let mut reach = 0.0_f32;
    for &(place, receivers) in near {
        let (position, radius) = (
            surfels.position(place as usize),
            surfels.radius(place as usize),
        );
        for i in bits_of(receivers) {
            let offset = position - group.origins[i];
            let distance = offset.length();
            reach = reach.max(distance + radius);
            // The cone around the surfel's ball; everything from within.
            let inside = distance * distance - radius * radius;
            let least = if inside > 0.0 {
                inside.sqrt()
            } else {
                f32::NEG_INFINITY
            };
            for (asking, direction) in asking.iter_mut().zip(&engine.directions.0) {
                let is_toward = offset.dot(*direction) >= least;
                let is_above = group.normals[i].dot(*direction) > 0.0;
                *asking |= u64::from(is_toward & is_above) << i;
            }
        }
    }
    (asking, reach)
}
