//! Arcs that lead back to where they start by way of a relocation (what a prim holds is moved to where the prim refers
//! to) or of an inherit or specialize. The crate follows them without an end in sight, so the layer that closes a circle
//! is refused before it is composed. Circles of references and payloads alone the crate finds itself.

use super::list_ops::added;
use openusd::sdf::{AbstractData, FieldKey, Path, Value};
use std::collections::{BTreeMap, BTreeSet};

/// What to look for in text, and the field of binary layers.
pub(super) const WORDS: [&str; 2] = ["relocates", "layerRelocates"];

/// The fields that refer to prims.
const ARCS: [FieldKey; 4] = [
    FieldKey::References,
    FieldKey::Payload,
    FieldKey::InheritPaths,
    FieldKey::Specializes,
];

/// Sites to follow from one prim; more than this do not come to an end in reasonable time.
const MOST_SITES: usize = 20_000;

/// Arcs in a row; longer ways are not followed.
const LONGEST_WAY: usize = 100;

/// What the layers of a stage move and refer to. Variants count as if all were chosen, and deleted items as if kept.
#[derive(Debug, Default)]
pub(super) struct Arcs {
    layers: BTreeMap<String, Layer>,
}

/// What counts of a layer; other layers by their identifiers, prims without variants.
#[derive(Debug, Default)]
struct Layer {
    sublayers: Vec<String>,
    default_prim: Option<Path>,
    /// (from, to)
    moves: Vec<(Path, Path)>,
    arcs: BTreeMap<Path, Vec<Arc>>,
}

/// Where a prim refers to.
#[derive(Debug)]
struct Arc {
    /// The root of the layer stack; `None`: that of the prim.
    layer: Option<String>,
    /// `None`: the default prim.
    target: Option<Path>,
    /// An inherit or specialize, which the stacks that refer to its prim take up too.
    is_class: bool,
}

/// A prim of a layer stack (called by its root) on a way of arcs, and the last of these.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Site {
    stack: String,
    path: Path,
    /// From and to in the names of the two stacks.
    arc: (Path, Path),
    /// The last arc is a relocation or a class arc.
    counts: bool,
}

/// Following arcs from one prim.
struct Walk<'a> {
    all: &'a Arcs,
    way: Vec<Site>,
    done: BTreeSet<(String, Path)>,
    /// Circles of references alone count too: the crate does not find them behind a relocation.
    of_any_arc: bool,
}

impl Arcs {
    /// Take in the layer `identifier`; `anchored` makes identifiers of the asset paths in it.
    pub(super) fn add(
        &mut self,
        identifier: &str,
        data: &dyn AbstractData,
        anchored: &dyn Fn(&str) -> String,
    ) {
        let layer = Layer::of(data, anchored);
        self.layers.insert(identifier.to_owned(), layer);
    }

    /// # Errors
    /// When arcs lead from where a prim is moved to back to there or below, with the relocation.
    pub(super) fn check_moves(&self) -> Result<(), String> {
        for root in self.layers.keys() {
            let stack = self.stack(root);
            for (from, to) in stack.iter().flat_map(|layer| &layer.moves) {
                if Walk::new(self).of_any_arc().returns(root, to) {
                    return Err(format!(
                        "relocates move <{from}> to <{to}>, and what is there refers to itself by way of that: it would hold itself without end"
                    ));
                }
            }
            if stack.iter().any(|layer| !layer.moves.is_empty()) {
                self.check_stack(root)?;
            }
        }
        Ok(())
    }

    /// # Errors
    /// When arcs of the layer `root`, or of those below it, lead back to their prim or below it, with its path.
    pub(super) fn check_stack(&self, root: &str) -> Result<(), String> {
        let layers = self.stack(root).into_iter();
        for prim in layers.flat_map(|layer| layer.arcs.keys()) {
            if Walk::new(self).returns(root, prim) {
                return Err(format!(
                    "the inherits, specializes or relocates of <{prim}>, and what they refer to, lead back to it: it would hold itself without end"
                ));
            }
        }
        Ok(())
    }

    /// The layer `root` and those below it, as far as they are known.
    fn stack<'a>(&'a self, root: &'a str) -> Vec<&'a Layer> {
        let mut met: Vec<(&str, &Layer)> = Vec::new();
        let mut next = vec![root];
        while let Some(identifier) = next.pop() {
            let Some(layer) = self.layers.get(identifier) else {
                continue;
            };
            if met.iter().all(|(known, _)| *known != identifier) {
                met.push((identifier, layer));
                next.extend(layer.sublayers.iter().map(String::as_str));
            }
        }
        met.into_iter().map(|(_, layer)| layer).collect()
    }
}

impl<'a> Walk<'a> {
    fn new(all: &'a Arcs) -> Self {
        Self {
            all,
            way: Vec::new(),
            done: BTreeSet::new(),
            of_any_arc: false,
        }
    }

    fn of_any_arc(mut self) -> Self {
        self.of_any_arc = true;
        self
    }

    /// True if a way from the prim at `path` comes to it again, or to one below or above it, by an arc that counts; so for
    /// all prims on the way.
    fn returns(&mut self, stack: &str, path: &Path) -> bool {
        let start = Site {
            stack: stack.to_owned(),
            path: path.clone(),
            arc: (path.clone(), path.clone()),
            counts: false,
        };
        let next = self.enter(start);
        let mut open = vec![next];
        while let Some(next) = open.last_mut() {
            let Some(site) = next.pop() else {
                open.pop();
                self.way.pop();
                continue;
            };
            if self.closes(&site) || self.done.len() > MOST_SITES {
                return true;
            }
            let key = (site.stack.clone(), site.path.clone());
            if self.way.len() < LONGEST_WAY && self.done.insert(key) {
                let next = self.enter(site);
                open.push(next);
            }
        }
        false
    }

    fn enter(&mut self, site: Site) -> Vec<Site> {
        self.way.push(site);
        self.next()
    }

    /// True if `site` is one of the way or below one of it, with an arc that counts between; or if it is above one of it and
    /// a reference or payload is between too: what is above holds the prim itself, with its arcs. (That a prim inherits
    /// what is above it the crate finds itself.)
    fn closes(&self, site: &Site) -> bool {
        let (mut counts, mut refers) = (site.counts || self.of_any_arc, !site.counts);
        for earlier in self.way.iter().rev() {
            let is_below = site.path.has_prefix(&earlier.path);
            let is_above = refers && earlier.path.has_prefix(&site.path);
            if counts && earlier.stack == site.stack && (is_below || is_above) {
                return true;
            }
            counts |= earlier.counts;
            refers |= !earlier.counts;
        }
        false
    }

    /// Where the last site of the way leads to.
    fn next(&self) -> Vec<Site> {
        let Some(site) = self.way.last() else {
            return Vec::new();
        };
        let mut next = Vec::new();
        for layer in self.all.stack(&site.stack) {
            let moved = layer
                .moves
                .iter()
                .filter_map(|(from, to)| site.to(&site.stack, to, from, true));
            next.extend(moved);
            for above in site.path.ancestors_below_root() {
                for arc in layer.arcs.get(&above).into_iter().flatten() {
                    self.follow(site, &above, arc, &mut next);
                }
            }
        }
        next
    }

    fn follow(&self, site: &Site, above: &Path, arc: &Arc, next: &mut Vec<Site>) {
        let stack = arc.layer.as_ref().unwrap_or(&site.stack);
        let default = || {
            let root = self.all.layers.get(stack)?;
            root.default_prim.clone()
        };
        let Some(target) = arc.target.clone().or_else(default) else {
            return;
        };
        let Some(found) = site.to(stack, above, &target, arc.is_class) else {
            return;
        };
        if arc.is_class {
            self.imply(&found, next);
        }
        next.push(found);
    }

    /// The prims that stand for the class at `site` in the stacks by which the way came.
    fn imply(&self, site: &Site, next: &mut Vec<Site>) {
        let mut path = site.path.clone();
        for pair in self.way.windows(2).rev() {
            let [outer, inner] = pair else { continue };
            let (from, to) = &inner.arc;
            path = path.replace_prefix(to, from).unwrap_or(path);
            next.push(Site {
                stack: outer.stack.clone(),
                path: path.clone(),
                ..site.clone()
            });
        }
    }
}

impl Site {
    /// The site that the arc `from` → `target` leads to; `None` if the site is not below `from`.
    fn to(&self, stack: &str, from: &Path, target: &Path, counts: bool) -> Option<Self> {
        let is_below = self.path.has_prefix(from);
        let path = is_below.then(|| self.path.replace_prefix(from, target))??;
        Some(Self {
            stack: stack.to_owned(),
            path,
            arc: (from.clone(), target.clone()),
            counts,
        })
    }
}

impl Layer {
    fn of(data: &dyn AbstractData, anchored: &dyn Fn(&str) -> String) -> Self {
        let mut layer = Self::default();
        let root = Path::abs_root();
        let field = |path: &Path, key: FieldKey| {
            let value = data.try_field(path, key.as_str());
            value.ok().flatten().map(std::borrow::Cow::into_owned)
        };
        if let Some(Value::StringVec(paths)) = field(&root, FieldKey::SubLayers) {
            layer.sublayers = paths.iter().map(|path| anchored(path)).collect();
        }
        if let Some(Value::Token(name)) = field(&root, FieldKey::DefaultPrim) {
            let path = Path::new(&format!("/{}", name.as_str().trim_start_matches('/')));
            layer.default_prim = path.ok();
        }
        for path in data.spec_paths() {
            if path.is_property_path() {
                continue;
            }
            for key in [FieldKey::LayerRelocates, FieldKey::Relocates] {
                if let Some(Value::Relocates(pairs)) = field(&path, key) {
                    let absolute = pairs
                        .iter()
                        .map(|(from, to)| (path.make_absolute(from), path.make_absolute(to)));
                    layer.moves.extend(absolute.filter(is_valid));
                }
            }
            let arcs = ARCS.into_iter().filter_map(|key| field(&path, key));
            let arcs: Vec<Arc> = arcs
                .flat_map(|value| arcs_of(&path, value, anchored))
                .collect();
            if !arcs.is_empty() {
                let prim = path.strip_all_variant_selections();
                layer.arcs.entry(prim).or_default().extend(arcs);
            }
        }
        layer
    }
}

/// USD ignores other relocations, and those that take a prim away lead nowhere.
fn is_valid((from, to): &(Path, Path)) -> bool {
    !to.is_empty() && from.prim_element_count() > 1 && !from.is_nested_with(to)
}

fn arcs_of(path: &Path, value: Value, anchored: &dyn Fn(&str) -> String) -> Vec<Arc> {
    let arc = |asset: &str, target: &Path, is_class| Arc {
        layer: (!asset.is_empty()).then(|| anchored(asset)),
        target: (!target.is_empty())
            .then(|| path.make_absolute(target).strip_all_variant_selections()),
        is_class,
    };
    match value {
        Value::ReferenceListOp(list) => added(&list)
            .map(|item| arc(&item.asset_path, &item.prim_path, false))
            .collect(),
        Value::PayloadListOp(list) => added(&list)
            .map(|item| arc(&item.asset_path, &item.prim_path, false))
            .collect(),
        Value::Payload(item) => vec![arc(&item.asset_path, &item.prim_path, false)],
        Value::PathListOp(list) => added(&list).map(|item| arc("", item, true)).collect(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(layers: &[(&str, &str)]) -> Result<(), String> {
        let mut all = Arcs::default();
        for (name, text) in layers {
            let data = openusd::usda::parse(&format!("#usda 1.0\n{text}")).unwrap();
            all.add(name, &data, &|asset| asset.to_owned());
        }
        all.check_moves()?;
        layers
            .iter()
            .try_for_each(|(name, _)| all.check_stack(name))
    }

    #[test]
    fn arcs_into_what_is_moved_out_of_their_own_prim_are_found() {
        for arc in [
            "references = </W/moved>",
            "prepend references = @root@</W/moved/deep>",
            "payload = </W/moved>",
            "inherits = </W/moved>",
        ] {
            let text = format!(
                "( relocates = {{ </W/A/x>: </W/moved> }} )\ndef \"W\" {{ def \"A\" ( {arc} ) {{}} }}"
            );
            let message = judged(&[("root", &text)]).unwrap_err();
            assert!(message.contains("</W/moved>"), "{message}");
        }
    }

    #[test]
    fn circles_through_other_prims_and_layers_are_found() {
        let relocates = "( relocates = { </W/A/x>: </W/moved> } )\n";
        let by_way = "def \"W\" { def \"A\" ( references = </W/B> ) {} def \"B\" ( references = </W/moved> ) {} }";
        assert!(judged(&[("root", &format!("{relocates}{by_way}"))]).is_err());
        let top = "( subLayers = [@moves@, @refers@] )";
        let refers = "def \"W\" { def \"A\" ( references = @top@</W/moved> ) {} }";
        let layers = [("top", top), ("moves", relocates), ("refers", refers)];
        assert!(judged(&layers).is_err());
        assert_eq!(judged(&layers[1..]), Ok(()));
    }

    #[test]
    fn circles_of_classes_and_references_are_found() {
        let text = "def \"W\" { def \"c\" ( specializes = </W/b> ) {} def \"b\" { def \"a\" ( references = </W/c/a> ) {} } }";
        assert!(judged(&[("root", text)]).is_err());
        let usual = "class \"C\" {} def \"W\" { def \"a\" ( references = </W/b> ) {} def \"b\" ( inherits = </C> ) {} }";
        assert_eq!(judged(&[("root", usual)]), Ok(()));
    }

    /// What `b` refers to holds all of `a`, `b` itself included.
    #[test]
    fn circles_by_way_of_a_class_above_are_found() {
        let text = "def \"W\" { def \"a\" { def \"b\" ( references = </D> ) {} } } def \"D\" ( payload = </K> ) {} def \"K\" ( specializes = </W/a> ) {}";
        let message = judged(&[("root", text)]).unwrap_err();
        assert!(message.contains("lead back"), "{message}");
        let beside = "def \"W\" { class \"k\" {} def \"a\" { def \"b\" ( inherits = </W/k> ) {} } } def \"D\" ( references = </W/a> ) {}";
        assert_eq!(judged(&[("root", beside)]), Ok(()));
    }

    #[test]
    fn usual_relocates_pass() {
        let relocates = "( relocates = { </W/A/x>: </W/moved>, </W/A/y>: <> } )\n";
        let usual = "def \"W\" { def \"A\" ( references = </Kit> ) {} def \"B\" ( references = </W/moved> ) {} }";
        assert_eq!(judged(&[("root", &format!("{relocates}{usual}"))]), Ok(()));
        assert_eq!(
            judged(&[("root", "def \"A\" ( references = </A/b> ) {}")]),
            Ok(())
        );
    }
}
