//! Ambient occlusion and its complement. PBGI §8.5.

use crate::gather::Hemisphere;
use std::f32::consts::{FRAC_1_PI, PI};

/// Cosine-weighted fraction of the hemisphere that is covered, 0…1. Summing what is covered and not what is open
/// makes an open hemisphere exactly 0, and [`visibility`] exactly 1.
pub fn occlusion(hemisphere: &Hemisphere) -> f32 {
    (covered(hemisphere) * FRAC_1_PI).clamp(0.0, 1.0)
}

/// 1 − occlusion.
pub fn visibility(hemisphere: &Hemisphere) -> f32 {
    1.0 - occlusion(hemisphere)
}

/// Cosine-weighted solid angle that is open, sr, 0…π: the irradiance of a uniform sky of radiance 1.
pub fn open(hemisphere: &Hemisphere) -> f32 {
    PI * visibility(hemisphere)
}

/// Cosine-weighted solid angle that is covered, sr.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the sum is rounded once, at its end"
)]
fn covered(hemisphere: &Hemisphere) -> f32 {
    let sum: f64 = hemisphere
        .weight
        .iter()
        .zip(&hemisphere.coverage)
        .map(|(&weight, &coverage)| f64::from(weight) * f64::from(coverage))
        .sum();
    sum as f32
}

#[cfg(test)]
mod tests {
    use super::super::testing::with_seen;
    use super::*;
    use glam::Vec3;

    #[test]
    fn half_a_hemisphere_covered_is_one_half() {
        let half = 0.5 * PI;
        with_seen(
            &[
                (Vec3::Y, half, 1.0, Vec3::ZERO),
                (Vec3::X, half, 0.0, Vec3::ZERO),
            ],
            |seen| {
                assert!((occlusion(seen.hemisphere) - 0.5).abs() < 1e-6);
                assert!((open(seen.hemisphere) - half).abs() < 1e-5);
            },
        );
    }

    #[test]
    fn an_open_sky_is_exactly_visible_and_rounding_never_leaves_the_range() {
        with_seen(&[(Vec3::Y, PI, 0.0, Vec3::ZERO)], |seen| {
            assert_eq!(occlusion(seen.hemisphere), 0.0);
            assert_eq!(visibility(seen.hemisphere), 1.0);
        });
        with_seen(&[(Vec3::Y, 1.001 * PI, 1.0, Vec3::ZERO)], |seen| {
            assert_eq!(occlusion(seen.hemisphere), 1.0);
            assert_eq!(open(seen.hemisphere), 0.0);
        });
    }
}
