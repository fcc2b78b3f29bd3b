//! The raster engine against closed forms and converged rays.

#[allow(dead_code, reason = "shared with other tests, which use the rest")]
#[path = "support/scenes.rs"]
mod scenes;

use glam::{DVec3, Vec3};
use scenes::{BOX, SceneBuilder, ball_in_a_box, plate, polygon_irradiance, receivers_in, room};
use std::f32::consts::PI;
use surflux::bake::{BakeSettings, Baked, bake};
use surflux::diagnostics::Diagnostics;
use surflux::gather::{
    DicedSurfels, Engine, GatherScene, Hemisphere, HitLight, RadianceSource, RasterEngine,
    RasterSettings, RaysEngine, RaysSettings, gather,
};
use surflux::lighting::{LightSamples, Lighting};
use surflux::math::Bounds3;
use surflux::octree::Octree;
use surflux::receivers::Receivers;
use surflux::results::Aov;
use surflux::scene::{PrimId, Scene};
use surflux::shading::Shader;
use surflux::trace::Tracer;

/// A scene whose surfels shine as told.
struct Fixture<'a> {
    scene: &'a Scene,
    tracer: Tracer,
    baked: Baked,
    octree: Octree,
}

impl<'a> Fixture<'a> {
    /// About `surfels` surfels of `scene` with the radiance that `light` gives by prim, place and normal.
    fn new(scene: &'a Scene, surfels: usize, light: impl Fn(u32, Vec3, Vec3) -> f32) -> Self {
        let diagnostics = Diagnostics::default();
        let shader = Shader::new(scene, &diagnostics);
        let tracer = Tracer::new(scene);
        let dark = Lighting::new(&shader, LightSamples::SURFEL, &diagnostics);
        let settings = BakeSettings {
            spacing: None,
            surfels,
            ..BakeSettings::default()
        };
        let mut baked =
            bake(&shader, &tracer, &dark, &settings, &diagnostics).expect("not cancelled");
        for i in 0..baked.cloud.len() {
            let cloud = &mut baked.cloud;
            let radiance = light(cloud.prim[i], cloud.position[i], cloud.normal[i]);
            cloud.radiosity[i] = Vec3::splat(PI * radiance);
            cloud.emission[i] = Vec3::ZERO;
        }
        let octree = Octree::new(&baked.cloud);
        Self {
            scene,
            tracer,
            baked,
            octree,
        }
    }

    /// What rays read, hits that are near lit by `near`.
    fn surfels<'b>(&'b self, near: Option<HitLight<'b>>) -> DicedSurfels<'b> {
        DicedSurfels::new(&self.baked.cloud, &self.baked.dice, near)
    }

    fn gather(&self, engine: &dyn Engine, receivers: &Receivers) -> Vec<f64> {
        let diagnostics = Diagnostics::default();
        let shader = Shader::new(self.scene, &diagnostics);
        let scene = GatherScene {
            shader: &shader,
            tracer: &self.tracer,
            lighting: None,
        };
        let aovs = [Aov::IrradianceIndirect];
        let seen = gather(scene, engine, receivers, &aovs, &diagnostics).expect("not cancelled");
        let data = &seen.buffers[0].data;
        data.chunks(3).map(|color| f64::from(color[1])).collect()
    }

    fn raster(&self, receivers: &Receivers, max_solid_angle: f32, resolution: u32) -> Vec<f64> {
        let settings = RasterSettings {
            max_solid_angle,
            raster_resolution: resolution,
            max_distance: None,
        };
        let engine = RasterEngine::new(&self.octree, &self.tracer, self.surfels(None), settings);
        self.gather(&engine, receivers)
    }

    fn rays(&self, receivers: &Receivers, rays: u32) -> Vec<f64> {
        let source = RadianceSource::Baked(self.surfels(None));
        let settings = RaysSettings {
            rays,
            turn: 0.3,
            max_distance: None,
            cone: None,
        };
        self.gather(
            &RaysEngine::new(&self.tracer, Some(source), settings),
            receivers,
        )
    }
}

fn relative_rmse(values: &[f64], truth: &[f64]) -> f64 {
    let square: f64 = values.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum();
    let mean = truth.iter().sum::<f64>() / truth.len() as f64;
    (square / truth.len() as f64).sqrt() / mean
}

/// Bright on top of the ball and in a spot on the floor with a sharp border, dim elsewhere.
fn spots(prim: u32, position: Vec3, normal: Vec3) -> f32 {
    let on_floor = position.y < -0.99 && position.distance(Vec3::new(-0.4, -1.0, 0.1)) < 0.5;
    let on_ball = prim == 1 && normal.y > 0.7;
    if on_floor || on_ball { 4.0 } else { 0.1 }
}

#[test]
fn a_furnace_is_as_bright_everywhere_as_its_walls() {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    let walls = builder.mesh("walls", room(BOX, 24), gray);
    let scene = builder.build();
    let fixture = Fixture::new(&scene, 20_000, |_, _, _| 1.0);
    let receivers = receivers_in(&scene, walls, 5);
    for (max_solid_angle, resolution, tolerance) in [(0.1, 12, 0.03), (0.01, 24, 0.01)] {
        let values = fixture.raster(&receivers, max_solid_angle, resolution);
        let truth = vec![f64::from(PI); values.len()];
        let error = relative_rmse(&values, &truth);
        assert!(error < tolerance, "{max_solid_angle}: {error}");
    }
}

#[test]
fn a_wall_lights_the_floor_beside_it_as_lambert_says() {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    let floor = plate(Vec3::ZERO, Vec3::Z, Vec3::X, 16);
    let floor = builder.mesh("floor", floor, gray);
    builder.mesh("wall", plate(Vec3::ZERO, Vec3::Y, Vec3::Z, 16), gray);
    let scene = builder.build();
    let fixture = Fixture::new(
        &scene,
        8_000,
        |prim, _, _| if prim == 1 { 1.0 } else { 0.0 },
    );
    let receivers = receivers_in(&scene, floor, 1);
    let corners = [Vec3::ZERO, Vec3::Y, Vec3::new(0.0, 1.0, 1.0), Vec3::Z];
    let truth: Vec<f64> = (receivers.position.iter().zip(&receivers.normal))
        .map(|(&place, &normal)| polygon_irradiance(place, normal, &corners))
        .collect();
    let values = fixture.raster(&receivers, 0.02, 36);
    let error = relative_rmse(&values, &truth);
    assert!(error < 0.01, "{error}");
    // The corner itself: the nearest row of receivers is half a surfel off the wall.
    for ((value, truth), place) in values.iter().zip(&truth).zip(&receivers.position) {
        assert!(
            (value / truth - 1.0).abs() < 0.08,
            "{place}: {value} {truth}"
        );
    }
}

#[test]
fn no_light_comes_through_walls_however_thin() {
    for thickness in [1e-3, 0.0] {
        let mut builder = SceneBuilder::new();
        let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
        let inner = builder.mesh("dark", room(BOX, 16), gray);
        let outer = Bounds3 {
            min: BOX.min - thickness,
            max: BOX.max + thickness,
        };
        builder.mesh("lit", room(outer, 16), gray);
        let around = Bounds3 {
            min: BOX.min * 2.0,
            max: BOX.max * 2.0,
        };
        builder.mesh("sky", room(around, 16), gray);
        let scene = builder.build();
        // Everything outside of the inner box shines, the outer sides of its walls too.
        let fixture = Fixture::new(&scene, 20_000, |prim, position, normal| {
            let outwards = position.dot(normal) > 0.0;
            if prim == 2 || outwards { 10.0 } else { 0.0 }
        });
        let receivers = receivers_in(&scene, inner, 7);
        for (max_solid_angle, resolution) in [(0.3, 6), (0.03, 12)] {
            let values = fixture.raster(&receivers, max_solid_angle, resolution);
            let lit = values.iter().filter(|&&value| value != 0.0).count();
            assert_eq!(
                lit, 0,
                "{thickness} {max_solid_angle}: {values:?} {:?}",
                receivers.position
            );
        }
    }
}

#[test]
fn errors_fall_towards_rays_as_knobs_tighten() {
    let scene = ball_in_a_box(24);
    let fixture = Fixture::new(&scene, 30_000, spots);
    let receivers = receivers_in(&scene, PrimId(0), 13);
    let truth = fixture.rays(&receivers, 65_536);
    let knobs = [(0.3, 6), (0.1, 12), (0.03, 24), (0.01, 48), (0.003, 96)];
    let errors: Vec<f64> = (knobs.iter())
        .map(|&(angle, resolution)| {
            relative_rmse(&fixture.raster(&receivers, angle, resolution), &truth)
        })
        .collect();
    assert!(errors.is_sorted_by(|a, b| a > b), "{errors:?}");
    assert!(errors[0] < 0.1 && errors[4] < 0.005, "{errors:?}");
}

#[test]
fn what_touches_the_floor_lights_it_and_shades_it() {
    let scene = ball_in_a_box(24);
    let fixture = Fixture::new(&scene, 60_000, |_, _, _| 1.0);
    let receivers = receivers_in(&scene, PrimId(1), 7);
    let truth = fixture.rays(&receivers, 8_192);
    let values = fixture.raster(&receivers, 0.02, 24);
    let error = relative_rmse(&values, &truth);
    assert!(error < 0.02, "{error}");
    let below = receivers.normal.iter().zip(values.iter().zip(&truth));
    for (normal, (value, truth)) in below.filter(|(normal, _)| normal.y < -0.9) {
        assert!(
            (value / truth - 1.0).abs() < 0.15,
            "{normal}: {value} {truth}"
        );
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let scene = ball_in_a_box(24);
    let fixture = Fixture::new(&scene, 10_000, spots);
    let receivers = receivers_in(&scene, PrimId(0), 3);
    let with_threads = |count| {
        let pool = rayon_pool(count);
        pool.install(|| fixture.raster(&receivers, 0.1, 12))
    };
    assert_eq!(with_threads(1), with_threads(5));
}

fn rayon_pool(count: usize) -> rayon::ThreadPool {
    let builder = rayon::ThreadPoolBuilder::new().num_threads(count);
    builder.build().expect("threads")
}

#[test]
fn a_small_step_changes_little() {
    let scene = ball_in_a_box(24);
    let fixture = Fixture::new(&scene, 20_000, spots);
    let here = receivers_in(&scene, PrimId(0), 5);
    let mut there = here.clone();
    for (place, normal) in there.position.iter_mut().zip(&here.normal) {
        // 1 % of the distance between receivers, along the wall.
        *place += normal.any_orthonormal_vector() * 1e-3;
    }
    let (a, b) = (
        fixture.raster(&here, 0.03, 12),
        fixture.raster(&there, 0.03, 12),
    );
    let change = relative_rmse(&b, &a);
    let own = relative_rmse(&a, &fixture.rays(&here, 8_192));
    assert!(change < 0.03 && change < 1.5 * own, "{change} {own}");
}

/// Receivers on the floor around the ball's foot, 8 × 8 of them a block.
fn tiles_on_the_floor(scene: &Scene) -> Receivers {
    let walls = receivers_in(scene, PrimId(0), 1);
    let floor = walls.normal.iter().position(|normal| normal.y > 0.99);
    let count = TILES * 8;
    let mut tiles = walls.subset(&vec![floor.expect("a floor"); count * count]);
    for i in 0..tiles.len() {
        let (tile, place) = (i / 64, i % 64);
        let x = tile % TILES * 8 + place % 8;
        let z = tile / TILES * 8 + place / 8;
        let at = |k: usize| 1.2 * (k as f32 / count as f32 - 0.5);
        tiles.position[i] = Vec3::new(0.2 + at(x), -1.0, 0.1 + at(z));
    }
    tiles
}

const TILES: usize = 12;

/// How far values of [`tiles_on_the_floor`] are from the mean of those to their left and right, over the mean of all:
/// 999 of 1000 are nearer. What light does by itself is less, but for the ball's foot, which is left out.
fn roughness(values: &[f64], receivers: &Receivers) -> f64 {
    let at = |x: usize, z: usize| (z / 8 * TILES + x / 8) * 64 + z % 8 * 8 + x % 8;
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let foot = Vec3::new(0.2, -1.0, 0.1);
    let mut steps = Vec::new();
    for (x, z) in (1..TILES * 8 - 1).flat_map(|x| (0..TILES * 8).map(move |z| (x, z))) {
        if receivers.position[at(x, z)].distance(foot) > 0.15 {
            let around = values[at(x - 1, z)] + values[at(x + 1, z)];
            steps.push((values[at(x, z)] - 0.5 * around).abs() / mean);
        }
    }
    steps.sort_by(f64::total_cmp);
    steps[steps.len() * 999 / 1000]
}

#[test]
fn no_borders_are_seen_between_receivers_that_share_their_work() {
    let scene = ball_in_a_box(24);
    let fixture = Fixture::new(&scene, 30_000, spots);
    let receivers = tiles_on_the_floor(&scene);
    let together = fixture.raster(&receivers, 0.2, 12);
    let settings = RasterSettings {
        max_solid_angle: 0.2,
        raster_resolution: 12,
        max_distance: None,
    };
    let engine = RasterEngine::new(
        &fixture.octree,
        &fixture.tracer,
        fixture.surfels(None),
        settings,
    );
    // Blocks that know nothing of each other do have borders.
    let mut alone = vec![0.0; receivers.len()];
    for start in (0..receivers.len()).step_by(64) {
        let scratch = &mut Hemisphere::default();
        engine.see(&receivers, start..start + 64, scratch, &mut |i, seen| {
            alone[i] = f64::from(PI * seen.reflected[0].y);
        });
    }
    let (together, alone) = (
        roughness(&together, &receivers),
        roughness(&alone, &receivers),
    );
    assert!(
        together < 0.04 && alone > 2.0 * together,
        "{together} {alone}"
    );
}

#[test]
fn dark_surfels_that_receivers_touch_are_lit_anew() {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    let floor = plate(Vec3::ZERO, Vec3::Z, Vec3::X, 16);
    let floor = builder.mesh("floor", floor, gray);
    builder.mesh("wall", plate(Vec3::ZERO, Vec3::Y, Vec3::Z, 16), gray);
    builder.sky(Vec3::ONE);
    let scene = builder.build();
    // As if no ray of any surfel had met the sky.
    let fixture = Fixture::new(&scene, 2_000, |_, _, _| 0.0);
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    let (tracer, dice) = (&fixture.tracer, &fixture.baked.dice);
    let light = HitLight::new(&shader, tracer, &lighting, dice);
    let source = RadianceSource::Baked(fixture.surfels(light));
    let settings = RaysSettings {
        rays: 4096,
        turn: 0.3,
        max_distance: None,
        cone: None,
    };
    let receivers = receivers_in(&scene, floor, 1);
    let truth = fixture.gather(&RaysEngine::new(tracer, Some(source), settings), &receivers);
    let settings = RasterSettings {
        raster_resolution: 32,
        ..RasterSettings::default()
    };
    let engine = RasterEngine::new(&fixture.octree, tracer, fixture.surfels(light), settings);
    let values = fixture.gather(&engine, &receivers);
    let lit = truth.iter().filter(|&&value| value > 0.0).count();
    let error = relative_rmse(&values, &truth);
    assert!(lit > 10 && error < 0.1, "{lit} {error}");
}

#[test]
fn far_from_the_origin_of_the_world_all_is_the_same() {
    let mut scene = ball_in_a_box(24);
    let near = Fixture::new(&scene, 5_000, spots);
    let receivers = receivers_in(&scene, PrimId(0), 31);
    let expected = near.raster(&receivers, 0.05, 12);
    scene.origin = DVec3::splat(1e6);
    let far = Fixture::new(&scene, 5_000, spots);
    let receivers = receivers_in(&scene, PrimId(0), 31);
    assert_eq!(far.raster(&receivers, 0.05, 12), expected);
}

#[test]
fn what_is_too_far_does_not_light() {
    let scene = ball_in_a_box(24);
    let fixture = Fixture::new(&scene, 5_000, |_, _, _| 1.0);
    let receivers = receivers_in(&scene, PrimId(0), 31);
    let settings = RasterSettings {
        max_distance: Some(1e-3),
        ..RasterSettings::default()
    };
    let engine = RasterEngine::new(
        &fixture.octree,
        &fixture.tracer,
        fixture.surfels(None),
        settings,
    );
    let values = fixture.gather(&engine, &receivers);
    assert!(values.iter().all(|&value| value == 0.0));
}
