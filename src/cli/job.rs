//! Arguments as typed → a [`Job`] as meant.

use super::args::{
    AboutArgs, BakeArgs, ConvertArgs, GatherArgs, InfoArgs, JobCommand, OutputArgs, PointsArgs,
    RenderArgs, StageArgs, SurfelArgs, VerifyArgs, ViewArgs,
};
use super::values::{
    AxisName, BouncesArg, EngineName, ExrLayout, InstancesName, InterpolateName, InterpolationName,
    JobName, LoadName, PurposeName, UsdDoor,
};
use crate::bake::BakeSettings;
use crate::pipeline::{
    BakeJob, BakeView, Bounces, ConvertJob, Dome, Encoding, EngineChoice, Falloff, GatherJob,
    InfoJob, Job, MapsSettings, OcclusionKind, OutputJob, PointsJob, Purposed, RenderJob, StageJob,
    VerifyJob, ViewJob, unknown_at_points,
};
use crate::results::{Aov, BakeInterpolation};
use crate::scene::{Purpose, UpAxis};
use crate::stage::{Composition, Door, LightGroupChoice, Load};
use crate::writers::usd::layer::InstancePolicy;
use anyhow::{Context, bail};
use std::path::Path;

impl JobCommand {
    /// The flags that every command has.
    pub(super) fn stage(&self) -> &StageArgs {
        match self {
            Self::Points(args) => &args.stage,
            Self::Bake(args) => &args.stage,
            Self::Render(args) => &args.stage,
            Self::Info(args) => &args.stage,
            Self::Validate(args) => &args.stage,
            Self::Verify(args) => &args.stage,
            Self::View(args) => &args.stage,
            Self::Convert(args) => &args.stage,
        }
    }

    /// Which settings prim has a say: `None` for commands that ask none.
    pub(super) fn settings(&self) -> Option<SettingsChoice<'_>> {
        let about = match self {
            Self::Points(args) => &args.about,
            Self::Bake(args) => &args.about,
            Self::Render(args) => &args.about,
            Self::Info(_)
            | Self::Validate(_)
            | Self::Verify(_)
            | Self::View(_)
            | Self::Convert(_) => return None,
        };
        match about.settings.as_deref() {
            Some("none") => None,
            Some(path) => Some(SettingsChoice::At(path)),
            None => Some(SettingsChoice::OfStage),
        }
    }
}

/// The prim whose settings count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SettingsChoice<'a> {
    /// The stage's own.
    OfStage,
    /// This one.
    At(&'a str),
}

/// What is read, and how, where the settings are asked for before the job is known.
pub(super) fn stage_of(command: &JobCommand) -> (&Path, Door, Composition) {
    let args = command.stage();
    (&args.stage, door(args.usd), composition(args))
}

/// The job that `command` means.
///
/// # Errors
/// What a person typed wrong: unknown AOVs, missing outputs, wrong extensions.
pub(super) fn from_args(command: JobCommand, command_line: &[String]) -> anyhow::Result<Job> {
    let job = match command {
        JobCommand::Points(args) => Job::Points(points(args, command_line)?),
        JobCommand::Bake(args) => Job::Bake(bake(args, command_line)?),
        JobCommand::Render(args) => Job::Render(render(args, command_line)?),
        JobCommand::Info(args) => Job::Info(info(args, command_line)?),
        JobCommand::Validate(args) => Job::Validate(stage(args.stage, command_line)?),
        JobCommand::Verify(args) => Job::Verify(verify(args, command_line)?),
        JobCommand::View(args) => Job::View(view(args, command_line)?),
        JobCommand::Convert(args) => Job::Convert(convert(args, command_line)?),
    };
    not_over_itself(&job)?;
    Ok(job)
}

/// An output that is what is read would be gone with what it was made of.
fn not_over_itself(job: &Job) -> anyhow::Result<()> {
    let (stage, output) = match job {
        Job::Points(job) => (&job.stage, &job.output),
        Job::Bake(job) => (&job.stage, &job.output),
        Job::Convert(job) => (&job.stage, &job.output),
        Job::Render(_) | Job::View(_) | Job::Info(_) | Job::Validate(_) | Job::Verify(_) => {
            return Ok(());
        }
    };
    let place = |path: &Path| path.canonicalize().ok();
    if let Some(path) = &output.path
        && place(path).is_some_and(|output| place(&stage.path) == Some(output))
    {
        bail!(
            "{}: that is the file that is read (right: another name)",
            path.display()
        );
    }
    Ok(())
}

fn stage(args: StageArgs, command_line: &[String]) -> anyhow::Result<StageJob> {
    Ok(StageJob {
        door: door(args.usd),
        composition: composition(&args),
        frames: args.frames.map(|frames| frames.0).unwrap_or_default(),
        dome: args.dome.map(dome).transpose()?,
        emitters: Vec::new(),
        light_groups: Vec::new(),
        mask: args.mask,
        purposes: args.purposes.into_iter().map(purpose).collect(),
        settings: None,
        command: command_line.to_vec(),
        path: args.stage,
    })
}

fn door(name: UsdDoor) -> Door {
    match name {
        UsdDoor::Auto => Door::Auto,
        UsdDoor::Native => Door::Native,
        UsdDoor::UsdCore => Door::UsdCore,
    }
}

fn composition(args: &StageArgs) -> Composition {
    Composition {
        load: match args.load {
            LoadName::All => Load::All,
            LoadName::None => Load::None,
        },
        variants: args.variant.clone(),
        session_layer: args.session_layer.clone(),
        muted_layers: args.mute_layer.clone(),
    }
}

/// The stage with what `gather` says of light: groups, and particles of clouds.
fn lit_stage(
    args: StageArgs,
    gather: &GatherArgs,
    command_line: &[String],
) -> anyhow::Result<StageJob> {
    Ok(StageJob {
        emitters: gather.cloud.clone(),
        light_groups: light_groups(&gather.light_groups)?,
        ..stage(args, command_line)?
    })
}

/// `NAME=PATHS`, or names separated by commas; each once.
fn light_groups(texts: &[String]) -> anyhow::Result<Vec<LightGroupChoice>> {
    let mut choices: Vec<LightGroupChoice> = Vec::new();
    let split = |text: &'_ String| match text.contains('=') {
        true => vec![text.clone()],
        false => text.split(',').map(str::to_owned).collect(),
    };
    for text in texts.iter().flat_map(split) {
        let choice: LightGroupChoice =
            (text.parse()).map_err(|wrong| anyhow::anyhow!("--light-groups: {wrong}"))?;
        if choices.iter().any(|known| known.name() == choice.name()) {
            bail!("--light-groups: {} is there twice", choice.name());
        }
        choices.push(choice);
    }
    Ok(choices)
}

fn dome(text: String) -> anyhow::Result<Dome> {
    match text.parse::<f32>() {
        Ok(radiance) if radiance >= 0.0 && radiance.is_finite() => Ok(Dome::Uniform(radiance)),
        Ok(_) => bail!("--dome {text}: radiance is a number of 0 or more"),
        Err(_) if Path::new(&text).is_file() => Ok(Dome::Image(text.into())),
        Err(_) => bail!("--dome {text}: neither a number nor a file"),
    }
}

fn purpose(name: PurposeName) -> Purpose {
    match name {
        PurposeName::Default => Purpose::Default,
        PurposeName::Render => Purpose::Render,
        PurposeName::Proxy => Purpose::Proxy,
        PurposeName::Guide => Purpose::Guide,
    }
}

fn output(args: OutputArgs, extensions: &[&str]) -> anyhow::Result<OutputJob> {
    output_named(args, "--output", extensions)
}

/// `name` is what the command line calls it.
fn output_named(args: OutputArgs, name: &str, extensions: &[&str]) -> anyhow::Result<OutputJob> {
    if let Some(path) = &args.output {
        check_extension(path, name, extensions)?;
    }
    Ok(OutputJob {
        path: args.output,
        no_clobber: args.no_clobber,
        dry_run: args.dry_run,
        ..OutputJob::only(None)
    })
}

/// What is told about a run besides its results.
fn told(output: OutputJob, args: AboutArgs) -> anyhow::Result<OutputJob> {
    if let Some(page) = &args.report {
        check_extension(page, "--report", &["html"])?;
    }
    Ok(OutputJob {
        report: args.report,
        thumbnail: args.thumbnail,
        ..output
    })
}

fn check_extension(path: &Path, name: &str, extensions: &[&str]) -> anyhow::Result<()> {
    let extension = path
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default();
    if extensions.contains(&extension) {
        return Ok(());
    }
    bail!(
        "{name} {}: the name must end in .{}",
        path.display(),
        extensions.join(" or .")
    )
}

const USD_EXTENSIONS: &[&str] = &["usdc", "usda", "usd"];

fn points(args: PointsArgs, command_line: &[String]) -> anyhow::Result<PointsJob> {
    args.output
        .output
        .as_ref()
        .context("points needs --output CLOUD.usdc")?;
    let defaults = BakeSettings::default();
    let SurfelArgs { spacing, surfels } = args.surfels;
    Ok(PointsJob {
        stage: stage(args.stage, command_line)?,
        output: told(output(args.output, USD_EXTENSIONS)?, args.about)?,
        bake: BakeSettings {
            spacing,
            surfels: surfels.unwrap_or(defaults.surfels),
            ..defaults
        },
    })
}

/// Names as typed → AOVs, each once.
fn aovs(names: &[String]) -> anyhow::Result<Vec<Aov>> {
    let mut aovs: Vec<Aov> = Vec::new();
    for name in names {
        let aov = name.trim().parse::<Aov>().context("--aov")?;
        if !aovs.contains(&aov) {
            aovs.push(aov);
        }
    }
    Ok(aovs)
}

fn info(args: InfoArgs, command_line: &[String]) -> anyhow::Result<InfoJob> {
    let aovs = aovs(&args.aov)?;
    let or = |fallback: &[Aov]| match aovs.is_empty() {
        true => fallback.to_vec(),
        false => aovs.clone(),
    };
    let wanted = match args.job {
        None => None,
        Some(JobName::Points) if !aovs.is_empty() => bail!("--for points has no --aov"),
        Some(JobName::Points) => Some(Purposed::Points),
        Some(JobName::Bake) => Some(Purposed::Bake(or(&BAKED))),
        Some(JobName::Render) => Some(Purposed::Render(or(&[Aov::Color]))),
    };
    Ok(InfoJob {
        stage: stage(args.stage, command_line)?,
        wanted,
    })
}

/// What a bake computes where nothing is asked.
const BAKED: [Aov; 2] = [Aov::Occlusion, Aov::Irradiance];

/// Tolerance of `--bounces auto` without one, and the part of a tolerance that reflections to come may take.
const USUAL_TOLERANCE: f64 = 0.02;
const LEFT_TO_COME: f64 = 0.25;

/// # Errors
/// Where flags lack what they need, and where AOVs of reflected light do not fit the bounces or the engine.
fn check_gather(args: &GatherArgs, aovs: &[Aov]) -> anyhow::Result<()> {
    if args.split_clouds && args.cloud.is_empty() {
        bail!("--split-clouds needs --cloud: clouds whose light is told apart");
    }
    if args.falloff != Falloff::None && args.max_distance.is_none() {
        bail!("--falloff needs --max-distance: where what covers has faded to nothing");
    }
    let is_reflected = |aov: &&Aov| matches!(aov, Aov::IrradianceIndirect | Aov::RadianceSh);
    let reflected = aovs
        .iter()
        .find(is_reflected)
        .filter(|_| args.bounces == BouncesArg::Count(0));
    if let Some(aov) = reflected {
        bail!("--bounces 0 leaves nothing for {aov} (right: 1 or more)");
    }
    if args.gather == EngineName::Raster && aovs.contains(&Aov::RadianceSh) {
        bail!(
            "--aov radiance_sh: engine raster keeps no directions of the light (use rays or paper)"
        );
    }
    Ok(())
}

fn gather(args: GatherArgs, surfels: SurfelArgs) -> anyhow::Result<GatherJob> {
    let aovs = aovs(&args.aov)?;
    let has_error = aovs.iter().find(|aov| aov.error_of().is_some());
    let engine = match args.gather {
        EngineName::Paper => Some("paper"),
        EngineName::Raster => Some("raster"),
        EngineName::Auto | EngineName::Rays | EngineName::Maps => None,
    };
    if let (Some(aov), Some(engine)) = (has_error, engine) {
        bail!(
            "--aov {aov}: engine {engine} does not know its error at a receiver (use rays or maps)"
        );
    }
    if args.gather == EngineName::Raster && !args.cloud.is_empty() {
        bail!(
            "--gather raster: it gathers from the stage's own surfels, which --cloud replaces (use rays or paper)"
        );
    }
    check_gather(&args, &aovs)?;
    Ok(GatherJob {
        aovs,
        bounces: match args.bounces {
            BouncesArg::Count(count) => Bounces::Count(count),
            BouncesArg::Auto => {
                let tolerance = args.tolerance.unwrap_or(USUAL_TOLERANCE);
                Bounces::Until(LEFT_TO_COME * tolerance)
            }
        },
        engine: match args.gather {
            EngineName::Auto => EngineChoice::Auto,
            EngineName::Rays => EngineChoice::Rays,
            EngineName::Maps => EngineChoice::Maps,
            EngineName::Raster => EngineChoice::Raster,
            EngineName::Paper => EngineChoice::Paper,
        },
        tolerance: args.tolerance,
        interpolate: args.interpolate == InterpolateName::Auto,
        rays: args.rays,
        maps: MapsSettings {
            directions: args.directions,
            pixel: args.map_pixel,
            cell: args.map_cell,
            ..MapsSettings::default()
        },
        max_solid_angle: args.max_solid_angle,
        raster_resolution: args.raster_resolution,
        max_distance: args.max_distance,
        occlusion: OcclusionKind {
            half_angle: args.cone_angle.map(f32::to_radians),
            falloff: args.falloff,
        },
        clouds: args.cloud,
        splits_clouds: args.split_clouds,
        spacing: surfels.spacing,
        surfels: surfels.surfels,
    })
}

fn bake(args: BakeArgs, command_line: &[String]) -> anyhow::Result<BakeJob> {
    args.output
        .output
        .as_ref()
        .context("bake needs --output DIR/NAME.usdc")?;
    let stage = lit_stage(args.stage, &args.gather, command_line)?;
    let mut gather = gather(args.gather, args.surfels)?;
    if gather.aovs.is_empty() {
        gather.aovs = BAKED.to_vec();
    }
    if gather.aovs.contains(&Aov::Depth) {
        bail!("--aov depth: a bake has no camera to measure depth from (use render)");
    }
    let display_color = match args.display_color.as_deref() {
        Some("none") => None,
        Some(name) => Some(name.parse::<Aov>().context("--display-color")?),
        None => gather.aovs.first().copied(),
    };
    if let Some(aov) = display_color.filter(|aov| !gather.aovs.contains(aov)) {
        gather.aovs.push(aov);
    }
    let view = args.view.as_deref().map(bake_view).transpose()?;
    let glossy = gather.aovs.iter().find(|aov| aov.needs_gloss());
    if let Some(aov) = glossy.filter(|_| view.is_none()) {
        bail!(
            "--aov {aov}: a bake has no eye to reflect to (add --view X,Y,Z or --view CAMERA, or use render)"
        );
    }
    if let Some(aov) = (args.positions.as_ref()).and_then(|_| unknown_at_points(&gather.aovs)) {
        bail!(
            "--aov {aov}: the points of --positions lie on no surface that is known and have no material"
        );
    }
    Ok(BakeJob {
        stage,
        positions: args.positions,
        output: told(output(args.output, USD_EXTENSIONS)?, args.about)?,
        gather,
        interpolation: match args.interpolation {
            InterpolationName::Vertex => BakeInterpolation::Vertex,
            InterpolationName::FaceVarying => BakeInterpolation::FaceVarying,
        },
        instances: match args.instances {
            InstancesName::Shared => InstancePolicy::Shared,
            InstancesName::Deinstance => InstancePolicy::Deinstance,
            InstancesName::Skip => InstancePolicy::Skip,
        },
        display_color,
        view,
    })
}

/// A direction to look along, or a camera.
fn bake_view(text: &str) -> anyhow::Result<BakeView> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    let [x, y, z] = parts[..] else {
        return Ok(BakeView::Camera(text.to_owned()));
    };
    let number = |text: &str| {
        text.parse::<f32>()
            .with_context(|| format!("--view: {text:?} is no number"))
    };
    let along = glam::Vec3::new(number(x)?, number(y)?, number(z)?).try_normalize();
    let along = along.context("--view: wanted a direction that is not 0,0,0")?;
    Ok(BakeView::Along(along))
}

fn render(args: RenderArgs, command_line: &[String]) -> anyhow::Result<RenderJob> {
    let stage = lit_stage(args.stage, &args.gather, command_line)?;
    let gather = gather(args.gather, args.surfels)?;
    let job = RenderJob {
        stage,
        output: told(output(args.output, &["exr"])?, args.about)?,
        gather,
        camera: args.camera,
        image_width: args.image_width,
        pixel_samples: args.pixel_samples,
        multipart: args.exr == ExrLayout::Multipart,
        preview: args.preview,
        hide_lights: args.hide_lights,
    };
    let pattern = job
        .output
        .path
        .as_ref()
        .is_some_and(|path| path.to_string_lossy().contains('#'));
    if job.output.path.is_some() && job.stage.frames.len() > 1 && !pattern {
        bail!(
            "--output needs #### in its name where several frames are rendered (right: shot.####.exr)"
        );
    }
    Ok(job)
}

fn verify(args: VerifyArgs, command_line: &[String]) -> anyhow::Result<VerifyJob> {
    let aovs = aovs(&args.aov)?;
    let measured = [
        Aov::Visibility,
        Aov::IrradianceIndirect,
        Aov::IrradianceEnvironment,
    ];
    if let Some(aov) = aovs.iter().find(|aov| !measured.contains(aov)) {
        bail!(
            "--aov {aov}: verify measures visibility, irradiance_indirect and irradiance_environment"
        );
    }
    Ok(VerifyJob {
        stage: stage(args.stage, command_line)?,
        output: output(args.output, &["html"])?,
        gather: GatherJob {
            aovs,
            bounces: Bounces::Count(args.bounces),
            engine: EngineChoice::Auto,
            tolerance: None,
            interpolate: args.interpolate == InterpolateName::Auto,
            rays: args.truth_rays,
            maps: MapsSettings::default(),
            max_solid_angle: PAPER.0,
            raster_resolution: PAPER.1,
            max_distance: args.max_distance,
            occlusion: OcclusionKind::default(),
            clouds: Vec::new(),
            splits_clouds: false,
            spacing: args.surfels.spacing,
            surfels: args.surfels.surfels,
        },
        camera: args.camera,
        receivers: args.receivers as usize,
        truth_rays: args.truth_rays,
        tolerances: args.tolerance,
        sets: args.sets,
        only_auto: args.only_auto,
    })
}

fn view(args: ViewArgs, command_line: &[String]) -> anyhow::Result<ViewJob> {
    args.output
        .output
        .as_ref()
        .context("view needs --output OUT.png or OUT.html")?;
    if args.exposure.is_some_and(|stops| !stops.is_finite()) {
        bail!("--exposure: a number of stops is needed");
    }
    Ok(ViewJob {
        stage: stage(args.stage, command_line)?,
        output: output(args.output, &["png", "html"])?,
        channel: args.aov,
        camera: args.camera,
        image_width: args.image_width,
        range: args.range,
        exposure: args.exposure,
        both_sides: args.both_sides,
    })
}

/// Endings of the names that can be written.
const WRITTEN: &[&str] = &["usdc", "usda", "usd", "glb", "ply", "ptc"];

fn convert(args: ConvertArgs, command_line: &[String]) -> anyhow::Result<ConvertJob> {
    let output = OutputArgs {
        output: Some(args.to),
        no_clobber: args.no_clobber,
        dry_run: args.dry_run,
    };
    Ok(ConvertJob {
        stage: stage(args.stage, command_line)?,
        output: output_named(output, "OUT", WRITTEN)?,
        encoding: match (args.ascii, args.big_endian) {
            (true, _) => Encoding::Ascii,
            (_, true) => Encoding::BinaryBig,
            _ => Encoding::Binary,
        },
        up_axis: args.up_axis.map(|axis| match axis {
            AxisName::Y => UpAxis::Y,
            AxisName::Z => UpAxis::Z,
        }),
        // the decimal digits that were typed, not the nearest single
        meters_per_unit: args
            .meters_per_unit
            .and_then(|unit| unit.to_string().parse().ok()),
        display_mesh: args.display_mesh,
    })
}

/// The paper's knobs, which a sweep replaces.
const PAPER: (f32, u32) = (0.03, 12);
