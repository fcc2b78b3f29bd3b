//! `surflux verify` on the terminal.

use super::print;
use crate::verify::{TruthSummary, VerifyReport};

/// JSON or a Markdown table on stdout, warnings on stderr.
pub(super) fn print(report: &VerifyReport, json: bool, quiet: bool) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string_pretty(report)?);
    } else {
        for truth in &report.truth {
            table(report, truth);
        }
    }
    if !quiet {
        print::warnings(&report.warnings);
    }
    Ok(())
}

fn table(report: &VerifyReport, truth: &TruthSummary) {
    println!(
        "{} at {} ({} of {} receivers; truth's standard error {:.3} %)\n",
        truth.aov,
        truth.set,
        truth.receivers,
        truth.population,
        100.0 * truth.standard_error
    );
    println!("| engine | settings | µs | relRMSE % | bias % | p99 % | max % | |");
    println!("|---|---|---:|---:|---:|---:|---:|---|");
    let rows = report.rows.iter();
    for row in rows.filter(|row| row.set == truth.set && row.aov == truth.aov) {
        let auto = row.auto.map_or(String::new(), |auto| {
            format!(
                "auto {} %: estimate {:.2} %, pilot {:.1} µs",
                100.0 * auto.tolerance,
                100.0 * auto.estimate.unwrap_or(0.0),
                auto.pilot_microseconds
            )
        });
        let bad = match row.error.non_finite {
            0 => String::new(),
            count => format!("{count} not finite "),
        };
        println!(
            "| {} | {} | {:.2} | {:.3} | {:+.3} | {:.2} | {:.2} | {bad}{auto} |",
            row.engine,
            row.settings_text(),
            row.microseconds,
            100.0 * row.error.relative_rmse,
            100.0 * row.error.bias,
            100.0 * row.error.p99,
            100.0 * row.error.max
        );
    }
    println!();
}
