//! Shading normals of polygon meshes, authored or flat, and what the cage keeps of them.
//!
//! Authored: `primvars:normals` wins over `normals`. Without either a polygon mesh is faceted, as in Hydra: hdEmbree
//! (`mesh.cpp`) forces smooth normals off for the schemes `none` and `bilinear`.

use super::super::super::raw::RawPrim;
use super::primvars::{AuthoredPrimvar, Layout, read_attribute};
use super::topology::Topology;
use super::triangulate::area_vector;
use crate::diagnostics::Diagnostics;
use crate::scene::Normals;
use glam::{DVec3, Vec3};

/// Normals that differ by less than this (1 − cosine; 0.08°, above the rounding of half floats) count as one.
const SAME_NORMAL: f32 = 1e-6;

/// The attributes that have them, stronger ones first, and what else belongs to these.
pub(super) const NORMALS: [&str; 3] = ["primvars:normals", "normals", "primvars:normals:indices"];

/// Normals of the authored points or face-vertices, unit (or zero where none could be found).
#[derive(Debug, Clone, PartialEq)]
pub(super) enum CageNormals {
    /// The faces' own.
    Flat,
    /// One a point.
    Point(Vec<Vec3>),
    /// One a face-vertex.
    Corner(Vec<Vec3>),
}

impl CageNormals {
    /// Authored normals of `prim`, else flat ones.
    pub(super) fn read(prim: &RawPrim, topology: &Topology, diagnostics: &Diagnostics) -> Self {
        for (name, fallback) in [("primvars:normals", "constant"), ("normals", "vertex")] {
            let Some(attribute) = prim.attributes.get(name) else {
                continue;
            };
            if attribute.value.is_none() {
                continue;
            }
            let indices = prim.attributes.get(&format!("{name}:indices"));
            let interpolation = attribute.interpolation.as_deref().unwrap_or(fallback);
            match read_attribute(attribute, indices, Some(interpolation), topology) {
                Ok(normals) => return Self::from_primvar(&normals, topology),
                Err(message) => diagnostics.warn(
                    "bad-normals",
                    prim.path.clone(),
                    format!("{name} is ignored: {message}"),
                ),
            }
        }
        Self::Flat
    }

    fn from_primvar(normals: &AuthoredPrimvar, topology: &Topology) -> Self {
        let expanded = normals.expanded();
        let mut values = expanded.iter().map(|v| v.truncate().normalize_or_zero());
        match normals.layout {
            Layout::Vertex | Layout::Varying => Self::Point(values.collect()),
            Layout::FaceVarying => Self::Corner(values.collect()).merged(topology),
            Layout::Constant => {
                let value = values.next().unwrap_or(Vec3::ZERO);
                Self::Point(vec![value; topology.point_count])
            }
            Layout::Uniform => {
                let counts = topology.counts.iter();
                let corners = counts
                    .zip(values)
                    .flat_map(|(&count, value)| std::iter::repeat_n(value, count as usize));
                Self::Corner(corners.collect()).merged(topology)
            }
        }
    }

    /// One normal a point where no point has two.
    fn merged(self, topology: &Topology) -> Self {
        let Self::Corner(corners) = self else {
            return self;
        };
        let mut points = vec![Vec3::ZERO; topology.point_count];
        for corner in topology.drawn().flat_map(|face| topology.corners(face)) {
            let point = &mut points[topology.indices[corner] as usize];
            let normal = corners[corner];
            if *point == Vec3::ZERO {
                *point = normal;
            } else if normal.dot(*point) < 1.0 - SAME_NORMAL {
                return Self::Corner(corners);
            }
        }
        Self::Point(points)
    }

    /// Over triangles; those of face-vertices are still without `corners`.
    pub(super) fn on_triangles(&self) -> Normals {
        match self {
            Self::Flat => Normals::Flat,
            Self::Point(values) => Normals::Vertex(values.clone()),
            Self::Corner(values) => Normals::Corner {
                corners: Vec::new(),
                values: values.clone(),
            },
        }
    }

    /// Normals for `Cage`: one a point (area-weighted over its faces where they differ) and, where they differ, one
    /// a face-vertex. `flipped`: the front of the faces follows the left hand.
    pub(super) fn for_cage(
        self,
        topology: &Topology,
        positions: &[Vec3],
        flipped: bool,
    ) -> (Vec<Vec3>, Vec<Vec3>) {
        let sign = if flipped { -1.0 } else { 1.0 };
        let area_of = |face: usize| sign * area_vector(topology.points_of(face), positions);
        let (mut corners, is_flat) = match self {
            Self::Point(mut points) => {
                clear_unused(&mut points, topology);
                return (points, Vec::new());
            }
            Self::Corner(corners) => (corners, false),
            Self::Flat => (vec![Vec3::ZERO; topology.indices.len()], true),
        };
        let mut sums = vec![DVec3::ZERO; topology.point_count];
        for face in 0..topology.face_count() {
            let area = area_of(face);
            if is_flat {
                corners[topology.corners(face)].fill(area.normalize_or_zero().as_vec3());
            }
            if topology.is_drawn[face] {
                let area = area.length();
                for corner in topology.corners(face) {
                    sums[topology.indices[corner] as usize] += area * corners[corner].as_dvec3();
                }
            }
        }
        let unit = |sum: &DVec3| sum.normalize_or_zero().as_vec3();
        let points = sums.iter().map(unit).collect();
        drop(sums);
        match Self::Corner(corners).merged(topology) {
            Self::Corner(corners) => (points, corners),
            _ => (points, Vec::new()),
        }
    }
}

fn clear_unused(points: &mut [Vec3], topology: &Topology) {
    let mut is_used = vec![false; points.len()];
    for &point in topology.drawn().flat_map(|face| topology.points_of(face)) {
        is_used[point as usize] = true;
    }
    for (normal, used) in points.iter_mut().zip(is_used) {
        if !used {
            *normal = Vec3::ZERO;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::raw::Value;
    use super::super::tests::{mesh, with_attribute};
    use super::*;

    /// Two unit squares at a right angle along the edge of points 1 and 2: fronts towards −Y... +Z and −X.
    fn bent() -> (RawPrim, Topology<'static>, Vec<Vec3>) {
        let points = vec![
            Vec3::ZERO,
            Vec3::X,
            Vec3::new(1.0, 1.0, 0.0),
            Vec3::Y,
            Vec3::new(1.0, 0.0, 1.0),
            Vec3::new(1.0, 1.0, 1.0),
        ];
        let prim = mesh("/m", &points, &[4, 4], &[0, 1, 2, 3, 1, 4, 5, 2]);
        let topology = Topology::read(&prim, 6, &Diagnostics::default()).unwrap();
        let topology = topology.into_owned();
        (prim, topology, points)
    }

    fn read(prim: &RawPrim, topology: &Topology<'_>) -> (CageNormals, usize) {
        let diagnostics = Diagnostics::default();
        let normals = CageNormals::read(prim, topology, &diagnostics);
        (normals, diagnostics.warnings().len())
    }

    #[test]
    fn a_polygon_mesh_without_normals_is_faceted_and_splits_at_the_bend() {
        let (prim, topology, points) = bent();
        let (normals, _) = read(&prim, &topology);
        assert_eq!(normals, CageNormals::Flat);
        let (at_points, at_corners) = normals.for_cage(&topology, &points, false);
        assert_eq!(at_corners[..4], [Vec3::Z; 4]);
        assert_eq!(at_corners[4..], [Vec3::NEG_X; 4]);
        assert_eq!(at_points[0], Vec3::Z);
        let middle = (Vec3::Z - Vec3::X).normalize();
        assert!(at_points[1].distance(middle) < 1e-6);
    }

    #[test]
    fn left_handed_faces_look_the_other_way() {
        let (_, topology, points) = bent();
        let (at_points, _) = CageNormals::Flat.for_cage(&topology, &points, true);
        assert_eq!(at_points[0], Vec3::NEG_Z);
    }

    #[test]
    fn a_flat_mesh_has_no_split_normals_and_unused_points_have_none() {
        let points = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];
        let prim = mesh("/m", &points, &[3], &[0, 1, 2]);
        let topology = Topology::read(&prim, 4, &Diagnostics::default()).unwrap();
        let (at_points, at_corners) = CageNormals::Flat.for_cage(&topology, &points, false);
        assert_eq!(at_points, [Vec3::Z, Vec3::Z, Vec3::Z, Vec3::ZERO]);
        assert!(at_corners.is_empty());
    }

    #[test]
    fn primvars_normals_win_over_normals_and_are_made_unit() {
        let (prim, topology, _) = bent();
        let prim = with_attribute(prim, "normals", Value::Vec3Array(vec![Vec3::X; 6]), None);
        assert_eq!(
            read(&prim, &topology).0,
            CageNormals::Point(vec![Vec3::X; 6])
        );
        let constant = Value::Vec3Array(vec![Vec3::Y * 3.0]);
        let prim = with_attribute(prim, "primvars:normals", constant, None);
        assert_eq!(
            read(&prim, &topology).0,
            CageNormals::Point(vec![Vec3::Y; 6])
        );
    }

    #[test]
    fn indexed_face_varying_normals_merge_unless_they_split() {
        let (prim, topology, _) = bent();
        let indexed = |indices: Vec<i32>| {
            let values = Value::Vec3Array(vec![Vec3::Z, Vec3::NEG_X]);
            let prim = with_attribute(
                prim.clone(),
                "primvars:normals",
                values,
                Some("faceVarying"),
            );
            with_attribute(
                prim,
                "primvars:normals:indices",
                Value::IntArray(indices),
                None,
            )
        };
        let split = read(&indexed(vec![0, 0, 0, 0, 1, 1, 1, 1]), &topology).0;
        assert!(matches!(split, CageNormals::Corner(_)));
        let smooth = read(&indexed(vec![0, 0, 0, 0, 0, 1, 1, 0]), &topology).0;
        assert!(matches!(smooth, CageNormals::Point(_)));
        let uniform = with_attribute(
            prim,
            "normals",
            Value::Vec3Array(vec![Vec3::Z, Vec3::NEG_X]),
            Some("uniform"),
        );
        assert_eq!(read(&uniform, &topology).0, split);
    }

    #[test]
    fn normals_of_the_wrong_length_are_replaced_with_a_warning() {
        let (prim, topology, _) = bent();
        let prim = with_attribute(prim, "normals", Value::Vec3Array(vec![Vec3::X; 5]), None);
        assert_eq!(read(&prim, &topology), (CageNormals::Flat, 1));
    }
}
