//! Curves, by a basis or as NURBS, → tubes and ribbons of triangles.
//!
//! Curves without normals are round tubes with open ends, `widths` across; with normals they are flat ribbons. How
//! finely they are cut: no further from the true curve than [`Curves::tessellate`] is asked for, within bounds of its own;
//! a tube is a prism with the girth of the true one, so that its area and its mean width from all sides are right
//! however few sides it has.

mod basis;
mod spline;
mod strand;

use super::super::super::raw::RawPrim;
use super::attributes::{ints, vectors};
use super::layouts::{Body, DEFAULT_WIDTH, Layouts};
use super::primvars::{AuthoredPrimvar, Layout};
use crate::diagnostics::Diagnostics;
use crate::scene::{Interpolation, Mesh, Normals, Primvar};
use basis::{Form, Order, Place};
use glam::{DVec3, Vec3, Vec4};
use spline::Spline;
use std::ops::Range;
use strand::{Station, Strands};

/// The type whose curves have knots.
pub(super) const NURBS: &str = "NurbsCurves";

/// Triangles of one prim, at most; coarser tubes from there on. 4 M hold 60 k hairs of 16 three-sided pieces.
const TRIANGLE_BUDGET: usize = 4_000_000;

/// A plan over the budget is made anew for facets this much deeper: a third of the sides, a third of the pieces.
const COARSENING: f64 = 8.0;

/// No depth below this part of the largest radius makes a finer tube.
const FINEST_PLAN: f64 = 1e-4;

/// Pieces of one segment, at most.
const MAX_PIECES: usize = 64;

/// A piece is no flatter an approximation than this part of its segment's length is deep, however small the curve.
const PIECE_DEPTH: f64 = 0.02;

/// The curves of one prim, checked.
#[derive(Debug)]
pub(super) struct Curves<'a> {
    body: Body<'a>,
    curves: Vec<Curve>,
}

/// One curve that can be drawn.
#[derive(Debug, Clone)]
struct Curve {
    /// Its number among all of the prim.
    number: u32,
    points: Range<usize>,
    spline: Spline,
    segments: usize,
    /// First of its values of `varying` interpolation.
    first_varying: usize,
}

impl<'a> Curves<'a> {
    /// The curves of `prim` with those of the primvars called `names` that it or (constant) `inherited` prims author.
    /// `None`, with a warning, where nothing can be drawn.
    pub(super) fn read(
        prim: &'a RawPrim,
        inherited: &[(String, &RawPrim)],
        names: &[String],
        diagnostics: &Diagnostics,
    ) -> Option<Self> {
        let warn = |message: String| {
            diagnostics.warn("bad-curves", prim.path.clone(), message);
        };
        let points = vectors(prim, "points");
        let splines = checked_splines(prim, points)
            .map_err(|flaw| warn(format!("{flaw}; left out")))
            .ok()?;
        let counts = ints(prim, "curveVertexCounts");
        let first_flaw = splines.iter().find_map(|spline| spline.as_ref().err());
        let flaw = first_flaw.cloned();
        let (curves, varying_total) = split(counts, splines);
        if curves.is_empty() && flaw.is_none() {
            diagnostics.warn(
                "empty-mesh",
                prim.path.clone(),
                "there is no curve; it is left out",
            );
            return None;
        }
        if curves.len() < counts.len() {
            let left_out = counts.len() - curves.len();
            let flaw = flaw.map_or_else(
                || "a number of points that their basis and wrap cannot have".to_owned(),
                |flaw| format!("what no curve can have, the first of them {flaw}"),
            );
            warn(format!(
                "{left_out} of {} curves have {flaw}; they are left out",
                counts.len()
            ));
        }
        if curves.is_empty() {
            return None;
        }
        let layouts = Layouts::of(counts.len(), points.len(), varying_total);
        let body = (prim, points, "curves");
        Some(Self {
            body: Body::read(body, (inherited, names), &layouts, diagnostics),
            curves,
        })
    }

    /// Tubes or ribbons in object space relative to the second value; facets lie about `depth` from the true surface at
    /// most, unless the curves are too many for that.
    pub(super) fn tessellate(self, depth: f64) -> (Mesh, DVec3) {
        let plan = self.affordable_plan(depth);
        let mut strands = Strands::default();
        let mut values: Vec<Vec<Vec4>> = vec![Vec::new(); self.body.primvars.len()];
        for (curve, shape) in self.curves.iter().zip(&plan.shapes) {
            let places = self.places(curve, shape.pieces);
            let stations: Vec<_> = places.iter().map(|&at| self.station(curve, at)).collect();
            let is_closed = curve.spline.is_closed();
            let width = match self.body.normals {
                Some(_) => strands.add_ribbon(&stations, is_closed, curve.number),
                None => strands.add_tube(&stations, is_closed, (curve.number, shape.sides)),
            };
            for (primvar, values) in self.body.primvars.iter().zip(&mut values) {
                if spreads(primvar.layout) {
                    for &at in &places {
                        let value = self.value(primvar, curve, at);
                        values.extend(std::iter::repeat_n(value, width));
                    }
                }
            }
        }
        let mut all = self.curves.iter();
        let is_closed = all.all(|curve| curve.spline.is_closed()) && self.body.normals.is_none();
        let center = self.body.center;
        (self.finish(strands, values, is_closed), center)
    }

    fn finish(self, strands: Strands, values: Vec<Vec<Vec4>>, closed: bool) -> Mesh {
        let primvars = self.body.primvars.iter().zip(values);
        let primvars = primvars.map(|(primvar, values)| laid_out(primvar, values));
        Mesh {
            positions: strands.positions,
            triangles: strands.triangles,
            triangle_faces: strands.curves,
            normals: Normals::Vertex(strands.normals),
            primvars: primvars.collect(),
            double_sided: self.body.double_sided,
            closed,
            cage: None,
            scheme: self.body.type_name,
        }
    }

    fn largest_radius(&self) -> f64 {
        let all = self.body.widths.iter().flat_map(|widths| &widths.values);
        let largest = all.map(|value| value.x).reduce(f32::max);
        0.5 * f64::from(largest.unwrap_or(DEFAULT_WIDTH).max(0.0))
    }

    /// How every curve is cut at `depth`, or as much coarser as the budget asks or can be.
    fn affordable_plan(&self, depth: f64) -> Plan {
        let mut depth = depth.max(FINEST_PLAN * self.largest_radius());
        let mut plan = self.plan(depth);
        while plan.triangles > TRIANGLE_BUDGET {
            depth *= COARSENING;
            let coarser = self.plan(depth);
            if coarser.triangles == plan.triangles {
                break;
            }
            plan = coarser;
        }
        plan
    }

    /// How every curve is cut at `depth`.
    fn plan(&self, depth: f64) -> Plan {
        let shape = |curve: &Curve| {
            let radius = (0..curve.segments)
                .flat_map(|segment| [0.0, 0.5, 1.0].map(|t| Place { segment, t }))
                .map(|at| self.radius(curve, at))
                .fold(0.0, f64::max);
            let segments = (0..curve.segments).map(|segment| self.pieces(curve, segment, depth));
            Shape {
                pieces: segments.max().unwrap_or(1),
                sides: strand::sides(radius, depth),
            }
        };
        let shapes: Vec<Shape> = self.curves.iter().map(shape).collect();
        let sides = |shape: &Shape| {
            if self.body.normals.is_some() {
                1
            } else {
                shape.sides
            }
        };
        let all = self.curves.iter().zip(&shapes);
        let triangles = all.map(|(curve, shape)| 2 * curve.segments * shape.pieces * sides(shape));
        Plan {
            triangles: triangles.sum(),
            shapes,
        }
    }

    /// Pieces that `segment` is cut into: a chord over 1/n of it is |second derivative| / 8n² deep at most.
    fn pieces(&self, curve: &Curve, segment: usize, depth: f64) -> usize {
        let at = |t: f64, order| self.sum(curve, Place { segment, t }, order);
        let bends = curve.spline.bends().iter();
        let bend = bends
            .map(|&t| at(t, Order::Second).length())
            .fold(0.0, f64::max);
        let length = (at(1.0, Order::Value) - at(0.0, Order::Value)).length();
        let length = length.max(at(0.5, Order::First).length());
        let depth = depth.min(PIECE_DEPTH * length);
        let pieces = (bend / (8.0 * depth)).sqrt().ceil();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped; a NaN (a segment without length) becomes 0"
        )]
        let pieces = pieces.clamp(0.0, 64.0) as usize;
        pieces.clamp(1, MAX_PIECES)
    }

    /// Where rings are drawn: the ends of all pieces, each once.
    fn places(&self, curve: &Curve, pieces: usize) -> Vec<Place> {
        let mut all = Vec::with_capacity(curve.segments * pieces + 1);
        for segment in 0..curve.segments {
            all.extend((0..pieces).map(|piece| Place {
                segment,
                t: as_f64(piece) / as_f64(pieces),
            }));
        }
        if !curve.spline.is_closed() {
            all.push(Place {
                segment: curve.segments - 1,
                t: 1.0,
            });
        }
        all
    }

    fn station(&self, curve: &Curve, at: Place) -> Station {
        let normals = self.body.normals.as_ref();
        Station {
            position: self.sum(curve, at, Order::Value) - self.body.center,
            tangent: match curve.spline.is_polyline() {
                // the polyline's corners want more than one side's direction
                true => DVec3::ZERO,
                false => self.sum(curve, at, Order::First),
            },
            radius: self.radius(curve, at),
            normal: normals.map(|normals| self.value(normals, curve, at).truncate().as_dvec3()),
        }
    }

    fn sum(&self, curve: &Curve, at: Place, order: Order) -> DVec3 {
        let points = &self.body.points[curve.points.clone()];
        let weights = curve.spline.weights(points.len(), at, order);
        let weighted = weights
            .iter()
            .map(|&(i, weight)| points[i].as_dvec3() * weight);
        weighted.sum()
    }

    fn radius(&self, curve: &Curve, at: Place) -> f64 {
        let width = match &self.body.widths {
            Some(widths) => self.value(widths, curve, at).x,
            None => DEFAULT_WIDTH,
        };
        // splines may swing below the values they approximate
        0.5 * f64::from(width).max(0.0)
    }

    fn value(&self, primvar: &AuthoredPrimvar, curve: &Curve, at: Place) -> Vec4 {
        let element = |index: usize| primvar.value_of(index);
        match primvar.layout {
            Layout::Constant => element(0),
            Layout::Uniform => element(curve.number as usize),
            Layout::Vertex => {
                let spline = &curve.spline;
                let weights = spline.weights(curve.points.len(), at, Order::Value);
                let weighted = weights
                    .iter()
                    .map(|&(i, weight)| element(curve.points.start + i) * narrow(weight));
                weighted.sum()
            }
            Layout::Varying | Layout::FaceVarying => {
                let spline = &curve.spline;
                let count = spline.varying_count(curve.segments, curve.points.len());
                let end = |at: usize| element(curve.first_varying + at % count);
                let start = spline.varying_at(at.segment);
                end(start).lerp(end(start + 1), narrow(at.t))
            }
        }
    }
}

/// See [`Curves::plan`].
struct Plan {
    shapes: Vec<Shape>,
    triangles: usize,
}

struct Shape {
    /// Of every segment.
    pieces: usize,
    /// Of the tube.
    sides: usize,
}

/// True for values that change along a curve.
fn spreads(layout: Layout) -> bool {
    !matches!(layout, Layout::Constant | Layout::Uniform)
}

fn laid_out(primvar: &AuthoredPrimvar, values: Vec<Vec4>) -> Primvar {
    match primvar.layout {
        Layout::Constant => primvar.finish(Interpolation::Constant, primvar.expanded()),
        Layout::Uniform => primvar.finish(Interpolation::Uniform, primvar.expanded()),
        _ => primvar.finish(Interpolation::Vertex, values),
    }
}

/// What each curve of `prim` is, or what is wrong with it, if the prim's arrays agree with each other.
fn checked_splines(prim: &RawPrim, points: &[Vec3]) -> Result<Vec<Result<Spline, String>>, String> {
    let counts = ints(prim, "curveVertexCounts");
    if let Some(count) = counts.iter().find(|&&count| count < 0) {
        return Err(format!("curveVertexCounts has a {count}, below 0"));
    }
    let total: i64 = counts.iter().map(|&count| i64::from(count)).sum();
    if i64::try_from(points.len()) != Ok(total) {
        return Err(format!(
            "curveVertexCounts sum up to {total}, there are {} points",
            points.len()
        ));
    }
    match points.iter().position(|point| !point.is_finite()) {
        Some(index) => Err(format!("point {index} is {}, not finite", points[index])),
        None if prim.type_name == NURBS => spline::nurbs(prim, counts),
        None => {
            let form = Form::read(prim)?;
            Ok(vec![Ok(Spline::Basis(form)); counts.len()])
        }
    }
}

/// The curves that can be drawn, and how many values of `varying` interpolation all have.
fn split(counts: &[i32], splines: Vec<Result<Spline, String>>) -> (Vec<Curve>, usize) {
    let (mut curves, mut first_point, mut first_varying) = (Vec::new(), 0, 0);
    for ((number, &count), spline) in (0..).zip(counts).zip(splines) {
        let count = usize::try_from(count).unwrap_or(0);
        let spline = spline.ok();
        let drawn = spline.and_then(|spline| Some((spline.segments(count)?, spline)));
        if let Some((segments, spline)) = drawn {
            let varying_count = spline.varying_count(segments, count);
            curves.push(Curve {
                number,
                points: first_point..first_point + count,
                spline,
                segments,
                first_varying,
            });
            first_varying += varying_count;
        }
        first_point += count;
    }
    (curves, first_varying)
}

#[expect(clippy::cast_precision_loss, reason = "counts of pieces")]
fn as_f64(count: usize) -> f64 {
    count as f64
}

#[expect(clippy::cast_possible_truncation, reason = "weights are of order 1")]
fn narrow(weight: f64) -> f32 {
    weight as f32
}

#[cfg(test)]
mod tests;
