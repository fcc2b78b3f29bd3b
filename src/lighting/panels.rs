//! Panels: connected plane parts of emissive meshes with one radiance. Their irradiance depends on the outline only.

use super::emitters::{EmissiveTriangle, front_normal};
use super::form_factor::outline_irradiance;
use super::sampled::GOLDEN;
use crate::math::{Bounds3, luminance};
use glam::{DVec3, Vec2, Vec3};
use std::collections::{BTreeMap, HashMap};

/// Corners off the plane of a panel by less than this part of the coordinates' magnitude are in it.
const PLANE_TOLERANCE: f64 = 2e-6;
/// Edges that turn by less than this angle run straight on.
const STRAIGHT_TOLERANCE: f64 = 1e-5;

/// A plane emitter of constant radiance.
#[derive(Debug)]
pub(super) struct Panel {
    /// Radiance of the front side.
    pub(super) emission: Vec3,
    /// Unit, on the front side.
    pub(super) normal: Vec3,
    exact_normal: DVec3,
    /// A point of the plane.
    anchor: DVec3,
    /// Outline, counter-clockwise as seen from the front.
    edges: Vec<(DVec3, DVec3)>,
    rectangle: Rectangle,
    triangles: Vec<[Vec3; 3]>,
    /// Running sums of the triangles' areas over the whole, ending with 1.
    cumulative: Vec<f32>,
}

/// Around a panel, along its longest edge.
#[derive(Debug)]
struct Rectangle {
    corner: DVec3,
    sides: [DVec3; 2],
    /// Part of it that the panel covers, 0…1.
    fill: f32,
}

/// Panels that cover less of their rectangle are sampled triangle by triangle.
const LEAST_FILL: f32 = 0.25;

impl Panel {
    /// Height of `position` over the plane, positive in front.
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    pub(super) fn distance(&self, position: Vec3) -> f32 {
        self.exact_normal.dot(position.as_dvec3() - self.anchor) as f32
    }

    /// Irradiance for radiance 1 at `position` if nothing is in between.
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    pub(super) fn irradiance(&self, position: Vec3, normal: Vec3) -> f32 {
        if self.distance(position) <= 0.0 {
            return 0.0;
        }
        let origin = position.as_dvec3();
        let edges = self.edges.iter().map(|(a, b)| (*a - origin, *b - origin));
        outline_irradiance(edges, self.exact_normal, normal.as_dvec3()) as f32
    }

    /// Distance along unit `direction` to the panel's front, if it is met.
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    pub(super) fn hit(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let (from, along) = (origin.as_dvec3(), direction.as_dvec3());
        let slope = -self.exact_normal.dot(along);
        let distance = self.exact_normal.dot(from - self.anchor) / slope;
        if slope <= 0.0 || distance <= 0.0 {
            return None;
        }
        let place = from + along * distance;
        self.contains(place).then_some(distance as f32)
    }

    /// Crossing number along the plane's longest axis.
    fn contains(&self, place: DVec3) -> bool {
        let size = self.exact_normal.abs();
        let (x, y) = if size.x >= size.y && size.x >= size.z {
            (1, 2)
        } else if size.y >= size.z {
            (2, 0)
        } else {
            (0, 1)
        };
        let mut is_inside = false;
        for (a, b) in &self.edges {
            if (a[y] > place[y]) != (b[y] > place[y]) {
                let share = (place[y] - a[y]) / (b[y] - a[y]);
                is_inside ^= place[x] < a[x] + share * (b[x] - a[x]);
            }
        }
        is_inside
    }

    /// Squares that [`Self::place`] has to be given for one point, on average: 1 to 4.
    pub(super) fn squares_a_point(&self) -> f32 {
        if self.rectangle.fill < LEAST_FILL {
            1.0
        } else {
            1.0 / self.rectangle.fill
        }
    }

    /// The point that belongs to the `index`-th `square` of a pattern, if there is one; uniform in area.
    ///
    /// The pattern is laid over the whole panel, however it is cut into triangles: choosing triangles by one side of
    /// the square would pick whole columns of a regular grid of triangles and nothing else.
    pub(super) fn place(&self, index: usize, square: Vec2) -> Option<Vec3> {
        if self.rectangle.fill < LEAST_FILL {
            return Some(self.place_in_triangle(index, square));
        }
        let Rectangle { corner, sides, .. } = &self.rectangle;
        let place = *corner + sides[0] * f64::from(square.x) + sides[1] * f64::from(square.y);
        self.contains(place).then_some(place.as_vec3())
    }

    #[expect(clippy::cast_precision_loss, reason = "a few hundred samples")]
    fn place_in_triangle(&self, index: usize, square: Vec2) -> Vec3 {
        let pick = (index as f32 * GOLDEN).fract();
        let last = self.triangles.len() - 1;
        let triangle = (self.cumulative.partition_point(|&sum| sum <= pick)).min(last);
        in_triangle(&self.triangles[triangle], square)
    }
}

impl Rectangle {
    /// Around `edges`, which enclose `area`.
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    fn around(edges: &[(DVec3, DVec3)], normal: DVec3, area: f64) -> Self {
        let along = (edges.iter())
            .map(|(a, b)| *b - *a)
            .max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))
            .unwrap_or_default()
            .normalize_or_zero();
        let axes = [along, normal.cross(along)];
        let reach = axes.map(|axis| {
            let heights = edges.iter().map(|(a, _)| axis.dot(*a));
            heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
                (low.min(x), high.max(x))
            })
        });
        let lift = edges.first().map_or(0.0, |(a, _)| normal.dot(*a));
        let sides = [0, 1].map(|k| axes[k] * (reach[k].1 - reach[k].0));
        let whole = sides[0].length() * sides[1].length();
        let fill = (area / whole) as f32;
        Self {
            corner: axes[0] * reach[0].0 + axes[1] * reach[1].0 + normal * lift,
            sides,
            fill: if fill.is_finite() { fill.min(1.0) } else { 0.0 },
        }
    }
}

/// The unit square to a triangle, equal areas.
pub(super) fn in_triangle(corners: &[Vec3; 3], square: Vec2) -> Vec3 {
    let (u, v) = barycentrics(square);
    corners[0] * (1.0 - u - v) + corners[1] * u + corners[2] * v
}

/// Weights of corners 1 and 2 for [`in_triangle`].
pub(super) fn barycentrics(square: Vec2) -> (f32, f32) {
    let root = square.x.sqrt();
    (root * (1.0 - square.y), root * square.y)
}

/// Sorts emissive triangles into panels and the rest.
#[derive(Debug)]
pub(super) struct PanelBuilder {
    most_panels: usize,
    most_edges: usize,
}

/// Bits of a corner's coordinates.
type Corner = [u32; 3];
type Edge = (Corner, Corner);

impl PanelBuilder {
    /// At most `most_panels` panels with `most_edges` edges in all.
    pub(super) fn new(most_panels: usize, most_edges: usize) -> Self {
        Self {
            most_panels,
            most_edges,
        }
    }

    /// Panels of enough power, strongest first, and all triangles that are in none, in the order given.
    pub(super) fn build(
        &self,
        triangles: Vec<EmissiveTriangle>,
    ) -> (Vec<Panel>, Vec<EmissiveTriangle>) {
        let power = |t: &EmissiveTriangle| luminance(t.emission) * t.area;
        let total: f32 = triangles.iter().map(power).sum();
        let mut groups: Vec<(f32, Vec<usize>)> = (Self::flat_groups(&triangles).into_iter())
            .map(|group| (group.iter().map(|&i| power(&triangles[i])).sum(), group))
            .collect();
        #[expect(clippy::cast_precision_loss, reason = "a small count")]
        let least = total / self.most_panels as f32;
        groups.retain(|(power, _)| *power >= least && *power > 0.0);
        groups.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut is_taken = vec![false; triangles.len()];
        let mut panels = Vec::new();
        let mut edges = 0;
        for (_, group) in groups.into_iter().take(self.most_panels) {
            let panel = panel_of(&triangles, &group);
            edges += panel.edges.len();
            if edges > self.most_edges {
                break;
            }
            panels.push(panel);
            for i in group {
                is_taken[i] = true;
            }
        }
        let rest = (triangles.into_iter().zip(is_taken)).filter(|(_, taken)| !taken);
        (panels, rest.map(|(triangle, _)| triangle).collect())
    }

    /// Connected triangles of constant, equal emission in the plane of the first of them.
    fn flat_groups(triangles: &[EmissiveTriangle]) -> Vec<Vec<usize>> {
        let mut neighbors: HashMap<Edge, usize> = HashMap::new();
        for (index, triangle) in triangles.iter().enumerate() {
            for edge in edges_of(triangle) {
                neighbors.insert(edge, index);
            }
        }
        let mut is_seen: Vec<bool> = triangles.iter().map(|t| !t.is_constant).collect();
        let mut groups = Vec::new();
        for seed in 0..triangles.len() {
            if is_seen[seed] {
                continue;
            }
            is_seen[seed] = true;
            let plane = Plane::of(&triangles[seed]);
            let mut group = vec![seed];
            let mut next = 0;
            while let Some(&index) = group.get(next) {
                next += 1;
                for (a, b) in edges_of(&triangles[index]) {
                    if let Some(&other) = neighbors.get(&(b, a))
                        && !is_seen[other]
                        && plane.accepts(&triangles[other])
                    {
                        is_seen[other] = true;
                        group.push(other);
                    }
                }
            }
            group.sort_unstable();
            groups.push(group);
        }
        groups
    }
}

/// Directed, counter-clockwise as seen from the front. Corners are told apart by their place, so that vertices that
/// were split for normals or texture coordinates still join.
fn edges_of(triangle: &EmissiveTriangle) -> [Edge; 3] {
    // adding zero makes −0 and 0 the same place
    let [a, b, c] = (triangle.corners).map(|p| (p + 0.0).to_array().map(f32::to_bits));
    [(a, b), (b, c), (c, a)]
}

fn place_of(corner: Corner) -> DVec3 {
    Vec3::from(corner.map(f32::from_bits)).as_dvec3()
}

fn panel_of(triangles: &[EmissiveTriangle], group: &[usize]) -> Panel {
    let members: Vec<_> = group.iter().map(|&i| triangles[i]).collect();
    let normal: DVec3 = (members.iter())
        .map(|t| front_normal(&t.corners) * f64::from(t.area))
        .sum();
    let normal = normal.normalize_or_zero();
    let area: f64 = members.iter().map(|t| f64::from(t.area)).sum();
    let mut sum = 0.0;
    let cumulative = members.iter().map(|t| {
        sum += f64::from(t.area);
        #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
        let share = (sum / area) as f32;
        share
    });
    let edges = outline(&members);
    Panel {
        emission: members[0].emission,
        normal: normal.as_vec3(),
        exact_normal: normal,
        anchor: members[0].corners[0].as_dvec3(),
        cumulative: cumulative.collect(),
        rectangle: Rectangle::around(&edges, normal, area),
        edges,
        triangles: members.iter().map(|t| t.corners).collect(),
    }
}

/// Edges without a counterpart, straight runs joined.
fn outline(members: &[EmissiveTriangle]) -> Vec<(DVec3, DVec3)> {
    let mut counts: BTreeMap<Edge, i32> = BTreeMap::new();
    for (a, b) in members.iter().flat_map(edges_of) {
        if a < b {
            *counts.entry((a, b)).or_default() += 1;
        } else {
            *counts.entry((b, a)).or_default() -= 1;
        }
    }
    let edges = counts.into_iter().flat_map(|((a, b), count)| {
        let edge = if count > 0 { (a, b) } else { (b, a) };
        std::iter::repeat_n(edge, count.unsigned_abs() as usize)
    });
    (join_straight(&edges.collect::<Vec<_>>()).into_iter())
        .map(|(a, b)| (place_of(a), place_of(b)))
        .collect()
}

struct Plane {
    normal: DVec3,
    anchor: DVec3,
    emission: Vec3,
    tolerance: f64,
}

impl Plane {
    fn of(triangle: &EmissiveTriangle) -> Self {
        let bounds = Bounds3::around(triangle.corners);
        let magnitude = bounds.min.abs().max(bounds.max.abs()).max_element();
        Self {
            normal: front_normal(&triangle.corners),
            anchor: triangle.corners[0].as_dvec3(),
            emission: triangle.emission,
            tolerance: PLANE_TOLERANCE * f64::from(magnitude),
        }
    }

    fn accepts(&self, triangle: &EmissiveTriangle) -> bool {
        triangle.emission == self.emission
            && front_normal(&triangle.corners).dot(self.normal) > 0.99
            && (triangle.corners.iter())
                .all(|p| self.normal.dot(p.as_dvec3() - self.anchor).abs() <= self.tolerance)
    }
}

/// Replaces runs of collinear edges by one edge each.
fn join_straight(edges: &[Edge]) -> Vec<Edge> {
    let mut leaving: BTreeMap<Corner, Vec<Corner>> = BTreeMap::new();
    let mut arriving: BTreeMap<Corner, Vec<Corner>> = BTreeMap::new();
    for &(a, b) in edges {
        leaving.entry(a).or_default().push(b);
        arriving.entry(b).or_default().push(a);
    }
    let passes_straight = |corner: Corner| {
        let (Some([from]), Some([to])) = (
            arriving.get(&corner).map(Vec::as_slice),
            leaving.get(&corner).map(Vec::as_slice),
        ) else {
            return false;
        };
        let middle = place_of(corner);
        let (before, after) = (middle - place_of(*from), place_of(*to) - middle);
        before.cross(after).length() <= STRAIGHT_TOLERANCE * before.dot(after)
    };
    let mut joined = Vec::new();
    for &(a, mut b) in edges {
        if passes_straight(a) {
            continue;
        }
        while passes_straight(b) {
            b = leaving[&b][0];
        }
        joined.push((a, b));
    }
    joined
}
