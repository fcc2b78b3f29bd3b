//! What a pilot is asked, and what it answers.

use super::check::Check;
use super::light::LightScenes;
use super::{Candidate, Knobs, Method, Pick};
use crate::diagnostics::Cancelled;
use crate::gather::maps::MapsPlan;
use crate::gather::{ErrorEstimate, Thinning};
use crate::receivers::Receivers;
use crate::results::Aov;

/// What to choose for.
pub struct Pilot<'a, 'c> {
    /// Geometry, materials, lights.
    pub scenes: LightScenes<'a>,
    /// All receivers of the run.
    pub receivers: &'a Receivers,
    /// All AOVs of the run.
    pub aovs: &'a [Aov],
    /// Relative RMSE to meet, above 0.
    pub tolerance: f64,
    /// How many times what is open may err by rays: above 1 where neighbors will even it out.
    pub evened: f64,
    /// Rays: how many, and the turn of their pattern (0 = the run's).
    pub rays: &'a dyn Fn(u32, f32) -> Box<dyn Method + 'a>,
    /// Share of the receivers that so many rays would see for where receivers speak for each other; `None` where they do not,
    /// or nobody can tell.
    pub share: Share<'a>,
    /// How rays see where pixels have many receivers.
    pub thinning: Option<&'a Thinning>,
    /// Everything else that could do the whole job, cheap settings of an engine before dear ones.
    pub candidates: &'a [Candidate<'c>],
    /// Depth maps for what only asks for the sky.
    pub maps: Maps<'a>,
    /// Error of the surfels' spacing, which no engine changes: relative RMSE of each AOV, in order; empty = none.
    pub surfel_errors: &'a [f64],
}

/// See [`Pilot::share`].
pub type Share<'a> = &'a dyn Fn(u32) -> Result<Option<f64>, Cancelled>;

/// Whether maps may do what they can.
#[derive(Debug, Clone, Copy)]
pub enum Maps<'a> {
    /// No.
    Never,
    /// If they are cheaper: what they draw, and the distance beyond which nothing covers.
    IfCheaper(&'a MapsPlan<'a>, Option<f32>),
    /// Yes, as well as they can.
    Always(&'a MapsPlan<'a>, Option<f32>),
}

impl std::fmt::Debug for Pilot<'_, '_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pilot")
            .field("receivers", &self.receivers.len())
            .field("aovs", &self.aovs)
            .field("tolerance", &self.tolerance)
            .field("candidates", &self.candidates)
            .finish_non_exhaustive()
    }
}

/// One candidate as measured.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Trial {
    /// Engine.
    pub engine: &'static str,
    /// Settings.
    #[serde(serialize_with = "knobs_as_map")]
    pub knobs: Knobs,
    /// Processor seconds of gathering a receiver.
    pub seconds_per_receiver: f64,
    /// Relative RMSE over that allowed, of the worst AOV; none where the cost alone ruled it out.
    pub error_over_tolerance: Option<f64>,
}

fn knobs_as_map<S: serde::Serializer>(knobs: &Knobs, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(knobs.iter().copied())
}

/// What the pilot found.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// What was chosen.
    pub pick: Pick,
    /// Rays that meet the tolerance for all AOVs, whether chosen or not; `None` if no AOV depends on them.
    pub rays: Option<u32>,
    /// Power of the number of rays that their error falls with, as far as it was measured: else [`RaysSettings::LAW`](crate::gather::RaysSettings::LAW).
    pub law: f64,
    /// See [`Pilot::share`]; `None` if nobody asked.
    pub share: Option<f64>,
    /// Looks at the results at the pilot's receivers again once the run is done; `None` if no AOV depends on the engine.
    pub check: Option<Check>,
    /// Times the usual light samples that the tolerance needs.
    pub light_scale: u32,
    /// Expected error of the run, one an AOV that has any.
    pub errors: Vec<ErrorEstimate>,
    /// Everything measured; the last one of its engine is the one to compare.
    pub trials: Vec<Trial>,
    /// Receivers looked at.
    pub receivers: usize,
    /// Processor seconds it all took.
    pub seconds: f64,
}

impl Outcome {
    /// The largest of [`Self::errors`]; `None` without any.
    pub fn worst(&self) -> Option<f64> {
        self.errors
            .iter()
            .map(|error| error.relative_rmse)
            .reduce(f64::max)
    }
}
