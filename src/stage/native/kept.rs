//! What one load has read, kept for loads of the same stage at other times: they read only what varies.

use super::layer_files::LayerFiles;
use super::properties::Properties;
use super::sites::{Fault, Sites};
use crate::diagnostics::{CancelToken, Cancelled, Warning};
use crate::stage::Error;
use crate::stage::attributes::Attributes;
use crate::stage::raw::{MOVED, RawPrim, RawStage, ReadCounts, Request};
use openusd::sdf;
use openusd::usd::Stage;
use std::sync::Arc;

/// What a walk over a stage found.
pub(super) struct Walked {
    pub(super) raw: RawStage,
    pub(super) warnings: Vec<Warning>,
    /// Prims in reach of value clips.
    pub(super) clipped: Vec<usize>,
}

/// A load's result, without the values that vary.
pub(super) struct Kept {
    request: Request,
    raw: RawStage,
    warnings: Vec<Warning>,
    moving: Vec<Moving>,
}

/// A prim with values that vary.
struct Moving {
    prim: usize,
    path: sdf::Path,
    /// Attributes to read again; none = all, which value clips may make vary.
    names: Option<Vec<String>>,
}

impl Kept {
    /// Of what `request` walked through; `None` at the default time, which no range of frames has.
    pub(super) fn new(request: &Request, walked: &Walked) -> Option<Self> {
        request.time?;
        let mut raw = walked.raw.clone();
        let mut moving = Vec::new();
        for (index, prim) in raw.prims.iter_mut().enumerate() {
            let is_clipped = walked.clipped.binary_search(&index).is_ok();
            let names = match is_clipped {
                true => None,
                false => Some(varying(prim)),
            };
            if names.as_ref().is_some_and(Vec::is_empty) {
                continue;
            }
            for name in names_of(prim, names.as_deref()) {
                if let Some(attribute) = prim.attributes.get_mut(&name) {
                    attribute.value = None;
                    attribute.held = None;
                }
            }
            moving.push(Moving {
                prim: index,
                path: sdf::Path::new(&prim.path).ok()?,
                names,
            });
        }
        Some(Self {
            request: request.clone(),
            raw,
            warnings: walked.warnings.clone(),
            moving,
        })
    }

    /// True if `request` differs from what was kept in its time only.
    pub(super) fn serves(&self, request: &Request) -> bool {
        let at_own_time = Request {
            time: self.request.time,
            ..request.clone()
        };
        request.time.is_some() && at_own_time == self.request
    }

    /// What `request` asks of `stage`, reading only what varies.
    ///
    /// # Errors
    /// What a whole load would refuse; cancellation.
    pub(super) fn at(
        &self,
        (stage, files): (&Stage, &LayerFiles),
        request: &Request,
        cancel: &CancelToken,
    ) -> Result<(RawStage, Vec<Warning>), Error> {
        let properties = Properties::new(stage, files, request);
        let mut raw = self.raw.clone();
        raw.meta.read = ReadCounts::default();
        for moving in &self.moving {
            if cancel.is_cancelled() {
                return Err(Cancelled.into());
            }
            let prim = &mut raw.prims[moving.prim];
            files.pulse().values();
            let read = moving.read(stage, &properties, prim);
            for attribute in read.map_err(super::traverse::refused)?.shared() {
                raw.meta.read.add(attribute.value.as_ref());
                prim.attributes.insert_shared(Arc::clone(attribute));
            }
        }
        Ok((raw, self.warnings.clone()))
    }
}

impl Moving {
    /// The attributes of `prim` that vary.
    fn read(
        &self,
        stage: &Stage,
        properties: &Properties<'_>,
        prim: &RawPrim,
    ) -> Result<Attributes, Fault> {
        let sites = Sites::of(stage, &self.path).map_err(|error| Fault {
            layer: stage.root_layer().identifier().to_owned(),
            message: format!("{}: {error:#}", self.path),
        })?;
        let mut read = RawPrim::typed("", &prim.type_name, None);
        match &self.names {
            Some(names) => {
                let names: Vec<&str> = names.iter().map(String::as_str).collect();
                properties.read_named(&names, &self.path, &sites, &mut read)?;
            }
            None => properties.read(&self.path, &sites, true, &mut read)?,
        }
        Ok(read.attributes)
    }
}

/// Names of the attributes of `prim` to be read at every time: those that vary; of an instancer, all that move its points
/// together.
fn varying(prim: &RawPrim) -> Vec<String> {
    let is_moved = |name: &str| prim.type_name == "PointInstancer" && MOVED.contains(&name);
    let mut names = prim.attributes.iter();
    let names = names.by_ref().filter(|(name, attribute)| {
        attribute.varying || attribute.held.is_some() || is_moved(name)
    });
    names.map(|(name, _)| name.clone()).collect()
}

/// Those of `names` that are attributes of `prim`; without `names`, all.
fn names_of(prim: &RawPrim, names: Option<&[String]>) -> Vec<String> {
    match names {
        Some(names) => names.to_vec(),
        None => prim.attributes.keys().cloned().collect(),
    }
}
