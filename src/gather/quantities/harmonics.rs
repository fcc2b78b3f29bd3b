//! Directional visibility and the light that arrives by reflection, as spherical harmonics. PBGI §8.7.

use super::Seen;
use crate::gather::Hemisphere;
use crate::math::sh::{COEFFICIENT_COUNT, Sh9};
use glam::{DVec3, Vec3};
use std::f32::consts::{PI, TAU};

/// Directions that stand for more than this many times the mean solid angle stand for equal parts of theirs: those next
/// to the horizon, of which a cosine-distributed pattern has few, so that the last one alone would stand for 2π/√count.
const MOST_SHARE: f32 = 4.0;

/// Coefficients of the function that is 1 in open directions above the horizon of the shading normal and 0 in all
/// others: no cosine, world space, basis of [`Sh9`]. Times the coefficients of an environment's radiance, summed: the
/// light that arrives from open directions, as far as 9 coefficients tell.
///
/// Exact where all is open and where nothing is, within 2 % of √π beside a wall by 1024 rays: what the pattern of directions makes of an open hemisphere, against the
/// closed form, is taken off by the part that is open.
pub fn visibility(seen: &Seen<'_>) -> Sh9 {
    let (hemisphere, normal) = (seen.hemisphere, seen.receivers.normal[seen.index]);
    let angles = SolidAngles::of(hemisphere, normal);
    if angles.whole == 0.0 {
        return Sh9::default();
    }
    let mut open = [0.0_f64; COEFFICIENT_COUNT];
    let mut all = [0.0_f64; COEFFICIENT_COUNT];
    let mut open_angle = 0.0;
    let directions = hemisphere.direction.iter().zip(&hemisphere.weight);
    for ((&direction, &weight), &coverage) in directions.zip(&hemisphere.coverage) {
        let solid_angle = angles.share(direction.dot(normal), weight);
        let visible = f64::from((1.0 - coverage).max(0.0));
        open_angle += visible * solid_angle;
        for (k, basis) in Sh9::basis(direction).0.into_iter().enumerate() {
            all[k] += f64::from(basis) * solid_angle;
            open[k] += f64::from(basis) * solid_angle * visible;
        }
    }
    let (factor, share) = (f64::from(TAU) / angles.whole, open_angle / angles.whole);
    // 2π ∫₀¹ Pₗ(t) dt: 2π, π, 0
    let exact = Sh9::zonal(normal, [TAU, PI, 0.0]);
    let coefficient = |k: usize| {
        let error = all[k] * factor - f64::from(exact.0[k]);
        #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
        let coefficient = (open[k] * factor - share * error) as f32;
        coefficient
    };
    Sh9(std::array::from_fn(coefficient))
}

/// Coefficients of the radiance that surfaces send by reflection from above the horizon of the shading normal, 0 from below:
/// no cosine, world space, basis of [`Sh9`], `[coefficient][channel]`. Convolved with the clamped cosine and evaluated
/// at a direction: the irradiance there, as far as 9 coefficients tell.
///
/// Exact where the same light comes from everywhere: what the pattern of directions makes of that, against the closed
/// form, is taken off by the mean radiance.
pub fn radiance(seen: &Seen<'_>) -> [[f32; 3]; COEFFICIENT_COUNT] {
    let (hemisphere, normal) = (seen.hemisphere, seen.receivers.normal[seen.index]);
    let angles = SolidAngles::of(hemisphere, normal);
    if angles.whole == 0.0 {
        return [[0.0; 3]; COEFFICIENT_COUNT];
    }
    let mut light = [DVec3::ZERO; COEFFICIENT_COUNT];
    let mut all = [0.0_f64; COEFFICIENT_COUNT];
    let mut sum = DVec3::ZERO;
    let directions = hemisphere.direction.iter().zip(&hemisphere.weight);
    for ((&direction, &weight), &reflected) in directions.zip(&hemisphere.reflected) {
        let solid_angle = angles.share(direction.dot(normal), weight);
        let part = reflected.as_dvec3() * solid_angle;
        sum += part;
        for (k, basis) in Sh9::basis(direction).0.into_iter().enumerate() {
            all[k] += f64::from(basis) * solid_angle;
            light[k] += f64::from(basis) * part;
        }
    }
    let (factor, mean) = (f64::from(TAU) / angles.whole, sum / angles.whole);
    let exact = Sh9::zonal(normal, [TAU, PI, 0.0]);
    std::array::from_fn(|k| {
        let error = all[k] * factor - f64::from(exact.0[k]);
        (light[k] * factor - mean * error).as_vec3().to_array()
    })
}

/// How the directions of a hemisphere share it.
struct SolidAngles {
    /// Sum of all, about 2π.
    whole: f64,
    /// Larger ones are pooled.
    limit: f32,
    /// Mean of those.
    pooled: f64,
}

impl SolidAngles {
    fn of(hemisphere: &Hemisphere, normal: Vec3) -> Self {
        let limit = MOST_SHARE * TAU / hemisphere.direction.len().max(1) as f32;
        let (mut whole, mut pool, mut count) = (0.0, 0.0, 0.0);
        for (direction, &weight) in hemisphere.direction.iter().zip(&hemisphere.weight) {
            let angle = solid_angle(direction.dot(normal), weight);
            whole += f64::from(angle);
            if angle > limit {
                pool += f64::from(angle);
                count += 1.0;
            }
        }
        Self {
            whole,
            limit,
            pooled: if count > 0.0 { pool / count } else { 0.0 },
        }
    }

    fn share(&self, cosine: f32, weight: f32) -> f64 {
        let angle = solid_angle(cosine, weight);
        if angle > self.limit {
            self.pooled
        } else {
            f64::from(angle)
        }
    }
}

/// Of a direction of cosine `cosine` to the normal that stands for `weight` of the cosine-weighted hemisphere: that of
/// the part of the band around its cosine in which the squared cosine differs by `weight/π`. Where the weight is small
/// against the cosine this is `weight / cosine`; the directions of a cosine-distributed pattern, which are stratified
/// in the squared cosine, have exactly such bands, so that their sum is 2π.
fn solid_angle(cosine: f32, weight: f32) -> f32 {
    let (square, half) = (cosine * cosine, 0.5 * weight / PI);
    let (top, bottom) = ((square + half).sqrt(), (square - half).max(0.0).sqrt());
    if top > 0.0 {
        2.0 * weight / (top + bottom)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::with_seen;
    use super::*;
    use crate::math::{Frame, sequence};

    /// Of 1024 directions beside a wall: 2 % of the first coefficient of an open plane. Found are 0.011 to 0.033 for walls
    /// turned about the normal: few directions are next to the horizon.
    const TOLERANCE: f32 = 0.04;

    /// Cosine-distributed directions about +Y, covered where `covered` says.
    fn pattern(count: u32, covered: impl Fn(Vec3) -> bool) -> Vec<(Vec3, f32, f32, Vec3)> {
        let frame = Frame::about(Vec3::Y);
        (0..count)
            .map(|i| {
                let local = sequence::cosine_hemisphere(sequence::fibonacci(i, count));
                let direction = frame.to_world(local);
                let coverage = if covered(direction) { 1.0 } else { 0.0 };
                (direction, PI / count as f32, coverage, Vec3::ZERO)
            })
            .collect()
    }

    #[test]
    fn an_open_hemisphere_has_the_harmonics_of_a_step_at_the_horizon() {
        // 2π ∫₀¹ Pₗ(t) dt: 2π, π, 0
        let exact = Sh9::zonal(Vec3::Y, [TAU, PI, 0.0]);
        with_seen(&pattern(256, |_| false), |seen| {
            let found = visibility(seen);
            for (a, b) in found.0.iter().zip(&exact.0) {
                assert!((a - b).abs() < 1e-5, "{found:?} {exact:?}");
            }
        });
    }

    #[test]
    fn behind_a_wall_a_quarter_of_the_sphere_is_left() {
        let quarter = |d: Vec3| if d.x > 0.0 && d.y > 0.0 { 1.0 } else { 0.0 };
        let count = 100_000;
        let solid_angle = 2.0 * TAU / count as f32;
        let exact = Sh9::project((0..count).map(|i| {
            let direction = sequence::spiral_sphere(i, count);
            (direction, quarter(direction), solid_angle)
        }));
        assert!((exact.0[0] - PI * 0.282_094_8).abs() < 1e-3);
        with_seen(&pattern(1024, |d| d.x < 0.0), |seen| {
            let found = visibility(seen);
            for (a, b) in found.0.iter().zip(&exact.0) {
                assert!((a - b).abs() < TOLERANCE, "{found:?} {exact:?}");
            }
        });
    }

    #[test]
    fn even_light_has_the_harmonics_of_a_step_and_a_spot_those_of_its_direction() {
        let color = Vec3::new(0.5, 1.0, 2.0);
        let lit: Vec<_> = (pattern(256, |_| true).into_iter())
            .map(|(direction, weight, coverage, _)| (direction, weight, coverage, color))
            .collect();
        let exact = Sh9::zonal(Vec3::Y, [TAU, PI, 0.0]);
        with_seen(&lit, |seen| {
            for (found, exact) in radiance(seen).iter().zip(exact.0) {
                let off = Vec3::from_array(*found) - color * exact;
                assert!(off.abs().max_element() < 1e-5, "{found:?} {exact}");
            }
        });
        let toward = Vec3::new(0.6, 0.64, -0.48);
        let cone: f32 = 0.02;
        let spot = |d: Vec3| d.dot(toward) > 1.0 - cone;
        let lit: Vec<_> = (pattern(16_384, spot).into_iter())
            .map(|(direction, weight, coverage, _)| (direction, weight, coverage, color * coverage))
            .collect();
        // A cap of 1 − cos = 0.02: of band l, 2π ∫ Pₗ(t) dt over the cap.
        let low = 1.0 - cone;
        let bands = [TAU * cone, PI * (1.0 - low * low), PI * (low - low.powi(3))];
        let exact = Sh9::zonal(toward, bands);
        with_seen(&lit, |seen| {
            for (found, exact) in radiance(seen).iter().zip(exact.0) {
                let off = Vec3::from_array(*found) - color * exact;
                assert!(
                    off.abs().max_element() < 0.03 * TAU * cone,
                    "{found:?} {exact}"
                );
            }
        });
    }

    #[test]
    fn nothing_seen_is_nothing_open() {
        with_seen(&[], |seen| assert_eq!(visibility(seen), Sh9::default()));
        with_seen(&[], |seen| assert_eq!(radiance(seen), [[0.0; 3]; 9]));
        with_seen(&pattern(64, |_| true), |seen| {
            assert_eq!(visibility(seen), Sh9::default());
        });
    }
}
