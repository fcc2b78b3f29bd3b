//! Light of what only part of a group sees.
//!
//! A group asks with more rays, and what they tell is taken to change evenly from one end of the group to the other: a plane
//! through the answers of all members. With as many rays in all, a plane through 64 answers errs by half of what members
//! do that each believe their own.

use super::RasterEngine;
use super::cut::{Cut, Doubt};
use super::group::Group;
use super::probe;
use super::transport::Area;
use glam::Vec3;
use std::f32::consts::PI;

/// Adds light from all doubts of `cut` to the `sums` of the members, which hold all other light; `light` tells what they
/// would receive from areas in full view.
pub(super) fn add(
    engine: &RasterEngine<'_>,
    group: &Group,
    cut: &Cut,
    light: &dyn Fn(&[Area]) -> Vec<Vec3>,
    sums: &mut [Vec3],
) {
    let of_areas = |doubt: &Doubt| light(&cut.doubtful[doubt.areas.clone()]);
    let mut full: Vec<Vec<Vec3>> = cut.doubts.iter().map(of_areas).collect();
    for close in &cut.close {
        for i in (0..group.len()).filter(|&i| !group.is_near(i, &close.disk)) {
            let place = (group.positions[i], group.normals[i]);
            let max_distance = engine.knobs.max_distance;
            let seen = close.area.seen_from(place.0, place.1, max_distance);
            let into = match close.doubt {
                Some(doubt) => &mut full[doubt][i],
                None => &mut sums[i],
            };
            *into += close.area.light * seen;
        }
    }
    let brightness = |light: &[Vec3]| light.iter().map(|light| light.element_sum()).sum::<f32>();
    let shares: Vec<f32> = full.iter().map(|full| brightness(full)).collect();
    let total = brightness(sums) + shares.iter().sum::<f32>();
    for ((doubt, full), share) in cut.doubts.iter().zip(&full).zip(shares) {
        if share > 0.0 {
            add_one(engine, group, (doubt, full, share / total), sums);
        }
    }
}

/// Adds a doubt whose light would be `part` of all if it were in full view.
fn add_one(
    engine: &RasterEngine<'_>,
    group: &Group,
    (doubt, full, part): (&Doubt, &[Vec3], f32),
    sums: &mut [Vec3],
) {
    let mut answers = doubt.answers.clone();
    let usual = engine.knobs.max_solid_angle / (2.0 * PI);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a few rays"
    )]
    let rays = (engine.knobs.more_rays * (part / usual).min(1.0)) as usize;
    let cluster = (&doubt.surfels, doubt.mean);
    probe::more(engine, group, cluster, (rays, None), &mut answers);
    let fit = answers.fitted(group);
    for ((sum, full), &place) in sums.iter_mut().zip(full).zip(&group.across) {
        *sum += *full * fit.at(place);
    }
}
