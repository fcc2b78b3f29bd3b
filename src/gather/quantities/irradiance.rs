//! Irradiance: the hemisphere's radiance, weighted by the cosine. PBGI §6.2.

use super::Seen;
use crate::gather::Hemisphere;
use glam::{DVec3, Vec3};

/// Irradiance from light that surfaces reflect, radiance·sr.
pub fn indirect(hemisphere: &Hemisphere) -> Vec3 {
    hemisphere
        .weight
        .iter()
        .zip(&hemisphere.reflected)
        .fold(DVec3::ZERO, |sum, (&weight, radiance)| {
            sum + radiance.as_dvec3() * f64::from(weight)
        })
        .as_vec3()
}

/// Irradiance of all light, radiance·sr.
pub fn total(seen: &Seen<'_>) -> Vec3 {
    seen.direct + seen.environment + seen.indirect
}

#[cfg(test)]
mod tests {
    use super::super::testing::with_seen;
    use super::*;
    use std::f32::consts::PI;

    #[test]
    fn uniform_radiance_gives_pi_times_it() {
        let radiance = Vec3::new(1.0, 2.0, 1e6);
        let rays = [(Vec3::Y, PI / 100.0, 1.0, radiance); 100];
        with_seen(&rays, |seen| {
            assert!(
                (indirect(seen.hemisphere) / (PI * radiance) - 1.0)
                    .abs()
                    .max_element()
                    < 1e-5
            );
        });
    }

    #[test]
    fn the_total_is_the_sum_of_its_three_parts() {
        with_seen(&[], |seen| {
            (seen.direct, seen.environment, seen.indirect) =
                (Vec3::X, 2.0 * Vec3::Y, 4.0 * Vec3::Z);
            assert_eq!(total(seen), Vec3::new(1.0, 2.0, 4.0));
        });
    }
}
