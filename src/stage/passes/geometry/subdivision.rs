//! Subdivision meshes → refined meshes with limit positions and limit normals, by `opensubdiv-rs` (a port of
//! OpenSubdiv; checked against Blender's, see CRATES.md §2).
//!
//! Uniform refinement. Below their sharpness semi-sharp creases are still curved away, so the limit is taken at a
//! level of at least the sharpness where the budget allows; at a coarser level what is left of them stays sharp.

use super::super::super::raw::RawPrim;
use super::attributes::floats;
use super::authored::{AuthoredMesh, Parts, Scheme};
use super::control::{Control, boundary_rule};
use super::limit_normals::{LevelData, SectorNormals};
use super::primvars::{AuthoredPrimvar, Layout};
use super::triangulate::Triangulation;
use crate::diagnostics::Diagnostics;
use crate::scene::{Interpolation, Mesh, Normals, Primvar};
use glam::{DVec3, Vec3, Vec4};
use opensubdiv_rs::far::{PrimvarRefiner, TopologyLevel, TopologyRefiner, UniformOptions};
use opensubdiv_rs::sdc::VtxBoundaryInterpolation;

/// From here on a crease never smooths (OpenSubdiv's `SHARPNESS_INFINITE`).
const INFINITE_SHARPNESS: f32 = 10.0;

/// Refine `mesh` `level` times; 0 only if all its faces are of the size that the scheme refines into. Topology that cannot be subdivided (a face that uses a point twice, Loop
/// with other faces than triangles) gives a warning and the mesh as polygons.
pub(super) fn subdivide(mesh: AuthoredMesh, level: usize, diagnostics: &Diagnostics) -> Mesh {
    let reason = match Refined::new(&mesh, level, diagnostics) {
        Ok(refined) => {
            let parts = refined.into_parts();
            return mesh.finish(parts);
        }
        Err(reason) => reason,
    };
    diagnostics.warn(
        "not-subdivided",
        mesh.prim.path.clone(),
        format!(
            "{} subdivision is not possible, drawn as polygons: {reason}",
            mesh.scheme.token()
        ),
    );
    mesh.into_polygons(diagnostics)
}

/// Levels that the finite sharpnesses of `prim` need before limits may be taken.
pub(super) fn sharpness_levels(prim: &RawPrim) -> usize {
    let sharpnesses = floats(prim, "creaseSharpnesses").iter();
    let all = sharpnesses.chain(floats(prim, "cornerSharpnesses"));
    let finite = all.filter(|sharpness| **sharpness < INFINITE_SHARPNESS);
    let highest = finite.fold(0.0_f32, |highest, &sharpness| highest.max(sharpness));
    (0..10_u8)
        .position(|level| f32::from(level) >= highest)
        .unwrap_or(10)
}

struct Refined<'a> {
    mesh: &'a AuthoredMesh<'a>,
    refiner: TopologyRefiner,
    /// Cage faces that are refined (all of three vertices or more).
    faces: Vec<u32>,
    /// Vertex of the last level → index into the mesh's positions: cage points first.
    position_of_vertex: Vec<u32>,
    position_count: usize,
    face_size: usize,
}

impl<'a> Refined<'a> {
    fn new(
        mesh: &'a AuthoredMesh,
        level: usize,
        diagnostics: &Diagnostics,
    ) -> Result<Self, String> {
        let faces: Vec<u32> = (0..)
            .zip(mesh.topology.counts.iter())
            .filter_map(|(face, &count)| (count >= 3).then_some(face))
            .collect();
        let mut refiner = Control::of(mesh, &faces, diagnostics).refiner(mesh)?;
        refiner.refine_uniform(UniformOptions::new(level));
        let (position_of_vertex, position_count) = order_vertices(&refiner, &mesh.topology.indices);
        Ok(Self {
            mesh,
            faces,
            position_of_vertex,
            position_count: position_count.max(mesh.topology.point_count),
            face_size: mesh.scheme.face_size() as usize,
            refiner,
        })
    }

    fn last(&self) -> TopologyLevel<'_> {
        self.refiner.level(self.refiner.max_level())
    }

    fn into_parts(self) -> Parts {
        let points: Vec<[f64; 3]> = self
            .mesh
            .points
            .iter()
            .map(|p| p.as_dvec3().to_array())
            .collect();
        let control = self.interpolate(&points, [0.0; 3]);
        let limit = self.limit(&control);
        let sources = self.source_faces();
        let is_drawn = self.drawn(&sources);
        let mut positions = self.mesh.points.to_vec();
        positions.resize(self.position_count, Vec3::ZERO);
        for (vertex, position) in limit.iter().enumerate() {
            positions[self.position_of_vertex[vertex] as usize] =
                DVec3::from_array(*position).as_vec3();
        }
        let mut triangulation = self.triangulate(&sources, &is_drawn);
        if self.mesh.left_handed {
            triangulation.flip();
        }
        let shading = self.normals(&LevelData {
            level: self.last(),
            scheme: self.mesh.scheme,
            control: &control,
            limit: &limit,
            face_size: self.face_size,
            is_drawn: &is_drawn,
        });
        let (normals, point_normals, corner_normals) = match shading {
            Some(shading) => self.lay_out_normals(shading, &triangulation),
            None => {
                let flat = super::normals::CageNormals::Flat;
                let cage_points = &positions[..self.mesh.topology.point_count];
                let (points, corners) =
                    flat.for_cage(&self.mesh.topology, cage_points, self.mesh.left_handed);
                (Normals::Flat, points, corners)
            }
        };
        let channels = self.channels();
        let primvars = self.mesh.primvars.iter().zip(channels);
        let primvars = primvars.map(|(p, channel)| self.primvar(p, channel, &triangulation));
        Parts {
            primvars: primvars.collect(),
            positions,
            triangles: triangulation.triangles,
            triangle_faces: triangulation.faces,
            normals,
            point_normals,
            corner_normals,
            boundary: self.mesh.topology.boundary(),
            scheme: self.mesh.scheme,
        }
    }

    /// Values of the last level by the smooth rules.
    fn interpolate<T: opensubdiv_rs::far::Primvar>(&self, base: &[T], zero: T) -> Vec<T> {
        let rules = PrimvarRefiner::new(&self.refiner);
        let mut values = base.to_vec();
        for level in 1..=self.refiner.max_level() {
            let mut refined = vec![zero.clone(); self.refiner.level(level).num_vertices()];
            rules.interpolate(level, &values, &mut refined);
            values = refined;
        }
        values
    }

    fn limit<T: opensubdiv_rs::far::Primvar>(&self, values: &[T]) -> Vec<T> {
        let mut limit = values.to_vec();
        PrimvarRefiner::new(&self.refiner).limit(values, &mut limit);
        if self.refiner.max_level() == 0 {
            // The cage may have points that no face uses: they have no limit and stay.
            let is_unused = |vertex: &usize| self.last().vertex_faces(*vertex).is_empty();
            for vertex in (0..values.len()).filter(is_unused) {
                limit[vertex].clone_from(&values[vertex]);
            }
        }
        limit
    }

    /// Cage face of every face of the last level.
    fn source_faces(&self) -> Vec<u32> {
        let mut sources = self.faces.clone();
        for level in 1..=self.refiner.max_level() {
            let refinement = self.refiner.refinement(level);
            let children = 0..self.refiner.level(level).num_faces();
            sources = children
                .map(|child| sources[refinement.child_face_parent_face(child) as usize])
                .collect();
        }
        sources
    }

    /// Holes are not drawn, nor are the faces at a boundary that is not interpolated.
    fn drawn(&self, sources: &[u32]) -> Vec<bool> {
        let base = self.refiner.level(0);
        let mut is_drawn = self.mesh.topology.is_drawn.clone();
        if boundary_rule(&self.mesh.prim) == VtxBoundaryInterpolation::None {
            for (index, &face) in self.faces.iter().enumerate() {
                let mut points = base.face_vertices(index).iter();
                is_drawn[face as usize] &= !points.any(|&v| base.is_vertex_boundary(v as usize));
            }
        }
        sources
            .iter()
            .map(|&face| is_drawn[face as usize])
            .collect()
    }

    fn triangulate(&self, sources: &[u32], is_drawn: &[bool]) -> Triangulation {
        let last = self.last();
        let mut result = Triangulation::default();
        let mut first_corner = 0;
        for (face, &source) in sources.iter().enumerate() {
            if is_drawn[face] {
                let vertices = last.face_vertices(face);
                // Refined faces are convex enough: always the same diagonal, which neighbors agree on.
                for i in 1..self.face_size - 1 {
                    let local = [0, i, i + 1];
                    result.triangles.push(
                        local.map(|corner| self.position_of_vertex[vertices[corner] as usize]),
                    );
                    result
                        .corners
                        .push(local.map(|corner| first_corner + small(corner)));
                    result.faces.push(source);
                }
            }
            first_corner += small(self.face_size);
        }
        result
    }

    /// Limit normals; `None` for bilinear surfaces, which are faceted.
    fn normals(&self, data: &LevelData) -> Option<SectorNormals> {
        if self.mesh.scheme == Scheme::Bilinear {
            return None;
        }
        let mut sectors = SectorNormals::of(data);
        if self.mesh.left_handed {
            for normal in &mut sectors.normals {
                *normal = -*normal;
            }
        }
        Some(sectors)
    }

    /// Over the triangles, at the cage's points, and (where they split there) at the cage's face-vertices.
    fn lay_out_normals(
        &self,
        sectors: SectorNormals,
        triangulation: &Triangulation,
    ) -> (Normals, Vec<Vec3>, Vec<Vec3>) {
        let mut at_positions = vec![Vec3::ZERO; self.position_count];
        let mut counts = vec![0_u32; self.position_count];
        for (normal, &vertex) in sectors.normals.iter().zip(&sectors.vertex_of_sector) {
            let position = self.position_of_vertex[vertex as usize] as usize;
            at_positions[position] += *normal;
            counts[position] += 1;
        }
        let point_count = self.mesh.topology.point_count;
        let unit = |sum: &Vec3| sum.normalize_or_zero();
        let points = at_positions[..point_count].iter().map(unit).collect();
        let corners = if counts[..point_count].iter().any(|&count| count > 1) {
            self.cage_corner_normals(&sectors)
        } else {
            Vec::new()
        };
        if counts.iter().all(|&count| count <= 1) {
            return (Normals::Vertex(at_positions), points, corners);
        }
        let of_corner = |corner: u32| sectors.sector_of_corner[corner as usize];
        let normals = Normals::Corner {
            corners: triangulation
                .corners
                .iter()
                .map(|t| t.map(of_corner))
                .collect(),
            values: sectors.normals,
        };
        (normals, points, corners)
    }

    /// The normal of every cage face-vertex is that of the refined face in its corner (the face itself at level 0): child i of a face lies at its
    /// corner i, and has that corner first (quads) or in place (triangles).
    fn cage_corner_normals(&self, sectors: &SectorNormals) -> Vec<Vec3> {
        let topology = &self.mesh.topology;
        let mut normals = vec![Vec3::ZERO; topology.indices.len()];
        let mut first_child = 0;
        let is_refined = self.refiner.max_level() > 0;
        for (index, &face) in self.faces.iter().enumerate() {
            for (corner, slot) in topology.corners(face as usize).enumerate() {
                if !is_refined {
                    let sector = sectors.sector_of_corner[index * self.face_size + corner];
                    if let Some(normal) = sectors.normals.get(sector as usize) {
                        normals[slot] = *normal;
                    }
                    continue;
                }
                let mut child = first_child + corner;
                let place = if self.face_size == 3 { corner } else { 0 };
                for _ in 1..self.refiner.max_level() {
                    child = 4 * child + place;
                }
                let sector = sectors.sector_of_corner[child * self.face_size + place];
                if let Some(normal) = sectors.normals.get(sector as usize) {
                    normals[slot] = *normal;
                }
            }
            first_child += match self.mesh.scheme {
                Scheme::Loop => 4,
                _ => topology.counts[face as usize] as usize,
            };
        }
        normals
    }

    /// Face-varying channel of every primvar, in the order in which [`Control`] adds them.
    fn channels(&self) -> Vec<Option<usize>> {
        let mut next = 0;
        let primvars = self.mesh.primvars.iter();
        primvars
            .map(|primvar| {
                (primvar.layout == Layout::FaceVarying).then(|| {
                    next += 1;
                    next - 1
                })
            })
            .collect()
    }

    fn primvar(
        &self,
        primvar: &AuthoredPrimvar,
        channel: Option<usize>,
        triangulation: &Triangulation,
    ) -> Primvar {
        let by_position = |values: Vec<[f32; 4]>| {
            let mut ordered = primvar.expanded();
            ordered.resize(self.position_count, Vec4::ZERO);
            for (vertex, value) in values.into_iter().enumerate() {
                ordered[self.position_of_vertex[vertex] as usize] = Vec4::from_array(value);
            }
            primvar.finish(Interpolation::Vertex, ordered)
        };
        match (primvar.layout, channel) {
            (Layout::Vertex, _) => {
                let refined = self.interpolate(&arrays(&primvar.expanded()), [0.0; 4]);
                by_position(self.limit(&refined))
            }
            (Layout::Varying, _) => by_position(self.varying(arrays(&primvar.expanded()))),
            (Layout::FaceVarying, Some(channel)) => {
                self.face_varying(primvar, channel, triangulation)
            }
            _ => primvar.clone().on_polygons(Vec::new()),
        }
    }

    /// Varying values: linear along edges and over faces, at every level.
    fn varying(&self, mut values: Vec<[f32; 4]>) -> Vec<[f32; 4]> {
        for level in 1..=self.refiner.max_level() {
            let parent = self.refiner.level(level - 1);
            let refinement = self.refiner.refinement(level);
            let mut refined = vec![[0.0; 4]; self.refiner.level(level).num_vertices()];
            let mut set = |child: u32, vertices: &[u32]| {
                if let Some(slot) = refined.get_mut(child as usize) {
                    *slot = mean(&values, vertices);
                }
            };
            for face in 0..parent.num_faces() {
                set(
                    refinement.face_child_vertex(face),
                    parent.face_vertices(face),
                );
            }
            for edge in 0..parent.num_edges() {
                set(
                    refinement.edge_child_vertex(edge),
                    &parent.edge_vertices(edge),
                );
            }
            for vertex in 0..parent.num_vertices() {
                set(refinement.vertex_child_vertex(vertex), &[small(vertex)]);
            }
            values = refined;
        }
        values
    }

    fn face_varying(
        &self,
        primvar: &AuthoredPrimvar,
        channel: usize,
        triangulation: &Triangulation,
    ) -> Primvar {
        let rules = PrimvarRefiner::new(&self.refiner);
        let base = arrays(&primvar.values);
        let values = rules.interpolate_face_varying_all(channel, &base).pop();
        let values = values.unwrap_or(base);
        let mut limit = vec![[0.0; 4]; self.last().num_fvar_values(channel)];
        rules.limit_face_varying(channel, &values, &mut limit);
        let last = self.last();
        let at = |corner: u32| {
            let (face, corner) = (
                corner as usize / self.face_size,
                corner as usize % self.face_size,
            );
            last.face_fvar_values(face, channel)[corner]
        };
        let corners = triangulation.corners.iter().map(|t| t.map(at)).collect();
        let values = limit.into_iter().map(Vec4::from_array).collect();
        primvar.finish(Interpolation::Corner(corners), values)
    }
}

pub(super) fn small(index: usize) -> u32 {
    u32::try_from(index).expect("opensubdiv-rs numbers everything in u32")
}

fn arrays(values: &[Vec4]) -> Vec<[f32; 4]> {
    values.iter().map(Vec4::to_array).collect()
}

fn mean(values: &[[f32; 4]], vertices: &[u32]) -> [f32; 4] {
    let vectors = vertices.iter();
    let sum: Vec4 = vectors.map(|&v| Vec4::from_array(values[v as usize])).sum();
    #[expect(clippy::cast_precision_loss, reason = "faces have few vertices")]
    let count = vertices.len() as f32;
    (sum / count).to_array()
}

/// Position of every vertex of the last level: cage points keep their index, the others follow. Also the number of
/// positions in use.
fn order_vertices(refiner: &TopologyRefiner, cage_indices: &[u32]) -> (Vec<u32>, usize) {
    let last = refiner.max_level();
    let point_count = refiner.level(0).num_vertices();
    if last == 0 {
        return ((0..small(point_count)).collect(), point_count);
    }
    let mut positions = vec![u32::MAX; refiner.level(last).num_vertices()];
    let mut is_used = vec![false; point_count];
    for &point in cage_indices {
        is_used[point as usize] = true;
    }
    for point in (0..point_count).filter(|&point| is_used[point]) {
        let vertex = (1..=last).try_fold(point, |vertex, level| {
            let child = refiner.refinement(level).vertex_child_vertex(vertex);
            // Points of faces that are not refined have no child.
            (child != opensubdiv_rs::INDEX_INVALID).then_some(child as usize)
        });
        if let Some(vertex) = vertex {
            positions[vertex] = small(point);
        }
    }
    let mut next = small(point_count);
    for position in positions
        .iter_mut()
        .filter(|position| **position == u32::MAX)
    {
        *position = next;
        next += 1;
    }
    (positions, next as usize)
}

#[cfg(test)]
mod tests;
