//! What rays need to know of surfaces that let light through: opacity at every point of them.
//!
//! Values of primvars and texture coordinates are linear on a triangle, so those at its corners are kept, apart from the
//! scene. Prims that nothing passes through have none: those of materials whose opacity is 1 everywhere, also where a texture
//! says so.

use super::clamped;
use super::textures::{TextureId, Textures};
use crate::image::{Image, Texture};
use crate::scene::{
    Input, Material, Mesh, MeshId, Prim, PrimId, Primvar, Scene, TextureRead, Wrap,
};
use crate::trace::Opacity;
use glam::{Mat2, Vec2, Vec4};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

/// Opacity of all prims that something passes through.
#[derive(Debug)]
pub(super) struct Screens {
    /// By prim: index into `covers`; `None` for those that nothing passes through.
    of_prim: Vec<Option<usize>>,
    /// One for each mesh with the materials that some prim of it has: by triangle.
    covers: Vec<Vec<Cover>>,
    reads: Vec<Read>,
    textures: Arc<Textures>,
}

/// What a triangle stops.
#[derive(Debug, Clone, Copy)]
struct Cover {
    opacity: Values,
    /// Above 0: opacity below it is 0, the rest 1.
    threshold: Values,
}

/// A number on a triangle.
#[derive(Debug, Clone, Copy)]
enum Values {
    /// At its corners.
    Linear([f32; 3]),
    /// Index into `Screens::reads`, and texture coordinates of its corners.
    Texture(u32, [Vec2; 3]),
}

/// What is read of a texture.
#[derive(Debug)]
struct Read {
    texture: TextureId,
    wrap: [Wrap; 2],
    scale: f32,
    bias: f32,
    fallback: f32,
    channel: usize,
    /// No value that it gives is below this.
    least: f32,
}

const OPAQUE: Cover = Cover {
    opacity: Values::Linear([1.0; 3]),
    threshold: Values::Linear([0.0; 3]),
};

/// False if a surface of `material` is opaque whatever its primvars and images hold.
pub fn may_be_screen(material: &Material) -> bool {
    !matches!(material.opacity, Input::Constant(value) if value.x >= 1.0)
}

impl Screens {
    /// `None` where nothing passes through anything.
    pub(super) fn of(scene: &Scene, textures: &Arc<Textures>) -> Option<Self> {
        let mut made = Self {
            of_prim: Vec::with_capacity(scene.prims.len()),
            covers: Vec::new(),
            reads: Vec::new(),
            textures: Arc::clone(textures),
        };
        let mut known = Vec::new();
        let mut by_mesh: HashMap<MeshId, Vec<usize>> = HashMap::new();
        let mut reads = HashMap::new();
        let may_pass: Vec<bool> = scene.materials.iter().map(may_be_screen).collect();
        for prim in &scene.prims {
            let candidates = by_mesh.entry(prim.mesh).or_default();
            let same = candidates.iter().find(|&&i| {
                let (other, _): &(&Prim, Option<usize>) = &known[i];
                other.materials == prim.materials
            });
            let index = match same {
                Some(&i) => known[i].1,
                None => {
                    let index = made.add((scene, &may_pass), prim, &mut reads);
                    candidates.push(known.len());
                    known.push((prim, index));
                    index
                }
            };
            made.of_prim.push(index);
        }
        (!made.covers.is_empty()).then_some(made)
    }

    /// Index of what `prim` stops, if anything passes through it.
    fn add(
        &mut self,
        (scene, of_material): (&Scene, &[bool]),
        prim: &Prim,
        reads: &mut HashMap<*const TextureRead, u32>,
    ) -> Option<usize> {
        let mesh = scene.mesh_of(prim);
        let is_plain = mesh.primvar("displayOpacity").is_none();
        let material = |face: u32| prim.materials.of_face(face);
        let may_pass = |&face: &u32| match material(face) {
            Some(id) => of_material[id.index()],
            None => !is_plain,
        };
        if !mesh.triangle_faces.iter().any(may_pass) {
            return None;
        }
        let covers: Vec<Cover> = (0..mesh.triangles.len())
            .map(|t| match material(mesh.triangle_faces[t]) {
                Some(id) if of_material[id.index()] => {
                    let material = &scene.materials[id.index()];
                    Cover {
                        opacity: self.values(&material.opacity, (mesh, t), reads),
                        threshold: self.values(&material.opacity_threshold, (mesh, t), reads),
                    }
                }
                None if !is_plain => Cover {
                    opacity: Values::Linear(numbers(mesh, t, "displayOpacity", 1.0)),
                    ..OPAQUE
                },
                _ => OPAQUE,
            })
            .collect();
        if covers.iter().all(|cover| self.is_opaque(cover)) {
            return None;
        }
        self.covers.push(covers);
        Some(self.covers.len() - 1)
    }

    fn values(
        &mut self,
        input: &Input,
        (mesh, t): (&Mesh, usize),
        reads: &mut HashMap<*const TextureRead, u32>,
    ) -> Values {
        match input {
            Input::Constant(value) => Values::Linear([value.x; 3]),
            Input::Primvar { name, fallback } => Values::Linear(numbers(mesh, t, name, fallback.x)),
            Input::Texture(read) => match self.textures.find(read) {
                None => Values::Linear([read.fallback[channel(read)]; 3]),
                Some(texture) => {
                    let index = *reads.entry(std::ptr::from_ref(&**read)).or_insert_with(|| {
                        let image = self.textures.get(texture);
                        self.reads.push(Read::new(read, (texture, image)));
                        u32::try_from(self.reads.len() - 1).expect("fewer reads than materials")
                    });
                    Values::Texture(index, places(mesh, t, read))
                }
            },
        }
    }

    /// True if nothing passes through it anywhere.
    fn is_opaque(&self, cover: &Cover) -> bool {
        let Values::Linear(thresholds) = cover.threshold else {
            return false;
        };
        let least = match cover.opacity {
            Values::Linear([a, b, c]) => a.min(b).min(c),
            Values::Texture(read, places) => {
                let read = &self.reads[read as usize];
                let is_inside = |st: &Vec2| st.cmpge(Vec2::ZERO).all() && st.cmple(Vec2::ONE).all();
                let has_edge = read.wrap.contains(&Wrap::Black);
                match has_edge && !places.iter().all(is_inside) {
                    true => f32::NEG_INFINITY,
                    false => read.least,
                }
            }
        };
        let [low, high] = [f32::min, f32::max].map(|f| thresholds.into_iter().reduce(f));
        match (low, high) {
            (Some(low), Some(high)) if low > 0.0 => least >= high,
            (_, Some(high)) if high <= 0.0 => least >= 1.0,
            _ => false,
        }
    }

    fn value(&self, values: &Values, (u, v): (f32, f32)) -> f32 {
        match values {
            Values::Linear([a, b, c]) => a * (1.0 - u - v) + b * u + c * v,
            Values::Texture(read, [a, b, c]) => {
                let read = &self.reads[*read as usize];
                let st = *a * (1.0 - u - v) + *b * u + *c * v;
                let found = (self.textures.get(read.texture)).sample(st, Mat2::ZERO, read.wrap);
                found.map_or(read.fallback, |value| {
                    value[read.channel] * read.scale + read.bias
                })
            }
        }
    }
}

impl Opacity for Screens {
    fn is_screen(&self, prim: PrimId) -> bool {
        self.of_prim[prim.index()].is_some()
    }

    fn at(&self, prim: PrimId, triangle: u32, u: f32, v: f32) -> f32 {
        let Some(index) = self.of_prim[prim.index()] else {
            return 1.0;
        };
        let cover = &self.covers[index][triangle as usize];
        let opacity = self.value(&cover.opacity, (u, v));
        let threshold = self.value(&cover.threshold, (u, v));
        if threshold > 0.0 {
            return f32::from(u8::from(opacity >= threshold));
        }
        clamped(opacity)
    }
}

impl Read {
    fn new(read: &TextureRead, (texture, image): (TextureId, &Texture)) -> Self {
        let channel = channel(read);
        let (scale, bias) = (read.scale[channel], read.bias[channel]);
        let lows = image.images().map(|image| least_of(image, channel, scale));
        let least = lows.fold(f32::INFINITY, f32::min) * scale + bias;
        Self {
            texture,
            wrap: [read.wrap_s, read.wrap_t],
            scale,
            bias,
            fallback: read.fallback[channel],
            channel,
            least: least.min(if image.is_udim() {
                read.fallback[channel]
            } else {
                least
            }),
        }
    }
}

/// The texel value of `image` that a factor of `scale` makes the least of.
fn least_of(image: &Image, channel: usize, scale: f32) -> f32 {
    let sign = if scale < 0.0 { -1.0 } else { 1.0 };
    let row = |y: usize| {
        let values = (0..image.width()).map(|x| sign * image.pixel(x, y)[channel]);
        values.fold(f32::INFINITY, f32::min)
    };
    let least = (0..image.height()).into_par_iter().map(row);
    sign * least.reduce(|| f32::INFINITY, f32::min)
}

/// Where a scalar is taken from.
fn channel(read: &TextureRead) -> usize {
    usize::from(read.channel.unwrap_or(0).min(3))
}

/// Values of primvar `name`, or `fallback`, at the corners of triangle `t`.
fn numbers(mesh: &Mesh, t: usize, name: &str, fallback: f32) -> [f32; 3] {
    mesh.primvar(name).map_or([fallback; 3], |primvar| {
        corners(primvar, mesh, t).map(|value| value.x)
    })
}

/// Texture coordinates at the corners of triangle `t`.
fn places(mesh: &Mesh, t: usize, read: &TextureRead) -> [Vec2; 3] {
    let transform = read.uv.transform;
    let st = match mesh.primvar(&read.uv.primvar) {
        Some(primvar) => corners(primvar, mesh, t).map(|value| Vec2::new(value.x, value.y)),
        None => [read.uv.fallback; 3],
    };
    st.map(|st| transform.transform_point2(st))
}

fn corners(primvar: &Primvar, mesh: &Mesh, t: usize) -> [Vec4; 3] {
    [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|(u, v)| primvar.sample(mesh, t, u, v))
}
