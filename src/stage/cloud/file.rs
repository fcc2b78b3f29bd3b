//! One USD layer, read without composition: what a cloud is made of.

use crate::files::Bytes;
use crate::stage::{Error, native};
use glam::Vec3;
use openusd::sdf::{AbstractData, Path, SpecType, Value};
use openusd::{usda, usdc};
use std::io::Cursor;
use std::thread;

/// Fields that bring in opinions from elsewhere.
const ARCS: [&str; 5] = [
    "references",
    "payload",
    "inheritPaths",
    "specializes",
    "variantSetNames",
];

/// An open layer.
pub(in crate::stage) struct File(Box<dyn AbstractData>);

/// Values of one attribute of a `Points` prim.
#[derive(Debug)]
pub(in crate::stage) enum Column {
    /// Numbers.
    Floats(Vec<f32>),
    /// Vectors; a fourth component was dropped.
    Vectors(Vec<Vec3>),
    /// Whole numbers.
    Ints(Vec<i32>),
}

/// `work` on the layer at `path`, checked before the crate reads it, and on a thread of its own: what the crate does not
/// survive is an error.
///
/// # Errors
/// Files that cannot be read or are damaged, and what `work` says.
pub(in crate::stage) fn on_layer<T: Send>(
    path: &std::path::Path,
    work: impl FnOnce(&File) -> Result<T, String> + Send,
) -> Result<T, Error> {
    let failed = |message: String| Error::Layer {
        path: path.to_owned(),
        message,
    };
    let unreadable = |source| Error::Unreadable {
        path: path.to_owned(),
        source,
    };
    let bytes = Bytes::of(path).map_err(unreadable)?;
    let read = || work(&File::open(bytes)?);
    let ended = thread::scope(|scope| {
        let reader = thread::Builder::new()
            .name(native::THREAD_NAME.to_owned())
            .stack_size(native::STACK_BYTES);
        reader.spawn_scoped(scope, read).map(|reader| reader.join())
    });
    match ended.map_err(unreadable)? {
        Ok(result) => result.map_err(failed),
        Err(_) => Err(failed("the reader failed: the file is damaged".to_owned())),
    }
}

impl File {
    /// The layer whose file has the content `bytes`, binary or text.
    fn open(bytes: Bytes) -> Result<Self, String> {
        match native::checked_layer(&bytes)? {
            Some(text) => {
                let data = usda::parse(&text).map_err(|error| format!("{error:#}"))?;
                Ok(Self(Box::new(data)))
            }
            None => {
                let data = usdc::CrateData::open(Cursor::new(bytes), true);
                Ok(Self(Box::new(data.map_err(|error| format!("{error:#}"))?)))
            }
        }
    }

    /// Paths of all active `Points` prims, sorted.
    pub(in crate::stage) fn points(&self) -> Vec<Path> {
        self.prims_of_type("Points")
    }

    /// Paths of all active prims of a type, sorted.
    pub(in crate::stage) fn prims_of_type(&self, type_name: &str) -> Vec<Path> {
        let mut paths = self.0.spec_paths();
        paths.retain(|path| {
            self.0.spec_type(path) == Some(SpecType::Prim)
                && matches!(self.metadata(path, "typeName"), Some(Value::Token(t)) if t.as_str() == type_name)
                && path.ancestors_below_root().all(|prim| {
                    !matches!(self.metadata(&prim, "active"), Some(Value::Bool(false)))
                })
        });
        paths
    }

    /// What in the layer points at other layers or prims, so that reading it alone would miss something.
    pub(in crate::stage) fn composes(&self) -> Option<String> {
        let root = Path::abs_root();
        if self.0.has_field(&root, "subLayers") {
            return Some("it has sublayers".to_owned());
        }
        let paths = self.0.spec_paths().into_iter();
        let mut arcs = paths.flat_map(|path| ARCS.map(|arc| (path.clone(), arc)));
        arcs.find(|(path, arc)| self.0.has_field(path, arc))
            .map(|(path, arc)| format!("{path} has {arc}"))
    }

    /// Every spec with its kind, in the file's order.
    pub(in crate::stage) fn specs(&self) -> impl Iterator<Item = (Path, SpecType)> {
        let paths = self.0.spec_paths().into_iter();
        paths.filter_map(|path| Some((path.clone(), self.0.spec_type(&path)?)))
    }

    /// Paths of all attributes.
    pub(in crate::stage) fn attributes(&self) -> impl Iterator<Item = Path> {
        let specs = self.specs();
        specs.filter_map(|(path, kind)| (kind == SpecType::Attribute).then_some(path))
    }

    /// Names of the attributes of `prim`.
    pub(in crate::stage) fn attributes_of(&self, prim: &Path) -> Vec<String> {
        let split = self.attributes().filter_map(|path| {
            let (of, name) = path.split_property()?;
            (of == *prim).then(|| name.to_owned())
        });
        split.collect()
    }

    /// Paths of the root prims.
    pub(in crate::stage) fn roots(&self) -> Vec<String> {
        let specs = self.specs();
        let prims = specs.filter(|(path, kind)| *kind == SpecType::Prim && path.is_root_prim());
        prims.map(|(path, _)| path.as_str().to_owned()).collect()
    }

    /// Sublayers as authored, strongest first.
    pub(in crate::stage) fn sublayers(&self) -> Vec<String> {
        match self.metadata(&Path::abs_root(), "subLayers") {
            Some(Value::StringVec(layers)) => layers,
            Some(Value::TokenVec(layers)) => layers.into_iter().map(String::from).collect(),
            _ => Vec::new(),
        }
    }

    /// True if the layer says something of the prim or property `path`.
    pub(in crate::stage) fn has(&self, path: &Path) -> bool {
        self.0.has_spec(path)
    }

    /// True if the layer authors `field` there.
    pub(in crate::stage) fn has_field(&self, path: &Path, field: &str) -> bool {
        self.0.has_field(path, field)
    }

    /// True if `schema` is applied to `prim`.
    pub(in crate::stage) fn has_schema(&self, prim: &Path, schema: &str) -> bool {
        let Some(Value::TokenListOp(schemas)) = self.metadata(prim, "apiSchemas") else {
            return false;
        };
        let lists = [
            &schemas.explicit_items,
            &schemas.prepended_items,
            &schemas.appended_items,
            &schemas.added_items,
        ];
        let mut names = lists.into_iter().flatten();
        names.any(|name| name.as_str() == schema)
    }

    /// `interpolation` of an attribute.
    pub(in crate::stage) fn interpolation(&self, prim: &Path, name: &str) -> Option<String> {
        let path = prim.append_property(name).ok()?;
        match self.metadata(&path, "interpolation")? {
            Value::Token(interpolation) => Some(interpolation.as_str().to_owned()),
            _ => None,
        }
    }

    /// `elementSize` of an attribute: how many array elements one value takes.
    pub(in crate::stage) fn element_size(&self, prim: &Path, name: &str) -> usize {
        let path = prim.append_property(name).ok();
        let size = path.and_then(|path| self.metadata(&path, "elementSize"));
        match size {
            Some(Value::Int(size)) => usize::try_from(size).unwrap_or(1).max(1),
            _ => 1,
        }
    }

    /// The default value (time `None`), if any, then all time samples; blocked values are left out.
    pub(in crate::stage) fn samples(
        &self,
        prim: &Path,
        name: &str,
    ) -> Result<Vec<(Option<f64>, Value)>, String> {
        let path = prim
            .append_property(name)
            .map_err(|error| error.to_string())?;
        let field = |field| {
            let value = self.0.try_field(&path, field);
            let value = value.map_err(|error| format!("{path}: {error}"));
            Ok::<_, String>(value?.map(|value| value.into_owned()))
        };
        let mut all: Vec<_> = field("default")?.into_iter().map(|v| (None, v)).collect();
        if let Some(Value::TimeSamples(samples)) = field("timeSamples")? {
            all.extend(samples.into_iter().map(|(time, v)| (Some(time), v)));
        }
        all.retain(|(_, value)| !matches!(value, Value::ValueBlock));
        Ok(all)
    }

    /// A field of a prim or property.
    pub(in crate::stage) fn metadata(&self, path: &Path, field: &str) -> Option<Value> {
        self.0
            .try_field(path, field)
            .ok()
            .flatten()
            .map(|value| value.into_owned())
    }

    /// Default value of an attribute, else its first time sample; `None` if it has none or is blocked.
    pub(in crate::stage) fn value(&self, prim: &Path, name: &str) -> Result<Option<Value>, String> {
        let path = prim
            .append_property(name)
            .map_err(|error| error.to_string())?;
        let field = |field| {
            let value = self.0.try_field(&path, field);
            value.map_err(|error| format!("{path}: {error}"))
        };
        match field("default")?.map(|value| value.into_owned()) {
            Some(Value::ValueBlock) => return Ok(None),
            Some(value) => return Ok(Some(value)),
            None => {}
        }
        let samples = field("timeSamples")?.map(|value| value.into_owned());
        Ok(match samples {
            Some(Value::TimeSamples(samples)) => samples.into_iter().next().map(|sample| sample.1),
            _ => None,
        })
    }

    /// Values of an attribute as a column, indices resolved; `None` if it has none.
    pub(in crate::stage) fn column(
        &self,
        prim: &Path,
        name: &str,
    ) -> Result<Option<Column>, String> {
        let Some(value) = self.value(prim, name)? else {
            return Ok(None);
        };
        let kind: &'static str = (&value).into();
        let column = column(value).ok_or_else(|| {
            format!("{prim}.{name} holds {kind}, not numbers of 1, 3 or 4 components")
        })?;
        if !name.starts_with("primvars:") {
            return Ok(Some(column));
        }
        match self.value(prim, &format!("{name}:indices"))? {
            Some(Value::IntVec(indices)) => {
                Ok(Some(column.pick(&indices).ok_or_else(|| {
                    format!("{prim}.{name}:indices has an index beyond the values")
                })?))
            }
            _ => Ok(Some(column)),
        }
    }
}

impl Column {
    fn pick(self, indices: &[i32]) -> Option<Self> {
        Some(match self {
            Self::Floats(values) => Self::Floats(picked(&values, indices)?),
            Self::Vectors(values) => Self::Vectors(picked(&values, indices)?),
            Self::Ints(values) => Self::Ints(picked(&values, indices)?),
        })
    }
}

fn picked<T: Copy>(values: &[T], indices: &[i32]) -> Option<Vec<T>> {
    let at = |&index: &i32| values.get(usize::try_from(index).ok()?).copied();
    indices.iter().map(at).collect()
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "doubles are kept in single precision"
)]
fn column(value: Value) -> Option<Column> {
    let xyz = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    Some(match value {
        Value::Float(v) => Column::Floats(vec![v]),
        Value::Double(v) => Column::Floats(vec![v as f32]),
        Value::FloatVec(v) => Column::Floats(v),
        Value::DoubleVec(v) => Column::Floats(v.iter().map(|&v| v as f32).collect()),
        Value::HalfVec(v) => Column::Floats(v.iter().map(|&v| v.into()).collect()),
        Value::IntVec(v) => Column::Ints(v),
        Value::Vec3f(v) => Column::Vectors(vec![xyz(v.x, v.y, v.z)]),
        Value::Vec3fVec(v) => Column::Vectors(bytemuck::cast_vec(v)),
        Value::Vec3dVec(v) => {
            let vectors = v.iter().map(|v| xyz(v.x as f32, v.y as f32, v.z as f32));
            Column::Vectors(vectors.collect())
        }
        Value::Vec3hVec(v) => {
            let vectors = v.iter().map(|v| xyz(v.x.into(), v.y.into(), v.z.into()));
            Column::Vectors(vectors.collect())
        }
        Value::Vec4fVec(v) => Column::Vectors(v.iter().map(|v| xyz(v.x, v.y, v.z)).collect()),
        Value::Vec4hVec(v) => {
            let vectors = v.iter().map(|v| xyz(v.x.into(), v.y.into(), v.z.into()));
            Column::Vectors(vectors.collect())
        }
        _ => return None,
    })
}
