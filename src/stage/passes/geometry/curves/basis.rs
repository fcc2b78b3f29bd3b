//! The shape of one curve of a `BasisCurves` prim: which control points, with which weights, make the point at a
//! parameter. The same weights hold for widths, normals and primvars of `vertex` interpolation.

use super::super::super::super::raw::RawPrim;
use super::super::attributes::token;

/// `type` and `basis`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Basis {
    Linear,
    Bezier,
    BSpline,
    CatmullRom,
}

/// `wrap`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Wrap {
    /// `nonperiodic`.
    Open,
    /// The last control point is followed by the first.
    Periodic,
    /// B-splines and Catmull-Rom splines reach their first and last control points, by a phantom point before and
    /// after: the mirror image of the second in the first.
    Pinned,
}

/// `type`, `basis` and `wrap` of a prim.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Form {
    pub(super) basis: Basis,
    pub(super) wrap: Wrap,
}

/// Coefficients of 1, t, t², t³ in the weights of a segment's four control points.
type Cubic = [[f64; 4]; 4];

const BEZIER: Cubic = [
    [1.0, -3.0, 3.0, -1.0],
    [0.0, 3.0, -6.0, 3.0],
    [0.0, 0.0, 3.0, -3.0],
    [0.0, 0.0, 0.0, 1.0],
];

const SIXTH: f64 = 1.0 / 6.0;

const B_SPLINE: Cubic = [
    [SIXTH, -0.5, 0.5, -SIXTH],
    [4.0 * SIXTH, 0.0, -1.0, 0.5],
    [SIXTH, 0.5, 0.5, -0.5],
    [0.0, 0.0, 0.0, SIXTH],
];

const CATMULL_ROM: Cubic = [
    [0.0, -0.5, 1.0, -0.5],
    [1.0, 0.0, -2.5, 1.5],
    [0.0, 0.5, 2.0, -1.5],
    [0.0, 0.0, -0.5, 0.5],
];

/// A place on a curve: number of the segment and parameter in it, 0…1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    pub(super) segment: usize,
    pub(super) t: f64,
}

/// Which derivative by a segment's parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    Value,
    First,
    Second,
}

impl Form {
    /// Of `prim`, with the schema's fallbacks; the error names a word that is none of the schema's.
    pub(super) fn read(prim: &RawPrim) -> Result<Self, String> {
        let unknown = |what: &str, word: &str, known: &str| {
            Err(format!("{what} {word:?} is none of {known}"))
        };
        let basis = match (token(prim, "type", "cubic"), token(prim, "basis", "bezier")) {
            ("linear", _) => Basis::Linear,
            ("cubic", "bezier") => Basis::Bezier,
            ("cubic", "bspline") => Basis::BSpline,
            ("cubic", "catmullRom") => Basis::CatmullRom,
            ("cubic", word) => return unknown("basis", word, "bezier, bspline, catmullRom"),
            (word, _) => return unknown("type", word, "linear, cubic"),
        };
        let wrap = match token(prim, "wrap", "nonperiodic") {
            "nonperiodic" => Wrap::Open,
            "periodic" => Wrap::Periodic,
            "pinned" => Wrap::Pinned,
            word => return unknown("wrap", word, "nonperiodic, periodic, pinned"),
        };
        // Only splines that do not reach their ends can be pinned there.
        let wrap = match (basis, wrap) {
            (Basis::Linear | Basis::Bezier, Wrap::Pinned) => Wrap::Open,
            (_, wrap) => wrap,
        };
        Ok(Self { basis, wrap })
    }

    /// Segments of a curve with `count` control points; `None` where there cannot be so many.
    pub(super) fn segments(self, count: usize) -> Option<usize> {
        match (self.basis, self.wrap) {
            (Basis::Linear, Wrap::Periodic) => (count >= 3).then_some(count),
            (Basis::Linear, _) => (count >= 2).then(|| count - 1),
            (Basis::Bezier, Wrap::Periodic) => {
                (count >= 3 && count.is_multiple_of(3)).then_some(count / 3)
            }
            (Basis::Bezier, _) => (count >= 4 && count % 3 == 1).then(|| (count - 1) / 3),
            (_, Wrap::Periodic) => (count >= 3).then_some(count),
            (_, Wrap::Pinned) => (count >= 2).then(|| count - 1),
            (_, Wrap::Open) => (count >= 4).then(|| count - 3),
        }
    }

    /// Values of `varying` interpolation on a curve of `segments`: one at each end of one.
    pub(super) fn varying_count(self, segments: usize) -> usize {
        segments + usize::from(self.wrap != Wrap::Periodic)
    }

    /// The control points of a curve of `count` that count at `place`, with their weights.
    pub(super) fn weights(self, count: usize, place: Place, order: Order) -> Vec<(usize, f64)> {
        let (first, weights) = self.segment(place, order);
        let mut all = Vec::with_capacity(6);
        for (offset, &weight) in weights.iter().enumerate() {
            // One too high, so that the phantom point before the first has a number.
            let number = first + offset;
            match self.wrap {
                Wrap::Periodic => all.push(((number + count - 1) % count, weight)),
                Wrap::Pinned if number == 0 => all.extend([(0, 2.0 * weight), (1, -weight)]),
                Wrap::Pinned if number == count + 1 => {
                    all.extend([(count - 1, 2.0 * weight), (count - 2, -weight)]);
                }
                _ => all.push((number - 1, weight)),
            }
        }
        all
    }

    /// Number of the first control point, plus one, and the weights of it and those that follow.
    fn segment(self, place: Place, order: Order) -> (usize, Vec<f64>) {
        let Place { segment, t } = place;
        let cubic = match self.basis {
            Basis::Linear => {
                let weights = match order {
                    Order::Value => vec![1.0 - t, t],
                    Order::First => vec![-1.0, 1.0],
                    Order::Second => vec![0.0, 0.0],
                };
                return (segment + 1, weights);
            }
            Basis::Bezier => &BEZIER,
            Basis::BSpline => &B_SPLINE,
            Basis::CatmullRom => &CATMULL_ROM,
        };
        let weights = cubic.map(|[a, b, c, d]| match order {
            Order::Value => a + t * (b + t * (c + t * d)),
            Order::First => b + t * (2.0 * c + t * 3.0 * d),
            Order::Second => 2.0 * c + t * 6.0 * d,
        });
        let first = match (self.basis, self.wrap) {
            (Basis::Bezier, _) => 3 * segment + 1,
            (_, Wrap::Pinned) => segment,
            _ => segment + 1,
        };
        (first, weights.to_vec())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Basis; 4] = [
        Basis::Linear,
        Basis::Bezier,
        Basis::BSpline,
        Basis::CatmullRom,
    ];

    fn place(segment: usize, t: f64) -> Place {
        Place { segment, t }
    }

    fn point(form: Form, xs: &[f64], at: Place, order: Order) -> f64 {
        let weights = form.weights(xs.len(), at, order);
        weights.iter().map(|&(i, weight)| xs[i] * weight).sum()
    }

    #[test]
    fn weights_sum_to_one_and_those_of_derivatives_to_zero() {
        for basis in ALL {
            for wrap in [Wrap::Open, Wrap::Periodic, Wrap::Pinned] {
                let form = Form { basis, wrap };
                let count = if basis == Basis::Bezier && wrap == Wrap::Periodic {
                    6
                } else {
                    7
                };
                for segment in 0..form.segments(count).unwrap() {
                    for t in [0.0, 0.3, 1.0] {
                        let sum = |order| point(form, &vec![1.0; count], place(segment, t), order);
                        assert!((sum(Order::Value) - 1.0).abs() < 1e-14);
                        assert!(sum(Order::First).abs() < 1e-14);
                        assert!(sum(Order::Second).abs() < 1e-14);
                    }
                }
            }
        }
    }

    #[test]
    fn segments_join_and_derivatives_are_those_of_the_values() {
        let xs = [0.0, 2.0, 1.0, 4.0, -3.0, 5.0, 6.5];
        for basis in ALL {
            for wrap in [Wrap::Open, Wrap::Periodic, Wrap::Pinned] {
                let form = Form { basis, wrap };
                let xs = if basis == Basis::Bezier && wrap == Wrap::Periodic {
                    &xs[..6]
                } else {
                    &xs
                };
                let segments = form.segments(xs.len()).unwrap();
                let at = |segment, t| point(form, xs, place(segment, t), Order::Value);
                for segment in 1..segments {
                    assert!(
                        (at(segment - 1, 1.0) - at(segment, 0.0)).abs() < 1e-12,
                        "{form:?}"
                    );
                }
                if wrap == Wrap::Periodic {
                    assert!(
                        (at(segments - 1, 1.0) - at(0, 0.0)).abs() < 1e-12,
                        "{form:?}"
                    );
                }
                let step = 1e-6;
                let slope = (at(0, 0.4 + step) - at(0, 0.4 - step)) / (2.0 * step);
                let found = point(form, xs, place(0, 0.4), Order::First);
                assert!((slope - found).abs() < 1e-6, "{form:?}: {slope} {found}");
            }
        }
    }

    /// By hand from the definitions of the schema: where curves start and end.
    #[test]
    fn curves_start_and_end_where_the_schema_says() {
        let xs = [0.0, 6.0, 3.0, 12.0];
        let ends = |basis, wrap| {
            let form = Form { basis, wrap };
            let last = form.segments(4).unwrap() - 1;
            [place(0, 0.0), place(last, 1.0)].map(|at| point(form, &xs, at, Order::Value))
        };
        assert_eq!(ends(Basis::Bezier, Wrap::Open), [0.0, 12.0]);
        assert_eq!(ends(Basis::CatmullRom, Wrap::Open), [6.0, 3.0]);
        assert_eq!(ends(Basis::CatmullRom, Wrap::Pinned), [0.0, 12.0]);
        let close = |found: [f64; 2], expected: [f64; 2]| {
            assert!(
                (0..2).all(|i| (found[i] - expected[i]).abs() < 1e-12),
                "{found:?}"
            );
        };
        // (0 + 4·6 + 3) / 6 and (6 + 4·3 + 12) / 6
        close(ends(Basis::BSpline, Wrap::Open), [4.5, 5.0]);
        close(ends(Basis::BSpline, Wrap::Pinned), [0.0, 12.0]);
    }
}
