//! What rays along the axes of maps see: maps without errors of their own.

use super::{Asked, Question};
use crate::gather::maps::{self, MapsSky};
use glam::Vec3;
use rayon::prelude::*;

/// Receivers nearer to a corner or edge than this in barycentric weight have no plane of their own: as rays have it.
const RIM: f32 = 1e-4;

/// What the few receivers see by rays along the axes of `count` maps, for each thing asked for: of an image what comes
/// from the even part of `sky`.
pub(super) fn along_axes(
    question: &Question<'_>,
    count: u32,
    max_distance: Option<f32>,
    sky: Option<&MapsSky>,
) -> Vec<Vec<f64>> {
    let axes: Vec<Vec3> = maps::directions(count).collect();
    let reach = max_distance.unwrap_or(f32::INFINITY);
    let few = question.few;
    let seen: Vec<(f64, Vec3)> = (0..few.len())
        .into_par_iter()
        .map(|i| {
            let (mut open, mut all) = (0.0, 0.0);
            let stand = Stand::of(question, i);
            let mut covered = Vec::with_capacity(axes.len());
            for axis in &axes {
                let height = axis.dot(few.normal[i]);
                let direction = if height < 0.0 { -axis } else { *axis };
                let weight = f64::from(height.abs());
                all += weight;
                covered.push(stand.is_covered(question, direction, reach));
                open += if covered.last() == Some(&true) {
                    0.0
                } else {
                    weight
                };
            }
            let light = sky.map_or(Vec3::ZERO, |sky| sky.even_light(few.normal[i], &covered));
            (if all > 0.0 { open / all } else { 0.0 }, light)
        })
        .collect();
    let values = |asked: &Asked| {
        if asked.is_image {
            let light = seen.iter().flat_map(|(_, light)| light.to_array());
            light.map(f64::from).collect()
        } else {
            seen.iter().map(|(open, _)| *open).collect()
        }
    };
    question.asked.iter().map(values).collect()
}

/// Where a receiver's rays start and the plane they do not cross.
struct Stand {
    origin: Vec3,
    plane: Option<Vec3>,
}

impl Stand {
    fn of(question: &Question<'_>, i: usize) -> Self {
        let few = question.few;
        let (normal, plane) = (few.normal[i], few.geometric_normal[i]);
        let surface = &few.surface[i];
        let on_rim = surface.u.min(surface.v).min(1.0 - surface.u - surface.v) < RIM;
        let lift = if on_rim && normal.dot(plane) > 0.5 {
            normal
        } else {
            plane
        };
        Self {
            origin: question.scene.tracer.lift(few.position[i], lift),
            plane: (!on_rim).then_some(plane),
        }
    }

    fn is_covered(&self, question: &Question<'_>, direction: Vec3, reach: f32) -> bool {
        let direction = match self.plane {
            Some(plane) if direction.dot(plane) < 0.0 => {
                direction - plane * (2.0 * direction.dot(plane))
            }
            _ => direction,
        };
        question
            .scene
            .tracer
            .occluded(self.origin, direction, reach)
    }
}
