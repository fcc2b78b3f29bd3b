//! What is drawn where: every visible gprim occurrence and every point of every PointInstancer, in traversal order.
//!
//! Transforms of points are those of `UsdGeomPointInstancer::ComputeInstanceTransformsAtTime` with the prototype's own
//! transform included: instancer × translation × orientation × scale × prototype root. What the prototype root's
//! ancestors say of transform, visibility or purpose does not reach the points; the instancer's does.

use super::super::super::ReadSettings;
use super::super::super::raw::{RawAttribute, RawPrim, RawStage};
use super::super::DEFAULT_TIME_CODES_PER_SECOND;
use super::super::flatten::{Occurrence, authored_purpose, is_invisible};
use super::super::xform;
use super::curves;
use super::draw_modes;
use super::gprims;
use super::instancer::{self, Moment, Point};
use crate::diagnostics::Diagnostics;
use crate::scene::{PrimSource, Purpose};
use glam::DMat4;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// One thing to draw.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Placement {
    /// Occurrence whose raw prim is the geometry and whose binding applies.
    pub(super) occurrence: usize,
    /// Absolute.
    pub(super) world_from_object: DMat4,
    pub(super) path: Arc<str>,
    pub(super) purpose: Purpose,
    pub(super) source: PrimSource,
}

/// How a prim takes part in drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Mesh,
    Gprim,
    Curves,
    Patch,
    Points,
    Instancer,
    /// Would be drawn by others.
    Unsupported,
    Nothing,
}

const UNSUPPORTED: [&str; 7] = [
    "HermiteCurves",
    "TetMesh",
    "Volume",
    "GenerativeProcedural",
    "ParticleField",
    "ParticleField3DGaussianSplat",
    "GaussianSplats",
];

impl Kind {
    pub(super) fn of(prim: &RawPrim) -> Self {
        match prim.type_name.as_str() {
            "Mesh" => Self::Mesh,
            "BasisCurves" | curves::NURBS => Self::Curves,
            "NurbsPatch" => Self::Patch,
            "Points" => Self::Points,
            "PointInstancer" => Self::Instancer,
            name if gprims::TYPES.contains(&name) => Self::Gprim,
            name if UNSUPPORTED.contains(&name) => Self::Unsupported,
            _ => Self::Nothing,
        }
    }

    /// True if it is made into triangles.
    fn is_surface(self) -> bool {
        matches!(
            self,
            Self::Mesh | Self::Gprim | Self::Curves | Self::Patch | Self::Points
        )
    }
}

/// All placements of the stage that are visible and whose purpose is wanted. What cannot be drawn gives a warning.
pub(super) fn placements(
    raw: &RawStage,
    occurrences: &[Occurrence],
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Vec<Placement> {
    let mut walk = Walk {
        raw,
        occurrences,
        settings,
        diagnostics,
        subtree_ends: subtree_ends(occurrences),
        by_path: None,
        open_instancers: HashSet::new(),
    };
    draw_modes::warn(raw, occurrences, diagnostics);
    let mut placed = Vec::new();
    let mut next = 0;
    while let Some(occurrence) = occurrences.get(next) {
        let kind = Kind::of(&raw.prims[occurrence.prim]);
        let is_drawn = occurrence.visible && walk.is_wanted(occurrence.purpose);
        match kind {
            Kind::Instancer if is_drawn => walk.place_points(next, &mut placed),
            kind if kind.is_surface() && is_drawn => {
                walk.warn_of_what_is_not_applied(next);
                placed.push(Placement {
                    occurrence: next,
                    world_from_object: occurrence.world_from_local,
                    path: occurrence.path.as_str().into(),
                    purpose: occurrence.purpose,
                    source: occurrence.source.clone(),
                });
            }
            Kind::Unsupported if is_drawn => walk.warn_unsupported(next),
            _ => {}
        }
        next = match kind {
            Kind::Instancer => walk.subtree_ends[next],
            _ => next + 1,
        };
    }
    placed
}

/// True if the prim names what skins it, or lies inside a `SkelRoot` where it or an ancestor binds a skeleton (with or
/// without `SkelBindingAPI` applied: renderers differ, so the pose is in doubt either way).
fn is_skinned(raw: &RawStage, occurrences: &[Occurrence], occurrence: usize) -> bool {
    let prim = |at: usize| &raw.prims[occurrences[at].prim];
    let has_api = |prim: &RawPrim| prim.api_schemas.iter().any(|api| api == "SkelBindingAPI");
    if prim(occurrence).is_posed {
        return false;
    }
    if has_api(prim(occurrence)) {
        return true;
    }
    let binds = |prim: &RawPrim| {
        let skeleton = prim.relationships.get("skel:skeleton");
        skeleton.is_some_and(|skeleton| !skeleton.targets.is_empty())
    };
    let line = std::iter::successors(Some(occurrence), |&at| occurrences[at].parent);
    let mut is_bound = false;
    for at in line {
        is_bound |= binds(prim(at));
        if prim(at).type_name == "SkelRoot" {
            return is_bound;
        }
    }
    false
}

/// Index behind the last descendant of every occurrence.
fn subtree_ends(occurrences: &[Occurrence]) -> Vec<usize> {
    let mut ends: Vec<usize> = (1..=occurrences.len()).collect();
    for (index, occurrence) in occurrences.iter().enumerate().rev() {
        if let Some(parent) = occurrence.parent {
            ends[parent] = ends[parent].max(ends[index]);
        }
    }
    ends
}

/// A drawable below a prototype, relative to the space that the instancer places prototypes in.
#[derive(Debug, Clone)]
struct Part {
    occurrence: usize,
    instancer_from_object: DMat4,
    /// Path below the point, from the prototype root's name on.
    suffix: String,
    /// Authored below the instancer.
    purpose: Option<Purpose>,
    /// See [`PrimSource`].
    shared_path: Arc<str>,
}

struct Walk<'a> {
    raw: &'a RawStage,
    occurrences: &'a [Occurrence],
    settings: &'a ReadSettings,
    diagnostics: &'a Diagnostics,
    subtree_ends: Vec<usize>,
    /// Occurrences by path, made when the first instancer asks.
    by_path: Option<HashMap<&'a str, usize>>,
    /// Instancers being expanded: one inside itself would never end.
    open_instancers: HashSet<usize>,
}

impl<'a> Walk<'a> {
    fn prim(&self, occurrence: usize) -> &'a RawPrim {
        &self.raw.prims[self.occurrences[occurrence].prim]
    }

    fn is_wanted(&self, purpose: Purpose) -> bool {
        purpose == Purpose::Default || self.settings.purposes.contains(&purpose)
    }

    fn warn(&self, kind: &str, occurrence: usize, message: impl Into<String>) {
        let path = self.occurrences[occurrence].path.clone();
        self.diagnostics.warn(kind, path, message);
    }

    fn warn_unsupported(&self, occurrence: usize) {
        let type_name = &self.prim(occurrence).type_name;
        self.warn(
            "unsupported-prim",
            occurrence,
            format!("{type_name} is not supported and is left out: it casts no shadow and receives nothing"),
        );
    }

    fn warn_of_what_is_not_applied(&self, occurrence: usize) {
        if is_skinned(self.raw, self.occurrences, occurrence) {
            self.warn(
                "unsupported-skinning",
                occurrence,
                "skinning is not applied, the mesh is drawn in its authored pose",
            );
        }
    }

    fn place_points(&mut self, instancer: usize, placed: &mut Vec<Placement>) {
        let parts_of = self.prototype_parts(instancer);
        self.warn_of_velocities(instancer);
        let occurrence = &self.occurrences[instancer];
        let path: Arc<str> = occurrence.path.as_str().into();
        for point in self.points(instancer, parts_of.len()) {
            let world_from_point = occurrence.world_from_local * point.matrix;
            for part in &parts_of[point.prototype] {
                let purpose = part.purpose.unwrap_or(occurrence.purpose);
                if !self.is_wanted(purpose) {
                    continue;
                }
                placed.push(Placement {
                    occurrence: part.occurrence,
                    world_from_object: world_from_point * part.instancer_from_object,
                    path: format!("{path}[{}]/{}", point.index, part.suffix).into(),
                    purpose,
                    source: PrimSource::PointInstance {
                        instancer: path.clone(),
                        index: u32::try_from(point.index).unwrap_or(u32::MAX),
                        shared_path: part.shared_path.clone(),
                    },
                });
            }
        }
    }

    /// The native door does not tell the samples of value clips apart. At whole frames, where samples are, nothing moves.
    fn warn_of_velocities(&self, instancer: usize) {
        let prim = self.prim(instancer);
        let moves = |positions: &str, velocities: &str| {
            let attribute = prim.attributes.get(positions);
            let has_velocities = prim.attributes.contains_key(velocities);
            let is_interpolated = |of: &RawAttribute| of.varying && of.held.is_none();
            has_velocities && attribute.is_some_and(is_interpolated)
        };
        let is_between = self.settings.time.is_some_and(|time| time.fract() != 0.0);
        let moves = moves("positions", "velocities") || moves("orientations", "angularVelocities");
        if is_between && moves {
            self.warn(
                "velocities",
                instancer,
                "velocities in value clips are not applied: between samples its points are interpolated",
            );
        }
    }

    fn shared_path(&self, occurrence: usize) -> Arc<str> {
        let occurrence = &self.occurrences[occurrence];
        match &occurrence.source {
            PrimSource::NativeInstance { shared_path, .. } => shared_path.clone(),
            _ => occurrence.path.as_str().into(),
        }
    }

    /// Drawables of every prototype of `instancer`; prototypes that do not exist have none.
    fn prototype_parts(&mut self, instancer: usize) -> Vec<Vec<Part>> {
        let targets = match self.prim(instancer).relationships.get("prototypes") {
            Some(relationship) => relationship.targets.as_slice(),
            None => &[],
        };
        if !self.open_instancers.insert(instancer) {
            self.warn(
                "cyclic-instance",
                instancer,
                "the instancer is among its own prototypes; it is left out there",
            );
            return vec![Vec::new(); targets.len()];
        }
        let mut parts = Vec::with_capacity(targets.len());
        for target in targets {
            parts.push(match self.find_target(instancer, target) {
                Some(root) => self.parts_below(root),
                None => {
                    self.warn(
                        "missing-prototype",
                        instancer,
                        format!("prototype {target} does not exist; its instances are left out"),
                    );
                    Vec::new()
                }
            });
        }
        self.open_instancers.remove(&instancer);
        parts
    }

    /// The occurrence that `target` means, seen from `instancer`: targets inside a native prototype are mapped to the
    /// instance that the instancer is in.
    fn find_target(&mut self, instancer: usize, target: &str) -> Option<usize> {
        let occurrences = self.occurrences;
        let by_path = self.by_path.get_or_insert_with(|| {
            let all = occurrences.iter().enumerate();
            all.map(|(index, occurrence)| (occurrence.path.as_str(), index))
                .collect()
        });
        let occurrence = &occurrences[instancer];
        let raw_path = &self.raw.prims[occurrence.prim].path;
        let mut root = occurrence.prim;
        while let Some(parent) = self.raw.prims[root].parent {
            root = parent;
        }
        let root_path = &self.raw.prims[root].path;
        let is_prototype = root >= self.raw.prototype_start;
        if let Some(below) = target
            .strip_prefix(root_path.as_str())
            .filter(|_| is_prototype)
        {
            let instance = occurrence.path.strip_suffix(&raw_path[root_path.len()..])?;
            return by_path.get(format!("{instance}{below}").as_str()).copied();
        }
        by_path.get(target).copied()
    }

    /// Drawables of `root` and below, nested instancers unfolded.
    fn parts_below(&mut self, root: usize) -> Vec<Part> {
        let end = self.subtree_ends[root];
        let parent_path = self.occurrences[root]
            .path
            .rfind('/')
            .map_or(0, |slash| slash + 1);
        // Transform, visibility and purpose relative to the root, one for every occurrence below it.
        let mut inherited: Vec<(DMat4, bool, Option<Purpose>)> = Vec::with_capacity(end - root);
        let mut parts = Vec::new();
        let mut hidden_until = root;
        for index in root..end {
            let prim = self.prim(index);
            let parent = self.occurrences[index].parent.filter(|_| index > root);
            let (matrix, visible, purpose) = parent
                .map_or((DMat4::IDENTITY, true, None), |parent| {
                    inherited[parent - root]
                });
            let local = xform::local(prim);
            let state = (
                matrix * local.parent_from_local,
                visible && !is_invisible(prim),
                authored_purpose(prim, self.diagnostics).or(purpose),
            );
            inherited.push(state);
            if !state.1 || index < hidden_until {
                continue;
            }
            match Kind::of(prim) {
                kind if kind.is_surface() => {
                    self.warn_of_what_is_not_applied(index);
                    parts.push(Part {
                        occurrence: index,
                        instancer_from_object: state.0,
                        suffix: self.occurrences[index].path[parent_path..].to_owned(),
                        purpose: state.2,
                        shared_path: self.shared_path(index),
                    });
                }
                Kind::Instancer => {
                    hidden_until = self.subtree_ends[index];
                    let suffix = self.occurrences[index].path[parent_path..].to_owned();
                    self.nested_parts(index, &suffix, (state.0, state.2), &mut parts);
                }
                Kind::Unsupported => self.warn_unsupported(index),
                _ => {}
            }
        }
        parts
    }

    fn nested_parts(
        &mut self,
        instancer: usize,
        suffix: &str,
        (matrix, purpose): (DMat4, Option<Purpose>),
        parts: &mut Vec<Part>,
    ) {
        let nested = self.prototype_parts(instancer);
        for point in self.points(instancer, nested.len()) {
            parts.extend(nested[point.prototype].iter().map(|part| Part {
                occurrence: part.occurrence,
                instancer_from_object: matrix * point.matrix * part.instancer_from_object,
                suffix: format!("{suffix}[{}]/{}", point.index, part.suffix),
                purpose: part.purpose.or(purpose),
                shared_path: part.shared_path.clone(),
            }));
        }
    }

    /// The instancer's visible points that have a prototype; none, with a warning, when its arrays disagree.
    fn points(&self, instancer: usize, prototype_count: usize) -> Vec<Point> {
        let rate = self.raw.meta.time_codes_per_second;
        let moment = Moment {
            time: self.settings.time,
            time_codes_per_second: rate
                .filter(|rate| *rate > 0.0)
                .unwrap_or(DEFAULT_TIME_CODES_PER_SECOND),
        };
        match instancer::points(self.prim(instancer), prototype_count, moment) {
            Ok((points, 0)) => points,
            Ok((points, without)) => {
                self.warn(
                    "bad-instance",
                    instancer,
                    format!(
                        "{without} points are left out: their protoIndices are not below {prototype_count} or their transforms are not finite"
                    ),
                );
                points
            }
            Err(message) => {
                self.warn(
                    "bad-instancer",
                    instancer,
                    format!("it is left out: {message}"),
                );
                Vec::new()
            }
        }
    }
}
