//! Point-based global illumination for USD stages, after P. Christensen, *Point-Based Global Illumination for
//! Movie Production* (2010), cited as "PBGI §n".
//!
//! The crate is one pipeline, and the modules below stand in its order:
//!
//! ```text
//!           stage            bake                octree
//! USD stage ────▶ Scene ───────────▶ SurfelCloud ─────▶ Octree ──┐ gather            writers
//!                   │    receivers                               ├──────▶ Results ──────────▶ EXR, primvars
//!                   └──────────────▶ Receivers ──────────────────┘
//! ```
//!
//! Everything after [`stage`] is in world space, stage units, relative to [`scene::Scene::origin`]; light is linear
//! with Rec.709 primaries.

// vocabulary: plain data
pub mod diagnostics;
pub mod math;
pub mod results;
pub mod scene;
pub mod surfels;

// tools: used by several steps
pub mod image;
pub mod lighting;
pub mod shading;
pub mod trace;

// steps, in the paper's order
pub mod bake;
pub mod bounce;
pub mod gather;
pub mod octree;
pub mod pilot;
pub mod receivers;
pub mod stage;
pub mod verify;
pub mod writers;

// the whole
pub mod cli;
pub mod pipeline;
