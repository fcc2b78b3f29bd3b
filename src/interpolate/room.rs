//! A cell → whether it has room enough for its seed to speak for all of it: the nearer things are, and the more its surface
//! bends, the faster what it sees changes. Ward and Heckbert, *Irradiance Gradients* (1992).

use super::seeds::Seeds;
use crate::gather::Hemisphere;
use crate::math::sequence;
use crate::receivers::Receivers;
use crate::trace::Tracer;
use glam::Vec3;

/// How little of it makes a cell crowded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Room {
    /// Radius of a cell, over the room that its seed has.
    pub(super) crowded: f32,
    /// Difference of unit normals.
    pub(super) bent: f32,
}

/// Rays that look around where the engine does not tell how far away things are: a few of them meet whatever is near, and
/// they cost little of what the receiver itself does.
const LOOKS: u32 = 32;

impl Room {
    /// This much less room.
    pub(super) fn times(self, looseness: f32) -> Self {
        Self {
            crowded: self.crowded * looseness,
            bent: self.bent * looseness,
        }
    }

    /// True if there is something near `cell`, or a fold in it, for its size: what `seed` sees, one of its receivers, is not
    /// what all of them see.
    pub(super) fn is_crowded(
        self,
        tracer: &Tracer,
        (receivers, cell): (&Receivers, &[u32]),
        (seeds, seed): (&Seeds, u32),
    ) -> bool {
        let own = seeds.receiver[seed as usize] as usize;
        let farthest = |values: &[Vec3]| {
            let apart = |&i: &u32| values[i as usize].distance(values[own]);
            cell.iter().map(apart).fold(0.0, f32::max)
        };
        let room = || match seeds.room[seed as usize] {
            room if room.is_nan() => look(tracer, receivers, own),
            room => room,
        };
        farthest(&receivers.normal) > self.bent
            || farthest(&receivers.position) > self.crowded * room()
    }
}

/// Harmonic mean of the distances in `hemisphere`, whose engine tells them ([`crate::gather::Engine::tells_distances`]);
/// infinite under an open sky.
pub(super) fn of(hemisphere: &Hemisphere) -> f32 {
    let mut sums = (0.0, 0.0);
    for (&weight, &distance) in hemisphere.weight.iter().zip(&hemisphere.distance) {
        sums.0 += weight;
        sums.1 += weight / distance.max(f32::MIN_POSITIVE);
    }
    sums.0 / sums.1
}

/// The same of what receiver `i` sees, if nobody has told.
fn look(tracer: &Tracer, receivers: &Receivers, i: usize) -> f32 {
    let up = receivers.rim_normal(i);
    let origin = tracer.lift(receivers.position[i], up);
    let frame = sequence::transported_frame(up);
    let nearness = |k| {
        let local = sequence::cosine_hemisphere(sequence::fibonacci(k, LOOKS));
        let hit = tracer.closest(origin, frame.to_world(local), f32::INFINITY);
        hit.map_or(0.0, |hit| 1.0 / hit.distance.max(f32::MIN_POSITIVE))
    };
    LOOKS as f32 / (0..LOOKS).map(nearness).sum::<f32>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ceiling_leaves_one_and_a_half_times_its_height_and_the_sky_leaves_all() {
        let mut hemisphere = Hemisphere::default();
        for k in 0..1024 {
            let direction = sequence::cosine_hemisphere(sequence::fibonacci(k, 1024));
            hemisphere.weight.push(std::f32::consts::PI / 1024.0);
            hemisphere.distance.push(3.0 / direction.z);
        }
        // The mean of cos θ / 3, weighted by the cosine, is 2 / 9.
        assert!((of(&hemisphere) - 4.5).abs() < 0.01, "{}", of(&hemisphere));
        hemisphere.distance.fill(f32::INFINITY);
        assert_eq!(of(&hemisphere), f32::INFINITY);
        let close = Room {
            crowded: 0.1,
            bent: 0.2,
        };
        assert_eq!(close.times(2.0).crowded, 0.2);
    }
}
