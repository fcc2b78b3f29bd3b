//! Which sources of a stage are told apart, and how they are called.

use super::super::super::ReadSettings;
use super::super::super::raw::RawStage;
use super::super::flatten;
use super::collections::{self, Membership, collection_name};
use super::paths::Paths;
use crate::diagnostics::Diagnostics;
use crate::scene::{GroupRule, LightGroup, Scene};
use std::str::FromStr;

/// A light group as asked for: `NAME` is the collection of that name, on whatever prim; `NAME=PATH,…` what is at or below
/// these paths (`--dome` for the dome of the command line) and in these collections (`/PRIM.collection:NAME`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LightGroupChoice {
    name: String,
    /// Empty: the collection called so.
    paths: Vec<String>,
}

impl LightGroupChoice {
    /// What results of its light are called after.
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl FromStr for LightGroupChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, paths) = match text.split_once('=') {
            Some((name, paths)) => (name, paths.split(',').map(str::to_owned).collect()),
            None => (text, Vec::new()),
        };
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.is_empty() || !name.chars().all(is_word) {
            return Err(format!(
                "{name:?} is no name for a light group: letters, digits and _ are"
            ));
        }
        if name == LightGroup::DEFAULT {
            return Err("default is the group of all sources that are in no other".to_owned());
        }
        if paths.iter().any(String::is_empty) {
            return Err(format!("{text:?} has an empty path"));
        }
        Ok(Self {
            name: name.to_owned(),
            paths,
        })
    }
}

/// What one choice holds: paths and all below, and collections.
struct Members<'a> {
    roots: Vec<&'a str>,
    collections: Vec<Membership>,
}

impl Members<'_> {
    fn contains(&self, path: &str) -> bool {
        let below = |root: &&str| {
            path.strip_prefix(*root)
                .is_some_and(|rest| rest.is_empty() || *root == "/" || rest.starts_with(['/', '[']))
        };
        let is_in = |collection: &Membership| collection.contains(path);
        self.roots.iter().any(below) || self.collections.iter().any(is_in)
    }
}

/// The sources of `scene`, read from `raw`, in the groups that `choices` name, and the rest; nothing without choices. A group
/// without sources is warned of and stays: its light is black.
pub fn light_groups(
    (raw, scene): (&RawStage, &Scene),
    choices: &[LightGroupChoice],
    diagnostics: &Diagnostics,
) -> Vec<LightGroup> {
    if choices.is_empty() {
        return Vec::new();
    }
    // What is wrong with transforms has been told when the scene was read.
    let occurrences = flatten::flatten(raw, &ReadSettings::default(), &Diagnostics::default());
    let paths = Paths::new(raw, &occurrences);
    let members: Vec<_> = (choices.iter())
        .map(|choice| members(choice, raw, &paths, diagnostics))
        .collect();
    let wants: Vec<_> = (members.iter())
        .map(|members| |path: &str| members.contains(path))
        .collect();
    let named: Vec<GroupRule<'_>> = (choices.iter().zip(&wants))
        .map(|(choice, wants)| (choice.name.as_str().into(), wants as _))
        .collect();
    let groups = LightGroup::partition(scene, &named);
    for group in &groups[..choices.len()] {
        if !group.lights.contains(&true) && !group.prims.contains(&true) {
            let message = "no light and no mesh is in this light group, or others before it have them: its light is black";
            diagnostics.warn("light-group", &*group.name, message);
        }
    }
    groups
}

fn members<'a>(
    choice: &'a LightGroupChoice,
    raw: &RawStage,
    paths: &Paths<'_>,
    diagnostics: &Diagnostics,
) -> Members<'a> {
    let (collected, roots): (Vec<_>, Vec<_>) = (choice.paths.iter())
        .map(String::as_str)
        .partition(|path| collection_name(path).is_some());
    let own = format!("collection:{}:includes", choice.name);
    let prims = raw.prims.iter().filter(|_| choice.paths.is_empty());
    let holders = prims.filter(|prim| prim.relationships.contains_key(&own));
    let named: Vec<_> = holders
        .map(|prim| format!("{}.collection:{}", prim.path, choice.name))
        .collect();
    let all = collected
        .into_iter()
        .chain(named.iter().map(String::as_str));
    Members {
        roots,
        collections: all
            .filter_map(|path| collections::membership(paths, path, 0, diagnostics))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_words_and_default_is_taken() {
        let choice: LightGroupChoice = "key=/lights/key,/lights.collection:fill"
            .parse()
            .expect("fine");
        assert_eq!((choice.name(), choice.paths.len()), ("key", 2));
        for wrong in ["", "a b", "default", "key=", "key=/a,,/b", "=/a"] {
            assert!(wrong.parse::<LightGroupChoice>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_path_holds_what_is_below_it_and_nothing_that_only_begins_alike() {
        let members = Members {
            roots: vec!["/lights/key"],
            collections: Vec::new(),
        };
        for inside in ["/lights/key", "/lights/key/bulb", "/lights/key[3]/mesh"] {
            assert!(members.contains(inside), "{inside}");
        }
        assert!(!members.contains("/lights/key2"));
        assert!(!members.contains("/lights"));
    }
}
