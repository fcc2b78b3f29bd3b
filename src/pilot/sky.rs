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
use crate::gather::maps::{self, MapsPlan, MapsSettings, MapsSky, SkyWanted, Wanted};
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
/// foretold 1.8 % at a twentieth of the rays' cost, and held it, though nearly all of it was their own; on its teapots at
/// a quarter.
const TRY_SHARE: f64 = 0.35;

/// Receivers nearer to a corner or edge than this in barycentric weight have no plane of their own: as rays have it.
const RIM: f32 = 1e-4;

/// What is asked for.
#[derive(Debug)]
pub(super) struct Question<'a> {
    /// With the lights of the run.
    pub(super) scene: GatherScene<'a>,
    /// Receivers to measure at.
    pub(super) few: &'a Receivers,
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
    // Half: the expectation is right within a factor of two.
    let is_too_dear =
        |settings: &MapsSettings| 0.5 * question.expected(plan, settings) > start.limit;
    if is_too_dear(&start.settings(DETAILS[0], DIRECTIONS.0)) {
        return Ok(None);
    }
    let guess = start.directions.clamp(DIRECTIONS.0, DIRECTIONS.1);
    let spread = Spread::settled(question, guess, start, diagnostics)?;
    let tried = (TRIAL_SHARE * guess)
        .clamp(TRIAL_DIRECTIONS.0, TRIAL_DIRECTIONS.1)
        .round();
    let sky = question.sky(&start.settings(DETAILS[0], tried));
    let truth = along_axes(question, round(tried), start.max_distance, sky.as_ref());
    let mut best: Option<SkyBid> = None;
    for detail in DETAILS {
        let settings = |directions: f64| start.settings(detail, directions);
        let least = settings(spread.needed(&[], question));
        // The expectation of one detail over another is better.
        let holds = best.as_ref().filter(|best| best.holds(start.limit));
        let expected = |settings: &MapsSettings| question.expected(plan, settings);
        let is_dearer = |best: &SkyBid| expected(&least) >= expected(&best.settings);
        if is_too_dear(&least) || holds.is_some_and(is_dearer) {
            continue;
        }
        let trial = (settings(tried), sky.as_ref(), &truth[..]);
        let attempt = Attempt::make(question, plan, trial, diagnostics)?;
        let bid = attempt.bid(question, plan, &spread, &settings);
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
        error_over_tolerance: Some(choose::AIM * bid.ratio),
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

/// Relative error of the set of directions, of each thing asked for.
struct Spread {
    errors: Vec<f64>,
    directions: f64,
}

/// Measurements at most until the number of directions is that which they ask for.
const MOST_LOOKS: u32 = 3;

/// Numbers of directions over one another between which the law of their error is relied on for an image, part of whose
/// error, that of its bright areas, falls with nothing.
const NEAR: (f64, f64) = (0.7, 1.4);

impl Spread {
    /// Measured at about as many directions as are needed, where an image is asked for.
    fn settled(
        question: &Question<'_>,
        guess: f64,
        start: &Start<'_>,
        diagnostics: &Diagnostics,
    ) -> Result<Self, Cancelled> {
        let is_image = question.asked.iter().any(|asked| asked.is_image);
        let mut directions = guess;
        let mut looks = 1;
        loop {
            let spread = Self::measure(question, directions, start, diagnostics)?;
            let needed = spread.needed(&[], question);
            let is_near = (NEAR.0..NEAR.1).contains(&(needed / directions));
            if !is_image || is_near || looks == MOST_LOOKS {
                return Ok(spread);
            }
            directions = needed;
            looks += 1;
        }
    }

    fn measure(
        question: &Question<'_>,
        directions: f64,
        start: &Start<'_>,
        diagnostics: &Diagnostics,
    ) -> Result<Self, Cancelled> {
        let sky = question.sky(&start.settings(DETAILS[0], directions));
        let mut found = along_axes(
            question,
            round(directions),
            start.max_distance,
            sky.as_ref(),
        );
        if let Some(sky) = &sky {
            let scene = (question.scene.shader.scene(), question.scene.tracer);
            let bright = sky.bright_light(scene, question.few, diagnostics)?;
            let images = found.iter_mut().zip(&question.asked);
            for (values, _) in images.filter(|(_, asked)| asked.is_image) {
                let bright = bright.iter().flat_map(|light| light.irradiance.to_array());
                (values.iter_mut().zip(bright)).for_each(|(sum, x)| *sum += f64::from(x));
            }
        }
        let error = |(found, asked): (&Vec<f64>, &Asked)| {
            let both = relative(rms_difference(found, &asked.truth), asked.mean);
            let own = both * both - asked.truth_error * asked.truth_error;
            // Less than a quarter of what was measured is not told by subtraction.
            own.max(both * both / 16.0).sqrt()
        };
        Ok(Self {
            errors: found.iter().zip(&question.asked).map(error).collect(),
            directions,
        })
    }

    fn at(&self, directions: f64) -> impl Iterator<Item = f64> {
        let left = (directions / self.directions).powf(-choose::LAW);
        self.errors.iter().map(move |error| error * left)
    }

    /// Directions that leave room for errors of maps of `own` (none: 0), but not more than make theirs small beside
    /// them.
    fn needed(&self, own: &[f64], question: &Question<'_>) -> f64 {
        let one = |(k, (error, asked)): (usize, (&f64, &Asked))| {
            let own = own.get(k).copied().unwrap_or(0.0);
            let left = asked.allowed.powi(2) - own.powi(2);
            let room = left.max(0.25 * asked.allowed.powi(2)).sqrt();
            self.directions * (error / room).powf(1.0 / choose::LAW)
        };
        let asked = self.errors.iter().zip(&question.asked).enumerate();
        asked
            .map(one)
            .fold(DIRECTIONS.0, f64::max)
            .min(DIRECTIONS.1)
    }
}

/// Maps of few directions.
struct Attempt {
    settings: MapsSettings,
    /// Relative errors against rays along the same directions.
    errors: Vec<f64>,
    seconds: f64,
    /// Share of receivers handed over.
    ambiguous: f64,
}

impl Attempt {
    fn make(
        question: &Question<'_>,
        plan: &MapsPlan<'_>,
        (settings, sky, truth): (MapsSettings, Option<&MapsSky>, &[Vec<f64>]),
        diagnostics: &Diagnostics,
    ) -> Result<Self, Cancelled> {
        let clock = Clock::start();
        let wanted = Wanted {
            environment: sky.map(|sky| SkyWanted {
                sky,
                with_direction: false,
            }),
            ..Wanted::default()
        };
        let seen = maps::visibility(plan, question.few, &settings, &wanted, diagnostics)?;
        let seconds = clock.seconds();
        let error = |(asked, truth): (&Asked, &Vec<f64>)| {
            let mut found: Vec<f64> = if asked.is_image {
                let light = seen.environment.iter().flat_map(|light| light.to_array());
                light.map(f64::from).collect()
            } else {
                seen.visibility.iter().copied().map(f64::from).collect()
            };
            let components = (truth.len() / question.few.len().max(1)).max(1);
            let pairs = found.chunks_mut(components).zip(truth.chunks(components));
            for ((found, truth), _) in pairs.zip(&seen.ambiguous).filter(|(_, yes)| **yes) {
                found.copy_from_slice(truth);
            }
            relative(rms_difference(&found, truth), asked.mean)
        };
        let ambiguous = seen.ambiguous.iter().filter(|&&yes| yes).count();
        Ok(Self {
            settings,
            errors: question.asked.iter().zip(truth).map(error).collect(),
            seconds,
            ambiguous: ambiguous as f64 / question.few.len().max(1) as f64,
        })
    }

    fn own_errors(&self, directions: f64) -> Vec<f64> {
        let ratio = directions / f64::from(self.settings.directions);
        let left = ratio.max(1.0).powf(-MAPS_LAW);
        self.errors.iter().map(|error| error * left).collect()
    }

    /// As many directions as the tolerance needs, and what they cost.
    fn bid(
        &self,
        question: &Question<'_>,
        plan: &MapsPlan<'_>,
        spread: &Spread,
        settings: &dyn Fn(f64) -> MapsSettings,
    ) -> SkyBid {
        let least = spread.needed(&[], question);
        let directions = spread.needed(&self.own_errors(least), question);
        let own_errors = self.own_errors(directions);
        let chosen = settings(directions);
        let handed_over = self.ambiguous * question.total as f64 * question.handed_over_seconds;
        let both = spread.at(directions).zip(&own_errors);
        let errors: Vec<f64> = both.map(|(spread, own)| spread.hypot(*own)).collect();
        SkyBid {
            settings: chosen,
            seconds: self.shared_seconds(plan, &chosen)
                + looks(plan, question.total, &chosen)
                + question.image_seconds
                + handed_over,
            ratio: worst(&errors, question),
            own_ratio: worst(&own_errors, question),
            errors,
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

/// What the few receivers see by rays along the axes of `count` maps, for each thing asked for: of an image what comes
/// from the even part of `sky`.
fn along_axes(
    question: &Question<'_>,
    count: u32,
    max_distance: Option<f32>,
    sky: Option<&MapsSky>,
) -> Vec<Vec<f64>> {
    let axes: Vec<Vec3> = maps::directions(count).collect();
    let reach = max_distance.unwrap_or(f32::INFINITY);
    let few = question.few;
    let seen: Vec<(f64, Vec3)> = (0..few.len())
        .into_par_iter()
        .map(|i| {
            let (mut open, mut all) = (0.0, 0.0);
            let stand = Stand::of(question, i);
            let mut covered = Vec::with_capacity(axes.len());
            for axis in &axes {
                let height = axis.dot(few.normal[i]);
                let direction = if height < 0.0 { -axis } else { *axis };
                let weight = f64::from(height.abs());
                all += weight;
                covered.push(stand.is_covered(question, direction, reach));
                open += if covered.last() == Some(&true) {
                    0.0
                } else {
                    weight
                };
            }
            let light = sky.map_or(Vec3::ZERO, |sky| sky.even_light(few.normal[i], &covered));
            (if all > 0.0 { open / all } else { 0.0 }, light)
        })
        .collect();
    let values = |asked: &Asked| {
        if asked.is_image {
            let light = seen.iter().flat_map(|(_, light)| light.to_array());
            light.map(f64::from).collect()
        } else {
            seen.iter().map(|(open, _)| *open).collect()
        }
    };
    question.asked.iter().map(values).collect()
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
