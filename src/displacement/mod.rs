//! Surfaces moved along their normals by their materials (UsdPreviewSurface `displacement`, a number, a primvar or an
//! image), as geometry: points, rays and receivers all see them moved, and nothing else has to know.
//!
//! Where an image displaces, triangles are cut until they are small enough to follow it. Edges stay closed: where faces with
//! different normals or heights meet, positions move by the means of them, weighted by angles.

mod cut;
mod relief;

use crate::diagnostics::Diagnostics;
use crate::scene::{FaceMaterials, Mesh, MeshId, PrimId, Scene};
use crate::shading::Heights;
use cut::Cut;
use glam::{DMat3, Mat3};
use rayon::prelude::*;
use relief::Relief;
use std::collections::HashMap;
use std::path::PathBuf;

/// Longest edge of what an image displaces, as a part of the scene's diagonal: two pixels of a 1K image that it fills.
const EDGE: f64 = 1.0 / 500.0;

/// Triangles of all displaced meshes at most, unless they have more before they are cut; beyond, edges are twice as long,
/// and twice again.
const BUDGET: usize = 2_000_000;

/// Times that edges are made twice as long before nothing is cut.
const MOST_DOUBLINGS: i32 = 8;

/// Occurrences of a mesh count as equally large where the squares of all lengths agree to this part.
const SAME_SIZE: f64 = 1e-4;

/// Displace all surfaces of `scene` whose materials ask for it, at the prims' own sizes: heights are in stage units. Points of
/// a mesh keep their numbers; values of primvars and materials stay where they were on the surface. Gives the image files read.
///
/// Missing or broken images, prims scaled to nothing and cutting that had to stop early are warnings.
pub fn displace(scene: &mut Scene, diagnostics: &Diagnostics) -> Vec<PathBuf> {
    let Some(heights) = Heights::of(scene, diagnostics) else {
        return Vec::new();
    };
    let groups = groups(scene, &heights, diagnostics);
    let meshes = displaced(scene, &heights, &groups, diagnostics);
    let images = heights.images().map(PathBuf::from).collect();
    replace(scene, groups, meshes);
    images
}

/// Prims of one mesh, size and materials: one displaced mesh.
struct Group {
    /// At least one.
    prims: Vec<PrimId>,
    /// `MᵀM` of the matrices that map the mesh to the world: how long its vectors are there.
    metric: DMat3,
}

impl Group {
    fn first(&self) -> PrimId {
        self.prims[0]
    }
}

/// Displaced prims together with those that they share a displaced mesh with, in the order of their first ones.
fn groups(scene: &Scene, heights: &Heights<'_>, diagnostics: &Diagnostics) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    let mut known: HashMap<(MeshId, [i64; 7]), Vec<usize>> = HashMap::new();
    for (id, prim) in (0..).map(PrimId).zip(&scene.prims) {
        let displaces = |material| Option::is_some_and(material, |id| heights.displaces(id));
        let is_displaced = match &prim.materials {
            FaceMaterials::Whole(material) => displaces(*material),
            FaceMaterials::PerFace(materials) => materials.iter().copied().any(displaces),
        };
        if !is_displaced {
            continue;
        }
        let matrix = Mat3::from(prim.world_from_object.matrix3).as_dmat3();
        let metric = matrix.transpose() * matrix;
        if !metric.inverse().is_finite() {
            let message = "scaled to nothing along an axis: it is not displaced";
            diagnostics.warn("flat-displacement", prim.path.to_string(), message);
            continue;
        }
        let alike = known.entry((prim.mesh, size(&metric))).or_default();
        let same = |&&i: &&usize| {
            let other: &Group = &groups[i];
            scene.prims[other.first().index()].materials == prim.materials
        };
        match alike.iter().find(same) {
            Some(&i) => groups[i].prims.push(id),
            None => {
                alike.push(groups.len());
                let prims = vec![id];
                groups.push(Group { prims, metric });
            }
        }
    }
    groups
}

/// Equal for sizes that are no different but by rounding, nearly always.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the tenth power of two beyond the precision asked for"
)]
fn size(metric: &DMat3) -> [i64; 7] {
    let [x, y, z] = [metric.x_axis, metric.y_axis, metric.z_axis];
    let magnitude = (x.x + y.y + z.z).log2().round();
    let step = SAME_SIZE * magnitude.exp2();
    let [xx, xy, xz, yy, yz, zz] =
        [x.x, x.y, x.z, y.y, y.z, z.z].map(|entry| (entry / step).round() as i64);
    [magnitude as i64, xx, xy, xz, yy, yz, zz]
}

/// The mesh of every group. Edges are as short as the budget allows.
fn displaced(
    scene: &Scene,
    heights: &Heights<'_>,
    groups: &[Group],
    diagnostics: &Diagnostics,
) -> Vec<Mesh> {
    let wanted = EDGE * f64::from(scene.bounds().diagonal());
    for doubling in 0..=MOST_DOUBLINGS {
        let longest = wanted * f64::from(doubling).exp2();
        let is_last = doubling == MOST_DOUBLINGS;
        let cuts = groups.par_iter().map(|group| {
            let cut = if is_last {
                uncut(scene, group)
            } else {
                cut(scene, heights, group, longest)?
            };
            Some((group, cut))
        });
        let cuts: Option<Vec<(&Group, Cut)>> = cuts.collect();
        let Some(cuts) = cuts else { continue };
        let all: usize = cuts.iter().map(|(_, cut)| cut.pieces.len()).sum();
        if all > BUDGET && !is_last {
            continue;
        }
        if doubling > 0 {
            let cut = match is_last {
                true => "not cut".to_owned(),
                false => format!("cut to edges of {longest} only"),
            };
            let message = format!(
                "displaced triangles are {cut}, since with edges of {wanted} they are more than {BUDGET}: finer displacement is lost"
            );
            let stage = scene.stage.path.display().to_string();
            diagnostics.warn("coarse-displacement", stage, message);
        }
        let relief = |(group, cut): (&Group, Cut)| {
            let prim = group.first();
            let mesh = scene.mesh_of(&scene.prims[prim.index()]);
            Relief::new(heights, (prim, mesh), &group.metric, cut).mesh()
        };
        return cuts.into_par_iter().map(relief).collect();
    }
    unreachable!("the last time nothing is cut")
}

fn uncut(scene: &Scene, group: &Group) -> Cut {
    let mesh = scene.mesh_of(&scene.prims[group.first().index()]);
    Cut::uncut(&mesh.positions, &mesh.triangles)
}

/// The mesh of `group` cut to edges no longer than `longest` where an image displaces it; `None` if that alone is too much.
fn cut(scene: &Scene, heights: &Heights<'_>, group: &Group, longest: f64) -> Option<Cut> {
    let prim = &scene.prims[group.first().index()];
    let mesh = scene.mesh_of(prim);
    let mut cut = Cut::uncut(&mesh.positions, &mesh.triangles);
    let is_detailed = |base: u32| {
        let material = prim.materials.of_face(mesh.triangle_faces[base as usize]);
        material.is_some_and(|material| heights.is_detailed(material))
    };
    let most = BUDGET.max(mesh.triangles.len());
    cut.refine((&group.metric, longest), is_detailed, most)
        .then_some(cut)
}

/// Give the prims of every group their displaced mesh, in the place of the old one if nobody else needs that.
fn replace(scene: &mut Scene, groups: Vec<Group>, meshes: Vec<Mesh>) {
    let mut is_needed = vec![false; scene.meshes.len()];
    let mut is_displaced = vec![false; scene.prims.len()];
    for id in groups.iter().flat_map(|group| &group.prims) {
        is_displaced[id.index()] = true;
    }
    for (prim, _) in scene
        .prims
        .iter()
        .zip(&is_displaced)
        .filter(|(_, moved)| !**moved)
    {
        is_needed[prim.mesh.index()] = true;
    }
    for (group, mesh) in groups.into_iter().zip(meshes) {
        let old = scene.prims[group.first().index()].mesh;
        let id = if is_needed[old.index()] {
            scene.meshes.push(mesh);
            MeshId(u32::try_from(scene.meshes.len() - 1).unwrap_or(u32::MAX))
        } else {
            is_needed[old.index()] = true;
            scene.meshes[old.index()] = mesh;
            old
        };
        for prim in group.prims {
            scene.prims[prim.index()].mesh = id;
        }
    }
}

#[cfg(test)]
mod tests;
