//! One curve's center line, as stations along it → the triangles of a tube or a ribbon.

use glam::{DQuat, DVec3, Vec3};
use std::f64::consts::{PI, TAU};

/// A facet of a tube may be this part of the radius deep at most, and at least: three sides, and 58.
const FACET_DEPTH: (f64, f64) = (1e-3, 0.4);

/// A polyline's tube is widened at a corner so that its pieces keep their widths, up to this factor (a corner of 120°).
const LARGEST_MITRE: f64 = 2.0;

/// A place on the center line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Station {
    pub(super) position: DVec3,
    /// Along the curve, of any length; zero where only the neighbors tell.
    pub(super) tangent: DVec3,
    /// Half the width.
    pub(super) radius: f64,
    /// Of a ribbon, of any length.
    pub(super) normal: Option<DVec3>,
}

/// Sides of a tube of `radius` whose facets are about `depth` deep.
pub(super) fn sides(radius: f64, depth: f64) -> usize {
    let (finest, coarsest) = FACET_DEPTH;
    // max before min: a radius of 0 gives bounds, not NaN
    let error = (depth / radius).max(finest).min(coarsest);
    // a prism with the girth of the cylinder leaves it by (π/n)²/3 radii at most
    let count = (PI / (3.0 * error).sqrt()).ceil();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 3 and 58"
    )]
    let count = count as usize;
    count.max(3)
}

/// Triangles of many curves.
#[derive(Debug, Default)]
pub(super) struct Strands {
    pub(super) positions: Vec<Vec3>,
    pub(super) normals: Vec<Vec3>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Number of the curve that a triangle belongs to.
    pub(super) curves: Vec<u32>,
}

impl Strands {
    pub(super) fn with_capacity(vertices: usize, triangles: usize) -> Self {
        Self {
            positions: Vec::with_capacity(vertices),
            normals: Vec::with_capacity(vertices),
            triangles: Vec::with_capacity(triangles),
            curves: Vec::with_capacity(triangles),
        }
    }

    /// Add `others` behind.
    pub(super) fn append(&mut self, others: Self) {
        let first = index(self.positions.len());
        self.positions.extend(others.positions);
        self.normals.extend(others.normals);
        let moved = others.triangles.iter().map(|t| t.map(|at| first + at));
        self.triangles.extend(moved);
        self.curves.extend(others.curves);
    }

    /// A prism of `sides` around the line, with the girth of the round tube, ends open; the number of vertices of every
    /// station.
    pub(super) fn add_tube(
        &mut self,
        line: &[Station],
        is_closed: bool,
        (curve, sides): (u32, usize),
    ) -> usize {
        let angle = PI / as_f64(sides);
        let widening = angle / angle.sin();
        let joints = joints(line, is_closed);
        let frames = frames(&joints, is_closed);
        let first = self.positions.len();
        for ((station, joint), across) in line.iter().zip(&joints).zip(&frames) {
            let up = joint.tangent.cross(*across);
            for side in 0..sides {
                let (sine, cosine) = (TAU * as_f64(side) / as_f64(sides)).sin_cos();
                let outward = *across * cosine + up * sine;
                let offset = outward + joint.bend * (outward.dot(joint.bend) * (joint.mitre - 1.0));
                let position = station.position + offset * (station.radius * widening);
                self.positions.push(position.as_vec3());
                self.normals.push(outward.as_vec3());
            }
        }
        self.join(first, (line.len(), sides), is_closed, curve);
        sides
    }

    /// A flat strip across the line and the normals; two vertices every station.
    pub(super) fn add_ribbon(&mut self, line: &[Station], is_closed: bool, curve: u32) -> usize {
        let joints = joints(line, is_closed);
        let first = self.positions.len();
        let mut last = None;
        for (station, joint) in line.iter().zip(&joints) {
            let authored = station.normal.unwrap_or(DVec3::ZERO);
            let across = joint.tangent.cross(authored).try_normalize().or(last);
            let across = across.unwrap_or_else(|| joint.tangent.any_orthonormal_vector());
            last = Some(across);
            let normal = across.cross(joint.tangent).as_vec3();
            for side in [-1.0, 1.0] {
                let position = station.position + across * (side * station.radius * joint.mitre);
                self.positions.push(position.as_vec3());
                self.normals.push(normal);
            }
        }
        let stations = if is_closed {
            line.len()
        } else {
            line.len() - 1
        };
        for at in 0..stations {
            let vertex =
                |station: usize, side: usize| index(first + 2 * (station % line.len()) + side);
            let [a, b] = [vertex(at, 0), vertex(at, 1)];
            let [c, d] = [vertex(at + 1, 1), vertex(at + 1, 0)];
            self.quad([a, b, c, d], curve);
        }
        2
    }

    /// The bands between rings of `sides` vertices.
    fn join(&mut self, first: usize, (rings, sides): (usize, usize), is_closed: bool, curve: u32) {
        for ring in 0..if is_closed { rings } else { rings - 1 } {
            for side in 0..sides {
                let vertex =
                    |ring: usize, side: usize| index(first + ring % rings * sides + side % sides);
                let [a, b] = [vertex(ring, side), vertex(ring, side + 1)];
                let [c, d] = [vertex(ring + 1, side + 1), vertex(ring + 1, side)];
                self.quad([a, b, c, d], curve);
            }
        }
    }

    fn quad(&mut self, [a, b, c, d]: [u32; 4], curve: u32) {
        self.triangles.extend([[a, b, c], [a, c, d]]);
        self.curves.extend([curve; 2]);
    }
}

/// How the line goes through a station.
#[derive(Debug, Clone, Copy)]
struct Joint {
    /// Unit.
    tangent: DVec3,
    /// Unit direction in which a polyline turns here, at right angles to `tangent`; zero where it does not.
    bend: DVec3,
    /// How much wider the line is along `bend`.
    mitre: f64,
}

fn joints(line: &[Station], is_closed: bool) -> Vec<Joint> {
    let count = line.len();
    let towards =
        |from: usize, to: usize| (line[to].position - line[from].position).normalize_or_zero();
    let mut last = DVec3::ZERO;
    let mut all: Vec<Joint> = (0..count)
        .map(|at| {
            let before = match at {
                0 if is_closed => towards(count - 1, 0),
                0 => DVec3::ZERO,
                at => towards(at - 1, at),
            };
            let after = match at {
                at if at + 1 < count => towards(at, at + 1),
                _ if is_closed => towards(at, 0),
                _ => DVec3::ZERO,
            };
            let is_corner = line[at].tangent == DVec3::ZERO;
            let own = line[at].tangent.try_normalize();
            let tangent = own.or_else(|| (before + after).try_normalize());
            let tangent = tangent.unwrap_or(if after == DVec3::ZERO { last } else { after });
            last = tangent;
            let (bend, mitre) = if is_corner {
                mitre(before, after)
            } else {
                (DVec3::ZERO, 1.0)
            };
            Joint {
                tangent,
                bend,
                mitre,
            }
        })
        .collect();
    // stations that fall together at the start have the direction of the first that does not
    let first = all
        .iter()
        .map(|joint| joint.tangent)
        .find(|t| *t != DVec3::ZERO);
    let first = first.unwrap_or(DVec3::Z);
    for joint in all
        .iter_mut()
        .take_while(|joint| joint.tangent == DVec3::ZERO)
    {
        joint.tangent = first;
    }
    all
}

/// Of a corner between the unit directions `before` and `after`, either of them zero at an end.
fn mitre(before: DVec3, after: DVec3) -> (DVec3, f64) {
    let bend = (after - before).normalize_or_zero();
    if before == DVec3::ZERO || after == DVec3::ZERO || bend == DVec3::ZERO {
        return (DVec3::ZERO, 1.0);
    }
    // half the angle between the two
    let cosine = (0.5 * (1.0 + before.dot(after))).max(0.0).sqrt();
    (bend, (1.0 / cosine).min(LARGEST_MITRE))
}

/// A unit vector across the line at each joint, carried along without turning about it; around a closed line what it
/// has turned in the end is spread over all.
fn frames(joints: &[Joint], is_closed: bool) -> Vec<DVec3> {
    let mut across = joints[0].tangent.any_orthonormal_vector();
    let mut all = vec![across];
    let carry = |across: DVec3, from: DVec3, to: DVec3| {
        let moved = DQuat::from_rotation_arc(from, to) * across;
        let moved = (moved - to * moved.dot(to)).try_normalize();
        moved.unwrap_or_else(|| to.any_orthonormal_vector())
    };
    for pair in joints.windows(2) {
        across = carry(across, pair[0].tangent, pair[1].tangent);
        all.push(across);
    }
    if is_closed {
        let start = joints[0].tangent;
        let end = carry(across, joints[joints.len() - 1].tangent, start);
        let turned = start.dot(all[0].cross(end)).atan2(all[0].dot(end));
        let share = turned / as_f64(joints.len());
        for (at, (across, joint)) in all.iter_mut().zip(joints).enumerate() {
            *across = DQuat::from_axis_angle(joint.tangent, -share * as_f64(at)) * *across;
        }
    }
    all
}

fn index(vertex: usize) -> u32 {
    u32::try_from(vertex).expect("the triangle budget keeps vertices below 2^32")
}

#[expect(clippy::cast_precision_loss, reason = "counts of sides and stations")]
fn as_f64(count: usize) -> f64 {
    count as f64
}
