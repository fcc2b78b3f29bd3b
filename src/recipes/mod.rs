//! Recipes: a file of steps → every step run on every file and frame it names, in order of what they need, as many at a
//! time as fit into memory; what is up to date is left alone.
//!
//! Steps are runs of surflux itself (or Python scripts) in processes of their own: one that crashes takes nothing with it,
//! and what it would say on the command line is what it says here.

mod manifest;
mod plan;
mod recipe;
mod run;

pub use plan::{ParseFrames, Plan, Task, plan};
pub use recipe::{Each, Recipe, RecipeError, Step, Value};
pub use run::{RunRecipeJob, RunReport, State, TaskReport, parse_bytes, run};
