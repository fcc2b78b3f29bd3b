//! How values change as a receiver turns: rotational gradients. Ward and Heckbert, *Irradiance Gradients* (1992).

use crate::gather::Hemisphere;
use glam::{DVec3, Vec3};

/// Next to the horizon a direction's solid angle is taken for that of one with this cosine: it is not known better.
const LEAST_COSINE: f32 = 0.02;

/// Change of the visibility of a receiver with `normal` by the change of its normal: turned to n, it is
/// v + gradient · (n − normal), as long as n is near.
pub fn visibility(hemisphere: &Hemisphere, normal: Vec3) -> Vec3 {
    let open = |k: usize| f64::from((1.0 - hemisphere.coverage[k]).max(0.0));
    sum(hemisphere, normal, |k| DVec3::splat(open(k)))[0] * std::f32::consts::FRAC_1_PI
}

/// The same of each channel of the irradiance of reflected light, radiance·sr.
pub fn indirect(hemisphere: &Hemisphere, normal: Vec3) -> [Vec3; 3] {
    sum(hemisphere, normal, |k| hemisphere.reflected[k].as_dvec3())
}

/// For each channel of what comes from direction k: ∫ it · direction dω over the hemisphere, without its part along the
/// normal, along which no normal turns.
fn sum(hemisphere: &Hemisphere, normal: Vec3, comes: impl Fn(usize) -> DVec3) -> [Vec3; 3] {
    let mut sums = [DVec3::ZERO; 3];
    for (k, (&direction, &weight)) in
        (hemisphere.direction.iter().zip(&hemisphere.weight)).enumerate()
    {
        let solid_angle = weight / direction.dot(normal).max(LEAST_COSINE);
        let (along, radiance) = (direction.as_dvec3() * f64::from(solid_angle), comes(k));
        for (sum, channel) in sums.iter_mut().zip(radiance.to_array()) {
            *sum += along * channel;
        }
    }
    sums.map(|sum| sum.as_vec3().reject_from_normalized(normal))
}

#[cfg(test)]
mod tests {
    use super::super::testing::with_seen;
    use super::*;
    use crate::math::sequence;
    use std::f32::consts::PI;

    /// Radiance L(ω) = 1 + x over the whole sphere gives E(n) = π + 2π/3 · n.x, whatever the normal.
    #[test]
    fn turning_in_light_from_one_side_changes_irradiance_as_the_closed_form_says() {
        let normal = Vec3::Y;
        let directions = (0..4000).map(|k| {
            let local = sequence::cosine_hemisphere(sequence::fibonacci(k, 4000));
            Vec3::new(local.x, local.z, local.y)
        });
        let rays: Vec<_> = directions
            .map(|d| (d, PI / 4000.0, 1.0, Vec3::new(1.0 + d.x, 1.0, 0.0)))
            .collect();
        with_seen(&rays, |seen| {
            let [tilted, even, black] = indirect(seen.hemisphere, normal);
            // Of light from below the horizon the hemisphere knows nothing: half of the sphere tells half of it, and the
            // other half comes with the turn.
            assert!(
                tilted.abs_diff_eq(Vec3::X * 2.0 * PI / 3.0, 0.05),
                "{tilted}"
            );
            assert!(even.length() < 0.05 && black == Vec3::ZERO, "{even}");
            assert_eq!(visibility(seen.hemisphere, normal), Vec3::ZERO);
        });
    }
}
