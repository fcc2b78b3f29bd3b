//! Which surfels are the surface that a receiver stands on.
//!
//! Disks stick out over edges and curvature and would cover what the surface itself does not.

use crate::octree::LeafSurfels;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashSet;

/// A disk that the receiver lies on, closer than this many of its radii, and that faces the same way, is the
/// receiver's own surface: this much a curved surface bends away from a disk of 1/10 of its radius of curvature.
const FRONT_RADII: f32 = 0.05;

/// A disk of the other side of the receiver's own surface does not rise above the receiver by more than this many of
/// its radii: rounding. A sheet in contact does.
const OTHER_SIDE_RADII: f32 = 1e-3;

/// It may rise this much where the disk has a front that the receiver stands on: a disk is flat, so in a hollow both
/// its sides pass over the surface, and the back would cover the whole hemisphere. Visibility of a scan with two sides
/// (a bunny of 70 000 triangles under surfels four times as large) errs by 12 % with this and by 51 % without.
const TWIN_RADII: f32 = 0.15;

/// How far across, in radii, such a disk reaches.
const TWIN_REACH: f32 = 1.5;

/// Least cosine, up to its sign, between the normals of the receiver and of its own surface.
const COSINE: f32 = 0.5;

/// Tells a receiver's own surface from all others.
#[derive(Debug)]
pub(super) struct OwnSurface {
    /// Surfels that stand back to back with another one: the two sides of a surface.
    has_twin: Vec<bool>,
}

impl OwnSurface {
    pub(super) fn new(surfels: &LeafSurfels) -> Self {
        let side = |i: usize| (surfels.position(i), surfels.normal(i));
        let keys = (0..surfels.len()).map(|i| key(side(i).0, side(i).1));
        let all: HashSet<_> = keys.collect();
        let has_twin = |i: usize| all.contains(&key(side(i).0, -side(i).1));
        Self {
            has_twin: (0..surfels.len()).into_par_iter().map(has_twin).collect(),
        }
    }

    /// True if `surfel` belongs to the surface under a receiver at `position` with the unit `normal`.
    pub(super) fn has(
        &self,
        surfels: &LeafSurfels,
        surfel: usize,
        (position, receiver_normal): (Vec3, Vec3),
    ) -> bool {
        let offset = surfels.position(surfel) - position;
        let (normal, radius) = (surfels.normal(surfel), surfels.radius(surfel));
        let facing = normal.dot(receiver_normal);
        let height = -normal.dot(offset);
        let beside = (offset + normal * height).length();
        if facing >= COSINE {
            return height <= FRONT_RADII * radius && beside <= radius;
        }
        let is_under = offset.dot(receiver_normal) <= OTHER_SIDE_RADII * radius;
        // Neighbours reach over the receiver too: their planes cross its own halfway to their centers.
        let is_other_side = is_under && height <= radius && beside <= 2.0 * radius;
        let is_back =
            self.has_twin[surfel] && height <= TWIN_RADII * radius && beside <= TWIN_REACH * radius;
        facing <= -COSINE && (is_other_side || is_back)
    }
}

/// One side of one place, the same for both zeros.
fn key(position: Vec3, normal: Vec3) -> [u32; 6] {
    let [p, n] = [position, normal].map(|v| (v + 0.0).to_array().map(f32::to_bits));
    [p[0], p[1], p[2], n[0], n[1], n[2]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::Octree;
    use crate::surfels::SurfelCloud;

    /// Squares of one unit facing `normals`, all in one place.
    fn at_origin(normals: &[Vec3]) -> Octree {
        let count = normals.len();
        Octree::new(&SurfelCloud {
            position: vec![Vec3::ZERO; count],
            normal: normals.to_vec(),
            radius: vec![0.75; count],
            area: vec![1.0; count],
            radiosity: vec![Vec3::ONE; count],
            albedo: vec![Vec3::ONE; count],
            emission: vec![Vec3::ZERO; count],
            prim: vec![0; count],
            ..SurfelCloud::default()
        })
    }

    /// How many of those that face a receiver at `depth` below, which looks up, are taken for its own surface.
    fn own(normals: &[Vec3], depth: f32) -> usize {
        let octree = at_origin(normals);
        let own = OwnSurface::new(octree.surfels());
        let place = (Vec3::NEG_Z * depth, Vec3::Z);
        let seen =
            |&i: &usize| octree.surfels().normal(i).z < 0.0 && own.has(octree.surfels(), i, place);
        (0..normals.len()).filter(seen).count()
    }

    #[test]
    fn the_back_of_the_surface_one_stands_on_is_left_out_and_nothing_else() {
        let both = [Vec3::Z, Vec3::NEG_Z];
        assert_eq!(own(&both, 0.05), 1);
        assert_eq!(own(&both, 0.5), 0, "a ceiling with an upper side");
        assert_eq!(own(&[Vec3::NEG_Z], 0.05), 0, "a sheet in contact");
        assert_eq!(own(&[Vec3::Z, Vec3::X], 0.05), 0);
    }
}
