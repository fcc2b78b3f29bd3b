//! Polygons → triangles: fans where the polygon is convex, ear clipping where it is not.
//!
//! Polygons are taken as nearly planar: they are projected along their Newell normal, in f64. Every polygon of n
//! vertices gives n − 2 triangles, except those that would use a vertex twice. Cost: linear, times the number of
//! reflex vertices where the polygon is concave.

use glam::{DVec2, DVec3, Vec3};

/// Triangles of a set of faces.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Triangulation {
    /// Vertex indices.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Face-vertex (corner) indices, parallel to `triangles`; empty where nothing is listed by them.
    pub(super) corners: Vec<[u32; 3]>,
    /// Face of each triangle.
    pub(super) faces: Vec<u32>,
    is_bare: bool,
}

/// Whether a [`Triangulation`] lists face-vertices too.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Corners {
    Listed,
    NotNeeded,
}

impl Triangulation {
    /// Room for `count` triangles.
    pub(super) fn with_capacity(count: usize, corners: Corners) -> Self {
        Self {
            triangles: Vec::with_capacity(count),
            corners: Vec::with_capacity(if corners == Corners::Listed { count } else { 0 }),
            faces: Vec::with_capacity(count),
            is_bare: corners == Corners::NotNeeded,
        }
    }

    /// Add face `face`, whose face-vertices `first_corner..` are `points`.
    pub(super) fn add(&mut self, face: u32, first_corner: u32, points: &[u32], positions: &[Vec3]) {
        let mut push = |local: [usize; 3]| {
            let triangle = local.map(|i| points[i]);
            let [a, b, c] = triangle;
            if a != b && b != c && c != a {
                self.triangles.push(triangle);
                if !self.is_bare {
                    self.corners
                        .push(local.map(|i| first_corner + local_index(i)));
                }
                self.faces.push(face);
            }
        };
        match points {
            [_, _] | [_] | [] => {}
            [_, _, _] => push([0, 1, 2]),
            _ => polygon(points, positions, &mut push),
        }
    }

    /// Turn every triangle around.
    pub(super) fn flip(&mut self) {
        for triangle in self.triangles.iter_mut().chain(&mut self.corners) {
            triangle.swap(1, 2);
        }
    }
}

fn local_index(corner: usize) -> u32 {
    u32::try_from(corner).expect("a face has fewer than 2^32 vertices")
}

/// Twice the area vector of a polygon (Newell), relative to its first point so that nothing cancels far from 0.
pub(super) fn area_vector(points: &[u32], positions: &[Vec3]) -> DVec3 {
    let at = |i: u32| positions[i as usize].as_dvec3();
    let Some(&first) = points.first() else {
        return DVec3::ZERO;
    };
    let pairs = points.windows(2);
    pairs
        .map(|pair| (at(pair[0]) - at(first)).cross(at(pair[1]) - at(first)))
        .sum()
}

fn polygon(points: &[u32], positions: &[Vec3], push: &mut impl FnMut([usize; 3])) {
    let flat = project(points, positions);
    let count = points.len();
    let is_convex = (0..count).all(|i| {
        turn(
            flat[(i + count - 1) % count],
            flat[i],
            flat[(i + 1) % count],
        ) >= 0.0
    });
    // A spiral turns the same way everywhere: a convex outline winds around once only.
    if is_convex && winds_once(&flat) {
        for i in 1..count - 1 {
            push([0, i, i + 1]);
        }
    } else {
        clip_ears(&flat, push);
    }
}

/// The polygon in its own plane, counter-clockwise.
fn project(points: &[u32], positions: &[Vec3]) -> Vec<DVec2> {
    let origin = positions[points[0] as usize].as_dvec3();
    let normal = area_vector(points, positions).normalize_or(DVec3::Z);
    let (x, y) = normal.any_orthonormal_pair();
    let handed = if x.cross(y).dot(normal) < 0.0 {
        -1.0
    } else {
        1.0
    };
    points
        .iter()
        .map(|&i| {
            let offset = positions[i as usize].as_dvec3() - origin;
            DVec2::new(offset.dot(x), handed * offset.dot(y))
        })
        .collect()
}

/// Twice the signed area of a triangle: positive if it turns left.
fn turn(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - b)
}

/// True if the edge directions of a polygon that only turns left make one full turn.
fn winds_once(flat: &[DVec2]) -> bool {
    let edges = (0..flat.len()).map(|i| flat[(i + 1) % flat.len()] - flat[i]);
    let upward = |edge: &DVec2| edge.y > 0.0 || (edge.y == 0.0 && edge.x > 0.0);
    let sides: Vec<bool> = edges
        .filter(|edge| *edge != DVec2::ZERO)
        .map(|edge| upward(&edge))
        .collect();
    let changes = (0..sides.len()).filter(|&i| sides[i] != sides[(i + 1) % sides.len()]);
    changes.count() <= 2
}

/// Cut off ears until a triangle is left. Where no ear is found (the outline crosses itself) the straightest corner
/// goes, so that it always ends with n − 2 triangles.
fn clip_ears(flat: &[DVec2], push: &mut impl FnMut([usize; 3])) {
    let mut left: Vec<usize> = (0..flat.len()).collect();
    let mut at = 0;
    let mut since_last_ear = 0;
    while left.len() > 3 {
        let count = left.len();
        at %= count;
        let corner = [
            left[(at + count - 1) % count],
            left[at],
            left[(at + 1) % count],
        ];
        if since_last_ear >= count {
            at = straightest(flat, &left);
        } else if !is_ear(flat, &left, corner) {
            at += 1;
            since_last_ear += 1;
            continue;
        }
        let corner = [
            left[(at + count - 1) % count],
            left[at],
            left[(at + 1) % count],
        ];
        push(corner);
        left.remove(at);
        // Going on one corner further keeps fans short: slivers come only where the outline asks for them.
        at += 1;
        since_last_ear = 0;
    }
    push([left[0], left[1], left[2]]);
}

fn is_ear(flat: &[DVec2], left: &[usize], corner: [usize; 3]) -> bool {
    let [a, b, c] = corner.map(|i| flat[i]);
    if turn(a, b, c) <= 0.0 {
        return false;
    }
    !left.iter().any(|&i| {
        let p = flat[i];
        // Points on top of a corner are the two sides of a bridge to a hole.
        p != a
            && p != b
            && p != c
            && turn(a, b, p) >= 0.0
            && turn(b, c, p) >= 0.0
            && turn(c, a, p) >= 0.0
    })
}

/// Position in `left` of the corner that spans the least area.
fn straightest(flat: &[DVec2], left: &[usize]) -> usize {
    let count = left.len();
    let area = |at: usize| {
        turn(
            flat[left[(at + count - 1) % count]],
            flat[left[at]],
            flat[left[(at + 1) % count]],
        )
        .abs()
    };
    (0..count)
        .min_by(|&a, &b| area(a).total_cmp(&area(b)))
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn triangles(outline: &[Vec3]) -> Triangulation {
        let points: Vec<u32> = (0..u32::try_from(outline.len()).unwrap()).collect();
        let mut result = Triangulation::default();
        result.add(5, 100, &points, outline);
        result
    }

    /// Areas along the polygon's normal: the sum, and the smallest.
    fn areas(outline: &[Vec3]) -> (f64, f64) {
        let points: Vec<u32> = (0..u32::try_from(outline.len()).unwrap()).collect();
        let normal = area_vector(&points, outline).normalize();
        let areas = triangles(outline)
            .triangles
            .iter()
            .map(|t| 0.5 * area_vector(t, outline).dot(normal))
            .collect::<Vec<_>>();
        (
            areas.iter().sum(),
            areas.iter().copied().fold(f64::INFINITY, f64::min),
        )
    }

    fn flat(outline: &[[f32; 2]]) -> Vec<Vec3> {
        outline.iter().map(|&[x, y]| Vec3::new(x, y, 0.0)).collect()
    }

    #[test]
    fn a_concave_l_keeps_its_area_without_turned_triangles() {
        let l = flat(&[[0., 0.], [3., 0.], [3., 1.], [1., 1.], [1., 2.], [0., 2.]]);
        let (sum, least) = areas(&l);
        assert!((sum - 4.0).abs() < 1e-12 && least > 0.0, "{sum} {least}");
    }

    #[test]
    fn a_concave_quad_is_split_along_its_inner_diagonal() {
        let dart = flat(&[[0., 0.], [2., 2.], [0., 1.], [-2., 2.]]);
        let (sum, least) = areas(&dart);
        assert!((sum - 2.0).abs() < 1e-12 && least > 0.0, "{sum} {least}");
    }

    #[test]
    fn a_square_with_a_bridged_hole_keeps_its_area() {
        let ring = flat(&[
            [0., 0.],
            [4., 0.],
            [4., 4.],
            [0., 4.],
            [0., 0.],
            [1., 1.],
            [1., 3.],
            [3., 3.],
            [3., 1.],
            [1., 1.],
        ]);
        let (sum, least) = areas(&ring);
        assert!((sum - 12.0).abs() < 1e-12 && least >= 0.0, "{sum} {least}");
    }

    #[test]
    fn a_comb_of_many_reflex_corners_keeps_its_area() {
        let mut comb = vec![[0.0, -1.0_f32]];
        comb.extend((0..200_u16).flat_map(|i| {
            let x = f32::from(i);
            [[x, 0.0], [x + 0.5, 1.0]]
        }));
        comb.extend([[200.0, 0.0], [200.0, -1.0]]);
        let mut comb = flat(&comb);
        comb.reverse();
        let (sum, least) = areas(&comb);
        assert!((sum - 300.0).abs() < 1e-9 && least >= 0.0, "{sum} {least}");
    }

    #[test]
    fn corners_and_face_are_those_of_the_face() {
        let quad = triangles(&flat(&[[0., 0.], [1., 0.], [1., 1.], [0., 1.]]));
        assert_eq!(quad.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(quad.corners, [[100, 101, 102], [100, 102, 103]]);
        assert_eq!(quad.faces, [5, 5]);
    }

    #[test]
    fn triangles_that_use_a_vertex_twice_are_dropped_and_flat_ones_kept() {
        let mut result = Triangulation::default();
        let positions = flat(&[[0., 0.], [1., 0.], [2., 0.]]);
        result.add(0, 0, &[0, 1, 1], &positions);
        result.add(1, 3, &[0, 1, 2], &positions);
        assert_eq!(result.triangles, [[0, 1, 2]]);
    }

    #[test]
    fn self_crossing_and_collapsed_outlines_end_with_two_fewer_triangles_than_corners() {
        let star = flat(&[[0., 3.], [-2., -3.], [3., 1.], [-3., 1.], [2., -3.]]);
        assert_eq!(triangles(&star).triangles.len(), 3);
        assert_eq!(triangles(&[Vec3::ONE; 6]).triangles.len(), 4);
    }

    proptest! {
        /// Star-shaped outlines around the origin, tilted in space: any radii give a simple polygon.
        #[test]
        fn star_shaped_polygons_keep_their_area(radii in prop::collection::vec(0.1_f32..3.0, 3..24)) {
            let step = std::f32::consts::TAU / radii.len() as f32;
            let outline: Vec<Vec3> = radii.iter().enumerate().map(|(i, r)| {
                let (y, x) = (step * i as f32).sin_cos();
                Vec3::new(r * x, r * y, r * (0.5 * x - 0.25 * y)) + Vec3::splat(50.0)
            }).collect();
            let points: Vec<u32> = (0..u32::try_from(outline.len()).unwrap()).collect();
            let expected = 0.5 * area_vector(&points, &outline).length();
            let (sum, least) = areas(&outline);
            prop_assert_eq!(triangles(&outline).triangles.len(), outline.len() - 2);
            prop_assert!((sum - expected).abs() <= 1e-9 * expected);
            prop_assert!(least >= -1e-5 * expected, "{}", least);
        }
    }
}
