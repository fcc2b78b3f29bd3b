//! The pilot: what it takes to choose an engine and its settings for a tolerance. `cargo bench --bench pilot`, with
//! `RAYON_NUM_THREADS=1` for the work. Items are the receivers that it looks at.

#[allow(dead_code, reason = "shared with tests, which use the rest")]
#[path = "../support/dense.rs"]
mod dense;
#[allow(dead_code, reason = "shared with tests, which use the rest")]
#[path = "../support/scenes.rs"]
mod scenes;

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::Vec3;
use scenes::{SceneBuilder, Side, bowl, plate, room};
use surflux::bake::{BakeSettings, bake};
use surflux::gather::maps::MapsPlan;
use surflux::gather::{DicedSurfels, GatherScene, RadianceSource, RaysEngine, RaysSettings};
use surflux::lighting::{LightSamples, Lighting};
use surflux::math::Bounds3;
use surflux::pilot::{LightScenes, Maps, Method, Outcome, Pilot, choose, picks};
use surflux::receivers::Receivers;
use surflux::results::Aov;
use surflux::scene::Scene;
use surflux::shading::Shader;
use surflux::trace::Tracer;

fn main() {
    divan::main();
}

const TOLERANCES: [f64; 3] = [0.05, 0.02, 0.01];

/// Quads along an edge of the cube that the dense ball is made of: 1.08 million triangles, 540 thousand vertices.
const DENSE: u16 = 300;

/// A box lit by a glowing panel below its ceiling, with a ball.
fn lit_room() -> Scene {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    let glow = builder.material(Vec3::ZERO, Vec3::splat(5.0));
    let walls = Bounds3 {
        min: Vec3::splat(-1.0),
        max: Vec3::splat(1.0),
    };
    builder.mesh("walls", room(walls, 32), gray);
    let ball = bowl(
        Vec3::NEG_Y * 0.5,
        0.5,
        std::f32::consts::PI,
        32,
        Side::Outside,
    );
    builder.mesh("ball", ball, gray);
    let panel = plate(Vec3::new(-0.3, 0.98, -0.3), Vec3::X * 0.6, Vec3::Z * 0.6, 2);
    builder.mesh("panel", panel, glow);
    builder.build()
}

/// What all that is asked for has in common.
struct Question<'a> {
    scene: GatherScene<'a>,
    source: Option<RadianceSource<'a>>,
    receivers: &'a Receivers,
    maps: Maps<'a>,
}

impl Question<'_> {
    fn choose(&self, aov: Aov, tolerance: f64) -> Outcome {
        let rays = |rays, turn| {
            let settings = RaysSettings {
                rays,
                turn,
                ..RaysSettings::default()
            };
            let engine = RaysEngine::new(self.scene.tracer, self.source.clone(), settings);
            Box::new(engine) as Box<dyn Method>
        };
        let pilot = Pilot {
            scenes: LightScenes {
                run: self.scene,
                finer: None,
            },
            receivers: self.receivers,
            aovs: &[aov],
            tolerance,
            evened: 1.0,
            rays: &rays,
            share: &|_| Ok(None),
            thinning: None,
            candidates: &[],
            maps: self.maps,
            surfel_errors: &[],
        };
        choose(&pilot, &dense::quiet()).expect("not cancelled")
    }

    fn run(&self, bencher: Bencher<'_, '_>, aov: Aov, tolerance: f64) {
        bencher
            .counter(ItemsCount::new(picks(self.receivers.len()).len()))
            .bench_local(|| self.choose(aov, tolerance).rays);
    }
}

/// Between maps and rays.
#[divan::bench(args = TOLERANCES, sample_count = 3, sample_size = 1)]
fn visibility_of_a_dense_ball(bencher: Bencher<'_, '_>, tolerance: f64) {
    let scene = dense::on_ground(dense::bumpy_ball(DENSE, Vec3::ZERO), 64);
    let (shader, tracer) = (Shader::new(&scene, &dense::quiet()), Tracer::new(&scene));
    let plan = MapsPlan::new(&scene);
    let question = Question {
        scene: GatherScene {
            shader: &shader,
            tracer: &tracer,
            lighting: None,
        },
        source: None,
        receivers: &dense::vertices(&scene),
        maps: Maps::IfCheaper(&plan, None),
    };
    question.run(bencher, Aov::Visibility, tolerance);
}

/// How many rays light that comes back from surfaces needs.
#[divan::bench(args = TOLERANCES, sample_count = 3, sample_size = 1)]
fn light_in_a_room(bencher: Bencher<'_, '_>, tolerance: f64) {
    let (scene, diagnostics) = (lit_room(), dense::quiet());
    let (shader, tracer) = (Shader::new(&scene, &diagnostics), Tracer::new(&scene));
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    let settings = BakeSettings::default();
    let baked = bake(&shader, &tracer, &lighting, &settings, &diagnostics).expect("not cancelled");
    let question = Question {
        scene: GatherScene {
            shader: &shader,
            tracer: &tracer,
            lighting: Some(&lighting),
        },
        source: Some(RadianceSource::Baked(DicedSurfels::new(
            &baked.cloud,
            &baked.dice,
            None,
        ))),
        receivers: &dense::vertices(&scene),
        maps: Maps::Never,
    };
    question.run(bencher, Aov::IrradianceIndirect, tolerance);
}
