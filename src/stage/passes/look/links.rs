//! `lightLink` and `shadowLink` of UsdLux lights: which prims a light lights, and which block it.
//!
//! Both are collections that hold everything unless `includeRoot` is turned off. A prim drawn by a PointInstancer goes by
//! the instancer's path, or by its prototype's where that lies below it.

use super::collections::{self, Membership};
use super::paths::Paths;
use super::values::Values;
use crate::diagnostics::Diagnostics;
use crate::scene::{LightLinks, Linked, Prim, PrimSource, Scene};
use std::sync::Arc;

/// The collections of one light; `None` holds everything.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Links {
    lit: Option<Membership>,
    blockers: Option<Membership>,
}

impl Links {
    /// Of the light at occurrence `index`.
    pub(super) fn read(paths: &Paths<'_>, index: usize, diagnostics: &Diagnostics) -> Self {
        let read = |name: &str| {
            if !is_limited(paths, index, name) {
                return None;
            }
            let path = &paths.occurrences()[index].path;
            let path = format!("{path}.collection:{name}");
            collections::membership(paths, &path, index, diagnostics)
        };
        Self {
            lit: read("lightLink"),
            blockers: read("shadowLink"),
        }
    }
}

/// True if the collection `name` of an occurrence may hold less than everything.
fn is_limited(paths: &Paths<'_>, index: usize, name: &str) -> bool {
    let prim = paths.prim_of(index);
    let part = |part: &str| format!("collection:{name}:{part}");
    let has_targets = |name: &str| {
        let relationship = prim.relationships.get(name);
        relationship.is_some_and(|relationship| !relationship.targets.is_empty())
    };
    has_targets(&part("includes"))
        || has_targets(&part("excludes"))
        || prim.flag(&part("includeRoot")) == Some(false)
        || prim.token(&part("expansionRule")) == Some("explicitOnly")
}

/// Link the lights of `scene`, which `links` are of, to its prims.
pub(in super::super) fn apply(scene: &mut Scene, links: &[Links]) {
    let mut resolver = Resolver::new(&scene.prims);
    for (light, links) in scene.lights.iter_mut().zip(links) {
        LightLinks {
            lit: light.lit,
            blockers: light.blockers,
        } = resolver.links(links);
    }
}

/// Collections → which prims are in them; each once, however many lights have it.
pub(super) struct Resolver<'a> {
    prims: &'a [Prim],
    known: Vec<(&'a Membership, Linked)>,
}

impl<'a> Resolver<'a> {
    pub(super) fn new(prims: &'a [Prim]) -> Self {
        Self {
            prims,
            known: Vec::new(),
        }
    }

    /// What `links` say of the prims.
    pub(super) fn links(&mut self, links: &'a Links) -> LightLinks {
        LightLinks {
            lit: self.linked(links.lit.as_ref()),
            blockers: self.linked(links.blockers.as_ref()),
        }
    }

    fn linked(&mut self, membership: Option<&'a Membership>) -> Linked {
        let Some(membership) = membership else {
            return Linked::All;
        };
        let found = self.known.iter().find(|(other, _)| *other == membership);
        if let Some((_, linked)) = found {
            return linked.clone();
        }
        let linked = linked_by(membership, self.prims);
        self.known.push((membership, linked.clone()));
        linked
    }
}

fn linked_by(membership: &Membership, prims: &[Prim]) -> Linked {
    let all: Arc<[bool]> = (prims.iter())
        .map(|prim| membership.contains(linked_path(prim)))
        .collect();
    match all.contains(&false) {
        true => Linked::Only(all),
        false => Linked::All,
    }
}

/// The path that collections name `prim` by.
fn linked_path(prim: &Prim) -> &str {
    match &prim.source {
        PrimSource::PointInstance {
            instancer,
            shared_path,
            ..
        } => {
            let rest = shared_path.strip_prefix(&**instancer);
            let is_below = rest.is_some_and(|rest| rest.starts_with('/'));
            if is_below { shared_path } else { instancer }
        }
        _ => &prim.path,
    }
}
