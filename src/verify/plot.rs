//! Rows → a Pareto plot: time of a receiver against error, both logarithmic, as SVG.

use super::Row;
use std::fmt::Write as _;

/// Size of the drawing and of its inner frame, SVG units.
const WIDTH: f64 = 440.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 40.0;

/// Errors below this (one in a million) are drawn there: a logarithm needs a floor.
const FLOOR: f64 = 1e-6;

/// Which error is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Measure {
    /// Relative RMSE.
    Rmse,
    /// 99th percentile.
    P99,
}

impl Measure {
    fn of(self, row: &Row) -> f64 {
        match self {
            Self::Rmse => row.error.relative_rmse,
            Self::P99 => row.error.p99,
        }
        .max(FLOOR)
    }

    fn title(self) -> &'static str {
        match self {
            Self::Rmse => "relRMSE",
            Self::P99 => "p99 of the relative error",
        }
    }
}

/// Color of an engine; the same in every plot of a page.
pub(super) fn engine_color(engine: &str) -> &'static str {
    match engine {
        "rays" => "#1f6fb4",
        "paper" => "#d1702a",
        "maps" => "#2a8f4a",
        _ => "#7a4fa3",
    }
}

/// A logarithmic axis.
#[derive(Debug, Clone, Copy)]
struct Axis {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
}

impl Axis {
    /// An axis over `values`, with a tenth of a decade beyond each end, drawn from `start` to `end`.
    fn over(values: impl Iterator<Item = f64>, start: f64, end: f64) -> Self {
        let logs: Vec<f64> = values.map(f64::log10).filter(|x| x.is_finite()).collect();
        let low = logs.iter().copied().reduce(f64::min).unwrap_or(0.0) - 0.15;
        let high = logs.iter().copied().reduce(f64::max).unwrap_or(1.0) + 0.15;
        Self {
            low,
            high,
            start,
            end,
        }
    }

    fn place(&self, value: f64) -> f64 {
        let along = (value.log10() - self.low) / (self.high - self.low);
        self.start + along * (self.end - self.start)
    }

    /// 1, 2 and 5 times powers of ten; only 1 where that alone gives enough.
    fn ticks(&self) -> Vec<f64> {
        let (mut power, last) = (self.low.floor(), self.high.ceil());
        let steps: &[f64] = if self.high - self.low > 2.5 {
            &[1.0]
        } else {
            &[1.0, 2.0, 5.0]
        };
        let mut ticks = Vec::new();
        while power <= last {
            ticks.extend(steps.iter().map(|step| step * 10_f64.powf(power)));
            power += 1.0;
        }
        ticks.retain(|tick| (self.low..=self.high).contains(&tick.log10()));
        ticks
    }
}

/// The plot of `rows` (of one AOV at one set) as an `<svg>` element. Text in it is ours, numbers and engine names.
pub(super) fn pareto(rows: &[&Row], measure: Measure) -> String {
    let x = Axis::over(rows.iter().map(|row| row.microseconds), LEFT, WIDTH - RIGHT);
    let y = Axis::over(rows.iter().map(|row| measure.of(row)), HEIGHT - BOTTOM, TOP);
    let mut svg = frame(&x, &y, measure);
    let mut engines: Vec<&str> = rows.iter().map(|row| row.engine).collect();
    engines.sort_unstable();
    engines.dedup();
    for engine in engines {
        let mut swept: Vec<&Row> = rows
            .iter()
            .copied()
            .filter(|row| row.engine == engine && row.auto.is_none())
            .collect();
        swept.sort_by(|a, b| a.microseconds.total_cmp(&b.microseconds));
        let color = engine_color(engine);
        let points: Vec<(f64, f64, &Row)> = swept
            .iter()
            .map(|row| (x.place(row.microseconds), y.place(measure.of(row)), *row))
            .collect();
        let line: Vec<String> = points
            .iter()
            .map(|(x, y, _)| format!("{x:.1},{y:.1}"))
            .collect();
        put(
            &mut svg,
            format_args!(
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.5\" opacity=\"0.6\"/>",
                line.join(" ")
            ),
        );
        for (px, py, row) in points {
            put(
                &mut svg,
                format_args!(
                    "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"4\" fill=\"{color}\"><title>{engine}: {}, {:.2} µs, {:.3} %</title></circle>",
                    row.settings_text(),
                    row.microseconds,
                    100.0 * measure.of(row)
                ),
            );
        }
    }
    autos(&mut svg, rows, (&x, &y), measure);
    svg.push_str("</svg>");
    svg
}

/// A ring and its tolerance around what `--tolerance` picks.
fn autos(svg: &mut String, rows: &[&Row], (x, y): (&Axis, &Axis), measure: Measure) {
    for row in rows {
        let Some(auto) = row.auto else { continue };
        let (px, py) = (x.place(row.microseconds), y.place(measure.of(row)));
        put(
            svg,
            format_args!(
                "<circle cx=\"{px:.1}\" cy=\"{py:.1}\" r=\"7\" fill=\"none\" stroke=\"#b0156b\" stroke-width=\"1.6\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" fill=\"#b0156b\" font-size=\"10\">{} %</text>",
                px + 9.0,
                py - 5.0,
                100.0 * auto.tolerance
            ),
        );
    }
}

fn frame(x: &Axis, y: &Axis, measure: Measure) -> String {
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\" \
         font-family=\"sans-serif\" font-size=\"10\">"
    );
    for tick in x.ticks() {
        let at = x.place(tick);
        put(
            &mut svg,
            format_args!(
                "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{}\" stroke=\"#ddd\"/>\
             <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#444\">{}</text>",
                HEIGHT - BOTTOM,
                HEIGHT - BOTTOM + 14.0,
                short(tick)
            ),
        );
    }
    for tick in y.ticks() {
        let at = y.place(tick);
        put(
            &mut svg,
            format_args!(
                "<line x1=\"{LEFT}\" x2=\"{}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#ddd\"/>\
             <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#444\">{} %</text>",
                WIDTH - RIGHT,
                LEFT - 5.0,
                at + 3.5,
                short(100.0 * tick)
            ),
        );
    }
    put(
        &mut svg,
        format_args!(
            "<rect x=\"{LEFT}\" y=\"{TOP}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#888\"/>\
         <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">µs a receiver, one thread</text>\
         <text transform=\"translate(12 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            WIDTH - LEFT - RIGHT,
            HEIGHT - TOP - BOTTOM,
            0.5 * (LEFT + WIDTH - RIGHT),
            HEIGHT - 8.0,
            0.5 * (TOP + HEIGHT - BOTTOM),
            measure.title()
        ),
    );
    svg
}

/// `value` without noise of its binary form.
fn short(value: f64) -> String {
    if value >= 1.0 {
        format!("{value:.0}")
    } else {
        format!("{}", (value * 1e6).round() / 1e6)
    }
}

/// Append to text; that cannot fail.
pub(super) fn put(text: &mut String, what: std::fmt::Arguments<'_>) {
    text.write_fmt(what).expect("a string takes all text");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decades_are_equally_far_apart_and_ticks_lie_inside() {
        let axis = Axis::over([1.0, 1000.0].into_iter(), 0.0, 100.0);
        let step = axis.place(10.0) - axis.place(1.0);
        assert!((axis.place(1000.0) - axis.place(100.0) - step).abs() < 1e-9);
        assert_eq!(axis.ticks(), [1.0, 10.0, 100.0, 1000.0]);
        let close = Axis::over([3.0, 6.0].into_iter(), 0.0, 100.0);
        assert_eq!(close.ticks(), [5.0]);
    }

    #[test]
    fn ticks_are_written_without_binary_noise() {
        assert_eq!(short(0.30000000000000004), "0.3");
        assert_eq!(short(200.00000000000003), "200");
    }
}
