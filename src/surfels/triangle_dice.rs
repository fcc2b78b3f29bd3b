//! How one triangle is cut into compact cells of nearly equal size, in barycentric terms. PBGI §4.
//!
//! A triangle is one or two [`Part`]s. A part is a triangle with a *tip*: rows run parallel to the edge opposite the
//! tip, and every row is cut into equal columns, as many as its width asks for. One part, with the shortest edge
//! opposite the tip, suits needles and well-shaped triangles; a flat obtuse triangle is first cut at its altitude on
//! the longest edge. Cells are then compact at any aspect ratio, all cells of a row have the same area, and a point
//! finds its cell without a search.

use glam::{DVec3, Vec3};

/// A triangle whose longest edge is below this many spacings is one cell: its area is then at most 0.97 spacing².
const WHOLE_BELOW: f64 = 1.5;

/// Below this sine of the angle between base and median a triangle is cut at its altitude: cells would be so skewed
/// that corners lie farther than 1.5 spacings from their middle. Of 1.6 million random triangles none has such a cell;
/// at 0.8 two of three runs of 300 thousand found one, at 0.7 one in a thousand has.
const SKEWED_BELOW: f64 = 0.85;

/// Weights of a triangle's three corners.
pub type Barycentric = Vec3;

const CORNERS: [Barycentric; 3] = [Vec3::X, Vec3::Y, Vec3::Z];

/// Rows and columns of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Grid {
    /// Rows, counted from the tip; at least 1.
    rows: u16,
    /// Columns that the edge opposite the tip asks for; at least 1.
    columns: u16,
    /// In a triangle of two parts: the tip is the apex rather than the end of the longest edge.
    tip_at_apex: bool,
}

impl Grid {
    fn new(length: f64, width: f64, spacing: f64) -> Self {
        Self {
            rows: division(length / spacing),
            columns: division(width / spacing),
            tip_at_apex: false,
        }
    }

    /// For a right triangle: rows across the longer leg, so that the first row is one compact cell.
    fn of_right_triangle(along_edge: f64, altitude: f64, spacing: f64) -> Self {
        Self {
            tip_at_apex: altitude > along_edge,
            ..Self::new(along_edge.max(altitude), along_edge.min(altitude), spacing)
        }
    }
}

/// Nearest whole number of cells, from 1 to `u16::MAX`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the range of u16; NaN becomes 0 and then 1"
)]
fn division(cells: f64) -> u16 {
    (cells.round().clamp(1.0, f64::from(u16::MAX)) as u16).max(1)
}

/// Rows of cells below a tip; what [`TriangleDice`] consists of, unpacked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Where all columns meet.
    tip: Barycentric,
    /// Ends of the edge opposite the tip.
    ends: [Barycentric; 2],
    rows: u32,
    columns: u32,
    /// Share of the triangle's area.
    area: f32,
}

/// One row of a [`Part`]: where its cells stand in the numbering of the triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row {
    /// Which row, from the tip.
    pub index: u32,
    /// Number of its first cell within the part.
    pub first: u32,
    /// Number of its cells.
    pub count: u32,
}

/// One cell of a [`Row`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Centroid.
    pub center: Barycentric,
    /// Corners; the first two coincide at a tip.
    pub corners: [Barycentric; 4],
    /// Share of the triangle's area.
    pub area: f32,
}

#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "rows and columns are below 2^16, products of three below 2^50 and summed as u64"
)]
impl Part {
    /// The whole triangle as one cell.
    pub const WHOLE: Self = Self {
        tip: Vec3::X,
        ends: [Vec3::Y, Vec3::Z],
        rows: 1,
        columns: 1,
        area: 1.0,
    };

    /// Number of rows.
    pub fn row_count(&self) -> u32 {
        self.rows
    }

    /// Number of cells.
    pub fn cell_count(&self) -> u32 {
        self.cells_before(self.rows)
    }

    /// Row `index` (below [`Self::row_count`]).
    pub fn row(&self, index: u32) -> Row {
        Row {
            index,
            first: self.cells_before(index),
            count: self.columns_of(index),
        }
    }

    /// Columns of a row: its middle width over the column width, rounded, at least 1.
    fn columns_of(&self, row: u32) -> u32 {
        (((2 * row + 1) * self.columns + self.rows) / (2 * self.rows)).max(1)
    }

    /// Cells in rows `0..row`, in O(log rows).
    fn cells_before(&self, row: u32) -> u32 {
        let (rows, columns) = (u64::from(self.rows), u64::from(self.columns));
        // The rows near the tip whose rounded width is 0 and that have one cell all the same.
        let narrow = (rows + columns - 1) / (2 * columns) * u64::from(rows > columns);
        let row = u64::from(row);
        (floor_sum(row, 2 * rows, 2 * columns, rows + columns) + row.min(narrow)) as u32
    }

    /// Point at `depth` (0 at the tip, 1 at the opposite edge) and `across` (0…1 along that edge).
    fn at(&self, depth: f32, across: f32) -> Barycentric {
        let edge = self.ends[0] * (1.0 - across) + self.ends[1] * across;
        self.tip * (1.0 - depth) + edge * depth
    }

    /// Cell `column` of `row`, with exact centroid and area.
    pub fn cell(&self, row: Row, column: u32) -> Cell {
        let rows = self.rows as f32;
        let (top, bottom) = (row.index as f32 / rows, (row.index + 1) as f32 / rows);
        let columns = row.count as f32;
        let (left, right) = (column as f32 / columns, (column + 1) as f32 / columns);
        // Width grows linearly with depth: ∫ depth² / ∫ depth over the row.
        let depth = 2.0 / 3.0 * (top * top + top * bottom + bottom * bottom) / (top + bottom);
        Cell {
            center: self.at(depth, 0.5 * (left + right)),
            corners: [
                self.at(top, left),
                self.at(top, right),
                self.at(bottom, right),
                self.at(bottom, left),
            ],
            area: self.area * (bottom - top) * (bottom + top) / columns,
        }
    }

    /// The middle of quarter `quarter` (0…3) of a cell; the four quarters have equal areas.
    pub fn quarter(&self, row: Row, column: u32, quarter: u32) -> Barycentric {
        let rows = self.rows as f32;
        let (top, bottom) = (row.index as f32 / rows, (row.index + 1) as f32 / rows);
        let (down, along) = ((quarter / 2) as f32, (quarter % 2) as f32);
        let depth = (top * top + (bottom * bottom - top * top) * (0.25 + 0.5 * down)).sqrt();
        self.at(
            depth,
            (column as f32 + 0.25 + 0.5 * along) / row.count as f32,
        )
    }
}

/// Number of the cell at `weights` of tip and ends in the part whose rows begin with the cells `starts`, which ends with
/// the end of the last row; points outside count for the nearest row and column.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "rows and columns are below 2^16"
)]
fn cell_in(starts: &[u32], [tip, left, right]: [f32; 3]) -> u32 {
    let last = starts.len() - 2;
    let row = (((1.0 - tip) * (last + 1) as f32) as usize).min(last);
    let (first, count) = (starts[row], starts[row + 1] - starts[row]);
    let across = right / (left + right).max(f32::MIN_POSITIVE);
    first + ((across * count as f32) as u32).min(count - 1)
}

/// How a triangle of more than one cell is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangleDice {
    /// Number of its first cell within its prim.
    first: u32,
    /// Where its rows begin among those of its prim.
    rows_at: u32,
    /// Foot of the altitude on the longest edge, 0…1; 0 = one part only.
    foot: f32,
    grids: [Grid; 2],
    /// The corner opposite the shortest edge (one part) or the longest edge (two parts).
    apex: u8,
}

/// How a triangle is diced at some spacing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Dicing {
    /// It has no area (or it is not finite): no cell.
    Nothing,
    /// One cell.
    Whole,
    /// Several.
    Cells(TriangleDice),
}

impl Dicing {
    /// Cut the triangle with these corners into cells of about `spacing`² each. Sides of cells are below about
    /// 1.5 `spacing`.
    pub fn new(corners: [Vec3; 3], spacing: f32) -> Self {
        let p = corners.map(|corner| corner.as_dvec3());
        let spacing = f64::from(spacing);
        // Edge k lies opposite corner k.
        let edge = |k: usize| p[(k + 2) % 3] - p[(k + 1) % 3];
        let squares = [0, 1, 2].map(|k| edge(k).length_squared());
        let cross = edge(2).cross(edge(0));
        if !(cross.length_squared() > 0.0 && cross.length_squared().is_finite()) {
            return Self::Nothing;
        }
        let pick = |a: usize, b: usize, take_b: bool| if take_b { b } else { a };
        let shorter = |a: usize, b: usize| pick(a, b, squares[b] < squares[a]);
        let longer = |a: usize, b: usize| pick(a, b, squares[b] > squares[a]);
        let shortest = shorter(shorter(0, 1), 2);
        let longest = longer(longer(0, 1), 2);
        if squares[longest] <= (WHOLE_BELOW * spacing).powi(2) {
            return Self::Whole;
        }
        let area = 0.5 * cross.length();
        let base = squares[shortest].sqrt();
        let median = p[shortest].distance(p[(shortest + 1) % 3].midpoint(p[(shortest + 2) % 3]));
        let sine = 2.0 * area / (base * median);
        if base < WHOLE_BELOW * spacing || sine >= SKEWED_BELOW {
            let squash = if base < WHOLE_BELOW * spacing {
                1.0
            } else {
                sine.sqrt()
            };
            return Self::one_part(shortest, Grid::new(median * squash, base * squash, spacing));
        }
        Self::two_parts(p, longest, area, spacing)
    }

    fn one_part(apex: usize, grid: Grid) -> Self {
        if grid.rows == 1 && grid.columns == 1 {
            return Self::Whole;
        }
        Self::Cells(TriangleDice {
            first: 0,
            rows_at: 0,
            foot: 0.0,
            grids: [grid; 2],
            apex: corner_number(apex),
        })
    }

    fn two_parts(p: [DVec3; 3], apex: usize, area: f64, spacing: f64) -> Self {
        let (start, end) = (p[(apex + 1) % 3], p[(apex + 2) % 3]);
        let edge = end - start;
        let length = edge.length();
        let foot = as_f32((p[apex] - start).dot(edge) / edge.length_squared());
        let foot = foot.clamp(f32::EPSILON, 1.0 - f32::EPSILON);
        let along = f64::from(foot) * length;
        let altitude = 2.0 * area / length;
        Self::Cells(TriangleDice {
            first: 0,
            rows_at: 0,
            foot,
            grids: [
                Grid::of_right_triangle(along, altitude, spacing),
                Grid::of_right_triangle(length - along, altitude, spacing),
            ],
            apex: corner_number(apex),
        })
    }

    /// Number of cells.
    pub fn cell_count(&self) -> u32 {
        match self {
            Self::Nothing => 0,
            Self::Whole => 1,
            Self::Cells(dice) => dice.parts().map(|part| part.cell_count()).sum(),
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a corner is 0, 1 or 2")]
fn corner_number(corner: usize) -> u8 {
    corner as u8
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a fraction, rounded to f32"
)]
fn as_f32(fraction: f64) -> f32 {
    fraction as f32
}

impl TriangleDice {
    /// Number of its first cell within its prim.
    pub fn first(&self) -> u32 {
        self.first
    }

    /// The same cut with its cells numbered from `first`; appends the numbers of the first cells of its rows, and where
    /// they end, to `row_starts`.
    ///
    /// # Panics
    /// With more than 2³² rows.
    #[must_use]
    pub fn placed(self, first: u32, row_starts: &mut Vec<u32>) -> Self {
        let rows_at = u32::try_from(row_starts.len()).expect("rows are numbered with 32 bits");
        let mut start = first;
        for part in self.parts() {
            for row in 0..part.row_count() {
                row_starts.push(start);
                start += part.columns_of(row);
            }
        }
        row_starts.push(start);
        Self {
            first,
            rows_at,
            ..self
        }
    }

    fn is_split(&self) -> bool {
        self.foot > 0.0
    }

    /// Its one or two parts, in the order of their cells.
    pub fn parts(&self) -> impl Iterator<Item = Part> + use<> {
        let this = *self;
        (0..if this.is_split() { 2 } else { 1 }).map(move |side| this.part(side))
    }

    fn part(&self, side: usize) -> Part {
        let corner = |k: usize| CORNERS[(usize::from(self.apex) + k) % 3];
        let grid = self.grids[side];
        let (apex, start, end) = (corner(0), corner(1), corner(2));
        let foot = start * (1.0 - self.foot) + end * self.foot;
        let (tip, ends, area) = match (self.is_split(), side, grid.tip_at_apex) {
            (false, ..) => (apex, [start, end], 1.0),
            (true, 0, false) => (start, [foot, apex], self.foot),
            (true, 0, true) => (apex, [start, foot], self.foot),
            (true, _, false) => (end, [apex, foot], 1.0 - self.foot),
            (true, _, true) => (apex, [foot, end], 1.0 - self.foot),
        };
        Part {
            tip,
            ends,
            rows: u32::from(grid.rows),
            columns: u32::from(grid.columns),
            area,
        }
    }

    /// Number (within its prim) of the cell at `point`, once [`Self::placed`] with `row_starts`.
    pub fn cell_at(&self, point: Barycentric, row_starts: &[u32]) -> u32 {
        let rows = self.grids.map(|grid| usize::from(grid.rows));
        let starts = &row_starts[self.rows_at as usize..];
        let weight = |k: usize| point[(usize::from(self.apex) + k) % 3];
        let (apex, start, end) = (weight(0), weight(1), weight(2));
        if !self.is_split() {
            return cell_in(&starts[..=rows[0]], [apex, start, end]);
        }
        // The point in terms of (start, foot, apex) or (foot, end, apex).
        let before_foot = start * self.foot - end * (1.0 - self.foot);
        if before_foot >= 0.0 {
            let (start, foot) = (before_foot / self.foot, end / self.foot);
            let weights = if self.grids[0].tip_at_apex {
                [apex, start, foot]
            } else {
                [start, foot, apex]
            };
            cell_in(&starts[..=rows[0]], weights)
        } else {
            let rest = 1.0 - self.foot;
            let (end, foot) = (-before_foot / rest, start / rest);
            let weights = if self.grids[1].tip_at_apex {
                [apex, foot, end]
            } else {
                [end, apex, foot]
            };
            cell_in(&starts[rows[0]..=rows[0] + rows[1]], weights)
        }
    }
}

/// Σ ⌊(a·i + b) / m⌋ over `i` in `0..n`, in O(log m): what lies below a line on a grid, folded as in Euclid's
/// algorithm.
fn floor_sum(n: u64, m: u64, a: u64, b: u64) -> u64 {
    if n == 0 {
        return 0;
    }
    let whole = n * (n - 1) / 2 * (a / m) + n * (b / m);
    let (a, b) = (a % m, b % m);
    let highest = a * n + b;
    if highest < m {
        return whole;
    }
    // Count the same lattice points row by row instead of column by column.
    whole + floor_sum(highest / m, a, m, highest % m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn area(c: [Vec3; 3]) -> f64 {
        let [a, b, c] = c.map(|p| p.as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    }

    fn at(c: [Vec3; 3], w: Barycentric) -> Vec3 {
        c[0] * w.x + c[1] * w.y + c[2] * w.z
    }

    fn corners() -> impl Strategy<Value = [Vec3; 3]> {
        let plain = prop::array::uniform9(-1.0_f32..1.0);
        (plain, 0.0001_f32..1.0, 0..3_usize).prop_map(|(c, flat, axis)| {
            let mut p = [0, 3, 6].map(|i| Vec3::new(c[i], c[i + 1], c[i + 2]));
            // Slivers of every kind: squash one axis.
            p.iter_mut().for_each(|p| p[axis] *= flat);
            p
        })
    }

    fn cells(dice: &TriangleDice) -> Vec<Cell> {
        dice.parts()
            .flat_map(|part| {
                (0..part.row_count()).flat_map(move |row| {
                    let row = part.row(row);
                    (0..row.count).map(move |column| part.cell(row, column))
                })
            })
            .collect()
    }

    #[test]
    fn floor_sums_equal_their_definition() {
        for (n, m, a, b) in [
            (0, 3, 2, 1),
            (7, 3, 2, 1),
            (20, 14, 26, 20),
            (100, 1, 5, 3),
            (9, 10, 1, 0),
        ] {
            let direct: u64 = (0..n).map(|i| (a * i + b) / m).sum();
            assert_eq!(floor_sum(n, m, a, b), direct);
        }
    }

    #[test]
    fn cells_are_numbered_row_by_row_without_gaps() {
        for rows in 1..40 {
            for columns in 1..60 {
                let part = Part {
                    rows,
                    columns,
                    ..Part::WHOLE
                };
                let mut next = 0;
                for row in (0..rows).map(|row| part.row(row)) {
                    assert_eq!(row.first, next);
                    next += row.count;
                }
                assert_eq!(part.cell_count(), next);
            }
        }
    }

    proptest! {
        #[test]
        fn cells_tile_the_triangle_and_stay_compact(c in corners(), spacing in 0.02_f32..0.5) {
            let Dicing::Cells(dice) = Dicing::new(c, spacing) else { return Ok(()) };
            let mut total = 0.0;
            let mut moment = Vec3::ZERO;
            for cell in cells(&dice) {
                total += f64::from(cell.area);
                moment += cell.center * cell.area;
                let radius = cell.corners.iter().map(|&w| at(c, w).distance(at(c, cell.center))).fold(0.0, f32::max);
                prop_assert!(radius < 1.5 * spacing, "radius {radius} at spacing {spacing}");
                // The corners' polygon has the area it claims.
                let [a, b, d, e] = cell.corners.map(|w| at(c, w));
                let polygon = area([a, b, d]) + area([a, d, e]);
                prop_assert!((polygon - f64::from(cell.area) * area(c)).abs() < 1e-4 * area(c) + 1e-9);
            }
            prop_assert!((total - 1.0).abs() < 1e-4);
            // Area-weighted centers of the cells are the centroid of the triangle.
            prop_assert!((moment - Vec3::splat(1.0 / 3.0)).abs().max_element() < 1e-4);
        }

        #[test]
        fn every_point_lies_in_the_cell_it_finds(c in corners(), spacing in 0.02_f32..0.5, a in 0.0_f32..1.0, b in 0.0_f32..1.0) {
            let Dicing::Cells(dice) = Dicing::new(c, spacing) else { return Ok(()) };
            let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
            let point = Vec3::new(1.0 - a - b, a, b);
            let cells = cells(&dice);
            let mut row_starts = vec![3];
            let dice = dice.placed(7, &mut row_starts);
            let cell = cells[(dice.cell_at(point, &row_starts) - 7) as usize];
            // In barycentric coordinates (y, z) the cell is a convex quadrangle: the point is on one side of all edges.
            let flat = |w: Vec3| (w.y, w.z);
            let mut signs = (0.0_f32, 0.0_f32);
            for k in 0..4 {
                let (p, q, r) = (flat(cell.corners[k]), flat(cell.corners[(k + 1) % 4]), flat(point));
                let side = (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0);
                signs = (signs.0.min(side), signs.1.max(side));
            }
            prop_assert!(signs.0.abs().min(signs.1) < 2e-6, "{signs:?}");
        }

        #[test]
        fn quarters_of_a_cell_find_the_cell(c in corners(), spacing in 0.05_f32..0.5) {
            let Dicing::Cells(dice) = Dicing::new(c, spacing) else { return Ok(()) };
            let mut row_starts = Vec::new();
            let dice = dice.placed(0, &mut row_starts);
            let mut number = 0;
            for part in dice.parts() {
                for row in (0..part.row_count()).map(|row| part.row(row)) {
                    for column in 0..row.count {
                        for quarter in 0..4 {
                            prop_assert_eq!(dice.cell_at(part.quarter(row, column, quarter), &row_starts), number);
                        }
                        number += 1;
                    }
                }
            }
            prop_assert_eq!(number, Dicing::Cells(dice).cell_count());
        }
    }

    #[test]
    fn a_large_square_gets_about_area_over_spacing_squared_cells() {
        let [a, b, c, d] = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
        let count: u32 = [[a, b, c], [a, c, d]]
            .map(|t| Dicing::new(t, 0.01).cell_count())
            .iter()
            .sum();
        assert!((9_500..10_500).contains(&count), "{count}");
    }

    #[test]
    fn flat_caps_and_needles_are_not_over_diced() {
        // Ideal: area / spacing². A needle one cell wide needs length / spacing.
        let cap = [Vec3::ZERO, Vec3::X * 10.0, Vec3::new(5.0, 2.0, 0.0)];
        let count = Dicing::new(cap, 0.1).cell_count();
        assert!((900..1200).contains(&count), "{count}");
        let needle = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 0.001, 0.0)];
        assert_eq!(Dicing::new(needle, 0.1).cell_count(), 10);
    }

    #[test]
    fn degenerate_and_broken_triangles_have_no_cells() {
        for c in [
            [Vec3::ZERO; 3],
            [Vec3::ZERO, Vec3::X, Vec3::X * 2.0],
            [Vec3::ZERO, Vec3::X, Vec3::NAN],
            [Vec3::ZERO, Vec3::X, Vec3::INFINITY],
        ] {
            assert_eq!(Dicing::new(c, 0.1), Dicing::Nothing);
        }
    }
}
