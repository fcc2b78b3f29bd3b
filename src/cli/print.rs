//! What a run tells at its end.

use super::log_sink;
use crate::diagnostics::Warning;
use crate::pipeline::Report;
use std::collections::BTreeMap;

/// Prims named for each kind of warning on the terminal; `--json` and `--log-file` have all.
const SHOWN_PER_KIND: usize = 4;

/// Statistics on stdout (`json`) or a summary on stderr; warnings grouped at the end.
pub(super) fn report(report: &Report, json: bool, quiet: bool) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string_pretty(report)?);
    }
    if quiet {
        return Ok(());
    }
    if !json && log_sink::is_for_people() {
        summary(report);
    }
    warnings(&report.warnings);
    Ok(())
}

fn summary(report: &Report) {
    if let Some(sizes) = sizes(report) {
        eprintln!("{sizes}");
    }
    let seconds = &report.seconds;
    let phases = [
        ("read", seconds.read),
        ("points", seconds.points),
        ("octree", seconds.octree),
        ("gather", seconds.gather),
        ("write", seconds.write),
        ("pictures", seconds.pictures),
    ];
    let phases = phases.iter().filter(|(_, seconds)| *seconds > 0.0);
    let phases: Vec<String> = phases
        .map(|(name, seconds)| format!("{name} {seconds:.2}"))
        .collect();
    eprintln!(
        "{:.2} s{}{}{}",
        seconds.total,
        if phases.is_empty() { "" } else { ": " },
        phases.join(", "),
        report
            .peak_memory_bytes
            .map(|bytes| format!("; peak memory {}", human_bytes(bytes)))
            .unwrap_or_default(),
    );
    if let Some(estimate) = report.error.estimate {
        eprintln!(
            "estimated error {:.2} % ({})",
            100.0 * estimate,
            report.error.method
        );
    }
    for output in &report.outputs {
        eprintln!("wrote {}", output.display());
    }
}

/// What there was, as far as the job has it: `view` has no receivers and no engine, a dry run nothing.
fn sizes(report: &Report) -> Option<String> {
    let counts = &report.counts;
    let sizes = [
        (counts.prims, "prims"),
        (counts.triangles, "triangles"),
        (counts.surfels, "surfels"),
        (counts.receivers, "receivers"),
    ];
    let sizes = sizes.iter().filter(|(count, _)| *count > 0);
    let parts: Vec<String> = sizes
        .map(|(count, what)| format!("{count} {what}"))
        .collect();
    if parts.is_empty() {
        return None;
    }
    let engine = report.settings.get("gather").and_then(|name| name.as_str());
    let how: Vec<String> = [
        (!report.usd.is_empty()).then(|| report.usd.clone()),
        engine.map(|name| format!("engine {name}")),
    ]
    .into_iter()
    .flatten()
    .collect();
    Some(match how.is_empty() {
        true => parts.join(", "),
        false => format!("{} ({})", parts.join(", "), how.join(", ")),
    })
}

/// `warnings` to the log, each; grouped by kind on stderr where people read.
pub(super) fn warnings(warnings: &[Warning]) {
    let mut kinds: BTreeMap<&str, Vec<&Warning>> = BTreeMap::new();
    for warning in warnings {
        if let Ok(line) = serde_json::to_string(warning) {
            log::warn!(target: log_sink::WARNING, "{line}");
        }
        kinds.entry(&warning.kind).or_default().push(warning);
    }
    if !log_sink::is_for_people() {
        return;
    }
    for (kind, group) in kinds {
        eprintln!("warning: {kind} ({})", group.len());
        for warning in group.iter().take(SHOWN_PER_KIND) {
            eprintln!(
                "  {}{}{}",
                warning.prim,
                if warning.prim.is_empty() { "" } else { ": " },
                warning.message
            );
        }
        if group.len() > SHOWN_PER_KIND {
            eprintln!(
                "  … and {} more (all in --json)",
                group.len() - SHOWN_PER_KIND
            );
        }
    }
}

/// Bytes with a binary unit and three digits.
pub(super) fn human_bytes(bytes: u64) -> String {
    let units = [(1_u64 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")];
    match units.into_iter().find(|(size, _)| bytes >= *size) {
        Some((size, unit)) => format!("{:.1} {unit}", bytes as f64 / size as f64),
        None => format!("{bytes} B"),
    }
}

#[cfg(test)]
mod tests {
    use crate::pipeline::Report;

    #[test]
    fn only_what_a_job_has_is_told() {
        let told = |report: &Report| super::sizes(report).unwrap_or_default();
        let mut report = Report::new(&[]);
        assert_eq!(super::sizes(&report), None);
        report.counts.surfels = 7;
        report.usd = "native".to_owned();
        assert_eq!(told(&report), "7 surfels (native)");
        report.counts.receivers = 3;
        report.set("gather", "rays");
        assert_eq!(
            told(&report),
            "7 surfels, 3 receivers (native, engine rays)"
        );
    }

    #[test]
    fn bytes_are_told_in_binary_units() {
        assert_eq!(super::human_bytes(512), "512 B");
        assert_eq!(super::human_bytes(3 << 29), "1.5 GiB");
    }
}
