//! Conformance: the scenes that both doors make, against what Pixar's usd-core computes of the same stages.
//!
//! The truth is `evaluate_stage.py`, which shares no code and no approach with the doors. Compared value by value: world
//! positions (of subdivision surfaces: limit points inside regular quads), topology, primvars and their interpolation
//! at every corner, purpose and visibility, the material of every face, extents of implicit gprims, lights, cameras,
//! render settings; at the default time and between frames. A value that differs is *unsupported* when a warning names
//! its prim; one that differs in silence fails the test.
//!
//! Runs over the shared assets (with a note where they are missing), over every stage below the folder that
//! `SURFLUX_STAGES` names, and over small stages of its own. `-- --nocapture` prints the table.

#![expect(
    clippy::print_stdout,
    reason = "the table of stages is what people run it for"
)]

#[path = "../support/stages.rs"]
mod stages;

mod compare;
mod features;
#[path = "../support/python.rs"]
mod python;
mod truth;

use compare::{Tally, compare};
use stages::stages_below;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use surflux::diagnostics::{Diagnostics, Warning};
use surflux::scene::Scene;
use surflux::stage::{self, Composition, Door, ReadSettings};
use truth::Evaluator;

/// How a stage is to be read.
#[derive(Debug, Clone, Default)]
struct Reading {
    time: Option<f64>,
    composition: Composition,
}

impl From<Option<f64>> for Reading {
    fn from(time: Option<f64>) -> Self {
        Self {
            time,
            ..Self::default()
        }
    }
}

/// The scene that `door` makes of `path`, and its warnings; `Err` where the door refuses it.
fn scene_of(path: &Path, door: Door, reading: &Reading) -> Result<(Scene, Vec<Warning>), String> {
    let diagnostics = Diagnostics::default();
    let settings = ReadSettings {
        time: reading.time,
        composition: reading.composition.clone(),
        // refined as little as possible: what is compared does not depend on it
        refine_edge: Some(f32::MAX),
        ..ReadSettings::default()
    };
    let source = match door {
        Door::Native => stage::open(path, door, &diagnostics),
        _ => stage::worker::WorkerSource::open_with(&python::python(), path, &diagnostics)
            .map(|source| Box::new(source) as Box<dyn stage::Source>),
    };
    let scene = source.and_then(|mut source| stage::read(source.as_mut(), &settings, &diagnostics));
    let scene = scene.map_err(|problem| problem.to_string())?;
    Ok((scene, diagnostics.warnings()))
}

/// Read `path` through `door` and compare it; `Err` where the door or usd-core refuses it.
fn judge(
    evaluator: &mut Evaluator,
    path: &Path,
    door: Door,
    reading: &Reading,
) -> Result<Tally, String> {
    let (scene, warnings) = scene_of(path, door, reading)?;
    let truth = evaluator.evaluate(path, reading);
    let truth = truth.map_err(|problem| format!("usd-core: {problem}"))?;
    Ok(compare(&scene, &truth, &warnings))
}

/// What is known of a stage before it is compared.
#[derive(Debug)]
struct Candidate {
    path: PathBuf,
    /// Files of the layers it brings in.
    layers: Vec<String>,
    /// A frame between frames of the stage's range, where it has one.
    between_frames: Option<f64>,
}

impl Candidate {
    fn new(evaluator: &mut Evaluator, path: PathBuf) -> Self {
        let truth = evaluator.evaluate(&path, &Reading::default());
        let index = truth.map(|truth| truth.index).unwrap_or_default();
        let names = index["layers"].as_array().into_iter().flatten();
        let layers = names
            .filter_map(|name| name.as_str().map(str::to_owned))
            .collect();
        let range = Some(&index["range"])
            .filter(|range| !range.is_null())
            .map(truth::list);
        let range = range.filter(|range| range[0] < range[1]);
        Self {
            path,
            layers,
            between_frames: range.map(|range| range[0] + 0.37 * (range[1] - range[0])),
        }
    }
}

/// The stages below `folder` that no other of them brings in, since what is in those is compared with these; and those
/// with a range of frames, which the others may lack.
fn stages_to_compare(folder: &Path, evaluator: &mut Evaluator) -> Vec<Candidate> {
    let mut paths = Vec::new();
    stages_below(folder, &mut paths);
    let found = paths.into_iter().map(|path| {
        let real = std::fs::canonicalize(&path).unwrap_or(path);
        Candidate::new(evaluator, real)
    });
    let all: Vec<Candidate> = found.collect();
    let mut below = HashSet::new();
    for candidate in &all {
        let own = candidate.path.to_string_lossy();
        below.extend(
            candidate
                .layers
                .iter()
                .filter(|layer| **layer != own)
                .cloned(),
        );
    }
    let is_compared = |candidate: &Candidate| {
        let is_root = !below.contains(&*candidate.path.to_string_lossy());
        is_root || candidate.between_frames.is_some()
    };
    all.into_iter().filter(is_compared).collect()
}

/// Sums over a set of stages.
#[derive(Debug, Default)]
struct Sums {
    stages: usize,
    refused: usize,
    total: Tally,
}

fn run_over(folder: &Path, door: Door) -> Sums {
    let mut evaluator = Evaluator::start();
    let mut sums = Sums::default();
    let real = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    for candidate in stages_to_compare(folder, &mut evaluator) {
        let path = candidate.path.as_path();
        let name = path.strip_prefix(&real).unwrap_or(path).display();
        for time in [None].into_iter().chain(candidate.between_frames.map(Some)) {
            sums.stages += 1;
            match judge(&mut evaluator, path, door, &time.into()) {
                Ok(tally) => sums.add(tally, &format!("{name} at {time:?}")),
                Err(refusal) => {
                    println!("{:>42}  {name}: {refusal}", "refused");
                    sums.refused += 1;
                }
            }
        }
    }
    sums
}

impl Sums {
    fn add(&mut self, tally: Tally, label: &str) {
        let Tally {
            prims,
            equal,
            unsupported,
            unjudged,
            different,
            differences,
            reasons,
        } = tally;
        println!("{prims:7} {equal:9} {different:9} {unsupported:9} {unjudged:4}  {label}");
        self.total.prims += prims;
        self.total.equal += equal;
        self.total.unsupported += unsupported;
        self.total.unjudged += unjudged;
        self.total.different += different;
        for (kind, count) in reasons {
            *self.total.reasons.entry(kind).or_default() += count;
        }
        let named = differences
            .into_iter()
            .map(|line| format!("{label}: {line}"));
        self.total.differences.extend(named);
    }
}

#[track_caller]
fn assert_conformance(folder: &Path) {
    let mut silent = Vec::new();
    for door in [Door::UsdCore, Door::Native] {
        println!("{door:?} against usd-core, {}", folder.display());
        println!(
            "{:>7} {:>9} {:>9} {:>9} {:>4}  stage",
            "prims", "equal", "different", "unsupp.", "n/a"
        );
        let Sums {
            stages,
            refused,
            total,
        } = run_over(folder, door);
        println!(
            "{door:?}: {stages} stages ({refused} refused), {} prims; values: {} equal, {} different, {} unsupported, {} not judged",
            total.prims, total.equal, total.different, total.unsupported, total.unjudged
        );
        let mut reasons: Vec<_> = total.reasons.into_iter().collect();
        reasons.sort();
        println!("unsupported: {reasons:?}\n");
        silent.extend(
            total
                .differences
                .into_iter()
                .map(|line| format!("{door:?} {line}")),
        );
    }
    assert!(
        silent.is_empty(),
        "{} silent differences:\n{}",
        silent.len(),
        silent.join("\n")
    );
}

#[test]
fn shared_assets_are_read_as_usd_core_computes_them() {
    let shared = std::env::var_os("SURFLUX_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")),
        PathBuf::from,
    );
    let assets = shared.join("assets");
    match assets.is_dir() {
        true => assert_conformance(&assets),
        false => println!("skipped: no shared assets (SURFLUX_SHARED)"),
    }
}

#[test]
fn stages_of_the_user_are_read_as_usd_core_computes_them() {
    match std::env::var_os("SURFLUX_STAGES") {
        Some(folder) => assert_conformance(Path::new(&folder)),
        None => println!("skipped: SURFLUX_STAGES names no folder"),
    }
}
