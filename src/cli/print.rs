//! What a run tells at its end.

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
    if !json {
        summary(report);
    }
    warnings(&report.warnings);
    Ok(())
}

fn summary(report: &Report) {
    let counts = &report.counts;
    let seconds = &report.seconds;
    eprintln!(
        "{} prims, {} triangles, {} surfels, {} receivers ({}, engine {})",
        counts.prims,
        counts.triangles,
        counts.surfels,
        counts.receivers,
        report.usd,
        report
            .settings
            .get("gather")
            .and_then(|name| name.as_str())
            .unwrap_or("none"),
    );
    eprintln!(
        "{:.2} s: read {:.2}, points {:.2}, octree {:.2}, gather {:.2}, write {:.2}{}",
        seconds.total,
        seconds.read,
        seconds.points,
        seconds.octree,
        seconds.gather,
        seconds.write,
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

/// `warnings` grouped by kind on stderr.
pub(super) fn warnings(warnings: &[Warning]) {
    let mut kinds: BTreeMap<&str, Vec<&Warning>> = BTreeMap::new();
    for warning in warnings {
        log::debug!("{}: {}: {}", warning.kind, warning.prim, warning.message);
        kinds.entry(&warning.kind).or_default().push(warning);
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
    #[test]
    fn bytes_are_told_in_binary_units() {
        assert_eq!(super::human_bytes(512), "512 B");
        assert_eq!(super::human_bytes(3 << 29), "1.5 GiB");
    }
}
