//! Rays of the tracer, one at a time, in the order of the rays engine (a hemisphere a receiver) and in that of
//! world-fixed directions (one direction for 64 neighboring receivers, then the next).
//!
//! `cargo bench --bench rays`; with `SURFLUX_BENCH_DATA=folder` the geometry and the rays are written there for
//! `embree_rival.py`. Items a second are rays.

mod scenes;

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::Vec3;
use scenes::{Receiver, diced_box, displaced_ball, receivers, scene};
use std::io::Write;
use std::path::Path;
use surflux::math::{Frame, sequence};
use surflux::scene::{Mesh, Scene};
use surflux::trace::Tracer;

const RECEIVERS: usize = 2048;
const RAYS: u32 = 64;
const BLOCK: usize = 64;

fn main() {
    if let Some(folder) = std::env::var_os("SURFLUX_BENCH_DATA") {
        for shape in SHAPES {
            write(Path::new(&folder), shape).expect("the folder can be written");
        }
    }
    divan::main();
}

#[derive(Debug, Clone, Copy)]
enum Shape {
    Box,
    Ball,
}

const SHAPES: [Shape; 2] = [Shape::Box, Shape::Ball];

impl Shape {
    fn name(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Ball => "ball",
        }
    }

    /// 200 000 triangles, and a ball in the box so that its rays meet something else too.
    fn meshes(self) -> Vec<Mesh> {
        match self {
            Self::Box => vec![diced_box(120), displaced_ball(50)],
            Self::Ball => vec![displaced_ball(220)],
        }
    }
}

/// A scene, its receivers, and rays from them.
struct Work {
    scene: Scene,
    tracer: Tracer,
    rays: Vec<(Vec3, Vec3)>,
}

/// Order and directions of the rays.
#[derive(Debug, Clone, Copy)]
enum Order {
    /// All directions of one receiver, cosine distributed about its normal.
    Local,
    /// One of a fixed set of directions for all receivers of a block that are turned towards it, then the next.
    World,
}

fn work(shape: Shape, order: Order) -> Work {
    let scene = scene(shape.meshes());
    let points = receivers(&scene.meshes[0], RECEIVERS);
    let tracer = Tracer::new(&scene);
    let rays = match order {
        Order::Local => local(&points),
        Order::World => world(&points),
    };
    Work {
        scene,
        tracer,
        rays,
    }
}

fn local(points: &[Receiver]) -> Vec<(Vec3, Vec3)> {
    let pattern: Vec<Vec3> = (0..RAYS)
        .map(|i| sequence::cosine_hemisphere(sequence::fibonacci(i, RAYS)))
        .collect();
    let of = |&(position, normal): &Receiver| {
        let frame = Frame::about(normal);
        let ray = move |local: &Vec3| (position, frame.to_world(*local));
        pattern.iter().map(ray).collect::<Vec<_>>()
    };
    points.iter().flat_map(of).collect()
}

fn world(points: &[Receiver]) -> Vec<(Vec3, Vec3)> {
    let directions: Vec<Vec3> = (0..2 * RAYS)
        .map(|i| sequence::spiral_sphere(i, 2 * RAYS))
        .collect();
    let mut rays = Vec::new();
    for block in points.chunks(BLOCK) {
        for &direction in &directions {
            let above = block
                .iter()
                .filter(|(_, normal)| normal.dot(direction) > 0.0);
            rays.extend(above.map(|&(position, _)| (position, direction)));
        }
    }
    rays
}

fn run(bencher: Bencher<'_, '_>, work: &Work, trace: impl Fn(&Tracer, Vec3, Vec3) -> bool + Sync) {
    bencher
        .counter(ItemsCount::new(work.rays.len()))
        .bench_local(|| {
            let hits = (work.rays.iter())
                .filter(|(origin, direction)| trace(&work.tracer, *origin, *direction));
            hits.count()
        });
}

fn closest(tracer: &Tracer, origin: Vec3, direction: Vec3) -> bool {
    tracer.closest(origin, direction, f32::INFINITY).is_some()
}

fn occluded(tracer: &Tracer, origin: Vec3, direction: Vec3) -> bool {
    tracer.occluded(origin, direction, f32::INFINITY)
}

#[divan::bench(args = SHAPES, sample_count = 7)]
fn closest_local(bencher: Bencher<'_, '_>, shape: Shape) {
    run(bencher, &work(shape, Order::Local), closest);
}

#[divan::bench(args = SHAPES, sample_count = 7)]
fn closest_world(bencher: Bencher<'_, '_>, shape: Shape) {
    run(bencher, &work(shape, Order::World), closest);
}

#[divan::bench(args = SHAPES, sample_count = 7)]
fn occluded_local(bencher: Bencher<'_, '_>, shape: Shape) {
    run(bencher, &work(shape, Order::Local), occluded);
}

#[divan::bench(args = SHAPES, sample_count = 7)]
fn occluded_world(bencher: Bencher<'_, '_>, shape: Shape) {
    run(bencher, &work(shape, Order::World), occluded);
}

#[divan::bench(args = SHAPES, sample_count = 3)]
fn build(bencher: Bencher<'_, '_>, shape: Shape) {
    let scene = scene(shape.meshes());
    bencher.bench_local(|| Tracer::new(&scene).bytes());
}

/// `NAME_triangles.f32` (corners) and, for both orders, `NAME_ORDER_rays.f32` (origin, direction).
fn write(folder: &Path, shape: Shape) -> std::io::Result<()> {
    for (order, label) in [(Order::Local, "local"), (Order::World, "world")] {
        let work = work(shape, order);
        let triangles = work
            .scene
            .meshes
            .iter()
            .flat_map(|mesh| (0..mesh.triangles.len()).flat_map(|t| mesh.corners(t)));
        save(
            &folder.join(format!("{}_triangles.f32", shape.name())),
            triangles,
        )?;
        let rays = work
            .rays
            .iter()
            .flat_map(|&(origin, direction)| [origin, direction]);
        save(
            &folder.join(format!("{}_{label}_rays.f32", shape.name())),
            rays,
        )?;
    }
    Ok(())
}

fn save(path: &Path, vectors: impl Iterator<Item = Vec3>) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    for vector in vectors {
        for value in vector.to_array() {
            file.write_all(&value.to_le_bytes())?;
        }
    }
    file.flush()
}
