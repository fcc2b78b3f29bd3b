//! Arguments as typed.

use super::frames::Frames;
use super::progress::ProgressMode;
use super::run::RunArgs;
use super::values::{
    AxisName, BouncesArg, EngineName, ExrLayout, InstancesName, InterpolateName, InterpolationName,
    JobName, LoadName, PurposeName, UsdDoor, bounces, cone_angle, falloff, fraction, not_negative,
    positive, range,
};
use crate::pipeline::Falloff;
use crate::stage::VariantChoice;
use clap::{ArgAction, Args, Parser, Subcommand};
use std::path::PathBuf;

/// Point-based global illumination for USD stages.
#[derive(Debug, Parser)]
#[command(
    name = "surflux",
    version,
    about,
    max_term_width = 120,
    after_help = "Every flag of a command is an environment variable too: --image-width is SURFLUX_IMAGE_WIDTH. What is \
    typed wins over variables, these over SurfluxBakeSettings of the stage, these over the --config file.\n\n\
    Example:\n  surflux bake asset.usd -o bake/asset.usdc --aov occlusion"
)]
pub(super) struct Cli {
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Debug, Subcommand)]
#[expect(clippy::large_enum_variant, reason = "there is one, for the whole run")]
pub(super) enum Command {
    #[command(flatten)]
    Job(JobCommand),
    /// Run a recipe: commands on many files and frames, in order, skipping what is up to date.
    #[command(
        after_help = "Example:\n  surflux run pipelines/occlusion_library.json --set assets='props/**/*.usd' --dry-run"
    )]
    Run(RunArgs),
    /// Write the completions of a shell to stdout.
    #[command(
        after_help = "Example:\n  surflux completions bash > ~/.local/share/bash-completion/completions/surflux"
    )]
    Completions {
        /// Whose.
        shell: clap_complete::Shell,
    },
    /// Write the manual pages, one a command.
    #[command(after_help = "Example:\n  surflux man ~/.local/share/man/man1")]
    Man {
        /// A folder that exists.
        folder: PathBuf,
    },
}

impl Command {
    /// The habits of commands that run something.
    pub(super) fn habits(&self) -> Option<&HabitArgs> {
        match self {
            Self::Job(command) => Some(&command.stage().habits),
            Self::Run(args) => Some(&args.habits),
            Self::Completions { .. } | Self::Man { .. } => None,
        }
    }
}

/// What is done with a stage.
#[derive(Debug, Subcommand)]
pub(super) enum JobCommand {
    /// Bake direct light into a surfel cloud (UsdGeomPoints).
    #[command(after_help = "Example:\n  surflux points shot.usda -o cloud.usdc --surfels 500000")]
    Points(PointsArgs),
    /// Bake light at the points of every mesh into an override layer of primvars.
    #[command(
        after_help = "Example:\n  surflux bake asset.usd -o bake/asset.usdc --aov occlusion,irradiance\n\n\
        Writes bake/asset.usdc (pure overs) and bake/asset_baked.usda, which sublayers it over the asset."
    )]
    Bake(BakeArgs),
    /// Render light seen by a camera into the AOVs of an EXR.
    #[command(
        after_help = "Example:\n  surflux render shot.usda -o shot.####.exr --frames 101:110 --camera /cam \
        --aov color,occlusion --preview"
    )]
    Render(RenderArgs),
    /// Tell what is in a stage, in one screen.
    #[command(
        after_help = "Example:\n  surflux info shot.usda --json\n  surflux info shot.usda --for bake --aov occlusion"
    )]
    Info(InfoArgs),
    /// Check a cloud or a bake: lengths, interpolation, extents, units, ids, values; exit code 1 if something is wrong.
    #[command(
        after_help = "Example:\n  surflux validate bake/asset_baked.usda --json",
        mut_arg("stage", |file| file.value_name("FILE").help("A cloud, a layer of baked primvars, or the stage that shows one")),
        mut_arg("frames", |flag| flag.hide(true)),
        mut_arg("dome", |flag| flag.hide(true)),
        mut_arg("mask", |flag| flag.hide(true)),
        mut_arg("purposes", |flag| flag.hide(true))
    )]
    Validate(ValidateArgs),
    /// Measure speed against error: engines and settings against ray-traced truth, on this stage.
    #[command(after_help = "Example:\n  surflux verify shot.usda -o report.html --json")]
    Verify(VerifyArgs),
    /// Show a cloud or a baked stage: a picture (.png), or a page that opens from disk (.html).
    #[command(
        after_help = "Example:\n  surflux view cloud.usdc -o cloud.html\n  surflux view bake/asset_baked.usda -o asset.png \
        --aov occlusion",
        mut_arg("stage", |file| file.value_name("CLOUD|STAGE").help("A cloud (Points), or a stage with primvars on meshes")),
        mut_arg("dome", |flag| flag.hide(true))
    )]
    View(ViewArgs),
    /// Convert between USD and other formats: glTF ↔ USD, clouds ↔ PLY and .ptc, Gaussian splats ↔ PLY.
    #[command(
        after_help = "Example:\n  surflux convert cloud.usdc cloud.ply\n  surflux convert scan.ply scan.usdc --up-axis z\n  \
        surflux convert asset.glb asset.usdc\n  surflux convert bake/asset_baked.usda asset.glb",
        mut_arg("stage", |file| file.index(1).value_name("IN").help("What to read: .usd, .usda, .usdc, .gltf, .glb, .ply or .ptc")),
        mut_arg("dome", |flag| flag.hide(true))
    )]
    Convert(ConvertArgs),
}

/// Flags of every command.
#[derive(Debug, Args)]
pub(super) struct StageArgs {
    /// The stage: .usd, .usda, .usdc or .usdz.
    pub(super) stage: PathBuf,
    /// How to read USD: the openusd crate, Pixar's usd-core in Python, or whichever is there.
    #[arg(long, value_enum, default_value_t = UsdDoor::Auto, env = "SURFLUX_USD")]
    pub(super) usd: UsdDoor,
    /// Frames: 101, 101:110, 101:110x2, 101-110:2, 1,5,9. Without it: the default time.
    #[arg(long, allow_hyphen_values = true)]
    pub(super) frames: Option<Frames>,
    /// Add a dome light: its radiance (1 = white), or a latlong .exr or .hdr image.
    #[arg(long, value_name = "RADIANCE|FILE")]
    pub(super) dome: Option<String>,
    /// Only these prims, what is below and what is above them.
    #[arg(long, value_name = "PATHS", value_delimiter = ',')]
    pub(super) mask: Vec<String>,
    /// Payloads: bring in all, or none.
    #[arg(long, value_enum, default_value_t = LoadName::All)]
    pub(super) load: LoadName,
    /// Choose a variant, stronger than what the stage says; many times.
    #[arg(long, value_name = "/PRIM{SET=CHOICE}")]
    pub(super) variant: Vec<VariantChoice>,
    /// A layer stronger than the stage, as usdview has it.
    #[arg(
        long,
        visible_alias = "session",
        alias = "sessionLayer",
        value_name = "LAYER"
    )]
    pub(super) session_layer: Option<PathBuf>,
    /// Compose without this layer (as a subLayers list names it, or absolute); many times.
    #[arg(long, alias = "muteLayer", value_name = "ID")]
    pub(super) mute_layer: Vec<String>,
    /// Purposes to include besides default.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "render")]
    pub(super) purposes: Vec<PurposeName>,
    /// Worker threads; 0 = one a core. Results do not depend on it.
    #[arg(long, default_value_t = 0, env = "SURFLUX_THREADS")]
    pub(super) threads: usize,
    /// Progress on stderr.
    #[arg(long, value_enum, default_value_t = ProgressMode::Auto)]
    pub(super) progress: ProgressMode,
    /// Statistics as JSON on stdout.
    #[arg(long)]
    pub(super) json: bool,
    /// More messages (-v info, -vv debug).
    #[arg(short, long, action = ArgAction::Count)]
    pub(super) verbose: u8,
    /// Errors only.
    #[arg(short, long, conflicts_with = "verbose")]
    pub(super) quiet: bool,
    /// Write messages to a file too.
    #[arg(long, value_name = "FILE")]
    pub(super) log_file: Option<PathBuf>,
    #[command(flatten)]
    pub(super) habits: HabitArgs,
}

/// Flags of every command that runs something.
#[derive(Debug, Clone, Args)]
pub(super) struct HabitArgs {
    /// Messages, warnings and errors as JSON objects, one a line.
    #[arg(long)]
    pub(super) log_json: bool,
    /// Settings that nothing else says (schemas/config.schema.json).
    #[arg(long, value_name = "FILE.json")]
    pub(super) config: Option<PathBuf>,
    /// Tell every setting as resolved, and where it comes from, as JSON; compute nothing. --config takes what is told.
    #[arg(long)]
    pub(super) print_config: bool,
}

/// Flags of the commands that write.
#[derive(Debug, Args)]
pub(super) struct OutputArgs {
    /// Output file.
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// Fail rather than replace a file.
    #[arg(long)]
    pub(super) no_clobber: bool,
    /// List the outputs, compute nothing.
    #[arg(long)]
    pub(super) dry_run: bool,
}

/// Flags of the commands that light: what the stage says of their settings, what they tell about their run.
#[derive(Debug, Args)]
pub(super) struct AboutArgs {
    /// The SurfluxBakeSettings prim that has a say in what no flag says; `none`: no prim has. Default: the one that the
    /// stage's renderSettingsPrimPath names, else the first below /Render.
    #[arg(long, value_name = "PATH|none")]
    pub(super) settings: Option<String>,
    /// Write a page about the run: pictures with and without reflected light, settings, statistics, warnings, error.
    #[arg(long, value_name = "FILE.html")]
    pub(super) report: Option<PathBuf>,
    /// Write a small picture of the first result beside the first output, as `NAME_thumbnail.png`.
    #[arg(long)]
    pub(super) thumbnail: bool,
}

/// Flags of dicing.
#[derive(Debug, Args)]
pub(super) struct SurfelArgs {
    /// Surfel spacing, stage units.
    #[arg(long, value_name = "LENGTH", value_parser = positive)]
    pub(super) spacing: Option<f32>,
    /// Number of surfels to aim at (without --spacing).
    #[arg(long, value_name = "N", conflicts_with = "spacing")]
    pub(super) surfels: Option<usize>,
}

/// Flags of gathering.
#[derive(Debug, Args)]
pub(super) struct GatherArgs {
    /// Results, comma separated.
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub(super) aov: Vec<String>,
    /// Diffuse reflections that `irradiance_indirect` holds; `auto`: until what is left to come is a quarter of --tolerance
    /// (0.02 without one).
    #[arg(long, value_name = "N|auto", default_value = "1", value_parser = bounces)]
    pub(super) bounces: BouncesArg,
    /// Gather engine.
    #[arg(long, value_enum, default_value_t = EngineName::Auto)]
    pub(super) gather: EngineName,
    /// Error to meet, rms(x − truth) / mean |truth| of each AOV, 0.02 = 2 %: engine, rays and light samples follow.
    #[arg(long, value_name = "T", value_parser = fraction,
        conflicts_with_all = ["rays", "directions", "map_pixel", "map_cell"])]
    pub(super) tolerance: Option<f64>,
    /// Let receivers that rays have seen speak for their neighbors, as far as --tolerance allows. Only with one.
    #[arg(long, value_enum, default_value_t = InterpolateName::Auto)]
    pub(super) interpolate: InterpolateName,
    /// Rays a receiver (engine rays without --tolerance).
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(16..=1_048_576))]
    pub(super) rays: u32,
    /// Directions that depth maps are drawn along (engine maps without --tolerance).
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=65_536))]
    pub(super) directions: u32,
    /// Width of a map's pixel, in mean edges of the densest meshes (engine maps without --tolerance).
    #[arg(long, value_name = "EDGES", default_value_t = 1.0, value_parser = positive)]
    pub(super) map_pixel: f32,
    /// Width of the cells that meshes are thinned to before they are drawn, in mean edges; below 1: as they are.
    #[arg(long, value_name = "EDGES", default_value_t = 0.0, value_parser = not_negative)]
    pub(super) map_cell: f32,
    /// Largest solid angle of a cluster, sr (engines raster and paper without --tolerance).
    #[arg(long, alias = "maxsolidangle", value_name = "SR", default_value_t = 0.03, value_parser = positive)]
    pub(super) max_solid_angle: f32,
    /// Engine paper: pixels along a side of the raster cube. Engine raster: three times the rays that ask whether a group
    /// of neighbors sees a cluster; its square over 4 where it sees part of it (without --tolerance).
    #[arg(long, alias = "rasterresolution", value_name = "N", default_value_t = 12,
        value_parser = clap::value_parser!(u32).range(2..=256))]
    pub(super) raster_resolution: u32,
    /// Nothing farther than this covers or shines, stage units.
    #[arg(long, alias = "maxdist", value_name = "LENGTH", value_parser = positive)]
    pub(super) max_distance: Option<f32>,
    /// How what covers `occlusion`, `visibility` and `reflection_occlusion` fades up to --max-distance: all of it, 1 − x,
    /// smoothly, or (1 − x) to a power (2). By rays.
    #[arg(long, value_name = "none|linear|smooth|exponent[:P]", default_value = "none", value_parser = falloff)]
    pub(super) falloff: Falloff,
    /// Half-angle of the cone that these ask about, degrees. Default: 90, and 20 for reflections. By rays.
    #[arg(long, alias = "coneangle", value_name = "DEGREES", value_parser = cone_angle)]
    pub(super) cone_angle: Option<f32>,
    /// Tell the light of these sources apart: a collection's name, or NAME=PATHS; many times. `irradiance` is then written as
    /// `irradiance_NAME` too, the sources of no group as `irradiance_default`.
    #[arg(long, alias = "lightGroups", value_name = "NAME[=PATH,…]")]
    pub(super) light_groups: Vec<String>,
    /// Clouds (UsdGeomPoints) that shine: surfels instead of the stage's own; points without normals, or with emission and no
    /// radiosity, as particles that light the stage. Many times.
    #[arg(long, alias = "sources", value_name = "CLOUD")]
    pub(super) cloud: Vec<PathBuf>,
    /// Write what each cloud adds to `irradiance_indirect` and `diffuse_indirect`, called by its file, besides their sum.
    #[arg(long)]
    pub(super) split_clouds: bool,
}

#[derive(Debug, Args)]
pub(super) struct PointsArgs {
    #[command(flatten)]
    pub(super) stage: StageArgs,
    #[command(flatten)]
    pub(super) output: OutputArgs,
    #[command(flatten)]
    pub(super) about: AboutArgs,
    #[command(flatten)]
    pub(super) surfels: SurfelArgs,
}

#[derive(Debug, Args)]
pub(super) struct BakeArgs {
    #[command(flatten)]
    pub(super) stage: StageArgs,
    #[command(flatten)]
    pub(super) output: OutputArgs,
    #[command(flatten)]
    pub(super) about: AboutArgs,
    #[command(flatten)]
    pub(super) surfels: SurfelArgs,
    #[command(flatten)]
    pub(super) gather: GatherArgs,
    /// Layout of the primvars on meshes.
    #[arg(long, value_enum, default_value_t = InterpolationName::Vertex)]
    pub(super) interpolation: InterpolationName,
    /// Compute at the points of this file (UsdGeomPoints with normals) instead of those of meshes; they are written to the
    /// output with the results as primvars.
    #[arg(long, value_name = "CLOUD")]
    pub(super) positions: Option<PathBuf>,
    /// What to do about meshes below instances.
    #[arg(long, value_enum, default_value_t = InstancesName::Shared)]
    pub(super) instances: InstancesName,
    /// AOV to show as displayColor; `none` leaves it alone. Default: the first one.
    #[arg(long, value_name = "AOV|none")]
    pub(super) display_color: Option<String>,
    /// Where `specular_indirect` and `reflection_occlusion` are seen from: a direction to look along (world space), or a
    /// camera (path or name).
    #[arg(long, value_name = "X,Y,Z|CAMERA", allow_hyphen_values = true)]
    pub(super) view: Option<String>,
}

#[derive(Debug, Args)]
pub(super) struct RenderArgs {
    #[command(flatten)]
    pub(super) stage: StageArgs,
    #[command(flatten)]
    pub(super) output: OutputArgs,
    #[command(flatten)]
    pub(super) about: AboutArgs,
    #[command(flatten)]
    pub(super) surfels: SurfelArgs,
    #[command(flatten)]
    pub(super) gather: GatherArgs,
    /// Camera path or name. Default: the render settings' camera, the stage's first, or an automatic framing.
    #[arg(long, value_name = "PATH")]
    pub(super) camera: Option<String>,
    /// Pixels across; the height follows the camera's aperture.
    #[arg(long, alias = "imageWidth", value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub(super) image_width: Option<u32>,
    /// Samples along a pixel's side.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub(super) pixel_samples: u32,
    /// One part, or one part an AOV.
    #[arg(long, value_enum, default_value_t = ExrLayout::Single)]
    pub(super) exr: ExrLayout,
    /// Write a tone-mapped PNG of the first AOV beside the EXR.
    #[arg(long)]
    pub(super) preview: bool,
    /// Leave the shapes of lights and the sky out of `color` and `emission`.
    #[arg(long)]
    pub(super) hide_lights: bool,
}

#[derive(Debug, Args)]
pub(super) struct InfoArgs {
    #[command(flatten)]
    pub(super) stage: StageArgs,
    /// Tell what such a job would read, and nothing else.
    #[arg(long = "for", value_enum, value_name = "JOB")]
    pub(super) job: Option<JobName>,
    /// AOVs of that job, comma separated.
    #[arg(long, value_name = "NAME", value_delimiter = ',', requires = "job")]
    pub(super) aov: Vec<String>,
}

#[derive(Debug, Args)]
pub(super) struct ValidateArgs {
    #[command(flatten)]
    pub(super) stage: StageArgs,
}

#[derive(Debug, Args)]
pub(super) struct VerifyArgs {
    #[command(flatten)]
    pub(super) stage: StageArgs,
    #[command(flatten)]
    pub(super) output: OutputArgs,
    #[command(flatten)]
    pub(super) surfels: SurfelArgs,
    /// Diffuse reflections that `irradiance_indirect` holds.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) bounces: u32,
    /// Nothing farther than this covers or shines, stage units.
    #[arg(long, alias = "maxdist", value_name = "LENGTH", value_parser = positive)]
    pub(super) max_distance: Option<f32>,
    /// Camera path or name for the set of pixels. Default: as `render`.
    #[arg(long, value_name = "PATH")]
    pub(super) camera: Option<String>,
    /// Receivers of each set.
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=65_536))]
    pub(super) receivers: u32,
    /// AOVs to measure, of `visibility`, `irradiance_indirect` and `irradiance_environment`, comma separated. Default: all
    /// that the stage has light for.
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub(super) aov: Vec<String>,
    /// Sets of receivers, comma separated. Default: all.
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = ["points", "pixels", "surfels"])]
    pub(super) sets: Vec<String>,
    /// Tolerances that the choice of `bake` and `render` is measured for, comma separated.
    #[arg(long, value_name = "T", value_delimiter = ',', default_values_t = [0.05, 0.02, 0.01], value_parser = fraction)]
    pub(super) tolerance: Vec<f64>,
    /// Measure what `--tolerance` picks and nothing else.
    #[arg(long)]
    pub(super) only_auto: bool,
    /// As `bake` and `render` have it; `never`: receivers of the set alone are seen, which takes less time.
    #[arg(long, value_enum, default_value_t = InterpolateName::Auto)]
    pub(super) interpolate: InterpolateName,
    /// Rays of each of the truth's two halves.
    #[arg(long, value_name = "N", default_value_t = 8192, value_parser = clap::value_parser!(u32).range(256..=1_048_576))]
    pub(super) truth_rays: u32,
}

#[derive(Debug, Args)]
pub(super) struct ViewArgs {
    #[command(flatten)]
    pub(super) stage: StageArgs,
    #[command(flatten)]
    pub(super) output: OutputArgs,
    /// What to show: a primvar, or N. Default: displayColor, else the first there is. A page has all.
    #[arg(long, value_name = "NAME")]
    pub(super) aov: Option<String>,
    /// Camera path or name. Default: all is in view.
    #[arg(long, value_name = "PATH")]
    pub(super) camera: Option<String>,
    /// Pixels across.
    #[arg(long, alias = "imageWidth", short = 'w', value_name = "N", value_parser = clap::value_parser!(u32).range(16..=16_384))]
    pub(super) image_width: Option<u32>,
    /// Ends of the scale of false colors. Default: 0:1 for fractions, else all but the outermost 0.5 %.
    #[arg(long, value_name = "LOW:HIGH", value_parser = range, allow_hyphen_values = true)]
    pub(super) range: Option<(f32, f32)>,
    /// Brighten colors by so many stops. Default: 95 % of them up to white.
    #[arg(long, value_name = "STOPS", allow_hyphen_values = true)]
    pub(super) exposure: Option<f32>,
    /// Show surfels from behind too.
    #[arg(long)]
    pub(super) both_sides: bool,
}

#[derive(Debug, Args)]
pub(super) struct ConvertArgs {
    #[command(flatten)]
    pub(super) stage: StageArgs,
    /// What to write; its name says the format.
    #[arg(value_name = "OUT", index = 2)]
    pub(super) to: PathBuf,
    /// PLY as text.
    #[arg(long)]
    pub(super) ascii: bool,
    /// PLY with its bytes the other way around.
    #[arg(long, conflicts_with = "ascii")]
    pub(super) big_endian: bool,
    /// What points up, where the format read does not say. Default: Y.
    #[arg(long, value_enum, ignore_case = true, value_name = "AXIS")]
    pub(super) up_axis: Option<AxisName>,
    /// Length of a unit in meters, where the format read does not say. Default: 1.
    #[arg(long, value_name = "METERS", value_parser = positive)]
    pub(super) meters_per_unit: Option<f32>,
    /// Write points as a mesh of squares, for programs that draw no points.
    #[arg(long)]
    pub(super) display_mesh: bool,
    /// Fail rather than replace a file.
    #[arg(long)]
    pub(super) no_clobber: bool,
    /// List the outputs, do nothing.
    #[arg(long)]
    pub(super) dry_run: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
