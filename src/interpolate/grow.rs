//! Cells → seeds, as many as what they see asks for.

use super::cells::{Cells, halves};
use super::room;
use super::seeds::{SeedIndex, Seeds};
use super::{Work, base};
use crate::diagnostics::Cancelled;
use crate::receivers::Receivers;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

/// A cell whose seed speaks for it.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    /// In the order of [`Cells`].
    pub(super) run: Range<usize>,
    pub(super) seed: u32,
}

/// What has been gathered.
#[derive(Debug)]
pub(super) struct Field {
    pub(super) cells: Cells,
    pub(super) seeds: Seeds,
    /// Cells whose other receivers are to be blended.
    pub(super) smooth: Vec<Cell>,
    /// See [`Work::scales`].
    pub(super) scales: Vec<Option<f64>>,
}

/// What a seed's neighbors foretell may be off by this much of the tolerance. They are twice as far away as the seed is from
/// what it speaks for, where errors are a quarter: in a Cornell box 1 to 5 times the tolerance add no error to that of rays.
const ROUGH: f64 = 1.5;

impl Work<'_> {
    /// Gather at seeds until all cells are smooth or have one receiver.
    pub(super) fn grow(&self) -> Result<Field, Cancelled> {
        let receivers = self.gathering.receivers;
        let cells = Cells::new(receivers, &|i| self.gathering.kind(i as usize));
        let mut seeds = Seeds::new(self.components());
        self.sow(&mut seeds, &cells.alone)?;
        let (mut smooth, mut scales) = (Vec::new(), None);
        let mut parts: Vec<(Range<usize>, Option<u32>)> = cells
            .largest
            .iter()
            .map(|run| (run.clone(), None))
            .collect();
        while !parts.is_empty() {
            let picked: Vec<u32> = (parts.par_iter())
                .filter(|(_, seed)| seed.is_none())
                .map(|(run, _)| middle(receivers, &cells.order[run.clone()]))
                .collect();
            let mut next = seeds.next();
            self.sow(&mut seeds, &picked)?;
            let cell = |(run, seed): (Range<usize>, Option<u32>)| Cell {
                run,
                seed: seed.unwrap_or_else(|| next.next().expect("every cell has a seed")),
            };
            let whole: Vec<Cell> = parts.drain(..).map(cell).collect();
            let scales = match &mut scales {
                Some(known) => known,
                unknown => unknown.insert(self.scales(&seeds)?),
            };
            let is_rough = self.rough(&seeds.index(), (&cells.order, &whole), scales);
            for (cell, is_rough) in whole.into_iter().zip(is_rough) {
                if is_rough {
                    parts.extend(quarters(&cells, &seeds, &cell));
                } else if cell.run.len() > 1 {
                    smooth.push(cell);
                }
            }
        }
        Ok(Field {
            cells,
            seeds,
            smooth,
            scales: scales.unwrap_or_default(),
        })
    }

    /// Which of `cells`, runs of `order`, have to be cut.
    fn rough(
        &self,
        index: &SeedIndex<'_>,
        (order, cells): (&[u32], &[Cell]),
        scales: &[Option<f64>],
    ) -> Vec<bool> {
        let limit = ROUGH * self.settings.tolerance;
        let (receivers, tracer) = (self.gathering.receivers, self.gathering.scene.tracer);
        let is_rough = |cell: &Cell| {
            if cell.run.len() == 1 {
                return false;
            }
            let own = index.seeds.receiver[cell.seed as usize];
            let is_foretold = || {
                index
                    .fit(cell.seed)
                    .is_some_and(|fit| base::relative(self.base, &fit.surprise, scales) <= limit)
            };
            room::is_crowded(tracer, receivers, &order[cell.run.clone()], own) || !is_foretold()
        };
        cells.par_iter().map(is_rough).collect()
    }
}

/// The receiver of a cell that is nearest to its middle.
fn middle(receivers: &Receivers, cell: &[u32]) -> u32 {
    let position = |i: u32| receivers.position[i as usize];
    let mean = cell.iter().map(|&i| position(i)).sum::<Vec3>() / cell.len() as f32;
    let nearer = |&a: &u32, &b: &u32| {
        let [x, y] = [a, b].map(|i| position(i).distance_squared(mean));
        x.total_cmp(&y).then(a.cmp(&b))
    };
    (cell.iter().copied().min_by(nearer)).expect("a cell has receivers")
}

/// The four parts of a cell; the one that its seed is in keeps it.
fn quarters(cells: &Cells, seeds: &Seeds, cell: &Cell) -> Vec<(Range<usize>, Option<u32>)> {
    let parts = halves(&cell.run)
        .into_iter()
        .flat_map(|half| match half.len() {
            1 => vec![half],
            _ => halves(&half).to_vec(),
        });
    let own = seeds.receiver[cell.seed as usize];
    let part = |run: Range<usize>| {
        let has_it = cells.order[run.clone()].contains(&own);
        (run, has_it.then_some(cell.seed))
    };
    parts.map(part).collect()
}
