//! Cells → seeds, as many as what they see asks for.

use super::cells::{Cells, halves};
use super::room::Room;
use super::seeds::Seeds;
use super::steps::Fault;
use super::thin::Alone;
use super::{Kind, Work, base};
use crate::diagnostics::Cancelled;
use crate::receivers::Receivers;
use crate::results::Aov;
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
    pub(super) alone: Alone,
    /// Cells whose other receivers are to be blended, of more than one receiver once they are grown.
    pub(super) smooth: Vec<Cell>,
    /// See [`Work::scales`].
    pub(super) scales: Vec<Option<f64>>,
    /// Blended receivers that were gathered at to see whether their values are true; they keep these.
    pub(super) checked: usize,
    /// What seeds see when they look once, if they have looked more often: of the first so many.
    pub(super) before: Option<Vec<f32>>,
    /// For the first so many seeds fewer saw, twice.
    pub(super) by_fewer: usize,
}

/// How much a cell may differ from its neighbors and still be smooth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Strictness {
    /// What a seed's neighbors foretell may be off by this much of the tolerance: most of that is what rays err by there and here.
    /// They are twice as far away as the seed is from what it speaks for, where errors are a quarter. Where cells are cut that
    /// are off by half as much, 1.15 to 1.25 times as many seeds are 1.05 to 1.1 times as far off (Cornell box, two teapots, 5
    /// and 2 %): those that stand closer speak for fewer.
    rough: f64,
    /// What is near enough to make a cell crowded, and how bent it may be.
    pub(super) room: Room,
}

impl Strictness {
    /// What is enough in most runs. Where 2.5 times as much is crowded and twice as much bent, two teapots in a box take 0.8 of
    /// the time and are a tenth farther off, but rough gloss is twice as far off.
    pub(super) const FIRST: Self = Self {
        rough: 3.0,
        room: Room {
            crowded: 0.1,
            bent: 0.2,
        },
    };

    /// Where it is not.
    pub(super) const SECOND: Self = Self {
        rough: 1.5,
        ..Self::FIRST
    };
}

impl Field {
    /// Take back what seeds saw when they looked otherwise: as all others see once.
    pub(super) fn forget_again(&mut self) {
        if let Some(before) = self.before.take() {
            self.seeds.values[..before.len()].copy_from_slice(&before);
        }
    }

    /// Take those cells out of the smooth ones that have this `fault`, each of the `kind` of its seed.
    pub(super) fn take_faulty(&mut self, fault: &Fault, kind: &dyn Fn(u32) -> Kind) -> Vec<Cell> {
        let seeds = &self.seeds.receiver;
        let is_faulty = |cell: &Cell| fault.holds(kind(seeds[cell.seed as usize]));
        let (faulty, smooth) = std::mem::take(&mut self.smooth)
            .into_iter()
            .partition(is_faulty);
        self.smooth = smooth;
        faulty
    }
}

/// A run of receivers, and the seed it has already.
type Part = (Range<usize>, Option<u32>);

impl Work<'_> {
    /// Gather at one seed in each of the largest cells.
    pub(super) fn plant(&self) -> Result<Field, Cancelled> {
        let cells = Cells::new(self.gathering.receivers, &|i| {
            self.gathering.kind(i as usize)
        });
        let mut seeds = Seeds::new(self.components());
        let mut alone = Alone::default();
        self.finish((&mut seeds, &mut alone), &cells.alone)?;
        let largest = cells.largest.iter().map(|run| (run.clone(), None));
        let smooth = self.sow_parts((&cells, &mut seeds), largest.collect())?;
        let scales = self.scales(&seeds)?;
        Ok(Field {
            cells,
            seeds,
            alone,
            smooth,
            scales,
            checked: 0,
            before: None,
            by_fewer: 0,
        })
    }

    /// True if what the seeds of a new `field` see is so smooth that their neighbors even out much of what they err by.
    pub(super) fn is_calm(&self, field: &Field) -> bool {
        let is_rough = self.rough(field, &field.smooth, Strictness::FIRST);
        let smooth = (field.smooth.iter().zip(is_rough)).filter(|(_, is_rough)| !is_rough);
        let count: usize = smooth.map(|(cell, _)| cell.run.len()).sum();
        count as f64 >= CALM * self.gathering.receivers.len() as f64
    }

    /// Cut those cells of `field` that have this `fault`, and their parts, until all of them are smooth or have one receiver.
    pub(super) fn grow(
        &self,
        field: &mut Field,
        strictness: Strictness,
        fault: &Fault,
    ) -> Result<(), Cancelled> {
        let cells = field.take_faulty(fault, &|i| self.gathering.kind(i as usize));
        self.grow_cells(field, strictness, cells)
    }

    /// The same of `cells`, which are in none of `field`'s.
    fn grow_cells(
        &self,
        field: &mut Field,
        strictness: Strictness,
        mut cells: Vec<Cell>,
    ) -> Result<(), Cancelled> {
        while !cells.is_empty() {
            let is_rough = self.rough(field, &cells, strictness);
            let mut rough = Vec::new();
            for (cell, is_rough) in cells.into_iter().zip(is_rough) {
                if is_rough {
                    rough.push(cell);
                } else if cell.run.len() > 1 {
                    field.smooth.push(cell);
                }
            }
            cells = self.cut(field, &rough)?;
        }
        Ok(())
    }

    /// Cut `cells`, which are in none of `field`'s, however smooth they are, and then grow their parts. Those that are smooth
    /// are the value, and in none of `field`'s.
    pub(super) fn regrow(
        &self,
        field: &mut Field,
        strictness: Strictness,
        cells: &[Cell],
    ) -> Result<Vec<Cell>, Cancelled> {
        let before = field.smooth.len();
        let parts = self.cut(field, cells)?;
        self.grow_cells(field, strictness, parts)?;
        Ok(field.smooth.split_off(before))
    }

    /// The parts of `cells`, with seeds; not of those whose receivers all take less than these would.
    fn cut(&self, field: &mut Field, cells: &[Cell]) -> Result<Vec<Cell>, Cancelled> {
        let (mut parts, mut rest) = (Vec::new(), Vec::new());
        for cell in cells {
            let own = field.seeds.receiver[cell.seed as usize];
            let others = field.cells.order[cell.run.clone()].iter().copied();
            let others = others.filter(|&i| i != own);
            if self.is_thin(others.clone()) {
                rest.extend(others);
            } else {
                parts.extend(quarters(&field.cells, &field.seeds, cell));
            }
        }
        self.finish((&mut field.seeds, &mut field.alone), &rest)?;
        self.sow_parts((&field.cells, &mut field.seeds), parts)
    }

    /// Give those of `parts` a seed that have none.
    fn sow_parts(
        &self,
        (cells, seeds): (&Cells, &mut Seeds),
        parts: Vec<Part>,
    ) -> Result<Vec<Cell>, Cancelled> {
        let receivers = self.gathering.receivers;
        let picked: Vec<u32> = (parts.par_iter())
            .filter(|(_, seed)| seed.is_none())
            .map(|(run, _)| middle(receivers, &cells.order[run.clone()]))
            .collect();
        let mut next = seeds.next();
        self.sow(seeds, &picked)?;
        let cell = |(run, seed): Part| Cell {
            run,
            seed: seed.unwrap_or_else(|| next.next().expect("every cell has a seed")),
        };
        Ok(parts.into_iter().map(cell).collect())
    }

    /// Which of `cells` have to be cut.
    fn rough(&self, field: &Field, cells: &[Cell], strictness: Strictness) -> Vec<bool> {
        let limit = strictness.rough * self.slack();
        let room = strictness.room.times(self.looseness());
        let (receivers, tracer) = (self.gathering.receivers, self.gathering.scene.tracer);
        let index = field.seeds.index();
        let is_rough = |cell: &Cell| {
            if cell.run.len() == 1 {
                return false;
            }
            let is_foretold = || {
                (index.fit(cell.seed)).is_some_and(|fit| {
                    base::relative(self.base, &fit.surprise, &field.scales) <= limit
                })
            };
            let run = &field.cells.order[cell.run.clone()];
            room.is_crowded(tracer, (receivers, run), (&field.seeds, cell.seed)) || !is_foretold()
        };
        cells.par_iter().map(is_rough).collect()
    }

    /// How much less room cells need than at [`ROOM_IS_FOR`]: what is blended errs by the square of how far its seeds are, over
    /// the room they have. Narrow lobes see farther things, of which room tells nothing.
    fn looseness(&self) -> f32 {
        if self.base.contains(&Aov::SpecularIndirect) {
            return 1.0;
        }
        #[expect(clippy::cast_possible_truncation, reason = "a ratio")]
        let times = (self.settings.tolerance / ROOM_IS_FOR).sqrt() as f32;
        times.clamp(1.0, LOOSEST)
    }
}

/// Share of the receivers that are in the smooth ones of the largest cells where fewer rays may do. Boxes, rooms, a ball and a
/// bunny have 0.85 to 0.97, foliage, chessmen and a scan with pits 0.35 to 0.57.
const CALM: f64 = 0.75;

/// Tolerance that [`Strictness`] was found for, two teapots in a box: at 2 % 0.9 of the seeds that it asks for do.
const ROOM_IS_FOR: f64 = 0.0125;

/// What cells need at 5 % and more: 0.76 of the seeds of the same box and room then, and 1 to 3 % more error.
const LOOSEST: f32 = 1.6;

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
