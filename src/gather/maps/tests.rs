use super::crowd::{LANES, Sums};
use super::*;
use crate::gather::testing::receivers_at;
use crate::lighting::{LightSamples, Lighting};
use crate::scene::{Light, LightKind, Linked, Scene};
use crate::shading::Shader;
use crate::trace::Tracer;
use crate::trace::testing::{Random, mesh, scene};
use glam::Affine3A;

/// A soup of triangles about as large as their distances, and a flat prim.
fn soup(random: &mut Random) -> Scene {
    let triangles: Vec<[Vec3; 3]> = (0..300)
        .map(|_| {
            let at = random.vector();
            [0; 3].map(|_| at + 0.2 * random.vector())
        })
        .collect();
    let flat = [Vec3::ZERO, Vec3::X, Vec3::Y].map(|v| v - 0.5 * Vec3::Z);
    let turned = Affine3A::from_rotation_y(0.7);
    scene(
        vec![mesh(&triangles), mesh(&[flat])],
        &[(0, Affine3A::IDENTITY), (1, turned), (0, turned)],
    )
}

fn anywhere(random: &mut Random, count: usize) -> Receivers {
    let points: Vec<_> = (0..count)
        .map(|_| (1.2 * random.vector(), random.direction()))
        .collect();
    receivers_at(&points)
}

/// All sums, bit by bit.
fn bits(sums: &[Sums]) -> Vec<u32> {
    let rows = |s: &Sums| -> Vec<f32> {
        let rows = [s.weight, s.open, s.uncertain];
        let rows = rows.iter().chain(&s.channels).chain(&s.sky);
        rows.flatten().copied().collect()
    };
    sums.iter().flat_map(rows).map(f32::to_bits).collect()
}

#[test]
fn sixteen_at_a_time_see_bit_for_bit_what_the_definition_sees_at_any_level() {
    let mut random = Random(7);
    let scene = soup(&mut random);
    let receivers = anywhere(&mut random, 100);
    let plan = MapsPlan::new(&scene);
    assert_eq!(plan.flats.len(), 1);
    let settings = MapsSettings::default();
    let sky = MapsSky::new(
        &lit(sunny).0,
        &MapsSettings {
            directions: 8,
            ..settings
        },
    );
    let wanted = Wanted {
        bent_normal: true,
        harmonics: true,
        environment: Some(SkyWanted {
            sky: &sky,
            with_direction: true,
        }),
    };
    let stage = Stage::new(&plan, &settings);
    let views: Vec<View> = axes::axes(8)
        .iter()
        .map(|axis| {
            let mut view = View::default();
            stage.look_along(Level::new(), (&plan, &wanted), axis, &mut view);
            view
        })
        .collect();
    let channels = Channels::of(&wanted);
    let rules = Rules {
        bias: 0.5,
        max_distance: 1.0,
        flat_margin: Rules::flat_margin(plan.radius, plan.radius),
        weighted_channels: channels.weighted,
    };
    let crowd = || {
        let rows = (channels.count, sky::row_count(wanted.environment));
        Crowd::new(&plan, &receivers, rows)
    };
    let mut plainly = crowd();
    for view in &views {
        for (block, sums) in plainly.blocks.iter().zip(&mut plainly.sums) {
            (0..LANES).for_each(|lane| plain::look(view, &rules, block, lane, sums));
        }
    }
    let expected = bits(&plainly.sums);
    for level in [Level::baseline(), Level::new()] {
        let mut widely = crowd();
        wide::look(level, (&views, &rules), &widely.blocks, &mut widely.sums);
        assert_eq!(bits(&widely.sums), expected, "{level:?}");
    }
    let open: f32 = plainly.sums.iter().flat_map(|s| s.open).sum();
    let weight: f32 = plainly.sums.iter().flat_map(|s| s.weight).sum();
    assert!(open > 0.1 * weight && open < 0.9 * weight);
}

#[test]
fn an_empty_scene_is_open_everywhere_and_no_receivers_see_nothing() {
    let scene = scene(Vec::new(), &[]);
    let plan = MapsPlan::new(&scene);
    assert_eq!(plan.edge(), 0.0);
    let look = |receivers: &Receivers| {
        let settings = MapsSettings {
            directions: 7,
            ..MapsSettings::default()
        };
        let wanted = Wanted {
            bent_normal: true,
            ..Wanted::default()
        };
        visibility(
            &plan,
            receivers,
            &settings,
            &wanted,
            &Diagnostics::default(),
        )
        .unwrap()
    };
    let seen = look(&receivers_at(&[
        (Vec3::ZERO, Vec3::Y),
        (Vec3::ONE, Vec3::X),
    ]));
    assert_eq!(seen.visibility, [1.0, 1.0]);
    assert_eq!(seen.ambiguous, [false, false]);
    assert!(look(&receivers_at(&[])).visibility.is_empty());
}

#[test]
fn an_open_receiver_gets_the_full_harmonics_and_bent_normal() {
    let scene = scene(Vec::new(), &[]);
    let plan = MapsPlan::new(&scene);
    let normal = Vec3::new(0.3, 0.8, -0.2).normalize();
    let receivers = receivers_at(&[(Vec3::ZERO, normal)]);
    let settings = MapsSettings {
        directions: 1024,
        ..MapsSettings::default()
    };
    let wanted = Wanted {
        bent_normal: true,
        harmonics: true,
        ..Wanted::default()
    };
    let quiet = Diagnostics::default();
    let seen = visibility(&plan, &receivers, &settings, &wanted, &quiet).unwrap();
    // The mean of ω by cosine is 2/3 n; the 0th coefficient is 2π·Y₀.
    assert!((seen.open_direction[0] - 2.0 / 3.0 * normal).length() < 2e-3);
    assert!((seen.harmonics[0].0[0] - 2.0 * PI * 0.282_094_8).abs() < 5e-3);
}

/// A gradient with a glow, a black quarter, and a sun of 1e4 in one texel; column and row of [`SIZE`].
fn sunny(x: usize, y: usize) -> Vec3 {
    let (x, y) = (x as f32 / SIZE.0 as f32, y as f32 / SIZE.1 as f32);
    if x > 0.75 {
        return Vec3::ZERO;
    }
    let glow = (-60.0 * ((x - 0.3).powi(2) + (y - 0.4).powi(2))).exp();
    let sun = (x - 0.5).abs().max((y - 0.3).abs()) < 0.5 / SIZE.0 as f32;
    Vec3::new(0.4, 0.6, 1.0 - y)
        + glow * Vec3::new(3.0, 2.0, 1.0)
        + Vec3::splat(if sun { 1e4 } else { 0.0 })
}

const SIZE: (usize, usize) = (256, 128);

/// Light of a dome with this image on an empty stage, and the irradiance of a normal that all its texels sum to.
fn lit(image: fn(usize, usize) -> Vec3) -> (Lighting, impl Fn(Vec3) -> Vec3) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.exr");
    let pixel = |x, y| <(f32, f32, f32)>::from(image(x, y));
    exr::prelude::write_rgb_file(&path, SIZE.0, SIZE.1, pixel).unwrap();
    let mut scene = scene(Vec::new(), &[]);
    scene.lights.push(Light {
        path: "/dome".into(),
        kind: LightKind::Dome {
            texture: Some(path),
        },
        radiance: Vec3::ONE,
        normalize: false,
        world_from_light: Affine3A::IDENTITY,
        shaping: None,
        casts_shadows: true,
        lit: Linked::All,
        blockers: Linked::All,
    });
    let quiet = Diagnostics::default();
    let shader = Shader::new(&scene, &quiet);
    let lighting = Lighting::new(&shader, LightSamples::default(), &quiet);
    let sum = move |normal: Vec3| {
        let mut sum = glam::DVec3::ZERO;
        for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
            let longitude = PI - 2.0 * PI * (x as f32 + 0.5) / SIZE.0 as f32;
            let latitude = |row: f32| PI * (0.5 - row / SIZE.1 as f32);
            let (up, level) = latitude(y as f32 + 0.5).sin_cos();
            let direction = Vec3::new(level * longitude.sin(), up, level * longitude.cos());
            let band = latitude(y as f32).sin() - latitude(y as f32 + 1.0).sin();
            let weight = direction.dot(normal).max(0.0) * 2.0 * PI / SIZE.0 as f32 * band;
            sum += (image(x, y) * weight).as_dvec3();
        }
        sum.as_vec3()
    };
    (lighting, sum)
}

#[test]
fn open_receivers_get_the_sum_over_all_cells_and_over_all_texels() {
    let scene = scene(Vec::new(), &[]);
    let (plan, tracer, quiet) = (
        MapsPlan::new(&scene),
        Tracer::new(&scene),
        Diagnostics::default(),
    );
    let (lighting, texels) = lit(sunny);
    let mut random = Random(11);
    let points: Vec<_> = (0..60).map(|_| (Vec3::ZERO, random.direction())).collect();
    let receivers = receivers_at(&points);
    let mut before = f32::INFINITY;
    for directions in [16, 64, 256] {
        let settings = MapsSettings {
            directions,
            ..MapsSettings::default()
        };
        let sky = MapsSky::new(&lighting, &settings);
        let wanted = Wanted {
            environment: Some(SkyWanted {
                sky: &sky,
                with_direction: false,
            }),
            ..Wanted::default()
        };
        let seen = visibility(&plan, &receivers, &settings, &wanted, &quiet).unwrap();
        let bright = (sky.bright_light((&scene, &tracer), &receivers, &quiet)).unwrap();
        let (mut error, mut size) = (0.0, 0.0);
        for (i, &normal) in receivers.normal.iter().enumerate() {
            let cells = sky.even_light(normal, &vec![false; directions as usize]);
            let rounding = (seen.environment[i] - cells).abs().max_element();
            assert!(rounding < 1e-5 * cells.max_element(), "{rounding} {cells}");
            let exact = texels(normal);
            error += (seen.environment[i] + bright[i].irradiance - exact).length_squared();
            size += exact.length();
        }
        let n = points.len() as f32;
        let error = (error / n).sqrt() / (size / n);
        assert!(error < 0.5 * before, "{directions}: {error} {before}");
        before = error;
    }
    // The cells of 256 axes are 9 degrees wide; what leans over the horizon is guessed for those across it.
    assert!(before < 1e-3, "{before}");
}

#[test]
fn cancelled_runs_end() {
    let scene = scene(Vec::new(), &[]);
    let plan = MapsPlan::new(&scene);
    let diagnostics = Diagnostics::default();
    diagnostics.cancel_token().cancel();
    let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
    let settings = MapsSettings::default();
    let result = visibility(
        &plan,
        &receivers,
        &settings,
        &Wanted::default(),
        &diagnostics,
    );
    assert_eq!(result, Err(Cancelled));
}
