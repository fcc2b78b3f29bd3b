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
use super::stand::Stand;
use super::tree::{Cut, Item, Look, Node, POINT_LIKE, Part, Seen, grow, pick, visible};
use crate::math::luminance;
use glam::{DVec3, Vec2, Vec3};

/// A triangle's radius over its distance below which three points stand for it: exact to third order.
const THREE_POINTS: f32 = 0.25;

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

/// All such triangles.
#[derive(Debug)]
pub(super) struct Clusters {
    sources: Vec<Source>,
    /// Running sums of the sources' power.
    sums: Vec<f64>,
    nodes: Vec<Node>,
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
        let mut view = View {
            sources: &self.sources,
            origin: stand.origin,
            normal: stand.point.normal,
        };
        view.parts(&self.nodes)
    }
}

/// The triangles as a receiver looks at them.
struct View<'a> {
    sources: &'a [Source],
    origin: Vec3,
    normal: Vec3,
}

impl Cut for View<'_> {
    fn seen(&mut self, node: &Node) -> Seen {
        node.seen_from(self.origin, self.normal)
    }

    fn roughly(&self, node: &Node) -> f32 {
        node.roughly(self.origin, self.normal)
    }

    fn source(&self, number: u32) -> Part {
        let source = &self.sources[number as usize];
        Part {
            first: number,
            count: 1,
            irradiance: source.irradiance(self.origin, self.normal),
            power: source.power,
            color: source.emission / luminance(source.emission),
        }
    }
}

impl Node {
    fn seen_from(&self, origin: Vec3, normal: Vec3) -> Seen {
        let offset = self.center - origin;
        let (height, squared) = (normal.dot(offset), offset.length_squared());
        if height <= -self.radius {
            return Seen::Nothing;
        }
        let distance = squared.sqrt();
        // of the angle under which it is seen, from outside
        let sine = self.radius / distance;
        if squared <= self.radius * self.radius {
            return Seen::Unclear(sine);
        }
        // angle of the cone of normals plus that under which the cluster is seen
        let (cosine, cone_sine) = (
            (1.0 - sine * sine).sqrt(),
            (1.0 - self.cone * self.cone).max(0.0).sqrt(),
        );
        let (spread_sine, spread_cosine) = (
            cone_sine * cosine + self.cone * sine,
            self.cone * cosine - cone_sine * sine,
        );
        if self.cone <= 0.0 || spread_cosine <= 0.0 {
            return Seen::Unclear(sine);
        }
        let turned = -self.axis.dot(offset) / distance;
        if turned <= -spread_sine {
            Seen::Nothing
        } else if turned >= spread_sine && height >= self.radius && sine < POINT_LIKE {
            Seen::Point(-self.moment.dot(offset) * height / (squared * squared))
        } else {
            Seen::Unclear(sine)
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
    use super::super::pattern;
    use super::super::tree::MOST_LOOKS;
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
            assert!(parts < 3 * MOST_LOOKS, "{parts}");
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
            assert!(parts.len() < 3 * MOST_LOOKS, "{}", parts.len());
            let sum: f64 = parts.iter().map(|part| f64::from(part.irradiance)).sum();
            let truth: f64 = (clusters.sources.iter())
                .map(|source| f64::from(source.irradiance(stand.origin, Vec3::Y)))
                .sum();
            assert!(
                (sum / truth - 1.0).abs() < 0.01,
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
