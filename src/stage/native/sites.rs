//! Where a composed prim has opinions, and what they say of the prim itself.

use super::class_cycles::children_run_in_circles;
use super::layer_files::LayerFiles;
use super::list_ops::added;
use crate::stage::materialx;
use crate::stage::raw::{MaterialxReference, Value};
use openusd::sdf::{self, AbstractData, ChildrenKey, FieldKey, LayerOffset};
use openusd::usd::Stage;
use std::cell::Ref;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

/// Where a composed prim has opinions, strongest first.
#[derive(Clone)]
pub(super) struct Sites(pub(super) Vec<Site>);

/// A layer and a place in it.
#[derive(Clone)]
pub(super) struct Site {
    /// Identifier of the layer.
    pub(super) layer: Rc<str>,
    pub(super) path: sdf::Path,
    /// Stage time = offset applied to layer time.
    pub(super) offset: LayerOffset,
}

/// A site with its layer borrowed from the stage; no layer may be loaded while one lives.
pub(super) struct Opinions<'a> {
    pub(super) site: &'a Site,
    layer: Ref<'a, sdf::Layer>,
}

/// What can go wrong: a message without the layer, and the layer.
pub(super) struct Fault {
    pub(super) layer: String,
    pub(super) message: String,
}

impl Fault {
    pub(super) fn new(layer: &str, message: impl ToString) -> Self {
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
                        layer: layer.into(),
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

    /// What each site holds.
    pub(super) fn borrow<'a>(&'a self, stage: &'a Stage) -> impl Iterator<Item = Opinions<'a>> {
        self.0.iter().filter_map(|site| {
            let layer = stage.layer(&site.layer)?;
            Some(Opinions { site, layer })
        })
    }
}

impl Site {
    /// `value` in stage time, if it is a time.
    pub(super) fn retimed(&self, value: Value, type_name: &str) -> Value {
        match value {
            Value::Float(time) if type_name == "timecode" => Value::Float(self.offset.apply(time)),
            other => other,
        }
    }
}

impl Opinions<'_> {
    /// What the layer holds.
    pub(super) fn data(&self) -> &dyn AbstractData {
        self.layer.data()
    }

    /// The value of `field` of the spec at `path` in the layer.
    ///
    /// # Errors
    /// When it cannot be decoded.
    pub(super) fn field(
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

impl Sites {
    /// `error`, laid at the strongest layer's door: the crate does not say whose it is.
    pub(super) fn fault(&self, error: &anyhow::Error) -> Fault {
        let layer = self.0.first().map_or("", |site| &site.layer);
        Fault::new(layer, format!("{error:#}"))
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
