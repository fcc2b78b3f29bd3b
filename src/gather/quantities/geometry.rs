//! What a receiver is, without any light: normal, position, depth, prim.

use super::Seen;
use glam::Vec3;

/// Unit shading normal on the lit side.
pub fn normal(seen: &Seen<'_>) -> Vec3 {
    seen.receivers.normal[seen.index]
}

/// Absolute world position, stage units: added in f64, rounded once.
pub fn world_position(seen: &Seen<'_>) -> Vec3 {
    (seen.receivers.origin + seen.receivers.position[seen.index].as_dvec3()).as_vec3()
}

/// Distance along the viewing axis, stage units; 0 where no camera placed the receivers.
pub fn depth(seen: &Seen<'_>) -> f32 {
    seen.receivers.depth.get(seen.index).copied().unwrap_or(0.0)
}

/// Index of the prim, exact up to 2²⁴ prims (buffers hold floats).
pub fn prim_id(seen: &Seen<'_>) -> f32 {
    seen.receivers.prim[seen.index] as f32
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::receivers_at;
    use super::super::{BLACK_SURFACE, Seen};
    use super::*;
    use crate::gather::Hemisphere;
    use glam::DVec3;

    #[test]
    fn positions_are_absolute_and_keep_their_precision() {
        let mut receivers = receivers_at(&[(Vec3::new(0.25, 0.0, 0.0), Vec3::Y)]);
        receivers.origin = DVec3::new(1e6, 0.0, -3.0);
        receivers.prim = vec![7];
        let hemisphere = Hemisphere::default();
        let seen = Seen {
            receivers: &receivers,
            index: 0,
            hemisphere: &hemisphere,
            surface: BLACK_SURFACE,
            direct: Vec3::ZERO,
            environment: Vec3::ZERO,
            illumination: Vec3::ZERO,
            indirect: Vec3::ZERO,
        };
        assert_eq!(world_position(&seen), Vec3::new(1_000_000.25, 0.0, -3.0));
        assert_eq!(
            (normal(&seen), depth(&seen), prim_id(&seen)),
            (Vec3::Y, 0.0, 7.0)
        );
    }
}
