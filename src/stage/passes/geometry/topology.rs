//! The authored faces of a mesh, checked: what everything after can index without asking again.

use super::super::super::Error;
use super::super::super::raw::RawPrim;
use super::attributes::{ints, token};
use crate::diagnostics::Diagnostics;
use std::borrow::Cow;

/// The attributes that faces are made of.
pub(super) const ARRAYS: [&str; 2] = ["faceVertexCounts", "faceVertexIndices"];

/// Valid faces over `point_count` points: counts and indices agree, every index is in range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Topology<'a> {
    pub(super) point_count: usize,
    pub(super) counts: Cow<'a, [u32]>,
    pub(super) indices: Cow<'a, [u32]>,
    /// First face-vertex of every face, and the total at the end.
    pub(super) offsets: Vec<u32>,
    /// False for holes and for faces of fewer than three vertices.
    pub(super) is_drawn: Vec<bool>,
}

impl<'a> Topology<'a> {
    /// Read and check the faces of `prim`; holes that name no face and faces of fewer than three vertices are
    /// left out with a warning.
    #[cfg(test)]
    pub(super) fn read(
        prim: &'a RawPrim,
        point_count: usize,
        diagnostics: &Diagnostics,
    ) -> Result<Self, Error> {
        let [counts, indices] = ARRAYS.map(|name| Cow::Borrowed(ints(prim, name)));
        Self::of(prim, (counts, indices), point_count, diagnostics)
    }

    /// The same of the arrays that `prim` has, or had, by the names [`ARRAYS`].
    pub(super) fn of(
        prim: &RawPrim,
        (counts, indices): (Cow<'a, [i32]>, Cow<'a, [i32]>),
        point_count: usize,
        diagnostics: &Diagnostics,
    ) -> Result<Self, Error> {
        let fail = |message: String| Error::Mesh {
            prim: prim.path.clone(),
            message,
        };
        let counts = checked_counts(counts).map_err(fail)?;
        let indices = checked_indices(indices, point_count).map_err(fail)?;
        let offsets = offsets(&counts, indices.len()).map_err(fail)?;
        let is_drawn = drawn_faces(prim, &counts, diagnostics);
        Ok(Self {
            point_count,
            counts,
            indices,
            offsets,
            is_drawn,
        })
    }

    /// The same, of no prim.
    #[cfg(test)]
    pub(super) fn into_owned(self) -> Topology<'static> {
        Topology {
            counts: self.counts.into_owned().into(),
            indices: self.indices.into_owned().into(),
            ..self
        }
    }

    /// Number of authored faces.
    pub(super) fn face_count(&self) -> usize {
        self.counts.len()
    }

    /// Face-vertices of `face`.
    pub(super) fn corners(&self, face: usize) -> std::ops::Range<usize> {
        self.offsets[face] as usize..self.offsets[face + 1] as usize
    }

    /// Points of `face` in authored order.
    pub(super) fn points_of(&self, face: usize) -> &[u32] {
        &self.indices[self.corners(face)]
    }

    /// Faces that are drawn, in order.
    pub(super) fn drawn(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.face_count()).filter(|&face| self.is_drawn[face])
    }

    /// Open edges and whether there are none at all.
    pub(super) fn boundary(&self) -> Boundary {
        let mut buckets = EdgeBuckets::of(self);
        let mut boundary = Boundary {
            is_closed: !buckets.uses.is_empty(),
            on_boundary: vec![false; self.point_count],
        };
        for low in 0..self.point_count {
            let uses =
                &mut buckets.uses[buckets.offsets[low] as usize..buckets.offsets[low + 1] as usize];
            sort_few(uses);
            for edge in uses.chunk_by(|a, b| a.0 == b.0) {
                if let [(high, _)] = edge {
                    boundary.on_boundary[low] = true;
                    boundary.on_boundary[*high as usize] = true;
                }
                boundary.is_closed &= matches!(edge, [(_, false), (_, true)]);
            }
        }
        boundary
    }
}

/// By insertion where that is soonest: most points have three edges to higher ones, used twice each.
fn sort_few(uses: &mut [(u32, bool)]) {
    if uses.len() > 16 {
        uses.sort_unstable();
        return;
    }
    for end in 1..uses.len() {
        let mut at = end;
        while at > 0 && uses[at - 1] > uses[at] {
            uses.swap(at - 1, at);
            at -= 1;
        }
    }
}

/// See [`Topology::boundary`].
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Boundary {
    /// Every edge is used exactly twice, in opposite directions.
    pub(super) is_closed: bool,
    /// One a point: it lies on an edge that one face only uses.
    pub(super) on_boundary: Vec<bool>,
}

/// Every use of an edge by a drawn face, sorted by its lower point: linear, where sorting all edges is not.
struct EdgeBuckets {
    offsets: Vec<u32>,
    /// Higher point, and whether the face runs from the higher to the lower.
    uses: Vec<(u32, bool)>,
}

impl EdgeBuckets {
    fn of(topology: &Topology<'_>) -> Self {
        let mut offsets = vec![0_u32; topology.point_count + 1];
        each_edge(topology, |from, to| {
            offsets[from.min(to) as usize + 1] += 1;
        });
        for point in 0..topology.point_count {
            offsets[point + 1] += offsets[point];
        }
        let mut next = offsets.clone();
        let mut uses = vec![(0, false); offsets[topology.point_count] as usize];
        each_edge(topology, |from, to| {
            let slot = &mut next[from.min(to) as usize];
            uses[*slot as usize] = (from.max(to), from > to);
            *slot += 1;
        });
        Self { offsets, uses }
    }
}

/// Directed edges of all drawn faces.
fn each_edge(topology: &Topology, mut edge: impl FnMut(u32, u32)) {
    for face in topology.drawn() {
        let points = topology.points_of(face);
        let mut from = points[points.len() - 1];
        for &to in points {
            edge(from, to);
            from = to;
        }
    }
}

fn checked_counts(authored: Cow<'_, [i32]>) -> Result<Cow<'_, [u32]>, String> {
    match authored.iter().position(|&count| count < 0) {
        Some(face) => Err(format!(
            "face {face} has a vertex count of {}, it must be 3 or more",
            authored[face]
        )),
        None => Ok(without_sign(authored)),
    }
}

fn checked_indices(authored: Cow<'_, [i32]>, point_count: usize) -> Result<Cow<'_, [u32]>, String> {
    let is_out = |index: &i32| usize::try_from(*index).map_or(true, |index| index >= point_count);
    match authored.iter().find(|index| is_out(index)) {
        Some(index) => Err(format!(
            "face vertex index {index} is out of range, the mesh has {point_count} points"
        )),
        None => Ok(without_sign(authored)),
    }
}

/// Numbers of which none is below 0.
fn without_sign(numbers: Cow<'_, [i32]>) -> Cow<'_, [u32]> {
    match numbers {
        Cow::Borrowed(numbers) => Cow::Borrowed(bytemuck::cast_slice(numbers)),
        Cow::Owned(numbers) => Cow::Owned(bytemuck::cast_vec(numbers)),
    }
}

fn offsets(counts: &[u32], index_count: usize) -> Result<Vec<u32>, String> {
    let total: u64 = counts.iter().map(|&count| u64::from(count)).sum();
    if total != index_count as u64 || u32::try_from(total).is_err() {
        return Err(format!(
            "faceVertexIndices has {index_count} entries, the sum of faceVertexCounts asks for {total} (at most {})",
            u32::MAX
        ));
    }
    let mut offsets = Vec::with_capacity(counts.len() + 1);
    offsets.push(0);
    offsets.extend(counts.iter().scan(0, |end, &count| {
        *end += count;
        Some(*end)
    }));
    Ok(offsets)
}

fn drawn_faces(prim: &RawPrim, counts: &[u32], diagnostics: &Diagnostics) -> Vec<bool> {
    let mut is_drawn: Vec<bool> = counts.iter().map(|&count| count >= 3).collect();
    let small = is_drawn.iter().filter(|&&drawn| !drawn).count();
    if small > 0 {
        diagnostics.warn(
            "degenerate-face",
            prim.path.clone(),
            format!("{small} faces have fewer than 3 vertices and are not drawn"),
        );
    }
    let mut unknown = 0;
    for &hole in ints(prim, "holeIndices") {
        match usize::try_from(hole)
            .ok()
            .and_then(|face| is_drawn.get_mut(face))
        {
            Some(drawn) => *drawn = false,
            None => unknown += 1,
        }
    }
    if unknown > 0 {
        diagnostics.warn(
            "bad-hole",
            prim.path.clone(),
            format!(
                "{unknown} holeIndices are ignored, the mesh has {} faces",
                counts.len()
            ),
        );
    }
    is_drawn
}

/// True if the front of the faces follows the left hand.
pub(super) fn is_left_handed(prim: &RawPrim) -> bool {
    token(prim, "orientation", "rightHanded") == "leftHanded"
}

#[cfg(test)]
mod tests {
    use super::super::tests::{mesh, with_ints};
    use super::*;
    use glam::Vec3;

    fn read(
        counts: &[i32],
        indices: &[i32],
        point_count: usize,
    ) -> Result<Topology<'static>, Error> {
        let prim = mesh("/m", &[Vec3::ZERO], counts, indices);
        let read = Topology::read(&prim, point_count, &Diagnostics::default());
        read.map(Topology::into_owned)
    }

    #[test]
    fn errors_name_the_index_and_what_would_be_right() {
        let message =
            |counts: &[i32], indices: &[i32]| read(counts, indices, 3).unwrap_err().to_string();
        assert_eq!(
            message(&[3], &[0, 1, 3]),
            "mesh /m: face vertex index 3 is out of range, the mesh has 3 points"
        );
        assert!(message(&[3], &[0, -1, 2]).contains("index -1 is out of range"));
        assert!(
            message(&[4], &[0, 1, 2])
                .contains("has 3 entries, the sum of faceVertexCounts asks for 4")
        );
        assert!(message(&[-3], &[]).contains("face 0 has a vertex count of -3"));
    }

    #[test]
    fn holes_and_faces_of_two_vertices_are_not_drawn() {
        let prim = mesh(
            "/m",
            &[Vec3::ZERO; 3],
            &[3, 2, 3],
            &[0, 1, 2, 0, 1, 2, 1, 0],
        );
        let prim = with_ints(prim, "holeIndices", &[0, 7]);
        let diagnostics = Diagnostics::default();
        let topology = Topology::read(&prim, 3, &diagnostics).unwrap();
        assert_eq!(topology.is_drawn, [false, false, true]);
        let kinds: Vec<_> = diagnostics.warnings().into_iter().map(|w| w.kind).collect();
        assert_eq!(kinds, ["bad-hole", "degenerate-face"]);
    }

    #[test]
    fn a_tetrahedron_is_closed_and_open_once_a_face_is_a_hole() {
        let indices = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3];
        let mut tetrahedron = read(&[3; 4], &indices, 5).unwrap();
        let boundary = tetrahedron.boundary();
        assert!(boundary.is_closed);
        assert_eq!(boundary.on_boundary, [false; 5]);
        tetrahedron.is_drawn[0] = false;
        let boundary = tetrahedron.boundary();
        assert!(!boundary.is_closed);
        assert_eq!(boundary.on_boundary, [true, true, true, false, false]);
    }

    #[test]
    fn faces_that_run_along_an_edge_in_the_same_direction_do_not_close_it() {
        let twice = read(&[3, 3], &[0, 1, 2, 0, 1, 2], 3).unwrap();
        assert!(!twice.boundary().is_closed);
        let both_sides = read(&[3, 3], &[0, 1, 2, 2, 1, 0], 3).unwrap();
        assert!(both_sides.boundary().is_closed);
    }

    #[test]
    fn a_mesh_without_faces_is_not_closed() {
        assert!(!read(&[], &[], 3).unwrap().boundary().is_closed);
    }
}
