//! A prim's mesh, placed in the world.

use super::{Mesh, Prim, PrimId, Scene};
use glam::{Affine3A, DVec3, Mat3, Vec3};

/// The triangles of a prim in world space relative to the scene's origin.
#[derive(Debug, Clone, Copy)]
pub struct PlacedMesh<'a> {
    /// In object space.
    pub mesh: &'a Mesh,
    world_from_object: Affine3A,
    /// To unnormalized world normals on the side of the object's: the cofactors, which exist for any matrix.
    world_normal_from_object: Mat3,
    /// −1 for a mirrored mesh, else 1.
    front: f64,
}

impl<'a> PlacedMesh<'a> {
    /// The mesh of `prim`, one of `scene`.
    pub fn new(scene: &'a Scene, prim: &Prim) -> Self {
        Self::with_transform(scene.mesh_of(prim), prim.world_from_object)
    }

    /// The mesh of prim `id`.
    pub fn of(scene: &'a Scene, id: PrimId) -> Self {
        Self::new(scene, &scene.prims[id.index()])
    }

    fn with_transform(mesh: &'a Mesh, world_from_object: Affine3A) -> Self {
        let matrix = world_from_object.matrix3;
        let (x, y, z) = (matrix.x_axis, matrix.y_axis, matrix.z_axis);
        let [x, y, z] = [y.cross(z), z.cross(x), x.cross(y)].map(Vec3::from);
        let is_mirrored = matrix.determinant() < 0.0;
        let side = if is_mirrored { -1.0 } else { 1.0 };
        Self {
            mesh,
            world_from_object,
            world_normal_from_object: Mat3::from_cols(x, y, z) * side,
            front: f64::from(side),
        }
    }

    /// Number of triangles.
    ///
    /// # Panics
    /// With more than 2³² of them.
    pub fn triangle_count(&self) -> u32 {
        u32::try_from(self.mesh.triangles.len()).expect("triangles are numbered with 32 bits")
    }

    /// World position of an object-space one.
    pub fn point(&self, position: Vec3) -> Vec3 {
        self.world_from_object.transform_point3(position)
    }

    /// Corners of triangle `t`.
    pub fn corners(&self, t: u32) -> [Vec3; 3] {
        self.mesh.corners(t as usize).map(|p| self.point(p))
    }

    /// Position at barycentric `(u, v)` of triangle `t`.
    pub fn position(&self, t: u32, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.mesh.corners(t as usize);
        self.point(a + (b - a) * u + (c - a) * v)
    }

    /// Area of triangle `t`, exact to the precision of its corners.
    pub fn area(&self, t: u32) -> f64 {
        0.5 * self.cross(t).length()
    }

    /// Normal of the front side of triangle `t`, twice its area long.
    pub fn front_cross(&self, t: u32) -> DVec3 {
        self.cross(t) * self.front
    }

    /// Unit plane normal of the front side of triangle `t`; zero where it has no area.
    pub fn plane_normal(&self, t: u32) -> Vec3 {
        self.front_cross(t).normalize_or_zero().as_vec3()
    }

    /// Unit world normal of an object-space one, on the same side of the surface; zero for zero.
    pub fn normal(&self, normal: Vec3) -> Vec3 {
        (self.world_normal_from_object * normal).normalize_or_zero()
    }

    /// Unit shading normal of the front side at barycentric `(u, v)` of triangle `t`; zero where there is none.
    pub fn shading_normal(&self, t: u32, u: f32, v: f32) -> Vec3 {
        self.normal(self.mesh.shading_normal(t as usize, u, v))
    }

    /// Unnormalized world normals at the corners of triangle `t`, front side; `None` for flat shading.
    pub fn corner_normals(&self, t: u32) -> Option<[Vec3; 3]> {
        let normals = self.mesh.corner_normals(t as usize)?;
        Some(normals.map(|normal| self.world_normal_from_object * normal))
    }

    fn cross(&self, t: u32) -> DVec3 {
        let [a, b, c] = self.corners(t).map(|p| p.as_dvec3());
        (b - a).cross(c - a)
    }
}

/// `shading` if it lies on the side of `geometric`, else `geometric`: light comes from one side only.
pub fn on_the_side_of(geometric: Vec3, shading: Vec3) -> Vec3 {
    if shading.dot(geometric) > 0.0 {
        shading
    } else {
        geometric
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Normals;

    #[test]
    fn normals_stay_perpendicular_under_shear_and_mirroring() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            triangles: vec![[0, 1, 2]],
            triangle_faces: vec![0],
            normals: Normals::Flat,
            primvars: vec![],
            double_sided: false,
            closed: false,
            cage: None,
            scheme: "none".into(),
        };
        let shear = Mat3::from_cols(Vec3::new(-2.0, 0.3, 0.1), Vec3::new(0.5, 1.0, 0.7), Vec3::Z);
        let world = PlacedMesh::with_transform(&mesh, Affine3A::from_mat3(shear));
        let normal = world.normal(Vec3::Z);
        let edge = |u, v| world.position(0, u, v) - world.position(0, 0.0, 0.0);
        assert!(normal.dot(edge(1.0, 0.0)).abs() < 1e-6);
        assert!(normal.dot(edge(0.0, 1.0)).abs() < 1e-6);
        // The side that object +Z is mapped to.
        assert!(normal.dot(shear * Vec3::Z) > 0.0);
        assert!(world.plane_normal(0).distance(normal) < 1e-6);
        assert!(world.shading_normal(0, 0.2, 0.2).distance(normal) < 1e-6);
        // |shear · X × shear · Y| / 2 by hand: (0.11, 1.45, -2.15).
        assert!((world.area(0) - 0.5 * 6.737_1_f64.sqrt()).abs() < 1e-6);
        assert_eq!(on_the_side_of(Vec3::Z, -Vec3::Z), Vec3::Z);
    }
}
