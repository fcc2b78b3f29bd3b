//! Materials → UsdPreviewSurface networks.

mod extensions;
mod read;

use super::document::Document;
use super::images::Images;
use super::meshes::coordinates_name;
use super::nodes::Names;
use crate::diagnostics::Diagnostics;
use crate::exchange::Error;
use crate::writers::usd::author::{Author, Data};
use extensions::SpecularGlossiness;
use glam::{Vec3, Vec4};
use gltf::Material;
use gltf::material::AlphaMode;
use gltf::texture::WrappingMode;
use read::{Read, Transform};
use std::collections::BTreeMap;

/// Extensions of materials that UsdPreviewSurface has no word for.
const LOST: [(&str, &str); 7] = [
    ("KHR_materials_transmission", "transmission: it is opaque"),
    ("KHR_materials_volume", "volume"),
    ("KHR_materials_sheen", "sheen"),
    ("KHR_materials_iridescence", "iridescence"),
    ("KHR_materials_anisotropy", "anisotropy"),
    ("KHR_materials_dispersion", "dispersion"),
    (
        "KHR_materials_specular",
        "specular: it reflects as its ior says",
    ),
];

/// Materials that something is bound to: by index and whether vertex colors are read, their names.
#[derive(Default)]
pub(super) struct Looks {
    used: BTreeMap<(Option<usize>, bool), String>,
    names: Names,
}

impl Looks {
    /// Path of `material` for a mesh with or without vertex colors.
    pub(super) fn path_of(&mut self, material: &Material<'_>, has_colors: bool) -> String {
        let pbr = material.pbr_metallic_roughness();
        let has_texture = match SpecularGlossiness::of(material) {
            Some(told) => told.diffuse_texture().is_some(),
            None => pbr.base_color_texture().is_some(),
        };
        let reads_colors = has_colors && !has_texture;
        let key = (material.index(), reads_colors);
        if let Some(name) = self.used.get(&key) {
            return format!("/root/Looks/{name}");
        }
        let default = material
            .index()
            .map_or("default".to_owned(), |index| format!("material_{index}"));
        let name = material.name().unwrap_or(&default);
        let name = self.names.unique(&match reads_colors {
            true => format!("{name}_vertex_colors"),
            false => name.to_owned(),
        });
        self.used.insert(key, name.clone());
        format!("/root/Looks/{name}")
    }

    /// Author all of them.
    pub(super) fn write(
        self,
        document: &Document,
        author: &mut Author,
        (images, diagnostics): (&mut Images<'_>, &Diagnostics),
    ) -> Result<(), Error> {
        if self.used.is_empty() {
            return Ok(());
        }
        author.define("/root/Looks", "Scope")?;
        for ((index, reads_colors), name) in self.used {
            let material = match index {
                Some(index) => document.gltf.materials().nth(index),
                None => None,
            };
            let mut look = Look {
                path: format!("/root/Looks/{name}"),
                author: &mut *author,
                images: &mut *images,
                diagnostics,
            };
            look.write((&document.gltf, material.as_ref()), reads_colors)?;
        }
        Ok(())
    }
}

/// One material being written.
struct Look<'a, 'd> {
    path: String,
    author: &'a mut Author,
    images: &'a mut Images<'d>,
    diagnostics: &'a Diagnostics,
}

impl Look<'_, '_> {
    fn write(
        &mut self,
        (document, material): (&gltf::Document, Option<&Material<'_>>),
        reads_colors: bool,
    ) -> Result<(), Error> {
        let path = self.path.clone();
        self.author.define(&path, "Material")?;
        let surface = format!("{path}/surface");
        self.shader(&surface, "UsdPreviewSurface")?;
        self.author.output(&surface, ("outputs:surface", "token"))?;
        let output = format!("{surface}.outputs:surface");
        self.author
            .connect(&path, ("outputs:surface", "token"), &output)?;
        let Some(material) = material else {
            // the default material of glTF: white metal of roughness 1
            self.vector("diffuseColor", Vec3::ONE, reads_colors)?;
            self.number("metallic", 1.0)?;
            return self.number("roughness", 1.0);
        };
        let specular = SpecularGlossiness::of(material).filter(|_| !material.unlit());
        self.base((document, material), specular.as_ref(), reads_colors)?;
        if !material.unlit() {
            match &specular {
                Some(specular) => self.specular(document, specular)?,
                None => self.metal(material)?,
            }
            self.relief(material)?;
            self.emission(material)?;
            self.coat(document, material)?;
            if let Some(ior) = material.ior() {
                self.number("ior", ior)?;
            }
        }
        for (extension, what) in LOST {
            if material.extension_value(extension).is_some() {
                self.diagnostics
                    .warn("lost", path.clone(), format!("{extension}: its {what}"));
            }
        }
        Ok(())
    }

    fn shader(&mut self, path: &str, id: &str) -> Result<(), Error> {
        self.author.define(path, "Shader")?;
        Ok(self
            .author
            .uniform(path, ("info:id", "token"), Data::Token(id.to_owned()))?)
    }

    fn surface(&self) -> String {
        format!("{}/surface", self.path)
    }

    fn number(&mut self, input: &str, value: f32) -> Result<(), Error> {
        let name = format!("inputs:{input}");
        Ok(self
            .author
            .attribute(&self.surface(), (&name, "float"), Data::Float(value))?)
    }

    /// A color, or vertex colors.
    fn vector(&mut self, input: &str, value: Vec3, reads_colors: bool) -> Result<(), Error> {
        let (surface, name) = (self.surface(), format!("inputs:{input}"));
        if !reads_colors {
            return Ok(self
                .author
                .attribute(&surface, (&name, "color3f"), Data::Vec3(value))?);
        }
        let reader = format!("{}/vertex_colors", self.path);
        self.shader(&reader, "UsdPrimvarReader_float3")?;
        let varname = Data::Text("displayColor".to_owned());
        self.author
            .attribute(&reader, ("inputs:varname", "string"), varname)?;
        self.author.output(&reader, ("outputs:result", "float3"))?;
        let source = format!("{reader}.outputs:result");
        Ok(self.author.connect(&surface, (&name, "color3f"), &source)?)
    }

    /// Base color and opacity; of unlit materials as emission.
    fn base(
        &mut self,
        (document, material): (&gltf::Document, &Material<'_>),
        specular: Option<&SpecularGlossiness<'_>>,
        reads_colors: bool,
    ) -> Result<(), Error> {
        let pbr = material.pbr_metallic_roughness();
        let factor = match specular {
            Some(told) => told.diffuse_factor(),
            None => Vec4::from_array(pbr.base_color_factor()),
        };
        let input = if material.unlit() {
            "emissiveColor"
        } else {
            "diffuseColor"
        };
        if material.unlit() {
            self.vector("diffuseColor", Vec3::ZERO, false)?;
            self.author.attribute(
                &self.surface(),
                ("inputs:useSpecularWorkflow", "int"),
                Data::Int(1),
            )?;
            self.vector("specularColor", Vec3::ZERO, false)?;
            self.number("roughness", 1.0)?;
        }
        let texture = match specular {
            Some(told) => (told.diffuse_texture())
                .and_then(|info| self.named(document, info, (factor, Vec4::ZERO)))
                .map(Read::color),
            None => (pbr.base_color_texture()).map(|info| Read::of(&info, factor).color()),
        };
        match &texture {
            Some(read) => {
                self.texture("base_color", read, &["rgb", "a"])?;
                self.take(input, "color3f", "base_color", "rgb")?;
            }
            None => self.vector(input, factor.truncate(), reads_colors)?,
        }
        if material.alpha_mode() == AlphaMode::Opaque {
            return Ok(());
        }
        match &texture {
            Some(_) => self.take("opacity", "float", "base_color", "a")?,
            None => self.number("opacity", factor.w)?,
        }
        if material.alpha_mode() == AlphaMode::Mask {
            self.number("opacityThreshold", material.alpha_cutoff().unwrap_or(0.5))?;
        }
        Ok(())
    }

    fn metal(&mut self, material: &Material<'_>) -> Result<(), Error> {
        let pbr = material.pbr_metallic_roughness();
        let (metallic, roughness) = (pbr.metallic_factor(), pbr.roughness_factor());
        let Some(info) = pbr.metallic_roughness_texture() else {
            self.number("metallic", metallic)?;
            return self.number("roughness", roughness);
        };
        let factor = Vec4::new(1.0, roughness, metallic, 1.0);
        self.texture("metallic_roughness", &Read::of(&info, factor), &["b", "g"])?;
        self.take("metallic", "float", "metallic_roughness", "b")?;
        self.take("roughness", "float", "metallic_roughness", "g")
    }

    /// Normals and occlusion.
    fn relief(&mut self, material: &Material<'_>) -> Result<(), Error> {
        if let Some(normal) = material.normal_texture() {
            if normal.scale() != 1.0 {
                let message = format!(
                    "its normals' scale {} is left out: they bend as painted",
                    normal.scale()
                );
                self.diagnostics.warn("lost", self.path.clone(), message);
            }
            // the only ones that the specification of UsdPreviewSurface has for normals of 8 bits
            let layout = (
                Vec4::new(2.0, 2.0, 2.0, 1.0),
                Vec4::new(-1.0, -1.0, -1.0, 0.0),
            );
            let transform = normal.extension_value("KHR_texture_transform");
            let read = Read::new(normal.texture(), normal.tex_coord(), transform, layout);
            self.texture("normal", &read, &["rgb"])?;
            self.take("normal", "normal3f", "normal", "rgb")?;
        }
        if let Some(occlusion) = material.occlusion_texture() {
            let s = occlusion.strength();
            let layout = (
                Vec4::new(s, s, s, 1.0),
                Vec4::new(1.0 - s, 1.0 - s, 1.0 - s, 0.0),
            );
            let transform = occlusion.extension_value("KHR_texture_transform");
            let read = Read::new(
                occlusion.texture(),
                occlusion.tex_coord(),
                transform,
                layout,
            );
            self.texture("occlusion", &read, &["r"])?;
            self.take("occlusion", "float", "occlusion", "r")?;
        }
        Ok(())
    }

    fn emission(&mut self, material: &Material<'_>) -> Result<(), Error> {
        let strength = material.emissive_strength().unwrap_or(1.0);
        let factor = Vec3::from_array(material.emissive_factor()) * strength;
        match material.emissive_texture() {
            Some(info) if factor != Vec3::ZERO => {
                self.texture(
                    "emissive",
                    &Read::of(&info, factor.extend(1.0)).color(),
                    &["rgb"],
                )?;
                self.take("emissiveColor", "color3f", "emissive", "rgb")
            }
            _ if factor != Vec3::ZERO => self.vector("emissiveColor", factor, false),
            _ => Ok(()),
        }
    }

    /// Connect `input` of the surface to an output of the texture `name`.
    fn take(
        &mut self,
        input: &str,
        type_name: &str,
        name: &str,
        output: &str,
    ) -> Result<(), Error> {
        let source = format!("{}/{name}.outputs:{output}", self.path);
        let input = format!("inputs:{input}");
        Ok(self
            .author
            .connect(&self.surface(), (&input, type_name), &source)?)
    }

    /// The nodes that read a texture.
    fn texture(&mut self, name: &str, read: &Read<'_>, outputs: &[&str]) -> Result<(), Error> {
        let path = format!("{}/{name}", self.path);
        let file = self
            .images
            .asset(&read.texture, (&path, self.diagnostics))?;
        self.shader(&path, "UsdUVTexture")?;
        let author = &mut self.author;
        if let Some(file) = file {
            author.attribute(&path, ("inputs:file", "asset"), Data::Asset(file))?;
        }
        let space = if read.is_color { "sRGB" } else { "raw" };
        author.attribute(
            &path,
            ("inputs:sourceColorSpace", "token"),
            Data::Token(space.to_owned()),
        )?;
        let sampler = read.texture.sampler();
        for (input, mode) in [
            ("inputs:wrapS", sampler.wrap_s()),
            ("inputs:wrapT", sampler.wrap_t()),
        ] {
            let word = match mode {
                WrappingMode::ClampToEdge => "clamp",
                WrappingMode::MirroredRepeat => "mirror",
                WrappingMode::Repeat => "repeat",
            };
            author.attribute(&path, (input, "token"), Data::Token(word.to_owned()))?;
        }
        if read.scale != Vec4::ONE {
            author.attribute(&path, ("inputs:scale", "float4"), Data::Vec4(read.scale))?;
        }
        if read.bias != Vec4::ZERO {
            author.attribute(&path, ("inputs:bias", "float4"), Data::Vec4(read.bias))?;
        }
        for output in outputs {
            let type_name = if *output == "rgb" { "float3" } else { "float" };
            author.output(&path, (&format!("outputs:{output}"), type_name))?;
        }
        let coordinates = self.coordinates(name, read)?;
        Ok(self
            .author
            .connect(&path, ("inputs:st", "float2"), &coordinates)?)
    }

    /// What gives texture coordinates to the texture `name`: the output's path.
    fn coordinates(&mut self, name: &str, read: &Read<'_>) -> Result<String, Error> {
        let set = coordinates_name(read.set);
        let reader = format!("{}/{set}", self.path);
        self.shader(&reader, "UsdPrimvarReader_float2")?;
        let author = &mut self.author;
        author.attribute(&reader, ("inputs:varname", "string"), Data::Text(set))?;
        author.output(&reader, ("outputs:result", "float2"))?;
        let plain = format!("{reader}.outputs:result");
        if read.transform == Transform::NONE {
            return Ok(plain);
        }
        let path = format!("{}/{name}_transform", self.path);
        self.shader(&path, "UsdTransform2d")?;
        let (scale, rotation, translation) = read.transform.upright();
        let author = &mut self.author;
        author.connect(&path, ("inputs:in", "float2"), &plain)?;
        author.attribute(&path, ("inputs:scale", "float2"), Data::Vec2(scale))?;
        author.attribute(&path, ("inputs:rotation", "float"), Data::Float(rotation))?;
        author.attribute(
            &path,
            ("inputs:translation", "float2"),
            Data::Vec2(translation),
        )?;
        author.output(&path, ("outputs:result", "float2"))?;
        Ok(format!("{path}.outputs:result"))
    }
}
