//! Scenes made by code, for the tests of the tracer and of what uses it.

use crate::scene::{
    FaceMaterials, Mesh, MeshId, Normals, Prim, PrimSource, Purpose, Scene, StageInfo, UpAxis,
};
use glam::{Affine3A, DVec3, Vec3};

/// A reproducible uniform number in 0…1 (splitmix64).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// 0…1.
    pub(crate) fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / 16_777_216.0
    }

    /// In the cube −1…1.
    pub(crate) fn vector(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0
    }

    /// Unit, uniform over the sphere.
    pub(crate) fn direction(&mut self) -> Vec3 {
        loop {
            let v = self.vector();
            if v.length_squared() < 1.0 && v.length_squared() > 1e-4 {
                return v.normalize();
            }
        }
    }
}

/// A double-sided mesh with a face a triangle and corners of its own.
pub(crate) fn mesh(triangles: &[[Vec3; 3]]) -> Mesh {
    Mesh {
        positions: triangles.iter().flatten().copied().collect(),
        triangles: (0..triangles.len() as u32)
            .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
            .collect(),
        triangle_faces: (0..triangles.len() as u32).collect(),
        normals: Normals::Flat,
        primvars: Vec::new(),
        double_sided: true,
        closed: false,
        cage: None,
        scheme: "none".into(),
    }
}

/// Corners of a box of this size around the origin, and its sides: outward, or inward for a negative size.
pub(crate) fn cube(size: f32) -> (Vec<Vec3>, [[u32; 4]; 6]) {
    let corners = (0..8).map(|i| {
        Vec3::new(
            (i & 1) as f32 - 0.5,
            (i >> 1 & 1) as f32 - 0.5,
            (i >> 2) as f32 - 0.5,
        ) * size
    });
    let quads = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    (corners.collect(), quads)
}

/// A scene of `(mesh, transform)` prims without materials.
pub(crate) fn scene(meshes: Vec<Mesh>, prims: &[(u32, Affine3A)]) -> Scene {
    let prims = prims.iter().map(|&(mesh, world_from_object)| Prim {
        path: format!("/p{mesh}").into(),
        mesh: MeshId(mesh),
        world_from_object,
        materials: FaceMaterials::Whole(None),
        purpose: Purpose::Default,
        source: PrimSource::Direct,
    });
    Scene {
        stage: StageInfo {
            path: "test".into(),
            up_axis: UpAxis::Y,
            meters_per_unit: 1.0,
            default_prim: None,
            time_range: None,
            time_codes_per_second: 24.0,
            time: None,
            layers: Vec::new(),
            variants: Vec::new(),
            reader: "test".into(),
        },
        origin: DVec3::ZERO,
        meshes,
        prims: prims.collect(),
        materials: Vec::new(),
        lights: Vec::new(),
        cameras: Vec::new(),
        render_settings: Vec::new(),
    }
}
