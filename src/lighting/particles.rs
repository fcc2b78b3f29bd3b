//! Glowing particles (fire, sparks, an explosion of a million): spheres of constant radiance that hide nothing, if they come
//! from a cloud, or what is behind them, if they are points of the stage. A tree of
//! them gives the irradiance without occluders at a cost that grows with the logarithm of their number, and rays to
//! particles picked by their share of it find how much of it is visible. PBGI §7.2.
//!
//! A cluster that is small as seen from the receiver and wholly above its horizon counts as one point; what is not, is
//! opened, down to single particles. As [`super::clusters`], for sources that face every way.

use super::balls::Ball;
use super::form_factor::cap_irradiance;
use super::pattern;
use super::stand::Stand;
use super::tree::{Cut, Item, Look, Node, POINT_LIKE, Part, Seen, grow, pick, visible};
use crate::math::{Frame, luminance};
use crate::scene::ParticleSet;
use crate::trace::Way;
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::PI;

/// Fewest particles of a crowd; disks of them over the one that holds it, at least; and sine of the angle about the middle under
/// which that is seen, beyond which it is all around.
const CROWD: u32 = 64;
const CROWDED: f32 = 0.5;
const WIDEST: f32 = 0.8;

/// A cluster in which particles hide each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crowd {
    first: u32,
    count: u32,
    /// Unit vector to its middle, and the sine of the angle about that which holds it; `None`: it is all around.
    pub(super) cone: Option<(Vec3, f32)>,
    /// Luminance of what it gives, about.
    pub(super) irradiance: f32,
}

impl Crowd {
    /// True if this source is part of it.
    pub(super) fn holds(&self, source: u32) -> bool {
        source.wrapping_sub(self.first) < self.count
    }
}

/// One sphere.
#[derive(Debug, Clone, Copy)]
struct Particle {
    /// As it was given.
    number: u32,
    center: Vec3,
    radius: f32,
    /// Radius of what hides others, within which it is; 0 = nothing does.
    shell: f32,
    radiance: Vec3,
    /// Luminance times the area of the disk that it is seen as: irradiance at distance 1, straight on.
    power: f32,
}

impl Particle {
    /// `None` if it is dark.
    fn new(number: u32, (center, radius, shell): (Vec3, f32, f32), radiance: Vec3) -> Option<Self> {
        let power = luminance(radiance) * PI * radius * radius;
        (power > 0.0 && power.is_finite()).then_some(Self {
            number,
            center,
            radius,
            shell,
            radiance,
            power,
        })
    }

    /// Irradiance over power at a receiver with this `normal`, from where the center is at `offset`: exact. Those who hide
    /// others have nobody in them: whoever seems to be is on them.
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    fn factor(&self, offset: Vec3, normal: Vec3) -> f32 {
        let (own, squared) = (self.radius * self.radius, offset.length_squared());
        if self.shell == 0.0 && squared <= own {
            return ball_factor(offset, normal, self.radius);
        }
        let squared = squared.max(own);
        let (distance, spread) = (squared.sqrt(), self.radius / squared.sqrt());
        let cosine = normal.dot(offset) / distance;
        if cosine >= spread {
            return cosine / squared;
        }
        let cap = cap_irradiance(cosine.into(), spread.into()) as f32;
        cap / (PI * own)
    }
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
                Particle::new(0, (center, radius, 0.0), radiance * factor)
            }));
        }
        Self::grown(sources)
    }

    /// `balls`, which hide each other. Cost O(n log n).
    ///
    /// # Panics
    /// With 2^31 of them or more.
    pub(super) fn of_balls(balls: &[Ball]) -> Self {
        let source = |(number, ball): (u32, &Ball)| {
            let place = (ball.center, ball.radius, ball.shell);
            Particle::new(number, place, ball.radiance)
        };
        Self::grown((0..).zip(balls).filter_map(source).collect())
    }

    /// Of each source, in order, the number of the ball that it is.
    pub(super) fn numbers(&self) -> impl Iterator<Item = u32> {
        self.sources.iter().map(|source| source.number)
    }

    /// Radiance of a source.
    pub(super) fn radiance(&self, source: u32) -> Vec3 {
        self.sources[source as usize].radiance
    }

    fn grown(mut sources: Vec<Particle>) -> Self {
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

    /// Irradiance; rays go to the particles that `picks` pick, a quarter of them if these agree.
    pub(super) fn irradiance(&self, stand: &Stand<'_>, picks: &[Vec2]) -> Vec3 {
        let (parts, _) = self.parts(stand, false);
        self.of_parts(&parts, stand, picks)
    }

    /// The same by `parts` of them alone.
    pub(super) fn of_parts(&self, parts: &[Part], stand: &Stand<'_>, picks: &[Vec2]) -> Vec3 {
        visible(parts, stand, picks, |part, place| {
            self.look(stand, part, place)
        })
    }

    /// See [`Look`].
    fn look(&self, stand: &Stand<'_>, part: &Part, place: Vec2) -> Option<Look> {
        let (index, within) = pick(&self.sums, part, place.x);
        let source = &self.sources[index];
        let towards = (source.center - stand.origin).try_normalize()?;
        // One point of the disk that the sphere is seen as.
        let aside = source.radius * pattern::disk(Vec2::new(within, place.y));
        let target = source.center + Frame::about(towards).to_world(aside.extend(0.0));
        let depth = (source.shell * source.shell - aside.length_squared()).max(0.0);
        let offset = target - stand.origin;
        let direction = offset.try_normalize()?;
        let cosine = stand.point.normal.dot(direction);
        if cosine <= 0.0 {
            return None;
        }
        let squared = offset.length_squared().max(source.radius * source.radius);
        let weight = cosine / squared * part.power / part.irradiance;
        let color = source.radiance * (weight / luminance(source.radiance));
        color.is_finite().then(|| Look {
            weight: color,
            way: stand.way(Some(target), direction).map(|way| Way {
                max_distance: (way.max_distance - depth.sqrt()).max(0.0),
                ..way
            }),
        })
    }

    /// The parts that shine on the receiver, in order of their sources, and crowds, if these are asked for, of which no part is
    /// made then.
    pub(super) fn parts(&self, stand: &Stand<'_>, asks_crowds: bool) -> (Vec<Part>, Vec<Crowd>) {
        let mut view = View {
            sources: &self.sources,
            origin: stand.origin,
            normal: stand.point.normal,
            crowds: asks_crowds.then(Vec::new),
        };
        let parts = view.parts(&self.nodes);
        let mut crowds = view.crowds.unwrap_or_default();
        crowds.sort_unstable_by_key(|crowd| crowd.first);
        (parts, crowds)
    }
}

/// The particles as a receiver looks at them.
struct View<'a> {
    sources: &'a [Particle],
    origin: Vec3,
    normal: Vec3,
    /// Those so far; `None` if they are not asked for.
    crowds: Option<Vec<Crowd>>,
}

impl Cut for View<'_> {
    fn seen(&mut self, node: &Node) -> Seen {
        let offset = node.center - self.origin;
        let (height, squared) = (self.normal.dot(offset), offset.length_squared());
        if height <= -node.radius {
            return Seen::Nothing;
        }
        if let Some(crowds) = self.crowds.as_mut().filter(|_| node.is_crowd()) {
            crowds.push(node.crowd(offset, self.normal));
            return Seen::Nothing;
        }
        let is_small = node.radius * node.radius < POINT_LIKE * POINT_LIKE * squared;
        if is_small && height >= node.radius {
            return Seen::Point(self.roughly(node));
        }
        Seen::Unclear(node.radius / squared.sqrt())
    }

    fn roughly(&self, node: &Node) -> f32 {
        node.power * ball_factor(node.center - self.origin, self.normal, node.radius)
    }

    fn source(&self, number: u32) -> Part {
        let source = &self.sources[number as usize];
        let factor = source.factor(source.center - self.origin, self.normal);
        Part {
            first: number,
            count: 1,
            irradiance: source.power * factor,
            power: source.power,
            color: source.radiance / luminance(source.radiance),
        }
    }
}

/// Irradiance by a ball of power 1 that is full of particles, whose center is at `offset` from a receiver with this `normal`:
/// from far, exact where all or nothing of it is above the horizon, and between if they fill it evenly: the mean height of those
/// above, ∫ max(t + y, 0) ¾ (1 − y²) dy of its radius. Inside, all of the hemisphere.
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
        let t = (cosine / spread).max(-1.0);
        spread * (3.0 / 16.0 + t * (0.5 + t * (3.0 / 8.0 - t * t / 16.0)))
    };
    above.max(0.0) / squared
}

impl Node {
    /// True if this cluster of particles hides many of its own.
    fn is_crowd(&self) -> bool {
        self.count >= CROWD && self.coverage >= CROWDED
    }

    fn crowd(&self, offset: Vec3, normal: Vec3) -> Crowd {
        let distance = offset.length();
        let all = self.power * ball_factor(offset, normal, self.radius);
        let is_apart = self.radius <= WIDEST * distance;
        Crowd {
            first: self.first,
            count: self.count,
            cone: is_apart.then(|| (offset / distance, self.radius / distance)),
            irradiance: all / self.coverage.max(1.0),
        }
    }
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
        let reach = |s: &Self| s.center.distance(center) + s.radius.max(s.shell);
        let radius = sources.iter().map(reach).fold(0.0, f32::max);
        let disks: f32 = sources.iter().map(|s| s.radius * s.radius).sum();
        Node {
            first,
            count: sources.len() as u32,
            second: 0,
            center,
            radius,
            coverage: disks / (radius * radius),
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
    use super::super::tree::MOST_LOOKS;
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
            let value = one.irradiance(&Stand::new(&tracer, &point), &pattern::picks(64));
            let squared = x * x + 4.0;
            let truth = PI * 0.25 * 2.0 / squared / squared.sqrt();
            let error = (value / (truth * Vec3::new(1.0, 2.0, 3.0)) - 1.0).abs();
            assert!(error.max_element() < 1e-4, "{x}: {value} {truth}");
        }
        let above = up_at(Vec3::new(0.0, 3.0, 0.0));
        let stand = Stand::new(&tracer, &above);
        assert_eq!(one.irradiance(&stand, &pattern::picks(64)), Vec3::ZERO);
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
        let value = both.irradiance(&Stand::new(&tracer, &point), &pattern::picks(64));
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
        for (position, tolerance) in [
            (Vec3::ZERO, 0.002),
            (Vec3::new(4.0, 0.3, 0.0), 0.002),
            (Vec3::new(0.0, 1.5, 0.0), 0.005),
        ] {
            let point = up_at(position);
            let stand = Stand::new(&tracer, &point);
            let (parts, _) = all.parts(&stand, false);
            assert!(parts.len() < 3 * MOST_LOOKS, "{}", parts.len());
            let sum: f64 = parts.iter().map(|part| f64::from(part.irradiance)).sum();
            let alone = |source: &Particle| {
                source.power * source.factor(source.center - stand.origin, Vec3::Y)
            };
            let truth: f64 = (all.sources.iter().map(alone)).map(f64::from).sum();
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
