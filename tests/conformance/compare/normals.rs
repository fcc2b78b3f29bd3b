//! Shading normals of polygon meshes, at every corner of every triangle.

use super::{Comparison, text};
use glam::{DMat3, DVec3};
use serde_json::Value;
use surflux::scene::{Normals, Prim};

/// Unit normals may be off by this much in every component: they are `f32`, turned by two or three products of matrices.
const SLACK: f64 = 1e-5;

impl Comparison<'_> {
    /// Those that the mesh authors, on its front side; what is made where there are none is not USD's business.
    pub(super) fn normals(&mut self, prim: &Prim, theirs: &Value) {
        let mesh = self.scene.mesh_of(prim);
        let Some(cage) = mesh.cage.as_ref().filter(|_| !theirs["normals"].is_null()) else {
            return;
        };
        let expected = self.truth.array(&theirs["normals"][1]);
        let interpolation = text(&theirs["normals"][0]);
        let matrix = prim.world_from_object.matrix3;
        let matrix = DMat3::from_cols(
            matrix.x_axis.as_dvec3(),
            matrix.y_axis.as_dvec3(),
            matrix.z_axis.as_dvec3(),
        );
        let normal_matrix = matrix.inverse().transpose();
        let mut starts = vec![0];
        for &count in &cage.face_vertex_counts {
            starts.push(starts[starts.len() - 1] + count as usize);
        }
        let side = if theirs["left"].as_bool() == Some(true) {
            -1.0
        } else {
            1.0
        };
        let (mut agreeing, mut all) = (0, 0);
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            let face = mesh.triangle_faces[t] as usize;
            for (k, &point) in triangle.iter().enumerate() {
                let corners = starts[face]..starts[face + 1];
                let mut slots = match interpolation {
                    "constant" => 0..1,
                    "uniform" => face..face + 1,
                    "vertex" | "varying" => point as usize..point as usize + 1,
                    _ => corners,
                };
                let found = match &mesh.normals {
                    Normals::Flat => DVec3::NAN,
                    Normals::Vertex(values) => values[point as usize].as_dvec3(),
                    Normals::Corner { corners, values } => {
                        values[corners[t][k] as usize].as_dvec3()
                    }
                };
                let found = side * (normal_matrix * found).normalize_or_zero();
                let equals = |slot: usize| {
                    let same_point =
                        interpolation != "faceVarying" || cage.face_vertex_indices[slot] == point;
                    let expected = expected.get(3 * slot..3 * slot + 3);
                    same_point
                        && expected.is_some_and(|expected| {
                            DVec3::from_slice(expected).abs_diff_eq(found, SLACK)
                        })
                };
                all += 1;
                agreeing += usize::from(slots.any(equals));
            }
        }
        self.count(&prim.path, "normals", (agreeing, all));
    }
}
