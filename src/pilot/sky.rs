//! Depth maps × tolerance → the cheapest settings that meet it, and what they cost.
//!
//! A few receivers cannot be looked at by maps for less than what drawing the maps takes, so the error is taken apart.
//! That of the set of directions is measured with rays along these very directions, which is cheap at a few receivers.
//! That of the maps is measured against such rays with few directions only, and told for more of them ([`trial`]).
//! Costs are those of the drawing that was measured, and of the looks of all receivers by [`maps::seconds`].

mod along;
mod spread;
mod trial;

use self::spread::Spread;
use self::trial::Attempt;
use super::clock::Clock;
use super::error::Weighted;
use super::{Trial, choose};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::GatherScene;
use crate::gather::maps::{self, MapsPlan, MapsSettings, MapsSky};
use crate::receivers::Receivers;

/// Width of pixels and cells, in edges, and bias, in pixels: cheap ones first. Dense smooth meshes do with 3 edges,
/// scans need 1 or less; a cell below 1 draws meshes as they are.
const DETAILS: [(f32, f32, f32); 4] = [
    (3.0, 3.0, 1.0),
    (2.0, 2.0, 1.0),
    (1.0, 0.0, 0.5),
    (0.5, 0.0, 0.5),
];

/// First of [`DETAILS`] that draws meshes as they are.
const FINE: usize = 2;

/// Where maps' own errors are this many times what is allowed, decimation is given up: a cell of 2 edges instead of 3 made
/// them 1.6 to 2.3 times smaller.
const HOPELESS: f64 = 3.0;

/// `settings` with the finest detail that is tried; `None` if they have it already.
pub fn finest(settings: &MapsSettings) -> Option<MapsSettings> {
    let (pixel, cell, bias) = DETAILS[DETAILS.len() - 1];
    (settings.pixel > pixel).then_some(MapsSettings {
        pixel,
        cell,
        bias,
        ..*settings
    })
}

/// Fewest and most directions that are chosen.
const DIRECTIONS: (f64, f64) = (16.0, 4096.0);

/// Share of the tolerance that errors of maps themselves may take: more is not to be relied on, since at a few receivers
/// they hang on the worst of these. With 0.8, at 5, 2 and 1 %, a box with two spheres, teapots, a bunny and a scan were off
/// by 0.92 to 1.22 times what was foretold.
const OWN_SHARE: f64 = 0.8;

/// Maps for less than this share of what others cost are worth a try beyond [`OWN_SHARE`] too: the run looks back at
/// what came of it, and turns to the others if it has to. On the bunny of `tests/bench/make_scenes.py` at 2 % maps were
/// foretold 1.8 % at a twentieth of the rays' cost, and held it, though nearly all of it was their own; on its teapots at
/// a quarter.
const TRY_SHARE: f64 = 0.35;

/// Part of expected seconds that is counted on before anything was drawn: they are right within a factor of two.
const UNSURE: f64 = 0.5;

/// What is asked for.
#[derive(Debug)]
pub(super) struct Question<'a> {
    /// With the lights of the run.
    pub(super) scene: GatherScene<'a>,
    /// Receivers to measure at, and what each counts.
    pub(super) few: &'a Receivers,
    pub(super) weighted: Weighted<'a>,
    /// Receivers of the run.
    pub(super) total: usize,
    /// At least one thing.
    pub(super) asked: Vec<Asked>,
    /// Processor seconds that another engine needs for a receiver handed over.
    pub(super) handed_over_seconds: f64,
    /// Processor seconds of the run that an image takes besides maps: its division, and rays to its bright areas.
    pub(super) image_seconds: f64,
}

/// One of the things asked for.
#[derive(Debug, Clone)]
pub(super) struct Asked {
    /// Irradiance from an environment with an image; otherwise visibility.
    pub(super) is_image: bool,
    /// Its values at the few receivers, their mean and their relative error.
    pub(super) truth: Vec<f64>,
    pub(super) mean: f64,
    pub(super) truth_error: f64,
    /// Relative error to stay below.
    pub(super) allowed: f64,
}

impl Question<'_> {
    /// The sky for maps of these settings, if an image is asked for.
    fn sky(&self, settings: &MapsSettings) -> Option<MapsSky> {
        let is_image = self.asked.iter().any(|asked| asked.is_image);
        let lighting = self.scene.lighting.filter(|_| is_image)?;
        Some(MapsSky::new(lighting, settings))
    }

    /// Expected processor seconds of the run but for receivers handed over.
    fn expected(&self, plan: &MapsPlan<'_>, settings: &MapsSettings) -> f64 {
        maps::seconds(plan, self.total, settings) + self.image_seconds
    }
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
#[derive(Debug, Clone)]
pub(super) struct SkyBid {
    pub(super) settings: MapsSettings,
    /// Expected processor seconds.
    pub(super) seconds: f64,
    /// Expected relative error of each thing asked for.
    pub(super) errors: Vec<f64>,
    /// The largest of them over what is allowed.
    ratio: f64,
    /// The same of the part that no other set of directions has.
    own_ratio: f64,
}

/// The cheapest bid below the limit, if there is one.
pub(super) fn search(
    question: &Question<'_>,
    start: &Start<'_>,
    trials: &mut Vec<Trial>,
    diagnostics: &Diagnostics,
) -> Result<Option<SkyBid>, Cancelled> {
    let plan = start.plan;
    let cheapest = start.settings(DETAILS[0], DIRECTIONS.0);
    if UNSURE * question.expected(plan, &cheapest) > start.limit {
        return Ok(None);
    }
    let guess = start.directions.clamp(DIRECTIONS.0, DIRECTIONS.1);
    let spread = Spread::settled(question, guess, start, diagnostics)?;
    let sets = trial::sets(question, start, guess);
    let fewest = spread.least(question);
    let mut best: Option<SkyBid> = None;
    // Of the last detail tried: its own errors over what is allowed, and what it took over what was expected.
    let mut last: Option<(f64, f64)> = None;
    for (number, detail) in DETAILS.into_iter().enumerate() {
        let settings = |directions: f64| start.settings(detail, directions);
        let least = settings(fewest);
        let holds = best.as_ref().filter(|best| best.holds(start.limit));
        let limit = holds.map_or(start.limit, |best| best.seconds);
        let trying = trial::expected_seconds(question, (plan, &settings), &sets);
        // The expectation of one detail over another is better than one alone.
        let scale = last.map_or(UNSURE, |(_, scale)| scale);
        let is_worthless = scale * (question.expected(plan, &least) + trying) >= limit;
        let is_hopeless =
            number > 0 && number < FINE && last.is_some_and(|(own_ratio, _)| own_ratio > HOPELESS);
        if is_hopeless || is_worthless {
            continue;
        }
        let clock = Clock::start();
        let attempt = Attempt::make(question, (plan, &settings), &sets, diagnostics)?;
        let bid = attempt.bid(question, (plan, &settings), &spread);
        last = Some((
            bid.own_ratio,
            clock.seconds() / trying.max(f64::MIN_POSITIVE),
        ));
        trials.push(record(&bid, question));
        if bid.beats(best.as_ref(), start.limit) {
            best = Some(bid);
        }
    }
    let serves = |best: &SkyBid| {
        start.limit.is_infinite() || (best.holds(start.limit) && best.seconds < start.limit)
    };
    Ok(best.filter(serves))
}

impl Start<'_> {
    fn settings(&self, (pixel, cell, bias): (f32, f32, f32), directions: f64) -> MapsSettings {
        MapsSettings {
            directions: round(directions),
            pixel,
            cell,
            bias,
            max_distance: self.max_distance,
            ..MapsSettings::default()
        }
    }
}

impl SkyBid {
    /// True if it will meet what is allowed, or is likely to and cheap enough beside `limit` seconds to find out.
    fn holds(&self, limit: f64) -> bool {
        let is_cheap = limit.is_finite() && self.seconds <= TRY_SHARE * limit;
        self.ratio <= 1.0 && (self.own_ratio <= OWN_SHARE || is_cheap)
    }

    fn beats(&self, best: Option<&Self>, limit: f64) -> bool {
        match best {
            None => true,
            Some(best) if best.holds(limit) => self.holds(limit) && self.seconds < best.seconds,
            Some(best) => self.holds(limit) || self.ratio < best.ratio,
        }
    }
}

/// The largest of `errors` over what is allowed.
fn worst(errors: &[f64], question: &Question<'_>) -> f64 {
    let ratios = errors.iter().zip(&question.asked);
    (ratios.map(|(error, asked)| error / asked.allowed)).fold(0.0, f64::max)
}

fn record(bid: &SkyBid, question: &Question<'_>) -> Trial {
    Trial {
        engine: "maps",
        knobs: knobs(&bid.settings),
        seconds_per_receiver: bid.seconds / question.total.max(1) as f64,
        error_over_tolerance: Some(choose::AIM_OF_MAPS * bid.ratio),
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

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "between 1 and 4096"
)]
fn round(directions: f64) -> u32 {
    directions.clamp(1.0, DIRECTIONS.1).round() as u32
}
