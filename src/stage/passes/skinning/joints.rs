//! Joints of a skeleton in their pose, and which of them move which points.

use super::dual;
use super::{matrices, tokens, vectors};
use crate::stage::raw::{RawAttribute, RawPrim, Value};
use glam::{DMat3, DMat4, DQuat};
use std::collections::HashMap;

/// Joint matrices that act on the points of a prim, and who acts on which.
pub(super) struct Influences<'a> {
    joints: Joints,
    /// Of linear joints: what they do to normals.
    of_normals: Vec<DMat3>,
    indices: &'a [i32],
    weights: &'a [f32],
    /// Joints a point.
    width: usize,
    /// All points have those of the first.
    is_shared: bool,
}

/// Skeleton space from the prim's bind space, one a joint of the prim's own order.
enum Joints {
    Linear(Vec<DMat4>),
    Dual(dual::Joints),
}

/// How influences are laid out.
#[derive(Debug, Clone, Copy)]
pub(super) enum Width {
    /// So many joints for all points.
    Shared { joints: usize },
    /// So many joints for each of so many points.
    Each { joints: usize, points: usize },
}

impl<'a> Influences<'a> {
    /// `None` where the arrays do not fit.
    pub(super) fn new(
        joints: Vec<DMat4>,
        (indices, weights): (&'a RawAttribute, &'a RawAttribute),
        width: Width,
        is_dual: bool,
    ) -> Option<Self> {
        let (Some(Value::IntArray(indices)), Some(Value::FloatArray(weights))) =
            (&indices.value, &weights.value)
        else {
            return None;
        };
        let is_shared = matches!(width, Width::Shared { .. });
        let (width, expected) = match width {
            Width::Shared { joints } => (joints, joints),
            Width::Each { joints, points } => (joints, joints.checked_mul(points)?),
        };
        let fits = width > 0 && indices.len() == expected && weights.len() == expected;
        fits.then(|| Self {
            of_normals: match is_dual {
                true => Vec::new(),
                false => joints.iter().map(|&joint| normal_matrix(joint)).collect(),
            },
            joints: match is_dual {
                true => Joints::Dual(dual::Joints::of(&joints)),
                false => Joints::Linear(joints),
            },
            indices,
            weights,
            width,
            is_shared,
        })
    }

    /// The blended matrix of the normal at `point`.
    pub(super) fn of_normal(&self, point: usize) -> DMat3 {
        let pairs = self.of(point);
        match &self.joints {
            Joints::Linear(_) => pairs
                .filter_map(|(joint, weight)| Some(*self.of_normals.get(joint)? * weight))
                .sum(),
            Joints::Dual(joints) => joints.blended(pairs).normals,
        }
    }

    /// The blended matrix of `point`. Weights are taken as they are, as `UsdSkel` does.
    pub(super) fn of_point(&self, point: usize) -> DMat4 {
        let pairs = self.of(point);
        match &self.joints {
            Joints::Linear(joints) => pairs
                .filter_map(|(joint, weight)| Some(*joints.get(joint)? * weight))
                .sum(),
            Joints::Dual(joints) => joints.blended(pairs).points,
        }
    }

    /// Joints and weights of `point`; joints that do not exist have no say.
    fn of(&self, point: usize) -> impl Iterator<Item = (usize, f64)> + Clone {
        let start = if self.is_shared {
            0
        } else {
            point * self.width
        };
        let slots = start..start + self.width;
        let pairs = self.indices[slots.clone()].iter().zip(&self.weights[slots]);
        let weighed = pairs.filter(|(_, weight)| **weight != 0.0);
        weighed
            .filter_map(|(&joint, &weight)| Some((usize::try_from(joint).ok()?, f64::from(weight))))
    }
}

/// The inverse transpose of `matrix`, which normals follow where points follow `matrix`; 0 where it has none.
pub(super) fn normal_matrix(matrix: DMat4) -> DMat3 {
    let inverse = DMat3::from_mat4(matrix).inverse();
    match inverse.is_finite() {
        true => inverse.transpose(),
        false => DMat3::ZERO,
    }
}

/// Those of the joints `names` that `own` lists, in its order; joints that the skeleton lacks do not move.
pub(super) fn chosen(own: &[String], names: &[String], of_skeleton: &[DMat4]) -> Vec<DMat4> {
    let place: HashMap<&str, usize> = (names.iter().enumerate())
        .map(|(at, name)| (name.as_str(), at))
        .collect();
    let joints = own.iter().map(|name| place.get(name.as_str()));
    joints
        .map(|at| at.map_or(DMat4::IDENTITY, |&at| of_skeleton[at]))
        .collect()
}

/// Joint in the pose × inverse of the joint when bound, in the skeleton's space, one a joint.
pub(super) fn skinning_matrices(
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
