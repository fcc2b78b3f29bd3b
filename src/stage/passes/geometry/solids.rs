//! What an implicit gprim says of its shape, and into how many facets that is cut.

use super::super::super::raw::RawPrim;
use super::attributes::{number, token};
use glam::{DMat3, DVec3};
use std::f64::consts::PI;

/// A round shape is cut so that no point of a facet is further from it than this part of the scene's diagonal …
pub(super) const SCENE_ERROR: f64 = 1e-4;
/// … but at least, and at most, this part of its own radius: finer would not show even when it fills the image, coarser
/// would show in the outline of small ones.
const RADIUS_ERROR: (f64, f64) = (1e-3, 1e-2);

/// A shape in object space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Solid {
    /// Half its side.
    Cube(f64),
    Plane {
        width: f64,
        length: f64,
        axis: Axis,
    },
    /// Two radii and the spine between their centers.
    Round {
        bottom: f64,
        top: f64,
        height: f64,
        /// Half spheres beyond the ends of the spine, else flat.
        has_domes: bool,
        axis: Axis,
    },
}

/// `axis`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    fn read(prim: &RawPrim) -> Self {
        match token(prim, "axis", "Z") {
            "X" => Self::X,
            "Y" => Self::Y,
            _ => Self::Z,
        }
    }

    /// Columns: the two directions across and the spine, right-handed.
    pub(super) fn frame(self) -> DMat3 {
        match self {
            Self::X => DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X),
            Self::Y => DMat3::from_cols(DVec3::Z, DVec3::X, DVec3::Y),
            Self::Z => DMat3::IDENTITY,
        }
    }
}

impl Solid {
    /// The shape of `prim` with the schema's fallbacks; `None` for sizes that are negative, not finite or span
    /// nothing, and for other types.
    pub(super) fn read(prim: &RawPrim) -> Option<Self> {
        let axis = Axis::read(prim);
        let size = |name: &str, fallback: f64| {
            let size = number(prim, name, fallback);
            (size >= 0.0 && size.is_finite()).then_some(size)
        };
        let round = |[bottom, top]: [&str; 2], radius: f64, height: f64, has_domes| {
            Some(Self::Round {
                bottom: size(bottom, radius)?,
                top: size(top, radius)?,
                height: size("height", height)?,
                has_domes,
                axis,
            })
        };
        let one_radius = ["radius", "radius"];
        let two_radii = ["radiusBottom", "radiusTop"];
        let solid = match prim.type_name.as_str() {
            "Cube" => Self::Cube(0.5 * size("size", 2.0)?),
            "Plane" => Self::Plane {
                width: size("width", 2.0)?,
                length: size("length", 2.0)?,
                axis,
            },
            "Sphere" => Self::sphere(size("radius", 1.0)?),
            "Capsule" => round(one_radius, 0.5, 1.0, true)?,
            "Capsule_1" => round(two_radii, 0.5, 1.0, true)?,
            "Cylinder" => round(one_radius, 1.0, 2.0, false)?,
            "Cylinder_1" => round(two_radii, 1.0, 2.0, false)?,
            "Cone" => Self::Round {
                bottom: size("radius", 1.0)?,
                top: 0.0,
                height: size("height", 2.0)?,
                has_domes: false,
                axis,
            },
            _ => return None,
        };
        solid.has_surface().then_some(solid)
    }

    fn sphere(radius: f64) -> Self {
        Self::Round {
            bottom: radius,
            top: radius,
            height: 0.0,
            has_domes: true,
            axis: Axis::Z,
        }
    }

    fn has_surface(&self) -> bool {
        match *self {
            Self::Cube(half) => half > 0.0,
            Self::Plane { width, length, .. } => width > 0.0 && length > 0.0,
            Self::Round { bottom, top, .. } => bottom.max(top) > 0.0,
        }
    }

    /// The larger radius; 0 for shapes without.
    pub(super) fn radius(&self) -> f64 {
        match *self {
            Self::Round { bottom, top, .. } => bottom.max(top),
            _ => 0.0,
        }
    }

    /// Half of the box around it (around its center at 0).
    pub(super) fn half_extent(&self) -> DVec3 {
        match *self {
            Self::Cube(half) => DVec3::splat(half),
            Self::Plane {
                width,
                length,
                axis,
            } => match axis {
                Axis::X => DVec3::new(0.0, length, width) * 0.5,
                Axis::Y => DVec3::new(width, 0.0, length) * 0.5,
                Axis::Z => DVec3::new(width, length, 0.0) * 0.5,
            },
            Self::Round {
                height,
                has_domes,
                axis,
                ..
            } => {
                let radius = self.radius();
                let dome = if has_domes { radius } else { 0.0 };
                let spine = 0.5 * height + dome;
                (axis.frame() * DVec3::new(radius, radius, spine)).abs()
            }
        }
    }

    /// Facets around: a multiple of 4 from 32 to 100, or 0 for shapes without a curve. `scale` is how much larger its
    /// largest occurrence is in the world, `diagonal` that of the scene.
    pub(super) fn facets(&self, scale: f64, diagonal: f64) -> usize {
        let radius = self.radius();
        if radius == 0.0 {
            return 0;
        }
        let (finest, coarsest) = RADIUS_ERROR;
        // max before min: a scale of 0 or NaN gives bounds, not NaN.
        let error = (SCENE_ERROR * diagonal / (radius * scale))
            .max(finest)
            .min(coarsest);
        // With n facets around and n / 2 from pole to pole the middle of one lies 2 (1 − cos(π / n)) radii deep.
        let count = PI / (1.0 - 0.5 * error).acos();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "between 8 and 25"
        )]
        let quarter = (0.25 * count).ceil() as usize;
        4 * quarter
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::raw::Value;
    use super::super::tests::{prim, with_attribute, with_token};
    use super::*;

    #[test]
    fn facets_follow_the_size_in_the_scene_within_bounds() {
        let sphere = Solid::sphere(2.0);
        // 1 − cos(π/n) by hand: 100 facets are 0.99e-3 deep, 32 are 0.96e-2.
        for (scale, diagonal, expected) in [
            (1.0, 1.0, 100),
            (1.0, 20.0, 100),
            (1.0, 1e6, 32),
            (1e-3, 4.0, 32),
            (0.5, 40.0, 52),
            (0.0, 1.0, 32),
            (1.0, 0.0, 100),
        ] {
            let facets = sphere.facets(scale, diagonal);
            assert_eq!(facets, expected, "scale {scale}, diagonal {diagonal}");
        }
        assert_eq!(Solid::Cube(1.0).facets(1.0, 1.0), 0);
    }

    /// `UsdGeomGprim.ComputeExtent` of usd-core gives these boxes.
    #[test]
    fn boxes_are_those_of_the_schemas() {
        let solid = |type_name: &str, axis: &str, sizes: &[(&str, f64)]| {
            let mut made = with_token(prim("/g", type_name, None), "axis", axis);
            for &(name, size) in sizes {
                made = with_attribute(made, name, Value::Float(size), None);
            }
            Solid::read(&made)
        };
        let half = |type_name, axis, sizes| solid(type_name, axis, sizes).unwrap().half_extent();
        assert_eq!(half("Sphere", "X", &[]), DVec3::ONE);
        assert_eq!(half("Cube", "X", &[("size", 3.0)]), DVec3::splat(1.5));
        assert_eq!(half("Capsule", "X", &[]), DVec3::new(1.0, 0.5, 0.5));
        assert_eq!(
            half("Cylinder", "Y", &[("height", 6.0)]),
            DVec3::new(1.0, 3.0, 1.0)
        );
        assert_eq!(
            half("Plane", "Y", &[("length", 6.0)]),
            DVec3::new(1.0, 0.0, 3.0)
        );
        assert_eq!(solid("Sphere", "X", &[("radius", 0.0)]), None);
        assert_eq!(solid("Cone", "X", &[("height", f64::INFINITY)]), None);
        assert_eq!(solid("Mesh", "X", &[]), None);
    }
}
