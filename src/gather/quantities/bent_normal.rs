//! The average unoccluded direction, plain and weighted by light. PBGI §8.7.

use super::Seen;
use crate::gather::Hemisphere;
use glam::{DVec3, Vec3};

/// Unit direction of the mean of all open directions, weighted by the cosine; the normal where nothing is open.
pub fn bent_normal(seen: &Seen<'_>) -> Vec3 {
    unit_or_normal(open_direction(seen.hemisphere), seen)
}

/// Unit direction of the mean of all open directions, weighted by the irradiance that the environment sends from there:
/// the bent normal under an even sky, or none. The normal where no light arrives.
pub fn illumination_direction(seen: &Seen<'_>) -> Vec3 {
    unit_or_normal(seen.illumination, seen)
}

fn unit_or_normal(direction: Vec3, seen: &Seen<'_>) -> Vec3 {
    (direction.as_dvec3().try_normalize()).map_or(seen.receivers.normal[seen.index], DVec3::as_vec3)
}

/// Sum of all open directions, weighted by their cosine-weighted solid angles.
pub fn open_direction(hemisphere: &Hemisphere) -> Vec3 {
    hemisphere
        .weight
        .iter()
        .zip(&hemisphere.coverage)
        .zip(&hemisphere.direction)
        .fold(DVec3::ZERO, |sum, ((&weight, &coverage), direction)| {
            sum + direction.as_dvec3() * f64::from(weight * (1.0 - coverage).max(0.0))
        })
        .as_vec3()
}

#[cfg(test)]
mod tests {
    use super::super::testing::with_seen;
    use super::*;

    #[test]
    fn it_points_to_the_open_side_and_is_the_normal_where_all_is_closed() {
        let side = Vec3::new(0.6, 0.8, 0.0);
        with_seen(
            &[
                (side, 1.0, 0.0, Vec3::ZERO),
                (Vec3::Z, 1.0, 1.0, Vec3::ZERO),
            ],
            |seen| assert!(bent_normal(seen).abs_diff_eq(side, 1e-6)),
        );
        with_seen(&[(side, 1.0, 1.0, Vec3::ZERO)], |seen| {
            assert_eq!(bent_normal(seen), Vec3::Y);
        });
    }
}
