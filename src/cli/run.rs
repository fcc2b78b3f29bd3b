//! `surflux run`: what is heard of a recipe while it runs, and its end.

use super::args::HabitArgs;
use super::frames::Frames;
use super::log_sink::{self, LogSettings};
use crate::diagnostics::{Diagnostics, Silent};
use crate::recipes::{self, RecipeError, RunRecipeJob, State, TaskReport};
use crate::stage::worker;
use anyhow::Context;
use clap::Args;
use std::io::Write;
use std::path::PathBuf;

/// What `run` is told.
#[derive(Debug, Args)]
pub(super) struct RunArgs {
    /// The recipe (schemas/recipe.schema.json; ready ones are in pipelines/).
    recipe: PathBuf,
    /// Replace one of its settings; many times.
    #[arg(long, value_name = "NAME=VALUE", value_parser = setting)]
    set: Vec<(String, String)>,
    /// What earlier runs did. Default: the recipe's name with .manifest.json, in the current folder.
    #[arg(long, value_name = "FILE")]
    manifest: Option<PathBuf>,
    /// Go on after a crash: what was finished and is there is not looked at again.
    #[arg(long)]
    resume: bool,
    /// Run what is up to date too.
    #[arg(long, conflicts_with = "resume")]
    force: bool,
    /// Tell what would be run, run nothing.
    #[arg(long)]
    dry_run: bool,
    /// Tasks at a time, at most; they share the threads.
    #[arg(long, value_name = "N", default_value_t = 1)]
    jobs: usize,
    /// Memory of all tasks at a time (4GiB). One that nobody knows about runs alone.
    #[arg(long, value_name = "BYTES", value_parser = recipes::parse_bytes)]
    memory: Option<u64>,
    /// Threads of all tasks at a time; 0 = one a core.
    #[arg(long, default_value_t = 0, env = "SURFLUX_THREADS")]
    threads: usize,
    /// What was done as JSON on stdout.
    #[arg(long)]
    json: bool,
    /// Errors only.
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    pub(super) habits: HabitArgs,
}

impl RunArgs {
    /// Begin to log.
    pub(super) fn log(&self, habits: &HabitArgs) -> anyhow::Result<()> {
        log_sink::install(&LogSettings {
            quiet: self.quiet,
            is_json: habits.log_json || self.habits.log_json,
            ..LogSettings::default()
        })
    }
}

/// Run a recipe with all its steps.
pub(super) fn run(args: RunArgs) -> anyhow::Result<()> {
    let diagnostics = Diagnostics::new(Box::new(Silent), super::cancel_on_signal()?);
    let frames = |text: &str| -> Result<Vec<f64>, String> {
        let frames: Frames = text.parse().map_err(|error| format!("{error}"))?;
        Ok(frames.0)
    };
    let (json, quiet) = (args.json, args.quiet);
    let mut tell = |task: &TaskReport| {
        if !log_sink::is_for_people() {
            log::warn!("{}", line(task));
        } else if !quiet {
            // A closed terminal ends nothing that is under way.
            let _ = writeln!(std::io::stderr(), "{}", line(task));
        }
    };
    let report = recipes::run(&job(args)?, &frames, &mut tell, &diagnostics)?;
    if json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else if !quiet && log_sink::is_for_people() {
        let count = |state| report.count(state);
        let parts = [
            (count(State::Due), "would be run"),
            (count(State::Done), "done"),
            (count(State::UpToDate), "up to date"),
            (count(State::Failed), "failed"),
            (count(State::LeftOut), "left out"),
        ];
        let parts = parts.iter().filter(|(count, _)| *count > 0);
        let parts: Vec<String> = parts
            .map(|(count, what)| format!("{count} {what}"))
            .collect();
        eprintln!("{} in {:.1} s", parts.join(", "), report.seconds);
    }
    let failed = report.count(State::Failed);
    if failed > 0 {
        return Err(RecipeError::Failed {
            failed,
            all: report.tasks.len(),
            skipped: report.count(State::LeftOut),
        }
        .into());
    }
    Ok(())
}

fn job(args: RunArgs) -> anyhow::Result<RunRecipeJob> {
    let name = args.recipe.file_stem().unwrap_or_default();
    let manifest = args.manifest.unwrap_or_else(|| {
        let mut file = name.to_os_string();
        file.push(".manifest.json");
        PathBuf::from(file)
    });
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let program = std::env::current_exe().context("where this program lies is not known")?;
    Ok(RunRecipeJob {
        command: std::env::args_os()
            .map(|word| word.to_string_lossy().into_owned())
            .collect(),
        recipe: args.recipe,
        sets: args.set,
        manifest,
        resume: args.resume,
        force: args.force,
        dry_run: args.dry_run,
        jobs: args.jobs,
        memory: args.memory,
        threads: if args.threads > 0 {
            args.threads
        } else {
            threads
        },
        program,
        python: worker::python(),
    })
}

/// One line about a task that is over; more where it failed.
fn line(task: &TaskReport) -> String {
    let state = match task.state {
        State::Due => "would run",
        State::UpToDate => "up to date",
        State::Done => "done",
        State::Failed => "FAILED",
        State::LeftOut => "left out",
    };
    let mut line = format!("{state:<10} {}", task.step);
    if !task.label.is_empty() {
        line += &format!(" ({})", task.label);
    }
    if task.state == State::Done {
        line += &format!(", {:.1} s", task.seconds);
    }
    if task.state == State::Due {
        line += &format!(": {}", task.command.join(" "));
    }
    if !task.warnings.is_empty() {
        line += &format!(", {} warnings (in --json)", task.warnings.len());
    }
    for more in task.error.iter().flat_map(|error| error.lines()) {
        line += &format!("\n    {more}");
    }
    line
}

/// `name=value`.
fn setting(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("name=value is needed")?;
    Ok((name.trim().to_owned(), value.to_owned()))
}
