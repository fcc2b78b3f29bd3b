//! Seeds → values of all receivers, and whether these are true.

use super::base;
use super::blend::Blend;
use super::grow::{Cell, Field, Strictness};
use super::seeds::{ASKED, SeedIndex, Seeds};
use super::{Fault, Kind, Work};
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

/// Blended values of a kind may differ from gathered ones by this much of the tolerance: the engine's own error, by which
/// neighbors differ a little, is in that. Rooms and teapots have 0.7 to 1.1, a scan with pits 3 to 15.
const UNTRUE: f64 = 1.3;

/// Seeds may say of a receiver, by weight, what is this much of the tolerance off the blend; and times that cells where it is
/// more are cut. On a curved lip seeds beside a cell foretell far more than there is: under a sky two teapots on a plane had
/// pixels off by three times the mean, so that rays saw for all.
const DISPUTED: f64 = 2.0;
const ROUNDS: u32 = 3;

/// Share of the receivers in such cells at first with which none is cut: rays will see for nearly all. Scenes by code have up to
/// 0.05, a scan with pits has 0.5.
const MOST_DISPUTED: f64 = 0.2;

/// Values of all receivers.
pub(super) struct Told {
    /// Of the base, side by side.
    pub(super) values: Vec<f32>,
    /// Receivers whose values are blended.
    pub(super) blended: Vec<u32>,
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
    /// Take the values of a cell of `field`, those of its seed aside; those whom nobody may speak for go to `orphans`.
    fn take(&mut self, field: &Field, cell: &Cell, blended: &Blended, orphans: &mut Vec<u32>) {
        let (cells, seeds) = (&field.cells, &field.seeds);
        let n = seeds.components;
        let own = seeds.receiver[cell.seed as usize];
        let run = cells.order[cell.run.clone()].iter();
        let run = (run.zip(blended.values.chunks_exact(n))).zip(&blended.is_told);
        for ((&i, value), is_told) in run.filter(|((i, _), _)| **i != own) {
            if *is_told {
                self.values[i as usize * n..][..n].copy_from_slice(value);
                self.blended.push(i);
            } else {
                orphans.push(i);
            }
        }
    }

    /// Put gathered values in place of blended ones.
    fn replace(&mut self, seeds: &Seeds) {
        let n = seeds.components;
        for (&i, value) in seeds.receiver.iter().zip(seeds.values.chunks_exact(n)) {
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
        };
        let mut cells = std::mem::take(&mut field.smooth);
        for round in 0.. {
            let blended = self.blend(field, &cells);
            let is_disputed = |blended: &Blended| {
                strictness.is_some() && blended.dispute > DISPUTED * self.settings.tolerance
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
            self.sow(&mut field.seeds, &orphans)?;
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
        let gradients = gradients(&index, &asked);
        let blend = |(cell, asked): (&Cell, &Vec<u32>)| {
            let (blend, mut voices) = (Blend::new(seeds, &gradients, asked), Vec::new());
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

    /// Whose blended values are not true, if any. Some receivers are gathered at to find out, which keep what was blended:
    /// among blended neighbors their own would be seen.
    pub(super) fn untrue(
        &self,
        told: &Told,
        field: &mut Field,
    ) -> Result<Option<Fault>, Cancelled> {
        let count = (told.blended.len() / CHECKED).max(FEWEST_CHECKED);
        let kind = |i: u32| self.gathering.kind(i as usize);
        let mut picks: Vec<u32> = (spread(told.blended.len(), count).into_iter())
            .map(|k| told.blended[k])
            .collect();
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
        let limit = (UNTRUE * self.settings.tolerance).powi(2);
        let is_untrue = |errors: &[(Kind, f64)]| {
            let square: f64 = errors.iter().map(|(_, square)| square).sum();
            square / errors.len().max(1) as f64 > limit
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
}

/// How each component of every seed changes with place; zero of those that nobody asks and of those that do not know.
fn gradients(index: &SeedIndex<'_>, asked: &[Vec<u32>]) -> Vec<Vec3> {
    let n = index.seeds.components;
    let mut is_asked = vec![false; index.seeds.len()];
    for &seed in asked.iter().flatten() {
        is_asked[seed as usize] = true;
    }
    let gradient = |seed: u32| {
        let fit = is_asked[seed as usize].then(|| index.fit(seed)).flatten();
        fit.map_or_else(|| vec![Vec3::ZERO; n], |fit| fit.gradient)
    };
    (index.seeds.all().into_par_iter())
        .flat_map_iter(gradient)
        .collect()
}
