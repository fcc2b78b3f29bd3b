//! A cell → whether it has room enough for its seed to speak for all of it: the nearer things are, and the more its surface
//! bends, the faster what it sees changes. Ward and Heckbert, *Irradiance Gradients* (1992).

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

/// Rays that look around: a few of them meet whatever is near, and they cost little of what the receiver itself does.
const LOOKS: u32 = 32;

impl Room {
    /// True if there is something near `cell`, or a fold in it, for its size: what `seed` sees, one of its receivers, is not
    /// what all of them see.
    pub(super) fn is_crowded(
        self,
        tracer: &Tracer,
        receivers: &Receivers,
        cell: &[u32],
        seed: u32,
    ) -> bool {
        let own = seed as usize;
        let farthest = |values: &[Vec3]| {
            let apart = |&i: &u32| values[i as usize].distance(values[own]);
            cell.iter().map(apart).fold(0.0, f32::max)
        };
        farthest(&receivers.normal) > self.bent
            || farthest(&receivers.position) > self.crowded * room(tracer, receivers, own)
    }
}

/// Harmonic mean of the distances to what receiver `i` sees, stage units; infinite under an open sky.
fn room(tracer: &Tracer, receivers: &Receivers, i: usize) -> f32 {
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
