//! Bytes of a file, on disk or inside a `.usdz` package (a zip archive whose entries are stored without compression),
//! possibly nested: `a.usdz[b.usdz[c.png]]`.

use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::path::{Component, Path, PathBuf};

/// Size of a zip end record without its comment, bytes; the comment is at most 65535 bytes.
const END_RECORD: usize = 22;
const MAX_COMMENT: u64 = 65_535;
const END_SIGNATURE: [u8; 4] = *b"PK\x05\x06";
const ENTRY_SIGNATURE: [u8; 4] = *b"PK\x01\x02";
const LOCAL_SIGNATURE: [u8; 4] = *b"PK\x03\x04";
const ENTRY_HEADER: usize = 46;
const LOCAL_HEADER: usize = 30;

/// The package and the path inside it, if `path` names something in a package.
pub(crate) fn split(path: &str) -> Option<(&str, &str)> {
    let (package, inner) = path.strip_suffix(']')?.split_once('[')?;
    let is_package = package.to_ascii_lowercase().ends_with(".usdz");
    is_package.then_some((package, inner))
}

/// All bytes of the file at `path`.
pub(crate) fn read(path: &Path) -> io::Result<Vec<u8>> {
    match path.to_str().and_then(split) {
        None => std::fs::read(path),
        Some((package, inner)) => read_inside(&mut File::open(package)?, inner),
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

/// True if the file at `path` exists.
pub(crate) fn exists(path: &Path) -> bool {
    match path.to_str().and_then(split) {
        None => path.is_file(),
        Some((package, inner)) => File::open(package).is_ok_and(|mut package| {
            let name = split(inner).map_or(inner, |(outer, _)| outer);
            find(&mut package, name).is_ok()
        }),
    }
}

fn read_inside(package: &mut (impl Read + Seek), inner: &str) -> io::Result<Vec<u8>> {
    match split(inner) {
        None => read_entry(package, inner),
        Some((outer, inner)) => {
            let nested = read_entry(package, outer)?;
            read_inside(&mut Cursor::new(nested), inner)
        }
    }
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

/// Where an entry's local header is, and how many bytes are stored.
struct Entry {
    offset: u64,
    size: u64,
}

fn read_entry(package: &mut (impl Read + Seek), name: &str) -> io::Result<Vec<u8>> {
    let entry = find(package, name)?;
    package.seek(SeekFrom::Start(entry.offset))?;
    let mut header = [0; LOCAL_HEADER];
    package.read_exact(&mut header)?;
    if header[..4] != LOCAL_SIGNATURE {
        return Err(invalid(format!("package is damaged at `{name}`")));
    }
    let skip = i64::from(u16_at(&header, 26)) + i64::from(u16_at(&header, 28));
    package.seek(SeekFrom::Current(skip))?;
    let mut bytes = Vec::new();
    package.take(entry.size).read_to_end(&mut bytes)?;
    if bytes.len() as u64 == entry.size {
        Ok(bytes)
    } else {
        Err(invalid(format!("package ends within `{name}`")))
    }
}

/// Look `name` up in the central directory.
fn find(package: &mut (impl Read + Seek), name: &str) -> io::Result<Entry> {
    let directory = directory(package)?;
    let mut at = 0;
    while let Some(header) = directory.get(at..at + ENTRY_HEADER) {
        if header[..4] != ENTRY_SIGNATURE {
            break;
        }
        let length = usize::from(u16_at(header, 28));
        let start = at + ENTRY_HEADER;
        if directory.get(start..start + length) == Some(name.as_bytes()) {
            if u16_at(header, 10) != 0 {
                return Err(invalid(format!(
                    "`{name}` is compressed, which usdz does not allow"
                )));
            }
            return Ok(Entry {
                offset: u64::from(u32_at(header, 42)),
                size: u64::from(u32_at(header, 20)),
            });
        }
        at = start + length + usize::from(u16_at(header, 30)) + usize::from(u16_at(header, 32));
    }
    let message = format!("package has no file `{name}`");
    Err(io::Error::new(io::ErrorKind::NotFound, message))
}

/// The central directory, found through the end record at the end of the archive.
fn directory(package: &mut (impl Read + Seek)) -> io::Result<Vec<u8>> {
    let length = package.seek(SeekFrom::End(0))?;
    let tail = length.min(END_RECORD as u64 + MAX_COMMENT);
    package.seek(SeekFrom::Start(length - tail))?;
    let mut bytes = Vec::new();
    package.take(tail).read_to_end(&mut bytes)?;
    let end = (bytes.windows(END_RECORD))
        .rev()
        .find(|record| record[..4] == END_SIGNATURE)
        .ok_or_else(|| invalid("not a usdz package".to_owned()))?;
    let (size, offset) = (u64::from(u32_at(end, 12)), u64::from(u32_at(end, 16)));
    package.seek(SeekFrom::Start(offset))?;
    let mut directory = Vec::new();
    package.take(size).read_to_end(&mut directory)?;
    Ok(directory)
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
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
        for cut in 0..good.len() {
            assert!(
                read_entry(&mut Cursor::new(&good[..cut]), "a.png").is_err(),
                "{cut}"
            );
        }
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] = !bad[at];
            let _ = read_entry(&mut Cursor::new(&bad), "a.png");
        }
    }
}
