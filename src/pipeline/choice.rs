//! Engine, settings and light samples of a run: as asked for, or as a pilot finds them for a tolerance.

use super::Error;
use super::gather::Light;
use super::interpolated::InterpolatedMethod;
use super::job::{EngineChoice, GatherJob, Part};
use super::maps::{MapsKnobs, MapsMethod, Promise};
use super::report::{Report, timed};
use super::stand::Stand;
use super::world::World;
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::maps::{self, MapsSettings};
use crate::gather::{self, GatherScene, RaysSettings, Thinning};
use crate::interpolate::{self, Gathering, InterpolateSettings};
use crate::lighting::{LightSamples, Lighting};
use crate::pilot::{self, Candidate, Knobs, LightScenes, Maps, Method, Outcome, Pick, Pilot};
use crate::results::{Aov, Results};

/// What a run does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice {
    pub(super) engine: Chosen,
    /// Times the default light samples.
    light_scale: u32,
    /// Power of the number of rays that their error falls with.
    pub(super) law: f64,
    /// Rays see for some receivers, and these speak for the others; so many of their results are refused.
    pub(super) interpolates: Option<u32>,
}

/// The engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Chosen {
    /// So many a receiver.
    Rays(u32),
    /// Largest solid angle and raster resolution.
    Raster((f32, u32)),
    /// Largest solid angle and raster resolution.
    Paper((f32, u32)),
    /// Maps, and rays for what they do not see.
    Maps(MapsKnobs),
}

impl Choice {
    fn as_asked(stand: &Stand<'_>) -> Self {
        let job = stand.job;
        Self {
            engine: match job.engine {
                _ if stand.needs_rays() => Chosen::Rays(job.rays),
                EngineChoice::Auto | EngineChoice::Rays => Chosen::Rays(job.rays),
                EngineChoice::Raster => {
                    Chosen::Raster((job.max_solid_angle, job.raster_resolution))
                }
                EngineChoice::Paper => Chosen::Paper((job.max_solid_angle, job.raster_resolution)),
                EngineChoice::Maps => Chosen::Maps(MapsKnobs {
                    settings: MapsSettings {
                        max_distance: job.max_distance,
                        ..job.maps
                    },
                    handed_over: job.rays,
                    others: job.rays,
                    is_broken: false,
                    few_see: false,
                }),
            },
            light_scale: 1,
            law: pilot::LAW,
            interpolates: None,
        }
    }

    /// What the pilot found for `stand`.
    pub(super) fn of(outcome: &Outcome, stand: &Stand<'_>) -> Self {
        let rays = outcome.rays.unwrap_or(FEWEST_RAYS);
        let engine = match outcome.pick {
            Pick::Rays => Chosen::Rays(rays),
            Pick::Candidate(i) => rivals(stand)[i],
            Pick::Maps {
                settings,
                handed_over,
                others,
            } => Chosen::Maps(MapsKnobs {
                settings,
                handed_over,
                others: others.unwrap_or(FEWEST_RAYS),
                is_broken: false,
                few_see: outcome.share.is_none_or(|share| share < FEW),
            }),
        };
        Self {
            engine,
            light_scale: outcome.light_scale,
            law: outcome.law,
            interpolates: interpolates(stand).then_some(0),
        }
    }

    /// Let finer maps, or rays, see for those chosen at the frames to come too, if they had to at this one: what engines
    /// differ by would be seen as a change of the scene.
    pub(super) fn keep(self, method: &MapsMethod<'_>, aovs: &[Aov], report: &mut Report) {
        if let Chosen::Maps(knobs) = self.engine {
            let engine = Chosen::Maps(MapsKnobs {
                settings: method.settings(),
                is_broken: method.is_redone(),
                ..knobs
            });
            if engine != self.engine {
                report
                    .choices
                    .insert(aovs.to_vec(), Self { engine, ..self });
            }
        }
    }

    /// Let the frames to come be interpolated as this one was, or rays see for all of their receivers, if that did not do at this
    /// one.
    pub(super) fn keep_rays(
        self,
        method: &InterpolatedMethod<'_>,
        aovs: &[Aov],
        report: &mut Report,
    ) {
        let interpolates = (!method.is_redone()).then(|| method.refusals());
        if self.interpolates != interpolates {
            let choice = Self {
                interpolates,
                ..self
            };
            report.choices.insert(aovs.to_vec(), choice);
        }
    }

    /// Lights with as many samples as the tolerance needs; `None`: the world's own do.
    pub(super) fn lighting(self, world: &World<'_>, diagnostics: &Diagnostics) -> Option<Lighting> {
        (self.light_scale > 1).then(|| {
            Lighting::new(
                world.shader,
                samples(world.samples, self.light_scale),
                diagnostics,
            )
        })
    }
}

fn samples(usual: LightSamples, scale: u32) -> LightSamples {
    LightSamples {
        per_light: usual.per_light * scale,
        emissive: usual.emissive * scale,
        environment: usual.environment * scale,
    }
}

/// Settings of the paper's engine that a pilot tries, cheap ones first: solid angle and resolution.
pub(super) const PAPER_KNOBS: [(f32, u32); 3] = [(0.1, 8), (0.03, 12), (0.01, 24)];

/// Seconds a surfel to build an octree, roughly.
const OCTREE_SECONDS: f64 = 0.3e-6;

/// A choice and, where a pilot made it for the frame at hand, what else that found.
pub(super) struct Found {
    pub(super) choice: Choice,
    pub(super) outcome: Option<Outcome>,
}

impl Found {
    /// What maps have to keep, where they were not asked for by name.
    pub(super) fn promise(&self, job: &GatherJob) -> Option<Promise> {
        let check = self.outcome.as_ref()?.check.clone()?;
        let tolerance = job.tolerance?;
        (job.engine == EngineChoice::Auto).then_some(Promise { check, tolerance })
    }

    /// Rays that do again what the raster engine did, at this frame and those to come, where the pilot promised too much: it
    /// looks at few groups of receivers.
    pub(super) fn rays_instead(
        &self,
        aovs: &[Aov],
        job: &GatherJob,
        report: &mut Report,
    ) -> Option<u32> {
        let is_broken = report.error.estimate? > job.tolerance?;
        let rays = self.outcome.as_ref()?.rays.filter(|_| is_broken)?;
        let engine = Chosen::Rays(rays);
        let choice = Choice {
            engine,
            ..self.choice
        };
        report.choices.insert(aovs.to_vec(), choice);
        report.set("rays", rays);
        report.set("engines", serde_json::Value::Null);
        Some(rays)
    }

    /// Replace what the pilot foretold by what came of it at the pilot's receivers.
    pub(super) fn look_back(&self, results: &Results, report: &mut Report) {
        self.look_back_at(results, None, report);
    }

    /// The same where rays saw as `thinning` says.
    pub(super) fn look_back_at(
        &self,
        results: &Results,
        thinning: Option<&Thinning>,
        report: &mut Report,
    ) {
        let check = self.outcome.as_ref().and_then(|found| found.check.clone());
        if let Some(check) = check {
            report
                .error
                .replace(&check.thinned(thinning).errors(results));
        }
    }
}

/// The choice for the run at hand; a pilot measures where there is a tolerance, once for all frames: the same settings
/// at every frame give results that differ only where the scene does.
pub(super) fn choose(
    stand: &Stand<'_>,
    report: &mut Report,
    diagnostics: &Diagnostics,
) -> Result<Found, Error> {
    let job = stand.job;
    report.error.is_of_pilot = false;
    warn_of_screens(stand, diagnostics);
    let known = |choice| Found {
        choice,
        outcome: None,
    };
    let by_name =
        !stand.needs_rays() && matches!(job.engine, EngineChoice::Raster | EngineChoice::Paper);
    let Some(tolerance) = job.tolerance.filter(|_| !by_name) else {
        return Ok(known(Choice::as_asked(stand)));
    };
    if let Some(choice) = report.choices.get(stand.aovs) {
        return Ok(known(*choice));
    }
    let mut seconds = 0.0;
    let outcome = timed(&mut seconds, || look(stand, tolerance, diagnostics))?;
    report.seconds.gather += seconds;
    record(&outcome, report);
    let choice = Choice::of(&outcome, stand);
    match choice.engine {
        Chosen::Rays(rays) => report.set("rays", rays),
        Chosen::Raster((max_solid_angle, resolution))
        | Chosen::Paper((max_solid_angle, resolution)) => {
            report.set("max_solid_angle", f64::from(max_solid_angle));
            report.set("raster_resolution", resolution);
        }
        Chosen::Maps(knobs) => {
            report.set("rays", knobs.handed_over.max(knobs.others));
        }
    }
    report.set("light_samples_scale", choice.light_scale);
    report.choices.insert(stand.aovs.to_vec(), choice);
    Ok(Found {
        choice,
        outcome: Some(outcome),
    })
}

/// Say so where an engine was asked for by name that takes surfaces for opaque which are not.
fn warn_of_screens(stand: &Stand<'_>, diagnostics: &Diagnostics) {
    let engine = match stand.job.engine {
        EngineChoice::Auto | EngineChoice::Rays => return,
        EngineChoice::Raster => "raster",
        EngineChoice::Paper => "paper",
        EngineChoice::Maps => "maps",
    };
    if stand.world().tracer.has_screens() {
        let message = format!(
            "some surfaces let light through, which --gather {engine} does not know: rays see for it"
        );
        diagnostics.warn("opacity", "", message);
    }
}

/// What interpolation has to keep where `outcome` led to it: the tolerance, or what rays alone err by.
pub(super) fn promise_of_rays(outcome: &Outcome, tolerance: f64) -> Option<Promise> {
    Some(Promise {
        check: outcome.check.clone()?,
        tolerance: tolerance.max(outcome.worst().unwrap_or(0.0)),
    })
}

/// Share of the receivers that rays see for, if anybody knows, where those speak for the others in place of maps that broke their
/// promise.
const FEW: f64 = 0.5;

/// Rays of a run whose AOVs do not depend on them.
const FEWEST_RAYS: u32 = 16;

/// Settings of the raster engine that a pilot tries: solid angle and resolution.
const TRIED_RASTER_KNOBS: [(f32, u32); 3] = [(0.4, 12), (0.05, 12), (0.05, 16)];

/// Receivers of a run that a pilot looks at the raster engine for, at least: it looks at 48 groups of neighbors. Where
/// receivers speak for each other rays are cheaper, in most scenes of the README.
const RASTER_RECEIVERS: usize = 1 << 17;

/// Everything but rays that can do the job, settings of one engine next to each other, cheap ones first.
fn rivals(stand: &Stand<'_>) -> Vec<Chosen> {
    // Without surfels there is nothing to rasterize, and dicing for it would cost more than rays do.
    // Nor do these engines know their error at a receiver.
    let asks_error = stand.aovs.iter().any(|aov| aov.error_of().is_some());
    let is_whole = stand.job.engine == EngineChoice::Auto && !stand.needs_rays();
    if !is_whole || stand.surfel_count() == 0 || asks_error {
        return Vec::new();
    }
    let lighting = stand.scene().lighting;
    let asks_open = (stand.aovs.iter()).any(|&aov| gather::asks_open(aov, lighting));
    let is_baked = matches!(stand.light(), Light::Baked(_));
    let is_dense = stand.receivers.len() >= RASTER_RECEIVERS && !interpolates(stand);
    let raster = (TRIED_RASTER_KNOBS.iter()).filter(|_| is_baked && is_dense && !asks_open);
    (raster.map(|&knobs| Chosen::Raster(knobs)))
        .chain(PAPER_KNOBS.iter().map(|&knobs| Chosen::Paper(knobs)))
        .collect()
}

/// [`rivals`] for the pilot.
pub(super) fn candidates<'s>(stand: &'s Stand<'_>) -> Vec<Candidate<'s>> {
    let candidate = |rival| {
        let (engine, knobs, make): (_, _, Box<dyn Fn() -> Box<dyn Method + 's> + 's>) = match rival
        {
            Chosen::Raster(knobs) => {
                let method = move || stand.raster(knobs, FEWEST_RAYS);
                ("raster", knobs, Box::new(move || Box::new(method())))
            }
            Chosen::Paper(knobs) => {
                let method = move || stand.paper(knobs);
                ("paper", knobs, Box::new(move || Box::new(method())))
            }
            Chosen::Rays(_) | Chosen::Maps(_) => return None,
        };
        Some(Candidate {
            engine,
            knobs: paper_knobs(knobs),
            preparation: OCTREE_SECONDS * stand.surfel_count() as f64,
            sees_groups: engine == "raster",
            make,
        })
    };
    rivals(stand).into_iter().filter_map(candidate).collect()
}

/// As candidates and reports name them.
pub(super) fn paper_knobs((max_solid_angle, resolution): (f32, u32)) -> Knobs {
    vec![
        ("max_solid_angle", round(max_solid_angle)),
        ("raster_resolution", f64::from(resolution)),
    ]
}

/// The shortest decimal number that is `x` in single precision.
fn round(x: f32) -> f64 {
    x.to_string().parse().unwrap_or_else(|_| f64::from(x))
}

/// Share of the tolerance that is left to rays where receivers speak for others: squared errors add up.
const SHARE_OF_RAYS: f64 = 0.95;

/// What is open may err by this much more before neighbors even it out: of what rays err by in it at pixels of a Cornell box,
/// teapots and a room, 512², 0.54 to 0.95 was left, at 5 and 2 %.
const EVENED: f64 = 1.05;

/// Rays of each receiver, at most, that tell how many see for others.
const FORESEEING_RAYS: u32 = 512;

/// True if receivers that rays have seen may speak for others.
fn interpolates(stand: &Stand<'_>) -> bool {
    let pays = interpolate::pays(stand.receivers, stand.aovs);
    stand.job.interpolate && !matches!(stand.part, Part::Cone(_)) && pays
}

/// Share of `stand`'s receivers that so many rays, which hold the tolerance, will see for, where receivers may speak for each
/// other.
fn foreseen(
    stand: &Stand<'_>,
    (rays, tolerance): (u32, f64),
    diagnostics: &Diagnostics,
) -> Result<Option<f64>, Cancelled> {
    if !interpolates(stand) {
        return Ok(None);
    }
    let fewer = rays.min(FORESEEING_RAYS);
    let gathering = Gathering {
        scene: stand.scene(),
        engine: &stand.rays_with(stand.rays_settings(fewer)),
        again: None,
        fewer: None,
        thin: None,
        receivers: stand.receivers,
        kinds: None,
        aovs: stand.aovs,
    };
    let settings = InterpolateSettings {
        // Noise asks for seeds too: as much of it beside the tolerance as in the run.
        tolerance: tolerance * pilot::errors_with_rays(fewer, rays),
        refusals: 0,
    };
    interpolate::foresee(gathering, settings, diagnostics)
}

/// Let a pilot look at `stand`'s receivers.
pub(super) fn look(
    stand: &Stand<'_>,
    tolerance: f64,
    diagnostics: &Diagnostics,
) -> Result<Outcome, Error> {
    let (tolerance, evened) = if interpolates(stand) {
        (SHARE_OF_RAYS * tolerance, EVENED)
    } else {
        (tolerance, 1.0)
    };
    let candidates = candidates(stand);
    let world = stand.world();
    let uniform = world.lighting.uniform_environment().is_some();
    let samples_light = |aov: &Aov| aov.needs_direct() || (aov.needs_environment() && !uniform);
    let finer = stand
        .aovs
        .iter()
        .any(samples_light)
        .then(|| Lighting::new(world.shader, samples(world.samples, 4), diagnostics));
    let rays = |count: u32, turn: f32| {
        let settings = RaysSettings {
            turn,
            ..stand.rays_settings(count)
        };
        Box::new(stand.rays_with(settings)) as Box<dyn Method>
    };
    let share = |count: u32| foreseen(stand, (count, tolerance), diagnostics);
    let is_sky = !stand.needs_rays() && stand.aovs.iter().any(|&aov| maps::supports(aov));
    let pilot = Pilot {
        scenes: LightScenes {
            run: stand.scene(),
            finer: finer.as_ref().map(|finer| GatherScene {
                lighting: Some(finer),
                ..stand.scene()
            }),
        },
        receivers: stand.receivers,
        aovs: stand.aovs,
        tolerance,
        evened,
        rays: &rays,
        share: &share,
        thinning: stand.thinning().filter(|_| interpolates(stand)),
        candidates: &candidates,
        maps: match stand.job.engine {
            EngineChoice::Auto if is_sky => {
                Maps::IfCheaper(stand.maps_plan(), stand.job.max_distance)
            }
            EngineChoice::Maps if is_sky => Maps::Always(stand.maps_plan(), stand.job.max_distance),
            _ => Maps::Never,
        },
        surfel_errors: &stand.surfel_errors,
    };
    Ok(pilot::choose(&pilot, diagnostics)?)
}

fn record(outcome: &Outcome, report: &mut Report) {
    let method = format!(
        "pilot: {} receivers against rays to convergence, light against four times its samples",
        outcome.receivers
    );
    report.error.add(&outcome.errors, method);
    report.error.is_of_pilot = true;
    report.set(
        "pilot",
        serde_json::json!({
            "receivers": outcome.receivers,
            "seconds": outcome.seconds,
            "trials": outcome.trials,
        }),
    );
}

/// Warn when the estimate is above the tolerance.
pub(super) fn judge(report: &Report, diagnostics: &Diagnostics) {
    let (Some(tolerance), Some(estimate)) = (report.error.tolerance, report.error.estimate) else {
        return;
    };
    if estimate > tolerance {
        let message = format!(
            "the error is about {:.2} %, more than --tolerance {tolerance} ({:.2} %) allows, with the most exact \
             settings there are",
            100.0 * estimate,
            100.0 * tolerance
        );
        diagnostics.warn("tolerance-missed", "", message);
    }
}
