//! Maps under an environment with an image: against rays in very many cells of the sky.

use crate::dense;
use crate::sky::lit;
use crate::speed::{errors, interpolate, median_cpu};
use glam::Vec3;
use surflux::gather::maps::{self, MapsPlan, MapsSettings, MapsSky, SkyWanted, Wanted};
use surflux::gather::{GatherScene, RaysEngine, RaysSettings, gather};
use surflux::lighting::{LightSamples, Lighting};
use surflux::receivers::Receivers;
use surflux::results::{Aov, Results};
use surflux::scene::Scene;
use surflux::shading::Shader;
use surflux::trace::Tracer;
use tempfile::TempDir;

/// A scene made ready.
struct World<'a> {
    shader: Shader<'a>,
    tracer: Tracer,
    plan: MapsPlan<'a>,
    lighting: Lighting,
}

impl<'a> World<'a> {
    fn new(scene: &'a Scene) -> Self {
        let shader = Shader::new(scene, &dense::quiet());
        Self {
            lighting: Lighting::new(&shader, LightSamples::default(), &dense::quiet()),
            tracer: Tracer::new(scene),
            plan: MapsPlan::new(scene),
            shader,
        }
    }

    fn scene<'s>(&'s self, lighting: &'s Lighting) -> GatherScene<'s> {
        GatherScene {
            shader: &self.shader,
            tracer: &self.tracer,
            lighting: Some(lighting),
        }
    }

    fn maps(&self, receivers: &Receivers, aovs: &[Aov], settings: &MapsSettings) -> Results {
        let rays = RaysEngine::new(&self.tracer, None, RaysSettings::default());
        maps::gather(
            self.scene(&self.lighting),
            (&self.plan, settings),
            &rays,
            (receivers, aovs),
            &dense::quiet(),
        )
        .expect("not cancelled")
    }

    /// With `finer` times the usual cells of the sky.
    fn rays(&self, receivers: &Receivers, aovs: &[Aov], finer: u32) -> Results {
        let usual = LightSamples::default();
        let samples = LightSamples {
            environment: finer * usual.environment,
            ..usual
        };
        let lighting = Lighting::new(&self.shader, samples, &dense::quiet());
        let rays = RaysEngine::new(&self.tracer, None, RaysSettings::default());
        gather(
            self.scene(&lighting),
            &rays,
            receivers,
            aovs,
            &dense::quiet(),
        )
        .expect("not cancelled")
    }
}

fn settings(directions: u32) -> MapsSettings {
    MapsSettings {
        directions,
        ..MapsSettings::default()
    }
}

fn ball() -> (Scene, TempDir) {
    lit(dense::on_ground(dense::bumpy_ball(60, Vec3::ZERO), 16))
}

#[test]
fn light_of_a_sky_with_a_sun_converges_to_that_of_rays() {
    let (scene, _folder) = ball();
    let world = World::new(&scene);
    let receivers = crate::every(&dense::vertices(&scene), 37);
    let aovs = [Aov::IrradianceEnvironment];
    let truth = &world.rays(&receivers, &aovs, 16).buffers[0].data;
    let by_rays = crate::relative_rmse(&world.rays(&receivers, &aovs, 1).buffers[0].data, truth);
    let mut errors = Vec::new();
    for directions in [16, 64, 256] {
        let found = &world.maps(&receivers, &aovs, &settings(directions)).buffers[0].data;
        errors.push(crate::relative_rmse(found, truth));
    }
    // Measured: 3.3, 1.2, 0.44 %, and 0.92 % by rays in 256 cells.
    let falls = errors.windows(2).all(|pair| pair[1] < 0.6 * pair[0]);
    assert!(falls && errors[2] < 0.007, "{errors:?} {by_rays}");
}

#[test]
fn light_comes_from_where_rays_see_it_come_from() {
    let (scene, _folder) = ball();
    let world = World::new(&scene);
    let receivers = crate::every(&dense::vertices(&scene), 97);
    let aovs = [Aov::IlluminationDirection, Aov::IrradianceEnvironment];
    let truth = world.rays(&receivers, &aovs, 4);
    let found = world.maps(&receivers, &aovs, &settings(256));
    let vectors = |results: &Results, k: usize| -> Vec<Vec3> {
        let values = results.buffers[k].data.chunks_exact(3);
        values.map(Vec3::from_slice).collect()
    };
    let light = vectors(&truth, 1);
    let bright = light.iter().map(|light| light.element_sum()).sum::<f32>() / light.len() as f32;
    let pairs = vectors(&found, 0).into_iter().zip(vectors(&truth, 0));
    for ((a, b), light) in pairs.zip(&light) {
        let angle = a.angle_between(b);
        assert!(
            angle < 0.1 || light.element_sum() < 0.1 * bright,
            "{angle} {light}"
        );
    }
}

#[test]
fn receivers_that_maps_cannot_judge_get_the_light_of_rays() {
    let (scene, _folder) = ball();
    let world = World::new(&scene);
    let receivers = crate::every(&dense::vertices(&scene), 97);
    let aovs = [Aov::IrradianceEnvironment, Aov::IlluminationDirection];
    // No share of uncertain verdicts is small enough.
    let none = MapsSettings {
        ambiguous: -1.0,
        ..settings(16)
    };
    let found = world.maps(&receivers, &aovs, &none);
    assert_eq!(found, world.rays(&receivers, &aovs, 1));
}

#[test]
fn any_number_of_threads_sees_the_same_sky() {
    let (scene, _folder) = lit(dense::on_ground(dense::bumpy_ball(20, Vec3::ZERO), 8));
    let receivers = dense::vertices(&scene);
    let aovs = [Aov::IrradianceEnvironment, Aov::IlluminationDirection];
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        pool.install(|| World::new(&scene).maps(&receivers, &aovs, &settings(40)))
    };
    assert_eq!(run(1), run(5));
}

/// Directions, pixel, cell, bias, and cells of the sky that rays would look along.
const MEASURED: [(u32, f32, f32, f32, u32); 14] = [
    (32, 1.0, 0.0, 0.5, 64),
    (64, 1.0, 0.0, 0.5, 64),
    (128, 1.0, 0.0, 0.5, 64),
    (64, 2.0, 2.0, 1.0, 128),
    (64, 1.0, 0.0, 0.5, 128),
    (128, 2.0, 2.0, 1.0, 128),
    (128, 1.0, 0.0, 0.5, 128),
    (256, 1.0, 0.0, 0.5, 128),
    (64, 1.0, 0.0, 0.5, 256),
    (128, 1.0, 0.0, 0.5, 256),
    (256, 1.0, 0.0, 0.5, 256),
    (256, 0.5, 0.0, 0.5, 256),
    (256, 1.0, 0.0, 0.5, 512),
    (512, 1.0, 0.0, 0.5, 512),
];

/// `RAYON_NUM_THREADS=1 cargo test --test maps image -- --ignored --nocapture --test-threads=1`
#[test]
#[ignore = "a measurement, minutes"]
fn cost_and_error_of_the_light_of_a_sky() {
    let ball = dense::on_ground(dense::bumpy_ball(150, Vec3::ZERO), 32);
    measure("bumpy ball on ground", ball);
    if let Some(mesh) = dense::shared_mesh("stanford-bunny") {
        measure("stanford-bunny", dense::on_ground(mesh, 60));
    }
}

#[expect(clippy::print_stdout, reason = "a measurement's only result")]
fn measure(name: &str, scene: Scene) {
    let (scene, _folder) = lit(scene);
    let mut world = World::new(&scene);
    let receivers = dense::vertices(&scene);
    let aovs = [Aov::IrradianceEnvironment];
    let picked: Vec<usize> = (0..400)
        .map(|k| (k * 2_654_435_761_usize) % receivers.len())
        .collect();
    let truth = world.rays(&receivers.subset(&picked), &aovs, 32);
    let error = |found: &Results| {
        let few = |results: &Results| -> Vec<f32> {
            let values = &results.buffers[0].data;
            (picked.iter())
                .flat_map(|&i| values[3 * i..][..3].to_vec())
                .collect()
        };
        errors(&few(found), &truth.buffers[0].data)
    };
    let microseconds = |seconds: f64| 1e6 * seconds / receivers.len() as f64;
    println!("{name}: {} vertices", receivers.len());
    let mut law = Vec::new();
    let rays = RaysEngine::new(&world.tracer, None, RaysSettings::default());
    let samples = |environment: u32| LightSamples {
        environment,
        ..LightSamples::default()
    };
    for cells in [32, 64, 128, 256, 512, 1024] {
        let lighting = Lighting::new(&world.shader, samples(cells), &dense::quiet());
        let scene = world.scene(&lighting);
        let (found, seconds) = median_cpu(|| {
            gather(scene, &rays, &receivers, &aovs, &dense::quiet()).expect("not cancelled")
        });
        let (error, us) = (error(&found), microseconds(seconds));
        println!("  rays {cells:5}: {us:7.2} us/v  {error}");
        law.push((error.rmse.ln(), us.ln()));
    }
    parts(&world, &receivers);
    for (directions, pixel, cell, bias, cells) in MEASURED {
        world.lighting = Lighting::new(&world.shader, samples(cells), &dense::quiet());
        let settings = MapsSettings {
            pixel,
            cell,
            bias,
            ..settings(directions)
        };
        let (found, seconds) = median_cpu(|| world.maps(&receivers, &aovs, &settings));
        let (error, us) = (error(&found), microseconds(seconds));
        let ratio = interpolate(&law, error.rmse) / us;
        println!(
            "  maps {directions:4} p {pixel} c {cell} b {bias} sky {cells:4}: {us:7.2} us/v  {error}  {ratio:.2}x"
        );
    }
}

/// What the parts of maps under a sky cost.
#[expect(clippy::print_stdout, reason = "a measurement's only result")]
fn parts(world: &World<'_>, receivers: &Receivers) {
    let (quiet, settings) = (dense::quiet(), MapsSettings::default());
    let (sky, set_up) = median_cpu(|| MapsSky::new(&world.lighting, &settings));
    let place = (world.shader.scene(), &world.tracer);
    let bright = median_cpu(|| sky.bright_light(place, receivers, &quiet)).1;
    let see = |environment: Option<SkyWanted<'_>>| {
        let wanted = Wanted {
            environment,
            ..Wanted::default()
        };
        median_cpu(|| maps::visibility(&world.plan, receivers, &settings, &wanted, &quiet)).1
    };
    let open = see(None);
    let lit = see(Some(SkyWanted {
        sky: &sky,
        with_direction: false,
    }));
    let each = |seconds: f64| 1e6 * seconds / receivers.len() as f64;
    println!(
        "  256 directions: sky divided in {set_up:.3} s; a vertex: visibility {:.2}, with light {:.2}, bright rays {:.2} us",
        each(open),
        each(lit),
        each(bright)
    );
}
