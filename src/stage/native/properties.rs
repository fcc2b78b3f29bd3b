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
use crate::stage::raw::{MOVED, MOVERS, RawAttribute, RawPrim, RawRelationship, Request, Sample};
use openusd::sdf::{self, FieldKey, SpecType};
use openusd::usd::{Attribute, Stage, TimeCode};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::HashMap;

/// Reads the properties of prims of one stage for one request.
pub(super) struct Properties<'a> {
    stage: &'a Stage,
    files: &'a LayerFiles,
    request: &'a Request,
    /// The attributes whose values are not to be read.
    without_value: Request,
    /// What the request says to the names met: there are many prims and few names.
    wanted: RefCell<HashMap<String, Wanted>>,
}

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
                        prim.relationships.insert(name.to_string(), relationship);
                    }
                    Some(SpecType::Attribute) if self.wanted(name).is_listed || is_moved(name) => {
                        let mut attribute = self.attribute(name, &specs)?;
                        if is_moved(name) {
                            attribute.held = self.held(&specs, &attribute.type_name)?;
                        }
                        if specs.iter().any(|spec| spec.has(FieldKey::ConnectionPaths)) {
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
        for place in child.properties {
            let name = table.property_name(place).to_owned();
            let wanted = self.wanted(&name);
            let Some(plain) = table.attribute(place, wanted.is_listed && wanted.has_value) else {
                return false;
            };
            if !wanted.is_listed {
                prim.unread.push(name);
                continue;
            }
            let default = plain.default.map(Cow::Owned);
            let value = default.and_then(|default| convert::value_of(default, &resolve));
            let value = value.map(|value| site.retimed(value, &plain.type_name));
            let attribute = RawAttribute {
                type_name: plain.type_name,
                value,
                ..RawAttribute::default()
            };
            prim.attributes.insert(name, attribute);
        }
        prim.attributes.shrink_to_fit();
        true
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
        let weight = match name.starts_with("inbetweens:") {
            true => specs.strongest("weight")?,
            false => None,
        };
        let mut attribute = RawAttribute {
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
            ..RawAttribute::default()
        };
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
        for (name, attribute) in &mut prim.attributes {
            if self.wanted(name).has_value {
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
