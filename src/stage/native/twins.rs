//! Instances beside each other that one layer alone makes, and makes alike, are composed once.
//!
//! The crate takes some 20 µs and 8 KB for every prim it composes. What an instance without children of its own is
//! composed of depends on its one spec and on nothing else, as long as its name occurs at no other site of its parent:
//! the next one with an equal spec has the same sites, its own apart, and the same prototype.

use super::child_table::{Child, ChildTable};
use super::sites::{Fault, Site, Sites};
use super::twin_keys::{ByKey, Key};
use crate::stage::raw::{PrimCommon, RawPrim};
use openusd::sdf::{self, AbstractData, ChildrenKey, FieldKey};
use openusd::usd::Stage;
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::Arc;

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

/// From so many children on it pays to make a table of them: it takes a tenth of what opening the layer takes.
const MANY: usize = 1000;

/// What one parent's children have in common.
pub(super) struct Siblings {
    sites: Vec<Site>,
    /// By all fields that compose.
    known: ByKey<Rc<Twin>>,
    /// What [`Self::is_new`] was asked of.
    met: ByKey<()>,
    /// Of the only site, if that is in a binary layer and there are many children.
    table: Option<ChildTable>,
    /// By the number of their fields in the table.
    tabled: HashMap<usize, Rc<Twin>>,
}

/// The one spec that makes a prim.
pub(super) struct Sole {
    own: Site,
    key: Key,
}

/// An instance that was composed.
pub(super) struct Twin {
    /// Its sites with properties, and its own.
    sites: Sites,
    /// Place of its own among `sites`.
    own: usize,
    /// Names of the properties of the others.
    names: Vec<String>,
    /// What it has besides attributes.
    pub(super) common: Arc<PrimCommon>,
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
            table: None,
            tabled: HashMap::new(),
        }
    }

    /// There are `count` children: where these are many, they are looked up in a table.
    pub(super) fn with_count(mut self, count: usize) -> Self {
        if let [site] = &self.sites[..]
            && count > MANY
        {
            self.table = ChildTable::of(&site.layer, &site.path);
        }
        self
    }

    /// The instance composed before that the child `name` makes again, what the table has of that child, and the site that
    /// makes them all.
    pub(super) fn tabled(
        &mut self,
        name: &str,
    ) -> Option<(Rc<Twin>, Child, &mut ChildTable, &Site)> {
        let table = self.table.as_mut()?;
        let child = table.child(name)?;
        let twin = self.tabled.get(&child.fields)?;
        let is_alone = twin.sites.0.len() == 1;
        is_alone.then(|| (Rc::clone(twin), child, table, &self.sites[0]))
    }

    /// What the child `name` makes is `twin`.
    fn note(&mut self, name: Option<&str>, twin: &Rc<Twin>) {
        let child = self.table.as_mut().zip(name);
        if let Some(child) = child.and_then(|(table, name)| table.child(name)) {
            self.tabled.insert(child.fields, Rc::clone(twin));
        }
    }

    /// The spec that makes the child at `path`, if it is the only one and makes an instance that has nothing of its own
    /// but attributes.
    pub(super) fn sole(&self, stage: &Stage, path: &sdf::Path) -> Option<Sole> {
        let name = path.name()?;
        let mut found = None;
        for site in &self.sites {
            let at = site.path.append_path(name).ok()?;
            let layer = stage.layer(&site.layer)?;
            let Some(fields) = layer.data().list_fields(&at) else {
                continue;
            };
            if found.is_some() {
                return None;
            }
            let own = Site {
                layer: Rc::clone(&site.layer),
                path: at,
                offset: site.offset,
            };
            found = Some((own, fields));
        }
        let (own, fields) = found?;
        let layer = stage.layer(&own.layer)?;
        let key = key(layer.data(), &own.path, fields)?;
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
        let twin = self.known.get(&sole.key)?;
        self.note(sole.own.path.name(), &twin);
        Some(twin)
    }

    /// `sole` made `prim`, an instance of prototype `number`.
    pub(super) fn remember(
        &mut self,
        stage: &Stage,
        sole: Sole,
        Sites(sites): Sites,
        (prim, number): (&RawPrim, usize),
    ) {
        let is_own = |site: &Site| site.layer == sole.own.layer && site.path == sole.own.path;
        let has_properties = |site: &Site| {
            let layer = stage.layer(&site.layer);
            let field = ChildrenKey::PropertyChildren.as_str();
            layer.is_some_and(|layer| layer.data().has_field(&site.path, field))
        };
        let kept = |site: &Site| is_own(site) || has_properties(site);
        let sites: Vec<Site> = sites.into_iter().filter(kept).collect();
        let others = sites.iter().filter(|site| !is_own(site)).cloned();
        let names = Sites(others.collect()).property_names(stage);
        let (Some(own), Ok(names)) = (sites.iter().position(is_own), names) else {
            return;
        };
        let twin = Twin {
            sites: Sites(sites),
            own,
            names,
            common: Arc::clone(prim.common()),
            number,
        };
        let twin = Rc::new(twin);
        self.note(sole.own.path.name(), &twin);
        self.known.insert(sole.key, twin);
    }
}

impl Twin {
    /// Sites of the instance that `sole` makes, as far as they have properties, and the names of these, sorted.
    ///
    /// # Errors
    /// When they cannot be decoded.
    pub(super) fn properties(
        &self,
        stage: &Stage,
        sole: Sole,
    ) -> Result<(Sites, Vec<String>), Fault> {
        let mut own = Sites(vec![sole.own]);
        let mut names = own.property_names(stage)?;
        if self.sites.0.len() == 1 {
            return Ok((own, names));
        }
        names.extend(self.names.iter().cloned());
        names.sort_unstable();
        names.dedup();
        let mut sites = self.sites.clone();
        std::mem::swap(&mut sites.0[self.own], &mut own.0[0]);
        Ok((sites, names))
    }
}

/// What an instance without children of its own has not.
const OWN: [&str; 4] = [
    ChildrenKey::PrimChildren.as_str(),
    ChildrenKey::VariantSetChildren.as_str(),
    FieldKey::Clips.as_str(),
    FieldKey::Relocates.as_str(),
];

/// Everything that the spec at `path`, which has the fields `names`, composes; `None` where that may depend on its name, or
/// is no instance.
fn key(data: &dyn AbstractData, path: &sdf::Path, mut names: Vec<String>) -> Option<Key> {
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

#[cfg(test)]
mod tests {
    use super::super::NativeSource;
    use crate::diagnostics::Diagnostics;
    use crate::stage::raw::{RawAttribute, RawPrim, RawStage, Request, Value};
    use crate::stage::{ReadSettings, Source};
    use openusd::usdc::CrateWriter;
    use std::fmt::Write;
    use std::fs::File;
    use std::sync::Arc;

    /// `count` instances of a ball beside each other, and what `body` says of each, read from a binary layer.
    fn read(count: usize, body: &dyn Fn(usize) -> String) -> RawStage {
        let mut text = "#usda 1.0\ndef \"ball\" { def Sphere \"s\" {} }\ndef \"W\" {\n".to_owned();
        for i in 0..count {
            let body = body(i);
            let name = format!("ball{i:06}");
            writeln!(
                text,
                "def Xform \"{name}\" (instanceable = true\nreferences = </ball>) {{\n{body}}}"
            )
            .unwrap();
        }
        text.push('}');
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.usdc");
        let data = openusd::usda::parse(&text).unwrap();
        CrateWriter::write(&data, &mut File::create(&path).unwrap()).unwrap();
        let request = Request::for_settings(&ReadSettings::default());
        let mut source = NativeSource::open(&path).unwrap();
        source.load(&request, &Diagnostics::default()).unwrap()
    }

    fn instances(stage: &RawStage) -> Vec<&RawPrim> {
        let all = stage.prims.iter();
        all.filter(|prim| prim.prototype.is_some()).collect()
    }

    /// Bytes that the allocator of glibc takes for so many.
    fn allocated(bytes: usize) -> usize {
        (bytes + 8).next_multiple_of(16).max(32)
    }

    /// Bytes that `prim` takes, without what others have too.
    fn own_bytes(prim: &RawPrim) -> usize {
        let own = prim.attributes.shared();
        let own = own.filter(|attribute| Arc::strong_count(attribute) == 1);
        let counted = size_of::<RawAttribute>() + 2 * size_of::<usize>();
        let list = prim.attributes.len() * size_of::<Arc<RawAttribute>>();
        size_of::<RawPrim>()
            + allocated(prim.path.capacity())
            + allocated(list)
            + own.count() * allocated(counted)
    }

    #[test]
    fn an_instance_takes_200_bytes_and_its_values_are_its_own() {
        let stage = read(1100, &|i| {
            format!(
                "double3 xformOp:translate = ({i}, 0, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"]\n\
                 custom int number = {i}\n"
            )
        });
        let all = instances(&stage);
        assert_eq!(all.len(), 1100);
        for (i, prim) in (0_u32..).zip(&all) {
            assert_eq!(prim.path, format!("/W/ball{i:06}"));
            assert!(Arc::ptr_eq(prim.common(), all[0].common()));
            assert_eq!(prim.unread, ["number"]);
            let Some(Value::Vec3(place)) = prim.attributes["xformOp:translate"].value else {
                panic!("{:?}", prim.attributes["xformOp:translate"]);
            };
            assert_eq!(place.x, f64::from(i));
            // the first two are read in other ways
            assert!(i < 2 || own_bytes(prim) <= 200, "{}", own_bytes(prim));
        }
        let prototype = all[0].prototype.unwrap();
        assert_eq!(stage.prims[prototype + 1].type_name, "Sphere");
    }

    #[test]
    fn instances_that_differ_in_more_share_no_more_than_they_have_alike() {
        let stage = read(1003, &|i| match i {
            500 => "custom int other = 1\n".to_owned(),
            501 => "token visibility = \"invisible\"\nrel r = </ball>\n".to_owned(),
            _ => "token visibility = \"inherited\"\n".to_owned(),
        });
        let all = instances(&stage);
        assert_eq!(all.len(), 1003);
        let word = |i: usize| all[i].attributes.get("visibility").map(|a| a.value.clone());
        let token = |word: &str| Some(Some(Value::Token(word.to_owned())));
        assert_eq!(word(499), token("inherited"));
        assert_eq!(word(500), None);
        assert_eq!(word(501), token("invisible"));
        assert_eq!(word(502), token("inherited"));
        assert_eq!(all[500].unread, ["other"]);
        assert_eq!(all[501].relationships["r"].targets, ["/ball"]);
        for i in [499, 502] {
            assert!(all[i].unread.is_empty() && all[i].relationships.is_empty());
            assert_eq!(all[i].prototype, all[0].prototype);
        }
    }
}
