//! Bound materials and `materialBind` subsets → the material of every face of an occurrence.

use super::super::super::raw::RawStage;
use super::super::flatten::Occurrence;
use super::super::look::Look;
use super::attributes;
use crate::scene::{FaceMaterials, MaterialId};
use std::collections::HashMap;
use std::sync::Arc;

/// Bindings of occurrences, with those of their subsets.
pub(super) struct Materials<'a> {
    raw: &'a RawStage,
    occurrences: &'a [Occurrence],
    look: &'a Look,
    /// `materialBind` subsets of each occurrence that has any.
    subsets: HashMap<usize, Vec<usize>>,
    /// Made already: instances share them.
    known: HashMap<usize, FaceMaterials>,
}

impl<'a> Materials<'a> {
    pub(super) fn of(raw: &'a RawStage, occurrences: &'a [Occurrence], look: &'a Look) -> Self {
        let mut subsets: HashMap<usize, Vec<usize>> = HashMap::new();
        for (index, occurrence) in occurrences.iter().enumerate() {
            let prim = &raw.prims[occurrence.prim];
            let binds = prim.type_name == "GeomSubset"
                && attributes::token(prim, "familyName", "") == "materialBind"
                && attributes::token(prim, "elementType", "face") == "face";
            if let Some(parent) = occurrence.parent.filter(|_| binds) {
                subsets.entry(parent).or_default().push(index);
            }
        }
        Self {
            raw,
            occurrences,
            look,
            subsets,
            known: HashMap::new(),
        }
    }

    pub(super) fn of_occurrence(&mut self, occurrence: usize) -> FaceMaterials {
        let whole = self.binding(occurrence);
        let Some(subsets) = self.subsets.get(&occurrence) else {
            return FaceMaterials::Whole(whole);
        };
        if let Some(known) = self.known.get(&occurrence) {
            return known.clone();
        }
        let prim = &self.raw.prims[self.occurrences[occurrence].prim];
        let mut faces = vec![whole; attributes::ints(prim, "faceVertexCounts").len()];
        for &subset in subsets {
            let material = self.binding(subset).or(whole);
            let prim = &self.raw.prims[self.occurrences[subset].prim];
            for &face in attributes::ints(prim, "indices") {
                if let Some(slot) = usize::try_from(face).ok().and_then(|f| faces.get_mut(f)) {
                    *slot = material;
                }
            }
        }
        let materials = FaceMaterials::PerFace(Arc::from(faces));
        self.known.insert(occurrence, materials.clone());
        materials
    }

    fn binding(&self, occurrence: usize) -> Option<MaterialId> {
        self.look.binding.get(occurrence).copied().flatten()
    }
}
