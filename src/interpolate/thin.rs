//! Receivers who speak for nobody, in pixels that have many: a few rays of each do.

use super::seeds::Seeds;
use super::{Work, base};
use crate::diagnostics::Cancelled;
use crate::gather::{self, Engine, Glance, Hemisphere};

/// Others of a cell who take no more than so many times the rays of one, and no more than this part of all rays each, are seen at
/// once: three seeds more would tell whether they need to be.
const SOON: f64 = 6.0;
const FEW: f64 = 0.6;

/// What was seen at those who speak for nobody.
#[derive(Debug, Default)]
pub(super) struct Alone {
    receiver: Vec<u32>,
    /// Of the base, side by side.
    values: Vec<f32>,
    /// How many of them looked twice.
    looked_twice: usize,
}

impl Alone {
    pub(super) fn len(&self) -> usize {
        self.receiver.len()
    }

    /// True if some looked once only.
    pub(super) fn can_look_again(&self) -> bool {
        self.looked_twice < self.len()
    }

    /// Forget what was seen at these receivers.
    pub(super) fn take(&mut self) -> Vec<u32> {
        std::mem::take(self).receiver
    }

    /// Put what was seen to the values of all receivers.
    pub(super) fn tell(&self, all: &mut [f32]) {
        put(all, &self.receiver, &self.values);
    }
}

/// Put the values of the receivers `which`, side by side, to their places among those of all.
fn put(all: &mut [f32], which: &[u32], values: &[f32]) {
    let n = values.len() / which.len().max(1);
    for (&i, value) in which.iter().zip(values.chunks_exact(n.max(1))) {
        all[i as usize * n..][..n].copy_from_slice(value);
    }
}

impl Work<'_> {
    /// Gather at the receivers `which`, who need not speak for others: with few rays, where those do.
    pub(super) fn finish(
        &self,
        (seeds, alone): (&mut Seeds, &mut Alone),
        which: &[u32],
    ) -> Result<(), Cancelled> {
        let Some(thin) = self.gathering.thin else {
            return self.sow(seeds, which);
        };
        thin.try_each((which, Glance::First), &mut |engine, which| {
            let Some(engine) = engine else {
                return self.sow(seeds, which);
            };
            alone.receiver.extend_from_slice(which);
            alone.values.extend(self.values(engine, which)?);
            Ok(())
        })
    }

    /// Let those who looked once do so in other directions too: the mean counts.
    pub(super) fn look_again_alone(&self, alone: &mut Alone) -> Result<(), Cancelled> {
        let Some(thin) = self.gathering.thin else {
            return Ok(());
        };
        let (n, first) = (self.components(), alone.looked_twice);
        let once = &alone.receiver[first..];
        let mut again = vec![0.0; n * self.gathering.receivers.len()];
        thin.try_each((once, Glance::Again), &mut |engine, which| {
            if let Some(engine) = engine {
                put(&mut again, which, &self.values(engine, which)?);
            }
            Ok(())
        })?;
        for (&i, values) in once
            .iter()
            .zip(alone.values[first * n..].chunks_exact_mut(n))
        {
            for (value, more) in values.iter_mut().zip(&again[i as usize * n..]) {
                *value = 0.5 * (*value + more);
            }
        }
        alone.looked_twice = alone.len();
        Ok(())
    }

    /// True if it is as well to gather at all of `others`, who are in one cell with a seed, as to cut it.
    pub(super) fn is_thin(&self, others: impl Iterator<Item = u32>) -> bool {
        self.gathering.thin.is_some_and(|thin| {
            let share = |i: u32| thin.thinning().class(i as usize).share();
            let (rays, count) = others.fold((0.0, 0.0), |(rays, count), i| {
                (rays + share(i), count + 1.0)
            });
            rays <= SOON && rays <= FEW * count
        })
    }

    /// What `engine` sees at the receivers `which`, of the base.
    fn values(&self, engine: &dyn Engine, which: &[u32]) -> Result<Vec<f32>, Cancelled> {
        let few = self.few(which);
        let reading = |i: usize, hemisphere: &Hemisphere, out: &mut [f32]| {
            base::read(self.base, (&few, i), hemisphere, out);
        };
        gather::read(
            engine,
            &few,
            (self.components(), &reading),
            self.diagnostics,
        )
    }
}
