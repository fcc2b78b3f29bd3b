//! Real spherical harmonics, the first 9 (bands 0 to 2). Order, sign and scale as in Ramamoorthi and Hanrahan,
//! *An Efficient Representation for Irradiance Environment Maps* (2001), eq. 3: no Condon-Shortley phase, orthonormal.

use glam::Vec3;
use std::ops::{Add, AddAssign, Mul};

/// Number of coefficients.
pub const COEFFICIENT_COUNT: usize = 9;

/// Zonal factors of the clamped cosine `max(0, t)`, see [`Sh9::zonal`]: π, 2π/3, π/4.
pub const CLAMPED_COSINE: [f32; 3] = [
    std::f32::consts::PI,
    2.0 * std::f32::consts::FRAC_PI_3,
    std::f32::consts::FRAC_PI_4,
];

const Y0: f32 = 0.282_094_8;
const Y1: f32 = 0.488_602_5;
const Y2: f32 = 1.092_548_4;
const Y20: f32 = 0.315_391_57;
const Y22: f32 = 0.546_274_2;

/// Band of each coefficient.
const BAND: [usize; COEFFICIENT_COUNT] = [0, 1, 1, 1, 2, 2, 2, 2, 2];

/// A function on the sphere as 9 coefficients: (0,0), (1,-1), (1,0), (1,1), (2,-2) … (2,2).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sh9(pub [f32; COEFFICIENT_COUNT]);

impl Sh9 {
    /// The basis functions at the unit vector `direction`; also the coefficients of a unit impulse there.
    pub fn basis(direction: Vec3) -> Self {
        let Vec3 { x, y, z } = direction;
        Self([
            Y0,
            Y1 * y,
            Y1 * z,
            Y1 * x,
            Y2 * x * y,
            Y2 * y * z,
            Y20 * (3.0 * z * z - 1.0),
            Y2 * x * z,
            Y22 * (x * x - y * y),
        ])
    }

    /// Coefficients of `f(axis · ω)`, where `bands[l]` = 2π ∫₋₁¹ f(t) Pₗ(t) dt (Funk-Hecke: no rotation is needed).
    pub fn zonal(axis: Vec3, bands: [f32; 3]) -> Self {
        Self::basis(axis).convolved(bands)
    }

    /// Coefficients of `max(0, normal · ω)`. Its 9-term series is off by up to 1/16: +1/16 at the normal itself and at
    /// its opposite, −0.04 at 122°.
    pub fn clamped_cosine(normal: Vec3) -> Self {
        Self::zonal(normal, CLAMPED_COSINE)
    }

    /// This function convolved with the zonal function of factors `bands`. With [`CLAMPED_COSINE`]: radiance to
    /// irradiance.
    #[must_use]
    pub fn convolved(self, bands: [f32; 3]) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * bands[BAND[i]]))
    }

    /// Integral over the sphere of this function times `other`.
    pub fn dot(&self, other: &Self) -> f32 {
        self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum()
    }

    /// Value of the series at the unit vector `direction`. May ring below zero where the function does not.
    pub fn evaluate(&self, direction: Vec3) -> f32 {
        self.dot(&Self::basis(direction))
    }

    /// Coefficients of a function known at `samples`: unit direction, value, solid angle that it stands for (sr).
    pub fn project(samples: impl IntoIterator<Item = (Vec3, f32, f32)>) -> Self {
        samples
            .into_iter()
            .fold(Self::default(), |sum, (direction, value, solid_angle)| {
                sum + Self::basis(direction) * (value * solid_angle)
            })
    }

    /// First moment ∫ f(ω) ω dω, read off band 1.
    pub fn moment(&self) -> Vec3 {
        Vec3::new(self.0[3], self.0[1], self.0[2]) / Y1
    }

    /// For a sum of `a·max(0, n·ω)`: the sum of `a·n`, which dotted with ω is the exact value wherever all n face ω.
    pub fn cosine_vector(&self) -> Vec3 {
        Vec3::new(self.0[3], self.0[1], self.0[2]) / (Y1 * CLAMPED_COSINE[1])
    }
}

impl Add for Sh9 {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
}

impl AddAssign for Sh9 {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Mul<f32> for Sh9 {
    type Output = Self;

    fn mul(self, factor: f32) -> Self {
        Self(self.0.map(|coefficient| coefficient * factor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::{PI, TAU};

    /// Gauss-free quadrature: `n` midpoint rows in z, `2n` columns in azimuth, equal solid angles.
    fn sphere(n: usize) -> impl Iterator<Item = (Vec3, f32)> {
        let solid_angle = 4.0 * PI / (2 * n * n) as f32;
        (0..2 * n * n).map(move |i| {
            let z = 1.0 - 2.0 * ((i / (2 * n)) as f32 + 0.5) / n as f32;
            let (sin, cos) = (TAU * ((i % (2 * n)) as f32 + 0.5) / (2 * n) as f32).sin_cos();
            let r = (1.0 - z * z).sqrt();
            (Vec3::new(r * cos, r * sin, z), solid_angle)
        })
    }

    #[test]
    fn basis_is_orthonormal_under_numeric_integration() {
        let mut gram = [[0.0_f64; 9]; 9];
        for (direction, solid_angle) in sphere(256) {
            let y = Sh9::basis(direction).0;
            for (i, row) in gram.iter_mut().enumerate() {
                for (j, cell) in row.iter_mut().enumerate() {
                    *cell += f64::from(y[i] * y[j] * solid_angle);
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, cell) in row.iter().enumerate() {
                let expected = f64::from(u8::from(i == j));
                // The midpoint rule is off by about 5/n² = 8e-5.
                assert!((cell - expected).abs() < 2e-4, "({i},{j}): {cell}");
            }
        }
    }

    #[test]
    fn clamped_cosine_lobe_equals_its_numeric_projection() {
        let normal = Vec3::new(0.3, -0.8, 0.5).normalize();
        let numeric = Sh9::project(sphere(128).map(|(d, w)| (d, d.dot(normal).max(0.0), w)));
        let closed = Sh9::clamped_cosine(normal);
        for (a, b) in numeric.0.iter().zip(&closed.0) {
            assert!((a - b).abs() < 1e-3, "{numeric:?} {closed:?}");
        }
        // 1/4 + P1/2 + 5/16 P2 at the normal and at its opposite.
        assert!((closed.evaluate(normal) - 1.0625).abs() < 1e-5);
        assert!((closed.evaluate(-normal) - 0.0625).abs() < 1e-5);
        assert!((closed.cosine_vector() - normal).length() < 1e-5);
    }

    #[test]
    fn constant_radiance_convolved_with_the_cosine_is_pi() {
        let one = Sh9::project(sphere(32).map(|(d, w)| (d, 1.0, w)));
        let irradiance = one.convolved(CLAMPED_COSINE);
        for direction in [Vec3::X, -Vec3::Y, Vec3::ONE.normalize()] {
            assert!((irradiance.evaluate(direction) - PI).abs() < 5e-3);
        }
        assert!(one.moment().length() < 1e-3);
    }

    #[test]
    fn moment_of_a_cosine_lobe_is_two_thirds_pi_times_its_axis() {
        let axis = Vec3::new(-1.0, 2.0, 2.0) / 3.0;
        let moment = Sh9::clamped_cosine(axis).moment();
        assert!((moment - axis * (2.0 * PI / 3.0)).length() < 1e-5);
    }
}
