//! Cameras.

use glam::DAffine3;

/// How a camera projects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Projection {
    /// Pinhole.
    #[default]
    Perspective,
    /// Parallel.
    Orthographic,
}

/// A `UsdGeomCamera`, looking along its −Z, +Y up.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Stage path; empty for the automatic framing camera.
    pub path: String,
    /// To world space (absolute, stage units; *not* relative to the scene's origin).
    pub world_from_camera: DAffine3,
    /// Projection.
    pub projection: Projection,
    /// Tenths of a stage unit, as in USD.
    pub horizontal_aperture: f64,
    /// Tenths of a stage unit.
    pub vertical_aperture: f64,
    /// Tenths of a stage unit.
    pub horizontal_aperture_offset: f64,
    /// Tenths of a stage unit.
    pub vertical_aperture_offset: f64,
    /// Tenths of a stage unit.
    pub focal_length: f64,
    /// Near and far, stage units.
    pub clipping_range: (f64, f64),
    /// `exposure`, stops (kept for reporting; not applied).
    pub exposure: f64,
}
