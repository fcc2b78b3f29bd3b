//! The flat file of arrays that a worker wrote: read array by array, each given back to the system once it was read, so
//! that arrays are in memory once (the file lies in memory where the system has a place for that).

use bytemuck::Pod;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Arrays below this many bytes stay in the file until it is closed.
const WORTH_FREEING: usize = 1 << 20;

/// An open file without a name: nothing stays behind, however this process ends.
#[derive(Debug)]
pub(super) struct ArrayFile {
    file: File,
    bytes: usize,
    is_read_again: bool,
}

impl ArrayFile {
    /// Open the file at `path` and remove its name. `is_read_again` keeps what was read.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub(super) fn open_and_remove(path: &Path, is_read_again: bool) -> io::Result<Self> {
        let opened = File::open(path).and_then(|file| {
            let bytes = file.metadata()?.len();
            Ok((writable(path).unwrap_or(file), bytes))
        });
        std::fs::remove_file(path)?;
        let (file, bytes) = opened?;
        Ok(Self {
            file,
            bytes: usize::try_from(bytes).map_err(io::Error::other)?,
            is_read_again,
        })
    }

    /// Its size.
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// The `count` values from byte `offset` on; without `is_read_again` they can be read once.
    ///
    /// # Errors
    /// When the file is too short for them, or cannot be read.
    pub(super) fn values<T: Pod>(&self, offset: usize, count: usize) -> Result<Vec<T>, String> {
        let size = count.checked_mul(size_of::<T>());
        let end = size.and_then(|size| offset.checked_add(size));
        if end.is_none_or(|end| end > self.bytes) {
            return Err("an array beyond the end of the worker's file".to_owned());
        }
        let mut values: Vec<T> = bytemuck::zeroed_vec(count);
        let into: &mut [u8] = bytemuck::cast_slice_mut(&mut values);
        let mut file = &self.file;
        file.seek(SeekFrom::Start(offset as u64))
            .and_then(|_| file.read_exact(into))
            .map_err(|error| error.to_string())?;
        if !self.is_read_again && into.len() >= WORTH_FREEING {
            free(&self.file, offset as u64, into.len() as u64);
        }
        Ok(values)
    }
}

/// The file opened so that parts of it can be freed.
fn writable(path: &Path) -> io::Result<File> {
    File::options().read(true).write(true).open(path)
}

/// Give the bytes back to the system; where it cannot take them they stay until the file is closed.
fn free(file: &File, offset: u64, bytes: u64) {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{FallocateFlags, fallocate};
        let flags = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        if let Err(problem) = fallocate(file, flags, offset, bytes) {
            log::debug!("arrays stay in the file: {problem}");
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (file, offset, bytes);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file_of(values: &[u32], is_read_again: bool) -> (tempfile::TempDir, ArrayFile) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("arrays");
        std::fs::write(&path, bytemuck::cast_slice::<_, u8>(values)).unwrap();
        let file = ArrayFile::open_and_remove(&path, is_read_again).unwrap();
        assert!(!path.exists());
        (folder, file)
    }

    #[test]
    fn arrays_come_as_they_were_written_and_only_from_inside_the_file() {
        let (_folder, file) = file_of(&[1, 2, 3, 4], false);
        assert_eq!(file.bytes(), 16);
        assert_eq!(file.values::<u32>(4, 2).unwrap(), [2, 3]);
        assert_eq!(file.values::<u32>(16, 0).unwrap(), [0; 0]);
        for (offset, count) in [(4, 4), (17, 0), (0, usize::MAX), (usize::MAX, 1)] {
            assert!(file.values::<u32>(offset, count).is_err());
        }
    }

    #[test]
    fn large_arrays_are_freed_unless_they_are_read_again() {
        let count = u32::try_from(WORTH_FREEING).unwrap();
        let values: Vec<u32> = (0..count).collect();
        let half = values.len() / 2;
        for is_read_again in [false, true] {
            let (_folder, file) = file_of(&values, is_read_again);
            let first: Vec<u32> = file.values(0, half).unwrap();
            assert_eq!(first, values[..half]);
            let rest: Vec<u32> = file.values(4 * half, half).unwrap();
            assert_eq!(rest, values[half..]);
            if is_read_again {
                assert_eq!(file.values::<u32>(0, half).unwrap(), first);
            }
        }
    }

    #[test]
    fn a_missing_file_is_an_error() {
        assert!(ArrayFile::open_and_remove(Path::new("does/not/exist"), false).is_err());
    }
}
