//! A Mesh prim as authored, checked, and the polygon mesh it is without subdivision.

use super::super::super::Error;
use super::super::super::raw::RawPrim;
use super::attributes::{boolean, token, vectors};
use super::normals::CageNormals;
use super::primvars::AuthoredPrimvar;
use super::topology::{Topology, is_left_handed};
use super::triangulate::Triangulation;
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
    pub(super) prim: &'a RawPrim,
    /// Positions are relative to this (object space): 0 unless the points are far from it.
    pub(super) center: DVec3,
    pub(super) points: Cow<'a, [Vec3]>,
    pub(super) topology: Topology,
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
        prim: &'a RawPrim,
        inherited: &[(String, &RawPrim)],
        names: &[String],
        diagnostics: &Diagnostics,
    ) -> Result<Option<Self>, Error> {
        let points = vectors(prim, "points");
        check_points(prim, points)?;
        let topology = Topology::read(prim, points.len(), diagnostics)?;
        if topology.drawn().next().is_none() {
            diagnostics.warn(
                "empty-mesh",
                prim.path.clone(),
                "the mesh has no faces and is left out",
            );
            return Ok(None);
        }
        let center = center_of(points);
        let primvars = read_primvars(prim, inherited, names, &topology, diagnostics);
        Ok(Some(Self {
            prim,
            center,
            points: relative(points, center),
            topology,
            scheme: Scheme::read(prim, diagnostics),
            left_handed: is_left_handed(prim),
            primvars,
        }))
    }

    /// The mesh as polygons, without subdivision.
    pub(super) fn as_polygons(&self, diagnostics: &Diagnostics) -> Mesh {
        let mut triangulation = self.triangulate();
        if self.left_handed {
            triangulation.flip();
        }
        let normals = CageNormals::read(self.prim, &self.topology, diagnostics);
        let shading = normals.on_triangles(&triangulation);
        let (point_normals, corner_normals) =
            normals.for_cage(&self.topology, &self.points, self.left_handed);
        let primvars = self.primvars.iter();
        let primvars = primvars.map(|p| p.on_polygons(&triangulation)).collect();
        self.finish(Parts {
            positions: self.points.to_vec(),
            triangles: triangulation.triangles,
            triangle_faces: triangulation.faces,
            normals: shading,
            primvars,
            point_normals,
            corner_normals,
            scheme: Scheme::None,
        })
    }

    /// The cage as polygons, flat and bare, in the place of the surface that it refines into.
    pub(super) fn cage_polygons(&self) -> Mesh {
        let mut triangulation = self.triangulate();
        if self.left_handed {
            triangulation.flip();
        }
        self.finish(Parts {
            positions: self.points.to_vec(),
            triangles: triangulation.triangles,
            triangle_faces: triangulation.faces,
            normals: Normals::Flat,
            primvars: Vec::new(),
            point_normals: Vec::new(),
            corner_normals: Vec::new(),
            scheme: self.scheme,
        })
    }

    fn triangulate(&self) -> Triangulation {
        let mut triangulation = Triangulation::default();
        for face in self.topology.drawn() {
            triangulation.add(
                u32::try_from(face).expect("offsets of all faces fit u32"),
                self.topology.offsets[face],
                self.topology.points_of(face),
                &self.points,
            );
        }
        triangulation
    }

    /// Add what does not depend on how the surface was made.
    pub(super) fn finish(&self, parts: Parts) -> Mesh {
        let boundary = self.topology.boundary();
        Mesh {
            positions: parts.positions,
            triangles: parts.triangles,
            triangle_faces: parts.triangle_faces,
            normals: parts.normals,
            primvars: parts.primvars,
            double_sided: boolean(self.prim, "doubleSided", false),
            closed: boundary.is_closed,
            cage: Some(Cage {
                point_count: self.topology.point_count,
                face_vertex_counts: self.topology.counts.clone(),
                face_vertex_indices: self.topology.indices.clone(),
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

fn relative(points: &[Vec3], center: DVec3) -> Cow<'_, [Vec3]> {
    if center == DVec3::ZERO {
        return Cow::Borrowed(points);
    }
    let shifted = points.iter();
    Cow::Owned(shifted.map(|p| (p.as_dvec3() - center).as_vec3()).collect())
}

fn read_primvars(
    prim: &RawPrim,
    inherited: &[(String, &RawPrim)],
    names: &[String],
    topology: &Topology,
    diagnostics: &Diagnostics,
) -> Vec<AuthoredPrimvar> {
    let read = |name: &String| {
        let own = AuthoredPrimvar::read(prim, name, topology, diagnostics);
        own.or_else(|| {
            let (_, owner) = inherited.iter().find(|(inherited, _)| inherited == name)?;
            AuthoredPrimvar::read(owner, name, topology, diagnostics)
        })
    };
    names.iter().filter_map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::super::super::super::raw::Value;
    use super::super::tests::{mesh, with_attribute};
    use super::*;

    fn polygons(prim: &RawPrim) -> Mesh {
        let diagnostics = Diagnostics::default();
        let authored = AuthoredMesh::read(prim, &[], &[], &diagnostics);
        authored.unwrap().unwrap().as_polygons(&diagnostics)
    }

    #[test]
    fn a_point_that_is_not_finite_is_named() {
        let points = [Vec3::ZERO, Vec3::X, Vec3::new(0.0, f32::NAN, 1.0)];
        let prim = mesh("/World/m", &points, &[3], &[0, 1, 2]);
        let error = AuthoredMesh::read(&prim, &[], &[], &Diagnostics::default()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "mesh /World/m: point 2 is [0, NaN, 1], all coordinates must be finite"
        );
    }

    #[test]
    fn meshes_without_faces_are_left_out_with_a_warning() {
        let prim = mesh("/m", &[], &[], &[]);
        let diagnostics = Diagnostics::default();
        let read = AuthoredMesh::read(&prim, &[], &[], &diagnostics).unwrap();
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
        let read = AuthoredMesh::read(&prim, &[], &[], &Diagnostics::default());
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
            let read = AuthoredMesh::read(prim, &inherited, &names, &diagnostics);
            read.unwrap().unwrap().primvars[0].values[0].x
        };
        assert_eq!(value(&prim), 7.0);
        assert_eq!(value(&float(prim, 3.0)), 3.0);
    }
}
