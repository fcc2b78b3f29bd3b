//! Outgoing radiance of diffuse surfaces: albedo/π times irradiance, and the beauty made of it.

use super::{Seen, irradiance};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Radiance reflected of what comes from lights, emissive surfaces and the environment.
pub fn direct(seen: &Seen<'_>) -> Vec3 {
    reflected(seen, seen.direct + seen.environment)
}

/// Radiance reflected of what comes from other surfaces' reflections.
pub fn indirect(seen: &Seen<'_>) -> Vec3 {
    reflected(seen, seen.indirect)
}

/// Everything that makes light: emission and reflection.
pub fn color(seen: &Seen<'_>) -> Vec3 {
    seen.surface.emission + reflected(seen, irradiance::total(seen))
}

fn reflected(seen: &Seen<'_>, irradiance: Vec3) -> Vec3 {
    seen.surface.albedo * irradiance * FRAC_1_PI
}

#[cfg(test)]
mod tests {
    use super::super::testing::with_seen;
    use super::*;

    #[test]
    fn color_is_emission_and_both_diffuse_parts() {
        with_seen(&[], |seen| {
            seen.surface.albedo = Vec3::new(0.5, 0.25, 1.0);
            seen.surface.emission = Vec3::new(7.0, 0.0, 0.0);
            seen.direct = Vec3::splat(2.0);
            seen.environment = Vec3::splat(1.0);
            seen.indirect = Vec3::splat(4.0);
            let expected = seen.surface.emission + direct(seen) + indirect(seen);
            assert!(color(seen).abs_diff_eq(expected, 1e-6));
            assert!((direct(seen).x - 0.5 * 3.0 * FRAC_1_PI).abs() < 1e-6);
        });
    }
}
