//! The composed stage → [`RawStage`]: its prims depth first, then each prototype once.

use super::OTHER_DOOR;
use super::ahead::Ahead;
use super::instance_key::InstanceKey;
use super::kept::Walked;
use super::layer_files::{EMPTY_SESSION, LayerFiles};
use super::properties::Properties;
use super::sites::{Fault, Sites};
use super::specs::text;
use super::twins::{Siblings, Sole, Twin};
use crate::diagnostics::{CancelToken, Cancelled, Warning};
use crate::stage::raw::{PrimCommon, RawMeta, RawPrim, RawStage, ReadCounts, Request};
use crate::stage::{Error, Load};
use openusd::sdf::{self, FieldKey};
use openusd::usd::{ClipsAPI, Stage};
use std::cell::RefCell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

/// One walk over a stage.
pub(super) struct Traversal<'a> {
    stage: &'a Stage,
    properties: Properties<'a>,
    files: &'a LayerFiles,
    request: &'a Request,
    cancel: &'a CancelToken,
    prims: Vec<RawPrim>,
    /// Prototype roots in the order they were met, and the index each will have in `prims`.
    prototypes: Vec<sdf::Path>,
    /// Instances met (index in `prims`) with the prototype they need (index in `prototypes`).
    instances: Vec<(usize, usize)>,
    numbers: HashMap<InstanceKey, usize>,
    warnings: Vec<Warning>,
    /// Prims whose payloads are not loaded.
    unloaded: Vec<String>,
    ahead: Ahead<'a>,
    /// Prims in reach of value clips.
    clipped: Vec<usize>,
    /// Prims beside each other may be composed as one.
    finds_twins: bool,
}

/// A prim still to be visited.
struct Pending {
    path: sdf::Path,
    parent: Option<usize>,
    /// An ancestor has value clips.
    clips: bool,
    /// A prototype's root: always there, whatever its specifier.
    root: bool,
    /// What it may have in common with its siblings.
    siblings: Option<Rc<RefCell<Siblings>>>,
}

impl<'a> Traversal<'a> {
    pub(super) fn new(
        stage: &'a Stage,
        files: &'a LayerFiles,
        request: &'a Request,
        cancel: &'a CancelToken,
    ) -> Self {
        let loads_payloads = request.composition.load == Load::All;
        let finds_twins = request.mask.is_empty() && loads_payloads;
        Self {
            stage,
            properties: Properties::new(stage, files, request),
            files,
            request,
            cancel,
            prims: Vec::new(),
            prototypes: Vec::new(),
            instances: Vec::new(),
            numbers: HashMap::new(),
            warnings: Vec::new(),
            unloaded: Vec::new(),
            ahead: Ahead::new((stage, files), cancel, (finds_twins, loads_payloads)),
            clipped: Vec::new(),
            finds_twins,
        }
    }

    /// Every prim is composed by itself, so that every error is found at every prim that has it.
    pub(super) fn without_twins(self) -> Self {
        Self {
            finds_twins: false,
            ahead: self.ahead.without_twins(),
            ..self
        }
    }

    /// Walk the stage of the root layer `root`.
    ///
    /// # Errors
    /// Layers that cannot be read, features that are not supported, cancellation.
    pub(super) fn run(mut self, root: &Path) -> Result<Walked, Error> {
        let roots = self.stage.root_prims().map_err(|error| Error::Layer {
            path: root.to_owned(),
            message: format!("{error:#}; {OTHER_DOOR}"),
        })?;
        let pending = roots.iter().rev().filter_map(|name| {
            let path = sdf::Path::abs_root().append_path(name.as_str()).ok()?;
            Some(Pending {
                path,
                parent: None,
                clips: false,
                root: false,
                siblings: None,
            })
        });
        let pending = pending.collect();
        self.walk(pending)?;
        let prototype_start = self.prims.len();
        let roots = self.walk_prototypes()?;
        self.point_to(&roots);
        let mut meta = meta(self.stage, root)?;
        let attributes = self.prims.iter().flat_map(|prim| prim.attributes.values());
        for attribute in attributes {
            meta.read.add(attribute.value.as_ref());
        }
        let raw = RawStage {
            meta: RawMeta {
                unloaded: self.unloaded,
                ..meta
            },
            prims: self.prims,
            prototype_start,
        };
        Ok(Walked {
            raw,
            warnings: self.warnings,
            clipped: self.clipped,
        })
    }

    /// Tell every instance its prototype, of which `roots` has the places. What instances have in common stays so.
    fn point_to(&mut self, roots: &[usize]) {
        let mut pointed = HashMap::new();
        for &(instance, prototype) in &self.instances {
            let prim = &mut self.prims[instance];
            let before = Arc::clone(prim.common());
            let key = (Arc::as_ptr(&before), prototype);
            let (_, after) = pointed.entry(key).or_insert_with(|| {
                let mut after = PrimCommon::clone(&before);
                after.prototype = Some(roots[prototype]);
                // the one before is kept too, so that no two of them are ever at one address
                (before, Arc::new(after))
            });
            prim.set_common(Arc::clone(after));
        }
    }

    /// Walk every prototype, those met on the way too; the index of each one's root.
    fn walk_prototypes(&mut self) -> Result<Vec<usize>, Error> {
        let mut roots = Vec::new();
        while let Some(path) = self.prototypes.get(roots.len()).cloned() {
            if self.ahead.is_due() {
                self.ahead.compose(self.prototypes[roots.len()..].to_vec());
            }
            roots.push(self.prims.len());
            self.walk(vec![Pending {
                path,
                parent: None,
                clips: false,
                root: true,
                siblings: None,
            }])?;
        }
        Ok(roots)
    }

    fn walk(&mut self, mut pending: Vec<Pending>) -> Result<(), Error> {
        while let Some(next) = pending.pop() {
            if self.cancel.is_cancelled() {
                return Err(Cancelled.into());
            }
            let children = self.visit(&next).map_err(refused)?;
            pending.extend(children.into_iter().rev());
            if self.ahead.is_due() {
                let paths = pending.iter().map(|next| next.path.clone());
                self.ahead.compose(paths.collect());
            }
        }
        Ok(())
    }

    /// Add the prim, if it is to be seen, and return its children.
    fn visit(&mut self, next: &Pending) -> Result<Vec<Pending>, Fault> {
        let siblings = next.siblings.as_ref();
        if siblings.is_some_and(|siblings| self.add_tabled(next, siblings)) {
            return Ok(Vec::new());
        }
        let mut sole = siblings.and_then(|all| all.borrow().sole(self.stage, &next.path));
        if let (Some(siblings), Some(own)) = (siblings, sole.take()) {
            let twin = siblings.borrow_mut().twin(&own);
            match twin {
                Some(twin) => return self.add_twin(next, own, &twin),
                None => sole = Some(own),
            }
        }
        self.files.pulse().prim(&next.path);
        let sites = Sites::of(self.stage, &next.path).map_err(|error| Fault {
            layer: self.stage.root_layer().identifier().to_owned(),
            message: format!("{}: {error:#}", next.path),
        })?;
        if !self.is_seen(next, &sites)? {
            return Ok(Vec::new());
        }
        let handle = self.stage.prim(next.path.clone());
        if self.request.composition.load == Load::None
            && !handle.is_loaded().map_err(|error| sites.fault(&error))?
        {
            self.unloaded.push(next.path.to_string());
            return Ok(Vec::new());
        }
        let own_clips = sites.has_prim_field(self.stage, FieldKey::Clips.as_str());
        if own_clips && self.request.time.is_some() {
            self.check_clips(next, &sites)?;
        }
        let clips = next.clips || own_clips;
        let index = self.prims.len();
        if clips {
            self.clipped.push(index);
        }
        self.prims.push(self.prim(next, &sites, clips)?);
        let is_instance = handle.is_instance().map_err(|error| sites.fault(&error))?;
        if is_instance && !next.root {
            let number = self.prototype_number(&next.path);
            let number = number.map_err(|error| sites.fault(&error))?;
            self.instances.push((index, number));
            if let (Some(siblings), Some(sole)) = (siblings, sole) {
                let mut siblings = siblings.borrow_mut();
                siblings.remember(self.stage, sole, sites, (&self.prims[index], number));
            }
            return Ok(Vec::new());
        }
        let names = handle.child_names().map_err(|error| sites.fault(&error))?;
        let children = names
            .iter()
            .filter_map(|name| next.path.append_path(name.as_str()).ok());
        Ok(self.pending(children.collect(), sites, (index, clips)))
    }

    /// The prims at `paths`, children of prim `parent`, which `sites` make, with value `clips` or without.
    fn pending(
        &self,
        paths: Vec<sdf::Path>,
        sites: Sites,
        (parent, clips): (usize, bool),
    ) -> Vec<Pending> {
        let has_siblings = self.finds_twins && !clips && paths.len() > 1;
        let siblings =
            has_siblings.then(|| Siblings::new(sites, self.stage).with_count(paths.len()));
        let siblings = siblings.map(|siblings| Rc::new(RefCell::new(siblings)));
        let child = |path| Pending {
            path,
            parent: Some(parent),
            clips,
            root: false,
            siblings: siblings.clone(),
        };
        paths.into_iter().map(child).collect()
    }

    /// Add the prim, if a table of `siblings` says that it is an instance like one before, with plain attributes.
    fn add_tabled(&mut self, next: &Pending, siblings: &RefCell<Siblings>) -> bool {
        let mut siblings = siblings.borrow_mut();
        let tabled = next.path.name().and_then(|name| siblings.tabled(name));
        let Some((twin, child, table, site)) = tabled else {
            return false;
        };
        self.files.pulse().prims(1);
        let mut prim = RawPrim::new(next.path.as_str(), Arc::clone(&twin.common));
        if !self.properties.read_tabled(table, child, site, &mut prim) {
            return false;
        }
        self.instances.push((self.prims.len(), twin.number));
        self.prims.push(prim);
        true
    }

    /// Add the prim that `own` makes, an instance like `twin`.
    fn add_twin(&mut self, next: &Pending, own: Sole, twin: &Twin) -> Result<Vec<Pending>, Fault> {
        self.files.pulse().prims(1);
        let (sites, names) = twin.properties(self.stage, own)?;
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let mut prim = RawPrim::new(next.path.as_str(), Arc::clone(&twin.common));
        let properties = &self.properties;
        properties.read_named(&names, &next.path, &sites, &mut prim)?;
        self.instances.push((self.prims.len(), twin.number));
        self.prims.push(prim);
        Ok(Vec::new())
    }

    /// The prim itself. A prototype's root is bare: what it holds belongs to the instances, which have it too.
    fn prim(&self, next: &Pending, sites: &Sites, clips: bool) -> Result<RawPrim, Fault> {
        let mut prim = RawPrim::typed(next.path.as_str(), "", next.parent);
        if next.root {
            return Ok(prim);
        }
        let schemas = self.stage.prim(next.path.clone()).api_schemas();
        let schemas = schemas.map_err(|error| sites.fault(&error))?;
        prim.api_schemas = schemas.iter().map(ToString::to_string).collect();
        prim.type_name = self
            .prim_text(sites, FieldKey::TypeName)?
            .unwrap_or_default();
        prim.kind = self.prim_text(sites, FieldKey::Kind)?;
        if prim.type_name == "PointInstancer" {
            prim.inactive_ids = sites.inactive_ids(self.stage)?;
        }
        prim.materialx = sites.materialx(self.stage, self.files)?;
        self.files.pulse().values();
        self.properties.read(&next.path, sites, clips, &mut prim)?;
        self.files.pulse().prim(&next.path);
        Ok(prim)
    }

    /// Active, defined and not abstract. (Payloads are all loaded.) Ancestors have been asked before.
    fn is_seen(&self, next: &Pending, sites: &Sites) -> Result<bool, Fault> {
        if next.root {
            return Ok(true);
        }
        let active = sites.prim_field(self.stage, FieldKey::Active.as_str())?;
        if active == Some(sdf::Value::Bool(false)) {
            return Ok(false);
        }
        let specifier = self.stage.prim(next.path.clone()).specifier();
        let specifier = specifier.map_err(|error| sites.fault(&error))?;
        Ok(specifier == Some(sdf::Specifier::Def))
    }

    fn prim_text(&self, sites: &Sites, field: FieldKey) -> Result<Option<String>, Fault> {
        Ok(sites.prim_field(self.stage, field.as_str())?.and_then(text))
    }

    /// Number of the prototype of the instance at `path`. The crate is asked for one of its own only once for all that
    /// share it: it searches through all instances of a prototype for every further one.
    fn prototype_number(&mut self, path: &sdf::Path) -> anyhow::Result<usize> {
        let key = InstanceKey::of(self.stage, path)?;
        if let Some(number) = self.numbers.get(&key) {
            return Ok(*number);
        }
        let prototype = self.stage.prim(path.clone()).prototype()?;
        let prototype = prototype
            .ok_or_else(|| anyhow::anyhow!("<{path}> is an instance without a prototype"))?;
        let number = self.prototypes.len();
        self.prototypes.push(prototype);
        self.numbers.insert(key, number);
        Ok(number)
    }

    /// One plain set of value clips is read like Pixar does; of several, the crate may take the wrong one.
    fn check_clips(&self, next: &Pending, sites: &Sites) -> Result<(), Fault> {
        let sets = self.stage.prim(next.path.clone()).clip_sets();
        let sets = sets.map_err(|error| sites.fault(&error))?;
        let clips = ClipsAPI::new(&self.stage.prim(next.path.clone()));
        let mut plain = sets.len() <= 1 && !next.clips;
        for set in &sets {
            let missing = clips.interpolate_missing_clip_values(set);
            plain &= missing.map_err(|error| sites.fault(&error))? != Some(true);
        }
        if plain {
            return Ok(());
        }
        let error = anyhow::anyhow!(
            "{}: of value clips, only a single set without interpolateMissingClipValues is supported",
            next.path
        );
        Err(sites.fault(&error))
    }
}

pub(super) fn refused(fault: Fault) -> Error {
    Error::Layer {
        path: PathBuf::from(fault.layer),
        message: format!("{}; {OTHER_DOOR}", fault.message),
    }
}

fn meta(stage: &Stage, root: &Path) -> Result<RawMeta, Error> {
    let field = |name: &str| {
        stage.stage_metadata(name).map_err(|error| Error::Layer {
            path: root.to_owned(),
            message: format!("{error:#}; {OTHER_DOOR}"),
        })
    };
    let number = |name: &str| {
        Ok::<_, Error>(match field(name)? {
            Some(sdf::Value::Double(number)) => Some(number),
            Some(sdf::Value::Float(number)) => Some(f64::from(number)),
            Some(sdf::Value::Int(number)) => Some(f64::from(number)),
            #[expect(
                clippy::cast_precision_loss,
                reason = "frames and units are small numbers"
            )]
            Some(sdf::Value::Int64(number)) => Some(number as f64),
            _ => None,
        })
    };
    let word = |name: &str| Ok::<_, Error>(field(name)?.and_then(text));
    let mut layers = stage.layer_identifiers();
    layers.retain(|layer| layer != EMPTY_SESSION);
    layers.sort();
    layers.dedup();
    Ok(RawMeta {
        path: root.to_owned(),
        up_axis: word("upAxis")?,
        meters_per_unit: number("metersPerUnit")?,
        default_prim: stage.default_prim().map(|name| name.to_string()),
        start_time_code: number("startTimeCode")?.or(number("startFrame")?),
        end_time_code: number("endTimeCode")?.or(number("endFrame")?),
        time_codes_per_second: number("timeCodesPerSecond")?.or(number("framesPerSecond")?),
        render_settings_prim_path: word("renderSettingsPrimPath")?,
        layers,
        unloaded: Vec::new(),
        read: ReadCounts::default(),
        reader: "native",
    })
}
