//! UsdLux lights.

use super::PrimId;
use glam::{Affine3A, Vec3};
use std::path::PathBuf;
use std::sync::Arc;

/// The prims that a light has to do with.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Linked {
    /// All of them.
    #[default]
    All,
    /// Those with `true`, by [`PrimId`].
    Only(Arc<[bool]>),
}

impl Linked {
    /// True if `prim` is one of them.
    pub fn contains(&self, prim: PrimId) -> bool {
        match self {
            Self::All => true,
            Self::Only(prims) => prims.get(prim.index()).copied().unwrap_or(false),
        }
    }
}

/// The prims that a light lights, and those that block it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LightLinks {
    /// Its `lightLink` collection.
    pub lit: Linked,
    /// Its `shadowLink` collection.
    pub blockers: Linked,
}

/// `ShapingAPI`: a cone about the light's −Z axis, and a focus falloff.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaping {
    /// `shaping:cone:angle`, radians from the axis; π or more = no cone.
    pub cone_angle: f32,
    /// `shaping:cone:softness`, 0 hard … 1 soft over the whole cone.
    pub cone_softness: f32,
    /// `shaping:focus` exponent on the cosine to the axis, 0 = none.
    pub focus: f32,
    /// `shaping:focusTint`, linear.
    pub focus_tint: Vec3,
}

/// Shape of a light in its own space; emission is towards −Z for rect, disk and distant lights.
#[derive(Debug, Clone, PartialEq)]
pub enum LightKind {
    /// Parallel light from a disk in the sky of `angle` radians across; 0 = perfectly sharp.
    Distant {
        /// Angular diameter, radians.
        angle: f32,
    },
    /// A sphere; `treat_as_point` = no shape, sharp shadows.
    Sphere {
        /// Radius, light space.
        radius: f32,
        /// `treatAsPoint`.
        treat_as_point: bool,
    },
    /// A rectangle in the XY plane, one-sided, radiance from a texture if one is given.
    Rect {
        /// Size along X, light space.
        width: f32,
        /// Size along Y, light space.
        height: f32,
        /// `inputs:texture:file`, resolved.
        texture: Option<PathBuf>,
    },
    /// A disk in the XY plane, one-sided.
    Disk {
        /// Radius, light space.
        radius: f32,
    },
    /// A tube along X, without caps.
    Cylinder {
        /// Radius, light space.
        radius: f32,
        /// Length along X, light space.
        length: f32,
    },
    /// The sky. Latlong images: USD's orientation (see `lighting`).
    Dome {
        /// `inputs:texture:file`, resolved; `None` = uniform.
        texture: Option<PathBuf>,
    },
    /// Particles that glow: in world space relative to the scene's origin, whatever the light's transform.
    Particles(Arc<ParticleSet>),
}

/// Glowing particles, columns of equal length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ParticleSet {
    /// Centers.
    pub position: Vec<Vec3>,
    /// Above 0.
    pub radius: Vec<f32>,
    /// Unit, of disks that shine to this side; empty: spheres.
    pub normal: Vec<Vec3>,
    /// Linear Rec.709, 0 or more.
    pub radiance: Vec<Vec3>,
}

/// A light. Intensity inputs are already multiplied out.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Stage path.
    pub path: String,
    /// Shape.
    pub kind: LightKind,
    /// `intensity · 2^exposure · color · (color of temperature) · diffuse`, linear Rec.709, *before* `normalize`.
    /// Radiance of area and dome lights; radiance of the sun's disk for distant lights.
    pub radiance: Vec3,
    /// `normalize`: power does not depend on size (divide by the world-space area, or by the angular measure of a
    /// distant light).
    pub normalize: bool,
    /// To world space relative to the scene's origin (directions only for distant and dome lights).
    pub world_from_light: Affine3A,
    /// Cone and focus, if applied.
    pub shaping: Option<Shaping>,
    /// `shadow:enable`, default true.
    pub casts_shadows: bool,
    /// Prims it lights: its `lightLink` collection.
    pub lit: Linked,
    /// Prims that block it: its `shadowLink` collection.
    pub blockers: Linked,
}
