//! Maps in a run: what only asks for the sky by maps, rays for the rest and where maps cannot tell.

use super::report::Report;
use super::stand::Stand;
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::maps::{self, MapsPlan, MapsSettings};
use crate::gather::{self, ErrorEstimate, GatherScene, RaysEngine};
use crate::pilot::error::{mean_magnitude, rms_difference, values};
use crate::pilot::{self, Check, Knobs, Method};
use crate::receivers::Receivers;
use crate::results::{Aov, AovBuffer, Results};
use serde_json::json;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Rays that judge maps where no pilot has: at 1 % error of maps, theirs is at most a third.
pub(super) const REFERENCE_RAYS: u32 = 512;

/// What a receiver of the reference may cost over one of maps, in terms of a budget that is a tenth of the run. It
/// costs more, 30 to 60, but runs that maps are good for have many receivers, and then few of them judge.
pub(super) const REFERENCE_COST: u32 = 16;

/// Settings of a run by maps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MapsKnobs {
    pub(super) settings: MapsSettings,
    /// Rays of receivers that maps cannot judge.
    pub(super) handed_over: u32,
    /// Rays for other AOVs.
    pub(super) others: u32,
    /// True once maps have broken their promise at an earlier frame: rays then see for them.
    pub(super) is_broken: bool,
    /// True if rays then need not see for all receivers.
    pub(super) few_see: bool,
}

/// Gathers by maps and rays.
#[derive(Debug)]
pub(super) struct MapsMethod<'a> {
    plan: &'a MapsPlan<'a>,
    settings: MapsSettings,
    rays: Rays<'a>,
    /// Receivers that were handed over.
    handed_over_count: AtomicUsize,
    promise: Option<Promise>,
    /// Settings of the maps that kept their promise, if these are not the ones that were asked for.
    finer: OnceLock<MapsSettings>,
    is_redone: AtomicBool,
}

/// What looks where maps do not.
#[derive(Debug)]
pub(super) struct Rays<'a> {
    /// For receivers that maps cannot tell anything of.
    pub(super) handed_over: RaysEngine<'a>,
    /// For all of them, where maps break their promise.
    pub(super) instead: Box<dyn Method + 'a>,
    /// For AOVs that maps know nothing of.
    pub(super) others: Box<dyn Method + 'a>,
}

/// What has to be kept by the results at all receivers of the run.
#[derive(Debug, Clone)]
pub(super) struct Promise {
    pub(super) check: Check,
    pub(super) tolerance: f64,
}

impl Promise {
    /// True if `results` of the whole run err no more than the tolerance allows.
    pub(super) fn is_kept_by(&self, results: &Results) -> bool {
        self.is_kept_by_errors(&self.check.errors(results))
    }

    /// The same of results at the receivers of the check alone.
    pub(super) fn is_kept_at_picks(&self, few: &Results) -> bool {
        self.is_kept_by_errors(&self.check.errors_at_picks(few))
    }

    fn is_kept_by_errors(&self, errors: &[ErrorEstimate]) -> bool {
        errors
            .iter()
            .all(|error| error.relative_rmse <= self.tolerance)
    }
}

impl<'a> MapsMethod<'a> {
    /// With a promise, the finest maps and then rays compute again what maps computed where these break it; receivers are
    /// then those of the whole run.
    pub(super) fn new(
        (plan, knobs): (&'a MapsPlan<'a>, &MapsKnobs),
        rays: Rays<'a>,
        promise: Option<Promise>,
    ) -> Self {
        Self {
            plan,
            settings: knobs.settings,
            rays,
            handed_over_count: AtomicUsize::new(0),
            promise,
            finer: OnceLock::new(),
            is_redone: AtomicBool::new(knobs.is_broken),
        }
    }

    /// How what was seen was drawn.
    pub(super) fn settings(&self) -> MapsSettings {
        self.finer.get().copied().unwrap_or(self.settings)
    }

    /// True if maps have broken their promise.
    pub(super) fn is_redone(&self) -> bool {
        self.is_redone.load(Ordering::Relaxed)
    }

    /// Tell `report` who computed what.
    pub(super) fn record(&self, stand: &Stand<'_>, report: &mut Report) {
        let engine = |aov: Aov| {
            let is_map = maps::supports(aov.error_of().unwrap_or(aov)) && !self.is_redone();
            let name = if is_map { "maps" } else { "rays" };
            (aov.name().to_owned(), name.into())
        };
        let asked = stand.aovs.iter().filter(|aov| aov.needs_hemisphere());
        let engines: serde_json::Map<_, _> = asked.map(|&aov| engine(aov)).collect();
        report.set("engines", engines);
        let settings = self.settings();
        report.set("directions", settings.directions);
        report.set("map_pixel", f64::from(settings.pixel));
        report.set("map_cell", f64::from(settings.cell));
        let count = self.handed_over_count.load(Ordering::Relaxed);
        let share = count as f64 / stand.receivers.len().max(1) as f64;
        report.set("handed_over", json!({ "count": count, "share": share }));
    }

    /// The AOVs of the sky by maps, where these keep their promise.
    fn sky(
        &self,
        scene: GatherScene<'_>,
        (receivers, aovs): (&Receivers, &[Aov]),
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        let by_rays = || (self.rays.instead).gather(scene, receivers, aovs, diagnostics);
        if self.is_redone() {
            return by_rays();
        }
        let seen = self.drawn(scene, (receivers, aovs), &self.settings, diagnostics)?;
        if self.keeps_promise(&seen) {
            return Ok(seen);
        }
        if let Some(finest) = pilot::finest_maps(&self.settings) {
            // Much cheaper than rays, or maps would not have been taken.
            let seen = self.drawn(scene, (receivers, aovs), &finest, diagnostics)?;
            if self.keeps_promise(&seen) {
                self.finer.get_or_init(|| finest);
                return Ok(seen);
            }
        }
        self.is_redone.store(true, Ordering::Relaxed);
        by_rays()
    }

    /// By maps, and rays for receivers that these cannot judge.
    fn drawn(
        &self,
        scene: GatherScene<'_>,
        (receivers, aovs): (&Receivers, &[Aov]),
        settings: &MapsSettings,
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        let mut count = 0;
        let mut by_rays = |few: &Receivers, aovs: &[Aov]| {
            count += few.len();
            gather::gather(scene, &self.rays.handed_over, few, aovs, diagnostics)
        };
        let seen = maps::gather_sky(
            (self.plan, settings),
            scene.lighting,
            (receivers, aovs),
            (&mut by_rays, &|| scene.tracer),
            diagnostics,
        )?;
        self.handed_over_count.store(count, Ordering::Relaxed);
        Ok(seen)
    }

    fn keeps_promise(&self, seen: &Results) -> bool {
        let keeps = |promise: &Promise| promise.is_kept_by(seen);
        self.promise.as_ref().is_none_or(keeps)
    }
}

impl Method for MapsMethod<'_> {
    fn gather(
        &self,
        scene: GatherScene<'_>,
        receivers: &Receivers,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        let is_sky = |aov: Aov| maps::supports(aov.error_of().unwrap_or(aov));
        let (sky, rest): (Vec<Aov>, Vec<Aov>) = aovs.iter().partition(|&&aov| is_sky(aov));
        let mut found = if rest.is_empty() {
            Results::default()
        } else {
            self.rays
                .others
                .gather(scene, receivers, &rest, diagnostics)?
        };
        if !sky.is_empty() {
            let (errors, mut sky): (Vec<Aov>, Vec<Aov>) =
                sky.iter().partition(|aov| aov.error_of().is_some());
            let open = [Aov::Visibility, Aov::Occlusion];
            if !errors.is_empty() && !sky.iter().any(|aov| open.contains(aov)) {
                sky.push(Aov::Visibility);
            }
            let seen = self.sky(scene, (receivers, &sky), diagnostics)?;
            if !errors.is_empty() {
                let data = self.errors(&seen);
                let buffer = |&aov: &Aov| AovBuffer {
                    aov,
                    data: data.clone(),
                };
                found.buffers.extend(errors.iter().map(buffer));
            }
            found.buffers.extend(seen.buffers);
        }
        found.buffers.retain(|buffer| aovs.contains(&buffer.aov));
        Ok(found.in_order_of(aovs))
    }
}

/// Standard deviation of a verdict that maps err by, times the directions to the power 0.75: a rough fit to one bumpy
/// ball.
const VERDICT_ERROR: f64 = 1.2;

impl MapsMethod<'_> {
    /// About how wrong the visibility of each receiver is: nothing where all or nothing is open, most where half is. Of
    /// the size that the pilot's receivers show, where there was a pilot.
    fn errors(&self, seen: &Results) -> Vec<f32> {
        let visibility = values(seen, Aov::Visibility).unwrap_or_default();
        let shape: Vec<f64> = visibility
            .iter()
            .map(|v| (v * (1.0 - v)).max(0.0).sqrt())
            .collect();
        let none = vec![0.0; shape.len()];
        let usual = VERDICT_ERROR * f64::from(self.settings.directions).powf(-0.75);
        let measured = self.promise.as_ref().and_then(|promise| {
            let errors = promise.check.errors(seen);
            let error = errors.iter().find(|error| error.aov == Aov::Visibility)?;
            let rms = error.relative_rmse * mean_magnitude(&visibility);
            let size = rms_difference(&shape, &none);
            (size > 0.0).then(|| rms / size)
        });
        let scale = measured.unwrap_or(usual);
        #[expect(clippy::cast_possible_truncation, reason = "rounded once, at its end")]
        let error = |shape: f64| (scale * shape) as f32;
        shape.into_iter().map(error).collect()
    }
}

/// The knobs as tables name them.
pub(super) fn names(knobs: &MapsKnobs) -> Knobs {
    pilot::maps_knobs(&knobs.settings)
}
