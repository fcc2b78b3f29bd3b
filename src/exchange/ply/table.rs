//! The rows of one element of a PLY file as columns.

use super::header::{Element, Format, Header, Property, Scalar};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Rows of numbers of known types.
#[derive(Debug)]
pub(super) struct Table<'a> {
    pub(super) count: usize,
    /// Name and type of each column.
    pub(super) columns: Vec<(String, Scalar)>,
    cells: Cells<'a>,
}

#[derive(Debug)]
enum Cells<'a> {
    Binary {
        rows: &'a [u8],
        stride: usize,
        /// Where each column is in a row.
        starts: Vec<usize>,
        is_big: bool,
    },
    /// One list a column.
    Text(Vec<Vec<f64>>),
}

impl<'a> Table<'a> {
    /// The element `name` of the file with `header` and content `bytes`.
    pub(super) fn of(header: &Header, name: &str, bytes: &'a [u8]) -> Result<Self, String> {
        let index = header
            .elements
            .iter()
            .position(|element| element.name == name);
        let index = index.ok_or_else(|| format!("it has no element {name}"))?;
        let element = &header.elements[index];
        let mut columns = Vec::with_capacity(element.properties.len());
        for property in &element.properties {
            match property {
                Property::One(name, scalar) => columns.push((name.clone(), *scalar)),
                Property::List(..) => {
                    return Err(format!("its element {name} holds lists, not numbers alone"));
                }
            }
        }
        let data = &bytes[header.end..];
        let cells = match header.format {
            Format::Ascii => Cells::Text(text_cells(header, index, data)?),
            format => {
                let before = &header.elements[..index];
                let is_big = format == Format::Big;
                let start = skipped(before, data, is_big)?;
                let stride: usize = columns.iter().map(|(_, scalar)| scalar.size()).sum();
                let needed = element.count.checked_mul(stride);
                let end = needed.and_then(|needed| needed.checked_add(start));
                let rows = end.and_then(|end| data.get(start..end)).ok_or_else(|| {
                    let rest = data.len().saturating_sub(start);
                    format!(
                        "it ends too early: {} rows of {stride} bytes are declared, {rest} bytes are there",
                        element.count
                    )
                })?;
                let mut at = 0;
                let starts = columns.iter().map(|(_, scalar)| {
                    at += scalar.size();
                    at - scalar.size()
                });
                Cells::Binary {
                    starts: starts.collect(),
                    rows,
                    stride,
                    is_big,
                }
            }
        };
        Ok(Self {
            count: element.count,
            columns,
            cells,
        })
    }

    /// Index of the column called `name`.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|(column, _)| column == name)
    }

    /// A column, each number converted.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "values are kept in single precision"
    )]
    pub(super) fn floats(&self, column: usize) -> Vec<f32> {
        if self.columns[column].1 == Scalar::F32
            && let Cells::Binary { is_big, .. } = &self.cells
        {
            let from = if *is_big {
                f32::from_be_bytes
            } else {
                f32::from_le_bytes
            };
            return self.each(column, |bytes: [u8; 4]| from(bytes));
        }
        self.doubles(column).into_iter().map(|x| x as f32).collect()
    }

    /// A column of codes; `None` if it is not of bytes.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 0…255"
    )]
    pub(super) fn bytes(&self, column: usize) -> Option<Vec<u8>> {
        if self.columns[column].1 != Scalar::U8 {
            return None;
        }
        Some(match &self.cells {
            Cells::Binary { .. } => self.each(column, |[byte]: [u8; 1]| byte),
            Cells::Text(lists) => lists[column]
                .iter()
                .map(|x| x.clamp(0.0, 255.0) as u8)
                .collect(),
        })
    }

    /// Three columns as vectors.
    pub(super) fn vectors(&self, columns: [usize; 3]) -> Vec<Vec3> {
        if let Cells::Binary {
            rows,
            stride,
            starts,
            is_big: false,
        } = &self.cells
            && columns
                .iter()
                .all(|&column| self.columns[column].1 == Scalar::F32)
        {
            let [x, y, z] = columns.map(|column| starts[column]);
            let float = |row: &[u8], at: usize| {
                f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]])
            };
            let read = |row: &[u8]| Vec3::new(float(row, x), float(row, y), float(row, z));
            return rows.par_chunks_exact(*stride).map(read).collect();
        }
        let [x, y, z] = columns.map(|column| self.floats(column));
        let rows = x.into_iter().zip(y).zip(z);
        rows.map(|((x, y), z)| Vec3::new(x, y, z)).collect()
    }

    /// Three columns as vectors in double precision.
    pub(super) fn double_vectors(&self, columns: [usize; 3]) -> Vec<DVec3> {
        let [x, y, z] = columns.map(|column| self.doubles(column));
        let rows = x.into_iter().zip(y).zip(z);
        rows.map(|((x, y), z)| DVec3::new(x, y, z)).collect()
    }

    /// A column, each number converted.
    pub(super) fn doubles(&self, column: usize) -> Vec<f64> {
        let is_big = match &self.cells {
            Cells::Text(lists) => return lists[column].clone(),
            Cells::Binary { is_big, .. } => *is_big,
        };
        macro_rules! read {
            ($type:ty) => {{
                let from = if is_big {
                    <$type>::from_be_bytes
                } else {
                    <$type>::from_le_bytes
                };
                self.each(column, |bytes| f64::from(from(bytes)))
            }};
        }
        match self.columns[column].1 {
            Scalar::I8 => read!(i8),
            Scalar::U8 => read!(u8),
            Scalar::I16 => read!(i16),
            Scalar::U16 => read!(u16),
            Scalar::I32 => read!(i32),
            Scalar::U32 => read!(u32),
            Scalar::F32 => read!(f32),
            Scalar::F64 => read!(f64),
        }
    }

    /// The bytes of a column through `convert`, row by row; empty for text.
    fn each<const N: usize, T: Send>(
        &self,
        column: usize,
        convert: impl Fn([u8; N]) -> T + Sync,
    ) -> Vec<T> {
        let Cells::Binary {
            rows,
            stride,
            starts,
            ..
        } = &self.cells
        else {
            return Vec::new();
        };
        let start = starts[column];
        let read = |row: &[u8]| {
            let mut bytes = [0; N];
            bytes.copy_from_slice(&row[start..start + N]);
            convert(bytes)
        };
        rows.par_chunks_exact(*stride).map(read).collect()
    }
}

/// Bytes that the elements before the wanted one take.
fn skipped(before: &[Element], data: &[u8], is_big: bool) -> Result<usize, String> {
    let early = || "it ends too early, before its points".to_owned();
    let mut at: usize = 0;
    for element in before {
        for _ in 0..element.count {
            for property in &element.properties {
                let size = match property {
                    Property::One(_, scalar) => scalar.size(),
                    Property::List(count, item) => {
                        let bytes = data.get(at..at + count.size()).ok_or_else(early)?;
                        at += count.size();
                        let items = unsigned(bytes, is_big)
                            .ok_or("a list has a count that is no whole number")?;
                        items.checked_mul(item.size()).ok_or_else(early)?
                    }
                };
                at = at
                    .checked_add(size)
                    .filter(|&at| at <= data.len())
                    .ok_or_else(early)?;
            }
            // an element without properties takes nothing, however many there are
            if element.properties.is_empty() {
                break;
            }
        }
    }
    Ok(at)
}

fn unsigned(bytes: &[u8], is_big: bool) -> Option<usize> {
    let mut all = [0_u8; 8];
    if bytes.len() > 4 {
        return None;
    }
    for (k, byte) in bytes.iter().enumerate() {
        let place = if is_big { bytes.len() - 1 - k } else { k };
        all[place] = *byte;
    }
    usize::try_from(u64::from_le_bytes(all)).ok()
}

/// Numbers of the element at `index`, one list a column.
fn text_cells(header: &Header, index: usize, data: &[u8]) -> Result<Vec<Vec<f64>>, String> {
    let text = std::str::from_utf8(data)
        .map_err(|_| "it is said to be ascii, but it is not text".to_owned())?;
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    for element in &header.elements[..index] {
        if !element.properties.is_empty() && element.count > 0 {
            lines
                .nth(element.count - 1)
                .ok_or("it ends too early, before its points")?;
        }
    }
    let element = &header.elements[index];
    let width = element.properties.len();
    // a row takes two letters a number at least
    let most = text.len() / (2 * width.max(1)) + 1;
    let early = |row: usize| {
        format!(
            "it ends too early: {} points are declared, {row} are there",
            element.count
        )
    };
    if element.count > most {
        return Err(early(lines.count()));
    }
    let mut columns = vec![Vec::with_capacity(element.count); width];
    for row in 0..element.count {
        let line = lines.next().ok_or_else(|| early(row))?;
        let mut words = line.split_ascii_whitespace();
        for column in &mut columns {
            let word = words
                .next()
                .ok_or_else(|| format!("row {row} of its points has fewer than {width} numbers"))?;
            let number = word.parse::<f64>();
            column.push(
                number.map_err(|_| format!("row {row} of its points has {word:?} for a number"))?,
            );
        }
    }
    Ok(columns)
}
