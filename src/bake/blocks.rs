//! The cells of a scene in blocks of similar size, each with its own part of the columns: work for threads.

use crate::scene::PrimId;
use crate::surfels::triangle_dice::{Part, Row};
use crate::surfels::{DiceMap, PrimDice, SurfelCloud};
use glam::Vec3;
use std::ops::Range;

/// Cells a block aims at: some milliseconds of work.
const BLOCK_CELLS: u32 = 4096;

/// A run of cells of one side of one prim: whole triangles, or some rows of one large triangle.
#[derive(Debug, Clone)]
pub(super) struct Block {
    pub(super) prim: PrimId,
    pub(super) back: bool,
    triangles: Range<u32>,
    /// Which part of the (only) triangle and which of its rows.
    rows: Option<(usize, Range<u32>)>,
    pub(super) cell_count: u32,
}

impl Block {
    /// All blocks, in the order of their surfels.
    pub(super) fn of_all(dice: &DiceMap) -> Vec<Self> {
        let mut blocks = Vec::new();
        for (prim, dice) in (0..).map(PrimId).zip(dice.prims()) {
            for back in [false, true] {
                if !dice.surfels(back).is_empty() {
                    cut(prim, back, dice, &mut blocks);
                }
            }
        }
        blocks
    }

    /// Rows of cells in order: triangle, number of the part's first cell within the prim, part, row.
    pub(super) fn for_each_row(
        &self,
        dice: &PrimDice,
        mut visit: impl FnMut(u32, u32, &Part, Row),
    ) {
        for t in self.triangles.clone() {
            let (mut first, parts) = dice.parts(t);
            for (number, part) in parts.enumerate() {
                let rows = match &self.rows {
                    None => 0..part.row_count(),
                    Some((only, rows)) if *only == number => rows.clone(),
                    Some(_) => 0..0,
                };
                for row in rows {
                    visit(t, first, &part, part.row(row));
                }
                first += part.cell_count();
            }
        }
    }
}

/// Cut one side of a prim into blocks.
fn cut(prim: PrimId, back: bool, dice: &PrimDice, blocks: &mut Vec<Block>) {
    let block = |triangles, rows, cell_count| Block {
        prim,
        back,
        triangles,
        rows,
        cell_count,
    };
    let (mut start, mut pending) = (0, 0);
    for t in 0..dice.triangle_count() {
        let cells: u32 = dice.parts(t).1.map(|part| part.cell_count()).sum();
        if pending > 0 && pending + cells > BLOCK_CELLS {
            blocks.push(block(start..t, None, pending));
            (start, pending) = (t, 0);
        }
        if cells > BLOCK_CELLS {
            for (number, part) in dice.parts(t).1.enumerate() {
                for (rows, count) in row_runs(&part) {
                    blocks.push(block(t..t + 1, Some((number, rows)), count));
                }
            }
            start = t + 1;
        } else {
            pending += cells;
        }
    }
    if pending > 0 {
        blocks.push(block(start..dice.triangle_count(), None, pending));
    }
}

/// Runs of rows of a part with their numbers of cells.
fn row_runs(part: &Part) -> Vec<(Range<u32>, u32)> {
    let mut runs = Vec::new();
    let (mut start, mut count) = (0, 0);
    for row in 0..part.row_count() {
        count += part.row(row).count;
        if count >= BLOCK_CELLS || row + 1 == part.row_count() {
            runs.push((start..row + 1, count));
            (start, count) = (row + 1, 0);
        }
    }
    runs
}

/// A block's part of the columns of a cloud.
pub(super) struct BlockColumns<'a> {
    pub(super) position: &'a mut [Vec3],
    pub(super) normal: &'a mut [Vec3],
    pub(super) radius: &'a mut [f32],
    pub(super) area: &'a mut [f32],
    pub(super) radiosity: &'a mut [Vec3],
    pub(super) albedo: &'a mut [Vec3],
    pub(super) emission: &'a mut [Vec3],
    pub(super) prim: &'a mut [u32],
    /// Irradiance of `Look::lights` at the centers.
    pub(super) lights: &'a mut [Vec3],
}

impl<'a> BlockColumns<'a> {
    /// The columns of `cloud` and `lights` split among `blocks`, whose surfels follow each other without gaps.
    pub(super) fn split(
        blocks: &[Block],
        cloud: &'a mut SurfelCloud,
        lights: &'a mut [Vec3],
    ) -> Vec<Self> {
        let mut rest = Self {
            position: &mut cloud.position,
            normal: &mut cloud.normal,
            radius: &mut cloud.radius,
            area: &mut cloud.area,
            radiosity: &mut cloud.radiosity,
            albedo: &mut cloud.albedo,
            emission: &mut cloud.emission,
            prim: &mut cloud.prim,
            lights,
        };
        let take = |block: &Block| rest.take(block.cell_count as usize);
        blocks.iter().map(take).collect()
    }

    fn take(&mut self, count: usize) -> Self {
        Self {
            position: front(&mut self.position, count),
            normal: front(&mut self.normal, count),
            radius: front(&mut self.radius, count),
            area: front(&mut self.area, count),
            radiosity: front(&mut self.radiosity, count),
            albedo: front(&mut self.albedo, count),
            emission: front(&mut self.emission, count),
            prim: front(&mut self.prim, count),
            lights: front(&mut self.lights, count),
        }
    }
}

/// Take the first `count` elements off `slice`.
pub(super) fn front<'a, T>(slice: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    slice
        .split_off_mut(..count)
        .expect("columns are as long as all blocks together")
}
