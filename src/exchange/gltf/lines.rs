//! Lines → a `BasisCurves` prim a primitive: linear, one curve a line; loops close.

use super::meshes::{self, Columns};
use super::nodes::Job;
use crate::exchange::Error;
use crate::writers::usd::author::Data;
use gltf::mesh::Mode;

/// Lines have no width in glTF: they are this part of the diagonal of their box wide.
const WIDTH: f32 = 1e-3;

/// Vertices of all curves, and how many each has.
struct Lines {
    vertices: Vec<u32>,
    counts: Vec<i32>,
    /// The last vertex of each is connected to its first.
    close: bool,
}

impl Lines {
    /// What the vertices `corners` are in `mode`. Lines that go on from where the one before ends are one curve with it.
    fn new(mode: Mode, corners: Vec<u32>) -> Self {
        let pairs: Vec<[u32; 2]> = match mode {
            Mode::Lines => corners.chunks_exact(2).map(|c| [c[0], c[1]]).collect(),
            _ => corners.windows(2).map(|c| [c[0], c[1]]).collect(),
        };
        let mut lines = Self {
            vertices: Vec::with_capacity(corners.len()),
            counts: Vec::new(),
            // two vertices are one line, there and back
            close: mode == Mode::LineLoop && corners.len() > 2,
        };
        for [from, to] in pairs {
            match lines.counts.last_mut() {
                Some(count) if lines.vertices.last() == Some(&from) => *count += 1,
                _ => {
                    lines.vertices.push(from);
                    lines.counts.push(2);
                }
            }
            lines.vertices.push(to);
        }
        lines
    }
}

/// Write the lines of `primitive`, which has `columns` at its vertices, at `path`.
pub(super) fn write(
    job: &mut Job<'_>,
    primitive: &gltf::Primitive<'_>,
    (columns, corners): (Columns, Vec<u32>),
    path: &str,
) -> Result<(), Error> {
    let lines = Lines::new(primitive.mode(), corners);
    let mut columns = columns.at(&lines.vertices);
    if columns.normals.take().is_some() {
        job.lost(
            path,
            "the normals of its lines are left out: curves that have some are ribbons",
        );
    }
    let (low, high) = meshes::bounds(&columns.positions);
    let width = WIDTH * (high - low).length();
    let message = format!("lines have no width in glTF: they are made {width} wide");
    job.diagnostics.warn("width", path, message);
    let author = &mut job.author;
    author.define(path, "BasisCurves")?;
    let token = |value: &str| Data::Token(value.to_owned());
    author.uniform(path, ("type", "token"), token("linear"))?;
    let wrap = if lines.close {
        "periodic"
    } else {
        "nonperiodic"
    };
    author.uniform(path, ("wrap", "token"), token(wrap))?;
    let counts = Data::Ints(lines.counts);
    author.attribute(path, ("curveVertexCounts", "int[]"), counts)?;
    let widths = Data::Floats(vec![width]);
    author.interpolated(path, ("widths", "float[]"), "constant", widths)?;
    let half = 0.5 * width;
    let extent = Data::Vec3s(vec![low - half, high + half]);
    author.attribute(path, ("extent", "float3[]"), extent)?;
    meshes::write_columns(job, &primitive.material(), columns, path)?;
    meshes::bind(job, primitive, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(mode: Mode, corners: &[u32]) -> (Vec<u32>, Vec<i32>, bool) {
        let lines = Lines::new(mode, corners.to_vec());
        (lines.vertices, lines.counts, lines.close)
    }

    #[test]
    fn lines_that_meet_in_order_are_one_curve() {
        let two = (vec![0, 1, 2, 7, 8], vec![3, 2], false);
        assert_eq!(of(Mode::Lines, &[0, 1, 1, 2, 7, 8]), two);
        let strip = (vec![3, 1, 2], vec![3], false);
        assert_eq!(of(Mode::LineStrip, &[3, 1, 2]), strip);
        let closed = (vec![0, 1, 2], vec![3], true);
        assert_eq!(of(Mode::LineLoop, &[0, 1, 2]), closed);
    }

    #[test]
    fn what_has_too_few_vertices_is_no_line() {
        assert_eq!(of(Mode::Lines, &[4]), (vec![], vec![], false));
        assert_eq!(of(Mode::LineStrip, &[]), (vec![], vec![], false));
        assert_eq!(of(Mode::LineLoop, &[5, 6]), (vec![5, 6], vec![2], false));
    }
}
