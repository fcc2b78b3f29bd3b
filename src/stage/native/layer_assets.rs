//! Layers as the crate reads them: from memory, or from their files.

use openusd::ar::Asset;
use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::sync::Arc;

/// A file's bytes, shared.
#[derive(Clone)]
pub(super) struct Bytes(Arc<Vec<u8>>);

impl AsRef<[u8]> for Bytes {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// Where the crate gets the content of a layer.
#[derive(Clone)]
pub(super) enum Content {
    /// Held in memory.
    Small(Bytes),
    /// Sound, and to be read from its file.
    Large,
}

/// Bytes in memory as the crate reads them.
struct LayerAsset(Cursor<Bytes>);

impl Read for LayerAsset {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.0.read(into)
    }
}

impl Seek for LayerAsset {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

impl Asset for LayerAsset {
    fn size(&self) -> io::Result<u64> {
        Ok(self.0.get_ref().0.len() as u64)
    }
}

/// A file as the crate reads it.
struct LayerFile(File);

impl Read for LayerFile {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.0.read(into)
    }
}

impl Seek for LayerFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

impl Asset for LayerFile {
    fn size(&self) -> io::Result<u64> {
        Ok(self.0.metadata()?.len())
    }
}

impl Content {
    /// These bytes.
    pub(super) fn of(bytes: Vec<u8>) -> Self {
        Self::Small(Bytes(Arc::new(bytes)))
    }

    /// The layer at `path`, from its start.
    pub(super) fn asset(&self, path: &str) -> io::Result<Box<dyn Asset>> {
        Ok(match self {
            Self::Small(bytes) => Box::new(LayerAsset(Cursor::new(bytes.clone()))),
            Self::Large => Box::new(LayerFile(File::open(path)?)),
        })
    }
}
