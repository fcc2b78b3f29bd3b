//! LAS and LAZ scans → points, through the crate `las`.
//!
//! | of a point | column |
//! |---|---|
//! | x, y, z (scaled and moved as the header says) | positions, relative to an origin where they are far from 0 |
//! | red, green, blue | `displayColor`: sRGB in 16 bits; in 8 where none is above 255 |
//! | intensity | `intensity`, as stored: 0 … 65535 |
//! | classification | `classification` |
//!
//! Everything else (returns, angles, times, bytes of vendors) is lost, with a warning. Scans are +Z up.

use super::{Error, malformed, read_file, single_precision};
use crate::diagnostics::Diagnostics;
use crate::files::Bytes;
use crate::math::srgb;
use crate::surfels::points::{Column, ColumnValues, PointSet, VectorKind};
use glam::{DVec3, Vec3};
use las::{PointData, PointDataBuilder, Reader};
use rayon::prelude::*;
use std::io::Cursor;
use std::path::Path;

/// Name of the thread that reads; a panic of the crate on it is an error of the file's.
pub const THREAD_NAME: &str = "las";

/// Points decoded at a time.
const BLOCK: u64 = 1 << 16;

/// What a point has at least, bytes: format 0.
const SMALLEST_POINT: u64 = 20;

/// The points of the file at `path`.
///
/// # Errors
/// Files that are no LAS or LAZ, are damaged or shorter than their header says; positions that are not finite.
pub fn read(path: &Path, diagnostics: &Diagnostics) -> Result<PointSet, Error> {
    let bytes = read_file(path)?;
    let malformed = malformed(path);
    check(&bytes).map_err(&malformed)?;
    let reader = std::thread::Builder::new().name(THREAD_NAME.to_owned());
    let reading = reader.spawn(move || columns(bytes));
    let reading = reading.map_err(|source| Error::Unreadable {
        path: path.to_owned(),
        source,
    })?;
    let columns = match reading.join() {
        Ok(columns) => columns.map_err(|error| malformed(error.to_string()))?,
        Err(_) => {
            return Err(malformed(
                "it is damaged: its points cannot be decoded".into(),
            ));
        }
    };
    let place = path.to_string_lossy();
    let message = "returns, angles, times and what else a point has are left out";
    diagnostics.warn("lost", place.clone(), message);
    if columns.is_in_bytes() {
        let message = "no color is above 255: they are taken as codes of 8 bits";
        diagnostics.warn("color", place, message);
    }
    columns.points().map_err(malformed)
}

/// Refuse what the crate would ask memory for without looking: an extended record, and a table of chunks, longer than the
/// file. (LAS 1.4 R15, public header block; `LASzip`, chunk table.)
fn check(bytes: &[u8]) -> Result<(), String> {
    let number = |at: u64, size: usize| -> Option<u64> {
        let at = usize::try_from(at).ok()?;
        let taken = bytes.get(at..at.checked_add(size)?)?;
        let mut all = [0; 8];
        all[..size].copy_from_slice(taken);
        Some(u64::from_le_bytes(all))
    };
    if !bytes.starts_with(b"LASF") {
        return Err("it is no LAS file: it does not begin with \"LASF\"".to_owned());
    }
    let length = bytes.len() as u64;
    let short = || "it ends within its header".to_owned();
    let start = number(96, 4).ok_or_else(short)?;
    let format = number(104, 1).ok_or_else(short)?;
    if bytes[25] >= 4 && number(243, 4).ok_or_else(short)? > 0 {
        let record = number(235, 8).ok_or_else(short)?;
        let size = number(record.saturating_add(20), 8);
        if size.is_none_or(|size| size > length) {
            return Err("it ends before its extended records".to_owned());
        }
    }
    let is_packed = format & 0xc0 != 0;
    if is_packed {
        let table = number(start, 8).ok_or("it ends before its points")?;
        // written to a stream, the offset of the table is at the end
        let table = match table == u64::MAX {
            true => number(length.saturating_sub(8), 8).unwrap_or(u64::MAX),
            false => table,
        };
        let chunks = number(table.saturating_add(4), 4);
        if chunks.is_none_or(|chunks| chunks > length) {
            return Err("its table of chunks does not lie in it".to_owned());
        }
    } else {
        let legacy = number(107, 4).ok_or_else(short)?;
        let count = match bytes[25] >= 4 && legacy == 0 {
            true => number(247, 8).ok_or_else(short)?,
            false => legacy,
        };
        let size = number(105, 2).ok_or_else(short)?.max(SMALLEST_POINT);
        let there = length.saturating_sub(start) / size;
        if count > there {
            return Err(format!(
                "its header says that it has {count} points, {there} are there"
            ));
        }
    }
    Ok(())
}

/// What is kept of the points.
#[derive(Default)]
struct Columns {
    position: Vec<DVec3>,
    color: Vec<[u16; 3]>,
    intensity: Vec<f32>,
    classification: Vec<i32>,
}

fn columns(bytes: Bytes) -> las::Result<Columns> {
    let mut reader = Reader::new(Cursor::new(bytes))?;
    let count = reader.header().number_of_points();
    let mut columns = Columns::default();
    let mut block = PointDataBuilder::new().for_header(reader.header()).build();
    let mut read = 0;
    while read < count {
        let taken = reader.fill_points(BLOCK, &mut block)?;
        if taken == 0 {
            break;
        }
        read += taken;
        columns.add(&block);
    }
    Ok(columns)
}

impl Columns {
    fn add(&mut self, block: &PointData) {
        let places = block.x().zip(block.y()).zip(block.z());
        self.position
            .extend(places.map(|((x, y), z)| DVec3::new(x, y, z)));
        self.intensity.extend(block.intensity().map(f32::from));
        self.classification
            .extend(block.classification().map(i32::from));
        if let Some(colors) = block.rgb() {
            self.color.extend(colors.map(|(r, g, b)| [r, g, b]));
        }
    }

    /// True if colors are codes of 8 bits in numbers of 16.
    fn is_in_bytes(&self) -> bool {
        let highest = self.color.par_iter().flat_map_iter(|color| *color).max();
        highest.is_some_and(|highest| (1..=255).contains(&highest))
    }

    fn points(self) -> Result<PointSet, String> {
        let whole = if self.is_in_bytes() { 255.0 } else { 65_535.0 };
        let linear = |color: &[u16; 3]| {
            Vec3::from_array(color.map(|code| srgb::to_linear(f32::from(code) / whole)))
        };
        let color: Vec<Vec3> = self.color.par_iter().map(linear).collect();
        let (origin, position) = single_precision(&self.position)?;
        let mut columns = vec![
            column("intensity", ColumnValues::Floats(self.intensity)),
            column("classification", ColumnValues::Ints(self.classification)),
        ];
        if !color.is_empty() {
            let color = ColumnValues::Vectors(VectorKind::Color, color);
            columns.insert(0, column("displayColor", color));
        }
        Ok(PointSet {
            origin,
            position,
            columns,
            ..PointSet::default()
        })
    }
}

fn column(name: &str, values: ColumnValues) -> Column {
    Column {
        name: name.to_owned(),
        values,
    }
}
