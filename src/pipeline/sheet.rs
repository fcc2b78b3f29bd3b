//! A run's report → one page that needs nothing else: pictures, settings, statistics, error, warnings, outputs.

use super::report::Report;
use super::shots::Shot;
use crate::diagnostics::Warning;
use crate::writers::page::{document, png_address};
use maud::{Markup, html};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Component, Path, PathBuf};

const STYLE: &str = include_str!("sheet.css");

/// Warnings of one kind that are listed; statistics have all.
const LISTED: usize = 100;

/// The page about `report`, to be written as `page` (links are relative to it). `name` is the stage's.
pub(super) fn sheet(report: &Report, name: &str, page: &Path) -> String {
    let title = format!("surflux {}: {name}", verb(report));
    let (pair, more): (Vec<&Shot>, Vec<&Shot>) =
        report.shots.iter().partition(|shot| shot.is_of_pair);
    let body = html! {
        h1 { (title) }
        p.note {
            "surflux " (report.surflux)
            @if !report.usd.is_empty() { ", USD read by " (report.usd) }
            ". Command: " code { (report.command.join(" ")) }
        }
        @if !pair.is_empty() {
            h2 { "With and without reflected light" }
            div.row.pair { @for shot in pair { (figure(shot)) } }
        }
        @if !more.is_empty() {
            h2 { "Results" }
            div.row.more { @for shot in more { (figure(shot)) } }
        }
        (error(report))
        h2 { "Run" }
        div.row { (seconds(report)) (counts(report)) (read(report)) }
        h2 { "Settings" }
        (settings(report))
        h2 { "Warnings" }
        (warnings(&report.warnings))
        h2 { "Outputs" }
        ul { @for output in &report.outputs {
            li { a href=(link(page, output)) { (output.display()) } }
        } }
    };
    document(&title, STYLE, &body)
}

/// `points`, `bake` or `render`, as typed.
fn verb(report: &Report) -> &str {
    report.command.get(1).map_or("", String::as_str)
}

fn figure(shot: &Shot) -> Markup {
    html! {
        figure {
            figcaption { (shot.title) }
            img alt=(shot.title) src=(png_address(&shot.png));
        }
    }
}

fn error(report: &Report) -> Markup {
    let error = &report.error;
    let misses = |value: f64| error.tolerance.is_some_and(|tolerance| value > tolerance);
    html! {
        h2 { "Error" }
        @if error.aovs.is_empty() {
            p.note { "No error was estimated: engines that can tell theirs do, and --tolerance asks for one." }
        } @else {
            p.note {
                "Relative root mean square, rms(x − truth) / mean |truth|, estimated (" (error.method) ")"
                @if let Some(tolerance) = error.tolerance { "; asked for: " (percent(tolerance)) }
            }
            table { @for (aov, value) in &error.aovs {
                tr { td { (aov) } td.n.over[misses(*value)] { (percent(*value)) } }
            } }
        }
    }
}

fn percent(value: f64) -> String {
    format!("{:.2} %", 100.0 * value)
}

fn seconds(report: &Report) -> Markup {
    let seconds = &report.seconds;
    let rows = [
        ("read", seconds.read),
        ("points", seconds.points),
        ("octree", seconds.octree),
        ("gather", seconds.gather),
        ("write", seconds.write),
        ("pictures", seconds.pictures),
        ("total", seconds.total),
    ];
    html! { div { table {
        tr { th { "seconds" } th {} }
        @for (name, value) in rows { tr { td { (name) } td.n { (format!("{value:.2}")) } } }
    } } }
}

fn counts(report: &Report) -> Markup {
    let counts = &report.counts;
    let rows = [
        ("prims", counts.prims),
        ("triangles", counts.triangles),
        ("surfels", counts.surfels),
        ("octree nodes", counts.nodes),
        ("receivers", counts.receivers),
        ("gathered at", counts.gathered),
    ];
    html! { div { table {
        tr { th { "largest over frames" } th {} }
        @for (name, value) in rows { tr { td { (name) } td.n { (value) } } }
    } } }
}

fn read(report: &Report) -> Markup {
    let read = &report.read;
    let rows = [
        ("layers", read.layers.to_string()),
        ("attributes", read.attributes.to_string()),
        ("values", mebibytes(read.bytes as u64)),
        ("textures", read.textures.to_string()),
        ("texture files", mebibytes(read.texture_bytes)),
    ];
    html! { div { table {
        tr { th { "read" } th {} }
        @for (name, value) in rows { tr { td { (name) } td.n { (value) } } }
        @if let Some(bytes) = report.peak_memory_bytes {
            tr { td { "peak memory" } td.n { (mebibytes(bytes)) } }
        }
    } } }
}

fn mebibytes(bytes: u64) -> String {
    #[expect(clippy::cast_precision_loss, reason = "shown with one decimal")]
    let mebibytes = bytes as f64 / f64::from(1_u32 << 20);
    format!("{mebibytes:.1} MiB")
}

fn settings(report: &Report) -> Markup {
    html! { table { @for (name, value) in &report.settings {
        tr { td { (name) } td { code { (text(value)) } } }
    } } }
}

fn text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(text).collect::<Vec<_>>().join(", "),
        Value::Null => "none".to_owned(),
        Value::Number(number) if number.is_f64() => {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "settings are single precision: further digits are noise"
            )]
            let single = number.as_f64().unwrap_or(f64::NAN) as f32;
            single.to_string()
        }
        other => other.to_string(),
    }
}

fn warnings(warnings: &[Warning]) -> Markup {
    let mut kinds: BTreeMap<&str, Vec<&Warning>> = BTreeMap::new();
    for warning in warnings {
        kinds.entry(&warning.kind).or_default().push(warning);
    }
    html! {
        @if kinds.is_empty() { p.note { "None." } }
        @for (kind, group) in kinds {
            p { b { (kind) } " (" (group.len()) ")" }
            ul { @for warning in group.iter().take(LISTED) {
                li { code { (warning.prim) } " " (warning.message) }
            } }
            @if group.len() > LISTED {
                p.note { "… and " (group.len() - LISTED) " more, in --json" }
            }
        }
    }
}

/// The address of `file` on a page in the folder of `page`.
fn link(page: &Path, file: &Path) -> String {
    let whole = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let (page, file) = (whole(page), whole(file));
    let folder: Vec<Component<'_>> = page.parent().unwrap_or(&page).components().collect();
    let parts: Vec<Component<'_>> = file.components().collect();
    let same = folder
        .iter()
        .zip(&parts)
        .take_while(|(a, b)| a == b)
        .count();
    let up = std::iter::repeat_n(Component::ParentDir, folder.len() - same);
    let path: PathBuf = up.chain(parts[same..].iter().copied()).collect();
    let mut address = String::new();
    for byte in path.to_string_lossy().replace('\\', "/").bytes() {
        match byte {
            b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' | b'/' => {
                address.push(char::from(byte));
            }
            _ => {
                let _ = write!(address, "%{byte:02X}");
            }
        }
    }
    address
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_lead_from_the_page_to_the_file() {
        let link = |page: &str, file: &str| link(Path::new(page), Path::new(file));
        assert_eq!(link("/a/b/r.html", "/a/b/x.exr"), "x.exr");
        assert_eq!(link("/a/b/r.html", "/a/c/x #1.exr"), "../c/x%20%231.exr");
        assert_eq!(link("r.html", "out/x.usdc"), "out/x.usdc");
    }

    #[test]
    fn what_was_typed_is_text_and_no_markup() {
        let mut report = Report::new(&["surflux".into(), "bake".into(), "<i>.usda".into()]);
        report.set("aovs", vec!["occlusion", "irradiance"]);
        report.set("max_solid_angle", f64::from(0.03_f32));
        report.error.tolerance = Some(0.02);
        report.error.aovs.insert("irradiance".to_owned(), 0.034);
        let page = sheet(&report, "<i>.usda", Path::new("r.html"));
        assert!(page.contains("surflux bake: &lt;i&gt;.usda") && !page.contains("<i>"));
        assert!(page.contains("occlusion, irradiance") && page.contains("<code>0.03</code>"));
        assert!(page.contains("<td class=\"n over\">3.40 %</td>"), "{page}");
    }
}
