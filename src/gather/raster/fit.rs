//! Light at some places across a window → light at all of them: a polynomial of second degree, by least squares.

use glam::{DVec3, Vec3};

/// 1, x, y, x², xy, y².
const TERMS: usize = 6;

/// Weight of places far from the center falls with this over this plus the square of their distance, in radii of the window:
/// what is told there counts little, other windows tell it too.
const CENTER: f64 = 0.3;

/// Keeps coefficients that the places do not tell at 0.
const RIDGE: f64 = 1e-4;

/// A polynomial in two variables, by color.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fit([DVec3; TERMS]);

impl Fit {
    /// Through the `values` at the places `across` as well as it can.
    pub(super) fn through(across: &[[f32; 2]], values: &[Vec3]) -> Self {
        let mut matrix = [[0.0; TERMS]; TERMS];
        let mut right = [DVec3::ZERO; TERMS];
        for (&place, value) in across.iter().zip(values) {
            let terms = terms(place);
            let weight = CENTER / (CENTER + terms[3] + terms[5]);
            for (row, &term) in terms.iter().enumerate() {
                for (column, &other) in terms.iter().enumerate() {
                    matrix[row][column] += weight * term * other;
                }
                right[row] += value.as_dvec3() * (weight * term);
            }
        }
        for (term, row) in matrix.iter_mut().enumerate() {
            row[term] += RIDGE;
        }
        Self(solved(matrix, right))
    }

    /// Its value at a place.
    pub(super) fn at(&self, place: [f32; 2]) -> Vec3 {
        let sum: DVec3 = (self.0.iter().zip(terms(place)))
            .map(|(&factor, term)| factor * term)
            .sum();
        sum.as_vec3()
    }
}

fn terms(place: [f32; 2]) -> [f64; TERMS] {
    let [x, y] = place.map(f64::from);
    [1.0, x, y, x * x, x * y, y * y]
}

/// What times the symmetric, positive `matrix` is `right`: Gauss without a choice of pivots.
fn solved(mut matrix: [[f64; TERMS]; TERMS], mut right: [DVec3; TERMS]) -> [DVec3; TERMS] {
    for step in 0..TERMS {
        let pivot = matrix[step];
        for row in step + 1..TERMS {
            let factor = matrix[row][step] / pivot[step];
            for (own, above) in matrix[row].iter_mut().zip(pivot).skip(step) {
                *own -= factor * above;
            }
            right[row] -= right[step] * factor;
        }
    }
    for step in (0..TERMS).rev() {
        let known: DVec3 = (step + 1..TERMS).map(|k| right[k] * matrix[step][k]).sum();
        right[step] = (right[step] - known) / matrix[step][step];
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_of_second_degree_come_back() {
        let value =
            |[x, y]: [f32; 2]| Vec3::new(2.0 + x - 3.0 * y, 1.0 + x * y, 4.0 - x * x + 0.5 * y * y);
        let places: Vec<[f32; 2]> = (0..49_u8)
            .map(|k| [f32::from(k % 7) / 3.0 - 1.0, f32::from(k / 7) / 3.0 - 1.0])
            .collect();
        let values: Vec<Vec3> = places.iter().map(|&place| value(place)).collect();
        let fit = Fit::through(&places, &values);
        for place in [[0.0, 0.0], [0.9, -0.3], [-1.0, 1.0]] {
            let off = (fit.at(place) - value(place)).abs().max_element();
            assert!(off < 1e-3, "{place:?}: {off}");
        }
    }

    #[test]
    fn places_on_a_line_tell_what_lies_on_it() {
        let places: Vec<[f32; 2]> = (0..9_u8).map(|k| [f32::from(k) / 4.0 - 1.0, 0.0]).collect();
        let values: Vec<Vec3> = places.iter().map(|[x, _]| Vec3::splat(1.0 + x)).collect();
        let fit = Fit::through(&places, &values);
        assert!((fit.at([0.5, 0.0]) - Vec3::splat(1.5)).abs().max_element() < 1e-3);
        assert!(fit.at([0.5, 1.0]).is_finite());
    }
}
