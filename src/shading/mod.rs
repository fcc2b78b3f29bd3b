//! Material and textures at a point of a surface: albedo and emission, averaged over a footprint.

pub mod gloss;
mod heights;
mod material;
mod screens;
mod textures;

use crate::diagnostics::Diagnostics;
use crate::scene::{Light, LightGroup, LightLinks, MaterialId, Prim, PrimId, Scene};
use crate::trace::{Hit, Opacity};
use glam::Vec3;
use gloss::{Gloss, Lobe};
pub use heights::Heights;
use material::Compiled;
use screens::Screens;
pub use screens::may_be_screen;
use std::path::Path;
use std::sync::Arc;
use textures::{Reads, Textures};

/// Albedo of surfaces that have neither a material nor `displayColor`: UsdPreviewSurface's default.
const NEUTRAL: Vec3 = Vec3::splat(0.18);

/// A point on a prim's triangle, with the size of the area it stands for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The prim.
    pub prim: PrimId,
    /// Triangle of the prim's mesh.
    pub triangle: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2.
    pub v: f32,
    /// Edge length, in world units, of the square to average textures over; 0 = point-sampled at full resolution.
    pub footprint: f32,
}

impl SurfacePoint {
    /// Where a ray hit; `footprint` as above.
    pub fn of_hit(hit: &Hit, footprint: f32) -> Self {
        Self {
            prim: hit.prim,
            triangle: hit.triangle,
            u: hit.u,
            v: hit.v,
            footprint,
        }
    }
}

/// What a surface does with light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Diffuse albedo of what there is of it, clamped to 0…1: `diffuseColor · (1 − metallic)` (all of it in the specular
    /// workflow).
    pub albedo: Vec3,
    /// Radiance that what there is of it emits from the front side, ≥ 0, finite.
    pub emission: Vec3,
    /// How much of it there is: the part of what falls on it that does not pass, 0…1. With a cut-out threshold: 0 or 1 at a
    /// point, the covered fraction over a footprint. Where it is 0 the rest is black.
    pub opacity: f32,
}

/// Evaluates materials of a scene; textures are decoded once.
#[derive(Debug)]
pub struct Shader<'a> {
    scene: &'a Scene,
    textures: Arc<Textures>,
    /// By [`MaterialId`]; `None` for materials on no prim of the scene.
    materials: Arc<[Option<Compiled<'a>>]>,
    /// What light passes through; `None` where nothing is.
    screens: Option<Arc<Screens>>,
    /// Only its sources shine; `None` = all do.
    group: Option<&'a LightGroup>,
}

impl<'a> Shader<'a> {
    /// Decode the textures that diffuse surfaces and emission of the scene's prims read. Missing or broken files become
    /// warnings naming file and material, and their reads give the fallback value.
    pub fn new(scene: &'a Scene, diagnostics: &Diagnostics) -> Self {
        Self::with_textures(scene, Reads::Diffuse, diagnostics)
    }

    /// The same, and the textures that [`Self::gloss`] reads; without them these give their fallbacks.
    pub fn glossy(scene: &'a Scene, diagnostics: &Diagnostics) -> Self {
        Self::with_textures(scene, Reads::Gloss, diagnostics)
    }

    /// The same for who asks for nothing but [`Self::opacity`]: other textures are not decoded and give their fallbacks.
    pub fn of_opacity(scene: &'a Scene, diagnostics: &Diagnostics) -> Self {
        Self::with_textures(scene, Reads::Opacity, diagnostics)
    }

    fn with_textures(scene: &'a Scene, reads: Reads, diagnostics: &Diagnostics) -> Self {
        let used = materials_in_use(scene);
        let in_use = || {
            let materials = scene.materials.iter().zip(&used);
            materials
                .filter(|(_, used)| **used)
                .map(|(material, _)| material)
        };
        let textures = Textures::load(in_use(), reads, diagnostics);
        let materials = scene.materials.iter().zip(&used);
        let materials =
            materials.map(|(material, used)| used.then(|| Compiled::new(material, &textures)));
        let materials = materials.collect();
        let textures = Arc::new(textures);
        Self {
            scene,
            materials,
            screens: Screens::of(scene, &textures).map(Arc::new),
            textures,
            group: None,
        }
    }

    /// How much surfaces stop of what falls on them, for [`crate::trace::Tracer::among`]; `None` if all of it everywhere.
    pub fn opacity(&self) -> Option<Arc<dyn Opacity>> {
        let screens = self.screens.as_ref().map(Arc::clone);
        screens.map(|screens| screens as Arc<dyn Opacity>)
    }

    /// The same materials and textures where only the sources of `group` shine.
    #[must_use]
    pub fn of_group(&self, group: &'a LightGroup) -> Self {
        Self {
            scene: self.scene,
            textures: Arc::clone(&self.textures),
            materials: Arc::clone(&self.materials),
            screens: self.screens.clone(),
            group: Some(group),
        }
    }

    /// The lights that shine: those of the group if this is one's, else all of the scene.
    pub fn lights(&self) -> impl Iterator<Item = &'a Light> {
        let group = self.group;
        let shines = move |i: usize| group.is_none_or(|group| group.lights[i]);
        let lights = self.scene.lights.iter().enumerate();
        lights
            .filter(move |(i, _)| shines(*i))
            .map(|(_, light)| light)
    }

    /// True if the emission of `prim` counts.
    fn shines(&self, prim: PrimId) -> bool {
        self.group.is_none_or(|group| group.has_prim(prim))
    }

    /// What reflects glossily at `point`. Prims without material: what UsdPreviewSurface does by default.
    pub fn gloss(&self, point: &SurfacePoint) -> Gloss {
        let prim = &self.scene.prims[point.prim.index()];
        match self.material_at(prim, point.triangle) {
            Some(material) => material.gloss(&self.textures, self.scene.mesh_of(prim), prim, point),
            None => Gloss {
                base: Lobe::new(material::reflectance(1.5), Vec3::ONE, 0.5),
                coat: Lobe::NONE,
            },
        }
    }

    /// Files of the textures that were decoded.
    pub fn images(&self) -> impl Iterator<Item = &Path> {
        self.textures.files()
    }

    /// The scene it shades.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// The surface at `point`. Prims without material: `displayColor` and `displayOpacity`, else 0.18 gray.
    pub fn surface(&self, point: &SurfacePoint) -> Surface {
        let prim = &self.scene.prims[point.prim.index()];
        let Some(material) = self.material_at(prim, point.triangle) else {
            return self.unbound(prim, point);
        };
        let surface = material.surface(&self.textures, self.scene.mesh_of(prim), prim, point);
        match self.shines(point.prim) {
            true => surface,
            false => Surface {
                emission: Vec3::ZERO,
                ..surface
            },
        }
    }

    /// True if triangle `triangle` of `prim` may emit (its material's emission is not constantly black).
    pub fn may_emit(&self, prim: PrimId, triangle: u32) -> bool {
        if !self.shines(prim) {
            return false;
        }
        let prim = &self.scene.prims[prim.index()];
        self.material_at(prim, triangle)
            .is_some_and(Compiled::may_emit)
    }

    /// Whom the emission of triangle `triangle` of `prim` lights; `None` without a material.
    pub fn emission_links(&self, prim: PrimId, triangle: u32) -> Option<&'a LightLinks> {
        let prim = &self.scene.prims[prim.index()];
        let face = self.scene.mesh_of(prim).triangle_faces[triangle as usize];
        let material = prim.materials.of_face(face)?;
        Some(&self.scene.materials[material.index()].emission_links)
    }

    fn material_at(&self, prim: &Prim, triangle: u32) -> Option<&Compiled<'a>> {
        let face = self.scene.mesh_of(prim).triangle_faces[triangle as usize];
        let material = prim.materials.of_face(face)?;
        self.materials[material.index()].as_ref()
    }

    fn unbound(&self, prim: &Prim, point: &SurfacePoint) -> Surface {
        let mesh = self.scene.mesh_of(prim);
        let primvar = |name: &str| {
            let primvar = mesh.primvar(name)?;
            Some(primvar.sample(mesh, point.triangle as usize, point.u, point.v))
        };
        let color = primvar("displayColor").map_or(NEUTRAL, glam::Vec4::truncate);
        let opacity = clamped(primvar("displayOpacity").map_or(1.0, |opacity| opacity.x));
        let albedo = match opacity > 0.0 {
            true => Vec3::from_array(color.to_array().map(clamped)),
            false => Vec3::ZERO,
        };
        Surface {
            albedo,
            emission: Vec3::ZERO,
            opacity,
        }
    }
}

/// To 0…1; NaN is 0.
fn clamped(value: f32) -> f32 {
    if value.is_nan() {
        0.0
    } else {
        value.clamp(0.0, 1.0)
    }
}

/// Which materials some prim has on some face.
fn materials_in_use(scene: &Scene) -> Vec<bool> {
    use crate::scene::FaceMaterials;
    let mut used = vec![false; scene.materials.len()];
    let mut mark = |material: &Option<MaterialId>| {
        if let Some(id) = material {
            used[id.index()] = true;
        }
    };
    for prim in &scene.prims {
        match &prim.materials {
            FaceMaterials::Whole(material) => mark(material),
            FaceMaterials::PerFace(materials) => materials.iter().for_each(&mut mark),
        }
    }
    used
}

#[cfg(test)]
mod tests;
