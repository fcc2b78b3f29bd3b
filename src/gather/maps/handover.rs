//! Which receivers maps cannot judge.
//!
//! Those with many verdicts that hung on the bias (contact, coincident surfaces), and vertices that the faces around
//! them cover themselves, at no distance at all: creases of rough scans, and folded fans. Measured on a dragon, one
//! folded vertex of 1259 raised the error from 1.4 to 3.3 %.

use super::{MapsPlan, MapsSettings, Visibility};
use crate::receivers::Receivers;
use crate::scene::Mesh;
use glam::Vec3;
use rayon::prelude::*;

/// Barycentric weight from which on a receiver stands at a vertex: they are pulled off open edges by a little.
const AT_VERTEX: f32 = 0.95;

/// Fill `visibility.ambiguous`.
pub(super) fn mark(
    plan: &MapsPlan<'_>,
    receivers: &Receivers,
    settings: &MapsSettings,
    visibility: &mut Visibility,
) {
    let creases = Creases::new(plan, receivers);
    visibility.ambiguous = (visibility.uncertain.par_iter())
        .enumerate()
        .map(|(i, &share)| {
            share > settings.ambiguous || creases.share(plan, receivers, i) > settings.crease
        })
        .collect();
}

/// For meshes with receivers at vertices: the share of the hemisphere that the faces around each vertex cover.
struct Creases {
    of_mesh: Vec<Vec<f32>>,
}

impl Creases {
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
                .map(|(asked, mesh)| if asked { creased(mesh) } else { Vec::new() })
                .collect(),
        }
    }

    /// 0 for receivers that are at no vertex.
    fn share(&self, plan: &MapsPlan<'_>, receivers: &Receivers, i: usize) -> f32 {
        vertex(plan, receivers, i).map_or(0.0, |(mesh, vertex)| self.of_mesh[mesh][vertex])
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

/// For every position, the cosine-weighted share of the hemisphere about its area-weighted normal below the horizon of
/// the edges around it: the mean of sin² of their elevations. Faces that look away from the normal cover everything.
fn creased(mesh: &Mesh) -> Vec<f32> {
    let face = |t: usize| -> Vec3 {
        let [a, b, c] = mesh.corners(t);
        (b - a).cross(c - a)
    };
    let mut normals = vec![Vec3::ZERO; mesh.positions.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        corners.iter().for_each(|&i| normals[i as usize] += face(t));
    }
    normals
        .iter_mut()
        .for_each(|normal| *normal = normal.normalize_or_zero());
    let mut sums = vec![(0.0_f32, 0.0_f32); mesh.positions.len()];
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let face = face(t);
        for k in 0..3 {
            let [at, next, last] = [0, 1, 2].map(|j| corners[(k + j) % 3] as usize);
            let normal = normals[at];
            let share = if face.dot(normal) < 0.0 {
                1.0
            } else {
                let [e, f] = [next, last].map(|to| {
                    let edge = mesh.positions[to] - mesh.positions[at];
                    let rise = edge.dot(normal).max(0.0);
                    rise * rise / edge.length_squared().max(f32::MIN_POSITIVE)
                });
                0.5 * (e + f)
            };
            sums[at].0 += share;
            sums[at].1 += 1.0;
        }
    }
    let mean = |&(sum, count): &(f32, f32)| sum / f32::max(count, 1.0);
    sums.iter().map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::testing::mesh;
    use std::f32::consts::TAU;

    /// A fan of faces about the origin, whose rim rises by `rise`.
    fn fan(rise: impl Fn(usize) -> f32) -> Mesh {
        let rim = (0..12_u8).map(|k| {
            let (sin, cos) = (TAU * f32::from(k) / 12.0).sin_cos();
            Vec3::new(cos, sin, rise(usize::from(k)))
        });
        let mut mesh = mesh(&[]);
        mesh.positions = std::iter::once(Vec3::ZERO).chain(rim).collect();
        mesh.triangles = (0..12).map(|k| [0, 1 + k, 1 + (k + 1) % 12]).collect();
        mesh
    }

    #[test]
    fn the_bottom_of_a_funnel_is_covered_by_the_squared_sine_of_its_slope_and_a_tip_by_nothing() {
        let slope = 0.75_f32; // 3-4-5: sin² = 9/25
        assert!((creased(&fan(|_| slope))[0] - 0.36).abs() < 1e-5);
        assert_eq!(creased(&fan(|_| -slope))[0], 0.0);
        assert!(creased(&fan(|_| 0.0))[0] < 1e-6);
    }

    #[test]
    fn a_folded_face_covers_more_than_the_default_allows() {
        let mut fan = fan(|_| 0.0);
        // One corner of the rim swings far over to the other side: a face there lies upside down.
        fan.positions[3] = Vec3::new(0.5, -0.4, 0.3);
        assert!(creased(&fan)[0] > MapsSettings::default().crease);
    }
}
