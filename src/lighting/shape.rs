//! Light shapes in world space: unshadowed irradiance in closed form where there is one, and samples that carry their
//! share of it.

mod meet;

use super::ShadePoint;
use super::form_factor::{cap_irradiance, outline_irradiance};
use super::pattern;
use crate::math::Frame;
use glam::{Affine3A, DVec3, Mat3, Mat3A, Vec2, Vec3, Vec3A};
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Sides of the polygon that stands in for a disk; of equal area, which leaves 1e-4 of its irradiance as error.
const DISK_SIDES: u16 = 64;
/// Scales along the axes that differ by less than this part make a sphere, not an ellipsoid.
const SPHERE_TOLERANCE: f32 = 1e-4;

/// What a light looks like from outside. Radiance is that of the surface, except where noted.
#[derive(Debug)]
pub(super) enum Shape {
    /// No extent: irradiance is radiance times `area` over the squared distance.
    Point { position: Vec3, area: f32 },
    /// Irradiance is radiance, from one direction.
    Parallel { to_light: Vec3 },
    /// A round patch of the sky.
    Sky { to_light: Vec3, half_angle: f32 },
    /// A rectangle or ellipse.
    Plane(Plane),
    /// The image of the unit sphere.
    Ellipsoid(Ellipsoid),
    /// The image of the unit circle in YZ along X in ±`half_length`.
    Tube { body: Ellipsoid, half_length: f32 },
}

#[derive(Debug)]
pub(super) struct Plane {
    center: Vec3,
    /// From the center to the middle of the sides along local X and Y (or semi-axes).
    half: [Vec3; 2],
    is_disk: bool,
    /// Unit, towards the lit side.
    normal: Vec3,
    area: f32,
    /// Of a ball around it.
    radius: f32,
    /// Counter-clockwise as seen from the lit side.
    outline: Vec<DVec3>,
}

/// The image of a unit sphere (or, as a [`Shape::Tube`], of a cylinder of radius 1).
#[derive(Debug)]
pub(super) struct Ellipsoid {
    world_from_unit: Affine3A,
    unit_from_world: Affine3A,
    /// Takes unit normals to outward normals as long as the area ratio.
    area_from_normal: Mat3A,
    /// World radius if it is a sphere.
    radius: Option<f32>,
}

/// A direction to a light.
#[derive(Debug, Clone, Copy)]
pub(super) struct LightSample {
    /// Unit.
    pub(super) to_light: Vec3,
    /// Where the light is; `None` = infinitely far.
    pub(super) position: Option<Vec3>,
    /// Place on a rectangle, −1…1 along its X and Y.
    pub(super) local: Vec2,
    /// Irradiance for radiance 1 if the light were all like this sample: the mean over a pattern is the irradiance.
    pub(super) weight: f32,
}

impl Shape {
    /// Center and radius of a ball around it; `None` if it is infinitely far.
    pub(super) fn ball(&self) -> Option<(Vec3, f32)> {
        let around = |body: &Ellipsoid, lengths: Vec3| {
            let axes = Mat3::from(body.world_from_unit.matrix3);
            let sides = [axes.x_axis, axes.y_axis, axes.z_axis].map(Vec3::length);
            let center = body.world_from_unit.transform_point3(Vec3::ZERO);
            (center, (Vec3::from_array(sides) * lengths).length())
        };
        match self {
            Self::Parallel { .. } | Self::Sky { .. } => None,
            Self::Point { position, .. } => Some((*position, 0.0)),
            Self::Plane(plane) => Some((plane.center, plane.radius)),
            Self::Ellipsoid(body) => Some(around(body, Vec3::ONE)),
            Self::Tube { body, half_length } => {
                Some(around(body, Vec3::new(*half_length, 1.0, 1.0)))
            }
        }
    }

    /// A plane light; `half` as in [`Plane`], lit towards `facing`.
    pub(super) fn plane(world_from_light: &Affine3A, half: Vec2, is_disk: bool) -> Self {
        let axis = |v: Vec3| world_from_light.transform_vector3(v);
        let halves = [axis(Vec3::X * half.x), axis(Vec3::Y * half.y)];
        let cross = halves[0].as_dvec3().cross(halves[1].as_dvec3());
        let facing = axis(-Vec3::Z).as_dvec3();
        let front = if cross.dot(facing) > 0.0 {
            cross
        } else {
            -cross
        };
        let share = if is_disk { PI } else { 4.0 };
        let center = world_from_light.transform_point3(Vec3::ZERO);
        #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
        let area = cross.length() as f32 * share;
        let mut outline = outline_of(center.as_dvec3(), halves.map(Vec3::as_dvec3), is_disk);
        if cross.dot(facing) <= 0.0 {
            outline.reverse();
        }
        Self::Plane(Plane {
            center,
            half: halves,
            is_disk,
            normal: front.normalize_or_zero().as_vec3(),
            area,
            radius: halves[0].length() + halves[1].length(),
            outline,
        })
    }

    /// World area (for `normalize`); of sky patches the measure that UsdLux documents; 1 for sources without extent.
    pub(super) fn size_factor(&self) -> f32 {
        match self {
            Self::Point { area, .. } => 4.0 * area,
            Self::Parallel { .. } => 1.0,
            Self::Sky { half_angle, .. } => {
                let squared = half_angle.sin().powi(2);
                PI * if *half_angle > FRAC_PI_2 {
                    2.0 - squared
                } else {
                    squared
                }
            }
            Self::Plane(plane) => plane.area,
            Self::Ellipsoid(ellipsoid) => ellipsoid.area(),
            Self::Tube { body, half_length } => body.tube_area(*half_length),
        }
    }

    /// Irradiance for radiance 1 without shadows, if there is a closed form (and always for sources without extent).
    pub(super) fn irradiance(&self, point: &ShadePoint) -> Option<f32> {
        let normal = point.normal.as_dvec3();
        #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
        match self {
            Self::Point { .. } | Self::Parallel { .. } => {
                Some(self.sample(point, Vec2::ZERO).map_or(0.0, |s| s.weight))
            }
            Self::Sky {
                to_light,
                half_angle,
            } => (*half_angle <= FRAC_PI_2).then(|| {
                let sine = f64::from(*half_angle).sin();
                cap_irradiance(to_light.as_dvec3().dot(normal), sine) as f32
            }),
            Self::Plane(plane) => Some(plane.irradiance(point)),
            Self::Ellipsoid(ellipsoid) => {
                let Some(radius) = ellipsoid.radius.map(f64::from) else {
                    return self.far_irradiance(point);
                };
                let center = Vec3::from(ellipsoid.world_from_unit.translation);
                let offset = (center - point.position).as_dvec3();
                let distance = offset.length();
                Some(if distance > radius {
                    cap_irradiance(offset.dot(normal) / distance, radius / distance) as f32
                } else {
                    0.0
                })
            }
            Self::Tube { .. } => self.far_irradiance(point),
        }
    }

    /// Irradiance of radiance 1 from an ellipsoid or a tube that is far and wholly above the horizon, by the area that it shows.
    fn far_irradiance(&self, point: &ShadePoint) -> Option<f32> {
        let (center, radius) = self.ball()?;
        let way = center - point.position;
        if !(is_far(radius, way) && point.normal.dot(way) > radius) {
            return None;
        }
        let (to_light, squared) = direction_to(center, point)?;
        let shown = match self {
            Self::Ellipsoid(body) => body.shown(to_light),
            Self::Tube { body, half_length } => body.shown_of_tube(*half_length, -way),
            _ => return None,
        };
        Some(shown * point.normal.dot(to_light) / squared)
    }

    /// True if the first coordinate of the squares that [`Self::sample`] takes leads from the middle to the rim, and not from side to
    /// side.
    pub(super) fn is_round(&self) -> bool {
        match self {
            Self::Plane(plane) => plane.is_disk,
            Self::Ellipsoid(_) | Self::Sky { .. } => true,
            Self::Point { .. } | Self::Parallel { .. } | Self::Tube { .. } => false,
        }
    }

    /// The sample at `square` (in the unit square); `None` where the light does not shine towards the point.
    pub(super) fn sample(&self, point: &ShadePoint, square: Vec2) -> Option<LightSample> {
        match self {
            Self::Point { position, area } => {
                let (to_light, squared) = direction_to(*position, point)?;
                let weight = point.normal.dot(to_light) * area / squared;
                LightSample::new(to_light, Some(*position), weight)
            }
            Self::Parallel { to_light } => {
                LightSample::new(*to_light, None, point.normal.dot(*to_light))
            }
            Self::Sky {
                to_light,
                half_angle,
            } => {
                let height = 2.0 * (0.5 * half_angle).sin().powi(2);
                let cosine = 1.0 - square.x * height;
                // from the height, as 1 − cosine² cancels for a small sun
                let sine = (square.x * height * (1.0 + cosine)).max(0.0).sqrt();
                let around = Vec2::from_angle(TAU * square.y) * sine;
                let direction = Frame::about(*to_light).to_world(around.extend(cosine));
                let weight = point.normal.dot(direction) * TAU * height;
                LightSample::new(direction, None, weight)
            }
            Self::Plane(plane) => plane.sample(point, square),
            Self::Ellipsoid(ellipsoid) => ellipsoid.sample(point, square),
            Self::Tube { body, half_length } => body.sample_tube(point, square, *half_length),
        }
    }
}

impl LightSample {
    fn new(to_light: Vec3, position: Option<Vec3>, weight: f32) -> Option<Self> {
        (weight > 0.0).then_some(Self {
            to_light,
            position,
            local: Vec2::ZERO,
            weight,
        })
    }

    /// From a place on a surface whose outward normal times area is `area`.
    fn on_surface(position: Vec3, area: Vec3, point: &ShadePoint) -> Option<Self> {
        let (to_light, squared) = direction_to(position, point)?;
        let leaving = (-area.dot(to_light)).max(0.0);
        let weight = point.normal.dot(to_light).max(0.0) * leaving / squared;
        Self::new(to_light, Some(position), weight)
    }
}

/// Square of the ball around a light over that of the way there from which on the light counts as one place with the area that it
/// shows: true to about as much.
const FAR: f32 = 1e-4;

/// True if a ball of `radius` at the end of `way` is small.
pub(super) fn is_far(radius: f32, way: Vec3) -> bool {
    radius * radius <= FAR * way.length_squared()
}

/// Unit direction and squared distance.
fn direction_to(position: Vec3, point: &ShadePoint) -> Option<(Vec3, f32)> {
    let offset = position - point.position;
    Some((offset.try_normalize()?, offset.length_squared()))
}

fn outline_of(center: DVec3, half: [DVec3; 2], is_disk: bool) -> Vec<DVec3> {
    if !is_disk {
        return [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(x, y)| center + half[0] * x + half[1] * y)
            .to_vec();
    }
    let step = std::f64::consts::TAU / f64::from(DISK_SIDES);
    let equal_area = (step / step.sin()).sqrt();
    (0..DISK_SIDES)
        .map(|i| {
            let (sine, cosine) = (f64::from(i) * step).sin_cos();
            center + (half[0] * cosine + half[1] * sine) * equal_area
        })
        .collect()
}

impl Plane {
    #[expect(clippy::cast_possible_truncation, reason = "f64 to f32")]
    fn irradiance(&self, point: &ShadePoint) -> f32 {
        let way = self.center - point.position;
        let is_above = point.normal.dot(way) > self.radius;
        if is_above && is_far(self.radius, way) {
            let sample = LightSample::on_surface(self.center, self.normal * self.area, point);
            return sample.map_or(0.0, |sample| sample.weight);
        }
        if self.normal.dot(point.position - self.center) <= 0.0 {
            return 0.0;
        }
        let origin = point.position.as_dvec3();
        let corners = self.outline.iter();
        let edges = (corners.clone().zip(corners.cycle().skip(1)))
            .map(|(from, to)| (*from - origin, *to - origin));
        outline_irradiance(edges, self.normal.as_dvec3(), point.normal.as_dvec3()) as f32
    }

    fn sample(&self, point: &ShadePoint, square: Vec2) -> Option<LightSample> {
        let local = if self.is_disk {
            pattern::disk(square)
        } else {
            2.0 * square - 1.0
        };
        let position = self.center + self.half[0] * local.x + self.half[1] * local.y;
        let sample = LightSample::on_surface(position, self.normal * self.area, point)?;
        Some(LightSample { local, ..sample })
    }
}

impl Ellipsoid {
    /// Area that is seen from far along the unit `direction`.
    fn shown(&self, direction: Vec3) -> f32 {
        let unit = self.unit_from_world.transform_vector3(direction).length();
        PI * self.world_from_unit.matrix3.determinant().abs() * unit
    }

    /// The same of the tube of radius 1 along X, from the end of `way`, which leads from its middle. It has no ends, so that what
    /// stands out behind the nearer one, as seen from infinitely far, is less by what that end would hide from there.
    fn shown_of_tube(&self, half_length: f32, way: Vec3) -> f32 {
        let along = self.unit_from_world.transform_vector3(way);
        // The middle of the side that is seen, a quarter of a turn away.
        let side = Vec3::new(0.0, -along.z, along.y).normalize_or_zero();
        let to_nearer = half_length.copysign(along.x);
        let of = |v: Vec3| self.world_from_unit.transform_vector3(v);
        let (axis, squared) = (of(Vec3::X * to_nearer), way.length_squared());
        let end = PI * of(Vec3::Y).cross(of(Vec3::Z));
        let end = if end.dot(axis) < 0.0 { -end } else { end };
        let shown = |way: Vec3| end.dot(way) / way.length().powi(3);
        let length = squared.sqrt();
        4.0 * way.dot(axis.cross(of(side))).abs() / length
            + (shown(way) - shown(way - axis)) * squared
    }

    /// `None` if the transform cannot be inverted.
    pub(super) fn new(world_from_unit: Affine3A) -> Option<Self> {
        let unit_from_world = world_from_unit.inverse();
        if !unit_from_world.is_finite() {
            return None;
        }
        let matrix = world_from_unit.matrix3;
        let scales = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(Vec3A::length);
        let skew = (matrix.x_axis.dot(matrix.y_axis).abs())
            .max(matrix.y_axis.dot(matrix.z_axis).abs())
            .max(matrix.z_axis.dot(matrix.x_axis).abs());
        let mean = (scales[0] + scales[1] + scales[2]) / 3.0;
        let is_sphere = skew <= SPHERE_TOLERANCE * mean * mean
            && scales
                .iter()
                .all(|s| (s - mean).abs() <= SPHERE_TOLERANCE * mean);
        Some(Self {
            world_from_unit,
            unit_from_world,
            area_from_normal: unit_from_world.matrix3.transpose() * matrix.determinant().abs(),
            radius: is_sphere.then_some(mean),
        })
    }

    /// World area of the image of the unit sphere.
    pub(super) fn area(&self) -> f32 {
        self.radius.map_or_else(
            || 4.0 * PI * self.mean_area(&pattern::sphere(4096)),
            |radius| 4.0 * PI * radius * radius,
        )
    }

    fn tube_area(&self, half_length: f32) -> f32 {
        let circle: Vec<Vec3> = (0..1024_u16)
            .map(|i| Vec2::from_angle(TAU * f32::from(i) / 1024.0))
            .map(|p| Vec3::new(0.0, p.x, p.y))
            .collect();
        TAU * 2.0 * half_length * self.mean_area(&circle)
    }

    #[expect(clippy::cast_precision_loss, reason = "a few thousand normals")]
    fn mean_area(&self, normals: &[Vec3]) -> f32 {
        let total: f32 = (normals.iter())
            .map(|&n| (self.area_from_normal * Vec3A::from(n)).length())
            .sum();
        total / normals.len() as f32
    }

    /// Uniform in area over the part of the unit sphere that sees the point.
    fn sample(&self, point: &ShadePoint, square: Vec2) -> Option<LightSample> {
        let from = self.unit_from_world.transform_point3(point.position);
        let distance = from.length();
        if distance <= 1.0 || !distance.is_finite() {
            return None;
        }
        let height = (distance - 1.0) / distance;
        let cosine = 1.0 - square.x * height;
        let sine = (square.x * height * (1.0 + cosine)).max(0.0).sqrt();
        let around = Vec2::from_angle(TAU * square.y) * sine;
        let unit = Frame::about(from / distance).to_world(around.extend(cosine));
        let area = self.area_from_normal * Vec3A::from(unit) * (TAU * height);
        let position = self.world_from_unit.transform_point3(unit);
        LightSample::on_surface(position, area.into(), point)
    }

    /// Uniform in angle over the part of the circle that sees the point, and in the angle along the axis under which
    /// the nearest line of the tube is seen.
    fn sample_tube(
        &self,
        point: &ShadePoint,
        square: Vec2,
        half_length: f32,
    ) -> Option<LightSample> {
        let from = self.unit_from_world.transform_point3(point.position);
        let radial = Vec2::new(from.y, from.z);
        let distance = radial.length();
        if distance <= 1.0 || !distance.is_finite() {
            return None;
        }
        let half_arc = (1.0 / distance).acos();
        let around = Vec2::from_angle((2.0 * square.x - 1.0) * half_arc).rotate(radial / distance);
        let nearest = distance - 1.0;
        let ends = [-half_length, half_length].map(|end| ((end - from.x) / nearest).atan());
        let angle = ends[0] + (ends[1] - ends[0]) * square.y;
        let along = nearest * angle.tan();
        let stretch = (ends[1] - ends[0]) * nearest * (1.0 + (along / nearest).powi(2));
        let normal = Vec3A::new(0.0, around.x, around.y);
        let area = self.area_from_normal * normal * (2.0 * half_arc * stretch);
        let unit = Vec3::new(from.x + along, around.x, around.y);
        let position = self.world_from_unit.transform_point3(unit);
        LightSample::on_surface(position, area.into(), point)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{EulerRot, Quat};

    #[test]
    fn from_far_shapes_give_what_their_places_do() {
        let turn = Quat::from_euler(EulerRot::XYZ, 0.4, 0.7, -0.3);
        let stretched =
            |scale: Vec3| Affine3A::from_scale_rotation_translation(scale, turn, Vec3::Y);
        let body = |scale| Ellipsoid::new(stretched(scale)).unwrap();
        let half_length = 3.0;
        let shapes = [
            Shape::plane(&stretched(Vec3::ONE), Vec2::new(1.0, 0.5), false),
            Shape::plane(&stretched(Vec3::ONE), Vec2::new(1.0, 0.5), true),
            Shape::Ellipsoid(body(Vec3::new(1.0, 0.5, 2.0))),
            Shape::Tube {
                body: body(Vec3::new(1.0, 0.5, 0.5)),
                half_length,
            },
        ];
        let places = pattern::grid(64);
        for (number, shape) in shapes.iter().enumerate() {
            let (center, radius) = shape.ball().unwrap();
            for toward in [
                Vec3::NEG_Z,
                Vec3::new(0.4, 0.3, -1.0),
                Vec3::new(-0.5, 0.2, -0.6),
            ] {
                let mut values = [0.0; 2];
                for (value, times) in values.iter_mut().zip([99.0, 101.0]) {
                    let position = center + turn * toward.normalize() * radius * times;
                    let normal = ((center - position).normalize() + 0.5 * Vec3::X).normalize();
                    let point = ShadePoint {
                        position,
                        normal,
                        geometric_normal: normal,
                        smooth_offset: None,
                        prim: None,
                    };
                    let weight =
                        |&square: &Vec2| shape.sample(&point, square).map_or(0.0, |s| s.weight);
                    let sampled = places.iter().map(weight).sum::<f32>() / 4096.0;
                    let told = shape.irradiance(&point);
                    assert!(times > 100.0 || number < 2 || told.is_none());
                    let told = told.unwrap_or(sampled);
                    assert!(
                        told > 0.0 && (told / sampled - 1.0).abs() < 4e-4,
                        "{number} {told} {sampled}"
                    );
                    *value = told * times * times;
                }
                let [near, far] = values;
                assert!((near / far - 1.0).abs() < 4e-4, "{number} {near} {far}");
            }
        }
    }
}
