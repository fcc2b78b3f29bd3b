//! The image files of a scene and their sizes, by their headers.

use crate::diagnostics::Diagnostics;
use crate::image;
use crate::pipeline::world::Needs;
use crate::scene::{Input, LightKind, Scene};
use crate::shading::may_be_screen;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Inputs that tell how much light surfaces let through; those of opaque ones are not decoded.
const OPACITY: [&str; 2] = ["opacity", "opacityThreshold"];

/// Others that surflux evaluates where there is light; images of yet others are told of but not decoded.
const DIFFUSE: [&str; 3] = ["diffuseColor", "emissiveColor", "metallic"];

/// One image file or set of tiles.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TextureSummary {
    /// The file; `<UDIM>` where it is a set.
    pub file: PathBuf,
    /// Pixels across (of the first tile); `None` if it cannot be read.
    pub width: Option<usize>,
    /// Pixels down.
    pub height: Option<usize>,
    /// Tiles of a set that exist; 1 otherwise.
    pub tiles: usize,
    /// Bytes of all files.
    pub bytes: Option<u64>,
    /// Paths of the materials and lights that use it.
    pub used_by: Vec<String>,
    /// True if a run decodes it: some material input that matters reads it, or a light.
    pub is_decoded: bool,
    /// Why it cannot be read.
    pub problem: Option<String>,
}

/// All images, in the order of their names, and which of them a job with these `needs` decodes.
pub(super) fn of(scene: &Scene, needs: Needs) -> Vec<TextureSummary> {
    let mut users: BTreeMap<PathBuf, (Vec<String>, bool)> = BTreeMap::new();
    let mut add = |file: &Path, user: &str, decoded: bool| {
        let (paths, is_decoded) = users.entry(file.to_owned()).or_default();
        if paths.last().is_none_or(|last| last != user) {
            paths.push(user.to_owned());
        }
        *is_decoded |= decoded;
    };
    for material in &scene.materials {
        let is_decoded = |name: &str| {
            (name == "displacement" && material.displaces())
                || (OPACITY.contains(&name) && may_be_screen(material))
                || (DIFFUSE.contains(&name) && needs.materials)
        };
        for (name, input) in material.inputs() {
            if let Input::Texture(read) = input {
                add(&read.file, &material.path, is_decoded(name));
            }
        }
    }
    for light in &scene.lights {
        if let LightKind::Rect { texture, .. } | LightKind::Dome { texture } = &light.kind
            && let Some(file) = texture
        {
            add(file, &light.path, true);
        }
    }
    let users: Vec<_> = users.into_iter().collect();
    let summary = |(file, (used_by, is_decoded))| measured(file, used_by, is_decoded);
    users.into_par_iter().map(summary).collect()
}

fn measured(file: PathBuf, used_by: Vec<String>, is_decoded: bool) -> TextureSummary {
    let tiles = image::tiles(&file);
    let probes: Result<Vec<image::Probe>, image::Error> =
        tiles.iter().map(|tile| image::probe(tile)).collect();
    let mut summary = TextureSummary {
        file,
        width: None,
        height: None,
        tiles: tiles.len(),
        bytes: None,
        used_by,
        is_decoded,
        problem: None,
    };
    match probes {
        Ok(probes) if probes.is_empty() => {
            summary.problem = Some("no tile of it exists".to_owned());
        }
        Ok(probes) => {
            summary.width = probes.first().map(|probe| probe.width);
            summary.height = probes.first().map(|probe| probe.height);
            summary.bytes = Some(probes.iter().map(|probe| probe.bytes).sum());
        }
        Err(error) => summary.problem = Some(error.to_string()),
    }
    summary
}

/// A file that cannot be read is a warning for each that uses it.
pub(super) fn warn_of_missing(textures: &[TextureSummary], diagnostics: &Diagnostics) {
    for texture in textures {
        let Some(problem) = &texture.problem else {
            continue;
        };
        for user in &texture.used_by {
            let message = format!("{problem}: its fallback or plain color is used");
            diagnostics.warn("missing-texture", user, message);
        }
    }
}
