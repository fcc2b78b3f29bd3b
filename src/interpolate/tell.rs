//! Seeds → values of all receivers, and whether these are true.

use super::base;
use super::blend::Blend;
use super::grow::{Cell, Field};
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

/// Values of all receivers.
pub(super) struct Told {
    /// Of the base, side by side.
    pub(super) values: Vec<f32>,
    /// Receivers whose values are blended.
    pub(super) blended: Vec<u32>,
}

impl Told {
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
    /// Values of all receivers.
    pub(super) fn tell(&self, field: &mut Field) -> Result<Told, Cancelled> {
        let (mut told, orphans) = self.blend(field);
        self.sow(&mut field.seeds, &orphans)?;
        told.replace(&field.seeds);
        Ok(told)
    }

    /// Values of all in smooth cells but the seeds; and those whom no seed may speak for.
    fn blend(&self, field: &Field) -> (Told, Vec<u32>) {
        let Field {
            cells,
            seeds,
            smooth,
            ..
        } = field;
        let (receivers, n) = (self.gathering.receivers, seeds.components);
        let index = seeds.index();
        let asked: Vec<Vec<u32>> = (smooth.par_iter())
            .map(|cell| index.near(cell.seed, ASKED))
            .collect();
        let gradients = gradients(&index, &asked);
        let blend = |(cell, asked): (&Cell, &Vec<u32>)| {
            let (blend, mut voices) = (Blend::new(seeds, &gradients, asked), Vec::new());
            let run = &cells.order[cell.run.clone()];
            let mut out = vec![0.0; n * run.len()];
            let is_told: Vec<bool> = (run.iter().zip(out.chunks_exact_mut(n)))
                .map(|(&i, out)| blend.at((receivers, i as usize), &mut voices, out))
                .collect();
            (out, is_told)
        };
        let found: Vec<(Vec<f32>, Vec<bool>)> =
            (smooth.par_iter().zip(&asked)).map(blend).collect();
        let mut told = Told {
            values: vec![0.0; n * receivers.len()],
            blended: Vec::new(),
        };
        let mut orphans = Vec::new();
        for (cell, (values, is_told)) in smooth.iter().zip(found) {
            let own = seeds.receiver[cell.seed as usize];
            let run = cells.order[cell.run.clone()].iter();
            let run = run.zip(values.chunks_exact(n)).zip(is_told);
            for ((&i, value), is_told) in run.filter(|((i, _), _)| **i != own) {
                if is_told {
                    told.values[i as usize * n..][..n].copy_from_slice(value);
                    told.blended.push(i);
                } else {
                    orphans.push(i);
                }
            }
        }
        (told, orphans)
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
