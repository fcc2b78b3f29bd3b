//! `surflux validate`: what is wrong with a cloud or a bake.

use super::{Error, StageJob};
use crate::diagnostics::{Diagnostics, Warning};
use crate::stage::validate::{self, Check, Finding, Kind, Severity};
use serde::Serialize;
use std::path::PathBuf;

/// The verdict on one file, as `--json` prints it (`schemas/validate.schema.json`).
#[derive(Debug, Clone, Serialize)]
pub struct ValidationReport {
    /// Version of surflux.
    pub surflux: &'static str,
    /// The command line.
    pub command: Vec<String>,
    /// The file as given.
    pub file: PathBuf,
    /// `cloud` or `bake`.
    pub kind: Kind,
    /// The layer of values: the file itself, or what it sublayers.
    pub layer: PathBuf,
    /// The stage that a bake was composed in.
    pub stage: Option<PathBuf>,
    /// Pixar's validators, if they were asked.
    pub validators: Option<String>,
    /// One entry a check, in a fixed order.
    pub checks: Vec<CheckSummary>,
    /// Everything that is wrong, errors first.
    pub findings: Vec<Finding>,
    /// Number of errors: the exit code is 1 if there are any.
    pub errors: usize,
    /// Number of warnings among the findings.
    pub warnings: usize,
    /// What USD warned of while it composed the stage.
    pub composition: Vec<Warning>,
}

/// What one check looked at and found.
#[derive(Debug, Clone, Serialize)]
pub struct CheckSummary {
    /// Which.
    pub check: Check,
    /// Values (or prims, attributes, rules) looked at.
    pub looked_at: usize,
    /// Errors found.
    pub errors: usize,
    /// Warnings found.
    pub warnings: usize,
}

/// Look at the file of `job`.
///
/// # Errors
/// When it cannot be read, or is neither a cloud nor a bake; what is wrong inside is in the report.
pub fn validate(job: &StageJob, diagnostics: &Diagnostics) -> Result<ValidationReport, Error> {
    let phase = diagnostics.phase("read", "file", 0);
    let found = validate::validate(&job.path, job.door, diagnostics)?;
    drop(phase);
    let of = |severity, check: Option<Check>| {
        let findings = found.findings.iter();
        let matching = findings.filter(|finding| {
            finding.severity == severity && check.is_none_or(|check| finding.check == check)
        });
        matching.count()
    };
    let checks = Check::ALL.map(|check| CheckSummary {
        check,
        looked_at: found.looked_at.get(&check).copied().unwrap_or(0),
        errors: of(Severity::Error, Some(check)),
        warnings: of(Severity::Warning, Some(check)),
    });
    Ok(ValidationReport {
        surflux: env!("CARGO_PKG_VERSION"),
        command: job.command.clone(),
        file: job.path.clone(),
        kind: found.kind,
        layer: found.layer.clone(),
        stage: found.stage.clone(),
        validators: found.validators.clone(),
        checks: checks.to_vec(),
        errors: of(Severity::Error, None),
        warnings: of(Severity::Warning, None),
        findings: found.findings,
        composition: diagnostics.warnings(),
    })
}
