//! A Mesh prim as authored, checked, and the polygon mesh it is without subdivision.

use super::super::super::Error;
use super::super::super::raw::{RawPrim, Value};
use super::attributes::{boolean, ints, token, vectors};
use super::bodies;
use super::normals::{CageNormals, NORMALS};
use super::primvars::{AuthoredPrimvar, Layout};
use super::topology::{self, Boundary, Topology, is_left_handed};
use super::triangulate::{Corners, Triangulation};
use crate::diagnostics::Diagnostics;
use crate::math::Bounds3;
use crate::scene::{Cage, Mesh, Normals, Primvar};
use glam::{DVec3, Vec3};
use std::borrow::Cow;

/// A box counts as far from zero when its center is this many times its size away: fewer than 4 bits of an f32 are
/// lost below that. Ordinary geometry so keeps its exact authored numbers.
const FAR: f64 = 16.0;

/// Where positions inside `min`…`max` are best stored relative to: exactly 0 unless the box is far from it.
pub(super) fn local_origin(min: DVec3, max: DVec3) -> DVec3 {
    let center = 0.5 * (min + max);
    let is_far = center.abs().max_element() > FAR * (max - min).length();
    if is_far && center.is_finite() && max.cmpge(min).all() {
        center.as_vec3().as_dvec3()
    } else {
        DVec3::ZERO
    }
}

/// `subdivisionScheme`, known words only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scheme {
    None,
    CatmullClark,
    Loop,
    Bilinear,
}

impl Scheme {
    /// Its USD token.
    pub(super) fn token(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::CatmullClark => "catmullClark",
            Self::Loop => "loop",
            Self::Bilinear => "bilinear",
        }
    }

    /// Vertices of every refined face.
    pub(super) fn face_size(self) -> u32 {
        if self == Self::Loop { 3 } else { 4 }
    }

    fn read(prim: &RawPrim, diagnostics: &Diagnostics) -> Self {
        match token(prim, "subdivisionScheme", "catmullClark") {
            "catmullClark" => Self::CatmullClark,
            "loop" => Self::Loop,
            "bilinear" => Self::Bilinear,
            "none" => Self::None,
            word => {
                diagnostics.warn(
                    "unknown-scheme",
                    prim.path.clone(),
                    format!("subdivisionScheme {word:?} is none of catmullClark, loop, bilinear, none; drawn as polygons"),
                );
                Self::None
            }
        }
    }
}

/// A mesh whose arrays agree: valid topology, finite points.
#[derive(Debug)]
pub(super) struct AuthoredMesh<'a> {
    /// Without the arrays that are here, if it is the mesh's own.
    pub(super) prim: Cow<'a, RawPrim>,
    /// Positions are relative to this (object space): 0 unless the points are far from it.
    pub(super) center: DVec3,
    pub(super) points: Cow<'a, [Vec3]>,
    pub(super) topology: Topology<'a>,
    pub(super) scheme: Scheme,
    pub(super) left_handed: bool,
    pub(super) primvars: Vec<AuthoredPrimvar>,
}

impl<'a> AuthoredMesh<'a> {
    /// Read `prim` with those of the primvars called `names` that it or (constant) `inherited` prims author.
    /// `None`, with a warning, for a mesh without anything to draw.
    ///
    /// # Errors
    /// Arrays that contradict each other, points that are not finite.
    pub(super) fn read(
        mut prim: Cow<'a, RawPrim>,
        inherited: &[(String, &RawPrim)],
        names: &[String],
        diagnostics: &Diagnostics,
    ) -> Result<Option<Self>, Error> {
        let points = take_points(&mut prim);
        check_points(&prim, &points)?;
        let faces = take_faces(&mut prim);
        let topology = Topology::of(&prim, faces, points.len(), diagnostics)?;
        if topology.drawn().next().is_none() {
            diagnostics.warn(
                "empty-mesh",
                prim.path.clone(),
                "the mesh has no faces and is left out",
            );
            return Ok(None);
        }
        let center = center_of(&points);
        let primvars = read_primvars(&mut prim, inherited, names, &topology, diagnostics);
        Ok(Some(Self {
            center,
            points: relative(points, center),
            topology,
            scheme: Scheme::read(&prim, diagnostics),
            left_handed: is_left_handed(&prim),
            primvars,
            prim,
        }))
    }

    /// The mesh as polygons, without subdivision. What takes most memory on its way comes first.
    pub(super) fn into_polygons(mut self, diagnostics: &Diagnostics) -> Mesh {
        let boundary = self.topology.boundary();
        let normals = CageNormals::read(&self.prim, &self.topology, diagnostics);
        if let Cow::Owned(prim) = &mut self.prim {
            for name in NORMALS {
                prim.attributes.remove(name);
            }
        }
        let mut shading = normals.on_triangles();
        let (point_normals, corner_normals) =
            normals.for_cage(&self.topology, &self.points, self.left_handed);
        let triangulation = self.triangulate(match self.lists_corners(&shading) {
            true => Corners::Listed,
            false => Corners::NotNeeded,
        });
        self.topology.offsets = Vec::new();
        if let Normals::Corner { corners, .. } = &mut shading {
            corners.clone_from(&triangulation.corners);
        }
        let primvars = self.lay_out_primvars(triangulation.corners);
        let positions = std::mem::take(&mut self.points).into_owned();
        self.finish(Parts {
            positions,
            triangles: triangulation.triangles,
            triangle_faces: triangulation.faces,
            normals: shading,
            primvars,
            point_normals,
            corner_normals,
            boundary,
            scheme: Scheme::None,
        })
    }

    /// Over the triangles whose face-vertices are `corners`; the last that needs these has them.
    fn lay_out_primvars(&mut self, mut corners: Vec<[u32; 3]>) -> Vec<Primvar> {
        let all = std::mem::take(&mut self.primvars);
        let is_listed = |primvar: &AuthoredPrimvar| primvar.layout == Layout::FaceVarying;
        let last = all.iter().rposition(is_listed);
        let laid_out = all.into_iter().enumerate().map(|(index, primvar)| {
            let own = match is_listed(&primvar) {
                true if Some(index) == last => std::mem::take(&mut corners),
                true => corners.clone(),
                false => Vec::new(),
            };
            primvar.on_polygons(own)
        });
        laid_out.collect()
    }

    /// True if anything is listed by the corners of triangles.
    fn lists_corners(&self, normals: &Normals) -> bool {
        let is_listed = |primvar: &AuthoredPrimvar| primvar.layout == Layout::FaceVarying;
        matches!(normals, Normals::Corner { .. }) || self.primvars.iter().any(is_listed)
    }

    /// The cage as polygons, flat and bare, in the place of the surface that it refines into.
    pub(super) fn into_cage_polygons(mut self) -> Mesh {
        let boundary = self.topology.boundary();
        let triangulation = self.triangulate(Corners::NotNeeded);
        let (positions, scheme) = (std::mem::take(&mut self.points).into_owned(), self.scheme);
        self.finish(Parts {
            positions,
            triangles: triangulation.triangles,
            triangle_faces: triangulation.faces,
            normals: Normals::Flat,
            primvars: Vec::new(),
            point_normals: Vec::new(),
            corner_normals: Vec::new(),
            boundary,
            scheme,
        })
    }

    /// Front faces counter-clockwise.
    fn triangulate(&self, corners: Corners) -> Triangulation {
        let vertices = self.topology.drawn().map(|face| self.topology.counts[face]);
        let count = vertices.map(|count| count as usize - 2).sum();
        let mut triangulation = Triangulation::with_capacity(count, corners);
        for face in self.topology.drawn() {
            triangulation.add(
                u32::try_from(face).expect("offsets of all faces fit u32"),
                self.topology.offsets[face],
                self.topology.points_of(face),
                &self.points,
            );
        }
        if self.left_handed {
            triangulation.flip();
        }
        triangulation
    }

    /// Add what does not depend on how the surface was made.
    pub(super) fn finish(self, parts: Parts) -> Mesh {
        let boundary = parts.boundary;
        Mesh {
            positions: parts.positions,
            triangles: parts.triangles,
            triangle_faces: parts.triangle_faces,
            normals: parts.normals,
            primvars: parts.primvars,
            double_sided: boolean(&self.prim, "doubleSided", false),
            closed: boundary.is_closed,
            cage: Some(Cage {
                point_count: self.topology.point_count,
                face_vertex_counts: self.topology.counts.into_owned(),
                face_vertex_indices: self.topology.indices.into_owned(),
                point_normals: parts.point_normals,
                corner_normals: parts.corner_normals,
                on_boundary: boundary.on_boundary,
            }),
            scheme: parts.scheme.token().to_owned(),
        }
    }
}

/// What making the surface results in; see [`Mesh`] and [`Cage`].
#[derive(Debug)]
pub(super) struct Parts {
    pub(super) positions: Vec<Vec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) triangle_faces: Vec<u32>,
    pub(super) normals: Normals,
    pub(super) primvars: Vec<Primvar>,
    pub(super) point_normals: Vec<Vec3>,
    pub(super) corner_normals: Vec<Vec3>,
    pub(super) boundary: Boundary,
    pub(super) scheme: Scheme,
}

fn check_points(prim: &RawPrim, points: &[Vec3]) -> Result<(), Error> {
    let bad = points.iter().position(|point| !point.is_finite());
    match bad {
        None => Ok(()),
        Some(index) => Err(Error::Mesh {
            prim: prim.path.clone(),
            message: format!(
                "point {index} is {}, all coordinates must be finite",
                points[index]
            ),
        }),
    }
}

fn center_of(points: &[Vec3]) -> DVec3 {
    let bounds = Bounds3::around(points.iter().copied());
    local_origin(bounds.min.as_dvec3(), bounds.max.as_dvec3())
}

fn relative(points: Cow<'_, [Vec3]>, center: DVec3) -> Cow<'_, [Vec3]> {
    if center == DVec3::ZERO {
        return points;
    }
    let mut points = points.into_owned();
    for point in &mut points {
        *point = (point.as_dvec3() - center).as_vec3();
    }
    Cow::Owned(points)
}

fn take_points<'a>(prim: &mut Cow<'a, RawPrim>) -> Cow<'a, [Vec3]> {
    let own = |value| match value {
        Value::Vec3Array(points) => Some(points),
        _ => None,
    };
    bodies::array(prim, "points", own, |prim| vectors(prim, "points"))
}

fn take_faces<'a>(prim: &mut Cow<'a, RawPrim>) -> (Cow<'a, [i32]>, Cow<'a, [i32]>) {
    let own = |value| match value {
        Value::IntArray(numbers) => Some(numbers),
        _ => None,
    };
    let mut take = |name| bodies::array(prim, name, own, |prim| ints(prim, name));
    let [counts, indices] = topology::ARRAYS;
    (take(counts), take(indices))
}

fn read_primvars(
    prim: &mut Cow<'_, RawPrim>,
    inherited: &[(String, &RawPrim)],
    names: &[String],
    topology: &Topology,
    diagnostics: &Diagnostics,
) -> Vec<AuthoredPrimvar> {
    let read = |name: &String| {
        let own = AuthoredPrimvar::read(prim, name, topology, diagnostics);
        if let (Some(_), Cow::Owned(prim)) = (&own, &mut *prim) {
            prim.attributes.remove(&format!("primvars:{name}"));
            prim.attributes.remove(&format!("primvars:{name}:indices"));
        }
        own.or_else(|| {
            let (_, owner) = inherited.iter().find(|(inherited, _)| inherited == name)?;
            AuthoredPrimvar::read(owner, name, topology, diagnostics)
        })
    };
    names.iter().filter_map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{mesh, with_attribute};
    use super::*;

    fn polygons(prim: &RawPrim) -> Mesh {
        let diagnostics = Diagnostics::default();
        let authored = AuthoredMesh::read(Cow::Borrowed(prim), &[], &[], &diagnostics);
        authored.unwrap().unwrap().into_polygons(&diagnostics)
    }

    #[test]
    fn a_point_that_is_not_finite_is_named() {
        let points = [Vec3::ZERO, Vec3::X, Vec3::new(0.0, f32::NAN, 1.0)];
        let prim = mesh("/World/m", &points, &[3], &[0, 1, 2]);
        let error = AuthoredMesh::read(Cow::Borrowed(&prim), &[], &[], &Diagnostics::default())
            .unwrap_err();
        assert_eq!(
            error.to_string(),
            "mesh /World/m: point 2 is [0, NaN, 1], all coordinates must be finite"
        );
    }

    #[test]
    fn meshes_without_faces_are_left_out_with_a_warning() {
        let prim = mesh("/m", &[], &[], &[]);
        let diagnostics = Diagnostics::default();
        let read = AuthoredMesh::read(Cow::Borrowed(&prim), &[], &[], &diagnostics).unwrap();
        assert!(read.is_none());
        assert_eq!(diagnostics.warnings()[0].kind, "empty-mesh");
    }

    #[test]
    fn left_handed_meshes_are_turned_while_the_cage_keeps_its_order() {
        let prim = mesh("/m", &[Vec3::ZERO, Vec3::X, Vec3::Y], &[3], &[0, 1, 2]);
        let left = with_attribute(
            prim.clone(),
            "orientation",
            Value::Token("leftHanded".into()),
            None,
        );
        assert_eq!(polygons(&prim).plane_normal(0), Vec3::Z);
        let left = polygons(&left);
        assert_eq!(left.plane_normal(0), Vec3::NEG_Z);
        let cage = left.cage.unwrap();
        assert_eq!(cage.face_vertex_indices, [0, 1, 2]);
        assert_eq!(cage.point_normals, [Vec3::NEG_Z; 3]);
    }

    #[test]
    fn points_far_away_keep_their_shape_relative_to_their_center() {
        let far = Vec3::new(1e6, 0.0, 0.0);
        let points = [far, far + Vec3::X, far + Vec3::Y];
        let prim = mesh("/m", &points, &[3], &[0, 1, 2]);
        let read = AuthoredMesh::read(Cow::Borrowed(&prim), &[], &[], &Diagnostics::default());
        let authored = read.unwrap().unwrap();
        assert_eq!(authored.points[1] - authored.points[0], Vec3::X);
        assert!(authored.points[0].length() < 1.0);
        assert_eq!(
            authored.center + authored.points[0].as_dvec3(),
            far.as_dvec3()
        );
    }

    #[test]
    fn constant_primvars_come_from_ancestors_unless_authored() {
        let prim = mesh("/a/m", &[Vec3::ZERO, Vec3::X, Vec3::Y], &[3], &[0, 1, 2]);
        let float = |prim: RawPrim, x: f32| {
            with_attribute(prim, "primvars:w", Value::FloatArray(vec![x]), None)
        };
        let ancestor = float(RawPrim::default(), 7.0);
        let inherited = [("w".to_owned(), &ancestor)];
        let names = ["w".to_owned()];
        let value = |prim: &RawPrim| {
            let diagnostics = Diagnostics::default();
            let read = AuthoredMesh::read(Cow::Borrowed(prim), &inherited, &names, &diagnostics);
            read.unwrap().unwrap().primvars[0].values[0].x
        };
        assert_eq!(value(&prim), 7.0);
        assert_eq!(value(&float(prim, 3.0)), 3.0);
    }
}
