//! What an error of 1 in a base AOV is an error of, in what was asked for.

use super::Work;
use super::seeds::Seeds;
use crate::diagnostics::Cancelled;
use crate::gather::estimate::spread;
use crate::results::{Aov, AovBuffer, Results};
use std::ops::Range;

/// Seeds that tell how much of an AOV hangs on a base AOV.
const ASKED: usize = 64;

impl Work<'_> {
    /// For each base AOV: the error of its values that makes a relative error of 1, over the mean, in the AOV asked for that
    /// hangs on it most. `None` where its error is that of another base AOV.
    pub(super) fn scales(&self, seeds: &Seeds) -> Result<Vec<Option<f64>>, Cancelled> {
        let shares = self.shares(seeds)?;
        let mut start = 0;
        let scale = |(&aov, share): (&Aov, f64)| {
            let range = start..start + aov.components();
            start = range.end;
            is_measured(aov).then(|| {
                let mean = mean(seeds, range);
                if mean > 0.0 { mean / share } else { 1.0 }
            })
        };
        Ok(self.base.iter().zip(shares).map(scale).collect())
    }

    /// Largest part, 0…1, of an AOV asked for that each base AOV makes.
    fn shares(&self, seeds: &Seeds) -> Result<Vec<f64>, Cancelled> {
        let picks = spread(seeds.len(), ASKED);
        let few: Vec<usize> = picks
            .iter()
            .map(|&seed| seeds.receiver[seed] as usize)
            .collect();
        let few = self.gathering.receivers.subset(&few);
        let assemble = |values: &[f32]| self.assemble(self.blended(values), &few);
        let n = seeds.components;
        let values: Vec<f32> = (picks.iter())
            .flat_map(|&seed| &seeds.values[seed * n..][..n])
            .copied()
            .collect();
        let whole = assemble(&values)?;
        let mut start = 0;
        let mut share = |&aov: &Aov| {
            let range = start..start + aov.components();
            start = range.end;
            let aovs = self.gathering.aovs;
            if !is_measured(aov) || aovs.iter().any(|&asked| is_measured_as(asked, aov)) {
                return Ok(1.0);
            }
            let mut without = values.clone();
            for values in without.chunks_exact_mut(n) {
                values[range.clone()].fill(0.0);
            }
            let without = assemble(&without)?;
            Ok(largest_part(&whole, &without))
        };
        self.base.iter().map(&mut share).collect()
    }
}

/// The others err as the visibility does, where they are measured.
fn is_measured(aov: Aov) -> bool {
    matches!(
        aov,
        Aov::Visibility | Aov::IrradianceIndirect | Aov::SpecularIndirect
    )
}

/// True if `asked` errs as `base` does, though it may be made of others.
fn is_measured_as(asked: Aov, base: Aov) -> bool {
    match base {
        Aov::Visibility => asked.is_openness(),
        Aov::IrradianceIndirect => asked == Aov::RadianceSh,
        _ => false,
    }
}

fn mean(seeds: &Seeds, components: Range<usize>) -> f64 {
    let own = (seeds.values.chunks_exact(seeds.components))
        .flat_map(|values| &values[components.clone()]);
    let sum: f64 = own.map(|&x| f64::from(x.abs())).sum();
    sum / (seeds.len() * components.len()).max(1) as f64
}

/// Of the AOVs of `whole`, the largest part that is missing in `without`.
fn largest_part(whole: &Results, without: &Results) -> f64 {
    let part = |(whole, without): (&AovBuffer, &AovBuffer)| {
        let n = whole.aov.components();
        // Alpha is no light. Occlusion is measured as visibility.
        let colors = n.min(3);
        let is_covered = whole.aov == Aov::Occlusion;
        let read = |x: f32| f64::from(if is_covered { 1.0 - x } else { x });
        let (mut missing, mut all) = (0.0, 0.0);
        for (a, b) in whole.data.chunks_exact(n).zip(without.data.chunks_exact(n)) {
            for (&a, &b) in a[..colors].iter().zip(b) {
                missing += (read(a) - read(b)).abs();
                all += read(a).abs();
            }
        }
        if all > 0.0 { missing / all } else { 0.0 }
    };
    let parts = whole.buffers.iter().zip(&without.buffers).map(part);
    parts.fold(0.0, f64::max)
}
