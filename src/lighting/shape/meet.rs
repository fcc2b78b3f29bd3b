//! Where a ray meets a light's shape, for lights that a camera sees.

use super::{Ellipsoid, Plane, Shape};
use glam::{Vec2, Vec3};

/// Where a ray meets a light on its shining side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::lighting) struct Meeting {
    /// Along the ray's direction.
    pub(in crate::lighting) distance: f32,
    /// Place on a rectangle, −1…1 along its X and Y; zero for other shapes.
    pub(in crate::lighting) local: Vec2,
}

impl Shape {
    /// Where the ray from `origin` in the unit `direction` first meets the shining side; `None` for shapes without
    /// extent, for a sun's disk, and from behind.
    pub(in crate::lighting) fn meet(&self, origin: Vec3, direction: Vec3) -> Option<Meeting> {
        match self {
            Self::Point { .. } | Self::Parallel { .. } | Self::Sky { .. } => None,
            Self::Plane(plane) => plane.meet(origin, direction),
            Self::Ellipsoid(body) => body.meet(origin, direction),
            Self::Tube { body, half_length } => body.meet_tube(*half_length, origin, direction),
        }
    }
}

impl Plane {
    fn meet(&self, origin: Vec3, direction: Vec3) -> Option<Meeting> {
        let approach = direction.dot(self.normal);
        if approach >= 0.0 {
            return None;
        }
        let distance = (self.center - origin).dot(self.normal) / approach;
        let offset = origin + direction * distance - self.center;
        let local = coordinates(self.half, offset)?;
        let inside = if self.is_disk {
            local.length_squared() <= 1.0
        } else {
            local.abs().max_element() <= 1.0
        };
        (inside && distance > 0.0).then_some(Meeting { distance, local })
    }
}

/// `offset` in the (possibly skew) axes `half`, which span a plane that contains it.
fn coordinates(half: [Vec3; 2], offset: Vec3) -> Option<Vec2> {
    let (xx, xy, yy) = (
        half[0].dot(half[0]),
        half[0].dot(half[1]),
        half[1].dot(half[1]),
    );
    let determinant = xx * yy - xy * xy;
    let (x, y) = (half[0].dot(offset), half[1].dot(offset));
    (determinant > 0.0).then(|| Vec2::new(yy * x - xy * y, xx * y - xy * x) / determinant)
}

impl Ellipsoid {
    fn meet(&self, origin: Vec3, direction: Vec3) -> Option<Meeting> {
        let (o, d) = self.in_unit_space(origin, direction);
        entry(d.length_squared(), o.dot(d), o.length_squared() - 1.0)
    }

    fn meet_tube(&self, half_length: f32, origin: Vec3, direction: Vec3) -> Option<Meeting> {
        let (o, d) = self.in_unit_space(origin, direction);
        let (across_o, across_d) = (Vec2::new(o.y, o.z), Vec2::new(d.y, d.z));
        let shift = across_o.length_squared() - 1.0;
        entry(across_d.length_squared(), across_o.dot(across_d), shift)
            .filter(|meeting| (o.x + d.x * meeting.distance).abs() <= half_length)
    }

    fn in_unit_space(&self, origin: Vec3, direction: Vec3) -> (Vec3, Vec3) {
        let unit = &self.unit_from_world;
        (
            unit.transform_point3(origin),
            unit.transform_vector3(direction),
        )
    }
}

/// The first root t > 0 of a·t² + 2·b·t + c, where the ray enters from outside (c > 0).
fn entry(a: f32, b: f32, c: f32) -> Option<Meeting> {
    let discriminant = b * b - a * c;
    if c <= 0.0 || b >= 0.0 || discriminant < 0.0 {
        return None;
    }
    // c / (−b + √…) does not cancel, as b < 0.
    let distance = c / (discriminant.sqrt() - b);
    Some(Meeting {
        distance,
        local: Vec2::ZERO,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Affine3A;

    fn distance(shape: &Shape, origin: Vec3, direction: Vec3) -> Option<f32> {
        shape
            .meet(origin, direction.normalize())
            .map(|meeting| meeting.distance)
    }

    #[test]
    fn a_rectangle_is_seen_from_its_front_within_its_sides() {
        let shape = Shape::plane(
            &Affine3A::from_translation(Vec3::Z * 2.0),
            Vec2::new(1.0, 0.5),
            false,
        );
        assert_eq!(distance(&shape, Vec3::ZERO, Vec3::Z), Some(2.0));
        assert_eq!(
            distance(&shape, Vec3::new(0.9, 0.4, 0.0), Vec3::Z),
            Some(2.0)
        );
        assert_eq!(distance(&shape, Vec3::new(0.0, 0.6, 0.0), Vec3::Z), None);
        assert_eq!(distance(&shape, Vec3::Z * 4.0, -Vec3::Z), None);
        let disk = Shape::plane(&Affine3A::IDENTITY, Vec2::ONE, true);
        assert_eq!(distance(&disk, Vec3::new(0.8, 0.8, -1.0), Vec3::Z), None);
    }

    #[test]
    fn a_ball_and_a_tube_are_seen_at_their_surface() {
        let ball =
            Shape::Ellipsoid(Ellipsoid::new(Affine3A::from_scale(Vec3::splat(2.0))).unwrap());
        assert_eq!(distance(&ball, Vec3::X * 5.0, -Vec3::X), Some(3.0));
        assert_eq!(distance(&ball, Vec3::ZERO, Vec3::X), None);
        assert_eq!(distance(&ball, Vec3::new(5.0, 2.1, 0.0), -Vec3::X), None);
        let tube = Shape::Tube {
            body: Ellipsoid::new(Affine3A::IDENTITY).unwrap(),
            half_length: 3.0,
        };
        assert_eq!(
            distance(&tube, Vec3::new(2.5, 4.0, 0.0), -Vec3::Y),
            Some(3.0)
        );
        assert_eq!(distance(&tube, Vec3::new(3.5, 4.0, 0.0), -Vec3::Y), None);
        assert_eq!(distance(&tube, Vec3::X * 9.0, -Vec3::X), None);
    }
}
