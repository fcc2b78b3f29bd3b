//! UsdLux lights other than domes, prepared for shading: irradiance = unshadowed irradiance × visible fraction.

use super::ShadePoint;
use super::beacons::Beacon;
use super::pattern;
use super::pictures::Picture;
use super::shape::{Ellipsoid, LightSample, Shape, is_far};
use super::shaping::WorldShaping;
use super::stand::Stand;
use crate::diagnostics::Diagnostics;
use crate::scene::{Light, LightKind};
use crate::trace::{TOGETHER, Way};
use glam::{Affine3A, Vec2, Vec3};
use std::ops::AddAssign;

/// Samples along each side of a light whose unshadowed irradiance has no closed form; they cost no rays.
const UNSHADOWED_SIDE: u16 = 16;

/// Shadow rays of which a quarter tells whether there is a penumbra; of more, those at the rim do, and one of so many inside.
const FEW: usize = 16;
const INSIDE: usize = 16;

/// Shadow rays of which those at the rim are more.
const MANY: usize = 64;

/// Shadow rays to a light with an extent that is looked at on its own, at least.
const FEWEST: usize = 4;

/// A light in world space.
#[derive(Debug)]
pub(super) struct AreaLight {
    shape: Shape,
    /// After `normalize`.
    radiance: Vec3,
    shaping: Option<WorldShaping>,
    texture: Option<Picture>,
    casts_shadows: bool,
    /// `None` if it is infinitely far.
    beacon: Option<Beacon>,
}

/// Patterns shared by all lights.
#[derive(Debug)]
pub(super) struct Patterns {
    /// Of 1, 4, 16, … shadow rays.
    shadow: Vec<Pattern>,
    unshadowed: Pattern,
}

/// Places on a light.
#[derive(Debug)]
pub(super) struct Pattern {
    squares: Vec<Vec2>,
    /// Side of the part of a light that a place stands for, 1 = the whole light.
    width: f32,
    /// Places that tell whether a receiver lies in the penumbra, on a square and on a round light: along the rim, which shadows
    /// cross first, and some inside. Empty where a quarter of `squares` tells it.
    first: [Vec<Vec2>; 2],
}

impl Pattern {
    fn new(squares: Vec<Vec2>) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "a few hundred samples")]
        let width = 1.0 / (squares.len() as f32).sqrt();
        let with_rim = |rim: Vec<Vec2>| -> Vec<Vec2> {
            let inside = &squares[..squares.len() / INSIDE];
            rim.into_iter().chain(inside.iter().copied()).collect()
        };
        let first = match squares.len() {
            0..=FEW => [Vec::new(), Vec::new()],
            len => {
                let side = if len > MANY { 4 } else { 3 };
                [
                    with_rim(pattern::rim(side)),
                    with_rim(pattern::circle(4 * side)),
                ]
            }
        };
        Self {
            squares,
            width,
            first,
        }
    }
}

impl Patterns {
    /// `per_light` shadow rays, rounded up to a power of four.
    pub(super) fn new(per_light: u32) -> Self {
        let finest = pattern::square(per_light);
        let coarser = (0..finest.len().ilog(4)).map(|power| pattern::square(1 << (2 * power)));
        Self {
            shadow: (coarser.chain([finest])).map(Pattern::new).collect(),
            unshadowed: Pattern::new(pattern::grid(UNSHADOWED_SIDE)),
        }
    }

    /// Of all shadow rays.
    pub(super) fn finest(&self) -> &Pattern {
        &self.shadow[self.shadow.len() - 1]
    }

    /// Shadow rays, so many to a light that is all there is.
    pub(super) fn rays(&self) -> usize {
        self.finest().squares.len()
    }

    /// As many of the shadow rays, or more, as go to a light that gives the `share`, 0…1, of what there is; four at least.
    #[expect(clippy::cast_precision_loss, reason = "a few hundred samples")]
    pub(super) fn of_share(&self, share: f64) -> &Pattern {
        let least = (self.rays() as f64 * share).max(FEWEST as f64);
        let enough = |pattern: &&Pattern| pattern.squares.len() as f64 >= least;
        self.shadow.iter().find(enough).unwrap_or(self.finest())
    }
}

impl AreaLight {
    /// `None` for domes, for particles and for lights that give nothing (a warning says why, except where they are simply black).
    pub(super) fn new(light: &Light, diagnostics: &Diagnostics) -> Option<Self> {
        let is_elsewhere = matches!(light.kind, LightKind::Dome { .. } | LightKind::Particles(_));
        if is_elsewhere || light.radiance == Vec3::ZERO {
            return None;
        }
        let warn = |message: &str| diagnostics.warn("degenerate-light", &light.path, message);
        if !light.radiance.is_finite() || !light.world_from_light.is_finite() {
            warn("intensity or transform is not finite: the light is left out");
            return None;
        }
        let Some(shape) = shape_of(light) else {
            warn("the light's transform or size has no area: it gives no light");
            return None;
        };
        let size = shape.size_factor();
        let radiance = match (light.normalize, &shape) {
            // a point's irradiance is radiance × a quarter of its area, which cancels
            (true, Shape::Point { .. }) => light.radiance,
            (true, _) => light.radiance / size,
            (false, _) => light.radiance,
        };
        let shape = match shape {
            Shape::Point { position, .. } if light.normalize => Shape::Point {
                position,
                area: 0.25,
            },
            other => other,
        };
        if size <= 0.0 && !light.normalize || !radiance.is_finite() {
            warn("the light's size is 0 and it is not treated as a point: it gives no light");
            return None;
        }
        let axis = light.world_from_light.transform_vector3(-Vec3::Z);
        let beacon = shape.ball().map(|(center, radius)| Beacon {
            center,
            radius,
            strength: radiance.element_sum() * shape.size_factor(),
        });
        Some(Self {
            beacon,
            shape,
            radiance,
            shaping: (light.shaping).map(|s| WorldShaping::new(s, axis.normalize_or_zero())),
            texture: texture_of(light, diagnostics),
            casts_shadows: light.casts_shadows,
        })
    }

    /// Irradiance, shadows included.
    pub(super) fn irradiance(&self, patterns: &Patterns, stand: &Stand<'_>) -> Vec3 {
        let unshadowed = self.open(patterns, stand.point);
        if unshadowed == Vec3::ZERO {
            return Vec3::ZERO;
        }
        unshadowed * self.visible_part(patterns.finest(), stand)
    }

    /// Share of the irradiance that arrives, a channel each.
    pub(super) fn visible_part(&self, pattern: &Pattern, stand: &Stand<'_>) -> Vec3 {
        if self.is_sharp() {
            Vec3::splat(self.visible_at(stand, Vec2::ZERO))
        } else {
            self.visible_fraction(pattern, stand)
        }
    }

    /// The way to the place on it that is numbered `turn`, or to the next from where it shines; `None` where there is none or the
    /// receiver's own surface hides it.
    pub(super) fn way(&self, pattern: &Pattern, stand: &Stand<'_>, turn: usize) -> Option<Way> {
        let square = self.shining(pattern, stand.point, turn)?;
        let sample = self.shape.sample(stand.point, square)?;
        stand.way(sample.position, sample.to_light)
    }

    /// The place numbered `turn`, or the next from where the light shines.
    fn shining(&self, pattern: &Pattern, point: &ShadePoint, turn: usize) -> Option<Vec2> {
        let squares = &pattern.squares;
        (0..squares.len())
            .map(|step| squares[(turn + step) % squares.len()])
            .find(|&square| {
                let sample = self.shape.sample(point, square);
                sample.is_some_and(|sample| self.factor(&sample, pattern.width) != Vec3::ZERO)
            })
    }

    /// False if nothing stands in its way.
    pub(super) fn casts_shadows(&self) -> bool {
        self.casts_shadows
    }

    /// Irradiance if all of the light were as visible as one place on it, the one numbered `turn`.
    pub(super) fn glance(&self, patterns: &Patterns, stand: &Stand<'_>, turn: usize) -> Vec3 {
        let unshadowed = self.open(patterns, stand.point);
        if unshadowed == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let square = self.shining(patterns.finest(), stand.point, turn);
        unshadowed * square.map_or(0.0, |square| self.visible_at(stand, square))
    }

    /// What a lobe reflects if all of the light were like one place on it, the one numbered `turn`: `brdf` (1/sr) tells how much
    /// of the light from a unit direction.
    pub(super) fn glint(
        &self,
        patterns: &Patterns,
        stand: &Stand<'_>,
        turn: usize,
        brdf: &dyn Fn(Vec3) -> Vec3,
    ) -> Vec3 {
        let Pattern { squares, width, .. } = patterns.finest();
        let square = squares[turn % squares.len()];
        let Some(sample) = self.shape.sample(stand.point, square) else {
            return Vec3::ZERO;
        };
        let irradiance = self.radiance * self.factor(&sample, *width);
        let reflected = brdf(sample.to_light) * irradiance * sample.weight;
        if reflected == Vec3::ZERO {
            return Vec3::ZERO;
        }
        reflected * self.visible(&sample, stand)
    }

    /// Irradiance if nothing were in the way.
    pub(super) fn open(&self, patterns: &Patterns, point: &ShadePoint) -> Vec3 {
        self.unshadowed(patterns, point) * self.radiance
    }

    /// `None` if it is infinitely far.
    pub(super) fn beacon(&self) -> Option<Beacon> {
        self.beacon
    }

    /// Distance to this light along the unit `direction`; `None` where it is not met.
    pub(super) fn distance(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let meeting = self.shape.meet(origin, direction)?;
        Some(meeting.distance)
    }

    /// Distance to this light along the unit `direction` and radiance from there; `None` where it is not met.
    pub(super) fn seen(&self, origin: Vec3, direction: Vec3) -> Option<(f32, Vec3)> {
        let meeting = self.shape.meet(origin, direction)?;
        let sample = LightSample {
            to_light: direction,
            position: Some(origin + direction * meeting.distance),
            local: meeting.local,
            weight: 0.0,
        };
        Some((meeting.distance, self.radiance * self.factor(&sample, 0.0)))
    }

    /// Without extent.
    fn is_sharp(&self) -> bool {
        matches!(self.shape, Shape::Point { .. } | Shape::Parallel { .. })
    }

    /// How much of the place `square` of the light is visible, 0…1.
    fn visible_at(&self, stand: &Stand<'_>, square: Vec2) -> f32 {
        let sample = self.shape.sample(stand.point, square);
        sample.map_or(0.0, |sample| self.visible(&sample, stand))
    }

    /// Unit direction to it if it has one only: there is no texture on it, and it is small as seen from `point`.
    fn far_direction(&self, point: &ShadePoint) -> Option<Vec3> {
        let ball = self.beacon.filter(|_| self.texture.is_none())?;
        let way = ball.center - point.position;
        is_far(ball.radius, way).then(|| way.normalize_or_zero())
    }

    /// For radiance 1: the closed form, or the mean of many samples; with shaping and texture.
    fn unshadowed(&self, patterns: &Patterns, point: &ShadePoint) -> Vec3 {
        let closed = self.shape.irradiance(point);
        if let (Some(irradiance), Some(shaping)) = (closed, self.shaping)
            && let Some(to_light) = self.far_direction(point)
        {
            return shaping.factor(-to_light) * irradiance;
        }
        let is_plain = self.shaping.is_none() && self.texture.is_none();
        match closed {
            Some(irradiance) if is_plain || irradiance <= 0.0 => Vec3::splat(irradiance),
            Some(irradiance) if self.is_sharp() => {
                let sample = self.shape.sample(point, Vec2::ZERO);
                sample.map_or(Vec3::ZERO, |s| self.factor(&s, 0.0)) * irradiance
            }
            _ => {
                let (mut plain, mut colored) = (0.0, Vec3::ZERO);
                let Pattern { squares, width, .. } = &patterns.unshadowed;
                for &square in squares {
                    if let Some(sample) = self.shape.sample(point, square) {
                        plain += sample.weight;
                        colored += sample.weight * self.factor(&sample, *width);
                    }
                }
                #[expect(clippy::cast_precision_loss, reason = "a few hundred samples")]
                let total = squares.len() as f32;
                match closed {
                    Some(irradiance) if plain > 0.0 => colored * (irradiance / plain),
                    _ => colored / total,
                }
            }
        }
    }

    /// Share of the irradiance that arrives, a channel each; told by few rays if these agree.
    fn visible_fraction(&self, pattern: &Pattern, stand: &Stand<'_>) -> Vec3 {
        let (squares, width) = (&pattern.squares, pattern.width);
        let first = &pattern.first[usize::from(self.shape.is_round())];
        let quarter = squares.len().div_ceil(4).max(FEWEST).min(squares.len());
        let (first, rest) = if first.is_empty() {
            squares.split_at(quarter)
        } else {
            (&first[..], &squares[..])
        };
        let mut arrival = Arrival::default();
        for some in first.chunks(TOGETHER) {
            arrival += self.arrival(some, width, stand);
            if !arrival.is_unanimous() {
                break;
            }
        }
        if arrival.open != Vec3::ZERO && arrival.is_unanimous() {
            return arrival.share();
        }
        // Places along the rim stand for no part of the light.
        if rest.len() == squares.len() {
            arrival = Arrival::default();
        }
        for some in rest.chunks(TOGETHER) {
            arrival += self.arrival(some, width, stand);
        }
        arrival.share()
    }

    /// What comes from the places `some`, at most [`TOGETHER`], of the light.
    fn arrival(&self, some: &[Vec2], width: f32, stand: &Stand<'_>) -> Arrival {
        let (mut weights, mut ways) = ([Vec3::ZERO; TOGETHER], [Way::NONE; TOGETHER]);
        let mut count = 0;
        let mut arrival = Arrival::default();
        for &square in some {
            let Some(sample) = self.shape.sample(stand.point, square) else {
                continue;
            };
            let weight = sample.weight * self.factor(&sample, width);
            arrival.open += weight;
            let way = (weight != Vec3::ZERO)
                .then(|| stand.way(sample.position, sample.to_light))
                .flatten();
            if let Some(way) = way {
                (weights[count], ways[count]) = (weight, way);
                count += 1;
            }
        }
        if !self.casts_shadows {
            arrival.lit = weights.iter().sum();
            return arrival;
        }
        let open = stand.tracer.transmittances(&ways[..count]);
        let lit = weights.iter().zip(open);
        arrival.lit = lit.map(|(&weight, open)| weight * open).sum();
        arrival
    }

    /// How much of the light from there arrives, 0…1.
    fn visible(&self, sample: &LightSample, stand: &Stand<'_>) -> f32 {
        if !self.casts_shadows {
            return f32::from(u8::from(stand.start(sample.to_light).is_some()));
        }
        match sample.position {
            None => stand.sees_sky(sample.to_light),
            Some(position) => stand.sees(position, sample.to_light),
        }
    }

    /// Of shaping and texture, this averaged over a square of side `width` (1 = the whole light).
    fn factor(&self, sample: &LightSample, width: f32) -> Vec3 {
        let shaping = self
            .shaping
            .map_or(Vec3::ONE, |s| s.factor(-sample.to_light));
        let texture =
            (self.texture.as_ref()).map_or(Vec3::ONE, |texture| texture.color(sample.local, width));
        shaping * texture
    }
}

/// Light from some places, for radiance 1: if nothing were in the way, and as it is.
#[derive(Debug, Clone, Copy, Default)]
struct Arrival {
    open: Vec3,
    lit: Vec3,
}

impl Arrival {
    /// All of it or nothing.
    fn is_unanimous(self) -> bool {
        self.lit == Vec3::ZERO || self.lit == self.open
    }

    /// What arrives of what would, a channel each.
    fn share(self) -> Vec3 {
        let share = |lit: f32, open: f32| if open > 0.0 { lit / open } else { 0.0 };
        Vec3::from_array([0, 1, 2].map(|k| share(self.lit[k], self.open[k])))
    }
}

impl AddAssign for Arrival {
    fn add_assign(&mut self, other: Self) {
        self.open += other.open;
        self.lit += other.lit;
    }
}

/// `None` if it has no extent where it should.
fn shape_of(light: &Light) -> Option<Shape> {
    let transform = &light.world_from_light;
    let scaled = |scale: Vec3| Ellipsoid::new(*transform * Affine3A::from_scale(scale));
    match &light.kind {
        LightKind::Dome { .. } | LightKind::Particles(_) => None,
        LightKind::Distant { angle } => {
            let to_light = transform.transform_vector3(Vec3::Z).try_normalize()?;
            let half_angle = (0.5 * angle).clamp(0.0, std::f32::consts::PI);
            Some(if half_angle > 0.0 {
                Shape::Sky {
                    to_light,
                    half_angle,
                }
            } else {
                Shape::Parallel { to_light }
            })
        }
        LightKind::Sphere {
            radius,
            treat_as_point,
        } => {
            let is_point = *treat_as_point || *radius <= 0.0;
            if is_point {
                // the mean projected area of a convex body is a quarter of its area (Cauchy)
                let area = scaled(Vec3::splat(*radius)).map_or(0.0, |body| 0.25 * body.area());
                let position = transform.transform_point3(Vec3::ZERO);
                return Some(Shape::Point { position, area });
            }
            scaled(Vec3::splat(*radius)).map(Shape::Ellipsoid)
        }
        LightKind::Rect { width, height, .. } => with_area(Shape::plane(
            transform,
            0.5 * Vec2::new(*width, *height),
            false,
        )),
        LightKind::Disk { radius } => {
            with_area(Shape::plane(transform, Vec2::splat(*radius), true))
        }
        LightKind::Cylinder { radius, length } => {
            let body = scaled(Vec3::splat(*radius))?;
            let half_length = 0.5 * length / radius;
            with_area(Shape::Tube { body, half_length })
        }
    }
}

fn with_area(shape: Shape) -> Option<Shape> {
    (shape.size_factor() > 0.0).then_some(shape)
}

fn texture_of(light: &Light, diagnostics: &Diagnostics) -> Option<Picture> {
    let LightKind::Rect {
        texture: Some(path),
        ..
    } = &light.kind
    else {
        return None;
    };
    Picture::load(path, &light.path, diagnostics)
}
