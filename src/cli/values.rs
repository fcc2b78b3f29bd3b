//! Values of flags: their names, and how they are read.

use crate::pipeline::Falloff;
use clap::ValueEnum;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum AxisName {
    Y,
    Z,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum UsdDoor {
    Auto,
    Native,
    UsdCore,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum LoadName {
    All,
    None,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum JobName {
    Points,
    Bake,
    Render,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum PurposeName {
    Default,
    Render,
    Proxy,
    Guide,
}

/// Whether receivers speak for others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum InterpolateName {
    /// Where it pays.
    Auto,
    /// Every receiver is gathered at.
    Never,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum EngineName {
    /// The cheapest that meets --tolerance, as a pilot on a few receivers measures; without it, rays.
    Auto,
    /// Rays against the scene, radiance read from the surfels at the hit.
    Rays,
    /// Occlusion, visibility, bent normals and light of the sky by depth maps that all receivers share, the rest by
    /// rays: for dense meshes and whole pictures.
    Maps,
    /// Reflected light from clusters of surfels that neighbors share, rays between the two for what is hidden; what asks
    /// which directions are open by rays.
    Raster,
    /// The published method: surfels and clusters rasterized onto a cube.
    Paper,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum InterpolationName {
    Vertex,
    #[value(name = "faceVarying", alias = "face-varying")]
    FaceVarying,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum InstancesName {
    Shared,
    Deinstance,
    Skip,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ExrLayout {
    Single,
    Multipart,
}

/// `--bounces`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BouncesArg {
    Count(u32),
    Auto,
}

pub(super) fn bounces(text: &str) -> Result<BouncesArg, String> {
    if text == "auto" {
        return Ok(BouncesArg::Auto);
    }
    (text.parse().map(BouncesArg::Count)).map_err(|_| "a number, or auto, is needed".to_owned())
}

pub(super) fn falloff(text: &str) -> Result<Falloff, String> {
    let (name, power) = text.split_once(':').unwrap_or((text, "2"));
    match (name, positive(power)) {
        ("none", _) if name == text => Ok(Falloff::None),
        ("linear", _) if name == text => Ok(Falloff::Linear),
        ("smooth", _) if name == text => Ok(Falloff::Smooth),
        ("exponent", Ok(power)) => Ok(Falloff::Exponent(power)),
        ("exponent", Err(wrong)) => Err(wrong),
        _ => Err("none, linear, smooth, exponent or exponent:P is needed".to_owned()),
    }
}

pub(super) fn cone_angle(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(degrees) if degrees > 0.0 && degrees <= 90.0 => Ok(degrees),
        _ => Err("degrees greater than 0, at most 90, are needed".to_owned()),
    }
}

pub(super) fn range(text: &str) -> Result<(f32, f32), String> {
    let ends = text.split_once(':').and_then(|(low, high)| {
        let (low, high) = (low.parse::<f32>().ok()?, high.parse::<f32>().ok()?);
        (low < high && (high - low).is_finite()).then_some((low, high))
    });
    ends.ok_or_else(|| "two numbers, the lower first, are needed: 0:0.5".to_owned())
}

pub(super) fn positive(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("a number greater than 0 is needed".to_owned()),
    }
}

pub(super) fn not_negative(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value >= 0.0 && value.is_finite() => Ok(value),
        _ => Err("a number of 0 or more is needed".to_owned()),
    }
}

/// A tolerance: below 1e-4 single precision and the surfels' spacing are what errs.
pub(super) fn fraction(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (1e-4..1.0).contains(&value) => Ok(value),
        _ => Err("a number from 0.0001 to below 1 is needed, 0.02 for 2 %".to_owned()),
    }
}
