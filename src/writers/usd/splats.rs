//! [`Splats`] → a `ParticleField3DGaussianSplat` (OpenUSD 26.03 and later).

use super::author::{Author, Data};
use super::{Error, Provenance};
use crate::scene::StageInfo;
use crate::surfels::splats::Splats;
use glam::Vec3;
use std::path::Path;

/// Standard deviations that the extent goes out from a center.
const REACH: f32 = 3.0;

/// Write `splats` to `path`.
///
/// # Errors
/// When the file cannot be written; nothing is left behind then.
pub fn write(
    splats: Splats,
    stage: &StageInfo,
    provenance: &Provenance,
    path: &Path,
) -> Result<(), Error> {
    let mut author = Author::new(stage, provenance, "root");
    let prim = "/root/splats";
    author.define("/root", "Xform")?;
    author.define(prim, "ParticleField3DGaussianSplat")?;
    author.attribute(prim, ("extent", "float3[]"), extent(&splats))?;
    let width = i32::try_from(splats.width()).unwrap_or(1);
    let degree = i32::try_from(splats.degree).unwrap_or(0);
    author.attribute(
        prim,
        ("positions", "point3f[]"),
        Data::Vec3s(splats.position),
    )?;
    author.attribute(
        prim,
        ("orientations", "quatf[]"),
        Data::Quats(splats.orientation),
    )?;
    author.attribute(prim, ("scales", "float3[]"), Data::Vec3s(splats.scale))?;
    author.attribute(prim, ("opacities", "float[]"), Data::Floats(splats.opacity))?;
    author.uniform(
        prim,
        ("radiance:sphericalHarmonicsDegree", "int"),
        Data::Int(degree),
    )?;
    let name = ("radiance:sphericalHarmonicsCoefficients", "float3[]");
    author.grouped(prim, name, width, Data::Vec3s(splats.coefficients))?;
    author.save(path)
}

fn extent(splats: &Splats) -> Data {
    let balls = splats.position.iter().zip(&splats.scale);
    let boxes = balls.map(|(&center, scale)| {
        let reach = Vec3::splat(REACH * scale.max_element());
        (center - reach, center + reach)
    });
    let all = boxes.reduce(|all, one| (all.0.min(one.0), all.1.max(one.1)));
    let (low, high) = all.unwrap_or_default();
    Data::Vec3s(vec![low, high])
}
