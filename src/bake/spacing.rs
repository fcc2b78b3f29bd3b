//! From a number of surfels to the spacing that makes about as many.

use super::BakeSettings;
use super::world::WorldMesh;
use crate::diagnostics::Diagnostics;
use crate::scene::Scene;
use crate::surfels::Sides;
use crate::surfels::triangle_dice::Dicing;
use rayon::prelude::*;

/// Surfels are numbered with 32 bits, of which one is kept as a mark; beyond this the spacing is coarsened.
const MOST_SURFELS: u64 = 1 << 30;

/// Meshes whose triangles alone exceed the budget still have their large triangles diced: the spacing is never more
/// than this many times the one that the area alone asks for.
const COARSEST: f64 = 2.0;

/// Stop correcting when the number of surfels is this close to the budget.
const CLOSE_ENOUGH: f64 = 0.02;

/// Each counts all cells, about 20 ns a triangle.
const MOST_CORRECTIONS: u32 = 6;

/// Edge length of a cell for `settings`, stage units; 0 for a scene without area.
pub(super) fn solve(
    scene: &Scene,
    sides: &[Sides],
    settings: &BakeSettings,
    diagnostics: &Diagnostics,
) -> f32 {
    let area = total_area(scene, sides);
    if area <= 0.0 {
        return 0.0;
    }
    let budget = (settings.surfels.max(1) as u64).min(MOST_SURFELS);
    let Some(asked) = settings.spacing.filter(|s| *s > 0.0 && s.is_finite()) else {
        return search(scene, sides, area, budget);
    };
    // Counting is only worth it where the limit is near.
    let expected = area / f64::from(asked).powi(2);
    if expected < 0.1 * MOST_SURFELS as f64 || count(scene, sides, asked) <= MOST_SURFELS {
        return asked;
    }
    let spacing = search(scene, sides, area, MOST_SURFELS / 2);
    let message = format!(
        "a spacing of {asked} would make about {expected:.1e} surfels; {spacing} is used instead"
    );
    diagnostics.warn("spacing-too-fine", "", message);
    spacing
}

/// Number × spacing² is nearly constant where cells are small against triangles: a few corrections by that rule.
fn search(scene: &Scene, sides: &[Sides], area: f64, budget: u64) -> f32 {
    let budget = budget as f64;
    let ideal = (area / budget).sqrt();
    let mut spacing = ideal;
    for _ in 0..MOST_CORRECTIONS {
        let excess = count(scene, sides, as_f32(spacing)) as f64 / budget;
        let next = (spacing * excess.sqrt()).clamp(ideal / COARSEST, ideal * COARSEST);
        if (excess - 1.0).abs() <= CLOSE_ENOUGH || next == spacing {
            break;
        }
        spacing = next;
    }
    as_f32(spacing)
}

#[expect(clippy::cast_possible_truncation, reason = "a length, rounded to f32")]
fn as_f32(spacing: f64) -> f32 {
    spacing as f32
}

/// Area of all sides with surfels, world space.
fn total_area(scene: &Scene, sides: &[Sides]) -> f64 {
    let of_prim = |(prim, sides): (_, &Sides)| {
        let mesh = WorldMesh::new(scene, prim);
        let area: f64 = (0..mesh.triangle_count()).map(|t| mesh.area(t)).sum();
        area * f64::from(sides.count())
    };
    let areas: Vec<f64> = scene.prims.par_iter().zip(sides).map(of_prim).collect();
    areas.iter().sum()
}

/// Number of surfels at `spacing`.
fn count(scene: &Scene, sides: &[Sides], spacing: f32) -> u64 {
    let of_prim = |(prim, sides): (_, &Sides)| {
        let mesh = WorldMesh::new(scene, prim);
        let cells = |t| u64::from(Dicing::new(mesh.corners(t), spacing).cell_count());
        (0..mesh.triangle_count())
            .into_par_iter()
            .map(cells)
            .sum::<u64>()
            * u64::from(sides.count())
    };
    scene.prims.par_iter().zip(sides).map(of_prim).sum()
}
