//! Flat convex prims (grounds, walls, ceilings): tested exactly instead of being drawn into maps, so that neither
//! their outlines nor contact with them depend on pixels.

use super::axes::Axis;
use super::plan::Occluder;
use crate::scene::Mesh;
use glam::{Vec2, Vec3};

/// Most flat prims that are tested exactly: one costs about a tenth of a look into a map.
pub(super) const MOST: usize = 24;

/// Most corners of a flat prim.
const MOST_CORNERS: usize = 8;

/// Points this part of its size off a plane, and areas this part off that of the hull, are flat and convex: the
/// rounding of transformed positions.
const FLATNESS: f32 = 2e-6;

/// Part of the area that may lie outside the triangles, or be covered twice.
const AREA_TOLERANCE: f32 = 1e-4;

/// Seen under less than this cosine, a flat prim covers nothing.
const EDGE_ON: f32 = 1e-6;

/// A flat convex prim.
#[derive(Debug, Clone)]
pub(super) struct Flat {
    /// Counter-clockwise about `normal`, relative to the plan's center.
    corners: Vec<Vec3>,
    normal: Vec3,
}

/// A flat prim looked at along an axis.
#[derive(Debug, Clone)]
pub(super) struct FlatView {
    /// A point (x, y) of the axis' plane is inside where all `a·x + b·y + c ≥ 0`.
    pub(super) edges: Vec<[f32; 3]>,
    /// Its depth along the axis there is `a·x + b·y + c`.
    pub(super) depth: [f32; 3],
}

/// The prim as a flat convex polygon, if it is one. Only prims of few corners on their outline are.
pub(super) fn find(mesh: &Mesh, occluder: &Occluder) -> Option<Flat> {
    let place = |p: Vec3| {
        let local = occluder.local_from_object;
        local.transform_point3(p.as_dvec3()).as_vec3()
    };
    let first = mesh.triangles.first()?;
    let start = place(mesh.positions[first[0] as usize]);
    let area_vector = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| place(mesh.positions[i as usize]));
        (b - a).cross(c - a).as_dvec3()
    };
    let direction = area_vector(first).normalize_or_zero().as_vec3();
    if direction == Vec3::ZERO || is_bent(mesh, (start, direction), &place) {
        return None;
    }
    let corners = hull(mesh, (start, direction), &place)?;
    let twice_area: f64 = mesh.triangles.iter().map(|t| area_vector(t).length()).sum();
    let fan: f64 = (2..corners.len())
        .map(|k| (corners[k - 1] - corners[0]).cross(corners[k] - corners[0]))
        .map(|v| f64::from(v.length()))
        .sum();
    let fills = (twice_area - fan).abs() <= f64::from(AREA_TOLERANCE) * fan;
    fills.then_some(Flat {
        corners,
        normal: direction,
    })
}

/// True if a used position lies off the plane.
fn is_bent(mesh: &Mesh, plane: (Vec3, Vec3), place: &impl Fn(Vec3) -> Vec3) -> bool {
    let (start, normal) = plane;
    mesh.triangles.iter().flatten().any(|&i| {
        let offset = place(mesh.positions[i as usize]) - start;
        let size = offset.abs().max_element().max(start.abs().max_element());
        offset.dot(normal).abs() > 4.0 * FLATNESS * size
    })
}

/// Corners of the convex hull of all used positions in their plane; `None` if there are too many.
fn hull(
    mesh: &Mesh,
    (start, normal): (Vec3, Vec3),
    place: &impl Fn(Vec3) -> Vec3,
) -> Option<Vec<Vec3>> {
    let frame = crate::math::Frame::about(normal);
    let mut points: Vec<Vec2> = mesh
        .triangles
        .iter()
        .flatten()
        .map(|&i| place(mesh.positions[i as usize]) - start)
        .map(|p| Vec2::new(p.dot(frame.tangent), p.dot(frame.bitangent)))
        .collect();
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let size = points.iter().fold(0.0_f32, |m, p| m.max(p.length()));
    let tolerance = FLATNESS * 8.0 * size;
    let mut corners = half_hull(points.iter().copied(), tolerance);
    corners.pop();
    corners.extend(half_hull(points.iter().rev().copied(), tolerance));
    corners.pop();
    (3..=MOST_CORNERS).contains(&corners.len()).then(|| {
        let world = |p: &Vec2| start + frame.tangent * p.x + frame.bitangent * p.y;
        corners.iter().map(world).collect()
    })
}

/// Lower hull of sorted points (upper one of reversed), without points closer than `tolerance` to its edges.
fn half_hull(points: impl Iterator<Item = Vec2>, tolerance: f32) -> Vec<Vec2> {
    let mut hull: Vec<Vec2> = Vec::new();
    for p in points {
        while let [.., a, b] = hull[..] {
            let along = p - a;
            if along.perp_dot(b - a) < -tolerance * along.length() {
                break;
            }
            hull.pop();
        }
        hull.push(p);
    }
    hull
}

/// Cosine between a receiver's normal and a flat prim's from which on this is what the receiver stands on, or a sheet upon that.
const OWN: f32 = 0.99;

impl Flat {
    /// True if a receiver that stands on something else, at a corner with this, is so near to it that rounding tells on which
    /// side: on the edge between two walls half of the hemisphere is covered or is not. Relative to the plan's center, `margin`
    /// in stage units.
    pub(super) fn is_met(&self, position: Vec3, normal: Vec3, margin: f32) -> bool {
        let is_near = self.normal.dot(position - self.corners[0]).abs() <= margin;
        let is_inside = |k: usize| {
            let (from, to) = (self.corners[k], self.corners[(k + 1) % self.corners.len()]);
            let along = to - from;
            self.normal.cross(along).dot(position - from) >= -margin * along.length()
        };
        is_near && self.normal.dot(normal).abs() < OWN && (0..self.corners.len()).all(is_inside)
    }

    /// As seen along `axis`; `None` edge-on.
    pub(super) fn view(&self, axis: &Axis) -> Option<FlatView> {
        let cosine = self.normal.dot(axis.direction);
        if cosine.abs() < EDGE_ON {
            return None;
        }
        let points: Vec<Vec2> = self
            .corners
            .iter()
            .map(|&p| Vec2::new(p.dot(axis.right), p.dot(axis.up)))
            .collect();
        let edge = |k: usize| {
            let (a, b) = (points[k], points[(k + 1) % points.len()]);
            let along = (b - a) * cosine.signum() / (b - a).length();
            [-along.y, along.x, a.x * along.y - a.y * along.x]
        };
        // n·(x r + y u + z d) = n·corner
        let (nr, nu) = (self.normal.dot(axis.right), self.normal.dot(axis.up));
        let constant = self.normal.dot(self.corners[0]);
        Some(FlatView {
            edges: (0..points.len()).map(edge).collect(),
            depth: [-nr / cosine, -nu / cosine, constant / cosine],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_stands_at_the_edge_of_a_wall_meets_it_and_its_own_receivers_do_not() {
        let wall = Flat {
            corners: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            normal: Vec3::Z,
        };
        let met = |x: f32, y: f32, z: f32, normal| wall.is_met(Vec3::new(x, y, z), normal, 1e-5);
        // On the floor below it, on either side of rounding, and a little in front.
        assert!(met(0.5, 0.0, 0.0, Vec3::Y) && met(0.5, -1e-6, -1e-6, Vec3::Y));
        assert!(!met(0.5, 0.0, 1e-3, Vec3::Y) && !met(0.5, -1e-3, 0.0, Vec3::Y));
        assert!(!met(2.0, 0.0, 0.0, Vec3::Y));
        assert!(!met(0.5, 0.5, 0.0, Vec3::Z) && !met(0.5, 0.5, 0.0, -Vec3::Z));
    }
}
