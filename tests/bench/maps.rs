//! Depth maps, whole and by their parts, on a bumpy ball of 1.08 million triangles over a ground. `cargo bench --bench
//! maps`, with `RAYON_NUM_THREADS=1` for the work and without for the wait. Items are triangles where maps are drawn,
//! looks where they are looked at, receivers where all is done.

#[allow(dead_code, reason = "shared with tests, which use the rest")]
#[path = "../support/dense.rs"]
mod dense;
#[allow(dead_code, reason = "shared with tests, which use the rest")]
#[path = "../support/scenes.rs"]
mod scenes;

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::Vec3;
use surflux::gather::maps::{self, MapsPlan, MapsSettings, Wanted};
use surflux::receivers::Receivers;
use surflux::scene::Scene;

fn main() {
    divan::main();
}

/// Quads along an edge of the cube that the dense ball is made of: 1.08 million triangles, 540 thousand vertices.
const DENSE: u16 = 300;

/// Axes in benchmarks of a part.
const AXES: u32 = 16;

fn ball(cells: u16) -> Scene {
    dense::on_ground(dense::bumpy_ball(cells, Vec3::ZERO), 64)
}

fn see(plan: &MapsPlan<'_>, receivers: &Receivers, settings: &MapsSettings) -> f32 {
    let wanted = Wanted::default();
    let seen = maps::visibility(plan, receivers, settings, &wanted, &dense::quiet());
    seen.expect("not cancelled").visibility[0]
}

fn smooth(directions: u32) -> MapsSettings {
    MapsSettings {
        directions,
        ..MapsSettings::SMOOTH
    }
}

#[divan::bench(sample_count = 5, sample_size = 1)]
fn plan(bencher: Bencher<'_, '_>) {
    let scene = ball(DENSE);
    bencher
        .counter(ItemsCount::new(scene.triangle_count()))
        .bench_local(|| MapsPlan::new(&scene).edge());
}

/// One direction: next to nothing is drawn. A plan keeps what was thinned.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn decimate(bencher: Bencher<'_, '_>) {
    let scene = ball(DENSE);
    let one = dense::vertices(&scene).subset(&[0]);
    bencher
        .counter(ItemsCount::new(scene.triangle_count()))
        .with_inputs(|| MapsPlan::new(&scene))
        .bench_local_refs(|plan| see(plan, &one, &smooth(1)));
}

/// All triangles at a pixel an edge, no decimation, one receiver.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn raster(bencher: Bencher<'_, '_>) {
    let scene = ball(DENSE);
    let one = dense::vertices(&scene).subset(&[0]);
    let plan = MapsPlan::new(&scene);
    let settings = MapsSettings {
        directions: AXES,
        ..MapsSettings::default()
    };
    bencher
        .counter(ItemsCount::new(scene.triangle_count() * AXES as usize))
        .bench_local(|| see(&plan, &one, &settings));
}

/// Receivers of the dense ball look at maps of a coarse one.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn look(bencher: Bencher<'_, '_>) {
    let receivers = dense::vertices(&ball(DENSE));
    let coarse = ball(10);
    let plan = MapsPlan::new(&coarse);
    let settings = MapsSettings {
        directions: 128,
        pixel: 0.1,
        ..MapsSettings::default()
    };
    bencher
        .counter(ItemsCount::new(receivers.len() * 128))
        .bench_local(|| see(&plan, &receivers, &settings));
}

#[divan::bench(args = [64, 128, 256], sample_count = 3, sample_size = 1)]
fn whole(bencher: Bencher<'_, '_>, directions: u32) {
    let scene = ball(DENSE);
    let receivers = dense::vertices(&scene);
    bencher
        .counter(ItemsCount::new(receivers.len()))
        .bench_local(|| see(&MapsPlan::new(&scene), &receivers, &smooth(directions)));
}
