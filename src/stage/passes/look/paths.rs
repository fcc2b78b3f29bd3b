//! Where a path written on the stage leads: targets of relationships and connections to prims, also through native
//! instances.

use super::super::super::raw::{RawPrim, RawStage};
use super::super::flatten::Occurrence;
use std::borrow::Cow;
use std::collections::HashMap;

/// Prims and occurrences by path.
#[derive(Debug)]
pub(super) struct Paths<'a> {
    raw: &'a RawStage,
    occurrences: &'a [Occurrence],
    prims: HashMap<&'a str, usize>,
    proxies: HashMap<&'a str, usize>,
}

impl<'a> Paths<'a> {
    /// Index all prims, and those occurrences whose path is not a prim's own (below native instances).
    pub(super) fn new(raw: &'a RawStage, occurrences: &'a [Occurrence]) -> Self {
        let own = |occurrence: &Occurrence| raw.prims[occurrence.prim].path == occurrence.path;
        Self {
            raw,
            occurrences,
            prims: (raw.prims.iter().enumerate())
                .map(|(index, prim)| (prim.path.as_str(), index))
                .collect(),
            proxies: (occurrences.iter())
                .filter(|occurrence| !own(occurrence))
                .map(|occurrence| (occurrence.path.as_str(), occurrence.prim))
                .collect(),
        }
    }

    /// The prim at index `prim`.
    pub(super) fn prim(&self, prim: usize) -> &'a RawPrim {
        &self.raw.prims[prim]
    }

    /// All occurrences.
    pub(super) fn occurrences(&self) -> &'a [Occurrence] {
        self.occurrences
    }

    /// The prim of an occurrence.
    pub(super) fn prim_of(&self, occurrence: usize) -> &'a RawPrim {
        self.prim(self.occurrences[occurrence].prim)
    }

    /// Index of the prim at `path`: a stage path, a path in a prototype, or one below an instance.
    pub(super) fn find(&self, path: &str) -> Option<usize> {
        let index = self.prims.get(path).or_else(|| self.proxies.get(path));
        index.copied()
    }

    /// `path` as seen from occurrence `from`: paths in a prototype become paths below the instance that `from` is in.
    pub(super) fn stage_path<'p>(&self, path: &'p str, from: usize) -> Cow<'p, str> {
        let instances = std::iter::successors(Some(from), |&at| self.occurrences[at].parent);
        for at in instances {
            let Some(prototype) = self.prim_of(at).prototype else {
                continue;
            };
            if let Some(rest) = below(path, &self.prim(prototype).path) {
                return Cow::Owned(format!("{}{rest}", self.occurrences[at].path));
            }
        }
        Cow::Borrowed(path)
    }
}

/// What follows `root` in `path` if `path` is `root`, below it, or one of its properties.
fn below<'p>(path: &'p str, root: &str) -> Option<&'p str> {
    path.strip_prefix(root)
        .filter(|rest| rest.is_empty() || rest.starts_with(['/', '.']))
}

/// Prim path and property name of a path; the latter is empty for a prim path.
pub(super) fn split_property(path: &str) -> (&str, &str) {
    path.split_once('.').unwrap_or((path, ""))
}

/// Last element of a prim path.
pub(super) fn name(path: &str) -> &str {
    path.rsplit_once('/').map_or(path, |(_, name)| name)
}
