//! Points of a prim's triangles in world space.

use crate::scene::{Mesh, Prim, Scene};
use glam::{Affine3A, Mat3, Vec3};

/// A prim's mesh, placed in the world (relative to the scene's origin).
#[derive(Debug, Clone, Copy)]
pub(super) struct WorldPrim<'a> {
    pub(super) mesh: &'a Mesh,
    world_from_object: Affine3A,
    /// To unnormalized world normals on the side of the object's: the cofactors, which exist for any matrix.
    world_normal_from_object: Mat3,
}

impl<'a> WorldPrim<'a> {
    pub(super) fn new(scene: &'a Scene, prim: &'a Prim) -> Self {
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

    pub(super) fn point(&self, position: Vec3) -> Vec3 {
        self.world_from_object.transform_point3(position)
    }

    /// World position at barycentric `(u, v)` of triangle `t`.
    pub(super) fn position(&self, t: usize, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.mesh.corners(t);
        self.point(a + (b - a) * u + (c - a) * v)
    }

    /// World area of triangle `t`.
    pub(super) fn area(&self, t: usize) -> f32 {
        let [a, b, c] = self.mesh.corners(t).map(|p| self.point(p));
        0.5 * (b - a).cross(c - a).length()
    }

    /// Unit world normal of an object-space normal; zero for zero.
    pub(super) fn normal(&self, normal: Vec3) -> Vec3 {
        (self.world_normal_from_object * normal).normalize_or_zero()
    }
}

/// `shading` if it lies on the side of `geometric`, else `geometric`: light comes from one side only.
pub(super) fn on_the_side_of(geometric: Vec3, shading: Vec3) -> Vec3 {
    if shading.dot(geometric) > 0.0 {
        shading
    } else {
        geometric
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scene::{FaceMaterials, MeshId, PrimSource, Purpose, StageInfo, UpAxis};
    use glam::DVec3;

    /// A scene of these meshes, each with its transform.
    pub(in crate::receivers) fn scene_of(meshes: Vec<(Mesh, Affine3A)>) -> Scene {
        let prim = |(i, (_, place)): (u32, &(Mesh, Affine3A))| Prim {
            path: format!("/prim{i}"),
            mesh: MeshId(i),
            world_from_object: *place,
            materials: FaceMaterials::Whole(None),
            purpose: Purpose::Default,
            source: PrimSource::Direct,
        };
        Scene {
            stage: StageInfo {
                path: "test.usda".into(),
                up_axis: UpAxis::Y,
                meters_per_unit: 1.0,
                default_prim: None,
                time_range: None,
                time_codes_per_second: 24.0,
                time: None,
                layers: vec![],
                reader: "native".into(),
            },
            origin: DVec3::ZERO,
            prims: (0..).zip(&meshes).map(prim).collect(),
            meshes: meshes.into_iter().map(|(mesh, _)| mesh).collect(),
            materials: vec![],
            lights: vec![],
            cameras: vec![],
            render_settings: vec![],
        }
    }

    #[test]
    fn normals_stay_perpendicular_under_shear_and_mirroring() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            triangles: vec![[0, 1, 2]],
            triangle_faces: vec![0],
            normals: crate::scene::Normals::Flat,
            primvars: vec![],
            double_sided: false,
            closed: false,
            cage: None,
            scheme: "none".into(),
        };
        let shear = Mat3::from_cols(Vec3::new(-2.0, 0.3, 0.1), Vec3::new(0.5, 1.0, 0.7), Vec3::Z);
        let scene = scene_of(vec![(mesh, Affine3A::from_mat3(shear))]);
        let world = WorldPrim::new(&scene, &scene.prims[0]);
        let normal = world.normal(Vec3::Z);
        let edge = |u, v| world.position(0, u, v) - world.position(0, 0.0, 0.0);
        assert!(normal.dot(edge(1.0, 0.0)).abs() < 1e-6 && normal.dot(edge(0.0, 1.0)).abs() < 1e-6);
        // The side that object +Z is mapped to.
        assert!(normal.dot(shear * Vec3::Z) > 0.0);
        assert_eq!(on_the_side_of(Vec3::Z, -Vec3::Z), Vec3::Z);
    }
}
