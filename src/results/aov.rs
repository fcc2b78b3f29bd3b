//! The AOVs: names, types, formats.

use crate::math::sh::COEFFICIENT_COUNT;
use std::fmt;
use std::str::FromStr;

/// Type of one AOV value on disk and in USD.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueType {
    /// One float; EXR channel `NAME.Y` (`depth.Z`), USD `float[]`.
    Float,
    /// Linear color; EXR `NAME.R/G/B`, USD `color3f[]`.
    Color,
    /// Color with alpha; EXR bare `R G B A`.
    ColorAlpha,
    /// Unit direction; EXR `NAME.X/Y/Z`, USD `normal3f[]`.
    Normal,
    /// Position; EXR `NAME.X/Y/Z`, USD `point3f[]`.
    Point,
    /// Unsigned id; EXR `NAME.id` (uint), USD `int[]`.
    Id,
    /// 9 coefficients of spherical harmonics ([`crate::math::sh::Sh9`]); on disk 9 results of one float each,
    /// `NAME0` … `NAME8`: EXR channels `NAME0.Y` …, USD `float[]` primvars.
    Harmonics,
    /// The same of a linear color, the three channels of one coefficient after those of the other; on disk 9 colors,
    /// EXR `NAME0.R/G/B` … in `f32` (coefficients may be negative), USD `color3f[]` primvars.
    ColorHarmonics,
}

/// What the coefficients of `visibility_sh` are called on disk.
const VISIBILITY_SH_NAMES: [&str; COEFFICIENT_COUNT] = [
    "visibility_sh0",
    "visibility_sh1",
    "visibility_sh2",
    "visibility_sh3",
    "visibility_sh4",
    "visibility_sh5",
    "visibility_sh6",
    "visibility_sh7",
    "visibility_sh8",
];

/// What the coefficients of `radiance_sh` are called on disk.
const RADIANCE_SH_NAMES: [&str; COEFFICIENT_COUNT] = [
    "radiance_sh0",
    "radiance_sh1",
    "radiance_sh2",
    "radiance_sh3",
    "radiance_sh4",
    "radiance_sh5",
    "radiance_sh6",
    "radiance_sh7",
    "radiance_sh8",
];

macro_rules! aovs {
    ($($(#[doc = $doc:literal])* $variant:ident, $name:literal, $value:ident;)*) => {
        /// A result of a run; the same name on disk, as primvar and on the command line.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Aov { $($(#[doc = $doc])* $variant,)* }

        impl Aov {
            /// All AOVs.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The name used everywhere.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// Type of its values.
            pub fn value_type(self) -> ValueType {
                match self { $(Self::$variant => ValueType::$value,)* }
            }
        }
    };
}

aovs! {
    /// Cosine-weighted fraction of the hemisphere that is covered, 0…1. PBGI §8.5.
    Occlusion, "occlusion", Float;
    /// 1 − occlusion.
    Visibility, "visibility", Float;
    /// Occlusion in a cone about the mirror direction (images) or the normal (bakes), 0…1. PBGI §8.5.
    ReflectionOcclusion, "reflection_occlusion", Float;
    /// Irradiance straight from lights and emissive surfaces, radiance·sr.
    IrradianceDirect, "irradiance_direct", Color;
    /// Irradiance from dome lights, unblocked directions only. PBGI §8.2.
    IrradianceEnvironment, "irradiance_environment", Color;
    /// Irradiance of light of every source after 1…`--bounces` reflections. PBGI §6, §8.3.
    IrradianceIndirect, "irradiance_indirect", Color;
    /// Sum of the three.
    Irradiance, "irradiance", Color;
    /// albedo/π · (direct + environment irradiance): outgoing radiance.
    DiffuseDirect, "diffuse_direct", Color;
    /// albedo/π · indirect irradiance.
    DiffuseIndirect, "diffuse_indirect", Color;
    /// Glossy reflection of surfaces and of the environment towards the eye, outgoing radiance. PBGI §6.2.
    SpecularIndirect, "specular_indirect", Color;
    /// Diffuse albedo.
    DiffuseAlbedo, "diffuse_albedo", Color;
    /// Emitted radiance of the surface itself.
    Emission, "emission", Color;
    /// Beauty: everything that makes light; alpha = coverage.
    Color, "color", ColorAlpha;
    /// Average unoccluded direction, unit. PBGI §8.7.
    BentNormal, "bent_normal", Normal;
    /// Average unoccluded direction weighted by the environment's brightness, unit. PBGI §8.7.
    IlluminationDirection, "illumination_direction", Normal;
    /// Coefficients of the function that is 1 in open directions above the horizon of the shading normal and 0 in all
    /// others, without a cosine, world space. PBGI §8.7.
    VisibilitySh, "visibility_sh", Harmonics;
    /// Coefficients of the radiance that arrives after 1…`--bounces` reflections, from directions above the horizon of
    /// the shading normal (0 from all others), without a cosine, world space: for relighting what stands there or is bent.
    /// PBGI §8.7.
    RadianceSh, "radiance_sh", ColorHarmonics;
    /// Shading normal.
    Normal, "N", Normal;
    /// World position.
    Position, "P", Point;
    /// Distance along the viewing axis, stage units (images only).
    Depth, "depth", Float;
    /// Index of the prim; −1 where there is none.
    PrimId, "primId", Id;
    /// About how wrong `occlusion` is at this receiver, absolute.
    ErrorOcclusion, "error_occlusion", Float;
    /// About how wrong `visibility` is at this receiver, absolute.
    ErrorVisibility, "error_visibility", Float;
    /// About how wrong `irradiance_indirect` is at this receiver, rms over its channels, radiance·sr.
    ErrorIrradianceIndirect, "error_irradiance_indirect", Float;
}

impl Aov {
    /// Floats a value: 1, 3, 4, 9 or 27.
    pub fn components(self) -> usize {
        match self.value_type() {
            ValueType::Float | ValueType::Id => 1,
            ValueType::Color | ValueType::Normal | ValueType::Point => 3,
            ValueType::ColorAlpha => 4,
            ValueType::Harmonics => COEFFICIENT_COUNT,
            ValueType::ColorHarmonics => 3 * COEFFICIENT_COUNT,
        }
    }

    /// The names on disk of the parts of a value that are results of their own, in order and of equal length:
    /// `visibility_sh0` …; empty for all others, which are one.
    pub fn part_names(self) -> &'static [&'static str] {
        match self {
            Self::VisibilitySh => &VISIBILITY_SH_NAMES,
            Self::RadianceSh => &RADIANCE_SH_NAMES,
            _ => &[],
        }
    }

    /// Type of each part of a value that has parts, and of the value of those that have none.
    pub fn part_type(self) -> ValueType {
        match self.value_type() {
            ValueType::Harmonics => ValueType::Float,
            ValueType::ColorHarmonics => ValueType::Color,
            whole => whole,
        }
    }

    /// Floats of a part: 1, 3 or 4.
    pub fn part_components(self) -> usize {
        self.components() / self.part_names().len().max(1)
    }

    /// True if computing it needs direct light at the receivers.
    pub fn needs_direct(self) -> bool {
        matches!(
            self,
            Self::IrradianceDirect | Self::Irradiance | Self::DiffuseDirect | Self::Color
        )
    }

    /// True if computing it needs the environment's light at the receivers.
    pub fn needs_environment(self) -> bool {
        matches!(
            self,
            Self::IrradianceEnvironment
                | Self::Irradiance
                | Self::DiffuseDirect
                | Self::Color
                | Self::IlluminationDirection
        )
    }

    /// True if it tells which directions of the hemisphere are open and nothing of light.
    pub fn is_openness(self) -> bool {
        matches!(
            self,
            Self::Occlusion | Self::Visibility | Self::BentNormal | Self::VisibilitySh
        )
    }

    /// True if computing it needs surfels with radiosity.
    pub fn needs_indirect(self) -> bool {
        matches!(
            self,
            Self::IrradianceIndirect
                | Self::Irradiance
                | Self::DiffuseIndirect
                | Self::SpecularIndirect
                | Self::Color
                | Self::RadianceSh
                | Self::ErrorIrradianceIndirect
        )
    }

    /// True if it is the sum of what each light makes of it (but for the alpha of `color`).
    pub fn adds_up(self) -> bool {
        matches!(
            self,
            Self::IrradianceDirect
                | Self::IrradianceEnvironment
                | Self::IrradianceIndirect
                | Self::Irradiance
                | Self::DiffuseDirect
                | Self::DiffuseIndirect
                | Self::SpecularIndirect
                | Self::Emission
                | Self::Color
                | Self::RadianceSh
        )
    }

    /// The AOV whose error this is, if it is one.
    pub fn error_of(self) -> Option<Self> {
        match self {
            Self::ErrorOcclusion => Some(Self::Occlusion),
            Self::ErrorVisibility => Some(Self::Visibility),
            Self::ErrorIrradianceIndirect => Some(Self::IrradianceIndirect),
            _ => None,
        }
    }

    /// True if it needs what reflects glossily at the receiver, and from where that is looked at.
    pub fn needs_gloss(self) -> bool {
        self == Self::SpecularIndirect
    }

    /// True if it needs the hemisphere above the receiver at all.
    pub fn needs_hemisphere(self) -> bool {
        self.is_openness()
            || self == Self::ReflectionOcclusion
            || self.error_of().is_some()
            || self.needs_direct()
            || self.needs_environment()
            || self.needs_indirect()
    }

    /// True if it needs the receiver's material (albedo or emission).
    pub fn needs_material(self) -> bool {
        matches!(
            self,
            Self::DiffuseDirect
                | Self::DiffuseIndirect
                | Self::DiffuseAlbedo
                | Self::Emission
                | Self::Color
        ) || self.needs_gloss()
    }
}

impl fmt::Display for Aov {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// No AOV has this name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no AOV is called {name:?}; there are: {known}")]
pub struct UnknownAov {
    name: String,
    known: String,
}

impl FromStr for Aov {
    type Err = UnknownAov;

    fn from_str(name: &str) -> Result<Self, UnknownAov> {
        Self::ALL
            .iter()
            .copied()
            .find(|aov| aov.name() == name)
            .ok_or_else(|| UnknownAov {
                name: name.to_owned(),
                known: Self::ALL
                    .iter()
                    .map(|aov| aov.name())
                    .collect::<Vec<_>>()
                    .join(" "),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for aov in Aov::ALL {
            assert_eq!(aov.name().parse::<Aov>().unwrap(), *aov);
        }
        assert!("Occlusion".parse::<Aov>().is_err());
    }

    #[test]
    fn exactly_the_coefficients_of_harmonics_are_parts() {
        for &aov in Aov::ALL {
            let (parts, floats) = match aov.value_type() {
                ValueType::Harmonics => (9, 1),
                ValueType::ColorHarmonics => (9, 3),
                _ => (0, aov.components()),
            };
            assert_eq!(aov.part_names().len(), parts, "{aov}");
            assert_eq!(aov.part_components(), floats, "{aov}");
            for (k, name) in aov.part_names().iter().enumerate() {
                assert_eq!(*name, format!("{aov}{k}"));
            }
        }
    }
}
