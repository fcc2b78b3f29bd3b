//! `.usdz` packages: zip archives whose files are stored, not compressed; and paths into them, possibly nested:
//! `a.usdz[b.usdz[c.png]]`.
//!
//! Zip layout: APPNOTE.TXT 6.3, sections 4.3.7 (local header), 4.3.12 (central directory), 4.3.16 (its end).

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::path::{Component, Path, PathBuf};

const END_SIGNATURE: [u8; 4] = *b"PK\x05\x06";
const ENTRY_SIGNATURE: [u8; 4] = *b"PK\x01\x02";
const LOCAL_SIGNATURE: [u8; 4] = *b"PK\x03\x04";
const END_BYTES: usize = 22;
const ENTRY_BYTES: usize = 46;
const LOCAL_BYTES: usize = 30;
/// A comment of at most 65535 bytes follows the end record.
const LONGEST_COMMENT: usize = 65_535;

/// The package and the path inside it, if `path` names something in a package.
pub(crate) fn split(path: &str) -> Option<(&str, &str)> {
    let (package, inner) = path.strip_suffix(']')?.split_once('[')?;
    let is_package = package.to_ascii_lowercase().ends_with(".usdz");
    is_package.then_some((package, inner))
}

/// All bytes of the file at `path`, which may be inside a package.
///
/// # Errors
/// What the system says, and those of [`Package::open`] and [`Package::read`].
pub(crate) fn read(path: &Path) -> io::Result<Vec<u8>> {
    match path.to_str().and_then(split) {
        None => std::fs::read(path),
        Some((package, inner)) => read_inside(&Package::open(Path::new(package))?, inner),
    }
}

fn read_inside(package: &Package, inner: &str) -> io::Result<Vec<u8>> {
    match split(inner) {
        None => package.read(inner),
        Some((outer, inner)) => {
            let nested = Package::of(Home::Memory(package.read(outer)?))?;
            read_inside(&nested, inner)
        }
    }
}

/// True if the file at `path` exists.
pub(crate) fn exists(path: &Path) -> bool {
    match path.to_str().and_then(split) {
        None => path.is_file(),
        Some((package, inner)) => {
            let name = split(inner).map_or(inner, |(outer, _)| outer);
            Package::open(Path::new(package)).is_ok_and(|package| package.has(name))
        }
    }
}

/// The path of the file that `relative` names beside `path`; in a package within it, where that leads to no folder outside.
pub(crate) fn beside(path: &Path, relative: &str) -> PathBuf {
    let folder = |path: &Path| path.parent().unwrap_or(Path::new("")).to_owned();
    let Some((package, inner)) = path.to_str().and_then(split) else {
        return folder(path).join(relative);
    };
    let mut steps: Vec<Component<'_>> = Vec::new();
    let from = folder(Path::new(inner));
    for step in from.components().chain(Path::new(relative).components()) {
        match step {
            Component::CurDir => {}
            Component::ParentDir if !steps.is_empty() => {
                steps.pop();
            }
            step => steps.push(step),
        }
    }
    let inner: PathBuf = steps.into_iter().collect();
    PathBuf::from(format!("{package}[{}]", inner.display()))
}

/// An open package.
#[derive(Debug)]
pub(crate) struct Package {
    home: Home,
    entries: BTreeMap<String, Entry>,
    first_layer: Option<String>,
}

/// Where a package's bytes are.
#[derive(Debug)]
enum Home {
    File(PathBuf),
    Memory(Vec<u8>),
}

impl Home {
    /// The bytes from `start` on.
    fn read(&self, start: u64, count: u64) -> io::Result<Vec<u8>> {
        match self {
            Self::File(path) => read_at(&mut File::open(path)?, start, count),
            Self::Memory(bytes) => read_at(&mut Cursor::new(bytes), start, count),
        }
    }

    fn length(&self) -> io::Result<u64> {
        match self {
            Self::File(path) => Ok(std::fs::metadata(path)?.len()),
            Self::Memory(bytes) => Ok(bytes.len() as u64),
        }
    }
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
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
        Self::of(Home::File(path.to_owned()))
    }

    fn of(home: Home) -> io::Result<Self> {
        let length = home.length()?;
        let tail = length.min((END_BYTES + LONGEST_COMMENT) as u64);
        let bytes = home.read(length - tail, tail)?;
        let end = bytes
            .windows(END_BYTES)
            .rposition(|window| window[..4] == END_SIGNATURE)
            .ok_or_else(|| damaged("no zip directory"))?;
        let end = &bytes[end..];
        let (count, size, start) = (u16_at(end, 10), u32_at(end, 12), u32_at(end, 16));
        let directory = home.read(u64::from(start), u64::from(size))?;
        let (entries, first_layer) = entries(&directory, usize::from(count))?;
        Ok(Self {
            home,
            entries,
            first_layer,
        })
    }

    /// True if the package holds the file `name`.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.entries.contains_key(name)
    }

    /// All file names, sorted.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// The first USD layer: the package's root layer.
    pub(crate) fn first_layer(&self) -> Option<&str> {
        self.first_layer.as_deref()
    }

    /// The bytes of the file `name`.
    ///
    /// # Errors
    /// When there is no such file, it is compressed (USDZ forbids it, and so does Pixar's reader), or it is cut off.
    pub(crate) fn read(&self, name: &str) -> io::Result<Vec<u8>> {
        let entry = self.entries.get(name).ok_or_else(|| {
            let message = format!("no file {name} in the package");
            io::Error::new(io::ErrorKind::NotFound, message)
        })?;
        if entry.method != 0 {
            return Err(damaged(&format!(
                "{name} is compressed, but files in a usdz must be stored"
            )));
        }
        let start = u64::from(entry.header);
        let header = self.home.read(start, LOCAL_BYTES as u64)?;
        if header[..4] != LOCAL_SIGNATURE {
            return Err(damaged(&format!("{name} has no header")));
        }
        let skip =
            LOCAL_BYTES as u64 + u64::from(u16_at(&header, 26)) + u64::from(u16_at(&header, 28));
        self.home.read(start + skip, u64::from(entry.size))
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

/// So many bytes from `start` on; an error where there are fewer.
fn read_at(source: &mut (impl Read + Seek), start: u64, count: u64) -> io::Result<Vec<u8>> {
    let length = source.seek(SeekFrom::End(0))?;
    if start.checked_add(count).is_none_or(|end| end > length) {
        return Err(damaged("the package is cut off"));
    }
    source.seek(SeekFrom::Start(start))?;
    let mut bytes = Vec::new();
    source.take(count).read_to_end(&mut bytes)?;
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
pub(crate) mod tests {
    use super::*;
    use std::io::Write;

    /// A stored zip, written from the format's description.
    pub(crate) fn stored_zip(files: &[(&str, &[u8])]) -> Vec<u8> {
        let (mut body, mut directory) = (Vec::new(), Vec::new());
        for (name, bytes) in files {
            let size = u32::try_from(bytes.len()).unwrap().to_le_bytes();
            let length = u16::try_from(name.len()).unwrap().to_le_bytes();
            let offset = u32::try_from(body.len()).unwrap().to_le_bytes();
            let common = [
                &[20, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0][..],
                &size,
                &size,
                &length,
            ]
            .concat();
            body.extend(
                [
                    &LOCAL_SIGNATURE[..],
                    &common,
                    &[3, 0],
                    name.as_bytes(),
                    &[0; 3],
                    bytes,
                ]
                .concat(),
            );
            let rest = [0; 12];
            directory.extend(
                [
                    &ENTRY_SIGNATURE[..],
                    &[20, 0],
                    &common,
                    &rest,
                    &offset,
                    name.as_bytes(),
                ]
                .concat(),
            );
        }
        let count = u16::try_from(files.len()).unwrap().to_le_bytes();
        let size = u32::try_from(directory.len()).unwrap().to_le_bytes();
        let offset = u32::try_from(body.len()).unwrap().to_le_bytes();
        let end = [
            &END_SIGNATURE[..],
            &[0; 4],
            &count,
            &count,
            &size,
            &offset,
            &[0; 2],
        ]
        .concat();
        [body, directory, end].concat()
    }

    #[test]
    fn files_are_found_in_packages_also_nested_ones() {
        let inner = stored_zip(&[("deep/c.png", b"deep")]);
        let outer = stored_zip(&[
            ("a.usda", b"first"),
            ("0/b.png", b"second"),
            ("n.usdz", &inner),
        ]);
        let folder = tempfile::tempdir().unwrap();
        let package = folder.path().join("p.usdz");
        File::create(&package).unwrap().write_all(&outer).unwrap();
        let inside = |name: &str| read(Path::new(&format!("{}[{name}]", package.display())));
        assert_eq!(inside("0/b.png").unwrap(), b"second");
        assert_eq!(inside("n.usdz[deep/c.png]").unwrap(), b"deep");
        assert_eq!(inside("b.png").unwrap_err().kind(), io::ErrorKind::NotFound);
        assert!(exists(Path::new(&format!("{}[a.usda]", package.display()))));
        assert!(!exists(Path::new(&format!(
            "{}[x.usda]",
            package.display()
        ))));
    }

    #[test]
    fn damaged_packages_are_errors() {
        let good = stored_zip(&[("a.png", b"0123456789")]);
        let read = |bytes: &[u8]| Package::of(Home::Memory(bytes.to_vec()))?.read("a.png");
        for cut in 0..good.len() {
            assert!(read(&good[..cut]).is_err(), "{cut}");
        }
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] = !bad[at];
            let _ = read(&bad);
        }
    }

    #[test]
    fn what_lies_beside_a_file_in_a_package_is_in_it() {
        let of =
            |path: &str, relative: &str| beside(Path::new(path), relative).display().to_string();
        assert_eq!(of("/a/b.mtlx", "c/d.png"), "/a/c/d.png");
        assert_eq!(of("/a/p.usdz[b.mtlx]", "./d.png"), "/a/p.usdz[d.png]");
        assert_eq!(
            of("/a/p.usdz[b/c.mtlx]", "../t/d.png"),
            "/a/p.usdz[t/d.png]"
        );
    }

    fn written(folder: &Path) -> PathBuf {
        let path = folder.join("p.usdz");
        let files: [(&str, &[u8]); 2] =
            [("root.usda", b"#usda 1.0\n"), ("tex/a.png", b"not really")];
        std::fs::write(&path, stored_zip(&files)).unwrap();
        path
    }

    #[test]
    fn files_of_packages_come_back_as_they_were_stored() {
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
