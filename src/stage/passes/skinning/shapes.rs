//! Blend shapes: what a weight adds to points and normals, as `UsdSkelBlendShapeQuery` has it.
//!
//! A shape may have others in between, each at a weight of its own; the shape itself is at 1, and nothing at 0. A weight
//! blends the two that it lies between, and beyond the ends it goes on as there.

use super::{value, vectors};
use crate::stage::raw::{RawPrim, Value};
use glam::Vec3;

/// Weights of no more than this are none, and shapes no further apart are one.
const CLOSE: f32 = 1e-6;

/// Start of the names of what is in between.
const BETWEEN: &str = "inbetweens:";

/// End of those of normals.
const OF_NORMALS: &str = ":normalOffsets";

/// Offsets at a weight; none for nothing.
#[derive(Debug, Clone, Copy)]
struct Step<'a> {
    weight: f32,
    points: Option<&'a [Vec3]>,
    normals: Option<&'a [Vec3]>,
}

/// A `BlendShape` prim.
#[derive(Debug)]
pub(super) struct Shape<'a> {
    /// By weight.
    steps: Vec<Step<'a>>,
    /// Of the points that it moves; `None` = all.
    indices: Option<&'a [i32]>,
}

impl<'a> Shape<'a> {
    /// `None` where its offsets are missing.
    pub(super) fn of(prim: &'a RawPrim) -> Option<Self> {
        let nothing = Step {
            weight: 0.0,
            points: None,
            normals: None,
        };
        let whole = Step {
            weight: 1.0,
            points: Some(vectors(prim, "offsets")?),
            normals: vectors(prim, "normalOffsets"),
        };
        let mut steps = vec![nothing, whole];
        steps.extend(between(prim));
        steps.sort_by(|a, b| a.weight.total_cmp(&b.weight));
        let indices = match value(prim, "pointIndices") {
            Some(Value::IntArray(indices)) if !indices.is_empty() => Some(indices.as_slice()),
            _ => None,
        };
        Some(Self { steps, indices })
    }

    /// Add what `weight` makes of the shape to `points` and, if there are as many, to `normals`. `None` for points that
    /// do not exist.
    pub(super) fn add(
        &self,
        weight: f32,
        points: &mut [Vec3],
        mut normals: Option<&mut [Vec3]>,
    ) -> Option<()> {
        if weight.abs() <= CLOSE {
            return Some(());
        }
        for (share, step) in self.shares(weight) {
            if let Some(offsets) = step.points {
                self.offset(points, offsets, share)?;
            }
            if let (Some(normals), Some(offsets)) = (normals.as_deref_mut(), step.normals) {
                self.offset(normals, offsets, share)?;
            }
        }
        Some(())
    }

    /// The two steps that `weight` lies between, or the first or last two, and how much of each.
    fn shares(&self, weight: f32) -> impl Iterator<Item = (f32, &Step<'a>)> {
        let above = self.steps.partition_point(|step| step.weight <= weight);
        let above = above.clamp(1, self.steps.len() - 1);
        let (lower, upper) = (&self.steps[above - 1], &self.steps[above]);
        let width = upper.weight - lower.weight;
        let share = (weight - lower.weight) / width;
        let both = [(1.0 - share, lower), (share, upper)];
        let is_wide = width > CLOSE;
        both.into_iter()
            .filter(move |(share, _)| is_wide && share.abs() > CLOSE)
    }

    fn offset(&self, values: &mut [Vec3], offsets: &[Vec3], share: f32) -> Option<()> {
        let Some(indices) = self.indices else {
            let all = values.iter_mut().zip(offsets);
            all.for_each(|(value, &offset)| *value += offset * share);
            return Some(());
        };
        for (&index, &offset) in indices.iter().zip(offsets) {
            *values.get_mut(usize::try_from(index).ok()?)? += offset * share;
        }
        Some(())
    }
}

/// Shapes in between; those without a weight of their own are none.
fn between(prim: &RawPrim) -> impl Iterator<Item = Step<'_>> {
    let all = prim.attributes.iter();
    all.filter_map(|(name, attribute)| {
        let is_step = name.starts_with(BETWEEN) && !name.ends_with(OF_NORMALS);
        let weight = attribute
            .weight
            .filter(|weight| is_step && weight.is_finite())?;
        Some(Step {
            weight,
            points: Some(vectors(prim, name)?),
            normals: vectors(prim, &format!("{name}{OF_NORMALS}")),
        })
    })
}
