//! The properties of one composed prim → [`RawAttribute`]s and [`RawRelationship`]s.
//!
//! A prim's opinions come from its sites: (layer, path in that layer, time offset), strongest first. Each field is
//! read from the first site that has it, so that a default in a strong layer hides time samples in a weaker one.

use super::child_table::{Child, ChildTable};
use super::convert;
use super::interpolate::Samples;
use super::layer_files::LayerFiles;
use super::sites::{Fault, Opinions, Site, Sites};
use super::specs::Specs;
use crate::stage::raw::{
    Declaration, MOVED, MOVERS, RawAttribute, RawPrim, RawRelationship, Request, Sample, Value,
};
use openusd::sdf::{self, FieldKey, SpecType};
use openusd::usd::{Attribute, Stage, TimeCode};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// Reads the properties of prims of one stage for one request.
pub(super) struct Properties<'a> {
    stage: &'a Stage,
    files: &'a LayerFiles,
    request: &'a Request,
    /// The attributes whose values are not to be read.
    without_value: Request,
    /// What the request says to the names met: there are many prims and few names.
    wanted: RefCell<HashMap<String, Wanted>>,
    /// Met last.
    declarations: RefCell<Vec<Arc<Declaration>>>,
    /// Attributes met last whose values are words.
    words: RefCell<Vec<Arc<RawAttribute>>>,
}

/// How many are looked through for one met before.
const RECENT: usize = 32;

/// What a request says to the name of an attribute.
#[derive(Debug, Clone, Copy)]
struct Wanted {
    is_listed: bool,
    has_value: bool,
}

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
            wanted: RefCell::default(),
            declarations: RefCell::default(),
            words: RefCell::default(),
        }
    }

    fn wanted(&self, name: &str) -> Wanted {
        if let Some(known) = self.wanted.borrow().get(name) {
            return *known;
        }
        let wanted = Wanted {
            is_listed: self.request.wants(name),
            has_value: !self.without_value.wants(name),
        };
        let mut all = self.wanted.borrow_mut();
        all.insert(name.to_owned(), wanted);
        wanted
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
        let (mut relationships, mut unread) = (BTreeMap::new(), Vec::new());
        {
            let opinions: Vec<Opinions<'_>> = sites.borrow(self.stage).collect();
            for &name in names {
                let specs = Specs::of(&opinions, name)?;
                if specs.is_empty() {
                    continue;
                }
                match specs.kind() {
                    Some(SpecType::Relationship) => {
                        let relationship = RawRelationship {
                            targets: Vec::new(),
                            bind_material_as: specs.token("bindMaterialAs")?,
                        };
                        relationships.insert(name.to_string(), relationship);
                    }
                    Some(SpecType::Attribute) if self.wanted(name).is_listed || is_moved(name) => {
                        let mut attribute = self.attribute(name, &specs)?;
                        if is_moved(name) {
                            attribute.held = self.held(&specs, &attribute.type_name)?;
                        }
                        if specs.iter().any(|spec| spec.has(FieldKey::ConnectionPaths)) {
                            connected.push(name.to_string());
                        }
                        prim.attributes.insert_shared(self.shared(name, attribute));
                    }
                    _ => unread.push(name.to_string()),
                }
            }
        }
        prim.attributes.shrink_to_fit();
        self.targets(path, sites, &mut relationships)?;
        self.connections(path, sites, &connected, prim)?;
        set_if_other(prim, relationships, unread);
        Ok(())
    }

    /// Fill `prim` with the properties that `table` has for `child`, which only `site` makes; `false` if one of them is more
    /// than an attribute with a default.
    pub(super) fn read_tabled(
        &self,
        table: &mut ChildTable,
        child: Child,
        site: &Site,
        prim: &mut RawPrim,
    ) -> bool {
        if prim.type_name == "PointInstancer" {
            return false;
        }
        let resolve = |authored: &str| self.files.resolve_value(authored, &site.layer);
        let mut unread = Vec::new();
        prim.attributes.reserve_exact(child.properties.len());
        for place in child.properties {
            if let Some(known) = table.known(place) {
                prim.attributes.insert_shared(known);
                continue;
            }
            let wanted = self.wanted(table.property_name(place));
            let Some(plain) = table.attribute(place, wanted.is_listed && wanted.has_value) else {
                return false;
            };
            let name = table.property_name(place);
            if !wanted.is_listed {
                unread.push(name.to_owned());
                continue;
            }
            let type_name = plain.type_name.as_ref().map_or("", |word| word.as_str());
            let declaration = self.declaration(name, type_name);
            let default = plain.default.map(Cow::Owned);
            let value = default.and_then(|default| convert::value_of(default, &resolve));
            let value = value.map(|value| site.retimed(value, type_name));
            let attribute = Arc::new(RawAttribute::new(declaration, value));
            if plain.is_word {
                table.remember(place, &attribute);
            }
            prim.attributes.insert_shared(attribute);
        }
        prim.attributes.shrink_to_fit();
        set_if_other(prim, BTreeMap::new(), unread);
        true
    }

    /// What attributes `name` of the type `type_name` have in common if they have nothing else.
    fn declaration(&self, name: &str, type_name: &str) -> Arc<Declaration> {
        let is_it = |known: &Declaration| {
            known.name == name && known.type_name == type_name && known.is_plain()
        };
        recent(&self.declarations, is_it, || {
            Declaration::plain(name, type_name)
        })
    }

    /// `attribute`, called `name`, sharing with those before what it has alike: all, where the value is made of words.
    fn shared(&self, name: &str, mut attribute: RawAttribute) -> Arc<RawAttribute> {
        attribute.name = name.to_owned();
        let declaration = Arc::clone(attribute.declaration());
        let is_it = |known: &Declaration| *known == *declaration;
        let declaration = recent(&self.declarations, is_it, || {
            Declaration::clone(&declaration)
        });
        let attribute = RawAttribute::new(declaration, attribute.value);
        match attribute.value {
            None | Some(Value::Token(_) | Value::TokenArray(_) | Value::Bool(_)) => {
                let is_it = |known: &RawAttribute| *known == attribute;
                recent(&self.words, is_it, || attribute.clone())
            }
            _ => Arc::new(attribute),
        }
    }

    /// Targets; apart from the rest because composing them may load layers.
    fn targets(
        &self,
        path: &sdf::Path,
        sites: &Sites,
        relationships: &mut BTreeMap<String, RawRelationship>,
    ) -> Result<(), Fault> {
        for (name, relationship) in relationships {
            let handle = self.stage.prim(path.clone()).relationship(name.as_str());
            let targets = handle.targets().map_err(|error| sites.fault(&error))?;
            relationship.targets = targets.iter().map(ToString::to_string).collect();
        }
        Ok(())
    }

    /// Connections, as [`Self::targets`].
    fn connections(
        &self,
        path: &sdf::Path,
        sites: &Sites,
        connected: &[String],
        prim: &mut RawPrim,
    ) -> Result<(), Fault> {
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
        let weight = match name.starts_with("inbetweens:") {
            true => specs.strongest("weight")?,
            false => None,
        };
        let declaration = Declaration {
            type_name: specs
                .token(FieldKey::TypeName.as_str())?
                .unwrap_or_default(),
            interpolation: specs.token("interpolation")?,
            element_size: match specs.strongest("elementSize")? {
                Some(sdf::Value::Int(size)) => Some(size),
                Some(sdf::Value::Int64(size)) => i32::try_from(size).ok(),
                _ => None,
            },
            weight: weight.as_ref().and_then(convert::float),
            color_space: specs.token(FieldKey::ColorSpace.as_str())?,
            ..Declaration::default()
        };
        let mut attribute = RawAttribute::new(declaration, None);
        if self.wanted(name).has_value {
            self.value(specs, &mut attribute)?;
        }
        Ok(attribute)
    }

    /// Value and `varying`. At a time the first site with samples or a default decides; without, the first default.
    fn value(&self, specs: &Specs<'_>, attribute: &mut RawAttribute) -> Result<(), Fault> {
        let (mut decided, mut is_sampled) = (false, false);
        for spec in specs.iter() {
            let site = spec.opinions.site;
            let resolve = |authored: &str| self.files.resolve_value(authored, &site.layer);
            if !decided && spec.has(FieldKey::TimeSamples) {
                let samples = spec.field(FieldKey::TimeSamples.as_str())?;
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
                        let value = samples.at(site.offset.inverse().apply(time));
                        attribute.value =
                            value.map(|value| site.retimed(value, &attribute.type_name));
                        return Ok(());
                    }
                }
            }
            if !decided && self.request.time.is_some() && spec.has_spline() {
                return Err(Fault::new(
                    &site.layer,
                    format!("{} is a spline, which is not supported", spec.at),
                ));
            }
            if let Some(default) = spec.field(FieldKey::Default.as_str())? {
                let default = self.files.long_arrays().restored(default);
                let default =
                    default.map_err(|error| Fault::new(&site.layer, format!("{error:#}")))?;
                let value = convert::value_of(default, &resolve);
                attribute.value = value.map(|value| site.retimed(value, &attribute.type_name));
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
        for spec in specs.iter() {
            let site = spec.opinions.site;
            let resolve = |authored: &str| self.files.resolve_value(authored, &site.layer);
            let samples = spec.field(FieldKey::TimeSamples.as_str())?;
            if let Some(sdf::Value::TimeSamples(samples)) = samples.as_deref() {
                let samples = Samples {
                    samples,
                    type_name,
                    resolve: &resolve,
                };
                let offset = &site.offset;
                let held = samples.held(offset.inverse().apply(time));
                let sample = held.map(|(time, value)| Sample {
                    time: offset.apply(time),
                    value,
                });
                return Ok(sample.map(Box::new));
            }
            if spec.has(FieldKey::Default) {
                break;
            }
        }
        Ok(None)
    }

    /// Values in reach of value clips: the crate knows them at their samples' times; between, as for any samples.
    /// (The crate interpolates within one clip, Pixar from the last sample of one to the first of the next.)
    fn clipped(&self, path: &sdf::Path, sites: &Sites, prim: &mut RawPrim) -> Result<(), Fault> {
        let names: Vec<String> = prim.attributes.keys().cloned().collect();
        for name in names {
            let attribute = prim.attributes.get_mut(&name);
            if let Some(attribute) = attribute.filter(|_| self.wanted(&name).has_value) {
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
            let value = Cow::Owned(value.unwrap_or(sdf::Value::ValueBlock));
            let value = self.files.long_arrays().restored(value)?;
            samples.push((at, value.into_owned()));
        }
        let layer = sites.0.first().map_or("", |site| &site.layer);
        let samples = Samples {
            samples: &samples,
            type_name: &attribute.type_name,
            resolve: &|authored: &str| self.files.resolve_value(authored, layer),
        };
        attribute.value = samples.at(time);
        Ok(())
    }
}

/// `prim` has these relationships and unread attributes; it goes on sharing them with others that have the same.
fn set_if_other(
    prim: &mut RawPrim,
    relationships: BTreeMap<String, RawRelationship>,
    unread: Vec<String>,
) {
    if prim.relationships != relationships {
        prim.relationships = relationships;
    }
    if prim.unread != unread {
        prim.unread = unread;
    }
}

/// The one of those `met` that `is_it`, or `new`, which is met then.
fn recent<T>(
    met: &RefCell<Vec<Arc<T>>>,
    is_it: impl Fn(&T) -> bool,
    new: impl FnOnce() -> T,
) -> Arc<T> {
    let mut met = met.borrow_mut();
    if let Some(known) = met.iter().find(|known| is_it(known)) {
        return Arc::clone(known);
    }
    let new = Arc::new(new());
    met.truncate(RECENT - 1);
    met.insert(0, Arc::clone(&new));
    new
}
