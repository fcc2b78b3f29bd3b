//! What is in a stage: the TD's first look.

mod flaws;
mod textures;
mod tree;

pub use flaws::{BrokenReference, Suspicion};
pub use textures::TextureSummary;
pub use tree::{AnimationSummary, TreeEntry};

use super::Error;
use super::job::{InfoJob, Purposed};
use super::world::{Needs, compose, read_settings};
use crate::diagnostics::{Diagnostics, Warning};
use crate::scene::{Input, Light, LightKind, Material, PrimSource, Scene};
use crate::stage;
use crate::stage::raw::RawStage;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A stage in numbers and names.
#[derive(Debug, Clone, Serialize)]
pub struct StageSummary {
    /// Version of surflux.
    pub surflux: &'static str,
    /// The command line.
    pub command: Vec<String>,
    /// Root layer as given.
    pub stage: String,
    /// `native` or `usd-core`.
    pub usd: String,
    /// `Y` or `Z`.
    pub up_axis: String,
    /// Meters in one stage unit.
    pub meters_per_unit: f64,
    /// `defaultPrim`.
    pub default_prim: Option<String>,
    /// Start and end time codes.
    pub time_range: Option<(f64, f64)>,
    /// Time codes a second.
    pub time_codes_per_second: f64,
    /// Time code read; none = default time.
    pub time: Option<f64>,
    /// Number of layers used.
    pub layers: usize,
    /// World bounds, those of subdivision surfaces around their control points: lower, upper corner, stage units; none
    /// for a stage without surfaces.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// What counts, by place: parents before children, most of the stage's depth left out.
    pub tree: Vec<TreeEntry>,
    /// What moves.
    pub animation: AnimationSummary,
    /// Surfaces.
    pub geometry: GeometrySummary,
    /// Lights.
    pub lights: Vec<LightSummary>,
    /// Camera paths.
    pub cameras: Vec<String>,
    /// Materials and their textures.
    pub materials: Vec<MaterialSummary>,
    /// Image files of materials and lights, with their sizes.
    pub textures: Vec<TextureSummary>,
    /// Render settings and their products.
    pub render_settings: Vec<RenderSummary>,
    /// References and payloads whose layers or prims do not exist.
    pub broken_references: Vec<BrokenReference>,
    /// Units, sizes and intensities that are rarely meant.
    pub suspicions: Vec<Suspicion>,
    /// What the job of `--for` would read; everything above is then what it would see.
    pub job: Option<JobReads>,
    /// Seconds it took to read.
    pub seconds: f64,
    /// What surflux cannot use, and with what consequence.
    pub warnings: Vec<Warning>,
}

/// What a job would read.
#[derive(Debug, Clone, Serialize)]
pub struct JobReads {
    /// `points`, `bake` or `render`.
    #[serde(rename = "for")]
    pub purpose: &'static str,
    /// Its AOVs.
    pub aov: Vec<&'static str>,
    /// True if materials are read.
    pub materials: bool,
    /// True if lights are read.
    pub lights: bool,
    /// Layers that are opened.
    pub layers: Vec<String>,
    /// Image files that are decoded.
    pub textures: Vec<PathBuf>,
    /// Bytes of those files.
    pub texture_bytes: u64,
    /// Attributes whose values are resolved at one frame.
    pub attributes: usize,
    /// Bytes of those values.
    pub bytes: usize,
}

/// Surfaces of a stage.
#[derive(Debug, Clone, Default, Serialize)]
pub struct GeometrySummary {
    /// Visible surfaces, instances counted each.
    pub prims: usize,
    /// Meshes held, shared ones once.
    pub meshes: usize,
    /// Prims below native instances.
    pub native_instances: usize,
    /// Prims drawn by `PointInstancer`s.
    pub point_instances: usize,
    /// Authored points a bake would write to, instances counted each.
    pub points: usize,
    /// Triangles after refinement, instances counted each.
    pub triangles: usize,
    /// Meshes by subdivision scheme or gprim type.
    pub schemes: BTreeMap<String, usize>,
}

/// One light.
#[derive(Debug, Clone, Serialize)]
pub struct LightSummary {
    /// Path.
    pub path: String,
    /// `DistantLight`, …
    pub kind: &'static str,
    /// Radiance before `normalize`, linear Rec.709.
    pub radiance: [f32; 3],
    /// Texture file.
    pub texture: Option<String>,
}

/// One material.
#[derive(Debug, Clone, Serialize)]
pub struct MaterialSummary {
    /// Path.
    pub path: String,
    /// Input name → texture file.
    pub textures: BTreeMap<String, String>,
}

/// One render settings prim.
#[derive(Debug, Clone, Serialize)]
pub struct RenderSummary {
    /// Path.
    pub path: String,
    /// Pixels.
    pub resolution: (u32, u32),
    /// Product name → its AOVs.
    pub products: BTreeMap<String, Vec<String>>,
}

/// Read the stage of `job` at its first frame and tell what is in it.
///
/// # Errors
/// Whatever reading reports.
pub fn info(job: &InfoJob, diagnostics: &Diagnostics) -> Result<StageSummary, Error> {
    let start = std::time::Instant::now();
    let needs = needs(job);
    let InfoJob { stage: job, wanted } = job;
    let phase = diagnostics.phase("read", "stage", 0);
    let mut source = stage::open(&job.path, job.door, diagnostics)?;
    let mut settings = read_settings(job, job.times()[0], needs);
    let raw = compose(source.as_mut(), &mut settings, diagnostics)?;
    let (scene, triangles) = stage::passes::outline(&raw, &settings, diagnostics)?;
    drop(phase);
    let mut summary = summarize(&scene);
    summary.command.clone_from(&job.command);
    summary.geometry.triangles = triangles;
    summary.tree = tree::of(&raw);
    summary.animation = tree::animation(&raw);
    summary.textures = textures::of(&scene, needs);
    textures::warn_of_missing(&summary.textures, diagnostics);
    summary.suspicions = flaws::suspicions(&raw, &scene);
    summary.job = wanted
        .as_ref()
        .map(|wanted| job_reads((wanted, settings.materials), needs, &raw, &summary.textures));
    summary.seconds = start.elapsed().as_secs_f64();
    summary.warnings = diagnostics.warnings();
    summary.broken_references = flaws::broken_references(&summary.warnings);
    Ok(summary)
}

/// What the job asked about reads; without one, everything.
fn needs(job: &InfoJob) -> Needs {
    match &job.wanted {
        Some(Purposed::Bake(aovs)) => Needs::of(aovs),
        Some(Purposed::Render(aovs)) => Needs::of_seen(aovs),
        Some(Purposed::Points) | None => Needs::ALL,
    }
}

fn job_reads(
    (wanted, has_materials): (&Purposed, bool),
    needs: Needs,
    raw: &RawStage,
    textures: &[TextureSummary],
) -> JobReads {
    let (purpose, aovs) = match wanted {
        Purposed::Points => ("points", &[][..]),
        Purposed::Bake(aovs) => ("bake", &aovs[..]),
        Purposed::Render(aovs) => ("render", &aovs[..]),
    };
    let decoded = || textures.iter().filter(|texture| texture.is_decoded);
    JobReads {
        purpose,
        aov: aovs.iter().map(|aov| aov.name()).collect(),
        materials: has_materials,
        lights: needs.lights,
        layers: raw.meta.layers.clone(),
        textures: decoded().map(|texture| texture.file.clone()).collect(),
        texture_bytes: decoded().filter_map(|texture| texture.bytes).sum(),
        attributes: raw.meta.read.attributes,
        bytes: raw.meta.read.bytes,
    }
}

fn summarize(scene: &Scene) -> StageSummary {
    let stage = &scene.stage;
    let bounds = scene.bounds();
    let corner = |p: glam::Vec3| (scene.origin + p.as_dvec3()).to_array();
    StageSummary {
        surflux: env!("CARGO_PKG_VERSION"),
        command: Vec::new(),
        stage: stage.path.display().to_string(),
        usd: stage.reader.clone(),
        up_axis: format!("{:?}", stage.up_axis),
        meters_per_unit: stage.meters_per_unit,
        default_prim: stage.default_prim.clone(),
        time_range: stage.time_range,
        time_codes_per_second: stage.time_codes_per_second,
        time: stage.time,
        layers: stage.layers.len(),
        bounds: (!bounds.is_empty()).then(|| [corner(bounds.min), corner(bounds.max)]),
        tree: Vec::new(),
        animation: AnimationSummary::default(),
        geometry: geometry(scene),
        lights: scene.lights.iter().map(light).collect(),
        cameras: scene
            .cameras
            .iter()
            .map(|camera| camera.path.clone())
            .collect(),
        materials: scene.materials.iter().map(material).collect(),
        textures: Vec::new(),
        render_settings: scene.render_settings.iter().map(render).collect(),
        broken_references: Vec::new(),
        suspicions: Vec::new(),
        job: None,
        seconds: 0.0,
        warnings: Vec::new(),
    }
}

fn geometry(scene: &Scene) -> GeometrySummary {
    let mut summary = GeometrySummary {
        prims: scene.prims.len(),
        meshes: scene.meshes.len(),
        ..GeometrySummary::default()
    };
    for mesh in &scene.meshes {
        *summary.schemes.entry(mesh.scheme.clone()).or_default() += 1;
    }
    for prim in &scene.prims {
        summary.points += scene
            .mesh_of(prim)
            .cage
            .as_ref()
            .map_or(0, |cage| cage.point_count);
        match prim.source {
            PrimSource::Direct => {}
            PrimSource::NativeInstance { .. } => summary.native_instances += 1,
            PrimSource::PointInstance { .. } => summary.point_instances += 1,
        }
    }
    summary
}

fn light(light: &Light) -> LightSummary {
    let (kind, texture) = match &light.kind {
        LightKind::Distant { .. } => ("DistantLight", None),
        LightKind::Sphere { .. } => ("SphereLight", None),
        LightKind::Rect { texture, .. } => ("RectLight", texture.as_ref()),
        LightKind::Disk { .. } => ("DiskLight", None),
        LightKind::Cylinder { .. } => ("CylinderLight", None),
        LightKind::Dome { texture } => ("DomeLight", texture.as_ref()),
        LightKind::Particles(_) => ("Points", None),
    };
    LightSummary {
        path: light.path.clone(),
        kind,
        radiance: light.radiance.to_array(),
        texture: texture.map(|path| path.display().to_string()),
    }
}

fn material(material: &Material) -> MaterialSummary {
    let texture = |(name, input): (&'static str, &Input)| match input {
        Input::Texture(read) => Some((name.to_owned(), read.file.display().to_string())),
        Input::Constant(_) | Input::Primvar { .. } => None,
    };
    MaterialSummary {
        path: material.path.clone(),
        textures: material.inputs().into_iter().filter_map(texture).collect(),
    }
}

fn render(settings: &crate::scene::RenderSettings) -> RenderSummary {
    let vars = |product: &crate::scene::RenderProduct| {
        product.vars.iter().map(|var| var.name.clone()).collect()
    };
    RenderSummary {
        path: settings.path.clone(),
        resolution: settings.resolution,
        products: settings
            .products
            .iter()
            .map(|product| (product.name.clone(), vars(product)))
            .collect(),
    }
}
