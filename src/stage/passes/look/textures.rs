//! Texture nodes: UsdUVTexture with its coordinates (UsdTransform2d, `UsdPrimvarReader_float2`), and the image nodes of
//! other shader libraries as far as their file and coordinates can be recognised.
//!
//! Fallbacks are those of the UsdPreviewSurface specification, except that texture coordinates that are neither
//! connected nor authored come from primvar `st`: the specification's (0, 0) would show a single texel.

use super::network::{Source, shader_id, source, value};
use super::paths::Paths;
use super::values::{asset, color, narrow, number, token};
use crate::scene::material::UvSource;
use crate::scene::{ColorSpace, TextureRead, Wrap};
use glam::{Affine2, Vec2, Vec4};

/// Primvar of texture coordinates by convention.
const DEFAULT_UV: &str = "st";

/// Deepest chain of UsdTransform2d nodes followed.
const MAX_TRANSFORMS: usize = 16;

/// Names of the file input of image nodes, UsdUVTexture's first.
const FILE_INPUTS: [&str; 4] = ["file", "filename", "fileTextureName", "texture"];

/// The texture that `node` reads through its output `output`; `None` if the node has no file.
pub(super) fn texture_read(paths: &Paths<'_>, node: usize, output: &str) -> Option<TextureRead> {
    let get = |input: &str| value(paths, node, input);
    let (file_input, file) = FILE_INPUTS
        .iter()
        .find_map(|&input| Some((input, asset(get(input)?)?)))?;
    let vec4 = |input: &str, default: Vec4| match get(input).and_then(color) {
        Some(v) if v.is_finite() => v,
        _ => default,
    };
    Some(TextureRead {
        file,
        shader: paths.prim(node).path.clone(),
        uv: uv_source(paths, node),
        wrap_s: wrap(paths, node, ["wrapS", "uaddressmode", "swrap"]),
        wrap_t: wrap(paths, node, ["wrapT", "vaddressmode", "twrap"]),
        scale: vec4("scale", Vec4::ONE),
        bias: vec4("bias", Vec4::ZERO),
        fallback: vec4("fallback", Vec4::W),
        color_space: color_space(paths, node, file_input),
        channel: match output {
            "r" => Some(0),
            "g" => Some(1),
            "b" => Some(2),
            "a" => Some(3),
            _ => None,
        },
    })
}

fn is_usd_texture(paths: &Paths<'_>, node: usize) -> bool {
    shader_id(paths.prim(node)).contains("UsdUVTexture")
}

/// Wrap mode; nodes other than UsdUVTexture tile by default.
fn wrap(paths: &Paths<'_>, node: usize, inputs: [&str; 3]) -> Wrap {
    let authored = inputs
        .iter()
        .find_map(|input| value(paths, node, input).and_then(token));
    match authored {
        Some("repeat" | "periodic") => Wrap::Repeat,
        Some("clamp") => Wrap::Clamp,
        Some("mirror") => Wrap::Mirror,
        Some("black" | "constant" | "useMetadata") => Wrap::Black,
        _ if is_usd_texture(paths, node) => Wrap::Black,
        _ => Wrap::Repeat,
    }
}

/// `sourceColorSpace`, else the `colorSpace` metadata of the file, else automatic.
fn color_space(paths: &Paths<'_>, node: usize, file_input: &str) -> ColorSpace {
    let authored = value(paths, node, "sourceColorSpace").and_then(token);
    let metadata = match source(paths, node, &format!("inputs:{file_input}")) {
        Source::Value(_, space) => space,
        _ => None,
    };
    match authored.or(metadata) {
        Some("raw" | "Raw" | "lin_rec709" | "lin_srgb" | "linear" | "Linear" | "data") => {
            ColorSpace::Raw
        }
        Some("sRGB" | "srgb" | "srgb_texture" | "srgb_rec709_scene" | "g22_rec709") => {
            ColorSpace::SRgb
        }
        _ => ColorSpace::Auto,
    }
}

/// Where the coordinates of a texture node come from.
fn uv_source(paths: &Paths<'_>, node: usize) -> UvSource {
    let connected = |name: &str| !matches!(source(paths, node, name), Source::Nothing);
    let inputs = [
        "inputs:st",
        "inputs:texcoord",
        "inputs:uv",
        "inputs:uvCoord",
    ];
    let mut at = inputs
        .into_iter()
        .find(|name| connected(name))
        .map(|name| (node, name));
    let mut uv = UvSource {
        primvar: DEFAULT_UV.to_owned(),
        fallback: Vec2::ZERO,
        transform: Affine2::IDENTITY,
    };
    if shader_id(paths.prim(node)).contains("tiledimage") {
        uv.transform = tiling(paths, node);
    }
    for _ in 0..MAX_TRANSFORMS {
        let Some((prim, input)) = at.take() else {
            break;
        };
        match source(paths, prim, input) {
            Source::Value(value, _) => {
                uv.primvar.clear();
                uv.fallback = color(value).map_or(Vec2::ZERO, |v| v.truncate().truncate());
            }
            Source::Node { prim, .. } if shader_id(paths.prim(prim)).contains("UsdTransform2d") => {
                uv.transform *= transform_2d(paths, prim);
                at = Some((prim, "inputs:in"));
            }
            Source::Node { prim, .. } if shader_id(paths.prim(prim)).contains("place2d") => {
                uv.transform *= place_2d(paths, prim);
                at = Some((prim, "inputs:texcoord"));
            }
            Source::Node { prim, .. } => {
                if let Some((name, fallback)) = primvar_read(paths, prim) {
                    uv.primvar = name;
                    uv.fallback = fallback.truncate().truncate();
                }
            }
            Source::Nothing => {}
        }
    }
    if !uv.fallback.is_finite() {
        uv.fallback = Vec2::ZERO;
    }
    uv
}

/// UsdTransform2d: `in` scaled, then rotated (degrees, counter-clockwise), then translated. Identity where not finite.
fn transform_2d(paths: &Paths<'_>, node: usize) -> Affine2 {
    let degrees = value(paths, node, "rotation")
        .and_then(number)
        .unwrap_or(0.0);
    let transform = Affine2::from_scale_angle_translation(
        vec2(paths, node, "scale", Vec2::ONE),
        narrow(degrees.to_radians()),
        vec2(paths, node, "translation", Vec2::ZERO),
    );
    if transform.is_finite() {
        transform
    } else {
        Affine2::IDENTITY
    }
}

/// MaterialX `place2d` in its default order: about `pivot`, `texcoord` divided by scale, turned back by `rotate`
/// degrees, less `offset`. Identity where not finite.
fn place_2d(paths: &Paths<'_>, node: usize) -> Affine2 {
    let pivot = vec2(paths, node, "pivot", Vec2::ZERO);
    let degrees = value(paths, node, "rotate").and_then(number).unwrap_or(0.0);
    let placed = Affine2::from_translation(pivot - vec2(paths, node, "offset", Vec2::ZERO))
        * Affine2::from_angle(-narrow(degrees.to_radians()))
        * Affine2::from_scale(vec2(paths, node, "scale", Vec2::ONE).recip())
        * Affine2::from_translation(-pivot);
    if placed.is_finite() {
        placed
    } else {
        Affine2::IDENTITY
    }
}

/// `texcoord · uvtiling − uvoffset` of a MaterialX `tiledimage`.
fn tiling(paths: &Paths<'_>, node: usize) -> Affine2 {
    let offset = vec2(paths, node, "uvoffset", Vec2::ZERO);
    let scale = vec2(paths, node, "uvtiling", Vec2::ONE);
    let tiled = Affine2::from_scale_angle_translation(scale, 0.0, -offset);
    if tiled.is_finite() {
        tiled
    } else {
        Affine2::IDENTITY
    }
}

fn vec2(paths: &Paths<'_>, node: usize, input: &str, default: Vec2) -> Vec2 {
    let authored = value(paths, node, input).and_then(color);
    authored.map_or(default, |v| v.truncate().truncate())
}

/// Primvar name and fallback of a `UsdPrimvarReader` (or a MaterialX `geompropvalue`); `None` for any other node.
pub(super) fn primvar_read(paths: &Paths<'_>, node: usize) -> Option<(String, Vec4)> {
    let id = shader_id(paths.prim(node));
    let (name_input, fallback_input) = if id.contains("UsdPrimvarReader") {
        ("varname", "fallback")
    } else if id.contains("geompropvalue") {
        ("geomprop", "default")
    } else {
        return None;
    };
    let name = value(paths, node, name_input).and_then(token).unwrap_or("");
    let fallback = value(paths, node, fallback_input).and_then(color);
    Some((
        name.strip_prefix("primvars:").unwrap_or(name).to_owned(),
        fallback.filter(|v| v.is_finite()).unwrap_or(Vec4::W),
    ))
}
