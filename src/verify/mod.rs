//! Engines × settings × receivers → speed against error: every [`Subject`] is timed and compared with converged rays.
//!
//! Times are processor time of one thread, the median of several passes that take turns. The
//! truth is the mean of two independent halves; their difference is its standard error, which is taken out of every
//! relative RMSE.

mod histogram;
mod html;
mod machine;
mod picture;
mod plot;

pub use html::page;
pub use machine::Machine;
pub use picture::{ErrorPicture, picture};

use crate::diagnostics::{Cancelled, Diagnostics, Silent};
use crate::gather::{self, GatherScene};
use crate::pilot::clock::Clock;
use crate::pilot::error::{ErrorStatistics, Truth, relative, statistics, values};
use crate::pilot::{Check, Knobs, Method, crowd};
use crate::receivers::Receivers;
use crate::results::Aov;
use serde::Serialize;

/// Passes over all subjects; odd, for the median.
const PASSES: usize = 3;

/// A pass that took longer than this many seconds is long enough for its time to mean something: it is the only one.
const LONG_PASS: f64 = 0.3;

/// Receivers of one kind.
#[derive(Debug)]
pub struct Set<'a> {
    /// `points`, `surfels`, `pixels`.
    pub name: &'static str,
    /// Those that errors are measured at.
    pub receivers: Receivers,
    /// Which of all they are.
    pub picks: Vec<usize>,
    /// All there are.
    pub all: &'a Receivers,
    /// Neighbors, which tell what a receiver of a run costs.
    crowd: Receivers,
    /// Whole groups of neighbors around the picks.
    groups: Receivers,
    /// Where the picks are among them.
    places: Vec<usize>,
}

impl<'a> Set<'a> {
    /// The receivers `picks` of `all`.
    pub fn new(name: &'static str, all: &'a Receivers, picks: Vec<usize>) -> Self {
        let (members, places) = gather::groups(all, &picks);
        Self {
            name,
            receivers: all.subset(&picks),
            picks,
            all,
            crowd: crowd(all),
            groups: all.subset(&members),
            places,
        }
    }
}

/// What a subject has to be given so that its time means something.
#[derive(Debug, Clone)]
pub enum Sees {
    /// Some receivers: each costs the same, but for what it shares with its neighbors.
    Each,
    /// Whole groups of neighbors: they share work, and err by it.
    Groups,
    /// All receivers at once: what they share is most of the cost. The check, if there is one, tells the error that a
    /// run would report.
    All(Option<Check>),
}

/// One engine with its settings.
#[derive(Debug)]
pub struct Subject<'a> {
    /// Engine.
    pub engine: &'static str,
    /// Settings.
    pub knobs: Knobs,
    /// What gathers.
    pub method: Box<dyn Method + 'a>,
    /// Set if this is what `--tolerance` picks.
    pub auto: Option<Auto>,
    /// How it is timed.
    pub sees: Sees,
}

impl Subject<'_> {
    /// Those that it is timed at.
    fn receivers<'s>(&self, set: &'s Set<'_>) -> &'s Receivers {
        match self.sees {
            Sees::Each => &set.crowd,
            Sees::Groups => &set.groups,
            Sees::All(_) => set.all,
        }
    }

    fn count(&self, set: &Set<'_>) -> usize {
        self.receivers(set).len()
    }
}

/// A pick of the pilot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Auto {
    /// Tolerance asked for.
    pub tolerance: f64,
    /// Error that the pilot foretold; none if it had nothing to measure.
    pub estimate: Option<f64>,
    /// Cost of the pilot, microseconds of processor time a receiver of the whole population.
    pub pilot_microseconds: f64,
}

/// What is measured at a set.
#[derive(Debug)]
pub struct Question<'a> {
    /// Which AOV; occlusion is asked for as visibility.
    pub aov: Aov,
    /// The scene that subjects see.
    pub scene: GatherScene<'a>,
    /// The scene that the truth sees: finer light samples.
    pub truth_scene: GatherScene<'a>,
    /// Two independent halves of the truth.
    pub truth: [Box<dyn Method + 'a>; 2],
    /// The field.
    pub subjects: Vec<Subject<'a>>,
}

/// One subject at one set.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Name of the set.
    pub set: &'static str,
    /// Name of the AOV.
    pub aov: &'static str,
    /// Engine.
    pub engine: &'static str,
    /// Settings.
    #[serde(serialize_with = "as_map")]
    pub settings: Knobs,
    /// Set if this is what `--tolerance` picks.
    pub auto: Option<Auto>,
    /// Processor time of one receiver on one thread.
    pub microseconds: f64,
    /// How wrong it is.
    #[serde(flatten)]
    pub error: ErrorStatistics,
    /// Signed error of each value over the truth's mean.
    #[serde(skip)]
    pub errors: Vec<f64>,
}

impl Row {
    /// The settings in words: `rays 64`.
    pub fn settings_text(&self) -> String {
        knobs_text(&self.settings)
    }

    /// Engine and settings in words.
    pub fn label(&self) -> String {
        label(self.engine, &self.settings)
    }
}

/// Engine and settings in words: `rays 64`, `paper: max solid angle 0.03, raster resolution 12`.
pub fn label(engine: &str, knobs: &Knobs) -> String {
    let knobs = knobs_text(knobs);
    if knobs.starts_with(engine) {
        knobs
    } else {
        format!("{engine}: {knobs}")
    }
}

/// Names and values, comma separated.
pub fn knobs_text(knobs: &Knobs) -> String {
    let words: Vec<String> = knobs
        .iter()
        .map(|(name, value)| format!("{} {value}", name.replace('_', " ")))
        .collect();
    words.join(", ")
}

fn as_map<S: serde::Serializer>(knobs: &Knobs, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(knobs.iter().copied())
}

/// The truth of one AOV at one set.
#[derive(Debug, Clone, Serialize)]
pub struct TruthSummary {
    /// Name of the set.
    pub set: &'static str,
    /// Name of the AOV.
    pub aov: &'static str,
    /// Receivers measured.
    pub receivers: usize,
    /// Receivers there are.
    pub population: usize,
    /// Mean magnitude.
    pub mean: f64,
    /// rms of the standard errors over the mean.
    pub standard_error: f64,
}

/// Everything `surflux verify` finds.
#[derive(Debug, Clone, Serialize)]
pub struct VerifyReport {
    /// Version.
    pub surflux: &'static str,
    /// The command line.
    pub command: Vec<String>,
    /// Root layer.
    pub stage: String,
    /// `native` or `usd-core`.
    pub usd: String,
    /// Where it was measured.
    pub machine: Machine,
    /// Triangles of the scene.
    pub triangles: usize,
    /// Surfels diced from it.
    pub surfels: usize,
    /// What everything is compared with.
    pub truth: Vec<TruthSummary>,
    /// All measurements, by AOV, set and subject.
    pub rows: Vec<Row>,
    /// Seconds it took.
    pub seconds: f64,
    /// Everything that was not as it should be.
    pub warnings: Vec<crate::diagnostics::Warning>,
    /// Errors seen by the camera.
    #[serde(skip)]
    pub pictures: Vec<ErrorPicture>,
}

/// Truth of `question` at `receivers`. Uses all threads.
///
/// # Errors
/// When cancelled.
pub fn truth(
    question: &Question<'_>,
    receivers: &Receivers,
    diagnostics: &Diagnostics,
) -> Result<Truth, Cancelled> {
    let [a, b] = &question.truth;
    let half = |method: &dyn Method| -> Result<Vec<f64>, Cancelled> {
        let results = method.gather(
            question.truth_scene,
            receivers,
            &[question.aov],
            diagnostics,
        )?;
        Ok(values(&results, question.aov).unwrap_or_default())
    };
    Ok(Truth::of_halves(&half(a.as_ref())?, &half(b.as_ref())?))
}

/// Values of one subject. Uses all threads.
///
/// # Errors
/// When cancelled.
pub fn look(
    question: &Question<'_>,
    method: &dyn Method,
    receivers: &Receivers,
    diagnostics: &Diagnostics,
) -> Result<Vec<f64>, Cancelled> {
    let results = method.gather(question.scene, receivers, &[question.aov], diagnostics)?;
    Ok(values(&results, question.aov).unwrap_or_default())
}

/// Measure all subjects of `question` at `set`, in order.
///
/// # Errors
/// When cancelled.
pub fn measure(
    question: &Question<'_>,
    set: &Set<'_>,
    diagnostics: &Diagnostics,
) -> Result<(TruthSummary, Vec<Row>), Cancelled> {
    // Phases of a few microseconds would only flicker on the screen, and cost time while it is measured.
    let silent = Diagnostics::new(Box::new(Silent), diagnostics.cancel_token().clone());
    let truth = truth(question, &set.receivers, &silent)?;
    let mut rows: Vec<Row> = Vec::new();
    let mut times = vec![Vec::with_capacity(PASSES); question.subjects.len()];
    for pass in 0..PASSES {
        for (i, subject) in question.subjects.iter().enumerate() {
            let is_long = |seconds: &f64| *seconds * subject.count(set) as f64 > LONG_PASS;
            if times[i].first().is_some_and(is_long) {
                continue;
            }
            let timed = one_thread(|| run(question, subject, set, &silent))?;
            times[i].push(timed.seconds);
            if pass == 0 {
                let pass = match subject.sees {
                    Sees::Each => Pass {
                        values: look(question, subject.method.as_ref(), &set.receivers, &silent)?,
                        ..timed
                    },
                    Sees::Groups | Sees::All(_) => timed,
                };
                rows.push(row(question, subject, (set, &pass), &truth));
            }
        }
    }
    for (row, times) in rows.iter_mut().zip(times) {
        row.microseconds = 1e6 * median(times);
    }
    let summary = TruthSummary {
        set: set.name,
        aov: question.aov.name(),
        receivers: set.receivers.len(),
        population: set.all.len(),
        mean: truth.mean,
        standard_error: relative(truth.standard_error, truth.mean),
    };
    Ok((summary, rows))
}

/// One pass of one subject.
struct Pass {
    /// At the receivers that it was timed at; of all of them, only the set's.
    values: Vec<f64>,
    /// A receiver.
    seconds: f64,
    /// The error that a run would report, if it looks back at its results.
    estimate: Option<f64>,
}

fn run(
    question: &Question<'_>,
    subject: &Subject<'_>,
    set: &Set<'_>,
    diagnostics: &Diagnostics,
) -> Result<Pass, Cancelled> {
    let receivers = subject.receivers(set);
    let aovs = [question.aov];
    let start = Clock::start();
    let method = subject.method.as_ref();
    let results = method.gather(question.scene, receivers, &aovs, diagnostics)?;
    let seconds = start.seconds() / receivers.len().max(1) as f64;
    let mut found = values(&results, question.aov).unwrap_or_default();
    let mut estimate = None;
    let places = match &subject.sees {
        Sees::Each => None,
        Sees::Groups => Some(&set.places),
        Sees::All(_) => Some(&set.picks),
    };
    if let Some(places) = places {
        let n = found.len() / receivers.len().max(1);
        let picked = places.iter().flat_map(|&i| &found[i * n..][..n]);
        found = picked.copied().collect();
    }
    if let Sees::All(check) = &subject.sees {
        let errors = check.as_ref().map(|check| check.errors(&results));
        let errors = errors.into_iter().flatten();
        estimate = errors.map(|error| error.relative_rmse).reduce(f64::max);
    }
    Ok(Pass {
        values: found,
        seconds,
        estimate,
    })
}

fn row(
    question: &Question<'_>,
    subject: &Subject<'_>,
    (set, pass): (&Set<'_>, &Pass),
    truth: &Truth,
) -> Row {
    let auto = subject.auto.map(|auto| Auto {
        estimate: pass.estimate.or(auto.estimate),
        ..auto
    });
    Row {
        set: set.name,
        aov: question.aov.name(),
        engine: subject.engine,
        settings: subject.knobs.clone(),
        auto,
        microseconds: 1e6 * pass.seconds,
        error: statistics(&pass.values, truth),
        errors: signed(&pass.values, truth),
    }
}

/// Error of each value over the truth's mean.
pub fn signed(run: &[f64], truth: &Truth) -> Vec<f64> {
    run.iter()
        .zip(&truth.values)
        .map(|(x, t)| relative(x - t, truth.mean))
        .collect()
}

/// Runs `work` on one thread of its own; where the system gives none, on the pool as it is.
fn one_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_ignores_one_disturbed_pass() {
        assert_eq!(median(vec![1.0, 100.0, 2.0]), 2.0);
        assert_eq!(median(vec![]), 0.0);
    }

    #[test]
    fn settings_are_told_in_words() {
        let knobs = vec![("max_solid_angle", 0.03), ("raster_resolution", 12.0)];
        assert_eq!(
            knobs_text(&knobs),
            "max solid angle 0.03, raster resolution 12"
        );
    }
}
