//! Errors → a histogram as SVG: how they are spread, not only how large they are.

use super::Row;
use super::plot::{engine_color, put};

const WIDTH: f64 = 440.0;
const HEIGHT: f64 = 212.0;
const BOTTOM: f64 = 24.0;
/// Room for the legend.
const TOP: f64 = 58.0;
const BINS: usize = 41;

/// Share of all errors that the horizontal axis reaches over.
const REACH: f64 = 0.98;

/// Rows far worse than the best pile up at the ends, so that the others can be told apart.
const MOST_OVER_LEAST: f64 = 8.0;

/// Counts of errors in `BINS` equal bins from −`reach` to `reach`; those beyond are in the outermost.
fn counts(errors: &[f64], reach: f64) -> [usize; BINS] {
    let mut bins = [0; BINS];
    for error in errors.iter().filter(|error| error.is_finite()) {
        let place = (0.5 + 0.5 * error / reach) * BINS as f64;
        bins[index(place)] += 1;
    }
    bins
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the bins"
)]
fn index(place: f64) -> usize {
    place.floor().clamp(0.0, BINS as f64 - 1.0) as usize
}

/// The magnitude that `REACH` of the errors of every row do not exceed, but no more than [`MOST_OVER_LEAST`] times what
/// holds for the best row; above 0.
fn reach(rows: &[&Row]) -> f64 {
    let reaches = rows.iter().map(|row| reach_of(&row.errors));
    let (least, most) = reaches.fold((f64::INFINITY, 0.0_f64), |(least, most), reach| {
        (least.min(reach), most.max(reach))
    });
    most.min(MOST_OVER_LEAST * least).max(f64::EPSILON)
}

fn reach_of(errors: &[f64]) -> f64 {
    let sizes = errors.iter().map(|error| error.abs());
    let mut sizes: Vec<f64> = sizes.filter(|size| size.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let at = index_of_share(sizes.len());
    sizes.get(at).copied().unwrap_or(0.0)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share of a count"
)]
fn index_of_share(count: usize) -> usize {
    (count as f64 * REACH) as usize
}

/// The signed errors of `rows` (over the truth's mean) as outlines over one axis, an `<svg>` element.
pub(super) fn histogram(rows: &[&Row]) -> String {
    let reach = reach(rows);
    let all: Vec<[usize; BINS]> = rows.iter().map(|row| counts(&row.errors, reach)).collect();
    let most = all.iter().flatten().copied().max().unwrap_or(0).max(1) as f64;
    let (floor, bin) = (HEIGHT - BOTTOM, WIDTH / BINS as f64);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" height=\"{HEIGHT}\" role=\"img\" \
         font-family=\"sans-serif\" font-size=\"10\">"
    );
    put(
        &mut svg,
        format_args!(
            "<line x1=\"0\" x2=\"{WIDTH}\" y1=\"{floor}\" y2=\"{floor}\" stroke=\"#888\"/>\
         <line x1=\"{0}\" x2=\"{0}\" y1=\"{TOP}\" y2=\"{floor}\" stroke=\"#ccc\"/>",
            0.5 * WIDTH
        ),
    );
    for (k, (row, counts)) in rows.iter().zip(&all).enumerate() {
        let mut points = vec![format!("0,{floor}")];
        for (i, count) in counts.iter().enumerate() {
            let height = floor - *count as f64 / most * (floor - TOP);
            points.push(format!("{:.1},{height:.1}", i as f64 * bin));
            points.push(format!("{:.1},{height:.1}", (i + 1) as f64 * bin));
        }
        points.push(format!("{WIDTH},{floor}"));
        let color = engine_color(row.engine);
        let dash = ["", "4 2", "7 2", "1.5 2"][k.min(3)];
        put(
            &mut svg,
            format_args!(
                "<polygon points=\"{}\" fill=\"{color}\" fill-opacity=\"0.08\" stroke=\"{color}\" stroke-dasharray=\"{dash}\"/>\
             <text x=\"4\" y=\"{}\" fill=\"{color}\">{} {}</text>",
                points.join(" "),
                12.0 + 12.0 * k as f64,
                ["—", "– –", "— —", "···"][k.min(3)],
                row.label()
            ),
        );
    }
    let low = HEIGHT - 10.0;
    put(
        &mut svg,
        format_args!(
            "<text x=\"2\" y=\"{low}\">≤ −{0:.2} %</text><text x=\"{1}\" y=\"{low}\" text-anchor=\"middle\">0</text>\
         <text x=\"{2}\" y=\"{low}\" text-anchor=\"end\">≥ {0:.2} %</text></svg>",
            100.0 * reach,
            0.5 * WIDTH,
            WIDTH - 2.0
        ),
    );
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_error_is_in_one_bin_and_none_in_the_middle_one() {
        let bins = counts(&[0.0, -0.1, 0.1, 5.0, f64::NAN], 0.1);
        assert_eq!(bins.iter().sum::<usize>(), 4);
        assert_eq!((bins[0], bins[BINS / 2], bins[BINS - 1]), (1, 1, 2));
    }
}
