//! Fixed sample patterns: the same for all receivers, so that errors never show as noise.

use glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// `count` points (rounded up to a power of four, so that the first quarter is stratified too) of the unit square: Sobol's
/// (0, 2)-sequence, moved to the middle of its cells.
pub(super) fn square(count: u32) -> Vec<Vec2> {
    sobol(power_of_four(count))
}

fn sobol(count: u32) -> Vec<Vec2> {
    #[expect(clippy::cast_precision_loss, reason = "at most 2^20 points")]
    let half_cell = 0.5 / count as f32;
    (0..count)
        .map(|i| Vec2::new(fraction(i.reverse_bits()), fraction(sobol_second(i))) + half_cell)
        .collect()
}

/// The same points, those of the first quarter and then the others, each from left to right: neighbors of a run of sources
/// follow each other.
pub(super) fn picks(count: u32) -> Vec<Vec2> {
    let mut picks = square(count);
    let count = picks.len();
    let (quarter, rest) = picks.split_at_mut(quarter_of(count));
    for part in [quarter, rest] {
        part.sort_by(|a, b| a.x.total_cmp(&b.x));
    }
    picks
}

/// 2^`power` points as [`square`] has them, each sixteen of a small rectangle together.
pub(super) fn blocks(power: u32) -> Vec<Vec2> {
    let mut all = sobol(1 << power);
    let blocks = power.saturating_sub(4);
    let (columns, rows) = (blocks / 2, blocks - blocks / 2);
    #[expect(clippy::cast_precision_loss, reason = "a power of two")]
    let [across, along] = [columns, rows].map(|power| (1_u32 << power) as f32);
    let block = |p: &Vec2| (p.x * across).floor() * along + (p.y * along).floor();
    all.sort_by(|a, b| block(a).total_cmp(&block(b)));
    all
}

/// Of so many picks those that are looked at first.
pub(super) fn quarter_of(count: usize) -> usize {
    count.div_ceil(4)
}

/// So far inside of the rim lie places along it, of the square's side: there is always something of the light around them.
const INSET: f32 = 1.0 / 256.0;

/// `4 · side` places along the rim of the unit square, its corners among them.
pub(super) fn rim(side: u16) -> Vec<Vec2> {
    let (low, high) = (Vec2::splat(INSET), Vec2::splat(1.0 - INSET));
    let corners = [
        low,
        Vec2::new(high.x, low.y),
        high,
        Vec2::new(low.x, high.y),
    ];
    let edges = corners.into_iter().zip(corners.into_iter().cycle().skip(1));
    edges
        .flat_map(|(from, to)| {
            (0..side).map(move |i| from.lerp(to, f32::from(i) / f32::from(side)))
        })
        .collect()
}

/// `count` places of the unit square that lie along the rim of a [`disk`].
pub(super) fn circle(count: u16) -> Vec<Vec2> {
    let turn = |i: u16| (f32::from(i) + 0.5) / f32::from(count);
    (0..count)
        .map(|i| Vec2::new(1.0 - INSET, turn(i)))
        .collect()
}

/// The middles of `side × side` squares: for smooth integrands, far better than [`square`].
pub(super) fn grid(side: u16) -> Vec<Vec2> {
    let middle = |i: u16| (f32::from(i) + 0.5) / f32::from(side);
    (0..side)
        .flat_map(|y| (0..side).map(move |x| Vec2::new(middle(x), middle(y))))
        .collect()
}

/// `count` cosine-weighted unit directions about +Z, ordered like [`square`].
pub(super) fn hemisphere(count: u32) -> Vec<Vec3> {
    (square(count).into_iter())
        .map(|p| {
            let disk = disk(p);
            disk.extend((1.0 - p.x).max(0.0).sqrt())
        })
        .collect()
}

/// The unit square to the unit disk, equal areas: `x` is the squared radius, `y` the angle.
pub(super) fn disk(p: Vec2) -> Vec2 {
    Vec2::from_angle(TAU * p.y) * p.x.sqrt()
}

/// `count` directions spread evenly over the sphere (spherical Fibonacci lattice).
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "angles in f64, then rounded"
)]
pub(super) fn sphere(count: usize) -> Vec<Vec3> {
    const GOLDEN_FRACTION: f64 = 0.618_033_988_749_894_9;
    (0..count)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
            let angle = std::f64::consts::TAU * (i as f64 * GOLDEN_FRACTION).fract();
            let radius = (1.0 - z * z).sqrt();
            Vec3::new(
                (radius * angle.cos()) as f32,
                (radius * angle.sin()) as f32,
                z as f32,
            )
        })
        .collect()
}

/// The next power of four, at most 4^10.
fn power_of_four(count: u32) -> u32 {
    (0..10)
        .map(|k| 4_u32.pow(k))
        .find(|&n| n >= count)
        .unwrap_or(1 << 20)
}

#[expect(clippy::cast_precision_loss, reason = "24 bits are kept")]
fn fraction(bits: u32) -> f32 {
    (bits >> 8) as f32 / (1 << 24) as f32
}

/// Second dimension of Sobol's sequence (the first is the van der Corput sequence).
fn sobol_second(mut index: u32) -> u32 {
    let (mut direction, mut bits) = (1_u32 << 31, 0);
    while index != 0 {
        if index & 1 == 1 {
            bits ^= direction;
        }
        index >>= 1;
        direction ^= direction >> 1;
    }
    bits
}

#[cfg(test)]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "numbers of tests are small"
)]
mod tests {
    use super::*;

    #[test]
    fn every_row_column_and_square_cell_holds_one_point_also_in_the_first_quarter() {
        let points = square(200);
        assert_eq!(points.len(), 256);
        for (count, side) in [(64_usize, 8_usize), (256, 16)] {
            let mut cells = vec![0; count];
            let mut rows = vec![0; count];
            for p in &points[..count] {
                cells[(p.x * side as f32) as usize * side + (p.y * side as f32) as usize] += 1;
                rows[(p.y * count as f32) as usize] += 1;
            }
            assert!(cells.iter().chain(&rows).all(|&n| n == 1));
        }
    }

    #[test]
    fn hemisphere_directions_are_unit_and_their_mean_cosine_is_two_thirds() {
        let directions = hemisphere(1024);
        let mean: f32 = directions.iter().map(|d| d.z).sum::<f32>() / 1024.0;
        assert!((mean - 2.0 / 3.0).abs() < 1e-4);
        assert!(directions.iter().all(|d| (d.length() - 1.0).abs() < 1e-6));
    }
}
