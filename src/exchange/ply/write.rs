//! Points → a PLY file.

use super::ABOUT;
use crate::exchange::Error;
use crate::exchange::srgb::Srgb;
use crate::scene::{StageInfo, UpAxis};
use crate::surfels::points::{ColumnValues, PointSet, VectorKind};
use crate::writers::usd::Provenance;
use crate::writers::write_streamed;
use glam::Vec3;
use rayon::prelude::*;
use std::fmt::Write as _;
use std::io::{self, Write};
use std::path::Path;

/// How numbers are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Encoding {
    /// Little endian.
    #[default]
    Binary,
    /// Big endian.
    BinaryBig,
    /// Text.
    Ascii,
}

/// Rows made by one thread at a time.
const CHUNK: usize = 8192;

/// Chunks in memory at a time.
const CHUNKS: usize = 32;

/// One property of the file.
struct Field<'a> {
    name: String,
    cells: Cells<'a>,
}

#[derive(Clone, Copy)]
enum Cells<'a> {
    /// Absolute coordinate of an axis, double precision.
    Place(&'a PointSet, usize),
    Part(&'a [Vec3], usize),
    Float(&'a [f32]),
    Int(&'a [i32]),
    /// sRGB code of a component.
    Code(&'a [Vec3], usize),
}

/// Write `points` of a stage like `stage` to `path`.
///
/// # Errors
/// When the file cannot be written; nothing is left behind then.
pub fn write(
    points: &PointSet,
    stage: &StageInfo,
    path: &Path,
    encoding: Encoding,
    provenance: &Provenance,
) -> Result<(), Error> {
    let fields = fields(points);
    let header = header(&fields, points.len(), stage, (encoding, provenance));
    let written = write_streamed(path, |out| {
        out.write_all(header.as_bytes())?;
        rows(&fields, points.len(), encoding, out)
    });
    written.map_err(|source| Error::Unwritable {
        path: path.to_owned(),
        source,
    })
}

fn fields(points: &PointSet) -> Vec<Field<'_>> {
    let mut fields = Vec::new();
    let mut add = |name: String, cells| fields.push(Field { name, cells });
    let is_far = points.origin != glam::DVec3::ZERO;
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let cells = match is_far {
            true => Cells::Place(points, axis),
            false => Cells::Part(&points.position, axis),
        };
        add(name.to_owned(), cells);
    }
    if let Some(normals) = &points.normal {
        for (axis, name) in ["nx", "ny", "nz"].into_iter().enumerate() {
            add(name.to_owned(), Cells::Part(normals, axis));
        }
    }
    if let Some(colors) = points.vectors("displayColor") {
        for (part, name) in ["red", "green", "blue"].into_iter().enumerate() {
            add(name.to_owned(), Cells::Code(colors, part));
        }
    }
    if let Some(radii) = &points.radius {
        add("radius".to_owned(), Cells::Float(radii));
    }
    for column in &points.columns {
        // spaces end a name
        let name = column.name.replace(char::is_whitespace, "_");
        match &column.values {
            ColumnValues::Floats(values) => add(name, Cells::Float(values)),
            ColumnValues::Ints(values) => add(name, Cells::Int(values)),
            ColumnValues::Vectors(kind, values) => {
                let ends = match kind {
                    VectorKind::Color => ["r", "g", "b"],
                    VectorKind::Normal | VectorKind::Vector => ["x", "y", "z"],
                };
                for (part, end) in ends.into_iter().enumerate() {
                    add(format!("{name}_{end}"), Cells::Part(values, part));
                }
            }
        }
    }
    fields
}

/// Comments that say where the file comes from.
pub(super) fn made_by(provenance: &Provenance) -> String {
    let (program, words) = (provenance.program(), provenance.words());
    format!("comment made by {program}\ncomment command {words}\n")
}

fn header(
    fields: &[Field<'_>],
    count: usize,
    stage: &StageInfo,
    (encoding, provenance): (Encoding, &Provenance),
) -> String {
    let format = match encoding {
        Encoding::Binary => "binary_little_endian",
        Encoding::BinaryBig => "binary_big_endian",
        Encoding::Ascii => "ascii",
    };
    let axis = match stage.up_axis {
        UpAxis::Y => "Y",
        UpAxis::Z => "Z",
    };
    let mut text = format!(
        "ply\nformat {format} 1.0\n{}comment {ABOUT}{axis} metersPerUnit {}\nelement vertex {count}\n",
        made_by(provenance),
        stage.meters_per_unit
    );
    for field in fields {
        let word = match field.cells {
            Cells::Place(..) => "double",
            Cells::Part(..) | Cells::Float(_) => "float",
            Cells::Int(_) => "int",
            Cells::Code(..) => "uchar",
        };
        // writing to a string does not fail
        let _ = writeln!(text, "property {word} {}", field.name);
    }
    text + "end_header\n"
}

fn rows(
    fields: &[Field<'_>],
    count: usize,
    encoding: Encoding,
    out: &mut (dyn Write + Send),
) -> io::Result<()> {
    let srgb = Srgb::new();
    let fill = |first: usize, buffers: &mut [Vec<u8>]| {
        let fill = |(k, bytes): (usize, &mut Vec<u8>)| {
            let start = count.min((first + k) * CHUNK);
            let rows = start..count.min(start + CHUNK);
            match encoding {
                Encoding::Ascii => text(fields, rows, (&srgb, bytes)),
                Encoding::Binary => binary::<false>(fields, rows, (&srgb, bytes)),
                Encoding::BinaryBig => binary::<true>(fields, rows, (&srgb, bytes)),
            }
        };
        buffers.par_iter_mut().enumerate().for_each(fill);
    };
    // one lot is written while the next is filled; their memory is used again, for new memory costs more than the work
    let (mut ready, mut next) = (vec![Vec::new(); CHUNKS], vec![Vec::new(); CHUNKS]);
    fill(0, &mut ready);
    for first in (0..count.div_ceil(CHUNK)).step_by(CHUNKS) {
        let write = || ready.iter().try_for_each(|bytes| out.write_all(bytes));
        let (written, ()) = rayon::join(write, || fill(first + CHUNKS, &mut next));
        written?;
        std::mem::swap(&mut ready, &mut next);
    }
    Ok(())
}

impl Cells<'_> {
    fn size(&self) -> usize {
        match self {
            Self::Place(..) => 8,
            Self::Part(..) | Self::Float(_) | Self::Int(_) => 4,
            Self::Code(..) => 1,
        }
    }

    fn place(points: &PointSet, axis: usize, i: usize) -> f64 {
        points.origin[axis] + f64::from(points.position[i][axis])
    }
}

fn binary<const IS_BIG: bool>(
    fields: &[Field<'_>],
    rows: std::ops::Range<usize>,
    (srgb, bytes): (&Srgb, &mut Vec<u8>),
) {
    let stride: usize = fields.iter().map(|field| field.cells.size()).sum();
    bytes.resize(stride * rows.len(), 0);
    let mut start = 0;
    for field in fields {
        macro_rules! fill {
            ($value:expr) => {{
                let value = $value;
                for (row, i) in bytes.chunks_exact_mut(stride).zip(rows.clone()) {
                    let number = value(i);
                    let number = if IS_BIG {
                        number.to_be_bytes()
                    } else {
                        number.to_le_bytes()
                    };
                    row[start..start + number.len()].copy_from_slice(&number);
                }
            }};
        }
        match field.cells {
            Cells::Place(points, axis) => fill!(|i| Cells::place(points, axis, i)),
            Cells::Part(values, part) => fill!(|i: usize| values[i][part]),
            Cells::Float(values) => fill!(|i: usize| values[i]),
            Cells::Int(values) => fill!(|i: usize| values[i]),
            Cells::Code(values, part) => fill!(|i: usize| srgb.encode(values[i][part])),
        }
        start += field.cells.size();
    }
}

/// Shortest digits that read back as the same number.
fn text(fields: &[Field<'_>], rows: std::ops::Range<usize>, (srgb, bytes): (&Srgb, &mut Vec<u8>)) {
    bytes.clear();
    let mut text = String::new();
    for i in rows {
        for (k, field) in fields.iter().enumerate() {
            if k > 0 {
                text.push(' ');
            }
            // writing to a string does not fail
            let _ = match field.cells {
                Cells::Place(points, axis) => write!(text, "{}", Cells::place(points, axis, i)),
                Cells::Part(values, part) => write!(text, "{}", values[i][part]),
                Cells::Float(values) => write!(text, "{}", values[i]),
                Cells::Int(values) => write!(text, "{}", values[i]),
                Cells::Code(values, part) => write!(text, "{}", srgb.encode(values[i][part])),
            };
        }
        text.push('\n');
    }
    bytes.extend_from_slice(text.as_bytes());
}
