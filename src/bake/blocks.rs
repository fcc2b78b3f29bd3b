//! The cells of a scene in blocks of similar size, each with its own part of the columns: work for threads.

use crate::scene::PrimId;
use crate::surfels::triangle_dice::{Part, Row};
use crate::surfels::{DiceMap, DiceTable, SurfelCloud};
use glam::Vec3;
use std::ops::Range;

/// Cells a block aims at: some milliseconds of work.
const BLOCK_CELLS: u32 = 4096;

/// Triangles of clusters a block has at most, but for a single cluster.
const BLOCK_MEMBERS: usize = 16 * BLOCK_CELLS as usize;

/// A run of cells of one side of one prim.
#[derive(Debug, Clone)]
pub(super) struct Block {
    pub(super) prim: PrimId,
    pub(super) back: bool,
    span: Span,
    pub(super) cell_count: u32,
}

#[derive(Debug, Clone)]
enum Span {
    /// Whole triangles.
    Triangles(Range<u32>),
    /// Some rows of one part of a large triangle.
    Rows {
        t: u32,
        part: usize,
        rows: Range<u32>,
    },
    /// Cells that are clusters.
    Clusters(Range<u32>),
}

impl Block {
    /// All blocks, in the order of their surfels.
    pub(super) fn of_all(dice: &DiceMap) -> Vec<Self> {
        let mut blocks = Vec::new();
        for (prim, dice) in (0..).map(PrimId).zip(dice.prims()) {
            for back in [false, true] {
                if !dice.surfels(back).is_empty() {
                    let mut push = |span, cell_count| {
                        blocks.push(Self {
                            prim,
                            back,
                            span,
                            cell_count,
                        });
                    };
                    cut_triangles(dice.table(), &mut push);
                    cut_clusters(dice.table(), &mut push);
                }
            }
        }
        blocks
    }

    /// Rows of cells within triangles in order: triangle, number of the part's first cell within the prim, part, row.
    pub(super) fn for_each_row(
        &self,
        table: &DiceTable,
        mut visit: impl FnMut(u32, u32, &Part, Row),
    ) {
        let triangles = match &self.span {
            Span::Triangles(triangles) => triangles.clone(),
            Span::Rows { t, .. } => *t..t + 1,
            Span::Clusters(_) => 0..0,
        };
        for t in triangles {
            let (mut first, parts) = table.parts(t);
            for (number, part) in parts.enumerate() {
                let rows = match &self.span {
                    Span::Rows { part, rows, .. } if *part == number => rows.clone(),
                    Span::Rows { .. } => 0..0,
                    _ => 0..part.row_count(),
                };
                for row in rows {
                    visit(t, first, &part, part.row(row));
                }
                first += part.cell_count();
            }
        }
    }

    /// The numbers of its cells that are clusters.
    pub(super) fn clusters(&self) -> Range<u32> {
        match &self.span {
            Span::Clusters(cells) => cells.clone(),
            _ => 0..0,
        }
    }
}

/// Cut the cells within triangles of one side of a prim into blocks.
fn cut_triangles(table: &DiceTable, push: &mut impl FnMut(Span, u32)) {
    let (mut start, mut pending) = (0, 0);
    for t in 0..table.triangle_count() {
        let cells: u32 = table.parts(t).1.map(|part| part.cell_count()).sum();
        if pending > 0 && pending + cells > BLOCK_CELLS {
            push(Span::Triangles(start..t), pending);
            (start, pending) = (t, 0);
        }
        if cells > BLOCK_CELLS {
            for (part, rows_of) in table.parts(t).1.enumerate() {
                for (rows, count) in row_runs(&rows_of) {
                    push(Span::Rows { t, part, rows }, count);
                }
            }
            start = t + 1;
        } else {
            pending += cells;
        }
    }
    if pending > 0 {
        push(Span::Triangles(start..table.triangle_count()), pending);
    }
}

/// Cut the clusters of one side of a prim into blocks.
fn cut_clusters(table: &DiceTable, push: &mut impl FnMut(Span, u32)) {
    let (mut start, mut members) = (table.within_count(), 0);
    for cell in table.within_count()..table.cell_count() {
        let more = table.members(cell).len();
        if cell > start && (cell - start >= BLOCK_CELLS || members + more > BLOCK_MEMBERS) {
            push(Span::Clusters(start..cell), cell - start);
            (start, members) = (cell, 0);
        }
        members += more;
    }
    if start < table.cell_count() {
        push(
            Span::Clusters(start..table.cell_count()),
            table.cell_count() - start,
        );
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
