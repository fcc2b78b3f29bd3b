//! Glowing particles (fire, sparks, an explosion of a million): spheres of constant radiance that hide nothing. A tree of
//! them gives the irradiance without occluders at a cost that grows with the logarithm of their number, and rays to
//! particles picked by their share of it find how much of it is visible. PBGI §7.2.
//!
//! A cluster that is small as seen from the receiver and wholly above its horizon counts as one point; what is not, is
//! opened, down to single particles. As [`super::clusters`], for sources that face every way.

use super::clusters::{Item, MOST_VISITS, Node, POINT_LIKE, Part, grow, pick, visible};
use super::pattern;
use super::stand::Stand;
use crate::math::{Frame, luminance};
use crate::scene::ParticleSet;
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::PI;

/// One sphere.
#[derive(Debug, Clone, Copy)]
struct Particle {
    center: Vec3,
    radius: f32,
    radiance: Vec3,
    /// Luminance times the area of the disk that it is seen as: irradiance at distance 1, straight on.
    power: f32,
}

/// All particles.
#[derive(Debug)]
pub(super) struct Particles {
    sources: Vec<Particle>,
    /// Running sums of the sources' power.
    sums: Vec<f64>,
    nodes: Vec<Node>,
}

impl Particles {
    /// Spheres of all of `sets`, each with a factor on its radiance. Cost O(n log n).
    ///
    /// # Panics
    /// With 2^31 particles or more.
    pub(super) fn new<'a>(sets: impl Iterator<Item = (&'a ParticleSet, Vec3)>) -> Self {
        let mut sources = Vec::new();
        for (set, factor) in sets {
            let spheres = set.position.iter().zip(&set.radius).zip(&set.radiance);
            sources.extend(spheres.filter_map(|((&center, &radius), &radiance)| {
                let radiance = radiance * factor;
                let power = luminance(radiance) * PI * radius * radius;
                (power > 0.0 && power.is_finite()).then_some(Particle {
                    center,
                    radius,
                    radiance,
                    power,
                })
            }));
        }
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

    /// Irradiance; rays go to the particles that `squares` pick, a quarter of them if these agree.
    pub(super) fn irradiance(&self, stand: &Stand<'_>, squares: &[Vec2]) -> Vec3 {
        let parts = self.parts(stand);
        visible(&parts, squares, |part, place| self.look(stand, part, place))
    }

    /// What the particle of `part` picked by `place` gives, over what it should give by its share, and how much is seen
    /// of it, 0…1.
    fn look(&self, stand: &Stand<'_>, part: &Part, place: Vec2) -> Option<(Vec3, f32)> {
        let (index, within) = pick(&self.sums, part, place.x);
        let source = &self.sources[index];
        let towards = (source.center - stand.origin).try_normalize()?;
        // One point of the disk that the sphere is seen as.
        let offset = source.radius * pattern::disk(Vec2::new(within, place.y));
        let target = source.center + Frame::about(towards).to_world(offset.extend(0.0));
        let offset = target - stand.origin;
        let direction = offset.try_normalize()?;
        let cosine = stand.point.normal.dot(direction);
        if cosine <= 0.0 {
            return None;
        }
        let squared = offset.length_squared().max(source.radius * source.radius);
        let weight = cosine / squared * part.power / part.irradiance;
        let color = source.radiance * (weight / luminance(source.radiance));
        color
            .is_finite()
            .then(|| (color, stand.sees(target, direction)))
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
            let offset = node.center - origin;
            let (height, squared) = (normal.dot(offset), offset.length_squared());
            if height <= -node.radius {
                continue;
            }
            let is_small = node.radius * node.radius < POINT_LIKE * POINT_LIKE * squared;
            if (is_small && height >= node.radius) || next > MOST_VISITS {
                parts.push(node.part(node.power * ball_factor(offset, normal, node.radius)));
            } else if node.second == 0 {
                parts.extend(self.leaf(node, origin, normal));
            } else {
                queue.extend([index + 1, node.second]);
            }
        }
        parts.retain(|part: &Part| part.irradiance > 0.0);
        parts.sort_unstable_by_key(|part| part.first);
        parts
    }

    fn leaf(&self, node: &Node, origin: Vec3, normal: Vec3) -> impl Iterator<Item = Part> {
        (node.first..node.first + node.count).map(move |first| {
            let source = &self.sources[first as usize];
            let factor = ball_factor(source.center - origin, normal, source.radius);
            Part {
                first,
                count: 1,
                irradiance: source.power * factor,
                power: source.power,
                color: source.radiance / luminance(source.radiance),
            }
        })
    }
}

/// Irradiance by a glowing ball of power 1 whose center is at `offset` from a receiver with this `normal`: exact above the
/// horizon; below it nothing; between, a parabola that meets both, within 4 % of the irradiance straight on; inside, all
/// of the hemisphere.
fn ball_factor(offset: Vec3, normal: Vec3, radius: f32) -> f32 {
    let squared = offset.length_squared();
    if squared <= radius * radius {
        return 1.0 / (radius * radius).max(f32::MIN_POSITIVE);
    }
    let distance = squared.sqrt();
    let (cosine, spread) = (normal.dot(offset) / distance, radius / distance);
    let above = if cosine >= spread {
        cosine
    } else {
        (cosine + spread).max(0.0).powi(2) / (4.0 * spread)
    };
    above / squared
}

impl Item for Particle {
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
            let sum: DVec3 = sources
                .iter()
                .map(|s| of(s).as_dvec3() * f64::from(s.power))
                .sum();
            (sum / power).as_vec3()
        };
        let center = mean(&|s| s.center);
        Node {
            first,
            count: sources.len() as u32,
            second: 0,
            center,
            radius: (sources.iter())
                .map(|s| s.center.distance(center) + s.radius)
                .fold(0.0, f32::max),
            moment: Vec3::ZERO,
            axis: Vec3::Z,
            cone: -1.0,
            power: power as f32,
            color: mean(&|s| s.radiance / luminance(s.radiance)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::ShadePoint;
    use super::*;
    use crate::trace::Tracer;
    use crate::trace::testing::{Random, mesh, scene};
    use glam::Affine3A;

    fn set(spheres: &[(Vec3, f32)]) -> ParticleSet {
        ParticleSet {
            position: spheres.iter().map(|s| s.0).collect(),
            radius: spheres.iter().map(|s| s.1).collect(),
            normal: Vec::new(),
            radiance: vec![Vec3::new(1.0, 2.0, 3.0); spheres.len()],
        }
    }

    fn particles(spheres: &[(Vec3, f32)]) -> Particles {
        Particles::new([(&set(spheres), Vec3::ONE)].into_iter())
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

    #[test]
    fn one_particle_gives_the_sphere_formula_and_none_below_the_horizon() {
        let tracer = Tracer::new(&scene(Vec::new(), &[]));
        let one = particles(&[(Vec3::new(0.0, 2.0, 0.0), 0.5)]);
        for x in [0.0_f32, 1.0, 4.0] {
            let point = up_at(Vec3::new(x, 0.0, 0.0));
            let value = one.irradiance(&Stand::new(&tracer, &point), &pattern::square(64));
            let squared = x * x + 4.0;
            let truth = PI * 0.25 * 2.0 / squared / squared.sqrt();
            let error = (value / (truth * Vec3::new(1.0, 2.0, 3.0)) - 1.0).abs();
            assert!(error.max_element() < 1e-4, "{x}: {value} {truth}");
        }
        let above = up_at(Vec3::new(0.0, 3.0, 0.0));
        let stand = Stand::new(&tracer, &above);
        assert_eq!(one.irradiance(&stand, &pattern::square(64)), Vec3::ZERO);
    }

    #[test]
    fn a_wall_hides_the_particles_behind_it() {
        // A wall over half of the sky: of two equal particles one is seen.
        let at = |x: f32, z: f32| Vec3::new(x, 1.0, z);
        let (a, b, c, d) = (at(-9.0, -5.0), at(0.0, -5.0), at(0.0, 5.0), at(-9.0, 5.0));
        let wall = mesh(&[[a, b, c], [a, c, d]]);
        let tracer = Tracer::new(&scene(vec![wall], &[(0, Affine3A::IDENTITY)]));
        let both = particles(&[
            (Vec3::new(-1.0, 3.0, 0.0), 0.1),
            (Vec3::new(1.0, 3.0, 0.0), 0.1),
        ]);
        let point = up_at(Vec3::ZERO);
        let value = both.irradiance(&Stand::new(&tracer, &point), &pattern::square(64));
        let truth = PI * 0.01 * 3.0 / 10.0_f32.powf(1.5);
        assert!((value.x / truth - 1.0).abs() < 1e-3, "{value} {truth}");
    }

    #[test]
    fn an_explosion_gives_the_sum_over_all_at_bounded_cost() {
        let mut random = Random(5);
        let spheres: Vec<_> = (0..100_000)
            .map(|_| (random.vector() + Vec3::new(0.0, 1.5, 0.0), 0.002))
            .collect();
        let all = particles(&spheres);
        let tracer = Tracer::new(&scene(Vec::new(), &[]));
        // In the middle of them clusters next to the receiver are not all opened: 9 % are missing.
        for (position, tolerance) in [
            (Vec3::ZERO, 0.05),
            (Vec3::new(4.0, 0.3, 0.0), 0.05),
            (Vec3::new(0.0, 1.5, 0.0), 0.12),
        ] {
            let point = up_at(position);
            let stand = Stand::new(&tracer, &point);
            let parts = all.parts(&stand);
            assert!(parts.len() < 3 * MOST_VISITS, "{}", parts.len());
            let sum: f64 = parts.iter().map(|part| f64::from(part.irradiance)).sum();
            let truth: f64 = (spheres.iter())
                .map(|&(center, radius)| ball_factor(center - stand.origin, Vec3::Y, radius))
                .map(|factor| f64::from(factor * luminance(Vec3::new(1.0, 2.0, 3.0)) * PI * 4e-6))
                .sum();
            assert!(
                (sum / truth - 1.0).abs() < tolerance,
                "{position}: {sum} {truth}"
            );
        }
    }

    #[test]
    fn black_flat_and_broken_particles_give_nothing() {
        assert!(particles(&[]).is_empty());
        assert!(particles(&[(Vec3::Y, 0.0)]).is_empty());
        let black = Particles::new([(&set(&[(Vec3::Y, 1.0)]), Vec3::ZERO)].into_iter());
        assert!(black.is_empty());
    }
}
