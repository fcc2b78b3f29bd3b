//! Solid angles, their first moments and form factors in closed form, in the shapes that do not cancel.
//!
//! The first moment ∫ω dω of a patch of directions, dotted with a normal, is its cosine-weighted solid angle (exact
//! for every normal that the whole patch faces); divided by π it is a form factor. Lambert's contour integral gives it
//! for polygons: Arvo, *Analytic Methods for Simulated Light Transport* (1995), §2.

use glam::DVec3;
use std::f32::consts::TAU;
use std::f64::consts::PI;

/// Solid angle (sr) of a disk of radius `r` seen from its axis at height `h ≥ 0`: 2π at `h = 0`, 0 for `r = 0`.
pub fn disk_solid_angle(h: f32, r: f32) -> f32 {
    if r <= 0.0 {
        return 0.0;
    }
    let slant = h.hypot(r);
    TAU * (r / slant) * (r / (slant + h))
}

/// Form factor (0…1) from a point to the disk of radius `r` at height `h` on the point's normal, facing it.
pub fn disk_form_factor(h: f32, r: f32) -> f32 {
    if r <= 0.0 {
        return 0.0;
    }
    (r / h.hypot(r)).powi(2)
}

/// Form factor (0…1) from a point to a sphere of radius `r` at `distance ≥ r`, whose center lies at the angle with
/// cosine `cos` from the point's normal. Exact while the whole sphere is above the horizon (`cos ≥ r/distance`).
pub fn sphere_form_factor(distance: f32, r: f32, cos: f32) -> f32 {
    (r / distance).powi(2) * cos
}

/// Solid angle (sr) of the spherical triangle of the unit vectors `a`, `b`, `c`; positive when they turn
/// counter-clockwise seen from outside the sphere. Van Oosterom and Strackee (1983).
pub fn triangle_solid_angle(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let volume = a.dot(b.cross(c));
    2.0 * volume.atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
}

/// First moment ∫ω dω of the directions inside the polygon `corners` (any lengths, none zero) seen from the origin.
/// Corners counter-clockwise seen from outside give a moment that points towards the polygon. Zero for fewer than 3.
pub fn polygon_moment(corners: &[DVec3]) -> DVec3 {
    let next = corners.iter().cycle().skip(1);
    corners
        .iter()
        .zip(next)
        .map(|(a, b)| edge_moment(*a, *b))
        .sum()
}

/// Half the angle between `a` and `b` times the unit normal of their plane; zero when they are parallel.
fn edge_moment(a: DVec3, b: DVec3) -> DVec3 {
    let cross = a.cross(b);
    let sin = cross.length();
    if sin == 0.0 {
        return DVec3::ZERO;
    }
    cross * (0.5 * sin.atan2(a.dot(b)) / sin)
}

/// Replace `clipped` by the part of polygon `corners` on the positive side of the plane through the origin with
/// normal `normal` (Sutherland-Hodgman); empty if nothing is left.
pub fn clip_to_horizon(corners: &[DVec3], normal: DVec3, clipped: &mut Vec<DVec3>) {
    clipped.clear();
    for (i, &a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % corners.len()];
        let (height_a, height_b) = (a.dot(normal), b.dot(normal));
        if height_a >= 0.0 {
            clipped.push(a);
        }
        if (height_a >= 0.0) != (height_b >= 0.0) {
            clipped.push(a + (b - a) * (height_a / (height_a - height_b)));
        }
    }
}

/// Form factor from the origin with unit `normal` to the polygon `corners`, the part under the horizon left out.
/// Positive for corners that turn counter-clockwise seen from outside; 1 for the whole hemisphere.
pub fn polygon_form_factor(corners: &[DVec3], normal: DVec3) -> f64 {
    let mut clipped = Vec::with_capacity(corners.len() + 1);
    clip_to_horizon(corners, normal, &mut clipped);
    polygon_moment(&clipped).dot(normal) / PI
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disk_seen_from_far_is_area_over_squared_distance() {
        for r in [1e-1_f32, 1e-3, 1e-5, 1e-18] {
            let omega = f64::from(disk_solid_angle(1.0, r));
            let r = f64::from(r);
            let exact = 2.0 * PI * r * r / ((1.0 + r * r).sqrt() * (1.0 + (1.0 + r * r).sqrt()));
            assert!((omega / exact - 1.0).abs() < 1e-6, "{r}");
        }
        assert_eq!(disk_solid_angle(0.0, 1.0), TAU);
        assert_eq!(disk_solid_angle(0.0, 0.0), 0.0);
        assert_eq!(disk_form_factor(0.0, 0.0), 0.0);
    }

    #[test]
    fn six_faces_of_the_cube_fill_the_sphere() {
        let s = 1.0 / 3.0_f64.sqrt();
        let [a, b, c, d] = [(-s, -s), (s, -s), (s, s), (-s, s)].map(|(x, y)| DVec3::new(x, y, s));
        let face = triangle_solid_angle(a, b, c) + triangle_solid_angle(a, c, d);
        assert!((6.0 * face - 4.0 * PI).abs() < 1e-12);
    }

    #[test]
    fn form_factor_of_a_parallel_square_equals_the_textbook_formula() {
        // Howell C-11: corner of an a × b rectangle above the point, at height h.
        let (a, b, h) = (0.7_f64, 1.9, 0.4);
        let (x, y) = (a / h, b / h);
        let (sx, sy) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        let exact = (x / sx * (y / sx).atan() + y / sy * (x / sy).atan()) / (2.0 * PI);
        let corners = [(0.0, 0.0), (a, 0.0), (a, b), (0.0, b)].map(|(x, y)| DVec3::new(x, y, h));
        assert!((polygon_form_factor(&corners, DVec3::Z) - exact).abs() < 1e-13);
    }

    #[test]
    fn tiny_and_near_polygons_agree_with_area_over_squared_distance() {
        for s in [1e-3, 1e-6] {
            let corners = [(-s, -s), (s, -s), (s, s), (-s, s)].map(|(x, y)| DVec3::new(x, y, 1.0));
            let moment = polygon_moment(&corners);
            assert!(
                (moment.z / (4.0 * s * s) - 1.0).abs() < 1e-4,
                "{s}: {moment}"
            );
        }
        assert_eq!(polygon_moment(&[]), DVec3::ZERO);
        assert_eq!(polygon_moment(&[DVec3::X, DVec3::X, DVec3::X]), DVec3::ZERO);
    }

    #[test]
    fn a_wall_that_crosses_the_horizon_counts_only_above_it() {
        // Vertical half plane x = 1 (very large): form factor ½ · (1 − cos 90°) = ½ from its foot at distance 1.
        let w = 1e7;
        let wall = [(-w, -w), (w, -w), (w, w), (-w, w)].map(|(y, z)| DVec3::new(1.0, y, z));
        assert!((polygon_form_factor(&wall, DVec3::Z) - 0.5).abs() < 1e-6);
        assert!(polygon_form_factor(&wall, -DVec3::X).abs() < 1e-12);
    }

    #[test]
    fn spheres_match_the_integral_over_their_cap() {
        let (distance, r, cos) = (3.0_f32, 1.0_f32, 0.8_f32);
        let half = f64::from(r / distance).asin();
        let n = 400;
        let mut sum = 0.0;
        let axis = DVec3::new(0.6, 0.0, 0.8);
        let (u, v) = (DVec3::new(0.8, 0.0, -0.6), DVec3::Y);
        for i in 0..n * n {
            let t = half * ((i / n) as f64 + 0.5) / n as f64;
            let p = 2.0 * PI * ((i % n) as f64 + 0.5) / n as f64;
            let d = axis * t.cos() + (u * p.cos() + v * p.sin()) * t.sin();
            sum += d.z.max(0.0) * t.sin() * (half / n as f64) * (2.0 * PI / n as f64);
        }
        assert!((f64::from(sphere_form_factor(distance, r, cos)) - sum / PI).abs() < 1e-5);
    }
}
