//! [`Receivers`] × tolerance → the cheapest [`Candidate`] that meets it on this very scene.
//!
//! A few receivers spread over the run are gathered at with few rays, then more, until the error's law tells how many
//! the tolerance needs; then with half as many again, which is the reference: the chosen number and every other
//! candidate that promises to be cheaper are judged by it, its own error taken out. Errors do not depend on the
//! machine, costs do: two machines may choose different engines, never different errors beyond the tolerance.

mod check;
mod choose;
pub mod clock;
mod crowd;
pub mod error;
mod image;
mod light;
mod question;
mod sample;
mod sky;

pub use check::Check;
pub(crate) use choose::LAW;
pub use choose::{choose, errors_with_rays, picks, rays_with_errors};
pub use crowd::crowd;
pub use light::LightScenes;
pub use question::{Maps, Outcome, Pilot, Share, Trial};
pub use sky::{finest as finest_maps, knobs as maps_knobs};

use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::maps::MapsSettings;
use crate::gather::{self, Engine, GatherScene};
use crate::receivers::Receivers;
use crate::results::{Aov, Results};
use std::fmt;

/// Something that computes AOVs: an [`Engine`] with its settings, or a method that looks at all receivers at once.
pub trait Method: Sync + fmt::Debug {
    /// The contract of [`gather::gather`].
    ///
    /// # Errors
    /// When cancelled.
    fn gather(
        &self,
        scene: GatherScene<'_>,
        receivers: &Receivers,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled>;
}

impl<E: Engine> Method for E {
    fn gather(
        &self,
        scene: GatherScene<'_>,
        receivers: &Receivers,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        gather::gather(scene, self, receivers, aovs, diagnostics)
    }
}

/// What a pilot chose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pick {
    /// Rays for everything.
    Rays,
    /// The candidate of this index for everything.
    Candidate(usize),
    /// Maps for what asks for the sky alone.
    Maps {
        /// How they are drawn.
        settings: MapsSettings,
        /// Rays where maps cannot tell.
        handed_over: u32,
        /// Rays for all other AOVs.
        others: Option<u32>,
    },
}

/// Name and value of each knob.
pub type Knobs = Vec<(&'static str, f64)>;

/// An engine with settings, ready to be made.
pub struct Candidate<'a> {
    /// `rays`, `paper`, …
    pub engine: &'static str,
    /// Its settings.
    pub knobs: Knobs,
    /// Processor seconds that [`Self::make`] will probably take.
    pub preparation: f64,
    /// True if neighbors share most of its work: it is looked at with whole groups of them.
    pub sees_groups: bool,
    /// Makes it, with what it stands on.
    pub make: Box<dyn Fn() -> Box<dyn Method + 'a> + 'a>,
}

impl fmt::Debug for Candidate<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Candidate")
            .field("engine", &self.engine)
            .field("knobs", &self.knobs)
            .finish_non_exhaustive()
    }
}
