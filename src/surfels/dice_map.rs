//! How the triangles of a scene are cut into micropolygons, and which surfel a point of a triangle belongs to.
//!
//! Surfels are numbered prim by prim; within a prim the front cells come triangle by triangle, then, where the prim
//! was diced on both sides, the back cells in the same order.

use super::triangle_dice::{Dicing, Part, TriangleDice};
use glam::Vec3;
use std::ops::Range;

/// Which sides of a prim carry surfels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sides {
    /// The front only: the back is never seen.
    Front,
    /// Front and back.
    Both,
}

impl Sides {
    /// 1 or 2.
    pub fn count(self) -> u32 {
        match self {
            Self::Front => 1,
            Self::Both => 2,
        }
    }
}

/// Marks an entry of [`Cells::Mixed`] that points into `diced`.
const DICED: u32 = 1 << 31;
/// Entry of a triangle without area.
const NOTHING: u32 = u32::MAX;

/// Cells of the triangles of a prim.
#[derive(Debug, Clone)]
enum Cells {
    /// Every triangle is one cell.
    OnePerTriangle,
    /// 4 bytes a triangle: the number of its only cell, [`DICED`] + an index into `diced`, or [`NOTHING`].
    Mixed {
        triangles: Box<[u32]>,
        diced: Box<[TriangleDice]>,
    },
}

/// How the triangles of one prim are diced.
#[derive(Debug, Clone)]
pub struct PrimDice {
    first: u32,
    cell_count: u32,
    triangle_count: u32,
    sides: Sides,
    cells: Cells,
}

impl PrimDice {
    /// Dice `triangle_count` triangles with the world-space `corners` at `spacing`. Fewer than 2³¹ cells: the caller
    /// chooses the spacing accordingly.
    pub fn new(
        triangle_count: u32,
        corners: impl Fn(u32) -> [Vec3; 3],
        spacing: f32,
        sides: Sides,
    ) -> Self {
        let mut triangles = Vec::with_capacity(triangle_count as usize);
        let mut diced = Vec::new();
        let (mut next, mut diced_count) = (0, 0_u32);
        for t in 0..triangle_count {
            let dicing = Dicing::new(corners(t), spacing);
            triangles.push(match dicing {
                Dicing::Nothing => NOTHING,
                Dicing::Whole => next,
                Dicing::Cells(dice) => {
                    diced.push(dice.starting_at(next));
                    diced_count += 1;
                    DICED | (diced_count - 1)
                }
            });
            next += dicing.cell_count();
        }
        let plain = diced.is_empty() && next == triangle_count;
        Self {
            first: 0,
            cell_count: next,
            triangle_count,
            sides,
            cells: if plain {
                Cells::OnePerTriangle
            } else {
                Cells::Mixed {
                    triangles: triangles.into(),
                    diced: diced.into(),
                }
            },
        }
    }

    /// Number of cells on one side.
    pub fn cell_count(&self) -> u32 {
        self.cell_count
    }

    /// Number of triangles.
    pub fn triangle_count(&self) -> u32 {
        self.triangle_count
    }

    /// Which sides carry surfels.
    pub fn sides(&self) -> Sides {
        self.sides
    }

    /// Its surfels on the front (`false`) or back (`true`) side, in cell order; empty for a back that was not diced.
    pub fn surfels(&self, back: bool) -> Range<u32> {
        let skipped = u32::from(back) * self.cell_count;
        let count = if back && self.sides == Sides::Front {
            0
        } else {
            self.cell_count
        };
        self.first + skipped..self.first + skipped + count
    }

    /// Number of the first cell of triangle `t`, and its parts in cell order (none without area).
    pub fn parts(&self, t: u32) -> (u32, impl Iterator<Item = Part> + use<>) {
        let entry = match &self.cells {
            Cells::OnePerTriangle => t,
            Cells::Mixed { triangles, .. } => triangles[t as usize],
        };
        let (first, whole, dice) = match &self.cells {
            Cells::Mixed { .. } if entry == NOTHING => (0, None, None),
            Cells::Mixed { diced, .. } if entry & DICED != 0 => {
                let dice = diced[(entry ^ DICED) as usize];
                (dice.first(), None, Some(dice))
            }
            _ => (entry, Some(Part::WHOLE), None),
        };
        (
            first,
            whole
                .into_iter()
                .chain(dice.into_iter().flat_map(|dice| dice.parts())),
        )
    }

    /// True if triangle `t` is one cell (or none, without area).
    pub fn is_whole(&self, t: u32) -> bool {
        match &self.cells {
            Cells::OnePerTriangle => true,
            Cells::Mixed { triangles, .. } => triangles[t as usize] & DICED == 0,
        }
    }

    /// Number of the cell at barycentric `(u, v)` of triangle `t`.
    pub fn cell_at(&self, t: u32, u: f32, v: f32) -> Option<u32> {
        match &self.cells {
            Cells::OnePerTriangle => Some(t),
            Cells::Mixed { triangles, diced } => match triangles[t as usize] {
                NOTHING => None,
                entry if entry & DICED != 0 => {
                    let dice = &diced[(entry ^ DICED) as usize];
                    Some(dice.cell_at(Vec3::new(1.0 - u - v, u, v)))
                }
                cell => Some(cell),
            },
        }
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
            + match &self.cells {
                Cells::OnePerTriangle => 0,
                Cells::Mixed { triangles, diced } => {
                    size_of_val(&**triangles) + size_of_val(&**diced)
                }
            }
    }
}

/// Finds the surfel of a point on a triangle, in constant time for all practical purposes (logarithmic in the rows
/// of a very large triangle).
#[derive(Debug, Clone, Default)]
pub struct DiceMap {
    prims: Vec<PrimDice>,
}

impl DiceMap {
    /// Number the cells of `prims` (in the order of their ids) as surfels. Together fewer than 2³² surfels.
    pub fn new(mut prims: Vec<PrimDice>) -> Self {
        let mut next = 0;
        for prim in &mut prims {
            prim.first = next;
            next += prim.cell_count * prim.sides.count();
        }
        Self { prims }
    }

    /// How each prim is diced.
    pub fn prims(&self) -> &[PrimDice] {
        &self.prims
    }

    /// Number of surfels of all prims.
    pub fn surfel_count(&self) -> usize {
        let last = self.prims.last();
        last.map_or(0, |prim| {
            (prim.first + prim.cell_count * prim.sides.count()) as usize
        })
    }

    /// Index of the surfel that covers barycentric `(u, v)` of `triangle` of prim `prim`, on the front or back side;
    /// `None` where that side was not diced (the inside of a closed mesh) or the triangle has no area.
    #[expect(
        clippy::too_many_arguments,
        reason = "they are the fields of a hit; vocabulary does not import `trace`"
    )]
    pub fn surfel_at(&self, prim: u32, triangle: u32, u: f32, v: f32, front: bool) -> Option<u32> {
        let prim = self.prims.get(prim as usize)?;
        if !front && prim.sides == Sides::Front {
            return None;
        }
        let cell = prim.cell_at(triangle, u, v)?;
        Some(prim.surfels(!front).start + cell)
    }

    /// Total bytes held.
    pub fn bytes(&self) -> usize {
        self.prims.iter().map(PrimDice::bytes).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Small triangle, large triangle, degenerate triangle.
    fn corners(t: u32) -> [Vec3; 3] {
        let size = [0.1, 10.0, 0.0][t as usize];
        [Vec3::ZERO, Vec3::X * size, Vec3::Y * size]
    }

    #[test]
    fn surfels_of_all_prims_sides_and_triangles_are_numbered_without_gaps() {
        let map = DiceMap::new(vec![
            PrimDice::new(3, corners, 1.0, Sides::Both),
            PrimDice::new(1, corners, 1.0, Sides::Front),
        ]);
        let cells = map.prims()[0].cell_count();
        assert_eq!(map.surfel_count(), 2 * cells as usize + 1);
        assert_eq!(map.surfel_at(0, 0, 0.2, 0.2, true), Some(0));
        assert_eq!(map.surfel_at(0, 0, 0.2, 0.2, false), Some(cells));
        assert_eq!(map.surfel_at(1, 0, 0.2, 0.2, true), Some(2 * cells));
        assert_eq!(map.surfel_at(1, 0, 0.2, 0.2, false), None);
        assert_eq!(map.surfel_at(0, 2, 0.2, 0.2, true), None);
        let mut found: Vec<_> = (0..100_000)
            .map(|i| (i % 317) as f32 / 317.0 * 0.999)
            .zip((0..).map(|i| (i / 317) as f32 / 316.0))
            .filter(|(u, v)| u + v < 1.0)
            .filter_map(|(u, v)| map.surfel_at(0, 1, u, v, true))
            .collect();
        found.sort_unstable();
        found.dedup();
        assert_eq!(found, (1..cells).collect::<Vec<_>>());
    }

    #[test]
    fn a_dense_mesh_needs_no_bytes_a_triangle() {
        let dense = DiceMap::new(vec![PrimDice::new(1000, |_| corners(0), 1.0, Sides::Front)]);
        assert_eq!(dense.bytes(), size_of::<PrimDice>());
        assert_eq!(dense.surfel_at(0, 999, 0.3, 0.3, true), Some(999));
        assert_eq!(DiceMap::default().surfel_count(), 0);
    }
}
