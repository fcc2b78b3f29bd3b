//! The raster engine beside rays and the paper's: µs a receiver and the error of the indirect irradiance against converged
//! rays, on a stage. `cargo bench --bench raster -- STAGE [SURFELS [PIXELS ACROSS, 0: POINTS OF MESHES]]`, with
//! `RAYON_NUM_THREADS=1`. Without a stage: a lit box around a ball.

#[allow(dead_code, reason = "shared with other benchmarks, which use the rest")]
mod scenes;

use scenes::{diced_box, displaced_ball, scene};
use surflux::bake::{BakeSettings, bake};
use surflux::diagnostics::Diagnostics;
use surflux::gather::estimate::spread;
use surflux::gather::paper::{PaperEngine, PaperSettings};
use surflux::gather::{
    DicedSurfels, Engine, GatherScene, RadianceSource, RasterEngine, RasterSettings, RaysEngine,
    RaysSettings, gather,
};
use surflux::lighting::{LightSamples, Lighting};
use surflux::octree::Octree;
use surflux::pilot::clock::Clock;
use surflux::receivers::{Receivers, camera, lens::Frame, primvar};
use surflux::results::{Aov, BakeInterpolation};
use surflux::scene::{PrimId, Scene};
use surflux::shading::Shader;
use surflux::stage::{self, Door, ReadSettings};
use surflux::trace::Tracer;

/// Solid angle and resolution.
const KNOBS: [(f32, u32); 6] = [
    (0.4, 8),
    (0.2, 12),
    (0.1, 12),
    (0.02, 24),
    (0.03, 24),
    (0.03, 48),
];

/// Rounds, one engine after the other; medians are told.
const ROUNDS: usize = 3;

fn main() {
    let arguments: Vec<String> = std::env::args().filter(|a| !a.starts_with("--")).collect();
    let number = |i: usize, usual: usize| {
        let given = arguments.get(i).and_then(|text| text.parse().ok());
        given.unwrap_or(usual)
    };
    let scene = arguments.get(1).map_or_else(
        || scene(vec![diced_box(32), displaced_ball(40)]),
        |path| read(path),
    );
    compare(&scene, number(2, 100_000), number(3, 256));
}

fn read(path: &str) -> Scene {
    let diagnostics = Diagnostics::default();
    let mut source = stage::open(path.as_ref(), Door::Native, &diagnostics).expect("a stage");
    let settings = ReadSettings {
        materials: true,
        lights: true,
        ..ReadSettings::default()
    };
    stage::read(source.as_mut(), &settings, &diagnostics).expect("a stage")
}

fn receivers(scene: &Scene, tracer: &Tracer, width: usize) -> Receivers {
    if width == 0 {
        let prims: Vec<PrimId> = (0..).map(PrimId).take(scene.prims.len()).collect();
        return primvar::place(scene, &prims, BakeInterpolation::Vertex);
    }
    let eye = scene.cameras.first().cloned();
    let eye = eye.unwrap_or_else(|| camera::framing_camera(scene));
    let width = u32::try_from(width).expect("a picture");
    camera::place(scene, tracer, &eye, Frame::new(width, width), 1)
}

#[expect(
    clippy::print_stdout,
    clippy::too_many_lines,
    reason = "one table, row by row"
)]
fn compare(scene: &Scene, surfels: usize, width: usize) {
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(scene, &diagnostics);
    let tracer = Tracer::new(scene);
    let lighting = Lighting::new(&shader, LightSamples::SURFEL, &diagnostics);
    let settings = BakeSettings {
        spacing: None,
        surfels,
        ..BakeSettings::default()
    };
    let baked = bake(&shader, &tracer, &lighting, &settings, &diagnostics).expect("not cancelled");
    let octree = Octree::new(&baked.cloud);
    let all = receivers(scene, &tracer, width);
    println!("{} surfels, {} receivers", baked.cloud.len(), all.len());
    let diced = DicedSurfels::new(&baked.cloud, &baked.dice, None);
    let rays = |rays, turn| {
        let source = RadianceSource::Baked(diced.clone());
        let settings = RaysSettings {
            rays,
            turn,
            max_distance: None,
            cone: None,
        };
        Box::new(RaysEngine::new(&tracer, Some(source), settings)) as Box<dyn Engine>
    };
    let mut engines: Vec<(String, Box<dyn Engine>)> = [64, 256, 1024]
        .iter()
        .map(|&count| (format!("rays {count}"), rays(count, 0.0)))
        .collect();
    for (max_solid_angle, raster_resolution) in [(0.1, 8), (0.03, 12)] {
        let settings = PaperSettings {
            max_solid_angle,
            raster_resolution,
            max_distance: None,
        };
        let name = format!("paper {max_solid_angle} {raster_resolution}");
        engines.push((name, Box::new(PaperEngine::new(&octree, settings))));
    }
    for (max_solid_angle, raster_resolution) in KNOBS {
        let settings = RasterSettings {
            max_solid_angle,
            raster_resolution,
            max_distance: None,
        };
        let engine = RasterEngine::new(&octree, &tracer, diced.clone(), settings);
        let name = format!("raster {max_solid_angle} {raster_resolution}");
        engines.push((name, Box::new(engine)));
    }
    let gather_with = |engine: &dyn Engine, receivers: &Receivers| -> Vec<f64> {
        let scene = GatherScene {
            shader: &shader,
            tracer: &tracer,
            lighting: Some(&lighting),
        };
        let aovs = [Aov::IrradianceIndirect];
        let seen = gather(scene, engine, receivers, &aovs, &diagnostics).expect("not cancelled");
        seen.buffers[0].data.iter().map(|&x| f64::from(x)).collect()
    };
    let picks = spread(all.len(), 512);
    let truth = gather_with(rays(16_384, 0.3).as_ref(), &all.subset(&picks));
    let mut times = vec![Vec::new(); engines.len()];
    let mut errors = vec![(0.0, 0.0); engines.len()];
    for _ in 0..ROUNDS {
        for (k, (_, engine)) in engines.iter().enumerate() {
            let clock = Clock::start();
            let values = gather_with(engine.as_ref(), &all);
            times[k].push(1e6 * clock.seconds() / all.len() as f64);
            errors[k] = error(&values, &truth, &picks);
        }
    }
    for (k, (name, _)) in engines.iter().enumerate() {
        times[k].sort_by(f64::total_cmp);
        let (rmse, bias) = errors[k];
        let time = times[k][ROUNDS / 2];
        println!(
            "{name:16} {time:8.2} µs  {:6.3} %  bias {:+.3} %",
            100.0 * rmse,
            100.0 * bias
        );
    }
}

/// Relative RMSE and bias of `values` at `picks`, three channels each.
fn error(values: &[f64], truth: &[f64], picks: &[usize]) -> (f64, f64) {
    let found = picks.iter().flat_map(|&i| &values[3 * i..3 * i + 3]);
    let mean = truth.iter().sum::<f64>() / truth.len() as f64;
    let differences: Vec<f64> = found.zip(truth).map(|(a, b)| (a - b) / mean).collect();
    let count = differences.len() as f64;
    let square: f64 = differences.iter().map(|d| d * d).sum();
    (
        (square / count).sqrt(),
        differences.iter().sum::<f64>() / count,
    )
}
