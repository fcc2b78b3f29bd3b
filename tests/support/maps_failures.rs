//! Scenes that depth maps are known to fail in. Truth is a closed form, or rays on the same scene; what maps hand over
//! counts as theirs.

use crate::dense::{self, bumpy_ball, vertices};
use crate::scenes::{Side, bowl, plate, receivers_in, triangle_mesh};
use crate::{every, scene_of, see, visibility_error};
use glam::{Affine3A, Vec3};
use surflux::gather::maps::MapsSettings;
use surflux::receivers::Receivers;
use surflux::scene::{Mesh, MeshId, Prim, PrimId, Scene};

/// What 256 directions alone may cost: 1 % on dense smooth meshes, up to half as much again in darker scenes.
const DIRECTIONS_ERROR: f32 = 0.017;

fn few() -> MapsSettings {
    MapsSettings::default()
}

fn assert_error(scene: &Scene, receivers: &Receivers, settings: &MapsSettings, most: f32) {
    let error = visibility_error(scene, receivers, settings);
    assert!(error < most, "{error}");
}

/// `base` once for each of `places`.
fn copies(base: Mesh, places: impl Iterator<Item = Affine3A>) -> Scene {
    let mut scene = scene_of(vec![base]);
    let prim = scene.prims[0].clone();
    scene.prims = (0..)
        .zip(places)
        .map(|(k, place): (u32, Affine3A)| Prim {
            path: format!("/World/copy{k}").into(),
            mesh: MeshId(0),
            world_from_object: place,
            ..prim.clone()
        })
        .collect();
    scene
}

#[test]
fn a_vertex_whose_fan_folds_is_as_dark_as_rays_find_it() {
    let mut floor = plate(Vec3::ZERO, Vec3::Z, Vec3::X, 12);
    let heights = floor.positions.iter_mut();
    heights.for_each(|p| p.y = 0.05 * (9.0 * p.x).sin() * (8.0 * p.z).cos());
    // One vertex is pulled over its neighbors: faces of three fans lie upside down.
    floor.positions[6 * 13 + 6] += Vec3::new(0.2, 0.02, 0.1);
    let scene = scene_of(vec![floor]);
    let receivers = vertices(&scene);
    assert_error(&scene, &receivers, &few(), DIRECTIONS_ERROR);
}

#[test]
fn slivers_a_thousand_times_as_long_as_wide_are_seen_as_by_rays() {
    // A bowl of 6000 slivers, which leave its bottom as a fan of rings: seen from inside.
    let cells = 3000_u32;
    let rings = 4_u32;
    let at = |i: u32, j: u32| {
        let turn = std::f32::consts::TAU * i as f32 / cells as f32;
        let polar = 0.3 + 1.2 * j as f32 / rings as f32;
        let (sin, cos) = polar.sin_cos();
        Vec3::new(sin * turn.cos(), -cos, sin * turn.sin())
    };
    let positions = (0..cells).flat_map(|i| (0..=rings).map(move |j| at(i, j)));
    let corner = |i: u32, j: u32| (i % cells) * (rings + 1) + j;
    let triangles = (0..cells).flat_map(|i| {
        (0..rings).flat_map(move |j| {
            let [a, b, c, d] = [
                corner(i, j),
                corner(i, j + 1),
                corner(i + 1, j + 1),
                corner(i + 1, j),
            ];
            [[a, b, c], [a, c, d]]
        })
    });
    let mesh = triangle_mesh(positions.collect(), triangles.collect(), Vec::new(), false);
    let scene = scene_of(vec![mesh]);
    let receivers = every(&receivers_in(&scene, PrimId(0), 1), 101);
    assert_error(&scene, &receivers, &few(), DIRECTIONS_ERROR);
}

/// A plate with a ball of a hundredth of its edges' length in its middle, in one mesh.
fn uneven() -> (Scene, usize) {
    let mut mesh = plate(Vec3::ZERO, 40.0 * Vec3::Z, 40.0 * Vec3::X, 60);
    let heights = mesh.positions.iter_mut();
    heights.for_each(|p| p.y = 0.3 * (p.x + 0.5 * p.z).sin());
    let coarse = mesh.positions.len();
    let ball = bumpy_ball(6, Vec3::ZERO);
    let first = u32::try_from(coarse).expect("a small mesh");
    let at = Vec3::new(20.1, 1.0, 20.2);
    mesh.positions
        .extend(ball.positions.iter().map(|&p| at + 0.02 * p));
    mesh.triangles
        .extend(ball.triangles.iter().map(|t| t.map(|i| i + first)));
    let mesh = triangle_mesh(mesh.positions, mesh.triangles, Vec::new(), false);
    (scene_of(vec![mesh]), coarse)
}

#[test]
fn fine_parts_of_a_coarse_prim_are_not_lost_in_its_pixels() {
    let (scene, coarse) = uneven();
    let all = vertices(&scene);
    let fine = all.subset(&(coarse..all.len()).collect::<Vec<_>>());
    assert_error(&scene, &fine, &few(), DIRECTIONS_ERROR);
    let rest = every(&all.subset(&(0..coarse).collect::<Vec<_>>()), 31);
    assert_error(&scene, &rest, &few(), DIRECTIONS_ERROR);
}

#[test]
fn small_things_on_a_huge_curved_ground_see_what_rays_see() {
    // A hill of radius 2000, edges of 50, and a ball of radius 1 that touches its top.
    let hill = bowl(Vec3::new(0.0, -2000.0, 0.0), 2000.0, 0.9, 60, Side::Outside);
    let ball = bumpy_ball(30, Vec3::new(0.0, 1.1, 0.0));
    let scene = scene_of(vec![hill, ball]);
    let receivers = receivers_in(&scene, PrimId(1), 53);
    assert_error(&scene, &receivers, &few(), DIRECTIONS_ERROR);
}

#[test]
fn six_hundred_instances_of_a_mesh_shade_each_other_as_rays_say() {
    let places = (0..25_u8).flat_map(|i| (0..24_u8).map(move |j| (f32::from(i), f32::from(j))));
    let places = places
        .map(|(x, z)| Affine3A::from_translation(Vec3::new(2.1 * x, (x * 1.7 + z).sin(), 2.1 * z)));
    let scene = copies(bumpy_ball(8, Vec3::ZERO), places);
    let receivers = every(&vertices(&scene), 991);
    // Balls of 768 triangles: pixels of half an edge.
    let settings = MapsSettings {
        pixel: 0.5,
        ..few()
    };
    assert_error(&scene, &receivers, &settings, DIRECTIONS_ERROR);
}

#[test]
fn size_and_place_do_not_matter() {
    let with = |place: Affine3A| {
        let mut scene = dense::on_ground(bumpy_ball(24, Vec3::ZERO), 8);
        for prim in &mut scene.prims {
            prim.world_from_object = place;
        }
        scene
    };
    let judge = |scene: &Scene| see(scene, &vertices(scene), &few());
    let here = judge(&with(Affine3A::IDENTITY));
    for scale in [1e-4, 1e5] {
        let there = judge(&with(Affine3A::from_scale(Vec3::splat(scale))));
        let pairs = here.visibility.iter().zip(&there.visibility);
        let off = pairs.fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
        // Roundings move receivers over the edges of a few pixels: directions of 1/256 each.
        assert!(off < 0.03, "{scale}: {off}");
    }
    // A million off with a size of 400: f32 leaves steps of an eighth, as much of the gap to the ground.
    let far = Vec3::new(1e6, -1e6, 2e6);
    let scene = with(Affine3A::from_translation(far) * Affine3A::from_scale(Vec3::splat(200.0)));
    let receivers = every(&vertices(&scene), 7);
    assert_error(&scene, &receivers, &few(), 0.03);
}

#[test]
fn corners_of_a_box_made_of_plates_are_dark() {
    let x = Vec3::X;
    let (y, z) = (Vec3::Y, Vec3::Z);
    let one = Vec3::ONE;
    let wall = |corner, u, v| {
        let mut wall = plate(corner, u, v, 4);
        let is_rim = |p: &Vec3| {
            let at = *p - corner;
            [at.dot(u), at.dot(v)]
                .iter()
                .any(|x| *x == 0.0 || *x == 1.0)
        };
        let cage = wall.cage.as_mut().expect("made with a cage");
        cage.on_boundary = wall.positions.iter().map(is_rim).collect();
        wall
    };
    let plates = [
        wall(Vec3::ZERO, z, x),
        wall(Vec3::ZERO, x, y),
        wall(Vec3::ZERO, y, z),
        wall(one, -x, -z),
        wall(one, -y, -x),
        wall(one, -z, -y),
    ];
    let scene = scene_of(plates.into());
    // Vertices, those on the edges of the box among them: pulled inwards by a little, as all on open edges are.
    let receivers: Receivers = vertices(&scene);
    let seen = see(&scene, &receivers, &few());
    let most = seen.visibility.iter().copied().fold(0.0, f32::max);
    assert!(most < 1e-3, "{most}");
}

#[test]
fn limited_distances_are_exact_where_far_surfaces_hide_near_ones() {
    // Above the floor a small lid within the limit, above that a large one beyond it: along many directions the last
    // surface is beyond, and the one before it counts.
    let floor = plate(Vec3::ZERO, Vec3::Z, Vec3::X, 10);
    let lift = |mut mesh: Mesh, bend: f32| {
        let heights = mesh.positions.iter_mut();
        heights.for_each(|p| p.y += bend * ((p.x - 0.5).powi(2) + (p.z - 0.5).powi(2)));
        mesh
    };
    let near = lift(
        plate(Vec3::new(0.3, 0.2, 0.3), 0.4 * Vec3::Z, 0.4 * Vec3::X, 6),
        0.3,
    );
    let far = lift(
        plate(Vec3::new(-2.0, 1.5, -2.0), 5.0 * Vec3::Z, 5.0 * Vec3::X, 30),
        0.02,
    );
    let scene = scene_of(vec![floor, near, far]);
    let receivers = every(&vertices(&scene), 3);
    let settings = MapsSettings {
        max_distance: Some(0.8),
        ..few()
    };
    assert_error(&scene, &receivers, &settings, DIRECTIONS_ERROR);
}
