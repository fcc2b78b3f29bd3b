//! Reading surfel clouds back from UsdGeomPoints: those that `writers::usd::cloud` wrote, and those that come from
//! other programs.
//!
//! | of a surfel | read from | when missing |
//! |---|---|---|
//! | normal | `normals`, `primvars:normals`, `primvars:N` | the points are particles |
//! | radius | `widths` / 2 | √(area / π); an error when there is no area either |
//! | area | `primvars:area` | π r² |
//! | radiosity | `primvars:radiosity` | π · `primvars:displayColor`, else 0 with a warning |
//! | albedo, emission | `primvars:albedo`, `primvars:emission` | 0: all its light is final |
//! | source prim | `primvars:sourcePrim` and the paths in `customData` | the `Points` prim |
//!
//! A prim without normals, or with `primvars:emission` and no `primvars:radiosity`, holds no surfels but particles that glow
//! ([`read_particles`]): spheres, or disks where there are normals; radius `widths` / 2, radiance `primvars:emission` / π, else
//! `primvars:radiosity` / π, else `primvars:displayColor`.
//!
//! One value stands for all, whatever the interpolation says; `varying` and `vertex` are the same on points.

pub(super) mod file;
mod particles;
mod placement;
mod points;
mod splats;

pub use particles::read_particles;
pub use points::read_points;

use super::Error;
use crate::diagnostics::Diagnostics;
use crate::scene::StageInfo;
use crate::surfels::SurfelCloud;
use crate::surfels::points::{PointSet, first_bad};
use crate::surfels::splats::Splats;
use file::{Column, File};
use glam::{DVec3, Vec3};
use openusd::sdf::{Path as SdfPath, Value};
use placement::Placement;
use std::f32::consts::PI;
use std::path::Path;

/// What a layer holds that can be read without composing.
#[derive(Debug)]
pub enum Found {
    /// Points, and what the layer says of itself.
    Points(PointSet, StageInfo),
    /// Gaussian splats, and the same.
    Splats(Splats, StageInfo),
    /// It composes others, has neither, or only a door to USD can read it.
    Neither,
}

/// Read the points or splats of the layer at `path`, if it holds some and nothing that would have to be composed.
///
/// # Errors
/// Points and splats that contradict themselves; layers that cannot be read at all are [`Found::Neither`].
pub fn find(path: &Path, diagnostics: &Diagnostics) -> Result<Found, Error> {
    let read = |file: &File| -> Result<Found, String> {
        if file.composes().is_some() {
            return Ok(Found::Neither);
        }
        if let Some((splats, about)) = splats::read(file, diagnostics)? {
            return Ok(Found::Splats(splats, about));
        }
        if file.points().is_empty() {
            return Ok(Found::Neither);
        }
        points::points(file, diagnostics).map(|(set, about)| Found::Points(set, about))
    };
    let found = match file::on_layer(path, |file| Ok(read(file))) {
        Err(_) => return Ok(Found::Neither),
        Ok(found) => found,
    };
    let mut found = found.map_err(|message| Error::Layer {
        path: path.to_owned(),
        message,
    })?;
    if let Found::Points(_, about) | Found::Splats(_, about) = &mut found {
        path.clone_into(&mut about.path);
    }
    Ok(found)
}

/// Read every `Points` prim of the USD file at `path` as one cloud, positions relative to `origin`.
///
/// Ancestors' transforms are applied; radii and areas grow with them. Lengths are the file's own units. Points without
/// size or with a zero normal are left out with a warning.
///
/// # Errors
/// Unreadable files, files that refer to other layers (flatten them first), arrays of wrong length, non-finite values:
/// the message names prim, attribute and the right length.
pub fn read_cloud(
    path: &Path,
    origin: DVec3,
    diagnostics: &Diagnostics,
) -> Result<SurfelCloud, Error> {
    file::on_layer(path, |file| clouds(file, origin, diagnostics))
}

/// All clouds of `file` as one.
fn clouds(file: &File, origin: DVec3, diagnostics: &Diagnostics) -> Result<SurfelCloud, String> {
    if let Some(arc) = file.composes() {
        return Err(format!(
            "{arc}; a cloud is read from one layer alone: flatten it first"
        ));
    }
    let mut cloud = SurfelCloud {
        origin,
        ..SurfelCloud::default()
    };
    let prims = file.points();
    if prims.is_empty() {
        return Err("it has no Points prim".to_owned());
    }
    for prim in prims {
        let part = Part {
            file,
            prim,
            diagnostics,
        };
        if let Some(read) = part.read(origin)? {
            append(&mut cloud, read);
        }
    }
    Ok(cloud)
}

/// One `Points` prim being read.
struct Part<'a> {
    file: &'a File,
    prim: SdfPath,
    diagnostics: &'a Diagnostics,
}

impl Part<'_> {
    fn read(&self, origin: DVec3) -> Result<Option<SurfelCloud>, String> {
        let position = match self.file.column(&self.prim, "points")? {
            Some(Column::Vectors(points)) => points,
            Some(_) => return Err(self.wrong("points", "three components a point")),
            None => Vec::new(),
        };
        let count = position.len();
        self.check_finite("points", &position)?;
        let Some(normal) = self.normals(count)?.filter(|_| !self.only_glows()) else {
            return Ok(None);
        };
        let (radius, area) = self.sizes(count)?;
        let (prim, prim_paths) = self.sources(count)?;
        let zero = || vec![Vec3::ZERO; count];
        let mut cloud = SurfelCloud {
            origin,
            position,
            normal,
            radius,
            area,
            radiosity: self.radiosity(count)?,
            albedo: self.vectors("primvars:albedo", count)?.unwrap_or_else(zero),
            emission: self
                .vectors("primvars:emission", count)?
                .unwrap_or_else(zero),
            prim,
            prim_paths,
            spacing: self.spacing()?,
        };
        self.place(&mut cloud, origin)?;
        self.leave_out_useless(&mut cloud);
        Ok(Some(cloud))
    }

    fn normals(&self, count: usize) -> Result<Option<Vec<Vec3>>, String> {
        for name in ["normals", "primvars:normals", "primvars:N"] {
            if let Some(normals) = self.vectors(name, count)? {
                return Ok(Some(normals));
            }
        }
        Ok(None)
    }

    /// True if its points are sources of light and nothing else, whether or not they face somewhere.
    fn only_glows(&self) -> bool {
        let has = |name: &str| {
            let path = self.prim.append_property(name);
            path.is_ok_and(|path| self.file.has(&path))
        };
        has("primvars:emission") && !has("primvars:radiosity")
    }

    /// Radii and areas.
    fn sizes(&self, count: usize) -> Result<(Vec<f32>, Vec<f32>), String> {
        let radius = self.floats("widths", count)?;
        let radius =
            radius.map(|widths| widths.iter().map(|width| 0.5 * width).collect::<Vec<_>>());
        let area = self.floats("primvars:area", count)?;
        match (radius, area) {
            (Some(radius), Some(area)) => Ok((radius, area)),
            (Some(radius), None) => {
                let area = radius.iter().map(|radius| PI * radius * radius).collect();
                Ok((radius, area))
            }
            (None, Some(area)) => {
                let radius = area
                    .iter()
                    .map(|area| (area / PI).max(0.0).sqrt())
                    .collect();
                Ok((radius, area))
            }
            (None, None) if count == 0 => Ok((Vec::new(), Vec::new())),
            (None, None) => Err(format!(
                "{} has neither widths nor primvars:area: it needs one diameter a point",
                self.prim
            )),
        }
    }

    fn radiosity(&self, count: usize) -> Result<Vec<Vec3>, String> {
        if let Some(radiosity) = self.vectors("primvars:radiosity", count)? {
            return Ok(radiosity);
        }
        if let Some(mut color) = self.vectors("primvars:displayColor", count)? {
            color.iter_mut().for_each(|radiance| *radiance *= PI);
            return Ok(color);
        }
        self.warn("it has neither primvars:radiosity nor primvars:displayColor, so it is black");
        Ok(vec![Vec3::ZERO; count])
    }

    /// Source prims of the points, and the paths they count.
    fn sources(&self, count: usize) -> Result<(Vec<u32>, Vec<String>), String> {
        let ids = match self.file.column(&self.prim, "primvars:sourcePrim")? {
            Some(Column::Ints(ids)) => self.expanded("primvars:sourcePrim", ids, count)?,
            _ => return Ok((vec![0; count], vec![self.prim.to_string()])),
        };
        let paths = source_paths(self.file, &self.prim);
        let id = |id: i32| {
            u32::try_from(id)
                .ok()
                .filter(|&id| (id as usize) < paths.len())
        };
        match ids.into_iter().map(id).collect::<Option<Vec<_>>>() {
            Some(ids) => Ok((ids, paths)),
            None => {
                self.warn(
                    "primvars:sourcePrim does not fit the paths in customData, so it is ignored",
                );
                Ok((vec![0; count], vec![self.prim.to_string()]))
            }
        }
    }

    fn spacing(&self) -> Result<f32, String> {
        Ok(match self.file.value(&self.prim, "surflux:spacing")? {
            Some(Value::Float(spacing)) if spacing.is_finite() => spacing.max(0.0),
            _ => 0.0,
        })
    }

    fn vectors(&self, name: &str, count: usize) -> Result<Option<Vec<Vec3>>, String> {
        match self.file.column(&self.prim, name)? {
            Some(Column::Vectors(values)) => {
                self.check_finite(name, &values)?;
                self.expanded(name, values, count).map(Some)
            }
            Some(_) => Err(self.wrong(name, "three components a point")),
            None => Ok(None),
        }
    }

    fn floats(&self, name: &str, count: usize) -> Result<Option<Vec<f32>>, String> {
        match self.file.column(&self.prim, name)? {
            Some(Column::Floats(values)) => {
                if let Some(index) = first_bad(&values, |value| value.is_finite()) {
                    return Err(self.not_finite(name, index));
                }
                self.expanded(name, values, count).map(Some)
            }
            Some(_) => Err(self.wrong(name, "one float a point")),
            None => Ok(None),
        }
    }

    fn expanded<T: Copy>(
        &self,
        name: &str,
        values: Vec<T>,
        count: usize,
    ) -> Result<Vec<T>, String> {
        match values.len() {
            length if length == count => Ok(values),
            1 => Ok(vec![values[0]; count]),
            length => Err(self.wrong(name, &format!("{count} values (or 1), not {length}"))),
        }
    }

    fn check_finite(&self, name: &str, values: &[Vec3]) -> Result<(), String> {
        match first_bad(values, |value| value.is_finite()) {
            Some(index) => Err(self.not_finite(name, index)),
            None => Ok(()),
        }
    }

    fn not_finite(&self, name: &str, index: usize) -> String {
        format!("{}.{name}[{index}] is not a finite number", self.prim)
    }

    fn wrong(&self, name: &str, right: &str) -> String {
        format!("{}.{name} should have {right}", self.prim)
    }

    fn warn(&self, message: &str) {
        self.diagnostics
            .warn("cloud", self.prim.to_string(), message);
    }

    /// From prim space to world space.
    fn place(&self, cloud: &mut SurfelCloud, origin: DVec3) -> Result<(), String> {
        let placement = Placement::new(placement::world_from_prim(self.file, &self.prim)?, origin);
        for position in &mut cloud.position {
            *position = placement.position(*position);
        }
        let sizes = cloud.radius.iter_mut().zip(&mut cloud.area);
        for (normal, (radius, area)) in cloud.normal.iter_mut().zip(sizes) {
            let (turned, growth) = placement.normal_and_growth(unit(*normal));
            *normal = turned;
            *radius *= growth.sqrt();
            *area = area.max(0.0) * growth;
        }
        Ok(())
    }

    fn leave_out_useless(&self, cloud: &mut SurfelCloud) {
        let sizes = cloud.radius.iter().zip(&cloud.normal);
        let useful: Vec<bool> = sizes
            .map(|(&radius, &normal)| radius > 0.0 && normal != Vec3::ZERO)
            .collect();
        let useless = useful.iter().filter(|&&useful| !useful).count();
        if useless == 0 {
            return;
        }
        self.warn(&format!(
            "{useless} points without size or normal are left out"
        ));
        let columns = [
            &mut cloud.position,
            &mut cloud.normal,
            &mut cloud.radiosity,
            &mut cloud.albedo,
            &mut cloud.emission,
        ];
        columns
            .into_iter()
            .for_each(|column| retain(column, &useful));
        retain(&mut cloud.radius, &useful);
        retain(&mut cloud.area, &useful);
        retain(&mut cloud.prim, &useful);
    }
}

/// Paths of the source prims that `primvars:sourcePrim` of `prim` counts.
pub(super) fn source_paths(file: &File, prim: &SdfPath) -> Vec<String> {
    let entry = |dictionary, key: &str| match dictionary {
        Some(Value::Dictionary(mut entries)) => entries.remove(key),
        _ => None,
    };
    let custom = file.metadata(prim, "customData");
    match entry(entry(custom, "surflux"), "primPaths") {
        Some(Value::StringVec(paths)) => paths,
        // openusd's text parser takes every array of strings in a dictionary for tokens
        Some(Value::TokenVec(paths)) => paths.into_iter().map(String::from).collect(),
        _ => Vec::new(),
    }
}

/// `normal` at unit length, untouched where it has that already: a cloud of ours comes back to the bit.
fn unit(normal: Vec3) -> Vec3 {
    match normal.is_normalized() {
        true => normal,
        false => normal.normalize_or_zero(),
    }
}

fn retain<T>(column: &mut Vec<T>, useful: &[bool]) {
    let mut useful = useful.iter();
    column.retain(|_| *useful.next().expect("one flag a value"));
}

/// Add `part` to `cloud`; source prims are counted on, the spacing is the finest.
fn append(cloud: &mut SurfelCloud, part: SurfelCloud) {
    if cloud.is_empty() && cloud.prim_paths.is_empty() {
        *cloud = part;
        return;
    }
    let offset = u32::try_from(cloud.prim_paths.len()).expect("fewer than 2^32 prims");
    cloud.position.extend(part.position);
    cloud.normal.extend(part.normal);
    cloud.radius.extend(part.radius);
    cloud.area.extend(part.area);
    cloud.radiosity.extend(part.radiosity);
    cloud.albedo.extend(part.albedo);
    cloud.emission.extend(part.emission);
    cloud
        .prim
        .extend(part.prim.iter().map(|prim| prim + offset));
    cloud.prim_paths.extend(part.prim_paths);
    cloud.spacing = cloud.spacing.min(part.spacing);
}
