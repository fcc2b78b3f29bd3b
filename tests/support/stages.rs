//! Stages in a folder.

use std::fs;
use std::path::{Path, PathBuf};

/// Put every stage in `folder` and below, in the order of their names, behind those in `found`.
pub(crate) fn stages_below(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = fs::read_dir(folder)
        .expect("the folder can be read")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    entries.sort();
    for path in entries {
        let extension = path.extension().and_then(|extension| extension.to_str());
        if path.is_dir() {
            stages_below(&path, found);
        } else if matches!(extension, Some("usd" | "usda" | "usdc" | "usdz")) {
            found.push(path);
        }
    }
}
