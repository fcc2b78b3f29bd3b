//! The entries of a `.usdz` package: a zip archive whose files are stored, not compressed.
//!
//! Zip layout: APPNOTE.TXT 6.3, sections 4.3.7 (local header), 4.3.12 (central directory), 4.3.16 (its end).

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

const END_SIGNATURE: [u8; 4] = *b"PK\x05\x06";
const ENTRY_SIGNATURE: [u8; 4] = *b"PK\x01\x02";
const LOCAL_SIGNATURE: [u8; 4] = *b"PK\x03\x04";
const END_BYTES: usize = 22;
const ENTRY_BYTES: usize = 46;
const LOCAL_BYTES: usize = 30;
/// A comment of at most 65535 bytes follows the end record.
const LONGEST_COMMENT: usize = 65_535;

/// An open package.
#[derive(Debug)]
pub(super) struct Package {
    path: std::path::PathBuf,
    entries: BTreeMap<String, Entry>,
    first_layer: Option<String>,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    method: u16,
    size: u32,
    header: u32,
}

impl Package {
    /// Read the directory of the package at `path`.
    ///
    /// # Errors
    /// When it cannot be read or is not a zip archive.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        let tail = (length).min((END_BYTES + LONGEST_COMMENT) as u64);
        let bytes = read_at(&mut file, length - tail, tail, length)?;
        let end = bytes
            .windows(END_BYTES)
            .rposition(|window| window[..4] == END_SIGNATURE)
            .ok_or_else(|| damaged("no zip directory"))?;
        let end = &bytes[end..];
        let (count, size, start) = (u16_at(end, 10), u32_at(end, 12), u32_at(end, 16));
        let directory = read_at(&mut file, u64::from(start), u64::from(size), length)?;
        let (entries, first_layer) = entries(&directory, usize::from(count))?;
        Ok(Self {
            path: path.to_owned(),
            entries,
            first_layer,
        })
    }

    /// True if the package holds the file `name`.
    pub(super) fn has(&self, name: &str) -> bool {
        self.entries.contains_key(name)
    }

    /// All file names, sorted.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// The first USD layer: the package's root layer.
    pub(super) fn first_layer(&self) -> Option<&str> {
        self.first_layer.as_deref()
    }

    /// The bytes of the file `name`.
    ///
    /// # Errors
    /// When there is no such file, it is compressed (USDZ forbids it, and so does Pixar's reader), or it is cut off.
    pub(super) fn read(&self, name: &str) -> io::Result<Vec<u8>> {
        let entry = self
            .entries
            .get(name)
            .ok_or_else(|| damaged(&format!("no file {name} in the package")))?;
        if entry.method != 0 {
            return Err(damaged(&format!(
                "{name} is compressed, but files in a usdz must be stored"
            )));
        }
        let mut file = File::open(&self.path)?;
        let length = file.metadata()?.len();
        let start = u64::from(entry.header);
        let header = read_at(&mut file, start, LOCAL_BYTES as u64, length)?;
        if header[..4] != LOCAL_SIGNATURE {
            return Err(damaged(&format!("{name} has no header")));
        }
        let skip =
            LOCAL_BYTES as u64 + u64::from(u16_at(&header, 26)) + u64::from(u16_at(&header, 28));
        read_at(&mut file, start + skip, u64::from(entry.size), length)
    }
}

fn entries(
    directory: &[u8],
    count: usize,
) -> io::Result<(BTreeMap<String, Entry>, Option<String>)> {
    let mut entries = BTreeMap::new();
    let mut first_layer = None;
    let mut rest = directory;
    for _ in 0..count {
        if rest.len() < ENTRY_BYTES || rest[..4] != ENTRY_SIGNATURE {
            return Err(damaged("the zip directory is cut off"));
        }
        let name_length = usize::from(u16_at(rest, 28));
        let more = usize::from(u16_at(rest, 30)) + usize::from(u16_at(rest, 32));
        let name = rest
            .get(ENTRY_BYTES..ENTRY_BYTES + name_length)
            .and_then(|name| std::str::from_utf8(name).ok())
            .ok_or_else(|| damaged("the zip directory has a bad file name"))?;
        if first_layer.is_none()
            && [".usd", ".usda", ".usdc"]
                .iter()
                .any(|end| name.ends_with(end))
        {
            first_layer = Some(name.to_owned());
        }
        let entry = Entry {
            method: u16_at(rest, 10),
            size: u32_at(rest, 24),
            header: u32_at(rest, 42),
        };
        entries.insert(name.to_owned(), entry);
        rest = rest
            .get(ENTRY_BYTES + name_length + more..)
            .unwrap_or_default();
    }
    Ok((entries, first_layer))
}

fn read_at(file: &mut File, start: u64, count: u64, length: u64) -> io::Result<Vec<u8>> {
    if start.checked_add(count).is_none_or(|end| end > length) {
        return Err(damaged("the package is cut off"));
    }
    file.seek(SeekFrom::Start(start))?;
    let mut bytes = Vec::new();
    file.take(count).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn damaged(message: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A package written by the crate's own archive writer.
    fn written(folder: &Path) -> std::path::PathBuf {
        let path = folder.join("p.usdz");
        let mut writer = openusd::usdz::ArchiveWriter::create(&path).unwrap();
        writer.add_layer("root.usda", b"#usda 1.0\n").unwrap();
        writer.add_layer("tex/a.png", b"not really").unwrap();
        writer.finish().unwrap();
        path
    }

    #[test]
    fn entries_come_back_as_the_archive_writer_stored_them() {
        let folder = tempfile::tempdir().unwrap();
        let package = Package::open(&written(folder.path())).unwrap();
        assert_eq!(package.first_layer(), Some("root.usda"));
        assert_eq!(package.read("tex/a.png").unwrap(), b"not really");
        assert!(package.has("root.usda") && !package.has("other"));
    }

    #[test]
    fn every_truncation_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let bytes = std::fs::read(written(folder.path())).unwrap();
        let cut = folder.path().join("cut.usdz");
        for length in 0..bytes.len() {
            std::fs::write(&cut, &bytes[..length]).unwrap();
            assert!(
                Package::open(&cut).is_err(),
                "{length} bytes of {}",
                bytes.len()
            );
        }
    }
}
