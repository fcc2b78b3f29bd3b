//! Scenes for tests of receivers.

use crate::scene::{
    FaceMaterials, Mesh, MeshId, Prim, PrimSource, Purpose, Scene, StageInfo, UpAxis,
};
use glam::{Affine3A, DVec3};

/// A scene of these meshes, each with its transform.
pub(super) fn scene_of(meshes: Vec<(Mesh, Affine3A)>) -> Scene {
    let prim = |(i, (_, place)): (u32, &(Mesh, Affine3A))| Prim {
        path: format!("/prim{i}").into(),
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
            variants: Vec::new(),
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
