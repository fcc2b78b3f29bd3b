//! Frame specifications: USD's `101:110x2` and the farms' `101-110:2`, comma separated, in one grammar.

use std::str::FromStr;

/// Most frames one run accepts: a typing slip such as `1:1e9` must not fill the memory.
const FRAME_LIMIT: usize = 1_000_000;

/// A list of time codes, in the order given.
#[derive(Debug, Clone, PartialEq)]
pub struct Frames(pub Vec<f64>);

/// Why a frame specification was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "frame specification {spec:?}: {reason} (right: 101, 101:110, 101:110x2, 101-110, 101-110:2, 1,5,9)"
)]
pub struct BadFrames {
    spec: String,
    reason: &'static str,
}

impl FromStr for Frames {
    type Err = BadFrames;

    fn from_str(spec: &str) -> Result<Self, BadFrames> {
        let fail = |reason| BadFrames {
            spec: spec.to_owned(),
            reason,
        };
        let mut frames = Vec::new();
        for part in spec.split(',') {
            let (first, last, step) = parse_range(part.trim()).map_err(fail)?;
            append(&mut frames, first, last, step).map_err(fail)?;
        }
        Ok(Self(frames))
    }
}

/// `first`, `last`, `step` of one comma-separated part.
fn parse_range(part: &str) -> Result<(f64, f64, f64), &'static str> {
    let (first, rest) = split_number(part)?;
    let Some(separator) = rest.chars().next() else {
        return Ok((first, first, 1.0));
    };
    let step_mark = match separator {
        ':' => 'x',
        '-' => ':',
        _ => return Err("expected ':' or '-' after the first frame"),
    };
    let (last, rest) = split_number(&rest[1..])?;
    let direction = if last < first { -1.0 } else { 1.0 };
    let step = match rest.strip_prefix(step_mark) {
        Some(step) => step.parse().map_err(|_| "the step is not a number")?,
        None if rest.is_empty() => direction,
        None => return Err("unexpected text after the last frame"),
    };
    // The farms' grammar writes counting down as 10-1:2, USD's as 10:1x-2.
    let step = if separator == '-' {
        f64::abs(step) * direction
    } else {
        step
    };
    Ok((first, last, step))
}

/// The number that `text` starts with, and the rest.
fn split_number(text: &str) -> Result<(f64, &str), &'static str> {
    let digits = text.strip_prefix('-').unwrap_or(text);
    let sign_length = text.len() - digits.len();
    let length = digits
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(digits.len());
    let (number, rest) = text.split_at(sign_length + length);
    number
        .parse()
        .map(|value| (value, rest))
        .map_err(|_| "expected a frame number")
}

fn append(frames: &mut Vec<f64>, first: f64, last: f64, step: f64) -> Result<(), &'static str> {
    if step == 0.0 || !step.is_finite() {
        return Err("the step must be a number other than 0");
    }
    if (last - first) * step < 0.0 {
        return Err("the step leads away from the last frame");
    }
    /// Steps that miss the last frame by less than this many steps still reach it (decimal steps such as 0.1).
    const SLACK_STEPS: f64 = 1e-9;
    let intervals = ((last - first) / step + SLACK_STEPS).floor();
    if intervals + frames.len() as f64 >= FRAME_LIMIT as f64 {
        return Err("more than a million frames");
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0 ≤ intervals < FRAME_LIMIT"
    )]
    let count = intervals as u32;
    frames.extend((0..=count).map(|i| first + f64::from(i) * step));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(spec: &str) -> Vec<f64> {
        spec.parse::<Frames>().unwrap().0
    }

    #[test]
    fn both_grammars_give_the_frames_that_usd_and_openjd_give() {
        assert_eq!(
            frames("101:104x0.5"),
            [101.0, 101.5, 102.0, 102.5, 103.0, 103.5, 104.0]
        );
        assert_eq!(frames("105:101"), [105.0, 104.0, 103.0, 102.0, 101.0]);
        assert_eq!(frames("105:101x-2"), [105.0, 103.0, 101.0]);
        assert_eq!(frames("101:110x3"), [101.0, 104.0, 107.0, 110.0]);
        assert_eq!(frames("101-104"), [101.0, 102.0, 103.0, 104.0]);
        assert_eq!(frames("1-20:8"), [1.0, 9.0, 17.0]);
        assert_eq!(
            frames("-3--1,10:8,7"),
            [-3.0, -2.0, -1.0, 10.0, 9.0, 8.0, 7.0]
        );
    }

    #[test]
    fn nonsense_is_refused() {
        for spec in [
            "",
            "a",
            "1:",
            "1:5x0",
            "1:5x-1",
            "1:1000000000",
            "1;2",
            "1:5y2",
            "1..2",
        ] {
            assert!(spec.parse::<Frames>().is_err(), "{spec:?}");
        }
    }
}
