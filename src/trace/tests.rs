//! The tracer against brute force in `f64`, flattened instances, closed boxes and extreme scales.

mod beams;
mod fans;

use super::testing::{Random, mesh, scene};
use super::*;
use glam::Mat3;

fn single(triangles: &[[Vec3; 3]]) -> Tracer {
    Tracer::new(&scene(vec![mesh(triangles)], &[(0, Affine3A::IDENTITY)]))
}

fn soup(count: usize, size: f32, random: &mut Random) -> Vec<[Vec3; 3]> {
    (0..count)
        .map(|_| {
            let center = random.vector();
            [0; 3].map(|_| center + size * random.vector())
        })
        .collect()
}

/// Axis-aligned box of half size 1 about 0, `n × n` quads a side, normals outward, corners shared bit by bit.
fn diced_box(n: usize) -> Vec<[Vec3; 3]> {
    let at = |i: usize| 2.0 * i as f32 / n as f32 - 1.0;
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [-1.0_f32, 1.0] {
            for i in 0..n {
                for j in 0..n {
                    let corner = |a: usize, b: usize| {
                        let mut p = [side; 3];
                        p[(axis + 1) % 3] = at(a);
                        p[(axis + 2) % 3] = at(b);
                        Vec3::from(p)
                    };
                    let [a, b, c, d] = [
                        corner(i, j),
                        corner(i + 1, j),
                        corner(i + 1, j + 1),
                        corner(i, j + 1),
                    ];
                    if side > 0.0 {
                        triangles.extend([[a, b, c], [a, c, d]]);
                    } else {
                        triangles.extend([[a, c, b], [a, d, c]]);
                    }
                }
            }
        }
    }
    triangles
}

/// Möller–Trumbore in `f64`: distance, distance of the hit to the triangle's edge in barycentrics, front.
fn exact(triangle: &[Vec3; 3], origin: Vec3, direction: Vec3) -> Option<(f64, f64, bool)> {
    let [a, b, c] = triangle.map(|p| p.as_dvec3());
    let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
    let (e1, e2) = (b - a, c - a);
    let p = d.cross(e2);
    let det = e1.dot(p);
    let s = o - a;
    let u = s.dot(p) / det;
    let q = s.cross(e1);
    let v = d.dot(q) / det;
    let t = e2.dot(q) / det;
    let edge = u.min(v).min(1.0 - u - v);
    (det != 0.0 && t > 0.0).then_some((t, edge, det > 0.0))
}

/// Compares with brute force; returns how many rays differ where the truth is not on an edge.
fn differences(tracer: &Tracer, triangles: &[[Vec3; 3]], rays: &[(Vec3, Vec3)]) -> usize {
    let mut count = 0;
    for &(origin, direction) in rays {
        let all: Vec<_> = (triangles.iter().enumerate())
            .filter_map(|(i, t)| exact(t, origin, direction).map(|h| (i, h)))
            .filter(|(_, h)| h.1 > -1e-5)
            .collect();
        if all.iter().any(|(_, h)| h.1.abs() <= 1e-5) {
            continue;
        }
        let truth = all.iter().min_by(|a, b| a.1.0.total_cmp(&b.1.0));
        let hit = tracer.closest(origin, direction, f32::INFINITY);
        let is_same = match (truth, hit) {
            (None, None) => true,
            (Some((i, t)), Some(h)) => {
                let near = (h.distance as f64 - t.0).abs() < 1e-5 * t.0.max(1e-3);
                (h.triangle as usize == *i && h.front == t.2 && near)
                    || all.iter().any(|(j, o)| {
                        *j == h.triangle as usize
                            && o.2 == h.front
                            && (o.0 - t.0).abs() < 1e-6 * t.0
                    })
            }
            _ => false,
        };
        let occluded = tracer.occluded(origin, direction, f32::INFINITY);
        count += usize::from(!is_same || occluded != truth.is_some());
    }
    count
}

#[test]
fn random_soups_agree_with_brute_force_at_any_scale() {
    let mut random = Random(1);
    for scale in [1e-4_f32, 1.0, 1e5] {
        for (count, size) in [(1, 0.5), (3, 0.5), (700, 0.1), (300, 1.0)] {
            let mut triangles = soup(count, size, &mut random);
            triangles.push([Vec3::ONE * 0.1; 3]);
            for p in triangles.iter_mut().flatten() {
                *p *= scale;
            }
            let rays: Vec<_> = (0..1000)
                .map(|_| (random.vector() * 1.5 * scale, random.direction()))
                .collect();
            let tracer = single(&triangles);
            assert_eq!(
                differences(&tracer, &triangles, &rays),
                0,
                "{scale} {count} {size}"
            );
        }
    }
}

#[test]
fn axis_aligned_rays_and_boxes_agree_with_brute_force() {
    let mut random = Random(2);
    let triangles = diced_box(8);
    let tracer = single(&triangles);
    let mut rays: Vec<_> = (0..1000)
        .map(|_| (random.vector() * 2.0, random.direction()))
        .collect();
    for axis in [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z] {
        rays.extend((0..100).map(|_| (random.vector() * 1.5, axis)));
    }
    assert_eq!(differences(&tracer, &triangles, &rays), 0);
}

#[test]
fn a_closed_box_does_not_leak_through_faces_edges_or_vertices() {
    let mut random = Random(3);
    let turned = Mat3::from_rotation_y(0.7) * Mat3::from_rotation_x(0.3);
    for matrix in [Mat3::IDENTITY, turned, turned * 1e-4] {
        let triangles: Vec<_> = (diced_box(7).iter())
            .map(|t| t.map(|p| matrix * p + matrix * Vec3::splat(0.3)))
            .collect();
        let tracer = single(&triangles);
        for i in 0..350_000 {
            let origin = matrix * (random.vector() * 0.99 + 0.3);
            let triangle =
                triangles[(random.next() * triangles.len() as f32) as usize % triangles.len()];
            let target = match i % 3 {
                0 => triangle[0],
                1 => triangle[0].lerp(triangle[1], random.next()),
                _ => origin + matrix * random.direction(),
            };
            let direction = (target - origin).normalize();
            let hit = tracer.closest(origin, direction, f32::INFINITY);
            assert!(hit.is_some_and(|hit| !hit.front), "{origin} {direction}");
            assert!(tracer.occluded(origin, direction, f32::INFINITY));
        }
    }
}

#[test]
fn instances_agree_with_their_flattened_copies_mirrored_and_sheared() {
    let mut random = Random(4);
    let triangles = soup(60, 0.3, &mut random);
    let second = soup(40, 0.3, &mut random);
    let transforms: Vec<Affine3A> = (0..30)
        .map(|i| {
            let mut linear =
                Mat3::from_cols(random.vector(), random.vector(), random.vector()) * 0.4;
            if i % 2 == 0 {
                linear.x_axis = -linear.x_axis;
            }
            Affine3A::from_mat3_translation(linear, random.vector() * 2.0)
        })
        .filter(|t| t.matrix3.determinant().abs() > 1e-3)
        .collect();
    let mut prims: Vec<_> = transforms.iter().map(|t| (0, *t)).collect();
    prims.push((1, Affine3A::IDENTITY));
    let scene = scene(vec![mesh(&triangles), mesh(&second)], &prims);
    let tracers = [0, usize::MAX].map(|copies| Tracer::with_copies(&scene, copies, |_| true));
    let mut flat = Vec::new();
    for (mesh, transform) in &prims {
        for t in if *mesh == 0 { &triangles } else { &second } {
            flat.push(t.map(|p| transform.transform_point3(p)));
        }
    }
    let flattened = single(&flat);
    let mut differing = 0;
    for k in 0..20_000 {
        let (origin, direction) = (random.vector() * 3.0, random.direction());
        let tracer = &tracers[k % 2];
        let a = tracer.closest(origin, direction, f32::INFINITY);
        let b = flattened.closest(origin, direction, f32::INFINITY);
        let is_same = match (a, b) {
            (None, None) => true,
            (Some(a), Some(b)) => {
                let first = |prim: usize| {
                    if prim < transforms.len() {
                        prim * 60
                    } else {
                        transforms.len() * 60
                    }
                };
                let prim = a.prim.index();
                let mirrored = prims[prim].1.matrix3.determinant() < 0.0;
                first(prim) + a.triangle as usize == b.triangle as usize
                    && (a.distance - b.distance).abs() < 1e-4 * b.distance.max(0.1)
                    && (a.front == b.front) != mirrored
            }
            _ => false,
        };
        differing += usize::from(!is_same);
        assert_eq!(
            tracer.occluded(origin, direction, f32::INFINITY),
            a.is_some()
        );
    }
    assert!(
        differing <= 4,
        "{differing} of 20000 rays differ (rounding at edges only)"
    );
}

#[test]
fn barycentrics_give_the_hit_point() {
    let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let tracer = single(&[triangle]);
    let hit = tracer
        .closest(Vec3::new(0.2, 0.3, 2.0), -Vec3::Z, 3.0)
        .unwrap();
    assert!((hit.u - 0.2).abs() < 1e-6 && (hit.v - 0.3).abs() < 1e-6 && hit.front);
    assert_eq!(hit.distance, 2.0);
    assert!(
        tracer
            .closest(Vec3::new(0.2, 0.3, 2.0), -Vec3::Z, 2.0)
            .is_none()
    );
    let behind = tracer
        .closest(Vec3::new(0.2, 0.3, -2.0), Vec3::Z, 3.0)
        .unwrap();
    assert!(!behind.front);
}

#[test]
fn nothing_is_hit_in_empty_scenes_or_by_rays_that_are_not_numbers() {
    let empty = Tracer::new(&scene(Vec::new(), &[]));
    assert!(empty.closest(Vec3::ZERO, Vec3::X, f32::INFINITY).is_none());
    assert!(!empty.occluded(Vec3::ZERO, Vec3::X, f32::INFINITY));
    let no_triangles = single(&[]);
    assert!(!no_triangles.occluded(Vec3::ZERO, Vec3::X, f32::INFINITY));
    let tracer = single(&diced_box(2));
    for direction in [Vec3::NAN, Vec3::ZERO, Vec3::INFINITY] {
        assert!(
            tracer
                .closest(Vec3::ZERO, direction, f32::INFINITY)
                .is_none()
        );
        assert!(!tracer.occluded(Vec3::ZERO, direction, f32::INFINITY));
    }
    assert!(tracer.closest(Vec3::NAN, Vec3::X, f32::INFINITY).is_none());
    assert!(tracer.closest(Vec3::ZERO, Vec3::X, f32::NAN).is_none());
    assert!(tracer.closest(Vec3::ZERO, Vec3::X, 0.0).is_none());
    let flat = [Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0)); 2];
    let collapsed = Tracer::new(&scene(
        vec![mesh(&diced_box(1))],
        &[(0, flat[0]), (0, flat[1])],
    ));
    assert!(!collapsed.occluded(Vec3::splat(0.1), Vec3::X, f32::INFINITY));
}

#[test]
fn a_hundred_thousand_coincident_triangles_build_and_are_hit() {
    let triangles = vec![[Vec3::ZERO, Vec3::X, Vec3::Y]; 100_000];
    let tracer = single(&triangles);
    assert!(tracer.occluded(Vec3::new(0.2, 0.2, 1.0), -Vec3::Z, 2.0));
    assert!(!tracer.occluded(Vec3::new(0.9, 0.9, 1.0), -Vec3::Z, 2.0));
}

#[test]
fn lifted_points_see_a_contact_of_1e_4_but_not_their_own_surface() {
    let mut random = Random(5);
    for matrix in [
        Mat3::IDENTITY,
        Mat3::from_rotation_z(0.4) * Mat3::from_rotation_x(1.1),
    ] {
        for scale in [1e-4_f32, 1.0, 1e5] {
            let quad = |height: f32| {
                let at = |x: f32, z: f32| scale * (matrix * (Vec3::new(x, height, z) + 0.5));
                let [a, b, c, d] = [at(-0.5, -0.5), at(-0.5, 0.5), at(0.5, 0.5), at(0.5, -0.5)];
                [[a, b, c], [a, c, d]]
            };
            let (ground, sheet) = (quad(0.0), quad(1e-4));
            let (alone, both) = (single(&ground), single(&[ground, sheet].concat()));
            let normal = matrix * Vec3::Y;
            for _ in 0..20_000 {
                let (u, v) = (random.next() * 0.49, random.next() * 0.49);
                let [a, b, c] = ground[0];
                let position = a + (b - a) * u + (c - a) * v;
                let mut direction = random.direction();
                if direction.dot(normal) < 0.0 {
                    direction = -direction;
                }
                let origin = alone.lift(position, normal);
                assert!(!alone.occluded(origin, direction, f32::INFINITY));
                assert!(both.occluded(both.lift(position, normal), normal, 1e-3 * scale));
            }
        }
    }
}

#[test]
fn the_same_tree_is_built_by_one_and_by_many_threads() {
    let triangles = soup(30_000, 0.02, &mut Random(6));
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| single(&triangles)).world.triangles.tree
    };
    assert!(build(1) == build(5));
}

/// Not a check: prints Mray/s of one thread for closest hits and occlusion.
#[test]
#[ignore = "measures speed: cargo test --release --lib trace:: -- --ignored --nocapture"]
#[expect(clippy::print_stdout, reason = "prints what it measures")]
fn measure_rays_per_second() {
    let ball: Vec<_> = (diced_box(300).iter())
        .map(|t| {
            t.map(|p| {
                let n = p.normalize();
                n * (1.0 + 0.02 * ((40.0 * n.x).sin() * (37.0 * n.y).sin() + (91.0 * n.z).sin()))
            })
        })
        .collect();
    let room = diced_box(290);
    for (name, triangles, inside) in [("box", room, true), ("ball", ball, false)] {
        let start = std::time::Instant::now();
        let tracer = single(&triangles);
        let build = start.elapsed().as_secs_f64();
        let mut random = Random(7);
        let rays: Vec<_> = (0..300_000)
            .map(|_| {
                let t =
                    triangles[(random.next() * triangles.len() as f32) as usize % triangles.len()];
                let mut n = (t[1] - t[0]).cross(t[2] - t[0]).normalize();
                n = if inside { -n } else { n };
                let origin = tracer.lift((t[0] + t[1] + t[2]) / 3.0, n);
                (origin, (n + random.direction()).normalize())
            })
            .collect();
        let start = std::time::Instant::now();
        let hits = rays
            .iter()
            .filter(|r| tracer.closest(r.0, r.1, f32::INFINITY).is_some())
            .count();
        let closest = rays.len() as f64 / start.elapsed().as_secs_f64() * 1e-6;
        let start = std::time::Instant::now();
        let limit = if inside { 1.0 } else { f32::INFINITY };
        let blocked = rays
            .iter()
            .filter(|r| tracer.occluded(r.0, r.1, limit))
            .count();
        let occluded = rays.len() as f64 / start.elapsed().as_secs_f64() * 1e-6;
        println!(
            "{name}: {} triangles, build {build:.2} s, {} B/triangle, closest {closest:.2} Mray/s ({hits}), occluded {occluded:.2} Mray/s ({blocked})",
            triangles.len(),
            tracer.bytes() / triangles.len()
        );
    }
}

/// Prims that own their mesh, shared ones stretched and mirrored, triangles without area and coincident ones.
fn mixed_scene(random: &mut Random) -> Scene {
    let mut triangles = soup(400, 0.15, random);
    for i in 0..40 {
        let [a, b, _] = triangles[i];
        triangles.extend([[a, a, b], [a, b, a.lerp(b, 0.3)], triangles[i + 40]]);
    }
    let own: Vec<_> = (0..5).map(|_| soup(60, 0.3, random)).collect();
    let mut meshes = vec![mesh(&triangles)];
    let mut prims = vec![(0, Affine3A::IDENTITY)];
    for i in 0..12 {
        let mut linear = Mat3::from_rotation_y(i as f32)
            * Mat3::from_diagonal(Vec3::new(1.0, 0.2 + random.next(), 0.5));
        if i % 2 == 0 {
            linear.z_axis = -linear.z_axis;
        }
        prims.push((0, Affine3A::from_mat3_translation(linear, random.vector())));
    }
    // Coincident with the first occurrence.
    prims.push(prims[1]);
    for triangles in &own {
        prims.push((meshes.len() as u32, Affine3A::IDENTITY));
        meshes.push(mesh(triangles));
    }
    scene(meshes, &prims)
}

/// The definition: every triangle, no hierarchy. Prims with a transform of their own have it applied to the ray.
fn brute_force(scene: &Scene, origin: Vec3, direction: Vec3) -> Option<Hit> {
    let mut best: Option<Hit> = None;
    for (prim, of) in (0..).map(PrimId).zip(&scene.prims) {
        let mesh = scene.mesh_of(of);
        let occurrence = Occurrence {
            prim,
            mesh: 0,
            object_from_world: rows_of(of.world_from_object.inverse()),
        };
        let world = Ray::new(origin, direction, f32::INFINITY)?;
        let ray = occurrence.local(&world)?;
        for triangle in 0..mesh.triangles.len() {
            let tracer = Triangles::single(mesh.corners(triangle), &ray);
            if let Some(hit) = tracer.map(|hit| hit.of_prim(prim, triangle as u32))
                && best.is_none_or(|best| hit.distance < best.distance)
            {
                best = Some(hit);
            }
        }
    }
    best
}

/// Origins next to each other and all over, directions along and between the axes.
fn packets(random: &mut Random) -> Vec<(Vec3, Vec<Vec3>, u64)> {
    (0..300)
        .map(|k| {
            let mut direction = random.direction();
            if k % 5 == 0 {
                direction[k % 3] = 0.0;
                direction = direction.normalize();
            }
            if k % 11 == 0 {
                direction = [Vec3::X, -Vec3::Y, Vec3::Z][k % 3];
            }
            let (center, size) = (random.vector(), [0.02, 0.2, 2.0][k % 3]);
            let count = [0, 1, 7, 16, 17, 63, 64, 64][k % 8];
            let origins = (0..count)
                .map(|_| center + size * random.vector())
                .collect();
            let all = (random.next() * u32::MAX as f32) as u64;
            (
                direction,
                origins,
                if k % 4 == 0 {
                    u64::MAX
                } else {
                    all << 20 ^ all
                },
            )
        })
        .collect()
}

#[test]
fn packets_hit_what_their_rays_hit_to_the_last_bit() {
    let mut random = Random(78);
    let scene = mixed_scene(&mut random);
    let tracers = [0, usize::MAX].map(|copies| Tracer::with_copies(&scene, copies, |_| true));
    let (mut blocked, mut found, mut hits) = (0, 0, [None; 64]);
    for (k, (direction, origins, active)) in packets(&mut random).into_iter().enumerate() {
        let tracer = &tracers[k / 2 % 2];
        for max_distance in [0.3, f32::INFINITY] {
            let mask = tracer.occluded_along(direction, &origins, max_distance, active);
            tracer.closest_along(direction, &origins, (max_distance, active), &mut hits);
            for (i, &origin) in origins.iter().enumerate() {
                let is_active = active >> i & 1 == 1;
                let any = is_active && tracer.occluded(origin, direction, max_distance);
                assert_eq!(mask >> i & 1 == 1, any);
                let closest = tracer.closest(origin, direction, max_distance);
                assert_eq!(hits[i], closest.filter(|_| is_active));
                assert_eq!(hits[i].is_some(), any);
                found += usize::from(hits[i].is_some());
            }
            let given = (1_u128 << origins.len()) - 1;
            assert_eq!(u128::from(mask) & !given, 0);
            blocked += mask.count_ones();
        }
    }
    assert!(blocked > 2000 && found > 2000, "{blocked} {found}");
}

#[test]
fn the_hierarchy_finds_what_a_search_of_all_triangles_finds_to_the_last_bit() {
    let mut random = Random(80);
    let scene = mixed_scene(&mut random);
    let tracer = Tracer::with_copies(&scene, 0, |_| true);
    let mut found = 0;
    for (direction, origins, _) in packets(&mut random) {
        for &origin in origins.iter().take(2) {
            let truth = brute_force(&scene, origin, direction);
            assert_eq!(tracer.closest(origin, direction, f32::INFINITY), truth);
            found += usize::from(truth.is_some());
        }
    }
    assert!(found > 200, "{found}");
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let mut random = Random(77);
    let mut tracer = Tracer::with_copies(&mixed_scene(&mut random), 0, |_| true);
    let best = tracer.level;
    for (direction, origins, active) in packets(&mut random) {
        let mut answers = [best, Level::baseline()].into_iter().map(|level| {
            tracer.level = level;
            let mut hits = [None; 64];
            tracer.closest_along(direction, &origins, (1.0, active), &mut hits);
            let mask = tracer.occluded_along(direction, &origins, 0.5, active);
            let single = origins.first().map(|&o| tracer.closest(o, direction, 1.0));
            (hits, mask, single)
        });
        assert_eq!(answers.next(), answers.next());
    }
}

#[test]
fn packets_that_are_not_numbers_hit_nothing_and_spoil_no_others() {
    let tracer = single(&diced_box(2));
    let origins = [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::splat(0.5)];
    let along = |direction, max| tracer.occluded_along(direction, &origins, max, u64::MAX);
    assert_eq!(along(Vec3::X, f32::INFINITY), 0b1001);
    assert_eq!(along(Vec3::X, 0.75), 0b1000);
    for direction in [Vec3::NAN, Vec3::ZERO, Vec3::INFINITY] {
        assert_eq!(along(direction, f32::INFINITY), 0);
    }
    for max_distance in [0.0, -1.0, f32::NAN] {
        assert_eq!(along(Vec3::X, max_distance), 0);
    }
    let mut hits = [None; 64];
    tracer.closest_along(Vec3::X, &origins, (2.0, u64::MAX), &mut hits);
    assert!(hits[0].is_some_and(|hit| hit.distance == 1.0) && hits[1].is_none());
    let empty = Tracer::new(&scene(Vec::new(), &[]));
    assert_eq!(empty.occluded_along(Vec3::X, &origins, 1.0, u64::MAX), 0);
}

#[test]
fn packets_do_not_leak_out_of_a_closed_box_through_edges_and_vertices() {
    let mut random = Random(79);
    let turned = Mat3::from_rotation_y(0.7) * Mat3::from_rotation_x(0.3);
    for (matrix, offset) in [
        (Mat3::IDENTITY, Vec3::ZERO),
        (turned, Vec3::splat(0.3)),
        (turned * 1e-4, Vec3::splat(1e-5)),
        (turned, Vec3::new(40.0, -7.0, 90.0)),
    ] {
        let triangles: Vec<_> = (diced_box(7).iter())
            .map(|t| t.map(|p| matrix * p + offset))
            .collect();
        let tracer = single(&triangles);
        for _ in 0..5000 {
            let direction = (matrix * random.direction()).normalize();
            let (mut origins, mut hits) = (Vec::new(), [None; 64]);
            while origins.len() < 64 {
                let at = (random.next() * triangles.len() as f32) as usize % triangles.len();
                let target = triangles[at][0].lerp(triangles[at][1], random.next().round());
                let back = matrix.determinant().cbrt() * (0.01 + random.next());
                let origin = target - direction * back;
                let local = matrix.inverse() * (origin - offset);
                if local.abs().max_element() < 0.99 {
                    origins.push(origin);
                } else {
                    origins.push(matrix * (random.vector() * 0.99) + offset);
                }
            }
            let mask = tracer.occluded_along(direction, &origins, f32::INFINITY, u64::MAX);
            assert_eq!(mask, u64::MAX, "{direction}");
            tracer.closest_along(direction, &origins, (f32::INFINITY, u64::MAX), &mut hits);
            assert!(hits.iter().all(|hit| hit.is_some_and(|hit| !hit.front)));
        }
    }
}
