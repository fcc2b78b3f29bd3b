//! How the environment lights receivers. PBGI §8.2.

use super::Hemisphere;
use super::quantities::{bent_normal, occlusion};
use crate::lighting::{Lighting, ShadePoint, SkyLight};
use crate::results::Aov;
use crate::trace::Tracer;
use glam::Vec3;

/// What is done about it in a run.
#[derive(Clone, Copy)]
pub(super) enum Environment<'a> {
    /// There is none, or nobody asks.
    None,
    /// The same radiance from everywhere: what the hemisphere leaves open is all that matters.
    Uniform(Vec3),
    /// Nobody lights: open directions count alike.
    Unlit,
    /// It has an image: directions of its own, shared by the receivers of a block.
    Sampled(&'a Lighting),
}

impl<'a> Environment<'a> {
    /// For what `aovs` ask, if there is `lighting` that they ask.
    pub(super) fn plan(lighting: Option<&'a Lighting>, aovs: &[Aov]) -> Self {
        match lighting.filter(|lighting| lighting.has_environment()) {
            Some(lighting) => {
                (lighting.uniform_environment()).map_or(Self::Sampled(lighting), Self::Uniform)
            }
            None if aovs.contains(&Aov::IlluminationDirection) => Self::Unlit,
            None => Self::None,
        }
    }

    /// True if it is read off the hemisphere.
    pub(super) fn needs_hemisphere(self) -> bool {
        matches!(self, Self::Uniform(_) | Self::Unlit)
    }

    /// True if [`Self::look`] takes the less time the nearer to each other its points are.
    pub(super) fn looks_together(self) -> bool {
        matches!(self, Self::Sampled(_))
    }

    /// Light at `points`, neighbors, before their hemispheres are seen; empty where these are all it takes. Nothing beyond
    /// `reach` hides it.
    pub(super) fn look(self, tracer: &Tracer, points: &[ShadePoint], reach: f32) -> Vec<SkyLight> {
        match self {
            Self::Sampled(lighting) => lighting.environment_of(tracer, points, reach),
            Self::None | Self::Uniform(_) | Self::Unlit => Vec::new(),
        }
    }

    /// Light at point `index` of those in `look`, which sees `hemisphere`.
    pub(super) fn light(
        self,
        look: &[SkyLight],
        index: usize,
        hemisphere: &Hemisphere,
    ) -> SkyLight {
        match self {
            Self::None => SkyLight::default(),
            Self::Sampled(_) => look[index],
            Self::Unlit => SkyLight {
                irradiance: Vec3::ZERO,
                direction: bent_normal::open_direction(hemisphere),
            },
            Self::Uniform(radiance) => SkyLight {
                irradiance: radiance * occlusion::open(hemisphere),
                direction: bent_normal::open_direction(hemisphere),
            },
        }
    }
}
