//! Pictures of light: textures of rect lights, and latitude–longitude maps of domes.

use crate::diagnostics::Diagnostics;
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI, TAU};
use std::path::Path;

/// Linear colors, rows from the top.
#[derive(Debug, Clone)]
pub(super) struct Picture {
    /// Texels across.
    pub(super) width: usize,
    /// Rows.
    pub(super) height: usize,
    /// `width · height` colors, finite and not negative.
    pub(super) pixels: Vec<Vec3>,
}

impl Picture {
    /// Reads `path`; what fails is a warning for `prim`, and `None`.
    pub(super) fn load_or_warn(path: &Path, prim: &str, diagnostics: &Diagnostics) -> Option<Self> {
        match image::open(path) {
            Ok(image) => {
                let is_encoded = !matches!(
                    image.color(),
                    image::ColorType::Rgb32F | image::ColorType::Rgba32F
                );
                let image = image.into_rgb32f();
                let pixel = |p: &image::Rgb<f32>| {
                    let color = Vec3::from(p.0);
                    clean(if is_encoded { linear(color) } else { color })
                };
                Some(Self {
                    width: image.width() as usize,
                    height: image.height() as usize,
                    pixels: image.pixels().map(pixel).collect(),
                })
                .filter(|picture| !picture.pixels.is_empty())
            }
            Err(error) => {
                let message = format!(
                    "texture {} cannot be read ({error}): the light shines evenly in its own color",
                    path.display()
                );
                diagnostics.warn("missing-texture", prim, message);
                None
            }
        }
    }

    /// One color.
    pub(super) fn uniform(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            pixels: vec![Vec3::ONE; width * height],
        }
    }

    /// The texel at `x` across and `y` down, 0…1, clamped.
    pub(super) fn at(&self, x: f32, y: f32) -> Vec3 {
        self.pixels[index(y, self.height) * self.width + index(x, self.width)]
    }

    /// Unit direction of a place on a latlong map, in pixels: longitude π at the left edge falling to −π at the right,
    /// longitude 0 along +Z, π/2 along +X, the top row around +Y (`UsdLuxDomeLight`, after OpenEXR).
    #[expect(clippy::cast_precision_loss, reason = "image sizes")]
    pub(super) fn direction(&self, x: f32, y: f32) -> Vec3 {
        let longitude = PI - TAU * x / self.width as f32;
        let latitude = FRAC_PI_2 - PI * y / self.height as f32;
        let (sine, cosine) = longitude.sin_cos();
        let level = latitude.cos();
        Vec3::new(level * sine, latitude.sin(), level * cosine)
    }

    /// Color of a latlong map in the unit `direction`.
    pub(super) fn radiance(&self, direction: Vec3) -> Vec3 {
        let longitude = direction.x.atan2(direction.z);
        let latitude = direction.y.clamp(-1.0, 1.0).asin();
        self.at((PI - longitude) / TAU, (FRAC_PI_2 - latitude) / PI)
    }

    /// Solid angle of every texel in row `y` of a latlong map.
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        reason = "image sizes; f64 to f32"
    )]
    pub(super) fn solid_angle(&self, y: usize) -> f32 {
        let step = std::f64::consts::PI / self.height as f64;
        let band = 2.0 * ((y as f64 + 0.5) * step).sin() * (0.5 * step).sin();
        (band * std::f64::consts::TAU / self.width as f64) as f32
    }

    /// Averages blocks of `factor × factor` texels (fewer at the right and lower edge).
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub(super) fn reduced(&self, factor: usize) -> Self {
        let (width, height) = (self.width.div_ceil(factor), self.height.div_ceil(factor));
        let mean = |x: usize, y: usize| {
            let (mut sum, mut count) = (Vec3::ZERO, 0_usize);
            for row in y * factor..((y + 1) * factor).min(self.height) {
                for column in x * factor..((x + 1) * factor).min(self.width) {
                    sum += self.pixels[row * self.width + column];
                    count += 1;
                }
            }
            sum / count as f32
        };
        let pixels = (0..width * height)
            .map(|i| mean(i % width, i / width))
            .collect();
        Self {
            width,
            height,
            pixels,
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "clamped to the image"
)]
fn index(place: f32, count: usize) -> usize {
    ((place * count as f32).max(0.0) as usize).min(count - 1)
}

fn clean(color: Vec3) -> Vec3 {
    let channel = |c: f32| if c.is_finite() { c.max(0.0) } else { 0.0 };
    Vec3::new(channel(color.x), channel(color.y), channel(color.z))
}

/// sRGB decoding (IEC 61966-2-1).
fn linear(color: Vec3) -> Vec3 {
    let channel = |c: f32| {
        if c <= 0.040_45 {
            c / 12.92
        } else {
            ((c + 0.055) / 1.055).powf(2.4)
        }
    };
    Vec3::new(channel(color.x), channel(color.y), channel(color.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texel_directions_follow_openexr_and_look_up_themselves() {
        let map = Picture::uniform(8, 4);
        let near = |x: f32, y: f32, d: Vec3| (map.direction(x, y) - d).length() < 1e-6;
        assert!(near(4.0, 2.0, Vec3::Z) && near(2.0, 2.0, Vec3::X) && near(0.0, 2.0, -Vec3::Z));
        assert!(near(1.0, 0.0, Vec3::Y) && near(6.0, 2.0, -Vec3::X));
        let pixels = (0..32).map(|i| Vec3::splat(i as f32)).collect();
        let map = Picture { pixels, ..map };
        for i in 0..32 {
            let direction = map.direction((i % 8) as f32 + 0.5, (i / 8) as f32 + 0.5);
            assert_eq!(map.radiance(direction).x, i as f32);
        }
    }

    #[test]
    fn texels_cover_the_sphere() {
        let map = Picture::uniform(16, 9);
        let total: f32 = (0..9).map(|y| 16.0 * map.solid_angle(y)).sum();
        assert!((total - 4.0 * PI).abs() < 1e-4);
    }
}
