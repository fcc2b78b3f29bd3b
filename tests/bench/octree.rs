//! Octrees of a million surfels: seconds by the wall clock and of processor time for a million, bytes.
//! `cargo bench --bench octree -- [SURFELS]`, threads as `RAYON_NUM_THREADS` says.

use glam::Vec3;
use std::f32::consts::TAU;
use std::time::Instant;
use surflux::octree::Octree;
use surflux::pilot::clock::Clock;
use surflux::surfels::SurfelCloud;

/// Builds of each cloud; medians are told.
const ROUNDS: usize = 5;

#[expect(clippy::print_stdout, reason = "one table, row by row")]
fn main() {
    let mut arguments = std::env::args().filter(|a| !a.starts_with("--")).skip(1);
    let count = arguments.next().and_then(|text| text.parse().ok());
    let count = count.unwrap_or(1_000_000);
    println!("cloud      s/M  processor s/M  nodes a surfel  bytes a surfel");
    for (name, place) in CLOUDS {
        let cloud = cloud(count, place);
        let mut times: Vec<(f64, f64)> = (0..ROUNDS).map(|_| time(&cloud)).collect();
        let millions = cloud.len() as f64 / 1e6;
        times.sort_by(|a, b| a.0.total_cmp(&b.0));
        let wall = times[ROUNDS / 2].0 / millions;
        times.sort_by(|a, b| a.1.total_cmp(&b.1));
        let own = times[ROUNDS / 2].1 / millions;
        let tree = Octree::new(&cloud);
        let per_surfel = |value: usize| value as f64 / cloud.len() as f64;
        let (nodes, bytes) = (per_surfel(tree.node_count()), per_surfel(tree.bytes()));
        println!("{name:8} {wall:6.3} {own:14.3} {nodes:15.3} {bytes:15.1}");
    }
}

fn time(cloud: &SurfelCloud) -> (f64, f64) {
    let (wall, own) = (Instant::now(), Clock::start());
    let tree = Octree::new(cloud);
    let times = (wall.elapsed().as_secs_f64(), own.seconds());
    drop(tree);
    times
}

/// Position and normal at a place of the unit square.
type Surface = fn(f32, f32) -> (Vec3, Vec3);

const CLOUDS: [(&str, Surface); 3] = [("room", room), ("ball", ball), ("leaves", leaves)];

/// The six walls of a room.
fn room(a: f32, b: f32) -> (Vec3, Vec3) {
    let (wall, u, v) = (
        (6.0 * a).floor(),
        2.0 * (6.0 * a).fract() - 1.0,
        2.0 * b - 1.0,
    );
    match wall.min(5.0) {
        w if w < 1.0 => (Vec3::new(u, v, -1.0), Vec3::Z),
        w if w < 2.0 => (Vec3::new(u, v, 1.0), -Vec3::Z),
        w if w < 3.0 => (Vec3::new(u, -1.0, v), Vec3::Y),
        w if w < 4.0 => (Vec3::new(u, 1.0, v), -Vec3::Y),
        w if w < 5.0 => (Vec3::new(-1.0, u, v), Vec3::X),
        _ => (Vec3::new(1.0, u, v), -Vec3::X),
    }
}

/// A ball with bumps.
fn ball(a: f32, b: f32) -> (Vec3, Vec3) {
    let (z, around) = (1.0 - 2.0 * a, TAU * b);
    let ring = (1.0 - z * z).max(0.0).sqrt();
    let out = Vec3::new(ring * around.cos(), ring * around.sin(), z);
    let wave = (31.0 * out.x).sin() * (29.0 * out.y).sin() * (37.0 * out.z).sin();
    let normal = out + 0.3 * Vec3::new(wave, (17.0 * out.z).sin(), (23.0 * out.x).cos());
    (out * (1.0 + 0.02 * wave), normal.normalize())
}

/// A ball of leaves turned at random.
fn leaves(a: f32, b: f32) -> (Vec3, Vec3) {
    let part = |seed: f32| (1e4 * (a * 12.9898 + b * 78.233 + seed).sin()).fract();
    let vector = |seed: f32| Vec3::new(part(seed), part(seed + 1.3), part(seed + 2.7));
    let normal = vector(5.1).try_normalize().unwrap_or(Vec3::Z);
    (vector(0.0), normal)
}

/// About `count` surfels in the order of rows, as a mesh is diced.
fn cloud(count: usize, surface: Surface) -> SurfelCloud {
    let side = (count as f32).sqrt().ceil();
    let mut cloud = SurfelCloud::default();
    for i in 0..count {
        let row = (i as f32 / side).floor();
        let column = i as f32 - row * side;
        let (position, normal) = surface((row + 0.5) / side, (column + 0.5) / side);
        let area = 12.0 / count as f32;
        cloud.position.push(position);
        cloud.normal.push(normal);
        cloud.radius.push(0.71 * area.sqrt());
        cloud.area.push(area);
        cloud
            .radiosity
            .push(Vec3::splat(0.5) + 0.5 * position.abs());
        cloud.albedo.push(Vec3::splat(0.5));
        cloud.emission.push(Vec3::ZERO);
        cloud.prim.push(0);
    }
    cloud
}
