//! A cloud or a bake of ours (or of another program) → what is wrong with it.
//!
//! The file itself is read layer by layer, without composition; a bake is then composed over its asset, for only the
//! meshes say how many values each interpolation needs. Through the usd-core door Pixar's validators are asked too; of
//! a bake they report what the asset alone does not have.

mod bake;
mod cloud;
mod columns;

use super::cloud::file::{self, File};
use super::{Door, Error, UsdVerdict};
use crate::diagnostics::Diagnostics;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Check {
    /// Prims, schemas and attributes that must or must not be there.
    Structure,
    /// As many values as the interpolation needs.
    Length,
    /// `interpolation` is authored and one that readers understand.
    Interpolation,
    /// `extent` holds all points with their widths, and little more.
    Extent,
    /// No NaN, no infinity.
    NonFinite,
    /// Diameters and areas are above 0.
    Widths,
    /// Directions are unit vectors.
    Normals,
    /// Ids name what there is.
    Ids,
    /// Light is not negative, fractions are within 0 and 1.
    Range,
    /// Axis and units are authored, and those of the asset.
    Units,
    /// Pixar's own validators.
    Usd,
}

impl Check {
    /// All of them, in the order of the report.
    pub const ALL: [Self; 11] = [
        Self::Structure,
        Self::Length,
        Self::Interpolation,
        Self::Extent,
        Self::NonFinite,
        Self::Widths,
        Self::Normals,
        Self::Ids,
        Self::Range,
        Self::Units,
        Self::Usd,
    ];

    /// As in the JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Structure => "structure",
            Self::Length => "length",
            Self::Interpolation => "interpolation",
            Self::Extent => "extent",
            Self::NonFinite => "non-finite",
            Self::Widths => "widths",
            Self::Normals => "normals",
            Self::Ids => "ids",
            Self::Range => "range",
            Self::Units => "units",
            Self::Usd => "usd",
        }
    }
}

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Readers will show something wrong, or nothing.
    Error,
    /// Most readers will cope.
    Warning,
}

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Finding {
    /// How bad.
    pub severity: Severity,
    /// Which check found it.
    pub check: Check,
    /// Prim or attribute path, `/` for the layer as a whole.
    pub place: String,
    /// What is wrong, and what would have been right.
    pub message: String,
}

/// What a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// It has `Points` prims and no sublayers.
    Cloud,
    /// Primvars over an asset.
    Bake,
}

/// The verdict on one file.
#[derive(Debug, Clone)]
pub struct Validation {
    /// What it is.
    pub kind: Kind,
    /// The layer of a bake's values.
    pub layer: PathBuf,
    /// The stage that a bake was composed in; `None` for clouds, and where no stage shows the bake.
    pub stage: Option<PathBuf>,
    /// Values that each check looked at.
    pub looked_at: BTreeMap<Check, usize>,
    /// Everything that is wrong, sorted.
    pub findings: Vec<Finding>,
    /// Pixar's validators, if they were asked.
    pub validators: Option<String>,
}

/// Findings being collected.
#[derive(Debug, Default)]
struct Audit {
    looked_at: BTreeMap<Check, usize>,
    findings: Vec<Finding>,
}

impl Audit {
    /// `count` values are looked at by `check`.
    fn look(&mut self, check: Check, count: usize) {
        *self.looked_at.entry(check).or_default() += count;
    }

    fn error(&mut self, check: Check, place: impl ToString, message: impl Into<String>) {
        self.find(Severity::Error, check, place.to_string(), message.into());
    }

    fn warn(&mut self, check: Check, place: impl ToString, message: impl Into<String>) {
        self.find(Severity::Warning, check, place.to_string(), message.into());
    }

    fn find(&mut self, severity: Severity, check: Check, place: String, message: String) {
        self.findings.push(Finding {
            severity,
            check,
            place,
            message,
        });
    }

    fn merge(&mut self, other: Self) {
        for (check, count) in other.looked_at {
            self.look(check, count);
        }
        self.findings.extend(other.findings);
    }
}

/// Look at the cloud or bake at `path`, USD read through `door`.
///
/// # Errors
/// Files that cannot be read at all, or that are neither; what is wrong inside is a finding.
pub fn validate(path: &Path, door: Door, diagnostics: &Diagnostics) -> Result<Validation, Error> {
    let mut audit = Audit::default();
    let (layer, shown_in) = bake::parts(path)?;
    let kind = match layer == path {
        true => on_layer(path, &mut audit, kind_of)?,
        false => Kind::Bake,
    };
    let (stage, asset) = match (kind, shown_in) {
        (Kind::Cloud, _) => {
            on_layer(path, &mut audit, cloud::check)?;
            (Some(path.to_owned()), None)
        }
        (Kind::Bake, shown_in) => {
            let written = on_layer(&layer, &mut audit, bake::check_layer)?;
            let (stage, asset) = shown_in.unzip();
            bake::check_composed(&written, stage.as_deref(), (door, diagnostics), &mut audit)?;
            (stage, asset)
        }
    };
    let validators = match &stage {
        Some(stage) => ask_usd(stage, asset.as_deref(), (door, diagnostics), &mut audit)?,
        None => None,
    };
    audit.findings.sort();
    audit.findings.dedup();
    Ok(Validation {
        kind,
        layer,
        stage: stage.filter(|_| kind == Kind::Bake),
        looked_at: audit.looked_at,
        findings: audit.findings,
        validators,
    })
}

fn kind_of(file: &File, _: &mut Audit) -> Result<Kind, String> {
    if file.composes().is_none() && !file.points().is_empty() {
        return Ok(Kind::Cloud);
    }
    match file.attributes().next() {
        Some(_) => Ok(Kind::Bake),
        None => Err("it is neither a cloud (no Points prim) nor a bake (no attribute)".to_owned()),
    }
}

/// `work` on the layer at `path`; what it found is added to `audit`.
fn on_layer<T: Send>(
    path: &Path,
    audit: &mut Audit,
    work: impl FnOnce(&File, &mut Audit) -> Result<T, String> + Send,
) -> Result<T, Error> {
    let (value, found) = file::on_layer(path, |file| {
        let mut found = Audit::default();
        Ok((work(file, &mut found)?, found))
    })?;
    audit.merge(found);
    Ok(value)
}

/// Pixar's validators on `stage`, without what they say of `asset` alone. Returns who they are.
fn ask_usd(
    stage: &Path,
    asset: Option<&Path>,
    (door, diagnostics): (Door, &Diagnostics),
    audit: &mut Audit,
) -> Result<Option<String>, Error> {
    let verdict_on = |path: &Path| super::open(path, door, diagnostics)?.validate(diagnostics);
    let Some(verdict) = verdict_on(stage)? else {
        return Ok(None);
    };
    let known = match asset {
        Some(asset) => verdict_on(asset)?.map(|verdict| verdict.complaints),
        None => None,
    };
    let known = known.unwrap_or_default();
    let UsdVerdict {
        validators,
        count,
        complaints,
    } = verdict;
    audit.look(Check::Usd, count);
    for complaint in complaints {
        if known.contains(&complaint) {
            continue;
        }
        let message = format!("{}: {}", complaint.name, complaint.message);
        match complaint.is_error {
            true => audit.error(Check::Usd, complaint.place, message),
            false => audit.warn(Check::Usd, complaint.place, message),
        }
    }
    Ok(Some(validators))
}
