//! Results on meshes → an override layer of primvars named as their AOV, and the stage that shows it.
//!
//! `DIR/NAME.usdc` holds nothing but `over`s and the stage's metadata: sublayer it over the asset anywhere.
//! `DIR/NAME_baked.usda` is that sublayering, made to be looked at (see [`super::baked`]).
//! Directions and positions are written as computed: world space.

use super::opinions::{Declaration, Opinions};
use super::targets::{self, Classes};
use super::{Error, Provenance, author_metadata, baked, save};
use crate::diagnostics::Diagnostics;
use crate::results::{
    Aov, AovBuffer, BakeInterpolation, PrimvarSpan, Results, ValueType, name_of_group,
};
use crate::scene::{Scene, StageInfo};
use glam::Vec3;
use openusd::gf;
use openusd::sdf::{FieldKey, Path as SdfPath, PathListOp, Specifier, Value};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

pub use super::targets::InstancePolicy;

/// What a bake writes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BakeOptions {
    /// AOVs to write, in order; the results must hold them all. Light groups of the results are written too.
    pub aovs: Vec<Aov>,
    /// AOV shown as `displayColor` (one float or harmonics = gray, alpha dropped); `None` leaves the asset's.
    pub display_color: Option<Aov>,
    /// What becomes of instances.
    pub instances: InstancePolicy,
    /// Version, command line, comment.
    pub provenance: Provenance,
}

/// Collects the results of one or several frames and writes them as one layer.
#[derive(Debug)]
pub struct LayerWriter {
    stage: StageInfo,
    options: BakeOptions,
    prims: BTreeMap<String, Primvars>,
    classes: Classes,
    inherits: BTreeMap<String, String>,
    deinstanced: BTreeSet<String>,
}

/// Primvars of one prim by name.
type Primvars = BTreeMap<Cow<'static, str>, Primvar>;

/// One primvar of one prim.
#[derive(Debug)]
struct Primvar {
    type_name: &'static str,
    interpolation: &'static str,
    default: Option<Value>,
    samples: Vec<(f64, Value)>,
}

impl LayerWriter {
    /// An empty bake over the stage that `stage` tells of.
    pub fn new(stage: &StageInfo, options: BakeOptions) -> Self {
        Self {
            stage: stage.clone(),
            options,
            prims: BTreeMap::new(),
            classes: Classes::default(),
            inherits: BTreeMap::new(),
            deinstanced: BTreeSet::new(),
        }
    }

    /// Add the values of one frame; `time` is its time code, `None` writes default values. The frames may come in
    /// any order, each once. Prims that cannot hold values are warned of.
    ///
    /// # Panics
    /// When `results` lacks an AOV of the options: that is a mistake of the caller's.
    pub fn add(
        &mut self,
        (scene, spans): (&Scene, &[PrimvarSpan]),
        results: &Results,
        time: Option<f64>,
        diagnostics: &Diagnostics,
    ) {
        let policy = self.options.instances;
        let targets = targets::find(scene, spans, policy, &mut self.classes, diagnostics);
        let buffer = |aov: &Aov| results.get(*aov).expect("every AOV to write was computed");
        let shown = self.options.display_color.as_ref().map(buffer);
        for (path, spans) in targets.spans {
            let Some(spans) = agreeing(&path, spans, diagnostics) else {
                continue;
            };
            let primvars = self.prims.entry(path).or_default();
            let whole = self.options.aovs.iter().map(|aov| (None, buffer(aov)));
            let groups = results.groups.iter().flat_map(|group| {
                let buffers = group.buffers.iter();
                buffers.map(|buffer| (Some(&*group.name), buffer))
            });
            for (group, buffer) in whole.chain(groups) {
                // ids do not move, so they are one value whatever the frames
                let is_id = buffer.aov.value_type() == ValueType::Id;
                let time = time.filter(|_| !is_id);
                for (name, type_name, value) in named(buffer.aov, average(buffer, &spans)) {
                    let name = name_of_group(name, group);
                    add_value(primvars, (name, type_name), &spans, (time, value));
                }
            }
            if let Some(shown) = shown {
                let value = colors(shown.aov, &average(shown, &spans));
                let name = ("displayColor".into(), "color3f[]");
                add_value(primvars, name, &spans, (time, value));
            }
        }
        self.inherits.extend(targets.inherits);
        self.deinstanced.extend(targets.deinstanced);
    }

    /// Write `path` and, beside it, the stage that shows it. Returns both paths.
    ///
    /// # Errors
    /// When a file cannot be written; a file that could not be finished does not exist or is the old one.
    pub fn write(self, path: &Path) -> Result<Vec<PathBuf>, Error> {
        let stage = self.stage_with_range();
        let mut layer = Opinions::new();
        author_metadata(&mut layer, &stage, &self.options.provenance);
        author_range(&mut layer, &stage);
        self.author_instances(&mut layer)?;
        let paths: Vec<String> = self.prims.keys().cloned().collect();
        let shows = self.options.display_color.is_some();
        for (path, primvars) in self.prims {
            author_prim(&mut layer, &path, primvars)?;
        }
        save(layer, path)?;
        let shown = if shows { paths } else { Vec::new() };
        let beside = baked::write(&stage, path, &shown, &self.options.provenance)?;
        Ok(vec![path.to_owned(), beside])
    }

    /// The asset's metadata; its time range is that of the samples when it has none of its own.
    fn stage_with_range(&self) -> StageInfo {
        let mut stage = self.stage.clone();
        let primvars = self.prims.values().flat_map(BTreeMap::values);
        let times = || primvars.clone().flat_map(|p| p.samples.iter().map(|s| s.0));
        let range = times().reduce(f64::min).zip(times().reduce(f64::max));
        stage.time_range = stage.time_range.or(range);
        stage
    }

    fn author_instances(&self, layer: &mut Opinions) -> Result<(), Error> {
        for class in self.classes.paths() {
            let class = layer.over(class)?;
            layer.set(
                &class,
                FieldKey::Specifier,
                Value::Specifier(Specifier::Class),
            );
        }
        for (instance, class) in &self.inherits {
            let class = layer.over(class)?;
            let instance = layer.over(instance)?;
            let arc = Value::PathListOp(PathListOp::prepended([class]));
            layer.set(&instance, FieldKey::InheritPaths, arc);
        }
        for instance in &self.deinstanced {
            let instance = layer.over(instance)?;
            layer.set(&instance, FieldKey::Instanceable, Value::Bool(false));
        }
        Ok(())
    }
}

/// Spans of one mesh, if they have as many values each; instances of one prototype always do.
fn agreeing<'a>(
    path: &str,
    spans: Vec<&'a PrimvarSpan>,
    diagnostics: &Diagnostics,
) -> Option<Vec<&'a PrimvarSpan>> {
    let layout = |span: &PrimvarSpan| (span.receiver_of_value.len(), span.interpolation);
    let first = layout(spans.first()?);
    if spans.iter().all(|span| layout(span) == first) {
        return Some(spans);
    }
    let message = "its instances differ in their number of points, so no average is written to it";
    diagnostics.warn("instance-not-baked", path, message);
    None
}

/// Mean over the spans for every value; directions are unit again, ids are those of the first span.
fn average(buffer: &AovBuffer, spans: &[&PrimvarSpan]) -> Vec<f32> {
    let width = buffer.aov.components();
    let at = |span: &PrimvarSpan, i: usize| span.receiver_of_value[i] as usize * width;
    let count = spans[0].receiver_of_value.len();
    let kind = buffer.aov.value_type();
    let mut values = Vec::with_capacity(count * width);
    if spans.len() == 1 || kind == ValueType::Id {
        for i in 0..count {
            let start = at(spans[0], i);
            values.extend_from_slice(&buffer.data[start..start + width]);
        }
        return values;
    }
    for i in 0..count {
        for component in 0..width {
            let one = |span: &&PrimvarSpan| f64::from(buffer.data[at(span, i) + component]);
            values.push(mean(spans.iter().map(one)));
        }
        if kind == ValueType::Normal {
            let start = values.len() - 3;
            let unit = Vec3::from_slice(&values[start..]).normalize_or_zero();
            values[start..].copy_from_slice(&unit.to_array());
        }
    }
    values
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a mean of f32 values is in their range"
)]
fn mean(values: impl ExactSizeIterator<Item = f64>) -> f32 {
    let count = values.len() as f64;
    (values.sum::<f64>() / count) as f32
}

/// The primvars of an AOV's numbers: one of its own name, or one a part; name, USD type, value.
fn named(aov: Aov, values: Vec<f32>) -> Vec<(&'static str, &'static str, Value)> {
    let names = aov.part_names();
    if names.is_empty() {
        let (type_name, value) = typed(aov, values);
        return vec![(aov.name(), type_name, value)];
    }
    let width = aov.part_components();
    let part = |(index, &name): (usize, &&'static str)| {
        let own = (values.chunks_exact(aov.components()))
            .flat_map(|value| &value[index * width..][..width]);
        let (type_name, value) = typed(aov, own.copied().collect());
        (name, type_name, value)
    };
    names.iter().enumerate().map(part).collect()
}

/// USD type and value of an AOV's numbers, or of those of one of its parts.
fn typed(aov: Aov, values: Vec<f32>) -> (&'static str, Value) {
    match aov.part_type() {
        ValueType::Float | ValueType::Harmonics => ("float[]", Value::FloatVec(values)),
        ValueType::Color | ValueType::ColorHarmonics => ("color3f[]", vectors(&values)),
        ValueType::Normal => ("normal3f[]", vectors(&values)),
        ValueType::Point => ("point3f[]", vectors(&values)),
        ValueType::ColorAlpha => {
            let colors = values.as_chunks().0.iter().copied().map(gf::Vec4f::from);
            ("color4f[]", Value::Vec4fVec(colors.collect()))
        }
        ValueType::Id => {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "ids are whole numbers below 2^24"
            )]
            let ids = values.iter().map(|&id| id as i32).collect();
            ("int[]", Value::IntVec(ids))
        }
    }
}

fn vectors(values: &[f32]) -> Value {
    let vectors = values.as_chunks().0.iter().copied().map(gf::Vec3f::from);
    Value::Vec3fVec(vectors.collect())
}

/// The numbers of an AOV as colors to look at: the values themselves, single ones as gray; of harmonics the first
/// coefficient.
fn colors(aov: Aov, values: &[f32]) -> Value {
    let width = aov.components();
    let color = |value: &[f32]| match value[..aov.part_components()] {
        [red, green, blue, ..] => gf::Vec3f::from([red, green, blue]),
        _ => gf::Vec3f::from([value[0]; 3]),
    };
    Value::Vec3fVec(values.chunks_exact(width).map(color).collect())
}

fn add_value(
    primvars: &mut Primvars,
    (name, type_name): (Cow<'static, str>, &'static str),
    spans: &[&PrimvarSpan],
    (time, value): (Option<f64>, Value),
) {
    let primvar = primvars.entry(name).or_insert_with(|| Primvar {
        type_name,
        interpolation: match spans[0].interpolation {
            BakeInterpolation::Vertex => "vertex",
            BakeInterpolation::FaceVarying => "faceVarying",
        },
        default: None,
        samples: Vec::new(),
    });
    match time {
        None => primvar.default = Some(value),
        Some(time) => primvar.samples.push((time, value)),
    }
}

pub(super) fn author_range(layer: &mut Opinions, stage: &StageInfo) {
    if let Some((start, end)) = stage.time_range {
        let root = SdfPath::abs_root();
        layer.set(&root, FieldKey::StartTimeCode, Value::Double(start));
        layer.set(&root, FieldKey::EndTimeCode, Value::Double(end));
    }
}

fn author_prim(layer: &mut Opinions, path: &str, primvars: Primvars) -> Result<(), Error> {
    let prim = layer.over(path)?;
    for (name, primvar) in primvars {
        let full = format!("primvars:{name}");
        let declaration = Declaration {
            name: &full,
            type_name: primvar.type_name,
            interpolation: Some(primvar.interpolation),
        };
        let attribute = layer.attribute(&prim, declaration)?;
        if let Some(value) = primvar.default {
            layer.set(&attribute, FieldKey::Default, value);
        }
        if !primvar.samples.is_empty() {
            let mut samples = primvar.samples;
            samples.sort_by(|a, b| a.0.total_cmp(&b.0));
            layer.set(
                &attribute,
                FieldKey::TimeSamples,
                Value::TimeSamples(samples),
            );
        }
        if name == "displayColor" {
            block_indices(layer, &prim)?;
        }
    }
    Ok(())
}

/// The asset's `displayColor` may be indexed; its indices must not be taken for ours.
fn block_indices(layer: &mut Opinions, prim: &SdfPath) -> Result<(), Error> {
    let declaration = Declaration {
        name: "primvars:displayColor:indices",
        type_name: "int[]",
        interpolation: None,
    };
    let indices = layer.attribute(prim, declaration)?;
    layer.set(&indices, FieldKey::Default, Value::ValueBlock);
    Ok(())
}
