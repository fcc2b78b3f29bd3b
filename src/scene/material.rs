//! Surface materials, reduced to what point-based light needs (UsdPreviewSurface).

use super::LightLinks;
use glam::{Affine2, Vec2, Vec4};
use std::path::PathBuf;

/// Index into [`super::Scene::materials`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MaterialId(pub u32);

impl MaterialId {
    /// As an index.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// `wrapS`, `wrapT` of UsdUVTexture. `useMetadata` is resolved to `Black`, as files here carry no such metadata.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// Zero outside the unit square.
    #[default]
    Black,
    /// Edge texels continue.
    Clamp,
    /// Tiled.
    Repeat,
    /// Tiled, every other one mirrored.
    Mirror,
}

/// `sourceColorSpace` of UsdUVTexture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ColorSpace {
    /// sRGB for 8-bit images with 3 or 4 channels, else raw.
    #[default]
    Auto,
    /// Linear values as stored.
    Raw,
    /// sRGB-encoded.
    SRgb,
}

/// Where a texture's coordinates come from.
#[derive(Debug, Clone, PartialEq)]
pub struct UvSource {
    /// Primvar name (`st` by convention).
    pub primvar: String,
    /// Coordinates where the primvar is missing.
    pub fallback: Vec2,
    /// UsdTransform2d (scale, then rotation, then translation), identity without one.
    pub transform: Affine2,
}

/// One UsdUVTexture read.
#[derive(Debug, Clone, PartialEq)]
pub struct TextureRead {
    /// Resolved file, or a name with `<UDIM>`; package paths (`a.usdz[b.png]`) allowed.
    pub file: PathBuf,
    /// Prim path of the texture shader, for messages.
    pub shader: String,
    /// Coordinates.
    pub uv: UvSource,
    /// Horizontal wrap.
    pub wrap_s: Wrap,
    /// Vertical wrap.
    pub wrap_t: Wrap,
    /// Applied after decoding: `value * scale + bias`.
    pub scale: Vec4,
    /// See `scale`.
    pub bias: Vec4,
    /// Value where the file cannot be read.
    pub fallback: Vec4,
    /// Color space of the file.
    pub color_space: ColorSpace,
    /// Which component(s) the connected output gives: 0–3 for r, g, b, a; `None` for rgb.
    pub channel: Option<u8>,
}

/// A material input: constant, from a primvar of the mesh, or from a texture. Colors use xyz; scalars use x.
#[derive(Debug, Clone, PartialEq)]
pub enum Input {
    /// The same everywhere.
    Constant(Vec4),
    /// `UsdPrimvarReader`: the primvar called `name`, else `fallback`.
    Primvar {
        /// Primvar name.
        name: String,
        /// Value where the mesh has no such primvar.
        fallback: Vec4,
    },
    /// A texture.
    Texture(Box<TextureRead>),
}

impl Input {
    /// A constant scalar.
    pub fn scalar(value: f32) -> Self {
        Self::Constant(Vec4::new(value, 0.0, 0.0, 1.0))
    }

    /// A constant color.
    pub fn color(r: f32, g: f32, b: f32) -> Self {
        Self::Constant(Vec4::new(r, g, b, 1.0))
    }
}

/// UsdPreviewSurface inputs (other shaders are reduced to it). Defaults are the specification's.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Stage path of the Material prim.
    pub path: String,
    /// Diffuse or base color, linear.
    pub diffuse_color: Input,
    /// Emitted radiance, linear.
    pub emissive_color: Input,
    /// 0 dielectric … 1 metal (ignored in the specular workflow).
    pub metallic: Input,
    /// 0 mirror … 1 rough.
    pub roughness: Input,
    /// 0 invisible … 1 opaque.
    pub opacity: Input,
    /// Above 0: opacity below it is a hole, the rest is opaque (cut-out).
    pub opacity_threshold: Input,
    /// `useSpecularWorkflow`.
    pub specular_workflow: bool,
    /// F0 of the specular workflow.
    pub specular_color: Input,
    /// Index of refraction.
    pub ior: Input,
    /// Clearcoat amount.
    pub clearcoat: Input,
    /// Clearcoat roughness.
    pub clearcoat_roughness: Input,
    /// Along the normal, stage units.
    pub displacement: Input,
    /// Texture of normals in tangent space. Surfaces are shaded without it: it is there for other formats.
    pub normal: Option<Box<TextureRead>>,
    /// Whom its emission lights directly, and what blocks that: all, but for meshes that are lights.
    pub emission_links: LightLinks,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            path: String::new(),
            diffuse_color: Input::color(0.18, 0.18, 0.18),
            emissive_color: Input::color(0.0, 0.0, 0.0),
            metallic: Input::scalar(0.0),
            roughness: Input::scalar(0.5),
            opacity: Input::scalar(1.0),
            opacity_threshold: Input::scalar(0.0),
            specular_workflow: false,
            specular_color: Input::color(0.0, 0.0, 0.0),
            ior: Input::scalar(1.5),
            clearcoat: Input::scalar(0.0),
            clearcoat_roughness: Input::scalar(0.01),
            displacement: Input::scalar(0.0),
            normal: None,
            emission_links: LightLinks::default(),
        }
    }
}

impl Material {
    /// True if it may move the surface it is on.
    pub fn displaces(&self) -> bool {
        !matches!(self.displacement, Input::Constant(value) if value.x == 0.0)
    }

    /// All inputs that surfaces are shaded with, by their UsdPreviewSurface names.
    pub fn inputs(&self) -> [(&'static str, &Input); 11] {
        [
            ("diffuseColor", &self.diffuse_color),
            ("emissiveColor", &self.emissive_color),
            ("metallic", &self.metallic),
            ("roughness", &self.roughness),
            ("opacity", &self.opacity),
            ("opacityThreshold", &self.opacity_threshold),
            ("specularColor", &self.specular_color),
            ("ior", &self.ior),
            ("clearcoat", &self.clearcoat),
            ("clearcoatRoughness", &self.clearcoat_roughness),
            ("displacement", &self.displacement),
        ]
    }
}
