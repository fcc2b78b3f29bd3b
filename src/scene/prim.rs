//! One visible occurrence of a mesh on the stage.

use super::{MaterialId, MeshId};
use glam::Affine3A;
use std::sync::Arc;

/// Index into [`super::Scene::prims`]; also the `primId` AOV.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PrimId(pub u32);

impl PrimId {
    /// Of points that lie on no prim.
    pub const NONE: Self = Self(u32::MAX);

    /// As an index.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// USD `purpose`, inherited.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Purpose {
    /// `default`.
    #[default]
    Default,
    /// `render`.
    Render,
    /// `proxy`.
    Proxy,
    /// `guide`.
    Guide,
}

impl Purpose {
    /// From the USD token; `None` for any other word.
    pub fn from_token(token: &str) -> Option<Self> {
        match token {
            "default" => Some(Self::Default),
            "render" => Some(Self::Render),
            "proxy" => Some(Self::Proxy),
            "guide" => Some(Self::Guide),
            _ => None,
        }
    }
}

/// Materials of a prim's faces. `None` = unbound: `displayColor` or a neutral gray is used.
#[derive(Debug, Clone, PartialEq)]
pub enum FaceMaterials {
    /// The same everywhere.
    Whole(Option<MaterialId>),
    /// One a source face (index by `Mesh::triangle_faces`).
    PerFace(Arc<[Option<MaterialId>]>),
}

impl FaceMaterials {
    /// Material of source face `face`.
    pub fn of_face(&self, face: u32) -> Option<MaterialId> {
        match self {
            Self::Whole(material) => *material,
            Self::PerFace(materials) => materials.get(face as usize).copied().flatten(),
        }
    }
}

/// Where on the stage the prim comes from: decides how a bake can be written back to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PrimSource {
    /// An ordinary prim: opinions can be written at its path.
    Direct,
    /// Below native instances: opinions at the path take effect only when all of them are made uninstanceable.
    NativeInstance {
        /// The instances above, outermost first, at least one.
        instances: Arc<[EnclosingInstance]>,
        /// Path of the same prim inside the first instance that uses this prototype (all instances share it).
        shared_path: Arc<str>,
    },
    /// Drawn by a `PointInstancer`: opinions can only go to the prototype, shared by all its points.
    PointInstance {
        /// Path of the instancer.
        instancer: Arc<str>,
        /// Index of the instance (point) in it.
        index: u32,
        /// Path of the mesh below the prototype.
        shared_path: Arc<str>,
    },
}

/// A native instance above a prim. Prims of many instances share one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EnclosingInstance {
    /// Length of its stage path, bytes: the path itself is the start of the prim's.
    pub path_length: usize,
    /// Path of the first instance that uses the same prototype; its own if it is the first.
    pub first: Arc<str>,
}

impl EnclosingInstance {
    /// Its stage path, from that of a prim below it.
    ///
    /// # Panics
    /// When no instance like this encloses the prim at `path`.
    pub fn path_above<'a>(&self, path: &'a str) -> &'a str {
        path.get(..self.path_length)
            .expect("the path of a prim starts with that of an instance above it")
    }
}

/// One visible occurrence of a mesh.
#[derive(Debug, Clone)]
pub struct Prim {
    /// Stage path; for point instances `INSTANCER[index]/…` (not a valid USD path, for people).
    pub path: Arc<str>,
    /// Geometry.
    pub mesh: MeshId,
    /// To world space relative to `Scene::origin`; may mirror, shear and scale unevenly.
    pub world_from_object: Affine3A,
    /// Bound materials.
    pub materials: FaceMaterials,
    /// Inherited purpose.
    pub purpose: Purpose,
    /// Where it comes from.
    pub source: PrimSource,
}
