//! Points of a file that glow: fire, sparks, anything with a size and a color. PBGI §7.2.

use super::{Part, file, placement, placement::Placement, unit};
use crate::diagnostics::Diagnostics;
use crate::scene::ParticleSet;
use crate::stage::Error;
use glam::{DVec3, Vec3};
use std::f32::consts::FRAC_1_PI;
use std::path::Path;

/// Read every `Points` prim of the USD file at `path` that holds no surfels, each with its path; positions relative to
/// `origin`. Ancestors' transforms are applied, sizes grow with the cube root of what volumes do. Points without size or
/// light are left out, with a warning where none is left.
///
/// # Errors
/// As [`super::read_cloud`].
pub fn read_particles(
    path: &Path,
    origin: DVec3,
    diagnostics: &Diagnostics,
) -> Result<Vec<(String, ParticleSet)>, Error> {
    file::on_layer(path, |file| {
        if let Some(arc) = file.composes() {
            return Err(format!(
                "{arc}; a cloud is read from one layer alone: flatten it first"
            ));
        }
        let mut all = Vec::new();
        for prim in file.points() {
            let part = Part {
                file,
                prim,
                diagnostics,
            };
            if let Some(set) = part.particles(origin)? {
                all.push((part.prim.to_string(), set));
            }
        }
        Ok(all)
    })
}

impl Part<'_> {
    /// `None` if it holds surfels.
    fn particles(&self, origin: DVec3) -> Result<Option<ParticleSet>, String> {
        let position = match self.file.column(&self.prim, "points")? {
            Some(file::Column::Vectors(points)) => points,
            Some(_) => return Err(self.wrong("points", "three components a point")),
            None => Vec::new(),
        };
        let count = position.len();
        self.check_finite("points", &position)?;
        let normal = self.normals(count)?;
        if normal.is_some() && !self.only_glows() {
            return Ok(None);
        }
        let (radius, _) = self.sizes(count)?;
        let set = ParticleSet {
            position,
            radius,
            normal: normal.unwrap_or_default(),
            radiance: self.radiance(count)?,
        };
        let set = self.placed(set, origin)?;
        let kept = shining(&set);
        if kept.position.is_empty() {
            self.warn("no point of it has size and light: it gives none");
        }
        Ok(Some(kept))
    }

    fn radiance(&self, count: usize) -> Result<Vec<Vec3>, String> {
        let mut radiance = match self.vectors("primvars:emission", count)? {
            Some(mut emission) => {
                emission.iter_mut().for_each(|value| *value *= FRAC_1_PI);
                emission
            }
            None => {
                let mut radiosity = self.radiosity(count)?;
                radiosity.iter_mut().for_each(|value| *value *= FRAC_1_PI);
                radiosity
            }
        };
        if radiance.iter().any(|value| value.min_element() < 0.0) {
            self.warn("negative light counts as 0");
            for value in &mut radiance {
                *value = value.max(Vec3::ZERO);
            }
        }
        Ok(radiance)
    }

    /// From prim space to world space.
    fn placed(&self, mut set: ParticleSet, origin: DVec3) -> Result<ParticleSet, String> {
        let world = placement::world_from_prim(self.file, &self.prim)?;
        let placement = Placement::new(world, origin);
        for position in &mut set.position {
            *position = placement.position(*position);
        }
        self.check_finite("points", &set.position)?;
        #[expect(
            clippy::cast_possible_truncation,
            reason = "radii are single precision"
        )]
        let scale = world.determinant().abs().cbrt() as f32;
        set.radius.iter_mut().for_each(|radius| *radius *= scale);
        for normal in &mut set.normal {
            *normal = placement.normal_and_growth(unit(*normal)).0;
        }
        Ok(set)
    }
}

/// Those of `set` that give light.
fn shining(set: &ParticleSet) -> ParticleSet {
    let faces = |i: usize| set.normal.get(i).is_none_or(|normal| *normal != Vec3::ZERO);
    let shines = |&i: &usize| set.radius[i] > 0.0 && set.radiance[i] != Vec3::ZERO && faces(i);
    let kept: Vec<usize> = (0..set.position.len()).filter(shines).collect();
    ParticleSet {
        position: kept.iter().map(|&i| set.position[i]).collect(),
        radius: kept.iter().map(|&i| set.radius[i]).collect(),
        normal: match set.normal.is_empty() {
            true => Vec::new(),
            false => kept.iter().map(|&i| set.normal[i]).collect(),
        },
        radiance: kept.iter().map(|&i| set.radiance[i]).collect(),
    }
}
