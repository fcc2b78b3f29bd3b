//! Dome lights as one fixed set of directions: each stands for the part of the sky nearest to it and keeps the first
//! moment of that part's radiance, so that the irradiance of unblocked cells is exact above the horizon.

mod block;
mod place;
mod set;
mod texels;

pub use block::SkyLight;
pub(super) use block::{MOST, light};
pub use set::{EnvironmentCell, EnvironmentSet};

use super::pictures;
use super::stand::Stand;
use crate::diagnostics::Diagnostics;
use crate::image::Latlong;
use crate::math::luminance;
use crate::scene::{Light, LightKind};
use glam::{Mat3, Vec3};
use std::f32::consts::PI;
use texels::Sky;

/// One dome light with a texture.
#[derive(Debug)]
pub(super) struct Dome {
    /// `None` = the same everywhere.
    pub(super) map: Option<Latlong>,
    /// Factor on the map.
    pub(super) radiance: Vec3,
    /// Rotation.
    pub(super) world_from_dome: Mat3,
}

/// All domes of a scene.
#[derive(Debug)]
pub(super) struct Environment {
    domes: Vec<Dome>,
    /// Radiance, if the same in all directions.
    pub(super) uniform: Option<Vec3>,
}

impl Environment {
    /// Read the textures.
    pub(super) fn new<'a>(
        lights: impl Iterator<Item = &'a Light>,
        diagnostics: &Diagnostics,
    ) -> Self {
        let domes: Vec<_> = lights
            .filter_map(|light| dome_of(light, diagnostics))
            .collect();
        let uniform = (domes.iter().all(|dome| dome.map.is_none()))
            .then(|| domes.iter().map(|dome| dome.radiance).sum());
        Self { domes, uniform }
    }

    /// The sky divided into about each of `counts` cells.
    pub(super) fn sets<const N: usize>(&self, counts: [u32; N]) -> [EnvironmentSet; N] {
        let skies = self.skies();
        counts
            .map(|count| EnvironmentSet::new(&skies, count.max(2) as usize, self.uniform.is_some()))
    }

    /// The sky divided into cells about `sites`, unit, and about `importance` more where light concentrates.
    pub(super) fn set_along(&self, sites: &[Vec3], importance: usize) -> EnvironmentSet {
        EnvironmentSet::along(&self.skies(), sites, importance)
    }

    /// One for each map, one for all even domes.
    fn skies(&self) -> Vec<Sky> {
        let mapped = |dome: &Dome| dome.map.as_ref().map(|map| Sky::of(dome, map));
        let mut skies: Vec<Sky> = self.domes.iter().filter_map(mapped).collect();
        let even = |dome: &&Dome| dome.map.is_none();
        if self.domes.iter().any(|dome| even(&dome)) {
            let radiance = self.domes.iter().filter(even).map(|dome| dome.radiance);
            skies.push(Sky::even(radiance.sum()));
        }
        skies
    }

    /// True if some dome shines.
    pub(super) fn is_lit(&self) -> bool {
        !self.domes.is_empty()
    }

    /// Sum of the domes' radiance from unit `direction`.
    pub(super) fn radiance(&self, direction: Vec3) -> Vec3 {
        let from = |dome: &Dome| {
            let local = dome.world_from_dome.transpose() * direction;
            dome.radiance
                * dome
                    .map
                    .as_ref()
                    .map_or(Vec3::ONE, |map| map.radiance(local))
        };
        self.domes.iter().map(from).sum()
    }

    /// Light along unblocked directions, in the cells of `set`.
    pub(super) fn light(&self, set: &EnvironmentSet, stand: &Stand<'_>) -> SkyLight {
        self.corrected(set, stand.point.normal, SkyLight::at(set, stand))
    }

    /// The same at each of `stands`, at most 64, which look along every direction together.
    pub(super) fn block(&self, set: &EnvironmentSet, stands: &[Stand<'_>]) -> Vec<SkyLight> {
        let light = light(set.cells(), stands);
        let corrected =
            |(light, stand): (SkyLight, &Stand<'_>)| self.corrected(set, stand.point.normal, light);
        light.into_iter().zip(stands).map(corrected).collect()
    }

    /// Light by a few looks, within the cells of `set`, which `number` chooses: in the mean over all numbers the truth.
    pub(super) fn glimpse(&self, set: &EnvironmentSet, stand: &Stand<'_>, number: u32) -> Vec3 {
        self.uniform.map_or_else(
            || block::glimpse(set, stand, number),
            |radiance| PI * radiance * block::glimpse_even(stand, number),
        )
    }

    /// Cells across the horizon are approximate, but the sum of an even sky's is known.
    fn corrected(&self, set: &EnvironmentSet, normal: Vec3, mut light: SkyLight) -> SkyLight {
        let Some(radiance) = self.uniform else {
            return light;
        };
        let arrivals = set.cells().iter().filter_map(|cell| cell.arrival(normal));
        let all: Vec3 = arrivals.map(|arrival| arrival.irradiance).sum();
        if luminance(all) > 0.0 {
            light.irradiance = PI * radiance * (luminance(light.irradiance) / luminance(all));
        }
        light
    }
}

/// `None` for other lights and black domes.
fn dome_of(light: &Light, diagnostics: &Diagnostics) -> Option<Dome> {
    let LightKind::Dome { texture } = &light.kind else {
        return None;
    };
    let matrix = Mat3::from(light.world_from_light.matrix3);
    let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(Vec3::normalize_or_zero);
    let world_from_dome = Mat3::from_cols(axes[0], axes[1], axes[2]);
    if !light.radiance.is_finite() || world_from_dome.determinant().abs() < 0.5 {
        let message = "intensity or rotation of the dome light is not valid: it is left out";
        diagnostics.warn("degenerate-light", &light.path, message);
        return None;
    }
    let map = (texture.as_ref()).and_then(|path| pictures::map(path, &light.path, diagnostics));
    let (map, radiance) = match map {
        Some(map) if map.pixels.iter().all(|pixel| *pixel == map.pixels[0]) => {
            (None, light.radiance * map.pixels[0])
        }
        map => (map, light.radiance),
    };
    (radiance != Vec3::ZERO).then_some(Dome {
        map,
        radiance,
        world_from_dome,
    })
}

#[cfg(test)]
mod tests;
