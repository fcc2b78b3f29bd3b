//! Clouds and bakes → USD layers, with the `openusd` crate.
//!
//! Text or binary by extension (`.usda`; `.usdc` and `.usd` are binary). Binary files say version 0.8.0, the lowest
//! that can hold what is written here, so that every USD since 2021 opens them.

pub mod author;
pub mod baked;
pub mod cloud;
mod corrections;
pub mod layer;
mod opinions;
pub mod points;
pub mod splats;
mod targets;

pub use baked::asset_path;

use crate::scene::{StageInfo, UpAxis};
use crate::writers::whole::temporary_beside;
use openusd::sdf::{self, FieldKey, Value};
use openusd::{usda, usdc};
use opinions::Opinions;
use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Why a USD file could not be written. Nothing is left behind then; an older file of that name is untouched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The folder does not exist, is not writable, or the disk is full.
    #[error("cannot write {path}")]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// The name does not end as a USD file's does.
    #[error("cannot write {path}: its name should end in .usdc, .usda or .usd")]
    Extension {
        /// The file.
        path: PathBuf,
    },
    /// The layer cannot be put into the file format.
    #[error("cannot write {path}: {message}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What the format refuses.
        message: String,
    },
    /// A prim path that USD does not allow.
    #[error("{prim} cannot be written to: {message}")]
    Prim {
        /// The path.
        prim: String,
        /// What is wrong with it.
        message: String,
    },
}

/// Where a file comes from; USD keeps it in its `customLayerData`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Provenance {
    /// Version of surflux.
    pub version: String,
    /// The command line, program name included.
    pub command: Vec<String>,
    /// Free text of the user's.
    pub comment: Option<String>,
}

impl Provenance {
    /// `surflux 0.1.0`.
    pub fn program(&self) -> String {
        format!("surflux {}", self.version)
    }

    /// The command line in one line.
    pub fn words(&self) -> String {
        self.command.join(" ").replace(char::is_control, " ")
    }

    fn dictionary(&self, source: &Path) -> HashMap<String, Value> {
        let string = |text: &str| Value::String(text.to_owned());
        let mut surflux = HashMap::from([
            ("version".to_owned(), string(&self.version)),
            ("command".to_owned(), string(&self.command.join(" "))),
            ("stage".to_owned(), string(&source.to_string_lossy())),
        ]);
        if let Some(comment) = &self.comment {
            surflux.insert("comment".to_owned(), string(comment));
        }
        HashMap::from([("surflux".to_owned(), Value::Dictionary(surflux))])
    }
}

/// Author what every layer of ours says of itself: axis, units, time codes, provenance.
fn author_metadata(layer: &mut Opinions, stage: &StageInfo, provenance: &Provenance) {
    let up_axis = match stage.up_axis {
        UpAxis::Y => "Y",
        UpAxis::Z => "Z",
    };
    let root = sdf::Path::abs_root();
    layer.set(&root, "upAxis", Value::Token(up_axis.into()));
    layer.set(&root, "metersPerUnit", Value::Double(stage.meters_per_unit));
    layer.set(
        &root,
        FieldKey::TimeCodesPerSecond,
        Value::Double(stage.time_codes_per_second),
    );
    layer.set(
        &root,
        FieldKey::CustomLayerData,
        Value::Dictionary(provenance.dictionary(&stage.path)),
    );
}

/// Write `layer` under a temporary name beside `path`, then rename it.
fn save(layer: Opinions, path: &Path) -> Result<(), Error> {
    let unwritable = |source: io::Error| Error::Unwritable {
        path: path.to_owned(),
        source,
    };
    let is_text = match path.extension().and_then(|extension| extension.to_str()) {
        Some("usda") => true,
        Some("usdc" | "usd") => false,
        _ => {
            return Err(Error::Extension {
                path: path.to_owned(),
            });
        }
    };
    let mut file = temporary_beside(path).map_err(unwritable)?;
    let written = match is_text {
        true => write_text(&layer.finish(), file.as_file_mut()),
        false => write_crate(layer, file.as_file_mut()),
    };
    written.map_err(|error| match error.downcast::<io::Error>() {
        Ok(source) => unwritable(source),
        Err(error) => Error::Format {
            path: path.to_owned(),
            message: format!("{error:#}"),
        },
    })?;
    file.persist(path)
        .map_err(|error| unwritable(error.error))?;
    Ok(())
}

/// `CrateWriter` writes in small pieces: unbuffered it takes three times as long (5 M points: 2.0 s against 0.6 s).
const BUFFER: usize = 1 << 20;

fn write_text(data: &sdf::Data, file: &mut File) -> anyhow::Result<()> {
    let text = usda::TextWriter::write_to_string(data)?;
    let mut out = BufWriter::with_capacity(BUFFER, file);
    for line in text.lines() {
        // openusd 0.6.0 leaves the brackets of a single schema out, which Pixar's parser does not
        match line.trim_start().strip_prefix("prepend apiSchemas = \"") {
            Some(schema) => writeln!(out, "prepend apiSchemas = [\"{schema}]")?,
            None => writeln!(out, "{line}")?,
        }
    }
    Ok(out.flush()?)
}

fn write_crate(layer: Opinions, file: &mut File) -> anyhow::Result<()> {
    /// Offset of the three version bytes in a crate file's header.
    const VERSION_OFFSET: u64 = 8;
    /// The crate always says 0.12.0, which USD before 24.11 refuses; nothing written here needs more than 0.8.0
    /// (0.9 brought time code values, 0.10 path expressions, 0.11 relocates, 0.12 splines).
    const VERSION: [u8; 3] = [0, 8, 0];
    let (data, arrays) = layer.finish_apart();
    let mut out = BufWriter::with_capacity(BUFFER, &mut *file);
    usdc::CrateWriter::write(&data, &mut out)?;
    out.flush()?;
    drop(out);
    file.seek(SeekFrom::Start(VERSION_OFFSET))?;
    file.write_all(&VERSION)?;
    corrections::correct(file, &arrays)
}
