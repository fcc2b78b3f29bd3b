//! Points of one layer with every column they have, for what does not gather from them: pictures, other formats.

use super::file::{self, Column as Values, File};
use super::placement::{self, Placement};
use super::{Part, unit};
use crate::diagnostics::Diagnostics;
use crate::scene::{StageInfo, UpAxis};
use crate::stage::Error;
use crate::surfels::points::{Column, ColumnValues, PointSet, VectorKind};
use glam::{DVec3, Vec3};
use openusd::sdf::{Path as SdfPath, Value};
use rayon::prelude::*;
use std::path::Path;

/// Attributes that have a place of their own, or would hold a radius twice.
const KNOWN: [&str; 4] = [
    "primvars:normals",
    "primvars:N",
    "primvars:widths",
    "primvars:radius",
];

/// Every `Points` prim of the layer at `path` as one set in world space, and what the layer says of itself. Constant
/// columns are expanded; those of other types than 1, 3 or 4 numbers are left out with a warning. Points whose place
/// or size is not finite are an error; other values that are not finite count as 0, with a warning.
///
/// # Errors
/// Unreadable files, files that refer to other layers, `points` or `widths` of wrong type, length or value.
pub fn read_points(path: &Path, diagnostics: &Diagnostics) -> Result<(PointSet, StageInfo), Error> {
    let (set, mut stage) = file::on_layer(path, |file| points(file, diagnostics))?;
    path.clone_into(&mut stage.path);
    Ok((set, stage))
}

/// [`read_points`] of an open file.
pub(super) fn points(
    file: &File,
    diagnostics: &Diagnostics,
) -> Result<(PointSet, StageInfo), String> {
    if let Some(arc) = file.composes() {
        return Err(format!(
            "{arc}; a cloud is read from one layer alone: flatten it first"
        ));
    }
    Ok((sets(file, diagnostics)?, stage_info(file)))
}

fn sets(file: &File, diagnostics: &Diagnostics) -> Result<PointSet, String> {
    let prims = file.points();
    let first = prims.first().ok_or("it has no Points prim")?;
    let place = placement::world_from_prim(file, first)?.w_axis.truncate();
    let origin = if place.is_finite() {
        place
    } else {
        DVec3::ZERO
    };
    let mut all: Option<PointSet> = None;
    for prim in prims {
        let part = Part {
            file,
            prim,
            diagnostics,
        };
        let set = part.set(origin)?;
        match &mut all {
            None => all = Some(set),
            Some(all) => {
                for name in all.append(set) {
                    part.warn(&format!(
                        "{name} is not on every Points prim: it is 0 where it is not"
                    ));
                }
            }
        }
    }
    Ok(all.unwrap_or_default())
}

impl Part<'_> {
    fn set(&self, origin: DVec3) -> Result<PointSet, String> {
        let position = match self.file.column(&self.prim, "points")? {
            Some(Values::Vectors(points)) => points,
            Some(_) => return Err(self.wrong("points", "three components a point")),
            None => Vec::new(),
        };
        let count = position.len();
        self.check_finite("points", &position)?;
        let mut set = PointSet {
            origin,
            normal: self.directions(count)?,
            radius: self.radii(count)?,
            columns: Vec::new(),
            position,
        };
        self.place_points(&mut set)?;
        for name in self.file.attributes_of(&self.prim) {
            let Some(short) = name.strip_prefix("primvars:") else {
                continue;
            };
            if KNOWN.contains(&name.as_str()) || short.ends_with(":indices") {
                continue;
            }
            if let Some(values) = self.values(&name, count) {
                set.columns.push(Column {
                    name: short.to_owned(),
                    values,
                });
            }
        }
        Ok(set)
    }

    fn directions(&self, count: usize) -> Result<Option<Vec<Vec3>>, String> {
        for name in ["normals", "primvars:normals", "primvars:N"] {
            if let Some(Values::Vectors(normals)) = self.file.column(&self.prim, name)? {
                let mut normals = self.expanded(name, normals, count)?;
                normals.par_iter_mut().for_each(|normal| {
                    *normal = if normal.is_finite() {
                        unit(*normal)
                    } else {
                        Vec3::ZERO
                    };
                });
                return Ok(Some(normals));
            }
        }
        Ok(None)
    }

    /// `primvars:radius` as Blender has it, else half of `widths`.
    fn radii(&self, count: usize) -> Result<Option<Vec<f32>>, String> {
        let named = |name, factor: f32| -> Result<Option<Vec<f32>>, String> {
            let mut sizes = self.floats(name, count)?;
            if let Some(sizes) = &mut sizes {
                let radius = |size: &mut f32| *size = factor * size.max(0.0);
                sizes.par_iter_mut().for_each(radius);
            }
            Ok(sizes)
        };
        match named("primvars:radius", 1.0)? {
            Some(radii) => Ok(Some(radii)),
            None => named("widths", 0.5),
        }
    }

    fn place_points(&self, set: &mut PointSet) -> Result<(), String> {
        let world = placement::world_from_prim(self.file, &self.prim)?;
        let placement = Placement::new(world, set.origin);
        if placement.is_identity() {
            return Ok(());
        }
        set.position.par_iter_mut().for_each(|position| {
            *position = placement.position(*position);
        });
        self.check_finite("points", &set.position)?;
        if let Some(normals) = &mut set.normal {
            normals.par_iter_mut().for_each(|normal| {
                *normal = placement.normal_and_growth(*normal).0;
            });
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "radii are single precision"
        )]
        let scale = world.determinant().abs().cbrt() as f32;
        if let Some(radii) = set.radius.as_mut().filter(|_| scale != 1.0) {
            radii.iter_mut().for_each(|radius| *radius *= scale);
        }
        Ok(())
    }

    /// The primvar `name`, one value a point; `None` with a warning if it cannot be used.
    fn values(&self, name: &str, count: usize) -> Option<ColumnValues> {
        let column = self.file.column(&self.prim, name).and_then(|column| {
            Ok(Some(match column {
                None => return Ok(None),
                Some(Values::Floats(values)) => {
                    ColumnValues::Floats(self.expanded(name, values, count)?)
                }
                Some(Values::Ints(values)) => {
                    ColumnValues::Ints(self.expanded(name, values, count)?)
                }
                Some(Values::Vectors(values)) => {
                    let values = self.expanded(name, values, count)?;
                    ColumnValues::Vectors(self.kind(name), values)
                }
            }))
        });
        let mut column = match column {
            Ok(column) => column?,
            Err(message) => {
                self.warn(&format!("left out: {message}"));
                return None;
            }
        };
        let bad = column.remove_non_finite();
        if bad > 0 {
            self.warn(&format!(
                "{bad} values of {name} are not finite and count as 0"
            ));
        }
        Some(column)
    }

    fn kind(&self, name: &str) -> VectorKind {
        let path = self.prim.append_property(name).ok();
        let type_name = path.and_then(|path| self.file.metadata(&path, "typeName"));
        match type_name {
            Some(Value::Token(name)) if name.as_str().starts_with("color") => VectorKind::Color,
            Some(Value::Token(name)) if name.as_str().starts_with("normal") => VectorKind::Normal,
            _ => VectorKind::Vector,
        }
    }
}

pub(super) fn stage_info(file: &File) -> StageInfo {
    let root = SdfPath::abs_root();
    let number = |name: &str| match file.metadata(&root, name) {
        Some(Value::Double(number)) if number.is_finite() && number > 0.0 => Some(number),
        _ => None,
    };
    let token = |name: &str| match file.metadata(&root, name) {
        Some(Value::Token(token)) => Some(token.as_str().to_owned()),
        _ => None,
    };
    StageInfo {
        path: std::path::PathBuf::new(),
        up_axis: match token("upAxis").as_deref() {
            Some("Z") => UpAxis::Z,
            _ => UpAxis::Y,
        },
        meters_per_unit: number("metersPerUnit").unwrap_or(0.01),
        default_prim: token("defaultPrim"),
        time_range: None,
        time_codes_per_second: number("timeCodesPerSecond").unwrap_or(24.0),
        time: None,
        layers: Vec::new(),
        variants: Vec::new(),
        reader: "native".to_owned(),
    }
}
