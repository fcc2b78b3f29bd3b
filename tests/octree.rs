//! Octree and the paper's gather against scenes made by code: analytic rectangles and spheres, ray traced here.

use glam::{DVec3, Quat, Vec3};
use std::fmt;
use std::f32::consts::{PI, TAU};
use surflux::gather::paper::{PaperEngine, PaperSettings};
use surflux::gather::{Engine, Hemisphere};
use surflux::math::Frame;
use surflux::octree::Octree;
use surflux::receivers::Receivers;
use surflux::results::Target;
use surflux::scene::PrimId;
use surflux::shading::SurfacePoint;
use surflux::surfels::SurfelCloud;

/// An analytic one-sided surface.
#[derive(Clone, Copy)]
enum Shape {
    /// Corner and edges; faces u × v.
    Rectangle(Vec3, Vec3, Vec3),
    /// Center and radius; faces outwards.
    Sphere(Vec3, f32),
}

/// A surface and its radiosity.
#[derive(Clone, Copy)]
struct Surface {
    shape: Shape,
    radiosity: fn(Vec3) -> f32,
}

#[derive(Clone, Copy)]
struct Place {
    position: Vec3,
    normal: Vec3,
}

impl Shape {
    fn area(self) -> f32 {
        match self {
            Self::Rectangle(_, u, v) => u.cross(v).length(),
            Self::Sphere(_, r) => 4.0 * PI * r * r,
        }
    }

    /// Distance along the ray to the front side.
    fn hit(self, origin: Vec3, direction: Vec3) -> Option<f32> {
        match self {
            Self::Rectangle(corner, u, v) => {
                let normal = u.cross(v).normalize();
                let cos = normal.dot(direction);
                if cos >= 0.0 {
                    return None;
                }
                let t = normal.dot(corner - origin) / cos;
                let local = origin + direction * t - corner;
                let (a, b) = (
                    local.dot(u) / u.length_squared(),
                    local.dot(v) / v.length_squared(),
                );
                (t > 0.0 && (0.0..=1.0).contains(&a) && (0.0..=1.0).contains(&b)).then_some(t)
            }
            Self::Sphere(center, r) => {
                let to_center = center - origin;
                let along = to_center.dot(direction);
                let miss = to_center - direction * along;
                let half_chord = r * r - miss.length_squared();
                let outside = to_center.length_squared() > r * r * 1.000_001;
                (outside && along > 0.0 && half_chord > 0.0).then(|| along - half_chord.sqrt())
            }
        }
    }

    /// Places that share the surface equally, `square` of them at most as wide as `spacing`, with area and footprint.
    fn dice(self, spacing: f32) -> Vec<(Place, f32, f32)> {
        match self {
            Self::Rectangle(corner, u, v) => {
                let [m, n] = [u, v].map(|edge| (edge.length() / spacing).ceil().max(1.0) as usize);
                let (du, dv) = (u / m as f32, v / n as f32);
                let normal = u.cross(v).normalize();
                let (area, radius) = (
                    du.length() * dv.length(),
                    0.5 * du.length().hypot(dv.length()),
                );
                let cell =
                    |i: usize| corner + du * ((i % m) as f32 + 0.5) + dv * ((i / m) as f32 + 0.5);
                let place = |i| Place {
                    position: cell(i),
                    normal,
                };
                (0..m * n).map(|i| (place(i), area, radius)).collect()
            }
            Self::Sphere(center, r) => {
                let rows = (PI * r / spacing).ceil().max(4.0) as usize;
                let mut cells = Vec::new();
                for row in 0..rows {
                    let [top, middle, bottom] =
                        [0.0, 0.5, 1.0].map(|part| PI * (row as f32 + part) / rows as f32);
                    let columns = (TAU * r * middle.sin() / spacing).ceil().max(3.0) as usize;
                    let area = TAU * r * r * (top.cos() - bottom.cos()) / columns as f32;
                    let width = TAU * r * middle.sin() / columns as f32;
                    let radius = 0.55 * width.hypot(PI * r / rows as f32);
                    for column in 0..columns {
                        let (sin, cos) = (TAU * (column as f32 + 0.5) / columns as f32).sin_cos();
                        let normal =
                            Vec3::new(middle.sin() * cos, middle.sin() * sin, middle.cos());
                        let position = center + normal * r;
                        cells.push((Place { position, normal }, area, radius));
                    }
                }
                cells
            }
        }
    }

    /// The place at (a, b) of the unit square, uniform in area.
    fn place(self, a: f32, b: f32) -> Place {
        match self {
            Self::Rectangle(corner, u, v) => Place {
                position: corner + u * a + v * b,
                normal: u.cross(v).normalize(),
            },
            Self::Sphere(center, r) => {
                let z = 1.0 - 2.0 * a;
                let (sin, cos) = (TAU * b).sin_cos();
                let s = (1.0 - z * z).sqrt();
                let normal = Vec3::new(s * cos, s * sin, z);
                Place {
                    position: center + normal * r,
                    normal,
                }
            }
        }
    }
}

/// The cloud of `surfaces`, about `count` surfels.
fn cloud(surfaces: &[Surface], count: usize) -> SurfelCloud {
    let area: f32 = surfaces.iter().map(|surface| surface.shape.area()).sum();
    let spacing = (area / count as f32).sqrt();
    let mut cloud = SurfelCloud {
        spacing,
        ..SurfelCloud::default()
    };
    for surface in surfaces {
        for (place, area, radius) in surface.shape.dice(spacing) {
            push(
                &mut cloud,
                place,
                (area, radius),
                (surface.radiosity)(place.position),
            );
        }
    }
    cloud
}

fn push(cloud: &mut SurfelCloud, place: Place, (area, radius): (f32, f32), radiosity: f32) {
    cloud.position.push(place.position);
    cloud.normal.push(place.normal);
    cloud.radius.push(radius);
    cloud.area.push(area);
    cloud.radiosity.push(Vec3::splat(radiosity));
    cloud.albedo.push(Vec3::splat(0.5));
    cloud.emission.push(Vec3::ZERO);
    cloud.prim.push(0);
}

fn receivers(places: &[Place]) -> Receivers {
    let surface = SurfacePoint {
        prim: PrimId(0),
        triangle: 0,
        u: 0.0,
        v: 0.0,
        footprint: 0.0,
    };
    Receivers {
        origin: DVec3::ZERO,
        position: places.iter().map(|place| place.position).collect(),
        normal: places.iter().map(|place| place.normal).collect(),
        geometric_normal: places.iter().map(|place| place.normal).collect(),
        prim: vec![0; places.len()],
        surface: vec![surface; places.len()],
        depth: Vec::new(),
        target: Target::Surfels,
    }
}

/// Visibility (0…1) and irradiance.
type Seen = (f64, f64);

/// By 128² stratified cosine-distributed rays: 0.1 to 0.2 % noise.
fn ray_traced(surfaces: &[Surface], place: Place) -> Seen {
    const SIDE: usize = 128;
    let frame = Frame::about(place.normal);
    let (mut visible, mut radiosity) = (0_usize, 0.0);
    for i in 0..SIDE * SIDE {
        let (a, b) = (
            ((i / SIDE) as f32 + hash(2 * i)) / SIDE as f32,
            ((i % SIDE) as f32 + hash(2 * i + 1)) / SIDE as f32,
        );
        let (sin, cos) = (TAU * b).sin_cos();
        let direction = frame.to_world(Vec3::new(a.sqrt() * cos, a.sqrt() * sin, (1.0 - a).sqrt()));
        let origin = place.position + place.normal * 1e-5;
        let hits = surfaces
            .iter()
            .filter_map(|s| s.shape.hit(origin, direction).map(|t| (t, s)));
        match hits.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((t, surface)) => {
                radiosity += f64::from((surface.radiosity)(origin + direction * t))
            }
            None => visible += 1,
        }
    }
    let count = (SIDE * SIDE) as f64;
    (visible as f64 / count, radiosity / count)
}

/// A number in 0…1 for each `i`.
fn hash(i: usize) -> f32 {
    let mut x = (i as u64).wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 40) as f32 / (1_u64 << 24) as f32
}

fn gathered(octree: &Octree, places: &[Place], settings: PaperSettings) -> Vec<Seen> {
    let engine = PaperEngine::new(octree, settings);
    let mut seen = Vec::new();
    let mut scratch = Hemisphere::default();
    engine.see(
        &receivers(places),
        0..places.len(),
        &mut scratch,
        &mut |_, hemisphere| {
            let (mut covered, mut irradiance) = (0.0, 0.0);
            for i in 0..hemisphere.weight.len() {
                covered += f64::from(hemisphere.weight[i] * hemisphere.coverage[i]);
                irradiance += f64::from(hemisphere.weight[i] * hemisphere.reflected[i].x);
            }
            seen.push((1.0 - covered / std::f64::consts::PI, irradiance));
        },
    );
    seen
}

/// Errors relative to the mean of the truth.
struct ErrorOf {
    /// rms(x − truth) / mean(truth).
    relative_rmse: f64,
    /// mean(x) / mean(truth) − 1.
    bias: f64,
}

impl ErrorOf {
    fn new(pairs: &[(f64, f64)]) -> Self {
        let sum = |value: fn(&(f64, f64)) -> f64| pairs.iter().map(value).sum::<f64>();
        let truth = sum(|pair| pair.1);
        let squares = sum(|pair| (pair.0 - pair.1).powi(2));
        Self {
            relative_rmse: (squares * pairs.len() as f64).sqrt() / truth,
            bias: sum(|pair| pair.0) / truth - 1.0,
        }
    }
}

impl fmt::Display for ErrorOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} % (bias {:+.2})", 100.0 * self.relative_rmse, 100.0 * self.bias)
    }
}

/// Places spread over all `surfaces` by area, a low-discrepancy sequence on each.
fn places_on(surfaces: &[Surface], count: usize) -> Vec<Place> {
    let area: f32 = surfaces.iter().map(|surface| surface.shape.area()).sum();
    let mut places = Vec::new();
    for surface in surfaces {
        let own = (surface.shape.area() / area * count as f32).ceil() as usize;
        for i in 0..own {
            let (a, b) = (0.5 + 0.754_877_67 * i as f32, 0.5 + 0.569_840_3 * i as f32);
            places.push(surface.shape.place(a.fract(), b.fract()));
        }
    }
    places
}

/// Six sides of the box from `low` to `high` that face inwards; the last is the one towards +z.
fn box_inside(low: Vec3, high: Vec3, radiosity: fn(Vec3) -> f32) -> Vec<Surface> {
    let size = high - low;
    let [x, y, z] = [Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z];
    [
        (low, x, y),
        (low, y, z),
        (low, z, x),
        (high, -z, -y),
        (high, -x, -z),
        (high, -y, -x),
    ]
    .map(|(corner, u, v)| Surface {
        shape: Shape::Rectangle(corner, u, v),
        radiosity,
    })
    .to_vec()
}

/// Turns a scene so that no wall lies along an axis of the octree or of the rasters.
const TURN: Quat = Quat::from_xyzw(0.182_574_19, 0.365_148_37, 0.547_722_56, 0.730_296_74);

/// Radiosity of [`cornell`]: a light spot on the floor and the left wall.
fn lit(p: Vec3) -> f32 {
    let spot = (-p.distance_squared(Vec3::new(0.35, 0.0, 0.5)) / 0.06).exp();
    let albedo = if p.x < 1e-4 { 0.2 } else { 0.7 };
    albedo * (0.15 + spot)
}

/// A unit box open towards +z with two spheres.
fn cornell() -> Vec<Surface> {
    let mut surfaces = box_inside(Vec3::ZERO, Vec3::ONE, lit);
    surfaces.pop();
    for (center, r) in [
        (Vec3::new(0.3, 0.18, 0.35), 0.18),
        (Vec3::new(0.7, 0.25, 0.6), 0.22),
    ] {
        surfaces.push(Surface {
            shape: Shape::Sphere(center, r),
            radiosity: lit,
        });
    }
    surfaces
}

/// [`cornell`], turned.
fn turned_cornell() -> Vec<Surface> {
    cornell()
        .into_iter()
        .map(|surface| Surface {
            shape: match surface.shape {
                Shape::Rectangle(corner, u, v) => Shape::Rectangle(TURN * corner, TURN * u, TURN * v),
                Shape::Sphere(center, r) => Shape::Sphere(TURN * center, r),
            },
            radiosity: |p| lit(TURN.inverse() * p),
        })
        .collect()
}

/// A sheet of truth for a scene: places, and what rays see from them.
fn truth(surfaces: &[Surface], count: usize) -> (Vec<Place>, Vec<Seen>) {
    let places = places_on(surfaces, count);
    let seen = places
        .iter()
        .map(|&place| ray_traced(surfaces, place))
        .collect();
    (places, seen)
}

/// Errors of visibility and irradiance.
fn errors(
    octree: &Octree,
    places: &[Place],
    truth: &[Seen],
    settings: PaperSettings,
) -> (ErrorOf, ErrorOf) {
    let seen = gathered(octree, places, settings);
    let of = |value: fn(&Seen) -> f64| {
        let pairs: Vec<_> = seen.iter().zip(truth).map(|(x, t)| (value(x), value(t))).collect();
        ErrorOf::new(&pairs)
    };
    (of(|seen| seen.0), of(|seen| seen.1))
}

#[test]
#[ignore = "prints a table; takes half a minute"]
#[expect(clippy::print_stdout, reason = "it is a report")]
fn knob_table() {
    let knobs = [(0.1, 12), (0.03, 8), (0.03, 12), (0.03, 32), (0.01, 12), (0.003, 32)];
    for (name, surfaces) in [("along the axes", cornell()), ("turned", turned_cornell())] {
        let (places, truth) = truth(&surfaces, 150);
        for count in [20_000, 200_000] {
            let octree = Octree::new(&cloud(&surfaces, count));
            let bytes = octree.bytes() / octree.surfels().len();
            println!("{name}, {count} surfels, {} nodes, {bytes} B a surfel", octree.node_count());
            for (max_solid_angle, raster_resolution) in knobs {
                let settings = PaperSettings {
                    max_solid_angle,
                    raster_resolution,
                    max_distance: None,
                };
                let start = std::time::Instant::now();
                let (visibility, irradiance) = errors(&octree, &places, &truth, settings);
                let micros = start.elapsed().as_micros() / places.len() as u128;
                println!(
                    "  {max_solid_angle:5} sr, {raster_resolution:2}² pixels: visibility {visibility}, irradiance {irradiance}, {micros} µs"
                );
            }
        }
    }
}
