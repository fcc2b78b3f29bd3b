//! Instances beside each other that one layer alone makes, and makes alike, are composed once.
//!
//! The crate takes some 20 µs and 8 KB for every prim it composes. What an instance without children of its own is
//! composed of depends on its one spec and on nothing else, as long as its name occurs at no other site of its parent:
//! the next one with an equal spec has the same sites, its own apart, and the same prototype.

use super::properties::{Site, Sites};
use super::twin_keys::{ByKey, Key};
use crate::stage::raw::RawPrim;
use openusd::sdf::{self, AbstractData, ChildrenKey, FieldKey};
use openusd::usd::Stage;
use std::rc::Rc;

/// Fields of a prim spec that compose nothing.
const IDLE: [&str; 8] = [
    "assetInfo",
    "comment",
    "customData",
    "displayName",
    "documentation",
    "hidden",
    "properties",
    "propertyOrder",
];

/// What one parent's children have in common.
pub(super) struct Siblings {
    sites: Vec<Site>,
    /// By all fields that compose.
    known: ByKey<Rc<Twin>>,
    /// What [`Self::is_new`] was asked of.
    met: ByKey<()>,
}

/// The one spec that makes a prim.
pub(super) struct Sole {
    own: Site,
    key: Key,
}

/// An instance that was composed.
pub(super) struct Twin {
    sites: Sites,
    /// Place of its own spec among `sites`.
    own: usize,
    /// Without properties.
    pub(super) prim: RawPrim,
    /// Of its prototype.
    pub(super) number: usize,
}

impl Siblings {
    /// Of the children of the prim at `sites`.
    pub(super) fn new(sites: Sites, stage: &Stage) -> Self {
        let is_moved = sites.0.iter().any(|site| {
            let layer = stage.layer(&site.layer);
            let root = sdf::Path::abs_root();
            layer.is_none_or(|layer| {
                layer
                    .data()
                    .has_field(&root, FieldKey::LayerRelocates.as_str())
                    || layer
                        .data()
                        .has_field(&site.path, FieldKey::Relocates.as_str())
            })
        });
        let sites = if is_moved { Vec::new() } else { sites.0 };
        Self {
            sites,
            known: ByKey::default(),
            met: ByKey::default(),
        }
    }

    /// The spec that makes the child at `path`, if it is the only one and makes an instance that has nothing of its own
    /// but attributes.
    pub(super) fn sole(&self, stage: &Stage, path: &sdf::Path) -> Option<Sole> {
        let name = path.name()?;
        let mut found = None;
        for site in &self.sites {
            let at = site.path.append_path(name).ok()?;
            if stage.layer(&site.layer)?.data().has_spec(&at) {
                if found.is_some() {
                    return None;
                }
                found = Some(Site {
                    layer: site.layer.clone(),
                    path: at,
                    offset: site.offset,
                });
            }
        }
        let own = found?;
        let layer = stage.layer(&own.layer)?;
        let key = key(layer.data(), &own.path)?;
        drop(layer);
        Some(Sole { own, key })
    }

    /// False if the child at `path` composes what another one does that was asked for here.
    pub(super) fn is_new(&mut self, stage: &Stage, path: &sdf::Path) -> bool {
        let Some(sole) = self.sole(stage, path) else {
            return true;
        };
        let is_new = self.met.get(&sole.key).is_none();
        if is_new {
            self.met.insert(sole.key, ());
        }
        is_new
    }

    /// The instance composed before that `sole` makes again.
    pub(super) fn twin(&mut self, sole: &Sole) -> Option<Rc<Twin>> {
        self.known.get(&sole.key)
    }

    /// `sole` made `prim`, an instance of prototype `number`.
    pub(super) fn remember(&mut self, sole: Sole, sites: Sites, prim: &RawPrim, number: usize) {
        let own = sites
            .0
            .iter()
            .position(|site| site.layer == sole.own.layer && site.path == sole.own.path);
        let Some(own) = own else { return };
        let prim = RawPrim {
            attributes: Default::default(),
            relationships: Default::default(),
            unread: Vec::new(),
            ..prim.clone()
        };
        let twin = Twin {
            sites,
            own,
            prim,
            number,
        };
        self.known.insert(sole.key, Rc::new(twin));
    }
}

impl Twin {
    /// Sites of the instance that `sole` makes.
    pub(super) fn sites(&self, sole: Sole) -> Sites {
        let mut sites = self.sites.clone();
        sites.0[self.own] = sole.own;
        sites
    }
}

/// What an instance without children of its own has not.
const OWN: [&str; 4] = [
    ChildrenKey::PrimChildren.as_str(),
    ChildrenKey::VariantSetChildren.as_str(),
    FieldKey::Clips.as_str(),
    FieldKey::Relocates.as_str(),
];

/// Everything that the spec at `path` composes; `None` where that may depend on its name, or is no instance.
fn key(data: &dyn AbstractData, path: &sdf::Path) -> Option<Key> {
    let mut names = data.list_fields(path)?;
    let has = |name: &str| names.iter().any(|own| own == name);
    if !has(FieldKey::Instanceable.as_str()) || OWN.iter().any(|name| has(name)) {
        return None;
    }
    names.retain(|name| !IDLE.contains(&name.as_str()));
    names.sort_unstable();
    let field = |name: String| {
        let value = data.try_field(path, &name).ok().flatten()?.into_owned();
        Some((name, value))
    };
    let key: Key = names.into_iter().map(field).collect::<Option<_>>()?;
    let is = |name: &str, value| key.iter().any(|(own, of)| own == name && *of == value);
    let is_instance = is(FieldKey::Instanceable.as_str(), sdf::Value::Bool(true))
        && is(
            FieldKey::Specifier.as_str(),
            sdf::Value::Specifier(sdf::Specifier::Def),
        );
    is_instance.then_some(key)
}
