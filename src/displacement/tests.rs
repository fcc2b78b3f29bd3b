use super::*;
use crate::scene::{Cage, Input, Interpolation, Material, MaterialId, Normals, Primvar};
use crate::trace::testing::{self, mesh, scene};
use glam::{Affine3A, Vec3, Vec4};

/// A box of half edge 1 with a face of two triangles a side, flat, its corners shared.
fn cube() -> Mesh {
    let (positions, quads) = testing::cube(2.0);
    let triangles = quads
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
        .collect();
    Mesh {
        positions,
        triangles,
        triangle_faces: (0..12).map(|t| t / 2).collect(),
        closed: true,
        cage: Some(Cage {
            point_count: 8,
            face_vertex_counts: vec![4; 6],
            face_vertex_indices: quads.concat(),
            ..Cage::default()
        }),
        ..mesh(&[])
    }
}

fn displaced_by(mesh: Mesh, displacement: Input, places: &[Affine3A]) -> Scene {
    let prims: Vec<_> = places.iter().map(|&place| (0, place)).collect();
    let mut scene = scene(vec![mesh], &prims);
    scene.materials.push(Material {
        displacement,
        ..Material::default()
    });
    for prim in &mut scene.prims {
        prim.materials = FaceMaterials::Whole(Some(MaterialId(0)));
    }
    let diagnostics = Diagnostics::default();
    displace(&mut scene, &diagnostics);
    assert!(diagnostics.warnings().is_empty());
    scene
}

#[test]
fn an_even_displacement_moves_corners_along_the_diagonal_and_keeps_flat_faces_flat() {
    let scene = displaced_by(cube(), Input::scalar(0.3), &[Affine3A::IDENTITY]);
    let [moved] = &scene.meshes[..] else {
        panic!("one mesh")
    };
    let length = f32::sqrt(3.0) + 0.3;
    for (before, after) in cube().positions.iter().zip(&moved.positions) {
        assert!(after.distance(before.normalize() * length) < 1e-6);
    }
    for t in 0..moved.triangles.len() {
        assert!(
            moved
                .shading_normal(t, 0.2, 0.3)
                .distance(cube().plane_normal(t))
                < 1e-5
        );
    }
    let cage = moved.cage.as_ref().expect("as before");
    assert_eq!((cage.point_count, cage.corner_normals.len()), (8, 24));
    for (normal, position) in cage.point_normals.iter().zip(&moved.positions) {
        assert!(normal.distance(position.normalize()) < 1e-5);
    }
}

#[test]
fn heights_are_world_lengths_whatever_a_prim_is_scaled_by() {
    let places = [1.0, 2.0, 2.0].map(|scale| Affine3A::from_scale(Vec3::splat(scale)));
    let turned = Affine3A::from_axis_angle(Vec3::new(1.0, 2.0, 0.5).normalize(), 0.7);
    let stretched = Affine3A::from_scale(Vec3::new(1.0, 3.0, 1.0));
    let places = [places[0], places[1], turned * places[2], turned * stretched];
    let scene = displaced_by(cube(), Input::scalar(0.3), &places);
    // One for each size, not for each prim.
    assert_eq!(scene.meshes.len(), 3);
    assert_eq!(scene.prims[1].mesh, scene.prims[2].mesh);
    for prim in &scene.prims {
        let moved = scene.mesh_of(prim);
        for (before, after) in cube().positions.iter().zip(&moved.positions) {
            let [before, after] =
                [before, after].map(|p| prim.world_from_object.transform_point3(*p));
            assert!((after.distance(before) - 0.3).abs() < 1e-5);
        }
    }
}

#[test]
fn a_height_that_differs_at_a_corner_of_faces_leaves_no_gap() {
    let mut cube = cube();
    let values: Vec<Vec4> = (0..36)
        .map(|i| Vec4::new(0.1 * (i % 7) as f32, 0.0, 0.0, 1.0))
        .collect();
    cube.primvars.push(Primvar {
        name: "height".to_owned(),
        components: 1,
        interpolation: Interpolation::Corner(
            (0..12).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        ),
        values,
    });
    let height = Input::Primvar {
        name: "height".to_owned(),
        fallback: Vec4::ZERO,
    };
    let scene = displaced_by(cube.clone(), height, &[Affine3A::IDENTITY]);
    let moved = &scene.meshes[0];
    assert_eq!(moved.triangles, cube.triangles);
    // Weighted by the angles: a right one of a side at each corner, whichever way its triangles are cut.
    let corner = |position: u32| {
        let mut sum = 0.0;
        for (t, triangle) in cube.triangles.iter().enumerate() {
            if let Some(k) = triangle.iter().position(|p| *p == position) {
                // The right angle is at corner 1 of a side's first triangle and 2 of its second.
                let weight = if k == 1 + t % 2 { 2.0 } else { 1.0 };
                sum += weight * 0.1 * ((3 * t + k) % 7) as f32;
            }
        }
        sum / 6.0
    };
    for position in 0..8 {
        let (before, after) = (
            cube.positions[position as usize],
            moved.positions[position as usize],
        );
        let by = after.length() - before.length();
        assert!(
            (by - corner(position)).abs() < 1e-5,
            "{position}: {by} {}",
            corner(position)
        );
    }
}

#[test]
fn undisplaced_prims_of_the_same_mesh_keep_theirs_and_normals_may_point_anywhere() {
    let mut smooth = cube();
    smooth.normals = Normals::Vertex(smooth.positions.iter().map(|p| p.normalize()).collect());
    let mut scene = scene(
        vec![smooth.clone()],
        &[(0, Affine3A::IDENTITY), (0, Affine3A::IDENTITY)],
    );
    scene.materials.push(Material {
        displacement: Input::scalar(-0.5),
        ..Material::default()
    });
    scene.prims[1].materials = FaceMaterials::Whole(Some(MaterialId(0)));
    displace(&mut scene, &Diagnostics::default());
    assert_eq!(scene.mesh_of(&scene.prims[0]), &smooth);
    let moved = scene.mesh_of(&scene.prims[1]);
    let Normals::Vertex(normals) = &moved.normals else {
        panic!("one a position")
    };
    for (normal, position) in normals.iter().zip(&moved.positions) {
        assert!((position.length() - f32::sqrt(3.0) + 0.5).abs() < 1e-5);
        assert!(normal.distance(position.normalize()) < 1e-3);
    }
}

#[test]
fn what_is_scaled_to_nothing_stays_where_it_is_with_a_warning() {
    let flat = Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0));
    let mut scene = scene(vec![cube()], &[(0, flat)]);
    scene.materials.push(Material {
        displacement: Input::scalar(1.0),
        ..Material::default()
    });
    scene.prims[0].materials = FaceMaterials::Whole(Some(MaterialId(0)));
    let diagnostics = Diagnostics::default();
    displace(&mut scene, &diagnostics);
    assert_eq!(scene.meshes[0], cube());
    assert_eq!(diagnostics.warnings()[0].kind, "flat-displacement");
}

#[test]
fn faces_with_points_of_their_own_stay_together_and_surfaces_back_to_back_part() {
    let whole = cube();
    let triangles: Vec<[Vec3; 3]> = (0..12).map(|t| whole.corners(t)).collect();
    let scene = displaced_by(mesh(&triangles), Input::scalar(0.3), &[Affine3A::IDENTITY]);
    let length = f32::sqrt(3.0) + 0.3;
    for position in &scene.meshes[0].positions {
        let expected = position.signum() / f32::sqrt(3.0) * length;
        assert!(position.distance(expected) < 1e-6, "{position}");
    }
    let one = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let other = [Vec3::ZERO, Vec3::Y, Vec3::X];
    let scene = displaced_by(
        mesh(&[one, other]),
        Input::scalar(0.2),
        &[Affine3A::IDENTITY],
    );
    let heights: Vec<f32> = scene.meshes[0].positions.iter().map(|p| p.z).collect();
    assert_eq!(heights, [0.2, 0.2, 0.2, -0.2, -0.2, -0.2]);
}
