//! Surfels as receivers, for bounces. PBGI §8.3.

use super::Receivers;
use crate::results::Target;
use crate::scene::PrimId;
use crate::shading::SurfacePoint;
use crate::surfels::SurfelCloud;

/// One receiver a surfel, in the cloud's order. `surface` names only the prim and the size (the triangle is
/// unknown): take albedo and emission from the cloud.
pub fn place(cloud: &SurfelCloud) -> Receivers {
    let surface = |i: usize| SurfacePoint {
        prim: PrimId(cloud.prim[i]),
        triangle: 0,
        u: 1.0 / 3.0,
        v: 1.0 / 3.0,
        footprint: cloud.area[i].sqrt(),
    };
    Receivers {
        origin: cloud.origin,
        position: cloud.position.clone(),
        normal: cloud.normal.clone(),
        geometric_normal: cloud.normal.clone(),
        prim: cloud.prim.clone(),
        surface: (0..cloud.len()).map(surface).collect(),
        depth: Vec::new(),
        toward_eye: Vec::new(),
        target: Target::Surfels,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn receivers_stand_where_the_surfels_are() {
        let cloud = SurfelCloud {
            position: vec![Vec3::X, Vec3::Y],
            normal: vec![Vec3::Z, -Vec3::Z],
            area: vec![4.0, 0.25],
            prim: vec![3, 5],
            ..SurfelCloud::default()
        };
        let receivers = place(&cloud);
        assert_eq!(receivers.position, cloud.position);
        assert_eq!(receivers.geometric_normal, cloud.normal);
        assert_eq!(receivers.surface[1].prim, PrimId(5));
        assert_eq!(receivers.surface[1].footprint, 0.5);
        assert_eq!(receivers.target, Target::Surfels);
        assert!(place(&SurfelCloud::default()).is_empty());
    }
}
