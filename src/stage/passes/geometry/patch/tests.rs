use super::super::tests::{prim, with_attribute, with_ints, with_token};
use super::*;
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

/// A knot vector of order 3 for the nine points of a full circle.
const CIRCLE: [f32; 12] = [
    0.0, 0.0, 0.0, 0.25, 0.25, 0.5, 0.5, 0.75, 0.75, 1.0, 1.0, 1.0,
];

fn single(x: f64) -> f32 {
    DVec3::splat(x).as_vec3().x
}

/// The nine control points of a full circle, and their weights.
fn circle() -> [(f64, f64, f64); 9] {
    let corners = [
        (1, 0),
        (1, 1),
        (0, 1),
        (-1, 1),
        (-1, 0),
        (-1, -1),
        (0, -1),
        (1, -1),
        (1, 0),
    ];
    corners.map(|(x, y)| {
        let weight = if x != 0 && y != 0 { FRAC_1_SQRT_2 } else { 1.0 };
        (f64::from(x), f64::from(y), weight)
    })
}

/// A profile (radius, height, weight) turned about z, u around.
fn revolved(profile: &[(f64, f64, f64)], order: i64, knots: &[f32]) -> RawPrim {
    let (mut points, mut weights) = (Vec::new(), Vec::new());
    for &(radius, height, of_profile) in profile {
        for (x, y, weight) in circle() {
            points.push(DVec3::new(radius * x, radius * y, height).as_vec3());
            weights.push(single(weight * of_profile));
        }
    }
    let made = prim("/p", "NurbsPatch", None);
    let with_size =
        |made, name: &str, size: i64| with_attribute(made, name, Value::Int(size), None);
    let made = with_size(with_size(made, "uVertexCount", 9), "uOrder", 3);
    let made = with_size(made, "vVertexCount", i64::try_from(profile.len()).unwrap());
    let made = with_size(made, "vOrder", order);
    let made = with_attribute(made, "uKnots", Value::FloatArray(CIRCLE.to_vec()), None);
    let made = with_attribute(made, "vKnots", Value::FloatArray(knots.to_vec()), None);
    let made = with_attribute(made, "points", Value::Vec3Array(points), None);
    with_attribute(made, "pointWeights", Value::FloatArray(weights), None)
}

fn cylinder() -> RawPrim {
    revolved(
        &[(1.0, 0.0, 1.0), (1.0, 3.0, 1.0)],
        2,
        &[0.0, 0.0, 1.0, 1.0],
    )
}

/// A half circle from the south to the north pole.
fn sphere() -> RawPrim {
    let h = FRAC_1_SQRT_2;
    let profile = [
        (0.0, -1.0, 1.0),
        (1.0, -1.0, h),
        (1.0, 0.0, 1.0),
        (1.0, 1.0, h),
        (0.0, 1.0, 1.0),
    ];
    revolved(&profile, 3, &[0.0, 0.0, 0.0, 0.5, 0.5, 1.0, 1.0, 1.0])
}

fn read(prim: &RawPrim) -> (Option<Patch<'_>>, Vec<String>) {
    let diagnostics = Diagnostics::default();
    let names = ["displayColor".to_owned(), "st".to_owned()];
    let read = Patch::read(prim, &[], &names, &diagnostics);
    let kinds = diagnostics.warnings().into_iter().map(|w| w.kind).collect();
    (read, kinds)
}

fn mesh(prim: &RawPrim, depth: f64) -> Mesh {
    let (read, warnings) = read(prim);
    assert!(warnings.is_empty(), "{warnings:?}");
    read.unwrap().tessellate(depth).0
}

fn area(mesh: &Mesh) -> f64 {
    let triangles = 0..mesh.triangles.len();
    let areas = triangles.map(|t| {
        let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    });
    areas.sum()
}

/// Rounding of positions to f32.
const ROUND: f32 = 2e-7;

#[test]
fn a_cylinder_is_exactly_round_with_normals_straight_out() {
    let mesh = mesh(&cylinder(), 1e-4);
    for position in &mesh.positions {
        assert!(
            (position.truncate().length() - 1.0).abs() <= ROUND,
            "{position}"
        );
    }
    for t in 0..mesh.triangles.len() {
        let corners = mesh.corners(t);
        for (corner, normal) in corners.iter().zip(mesh.corner_normals(t).unwrap()) {
            let outward = corner.truncate().extend(0.0);
            assert!(normal.distance(outward) < 1e-6, "{normal} at {corner}");
        }
        assert!(mesh.plane_normal(t).dot(mesh.shading_normal(t, 0.3, 0.3)) > 0.9);
    }
    assert!(!mesh.closed);
    assert!((area(&mesh) / (TAU * 3.0) - 1.0).abs() < 1e-3);
}

#[test]
fn a_sphere_is_exactly_round_and_closed() {
    let mesh = mesh(&sphere(), 1e-4);
    for position in &mesh.positions {
        assert!((position.length() - 1.0).abs() <= ROUND, "{position}");
    }
    assert!(mesh.closed);
    let mut edges = std::collections::HashMap::new();
    for [a, b, c] in &mesh.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((from.min(to), from.max(to))).or_insert(0) +=
                if from < to { 1 } else { -1 };
        }
    }
    assert!(edges.values().all(|&balance| balance == 0));
    assert!(
        (area(&mesh) / (4.0 * PI) - 1.0).abs() < 2e-3,
        "{}",
        area(&mesh)
    );
    for t in 0..mesh.triangles.len() {
        let out = mesh.corners(t).iter().sum::<Vec3>().normalize();
        assert!(mesh.plane_normal(t).dot(out) > 0.98, "triangle {t}");
        let normals = mesh.corner_normals(t).unwrap();
        assert!(
            normals.iter().all(|normal| normal.dot(out) > 0.95),
            "triangle {t}: {normals:?}"
        );
    }
}

#[test]
fn facets_lie_as_close_as_asked() {
    let count = |depth: f64| mesh(&sphere(), depth).triangles.len();
    // twice as close takes about twice as many; between the bounds of the patch's own size
    assert!(count(7e-4) > 3 * count(7e-3));
    assert_eq!(count(0.0), count(1e-9));
    let mesh = mesh(&sphere(), 2e-3);
    let middle = |t: usize| mesh.corners(t).iter().sum::<Vec3>().length() / 3.0;
    let worst = (0..mesh.triangles.len())
        .map(|t| 1.0 - middle(t))
        .fold(0.0, f32::max);
    // two chords of 2e-3 each and their diagonal
    assert!(worst <= 8e-3, "{worst}");
}

#[test]
fn left_handed_patches_face_the_other_way() {
    let mesh = mesh(&with_token(cylinder(), "orientation", "leftHanded"), 1e-3);
    let out = mesh.corners(0)[0].truncate().extend(0.0);
    assert!(mesh.plane_normal(0).dot(out) < -0.9);
    assert!(mesh.shading_normal(0, 0.3, 0.3).dot(out) < -0.9);
}

#[test]
fn ranges_cut_the_patch() {
    let half = glam::DVec2::new(0.0, 0.5);
    let mesh = mesh(
        &with_attribute(cylinder(), "uRange", Value::Vec2(half), None),
        1e-3,
    );
    assert!(mesh.positions.iter().all(|position| position.y > -1e-6));
    assert!((area(&mesh) / (PI * 3.0) - 1.0).abs() < 2e-3);
}

#[test]
fn vertex_primvars_are_blended_like_points() {
    let points = vectors(&cylinder(), "points").to_vec();
    let made = with_attribute(
        cylinder(),
        "primvars:displayColor",
        Value::Vec3Array(points),
        Some("vertex"),
    );
    let mesh = mesh(&made, 1e-3);
    let color = mesh.primvar("displayColor").unwrap();
    for t in 0..mesh.triangles.len() {
        let value = color.sample(&mesh, t, 0.2, 0.5).truncate();
        let [a, b, c] = mesh.corners(t);
        assert!(value.distance(a * 0.3 + b * 0.2 + c * 0.5) < 1e-5);
    }
}

#[test]
fn what_is_wrong_is_told() {
    let told = |prim: RawPrim| {
        let (read, warnings) = read(&prim);
        (read.is_some(), warnings)
    };
    let bad = || (false, vec!["bad-patch".to_owned()]);
    let knots = Value::FloatArray(vec![0.0, 1.0]);
    assert_eq!(
        told(with_attribute(cylinder(), "vKnots", knots, None)),
        bad()
    );
    assert_eq!(
        told(with_attribute(
            cylinder(),
            "vVertexCount",
            Value::Int(3),
            None
        )),
        bad()
    );
    let weights = Value::FloatArray(vec![0.0; 18]);
    assert_eq!(
        told(with_attribute(cylinder(), "pointWeights", weights, None)),
        bad()
    );
    assert_eq!(told(prim("/p", "NurbsPatch", None)), bad());
    let trimmed = with_ints(cylinder(), "trimCurve:counts", &[1]);
    assert_eq!(told(trimmed), (true, vec!["trim-curves".to_owned()]));
}
