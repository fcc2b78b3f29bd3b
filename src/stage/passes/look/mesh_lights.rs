//! `MeshLightAPI`: meshes that shine → materials whose emission is the light's radiance.
//!
//! `light:materialSyncMode` as UsdLux has it: `materialGlowTintsLight` (the fallback) multiplies the light's radiance by
//! the emission of the bound material, `independent` puts it in the place of that emission, `noMaterialResponse` takes
//! away everything else of the material too. What a camera sees of the surface is the same radiance that lights the
//! scene, where UsdLux would show it the material's own emission.

use super::super::super::raw::RawPrim;
use super::links::{Links, Resolver};
use super::reduce::multiplied;
use super::values::Values;
use crate::diagnostics::Diagnostics;
use crate::scene::{FaceMaterials, Input, LightLinks, Material, MaterialId, PlacedMesh, Scene};
use glam::{Vec3, Vec4};
use std::collections::HashMap;
use std::sync::Arc;

/// What a mesh light makes of the bound material.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(in super::super) enum MaterialSync {
    GlowTintsLight,
    Independent,
    NoMaterialResponse,
}

/// A mesh that is a light.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshLight {
    /// Stage path.
    pub(super) path: String,
    /// Inputs multiplied out, before `normalize`.
    pub(super) radiance: Vec3,
    /// Divide by the world-space area.
    pub(super) normalize: bool,
    pub(super) sync: MaterialSync,
    pub(super) links: Links,
}

impl MaterialSync {
    /// `light:materialSyncMode` of `prim`; unknown words count as the fallback, with a warning.
    pub(super) fn read(prim: &RawPrim, path: &str, diagnostics: &Diagnostics) -> Self {
        match prim.token("light:materialSyncMode") {
            None | Some("materialGlowTintsLight" | "") => Self::GlowTintsLight,
            Some("independent") => Self::Independent,
            Some("noMaterialResponse") => Self::NoMaterialResponse,
            Some(word) => {
                let message = format!(
                    "light:materialSyncMode `{word}` is none of materialGlowTintsLight, independent, noMaterialResponse; \
                     the first is used"
                );
                diagnostics.warn("unsupported-light", path, message);
                Self::GlowTintsLight
            }
        }
    }
}

/// Give the prims that `lights` name materials that shine; those not drawn are passed over.
pub(in super::super) fn shine(scene: &mut Scene, lights: &[MeshLight], diagnostics: &Diagnostics) {
    if lights.is_empty() {
        return;
    }
    let by_path: HashMap<&str, usize> = (lights.iter().zip(0..))
        .map(|(light, number)| (light.path.as_str(), number))
        .collect();
    let mut resolver = Resolver::new(&scene.prims);
    let links: Vec<LightLinks> = (lights.iter())
        .map(|light| resolver.links(&light.links))
        .collect();
    let mut made = Made::default();
    for index in 0..scene.prims.len() {
        let Some(&number) = by_path.get(&*scene.prims[index].path) else {
            continue;
        };
        let light = &lights[number];
        let radiance = match light.normalize {
            true => light.radiance / area(scene, index),
            false => light.radiance,
        };
        if !radiance.is_finite() {
            let message = "a mesh without area cannot be normalized: the light is left out";
            diagnostics.warn("invalid-light", light.path.clone(), message);
            continue;
        }
        let mut lit = |material: Option<MaterialId>| {
            let shine = (radiance, light.sync, (number, &links[number]));
            Some(made.material(&mut scene.materials, material, shine))
        };
        let materials = match &scene.prims[index].materials {
            FaceMaterials::Whole(material) => FaceMaterials::Whole(lit(*material)),
            FaceMaterials::PerFace(faces) => {
                let faces: Vec<_> = faces.iter().map(|material| lit(*material)).collect();
                FaceMaterials::PerFace(Arc::from(faces))
            }
        };
        warn_if_dark(scene, &materials, light, diagnostics);
        scene.prims[index].materials = materials;
    }
}

/// A tint that is black everywhere is rarely meant.
fn warn_if_dark(
    scene: &Scene,
    materials: &FaceMaterials,
    light: &MeshLight,
    diagnostics: &Diagnostics,
) {
    let is_dark = |material: &Option<MaterialId>| {
        let material = material.map(|id| &scene.materials[id.index()].emissive_color);
        matches!(material, Some(Input::Constant(emission)) if emission.truncate() == Vec3::ZERO)
    };
    let all_dark = match materials {
        FaceMaterials::Whole(material) => is_dark(material),
        FaceMaterials::PerFace(faces) => faces.iter().all(is_dark),
    };
    if all_dark && light.radiance != Vec3::ZERO {
        diagnostics.warn(
            "dark-mesh-light",
            light.path.clone(),
            "its materials do not glow, and by materialGlowTintsLight their glow is the light's color: it is dark \
             (with materialSyncMode independent it would shine)",
        );
    }
}

/// World-space area of prim `index`.
fn area(scene: &Scene, index: usize) -> f32 {
    let mesh = PlacedMesh::new(scene, &scene.prims[index]);
    let area: f64 = (0..mesh.triangle_count()).map(|t| mesh.area(t)).sum();
    super::values::narrow(area)
}

/// Materials made so far, by what they are made of: prims with the same have the same.
#[derive(Default)]
struct Made(HashMap<Key, MaterialId>);

/// Bound material, radiance, mode, and the number of the light if it has links.
type Key = (Option<MaterialId>, [u32; 3], MaterialSync, Option<usize>);

impl Made {
    fn material(
        &mut self,
        materials: &mut Vec<Material>,
        bound: Option<MaterialId>,
        (radiance, sync, (number, links)): (Vec3, MaterialSync, (usize, &LightLinks)),
    ) -> MaterialId {
        let linked = (*links != LightLinks::default()).then_some(number);
        let key = (bound, radiance.to_array().map(f32::to_bits), sync, linked);
        *self.0.entry(key).or_insert_with(|| {
            let bound = bound.map(|id| &materials[id.index()]);
            materials.push(Material {
                emission_links: links.clone(),
                ..shining(bound, radiance, sync)
            });
            let id = u32::try_from(materials.len() - 1);
            MaterialId(id.expect("fewer materials than prims, and those fit in memory"))
        })
    }
}

fn shining(bound: Option<&Material>, radiance: Vec3, sync: MaterialSync) -> Material {
    let own = Input::Constant(radiance.extend(1.0));
    let material = bound.cloned().unwrap_or_else(unbound);
    match (sync, bound) {
        (MaterialSync::GlowTintsLight, Some(bound)) => Material {
            emissive_color: multiplied(bound.emissive_color.clone(), radiance.extend(1.0)),
            ..material
        },
        (MaterialSync::GlowTintsLight | MaterialSync::Independent, _) => Material {
            emissive_color: own,
            ..material
        },
        (MaterialSync::NoMaterialResponse, _) => Material {
            path: material.path,
            diffuse_color: Input::color(0.0, 0.0, 0.0),
            emissive_color: own,
            specular_workflow: true,
            opacity: material.opacity,
            opacity_threshold: material.opacity_threshold,
            ..Material::default()
        },
    }
}

/// What prims without a material look like.
fn unbound() -> Material {
    let display = |name: &str, fallback: Vec4| Input::Primvar {
        name: name.to_owned(),
        fallback,
    };
    let Input::Constant(neutral) = Material::default().diffuse_color else {
        unreachable!("the default is a constant");
    };
    Material {
        diffuse_color: display("displayColor", neutral),
        opacity: display("displayOpacity", Vec4::ONE),
        ..Material::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIANCE: Vec3 = Vec3::new(2.0, 4.0, 6.0);

    fn emission(material: &Material) -> Vec3 {
        let Input::Constant(value) = material.emissive_color else {
            panic!("constant: {:?}", material.emissive_color);
        };
        value.truncate()
    }

    fn glowing() -> Material {
        Material {
            emissive_color: Input::color(0.5, 1.0, 0.0),
            diffuse_color: Input::color(0.9, 0.9, 0.9),
            ..Material::default()
        }
    }

    #[test]
    fn sync_modes_are_those_of_usdlux() {
        let lit = |sync| shining(Some(&glowing()), RADIANCE, sync);
        let tinted = lit(MaterialSync::GlowTintsLight);
        assert_eq!(emission(&tinted), Vec3::new(1.0, 4.0, 0.0));
        assert_eq!(tinted.diffuse_color, glowing().diffuse_color);
        let own = lit(MaterialSync::Independent);
        assert_eq!(
            (emission(&own), &own.diffuse_color),
            (RADIANCE, &glowing().diffuse_color)
        );
        let bare = lit(MaterialSync::NoMaterialResponse);
        assert_eq!(
            (emission(&bare), bare.diffuse_color),
            (RADIANCE, Input::color(0.0, 0.0, 0.0))
        );
    }

    #[test]
    fn without_a_material_the_light_has_its_own_color_on_the_display_color() {
        let lit = shining(None, RADIANCE, MaterialSync::GlowTintsLight);
        assert_eq!(emission(&lit), RADIANCE);
        assert!(
            matches!(&lit.diffuse_color, Input::Primvar { name, .. } if name == "displayColor")
        );
    }

    #[test]
    fn equal_lights_on_equal_materials_share_one() {
        let (mut made, mut materials) = (Made::default(), vec![glowing()]);
        let mut of = |bound, radiance| {
            let shine = (
                radiance,
                MaterialSync::Independent,
                (0, &LightLinks::default()),
            );
            made.material(&mut materials, bound, shine)
        };
        let first = of(Some(MaterialId(0)), RADIANCE);
        assert_eq!(of(Some(MaterialId(0)), RADIANCE), first);
        assert_ne!(of(None, RADIANCE), first);
        assert_ne!(of(Some(MaterialId(0)), Vec3::ONE), first);
        assert_eq!(materials.len(), 4);
    }
}
