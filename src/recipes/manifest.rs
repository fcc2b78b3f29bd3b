//! What earlier runs did: commands, and what the files they read and wrote held. A task whose files are still the same is
//! up to date.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;
use twox_hash::XxHash3_128;

/// All tasks that were ever finished, by their command.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Manifest {
    surflux: String,
    tasks: BTreeMap<String, Finished>,
}

/// A task that is done.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Finished {
    /// Files it read.
    pub(super) inputs: BTreeMap<PathBuf, Print>,
    /// Files it wrote.
    pub(super) outputs: BTreeMap<PathBuf, Print>,
    /// Bytes, if it told.
    pub(super) peak_memory: Option<u64>,
}

/// What tells one state of a file from another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Print {
    bytes: u64,
    /// Nanoseconds since 1970; only to save hashing.
    modified: u64,
    /// XXH3, 128 bits.
    hash: String,
}

impl Print {
    /// Of the file at `path` as it is now.
    pub(super) fn of(path: &Path) -> io::Result<Self> {
        let (bytes, modified) = about(path)?;
        let mut file = File::open(path)?;
        let mut hasher = XxHash3_128::new();
        let mut buffer = vec![0; 1 << 20];
        loop {
            let count = file.read(&mut buffer)?;
            if count == 0 {
                break;
            }
            hasher.write(&buffer[..count]);
        }
        let hash = format!("{:032x}", hasher.finish_128());
        Ok(Self {
            bytes,
            modified,
            hash,
        })
    }

    /// True if the file at `path` holds what it held then; if it was not touched it is not read.
    fn still_fits(&self, path: &Path) -> bool {
        match about(path) {
            Ok((bytes, modified)) if bytes == self.bytes => {
                modified == self.modified || Self::of(path).is_ok_and(|now| now.hash == self.hash)
            }
            _ => false,
        }
    }
}

fn about(path: &Path) -> io::Result<(u64, u64)> {
    let about = std::fs::metadata(path)?;
    let modified = about.modified()?.duration_since(UNIX_EPOCH);
    let modified = modified.map_or(0, |since| since.as_nanos());
    Ok((about.len(), u64::try_from(modified).unwrap_or(0)))
}

impl Manifest {
    /// What is at `path`; nothing if there is no manifest, or another version wrote it.
    pub(super) fn read(path: &Path) -> Self {
        let text = std::fs::read_to_string(path).unwrap_or_default();
        let found: Self = serde_json::from_str(&text).unwrap_or_default();
        if found.surflux == env!("CARGO_PKG_VERSION") {
            found
        } else {
            Self {
                surflux: env!("CARGO_PKG_VERSION").to_owned(),
                tasks: BTreeMap::new(),
            }
        }
    }

    /// Replace the one at `path`.
    pub(super) fn write(&self, path: &Path) -> io::Result<()> {
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder)?;
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        serde_json::to_writer_pretty(&mut file, self)?;
        file.write_all(b"\n")?;
        file.persist(path)?;
        Ok(())
    }

    /// How `command` went when it last did.
    pub(super) fn finished(&self, command: &[String]) -> Option<&Finished> {
        self.tasks.get(&key(command))
    }

    /// `command` is done.
    pub(super) fn add(&mut self, command: &[String], finished: Finished) {
        self.tasks.insert(key(command), finished);
    }
}

impl Finished {
    /// True if all files it read and wrote are as they were.
    pub(super) fn is_up_to_date(&self) -> bool {
        let files = self.inputs.iter().chain(&self.outputs);
        !self.outputs.is_empty()
            && files
                .into_iter()
                .all(|(path, print)| print.still_fits(path))
    }

    /// True if what it wrote is there.
    pub(super) fn is_there(&self) -> bool {
        !self.outputs.is_empty() && self.outputs.keys().all(|path| path.is_file())
    }
}

/// A command as one line that cannot be mistaken for another's.
fn key(command: &[String]) -> String {
    serde_json::to_string(command).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_counts_not_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, "one").unwrap();
        let print = Print::of(&path).unwrap();
        assert!(print.still_fits(&path));
        std::thread::sleep(std::time::Duration::from_millis(20));
        std::fs::write(&path, "one").unwrap();
        assert!(print.still_fits(&path), "touched only");
        std::thread::sleep(std::time::Duration::from_millis(20));
        std::fs::write(&path, "two").unwrap();
        assert!(!print.still_fits(&path));
        std::fs::remove_file(&path).unwrap();
        assert!(!print.still_fits(&path));
    }

    #[test]
    fn manifests_survive_the_disk_and_garbage_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sub/m.json");
        let command = ["bake".to_owned(), "a b".to_owned()];
        let mut manifest = Manifest::read(&path);
        assert!(manifest.finished(&command).is_none());
        let done = Finished {
            peak_memory: Some(7),
            ..Finished::default()
        };
        manifest.add(&command, done);
        manifest.write(&path).unwrap();
        let again = Manifest::read(&path);
        assert_eq!(again.finished(&command).unwrap().peak_memory, Some(7));
        std::fs::write(&path, "{").unwrap();
        assert!(Manifest::read(&path).finished(&command).is_none());
    }
}
