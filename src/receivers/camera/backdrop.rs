//! What a camera sees besides surfaces: the shapes of lights, the sky.

use super::{CameraRay, Frame, Sampling, Sights, View};
use crate::results::Target;
use crate::scene::{Camera, Scene};
use crate::trace::{Hit, Tracer};
use glam::Vec4;
use rayon::prelude::*;

/// Color and coverage along a ray, before the first surface that nothing passes through.
pub type Glow<'a> = &'a (dyn Fn(&CameraRay, Option<Hit>) -> Vec4 + Sync);

/// What `camera` sees besides surfaces, a pixel each, rows from the top: the mean of `glow` over the samples of
/// [`place_with`](super::place_with), which made `target`. Pixels that surfaces cover wholly show nothing else: there is no
/// light before them, since surfaces behind it cover nothing.
pub fn backdrop(
    scene: &Scene,
    tracer: &Tracer,
    glow: Glow<'_>,
    (camera, frame): (&Camera, Frame),
    (sampling, target): (&Sampling, &Target),
) -> Vec<Vec4> {
    let view = View::new(scene, &|_| (), (camera, frame), sampling);
    let covered = coverage(target, frame);
    let mean = |x: u32, y: u32, sights: &mut Sights| {
        if covered[(y * frame.width + x) as usize] >= 1.0 {
            return Vec4::ZERO;
        }
        view.look_through((x, y), &mut Vec::new(), sights);
        sights.look(tracer);
        let seen = sights.rays.iter().enumerate();
        let sum: Vec4 = seen.map(|(i, ray)| glow(ray, sights.beam.hit(i))).sum();
        sum / sights.rays.len() as f32
    };
    let row = |y: u32| {
        let mut sights = Sights::default();
        (0..frame.width)
            .map(|x| mean(x, y, &mut sights))
            .collect::<Vec<Vec4>>()
    };
    let rows: Vec<_> = (0..frame.height).into_par_iter().map(row).collect();
    rows.concat()
}

/// How much of each pixel receivers stand for, 0…1.
fn coverage(target: &Target, frame: Frame) -> Vec<f32> {
    let mut covered = vec![0.0; frame.width as usize * frame.height as usize];
    if let Target::Image { shares, .. } = target {
        for share in shares {
            covered[share.pixel as usize] += share.weight;
        }
    }
    covered
}
