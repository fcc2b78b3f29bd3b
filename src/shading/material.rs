//! A material with its textures found: evaluates inputs at surface points.

use super::gloss::{Gloss, Lobe};
use super::textures::{TextureId, Textures};
use super::{Surface, SurfacePoint, clamped};
use crate::scene::{Input, Material, Mesh, Prim, TextureRead};
use glam::{Mat2, Vec2, Vec3, Vec4};

/// Cut-outs are decided at this many points along each edge of a footprint.
const CUTOUT_SAMPLES: u8 = 4;

/// Inputs of a material that point-based light needs.
#[derive(Debug)]
pub(super) struct Compiled<'a> {
    diffuse: Source<'a>,
    emission: Source<'a>,
    metallic: Source<'a>,
    opacity: Source<'a>,
    threshold: Source<'a>,
    roughness: Source<'a>,
    ior: Source<'a>,
    specular_color: Source<'a>,
    clearcoat: Source<'a>,
    clearcoat_roughness: Source<'a>,
    specular_workflow: bool,
}

/// Where an input's value comes from.
#[derive(Debug, Clone, Copy)]
pub(super) enum Source<'a> {
    Constant(Vec4),
    Primvar {
        name: &'a str,
        fallback: Vec4,
    },
    Texture {
        id: TextureId,
        read: &'a TextureRead,
    },
}

/// A point, with the mesh and prim it is on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place<'a> {
    pub(super) textures: &'a Textures,
    pub(super) mesh: &'a Mesh,
    pub(super) prim: &'a Prim,
    pub(super) point: &'a SurfacePoint,
}

impl<'a> Compiled<'a> {
    pub(super) fn new(material: &'a Material, textures: &Textures) -> Self {
        let source = |input: &'a Input| Source::new(input, textures);
        Self {
            diffuse: source(&material.diffuse_color),
            emission: source(&material.emissive_color),
            metallic: source(&material.metallic),
            opacity: source(&material.opacity),
            threshold: source(&material.opacity_threshold),
            roughness: source(&material.roughness),
            ior: source(&material.ior),
            specular_color: source(&material.specular_color),
            clearcoat: source(&material.clearcoat),
            clearcoat_roughness: source(&material.clearcoat_roughness),
            specular_workflow: material.specular_workflow,
        }
    }

    /// False if its emission is constantly black.
    pub(super) fn may_emit(&self) -> bool {
        let is_lit = |value: Vec4| value.truncate().max_element() > 0.0;
        match self.emission {
            Source::Constant(value) => is_lit(value),
            Source::Primvar { .. } => true,
            Source::Texture { read, .. } => {
                is_lit(read.scale.abs()) || is_lit(read.bias) || is_lit(read.fallback)
            }
        }
    }

    pub(super) fn surface(
        &self,
        textures: &Textures,
        mesh: &Mesh,
        prim: &Prim,
        point: &SurfacePoint,
    ) -> Surface {
        let place = Place {
            textures,
            mesh,
            prim,
            point,
        };
        let opacity = self.opacity(&place);
        if opacity == 0.0 {
            return Surface {
                albedo: Vec3::ZERO,
                emission: Vec3::ZERO,
                opacity,
            };
        }
        let metallic = match self.specular_workflow {
            true => 0.0,
            false => clamped(self.metallic.at(&place).x),
        };
        let diffuse = self.diffuse.at(&place).truncate();
        let emission = self.emission.at(&place).truncate();
        let radiance = |x: f32| if x.is_finite() { x.max(0.0) } else { 0.0 };
        Surface {
            albedo: Vec3::from_array(diffuse.to_array().map(clamped)) * (1.0 - metallic),
            emission: Vec3::from_array(emission.to_array().map(radiance)),
            opacity,
        }
    }

    /// Lobes as Storm has them: of dielectrics by their index of refraction, of metals in their color up to the edge.
    pub(super) fn gloss(
        &self,
        textures: &Textures,
        mesh: &Mesh,
        prim: &Prim,
        point: &SurfacePoint,
    ) -> Gloss {
        let place = Place {
            textures,
            mesh,
            prim,
            point,
        };
        let number = |source: &Source<'_>| clamped(source.at(&place).x);
        let color = |source: &Source<'_>| {
            Vec3::from_array(source.at(&place).truncate().to_array().map(clamped))
        };
        if self.opacity(&place) == 0.0 {
            return Gloss::NONE;
        }
        let roughness = number(&self.roughness);
        let base = if self.specular_workflow {
            Lobe::of_color(color(&self.specular_color), roughness)
        } else {
            let (metallic, tint) = (number(&self.metallic), color(&self.diffuse));
            let edge = Vec3::ONE.lerp(tint, metallic);
            let f0 = (edge * reflectance(self.ior.at(&place).x)).lerp(edge, metallic);
            Lobe::new(f0, edge, roughness)
        };
        let amount = number(&self.clearcoat);
        let coat_f0 = reflectance(self.ior.at(&place).x) * amount;
        let coat_roughness = number(&self.clearcoat_roughness);
        let coat = Lobe::new(coat_f0, Vec3::splat(amount), coat_roughness);
        Gloss { base, coat }
    }

    fn opacity(&self, place: &Place<'_>) -> f32 {
        let threshold = self.threshold.at(place).x;
        if threshold > 0.0 {
            return self.opacity.coverage(place, threshold);
        }
        clamped(self.opacity.at(place).x)
    }
}

impl<'a> Source<'a> {
    /// Textures that could not be decoded become their fallback.
    pub(super) fn new(input: &'a Input, textures: &Textures) -> Self {
        match input {
            Input::Constant(value) => Self::Constant(*value),
            Input::Primvar { name, fallback } => Self::Primvar {
                name,
                fallback: *fallback,
            },
            Input::Texture(read) => match textures.find(read) {
                Some(id) => Self::Texture { id, read },
                None => Self::Constant(channel(read.fallback, read)),
            },
        }
    }

    /// Its value there.
    pub(super) fn at(&self, place: &Place<'_>) -> Vec4 {
        match *self {
            Self::Constant(value) => value,
            Self::Primvar { name, fallback } => place.primvar(name).unwrap_or(fallback),
            Self::Texture { id, read } => {
                let (st, footprint) = place.texture_square(read);
                place.texture(id, read, st, footprint)
            }
        }
    }

    /// Fraction of the footprint where the value reaches `threshold`. Thresholding the mean instead would make thin
    /// leaves appear or vanish as a whole.
    fn coverage(&self, place: &Place<'_>, threshold: f32) -> f32 {
        let is_opaque = |value: Vec4| f32::from(u8::from(value.x >= threshold));
        let Self::Texture { id, read } = *self else {
            return is_opaque(self.at(place));
        };
        let (st, square) = place.texture_square(read);
        if square == Mat2::ZERO {
            return is_opaque(place.texture(id, read, st, square));
        }
        let count = f32::from(CUTOUT_SAMPLES);
        let offset = |step: u8| (f32::from(step) + 0.5) / count - 0.5;
        let steps = (0..CUTOUT_SAMPLES).flat_map(|y| (0..CUTOUT_SAMPLES).map(move |x| (x, y)));
        let covered: f32 = steps
            .map(|(x, y)| {
                let at = st + square * Vec2::new(offset(x), offset(y));
                is_opaque(place.texture(id, read, at, square * count.recip()))
            })
            .sum();
        covered / (count * count)
    }
}

/// What a surface of this index of refraction reflects straight on; of what is no index, nothing.
pub(super) fn reflectance(ior: f32) -> Vec3 {
    let ratio = (1.0 - ior) / (1.0 + ior);
    Vec3::splat(clamped(ratio * ratio))
}

/// The value that the connected output gives: all of it, or one channel spread over rgb.
fn channel(value: Vec4, read: &TextureRead) -> Vec4 {
    match read.channel {
        Some(channel) => Vec3::splat(value[usize::from(channel.min(3))]).extend(1.0),
        None => value,
    }
}

impl Place<'_> {
    /// A primvar here; single numbers are gray.
    fn primvar(&self, name: &str) -> Option<Vec4> {
        let primvar = self.mesh.primvar(name)?;
        let value = primvar.sample(
            self.mesh,
            self.point.triangle as usize,
            self.point.u,
            self.point.v,
        );
        match primvar.components {
            1 => Some(Vec3::splat(value.x).extend(1.0)),
            _ => Some(value),
        }
    }

    fn texture(&self, id: TextureId, read: &TextureRead, st: Vec2, footprint: Mat2) -> Vec4 {
        let wrap = [read.wrap_s, read.wrap_t];
        let sampled = self.textures.get(id).sample(st, footprint, wrap);
        let value = sampled.map_or(read.fallback, |value| value * read.scale + read.bias);
        channel(value, read)
    }

    /// Texture coordinates of the point, and the edges of its footprint there (columns).
    fn texture_square(&self, read: &TextureRead) -> (Vec2, Mat2) {
        let transform = read.uv.transform;
        let Some(primvar) = self.mesh.primvar(&read.uv.primvar) else {
            return (transform.transform_point2(read.uv.fallback), Mat2::ZERO);
        };
        let triangle = self.point.triangle as usize;
        let uv = |u: f32, v: f32| {
            let value = primvar.sample(self.mesh, triangle, u, v);
            Vec2::new(value.x, value.y)
        };
        let st = transform.transform_point2(uv(self.point.u, self.point.v));
        if self.point.footprint <= 0.0 {
            return (st, Mat2::ZERO);
        }
        let origin = uv(0.0, 0.0);
        let edges = Mat2::from_cols(uv(1.0, 0.0) - origin, uv(0.0, 1.0) - origin);
        let square =
            transform.matrix2 * edges * self.barycentric_per_length() * self.point.footprint;
        (
            st,
            if square.is_finite() {
                square
            } else {
                Mat2::ZERO
            },
        )
    }

    /// How the barycentric weights of corners 1 and 2 change along two perpendicular world directions in the
    /// triangle's plane, per unit length; zero for a triangle without area.
    fn barycentric_per_length(&self) -> Mat2 {
        let [a, b, c] = self.mesh.corners(self.point.triangle as usize);
        let world = |edge: Vec3| self.prim.world_from_object.transform_vector3(edge);
        let (to_b, to_c) = (world(b - a), world(c - a));
        let base = to_b.length();
        let along = to_c.dot(to_b) / base;
        let height = to_b.cross(to_c).length() / base;
        if !(base.is_normal() && height.is_normal()) {
            return Mat2::ZERO;
        }
        // The inverse of the matrix with columns (base, 0) and (along, height).
        Mat2::from_cols(
            Vec2::new(base.recip(), 0.0),
            Vec2::new(-along / base, 1.0) / height,
        )
    }
}
