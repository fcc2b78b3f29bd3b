//! Many layers: they are opened many at a time, and no others than one at a time.

use crate::compare::compare;
use crate::{Case, native};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use surflux::diagnostics::Diagnostics;

/// More than the reader opens one by one.
const COUNT: usize = 150;

/// Parts that bring in layers of their own, in groups, as payloads, behind variants, as instances; and parts that are
/// not there: inactive, not defined, missing.
fn write_shot(folder: &Path) -> PathBuf {
    let mut shot = "#usda 1.0\n".to_owned();
    for i in 0..COUNT {
        let leaf = format!("#usda 1.0\ndef \"L\" {{\nint number = {i}\n}}\n");
        fs::write(folder.join(format!("leaf{i}.usda")), leaf).expect("a file");
        let part = format!(
            "#usda 1.0\ndef \"P\" (variants = {{\nstring v = \"a\"\n}}\nprepend variantSets = \"v\") {{\n\
             def \"below\" (references = @./leaf{i}.usda@</L>) {{}}\n\
             variantSet \"v\" = {{\n\"a\" {{\nover \"below\" {{\nint chosen = {i}\n}}\n}}\n\
             \"b\" (references = @./unused.usda@</L>) {{\n}}\n}}\n}}\n"
        );
        fs::write(folder.join(format!("part{i}.usda")), part).expect("a file");
        let arc = if i % 3 == 0 { "payload" } else { "references" };
        let head = match i % 5 {
            0 => "instanceable = true",
            1 => "kind = \"component\"",
            _ => "",
        };
        let asset = if i == 77 { 1000 } else { i };
        writeln!(
            shot,
            "def \"G{i}\" {{\ndef \"one\" ({head}\n{arc} = @./part{asset}.usda@</P>) {{}}\n}}"
        )
        .expect("text");
    }
    shot += "def \"off\" (active = false) {\ndef \"x\" (references = @./unused.usda@</L>) {}\n}\n\
             over \"undefined\" {\ndef \"x\" (references = @./unused.usda@</L>) {}\n}\n";
    fs::write(folder.join("unused.usda"), "#usda 1.0\ndef \"L\" {}\n").expect("a file");
    let path = folder.join("shot.usda");
    fs::write(&path, shot).expect("a file");
    path
}

#[test]
fn many_layers_read_like_usd_core_reads_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = write_shot(folder.path());
    let masked = Case {
        mask: (10..120).map(|i| format!("/G{i}")).collect(),
        ..Case::new(&path, None)
    };
    let tally = compare(&[Case::new(&path, None), masked]);
    assert!(tally.different.is_empty(), "{}", tally.different.join("\n"));
}

#[test]
fn layers_of_prims_that_are_not_there_are_not_opened_ahead_either() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = write_shot(folder.path());
    let diagnostics = Diagnostics::default();
    let all = native(&Case::new(&path, None), &diagnostics).expect("it is read");
    // the root, and of each part but the one that is missing its own layer and its leaf
    assert_eq!(all.meta.layers.len(), 1 + 2 * (COUNT - 1));
    let missing = diagnostics.warnings();
    let told: Vec<&str> = missing.iter().map(|warning| &*warning.prim).collect();
    assert_eq!(told, ["/G77/one"]);
    let masked = Case {
        mask: (0..100).map(|i| format!("/G{i}")).collect(),
        ..Case::new(&path, None)
    };
    let some = native(&masked, &Diagnostics::default()).expect("it is read");
    assert_eq!(some.meta.layers.len(), 1 + 2 * 99);
}

/// Makes binary layers in the folder `sys.argv[1]`: b.usdc, and a.usdc that refers to its default prim.
const EXPORT: &str = r##"
import sys
from pxr import Sdf

def export(name, text):
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString("#usda 1.0\n" + text)
    layer.Export(sys.argv[1] + "/" + name)

export("b.usdc", '(\ndefaultPrim = "B"\n)\ndef Xform "B" {\nint n = 3\ndef Cube "c" {\n}\n}\n')
export("a.usdc", 'def "A" {\ndef "r" (references = @./b.usdc@) {\n}\ndef "p" (payload = @./b.usdc@</B/c>) {\n}\n}\n')
"##;

/// USD counts the path that such a reference has not, and does not write it.
#[test]
fn binary_layers_refer_to_default_prims() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    crate::python::run_python(EXPORT, &[folder.path()]);
    let path = folder.path().join("a.usdc");
    let tally = compare(&[Case::new(&path, None)]);
    assert!(tally.different.is_empty(), "{}", tally.different.join("\n"));
    let stage = native(&Case::new(&path, None), &Diagnostics::default()).expect("a stage");
    assert!(stage.find("/A/r/c").is_some());
}
