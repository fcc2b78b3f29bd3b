//! The arrays of a PointInstancer → points with transforms, those of
//! `UsdGeomPointInstancer::ComputeInstanceTransformsAtTime` without the prototypes' own.
//!
//! What `invisibleIds` hides at the time and `inactiveIds` at all times is left out.

use super::super::super::raw::RawPrim;
use super::attributes::{ints, long_ints, quaternions, vectors};
use glam::{DMat3, DMat4, DQuat, Vec3, Vec4};
use std::collections::HashSet;

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
) -> Result<(Vec<Point>, usize), String> {
    let arrays = Arrays::read(instancer)?;
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
    positions: &'a [Vec3],
    scales: &'a [Vec3],
    orientations: &'a [Vec4],
    ids: Vec<i64>,
}

impl<'a> Arrays<'a> {
    fn read(instancer: &'a RawPrim) -> Result<Self, String> {
        let arrays = Self {
            prototypes: ints(instancer, "protoIndices"),
            positions: vectors(instancer, "positions"),
            scales: vectors(instancer, "scales"),
            orientations: match quaternions(instancer, "orientationsf") {
                [] => quaternions(instancer, "orientations"),
                precise => precise,
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
        }
        if let Some(scale) = self.scales.get(index) {
            linear *= DMat3::from_diagonal(scale.as_dvec3());
        }
        DMat4::from_translation(self.positions[index].as_dvec3()) * DMat4::from_mat3(linear)
    }
}
