//! `xformOpOrder` and its ops → one local matrix, composed in f64 as `UsdGeomXformable::GetLocalTransformation` does.
//!
//! Column vectors: the first op of the order is the outermost. What usd-core does with flawed stacks is kept: an op
//! without attribute or value is the identity, `!resetXformStack!` drops every op before it.

use super::super::raw::{RawPrim, Value};
use glam::{DMat3, DMat4, DQuat, DVec3, Vec4};

/// A prim's own transform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalTransform {
    /// To the parent's space, or to world space if `resets_stack`.
    pub parent_from_local: DMat4,
    /// `!resetXformStack!`: the parents' transforms do not apply.
    pub resets_stack: bool,
    /// Number of ops that had to be left out (missing attribute, wrong type, no inverse).
    pub flawed_op_count: usize,
}

impl LocalTransform {
    const IDENTITY: Self = Self {
        parent_from_local: DMat4::IDENTITY,
        resets_stack: false,
        flawed_op_count: 0,
    };
}

const INVERT: &str = "!invert!";
pub(super) const RESET: &str = "!resetXformStack!";
/// Concrete types of usd-core 26.11 that are not Xformable, so that xformOps on them mean nothing
/// (found by asking its schema registry).
const NOT_XFORMABLE: [&str; 12] = [
    "",
    "Scope",
    "Material",
    "NodeGraph",
    "Shader",
    "GeomSubset",
    "RenderSettings",
    "RenderProduct",
    "RenderVar",
    "RenderPass",
    "SkelAnimation",
    "BlendShape",
];

/// The local transform of `prim`; the identity for prims that are not transformable.
pub fn local(prim: &RawPrim) -> LocalTransform {
    if NOT_XFORMABLE.contains(&prim.type_name.as_str()) {
        return LocalTransform::IDENTITY;
    }
    let order = prim.attributes.get("xformOpOrder");
    let Some(Value::TokenArray(order)) = order.and_then(|attribute| attribute.value.as_ref())
    else {
        return LocalTransform::IDENTITY;
    };
    let mut result = LocalTransform::IDENTITY;
    for entry in order {
        if entry == RESET {
            result = LocalTransform {
                resets_stack: true,
                ..LocalTransform::IDENTITY
            };
            continue;
        }
        match op_matrix(prim, entry) {
            Some(matrix) => result.parent_from_local *= matrix,
            None => result.flawed_op_count += 1,
        }
    }
    result
}

/// The matrix of one entry of the order; `None` if the op's attribute is missing, has the wrong type or no inverse.
fn op_matrix(prim: &RawPrim, entry: &str) -> Option<DMat4> {
    let (name, inverted) = match entry.strip_prefix(INVERT) {
        Some(name) => (name, true),
        None => (entry, false),
    };
    let kind = name.strip_prefix("xformOp:")?.split(':').next()?;
    // Only time samples, and none wanted: the identity, as in usd-core.
    let Some(value) = &prim.attributes.get(name)?.value else {
        return Some(DMat4::IDENTITY);
    };
    let matrix = kind_matrix(kind, value)?;
    if !inverted {
        return Some(matrix);
    }
    let inverse = matrix.inverse();
    inverse.is_finite().then_some(inverse)
}

fn kind_matrix(kind: &str, value: &Value) -> Option<DMat4> {
    if let Some(axes) = kind.strip_prefix("rotate") {
        return rotation(axes, value).map(DMat4::from_mat3);
    }
    Some(match (kind, value) {
        ("translate", Value::Vec3(offset)) => DMat4::from_translation(*offset),
        ("scale", Value::Vec3(factors)) => DMat4::from_mat3(DMat3::from_diagonal(*factors)),
        ("orient", Value::Quat(quaternion)) => {
            DMat4::from_mat3(rotation_of_quaternion(*quaternion))
        }
        ("transform", Value::Matrix(matrix)) => **matrix,
        _ => {
            let (kind, axis) = kind.split_at_checked(kind.len().checked_sub(1)?)?;
            let axis = unit_axis(axis)?;
            match kind {
                "translate" => DMat4::from_translation(axis * number(value)?),
                "scale" => DMat4::from_mat3(DMat3::from_diagonal(
                    DVec3::ONE + axis * (number(value)? - 1.0),
                )),
                _ => return None,
            }
        }
    })
}

/// `axes` = `X` with one angle, or an order such as `XYZ` with three: the first letter is applied first.
fn rotation(axes: &str, value: &Value) -> Option<DMat3> {
    if axes.len() == 1 {
        return Some(DMat3::from_axis_angle(
            unit_axis(axes)?,
            number(value)?.to_radians(),
        ));
    }
    let Value::Vec3(degrees) = value else {
        return None;
    };
    if axes.len() != 3 {
        return None;
    }
    axes.chars().try_fold(DMat3::IDENTITY, |rotation, letter| {
        let axis = unit_axis(letter.encode_utf8(&mut [0; 4]))?;
        Some(DMat3::from_axis_angle(axis, degrees.dot(axis).to_radians()) * rotation)
    })
}

/// Rotation by a quaternion as `GfRotation` reads it: the angle from the real part alone, the axis from the
/// imaginary part. Differs from normalizing only for quaternions that are not unit.
pub fn rotation_of_quaternion(quaternion: DQuat) -> DMat3 {
    let imaginary = quaternion.xyz();
    match imaginary.try_normalize() {
        Some(axis) => DMat3::from_axis_angle(axis, 2.0 * quaternion.w.clamp(-1.0, 1.0).acos()),
        None => DMat3::IDENTITY,
    }
}

/// [`rotation_of_quaternion`] of an array element (x, y, z, w).
pub fn rotation_of_components(quaternion: Vec4) -> DMat3 {
    rotation_of_quaternion(DQuat::from_vec4(quaternion.as_dvec4()))
}

fn unit_axis(letter: &str) -> Option<DVec3> {
    match letter {
        "X" => Some(DVec3::X),
        "Y" => Some(DVec3::Y),
        "Z" => Some(DVec3::Z),
        _ => None,
    }
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Float(number) => Some(*number),
        #[expect(
            clippy::cast_precision_loss,
            reason = "an angle or length given as an integer"
        )]
        Value::Int(number) => Some(*number as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::raw::RawAttribute;
    use super::*;

    /// An Xform with `ops` (name, value) in this order; `order` may repeat or invert them.
    fn xform(ops: &[(&str, Value)], order: &[&str]) -> RawPrim {
        let attribute = |value: Value| RawAttribute::from(value);
        let mut prim = RawPrim::typed("", "Xform", None);
        for (name, value) in ops {
            prim.attributes
                .insert(format!("xformOp:{name}"), attribute(value.clone()));
        }
        let order = order.iter().map(|&name| name.to_owned()).collect();
        prim.attributes
            .insert("xformOpOrder".into(), attribute(Value::TokenArray(order)));
        prim
    }

    /// `rows` is usd-core 26.11's answer, transposed to column vectors, written row by row.
    fn assert_rows(prim: &RawPrim, rows: [[f64; 4]; 3]) {
        let matrix = local(prim).parent_from_local;
        for (r, row) in rows.iter().enumerate() {
            for (c, &expected) in row.iter().enumerate() {
                let got = matrix.row(r)[c];
                assert!(
                    (got - expected).abs() < 1e-14 * 32.0,
                    "row {r} column {c}: {got} instead of {expected}"
                );
            }
        }
    }

    fn vec3(x: f64, y: f64, z: f64) -> Value {
        Value::Vec3(DVec3::new(x, y, z))
    }

    #[test]
    fn euler_orders_equal_usd_core() {
        let angles = vec3(10.0, 20.0, 30.0);
        assert_rows(
            &xform(&[("rotateXYZ", angles)], &["xformOp:rotateXYZ"]),
            [
                [
                    0.8137976813493738,
                    -0.44096961052988237,
                    0.3785223063697925,
                    0.0,
                ],
                [
                    0.46984631039295416,
                    0.8825641192593856,
                    0.01802831123629728,
                    0.0,
                ],
                [
                    -0.34202014332566877,
                    0.16317591116653482,
                    0.9254165783983234,
                    0.0,
                ],
            ],
        );
    }

    #[test]
    fn euler_orders_that_start_elsewhere_equal_usd_core() {
        let angles = vec3(10.0, 20.0, 30.0);
        assert_rows(
            &xform(&[("rotateZYX", angles.clone())], &["xformOp:rotateZYX"]),
            [
                [
                    0.8137976813493738,
                    -0.46984631039295416,
                    0.34202014332566877,
                    0.0,
                ],
                [
                    0.5438381424823255,
                    0.823172944645501,
                    -0.16317591116653482,
                    0.0,
                ],
                [
                    -0.2048741287028622,
                    0.3187957775971679,
                    0.9254165783983234,
                    0.0,
                ],
            ],
        );
        assert_rows(
            &xform(&[("rotateYZX", angles)], &["xformOp:rotateYZX"]),
            [
                [
                    0.8137976813493738,
                    -0.49999999999999994,
                    0.2961981327260239,
                    0.0,
                ],
                [
                    0.5220994638130463,
                    0.8528685319524433,
                    0.005236133250197755,
                    0.0,
                ],
                [
                    -0.2552361332501978,
                    0.1503837331804353,
                    0.9551121657052657,
                    0.0,
                ],
            ],
        );
    }

    #[test]
    fn quaternions_that_are_not_unit_turn_as_in_usd_core() {
        let quaternion = DQuat::from_xyzw(0.1, 0.5, 0.2, 0.9);
        assert_rows(
            &xform(&[("orient", Value::Quat(quaternion))], &["xformOp:orient"]),
            [
                [
                    0.6326666666666669,
                    -0.22316273993818636,
                    0.7415735165121324,
                    0.0,
                ],
                [
                    0.34982940660485295,
                    0.9366666666666668,
                    -0.016581369969093235,
                    0.0,
                ],
                [
                    -0.6909068498454658,
                    0.2699147033024264,
                    0.6706666666666669,
                    0.0,
                ],
            ],
        );
    }

    #[test]
    fn pivots_and_mirroring_scales_equal_usd_core() {
        let ops = [
            ("translate", vec3(1.0, 2.0, 3.0)),
            ("translate:pivot", vec3(4.0, 5.0, 6.0)),
            ("rotateY", Value::Float(30.0)),
            ("scale", vec3(1.0, 2.0, -3.0)),
        ];
        let order = [
            "xformOp:translate",
            "xformOp:translate:pivot",
            "xformOp:rotateY",
            "xformOp:scale",
            "!invert!xformOp:translate:pivot",
        ];
        assert_rows(
            &xform(&ops, &order),
            [
                [
                    0.8660254037844387,
                    0.0,
                    -1.4999999999999998,
                    10.535898384862243,
                ],
                [0.0, 2.0, 0.0, -3.0],
                [
                    -0.49999999999999994,
                    0.0,
                    -2.598076211353316,
                    26.588457268119896,
                ],
            ],
        );
    }

    #[test]
    fn inverted_rotations_scales_and_orients_equal_usd_core() {
        let ops = [
            ("rotateXZY:q", vec3(10.0, 20.0, 30.0)),
            ("scale", vec3(1.0, 2.0, 4.0)),
            (
                "orient",
                Value::Quat(DQuat::from_xyzw(0.6, 0.0, 0.0, f64::from(0.8_f32))),
            ),
        ];
        let order = [
            "!invert!xformOp:rotateXZY:q",
            "!invert!xformOp:scale",
            "!invert!xformOp:orient",
        ];
        let matrix = local(&xform(&ops, &order)).parent_from_local;
        let expected = [
            [0.8137976813493738, 0.14108756056709892, 0.21926612510286247],
            [
                -0.4033171145852769,
                0.03982050232286283,
                0.43258805064567724,
            ],
            [
                0.41841204441673263,
                -0.2360267608840415,
                -0.009483713171351354,
            ],
        ];
        for (r, row) in expected.iter().enumerate() {
            for (c, &value) in row.iter().enumerate() {
                assert!((matrix.row(r)[c] - value).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn reset_drops_the_ops_before_it_as_in_usd_core() {
        let ops = [
            ("rotateZ", Value::Float(90.0)),
            ("translate", vec3(1.0, 2.0, 3.0)),
        ];
        let prim = xform(&ops, &["xformOp:rotateZ", RESET, "xformOp:translate"]);
        assert!(local(&prim).resets_stack);
        assert_eq!(
            local(&prim).parent_from_local,
            DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0))
        );
    }

    #[test]
    fn missing_ops_count_as_identity_and_are_counted() {
        let prim = xform(
            &[("translate", vec3(1.0, 2.0, 3.0))],
            &["xformOp:scale:x", "xformOp:rotateX", "xformOp:translate"],
        );
        let result = local(&prim);
        assert_eq!(result.flawed_op_count, 2);
        assert_eq!(
            result.parent_from_local,
            DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0))
        );
    }

    #[test]
    fn ops_without_a_value_at_this_time_are_the_identity_and_no_flaw() {
        let mut prim = xform(&[("rotateX", Value::Float(9.0))], &["xformOp:rotateX"]);
        let attribute = prim.attributes.get_mut("xformOp:rotateX").unwrap();
        attribute.value = None;
        assert_eq!(local(&prim), LocalTransform::IDENTITY);
    }

    #[test]
    fn single_axis_translations_and_scales_act_on_their_axis() {
        let prim = xform(
            &[
                ("translateX", Value::Float(5.0)),
                ("scaleY", Value::Float(3.0)),
            ],
            &["xformOp:translateX", "xformOp:scaleY"],
        );
        assert_rows(
            &prim,
            [
                [1.0, 0.0, 0.0, 5.0],
                [0.0, 3.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ],
        );
    }

    #[test]
    fn scopes_are_not_transformable() {
        let mut prim = xform(&[("rotateZ", Value::Float(90.0))], &["xformOp:rotateZ"]);
        prim.type_name = "Scope".into();
        assert_eq!(local(&prim), LocalTransform::IDENTITY);
    }
}
