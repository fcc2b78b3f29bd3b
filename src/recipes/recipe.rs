//! A recipe as it is written: `schemas/recipe.schema.json` tells the same to editors.

use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What can be wrong with a recipe, or with running one.
#[derive(Debug, thiserror::Error)]
pub enum RecipeError {
    /// Cannot be read.
    #[error("{}: cannot be read", path.display())]
    Read {
        /// The recipe.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Is no recipe.
    #[error("{}: is no recipe", path.display())]
    Parse {
        /// The recipe.
        path: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// Contradicts itself, or names what is not there.
    #[error("{}: {message}", path.display())]
    Meaning {
        /// The recipe.
        path: PathBuf,
        /// What is wrong and what would be right.
        message: String,
    },
    /// The manifest cannot be written.
    #[error("{}: cannot be written", path.display())]
    Manifest {
        /// The manifest.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Some steps failed.
    #[error("{failed} of {all} tasks failed{}", if *skipped > 0 { format!(", {skipped} were left out since they need them") } else { String::new() })]
    Failed {
        /// How many.
        failed: usize,
        /// Of how many.
        all: usize,
        /// Tasks that could not be started.
        skipped: usize,
    },
    /// Ended by a signal.
    #[error("cancelled: what was finished stays; --resume goes on")]
    Cancelled,
}

/// A list of steps with settings.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// For editors.
    #[serde(default, rename = "$schema")]
    pub schema: Option<String>,
    /// For people.
    #[serde(default)]
    pub description: String,
    /// Values that `{name}` stands for in steps, replaced by `--set name=value`. `null`: has to be set.
    #[serde(default)]
    pub settings: BTreeMap<String, Option<Value>>,
    /// In any order.
    pub steps: Vec<Step>,
}

/// Text, or a number as it is written.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// As it is.
    Text(String),
    /// 0.02 as `0.02`.
    Number(serde_json::Number),
}

impl Value {
    pub(super) fn text(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(number) => number.to_string(),
        }
    }
}

/// One command, run once, or once for each of several files, and for each of several frames.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Other steps know it by this.
    pub name: String,
    /// A command of surflux (`points`, `bake`, …), or `python`: a script and its arguments.
    pub command: String,
    /// As on the command line. `{{` and `}}` are braces.
    pub arguments: Vec<String>,
    /// What it is run for, one at a time: `{each}`, `{each.stem}`, `{each.name}`, `{each.folder}`.
    #[serde(default)]
    pub each: Option<Each>,
    /// Frames it is run for, one at a time, as `--frames` has them: `{frame}`, `{frame:04}`.
    #[serde(default)]
    pub frames: Option<String>,
    /// Files it reads besides those that a run of surflux tells of itself.
    #[serde(default)]
    pub inputs: Vec<String>,
    /// Files it writes; needed where other steps go on from them, and of scripts.
    #[serde(default)]
    pub outputs: Vec<String>,
    /// Steps that come first, besides those that write what it reads.
    #[serde(default)]
    pub after: Vec<String>,
    /// Memory it takes: `2GiB`. Without it: what it took the last time, or all there is.
    #[serde(default)]
    pub memory: Option<String>,
}

/// Where the files of a step come from.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
pub enum Each {
    /// A pattern: `assets/**/*.usd`.
    Pattern(String),
    /// Several.
    Patterns(Vec<String>),
    /// What another step writes.
    Step {
        /// Its name.
        step: String,
    },
}

/// Commands that steps can be.
pub(super) const COMMANDS: [&str; 9] = [
    "points", "bake", "render", "convert", "view", "info", "validate", "verify", PYTHON,
];

/// A step that is a script.
pub(super) const PYTHON: &str = "python";

impl Recipe {
    /// Read the recipe at `path`; `sets`: values that replace its own.
    ///
    /// # Errors
    /// Unreadable files, unknown keys, settings and steps that are not there, values that are missing.
    pub fn read(path: &Path, sets: &[(String, String)]) -> Result<Self, RecipeError> {
        let text = std::fs::read_to_string(path).map_err(|source| RecipeError::Read {
            path: path.to_path_buf(),
            source,
        })?;
        let mut recipe: Self =
            serde_json::from_str(&text).map_err(|source| RecipeError::Parse {
                path: path.to_path_buf(),
                source,
            })?;
        let wrong = |message: String| RecipeError::Meaning {
            path: path.to_path_buf(),
            message,
        };
        for (name, value) in sets {
            if !recipe.settings.contains_key(name) {
                let known: Vec<&str> = recipe.settings.keys().map(String::as_str).collect();
                let known = known.join(", ");
                return Err(wrong(format!(
                    "--set {name}: there is no such setting; there are {known}"
                )));
            }
            let value = Value::Text(value.clone());
            recipe.settings.insert(name.clone(), Some(value));
        }
        let missing: Vec<&str> = (recipe.settings.iter())
            .filter(|(_, value)| value.is_none())
            .map(|(name, _)| name.as_str())
            .collect();
        if let Some(first) = missing.first() {
            let message = format!("{} must be set: --set {first}=…", missing.join(", "));
            return Err(wrong(message));
        }
        recipe.check().map_err(wrong)?;
        Ok(recipe)
    }

    fn check(&self) -> Result<(), String> {
        let mut names = BTreeSet::new();
        for step in &self.steps {
            let name = &step.name;
            if !names.insert(name.as_str()) {
                return Err(format!("two steps are called `{name}`"));
            }
            if !COMMANDS.contains(&step.command.as_str()) {
                let known = COMMANDS.join(", ");
                let command = &step.command;
                return Err(format!(
                    "step `{name}`: there is no command `{command}`; there are {known}"
                ));
            }
        }
        for step in &self.steps {
            let of_each = step.each.iter().filter_map(|each| match each {
                Each::Step { step } => Some(step),
                _ => None,
            });
            for other in step.after.iter().chain(of_each) {
                if !names.contains(other.as_str()) {
                    let name = &step.name;
                    return Err(format!("step `{name}`: there is no step `{other}`"));
                }
            }
        }
        Ok(())
    }
}
