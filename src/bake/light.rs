//! Direct light on cells, averaged over their areas.
//!
//! Light is evaluated at the center of every cell, as seen from one place on each source, another one for every
//! neighbor. Where a cell and its neighbors differ by more than
//! [`STEEPEST`], which is what a penumbra, a shadow's edge or the falloff of a near light looks like at the cells' size, UsdLux
//! lights (the sharp sources) are evaluated again at the middles of its four quarters, and their mean counts.
//! Neighbors are the adjoining cells of the same triangle, and for whole triangles and clusters the cells of all
//! triangles that share a point with them. Clusters are evaluated at the middles of some of their triangles. What lies between cells that agree, such as the shadow of a twig, is not looked for.
//! Environment and emissive surfaces are wide and evaluated at the center only.

use crate::lighting::ShadePoint;
use crate::math::luminance;
use crate::scene::{PlacedMesh, PrimId};
use crate::shading::{Surface, SurfacePoint};
use crate::surfels::DiceTable;
use crate::surfels::triangle_dice::{Part, Row};
use glam::Vec3;
use rayon::prelude::*;

/// Relative difference of irradiance between neighboring cells above which a cell is evaluated more finely.
const STEEPEST: f32 = 0.1;

/// What shades and lights a point; apart from the modules that do, so that tests can put closed forms in their place.
#[derive(Clone, Copy)]
pub(super) struct Look<'a> {
    /// True if light passes through a prim.
    pub(super) is_screen: &'a (dyn Fn(PrimId) -> bool + Sync),
    /// Albedo and emission.
    pub(super) surface: &'a (dyn Fn(&SurfacePoint) -> Surface + Sync),
    /// Irradiance of sources whose shadows may be sharp.
    pub(super) lights: &'a (dyn Fn(&ShadePoint) -> Vec3 + Sync),
    /// The same where nothing casts a penumbra; in penumbrae that of one place on the source, another for every number.
    pub(super) glance: &'a (dyn Fn(&ShadePoint, usize) -> Vec3 + Sync),
    /// Irradiance of wide sources at each of some points, near each other for speed.
    pub(super) wide: &'a (dyn Fn(&[ShadePoint]) -> Vec<Vec3> + Sync),
}

/// One side of a prim, as far as points on it are concerned.
#[derive(Clone, Copy)]
pub(super) struct Side<'a> {
    pub(super) world: &'a PlacedMesh<'a>,
    pub(super) prim: PrimId,
    pub(super) back: bool,
}

impl Side<'_> {
    /// The middle of triangle `t`.
    pub(super) fn middle(&self, t: u32) -> ShadePoint {
        self.shade_point(t, Vec3::splat(1.0 / 3.0), plane_normal(self.world, t))
    }

    /// See [`ShadePoint::on_side`].
    pub(super) fn shade_point(&self, t: u32, weights: Vec3, plane_normal: Vec3) -> ShadePoint {
        ShadePoint::on_side(self.world, (t, weights), plane_normal, self.back).of_prim(self.prim)
    }
}

/// Number for [`Look::glance`] of a cell: those of neighbors differ.
pub(super) fn glance_number(t: u32, row: Row, column: u32) -> usize {
    5 * column as usize + 7 * row.index as usize + whole_number(t)
}

/// The same for whole triangles and clusters, `t` being the first triangle.
pub(super) fn whole_number(t: u32) -> usize {
    // the upper bits of multiples of the golden ratio: neighboring triangles have distant numbers
    (t.wrapping_mul(0x9e37_79b9) >> 28) as usize
}

/// Unit plane normal of the front side of triangle `t`; any where rounding leaves no area in this instance of a mesh.
pub(super) fn plane_normal(world: &PlacedMesh<'_>, t: u32) -> Vec3 {
    world.plane_normal(t).normalize_or(Vec3::Y)
}

/// Irradiance of `look.lights` on one cell as the mean over its quarters.
pub(super) fn quartered(
    look: &Look<'_>,
    side: &Side<'_>,
    t: u32,
    part: &Part,
    at: (Row, u32),
) -> Vec3 {
    let plane_normal = plane_normal(side.world, t);
    let sum: Vec3 = (0..4)
        .map(|quarter| {
            let weights = part.quarter(at.0, at.1, quarter);
            (look.lights)(&side.shade_point(t, weights, plane_normal))
        })
        .sum();
    0.25 * sum
}

/// Luminance of the irradiance at the cells of one side of one prim, and around every point of its mesh.
pub(super) struct Steepness<'a> {
    /// By cell.
    center: &'a [Vec3],
    /// Lowest and highest around each position of the mesh; empty if all triangles are cut.
    around: Vec<[f32; 2]>,
}

impl<'a> Steepness<'a> {
    pub(super) fn new(world: &PlacedMesh<'_>, dice: &DiceTable, center: &'a [Vec3]) -> Self {
        let mut around = Vec::new();
        if (0..dice.triangle_count())
            .into_par_iter()
            .any(|t| dice.is_whole(t))
        {
            around = vec![[f32::INFINITY, f32::NEG_INFINITY]; world.mesh.positions.len()];
            for t in 0..dice.triangle_count() {
                for (corner, [u, v]) in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].into_iter().enumerate()
                {
                    let Some(cell) = dice.cell_at(t, u, v) else {
                        continue;
                    };
                    let value = luminance(center[cell as usize]);
                    let range = &mut around[world.mesh.triangles[t as usize][corner] as usize];
                    *range = [range[0].min(value), range[1].max(value)];
                }
            }
        }
        Self { center, around }
    }

    /// True if the cells around `triangles`, which are whole, differ.
    pub(super) fn at_triangles(&self, world: &PlacedMesh<'_>, triangles: &[u32]) -> bool {
        let points = triangles
            .iter()
            .flat_map(|t| world.mesh.triangles[*t as usize]);
        let [low, high] = points.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], i| {
            let range = self.around[i as usize];
            [low.min(range[0]), high.max(range[1])]
        });
        high - low > STEEPEST * high
    }

    /// True if cell `column` of `row` and those before, after, above and below it differ. `first` is the number of
    /// the part's first cell.
    pub(super) fn at_cell(&self, first: u32, part: &Part, row: Row, column: u32) -> bool {
        let value =
            |row: Row, column: u32| luminance(self.center[(first + row.first + column) as usize]);
        let here = value(row, column);
        let differs = |other: f32| (here - other).abs() > STEEPEST * here.max(other);
        let beside = |index: u32| {
            let other = part.row(index);
            differs(value(
                other,
                (2 * column + 1) * other.count / (2 * row.count),
            ))
        };
        (column > 0 && differs(value(row, column - 1)))
            || (column + 1 < row.count && differs(value(row, column + 1)))
            || (row.index > 0 && beside(row.index - 1))
            || (row.index + 1 < part.row_count() && beside(row.index + 1))
    }
}
