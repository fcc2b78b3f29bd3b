//! Where on the stage the values of a prim can be written: its own path, or a place its instances share.

use crate::diagnostics::Diagnostics;
use crate::results::PrimvarSpan;
use crate::scene::{Prim, PrimSource, Scene};
use std::collections::BTreeMap;

/// What becomes of prims below instances. USD ignores opinions below an instanceable prim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InstancePolicy {
    /// One set of values for all instances of a prototype, their average; instances stay instances.
    ///
    /// Native instances: every instance inherits a new class of the bake layer that holds the values (an arc on the
    /// instance itself is part of its prototype, opinions below it are not). Point instances: the values go to the
    /// prototype prim.
    #[default]
    Shared,
    /// Native instances are made uninstanceable and hold values of their own. Point instances are skipped with a
    /// warning: a point of a `PointInstancer` cannot hold values.
    Deinstance,
    /// No values for anything below an instance, with a warning.
    Skip,
}

/// The places to write to, in path order, and what has to be said of the instances above them.
#[derive(Debug, Default)]
pub(super) struct Targets<'a> {
    /// Spans that share each path; more than one are averaged.
    pub(super) spans: BTreeMap<String, Vec<&'a PrimvarSpan>>,
    /// Class to inherit by instance.
    pub(super) inherits: BTreeMap<String, String>,
    /// Instances that must not be instanceable any more.
    pub(super) deinstanced: Vec<String>,
}

/// Names the class of each prototype; kept over the frames of a bake.
#[derive(Debug, Default)]
pub(super) struct Classes(BTreeMap<String, String>);

impl Classes {
    /// Path of the class of the prototype whose first instance is `first_instance`.
    fn of(&mut self, first_instance: &str) -> String {
        let next = self.0.len() + 1;
        let new = || format!("/_surflux_shared_{next}");
        self.0
            .entry(first_instance.to_owned())
            .or_insert_with(new)
            .clone()
    }

    /// All classes so far.
    pub(super) fn paths(&self) -> impl Iterator<Item = &str> {
        self.0.values().map(String::as_str)
    }
}

/// Find the target of every span.
pub(super) fn find<'a>(
    scene: &Scene,
    spans: &'a [PrimvarSpan],
    policy: InstancePolicy,
    classes: &mut Classes,
    diagnostics: &Diagnostics,
) -> Targets<'a> {
    let mut targets = Targets::default();
    for span in spans {
        let prim = &scene.prims[span.prim.index()];
        match target(prim, policy, classes, &mut targets) {
            Ok(path) => targets.spans.entry(path).or_default().push(span),
            Err(refusal) => diagnostics.warn("instance-not-baked", refusal.prim, refusal.message),
        }
    }
    targets.deinstanced.sort();
    targets.deinstanced.dedup();
    targets
}

struct Refusal {
    prim: String,
    message: &'static str,
}

fn target(
    prim: &Prim,
    policy: InstancePolicy,
    classes: &mut Classes,
    targets: &mut Targets<'_>,
) -> Result<String, Refusal> {
    match (&prim.source, policy) {
        (PrimSource::Direct, _) => Ok(prim.path.clone()),
        (
            PrimSource::NativeInstance {
                instance_root,
                shared_path,
            },
            InstancePolicy::Shared,
        ) => {
            let below = prim.path.strip_prefix(instance_root.as_str());
            let split = below.and_then(|below| Some((below, shared_path.strip_suffix(below)?)));
            let (below, first_instance) = split.ok_or_else(|| Refusal {
                prim: instance_root.clone(),
                message: "its place in the shared prototype is unknown, so it gets no baked values",
            })?;
            let class = classes.of(first_instance);
            targets
                .inherits
                .insert(instance_root.clone(), class.clone());
            Ok(class + below)
        }
        (PrimSource::NativeInstance { instance_root, .. }, InstancePolicy::Deinstance) => {
            targets.deinstanced.push(instance_root.clone());
            Ok(prim.path.clone())
        }
        (PrimSource::NativeInstance { instance_root, .. }, InstancePolicy::Skip) => Err(Refusal {
            prim: instance_root.clone(),
            message: "instances are skipped, so what is below gets no baked values",
        }),
        (PrimSource::PointInstance { shared_path, .. }, InstancePolicy::Shared) => {
            Ok(shared_path.clone())
        }
        (PrimSource::PointInstance { instancer, .. }, InstancePolicy::Deinstance) => Err(Refusal {
            prim: instancer.clone(),
            message: "the points of a PointInstancer cannot hold values of their own, so its instances get no baked \
                      values; --instances shared writes their average to the prototypes",
        }),
        (PrimSource::PointInstance { instancer, .. }, InstancePolicy::Skip) => Err(Refusal {
            prim: instancer.clone(),
            message: "instances are skipped, so its instances get no baked values",
        }),
    }
}
