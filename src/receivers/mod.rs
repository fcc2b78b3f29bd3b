//! Scene → [`Receivers`]: where light is to be computed. Pixels of a camera, points of meshes, surfels.

pub mod camera;
pub mod lens;
pub mod primvar;
pub mod surfel;
mod world;

use crate::results::Target;
use crate::shading::SurfacePoint;
use glam::{DVec3, Vec3};

/// Points to gather at, as columns of equal length.
#[derive(Debug, Clone, PartialEq)]
pub struct Receivers {
    /// World position that `position` is relative to.
    pub origin: DVec3,
    /// Positions on surfaces.
    pub position: Vec<Vec3>,
    /// Unit shading normals, on the side that is lit.
    pub normal: Vec<Vec3>,
    /// Unit plane normals, same side.
    pub geometric_normal: Vec<Vec3>,
    /// Index of the prim.
    pub prim: Vec<u32>,
    /// The same point in surface terms, for materials (for vertices: on one of the faces around it).
    pub surface: Vec<SurfacePoint>,
    /// Distance along the viewing axis, stage units; empty unless placed by a camera.
    pub depth: Vec<f32>,
    /// Where the values go.
    pub target: Target,
}

impl Receivers {
    /// Number of receivers.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// True without receivers.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }
}
