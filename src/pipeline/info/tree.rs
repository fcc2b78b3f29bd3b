//! The stage as a tree of what counts, and what of it moves.

use crate::stage::raw::{RawPrim, RawStage};
use serde::Serialize;
use std::collections::BTreeMap;

/// Deepest level told of.
const DEPTH: usize = 3;

/// Most entries told of: a bigger stage shows its upper levels only.
const ENTRIES: usize = 400;

/// One prim, with what is at and below it. Prims below native instances count once, below their prototype.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TreeEntry {
    /// Path.
    pub path: String,
    /// Type; empty for prims without one.
    #[serde(rename = "type")]
    pub type_name: String,
    /// `kind` metadata.
    pub kind: Option<String>,
    /// True for a native instance.
    pub is_instance: bool,
    /// Prims at and below it by type: those that are drawn, shine, look or shade.
    pub holds: BTreeMap<String, usize>,
}

/// Attributes with several time samples.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct AnimationSummary {
    /// Their number.
    pub attributes: usize,
    /// Prims that have one.
    pub prims: usize,
    /// Prims whose transform moves.
    pub transforms: usize,
    /// Prims whose points move.
    pub points: usize,
}

/// Types that do not count: they only hold or name others.
const MINOR: [&str; 6] = ["", "Xform", "Scope", "Shader", "NodeGraph", "GeomSubset"];

/// The upper levels of `raw`: what holds something that counts.
pub(super) fn of(raw: &RawStage) -> Vec<TreeEntry> {
    let prims = &raw.prims[..raw.prototype_start];
    let mut holds: Vec<BTreeMap<String, usize>> = vec![BTreeMap::new(); prims.len()];
    // parents come before children: from the end every prim is complete when its parent takes it in
    for (index, prim) in prims.iter().enumerate().rev() {
        if !MINOR.contains(&prim.type_name.as_str()) {
            *holds[index].entry(prim.type_name.clone()).or_default() += 1;
        }
        if prim.prototype.is_some() {
            *holds[index].entry("instance".to_owned()).or_default() += 1;
        }
        if let Some(parent) = prim.parent {
            for (name, count) in holds[index].clone() {
                *holds[parent].entry(name).or_default() += count;
            }
        }
    }
    let depth = |prim: &RawPrim| prim.path.matches('/').count();
    let counts = |limit: usize| {
        let shown = prims.iter().zip(&holds);
        shown.filter(move |(prim, holds)| depth(prim) <= limit && !holds.is_empty())
    };
    let limit = (1..=DEPTH)
        .rev()
        .find(|&limit| counts(limit).count() <= ENTRIES);
    let entry = |(prim, holds): (&RawPrim, &BTreeMap<String, usize>)| TreeEntry {
        path: prim.path.clone(),
        type_name: prim.type_name.clone(),
        kind: prim.kind.clone(),
        is_instance: prim.prototype.is_some(),
        holds: holds.clone(),
    };
    counts(limit.unwrap_or(1))
        .take(ENTRIES)
        .map(entry)
        .collect()
}

/// What varies with time.
pub(super) fn animation(raw: &RawStage) -> AnimationSummary {
    let mut summary = AnimationSummary::default();
    for prim in &raw.prims {
        let varying: Vec<&str> = (prim.attributes.iter())
            .filter(|(_, attribute)| attribute.varying)
            .map(|(name, _)| name.as_str())
            .collect();
        summary.attributes += varying.len();
        summary.prims += usize::from(!varying.is_empty());
        let moves = varying.iter().any(|name| name.starts_with("xformOp"));
        summary.transforms += usize::from(moves);
        let deforms = ["points", "positions"];
        summary.points += usize::from(varying.iter().any(|name| deforms.contains(name)));
    }
    summary
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prim(path: &str, type_name: &str, parent: Option<usize>) -> RawPrim {
        RawPrim::typed(path, type_name, parent)
    }

    #[test]
    fn every_level_counts_what_is_below_and_empty_branches_are_left_out() {
        let raw = RawStage {
            prims: vec![
                prim("/W", "Xform", None),
                prim("/W/a", "Mesh", Some(0)),
                prim("/W/g", "Xform", Some(0)),
                prim("/W/g/b", "Mesh", Some(2)),
                prim("/W/g/deep", "Xform", Some(2)),
                prim("/W/g/deep/c", "SphereLight", Some(4)),
                prim("/W/empty", "Scope", Some(0)),
            ],
            prototype_start: 7,
            ..RawStage::default()
        };
        let tree = of(&raw);
        let paths: Vec<&str> = tree.iter().map(|entry| entry.path.as_str()).collect();
        assert_eq!(paths, ["/W", "/W/a", "/W/g", "/W/g/b", "/W/g/deep"]);
        assert_eq!(tree[0].holds["Mesh"], 2);
        assert_eq!(tree[2].holds["SphereLight"], 1);
    }
}
