//! A dome's map as small lights in world space, in blocks of neighbors; large maps are reduced so that power and first
//! moment stay.

use super::Dome;
use crate::image::Latlong;
use crate::math::{Frame, luminance};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

/// Maps are taken as at most this many texels across: a third of a degree each. Finer texels are merged.
const MOST_ACROSS: usize = 1024;
/// Texels across the map that stands for an even sky.
const EVEN_ACROSS: usize = 512;
/// Texels a side of a block.
const BLOCK: usize = 8;
/// Most light of a texel, radiance·sr: sums over whole skies and their products with materials stay finite.
const MOST_LIGHT: f32 = 1e30;

/// Part of a sky that is never divided.
#[derive(Debug, Clone, Copy)]
pub(super) struct Texel {
    /// Mean direction of its light (of its area, if it is black): its length is at most 1.
    pub(super) direction: Vec3,
    /// Radiance times solid angle.
    pub(super) light: Vec3,
    /// Steradians.
    pub(super) solid_angle: f32,
}

impl Texel {
    /// `across × across` equal parts, as if it were a square; their first moments sum to its own.
    pub(super) fn split(self, across: u8) -> impl Iterator<Item = Self> {
        let frame = Frame::about(self.direction.normalize_or(Vec3::Y));
        let count = f32::from(across) * f32::from(across);
        let step = self.solid_angle.sqrt() / f32::from(across);
        let off = move |i: u8| (f32::from(i) + 0.5 - 0.5 * f32::from(across)) * step;
        (0..across * across).map(move |i| Self {
            direction: self.direction
                + frame.tangent * off(i % across)
                + frame.bitangent * off(i / across),
            light: self.light / count,
            solid_angle: self.solid_angle / count,
        })
    }
}

/// One dome's light, or that of all even domes together.
#[derive(Debug)]
pub(super) struct Sky {
    /// Neighbors on the sphere, row by row of blocks.
    pub(super) blocks: Vec<Vec<Texel>>,
}

impl Sky {
    pub(super) fn of(dome: &Dome, map: &Latlong) -> Self {
        let merge = map.width.div_ceil(MOST_ACROSS);
        let reduced = Reduced::new(dome, map, merge);
        let texel = |column: usize, row: usize| reduced.texel(column, row);
        Self::from_texels(
            map.width.div_ceil(merge),
            map.height.div_ceil(merge),
            &texel,
        )
    }

    /// The same radiance from everywhere.
    pub(super) fn even(radiance: Vec3) -> Self {
        let map = even_map(EVEN_ACROSS, EVEN_ACROSS / 2);
        let texel = |x: usize, y: usize| Texel {
            direction: map.direction(x, y),
            light: bounded(radiance * map.solid_angle(y)),
            solid_angle: map.solid_angle(y),
        };
        Self::from_texels(map.width, map.height, &texel)
    }

    fn from_texels(
        width: usize,
        height: usize,
        texel: &(dyn Fn(usize, usize) -> Texel + Sync),
    ) -> Self {
        let across = width.div_ceil(BLOCK);
        let block = |index: usize| {
            let (left, top) = (index % across * BLOCK, index / across * BLOCK);
            let rows = top..(top + BLOCK).min(height);
            rows.flat_map(|y| (left..(left + BLOCK).min(width)).map(move |x| texel(x, y)))
                .collect()
        };
        Self {
            blocks: (0..across * height.div_ceil(BLOCK))
                .into_par_iter()
                .map(block)
                .collect(),
        }
    }

    /// Luminance of the mean radiance.
    pub(super) fn mean(&self) -> f64 {
        let (mut light, mut area) = (0.0, 0.0);
        for texel in self.blocks.iter().flatten() {
            light += f64::from(luminance(texel.light));
            area += f64::from(texel.solid_angle);
        }
        light / area
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

/// A map seen through texels of `merge × merge` of its pixels, fewer at the right and lower edge.
struct Reduced<'a> {
    dome: &'a Dome,
    map: &'a Latlong,
    merge: usize,
    /// Level direction of each column, (x, z): the trigonometry of millions of pixels is that of few columns.
    columns: Vec<DVec2>,
}

impl<'a> Reduced<'a> {
    fn new(dome: &'a Dome, map: &'a Latlong, merge: usize) -> Self {
        // all rows share them; those at the poles are short, but never zero
        let level = |x: usize| {
            let direction = map.direction(x, map.height / 2).as_dvec3();
            DVec2::new(direction.x, direction.z).normalize()
        };
        Self {
            dome,
            map,
            merge,
            columns: (0..map.width).map(level).collect(),
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    fn texel(&self, column: usize, row: usize) -> Texel {
        let (map, merge) = (self.map, self.merge);
        let (mut light, mut area) = (DVec3::ZERO, 0.0_f64);
        let (mut bright, mut plain) = (DVec3::ZERO, DVec3::ZERO);
        for y in row * merge..((row + 1) * merge).min(map.height) {
            let solid_angle = f64::from(map.solid_angle(y));
            let up = f64::from(map.direction(0, y).y);
            let level = (1.0 - up * up).max(0.0).sqrt();
            for x in column * merge..((column + 1) * merge).min(map.width) {
                let pixel = map.pixels[y * map.width + x];
                let across = self.columns[x] * level;
                let direction = DVec3::new(across.x, up, across.y);
                light += pixel.as_dvec3() * solid_angle;
                bright += direction * (f64::from(luminance(pixel)) * solid_angle);
                plain += direction * solid_angle;
                area += solid_angle;
            }
        }
        let total = light.dot(LUMINANCE);
        let mean = if total > 0.0 {
            bright / total
        } else {
            plain / area
        };
        Texel {
            direction: self.dome.world_from_dome * mean.as_vec3().clamp_length_max(1.0),
            light: bounded((light * self.dome.radiance.as_dvec3()).as_vec3()),
            solid_angle: area as f32,
        }
    }
}

/// Weights of [`luminance`].
pub(super) const LUMINANCE: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);

fn bounded(light: Vec3) -> Vec3 {
    light.min(Vec3::splat(MOST_LIGHT))
}
