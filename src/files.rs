//! Files → their bytes. Large ones are mapped, so that what is not looked at is neither read nor copied.

pub(crate) mod package;

use memmap2::Mmap;
use std::fs::File;
use std::io::{self, Read};
use std::ops::Deref;
use std::path::Path;
use std::sync::Arc;

/// Files longer than this, bytes, are mapped.
const LARGE: u64 = 8 << 20;

/// The content of a file; clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Bytes(Arc<Kept>);

#[derive(Debug)]
enum Kept {
    Read(Vec<u8>),
    Mapped(Mmap),
}

impl Bytes {
    /// The content of the file at `path`. A large file has to keep its length as long as its bytes are in use: the system
    /// ends a program that looks at what is gone. Files of ours are replaced, never shortened.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn of(path: &Path) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let about = file.metadata()?;
        if about.is_file() && about.len() > LARGE {
            return Ok(Self(Arc::new(Kept::Mapped(mapped(&file)?))));
        }
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        Ok(Self(Arc::new(Kept::Read(bytes))))
    }
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &*self.0 {
            Kept::Read(bytes) => bytes,
            Kept::Mapped(bytes) => bytes,
        }
    }
}

impl AsRef<[u8]> for Bytes {
    fn as_ref(&self) -> &[u8] {
        self
    }
}

#[expect(
    unsafe_code,
    reason = "mapping: 10 M points of 400 MB are read in half the time"
)]
fn mapped(file: &File) -> io::Result<Mmap> {
    // SAFETY: the mapping is private and read only; bytes that another program changes meanwhile are bytes still, every
    // pattern of which is a `u8`, and all that reads them checks them as those of any file.
    unsafe { Mmap::map(file) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn mapped_bytes_are_those_of_the_file() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let block: Vec<u8> = (0..=u8::MAX).cycle().take(1 << 20).collect();
        for _ in 0..9 {
            file.write_all(&block).unwrap();
        }
        let bytes = Bytes::of(file.path()).unwrap();
        assert!(matches!(&*bytes.0, Kept::Mapped(_)));
        assert!(*bytes == *std::fs::read(file.path()).unwrap());
        assert!(Bytes::of(Path::new("no such file")).is_err());
    }
}
