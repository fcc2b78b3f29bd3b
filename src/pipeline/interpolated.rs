//! Interpolation in a run.

use super::maps::Promise;
use super::report::Report;
use super::stand::Stand;
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::{GatherScene, RaysEngine};
use crate::interpolate::{self, Gathering, InterpolateSettings};
use crate::pilot::Method;
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};

/// Rays, and interpolation between those that they see for; more rays, or rays for all, where that breaks a promise.
#[derive(Debug)]
pub(super) struct InterpolatedMethod<'a> {
    engine: RaysEngine<'a>,
    /// As many rays, of another pattern.
    again: RaysEngine<'a>,
    settings: InterpolateSettings,
    promise: Option<Promise>,
    is_redone: AtomicBool,
    refusals: AtomicU32,
    gathered: AtomicUsize,
}

impl<'a> InterpolatedMethod<'a> {
    /// For a run on `stand` with so many rays that may err by `tolerance`, of which the first results are refused as at the frame
    /// before. With a promise, receivers are those of the whole run.
    pub(super) fn new(
        stand: &Stand<'a>,
        rays: u32,
        (tolerance, refusals): (f64, u32),
        promise: Option<Promise>,
    ) -> Self {
        let settings = stand.rays_settings(rays);
        let engines = [settings, settings.again()].map(|settings| stand.rays_with(settings));
        Self::between(engines, (tolerance, refusals), promise)
    }

    /// The same between what the first of `engines` sees, or the mean of both.
    pub(super) fn between(
        [engine, again]: [RaysEngine<'a>; 2],
        (tolerance, refusals): (f64, u32),
        promise: Option<Promise>,
    ) -> Self {
        Self {
            engine,
            again,
            settings: InterpolateSettings {
                tolerance,
                refusals,
            },
            promise,
            is_redone: AtomicBool::new(false),
            refusals: AtomicU32::new(0),
            gathered: AtomicUsize::new(0),
        }
    }

    /// True if interpolation has broken the promise.
    pub(super) fn is_redone(&self) -> bool {
        self.is_redone.load(Ordering::Relaxed)
    }

    /// Results that were refused before any were accepted.
    pub(super) fn refusals(&self) -> u32 {
        self.refusals.load(Ordering::Relaxed)
    }

    /// Tell `report` how many receivers were gathered at.
    pub(super) fn record(&self, report: &mut Report) {
        report.counts.gathered = self.gathered.load(Ordering::Relaxed);
    }
}

impl Method for InterpolatedMethod<'_> {
    fn gather(
        &self,
        scene: GatherScene<'_>,
        receivers: &Receivers,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        let kinds = self.engine.kinds(receivers);
        let gathering = Gathering {
            scene,
            engine: &self.engine,
            again: Some(&self.again),
            receivers,
            kinds: kinds.as_deref(),
            aovs,
        };
        let is_kept = |results: &Results| {
            let promise = self.promise.as_ref();
            promise.is_none_or(|promise| promise.is_kept_by(results))
        };
        let found = interpolate::gather(gathering, self.settings, &is_kept, diagnostics)?;
        self.gathered.store(found.gathered, Ordering::Relaxed);
        self.is_redone.store(found.is_refused, Ordering::Relaxed);
        self.refusals.store(found.refusals, Ordering::Relaxed);
        Ok(found.results)
    }
}
