//! Surface shaders other than UsdPreviewSurface, reduced to base color, emission, metalness, roughness and opacity by
//! the names of their inputs: MaterialX `standard_surface`, `OpenPBR` and glTF, Arnold, RenderMan, MDL's `OmniPBR`.

use super::materials::{Kind, Reader};
use super::network::{shader_id, value};
use super::values::{narrow, number};
use crate::scene::{Input, Material};
use glam::Vec4;

/// Name of a color, of the input that weighs it (may be empty), and the weight where that is not authored.
type Weighted = (&'static str, &'static str, f32);

/// Base color, best first.
const BASE: [Weighted; 8] = [
    ("base_color", "base", 1.0),
    ("base_color", "base_weight", 1.0),
    ("baseColor", "", 1.0),
    ("diffuseColor", "diffuseGain", 1.0),
    ("diffuse_color", "", 1.0),
    ("diffuse_texture", "", 1.0),
    ("diffuse_color_constant", "", 1.0),
    ("color", "", 1.0),
];

/// Emission, best first. Weights default to those of the shaders: a glow color alone does not glow.
const EMISSION: [Weighted; 7] = [
    ("emission_color", "emission", 0.0),
    ("emission_color", "emission_luminance", 0.0),
    ("emissive", "emissive_strength", 1.0),
    ("emissiveColor", "", 1.0),
    ("emitColor", "", 1.0),
    ("glowColor", "glowGain", 0.0),
    ("emissive_color", "emissive_intensity", 40.0),
];

const METALLIC: [&str; 4] = [
    "metalness",
    "base_metalness",
    "metallic",
    "metallic_constant",
];

const ROUGHNESS: [&str; 4] = [
    "specular_roughness",
    "roughness",
    "specularRoughness",
    "reflection_roughness_constant",
];

const OPACITY: [&str; 4] = ["opacity", "geometry_opacity", "alpha", "opacity_constant"];

/// Surface shader `prim` reduced, with one warning that says so; `None` if it has no input with a known name.
pub(super) fn surface(reader: &Reader<'_>, prim: usize) -> Option<Material> {
    let scalar = |names: &[&str]| {
        let mut names = names.iter();
        names.find_map(|name| reader.authored_input(prim, name, Kind::Scalar))
    };
    let base = weighted(reader, prim, &BASE);
    let emission = weighted(reader, prim, &EMISSION).filter(|_| emission_is_enabled(reader, prim));
    let others = [scalar(&METALLIC), scalar(&ROUGHNESS), scalar(&OPACITY)];
    let id = shader_id(reader.paths.prim(prim));
    let defaults = defaults(id);
    let nothing_known = base.is_none() && emission.is_none() && others.iter().all(Option::is_none);
    if nothing_known && defaults.is_none() {
        return None;
    }
    reader.diagnostics.warn(
        "reduced-material",
        reader.material,
        format!("surface shader `{id}` is reduced to base color, emission, metalness, roughness and opacity: other effects are left out"),
    );
    let default = defaults.unwrap_or_default();
    let [metallic, roughness, opacity] = others;
    Some(Material {
        diffuse_color: base.unwrap_or(default.diffuse_color.clone()),
        emissive_color: emission.unwrap_or(default.emissive_color.clone()),
        metallic: metallic.unwrap_or(default.metallic.clone()),
        roughness: roughness.unwrap_or(default.roughness.clone()),
        opacity: opacity.unwrap_or(default.opacity.clone()),
        ..default
    })
}

/// What shader `id` shows where nothing is authored, as MaterialX's node definitions 1.39 have it; `None` for others.
fn defaults(id: &str) -> Option<Material> {
    let (gray, metallic, roughness) = match id {
        _ if id.contains("standard_surface") => (0.8, 0.0, 0.2),
        _ if id.contains("open_pbr_surface") => (0.8, 0.0, 0.3),
        _ if id.contains("gltf_pbr") => (1.0, 1.0, 1.0),
        _ => return None,
    };
    Some(Material {
        diffuse_color: Input::color(gray, gray, gray),
        metallic: Input::scalar(metallic),
        roughness: Input::scalar(roughness),
        ..Material::default()
    })
}

/// The first color of `names` that is given, times its weight.
fn weighted(reader: &Reader<'_>, prim: usize, names: &[Weighted]) -> Option<Input> {
    let given = |name: &'static str| {
        let input = reader.authored_input(prim, name, Kind::Color)?;
        Some((name, input))
    };
    let (color, input) = names.iter().find_map(|(color, ..)| given(color))?;
    let of_color = || names.iter().filter(|(name, ..)| *name == color);
    let authored = |&(_, weight, _): &Weighted| value(reader.paths, prim, weight).and_then(number);
    let default = of_color().map(|(.., default)| *default).next();
    let weight = of_color().find_map(authored).map(narrow).or(default);
    Some(scaled(input, weight.unwrap_or(1.0)))
}

/// `input · weight`; a primvar cannot be scaled and stays as it is.
fn scaled(input: Input, weight: f32) -> Input {
    let weight = if weight.is_finite() {
        weight.max(0.0)
    } else {
        1.0
    };
    multiplied(input, Vec4::new(weight, weight, weight, 1.0))
}

/// `input · weight`, component by component; the fallback only of a primvar.
pub(super) fn multiplied(input: Input, weight: Vec4) -> Input {
    match input {
        Input::Constant(value) => Input::Constant(value * weight),
        Input::Texture(mut read) => {
            read.scale *= weight;
            read.bias *= weight;
            Input::Texture(read)
        }
        Input::Primvar { name, fallback } => Input::Primvar {
            name,
            fallback: fallback * weight,
        },
    }
}

/// MDL's `OmniPBR` emits only when told to; everything else emits what its color says.
fn emission_is_enabled(reader: &Reader<'_>, prim: usize) -> bool {
    let switch = value(reader.paths, prim, "enable_emission").and_then(number);
    let off_by_default = shader_id(reader.paths.prim(prim)).starts_with("Omni");
    switch.map_or(!off_by_default, |switch| switch != 0.0)
}
