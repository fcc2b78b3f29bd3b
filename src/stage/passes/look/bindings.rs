//! Material bindings: for each prim the strongest of its direct, inherited and collection bindings, the way
//! `UsdShadeMaterialBindingAPI::ComputeBoundMaterial` of usd-core 26.11 chooses.
//!
//! For each purpose in turn, bindings are looked at from the prim upwards. The nearest one wins, unless one further up
//! is `strongerThanDescendants`; at the same prim a collection binding that holds the prim beats the direct one, and
//! the first such collection in property order counts. A binding whose target is not a Material leaves the prim without
//! one (it does not fall back to a weaker binding).

use super::super::super::raw::{RawPrim, RawRelationship};
use super::collections::{Membership, collection_name, membership};
use super::paths::Paths;
use crate::diagnostics::Diagnostics;
use std::cmp::Ordering;
use std::collections::HashMap;

/// Name of the all-purpose material purpose.
pub(super) const ALL_PURPOSE: &str = "";

/// A binding that applies to some prim.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bound<'a> {
    /// Target path, as written (possibly in a prototype).
    pub(super) material: &'a str,
    /// Occurrence that carries the relationship.
    pub(super) at: usize,
}

#[derive(Debug)]
struct Direct<'a> {
    material: &'a str,
    strong: bool,
}

#[derive(Debug)]
struct Collection<'a> {
    path: &'a str,
    material: &'a str,
    strong: bool,
}

/// Bindings of one prim, one entry a purpose.
#[derive(Debug)]
struct PrimBindings<'a> {
    direct: Vec<Option<Direct<'a>>>,
    collections: Vec<Vec<Collection<'a>>>,
}

/// Finds the binding of occurrences. Cost of one: the prims above it that carry bindings.
#[derive(Debug)]
pub(super) struct Bindings<'a> {
    paths: &'a Paths<'a>,
    purposes: usize,
    prims: HashMap<usize, PrimBindings<'a>>,
    nearest: Vec<Option<usize>>,
    memberships: HashMap<String, Option<Membership>>,
    diagnostics: &'a Diagnostics,
}

impl<'a> Bindings<'a> {
    /// Collect the bindings of all prims for `purposes`, strongest first ([`ALL_PURPOSE`] included by the caller).
    pub(super) fn new(
        paths: &'a Paths<'a>,
        purposes: &[&str],
        diagnostics: &'a Diagnostics,
    ) -> Self {
        let mut prims = HashMap::new();
        let mut nearest: Vec<Option<usize>> = Vec::with_capacity(paths.occurrences().len());
        for (index, occurrence) in paths.occurrences().iter().enumerate() {
            let binds = prims.contains_key(&occurrence.prim) || {
                let found = PrimBindings::of(paths.prim(occurrence.prim), purposes);
                found.is_some_and(|found| prims.insert(occurrence.prim, found).is_none())
            };
            let inherited = occurrence.parent.and_then(|parent| nearest[parent]);
            nearest.push(if binds { Some(index) } else { inherited });
        }
        Self {
            paths,
            purposes: purposes.len(),
            prims,
            nearest,
            memberships: HashMap::new(),
            diagnostics,
        }
    }

    /// The binding that applies to `occurrence`.
    pub(super) fn of(&mut self, occurrence: usize) -> Option<Bound<'a>> {
        (0..self.purposes).find_map(|purpose| self.of_purpose(occurrence, purpose))
    }

    fn of_purpose(&mut self, occurrence: usize, purpose: usize) -> Option<Bound<'a>> {
        let mut winner: Option<Bound<'a>> = None;
        let mut next = self.nearest[occurrence];
        while let Some(at) = next {
            let parent = self.paths.occurrences()[at].parent;
            next = parent.and_then(|parent| self.nearest[parent]);
            let bindings = &self.prims[&self.paths.occurrences()[at].prim];
            if let Some(direct) = &bindings.direct[purpose]
                && (winner.is_none() || direct.strong)
            {
                winner = Some(Bound {
                    material: direct.material,
                    at,
                });
            }
            let path = &self.paths.occurrences()[occurrence].path;
            for collection in &bindings.collections[purpose] {
                let wins = winner.is_none_or(|winner| winner.at == at) || collection.strong;
                let from = (self.paths, at, self.diagnostics);
                if wins && holds(&mut self.memberships, from, collection.path, path) {
                    winner = Some(Bound {
                        material: collection.material,
                        at,
                    });
                    break;
                }
            }
        }
        winner
    }
}

/// Where a collection is looked at from: the stage, the occurrence that binds it, and where to complain.
type From<'a> = (&'a Paths<'a>, usize, &'a Diagnostics);

fn holds(
    memberships: &mut HashMap<String, Option<Membership>>,
    (paths, at, diagnostics): From<'_>,
    collection: &str,
    prim: &str,
) -> bool {
    let key = paths.stage_path(collection, at).into_owned();
    memberships
        .entry(key)
        .or_insert_with(|| membership(paths, collection, at, diagnostics))
        .as_ref()
        .is_some_and(|members| members.contains(prim))
}

impl<'a> PrimBindings<'a> {
    fn of(prim: &'a RawPrim, purposes: &[&str]) -> Option<Self> {
        let binds = |name: &str| name.starts_with("material:binding");
        prim.relationships
            .keys()
            .any(|name| binds(name))
            .then(|| Self {
                direct: purposes
                    .iter()
                    .map(|purpose| direct(prim, purpose))
                    .collect(),
                collections: purposes
                    .iter()
                    .map(|purpose| collections(prim, purpose))
                    .collect(),
            })
    }
}

fn is_strong(relationship: &RawRelationship) -> bool {
    relationship.bind_material_as.as_deref() == Some("strongerThanDescendants")
}

fn with_purpose(name: &str, purpose: &str) -> String {
    if purpose.is_empty() {
        name.to_owned()
    } else {
        format!("{name}:{purpose}")
    }
}

/// The direct binding for a purpose; anything but exactly one prim target is no binding.
fn direct<'a>(prim: &'a RawPrim, purpose: &str) -> Option<Direct<'a>> {
    let relationship = prim
        .relationships
        .get(&with_purpose("material:binding", purpose))?;
    match relationship.targets.as_slice() {
        [material] if !material.contains('.') => Some(Direct {
            material,
            strong: is_strong(relationship),
        }),
        _ => None,
    }
}

/// The collection bindings for a purpose in property order; anything but one collection and one prim is no binding.
fn collections<'a>(prim: &'a RawPrim, purpose: &str) -> Vec<Collection<'a>> {
    let prefix = with_purpose("material:binding:collection", purpose) + ":";
    let mut found: Vec<(&str, Collection<'a>)> = (prim.relationships.iter())
        .filter_map(|(name, relationship)| {
            let name = name
                .strip_prefix(&prefix)
                .filter(|name| !name.contains(':'))?;
            let (path, material) = match relationship.targets.as_slice() {
                [a, b] if collection_name(a).is_some() && !b.contains('.') => (a, b),
                [a, b] if collection_name(b).is_some() && !a.contains('.') => (b, a),
                _ => return None,
            };
            let strong = is_strong(relationship);
            Some((
                name,
                Collection {
                    path,
                    material,
                    strong,
                },
            ))
        })
        .collect();
    found.sort_by(|a, b| property_order(a.0, b.0));
    found
        .into_iter()
        .map(|(_, collection)| collection)
        .collect()
}

/// USD's order of property names: without case, digits by their value; equal then: fewer zeros, capitals first.
fn property_order(a: &str, b: &str) -> Ordering {
    pieces(a)
        .cmp(&pieces(b))
        .then_with(|| a.len().cmp(&b.len()))
        .then_with(|| a.cmp(b))
}

/// A name as pieces that compare: a character, or a run of digits by its value (leading zeros dropped, longer is more).
fn pieces(name: &str) -> Vec<(u8, usize, String)> {
    let bytes = name.as_bytes();
    let mut pieces = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let digits = bytes[at..]
            .iter()
            .take_while(|b| b.is_ascii_digit())
            .count();
        if digits == 0 {
            pieces.push((bytes[at].to_ascii_lowercase(), 0, String::new()));
            at += 1;
        } else {
            let value = name[at..at + digits].trim_start_matches('0');
            pieces.push((b'0', value.len(), value.to_owned()));
            at += digits;
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::super::fixture::Fixture;
    use super::*;
    use crate::stage::raw::Value;

    /// What usd-core 26.11's `ComputeBoundMaterial` answers on the stage in `library()` and below, for purposes
    /// `full` and all-purpose.
    fn assert_bound(fixture: &Fixture, expected: &[(&str, Option<&str>, Option<&str>)]) {
        let occurrences = fixture.occurrences();
        let paths = Paths::new(&fixture.raw, &occurrences);
        let diagnostics = Diagnostics::default();
        let mut full = Bindings::new(&paths, &["full", ALL_PURPOSE], &diagnostics);
        let mut all = Bindings::new(&paths, &[ALL_PURPOSE], &diagnostics);
        for (path, with_full, all_purpose) in expected {
            let index = occurrences
                .iter()
                .position(|occurrence| occurrence.path == *path)
                .unwrap();
            let found = |bound: Option<Bound<'_>>| {
                let bound = bound?;
                let path = paths.stage_path(bound.material, bound.at).into_owned();
                let is_material = |&prim: &usize| paths.prim(prim).type_name == "Material";
                paths.find(bound.material).filter(is_material).map(|_| path)
            };
            assert_eq!(found(full.of(index)).as_deref(), *with_full, "full {path}");
            assert_eq!(
                found(all.of(index)).as_deref(),
                *all_purpose,
                "all-purpose {path}"
            );
        }
    }

    fn library() -> Fixture {
        ["A", "B", "C", "D"]
            .iter()
            .fold(Fixture::default().prim("/L", "Scope"), |stage, name| {
                stage.prim(&format!("/L/{name}"), "Material")
            })
            .prim("/L/NotMat", "Scope")
    }

    const A: Option<&str> = Some("/L/A");
    const B: Option<&str> = Some("/L/B");
    const C: Option<&str> = Some("/L/C");
    const D: Option<&str> = Some("/L/D");

    #[test]
    fn collection_bindings_follow_usd_core() {
        let stage = library()
            .prim("/W", "Xform")
            .rel("material:binding", &["/L/A"])
            .rel(
                "material:binding:collection:m10",
                &["/W.collection:c10", "/L/C"],
            )
            .rel(
                "material:binding:collection:m2",
                &["/W.collection:c2", "/L/B"],
            )
            .rel(
                "material:binding:collection:full:fx",
                &["/L/D", "/W.collection:ex"],
            )
            .rel("collection:c10:includes", &["/W/g1", "/W/g2"])
            .rel("collection:c2:includes", &["/W/g1", "/W/deep"])
            .rel("collection:c2:excludes", &["/W/deep/y"])
            .token("collection:ex:expansionRule", "explicitOnly")
            .rel("collection:ex:includes", &["/W/ex", "/W/exroot"])
            .prim("/W/g0", "Sphere")
            .prim("/W/g1", "Sphere")
            .prim("/W/g2", "Sphere")
            .rel("material:binding", &["/L/D"])
            .prim("/W/deep", "Xform")
            .prim("/W/deep/x", "Sphere")
            .prim("/W/deep/y", "Xform")
            .prim("/W/deep/y/z", "Sphere")
            .rel("material:binding", &["/L/D"])
            .prim("/W/deep/y/w", "Sphere")
            .prim("/W/ex", "Sphere")
            .prim("/W/exroot", "Xform")
            .prim("/W/exroot/k", "Sphere");
        assert_bound(
            &stage,
            &[
                ("/W/g0", A, A),
                ("/W/g1", B, B),
                ("/W/g2", D, D),
                ("/W/deep/x", B, B),
                ("/W/deep/y/z", D, D),
                ("/W/deep/y/w", A, A),
                ("/W/ex", D, A),
                ("/W/exroot/k", A, A),
            ],
        );
    }

    #[test]
    fn strength_and_purposes_follow_usd_core() {
        let stage = library()
            .prim("/S", "Xform")
            .strong_rel("material:binding", &["/L/A"])
            .prim("/S/a", "Xform")
            .rel("material:binding", &["/L/B"])
            .prim("/S/a/p", "Sphere")
            .rel("material:binding", &["/L/C"])
            .prim("/S/a/q", "Sphere")
            .rel("material:binding:full", &["/L/C"])
            .prim("/T", "Xform")
            .rel("material:binding:full", &["/L/B"])
            .prim("/T/own", "Sphere")
            .rel("material:binding", &["/L/A"])
            .prim("/T/prev", "Sphere")
            .rel("material:binding:preview", &["/L/C"])
            .prim("/M", "Mesh")
            .rel("material:binding", &["/L/A"])
            .prim("/M/s", "GeomSubset")
            .rel("material:binding", &["/L/B"])
            .prim("/M/t", "GeomSubset");
        assert_bound(
            &stage,
            &[
                ("/S/a/p", A, A),
                ("/S/a/q", C, A),
                ("/T/own", B, A),
                ("/T/prev", B, None),
                ("/M", A, A),
                ("/M/s", B, B),
                ("/M/t", A, A),
            ],
        );
    }

    #[test]
    fn targets_that_are_no_material_leave_the_prim_unbound_as_in_usd_core() {
        let stage = library()
            .prim("/T", "Xform")
            .rel("material:binding:full", &["/L/B"])
            .prim("/T/missing", "Sphere")
            .rel("material:binding", &["/L/Nope"])
            .prim("/U", "Xform")
            .rel("material:binding", &["/L/A"])
            .prim("/U/missing", "Sphere")
            .rel("material:binding", &["/L/Nope"])
            .prim("/U/notmat", "Sphere")
            .rel("material:binding", &["/L/NotMat"])
            .prim("/U/two", "Sphere")
            .rel("material:binding", &["/L/B", "/L/C"])
            .prim("/U/blocked", "Sphere")
            .rel("material:binding", &[])
            .prim("/U/fullbad", "Sphere")
            .rel("material:binding:full", &["/L/Nope"])
            .rel("material:binding", &["/L/B"])
            .prim("/V", "Xform")
            .rel(
                "material:binding:collection:bad",
                &["/V.collection:bad", "/L/Nope"],
            )
            .rel("collection:bad:includes", &["/V"])
            .rel(
                "material:binding:collection:r",
                &["/V.collection:r", "/L/B"],
            )
            .value("collection:r:includeRoot", Value::Bool(true))
            .prim("/V/i", "Sphere");
        assert_bound(
            &stage,
            &[
                ("/T/missing", B, None),
                ("/U/missing", None, None),
                ("/U/notmat", None, None),
                ("/U/two", A, A),
                ("/U/blocked", A, A),
                ("/U/fullbad", None, B),
                ("/V/i", None, None),
            ],
        );
    }

    #[test]
    fn nested_and_strong_collections_follow_usd_core() {
        let stage = library()
            .prim("/N", "Xform")
            .rel(
                "material:binding:collection:o",
                &["/N.collection:o", "/L/C"],
            )
            .rel(
                "collection:o:includes",
                &["/N.collection:i", "/N.collection:o", "/N/b"],
            )
            .rel("collection:i:includes", &["/N/a"])
            .rel("collection:i:excludes", &["/N/a/no"])
            .prim("/N/a", "Sphere")
            .prim("/N/a/no", "Sphere")
            .prim("/N/a/yes", "Sphere")
            .prim("/N/b", "Sphere")
            .prim("/N/c", "Sphere")
            .prim("/Q", "Xform")
            .rel("material:binding", &["/L/A"])
            .strong_rel(
                "material:binding:collection:o",
                &["/Q.collection:o", "/L/C"],
            )
            .rel("collection:o:includes", &["/Q/a"])
            .prim("/Q/a", "Sphere")
            .rel("material:binding", &["/L/B"])
            .prim("/Q/b", "Xform")
            .rel("material:binding", &["/L/B"])
            .rel(
                "material:binding:collection:o",
                &["/Q/b.collection:o", "/L/D"],
            )
            .rel("collection:o:includes", &["/Q/b/c"])
            .prim("/Q/b/c", "Sphere")
            .prim("/Q/b/d", "Sphere")
            .prim("/R", "Xform")
            .rel(
                "material:binding:collection:r",
                &["/R.collection:r", "/L/B"],
            )
            .value("collection:r:includeRoot", Value::Bool(true))
            .rel("collection:r:excludes", &["/R/e"])
            .prim("/R/i", "Sphere")
            .prim("/R/e", "Sphere")
            .prim("/R/e/j", "Sphere");
        assert_bound(
            &stage,
            &[("/R/i", B, B), ("/R/e", None, None), ("/R/e/j", None, None)],
        );
    }

    #[test]
    fn targets_inside_prototypes_are_those_of_each_instance() {
        let stage = library()
            .prim("/I", "Xform")
            .rel("collection:o:includes", &["/I/one/u"])
            .rel(
                "material:binding:collection:o",
                &["/I.collection:o", "/L/D"],
            )
            .rel("material:binding", &["/L/A"])
            .prim("/I/one", "Xform")
            .prim("/I/two", "Xform")
            .rel("material:binding", &["/I/one/Mtl/PM"])
            .prim("/__Prototype_1", "Xform")
            .prim("/__Prototype_1/Mtl", "Scope")
            .prim("/__Prototype_1/Mtl/PM", "Material")
            .prim("/__Prototype_1/s", "Sphere")
            .rel("material:binding", &["/__Prototype_1/Mtl/PM"])
            .prim("/__Prototype_1/u", "Sphere")
            .prim("/__Prototype_1/o", "Sphere")
            .rel("material:binding", &["/L/C"])
            .instances(&["/I/one", "/I/two"], "/__Prototype_1");
        let one = Some("/I/one/Mtl/PM");
        let two = Some("/I/two/Mtl/PM");
        assert_bound(
            &stage,
            &[
                ("/I/one/s", one, one),
                ("/I/one/u", D, D),
                ("/I/one/o", C, C),
                ("/I/two/s", two, two),
                ("/I/two/u", one, one),
                ("/I/two/o", C, C),
            ],
        );
    }

    #[test]
    fn property_names_are_ordered_as_usd_core_lists_them() {
        let ordered = [
            ("a2", "a10"),
            ("a", "B"),
            ("B", "b"),
            ("_b", "B"),
            ("a1", "a01"),
            ("_b", "b"),
            ("Ab", "aB"),
            ("a1b", "a_b"),
        ];
        for (first, second) in ordered {
            assert_eq!(
                property_order(first, second),
                Ordering::Less,
                "{first} {second}"
            );
        }
    }
}
