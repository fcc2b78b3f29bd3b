//! Whole assets, prim by prim: what conversion from other formats writes with.

use super::opinions::{Declaration, Opinions};
use super::{Error, Provenance, author_metadata, layer, save};
use crate::scene::StageInfo;
use glam::{DMat4, DVec3, Quat, Vec2, Vec3, Vec4};
use openusd::gf;
use openusd::sdf::{
    AssetPath, FieldKey, Path as SdfPath, PathListOp, Reference, ReferenceListOp, SpecType,
    Specifier, TokenListOp, Value,
};
use openusd::tf::Token;
use std::path::Path;

/// A value, of the USD type that [`Author::attribute`] names beside it.
#[derive(Debug, Clone, PartialEq)]
pub enum Data {
    /// bool.
    Bool(bool),
    /// int.
    Int(i32),
    /// float.
    Float(f32),
    /// double.
    Double(f64),
    /// token.
    Token(String),
    /// string.
    Text(String),
    /// asset.
    Asset(String),
    /// float2.
    Vec2(Vec2),
    /// float3, color3f.
    Vec3(Vec3),
    /// double3.
    DVec3(DVec3),
    /// float4.
    Vec4(Vec4),
    /// quatf.
    Quat(Quat),
    /// matrix4d; column vectors, as everywhere here.
    Matrix(DMat4),
    /// int[].
    Ints(Vec<i32>),
    /// float[].
    Floats(Vec<f32>),
    /// float2[], texCoord2f[].
    Vec2s(Vec<Vec2>),
    /// point3f[] and its like.
    Vec3s(Vec<Vec3>),
    /// color4f[], float4[].
    Vec4s(Vec<Vec4>),
    /// quatf[].
    Quats(Vec<Quat>),
    /// quath[].
    HalfQuats(Vec<Quat>),
    /// half3[].
    HalfVec3s(Vec<Vec3>),
    /// matrix4d[]; column vectors.
    Matrices(Vec<DMat4>),
    /// token[].
    Tokens(Vec<&'static str>),
    /// token[] of names that files choose.
    Names(Vec<String>),
}

/// A layer being written. Paths are absolute; prims that are missing above one come as overs.
#[derive(Debug)]
pub struct Author {
    layer: Opinions,
}

impl Author {
    /// A layer that says what `stage` says, with the root prim `default_prim`.
    pub fn new(stage: &StageInfo, provenance: &Provenance, default_prim: &str) -> Self {
        let mut made = Opinions::new();
        author_metadata(&mut made, stage, provenance);
        layer::author_range(&mut made, stage);
        let name = Value::Token(default_prim.into());
        made.set(&SdfPath::abs_root(), FieldKey::DefaultPrim, name);
        Self { layer: made }
    }

    /// Define `path` as a prim of type `type_name` (empty: none).
    ///
    /// # Errors
    /// Paths that USD does not allow.
    pub fn define(&mut self, path: &str, type_name: &'static str) -> Result<(), Error> {
        self.layer.define(path, type_name).map(drop)
    }

    /// Define `path` as a class: it is not drawn by itself.
    ///
    /// # Errors
    /// Paths that USD does not allow.
    pub fn class(&mut self, path: &str) -> Result<(), Error> {
        let prim = self.layer.over(path)?;
        let class = Value::Specifier(Specifier::Class);
        self.layer.set(&prim, FieldKey::Specifier, class);
        Ok(())
    }

    /// An attribute `name` of type `type_name` with a value.
    ///
    /// # Errors
    /// Names that USD does not allow.
    pub fn attribute(
        &mut self,
        prim: &str,
        (name, type_name): (&str, &str),
        value: Data,
    ) -> Result<(), Error> {
        let path = self.declare(prim, (name, type_name), None)?;
        self.layer.set(&path, FieldKey::Default, value.into());
        Ok(())
    }

    /// A `uniform` attribute with a value.
    ///
    /// # Errors
    /// Names that USD does not allow.
    pub fn uniform(
        &mut self,
        prim: &str,
        (name, type_name): (&str, &str),
        value: Data,
    ) -> Result<(), Error> {
        let prim = self.layer.over(prim)?;
        self.layer
            .uniform(&prim, name, type_name, value.into())
            .map(drop)
    }

    /// A primvar, or another attribute that has an interpolation.
    ///
    /// # Errors
    /// Names that USD does not allow.
    pub fn interpolated(
        &mut self,
        prim: &str,
        (name, type_name): (&str, &str),
        interpolation: &str,
        value: Data,
    ) -> Result<(), Error> {
        let path = self.declare(prim, (name, type_name), Some(interpolation))?;
        self.layer.set(&path, FieldKey::Default, value.into());
        Ok(())
    }

    /// An array of which `size` elements in a row belong to each point.
    ///
    /// # Errors
    /// Names that USD does not allow.
    pub fn grouped(
        &mut self,
        prim: &str,
        (name, type_name): (&str, &str),
        size: i32,
        value: Data,
    ) -> Result<(), Error> {
        let path = self.declare(prim, (name, type_name), Some("vertex"))?;
        self.layer.set(&path, "elementSize", Value::Int(size));
        self.layer.set(&path, FieldKey::Default, value.into());
        Ok(())
    }

    /// Values over time, by rising time codes; the first stands for the default time too.
    ///
    /// # Errors
    /// Names that USD does not allow.
    pub fn samples(
        &mut self,
        prim: &str,
        (name, type_name): (&str, &str),
        samples: Vec<(f64, Data)>,
    ) -> Result<(), Error> {
        let path = self.declare(prim, (name, type_name), None)?;
        let samples: Vec<(f64, Value)> = samples
            .into_iter()
            .map(|(time, value)| (time, value.into()))
            .collect();
        if let Some((_, first)) = samples.first() {
            self.layer.set(&path, FieldKey::Default, first.clone());
        }
        self.layer
            .set(&path, FieldKey::TimeSamples, Value::TimeSamples(samples));
        Ok(())
    }

    /// An output without a value, to be connected to.
    ///
    /// # Errors
    /// Names that USD does not allow.
    pub fn output(&mut self, prim: &str, (name, type_name): (&str, &str)) -> Result<(), Error> {
        self.declare(prim, (name, type_name), None).map(drop)
    }

    /// Connect an attribute of `prim` to the property `source` (`/prim.outputs:rgb`).
    ///
    /// # Errors
    /// Names that USD does not allow.
    pub fn connect(
        &mut self,
        prim: &str,
        (name, type_name): (&str, &str),
        source: &str,
    ) -> Result<(), Error> {
        let path = self.declare(prim, (name, type_name), None)?;
        let source = sdf_path(source)?;
        let source = Value::PathListOp(PathListOp::explicit([source]));
        self.layer.set(&path, FieldKey::ConnectionPaths, source);
        Ok(())
    }

    /// A relationship to `targets`.
    ///
    /// # Errors
    /// Names that USD does not allow.
    pub fn relate(&mut self, prim: &str, name: &str, targets: &[String]) -> Result<(), Error> {
        let prim = self.layer.over(prim)?;
        let path = self.layer.property(&prim, name, SpecType::Relationship)?;
        let targets = targets.iter().map(|target| sdf_path(target));
        let targets = targets.collect::<Result<Vec<_>, _>>()?;
        let targets = Value::PathListOp(PathListOp::explicit(targets));
        self.layer.set(&path, FieldKey::TargetPaths, targets);
        Ok(())
    }

    /// Apply API schemas.
    ///
    /// # Errors
    /// Paths that USD does not allow.
    pub fn apply(&mut self, prim: &str, schemas: &[&'static str]) -> Result<(), Error> {
        let prim = self.layer.over(prim)?;
        let schemas = schemas.iter().map(|schema| Token::new(schema));
        let schemas = Value::TokenListOp(TokenListOp::prepended(schemas));
        self.layer.set(&prim, FieldKey::ApiSchemas, schemas);
        Ok(())
    }

    /// Reference the prim `target` of this layer, shared by all that do.
    ///
    /// # Errors
    /// Paths that USD does not allow.
    pub fn instance(&mut self, prim: &str, target: &str) -> Result<(), Error> {
        let prim = self.layer.over(prim)?;
        let reference = Reference {
            prim_path: sdf_path(target)?,
            ..Reference::default()
        };
        let references = ReferenceListOp::prepended([reference]);
        self.layer.set(
            &prim,
            FieldKey::References,
            Value::ReferenceListOp(references),
        );
        self.layer
            .set(&prim, FieldKey::Instanceable, Value::Bool(true));
        Ok(())
    }

    /// Write the layer to `path`.
    ///
    /// # Errors
    /// When the file cannot be written; nothing is left behind then.
    pub fn save(self, path: &Path) -> Result<(), Error> {
        save(self.layer, path)
    }

    fn declare(
        &mut self,
        prim: &str,
        (name, type_name): (&str, &str),
        interpolation: Option<&str>,
    ) -> Result<SdfPath, Error> {
        let prim = self.layer.over(prim)?;
        let declaration = Declaration {
            name,
            type_name,
            interpolation,
        };
        self.layer.attribute(&prim, declaration)
    }
}

fn sdf_path(path: &str) -> Result<SdfPath, Error> {
    SdfPath::new(path).map_err(|error| Error::Prim {
        prim: path.to_owned(),
        message: error.to_string(),
    })
}

/// `name` with what USD does not take in names of prims replaced by `_`; never empty.
pub fn prim_name(name: &str) -> String {
    let is_letter = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let name: String = name
        .chars()
        .map(|c| if is_letter(c) { c } else { '_' })
        .collect();
    match name.chars().next() {
        Some(first) if !first.is_ascii_digit() => name,
        _ => format!("_{name}"),
    }
}

fn quatf(q: &Quat) -> gf::Quatf {
    gf::Quatf {
        w: q.w,
        x: q.x,
        y: q.y,
        z: q.z,
    }
}

fn quath(q: &Quat) -> gf::Quath {
    let [x, y, z, w] = q.to_array().map(half::f16::from_f32);
    gf::Quath { w, x, y, z }
}

impl From<Data> for Value {
    fn from(data: Data) -> Self {
        match data {
            Data::Bool(x) => Self::Bool(x),
            Data::Int(x) => Self::Int(x),
            Data::Float(x) => Self::Float(x),
            Data::Double(x) => Self::Double(x),
            Data::Token(x) => Self::Token(x.as_str().into()),
            Data::Text(x) => Self::String(x),
            Data::Asset(x) => Self::AssetPath(AssetPath::new(x)),
            Data::Vec2(x) => Self::Vec2f(x.to_array().into()),
            Data::Vec3(x) => Self::Vec3f(x.to_array().into()),
            Data::DVec3(x) => Self::Vec3d(x.to_array().into()),
            Data::Vec4(x) => Self::Vec4f(x.to_array().into()),
            Data::Quat(x) => Self::Quatf(quatf(&x)),
            // row vectors, row by row: in memory the same as column vectors, column by column
            Data::Matrix(x) => Self::Matrix4d(bytemuck::cast(x.to_cols_array())),
            Data::Ints(x) => Self::IntVec(x),
            Data::Floats(x) => Self::FloatVec(x),
            Data::Vec2s(x) => Self::Vec2fVec(bytemuck::cast_vec(x)),
            Data::Vec3s(x) => Self::Vec3fVec(bytemuck::cast_vec(x)),
            Data::Vec4s(x) => Self::Vec4fVec(x.iter().map(|x| x.to_array().into()).collect()),
            Data::Quats(x) => Self::QuatfVec(x.iter().map(quatf).collect()),
            Data::HalfQuats(x) => Self::QuathVec(x.iter().map(quath).collect()),
            Data::HalfVec3s(x) => Self::Vec3hVec(
                x.iter()
                    .map(|x| x.to_array().map(half::f16::from_f32).into())
                    .collect(),
            ),
            Data::Matrices(x) => Self::Matrix4dVec(
                x.iter()
                    .map(|x| bytemuck::cast(x.to_cols_array()))
                    .collect(),
            ),
            Data::Names(x) => Self::TokenVec(x.iter().map(|x| x.as_str().into()).collect()),
            Data::Tokens(x) => Self::TokenVec(x.into_iter().map(Token::new).collect()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_names_of_prims() {
        assert_eq!(prim_name("Sphere.001"), "Sphere_001");
        assert_eq!(prim_name("3d ü"), "_3d__");
        assert_eq!(prim_name(""), "_");
    }
}
