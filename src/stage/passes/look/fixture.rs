//! Small composed stages written by hand, for the tests of this folder.

use crate::scene::{PrimSource, Purpose};
use crate::stage::passes::flatten::Occurrence;
use crate::stage::raw::{RawAttribute, RawPrim, RawRelationship, RawStage, Value};
use glam::DMat4;

/// A stage under construction; methods after [`Fixture::prim`] add to the prim last named.
#[derive(Debug, Default)]
pub(super) struct Fixture {
    pub(super) raw: RawStage,
}

impl Fixture {
    /// Add a prim; its parent must be there already. `/__Prototype_…` prims come last.
    pub(super) fn prim(mut self, path: &str, type_name: &str) -> Self {
        let parent = path.rsplit_once('/').map_or("", |(parent, _)| parent);
        let parent = self.raw.find(parent);
        self.raw.prims.push(RawPrim::typed(path, type_name, parent));
        if !path.starts_with("/__Prototype") {
            self.raw.prototype_start = self.raw.prims.len();
        }
        self
    }

    fn last(&mut self) -> &mut RawPrim {
        self.raw.prims.last_mut().unwrap()
    }

    pub(super) fn rel(mut self, name: &str, targets: &[&str]) -> Self {
        let targets = targets.iter().map(|&target| target.to_owned()).collect();
        let relationship = RawRelationship {
            targets,
            bind_material_as: None,
        };
        self.last()
            .relationships
            .insert(name.to_owned(), relationship);
        self
    }

    pub(super) fn strong_rel(self, name: &str, targets: &[&str]) -> Self {
        let mut with = self.rel(name, targets);
        let relationship = with.last().relationships.get_mut(name).unwrap();
        relationship.bind_material_as = Some("strongerThanDescendants".to_owned());
        with
    }

    pub(super) fn value(mut self, name: &str, value: Value) -> Self {
        let attribute = RawAttribute::from(value);
        self.last().attributes.insert(name.to_owned(), attribute);
        self
    }

    pub(super) fn number(self, name: &str, value: f64) -> Self {
        self.value(name, Value::Float(value))
    }

    pub(super) fn token(self, name: &str, value: &str) -> Self {
        self.value(name, Value::Token(value.to_owned()))
    }

    pub(super) fn connect(mut self, name: &str, target: &str) -> Self {
        let attributes = &mut self.last().attributes;
        let mut attribute = attributes.remove(name).unwrap_or_default();
        attribute.connections = vec![target.to_owned()];
        attributes.insert(name.to_owned(), attribute);
        self
    }

    pub(super) fn api(mut self, name: &str) -> Self {
        self.last().api_schemas.push(name.to_owned());
        self
    }

    /// Make the prims at `instances` native instances of the prototype root `prototype`.
    pub(super) fn instances(mut self, instances: &[&str], prototype: &str) -> Self {
        let root = self.raw.find(prototype);
        for path in instances {
            let index = self.raw.find(path).unwrap();
            self.raw.prims[index].prototype = root;
        }
        self
    }

    /// Every prim once for each time it occurs, at the origin.
    pub(super) fn occurrences(&self) -> Vec<Occurrence> {
        let mut all = Vec::new();
        for index in 0..self.raw.prototype_start {
            if self.raw.prims[index].parent.is_none() {
                self.occur(index, None, self.raw.prims[index].path.clone(), &mut all);
            }
        }
        all
    }

    fn occur(&self, prim: usize, parent: Option<usize>, path: String, all: &mut Vec<Occurrence>) {
        let this = all.len();
        all.push(Occurrence {
            prim,
            parent,
            path: path.clone(),
            world_from_local: DMat4::IDENTITY,
            visible: true,
            purpose: Purpose::Default,
            source: PrimSource::Direct,
        });
        let owner = self.raw.prims[prim].prototype.unwrap_or(prim);
        for child in 0..self.raw.prims.len() {
            if self.raw.prims[child].parent == Some(owner) {
                let name = super::paths::name(&self.raw.prims[child].path);
                self.occur(child, Some(this), format!("{path}/{name}"), all);
            }
        }
    }
}
