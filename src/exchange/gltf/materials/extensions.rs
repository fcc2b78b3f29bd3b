//! Extensions of materials that the crate does not read, from their JSON.

use super::Look;
use super::read::{Read, single};
use crate::exchange::Error;
use crate::writers::usd::author::Data;
use glam::{Vec3, Vec4};
use gltf::Material;
use serde_json::Value;

const SPECULAR_GLOSSINESS: &str = "KHR_materials_pbrSpecularGlossiness";

/// A surface told by its diffuse and specular colors, and by its gloss: `KHR_materials_pbrSpecularGlossiness`, in the place of
/// metal and roughness.
pub(super) struct SpecularGlossiness<'a>(&'a Value);

impl<'a> SpecularGlossiness<'a> {
    pub(super) fn of(material: &'a Material<'_>) -> Option<Self> {
        material.extension_value(SPECULAR_GLOSSINESS).map(Self)
    }

    /// Diffuse color and opacity.
    pub(super) fn diffuse_factor(&self) -> Vec4 {
        let [x, y, z, w] = numbers(self.0, "diffuseFactor", 1.0);
        Vec4::new(x, y, z, w)
    }

    pub(super) fn diffuse_texture(&self) -> Option<&'a Value> {
        self.0.get("diffuseTexture")
    }
}

impl Look<'_, '_> {
    /// The texture that `info` names, the JSON of a `textureInfo`: values times `scale` plus `bias`. `None` with a warning
    /// where there is none of that number.
    pub(super) fn named<'a>(
        &self,
        document: &'a gltf::Document,
        info: &Value,
        (scale, bias): (Vec4, Vec4),
    ) -> Option<Read<'a>> {
        let count = |key: &str| info.get(key).and_then(Value::as_u64);
        let texture = (count("index"))
            .and_then(|index| usize::try_from(index).ok())
            .and_then(|index| document.textures().nth(index));
        let Some(texture) = texture else {
            let message = "one of its extensions' textures is not in the file: left out";
            self.diagnostics.warn("lost", self.path.clone(), message);
            return None;
        };
        let set = count("texCoord").and_then(|set| u32::try_from(set).ok());
        let transform = (info.get("extensions")).and_then(|all| all.get("KHR_texture_transform"));
        Some(Read::new(
            texture,
            set.unwrap_or(0),
            transform,
            (scale, bias),
        ))
    }

    /// Specular color and roughness in the place of metal and roughness. Specular colors are painted sRGB, with linear gloss
    /// beside them: roughness is 1 − gloss.
    pub(super) fn specular(
        &mut self,
        document: &gltf::Document,
        told: &SpecularGlossiness<'_>,
    ) -> Result<(), Error> {
        let [x, y, z] = numbers(told.0, "specularFactor", 1.0);
        let [gloss] = numbers(told.0, "glossinessFactor", 1.0);
        let workflow = ("inputs:useSpecularWorkflow", "int");
        self.author
            .attribute(&self.surface(), workflow, Data::Int(1))?;
        let texture = told
            .0
            .get("specularGlossinessTexture")
            .and_then(|info| self.named(document, info, (Vec4::new(x, y, z, -gloss), Vec4::W)));
        let Some(read) = texture.map(Read::color) else {
            self.vector("specularColor", Vec3::new(x, y, z), false)?;
            return self.number("roughness", 1.0 - gloss);
        };
        self.texture("specular_glossiness", &read, &["rgb", "a"])?;
        self.take("specularColor", "color3f", "specular_glossiness", "rgb")?;
        self.take("roughness", "float", "specular_glossiness", "a")
    }

    /// `KHR_materials_clearcoat`.
    pub(super) fn coat(
        &mut self,
        document: &gltf::Document,
        material: &Material<'_>,
    ) -> Result<(), Error> {
        let Some(coat) = material.extension_value("KHR_materials_clearcoat") else {
            return Ok(());
        };
        let parts = [
            ("clearcoat", "clearcoatFactor", "clearcoatTexture", "r"),
            (
                "clearcoatRoughness",
                "clearcoatRoughnessFactor",
                "clearcoatRoughnessTexture",
                "g",
            ),
        ];
        for (input, factor, texture, output) in parts {
            let [factor] = numbers(coat, factor, 0.0);
            let layout = (Vec4::splat(factor), Vec4::ZERO);
            let texture = (coat.get(texture)).and_then(|info| self.named(document, info, layout));
            match texture {
                Some(read) if factor != 0.0 => {
                    self.texture(input, &read, &[output])?;
                    self.take(input, "float", input, output)?;
                }
                _ => self.number(input, factor)?,
            }
        }
        if coat.get("clearcoatNormalTexture").is_some() {
            let message = "KHR_materials_clearcoat: its normals are left out: the coat is as smooth as what is below it";
            self.diagnostics.warn("lost", self.path.clone(), message);
        }
        Ok(())
    }
}

/// The number or numbers `key` of `value`, each `default` where it is not told.
fn numbers<const N: usize>(value: &Value, key: &str, default: f32) -> [f32; N] {
    let told = value.get(key);
    std::array::from_fn(|i| {
        let one = told.and_then(|told| told.get(i).or_else(|| (i == 0).then_some(told)));
        one.and_then(Value::as_f64).map_or(default, single)
    })
}
