//! A PLY file → points.

use super::ABOUT;
use super::header::Header;
use super::table::Table;
use crate::diagnostics::Diagnostics;
use crate::exchange::srgb::Srgb;
use crate::exchange::{Error, malformed, not_finite, read_file, single_precision};
use crate::math::srgb;
use crate::scene::UpAxis;
use crate::surfels::points::{Column, ColumnValues, PointSet, VectorKind, first_bad};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::path::Path;

/// The points of the file at `path`, and its up axis and meters a unit where a comment of ours says them. Faces and what
/// else is in it are lost, with a warning. Values that are not finite count as 0, with a warning.
///
/// # Errors
/// Files that are no PLY, or shorter than their header says; positions that are missing or not finite.
pub fn read(
    path: &Path,
    diagnostics: &Diagnostics,
) -> Result<(PointSet, Option<(UpAxis, f64)>), Error> {
    let bytes = read_file(path)?;
    let malformed = malformed(path);
    let header = Header::parse(&bytes).map_err(&malformed)?;
    let table = Table::of(&header, "vertex", &bytes).map_err(&malformed)?;
    let place = path.to_string_lossy();
    for element in &header.elements {
        if element.name != "vertex" && element.count > 0 {
            let message = format!(
                "{} elements {} are left out: points are read",
                element.count, element.name
            );
            diagnostics.warn("lost", place.clone(), message);
        }
    }
    let mut set = points(&table).map_err(&malformed)?;
    let bad = set.remove_non_finite();
    if bad > 0 {
        let message = format!("{bad} values are not finite and count as 0");
        diagnostics.warn("non-finite", place.clone(), message);
    }
    Ok((set, about(&header)))
}

fn about(header: &Header) -> Option<(UpAxis, f64)> {
    let mut comments = header.comments.iter();
    let words = comments.find_map(|comment| comment.strip_prefix(ABOUT))?;
    let (axis, unit) = words.split_once(" metersPerUnit ")?;
    let unit = unit.trim().parse::<f64>().ok()?;
    let axis = match axis {
        "Y" => UpAxis::Y,
        "Z" => UpAxis::Z,
        _ => return None,
    };
    (unit.is_finite() && unit > 0.0).then_some((axis, unit))
}

/// Columns of a table, each taken once.
struct Taken<'a> {
    table: &'a Table<'a>,
    taken: Vec<bool>,
}

fn points(table: &Table<'_>) -> Result<PointSet, String> {
    let mut taken = Taken {
        table,
        taken: vec![false; table.columns.len()],
    };
    let place = taken.three(["x", "y", "z"]);
    let place = place.ok_or("its points have no x, y and z")?;
    let (origin, position) = positions(table, place)?;
    let normal = taken.three(["nx", "ny", "nz"]).map(|columns| {
        let mut normals = table.vectors(columns);
        normals.par_iter_mut().for_each(|normal| {
            if !normal.is_normalized() {
                *normal = normal.normalize_or_zero();
            }
        });
        normals
    });
    let mut set = PointSet {
        origin,
        position,
        normal,
        radius: taken.radii(),
        columns: Vec::new(),
    };
    let shown = taken.shown_color();
    taken.rest(&mut set.columns);
    if let Some(shown) = shown.filter(|_| set.column("displayColor").is_none()) {
        let values = ColumnValues::Vectors(VectorKind::Color, shown);
        let name = "displayColor".to_owned();
        set.columns.insert(0, Column { name, values });
    }
    Ok(set)
}

/// Single precision relative to an origin; the origin is 0 unless doubles lie far off it.
fn positions(table: &Table<'_>, columns: [usize; 3]) -> Result<(DVec3, Vec<Vec3>), String> {
    let is_double = columns
        .iter()
        .all(|&column| table.columns[column].1.size() == 8);
    if !is_double {
        let position = table.vectors(columns);
        return match first_bad(&position, |p| p.is_finite()) {
            Some(at) => Err(not_finite(at)),
            None => Ok((DVec3::ZERO, position)),
        };
    }
    single_precision(&table.double_vectors(columns))
}

impl Taken<'_> {
    fn three(&mut self, names: [&str; 3]) -> Option<[usize; 3]> {
        let [x, y, z] = names.map(|name| self.table.find(name));
        let columns = [x?, y?, z?];
        columns.iter().for_each(|&column| self.taken[column] = true);
        Some(columns)
    }

    fn radii(&mut self) -> Option<Vec<f32>> {
        let names = [
            ("radius", 1.0),
            ("pscale", 1.0),
            ("widths", 0.5),
            ("width", 0.5),
        ];
        let found = names
            .into_iter()
            .find_map(|(name, factor)| Some((self.table.find(name)?, factor)));
        let (column, factor) = found?;
        self.taken[column] = true;
        let mut radii = self.table.floats(column);
        radii
            .iter_mut()
            .for_each(|radius| *radius = (*radius * factor).max(0.0));
        Some(radii)
    }

    /// `red green blue` decoded to linear light: codes as sRGB, and floats too, as Blender takes them.
    fn shown_color(&mut self) -> Option<Vec<Vec3>> {
        let columns = self
            .three(["red", "green", "blue"])
            .or_else(|| self.three(["r", "g", "b"]))
            .or_else(|| self.three(["diffuse_red", "diffuse_green", "diffuse_blue"]))?;
        if let [Some(r), Some(g), Some(b)] = columns.map(|column| self.table.bytes(column)) {
            let srgb = Srgb::new();
            let color =
                |i: usize| Vec3::from_array([r[i], g[i], b[i]].map(|code| srgb.decode(code)));
            return Some((0..self.table.count).into_par_iter().map(color).collect());
        }
        // 16-bit codes span 0…65535
        let is_code = columns
            .iter()
            .all(|&column| self.table.columns[column].1.size() == 2);
        let whole = if is_code { 65_535.0 } else { 1.0 };
        let mut colors = self.table.vectors(columns);
        colors.par_iter_mut().for_each(|color| {
            *color = color.map(|x| srgb::to_linear(x / whole));
        });
        Some(colors)
    }

    /// Everything not taken yet: triples by their endings, then numbers.
    fn rest(&mut self, columns: &mut Vec<Column>) {
        for index in 0..self.table.columns.len() {
            if self.taken[index] {
                continue;
            }
            let (name, scalar) = self.table.columns[index].clone();
            let triple = [(["_r", "_g", "_b"], true), (["_x", "_y", "_z"], false)];
            let found = triple.into_iter().find_map(|(ends, is_color)| {
                let base = name.strip_suffix(ends[0])?;
                let names = ends.map(|end| format!("{base}{end}"));
                let columns = self.three(names.each_ref().map(String::as_str))?;
                Some((base.to_owned(), columns, is_color))
            });
            let (name, values) = match found {
                Some((base, triple, is_color)) => {
                    let kind = match is_color {
                        true => VectorKind::Color,
                        false if base == "N" || base.contains("normal") => VectorKind::Normal,
                        false => VectorKind::Vector,
                    };
                    (
                        base,
                        ColumnValues::Vectors(kind, self.table.vectors(triple)),
                    )
                }
                None if scalar.is_float() => (name, ColumnValues::Floats(self.table.floats(index))),
                None => {
                    let numbers = self.table.doubles(index);
                    #[expect(
                        clippy::cast_possible_truncation,
                        reason = "saturates at the ends of i32"
                    )]
                    let whole = numbers.into_iter().map(|x| x as i32).collect();
                    (name, ColumnValues::Ints(whole))
                }
            };
            self.taken[index] = true;
            columns.push(Column { name, values });
        }
    }
}
