//! Scene → [`Receivers`]: where light is to be computed. Pixels of a camera, points of meshes, surfels.

pub mod camera;
pub mod lens;
pub mod points;
pub mod primvar;
pub mod sampling;
pub mod surfel;
#[cfg(test)]
mod testing;

use crate::results::Target;
use crate::shading::SurfacePoint;
use glam::{DVec3, Vec3};

/// Points to gather at, as columns of equal length.
#[derive(Debug, Clone, PartialEq)]
pub struct Receivers {
    /// World position that `position` is relative to.
    pub origin: DVec3,
    /// Positions on surfaces.
    pub position: Vec<Vec3>,
    /// Unit shading normals, on the side that is lit.
    pub normal: Vec<Vec3>,
    /// Unit plane normals, same side.
    pub geometric_normal: Vec<Vec3>,
    /// Index of the prim.
    pub prim: Vec<u32>,
    /// The same point in surface terms, for materials (for vertices: on one of the faces around it).
    pub surface: Vec<SurfacePoint>,
    /// Distance along the viewing axis, stage units; empty unless placed by a camera.
    pub depth: Vec<f32>,
    /// Unit directions to the eye; empty unless placed by a camera.
    pub toward_eye: Vec<Vec3>,
    /// Where the values go.
    pub target: Target,
}

impl Receivers {
    /// Where to lift receiver `i` along, if it may lie on an edge or corner: its shading normal, which leads away from all
    /// faces there, or, where that is far from it, the normal of its plane: between two walls of one mesh the shading
    /// normal leads away from both.
    pub fn rim_normal(&self, i: usize) -> Vec3 {
        let (shading, plane) = (self.normal[i], self.geometric_normal[i]);
        if shading.dot(plane) > 0.5 {
            shading
        } else {
            plane
        }
    }

    /// Number of receivers.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// True without receivers.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// The receivers `picked`, in that order, as receivers of their own; their target is forgotten (one value each).
    ///
    /// # Panics
    /// If an index is not below [`Self::len`].
    #[must_use]
    pub fn subset(&self, picked: &[usize]) -> Self {
        fn take<T: Copy>(column: &[T], picked: &[usize]) -> Vec<T> {
            picked.iter().map(|&i| column[i]).collect()
        }
        fn take_if_any<T: Copy>(column: &[T], picked: &[usize]) -> Vec<T> {
            if column.is_empty() {
                Vec::new()
            } else {
                take(column, picked)
            }
        }
        Self {
            origin: self.origin,
            position: take(&self.position, picked),
            normal: take(&self.normal, picked),
            geometric_normal: take(&self.geometric_normal, picked),
            prim: take(&self.prim, picked),
            surface: take(&self.surface, picked),
            depth: take_if_any(&self.depth, picked),
            toward_eye: take_if_any(&self.toward_eye, picked),
            target: Target::Surfels,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surfels::SurfelCloud;

    #[test]
    fn a_subset_keeps_order_and_all_columns() {
        let all = surfel::place(&SurfelCloud {
            position: vec![Vec3::X, Vec3::Y, Vec3::Z],
            normal: vec![Vec3::Z; 3],
            area: vec![1.0, 4.0, 9.0],
            prim: vec![0, 1, 2],
            ..SurfelCloud::default()
        });
        let few = all.subset(&[2, 0]);
        assert_eq!(few.position, [Vec3::Z, Vec3::X]);
        assert_eq!(few.prim, [2, 0]);
        assert_eq!(few.surface[0].footprint, 3.0);
        assert!(few.depth.is_empty() && few.len() == 2);
        assert!(all.subset(&[]).is_empty());
    }
}
