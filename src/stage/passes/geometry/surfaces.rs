//! Refined subdivision surfaces of one time, kept for others: what a mesh is refined into follows from its attributes, those
//! it inherits, and the level.

use super::{Asked, Detail, Geometry, Made, Scheme, Source, make};
use crate::diagnostics::Diagnostics;
use crate::stage::raw::RawAttribute;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

/// Attributes that say where and whether a mesh is drawn, not what it is.
const OF_PLACE: [&str; 4] = ["xformOp", "visibility", "purpose", "extent"];

/// What was refined in the course of several reads of one stage. Empty at first; it holds as much again as the refined
/// meshes of one read that do not vary with time.
#[derive(Debug, Default)]
pub struct Surfaces(HashMap<String, Vec<Surface>>);

/// One refined mesh.
#[derive(Debug)]
struct Surface {
    recipe: Recipe,
    made: Made,
}

/// All that a refined mesh is made of.
#[derive(Debug, PartialEq)]
pub(super) struct Recipe {
    level: usize,
    /// Of the primvars that are laid out.
    names: Vec<String>,
    own: Vec<Arc<RawAttribute>>,
    /// Of the constant primvars of ancestors, with the path of their owner.
    inherited: Vec<(String, Arc<RawAttribute>)>,
}

impl Recipe {
    /// Of `geometry` with the primvars called `names` at `level`.
    pub(super) fn of(geometry: &Geometry<'_>, names: &[String], level: usize) -> Self {
        let own = geometry.prim.attributes.shared();
        let own = own.filter(|attribute| {
            !OF_PLACE
                .iter()
                .any(|start| attribute.name.starts_with(start))
        });
        let inherited = geometry.inherited.iter().flat_map(|(name, owner)| {
            let primvar = format!("primvars:{name}");
            let all = owner.attributes.shared();
            let all = all.filter(move |attribute| attribute.name.starts_with(&primvar));
            all.map(|attribute| (owner.path.clone(), Arc::clone(attribute)))
        });
        Self {
            level,
            names: names.to_vec(),
            own: own.cloned().collect(),
            inherited: inherited.collect(),
        }
    }

    /// True if another time will ask for the same.
    fn stays(&self) -> bool {
        let inherited = self.inherited.iter().map(|(_, attribute)| attribute);
        let mut all = self.own.iter().chain(inherited);
        !all.any(|attribute| attribute.varying)
    }

    /// True if they are of one occurrence of a mesh, as far as that makes a difference.
    fn has_same_owners(&self, other: &Self) -> bool {
        let owners = |recipe: &Self| {
            let all = recipe.inherited.iter();
            all.map(|(owner, attribute)| (owner.clone(), attribute.name.clone()))
                .collect::<Vec<_>>()
        };
        owners(self) == owners(other)
    }
}

impl Surfaces {
    /// `asked`, whole: what was refined before is taken as it was. `names` are those of the primvars that are laid out.
    pub(super) fn make(
        &mut self,
        geometries: &[Geometry<'_>],
        names: &[String],
        asked: Vec<Asked<'_>>,
        diagnostics: &Diagnostics,
    ) -> Vec<Option<Made>> {
        let before = &*self;
        let made = asked.into_par_iter().zip(geometries);
        let made = made.map(|((source, level), geometry)| {
            let is_refined = matches!(&source, Source::Mesh(mesh) if mesh.scheme != Scheme::None);
            let recipe = is_refined.then(|| Recipe::of(geometry, names, level));
            let path = &geometry.prim.path;
            match recipe.as_ref().and_then(|recipe| before.find(path, recipe)) {
                Some(found) => (Some(found), None),
                None => (make(source, level, Detail::Full, diagnostics), recipe),
            }
        });
        let made: Vec<(Option<Made>, Option<Recipe>)> = made.collect();
        let all = geometries.iter().zip(made);
        let all = all.map(|(geometry, (made, recipe))| {
            if let (Some(made), Some(recipe)) = (&made, recipe) {
                self.keep(&geometry.prim.path, recipe, made);
            }
            made
        });
        all.collect()
    }

    /// What the mesh at `path` was refined into from the same.
    fn find(&self, path: &str, recipe: &Recipe) -> Option<Made> {
        let mut all = self.0.get(path)?.iter();
        let found = all.find(|surface| surface.recipe == *recipe)?;
        Some(found.made.clone())
    }

    /// `recipe` of the mesh at `path` gave `made`. What was kept of that mesh for another level or other values goes.
    fn keep(&mut self, path: &str, recipe: Recipe, made: &Made) {
        if !recipe.stays() {
            return;
        }
        let all = self.0.entry(path.to_owned()).or_default();
        all.retain(|surface| !surface.recipe.has_same_owners(&recipe));
        all.push(Surface {
            recipe,
            made: made.clone(),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{mesh, moved, with_token};
    use super::*;
    use crate::scene::Scene;
    use crate::stage::ReadSettings;
    use crate::stage::passes::{scene, scene_keeping};
    use crate::stage::raw::{RawPrim, RawStage};
    use glam::Vec3;

    /// A tetrahedron, subdivided.
    fn blob(path: &str, height: f32) -> RawPrim {
        let points = [Vec3::ZERO, Vec3::X, Vec3::Y, height * Vec3::Z];
        let indices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3];
        let prim = mesh(path, &points, &[3; 4], &indices);
        with_token(prim, "subdivisionScheme", "catmullClark")
    }

    fn stage(prims: Vec<RawPrim>) -> RawStage {
        RawStage {
            prototype_start: prims.len(),
            prims,
            ..RawStage::default()
        }
    }

    fn keeping(raw: &RawStage, kept: &mut Surfaces) -> Scene {
        let settings = ReadSettings::default();
        scene_keeping(raw, &settings, kept, &Diagnostics::default()).unwrap()
    }

    fn assert_same_as_alone(raw: &RawStage, kept: &mut Surfaces) {
        let found = keeping(raw, kept);
        let alone = scene(raw, &ReadSettings::default(), &Diagnostics::default()).unwrap();
        assert_eq!(found.meshes, alone.meshes);
        let placed = |scene: &Scene| {
            let all = scene.prims.iter();
            all.map(|prim| (prim.path.clone(), prim.mesh, prim.world_from_object))
                .collect::<Vec<_>>()
        };
        assert_eq!(placed(&found), placed(&alone));
    }

    #[test]
    fn scenes_are_those_of_single_reads_wherever_things_move_and_however_fine() {
        let mut kept = Surfaces::default();
        for (x, height) in [(2.0, 1.0), (3.0, 1.0), (3.0, 1.5), (40.0, 1.0), (2.0, 1.0)] {
            let mut moving = moved(blob("/moving", 1.0), x, 0.0, 0.0);
            let op = moving.attributes.get_mut("xformOp:transform");
            op.unwrap().varying = true;
            let prims = vec![blob("/still", 1.0), moving, blob("/other", height)];
            assert_same_as_alone(&stage(prims), &mut kept);
            assert_eq!(kept.0.len(), 3, "what moves as a whole is one surface");
        }
        for all in kept.0.values() {
            assert_eq!(all.len(), 1, "no more than the last of each");
        }
    }

    #[test]
    fn what_was_refined_is_taken_and_what_varies_is_not_kept() {
        let mut kept = Surfaces::default();
        let mut breathing = blob("/breathing", 1.0);
        breathing.attributes.get_mut("points").unwrap().varying = true;
        let raw = stage(vec![blob("/still", 1.0), breathing]);
        keeping(&raw, &mut kept);
        assert_eq!(kept.0.keys().collect::<Vec<_>>(), ["/still"]);
        let mark = |all: &mut Vec<Surface>| all[0].made.mesh.double_sided = true;
        kept.0.values_mut().for_each(mark);
        let scene = keeping(&raw, &mut kept);
        let is_marked = scene.meshes.iter().map(|mesh| mesh.double_sided);
        assert_eq!(is_marked.collect::<Vec<_>>(), [true, false]);
    }
}
