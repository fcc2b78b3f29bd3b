//! How long maps take, so that a pilot can choose between engines.

use super::{MapsPlan, MapsSettings};

/// Nanoseconds to draw one triangle into the maps of an axis, at about a pixel an edge. Measured, as all three, on one
/// thread with 512-bit vectors, on a bumpy ball of 1.08 M triangles over a ground (`cargo bench --bench maps`).
const DRAW: f64 = 7.0;

/// Nanoseconds for one receiver to look along one axis, a class of maps. Adding up the light of the sky is lost in it:
/// 4.34 µs a vertex for 256 directions with it, 4.56 without.
const LOOK: f64 = 3.6;

/// Nanoseconds a receiver before the first look.
const SET_UP: f64 = 150.0;

/// Expected seconds of one thread for `receivers` receivers. Within a factor of about 2.
pub fn seconds(plan: &MapsPlan<'_>, receivers: usize, settings: &MapsSettings) -> f64 {
    let axes = f64::from(settings.directions.max(1));
    let thinning = f64::from(settings.cell.max(1.0)).powi(2);
    let triangles = plan.triangle_count() as f64 / thinning;
    let maps = plan.classes.len().max(1) as f64;
    let receivers = receivers as f64;
    1e-9 * (axes * (triangles * DRAW + receivers * maps * LOOK) + receivers * SET_UP)
}
