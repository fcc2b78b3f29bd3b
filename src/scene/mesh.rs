//! Surfaces as triangles, with what the authored mesh (the cage) needs to get values back.

use crate::math::Bounds3;
use glam::{Vec3, Vec4};

/// Index into [`super::Scene::meshes`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MeshId(pub u32);

impl MeshId {
    /// As an index.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// How a primvar's values are laid out over the **triangles** of a [`Mesh`] (not over the cage).
#[derive(Debug, Clone, PartialEq)]
pub enum Interpolation {
    /// One value.
    Constant,
    /// One value a triangle's source face: `values[triangle_faces[t]]`.
    Uniform,
    /// One value a position of the mesh (USD `vertex` and `varying`).
    Vertex,
    /// `corners[t][k]` indexes the value at corner `k` of triangle `t` (USD `faceVarying`).
    Corner(Vec<[u32; 3]>),
}

/// A primvar resolved onto the triangles; 1 to 4 components, unused ones 0 (alpha 1 for colors).
#[derive(Debug, Clone, PartialEq)]
pub struct Primvar {
    /// Name without the `primvars:` prefix.
    pub name: String,
    /// How many of the four components were authored (1–4).
    pub components: u8,
    /// Layout of `values`.
    pub interpolation: Interpolation,
    /// The values, de-indexed as far as `interpolation` says.
    pub values: Vec<Vec4>,
}

impl Primvar {
    /// Value at barycentric `(u, v)` of triangle `t` (weights `1-u-v, u, v` of its corners).
    pub fn sample(&self, mesh: &Mesh, t: usize, u: f32, v: f32) -> Vec4 {
        let mix = |i: [u32; 3]| {
            let at = |k: usize| self.values[i[k] as usize];
            at(0) * (1.0 - u - v) + at(1) * u + at(2) * v
        };
        match &self.interpolation {
            Interpolation::Constant => self.values[0],
            Interpolation::Uniform => self.values[mesh.triangle_faces[t] as usize],
            Interpolation::Vertex => mix(mesh.triangles[t]),
            Interpolation::Corner(corners) => mix(corners[t]),
        }
    }
}

/// Shading normals of a [`Mesh`], unit, on the front side (right-handed orientation).
#[derive(Debug, Clone, PartialEq)]
pub enum Normals {
    /// The triangles' own plane normals.
    Flat,
    /// One a position.
    Vertex(Vec<Vec3>),
    /// `corners[t][k]` indexes `values`.
    Corner {
        /// Index into `values` for each triangle corner.
        corners: Vec<[u32; 3]>,
        /// Unit normals.
        values: Vec<Vec3>,
    },
}

/// The authored mesh, as far as values are written back to it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cage {
    /// Number of authored points: `Mesh::positions[..point_count]` are exactly those points, in authored order
    /// (at their limit positions if the mesh is a subdivision surface).
    pub point_count: usize,
    /// Authored `faceVertexCounts`, holes included.
    pub face_vertex_counts: Vec<u32>,
    /// Authored `faceVertexIndices` in authored order (also for left-handed meshes).
    pub face_vertex_indices: Vec<u32>,
    /// One unit shading normal a point (area-weighted over the adjoining faces where authored normals split),
    /// front side; zero for a point that no face uses.
    pub point_normals: Vec<Vec3>,
    /// One unit shading normal a face-vertex when shading normals split at points, else empty.
    pub corner_normals: Vec<Vec3>,
    /// True for points on an open edge of the mesh (used by one face only).
    pub on_boundary: Vec<bool>,
}

/// A surface as triangles: polygon meshes triangulated, subdivision surfaces refined with limit positions, implicit
/// gprims tessellated. Front faces are counter-clockwise (left-handed meshes were flipped).
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    /// Positions: object space when several prims share the mesh, else world space relative to the scene's origin
    /// (and the prim's transform is the identity). Finite.
    pub positions: Vec<Vec3>,
    /// Indices into `positions`; never degenerate in index, possibly of zero area.
    pub triangles: Vec<[u32; 3]>,
    /// Source face of every triangle on the cage (index into `face_vertex_counts`), or 0-based part of a gprim.
    pub triangle_faces: Vec<u32>,
    /// Shading normals.
    pub normals: Normals,
    /// Primvars the job asked for (texture coordinates, displayColor, those that materials read).
    pub primvars: Vec<Primvar>,
    /// USD `doubleSided`.
    pub double_sided: bool,
    /// No open edges, every edge used twice in opposite directions.
    pub closed: bool,
    /// The authored mesh; `None` for implicit gprims, which have no points to write values to.
    pub cage: Option<Cage>,
    /// `subdivisionScheme` that made it: `none`, `catmullClark`, `loop`, `bilinear`, or the gprim's type name.
    pub scheme: String,
}

impl Mesh {
    /// True if each of its faces is a ball: `Points` without normals.
    pub fn is_of_balls(&self) -> bool {
        self.scheme == "Points" && self.closed
    }

    /// Bounds of all positions, in the space of `positions`.
    pub fn bounds(&self) -> Bounds3 {
        Bounds3::around(self.positions.iter().copied())
    }

    /// The primvar called `name`.
    pub fn primvar(&self, name: &str) -> Option<&Primvar> {
        self.primvars.iter().find(|primvar| primvar.name == name)
    }

    /// Corner positions of triangle `t`.
    pub fn corners(&self, t: usize) -> [Vec3; 3] {
        self.triangles[t].map(|i| self.positions[i as usize])
    }

    /// Unit shading normal at barycentric `(u, v)` of triangle `t`, in the space of `positions`; the plane normal
    /// where the interpolated one vanishes, zero for a triangle without area.
    pub fn shading_normal(&self, t: usize, u: f32, v: f32) -> Vec3 {
        let mix = |values: &[Vec3], i: [u32; 3]| {
            values[i[0] as usize] * (1.0 - u - v)
                + values[i[1] as usize] * u
                + values[i[2] as usize] * v
        };
        let interpolated = match &self.normals {
            Normals::Flat => Vec3::ZERO,
            Normals::Vertex(values) => mix(values, self.triangles[t]),
            Normals::Corner { corners, values } => mix(values, corners[t]),
        };
        interpolated
            .try_normalize()
            .unwrap_or_else(|| self.plane_normal(t))
    }

    /// Authored or computed normals at the corners of triangle `t`; `None` if it is shaded flat.
    pub fn corner_normals(&self, t: usize) -> Option<[Vec3; 3]> {
        match &self.normals {
            Normals::Flat => None,
            Normals::Vertex(values) => Some(self.triangles[t].map(|i| values[i as usize])),
            Normals::Corner { corners, values } => Some(corners[t].map(|i| values[i as usize])),
        }
    }

    /// Unit plane normal of triangle `t`, or zero if it has no area.
    pub fn plane_normal(&self, t: usize) -> Vec3 {
        let [a, b, c] = self.corners(t).map(|p| p.as_dvec3());
        (b - a).cross(c - a).normalize_or_zero().as_vec3()
    }
}
