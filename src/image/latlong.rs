//! Environments as latitude-longitude images, in the orientation of UsdLux dome lights.
//!
//! UsdLux takes OpenEXR's convention: the top row is +Y, the bottom row −Y, the centre of the image +Z, and longitude
//! grows from right to left, so that a quarter from the left edge is +X, a quarter from the right −X, and both edges
//! are −Z. Directions here are in light space; a dome whose pole is +Z is turned by its light's transform.

use super::decode::{self, Decoded, Samples};
use super::{Error, Image};
use crate::scene::ColorSpace;
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI, TAU};
use std::path::Path;

/// Radiance from every direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Latlong {
    /// Columns.
    pub width: usize,
    /// Rows, from +Y down.
    pub height: usize,
    /// Linear radiance, row by row; finite, ≥ 0.
    pub pixels: Vec<Vec3>,
    /// How many pixels had a negative or non-finite component, which is 0 now.
    pub repaired: usize,
}

impl Latlong {
    /// Read the image at `path`, reduced by averaging (weighted by solid angle) until it is at most `max_width` wide.
    ///
    /// # Errors
    /// Files that are missing, damaged, of another format, or absurdly large.
    pub fn load(path: &Path, max_width: usize) -> Result<Self, Error> {
        let decoded = decode::file(path)?;
        let mut environment = Self::from_decoded(decoded);
        while environment.width > max_width.max(1) && environment.height > 1 {
            environment = environment.halved();
        }
        Ok(environment)
    }

    fn from_decoded(decoded: Decoded) -> Self {
        let (width, height) = (decoded.width, decoded.height);
        let not_finite = match &decoded.samples {
            Samples::Bytes(_) => 0,
            Samples::Half(values) => values.iter().filter(|value| !value.is_finite()).count(),
            Samples::Float(values) => values.iter().filter(|value| !value.is_finite()).count(),
        };
        let image = Image::new(decoded, ColorSpace::Auto);
        let mut negative = 0;
        let pixel = |index: usize| {
            let color = image.pixel(index % width, index / width).truncate();
            negative += usize::from(color.min_element() < 0.0);
            color.max(Vec3::ZERO)
        };
        let pixels = (0..width * height).map(pixel).collect();
        Self {
            width,
            height,
            pixels,
            repaired: not_finite + negative,
        }
    }

    /// Half the size (rounded up), pixels averaged by their solid angles.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let average = |index: usize| {
            let (left, top) = (index % width * 2, index / width * 2);
            let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
            for y in top..(top + 2).min(self.height) {
                let weight = self.solid_angle(y);
                for x in left..(left + 2).min(self.width) {
                    sum += self.pixels[y * self.width + x] * weight;
                    weights += weight;
                }
            }
            sum / weights
        };
        let pixels = (0..width * height).map(average).collect();
        Self {
            width,
            height,
            pixels,
            repaired: self.repaired,
        }
    }

    /// Unit direction (light space) of the centre of pixel (`x`, `y`).
    pub fn direction(&self, x: usize, y: usize) -> Vec3 {
        let longitude = PI - TAU * (x as f32 + 0.5) / self.width as f32;
        let latitude = FRAC_PI_2 - PI * (y as f32 + 0.5) / self.height as f32;
        let level = latitude.cos();
        Vec3::new(
            level * longitude.sin(),
            latitude.sin(),
            level * longitude.cos(),
        )
    }

    /// Solid angle of a pixel in row `y`, steradians. All pixels together: 4π.
    pub fn solid_angle(&self, y: usize) -> f32 {
        let half = FRAC_PI_2 / self.height as f32;
        let latitude = FRAC_PI_2 - PI * (y as f32 + 0.5) / self.height as f32;
        // sin(latitude + half) − sin(latitude − half), without cancelling.
        TAU / self.width as f32 * 2.0 * latitude.cos() * half.sin()
    }

    /// Radiance from `direction` (light space, any length; zero gives 0), bilinear between pixels.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let Some(direction) = direction.try_normalize() else {
            return Vec3::ZERO;
        };
        let u = 0.5 - direction.x.atan2(direction.z) / TAU;
        let v = 0.5 - direction.y.clamp(-1.0, 1.0).asin() / PI;
        let (left, right, across) = self.columns(u);
        let (top, bottom, down) = self.rows(v);
        let at = |x: usize, y: usize| self.pixels[y * self.width + x];
        let row = |y: usize| at(left, y).lerp(at(right, y), across);
        row(top).lerp(row(bottom), down)
    }

    /// The columns around `u`; the image closes on itself.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0 to width"
    )]
    fn columns(&self, u: f32) -> (usize, usize, f32) {
        let x = (u * self.width as f32 - 0.5).rem_euclid(self.width as f32);
        let left = (x as usize).min(self.width - 1);
        (left, (left + 1) % self.width, x - left as f32)
    }

    /// The rows around `v`; beyond the outermost centres they continue.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0 to height"
    )]
    fn rows(&self, v: f32) -> (usize, usize, f32) {
        let last = (self.height - 1) as f32;
        let y = (v * self.height as f32 - 0.5).clamp(0.0, last);
        let top = y as usize;
        (top, (top + 1).min(self.height - 1), y - top as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn latlong(width: usize, height: usize, pixel: impl Fn(usize, usize) -> Vec3) -> Latlong {
        let pixels = (0..width * height)
            .map(|i| pixel(i % width, i / width))
            .collect();
        Latlong {
            width,
            height,
            pixels,
            repaired: 0,
        }
    }

    #[test]
    fn directions_are_those_of_the_openexr_convention() {
        let image = latlong(8, 4, |x, y| Vec3::new(x as f32, y as f32, 0.0));
        // Centre +Z, quarter from the left +X, quarter from the right −X, both edges −Z.
        assert!((image.radiance(Vec3::Z).x - 3.5).abs() < 1e-4);
        assert!((image.radiance(Vec3::X).x - 1.5).abs() < 1e-4);
        assert!((image.radiance(Vec3::NEG_X).x - 5.5).abs() < 1e-4);
        let edge = image.radiance(Vec3::NEG_Z).x;
        assert!(
            (edge - 3.5).abs() < 1e-4,
            "{edge}: the mean of columns 0 and 7"
        );
        assert_eq!(image.radiance(Vec3::Y).y, 0.0);
        assert_eq!(image.radiance(Vec3::NEG_Y).y, 3.0);
        assert_eq!(image.radiance(Vec3::ZERO), Vec3::ZERO);
    }

    #[test]
    fn looking_up_the_direction_of_a_pixel_gives_the_pixel() {
        let image = latlong(16, 8, |x, y| Vec3::new(x as f32, y as f32, 1.0));
        for (x, y) in [(0, 0), (15, 7), (3, 4), (8, 1), (15, 0)] {
            let found = image.radiance(image.direction(x, y));
            assert!(
                found.distance(Vec3::new(x as f32, y as f32, 1.0)) < 1e-3,
                "{x} {y}: {found}"
            );
        }
    }

    #[test]
    fn solid_angles_of_all_pixels_sum_to_the_sphere() {
        for (width, height) in [(1, 1), (2, 1), (64, 32), (1000, 333)] {
            let image = latlong(width, height, |_, _| Vec3::ONE);
            let sum: f64 = (0..height)
                .map(|y| f64::from(image.solid_angle(y)) * width as f64)
                .sum();
            assert!(
                (sum / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-5,
                "{width} × {height}"
            );
        }
    }

    #[test]
    fn reducing_keeps_the_power() {
        let power = |image: &Latlong| -> f64 {
            let terms = (0..image.pixels.len())
                .map(|i| f64::from(image.pixels[i].x * image.solid_angle(i / image.width)));
            terms.sum()
        };
        let image = latlong(64, 32, |x, y| Vec3::splat(((x * 7 + y * 13) % 11) as f32));
        let reduced = image.halved();
        assert_eq!((reduced.width, reduced.height), (32, 16));
        assert!((power(&reduced) / power(&image) - 1.0).abs() < 1e-3);
        let odd = latlong(5, 3, |_, _| Vec3::ONE).halved();
        assert_eq!((odd.width, odd.height, odd.pixels[5]), (3, 2, Vec3::ONE));
    }

    #[test]
    fn files_lose_what_is_negative_or_not_finite() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sky.exr");
        exr::prelude::write_rgb_file(&path, 4, 2, |x, y| match (x, y) {
            (0, 0) => (f32::NAN, 1.0, 1.0),
            (1, 0) => (-5.0, 1.0, 1.0),
            (2, 0) => (f32::INFINITY, 1.0, 1.0),
            _ => (2e5, 1.0, 1.0),
        })
        .unwrap();
        let image = Latlong::load(&path, 4096).unwrap();
        assert_eq!((image.width, image.height, image.repaired), (4, 2, 3));
        assert_eq!(
            [0, 1, 2, 3].map(|x| image.pixels[x].x),
            [0.0, 0.0, 0.0, 2e5]
        );
        assert_eq!(Latlong::load(&path, 2).unwrap().width, 2);
    }
}
