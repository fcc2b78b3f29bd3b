//! Subdivided surfaces against limits that are known.

use super::super::super::super::raw::Value;
use super::super::attributes::ints;
use super::super::tests::{mesh, with_attribute, with_ints, with_token};
use super::*;
use glam::Vec2;

const CUBE_INDICES: [i32; 24] = [
    0, 1, 3, 2, 2, 3, 5, 4, 4, 5, 7, 6, 6, 7, 1, 0, 1, 7, 5, 3, 6, 0, 2, 4,
];

/// Corners at ±1.
fn cube() -> RawPrim {
    let corners = [
        [-1., -1., 1.],
        [1., -1., 1.],
        [-1., 1., 1.],
        [1., 1., 1.],
        [-1., 1., -1.],
        [1., 1., -1.],
        [-1., -1., -1.],
        [1., -1., -1.],
    ];
    let prim = mesh("/m", &corners.map(Vec3::from_array), &[4; 6], &CUBE_INDICES);
    with_token(prim, "subdivisionScheme", "catmullClark")
}

/// `side`² quads over `side + 1` points a side on the unit square, lifted by `height`.
fn grid(side: u8, height: impl Fn(Vec2) -> f32) -> RawPrim {
    let at = |i: u8| f32::from(i) / f32::from(side);
    let points: Vec<Vec3> = (0..=side)
        .flat_map(|y| (0..=side).map(move |x| (x, y)))
        .map(|(x, y)| {
            let p = Vec2::new(at(x), at(y));
            p.extend(height(p))
        })
        .collect();
    let row = i32::from(side) + 1;
    let indices: Vec<i32> = (0..i32::from(side))
        .flat_map(|y| (0..i32::from(side)).map(move |x| y * row + x))
        .flat_map(|i| [i, i + 1, i + 1 + row, i + row])
        .collect();
    let counts = vec![4; usize::from(side) * usize::from(side)];
    let prim = mesh("/m", &points, &counts, &indices);
    with_token(prim, "subdivisionScheme", "catmullClark")
}

fn sharp_edges(prim: RawPrim, pairs: &[i32], sharpness: f32) -> RawPrim {
    let count = pairs.len() / 2;
    let prim = with_ints(prim, "creaseIndices", pairs);
    let prim = with_ints(prim, "creaseLengths", &vec![2; count]);
    let sharpnesses = Value::FloatArray(vec![sharpness; count]);
    with_attribute(prim, "creaseSharpnesses", sharpnesses, None)
}

fn refine_with(prim: &RawPrim, level: usize, names: &[&str]) -> (Mesh, Vec<String>) {
    let names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
    let diagnostics = Diagnostics::default();
    let authored = AuthoredMesh::read(std::borrow::Cow::Borrowed(prim), &[], &names, &diagnostics);
    let mesh = subdivide(authored.unwrap().unwrap(), level, &diagnostics);
    let kinds = diagnostics.warnings().into_iter().map(|w| w.kind);
    (mesh, kinds.collect())
}

fn refine(prim: &RawPrim, level: usize) -> Mesh {
    let (mesh, warnings) = refine_with(prim, level, &[]);
    assert_eq!(warnings, Vec::<String>::new());
    mesh
}

fn area(mesh: &Mesh) -> f64 {
    let doubled = (0..mesh.triangles.len()).map(|t| {
        let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3());
        (b - a).cross(c - a).length()
    });
    0.5 * doubled.sum::<f64>()
}

fn point_normals(mesh: &Mesh) -> &[Vec3] {
    &mesh.cage.as_ref().unwrap().point_normals
}

/// Halstead et al.: (n² V + 4 Σ E + Σ F) / (n (n + 5)) with n = 3 halves the corners of a cube.
#[test]
fn corners_of_a_cube_have_their_limit_at_half_at_every_level() {
    for level in 0..=3 {
        let mesh = refine(&cube(), level);
        for corner in 0..8 {
            let sign = Vec3::from_array(mesh.positions[corner].to_array().map(f32::signum));
            assert!(mesh.positions[corner].distance(0.5 * sign) < 1e-6);
            assert!(point_normals(&mesh)[corner].distance(sign.normalize()) < 1e-6);
        }
        assert_eq!(
            mesh.triangles.len(),
            6 * 4_usize.pow(u32::try_from(level).unwrap()) * 2
        );
        assert!(mesh.closed && mesh.scheme == "catmullClark");
        assert!(matches!(mesh.normals, Normals::Vertex(_)));
    }
}

/// Where the control points are regular the limit is a bicubic B-spline: 4/6, 1/6, 1/6 along both axes.
#[test]
fn regular_vertices_have_the_bicubic_b_spline_as_limit() {
    let height = |p: Vec2| (7.0 * p.x + 3.0 * p.y).sin();
    let mesh = refine(&grid(4, height), 2);
    let sample = |x: f32, y: f32| height(Vec2::new(0.5 + x, 0.5 + y));
    let weights = [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0];
    let slopes = [-0.5 * 4.0, 0.0, 0.5 * 4.0];
    let blend = |u: [f32; 3], v: [f32; 3]| -> f32 {
        let along = |j: usize, y: f32| {
            (0..3)
                .zip([-0.25, 0.0, 0.25])
                .map(|(i, x)| u[i] * v[j] * sample(x, y))
                .sum::<f32>()
        };
        (0..3)
            .zip([-0.25, 0.0, 0.25])
            .map(|(j, y)| along(j, y))
            .sum()
    };
    let middle = mesh.positions[12];
    assert!((middle.z - blend(weights, weights)).abs() < 1e-6);
    let normal = Vec3::new(-blend(slopes, weights), -blend(weights, slopes), 1.0);
    assert!(point_normals(&mesh)[12].distance(normal.normalize()) < 1e-5);
}

/// Limits do not depend on the level they are taken at, so the cage's own must be those of two levels further: with
/// holes, a point that no face uses, turned faces, sharp edges and seams.
#[test]
fn the_cage_alone_has_the_limits_of_its_refinement() {
    let mut prim = grid(4, |p| (7.0 * p.x + 3.0 * p.y).sin());
    if let Some(Value::Vec3Array(points)) = &mut prim.attributes.get_mut("points").unwrap().value {
        points.push(Vec3::splat(9.0));
    }
    let prim = with_token(prim, "orientation", "leftHanded");
    let prim = with_ints(prim, "holeIndices", &[3]);
    let prim = sharp_edges(prim, &[2, 7, 7, 12, 12, 17, 17, 22], 10.0);
    let corners: Vec<Vec2> = (0_u8..64)
        .map(|i| Vec2::new(f32::from(i % 7), f32::from(i / 9)))
        .collect();
    let corners = Value::Vec2Array(corners);
    let prim = with_attribute(prim, "primvars:st", corners, Some("faceVarying"));
    let vertices = Value::FloatArray(
        (0_u8..26)
            .map(|i| f32::from((i % 15) * (i % 15) % 11))
            .collect(),
    );
    let prim = with_attribute(prim, "primvars:w", vertices, Some("vertex"));
    let [cage, fine] = [0, 2].map(|level| refine_with(&prim, level, &["st", "w"]).0);
    assert_eq!(cage.positions.len(), 26);
    assert_eq!(cage.triangles.len(), 2 * 15);
    assert_eq!(cage.positions[25], Vec3::splat(9.0));
    for point in 0..26 {
        assert!(
            cage.positions[point].distance(fine.positions[point]) < 1e-5,
            "{point}"
        );
        let normals = [&cage, &fine].map(|mesh| point_normals(mesh)[point]);
        assert!(
            normals[0].distance(normals[1]) < 1e-5,
            "{point}: {normals:?}"
        );
        let values = [&cage, &fine].map(|mesh| mesh.primvar("w").unwrap().values[point]);
        assert!(values[0].distance(values[1]) < 1e-5, "{point}: {values:?}");
    }
    let corner_normals = [&cage, &fine].map(|mesh| &mesh.cage.as_ref().unwrap().corner_normals);
    assert_eq!(corner_normals[0].len(), 64);
    for (corner, (a, b)) in corner_normals[0].iter().zip(corner_normals[1]).enumerate() {
        assert!(a.distance(*b) < 1e-5, "corner {corner}: {a} {b}");
    }
    // Every corner of a face as itself has the limit of its seam-bounded patch, like the fine face in it.
    let at_point = |mesh: &Mesh, face: u32, point: u32| {
        let st = mesh.primvar("st").unwrap();
        let faces = mesh.triangles.iter().zip(&mesh.triangle_faces).enumerate();
        let mut of_face = faces.filter(|(_, (_, f))| **f == face);
        of_face.find_map(|(t, (triangle, _))| {
            let corner = triangle.iter().position(|&i| i == point)?;
            let Interpolation::Corner(corners) = &st.interpolation else {
                return None;
            };
            Some(st.values[corners[t][corner] as usize])
        })
    };
    for (face, first) in [(0, 0), (5, 6), (15, 18)] {
        for point in [first, first + 1, first + 6, first + 5] {
            let [a, b] = [&cage, &fine].map(|mesh| at_point(mesh, face, point).unwrap());
            assert!(a.distance(b) < 1e-5, "face {face} point {point}: {a} {b}");
        }
    }
}

/// Limit tangents belong to the surface, not to the level they are taken at; and far down the facets themselves
/// lean as the surface does.
fn assert_normals_converge(prim: &RawPrim) {
    let coarse = refine(prim, 1);
    let fine = refine(prim, 6);
    let count = point_normals(&coarse).len();
    let mut facets = vec![Vec3::ZERO; count];
    for (t, triangle) in fine.triangles.iter().enumerate() {
        for &i in triangle.iter().filter(|&&i| (i as usize) < count) {
            facets[i as usize] += fine.plane_normal(t);
        }
    }
    for (point, facet) in facets.iter().enumerate() {
        let normals = [&coarse, &fine].map(|mesh| point_normals(mesh)[point]);
        assert!(
            normals[0].distance(normals[1]) < 2e-4,
            "point {point}: {normals:?}"
        );
        let cage = coarse.cage.as_ref().unwrap();
        let mut uses = cage.face_vertex_indices.iter();
        if uses.by_ref().filter(|&&i| i as usize == point).count() == 1 {
            // At rounded corners of one face facets turn to the tangent plane as slowly as 1 / level.
            continue;
        }
        let facet = facet.normalize();
        assert!(
            normals[0].distance(facet) < 0.03,
            "point {point}: {normals:?} {facet}"
        );
    }
}

#[test]
fn catmull_clark_normals_converge_inside_and_on_boundaries() {
    let bumpy = grid(3, |p| 0.3 * (5.0 * p.x + 2.0 * p.y * p.y).sin());
    assert_normals_converge(&bumpy);
    let edge_only = with_token(bumpy, "interpolateBoundary", "edgeOnly");
    assert_normals_converge(&edge_only);
}

#[test]
fn loop_normals_converge_inside_and_on_boundaries() {
    let quads = grid(3, |p| 0.3 * (5.0 * p.x + 2.0 * p.y * p.y).sin());
    let points = super::super::attributes::vectors(&quads, "points");
    let corners = ints(&quads, "faceVertexIndices").chunks(4);
    let triangles: Vec<i32> = corners
        .flat_map(|q| [q[0], q[1], q[2], q[0], q[2], q[3]])
        .collect();
    let prim = mesh("/m", points, &[3; 18], &triangles);
    assert_normals_converge(&with_token(prim, "subdivisionScheme", "loop"));
}

#[test]
fn a_crease_across_a_sheet_splits_its_normals() {
    let roof = grid(4, |p| 0.5 - (p.x - 0.5).abs());
    let ridge = [2, 7, 7, 12, 12, 17, 17, 22];
    let mesh = refine(&sharp_edges(roof, &ridge, 10.0), 2);
    let cage = mesh.cage.as_ref().unwrap();
    assert!(matches!(mesh.normals, Normals::Corner { .. }));
    // Face-vertices of point 12 in the four faces around it, left and right of the ridge.
    let left = Vec3::new(-1.0, 0.0, 1.0).normalize();
    let right = Vec3::new(1.0, 0.0, 1.0).normalize();
    let at_ridge = cage
        .face_vertex_indices
        .iter()
        .zip(&cage.corner_normals)
        .enumerate();
    let at_ridge: Vec<_> = at_ridge.filter(|(_, (point, _))| **point == 12).collect();
    assert_eq!(at_ridge.len(), 4);
    for (corner, (_, normal)) in at_ridge {
        let expected = if corner / 4 % 4 < 2 { left } else { right };
        assert!(normal.distance(expected) < 0.1, "corner {corner}: {normal}");
    }
    assert!(cage.point_normals[12].distance(Vec3::Z) < 1e-5);
}

#[test]
fn a_cube_with_infinitely_sharp_edges_stays_a_cube() {
    let edges = [
        0, 1, 1, 3, 3, 2, 2, 0, 3, 5, 5, 4, 4, 2, 5, 7, 7, 6, 6, 4, 7, 1, 0, 6,
    ];
    let mesh = refine(&sharp_edges(cube(), &edges, 10.0), 2);
    assert!((area(&mesh) - 24.0).abs() < 1e-4);
    let cage = mesh.cage.as_ref().unwrap();
    assert!(
        cage.corner_normals[..4]
            .iter()
            .all(|n| n.distance(Vec3::Z) < 1e-6)
    );
    for t in 0..mesh.triangles.len() {
        assert!(
            mesh.shading_normal(t, 0.2, 0.3)
                .distance(mesh.plane_normal(t))
                < 1e-5
        );
    }
}

/// Sharpness s < 1 blends linearly between smooth and sharp at the first level, where it then vanishes: for a
/// cage of one crease the limit is linear in s.
#[test]
fn semi_sharp_creases_lie_between_smooth_and_sharp() {
    let roof = || grid(4, |p| 0.5 - (p.x - 0.5).abs());
    let ridge = [2, 7, 7, 12, 12, 17, 17, 22];
    let height = |sharpness: f32, level: usize| {
        refine(&sharp_edges(roof(), &ridge, sharpness), level).positions[12].z
    };
    let (smooth, sharp) = (height(0.0, 1), height(10.0, 1));
    let (half, one) = (height(0.5, 1), height(1.0, 2));
    assert!((sharp - 0.5).abs() < 1e-6 && smooth < half && half < one && one < sharp);
    assert!(
        (half - 0.5 * (smooth + one)).abs() < 1e-6,
        "{smooth} {half} {one}"
    );
}

#[test]
fn a_flat_sheet_keeps_its_corners_or_rounds_them_as_asked() {
    let sheet = grid(3, |_| 0.0);
    let whole = area(&refine(&sheet, 3));
    assert!((whole - 1.0).abs() < 1e-5, "{whole}");
    let rounded = refine(
        &with_token(sheet.clone(), "interpolateBoundary", "edgeOnly"),
        3,
    );
    assert!(area(&rounded) < 0.99 && area(&rounded) > 0.9);
    let shrunk = refine(&with_token(sheet, "interpolateBoundary", "none"), 2);
    assert!(shrunk.triangle_faces.iter().all(|&face| face == 4));
}

#[test]
fn left_handed_surfaces_look_the_other_way() {
    let mesh = refine(&with_token(cube(), "orientation", "leftHanded"), 1);
    assert!(point_normals(&mesh)[0].dot(mesh.positions[0]) < 0.0);
    let outward = mesh.positions[mesh.triangles[0][0] as usize];
    assert!(mesh.plane_normal(0).dot(outward) < 0.0);
    assert!(mesh.shading_normal(0, 0.3, 0.3).dot(outward) < 0.0);
}

#[test]
fn primvars_follow_the_rule_of_their_interpolation() {
    let count = |n: u8| (0..n).map(f32::from).collect::<Vec<_>>();
    let sheet = grid(2, |_| 0.0);
    let points = super::super::attributes::vectors(&sheet, "points").to_vec();
    let st: Vec<Vec2> = points.iter().map(|p| p.truncate()).collect();
    let indices = ints(&sheet, "faceVertexIndices").to_vec();
    let xs = |f: fn(f32) -> f32| Value::FloatArray(points.iter().map(|p| f(p.x)).collect());
    let step = |x: f32| if x == 0.5 { 1.0 } else { 0.0 };
    let prim = with_attribute(
        sheet,
        "primvars:u",
        Value::FloatArray(count(4)),
        Some("uniform"),
    );
    let prim = with_attribute(prim, "primvars:v", xs(step), Some("vertex"));
    let prim = with_attribute(prim, "primvars:w", xs(step), Some("varying"));
    let prim = with_attribute(
        prim,
        "primvars:st",
        Value::Vec2Array(st),
        Some("faceVarying"),
    );
    let prim = with_ints(prim, "primvars:st:indices", &indices);
    let prim = with_token(prim, "faceVaryingLinearInterpolation", "none");
    let (mesh, warnings) = refine_with(&prim, 2, &["u", "v", "w", "st"]);
    assert!(warnings.is_empty());
    let [u, v, w, st] = ["u", "v", "w", "st"].map(|name| mesh.primvar(name).unwrap());
    // The middle of the ridge: 4/6 of it by the smooth rule, all of it by the linear one.
    assert!((v.values[4].x - 4.0 / 6.0).abs() < 1e-6);
    assert_eq!(w.values[4].x, 1.0);
    let edge_only = with_token(prim, "interpolateBoundary", "edgeOnly");
    let (rounded, _) = refine_with(&edge_only, 2, &["st"]);
    // Texture coordinates that are the positions stay so under the same rules.
    for t in 0..rounded.triangles.len() {
        let st = rounded
            .primvar("st")
            .unwrap()
            .sample(&rounded, t, 0.25, 0.25);
        let [a, b, c] = rounded.corners(t);
        let p = 0.5 * a + 0.25 * b + 0.25 * c;
        assert!(st.truncate().distance(p) < 1e-6, "{st} at {p}");
    }
    for t in 0..mesh.triangles.len() {
        let face = f32::from(u8::try_from(mesh.triangle_faces[t]).unwrap());
        assert_eq!(u.sample(&mesh, t, 0.3, 0.3).x, face);
        assert!(w.sample(&mesh, t, 0.0, 0.0).x <= 1.0);
    }
    assert_eq!(st.components, 2);
}

#[test]
fn unused_points_stay_and_holes_are_not_drawn_but_support() {
    let whole = refine(&cube(), 1);
    let mut open = with_ints(cube(), "holeIndices", &[0]);
    let Some(Value::Vec3Array(points)) = open
        .attributes
        .get_mut("points")
        .and_then(|a| a.value.as_mut())
    else {
        unreachable!("the cube has points")
    };
    points.push(Vec3::splat(9.0));
    let open = refine(&open, 1);
    assert_eq!(open.positions[8], Vec3::splat(9.0));
    assert_eq!(open.positions[0], whole.positions[0]);
    assert_eq!(open.triangles.len(), whole.triangles.len() - 8);
    assert!(open.triangle_faces.iter().all(|&face| face != 0));
    assert!(point_normals(&open)[0].distance(point_normals(&whole)[0]) < 1e-6);
}

#[test]
fn bilinear_meshes_keep_their_points_and_are_faceted() {
    let mesh = refine(&with_token(cube(), "subdivisionScheme", "bilinear"), 2);
    assert!((area(&mesh) - 24.0).abs() < 1e-5);
    assert_eq!(mesh.normals, Normals::Flat);
    assert_eq!(mesh.positions[0], Vec3::new(-1.0, -1.0, 1.0));
    assert_eq!(mesh.cage.unwrap().corner_normals[0], Vec3::Z);
}

#[test]
fn what_cannot_be_subdivided_is_drawn_as_polygons_with_a_warning() {
    let (mesh, warnings) = refine_with(&with_token(cube(), "subdivisionScheme", "loop"), 2, &[]);
    assert_eq!(
        (mesh.triangles.len(), warnings),
        (12, vec!["not-subdivided".to_owned()])
    );
    assert_eq!(mesh.scheme, "none");
    let points = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let repeated = mesh_of_repeated_points(&points);
    let (mesh, warnings) = refine_with(&repeated, 1, &[]);
    assert_eq!(
        (mesh.triangles.len(), warnings),
        (1, vec!["not-subdivided".to_owned()])
    );
}

fn mesh_of_repeated_points(points: &[Vec3]) -> RawPrim {
    let prim = mesh("/m", points, &[4], &[0, 1, 1, 2]);
    with_token(prim, "subdivisionScheme", "catmullClark")
}

#[test]
fn fins_turned_neighbors_and_touching_corners_are_refined_without_panic() {
    // Three quads on one edge; two quads that run the same way along their edge; two that share a corner only.
    let points: Vec<Vec3> = (0..12_u8)
        .map(|i| Vec3::new(f32::from(i % 3), f32::from(i / 3), f32::from(i * i % 5)))
        .collect();
    for indices in [
        vec![0, 1, 4, 3, 1, 2, 5, 4, 1, 7, 10, 4],
        vec![0, 1, 4, 3, 4, 5, 2, 1, 1, 4, 7, 6],
        vec![0, 1, 4, 3, 4, 5, 8, 7],
    ] {
        let prim = mesh("/m", &points, &vec![4; indices.len() / 4], &indices);
        let mesh = refine(&with_token(prim, "subdivisionScheme", "catmullClark"), 2);
        assert!(mesh.positions.iter().all(|p| p.is_finite()));
        assert_eq!(mesh.triangles.len(), indices.len() / 4 * 32);
    }
}

#[test]
fn creases_that_name_no_edge_are_left_out_with_a_warning() {
    let (_, warnings) = refine_with(&sharp_edges(cube(), &[0, 3, -1, 5], 2.0), 1, &[]);
    assert_eq!(warnings, ["bad-crease"]);
}

#[test]
fn levels_reach_the_highest_finite_sharpness() {
    assert_eq!(sharpness_levels(&cube()), 0);
    for (sharpness, levels) in [(0.5, 1), (1.0, 1), (2.2, 3), (10.0, 0), (f32::INFINITY, 0)] {
        assert_eq!(
            sharpness_levels(&sharp_edges(cube(), &[0, 1], sharpness)),
            levels
        );
    }
}
