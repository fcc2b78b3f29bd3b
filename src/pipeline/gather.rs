//! Surfels, octree, gather and error estimate of one frame.

use super::Error;
use super::bounces::bounced;
use super::choice::{self, Chosen, Found};
use super::gloss;
use super::interpolated::InterpolatedMethod;
use super::job::{EngineChoice, GatherJob, Part};
use super::maps::{self, MapsKnobs};
use super::raster;
use super::report::{Report, timed};
use super::spacing::{self, Asked};
use super::stand::Stand;
use super::world::World;
use crate::bake::{self, BakeSettings, Baked};
use crate::bounce::Bounces;
use crate::diagnostics::Diagnostics;
use crate::gather::{
    self, DicedSurfels, GatherScene, HitLight, LoadedCloud, RadianceSource, RaysEngine,
    RaysSettings, Reference,
};
use crate::lighting::{LightSamples, Lighting};
use crate::pilot::{self, Method};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use crate::stage::cloud;
use crate::surfels::SurfelCloud;

/// The surfels that shine.
pub(super) enum Light {
    /// Nobody asks for reflected light.
    None,
    /// Diced from the scene.
    Baked(Box<Baked>),
    /// Read from files.
    Loaded(Vec<SurfelCloud>),
}

impl Light {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::None => 0,
            Self::Baked(baked) => baked.cloud.len(),
            Self::Loaded(clouds) => clouds.iter().map(SurfelCloud::len).sum(),
        }
    }

    /// Light after `bounces` reflections but the last; after one, hits nearer than `near_radii` of their surfel are lit
    /// anew.
    pub(super) fn source<'a>(
        &'a self,
        world: &'a World<'_>,
        (bounces, near_radii): (Bounces, f32),
    ) -> Option<RadianceSource<'a>> {
        match self {
            Self::None => None,
            Self::Baked(baked) => Some(read_surfels(baked, world, (bounces, near_radii))),
            Self::Loaded(clouds) => Some(RadianceSource::Loaded(
                clouds
                    .iter()
                    .map(|cloud| LoadedCloud::new(cloud, world.scene().origin))
                    .collect(),
            )),
        }
    }

    /// See [`relight`].
    pub(super) fn at_hits<'a>(
        &'a self,
        world: &'a World<'_>,
        lighting: &'a Lighting,
    ) -> Option<RadianceSource<'a>> {
        let Self::Baked(baked) = self else {
            return None;
        };
        relight(baked, world, lighting).map(RadianceSource::AtHits)
    }
}

/// See [`Light::source`].
pub(super) fn read_surfels<'a>(
    baked: &'a Baked,
    world: &'a World<'_>,
    (bounces, near_radii): (Bounces, f32),
) -> RadianceSource<'a> {
    let near = (bounces.is_at_most_once())
        .then(|| relight(baked, world, &world.lighting))
        .flatten();
    let near = near.map(|hits| hits.within(near_radii));
    RadianceSource::Baked(DicedSurfels::new(&baked.cloud, &baked.dice, near))
}

/// What [`read_surfels`] errs by after one reflection; `None` as [`relight`].
pub(super) fn errors_of_surfels<'a>(
    baked: &'a Baked,
    world: &'a World<'_>,
    near_radii: f32,
) -> Option<RadianceSource<'a>> {
    let anew = relight(baked, world, &world.lighting)?.within(near_radii);
    Some(RadianceSource::ErrorOf {
        cloud: &baked.cloud,
        dice: &baked.dice,
        anew,
    })
}

/// Light of `lighting` found anew at hits, on the sides that have surfels: once reflected. `None` where a few rays can't
/// light a place.
pub(super) fn relight<'a>(
    baked: &'a Baked,
    world: &'a World<'_>,
    lighting: &'a Lighting,
) -> Option<HitLight<'a>> {
    HitLight::new(world.shader, &world.tracer, lighting, &baked.dice)
}

/// Compute `aovs` at `receivers`: kinds of occlusion, and gloss, each by rays of their own, all others by one gather. Where
/// receivers are looked at from somewhere, `color` holds what they reflect glossily too.
pub(super) fn gather(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let shines = aovs.contains(&Aov::Color) && !receivers.toward_eye.is_empty();
    let mut groups: Vec<(Part, Vec<Aov>)> = Vec::new();
    for &aov in aovs {
        let part = job.occlusion.part_of(aov);
        match groups.iter_mut().find(|(known, _)| *known == part) {
            Some((_, group)) => group.push(aov),
            None => groups.push((part, vec![aov])),
        }
    }
    // What the report tells last is what most asks for.
    groups.sort_by_key(|(part, _)| *part == Part::Whole);
    let mut all = Results::default();
    for (part, group) in &groups {
        let run = (&mut *report, diagnostics);
        let has_gloss = aovs.contains(&gloss::AOV);
        let found = if shines && !has_gloss && group.contains(&Aov::Color) {
            gloss::gather_beside(world, receivers, (group, *part), job, run)?
        } else {
            let asked = Asked {
                receivers,
                aovs: group,
                beside: &[],
            };
            let lit = spacing::lit(world, asked, job, (&mut *report, diagnostics))?;
            let stand = Stand::new(world, &lit, receivers, group, job).about(*part);
            let found = gather_on(&stand, (&mut *report, diagnostics))?;
            choice::judge(report, diagnostics);
            found
        };
        all.buffers.extend(found.buffers);
    }
    if shines {
        gloss::add(&mut all);
        all.buffers.retain(|buffer| aovs.contains(&buffer.aov));
    }
    Ok(all.in_order_of(aovs))
}

/// Compute what `stand` asks for, which all is about one part of the hemisphere.
pub(super) fn gather_on(
    stand: &Stand<'_>,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let (world, receivers) = (stand.world(), stand.receivers);
    report.counts.receivers = report.counts.receivers.max(receivers.len());
    let gathered_before = std::mem::replace(&mut report.counts.gathered, receivers.len());
    report.counts.surfels = report.counts.surfels.max(stand.light().len());
    let found = choice::choose(stand, report, diagnostics)?;
    let lighting = found.choice.lighting(world, diagnostics);
    let scene = GatherScene {
        lighting: Some(lighting.as_ref().unwrap_or(&world.lighting)),
        ..stand.scene()
    };
    let run = (&mut *report, diagnostics);
    let results = match found.choice.engine {
        Chosen::Rays(rays) if found.choice.interpolates.is_some() => {
            see_interpolated(stand, scene, (rays, &found), run)?
        }
        Chosen::Rays(rays) => see_rays(stand, scene, rays, run)?,
        Chosen::Raster(knobs) => {
            let results = see_raster(stand, scene, knobs, (&mut *report, diagnostics))?;
            found.look_back(&results, report);
            match found.rays_instead(stand.aovs, stand.job, report) {
                Some(rays) => {
                    let results = see_rays(stand, scene, rays, (&mut *report, diagnostics))?;
                    found.look_back(&results, report);
                    results
                }
                None => results,
            }
        }
        Chosen::Paper(knobs) => see_paper(stand, scene, knobs, run)?,
        Chosen::Maps(knobs) => see_maps(stand, scene, (&knobs, &found), run)?,
    };
    report.counts.nodes = report.counts.nodes.max(stand.node_count());
    report.counts.gathered = report.counts.gathered.max(gathered_before);
    Ok(results)
}

/// Cost of a reference receiver by rays over one by the paper's engine: measured between 2 and 4 on Cornell boxes.
const PAPER_REFERENCE_COST: u32 = 4;

/// Gather with so many rays.
fn see_rays(
    stand: &Stand<'_>,
    scene: GatherScene<'_>,
    rays: u32,
    run: (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let settings = stand.rays_settings(rays);
    let engine = stand.rays_with(settings);
    let reference = stand.rays_with(settings.reference());
    see(stand, scene, ("rays", &engine, rays_judge(&reference)), run)
}

/// Gather with so many rays at some receivers, which speak for the others.
fn see_interpolated(
    stand: &Stand<'_>,
    scene: GatherScene<'_>,
    (rays, found): (u32, &Found),
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let reference = stand.rays_with(stand.rays_settings(rays).reference());
    let tolerance = stand.job.tolerance.unwrap_or(0.0);
    let outcome = found.outcome.as_ref();
    let promise = outcome.and_then(|outcome| choice::promise_of_rays(outcome, tolerance));
    let refusals = found.choice.interpolates.unwrap_or(0);
    let method = InterpolatedMethod::new(
        stand,
        (rays, found.choice.law),
        (tolerance, refusals),
        promise,
    );
    let run = (&mut *report, diagnostics);
    let judge = Reference {
        thinning: method.thinning(),
        ..rays_judge(&reference)
    };
    let results = see(stand, scene, ("rays", &method, judge), run)?;
    method.record(report);
    found.look_back_at(&results, method.thinning(), report);
    found.choice.keep_rays(&method, stand.aovs, report);
    Ok(results)
}

/// Gather with the paper's engine.
fn see_paper(
    stand: &Stand<'_>,
    scene: GatherScene<'_>,
    knobs: (f32, u32),
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    timed(&mut report.seconds.octree, || stand.octree());
    let reference = Reference {
        engine: &stand.rays_with(stand.rays_settings(stand.job.rays)),
        cost: PAPER_REFERENCE_COST,
        error_share: 0.0,
        thinning: None,
    };
    let run = (report, diagnostics);
    see(stand, scene, ("paper", &stand.paper(knobs), reference), run)
}

/// Gather with maps, and rays where these can't tell.
fn see_maps(
    stand: &Stand<'_>,
    scene: GatherScene<'_>,
    (knobs, found): (&MapsKnobs, &Found),
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let method = stand.maps(knobs, found.promise(stand.job));
    let reference = Reference {
        engine: &stand.rays_with(stand.rays_settings(maps::REFERENCE_RAYS)),
        cost: maps::REFERENCE_COST,
        error_share: 0.0,
        thinning: None,
    };
    let run = (&mut *report, diagnostics);
    let results = see(stand, scene, ("maps", &method, reference), run)?;
    method.record(stand, report);
    found.look_back(&results, report);
    found.choice.keep(&method, stand.aovs, report);
    Ok(results)
}

/// Judges rays by rays of [`RaysSettings::reference`].
fn rays_judge<'e>(engine: &'e RaysEngine<'_>) -> Reference<'e> {
    Reference {
        engine,
        cost: RaysSettings::REFERENCE_RATIO,
        error_share: RaysSettings::REFERENCE_ERROR_SHARE,
        thinning: None,
    }
}

/// Gather with the raster engine.
fn see_raster(
    stand: &Stand<'_>,
    scene: GatherScene<'_>,
    knobs: (f32, u32),
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    timed(&mut report.seconds.octree, || stand.octree());
    let method = stand.raster(knobs, stand.job.rays);
    method.record(stand, report);
    let reference = Reference {
        engine: &stand.rays_with(stand.rays_settings(raster::REFERENCE_RAYS)),
        cost: raster::REFERENCE_COST,
        error_share: 0.0,
        thinning: None,
    };
    see(
        stand,
        scene,
        ("raster", &method, reference),
        (report, diagnostics),
    )
}

/// Gather with `method` and, where no pilot has, estimate its error against `reference`.
fn see(
    stand: &Stand<'_>,
    scene: GatherScene<'_>,
    (name, method, reference): (&str, &dyn Method, Reference<'_>),
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Results, Error> {
    let (receivers, aovs) = (stand.receivers, stand.aovs);
    report.set("gather", name);
    let results = timed(&mut report.seconds.gather, || {
        method.gather(scene, receivers, aovs, diagnostics)
    })?;
    if report.error.is_of_pilot {
        return Ok(results);
    }
    let estimates = timed(&mut report.seconds.gather, || {
        gather::estimate(scene, reference, receivers, &results, diagnostics)
    })?;
    let method = format!(
        "{name} on receivers of the run against {} as reference",
        reference.engine.name()
    );
    report.error.add(&estimates, method);
    Ok(results)
}

/// The surfels `aovs` need: baked (and bounced), read from files, or none.
pub(super) fn light(
    world: &World<'_>,
    receivers: &Receivers,
    aovs: &[Aov],
    job: &GatherJob,
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Light, Error> {
    if !needs_surfels(world, aovs, job) && job.engine != EngineChoice::Paper {
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
        // Particles shine on the stage's own surfels.
        if clouds.iter().any(|cloud| !cloud.is_empty()) {
            return Ok(Light::Loaded(clouds));
        }
    }
    let settings = job.bake_settings(receivers.len());
    let baked = dice(
        world,
        (&settings, job.tolerance),
        (&mut *report, diagnostics),
    )?;
    report.set("spacing", f64::from(baked.cloud.spacing));
    bounced(world, baked, job, (report, diagnostics))
}

/// True if some of `aovs` holds light that surfaces reflect.
pub(super) fn needs_surfels(world: &World<'_>, aovs: &[Aov], job: &GatherJob) -> bool {
    let shines = !world.lighting.is_dark() || !job.clouds.is_empty();
    shines && job.bounces != Bounces::Count(0) && aovs.iter().any(|aov| aov.needs_indirect())
}

/// Tolerance of reflected light that [`LightSamples::SURFEL`] are enough for under a dome. In a Cornell box under one 128 directions
/// left 0.9 % in it of 137 000 surfels and of 550 000: neighbors are lit from the same ones, and err alike.
const USUAL_SAMPLES_ARE_FOR: f64 = 0.02;

/// Most directions that light surfels.
const MOST_DIRECTIONS: f64 = 1024.0;

/// Samples that light surfels where what these reflect may err by `tolerance`, by the law of errors.
pub(super) fn surfel_samples(tolerance: Option<f64>) -> LightSamples {
    let usual = LightSamples::SURFEL;
    let times = tolerance.map_or(1.0, |tolerance| {
        (USUAL_SAMPLES_ARE_FOR / tolerance).max(1.0)
    });
    let directions = f64::from(usual.environment) * times.powf(1.0 / pilot::LAW);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "128 to 1024"
    )]
    LightSamples {
        environment: directions.min(MOST_DIRECTIONS) as u32,
        ..usual
    }
}

/// Dice and light the world, with fewer light samples than receivers get, since errors of many surfels average out: as many as the
/// tolerance of what these reflect asks for, if there is one.
pub(super) fn dice(
    world: &World<'_>,
    (settings, tolerance): (&BakeSettings, Option<f64>),
    (report, diagnostics): (&mut Report, &Diagnostics),
) -> Result<Baked, Error> {
    let baked = timed(&mut report.seconds.points, || {
        let samples = surfel_samples(tolerance);
        let lighting = Lighting::of_surfels(world.shader, samples, diagnostics);
        bake::bake(
            world.shader,
            &world.tracer,
            &lighting,
            settings,
            diagnostics,
        )
    })?;
    Ok(baked)
}

/// Record the settings of `job` as resolved.
pub(super) fn record(job: &GatherJob, aovs: &[Aov], report: &mut Report) {
    report.set("aov", aovs.iter().map(|aov| aov.name()).collect::<Vec<_>>());
    if let Bounces::Count(count) = job.bounces {
        report.set("bounces", count);
    }
    report.error.tolerance = job.tolerance;
    if job.tolerance.is_none() {
        report.set("rays", job.rays);
    }
    report.set("max_solid_angle", f64::from(job.max_solid_angle));
    report.set("raster_resolution", job.raster_resolution);
    report.set("max_distance", job.max_distance.map(f64::from));
    if let Some(cone) = aovs.iter().find_map(|&aov| job.occlusion.cone_of(aov)) {
        report.set("cone_angle", f64::from(cone.half_angle.to_degrees()));
        report.set("falloff", cone.falloff.name());
    }
    report.set("threads", rayon::current_num_threads());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finer_tolerances_light_surfels_from_more_directions() {
        let of = |tolerance| surfel_samples(Some(tolerance)).environment;
        let usual = LightSamples::SURFEL;
        assert_eq!(surfel_samples(None), usual);
        assert_eq!((of(0.05), of(0.02)), (usual.environment, usual.environment));
        // Half of the error: 2^(4/3) as many.
        assert_eq!((of(0.01), of(1e-6)), (322, 1024));
        let fine = surfel_samples(Some(0.001));
        assert_eq!(
            (fine.per_light, fine.emissive),
            (usual.per_light, usual.emissive)
        );
    }
}
