//! A layer being made: prims and attributes in authored order, in time proportional to their number.

use super::Error;
use glam::Vec3;
use openusd::sdf::{
    AbstractData, ChildrenKey, Data, FieldKey, Path, SpecType, Specifier, Value, Variability,
};
use openusd::tf::Token;
use std::collections::HashMap;

/// Opinions of one layer.
#[derive(Debug)]
pub(super) struct Opinions {
    data: Data,
    /// Names of the child prims, and of the properties, of each path.
    prims: HashMap<Path, Vec<Token>>,
    properties: HashMap<Path, Vec<Token>>,
    arrays: Vec<(Vec<Path>, Array)>,
}

/// Values of which there may be many.
#[derive(Debug)]
pub(super) enum Array {
    Floats(Vec<f32>),
    Vectors(Vec<Vec3>),
}

/// First of the two numbers that stand for an array, which the second counts: no number that anybody would write.
pub(super) const PLACE: i64 = 0x5a7f_10c5_e7a6_0000;

/// How an attribute is declared.
#[derive(Debug, Clone, Copy)]
pub(super) struct Declaration<'a> {
    /// Full name, `primvars:` included.
    pub(super) name: &'a str,
    /// USD value type name.
    pub(super) type_name: &'a str,
    /// `interpolation` metadata, for primvars and the like.
    pub(super) interpolation: Option<&'a str>,
}

impl Opinions {
    pub(super) fn new() -> Self {
        let mut data = Data::new();
        data.create_spec(Path::abs_root(), SpecType::PseudoRoot);
        Self {
            data,
            prims: HashMap::new(),
            properties: HashMap::new(),
            arrays: Vec::new(),
        }
    }

    /// The prim at `path` (absolute), made as an `over` with all ancestors where missing.
    pub(super) fn over(&mut self, path: &str) -> Result<Path, Error> {
        let invalid = |message: String| Error::Prim {
            prim: path.to_owned(),
            message,
        };
        let names = path.strip_prefix('/').unwrap_or_default().split('/');
        if !names.into_iter().all(is_name) {
            return Err(invalid("it is not the path of a prim".to_owned()));
        }
        let path = Path::new(path).map_err(|error| invalid(error.to_string()))?;
        self.ensure(&path);
        Ok(path)
    }

    /// The prim at `path`, made a `def` of type `type_name`.
    pub(super) fn define(&mut self, path: &str, type_name: &'static str) -> Result<Path, Error> {
        let path = self.over(path)?;
        self.set(&path, FieldKey::Specifier, Value::Specifier(Specifier::Def));
        self.set(
            &path,
            FieldKey::TypeName,
            Value::Token(Token::new(type_name)),
        );
        Ok(path)
    }

    fn ensure(&mut self, path: &Path) {
        if self.data.has_spec(path) {
            return;
        }
        let (Some(parent), Some(name)) = (path.parent(), path.name()) else {
            return;
        };
        self.ensure(&parent);
        self.prims.entry(parent).or_default().push(name.into());
        self.data.create_spec(path.clone(), SpecType::Prim);
        self.set(path, FieldKey::Specifier, Value::Specifier(Specifier::Over));
    }

    /// Set a field of an existing prim, property or the layer itself (`/`).
    pub(super) fn set(&mut self, path: &Path, field: impl AsRef<str>, value: Value) {
        self.data.set_field(path, field.as_ref(), value);
    }

    /// Set the value that all `attributes` have: it is in memory once, and in a binary file too.
    pub(super) fn set_array(&mut self, attributes: Vec<Path>, array: Array) {
        let index = i64::try_from(self.arrays.len()).expect("fewer than 2^63 arrays");
        for path in &attributes {
            self.set(path, FieldKey::Default, Value::Int64Vec(vec![PLACE, index]));
        }
        self.arrays.push((attributes, array));
    }

    /// Declare an attribute on `prim`, without a value yet.
    pub(super) fn attribute(
        &mut self,
        prim: &Path,
        declaration: Declaration<'_>,
    ) -> Result<Path, Error> {
        let path = self.property(prim, declaration.name, SpecType::Attribute)?;
        let type_name = Value::Token(declaration.type_name.into());
        self.set(&path, FieldKey::TypeName, type_name);
        if let Some(interpolation) = declaration.interpolation {
            self.set(&path, "interpolation", Value::Token(interpolation.into()));
        }
        Ok(path)
    }

    /// A `uniform` attribute with its value.
    pub(super) fn uniform(
        &mut self,
        prim: &Path,
        name: &str,
        type_name: &str,
        value: Value,
    ) -> Result<Path, Error> {
        let declaration = Declaration {
            name,
            type_name,
            interpolation: None,
        };
        let path = self.attribute(prim, declaration)?;
        let uniform = Value::Variability(Variability::Uniform);
        self.set(&path, FieldKey::Variability, uniform);
        self.set(&path, FieldKey::Default, value);
        Ok(path)
    }

    /// Declare a property of kind `kind` on `prim`.
    pub(super) fn property(
        &mut self,
        prim: &Path,
        name: &str,
        kind: SpecType,
    ) -> Result<Path, Error> {
        let path = prim.append_property(name).map_err(|error| Error::Prim {
            prim: format!("{prim}.{name}"),
            message: error.to_string(),
        })?;
        if !self.data.has_spec(&path) {
            self.data.create_spec(path.clone(), kind);
            self.properties
                .entry(prim.clone())
                .or_default()
                .push(name.into());
        }
        Ok(path)
    }

    /// The finished layer as text has it, arrays where they belong.
    pub(super) fn finish(mut self) -> Data {
        for (paths, array) in std::mem::take(&mut self.arrays) {
            let value = array.into_value();
            for path in &paths {
                self.set(path, FieldKey::Default, value.clone());
            }
        }
        self.finish_apart().0
    }

    /// The finished layer with two numbers in place of each array ([`PLACE`]), and the arrays.
    pub(super) fn finish_apart(mut self) -> (Data, Vec<Array>) {
        for (children, key) in [
            (self.prims, ChildrenKey::PrimChildren),
            (self.properties, ChildrenKey::PropertyChildren),
        ] {
            for (path, names) in children {
                self.data
                    .set_field(&path, key.as_str(), Value::TokenVec(names));
            }
        }
        let arrays = self.arrays.into_iter().map(|(_, array)| array);
        (self.data, arrays.collect())
    }
}

impl Array {
    fn into_value(self) -> Value {
        match self {
            Self::Floats(values) => Value::FloatVec(values),
            Self::Vectors(values) => {
                Value::Vec3fVec(bytemuck::cast_vec::<Vec3, openusd::gf::Vec3f>(values))
            }
        }
    }

    pub(super) fn len(&self) -> usize {
        match self {
            Self::Floats(values) => values.len(),
            Self::Vectors(values) => values.len(),
        }
    }

    /// As a file has them.
    pub(super) fn bytes(&self) -> &[u8] {
        match self {
            Self::Floats(values) => bytemuck::cast_slice(values),
            Self::Vectors(values) => bytemuck::cast_slice(values),
        }
    }
}

/// True for what USD takes as a prim's name: letters of any script, digits and `_`, no digit first.
/// (`Path::new` lets `I[3]` pass.)
fn is_name(name: &str) -> bool {
    let is_letter = |letter: char| letter.is_alphabetic() || letter == '_';
    name.starts_with(is_letter) && name.chars().all(|c| is_letter(c) || c.is_alphanumeric())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ancestors_come_as_overs_and_children_keep_their_order() {
        let mut layer = Opinions::new();
        layer.over("/a/z").unwrap();
        layer.define("/a/b", "Mesh").unwrap();
        let text = openusd::usda::TextWriter::write_to_string(&layer.finish()).unwrap();
        let lines: Vec<_> = text
            .lines()
            .map(str::trim)
            .filter(|l| l.contains('"'))
            .collect();
        assert_eq!(lines, ["over \"a\"", "over \"z\"", "def Mesh \"b\""]);
    }

    #[test]
    fn paths_that_are_no_prims_are_refused() {
        for path in ["", "/", "relative", "/a.b", "/I[3]/m", "/1 2"] {
            assert!(Opinions::new().over(path).is_err(), "{path:?}");
        }
    }
}
