//! Emissive triangles of constant radiance that are no panels (bulbs, neon letters, a million sparks): a tree of
//! clusters gives the irradiance without occluders almost exactly at a cost that grows with the logarithm of their
//! number, and rays to points picked by their share of it find how much of it is visible.
//!
//! A cluster that is small as seen from the receiver, wholly above its horizon and turned towards it counts as one
//! point with the sum of its area vectors; what is not, is opened, down to single triangles. After Walter et al.,
//! *Lightcuts* (2005).

use super::emitters::{EmissiveTriangle, front_normal};
use super::form_factor::outline_irradiance;
use super::panels::barycentrics;
use super::pattern;
use super::stand::Stand;
use crate::math::{Bounds3, luminance};
use crate::trace::{TOGETHER, Way};
use glam::{DVec3, Vec2, Vec3};

/// A cluster's radius over its distance below which it counts as a point: the error of that is of second order.
pub(super) const POINT_LIKE: f32 = 0.05;
/// A triangle's radius over its distance below which three points stand for it: exact to third order.
const THREE_POINTS: f32 = 0.25;
/// Most triangles of a cluster that is not divided.
const LEAF_SIZE: usize = 8;
/// So many clusters are looked at for one receiver; those left then are taken as they are, roughly.
pub(super) const MOST_VISITS: usize = 2048;
/// Subtrees of at least this many triangles are built in parallel.
const PARALLEL: usize = 8192;

/// A triangle, ready to be summed up.
#[derive(Debug, Clone, Copy)]
struct Source {
    corners: [Vec3; 3],
    center: Vec3,
    /// Of the circle about the center.
    radius: f32,
    /// Unit normal of the front times area times luminance.
    moment: Vec3,
    emission: Vec3,
    /// Luminance times area.
    power: f32,
}

/// A cluster: a run of sources; its first child follows it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub(super) first: u32,
    pub(super) count: u32,
    /// The second child; 0 = none.
    pub(super) second: u32,
    /// Of power.
    pub(super) center: Vec3,
    /// Of the ball about the center that holds it.
    pub(super) radius: f32,
    /// Sum over its sources.
    pub(super) moment: Vec3,
    /// Unit, in the middle of its normals.
    pub(super) axis: Vec3,
    /// Cosine of the largest angle between a normal and the axis.
    pub(super) cone: f32,
    pub(super) power: f32,
    /// Of particles: area of their disks over that of the ball's.
    pub(super) coverage: f32,
    /// Mean emission over its luminance.
    pub(super) color: Vec3,
}

/// What a tree is built over.
pub(super) trait Item: Send + Sync + Sized {
    fn center(&self) -> Vec3;

    fn power(&self) -> f32;

    /// Sums over `items`, at least one, the first of which has the number `first`; without children.
    fn node(items: &[Self], first: u32) -> Node;
}

/// All such triangles.
#[derive(Debug)]
pub(super) struct Clusters {
    sources: Vec<Source>,
    /// Running sums of the sources' power.
    sums: Vec<f64>,
    nodes: Vec<Node>,
}

/// A part of the emitters and what it gives without occluders.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    pub(super) first: u32,
    pub(super) count: u32,
    /// In luminance.
    pub(super) irradiance: f32,
    pub(super) power: f32,
    pub(super) color: Vec3,
}

impl Clusters {
    /// Cost O(n log n).
    ///
    /// # Panics
    /// With 2^31 triangles or more.
    pub(super) fn new(triangles: &[EmissiveTriangle]) -> Self {
        let mut sources: Vec<Source> = triangles.iter().filter_map(Source::new).collect();
        let (nodes, sums) = grow(&mut sources);
        Self {
            sums,
            sources,
            nodes,
        }
    }

    /// True if there are none.
    pub(super) fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Irradiance; rays go to the points that `picks` pick, a quarter of them if these agree.
    pub(super) fn irradiance(&self, stand: &Stand<'_>, picks: &[Vec2]) -> Vec3 {
        let parts = self.parts(stand);
        visible(&parts, stand, picks, |part, place| {
            self.look(stand, part, place)
        })
    }

    /// See [`Look`].
    fn look(&self, stand: &Stand<'_>, part: &Part, place: Vec2) -> Option<Look> {
        let (index, within) = pick(&self.sums, part, place.x);
        let source = &self.sources[index];
        let (u, v) = barycentrics(Vec2::new(within, place.y));
        let [a, b, c] = source.corners;
        let target = a * (1.0 - u - v) + b * u + c * v;
        let offset = target - stand.origin;
        let direction = offset.try_normalize()?;
        let cosine = stand.point.normal.dot(direction);
        let normal = source.moment / source.power;
        let leaving = -normal.dot(direction);
        if cosine <= 0.0 || leaving <= 0.0 {
            return None;
        }
        let weight = cosine * leaving / offset.length_squared() * part.power / part.irradiance;
        weight.is_finite().then(|| Look {
            weight: source.emission * (weight / luminance(source.emission)),
            way: stand.way_to_surface(target, direction, leaving),
        })
    }

    /// The parts that shine on the receiver, in order of their sources.
    fn parts(&self, stand: &Stand<'_>) -> Vec<Part> {
        let (origin, normal) = (stand.origin, stand.point.normal);
        let mut parts = Vec::new();
        let mut queue = vec![0_u32];
        let mut next = 0;
        while let Some(&index) = queue.get(next) {
            next += 1;
            let node = &self.nodes[index as usize];
            match node.seen_from(origin, normal) {
                Seen::Nothing => {}
                Seen::Point(irradiance) => parts.push(node.part(irradiance)),
                Seen::Unclear if next > MOST_VISITS => {
                    parts.push(node.part(node.roughly(origin, normal)));
                }
                Seen::Unclear if node.second == 0 => {
                    parts.extend(self.leaf(node, origin, normal));
                }
                Seen::Unclear => queue.extend([index + 1, node.second]),
            }
        }
        parts.retain(|part: &Part| part.irradiance > 0.0);
        parts.sort_unstable_by_key(|part| part.first);
        parts
    }

    fn leaf(&self, node: &Node, origin: Vec3, normal: Vec3) -> impl Iterator<Item = Part> {
        (node.first..node.first + node.count).map(move |first| {
            let source = &self.sources[first as usize];
            Part {
                first,
                count: 1,
                irradiance: source.irradiance(origin, normal),
                power: source.power,
                color: source.emission / luminance(source.emission),
            }
        })
    }
}

/// A point of a part of the emitters.
pub(super) struct Look {
    /// What it gives, over what it should give by its share.
    pub(super) weight: Vec3,
    /// To the receiver; `None` where its own surface hides it.
    pub(super) way: Option<Way>,
}

/// Irradiance by `parts`: rays go to the points that `picks`, those of a quarter side by side and then the rest, pick, `look`
/// finds such a point of a part. A quarter of the rays if these agree.
pub(super) fn visible(
    parts: &[Part],
    stand: &Stand<'_>,
    picks: &[Vec2],
    look: impl Fn(&Part, Vec2) -> Option<Look>,
) -> Vec3 {
    let mut sum = 0.0;
    let sums: Vec<f32> = (parts.iter())
        .map(|part| {
            sum += part.irradiance;
            sum
        })
        .collect();
    if sum.is_nan() || sum <= 0.0 {
        return Vec3::ZERO;
    }
    let unoccluded: Vec3 = parts.iter().map(|part| part.color * part.irradiance).sum();
    let picked = |pick: &Vec2| {
        let place = pick.x * sum;
        let at = sums
            .partition_point(|&sum| sum <= place)
            .min(parts.len() - 1);
        let before = if at == 0 { 0.0 } else { sums[at - 1] };
        let within = ((place - before) / parts[at].irradiance).clamp(0.0, 1.0);
        look(&parts[at], Vec2::new(within, pick.y))
    };
    let (mut all, mut lit) = (Vec3::ZERO, Vec3::ZERO);
    let (quarter, rest) = picks.split_at(pattern::quarter_of(picks.len()));
    for (part, is_first) in [(quarter, true), (rest, false)] {
        if !is_first && all != Vec3::ZERO && (lit == Vec3::ZERO || lit == all) {
            break;
        }
        for some in part.chunks(TOGETHER) {
            let (mut weights, mut ways) = ([Vec3::ZERO; TOGETHER], [Way::NONE; TOGETHER]);
            let mut count = 0;
            for look in some.iter().filter_map(picked) {
                all += look.weight;
                if let Some(way) = look.way {
                    (weights[count], ways[count]) = (look.weight, way);
                    count += 1;
                }
            }
            let open = stand.tracer.transmittances(&ways[..count]);
            for (weight, open) in weights.iter().zip(open).take(count) {
                lit += weight * open;
            }
        }
    }
    let share = |lit: f32, all: f32| if all > 0.0 { lit / all } else { 0.0 };
    unoccluded
        * Vec3::new(
            share(lit.x, all.x),
            share(lit.y, all.y),
            share(lit.z, all.z),
        )
}

/// The source of `part` that `place`, 0…1, picks by power, `sums` being its running sums over all sources, and what is left
/// of `place` within it, 0…1.
pub(super) fn pick(sums: &[f64], part: &Part, place: f32) -> (usize, f32) {
    let first = part.first as usize;
    let run = &sums[first..first + part.count as usize];
    let before = if first == 0 { 0.0 } else { sums[first - 1] };
    let pick = before + f64::from(place) * (run[run.len() - 1] - before);
    let index = run.partition_point(|&sum| sum <= pick).min(run.len() - 1);
    let low = if index == 0 { before } else { run[index - 1] };
    #[expect(clippy::cast_possible_truncation, reason = "a part of 1")]
    let within = ((pick - low) / (run[index] - low)).clamp(0.0, 1.0) as f32;
    (first + index, within)
}

/// What a receiver sees of a cluster.
enum Seen {
    /// It is below the horizon or turned away.
    Nothing,
    /// As good as a point of this irradiance.
    Point(f32),
    /// Neither for certain.
    Unclear,
}

impl Node {
    pub(super) fn part(&self, irradiance: f32) -> Part {
        Part {
            first: self.first,
            count: self.count,
            irradiance,
            power: self.power,
            color: self.color,
        }
    }

    fn seen_from(&self, origin: Vec3, normal: Vec3) -> Seen {
        let offset = self.center - origin;
        let (height, squared) = (normal.dot(offset), offset.length_squared());
        if height <= -self.radius {
            return Seen::Nothing;
        }
        if squared <= self.radius * self.radius {
            return Seen::Unclear;
        }
        let distance = squared.sqrt();
        // angle of the cone of normals plus that under which the cluster is seen
        let sine = self.radius / distance;
        let (cosine, cone_sine) = (
            (1.0 - sine * sine).sqrt(),
            (1.0 - self.cone * self.cone).max(0.0).sqrt(),
        );
        let (spread_sine, spread_cosine) = (
            cone_sine * cosine + self.cone * sine,
            self.cone * cosine - cone_sine * sine,
        );
        if self.cone <= 0.0 || spread_cosine <= 0.0 {
            return Seen::Unclear;
        }
        let turned = -self.axis.dot(offset) / distance;
        if turned <= -spread_sine {
            Seen::Nothing
        } else if turned >= spread_sine && height >= self.radius && sine < POINT_LIKE {
            Seen::Point(-self.moment.dot(offset) * height / (squared * squared))
        } else {
            Seen::Unclear
        }
    }

    /// As if part of it, as much as its normals agree, were flat and the rest turned every way.
    fn roughly(&self, origin: Vec3, normal: Vec3) -> f32 {
        let offset = self.center - origin;
        let squared = offset.length_squared().max(self.radius * self.radius);
        let distance = squared.sqrt();
        let (towards, flat) = (-self.moment.dot(offset) / distance, self.moment.length());
        let projected = 0.5 * (towards + towards.abs()) + 0.25 * (self.power - flat).max(0.0);
        let (cosine, spread) = (normal.dot(offset) / distance, self.radius / distance);
        let above = if cosine >= spread {
            cosine
        } else {
            (cosine + spread).max(0.0).powi(2) / (4.0 * spread)
        };
        projected * above / squared
    }
}

impl Source {
    fn new(triangle: &EmissiveTriangle) -> Option<Self> {
        let corners = triangle.corners;
        let center = (corners[0] + corners[1] + corners[2]) / 3.0;
        let power = luminance(triangle.emission) * triangle.area;
        let normal = front_normal(&corners).as_vec3();
        let reach = corners.map(|corner| corner.distance(center));
        (power > 0.0 && normal != Vec3::ZERO).then_some(Self {
            corners,
            center,
            radius: reach.into_iter().fold(0.0, f32::max),
            moment: normal * power,
            emission: triangle.emission,
            power,
        })
    }

    /// In luminance, without occluders.
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    fn irradiance(&self, origin: Vec3, normal: Vec3) -> f32 {
        let offset = self.center - origin;
        let (height, squared) = (normal.dot(offset), offset.length_squared());
        let towards = -self.moment.dot(offset);
        if height <= -self.radius || towards <= 0.0 {
            return 0.0;
        }
        if height >= self.radius && self.radius * self.radius < POINT_LIKE * POINT_LIKE * squared {
            return towards * height / (squared * squared);
        }
        if self.radius * self.radius < THREE_POINTS * THREE_POINTS * squared {
            // all points of a triangle have the same distance from its plane, the receiver's
            let at = |corner: usize| {
                let offset = 0.5 * (offset + self.corners[corner] - origin);
                let squared = offset.length_squared();
                normal.dot(offset).max(0.0) / (squared * squared)
            };
            return towards * (at(0) + at(1) + at(2)) / 3.0;
        }
        let [a, b, c] = self.corners.map(|corner| (corner - origin).as_dvec3());
        let plane_normal = (b - a).cross(c - a).normalize_or_zero();
        // a triangle in whose plane the receiver lies gives nothing
        if plane_normal.dot(a) >= 0.0 {
            return 0.0;
        }
        let edges = [(a, b), (b, c), (c, a)].into_iter();
        luminance(self.emission) * outline_irradiance(edges, plane_normal, normal.as_dvec3()) as f32
    }
}

/// The nodes of a tree over `sources`, which are put in its order, and the running sums of their power.
///
/// # Panics
/// With 2^31 sources or more.
pub(super) fn grow<T: Item>(sources: &mut [T]) -> (Vec<Node>, Vec<f64>) {
    assert!(
        sources.len() < 1 << 31,
        "sources of light are numbered with 31 bits"
    );
    let nodes = if sources.is_empty() {
        Vec::new()
    } else {
        build(sources, 0)
    };
    let mut sum = 0.0;
    let sums = sources.iter().map(|source| {
        sum += f64::from(source.power());
        sum
    });
    (nodes, sums.collect())
}

/// Nodes over `sources`, the first of which has the number `first`; reorders them. Preorder, so that a first child
/// follows its parent.
#[expect(clippy::cast_possible_truncation, reason = "grow asserts the count")]
fn build<T: Item>(sources: &mut [T], first: u32) -> Vec<Node> {
    let node = T::node(sources, first);
    if sources.len() <= LEAF_SIZE {
        return vec![node];
    }
    let bounds = Bounds3::around(sources.iter().map(Item::center));
    let size = bounds.max - bounds.min;
    let axis = (0..3)
        .max_by(|&a, &b| size[a].total_cmp(&size[b]))
        .expect("there are three axes");
    let middle = sources.len() / 2;
    sources.select_nth_unstable_by(middle, |a, b| a.center()[axis].total_cmp(&b.center()[axis]));
    let is_large = sources.len() >= PARALLEL;
    let (low, high) = sources.split_at_mut(middle);
    let second_first = first + middle as u32;
    let (low, high) = if is_large {
        rayon::join(|| build(low, first), || build(high, second_first))
    } else {
        (build(low, first), build(high, second_first))
    };
    let mut nodes = Vec::with_capacity(1 + low.len() + high.len());
    nodes.push(Node {
        second: 1 + low.len() as u32,
        ..node
    });
    let second = nodes[0].second;
    for (shift, part) in [(1, low), (second, high)] {
        nodes.extend(part.into_iter().map(|node| Node {
            second: if node.second == 0 {
                0
            } else {
                node.second + shift
            },
            ..node
        }));
    }
    nodes
}

impl Item for Source {
    fn center(&self) -> Vec3 {
        self.center
    }

    fn power(&self) -> f32 {
        self.power
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "sums in f64; grow asserts the count"
    )]
    fn node(sources: &[Self], first: u32) -> Node {
        let power: f64 = sources.iter().map(|s| f64::from(s.power)).sum();
        let mean = |of: &dyn Fn(&Self) -> Vec3| {
            let sum: DVec3 = sources.iter().map(|s| of(s).as_dvec3()).sum();
            sum.as_vec3()
        };
        let center = mean(&|s| s.center * s.power) / power as f32;
        let moment = mean(&|s| s.moment);
        let axis = moment.normalize_or(Vec3::Z);
        let cosine = |s: &Self| (s.moment / s.power).dot(axis);
        Node {
            first,
            count: sources.len() as u32,
            second: 0,
            center,
            radius: (sources.iter())
                .map(|s| s.center.distance(center) + s.radius)
                .fold(0.0, f32::max),
            moment,
            axis,
            cone: sources.iter().map(cosine).fold(1.0, f32::min),
            power: power as f32,
            coverage: 0.0,
            color: mean(&|s| s.emission * (s.power / luminance(s.emission))) / power as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::ShadePoint;
    use super::*;
    use crate::scene::PrimId;
    use crate::trace::Tracer;
    use crate::trace::testing::{Random, scene};
    use std::f32::consts::PI;

    fn emissive(corners: [Vec3; 3]) -> EmissiveTriangle {
        let [a, b, c] = corners;
        EmissiveTriangle {
            prim: PrimId(0),
            triangle: 0,
            corners,
            emission: Vec3::new(1.0, 2.0, 3.0),
            is_constant: true,
            area: 0.5 * (b - a).cross(c - a).length(),
        }
    }

    fn up_at(position: Vec3) -> ShadePoint {
        ShadePoint {
            position,
            normal: Vec3::Y,
            geometric_normal: Vec3::Y,
            smooth_offset: None,
            prim: None,
        }
    }

    /// A sphere of `2 · rows · 2 rows` triangles.
    fn globe(center: Vec3, radius: f32, rows: u32) -> Vec<EmissiveTriangle> {
        let at = |i: u32, j: u32| {
            let polar = PI * i as f32 / rows as f32;
            let around = Vec2::from_angle(PI * (j % (2 * rows)) as f32 / rows as f32);
            center + radius * Vec3::new(polar.sin() * around.x, polar.cos(), polar.sin() * around.y)
        };
        let mut all = Vec::new();
        for i in 0..rows {
            for j in 0..2 * rows {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                all.extend([emissive([a, c, b]), emissive([a, d, c])]);
            }
        }
        all
    }

    #[test]
    fn a_million_triangles_cost_few_parts_and_give_the_sphere_formula() {
        let center = Vec3::new(0.0, 1.0, 0.0);
        let clusters = Clusters::new(&globe(center, 0.4, 500));
        assert!(clusters.sources.len() > 990_000);
        let tracer = Tracer::new(&scene(Vec::new(), &[]));
        for x in [0.0, 0.5, 3.0] {
            let point = up_at(Vec3::new(x, 0.0, 0.0));
            let stand = Stand::new(&tracer, &point);
            let parts = clusters.parts(&stand).len();
            assert!(parts < 3 * MOST_VISITS, "{parts}");
            let squared = x * x + 1.0;
            let truth = PI * 0.16 / squared / squared.sqrt();
            let value = clusters.irradiance(&stand, &pattern::picks(64));
            let error = (value / (truth * Vec3::new(1.0, 2.0, 3.0)) - 1.0).abs();
            assert!(error.max_element() < 1e-3, "{x}: {value} {truth}");
        }
    }

    #[test]
    fn sparks_that_face_every_way_give_the_sum_over_all_at_bounded_cost() {
        let mut random = Random(3);
        let spark = |random: &mut Random| {
            let center = random.vector() + Vec3::new(0.0, 1.5, 0.0);
            emissive([(); 3].map(|()| center + 0.003 * random.direction()))
        };
        let clusters = Clusters::new(&(0..100_000).map(|_| spark(&mut random)).collect::<Vec<_>>());
        let tracer = Tracer::new(&scene(Vec::new(), &[]));
        for position in [
            Vec3::ZERO,
            Vec3::new(4.0, 0.3, 0.0),
            Vec3::new(0.0, 1.5, 0.0),
        ] {
            let point = up_at(position);
            let stand = Stand::new(&tracer, &point);
            let parts = clusters.parts(&stand);
            assert!(parts.len() < 3 * MOST_VISITS, "{}", parts.len());
            let sum: f64 = parts.iter().map(|part| f64::from(part.irradiance)).sum();
            let truth: f64 = (clusters.sources.iter())
                .map(|source| f64::from(source.irradiance(stand.origin, Vec3::Y)))
                .sum();
            assert!(
                (sum / truth - 1.0).abs() < 0.05,
                "{position}: {sum} {truth}"
            );
        }
    }

    #[test]
    fn nothing_and_triangles_without_area_give_nothing() {
        let flat = EmissiveTriangle {
            area: 0.0,
            ..emissive([Vec3::X, Vec3::X, Vec3::Y])
        };
        assert!(Clusters::new(&[]).is_empty());
        assert!(Clusters::new(&[flat]).is_empty());
    }
}
