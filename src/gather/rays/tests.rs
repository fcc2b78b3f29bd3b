//! Shapes in closed form, seen by rays.

use super::*;
use crate::gather::quantities::occlusion::occlusion;
use crate::gather::testing::{Shape, Shapes, receivers_at};
use crate::math::Frame;

fn occlusions(shapes: &Shapes, receivers: &Receivers, settings: RaysSettings) -> Vec<f32> {
    let engine = RaysEngine::with_query(shapes, None, settings);
    let mut out = Vec::new();
    engine.see(
        receivers,
        0..receivers.len(),
        &mut Hemisphere::default(),
        &mut |_, seen| out.push(occlusion(seen)),
    );
    out
}

#[test]
fn a_sphere_above_the_horizon_covers_its_configuration_factor() {
    // cos θ · (r/d)², for any sphere wholly above the horizon.
    let (radius, distance) = (0.5, 1.25);
    let shapes = Shapes(vec![Shape::Sphere {
        center: Vec3::ZERO,
        radius,
    }]);
    for tilt in [0.0_f32, 0.4, 0.9] {
        for azimuth in 0..12 {
            let away = Frame::about(sequence::spiral_sphere(azimuth, 12));
            let position = away.normal * -distance;
            let normal = away.normal * tilt.cos() + away.tangent * tilt.sin();
            let receivers = receivers_at(&[(position, normal)]);
            let got = occlusions(&shapes, &receivers, RaysSettings::default())[0];
            let exact = tilt.cos() * (radius / distance).powi(2);
            assert!((got - exact).abs() < 0.006, "{tilt}: {got} {exact}");
        }
    }
}

#[test]
fn error_falls_almost_linearly_with_the_number_of_rays() {
    let shapes = Shapes(vec![Shape::Sphere {
        center: Vec3::ZERO,
        radius: 0.5,
    }]);
    let points: Vec<_> = (0..200)
        .map(|i| {
            let away = sequence::spiral_sphere(i, 200);
            (away * -1.25, away)
        })
        .collect();
    let receivers = receivers_at(&points);
    let error = |rays| {
        let settings = RaysSettings {
            rays,
            ..RaysSettings::default()
        };
        let values = occlusions(&shapes, &receivers, settings);
        (values.iter().map(|x| (x - 0.16).powi(2)).sum::<f32>() / 200.0).sqrt() / 0.84
    };
    // Random rays: 1.4 %, 0.34 %.
    let (coarse, fine) = (error(1024), error(16384));
    assert!(coarse < 0.004 && fine < 0.0006, "{coarse} {fine}");
}

#[test]
fn a_coaxial_disk_covers_its_form_factor_and_an_enclosure_everything() {
    let disk = Shapes(vec![Shape::Disk {
        center: Vec3::Y,
        normal: Vec3::Y,
        radius: 2.0,
    }]);
    let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
    let got = occlusions(&disk, &receivers, RaysSettings::default())[0];
    assert!((got - 4.0 / 5.0).abs() < 1e-3, "{got}"); // r²/(r²+h²)
    let enclosure = Shapes(vec![Shape::Sphere {
        center: Vec3::ZERO,
        radius: 9.0,
    }]);
    let got = occlusions(&enclosure, &receivers, RaysSettings::default())[0];
    assert!((got - 1.0).abs() < 1e-6);
    let near = RaysSettings {
        max_distance: Some(8.9),
        ..RaysSettings::default()
    };
    assert_eq!(occlusions(&enclosure, &receivers, near)[0], 0.0);
}

#[test]
fn weights_sum_to_pi_for_any_number_of_rays() {
    for rays in [0, 1, 7, 1024] {
        let settings = RaysSettings {
            rays,
            ..RaysSettings::default()
        };
        let shapes = Shapes(Vec::new());
        let engine = RaysEngine::with_query(&shapes, None, settings);
        let receivers = receivers_at(&[(Vec3::ZERO, Vec3::X)]);
        engine.see(
            &receivers,
            0..1,
            &mut Hemisphere::default(),
            &mut |_, seen| {
                assert!((seen.weight.iter().sum::<f32>() - PI).abs() < 1e-4);
                assert!(seen.distance.iter().all(|d| d.is_infinite()));
            },
        );
    }
}

#[test]
fn values_have_no_seam_where_normals_cross_the_coordinate_planes() {
    let toward = Vec3::new(3.0, 2.0, 1.0);
    let shapes = Shapes(vec![Shape::Disk {
        center: toward,
        normal: toward.normalize(),
        radius: 2.0,
    }]);
    let off = 1e-6;
    let mut points = Vec::new();
    for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
        let circle = Frame::about(axis);
        for k in 0..100 {
            let (sin, cos) = (k as f32 * PI / 50.0).sin_cos();
            let normal = circle.tangent * cos + circle.bitangent * sin;
            points.push((Vec3::ZERO, (normal + off * axis).normalize()));
            points.push((Vec3::ZERO, (normal - off * axis).normalize()));
        }
    }
    let values = occlusions(&shapes, &receivers_at(&points), RaysSettings::default());
    for pair in values.chunks_exact(2) {
        // One ray may change sides; a frame that flips changes several.
        assert!((pair[0] - pair[1]).abs() < 1.5 / 1024.0, "{pair:?}");
    }
}

#[test]
fn a_tilted_shading_normal_sees_neither_its_own_plane_nor_anything_less_of_the_sky() {
    // A large ground of which the receiver's triangle is a part.
    let ground = Shapes(vec![Shape::Disk {
        center: Vec3::ZERO,
        normal: Vec3::Y,
        radius: 1e3,
    }]);
    let mut receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
    receivers.normal[0] = Vec3::new(0.5, 1.0, 0.0).normalize();
    let inside = occlusions(&ground, &receivers, RaysSettings::default())[0];
    assert_eq!(inside, 0.0);
    // At a vertex the rays find out: the ground's far part lies below this share of the tilted hemisphere.
    (receivers.surface[0].u, receivers.surface[0].v) = (1.0, 0.0);
    let rim = occlusions(&ground, &receivers, RaysSettings::default())[0];
    let exact = 0.5 * (1.0 - receivers.normal[0].y);
    assert!((rim - exact).abs() < 3.0 / 1024.0, "{rim} {exact}");
}

#[test]
fn what_a_receiver_sees_does_not_depend_on_those_seen_with_it() {
    let shapes = Shapes(vec![
        Shape::Sphere {
            center: Vec3::new(0.3, 0.9, 0.1),
            radius: 0.5,
        },
        Shape::Disk {
            center: Vec3::new(-1.5, 0.0, 0.0),
            normal: Vec3::X,
            radius: 2.0,
        },
    ]);
    let points: Vec<_> = (0..150)
        .map(|i| {
            let away = sequence::spiral_sphere(i, 150);
            (away * 0.2, away)
        })
        .collect();
    let mut receivers = receivers_at(&points);
    for (i, normal) in receivers.normal.iter_mut().enumerate() {
        // Some stand on facets, whose plane mirrors what lies below it.
        if i % 3 == 0 {
            *normal = (*normal + Vec3::new(0.2, 0.1, -0.3)).normalize();
        }
    }
    let engine = RaysEngine::with_query(&shapes, None, RaysSettings::default());
    let mut scratch = Hemisphere::default();
    let mut together = Vec::new();
    engine.see(&receivers, 0..150, &mut scratch, &mut |i, seen| {
        assert_eq!(i, together.len());
        together.push(seen.clone());
    });
    let mut covered = 0.0;
    for (i, together) in together.iter().enumerate() {
        engine.see(&receivers, i..i + 1, &mut scratch, &mut |_, alone| {
            assert_eq!(alone.direction, together.direction);
            assert_eq!(alone.weight, together.weight);
            assert_eq!(alone.coverage, together.coverage);
            let plane = receivers.geometric_normal[i];
            assert!(alone.direction.iter().all(|d| d.dot(plane) > -1e-6));
        });
        covered += occlusion(together);
    }
    assert!(covered > 10.0, "{covered}");
}
