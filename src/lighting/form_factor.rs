//! Irradiance from unoccluded shapes of radiance 1, in closed form, clipped at the receiver's horizon.

use glam::DVec3;
use std::f64::consts::PI;

/// Irradiance from a plane figure of radiance 1: Lambert's formula (1760), a sum over its outline, which may have holes
/// and several parts. `edges` go counter-clockwise as seen from the receiver, relative to it; `plane_normal` is that of
/// the figure's plane, whose distance from the receiver must not be 0; `normal` is the receiver's. Never negative.
pub(super) fn outline_irradiance(
    edges: impl Iterator<Item = (DVec3, DVec3)>,
    plane_normal: DVec3,
    normal: DVec3,
) -> f64 {
    let mut sum = 0.0;
    for (from, to) in edges {
        let (height_from, height_to) = (normal.dot(from), normal.dot(to));
        if height_from <= 0.0 && height_to <= 0.0 {
            continue;
        }
        let (mut start, mut end) = (from, to);
        if height_from <= 0.0 || height_to <= 0.0 {
            let crossing = from.lerp(to, height_from / (height_from - height_to));
            let azimuth = azimuth_on_horizon(crossing, plane_normal, normal);
            if height_from <= 0.0 {
                start = crossing;
                sum += azimuth;
            } else {
                end = crossing;
                sum -= azimuth;
            }
        }
        sum += edge_term(start, end, normal);
    }
    (-0.5 * sum).max(0.0)
}

/// Angle of the edge seen from the origin, times the cosine between its great circle's axis and `normal`.
fn edge_term(from: DVec3, to: DVec3, normal: DVec3) -> f64 {
    let (cross, dot) = (from.cross(to), from.dot(to));
    let squared = cross.length_squared();
    if dot > 0.0 && squared <= SHORT * dot * dot {
        return arc_of_tangent(squared / (dot * dot)) / dot * normal.dot(cross);
    }
    let length = squared.sqrt();
    if length > 0.0 {
        length.atan2(dot) / length * normal.dot(cross)
    } else {
        0.0
    }
}

/// Square of the tangent up to which an angle is told by the first terms of its series, to 3·10⁻¹⁰ of it.
const SHORT: f64 = 0.04;

/// The arc over its tangent, whose square is `t` up to [`SHORT`].
fn arc_of_tangent(t: f64) -> f64 {
    1.0 - t * (1.0 / 3.0 - t * (1.0 / 5.0 - t * (1.0 / 7.0 - t * (1.0 / 9.0 - t / 11.0))))
}

/// Where the outline dips below the horizon, arcs of the horizon close it. All crossings lie on one straight line, so
/// that the arcs' signed lengths are differences of azimuths measured from the foot of that line.
fn azimuth_on_horizon(crossing: DVec3, plane_normal: DVec3, normal: DVec3) -> f64 {
    let level = plane_normal - normal * normal.dot(plane_normal);
    let foot = if level.dot(crossing) < 0.0 {
        -level
    } else {
        level
    };
    crossing.dot(normal.cross(foot)).atan2(crossing.dot(foot))
}

/// Irradiance from a round cap of the sky of radiance 1 and angular radius up to 90°: `sine` of its radius,
/// `cosine` of the angle between its center and the receiver's normal. Snyder, *Area Light Sources for Real-Time
/// Graphics* (1996).
pub(super) fn cap_irradiance(cosine: f64, sine: f64) -> f64 {
    let sine = sine.min(1.0);
    let squared = sine * sine;
    if cosine >= sine {
        return PI * squared * cosine;
    }
    if cosine <= -sine || sine == 0.0 {
        return 0.0;
    }
    let away = (1.0 - cosine * cosine).max(0.0).sqrt();
    let cotangent = (1.0 - squared).max(0.0).sqrt() / sine;
    if cotangent == 0.0 {
        // the cap is a hemisphere: a lune remains above the horizon
        return 0.5 * PI * (1.0 + cosine);
    }
    let y = (-cotangent * cosine / away).clamp(-1.0, 1.0);
    let side = away * (1.0 - y * y).sqrt();
    ((cosine * y.acos() - cotangent * side) * squared + (side / cotangent).atan()).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_edges_are_told_as_exactly_as_long_ones() {
        for tangent in [1e-9_f64, 1e-3, 0.1, 0.199, 0.2] {
            let series = arc_of_tangent(tangent * tangent) * tangent;
            assert!((series / tangent.atan() - 1.0).abs() < 4e-10, "{tangent}");
        }
        assert!(0.2_f64.powi(2) <= SHORT * (1.0 + 1e-15));
    }

    fn loop_of(points: &[DVec3]) -> Vec<(DVec3, DVec3)> {
        (0..points.len())
            .map(|i| (points[i], points[(i + 1) % points.len()]))
            .collect()
    }

    fn rectangle(x: [f64; 2], y: [f64; 2], z: f64) -> Vec<DVec3> {
        // counter-clockwise seen from below (the origin)
        vec![
            DVec3::new(x[0], y[0], z),
            DVec3::new(x[0], y[1], z),
            DVec3::new(x[1], y[1], z),
            DVec3::new(x[1], y[0], z),
        ]
    }

    /// Sum over a fine grid of the rectangle.
    fn brute_force(x: [f64; 2], y: [f64; 2], z: f64, normal: DVec3) -> f64 {
        let n = 1000;
        let mut sum = 0.0;
        for i in 0..n {
            for j in 0..n {
                let p = DVec3::new(
                    x[0] + (x[1] - x[0]) * (i as f64 + 0.5) / n as f64,
                    y[0] + (y[1] - y[0]) * (j as f64 + 0.5) / n as f64,
                    z,
                );
                let d2 = p.length_squared();
                sum += normal.dot(p).max(0.0) * z / (d2 * d2);
            }
        }
        sum * (x[1] - x[0]) * (y[1] - y[0]) / (n * n) as f64
    }

    #[test]
    fn rectangle_over_its_corner_has_the_textbook_form_factor() {
        // Howell, catalog of configuration factors, B-4: element parallel to a rectangle, normal through a corner
        let (a, b, c) = (0.7, 1.3, 0.9);
        let (x, y): (f64, f64) = (a / c, b / c);
        let (p, q) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        let truth = (x / p * (y / p).atan() + y / q * (x / q).atan()) / (2.0 * PI);
        let edges = loop_of(&rectangle([0.0, a], [0.0, b], c));
        let irradiance = outline_irradiance(edges.into_iter(), DVec3::Z, DVec3::Z);
        assert!((irradiance / PI - truth).abs() < 1e-14);
    }

    #[test]
    fn rectangles_across_the_horizon_equal_brute_force() {
        for normal in [
            DVec3::X,
            DVec3::new(1.0, 0.3, -0.4).normalize(),
            DVec3::new(-0.2, 1.0, 0.5).normalize(),
            DVec3::new(0.1, -0.2, -1.0).normalize(),
        ] {
            let (x, y, z) = ([-0.8, 1.1], [-0.5, 0.9], 0.6);
            let edges = loop_of(&rectangle(x, y, z));
            let irradiance = outline_irradiance(edges.into_iter(), DVec3::Z, normal);
            let truth = brute_force(x, y, z, normal);
            assert!(
                (irradiance - truth).abs() < 1e-5,
                "{normal}: {irradiance} {truth}"
            );
        }
    }

    #[test]
    fn a_figure_with_a_hole_is_the_difference_also_across_the_horizon() {
        let normal = DVec3::new(0.9, 0.2, 0.1).normalize();
        let outer = loop_of(&rectangle([-1.0, 1.0], [-1.0, 1.0], 0.5));
        let mut hole = rectangle([-0.4, 0.5], [-0.3, 0.6], 0.5);
        let inner = loop_of(&hole);
        hole.reverse();
        let both = outer.iter().copied().chain(loop_of(&hole));
        let sum = outline_irradiance(both, DVec3::Z, normal);
        let of =
            |edges: &[(DVec3, DVec3)]| outline_irradiance(edges.iter().copied(), DVec3::Z, normal);
        assert!((sum - (of(&outer) - of(&inner))).abs() < 1e-14);
    }

    #[test]
    fn caps_equal_brute_force_above_across_and_below_the_horizon() {
        for radius in [0.01_f64, 0.3, 1.0, 1.5] {
            for angle in [0.0_f64, 0.5, 1.3, 1.5, 1.6, 2.0, 3.0] {
                let n = 1500;
                let mut truth = 0.0;
                for i in 0..n {
                    let polar = radius * (i as f64 + 0.5) / n as f64;
                    for j in 0..n {
                        let around = 2.0 * PI * (j as f64 + 0.5) / n as f64;
                        let cosine =
                            angle.cos() * polar.cos() + angle.sin() * polar.sin() * around.cos();
                        truth += cosine.max(0.0) * polar.sin();
                    }
                }
                truth *= radius / n as f64 * 2.0 * PI / n as f64;
                let irradiance = cap_irradiance(angle.cos(), radius.sin());
                let tolerance = 1e-5 * radius * radius;
                assert!(
                    (irradiance - truth).abs() < tolerance,
                    "{radius} {angle}: {irradiance} {truth}"
                );
            }
        }
    }
}
