//! A stage at one time code, resolved: world space, stage units, no USD type inside.
//!
//! [`Mesh`]es hold geometry, shared between instances; a [`Prim`] is one visible occurrence of a mesh, with its
//! path, transform and materials. Positions are `f32` relative to [`Scene::origin`], so that a shot far from the
//! world's origin keeps its precision.

pub mod camera;
pub mod light;
mod light_group;
pub mod material;
pub mod mesh;
pub mod placed;
pub mod prim;
pub mod render_product;

pub use camera::Camera;
pub use light::{Light, LightKind, LightLinks, Linked, ParticleSet, Shaping};
pub use light_group::{GroupRule, LightGroup};
pub use material::{ColorSpace, Input, Material, MaterialId, TextureRead, Wrap};
pub use mesh::{Cage, Interpolation, Mesh, MeshId, Normals, Primvar};
pub use placed::{PlacedMesh, on_the_side_of};
pub use prim::{EnclosingInstance, FaceMaterials, Prim, PrimId, PrimSource, Purpose};
pub use render_product::{RenderProduct, RenderSettings, RenderVar};

use crate::math::Bounds3;
use glam::{DVec3, Vec3};

/// Which axis points up on the stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UpAxis {
    /// +Y, the default of USD.
    #[default]
    Y,
    /// +Z.
    Z,
}

impl UpAxis {
    /// The axis as a unit vector.
    pub fn direction(self) -> Vec3 {
        match self {
            Self::Y => Vec3::Y,
            Self::Z => Vec3::Z,
        }
    }
}

/// What the stage says of itself as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct StageInfo {
    /// The root layer's path as the user gave it.
    pub path: std::path::PathBuf,
    /// Up axis.
    pub up_axis: UpAxis,
    /// Length of one stage unit in meters (USD's default: 0.01).
    pub meters_per_unit: f64,
    /// `defaultPrim`, a name without slash, when authored.
    pub default_prim: Option<String>,
    /// Authored start and end time codes.
    pub time_range: Option<(f64, f64)>,
    /// Time codes per second (USD's default: 24).
    pub time_codes_per_second: f64,
    /// The time code this scene was read at; `None` = the default time.
    pub time: Option<f64>,
    /// Identifiers of all layers used.
    pub layers: Vec<String>,
    /// Variants that the user chose over the stage's own: prim path, set, variant.
    pub variants: Vec<[String; 3]>,
    /// `native` or `usd-core`.
    pub reader: String,
}

/// A stage at one time code. Topology is valid, bindings are resolved, all numbers are finite.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Metadata.
    pub stage: StageInfo,
    /// World position (stage units) that every `Vec3` position of this scene is relative to.
    pub origin: DVec3,
    /// Geometry, shared.
    pub meshes: Vec<Mesh>,
    /// Occurrences of meshes, indexed by [`PrimId`], in stage traversal order.
    pub prims: Vec<Prim>,
    /// Surface materials, indexed by [`MaterialId`].
    pub materials: Vec<Material>,
    /// Lights, in stage traversal order.
    pub lights: Vec<Light>,
    /// Cameras, in stage traversal order.
    pub cameras: Vec<Camera>,
    /// Render settings of the stage, flattened; the one named by `renderSettingsPrimPath` first.
    pub render_settings: Vec<RenderSettings>,
}

impl Scene {
    /// The mesh of a prim.
    pub fn mesh_of(&self, prim: &Prim) -> &Mesh {
        &self.meshes[prim.mesh.index()]
    }

    /// World bounds (relative to [`Self::origin`]) of all prims.
    pub fn bounds(&self) -> Bounds3 {
        self.prims
            .iter()
            .fold(Bounds3::EMPTY, |all, prim| all.union(self.bounds_of(prim)))
    }

    /// World bounds of one prim: exact when its transform is the identity, else around its transformed box.
    pub fn bounds_of(&self, prim: &Prim) -> Bounds3 {
        let local = self.mesh_of(prim).bounds();
        if local.is_empty() {
            return local;
        }
        Bounds3::around((0..8).map(|corner| {
            let pick =
                |bit: u32, low: f32, high: f32| if corner >> bit & 1 == 0 { low } else { high };
            prim.world_from_object.transform_point3(Vec3::new(
                pick(0, local.min.x, local.max.x),
                pick(1, local.min.y, local.max.y),
                pick(2, local.min.z, local.max.z),
            ))
        }))
    }

    /// Number of triangles over all prims (instances counted each).
    pub fn triangle_count(&self) -> usize {
        self.prims
            .iter()
            .map(|prim| self.mesh_of(prim).triangles.len())
            .sum()
    }
}
