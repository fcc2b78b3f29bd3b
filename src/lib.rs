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
//! Surfaces that their materials displace are moved in the `Scene` ([`displacement`]) before anything else sees it.
//!
//! Occlusion at the points of every mesh of a stage, each step called by itself ([`pipeline`] strings them together):
//!
//! ```
//! use surflux::gather::{self, GatherScene, RaysEngine, RaysSettings};
//! use surflux::{diagnostics::Diagnostics, receivers::primvar, results::{Aov, BakeInterpolation}, scene::PrimId};
//! use surflux::{shading::Shader, stage, trace::Tracer};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let diagnostics = Diagnostics::default();
//! let mut source = stage::open("examples/room.usda".as_ref(), stage::Door::Native, &diagnostics)?;
//! let settings = stage::ReadSettings { materials: false, lights: false, ..Default::default() };
//! let scene = stage::read(source.as_mut(), &settings, &diagnostics)?;
//!
//! let (shader, tracer) = (Shader::new(&scene, &diagnostics), Tracer::new(&scene));
//! let prims: Vec<PrimId> = (0..).map(PrimId).take(scene.prims.len()).collect();
//! let receivers = primvar::place(&scene, &prims, BakeInterpolation::Vertex);
//! let engine = RaysEngine::new(&tracer, None, RaysSettings { rays: 64, ..Default::default() });
//! let world = GatherScene { shader: &shader, tracer: &tracer, lighting: None };
//! let results = gather::gather(world, &engine, &receivers, &[Aov::Occlusion], &diagnostics)?;
//!
//! let occlusion = &results.get(Aov::Occlusion).expect("it was asked for").data;
//! assert_eq!(occlusion.len(), receivers.len());
//! assert!(occlusion.iter().all(|covered| (0.0..=1.0).contains(covered)));
//! # Ok(())
//! # }
//! ```
//!
//! Everything after [`stage`] is in world space, stage units, relative to [`scene::Scene::origin`]; light is linear
//! with Rec.709 primaries.

// vocabulary: plain data
pub mod diagnostics;
mod files;
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
pub mod displacement;
pub mod exchange;
pub mod gather;
pub mod interpolate;
pub mod octree;
pub mod pilot;
pub mod receivers;
pub mod stage;
pub mod verify;
pub mod view;
pub mod writers;

// the whole
pub mod cli;
pub mod pipeline;
pub mod recipes;
