//! The one place that maps memory: the flat file of arrays that a worker wrote.

use memmap2::Mmap;
use std::fs::File;
use std::io;
use std::path::Path;

/// Map the file at `path` for reading and remove its name: nothing stays behind, however this process ends.
///
/// # Errors
/// When it cannot be opened or mapped (it must not be empty).
pub(super) fn map_and_remove(path: &Path) -> io::Result<Mmap> {
    let file = File::open(path)?;
    let map = map(&file);
    std::fs::remove_file(path)?;
    map
}

#[expect(
    unsafe_code,
    reason = "mapping a file is unsafe by nature: another process could change it"
)]
fn map(file: &File) -> io::Result<Mmap> {
    // SAFETY: the file lies in a folder that only this process and its worker know (created with owner-only access),
    // the worker has finished writing and closed it before it named it, and its name is removed right after: nobody
    // truncates or changes it while it is mapped.
    unsafe { Mmap::map(file) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_what_was_written_and_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("arrays");
        std::fs::write(&path, [1_u8, 2, 3]).unwrap();
        let map = map_and_remove(&path).unwrap();
        assert_eq!(&map[..], &[1, 2, 3]);
        assert!(!path.exists());
    }

    #[test]
    fn a_missing_file_is_an_error() {
        assert!(map_and_remove(Path::new("does/not/exist")).is_err());
    }
}
