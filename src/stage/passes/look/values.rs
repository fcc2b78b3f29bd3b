//! Authored values of a raw prim as the plain types that the passes compute with.

use super::super::super::raw::{RawAttribute, RawPrim, Value};
use glam::{Vec3, Vec4};
use std::path::PathBuf;

/// Typed access to a prim's authored attributes; `None` = not authored, blocked, or of another kind.
pub(super) trait Values {
    /// The attribute's value.
    fn value(&self, name: &str) -> Option<&Value>;

    /// A float, an integer or a bool as a number.
    fn number(&self, name: &str) -> Option<f64> {
        self.value(name).and_then(number)
    }

    /// A bool, or an integer that is not 0.
    fn flag(&self, name: &str) -> Option<bool> {
        match self.value(name)? {
            Value::Bool(flag) => Some(*flag),
            Value::Int(number) => Some(*number != 0),
            _ => None,
        }
    }

    /// A token or string.
    fn token(&self, name: &str) -> Option<&str> {
        self.value(name).and_then(token)
    }

    /// A token array.
    fn tokens(&self, name: &str) -> Option<&[String]> {
        match self.value(name)? {
            Value::TokenArray(tokens) => Some(tokens),
            _ => None,
        }
    }
}

impl Values for RawPrim {
    fn value(&self, name: &str) -> Option<&Value> {
        self.attributes
            .get(name)
            .and_then(|attribute: &RawAttribute| attribute.value.as_ref())
    }
}

/// A float, an integer or a bool as a number.
pub(super) fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Float(number) => Some(*number),
        #[expect(
            clippy::cast_precision_loss,
            reason = "integers of lights and materials are small"
        )]
        Value::Int(number) => Some(*number as f64),
        Value::Bool(flag) => Some(f64::from(u8::from(*flag))),
        _ => None,
    }
}

/// A token or string.
pub(super) fn token(value: &Value) -> Option<&str> {
    match value {
        Value::Token(token) => Some(token),
        _ => None,
    }
}

/// An asset that is not the empty path: resolved if possible, else as authored (whoever opens it reports it).
pub(super) fn asset(value: &Value) -> Option<PathBuf> {
    match value {
        Value::Asset { authored, resolved } if resolved.is_empty() => {
            Some(authored).filter(|path| !path.is_empty())
        }
        Value::Asset { resolved, .. } => Some(resolved),
        _ => None,
    }
    .map(PathBuf::from)
}

/// Numbers and vectors as a color with alpha 1 where there is none; single numbers are gray.
pub(super) fn color(value: &Value) -> Option<Vec4> {
    match value {
        Value::Vec2(v) => Some(v.as_vec2().extend(0.0).extend(1.0)),
        Value::Vec3(v) => Some(v.as_vec3().extend(1.0)),
        Value::Vec4(v) => Some(v.as_vec4()),
        _ => number(value).map(|x| Vec3::splat(narrow(x)).extend(1.0)),
    }
}

/// Double to single precision; out of range becomes infinite, which the callers refuse.
#[expect(
    clippy::cast_possible_truncation,
    reason = "rounding is what it is for"
)]
pub(super) fn narrow(x: f64) -> f32 {
    x as f32
}
