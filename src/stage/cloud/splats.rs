//! Gaussian splats of one layer.

use super::file::{Column as Values, File};
use crate::diagnostics::Diagnostics;
use crate::scene::StageInfo;
use crate::surfels::splats::Splats;
use glam::{DMat4, Quat, Vec3};
use openusd::sdf::{Path as SdfPath, Value};

const TYPE: &str = "ParticleField3DGaussianSplat";

/// The first `ParticleField3DGaussianSplat` of `file`, in its own space, if it has one; others, and a transform, are lost
/// with a warning. The error tells of arrays of wrong type or length, and of values that are not finite.
pub(super) fn read(
    file: &File,
    diagnostics: &Diagnostics,
) -> Result<Option<(Splats, StageInfo)>, String> {
    let prims = file.prims_of_type(TYPE);
    let Some(prim) = prims.first() else {
        return Ok(None);
    };
    for other in &prims[1..] {
        let message = "one field of splats is written: this one is left out";
        diagnostics.warn("lost", other.to_string(), message);
    }
    if super::placement::world_from_prim(file, prim)? != DMat4::IDENTITY {
        let message = "splats are written in their own space: its transform is left out";
        diagnostics.warn("lost", prim.to_string(), message);
    }
    let about = super::points::stage_info(file);
    Ok(Some((splats(file, prim)?, about)))
}

fn splats(file: &File, prim: &SdfPath) -> Result<Splats, String> {
    let wrong = |name: &str| format!("{prim}.{name} should have one value a splat");
    let vectors = |name: &str| -> Result<Option<Vec<Vec3>>, String> {
        for name in [name.to_owned(), format!("{name}h")] {
            match file.column(prim, &name)? {
                Some(Values::Vectors(values)) => return Ok(Some(values)),
                Some(_) => return Err(wrong(&name)),
                None => {}
            }
        }
        Ok(None)
    };
    let position = vectors("positions")?.unwrap_or_default();
    let count = position.len();
    let scale = vectors("scales")?.unwrap_or_else(|| vec![Vec3::ONE; count]);
    let floats = |name: &str| file.column(prim, name);
    let opacity = match floats("opacities")?.or(floats("opacitiesh")?) {
        Some(Values::Floats(values)) => values,
        Some(_) => return Err(wrong("opacities")),
        None => vec![1.0; count],
    };
    let degree = match file.value(prim, "radiance:sphericalHarmonicsDegree")? {
        Some(Value::Int(degree)) => usize::try_from(degree).unwrap_or(usize::MAX),
        _ => Splats::MOST_DEGREE,
    };
    if degree > Splats::MOST_DEGREE {
        return Err(format!(
            "{prim}.radiance:sphericalHarmonicsDegree is not 0 to {}",
            Splats::MOST_DEGREE
        ));
    }
    let width = (degree + 1).pow(2);
    let coefficients = vectors("radiance:sphericalHarmonicsCoefficients")?;
    let splats = Splats {
        orientation: orientations(file, prim, count)?,
        coefficients: coefficients.unwrap_or_else(|| vec![Vec3::ZERO; count * width]),
        position,
        scale,
        opacity,
        degree,
    };
    let lengths = [
        ("scales", splats.scale.len(), count),
        ("opacities", splats.opacity.len(), count),
        ("orientations", splats.orientation.len(), count),
        (
            "radiance:sphericalHarmonicsCoefficients",
            splats.coefficients.len(),
            count * width,
        ),
    ];
    match lengths
        .into_iter()
        .find(|(_, length, right)| length != right)
    {
        Some((name, length, right)) => Err(format!(
            "{prim}.{name} has {length} values where {right} are needed"
        )),
        None => Ok(splats),
    }
}

fn orientations(file: &File, prim: &SdfPath, count: usize) -> Result<Vec<Quat>, String> {
    let value = match file.value(prim, "orientations")? {
        None => file.value(prim, "orientationsh")?,
        value => value,
    };
    let turns: Vec<Quat> = match value {
        Some(Value::QuatfVec(values)) => values
            .iter()
            .map(|q| Quat::from_xyzw(q.x, q.y, q.z, q.w))
            .collect(),
        Some(Value::QuathVec(values)) => {
            let turn = |q: &openusd::gf::Quath| [q.x, q.y, q.z, q.w].map(f32::from);
            values.iter().map(|q| Quat::from_array(turn(q))).collect()
        }
        Some(_) => {
            return Err(format!(
                "{prim}.orientations should have one quaternion a splat"
            ));
        }
        None => vec![Quat::IDENTITY; count],
    };
    match turns.iter().all(|turn| turn.is_finite()) {
        true => Ok(turns),
        false => Err(format!(
            "{prim}.orientations has values that are not finite"
        )),
    }
}
