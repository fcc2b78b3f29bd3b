use super::super::super::super::raw::Value;
use super::super::tests::{prim, with_attribute, with_ints, with_token};
use super::*;
use std::f64::consts::{PI, TAU};

/// One width for every control point.
fn widths(count: usize, width: f32) -> Value {
    Value::FloatArray(vec![width; count])
}

fn curves(form: [&str; 3], counts: &[i32], points: &[Vec3]) -> RawPrim {
    let made = prim("/c", "BasisCurves", None);
    let made = with_ints(made, "curveVertexCounts", counts);
    let made = with_attribute(made, "points", Value::Vec3Array(points.to_vec()), None);
    let [kind, basis, wrap] = form;
    let made = with_token(made, "type", kind);
    with_token(with_token(made, "basis", basis), "wrap", wrap)
}

fn read(prim: &RawPrim) -> (Option<Curves<'_>>, Vec<String>) {
    let diagnostics = Diagnostics::default();
    let names = ["displayColor".to_owned(), "st".to_owned()];
    let read = Curves::read(prim, &[], &names, &diagnostics);
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

const LINEAR: [&str; 3] = ["linear", "bezier", "nonperiodic"];

#[test]
fn a_straight_tube_has_the_area_of_the_cylinder_whatever_its_sides() {
    let points = [Vec3::ZERO, Vec3::X, Vec3::new(4.0, 0.0, 0.0)];
    let prim = curves(LINEAR, &[3], &points);
    let prim = with_attribute(prim, "widths", widths(3, 0.5), None);
    for depth in [1e-4, 1e-2, 1.0] {
        let mesh = mesh(&prim, depth);
        let expected = TAU * 0.25 * 4.0;
        assert!(
            (area(&mesh) / expected - 1.0).abs() < 1e-6,
            "{}",
            area(&mesh)
        );
        assert!(mesh.triangles.len() >= 12 && !mesh.closed);
    }
}

#[test]
fn sides_follow_the_depth_within_bounds() {
    for (depth, expected) in [(0.0, 58), (1e-3, 58), (0.03, 11), (0.4, 3), (9.0, 3)] {
        assert_eq!(strand::sides(1.0, depth), expected, "{depth}");
    }
    assert_eq!(strand::sides(0.0, 1.0), 3);
}

#[test]
fn tapered_tubes_have_the_area_of_the_cone() {
    let prim = curves(LINEAR, &[2], &[Vec3::ZERO, Vec3::new(0.0, 0.0, 3.0)]);
    let taper = Value::FloatArray(vec![2.0, 0.0]);
    let prim = with_attribute(prim, "widths", taper, Some("varying"));
    // π r √(r² + h²) with r = 1, h = 3; the prism's facets lean less than the cone's side
    let expected = PI * 10.0_f64.sqrt();
    assert!((area(&mesh(&prim, 1e-6)) / expected - 1.0).abs() < 1e-3);
}

/// A quarter circle as one cubic Bézier, which is right to 2.7e-4.
#[test]
fn a_bent_tube_follows_the_curve_as_closely_as_asked() {
    let k = 0.552_284_8;
    let points = [
        Vec3::X,
        Vec3::new(1.0, k, 0.0),
        Vec3::new(k, 1.0, 0.0),
        Vec3::Y,
    ];
    let prim = curves(["cubic", "bezier", "nonperiodic"], &[4], &points);
    let prim = with_attribute(prim, "widths", widths(4, 0.02), None);
    for depth in [1e-2, 1e-4] {
        let mesh = mesh(&prim, depth);
        let middle = |t: usize| mesh.corners(t).iter().map(|p| p.as_dvec3()).sum::<DVec3>() / 3.0;
        let off = |t: usize| (middle(t).truncate().length() - 1.0).abs();
        let worst = (0..mesh.triangles.len()).map(off).fold(0.0, f64::max);
        assert!(worst <= 0.011 + depth, "{worst} at {depth}");
        // area of a torus' quarter
        let expected = TAU * 0.01 * PI / 2.0;
        assert!(
            (area(&mesh) / expected - 1.0).abs() < 0.02,
            "{}",
            area(&mesh) / expected
        );
    }
}

#[test]
fn each_segment_has_the_pieces_that_it_needs_in_each_of_many_curves() {
    let bent = [Vec3::ZERO, Vec3::Y, Vec3::new(1.0, 1.0, 0.0), Vec3::X];
    let straight = [2.0, 3.0, 4.0].map(|x| Vec3::X * x);
    let form = ["cubic", "bezier", "nonperiodic"];
    let triangles = |points: &[Vec3], count: usize| {
        let [per_curve, all] = [points.len(), count * points.len()];
        let counts = vec![i32::try_from(per_curve).unwrap(); count];
        let prim = curves(form, &counts, &points.repeat(count));
        let prim = with_attribute(prim, "widths", widths(all, 0.02), None);
        mesh(&prim, 1e-3)
    };
    let (one, two) = (
        triangles(&bent, 1),
        triangles(&[&bent[..], &straight].concat(), 1),
    );
    let a_piece = 2 * strand::sides(0.01, 1e-3);
    assert!(one.triangles.len() > 4 * a_piece);
    assert_eq!(
        two.triangles.len(),
        one.triangles.len() + a_piece,
        "straight"
    );
    // More than one task cuts.
    let count = 2 * CURVES_A_TASK + 7;
    let many = triangles(&bent, count);
    let (vertices, pieces) = (one.positions.len(), one.triangles.len());
    assert_eq!(many.triangles.len(), count * pieces);
    for (i, triangle) in many.triangles.iter().enumerate() {
        let first = u32::try_from(i / pieces * vertices).unwrap();
        assert_eq!(*triangle, one.triangles[i % pieces].map(|at| first + at));
        assert_eq!(many.triangle_faces[i] as usize, i / pieces);
    }
    for (i, position) in many.positions.iter().enumerate() {
        // About another center.
        assert!(position.distance(one.positions[i % vertices]) < 1e-6);
    }
}

#[test]
fn a_periodic_curve_is_a_closed_ring() {
    let corners = [Vec3::X, Vec3::Y, -Vec3::X, -Vec3::Y].map(|p| 3.0 * p);
    for basis in ["bspline", "catmullRom"] {
        let prim = curves(["cubic", basis, "periodic"], &[4], &corners);
        let prim = with_attribute(prim, "widths", widths(4, 0.1), None);
        let mesh = mesh(&prim, 1e-3);
        assert!(mesh.closed);
        let mut uses = std::collections::HashMap::new();
        for triangle in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
                *uses.entry((a.min(b), a.max(b))).or_insert(0) += if a < b { 1 } else { -1 };
            }
        }
        assert!(uses.values().all(|&balance| balance == 0), "{basis}");
        // the frame does not jump where the ring closes
        let expected = area(&mesh);
        let longest = (0..mesh.triangles.len()).flat_map(|t| {
            let [a, b, c] = mesh.corners(t);
            [a.distance(b), b.distance(c), c.distance(a)]
        });
        assert!(longest.fold(0.0, f32::max) < 1.0 && expected > 0.0);
    }
}

#[test]
fn tubes_face_outwards() {
    let points = [
        Vec3::ZERO,
        Vec3::new(1.0, 2.0, 0.5),
        Vec3::new(2.0, 2.0, 3.0),
    ];
    let prim = curves(["cubic", "catmullRom", "pinned"], &[3], &points);
    let mesh = mesh(&with_attribute(prim, "widths", widths(3, 0.2), None), 1e-3);
    for t in 0..mesh.triangles.len() {
        assert!(mesh.plane_normal(t).dot(mesh.shading_normal(t, 0.3, 0.3)) > 0.7);
    }
}

#[test]
fn corners_of_polylines_keep_their_width() {
    let points = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0)];
    let prim = curves(LINEAR, &[3], &points);
    let mesh = mesh(&with_attribute(prim, "widths", widths(3, 0.2), None), 1e-5);
    // the outer corner of two bands 0.2 wide that meet at a right angle
    let reach = mesh.positions.iter().map(|p| p.x - p.y).fold(0.0, f32::max);
    assert!((reach - 1.2).abs() < 2e-3, "{reach}");
}

#[test]
fn normals_make_ribbons_that_face_them() {
    let points = [Vec3::ZERO, Vec3::X, Vec3::new(2.0, 0.0, 0.0)];
    let prim = curves(LINEAR, &[3], &points);
    let prim = with_attribute(
        prim,
        "widths",
        Value::FloatArray(vec![0.5]),
        Some("constant"),
    );
    let normals = Value::Vec3Array(vec![Vec3::new(0.0, 0.0, 2.0); 3]);
    let mesh = mesh(&with_attribute(prim, "normals", normals, None), 1.0);
    assert!((area(&mesh) - 1.0).abs() < 1e-6);
    assert!(mesh.double_sided);
    for t in 0..mesh.triangles.len() {
        assert!(mesh.plane_normal(t).distance(Vec3::Z) < 1e-6);
        assert!(mesh.shading_normal(t, 0.2, 0.2).distance(Vec3::Z) < 1e-6);
    }
}

#[test]
fn values_are_laid_out_by_their_interpolation() {
    let points: Vec<Vec3> = (0..7_u8)
        .map(|i| Vec3::new(f32::from(i), 0.0, 0.0))
        .collect();
    let made = curves(["cubic", "bspline", "pinned"], &[3, 4], &points);
    let made = with_attribute(made, "widths", widths(2, 0.1), Some("uniform"));
    let colors = Value::Vec3Array(vec![Vec3::X, Vec3::Y]);
    let made = with_attribute(made, "primvars:displayColor", colors, Some("uniform"));
    // pinned: 2 and 3 segments, so 3 and 4 varying values
    let st = Value::FloatArray((0..7_u8).map(f32::from).collect());
    let made = with_attribute(made, "primvars:st", st, Some("varying"));
    let mesh = mesh(&made, 1.0);
    let color = mesh.primvar("displayColor").unwrap();
    let last = mesh.triangles.len() - 1;
    assert_eq!(color.sample(&mesh, 0, 0.3, 0.3).truncate(), Vec3::X);
    assert_eq!(color.sample(&mesh, last, 0.3, 0.3).truncate(), Vec3::Y);
    // evenly spaced control points: the parameter is the position
    let st = mesh.primvar("st").unwrap();
    for (position, value) in mesh.positions.iter().zip(&st.values) {
        assert!((position.x - value.x).abs() < 1e-5, "{position} {value}");
    }
}

#[test]
fn what_cannot_be_drawn_is_told() {
    let points = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE];
    let cubic = ["cubic", "bezier", "nonperiodic"];
    let with_widths = |prim| {
        with_attribute(
            prim,
            "widths",
            Value::FloatArray(vec![0.1]),
            Some("constant"),
        )
    };
    let told = |prim: RawPrim| {
        let (read, warnings) = read(&prim);
        (read.is_some(), warnings)
    };
    let bad = || vec!["bad-curves".to_owned()];
    assert_eq!(
        told(with_widths(curves(cubic, &[4], &points))),
        (false, bad())
    );
    assert_eq!(
        told(with_widths(curves(
            ["cubic", "power", "pinned"],
            &[5],
            &points
        ))),
        (false, bad())
    );
    assert_eq!(
        told(with_widths(curves(
            ["linear", "bezier", "pinned"],
            &[4, 1],
            &points
        ))),
        (true, bad())
    );
    let nan = [Vec3::ZERO, Vec3::NAN];
    assert_eq!(
        told(with_widths(curves(LINEAR, &[2], &nan))),
        (false, bad())
    );
    assert_eq!(
        told(curves(LINEAR, &[5], &points)),
        (true, vec!["default-widths".to_owned()])
    );
    assert_eq!(
        told(curves(LINEAR, &[], &[])),
        (false, vec!["empty-mesh".to_owned()])
    );
}

fn nurbs(orders: &[i32], counts: &[i32], knots: &[f32], points: &[Vec3]) -> RawPrim {
    let made = prim("/c", NURBS, None);
    let made = with_ints(made, "curveVertexCounts", counts);
    let made = with_ints(made, "order", orders);
    let made = with_attribute(made, "knots", Value::FloatArray(knots.to_vec()), None);
    let made = with_attribute(made, "points", Value::Vec3Array(points.to_vec()), None);
    let width = Value::FloatArray(vec![0.02]);
    with_attribute(made, "widths", width, Some("constant"))
}

/// A circle of radius 3 about the z axis: nine points of a square, with weights 1 and √½ by turns.
fn circle() -> RawPrim {
    let corners = [
        [1, 0],
        [1, 1],
        [0, 1],
        [-1, 1],
        [-1, 0],
        [-1, -1],
        [0, -1],
        [1, -1],
        [1, 0],
    ];
    let points = corners.map(|[x, y]: [i8; 2]| 3.0 * Vec3::new(f32::from(x), f32::from(y), 0.0));
    let knots = [0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0, 4.0];
    let weights = (0..9).map(|i| if i % 2 == 0 { 1.0 } else { 0.5_f32.sqrt() });
    let weights = Value::FloatArray(weights.collect());
    with_attribute(
        nurbs(&[3], &[9], &knots, &points),
        "pointWeights",
        weights,
        None,
    )
}

#[test]
fn a_rational_quadratic_is_a_circle() {
    let made = circle();
    let (read, _) = read(&made);
    let read = read.unwrap();
    let curve = &read.curves[0];
    for segment in 0..4 {
        for t in [0.0, 0.1, 0.37, 0.5, 0.81, 1.0] {
            let at = |order| read.sum(curve, Place { segment, t }, order);
            let (place, slope, bend) = (at(Order::Value), at(Order::First), at(Order::Second));
            assert!((place.length() - 3.0).abs() < 1e-6, "{}", place.length());
            assert!(
                place.dot(slope).abs() < 1e-6,
                "the tangent is at right angles"
            );
            let curvature = slope.cross(bend).length() / slope.length().powi(3);
            assert!((curvature - 1.0 / 3.0).abs() < 1e-6, "{curvature}");
        }
    }
    for depth in [1e-2, 1e-4] {
        let mesh = mesh(&made, depth);
        let expected = TAU * 3.0 * TAU * 0.01; // a torus
        assert!((area(&mesh) / expected - 1.0).abs() < depth + 1e-4);
        let reach = mesh.positions.iter().map(|p| p.truncate().length());
        assert!(reach.fold(0.0, f32::max) < 3.02);
    }
}

#[test]
fn a_range_draws_its_part_of_a_curve_only() {
    let ranges = Value::Vec2Array(vec![glam::Vec2::new(0.0, 1.0)]);
    let mesh = mesh(&with_attribute(circle(), "ranges", ranges, None), 1e-4);
    assert!((area(&mesh) / (TAU * 3.0 / 4.0 * TAU * 0.01) - 1.0).abs() < 1e-3);
    let least = mesh.positions.iter().map(|p| p.x.min(p.y));
    assert!(
        least.fold(0.0, f32::min) > -0.02,
        "the first quarter, and its width"
    );
}

/// Evenly spaced knots, and those with `order` equal ones at each end: what the bases of `BasisCurves` are.
#[test]
fn nurbs_with_the_knots_of_a_basis_are_the_curves_of_that_basis() {
    let points = [
        Vec3::ZERO,
        Vec3::new(1.0, 2.0, 0.5),
        Vec3::new(2.0, 2.0, 3.0),
        Vec3::new(4.0, 0.0, 1.0),
        Vec3::new(5.0, 1.0, -1.0),
        Vec3::new(7.0, 0.0, 0.0),
        Vec3::new(8.0, 3.0, 0.0),
    ];
    let even: Vec<f32> = (0..11_u8).map(f32::from).collect();
    let thrice = [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0];
    let once = [0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 6.0];
    for (form, order, knots) in [
        (["cubic", "bspline", "nonperiodic"], 4, &even[..]),
        (["cubic", "bezier", "nonperiodic"], 4, &thrice[..]),
        (LINEAR, 2, &once[..]),
    ] {
        let expected = curves(form, &[7], &points);
        let width = Value::FloatArray(vec![0.02]);
        let expected = mesh(
            &with_attribute(expected, "widths", width, Some("constant")),
            1e-3,
        );
        // two in one prim, the second farther up
        let both: Vec<Vec3> = points
            .iter()
            .chain(&points.map(|p| p + 9.0 * Vec3::Z))
            .copied()
            .collect();
        let knots = [knots, knots].concat();
        let found = mesh(&nurbs(&[order; 2], &[7; 2], &knots, &both), 1e-3);
        let count = expected.positions.len();
        assert_eq!(found.positions.len(), 2 * count, "{form:?}");
        let lift = found.positions[count] - found.positions[0];
        assert!(lift.distance(9.0 * Vec3::Z) < 1e-5);
        let offset = found.positions[0] - expected.positions[0];
        for (found, expected) in found.positions.iter().zip(&expected.positions) {
            assert!(
                (*found - offset).distance(*expected) < 1e-5,
                "{form:?}: {found} {expected}"
            );
        }
    }
}

#[test]
fn values_of_nurbs_lie_at_knots_or_control_points() {
    let points: Vec<Vec3> = (0..5_u8)
        .map(|i| Vec3::new(f32::from(i), 0.0, 0.0))
        .collect();
    // a knot that is there twice: 4 values, two of them at one place
    let knots = [0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 2.0];
    let made = nurbs(&[3], &[5], &knots, &points);
    let made = with_attribute(
        made,
        "primvars:displayColor",
        Value::Vec3Array(points.clone()),
        Some("vertex"),
    );
    let st = Value::FloatArray(vec![0.0, 2.0, 6.0, 8.0]);
    let mesh = mesh(
        &with_attribute(made, "primvars:st", st, Some("varying")),
        1.0,
    );
    let color = mesh.primvar("displayColor").unwrap();
    for (position, value) in mesh.positions.iter().zip(&color.values) {
        assert!((position.x - value.x).abs() < 1e-5, "{position} {value}");
    }
    let st = &mesh.primvar("st").unwrap().values;
    assert_eq!(st[0].x, 0.0);
    assert_eq!(st[st.len() - 1].x, 8.0);
}

#[test]
fn nurbs_that_cannot_be_drawn_are_told() {
    let line = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
    let knots = [0.0, 0.0, 1.0, 1.0];
    let told = |prim: RawPrim| {
        let diagnostics = Diagnostics::default();
        let count = Curves::read(&prim, &[], &[], &diagnostics).map(|read| read.curves.len());
        let messages = diagnostics.warnings().into_iter().map(|w| w.message);
        (count.unwrap_or(0), messages.collect::<Vec<_>>().join("; "))
    };
    let two = |orders: &[i32], knots: &[f32]| told(nurbs(orders, &[2, 2], knots, &line));
    let (count, message) = two(&[2], &knots.repeat(2));
    assert!(
        count == 0 && message.contains("1 orders, 2 are needed"),
        "{message}"
    );
    let (count, message) = two(&[2, 2], &knots);
    assert!(
        count == 0 && message.contains("4 knots, 8 are needed"),
        "{message}"
    );
    let backwards = [knots, [0.0, 1.0, 0.5, 2.0]].concat();
    let (count, message) = two(&[2, 2], &backwards);
    assert!(count == 1 && message.contains("1 of 2 curves"), "{message}");
    let (count, message) = two(&[2, 3], &[&knots[..], &[0.0; 5]].concat());
    assert!(count == 1 && message.contains("order 3"), "{message}");
    let (count, _) = two(&[-1, i32::MAX], &[&knots[..], &knots].concat());
    assert_eq!(count, 0);
    let weights = Value::FloatArray(vec![1.0, 1.0, 0.0, 1.0]);
    let prim = nurbs(&[2, 2], &[2, 2], &knots.repeat(2), &line);
    let (count, message) = told(with_attribute(prim, "pointWeights", weights, None));
    assert!(count == 1 && message.contains("not above 0"), "{message}");
    let many = vec![Vec3::ZERO; 100];
    let (count, message) = told(nurbs(&[100], &[100], &[0.0; 200], &many));
    assert!(count == 0 && message.contains("at most"), "{message}");
}
