//! Rays of the tracer, one at a time, in the order of the rays engine (a hemisphere a receiver) and in that of
//! world-fixed directions (one direction for 64 neighboring receivers, then the next); the latter in packets too, as the
//! engine sends them.
//!
//! `cargo bench --bench rays`; items a second are rays. With `SURFLUX_BENCH_DATA=folder` the geometry, the rays and what
//! they hit are written there for `embree_rival.c` instead, and the speed of packets is told as it tells its own.

mod files;
mod scenes;

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::Vec3;
use scenes::{Receiver, diced_box, displaced_ball, receivers, scene};
use std::path::Path;
use surflux::math::{Frame, sequence};
use surflux::pilot::clock::Clock;
use surflux::scene::{Mesh, Scene};
use surflux::trace::{Hit, Tracer};

const RECEIVERS: usize = 2048;
const RAYS: u32 = 64;
const BLOCK: usize = 64;

fn main() {
    if let Some(folder) = std::env::var_os("SURFLUX_BENCH_DATA") {
        for shape in SHAPES {
            write(Path::new(&folder), shape).expect("the folder can be written");
            tell_speed(shape);
        }
        return;
    }
    divan::main();
}

#[expect(clippy::print_stdout, reason = "the result")]
fn tell_speed(shape: Shape) {
    let packets = Packets::new(shape);
    let (occluded, closest) = (
        packets.speed(packet_occluded),
        packets.speed(packet_closest),
    );
    println!("{shape:?}: packets, world: occluded {occluded:.2}, closest {closest:.2} Mray/s");
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
    let mut rays = Vec::new();
    for block in points.chunks(BLOCK) {
        for direction in directions() {
            let above = block
                .iter()
                .filter(|(_, normal)| normal.dot(direction) > 0.0);
            rays.extend(above.map(|&(position, _)| (position, direction)));
        }
    }
    rays
}

fn directions() -> impl Iterator<Item = Vec3> {
    (0..2 * RAYS).map(|i| sequence::spiral_sphere(i, 2 * RAYS))
}

/// [`world`] in packets.
struct Packets {
    tracer: Tracer,
    blocks: Vec<Block>,
    /// Rays of all.
    rays: usize,
}

/// Neighbors, and which of them are turned towards each direction.
struct Block {
    origins: Vec<Vec3>,
    asked: Vec<(Vec3, u64)>,
}

impl Packets {
    fn new(shape: Shape) -> Self {
        let scene = scene(shape.meshes());
        let points = receivers(&scene.meshes[0], RECEIVERS);
        let blocks: Vec<Block> = points.chunks(BLOCK).map(Block::new).collect();
        let asked = blocks.iter().flat_map(|block| &block.asked);
        Self {
            tracer: Tracer::new(&scene),
            rays: asked.map(|(_, facing)| facing.count_ones() as usize).sum(),
            blocks,
        }
    }

    fn run(&self, bencher: Bencher<'_, '_>, hits: PacketQuery) {
        bencher
            .counter(ItemsCount::new(self.rays))
            .bench_local(|| self.trace(hits));
    }

    fn trace(&self, hits: PacketQuery) -> usize {
        let of = |block: &Block| -> usize {
            let asked = block.asked.iter();
            asked
                .map(|&(direction, facing)| hits(&self.tracer, block, direction, facing))
                .sum()
        };
        self.blocks.iter().map(of).sum()
    }

    /// Millions of rays a second of processor time, which other programs change less than the wait: the median of
    /// seven, as of the rival's.
    fn speed(&self, hits: PacketQuery) -> f64 {
        let mut seconds = [0.0; 7].map(|_: f64| {
            let start = Clock::start();
            std::hint::black_box(self.trace(hits));
            start.seconds()
        });
        seconds.sort_by(f64::total_cmp);
        1e-6 * self.rays as f64 / seconds[3]
    }
}

/// How many of the rays of a block along a direction hit.
type PacketQuery = fn(&Tracer, &Block, Vec3, u64) -> usize;

fn packet_closest(tracer: &Tracer, block: &Block, direction: Vec3, facing: u64) -> usize {
    let mut hits: [Option<Hit>; BLOCK] = [None; BLOCK];
    let asked = (f32::INFINITY, facing);
    tracer.closest_along(direction, &block.origins, asked, &mut hits);
    hits.iter().flatten().count()
}

fn packet_occluded(tracer: &Tracer, block: &Block, direction: Vec3, facing: u64) -> usize {
    let covered = tracer.occluded_along(direction, &block.origins, f32::INFINITY, facing);
    covered.count_ones() as usize
}

impl Block {
    fn new(points: &[Receiver]) -> Self {
        let facing = |direction: Vec3| {
            let bits = points.iter().enumerate();
            bits.fold(0, |mask, (i, (_, normal))| {
                mask | u64::from(normal.dot(direction) > 0.0) << i
            })
        };
        let asked = directions().map(|direction| (direction, facing(direction)));
        Self {
            origins: points.iter().map(|&(position, _)| position).collect(),
            asked: asked.filter(|&(_, facing)| facing != 0).collect(),
        }
    }
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

#[divan::bench(args = SHAPES, sample_count = 7)]
fn closest_packets(bencher: Bencher<'_, '_>, shape: Shape) {
    Packets::new(shape).run(bencher, packet_closest);
}

#[divan::bench(args = SHAPES, sample_count = 7)]
fn occluded_packets(bencher: Bencher<'_, '_>, shape: Shape) {
    Packets::new(shape).run(bencher, packet_occluded);
}

#[divan::bench(args = SHAPES, sample_count = 3)]
fn build(bencher: Bencher<'_, '_>, shape: Shape) {
    let scene = scene(shape.meshes());
    bencher.bench_local(|| Tracer::new(&scene).bytes());
}

/// `NAME_triangles.f32` (corners) and, for both orders, `NAME_ORDER_rays.f32` (origin, direction) and
/// `NAME_ORDER_distances.f32` (to what we hit, infinite for nothing).
fn write(folder: &Path, shape: Shape) -> std::io::Result<()> {
    let path = |what: &str| folder.join(format!("{}_{what}.f32", shape.name()));
    for (order, label) in [(Order::Local, "local"), (Order::World, "world")] {
        let work = work(shape, order);
        let meshes = work.scene.meshes.iter();
        let triangles = meshes.flat_map(|mesh| (0..mesh.triangles.len()).map(|t| mesh.corners(t)));
        files::save(
            &path("triangles"),
            triangles.flatten().flat_map(|p| p.to_array()),
        )?;
        let rays = work
            .rays
            .iter()
            .flat_map(|&(origin, direction)| [origin, direction]);
        files::save(
            &path(&format!("{label}_rays")),
            rays.flat_map(|v| v.to_array()),
        )?;
        let distances = work.rays.iter().map(|&(origin, direction)| {
            let hit = work.tracer.closest(origin, direction, f32::INFINITY);
            hit.map_or(f32::INFINITY, |hit| hit.distance)
        });
        files::save(&path(&format!("{label}_distances")), distances)?;
    }
    Ok(())
}
