//! 3D Gaussian splats: what radiance fields are exchanged as. They are carried along, nothing is gathered from them.

use glam::{Quat, Vec3};

/// Gaussians as columns of equal length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Splats {
    /// Centers.
    pub position: Vec<Vec3>,
    /// Unit.
    pub orientation: Vec<Quat>,
    /// Standard deviations along the axes, linear, above 0.
    pub scale: Vec<Vec3>,
    /// 0…1, linear.
    pub opacity: Vec<f32>,
    /// Highest band of the spherical harmonics, 0…3.
    pub degree: usize,
    /// `(degree + 1)²` a splat, the constant one first: color 0.5 + 0.282 095 c₀ + …
    pub coefficients: Vec<Vec3>,
}

impl Splats {
    /// Highest band that files have.
    pub const MOST_DEGREE: usize = 3;

    /// Number of splats.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// True without splats.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Coefficients a splat.
    pub fn width(&self) -> usize {
        (self.degree + 1).pow(2)
    }
}
