//! Native instances unfolded, transforms, visibility and purpose inherited: every prim once for each time it occurs.
//!
//! The rules are UsdGeom's: xformOps count on Xformable prims only; any invisible ancestor makes a prim invisible; the
//! nearest authored `purpose` on the prim or an ancestor wins (`UsdGeomImageable::ComputePurpose`). Linear in the
//! number of occurrences; no recursion, so deep hierarchies cannot overflow the stack.

use super::super::ReadSettings;
use super::super::raw::{RawPrim, RawStage, Value};
use super::xform;
use crate::diagnostics::Diagnostics;
use crate::scene::{EnclosingInstance, PrimSource, Purpose};
use glam::DMat4;
use std::collections::HashMap;
use std::sync::Arc;

/// One occurrence of a prim on the flattened stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Occurrence {
    /// Index into `RawStage::prims`. For a native instance: the instance prim itself (its prototype root adds no
    /// occurrence of its own; the prototype's children follow as children of the instance).
    pub prim: usize,
    /// Occurrence index of the parent.
    pub parent: Option<usize>,
    /// Stage path (instance-proxy path below instances).
    pub path: String,
    /// Absolute world transform, column vectors.
    pub world_from_local: DMat4,
    /// Inherited visibility.
    pub visible: bool,
    /// Inherited purpose.
    pub purpose: Purpose,
    /// Where it comes from (never `PointInstance` here).
    pub source: PrimSource,
}

/// Flatten `raw`, depth first, parents before children. Subtrees of `PointInstancer` prims are included like any
/// other (the geometry pass decides that prototypes below an instancer are not drawn by themselves); invisible prims
/// are included with `visible = false`, and no purpose is left out: `settings` only names what later passes keep.
///
/// Flawed xformOps are left out with a warning, an unknown purpose counts as `guide`.
pub fn flatten(
    raw: &RawStage,
    _settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Vec<Occurrence> {
    let children = Children::of(raw);
    let mut unfolded = Unfolding {
        raw,
        diagnostics,
        occurrences: Vec::with_capacity(raw.prims.len()),
        first_paths: vec![None; raw.prims.len()],
        first_instance: vec![None; raw.prims.len()],
        no_instances: Arc::new([]),
        enclosing: HashMap::new(),
    };
    let stage_prims = raw.prims.iter().take(raw.prototype_start).enumerate();
    let mut pending: Vec<Pending> = stage_prims
        .filter(|(_, prim)| prim.parent.is_none())
        .map(|(prim, _)| Pending {
            prim,
            parent: None,
            instance_depth: 0,
        })
        .rev()
        .collect();
    while let Some(next) = pending.pop() {
        let occurrence = unfolded.add(&next);
        let Some((below, instance_depth)) = unfolded.content_of(&next, raw) else {
            continue;
        };
        pending.extend(children.of_prim(below).iter().rev().map(|&prim| Pending {
            prim,
            parent: Some(occurrence),
            instance_depth,
        }));
    }
    unfolded.occurrences
}

/// A prim still to be added.
struct Pending {
    prim: usize,
    parent: Option<usize>,
    instance_depth: usize,
}

/// Child indices of every prim, in stage order.
struct Children {
    offsets: Vec<usize>,
    children: Vec<usize>,
}

impl Children {
    fn of(raw: &RawStage) -> Self {
        let mut offsets = vec![0; raw.prims.len() + 1];
        for parent in raw.prims.iter().filter_map(|prim| prim.parent) {
            offsets[parent + 1] += 1;
        }
        for i in 0..raw.prims.len() {
            offsets[i + 1] += offsets[i];
        }
        let mut next = offsets.clone();
        let mut children = vec![0; offsets[raw.prims.len()]];
        for (index, prim) in raw.prims.iter().enumerate() {
            if let Some(parent) = prim.parent {
                children[next[parent]] = index;
                next[parent] += 1;
            }
        }
        Self { offsets, children }
    }

    fn of_prim(&self, prim: usize) -> &[usize] {
        &self.children[self.offsets[prim]..self.offsets[prim + 1]]
    }
}

struct Unfolding<'a> {
    raw: &'a RawStage,
    diagnostics: &'a Diagnostics,
    occurrences: Vec<Occurrence>,
    /// Path of the first occurrence of every prim below a prototype.
    first_paths: Vec<Option<Arc<str>>>,
    /// Path of the first instance of every prototype root.
    first_instance: Vec<Option<Arc<str>>>,
    no_instances: Arc<[EnclosingInstance]>,
    /// Instances above, by those above the innermost of them, the length of its path, and its prototype.
    enclosing: HashMap<(*const EnclosingInstance, usize, usize), Arc<[EnclosingInstance]>>,
}

impl Unfolding<'_> {
    /// The prim whose children stand below `pending`, and how many instances enclose them. `None` where a prototype
    /// contains itself, which composition rules out but a damaged door could deliver.
    fn content_of(&self, pending: &Pending, raw: &RawStage) -> Option<(usize, usize)> {
        let Some(prototype) = raw.prims[pending.prim].prototype else {
            return Some((pending.prim, pending.instance_depth));
        };
        let depth = pending.instance_depth + 1;
        let prototypes = &raw.prims[raw.prototype_start..];
        if depth > prototypes.len() {
            self.diagnostics.warn(
                "cyclic-instance",
                raw.prims[pending.prim].path.clone(),
                "the prototype contains an instance of itself; it is unfolded no further",
            );
            return None;
        }
        Some((prototype, depth))
    }

    fn add(&mut self, pending: &Pending) -> usize {
        let prim = &self.raw.prims[pending.prim];
        let path = match pending.parent.map(|index| &self.occurrences[index]) {
            None => prim.path.clone(),
            Some(parent) => format!("{}/{}", parent.path, name_of(&prim.path)),
        };
        let source = self.source(pending, &path);
        let parent = pending.parent.map(|index| &self.occurrences[index]);
        let local = xform::local(prim);
        let world_from_parent = match parent {
            Some(parent) if !local.resets_stack => parent.world_from_local,
            _ => DMat4::IDENTITY,
        };
        let occurrence = Occurrence {
            prim: pending.prim,
            parent: pending.parent,
            world_from_local: world_from_parent * local.parent_from_local,
            visible: parent.is_none_or(|parent| parent.visible) && !is_invisible(prim),
            purpose: authored_purpose(prim, self.diagnostics)
                .or(parent.map(|parent| parent.purpose))
                .unwrap_or_default(),
            source,
            path,
        };
        if local.flawed_op_count > 0 {
            self.diagnostics.warn(
                "flawed-xform",
                prim.path.clone(),
                format!(
                    "{} entries of xformOpOrder have no usable op and count as identity",
                    local.flawed_op_count
                ),
            );
        }
        let index = self.occurrences.len();
        if let Some(prototype) = prim.prototype {
            let path = &occurrence.path;
            self.first_instance[prototype].get_or_insert_with(|| Arc::from(path.as_str()));
        }
        self.occurrences.push(occurrence);
        index
    }

    fn source(&mut self, pending: &Pending, path: &str) -> PrimSource {
        if pending.instance_depth == 0 {
            return PrimSource::Direct;
        }
        let instances = match pending.parent {
            Some(parent) => self.instances_down_to(parent),
            None => self.no_instances.clone(),
        };
        let first = &mut self.first_paths[pending.prim];
        PrimSource::NativeInstance {
            instances,
            shared_path: first.get_or_insert_with(|| Arc::from(path)).clone(),
        }
    }

    /// The instances above the children of `occurrence`.
    fn instances_down_to(&mut self, occurrence: usize) -> Arc<[EnclosingInstance]> {
        let Occurrence {
            prim, path, source, ..
        } = &self.occurrences[occurrence];
        let above = match source {
            PrimSource::NativeInstance { instances, .. } => instances.clone(),
            _ => self.no_instances.clone(),
        };
        let Some(prototype) = self.raw.prims[*prim].prototype else {
            return above;
        };
        // those above are kept here too, so that no two of them are ever at one address
        let key = (above.as_ptr(), path.len(), prototype);
        let first = &self.first_instance[prototype];
        let all = self.enclosing.entry(key).or_insert_with(|| {
            let this = EnclosingInstance {
                path_length: path.len(),
                first: first.clone().unwrap_or_else(|| Arc::from(path.as_str())),
            };
            above.iter().cloned().chain([this]).collect()
        });
        all.clone()
    }
}

/// The last element of a prim path.
pub(super) fn name_of(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// True if `visibility` is authored as `invisible` on an imageable prim (prims without type are not imageable).
pub(super) fn is_invisible(prim: &RawPrim) -> bool {
    !prim.type_name.is_empty() && token(prim, "visibility") == Some("invisible")
}

/// The purpose authored on `prim` itself.
pub(super) fn authored_purpose(prim: &RawPrim, diagnostics: &Diagnostics) -> Option<Purpose> {
    if prim.type_name.is_empty() {
        return None;
    }
    let word = token(prim, "purpose")?;
    Some(Purpose::from_token(word).unwrap_or_else(|| {
        diagnostics.warn(
            "unknown-purpose",
            prim.path.clone(),
            format!("purpose {word:?} is none of default, render, proxy, guide; taken as guide"),
        );
        Purpose::Guide
    }))
}

fn token<'a>(prim: &'a RawPrim, name: &str) -> Option<&'a str> {
    match prim.attributes.get(name)?.value.as_ref()? {
        Value::Token(word) => Some(word),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::raw::RawAttribute;
    use super::*;
    use glam::DVec3;

    fn prim(path: &str, type_name: &str, parent: Option<usize>) -> RawPrim {
        RawPrim::typed(path, type_name, parent)
    }

    fn with(mut prim: RawPrim, name: &str, value: Value) -> RawPrim {
        let attribute = RawAttribute::from(value);
        prim.attributes.insert(name.into(), attribute);
        prim
    }

    fn moved(prim: RawPrim, x: f64) -> RawPrim {
        let order = Value::TokenArray(vec!["xformOp:translate".into()]);
        let prim = with(prim, "xformOpOrder", order);
        with(
            prim,
            "xformOp:translate",
            Value::Vec3(DVec3::new(x, 0.0, 0.0)),
        )
    }

    fn instance(mut prim: RawPrim, prototype: usize) -> RawPrim {
        prim.prototype = Some(prototype);
        prim
    }

    fn flat(prims: Vec<RawPrim>, prototype_start: usize) -> Vec<Occurrence> {
        let raw = RawStage {
            prims,
            prototype_start,
            ..RawStage::default()
        };
        flatten(&raw, &ReadSettings::default(), &Diagnostics::default())
    }

    #[test]
    fn nested_instances_unfold_in_stage_order_with_shared_paths() {
        let prims = vec![
            moved(instance(prim("/A", "Xform", None), 2), 1.0),
            moved(instance(prim("/B", "Xform", None), 2), 2.0),
            prim("/__Prototype_1", "Xform", None),
            moved(
                instance(prim("/__Prototype_1/n", "Xform", Some(2)), 4),
                10.0,
            ),
            prim("/__Prototype_2", "Xform", None),
            moved(prim("/__Prototype_2/m", "Mesh", Some(4)), 100.0),
        ];
        let flat = flat(prims, 2);
        let paths: Vec<_> = flat.iter().map(|o| o.path.as_str()).collect();
        assert_eq!(paths, ["/A", "/A/n", "/A/n/m", "/B", "/B/n", "/B/n/m"]);
        assert_eq!(flat[5].world_from_local.w_axis.x, 112.0);
        assert_eq!(flat[3].source, PrimSource::Direct);
        assert_eq!(
            flat[5].source,
            PrimSource::NativeInstance {
                instances: Arc::new([
                    EnclosingInstance {
                        path_length: "/B".len(),
                        first: "/A".into(),
                    },
                    EnclosingInstance {
                        path_length: "/B/n".len(),
                        first: "/A/n".into(),
                    },
                ]),
                shared_path: "/A/n/m".into(),
            }
        );
    }

    #[test]
    fn any_invisible_ancestor_hides_and_the_nearest_purpose_wins() {
        let token = |word: &str| Value::Token(word.into());
        let prims = vec![
            with(prim("/a", "Xform", None), "purpose", token("proxy")),
            with(
                prim("/a/b", "Scope", Some(0)),
                "visibility",
                token("invisible"),
            ),
            with(
                prim("/a/b/c", "Mesh", Some(1)),
                "visibility",
                token("inherited"),
            ),
            with(prim("/a/d", "Mesh", Some(0)), "purpose", token("default")),
            with(prim("/e", "", None), "visibility", token("invisible")),
            prim("/e/f", "Mesh", Some(4)),
        ];
        let flat = flat(prims, 6);
        let visible: Vec<_> = flat.iter().map(|o| o.visible).collect();
        assert_eq!(visible, [true, false, false, true, true, true]);
        let purposes: Vec<_> = flat.iter().map(|o| o.purpose).collect();
        use Purpose::{Default, Proxy};
        assert_eq!(purposes, [Proxy, Proxy, Proxy, Default, Default, Default]);
    }

    #[test]
    fn untyped_prims_and_scopes_do_not_move_their_children_as_in_usd_core() {
        let prims = vec![
            moved(prim("/p", "", None), 100.0),
            moved(prim("/p/q", "Scope", Some(0)), 10.0),
            moved(prim("/p/q/a", "Xform", Some(1)), 1.0),
        ];
        assert_eq!(flat(prims, 3)[2].world_from_local.w_axis.x, 1.0);
    }

    #[test]
    fn a_prototype_inside_itself_ends_with_a_warning() {
        let prims = vec![
            instance(prim("/A", "Xform", None), 1),
            prim("/__Prototype_1", "Xform", None),
            instance(prim("/__Prototype_1/n", "Xform", Some(1)), 1),
        ];
        let raw = RawStage {
            prims,
            prototype_start: 1,
            ..RawStage::default()
        };
        let diagnostics = Diagnostics::default();
        let flat = flatten(&raw, &ReadSettings::default(), &diagnostics);
        assert!(flat.len() < 10);
        assert_eq!(diagnostics.warnings()[0].kind, "cyclic-instance");
    }

    #[test]
    fn a_hundred_thousand_instances_and_a_chain_of_as_many_prims_take_linear_time() {
        let count = 100_000;
        let mut prims: Vec<RawPrim> = (0..count)
            .map(|i| instance(prim(&format!("/i{i}"), "Xform", None), count))
            .collect();
        prims.push(prim("/__Prototype_1", "Xform", None));
        prims.push(prim("/__Prototype_1/m", "Mesh", Some(count)));
        let start = std::time::Instant::now();
        assert_eq!(flat(prims, count).len(), 2 * count);
        let seconds = start.elapsed().as_secs_f64();
        assert!(seconds < 1.0, "took {seconds} s");
    }

    #[test]
    fn deep_hierarchies_do_not_overflow_the_stack() {
        let chain = (0..5_000)
            .map(|i| prim(&format!("/x{i}"), "Xform", (i > 0).then(|| i - 1)))
            .collect();
        assert_eq!(flat(chain, 5_000).len(), 5_000);
    }
}
