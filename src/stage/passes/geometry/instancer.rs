//! The arrays of a PointInstancer → points with transforms, those of
//! `UsdGeomPointInstancer::ComputeInstanceTransformsAtTime` without the prototypes' own.
//!
//! Velocities with samples at the times of what they move hold everything at its last sample and move it on from there;
//! without, everything is interpolated. What `invisibleIds` hides at the time and `inactiveIds` at all times is left out.

use super::super::super::raw::{RawPrim, Sample, Value};
use super::attributes::{ints, long_ints, quaternions, vectors};
use glam::{DMat3, DMat4, DQuat, Vec3, Vec4};
use std::borrow::Cow;
use std::collections::HashSet;

/// When an instancer is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment {
    /// Time code; `None` = default time.
    pub(super) time: Option<f64>,
    pub(super) time_codes_per_second: f64,
}

impl Moment {
    /// Seconds since the sample at the time code `sample`; below 0 before the first sample.
    fn seconds_since(self, sample: f64) -> f64 {
        let time = self.time.unwrap_or(sample);
        (time - sample) / self.time_codes_per_second
    }
}

/// One visible point.
pub(super) struct Point {
    pub(super) index: usize,
    /// Below the number of prototypes.
    pub(super) prototype: usize,
    /// Translation × orientation × scale. Finite.
    pub(super) matrix: DMat4,
}

/// Visible points of `instancer`, and how many more name no prototype or have a transform that is not finite.
///
/// # Errors
/// Arrays of different lengths: usd-core computes nothing then either.
pub(super) fn points(
    instancer: &RawPrim,
    prototype_count: usize,
    moment: Moment,
) -> Result<(Vec<Point>, usize), String> {
    let arrays = Arrays::read(instancer, moment)?;
    let invisible = long_ints(instancer, "invisibleIds");
    let inactive = instancer.inactive_ids.iter().copied();
    let invisible: HashSet<i64> = invisible.into_iter().chain(inactive).collect();
    let mut points = Vec::with_capacity(arrays.prototypes.len());
    let mut without = 0;
    for (index, &prototype) in arrays.prototypes.iter().enumerate() {
        if !invisible.is_empty() && invisible.contains(&arrays.id(index)) {
            continue;
        }
        let prototype = usize::try_from(prototype).ok();
        let matrix = arrays.matrix(index);
        match prototype.filter(|&prototype| prototype < prototype_count) {
            Some(prototype) if matrix.is_finite() => points.push(Point {
                index,
                prototype,
                matrix,
            }),
            _ => without += 1,
        }
    }
    Ok((points, without))
}

/// Equal lengths; `scales`, `orientations` and `ids` may be empty.
struct Arrays<'a> {
    prototypes: &'a [i32],
    positions: Cow<'a, [Vec3]>,
    scales: &'a [Vec3],
    orientations: &'a [Vec4],
    /// Turns that follow on `orientations`; empty without.
    spins: Vec<DQuat>,
    ids: Vec<i64>,
}

impl<'a> Arrays<'a> {
    fn read(instancer: &'a RawPrim, moment: Moment) -> Result<Self, String> {
        let name = match quaternions(instancer, "orientationsf") {
            [] => "orientations",
            _ => "orientationsf",
        };
        let moving = velocities(instancer, "positions", "velocities");
        let turning = velocities(instancer, name, "angularVelocities");
        let is_held = moving.is_some() || turning.is_some();
        let held = |name| held(instancer, name).filter(|_| is_held);
        let arrays = Self {
            prototypes: ints(instancer, "protoIndices"),
            positions: match moving {
                Some((start, velocities)) => {
                    let accelerations = beside(start, self::held(instancer, "accelerations"));
                    Cow::Owned(moved(start, (velocities, accelerations), moment))
                }
                None => Cow::Borrowed(
                    held("positions").map_or_else(|| vectors(instancer, "positions"), vectors_of),
                ),
            },
            scales: held("scales").map_or_else(|| vectors(instancer, "scales"), vectors_of),
            orientations: held(name).map_or_else(|| quaternions(instancer, name), quaternions_of),
            spins: match turning {
                Some((start, velocities)) => spins(start, velocities, moment),
                None => Vec::new(),
            },
            ids: long_ints(instancer, "ids"),
        };
        let count = arrays.prototypes.len();
        for (name, length, is_optional) in [
            ("positions", arrays.positions.len(), false),
            ("scales", arrays.scales.len(), true),
            ("orientations", arrays.orientations.len(), true),
        ] {
            if length != count && !(is_optional && length == 0) {
                return Err(format!("it has {length} {name} for {count} protoIndices"));
            }
        }
        Ok(arrays)
    }

    /// Identity for `invisibleIds`: the index where `ids` does not fit.
    fn id(&self, index: usize) -> i64 {
        if self.ids.len() == self.prototypes.len() {
            self.ids[index]
        } else {
            i64::try_from(index).unwrap_or(i64::MAX)
        }
    }

    fn matrix(&self, index: usize) -> DMat4 {
        let mut linear = DMat3::IDENTITY;
        if let Some(orientation) = self.orientations.get(index) {
            // Not normalized: usd-core takes the quaternion as it is here (unlike in `xformOp:orient`).
            linear *= DMat3::from_quat(DQuat::from_vec4(orientation.as_dvec4()));
            if let Some(spin) = self.spins.get(index) {
                linear = DMat3::from_quat(*spin) * linear;
            }
        }
        if let Some(scale) = self.scales.get(index) {
            linear *= DMat3::from_diagonal(scale.as_dvec3());
        }
        DMat4::from_translation(self.positions[index].as_dvec3()) * DMat4::from_mat3(linear)
    }
}

/// The samples of `start` and of its velocities `by`, if they are at one time and as many.
fn velocities<'a>(
    instancer: &'a RawPrim,
    start: &str,
    by: &str,
) -> Option<(&'a Sample, &'a [Vec3])> {
    let start = held(instancer, start)?;
    Some((start, beside(start, held(instancer, by))?))
}

/// Positions moved on from those of a sample.
fn moved(
    start: &Sample,
    (velocities, accelerations): (&[Vec3], Option<&[Vec3]>),
    moment: Moment,
) -> Vec<Vec3> {
    let seconds = moment.seconds_since(start.time);
    let position = |(index, start): (usize, &Vec3)| {
        let acceleration = accelerations.map_or(Vec3::ZERO, |all| all[index]);
        let mean = velocities[index].as_dvec3() + 0.5 * seconds * acceleration.as_dvec3();
        (start.as_dvec3() + seconds * mean).as_vec3()
    };
    vectors_of(start).iter().enumerate().map(position).collect()
}

/// Turns since a sample, by degrees a second around each vector.
fn spins(start: &Sample, velocities: &[Vec3], moment: Moment) -> Vec<DQuat> {
    let seconds = moment.seconds_since(start.time);
    let spin = |velocity: &Vec3| {
        let turn = velocity.as_dvec3() * seconds;
        DQuat::from_scaled_axis(turn.map(f64::to_radians))
    };
    velocities.iter().map(spin).collect()
}

fn held<'a>(instancer: &'a RawPrim, name: &str) -> Option<&'a Sample> {
    instancer.attributes.get(name)?.held.as_deref()
}

/// The vectors of `sample`, if it is at the time of `start` and has as many values.
fn beside<'a>(start: &Sample, sample: Option<&'a Sample>) -> Option<&'a [Vec3]> {
    #[expect(
        clippy::float_cmp,
        reason = "usd-core takes samples at the very same time alone"
    )]
    let sample = sample.filter(|sample| sample.time == start.time)?;
    let vectors = vectors_of(sample);
    (Some(vectors.len()) == start.value.array_len()).then_some(vectors)
}

fn vectors_of(sample: &Sample) -> &[Vec3] {
    match &sample.value {
        Value::Vec3Array(vectors) => vectors,
        _ => &[],
    }
}

fn quaternions_of(sample: &Sample) -> &[Vec4] {
    match &sample.value {
        Value::QuatArray(quaternions) => quaternions,
        _ => &[],
    }
}
