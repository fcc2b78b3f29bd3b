//! What is bound to skeletons → in the pose of the time, as `UsdSkel` has it, in the skeleton's space and then taken to the
//! prim's own:
//!
//! - points by linear blending, p′ = Σ wᵢ · jointᵢ · bindᵢ⁻¹ · geomBind · (p + Σ blend shape offsets), or by `dual`
//!   quaternions; normals follow by the inverse transposes;
//! - gprims without points, which one set of weights moves as a whole, by a new matrix in place of their own.
//!
//! What binds a prim may stand on prims above it, up to the `SkelRoot`. What is not understood (bindings from outside a
//! native instance, a skeleton without values at the time, tangents of Hermite curves) leaves the prim as authored; the
//! geometry pass then names it.

mod dual;
mod joints;
mod shapes;

use super::super::raw::{RawAttribute, RawPrim, RawStage, Value};
use super::xform;
use crate::diagnostics::Diagnostics;
use glam::{DMat3, DMat4, Vec3};
use joints::{Influences, Width, normal_matrix};
use rayon::prelude::*;
use shapes::Shape;
use std::collections::HashMap;

/// Types with points that are posed.
const POINT_BASED: [&str; 5] = ["Mesh", "BasisCurves", "NurbsCurves", "NurbsPatch", "Points"];

/// Types without, which are posed as a whole.
const WHOLE: [&str; 8] = [
    "Cube",
    "Sphere",
    "Cylinder",
    "Cylinder_1",
    "Capsule",
    "Capsule_1",
    "Cone",
    "Plane",
];

/// The API that makes a prim's properties part of a binding.
const API: &str = "SkelBindingAPI";

/// `raw` with what is skinned in it posed.
pub(in crate::stage) fn pose(mut raw: RawStage, diagnostics: &Diagnostics) -> RawStage {
    if raw.prims.iter().all(|prim| prim.type_name != "SkelRoot") {
        return raw;
    }
    let by_path: HashMap<&str, usize> = (raw.prims.iter().enumerate())
        .map(|(index, prim)| (prim.path.as_str(), index))
        .collect();
    let posing = Posing { raw: &raw, by_path };
    let posed: Vec<Option<Posed>> = (0..raw.prims.len())
        .into_par_iter()
        .map(|at| {
            let type_name = raw.prims[at].type_name.as_str();
            let is_candidate = POINT_BASED.contains(&type_name) || WHOLE.contains(&type_name);
            (is_candidate && diagnostics.check().is_ok())
                .then(|| posing.posed(at))
                .flatten()
        })
        .collect();
    for (prim, posed) in raw.prims.iter_mut().zip(posed) {
        if let Some(posed) = posed {
            posed.write_to(prim);
        }
    }
    raw
}

/// What the pose makes of a prim.
enum Posed {
    /// Bound, but nothing of it moves.
    AsAuthored,
    Points {
        points: Vec<Vec3>,
        /// The attribute that they came from, and the values, no longer indexed.
        normals: Option<(&'static str, Vec<Vec3>)>,
    },
    /// Its matrix below its parent.
    Whole(DMat4),
}

impl Posed {
    fn write_to(self, prim: &mut RawPrim) {
        prim.is_posed = true;
        let (points, normals) = match self {
            Self::AsAuthored => return,
            Self::Points { points, normals } => (points, normals),
            Self::Whole(matrix) => return place(prim, matrix),
        };
        if let Some((name, _)) = &normals {
            prim.attributes.remove(&format!("{name}:indices"));
        }
        for (name, values) in [("points", points)].into_iter().chain(normals) {
            if let Some(attribute) = prim.attributes.get_mut(name) {
                attribute.value = Some(Value::Vec3Array(values));
            }
        }
    }
}

/// Give `prim` the one transform `matrix`.
fn place(prim: &mut RawPrim, matrix: DMat4) {
    const OP: &str = "xformOp:transform:posed";
    let order = match value(prim, "xformOpOrder") {
        Some(Value::TokenArray(order)) if order.iter().any(|op| op == xform::RESET) => {
            vec![xform::RESET.to_owned(), OP.to_owned()]
        }
        _ => vec![OP.to_owned()],
    };
    for (name, value) in [
        (OP, Value::Matrix(Box::new(matrix))),
        ("xformOpOrder", Value::TokenArray(order)),
    ] {
        let attribute = RawAttribute::from(value);
        prim.attributes.insert(name.to_owned(), attribute);
    }
}

struct Posing<'a> {
    raw: &'a RawStage,
    by_path: HashMap<&'a str, usize>,
}

impl<'a> Posing<'a> {
    fn posed(&self, at: usize) -> Option<Posed> {
        let prim = &self.raw.prims[at];
        let in_root = self
            .line(at)
            .any(|at| self.raw.prims[at].type_name == "SkelRoot");
        let skeleton = self.inherited(at, "skel:skeleton").filter(|_| in_root)?;
        if !has_api(prim) && authors_binding(prim) {
            return None;
        }
        let animation = self
            .inherited(skeleton, "skel:animationSource")
            .map(|at| &self.raw.prims[at]);
        let indices = self.bound(at, "primvars:skel:jointIndices");
        if WHOLE.contains(&prim.type_name.as_str()) {
            let Some(indices) = indices else {
                return Some(Posed::AsAuthored);
            };
            let influences = self.influences((at, skeleton), animation, indices, None)?;
            return self.moved_whole(at, skeleton, influences.of_point(0));
        }
        let mut points = vectors(prim, "points")?.to_vec();
        let mut normals = Normals::of(prim, points.len());
        let is_shaped = self.add_shapes(at, animation, &mut points, &mut normals)?;
        let Some(indices) = indices else {
            // Blend shapes alone stay in the mesh's space.
            return Some(match is_shaped {
                true => Posed::Points {
                    points,
                    normals: normals.map(Normals::finished),
                },
                false => Posed::AsAuthored,
            });
        };
        let influences = self.influences((at, skeleton), animation, indices, Some(points.len()))?;
        let bind = self.bind(at);
        let local_from_skeleton =
            self.root_from_local(at).inverse() * self.root_from_local(skeleton);
        let matrix = |point: usize| local_from_skeleton * influences.of_point(point) * bind;
        if let Some(normals) = &mut normals {
            let (last, first) = (normal_matrix(local_from_skeleton), normal_matrix(bind));
            normals.turn(|point| last * influences.of_normal(point) * first);
        }
        for (index, point) in points.iter_mut().enumerate() {
            *point = matrix(index).transform_point3(point.as_dvec3()).as_vec3();
        }
        let is_finite = points.iter().all(|point| point.is_finite());
        let normals = normals.map(Normals::finished);
        is_finite.then_some(Posed::Points { points, normals })
    }

    /// A gprim moved by `skinned`, which acts in the skeleton's space: its own transform has no say.
    fn moved_whole(&self, at: usize, skeleton: usize, skinned: DMat4) -> Option<Posed> {
        let prim = &self.raw.prims[at];
        let above = match (xform::local(prim).resets_stack, prim.parent) {
            (false, Some(parent)) => self.root_from_local(parent),
            _ => DMat4::IDENTITY,
        };
        let matrix = above.inverse() * self.root_from_local(skeleton) * skinned * self.bind(at);
        matrix.is_finite().then_some(Posed::Whole(matrix))
    }

    /// `at` and its ancestors, as far as the stage or prototype goes.
    fn line(&self, at: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(at), |&at| self.raw.prims[at].parent)
    }

    /// The prim that relationship `name` on `at` or the nearest ancestor that has it points at.
    fn inherited(&self, at: usize, name: &str) -> Option<usize> {
        let targets = self
            .line(at)
            .find_map(|at| self.raw.prims[at].relationships.get(name))?;
        self.by_path.get(targets.targets.first()?.as_str()).copied()
    }

    /// Prims whose properties bind `at`, nearest first: itself and those above, up to the `SkelRoot`.
    fn binding(&self, at: usize) -> impl Iterator<Item = &'a RawPrim> {
        let mut is_inside = true;
        let prims = self.line(at).map(|at| &self.raw.prims[at]);
        prims
            .take_while(move |prim| {
                let is_taken = is_inside;
                is_inside &= prim.type_name != "SkelRoot";
                is_taken
            })
            .filter(|prim| has_api(prim))
    }

    /// Attribute `name` of the binding of `at`, if it has a value.
    fn bound(&self, at: usize, name: &str) -> Option<&'a RawAttribute> {
        let mut found = self
            .binding(at)
            .filter_map(|prim| prim.attributes.get(name));
        found.find(|attribute| attribute.value.is_some())
    }

    fn bind(&self, at: usize) -> DMat4 {
        match self
            .bound(at, "primvars:skel:geomBindTransform")
            .map(|a| &a.value)
        {
            Some(Some(Value::Matrix(matrix))) => **matrix,
            _ => DMat4::IDENTITY,
        }
    }

    fn root_from_local(&self, at: usize) -> DMat4 {
        let mut matrix = DMat4::IDENTITY;
        for at in self.line(at) {
            let local = xform::local(&self.raw.prims[at]);
            matrix = local.parent_from_local * matrix;
            if local.resets_stack {
                break;
            }
        }
        matrix
    }

    /// Who moves the `point_count` points of prim `at`, or the whole of it.
    fn influences(
        &self,
        (at, skeleton): (usize, usize),
        animation: Option<&'a RawPrim>,
        indices: &'a RawAttribute,
        point_count: Option<usize>,
    ) -> Option<Influences<'a>> {
        let skeleton = &self.raw.prims[skeleton];
        let names = tokens(skeleton, "joints")?;
        let of_skeleton = joints::skinning_matrices(skeleton, names, animation)?;
        let own = self.bound(at, "skel:joints").and_then(|a| a.value.as_ref());
        let joints = match own {
            Some(Value::TokenArray(own)) => joints::chosen(own, names, &of_skeleton),
            _ => of_skeleton,
        };
        let is_rigid = indices.interpolation.as_deref().unwrap_or("constant") == "constant";
        let joints_each = usize::try_from(indices.element_size.unwrap_or(1)).ok()?;
        let width = match (is_rigid, point_count) {
            (true, _) => Width::Shared {
                joints: joints_each,
            },
            (false, Some(points)) => Width::Each {
                joints: joints_each,
                points,
            },
            (false, None) => return None,
        };
        let weights = self.bound(at, "primvars:skel:jointWeights")?;
        let method = self.bound(at, "primvars:skel:skinningMethod");
        let is_dual = match method.and_then(|a| a.value.as_ref()) {
            Some(Value::Token(method)) => match method.as_str() {
                "dualQuaternion" => true,
                "classicLinear" => false,
                _ => return None,
            },
            _ => false,
        };
        Influences::new(joints, (indices, weights), width, is_dual)
    }

    /// Add the offsets of the blend shapes that the animation weighs, if there are any. `None` for shapes that are not
    /// understood.
    fn add_shapes(
        &self,
        at: usize,
        animation: Option<&RawPrim>,
        points: &mut [Vec3],
        normals: &mut Option<Normals>,
    ) -> Option<bool> {
        let names = self
            .bound(at, "skel:blendShapes")
            .and_then(|a| a.value.as_ref());
        let (Some(Value::TokenArray(names)), Some(animation)) = (names, animation) else {
            return Some(false);
        };
        let (Some(channels), Some(weights)) = (
            tokens(animation, "blendShapes"),
            floats(animation, "blendShapeWeights"),
        ) else {
            return Some(false);
        };
        let mut binding = self.binding(at);
        let targets = binding.find_map(|prim| prim.relationships.get("skel:blendShapeTargets"))?;
        for (name, target) in names.iter().zip(&targets.targets) {
            let channel = channels.iter().position(|channel| channel == name);
            let weight = channel.and_then(|channel| weights.get(channel));
            let Some(&weight) = weight.filter(|&&weight| weight != 0.0) else {
                continue;
            };
            let shape = Shape::of(&self.raw.prims[*self.by_path.get(target.as_str())?])?;
            let of_points = normals.as_mut().and_then(Normals::of_points);
            shape.add(weight, points, of_points)?;
        }
        Some(true)
    }
}

/// Normals of points or face-vertices, and which point each is at.
struct Normals<'a> {
    name: &'static str,
    values: Vec<Vec3>,
    /// `None` = one a point.
    points: Option<&'a [i32]>,
}

impl<'a> Normals<'a> {
    /// Those of `prim`, each spelled out if they are indexed. Others than those of points and face-vertices stay as they
    /// are.
    fn of(prim: &'a RawPrim, point_count: usize) -> Option<Self> {
        let name = ["primvars:normals", "normals"]
            .into_iter()
            .find(|name| prim.attributes.contains_key(name))?;
        let authored = vectors(prim, name)?;
        let values = match value(prim, &format!("{name}:indices")) {
            Some(Value::IntArray(indices)) => {
                let at = |&index: &i32| authored.get(usize::try_from(index).ok()?).copied();
                indices.iter().map(at).collect::<Option<Vec<Vec3>>>()?
            }
            _ => authored.to_vec(),
        };
        let corners = match value(prim, "faceVertexIndices") {
            Some(Value::IntArray(corners)) => corners.as_slice(),
            _ => &[],
        };
        let is_point = |&point: &i32| usize::try_from(point).is_ok_and(|at| at < point_count);
        let points = match values.len() {
            count if count == point_count => None,
            count if count == corners.len() && corners.iter().all(is_point) => Some(corners),
            _ => return None,
        };
        Some(Self {
            name,
            values,
            points,
        })
    }

    /// Normals that blend shapes can add to.
    fn of_points(&mut self) -> Option<&mut [Vec3]> {
        self.points.is_none().then_some(self.values.as_mut_slice())
    }

    /// Turn each by the matrix of its point.
    fn turn(&mut self, matrix: impl Fn(usize) -> DMat3) {
        for (slot, normal) in self.values.iter_mut().enumerate() {
            let point = match self.points {
                Some(points) => usize::try_from(points[slot]).unwrap_or(0),
                None => slot,
            };
            *normal = (matrix(point) * normal.as_dvec3())
                .normalize_or_zero()
                .as_vec3();
        }
    }

    fn finished(mut self) -> (&'static str, Vec<Vec3>) {
        for normal in &mut self.values {
            *normal = normal.as_dvec3().normalize_or_zero().as_vec3();
        }
        (self.name, self.values)
    }
}

fn has_api(prim: &RawPrim) -> bool {
    prim.api_schemas.iter().any(|api| api == API)
}

/// True if `prim` says itself what moves it.
fn authors_binding(prim: &RawPrim) -> bool {
    let mut names = prim.attributes.keys();
    names.any(|name| name.starts_with("primvars:skel:") || name.starts_with("skel:"))
}

fn value<'a>(prim: &'a RawPrim, name: &str) -> Option<&'a Value> {
    let attribute: Option<&RawAttribute> = prim.attributes.get(name);
    attribute?.value.as_ref()
}

fn tokens<'a>(prim: &'a RawPrim, name: &str) -> Option<&'a [String]> {
    match value(prim, name)? {
        Value::TokenArray(tokens) => Some(tokens),
        _ => None,
    }
}

fn vectors<'a>(prim: &'a RawPrim, name: &str) -> Option<&'a [Vec3]> {
    match value(prim, name)? {
        Value::Vec3Array(vectors) => Some(vectors),
        _ => None,
    }
}

fn floats<'a>(prim: &'a RawPrim, name: &str) -> Option<&'a [f32]> {
    match value(prim, name)? {
        Value::FloatArray(floats) => Some(floats),
        _ => None,
    }
}

fn matrices<'a>(prim: &'a RawPrim, name: &str) -> Option<&'a [DMat4]> {
    match value(prim, name)? {
        Value::MatrixArray(matrices) => Some(matrices),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::raw::RawRelationship;
    use glam::DVec3;

    fn prim(
        path: &str,
        type_name: &str,
        parent: Option<usize>,
        values: &[(&str, Value)],
    ) -> RawPrim {
        let attribute = |(name, value): &(&str, Value)| {
            let mut attribute = RawAttribute::from(value.clone());
            attribute.interpolation = Some("vertex".to_owned());
            ((*name).to_owned(), attribute)
        };
        RawPrim::typed(path, type_name, parent).with(values.iter().map(attribute).collect())
    }

    /// Two points on one joint that rests a unit above where it was bound.
    fn stage(indices: &[i32], weights: &[f32]) -> RawStage {
        let lifted = DMat4::from_translation(DVec3::Y);
        let skeleton = [
            ("joints", Value::TokenArray(vec!["a".to_owned()])),
            ("bindTransforms", Value::MatrixArray(vec![DMat4::IDENTITY])),
            ("restTransforms", Value::MatrixArray(vec![lifted])),
        ];
        let mesh = [
            ("points", Value::Vec3Array(vec![Vec3::ZERO, Vec3::X])),
            (
                "primvars:skel:jointIndices",
                Value::IntArray(indices.to_vec()),
            ),
            (
                "primvars:skel:jointWeights",
                Value::FloatArray(weights.to_vec()),
            ),
        ];
        let mut mesh = prim("/r/m", "Mesh", Some(0), &mesh);
        mesh.api_schemas.push("SkelBindingAPI".to_owned());
        let targets = vec!["/r/s".to_owned()];
        let skeleton_of = RawRelationship {
            targets,
            bind_material_as: None,
        };
        mesh.relationships
            .insert("skel:skeleton".to_owned(), skeleton_of);
        let root = prim("/r", "SkelRoot", None, &[]);
        let prims = vec![root, prim("/r/s", "Skeleton", Some(0), &skeleton), mesh];
        RawStage {
            prototype_start: prims.len(),
            prims,
            ..RawStage::default()
        }
    }

    fn posed(stage: RawStage) -> Option<Vec<Vec3>> {
        let posed = pose(stage, &Diagnostics::default());
        let mesh = &posed.prims[2];
        mesh.is_posed
            .then(|| vectors(mesh, "points").unwrap().to_vec())
    }

    #[test]
    fn points_follow_the_joint_from_where_it_was_bound() {
        assert_eq!(
            posed(stage(&[0, 0], &[1.0, 1.0])),
            Some(vec![Vec3::Y, Vec3::X + Vec3::Y])
        );
        // Joints that do not exist have no say.
        assert_eq!(
            posed(stage(&[0, 7], &[1.0, 1.0])),
            Some(vec![Vec3::Y, Vec3::ZERO])
        );
        assert_eq!(
            posed(stage(&[0, -1], &[1.0, 1.0])),
            Some(vec![Vec3::Y, Vec3::ZERO])
        );
    }

    #[test]
    fn arrays_that_do_not_fit_leave_the_mesh_as_authored() {
        assert_eq!(posed(stage(&[0], &[1.0])), None);
        assert_eq!(posed(stage(&[0, 0], &[1.0])), None);
        assert_eq!(posed(stage(&[0, 0], &[1.0, f32::NAN])), None);
        let mut without = stage(&[], &[]);
        let indices = without.prims[2]
            .attributes
            .get_mut("primvars:skel:jointIndices");
        indices.unwrap().interpolation = None;
        assert_eq!(posed(without), None);
        let mut flat = stage(&[0, 0], &[1.0, 1.0]);
        flat.prims[1].attributes.remove("restTransforms");
        assert_eq!(posed(flat), None);
    }
}
