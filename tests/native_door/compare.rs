//! A stage as the native reader gives it, against what usd-core says of it.

use crate::values::{encode, real, same_value};
use crate::{Case, native, truths};
use serde_json::{Value as Json, json};
use surflux::diagnostics::Diagnostics;
use surflux::stage::raw::{RawAttribute, RawPrim, RawStage};

/// Two sums of the same numbers in another order, or one value interpolated in another width, may differ by this much
/// of the sum of their magnitudes: a few roundings of single precision.
const INTERPOLATED: f64 = 4e-7;
/// The same in half precision.
const HALF: f64 = 1e-3;
/// Values that were only copied: sums in double precision.
const COPIED: f64 = 1e-12;

/// What was compared.
#[derive(Default)]
pub(crate) struct Tally {
    stages: usize,
    prims: usize,
    values: usize,
    facts: usize,
    /// Stages whose lists of layers are the same.
    same_layers: usize,
    pub(crate) different: Vec<String>,
}

impl Tally {
    fn fact<T: PartialEq + std::fmt::Debug>(&mut self, what: &str, ours: &T, truth: &T) {
        self.facts += 1;
        if ours != truth {
            self.different
                .push(format!("{what}: {ours:?}, usd-core {truth:?}"));
        }
    }

    /// `pairs`: key in the truth, and what we have for it.
    fn all(&mut self, name: &str, truth: &Json, pairs: &[(&str, Json)]) {
        for (key, ours) in pairs {
            self.fact(&format!("{name} {key}"), ours, &truth[key]);
        }
    }

    fn stage(&mut self, case: &Case, ours: &RawStage, truth: &Json) {
        self.stages += 1;
        let file = case.path.file_name().unwrap_or_default().to_string_lossy();
        let name = format!(
            "{file}{}",
            case.time.map_or(String::new(), |time| format!("@{time}"))
        );
        let text = renamed(&truth["prims"].to_string(), &prototype_names(truth));
        let theirs: Vec<Json> = serde_json::from_str(&text).expect("renaming keeps JSON");
        let look = Look {
            stage: ours,
            names: our_prototypes(ours),
            timed: case.time.is_some(),
        };
        let paths: Vec<String> = ours
            .prims
            .iter()
            .map(|prim| look.named(&prim.path))
            .collect();
        let their_paths: Vec<&str> = theirs
            .iter()
            .filter_map(|prim| prim["path"].as_str())
            .collect();
        self.fact(&format!("{name} prims"), &json!(paths), &json!(their_paths));
        let meta = &ours.meta;
        let pairs = [
            ("prototypeStart", json!(ours.prototype_start)),
            ("upAxis", json!(meta.up_axis)),
            ("metersPerUnit", json!(meta.meters_per_unit)),
            ("defaultPrim", json!(meta.default_prim)),
            ("startTimeCode", json!(meta.start_time_code)),
            ("endTimeCode", json!(meta.end_time_code)),
        ];
        self.all(&name, truth, &pairs);
        let mut layers: Vec<String> = meta.layers.iter().map(|layer| real(layer)).collect();
        layers.sort();
        layers.dedup();
        self.layers(&name, &layers, &keys(&truth["layers"]));
        for ((prim, path), theirs) in ours.prims.iter().zip(&paths).zip(&theirs) {
            if theirs["path"].as_str() == Some(path) {
                self.prims += 1;
                self.prim(&format!("{name} {path}"), &look, prim, theirs);
            }
        }
    }

    /// usd-core also composes what is never seen (undefined prims) and counts the layers met there.
    fn layers(&mut self, name: &str, ours: &[String], truth: &[String]) {
        self.facts += 1;
        self.same_layers += usize::from(ours == truth);
        for layer in ours.iter().filter(|layer| !truth.contains(layer)) {
            self.different
                .push(format!("{name} layers: usd-core does not use {layer}"));
        }
    }

    fn prim(&mut self, name: &str, look: &Look<'_>, ours: &RawPrim, truth: &Json) {
        let pairs = [
            ("type", json!(ours.type_name)),
            ("parent", look.path_of(ours.parent)),
            ("apiSchemas", json!(ours.api_schemas)),
            ("prototype", look.path_of(ours.prototype)),
            ("kind", json!(ours.kind)),
        ];
        self.all(name, truth, &pairs);
        let listed: Vec<&String> = ours.attributes.keys().collect();
        self.fact(
            &format!("{name} attributes"),
            &json!(listed),
            &sorted_keys(&truth["attributes"]),
        );
        let listed: Vec<&String> = ours.relationships.keys().collect();
        self.fact(
            &format!("{name} relationships"),
            &json!(listed),
            &sorted_keys(&truth["relationships"]),
        );
        for (key, relationship) in &ours.relationships {
            let pairs = [
                ("targets", look.all_named(&relationship.targets)),
                ("bindMaterialAs", json!(relationship.bind_material_as)),
            ];
            self.all(
                &format!("{name}.{key}"),
                &truth["relationships"][key],
                &pairs,
            );
        }
        for (key, attribute) in &ours.attributes {
            self.attribute(
                &format!("{name}.{key}"),
                look,
                attribute,
                &truth["attributes"][key],
            );
        }
    }

    fn attribute(&mut self, name: &str, look: &Look<'_>, ours: &RawAttribute, truth: &Json) {
        let pairs = [
            ("type", json!(ours.type_name)),
            ("interpolation", json!(ours.interpolation)),
            ("elementSize", json!(ours.element_size)),
            ("colorSpace", json!(ours.color_space)),
            ("connections", look.all_named(&ours.connections)),
            ("varying", json!(ours.varying)),
        ];
        self.all(name, truth, &pairs);
        self.values += 1;
        let tolerance = match look.timed {
            false => COPIED,
            true if ours.type_name.contains('h') => HALF,
            true => INTERPOLATED,
        };
        if !same_value(ours.value.as_ref(), &truth["value"], tolerance) {
            let ours = ours.value.as_ref().map(encode);
            self.different.push(format!(
                "{name} value: {ours:?}, usd-core {}",
                truth["value"]
            ));
        }
    }
}

/// How one stage of ours is looked at.
struct Look<'a> {
    stage: &'a RawStage,
    /// Its prototype roots, in order.
    names: Vec<&'a str>,
    timed: bool,
}

impl Look<'_> {
    fn named(&self, path: &str) -> String {
        renamed(path, &self.names)
    }

    fn all_named(&self, paths: &[String]) -> Json {
        json!(
            paths
                .iter()
                .map(|path| self.named(path))
                .collect::<Vec<_>>()
        )
    }

    fn path_of(&self, index: Option<usize>) -> Json {
        json!(index.map(|index| self.named(&self.stage.prims[index].path)))
    }
}

fn our_prototypes(stage: &RawStage) -> Vec<&str> {
    let prims = stage.prims[stage.prototype_start..].iter();
    prims
        .filter(|prim| prim.parent.is_none())
        .map(|prim| prim.path.as_str())
        .collect()
}

fn keys(list: &Json) -> Vec<String> {
    let names = list.as_array().into_iter().flatten();
    names
        .filter_map(|name| name.as_str().map(str::to_owned))
        .collect()
}

fn sorted_keys(object: &Json) -> Json {
    let mut names: Vec<String> = object
        .as_object()
        .map(|map| map.keys().cloned().collect())
        .unwrap_or_default();
    names.sort();
    json!(names)
}

/// Names of the prototype roots of a dump, in the order they come.
fn prototype_names(truth: &Json) -> Vec<&str> {
    let start = usize::try_from(truth["prototypeStart"].as_u64().unwrap_or(0)).expect("fits");
    let prims = truth["prims"].as_array().expect("a list of prims");
    prims[start..]
        .iter()
        .filter(|prim| prim["parent"].is_null())
        .filter_map(|prim| prim["path"].as_str())
        .collect()
}

/// `text` with the prototypes numbered in the order they come: readers number them as they like.
fn renamed(text: &str, names: &[&str]) -> String {
    let mut pieces = text.split("/__Prototype_");
    let mut out = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let digits = piece.len() - piece.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let name = format!("/__Prototype_{}", &piece[..digits]);
        let order = names.iter().position(|known| *known == name);
        out += &order.map_or(name, |order| format!("/__P{order}"));
        out += &piece[digits..];
    }
    out
}

pub(crate) fn compare(cases: &[Case]) -> Tally {
    let mut tally = Tally::default();
    for (case, truth) in cases.iter().zip(truths(cases)) {
        match (
            native(case, &Diagnostics::default()),
            truth["error"].as_str(),
        ) {
            (Ok(stage), None) => tally.stage(case, &stage, &truth),
            (Err(_), Some(_)) => {}
            (Ok(_), Some(error)) => tally.different.push(format!(
                "{}: usd-core refuses: {error}",
                case.path.display()
            )),
            (Err(error), None) => tally
                .different
                .push(format!("{}: we refuse: {error}", case.path.display())),
        }
    }
    for line in &tally.different {
        println!("  {line}");
    }
    println!(
        "{} stages, {} prims, {} values and {} other facts compared; {} different; {} lists of layers the same",
        tally.stages,
        tally.prims,
        tally.values,
        tally.facts,
        tally.different.len(),
        tally.same_layers
    );
    tally
}
