//! Depth maps against closed forms and against rays on the same scene, and where they are known to fail.

#[path = "support/dense.rs"]
mod dense;
#[path = "support/maps_failures.rs"]
mod failures;
#[path = "support/maps_image.rs"]
mod image;
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
#[path = "support/scenes.rs"]
mod scenes;
#[path = "support/sky.rs"]
mod sky;
#[path = "support/maps_speed.rs"]
mod speed;

use glam::{Affine3A, Quat, Vec3};
use scenes::{
    SceneBuilder, Side, bowl, plate, polygon_irradiance, receivers_at, room, triangle_mesh,
};
use std::f32::consts::PI;
use surflux::gather::maps::{self, MapsPlan, MapsSettings, Visibility, Wanted};
use surflux::gather::{GatherScene, RaysEngine, RaysSettings, gather};
use surflux::lighting::{LightSamples, Lighting};
use surflux::math::Bounds3;
use surflux::receivers::Receivers;
use surflux::results::{Aov, AovBuffer, Results};
use surflux::scene::{Mesh, MeshId, PrimId, Scene};
use surflux::shading::Shader;
use surflux::trace::Tracer;

fn scene_of(meshes: Vec<Mesh>) -> Scene {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    for (i, mesh) in meshes.into_iter().enumerate() {
        builder.mesh(&format!("m{i}"), mesh, gray);
    }
    builder.build()
}

fn see(scene: &Scene, receivers: &Receivers, settings: &MapsSettings) -> Visibility {
    let plan = MapsPlan::new(scene);
    maps::visibility(
        &plan,
        receivers,
        settings,
        &Wanted::default(),
        &dense::quiet(),
    )
    .expect("not cancelled")
}

/// AOVs by maps with hand-over to rays of the same number, and by 4096 rays.
fn both(
    scene: &Scene,
    receivers: &Receivers,
    settings: &MapsSettings,
    aovs: &[Aov],
) -> [Results; 2] {
    let quiet = dense::quiet();
    let shader = Shader::new(scene, &quiet);
    let tracer = Tracer::new(scene);
    let with = GatherScene {
        shader: &shader,
        tracer: &tracer,
        lighting: None,
    };
    let rays = |rays| {
        RaysEngine::new(
            &tracer,
            None,
            RaysSettings {
                rays,
                max_distance: settings.max_distance,
                turn: 0.3,
                cone: None,
            },
        )
    };
    let plan = MapsPlan::new(scene);
    let ours = maps::gather(
        with,
        (&plan, settings),
        &rays(settings.directions),
        (receivers, aovs),
        &quiet,
    );
    let truth = gather(with, &rays(4096), receivers, aovs, &quiet);
    [ours.expect("not cancelled"), truth.expect("not cancelled")]
}

/// rms of the difference over the mean.
fn relative_rmse(values: &[f32], truth: &[f32]) -> f32 {
    let square: f32 = values
        .iter()
        .zip(truth)
        .map(|(a, b)| (a - b) * (a - b))
        .sum();
    let n = truth.len() as f32;
    (square / n).sqrt() / (truth.iter().sum::<f32>() / n)
}

fn visibility_error(scene: &Scene, receivers: &Receivers, settings: &MapsSettings) -> f32 {
    let [ours, truth] = both(scene, receivers, settings, &[Aov::Visibility]);
    relative_rmse(&ours.buffers[0].data, &truth.buffers[0].data)
}

fn every(receivers: &Receivers, step: usize) -> Receivers {
    receivers.subset(&(0..receivers.len()).step_by(step).collect::<Vec<_>>())
}

#[test]
fn a_ball_alone_sees_all_of_the_sky() {
    let ball = || bowl(Vec3::new(3.0, 1.0, 0.0), 0.5, PI, 24, Side::Outside);
    let scene = scene_of(vec![ball()]);
    let receivers = dense::vertices(&scene);
    for settings in [MapsSettings::default(), MapsSettings::SMOOTH] {
        let seen = see(&scene, &receivers, &settings);
        let least = seen.visibility.iter().copied().fold(1.0, f32::min);
        assert!(least > 0.999, "{least}");
    }
}

#[test]
fn perpendicular_plates_cover_their_configuration_factor() {
    let floor = plate(Vec3::ZERO, Vec3::Z, Vec3::X, 8);
    let wall = plate(Vec3::ZERO, Vec3::Y, Vec3::Z, 1);
    let scene = scene_of(vec![floor, wall]);
    let receivers = scenes::receivers_in(&scene, PrimId(0), 1);
    let settings = MapsSettings {
        directions: 1024,
        ..MapsSettings::default()
    };
    let seen = see(&scene, &receivers, &settings);
    let corners = [Vec3::ZERO, Vec3::Y, Vec3::new(0.0, 1.0, 1.0), Vec3::Z];
    for (i, &got) in seen.visibility.iter().enumerate() {
        let open = PI as f64 - polygon_irradiance(receivers.position[i], Vec3::Y, &corners);
        let exact = open / PI as f64;
        // 1024 directions: a step of the wall's outline is worth 1/1024, a few of them remain.
        assert!((f64::from(got) - exact).abs() < 6e-3, "{i}: {got} {exact}");
    }
}

#[test]
fn bumps_over_a_ground_match_rays() {
    let scene = dense::on_ground(dense::bumpy_ball(60, Vec3::ZERO), 16);
    let receivers = every(&dense::vertices(&scene), 37);
    let full = MapsSettings::default();
    assert!(visibility_error(&scene, &receivers, &full) < 0.012);
    let smooth = MapsSettings {
        directions: 256,
        pixel: 2.0,
        cell: 2.0,
        ..MapsSettings::SMOOTH
    };
    assert!(visibility_error(&scene, &receivers, &smooth) < 0.03);
}

#[test]
fn points_within_triangles_are_receivers_like_vertices() {
    let scene = dense::on_ground(dense::bumpy_ball(60, Vec3::ZERO), 16);
    let receivers = scenes::receivers_in(&scene, PrimId(1), 97);
    assert!(visibility_error(&scene, &receivers, &MapsSettings::default()) < 0.012);
}

#[test]
fn a_closed_room_is_dark_although_its_fronts_look_inwards() {
    let bounds = Bounds3 {
        min: Vec3::ZERO,
        max: Vec3::new(2.0, 1.0, 3.0),
    };
    let scene = scene_of(vec![room(bounds, 6)]);
    let receivers = scenes::receivers_in(&scene, PrimId(0), 1);
    let [ours, _] = both(
        &scene,
        &receivers,
        &MapsSettings::default(),
        &[Aov::Visibility],
    );
    let mean = ours.buffers[0].data.iter().sum::<f32>() / receivers.len() as f32;
    assert!(mean < 0.01, "{mean}");
    let ball = scene_of(vec![bowl(Vec3::ZERO, 1.0, PI, 40, Side::Inside)]);
    let receivers = every(&dense::vertices(&ball), 7);
    let [ours, _] = both(
        &ball,
        &receivers,
        &MapsSettings::default(),
        &[Aov::Visibility],
    );
    let mean = ours.buffers[0].data.iter().sum::<f32>() / receivers.len() as f32;
    assert!(mean < 0.01, "{mean}");
}

#[test]
fn a_flat_sheet_in_contact_covers_the_ground() {
    let ground = plate(Vec3::ZERO, Vec3::Z, Vec3::X, 16);
    let sheet = plate(
        Vec3::new(-0.5, 1e-4, -0.5),
        2.0 * Vec3::Z,
        2.0 * Vec3::X,
        16,
    );
    let scene = scene_of(vec![ground, sheet]);
    let receivers = scenes::receivers_in(&scene, PrimId(0), 5);
    let seen = see(&scene, &receivers, &MapsSettings::default());
    let most = seen.visibility.iter().copied().fold(0.0, f32::max);
    assert!(most < 2e-3, "{most}");
}

#[test]
fn curved_contact_and_coincident_surfaces_are_handed_over() {
    let ball = |r: f32| bowl(Vec3::ZERO, r, PI, 40, Side::Outside);
    // A skin 1e-4 over another: the inner one is dark.
    let skins = scene_of(vec![ball(1.0), ball(1.0001)]);
    let inner = every(&scenes::receivers_in(&skins, PrimId(0), 1), 11);
    let [ours, _] = both(&skins, &inner, &MapsSettings::default(), &[Aov::Visibility]);
    let most = ours.buffers[0].data.iter().copied().fold(0.0, f32::max);
    assert!(most < 0.02, "{most}");
    // Everything twice: as open as once.
    let twice = scene_of(vec![ball(1.0), ball(1.0)]);
    let receivers = every(&dense::vertices(&twice), 17);
    let [ours, _] = both(
        &twice,
        &receivers,
        &MapsSettings::default(),
        &[Aov::Visibility],
    );
    let least = ours.buffers[0].data.iter().copied().fold(1.0, f32::min);
    assert!(least > 0.98, "{least}");
}

#[test]
fn both_plates_of_one_thin_prim_see_what_rays_see() {
    // One mesh of two parallel plates close to each other: the space between is dark.
    let (mut low, high) = (
        plate(Vec3::ZERO, Vec3::Z, Vec3::X, 24),
        plate(Vec3::new(0.0, 0.02, 0.0), Vec3::Z, Vec3::X, 24),
    );
    let first = u32::try_from(low.positions.len()).unwrap();
    low.positions.extend(high.positions);
    low.triangles
        .extend(high.triangles.iter().map(|t| t.map(|i| i + first)));
    let plates = triangle_mesh(low.positions, low.triangles, Vec::new(), false);
    let scene = scene_of(vec![plates]);
    let receivers = scenes::receivers_in(&scene, PrimId(0), 7);
    assert!(visibility_error(&scene, &receivers, &MapsSettings::default()) < 0.03);
}

#[test]
fn instances_see_what_their_copies_see() {
    let ball = dense::bumpy_ball(30, Vec3::ZERO);
    let places = [
        Affine3A::from_translation(Vec3::new(-1.4, 0.0, 0.0)),
        Affine3A::from_scale_rotation_translation(
            Vec3::new(1.0, -0.8, 1.2),
            Quat::from_rotation_x(0.5),
            Vec3::new(1.3, 0.2, 0.4),
        ),
    ];
    let mut shared = scene_of(vec![ball.clone(), ball]);
    for (prim, place) in shared.prims.iter_mut().zip(places) {
        prim.mesh = MeshId(0);
        prim.world_from_object = place;
    }
    let receivers = every(&dense::vertices(&shared), 23);
    assert!(visibility_error(&shared, &receivers, &MapsSettings::default()) < 0.015);
}

#[test]
fn finite_distances_match_rays() {
    let scene = dense::on_ground(dense::bumpy_ball(40, Vec3::ZERO), 8);
    let receivers = every(&dense::vertices(&scene), 41);
    let settings = MapsSettings {
        max_distance: Some(0.6),
        ..MapsSettings::default()
    };
    assert!(visibility_error(&scene, &receivers, &settings) < 0.012);
}

#[test]
fn the_other_engine_is_asked_only_for_what_is_ambiguous() {
    let ask = |scene: &Scene| {
        let (plan, receivers) = (MapsPlan::new(scene), dense::vertices(scene));
        let aovs = [Aov::Visibility];
        let mut asked = 0;
        let mut other = |few: &Receivers, aovs: &[Aov]| {
            asked += few.len();
            let data = vec![7.0; few.len()];
            let buffers = vec![AovBuffer { aov: aovs[0], data }];
            Ok(Results {
                buffers,
                ..Results::default()
            })
        };
        let results = maps::gather_sky(
            (&plan, &MapsSettings::default()),
            None,
            (&receivers, &aovs),
            (&mut other, &|| unreachable!("no image of a sky is lit")),
            &dense::quiet(),
        )
        .expect("not cancelled");
        let theirs = results.buffers[0].data.iter().filter(|&&v| v == 7.0);
        assert_eq!(theirs.count(), asked);
        asked
    };
    let ball = || bowl(Vec3::ZERO, 1.0, PI, 40, Side::Outside);
    assert_eq!(ask(&scene_of(vec![ball()])), 0);
    assert!(ask(&scene_of(vec![ball(), ball()])) > 1000);
}

#[test]
fn bent_normals_and_all_other_aovs_come_in_the_order_asked_for() {
    let scene = dense::on_ground(dense::bumpy_ball(40, Vec3::ZERO), 8);
    let receivers = every(&dense::vertices(&scene), 41);
    let aovs = [Aov::Normal, Aov::BentNormal, Aov::Depth, Aov::Occlusion];
    let [ours, truth] = both(&scene, &receivers, &MapsSettings::default(), &aovs);
    let order: Vec<_> = ours.buffers.iter().map(|b| b.aov).collect();
    assert_eq!(order, aovs);
    assert_eq!(ours.buffers[0], truth.buffers[0]);
    let vectors = |r: &Results| {
        r.buffers[1]
            .data
            .chunks_exact(3)
            .map(Vec3::from_slice)
            .collect::<Vec<_>>()
    };
    let open = &truth.buffers[3].data;
    for ((a, b), occlusion) in vectors(&ours).iter().zip(vectors(&truth)).zip(open) {
        assert!(
            *occlusion > 0.8 || a.angle_between(b) < 0.06,
            "{a} {b} {occlusion}"
        );
    }
}

#[test]
fn harmonics_of_the_visibility_match_those_by_rays() {
    let scene = dense::on_ground(dense::bumpy_ball(40, Vec3::ZERO), 8);
    let receivers = every(&dense::vertices(&scene), 41);
    let aovs = [Aov::VisibilitySh];
    let [ours, truth] = both(&scene, &receivers, &MapsSettings::default(), &aovs);
    let pairs = ours.buffers[0].data.iter().zip(&truth.buffers[0].data);
    let square: f32 = pairs.map(|(a, b)| (a - b) * (a - b)).sum();
    let rms = (square / truth.buffers[0].data.len() as f32).sqrt();
    // √π is the constant coefficient of an open hemisphere; either engine has its directions' 1 %.
    assert!(rms < 0.02 * PI.sqrt(), "{rms}");
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let scene = dense::on_ground(dense::bumpy_ball(30, Vec3::ZERO), 8);
    let receivers = dense::vertices(&scene);
    let settings = MapsSettings {
        directions: 40,
        pixel: 1.5,
        cell: 1.5,
        ..MapsSettings::default()
    };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| see(&scene, &receivers, &settings))
    };
    assert_eq!(run(1), run(5));
}

#[test]
fn receivers_on_open_edges_and_degenerate_triangles_do_no_harm() {
    let scene = scene_of(vec![
        triangle_mesh(vec![Vec3::ZERO; 3], vec![[0, 1, 2]], Vec::new(), false),
        bowl(Vec3::ZERO, 1.0, 2.0, 30, Side::Inside),
    ]);
    let receivers = receivers_at(&scene, &[(PrimId(0), 0, 0.2, 0.2)]);
    let seen = see(&scene, &receivers, &MapsSettings::default());
    assert!(seen.visibility[0].is_finite());
    let receivers = dense::vertices(&scene);
    let rim = receivers.subset(&(receivers.len() - 60..receivers.len()).collect::<Vec<_>>());
    assert!(visibility_error(&scene, &rim, &MapsSettings::default()) < 0.03);
}

#[test]
fn a_uniform_sky_gives_pi_times_its_radiance_where_it_is_visible() {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    builder.mesh("ball", dense::bumpy_ball(40, Vec3::ZERO), gray);
    builder.sky(Vec3::new(1.0, 2.0, 0.0));
    let scene = builder.build();
    let receivers = every(&dense::vertices(&scene), 97);
    let quiet = dense::quiet();
    let shader = Shader::new(&scene, &quiet);
    let tracer = Tracer::new(&scene);
    let lighting = Lighting::new(&shader, LightSamples::default(), &quiet);
    assert!(!maps::needs_sky(
        Aov::IrradianceEnvironment,
        Some(&lighting)
    ));
    let with = GatherScene {
        shader: &shader,
        tracer: &tracer,
        lighting: Some(&lighting),
    };
    let rays = RaysEngine::new(&tracer, None, RaysSettings::default());
    let (plan, settings) = (MapsPlan::new(&scene), MapsSettings::default());
    let aovs = [Aov::IrradianceEnvironment, Aov::Visibility];
    let results = maps::gather(with, (&plan, &settings), &rays, (&receivers, &aovs), &quiet);
    let results = results.expect("not cancelled");
    let light = results.buffers[0].data.chunks_exact(3);
    for (light, visible) in light.zip(&results.buffers[1].data) {
        let expected = PI * visible * Vec3::new(1.0, 2.0, 0.0);
        assert!((Vec3::from_slice(light) - expected).length() < 1e-4);
    }
}
