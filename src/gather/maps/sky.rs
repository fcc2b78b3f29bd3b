//! An environment with an image, divided among the directions of maps.
//!
//! Each direction, both ways of an axis, has the cell of the sky nearest to it with the first moment of its light, so
//! that what arrives when nothing blocks is exact, whatever the sky looks like within the cell. Suns and small bright
//! areas have cells of their own, which cast sharp shadows: rays look at them.

use super::MapsSettings;
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::neighbors;
use crate::lighting::{
    EnvironmentCell, EnvironmentSet, Lighting, LinkedDomes, ShadePoint, SkyLight,
};
use crate::math::luminance;
use crate::receivers::Receivers;
use crate::scene::Scene;
use crate::trace::Tracer;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::Arc;

/// Receivers a unit of parallel work of rays: what looks together.
const BLOCK: usize = 64;

/// Rays to bright areas over those of [`Lighting::environment_set`], which has fewer other directions to see them by. On
/// a bunny on a ground under a sun and four bright areas, 128 directions err by 1.31, 0.67, 0.65 % with a share of a
/// quarter, a half, one, and 256 by 0.51 and 0.49 % with a half and one.
const BRIGHT_SHARE: f32 = 0.5;

/// A sky for maps of one number of directions.
#[derive(Debug)]
pub struct MapsSky {
    /// Of the axes.
    directions: Vec<Vec3>,
    /// Even cells: along the first axis, against it, along the second …
    set: EnvironmentSet,
    /// What no map shows: rays look at it.
    linked: Arc<LinkedDomes>,
    /// Nothing beyond hides the sky.
    reach: f32,
}

impl MapsSky {
    /// The domes of `lighting`. Costs tens of milliseconds for a large map.
    pub fn new(lighting: &Lighting, settings: &MapsSettings) -> Self {
        let directions: Vec<Vec3> = super::directions(settings.directions.max(1)).collect();
        let both: Vec<Vec3> = directions.iter().flat_map(|&d| [d, -d]).collect();
        Self {
            set: lighting.environment_along(&both, BRIGHT_SHARE),
            directions,
            linked: Arc::clone(lighting.linked_domes()),
            reach: settings.max_distance.unwrap_or(f32::INFINITY),
        }
    }

    /// Of the axes that it is divided for, unit.
    pub(super) fn directions(&self) -> &[Vec3] {
        &self.directions
    }

    /// The cells along axis `number` and against it.
    pub(super) fn pair(&self, number: usize) -> [&EnvironmentCell; 2] {
        let even = self.set.even();
        [&even[2 * number], &even[2 * number + 1]]
    }

    /// Irradiance from the even cells at a receiver with unit `normal` that is covered along no axis but those of
    /// `covered` (each looked along on the receiver's side of its horizon). Light of cells that lean over the horizon
    /// from below counts as much as the receiver is open on the whole. The definition of what maps compute.
    pub fn even_light(&self, normal: Vec3, covered: &[bool]) -> Vec3 {
        let (mut seen, mut sunken) = (Vec3::ZERO, Vec3::ZERO);
        let (mut open, mut all) = (0.0, 0.0);
        for (number, (direction, &covered)) in self.directions.iter().zip(covered).enumerate() {
            let cosine = direction.dot(normal);
            let side = usize::from(cosine < 0.0);
            let pair = self.pair(number);
            if !covered {
                open += cosine.abs();
                seen += pair[side].irradiance(normal);
            }
            sunken += pair[1 - side].irradiance(normal);
            all += cosine.abs();
        }
        seen + sunken * if all > 0.0 { open / all } else { 0.0 }
    }

    /// Light from suns, small bright areas and domes with links at each of `receivers`, by rays.
    ///
    /// # Errors
    /// When cancelled.
    pub fn bright_light(
        &self,
        (scene, tracer): (&Scene, &Tracer),
        receivers: &Receivers,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<SkyLight>, Cancelled> {
        let count = receivers.len();
        if self.set.importance().is_empty() && self.linked.is_empty() {
            return Ok(vec![SkyLight::default(); count]);
        }
        let phase = diagnostics.phase("maps", "rays to bright sky", count as u64);
        let order = neighbors::order(&receivers.position, &receivers.normal);
        let block = |block: &[usize]| {
            diagnostics.check()?;
            let points: Vec<_> = (block.iter())
                .map(|&i| point(scene, receivers, i))
                .collect();
            phase.advance(block.len() as u64);
            let mut light = self.set.importance_light(tracer, &points, self.reach);
            let asked = (&points[..], self.reach);
            self.linked.add_light(tracer, asked, &mut light);
            Ok(light)
        };
        let blocks: Result<Vec<_>, Cancelled> = order.par_chunks(BLOCK).map(block).collect();
        let mut light = vec![SkyLight::default(); count];
        for (&i, found) in order.iter().zip(blocks?.iter().flatten()) {
            light[i] = *found;
        }
        Ok(light)
    }
}

fn point(scene: &Scene, receivers: &Receivers, i: usize) -> ShadePoint {
    let normals = (receivers.normal[i], receivers.geometric_normal[i]);
    ShadePoint::on_mesh(scene, &receivers.surface[i], receivers.position[i], normals)
}

/// What an environment asks of a look.
#[derive(Debug, Clone, Copy)]
pub struct SkyWanted<'a> {
    /// The cells.
    pub sky: &'a MapsSky,
    /// True if where the light comes from is asked for too.
    pub with_direction: bool,
}

/// Rows of sums over looks: irradiance from cells looked along, then from cells below the horizon that lean over it,
/// and, where it is asked for, the mean direction of the former weighted by luminance; three each.
pub(super) const SEEN: usize = 0;
pub(super) const SUNKEN: usize = 3;
pub(super) const TOWARDS: usize = 6;

/// How many of them there are.
pub(super) fn row_count(wanted: Option<SkyWanted<'_>>) -> usize {
    match wanted {
        None => 0,
        Some(wanted) if wanted.with_direction => TOWARDS + 3,
        Some(_) => TOWARDS,
    }
}

/// An [`EnvironmentCell`] as looks use it.
#[derive(Debug, Clone, Copy)]
pub(super) struct SkyCell {
    pub(super) direction: Vec3,
    /// ∫ L ω dω of each color.
    pub(super) moments: [Vec3; 3],
    /// What arrives from a cell across the horizon, over the square of how far it reaches above it.
    pub(super) rise: Vec3,
    pub(super) half_width: f32,
}

impl SkyCell {
    pub(super) fn of(cell: &EnvironmentCell) -> Self {
        let [x, y, z] = cell.moments();
        let width = 4.0 * cell.half_width();
        Self {
            direction: cell.direction(),
            moments: [0, 1, 2].map(|color| Vec3::new(x[color], y[color], z[color])),
            rise: if width > 0.0 {
                cell.flux() / width
            } else {
                Vec3::ZERO
            },
            half_width: cell.half_width(),
        }
    }
}

/// The luminance of a color in a fixed order of operations.
pub(super) fn weights() -> [f32; 3] {
    [Vec3::X, Vec3::Y, Vec3::Z].map(luminance)
}
