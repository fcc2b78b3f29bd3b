//! Values as the dump of usd-core spells them, and whether they are the same.

use serde_json::{Value as Json, json};
use std::path::PathBuf;
use surflux::stage::raw::Value;

pub(crate) fn encode(value: &Value) -> Json {
    match value {
        Value::Bool(v) => json!({"number": i64::from(*v)}),
        Value::Int(v) => json!({"number": v}),
        Value::Float(v) => json!({"number": finite(*v)}),
        Value::Token(v) => json!({"text": v}),
        Value::Asset { authored, resolved } => json!({"asset": [authored, resolved]}),
        Value::Vec2(v) => numbers(&v.to_array()),
        Value::Vec3(v) => numbers(&v.to_array()),
        Value::Vec4(v) => numbers(&v.to_array()),
        Value::Quat(v) => numbers(&v.to_array()),
        Value::Matrix(v) => numbers(&v.to_cols_array()),
        Value::IntArray(v) => array(v.iter().map(|&x| f64::from(x)), 1),
        Value::Int64Array(v) => array(v.iter().map(|&x| x as f64), 1),
        Value::FloatArray(v) => array(v.iter().map(|&x| f64::from(x)), 1),
        Value::Vec2Array(v) => array(v.iter().flat_map(|v| v.to_array()).map(f64::from), 2),
        Value::Vec3Array(v) => array(v.iter().flat_map(|v| v.to_array()).map(f64::from), 3),
        Value::Vec4Array(v) | Value::QuatArray(v) => {
            array(v.iter().flat_map(|v| v.to_array()).map(f64::from), 4)
        }
        Value::MatrixArray(v) => array(v.iter().flat_map(|v| v.to_cols_array()), 16),
        Value::TokenArray(v) => json!({"texts": v}),
    }
}

fn finite(x: f64) -> Json {
    match x {
        x if x.is_nan() => json!("nan"),
        x if x.is_infinite() => json!(if x > 0.0 { "inf" } else { "-inf" }),
        x => json!(x),
    }
}

fn numbers(list: &[f64]) -> Json {
    json!({"numbers": list.iter().map(|&x| finite(x)).collect::<Vec<_>>()})
}

fn array(list: impl Iterator<Item = f64>, width: usize) -> Json {
    let list: Vec<f64> = list.collect();
    let weighted = list
        .iter()
        .enumerate()
        .map(|(i, x)| x * (1 + i % 97) as f64)
        .sum();
    let size = list.iter().map(|x| x.abs()).sum();
    json!({"array": {
        "count": list.len() / width,
        "width": width,
        "sum": finite(list.iter().sum()),
        "weighted": finite(weighted),
        "size": finite(size),
    }})
}

pub(crate) fn same_value(ours: Option<&Value>, truth: &Json, tolerance: f64) -> bool {
    let Some(ours) = ours else {
        return truth.is_null() || !truth["other"].is_null();
    };
    let encoded = encode(ours);
    if let (Value::Asset { authored, resolved }, Some(theirs)) = (ours, truth["asset"].as_array()) {
        let udim = authored.contains("<UDIM>");
        let same = theirs[1].as_str() == Some(&real_asset(resolved));
        return theirs[0].as_str() == Some(authored) && (udim || same);
    }
    if let (Some(ours), Some(theirs)) = (encoded["array"].as_object(), truth["array"].as_object()) {
        let scale = ours["size"].as_f64().unwrap_or(0.0);
        // an empty array has no width in numpy
        let shape = ours["count"] == theirs["count"]
            && (ours["width"] == theirs["width"] || ours["count"] == 0);
        let close = |key: &str, scale: f64| near(&ours[key], &theirs[key], tolerance * scale);
        return shape
            && close("sum", scale)
            && close("weighted", scale * 97.0)
            && close("size", scale);
    }
    if let (Some(ours), Some(theirs)) = (encoded["numbers"].as_array(), truth["numbers"].as_array())
    {
        let size = ours
            .iter()
            .filter_map(Json::as_f64)
            .fold(0.0, |sum, x| sum + x.abs());
        return ours.len() == theirs.len()
            && ours
                .iter()
                .zip(theirs)
                .all(|(a, b)| near(a, b, tolerance * size));
    }
    if let Some(size) = encoded["number"].as_f64() {
        return near(&encoded["number"], &truth["number"], tolerance * size.abs());
    }
    encoded == *truth
}

fn real_asset(path: &str) -> String {
    match path.split_once('[') {
        Some((package, inner)) => format!("{}[{inner}", real(package)),
        None if path.is_empty() => String::new(),
        None => real(path),
    }
}

fn near(ours: &Json, truth: &Json, tolerance: f64) -> bool {
    match (ours.as_f64(), truth.as_f64()) {
        (Some(ours), Some(truth)) => (ours - truth).abs() <= tolerance,
        _ => ours == truth,
    }
}

pub(crate) fn real(path: &str) -> String {
    let path = match path.split_once('[') {
        Some((package, _)) => package,
        None => path,
    };
    let real = std::fs::canonicalize(path).unwrap_or_else(|_| PathBuf::from(path));
    real.to_string_lossy().into_owned()
}
