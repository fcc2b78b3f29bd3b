//! The crate's values → [`Value`]: all widths of a kind unified, matrices transposed, quaternions as (x, y, z, w).

use crate::stage::raw::Value;
use bytemuck::allocation::cast_vec;
use glam::{DMat4, DQuat, DVec2, DVec3, DVec4, Vec2, Vec3, Vec4};
use openusd::{gf, sdf};
use std::borrow::Cow;

/// Floating-point width of a value USD can interpolate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Precision {
    Half,
    Single,
    Double,
}

impl Precision {
    /// Width of `value`'s components; `None` for what USD holds between samples (integers, strings …).
    pub(super) fn of(value: &sdf::Value) -> Option<Self> {
        use sdf::Value as V;
        match value {
            V::Half(_)
            | V::HalfVec(_)
            | V::Quath(_)
            | V::QuathVec(_)
            | V::Vec2h(_)
            | V::Vec2hVec(_)
            | V::Vec3h(_)
            | V::Vec3hVec(_)
            | V::Vec4h(_)
            | V::Vec4hVec(_) => Some(Self::Half),
            V::Float(_)
            | V::FloatVec(_)
            | V::Quatf(_)
            | V::QuatfVec(_)
            | V::Vec2f(_)
            | V::Vec2fVec(_)
            | V::Vec3f(_)
            | V::Vec3fVec(_)
            | V::Vec4f(_)
            | V::Vec4fVec(_) => Some(Self::Single),
            V::Double(_)
            | V::DoubleVec(_)
            | V::Quatd(_)
            | V::QuatdVec(_)
            | V::Vec2d(_)
            | V::Vec2dVec(_)
            | V::Vec3d(_)
            | V::Vec3dVec(_)
            | V::Vec4d(_)
            | V::Vec4dVec(_)
            | V::Matrix4d(_)
            | V::Matrix4dVec(_)
            | V::TimeCode(_)
            | V::TimeCodeVec(_) => Some(Self::Double),
            _ => None,
        }
    }

    /// The value of this width nearest to `x`.
    pub(super) fn round(self, x: f64) -> f64 {
        match self {
            Self::Half => half::f16::from_f64(x).to_f64(),
            Self::Single => f64::from(single(x)),
            Self::Double => x,
        }
    }
}

/// A time sample of a `type_name` attribute as what it is: the crate's text parser reads scalar samples without
/// looking at the type (`1` is an integer, `true` and `inf` are tokens). `None` if `sample` already is what it should be.
pub(super) fn typed(sample: &sdf::Value, type_name: &str) -> Option<sdf::Value> {
    use sdf::Value as V;
    match type_name {
        "half" => real(sample).map(|x| V::Half(half::f16::from_f64(x))),
        "float" => real(sample).map(|x| V::Float(single(x))),
        "double" => real(sample).map(V::Double),
        "timecode" => real(sample).map(|x| V::TimeCode(x.into())),
        "bool" => match sample {
            V::Int64(x) => Some(V::Bool(*x != 0)),
            V::Token(word) => Some(V::Bool(word.as_str().eq_ignore_ascii_case("true"))),
            _ => None,
        },
        "asset" => match sample {
            V::String(path) => Some(V::AssetPath(sdf::AssetPath::new(path.clone()))),
            _ => None,
        },
        _ => None,
    }
}

fn real(sample: &sdf::Value) -> Option<f64> {
    use sdf::Value as V;
    match sample {
        V::Double(x) => Some(*x),
        #[expect(
            clippy::cast_precision_loss,
            reason = "what the text says was meant as a real number"
        )]
        V::Int64(x) => Some(*x as f64),
        V::Token(word) => word.as_str().parse().ok(),
        _ => None,
    }
}

/// [`value`], without a copy of the large arrays that need no conversion, if `from` is given away.
pub(super) fn value_of(
    from: Cow<'_, sdf::Value>,
    resolve: &dyn Fn(&str) -> String,
) -> Option<Value> {
    use sdf::Value as V;
    let from = match from {
        Cow::Owned(from) => from,
        Cow::Borrowed(from) => return value(from, resolve),
    };
    Some(match from {
        V::IntVec(v) => Value::IntArray(v),
        V::Int64Vec(v) => Value::Int64Array(v),
        V::FloatVec(v) => Value::FloatArray(v),
        V::Vec2fVec(v) => Value::Vec2Array(cast_vec(v)),
        V::Vec3fVec(v) => Value::Vec3Array(cast_vec(v)),
        other => return value(&other, resolve),
    })
}

/// `from` in our kinds; `None` for a block, and for kinds no scene needs (dictionaries, matrix2d, matrix3d …).
/// `resolve` finds the file of an asset path.
pub(super) fn value(from: &sdf::Value, resolve: &dyn Fn(&str) -> String) -> Option<Value> {
    use sdf::Value as V;
    match from {
        V::AssetPath(asset) => Some(Value::Asset {
            authored: asset.authored_path.clone(),
            resolved: resolve(asset.asset_path()),
        }),
        V::AssetPathVec(assets) => Some(Value::TokenArray(
            assets
                .iter()
                .map(|asset| asset.authored_path.clone())
                .collect(),
        )),
        other => scalar(other)
            .or_else(|| tuple(other))
            .or_else(|| array(other))
            .or_else(|| tuple_array(other)),
    }
}

/// A number, whatever spelling the parser of text took it for.
pub(super) fn float(from: &sdf::Value) -> Option<f32> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "it is a float in USD"
    )]
    match scalar(from)? {
        Value::Float(number) => Some(number as f32),
        Value::Int(number) => Some(number as f32),
        _ => None,
    }
}

fn scalar(from: &sdf::Value) -> Option<Value> {
    use sdf::Value as V;
    Some(match from {
        V::Bool(v) => Value::Bool(*v),
        V::Uchar(v) => Value::Int(i64::from(*v)),
        V::Int(v) => Value::Int(i64::from(*v)),
        V::Uint(v) => Value::Int(i64::from(*v)),
        V::Int64(v) => Value::Int(*v),
        V::Uint64(v) => Value::Int(i64::try_from(*v).unwrap_or(i64::MAX)),
        V::Half(v) => Value::Float(v.to_f64()),
        V::Float(v) => Value::Float(f64::from(*v)),
        V::Double(v) => Value::Float(*v),
        V::TimeCode(v) => Value::Float(v.value()),
        V::Token(v) => Value::Token(v.as_str().to_owned()),
        V::String(v) | V::PathExpression(v) => Value::Token(v.clone()),
        _ => return None,
    })
}

fn tuple(from: &sdf::Value) -> Option<Value> {
    use sdf::Value as V;
    Some(match from {
        V::Vec2h(v) => Value::Vec2(DVec2::new(v.x.to_f64(), v.y.to_f64())),
        V::Vec2f(v) => Value::Vec2(DVec2::new(v.x.into(), v.y.into())),
        V::Vec2d(v) => Value::Vec2(DVec2::new(v.x, v.y)),
        V::Vec2i(v) => Value::Vec2(DVec2::new(v.x.into(), v.y.into())),
        V::Vec3h(v) => Value::Vec3(DVec3::new(v.x.to_f64(), v.y.to_f64(), v.z.to_f64())),
        V::Vec3f(v) => Value::Vec3(DVec3::new(v.x.into(), v.y.into(), v.z.into())),
        V::Vec3d(v) => Value::Vec3(DVec3::new(v.x, v.y, v.z)),
        V::Vec3i(v) => Value::Vec3(DVec3::new(v.x.into(), v.y.into(), v.z.into())),
        V::Vec4h(v) => Value::Vec4(DVec4::new(
            v.x.to_f64(),
            v.y.to_f64(),
            v.z.to_f64(),
            v.w.to_f64(),
        )),
        V::Vec4f(v) => Value::Vec4(DVec4::new(v.x.into(), v.y.into(), v.z.into(), v.w.into())),
        V::Vec4d(v) => Value::Vec4(DVec4::new(v.x, v.y, v.z, v.w)),
        V::Vec4i(v) => Value::Vec4(DVec4::new(v.x.into(), v.y.into(), v.z.into(), v.w.into())),
        V::Quath(q) => Value::Quat(DQuat::from_xyzw(
            q.x.to_f64(),
            q.y.to_f64(),
            q.z.to_f64(),
            q.w.to_f64(),
        )),
        V::Quatf(q) => Value::Quat(DQuat::from_xyzw(
            q.x.into(),
            q.y.into(),
            q.z.into(),
            q.w.into(),
        )),
        V::Quatd(q) => Value::Quat(DQuat::from_xyzw(q.x, q.y, q.z, q.w)),
        V::Matrix4d(m) => Value::Matrix(Box::new(matrix(m))),
        _ => return None,
    })
}

fn array(from: &sdf::Value) -> Option<Value> {
    use sdf::Value as V;
    Some(match from {
        V::BoolVec(v) => Value::IntArray(v.iter().map(|&v| i32::from(v)).collect()),
        V::UcharVec(v) => Value::IntArray(v.iter().map(|&v| i32::from(v)).collect()),
        V::IntVec(v) => Value::IntArray(v.clone()),
        V::UintVec(v) => Value::IntArray(v.iter().map(|&v| v.cast_signed()).collect()),
        V::Int64Vec(v) => Value::Int64Array(v.clone()),
        V::Uint64Vec(v) => Value::Int64Array(v.iter().map(|&v| v.cast_signed()).collect()),
        V::HalfVec(v) => Value::FloatArray(v.iter().map(|v| v.to_f32()).collect()),
        V::FloatVec(v) => Value::FloatArray(v.clone()),
        V::DoubleVec(v) => Value::FloatArray(v.iter().map(|&v| single(v)).collect()),
        V::TimeCodeVec(v) => Value::FloatArray(v.iter().map(|v| single(v.value())).collect()),
        V::TokenVec(v) => Value::TokenArray(v.iter().map(|v| v.as_str().to_owned()).collect()),
        V::StringVec(v) => Value::TokenArray(v.clone()),
        V::Matrix4dVec(v) => Value::MatrixArray(v.iter().map(matrix).collect()),
        _ => return None,
    })
}

fn tuple_array(from: &sdf::Value) -> Option<Value> {
    use glam::{IVec2, IVec3, IVec4};
    use sdf::Value as V;
    Some(match from {
        V::Vec2hVec(v) => Value::Vec2Array(each(v, |v| Vec2::new(v.x.to_f32(), v.y.to_f32()))),
        V::Vec2fVec(v) => Value::Vec2Array(each(v, |v| Vec2::new(v.x, v.y))),
        V::Vec2dVec(v) => Value::Vec2Array(each(v, |v| DVec2::new(v.x, v.y).as_vec2())),
        V::Vec2iVec(v) => Value::Vec2Array(each(v, |v| IVec2::new(v.x, v.y).as_vec2())),
        V::Vec3hVec(v) => Value::Vec3Array(each(v, |v| {
            Vec3::from([v.x, v.y, v.z].map(half::f16::to_f32))
        })),
        V::Vec3fVec(v) => Value::Vec3Array(each(v, |v| Vec3::new(v.x, v.y, v.z))),
        V::Vec3dVec(v) => Value::Vec3Array(each(v, |v| DVec3::new(v.x, v.y, v.z).as_vec3())),
        V::Vec3iVec(v) => Value::Vec3Array(each(v, |v| IVec3::new(v.x, v.y, v.z).as_vec3())),
        V::Vec4hVec(v) => Value::Vec4Array(each(v, |v| {
            Vec4::from([v.x, v.y, v.z, v.w].map(half::f16::to_f32))
        })),
        V::Vec4fVec(v) => Value::Vec4Array(each(v, |v| Vec4::new(v.x, v.y, v.z, v.w))),
        V::Vec4dVec(v) => Value::Vec4Array(each(v, |v| DVec4::new(v.x, v.y, v.z, v.w).as_vec4())),
        V::Vec4iVec(v) => Value::Vec4Array(each(v, |v| IVec4::new(v.x, v.y, v.z, v.w).as_vec4())),
        V::QuathVec(v) => Value::QuatArray(each(v, |q| {
            Vec4::from([q.x, q.y, q.z, q.w].map(half::f16::to_f32))
        })),
        V::QuatfVec(v) => Value::QuatArray(each(v, |q| Vec4::new(q.x, q.y, q.z, q.w))),
        V::QuatdVec(v) => Value::QuatArray(each(v, |q| DVec4::new(q.x, q.y, q.z, q.w).as_vec4())),
        _ => return None,
    })
}

fn each<T, U>(list: &[T], convert: impl Fn(&T) -> U) -> Vec<U> {
    list.iter().map(convert).collect()
}

/// USD's matrix is rows that act on row vectors: read as columns it is its own transpose.
fn matrix(m: &gf::Matrix4d) -> DMat4 {
    DMat4::from_cols_array(&m.0)
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "arrays are kept in single precision"
)]
pub(super) fn single(x: f64) -> f32 {
    x as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(from: &sdf::Value) -> Option<Value> {
        value(from, &|_| String::new())
    }

    #[test]
    fn a_translation_in_the_last_row_moves_column_vectors() {
        let mut rows = [0.0; 16];
        for diagonal in [0, 5, 10, 15] {
            rows[diagonal] = 1.0;
        }
        rows[12..15].copy_from_slice(&[1.0, 2.0, 3.0]);
        let Some(Value::Matrix(matrix)) = plain(&sdf::Value::Matrix4d(gf::Matrix4d(rows))) else {
            panic!("a matrix");
        };
        assert_eq!(
            matrix.transform_point3(DVec3::ZERO),
            DVec3::new(1.0, 2.0, 3.0)
        );
    }

    #[test]
    fn what_is_given_away_is_what_is_copied() {
        let vectors = [gf::vec3f(1.0, 2.0, 3.0), gf::vec3f(-4.0, 5.0, 6.5)];
        for from in [
            sdf::Value::IntVec(vec![1, -2]),
            sdf::Value::Vec2fVec(vec![gf::vec2f(1.0, 2.0)]),
            sdf::Value::Vec3fVec(vectors.to_vec()),
            sdf::Value::DoubleVec(vec![0.5]),
            sdf::Value::ValueBlock,
        ] {
            let copied = plain(&from);
            assert_eq!(value_of(Cow::Owned(from), &|_| String::new()), copied);
        }
    }

    #[test]
    fn quaternions_have_the_real_part_last() {
        let quat = sdf::Value::QuatfVec(vec![gf::quatf(1.0, 2.0, 3.0, 4.0)]);
        assert_eq!(
            plain(&quat),
            Some(Value::QuatArray(vec![Vec4::new(2.0, 3.0, 4.0, 1.0)]))
        );
    }

    #[test]
    fn unsigned_and_boolean_arrays_are_integer_arrays() {
        assert_eq!(
            plain(&sdf::Value::BoolVec(vec![true, false])),
            Some(Value::IntArray(vec![1, 0]))
        );
        assert_eq!(
            plain(&sdf::Value::UintVec(vec![7])),
            Some(Value::IntArray(vec![7]))
        );
        assert_eq!(plain(&sdf::Value::ValueBlock), None);
    }

    #[test]
    fn rounding_gives_what_the_width_can_hold() {
        assert_eq!(
            Precision::Half.round(1.0 / 3.0),
            half::f16::from_f64(1.0 / 3.0).to_f64()
        );
        assert_eq!(Precision::Single.round(0.1), f64::from(0.1_f32));
        assert_eq!(Precision::Double.round(0.1), 0.1);
    }
}
