//! `surflux validate` as a table.

use super::print;
use crate::pipeline::ValidationReport;
use crate::stage::validate::{Kind, Severity};
use anyhow::bail;

/// Findings listed of each file; `--json` has all.
const LISTED: usize = 40;

/// The verdict on stdout, as JSON or as a table; an error if the file has any.
pub(super) fn print(report: &ValidationReport, json: bool, quiet: bool) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string_pretty(report)?);
    } else if !quiet {
        table(report);
        print::warnings(&report.composition);
    }
    if report.errors > 0 {
        bail!("{}: {} errors", report.file.display(), report.errors);
    }
    Ok(())
}

fn table(report: &ValidationReport) {
    let kind = match report.kind {
        Kind::Cloud => "cloud",
        Kind::Bake => "bake",
    };
    let shown_in = report.stage.as_ref();
    let shown_in = shown_in.map_or(String::new(), |stage| format!(" in {}", stage.display()));
    println!("{} ({kind}{shown_in})", report.layer.display());
    println!(
        "  {:<14} {:>12} {:>7} {:>9}",
        "check", "looked at", "errors", "warnings"
    );
    for check in &report.checks {
        let looked_at = match check.looked_at {
            0 => "-".to_owned(),
            count => count.to_string(),
        };
        println!(
            "  {:<14} {looked_at:>12} {:>7} {:>9}",
            check.check.name(),
            check.errors,
            check.warnings
        );
    }
    let nobody = "none (they take --usd usd-core)".to_owned();
    println!(
        "  validators of USD: {}",
        report.validators.as_ref().unwrap_or(&nobody)
    );
    for finding in report.findings.iter().take(LISTED) {
        let severity = match finding.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        println!(
            "{severity}: {}: {}: {}",
            finding.check.name(),
            finding.place,
            finding.message
        );
    }
    if report.findings.len() > LISTED {
        println!(
            "… and {} more (all in --json)",
            report.findings.len() - LISTED
        );
    }
    if report.errors == 0 {
        println!("valid, {} warnings", report.warnings);
    }
}
