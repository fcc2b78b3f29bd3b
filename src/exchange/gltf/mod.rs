//! glTF 2.0 (`.gltf`, `.glb`) → a USD asset: +Y up, meters.
//!
//! ```text
//! /root                 Xform (SkelRoot where anything is deformed), the default scene
//!   /NODE               Xform: translate, orient, scale, with time samples where animated
//!     /MESH             Mesh (Points where the mode is POINTS); of several primitives /MESH_0, /MESH_1 …
//!     /Camera, /Light, /Instances
//!   /Looks/MATERIAL     UsdPreviewSurface
//!   /Skeletons/SKIN     Skeleton, with /Animation
//! /_meshes/MESH         classes: meshes that several nodes show, which instance them
//! ```
//!
//! | glTF | USD |
//! |---|---|
//! | triangles, strips, fans, points | `Mesh` without subdivision; `Points` with `_RADIUS` as half of `widths` |
//! | lines, strips, loops | `BasisCurves`, a thousandth of their size wide: lines have no width in glTF |
//! | `TEXCOORD_n` | `primvars:st`, `st1` …, v turned over |
//! | `COLOR_0` | `primvars:COLOR_0` as it is; times the base color `primvars:displayColor`, which the material reads where it has no texture |
//! | textures | `UsdUVTexture`: metallic from blue, roughness from green, occlusion from red; files beside the result where they were packed |
//! | `KHR_texture_transform` | `UsdTransform2d`, in USD's upright texture space |
//! | emissive strength, ior, clearcoat, unlit | `emissiveColor`, `ior`, `clearcoat`, black with emission |
//! | `EXT_mesh_gpu_instancing` | `PointInstancer` |
//! | point and spot lights, I candela | `SphereLight`, normalized, intensity 4 I: it sends a quarter of its intensity (in radiance·area units) along an axis |
//! | directional lights, E lux | `DistantLight`, normalized, intensity E |
//! | animation of nodes | time samples at the keys, 24 a second; cubic splines at every frame |
//! | skins | `Skeleton` and `SkelAnimation`; their nodes are prims too, for what hangs on them |
//! | morph targets | `BlendShape`s of the points that they move, their weights in the animation |
//!
//! What is lost is a warning.

mod accessor;
mod check;
mod document;
mod images;
mod lines;
mod materials;
mod meshes;
mod motion;
mod nodes;
mod skins;

use super::{Error, malformed};
use crate::diagnostics::Diagnostics;
use crate::scene::{StageInfo, UpAxis};
use crate::writers::usd::Provenance;
use crate::writers::usd::author::Author;
use document::Document;
use std::path::{Path, PathBuf};

/// Time codes a second.
const RATE: f64 = 24.0;

/// What became of a file.
#[derive(Debug, Clone, Default)]
pub struct Converted {
    /// Every file written, the USD file first.
    pub outputs: Vec<PathBuf>,
    /// Meshes and points drawn, instances counted each.
    pub prims: usize,
    /// Triangles, those of shared meshes once.
    pub triangles: usize,
}

/// Convert the file `from` to the USD file `to`; images that are packed in it are written to `NAME_textures` beside that.
///
/// # Errors
/// Files that are no glTF, lack buffers, point outside of them, or need extensions that are not known here; files that cannot
/// be written. Nothing of the USD file is written then.
pub fn to_usd(
    (from, to): (&Path, &Path),
    provenance: &Provenance,
    diagnostics: &Diagnostics,
) -> Result<Converted, Error> {
    let malformed = malformed(from);
    let document = Document::open(from, diagnostics)?;
    let motion = motion::Motion::read(&document, diagnostics).map_err(&malformed)?;
    let stage = StageInfo {
        path: from.to_owned(),
        up_axis: UpAxis::Y,
        meters_per_unit: 1.0,
        default_prim: Some("root".to_owned()),
        time_range: motion.range(),
        time_codes_per_second: RATE,
        time: None,
        layers: Vec::new(),
        variants: Vec::new(),
        reader: String::new(),
    };
    let mut author = Author::new(&stage, provenance, "root");
    let is_deformed = skins::any(&document.gltf);
    author.define("/root", if is_deformed { "SkelRoot" } else { "Xform" })?;
    let mut job = nodes::Job {
        document: &document,
        author: &mut author,
        diagnostics,
        looks: materials::Looks::default(),
        motion,
        rigs: skins::Rigs::default(),
        converted: Converted::default(),
    };
    job.scene()?;
    let nodes::Job {
        looks,
        mut converted,
        ..
    } = job;
    let images = images::write(&document, (to, looks), &mut author, diagnostics)?;
    author.save(to)?;
    converted.outputs = vec![to.to_owned()];
    converted.outputs.extend(images);
    Ok(converted)
}
