//! How a candidate whose neighbors share their work is looked at: at whole groups of them, as a run has them.

use super::{Bench, Judge};
use crate::diagnostics::Cancelled;
use crate::gather::{self, estimate::spread};
use crate::pilot::error::Weighted;
use crate::pilot::{Candidate, Method};
use crate::receivers::Receivers;

/// Groups looked at, each around another one of the pilot's receivers: a thirteenth of the run's receivers; and those that a
/// glance is for.
const GROUPS: usize = 48;
const FEW_GROUPS: usize = 6;

/// Whole groups of neighbors.
pub(super) struct Groups {
    receivers: Receivers,
    /// Which of the pilot's receivers are in them.
    few: Vec<usize>,
    /// Where they are among `receivers`.
    places: Vec<usize>,
}

impl Groups {
    /// The groups of `count` of `picks`, which are among `all`.
    fn around(all: &Receivers, picks: &[usize], count: usize) -> Self {
        let few = spread(picks.len(), count.min(picks.len()));
        let chosen: Vec<usize> = few.iter().map(|&k| picks[k]).collect();
        let (members, places) = gather::groups(all, &chosen);
        Self {
            receivers: all.subset(&members),
            few,
            places,
        }
    }
}

impl Bench<'_, '_, '_> {
    /// Seconds a receiver of `method`, which sees groups, by few of them.
    pub(super) fn glanced(&self, method: &dyn Method) -> Result<f64, Cancelled> {
        let groups = Groups::around(self.pilot.receivers, &self.sample.picks, FEW_GROUPS);
        Ok(self.look(method, &groups.receivers)?.seconds_per_receiver)
    }

    /// Seconds a receiver of `method` and its errors.
    pub(super) fn tried(
        &mut self,
        (candidate, method): (&Candidate<'_>, &dyn Method),
        judge: &Judge,
    ) -> Result<(f64, Vec<f64>), Cancelled> {
        if !candidate.sees_groups {
            let look = self.look(method, &self.few)?;
            let both = (&look.results, &judge.reference);
            let weighted = Weighted(&self.sample.weights);
            let errors = self.without_reference(both, judge, weighted);
            return Ok((look.seconds_per_receiver, errors));
        }
        let groups = match self.groups.take() {
            Some(groups) => groups,
            None => Groups::around(self.pilot.receivers, &self.sample.picks, GROUPS),
        };
        let look = self.look(method, &groups.receivers)?;
        let run = look.results.subset(&groups.places);
        let reference = judge.reference.subset(&groups.few);
        let weights = &self.sample.weights;
        let weights: Vec<f64> = groups.few.iter().map(|&k| weights[k]).collect();
        let errors = self.without_reference((&run, &reference), judge, Weighted(&weights));
        self.groups = Some(groups);
        Ok((look.seconds_per_receiver, errors))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::testing::receivers_at;
    use glam::Vec3;

    #[test]
    fn the_pilots_receivers_are_found_again_among_their_neighbors() {
        let places: Vec<_> = (0..5_000)
            .map(|i| {
                (
                    Vec3::new((i * 37 % 71) as f32, (i % 113) as f32, 0.0),
                    Vec3::Z,
                )
            })
            .collect();
        let all = receivers_at(&places);
        let picks = spread(all.len(), 200);
        let groups = Groups::around(&all, &picks, GROUPS);
        assert!(groups.places.len() == GROUPS && groups.receivers.len() > 3_000);
        for (&k, &place) in groups.few.iter().zip(&groups.places) {
            assert_eq!(groups.receivers.position[place], all.position[picks[k]]);
        }
    }
}
