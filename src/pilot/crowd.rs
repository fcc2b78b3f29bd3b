//! Receivers that tell costs: neighbors, as a run has them.

use crate::receivers::Receivers;
use rayon::prelude::*;

/// Groups of neighbors, and receivers in each: what looks along a direction together.
const GROUPS: usize = 4;
const GROUP: usize = 64;

/// A few groups of `receivers` next to each other. Receivers spread over the whole share no directions: 64 rays from 256
/// of the 526 323 points of a ball took 44 µs a receiver, from all of them 9. O(n).
pub fn crowd(receivers: &Receivers) -> Receivers {
    let count = receivers.len();
    let groups = GROUPS.min(count.div_ceil(GROUP));
    let mut chosen: Vec<usize> = (0..groups)
        .into_par_iter()
        .flat_map_iter(|k| around(receivers, (2 * k + 1) * count / (2 * groups)))
        .collect();
    chosen.sort_unstable();
    chosen.dedup();
    receivers.subset(&chosen)
}

/// The receivers nearest to receiver `i`, itself among them.
fn around(receivers: &Receivers, i: usize) -> Vec<usize> {
    let center = receivers.position[i];
    let places = receivers.position.iter().enumerate();
    let mut all: Vec<(f32, usize)> = places
        .map(|(k, place)| (place.distance_squared(center), k))
        .collect();
    if all.len() > GROUP {
        all.select_nth_unstable_by(GROUP, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        all.truncate(GROUP);
    }
    all.into_iter().map(|(_, k)| k).collect()
}
