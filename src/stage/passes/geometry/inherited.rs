//! Which constant primvars each occurrence inherits, and from whom.

use super::super::super::raw::RawStage;
use super::super::flatten::Occurrence;
use super::primvars::AuthoredPrimvar;
use std::collections::HashMap;

/// Constant primvars that ancestors hand down.
pub(super) struct Inherited {
    /// Distinct sets of (index of the name, raw prim that owns it).
    pub(super) sets: Vec<Vec<(usize, usize)>>,
    /// Set that applies to each occurrence from above.
    pub(super) set_of: Vec<usize>,
}

impl Inherited {
    pub(super) fn of(raw: &RawStage, occurrences: &[Occurrence], names: &[String]) -> Self {
        let attribute_names: Vec<String> = names.iter().map(|n| format!("primvars:{n}")).collect();
        let mut sets = vec![Vec::new()];
        let mut known: HashMap<Vec<(usize, usize)>, usize> = HashMap::from([(Vec::new(), 0)]);
        let mut set_of = Vec::with_capacity(occurrences.len());
        // What each occurrence hands down: its own on top of what it got.
        let mut handed_down: Vec<usize> = Vec::with_capacity(occurrences.len());
        for occurrence in occurrences {
            let above = occurrence.parent.map_or(0, |parent| handed_down[parent]);
            set_of.push(above);
            let attributes = &raw.prims[occurrence.prim].attributes;
            let own: Vec<usize> = (0..names.len())
                .filter(|&name| {
                    let attribute = attributes.get(&attribute_names[name]);
                    attribute.is_some_and(AuthoredPrimvar::is_inheritable)
                })
                .collect();
            if own.is_empty() {
                handed_down.push(above);
                continue;
            }
            let mut set: Vec<(usize, usize)> = sets[above].clone();
            set.retain(|(name, _)| !own.contains(name));
            set.extend(own.into_iter().map(|name| (name, occurrence.prim)));
            set.sort_unstable();
            handed_down.push(*known.entry(set).or_insert_with_key(|set| {
                sets.push(set.clone());
                sets.len() - 1
            }));
        }
        Self { sets, set_of }
    }
}
