//! What is measured: every engine at some settings, and what `--tolerance` picks.

use super::super::Error;
use super::super::choice::{self, Choice, Chosen, PAPER_KNOBS, paper_knobs};
use super::super::interpolated::InterpolatedMethod;
use super::super::maps::{self, MapsKnobs, Promise};
use super::super::raster::{RASTER_KNOBS, RasterMethod};
use super::super::stand::Stand;
use super::super::world::World;
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::maps::{MapsSettings, supports};
use crate::gather::{GatherScene, RaysEngine};
use crate::lighting::{LightSamples, Lighting};
use crate::pilot::{Knobs, Method};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use crate::verify::{Auto, Sees, Subject};

/// Rays a receiver that are swept.
const RAYS: [u32; 5] = [16, 64, 256, 1024, 4096];

/// Knobs of the paper's engine that are swept besides those that `auto` knows.
const MORE_PAPER_KNOBS: [(f32, u32); 1] = [(0.3, 6)];

/// Maps that are swept: directions, pixel and cell in edges, bias in pixels.
const MAPS: [(u32, f32, f32, f32); 6] = [
    (64, 3.0, 3.0, 1.0),
    (256, 3.0, 3.0, 1.0),
    (64, 1.0, 0.0, 0.5),
    (256, 1.0, 0.0, 0.5),
    (1024, 1.0, 0.0, 0.5),
    (256, 0.5, 0.0, 0.5),
];

/// What the sweep of engines stands on.
pub(super) struct Swept<'a> {
    pub(super) world: &'a World<'a>,
    /// For the octree, which all share.
    pub(super) surfels: &'a Stand<'a>,
    pub(super) max_distance: Option<f32>,
}

impl<'a> Swept<'a> {
    /// Every engine that tells `aov`, at each of its settings.
    pub(super) fn subjects<'s>(
        &self,
        aov: Aov,
        stand: &'s Stand<'_>,
        diagnostics: &Diagnostics,
    ) -> Vec<Subject<'s>>
    where
        'a: 's,
    {
        let samples_sky = self.samples_sky(aov);
        let mut subjects: Vec<Subject<'s>> = if samples_sky {
            self.sky_rays(stand, diagnostics).collect()
        } else {
            rays(stand).collect()
        };
        if supports(aov) {
            subjects.extend(self.maps(stand));
        }
        if aov == Aov::IrradianceIndirect {
            subjects.extend(self.raster());
        }
        if !samples_sky {
            subjects.extend(self.paper());
        }
        subjects
    }

    /// True if rays to places in the sky tell `aov`, whatever the engine.
    fn samples_sky(&self, aov: Aov) -> bool {
        let is_even = self.world.lighting.uniform_environment().is_some();
        aov == Aov::IrradianceEnvironment && !is_even
    }

    /// As many rays to the sky, by places that light and not by the engine.
    fn sky_rays<'s>(
        &self,
        stand: &'s Stand<'_>,
        diagnostics: &Diagnostics,
    ) -> impl Iterator<Item = Subject<'s>> {
        RAYS.iter().map(move |&environment| {
            let samples = LightSamples {
                environment,
                ..LightSamples::default()
            };
            let relit = Relit {
                lighting: Lighting::new(self.world.shader, samples, diagnostics),
                method: Box::new(stand.rays_with(stand.rays_settings(1))),
            };
            each(
                "rays",
                vec![("environment", f64::from(environment))],
                Box::new(relit),
            )
        })
    }

    fn maps<'s>(&self, stand: &'s Stand<'_>) -> impl Iterator<Item = Subject<'s>> {
        MAPS.iter().map(|&(directions, pixel, cell, bias)| {
            let settings = MapsSettings {
                directions,
                pixel,
                cell,
                bias,
                max_distance: self.max_distance,
                ..MapsSettings::default()
            };
            let knobs = MapsKnobs {
                settings,
                handed_over: directions,
                others: directions,
                is_broken: false,
                few_see: false,
            };
            Subject {
                engine: "maps",
                knobs: maps::names(&knobs),
                method: Box::new(stand.maps(&knobs, None)),
                auto: None,
                sees: Sees::All(None),
            }
        })
    }

    /// Neighbors share most of its work.
    fn raster<'s>(&self) -> impl Iterator<Item = Subject<'s>>
    where
        'a: 's,
    {
        let surfels = self.surfels;
        let knobs = RASTER_KNOBS.iter().filter(|_| surfels.surfel_count() > 0);
        knobs.map(move |&knobs| Subject {
            sees: Sees::Groups,
            ..each(
                "raster",
                paper_knobs(knobs),
                Box::new(surfels.raster(knobs, 1)),
            )
        })
    }

    fn paper<'s>(&self) -> impl Iterator<Item = Subject<'s>>
    where
        'a: 's,
    {
        let surfels = self.surfels;
        let knobs = MORE_PAPER_KNOBS.iter().chain(&PAPER_KNOBS);
        knobs.map(move |&knobs| each("paper", paper_knobs(knobs), Box::new(surfels.paper(knobs))))
    }
}

fn rays<'s>(stand: &'s Stand<'_>) -> impl Iterator<Item = Subject<'s>> {
    RAYS.iter().map(|&rays| {
        let engine = stand.rays_with(stand.rays_settings(rays));
        each("rays", vec![("rays", f64::from(rays))], Box::new(engine))
    })
}

/// A method that looks at receivers one by one.
fn each<'s>(engine: &'static str, knobs: Knobs, method: Box<dyn Method + 's>) -> Subject<'s> {
    Subject {
        engine,
        knobs,
        method,
        auto: None,
        sees: Sees::Each,
    }
}

/// A method under lights of other samples than the scene's.
#[derive(Debug)]
struct Relit<'a> {
    lighting: Lighting,
    method: Box<dyn Method + 'a>,
}

impl Method for Relit<'_> {
    fn gather(
        &self,
        scene: GatherScene<'_>,
        receivers: &Receivers,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        let scene = GatherScene {
            lighting: Some(&self.lighting),
            ..scene
        };
        self.method.gather(scene, receivers, aovs, diagnostics)
    }
}

/// The raster engine, and rays that do it again where it breaks what the pilot foretold, as in a run.
#[derive(Debug)]
struct Promised<'a> {
    raster: RasterMethod<'a>,
    rays: RaysEngine<'a>,
    promise: Option<Promise>,
}

impl Method for Promised<'_> {
    fn gather(
        &self,
        scene: GatherScene<'_>,
        receivers: &Receivers,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        let found = self.raster.gather(scene, receivers, aovs, diagnostics)?;
        match &self.promise {
            Some(promise) if !promise.is_kept_by(&found) => {
                self.rays.gather(scene, receivers, aovs, diagnostics)
            }
            _ => Ok(found),
        }
    }
}

/// What `--tolerance` picks for all of `stand`'s receivers.
pub(super) fn auto<'s>(
    stand: &'s Stand<'_>,
    tolerance: f64,
    surfel_seconds: f64,
    diagnostics: &Diagnostics,
) -> Result<Subject<'s>, Error> {
    let outcome = choice::look(stand, tolerance, diagnostics)?;
    let auto = Auto {
        tolerance,
        estimate: outcome.worst(),
        pilot_microseconds: 1e6 * (outcome.seconds + surfel_seconds)
            / stand.receivers.len().max(1) as f64,
    };
    let choice = Choice::of(&outcome, stand);
    let promise = (outcome.check.clone()).map(|check| Promise { check, tolerance });
    let (engine, knobs, method): (_, _, Box<dyn Method + 's>) = match choice.engine {
        Chosen::Raster(knobs) => {
            let rays = outcome.rays.unwrap_or(1);
            let method = Promised {
                raster: stand.raster(knobs, rays),
                rays: stand.rays_with(stand.rays_settings(rays)),
                promise,
            };
            ("raster", paper_knobs(knobs), Box::new(method))
        }
        Chosen::Paper(knobs) => ("paper", paper_knobs(knobs), Box::new(stand.paper(knobs))),
        Chosen::Rays(rays) => {
            let method: Box<dyn Method + 's> = if choice.interpolates.is_some() {
                let promise = choice::promise_of_rays(&outcome, tolerance);
                Box::new(InterpolatedMethod::new(
                    stand,
                    (rays, choice.law),
                    (tolerance, 0),
                    promise,
                ))
            } else {
                Box::new(stand.rays_with(stand.rays_settings(rays)))
            };
            ("rays", vec![("rays", f64::from(rays))], method)
        }
        Chosen::Maps(knobs) => {
            let method = Box::new(stand.maps(&knobs, promise));
            ("maps", maps::names(&knobs), method)
        }
    };
    let method = match choice.lighting(stand.world(), diagnostics) {
        Some(lighting) => Box::new(Relit { lighting, method }),
        None => method,
    };
    Ok(Subject {
        engine,
        knobs,
        method,
        auto: Some(auto),
        sees: if matches!(engine, "maps" | "raster") || choice.interpolates.is_some() {
            Sees::All(outcome.check)
        } else {
            Sees::Each
        },
    })
}
