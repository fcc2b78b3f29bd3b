//! The properties of one composed prim → [`RawAttribute`]s and [`RawRelationship`]s.
//!
//! A prim's opinions come from its sites: (layer, path in that layer, time offset), strongest first. Each field is
//! read from the first site that has it, so that a default in a strong layer hides time samples in a weaker one.

use super::class_cycles::children_run_in_circles;
use super::convert;
use super::interpolate::Samples;
use super::layer_files::LayerFiles;
use crate::stage::materialx;
use crate::stage::raw::{
    MOVED, MOVERS, MaterialxReference, RawAttribute, RawPrim, RawRelationship, Request, Sample,
    Value,
};
use openusd::pcp::{ArcType, LayerId, Node, PrimIndex};
use openusd::sdf::{self, AbstractData, ChildrenKey, FieldKey, LayerOffset, SpecType};
use openusd::usd::{Attribute, Stage, TimeCode};
use std::cell::Ref;
use std::collections::{BTreeMap, BTreeSet};

/// Where a composed prim has opinions, strongest first.
#[derive(Clone)]
pub(super) struct Sites(pub(super) Vec<Site>);

/// A layer and a place in it.
#[derive(Clone)]
pub(super) struct Site {
    /// Identifier of the layer.
    pub(super) layer: String,
    pub(super) path: sdf::Path,
    /// Stage time = offset applied to layer time.
    pub(super) offset: LayerOffset,
}

/// A site with its layer borrowed from the stage; no layer may be loaded while one lives.
struct Opinions<'a> {
    site: &'a Site,
    layer: Ref<'a, sdf::Layer>,
}

/// What can go wrong: a message without the layer, and the layer.
pub(super) struct Fault {
    pub(super) layer: String,
    pub(super) message: String,
}

impl Fault {
    fn new(layer: &str, message: impl ToString) -> Self {
        Self {
            layer: layer.to_owned(),
            message: message.to_string(),
        }
    }
}

impl Sites {
    /// The sites of the prim at `path`.
    pub(super) fn of(stage: &Stage, path: &sdf::Path) -> anyhow::Result<Self> {
        let index = stage.prim_index(path.clone()).graph()?;
        anyhow::ensure!(
            !children_run_in_circles(stage, &index, path),
            "the inherits and specializes that reach <{path}> run in circles below it"
        );
        let mut sites = Vec::new();
        for node in index.nodes().filter(|node| node.has_specs()) {
            let arc = node.map_to_root().time_offset();
            for (id, sublayer) in stage.node_layer_stack(node) {
                let Some(layer) = stage.layer_identifier(id) else {
                    continue;
                };
                let authored = stage
                    .layer(&layer)
                    .is_some_and(|layer| layer.data().has_spec(node.path()));
                if authored {
                    sites.push(Site {
                        layer,
                        path: node.path().clone(),
                        offset: arc.concatenate(&sublayer),
                    });
                }
            }
        }
        Ok(Self(sites))
    }

    /// The strongest opinion of the prim's `field`.
    pub(super) fn prim_field(
        &self,
        stage: &Stage,
        field: &str,
    ) -> Result<Option<sdf::Value>, Fault> {
        for opinions in self.borrow(stage) {
            if let Some(value) = opinions.field(&opinions.site.path, field)? {
                return Ok(Some(value.into_owned()));
            }
        }
        Ok(None)
    }

    /// References to MaterialX documents, strongest first. `files` finds them.
    pub(super) fn materialx(
        &self,
        stage: &Stage,
        files: &LayerFiles,
    ) -> Result<Vec<MaterialxReference>, Fault> {
        let mut found = Vec::new();
        for opinions in self.borrow(stage) {
            for field in [FieldKey::References, FieldKey::Payload] {
                let Some(value) = opinions.field(&opinions.site.path, field.as_str())? else {
                    continue;
                };
                for (asset, target) in documents(&value) {
                    let resolved = files.resolve_value(&asset, &opinions.site.layer);
                    let file = if resolved.is_empty() { asset } else { resolved };
                    let file = file.into();
                    found.push(MaterialxReference { file, target });
                }
            }
        }
        Ok(found)
    }

    /// `inactiveIds`, every site's edits applied to those of the weaker ones.
    pub(super) fn inactive_ids(&self, stage: &Stage) -> Result<Vec<i64>, Fault> {
        let mut edits = Vec::new();
        for opinions in self.borrow(stage) {
            let value = opinions.field(&opinions.site.path, "inactiveIds")?;
            match value.as_deref() {
                Some(sdf::Value::Int64ListOp(edit)) => edits.push(edit.clone()),
                // what the crate's parser of text makes of a plain list
                Some(sdf::Value::Int64Vec(ids)) => {
                    edits.push(sdf::Int64ListOp::explicit(ids.iter().copied()));
                }
                Some(_) => {
                    return Err(Fault::new(
                        &opinions.site.layer,
                        "inactiveIds is no list of integers",
                    ));
                }
                None => {}
            }
        }
        let weakest_first = edits.iter().rev();
        Ok(weakest_first.fold(Vec::new(), |ids, edit| edit.compose_over(&ids)))
    }

    /// Variant sets of the prim, each with its variants.
    pub(super) fn variants(&self, stage: &Stage) -> BTreeMap<String, BTreeSet<String>> {
        let mut found: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for opinions in self.borrow(stage) {
            let names = |path: &sdf::Path, field: ChildrenKey| {
                let value = opinions.data().try_field(path, field.as_str());
                match value.ok().flatten().as_deref() {
                    Some(sdf::Value::TokenVec(names)) => {
                        names.iter().map(ToString::to_string).collect()
                    }
                    _ => Vec::new(),
                }
            };
            let path = &opinions.site.path;
            for set in names(path, ChildrenKey::VariantSetChildren) {
                let at = path.append_variant_selection(&set, "");
                let variants = names(&at, ChildrenKey::VariantChildren);
                found.entry(set).or_default().extend(variants);
            }
        }
        found
    }

    /// Names of the properties that any site has, sorted.
    pub(super) fn property_names(&self, stage: &Stage) -> Result<Vec<String>, Fault> {
        let mut names = BTreeSet::new();
        for opinions in self.borrow(stage) {
            let field = ChildrenKey::PropertyChildren.as_str();
            if let Some(sdf::Value::TokenVec(found)) =
                opinions.field(&opinions.site.path, field)?.as_deref()
            {
                names.extend(found.iter().map(ToString::to_string));
            }
        }
        Ok(names.into_iter().collect())
    }

    /// True if any site has `field`.
    pub(super) fn has_prim_field(&self, stage: &Stage, field: &str) -> bool {
        self.borrow(stage)
            .any(|opinions| opinions.layer.data().has_field(&opinions.site.path, field))
    }

    fn borrow<'a>(&'a self, stage: &'a Stage) -> impl Iterator<Item = Opinions<'a>> {
        self.0.iter().filter_map(|site| {
            let layer = stage.layer(&site.layer)?;
            Some(Opinions { site, layer })
        })
    }
}

impl Opinions<'_> {
    /// `value` in stage time, if it is a time.
    fn retimed(&self, value: Value, type_name: &str) -> Value {
        match value {
            Value::Float(time) if type_name == "timecode" => {
                Value::Float(self.site.offset.apply(time))
            }
            other => other,
        }
    }

    fn data(&self) -> &dyn AbstractData {
        self.layer.data()
    }

    fn field(
        &self,
        path: &sdf::Path,
        field: &str,
    ) -> Result<Option<std::borrow::Cow<'_, sdf::Value>>, Fault> {
        self.data().try_field(path, field).map_err(|error| {
            let error = anyhow::Error::new(error);
            Fault::new(&self.site.layer, format!("{error:#}"))
        })
    }
}

/// Reads the properties of prims of one stage for one request.
pub(super) struct Properties<'a> {
    stage: &'a Stage,
    files: &'a LayerFiles,
    request: &'a Request,
    /// The attributes whose values are not to be read.
    without_value: Request,
}

/// A property's specs, strongest first.
type Specs<'a> = Vec<(&'a Opinions<'a>, sdf::Path)>;

impl<'a> Properties<'a> {
    pub(super) fn new(stage: &'a Stage, files: &'a LayerFiles, request: &'a Request) -> Self {
        let without_value = Request {
            attributes: request.values_not_needed.clone(),
            ..request.clone()
        };
        Self {
            stage,
            files,
            request,
            without_value,
        }
    }

    /// Fill `prim` with the properties at `path`. `clips`: value clips are in reach of it.
    pub(super) fn read(
        &self,
        path: &sdf::Path,
        sites: &Sites,
        clips: bool,
        prim: &mut RawPrim,
    ) -> Result<(), Fault> {
        let names = self.stage.prim(path.clone()).property_names();
        let names = names.map_err(|error| sites.fault(&error))?;
        let names: Vec<&str> = names.iter().map(|name| name.as_str()).collect();
        self.read_named(&names, path, sites, prim)?;
        if clips {
            self.clipped(path, sites, prim)?;
        }
        Ok(())
    }

    /// Fill `prim` with its properties `names`, but for what value clips say.
    pub(super) fn read_named(
        &self,
        names: &[&str],
        path: &sdf::Path,
        sites: &Sites,
        prim: &mut RawPrim,
    ) -> Result<(), Fault> {
        let moves = self.request.time.is_some()
            && prim.type_name == "PointInstancer"
            && names.iter().any(|name| MOVERS.contains(name));
        let is_moved = |name: &str| moves && MOVED.contains(&name);
        let mut connected = Vec::new();
        {
            let opinions: Vec<Opinions<'_>> = sites.borrow(self.stage).collect();
            for &name in names {
                let specs = specs(&opinions, name)?;
                let Some((strongest, at)) = specs.first() else {
                    continue;
                };
                match strongest.data().spec_type(at) {
                    Some(SpecType::Relationship) => {
                        let bind_material_as = token(&specs, "bindMaterialAs")?;
                        let relationship = RawRelationship {
                            targets: Vec::new(),
                            bind_material_as,
                        };
                        prim.relationships.insert(name.to_string(), relationship);
                    }
                    Some(SpecType::Attribute) if self.request.wants(name) || is_moved(name) => {
                        let mut attribute = self.attribute(name, &specs)?;
                        if is_moved(name) {
                            attribute.held = self.held(&specs, &attribute.type_name)?;
                        }
                        if specs.iter().any(|(o, at)| {
                            o.data().has_field(at, FieldKey::ConnectionPaths.as_str())
                        }) {
                            connected.push(name.to_string());
                        }
                        prim.attributes.insert(name.to_string(), attribute);
                    }
                    _ => prim.unread.push(name.to_string()),
                }
            }
        }
        prim.attributes.shrink_to_fit();
        self.targets(path, sites, &connected, prim)
    }

    /// Targets and connections; apart from the rest because composing them may load layers.
    fn targets(
        &self,
        path: &sdf::Path,
        sites: &Sites,
        connected: &[String],
        prim: &mut RawPrim,
    ) -> Result<(), Fault> {
        for (name, relationship) in &mut prim.relationships {
            let handle = self.stage.prim(path.clone()).relationship(name.as_str());
            let targets = handle.targets().map_err(|error| sites.fault(&error))?;
            relationship.targets = targets.iter().map(ToString::to_string).collect();
        }
        for name in connected {
            let handle = self.stage.prim(path.clone()).attribute(name.as_str());
            let connections = handle.connections().map_err(|error| sites.fault(&error))?;
            if let Some(attribute) = prim.attributes.get_mut(name) {
                attribute.connections = connections.iter().map(ToString::to_string).collect();
            }
        }
        Ok(())
    }

    fn attribute(&self, name: &str, specs: &Specs<'_>) -> Result<RawAttribute, Fault> {
        let mut attribute = RawAttribute {
            type_name: token(specs, FieldKey::TypeName.as_str())?.unwrap_or_default(),
            interpolation: token(specs, "interpolation")?,
            element_size: match strongest(specs, "elementSize")? {
                Some(sdf::Value::Int(size)) => Some(size),
                Some(sdf::Value::Int64(size)) => i32::try_from(size).ok(),
                _ => None,
            },
            weight: match (name.starts_with("inbetweens:"), strongest(specs, "weight")?) {
                (true, Some(weight)) => convert::float(&weight),
                _ => None,
            },
            color_space: token(specs, FieldKey::ColorSpace.as_str())?,
            ..RawAttribute::default()
        };
        if !self.without_value.wants(name) {
            self.value(specs, &mut attribute)?;
        }
        Ok(attribute)
    }

    /// Value and `varying`. At a time the first site with samples or a default decides; without, the first default.
    fn value(&self, specs: &Specs<'_>, attribute: &mut RawAttribute) -> Result<(), Fault> {
        let (mut decided, mut is_sampled) = (false, false);
        for (opinions, at) in specs {
            let resolve = |authored: &str| self.files.resolve_value(authored, &opinions.site.layer);
            if !decided
                && opinions
                    .data()
                    .has_field(at, FieldKey::TimeSamples.as_str())
            {
                let samples = opinions.field(at, FieldKey::TimeSamples.as_str())?;
                if let Some(sdf::Value::TimeSamples(samples)) = samples.as_deref() {
                    decided = true;
                    is_sampled = !samples.is_empty();
                    attribute.varying = samples.len() > 1;
                    if let Some(time) = self.request.time {
                        let samples = Samples {
                            samples,
                            type_name: &attribute.type_name,
                            resolve: &resolve,
                        };
                        let value = samples.at(opinions.site.offset.inverse().apply(time));
                        attribute.value =
                            value.map(|value| opinions.retimed(value, &attribute.type_name));
                        return Ok(());
                    }
                }
            }
            if !decided && self.request.time.is_some() && opinions.data().has_field(at, "spline") {
                return Err(Fault::new(
                    &opinions.site.layer,
                    format!("{at} is a spline, which is not supported"),
                ));
            }
            if let Some(default) = opinions.field(at, FieldKey::Default.as_str())? {
                let value = convert::value_of(default, &resolve);
                attribute.value = value.map(|value| opinions.retimed(value, &attribute.type_name));
                return Ok(());
            }
        }
        attribute.varying |= is_sampled;
        Ok(())
    }

    /// What the samples hold at the time; `None` where a default decides, or the default time is asked for.
    fn held(&self, specs: &Specs<'_>, type_name: &str) -> Result<Option<Box<Sample>>, Fault> {
        let Some(time) = self.request.time else {
            return Ok(None);
        };
        for (opinions, at) in specs {
            let resolve = |authored: &str| self.files.resolve_value(authored, &opinions.site.layer);
            let samples = opinions.field(at, FieldKey::TimeSamples.as_str())?;
            if let Some(sdf::Value::TimeSamples(samples)) = samples.as_deref() {
                let samples = Samples {
                    samples,
                    type_name,
                    resolve: &resolve,
                };
                let offset = &opinions.site.offset;
                let held = samples.held(offset.inverse().apply(time));
                let sample = held.map(|(time, value)| Sample {
                    time: offset.apply(time),
                    value,
                });
                return Ok(sample.map(Box::new));
            }
            if opinions.data().has_field(at, FieldKey::Default.as_str()) {
                break;
            }
        }
        Ok(None)
    }

    /// Values in reach of value clips: the crate knows them at their samples' times; between, as for any samples.
    /// (The crate interpolates within one clip, Pixar from the last sample of one to the first of the next.)
    fn clipped(&self, path: &sdf::Path, sites: &Sites, prim: &mut RawPrim) -> Result<(), Fault> {
        for (name, attribute) in &mut prim.attributes {
            if !self.without_value.wants(name) {
                let handle = self.stage.prim(path.clone()).attribute(name.as_str());
                let read = self.clip(&handle, sites, attribute);
                read.map_err(|error| sites.fault(&error))?;
            }
        }
        Ok(())
    }

    fn clip(
        &self,
        handle: &Attribute,
        sites: &Sites,
        attribute: &mut RawAttribute,
    ) -> anyhow::Result<()> {
        attribute.varying = handle.value_might_be_time_varying()?;
        attribute.held = None;
        let Some(time) = self.request.time else {
            return Ok(());
        };
        let (before, after) = handle
            .bracketing_time_samples(time)?
            .unwrap_or((time, time));
        let mut samples = Vec::new();
        for at in [before, after] {
            let value = handle.get_at::<sdf::Value>(TimeCode::new(at))?;
            samples.push((at, value.unwrap_or(sdf::Value::ValueBlock)));
        }
        let layer = sites.0.first().map_or("", |site| site.layer.as_str());
        let samples = Samples {
            samples: &samples,
            type_name: &attribute.type_name,
            resolve: &|authored: &str| self.files.resolve_value(authored, layer),
        };
        attribute.value = samples.at(time);
        Ok(())
    }
}

/// MaterialX documents and targets that a field of references or payloads names.
fn documents(value: &sdf::Value) -> Vec<(String, String)> {
    let (mut all, is_document) = (Vec::new(), |asset: &str| materialx::is_document(asset));
    let mut add = |asset: &str, prim: &sdf::Path| {
        if is_document(asset) {
            all.push((asset.to_owned(), prim.to_string()));
        }
    };
    match value {
        sdf::Value::ReferenceListOp(list) => {
            added(list).for_each(|item| add(&item.asset_path, &item.prim_path));
        }
        sdf::Value::PayloadListOp(list) => {
            added(list).for_each(|item| add(&item.asset_path, &item.prim_path));
        }
        sdf::Value::Payload(item) => add(&item.asset_path, &item.prim_path),
        _ => {}
    }
    all
}

/// What `list` adds, in whichever way.
fn added<T: Default + Clone + PartialEq>(list: &sdf::ListOp<T>) -> impl Iterator<Item = &T> {
    let lists = [
        &list.explicit_items,
        &list.prepended_items,
        &list.added_items,
        &list.appended_items,
    ];
    lists.into_iter().flatten()
}

impl Sites {
    /// `error`, laid at the strongest layer's door: the crate does not say whose it is.
    pub(super) fn fault(&self, error: &anyhow::Error) -> Fault {
        let layer = self.0.first().map_or("", |site| site.layer.as_str());
        Fault::new(layer, format!("{error:#}"))
    }
}

/// What instances must have in common to share a prototype: the sites that arcs on the instance itself bring in
/// (`Pcp_InstanceKey`). The crate's own key includes variants of the instance's ancestors, and so shares too little.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct InstanceKey(Vec<(ArcType, LayerId, String, u64, u64)>);

impl InstanceKey {
    /// The key of the instance at `path`.
    pub(super) fn of(stage: &Stage, path: &sdf::Path) -> anyhow::Result<Self> {
        let index = stage.prim_index(path.clone()).graph()?;
        let nodes = index
            .nodes()
            .filter(|node| node.has_specs() && is_own(&index, node));
        let parts = nodes.map(|node| {
            let offset = node.map_to_root().time_offset();
            let (layer, path) = (node.layer_id(), node.path().to_string());
            (
                node.arc(),
                layer,
                path,
                offset.offset.to_bits(),
                offset.scale.to_bits(),
            )
        });
        Ok(Self(parts.collect()))
    }
}

/// True if an arc of the prim itself, not of an ancestor, brings `node` in. (Below the pseudo-root the instance's own
/// site hangs on an arc too: instances at the top of a stage differ in it and share nonetheless.)
fn is_own(index: &PrimIndex, node: &Node) -> bool {
    let mut at = Some(node);
    while let Some(node) = at {
        let parent = node.parent().filter(|_| node.arc() != ArcType::Root);
        let parent = parent.map(|parent| index.node(parent));
        if parent.is_some_and(|parent| {
            parent.path().prim_element_count() <= usize::from(node.namespace_depth())
        }) {
            return true;
        }
        at = parent;
    }
    false
}

fn specs<'a>(opinions: &'a [Opinions<'a>], name: &str) -> Result<Specs<'a>, Fault> {
    let mut specs = Vec::new();
    for opinion in opinions {
        let at = opinion.site.path.append_property(name);
        let at = at.map_err(|error| Fault::new(&opinion.site.layer, format!("{error:#}")))?;
        if opinion.data().has_spec(&at) {
            specs.push((opinion, at));
        }
    }
    Ok(specs)
}

fn strongest(specs: &Specs<'_>, field: &str) -> Result<Option<sdf::Value>, Fault> {
    for (opinions, at) in specs {
        if let Some(value) = opinions.field(at, field)? {
            return Ok(Some(value.into_owned()));
        }
    }
    Ok(None)
}

fn token(specs: &Specs<'_>, field: &str) -> Result<Option<String>, Fault> {
    Ok(strongest(specs, field)?.and_then(text))
}

/// The text of a token or string.
pub(super) fn text(value: sdf::Value) -> Option<String> {
    match value {
        sdf::Value::Token(token) => Some(token.as_str().to_owned()),
        sdf::Value::String(string) => Some(string),
        _ => None,
    }
}
