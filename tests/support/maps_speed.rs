//! What maps cost and how far off they are, against rays on the same scene in one run. Ignored: minutes.
//!
//! `RAYON_NUM_THREADS=1 cargo test --test maps -- --ignored --nocapture --test-threads=1`

use crate::dense;
use surflux::gather::maps::{MapsPlan, MapsSettings, Wanted, visibility};
use surflux::gather::quantities::occlusion;
use surflux::gather::{Engine, Hemisphere, RaysEngine, RaysSettings};
use surflux::receivers::Receivers;
use surflux::scene::Scene;
use surflux::trace::Tracer;

fn by_rays(tracer: &Tracer, receivers: &Receivers, rays: u32) -> Vec<f32> {
    use rayon::prelude::*;
    let settings = RaysSettings {
        rays,
        turn: 0.3,
        ..RaysSettings::default()
    };
    let engine = RaysEngine::new(tracer, None, settings);
    let block = engine.block_size().max(1);
    let mut values = vec![0.0; receivers.len()];
    values.par_chunks_mut(block).enumerate().for_each_init(
        Hemisphere::default,
        |scratch, (k, values)| {
            let first = k * block;
            let range = first..first + values.len();
            engine.see(receivers, range, scratch, &mut |i, seen| {
                values[i - first] = occlusion::visibility(seen);
            });
        },
    );
    values
}

/// Seconds of processor time of this process: the machine is shared.
fn cpu() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").expect("Linux");
    let after = stat.rsplit(')').next().expect("fields");
    let ticks = |k: usize| {
        after
            .split_whitespace()
            .nth(k)
            .and_then(|t| t.parse::<f64>().ok())
            .expect("ticks")
    };
    (ticks(11) + ticks(12)) / 100.0
}

/// What `work` returns and the middle of three times it took, seconds of processor time.
pub(crate) fn median_cpu<T>(mut work: impl FnMut() -> T) -> (T, f64) {
    let mut timed = || {
        let start = cpu();
        let result = work();
        (result, cpu() - start)
    };
    let mut runs = [timed(), timed(), timed()];
    runs.sort_by(|a, b| a.1.total_cmp(&b.1));
    let [_, middle, _] = runs;
    middle
}

pub(crate) struct Errors {
    pub(crate) rmse: f64,
    bias: f64,
    p99: f64,
}

impl std::fmt::Display for Errors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [rmse, bias, p99] = [self.rmse, self.bias, self.p99].map(|x| 100.0 * x);
        write!(f, "{rmse:6.2} % bias {bias:+.2} p99 {p99:.1}")
    }
}

pub(crate) fn errors(values: &[f32], truth: &[f32]) -> Errors {
    let n = truth.len() as f64;
    let mean = truth.iter().map(|&t| f64::from(t)).sum::<f64>() / n;
    let diffs: Vec<f64> = values
        .iter()
        .zip(truth)
        .map(|(&v, &t)| f64::from(v) - f64::from(t))
        .collect();
    let mut shares: Vec<f64> = diffs
        .iter()
        .zip(truth)
        .map(|(d, &t)| d.abs() / f64::from(t).max(0.1 * mean))
        .collect();
    shares.sort_by(f64::total_cmp);
    Errors {
        rmse: (diffs.iter().map(|d| d * d).sum::<f64>() / n).sqrt() / mean,
        bias: diffs.iter().sum::<f64>() / n / mean,
        p99: shares[shares.len() * 99 / 100],
    }
}

/// A scene, where it is judged, and what rays cost there.
struct Bench<'a> {
    scene: &'a Scene,
    tracer: Tracer,
    receivers: Receivers,
    picked: Vec<usize>,
    truth: Vec<f32>,
    /// Microseconds a vertex of the hierarchy.
    build: f64,
    /// Microseconds a ray.
    ray: f64,
    /// Logarithms of error and microseconds a vertex.
    law: Vec<(f64, f64)>,
}

#[expect(clippy::print_stdout, reason = "a measurement's only result")]
impl<'a> Bench<'a> {
    fn new(name: &str, scene: &'a Scene) -> Self {
        let receivers = dense::vertices(scene);
        let count = receivers.len();
        let start = cpu();
        let tracer = Tracer::new(scene);
        let build = (cpu() - start) * 1e6 / count as f64;
        let picked: Vec<usize> = (0..400)
            .map(|k| (k * 2_654_435_761_usize) % count)
            .collect();
        let truth = by_rays(&tracer, &receivers.subset(&picked), 8192);
        let triangles = scene.triangle_count();
        println!("{name}: {count} vertices, {triangles} triangles, build {build:.2} us/v");
        Self {
            scene,
            tracer,
            receivers,
            picked,
            truth,
            build,
            ray: 0.0,
            law: Vec::new(),
        }
    }

    fn rays(&mut self, rays: u32) {
        let few = self.receivers.subset(&self.picked);
        let e = errors(&by_rays(&self.tracer, &few, rays), &self.truth);
        let count = self.receivers.len();
        let step = (count * rays as usize / 2_000_000).max(1);
        // Neighbors stay together: engines share work between them.
        let timed: Vec<usize> = (0..count).filter(|i| (i / 64) % step == 0).collect();
        let timed = self.receivers.subset(&timed);
        let gather =
            median_cpu(|| by_rays(&self.tracer, &timed, rays)).1 * 1e6 / timed.len() as f64;
        let us = self.build + gather;
        println!("  rays {rays:4}: {us:7.2} us/v  {e}");
        self.law.push((e.rmse.ln(), us.ln()));
        self.ray = gather / f64::from(rays);
    }

    fn maps(&self, s: &MapsSettings) {
        let count = self.receivers.len() as f64;
        let (seen, seconds) = median_cpu(|| {
            let plan = MapsPlan::new(self.scene);
            let wanted = Wanted::default();
            visibility(&plan, &self.receivers, s, &wanted, &dense::quiet()).expect("not cancelled")
        });
        let us = seconds * 1e6 / count;
        let mut values: Vec<f32> = self.picked.iter().map(|&i| seen.visibility[i]).collect();
        let alone = errors(&values, &self.truth);
        let ambiguous = |&k: &usize| seen.ambiguous[self.picked[k]];
        let flagged: Vec<usize> = (0..values.len()).filter(ambiguous).collect();
        let places: Vec<usize> = flagged.iter().map(|&k| self.picked[k]).collect();
        let better = by_rays(&self.tracer, &self.receivers.subset(&places), s.directions);
        flagged.iter().zip(better).for_each(|(&k, v)| values[k] = v);
        let with = errors(&values, &self.truth);
        let share = seen.ambiguous.iter().filter(|&&a| a).count() as f64 / count;
        let by_rays = self.build + share * self.ray * f64::from(s.directions);
        let total = if share > 0.0 { us + by_rays } else { us };
        let ratio = |e: &Errors, us: f64| interpolate(&self.law, e.rmse) / us;
        println!(
            "  maps {:4} p {} c {} b {}: {us:7.2} us/v  {alone} {:.1}x | {:.1} % handed over: {total:.2} us/v {with} {:.1}x",
            s.directions,
            s.pixel,
            s.cell,
            s.bias,
            ratio(&alone, us),
            100.0 * share,
            ratio(&with, total),
        );
    }
}

fn measure(name: &str, scene: &Scene, settings: &[MapsSettings]) {
    let mut bench = Bench::new(name, scene);
    [16, 64, 256].into_iter().for_each(|rays| bench.rays(rays));
    settings.iter().for_each(|settings| bench.maps(settings));
}

/// Microseconds of rays at this error, log-log through the measured points.
pub(crate) fn interpolate(law: &[(f64, f64)], error: f64) -> f64 {
    let x = error.ln();
    let k = (0..law.len() - 2)
        .find(|&k| x > law[k + 1].0)
        .unwrap_or(law.len() - 2);
    let ((x0, y0), (x1, y1)) = (law[k], law[k + 1]);
    (y0 + (y1 - y0) * (x - x0) / (x1 - x0)).exp()
}

fn grid(directions: &[u32], shapes: &[(f32, f32, f32)]) -> Vec<MapsSettings> {
    shapes
        .iter()
        .flat_map(|&(pixel, cell, bias)| {
            directions.iter().map(move |&directions| MapsSettings {
                directions,
                pixel,
                cell,
                bias,
                ..MapsSettings::default()
            })
        })
        .collect()
}

#[test]
#[ignore = "a measurement, minutes"]
fn a_dense_smooth_mesh() {
    let scene = dense::on_ground(dense::bumpy_ball(300, glam::Vec3::ZERO), 64);
    measure(
        "bumpy ball on ground",
        &scene,
        &grid(
            &[64, 128, 256],
            &[(3.0, 3.0, 1.0), (2.0, 2.0, 1.0), (1.0, 0.0, 1.0)],
        ),
    );
}

#[test]
#[ignore = "a measurement, minutes"]
fn scans_of_the_shared_assets() {
    for name in ["stanford-bunny", "nefertiti", "rocker-arm"] {
        if let Some(mesh) = dense::shared_mesh(name) {
            let scene = dense::on_ground(mesh, 32);
            measure(
                name,
                &scene,
                &grid(
                    &[64, 256],
                    &[
                        (2.0, 2.0, 1.0),
                        (1.0, 0.0, 1.0),
                        (1.0, 0.0, 0.5),
                        (0.5, 0.0, 0.5),
                    ],
                ),
            );
        }
    }
}
