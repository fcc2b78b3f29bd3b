//! Log messages to stderr and, if asked, a file: as lines for people or as JSON objects.

use anyhow::Context;
use log::{Level, LevelFilter, Log, Metadata, Record};
use serde_json::json;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

/// Target of warnings of a run; the message is a [`crate::diagnostics::Warning`] as JSON. On the terminal they are grouped
/// at the end instead, where people read.
pub(super) const WARNING: &str = "surflux::warning";

/// Target of nothing: `log_enabled!` for it tells whether people read stderr.
pub(super) const PEOPLE: &str = "surflux::people";

struct Logger {
    file: Option<Mutex<File>>,
    terminal: LevelFilter,
    is_json: bool,
}

/// How to log.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LogSettings<'a> {
    /// Info, debug.
    pub(super) verbose: u8,
    /// Errors only.
    pub(super) quiet: bool,
    /// JSON objects, one a line.
    pub(super) is_json: bool,
    /// A file that gets all messages too.
    pub(super) file: Option<&'a Path>,
}

/// Install the logger: errors only when `quiet`, warnings by default, info and debug with `-v`, `-vv`.
///
/// # Errors
/// When the log file cannot be created.
pub(super) fn install(settings: &LogSettings<'_>) -> anyhow::Result<()> {
    let terminal = match (settings.quiet, settings.verbose) {
        (true, _) => LevelFilter::Error,
        (false, 0) => LevelFilter::Warn,
        (false, 1) => LevelFilter::Info,
        (false, _) => LevelFilter::Debug,
    };
    let open = |path: &Path| {
        File::create(path).with_context(|| format!("cannot create log file {}", path.display()))
    };
    let file = settings.file.map(open).transpose()?.map(Mutex::new);
    let level = if file.is_some() {
        terminal.max(LevelFilter::Info)
    } else {
        terminal
    };
    let is_json = settings.is_json;
    log::set_boxed_logger(Box::new(Logger {
        file,
        terminal,
        is_json,
    }))
    .context("logging was set up twice")?;
    log::set_max_level(level);
    Ok(())
}

/// True where stderr is read by people: grouped warnings and a summary belong there.
pub(super) fn is_for_people() -> bool {
    log::log_enabled!(target: PEOPLE, Level::Error)
}

impl Log for Logger {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        if metadata.target() == PEOPLE {
            return !self.is_json;
        }
        // Other crates' debug chatter is of no use to a TD.
        metadata.target().starts_with("surflux") || metadata.level() <= Level::Warn
    }

    fn log(&self, record: &Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        let line = match self.is_json {
            true => json_line(record),
            false => text_line(record),
        };
        let is_grouped = record.target() == WARNING && !self.is_json;
        if record.level() <= self.terminal && !is_grouped {
            // A closed terminal must not end the run: messages are a courtesy.
            let _ = writeln!(std::io::stderr(), "{line}");
        }
        if let Some(file) = &self.file {
            // A full disk must not end the run either.
            let _ = writeln!(
                file.lock().unwrap_or_else(PoisonError::into_inner),
                "{line}"
            );
        }
    }

    fn flush(&self) {}
}

/// The warning that a record of target [`WARNING`] carries.
fn carried(record: &Record<'_>) -> Option<serde_json::Value> {
    let is_warning = record.target() == WARNING;
    is_warning.then(|| serde_json::from_str(&record.args().to_string()).ok())?
}

fn text_line(record: &Record<'_>) -> String {
    let Some(warning) = carried(record) else {
        return format!("surflux: {}", record.args());
    };
    let part = |name: &str| warning[name].as_str().unwrap_or_default();
    let place = match part("prim") {
        "" => String::new(),
        prim => format!("{prim}: "),
    };
    format!(
        "surflux: warning: {}: {place}{}",
        part("kind"),
        part("message")
    )
}

/// `time` is in seconds since 1970.
fn json_line(record: &Record<'_>) -> String {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    let mut line = json!({
        "time": now.map_or(0.0, |now| now.as_secs_f64()),
        "level": record.level().as_str().to_lowercase(),
        "message": record.args().to_string(),
    });
    if let Some(serde_json::Value::Object(warning)) = carried(record) {
        for (name, value) in warning {
            line[name] = value;
        }
    }
    line.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_are_lines_with_their_prims() {
        let warning = r#"{"kind":"lost","prim":"/a","message":"gone"}"#;
        let args = format_args!("{warning}");
        let record = Record::builder()
            .target(WARNING)
            .level(Level::Warn)
            .args(args)
            .build();
        assert_eq!(text_line(&record), "surflux: warning: lost: /a: gone");
        let line: serde_json::Value = serde_json::from_str(&json_line(&record)).unwrap();
        assert_eq!(
            (&line["level"], &line["prim"]),
            (&json!("warn"), &json!("/a"))
        );
        assert_eq!(line["message"], "gone");
        assert!(line["time"].as_f64().unwrap() > 1e9);
    }
}
