//! Small stages that each hold one feature of composition or of values.

mod arcs;
mod values;

use crate::Case;
use crate::compare::compare;

/// A small stage: its files (the first is the root) and what it is about.
pub(crate) struct Feature {
    name: &'static str,
    pub(crate) files: &'static [(&'static str, &'static str)],
}

/// All of them.
pub(crate) fn features() -> impl Iterator<Item = &'static Feature> {
    arcs::FEATURES.iter().chain(values::FEATURES)
}

#[test]
fn composition_features_read_like_usd_core_reads_them() {
    let mut failed = Vec::new();
    for feature in features() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (name, text) in feature.files {
            std::fs::write(folder.path().join(name), text).expect("a file");
        }
        let root = folder.path().join(feature.files[0].0);
        let cases =
            [None, Some(-1.0), Some(3.0), Some(6.5), Some(12.0)].map(|time| Case::new(&root, time));
        println!("{}:", feature.name);
        let tally = compare(&cases);
        if !tally.different.is_empty() {
            failed.push(format!(
                "{}:\n  {}",
                feature.name,
                tally.different.join("\n  ")
            ));
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}
