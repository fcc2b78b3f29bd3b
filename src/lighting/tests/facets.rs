//! Coarse smooth meshes at the terminator.

use super::*;

/// A ball of few triangles with smooth normals, and points of its triangles.
fn coarse_ball() -> (Vec<[Vec3; 3]>, Vec<ShadePoint>) {
    let triangles = ball(3);
    let mut points = Vec::new();
    for corners in &triangles {
        let plane = (corners[1] - corners[0])
            .cross(corners[2] - corners[0])
            .normalize();
        for (u, v) in [(0.2, 0.2), (0.6, 0.2), (0.2, 0.6), (0.3, 0.35), (0.05, 0.9)] {
            let weights = Vec3::new(1.0 - u - v, u, v);
            let [a, b, c] = corners;
            let position = a * weights.x + b * weights.y + c * weights.z;
            let normal = position.normalize();
            let normals = corners.map(Vec3::normalize);
            points.push(ShadePoint {
                position,
                normal,
                geometric_normal: plane,
                smooth_offset: Some(smooth_offset(corners, &normals, weights, normal)),
                prim: None,
            });
        }
    }
    (triangles, points)
}

/// A sharp sun in a direction that no edge of [`coarse_ball`] has to do with.
fn slanted_sun() -> (Light, Vec3) {
    let to_sun = Vec3::new(0.3, 0.8, 0.5).normalize();
    let turn = Affine3A::from_quat(Quat::from_rotation_arc(Vec3::Z, to_sun));
    (light(LightKind::Distant { angle: 0.0 }, turn), to_sun)
}

#[test]
fn facets_of_a_coarse_smooth_ball_do_not_show_at_the_terminator() {
    let (triangles, points) = coarse_ball();
    let (sun, to_sun) = slanted_sun();
    let values = lit_by(sun.clone(), &triangles, LightSamples::default(), &points);
    let mut below = 0;
    for (value, point) in values.iter().zip(&points) {
        let cosine = point.normal.dot(to_sun).max(0.0);
        assert_near(*value, cosine, if cosine > 0.0 { 1e-5 } else { 0.0 });
        below += usize::from(cosine > 0.0 && point.geometric_normal.dot(to_sun) < 0.0);
    }
    assert!(below >= 4, "{below} points are lit from below their planes");
    let flat: Vec<_> = (points.iter())
        .map(|point| ShadePoint {
            smooth_offset: None,
            prim: None,
            ..*point
        })
        .collect();
    let dark = lit_by(sun, &triangles, LightSamples::default(), &flat);
    assert_ne!(dark, values);
}

#[test]
fn light_does_not_leak_through_what_touches_a_coarse_smooth_ball() {
    // a sheet that cuts the ball a little above its terminator: below it all is dark
    let (mut triangles, points) = coarse_ball();
    let (sun, to_sun) = slanted_sun();
    let frame = crate::math::Frame::about(to_sun);
    let (a, b) = (frame.tangent * 9.0, frame.normal.cross(frame.tangent) * 9.0);
    triangles.extend(quad(
        to_sun * 0.05 - a - b,
        to_sun * 0.05 + a - b,
        to_sun * 0.05 + a + b,
        to_sun * 0.05 - a + b,
    ));
    let below: Vec<_> = (points.into_iter())
        .filter(|point| point.position.dot(to_sun) < 0.045)
        .collect();
    let facing_sun = |point: &&ShadePoint| point.normal.dot(to_sun) > 0.0;
    assert!(below.iter().filter(facing_sun).count() > 3);
    let values = lit_by(sun, &triangles, LightSamples::default(), &below);
    assert!(values.iter().all(|value| *value == Vec3::ZERO));
}

#[test]
fn the_smooth_surface_over_a_triangle_of_a_sphere_is_near_the_sphere_and_hollow_ones_have_none() {
    let corners = [Vec3::X, Vec3::Y, Vec3::Z];
    let third = Vec3::splat(1.0 / 3.0);
    let up = third.normalize();
    let offset = smooth_offset(&corners, &corners, third, up);
    let height = (third + offset).length();
    assert!(offset.normalize().dot(up) > 0.999 && (0.9..1.3).contains(&height));
    let hollow = smooth_offset(&corners, &corners.map(|n| -n), third, -up);
    assert_eq!(hollow, Vec3::ZERO);
    let at_corner = smooth_offset(&corners, &corners, Vec3::Y, Vec3::Y);
    assert_eq!(at_corner, Vec3::ZERO);
}
