//! What is wrong with a file before anything of it is used, and what the crate would miss in one that is right.

use crate::diagnostics::Diagnostics;
use gltf::json;
use json::validation::{Checked, Error as Flaw, Validate};
use json::{Camera, Root, camera};
use serde_json::{Map, Value};
use std::path::Path;

/// Extensions that may be required: what they mean is done here, or is told as lost.
const KNOWN: [&str; 9] = [
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Ways of packing that nothing can be read without.
const PACKED: [&str; 3] = [
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_texture_basisu",
];

pub(super) const OLD: &str = "it is glTF 1.0, which is not read: export it as glTF 2.0";

/// Refuse what is older than glTF 2.0.
pub(super) fn version(root: &Value) -> Result<(), String> {
    let version = root.get("asset").and_then(|asset| asset.get("version"));
    // glTF 1.0 has objects with names where glTF 2.0 has lists, and need not tell its version
    let is_old = match version.and_then(Value::as_str) {
        Some(version) => version.starts_with("1."),
        None => root.get("nodes").is_some_and(Value::is_object),
    };
    if is_old { Err(OLD.to_owned()) } else { Ok(()) }
}

/// Add what may be left out, but not for the crate: the nodes of a scene, and what kind of image a view holds, which its bytes
/// tell.
pub(super) fn complete(root: &mut Value) {
    add(root, ("scenes", |_| true), ("nodes", Value::Array(vec![])));
    let is_packed: Lacks = |image| image.contains_key("bufferView");
    add(root, ("images", is_packed), ("mimeType", Value::from("")));
}

/// True of objects that should have something.
type Lacks = fn(&Map<String, Value>) -> bool;

/// Give all objects of the list `list` that `lacks` holds for the value `key`, if they have none.
fn add(root: &mut Value, (list, lacks): (&str, Lacks), (key, value): (&str, Value)) {
    let list = root.get_mut(list).and_then(Value::as_array_mut);
    let objects = list.into_iter().flatten().filter_map(Value::as_object_mut);
    for object in objects.filter(|object| lacks(object)) {
        object.entry(key).or_insert_with(|| value.clone());
    }
}

/// Refuse what breaks the specification; but the bounds of positions, which many exporters leave out, are not needed.
pub(super) fn valid(root: &Root) -> Result<(), String> {
    let mut flaws = Vec::new();
    let mut add = |path: &dyn Fn() -> json::Path, flaw: Flaw| {
        let path = path();
        let is_bound = [".min", ".max"]
            .iter()
            .any(|end| path.as_str().ends_with(end));
        if !(is_bound && flaw == Flaw::Missing) {
            flaws.push(format!("{path}: {flaw}"));
        }
    };
    root.validate(root, json::Path::new, &mut add);
    flaws.extend(unchecked(root));
    match flaws.len() {
        0 => Ok(()),
        count => {
            flaws.truncate(MOST_FLAWS);
            let more = if count > MOST_FLAWS { " …" } else { "" };
            Err(format!(
                "it is no valid glTF 2.0: {}{more}",
                flaws.join("; ")
            ))
        }
    }
}

/// What the crate relies on and does not look at.
fn unchecked(root: &Root) -> impl Iterator<Item = String> {
    let lacks_lens = |camera: &Camera| match camera.type_ {
        Checked::Valid(camera::Type::Perspective) => camera.perspective.is_none(),
        Checked::Valid(camera::Type::Orthographic) => camera.orthographic.is_none(),
        Checked::Invalid => false,
    };
    let cameras = (root.cameras.iter().enumerate())
        .filter(move |(_, camera)| lacks_lens(camera))
        .map(|(i, _)| format!("cameras[{i}]: it has no lens of its type"));
    let images = (root.images.iter().enumerate())
        .filter(|(_, image)| image.uri.is_none() && image.buffer_view.is_none())
        .map(|(i, _)| format!("images[{i}]: it has neither uri nor bufferView"));
    cameras.chain(images)
}

/// Flaws that a message names.
const MOST_FLAWS: usize = 4;

/// Refuse what cannot be read; take known extensions out of the list, which the crate knows fewer of.
pub(super) fn required(
    root: &mut Value,
    path: &Path,
    diagnostics: &Diagnostics,
) -> Result<(), String> {
    let Some(Value::Array(required)) = root.get_mut("extensionsRequired") else {
        return Ok(());
    };
    for name in required.iter().filter_map(Value::as_str) {
        if PACKED.contains(&name) {
            return Err(format!(
                "it needs {name}, which is not unpacked here (export it without)"
            ));
        }
        if !KNOWN.contains(&name) {
            let message =
                format!("it requires {name}, which is not known here: what that holds is lost");
            diagnostics.warn("lost", path.to_string_lossy(), message);
        }
    }
    required.clear();
    Ok(())
}
