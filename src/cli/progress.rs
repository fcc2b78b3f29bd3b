//! Progress on stderr: a bar on a terminal, plain lines, JSON lines, or `OpenJD` messages.

use crate::diagnostics::{ProgressSink, Silent};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What `--progress` says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum ProgressMode {
    /// A bar when stderr is a terminal, nothing otherwise.
    #[default]
    Auto,
    /// A line a phase and every few seconds.
    Plain,
    /// One JSON object a line.
    Json,
    /// `openjd_progress:` and `openjd_status:` lines on stdout, as farms read them.
    Openjd,
    /// Nothing.
    None,
}

/// A line at most this often in the line modes.
const LINE_INTERVAL: Duration = Duration::from_secs(2);

/// The sink for `mode`.
pub fn sink(mode: ProgressMode) -> Box<dyn ProgressSink> {
    match mode {
        ProgressMode::Auto if std::io::stderr().is_terminal() => Box::new(Bar::default()),
        ProgressMode::Auto | ProgressMode::None => Box::new(Silent),
        ProgressMode::Plain => Box::new(Lines::new(LineStyle::Plain)),
        ProgressMode::Json => Box::new(Lines::new(LineStyle::Json)),
        ProgressMode::Openjd => Box::new(Lines::new(LineStyle::OpenJd)),
    }
}

/// A terminal bar with rate and time left.
#[derive(Default)]
struct Bar(Mutex<Option<ProgressBar>>);

impl ProgressSink for Bar {
    fn begin(&self, phase: &str, unit: &str, total: u64) {
        let bar = if total == 0 {
            ProgressBar::new_spinner()
        } else {
            ProgressBar::new(total)
        };
        let template = if total == 0 {
            "{prefix:>8} {spinner} {elapsed}".to_owned()
        } else {
            format!(
                "{{prefix:>8}} [{{bar:40}}] {{percent:>3}} % {{human_pos}} {unit}, {{per_sec}}, {{eta}} left"
            )
        };
        bar.set_style(
            ProgressStyle::with_template(&template)
                .unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        bar.set_prefix(phase.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(bar);
    }

    fn advance(&self, done: u64) {
        if let Some(bar) = &*self.0.lock().unwrap_or_else(PoisonError::into_inner) {
            bar.set_position(done);
        }
    }

    fn end(&self) {
        if let Some(bar) = self.0.lock().unwrap_or_else(PoisonError::into_inner).take() {
            bar.finish_and_clear();
        }
    }
}

#[derive(Clone, Copy)]
enum LineStyle {
    Plain,
    Json,
    OpenJd,
}

struct Running {
    phase: String,
    unit: String,
    total: u64,
    done: u64,
    start: Instant,
    last_line: Instant,
}

/// Lines at intervals.
struct Lines {
    style: LineStyle,
    running: Mutex<Option<Running>>,
}

impl Lines {
    fn new(style: LineStyle) -> Self {
        Self {
            style,
            running: Mutex::new(None),
        }
    }

    fn line(&self, running: &Running, ended: bool) {
        let text = match self.style {
            LineStyle::Plain => plain_line(running, ended),
            LineStyle::Json => json_line(running, ended),
            LineStyle::OpenJd => openjd_line(running, ended),
        };
        // A closed pipe must not end the run: progress is a courtesy.
        let _ = match self.style {
            LineStyle::OpenJd => writeln!(std::io::stdout(), "{text}"),
            LineStyle::Plain | LineStyle::Json => writeln!(std::io::stderr(), "{text}"),
        };
    }
}

impl ProgressSink for Lines {
    fn begin(&self, phase: &str, unit: &str, total: u64) {
        let now = Instant::now();
        let running = Running {
            phase: phase.to_owned(),
            unit: unit.to_owned(),
            total,
            done: 0,
            start: now,
            last_line: now,
        };
        self.line(&running, false);
        *self.running.lock().unwrap_or_else(PoisonError::into_inner) = Some(running);
    }

    fn advance(&self, done: u64) {
        let mut guard = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(running) = guard.as_mut() else {
            return;
        };
        running.done = running.done.max(done);
        if running.last_line.elapsed() >= LINE_INTERVAL {
            running.last_line = Instant::now();
            self.line(running, false);
        }
    }

    fn end(&self) {
        if let Some(running) = self
            .running
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
        {
            self.line(&running, true);
        }
    }
}

fn plain_line(running: &Running, ended: bool) -> String {
    let Running {
        phase,
        unit,
        total,
        done,
        start,
        ..
    } = running;
    let seconds = start.elapsed().as_secs_f64();
    match (ended, *total) {
        (true, _) => format!("{phase}: done, {seconds:.2} s"),
        (false, 0) => format!("{phase} …"),
        (false, _) => format!("{phase}: {done} of {total} {unit}, {seconds:.0} s"),
    }
}

fn json_line(running: &Running, ended: bool) -> String {
    serde_json::json!({
        "phase": running.phase, "unit": running.unit, "total": running.total, "done": running.done,
        "seconds": running.start.elapsed().as_secs_f64(), "ended": ended,
    })
    .to_string()
}

fn openjd_line(running: &Running, ended: bool) -> String {
    if !ended && running.done == 0 {
        return format!("openjd_status: {}", running.phase);
    }
    let fraction = if ended || running.total == 0 {
        1.0
    } else {
        running.done as f64 / running.total as f64
    };
    format!("openjd_progress: {:.1}", 100.0 * fraction.min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_say_phase_amount_and_end() {
        let now = Instant::now();
        let running = Running {
            phase: "gather".into(),
            unit: "receivers".into(),
            total: 200,
            done: 50,
            start: now,
            last_line: now,
        };
        assert_eq!(
            plain_line(&running, false),
            "gather: 50 of 200 receivers, 0 s"
        );
        assert_eq!(openjd_line(&running, false), "openjd_progress: 25.0");
        let json: serde_json::Value = serde_json::from_str(&json_line(&running, true)).unwrap();
        assert_eq!(
            (json["done"].as_u64(), json["ended"].as_bool()),
            (Some(50), Some(true))
        );
    }
}
