//! Packages that refer to themselves: by an absolute path, as nothing else leads out of a package.

use crate::{Case, native};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use surflux::diagnostics::Diagnostics;

/// No more than a wink: what runs in circles is not followed.
const AT_ONCE: Duration = Duration::from_secs(5);

/// A package `name` of the layer `text`, in which `SELF` stands for the package itself.
fn package(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    let text = text.replace("SELF", &path.to_string_lossy());
    let text = format!("#usda 1.0\n(\ndefaultPrim = \"W\"\n{text}");
    let mut writer = openusd::usdz::ArchiveWriter::create(&path).expect("a package");
    writer
        .add_layer("root.usda", text.as_bytes())
        .expect("an entry");
    writer.finish().expect("a package");
    path
}

#[test]
fn references_of_packages_to_themselves_are_cut_with_a_warning() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in [
        (
            "ref.usdz",
            ")\ndef \"W\" {\ndef \"a\" (references = @SELF@</W>) {\n}\n}\n",
        ),
        (
            "payload.usdz",
            ")\ndef \"W\" {\ndef \"a\" (payload = @SELF@) {\n}\n}\n",
        ),
        (
            "inner.usdz",
            ")\ndef \"W\" {\ndef \"a\" (references = @SELF[root.usda]@</W>) {\n}\n}\n",
        ),
        ("sub.usdz", "subLayers = [@SELF@]\n)\ndef \"W\" {\n}\n"),
    ] {
        let (path, start) = (package(folder.path(), name, text), Instant::now());
        let diagnostics = Diagnostics::default();
        let stage = native(&Case::new(&path, None), &diagnostics).expect("a stage");
        assert!(start.elapsed() < AT_ONCE, "{name}");
        assert!(stage.prims.len() < 8, "{name}: {}", stage.prims.len());
        let warnings = diagnostics.warnings();
        let is_told = warnings
            .iter()
            .any(|warning| warning.kind == "composition-cycle");
        assert!(is_told, "{name}: {warnings:?}");
    }
}

#[test]
fn classes_and_relocates_of_packages_that_lead_back_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in [
        (
            "class.usdz",
            ")\ndef \"W\" {\ndef \"c\" (specializes = </W/b>) {\n}\ndef \"b\" {\n\
             def \"a\" (references = @SELF@</W/c/a>) {\n}\n}\n}\n",
        ),
        (
            "above.usdz",
            ")\ndef \"W\" {\ndef \"a\" {\ndef \"b\" (references = @SELF@</D>) {\n}\n}\n}\n\
             def \"D\" (payload = </K>) {\n}\ndef \"K\" (specializes = </W/a>) {\n}\n",
        ),
        (
            "moved.usdz",
            "relocates = { </W/A/x>: </W/moved> }\n)\ndef \"W\" {\n\
             def \"A\" (references = @SELF@</W/moved>) {\n}\n}\n",
        ),
    ] {
        let (path, start) = (package(folder.path(), name, text), Instant::now());
        let outcome = native(&Case::new(&path, None), &Diagnostics::default());
        assert!(start.elapsed() < AT_ONCE, "{name}");
        let message = outcome.expect_err(name).to_string();
        assert!(message.contains("without end"), "{name}: {message}");
        assert!(message.contains("--usd usd-core"), "{name}: {message}");
    }
}
