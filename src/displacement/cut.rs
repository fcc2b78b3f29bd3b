//! Triangles cut at the middles of long edges, without gaps: whether an edge is cut hangs on the edge alone.

use glam::{DMat3, Vec2, Vec3};
use std::collections::HashMap;

/// Passes at most; each halves edges.
const MOST_PASSES: u32 = 12;

/// A triangle that lies on one of the mesh it was cut from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    /// That triangle.
    pub(super) base: u32,
    /// Positions of its corners.
    pub(super) corners: [u32; 3],
    /// Barycentric weights of the base's corners 1 and 2 at its own; exact.
    pub(super) at: [Vec2; 3],
}

/// A mesh cut finer, in the same places.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cut {
    /// The mesh's own positions, then the middles of edges.
    pub(super) positions: Vec<Vec3>,
    /// For every position beyond the mesh's own the two that it lies between.
    pub(super) ends: Vec<[u32; 2]>,
    /// Those of one base one after the other, in the order of the bases.
    pub(super) pieces: Vec<Piece>,
}

impl Cut {
    /// Nothing cut yet.
    pub(super) fn uncut(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let at = [Vec2::ZERO, Vec2::X, Vec2::Y];
        let bases = 0_u32..;
        let pieces = bases
            .zip(triangles)
            .map(|(base, &corners)| Piece { base, corners, at });
        Self {
            positions: positions.to_vec(),
            ends: Vec::new(),
            pieces: pieces.collect(),
        }
    }

    /// Cut the edges of triangles that `is_cut` says may be until none is longer than `longest` as `metric` has it, also
    /// where others share them. False (and cut in part) where that takes more than `most` triangles.
    pub(super) fn refine(
        &mut self,
        (metric, longest): (&DMat3, f64),
        is_cut: impl Fn(u32) -> bool,
        most: usize,
    ) -> bool {
        for _ in 0..MOST_PASSES {
            let middles = self.middles(|a, b| length(metric, b - a) > longest, &is_cut);
            if middles.is_empty() {
                return true;
            }
            let pieces = std::mem::take(&mut self.pieces);
            for piece in pieces {
                self.divide(piece, &middles, |edge| length(metric, edge));
            }
            if self.pieces.len() > most {
                return false;
            }
        }
        true
    }

    /// New positions in the middle of long edges of triangles that may be cut.
    fn middles(
        &mut self,
        is_long: impl Fn(Vec3, Vec3) -> bool,
        is_cut: &impl Fn(u32) -> bool,
    ) -> HashMap<[u32; 2], u32> {
        let mut middles = HashMap::new();
        for piece in self.pieces.iter().filter(|piece| is_cut(piece.base)) {
            for k in 0..3 {
                let key = edge(piece.corners[k], piece.corners[(k + 1) % 3]);
                let [a, b] = key.map(|i| self.positions[i as usize]);
                if middles.contains_key(&key) || !is_long(a, b) {
                    continue;
                }
                let number = u32::try_from(self.positions.len()).unwrap_or(u32::MAX);
                middles.insert(key, number);
                self.positions.push(0.5 * a + 0.5 * b);
                self.ends.push(key);
            }
        }
        middles
    }

    /// Push the parts of `piece`, of which some edges have middles.
    fn divide(
        &mut self,
        piece: Piece,
        middles: &HashMap<[u32; 2], u32>,
        length: impl Fn(Vec3) -> f64,
    ) {
        let [a, b, c] = [0, 1, 2].map(|k| (piece.corners[k], piece.at[k]));
        let middle = |(i, at): (u32, Vec2), (j, other): (u32, Vec2)| {
            let middle = middles.get(&edge(i, j))?;
            Some((*middle, 0.5 * (at + other)))
        };
        let distance = |(i, _): (u32, Vec2), (j, _): (u32, Vec2)| {
            length(self.positions[j as usize] - self.positions[i as usize])
        };
        let parts: Vec<[(u32, Vec2); 3]> = match [middle(a, b), middle(b, c), middle(c, a)] {
            [None, None, None] => vec![[a, b, c]],
            [Some(m), None, None] => vec![[a, m, c], [m, b, c]],
            [None, Some(m), None] => vec![[a, b, m], [a, m, c]],
            [None, None, Some(m)] => vec![[a, b, m], [m, b, c]],
            [Some(m), Some(n), None] => halved([m, b, n], [a, m, n, c], distance),
            [None, Some(m), Some(n)] => halved([m, c, n], [b, m, n, a], distance),
            [Some(n), None, Some(m)] => halved([m, a, n], [c, m, n, b], distance),
            [Some(l), Some(m), Some(n)] => vec![[a, l, n], [l, b, m], [n, m, c], [l, m, n]],
        };
        self.pieces.extend(parts.iter().map(|corners| Piece {
            base: piece.base,
            corners: corners.map(|(i, _)| i),
            at: corners.map(|(_, at)| at),
        }));
    }
}

/// A tip, and a quad along the shorter of its diagonals.
fn halved<T: Copy>(
    tip: [T; 3],
    [a, b, c, d]: [T; 4],
    distance: impl Fn(T, T) -> f64,
) -> Vec<[T; 3]> {
    match distance(a, c) <= distance(b, d) {
        true => vec![tip, [a, b, c], [a, c, d]],
        false => vec![tip, [a, b, d], [b, c, d]],
    }
}

fn edge(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Length of a vector as `metric` (`MᵀM` of what maps it to the world) has it.
pub(super) fn length(metric: &DMat3, vector: Vec3) -> f64 {
    let vector = vector.as_dvec3();
    vector.dot(*metric * vector).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Area vectors of the pieces, summed for each base.
    fn areas(cut: &Cut, bases: usize) -> Vec<Vec3> {
        let mut sums = vec![Vec3::ZERO; bases];
        for piece in &cut.pieces {
            let [a, b, c] = piece.corners.map(|i| cut.positions[i as usize]);
            sums[piece.base as usize] += 0.5 * (b - a).cross(c - a);
        }
        sums
    }

    /// A long triangle beside a small one.
    fn two() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let positions = vec![
            Vec3::ZERO,
            Vec3::new(4.0, 0.0, 0.0),
            Vec3::new(0.3, 1.0, 0.0),
            Vec3::new(-0.2, 0.9, 0.4),
        ];
        (positions, vec![[0, 1, 2], [0, 2, 3]])
    }

    #[test]
    fn pieces_cover_their_triangles_and_meet_edge_to_edge() {
        let (positions, triangles) = two();
        let mut cut = Cut::uncut(&positions, &triangles);
        let whole = areas(&cut, 2);
        assert!(cut.refine((&DMat3::IDENTITY, 0.3), |_| true, 10_000));
        for (before, after) in whole.iter().zip(areas(&cut, 2)) {
            assert!((*before - after).length() < 1e-5);
        }
        let mut edges: HashMap<[u32; 2], i32> = HashMap::new();
        for piece in &cut.pieces {
            for k in 0..3 {
                let [a, b] = [piece.corners[k], piece.corners[(k + 1) % 3]];
                *edges.entry(edge(a, b)).or_default() += 1;
                let at = |i: u32| cut.positions[i as usize];
                assert!((at(a) - at(b)).length() <= 0.3);
            }
        }
        // Those used once make up the outline: 4 + |(3.7, 1)| + 2 sides of the small one.
        let once = edges.iter().filter(|(_, count)| **count == 1);
        let outline: f32 = once
            .map(|([a, b], _)| (cut.positions[*a as usize] - cut.positions[*b as usize]).length())
            .sum();
        let expected = 4.0
            + Vec2::new(3.7, 1.0).length()
            + Vec3::new(0.5, 0.1, 0.4).length()
            + Vec3::new(0.2, 0.9, 0.4).length();
        assert!((outline - expected).abs() < 1e-4, "{outline} {expected}");
        assert!(edges.values().all(|count| *count <= 2));
    }

    #[test]
    fn weights_tell_where_pieces_lie_and_ends_where_middles_do() {
        let (positions, triangles) = two();
        let mut cut = Cut::uncut(&positions, &triangles);
        cut.refine((&DMat3::IDENTITY, 0.5), |base| base == 0, 10_000);
        assert!(cut.pieces.is_sorted_by_key(|piece| piece.base));
        for piece in &cut.pieces {
            let [a, b, c] = triangles[piece.base as usize].map(|i| positions[i as usize]);
            for (corner, at) in piece.corners.iter().zip(piece.at) {
                let expected = a + (b - a) * at.x + (c - a) * at.y;
                assert!(cut.positions[*corner as usize].distance(expected) < 1e-6);
            }
        }
        for (i, ends) in (positions.len()..).zip(&cut.ends) {
            let [a, b] = ends.map(|end| cut.positions[end as usize]);
            assert_eq!(cut.positions[i], 0.5 * a + 0.5 * b);
        }
    }

    #[test]
    fn too_many_are_told() {
        let (positions, triangles) = two();
        let mut cut = Cut::uncut(&positions, &triangles);
        assert!(!cut.refine((&DMat3::IDENTITY, 0.01), |_| true, 100));
    }
}
