//! How often every subdivision mesh is refined.
//!
//! Wanted: refined edges no longer than asked, at least one level, at most [`MAX_LEVEL`], and enough levels for the
//! sharpest finite crease. Where the scene's sum goes beyond [`FACE_BUDGET`] the asked edge is doubled until it fits
//! or every mesh is at its least level; creases are followed only as far as a mesh alone stays in the budget.

use super::authored::{AuthoredMesh, Scheme};
use super::subdivision::sharpness_levels;
use crate::diagnostics::Diagnostics;
use glam::DVec3;

/// Most levels: 256 faces for each of the cage.
const MAX_LEVEL: usize = 4;
/// Refined faces over all meshes of a scene: about 0.5 GB while refining and 2 to 4 s (CRATES.md §2).
const FACE_BUDGET: u64 = 2_000_000;
/// Edge asked for by default, as a part of the scene's diagonal: about 2 pixels of a 1K image that it fills.
const DEFAULT_EDGE: f64 = 1.0 / 500.0;

/// What a geometry asks for.
pub(super) enum Demand<'a> {
    /// Not subdivided.
    None,
    /// Refined until edges are no longer than this, object space.
    Refined(&'a AuthoredMesh<'a>, f64),
}

/// The edge length asked for when the user asks for none; world space. 0 for an empty scene.
pub(super) fn default_edge((min, max): (DVec3, DVec3)) -> f64 {
    DEFAULT_EDGE * (max - min).max(DVec3::ZERO).length()
}

/// Levels of all geometries, 0 for those that are not subdivided.
pub(super) fn levels(demands: &[Demand], diagnostics: &Diagnostics) -> Vec<usize> {
    let plans: Vec<Option<Plan>> = demands
        .iter()
        .map(|demand| match demand {
            Demand::None => None,
            Demand::Refined(mesh, edge) => Some(Plan::of(mesh, *edge, diagnostics)),
        })
        .collect();
    let level = |plan: &Option<Plan>, coarser: usize| plan.as_ref().map_or(0, |p| p.level(coarser));
    let total = |coarser: usize| -> u64 {
        let all = plans.iter().flatten();
        all.map(|plan| plan.faces(plan.level(coarser)))
            .fold(0, u64::saturating_add)
    };
    let coarser = (0..MAX_LEVEL).find(|&coarser| total(coarser) <= FACE_BUDGET);
    let coarser = coarser.unwrap_or(MAX_LEVEL);
    plans.iter().map(|plan| level(plan, coarser)).collect()
}

struct Plan {
    wanted: usize,
    least: usize,
    /// Faces after the first level.
    first_faces: u64,
}

impl Plan {
    fn of(mesh: &AuthoredMesh, edge: f64, diagnostics: &Diagnostics) -> Self {
        let first_faces = match mesh.scheme {
            Scheme::Loop => 4 * mesh.topology.counts.len() as u64,
            _ => mesh.topology.indices.len() as u64,
        };
        let mut plan = Self {
            wanted: levels_for(longest_edge(mesh) / edge),
            least: 1,
            first_faces,
        };
        let needed = sharpness_levels(mesh.prim);
        plan.least = (1..=needed.clamp(1, MAX_LEVEL))
            .rev()
            .find(|&level| level == 1 || plan.faces(level) <= FACE_BUDGET)
            .unwrap_or(1);
        if plan.least < needed {
            diagnostics.warn(
                "sharp-crease",
                mesh.prim.path.clone(),
                format!("creases are followed for {} levels of the {needed} that their sharpness asks for; what is left of them stays sharp", plan.least),
            );
        }
        plan
    }

    fn level(&self, coarser: usize) -> usize {
        self.wanted.saturating_sub(coarser).clamp(self.least, MAX_LEVEL)
    }

    fn faces(&self, level: usize) -> u64 {
        self.first_faces << (2 * (level - 1))
    }
}

/// Halvings until `ratio` is at most 1.
fn levels_for(ratio: f64) -> usize {
    let halved = |level: &usize| ratio / f64::from(1_u32 << level) <= 1.0;
    (1..MAX_LEVEL).find(halved).unwrap_or(MAX_LEVEL)
}

fn longest_edge(mesh: &AuthoredMesh) -> f64 {
    let topology = &mesh.topology;
    let longest = topology.drawn().flat_map(|face| {
        let points = topology.points_of(face);
        let following = points.iter().cycle().skip(1);
        points.iter().zip(following).map(|(&a, &b)| {
            let [a, b] = [a, b].map(|i| mesh.points[i as usize].as_dvec3());
            a.distance_squared(b)
        })
    });
    longest.fold(0.0, f64::max).sqrt()
}
