//! Where on the stage the values of a prim can be written: its own path, or a place its instances share.

use crate::diagnostics::Diagnostics;
use crate::results::PrimvarSpan;
use crate::scene::{EnclosingInstance, Prim, PrimSource, Scene};
use std::collections::BTreeMap;

/// What becomes of prims below instances. USD ignores opinions below an instanceable prim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InstancePolicy {
    /// One set of values for all instances of a prototype, their average; instances stay instances.
    ///
    /// Native instances: every instance inherits a new class of the bake layer that holds the values (an arc on the
    /// instance itself is part of its prototype, opinions below it are not); an instance inside another inherits its
    /// own in the class of the outer one. Point instances: the values go to the prototype prim.
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
    /// Class to inherit by instance, or by what stands for it in the class of an outer one.
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
        (PrimSource::Direct, _) => Ok(prim.path.to_string()),
        (PrimSource::NativeInstance { instances, .. }, InstancePolicy::Shared) => {
            Ok(shared(prim, instances, classes, &mut targets.inherits))
        }
        (PrimSource::NativeInstance { instances, .. }, InstancePolicy::Deinstance) => {
            let paths = instances
                .iter()
                .map(|instance| instance.path_above(&prim.path));
            targets.deinstanced.extend(paths.map(str::to_owned));
            Ok(prim.path.to_string())
        }
        (PrimSource::NativeInstance { instances, .. }, InstancePolicy::Skip) => Err(Refusal {
            prim: instances
                .first()
                .map_or(&*prim.path, |outermost| outermost.path_above(&prim.path))
                .to_owned(),
            message: "instances are skipped, so what is below gets no baked values",
        }),
        (PrimSource::PointInstance { shared_path, .. }, InstancePolicy::Shared) => {
            Ok(shared_path.to_string())
        }
        (PrimSource::PointInstance { instancer, .. }, InstancePolicy::Deinstance) => Err(Refusal {
            prim: instancer.to_string(),
            message: "the points of a PointInstancer cannot hold values of their own, so its instances get no baked \
                      values; --instances shared writes their average to the prototypes",
        }),
        (PrimSource::PointInstance { instancer, .. }, InstancePolicy::Skip) => Err(Refusal {
            prim: instancer.to_string(),
            message: "instances are skipped, so its instances get no baked values",
        }),
    }
}

/// The place that all prims like `prim` share: below the class of the innermost of `instances`. Each instance inherits
/// its class where its own opinions count: on the stage, or in the class of the instance that encloses it.
fn shared(
    prim: &Prim,
    instances: &[EnclosingInstance],
    classes: &mut Classes,
    inherits: &mut BTreeMap<String, String>,
) -> String {
    // what stands for the stage path `above`: itself, then the class of each instance in turn
    let (mut above, mut stand_in) = ("", String::new());
    for instance in instances {
        let class = classes.of(&instance.first);
        let path = instance.path_above(&prim.path);
        inherits.insert(below(&stand_in, above, path), class.clone());
        (above, stand_in) = (path, class);
    }
    below(&stand_in, above, &prim.path)
}

/// `path` with `stand_in` for `above`, which encloses it.
fn below(stand_in: &str, above: &str, path: &str) -> String {
    let rest = path
        .strip_prefix(above)
        .expect("instances enclose what is below them");
    format!("{stand_in}{rest}")
}
