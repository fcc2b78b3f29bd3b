//! How a material reads a texture.

use glam::{Vec2, Vec4};
use serde_json::Value;

/// A texture with how it is read.
pub(super) struct Read<'a> {
    pub(super) texture: gltf::Texture<'a>,
    pub(super) set: u32,
    pub(super) transform: Transform,
    pub(super) is_color: bool,
    pub(super) scale: Vec4,
    pub(super) bias: Vec4,
}

/// `KHR_texture_transform`, as glTF has it: v downwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Transform {
    offset: Vec2,
    rotation: f32,
    scale: Vec2,
}

impl Transform {
    pub(super) const NONE: Self = Self {
        offset: Vec2::ZERO,
        rotation: 0.0,
        scale: Vec2::ONE,
    };

    /// Scale, rotation (degrees) and translation of a `UsdTransform2d`, whose v points up: with t = 1 − v both ways,
    /// u' = cos su u + sin sv v + ou and v' = −sin su u + cos sv v + ov become a turn by the same angle.
    pub(super) fn upright(&self) -> (Vec2, f32, Vec2) {
        let (sin, cos) = self.rotation.sin_cos();
        let translation = Vec2::new(
            self.offset.x + sin * self.scale.y,
            1.0 - self.offset.y - cos * self.scale.y,
        );
        (self.scale, self.rotation.to_degrees(), translation)
    }

    /// From the extension's JSON, for textures that the crate does not tell of.
    fn of_json(value: &Value) -> (Self, Option<u32>) {
        let number = |value: &Value| value.as_f64().map(single);
        let pair = |key: &str, default: Vec2| {
            let list = value.get(key).and_then(Value::as_array);
            let pair = list.and_then(|l| Some(Vec2::new(number(l.first()?)?, number(l.get(1)?)?)));
            pair.unwrap_or(default)
        };
        let set = value.get("texCoord").and_then(Value::as_u64);
        let transform = Self {
            offset: pair("offset", Vec2::ZERO),
            rotation: value.get("rotation").and_then(number).unwrap_or(0.0),
            scale: pair("scale", Vec2::ONE),
        };
        (transform, set.and_then(|set| u32::try_from(set).ok()))
    }
}

impl<'a> Read<'a> {
    pub(super) fn new(
        texture: gltf::Texture<'a>,
        set: u32,
        extension: Option<&Value>,
        (scale, bias): (Vec4, Vec4),
    ) -> Self {
        let (transform, other) = extension.map_or((Transform::NONE, None), Transform::of_json);
        Self {
            texture,
            set: other.unwrap_or(set),
            transform,
            is_color: false,
            scale,
            bias,
        }
    }

    /// A texture of numbers times `factor`.
    pub(super) fn of(info: &gltf::texture::Info<'a>, factor: Vec4) -> Self {
        let mut read = Self::new(info.texture(), info.tex_coord(), None, (factor, Vec4::ZERO));
        if let Some(transform) = info.texture_transform() {
            read.transform = Transform {
                offset: Vec2::from_array(transform.offset()),
                rotation: transform.rotation(),
                scale: Vec2::from_array(transform.scale()),
            };
            read.set = transform.tex_coord().unwrap_or(read.set);
        }
        read
    }

    /// It holds colors, painted sRGB.
    pub(super) fn color(mut self) -> Self {
        self.is_color = true;
        self
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "materials are single precision"
)]
pub(super) fn single(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transform_upright_moves_points_as_one_upside_down() {
        let transform = Transform {
            offset: Vec2::new(0.3, -0.2),
            rotation: 0.7,
            scale: Vec2::new(2.0, 0.5),
        };
        let (sin, cos) = transform.rotation.sin_cos();
        let (scale, degrees, translation) = transform.upright();
        let turn = glam::Mat2::from_angle(degrees.to_radians());
        for uv in [Vec2::ZERO, Vec2::new(0.25, 0.75), Vec2::new(1.0, -3.0)] {
            let scaled = uv * transform.scale;
            let moved = Vec2::new(
                cos * scaled.x + sin * scaled.y,
                cos * scaled.y - sin * scaled.x,
            );
            let moved = moved + transform.offset;
            let upright = turn * (Vec2::new(uv.x, 1.0 - uv.y) * scale) + translation;
            assert!((Vec2::new(upright.x, 1.0 - upright.y) - moved).length() < 1e-5);
        }
    }
}
