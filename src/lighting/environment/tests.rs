//! Environments against brute force over their texels.

use super::super::ShadePoint;
use super::texels::even_map;
use super::*;
use crate::scene::{Light, Linked};
use crate::trace::Tracer;
use crate::trace::testing::{Random, mesh, scene};
use glam::{Affine3A, DVec3};
use std::f32::consts::TAU;

const CELLS: u32 = 512;

/// An environment with its cells.
struct Divided {
    environment: Environment,
    set: EnvironmentSet,
}

impl Divided {
    fn irradiance(&self, tracer: &Tracer, point: &ShadePoint, origin: Vec3) -> Vec3 {
        let stand = Stand::new(tracer, point).moved_to(origin);
        self.environment.light(&self.set, &stand).irradiance
    }
}

fn divided(environment: Environment) -> Divided {
    let [set] = environment.sets([CELLS]);
    Divided { environment, set }
}

fn environment(map: Option<Latlong>, radiance: Vec3) -> Divided {
    let uniform = map.is_none().then_some(radiance);
    let domes = vec![Dome {
        map,
        radiance,
        world_from_dome: Mat3::from_rotation_x(0.3) * Mat3::from_rotation_y(1.0),
    }];
    divided(Environment { domes, uniform })
}

fn open() -> Tracer {
    Tracer::new(&scene(Vec::new(), &[]))
}

fn facing(normal: Vec3) -> ShadePoint {
    ShadePoint {
        position: Vec3::ZERO,
        normal,
        geometric_normal: normal,
        smooth_offset: None,
        prim: None,
    }
}

/// A wall up to the horizon at x = −0.01.
fn walled() -> Tracer {
    let far = 1e3;
    let corner = |y: f32, z: f32| Vec3::new(-0.01, y * far, z * far);
    let (a, b, c, d) = (
        corner(-1.0, -1.0),
        corner(1.0, -1.0),
        corner(1.0, 1.0),
        corner(-1.0, 1.0),
    );
    let wall = [[a, b, c], [a, c, d]];
    Tracer::new(&scene(vec![mesh(&wall)], &[(0, Affine3A::IDENTITY)]))
}

fn smooth_sky() -> Latlong {
    let mut map = even_map(256, 128);
    for i in 0..map.pixels.len() {
        let d = map.direction(i % 256, i / 256);
        let glow = (4.0 * (d.dot(Vec3::new(0.6, 0.5, 0.6)) - 1.0)).exp();
        map.pixels[i] = Vec3::new(0.4, 0.6, 1.0) * (0.3 + 0.7 * d.y.max(-0.2))
            + glow * Vec3::new(3.0, 2.0, 1.0);
    }
    map
}

fn brute_force(environment: &Divided, normal: Vec3) -> Vec3 {
    let dome = &environment.environment.domes[0];
    let map = dome.map.as_ref().unwrap();
    let mut sum = DVec3::ZERO;
    for y in 0..map.height {
        let solid_angle = f64::from(map.solid_angle(y));
        for x in 0..map.width {
            let direction = dome.world_from_dome * map.direction(x, y);
            let cosine = f64::from(direction.dot(normal).max(0.0));
            sum += map.pixels[y * map.width + x].as_dvec3() * cosine * solid_angle;
        }
    }
    sum.as_vec3() * dome.radiance
}

fn worst_error(environment: &Divided, count: u64, counts: impl Fn(Vec3) -> bool) -> f32 {
    let (tracer, mut random) = (open(), Random(count));
    let mean = PI * brute_force(environment, Vec3::Y).element_sum() / PI;
    (0..count)
        .map(|_| random.direction())
        .filter(|normal| counts(*normal))
        .map(|normal| {
            let value = environment.irradiance(&tracer, &facing(normal), Vec3::ZERO);
            let truth = brute_force(environment, normal);
            ((value - truth).abs() / truth.max(Vec3::splat(0.01 * mean))).max_element()
        })
        .fold(0.0, f32::max)
}

#[test]
fn unblocked_irradiance_of_a_smooth_sky_is_within_half_a_percent() {
    let sky = environment(Some(smooth_sky()), Vec3::ONE);
    let worst = worst_error(&sky, 60, |_| true);
    assert!(worst < 5e-3, "{worst}");
}

#[test]
fn unblocked_irradiance_with_a_sun_of_1e6_in_one_texel_is_within_a_percent() {
    let mut map = smooth_sky();
    map.pixels[40 * 256 + 100] = Vec3::splat(1e6);
    let sky = environment(Some(map), Vec3::ONE);
    let sun = sky.environment.domes[0].world_from_dome * smooth_sky().direction(100, 40);
    // The sum takes a texel as its middle, the cells as its area: where the sun sets they differ.
    let texel = TAU / 256.0;
    let worst = worst_error(&sky, 60, |normal| normal.dot(sun).abs() > texel);
    assert!(worst < 1e-2, "{worst}");
}

#[test]
fn uniform_sky_gives_pi_l_and_half_of_it_beside_a_wall() {
    let radiance = Vec3::new(1.0, 2.0, 0.0);
    let sky = environment(None, radiance);
    let open = sky.irradiance(&open(), &facing(Vec3::Y), Vec3::ZERO);
    assert!((open - PI * radiance).abs().max_element() < 1e-5);
    let tracer = walled();
    let beside = sky.irradiance(&tracer, &facing(Vec3::Y), Vec3::new(0.0, 1e-4, 0.0));
    let error = (beside - 0.5 * PI * radiance).abs().max_element();
    assert!(error < 0.01 * PI, "{beside}");
}

/// Mean of many glimpses at a receiver facing `normal`.
fn mean_glimpse(sky: &Divided, tracer: &Tracer, normal: Vec3) -> Vec3 {
    let point = facing(normal);
    let stand = Stand::new(tracer, &point).moved_to(Vec3::new(0.0, 1e-4, 0.0));
    let glimpse = |number| sky.environment.glimpse(&sky.set, &stand, number).as_dvec3();
    let sum: DVec3 = (0..GLIMPSES).map(glimpse).sum();
    (sum / f64::from(GLIMPSES)).as_vec3()
}

const GLIMPSES: u32 = 40_000;

#[test]
fn glimpses_are_in_the_mean_what_a_wall_leaves_of_the_sky() {
    // Half of an even sky, and each of these normals sees another part of it: (1 + n · x) / 2.
    let (tracer, even) = (walled(), environment(None, Vec3::ONE));
    for normal in [Vec3::Y, Vec3::X, Vec3::new(-0.6, 0.8, 0.0)] {
        let truth = PI * 0.5 * (1.0 + normal.x);
        let mean = mean_glimpse(&even, &tracer, normal).x;
        assert!(
            (mean / truth - 1.0).abs() < 0.01,
            "{normal}: {mean} {truth}"
        );
    }
}

#[test]
fn glimpses_of_few_cells_see_shadows_inside_them() {
    let (tracer, mut sky) = (walled(), environment(Some(smooth_sky()), Vec3::ONE));
    let fine = sky.irradiance(&tracer, &facing(Vec3::Y), Vec3::new(0.0, 1e-4, 0.0));
    let [set] = sky.environment.sets([64]);
    sky.set = set;
    let mean = mean_glimpse(&sky, &tracer, Vec3::Y);
    let fixed = sky.irradiance(&tracer, &facing(Vec3::Y), Vec3::new(0.0, 1e-4, 0.0));
    let error = |of: Vec3| (of / fine - 1.0).abs().max_element();
    let (glimpsed, fixed) = (error(mean), error(fixed));
    assert!(glimpsed < 0.02, "{glimpsed}");
    assert!(glimpsed < 0.7 * fixed, "{glimpsed} {fixed}");
}

#[test]
fn a_blocked_sun_leaves_the_sky() {
    let mut map = smooth_sky();
    let sky_alone = environment(Some(map.clone()), Vec3::ONE);
    map.pixels[40 * 256 + 100] = Vec3::splat(1e6);
    let with_sun = environment(Some(map.clone()), Vec3::ONE);
    let sun = with_sun.environment.domes[0].world_from_dome * map.direction(100, 40);
    let across = sun.any_orthonormal_vector();
    let (a, b) = (across * 0.3, sun.cross(across) * 0.3);
    let shade = [[sun - a - b, sun + a - b, sun + b]];
    let tracer = Tracer::new(&scene(vec![mesh(&shade)], &[(0, Affine3A::IDENTITY)]));
    let shaded = with_sun.irradiance(&tracer, &facing(sun), Vec3::ZERO);
    let truth = sky_alone.irradiance(&tracer, &facing(sun), Vec3::ZERO);
    assert!(
        (shaded / truth - 1.0).abs().max_element() < 0.03,
        "{shaded} {truth}"
    );
}

#[test]
fn domes_look_up_their_map_in_their_own_frame_and_add_up() {
    let sky = environment(Some(smooth_sky()), Vec3::splat(2.0));
    let local = Vec3::new(0.6, 0.5, 0.6).normalize();
    let world = sky.environment.domes[0].world_from_dome * local;
    let truth = smooth_sky().radiance(local) * 2.0;
    assert!(
        (sky.environment.radiance(world) - truth)
            .abs()
            .max_element()
            < 0.2
    );
    let dome = |radiance: f32| Light {
        path: "/dome".into(),
        kind: LightKind::Dome { texture: None },
        radiance: Vec3::splat(radiance),
        normalize: true,
        world_from_light: Affine3A::from_scale(Vec3::splat(7.0)),
        shaping: None,
        casts_shadows: true,
        lit: Linked::All,
        blockers: Linked::All,
    };
    let lights = [dome(1.0), dome(0.5), dome(0.0)];
    let two = divided(Environment::new(lights.iter(), &Diagnostics::default()));
    assert_eq!(two.environment.uniform, Some(Vec3::splat(1.5)));
    let irradiance = two.irradiance(&open(), &facing(Vec3::X), Vec3::ZERO);
    assert!((irradiance - 1.5 * PI).abs().max_element() < 1e-4);
}

#[test]
fn a_missing_texture_is_a_warning_and_an_even_sky() {
    let diagnostics = Diagnostics::default();
    let dome = Light {
        path: "/dome".into(),
        kind: LightKind::Dome {
            texture: Some("does-not-exist.hdr".into()),
        },
        radiance: Vec3::ONE,
        normalize: false,
        world_from_light: Affine3A::IDENTITY,
        shaping: None,
        casts_shadows: true,
        lit: Linked::All,
        blockers: Linked::All,
    };
    let sky = Environment::new([dome].iter(), &diagnostics);
    assert_eq!(diagnostics.warnings().len(), 1);
    assert_eq!(sky.uniform, Some(Vec3::ONE));
}
