//! Images → files that USD can name: those that are packed are written beside the result.

use super::document::{Document, file_name, resolve};
use super::materials::Looks;
use crate::diagnostics::Diagnostics;
use crate::exchange::{Error, malformed};
use crate::writers::usd::author::{Author, prim_name};
use crate::writers::write_whole;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Images as they are asked for.
pub(super) struct Images<'d> {
    document: &'d Document,
    /// The USD file.
    to: PathBuf,
    /// What the USD file calls each image.
    assets: BTreeMap<usize, Option<String>>,
    /// Files to be written.
    packed: Vec<(PathBuf, Vec<u8>)>,
}

/// Author `looks` and write the images that they read and that are packed in the file; returns the images' files.
pub(super) fn write(
    document: &Document,
    (to, looks): (&Path, Looks),
    author: &mut Author,
    diagnostics: &Diagnostics,
) -> Result<Vec<PathBuf>, Error> {
    let mut images = Images {
        document,
        to: to.to_owned(),
        assets: BTreeMap::new(),
        packed: Vec::new(),
    };
    looks.write(document, author, (&mut images, diagnostics))?;
    let mut written = Vec::new();
    for (path, bytes) in images.packed {
        let unwritable = |source| Error::Unwritable {
            path: path.clone(),
            source,
        };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(unwritable)?;
        }
        write_whole(&path, &bytes).map_err(unwritable)?;
        written.push(path);
    }
    Ok(written)
}

impl Images<'_> {
    /// What the USD file calls the image of `texture`, which is read at `place`; `None`, with a warning, if it has none.
    pub(super) fn asset(
        &mut self,
        texture: &gltf::Texture<'_>,
        (place, diagnostics): (&str, &Diagnostics),
    ) -> Result<Option<String>, Error> {
        let Some(image) = texture.source() else {
            let message = format!(
                "texture {} has no PNG or JPEG image: it is left out",
                texture.index()
            );
            diagnostics.warn("lost", place, message);
            return Ok(None);
        };
        if let Some(asset) = self.assets.get(&image.index()) {
            return Ok(asset.clone());
        }
        let malformed = malformed(&self.document.path);
        let asset = match image.source() {
            gltf::image::Source::Uri { uri, .. } if !uri.starts_with("data:") => {
                let name = file_name(uri).map_err(&malformed)?;
                let file = self.document.folder.join(&name);
                if !file.is_file() {
                    let message = format!("{} is missing", file.display());
                    diagnostics.warn("missing-texture", place, message);
                }
                Some(crate::writers::usd::asset_path(&file, &self.to))
            }
            gltf::image::Source::Uri { uri, .. } => {
                let bytes = resolve(uri, &self.document.folder).map_err(&malformed)?;
                self.pack(&image, bytes, (place, diagnostics))
            }
            gltf::image::Source::View { view, .. } => {
                let bytes = self.document.view(&view).map_err(&malformed)?.to_vec();
                self.pack(&image, bytes, (place, diagnostics))
            }
        };
        self.assets.insert(image.index(), asset.clone());
        Ok(asset)
    }

    /// Keep an image to be written; its bytes say what it is.
    fn pack(
        &mut self,
        image: &gltf::Image<'_>,
        bytes: Vec<u8>,
        (place, diagnostics): (&str, &Diagnostics),
    ) -> Option<String> {
        let ending = match bytes[..] {
            [0x89, b'P', b'N', b'G', ..] => "png",
            [0xFF, 0xD8, 0xFF, ..] => "jpg",
            _ => {
                let message = format!(
                    "image {} is neither PNG nor JPEG: it is left out",
                    image.index()
                );
                diagnostics.warn("lost", place, message);
                return None;
            }
        };
        let stem = self.to.file_stem().unwrap_or_default().to_string_lossy();
        let folder = format!("{stem}_textures");
        let name = image
            .name()
            .map_or(String::new(), |name| format!("_{}", prim_name(name)));
        let file = format!("{}{name}.{ending}", image.index());
        let path = self.to.with_file_name(&folder).join(&file);
        self.packed.push((path, bytes));
        Some(format!("./{folder}/{file}"))
    }
}
