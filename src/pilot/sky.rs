//! Depth maps × tolerance → the cheapest settings that meet it, and what they cost.
//!
//! A few receivers cannot be looked at by maps for less than what drawing the maps takes, so the error is taken apart.
//! That of the set of directions is measured with rays along these very directions, which is cheap at a few receivers.
//! That of the maps is measured against the same rays with few directions only; more of them make it smaller, not larger.
//! Costs are those of the drawing that was measured, and of the looks of all receivers by [`maps::seconds`].

use super::clock::Clock;
use super::error::{relative, rms_difference};
use super::{Trial, choose};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::GatherScene;
use crate::gather::maps::{self, MapsPlan, MapsSettings, Wanted};
use crate::receivers::Receivers;
use glam::Vec3;
use rayon::prelude::*;

/// Width of pixels and cells, in edges, and bias, in pixels: cheap ones first. Dense smooth meshes do with 3 edges,
/// scans need 1 or less; a cell below 1 draws meshes as they are.
const DETAILS: [(f32, f32, f32); 4] = [
    (3.0, 3.0, 1.0),
    (2.0, 2.0, 1.0),
    (1.0, 0.0, 0.5),
    (0.5, 0.0, 0.5),
];

/// Directions of a trial over those of the run, at least and at most so many.
const TRIAL_SHARE: f64 = 0.125;
const TRIAL_DIRECTIONS: (f64, f64) = (16.0, 64.0);

/// Fewest and most directions that are chosen.
const DIRECTIONS: (f64, f64) = (16.0, 2048.0);

/// Power of the number of directions that errors of maps themselves fall with. Those in place stay, those of single pixels
/// average out: on a bumpy ball from 16 to 256 directions they fell with 0.4, on a box with two spheres with 0.2.
const MAPS_LAW: f64 = 0.25;

/// Share of the tolerance that errors of maps themselves may take: more is not to be relied on, since at a few receivers
/// they hang on the worst of these. Beyond it, in a box with two spheres, the run missed what was foretold.
const OWN_SHARE: f64 = 0.6;

/// Maps for less than this share of what others cost are worth a try beyond [`OWN_SHARE`] too: the run looks back at
/// what came of it, and turns to the others if it has to. On the bunny of `tests/bench/make_scenes.py` at 2 % maps were
/// foretold 1.8 % at a twentieth of the rays' cost, and held it, though nearly all of it was their own.
const TRY_SHARE: f64 = 0.2;

/// Receivers nearer to a corner or edge than this in barycentric weight have no plane of their own: as rays have it.
const RIM: f32 = 1e-4;

/// What is asked for.
#[derive(Debug)]
pub(super) struct Question<'a> {
    pub(super) scene: GatherScene<'a>,
    /// Receivers to measure at.
    pub(super) few: &'a Receivers,
    /// Receivers of the run.
    pub(super) total: usize,
    /// Visibility of each of `few`, its mean and its relative error.
    pub(super) truth: Vec<f64>,
    pub(super) mean: f64,
    pub(super) truth_error: f64,
    /// Relative error to stay below.
    pub(super) allowed: f64,
    /// Processor seconds that another engine needs for a receiver handed over.
    pub(super) ray_seconds: f64,
}

/// Where to start.
pub(super) struct Start<'a> {
    pub(super) plan: &'a MapsPlan<'a>,
    pub(super) max_distance: Option<f32>,
    /// Rays of another engine that meet the tolerance.
    pub(super) directions: f64,
    /// Seconds to stay below; infinite: the best there is, whatever it costs and whether it meets the tolerance or not.
    pub(super) limit: f64,
}

/// Settings that meet the tolerance.
#[derive(Debug, Clone, Copy)]
pub(super) struct SkyBid {
    pub(super) settings: MapsSettings,
    /// Expected processor seconds.
    pub(super) seconds: f64,
    /// Expected relative error.
    pub(super) error: f64,
    /// The part of it that no other set of directions has.
    own_error: f64,
}

/// The cheapest bid below the limit, if there is one.
pub(super) fn search(
    question: &Question<'_>,
    start: &Start<'_>,
    trials: &mut Vec<Trial>,
    diagnostics: &Diagnostics,
) -> Result<Option<SkyBid>, Cancelled> {
    let plan = start.plan;
    let guess = start.directions.clamp(DIRECTIONS.0, DIRECTIONS.1);
    let spread = Spread::measure(question, guess, start.max_distance);
    let tried = (TRIAL_SHARE * guess)
        .clamp(TRIAL_DIRECTIONS.0, TRIAL_DIRECTIONS.1)
        .round();
    let truth = along_axes(question, round(tried), start.max_distance);
    let mut best: Option<SkyBid> = None;
    for detail in DETAILS {
        let settings = |directions: f64| MapsSettings {
            directions: round(directions),
            pixel: detail.0,
            cell: detail.1,
            bias: detail.2,
            max_distance: start.max_distance,
            ..MapsSettings::default()
        };
        let expected = |settings: &MapsSettings| maps::seconds(plan, question.total, settings);
        let least = expected(&settings(spread.needed(0.0, question)));
        // Half: the expectation is right within a factor of two. That of one detail over another is better.
        let holds = best.filter(|best| best.holds(question, start.limit));
        let is_dearer = |best: SkyBid| least >= expected(&best.settings);
        if 0.5 * least > start.limit || holds.is_some_and(is_dearer) {
            continue;
        }
        let attempt = Attempt::make(question, plan, (settings(tried), &truth), diagnostics)?;
        let bid = attempt.bid(question, plan, &spread, &settings);
        trials.push(record(&bid, question));
        if bid.beats(best.as_ref(), (question, start.limit)) {
            best = Some(bid);
        }
    }
    let serves = |best: &SkyBid| {
        start.limit.is_infinite()
            || (best.holds(question, start.limit) && best.seconds < start.limit)
    };
    Ok(best.filter(serves))
}

impl SkyBid {
    /// True if it will meet what is allowed, or is likely to and cheap enough beside `limit` seconds to find out.
    fn holds(&self, question: &Question<'_>, limit: f64) -> bool {
        let is_sure = self.own_error <= OWN_SHARE * question.allowed;
        let is_cheap = limit.is_finite() && self.seconds <= TRY_SHARE * limit;
        self.error <= question.allowed && (is_sure || is_cheap)
    }

    fn beats(&self, best: Option<&Self>, (question, limit): (&Question<'_>, f64)) -> bool {
        match best {
            None => true,
            Some(best) if best.holds(question, limit) => {
                self.holds(question, limit) && self.seconds < best.seconds
            }
            Some(best) => self.holds(question, limit) || self.error < best.error,
        }
    }
}

fn record(bid: &SkyBid, question: &Question<'_>) -> Trial {
    Trial {
        engine: "maps",
        knobs: knobs(&bid.settings),
        seconds_per_receiver: bid.seconds / question.total.max(1) as f64,
        error_over_tolerance: Some(choose::AIM * bid.error / question.allowed),
    }
}

/// As candidates and reports name them.
pub fn knobs(settings: &MapsSettings) -> super::Knobs {
    vec![
        ("directions", f64::from(settings.directions)),
        ("pixel", f64::from(settings.pixel)),
        ("cell", f64::from(settings.cell)),
    ]
}

/// Relative error of the set of directions.
struct Spread {
    error: f64,
    directions: f64,
}

impl Spread {
    fn measure(question: &Question<'_>, directions: f64, max_distance: Option<f32>) -> Self {
        let found = along_axes(question, round(directions), max_distance);
        let both = relative(rms_difference(&found, &question.truth), question.mean);
        let own = both * both - question.truth_error * question.truth_error;
        Self {
            // Less than a quarter of what was measured is not told by subtraction.
            error: own.max(both * both / 16.0).sqrt(),
            directions,
        }
    }

    fn at(&self, directions: f64) -> f64 {
        self.error * (directions / self.directions).powf(-choose::LAW)
    }

    /// Directions that leave room for an error of maps of `own`, but not more than make theirs small beside it.
    fn needed(&self, own: f64, question: &Question<'_>) -> f64 {
        let left = question.allowed.powi(2) - own.powi(2);
        let room = left.max(0.25 * question.allowed.powi(2)).sqrt();
        (self.directions * (self.error / room).powf(1.0 / choose::LAW))
            .clamp(DIRECTIONS.0, DIRECTIONS.1)
    }
}

/// Maps of few directions.
struct Attempt {
    settings: MapsSettings,
    /// Relative error against rays along the same directions.
    error: f64,
    seconds: f64,
    /// Share of receivers handed over.
    ambiguous: f64,
}

impl Attempt {
    fn make(
        question: &Question<'_>,
        plan: &MapsPlan<'_>,
        (settings, truth): (MapsSettings, &[f64]),
        diagnostics: &Diagnostics,
    ) -> Result<Self, Cancelled> {
        let clock = Clock::start();
        let wanted = Wanted::default();
        let seen = maps::visibility(plan, question.few, &settings, &wanted, diagnostics)?;
        let seconds = clock.seconds();
        let sure = seen.visibility.iter().zip(&seen.ambiguous).zip(truth);
        let found: Vec<f64> = sure
            .map(|((&v, &ambiguous), &t)| if ambiguous { t } else { f64::from(v) })
            .collect();
        let ambiguous = seen.ambiguous.iter().filter(|&&yes| yes).count();
        Ok(Self {
            settings,
            error: relative(rms_difference(&found, truth), question.mean),
            seconds,
            ambiguous: ambiguous as f64 / question.few.len().max(1) as f64,
        })
    }

    fn own_error(&self, directions: f64) -> f64 {
        let ratio = directions / f64::from(self.settings.directions);
        self.error * ratio.max(1.0).powf(-MAPS_LAW)
    }

    /// As many directions as the tolerance needs, and what they cost.
    fn bid(
        &self,
        question: &Question<'_>,
        plan: &MapsPlan<'_>,
        spread: &Spread,
        settings: &dyn Fn(f64) -> MapsSettings,
    ) -> SkyBid {
        let least = spread.needed(0.0, question);
        let directions = spread.needed(self.own_error(least), question);
        let own_error = self.own_error(directions);
        let chosen = settings(directions);
        let handed_over = self.ambiguous * question.total as f64 * question.ray_seconds;
        SkyBid {
            settings: chosen,
            seconds: self.shared_seconds(plan, &chosen)
                + looks(plan, question.total, &chosen)
                + handed_over,
            error: spread.at(directions).hypot(own_error),
            own_error,
        }
    }

    /// Seconds for drawing, as measured: what does not grow with the directions, and what does.
    fn shared_seconds(&self, plan: &MapsPlan<'_>, chosen: &MapsSettings) -> f64 {
        let drawing = maps::seconds(plan, 0, &self.settings).min(self.seconds);
        let ratio = f64::from(chosen.directions) / f64::from(self.settings.directions);
        self.seconds - drawing + ratio * drawing
    }
}

/// Seconds that the looks of `receivers` take.
fn looks(plan: &MapsPlan<'_>, receivers: usize, settings: &MapsSettings) -> f64 {
    maps::seconds(plan, receivers, settings) - maps::seconds(plan, 0, settings)
}

/// Visibility of the few receivers by rays along the axes of `count` maps.
fn along_axes(question: &Question<'_>, count: u32, max_distance: Option<f32>) -> Vec<f64> {
    let axes: Vec<Vec3> = maps::directions(count).collect();
    let reach = max_distance.unwrap_or(f32::INFINITY);
    (0..question.few.len())
        .into_par_iter()
        .map(|i| {
            let (mut open, mut all) = (0.0, 0.0);
            let stand = Stand::of(question, i);
            for axis in &axes {
                let height = axis.dot(question.few.normal[i]);
                let direction = if height < 0.0 { -axis } else { *axis };
                let weight = f64::from(height.abs());
                all += weight;
                if !stand.is_covered(question, direction, reach) {
                    open += weight;
                }
            }
            if all > 0.0 { open / all } else { 0.0 }
        })
        .collect()
}

/// Where a receiver's rays start and the plane they do not cross.
struct Stand {
    origin: Vec3,
    plane: Option<Vec3>,
}

impl Stand {
    fn of(question: &Question<'_>, i: usize) -> Self {
        let few = question.few;
        let (normal, plane) = (few.normal[i], few.geometric_normal[i]);
        let surface = &few.surface[i];
        let on_rim = surface.u.min(surface.v).min(1.0 - surface.u - surface.v) < RIM;
        let lift = if on_rim && normal.dot(plane) > 0.5 {
            normal
        } else {
            plane
        };
        Self {
            origin: question.scene.tracer.lift(few.position[i], lift),
            plane: (!on_rim).then_some(plane),
        }
    }

    fn is_covered(&self, question: &Question<'_>, direction: Vec3, reach: f32) -> bool {
        let direction = match self.plane {
            Some(plane) if direction.dot(plane) < 0.0 => {
                direction - plane * (2.0 * direction.dot(plane))
            }
            _ => direction,
        };
        question
            .scene
            .tracer
            .occluded(self.origin, direction, reach)
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "between 1 and 2048"
)]
fn round(directions: f64) -> u32 {
    directions.clamp(1.0, DIRECTIONS.1).round() as u32
}
