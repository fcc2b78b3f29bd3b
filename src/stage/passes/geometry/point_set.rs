//! `Points` → spheres, or disks where they have normals, of triangles.
//!
//! A sphere is a polyhedron of the same area, whose mean width from all sides is then right too (Cauchy), however few
//! faces it has; a disk is an octagon of its area.

use super::super::super::raw::RawPrim;
use super::attributes::vectors;
use super::layouts::{Body, DEFAULT_WIDTH, Layouts};
use super::primvars::{AuthoredPrimvar, Layout};
use crate::diagnostics::Diagnostics;
use crate::scene::{Interpolation, Mesh, Normals, Primvar};
use glam::{DVec3, Vec3};
use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

/// Triangles of one prim, at most, unless octahedra have more: half a million points as these.
const TRIANGLE_BUDGET: usize = 4_000_000;

/// Over the budget polyhedra may be this much deeper.
const COARSENING: f64 = 4.0;

/// No depth below this part of the largest radius asks for more faces.
const FINEST: f64 = 1e-3;

/// Most times that the faces of an icosahedron are divided into four.
const MOST_DIVISIONS: u32 = 3;

/// Corners of a disk.
const DISK_CORNERS: u32 = 8;

/// The points of one prim, checked.
#[derive(Debug)]
pub(super) struct PointSet<'a>(Body<'a>);

/// A convex polyhedron with the area of the unit sphere.
struct Ball {
    /// Its corners, and their directions.
    corners: Vec<(DVec3, Vec3)>,
    triangles: Vec<[u32; 3]>,
    /// How far it is from the sphere at most.
    depth: f64,
}

impl<'a> PointSet<'a> {
    /// The points of `prim` with those of the primvars called `names` that it or (constant) `inherited` prims author.
    /// `None`, with a warning, where nothing can be drawn.
    pub(super) fn read(
        prim: &'a RawPrim,
        inherited: &[(String, &RawPrim)],
        names: &[String],
        diagnostics: &Diagnostics,
    ) -> Option<Self> {
        let points = vectors(prim, "points");
        if points.is_empty() {
            let message = "there is no point; it is left out";
            diagnostics.warn("empty-mesh", prim.path.clone(), message);
            return None;
        }
        if let Some(index) = points.iter().position(|point| !point.is_finite()) {
            let message = format!("point {index} is {}, not finite; left out", points[index]);
            diagnostics.warn("bad-points", prim.path.clone(), message);
            return None;
        }
        let layouts = Layouts::of(1, points.len(), points.len());
        let body = (prim, points, "points");
        let body = Body::read(body, (inherited, names), &layouts, diagnostics);
        Some(Self(body))
    }

    /// Spheres or disks in object space relative to the second value; spheres are about `depth` from the true ones at
    /// most, unless the points are too many for that. Points without width are not drawn.
    pub(super) fn tessellate(self, depth: f64) -> (Mesh, DVec3) {
        let mut mesh = Mesh {
            positions: Vec::new(),
            triangles: Vec::new(),
            triangle_faces: Vec::new(),
            normals: Normals::Flat,
            primvars: self.0.primvars.iter().map(laid_out).collect(),
            double_sided: self.0.double_sided,
            closed: self.0.normals.is_none(),
            cage: None,
            scheme: self.0.type_name.clone(),
        };
        let mut normals = Vec::new();
        match &self.0.normals {
            Some(of_points) => self.add_disks(of_points, (&mut mesh, &mut normals)),
            None => self.add_balls(depth, (&mut mesh, &mut normals)),
        }
        mesh.normals = Normals::Vertex(normals);
        (mesh, self.0.center)
    }

    fn radius(&self, point: usize) -> f64 {
        let width = match &self.0.widths {
            Some(widths) => widths.value_of(element(widths, point)).x,
            None => DEFAULT_WIDTH,
        };
        0.5 * f64::from(width).max(0.0)
    }

    /// Points that are drawn, with their radii.
    fn drawn(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        let all = (0..self.0.points.len()).map(|point| (point, self.radius(point)));
        all.filter(|(_, radius)| *radius > 0.0)
    }

    fn add_balls(&self, depth: f64, (mesh, normals): (&mut Mesh, &mut Vec<Vec3>)) {
        let balls = balls();
        let largest = self.drawn().map(|(_, radius)| radius).fold(0.0, f64::max);
        let mut depth = depth.max(FINEST * largest);
        let ball_of = |radius: f64, depth: f64| {
            let fits = |ball: &&Ball| ball.depth * radius <= depth;
            balls.iter().find(fits).unwrap_or(&balls[balls.len() - 1])
        };
        let triangles = |depth: f64| -> usize {
            let all = self.drawn().map(|(_, radius)| ball_of(radius, depth));
            all.map(|ball| ball.triangles.len()).sum()
        };
        while depth < largest && triangles(depth) > TRIANGLE_BUDGET {
            depth *= COARSENING;
        }
        for (point, radius) in self.drawn() {
            let ball = ball_of(radius, depth);
            let first = start(mesh, point, &ball.triangles);
            let middle = self.0.points[point].as_dvec3() - self.0.center;
            for (corner, direction) in &ball.corners {
                mesh.positions.push((middle + *corner * radius).as_vec3());
                normals.push(*direction);
            }
            debug_assert_eq!(first as usize + ball.corners.len(), mesh.positions.len());
        }
    }

    fn add_disks(&self, of_points: &AuthoredPrimvar, (mesh, normals): (&mut Mesh, &mut Vec<Vec3>)) {
        let angle = TAU / f64::from(DISK_CORNERS);
        // Of an octagon: its area is that of the disk.
        let stretch = (TAU / (f64::from(DISK_CORNERS) * angle.sin())).sqrt();
        let fan: Vec<[u32; 3]> = (1..DISK_CORNERS - 1).map(|k| [0, k, k + 1]).collect();
        for (point, radius) in self.drawn() {
            let value = of_points.value_of(element(of_points, point));
            let Some(normal) = value.truncate().as_dvec3().try_normalize() else {
                continue;
            };
            let (across, along) = normal.any_orthonormal_pair();
            start(mesh, point, &fan);
            let middle = self.0.points[point].as_dvec3() - self.0.center;
            for corner in 0..DISK_CORNERS {
                let (sine, cosine) = (angle * f64::from(corner)).sin_cos();
                let arm = (across * cosine + along * sine) * (radius * stretch);
                mesh.positions.push((middle + arm).as_vec3());
                normals.push(normal.as_vec3());
            }
        }
    }
}

/// Push triangles whose corners count from what comes next, which is the value.
fn start(mesh: &mut Mesh, point: usize, triangles: &[[u32; 3]]) -> u32 {
    let first = number(mesh.positions.len());
    let moved = triangles.iter().map(|corners| corners.map(|k| first + k));
    mesh.triangles.extend(moved);
    mesh.triangle_faces
        .resize(mesh.triangles.len(), number(point));
    first
}

fn number(count: usize) -> u32 {
    u32::try_from(count).expect("fewer than 2^32 of them")
}

/// Which element of `primvar` is that of `point`.
fn element(primvar: &AuthoredPrimvar, point: usize) -> usize {
    match primvar.layout {
        Layout::Constant | Layout::Uniform => 0,
        _ => point,
    }
}

/// Over triangles whose faces are points.
fn laid_out(primvar: &AuthoredPrimvar) -> Primvar {
    let interpolation = match primvar.layout {
        Layout::Constant | Layout::Uniform => Interpolation::Constant,
        _ => Interpolation::Uniform,
    };
    primvar.finish(interpolation, primvar.expanded())
}

/// An octahedron, an icosahedron, and this divided once and again: coarse ones first.
fn balls() -> Vec<Ball> {
    let octahedron = [
        DVec3::X,
        DVec3::NEG_X,
        DVec3::Y,
        DVec3::NEG_Y,
        DVec3::Z,
        DVec3::NEG_Z,
    ];
    let octants = [
        [0, 2, 4],
        [2, 1, 4],
        [1, 3, 4],
        [3, 0, 4],
        [2, 0, 5],
        [1, 2, 5],
        [3, 1, 5],
        [0, 3, 5],
    ];
    let mut all = vec![Ball::of(&octahedron, octants.to_vec())];
    let (mut corners, mut triangles) = icosahedron();
    all.push(Ball::of(&corners, triangles.clone()));
    for _ in 0..MOST_DIVISIONS {
        (corners, triangles) = divided(corners, &triangles);
        all.push(Ball::of(&corners, triangles.clone()));
    }
    all
}

fn icosahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let golden = f64::midpoint(1.0, 5.0_f64.sqrt());
    let corners = (0..12).map(|i| {
        let sign = |bit: u32| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let (one, far) = (sign(0), golden * sign(1));
        match i / 4 {
            0 => DVec3::new(0.0, one, far),
            1 => DVec3::new(one, far, 0.0),
            _ => DVec3::new(far, 0.0, one),
        }
    });
    let corners: Vec<DVec3> = corners.collect();
    let at = |i: u32| corners[i as usize];
    let is_edge = |a: u32, b: u32| (at(a).distance_squared(at(b)) - 4.0).abs() < 1e-9;
    let mut triangles = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if is_edge(a, b) && is_edge(b, c) && is_edge(c, a) {
                    let [p, q, r] = [a, b, c].map(at);
                    let is_outward = (q - p).cross(r - p).dot(p) > 0.0;
                    triangles.push(if is_outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    let units = corners.into_iter().map(DVec3::normalize).collect();
    (units, triangles)
}

/// Four triangles for each, their corners on the unit sphere.
fn divided(mut corners: Vec<DVec3>, triangles: &[[u32; 3]]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
            corners.push((corners[a as usize] + corners[b as usize]).normalize());
            number(corners.len() - 1)
        })
    };
    let mut parts = Vec::with_capacity(4 * triangles.len());
    for &[a, b, c] in triangles {
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        parts.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    (corners, parts)
}

impl Ball {
    /// The polyhedron with corners in these directions.
    fn of(directions: &[DVec3], triangles: Vec<[u32; 3]>) -> Self {
        let corners_of = |corners: &[u32; 3]| corners.map(|i| directions[i as usize]);
        let cross = |corners: &[u32; 3]| {
            let [a, b, c] = corners_of(corners);
            (b - a).cross(c - a)
        };
        let area: f64 = triangles.iter().map(|t| 0.5 * cross(t).length()).sum();
        let stretch = (4.0 * PI / area).sqrt();
        let faces = triangles.iter();
        let lowest = faces.map(|t| stretch * cross(t).normalize().dot(corners_of(t)[0]));
        let lowest = lowest.fold(f64::INFINITY, f64::min);
        let corners = directions
            .iter()
            .map(|&direction| (direction * stretch, direction.as_vec3()));
        Self {
            corners: corners.collect(),
            triangles,
            depth: (stretch - 1.0).max(1.0 - lowest),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::raw::Value;
    use super::super::tests::with_attribute;
    use super::*;

    fn points(values: Vec<(&str, Value)>) -> RawPrim {
        let prim = RawPrim::typed("/p", "Points", None);
        let add = |prim, (name, value)| with_attribute(prim, name, value, None);
        values.into_iter().fold(prim, add)
    }

    fn tessellated(prim: &RawPrim, depth: f64) -> (Mesh, DVec3, usize) {
        let diagnostics = Diagnostics::default();
        let set = PointSet::read(prim, &[], &["displayColor".to_owned()], &diagnostics);
        let (mesh, center) = set.expect("points").tessellate(depth);
        (mesh, center, diagnostics.warnings().len())
    }

    fn area(mesh: &Mesh) -> f64 {
        let cross = |t: usize| {
            let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3());
            0.5 * (b - a).cross(c - a).length()
        };
        (0..mesh.triangles.len()).map(cross).sum()
    }

    #[test]
    fn balls_are_closed_face_outward_and_have_the_area_and_the_mean_width_of_spheres() {
        let counts: Vec<usize> = balls().iter().map(|ball| ball.triangles.len()).collect();
        assert_eq!(counts, [8, 20, 80, 320, 1280]);
        assert!(balls().is_sorted_by(|a, b| a.depth > b.depth));
        for ball in balls() {
            let at = |i: u32| ball.corners[i as usize].0;
            let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
            for &[a, b, c] in &ball.triangles {
                assert!((at(b) - at(a)).cross(at(c) - at(a)).dot(at(a)) > 0.0);
                for edge in [(a, b), (b, c), (c, a)] {
                    *edges.entry(edge).or_default() += 1;
                }
            }
            assert!(
                edges
                    .iter()
                    .all(|(&(a, b), &n)| n == 1 && edges[&(b, a)] == 1)
            );
        }
        let widths = Value::FloatArray(vec![1.0]);
        for depth in [1.0, 0.1, 0.02, 1e-4] {
            let prim = points(vec![
                ("points", Value::Vec3Array(vec![Vec3::new(3.0, 1.0, 2.0)])),
                ("widths", widths.clone()),
            ]);
            let (mesh, center, warnings) = tessellated(&prim, depth);
            assert!((area(&mesh) - PI).abs() < 1e-5, "{}", area(&mesh));
            assert_eq!(warnings, 0);
            for position in &mesh.positions {
                let from = position.as_dvec3() + center - DVec3::new(3.0, 1.0, 2.0);
                assert!(
                    (from.length() - 0.5).abs() <= depth.max(2e-3),
                    "{depth} {from}"
                );
            }
        }
    }

    #[test]
    fn points_with_normals_are_disks_of_their_area_and_those_without_width_nothing() {
        let prim = points(vec![
            (
                "points",
                Value::Vec3Array(vec![Vec3::ZERO, Vec3::X, Vec3::Y]),
            ),
            ("widths", Value::FloatArray(vec![2.0, 0.0, 1.0])),
            (
                "normals",
                Value::Vec3Array(vec![Vec3::new(0.0, 3.0, 4.0), Vec3::X, Vec3::Z]),
            ),
        ]);
        let prim = with_attribute(
            prim,
            "primvars:displayColor",
            Value::Vec3Array(vec![Vec3::X, Vec3::Y, Vec3::Z]),
            Some("vertex"),
        );
        let (mesh, _, _) = tessellated(&prim, 0.1);
        assert!((area(&mesh) - 1.25 * PI).abs() < 1e-5);
        assert_eq!(
            (mesh.triangles.len(), mesh.double_sided, mesh.closed),
            (12, true, false)
        );
        for t in 0..12 {
            let (normal, color) = match t < 6 {
                true => (Vec3::new(0.0, 0.6, 0.8), Vec3::X),
                false => (Vec3::Z, Vec3::Z),
            };
            assert!(mesh.plane_normal(t).distance(normal) < 1e-6);
            let found = mesh
                .primvar("displayColor")
                .expect("asked for")
                .sample(&mesh, t, 0.3, 0.3);
            assert_eq!(found.truncate(), color);
        }
    }

    #[test]
    fn a_million_points_are_octahedra_and_odd_ones_are_told() {
        let many: Vec<Vec3> = (0..600_000).map(|i| Vec3::X * i as f32).collect();
        let widths = Value::FloatArray(vec![1.0; many.len()]);
        let prim = points(vec![("points", Value::Vec3Array(many)), ("widths", widths)]);
        assert_eq!(tessellated(&prim, 1e-3).0.triangles.len(), 8 * 600_000);
        let prim = points(vec![("points", Value::Vec3Array(vec![Vec3::ZERO]))]);
        assert_eq!(tessellated(&prim, 0.1).2, 1);
        let diagnostics = Diagnostics::default();
        for odd in [vec![], vec![Vec3::X, Vec3::splat(f32::NAN)]] {
            let prim = points(vec![("points", Value::Vec3Array(odd))]);
            assert!(PointSet::read(&prim, &[], &[], &diagnostics).is_none());
        }
        assert_eq!(diagnostics.warnings().len(), 2);
    }
}
