//! Low-discrepancy point sets and their mapping to directions.
//!
//! [`fibonacci`] is the set of choice where a fixed number of points is known beforehand, [`sobol_owen`] where sets
//! of any size, or several independent ones, are needed. [`cosine_hemisphere`] and [`spiral_sphere`] make directions
//! of them, [`transported_frame`] turns a hemisphere so that it follows a normal without seams.

use super::Frame;
use glam::{Vec2, Vec3};
use std::f32::consts::TAU;

/// 2³² divided by the golden ratio, rounded to odd: `i · GOLDEN` in wrapping arithmetic is the fraction of `i/φ`.
const GOLDEN: u32 = 0x9E37_79B9;

/// 2⁻³², which makes the fractions of 32-bit fixed point.
const FIXED: f64 = 1.0 / 4_294_967_296.0;

/// The largest f32 below 1: rounding must not lift a fraction out of [0, 1).
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Point `i` of `count` of the Fibonacci lattice, in [0, 1)²: x is stratified at the middle of `count` equal intervals,
/// y follows the golden ratio, exact for any `i` (fixed point). A rank-1 lattice whenever `count` is a Fibonacci number,
/// and of the same quality (discrepancy O(log n / n)) in between.
pub fn fibonacci(i: u32, count: u32) -> Vec2 {
    let x = (f64::from(i) + 0.5) / f64::from(count.max(1));
    Vec2::new(below_one(x), fraction(i.wrapping_mul(GOLDEN)))
}

/// Point `i` of the two-dimensional Sobol' sequence, Owen-scrambled with `seed`, in [0, 1)².
///
/// Every run of 2^k points from a multiple of 2^k has one point in each of its dyadic boxes of area 2⁻ᵏ; different
/// seeds give independent sets. B. Burley, *Practical Hash-based Owen Scrambling* (JCGT 2020).
pub fn sobol_owen(i: u32, seed: u32) -> Vec2 {
    let shuffled = owen(i, hash(seed));
    let x = owen(shuffled.reverse_bits(), hash(seed ^ 0x68BC_21EB));
    let y = owen(sobol_second(shuffled), hash(seed ^ 0x02E5_BE93));
    Vec2::new(fraction(x), fraction(y))
}

/// Direction about +Z for `point` in [0, 1)², distributed with density cos θ / π: x is the squared sine of the angle to
/// Z, y the azimuth in turns. Equal areas of the square become equal areas of the unit disk below.
///
/// Of the two equal-area maps this polar one suits [`fibonacci`]: the points become a sunflower spiral without the
/// concentric map's creases along the diagonals. Measured in a box with two spheres over 250 receivers, error of the
/// irradiance: 1024 points 0.30 % (concentric 0.35 %), 4096 points 0.105 % (0.118 %), 256 points 0.88 % (0.82 %).
pub fn cosine_hemisphere(point: Vec2) -> Vec3 {
    let (sin, cos) = (TAU * point.y).sin_cos();
    let radius = point.x.sqrt();
    Vec3::new(radius * cos, radius * sin, (1.0 - point.x).sqrt())
}

/// Direction `i` of `count` evenly spread over the whole sphere: a spiral about Z with the golden angle between
/// neighbors. Each stands for 4π/`count` sr.
pub fn spiral_sphere(i: u32, count: u32) -> Vec3 {
    let point = fibonacci(i, count);
    let z = 1.0 - 2.0 * point.x;
    let (sin, cos) = (TAU * point.y).sin_cos();
    let radius = 2.0 * (point.x * (1.0 - point.x)).sqrt();
    Vec3::new(radius * cos, radius * sin, z)
}

/// The pole that [`transported_frame`] turns to the normal. Its opposite, the only normal about which frames are not
/// continuous, lies away from the axes and planes of symmetry where walls and objects have their normals.
const POLE: Frame = Frame {
    tangent: Vec3::new(0.8, 0.0, 0.6),
    bitangent: Vec3::new(0.36, 0.8, -0.48),
    normal: Vec3::new(-0.48, 0.6, 0.64),
};

/// Closer to the pole's opposite than this, squared and in radians, f32 no longer tells the azimuth of the turn.
const OPPOSITE: f32 = 1e-8;

/// Frame about the unit vector `normal`, turned there from one fixed pole by the shortest way.
///
/// Continuous in the normal everywhere but at one point (no frame can do better), so that a pattern of directions shows
/// no seam on smooth surfaces; [`Frame::about`] is faster but flips along a great circle.
pub fn transported_frame(normal: Vec3) -> Frame {
    let middle = POLE.normal + normal;
    let length_squared = middle.length_squared();
    if length_squared < OPPOSITE {
        return Frame {
            tangent: POLE.tangent,
            bitangent: normal.cross(POLE.tangent),
            normal,
        };
    }
    // The turn is a reflection of `v` at the pole's plane (no change, v lies in it) and at the middle's plane.
    let scale = -2.0 / length_squared;
    let turned = POLE.tangent + middle * (scale * POLE.tangent.dot(middle));
    // Close to the pole's opposite the rounding of `normal` has grown: make it a frame again.
    let tangent = (turned - normal * normal.dot(turned)).normalize_or(POLE.tangent);
    Frame {
        tangent,
        bitangent: normal.cross(tangent),
        normal,
    }
}

/// `bits / 2³²`, in [0, 1).
fn fraction(bits: u32) -> f32 {
    below_one(f64::from(bits) * FIXED)
}

/// `x` in [0, 1) as f32, still in [0, 1).
#[expect(
    clippy::cast_possible_truncation,
    reason = "rounding of a fraction is meant"
)]
fn below_one(x: f64) -> f32 {
    (x as f32).min(BELOW_ONE)
}

/// Second coordinate of Sobol' point `i`: its generator matrix is Pascal's triangle modulo 2.
fn sobol_second(i: u32) -> u32 {
    let mut column = 1_u32 << 31;
    let mut value = 0;
    let mut rest = i;
    while rest != 0 {
        if rest & 1 != 0 {
            value ^= column;
        }
        column ^= column >> 1;
        rest >>= 1;
    }
    value
}

/// Owen scrambling of the binary fraction `bits`: every digit is flipped depending on those before it. Laine–Karras
/// permutation with the constants of N. Vegdahl, *Building a Better LK Hash* (2021).
fn owen(bits: u32, seed: u32) -> u32 {
    let mut x = bits.reverse_bits();
    x ^= x.wrapping_mul(0x3D20_ADEA);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6C56);
    x ^= x.wrapping_mul(0x53A2_2864);
    x.reverse_bits()
}

/// A well mixed number for `x` (the finalizer of `MurmurHash3`).
pub fn hash(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x85EB_CA6B);
    let x = (x ^ (x >> 13)).wrapping_mul(0xC2B2_AE35);
    x ^ (x >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest deviation of the share of points in a box [0,x)×[0,y) from its area, over a grid of boxes.
    fn star_discrepancy(points: &[Vec2]) -> f64 {
        let steps = 64;
        let mut worst = 0.0_f64;
        for (a, b) in (1..=steps).flat_map(|a| (1..=steps).map(move |b| (a, b))) {
            let (x, y) = (a as f32 / steps as f32, b as f32 / steps as f32);
            let inside = points.iter().filter(|p| p.x < x && p.y < y).count();
            worst = worst
                .max((inside as f64 / points.len() as f64 - f64::from(x) * f64::from(y)).abs());
        }
        worst
    }

    #[test]
    fn discrepancy_is_far_below_that_of_random_points() {
        // Random points: about 1/sqrt(n) = 0.031 at 1024; the bound log(n)/n is 0.0068.
        let n = 1024;
        let lattice: Vec<_> = (0..n).map(|i| fibonacci(i, n)).collect();
        assert!(star_discrepancy(&lattice) < 0.004);
        for seed in 0..4 {
            let sobol: Vec<_> = (0..n).map(|i| sobol_owen(i, seed)).collect();
            assert!(star_discrepancy(&sobol) < 0.0068, "seed {seed}");
        }
    }

    #[test]
    fn every_dyadic_box_of_the_scrambled_net_holds_one_point() {
        let bits = 8;
        for seed in [0, 1, 77] {
            for x_bits in 0..=bits {
                let mut seen = vec![0; 1 << bits];
                for i in 0..1 << bits {
                    let p = sobol_owen(i, seed);
                    let digits = |x: f32, count: u32| -> usize {
                        (0..1 << count)
                            .rposition(|k| x >= k as f32 / (1 << count) as f32)
                            .unwrap()
                    };
                    seen[(digits(p.y, bits - x_bits) << x_bits) + digits(p.x, x_bits)] += 1;
                }
                assert!(seen.iter().all(|&count| count == 1), "{seed} {x_bits}");
            }
        }
    }

    #[test]
    fn seeds_give_different_sets() {
        let same = (0..256)
            .filter(|&i| sobol_owen(i, 1) == sobol_owen(i, 2))
            .count();
        assert!(same < 3);
    }

    #[test]
    fn points_stay_inside_the_unit_square() {
        for i in [0, 1, u32::MAX - 1, u32::MAX] {
            for p in [fibonacci(i, u32::MAX), sobol_owen(i, 5), fibonacci(0, 1)] {
                assert!((0.0..1.0).contains(&p.x) && (0.0..1.0).contains(&p.y));
            }
        }
    }

    #[test]
    fn cosine_directions_integrate_the_first_spherical_harmonics_over_the_hemisphere() {
        // ∫ f cos θ dω over the hemisphere: z → 2π/3, z² → π/2, x² → π/4, and 0 for all odd in x or y.
        let n = 1024;
        let mean = |f: &dyn Fn(Vec3) -> f32| {
            (0..n)
                .map(|i| f64::from(f(cosine_hemisphere(fibonacci(i, n)))))
                .sum::<f64>()
                / f64::from(n)
        };
        let tolerance = 1e-3; // measured below 5e-4; random directions would miss it by 0.02
        assert!((mean(&|d| d.z) - 2.0 / 3.0).abs() < tolerance);
        assert!((mean(&|d| d.z * d.z) - 0.5).abs() < tolerance);
        assert!((mean(&|d| d.x * d.x) - 0.25).abs() < tolerance);
        assert!((mean(&|d| d.y * d.y) - 0.25).abs() < tolerance);
        for odd in [
            mean(&|d| d.x),
            mean(&|d| d.y),
            mean(&|d| d.x * d.y),
            mean(&|d| d.x * d.z),
            mean(&|d| d.y * d.z),
        ] {
            assert!(odd.abs() < tolerance, "{odd}");
        }
        for i in 0..n {
            let d = cosine_hemisphere(fibonacci(i, n));
            assert!((d.length() - 1.0).abs() < 1e-6 && d.z > 0.0);
        }
    }

    #[test]
    fn spiral_directions_are_balanced_and_isotropic() {
        let n = 512;
        let (mut first, mut second) = (Vec3::ZERO, glam::Mat3::ZERO);
        for i in 0..n {
            let d = spiral_sphere(i, n);
            assert!((d.length() - 1.0).abs() < 1e-6);
            first += d / n as f32;
            second += glam::Mat3::from_cols(d * d.x, d * d.y, d * d.z) * (1.0 / n as f32);
        }
        assert!(first.length() < 2e-3, "{first}");
        let third = glam::Mat3::from_diagonal(Vec3::splat(1.0 / 3.0));
        assert!(second.abs_diff_eq(third, 2e-3), "{second}");
    }

    #[test]
    fn transported_frames_are_orthonormal_for_all_normals() {
        for normal in (0..2000)
            .map(|i| spiral_sphere(i, 2000))
            .chain([POLE.normal, -POLE.normal])
            .chain((0..40).map(|k| {
                let off = 10.0_f32.powf(-8.0 + 0.2 * k as f32);
                (-POLE.normal + off * POLE.tangent + 0.3 * off * POLE.bitangent).normalize()
            }))
        {
            let f = transported_frame(normal);
            assert!((f.tangent.length() - 1.0).abs() < 1e-5, "{normal} {f:?}");
            assert!(f.tangent.dot(normal).abs() < 1e-3, "{normal} {f:?}");
            assert!(f.tangent.cross(f.bitangent).dot(normal) > 0.999_99);
        }
    }

    #[test]
    fn transported_frames_turn_no_faster_than_the_normal_allows() {
        // Parallel transport from the pole: the tangent turns by at most tan(θ/2) + 1 times the normal's turn.
        let steps = 20_000;
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            let circle = Frame::about(axis);
            let normal = |k: i32| {
                let (sin, cos) = (TAU * k as f32 / steps as f32).sin_cos();
                circle.tangent * cos + circle.bitangent * sin
            };
            for k in 0..steps {
                let (a, b) = (normal(k), normal(k + 1));
                let turn = transported_frame(a)
                    .tangent
                    .distance(transported_frame(b).tangent);
                let half = 0.5 * POLE.normal.dot(a).clamp(-1.0, 1.0).acos();
                assert!(turn < 1.2 * (1.0 + half.tan()) * TAU / steps as f32 + 1e-6);
            }
        }
    }
}
