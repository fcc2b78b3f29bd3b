//! Pixels of which all samples meet one triangle, which most are: their receiver, without one for each sample before.

use super::{Face, SAME_NORMAL_COSINE, Seen, View, WorldRay, key_of};
use crate::scene::{Normals, on_the_side_of};
use crate::trace::{Hit, Layer};
use glam::Vec3;

impl<'a> View<'a> {
    /// What [`View::merge`] makes of a pixel whose `rays` meet nothing but one face, in one piece; `None` if they do not.
    pub(super) fn of_one_face(
        &self,
        rays: &[WorldRay],
        layers: &[Vec<Layer>],
        last: &mut Option<Face<'a>>,
    ) -> Option<Seen> {
        let [first] = layers.first()?[..] else {
            return None;
        };
        let key = key_of(&first.hit);
        let is_only_this = |layers: &Vec<Layer>| matches!(layers[..], [Layer { hit, opacity: 1.0 }] if key_of(&hit) == key);
        if !layers.iter().all(is_only_this) {
            return None;
        }
        let face = self.face(last, &first.hit);
        let [across, along] = *face.even.get_or_init(|| edges_if_even(face)).as_ref()?;
        let hits = || layers.iter().map(|layers| layers[0].hit);
        let count = layers.len() as f32;
        let (u, v) = hits().fold((0.0, 0.0), |sum, hit| (sum.0 + hit.u, sum.1 + hit.v));
        let (u, v) = (u / count, v / count);
        let off_mean = |hit: &Hit| (across * (hit.u - u) + along * (hit.v - v)).length_squared();
        let (nearest, hit) =
            (hits().enumerate()).min_by(|a, b| off_mean(&a.1).total_cmp(&off_mean(&b.1)))?;
        let depths = rays
            .iter()
            .zip(hits())
            .map(|(ray, hit)| self.depth(ray, &hit));
        let mut merged = self.seen(&rays[nearest], (&hit, face), 1.0);
        let mean = Hit { u, v, ..hit };
        merged.normal = on_the_side_of(face.normal, face.shading_normal(&mean));
        merged.position = face.world.position(hit.triangle, u, v);
        merged.depth = depths.sum::<f32>() / count;
        (merged.surface.u, merged.surface.v) = (u, v);
        Some(merged)
    }
}

/// The edges of `face` from its first corner, stage units, if all its normals belong to one surface.
fn edges_if_even(face: &Face<'_>) -> Option<[Vec3; 2]> {
    let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)];
    if !matches!(face.world.mesh.normals, Normals::Flat) {
        let [a, b, c] = corners.map(|(u, v)| face.world.shading_normal(face.triangle, u, v));
        // No two normals between these are farther apart than they are.
        let is_even = |(a, b): (Vec3, Vec3)| a.dot(b) > SAME_NORMAL_COSINE;
        if ![(a, b), (b, c), (c, a)].into_iter().all(is_even) {
            return None;
        }
    }
    let [origin, u, v] = corners.map(|(u, v)| face.world.position(face.triangle, u, v));
    Some([u - origin, v - origin])
}
