//! What a run did, as `--json` prints it (DESIGN: `surflux`, `command`, `usd`, `seconds`, `counts`, …).

use super::choice::Choice;
use super::shots::Shot;
use super::spacing::Dicing;
use crate::diagnostics::Warning;
use crate::gather::ErrorEstimate;
use crate::image;
use crate::results::Aov;
use crate::stage::raw::RawMeta;
use crate::stage::{self, Source};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Seconds a phase, summed over frames.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Seconds {
    /// Stage to scene, acceleration structure and textures included.
    pub read: f64,
    /// Dicing and direct light of surfels.
    pub points: f64,
    /// Octree.
    pub octree: f64,
    /// Gathering, bounces included.
    pub gather: f64,
    /// Files.
    pub write: f64,
    /// Pictures for a page or a thumbnail, what is gathered for them alone included.
    pub pictures: f64,
    /// Everything.
    pub total: f64,
}

/// How much of everything; the largest over frames.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Counts {
    /// Visible prims with a surface (instances counted each).
    pub prims: usize,
    /// Triangles (instances counted each).
    pub triangles: usize,
    /// Surfels.
    pub surfels: usize,
    /// Octree nodes.
    pub nodes: usize,
    /// Receivers.
    pub receivers: usize,
    /// Receivers that were gathered at (not interpolated), of the gather that did so at most.
    pub gathered: usize,
}

/// What was read of the stage, summed over frames; data that all frames share counts once through usd-core.
#[derive(Debug, Clone, Default, Serialize)]
pub struct ReadReport {
    /// Layers opened.
    pub layers: usize,
    /// Attributes whose values were resolved.
    pub attributes: usize,
    /// Bytes of those values.
    pub bytes: usize,
    /// Image files read: textures of materials and lights.
    pub textures: usize,
    /// Bytes of those files; 0 for images inside packages, whose layers were read anyway.
    pub texture_bytes: u64,
    /// Layers, packages and image files that were read, each once.
    pub files: BTreeSet<PathBuf>,
    /// The image files, each counted once.
    #[serde(skip)]
    pub(super) images: BTreeSet<PathBuf>,
}

impl ReadReport {
    /// Count what one frame has read.
    pub(super) fn add(&mut self, raw: &RawMeta) {
        self.layers = self.layers.max(raw.layers.len());
        self.files
            .extend(raw.layers.iter().filter_map(|layer| file_of(layer)));
        self.attributes += raw.read.attributes;
        self.bytes += raw.read.bytes;
    }

    /// Count `files`, patterns with `<UDIM>` tile by tile, unless they were counted before.
    pub(super) fn add_images(&mut self, files: impl Iterator<Item = PathBuf>) {
        for file in files.flat_map(|file| image::tiles(&file)) {
            if !self.images.contains(&file) {
                self.textures += 1;
                self.texture_bytes += std::fs::metadata(&file).map_or(0, |about| about.len());
                self.files.extend(file_of(&file.to_string_lossy()));
                self.images.insert(file);
            }
        }
    }
}

/// The file that holds a layer or an image: of what lies in packages (`a.usdz[b.usdc]`) the package; `None` for layers in
/// memory.
fn file_of(identifier: &str) -> Option<PathBuf> {
    let path = Path::new(identifier.split('[').next().unwrap_or(identifier));
    path.is_file().then(|| path.to_path_buf())
}

/// How good the result is.
#[derive(Debug, Clone, Default, Serialize)]
pub struct ErrorReport {
    /// What was asked for.
    pub tolerance: Option<f64>,
    /// Largest estimated relative RMSE over the AOVs.
    pub estimate: Option<f64>,
    /// How it was estimated.
    pub method: String,
    /// Estimate of each AOV that an error can be told of.
    pub aovs: BTreeMap<String, f64>,
    /// True while the pilot's estimate stands for the run at hand.
    #[serde(skip)]
    pub(super) is_of_pilot: bool,
}

impl ErrorReport {
    /// Keep the largest estimate of each AOV over frames and views.
    pub(super) fn add(&mut self, estimates: &[ErrorEstimate], method: String) {
        for estimate in estimates {
            let worst = self.aovs.entry(estimate.aov.name().to_owned()).or_default();
            *worst = worst.max(estimate.relative_rmse);
        }
        self.estimate = self.aovs.values().copied().reduce(f64::max);
        self.method = method;
    }

    /// Put an estimate of AOV `name` in place of that there is.
    pub(super) fn put(&mut self, name: &str, estimate: f64) {
        self.aovs.insert(name.to_owned(), estimate);
        self.estimate = self.aovs.values().copied().reduce(f64::max);
    }

    /// Put better estimates of the run at hand in place of those there are.
    pub(super) fn replace(&mut self, estimates: &[ErrorEstimate]) {
        for estimate in estimates {
            let name = estimate.aov.name().to_owned();
            self.aovs.insert(name, estimate.relative_rmse);
        }
        self.estimate = self.aovs.values().copied().reduce(f64::max);
    }
}

/// Statistics of one run.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Version.
    pub surflux: &'static str,
    /// The command line.
    pub command: Vec<String>,
    /// `native` or `usd-core`.
    pub usd: String,
    /// Time.
    pub seconds: Seconds,
    /// Sizes.
    pub counts: Counts,
    /// What was read.
    pub read: ReadReport,
    /// Peak resident memory of this process and of the usd-core worker together, if the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Settings as resolved.
    pub settings: serde_json::Map<String, serde_json::Value>,
    /// Accuracy.
    pub error: ErrorReport,
    /// Files written (or to be written, for a dry run).
    pub outputs: Vec<PathBuf>,
    /// Everything that was not as it should be.
    pub warnings: Vec<Warning>,
    /// True once some frame had surfaces that let light through or are displaced: later ones read materials at once.
    #[serde(skip)]
    pub(super) reads_materials: bool,
    /// Pictures of the first frame, where a page or a thumbnail was asked for.
    #[serde(skip)]
    pub shots: Vec<Shot>,
    /// What the pilot chose for each set of AOVs: later frames keep it.
    #[serde(skip)]
    pub(super) choices: BTreeMap<Vec<Aov>, Choice>,
    /// What a tolerance asked of surfels, for each set of AOVs.
    #[serde(skip)]
    pub(super) dicings: BTreeMap<Vec<Aov>, Dicing>,
}

impl Report {
    /// A report of its own for a part of the run, which keeps to what was chosen before, to be given back to
    /// [`Self::add_part`].
    pub(super) fn part(&mut self) -> Self {
        Self {
            choices: std::mem::take(&mut self.choices),
            dicings: std::mem::take(&mut self.dicings),
            ..Self::new(&[])
        }
    }

    /// Add what `part`, a gather for some of the light, took and chose.
    pub(super) fn add_part(&mut self, mut part: Self) {
        self.choices.append(&mut part.choices);
        self.dicings.append(&mut part.dicings);
        self.seconds.read += part.seconds.read;
        self.seconds.points += part.seconds.points;
        self.seconds.octree += part.seconds.octree;
        self.seconds.gather += part.seconds.gather;
        self.counts.surfels = self.counts.surfels.max(part.counts.surfels);
        self.counts.nodes = self.counts.nodes.max(part.counts.nodes);
        self.counts.receivers = self.counts.receivers.max(part.counts.receivers);
        self.counts.gathered = self.counts.gathered.max(part.counts.gathered);
        for (name, value) in part.settings {
            self.settings.entry(name).or_insert(value);
        }
    }

    /// An empty report of `command`.
    pub fn new(command: &[String]) -> Self {
        Self {
            surflux: env!("CARGO_PKG_VERSION"),
            command: command.to_vec(),
            usd: String::new(),
            seconds: Seconds::default(),
            counts: Counts::default(),
            read: ReadReport::default(),
            peak_memory_bytes: None,
            settings: serde_json::Map::new(),
            error: ErrorReport::default(),
            outputs: Vec::new(),
            warnings: Vec::new(),
            reads_materials: false,
            shots: Vec::new(),
            choices: BTreeMap::new(),
            dicings: BTreeMap::new(),
        }
    }

    /// Call the setting `old` by the name `new`.
    pub(super) fn rename_setting(&mut self, old: &str, new: &str) {
        if let Some(value) = self.settings.remove(old) {
            self.set(new, value);
        }
    }

    /// Record one resolved setting.
    pub fn set(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.settings.insert(name.to_owned(), value.into());
    }
}

/// Runs `work` and adds its seconds to `total`.
pub(super) fn timed<T>(total: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let value = work();
    *total += start.elapsed().as_secs_f64();
    value
}

/// Peak resident memory of this process and, where `source` reads with one of its own, of that too; `None` where the
/// system does not tell.
pub(super) fn peak_memory_bytes(source: &dyn Source) -> Option<u64> {
    let own = stage::process_peak_memory("self")?;
    Some(own + source.peak_memory_bytes().unwrap_or(0))
}
