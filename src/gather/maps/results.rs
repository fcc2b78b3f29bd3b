//! The AOVs that maps can compute, and the other engine for what they cannot.

use super::{MapsPlan, MapsSettings, MapsSky, SkyWanted, Visibility, Wanted, visibility};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::{self, Engine, GatherScene};
use crate::lighting::Lighting;
use crate::receivers::Receivers;
use crate::results::{Aov, AovBuffer, Results};
use crate::trace::Tracer;
use glam::Vec3;
use std::f32::consts::PI;

/// True if maps compute `aov` themselves: what only asks for the sky.
pub fn supports(aov: Aov) -> bool {
    aov.is_openness() || asks_environment(aov)
}

fn asks_environment(aov: Aov) -> bool {
    matches!(aov, Aov::IrradianceEnvironment | Aov::IlluminationDirection)
}

/// True if maps need a [`MapsSky`] for `aov`: its environment has an image.
pub fn needs_sky(aov: Aov, lighting: Option<&Lighting>) -> bool {
    asks_environment(aov) && lighting.is_some_and(|light| light.uniform_environment().is_none())
}

/// Compute `aovs` at every receiver, one buffer each in the order given: those that maps support by maps, but at
/// ambiguous receivers by `other`; all others by `other`. Suns and small bright areas of an environment with an image
/// are looked at by rays. The same bits for any number of threads.
///
/// # Errors
/// When cancelled.
pub fn gather(
    scene: GatherScene<'_>,
    (plan, settings): (&MapsPlan<'_>, &MapsSettings),
    other: &dyn Engine,
    (receivers, aovs): (&Receivers, &[Aov]),
    diagnostics: &Diagnostics,
) -> Result<Results, Cancelled> {
    let (own, rest): (Vec<Aov>, Vec<Aov>) = aovs.iter().partition(|&&aov| supports(aov));
    let mut found = if rest.is_empty() {
        Results::default()
    } else {
        gather::gather(scene, other, receivers, &rest, diagnostics)?
    };
    if !own.is_empty() {
        let mut ask =
            |few: &Receivers, aovs: &[Aov]| gather::gather(scene, other, few, aovs, diagnostics);
        let asked = (receivers, &own[..]);
        let mut results = gather_sky(
            (plan, settings),
            scene.lighting,
            asked,
            (&mut ask, &|| scene.tracer),
            diagnostics,
        )?;
        found.buffers.append(&mut results.buffers);
    }
    Ok(found.in_order_of(aovs))
}

/// Another engine: values of some receivers.
pub type Ask<'a> = dyn FnMut(&Receivers, &[Aov]) -> Result<Results, Cancelled> + 'a;

/// As [`gather()`], only `aovs` that maps support. `other` is called at most once, and not at all where no receiver is
/// ambiguous; `tracer` where an environment has bright areas: what they work with need not be made before.
///
/// # Errors
/// When cancelled.
pub fn gather_sky<'t>(
    (plan, settings): (&MapsPlan<'_>, &MapsSettings),
    lighting: Option<&Lighting>,
    (receivers, aovs): (&Receivers, &[Aov]),
    (other, tracer): (&mut Ask<'_>, &dyn Fn() -> &'t Tracer),
    diagnostics: &Diagnostics,
) -> Result<Results, Cancelled> {
    let lit = lighting.filter(|_| aovs.iter().any(|&aov| needs_sky(aov, lighting)));
    let sky = lit.map(|lighting| MapsSky::new(lighting, settings));
    let towards = aovs.contains(&Aov::IlluminationDirection);
    let wanted = Wanted {
        bent_normal: aovs.contains(&Aov::BentNormal) || (towards && sky.is_none()),
        harmonics: aovs.contains(&Aov::VisibilitySh),
        environment: sky.as_ref().map(|sky| SkyWanted {
            sky,
            with_direction: towards,
        }),
    };
    let mut seen = visibility(plan, receivers, settings, &wanted, diagnostics)?;
    let (picked, sure): (Vec<usize>, Vec<usize>) =
        (0..receivers.len()).partition(|&i| seen.ambiguous[i]);
    if let Some(sky) = &sky {
        let few = receivers.subset(&sure);
        let bright = sky.bright_light((plan.scene, tracer()), &few, diagnostics)?;
        for (&i, bright) in sure.iter().zip(bright) {
            seen.environment[i] += bright.irradiance;
            if towards {
                seen.illumination[i] += bright.direction;
            }
        }
    }
    let mut results = read(aovs, &seen, receivers, lighting);
    if picked.is_empty() {
        return Ok(results);
    }
    let better = other(&receivers.subset(&picked), aovs)?;
    for (buffer, better) in results.buffers.iter_mut().zip(&better.buffers) {
        let n = buffer.aov.components();
        for (k, &i) in picked.iter().enumerate() {
            buffer.data[i * n..][..n].copy_from_slice(&better.data[k * n..][..n]);
        }
    }
    Ok(results)
}

fn read(
    aovs: &[Aov],
    seen: &Visibility,
    receivers: &Receivers,
    lighting: Option<&Lighting>,
) -> Results {
    let buffer = |&aov: &Aov| {
        let data = match aov {
            Aov::Occlusion => seen.visibility.iter().map(|v| 1.0 - v).collect(),
            Aov::BentNormal => flatten(unit(&seen.open_direction, receivers)),
            Aov::IlluminationDirection if seen.illumination.is_empty() => {
                flatten(unit(&seen.open_direction, receivers))
            }
            Aov::IlluminationDirection => flatten(unit(&seen.illumination, receivers)),
            Aov::VisibilitySh => seen.harmonics.iter().flat_map(|sh| sh.0).collect(),
            Aov::IrradianceEnvironment if seen.environment.is_empty() => {
                let radiance = lighting.and_then(Lighting::uniform_environment);
                let full = PI * radiance.unwrap_or_default();
                flatten(seen.visibility.iter().map(|&v| full * v))
            }
            Aov::IrradianceEnvironment => flatten(seen.environment.iter().copied()),
            _ => seen.visibility.clone(),
        };
        AovBuffer { aov, data }
    };
    Results {
        buffers: aovs.iter().map(buffer).collect(),
        ..Results::default()
    }
}

/// Each of `directions` at unit length, the normal where there is none.
fn unit<'a>(directions: &'a [Vec3], receivers: &'a Receivers) -> impl Iterator<Item = Vec3> + 'a {
    let pairs = directions.iter().zip(&receivers.normal);
    pairs.map(|(direction, &normal)| direction.try_normalize().unwrap_or(normal))
}

fn flatten(values: impl Iterator<Item = Vec3>) -> Vec<f32> {
    values.flat_map(|v| v.to_array()).collect()
}
