//! What makes the points of one curve of its control points: the basis of its prim, or knots and weights of its own.

use super::super::super::super::raw::{RawPrim, Value};
use super::super::attributes::{floats, ints};
use super::super::nurbs::Knots;
use super::basis::{Basis, Form, Order, Place, Wrap};
use glam::Vec2;
use std::sync::Arc;

/// Orders above this are refused: what a curve takes grows with their square, and modelers end at 24 or so.
const LARGEST_ORDER: usize = 32;

/// The law of one curve.
#[derive(Debug, Clone)]
pub(super) enum Spline {
    Basis(Form),
    Nurbs(Arc<Nurbs>),
}

/// A non-uniform rational B-spline.
#[derive(Debug)]
pub(super) struct Nurbs {
    knots: Knots,
    /// Degree + 1.
    order: usize,
    /// The segments: number of the knot interval, and the parameters it is drawn between.
    intervals: Vec<(usize, f64, f64)>,
    /// Of the control points, above 0; empty = 1.
    weights: Vec<f64>,
}

impl Spline {
    /// Segments of a curve with `count` control points; `None` where there cannot be so many.
    pub(super) fn segments(&self, count: usize) -> Option<usize> {
        match self {
            Self::Basis(form) => form.segments(count),
            Self::Nurbs(nurbs) => Some(nurbs.intervals.len()),
        }
    }

    /// Values of `varying` interpolation on a curve of `segments` and `count` control points. Of NURBS: one at every knot of
    /// the domain, repeated ones too, as RenderMan counts.
    pub(super) fn varying_count(&self, segments: usize, count: usize) -> usize {
        match self {
            Self::Basis(form) => form.varying_count(segments),
            Self::Nurbs(nurbs) => count + 2 - nurbs.order,
        }
    }

    /// Number of the varying value at the start of `segment`; the next is at its end.
    pub(super) fn varying_at(&self, segment: usize) -> usize {
        match self {
            Self::Basis(_) => segment,
            Self::Nurbs(nurbs) => nurbs.intervals[segment].0 + 1 - nurbs.order,
        }
    }

    /// The control points of a curve of `count` that count at `place`, with their weights.
    pub(super) fn weights(&self, count: usize, place: Place, order: Order) -> Vec<(usize, f64)> {
        match self {
            Self::Basis(form) => form.weights(count, place, order),
            Self::Nurbs(nurbs) => nurbs.weights_at(place, order),
        }
    }

    /// True if the last point is followed by the first.
    pub(super) fn is_closed(&self) -> bool {
        matches!(self, Self::Basis(form) if form.wrap == Wrap::Periodic)
    }

    /// True if the curve has corners at its control points.
    pub(super) fn is_polyline(&self) -> bool {
        match self {
            Self::Basis(form) => form.basis == Basis::Linear,
            Self::Nurbs(nurbs) => nurbs.order == 2,
        }
    }

    /// Where the second derivative of a segment is looked for its largest: that of a cubic is largest at an end.
    pub(super) fn bends(&self) -> &'static [f64] {
        match self {
            Self::Basis(_) => &[0.0, 1.0],
            Self::Nurbs(_) => &[0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0],
        }
    }
}

impl Nurbs {
    /// The rational basis R = N w / Σ N w and its derivatives, by a segment's parameter 0…1.
    fn weights_at(&self, place: Place, order: Order) -> Vec<(usize, f64)> {
        let (span, from, to) = self.intervals[place.segment];
        let length = to - from;
        let first = span + 1 - self.order;
        let weighted = |times: usize| {
            let functions = self.knots.weights(span, from + place.t * length, times);
            let numbered = functions.into_iter().enumerate();
            let own = |at: usize| self.weights.get(first + at).copied().unwrap_or(1.0);
            let all: Vec<f64> = numbered.map(|(at, value)| value * own(at)).collect();
            let sum: f64 = all.iter().sum();
            (all, sum)
        };
        let (values, sum) = weighted(0);
        let slopes = (order != Order::Value).then(|| weighted(1));
        let bends = (order == Order::Second).then(|| weighted(2));
        let all = values.iter().enumerate().map(|(at, value)| {
            let value = value / sum;
            let Some((slopes, slope_sum)) = &slopes else {
                return (first + at, value);
            };
            let slope = (slopes[at] - value * slope_sum) / sum;
            let Some((bends, bend_sum)) = &bends else {
                return (first + at, slope * length);
            };
            let bend = (bends[at] - 2.0 * slope * slope_sum - value * bend_sum) / sum;
            (first + at, bend * length * length)
        });
        all.collect()
    }
}

/// The curves of the `NurbsCurves` prim `prim`, which have `counts` control points each: their laws, or what is wrong with
/// one. The error is of the prim as a whole.
pub(super) fn nurbs(prim: &RawPrim, counts: &[i32]) -> Result<Vec<Result<Spline, String>>, String> {
    let (orders, knots) = (ints(prim, "order"), floats(prim, "knots"));
    let weights = floats(prim, "pointWeights");
    let ranges = match prim.attributes.get("ranges").and_then(|a| a.value.as_ref()) {
        Some(Value::Vec2Array(ranges)) => ranges.as_slice(),
        _ => &[],
    };
    let size = |&number: &i32| usize::try_from(number).unwrap_or(0);
    let counts: Vec<usize> = counts.iter().map(size).collect();
    let orders: Vec<usize> = orders.iter().map(size).collect();
    let (curves, points) = (counts.len(), counts.iter().sum());
    agree("orders", orders.len(), curves)?;
    if !ranges.is_empty() {
        agree("ranges", ranges.len(), curves)?;
    }
    if !weights.is_empty() {
        agree("pointWeights", weights.len(), points)?;
    }
    agree("knots", knots.len(), points + orders.iter().sum::<usize>())?;
    let (mut first_knot, mut first_point) = (0, 0);
    let all = counts.iter().zip(&orders).enumerate();
    let all = all.map(|(number, (&count, &order))| {
        let own_knots = &knots[first_knot..first_knot + count + order];
        let own_weights = match weights.is_empty() {
            true => weights,
            false => &weights[first_point..first_point + count],
        };
        (first_knot, first_point) = (first_knot + count + order, first_point + count);
        let made = one(own_knots, own_weights, (order, count), ranges.get(number));
        made.map(|nurbs| Spline::Nurbs(Arc::new(nurbs)))
    });
    Ok(all.collect())
}

fn agree(what: &str, found: usize, needed: usize) -> Result<(), String> {
    match found == needed {
        true => Ok(()),
        false => Err(format!("there are {found} {what}, {needed} are needed")),
    }
}

fn one(
    knots: &[f32],
    weights: &[f32],
    (order, count): (usize, usize),
    range: Option<&Vec2>,
) -> Result<Nurbs, String> {
    if order > LARGEST_ORDER {
        return Err(format!("order {order} (right: at most {LARGEST_ORDER})"));
    }
    let knots = Knots::new(knots, order, count)?;
    let is_positive = |weight: &&f32| weight.is_finite() && **weight > 0.0;
    if let Some(weight) = weights.iter().find(|weight| !is_positive(weight)) {
        return Err(format!("a pointWeight that is {weight}, not above 0"));
    }
    let (start, end) = knots.domain();
    let range = range.map_or((start, end), |range| {
        let range = range.as_dvec2();
        (range.x.max(start), range.y.min(end))
    });
    let intervals = knots.intervals(range.0, range.1);
    if intervals.is_empty() {
        return Err(format!("a range outside its knots {start} to {end}"));
    }
    Ok(Nurbs {
        knots,
        order,
        intervals,
        weights: weights.iter().map(|&weight| f64::from(weight)).collect(),
    })
}
