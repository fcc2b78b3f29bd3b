//! Part of the hemisphere, and coverage that fades with distance: the kinds of occlusion. PBGI §8.5.

use super::{Hemisphere, Look, RaysEngine, Stand};
use crate::math::sequence;
use crate::receivers::Receivers;
use crate::trace::{Hit, Layer};
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Which directions count, and how much what covers them does. Coverage only: no light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// Its middle.
    pub axis: Axis,
    /// Angle between its axis and its rim, radians, 0…π/2. Directions are weighted by their cosine to the axis.
    pub half_angle: f32,
    /// What distance makes of coverage.
    pub falloff: Falloff,
}

/// The middle of a cone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// The shading normal.
    Normal,
    /// Where a mirror would show the eye what lies; the normal where no camera placed the receiver.
    Mirror,
}

/// How much something at a distance covers, from 1 near by to 0 at the largest distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Falloff {
    /// All of it, up to the largest distance.
    None,
    /// 1 − x, where x is the distance over the largest.
    Linear,
    /// 1 − x²(3 − 2x): no edge at either end.
    Smooth,
    /// (1 − x) to this power, above 0.
    Exponent(f32),
}

impl Falloff {
    /// As command lines spell it: `exponent:2`.
    pub fn name(self) -> String {
        match self {
            Self::None => "none".to_owned(),
            Self::Linear => "linear".to_owned(),
            Self::Smooth => "smooth".to_owned(),
            Self::Exponent(power) => format!("exponent:{power}"),
        }
    }

    /// Coverage by something at `distance` where nothing beyond `max_distance` covers, 0…1.
    pub fn coverage(self, distance: f32, max_distance: f32) -> f32 {
        let x = (distance / max_distance).clamp(0.0, 1.0);
        match self {
            Self::None => 1.0,
            Self::Linear => 1.0 - x,
            Self::Smooth => 1.0 - x * x * (3.0 - 2.0 * x),
            Self::Exponent(power) => (1.0 - x).powf(power),
        }
    }
}

impl Cone {
    /// `count` unit directions about +Z, distributed by their cosine to it, turned by `turn` turns.
    pub(super) fn pattern(&self, count: u32, turn: f32) -> Vec<Vec3> {
        // Projected to the plane of the rim, directions of equal weight cover equal areas.
        let rim = self.half_angle.sin().powi(2);
        let direction = |i| {
            let point = sequence::fibonacci(i, count);
            let turned = (point.y + turn).rem_euclid(1.0);
            sequence::cosine_hemisphere(Vec2::new(rim * point.x, turned))
        };
        (0..count).map(direction).collect()
    }

    fn axis(&self, receivers: &Receivers, i: usize) -> Vec3 {
        let normal = receivers.normal[i];
        match (self.axis, receivers.toward_eye.get(i)) {
            (Axis::Mirror, Some(&eye)) => {
                (normal * (2.0 * normal.dot(eye)) - eye).normalize_or(normal)
            }
            _ => normal,
        }
    }
}

impl RaysEngine<'_> {
    /// What receiver `i` sees of `cone` along `pattern`. Directions below the horizon do not count.
    pub(super) fn fill_cone(
        &self,
        (cone, pattern): (&Cone, &[Vec3]),
        (receivers, i): (&Receivers, usize),
        seen: &mut Hemisphere,
    ) {
        seen.clear();
        let stand = Stand::of(receivers, i);
        let origin = self.query.lift(receivers.position[i], stand.lift);
        let frame = sequence::transported_frame(cone.axis(receivers, i));
        let mut layers = Vec::new();
        for &local in pattern {
            let direction = frame.to_world(local);
            if direction.dot(receivers.normal[i]) <= 0.0 {
                continue;
            }
            let direction = stand.above_horizon(direction);
            let (coverage, distance) =
                self.coverage(cone.falloff, (origin, direction), &mut layers);
            seen.direction.push(direction);
            seen.coverage.push(coverage);
            seen.distance.push(distance);
            seen.reflected.push(Vec3::ZERO);
            seen.emitted.push(Vec3::ZERO);
        }
        let count = seen.direction.len();
        seen.weight.resize(count, PI / count.max(1) as f32);
    }

    /// How much the direction is covered, and from how far: 0 where that does not matter.
    fn coverage(
        &self,
        falloff: Falloff,
        (origin, direction): (Vec3, Vec3),
        layers: &mut Vec<Layer>,
    ) -> (f32, f32) {
        let max = self.max_distance;
        if falloff == Falloff::None {
            let look = Look {
                source: None,
                ..self.look()
            };
            let sight = look.along(origin, direction, layers);
            return (sight.coverage, sight.distance);
        }
        let of = |hit: &Hit| falloff.coverage(hit.distance, max);
        let Some(tracer) = self.query.screens() else {
            let hit = self.query.closest(origin, direction, max);
            return hit.map_or((0.0, f32::INFINITY), |hit| (of(&hit), hit.distance));
        };
        let solid = tracer.solid_closest(origin, direction, max);
        let end = solid.map_or(max, |hit| hit.distance);
        let mut open = tracer.layers((origin, direction), end, layers);
        let mut coverage = solid.map_or(0.0, |hit| open * of(&hit));
        let first = layers.first().map(|layer| layer.hit).or(solid);
        open = 1.0;
        for layer in layers.iter() {
            coverage += open * layer.opacity * of(&layer.hit);
            open *= 1.0 - layer.opacity;
        }
        (coverage, first.map_or(f32::INFINITY, |hit| hit.distance))
    }
}

#[cfg(test)]
mod tests {
    use super::super::RaysSettings;
    use super::*;
    use crate::gather::Engine;
    use crate::gather::quantities::occlusion::occlusion;
    use crate::gather::testing::{Shape, Shapes, receivers_at};
    use std::f32::consts::FRAC_PI_2;

    fn occluded(shapes: &Shapes, receivers: &Receivers, cone: Cone, max: Option<f32>) -> f32 {
        let settings = RaysSettings {
            max_distance: max,
            cone: Some(cone),
            ..RaysSettings::default()
        };
        let engine = RaysEngine::with_query(shapes, None, settings);
        let mut found = 0.0;
        let mut visit = |_, seen: &Hemisphere| found = occlusion(seen);
        engine.see(receivers, 0..1, &mut Hemisphere::default(), &mut visit);
        found
    }

    fn ceiling(height: f32) -> Shapes {
        Shapes(vec![Shape::Disk {
            center: Vec3::Y * height,
            normal: Vec3::Y,
            radius: 1e6,
        }])
    }

    #[test]
    fn a_sphere_on_the_axis_covers_its_share_of_the_cone() {
        let (radius, distance, half_angle) = (0.2, 1.0, 0.5_f32);
        let sphere = Shapes(vec![Shape::Sphere {
            center: Vec3::Y * distance,
            radius,
        }]);
        let cone = Cone {
            axis: Axis::Normal,
            half_angle,
            falloff: Falloff::None,
        };
        let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
        let exact = (radius / distance).powi(2) / half_angle.sin().powi(2);
        let got = occluded(&sphere, &receivers, cone, None);
        assert!((got - exact).abs() < 2e-3, "{got} {exact}");
    }

    #[test]
    fn a_ceiling_fades_with_its_distance() {
        // ∫ 2c f(h/(Dc)) dc over the cosines c = h/D … 1.
        let c = 0.4_f32;
        let exact = [
            (Falloff::None, 1.0 - c * c),
            (Falloff::Linear, (1.0 - c).powi(2)),
            (
                Falloff::Exponent(2.0),
                1.0 - 4.0 * c + 3.0 * c * c - 2.0 * c * c * c.ln(),
            ),
            (
                Falloff::Smooth,
                1.0 - c * c + 6.0 * c * c * c.ln() + 4.0 * c * c * (1.0 - c),
            ),
        ];
        let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
        for (falloff, exact) in exact {
            let cone = Cone {
                axis: Axis::Normal,
                half_angle: FRAC_PI_2,
                falloff,
            };
            let got = occluded(&ceiling(0.4), &receivers, cone, Some(1.0));
            assert!((got - exact).abs() < 3e-3, "{falloff:?}: {got} {exact}");
        }
    }

    #[test]
    fn a_mirror_shows_what_the_eye_would_see_in_it_and_nothing_below_the_horizon() {
        let wall = Shapes(vec![Shape::Sphere {
            center: Vec3::new(2.0, 2.0, 0.0),
            radius: 1.0,
        }]);
        let cone = |axis| Cone {
            axis,
            half_angle: 0.2,
            falloff: Falloff::None,
        };
        let mut receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
        receivers.toward_eye = vec![Vec3::new(-1.0, 1.0, 0.0).normalize()];
        assert_eq!(occluded(&wall, &receivers, cone(Axis::Mirror), None), 1.0);
        assert_eq!(occluded(&wall, &receivers, cone(Axis::Normal), None), 0.0);
        // Half of a cone along the horizon lies below it, where everything is covered.
        receivers.toward_eye = vec![-Vec3::X];
        let below = Shapes(vec![Shape::Disk {
            center: Vec3::Y * -1e-3,
            normal: Vec3::Y,
            radius: 1e6,
        }]);
        assert_eq!(occluded(&below, &receivers, cone(Axis::Mirror), None), 0.0);
    }
}
