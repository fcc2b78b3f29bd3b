//! The pixels of the raster cube: their directions, and the cosine-weighted solid angle each has above a horizon.

use crate::gather::Hemisphere;
use crate::math::solid_angle::{clip_to_horizon, polygon_moment};
use glam::{DVec3, Vec3};

/// One face of the cube: an axis and two more that make a right-handed frame `u × v = axis`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Face {
    pub axis: Vec3,
    pub u: Vec3,
    pub v: Vec3,
}

impl Face {
    const fn new(axis: Vec3, u: Vec3, v: Vec3) -> Self {
        Self { axis, u, v }
    }
}

/// All six.
pub(super) const FACES: [Face; 6] = [
    Face::new(Vec3::X, Vec3::Y, Vec3::Z),
    Face::new(Vec3::NEG_X, Vec3::Z, Vec3::Y),
    Face::new(Vec3::Y, Vec3::Z, Vec3::X),
    Face::new(Vec3::NEG_Y, Vec3::X, Vec3::Z),
    Face::new(Vec3::Z, Vec3::X, Vec3::Y),
    Face::new(Vec3::NEG_Z, Vec3::Y, Vec3::X),
];

/// A pixel's part above some horizon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OpenPixel {
    pub pixel: usize,
    /// Unit; the middle of the part, weighted by its solid angle.
    pub direction: Vec3,
    /// Cosine-weighted solid angle, sr.
    pub weight: f32,
}

/// The pixels of all faces; index = (face · resolution + row along `v`) · resolution + column along `u`.
#[derive(Debug, Clone)]
pub(super) struct PixelTable {
    resolution: usize,
    /// ∫ω dω over each pixel.
    moment: Vec<DVec3>,
}

impl PixelTable {
    pub(super) fn new(resolution: usize) -> Self {
        let mut table = Self {
            resolution,
            moment: Vec::new(),
        };
        let count = 6 * resolution * resolution;
        table.moment = (0..count)
            .map(|pixel| polygon_moment(&table.corners(pixel)))
            .collect();
        table
    }

    /// Number of pixels of all faces.
    pub(super) fn len(&self) -> usize {
        self.moment.len()
    }

    /// Pixels along an edge of a face.
    pub(super) fn resolution(&self) -> usize {
        self.resolution
    }

    /// Middle of a pixel, on the cube (not unit).
    pub(super) fn center(&self, pixel: usize) -> Vec3 {
        self.point(pixel, 0.5, 0.5).as_vec3()
    }

    /// Corners on the cube, counter-clockwise seen from outside.
    fn corners(&self, pixel: usize) -> [DVec3; 4] {
        [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(u, v)| self.point(pixel, u, v))
    }

    fn point(&self, pixel: usize, u: f64, v: f64) -> DVec3 {
        let k = self.resolution;
        let face = &FACES[pixel / (k * k)];
        let coordinate = |cell: usize, within: f64| 2.0 * (cell as f64 + within) / k as f64 - 1.0;
        face.axis.as_dvec3()
            + face.u.as_dvec3() * coordinate(pixel % k, u)
            + face.v.as_dvec3() * coordinate(pixel / k % k, v)
    }

    /// The pixels, or their parts, above the horizon of the unit `normal`; their weights sum to π.
    pub(super) fn above_horizon(&self, normal: Vec3, open: &mut Vec<OpenPixel>) {
        open.clear();
        let normal = normal.as_dvec3().normalize();
        let mut clipped = Vec::new();
        for (pixel, &whole) in self.moment.iter().enumerate() {
            let corners = self.corners(pixel);
            let above = corners
                .iter()
                .filter(|corner| corner.dot(normal) > 0.0)
                .count();
            let moment = match above {
                0 => continue,
                4 => whole,
                _ => {
                    clip_to_horizon(&corners, normal, &mut clipped);
                    polygon_moment(&clipped)
                }
            };
            let weight = moment.dot(normal);
            if weight > 0.0 {
                #[expect(clippy::cast_possible_truncation, reason = "stored as f32")]
                open.push(OpenPixel {
                    pixel,
                    direction: moment.normalize().as_vec3(),
                    weight: weight as f32,
                });
            }
        }
    }
}

/// Append `open` to `hemisphere`, seeing nothing yet.
pub(super) fn append_empty(open: &[OpenPixel], hemisphere: &mut Hemisphere) {
    for pixel in open {
        hemisphere.direction.push(pixel.direction);
        hemisphere.weight.push(pixel.weight);
    }
    hemisphere.coverage.resize(open.len(), 0.0);
    hemisphere.distance.resize(open.len(), f32::INFINITY);
    hemisphere.reflected.resize(open.len(), Vec3::ZERO);
    hemisphere.emitted.resize(open.len(), Vec3::ZERO);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn faces_are_right_handed() {
        for face in FACES {
            assert_eq!(face.u.cross(face.v), face.axis);
        }
    }

    #[test]
    fn cosine_weights_of_any_hemisphere_sum_to_pi_and_point_above_the_horizon() {
        for resolution in [1, 2, 8, 12, 32] {
            let table = PixelTable::new(resolution);
            let mut open = Vec::new();
            for normal in [
                Vec3::X,
                Vec3::NEG_Z,
                Vec3::new(1.0, 1.0, 0.0).normalize(),
                Vec3::new(-0.2, 0.5, 0.7).normalize(),
            ] {
                table.above_horizon(normal, &mut open);
                let sum: f64 = open.iter().map(|pixel| f64::from(pixel.weight)).sum();
                assert!((sum - PI).abs() < 1e-5, "{resolution} {normal} {sum}");
                assert!(open.iter().all(|pixel| pixel.direction.dot(normal) > 0.0));
            }
        }
    }

    #[test]
    fn moments_equal_numeric_integration_over_the_pixel() {
        let table = PixelTable::new(3);
        let n = 200;
        for pixel in [0, 4, 17, 53] {
            let mut sum = DVec3::ZERO;
            for i in 0..n * n {
                let point = table.point(
                    pixel,
                    ((i % n) as f64 + 0.5) / n as f64,
                    ((i / n) as f64 + 0.5) / n as f64,
                );
                let area = (2.0 / 3.0 / n as f64).powi(2);
                // dω = cos/d² dA = dA/d³ for a plane at distance 1.
                sum += point.normalize() * (area / point.length().powi(3));
            }
            assert!((sum - table.moment[pixel]).length() < 1e-5);
        }
    }
}
