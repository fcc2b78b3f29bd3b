//! Emissive surfaces against closed forms and brute force.

use super::*;

/// Emitting squares or meshes: `(triangles, radiance, transform)`.
fn emitting(meshes: &[(Vec<[Vec3; 3]>, f32, Affine3A)]) -> Scene {
    let prims: Vec<_> = (0..).zip(meshes).map(|(i, m)| (i, m.2)).collect();
    let mut scene = scene(meshes.iter().map(|m| mesh(&m.0)).collect(), &prims);
    for (i, (_, radiance, _)) in (0..).zip(meshes) {
        scene.materials.push(Material {
            emissive_color: Input::color(*radiance, 2.0 * radiance, 3.0 * radiance),
            ..Material::default()
        });
        scene.prims[i].materials = FaceMaterials::Whole(Some(MaterialId(i as u32)));
    }
    scene
}

fn from_emitters(scene: &Scene, points: &[ShadePoint]) -> Vec<Vec3> {
    by_samples(ONE_LIGHT, scene, points)
}

fn by_samples(samples: LightSamples, scene: &Scene, points: &[ShadePoint]) -> Vec<Vec3> {
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(scene, &diagnostics);
    let tracer = Tracer::new(scene);
    let lighting = Lighting::new(&shader, samples, &diagnostics);
    points
        .iter()
        .map(|p| lighting.emitters(&shader, &tracer, p))
        .collect()
}

#[test]
fn perpendicular_square_gives_the_textbook_form_factor_with_any_tessellation() {
    // Howell B-3: element in the plane at right angles to a rectangle (width b, height a), at distance c of its foot
    let (a, b, c): (f32, f32, f32) = (1.0, 1.0, 0.5);
    let (x, y) = (a / b, c / b);
    let root = (x * x + y * y).sqrt();
    let truth = 0.5 * ((1.0 / y).atan() - y / root * (1.0 / root).atan());
    for n in [1, 12] {
        // wall at x = 0, 0 ≤ y ≤ 1, 0 ≤ z ≤ 1, facing +X; the element below its edge's end
        let wall = grid(Vec3::ZERO, Vec3::Y, Vec3::Z, n);
        let scene = emitting(&[(wall, 1.0, Affine3A::IDENTITY)]);
        let value = from_emitters(&scene, &[up_at(Vec3::new(c, 0.0, 0.0))]);
        assert_near(value[0], truth, 5e-4);
    }
}

#[test]
fn a_closed_emitting_box_gives_pi_l_everywhere_also_on_edges_and_corners() {
    // 16: a power of two, as the number of samples is
    for n in [1, 5, 16] {
        let mut triangles = Vec::new();
        for (a, b, c) in [
            (Vec3::X, Vec3::Y, Vec3::Z),
            (Vec3::Y, Vec3::Z, Vec3::X),
            (Vec3::Z, Vec3::X, Vec3::Y),
        ] {
            triangles.extend(grid(Vec3::ZERO, a, b, n));
            triangles.extend(grid(c, b, a, n));
        }
        for turn in [
            Affine3A::IDENTITY,
            Affine3A::from_rotation_y(0.4) * Affine3A::from_rotation_x(1.0),
        ] {
            let turned: Vec<_> = triangles
                .iter()
                .map(|t| t.map(|p| turn.transform_point3(p)))
                .collect();
            let scene = emitting(&[(turned, 1.0, Affine3A::IDENTITY)]);
            let mut points = Vec::new();
            for i in 0..=10 {
                for j in 0..=10 {
                    let local = Vec3::new(i as f32 / 10.0, 0.0, j as f32 / 10.0);
                    points.push(facing(
                        turn.transform_point3(local),
                        turn.transform_vector3(Vec3::Y),
                    ));
                }
            }
            for (value, point) in from_emitters(&scene, &points).into_iter().zip(&points) {
                let error = (value / (PI * Vec3::new(1.0, 2.0, 3.0)) - 1.0)
                    .abs()
                    .max_element();
                assert!(error < 2e-3, "{n} {}: {value}", point.position);
            }
        }
    }
}

fn relative_rms(values: &[Vec3], truths: &[f32]) -> f32 {
    let squares: f32 = (values.iter().zip(truths))
        .map(|(value, truth)| (value.x - truth).powi(2))
        .sum();
    let count = truths.len() as f32;
    (squares / count).sqrt() / (truths.iter().sum::<f32>() / count)
}

#[test]
fn a_finely_tessellated_emitting_ball_equals_the_sphere_formula() {
    for mirror in [1.0_f32, -1.0] {
        let transform = Affine3A::from_scale_rotation_translation(
            Vec3::new(0.4 * mirror, 0.4, 0.4),
            Quat::IDENTITY,
            Vec3::new(0.0, 1.0, 0.0),
        );
        let scene = emitting(&[(ball(24), 1.0, transform)]);
        let points: Vec<_> = (0..20)
            .map(|i| up_at(Vec3::new(0.15 * i as f32, 0.0, 0.1)))
            .collect();
        let truths: Vec<_> = (points.iter())
            .map(|point| {
                let d2 = point.position.length_squared() + 1.0;
                PI * 0.16 / d2 / d2.sqrt()
            })
            .collect();
        let relative = relative_rms(&from_emitters(&scene, &points), &truths);
        assert!(relative < 1.5e-3, "relRMS {relative}");
    }
}

#[test]
fn a_half_hidden_emitting_ball_equals_brute_force() {
    let transform = Affine3A::from_scale_rotation_translation(
        Vec3::splat(0.4),
        Quat::IDENTITY,
        Vec3::new(0.0, 1.5, 0.0),
    );
    let sheet = grid(Vec3::new(0.0, 0.6, -2.0), Vec3::X * 2.0, Vec3::Z * 4.0, 1);
    let scene = emitting(&[(ball(16), 1.0, transform), (sheet, 0.0, Affine3A::IDENTITY)]);
    let tracer = Tracer::new(&scene);
    let points: Vec<_> = (0..9)
        .map(|i| up_at(Vec3::new(0.1 * i as f32 - 0.5, 0.0, 0.05)))
        .collect();
    let mut random = Random(5);
    let truths: Vec<_> = (points.iter())
        .map(|point| {
            // directions within the cone about the ball
            let to_ball = Vec3::new(0.0, 1.5, 0.0) - point.position;
            let frame = crate::math::Frame::about(to_ball.normalize());
            let cap = 1.0 - (1.0 - (0.41 / to_ball.length()).powi(2)).sqrt();
            let (n, mut sum) = (40_000, 0.0_f64);
            for _ in 0..n {
                let z = 1.0 - cap * random.next();
                let around = Vec2::from_angle(2.0 * PI * random.next());
                let direction = frame.to_world((around * (1.0 - z * z).sqrt()).extend(z));
                let hit = tracer.closest(point.position, direction, f32::INFINITY);
                if hit.is_some_and(|hit| hit.prim.0 == 0) {
                    sum += f64::from(direction.y);
                }
            }
            (sum * f64::from(2.0 * PI * cap)) as f32 / n as f32
        })
        .collect();
    let relative = relative_rms(&from_emitters(&scene, &points), &truths);
    assert!(relative < 2e-2, "relRMS {relative} in a penumbra");
}

#[test]
fn an_emitting_square_brighter_to_one_side_equals_brute_force() {
    // emission x at the place x of a unit square over the receiver
    let square = grid(Vec3::new(0.0, 1.0, 0.0), Vec3::X, Vec3::Z, 1);
    let mut scene = emitting(&[(square, 1.0, Affine3A::IDENTITY)]);
    let values = (scene.meshes[0].positions.iter())
        .map(|p| glam::Vec4::new(p.x, 2.0 * p.x, 3.0 * p.x, 1.0))
        .collect();
    scene.meshes[0].primvars.push(crate::scene::Primvar {
        name: "glow".into(),
        components: 3,
        interpolation: crate::scene::Interpolation::Vertex,
        values,
    });
    scene.materials[0].emissive_color = Input::Primvar {
        name: "glow".into(),
        fallback: glam::Vec4::ONE,
    };
    let points: Vec<_> = (0..12)
        .map(|i| up_at(Vec3::new(0.2 * i as f32 - 0.8, 0.0, 0.3)))
        .collect();
    let n = 200;
    let at = |i: usize| (i as f32 + 0.5) / n as f32;
    let truths: Vec<_> = (points.iter())
        .map(|point| {
            let sum: f64 = (0..n * n)
                .map(|k| {
                    let place = Vec3::new(at(k % n), 1.0, at(k / n));
                    let squared = (place - point.position).length_squared();
                    f64::from(place.x / (squared * squared))
                })
                .sum();
            (sum / (n * n) as f64) as f32
        })
        .collect();
    let relative = relative_rms(&from_emitters(&scene, &points), &truths);
    assert!(relative < 2.5e-2, "relRMS {relative}");
}

#[test]
fn occluded_panels_equal_brute_force_with_any_tessellation() {
    let mut random = Random(11);
    let blocker = grid(Vec3::new(0.1, 1.0, -0.3), Vec3::X * 0.5, Vec3::Z * 0.5, 1);
    let points: Vec<_> = (0..12)
        .map(|i| up_at(Vec3::new(0.1 * i as f32 - 0.4, 0.0, 0.05)))
        .collect();
    let mut truths = Vec::new();
    for n in [1, 4, 16] {
        // faces down
        let light = grid(Vec3::new(-0.5, 2.0, -0.5), Vec3::X, Vec3::Z, n);
        let scene = emitting(&[
            (light, 1.0, Affine3A::IDENTITY),
            (blocker.clone(), 0.0, Affine3A::IDENTITY),
        ]);
        if truths.is_empty() {
            let tracer = Tracer::new(&scene);
            truths = (points.iter())
                .map(|point| brute_force(&tracer, point.position, &mut random))
                .collect();
        }
        let relative = relative_rms(&from_emitters(&scene, &points), &truths);
        assert!(relative < 1.5e-2, "{n}: relRMS {relative} in a penumbra");
    }
}

/// Irradiance from the unit square that faces down at height 2, radiance 1.
fn brute_force(tracer: &Tracer, position: Vec3, random: &mut Random) -> f32 {
    let count = 100_000;
    let mut sum = 0.0_f64;
    for _ in 0..count {
        let target = Vec3::new(random.next() - 0.5, 2.0, random.next() - 0.5);
        let d = target - position;
        if !tracer.occluded(position, d.normalize(), d.length() * 0.999) {
            sum += f64::from(4.0 / d.length_squared().powi(2));
        }
    }
    (sum / f64::from(count)) as f32
}

#[test]
fn panels_that_fill_little_of_their_rectangle_equal_their_form_factor() {
    // a thin frame of four bars, faces down at height 1
    let bar = |corner, a, b| grid(corner, a, b, 4);
    let (x, z) = (Vec3::X, Vec3::Z);
    let lift = Vec3::new(-1.0, 1.0, -1.0);
    let mut frame = bar(lift, 2.0 * x, 0.05 * z);
    frame.extend(bar(lift + 1.95 * z, 2.0 * x, 0.05 * z));
    frame.extend(bar(lift + 0.05 * z, 0.05 * x, 1.9 * z));
    frame.extend(bar(lift + 1.95 * x + 0.05 * z, 0.05 * x, 1.9 * z));
    let scene = emitting(&[(frame, 1.0, Affine3A::IDENTITY)]);
    let square = |half: f32| {
        // four quarters of a parallel rectangle over its corner, Howell B-3
        let q = half / (1.0 + half * half).sqrt();
        4.0 * q * q.atan()
    };
    let value = from_emitters(&scene, &[up_at(Vec3::ZERO)])[0];
    assert_near(value, square(1.0) - square(0.95), 1e-3);
}

#[test]
fn scenes_without_emission_have_no_emitters() {
    let black = emitting(&[(
        grid(Vec3::ZERO, Vec3::X, Vec3::Y, 2),
        0.0,
        Affine3A::IDENTITY,
    )]);
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&black, &diagnostics);
    let lighting = Lighting::new(&shader, ONE_LIGHT, &diagnostics);
    assert!(!lighting.has_emitters() && !lighting.has_environment());
    assert_eq!(lighting.uniform_environment(), Some(Vec3::ZERO));
    let tracer = Tracer::new(&black);
    let point = up_at(Vec3::ZERO);
    assert_eq!(lighting.emitters(&shader, &tracer, &point), Vec3::ZERO);
    assert_eq!(lighting.environment(&tracer, &point), Vec3::ZERO);
}

/// `Points` as octahedra of the area of spheres.
fn points(balls: &[(Vec3, f32)]) -> crate::scene::Mesh {
    let ends = [Vec3::X, Vec3::Y, Vec3::Z];
    let mut triangles = Vec::new();
    for &(center, radius) in balls {
        // Eight triangles of side √2.
        let stretch = radius * (PI / 3.0_f32.sqrt()).sqrt();
        for octant in 0..8 {
            let sign = |axis: usize| if octant >> axis & 1 == 0 { 1.0 } else { -1.0 };
            let [a, b, c] = [0, 1, 2].map(|axis| center + stretch * sign(axis) * ends[axis]);
            let is_outward = sign(0) * sign(1) * sign(2) > 0.0;
            triangles.push(if is_outward { [a, b, c] } else { [a, c, b] });
        }
    }
    let mut mesh = mesh(&triangles);
    mesh.triangle_faces = (0..mesh.triangles.len() as u32).map(|t| t / 8).collect();
    (mesh.scheme, mesh.closed) = ("Points".into(), true);
    mesh
}

/// What shines of `scene`, whose first prim is `Points` that emit (1, 2, 3), at `point`: by rays all around.
fn by_all_rays(tracer: &Tracer, point: &ShadePoint) -> Vec3 {
    let mut random = Random(9);
    let count = 400_000;
    let origin = tracer.lift(point.position, point.normal);
    let met = (0..count).filter(|_| {
        let direction = (point.normal + random.direction()).normalize();
        (tracer.closest(origin, direction, f32::INFINITY)).is_some_and(|hit| hit.prim.0 == 0)
    });
    PI * met.count() as f32 / count as f32 * Vec3::new(1.0, 2.0, 3.0)
}

#[test]
fn points_that_hide_each_other_give_what_rays_all_around_see_of_them() {
    let mut random = Random(4);
    let wall = grid(Vec3::new(-3.0, 0.0, 2.0), Vec3::Y, 2.0 * Vec3::X, 1);
    for (count, radius) in [(3000, 0.03), (3000, 0.012), (100, 0.15)] {
        let balls: Vec<_> = (0..count)
            .map(|_| (random.vector() + Vec3::new(0.0, 1.5, 0.0), radius))
            .collect();
        let mut scene = emitting(&[
            (Vec::new(), 1.0, Affine3A::IDENTITY),
            (wall.clone(), 0.0, Affine3A::IDENTITY),
        ]);
        scene.meshes[0] = points(&balls);
        let tracer = Tracer::new(&scene);
        // Beside them, amid them, below them, behind the wall.
        let places = [
            [4.0, 0.0, 0.0],
            [0.1, 1.4, 0.2],
            [0.3, 0.2, 0.1],
            [-2.0, 0.5, 4.0],
        ];
        let places = places.map(|place| up_at(Vec3::from_array(place)));
        let many = LightSamples {
            emissive: 4096,
            ..ONE_LIGHT
        };
        let found = by_samples(many, &scene, &places);
        for (found, point) in found.into_iter().zip(&places) {
            let truth = by_all_rays(&tracer, point);
            let off = (found - truth).abs().x;
            assert!(
                off < 0.02 * truth.x + 0.001,
                "{count} of {radius} at {}: {found} {truth}",
                point.position
            );
        }
    }
}

#[test]
fn points_that_stand_apart_give_the_sum_of_sphere_formulas() {
    let balls: Vec<_> = (0..100)
        .map(|i| {
            let (x, z) = ((i % 10) as f32 - 4.5, (i / 10) as f32 - 4.5);
            (Vec3::new(x, 3.0, z), 0.02)
        })
        .collect();
    let mut scene = emitting(&[(Vec::new(), 1.0, Affine3A::from_scale(Vec3::splat(2.0)))]);
    scene.meshes[0] = points(&balls);
    let point = up_at(Vec3::new(0.7, 0.0, 0.2));
    let truth: f32 = (balls.iter())
        .map(|(center, radius)| {
            let offset = 2.0 * *center - point.position;
            let radius = 2.0 * radius;
            PI * radius * radius * offset.y / offset.length().powi(3)
        })
        .sum();
    assert_near(from_emitters(&scene, &[point])[0], truth, 2e-3);
}
