//! Visibility of every vertex of stages: our rays and maps beside Embree's packets, in one run.
//!
//! `SURFLUX_EMBREE=./embree_rival cargo bench --bench visibility -- STAGE...`, where the head of `embree_rival.c` tells
//! how that is made, and `make_scenes.py` makes stages.
//!
//! All on one thread and in processor time, three rounds in turn, medians. Set-up is included: hierarchies, plans,
//! decimation, the hierarchy for receivers that maps hand over; reading the stage is not. Embree is given receivers that
//! are lifted and in order already, and the directions of our rays; it is not robust, which would take 1.3 times as long.
//! Errors are those of the same [`FEW`] receivers, rms(x − truth) / mean(truth), against [`TRUTH_RAYS`] rays of Embree in
//! directions of their own. The last column is the time that Embree would take for the row's error, by the power law
//! through its own rows, over the row's: above 1 the row is faster.

mod files;

use anyhow::{Context, bail, ensure};
use glam::{Mat3, Vec3};
use std::path::{Path, PathBuf};
use std::process::Command;
use surflux::diagnostics::Diagnostics;
use surflux::gather::maps::{self, MapsPlan, MapsSettings};
use surflux::gather::{self, GatherScene, RaysEngine, RaysSettings};
use surflux::math::bits::{MORTON_CELLS, morton};
use surflux::math::sequence;
use surflux::pilot::clock::Clock;
use surflux::pilot::error::{mean_magnitude, relative, rms_difference, values};
use surflux::receivers::{Receivers, primvar};
use surflux::results::{Aov, BakeInterpolation, Results};
use surflux::scene::{PrimId, Scene};
use surflux::shading::Shader;
use surflux::stage::{self, ReadSettings};
use surflux::trace::Tracer;

/// Rays a receiver: two rows make a law.
const RAYS: [u32; 2] = [64, 256];
const ROUNDS: usize = 3;
const FEW: usize = 1024;
const TRUTH_RAYS: u32 = 16_384;

/// Neighbors are sorted by the octant of their normals in groups of this many, as our gather does.
const GROUP: usize = 256;

fn maps_settings() -> Vec<MapsSettings> {
    let smooth = [64, 128, 256].map(|directions| MapsSettings {
        directions,
        ..MapsSettings::SMOOTH
    });
    let rough = [1.0, 0.5].map(|pixel| MapsSettings {
        pixel,
        ..MapsSettings::default()
    });
    smooth.into_iter().chain(rough).collect()
}

fn main() -> anyhow::Result<()> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build_global()?;
    let stages = std::env::args().skip(1).filter(|arg| arg != "--bench");
    for stage in stages {
        let rival =
            std::env::var_os("SURFLUX_EMBREE").context("set SURFLUX_EMBREE to the rival")?;
        measure(&stage, Path::new(&rival)).with_context(|| stage.clone())?;
    }
    Ok(())
}

fn measure(path: &str, rival: &Path) -> anyhow::Result<()> {
    let diagnostics = Diagnostics::default();
    let mut source = stage::open(path.as_ref(), stage::Door::Native, &diagnostics)?;
    let settings = ReadSettings {
        materials: false,
        lights: false,
        ..ReadSettings::default()
    };
    let scene = stage::read(source.as_mut(), &settings, &diagnostics)?;
    let shader = Shader::new(&scene, &diagnostics);
    let bench = Bench::new(&scene, &shader)?;
    let rival = Rival::new(&bench, rival)?;
    let truth = rival.see("few", &[TRUTH_RAYS])?.remove(0).values;
    let mut rows = Rows::default();
    for _ in 0..ROUNDS {
        for seen in rival.see("all", &RAYS)? {
            rows.add(seen);
        }
        for seen in bench.rays(&RAYS, &bench.receivers)? {
            rows.add(bench.at_few(seen));
        }
        for settings in maps_settings() {
            rows.add(bench.at_few(bench.maps(&settings)?));
        }
    }
    let few = bench.receivers.subset(&bench.few);
    let own = bench.rays(&[TRUTH_RAYS], &few)?.remove(0).values;
    let count = bench.receivers.len();
    rows.print((path, &scene, count), &truth, &own);
    Ok(())
}

/// Everything seen once.
struct Seen {
    name: String,
    detail: String,
    cost: Cost,
    /// Of all receivers, or of the few.
    values: Vec<f64>,
}

/// Seconds.
#[derive(Clone, Copy)]
struct Cost {
    set_up: f64,
    gather: f64,
}

impl Cost {
    fn total(self) -> f64 {
        self.set_up + self.gather
    }
}

struct Bench<'a> {
    scene: &'a Scene,
    shader: &'a Shader<'a>,
    receivers: Receivers,
    /// Those that are judged.
    few: Vec<usize>,
}

impl<'a> Bench<'a> {
    fn new(scene: &'a Scene, shader: &'a Shader<'a>) -> anyhow::Result<Self> {
        let prims: Vec<PrimId> = (0..).map(PrimId).take(scene.prims.len()).collect();
        let receivers = primvar::place(scene, &prims, BakeInterpolation::Vertex);
        ensure!(!receivers.is_empty(), "a stage with meshes is needed");
        let step = receivers.len().div_ceil(FEW);
        Ok(Self {
            few: (0..receivers.len()).step_by(step).collect(),
            scene,
            shader,
            receivers,
        })
    }

    fn at_few(&self, mut seen: Seen) -> Seen {
        seen.values = self.few.iter().map(|&i| seen.values[i]).collect();
        seen
    }

    fn rays(&self, counts: &[u32], receivers: &Receivers) -> anyhow::Result<Vec<Seen>> {
        let start = Clock::start();
        let tracer = Tracer::new(self.scene);
        let set_up = start.seconds();
        let see = |&rays: &u32| {
            let start = Clock::start();
            let results = self.by_rays(&tracer, rays, receivers)?;
            let gather = start.seconds();
            Ok(Seen {
                name: format!("rays {rays}"),
                detail: String::new(),
                cost: Cost { set_up, gather },
                values: visibility_of(&results)?,
            })
        };
        counts.iter().map(see).collect()
    }

    fn by_rays(
        &self,
        tracer: &Tracer,
        rays: u32,
        receivers: &Receivers,
    ) -> Result<Results, surflux::diagnostics::Cancelled> {
        let settings = RaysSettings {
            rays,
            ..RaysSettings::default()
        };
        let scene = GatherScene {
            shader: self.shader,
            tracer,
            lighting: None,
        };
        let engine = RaysEngine::new(tracer, None, settings);
        let diagnostics = Diagnostics::default();
        gather::gather(scene, &engine, receivers, &[Aov::Visibility], &diagnostics)
    }

    fn maps(&self, settings: &MapsSettings) -> anyhow::Result<Seen> {
        let start = Clock::start();
        let plan = MapsPlan::new(self.scene);
        let set_up = start.seconds();
        let mut handed_over = 0;
        let mut by_rays = |few: &Receivers, _: &[Aov]| {
            handed_over = few.len();
            self.by_rays(&Tracer::new(self.scene), settings.directions, few)
        };
        let results = maps::gather_sky(
            (&plan, settings),
            None,
            (&self.receivers, &[Aov::Visibility]),
            (&mut by_rays, &|| unreachable!("no image of a sky is lit")),
            &Diagnostics::default(),
        )?;
        let gather = start.seconds() - set_up;
        let share = 100.0 * handed_over as f64 / self.receivers.len() as f64;
        let (pixel, cell) = (settings.pixel, settings.cell);
        Ok(Seen {
            name: format!("maps {} pixel {pixel} cell {cell}", settings.directions),
            detail: format!("{share:.1} % by rays"),
            cost: Cost { set_up, gather },
            values: visibility_of(&results)?,
        })
    }
}

fn visibility_of(results: &Results) -> anyhow::Result<Vec<f64>> {
    values(results, Aov::Visibility).context("visibility was asked for")
}

/// Embree, in a process of its own.
struct Rival {
    program: PathBuf,
    folder: tempfile::TempDir,
    /// Where each of the few stands in the order of all.
    few: Vec<usize>,
}

impl Rival {
    /// Write what it reads.
    fn new(bench: &Bench<'_>, program: &Path) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        let write = |name: String, vectors: Vec<Vec3>| {
            let numbers = vectors.into_iter().flat_map(|v| v.to_array());
            files::save(&folder.path().join(format!("{name}.f32")), numbers)
        };
        write("triangles".into(), triangles(bench.scene))?;
        let tracer = Tracer::new(bench.scene);
        let rays_from = |picked: &[usize]| {
            let of = |&i: &usize| {
                [
                    lifted(&tracer, &bench.receivers, i),
                    bench.receivers.normal[i],
                ]
            };
            picked.iter().flat_map(of).collect::<Vec<_>>()
        };
        let order = order(&bench.receivers);
        write("all_receivers".into(), rays_from(&order))?;
        write("few_receivers".into(), rays_from(&bench.few))?;
        for rays in RAYS {
            write(format!("all_directions_{rays}"), directions(2 * rays, TILT))?;
        }
        write(
            format!("few_directions_{TRUTH_RAYS}"),
            directions(2 * TRUTH_RAYS, TILT.transpose()),
        )?;
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(k, &i)| place[i] = k);
        Ok(Self {
            program: program.to_owned(),
            few: bench.few.iter().map(|&i| place[i]).collect(),
            folder,
        })
    }

    /// What the few see, as part of `set`.
    fn see(&self, set: &str, counts: &[u32]) -> anyhow::Result<Vec<Seen>> {
        let mut command = Command::new(&self.program);
        command.arg("visibility").arg(self.folder.path()).arg(set);
        command.args(counts.iter().map(u32::to_string));
        let output = command.output().context("the rival does not run")?;
        if !output.status.success() {
            bail!("{}", String::from_utf8_lossy(&output.stderr));
        }
        let output = String::from_utf8(output.stdout)?;
        let mut lines = output.lines();
        let set_up: f64 = lines.next().context("no set-up")?.parse()?;
        let seen = |(&rays, line): (&u32, &str)| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let &[width, hint, seconds] = &words[..] else {
                bail!("{line}");
            };
            let path = self
                .folder
                .path()
                .join(format!("{set}_visibility_{rays}.f32"));
            let values = files::load(&path)?;
            let at = |&k: &usize| f64::from(values[k]);
            Ok(Seen {
                name: format!("Embree {rays}"),
                detail: format!("packets of {width}, {hint}"),
                cost: Cost {
                    set_up,
                    gather: seconds.parse()?,
                },
                values: match set {
                    "all" => self.few.iter().map(at).collect(),
                    _ => values.iter().map(|&v| f64::from(v)).collect(),
                },
            })
        };
        counts.iter().zip(lines).map(seen).collect()
    }
}

/// Corners in world space.
fn triangles(scene: &Scene) -> Vec<Vec3> {
    let of = |prim| {
        let mesh = scene.mesh_of(prim);
        let corners = (0..mesh.triangles.len()).flat_map(|t| mesh.corners(t));
        corners.map(|corner| prim.world_from_object.transform_point3(corner))
    };
    scene.prims.iter().flat_map(of).collect()
}

/// Origin of the rays from vertex `i`, where the rays engine puts it.
fn lifted(tracer: &Tracer, receivers: &Receivers, i: usize) -> Vec3 {
    tracer.lift(receivers.position[i], receivers.rim_normal(i))
}

/// Neighbors next to each other, those turned to one side first.
fn order(receivers: &Receivers) -> Vec<usize> {
    let bounds = surflux::math::Bounds3::around(receivers.position.iter().copied());
    let scale = MORTON_CELLS / (bounds.max - bounds.min).max_element();
    let mut order: Vec<usize> = (0..receivers.len()).collect();
    order.sort_by_cached_key(|&i| morton((receivers.position[i] - bounds.min) * scale));
    for group in order.chunks_mut(GROUP) {
        group.sort_by_key(|&i| receivers.normal[i].to_array().map(|x| x < 0.0));
    }
    order
}

/// Turns the directions of rows: those of our rays engine, so that both have the same errors.
const TILT: Mat3 = Mat3::from_cols(
    Vec3::new(0.8, 0.0, 0.6),
    Vec3::new(0.36, 0.8, -0.48),
    Vec3::new(-0.48, 0.6, 0.64),
);

/// Evenly over the sphere.
fn directions(count: u32, turned: Mat3) -> Vec<Vec3> {
    (0..count)
        .map(|i| (turned * sequence::spiral_sphere(i, count)).normalize())
        .collect()
}

/// What each way saw, once a round; the ways in the order in which they came first.
#[derive(Default)]
struct Rows(Vec<Vec<Seen>>);

impl Rows {
    fn add(&mut self, seen: Seen) {
        match self.0.iter_mut().find(|row| row[0].name == seen.name) {
            Some(row) => row.push(seen),
            None => self.0.push(vec![seen]),
        }
    }

    #[expect(clippy::print_stdout, reason = "the result")]
    fn print(mut self, (path, scene, count): (&str, &Scene, usize), truth: &[f64], own: &[f64]) {
        let error = |values: &[f64]| relative(rms_difference(values, truth), mean_magnitude(truth));
        let each = |seconds: f64| 1e6 * seconds / count as f64;
        for row in &mut self.0 {
            row.sort_by(|a, b| a.cost.total().total_cmp(&b.cost.total()));
        }
        let medians: Vec<&Seen> = self.0.iter().map(|row| &row[row.len() / 2]).collect();
        let embree = medians
            .iter()
            .filter(|seen| seen.name.starts_with("Embree"));
        let law: Vec<(f64, f64)> = embree
            .map(|seen| (error(&seen.values), seen.cost.total()))
            .collect();
        let triangles = scene.triangle_count();
        println!("{path}: {count} receivers, {triangles} triangles");
        println!(
            "  our rays, {TRUTH_RAYS}: {:.3} % off the truth",
            100.0 * error(own)
        );
        println!("  set-up s   us each  with set-up   error %  Embree's time over this");
        for Seen {
            name,
            detail,
            cost,
            values,
        } in medians
        {
            let error = error(values);
            println!(
                "  {:8.3} {:9.3} {:12.3} {:9.3} {:8.2}  {name} {detail}",
                cost.set_up,
                each(cost.gather),
                each(cost.total()),
                100.0 * error,
                at_error(&law, error) / cost.total(),
            );
        }
    }
}

/// Cost at `error` by the power law through the first and the last of `law`.
fn at_error(law: &[(f64, f64)], error: f64) -> f64 {
    let (Some(&(first, dear)), Some(&(last, cheap))) = (law.first(), law.last()) else {
        return f64::NAN;
    };
    let power = (cheap / dear).ln() / (last / first).ln();
    dear * (error / first).powf(power)
}
