//! `Points` prims of one layer.

use super::columns::Numbers;
use super::{Audit, Check};
use crate::stage::cloud::file::File;
use glam::Vec3;
use openusd::sdf::{Path as SdfPath, Value};
use std::collections::HashSet;
use std::f32::consts::PI;

/// Columns that `SurfluxCloudAPI` promises.
const COLUMNS: [&str; 10] = [
    "extent",
    "widths",
    "normals",
    "primvars:N",
    "primvars:displayColor",
    "primvars:radiosity",
    "primvars:albedo",
    "primvars:emission",
    "primvars:area",
    "primvars:sourcePrim",
];

/// Attributes with one value a point.
const PER_POINT: [&str; 6] = [
    "widths",
    "normals",
    "ids",
    "velocities",
    "accelerations",
    "angularVelocities",
];

/// An extent may be off by this fraction of its diagonal: corners are sums rounded to single precision.
const EXTENT_TOLERANCE: f32 = 1e-5;

/// An extent larger than the points by this fraction of the diagonal makes viewers frame and cull badly.
const EXTENT_SLACK: f32 = 0.01;

/// `displayColor` is radiosity / π up to single precision and a little room for other programs.
const DISPLAY_TOLERANCE: f32 = 1e-4;

/// All `Points` prims, and what the layer says of itself.
pub(super) fn check(file: &File, audit: &mut Audit) -> Result<(), String> {
    check_units(file, audit);
    for prim in file.points() {
        let part = Part {
            is_ours: file.has_schema(&prim, "SurfluxCloudAPI"),
            count: part_count(file, &prim)?,
            file,
            prim,
        };
        part.check(audit)?;
    }
    Ok(())
}

/// `metersPerUnit`, `upAxis`, `defaultPrim`.
fn check_units(file: &File, audit: &mut Audit) {
    let root = SdfPath::abs_root();
    audit.look(Check::Units, 3);
    match file.metadata(&root, "metersPerUnit") {
        Some(Value::Double(unit)) if unit > 0.0 && unit.is_finite() => {}
        Some(_) => audit.error(Check::Units, "/", "metersPerUnit is not above 0"),
        None => audit.warn(
            Check::Units,
            "/",
            "metersPerUnit is not authored: readers take centimeters",
        ),
    }
    match file.metadata(&root, "upAxis") {
        Some(Value::Token(axis)) if matches!(axis.as_str(), "Y" | "Z") => {}
        Some(_) => audit.error(Check::Units, "/", "upAxis is neither Y nor Z"),
        None => audit.warn(Check::Units, "/", "upAxis is not authored: readers take Y"),
    }
    match file.metadata(&root, "defaultPrim") {
        Some(Value::Token(name)) => {
            let path = SdfPath::new(&format!("/{}", name.as_str()));
            if !path.is_ok_and(|path| file.has(&path)) {
                let message = format!("defaultPrim {} does not exist", name.as_str());
                audit.error(Check::Structure, "/", message);
            }
        }
        _ => audit.warn(
            Check::Structure,
            "/",
            "no defaultPrim: a reference to this file finds nothing",
        ),
    }
}

fn part_count(file: &File, prim: &SdfPath) -> Result<usize, String> {
    Ok(match file.value(prim, "points")? {
        Some(value) => Numbers::new(&value).map_or(0, |points| points.len()),
        None => 0,
    })
}

/// One `Points` prim.
struct Part<'a> {
    file: &'a File,
    prim: SdfPath,
    count: usize,
    is_ours: bool,
}

impl Part<'_> {
    fn check(&self, audit: &mut Audit) -> Result<(), String> {
        self.check_columns(audit)?;
        for name in self.file.attributes_of(&self.prim) {
            let Some(value) = self.file.value(&self.prim, &name)? else {
                continue;
            };
            self.check_attribute(&name, &value, audit)?;
        }
        self.check_sizes(audit)?;
        self.check_extent(audit)?;
        self.check_sources(audit)?;
        self.check_display(audit)
    }

    fn place(&self, name: &str) -> String {
        format!("{}.{name}", self.prim)
    }

    /// What must be there.
    fn check_columns(&self, audit: &mut Audit) -> Result<(), String> {
        audit.look(Check::Structure, 1);
        if self.file.value(&self.prim, "points")?.is_none() {
            audit.error(Check::Structure, &self.prim, "it has no points");
        }
        if self.is_ours {
            audit.look(Check::Structure, COLUMNS.len());
            for name in COLUMNS {
                if self.file.value(&self.prim, name)?.is_none() {
                    let message = "SurfluxCloudAPI promises it, but it has no value";
                    audit.error(Check::Structure, self.place(name), message);
                }
            }
            self.check_spacing(audit)?;
        } else if self.file.value(&self.prim, "normals")?.is_none()
            && self.file.value(&self.prim, "primvars:N")?.is_none()
        {
            let message = "it has no normals: its points face nowhere and cannot light anything";
            audit.warn(Check::Structure, &self.prim, message);
        }
        Ok(())
    }

    fn check_spacing(&self, audit: &mut Audit) -> Result<(), String> {
        audit.look(Check::Units, 1);
        match self.file.value(&self.prim, "surflux:spacing")? {
            Some(Value::Float(spacing)) if spacing >= 0.0 && spacing.is_finite() => {}
            _ => audit.error(
                Check::Units,
                self.place("surflux:spacing"),
                "a length of 0 or more in stage units is needed",
            ),
        }
        Ok(())
    }

    fn check_attribute(&self, name: &str, value: &Value, audit: &mut Audit) -> Result<(), String> {
        let place = self.place(name);
        let base = name.strip_prefix("primvars:").unwrap_or(name);
        let is_primvar = name.starts_with("primvars:") && !name.ends_with(":indices");
        if let Some(numbers) = Numbers::new(value) {
            numbers.check_finite(&place, audit);
            numbers.check_meaning(base, &place, audit);
        }
        if is_primvar || PER_POINT.contains(&name) {
            let length = match self.file.value(&self.prim, &format!("{name}:indices"))? {
                Some(Value::IntVec(indices)) => self.check_indices(name, &indices, value, audit),
                _ => length(value),
            };
            self.check_length((name, is_primvar), length, audit);
        }
        if name == "ids" {
            check_unique(value, &place, audit);
        }
        Ok(())
    }

    /// The number of indexed values.
    fn check_indices(
        &self,
        name: &str,
        indices: &[i32],
        value: &Value,
        audit: &mut Audit,
    ) -> Option<usize> {
        let values = length(value)?;
        audit.look(Check::Ids, indices.len());
        let fits = |&index: &i32| usize::try_from(index).is_ok_and(|index| index < values);
        if let Some(at) = indices.iter().position(|index| !fits(index)) {
            let message = format!(
                "index {} at {at}, but there are {values} values",
                indices[at]
            );
            audit.error(Check::Ids, self.place(&format!("{name}:indices")), message);
        }
        Some(indices.len())
    }

    fn check_length(
        &self,
        (name, is_primvar): (&str, bool),
        length: Option<usize>,
        audit: &mut Audit,
    ) {
        let place = self.place(name);
        let authored = self.file.interpolation(&self.prim, name);
        audit.look(Check::Interpolation, 1);
        // schema: widths and normals of points vary where nothing is said, primvars are constant
        let interpolation = match (&authored, is_primvar) {
            (Some(authored), _) => authored.as_str(),
            (None, true) => "constant",
            (None, false) => "vertex",
        };
        if authored.is_none() && self.is_ours && name != "ids" {
            audit.error(
                Check::Interpolation,
                &place,
                "no interpolation is authored: some readers take constant",
            );
        }
        let needed = match interpolation {
            "vertex" | "varying" => self.count,
            "constant" | "uniform" => 1,
            other => {
                let message =
                    format!("interpolation {other} has no meaning on points (right: vertex)");
                audit.error(Check::Interpolation, place, message);
                return;
            }
        };
        let Some(length) = length else { return };
        audit.look(Check::Length, length);
        let elements = self.file.element_size(&self.prim, name);
        if length != needed * elements {
            let message = format!(
                "{length} values, but {interpolation} on {} points needs {}",
                self.count,
                needed * elements
            );
            audit.error(Check::Length, place, message);
        }
    }

    /// Diameters and areas.
    fn check_sizes(&self, audit: &mut Audit) -> Result<(), String> {
        for name in ["widths", "primvars:area"] {
            let Some(numbers) = self.numbers(name)? else {
                continue;
            };
            audit.look(Check::Widths, numbers.len());
            let is_bad = |&&value: &&f32| value <= 0.0;
            let bad = numbers.values.iter().filter(is_bad).count();
            let place = self.place(name);
            match bad {
                0 => {}
                _ if name == "widths" => {
                    let message = format!(
                        "{bad} of {} are not above 0: such points are not seen",
                        numbers.len()
                    );
                    audit.error(Check::Widths, place, message);
                }
                _ => {
                    let message = format!(
                        "{bad} of {} are not above 0: they send no light",
                        numbers.len()
                    );
                    audit.warn(Check::Widths, place, message);
                }
            }
        }
        Ok(())
    }

    fn numbers(&self, name: &str) -> Result<Option<Numbers>, String> {
        let value = self.file.value(&self.prim, name)?;
        Ok(value.as_ref().and_then(Numbers::new))
    }

    /// `extent` against the points taken as balls of half their width, as USD computes it.
    fn check_extent(&self, audit: &mut Audit) -> Result<(), String> {
        let place = self.place("extent");
        let (Some(points), Some(extent)) = (self.numbers("points")?, self.numbers("extent")?)
        else {
            return Ok(());
        };
        audit.look(Check::Extent, points.len());
        let corners: Vec<Vec3> = extent
            .values
            .chunks_exact(extent.width)
            .map(vector)
            .collect();
        let [low, high] = corners[..] else {
            let message = format!("{} values, but an extent has 2 corners", corners.len());
            audit.error(Check::Extent, place, message);
            return Ok(());
        };
        let widths = self
            .numbers("widths")?
            .map_or(Vec::new(), |widths| widths.values);
        let radius = |i: usize| 0.5 * widths.get(i).or(widths.first()).copied().unwrap_or(0.0);
        let balls = points
            .values
            .chunks_exact(points.width)
            .map(vector)
            .enumerate();
        let (mut least, mut most) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for (i, center) in balls.filter(|(_, center)| center.is_finite()) {
            least = least.min(center - radius(i));
            most = most.max(center + radius(i));
        }
        if !least.is_finite() {
            return Ok(());
        }
        // the corners' own rounding, which counts far from the origin
        let size = (most - least).length();
        let rounding =
            EXTENT_TOLERANCE * size + f32::EPSILON * most.abs().max(least.abs()).max_element();
        let outside = (low - least).max(most - high).max_element();
        if outside.is_nan() || outside > rounding {
            let message = format!(
                "points with their widths reach from {least} to {most}, beyond {low} to {high}"
            );
            audit.error(Check::Extent, place, message);
        } else if (least - low).max(high - most).max_element() > EXTENT_SLACK * size + rounding {
            let message = format!("{low} to {high} is larger than the points, {least} to {most}");
            audit.warn(Check::Extent, place, message);
        }
        Ok(())
    }

    /// `primvars:sourcePrim` counts the paths in `customData`.
    fn check_sources(&self, audit: &mut Audit) -> Result<(), String> {
        let Some(Value::IntVec(ids)) = self.file.value(&self.prim, "primvars:sourcePrim")? else {
            return Ok(());
        };
        let paths = crate::stage::cloud::source_paths(self.file, &self.prim).len();
        audit.look(Check::Ids, ids.len());
        let names_one = |&id: &i32| usize::try_from(id).is_ok_and(|id| id < paths);
        if let Some(at) = ids.iter().position(|id| !names_one(id)) {
            let message = format!(
                "point {at} comes from prim {}, but customData names {paths} paths",
                ids[at]
            );
            audit.error(Check::Ids, self.place("primvars:sourcePrim"), message);
        }
        Ok(())
    }

    /// Viewers show `displayColor`: it is the radiance, radiosity / π.
    fn check_display(&self, audit: &mut Audit) -> Result<(), String> {
        let columns = (
            self.numbers("primvars:displayColor")?,
            self.numbers("primvars:radiosity")?,
        );
        let (Some(display), Some(radiosity)) = columns else {
            return Ok(());
        };
        audit.look(Check::Range, display.len());
        let pairs = display.values.iter().zip(&radiosity.values);
        let is_off = |&(&display, &radiosity): &(&f32, &f32)| {
            (display * PI - radiosity).abs() > DISPLAY_TOLERANCE * radiosity.abs()
        };
        let off = pairs.filter(is_off).count();
        if off > 0 {
            let message = format!(
                "{off} components are not radiosity / π: viewers show other light than is gathered"
            );
            audit.warn(Check::Range, self.place("primvars:displayColor"), message);
        }
        Ok(())
    }
}

fn vector(components: &[f32]) -> Vec3 {
    match *components {
        [x, y, z, ..] => Vec3::new(x, y, z),
        _ => Vec3::NAN,
    }
}

/// Values of an array; `None` for what is no array.
pub(super) fn length(value: &Value) -> Option<usize> {
    match value {
        Value::Int64Vec(v) => Some(v.len()),
        Value::StringVec(v) => Some(v.len()),
        Value::TokenVec(v) => Some(v.len()),
        _ => Numbers::new(value)
            .filter(|numbers| numbers.is_array)
            .map(|numbers| numbers.len()),
    }
}

fn check_unique(value: &Value, place: &str, audit: &mut Audit) {
    if let Value::Int64Vec(ids) = value {
        audit.look(Check::Ids, ids.len());
        let mut seen = HashSet::with_capacity(ids.len());
        if let Some(twice) = ids.iter().find(|id| !seen.insert(**id)) {
            audit.error(Check::Ids, place, format!("id {twice} stands twice"));
        }
    }
}
