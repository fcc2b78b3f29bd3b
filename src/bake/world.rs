//! A prim's mesh in world space.

use crate::scene::{Mesh, Prim, PrimId, Scene};
use glam::{Affine3A, DVec3, Mat3, Vec3, Vec3A};

/// The triangles of a prim, relative to the scene's origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct WorldMesh<'a> {
    pub(super) mesh: &'a Mesh,
    world_from_object: Affine3A,
    /// To unnormalized world normals on the side of the object's: the cofactors, which exist for any matrix.
    world_normal_from_object: Mat3,
}

impl<'a> WorldMesh<'a> {
    pub(super) fn new(scene: &'a Scene, prim: &Prim) -> Self {
        let matrix = prim.world_from_object.matrix3;
        let (x, y, z) = (matrix.x_axis, matrix.y_axis, matrix.z_axis);
        let cofactors = [y.cross(z), z.cross(x), x.cross(y)].map(Vec3::from);
        let side = if matrix.determinant() < 0.0 {
            -1.0
        } else {
            1.0
        };
        Self {
            mesh: scene.mesh_of(prim),
            world_from_object: prim.world_from_object,
            world_normal_from_object: Mat3::from_cols(cofactors[0], cofactors[1], cofactors[2])
                * side,
        }
    }

    pub(super) fn of(scene: &'a Scene, prim: PrimId) -> Self {
        Self::new(scene, &scene.prims[prim.index()])
    }

    pub(super) fn triangle_count(&self) -> u32 {
        u32::try_from(self.mesh.triangles.len()).expect("triangles are numbered with 32 bits")
    }

    /// Position of point `point` of the mesh.
    pub(super) fn point(&self, point: u32) -> Vec3 {
        self.world_from_object
            .transform_point3a(Vec3A::from(self.mesh.positions[point as usize]))
            .into()
    }

    pub(super) fn corners(&self, t: u32) -> [Vec3; 3] {
        let place = |p: Vec3| Vec3::from(self.world_from_object.transform_point3a(Vec3A::from(p)));
        self.mesh.corners(t as usize).map(place)
    }

    /// Exact to the precision of the corners.
    pub(super) fn area(&self, t: u32) -> f64 {
        let [a, b, c] = self.corners(t).map(|p| p.as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    }

    /// Unit plane normal of the front side; any where rounding leaves no area.
    pub(super) fn plane_normal(&self, t: u32) -> Vec3 {
        let [a, b, c] = self.corners(t).map(|p| p.as_dvec3());
        let normal = (b - a).cross(c - a).normalize_or(DVec3::Y).as_vec3();
        if self.is_mirrored() { -normal } else { normal }
    }

    fn is_mirrored(&self) -> bool {
        self.world_from_object.matrix3.determinant() < 0.0
    }

    /// Unit shading normal of the front side, never more than 90° from `plane_normal`.
    pub(super) fn shading_normal(&self, t: u32, u: f32, v: f32, plane_normal: Vec3) -> Vec3 {
        let normal = self.mesh.shading_normal(t as usize, u, v);
        let normal = (self.world_normal_from_object * normal).normalize_or(plane_normal);
        if normal.dot(plane_normal) > 0.0 {
            normal
        } else {
            plane_normal
        }
    }
}
