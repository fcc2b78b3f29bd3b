//! The command line: arguments as typed → a job as meant → exit code.
#![expect(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "this module is what talks to the terminal"
)]

mod about;
mod args;
mod config;
pub mod frames;
mod info;
mod job;
mod layers;
mod log_sink;
mod print;
pub mod progress;
mod run;
mod shot;
mod validate;
mod values;
mod variables;
mod verify;

use crate::diagnostics::{CancelToken, Diagnostics};
use crate::pipeline;
use crate::stage::Source;
use args::{Cli, Command, HabitArgs, StageArgs};
use clap::{ArgMatches, FromArgMatches};
use log_sink::LogSettings;
use std::ffi::OsString;
use std::process::ExitCode;

/// Exit code of a run that failed.
const FAILED: u8 = 1;
/// Exit code of a command line that makes no sense.
const USAGE: u8 = 2;

/// Run the program with the process's own arguments.
pub fn main() -> ExitCode {
    quiet_reader();
    let argv: Vec<OsString> = std::env::args_os().collect();
    let mut program = variables::command();
    program.build();
    let typed = program.try_get_matches_from_mut(&argv);
    let typed = typed.unwrap_or_else(|error| error.exit());
    let failure = match begin(&mut program, &argv, &typed) {
        Ok(()) => return ExitCode::SUCCESS,
        Err(failure) => failure,
    };
    let advice = match failure.code {
        USAGE if log_sink::is_for_people() => "\n\nFor more information, try '--help'.",
        _ => "",
    };
    log::error!("{:#}{advice}", failure.error);
    ExitCode::from(failure.code)
}

/// Why the program ends with another code than 0.
struct Failure {
    code: u8,
    error: anyhow::Error,
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self {
            code: FAILED,
            error,
        }
    }
}

fn usage(error: anyhow::Error) -> Failure {
    Failure { code: USAGE, error }
}

fn begin(
    program: &mut clap::Command,
    argv: &[OsString],
    typed: &ArgMatches,
) -> Result<(), Failure> {
    let name = typed.subcommand_name().unwrap_or_default().to_owned();
    let parsed = meant(typed)?;
    let Some(habits) = parsed.habits().cloned() else {
        log_sink::install(&LogSettings::default())?;
        return match parsed {
            Command::Completions { shell } => Ok(about::completions(shell)?),
            Command::Man { folder } => Ok(about::manual(&folder)?),
            Command::Job(_) | Command::Run(_) => unreachable!("these have habits"),
        };
    };
    let config = match &habits.config {
        Some(path) => config::read(path, program, &name),
        None => Ok(Default::default()),
    };
    let config = config.map_err(|error| early(&habits, usage(error)))?;
    let layers: [&[layers::Opinion]; 2] = config.each_ref().map(Vec::as_slice);
    let resolved = layers::resolve(program, argv, typed, &layers);
    let resolved = resolved.map_err(|error| early(&habits, usage(error)))?;
    match meant(&resolved.matches)? {
        Command::Run(args) => {
            args.log(&habits)?;
            tell_or(program, &habits, &resolved, || run::run(args))
        }
        Command::Job(command) => {
            let settings = command.stage().clone_settings();
            settings.log()?;
            start_threads(&settings)?;
            let cancel = cancel_on_signal()?;
            let asked = shot::Asked {
                program,
                argv,
                typed,
                config: &layers,
                cancel: &cancel,
            };
            let shot = asked.resolve(command, resolved)?;
            if settings.habits.print_config {
                return shown(program, &shot.resolved);
            }
            Ok(run(
                shot.job.map_err(usage)?,
                shot.source,
                &settings,
                cancel,
            )?)
        }
        Command::Completions { .. } | Command::Man { .. } => Ok(()),
    }
}

/// Log as far as it is known how, and hand on what went wrong.
fn early(habits: &HabitArgs, failure: Failure) -> Failure {
    let settings = LogSettings {
        is_json: habits.log_json,
        ..LogSettings::default()
    };
    match log_sink::install(&settings) {
        Ok(()) => failure,
        Err(error) => error.into(),
    }
}

fn meant(matches: &ArgMatches) -> anyhow::Result<Command> {
    Ok(Cli::from_arg_matches(matches)
        .unwrap_or_else(|error| error.exit())
        .command)
}

fn tell_or(
    program: &clap::Command,
    habits: &HabitArgs,
    resolved: &layers::Resolved,
    work: impl FnOnce() -> anyhow::Result<()>,
) -> Result<(), Failure> {
    if habits.print_config {
        return shown(program, resolved);
    }
    Ok(work()?)
}

/// `--print-config`.
fn shown(program: &clap::Command, resolved: &layers::Resolved) -> Result<(), Failure> {
    if let Some((name, matches)) = resolved.matches.subcommand()
        && let Some(command) = program.find_subcommand(name)
    {
        println!("{}", config::told(command, matches, &resolved.places));
    }
    Ok(())
}

/// Readers turn panics of the crates `openusd` and `las` into errors: nobody should see them twice.
fn quiet_reader() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let thread = std::thread::current();
        let readers = [
            crate::stage::native::THREAD_NAME,
            crate::exchange::las::THREAD_NAME,
        ];
        if thread.name().is_some_and(|name| readers.contains(&name)) {
            log::debug!("{panic}");
        } else {
            usual(panic);
        }
    }));
}

/// Settings of the run itself, apart from its job.
struct RunSettings {
    threads: usize,
    progress: progress::ProgressMode,
    json: bool,
    verbose: u8,
    quiet: bool,
    log_file: Option<std::path::PathBuf>,
    habits: HabitArgs,
}

impl RunSettings {
    fn log(&self) -> anyhow::Result<()> {
        log_sink::install(&LogSettings {
            verbose: self.verbose,
            quiet: self.quiet,
            is_json: self.habits.log_json,
            file: self.log_file.as_deref(),
        })
    }
}

/// Threads of everything that is computed in parallel.
fn start_threads(settings: &RunSettings) -> anyhow::Result<()> {
    let threads = rayon::ThreadPoolBuilder::new().num_threads(settings.threads);
    Ok(threads.build_global()?)
}

impl StageArgs {
    fn clone_settings(&self) -> RunSettings {
        RunSettings {
            threads: self.threads,
            progress: if self.quiet {
                progress::ProgressMode::None
            } else {
                self.progress
            },
            json: self.json,
            verbose: self.verbose,
            quiet: self.quiet,
            log_file: self.log_file.clone(),
            habits: self.habits.clone(),
        }
    }
}

/// Cancelled by the first signal that asks the program to end, which leaves nothing behind; the second ends the process at
/// once: what does not look at the token, as a library in an endless loop, cannot be asked.
fn cancel_on_signal() -> anyhow::Result<CancelToken> {
    let cancel = CancelToken::default();
    let on_signal = cancel.clone();
    ctrlc::set_handler(move || {
        if on_signal.is_cancelled() {
            std::process::exit(1);
        }
        on_signal.cancel();
    })?;
    Ok(cancel)
}

/// Do `job`; `source` is its stage where it is open already.
fn run(
    job: pipeline::Job,
    source: Option<Box<dyn Source>>,
    settings: &RunSettings,
    cancel: CancelToken,
) -> anyhow::Result<()> {
    let diagnostics = Diagnostics::new(progress::sink(settings.progress), cancel);
    if let pipeline::Job::Info(stage) = &job {
        let info = pipeline::info(stage, &diagnostics)?;
        return info::print(&info, settings.json);
    }
    if let pipeline::Job::Validate(file) = &job {
        let report = pipeline::validate(file, &diagnostics)?;
        return validate::print(&report, settings.json, settings.quiet);
    }
    if let pipeline::Job::Verify(job) = &job {
        let report = pipeline::verify(job, &diagnostics)?;
        return verify::print(&report, settings.json, settings.quiet);
    }
    match pipeline::run_opened(&job, source, &diagnostics) {
        Ok(report) => print::report(&report, settings.json, settings.quiet),
        Err(error) => {
            if !settings.quiet {
                print::warnings(&diagnostics.warnings());
            }
            Err(error.into())
        }
    }
}
