//! The worker's answer to a load: its JSON index and the flat file of arrays → [`RawStage`].

use super::super::raw::{
    Declaration, MaterialxReference, PrimCommon, RawAttribute, RawMeta, RawPrim, RawRelationship,
    RawStage, ReadCounts, Sample, Value,
};
use super::array_file::ArrayFile;
use glam::{DMat4, DQuat, DVec2, DVec3, DVec4, Vec2, Vec3, Vec4};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What the worker answers to a load.
#[derive(Debug, Deserialize)]
pub(super) struct Index {
    meta: Meta,
    prims: Vec<Prim>,
    prototype_start: usize,
    /// What became of each variant choice, and names that would have been right.
    pub(super) variants: Vec<(String, Vec<String>)>,
    /// The file of arrays; empty when there are none.
    pub(super) arrays: PathBuf,
    /// False where arrays that do not vary are those of an earlier load.
    pub(super) fresh: bool,
    /// Values read.
    read: usize,
    /// What USD warned of, sorted.
    pub(super) warnings: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct Meta {
    up_axis: Option<String>,
    meters_per_unit: Option<Number>,
    default_prim: Option<String>,
    start_time_code: Option<Number>,
    end_time_code: Option<Number>,
    time_codes_per_second: Option<Number>,
    render_settings_prim_path: Option<String>,
    layers: Vec<String>,
    unloaded: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct Prim {
    path: String,
    #[serde(rename = "type")]
    type_name: String,
    parent: Option<usize>,
    prototype: Option<usize>,
    kind: Option<String>,
    #[serde(default)]
    schemas: Vec<String>,
    #[serde(default)]
    attributes: BTreeMap<String, Attribute>,
    /// Targets and `bindMaterialAs`.
    #[serde(default)]
    relationships: BTreeMap<String, (Vec<String>, Option<String>)>,
    #[serde(default)]
    unread: Vec<String>,
    #[serde(default)]
    inactive_ids: Vec<i64>,
    /// Files and targets.
    #[serde(default)]
    materialx: Vec<(PathBuf, String)>,
}

#[derive(Debug, Deserialize)]
struct Attribute {
    #[serde(rename = "type")]
    type_name: String,
    value: Option<Content>,
    interpolation: Option<String>,
    element_size: Option<i32>,
    weight: Option<Number>,
    color_space: Option<String>,
    #[serde(default)]
    connections: Vec<String>,
    #[serde(default)]
    varying: bool,
    held: Option<(Number, Content)>,
}

/// A value by kind, as `program/values.py` spells them.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Content {
    Bool(bool),
    Int(i64),
    Float(Number),
    Token(String),
    Asset(String, String),
    Vector(Vec<Number>),
    Quat([Number; 4]),
    Matrix([Number; 16]),
    Tokens(Vec<String>),
    /// Byte offset, element type, rows, columns.
    Array(usize, String, usize, usize),
    /// The same, in the file of an earlier load.
    Kept(usize, String, usize, usize),
}

/// The files of arrays that an index points into.
#[derive(Debug, Clone, Copy)]
pub(super) struct Arrays<'a> {
    /// Of this load; none without arrays.
    pub(super) new: Option<&'a ArrayFile>,
    /// Of the earlier load that read what does not vary.
    pub(super) kept: Option<&'a ArrayFile>,
}

/// A float spelled out: `str::parse` rounds correctly and knows `nan` and `inf`, JSON numbers do neither.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(try_from = "String")]
struct Number(f64);

impl TryFrom<String> for Number {
    type Error = std::num::ParseFloatError;

    fn try_from(text: String) -> Result<Self, Self::Error> {
        text.parse().map(Self)
    }
}

impl Index {
    /// The stage, with arrays read from `arrays`. The error says which prim's value does not make sense.
    pub(super) fn into_stage(self, root: &Path, arrays: Arrays<'_>) -> Result<RawStage, String> {
        let mut meta = self.meta.into_raw(root);
        meta.read = ReadCounts {
            attributes: self.read,
            bytes: arrays.new.map_or(0, ArrayFile::bytes),
        };
        let prims = self
            .prims
            .into_iter()
            .map(|prim| prim.into_raw(arrays))
            .collect::<Result<_, _>>()?;
        Ok(RawStage {
            meta,
            prims,
            prototype_start: self.prototype_start,
        })
    }
}

impl Meta {
    fn into_raw(self, root: &Path) -> RawMeta {
        let float = |number: Option<Number>| number.map(|number| number.0);
        RawMeta {
            path: root.to_owned(),
            up_axis: self.up_axis,
            meters_per_unit: float(self.meters_per_unit),
            default_prim: self.default_prim,
            start_time_code: float(self.start_time_code),
            end_time_code: float(self.end_time_code),
            time_codes_per_second: float(self.time_codes_per_second),
            render_settings_prim_path: self.render_settings_prim_path,
            layers: self.layers,
            unloaded: self.unloaded,
            read: ReadCounts::default(),
            reader: "usd-core",
        }
    }
}

impl Prim {
    fn into_raw(self, arrays: Arrays<'_>) -> Result<RawPrim, String> {
        let path = self.path;
        let attribute = |(name, attribute): (String, Attribute)| {
            let raw = attribute
                .into_raw(arrays)
                .map_err(|problem| format!("{path}.{name}: {problem}"))?;
            Ok((name, raw))
        };
        let attributes = self
            .attributes
            .into_iter()
            .map(attribute)
            .collect::<Result<_, String>>()?;
        let relationship = |(name, (targets, bind_material_as))| {
            let raw = RawRelationship {
                targets,
                bind_material_as,
            };
            (name, raw)
        };
        let common = PrimCommon {
            type_name: self.type_name,
            parent: self.parent,
            api_schemas: self.schemas,
            prototype: self.prototype,
            kind: self.kind,
            relationships: self.relationships.into_iter().map(relationship).collect(),
            unread: self.unread,
            inactive_ids: self.inactive_ids,
            is_posed: false,
            materialx: (self.materialx.into_iter())
                .map(|(file, target)| MaterialxReference { file, target })
                .collect(),
        };
        Ok(RawPrim::new(path, common).with(attributes))
    }
}

impl Attribute {
    fn into_raw(self, arrays: Arrays<'_>) -> Result<RawAttribute, String> {
        let declaration = Declaration {
            type_name: self.type_name,
            interpolation: self.interpolation,
            element_size: self.element_size,
            weight: self.weight.map(|weight| narrow(weight.0)),
            color_space: self.color_space,
            connections: self.connections,
            varying: self.varying,
            held: match self.held {
                Some((time, value)) => Some(Box::new(Sample {
                    time: time.0,
                    value: value.into_raw(arrays)?,
                })),
                None => None,
            },
            ..Declaration::default()
        };
        let value = self.value.map(|value| value.into_raw(arrays)).transpose()?;
        Ok(RawAttribute::new(declaration, value))
    }
}

impl Content {
    fn into_raw(self, arrays: Arrays<'_>) -> Result<Value, String> {
        Ok(match self {
            Self::Bool(value) => Value::Bool(value),
            Self::Int(value) => Value::Int(value),
            Self::Float(value) => Value::Float(value.0),
            Self::Token(value) => Value::Token(value),
            Self::Asset(authored, resolved) => Value::Asset { authored, resolved },
            Self::Vector(values) => vector(&values)?,
            Self::Quat(values) => Value::Quat(DQuat::from_array(values.map(|value| value.0))),
            // USD's row-major, row-vector matrix is the column-major, column-vector one in memory.
            Self::Matrix(values) => {
                let matrix = DMat4::from_cols_array(&values.map(|value| value.0));
                Value::Matrix(Box::new(matrix))
            }
            Self::Tokens(values) => Value::TokenArray(values),
            Self::Array(offset, kind, rows, columns) => {
                array(arrays.new, offset, &kind, (rows, columns))?
            }
            Self::Kept(offset, kind, rows, columns) => {
                array(arrays.kept, offset, &kind, (rows, columns))?
            }
        })
    }
}

#[expect(clippy::cast_possible_truncation, reason = "it is a float in USD")]
fn narrow(number: f64) -> f32 {
    number as f32
}

fn vector(values: &[Number]) -> Result<Value, String> {
    match *values {
        [x, y] => Ok(Value::Vec2(DVec2::new(x.0, y.0))),
        [x, y, z] => Ok(Value::Vec3(DVec3::new(x.0, y.0, z.0))),
        [x, y, z, w] => Ok(Value::Vec4(DVec4::new(x.0, y.0, z.0, w.0))),
        _ => Err(format!("a vector of {} components", values.len())),
    }
}

/// The array of `rows` × `columns` at byte `offset`.
fn array(
    file: Option<&ArrayFile>,
    offset: usize,
    kind: &str,
    (rows, columns): (usize, usize),
) -> Result<Value, String> {
    Ok(match (kind, columns) {
        ("i4", 1) => Value::IntArray(values(file, offset, rows)?),
        ("i8", 1) => Value::Int64Array(values(file, offset, rows)?),
        ("f4", 1) => Value::FloatArray(values(file, offset, rows)?),
        ("f4", 2) => Value::Vec2Array(values::<Vec2>(file, offset, rows)?),
        ("f4", 3) => Value::Vec3Array(values::<Vec3>(file, offset, rows)?),
        ("f4", 4) => Value::Vec4Array(values::<Vec4>(file, offset, rows)?),
        ("qf4", 4) => Value::QuatArray(values::<Vec4>(file, offset, rows)?),
        ("f8", 16) => Value::MatrixArray(values::<DMat4>(file, offset, rows)?),
        _ => return Err(format!("an array of {columns} × {kind}")),
    })
}

/// A load without any values has no file.
fn values<T: bytemuck::Pod>(
    file: Option<&ArrayFile>,
    offset: usize,
    count: usize,
) -> Result<Vec<T>, String> {
    match file {
        Some(file) => file.values(offset, count),
        None if count == 0 => Ok(Vec::new()),
        None => Err("an array without the worker's file".to_owned()),
    }
}
