//! `CollectionAPI`: which paths a collection holds (include and exclude rules; path expressions are not evaluated).

use super::paths::{Paths, split_property};
use super::values::Values;
use crate::diagnostics::Diagnostics;
use std::collections::HashMap;

/// What a collection says of a path and, unless told otherwise below, of everything beneath it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    Exclude,
    Explicit,
    Expand,
}

/// Collections of lights that UsdLux gives an `includeRoot` that is true unless authored.
const HOLDING_ALL: [&str; 2] = ["lightLink", "shadowLink"];

/// Rules of one collection by stage path.
#[derive(Debug, Clone, Default, PartialEq)]
pub(in super::super) struct Membership(HashMap<String, Rule>);

impl Membership {
    /// True if the prim at stage path `path` belongs to the collection: the nearest rule at or above it decides.
    pub(super) fn contains(&self, path: &str) -> bool {
        if self.0.is_empty() {
            return false;
        }
        let mut at = path;
        loop {
            match self.0.get(at) {
                Some(Rule::Exclude) => return false,
                Some(Rule::Expand) => return true,
                Some(Rule::Explicit) if at == path => return true,
                _ => {}
            }
            at = match at.rfind('/') {
                Some(0) if at.len() > 1 => "/",
                Some(end) if end > 0 => &at[..end],
                _ => return false,
            };
        }
    }
}

/// The collection name of a target like `/A/B.collection:NAME`.
pub(super) fn collection_name(path: &str) -> Option<&str> {
    split_property(path)
        .1
        .strip_prefix("collection:")
        .filter(|name| !name.is_empty())
}

/// Membership of the collection at `path` as seen from occurrence `from`; `None` if its prim does not exist.
/// Collections may include others; one that includes itself is cut there, as Pixar's USD does.
pub(super) fn membership(
    paths: &Paths<'_>,
    path: &str,
    from: usize,
    diagnostics: &Diagnostics,
) -> Option<Membership> {
    let mut reader = Reader {
        paths,
        from,
        diagnostics,
        chain: Vec::new(),
    };
    reader.read(path)
}

struct Reader<'a> {
    paths: &'a Paths<'a>,
    from: usize,
    diagnostics: &'a Diagnostics,
    chain: Vec<String>,
}

impl Reader<'_> {
    fn read(&mut self, path: &str) -> Option<Membership> {
        let name = collection_name(path)?;
        let prim = self.paths.prim(self.paths.find(split_property(path).0)?);
        let targets = |what: &str| {
            let relationship = prim.relationships.get(&format!("collection:{name}:{what}"));
            relationship.map_or(&[][..], |relationship| &relationship.targets)
        };
        let rule = match prim.token(&format!("collection:{name}:expansionRule")) {
            Some("explicitOnly") => Rule::Explicit,
            _ => Rule::Expand,
        };
        self.chain.push(path.to_owned());
        let mut rules = HashMap::new();
        for target in targets("includes") {
            self.include(target, rule, &mut rules);
        }
        self.chain.pop();
        let root = prim.flag(&format!("collection:{name}:includeRoot"));
        let root = root.unwrap_or(HOLDING_ALL.contains(&name));
        if root && rule == Rule::Expand {
            rules.insert("/".to_owned(), Rule::Expand);
        }
        if rules.is_empty() {
            self.warn_of_expression(
                prim.token(&format!("collection:{name}:membershipExpression")),
                path,
            );
        }
        for target in targets("excludes") {
            rules.insert(self.stage_path(target), Rule::Exclude);
        }
        Some(Membership(rules))
    }

    fn include(&mut self, target: &str, rule: Rule, rules: &mut HashMap<String, Rule>) {
        if collection_name(target).is_none() {
            rules.insert(self.stage_path(target), rule);
        } else if !self.chain.iter().any(|outer| outer == target)
            && let Some(inner) = self.read(target)
        {
            rules.extend(inner.0);
        }
    }

    fn stage_path(&self, target: &str) -> String {
        self.paths.stage_path(target, self.from).into_owned()
    }

    fn warn_of_expression(&self, expression: Option<&str>, path: &str) {
        if let Some(expression) = expression.filter(|text| !text.trim().is_empty()) {
            self.diagnostics.warn(
                "unsupported-collection",
                path,
                format!("membershipExpression `{expression}` is not evaluated: the collection counts as empty"),
            );
        }
    }
}
