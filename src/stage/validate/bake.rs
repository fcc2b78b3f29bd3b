//! A layer of baked primvars: what it holds, and how it composes over its asset.

use super::columns::Numbers;
use super::{Audit, Check, Door, Error};
use crate::diagnostics::Diagnostics;
use crate::stage::cloud::file::File;
use crate::stage::raw::{RawPrim, RawStage, Request, Value as RawValue};
use crate::stage::{self, ReadSettings};
use openusd::sdf::{Path as SdfPath, SpecType, Specifier, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Classes that hold what instances share start with this name.
const SHARED_CLASS: &str = "/_surflux_shared_";

/// Fields of a prim that bring in something else than opinions on values.
const COPIES: [&str; 5] = [
    "references",
    "payload",
    "specializes",
    "variantSetNames",
    "typeName",
];

/// Attributes whose lengths say how many values each interpolation needs.
const TOPOLOGY: [&str; 3] = ["points", "faceVertexCounts", "faceVertexIndices"];

/// What a layer of values holds.
#[derive(Debug, Default)]
pub(super) struct Written {
    /// Names of the primvars on each prim, classes included.
    prims: BTreeMap<String, BTreeSet<String>>,
    /// Times of all samples; `None` where there are defaults.
    times: Vec<Option<f64>>,
    up_axis: Option<String>,
    meters_per_unit: Option<f64>,
    /// Classes that something inherits.
    inherited: BTreeSet<String>,
}

/// The layer of values of the bake at `path`, and the stage that shows it with the asset below; both may be `path`.
/// A file without sublayers is a layer of values, shown by `NAME_baked.usda` beside it where that exists.
pub(super) fn parts(path: &Path) -> Result<(PathBuf, Option<(PathBuf, PathBuf)>), Error> {
    let mut unused = Audit::default();
    let folder = path.parent().unwrap_or(Path::new(""));
    let sublayers = super::on_layer(path, &mut unused, |file, _| Ok(file.sublayers()))?;
    if let [layer, asset, ..] = &sublayers[..] {
        let shown = (path.to_owned(), beside(folder, asset));
        return Ok((beside(folder, layer), Some(shown)));
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let stage = path.with_file_name(format!("{stem}_baked.usda"));
    if !stage.is_file() {
        return Ok((path.to_owned(), None));
    }
    let sublayers = super::on_layer(&stage, &mut unused, |file, _| Ok(file.sublayers()))?;
    let shown = match &sublayers[..] {
        [layer, asset, ..] if Path::new(layer).file_name() == path.file_name() => {
            Some((stage, beside(folder, asset)))
        }
        _ => None,
    };
    Ok((path.to_owned(), shown))
}

/// The sublayer `authored` of a layer in `folder`.
fn beside(folder: &Path, authored: &str) -> PathBuf {
    folder.join(authored.strip_prefix("./").unwrap_or(authored))
}

/// What the layer itself tells: only overs, only primvars, arrays of finite values with their interpolation.
pub(super) fn check_layer(file: &File, audit: &mut Audit) -> Result<Written, String> {
    let root = SdfPath::abs_root();
    let mut written = Written {
        up_axis: match file.metadata(&root, "upAxis") {
            Some(Value::Token(axis)) => Some(axis.as_str().to_owned()),
            _ => None,
        },
        meters_per_unit: match file.metadata(&root, "metersPerUnit") {
            Some(Value::Double(unit)) => Some(unit),
            _ => None,
        },
        ..Written::default()
    };
    if let Some(arc) = file.composes().filter(|arc| arc.contains("sublayers")) {
        audit.error(
            Check::Structure,
            "/",
            format!("{arc}: a bake holds values only"),
        );
    }
    for (path, kind) in file.specs() {
        match kind {
            SpecType::Prim => check_prim(file, &path, &mut written, audit),
            SpecType::Attribute => check_attribute(file, &path, &mut written, audit)?,
            SpecType::Relationship => {
                audit.error(Check::Structure, path, "a bake holds no relationships");
            }
            _ => {}
        }
    }
    written
        .times
        .sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    written.times.dedup();
    for class in file.roots().iter().filter(|path| is_shared(path)) {
        if !written.inherited.contains(class) {
            audit.error(
                Check::Structure,
                class,
                "no instance inherits it: its values are never seen",
            );
        }
    }
    Ok(written)
}

fn is_shared(path: &str) -> bool {
    path.starts_with(SHARED_CLASS)
}

fn check_prim(file: &File, path: &SdfPath, written: &mut Written, audit: &mut Audit) {
    audit.look(Check::Structure, 1);
    let specifier = match file.metadata(path, "specifier") {
        Some(Value::Specifier(specifier)) => specifier,
        _ => Specifier::Over,
    };
    let is_class = specifier == Specifier::Class && is_shared(path.as_str());
    if specifier != Specifier::Over && !is_class {
        let message = "it is defined here; a bake holds overs only, or it would make prims that the asset lacks";
        audit.error(Check::Structure, path, message);
    }
    for field in COPIES
        .into_iter()
        .filter(|field| file.has_field(path, field))
    {
        let message = format!("it has {field}, which a bake must leave to the asset");
        audit.error(Check::Structure, path, message);
    }
    if let Some(Value::PathListOp(arcs)) = file.metadata(path, "inheritPaths") {
        let arcs = arcs.prepended_items.iter().chain(&arcs.explicit_items);
        written
            .inherited
            .extend(arcs.map(|class| class.as_str().to_owned()));
    }
}

fn check_attribute(
    file: &File,
    path: &SdfPath,
    written: &mut Written,
    audit: &mut Audit,
) -> Result<(), String> {
    let Some((prim, name)) = path.split_property() else {
        return Ok(());
    };
    let Some(base) = name.strip_prefix("primvars:") else {
        let message = "only primvars are baked; this changes the asset";
        audit.error(Check::Structure, path, message);
        return Ok(());
    };
    if base.ends_with(":indices") {
        return Ok(());
    }
    audit.look(Check::Interpolation, 1);
    match file.interpolation(&prim, name).as_deref() {
        Some("vertex" | "varying" | "faceVarying" | "uniform" | "constant") => {}
        Some(other) => audit.error(
            Check::Interpolation,
            path,
            format!("interpolation {other} is none of USD's (right: vertex or faceVarying)"),
        ),
        None => audit.error(
            Check::Interpolation,
            path,
            "no interpolation is authored: USD takes constant, which shows one value everywhere",
        ),
    }
    let samples = file.samples(&prim, name)?;
    if samples.is_empty() {
        audit.error(Check::Structure, path, "it has no value");
    }
    for (time, value) in samples {
        written.times.push(time);
        let place = match time {
            Some(time) => format!("{path} at {time}"),
            None => path.to_string(),
        };
        if let Some(numbers) = Numbers::new(&value) {
            numbers.check_finite(&place, audit);
            numbers.check_meaning(base, &place, audit);
        }
    }
    let names = written.prims.entry(prim.as_str().to_owned()).or_default();
    names.insert(name.to_owned());
    Ok(())
}

/// How `written` composes in `stage`: every prim is there, every array fits its mesh, axis and units are the asset's.
pub(super) fn check_composed(
    written: &Written,
    stage: Option<&Path>,
    (door, diagnostics): (Door, &Diagnostics),
    audit: &mut Audit,
) -> Result<(), Error> {
    let Some(stage) = stage else {
        let message = "no stage shows this bake over its asset (NAME_baked.usda beside it, or give that): \
                       lengths are not checked against meshes";
        audit.warn(Check::Structure, "/", message);
        return Ok(());
    };
    let mut source = stage::open(stage, door, diagnostics)?;
    let names = written.prims.values().flatten();
    let wanted: BTreeSet<&str> = names.map(String::as_str).chain(TOPOLOGY).collect();
    let indices = wanted.iter().map(|name| format!("{name}:indices"));
    let attributes: Vec<String> = indices
        .chain(wanted.iter().map(|&name| name.to_owned()))
        .collect();
    for &time in &written.times {
        let settings = ReadSettings {
            time,
            ..ReadSettings::default()
        };
        let request = Request {
            attributes: attributes.clone(),
            ..Request::for_settings(&settings)
        };
        let raw = source.load(&request, diagnostics)?;
        check_units(written, &raw, audit);
        check_prims(written, &raw, time, audit);
    }
    Ok(())
}

fn check_units(written: &Written, raw: &RawStage, audit: &mut Audit) {
    audit.look(Check::Units, 2);
    match &written.up_axis {
        None => audit.warn(Check::Units, "/", "upAxis is not authored"),
        Some(axis) if raw.meta.up_axis.as_ref().is_some_and(|asset| asset != axis) => {
            audit.error(
                Check::Units,
                "/",
                format!("upAxis is {axis}, the asset's is not"),
            );
        }
        Some(_) => {}
    }
    match written.meters_per_unit {
        None => audit.warn(Check::Units, "/", "metersPerUnit is not authored"),
        Some(unit) if raw.meta.meters_per_unit.is_some_and(|asset| asset != unit) => {
            let message = format!("metersPerUnit is {unit}, the asset's is not");
            audit.error(Check::Units, "/", message);
        }
        Some(_) => {}
    }
}

fn check_prims(written: &Written, raw: &RawStage, time: Option<f64>, audit: &mut Audit) {
    let by_path: BTreeMap<&str, &RawPrim> = raw
        .prims
        .iter()
        .map(|prim| (prim.path.as_str(), prim))
        .collect();
    for (path, names) in written.prims.iter().filter(|(path, _)| !is_shared(path)) {
        match by_path.get(path.as_str()) {
            Some(prim) => names
                .iter()
                .for_each(|name| check_values(prim, name, time, audit)),
            None => audit.error(
                Check::Structure,
                path,
                "the stage has no such prim, or it is below an instance, where USD ignores overs",
            ),
        }
    }
    // what instances share arrives in their prototypes through the classes
    let shared: BTreeSet<&String> = (written.prims.iter())
        .filter(|(path, _)| is_shared(path))
        .flat_map(|(_, names)| names)
        .collect();
    for prim in &raw.prims[raw.prototype_start..] {
        for name in shared
            .iter()
            .filter(|name| prim.attributes.contains_key(name))
        {
            check_values(prim, name, time, audit);
        }
    }
}

/// The composed primvar `name` of `prim` against its topology.
fn check_values(prim: &RawPrim, name: &str, time: Option<f64>, audit: &mut Audit) {
    let place = match time {
        Some(time) => format!("{}.{name} at {time}", prim.path),
        None => format!("{}.{name}", prim.path),
    };
    let Some(attribute) = prim.attributes.get(name) else {
        let message = "it does not compose: another layer or a class is missing";
        audit.error(Check::Structure, place, message);
        return;
    };
    let Some(value) = &attribute.value else {
        return;
    };
    let indices = prim.attributes.get(&format!("{name}:indices"));
    let indices = indices.and_then(|indices| indices.value.as_ref());
    let Some(length) = length(indices.unwrap_or(value)) else {
        audit.error(Check::Length, place, "it is no array of numbers");
        return;
    };
    let interpolation = attribute.interpolation.as_deref().unwrap_or("constant");
    let Some(needed) = needed(prim, interpolation) else {
        return;
    };
    audit.look(Check::Length, length);
    if length != needed {
        let message = format!(
            "{length} values, but {interpolation} on this {} needs {needed}",
            prim.type_name
        );
        audit.error(Check::Length, place, message);
    }
}

/// Values that `interpolation` takes on `prim`; `None` where its schema cannot tell.
fn needed(prim: &RawPrim, interpolation: &str) -> Option<usize> {
    let count = |name: &str| {
        let value = prim
            .attributes
            .get(name)
            .and_then(|attribute| attribute.value.as_ref());
        value.and_then(length).unwrap_or(0)
    };
    match (interpolation, prim.type_name.as_str()) {
        ("constant", _) => Some(1),
        ("vertex" | "varying", "Mesh" | "Points")
        | ("vertex", "BasisCurves" | "NurbsCurves" | "NurbsPatch") => Some(count("points")),
        ("uniform", "Mesh") => Some(count("faceVertexCounts")),
        ("faceVarying", "Mesh") => Some(count("faceVertexIndices")),
        _ => None,
    }
}

fn length(value: &RawValue) -> Option<usize> {
    match value {
        RawValue::TokenArray(_) => None,
        value => value.array_len(),
    }
}
