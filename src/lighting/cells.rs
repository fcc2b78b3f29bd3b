//! Divides a sky into cells: evenly spread directions plus importance directions where light concentrates, every texel
//! in the cell of the nearest direction, and the moments of each cell.

use super::environment::Dome;
use super::pattern;
use crate::image::Latlong;
use crate::math::luminance;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Texels of a map that stands for an even sky.
const UNIFORM_MAP: (usize, usize) = (512, 256);
/// Importance directions are placed on maps of at most this many texels across.
const PLACING_WIDTH: usize = 1024;
/// Texels are assigned in square blocks of this side: the nearest directions are sought once a block.
const BLOCK: usize = 8;
const LLOYD_STEPS: usize = 3;

/// Part of the sky.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    /// Unit, to the centroid of its light.
    direction: Vec3,
    /// ∫ L ω dω: `moments[axis]` is a color.
    moments: [Vec3; 3],
    /// ∫ L ω dω along `direction`, a color.
    flux: Vec3,
    /// Half width of the cell along any axis, as a difference of cosines, if its light were spread evenly over it.
    half_width: f32,
}

impl Cell {
    /// Irradiance for a receiver with unit `normal`, and the direction to look for what blocks it; `None` if below the
    /// horizon. A cell across the horizon counts with its upper part, as if it were spread evenly over its width.
    pub(super) fn irradiance(&self, normal: Vec3) -> Option<(Vec3, Vec3)> {
        let cosine = normal.dot(self.direction);
        if cosine <= -self.half_width {
            return None;
        }
        if cosine >= self.half_width {
            let [x, y, z] = self.moments;
            let irradiance = x * normal.x + y * normal.y + z * normal.z;
            return Some((irradiance.max(Vec3::ZERO), self.direction));
        }
        let top = cosine + self.half_width;
        let irradiance = self.flux * (top * top / (4.0 * self.half_width));
        let direction = self.direction + normal * (2.0 / 3.0 * top - cosine);
        Some((irradiance, direction.try_normalize()?))
    }
}

/// The cells of the sum of all `domes`, about `count`; no importance directions if `is_uniform`.
pub(super) fn build_cells(domes: &[Dome], count: usize, is_uniform: bool) -> Vec<Cell> {
    let maps: Vec<Sky<'_>> = domes.iter().map(Sky::new).collect();
    let importance = if is_uniform {
        Vec::new()
    } else {
        place_importance(&maps, count / 2)
    };
    let mut directions = pattern::sphere(count - importance.len());
    directions.extend(importance);
    let mut sums = vec![Sums::default(); directions.len()];
    for sky in &maps {
        for part in sky.sums(&directions) {
            for (sum, part) in sums.iter_mut().zip(part) {
                sum.add(&part);
            }
        }
    }
    sums.iter().filter_map(Sums::cell).collect()
}

/// A dome's map, or an even one.
struct Sky<'a> {
    dome: &'a Dome,
    map: std::borrow::Cow<'a, Latlong>,
}

/// A texel in world space.
#[derive(Clone, Copy)]
struct Texel {
    direction: Vec3,
    /// Radiance times solid angle.
    light: Vec3,
    solid_angle: f32,
}

/// Sums over a cell.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// Σ luminance.
    total: f64,
    /// Σ color · direction, an axis each.
    moments: [DVec3; 3],
}

impl Sums {
    fn add(&mut self, other: &Self) {
        self.total += other.total;
        for axis in 0..3 {
            self.moments[axis] += other.moments[axis];
        }
    }

    fn add_texel(&mut self, texel: &Texel) {
        self.total += f64::from(luminance(texel.light));
        for axis in 0..3 {
            self.moments[axis] += texel.light.as_dvec3() * f64::from(texel.direction[axis]);
        }
    }

    /// `None` for a cell without light.
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    fn cell(&self) -> Option<Cell> {
        let bright = |color: DVec3| color.dot(DVec3::new(0.2126, 0.7152, 0.0722));
        let [x, y, z] = self.moments;
        let moment = DVec3::new(bright(x), bright(y), bright(z));
        let direction = moment.try_normalize()?;
        // directions are unit, so that their variance about the centroid is 1 − |mean|², over two axes
        let mean = moment.length() / self.total;
        let variance = 0.5 * (1.0 - mean * mean).max(0.0);
        Some(Cell {
            direction: direction.as_vec3(),
            moments: self.moments.map(|m| m.as_vec3()),
            flux: (x * direction.x + y * direction.y + z * direction.z).as_vec3(),
            half_width: (3.0 * variance).sqrt() as f32,
        })
    }
}

impl<'a> Sky<'a> {
    fn new(dome: &'a Dome) -> Self {
        let even = || std::borrow::Cow::Owned(even_map(UNIFORM_MAP.0, UNIFORM_MAP.1));
        let map = (dome.map.as_ref()).map_or_else(even, std::borrow::Cow::Borrowed);
        Self { dome, map }
    }

    /// The same sky with fewer texels, if there are many.
    fn coarse(&self) -> Self {
        let factor = self.map.width.div_ceil(PLACING_WIDTH);
        let map = if factor > 1 {
            std::borrow::Cow::Owned(reduced(&self.map, factor))
        } else {
            self.map.clone()
        };
        Self {
            dome: self.dome,
            map,
        }
    }

    fn rows_of_blocks(&self) -> usize {
        self.map.height.div_ceil(BLOCK)
    }

    /// The blocks of one row of blocks, each with its texels.
    fn blocks(&self, row: usize) -> impl Iterator<Item = Vec<Texel>> {
        let rows = row * BLOCK..((row + 1) * BLOCK).min(self.map.height);
        (0..self.map.width.div_ceil(BLOCK)).map(move |column| {
            let columns = column * BLOCK..((column + 1) * BLOCK).min(self.map.width);
            let mut texels = Vec::with_capacity(BLOCK * BLOCK);
            for y in rows.clone() {
                let solid_angle = self.map.solid_angle(y);
                for x in columns.clone() {
                    let local = self.map.direction(x, y);
                    let pixel = self.map.pixels[y * self.map.width + x];
                    texels.push(Texel {
                        direction: self.dome.world_from_dome * local,
                        light: pixel * self.dome.radiance * solid_angle,
                        solid_angle,
                    });
                }
            }
            texels
        })
    }

    /// Sums of every direction's cell over this sky, one list a row of blocks, in order.
    fn sums(&self, directions: &[Vec3]) -> Vec<Vec<Sums>> {
        (0..self.rows_of_blocks())
            .into_par_iter()
            .map(|row| {
                let mut sums = vec![Sums::default(); directions.len()];
                for block in self.blocks(row) {
                    assign(&block, directions, |nearest, texel| {
                        sums[nearest].add_texel(texel);
                    });
                }
                sums
            })
            .collect()
    }
}

/// A map of radiance 1.
pub(super) fn even_map(width: usize, height: usize) -> Latlong {
    Latlong {
        width,
        height,
        pixels: vec![Vec3::ONE; width * height],
        repaired: 0,
    }
}

/// Averages blocks of `factor × factor` texels (fewer at the right and lower edge), by solid angle.
fn reduced(map: &Latlong, factor: usize) -> Latlong {
    let (width, height) = (map.width.div_ceil(factor), map.height.div_ceil(factor));
    let mean = |x: usize, y: usize| {
        let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
        for row in y * factor..((y + 1) * factor).min(map.height) {
            let weight = map.solid_angle(row);
            for column in x * factor..((x + 1) * factor).min(map.width) {
                sum += map.pixels[row * map.width + column] * weight;
                weights += weight;
            }
        }
        sum / weights
    };
    let pixels = (0..width * height)
        .into_par_iter()
        .map(|i| mean(i % width, i / width))
        .collect();
    Latlong {
        width,
        height,
        pixels,
        repaired: map.repaired,
    }
}

/// Calls `put` with the index of the nearest direction for each texel of a small block.
fn assign(block: &[Texel], directions: &[Vec3], mut put: impl FnMut(usize, &Texel)) {
    let middle = block.iter().map(|texel| texel.direction).sum::<Vec3>();
    let Some(middle) = middle.try_normalize() else {
        return;
    };
    let to_edge = (block.iter()).fold(1.0_f32, |least, t| least.min(t.direction.dot(middle)));
    let nearest = (directions.iter()).fold(-1.0_f32, |most, d| most.max(d.dot(middle)));
    // a direction nearer to some texel than the middle's nearest is at most two radii farther from the middle
    let reach = nearest.clamp(-1.0, 1.0).acos() + 2.0 * to_edge.clamp(-1.0, 1.0).acos();
    let least = reach.min(std::f32::consts::PI).cos() - 1e-5;
    let candidates: Vec<usize> = (0..directions.len())
        .filter(|&i| directions[i].dot(middle) >= least)
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

/// Up to `count` directions where the sky is brighter than its mean: equal shares of that excess, then Lloyd's steps.
fn place_importance(skies: &[Sky<'_>], count: usize) -> Vec<Vec3> {
    let blocks: Vec<Vec<Texel>> = skies
        .iter()
        .flat_map(|sky| {
            let coarse = sky.coarse();
            let mean = mean_radiance(&coarse);
            let blocks =
                (0..coarse.rows_of_blocks()).flat_map(|row| coarse.blocks(row).collect::<Vec<_>>());
            let excess = |mut texel: Texel| {
                let excess = luminance(texel.light) - mean * texel.solid_angle;
                texel.light = Vec3::splat(excess.max(0.0));
                texel
            };
            blocks
                .map(|block| block.into_iter().map(excess).collect())
                .collect::<Vec<Vec<Texel>>>()
        })
        .collect();
    let (blocks, share) = cap_peaks(blocks, count);
    let mut directions = Vec::with_capacity(count);
    let mut sum = 0.5 * share;
    for texel in blocks.iter().flatten() {
        sum += f64::from(texel.light.x);
        while share > 0.0 && sum >= share && directions.len() < count {
            sum -= share;
            directions.push(texel.direction);
        }
    }
    directions.dedup();
    for _ in 0..LLOYD_STEPS {
        directions = lloyd_step(&blocks, &directions);
    }
    directions
}

fn mean_radiance(sky: &Sky<'_>) -> f32 {
    let (mut light, mut area) = (0.0_f64, 0.0_f64);
    for texel in (0..sky.rows_of_blocks())
        .flat_map(|row| sky.blocks(row))
        .flatten()
    {
        light += f64::from(luminance(texel.light));
        area += f64::from(texel.solid_angle);
    }
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    let mean = (light / area) as f32;
    mean
}

/// Cuts texels that hold more than one direction's share (a sun) down to it, so that they do not take the directions of
/// everything else; returns the share too.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "f64 to f32; small counts"
)]
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
    let mut centroids = vec![DVec3::ZERO; directions.len()];
    if directions.is_empty() {
        return Vec::new();
    }
    for block in blocks {
        if block.iter().all(|texel| texel.light.x == 0.0) {
            continue;
        }
        assign(block, directions, |nearest, texel| {
            centroids[nearest] += texel.direction.as_dvec3() * f64::from(texel.light.x);
        });
    }
    (centroids.iter().zip(directions))
        .map(|(sum, old)| sum.try_normalize().map_or(*old, |d| d.as_vec3()))
        .collect()
}
