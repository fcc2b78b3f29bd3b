//! Textures of UsdPreviewSurface → images, samplers and textures of GLB.
//!
//! | glTF | from |
//! |---|---|
//! | `baseColorTexture` | `diffuseColor`, sRGB; `opacity` in its alpha |
//! | `metallicRoughnessTexture` | `roughness` in green, `metallic` in blue |
//! | `emissiveTexture` | `emissiveColor`, sRGB; `KHR_materials_emissive_strength` above 1 |
//! | `normalTexture` | `normal` |
//!
//! A file goes in as it is where it is a PNG or JPEG whose values mean the same there; else it is written anew, 8 bits a
//! channel, with `scale`, `bias` and color space applied: every channel of the result is a table of codes away from a
//! channel of a file. The transform of coordinates becomes `KHR_texture_transform`.

use crate::image::{self, Codes, Use};
use crate::math::srgb;
use crate::scene::material::TextureRead;
use crate::scene::{ColorSpace, Input, Material, Wrap};
use glam::{Affine2, Vec2};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::Path;

/// Wrapping of glTF.
const REPEAT: u32 = 10497;
const CLAMP_TO_EDGE: u32 = 33071;
const MIRRORED_REPEAT: u32 = 33648;

/// Coordinates that are written whether something reads them or not.
pub(super) const COORDINATES: &str = "st";

/// Sets of coordinates that surfaces of one material have, at most.
pub(super) const SETS: usize = 4;

/// What has been written of images.
#[derive(Default)]
pub(super) struct Textures {
    pub(super) images: Vec<Value>,
    pub(super) samplers: Vec<Value>,
    pub(super) textures: Vec<Value>,
    /// Index of each texture by what it is made of.
    known: HashMap<String, usize>,
    pub(super) has_transforms: bool,
}

/// What to do with one channel of the result.
#[derive(Debug, Clone, Copy)]
enum Channel<'a> {
    Constant(f32),
    Read(&'a TextureRead, usize),
}

/// An image to be made: its channels and what they mean.
struct Recipe<'a> {
    channels: [Channel<'a>; 4],
    /// Red, green and blue are sRGB-encoded.
    used_as: Use,
    /// Value → what is written: times this, plus that.
    scale: f32,
    offset: f32,
}

/// The textures of a material, each with its factors.
#[derive(Default)]
pub(super) struct Maps {
    pub(super) base: Option<Value>,
    pub(super) has_alpha: bool,
    pub(super) metallic_roughness: Option<Value>,
    pub(super) emissive: Option<Value>,
    pub(super) emissive_strength: f32,
    pub(super) normal: Option<Value>,
}

/// Primvars that are `TEXCOORD_0`, `TEXCOORD_1` … of the surfaces of `material`: those that its textures read, in the order
/// of its inputs.
pub(super) fn coordinates_of(material: &Material) -> Vec<&str> {
    let inputs = [
        &material.diffuse_color,
        &material.opacity,
        &material.roughness,
        &material.metallic,
        &material.emissive_color,
    ];
    let reads = inputs.into_iter().filter_map(read_of);
    let mut names = Vec::new();
    for read in reads.chain(material.normal.as_deref()) {
        let name = read.uv.primvar.as_str();
        if !names.contains(&name) && names.len() < SETS {
            names.push(name);
        }
    }
    names
}

/// Texture read by `input`, if it can be had with the coordinates there are.
pub(super) fn read_of(input: &Input) -> Option<&TextureRead> {
    match input {
        Input::Texture(read) => Some(read),
        Input::Constant(_) | Input::Primvar { .. } => None,
    }
}

fn constant(input: &Input) -> f32 {
    match input {
        Input::Constant(value) => value.x,
        Input::Primvar { fallback, .. } => fallback.x,
        Input::Texture(read) => read.fallback.x,
    }
}

impl Textures {
    /// The textures of `material`; each that cannot be written is told to `lost`, by its input and why. `data` takes the
    /// bytes of an image and says which view they are.
    pub(super) fn of_material(
        &mut self,
        material: &Material,
        data: &mut dyn FnMut(&[u8]) -> usize,
        lost: &dyn Fn(&str, String),
    ) -> Maps {
        let mut maps = Maps {
            emissive_strength: 1.0,
            ..Maps::default()
        };
        let sets = coordinates_of(material);
        let mut add = |name: &str, recipe: Recipe<'_>| match self.add(&recipe, &sets, data) {
            Ok(info) => Some(info),
            Err(why) => {
                lost(name, why);
                None
            }
        };
        let color = |read| [0, 1, 2].map(|k| Channel::Read(read, k));
        let (diffuse, opacity) = (read_of(&material.diffuse_color), read_of(&material.opacity));
        if diffuse.is_some() || opacity.is_some() {
            let [r, g, b] = diffuse.map_or([Channel::Constant(1.0); 3], color);
            let alpha = opacity.map_or(Channel::Constant(1.0), channel_of);
            maps.base = add("diffuseColor", Recipe::color([r, g, b, alpha], 1.0));
            maps.has_alpha = maps.base.is_some() && opacity.is_some();
        }
        let (roughness, metallic) = (read_of(&material.roughness), read_of(&material.metallic));
        if roughness.is_some() || metallic.is_some() {
            let one = Channel::Constant(1.0);
            let [green, blue] = [roughness, metallic].map(|read| read.map_or(one, channel_of));
            let recipe = Recipe::data([one, green, blue, one], 1.0, 0.0);
            maps.metallic_roughness = add("roughness and metallic", recipe);
        }
        if let Some(read) = read_of(&material.emissive_color) {
            let peak = (read.scale + read.bias).truncate().max_element().max(1.0);
            let [r, g, b] = color(read);
            let recipe = Recipe::color([r, g, b, Channel::Constant(1.0)], peak.recip());
            maps.emissive = add("emissiveColor", recipe);
            maps.emissive_strength = peak;
        }
        if let Some(read) = &material.normal {
            let [x, y, z] = color(read);
            let recipe = Recipe::data([x, y, z, Channel::Constant(1.0)], 0.5, 0.5);
            maps.normal = add("normal", recipe);
        }
        maps
    }

    /// What a material says to have the image of `recipe`.
    fn add(
        &mut self,
        recipe: &Recipe<'_>,
        sets: &[&str],
        data: &mut dyn FnMut(&[u8]) -> usize,
    ) -> Result<Value, String> {
        let mut reads = recipe.reads();
        let first = reads.next().ok_or("it reads no file")?;
        if let Some(other) = reads.find(|read| read.uv != first.uv) {
            let (a, b) = (first.file.display(), other.file.display());
            return Err(format!("{a} and {b} lie on the surface differently"));
        }
        let name = first.uv.primvar.as_str();
        let set = sets.iter().position(|set| *set == name);
        let set = set.ok_or_else(|| {
            format!("it is placed by primvars:{name}, and {SETS} other primvars are written")
        })?;
        let key = recipe.key();
        let index = match self.known.get(&key) {
            Some(&index) => index,
            None => {
                let index = self.texture(recipe, first, data)?;
                self.known.insert(key, index);
                index
            }
        };
        let mut info = json!({ "index": index });
        if set > 0 {
            info["texCoord"] = json!(set);
        }
        if let Some(transform) = transform(first.uv.transform) {
            self.has_transforms = true;
            info["extensions"] = json!({ "KHR_texture_transform": transform });
        }
        Ok(info)
    }

    fn texture(
        &mut self,
        recipe: &Recipe<'_>,
        first: &TextureRead,
        data: &mut dyn FnMut(&[u8]) -> usize,
    ) -> Result<usize, String> {
        let (bytes, kind) = recipe.encoded()?;
        let stem = first.file.file_stem().unwrap_or_default();
        self.images.push(json!({
            "name": stem.to_string_lossy().trim_end_matches(']'),
            "bufferView": data(&bytes), "mimeType": kind,
        }));
        let wrap = |wrap: Wrap| match wrap {
            Wrap::Repeat => REPEAT,
            Wrap::Mirror => MIRRORED_REPEAT,
            Wrap::Clamp | Wrap::Black => CLAMP_TO_EDGE,
        };
        let sampler = json!({ "wrapS": wrap(first.wrap_s), "wrapT": wrap(first.wrap_t) });
        let known = self.samplers.iter().position(|known| *known == sampler);
        let sampler = known.unwrap_or_else(|| {
            self.samplers.push(sampler);
            self.samplers.len() - 1
        });
        let source = self.images.len() - 1;
        self.textures
            .push(json!({ "source": source, "sampler": sampler }));
        Ok(self.textures.len() - 1)
    }
}

/// The image of `read` among those that were loaded.
fn codes_of<'c>(files: &'c [((&Path, ColorSpace), Codes)], read: &TextureRead) -> &'c Codes {
    let key = (read.file.as_path(), read.color_space);
    let mut files = files.iter();
    let found = files.find(|(known, _)| *known == key);
    &found.expect("every file that is read was loaded").1
}

/// A single number is the first of what it is connected to.
fn channel_of(read: &TextureRead) -> Channel<'_> {
    Channel::Read(read, usize::from(read.channel.unwrap_or(0)))
}

impl<'a> Recipe<'a> {
    fn color(channels: [Channel<'a>; 4], scale: f32) -> Self {
        Self {
            channels,
            used_as: Use::Color,
            scale,
            offset: 0.0,
        }
    }

    fn data(channels: [Channel<'a>; 4], scale: f32, offset: f32) -> Self {
        Self {
            channels,
            used_as: Use::Data,
            scale,
            offset,
        }
    }

    fn reads(&self) -> impl Iterator<Item = &'a TextureRead> + use<'a> {
        let channels = self.channels.into_iter();
        channels.filter_map(|channel| match channel {
            Channel::Read(read, _) => Some(read),
            Channel::Constant(_) => None,
        })
    }

    /// The same for the same texture.
    fn key(&self) -> String {
        let channels = self.channels.map(|channel| match channel {
            Channel::Constant(value) => format!("{value}"),
            Channel::Read(read, k) => format!(
                "{:?} {k} {:?} {:?} {:?} {:?} {:?}",
                read.file, read.color_space, read.scale, read.bias, read.wrap_s, read.wrap_t
            ),
        });
        format!("{channels:?} {:?} {}", self.used_as, self.scale)
    }

    /// The image as PNG or JPEG, and which of them it is.
    fn encoded(&self) -> Result<(Vec<u8>, &'static str), String> {
        let mut files: Vec<((&Path, ColorSpace), Codes)> = Vec::new();
        for read in self.reads() {
            let key = (read.file.as_path(), read.color_space);
            if files.iter().all(|(known, _)| *known != key) {
                let codes = Codes::load(&read.file, read.color_space, self.used_as);
                files.push((key, codes.map_err(|error| error.to_string())?));
            }
        }
        let codes_of = |read: &TextureRead| codes_of(&files, read);
        let tables = [0, 1, 2, 3].map(|k| match self.channels[k] {
            Channel::Constant(value) => [self.code(value, k); 256],
            Channel::Read(read, from) => self.table(k, (read, from), codes_of(read).is_srgb),
        });
        if let Some(as_it_is) = self.as_it_is(&tables, &codes_of) {
            return Ok(as_it_is);
        }
        let sizes = self.reads().map(|read| {
            let codes = codes_of(read);
            (codes.width, codes.height)
        });
        let (width, height) = sizes
            .reduce(|a, b| (a.0.max(b.0), a.1.max(b.1)))
            .unwrap_or((1, 1));
        let mut pixels = vec![[0_u8; 4]; width * height];
        for (k, channel) in self.channels.into_iter().enumerate() {
            match channel {
                Channel::Constant(_) => pixels.iter_mut().for_each(|pixel| pixel[k] = tables[k][0]),
                Channel::Read(read, from) => {
                    let codes = codes_of(read);
                    for (y, row) in pixels.chunks_exact_mut(width).enumerate() {
                        let start = y * codes.height / height * codes.width;
                        for (x, pixel) in row.iter_mut().enumerate() {
                            let code = codes.pixels[start + x * codes.width / width][from];
                            pixel[k] = tables[k][usize::from(code)];
                        }
                    }
                }
            }
        }
        let png = image::png_of_codes((width, height), &pixels);
        png.map(|png| (png, "image/png"))
    }

    /// The only file that is read, if all channels are those of the result already.
    fn as_it_is<'c>(
        &self,
        tables: &[[u8; 256]; 4],
        codes_of: &impl Fn(&TextureRead) -> &'c Codes,
    ) -> Option<(Vec<u8>, &'static str)> {
        let first = self.reads().next()?;
        let same = |k: usize| {
            let is_own = matches!(self.channels[k], Channel::Read(read, from)
                if from == k && read.file == first.file);
            is_own && (0..=u8::MAX).all(|code| tables[k][usize::from(code)] == code)
        };
        let is_free = |k: usize| match self.channels[k] {
            // red says nothing beside roughness and metallic
            Channel::Constant(_) if self.used_as == Use::Data => k == 0 || k == 3,
            Channel::Constant(value) => k == 3 && value == 1.0 && !codes_of(first).has_alpha,
            Channel::Read(..) => false,
        };
        if !(0..4).all(|k| same(k) || is_free(k)) {
            return None;
        }
        let bytes = image::bytes_of(&first.file).ok()?;
        match bytes[..] {
            [0x89, b'P', b'N', b'G', ..] => Some((bytes, "image/png")),
            [0xFF, 0xD8, 0xFF, ..] => Some((bytes, "image/jpeg")),
            _ => None,
        }
    }

    /// What becomes of each code of channel `from` of a file in channel `k` of the result.
    fn table(&self, k: usize, (read, from): (&TextureRead, usize), is_srgb: bool) -> [u8; 256] {
        let mut table = [0; 256];
        let (scale, bias) = (read.scale[from.min(3)], read.bias[from.min(3)]);
        for code in 0..=u8::MAX {
            let stored = f32::from(code) / 255.0;
            let value = match is_srgb && from < 3 {
                true => srgb::to_linear(stored),
                false => stored,
            };
            table[usize::from(code)] = self.code(value * scale + bias, k);
        }
        table
    }

    fn code(&self, value: f32, k: usize) -> u8 {
        match self.used_as {
            Use::Color if k < 3 => srgb::code(value * self.scale),
            // opacity
            Use::Color => srgb::byte(value),
            Use::Data => srgb::byte(value * self.scale + self.offset),
        }
    }
}

/// `KHR_texture_transform` of a `UsdTransform2d`; `None` for the identity. glTF's v points down: with t = 1 − v both ways
/// a turn by an angle stays one by the same angle (`gltf::materials` goes the other way).
fn transform(uv: Affine2) -> Option<Value> {
    if uv == Affine2::IDENTITY {
        return None;
    }
    let (x, y) = (uv.matrix2.x_axis, uv.matrix2.y_axis);
    let rotation = x.y.atan2(x.x);
    let (sin, cos) = rotation.sin_cos();
    let scale = Vec2::new(x.length(), y.dot(Vec2::new(-sin, cos)));
    let offset = Vec2::new(
        uv.translation.x - sin * scale.y,
        1.0 - uv.translation.y - cos * scale.y,
    );
    Some(json!({ "offset": offset.to_array(), "rotation": rotation, "scale": scale.to_array() }))
}

/// Value of a number that a texture stands for, or that is the same everywhere.
pub(super) fn factor(input: &Input, is_mapped: bool) -> f32 {
    match read_of(input).is_some() && is_mapped {
        true => 1.0,
        false => constant(input),
    }
}
