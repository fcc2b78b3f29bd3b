//! A file read through a buffer that survives short jumps: the crate seeks before each of many short reads.

use openusd::ar::Asset;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// Longer reads go past the buffer, straight from the file.
const BUFFER_BYTES: usize = 64 << 10;

/// An open file.
pub(super) struct LargeFile {
    reader: BufReader<File>,
    position: u64,
    size: u64,
}

impl LargeFile {
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        Ok(Self {
            size: file.metadata()?.len(),
            reader: BufReader::with_capacity(BUFFER_BYTES, file),
            position: 0,
        })
    }
}

impl Read for LargeFile {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.reader.read(into)?;
        self.position += count as u64;
        Ok(count)
    }
}

impl Seek for LargeFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let target = match to {
            SeekFrom::Start(target) => Some(target),
            SeekFrom::Current(offset) => self.position.checked_add_signed(offset),
            SeekFrom::End(offset) => self.size.checked_add_signed(offset),
        };
        let target = target.ok_or(io::ErrorKind::InvalidInput)?;
        // both are lengths of files, which fit
        let offset = i64::try_from(i128::from(target) - i128::from(self.position));
        self.reader
            .seek_relative(offset.map_err(io::Error::other)?)?;
        self.position = target;
        Ok(target)
    }
}

impl Asset for LargeFile {
    fn size(&self) -> io::Result<u64> {
        Ok(self.size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jumps_near_and_far_read_what_is_there() {
        let bytes: Vec<u8> = (0..300_000_u32).flat_map(u32::to_le_bytes).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large");
        std::fs::write(&path, &bytes).unwrap();
        let mut file = LargeFile::open(&path).unwrap();
        assert_eq!(file.size().unwrap(), bytes.len() as u64);
        let mut at = 0_u64;
        for (to, count) in [
            (SeekFrom::Start(900_001), 70_000_usize),
            (SeekFrom::Current(-69_990), 3),
            (SeekFrom::Start(5), 11),
            (SeekFrom::Start(20), 100),
            (SeekFrom::End(-8), 8),
        ] {
            at = match to {
                SeekFrom::Start(start) => start,
                SeekFrom::Current(offset) => at.checked_add_signed(offset).unwrap(),
                SeekFrom::End(offset) => (bytes.len() as u64).checked_add_signed(offset).unwrap(),
            };
            assert_eq!(file.seek(to).unwrap(), at);
            let mut read = vec![0; count];
            file.read_exact(&mut read).unwrap();
            let start = usize::try_from(at).unwrap();
            assert_eq!(read, bytes[start..start + count]);
            at += count as u64;
        }
    }
}
