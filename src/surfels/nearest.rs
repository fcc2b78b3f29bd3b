//! Finding the surfel at a point of space, for clouds that come from files.

use super::SurfelCloud;
use glam::{I64Vec3, Vec3};

/// Farther than this many radii from a surfel's center a point does not belong to it.
const REACH_RADII: f32 = 2.0;

/// Distance off a surfel's plane counts this many times as much as distance within it, so that of two parallel
/// surfaces close together the one that the point lies on wins.
const OFF_PLANE_WEIGHT: f32 = 4.0;

/// Hash grids over a cloud, one for every power of two of surfel size, in two arrays.
///
/// A surfel stands in one grid cell at least `2 · REACH_RADII` radii wide: the eight cells around a point hold all
/// surfels of that size that reach it. 4 bytes a surfel and 4 to 8 for the buckets.
#[derive(Debug, Clone)]
pub struct NearestMap {
    /// Grids that hold surfels: their cells are `2^level` stage units wide. Ascending.
    levels: Vec<i32>,
    /// `surfels[starts[b]..starts[b + 1]]` stand in bucket `b`; a power of two of buckets.
    starts: Vec<u32>,
    surfels: Vec<u32>,
}

impl NearestMap {
    /// Index the cloud, in linear time.
    pub fn new(cloud: &SurfelCloud) -> Self {
        let bucket_count = cloud.len().next_power_of_two();
        let mask = bucket_count - 1;
        let mut levels = std::collections::BTreeSet::new();
        let buckets: Vec<usize> = (0..cloud.len())
            .map(|i| {
                let level = level_of(cloud.radius[i]);
                levels.insert(level);
                hash(level, cell_of(cloud.position[i], level)) & mask
            })
            .collect();
        let mut starts = vec![0_u32; bucket_count + 1];
        for &bucket in &buckets {
            starts[bucket + 1] += 1;
        }
        for bucket in 0..bucket_count {
            starts[bucket + 1] += starts[bucket];
        }
        let mut next = starts.clone();
        let mut surfels = vec![0; cloud.len()];
        for (surfel, &bucket) in (0_u32..).zip(&buckets) {
            surfels[next[bucket] as usize] = surfel;
            next[bucket] += 1;
        }
        Self {
            levels: levels.into_iter().collect(),
            starts,
            surfels,
        }
    }

    /// The surfel whose disk lies closest to `position` (in its own radii, distance off its plane weighing more)
    /// among those facing `normal`; `None` if none is within two radii. `cloud` is the one that was indexed, and
    /// `position` is relative to its origin. The lowest index wins a tie.
    pub fn surfel_at(&self, cloud: &SurfelCloud, position: Vec3, normal: Vec3) -> Option<u32> {
        let mut best = (f32::INFINITY, None);
        for &level in &self.levels {
            for bucket in self.buckets_around(position, level) {
                let range = self.starts[bucket] as usize..self.starts[bucket + 1] as usize;
                for &surfel in &self.surfels[range] {
                    let distance = squared_distance(cloud, surfel, position, normal);
                    let nearer = distance < best.0
                        || (distance == best.0 && best.1.is_some_and(|other| surfel < other));
                    if nearer {
                        best = (distance, Some(surfel));
                    }
                }
            }
        }
        best.1
    }

    /// Buckets of the eight cells whose common corner is nearest to `position`.
    fn buckets_around(&self, position: Vec3, level: i32) -> [usize; 8] {
        let half_cell = 0.5 * width_of(level);
        let low = cell_of(position - half_cell, level);
        let mask = self.starts.len() - 2;
        std::array::from_fn(|corner| {
            let bit = |axis: usize| i64::from(corner >> axis & 1 == 1);
            hash(
                level,
                low.wrapping_add(I64Vec3::new(bit(0), bit(1), bit(2))),
            ) & mask
        })
    }
}

/// Square of the distance in radii; infinite for a surfel out of reach or facing away.
fn squared_distance(cloud: &SurfelCloud, surfel: u32, position: Vec3, normal: Vec3) -> f32 {
    let i = surfel as usize;
    let offset = (position - cloud.position[i]) / cloud.radius[i];
    let squared = offset.length_squared();
    if squared > REACH_RADII * REACH_RADII || cloud.normal[i].dot(normal) <= 0.0 {
        return f32::INFINITY;
    }
    let height = offset.dot(cloud.normal[i]);
    squared + (OFF_PLANE_WEIGHT * OFF_PLANE_WEIGHT - 1.0) * height * height
}

/// The level whose cells are the smallest at least `2 · REACH_RADII · radius` wide.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the binary logarithm of a finite f32 is within ±150"
)]
fn level_of(radius: f32) -> i32 {
    (2.0 * REACH_RADII * radius).log2().ceil() as i32
}

fn width_of(level: i32) -> f32 {
    2.0_f32.powi(level)
}

fn cell_of(position: Vec3, level: i32) -> I64Vec3 {
    // Widths are powers of two: the quotient is exact as long as it does not overflow, and then the cast saturates.
    (position / width_of(level)).floor().as_i64vec3()
}

/// Mixes level and cell to a word of which any bits can be used (multiply and fold; constants from the golden ratio
/// and splitmix64).
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a hash keeps whatever bits there are"
)]
fn hash(level: i32, cell: I64Vec3) -> usize {
    let mut word = level as u64;
    for part in [cell.x, cell.y, cell.z] {
        word = (word ^ part as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        word ^= word >> 32;
    }
    word = word.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (word ^ word >> 29) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cloud(surfels: &[(Vec3, Vec3, f32)]) -> SurfelCloud {
        SurfelCloud {
            position: surfels.iter().map(|s| s.0).collect(),
            normal: surfels.iter().map(|s| s.1.normalize()).collect(),
            radius: surfels.iter().map(|s| s.2).collect(),
            ..SurfelCloud::default()
        }
    }

    fn all(cloud: &SurfelCloud, position: Vec3, normal: Vec3) -> Option<u32> {
        let count = u32::try_from(cloud.len()).unwrap();
        (0..count)
            .map(|i| (squared_distance(cloud, i, position, normal), i))
            .filter(|(distance, _)| distance.is_finite())
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            .map(|(_, i)| i)
    }

    fn vector(size: f32) -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-size..size).prop_map(Vec3::from)
    }

    proptest! {
        #[test]
        fn finds_what_a_search_of_all_surfels_finds(
            surfels in prop::collection::vec((vector(1.0), vector(1.0), -8.0_f32..-1.0), 1..200),
            position in vector(1.2),
            normal in vector(1.0),
        ) {
            let surfels: Vec<_> = surfels.into_iter()
                .map(|(p, n, r)| (p, n + Vec3::splat(1e-3), r.exp2()))
                .collect();
            let cloud = cloud(&surfels);
            let map = NearestMap::new(&cloud);
            prop_assert_eq!(map.surfel_at(&cloud, position, normal), all(&cloud, position, normal));
        }
    }

    #[test]
    fn sides_of_a_thin_wall_are_told_apart_by_their_normals() {
        let cloud = cloud(&[(Vec3::ZERO, Vec3::Z, 1.0), (Vec3::ZERO, -Vec3::Z, 1.0)]);
        let map = NearestMap::new(&cloud);
        assert_eq!(map.surfel_at(&cloud, Vec3::ZERO, Vec3::Z), Some(0));
        assert_eq!(map.surfel_at(&cloud, Vec3::ZERO, -Vec3::Z), Some(1));
        assert_eq!(map.surfel_at(&cloud, Vec3::X * 2.1, Vec3::Z), None);
    }

    #[test]
    fn the_surface_that_a_point_lies_on_wins_over_a_parallel_one() {
        let cloud = cloud(&[
            (Vec3::new(0.0, 0.0, 0.3), Vec3::Z, 1.0),
            (Vec3::new(0.9, 0.0, 0.0), Vec3::Z, 1.0),
        ]);
        let map = NearestMap::new(&cloud);
        assert_eq!(map.surfel_at(&cloud, Vec3::ZERO, Vec3::Z), Some(1));
    }

    #[test]
    fn empty_clouds_and_broken_positions_find_nothing() {
        let empty = SurfelCloud::default();
        assert_eq!(
            NearestMap::new(&empty).surfel_at(&empty, Vec3::ZERO, Vec3::Z),
            None
        );
        let one = cloud(&[(Vec3::ZERO, Vec3::Z, 1.0)]);
        let map = NearestMap::new(&one);
        assert_eq!(map.surfel_at(&one, Vec3::NAN, Vec3::Z), None);
        assert_eq!(map.surfel_at(&one, Vec3::splat(f32::MAX), Vec3::Z), None);
    }
}
