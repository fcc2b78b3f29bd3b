//! Typed reads of a [`RawPrim`]'s attributes. A value of the wrong type counts as not authored.

use super::super::super::raw::{RawPrim, Value};
use glam::{Vec3, Vec4};

fn value<'a>(prim: &'a RawPrim, name: &str) -> Option<&'a Value> {
    prim.attributes.get(name)?.value.as_ref()
}

/// A token, or `fallback`.
pub(super) fn token<'a>(prim: &'a RawPrim, name: &str, fallback: &'static str) -> &'a str {
    match value(prim, name) {
        Some(Value::Token(word)) => word,
        _ => fallback,
    }
}

/// A number, or `fallback`.
pub(super) fn number(prim: &RawPrim, name: &str, fallback: f64) -> f64 {
    match value(prim, name) {
        Some(Value::Float(number)) => *number,
        #[expect(clippy::cast_precision_loss, reason = "a size given as an integer")]
        Some(Value::Int(number)) => *number as f64,
        _ => fallback,
    }
}

/// A bool, or `fallback`.
pub(super) fn boolean(prim: &RawPrim, name: &str, fallback: bool) -> bool {
    match value(prim, name) {
        Some(Value::Bool(yes)) => *yes,
        _ => fallback,
    }
}

/// 32-bit integers; empty if not authored.
pub(super) fn ints<'a>(prim: &'a RawPrim, name: &str) -> &'a [i32] {
    match value(prim, name) {
        Some(Value::IntArray(values)) => values,
        _ => &[],
    }
}

/// 64-bit integers; empty if not authored. Small ones are accepted too.
pub(super) fn long_ints(prim: &RawPrim, name: &str) -> Vec<i64> {
    match value(prim, name) {
        Some(Value::Int64Array(values)) => values.clone(),
        Some(Value::IntArray(values)) => values.iter().map(|&i| i64::from(i)).collect(),
        _ => Vec::new(),
    }
}

/// Floats; empty if not authored.
pub(super) fn floats<'a>(prim: &'a RawPrim, name: &str) -> &'a [f32] {
    match value(prim, name) {
        Some(Value::FloatArray(values)) => values,
        _ => &[],
    }
}

/// 3-vectors; empty if not authored.
pub(super) fn vectors<'a>(prim: &'a RawPrim, name: &str) -> &'a [Vec3] {
    match value(prim, name) {
        Some(Value::Vec3Array(values)) => values,
        _ => &[],
    }
}

/// Quaternions (x, y, z, w); empty if not authored.
pub(super) fn quaternions<'a>(prim: &'a RawPrim, name: &str) -> &'a [Vec4] {
    match value(prim, name) {
        Some(Value::QuatArray(values)) => values,
        _ => &[],
    }
}
