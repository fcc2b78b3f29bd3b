//! What a surface reflects besides diffusely: the GGX lobes of UsdPreviewSurface.

use glam::{Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// A lobe of microfacets. Walter et al., *Microfacet Models for Refraction through Rough Surfaces* (2007).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lobe {
    /// Reflectance straight on, 0…1.
    pub f0: Vec3,
    /// Reflectance at grazing angles, 0…1.
    pub f90: Vec3,
    /// Width: `roughness²`, above 0.
    pub alpha: f32,
}

/// The lobes of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gloss {
    /// The surface itself.
    pub base: Lobe,
    /// Clear coat on top of it; it takes nothing from the base.
    pub coat: Lobe,
}

/// Smoother than this, as `roughness`, a lobe is as good as a mirror in single precision.
const SMOOTHEST: f32 = 0.01;

/// Where a specular color is darker than 1 over this, its grazing reflectance falls too: a black one reflects nothing.
/// Lagarde and de Rousiers, *Moving Frostbite to Physically Based Rendering* (2014).
const FULL_EDGE: f32 = 50.0;

impl Lobe {
    /// Reflects nothing.
    pub const NONE: Self = Self {
        f0: Vec3::ZERO,
        f90: Vec3::ZERO,
        alpha: 1.0,
    };

    /// A lobe of this `roughness` (0…1).
    pub fn new(f0: Vec3, f90: Vec3, roughness: f32) -> Self {
        Self {
            f0,
            f90,
            alpha: roughness.max(SMOOTHEST).powi(2),
        }
    }

    /// A lobe whose edge is white where it reflects at all.
    pub fn of_color(f0: Vec3, roughness: f32) -> Self {
        let edge = (FULL_EDGE * f0.max_element()).min(1.0);
        Self::new(f0, Vec3::splat(edge), roughness)
    }

    /// True if it reflects nothing.
    pub fn is_black(&self) -> bool {
        self.f0 == Vec3::ZERO && self.f90 == Vec3::ZERO
    }

    /// Reflectance at `cosine` between the microfacet's normal and either direction. Schlick (1994).
    pub fn fresnel(&self, cosine: f32) -> Vec3 {
        self.f0 + (self.f90 - self.f0) * (1.0 - cosine).clamp(0.0, 1.0).powi(5)
    }

    /// Direction that light reflected towards `view` comes from, and its weight: the mean over `point` in [0, 1)² of weights
    /// times radiance is what the lobe reflects. Unit vectors in a frame whose Z is the normal; `view.z` > 0. `None` below
    /// the horizon: nothing comes from there. Heitz, *Sampling the GGX Distribution of Visible Normals* (2018).
    pub fn sample(&self, view: Vec3, point: Vec2) -> Option<(Vec3, Vec3)> {
        let a = self.alpha;
        let stretched = Vec3::new(a * view.x, a * view.y, view.z).normalize();
        let across = Vec3::new(-stretched.y, stretched.x, 0.0).normalize_or(Vec3::X);
        let up = stretched.cross(across);
        let (sin, cos) = (TAU * point.y).sin_cos();
        let radius = point.x.sqrt();
        let (x, s) = (radius * cos, 0.5 * (1.0 + stretched.z));
        let y = (1.0 - s) * (1.0 - x * x).max(0.0).sqrt() + s * radius * sin;
        let z = (1.0 - x * x - y * y).max(0.0).sqrt();
        let facet = across * x + up * y + stretched * z;
        let facet = Vec3::new(a * facet.x, a * facet.y, facet.z.max(0.0)).normalize_or(Vec3::Z);
        let cosine = view.dot(facet);
        let light = facet * (2.0 * cosine) - view;
        (light.z > 0.0).then(|| {
            let (seen, lit) = (self.masked(view), self.masked(light));
            let shadow = (1.0 + seen) / (1.0 + seen + lit);
            (light, self.fresnel(cosine) * shadow)
        })
    }

    /// Reflected radiance over irradiance, 1/sr: D·F·G₂ / (4 cos cos). Unit vectors in a frame whose Z is the normal, away from
    /// the surface; black below the horizon. Walter et al. (2007), with masking and shadowing that know of each other's height.
    pub fn brdf(&self, view: Vec3, light: Vec3) -> Vec3 {
        if view.z <= 0.0 || light.z <= 0.0 {
            return Vec3::ZERO;
        }
        let facet = (view + light).normalize_or(Vec3::Z);
        let square = self.alpha * self.alpha;
        let spread = facet.z * facet.z * (square - 1.0) + 1.0;
        let density = square / (PI * spread * spread);
        let open = 1.0 / (1.0 + self.masked(view) + self.masked(light));
        self.fresnel(view.dot(facet)) * (density * open / (4.0 * view.z * light.z))
    }

    /// Smith's Λ: how much of the microsurface is hidden from `direction`, over what is seen of it.
    fn masked(&self, direction: Vec3) -> f32 {
        let slope =
            direction.truncate().length_squared() / direction.z.powi(2).max(f32::MIN_POSITIVE);
        0.5 * ((1.0 + self.alpha * self.alpha * slope).sqrt() - 1.0)
    }
}

impl Gloss {
    /// Diffuse through and through.
    pub const NONE: Self = Self {
        base: Lobe::NONE,
        coat: Lobe::NONE,
    };

    /// The lobes that reflect something.
    pub fn lobes(&self) -> impl Iterator<Item = &Lobe> {
        [&self.base, &self.coat]
            .into_iter()
            .filter(|lobe| !lobe.is_black())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sequence;

    /// What `lobe` reflects of a white sky, by its BRDF, integrated over a fine grid of directions.
    fn albedo_by_integration(lobe: &Lobe, view: Vec3) -> f64 {
        let (rings, sectors) = (1500_u16, 600_u16);
        let mut sum = 0.0_f64;
        for ring in 0..rings {
            let theta = (f32::from(ring) + 0.5) / f32::from(rings) * 0.5 * PI;
            for sector in 0..sectors {
                let phi = (f32::from(sector) + 0.5) / f32::from(sectors) * TAU;
                let (sin, cos) = theta.sin_cos();
                let light = Vec3::new(sin * phi.cos(), sin * phi.sin(), cos);
                sum += f64::from(lobe.brdf(view, light).x * light.z * sin);
            }
        }
        sum * f64::from(0.5 * PI / f32::from(rings)) * f64::from(TAU / f32::from(sectors))
    }

    #[test]
    fn samples_reflect_as_much_of_a_white_sky_as_the_brdf_says() {
        for (roughness, tilt) in [(0.3, 0.2), (0.5, 1.0), (0.8, 1.3), (1.0, 0.0)] {
            let lobe = Lobe::new(Vec3::splat(0.04), Vec3::ONE, roughness);
            let (sin, cos) = f32::sin_cos(tilt);
            let view = Vec3::new(sin, 0.0, cos);
            let count = 20_000;
            let sampled: f64 = (0..count)
                .filter_map(|i| lobe.sample(view, sequence::fibonacci(i, count)))
                .map(|(_, weight)| f64::from(weight.x))
                .sum::<f64>()
                / f64::from(count);
            let exact = albedo_by_integration(&lobe, view);
            assert!(
                (sampled / exact - 1.0).abs() < 0.01,
                "{roughness} {tilt}: {sampled} {exact}"
            );
        }
    }

    #[test]
    fn a_mirror_reflects_at_the_same_angle_and_black_reflects_nothing() {
        let mirror = Lobe::of_color(Vec3::ONE, 0.0);
        let view = Vec3::new(0.6, 0.0, 0.8);
        for i in 0..50 {
            let (light, weight) = mirror.sample(view, sequence::fibonacci(i, 50)).unwrap();
            assert!(
                light.abs_diff_eq(Vec3::new(-0.6, 0.0, 0.8), 0.02),
                "{light}"
            );
            assert!(weight.abs_diff_eq(Vec3::ONE, 1e-4));
        }
        assert!(Lobe::of_color(Vec3::ZERO, 0.3).is_black());
        assert_eq!(Gloss::NONE.lobes().count(), 0);
    }
}
