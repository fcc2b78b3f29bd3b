//! More than one reflection: light of a baked cloud after all of them but the last.

use super::Error;
use super::gather::{Light, dice};
use super::job::GatherJob;
use super::report::{Report, timed};
use super::world::World;
use crate::bake::{BakeSettings, Baked};
use crate::bounce::{BounceClouds, CoarseCloud, bounce};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::{CloudGather, CloudRays, GatherScene, Pass, RaysSettings};
use crate::interpolate::{self, Gathering, InterpolateSettings};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use crate::surfels::SurfelCloud;
use glam::Vec3;
use std::sync::atomic::{AtomicBool, Ordering};

/// Surfels of the cloud that bounces are computed on: light after two reflections is smooth. PBGI §8.3.
const BOUNCE_SURFELS: usize = 20_000;

/// Rays a surfel for bounces: the errors of many surfels average out at a receiver.
const BOUNCE_RAYS: u32 = 256;

/// What surfels that speak for each other may err by beside that, where the run has a tolerance.
const BOUNCE_TOLERANCE: f64 = 0.05;

/// Share of the surfels that are gathered at beyond which they no longer speak for each other: seeing whether what they say is
/// true costs more.
const MOST_SEEN: f64 = 0.6;

/// `baked` after all reflections but the last.
pub(super) fn bounced(
    world: &World<'_>,
    baked: Baked,
    job: &GatherJob,
    run: (&mut Report, &Diagnostics),
) -> Result<Light, Error> {
    if job.bounces.is_at_most_once() {
        return Ok(Light::Baked(Box::new(baked)));
    }
    let cloud = after_bounces(world, &baked, job, run)?;
    Ok(Light::Baked(Box::new(Baked { cloud, ..baked })))
}

/// `baked` after `job.bounces` reflections, computed on a coarser cloud where that saves work.
fn after_bounces(
    world: &World<'_>,
    baked: &Baked,
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<SurfelCloud, Error> {
    let coarse_settings = BakeSettings {
        spacing: None,
        surfels: BOUNCE_SURFELS,
        every_light: false,
    };
    let coarse = (baked.cloud.len() > 2 * BOUNCE_SURFELS)
        .then(|| {
            dice(
                world,
                (&coarse_settings, job.tolerance),
                (&mut *report, diagnostics),
            )
        })
        .transpose()?;
    let light = BounceLight {
        world,
        rays: CloudRays {
            tracer: &world.tracer,
            dice: coarse.as_ref().map_or(&baked.dice, |coarse| &coarse.dice),
            settings: RaysSettings {
                rays: BOUNCE_RAYS.min(job.rays),
                max_distance: job.max_distance,
                ..RaysSettings::default()
            },
        },
        speak: AtomicBool::new(job.tolerance.is_some() && job.interpolate),
    };
    let clouds = BounceClouds {
        fine: &baked.cloud,
        coarse: coarse.as_ref().map(|baked| CoarseCloud {
            baked,
            tracer: &world.tracer,
        }),
    };
    let (cloud, count) = timed(&mut report.seconds.gather, || {
        bounce(clouds, &light, job.bounces, diagnostics)
    })?;
    report.set("bounces", count);
    Ok(cloud)
}

/// Rays, at surfels that may speak for their neighbors.
#[derive(Debug)]
struct BounceLight<'a> {
    world: &'a World<'a>,
    rays: CloudRays<'a>,
    /// As long as that saves something.
    speak: AtomicBool,
}

impl CloudGather for BounceLight<'_> {
    fn irradiance(
        &self,
        cloud: &SurfelCloud,
        receivers: &Receivers,
        pass: Pass,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Vec3>, Cancelled> {
        if !self.speak.load(Ordering::Relaxed) {
            return self.rays.irradiance(cloud, receivers, pass, diagnostics);
        }
        let gathering = Gathering {
            scene: GatherScene {
                shader: self.world.shader,
                tracer: self.rays.tracer,
                lighting: None,
            },
            engine: &self.rays.engine(cloud, pass),
            again: None,
            fewer: None,
            thin: None,
            receivers,
            kinds: None,
            aovs: &[Aov::IrradianceIndirect],
        };
        let settings = InterpolateSettings {
            tolerance: BOUNCE_TOLERANCE,
            refusals: 0,
        };
        let found = interpolate::gather(gathering, settings, &|_: &Results| true, diagnostics)?;
        if found.gathered as f64 > MOST_SEEN * receivers.len() as f64 {
            self.speak.store(false, Ordering::Relaxed);
        }
        let light = found.results.get(Aov::IrradianceIndirect);
        let light = light.map_or(&[][..], |buffer| &buffer.data);
        Ok(bytemuck::cast_slice(light).to_vec())
    }
}
