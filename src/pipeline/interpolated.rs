//! Interpolation in a run.

use super::maps::Promise;
use super::report::Report;
use super::stand::Stand;
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::{GatherScene, RaysEngine, RaysSettings, ThinEngines, Thinning};
use crate::interpolate::{self, Fewer, Gathering, InterpolateSettings, Judge};
use crate::pilot::{self, Method};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};

impl Judge for Promise {
    fn accepts(&self, results: &Results) -> bool {
        self.is_kept_by(results)
    }

    fn picks(&self) -> &[usize] {
        self.check.picks()
    }

    fn accepts_at_picks(&self, few: &Results) -> bool {
        self.is_kept_at_picks(few)
    }
}

/// Rays, and interpolation between those that they see for; more rays, or rays for all, where that breaks a promise.
#[derive(Debug)]
pub(super) struct InterpolatedMethod<'a> {
    engines: Engines<'a>,
    settings: InterpolateSettings,
    promise: Option<Promise>,
    is_redone: AtomicBool,
    refusals: AtomicU32,
    gathered: AtomicUsize,
    is_by_fewer: AtomicBool,
}

/// Who sees for seeds.
#[derive(Debug)]
struct Engines<'a> {
    usual: RaysEngine<'a>,
    /// As many rays, of another pattern.
    again: RaysEngine<'a>,
    fewer: Option<FewerRays<'a>>,
    thin: Option<ThinEngines<'a>>,
}

/// See [`Gathering::fewer`].
#[derive(Debug)]
struct FewerRays<'a> {
    engines: [RaysEngine<'a>; 2],
    rays: u32,
    /// What they err by, over what all do.
    errors: f64,
}

/// Fewer rays err by about so many times what all do. One bounce, 512², 5 and 2 %, over the time with all: Cornell box 0.83,
/// 0.77, teapots 0.78, 0.70, room 0.74, 0.69, sky 0.62, 0.73; what comes of it is refused on a ball (1.3, 1.2) and a bunny (1.3,
/// 0.78). With 2 it is refused in most of these.
const FEWER_ERR: f64 = 1.4;

/// Where there are not so many rays, fewer err by more than the law of errors says: two teapots at 5 %, 1024², were refused with 92
/// in place of 143.
const MANY: u32 = 150;

impl<'a> Engines<'a> {
    fn new(settings: RaysSettings, engine: &dyn Fn(RaysSettings) -> RaysEngine<'a>) -> Self {
        let fewer = RaysSettings {
            rays: pilot::rays_with_errors(settings.rays, FEWER_ERR),
            ..settings.otherwise()
        };
        let errors = pilot::errors_with_rays(fewer.rays, settings.rays);
        Self {
            usual: engine(settings),
            again: engine(settings.again()),
            fewer: (settings.rays >= MANY && errors > 1.0).then(|| FewerRays {
                engines: [fewer, fewer.again()].map(engine),
                rays: fewer.rays,
                errors,
            }),
            thin: None,
        }
    }
}

impl<'a> InterpolatedMethod<'a> {
    /// For a run on `stand` with so many rays that may err by `tolerance`, of which the first results are refused as at the frame
    /// before; errors of rays fall by this `law`. With a promise, receivers are those of the whole run.
    pub(super) fn new(
        stand: &Stand<'a>,
        (rays, law): (u32, f64),
        (tolerance, refusals): (f64, u32),
        promise: Option<Promise>,
    ) -> Self {
        let engine = |settings| stand.rays_with(settings);
        let settings = stand.rays_settings(rays);
        let thin = stand.thin_rays((rays, law));
        let promise = promise.map(|promise| Promise {
            check: promise
                .check
                .thinned(thin.as_ref().map(ThinEngines::thinning)),
            ..promise
        });
        let mut method = Self::between((settings, &engine), (tolerance, refusals), promise);
        method.engines.thin = thin;
        method
    }

    /// The same between what an `engine` with these rays sees, or the mean of such.
    pub(super) fn between(
        (rays, engine): (RaysSettings, &dyn Fn(RaysSettings) -> RaysEngine<'a>),
        (tolerance, refusals): (f64, u32),
        promise: Option<Promise>,
    ) -> Self {
        Self {
            engines: Engines::new(rays, engine),
            settings: InterpolateSettings {
                tolerance,
                refusals,
            },
            promise,
            is_redone: AtomicBool::new(false),
            refusals: AtomicU32::new(0),
            gathered: AtomicUsize::new(0),
            is_by_fewer: AtomicBool::new(false),
        }
    }

    /// How rays saw where pixels have many receivers.
    pub(super) fn thinning(&self) -> Option<&Thinning> {
        let is_thin = !self.is_redone();
        (self.engines.thin.as_ref().filter(|_| is_thin)).map(ThinEngines::thinning)
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
        let fewer = self.engines.fewer.as_ref();
        if let Some(fewer) = fewer.filter(|_| self.is_by_fewer.load(Ordering::Relaxed)) {
            report.set("gathered_rays", fewer.rays);
        }
        if let Some(thinning) = self.thinning() {
            report.set("thinned_rays", thinning.cost());
        }
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
        let Engines {
            usual,
            again,
            fewer,
            thin,
        } = &self.engines;
        let kinds = usual.kinds(receivers);
        let gathering = Gathering {
            scene,
            engine: usual,
            again: Some(again),
            fewer: fewer.as_ref().map(|fewer| Fewer {
                engine: &fewer.engines[0],
                again: &fewer.engines[1],
                errors: fewer.errors,
            }),
            thin: thin.as_ref(),
            receivers,
            kinds: kinds.as_deref(),
            aovs,
        };
        let judge: &dyn Judge = match &self.promise {
            Some(promise) => promise,
            None => &|_: &Results| true,
        };
        let found = interpolate::gather(gathering, self.settings, judge, diagnostics)?;
        self.gathered.store(found.gathered, Ordering::Relaxed);
        self.is_by_fewer.store(found.is_by_fewer, Ordering::Relaxed);
        self.is_redone.store(found.is_refused, Ordering::Relaxed);
        self.refusals.store(found.refusals, Ordering::Relaxed);
        Ok(found.results)
    }
}
