//! Where the directions of an environment set lie: evenly spread ones, and others where light concentrates.

use super::texels::{Sky, Texel};
use crate::math::luminance;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

const LLOYD_STEPS: usize = 3;
/// Parts a side of a texel, at most: 16 directions for a sun.
const MOST_ACROSS: u8 = 4;
/// Blocks of texels a unit of parallel work.
const BLOCKS: usize = 128;

/// Up to `count` directions where skies are brighter than their mean: equal shares of that excess, then Lloyd's steps.
pub(super) fn importance(skies: &[Sky], count: usize) -> Vec<Vec3> {
    let (blocks, share) = cap_peaks(excess(skies), count);
    let mut directions = Vec::with_capacity(count);
    let mut sum = 0.5 * share;
    for texel in blocks.iter().flatten() {
        sum += f64::from(texel.light.x);
        while share > 0.0 && sum >= share && directions.len() < count {
            sum -= share;
            directions.push(texel.direction.normalize_or(Vec3::Y));
        }
    }
    directions.dedup();
    for _ in 0..LLOYD_STEPS {
        directions = lloyd_step(&blocks, &directions);
    }
    directions
}

/// The same skies, texels that hold more than a share of `count` directions (suns) cut into smaller ones: each may then
/// have several directions, so that its shadow has a penumbra as wide as itself.
pub(super) fn split_peaks(skies: &[Sky], count: usize) -> Vec<Sky> {
    let (_, share) = cap_peaks(excess(skies), count);
    let split = |block: &Vec<Texel>| {
        let parts = |texel: &Texel| texel.split(parts_across(texel, share));
        block.iter().flat_map(parts).collect()
    };
    (skies.iter())
        .map(|sky| Sky {
            blocks: sky.blocks.iter().map(split).collect(),
        })
        .collect()
}

/// Squared: the root of the number of shares that it holds, since the error where an edge of a shadow crosses a part
/// falls with its light and, more slowly, with its width. At most [`MOST_ACROSS`].
fn parts_across(texel: &Texel, share: f64) -> u8 {
    let shares = f64::from(luminance(texel.light)) / share;
    (2..=MOST_ACROSS)
        .rev()
        .find(|&side| shares >= f64::from(side).powi(4))
        .unwrap_or(1)
}

/// What of each texel is brighter than the mean of its sky, all components alike.
#[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
fn excess(skies: &[Sky]) -> Vec<Vec<Texel>> {
    let of = |sky: &Sky| {
        let mean = sky.mean() as f32;
        let excess = move |texel: &Texel| Texel {
            light: Vec3::splat((luminance(texel.light) - mean * texel.solid_angle).max(0.0)),
            ..*texel
        };
        (sky.blocks.iter())
            .map(|block| block.iter().map(excess).collect())
            .collect::<Vec<_>>()
    };
    skies.iter().flat_map(of).collect()
}

/// Cuts texels that hold more than one direction's share (a sun) down to it, so that they do not take the directions of
/// everything else; returns the share too.
#[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
fn cap_peaks(mut blocks: Vec<Vec<Texel>>, count: usize) -> (Vec<Vec<Texel>>, f64) {
    let mut share = 0.0;
    // every step takes the excess of the brightest texels away; what then counts as bright settles quickly
    for _ in 0..8 {
        let total: f64 = (blocks.iter().flatten())
            .map(|texel| f64::from(texel.light.x))
            .sum();
        share = total / count.max(1) as f64;
        let cap = Vec3::splat(share as f32);
        for texel in blocks.iter_mut().flatten() {
            texel.light = texel.light.min(cap);
        }
    }
    (blocks, share)
}

/// Moves each direction to the centroid of the light nearest to it; those without light stay.
fn lloyd_step(blocks: &[Vec<Texel>], directions: &[Vec3]) -> Vec<Vec3> {
    if directions.is_empty() {
        return Vec::new();
    }
    let part = |blocks: &[Vec<Texel>]| {
        let mut centroids = vec![DVec3::ZERO; directions.len()];
        let lit = |block: &&Vec<Texel>| block.iter().any(|texel| texel.light.x > 0.0);
        for block in blocks.iter().filter(lit) {
            assign(block, directions, |nearest, texel| {
                centroids[nearest] += texel.direction.as_dvec3() * f64::from(texel.light.x);
            });
        }
        centroids
    };
    let parts: Vec<_> = blocks.par_chunks(BLOCKS).map(part).collect();
    let moved = |(i, old): (usize, &Vec3)| {
        let sum: DVec3 = parts.iter().map(|part| part[i]).sum();
        sum.try_normalize().map_or(*old, |d| d.as_vec3())
    };
    directions.iter().enumerate().map(moved).collect()
}

/// Calls `put` with the index of the nearest direction for each texel of a small block.
pub(super) fn assign(block: &[Texel], directions: &[Vec3], mut put: impl FnMut(usize, &Texel)) {
    let middle = block.iter().map(|texel| texel.direction).sum::<Vec3>();
    let middle = middle.normalize_or(Vec3::Y);
    let radius =
        |least: f32, texel: &Texel| least.min(texel.direction.normalize_or(middle).dot(middle));
    let to_edge = block.iter().fold(1.0_f32, radius);
    let cosines: Vec<f32> = directions.iter().map(|d| d.dot(middle)).collect();
    let nearest = cosines.iter().copied().fold(-1.0_f32, f32::max);
    // a direction nearer to some texel than the middle's nearest is at most two radii farther from the middle
    let reach = nearest.clamp(-1.0, 1.0).acos() + 2.0 * to_edge.clamp(-1.0, 1.0).acos();
    let least = reach.min(std::f32::consts::PI).cos() - ROUNDING;
    let candidates: Vec<usize> = (0..directions.len())
        .filter(|&i| cosines[i] >= least)
        .collect();
    for texel in block {
        let mut best = (f32::NEG_INFINITY, 0);
        for &i in &candidates {
            let cosine = directions[i].dot(texel.direction);
            if cosine > best.0 {
                best = (cosine, i);
            }
        }
        put(best.1, texel);
    }
}

/// Error of a cosine found by `acos` and `cos` of sums, several times over.
const ROUNDING: f32 = 1e-5;
