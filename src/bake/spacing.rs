//! From a number of surfels to the spacing that makes about as many, and the cells at it.

use super::BakeSettings;
use super::shapes::{self, Shapes};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::scene::{PlacedMesh, Scene};
use crate::surfels::{DiceMap, PrimDice, Sides};
use rayon::prelude::*;

/// Surfels are numbered with 32 bits, of which one is kept as a mark; beyond this the spacing is coarsened.
const MOST_SURFELS: u64 = 1 << 30;

/// Scenes of very many small objects have at least some surfels an object; large surfaces beside them are still
/// diced: the spacing is never more than this many times the one that the area alone asks for.
const COARSEST: f64 = 4.0;

/// Stop correcting when the number of surfels is this close to the budget.
const CLOSE_ENOUGH: f64 = 0.02;

/// Each dices the scene, about 100 ns a triangle of a distinct shape.
const MOST_CORRECTIONS: u32 = 6;

/// How all prims are diced for `settings`, and the edge length of a cell, stage units; 0 for a scene without area.
pub(super) fn dice(
    scene: &Scene,
    sides: &[Sides],
    settings: &BakeSettings,
    diagnostics: &Diagnostics,
) -> Result<(DiceMap, f32), Cancelled> {
    let search = Search {
        shapes: Shapes::new(scene, sides),
        area: total_area(scene, sides),
        diagnostics,
    };
    let (prims, spacing) = search.solve(settings)?;
    Ok((DiceMap::new(prims), spacing))
}

struct Search<'a> {
    shapes: Shapes<'a>,
    /// Of all sides with surfels.
    area: f64,
    diagnostics: &'a Diagnostics,
}

impl Search<'_> {
    fn solve(&self, settings: &BakeSettings) -> Result<(Vec<PrimDice>, f32), Cancelled> {
        if self.area <= 0.0 {
            return Ok((self.shapes.dice(0.0), 0.0));
        }
        let budget = (settings.surfels.max(1) as u64).min(MOST_SURFELS);
        let Some(asked) = settings.spacing.filter(|s| *s > 0.0 && s.is_finite()) else {
            return self.for_budget(budget);
        };
        let expected = self.area / f64::from(asked).powi(2);
        // Far beyond the limit the numbers of cells would not even fit.
        if expected < 2.0 * MOST_SURFELS as f64 {
            let prims = self.shapes.dice(asked);
            if shapes::count(&prims) <= MOST_SURFELS {
                return Ok((prims, asked));
            }
        }
        let (prims, spacing) = self.for_budget(MOST_SURFELS / 2)?;
        let message = format!(
            "a spacing of {asked} would make about {expected:.1e} surfels; {spacing} is used instead"
        );
        self.diagnostics.warn("spacing-too-fine", "", message);
        Ok((prims, spacing))
    }

    /// Number × spacing² is nearly constant: a few corrections by that rule, the closest one counts.
    fn for_budget(&self, budget: u64) -> Result<(Vec<PrimDice>, f32), Cancelled> {
        let budget = budget as f64;
        let ideal = (self.area / budget).sqrt();
        let mut spacing = ideal;
        let mut best = None;
        let mut least_off = f64::INFINITY;
        for _ in 0..MOST_CORRECTIONS {
            self.diagnostics.check()?;
            let prims = self.shapes.dice(as_f32(spacing));
            let excess = shapes::count(&prims) as f64 / budget;
            let off = excess.ln().abs();
            if off < least_off {
                (best, least_off) = (Some((prims, as_f32(spacing))), off);
            }
            if !(off.is_finite() && ideal > 0.0 && ideal.is_finite()) {
                break;
            }
            let next = (spacing * excess.sqrt()).clamp(ideal / COARSEST, ideal * COARSEST);
            if (excess - 1.0).abs() <= CLOSE_ENOUGH || next == spacing {
                break;
            }
            spacing = next;
        }
        Ok(best.unwrap_or_else(|| (self.shapes.dice(as_f32(spacing)), as_f32(spacing))))
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a length, rounded to f32")]
fn as_f32(spacing: f64) -> f32 {
    spacing as f32
}

/// Area of all sides with surfels, world space.
fn total_area(scene: &Scene, sides: &[Sides]) -> f64 {
    let of_prim = |(prim, sides): (_, &Sides)| {
        let mesh = PlacedMesh::new(scene, prim);
        let area: f64 = (0..mesh.triangle_count()).map(|t| mesh.area(t)).sum();
        area * f64::from(sides.count())
    };
    let areas: Vec<f64> = scene.prims.par_iter().zip(sides).map(of_prim).collect();
    areas.iter().sum()
}
