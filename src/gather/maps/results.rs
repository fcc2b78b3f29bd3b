//! The AOVs that maps can compute, and the other engine for what they cannot.

use super::{MapsPlan, MapsSettings, Visibility, Wanted, visibility};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::{self, Engine, GatherScene};
use crate::lighting::Lighting;
use crate::receivers::Receivers;
use crate::results::{Aov, AovBuffer, Results};
use glam::Vec3;
use std::f32::consts::PI;

/// True if maps compute `aov` themselves: what only asks for the sky, and that from a uniform one.
pub fn supports(aov: Aov, lighting: Option<&Lighting>) -> bool {
    match aov {
        aov if aov.is_openness() => true,
        Aov::IrradianceEnvironment => sky(lighting).is_some(),
        _ => false,
    }
}

/// Radiance of the sky if it is uniform.
fn sky(lighting: Option<&Lighting>) -> Option<Vec3> {
    lighting.map_or(Some(Vec3::ZERO), |lighting| {
        if lighting.has_environment() {
            lighting.uniform_environment()
        } else {
            Some(Vec3::ZERO)
        }
    })
}

/// Compute `aovs` at every receiver, one buffer each in the order given: those that maps support by maps, but at
/// ambiguous receivers by `other`; all others by `other`. The same bits for any number of threads.
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
    let (own, rest): (Vec<Aov>, Vec<Aov>) =
        aovs.iter().partition(|&&aov| supports(aov, scene.lighting));
    let mut found = if rest.is_empty() {
        Results::default()
    } else {
        gather::gather(scene, other, receivers, &rest, diagnostics)?
    };
    if !own.is_empty() {
        let wanted = Wanted {
            bent_normal: own.contains(&Aov::BentNormal),
            harmonics: own.contains(&Aov::VisibilitySh),
            ..Wanted::default()
        };
        let seen = visibility(plan, receivers, settings, &wanted, diagnostics)?;
        let mut results = read(&own, &seen, receivers, scene.lighting);
        hand_over(scene, other, (receivers, &seen), &mut results, diagnostics)?;
        found.buffers.append(&mut results.buffers);
    }
    let place = |buffer: &AovBuffer| aovs.iter().position(|&aov| aov == buffer.aov);
    found.buffers.sort_by_key(place);
    Ok(found)
}

/// Gather the ambiguous receivers by `other`, into their places.
fn hand_over(
    scene: GatherScene<'_>,
    other: &dyn Engine,
    (receivers, seen): (&Receivers, &Visibility),
    results: &mut Results,
    diagnostics: &Diagnostics,
) -> Result<(), Cancelled> {
    let picked: Vec<usize> = (0..receivers.len())
        .filter(|&i| seen.ambiguous[i])
        .collect();
    if picked.is_empty() {
        return Ok(());
    }
    let aovs: Vec<Aov> = results.buffers.iter().map(|buffer| buffer.aov).collect();
    let few = receivers.subset(&picked);
    let better = gather::gather(scene, other, &few, &aovs, diagnostics)?;
    for (buffer, better) in results.buffers.iter_mut().zip(&better.buffers) {
        let n = buffer.aov.components();
        for (k, &i) in picked.iter().enumerate() {
            buffer.data[i * n..][..n].copy_from_slice(&better.data[k * n..][..n]);
        }
    }
    Ok(())
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
            Aov::BentNormal => flatten(bent_normals(seen, receivers)),
            Aov::VisibilitySh => seen.harmonics.iter().flat_map(|sh| sh.0).collect(),
            Aov::IrradianceEnvironment => {
                let full = PI * sky(lighting).unwrap_or_default();
                flatten(seen.visibility.iter().map(|&v| full * v))
            }
            _ => seen.visibility.clone(),
        };
        AovBuffer { aov, data }
    };
    Results {
        buffers: aovs.iter().map(buffer).collect(),
    }
}

fn bent_normals<'a>(
    seen: &'a Visibility,
    receivers: &'a Receivers,
) -> impl Iterator<Item = Vec3> + 'a {
    let open = seen.open_direction.iter();
    open.zip(&receivers.normal)
        .map(|(open, &normal)| open.try_normalize().unwrap_or(normal))
}

fn flatten(values: impl Iterator<Item = Vec3>) -> Vec<f32> {
    values.flat_map(|v| v.to_array()).collect()
}
