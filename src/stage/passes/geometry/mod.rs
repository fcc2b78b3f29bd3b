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
mod bodies;
mod control;
mod curves;
mod draw_modes;
mod face_materials;
mod gprims;
mod inherited;
mod instancer;
mod layouts;
mod limit_normals;
mod normals;
mod nurbs;
mod patch;
mod placement;
mod point_set;
mod primvars;
mod refinement;
mod solids;
mod subdivision;
mod surfaces;
mod topology;
mod triangulate;
mod world;

use super::super::raw::{RawPrim, RawStage};
use super::super::{Error, ReadSettings};
use super::flatten::Occurrence;
use super::look::Look;
use crate::diagnostics::Diagnostics;
use crate::scene::{Mesh, MeshId, Prim, PrimSource};
use authored::{AuthoredMesh, Scheme, local_origin};
use bodies::Bodies;
pub use bodies::Lent;
use curves::Curves;
use face_materials::Materials;
use glam::{Affine3A, DAffine3, DMat4, DVec3};
use gprims::Gprim;
use inherited::Inherited;
use patch::Patch;
use placement::{Kind, Placement};
use point_set::PointSet;
use rayon::prelude::*;
use refinement::Fineness;
use std::borrow::Cow;
use std::collections::HashMap;
pub use surfaces::Surfaces;

/// Primvars that are kept whether or not a material reads them.
const ALWAYS_KEPT: [&str; 3] = ["displayColor", "displayOpacity", "st"];

/// What is drawn where, and the origin that follows from it; geometry itself is not made yet.
#[derive(Debug)]
pub struct Layout<'a> {
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
    raw: &RawStage,
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
        occurrences,
        settings,
        placements,
        bounds,
        origin: local_origin(bounds.0, bounds.1),
    })
}

/// One distinct geometry.
struct Geometry<'a> {
    /// Its own where its arrays may be spent.
    prim: Cow<'a, RawPrim>,
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

    /// Make the geometry of `raw`, of which `self` is; with [`Making::Keeping`], surfaces that were refined for another time
    /// are taken from there.
    ///
    /// # Errors
    /// Meshes whose arrays contradict each other or whose points are not finite; cancellation.
    pub fn build(
        &self,
        raw: Lent<'_>,
        look: &Look,
        making: Making<'_>,
        diagnostics: &Diagnostics,
    ) -> Result<Built, Error> {
        let mut names = kept_primvars(look);
        if self.settings.all_primvars {
            names.extend(authored_numbers(&raw));
            names.sort_unstable();
            names.dedup();
        }
        let (raw, bodies) = raw.opened(self);
        let mut geometries = self.geometries((raw, &bodies), &names);
        drop(bodies);
        let mut sources = read_all(&mut geometries, &names, diagnostics)?;
        self.share_gprims(&mut geometries, &mut sources);
        self.ask_for_depth(&geometries, &mut sources);
        let levels = refinement::levels(&self.demands(&geometries, &sources), diagnostics);
        diagnostics.check()?;
        let asked: Vec<Asked> = sources.into_iter().zip(levels).collect();
        let made = match making {
            Making::Keeping(kept) => kept.make(&geometries, &names, asked, diagnostics),
            Making::Once(detail) => (asked.into_par_iter())
                .map(|(source, level)| make(source, level, detail, diagnostics))
                .collect(),
        };
        diagnostics.check()?;
        Ok(self.assemble(&geometries, made, (raw, look), diagnostics))
    }

    /// Distinct geometries in order of first use.
    fn geometries<'b>(
        &self,
        (raw, bodies): (&'b RawStage, &Bodies),
        names: &[String],
    ) -> Vec<Geometry<'b>> {
        let inherited = Inherited::of(raw, self.occurrences, names);
        let mut by_key: HashMap<(usize, usize), usize> = HashMap::new();
        let mut geometries: Vec<Geometry> = Vec::new();
        for (index, placement) in self.placements.iter().enumerate() {
            let prim = self.occurrences[placement.occurrence].prim;
            let set = inherited.set_of[placement.occurrence];
            let geometry = *by_key.entry((prim, set)).or_insert_with(|| {
                let owners = inherited.sets[set].iter();
                geometries.push(Geometry {
                    prim: bodies.of(raw, prim),
                    inherited: owners
                        .map(|(name, owner)| (names[*name].clone(), &raw.prims[*owner]))
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

    /// Curves, patches and points are cut as their largest occurrence asks.
    fn ask_for_depth(&self, geometries: &[Geometry], sources: &mut [Source]) {
        for (geometry, source) in geometries.iter().zip(sources) {
            if let Source::Curves(_, depth) | Source::Patch(_, depth) | Source::Points(_, depth) =
                source
            {
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
        made: Vec<Option<Made>>,
        of: (&RawStage, &Look),
        diagnostics: &Diagnostics,
    ) -> Built {
        let mut meshes = Vec::with_capacity(made.len());
        let mut triangles = Vec::with_capacity(made.len());
        let mut of_placement: Vec<Option<(MeshId, Affine3A)>> = vec![None; self.placements.len()];
        for (geometry, made) in geometries.iter().zip(made) {
            let Some(made) = made else {
                continue;
            };
            let (mut mesh, center) = (made.mesh, made.center);
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
            triangles.push(made.triangles);
        }
        Built {
            meshes,
            prims: self.prims(of_placement, of),
            triangles,
        }
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

    fn prims(
        &self,
        of_placement: Vec<Option<(MeshId, Affine3A)>>,
        (raw, look): (&RawStage, &Look),
    ) -> Vec<Prim> {
        let mut materials = Materials::of(raw, self.occurrences, look);
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
        path.to_string(),
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

/// Names of all primvars of numbers on the stage but those of skinning.
fn authored_numbers(raw: &RawStage) -> Vec<String> {
    let attributes = raw.prims.iter().flat_map(|prim| &prim.attributes);
    let names = attributes.filter_map(|(name, attribute)| {
        let name = name.strip_prefix("primvars:")?;
        let is_data = !name.ends_with(":indices") && !name.starts_with("skel:");
        let numbers = attribute.value.as_ref().is_some_and(|value| {
            use crate::stage::raw::Value as V;
            matches!(
                value,
                V::FloatArray(_)
                    | V::Vec2Array(_)
                    | V::Vec3Array(_)
                    | V::Vec4Array(_)
                    | V::IntArray(_)
            )
        });
        (is_data && numbers).then(|| name.to_owned())
    });
    names.collect()
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
    /// The same.
    Points(Box<PointSet<'a>>, f64),
    Nothing,
}

fn read_all<'a>(
    geometries: &mut [Geometry<'a>],
    names: &[String],
    diagnostics: &Diagnostics,
) -> Result<Vec<Source<'a>>, Error> {
    let read = |geometry: &mut Geometry<'a>| {
        let inherited = &geometry.inherited;
        let prim = match &mut geometry.prim {
            // only meshes are
            Cow::Owned(prim) => {
                let mesh = Cow::Owned(std::mem::take(prim));
                let mesh = AuthoredMesh::read(mesh, inherited, names, diagnostics)?;
                return Ok(Source::of(mesh, Source::Mesh));
            }
            Cow::Borrowed(prim) => *prim,
        };
        Ok(match Kind::of(prim) {
            Kind::Mesh => {
                let mesh = AuthoredMesh::read(Cow::Borrowed(prim), inherited, names, diagnostics)?;
                Source::of(mesh, Source::Mesh)
            }
            Kind::Curves => {
                let curves = Curves::read(prim, inherited, names, diagnostics);
                Source::of(curves, |curves| Source::Curves(curves, 0.0))
            }
            Kind::Patch => {
                let patch = Patch::read(prim, inherited, names, diagnostics);
                Source::of(patch, |patch| Source::Patch(patch, 0.0))
            }
            Kind::Points => {
                let set = PointSet::read(prim, inherited, names, diagnostics);
                Source::of(set, |set| Source::Points(set, 0.0))
            }
            _ => {
                let gprim = Gprim::read(prim, inherited, names, diagnostics);
                Source::of(gprim, |gprim| Source::Gprim(gprim, 0))
            }
        })
    };
    // Collected whole first: the error reported is the first in stage order for any thread count.
    let all: Vec<Result<Source, Error>> = geometries.par_iter_mut().map(read).collect();
    all.into_iter().collect()
}

impl<'a> Source<'a> {
    fn of<T>(read: Option<T>, source: impl FnOnce(Box<T>) -> Self) -> Self {
        read.map_or(Self::Nothing, |read| source(Box::new(read)))
    }
}

/// How geometry is made.
#[derive(Debug)]
pub enum Making<'a> {
    /// As far as that.
    Once(Detail),
    /// In [`Detail::Full`]; surfaces are kept for other times.
    Keeping(&'a mut Surfaces),
}

/// How far geometry is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// As it is drawn.
    Full,
    /// Subdivision surfaces are the polygons of their cages: some 20 times sooner.
    Cages,
}

/// Geometry and its occurrences.
#[derive(Debug)]
pub struct Built {
    /// Every distinct geometry.
    pub meshes: Vec<Mesh>,
    /// One for each time a mesh is drawn.
    pub prims: Vec<Prim>,
    /// Triangles of each mesh in [`Detail::Full`].
    pub triangles: Vec<usize>,
}

/// A source, and how often it is refined.
type Asked<'a> = (Source<'a>, usize);

/// A mesh, where its own origin lies, and how many triangles it has in [`Detail::Full`].
#[derive(Debug, Clone)]
struct Made {
    mesh: Mesh,
    center: DVec3,
    triangles: usize,
}

fn make(source: Source, level: usize, detail: Detail, diagnostics: &Diagnostics) -> Option<Made> {
    if diagnostics.check().is_err() {
        return None;
    }
    let (mesh, center) = match source {
        Source::Nothing => return None,
        Source::Gprim(gprim, facets) => (gprim.tessellate(facets), DVec3::ZERO),
        Source::Curves(curves, depth) => curves.tessellate(depth),
        Source::Patch(patch, depth) => patch.tessellate(depth),
        Source::Points(set, depth) => set.tessellate(depth),
        Source::Mesh(mesh) if mesh.scheme == Scheme::None => {
            let center = mesh.center;
            (mesh.into_polygons(diagnostics), center)
        }
        Source::Mesh(mesh) if detail == Detail::Cages => {
            return Some(Made {
                triangles: refinement::triangle_count(&mesh, level),
                center: mesh.center,
                mesh: mesh.into_cage_polygons(),
            });
        }
        Source::Mesh(mesh) => {
            let center = mesh.center;
            (subdivision::subdivide(*mesh, level, diagnostics), center)
        }
    };
    Some(Made {
        triangles: mesh.triangles.len(),
        mesh,
        center,
    })
}

#[cfg(test)]
mod tests;
