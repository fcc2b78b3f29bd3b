//! How often every subdivision mesh is refined.
//!
//! Wanted: refined edges no longer than asked, at most [`MAX_LEVEL`] levels, and enough of them for the sharpest finite
//! crease. Where no edge is asked for, facets that lie close to the surface need not have short edges too ([`Fineness`]).
//! A cage that is fine enough is not refined at all: its faces carry limit positions and normals, if
//! they are what the scheme refines into (quads, or triangles for Loop). Where the scene's sum goes beyond
//! [`FACE_BUDGET`] the asked edge is doubled until it fits or every mesh is at its least level; creases are followed
//! only as far as a mesh alone stays in the budget.

use super::authored::{AuthoredMesh, Scheme};
use super::subdivision::sharpness_levels;
use crate::diagnostics::Diagnostics;
use glam::DVec3;

/// Most levels: 256 faces for each of the cage.
const MAX_LEVEL: usize = 4;
/// Refined faces over all meshes of a scene.
const FACE_BUDGET: u64 = 1_000_000;
/// Edge asked for by default, as a part of the scene's diagonal. Where the surface bends with a radius of no less than
/// an edge, facets with corners on the limit surface are at most an eighth of an edge deep: half a pixel of a 1K image
/// that the scene fills.
const DEFAULT_EDGE: f64 = 1.0 / 250.0;

/// Facets may lie this deep below the surface: a part of the default edge, and of the mesh's own diagonal.
const DEPTH: (f64, f64) = (1.0 / 8.0, 1e-3);
/// Longest edge in the mesh's own diagonal that is trusted to show how a flat piece's outline bends: one on a circle is
/// then no deeper than [`DEPTH`] says.
const OUTLINE_EDGE: f64 = 1.0 / 16.0;

/// What a geometry asks for.
pub(super) enum Demand<'a> {
    /// Not subdivided.
    None,
    /// Refined as far as that says.
    Refined(&'a AuthoredMesh<'a>, Fineness),
}

/// When a level is fine enough; object space.
#[derive(Debug, Clone, Copy)]
pub(super) enum Fineness {
    /// Edges are no longer than this.
    Asked(f64),
    /// Edges are no longer than this (the default edge), or facets no deeper than [`DEPTH`].
    Default(f64),
}

impl Fineness {
    fn is_reached(self, shape: Shape, level: usize) -> bool {
        let halvings = f64::from(1_u32 << level);
        let edge = shape.longest_edge / halvings;
        match self {
            Self::Asked(longest) => edge <= longest,
            Self::Default(longest) => {
                let (of_edge, of_size) = DEPTH;
                let depth = shape.depth / (halvings * halvings);
                edge <= longest
                    || (edge <= OUTLINE_EDGE * shape.size
                        && depth <= (of_edge * longest).min(of_size * shape.size))
            }
        }
    }

    fn levels(self, shape: Shape) -> usize {
        (0..MAX_LEVEL)
            .find(|&level| self.is_reached(shape, level))
            .unwrap_or(MAX_LEVEL)
    }
}

/// The edge length asked for when the user asks for none, in a scene of this diagonal; world space.
pub(super) fn default_edge(diagonal: f64) -> f64 {
    DEFAULT_EDGE * diagonal
}

/// Levels of all geometries; 0 for those that are not refined or not subdivided.
pub(super) fn levels(demands: &[Demand], diagnostics: &Diagnostics) -> Vec<usize> {
    let plans: Vec<Option<Plan>> = demands
        .iter()
        .map(|demand| match demand {
            Demand::None => None,
            Demand::Refined(mesh, fineness) => Some(Plan::of(mesh, *fineness, diagnostics)),
        })
        .collect();
    let level = |plan: &Option<Plan>, coarser: usize| plan.as_ref().map_or(0, |p| p.level(coarser));
    let total = |coarser: usize| -> u64 {
        let all = plans.iter().flatten();
        all.map(|plan| plan.faces(plan.level(coarser)))
            .fold(0, u64::saturating_add)
    };
    let coarser = (0..MAX_LEVEL).find(|&coarser| total(coarser) <= FACE_BUDGET);
    let coarser = coarser.unwrap_or(MAX_LEVEL);
    plans.iter().map(|plan| level(plan, coarser)).collect()
}

/// Triangles of `mesh` after `level` levels. Faces refine into as many quads as they have corners (triangles of Loop into
/// four), and these into four each.
pub(super) fn triangle_count(mesh: &AuthoredMesh, level: usize) -> usize {
    let corners = |face: usize| mesh.topology.points_of(face).len();
    let drawn = mesh.topology.drawn();
    match (mesh.scheme, level) {
        (Scheme::Loop, _) => drawn.count() << (2 * level),
        (_, 0) => drawn.map(|face| corners(face) - 2).sum(),
        _ => drawn.map(corners).sum::<usize>() << (2 * level - 1),
    }
}

struct Plan {
    wanted: usize,
    least: usize,
    cage_faces: u64,
    /// Faces after the first level.
    first_faces: u64,
}

impl Plan {
    fn of(mesh: &AuthoredMesh, fineness: Fineness, diagnostics: &Diagnostics) -> Self {
        let first_faces = match mesh.scheme {
            Scheme::Loop => 4 * mesh.topology.counts.len() as u64,
            _ => mesh.topology.indices.len() as u64,
        };
        let mut plan = Self {
            wanted: fineness.levels(Shape::of(mesh)),
            least: least_level(mesh),
            cage_faces: mesh.topology.counts.len() as u64,
            first_faces,
        };
        let needed = sharpness_levels(&mesh.prim);
        plan.least = (plan.least..=needed.clamp(plan.least, MAX_LEVEL))
            .rev()
            .find(|&level| plan.faces(level) <= FACE_BUDGET)
            .unwrap_or(plan.least);
        if plan.least < needed {
            diagnostics.warn(
                "sharp-crease",
                mesh.prim.path.clone(),
                format!("creases are followed for {} levels of the {needed} that their sharpness asks for; what is left of them stays sharp", plan.least),
            );
        }
        plan
    }

    fn level(&self, coarser: usize) -> usize {
        self.wanted
            .saturating_sub(coarser)
            .clamp(self.least, MAX_LEVEL)
    }

    fn faces(&self, level: usize) -> u64 {
        match level {
            0 => self.cage_faces,
            _ => self.first_faces << (2 * (level - 1)),
        }
    }
}

/// 0 where the limit can be taken on the cage itself: all its faces are what the scheme refines into. (The limit rules
/// hold for no others.)
fn least_level(mesh: &AuthoredMesh) -> usize {
    let size = mesh.scheme.face_size();
    let is_plain = mesh.topology.counts.iter().all(|&count| count == size);
    usize::from(!is_plain)
}

/// How large and how bent a cage is, object space.
#[derive(Debug, Clone, Copy)]
struct Shape {
    /// Diagonal of its box.
    size: f64,
    longest_edge: f64,
    /// Estimate of how deep its deepest facet lies below a smooth surface through its points: a quarter of an edge
    /// times the distance between the unit normals of face and point, which on a circle is the arc's height. It
    /// quarters with every level.
    depth: f64,
}

impl Shape {
    fn of(mesh: &AuthoredMesh) -> Self {
        let topology = &mesh.topology;
        let at = |point: u32| mesh.points[point as usize].as_dvec3();
        let normal_of = |face: usize| {
            let points = topology.points_of(face);
            let fan = points.windows(2).skip(1);
            let first = at(points[0]);
            fan.map(|pair| (at(pair[0]) - first).cross(at(pair[1]) - first))
                .sum::<DVec3>()
        };
        let mut point_normals = vec![DVec3::ZERO; mesh.points.len()];
        let mut bounds = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for face in topology.drawn() {
            let normal = normal_of(face);
            for &point in topology.points_of(face) {
                point_normals[point as usize] += normal;
                bounds = (bounds.0.min(at(point)), bounds.1.max(at(point)));
            }
        }
        let mut shape = Self {
            size: (bounds.1 - bounds.0).length(),
            longest_edge: 0.0,
            depth: 0.0,
        };
        for face in topology.drawn() {
            let points = topology.points_of(face);
            let normal = normal_of(face).normalize_or_zero();
            for (&a, &b) in points.iter().zip(points.iter().cycle().skip(1)) {
                let edge = at(a).distance(at(b));
                let turn = [a, b].map(|point| {
                    let of_point = point_normals[point as usize].normalize_or_zero();
                    normal.distance(of_point)
                });
                shape.longest_edge = shape.longest_edge.max(edge);
                shape.depth = shape.depth.max(0.25 * edge * turn[0].max(turn[1]));
            }
        }
        shape
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::raw::{RawPrim, Value};
    use super::super::tests::{mesh, with_attribute, with_ints, with_token};
    use super::*;
    use glam::Vec3;
    use std::borrow::Cow;

    /// A row of unit quads.
    fn strip(count: i32) -> RawPrim {
        let indices: Vec<i32> = (0..count)
            .flat_map(|i| [2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1])
            .collect();
        #[expect(clippy::cast_precision_loss, reason = "below 2^24")]
        let points: Vec<Vec3> = (0..=count)
            .flat_map(|i| [Vec3::X * i as f32, Vec3::X * i as f32 + Vec3::Y])
            .collect();
        let counts = vec![4; usize::try_from(count).unwrap()];
        let prim = mesh("/m", &points, &counts, &indices);
        with_token(prim, "subdivisionScheme", "catmullClark")
    }

    fn level(prim: &RawPrim, edges: &[f64]) -> (Vec<usize>, usize) {
        let diagnostics = Diagnostics::default();
        let authored = AuthoredMesh::read(Cow::Borrowed(prim), &[], &[], &diagnostics);
        let authored = authored.unwrap().unwrap();
        let demands: Vec<Demand> = edges
            .iter()
            .map(|&edge| Demand::Refined(&authored, Fineness::Asked(edge)))
            .collect();
        (levels(&demands, &diagnostics), diagnostics.warnings().len())
    }

    #[test]
    fn edges_are_halved_until_they_are_short_enough_within_bounds() {
        let strip = strip(3);
        for (edge, expected) in [
            (2.0, 0),
            (1.0, 0),
            (0.5, 1),
            (0.26, 2),
            (0.25, 2),
            (0.1, 4),
            (0.0, 4),
        ] {
            assert_eq!(level(&strip, &[edge]), (vec![expected], 0), "edge {edge}");
        }
    }

    #[test]
    fn a_scene_beyond_the_budget_is_refined_less_everywhere() {
        // 40 000 faces at level 4 are 10 M, at level 3 2.56 M, at level 2 640 k; seven meshes of them 280 k.
        let strip = strip(40_000);
        assert_eq!(level(&strip, &[0.01]).0, [2]);
        assert_eq!(level(&strip, &[0.01; 4]).0, [1; 4]);
        assert_eq!(level(&strip, &[0.01; 7]).0, [0; 7]);
        assert_eq!(level(&strip, &[0.01, 1.0]).0, [2, 0]);
    }

    #[test]
    fn creases_raise_the_level_as_far_as_the_budget_allows() {
        let creased = |count: i32, sharpness: f32| {
            let prim = with_ints(strip(count), "creaseIndices", &[0, 2]);
            let prim = with_ints(prim, "creaseLengths", &[2]);
            let sharpness = Value::FloatArray(vec![sharpness]);
            with_attribute(prim, "creaseSharpnesses", sharpness, None)
        };
        assert_eq!(level(&creased(3, 2.5), &[2.0]), (vec![3], 0));
        assert_eq!(level(&creased(3, 10.0), &[2.0]), (vec![0], 0));
        assert_eq!(level(&creased(3, 7.0), &[2.0]), (vec![4], 1));
        assert_eq!(level(&creased(40_000, 3.0), &[2.0]), (vec![2], 1));
    }

    #[test]
    fn faces_that_are_not_the_schemes_own_are_refined_once() {
        let triangle = mesh("/m", &[Vec3::ZERO, Vec3::X, Vec3::Y], &[3], &[0, 1, 2]);
        let scheme = |word: &str| with_token(triangle.clone(), "subdivisionScheme", word);
        assert_eq!(level(&scheme("catmullClark"), &[9.0]).0, [1]);
        assert_eq!(level(&scheme("bilinear"), &[9.0]).0, [1]);
        assert_eq!(level(&scheme("loop"), &[9.0]).0, [0]);
    }

    /// A tube of radius 1 and `around` square-ish faces a ring: the arc's height is 1 − cos(π / around).
    fn tube(around: u16) -> RawPrim {
        let rows = 0..=around;
        let points: Vec<Vec3> = rows
            .flat_map(|row| (0..around).map(move |i| (row, i)))
            .map(|(row, i)| {
                let turn = std::f32::consts::TAU / f32::from(around);
                let (sine, cosine) = (turn * f32::from(i)).sin_cos();
                Vec3::new(cosine, sine, turn * f32::from(row))
            })
            .collect();
        let n = i32::from(around);
        let quads = (0..n).flat_map(|row| (0..n).map(move |i| (row * n, i)));
        let indices: Vec<i32> = quads
            .flat_map(|(row, i)| [i, (i + 1) % n, (i + 1) % n + n, i + n].map(|k| row + k))
            .collect();
        let prim = mesh("/m", &points, &vec![4; indices.len() / 4], &indices);
        with_token(prim, "subdivisionScheme", "catmullClark")
    }

    #[test]
    fn facets_close_to_the_surface_may_have_long_edges_unless_asked() {
        for (around, expected) in [(100, 0), (60, 0), (24, 1), (8, 3)] {
            let prim = tube(around);
            let diagnostics = Diagnostics::default();
            let authored = AuthoredMesh::read(Cow::Borrowed(&prim), &[], &[], &diagnostics);
            let authored = authored.unwrap().unwrap();
            let shape = Shape::of(&authored);
            let height = 1.0 - (std::f64::consts::PI / f64::from(around)).cos();
            assert!(
                (shape.depth / height - 1.0).abs() < 0.06,
                "{shape:?} for {height}"
            );
            // The default edge of a scene that the tube fills.
            let edge = default_edge(shape.size);
            let demand = [Demand::Refined(&authored, Fineness::Default(edge))];
            assert_eq!(
                levels(&demand, &diagnostics),
                [expected],
                "{around}: {shape:?}"
            );
            let demand = [Demand::Refined(
                &authored,
                Fineness::Asked(0.9 * shape.longest_edge),
            )];
            assert_eq!(levels(&demand, &diagnostics), [1]);
        }
    }

    #[test]
    fn nothing_to_refine_gives_level_zero() {
        let diagnostics = Diagnostics::default();
        assert_eq!(levels(&[Demand::None], &diagnostics), [0]);
    }
}
