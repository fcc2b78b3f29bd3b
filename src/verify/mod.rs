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
use crate::gather::GatherScene;
use crate::pilot::clock::Clock;
use crate::pilot::error::{ErrorStatistics, Truth, relative, statistics, values};
use crate::pilot::{Knobs, Method};
use crate::receivers::Receivers;
use crate::results::Aov;
use serde::Serialize;

/// Passes over all subjects; odd, for the median.
const PASSES: usize = 3;

/// Receivers of one kind.
#[derive(Debug)]
pub struct Set {
    /// `points`, `surfels`, `pixels`.
    pub name: &'static str,
    /// Those that are measured.
    pub receivers: Receivers,
    /// How many there are in all.
    pub population: usize,
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
    set: &Set,
    diagnostics: &Diagnostics,
) -> Result<(TruthSummary, Vec<Row>), Cancelled> {
    // Phases of a few microseconds would only flicker on the screen, and cost time while it is measured.
    let silent = Diagnostics::new(Box::new(Silent), diagnostics.cancel_token().clone());
    let truth = truth(question, &set.receivers, &silent)?;
    let mut times = vec![Vec::with_capacity(PASSES); question.subjects.len()];
    let mut found = vec![Vec::new(); question.subjects.len()];
    for _ in 0..PASSES {
        for (i, subject) in question.subjects.iter().enumerate() {
            let timed = one_thread(|| {
                let start = Clock::start();
                let values = look(question, subject.method.as_ref(), &set.receivers, &silent);
                (values, start.seconds())
            });
            found[i] = timed.0?;
            times[i].push(timed.1);
        }
    }
    let count = set.receivers.len().max(1) as f64;
    let rows = question.subjects.iter().zip(found).zip(times);
    let rows = rows
        .map(|((subject, found), times)| Row {
            set: set.name,
            aov: question.aov.name(),
            engine: subject.engine,
            settings: subject.knobs.clone(),
            auto: subject.auto,
            microseconds: 1e6 * median(times) / count,
            error: statistics(&found, &truth),
            errors: signed(&found, &truth),
        })
        .collect();
    let summary = TruthSummary {
        set: set.name,
        aov: question.aov.name(),
        receivers: set.receivers.len(),
        population: set.population,
        mean: truth.mean,
        standard_error: relative(truth.standard_error, truth.mean),
    };
    Ok((summary, rows))
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
