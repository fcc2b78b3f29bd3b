//! A seed and its neighbors → how fast values change there, and how wrong the neighbors are about the seed.

use super::seeds::Seeds;
use crate::math::frame::Frame;
use glam::swizzles::Vec3Swizzles;
use glam::{DMat2, DMat3, DVec3, Vec3};

/// Neighbors that a plane is laid through.
pub(super) const NEIGHBORS: usize = 10;

/// The same to even a seed with: what rays err by in these is smaller still. 16, 24 and 40 leave 0.93, 0.88 and 0.85 of the error
/// of 10 in a Cornell box at 5 %, 0.95, 0.95 and 0.98 at 2 %.
pub(super) const MANY_NEIGHBORS: usize = 24;

/// Neighbors without which there is no plane.
const FEWEST: usize = 4;

/// The moments' determinant, of offsets up to 1 and weights that sum to 1, below which neighbors stand in a row.
const IN_A_ROW: f64 = 1e-4;

/// The farthest neighbor counts a little too: offsets are scaled to this.
const REACH: f64 = 0.9;

/// Values around a seed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    /// Change of each component along the surface, per stage unit.
    pub(super) gradient: Vec<Vec3>,
    /// What the neighbors alone would say of each component at the seed, minus what it is.
    pub(super) surprise: Vec<f32>,
    /// Part of that which is to be added to the seed's own values for the least error, if seeds err by chance and alike.
    pub(super) share: f32,
}

/// Least squares through `around[1..]`, the neighbors of seed `around[0]`, nearest first; `None` where they are too few or
/// in a row.
pub(super) fn fit(seeds: &Seeds, around: &[u32]) -> Option<Fit> {
    let (&own, others) = around.split_first()?;
    if others.len() < FEWEST {
        return None;
    }
    let plane = Plane::new(seeds, own, others)?;
    let found =
        (0..seeds.components).map(|component| plane.through(seeds, (own, others), component));
    let (gradient, surprise) = found.unzip();
    Some(Fit {
        gradient,
        surprise,
        share: plane.share(),
    })
}

/// What does not hang on the values.
struct Plane {
    frame: Frame,
    /// Length of offset 1, stage units.
    scale: f64,
    /// 1 and offset of each neighbor, and its weight.
    offsets: Vec<(DVec3, f64)>,
    /// From the weighted sums of rises, and of rises by offsets, to slopes and to the level at the seed.
    slopes: DMat2,
    level: DVec3,
}

impl Plane {
    fn new(seeds: &Seeds, own: u32, others: &[u32]) -> Option<Self> {
        let position = |seed: u32| seeds.position[seed as usize];
        let frame = Frame::about(seeds.normal[own as usize]);
        let farthest = position(*others.last()?).distance(position(own));
        if farthest <= 0.0 {
            return None;
        }
        let scale = f64::from(farthest) / REACH;
        let offset = |&other: &u32| {
            let apart = position(other) - position(own);
            let (x, y) = (apart.dot(frame.tangent), apart.dot(frame.bitangent));
            let offset = DVec3::new(1.0, f64::from(x) / scale, f64::from(y) / scale);
            (offset, (1.0 - offset.yz().length()).max(0.0).powi(2))
        };
        let mut offsets: Vec<(DVec3, f64)> = others.iter().map(offset).collect();
        let sum: f64 = offsets.iter().map(|(_, weight)| weight).sum();
        offsets.iter_mut().for_each(|(_, weight)| *weight /= sum);
        let moments = offsets.iter().fold(DMat3::ZERO, |sum, &(u, weight)| {
            sum + DMat3::from_cols(u, u * u.y, u * u.z) * weight
        });
        let own_moments = DMat2::from_cols(moments.y_axis.yz(), moments.z_axis.yz());
        let is_flat = moments.determinant() > IN_A_ROW && own_moments.determinant() > IN_A_ROW;
        is_flat.then(|| Self {
            frame,
            scale,
            offsets,
            slopes: own_moments.inverse(),
            level: moments.inverse().x_axis,
        })
    }

    /// See [`Fit::share`]: of two independent findings each counts by the inverse of its variance.
    #[expect(clippy::cast_possible_truncation, reason = "a part of 1")]
    fn share(&self) -> f32 {
        let part = |&(u, weight): &(DVec3, f64)| (weight * self.level.dot(u)).powi(2);
        let variance: f64 = self.offsets.iter().map(part).sum();
        (1.0 / (1.0 + variance)) as f32
    }

    /// Gradient of one component, and surprise.
    #[expect(clippy::cast_possible_truncation, reason = "rounded once, at its end")]
    fn through(
        &self,
        seeds: &Seeds,
        (own, others): (u32, &[u32]),
        component: usize,
    ) -> (Vec3, f32) {
        let normal = seeds.normal[own as usize];
        let value = |seed: u32| f64::from(seeds.turned(seed, component, normal));
        let rises = (others.iter().zip(&self.offsets))
            .fold(DVec3::ZERO, |sum, (&other, &(u, weight))| {
                sum + u * (weight * (value(other) - value(own)))
            });
        let slope = (self.slopes * rises.yz()).as_vec2() / self.scale as f32;
        let gradient = self.frame.tangent * slope.x + self.frame.bitangent * slope.y;
        (gradient, self.level.dot(rises) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::super::seeds::testing::seeds_at;
    use super::*;

    /// 5 × 5 places on the plane y = 0, the middle one first.
    fn grid(value: impl Fn(Vec3) -> f32) -> Seeds {
        let mut places: Vec<Vec3> = (-2..=2_i16)
            .flat_map(|x| (-2..=2_i16).map(move |z| Vec3::new(f32::from(x), 0.0, f32::from(z))))
            .collect();
        places.sort_by(|a, b| a.length().total_cmp(&b.length()));
        let seed = |&place: &Vec3| (place, Vec3::Y, value(place), Vec3::ZERO);
        seeds_at(&places.iter().map(seed).collect::<Vec<_>>())
    }

    #[test]
    fn neighbors_all_around_are_believed_more_than_those_of_one_side() {
        let seeds = grid(|_| 0.0);
        let all: Vec<u32> = (0..11).collect();
        let is_beside = |&i: &u32| i == 0 || seeds.position[i as usize].x > 0.0;
        let beside: Vec<u32> = (0..25).filter(is_beside).collect();
        let [all, beside] = [all, beside].map(|around| fit(&seeds, &around).unwrap().share);
        // The mean of a few neighbors has a fraction of the variance of one; what is foretold from beside has more.
        assert!((0.75..0.95).contains(&all), "{all}");
        assert!((0.3..0.75).contains(&beside), "{beside}");
    }

    #[test]
    fn a_plane_is_found_and_no_surprise() {
        let seeds = grid(|p| 3.0 + 2.0 * p.x - 0.5 * p.z);
        let around: Vec<u32> = (0..11).collect();
        let found = fit(&seeds, &around).unwrap();
        assert!(found.gradient[0].abs_diff_eq(Vec3::new(2.0, 0.0, -0.5), 1e-5));
        assert!(found.surprise[0].abs() < 1e-5);
    }

    #[test]
    fn a_bump_surprises_by_its_height_and_has_no_slope() {
        let seeds = grid(|p| if p == Vec3::ZERO { 1.0 } else { 0.0 });
        let found = fit(&seeds, &(0..9).collect::<Vec<_>>()).unwrap();
        assert!((found.surprise[0] + 1.0).abs() < 1e-5);
        assert!(found.gradient[0].length() < 1e-5);
    }

    #[test]
    fn neighbors_that_are_turned_tell_what_they_would_see_if_they_were_not() {
        // Irradiance of a sun at d is n · d: the same everywhere for the same normal.
        let sun = Vec3::new(0.6, 0.8, 0.0);
        let places = [Vec3::ZERO, Vec3::X, -Vec3::X, Vec3::Z, -Vec3::Z];
        let seed = |&place: &Vec3| {
            let normal = (Vec3::Y + 0.2 * place).normalize();
            (place, normal, normal.dot(sun), sun)
        };
        let seeds = seeds_at(&places.iter().map(seed).collect::<Vec<_>>());
        let found = fit(&seeds, &[0, 1, 2, 3, 4]).unwrap();
        assert!(found.gradient[0].length() < 1e-6 && found.surprise[0].abs() < 1e-6);
    }

    #[test]
    fn neighbors_in_a_row_at_one_place_or_too_few_tell_nothing() {
        let row: Vec<_> = (0..8_i16)
            .map(|i| (Vec3::X * f32::from(i), Vec3::Y, 0.0, Vec3::ZERO))
            .collect();
        assert!(fit(&seeds_at(&row), &(0..8).collect::<Vec<_>>()).is_none());
        assert!(fit(&seeds_at(&row), &[0, 1, 2]).is_none());
        assert!(fit(&seeds_at(&[row[0]; 8]), &(0..8).collect::<Vec<_>>()).is_none());
        assert!(fit(&seeds_at(&row), &[]).is_none());
    }
}
