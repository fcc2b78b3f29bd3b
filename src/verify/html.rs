//! A [`VerifyReport`] → one page that needs nothing else: plots, tables, histograms, error pictures.

use super::histogram::histogram;
use super::plot::{Measure, engine_color, pareto};
use super::{ErrorPicture, Row, TruthSummary, VerifyReport};
use crate::writers::image::png_of_rgb;
use crate::writers::page::{document, png_address};
use maud::{Markup, PreEscaped, html};

const STYLE: &str = "body{font:14px/1.45 system-ui,sans-serif;margin:24px auto;max-width:1120px;padding:0 16px;color:#222}\
h1{font-size:22px;margin:0 0 4px}h2{font-size:18px;margin:32px 0 8px;border-bottom:1px solid #ddd}h3{font-size:14px;margin:18px 0 4px}\
table{border-collapse:collapse;font-size:12.5px;font-variant-numeric:tabular-nums}\
th,td{padding:2px 9px;text-align:right;border-bottom:1px solid #eee}th{border-bottom:1px solid #888}\
td.l,th.l{text-align:left}tr.auto td{background:#fbeef5}.row{display:flex;flex-wrap:wrap;gap:16px}\
.dot{display:inline-block;width:10px;height:10px;border-radius:5px;margin-right:4px}\
figure{margin:0}figcaption{font-size:12px;color:#444}img{image-rendering:pixelated;width:340px;display:block}\
p.note{color:#555;font-size:12.5px;max-width:80ch}.bar{width:340px;height:10px;background:linear-gradient(90deg,#2166ac,#fff,#b2182b)}\
.ends{display:flex;justify-content:space-between;width:340px;font-size:11px}";

/// The page as HTML.
pub fn page(report: &VerifyReport) -> String {
    let body = html! {
        h1 { "Speed against error: " (report.stage) }
        (summary(report))
        @for truth in aovs(report) { (section(report, truth)) }
        @if !report.warnings.is_empty() { (warnings(report)) }
    };
    document(&format!("surflux verify: {}", report.stage), STYLE, &body)
}

/// One truth for each AOV, in order.
fn aovs(report: &VerifyReport) -> Vec<&'static str> {
    let mut names = Vec::new();
    for truth in &report.truth {
        if !names.contains(&truth.aov) {
            names.push(truth.aov);
        }
    }
    names
}

fn summary(report: &VerifyReport) -> Markup {
    let machine = &report.machine;
    html! {
        p.note {
            "surflux " (report.surflux) ", " (report.usd) ", " (report.triangles) " triangles, " (report.surfels) " surfels. "
            (machine.processor) ", " (machine.processors) " processors, " (machine.system)
            @if !machine.load.is_empty() { ", load " (machine.load) }
            @if machine.debug_assertions { ", built with debug assertions" }
            "; " (format!("{:.1}", report.seconds)) " s. Command: " code { (report.command.join(" ")) }
        }
        p.note {
            "Truth: rays to convergence, in two independent halves whose difference gives its standard error; that error is \
             taken out of relRMSE = rms(x − truth) / mean |truth|. p99 and max are of |x − truth| / max(|truth|, 0.1 mean). \
             Times are processor time of one receiver among its neighbors on one thread, the median of three passes in turns, without building what an engine \
             stands on. Rings and shaded rows are what --tolerance picks at that tolerance."
        }
        p { @for engine in engines(report) {
            span.dot style=(format!("background:{}", engine_color(engine))) {} (engine) " \u{2003}"
        } }
    }
}

fn engines(report: &VerifyReport) -> Vec<&'static str> {
    let mut engines: Vec<_> = report.rows.iter().map(|row| row.engine).collect();
    engines.sort_unstable();
    engines.dedup();
    engines
}

fn section(report: &VerifyReport, aov: &str) -> Markup {
    let truths = report.truth.iter().filter(|truth| truth.aov == aov);
    let pictures: Vec<_> = report
        .pictures
        .iter()
        .filter(|picture| picture.title.starts_with(&format!("{aov}:")))
        .collect();
    html! {
        h2 { (aov) }
        @for truth in truths { (set(report, truth)) }
        @if !pictures.is_empty() {
            h3 { "Errors as the camera sees them, over the mean" }
            div.row { @for picture in pictures { (figure(picture)) } }
        }
    }
}

fn set(report: &VerifyReport, truth: &TruthSummary) -> Markup {
    let rows: Vec<&Row> = report
        .rows
        .iter()
        .filter(|row| row.set == truth.set && row.aov == truth.aov)
        .collect();
    let shown: Vec<&Row> = rows
        .iter()
        .copied()
        .filter(|row| in_histogram(row))
        .collect();
    html! {
        h3 { (truth.aov) " at " (truth.set) }
        p.note {
            (truth.receivers) " of " (truth.population) " receivers; mean " (format!("{:.4}", truth.mean))
            ", standard error of the truth " (percent(truth.standard_error))
        }
        div.row {
            (PreEscaped(pareto(&rows, Measure::Rmse)))
            (PreEscaped(pareto(&rows, Measure::P99)))
        }
        div.row {
            (table(&rows))
            (PreEscaped(histogram(&shown)))
        }
    }
}

/// Few enough outlines to tell apart: some rays, maps and the paper's own settings.
fn in_histogram(row: &Row) -> bool {
    let knob = |name| row.settings.iter().find(|(knob, _)| *knob == name);
    let is = |name, value: f64| knob(name).is_some_and(|(_, n)| *n == value);
    let rays = is("rays", 64.0) || is("rays", 256.0);
    let maps = is("directions", 256.0) && is("pixel", 1.0);
    row.auto.is_none() && (rays || maps || is("raster_resolution", 12.0))
}

fn table(rows: &[&Row]) -> Markup {
    html! {
        table {
            tr {
                th.l { "engine" } th.l { "settings" } th { "µs" } th { "relRMSE" } th { "bias" } th { "p99" } th { "max" }
                th { "not finite" } th { "tolerance" } th { "estimate" }
            }
            @for row in rows {
                tr class=[row.auto.map(|_| "auto")] {
                    td.l { (row.engine) }
                    td.l { (row.settings_text()) }
                    td { (microseconds(row.microseconds)) }
                    td { (percent(row.error.relative_rmse)) }
                    td { (percent(row.error.bias)) }
                    td { (percent(row.error.p99)) }
                    td { (percent(row.error.max)) }
                    td { (row.error.non_finite) }
                    @if let Some(auto) = row.auto {
                        td { (percent(auto.tolerance)) }
                        td { (auto.estimate.map_or(String::new(), percent)) }
                    } @else { td {} td {} }
                }
            }
        }
    }
}

fn figure(picture: &ErrorPicture) -> Markup {
    let png = png_of_rgb(picture.width, picture.height, &picture.rgb);
    html! {
        figure {
            figcaption { (picture.title) }
            img alt=(picture.title) src=(png_address(&png));
            div.bar {}
            div.ends {
                span { (format!("−{}", percent(picture.scale))) } span { "0" } span { (format!("+{}", percent(picture.scale))) }
            }
        }
    }
}

fn warnings(report: &VerifyReport) -> Markup {
    html! {
        h2 { "Warnings" }
        ul { @for warning in &report.warnings {
            li { b { (warning.kind) } " " (warning.prim) " " (warning.message) }
        } }
    }
}

/// Three digits or so.
pub(super) fn percent(x: f64) -> String {
    let x = 100.0 * x;
    match x.abs() {
        size if size >= 100.0 => format!("{x:.0} %"),
        size if size >= 10.0 => format!("{x:.1} %"),
        size if size >= 1.0 => format!("{x:.2} %"),
        _ => format!("{x:.3} %"),
    }
}

fn microseconds(x: f64) -> String {
    if x >= 100.0 {
        format!("{x:.0}")
    } else {
        format!("{x:.2}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentages_keep_three_digits() {
        assert_eq!(percent(0.012_345), "1.23 %");
        assert_eq!(percent(1.5), "150 %");
        assert_eq!(percent(-0.000_1), "-0.010 %");
    }
}
