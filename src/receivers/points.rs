//! Points of a file as receivers, wherever they lie: computed at, and written back with the results.

use super::Receivers;
use crate::results::Target;
use crate::scene::PrimId;
use crate::shading::SurfacePoint;
use crate::surfels::points::PointSet;
use glam::{DVec3, Vec3};

/// One receiver for each point of `set` that has a normal, in the set's order, relative to `origin`, and the numbers of these
/// points. They lie on no surface of the scene as far as anyone knows: every light reaches them, and they have no material.
///
/// # Panics
/// If the set has normals, but not one a point.
pub fn place(set: &PointSet, origin: DVec3) -> (Receivers, Vec<usize>) {
    let none = Vec::new();
    let normals = set.normal.as_ref().unwrap_or(&none);
    assert!(
        normals.is_empty() || normals.len() == set.len(),
        "columns of a set are equally long"
    );
    let faces = |i: &usize| normals.get(*i).is_some_and(|normal| *normal != Vec3::ZERO);
    let kept: Vec<usize> = (0..set.len()).filter(faces).collect();
    let shift = (set.origin - origin).as_vec3();
    let normal: Vec<Vec3> = kept.iter().map(|&i| normals[i]).collect();
    let surface = SurfacePoint {
        prim: PrimId::NONE,
        triangle: 0,
        u: 0.0,
        v: 0.0,
        footprint: 0.0,
    };
    let receivers = Receivers {
        origin,
        position: kept.iter().map(|&i| set.position[i] + shift).collect(),
        geometric_normal: normal.clone(),
        normal,
        prim: vec![PrimId::NONE.0; kept.len()],
        surface: vec![surface; kept.len()],
        depth: Vec::new(),
        toward_eye: Vec::new(),
        target: Target::Surfels,
    };
    (receivers, kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_with_a_normal_stand_where_they_are_in_the_world() {
        let set = PointSet {
            origin: DVec3::new(1e6, 0.0, 0.0),
            position: vec![Vec3::X, Vec3::Y, Vec3::Z],
            normal: Some(vec![Vec3::Z, Vec3::ZERO, Vec3::Y]),
            ..PointSet::default()
        };
        let (receivers, kept) = place(&set, DVec3::new(1e6 - 2.0, 0.0, 0.0));
        assert_eq!(kept, [0, 2]);
        assert_eq!(
            receivers.position,
            [Vec3::X * 3.0, Vec3::new(2.0, 0.0, 1.0)]
        );
        assert_eq!(receivers.normal, [Vec3::Z, Vec3::Y]);
        assert!(place(&PointSet::default(), DVec3::ZERO).0.is_empty());
    }
}
