//! Surfels, octree, bounces, gather and error estimate of one frame.

use super::Error;
use super::job::{EngineChoice, GatherJob};
use super::report::{Report, timed};
use super::world::World;
use crate::bake::{self, BakeSettings, Baked};
use crate::bounce::{self, BounceClouds, CoarseCloud};
use crate::diagnostics::Diagnostics;
use crate::gather::paper::{PaperEngine, PaperSettings};
use crate::gather::{
    self, Engine, GatherScene, LoadedCloud, RadianceSource, RaysEngine, RaysFactory, RaysSettings,
    Reference,
};
use crate::octree::Octree;
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use crate::stage::cloud;
use crate::surfels::{DiceMap, SurfelCloud};

/// The surfels that shine.
enum Light {
    /// Nobody asks for reflected light.
    None,
    /// Diced from the scene.
    Baked { cloud: SurfelCloud, dice: DiceMap },
    /// Read from files.
    Loaded(Vec<SurfelCloud>),
}

impl Light {
    fn len(&self) -> usize {
        match self {
            Self::None => 0,
            Self::Baked { cloud, .. } => cloud.len(),
            Self::Loaded(clouds) => clouds.iter().map(SurfelCloud::len).sum(),
        }
    }

    fn source(&self, world: &World<'_>) -> Option<RadianceSource<'_>> {
        match self {
            Self::None => None,
            Self::Baked { cloud, dice } => Some(RadianceSource::Baked { cloud, dice }),
            Self::Loaded(clouds) => Some(RadianceSource::Loaded(
                clouds
                    .iter()
                    .map(|cloud| LoadedCloud::new(cloud, world.scene().origin))
                    .collect(),
            )),
        }
    }
}

/// Compute `aovs` at `receivers`.
pub(super) fn gather(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    run: (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let (report, diagnostics) = run;
    report.counts.receivers = report.counts.receivers.max(receivers.len());
    report.counts.gathered = report.counts.receivers;
    let light = light(world, receivers, aovs, job, (&mut *report, diagnostics))?;
    report.counts.surfels = report.counts.surfels.max(light.len());
    let settings = RaysSettings {
        rays: job.rays,
        max_distance: job.max_distance,
        ..RaysSettings::default()
    };
    match job.engine {
        EngineChoice::Rays => {
            let engine = RaysEngine::new(&world.tracer, light.source(world), settings);
            let reference =
                RaysEngine::new(&world.tracer, light.source(world), settings.reference());
            let reference = Reference {
                engine: &reference,
                cost: settings.reference().rays / settings.rays.max(1),
                error_share: RaysSettings::REFERENCE_ERROR_SHARE,
            };
            see(
                world,
                (&engine, reference),
                receivers,
                aovs,
                (report, diagnostics),
            )
        }
        EngineChoice::Paper => {
            let octree = timed(&mut report.seconds.octree, || {
                Octree::new(&whole_cloud(&light))
            });
            report.counts.nodes = report.counts.nodes.max(octree.node_count());
            let engine = PaperEngine::new(
                &octree,
                PaperSettings {
                    max_solid_angle: job.max_solid_angle,
                    raster_resolution: job.raster_resolution,
                    max_distance: job.max_distance,
                },
            );
            let reference = RaysEngine::new(&world.tracer, light.source(world), settings);
            let reference = Reference {
                engine: &reference,
                cost: PAPER_REFERENCE_COST,
                error_share: 0.0,
            };
            see(
                world,
                (&engine, reference),
                receivers,
                aovs,
                (report, diagnostics),
            )
        }
    }
}

/// Cost of a reference receiver by rays over one by the paper's engine: measured between 2 and 4 on Cornell boxes.
const PAPER_REFERENCE_COST: u32 = 4;

/// All surfels as one cloud for the octree.
fn whole_cloud(light: &Light) -> SurfelCloud {
    match light {
        Light::None => SurfelCloud::default(),
        Light::Baked { cloud, .. } => cloud.clone(),
        Light::Loaded(clouds) => SurfelCloud::joined(clouds),
    }
}

/// Gather with `engine` and estimate its error against `reference`.
fn see(
    world: &World<'_>,
    (engine, reference): (&dyn Engine, Reference<'_>),
    receivers: &Receivers,
    aovs: &[Aov],
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let scene = GatherScene {
        shader: world.shader,
        tracer: &world.tracer,
        lighting: Some(&world.lighting),
    };
    report.set("gather", engine.name());
    let results = timed(&mut report.seconds.gather, || {
        gather::gather(scene, engine, receivers, aovs, diagnostics)
    })?;
    let estimates = timed(&mut report.seconds.gather, || {
        gather::estimate(scene, reference, receivers, &results, diagnostics)
    })?;
    for estimate in estimates {
        let worst = report
            .error
            .aovs
            .entry(estimate.aov.name().to_owned())
            .or_default();
        *worst = worst.max(estimate.relative_rmse);
    }
    report.error.estimate = report.error.aovs.values().copied().reduce(f64::max);
    report.error.method = format!(
        "{} on receivers of the run against {} as reference",
        engine.name(),
        reference.engine.name()
    );
    Ok(results)
}

/// The surfels `aovs` need: baked (and bounced), read from files, or none.
fn light(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Light, Error> {
    let shines = !world.lighting.is_dark() || !job.clouds.is_empty();
    let indirect = shines && job.bounces > 0 && aovs.iter().any(|aov| aov.needs_indirect());
    if !indirect && job.engine == EngineChoice::Rays {
        return Ok(Light::None);
    }
    if !job.clouds.is_empty() {
        let origin = world.scene().origin;
        let clouds = timed(&mut report.seconds.read, || {
            job.clouds
                .iter()
                .map(|path| cloud::read_cloud(path, origin, diagnostics))
                .collect::<Result<Vec<_>, _>>()
        })?;
        return Ok(Light::Loaded(clouds));
    }
    let settings = job.bake_settings(receivers.len());
    let baked = dice(world, &settings, (&mut *report, diagnostics))?;
    report.set("spacing", f64::from(baked.cloud.spacing));
    if job.bounces <= 1 {
        return Ok(Light::Baked {
            cloud: baked.cloud,
            dice: baked.dice,
        });
    }
    let cloud = bounced(world, &baked, job, (report, diagnostics))?;
    Ok(Light::Baked {
        cloud,
        dice: baked.dice,
    })
}

/// Dice and light the world.
pub(super) fn dice(
    world: &World<'_>,
    settings: &BakeSettings,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Baked, Error> {
    let baked = timed(&mut report.seconds.points, || {
        bake::bake(
            world.shader,
            &world.tracer,
            &world.lighting,
            settings,
            diagnostics,
        )
    })?;
    Ok(baked)
}

/// Surfels of the cloud that bounces are computed on: light after two reflections is smooth. PBGI §8.3.
const BOUNCE_SURFELS: usize = 20_000;

/// Rays a surfel for bounces: the errors of many surfels average out at a receiver.
const BOUNCE_RAYS: u32 = 256;

/// `baked` after `job.bounces` reflections, computed on a coarser cloud where that saves work.
fn bounced(
    world: &World<'_>,
    baked: &Baked,
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<SurfelCloud, Error> {
    let coarse_settings = BakeSettings {
        spacing: None,
        surfels: BOUNCE_SURFELS,
    };
    let coarse = (baked.cloud.len() > 2 * BOUNCE_SURFELS)
        .then(|| dice(world, &coarse_settings, (&mut *report, diagnostics)))
        .transpose()?;
    let settings = RaysSettings {
        rays: BOUNCE_RAYS.min(job.rays),
        max_distance: job.max_distance,
        ..RaysSettings::default()
    };
    let dice = coarse.as_ref().map_or(&baked.dice, |coarse| &coarse.dice);
    let factory = RaysFactory {
        tracer: &world.tracer,
        dice,
        settings,
    };
    let clouds = BounceClouds {
        fine: &baked.cloud,
        coarse: coarse.as_ref().map(|baked| CoarseCloud {
            baked,
            tracer: &world.tracer,
        }),
    };
    let cloud = timed(&mut report.seconds.gather, || {
        bounce::bounce(clouds, &factory, job.bounces, diagnostics)
    })?;
    Ok(cloud)
}

/// Record the settings of `job` as resolved.
pub(super) fn record(job: &GatherJob, aovs: &[Aov], report: &mut Report) {
    report.set("aov", aovs.iter().map(|aov| aov.name()).collect::<Vec<_>>());
    report.set("bounces", job.bounces);
    report.set("rays", job.rays);
    report.set("max_solid_angle", f64::from(job.max_solid_angle));
    report.set("raster_resolution", job.raster_resolution);
    report.set("max_distance", job.max_distance.map(f64::from));
    report.set("threads", rayon::current_num_threads());
}
