//! Blending of joints as dual quaternions, as `UsdSkel` does it: every joint is a stretch followed by a rigid motion;
//! stretches are blended as matrices, motions as dual quaternions. Kavan et al., *Geometric Skinning with Approximate
//! Dual Quaternion Blending*, 2008.

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};

/// Joints flatter than this have no motion that could be told: `GfMatrix4d::Factor` gives up there.
const FLAT: f64 = 1e-10;

/// A stretch closer to none than this counts as none, as `GfIsClose` has it.
const NO_STRETCH: f64 = 1e-6;

/// Steps of the polar decomposition at most: it doubles its digits in each, once scales are told apart.
const STEPS: usize = 100;

/// A joint taken apart: `motion` after `stretch`.
#[derive(Debug, Clone, Copy)]
struct Joint {
    /// Symmetric.
    stretch: DMat3,
    /// Zero where the joint is flat.
    rotation: DVec4,
    /// Half the translation times the rotation.
    dual: DVec4,
}

/// What joints blend to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blended {
    pub(super) points: DMat4,
    pub(super) normals: DMat3,
}

/// Joints to blend.
#[derive(Debug)]
pub(super) struct Joints {
    joints: Vec<Joint>,
    /// Without one, points without any weight stay where they are.
    has_stretch: bool,
}

impl Joints {
    pub(super) fn of(matrices: &[DMat4]) -> Self {
        let joints: Vec<Joint> = matrices.iter().map(Joint::of).collect();
        let has_stretch = joints.iter().any(|joint| {
            let off = joint.stretch - DMat3::IDENTITY;
            off.to_cols_array().iter().any(|x| x.abs() > NO_STRETCH)
        });
        Self {
            joints,
            has_stretch,
        }
    }

    /// What the joints `weights` names blend to; joints that do not exist have no say.
    pub(super) fn blended(&self, weights: impl Iterator<Item = (usize, f64)> + Clone) -> Blended {
        let known = weights.filter_map(|(joint, weight)| Some((self.joints.get(joint)?, weight)));
        let heaviest = known.clone().reduce(|best, next| match next.1 > best.1 {
            true => next,
            false => best,
        });
        let pivot = heaviest.map_or(DVec4::W, |(joint, _)| joint.rotation);
        let (mut stretch, mut squeeze) = (DMat3::ZERO, DMat3::ZERO);
        let (mut rotation, mut dual) = (DVec4::ZERO, DVec4::ZERO);
        for (joint, weight) in known.filter(|(_, weight)| *weight != 0.0) {
            stretch += joint.stretch * weight;
            squeeze += joint.stretch.inverse() * weight;
            // of the two quaternions of a rotation, the one on the side of the heaviest joint's
            let side = if joint.rotation.dot(pivot) < 0.0 {
                -weight
            } else {
                weight
            };
            rotation += joint.rotation * side;
            dual += joint.dual * side;
        }
        if !self.has_stretch {
            (stretch, squeeze) = (DMat3::IDENTITY, DMat3::IDENTITY);
        }
        let length = rotation.length();
        if length < FLAT {
            (rotation, dual) = (DVec4::W, DVec4::ZERO);
        } else {
            (rotation, dual) = (rotation / length, dual / length);
        }
        let rotation = DQuat::from_vec4(rotation);
        let moved = DQuat::from_vec4(dual) * rotation.conjugate();
        let translation = 2.0 * DVec3::new(moved.x, moved.y, moved.z);
        let motion = DMat4::from_rotation_translation(rotation, translation);
        Blended {
            points: motion * DMat4::from_mat3(stretch),
            // a stretch is symmetric: its inverse is the transpose of it
            normals: DMat3::from_quat(rotation) * squeeze,
        }
    }
}

impl Joint {
    fn of(matrix: &DMat4) -> Self {
        let linear = DMat3::from_mat4(*matrix);
        let Some(rotation) = rotation_of(linear) else {
            return Self {
                stretch: DMat3::IDENTITY,
                rotation: DVec4::ZERO,
                dual: DVec4::ZERO,
            };
        };
        let quaternion = DQuat::from_mat3(&rotation).normalize();
        let moved = DQuat::from_vec4(matrix.w_axis.truncate().extend(0.0)) * quaternion;
        Self {
            stretch: rotation.transpose() * linear,
            rotation: DVec4::from(quaternion),
            dual: DVec4::from(moved) * 0.5,
        }
    }
}

/// The rotation of the polar decomposition of `linear`, which mirrors where `linear` does by a stretch below 0. `None`
/// where it is flat. Higham, *Computing the polar decomposition*, 1986.
fn rotation_of(linear: DMat3) -> Option<DMat3> {
    let determinant = linear.determinant();
    if determinant.is_nan() || determinant.abs() < FLAT {
        return None;
    }
    let mut unit = linear;
    for _ in 0..STEPS {
        let next = (unit + unit.inverse().transpose()) * 0.5;
        let is_settled = (next - unit)
            .to_cols_array()
            .iter()
            .all(|x| x.abs() < 1e-15);
        unit = next;
        if is_settled {
            break;
        }
    }
    let rotation = unit * determinant.signum();
    rotation.is_finite().then_some(rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spread(matrices: &[DMat4], weights: &[f64], point: DVec3) -> DVec3 {
        let joints = Joints::of(matrices);
        let weights = weights.iter().copied().enumerate();
        joints.blended(weights).points.transform_point3(point)
    }

    /// Where linear blending of a half turn with none collapses to the axis, dual quaternions keep the distance.
    #[test]
    fn a_twisted_point_keeps_its_distance_from_the_axis() {
        let turned = DMat4::from_rotation_x(std::f64::consts::PI * 0.999);
        let found = spread(&[DMat4::IDENTITY, turned], &[0.5, 0.5], DVec3::Y);
        assert!((found.length() - 1.0).abs() < 1e-14, "{found}");
        assert!(found.y.abs() < 2e-3 && found.z > 0.999, "{found}");
    }

    #[test]
    fn one_joint_moves_points_as_its_matrix_does() {
        let matrix = DMat4::from_translation(DVec3::new(1.0, -2.0, 3.0))
            * DMat4::from_rotation_y(2.0)
            * DMat4::from_scale(DVec3::new(0.5, -3.0, 2.0));
        let point = DVec3::new(1.0, 2.0, 3.0);
        let found = spread(&[matrix], &[1.0], point);
        assert!(found.distance(matrix.transform_point3(point)) < 1e-13);
    }

    #[test]
    fn points_without_weight_stay_unless_some_joint_stretches() {
        let moved = DMat4::from_translation(DVec3::X);
        let stretched = DMat4::from_scale(DVec3::splat(2.0));
        assert_eq!(spread(&[moved], &[0.0], DVec3::ONE), DVec3::ONE);
        let flattened = spread(&[moved, stretched], &[0.0, 0.0], DVec3::ONE);
        assert_eq!(flattened, DVec3::ZERO);
    }

    #[test]
    fn flat_joints_move_nothing() {
        let flat = DMat4::from_translation(DVec3::X) * DMat4::from_scale(DVec3::ZERO);
        assert_eq!(spread(&[flat], &[1.0], DVec3::ONE), DVec3::ONE);
    }
}
