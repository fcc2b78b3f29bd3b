//! How the triangles of a scene are cut into micropolygons, and which surfel a point of a triangle belongs to.
//!
//! Surfels are numbered prim by prim; within a prim the front cells come in the order of its [`DiceTable`], then, where
//! the prim was diced on both sides, the back cells in the same order.

use super::DiceTable;
use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

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

/// How one prim is diced: the table of its mesh, and which sides.
#[derive(Debug, Clone)]
pub struct PrimDice {
    first: u32,
    sides: Sides,
    table: Arc<DiceTable>,
}

impl PrimDice {
    /// A prim whose mesh is diced as `table` says.
    pub fn new(table: Arc<DiceTable>, sides: Sides) -> Self {
        Self {
            first: 0,
            sides,
            table,
        }
    }

    /// The cells of one side.
    pub fn table(&self) -> &DiceTable {
        &self.table
    }

    /// Which sides carry surfels.
    pub fn sides(&self) -> Sides {
        self.sides
    }

    /// Its surfels on the front (`false`) or back (`true`) side, in cell order; empty for a back that was not diced.
    pub fn surfels(&self, back: bool) -> Range<u32> {
        let cell_count = self.table.cell_count();
        let skipped = u32::from(back) * cell_count;
        let count = if back && self.sides == Sides::Front {
            0
        } else {
            cell_count
        };
        self.first + skipped..self.first + skipped + count
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
            next += prim.table.cell_count() * prim.sides.count();
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
            (prim.first + prim.table.cell_count() * prim.sides.count()) as usize
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
        let cell = prim.table.cell_at(triangle, u, v)?;
        Some(prim.surfels(!front).start + cell)
    }

    /// Total bytes held; tables that prims share count once.
    pub fn bytes(&self) -> usize {
        let mut seen = HashSet::new();
        let tables = self.prims.iter().map(|prim| &prim.table);
        let tables = tables.filter(|table| seen.insert(Arc::as_ptr(table)));
        size_of_val(&*self.prims) + tables.map(|table| table.bytes()).sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use glam::Vec3;

    /// The first `count` of a small, a large and a degenerate triangle.
    fn table(count: u32) -> Arc<DiceTable> {
        let triangles: Vec<_> = (0..count).map(|t| [0, 2 * t + 1, 2 * t + 2]).collect();
        let place = |point: u32| {
            let size = [0.0, 0.1, 0.1, 10.0, 10.0, 0.0, 0.0][point as usize];
            size * if point % 2 == 1 { Vec3::X } else { Vec3::Y }
        };
        Arc::new(DiceTable::new(&triangles, place, 1.0))
    }

    #[test]
    fn surfels_of_all_prims_sides_and_triangles_are_numbered_without_gaps() {
        let map = DiceMap::new(vec![
            PrimDice::new(table(3), Sides::Both),
            PrimDice::new(table(1), Sides::Front),
        ]);
        let cells = map.prims()[0].table().cell_count();
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
    fn instances_share_the_bytes_of_their_table() {
        let table = table(3);
        let instances = |count| {
            let prim = |_| PrimDice::new(Arc::clone(&table), Sides::Front);
            DiceMap::new((0..count).map(prim).collect())
        };
        let more = instances(100).bytes() - instances(10).bytes();
        assert_eq!(more, 90 * size_of::<PrimDice>());
        assert!(instances(1).bytes() > table.bytes());
        assert_eq!(DiceMap::default().surfel_count(), 0);
    }
}
