//! Where a prim of a single layer stands: its ancestors' `xformOp`s composed.

use super::file::File;
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3, EulerRot};
use openusd::sdf::{Path, Value};

/// World transform of `prim` at its default values, column vectors. The error names the operation that makes no sense.
pub(super) fn world_from_prim(file: &File, prim: &Path) -> Result<DMat4, String> {
    let mut world = DMat4::IDENTITY;
    for path in prim.ancestors_below_root() {
        let (local, resets) = local_transform(file, &path)?;
        world = local * world;
        if resets {
            break;
        }
    }
    Ok(world)
}

/// Transform to the parent, and whether it forgets the parent's.
fn local_transform(file: &File, prim: &Path) -> Result<(DMat4, bool), String> {
    let mut local = DMat4::IDENTITY;
    let mut resets = false;
    let Some(Value::TokenVec(order)) = file.value(prim, "xformOpOrder")? else {
        return Ok((local, resets));
    };
    for name in &order {
        if name.as_str() == "!resetXformStack!" {
            (local, resets) = (DMat4::IDENTITY, true);
            continue;
        }
        let bare = name.as_str().strip_prefix("!invert!");
        let attribute = bare.unwrap_or(name.as_str());
        let value = file.value(prim, attribute)?;
        let operation = value.and_then(|value| operation(attribute, &value));
        let matrix = operation.ok_or_else(|| format!("{prim}.{attribute} is no transform"))?;
        local *= if bare.is_some() {
            matrix.inverse()
        } else {
            matrix
        };
    }
    Ok((local, resets))
}

/// The matrix of `xformOp:KIND[:suffix]` with `value`.
fn operation(attribute: &str, value: &Value) -> Option<DMat4> {
    let kind = attribute.strip_prefix("xformOp:")?.split(':').next()?;
    Some(match kind {
        "translate" => DMat4::from_translation(vector(value)?),
        "scale" => DMat4::from_scale(vector(value)?),
        "rotateX" => DMat4::from_rotation_x(angle(value)?),
        "rotateY" => DMat4::from_rotation_y(angle(value)?),
        "rotateZ" => DMat4::from_rotation_z(angle(value)?),
        "orient" => DMat4::from_quat(quaternion(value)?),
        "transform" => match value {
            // row vectors, row by row: in memory the same as column vectors, column by column
            Value::Matrix4d(matrix) => DMat4::from_cols_array(bytemuck::cast_ref(matrix)),
            _ => return None,
        },
        _ => DMat4::from_quat(euler(kind, vector(value)?)?),
    })
}

/// `rotateABC`: about A first, then B, then C; `angles` in degrees about x, y and z.
fn euler(kind: &str, angles: DVec3) -> Option<DQuat> {
    let [x, y, z] = angles.to_array().map(f64::to_radians);
    // glam applies the last axis of its name first when read right to left: ZYX = z · y · x
    let (order, a, b, c) = match kind {
        "rotateXYZ" => (EulerRot::ZYX, z, y, x),
        "rotateXZY" => (EulerRot::YZX, y, z, x),
        "rotateYXZ" => (EulerRot::ZXY, z, x, y),
        "rotateYZX" => (EulerRot::XZY, x, z, y),
        "rotateZXY" => (EulerRot::YXZ, y, x, z),
        "rotateZYX" => (EulerRot::XYZ, x, y, z),
        _ => return None,
    };
    Some(DQuat::from_euler(order, a, b, c))
}

fn vector(value: &Value) -> Option<DVec3> {
    Some(match value {
        Value::Vec3d(v) => DVec3::new(v.x, v.y, v.z),
        Value::Vec3f(v) => DVec3::new(v.x.into(), v.y.into(), v.z.into()),
        Value::Vec3h(v) => DVec3::new(v.x.into(), v.y.into(), v.z.into()),
        _ => return None,
    })
}

fn angle(value: &Value) -> Option<f64> {
    let degrees = match *value {
        Value::Double(degrees) => degrees,
        Value::Float(degrees) => degrees.into(),
        Value::Half(degrees) => degrees.into(),
        _ => return None,
    };
    Some(degrees.to_radians())
}

fn quaternion(value: &Value) -> Option<DQuat> {
    let quaternion = match value {
        Value::Quatd(q) => DQuat::from_xyzw(q.x, q.y, q.z, q.w),
        Value::Quatf(q) => DQuat::from_xyzw(q.x.into(), q.y.into(), q.z.into(), q.w.into()),
        Value::Quath(q) => DQuat::from_xyzw(q.x.into(), q.y.into(), q.z.into(), q.w.into()),
        _ => return None,
    };
    (quaternion.length_squared() > 0.0).then(|| quaternion.normalize())
}

/// How disks change under an affine transform.
#[derive(Debug)]
pub(super) struct Placement {
    affine: DAffine3,
    /// Cofactors of the linear part: they take a normal times an area to the same of the image.
    cofactor: DMat3,
    /// Translations leave everything but positions as it is.
    only_moves: bool,
}

impl Placement {
    /// From prim space to world space relative to `origin`.
    pub(super) fn new(world: DMat4, origin: DVec3) -> Self {
        let moved = DMat4::from_translation(-origin) * world;
        let affine = DAffine3::from_mat4(moved);
        let [x, y, z] = [
            affine.matrix3.x_axis,
            affine.matrix3.y_axis,
            affine.matrix3.z_axis,
        ];
        Self {
            affine,
            cofactor: DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)),
            only_moves: affine.matrix3 == DMat3::IDENTITY,
        }
    }

    /// True if everything stays as it is.
    pub(super) fn is_identity(&self) -> bool {
        self.affine == DAffine3::IDENTITY
    }

    pub(super) fn position(&self, position: glam::Vec3) -> glam::Vec3 {
        self.affine.transform_point3(position.as_dvec3()).as_vec3()
    }

    /// Unit normal of the image and the factor its area grows by. `normal` is unit; both are 0 where the transform
    /// flattens it away.
    pub(super) fn normal_and_growth(&self, normal: glam::Vec3) -> (glam::Vec3, f32) {
        if self.only_moves {
            return (normal, 1.0);
        }
        let image = self.cofactor * normal.as_dvec3();
        let growth = image.length();
        // mirrored transforms turn the cofactors inside out
        let side = self.affine.matrix3.determinant().signum();
        let unit = (image * side).normalize_or_zero().as_vec3();
        #[expect(
            clippy::cast_possible_truncation,
            reason = "an area ratio, stored like areas"
        )]
        let growth = growth as f32;
        (unit, growth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn rotations_turn_about_their_first_axis_first() {
        // 90° about x takes y to z; then 90° about z leaves z alone
        let turn = euler("rotateXYZ", DVec3::new(90.0, 0.0, 90.0)).unwrap();
        assert!((turn * DVec3::Y - DVec3::Z).length() < 1e-12);
        // about z first: y to -x, which 90° about x leaves alone
        let turn = euler("rotateZYX", DVec3::new(90.0, 0.0, 90.0)).unwrap();
        assert!((turn * DVec3::Y + DVec3::X).length() < 1e-12);
    }

    #[test]
    fn areas_grow_by_the_scales_across_the_normal() {
        let scaled = Placement::new(DMat4::from_scale(DVec3::new(2.0, 3.0, 5.0)), DVec3::ZERO);
        assert_eq!(scaled.normal_and_growth(Vec3::Z), (Vec3::Z, 6.0));
        assert_eq!(scaled.normal_and_growth(Vec3::X), (Vec3::X, 15.0));
    }

    #[test]
    fn mirroring_keeps_normals_on_their_side() {
        let mirrored = Placement::new(DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)), DVec3::ZERO);
        assert_eq!(mirrored.normal_and_growth(Vec3::X), (-Vec3::X, 1.0));
        assert_eq!(mirrored.normal_and_growth(Vec3::Y), (Vec3::Y, 1.0));
    }

    #[test]
    fn positions_far_away_keep_their_precision() {
        let origin = DVec3::splat(1e9);
        let placed = Placement::new(DMat4::from_translation(origin), origin);
        let point = Vec3::new(0.1, -2.0, 1e-6);
        assert_eq!(placed.position(point), point);
    }
}
