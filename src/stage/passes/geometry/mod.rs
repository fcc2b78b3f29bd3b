//! Meshes, implicit gprims, curves, patches and instancers → shared meshes and prims.
//!
//! In: the composed stage and its flattened occurrences. Out: every distinct geometry once, and one [`Prim`] for each
//! time it is drawn. A geometry drawn once is stored in world space relative to the scene's origin, with the identity
//! as transform; one drawn several times stays in object space, shared. Mirroring transforms: normals go through the
//! inverse transpose, and baked triangles are turned so that counter-clockwise stays the side that USD calls front;
//! for shared meshes it is the reader of `Prim::world_from_object` who must turn them where its determinant is
//! negative.

mod attributes;
mod authored;
mod control;
mod curves;
mod draw_modes;
mod gprims;
mod instancer;
mod limit_normals;
mod normals;
mod nurbs;
mod patch;
mod placement;
mod primvars;
mod refinement;
mod solids;
mod subdivision;
mod topology;
mod triangulate;
mod world;

use super::super::raw::{RawPrim, RawStage};
use super::super::{Error, ReadSettings};
use super::flatten::Occurrence;
use super::look::Look;
use crate::diagnostics::Diagnostics;
use crate::scene::{FaceMaterials, MaterialId, Mesh, MeshId, Prim, PrimSource};
use authored::{AuthoredMesh, Scheme, local_origin};
use curves::Curves;
use glam::{Affine3A, DAffine3, DMat4, DVec3};
use gprims::Gprim;
use patch::Patch;
use placement::{Kind, Placement};
use primvars::AuthoredPrimvar;
use rayon::prelude::*;
use refinement::Fineness;
use std::collections::HashMap;
use std::sync::Arc;

/// Primvars that are kept whether or not a material reads them.
const ALWAYS_KEPT: [&str; 3] = ["displayColor", "displayOpacity", "st"];

/// What is drawn where, and the origin that follows from it; geometry itself is not made yet.
#[derive(Debug)]
pub struct Layout<'a> {
    raw: &'a RawStage,
    occurrences: &'a [Occurrence],
    settings: &'a ReadSettings,
    placements: Vec<Placement>,
    /// Absolute; `min > max` when nothing is drawn.
    bounds: (DVec3, DVec3),
    origin: DVec3,
}

/// Find out what is drawn where, unfolding point instancers.
///
/// # Errors
/// Cancellation.
pub fn lay_out<'a>(
    raw: &'a RawStage,
    occurrences: &'a [Occurrence],
    settings: &'a ReadSettings,
    diagnostics: &Diagnostics,
) -> Result<Layout<'a>, Error> {
    diagnostics.check()?;
    let mut placements = placement::placements(raw, occurrences, settings, diagnostics);
    let bounds =
        world::Boxes::new(raw, occurrences).keep_within_reach(&mut placements, |placement| {
            let limit = world::LARGEST_DISTANCE;
            let flaw = format!("is not finite or leads more than {limit:e} units away");
            warn_of_transform(placement, &flaw, diagnostics);
        });
    Ok(Layout {
        raw,
        occurrences,
        settings,
        placements,
        bounds,
        origin: local_origin(bounds.0, bounds.1),
    })
}

/// One distinct geometry.
struct Geometry<'a> {
    prim: &'a RawPrim,
    /// Constant primvars of ancestors, the nearest owner each.
    inherited: Vec<(String, &'a RawPrim)>,
    /// Placements that draw it.
    uses: Vec<usize>,
}

impl Layout<'_> {
    /// World position that all positions are to be relative to: exactly 0 unless the scene is far from 0 for its
    /// size.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Make the geometry.
    ///
    /// # Errors
    /// Meshes whose arrays contradict each other or whose points are not finite; cancellation.
    pub fn build(
        &self,
        look: &Look,
        diagnostics: &Diagnostics,
    ) -> Result<(Vec<Mesh>, Vec<Prim>), Error> {
        let names = kept_primvars(look);
        let mut geometries = self.geometries(&names);
        let mut sources = read_all(&geometries, &names, diagnostics)?;
        self.share_gprims(&mut geometries, &mut sources);
        self.ask_for_depth(&geometries, &mut sources);
        let levels = refinement::levels(&self.demands(&geometries, &sources), diagnostics);
        diagnostics.check()?;
        let made: Vec<Option<(Mesh, DVec3)>> = sources
            .into_par_iter()
            .zip(levels)
            .map(|(source, level)| make(source, level, diagnostics))
            .collect();
        diagnostics.check()?;
        Ok(self.assemble(&geometries, made, look, diagnostics))
    }

    /// Distinct geometries in order of first use.
    fn geometries(&self, names: &[String]) -> Vec<Geometry<'_>> {
        let inherited = Inherited::of(self.raw, self.occurrences, names);
        let mut by_key: HashMap<(usize, usize), usize> = HashMap::new();
        let mut geometries: Vec<Geometry> = Vec::new();
        for (index, placement) in self.placements.iter().enumerate() {
            let prim = self.occurrences[placement.occurrence].prim;
            let set = inherited.set_of[placement.occurrence];
            let geometry = *by_key.entry((prim, set)).or_insert_with(|| {
                let owners = inherited.sets[set].iter();
                geometries.push(Geometry {
                    prim: &self.raw.prims[prim],
                    inherited: owners
                        .map(|(name, owner)| (names[*name].clone(), &self.raw.prims[*owner]))
                        .collect(),
                    uses: Vec::new(),
                });
                geometries.len() - 1
            });
            geometries[geometry].uses.push(index);
        }
        geometries
    }

    /// Length of the diagonal of what is drawn; 0 when nothing is.
    fn diagonal(&self) -> f64 {
        let (min, max) = self.bounds;
        (max - min).max(DVec3::ZERO).length()
    }

    /// That of the largest occurrence.
    fn scale_of(&self, geometry: &Geometry) -> f64 {
        let uses = geometry.uses.iter();
        uses.map(|&i| world::greatest_scale(self.placements[i].world_from_object))
            .fold(0.0, f64::max)
    }

    /// Cut every gprim as its largest occurrence asks, and draw those that come out equal with one mesh: the first
    /// gets the uses of the others. Flattened ones stay alone, since a shared mesh cannot be flattened.
    fn share_gprims(&self, geometries: &mut [Geometry], sources: &mut [Source]) {
        let mut first: HashMap<String, usize> = HashMap::new();
        for index in 0..sources.len() {
            let Source::Gprim(gprim, facets) = &mut sources[index] else {
                continue;
            };
            let geometry = &geometries[index];
            *facets = gprim.solid.facets(self.scale_of(geometry), self.diagonal());
            let mut uses = geometry.uses.iter();
            if uses.any(|&i| world::is_singular(self.placements[i].world_from_object)) {
                continue;
            }
            let owner = *first.entry(gprim.key(*facets)).or_insert(index);
            if owner != index {
                let uses = std::mem::take(&mut geometries[index].uses);
                geometries[owner].uses.extend(uses);
                sources[index] = Source::Nothing;
            }
        }
    }

    /// Curves and patches are cut as their largest occurrence asks.
    fn ask_for_depth(&self, geometries: &[Geometry], sources: &mut [Source]) {
        for (geometry, source) in geometries.iter().zip(sources) {
            if let Source::Curves(_, depth) | Source::Patch(_, depth) = source {
                let scale = self.scale_of(geometry).max(f64::MIN_POSITIVE);
                *depth = solids::SCENE_ERROR * self.diagonal() / scale;
            }
        }
    }

    fn demands<'b>(
        &self,
        geometries: &'b [Geometry<'b>],
        sources: &'b [Source<'b>],
    ) -> Vec<refinement::Demand<'b>> {
        let fineness = |scale: f64| match self.settings.refine_edge {
            Some(edge) => Fineness::Asked(f64::from(edge) / scale),
            None => Fineness::Default(refinement::default_edge(self.diagonal()) / scale),
        };
        let all = geometries.iter().zip(sources);
        all.map(|(geometry, source)| match source {
            Source::Mesh(mesh) if mesh.scheme != Scheme::None => {
                refinement::Demand::Refined(mesh, fineness(self.scale_of(geometry)))
            }
            _ => refinement::Demand::None,
        })
        .collect()
    }

    fn assemble(
        &self,
        geometries: &[Geometry],
        made: Vec<Option<(Mesh, DVec3)>>,
        look: &Look,
        diagnostics: &Diagnostics,
    ) -> (Vec<Mesh>, Vec<Prim>) {
        let mut meshes = Vec::with_capacity(made.len());
        let mut of_placement: Vec<Option<(MeshId, Affine3A)>> = vec![None; self.placements.len()];
        for (geometry, made) in geometries.iter().zip(made) {
            let Some((mut mesh, center)) = made else {
                continue;
            };
            let id = MeshId(u32::try_from(meshes.len()).expect("fewer meshes than 2^32"));
            let origin_from_world = DMat4::from_translation(-self.origin);
            let matrix = |placement: usize| {
                let world_from_object = self.placements[placement].world_from_object;
                origin_from_world * world_from_object * DMat4::from_translation(center)
            };
            let mut is_drawn = false;
            let is_shared = geometry.uses.len() > 1;
            for &placement in &geometry.uses {
                let matrix = matrix(placement);
                if !self.is_usable(placement, matrix, is_shared, diagnostics) {
                    continue;
                }
                let affine = if is_shared {
                    DAffine3::from_mat4(matrix).as_affine3a()
                } else {
                    world::bake(&mut mesh, matrix);
                    Affine3A::IDENTITY
                };
                of_placement[placement] = Some((id, affine));
                is_drawn = true;
            }
            if !is_drawn {
                continue;
            }
            meshes.push(mesh);
        }
        (meshes, self.prims(of_placement, look))
    }

    /// Transforms that are not finite draw nothing, nor do those that flatten a shared mesh: whoever traces it needs
    /// the inverse.
    fn is_usable(
        &self,
        placement: usize,
        matrix: DMat4,
        is_shared: bool,
        diagnostics: &Diagnostics,
    ) -> bool {
        let flaw = if !matrix.is_finite() {
            "is not finite"
        } else if is_shared && world::is_singular(matrix) {
            "flattens a shared mesh"
        } else {
            return true;
        };
        warn_of_transform(&self.placements[placement], flaw, diagnostics);
        false
    }

    fn prims(&self, of_placement: Vec<Option<(MeshId, Affine3A)>>, look: &Look) -> Vec<Prim> {
        let mut materials = Materials::of(self.raw, self.occurrences, look);
        let drawn = self.placements.iter().zip(of_placement);
        drawn
            .filter_map(|(placement, mesh)| {
                let (mesh, world_from_object) = mesh?;
                Some(Prim {
                    path: placement.path.clone(),
                    mesh,
                    world_from_object,
                    materials: materials.of_occurrence(placement.occurrence),
                    purpose: placement.purpose,
                    source: placement.source.clone(),
                })
            })
            .collect()
    }
}

/// One warning for all points of an instancer: scaling points to nothing is a common way to hide them.
fn warn_of_transform(placement: &Placement, flaw: &str, diagnostics: &Diagnostics) {
    let path = match &placement.source {
        PrimSource::PointInstance { instancer, .. } => instancer,
        _ => &placement.path,
    };
    diagnostics.warn(
        "degenerate-transform",
        path.clone(),
        format!("what is drawn with a transform that {flaw} is left out"),
    );
}

fn kept_primvars(look: &Look) -> Vec<String> {
    let mut names: Vec<String> = ALWAYS_KEPT.map(str::to_owned).to_vec();
    names.extend(look.primvars.iter().cloned());
    names.sort_unstable();
    names.dedup();
    names
}

/// A geometry read and checked.
enum Source<'a> {
    Mesh(Box<AuthoredMesh<'a>>),
    /// With its facets around; 0 until [`Layout::share_gprims`] has chosen.
    Gprim(Box<Gprim>, usize),
    /// With how deep facets may be, object space; 0 until [`Layout::ask_for_depth`] has chosen.
    Curves(Box<Curves<'a>>, f64),
    /// The same.
    Patch(Box<Patch<'a>>, f64),
    Nothing,
}

fn read_all<'a>(
    geometries: &[Geometry<'a>],
    names: &[String],
    diagnostics: &Diagnostics,
) -> Result<Vec<Source<'a>>, Error> {
    let read = |geometry: &Geometry<'a>| {
        let inherited = &geometry.inherited;
        Ok(match Kind::of(geometry.prim) {
            Kind::Mesh => AuthoredMesh::read(geometry.prim, inherited, names, diagnostics)?
                .map_or(Source::Nothing, |mesh| Source::Mesh(Box::new(mesh))),
            Kind::Curves => Curves::read(geometry.prim, inherited, names, diagnostics)
                .map_or(Source::Nothing, |curves| {
                    Source::Curves(Box::new(curves), 0.0)
                }),
            Kind::Patch => Patch::read(geometry.prim, inherited, names, diagnostics)
                .map_or(Source::Nothing, |patch| Source::Patch(Box::new(patch), 0.0)),
            _ => Gprim::read(geometry.prim, inherited, names, diagnostics)
                .map_or(Source::Nothing, |gprim| Source::Gprim(Box::new(gprim), 0)),
        })
    };
    // Collected whole first: the error reported is the first in stage order for any thread count.
    let all: Vec<Result<Source, Error>> = geometries.par_iter().map(read).collect();
    all.into_iter().collect()
}

fn make(source: Source, level: usize, diagnostics: &Diagnostics) -> Option<(Mesh, DVec3)> {
    if diagnostics.check().is_err() {
        return None;
    }
    match source {
        Source::Nothing => None,
        Source::Gprim(gprim, facets) => Some((gprim.tessellate(facets), DVec3::ZERO)),
        Source::Curves(curves, depth) => Some(curves.tessellate(depth)),
        Source::Patch(patch, depth) => Some(patch.tessellate(depth)),
        Source::Mesh(mesh) if mesh.scheme == Scheme::None => {
            Some((mesh.as_polygons(diagnostics), mesh.center))
        }
        Source::Mesh(mesh) => Some((
            subdivision::subdivide(&mesh, level, diagnostics),
            mesh.center,
        )),
    }
}

/// Constant primvars that ancestors hand down.
struct Inherited {
    /// Distinct sets of (index of the name, raw prim that owns it).
    sets: Vec<Vec<(usize, usize)>>,
    /// Set that applies to each occurrence from above.
    set_of: Vec<usize>,
}

impl Inherited {
    fn of(raw: &RawStage, occurrences: &[Occurrence], names: &[String]) -> Self {
        let attribute_names: Vec<String> = names.iter().map(|n| format!("primvars:{n}")).collect();
        let mut sets = vec![Vec::new()];
        let mut known: HashMap<Vec<(usize, usize)>, usize> = HashMap::from([(Vec::new(), 0)]);
        let mut set_of = Vec::with_capacity(occurrences.len());
        // What each occurrence hands down: its own on top of what it got.
        let mut handed_down: Vec<usize> = Vec::with_capacity(occurrences.len());
        for occurrence in occurrences {
            let above = occurrence.parent.map_or(0, |parent| handed_down[parent]);
            set_of.push(above);
            let attributes = &raw.prims[occurrence.prim].attributes;
            let own: Vec<usize> = (0..names.len())
                .filter(|&name| {
                    let attribute = attributes.get(&attribute_names[name]);
                    attribute.is_some_and(AuthoredPrimvar::is_inheritable)
                })
                .collect();
            if own.is_empty() {
                handed_down.push(above);
                continue;
            }
            let mut set: Vec<(usize, usize)> = sets[above].clone();
            set.retain(|(name, _)| !own.contains(name));
            set.extend(own.into_iter().map(|name| (name, occurrence.prim)));
            set.sort_unstable();
            handed_down.push(*known.entry(set).or_insert_with_key(|set| {
                sets.push(set.clone());
                sets.len() - 1
            }));
        }
        Self { sets, set_of }
    }
}

/// Bindings of occurrences, with those of their subsets.
struct Materials<'a> {
    raw: &'a RawStage,
    occurrences: &'a [Occurrence],
    look: &'a Look,
    /// `materialBind` subsets of each occurrence that has any.
    subsets: HashMap<usize, Vec<usize>>,
    /// Made already: instances share them.
    known: HashMap<usize, FaceMaterials>,
}

impl<'a> Materials<'a> {
    fn of(raw: &'a RawStage, occurrences: &'a [Occurrence], look: &'a Look) -> Self {
        let mut subsets: HashMap<usize, Vec<usize>> = HashMap::new();
        for (index, occurrence) in occurrences.iter().enumerate() {
            let prim = &raw.prims[occurrence.prim];
            let binds = prim.type_name == "GeomSubset"
                && attributes::token(prim, "familyName", "") == "materialBind"
                && attributes::token(prim, "elementType", "face") == "face";
            if let Some(parent) = occurrence.parent.filter(|_| binds) {
                subsets.entry(parent).or_default().push(index);
            }
        }
        Self {
            raw,
            occurrences,
            look,
            subsets,
            known: HashMap::new(),
        }
    }

    fn of_occurrence(&mut self, occurrence: usize) -> FaceMaterials {
        let whole = self.binding(occurrence);
        let Some(subsets) = self.subsets.get(&occurrence) else {
            return FaceMaterials::Whole(whole);
        };
        if let Some(known) = self.known.get(&occurrence) {
            return known.clone();
        }
        let prim = &self.raw.prims[self.occurrences[occurrence].prim];
        let mut faces = vec![whole; attributes::ints(prim, "faceVertexCounts").len()];
        for &subset in subsets {
            let material = self.binding(subset).or(whole);
            let prim = &self.raw.prims[self.occurrences[subset].prim];
            for &face in attributes::ints(prim, "indices") {
                if let Some(slot) = usize::try_from(face).ok().and_then(|f| faces.get_mut(f)) {
                    *slot = material;
                }
            }
        }
        let materials = FaceMaterials::PerFace(Arc::from(faces));
        self.known.insert(occurrence, materials.clone());
        materials
    }

    fn binding(&self, occurrence: usize) -> Option<MaterialId> {
        self.look.binding.get(occurrence).copied().flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::raw::{RawAttribute, RawRelationship, Value};
    use super::super::flatten::flatten;
    use super::*;
    use crate::scene::{Interpolation, Normals, Purpose};
    use glam::{DQuat, Vec3, Vec4};

    pub(super) fn with_attribute(
        mut prim: RawPrim,
        name: &str,
        value: Value,
        interpolation: Option<&str>,
    ) -> RawPrim {
        let attribute = RawAttribute {
            value: Some(value),
            interpolation: interpolation.map(str::to_owned),
            ..RawAttribute::default()
        };
        prim.attributes.insert(name.to_owned(), attribute);
        prim
    }

    pub(super) fn with_ints(prim: RawPrim, name: &str, values: &[i32]) -> RawPrim {
        with_attribute(prim, name, Value::IntArray(values.to_vec()), None)
    }

    /// A polygon mesh.
    pub(super) fn mesh(path: &str, points: &[Vec3], counts: &[i32], indices: &[i32]) -> RawPrim {
        let prim = prim(path, "Mesh", None);
        let prim = with_attribute(prim, "points", Value::Vec3Array(points.to_vec()), None);
        let prim = with_ints(prim, "faceVertexCounts", counts);
        let prim = with_ints(prim, "faceVertexIndices", indices);
        with_token(prim, "subdivisionScheme", "none")
    }

    pub(super) fn with_token(prim: RawPrim, name: &str, word: &str) -> RawPrim {
        with_attribute(prim, name, Value::Token(word.to_owned()), None)
    }

    pub(super) fn prim(path: &str, type_name: &str, parent: Option<usize>) -> RawPrim {
        RawPrim {
            path: path.to_owned(),
            type_name: type_name.to_owned(),
            parent,
            ..RawPrim::default()
        }
    }

    fn under(mut prim: RawPrim, parent: usize) -> RawPrim {
        prim.parent = Some(parent);
        prim
    }

    fn transformed(prim: RawPrim, matrix: DMat4) -> RawPrim {
        let order = Value::TokenArray(vec!["xformOp:transform".to_owned()]);
        let prim = with_attribute(prim, "xformOpOrder", order, None);
        with_attribute(prim, "xformOp:transform", Value::Matrix(matrix), None)
    }

    fn moved(prim: RawPrim, x: f64, y: f64, z: f64) -> RawPrim {
        transformed(prim, DMat4::from_translation(DVec3::new(x, y, z)))
    }

    fn triangle(path: &str) -> RawPrim {
        mesh(path, &[Vec3::ZERO, Vec3::X, Vec3::Y], &[3], &[0, 1, 2])
    }

    struct Built {
        meshes: Vec<Mesh>,
        prims: Vec<Prim>,
        origin: DVec3,
        warnings: Vec<String>,
    }

    fn try_build(raw: &RawStage, look: &Look) -> Result<Built, Error> {
        let settings = ReadSettings::default();
        let diagnostics = Diagnostics::default();
        let occurrences = flatten(raw, &settings, &diagnostics);
        let layout = lay_out(raw, &occurrences, &settings, &diagnostics)?;
        let (meshes, prims) = layout.build(look, &diagnostics)?;
        let warnings = diagnostics.warnings().into_iter().map(|w| w.kind).collect();
        Ok(Built {
            meshes,
            prims,
            origin: layout.origin(),
            warnings,
        })
    }

    fn build(prims: Vec<RawPrim>, prototype_start: usize) -> Built {
        let raw = RawStage {
            prims,
            prototype_start,
            ..RawStage::default()
        };
        try_build(&raw, &Look::default()).unwrap()
    }

    fn build_all(prims: Vec<RawPrim>) -> Built {
        let count = prims.len();
        build(prims, count)
    }

    #[test]
    fn a_mesh_drawn_once_is_in_world_space_and_twice_is_shared() {
        let mut instances: Vec<RawPrim> = (0..2_u8)
            .map(|i| {
                moved(
                    prim(&format!("/i{i}"), "Xform", None),
                    f64::from(i),
                    0.0,
                    0.0,
                )
            })
            .collect();
        for instance in &mut instances {
            instance.prototype = Some(3);
        }
        let single = moved(triangle("/single"), 5.0, 0.0, 0.0);
        let prims = [
            instances,
            vec![
                single,
                prim("/__Prototype_1", "Xform", None),
                under(triangle("/__Prototype_1/t"), 3),
            ],
        ];
        let built = build(prims.concat(), 3);
        assert_eq!(built.meshes.len(), 2);
        let paths: Vec<_> = built.prims.iter().map(|p| p.path.as_str()).collect();
        assert_eq!(paths, ["/i0/t", "/i1/t", "/single"]);
        assert_eq!(built.prims[0].mesh, built.prims[1].mesh);
        assert_eq!(built.prims[1].world_from_object.translation.x, 1.0);
        assert_eq!(
            built.meshes[built.prims[0].mesh.index()].positions[0],
            Vec3::ZERO
        );
        assert_eq!(built.prims[2].world_from_object, Affine3A::IDENTITY);
        let world = &built.meshes[built.prims[2].mesh.index()];
        assert_eq!(world.positions[1], Vec3::new(6.0, 0.0, 0.0));
        assert_eq!(built.origin, DVec3::ZERO);
    }

    #[test]
    fn invisible_prims_guides_and_proxies_are_not_drawn() {
        let prims = vec![
            with_token(triangle("/hidden"), "visibility", "invisible"),
            with_token(triangle("/guide"), "purpose", "guide"),
            with_token(triangle("/render"), "purpose", "render"),
            triangle("/plain"),
        ];
        let built = build_all(prims);
        let paths: Vec<_> = built.prims.iter().map(|p| p.path.as_str()).collect();
        assert_eq!(paths, ["/render", "/plain"]);
        assert_eq!(built.prims[0].purpose, Purpose::Render);
    }

    #[test]
    fn mirrored_meshes_keep_their_front_on_the_same_side() {
        let mirror = DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        let prim = with_attribute(
            triangle("/m"),
            "normals",
            Value::Vec3Array(vec![Vec3::Z; 3]),
            None,
        );
        let st = Value::Vec2Array(vec![glam::Vec2::ZERO, glam::Vec2::X, glam::Vec2::Y]);
        let prim = with_attribute(prim, "primvars:st", st, Some("faceVarying"));
        let built = build_all(vec![transformed(prim, mirror)]);
        let mesh = &built.meshes[0];
        assert_eq!(mesh.positions[1], Vec3::NEG_X);
        assert_eq!(mesh.plane_normal(0), Vec3::Z);
        assert_eq!(mesh.shading_normal(0, 0.3, 0.3), Vec3::Z);
        assert_eq!(mesh.triangles[0], [0, 2, 1]);
        let st = mesh.primvar("st").unwrap();
        assert_eq!(st.interpolation, Interpolation::Corner(vec![[0, 2, 1]]));
        assert_eq!(mesh.cage.as_ref().unwrap().point_normals, [Vec3::Z; 3]);
    }

    #[test]
    fn sheared_normals_stay_perpendicular() {
        // x += z: a face in the plane x = 0 leans, its normal becomes (1, 0, −1).
        let shear = DMat4::from_cols(
            DVec3::X.extend(0.0),
            DVec3::Y.extend(0.0),
            DVec3::new(1.0, 0.0, 1.0).extend(0.0),
            glam::DVec4::W,
        );
        let points = [Vec3::ZERO, Vec3::Y, Vec3::Z];
        let prim = mesh("/m", &points, &[3], &[0, 1, 2]);
        let normals = Value::Vec3Array(vec![Vec3::X; 3]);
        let prim = with_attribute(prim, "normals", normals, None);
        let built = build_all(vec![transformed(prim, shear)]);
        let mesh = &built.meshes[0];
        assert!(
            mesh.shading_normal(0, 0.2, 0.2)
                .distance(mesh.plane_normal(0))
                < 1e-6
        );
    }

    #[test]
    fn a_scene_far_from_zero_keeps_its_shape_relative_to_its_origin() {
        let built = build_all(vec![moved(triangle("/m"), 1e6, 0.0, -3e6)]);
        assert!(built.origin.x > 9e5);
        let [a, b, c] = built.meshes[0].corners(0);
        assert_eq!((b - a, c - a), (Vec3::X, Vec3::Y));
        let world = built.origin + a.as_dvec3();
        assert_eq!(world, DVec3::new(1e6, 0.0, -3e6));
    }

    /// usd-core's own numbers for this stage: `ComputeInstanceTransformsAtTime` on a PointInstancer with a prototype
    /// at z = 10 below a scope that is itself moved (which must not count).
    fn instancer_stage() -> Vec<RawPrim> {
        let instancer = moved(prim("/W/PI", "PointInstancer", Some(0)), 0.0, 1.0, 0.0);
        let instancer = with_ints(instancer, "protoIndices", &[0, 1, 0]);
        let positions = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]].map(Vec3::from_array);
        let scales = [[1.0; 3], [2.0, 3.0, 4.0], [-1.0, 2.0, 1.0]].map(Vec3::from_array);
        // 0.7071 as a half float.
        let half = 0.707_031_25;
        let orientations = [
            [0.0, half, 0.0, half],
            [0.0, 0.0, 0.0, 1.0],
            [0.5, 0.5, 0.5, 0.5],
        ];
        let vectors = |values: [Vec3; 3]| Value::Vec3Array(values.to_vec());
        let instancer = with_attribute(instancer, "positions", vectors(positions), None);
        let instancer = with_attribute(instancer, "scales", vectors(scales), None);
        let orientations = Value::QuatArray(orientations.map(Vec4::from_array).to_vec());
        let mut instancer = with_attribute(instancer, "orientations", orientations, None);
        let targets = vec!["/W/PI/P/A".to_owned(), "/W/PI/P/B".to_owned()];
        instancer.relationships.insert(
            "prototypes".to_owned(),
            RawRelationship {
                targets,
                bind_material_as: None,
            },
        );
        vec![
            moved(prim("/W", "Xform", None), 7.0, 0.0, 0.0),
            instancer,
            moved(prim("/W/PI/P", "Xform", Some(1)), 1000.0, 0.0, 0.0),
            moved(prim("/W/PI/P/A", "Xform", Some(2)), 0.0, 0.0, 10.0),
            under(triangle("/W/PI/P/A/t"), 3),
            under(triangle("/W/PI/P/B"), 2),
        ]
    }

    #[test]
    fn point_instances_stand_where_usd_core_puts_them() {
        let built = build_all(instancer_stage());
        let paths: Vec<_> = built.prims.iter().map(|p| p.path.as_str()).collect();
        assert_eq!(paths, ["/W/PI[0]/A/t", "/W/PI[1]/B", "/W/PI[2]/A/t"]);
        let rows = [
            [
                0.000213623046875,
                0.0,
                0.999786376953125,
                10.99786376953125 + 7.0,
            ],
            [0.0, 1.0, 0.0, 2.0 + 1.0],
            [-0.999786376953125, 0.0, 0.000213623046875, 3.00213623046875],
        ];
        let got = built.prims[0].world_from_object;
        for (r, row) in rows.iter().enumerate() {
            for (c, &value) in row.iter().enumerate() {
                let got = if c < 3 {
                    got.matrix3.col(c)[r]
                } else {
                    got.translation[r]
                };
                assert!(
                    (f64::from(got) - value).abs() < 1e-6,
                    "row {r} column {c}: {got}"
                );
            }
        }
        let last = built.prims[2].world_from_object;
        let images = [
            last.matrix3.x_axis,
            last.matrix3.y_axis,
            last.matrix3.z_axis,
        ];
        let expected = [Vec3::NEG_Y, 2.0 * Vec3::Z, Vec3::X];
        for (image, expected) in images.iter().zip(expected) {
            assert!(Vec3::from(*image).distance(expected) < 1e-6);
        }
        assert!(Vec3::from(last.translation).distance(Vec3::new(24.0, 9.0, 9.0)) < 1e-5);
        let single = &built.meshes[built.prims[1].mesh.index()];
        assert_eq!(single.positions[1], Vec3::new(13.0, 6.0, 6.0));
        assert_eq!(
            built.prims[2].source,
            PrimSource::PointInstance {
                instancer: "/W/PI".into(),
                index: 2,
                shared_path: "/W/PI/P/A/t".into()
            }
        );
    }

    #[test]
    fn invisible_ids_hide_points_by_id_or_index() {
        let mut prims = instancer_stage();
        prims[1] = with_ints(prims[1].clone(), "invisibleIds", &[1]);
        assert_eq!(build_all(prims.clone()).prims.len(), 2);
        prims[1] = with_attribute(
            prims[1].clone(),
            "ids",
            Value::Int64Array(vec![1, 5, 1]),
            None,
        );
        let built = build_all(prims);
        assert_eq!(built.prims.len(), 1);
        assert_eq!(built.prims[0].path, "/W/PI[1]/B");
    }

    #[test]
    fn flawed_instancers_are_left_out_with_a_warning() {
        let mut prims = instancer_stage();
        prims[1] = with_ints(prims[1].clone(), "protoIndices", &[0, 7, -1]);
        let built = build_all(prims.clone());
        assert_eq!(
            (built.prims.len(), built.warnings),
            (1, vec!["bad-instance".to_owned()])
        );
        prims[1] = with_ints(prims[1].clone(), "protoIndices", &[0, 1]);
        let built = build_all(prims);
        assert_eq!(
            (built.prims.len(), built.warnings),
            (0, vec!["bad-instancer".to_owned()])
        );
    }

    #[test]
    fn nested_instancers_multiply_and_one_in_itself_ends() {
        let points = |prim: RawPrim, target: &str| {
            let positions = vec![Vec3::X, 2.0 * Vec3::X];
            let prim = with_attribute(prim, "positions", Value::Vec3Array(positions), None);
            let mut prim = with_ints(prim, "protoIndices", &[0, 0]);
            let relationship = RawRelationship {
                targets: vec![target.to_owned()],
                bind_material_as: None,
            };
            prim.relationships
                .insert("prototypes".to_owned(), relationship);
            prim
        };
        let outer = points(prim("/o", "PointInstancer", None), "/o/i");
        let inner = points(prim("/o/i", "PointInstancer", Some(0)), "/o/i/t");
        let leaf = under(triangle("/o/i/t"), 1);
        let built = build_all(vec![outer, inner, leaf.clone()]);
        let placed: Vec<_> = built
            .prims
            .iter()
            .map(|p| (p.path.as_str(), p.world_from_object.translation.x))
            .collect();
        let expected = [
            ("/o[0]/i[0]/t", 2.0),
            ("/o[0]/i[1]/t", 3.0),
            ("/o[1]/i[0]/t", 3.0),
            ("/o[1]/i[1]/t", 4.0),
        ];
        assert_eq!(placed, expected);

        let own = points(prim("/o", "PointInstancer", None), "/o");
        let built = build_all(vec![own]);
        assert!(built.prims.is_empty());
        assert_eq!(built.warnings, ["cyclic-instance"]);
    }

    #[test]
    fn instancers_inside_native_instances_find_the_prototypes_of_their_instance() {
        let mut prims = vec![
            prim("/A", "Xform", None),
            moved(prim("/B", "Xform", None), 5.0, 0.0, 0.0),
        ];
        prims[0].prototype = Some(2);
        prims[1].prototype = Some(2);
        prims.push(prim("/__Prototype_1", "Xform", None));
        let instancer = prim("/__Prototype_1/pi", "PointInstancer", Some(2));
        let instancer = with_ints(instancer, "protoIndices", &[0]);
        let positions = Value::Vec3Array(vec![Vec3::Y]);
        let mut instancer = with_attribute(instancer, "positions", positions, None);
        instancer.relationships.insert(
            "prototypes".to_owned(),
            RawRelationship {
                targets: vec!["/__Prototype_1/pi/t".to_owned()],
                bind_material_as: None,
            },
        );
        prims.push(instancer);
        prims.push(under(triangle("/__Prototype_1/pi/t"), 3));
        let built = build(prims, 2);
        let paths: Vec<_> = built.prims.iter().map(|p| p.path.as_str()).collect();
        assert_eq!(paths, ["/A/pi[0]/t", "/B/pi[0]/t"]);
        assert_eq!(built.prims[1].world_from_object.translation.x, 5.0);
    }

    #[test]
    fn a_hundred_thousand_points_take_less_than_a_second() {
        let count = 100_000_u32;
        let mut prims = instancer_stage();
        #[expect(clippy::cast_precision_loss, reason = "below 2^24")]
        let positions = (0..count).map(|i| Vec3::splat(i as f32)).collect();
        prims[1].attributes.remove("scales");
        prims[1].attributes.remove("orientations");
        prims[1] = with_attribute(
            prims[1].clone(),
            "positions",
            Value::Vec3Array(positions),
            None,
        );
        prims[1] = with_ints(prims[1].clone(), "protoIndices", &vec![0; count as usize]);
        let start = std::time::Instant::now();
        let built = build_all(prims);
        let seconds = start.elapsed().as_secs_f64();
        assert_eq!((built.prims.len(), built.meshes.len()), (count as usize, 1));
        assert!(seconds < 1.0, "took {seconds} s");
    }

    #[test]
    fn subsets_of_the_material_bind_family_give_faces_their_materials() {
        let subset = |path: &str, family: &str, faces: &[i32]| {
            let prim = with_token(prim(path, "GeomSubset", Some(0)), "familyName", family);
            with_ints(prim, "indices", faces)
        };
        let points = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];
        let indices = [0, 1, 2, 1, 3, 2, 0, 2, 1];
        let raw = RawStage {
            prims: vec![
                mesh("/m", &points, &[3, 3, 3], &indices),
                subset("/m/a", "materialBind", &[1, 99]),
                subset("/m/b", "other", &[2]),
            ],
            prototype_start: 3,
            ..RawStage::default()
        };
        let look = Look {
            binding: vec![
                Some(MaterialId(4)),
                Some(MaterialId(7)),
                Some(MaterialId(9)),
            ],
            ..Look::default()
        };
        let materials = &try_build(&raw, &look).unwrap().prims[0].materials;
        let of_faces = [0, 1, 2].map(|face| materials.of_face(face));
        assert_eq!(of_faces, [4, 7, 4].map(|id| Some(MaterialId(id))));
    }

    #[test]
    fn occurrences_that_inherit_different_primvars_do_not_share_a_mesh() {
        let color = |prim: RawPrim, value: f32| {
            let value = Value::Vec3Array(vec![Vec3::splat(value)]);
            with_attribute(prim, "primvars:displayColor", value, None)
        };
        let mut prims = vec![
            color(prim("/a", "Xform", None), 0.25),
            color(prim("/b", "Xform", None), 0.5),
            prim("/a/i", "Xform", Some(0)),
            prim("/b/i", "Xform", Some(1)),
            prim("/b/j", "Xform", Some(1)),
        ];
        for instance in &mut prims[2..] {
            instance.prototype = Some(5);
        }
        prims.push(prim("/__Prototype_1", "Xform", None));
        prims.push(under(triangle("/__Prototype_1/t"), 5));
        let built = build(prims, 5);
        assert_eq!((built.meshes.len(), built.prims.len()), (2, 3));
        let colors: Vec<_> = built
            .prims
            .iter()
            .map(|p| {
                built.meshes[p.mesh.index()]
                    .primvar("displayColor")
                    .unwrap()
                    .values[0]
                    .x
            })
            .collect();
        assert_eq!(colors, [0.25, 0.5, 0.5]);
    }

    #[test]
    fn skinning_is_named_where_a_skeleton_is_bound_with_or_without_the_api() {
        let skeleton = |mut prim: RawPrim| {
            let targets = vec!["/r/skel".to_owned()];
            let relationship = RawRelationship {
                targets,
                bind_material_as: None,
            };
            prim.relationships
                .insert("skel:skeleton".to_owned(), relationship);
            prim
        };
        let inherited = vec![
            skeleton(prim("/r", "SkelRoot", None)),
            prim("/r/g", "Xform", Some(0)),
            under(triangle("/r/g/t"), 1),
        ];
        assert_eq!(
            build_all(inherited.clone()).warnings,
            ["unsupported-skinning"]
        );
        let mut outside = inherited;
        outside[0].type_name = "Xform".to_owned();
        assert!(build_all(outside.clone()).warnings.is_empty());
        outside[2].api_schemas.push("SkelBindingAPI".to_owned());
        assert_eq!(build_all(outside).warnings, ["unsupported-skinning"]);
    }

    #[test]
    fn types_that_cannot_be_drawn_are_named() {
        let built = build_all(vec![
            prim("/hair", "HermiteCurves", None),
            prim("/x", "Xform", None),
        ]);
        assert_eq!(built.warnings, ["unsupported-prim"]);
    }

    #[test]
    fn flattening_transforms_are_kept_for_single_meshes_only_if_something_is_left() {
        let flat = DMat4::from_scale(DVec3::new(1.0, 1.0, 0.0));
        let built = build_all(vec![transformed(triangle("/m"), flat)]);
        assert_eq!(built.prims.len(), 1);
        assert_eq!(built.meshes[0].plane_normal(0), Vec3::Z);
    }

    #[test]
    fn equal_gprims_of_like_size_share_a_mesh() {
        let sphere = |path: &str, radius: f64, scale: f64, x: f64| {
            let matrix =
                DMat4::from_translation(DVec3::X * x) * DMat4::from_scale(DVec3::splat(scale));
            let made = transformed(prim(path, "Sphere", None), matrix);
            with_attribute(made, "radius", Value::Float(radius), None)
        };
        let flat = transformed(
            prim("/flat", "Sphere", None),
            DMat4::from_scale(DVec3::new(1.0, 1.0, 0.0)),
        );
        let built = build_all(vec![
            sphere("/big", 1.0, 1.0, 0.0),
            sphere("/small", 1.0, 0.01, 2.0),
            sphere("/pebble", 0.5, 0.02, 3.0),
            sphere("/again", 1.0, 0.02, 4.0),
            sphere("/big2", 1.0, 0.95, 6.0),
            flat,
        ]);
        let of: Vec<_> = built.prims.iter().map(|p| p.mesh.index()).collect();
        assert_eq!(of, [0, 1, 2, 1, 0, 3]);
        let triangles: Vec<_> = built.meshes.iter().map(|m| m.triangles.len()).collect();
        // 100 around and 50 from pole to pole; 32 and 16 for those of a hundredth of the scene.
        assert_eq!(triangles[..3], [9_800, 960, 960]);
        assert!(built.warnings.is_empty(), "{:?}", built.warnings);
        let again = &built.prims[3].world_from_object;
        assert_eq!(again.transform_point3(Vec3::X), Vec3::new(4.02, 0.0, 0.0));
    }

    #[test]
    fn the_first_bad_mesh_in_stage_order_is_reported() {
        let bad = |path: &str| mesh(path, &[Vec3::ZERO], &[3], &[0, 1, 2]);
        let raw = RawStage {
            prims: vec![triangle("/ok"), bad("/bad1"), bad("/bad2")],
            prototype_start: 3,
            ..RawStage::default()
        };
        let error = try_build(&raw, &Look::default()).err().unwrap();
        assert!(error.to_string().starts_with("mesh /bad1: "));
    }

    #[test]
    fn an_empty_stage_gives_an_empty_scene() {
        let built = build_all(Vec::new());
        assert!(built.meshes.is_empty() && built.prims.is_empty());
        assert_eq!(built.origin, DVec3::ZERO);
    }

    #[test]
    fn a_sphere_and_a_quaternion_turn_meet_in_world_space() {
        let turn = DMat4::from_quat(DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2));
        let cone = transformed(prim("/c", "Cone", None), turn);
        let built = build_all(vec![cone]);
        assert!(matches!(built.meshes[0].normals, Normals::Vertex(_)));
        let tip = built.meshes[0]
            .positions
            .iter()
            .map(|p| p.y)
            .fold(f32::MAX, f32::min);
        assert!((tip + 1.0).abs() < 1e-6, "{tip}");
    }
}
