//! Seeds → values of all receivers, and whether these are true.

use super::base;
use super::blend::{Around, Blend};
use super::fit::Fit;
use super::grow::{Cell, Field, Strictness};
use super::seeds::{ASKED, SeedIndex, Seeds};
use super::steps::Fault;
use super::{Kind, Work};
use crate::diagnostics::Cancelled;
use crate::gather::estimate::spread;
use glam::Vec3;
use rayon::prelude::*;

/// One in so many blended receivers is gathered at to see whether its values are true, a tenth of what is gathered in a room;
/// and how many at least.
const CHECKED: usize = 128;
const FEWEST_CHECKED: usize = 256;

/// Checked receivers of a kind that tell something about it.
const FEWEST_OF_KIND: usize = 8;

/// Blended values of a kind may differ from gathered ones by this much of the tolerance: both may be off by it. Rooms and teapots
/// have 0.7 to 1.3, a scan with pits 3 to 15.
const UNTRUE: f64 = std::f64::consts::SQRT_2;

/// So much more, over the root of their number, the mean square of few may be by chance: a handle's nine receivers had 1.5.
const CHANCE: f64 = 2.0;

/// Seeds may say of a receiver, by weight, what is this much of the tolerance off the blend; and times that cells where it is
/// more are cut. On a curved lip seeds beside a cell foretell far more than there is: under a sky two teapots on a plane had
/// pixels off by three times the mean, so that rays saw for all.
const DISPUTED: f64 = 2.0;
const ROUNDS: u32 = 3;

/// Share of the receivers in such cells at first with which none is cut: rays will see for nearly all. Scenes by code have up to
/// 0.05, a scan with pits has 0.5.
const MOST_DISPUTED: f64 = 0.2;

/// What rays err by differs from seed to seed: the mean of each and of what its neighbors foretell of it is nearer to the truth,
/// as long as these are off by less than so many times the tolerance, and not at all where it is more: there is something to be
/// seen. Cornell box, teapots, room, 512², with (1.5, 2.5): 0.79, 0.81, 0.85 of the error at 5 %, 0.81, 0.83, 0.92 at 2 %, and
/// walls without smudges.
const EVEN: (f64, f64) = (2.25, 3.75);

/// Many neighbors are asked where they are off by less than this; where it is more, the nearest ones are.
const EVEN_OF_MANY: f64 = 1.5;

/// Values of all receivers.
pub(super) struct Told {
    /// Of the base, side by side.
    pub(super) values: Vec<f32>,
    /// Receivers whose values are blended.
    pub(super) blended: Vec<u32>,
    /// Seeds among others who have values evened with these.
    evened: Vec<bool>,
}

/// Values of the receivers of a cell.
struct Blended {
    /// Side by side.
    values: Vec<f32>,
    /// False for those whom no seed may speak for.
    is_told: Vec<bool>,
    /// How far what seeds say is from the blend: relative, root of the mean square.
    dispute: f64,
}

impl Told {
    /// Take the values of a cell of `field`; those whom nobody may speak for go to `orphans`.
    fn take(&mut self, field: &Field, cell: &Cell, blended: &Blended, orphans: &mut Vec<u32>) {
        let (cells, seeds) = (&field.cells, &field.seeds);
        let n = seeds.components;
        let own = seeds.receiver[cell.seed as usize];
        let run = cells.order[cell.run.clone()].iter();
        let run = (run.zip(blended.values.chunks_exact(n))).zip(&blended.is_told);
        for ((&i, value), &is_told) in run {
            if is_told {
                self.values[i as usize * n..][..n].copy_from_slice(value);
            }
            match (i == own, is_told) {
                (true, _) => self.evened[i as usize] = is_told,
                (false, true) => self.blended.push(i),
                (false, false) => orphans.push(i),
            }
        }
    }

    /// Put gathered values in place of blended ones, where they are not evened.
    fn replace(&mut self, seeds: &Seeds) {
        let n = seeds.components;
        let gathered = seeds.receiver.iter().zip(seeds.values.chunks_exact(n));
        for (&i, value) in gathered.filter(|(i, _)| !self.evened[**i as usize]) {
            self.values[i as usize * n..][..n].copy_from_slice(value);
        }
        let is_seed = seeds.marks(self.values.len() / n);
        self.blended.retain(|&i| !is_seed[i as usize]);
    }
}

impl Work<'_> {
    /// Values of all receivers. With a `strictness`, cells of whose receivers seeds say different things are cut.
    pub(super) fn tell(
        &self,
        field: &mut Field,
        strictness: Option<Strictness>,
    ) -> Result<Told, Cancelled> {
        let mut told = Told {
            values: vec![0.0; field.seeds.components * self.gathering.receivers.len()],
            blended: Vec::new(),
            evened: vec![false; self.gathering.receivers.len()],
        };
        let mut cells = std::mem::take(&mut field.smooth);
        for round in 0.. {
            let blended = self.blend(field, &cells);
            let is_disputed = |blended: &Blended| {
                strictness.is_some() && blended.dispute > DISPUTED * self.slack()
            };
            let receivers = |is_counted: &dyn Fn(&Blended) -> bool| -> usize {
                let counted = cells.iter().zip(&blended).filter(|it| is_counted(it.1));
                counted.map(|(cell, _)| cell.run.len()).sum()
            };
            let few = receivers(&|_| true) as f64 * MOST_DISPUTED;
            let cuts = round < ROUNDS && (round > 0 || receivers(&is_disputed) as f64 <= few);
            let (disputed, agreed): (Vec<_>, Vec<_>) = (cells.into_iter().zip(blended))
                .partition(|(_, blended)| cuts && is_disputed(blended));
            let mut orphans = Vec::new();
            for (cell, blended) in &agreed {
                told.take(field, cell, blended, &mut orphans);
            }
            self.finish((&mut field.seeds, &mut field.alone), &orphans)?;
            field
                .smooth
                .extend(agreed.into_iter().map(|(cell, _)| cell));
            let disputed: Vec<Cell> = disputed.into_iter().map(|(cell, _)| cell).collect();
            let Some(strictness) = strictness.filter(|_| !disputed.is_empty()) else {
                break;
            };
            cells = self.regrow(field, strictness, &disputed)?;
        }
        told.replace(&field.seeds);
        field.alone.tell(&mut told.values);
        Ok(told)
    }

    /// Values of all in `cells`.
    fn blend(&self, field: &Field, smooth: &[Cell]) -> Vec<Blended> {
        let Field { cells, seeds, .. } = field;
        let (receivers, n) = (self.gathering.receivers, seeds.components);
        let index = seeds.index();
        let asked: Vec<Vec<u32>> = (smooth.par_iter())
            .map(|cell| index.near(cell.seed, ASKED))
            .collect();
        let around = self.around(&index, &asked, &field.scales);
        let blend = |(cell, asked): (&Cell, &Vec<u32>)| {
            let (blend, mut voices) = (Blend::new(seeds, &around, asked), Vec::new());
            let run = &cells.order[cell.run.clone()];
            let (mut values, mut apart) = (vec![0.0; n * run.len()], vec![0.0; n]);
            let (mut is_told, mut square) = (Vec::with_capacity(run.len()), 0.0);
            for (&i, out) in run.iter().zip(values.chunks_exact_mut(n)) {
                let at = (receivers, i as usize);
                let has_voices = blend.at(at, &mut voices, (&mut *out, &mut apart));
                is_told.push(has_voices);
                if has_voices {
                    square += base::relative(self.base, &apart, &field.scales).powi(2);
                }
            }
            Blended {
                values,
                is_told,
                dispute: (square / run.len() as f64).sqrt(),
            }
        };
        (smooth.par_iter().zip(&asked)).map(blend).collect()
    }

    /// Whose blended values are not true, if any of those are that had this `fault` before. Some receivers are gathered at to
    /// find out, which keep what was blended: among blended neighbors their own would be seen.
    pub(super) fn untrue(
        &self,
        told: &Told,
        field: &mut Field,
        fault: &Fault,
    ) -> Result<Option<Fault>, Cancelled> {
        let kind = |i: u32| self.gathering.kind(i as usize);
        let changed = told.blended.iter().filter(|&&i| fault.holds(kind(i)));
        let changed: Vec<u32> = changed.copied().collect();
        let count = (changed.len() / CHECKED).max(FEWEST_CHECKED);
        let picks = spread(changed.len(), count).into_iter();
        let mut picks: Vec<u32> = picks.map(|k| changed[k]).collect();
        picks.sort_by_key(|&i| kind(i));
        let n = self.components();
        let mut truth = Seeds::new(n);
        self.sow(&mut truth, &picks)?;
        let error = |(&i, truth): (&u32, &[f32])| {
            let blended = &told.values[i as usize * n..][..n];
            let off: Vec<f32> = blended.iter().zip(truth).map(|(a, b)| a - b).collect();
            (
                kind(i),
                base::relative(self.base, &off, &field.scales).powi(2),
            )
        };
        let errors: Vec<(Kind, f64)> = (picks.iter().zip(truth.values.chunks_exact(n)))
            .map(error)
            .collect();
        let limit = (UNTRUE * self.slack()).powi(2);
        let is_untrue = |errors: &[(Kind, f64)]| {
            let square: f64 = errors.iter().map(|(_, square)| square).sum();
            let count = errors.len().max(1) as f64;
            square / count > limit * (1.0 + CHANCE / count.sqrt())
        };
        let untrue: Vec<Kind> = (errors.chunk_by(|a, b| a.0 == b.0))
            .filter(|errors| errors.len() >= FEWEST_OF_KIND && is_untrue(errors))
            .map(|errors| errors[0].0)
            .collect();
        let rest: Vec<(Kind, f64)> = (errors.into_iter())
            .filter(|(kind, _)| untrue.binary_search(kind).is_err())
            .collect();
        // All others together: each may have too few receivers to be judged alone.
        field.checked += picks.len();
        Ok(match untrue.is_empty() {
            _ if is_untrue(&rest) => Some(Fault::All),
            true => None,
            false => Some(Fault::Of(untrue)),
        })
    }

    /// What is around every seed that is asked; zero where nobody asks or knows.
    fn around(&self, index: &SeedIndex<'_>, asked: &[Vec<u32>], scales: &[Option<f64>]) -> Around {
        let n = index.seeds.components;
        let mut is_asked = vec![false; index.seeds.len()];
        for &seed in asked.iter().flatten() {
            is_asked[seed as usize] = true;
        }
        let of_seed = |(seed, (gradient, shift)): (u32, (&mut [Vec3], &mut [f32]))| {
            let fit = is_asked[seed as usize].then(|| index.fit(seed)).flatten();
            let Some(fit) = fit else {
                return;
            };
            gradient.copy_from_slice(&fit.gradient);
            let off = |fit: &Fit| base::relative(self.base, &fit.surprise, scales) / self.slack();
            let wide = index.wide_fit(seed).filter(|fit| off(fit) < EVEN_OF_MANY);
            let even = wide.as_ref().unwrap_or(&fit);
            let believed = ((EVEN.1 - off(even)) / (EVEN.1 - EVEN.0)).clamp(0.0, 1.0);
            #[expect(clippy::cast_possible_truncation, reason = "a part of 1")]
            let share = even.share * believed as f32;
            for (shift, surprise) in shift.iter_mut().zip(&even.surprise) {
                *shift = share * surprise;
            }
        };
        let mut around = Around {
            gradient: vec![Vec3::ZERO; n * is_asked.len()],
            shift: vec![0.0; n * is_asked.len()],
        };
        let columns = around.gradient.par_chunks_mut(n);
        let columns = columns.zip(around.shift.par_chunks_mut(n));
        index
            .seeds
            .all()
            .into_par_iter()
            .zip(columns)
            .for_each(of_seed);
        around
    }
}
