//! B-spline basis functions: what of its control points a NURBS is made of at a parameter. Piegl and Tiller, *The NURBS
//! Book*, A2.1 and A2.2.

/// A knot vector for a number of control points, checked.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Knots {
    knots: Vec<f64>,
    /// Degree + 1.
    order: usize,
    /// Control points.
    count: usize,
}

/// The control points that count at a parameter: the first, and for each its weight and the weight's derivative.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Blend {
    pub(super) first: usize,
    pub(super) weights: Vec<(f64, f64)>,
}

impl Knots {
    /// `knots` of a B-spline of `order` over `count` points. The error says what would be right.
    pub(super) fn new(knots: &[f32], order: usize, count: usize) -> Result<Self, String> {
        if order < 2 || count < order {
            return Err(format!(
                "order {order} with {count} points (right: an order of 2 or more, and as many points)"
            ));
        }
        if knots.len() != count + order {
            return Err(format!(
                "{} knots, order {order} with {count} points needs {}",
                knots.len(),
                count + order
            ));
        }
        let knots: Vec<f64> = knots.iter().map(|&knot| f64::from(knot)).collect();
        let in_order = knots.windows(2).all(|pair| pair[0] <= pair[1]);
        if !in_order || !knots.iter().all(|knot| knot.is_finite()) {
            return Err("knots that are not finite or go down".to_owned());
        }
        let made = Self {
            knots,
            order,
            count,
        };
        let (start, end) = made.domain();
        if start < end {
            Ok(made)
        } else {
            Err(format!("knots that leave no range ({start} to {end})"))
        }
    }

    /// Where the basis functions sum up to 1.
    pub(super) fn domain(&self) -> (f64, f64) {
        (self.knots[self.order - 1], self.knots[self.count])
    }

    /// Distinct knots inside `from`…`to`, and these two.
    pub(super) fn breaks(&self, from: f64, to: f64) -> Vec<f64> {
        let inner = self.knots.iter().copied();
        let inner = inner.filter(|&knot| from < knot && knot < to);
        let mut all: Vec<f64> = [from].into_iter().chain(inner).chain([to]).collect();
        all.dedup();
        all
    }

    /// At `parameter`, which is kept inside the domain.
    pub(super) fn blend(&self, parameter: f64) -> Blend {
        let (start, end) = self.domain();
        let u = parameter.clamp(start, end);
        let span = self.span(u);
        let degree = self.order - 1;
        let values = self.functions(span, u, degree);
        let slopes = self.derivatives(span, u, degree, 1);
        Blend {
            first: span - degree,
            weights: values.into_iter().zip(slopes).collect(),
        }
    }

    /// The knot intervals of some width between `from` and `to`, each by its number and as much of it as lies there.
    pub(super) fn intervals(&self, from: f64, to: f64) -> Vec<(usize, f64, f64)> {
        let all = self.order - 1..self.count;
        let cut = all.map(|span| {
            let (start, end) = (self.knots[span], self.knots[span + 1]);
            (span, start.max(from), end.min(to))
        });
        cut.filter(|(_, start, end)| start < end).collect()
    }

    /// The `times`-th derivatives, at `parameter` in the knot interval `span`, of the functions that are not 0 there. The
    /// first of them belongs to control point `span` + 1 − order.
    pub(super) fn weights(&self, span: usize, parameter: f64, times: usize) -> Vec<f64> {
        self.derivatives(span, parameter, self.order - 1, times)
    }

    /// Derivative of N(i, p) = p (N(i, p−1) / (u[i+p] − u[i]) − N(i+1, p−1) / (u[i+p+1] − u[i+1])), *The NURBS Book*, 2.7.
    fn derivatives(&self, span: usize, u: f64, degree: usize, times: usize) -> Vec<f64> {
        if times == 0 {
            return self.functions(span, u, degree);
        }
        if degree == 0 {
            return vec![0.0];
        }
        let lower = self.derivatives(span, u, degree - 1, times - 1);
        #[expect(clippy::cast_precision_loss, reason = "a degree")]
        let p = degree as f64;
        let part = |at: usize| {
            // lower[at] belongs to the function that starts at knot `span − degree + 1 + at`
            let from = span - degree + 1 + at;
            let width = self.knots[from + degree] - self.knots[from];
            if width > 0.0 {
                p * lower[at] / width
            } else {
                0.0
            }
        };
        let all = (0..=degree).map(|at| {
            let before = if at > 0 { part(at - 1) } else { 0.0 };
            let after = if at < degree { part(at) } else { 0.0 };
            before - after
        });
        all.collect()
    }

    /// The last knot interval of some width that holds `u` or ends there.
    fn span(&self, u: f64) -> usize {
        let inside = self.knots[..=self.count].partition_point(|&knot| knot <= u);
        let mut span = inside
            .saturating_sub(1)
            .clamp(self.order - 1, self.count - 1);
        while span > self.order - 1 && self.knots[span] >= self.knots[span + 1] {
            span -= 1;
        }
        span
    }

    /// The `degree + 1` functions of that degree that are not 0 in `span`.
    fn functions(&self, span: usize, u: f64, degree: usize) -> Vec<f64> {
        let mut values = vec![1.0];
        for p in 1..=degree {
            let mut next = vec![0.0; p + 1];
            for (at, &value) in values.iter().enumerate() {
                let right = self.knots[span + at + 1];
                let left = self.knots[span + at + 1 - p];
                let share = if right > left {
                    value / (right - left)
                } else {
                    0.0
                };
                next[at] += (right - u) * share;
                next[at + 1] += (u - left) * share;
            }
            values = next;
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bernstein polynomials are the B-splines of a knot vector without inner knots.
    #[test]
    fn without_inner_knots_they_are_bernstein_polynomials() {
        let knots = Knots::new(&[0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0], 4, 4).unwrap();
        for t in [0.0, 0.25, 0.7, 1.0] {
            let blend = knots.blend(t);
            let s = 1.0 - t;
            let expected = [
                (s * s * s, -3.0 * s * s),
                (3.0 * t * s * s, 3.0 * s * s - 6.0 * t * s),
                (3.0 * t * t * s, 6.0 * t * s - 3.0 * t * t),
                (t * t * t, 3.0 * t * t),
            ];
            assert_eq!(blend.first, 0);
            for (found, expected) in blend.weights.iter().zip(expected) {
                assert!(
                    (found.0 - expected.0).abs() < 1e-14 && (found.1 - expected.1).abs() < 1e-13
                );
            }
        }
    }

    #[test]
    fn weights_sum_to_one_over_uneven_and_repeated_knots() {
        let knots = Knots::new(&[-1.0, 0.0, 0.5, 0.5, 2.0, 3.0, 7.0, 7.0, 9.0], 3, 6).unwrap();
        assert_eq!(knots.domain(), (0.5, 7.0));
        assert_eq!(knots.breaks(0.5, 7.0), [0.5, 2.0, 3.0, 7.0]);
        for u in [0.5, 0.51, 1.9, 2.0, 2.5, 3.0, 6.9, 7.0] {
            let blend = knots.blend(u);
            let sum: f64 = blend.weights.iter().map(|(weight, _)| weight).sum();
            let slope: f64 = blend.weights.iter().map(|(_, slope)| slope).sum();
            assert!(
                (sum - 1.0).abs() < 1e-14 && slope.abs() < 1e-12,
                "{u}: {sum} {slope}"
            );
            assert!(blend.first + 3 <= 6);
        }
    }

    #[test]
    fn derivatives_are_those_of_the_values() {
        let knots = Knots::new(&[0.0, 0.0, 0.5, 1.0, 1.0, 2.5, 3.0, 4.0, 4.0], 4, 5).unwrap();
        assert_eq!(
            knots.intervals(1.5, 9.0),
            [(4, 1.5, 2.5)],
            "the domain ends at 2.5"
        );
        let (u, step) = (1.7, 1e-5);
        for times in [1, 2, 3] {
            let at = |u| knots.weights(4, u, times - 1);
            let (before, after) = (at(u - step), at(u + step));
            for (i, found) in knots.weights(4, u, times).into_iter().enumerate() {
                let slope = (after[i] - before[i]) / (2.0 * step);
                assert!((found - slope).abs() < 1e-6, "{found} {slope}");
            }
        }
        assert_eq!(knots.weights(4, u, 4), [0.0; 4]);
    }

    #[test]
    fn what_is_wrong_is_told_with_what_is_right() {
        let flaw = |knots: &[f32], order, count| Knots::new(knots, order, count).unwrap_err();
        assert!(flaw(&[0.0; 3], 2, 2).contains("needs 4"));
        assert!(flaw(&[0.0; 4], 1, 3).contains("order"));
        assert!(flaw(&[0.0; 4], 2, 2).contains("no range"));
        assert!(flaw(&[0.0, 1.0, 0.5, 2.0], 2, 2).contains("go down"));
        assert!(flaw(&[0.0, f32::NAN, 1.0, 2.0], 2, 2).contains("finite"));
    }
}
