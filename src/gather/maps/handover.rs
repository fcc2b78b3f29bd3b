//! Which receivers maps cannot judge.
//!
//! Those with many verdicts that hung on the bias (contact, coincident surfaces), and vertices that the faces around
//! them cover themselves, at no distance at all: creases of rough scans, and folded fans. Measured on a dragon, one
//! folded vertex of 1259 raised the error from 1.4 to 3.3 %. And those at corners, also with flat prims, and at the open borders of
//! other prims (`borders`).

use super::borders::{Borders, Turn};
use super::{MapsPlan, MapsSettings, Visibility};
use crate::receivers::Receivers;
use crate::scene::Mesh;
use crate::shading::SurfacePoint;
use glam::Vec3;
use rayon::prelude::*;

/// Barycentric weight from which on a receiver stands at a vertex: they are pulled off open edges by a little.
const AT_VERTEX: f32 = 0.95;

/// Triangles whose longest edge is this part of a pixel are details that maps do not see: small parts of meshes that
/// are coarse elsewhere, and small things in wide scenes, whose maps have few pixels for each.
const TINY: f32 = 1.0 / 16.0;

/// Fill `visibility.ambiguous`.
///
/// `pixels`: width of those that each prim is drawn at; `flat_margin`: see [`super::look::Rules`].
pub(super) fn mark(
    (plan, pixels): (&MapsPlan<'_>, &[f32]),
    receivers: &Receivers,
    (settings, flat_margin): (&MapsSettings, f32),
    visibility: &mut Visibility,
) {
    let is_at_flat = |i: usize| {
        let place = receivers.position[i] - plan.center;
        let normal = receivers.geometric_normal[i];
        let mut flats = plan.flats.iter();
        flats.any(|flat| flat.is_met(place, normal, flat_margin))
    };
    let borders = Borders::new(plan, pixels, settings.bias);
    for prim in receivers.prim.chunk_by(PartialEq::eq) {
        if let Some(prim) = plan.scene.prims.get(prim[0] as usize) {
            plan.creases(prim.mesh.index());
        }
    }
    visibility.ambiguous = (visibility.uncertain.par_iter())
        .enumerate()
        .map(|(i, &share)| {
            share > settings.ambiguous
                || (vertex(plan, receivers, i)).is_some_and(|(mesh, at)| plan.creases(mesh)[at])
                || is_tiny(plan, pixels, receivers, i)
                || borders.are_met(receivers.position[i], receivers.prim[i])
                || is_at_flat(i)
        })
        .collect();
}

/// True if the triangle of receiver `i` is far smaller than the pixels it is drawn at.
fn is_tiny(plan: &MapsPlan<'_>, pixels: &[f32], receivers: &Receivers, i: usize) -> bool {
    let Some(prim) = plan.scene.prims.get(receivers.prim[i] as usize) else {
        return false;
    };
    let mesh = plan.scene.mesh_of(prim);
    let Some(t) = mesh.triangles.get(receivers.surface[i].triangle as usize) else {
        return false;
    };
    let at = |k: usize| mesh.positions[t[k] as usize];
    let edges = [at(1) - at(0), at(2) - at(1), at(0) - at(2)];
    let longest = edges.map(Vec3::length_squared).into_iter().reduce(f32::max);
    let scale = prim.world_from_object.matrix3.determinant().abs().cbrt();
    longest.unwrap_or(0.0).sqrt() * scale < TINY * pixels[receivers.prim[i] as usize]
}

/// Corner of its triangle that a receiver stands at, if any.
fn corner(surface: &SurfacePoint) -> Option<usize> {
    let weights = [1.0 - surface.u - surface.v, surface.u, surface.v];
    weights.iter().position(|&weight| weight >= AT_VERTEX)
}

/// Number of the mesh and of its position that receiver `i` stands at, if any.
fn vertex(plan: &MapsPlan<'_>, receivers: &Receivers, i: usize) -> Option<(usize, usize)> {
    let surface = &receivers.surface[i];
    let corner = corner(surface)?;
    let prim = plan.scene.prims.get(receivers.prim[i] as usize)?;
    let mesh = plan.scene.mesh_of(prim);
    let t = mesh.triangles.get(surface.triangle as usize)?;
    Some((prim.mesh.index(), t[corner] as usize))
}

/// Share of a vertex' hemisphere that the faces around it cover, above which it is ambiguous: creases finer than a pixel.
pub(super) const CREASED: f32 = 0.05;

/// True for every position of which more than [`CREASED`] of the hemisphere is covered by the faces around it.
pub(super) fn creases(mesh: &Mesh, (normals, turns): (&[Vec3], &[Turn])) -> Vec<bool> {
    // No edge around the others rises that far.
    let is_asked = |i: u32| turns[i as usize] > Turn::Flat;
    let shares = covered(mesh, normals, is_asked);
    shares.iter().map(|&share| share > CREASED).collect()
}

/// For every position that `is_asked`, the cosine-weighted share of the hemisphere about its area-weighted normal below the
/// horizon of the edges around it: the mean of sin² of their elevations, each edge of a face weighing a half where two faces
/// share it. Faces that look away from the normal cover everything. 0 for the others.
fn covered(mesh: &Mesh, normals: &[Vec3], is_asked: impl Fn(u32) -> bool) -> Vec<f32> {
    let mut sums = vec![(0.0_f32, 0.0_f32); mesh.positions.len()];
    for t in &mesh.triangles {
        if !t.iter().any(|&i| is_asked(i)) {
            continue;
        }
        let at = [t[0] as usize, t[1] as usize, t[2] as usize];
        let corners = [
            mesh.positions[at[0]],
            mesh.positions[at[1]],
            mesh.positions[at[2]],
        ];
        let edges = [
            corners[1] - corners[0],
            corners[2] - corners[1],
            corners[0] - corners[2],
        ];
        let face = edges[0].cross(edges[1]);
        let lengths = [
            edges[0].length_squared(),
            edges[1].length_squared(),
            edges[2].length_squared(),
        ];
        for k in (0..3).filter(|&k| is_asked(t[k])) {
            let (normal, last) = (normals[at[k]], (k + 2) % 3);
            let rise = |height: f32, length: f32| {
                let height = height.max(0.0);
                height * height / length.max(f32::MIN_POSITIVE)
            };
            let share = if face.dot(normal) < 0.0 {
                1.0
            } else {
                let next = rise(edges[k].dot(normal), lengths[k]);
                let last = rise(-edges[last].dot(normal), lengths[last]);
                0.5 * (next + last) / normal.length_squared().max(f32::MIN_POSITIVE)
            };
            sums[at[k]].0 += share;
            sums[at[k]].1 += 1.0;
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

    fn share_at_tip(fan: &Mesh) -> f32 {
        let center = fan.triangles.iter().map(|t| {
            let [a, b, c] = t.map(|i| fan.positions[i as usize]);
            (b - a).cross(c - a)
        });
        let mut normals = vec![Vec3::Z; fan.positions.len()];
        normals[0] = center.sum();
        covered(fan, &normals, |_| true)[0]
    }

    #[test]
    fn the_bottom_of_a_funnel_is_covered_by_the_squared_sine_of_its_slope_and_a_tip_by_nothing() {
        let slope = 0.75_f32; // 3-4-5: sin² = 9/25
        assert!((share_at_tip(&fan(|_| slope)) - 0.36).abs() < 1e-5);
        assert_eq!(share_at_tip(&fan(|_| -slope)), 0.0);
        assert!(share_at_tip(&fan(|_| 0.0)) < 1e-6);
    }

    #[test]
    fn a_folded_face_covers_more_than_the_default_allows() {
        let mut fan = fan(|_| 0.0);
        // One corner of the rim swings far over to the other side: a face there lies upside down.
        fan.positions[3] = Vec3::new(0.5, -0.4, 0.3);
        assert!(share_at_tip(&fan) > CREASED);
    }
}
