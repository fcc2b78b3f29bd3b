//! Cameras against places worked out by hand.

use super::super::lens::tests::camera as turned_camera;
use super::super::testing::scene_of;
use super::*;
use crate::scene::{Mesh, Normals, PrimId};
use glam::Affine3A;

/// A quadrangle from corner `a` along `u` and `v`, facing `u × v`.
fn quad(a: Vec3, u: Vec3, v: Vec3) -> Mesh {
    Mesh {
        positions: vec![a, a + u, a + u + v, a + v],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        triangle_faces: vec![0, 0],
        normals: Normals::Flat,
        primvars: vec![],
        double_sided: false,
        closed: false,
        cage: None,
        scheme: "none".into(),
    }
}

/// First hit by trying all triangles, in f64.
#[expect(clippy::cast_possible_truncation, reason = "rounded to f32")]
fn cast(scene: &Scene, origin: Vec3, direction: Vec3, length: f32) -> Option<Hit> {
    let mut best: Option<Hit> = None;
    for (id, prim) in (0..).zip(&scene.prims) {
        let mesh = scene.mesh_of(prim);
        for (t, _) in (0..).zip(&mesh.triangles) {
            let [a, b, c] = mesh
                .corners(t as usize)
                .map(|p| prim.world_from_object.transform_point3(p).as_dvec3());
            let (u_axis, v_axis, d) = (b - a, c - a, direction.as_dvec3());
            let normal = u_axis.cross(v_axis);
            let (offset, facing) = (origin.as_dvec3() - a, -d.dot(normal));
            let distance = offset.dot(normal) / facing;
            let q = offset + d * distance;
            let area = normal.length_squared();
            let (u, v) = (
                q.cross(v_axis).dot(normal) / area,
                u_axis.cross(q).dot(normal) / area,
            );
            let limit = best.map_or(f64::from(length), |hit| f64::from(hit.distance));
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > 0.0 && distance < limit {
                best = Some(Hit {
                    distance: distance as f32,
                    prim: PrimId(id),
                    triangle: t,
                    u: u as f32,
                    v: v as f32,
                    front: facing > 0.0,
                });
            }
        }
    }
    best
}

fn cast_all(scene: &Scene, sights: &mut Sights) {
    for (ray, found) in sights.rays.iter().zip(&mut sights.layers) {
        let hit = cast(scene, ray.origin, ray.direction, ray.length);
        found.extend(hit.map(|hit| Layer { hit, opacity: 1.0 }));
    }
}

fn look(scene: &Scene, camera: &Camera, frame: Frame, samples: u32) -> Receivers {
    let cast = |sights: &mut Sights| cast_all(scene, sights);
    place_with(scene, &cast, (camera, frame), &Sampling::uniform(samples))
}

fn shares(receivers: &Receivers) -> &[PixelShare] {
    match &receivers.target {
        Target::Image { shares, .. } => shares,
        other => panic!("{other:?}"),
    }
}

/// At (0, 0, 5) looking along −Z; the window at distance 5 is 4 × 2 units.
fn simple_camera() -> Camera {
    Camera {
        world_from_camera: DAffine3::from_translation(DVec3::Z * 5.0),
        horizontal_aperture: 40.0,
        vertical_aperture: 20.0,
        horizontal_aperture_offset: 0.0,
        vertical_aperture_offset: 0.0,
        focal_length: 50.0,
        clipping_range: (1.0, 100.0),
        ..turned_camera(Projection::Perspective)
    }
}

fn wall(half_width: f32) -> Mesh {
    quad(
        Vec3::new(-half_width, -1.5, 0.0),
        Vec3::X * 2.0 * half_width,
        Vec3::Y * 3.0,
    )
}

#[test]
fn pixel_centers_fall_where_the_window_says() {
    let scene = scene_of(vec![(wall(2.5), Affine3A::IDENTITY)]);
    for samples in [1, 3] {
        let receivers = look(&scene, &simple_camera(), Frame::new(40, 20), samples);
        // One receiver a pixel, but two where the diagonal of the quadrangle is not crossed at the mean.
        assert_eq!(receivers.len(), 800);
        for share in shares(&receivers) {
            let (x, y) = (share.pixel % 40, share.pixel / 40);
            let center = Vec3::new(
                -2.0 + (x as f32 + 0.5) / 10.0,
                1.0 - (y as f32 + 0.5) / 10.0,
                0.0,
            );
            let receiver = share.receiver as usize;
            // A third of a pixel: the representative hit where a pixel spans both triangles.
            let tolerance = if samples == 1 { 1e-5 } else { 0.034 };
            assert!(receivers.position[receiver].distance(center) < tolerance);
            assert!((receivers.depth[receiver] - 5.0).abs() < 1e-5);
            assert_eq!(receivers.normal[receiver], Vec3::Z);
            assert!((share.weight - 1.0).abs() < 1e-6);
            // A pixel is 0.1 × 0.1 units.
            assert!((receivers.surface[receiver].footprint - 0.1).abs() < 2e-3);
        }
    }
}

#[test]
fn shares_sum_to_the_exact_coverage_of_an_edge() {
    // The wall ends at x = 0.133…: pixel 21 of 40 is covered for a third.
    let mut wall = wall(1.0);
    wall.positions[1].x = 2.0 / 15.0;
    wall.positions[2].x = 2.0 / 15.0;
    let scene = scene_of(vec![(wall, Affine3A::IDENTITY)]);
    let receivers = look(&scene, &simple_camera(), Frame::new(40, 20), 4);
    let coverage = |pixel: u32| {
        shares(&receivers)
            .iter()
            .filter(|s| s.pixel == pixel)
            .map(|s| s.weight)
            .sum::<f32>()
    };
    assert_eq!(coverage(10 * 40 + 20), 1.0);
    // 16 distinct columns: to 1/32.
    assert!((coverage(10 * 40 + 21) - 1.0 / 3.0).abs() <= 1.0 / 32.0 + 1e-6);
    assert_eq!(coverage(10 * 40 + 22), 0.0);
}

#[test]
fn a_fold_and_a_step_in_one_pixel_are_receivers_of_their_own() {
    let floor = quad(Vec3::new(-9.0, 0.0, 0.0), Vec3::Z * 4.0, Vec3::X * 18.0);
    let back = quad(Vec3::new(-9.0, 0.0, 0.0), Vec3::X * 18.0, Vec3::Y * 9.0);
    let camera = Camera {
        world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 1.0, 5.0)),
        ..simple_camera()
    };
    let scene = scene_of(vec![
        (floor, Affine3A::IDENTITY),
        (back, Affine3A::IDENTITY),
    ]);
    // One pixel: sees the fold through its lower half.
    let receivers = look(
        &scene,
        &camera,
        Frame {
            pixel_aspect_ratio: 1.0,
            ..Frame::new(1, 1)
        },
        8,
    );
    assert_eq!(receivers.len(), 2);
    assert_eq!(receivers.prim.iter().sum::<u32>(), 1);
    assert!(receivers.normal.contains(&Vec3::Y) && receivers.normal.contains(&Vec3::Z));
    // Two parallel walls, one far behind the other's edge.
    let step = scene_of(vec![
        (
            quad(Vec3::new(-9.0, -9.0, 0.0), Vec3::X * 9.0, Vec3::Y * 18.0),
            Affine3A::IDENTITY,
        ),
        (
            wall(50.0),
            Affine3A::from_scale_rotation_translation(
                Vec3::splat(30.0),
                glam::Quat::IDENTITY,
                Vec3::Z * -60.0,
            ),
        ),
    ]);
    let receivers = look(&step, &simple_camera(), Frame::new(1, 1), 4);
    assert_eq!(receivers.len(), 2);
    assert!(
        shares(&receivers)
            .iter()
            .all(|share| (share.weight - 0.5).abs() < 0.13)
    );
}

#[test]
fn backs_are_lit_on_the_side_that_is_seen_and_clipping_is_honored() {
    let away = quad(Vec3::new(-2.5, -1.5, 0.0), Vec3::Y * 3.0, Vec3::X * 5.0);
    let scene = scene_of(vec![(away, Affine3A::IDENTITY)]);
    let receivers = look(&scene, &simple_camera(), Frame::new(4, 2), 2);
    assert_eq!(receivers.len(), 8);
    assert!(
        receivers
            .normal
            .iter()
            .chain(&receivers.geometric_normal)
            .all(|n| *n == Vec3::Z)
    );
    for clipping_range in [(5.01, 100.0), (1.0, 4.99)] {
        let clipped = Camera {
            clipping_range,
            ..simple_camera()
        };
        assert!(look(&scene, &clipped, Frame::new(4, 2), 2).is_empty());
    }
}

#[test]
fn scenes_far_from_the_origin_are_seen_like_near_ones() {
    let near = scene_of(vec![(wall(2.5), Affine3A::IDENTITY)]);
    let shift = DVec3::splat(1e7);
    let far = Scene {
        origin: shift,
        ..scene_of(vec![(wall(2.5), Affine3A::IDENTITY)])
    };
    let moved = Camera {
        world_from_camera: DAffine3::from_translation(shift + DVec3::Z * 5.0),
        ..simple_camera()
    };
    let (a, b) = (
        look(&near, &simple_camera(), Frame::new(8, 4), 2),
        look(&far, &moved, Frame::new(8, 4), 2),
    );
    assert_eq!(a.position, b.position);
    assert_eq!(b.origin, shift);
}

#[test]
fn the_automatic_camera_sees_every_corner_and_fills_the_frame() {
    for up_axis in [crate::scene::UpAxis::Y, crate::scene::UpAxis::Z] {
        let mut scene = scene_of(vec![(
            quad(
                Vec3::new(3.0, -1.0, 2.0),
                Vec3::X * 4.0,
                Vec3::new(0.0, 1.0, 7.0),
            ),
            Affine3A::IDENTITY,
        )]);
        scene.stage.up_axis = up_axis;
        scene.origin = DVec3::new(1e6, 0.0, 0.0);
        let camera = framing_camera(&scene);
        let lens = Lens::new(&camera, Frame::new(13_704, 10_000));
        let bounds = scene.bounds();
        let mut reach = 0.0_f64;
        for corner in 0..8 {
            let pick = |axis: usize| {
                if corner >> axis & 1 == 0 {
                    bounds.min[axis]
                } else {
                    bounds.max[axis]
                }
            };
            let point = Vec3::new(pick(0), pick(1), pick(2)).as_dvec3() + scene.origin;
            let clip = lens.world_to_ndc() * point.extend(1.0);
            let ndc = clip.truncate() / clip.w;
            assert!(clip.w > camera.clipping_range.0 && clip.w < camera.clipping_range.1);
            reach = reach.max((ndc.x - 0.5).abs()).max((ndc.y - 0.5).abs());
        }
        assert!((0.45..0.5).contains(&reach), "{reach}");
        // Upright: the up axis points up in the image.
        let up = camera.world_from_camera.matrix3.transpose() * up_axis.direction().as_dvec3();
        assert!(up.y > 0.5 && up.x.abs() < 1e-12);
    }
    assert!(
        framing_camera(&scene_of(vec![]))
            .world_from_camera
            .is_finite()
    );
}

/// Pixels of one face of `normals`, and of more: those of one are what a cluster of all their samples is.
fn pixels_of_one_face(normals: Normals) -> usize {
    let mesh = Mesh {
        normals,
        ..quad(
            Vec3::new(-1.5, -0.8, -1.0),
            Vec3::new(3.0, 0.0, 1.0),
            Vec3::new(0.2, 1.7, 0.0),
        )
    };
    let scene = scene_of(vec![(mesh, Affine3A::from_scale(Vec3::new(1.0, 1.0, 2.0)))]);
    let sampling = Sampling::uniform(4);
    let cast = |sights: &mut Sights| cast_all(&scene, sights);
    let camera = simple_camera();
    let view = View::new(&scene, &cast, (&camera, Frame::new(16, 8)), &sampling);
    let (mut rays, mut sights) = (Vec::new(), Sights::default());
    let (mut clusters, mut face) = (Clusters::default(), None);
    let mut count = 0;
    for pixel in 0..16 * 8 {
        view.look_through((pixel % 16, pixel / 16), &mut rays, &mut sights);
        cast_all(&scene, &mut sights);
        let Some(seen) = view.of_one_face(&rays, &sights.layers, &mut face) else {
            continue;
        };
        view.cluster(&rays, &sights.layers, &mut face, &mut clusters);
        let [cluster] = clusters.all() else {
            panic!("{} surfaces", clusters.count);
        };
        let all = view.merge(cluster, 1.0);
        assert!(seen.position.distance(all.position) < 1e-5);
        assert!(
            seen.normal.distance(all.normal) < 1e-4,
            "{} {}",
            seen.normal,
            all.normal
        );
        assert!((seen.depth - all.depth).abs() < 1e-5);
        assert_eq!(
            (seen.geometric_normal, seen.front),
            (all.geometric_normal, all.front)
        );
        assert_eq!(seen.surface.triangle, all.surface.triangle);
        let size = seen.surface.footprint / all.surface.footprint;
        assert!((size - 1.0).abs() < 0.1 && seen.toward_eye.distance(all.toward_eye) < 0.1);
        count += 1;
    }
    count
}

#[test]
fn the_receiver_of_one_face_is_that_of_all_its_samples() {
    let flat = pixels_of_one_face(Normals::Flat);
    assert!((30..90).contains(&flat), "{flat}");
    let around = |bend: f32| {
        let corner = |x: f32, y: f32| Vec3::new(bend * x, bend * y, 1.0).normalize();
        Normals::Vertex(vec![
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ])
    };
    assert_eq!(pixels_of_one_face(around(0.03)), flat);
    // Normals so far apart may be those of two surfaces.
    assert_eq!(pixels_of_one_face(around(0.5)), 0);
}
