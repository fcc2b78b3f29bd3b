//! The textures of a scene's materials, each decoded once, in parallel.

use super::screens::may_be_screen;
use crate::diagnostics::Diagnostics;
use crate::image::{Error, Texture};
use crate::scene::{ColorSpace, Input, Material, TextureRead};
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Decoded textures.
#[derive(Debug, Default)]
pub(super) struct Textures {
    loaded: Vec<Option<Texture>>,
    by_file: HashMap<(PathBuf, u8), usize>,
}

/// Index of a texture that was decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TextureId(usize);

/// Which inputs have their textures decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reads {
    /// Those of displacement alone.
    Displacement,
    /// Those of opacity.
    Opacity,
    /// Those of diffuse surfaces and emission too.
    Diffuse,
    /// Those of glossy ones too.
    Gloss,
}

/// Textures that `material` reads.
fn reads(material: &Material, reads: Reads) -> impl Iterator<Item = &TextureRead> {
    let displacement = [&material.displacement].into_iter();
    let displacement = displacement.filter(move |_| reads == Reads::Displacement);
    let opacity = [&material.opacity, &material.opacity_threshold];
    let opacity = (opacity.into_iter())
        .filter(move |_| reads != Reads::Displacement && may_be_screen(material));
    let diffuse = [
        &material.diffuse_color,
        &material.emissive_color,
        &material.metallic,
    ];
    let diffuse =
        (diffuse.into_iter()).filter(move |_| matches!(reads, Reads::Diffuse | Reads::Gloss));
    let gloss = [
        &material.roughness,
        &material.specular_color,
        &material.ior,
        &material.clearcoat,
        &material.clearcoat_roughness,
    ];
    let gloss = gloss.into_iter().filter(move |_| reads == Reads::Gloss);
    diffuse
        .chain(opacity)
        .chain(gloss)
        .chain(displacement)
        .filter_map(|input| match input {
            Input::Texture(read) => Some(read.as_ref()),
            _ => None,
        })
}

fn key(read: &TextureRead) -> (PathBuf, u8) {
    let color_space = match read.color_space {
        ColorSpace::Auto => 0,
        ColorSpace::Raw => 1,
        ColorSpace::SRgb => 2,
    };
    (read.file.clone(), color_space)
}

impl Textures {
    /// Decode what `materials` read. Files that cannot be decoded are warnings, one for each material.
    pub(super) fn load<'m>(
        materials: impl Iterator<Item = &'m Material> + Clone,
        wanted: Reads,
        diagnostics: &Diagnostics,
    ) -> Self {
        let mut by_file = HashMap::new();
        let mut files: Vec<&TextureRead> = Vec::new();
        for read in materials
            .clone()
            .flat_map(|material| reads(material, wanted))
        {
            by_file.entry(key(read)).or_insert_with(|| {
                files.push(read);
                files.len() - 1
            });
        }
        let phase = diagnostics.phase("textures", "files", files.len() as u64);
        let load = |read: &&TextureRead| {
            let texture = Texture::load(&read.file, read.color_space);
            phase.advance(1);
            texture
        };
        let loaded: Vec<Result<Texture, Error>> = files.par_iter().map(load).collect();
        for material in materials {
            for read in reads(material, wanted) {
                warn(material, read, &loaded[by_file[&key(read)]], diagnostics);
            }
        }
        Self {
            loaded: loaded.into_iter().map(Result::ok).collect(),
            by_file,
        }
    }

    /// The texture that `read` reads, if it could be decoded.
    pub(super) fn find(&self, read: &TextureRead) -> Option<TextureId> {
        let index = *self.by_file.get(&key(read))?;
        self.loaded[index].as_ref().map(|_| TextureId(index))
    }

    /// Files of the textures that were decoded.
    pub(super) fn files(&self) -> impl Iterator<Item = &Path> {
        let files = self.by_file.iter();
        files.filter_map(|((file, _), &index)| self.loaded[index].as_ref().map(|_| file.as_path()))
    }

    /// A texture that was found.
    pub(super) fn get(&self, id: TextureId) -> &Texture {
        self.loaded[id.0]
            .as_ref()
            .expect("ids are given to decoded textures only")
    }
}

fn warn(
    material: &Material,
    read: &TextureRead,
    loaded: &Result<Texture, Error>,
    diagnostics: &Diagnostics,
) {
    let file = |path: &Path| path.display().to_string();
    match loaded {
        Ok(texture) if texture.repaired() > 0 => diagnostics.warn(
            "invalid-texture",
            &material.path,
            format!(
                "{} has {} samples that are not finite: they count as 0",
                file(&read.file),
                texture.repaired()
            ),
        ),
        Ok(_) => {}
        Err(error) => {
            let cause = std::error::Error::source(error)
                .map_or(String::new(), |cause| format!(" ({cause})"));
            let message = format!(
                "{error}{cause}: texture {} gives its fallback {}",
                read.shader, read.fallback
            );
            diagnostics.warn("missing-texture", &material.path, message);
        }
    }
}
