//! Jobs as meant: everything that was typed, checked and resolved.

use crate::bake::BakeSettings;
use crate::bounce::Bounces;
use crate::exchange::ply::Encoding;
use crate::gather::maps::MapsSettings;
use crate::gather::rays::cone::{Axis, Cone, Falloff};
use crate::results::{Aov, BakeInterpolation};
use crate::scene::{Purpose, UpAxis};
use crate::stage::{Composition, Door, LightGroupChoice};
use std::f32::consts::{FRAC_PI_2, PI};
use std::path::PathBuf;

/// What all jobs say about their stage.
#[derive(Debug, Clone)]
pub struct StageJob {
    /// Root layer.
    pub path: PathBuf,
    /// How to read it.
    pub door: Door,
    /// Time codes; empty = the default time.
    pub frames: Vec<f64>,
    /// A dome light in addition to the stage's own.
    pub dome: Option<Dome>,
    /// Clouds; those of their points that are no surfels are lights of the stage. Empty where no light is computed.
    pub emitters: Vec<PathBuf>,
    /// Sources to tell apart.
    pub light_groups: Vec<LightGroupChoice>,
    /// Population mask.
    pub mask: Vec<String>,
    /// Payloads, variants, session and muted layers.
    pub composition: Composition,
    /// Purposes besides `default`.
    pub purposes: Vec<Purpose>,
    /// The SurfluxBakeSettings prim that had a say in the job; `None` = the stage's own render settings count.
    pub settings: Option<String>,
    /// The command line, stored in outputs and statistics.
    pub command: Vec<String>,
}

/// A dome light that the stage does not have.
#[derive(Debug, Clone, PartialEq)]
pub enum Dome {
    /// The same white radiance from everywhere.
    Uniform(f32),
    /// A latlong image, radiance as stored.
    Image(PathBuf),
}

impl StageJob {
    /// The times to read at: the frames, or the default time once.
    pub fn times(&self) -> Vec<Option<f64>> {
        if self.frames.is_empty() {
            vec![None]
        } else {
            self.frames.iter().copied().map(Some).collect()
        }
    }
}

/// Which engine gathers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EngineChoice {
    /// The cheapest that meets the tolerance; without a tolerance, rays.
    Auto,
    /// Ray tracing, radiance from surfels.
    Rays,
    /// Depth maps for what only asks for the sky, rays for the rest.
    Maps,
    /// Points for reflected light, rays for what asks which directions are open.
    Raster,
    /// The published method.
    Paper,
}

/// How to gather.
#[derive(Debug, Clone)]
pub struct GatherJob {
    /// Results in order; empty for a render = what the stage's render settings ask, or `color`.
    pub aovs: Vec<Aov>,
    /// Reflections.
    pub bounces: Bounces,
    /// The engine.
    pub engine: EngineChoice,
    /// Relative RMSE to meet; `None`: the knobs below say what to do.
    pub tolerance: Option<f64>,
    /// Let receivers speak for others where the tolerance allows.
    pub interpolate: bool,
    /// Rays a receiver (without a tolerance).
    pub rays: u32,
    /// Maps (without a tolerance); the distance below holds for them too.
    pub maps: MapsSettings,
    /// sr.
    pub max_solid_angle: f32,
    /// Pixels.
    pub raster_resolution: u32,
    /// Stage units.
    pub max_distance: Option<f32>,
    /// What occlusion means.
    pub occlusion: OcclusionKind,
    /// Clouds that shine instead of the stage's own surfels.
    pub clouds: Vec<PathBuf>,
    /// Tell the light of each of them apart.
    pub splits_clouds: bool,
    /// Dicing; `None` for the count = from the number of receivers.
    pub spacing: Option<f32>,
    /// Surfels to aim at.
    pub surfels: Option<usize>,
}

/// The part of the hemisphere that occlusion asks about, and what distance makes of it. PBGI §8.5.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OcclusionKind {
    /// Half-angle of the cone, radians; `None`: the hemisphere, and of reflections [`Self::REFLECTION`].
    pub half_angle: Option<f32>,
    /// How coverage fades up to the largest distance.
    pub falloff: Falloff,
}

/// Part of the hemisphere above a receiver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Part {
    /// All of it.
    Whole,
    /// A cone.
    Cone(Cone),
    /// What a glossy surface reflects towards the eye.
    Lobes,
}

impl Default for OcclusionKind {
    fn default() -> Self {
        Self {
            half_angle: None,
            falloff: Falloff::None,
        }
    }
}

impl OcclusionKind {
    /// Half-angle of the cone of reflections where none is asked for, radians: 20°.
    pub const REFLECTION: f32 = 20.0 * PI / 180.0;

    /// The part of the hemisphere that `aov` asks about.
    pub fn part_of(&self, aov: Aov) -> Part {
        if aov.needs_gloss() {
            return Part::Lobes;
        }
        self.cone_of(aov).map_or(Part::Whole, Part::Cone)
    }

    /// The cone that `aov` asks about, if it does.
    pub fn cone_of(&self, aov: Aov) -> Option<Cone> {
        let falloff = self.falloff;
        let is_whole = self.half_angle.is_none() && falloff == Falloff::None;
        match aov.error_of().unwrap_or(aov) {
            Aov::ReflectionOcclusion => Some(Cone {
                axis: Axis::Mirror,
                half_angle: self.half_angle.unwrap_or(Self::REFLECTION),
                falloff,
            }),
            Aov::Occlusion | Aov::Visibility if !is_whole => Some(Cone {
                axis: Axis::Normal,
                half_angle: self.half_angle.unwrap_or(FRAC_PI_2),
                falloff,
            }),
            _ => None,
        }
    }
}

/// Surfels aimed at when nothing is asked: enough for the light of a room, up to a tenth of a surfel a receiver more.
const SURFELS: std::ops::RangeInclusive<usize> = 100_000..=500_000;

impl GatherJob {
    /// Dicing for `receivers` receivers.
    pub fn bake_settings(&self, receivers: usize) -> BakeSettings {
        let wanted = self
            .surfels
            .unwrap_or_else(|| receivers.clamp(*SURFELS.start(), *SURFELS.end()));
        BakeSettings {
            spacing: self.spacing,
            surfels: wanted,
            every_light: false,
        }
    }
}

/// `surflux info`.
#[derive(Debug, Clone)]
pub struct InfoJob {
    /// The stage.
    pub stage: StageJob,
    /// The job whose reading is asked about; `None` = the whole stage.
    pub wanted: Option<Purposed>,
}

/// A job as far as its needs go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Purposed {
    /// Direct light in a cloud.
    Points,
    /// These AOVs at points of meshes.
    Bake(Vec<Aov>),
    /// These AOVs in an image.
    Render(Vec<Aov>),
}

/// `surflux points`.
#[derive(Debug, Clone)]
pub struct PointsJob {
    /// The stage.
    pub stage: StageJob,
    /// The cloud.
    pub output: OutputJob,
    /// Dicing.
    pub bake: BakeSettings,
}

/// `surflux bake`.
#[derive(Debug, Clone)]
pub struct BakeJob {
    /// The stage.
    pub stage: StageJob,
    /// The layer.
    pub output: OutputJob,
    /// Gathering.
    pub gather: GatherJob,
    /// Layout.
    pub interpolation: BakeInterpolation,
    /// What to do below instances.
    pub instances: crate::writers::usd::layer::InstancePolicy,
    /// Shown as displayColor.
    pub display_color: Option<Aov>,
    /// Where glossy surfaces are looked at from.
    pub view: Option<BakeView>,
    /// Points to compute at instead of those of meshes; they are written again, with the results.
    pub positions: Option<PathBuf>,
}

/// The eye of a bake.
#[derive(Debug, Clone, PartialEq)]
pub enum BakeView {
    /// It looks along this direction from far away; unit, world space.
    Along(glam::Vec3),
    /// That of a camera: path or name.
    Camera(String),
}

/// `surflux render`.
#[derive(Debug, Clone)]
pub struct RenderJob {
    /// The stage.
    pub stage: StageJob,
    /// The image; no path = the render product's name.
    pub output: OutputJob,
    /// Gathering.
    pub gather: GatherJob,
    /// Path or name.
    pub camera: Option<String>,
    /// Pixels across.
    pub image_width: Option<u32>,
    /// Samples along a pixel's side.
    pub pixel_samples: u32,
    /// One part an AOV.
    pub multipart: bool,
    /// PNG beside the EXR.
    pub preview: bool,
    /// Leave lights and sky out of the image.
    pub hide_lights: bool,
}

/// Where to write.
#[derive(Debug, Clone)]
pub struct OutputJob {
    /// File, with `####` for the frame where several are written.
    pub path: Option<PathBuf>,
    /// Fail rather than replace.
    pub no_clobber: bool,
    /// List only.
    pub dry_run: bool,
    /// A page (HTML) about the run.
    pub report: Option<PathBuf>,
    /// A small picture beside the first output.
    pub thumbnail: bool,
}

impl OutputJob {
    /// True where pictures of the results are shown.
    pub(super) fn is_pictured(&self) -> bool {
        self.report.is_some() || self.thumbnail
    }

    /// Only the file `path`.
    pub fn only(path: Option<PathBuf>) -> Self {
        Self {
            path,
            no_clobber: false,
            dry_run: false,
            report: None,
            thumbnail: false,
        }
    }
}

/// `surflux verify`.
#[derive(Debug, Clone)]
pub struct VerifyJob {
    /// The stage.
    pub stage: StageJob,
    /// The page, if one is wanted.
    pub output: OutputJob,
    /// Dicing, distances and bounces; AOVs (none: all that engines differ in); engines are all of them.
    pub gather: GatherJob,
    /// Path or name of the camera of the third set of receivers.
    pub camera: Option<String>,
    /// Receivers of each set.
    pub receivers: usize,
    /// Rays of each half of the truth.
    pub truth_rays: u32,
    /// Names of the sets: `points`, `pixels`, `surfels`; empty = all there are.
    pub sets: Vec<String>,
    /// Tolerances that `auto` is asked for.
    pub tolerances: Vec<f64>,
    /// Only what `auto` picks, no sweep of engines and no pictures.
    pub only_auto: bool,
}

/// A picture or a page of a cloud or a stage.
#[derive(Debug, Clone)]
pub struct ViewJob {
    /// The cloud or stage; the first of its frames is shown.
    pub stage: StageJob,
    /// `.png` or `.html`.
    pub output: OutputJob,
    /// What is shown; `None`: the first there is.
    pub channel: Option<String>,
    /// Path or name of a camera of the stage; `None`: one that sees everything.
    pub camera: Option<String>,
    /// Pixels across.
    pub image_width: Option<u32>,
    /// Ends of false colors.
    pub range: Option<(f32, f32)>,
    /// Stops for colors.
    pub exposure: Option<f32>,
    /// Surfels that face away are drawn too.
    pub both_sides: bool,
}

/// One format into another.
#[derive(Debug, Clone)]
pub struct ConvertJob {
    /// What is read; of a USD stage with how.
    pub stage: StageJob,
    /// What is written.
    pub output: OutputJob,
    /// How PLY is written.
    pub encoding: Encoding,
    /// Where a format says nothing of it.
    pub up_axis: Option<UpAxis>,
    /// Where a format says nothing of it.
    pub meters_per_unit: Option<f64>,
    /// Points become a mesh of squares.
    pub display_mesh: bool,
}

/// Anything surflux does.
#[derive(Debug, Clone)]
pub enum Job {
    /// Bake a cloud.
    Points(PointsJob),
    /// Bake primvars.
    Bake(BakeJob),
    /// Render an image.
    Render(RenderJob),
    /// Tell.
    Info(InfoJob),
    /// Look at a cloud or a bake.
    Validate(StageJob),
    /// Measure speed against error.
    Verify(VerifyJob),
    /// Show.
    View(ViewJob),
    /// Convert.
    Convert(ConvertJob),
}

impl Job {
    /// The stage of jobs that light one.
    pub fn lit_stage_mut(&mut self) -> Option<&mut StageJob> {
        match self {
            Self::Points(job) => Some(&mut job.stage),
            Self::Bake(job) => Some(&mut job.stage),
            Self::Render(job) => Some(&mut job.stage),
            Self::Info(_)
            | Self::Validate(_)
            | Self::Verify(_)
            | Self::View(_)
            | Self::Convert(_) => None,
        }
    }
}
