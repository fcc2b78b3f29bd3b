//! Direct light at receivers and surfels, and the bake around it. `cargo bench --bench light`; items are points.

mod scenes;

use divan::Bencher;
use divan::counter::ItemsCount;
use scenes::{diced_box, displaced_ball, receivers, scene};
use surflux::bake::{BakeSettings, bake};
use surflux::diagnostics::Diagnostics;
use surflux::lighting::{LightSamples, Lighting, ShadePoint};
use surflux::scene::{Input, Material, MaterialId, Scene};
use surflux::shading::Shader;
use surflux::trace::Tracer;

fn main() {
    divan::main();
}

fn room() -> Scene {
    scene(vec![diced_box(32), displaced_ball(40)])
}

/// The same room lit by the ball.
fn glowing() -> Scene {
    let mut scene = room();
    scene.lights.clear();
    scene.materials.push(Material {
        emissive_color: Input::color(1.0, 1.0, 1.0),
        ..Material::default()
    });
    scene.prims[1].materials = surflux::scene::FaceMaterials::Whole(Some(MaterialId(1)));
    scene
}

/// Everything that lighting needs, for points on the walls.
fn with_points(scene: &Scene, work: impl Fn(&Shader<'_>, &Tracer, &Lighting, &[ShadePoint])) {
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    let points: Vec<_> = (receivers(&scene.meshes[0], 2048).into_iter())
        .map(|(position, normal)| ShadePoint {
            position,
            normal,
            geometric_normal: normal,
            smooth_offset: None,
        })
        .collect();
    work(&shader, &Tracer::new(scene), &lighting, &points);
}

#[divan::bench(sample_count = 5)]
fn rect_light_at_receivers(bencher: Bencher<'_, '_>) {
    let bencher = std::cell::RefCell::new(Some(bencher));
    with_points(&room(), |_, tracer, lighting, points| {
        let bencher = bencher.take().expect("called once");
        bencher
            .counter(ItemsCount::new(points.len()))
            .bench_local(|| {
                let light = points.iter().map(|point| lighting.lights(tracer, point));
                light.sum::<glam::Vec3>()
            });
    });
}

#[divan::bench(sample_count = 5)]
fn rect_light_at_a_glance(bencher: Bencher<'_, '_>) {
    let bencher = std::cell::RefCell::new(Some(bencher));
    with_points(&room(), |_, tracer, lighting, points| {
        let lighting = lighting.for_surfels();
        let bencher = bencher.take().expect("called once");
        bencher
            .counter(ItemsCount::new(points.len()))
            .bench_local(|| {
                let glances = (points.iter().enumerate())
                    .map(|(number, point)| lighting.glance(tracer, point, number));
                glances.sum::<glam::Vec3>()
            });
    });
}

#[divan::bench(sample_count = 5)]
fn glowing_ball_at_receivers(bencher: Bencher<'_, '_>) {
    let bencher = std::cell::RefCell::new(Some(bencher));
    with_points(&glowing(), |shader, tracer, lighting, points| {
        let bencher = bencher.take().expect("called once");
        bencher
            .counter(ItemsCount::new(points.len()))
            .bench_local(|| {
                let light = (points.iter()).map(|point| lighting.emitters(shader, tracer, point));
                light.sum::<glam::Vec3>()
            });
    });
}

#[divan::bench(sample_count = 3)]
fn bake_200_000_surfels(bencher: Bencher<'_, '_>) {
    let (scene, diagnostics) = (room(), Diagnostics::default());
    let shader = Shader::new(&scene, &diagnostics);
    let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
    let tracer = Tracer::new(&scene);
    let settings = BakeSettings::default();
    let run = || bake(&shader, &tracer, &lighting, &settings, &diagnostics);
    let count = run().expect("not cancelled").cloud.len();
    bencher.counter(ItemsCount::new(count)).bench_local(run);
}
