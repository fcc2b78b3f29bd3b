//! What is broken or rarely meant.

use crate::diagnostics::Warning;
use crate::scene::{Light, LightKind, Scene};
use crate::stage::raw::RawStage;
use serde::Serialize;
use std::f32::consts::PI;

/// A shot of 100 km or a prop of 1 mm is rarer than wrong units.
const USUAL_SIZES_METERS: std::ops::RangeInclusive<f64> = 1e-3..=1e5;

/// Full sun is 1 to some tens in the units of a shot's exposure, a dim room a hundredth: irradiance out of this range
/// is more often an intensity of another renderer.
const USUAL_IRRADIANCE: std::ops::RangeInclusive<f32> = 1e-3..=1e4;

/// Radiance of an area light: a lamp of 1 cm that lights a room is about 1e5.
const LARGEST_RADIANCE: f32 = 1e7;

/// A reference or payload that brings nothing in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct BrokenReference {
    /// The prim that has it.
    pub prim: String,
    /// What USD says, the missing layer included.
    pub message: String,
}

/// Something rarely meant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Suspicion {
    /// `units`, `size`, `light`.
    pub kind: &'static str,
    /// Prim path; `/` for the stage.
    pub prim: String,
    /// What is odd, and what follows from it.
    pub message: String,
}

/// Those of `warnings` that tell of missing layers or prims.
pub(super) fn broken_references(warnings: &[Warning]) -> Vec<BrokenReference> {
    const SIGNS: [&str; 5] = [
        "Could not open asset",
        "could not open",
        "not found",
        "Unresolved",
        "unresolved",
    ];
    let is_broken = |warning: &&Warning| {
        warning.kind == "usd" && SIGNS.iter().any(|sign| warning.message.contains(sign))
    };
    let reference = |warning: &Warning| BrokenReference {
        prim: warning.prim.clone(),
        message: warning.message.clone(),
    };
    warnings.iter().filter(is_broken).map(reference).collect()
}

/// Units, sizes and intensities out of the usual.
pub(super) fn suspicions(raw: &RawStage, scene: &Scene) -> Vec<Suspicion> {
    let mut found = Vec::new();
    let mut add = |kind, prim: &str, message: String| {
        found.push(Suspicion {
            kind,
            prim: prim.to_owned(),
            message,
        });
    };
    if raw.meta.meters_per_unit.is_none() {
        let message = "metersPerUnit is not authored: a unit counts as a centimeter";
        add("units", "/", message.to_owned());
    }
    if raw.meta.up_axis.is_none() {
        add(
            "units",
            "/",
            "upAxis is not authored: Y counts as up".to_owned(),
        );
    }
    let bounds = scene.bounds();
    if !bounds.is_empty() {
        let size = f64::from((bounds.max - bounds.min).length()) * scene.stage.meters_per_unit;
        if size > 0.0 && !USUAL_SIZES_METERS.contains(&size) {
            let message = format!(
                "the stage is {size:.3e} m across at {} m a unit",
                scene.stage.meters_per_unit
            );
            add("size", "/", message);
        }
    }
    for light in &scene.lights {
        if let Some(message) = odd_light(light) {
            add("light", &light.path, message);
        }
    }
    found
}

/// What is odd about a light, if anything.
fn odd_light(light: &Light) -> Option<String> {
    let radiance = light.radiance.max_element();
    if radiance <= 0.0 {
        return Some("it is black: intensity, color or exposure is 0".to_owned());
    }
    let irradiance = match light.kind {
        LightKind::Dome { .. } => PI * radiance,
        LightKind::Distant { .. } if light.normalize => radiance,
        // the sun's disk seen from the ground: a small cap of half the angle
        LightKind::Distant { angle } => PI * (0.5 * angle).sin().powi(2) * radiance,
        _ if light.normalize => return None,
        _ => {
            let is_large = radiance > LARGEST_RADIANCE;
            let message = format!(
                "radiance {radiance:.3e} is that of no lamp: intensity or exposure of another unit?"
            );
            return is_large.then_some(message);
        }
    };
    (!USUAL_IRRADIANCE.contains(&irradiance) && irradiance > 0.0).then(|| {
        format!("surfaces that face it get irradiance {irradiance:.3e}: intensity or exposure of another unit?")
    })
}
