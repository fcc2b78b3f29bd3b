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
use rayon::prelude::*;
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

/// Curves cut by one task.
const CURVES_A_TASK: usize = 256;

/// Curves cut before what they became is put together.
const CURVES_HELD: usize = 128 * CURVES_A_TASK;

/// Pieces of one segment, at most.
const MAX_PIECES: u8 = 64;

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
        let shapes: Vec<_> = self.curves.iter().zip(plan.shapes()).collect();
        let mut strands = Strands::with_capacity(plan.vertices, plan.triangles);
        let mut values: Vec<Vec<Vec4>> = vec![Vec::new(); self.body.primvars.len()];
        for shapes in shapes.chunks(CURVES_HELD) {
            let parts = shapes.par_chunks(CURVES_A_TASK);
            let parts: Vec<_> = parts.map(|shapes| self.cut(shapes)).collect();
            for (part, part_values) in parts {
                strands.append(part);
                for (all, part) in values.iter_mut().zip(part_values) {
                    all.extend(part);
                }
            }
        }
        let mut all = self.curves.iter();
        let is_closed = all.all(|curve| curve.spline.is_closed()) && self.body.normals.is_none();
        let center = self.body.center;
        (self.finish(strands, values, is_closed), center)
    }

    /// The triangles of some curves, and the primvars' values at their vertices.
    fn cut(&self, shapes: &[(&Curve, (usize, &[u8]))]) -> (Strands, Vec<Vec<Vec4>>) {
        let mut strands = Strands::default();
        let mut values = vec![Vec::new(); self.body.primvars.len()];
        for &(curve, (sides, pieces)) in shapes {
            let places = places(curve, pieces);
            let stations: Vec<_> = places.iter().map(|&at| self.station(curve, at)).collect();
            let is_closed = curve.spline.is_closed();
            let width = match self.body.normals {
                Some(_) => strands.add_ribbon(&stations, is_closed, curve.number),
                None => strands.add_tube(&stations, is_closed, (curve.number, sides)),
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
        (strands, values)
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
        let parts = self.curves.par_chunks(CURVES_A_TASK);
        let parts = parts.map(|curves| self.plan_of(curves, depth));
        let mut plan = Plan::default();
        for part in parts.collect::<Vec<_>>() {
            plan.append(part);
        }
        plan
    }

    fn plan_of(&self, curves: &[Curve], depth: f64) -> Plan {
        let mut plan = Plan::default();
        for curve in curves {
            let radius = (0..curve.segments)
                .flat_map(|segment| [0.0, 0.5, 1.0].map(|t| Place { segment, t }))
                .map(|at| self.radius(curve, at))
                .fold(0.0, f64::max);
            let sides = strand::sides(radius, depth);
            let first = plan.pieces.len();
            let pieces = |segment| self.pieces(curve, segment, depth);
            plan.pieces.extend((0..curve.segments).map(pieces));
            let all: usize = plan.pieces[first..].iter().map(|&n| usize::from(n)).sum();
            let (quads, corners) = match self.body.normals {
                Some(_) => (1, 2),
                None => (sides, sides),
            };
            plan.triangles += 2 * all * quads;
            plan.vertices += (all + 1) * corners;
            plan.sides.push(sides);
            plan.ends.push(plan.pieces.len());
        }
        plan
    }

    /// Pieces that `segment` is cut into: a chord over 1/n of it is |second derivative| / 8n² deep at most.
    fn pieces(&self, curve: &Curve, segment: usize, depth: f64) -> u8 {
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
            reason = "casts of floats saturate; a NaN (a segment without length) becomes 0"
        )]
        let pieces = pieces as u8;
        pieces.clamp(1, MAX_PIECES)
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

/// How every curve of a prim is cut.
#[derive(Debug, Default)]
struct Plan {
    /// Of every tube.
    sides: Vec<usize>,
    /// Where the segments of every curve end in `pieces`.
    ends: Vec<usize>,
    /// Of every segment of every curve.
    pieces: Vec<u8>,
    triangles: usize,
    /// At most.
    vertices: usize,
}

impl Plan {
    /// Add what comes behind.
    fn append(&mut self, behind: Self) {
        let first = self.pieces.len();
        self.sides.extend(behind.sides);
        self.ends.extend(behind.ends.iter().map(|end| first + end));
        self.pieces.extend(behind.pieces);
        self.triangles += behind.triangles;
        self.vertices += behind.vertices;
    }

    /// Of every curve, the sides and the pieces of its segments.
    fn shapes(&self) -> impl Iterator<Item = (usize, &[u8])> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        let ranges = starts.zip(&self.ends).map(|(start, &end)| start..end);
        let pieces = ranges.map(|range| &self.pieces[range]);
        self.sides.iter().copied().zip(pieces)
    }
}

/// Where rings are drawn: the ends of all `pieces` of the segments, each once.
fn places(curve: &Curve, pieces: &[u8]) -> Vec<Place> {
    let rings: usize = pieces.iter().map(|&n| usize::from(n)).sum();
    let mut all = Vec::with_capacity(rings + 1);
    for (segment, &pieces) in pieces.iter().enumerate() {
        all.extend((0..pieces).map(|piece| Place {
            segment,
            t: f64::from(piece) / f64::from(pieces),
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

#[expect(clippy::cast_possible_truncation, reason = "weights are of order 1")]
fn narrow(weight: f64) -> f32 {
    weight as f32
}

#[cfg(test)]
mod tests;
