//! What is read off a receiver's hemisphere and light: one value an AOV. PBGI §6.2, §8.5, §8.7.
//!
//! The set of AOVs is closed (they are the tool's vocabulary), so this is a match and not a trait: a new variant of
//! [`Aov`] does not compile until [`fn@write`] says which function of which file here computes it.

pub mod bent_normal;
pub mod diffuse;
pub mod error;
pub mod geometry;
pub mod harmonics;
pub mod irradiance;
pub mod occlusion;
pub mod turn;

use super::Hemisphere;
use crate::receivers::Receivers;
use crate::results::Aov;
use crate::shading::Surface;
use glam::Vec3;

/// The material of receivers where no AOV asks for it.
pub const BLACK_SURFACE: Surface = Surface {
    albedo: Vec3::ZERO,
    emission: Vec3::ZERO,
    opacity: 1.0,
};

/// All that is known about one receiver. Parts that no AOV of the run needs are empty or black.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    /// All receivers.
    pub receivers: &'a Receivers,
    /// Which of them this is.
    pub index: usize,
    /// What it sees.
    pub hemisphere: &'a Hemisphere,
    /// Its material.
    pub surface: Surface,
    /// Irradiance from lights and emissive surfaces, radiance·sr.
    pub direct: Vec3,
    /// Irradiance from the environment, radiance·sr.
    pub environment: Vec3,
    /// Mean of the open directions weighted by the environment's irradiance from there; of any length.
    pub illumination: Vec3,
    /// Irradiance from light reflected by surfaces, radiance·sr.
    pub indirect: Vec3,
}

/// Write the value of `aov` to `out`, `aov.components()` floats.
pub fn write(aov: Aov, seen: &Seen<'_>, out: &mut [f32]) {
    match aov {
        Aov::Occlusion | Aov::ReflectionOcclusion => {
            out[0] = occlusion::occlusion(seen.hemisphere);
        }
        Aov::Visibility => out[0] = occlusion::visibility(seen.hemisphere),
        Aov::BentNormal => put(out, bent_normal::bent_normal(seen)),
        Aov::IlluminationDirection => put(out, bent_normal::illumination_direction(seen)),
        Aov::VisibilitySh => out.copy_from_slice(&harmonics::visibility(seen).0),
        Aov::RadianceSh => out.copy_from_slice(harmonics::radiance(seen).as_flattened()),
        Aov::IrradianceDirect => put(out, seen.direct),
        Aov::IrradianceEnvironment => put(out, seen.environment),
        // A lobe's directions carry what it reflects of them: their sum is all of it.
        Aov::IrradianceIndirect | Aov::SpecularIndirect => put(out, seen.indirect),
        Aov::Irradiance => put(out, irradiance::total(seen)),
        Aov::DiffuseDirect => put(out, diffuse::direct(seen)),
        Aov::DiffuseIndirect => put(out, diffuse::indirect(seen)),
        Aov::DiffuseAlbedo => put(out, seen.surface.albedo),
        Aov::Emission => put(out, seen.surface.emission),
        Aov::Color => {
            put(out, diffuse::color(seen));
            out[3] = 1.0;
        }
        Aov::Normal => put(out, geometry::normal(seen)),
        Aov::Position => put(out, geometry::world_position(seen)),
        Aov::Depth => out[0] = geometry::depth(seen),
        Aov::PrimId => out[0] = geometry::prim_id(seen),
        Aov::ErrorOcclusion | Aov::ErrorVisibility => out[0] = error::openness(seen.hemisphere),
        Aov::ErrorIrradianceIndirect => out[0] = error::indirect(seen.hemisphere),
    }
}

fn put(out: &mut [f32], value: Vec3) {
    out[..3].copy_from_slice(&value.to_array());
}

#[cfg(test)]
pub(super) mod testing {
    use super::super::testing::receivers_at;
    use super::*;

    /// A receiver at the origin facing +Y, whose hemisphere has the given (direction, weight, coverage, reflected).
    pub(crate) fn with_seen(rays: &[(Vec3, f32, f32, Vec3)], check: impl FnOnce(&mut Seen<'_>)) {
        let mut hemisphere = Hemisphere::default();
        for &(direction, weight, coverage, reflected) in rays {
            hemisphere.direction.push(direction);
            hemisphere.weight.push(weight);
            hemisphere.coverage.push(coverage);
            hemisphere
                .distance
                .push(if coverage > 0.0 { 1.0 } else { f32::INFINITY });
            hemisphere.reflected.push(reflected);
            hemisphere.emitted.push(Vec3::ZERO);
        }
        let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
        check(&mut Seen {
            receivers: &receivers,
            index: 0,
            hemisphere: &hemisphere,
            surface: BLACK_SURFACE,
            direct: Vec3::ZERO,
            environment: Vec3::ZERO,
            illumination: Vec3::ZERO,
            indirect: irradiance::indirect(&hemisphere),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_aov_fills_all_its_components_with_finite_values() {
        testing::with_seen(&[(Vec3::Y, 3.0, 0.5, Vec3::ONE)], |seen| {
            for &aov in Aov::ALL {
                let mut out = vec![f32::NAN; aov.components()];
                write(aov, seen, &mut out);
                assert!(out.iter().all(|x| x.is_finite()), "{aov}: {out:?}");
            }
        });
    }
}
