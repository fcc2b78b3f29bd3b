//! Direct light at receivers and surfels, and the bake around it. `cargo bench --bench light`; items are points.

mod scenes;

use divan::Bencher;
use divan::counter::ItemsCount;
use scenes::{diced_box, displaced_ball, receivers, scene};
use surflux::bake::{BakeSettings, bake};
use surflux::diagnostics::Diagnostics;
use surflux::lighting::{LightSamples, Lighting, ShadePoint};
use surflux::scene::{Input, LightKind, Material, MaterialId, Scene};
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

/// The ball in the open under a map with a sun; keep the folder as long as the scene.
fn under_a_sky() -> (Scene, tempfile::TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sky.exr");
    let texel = |x: usize, y: usize| {
        let sun = if (x, y) == (100, 70) { 1e5 } else { 0.0 };
        (sun + 0.5, sun + 0.7, sun + 1.0 - y as f32 / 256.0)
    };
    exr::prelude::write_rgb_file(&path, 512, 256, texel).expect("written");
    let mut scene = scene(vec![displaced_ball(40)]);
    scene.lights[0].kind = LightKind::Dome {
        texture: Some(path.as_path().into()),
    };
    (scene, folder)
}

#[divan::bench(sample_count = 5)]
fn sky_at_receivers(bencher: Bencher<'_, '_>) {
    let (scene, _folder) = under_a_sky();
    let bencher = std::cell::RefCell::new(Some(bencher));
    with_points(&scene, |_, tracer, lighting, points| {
        let bencher = bencher.take().expect("called once");
        bencher
            .counter(ItemsCount::new(points.len()))
            .bench_local(|| lighting.environment_of(tracer, points, f32::INFINITY));
    });
}

/// The map read and both sets built.
#[divan::bench(sample_count = 5)]
fn sky_of_512_by_256(bencher: Bencher<'_, '_>) {
    let (scene, _folder) = under_a_sky();
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&scene, &diagnostics);
    bencher.bench_local(|| Lighting::new(&shader, LightSamples::default(), &diagnostics));
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
            prim: None,
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
        let lighting = lighting.for_surfels(true);
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
