//! Inherits and specializes that lead back to where they start. The crate follows those of a prim and of its parent
//! without an end in sight, until the stack overflows; so such layers are refused before they are composed.

use openusd::pcp::{LayerId, PrimIndex};
use openusd::sdf::{AbstractData, FieldKey, Path, Value};
use openusd::usd::Stage;
use std::collections::{BTreeMap, BTreeSet};

/// The fields that hold such arcs, as they are spelled in text and in binary layers.
const FIELDS: [FieldKey; 2] = [FieldKey::InheritPaths, FieldKey::Specializes];

/// Class arcs of all layers read so far: prim path → targets. Arcs of different layers count together, because they
/// may be composed together.
#[derive(Debug, Default)]
pub(super) struct ClassArcs(BTreeMap<Path, BTreeSet<Path>>);

impl ClassArcs {
    /// Add the arcs of `layer`.
    ///
    /// # Errors
    /// When they close a cycle, with a path on it.
    pub(super) fn add(&mut self, layer: &dyn AbstractData) -> Result<(), String> {
        let mut added = Vec::new();
        for path in layer.spec_paths() {
            for field in FIELDS {
                let Ok(Some(value)) = layer.try_field(&path, field.as_str()) else {
                    continue;
                };
                let Value::PathListOp(targets) = value.as_ref() else {
                    continue;
                };
                let from = path.strip_all_variant_selections();
                let targets = targets.flatten();
                let targets = targets
                    .iter()
                    .map(|target| path.make_absolute(target).strip_all_variant_selections());
                let targets: Vec<Path> = targets.collect();
                added.push(from.clone());
                added.extend(targets.iter().cloned());
                self.0.entry(from).or_default().extend(targets);
            }
        }
        let cyclic = added.into_iter().find(|path| self.returns(path));
        match cyclic {
            Some(path) => Err(format!(
                "the inherits and specializes of <{path}> lead back to it or run in circles"
            )),
            None => Ok(()),
        }
    }

    /// True if following arcs from `start` comes to the same prim twice on one way.
    fn returns(&self, start: &Path) -> bool {
        let mut done = BTreeSet::new();
        // (prim, its targets still to follow): a way, from `start` to the prim at hand
        let mut way = vec![(start.clone(), self.next(start))];
        while let Some((path, next)) = way.last_mut() {
            let Some(target) = next.pop() else {
                done.insert(path.clone());
                way.pop();
                continue;
            };
            if way.iter().any(|(on_way, _)| *on_way == target) {
                return true;
            }
            if !done.contains(&target) {
                let next = self.next(&target);
                way.push((target, next));
            }
        }
        false
    }

    /// Where the crate goes on from `path`: the arcs of the prim and of its parent.
    fn next(&self, path: &Path) -> Vec<Path> {
        let own = self.0.get(path);
        let above = path.parent().and_then(|parent| self.0.get(&parent));
        own.into_iter().chain(above).flatten().cloned().collect()
    }
}

/// True if composing a child of the prim at `path` would not end: a class arc on one of the prim's own sites comes out,
/// mapped to the stage, as a child of the prim, for which the crate would look at the same sites again.
pub(super) fn children_run_in_circles(stage: &Stage, index: &PrimIndex, path: &Path) -> bool {
    index.nodes().filter(|node| node.has_specs()).any(|node| {
        let layers = stage.node_layer_stack(node).into_iter();
        let mut targets = layers.flat_map(|(id, _)| class_targets(stage, id, node.path()));
        targets.any(|target| {
            let mut mapped = index
                .nodes()
                .filter_map(|node| node.map_to_root().map_source_to_target(&target));
            target.parent().as_ref() == Some(path)
                || mapped.any(|mapped| mapped.parent().as_ref() == Some(path))
        })
    })
}

fn class_targets(stage: &Stage, layer: LayerId, at: &Path) -> Vec<Path> {
    let mut targets = Vec::new();
    let identifier = stage.layer_identifier(layer).unwrap_or_default();
    let Some(layer) = stage.layer(&identifier) else {
        return targets;
    };
    for field in FIELDS {
        if let Ok(Some(value)) = layer.data().try_field(at, field.as_str())
            && let Value::PathListOp(list) = value.as_ref()
        {
            targets.extend(
                list.flatten()
                    .iter()
                    .map(|target| at.make_absolute(target).strip_all_variant_selections()),
            );
        }
    }
    targets
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(text: &str) -> Result<(), String> {
        let data = openusd::usda::parse(&format!("#usda 1.0\n{text}")).unwrap();
        ClassArcs::default().add(&data)
    }

    #[test]
    fn arcs_that_run_in_circles_are_found() {
        assert!(judged("def \"W\" (inherits = </W/C>) { def \"C\" {} }").is_err());
        assert!(
            judged(
                "def \"W\" { def \"a\" (inherits = </W/b>) {} def \"b\" (specializes = </W/a>) {} }"
            )
            .is_err()
        );
        assert!(judged("def \"W\" { def \"a\" (inherits = </W/a>) {} }").is_err());
    }

    /// The crate cuts these by itself, but not where an arc from elsewhere leads into the circle.
    #[test]
    fn circles_of_root_prims_are_found() {
        assert!(judged("def \"I\" (inherits = </J>) {} def \"J\" (inherits = </I>) {}").is_err());
        assert!(judged("def \"I\" (specializes = </I>) {}").is_err());
    }

    #[test]
    fn usual_classes_pass() {
        assert!(judged("class \"C\" { class \"D\" {} def \"x\" (inherits = </C/D>) {} }\ndef \"P\" (inherits = </C>) {}").is_ok());
        assert!(judged("def \"A\" (inherits = [</B>, </C>]) {} def \"B\" (inherits = </C>) {} class \"C\" {}").is_ok());
    }
}
