//! Lights and emissive surfaces against closed forms and brute force.

use super::lights::AreaLight;
use super::*;
use crate::scene::{
    FaceMaterials, Input, Light, LightKind, Linked, Material, MaterialId, Scene, Shaping,
};
use crate::trace::testing::{Random, mesh, scene};
use glam::{Affine3A, Mat3, Quat, Vec2};
use std::f32::consts::{FRAC_PI_2, PI};

const ONE_LIGHT: LightSamples = LightSamples {
    per_light: 256,
    emissive: 256,
    environment: 64,
};

fn light(kind: LightKind, world_from_light: Affine3A) -> Light {
    Light {
        path: "/light".into(),
        kind,
        radiance: Vec3::new(1.0, 2.0, 3.0),
        normalize: false,
        world_from_light,
        shaping: None,
        casts_shadows: true,
        lit: Linked::All,
        blockers: Linked::All,
    }
}

fn up_at(position: Vec3) -> ShadePoint {
    facing(position, Vec3::Y)
}

fn facing(position: Vec3, normal: Vec3) -> ShadePoint {
    ShadePoint {
        position,
        normal,
        geometric_normal: normal,
        smooth_offset: None,
        prim: None,
    }
}

/// Looks down (−Z to −Y) from `height`.
fn above(height: f32) -> Affine3A {
    Affine3A::from_rotation_translation(
        Quat::from_rotation_x(-FRAC_PI_2),
        Vec3::new(0.0, height, 0.0),
    )
}

fn quad(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> Vec<[Vec3; 3]> {
    vec![[a, b, c], [a, c, d]]
}

/// Irradiance of one light in a scene of `triangles`.
fn lit(light: Light, triangles: &[[Vec3; 3]], point: &ShadePoint) -> Vec3 {
    lit_by(
        light,
        triangles,
        LightSamples::default(),
        std::slice::from_ref(point),
    )[0]
}

fn lit_by(
    light: Light,
    triangles: &[[Vec3; 3]],
    samples: LightSamples,
    points: &[ShadePoint],
) -> Vec<Vec3> {
    let mut scene = scene(vec![mesh(triangles)], &[(0, Affine3A::IDENTITY)]);
    scene.lights.push(light);
    let tracer = Tracer::new(&scene);
    let shaderless = scene_without_prims();
    let diagnostics = Diagnostics::default();
    let mut lighting = Lighting::new(
        &Shader::new(&shaderless, &diagnostics),
        samples,
        &diagnostics,
    );
    lighting.lights = LinkedLights::new((&scene, None), scene.lights.iter(), &diagnostics);
    points.iter().map(|p| lighting.lights(&tracer, p)).collect()
}

fn scene_without_prims() -> Scene {
    scene(Vec::new(), &[])
}

fn assert_near(value: Vec3, truth: f32, tolerance: f32) {
    let truth = truth * Vec3::new(1.0, 2.0, 3.0);
    let error = (value - truth).abs().max_element();
    assert!(
        error <= tolerance * truth.max_element().max(1e-6),
        "{value} is not {truth}"
    );
}

#[test]
fn disk_on_its_axis_gives_pi_l_r2_over_r2_plus_h2() {
    for (radius, height) in [(1.0_f32, 1.0_f32), (0.5, 3.0), (2.0, 0.1)] {
        let disk = light(LightKind::Disk { radius }, above(height));
        let truth = PI * radius * radius / (radius * radius + height * height);
        assert_near(lit(disk, &[], &up_at(Vec3::ZERO)), truth, 1e-3);
    }
}

#[test]
fn distant_light_gives_pi_l_sin2_of_half_its_angle_and_its_size_cancels_when_normalized() {
    for angle in [0.53_f32, 10.0, 90.0] {
        let kind = LightKind::Distant {
            angle: angle.to_radians(),
        };
        let truth = PI * (0.5 * angle).to_radians().sin().powi(2);
        let sun = light(kind, above(0.0));
        assert_near(lit(sun.clone(), &[], &up_at(Vec3::ZERO)), truth, 1e-5);
        let normalized = Light {
            normalize: true,
            ..sun
        };
        assert_near(lit(normalized, &[], &up_at(Vec3::ZERO)), 1.0, 1e-5);
    }
    let sharp = light(LightKind::Distant { angle: 0.0 }, above(0.0));
    let slanted = facing(Vec3::ZERO, Vec3::new(0.0, 0.6, 0.8));
    assert_near(lit(sharp, &[], &slanted), 0.6, 1e-5);
}

#[test]
fn sphere_light_gives_pi_l_sin2_cos_and_nothing_inside() {
    let kind = LightKind::Sphere {
        radius: 0.5,
        treat_as_point: false,
    };
    let at = Affine3A::from_translation(Vec3::new(0.0, 2.0, 0.0));
    let sphere = light(kind, at);
    assert_near(
        lit(sphere.clone(), &[], &up_at(Vec3::ZERO)),
        PI / 16.0,
        1e-5,
    );
    assert_eq!(
        lit(sphere.clone(), &[], &up_at(Vec3::new(0.0, 1.8, 0.0))),
        Vec3::ZERO
    );
    let half = facing(Vec3::ZERO, Vec3::X);
    let horizon = lit(sphere, &[], &half);
    // half of the cap is below the horizon of this receiver: brute force over the cap
    let sigma = 0.25_f64.asin();
    let truth = (sigma - sigma.sin() * sigma.cos()) as f32;
    assert_near(horizon, truth, 1e-4);
}

#[test]
fn stretched_sphere_equals_a_brute_force_sum_over_its_surface() {
    let matrix = Mat3::from_rotation_z(0.5) * Mat3::from_diagonal(Vec3::new(0.3, -0.8, 0.5));
    let transform = Affine3A::from_mat3_translation(matrix, Vec3::new(0.4, 1.5, 0.2));
    let kind = LightKind::Sphere {
        radius: 1.0,
        treat_as_point: false,
    };
    let point = facing(Vec3::ZERO, Vec3::new(0.5, 0.8, 0.2).normalize());
    let (mut sum, mut area) = (0.0_f64, 0.0_f64);
    let n = 1000;
    for i in 0..n {
        for j in 0..2 * n {
            let (theta, phi) = (
                PI * (i as f32 + 0.5) / n as f32,
                PI * (j as f32 + 0.5) / n as f32,
            );
            let unit = Vec3::new(
                theta.sin() * phi.cos(),
                theta.sin() * phi.sin(),
                theta.cos(),
            );
            let normal = matrix.inverse().transpose() * unit * matrix.determinant().abs();
            let element = f64::from(theta.sin()) * f64::from(PI / n as f32).powi(2);
            let p = transform.transform_point3(unit);
            let d = p.normalize();
            let share =
                d.dot(point.normal).max(0.0) * (-normal.dot(d)).max(0.0) / p.length_squared();
            sum += f64::from(share) * element;
            area += f64::from(normal.length()) * element;
        }
    }
    let body = light(kind, transform);
    assert_near(lit(body.clone(), &[], &point), sum as f32, 3e-3);
    let normalized = Light {
        normalize: true,
        ..body
    };
    assert_near(lit(normalized, &[], &point), (sum / area) as f32, 4e-3);
}

#[test]
fn treated_as_point_gives_the_radiance_times_the_projected_area_also_without_size() {
    let at = Affine3A::from_translation(Vec3::new(0.0, 2.0, 0.0));
    let sphere = |radius| {
        light(
            LightKind::Sphere {
                radius,
                treat_as_point: true,
            },
            at,
        )
    };
    assert_near(
        lit(sphere(0.1), &[], &up_at(Vec3::ZERO)),
        PI * 0.01 / 4.0,
        1e-5,
    );
    let normalized = Light {
        normalize: true,
        ..sphere(0.0)
    };
    assert_near(lit(normalized, &[], &up_at(Vec3::ZERO)), 0.25 / 4.0, 1e-5);
}

#[test]
fn long_cylinder_equals_the_infinite_one_and_its_caps_are_dark() {
    // an infinite cylinder over a facing receiver: radiance · 2 · r / d (the projected chord, Howell B-)
    let kind = LightKind::Cylinder {
        radius: 0.2,
        length: 400.0,
    };
    let tube = light(kind, Affine3A::from_translation(Vec3::new(0.0, 1.0, 0.0)));
    assert_near(lit(tube, &[], &up_at(Vec3::ZERO)), PI * 0.2, 2e-3);
    let short = LightKind::Cylinder {
        radius: 0.2,
        length: 1.0,
    };
    let tube = light(short, Affine3A::IDENTITY);
    let before_cap = facing(Vec3::new(1.0, 0.1, 0.0), -Vec3::X);
    assert_eq!(lit(tube, &[], &before_cap), Vec3::ZERO);
}

#[test]
fn rect_shines_only_towards_its_minus_z_also_when_mirrored_and_is_normalized_by_world_area() {
    let kind = LightKind::Rect {
        width: 1.0,
        height: 2.0,
        texture: None,
    };
    let scaled = above(1.5) * Affine3A::from_scale(Vec3::new(-2.0, 0.5, 1.0));
    let rect = light(kind, scaled);
    let below = lit(rect.clone(), &[], &up_at(Vec3::ZERO));
    assert!(below.x > 0.1);
    let over = facing(Vec3::new(0.0, 3.0, 0.0), -Vec3::Y);
    assert_eq!(lit(rect.clone(), &[], &over), Vec3::ZERO);
    let normalized = lit(
        Light {
            normalize: true,
            ..rect
        },
        &[],
        &up_at(Vec3::ZERO),
    );
    assert!((normalized * 2.0 - below).abs().max_element() < 1e-6);
}

#[test]
fn penumbra_of_a_rect_behind_an_edge_equals_brute_force() {
    let kind = LightKind::Rect {
        width: 1.0,
        height: 0.7,
        texture: None,
    };
    let rect = light(kind, above(2.0));
    let far = 50.0;
    let sheet = quad(
        Vec3::new(0.0, 1.0, -far),
        Vec3::new(far, 1.0, -far),
        Vec3::new(far, 1.0, far),
        Vec3::new(0.0, 1.0, far),
    );
    for x in [-0.6_f32, -0.3, -0.05, 0.1, 0.31, 0.6] {
        let n = 320;
        let (mut truth, mut all) = (0.0_f64, 0.0_f64);
        for i in 0..n {
            for j in 0..n {
                let p = Vec3::new(
                    (i as f32 + 0.5) / n as f32 - 0.5 - x,
                    2.0,
                    0.7 * ((j as f32 + 0.5) / n as f32 - 0.5),
                );
                let share = f64::from(4.0 / p.length_squared().powi(2) * 0.7 / (n * n) as f32);
                all += share;
                if x + 0.5 * p.x < 0.0 {
                    truth += share;
                }
            }
        }
        let value = lit(rect.clone(), &sheet, &up_at(Vec3::new(x, 0.0, 0.0)));
        assert!(
            (value.x - truth as f32).abs() < 0.01 * all as f32,
            "{x}: {value} {truth}"
        );
    }
}

#[test]
fn surfel_samples_find_full_light_and_full_shadow_exactly() {
    let kind = LightKind::Rect {
        width: 1.0,
        height: 1.0,
        texture: None,
    };
    let sheet = quad(
        Vec3::new(0.0, 1.0, -9.0),
        Vec3::new(9.0, 1.0, -9.0),
        Vec3::new(9.0, 1.0, 9.0),
        Vec3::new(0.0, 1.0, 9.0),
    );
    let points = [
        up_at(Vec3::new(-3.0, 0.0, 0.0)),
        up_at(Vec3::new(3.0, 0.0, 0.0)),
    ];
    let rect = light(kind, above(2.0));
    let values = lit_by(rect.clone(), &sheet, LightSamples::SURFEL, &points);
    let open = lit_by(rect.clone(), &[], LightSamples::SURFEL, &points);
    assert_eq!(values, [open[0], Vec3::ZERO]);
    let unshadowed = Light {
        casts_shadows: false,
        ..rect
    };
    assert_eq!(
        lit_by(unshadowed, &sheet, LightSamples::SURFEL, &points),
        open
    );
}

#[test]
fn a_linked_light_lights_its_prims_alone_and_only_its_blockers_shadow_it() {
    let sheet = |height: f32| {
        mesh(&quad(
            Vec3::new(-9.0, height, -9.0),
            Vec3::new(-9.0, height, 9.0),
            Vec3::new(9.0, height, 9.0),
            Vec3::new(9.0, height, -9.0),
        ))
    };
    let (floor, low, high) = (PrimId(0), PrimId(1), PrimId(2));
    let meshes = [0.0, 1.0, 2.0].map(sheet).to_vec();
    let mut scene = scene(meshes, &[0, 1, 2].map(|mesh| (mesh, Affine3A::IDENTITY)));
    let only = |prims: &[PrimId]| {
        Linked::Only([floor, low, high].map(|prim| prims.contains(&prim)).into())
    };
    // a disk on its axis: π L r² / (r² + h²), seen from the floor and from the lower sheet
    let truth = |height: f32| PI / (1.0 + height * height);
    let cases = [
        (Linked::All, Linked::All, [0.0, 0.0]),
        (Linked::All, only(&[]), [truth(3.0), truth(2.0)]),
        (Linked::All, only(&[low]), [0.0, truth(2.0)]),
        (Linked::All, only(&[floor]), [truth(3.0), truth(2.0)]),
        (only(&[low]), only(&[]), [0.0, truth(2.0)]),
        (only(&[floor, high]), only(&[floor]), [truth(3.0), 0.0]),
    ];
    for (lit, blockers, truth) in cases {
        scene.lights = vec![Light {
            lit,
            blockers,
            ..light(LightKind::Disk { radius: 1.0 }, above(3.0))
        }];
        let (tracer, diagnostics) = (Tracer::new(&scene), Diagnostics::default());
        let shader = Shader::new(&scene, &diagnostics);
        let lighting = Lighting::new(&shader, ONE_LIGHT, &diagnostics);
        for ((prim, height), truth) in [(floor, 0.0), (low, 1.0)].into_iter().zip(truth) {
            let point = up_at(Vec3::Y * height).of_prim(prim);
            assert_near(lighting.lights(&tracer, &point), truth, 1e-3);
            assert_near(
                lighting.for_surfels(true).lights(&tracer, &point),
                truth,
                1e-3,
            );
        }
    }
}

#[test]
fn lights_in_the_plane_of_a_ceiling_are_not_blocked_by_it() {
    let kind = LightKind::Rect {
        width: 1.0,
        height: 1.0,
        texture: None,
    };
    let ceiling = quad(
        Vec3::new(-4.0, 2.0, -4.0),
        Vec3::new(4.0, 2.0, -4.0),
        Vec3::new(4.0, 2.0, 4.0),
        Vec3::new(-4.0, 2.0, 4.0),
    );
    for x in [0.0, 1.0, 4.0, 30.0] {
        let point = up_at(Vec3::new(x, 0.0, 0.3));
        let rect = light(kind.clone(), above(2.0));
        assert_eq!(
            lit(rect.clone(), &ceiling, &point),
            lit(rect, &[], &point),
            "{x}"
        );
    }
}

#[test]
fn a_cone_on_a_small_sphere_cuts_its_light() {
    let kind = LightKind::Sphere {
        radius: 0.01,
        treat_as_point: false,
    };
    let shaping = Shaping {
        cone_angle: 0.5,
        cone_softness: 0.0,
        focus: 0.0,
        focus_tint: Vec3::ZERO,
    };
    let spot = Light {
        shaping: Some(shaping),
        ..light(kind.clone(), above(1.0))
    };
    let plain = light(kind, above(1.0));
    let inside = up_at(Vec3::new(0.4, 0.0, 0.0));
    assert_eq!(lit(spot.clone(), &[], &inside), lit(plain, &[], &inside));
    assert_eq!(lit(spot, &[], &up_at(Vec3::new(0.7, 0.0, 0.0))), Vec3::ZERO);
}

#[test]
fn lights_without_size_or_finite_numbers_warn_and_are_dark() {
    let kinds = [
        LightKind::Rect {
            width: 0.0,
            height: 1.0,
            texture: None,
        },
        LightKind::Disk { radius: 0.0 },
        LightKind::Sphere {
            radius: 0.0,
            treat_as_point: false,
        },
        LightKind::Cylinder {
            radius: 0.0,
            length: 1.0,
        },
    ];
    let mut lights: Vec<_> = kinds
        .into_iter()
        .map(|kind| light(kind, above(1.0)))
        .collect();
    lights.push(Light {
        radiance: Vec3::NAN,
        ..light(LightKind::Disk { radius: 1.0 }, above(1.0))
    });
    lights.push(light(LightKind::Distant { angle: 0.1 }, Affine3A::ZERO));
    for light in lights {
        let diagnostics = Diagnostics::default();
        assert!(AreaLight::new(&light, &diagnostics).is_none(), "{light:?}");
        assert_eq!(diagnostics.warnings().len(), 1);
    }
}

#[test]
fn glances_at_a_light_average_to_its_irradiance() {
    let kind = LightKind::Rect {
        width: 1.0,
        height: 1.0,
        texture: None,
    };
    let sheet = quad(
        Vec3::new(0.0, 1.0, -9.0),
        Vec3::new(9.0, 1.0, -9.0),
        Vec3::new(9.0, 1.0, 9.0),
        Vec3::new(0.0, 1.0, 9.0),
    );
    let mut scene = scene(vec![mesh(&sheet)], &[(0, Affine3A::IDENTITY)]);
    scene.lights.push(light(kind, above(2.0)));
    let (tracer, diagnostics) = (Tracer::new(&scene), Diagnostics::default());
    let shader = Shader::new(&scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    for x in [-0.4, -0.1, 0.0, 0.3] {
        let point = up_at(Vec3::new(x, 0.0, 0.0));
        let glance = |number| lighting.for_surfels(true).glance(&tracer, &point, number).x;
        let mean = (0..16).map(glance).sum::<f32>() / 16.0;
        let truth = lighting.lights(&tracer, &point).x;
        let open = PI * 0.25;
        assert!((mean - truth).abs() < 0.05 * open, "{x}: {mean} {truth}");
    }
}

/// `n × n` quads from `corner` along `a` and `b`, counter-clockwise about `a × b`.
fn grid(corner: Vec3, a: Vec3, b: Vec3, n: usize) -> Vec<[Vec3; 3]> {
    let at = |i: usize, j: usize| corner + a * (i as f32 / n as f32) + b * (j as f32 / n as f32);
    (0..n * n)
        .flat_map(|k| {
            let (i, j) = (k % n, k / n);
            quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1))
        })
        .collect()
}

/// A ball about the origin of `12 n²` triangles: between inscribed and circumscribed, so that its area is the sphere's
/// to 1e-3 with `n` = 24.
fn ball(n: usize) -> Vec<[Vec3; 3]> {
    let mut triangles = Vec::new();
    let middle = 0.5 * (Vec3::X + Vec3::Y + Vec3::Z);
    for (a, b, c) in [
        (Vec3::X, Vec3::Y, Vec3::Z),
        (Vec3::Y, Vec3::Z, Vec3::X),
        (Vec3::Z, Vec3::X, Vec3::Y),
    ] {
        triangles.extend(grid(c - middle, a, b, n));
        triangles.extend(grid(-middle, b, a, n));
    }
    (triangles.iter())
        .map(|t| t.map(|p| p.normalize() * 1.0006))
        .collect()
}

mod emitters;
mod facets;
mod many_lights;
mod penumbrae;
