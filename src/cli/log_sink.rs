//! Log messages to stderr and, if asked, a file.

use anyhow::Context;
use log::{Level, LevelFilter, Log, Metadata, Record};
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

struct Logger {
    file: Option<Mutex<File>>,
    terminal: LevelFilter,
}

/// Install the logger: errors only when `quiet`, warnings by default, info and debug with `-v`, `-vv`.
///
/// # Errors
/// When the log file cannot be created.
pub(super) fn install(verbose: u8, quiet: bool, file: Option<&Path>) -> anyhow::Result<()> {
    let terminal = match (quiet, verbose) {
        (true, _) => LevelFilter::Error,
        (false, 0) => LevelFilter::Warn,
        (false, 1) => LevelFilter::Info,
        (false, _) => LevelFilter::Debug,
    };
    let open = |path: &Path| {
        File::create(path).with_context(|| format!("cannot create log file {}", path.display()))
    };
    let file = file.map(open).transpose()?.map(Mutex::new);
    let level = if file.is_some() {
        terminal.max(LevelFilter::Info)
    } else {
        terminal
    };
    log::set_boxed_logger(Box::new(Logger { file, terminal }))
        .context("logging was set up twice")?;
    log::set_max_level(level);
    Ok(())
}

impl Log for Logger {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        // Other crates' debug chatter is of no use to a TD.
        metadata.target().starts_with("surflux") || metadata.level() <= Level::Warn
    }

    fn log(&self, record: &Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let line = format!("surflux: {}", record.args());
        if record.level() <= self.terminal {
            eprintln!("{line}");
        }
        if let Some(file) = &self.file {
            // A full disk must not end the run: the log is a courtesy.
            let _ = writeln!(
                file.lock().unwrap_or_else(PoisonError::into_inner),
                "{line}"
            );
        }
    }

    fn flush(&self) {}
}
