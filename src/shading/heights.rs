//! How far materials displace surfaces, before there is a surface to shade.

use super::material::{Place, Source};
use super::textures::{Reads, Textures};
use super::{SurfacePoint, materials_in_use};
use crate::diagnostics::Diagnostics;
use crate::scene::{Material, MaterialId, PrimId, Scene};
use std::path::Path;

/// Displacements of a scene's materials (UsdPreviewSurface `displacement`); their textures are decoded once.
#[derive(Debug)]
pub struct Heights<'a> {
    scene: &'a Scene,
    textures: Textures,
    /// By [`MaterialId`]; `None` for materials that displace nothing.
    sources: Vec<Option<Source<'a>>>,
}

impl<'a> Heights<'a> {
    /// Decode the textures of displacement; `None` where no prim of `scene` is displaced. Missing or broken files become
    /// warnings, and their reads give the fallback value.
    pub fn of(scene: &'a Scene, diagnostics: &Diagnostics) -> Option<Self> {
        let used = materials_in_use(scene);
        let materials = || scene.materials.iter().zip(&used);
        let displacing = || {
            materials()
                .filter_map(|(material, used)| (*used && material.displaces()).then_some(material))
        };
        displacing().next()?;
        let textures = Textures::load(displacing(), Reads::Displacement, diagnostics);
        let source = |(material, used): (&'a Material, &bool)| {
            (*used && material.displaces()).then(|| Source::new(&material.displacement, &textures))
        };
        let sources = materials().map(source).collect();
        Some(Self {
            scene,
            textures,
            sources,
        })
    }

    /// True if `material` displaces.
    pub fn displaces(&self, material: MaterialId) -> bool {
        self.sources[material.index()].is_some()
    }

    /// The material of source face `face` of `prim`.
    pub fn material_of(&self, prim: PrimId, face: u32) -> Option<MaterialId> {
        self.scene.prims[prim.index()].materials.of_face(face)
    }

    /// True if the displacement of `material` is not linear on triangles: it comes from an image.
    pub fn is_detailed(&self, material: MaterialId) -> bool {
        matches!(self.sources[material.index()], Some(Source::Texture { .. }))
    }

    /// How far the surface at `point` moves along its normal, world units; 0 where that is no number.
    pub fn at(&self, material: MaterialId, point: &SurfacePoint) -> f32 {
        let Some(source) = &self.sources[material.index()] else {
            return 0.0;
        };
        let prim = &self.scene.prims[point.prim.index()];
        let place = Place {
            textures: &self.textures,
            mesh: self.scene.mesh_of(prim),
            prim,
            point,
        };
        let height = source.at(&place).x;
        if height.is_finite() { height } else { 0.0 }
    }

    /// Files of the textures that were decoded.
    pub fn images(&self) -> impl Iterator<Item = &Path> {
        self.textures.files()
    }
}
