//! UsdLux `ShapingAPI`: cone and focus as factors on the emitted radiance, after the schema's documentation.

use crate::scene::Shaping;
use glam::Vec3;

/// A [`Shaping`] in world space.
#[derive(Debug, Clone, Copy)]
pub(super) struct WorldShaping {
    shaping: Shaping,
    /// Unit.
    axis: Vec3,
}

impl WorldShaping {
    /// `axis`: the light's −Z in world space, unit.
    pub(super) fn new(shaping: Shaping, axis: Vec3) -> Self {
        Self { shaping, axis }
    }

    /// Factor on radiance emitted towards the unit `direction`.
    pub(super) fn factor(&self, direction: Vec3) -> Vec3 {
        let cosine = direction.dot(self.axis).clamp(-1.0, 1.0);
        let cone = cone_factor(&self.shaping, cosine);
        if self.shaping.focus > 0.0 {
            let focus = cosine.abs().powf(self.shaping.focus);
            self.shaping.focus_tint.lerp(Vec3::ONE, focus) * cone
        } else {
            Vec3::splat(cone)
        }
    }
}

fn cone_factor(shaping: &Shaping, cosine: f32) -> f32 {
    if shaping.cone_angle >= std::f32::consts::PI {
        return 1.0;
    }
    let angle = cosine.acos();
    if angle > shaping.cone_angle {
        return 0.0;
    }
    let start = shaping.cone_angle * (1.0 - shaping.cone_softness.clamp(0.0, 1.0));
    if angle <= start {
        return 1.0;
    }
    let t = (angle - start) / (shaping.cone_angle - start);
    1.0 - t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn factor(angle: f32, shaping: Shaping) -> Vec3 {
        WorldShaping::new(shaping, Vec3::Z).factor(Vec3::new(angle.sin(), 0.0, angle.cos()))
    }

    const CONE: Shaping = Shaping {
        cone_angle: 0.8,
        cone_softness: 0.0,
        focus: 0.0,
        focus_tint: Vec3::ZERO,
    };

    #[test]
    fn hard_cones_cut_and_soft_ones_are_halfway_in_the_middle_of_the_ramp() {
        assert_eq!(factor(0.79, CONE), Vec3::ONE);
        assert_eq!(factor(0.81, CONE), Vec3::ZERO);
        let soft = Shaping {
            cone_softness: 0.5,
            ..CONE
        };
        assert_eq!(factor(0.39, soft), Vec3::ONE);
        assert!((factor(0.6, soft) - 0.5).abs().max_element() < 1e-5);
        assert_eq!(factor(0.81, soft), Vec3::ZERO);
    }

    #[test]
    fn focus_is_a_power_of_the_cosine_and_tints_what_it_takes() {
        let focus = Shaping {
            cone_angle: 4.0,
            focus: 3.0,
            focus_tint: Vec3::X,
            ..CONE
        };
        let cubed = 0.5_f32.powi(3);
        let truth = Vec3::new(1.0, cubed, cubed);
        assert!(
            (factor(60_f32.to_radians(), focus) - truth)
                .abs()
                .max_element()
                < 1e-5
        );
    }
}
