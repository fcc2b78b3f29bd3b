//! The command line: arguments as typed → a job as meant → exit code.
#![expect(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "this module is what talks to the terminal"
)]

mod about;
mod args;
pub mod frames;
mod info;
mod job;
mod log_sink;
mod print;
pub mod progress;
mod run;
mod validate;
mod variables;
mod verify;

use crate::diagnostics::{CancelToken, Diagnostics};
use crate::pipeline;
use args::{Cli, Command, StageArgs};
use clap::FromArgMatches;
use std::process::ExitCode;

/// Exit code of a run that failed.
const FAILED: u8 = 1;
/// Exit code of a command line that makes no sense.
const USAGE: u8 = 2;

/// Run the program with the process's own arguments.
pub fn main() -> ExitCode {
    quiet_reader();
    let command_line: Vec<String> = std::env::args().collect();
    let typed = Cli::from_arg_matches(&variables::command().get_matches());
    let command = match typed.unwrap_or_else(|error| error.exit()).command {
        Command::Job(command) => command,
        Command::Run(args) => return exit_code(run::run(args)),
        Command::Completions { shell } => return exit_code(about::completions(shell)),
        Command::Man { folder } => return exit_code(about::manual(&folder)),
    };
    let stage = command.stage().clone_settings();
    if let Err(error) = log_sink::install(stage.verbose, stage.quiet, stage.log_file.as_deref()) {
        eprintln!("surflux: {error:#}");
        return ExitCode::from(FAILED);
    }
    let job = match job::from_args(command, &command_line) {
        Ok(job) => job,
        Err(usage) => {
            eprintln!("surflux: {usage:#}\n\nFor more information, try '--help'.");
            return ExitCode::from(USAGE);
        }
    };
    exit_code(run(&job, &stage))
}

fn exit_code(result: anyhow::Result<()>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("surflux: {error:#}");
            ExitCode::from(FAILED)
        }
    }
}

/// The native reader turns panics of the `openusd` crate into errors: nobody should see them twice.
fn quiet_reader() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let thread = std::thread::current();
        if thread.name() == Some(crate::stage::native::THREAD_NAME) {
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
        }
    }
}

fn run(job: &pipeline::Job, settings: &RunSettings) -> anyhow::Result<()> {
    let cancel = CancelToken::default();
    cancel_on_signal(&cancel)?;
    rayon::ThreadPoolBuilder::new()
        .num_threads(settings.threads)
        .build_global()?;
    let diagnostics = Diagnostics::new(progress::sink(settings.progress), cancel);
    if let pipeline::Job::Info(stage) = job {
        let info = pipeline::info(stage, &diagnostics)?;
        return info::print(&info, settings.json);
    }
    if let pipeline::Job::Validate(file) = job {
        let report = pipeline::validate(file, &diagnostics)?;
        return validate::print(&report, settings.json, settings.quiet);
    }
    if let pipeline::Job::Verify(job) = job {
        let report = pipeline::verify(job, &diagnostics)?;
        return verify::print(&report, settings.json, settings.quiet);
    }
    match pipeline::run(job, &diagnostics) {
        Ok(report) => print::report(&report, settings.json, settings.quiet),
        Err(error) => {
            if !settings.quiet {
                print::warnings(&diagnostics.warnings());
            }
            Err(error.into())
        }
    }
}

/// Ctrl-C and the like ask the run to end, which leaves nothing behind; the second time the process ends at once: what
/// does not look at the token, as a library in an endless loop, cannot be asked.
fn cancel_on_signal(cancel: &CancelToken) -> Result<(), ctrlc::Error> {
    let cancel = cancel.clone();
    ctrlc::set_handler(move || {
        if cancel.is_cancelled() {
            std::process::exit(1);
        }
        cancel.cancel();
    })
}
