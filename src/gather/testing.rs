//! For tests: receivers, and geometry in closed form behind the rays engine's seam.

use super::ray_query::RayQuery;
use crate::receivers::Receivers;
use crate::results::{PixelShare, Target};
use crate::scene::PrimId;
use crate::shading::SurfacePoint;
use crate::trace::Hit;
use glam::{DVec3, Vec3};

/// A column of pixels that so many receivers each share alike, one after the other.
pub(crate) fn pixels_of(counts: &[u16]) -> Target {
    let of_pixel = |(pixel, &count): (u32, &u16)| (0..count).map(move |_| (pixel, count));
    let all = (0..).zip(counts).flat_map(of_pixel);
    let share = |(receiver, (pixel, count)): (u32, (u32, u16))| PixelShare {
        pixel,
        receiver,
        weight: 1.0 / f32::from(count),
    };
    Target::Image {
        width: 1,
        height: u32::try_from(counts.len()).expect("few pixels"),
        shares: (0..).zip(all).map(share).collect(),
    }
}

/// Receivers at (position, normal), in the middle of flat triangles.
pub(crate) fn receivers_at(points: &[(Vec3, Vec3)]) -> Receivers {
    let surface = SurfacePoint {
        prim: PrimId(0),
        triangle: 0,
        u: 0.3,
        v: 0.3,
        footprint: 0.0,
    };
    Receivers {
        origin: DVec3::ZERO,
        position: points.iter().map(|p| p.0).collect(),
        normal: points.iter().map(|p| p.1).collect(),
        geometric_normal: points.iter().map(|p| p.1).collect(),
        prim: vec![0; points.len()],
        surface: vec![surface; points.len()],
        depth: Vec::new(),
        toward_eye: Vec::new(),
        target: Target::Surfels,
    }
}

/// A shape with a closed form for rays.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    Sphere {
        center: Vec3,
        radius: f32,
    },
    Disk {
        center: Vec3,
        normal: Vec3,
        radius: f32,
    },
}

impl Shape {
    fn hit(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        match *self {
            Self::Sphere { center, radius } => {
                let to = center - origin;
                let along = to.dot(direction);
                let half = (radius * radius - (to - direction * along).length_squared()).sqrt();
                [along - half, along + half].into_iter().find(|&t| t > 0.0)
            }
            Self::Disk {
                center,
                normal,
                radius,
            } => {
                let t = normal.dot(center - origin) / normal.dot(direction);
                let inside = (origin + direction * t).distance(center) < radius;
                (t > 0.0 && t.is_finite() && inside).then_some(t)
            }
        }
    }
}

/// Shapes as geometry; prim = index of the shape.
#[derive(Debug, Clone)]
pub(super) struct Shapes(pub(super) Vec<Shape>);

impl RayQuery for Shapes {
    fn closest(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit> {
        let hits = self.0.iter().zip(0..).filter_map(|(shape, prim)| {
            let distance = shape.hit(origin, direction)?;
            (distance < max_distance).then_some(Hit {
                distance,
                prim: PrimId(prim),
                triangle: 0,
                u: 0.0,
                v: 0.0,
                front: true,
            })
        });
        hits.min_by(|a, b| a.distance.total_cmp(&b.distance))
    }

    fn occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        self.closest(origin, direction, max_distance).is_some()
    }

    fn lift(&self, position: Vec3, normal: Vec3) -> Vec3 {
        position + normal * 1e-5
    }
}
