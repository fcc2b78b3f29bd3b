//! Which receivers maps cannot judge.
//!
//! Those with many verdicts that hung on the bias (contact, coincident surfaces, creases finer than a pixel), and
//! vertices of folded fans: a face around them lies over them, at no distance at all. Measured on a dragon: one such
//! vertex of 1259 raised the error from 1.4 to 3.3 %.

use super::{MapsPlan, MapsSettings, Visibility};
use crate::receivers::Receivers;
use crate::scene::Mesh;
use glam::Vec3;
use rayon::prelude::*;

/// A face that looks away from its vertex' normal by more than this cosine lies over it.
const FOLDED: f32 = -0.1;

/// Barycentric weight from which on a receiver stands at a vertex: they are pulled off open edges by a little.
const AT_VERTEX: f32 = 0.95;

/// Fill `visibility.ambiguous`.
pub(super) fn mark(
    plan: &MapsPlan<'_>,
    receivers: &Receivers,
    settings: &MapsSettings,
    visibility: &mut Visibility,
) {
    let folds = Folds::new(plan, receivers);
    visibility.ambiguous = (visibility.uncertain.par_iter())
        .enumerate()
        .map(|(i, &share)| share > settings.ambiguous || folds.has(plan, receivers, i))
        .collect();
}

/// For meshes with receivers at vertices: which vertices have a folded fan. Else empty.
struct Folds {
    of_mesh: Vec<Vec<bool>>,
}

impl Folds {
    fn new(plan: &MapsPlan<'_>, receivers: &Receivers) -> Self {
        let meshes = &plan.scene.meshes;
        let mut is_asked = vec![false; meshes.len()];
        for i in 0..receivers.len() {
            if let Some((mesh, _)) = vertex(plan, receivers, i) {
                is_asked[mesh] = true;
            }
        }
        let of_mesh = is_asked.into_par_iter().zip(meshes);
        Self {
            of_mesh: of_mesh
                .map(|(asked, mesh)| if asked { folded(mesh) } else { Vec::new() })
                .collect(),
        }
    }

    fn has(&self, plan: &MapsPlan<'_>, receivers: &Receivers, i: usize) -> bool {
        vertex(plan, receivers, i).is_some_and(|(mesh, vertex)| self.of_mesh[mesh][vertex])
    }
}

/// Mesh and position that receiver `i` stands at, if any.
fn vertex(plan: &MapsPlan<'_>, receivers: &Receivers, i: usize) -> Option<(usize, usize)> {
    let surface = &receivers.surface[i];
    let weights = [1.0 - surface.u - surface.v, surface.u, surface.v];
    let corner = weights.iter().position(|&weight| weight >= AT_VERTEX)?;
    let prim = plan.scene.prims.get(receivers.prim[i] as usize)?;
    let mesh = plan.scene.mesh_of(prim);
    let t = mesh.triangles.get(surface.triangle as usize)?;
    Some((prim.mesh.index(), t[corner] as usize))
}

/// True for positions with a face around that looks away from the mean of all.
fn folded(mesh: &Mesh) -> Vec<bool> {
    let face = |t: usize| -> Vec3 {
        let [a, b, c] = mesh.corners(t);
        (b - a).cross(c - a)
    };
    let mut normals = vec![Vec3::ZERO; mesh.positions.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        corners.iter().for_each(|&i| normals[i as usize] += face(t));
    }
    let mut folded = vec![false; mesh.positions.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let face = face(t);
        for &i in corners {
            let normal = normals[i as usize];
            let facing = face.dot(normal);
            if facing < 0.0
                && facing * facing
                    > FOLDED * FOLDED * face.length_squared() * normal.length_squared()
            {
                folded[i as usize] = true;
            }
        }
    }
    folded
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::testing::mesh;

    #[test]
    fn a_vertex_under_one_of_its_own_faces_is_folded_and_one_on_a_dome_is_not() {
        let fan = |lift: f32| {
            let rim = [
                Vec3::X,
                Vec3::new(-0.5, 0.0, 0.9),
                Vec3::new(-0.5, lift, -0.9),
            ];
            let mut mesh = mesh(&[
                [Vec3::ZERO, rim[1], rim[0]],
                [Vec3::ZERO, rim[2], rim[1]],
                [Vec3::ZERO, rim[0], rim[2]],
            ]);
            mesh.positions = vec![Vec3::ZERO, rim[0], rim[1], rim[2]];
            mesh.triangles = vec![[0, 2, 1], [0, 3, 2], [0, 1, 3]];
            mesh
        };
        assert_eq!(folded(&fan(-0.3)), [false; 4]);
        let mut over = fan(0.0);
        // The third corner swings over to the side of the second: the last face lies upside down over the first.
        over.positions[3] = Vec3::new(-0.5, 0.1, 1.2);
        assert!(folded(&over)[0]);
    }
}
