//! Animation of nodes → samples of their translation, rotation and scale.

use super::RATE;
use super::accessor::numbers;
use super::document::Document;
use crate::diagnostics::Diagnostics;
use glam::{Quat, Vec3, Vec4};
use gltf::accessor::Dimensions;
use gltf::animation::{Interpolation, Property};
use std::collections::BTreeMap;

/// Time codes before a step at which the value before it is held.
const STEP: f64 = 1e-3;

/// Most frames that a cubic spline is sampled at: an hour at 24 a second.
const MOST_FRAMES: f64 = 86_400.0;

/// Samples of one property of a node by time code.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Track {
    Vectors(Vec<(f64, Vec3)>),
    Rotations(Vec<(f64, Quat)>),
}

/// The tracks of a node.
#[derive(Debug, Clone, Default)]
pub(super) struct Tracks {
    pub(super) translation: Option<Track>,
    pub(super) rotation: Option<Track>,
    pub(super) scale: Option<Track>,
}

impl Tracks {
    /// Those that there are.
    pub(super) fn all(&self) -> impl Iterator<Item = &Track> {
        [&self.translation, &self.rotation, &self.scale]
            .into_iter()
            .flatten()
    }
}

/// Everything that moves, by node.
#[derive(Debug, Default)]
pub(super) struct Motion {
    nodes: BTreeMap<usize, Tracks>,
    /// One a morph target: the first number is its weight.
    weights: BTreeMap<usize, Vec<Track>>,
    range: Option<(f64, f64)>,
}

impl Motion {
    /// The first animation of the file.
    pub(super) fn read(document: &Document, diagnostics: &Diagnostics) -> Result<Self, String> {
        let mut motion = Self::default();
        let mut animations = document.gltf.animations();
        let Some(animation) = animations.next() else {
            return Ok(motion);
        };
        let place = document.path.to_string_lossy();
        let more = animations.count();
        if more > 0 {
            let message = format!("{more} animations after the first are left out");
            diagnostics.warn("lost", place.clone(), message);
        }
        for channel in animation.channels() {
            let target = channel.target();
            if target.property() == Property::MorphTargetWeights {
                let tracks = weights(document, &channel)?;
                tracks.iter().take(1).for_each(|track| motion.extend(track));
                motion.weights.insert(target.node().index(), tracks);
                continue;
            }
            let track = track(document, &channel)?;
            motion.extend(&track);
            let tracks = motion.nodes.entry(target.node().index()).or_default();
            match target.property() {
                Property::Translation => tracks.translation = Some(track),
                Property::Rotation => tracks.rotation = Some(track),
                _ => tracks.scale = Some(track),
            }
        }
        Ok(motion)
    }

    /// Take the times of `track` into the range.
    fn extend(&mut self, track: &Track) {
        let times = |f: fn(f64, f64) -> f64| track.times().reduce(f);
        if let Some((first, last)) = times(f64::min).zip(times(f64::max)) {
            let (low, high) = self.range.unwrap_or((first, last));
            self.range = Some((low.min(first), high.max(last)));
        }
    }

    /// First and last time code.
    pub(super) fn range(&self) -> Option<(f64, f64)> {
        self.range
    }

    /// What moves node `index`.
    pub(super) fn of(&self, index: usize) -> Option<&Tracks> {
        self.nodes.get(&index)
    }

    /// Weights of the morph targets of node `index`, if they move.
    pub(super) fn weights_of(&self, index: usize) -> Option<&Vec<Track>> {
        self.weights.get(&index)
    }
}

impl Track {
    /// The vector at `time`, straight between samples; of rotations, none.
    pub(super) fn vector_at(&self, time: f64) -> Vec3 {
        match self {
            Self::Vectors(samples) => {
                between(samples, time, |a, b, t| a.lerp(b, t)).unwrap_or_default()
            }
            Self::Rotations(_) => Vec3::ZERO,
        }
    }

    /// The rotation at `time`, the short way between samples; of vectors, none.
    pub(super) fn rotation_at(&self, time: f64) -> Quat {
        match self {
            Self::Rotations(samples) => {
                between(samples, time, Quat::slerp).unwrap_or(Quat::IDENTITY)
            }
            Self::Vectors(_) => Quat::IDENTITY,
        }
    }

    /// Time codes of the samples.
    pub(super) fn times(&self) -> Box<dyn Iterator<Item = f64> + '_> {
        match self {
            Self::Vectors(samples) => Box::new(samples.iter().map(|sample| sample.0)),
            Self::Rotations(samples) => Box::new(samples.iter().map(|sample| sample.0)),
        }
    }
}

/// The value of `samples` at `time`, held before the first and after the last; `None` if there are none.
fn between<T: Copy>(samples: &[(f64, T)], time: f64, blend: fn(T, T, f32) -> T) -> Option<T> {
    let after = samples.partition_point(|sample| sample.0 <= time);
    let (Some(before), Some(after)) = (after.checked_sub(1), samples.get(after)) else {
        return samples.get(after.saturating_sub(1)).map(|sample| sample.1);
    };
    let (start, from) = samples[before];
    #[expect(clippy::cast_possible_truncation, reason = "0…1")]
    let t = ((time - start) / (after.0 - start)) as f32;
    Some(blend(from, after.1, t))
}

/// Weights of morph targets, a track each.
fn weights(
    document: &Document,
    channel: &gltf::animation::Channel<'_>,
) -> Result<Vec<Track>, String> {
    let sampler = channel.sampler();
    let codes = codes(document, &sampler)?;
    let values = numbers(document, &sampler.output(), &[Dimensions::Scalar])?;
    let is_cubic = sampler.interpolation() == Interpolation::CubicSpline;
    let rows = codes.len() * if is_cubic { 3 } else { 1 };
    if rows == 0 || values.len() % rows != 0 {
        return Err(format!(
            "an animation has {} weights for {} keys",
            values.len(),
            codes.len()
        ));
    }
    let count = values.len() / rows;
    let of_target = |k: usize| {
        let column = values.iter().skip(k).step_by(count);
        let column = column.map(|&weight| Vec4::new(weight, 0.0, 0.0, 0.0));
        let samples = samples(&sampler, &codes, column.collect())?;
        let scalars = samples
            .into_iter()
            .map(|(time, value)| (time, value.truncate()));
        Ok(Track::Vectors(scalars.collect()))
    };
    (0..count).map(of_target).collect()
}

/// Times of keys as time codes, rising.
fn codes(document: &Document, sampler: &gltf::animation::Sampler<'_>) -> Result<Vec<f64>, String> {
    let times = numbers(document, &sampler.input(), &[Dimensions::Scalar])?;
    if times.windows(2).any(|pair| pair[1] <= pair[0]) {
        return Err("the times of an animation do not rise".to_owned());
    }
    Ok(times.iter().map(|&time| f64::from(time) * RATE).collect())
}

/// Samples between which values go straight.
fn samples(
    sampler: &gltf::animation::Sampler<'_>,
    codes: &[f64],
    values: Vec<Vec4>,
) -> Result<Vec<(f64, Vec4)>, String> {
    Ok(match sampler.interpolation() {
        Interpolation::Linear => codes.iter().copied().zip(values).collect(),
        Interpolation::Step => held(codes, &values),
        Interpolation::CubicSpline => spline(codes, &values)?,
    })
}

fn track(document: &Document, channel: &gltf::animation::Channel<'_>) -> Result<Track, String> {
    let sampler = channel.sampler();
    let is_rotation = channel.target().property() == Property::Rotation;
    let codes = codes(document, &sampler)?;
    let dimensions = if is_rotation {
        Dimensions::Vec4
    } else {
        Dimensions::Vec3
    };
    let values = numbers(document, &sampler.output(), &[dimensions])?;
    let width = dimensions.multiplicity();
    let values: Vec<Vec4> = values
        .chunks_exact(width)
        .map(|value| {
            Vec4::new(
                value[0],
                value[1],
                value[2],
                value.get(3).copied().unwrap_or(0.0),
            )
        })
        .collect();
    let is_cubic = sampler.interpolation() == Interpolation::CubicSpline;
    let needed = codes.len() * if is_cubic { 3 } else { 1 };
    if values.len() != needed {
        return Err(format!(
            "an animation has {} values where {needed} are needed",
            values.len()
        ));
    }
    let samples = samples(&sampler, &codes, values)?;
    Ok(match is_rotation {
        true => Track::Rotations(rotations(samples)),
        false => {
            let vectors = samples
                .into_iter()
                .map(|(time, value)| (time, value.truncate()));
            Track::Vectors(vectors.collect())
        }
    })
}

/// Unit, each on the side of the one before, so that the short way is taken between them.
fn rotations(samples: Vec<(f64, Vec4)>) -> Vec<(f64, Quat)> {
    let mut before = Vec4::ZERO;
    let turned = samples.into_iter().map(|(time, value)| {
        let value = value.try_normalize().unwrap_or(Vec4::W);
        let value = if value.dot(before) < 0.0 {
            -value
        } else {
            value
        };
        before = value;
        (time, Quat::from_vec4(value))
    });
    turned.collect()
}

fn held(codes: &[f64], values: &[Vec4]) -> Vec<(f64, Vec4)> {
    let mut samples = Vec::with_capacity(2 * codes.len());
    for (k, (&code, &value)) in codes.iter().zip(values).enumerate() {
        samples.push((code, value));
        if let Some(&next) = codes.get(k + 1).filter(|&&next| next - code > 2.0 * STEP) {
            samples.push((next - STEP, value));
        }
    }
    samples
}

/// At every key and every whole frame between: glTF 2.0, appendix C.
fn spline(codes: &[f64], values: &[Vec4]) -> Result<Vec<(f64, Vec4)>, String> {
    let ends = codes.first().zip(codes.last());
    if ends.is_some_and(|(first, last)| last - first > MOST_FRAMES) {
        return Err("an animation is longer than an hour".to_owned());
    }
    let mut samples = Vec::new();
    for k in 0..codes.len() {
        samples.push((codes[k], values[3 * k + 1]));
        let Some(&next) = codes.get(k + 1) else {
            continue;
        };
        let span = next - codes[k];
        #[expect(
            clippy::cast_possible_truncation,
            reason = "seconds in single precision"
        )]
        let seconds = (span / RATE) as f32;
        let (from, out) = (values[3 * k + 1], values[3 * k + 2] * seconds);
        let (into, to) = (values[3 * k + 3] * seconds, values[3 * k + 4]);
        let mut frame = codes[k].floor() + 1.0;
        while frame < next {
            #[expect(clippy::cast_possible_truncation, reason = "0…1")]
            let t = ((frame - codes[k]) / span) as f32;
            let (t2, t3) = (t * t, t * t * t);
            let value = from * (2.0 * t3 - 3.0 * t2 + 1.0)
                + out * (t3 - 2.0 * t2 + t)
                + to * (3.0 * t2 - 2.0 * t3)
                + into * (t3 - t2);
            samples.push((frame, value));
            frame += 1.0;
        }
    }
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_held_until_just_before_the_next() {
        let values = [Vec4::ZERO, Vec4::ONE];
        let samples = held(&[0.0, 12.0], &values);
        assert_eq!(
            samples,
            [
                (0.0, Vec4::ZERO),
                (12.0 - STEP, Vec4::ZERO),
                (12.0, Vec4::ONE)
            ]
        );
    }

    #[test]
    fn a_spline_with_the_slope_of_a_line_is_the_line() {
        // one second from 0 to 24, slope 24 a second
        let slope = Vec4::splat(24.0);
        let values = [slope, Vec4::ZERO, slope, slope, slope, slope];
        for (time, value) in spline(&[0.0, 24.0], &values).unwrap() {
            assert!((f64::from(value.x) - time).abs() < 1e-5, "{time}");
        }
    }

    #[test]
    fn rotations_take_the_short_way() {
        let turned = rotations(vec![(0.0, Vec4::W), (1.0, Vec4::new(0.1, 0.0, 0.0, -1.0))]);
        assert!(turned[1].1.w > 0.0);
    }
}
