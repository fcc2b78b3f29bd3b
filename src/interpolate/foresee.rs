//! A run → how many of its receivers it will be gathered at, told by a few runs of neighbors.

use super::grow::Strictness;
use super::steps::{Fault, Sight};
use super::{Gathering, InterpolateSettings, Work, base, pays};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather;
use crate::receivers::Receivers;

/// Neighbors looked at together, and how many times.
const RUN: usize = 1024;
const RUNS: usize = 16;

/// Of a run's receivers, at most one in so many is looked at.
const ONE_IN: usize = 4;

/// Share of all receivers that [`super::gather()`] would gather at if nothing is refused; `None` where it would gather at all,
/// or where there are too few to tell. A few percent of what gathering at all costs.
///
/// # Errors
/// When cancelled.
pub fn foresee(
    gathering: Gathering<'_>,
    settings: InterpolateSettings,
    diagnostics: &Diagnostics,
) -> Result<Option<f64>, Cancelled> {
    let (receivers, aovs) = (gathering.receivers, gathering.aovs);
    let base = base::of(gathering.scene, aovs);
    if base.is_empty() || !pays(receivers, aovs) || receivers.len() < ONE_IN * RUN * RUNS {
        return Ok(None);
    }
    let few = receivers.subset(&runs(receivers));
    let work = Work {
        gathering: Gathering {
            receivers: &few,
            kinds: None,
            ..gathering
        },
        sight: Sight::full(gathering),
        base: &base,
        settings,
        diagnostics,
    };
    let mut field = work.plant()?;
    work.grow(&mut field, Strictness::FIRST, &Fault::All)?;
    Ok(Some(field.seeds.len() as f64 / few.len() as f64))
}

/// Runs of neighbors, spread over all.
fn runs(receivers: &Receivers) -> Vec<usize> {
    let order = gather::neighbors(receivers);
    let apart = order.len() / RUNS;
    let run = |k: usize| &order[k * apart + (apart - RUN) / 2..][..RUN];
    (0..RUNS).flat_map(run).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::testing::receivers_at;
    use glam::Vec3;

    #[test]
    fn runs_are_of_neighbors_and_no_receiver_is_in_two() {
        let side = 300;
        let places = (0..side * side).map(|i| {
            let (x, z) = ((i % side) as f32, (i / side) as f32);
            (Vec3::new(x, 0.0, z), Vec3::Y)
        });
        let receivers = receivers_at(&places.collect::<Vec<_>>());
        let all = runs(&receivers);
        for run in all.chunks(RUN) {
            let middle = run.iter().map(|&i| receivers.position[i]).sum::<Vec3>() / RUN as f32;
            let far = |&&i: &&usize| receivers.position[i].distance(middle) > 100.0;
            assert!(run.iter().filter(far).count() < RUN / 4);
        }
        let mut once = all.clone();
        once.sort_unstable();
        once.dedup();
        assert_eq!(once.len(), RUN * RUNS);
    }
}
