//! Dome lights against sums over all texels of their maps, and what broken maps do.

#[allow(dead_code, reason = "every test file uses some of the builders")]
#[path = "support/scenes.rs"]
mod scenes;

use glam::{Affine3A, DMat3, DVec3, Vec3};
use scenes::{SceneBuilder, floor_under_a_roof, plate, polygon_irradiance, receivers_at};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::path::{Path, PathBuf};
use surflux::bake::{BakeSettings, bake};
use surflux::diagnostics::Diagnostics;
use surflux::gather::{GatherScene, RaysEngine, RaysSettings, gather};
use surflux::lighting::{LightSamples, Lighting, ShadePoint};
use surflux::math::sequence::spiral_sphere;
use surflux::results::{Aov, Results};
use surflux::scene::{Light, LightKind, Linked, PrimId, Scene};
use surflux::shading::Shader;
use surflux::trace::Tracer;
use tempfile::TempDir;

/// Rows and columns of most maps here.
const SIZE: (usize, usize) = (512, 256);

/// Where the sun of a map is: column, row.
const SUN: (usize, usize) = (100, 70);

type Map<'a> = &'a (dyn Fn(usize, usize) -> Vec3 + Sync);

/// Direction and solid angle of a texel, by UsdLux' words: the top is +Y, the centre +Z, a quarter from the left +X.
fn texel(size: (usize, usize), x: usize, y: usize) -> (DVec3, f64) {
    let longitude = PI - TAU * (x as f64 + 0.5) / size.0 as f64;
    let latitude = |row: f64| FRAC_PI_2 - PI * row / size.1 as f64;
    let (up, level) = latitude(y as f64 + 0.5).sin_cos();
    let direction = DVec3::new(level * longitude.sin(), up, level * longitude.cos());
    let band = latitude(y as f64).sin() - latitude(y as f64 + 1.0).sin();
    (direction, TAU / size.0 as f64 * band)
}

/// ∫ L max(0, n·ω) dω.
fn irradiance(map: Map<'_>, turn: &DMat3, normal: Vec3) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (direction, solid_angle) = texel(SIZE, x, y);
            let cosine = (*turn * direction).dot(normal.as_dvec3()).max(0.0);
            sum += map(x, y).as_dvec3() * cosine * solid_angle;
        }
    }
    sum
}

fn smooth(x: usize, y: usize) -> Vec3 {
    let direction = texel(SIZE, x, y).0.as_vec3();
    let glow = (8.0 * (direction.dot(Vec3::new(0.6, 0.5, 0.6)) - 1.0)).exp();
    Vec3::new(0.4, 0.6, 1.0) * (0.3 + 0.7 * direction.y.max(-0.2)) + glow * Vec3::new(3.0, 2.0, 1.0)
}

fn with_sun(x: usize, y: usize) -> Vec3 {
    if (x, y) == SUN {
        Vec3::splat(1e6)
    } else {
        smooth(x, y)
    }
}

fn write(folder: &TempDir, size: (usize, usize), map: Map<'_>) -> PathBuf {
    let path = folder.path().join("sky.exr");
    let pixel = |x, y| <(f32, f32, f32)>::from(map(x, y));
    exr::prelude::write_rgb_file(&path, size.0, size.1, pixel).expect("written");
    path
}

fn dome(texture: Option<&Path>, radiance: Vec3, turn: &DMat3) -> Light {
    Light {
        path: "/World/sky".to_owned(),
        kind: LightKind::Dome {
            texture: texture.map(Into::into),
        },
        radiance,
        normalize: false,
        world_from_light: Affine3A::from_mat3(turn.as_mat3()),
        shaping: None,
        casts_shadows: true,
        lit: Linked::All,
        blockers: Linked::All,
    }
}

/// A floor far below, lit by `lights`.
fn scene(lights: Vec<Light>) -> Scene {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    let corner = Vec3::new(-1.0, 0.0, -1.0);
    builder.mesh(
        "floor",
        plate(corner, Vec3::Z * 2.0, Vec3::X * 2.0, 1),
        gray,
    );
    let mut scene = builder.build();
    scene.lights = lights;
    scene
}

fn facing(position: Vec3, normal: Vec3) -> ShadePoint {
    ShadePoint {
        position,
        normal,
        geometric_normal: normal,
        smooth_offset: None,
        prim: None,
    }
}

/// High above the floor, which covers nothing.
fn in_the_open(count: u32) -> Vec<ShadePoint> {
    (0..count)
        .map(|i| facing(Vec3::Y * 1e5, spiral_sphere(i, count)))
        .collect()
}

/// Light at `points` in `scene`, and how many warnings there were.
fn lit(scene: &Scene, points: &[ShadePoint]) -> (Vec<Vec3>, usize) {
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    let tracer = Tracer::new(scene);
    let light = lighting.environment_of(&tracer, points, f32::INFINITY);
    let values = light.iter().map(|light| light.irradiance).collect();
    (values, diagnostics.warnings().len())
}

/// rms(a − b) / mean b.
fn relative_rms(a: &[Vec3], b: &[DVec3]) -> f64 {
    let count = b.len() as f64;
    let square: f64 = (a.iter().zip(b))
        .map(|(a, b)| (a.as_dvec3() - b).length_squared() / 3.0)
        .sum();
    let mean: f64 = b.iter().map(|b| b.element_sum() / 3.0).sum();
    (square / count).sqrt() / (mean / count)
}

#[test]
fn irradiance_in_the_open_is_the_sum_over_all_texels() {
    let folder = TempDir::new().expect("a folder");
    let turn = DMat3::from_rotation_x(0.3) * DMat3::from_rotation_y(1.0);
    let points = in_the_open(100);
    for map in [smooth as fn(usize, usize) -> Vec3, with_sun] {
        let path = write(&folder, SIZE, &map);
        let (found, _) = lit(&scene(vec![dome(Some(&path), Vec3::ONE, &turn)]), &points);
        let exact: Vec<DVec3> = (points.iter())
            .map(|point| irradiance(&map, &turn, point.normal))
            .collect();
        let error = relative_rms(&found, &exact);
        assert!(error < 2e-3, "{error}");
    }
}

#[test]
fn a_sun_of_1e6_in_one_texel_keeps_its_light() {
    let folder = TempDir::new().expect("a folder");
    let path = write(&folder, SIZE, &with_sun);
    let points = in_the_open(100);
    let turn = DMat3::IDENTITY;
    let (found, _) = lit(&scene(vec![dome(Some(&path), Vec3::ONE, &turn)]), &points);
    let sun = texel(SIZE, SUN.0, SUN.1).0.as_vec3();
    let mut seen = 0;
    for (point, found) in points.iter().zip(found) {
        if point.normal.dot(sun) < 0.02 {
            continue; // the sun is about to set: there its texel's own width counts
        }
        let exact = irradiance(&with_sun, &turn, point.normal);
        let error = (found.as_dvec3() / exact - 1.0).abs().max_element();
        assert!(error < 0.02, "{} {found} {exact}", point.normal);
        seen += 1;
    }
    assert!(seen > 40);
}

#[test]
fn domes_add_up_each_in_its_own_frame() {
    let folder = TempDir::new().expect("a folder");
    let path = write(&folder, SIZE, &with_sun);
    let turns = [
        DMat3::from_rotation_x(FRAC_PI_2),
        DMat3::from_rotation_z(2.0),
    ];
    let even = Vec3::new(0.5, 0.0, 2.0);
    let lights = vec![
        dome(Some(&path), Vec3::splat(1e-3), &turns[0]),
        dome(None, even, &turns[1]),
        dome(Some(&path), Vec3::X, &turns[1]),
    ];
    let points = in_the_open(50);
    let (found, _) = lit(&scene(lights), &points);
    let exact: Vec<DVec3> = (points.iter())
        .map(|point| {
            let one = irradiance(&with_sun, &turns[0], point.normal) * 1e-3;
            let other = irradiance(&with_sun, &turns[1], point.normal) * DVec3::X;
            one + other + even.as_dvec3() * PI
        })
        .collect();
    let error = relative_rms(&found, &exact);
    assert!(error < 4e-3, "{error}");
}

#[test]
fn both_parts_of_the_set_hold_the_whole_sky() {
    let folder = TempDir::new().expect("a folder");
    let path = write(&folder, SIZE, &with_sun);
    let scene = scene(vec![dome(Some(&path), Vec3::ONE, &DMat3::IDENTITY)]);
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    let set = lighting.environment_set();
    assert!(!set.even().is_empty() && !set.importance().is_empty());
    assert_eq!(set.even().len() + set.importance().len(), set.cells().len());
    let mut exact = [DVec3::ZERO; 3];
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (direction, solid_angle) = texel(SIZE, x, y);
            for (axis, exact) in exact.iter_mut().enumerate() {
                *exact += with_sun(x, y).as_dvec3() * direction[axis] * solid_angle;
            }
        }
    }
    for (axis, exact) in exact.into_iter().enumerate() {
        let parts = set.even().iter().chain(set.importance());
        let sum: DVec3 = parts.map(|cell| cell.moments()[axis].as_dvec3()).sum();
        let error = (sum - exact).length() / exact.length();
        assert!(error < 1e-4, "{axis}: {sum} {exact}");
    }
    let (points, tracer) = (in_the_open(50), Tracer::new(&scene));
    let whole = lighting.environment_of(&tracer, &points, f32::INFINITY);
    let sharp = set.importance_light(&tracer, &points, f32::INFINITY);
    for (point, (whole, sharp)) in points.iter().zip(whole.iter().zip(sharp)) {
        let even = set.even().iter().map(|cell| cell.irradiance(point.normal));
        let sum = sharp.irradiance + even.sum::<Vec3>();
        let error = (sum - whole.irradiance).abs().max_element();
        assert!(error < 1e-5 * sum.max_element(), "{sum} {whole:?}");
    }
}

#[test]
fn receivers_in_blocks_see_what_each_sees_alone() {
    let folder = TempDir::new().expect("a folder");
    let path = write(&folder, SIZE, &with_sun);
    let scene = scene(vec![dome(Some(&path), Vec3::ONE, &DMat3::IDENTITY)]);
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    let tracer = Tracer::new(&scene);
    // around the floor's edge, above and below it
    let points: Vec<ShadePoint> = (0..150)
        .map(|i| {
            let off = Vec3::new(1.0, 0.3, 0.0) + 0.5 * spiral_sphere(i, 150);
            facing(off, spiral_sphere(i * 7 % 150, 150))
        })
        .collect();
    let together = lighting.environment_of(&tracer, &points, f32::INFINITY);
    for (point, light) in points.iter().zip(together) {
        let alone = lighting.environment(&tracer, point);
        let error = (light.irradiance - alone).abs().max_element();
        assert!(
            error <= 1e-5 * alone.max_element(),
            "{point:?}: {light:?} {alone}"
        );
    }
}

#[test]
fn the_shadow_of_a_sun_in_one_texel_has_a_penumbra_as_wide_as_the_texel() {
    let folder = TempDir::new().expect("a folder");
    let only_sun = |x: usize, y: usize| Vec3::splat(if (x, y) == (256, 100) { 1e4 } else { 0.0 });
    let path = write(&folder, SIZE, &only_sun);
    let scene = scene(vec![dome(Some(&path), Vec3::ONE, &DMat3::IDENTITY)]);
    // Below the floor, whose edge at z = 1 hides the sun for all who stand before the line from the sun over it.
    let (sun, solid_angle) = texel(SIZE, 256, 100);
    let down = 1.0;
    let line = 1.0 - down * sun.z / sun.y;
    let width = solid_angle.sqrt() / sun.y.powi(2);
    let points: Vec<ShadePoint> = (-20..=20)
        .map(|i| {
            let z = line + width * f64::from(i) / 20.0;
            facing(DVec3::new(0.0, -down, z).as_vec3(), sun.as_vec3())
        })
        .collect();
    let (found, _) = lit(&scene, &points);
    let whole = 1e4 * solid_angle;
    let share: Vec<f64> = (found.iter())
        .map(|light| f64::from(light.x) / whole)
        .collect();
    assert!(
        share[0] < 1e-3 && (share[40] - 1.0).abs() < 1e-3,
        "{share:?}"
    );
    assert!(share.windows(2).all(|pair| pair[1] >= pair[0] - 1e-4));
    let steps = share.windows(2).filter(|pair| pair[1] > pair[0] + 1e-3);
    assert!(steps.count() >= 4, "{share:?}");
    let mean = share.iter().sum::<f64>() / 41.0;
    assert!((mean - 0.5).abs() < 0.1, "{share:?}");
}

#[test]
fn broken_maps_are_warned_of_and_all_light_is_finite() {
    let folder = TempDir::new().expect("a folder");
    let points = in_the_open(20);
    let cases: [(&str, (usize, usize), Map<'_>, usize); 6] = [
        ("black", (16, 8), &|_, _| Vec3::ZERO, 0),
        ("one pixel", (1, 1), &|_, _| Vec3::ONE, 0),
        ("one row", (5, 1), &|x, _| Vec3::splat(x as f32), 0),
        (
            "not finite",
            (16, 8),
            &|x, y| match (x, y) {
                (0, 0) => Vec3::NAN,
                (1, 3) => Vec3::INFINITY,
                _ => Vec3::ONE,
            },
            1,
        ),
        ("negative", (16, 8), &|x, _| Vec3::splat(x as f32 - 1.0), 1),
        (
            "wide range",
            (16, 8),
            &|x, _| Vec3::splat(10.0_f32.powf(5.0 * x as f32 - 37.0)),
            0,
        ),
    ];
    for (name, size, map, expected) in cases {
        let path = write(&folder, size, map);
        for radiance in [1.0, 1e30] {
            let light = dome(Some(&path), Vec3::splat(radiance), &DMat3::IDENTITY);
            let (found, warnings) = lit(&scene(vec![light]), &points);
            assert_eq!(warnings, expected, "{name}");
            assert!(
                found.iter().all(|light| light.is_finite()),
                "{name}: {found:?}"
            );
            assert!(
                found.iter().all(|light| light.min_element() >= 0.0),
                "{name}"
            );
            assert_eq!(
                found.iter().all(|light| *light == Vec3::ZERO),
                name == "black"
            );
        }
    }
    let missing = dome(
        Some(&folder.path().join("none.exr")),
        Vec3::ONE,
        &DMat3::IDENTITY,
    );
    let (_, warnings) = lit(&scene(vec![missing]), &points);
    assert_eq!(warnings, 1);
}

/// Directions of what is open and of the light on the floor, which `lights` light.
fn directions(lights: Vec<Light>) -> Results {
    let aovs = [Aov::IlluminationDirection, Aov::BentNormal];
    gathered(&scene(lights), RaysSettings::default(), &aovs)
}

/// `aovs` at a point of the first mesh.
fn gathered(scene: &Scene, settings: RaysSettings, aovs: &[Aov]) -> Results {
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    let tracer = Tracer::new(scene);
    let engine = RaysEngine::new(&tracer, None, settings);
    let receivers = receivers_at(scene, &[(PrimId(0), 0, 0.3, 0.3)]);
    let scene = GatherScene {
        shader: &shader,
        tracer: &tracer,
        lighting: Some(&lighting),
    };
    gather(scene, &engine, &receivers, aovs, &diagnostics).expect("nobody cancels")
}

#[test]
fn only_what_is_nearer_than_the_largest_distance_hides_the_sky() {
    let folder = TempDir::new().expect("a folder");
    let path = write(&folder, SIZE, &smooth);
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    let (x, z) = (Vec3::X * 40.0, Vec3::Z * 40.0);
    for (name, height) in [("floor", 0.0), ("roof", 0.25)] {
        let corner = Vec3::new(-20.0, height, -20.0);
        builder.mesh(name, plate(corner, z, x, 1), gray);
    }
    let mut scene = builder.build();
    let sky = irradiance(&smooth, &DMat3::IDENTITY, Vec3::Y);
    scene.lights = vec![dome(Some(&path), Vec3::ONE, &DMat3::IDENTITY)];
    let found = |max_distance: Option<f32>| {
        let settings = RaysSettings {
            max_distance,
            ..RaysSettings::default()
        };
        let results = gathered(&scene, settings, &[Aov::IrradianceEnvironment]);
        let buffer = results.get(Aov::IrradianceEnvironment).expect("asked for");
        DVec3::from_slice(
            &buffer
                .data
                .iter()
                .map(|&x| f64::from(x))
                .collect::<Vec<_>>(),
        )
    };
    let found = [None, Some(100.0), Some(0.2)].map(found);
    assert!(
        found[0].max_element() < 1e-3 * sky.max_element(),
        "{found:?}"
    );
    assert_eq!(found[0], found[1]);
    let off = (found[2] - sky).abs().max_element() / sky.max_element();
    assert!(off < 0.01, "{found:?} {sky}");
}

#[test]
fn the_direction_of_the_light_is_the_suns_or_under_an_even_sky_the_bent_normal() {
    let folder = TempDir::new().expect("a folder");
    let path = write(&folder, SIZE, &with_sun);
    let direction =
        |results: &Results, aov| Vec3::from_slice(&results.get(aov).expect("asked for").data);
    let sunny = directions(vec![dome(Some(&path), Vec3::ONE, &DMat3::IDENTITY)]);
    let sun = texel(SIZE, SUN.0, SUN.1).0.as_vec3();
    let found = direction(&sunny, Aov::IlluminationDirection);
    assert!(found.angle_between(sun) < 0.02, "{found} {sun}");
    for lights in [vec![dome(None, Vec3::X, &DMat3::IDENTITY)], Vec::new()] {
        let even = directions(lights);
        let bent = direction(&even, Aov::BentNormal);
        assert_eq!(direction(&even, Aov::IlluminationDirection), bent);
    }
}

/// Surfels of a floor below a square roof, against Lambert's sum over its edges: lit from the same directions they err alike, and
/// less from more directions.
#[test]
fn surfels_see_the_sky_as_well_as_they_have_directions_for() {
    let (scene, floor, corners) = floor_under_a_roof(8);
    let (tracer, diagnostics) = (Tracer::new(&scene), Diagnostics::default());
    let shader = Shader::new(&scene, &diagnostics);
    let error = |lighting: &Lighting| {
        let settings = BakeSettings {
            surfels: 4000,
            ..BakeSettings::default()
        };
        let baked = bake(&shader, &tracer, lighting, &settings, &diagnostics);
        let cloud = baked.expect("not cancelled").cloud;
        let is_upper =
            |&i: &usize| cloud.prim[i] as usize == floor.index() && cloud.normal[i].y > 0.0;
        let upper: Vec<usize> = (0..cloud.len()).filter(is_upper).collect();
        let (mut square, mut sum) = (0.0, 0.0);
        for &i in &upper {
            let open = PI - polygon_irradiance(cloud.position[i], Vec3::Y, &corners);
            square += (f64::from(cloud.radiosity[i].x) / 0.5 - open).powi(2);
            sum += open;
        }
        let count = upper.len() as f64;
        assert!(count > 500.0, "{count}");
        (square * count).sqrt() / sum
    };
    let finer = LightSamples {
        environment: 1024,
        ..LightSamples::SURFEL
    };
    let usual = error(&Lighting::new(&shader, finer, &diagnostics));
    let fine = error(&Lighting::of_surfels(&shader, finer, &diagnostics));
    assert!(fine < 0.02 && fine < 0.4 * usual, "{fine} {usual}");
}
