//! Meshes bound to skeletons → their points in the pose of the time, as `UsdSkel`'s linear blend skinning has it:
//! p′ = Σ wᵢ · jointᵢ · bindᵢ⁻¹ · geomBind · (p + Σ blend shape offsets), in the skeleton's space, then taken to the
//! mesh's own. Normals follow by the inverse transposes.
//!
//! What is not understood (dual quaternions, in-between shapes, bindings from outside a native instance, a skeleton
//! without values at the time) leaves the mesh as authored; the geometry pass then names it.

use super::super::raw::{RawAttribute, RawPrim, RawStage, Value};
use super::xform;
use crate::diagnostics::Diagnostics;
use glam::{DMat3, DMat4, DQuat, DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// `raw` with its skinned meshes posed.
pub(in crate::stage) fn pose(mut raw: RawStage, diagnostics: &Diagnostics) -> RawStage {
    let is_bound = |prim: &RawPrim| {
        let is_mesh = prim.type_name == "Mesh";
        is_mesh && prim.api_schemas.iter().any(|api| api == "SkelBindingAPI")
    };
    let bound: Vec<usize> = (0..raw.prims.len())
        .filter(|&at| is_bound(&raw.prims[at]))
        .collect();
    if bound.is_empty() {
        return raw;
    }
    let by_path: HashMap<&str, usize> = (raw.prims.iter().enumerate())
        .map(|(index, prim)| (prim.path.as_str(), index))
        .collect();
    let posing = Posing { raw: &raw, by_path };
    let posed: Vec<(usize, Option<Deformed>)> = bound
        .into_par_iter()
        .map(|mesh| {
            let is_running = diagnostics.check().is_ok();
            (mesh, is_running.then(|| posing.deformed(mesh)).flatten())
        })
        .collect();
    for (mesh, deformed) in posed {
        if let Some(deformed) = deformed {
            deformed.write_to(&mut raw.prims[mesh]);
        }
    }
    raw
}

/// New values of a mesh.
struct Deformed {
    points: Vec<Vec3>,
    /// The attribute that they came from, and the values.
    normals: Option<(&'static str, Vec<Vec3>)>,
}

impl Deformed {
    fn write_to(self, prim: &mut RawPrim) {
        prim.is_posed = true;
        let normals = self.normals.into_iter();
        for (name, values) in [("points", self.points)].into_iter().chain(normals) {
            if let Some(attribute) = prim.attributes.get_mut(name) {
                attribute.value = Some(Value::Vec3Array(values));
            }
        }
    }
}

/// Joint matrices that act on the points of a mesh, and who acts on which.
struct Influences<'a> {
    /// Skeleton space from the mesh's bind space, one a joint of the mesh's own order.
    joints: Vec<DMat4>,
    indices: &'a [i32],
    weights: &'a [f32],
    /// Joints a point; all points share them if `is_rigid`.
    width: usize,
    is_rigid: bool,
}

impl Influences<'_> {
    /// The blended matrix of `point`. Weights are taken as they are, as `UsdSkel` does.
    fn of_point(&self, point: usize) -> DMat4 {
        let start = if self.is_rigid { 0 } else { point * self.width };
        let slots = start..start + self.width;
        let mut sum = DMat4::ZERO;
        for (&joint, &weight) in self.indices[slots.clone()].iter().zip(&self.weights[slots]) {
            let joint = usize::try_from(joint)
                .ok()
                .and_then(|joint| self.joints.get(joint));
            if let (Some(joint), true) = (joint, weight != 0.0) {
                sum += *joint * f64::from(weight);
            }
        }
        sum
    }
}

struct Posing<'a> {
    raw: &'a RawStage,
    by_path: HashMap<&'a str, usize>,
}

impl<'a> Posing<'a> {
    fn deformed(&self, mesh: usize) -> Option<Deformed> {
        let prim = &self.raw.prims[mesh];
        let in_root = self
            .line(mesh)
            .any(|at| self.raw.prims[at].type_name == "SkelRoot");
        let skeleton = self.inherited(mesh, "skel:skeleton").filter(|_| in_root)?;
        let method = prim
            .attributes
            .get("primvars:skel:skinningMethod")
            .and_then(|a| a.value.as_ref());
        if matches!(method, Some(Value::Token(method)) if method != "classicLinear") {
            return None;
        }
        let animation = self
            .inherited(skeleton, "skel:animationSource")
            .map(|at| &self.raw.prims[at]);
        let mut points = vectors(prim, "points")?.to_vec();
        self.add_shapes(prim, animation, &mut points)?;
        if !prim.attributes.contains_key("primvars:skel:jointIndices") {
            // Blend shapes alone stay in the mesh's space.
            return Some(Deformed {
                points,
                normals: None,
            });
        }
        let influences = self.influences(prim, skeleton, animation, points.len())?;
        let bind = match prim
            .attributes
            .get("primvars:skel:geomBindTransform")
            .map(|a| &a.value)
        {
            Some(Some(Value::Matrix(matrix))) => **matrix,
            _ => DMat4::IDENTITY,
        };
        let mesh_from_skeleton =
            self.root_from_local(mesh).inverse() * self.root_from_local(skeleton);
        let matrix = |point: usize| mesh_from_skeleton * influences.of_point(point) * bind;
        let normals = deformed_normals(prim, &matrix, points.len());
        for (index, point) in points.iter_mut().enumerate() {
            *point = matrix(index).transform_point3(point.as_dvec3()).as_vec3();
        }
        let is_finite = points.iter().all(|point| point.is_finite());
        is_finite.then_some(Deformed { points, normals })
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

    fn influences(
        &self,
        mesh: &'a RawPrim,
        skeleton: usize,
        animation: Option<&'a RawPrim>,
        point_count: usize,
    ) -> Option<Influences<'a>> {
        let skeleton = &self.raw.prims[skeleton];
        let names = tokens(skeleton, "joints")?;
        let of_skeleton = skinning_matrices(skeleton, names, animation)?;
        let joints = match tokens(mesh, "skel:joints") {
            Some(own) => own
                .iter()
                .map(|name| {
                    let joint = names.iter().position(|joint| joint == name);
                    joint.map_or(DMat4::IDENTITY, |joint| of_skeleton[joint])
                })
                .collect(),
            None => of_skeleton,
        };
        let attribute = mesh.attributes.get("primvars:skel:jointIndices")?;
        let Some(Value::IntArray(indices)) = &attribute.value else {
            return None;
        };
        let weights = floats(mesh, "primvars:skel:jointWeights")?;
        let is_rigid = attribute.interpolation.as_deref().unwrap_or("constant") == "constant";
        let width = match is_rigid {
            true => indices.len(),
            false => usize::try_from(attribute.element_size.unwrap_or(1)).ok()?,
        };
        let expected = if is_rigid {
            width
        } else {
            width.checked_mul(point_count)?
        };
        let fits = width > 0 && indices.len() == expected && weights.len() == expected;
        fits.then_some(Influences {
            joints,
            indices,
            weights,
            width,
            is_rigid,
        })
    }

    /// Add the offsets of the blend shapes that the animation weighs. `None` for shapes that are not understood.
    fn add_shapes(
        &self,
        mesh: &RawPrim,
        animation: Option<&RawPrim>,
        points: &mut [Vec3],
    ) -> Option<()> {
        let (Some(names), Some(animation)) = (tokens(mesh, "skel:blendShapes"), animation) else {
            return Some(());
        };
        let (Some(channels), Some(weights)) = (
            tokens(animation, "blendShapes"),
            floats(animation, "blendShapeWeights"),
        ) else {
            return Some(());
        };
        let targets = &mesh.relationships.get("skel:blendShapeTargets")?.targets;
        for (name, target) in names.iter().zip(targets) {
            let channel = channels.iter().position(|channel| channel == name);
            let weight = channel
                .and_then(|channel| weights.get(channel))
                .copied()
                .unwrap_or(0.0);
            if weight == 0.0 {
                continue;
            }
            let shape = &self.raw.prims[*self.by_path.get(target.as_str())?];
            if shape
                .attributes
                .keys()
                .any(|name| name.starts_with("inbetweens:"))
            {
                return None;
            }
            let offsets = vectors(shape, "offsets")?;
            match shape
                .attributes
                .get("pointIndices")
                .and_then(|a| a.value.as_ref())
            {
                Some(Value::IntArray(indices)) if !indices.is_empty() => {
                    for (&index, &offset) in indices.iter().zip(offsets) {
                        *points.get_mut(usize::try_from(index).ok()?)? += offset * weight;
                    }
                }
                _ => {
                    points
                        .iter_mut()
                        .zip(offsets)
                        .for_each(|(point, &offset)| *point += offset * weight);
                }
            }
        }
        Some(())
    }
}

/// Joint in the pose × inverse of the joint when bound, in the skeleton's space, one a joint.
fn skinning_matrices(
    skeleton: &RawPrim,
    names: &[String],
    animation: Option<&RawPrim>,
) -> Option<Vec<DMat4>> {
    let bind = matrices(skeleton, "bindTransforms").filter(|bind| bind.len() == names.len())?;
    let rest = matrices(skeleton, "restTransforms").filter(|rest| rest.len() == names.len());
    let animated = match animation {
        Some(animation) => animated_joints(animation)?,
        None => HashMap::new(),
    };
    let at: HashMap<&str, usize> = names
        .iter()
        .enumerate()
        .map(|(i, name)| (name.as_str(), i))
        .collect();
    let mut pose: Vec<DMat4> = Vec::with_capacity(names.len());
    for (index, name) in names.iter().enumerate() {
        let local = match animated.get(name.as_str()) {
            Some(local) => *local,
            None => rest?[index],
        };
        // The nearest ancestor that is a joint; `UsdSkel` demands that parents come first.
        let ancestors =
            std::iter::successors(name.rsplit_once('/'), |(above, _)| above.rsplit_once('/'));
        let parent = ancestors
            .filter_map(|(above, _)| at.get(above))
            .next()
            .copied();
        pose.push(match parent {
            Some(parent) => *pose.get(parent)? * local,
            None => local,
        });
    }
    let skinned = pose
        .iter()
        .zip(bind)
        .map(|(pose, bind)| *pose * bind.inverse());
    Some(skinned.collect())
}

/// Local matrices of the joints that `animation` moves; `None` if its arrays do not fit or are missing at the time.
fn animated_joints(animation: &RawPrim) -> Option<HashMap<&str, DMat4>> {
    let names = tokens(animation, "joints").unwrap_or(&[]);
    if names.is_empty() {
        return Some(HashMap::new());
    }
    let translations = vectors(animation, "translations")?;
    let scales = vectors(animation, "scales")?;
    let Some(Value::QuatArray(rotations)) = &animation.attributes.get("rotations")?.value else {
        return None;
    };
    let count = names.len();
    if [translations.len(), scales.len(), rotations.len()] != [count; 3] {
        return None;
    }
    let local = |joint: usize| {
        let rotation = DQuat::from_vec4(rotations[joint].as_dvec4()).normalize();
        let turned = DMat3::from_quat(rotation) * DMat3::from_diagonal(scales[joint].as_dvec3());
        DMat4::from_translation(translations[joint].as_dvec3()) * DMat4::from_mat3(turned)
    };
    Some(
        names
            .iter()
            .enumerate()
            .map(|(joint, name)| (name.as_str(), local(joint)))
            .collect(),
    )
}

/// Normals of points or face-vertices, turned with the points they are at. Indexed ones and others stay.
fn deformed_normals(
    mesh: &RawPrim,
    matrix: &dyn Fn(usize) -> DMat4,
    point_count: usize,
) -> Option<(&'static str, Vec<Vec3>)> {
    let name = ["primvars:normals", "normals"]
        .into_iter()
        .find(|name| mesh.attributes.contains_key(name))?;
    let normals = vectors(mesh, name)?;
    let corners = match mesh.attributes.get("faceVertexIndices").map(|a| &a.value) {
        Some(Some(Value::IntArray(corners))) => corners.as_slice(),
        _ => &[],
    };
    let is_indexed =
        mesh.attributes.contains_key("primvars:normals:indices") && name == "primvars:normals";
    if is_indexed {
        return None;
    }
    let turned = |normal: Vec3, point: usize| {
        let linear = DMat3::from_mat4(matrix(point));
        let (x, y, z) = (linear.x_axis, linear.y_axis, linear.z_axis);
        // the cofactors: the inverse transpose, but for a factor that normalizing takes away
        let normal_matrix =
            DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * linear.determinant().signum();
        let turned: DVec3 = normal_matrix * normal.as_dvec3();
        turned.normalize_or_zero().as_vec3()
    };
    let point_of = |slot: usize| match normals.len() {
        count if count == point_count => Some(slot),
        count if count == corners.len() => usize::try_from(corners[slot])
            .ok()
            .filter(|&p| p < point_count),
        _ => None,
    };
    let all = normals
        .iter()
        .enumerate()
        .map(|(slot, &normal)| Some(turned(normal, point_of(slot)?)));
    Some((name, all.collect::<Option<_>>()?))
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

    fn prim(
        path: &str,
        type_name: &str,
        parent: Option<usize>,
        values: &[(&str, Value)],
    ) -> RawPrim {
        let attribute = |(name, value): &(&str, Value)| {
            let attribute = RawAttribute {
                value: Some(value.clone()),
                interpolation: Some("vertex".to_owned()),
                ..RawAttribute::default()
            };
            ((*name).to_owned(), attribute)
        };
        RawPrim {
            path: path.to_owned(),
            type_name: type_name.to_owned(),
            parent,
            attributes: values.iter().map(attribute).collect(),
            ..RawPrim::default()
        }
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
