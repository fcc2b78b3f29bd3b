//! Damaged layers, and those that refer to each other in ways that cannot be read.

use crate::{Case, native};
use std::path::Path;
use surflux::diagnostics::Diagnostics;

/// A layer with what crate files encode in different ways: compressed and plain arrays, samples, list ops,
/// dictionaries, strings, variants.
const RICH: &str = r#"#usda 1.0
(defaultPrim = "World" customLayerData = { string tool = "t" dictionary more = { int n = 3 } })
def Xform "World" (kind = "group" prepend apiSchemas = ["MaterialBindingAPI"] variants = { string v = "a" } prepend variantSets = "v"
    inherits = </K> references = </K> payload = </K>) {
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)]
    int[] faceVertexCounts = [3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3]
    float[] widths = [1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3, 1, 2, 3]
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 5: (1, 2, 3) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
    string text = "hello"
    asset file = @./a.png@
    rel to = [</World/C>, </World>]
    def Sphere "C" { double radius = 2 color3f[] primvars:displayColor = [(1, 0, 0)] (interpolation = "constant") }
    variantSet "v" = { "a" { int chosen = 1 } "b" { int chosen = 2 } }
}
class "K" { def "Part" (inherits = </K/Base>) { double d = 1 } class "Base" {} }
"#;

fn binary(text: &str) -> Vec<u8> {
    let data = openusd::usda::parse(text).expect("the text is right");
    let mut bytes = std::io::Cursor::new(Vec::new());
    openusd::usdc::CrateWriter::write(&data, &mut bytes).expect("it can be written");
    bytes.into_inner()
}

/// Read `bytes` as a file called `name`, at two times; whatever is wrong with them must come back as an `Err`.
fn survive(folder: &Path, name: &str, bytes: &[u8]) {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a file");
    for time in [None, Some(2.0)] {
        let _ = native(&Case::new(&path, time), &Diagnostics::default());
    }
}

#[test]
fn truncated_files_are_errors() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let binary = binary(RICH);
    for length in (0..binary.len()).step_by(7) {
        survive(folder.path(), "cut.usdc", &binary[..length]);
    }
    for length in (0..RICH.len()).step_by(7) {
        survive(folder.path(), "cut.usda", &RICH.as_bytes()[..length]);
    }
}

/// Before version 0.4 tables were not compressed; the crate does not read those.
#[test]
fn old_binary_layers_are_refused_with_the_way_out() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("old.usdc");
    let mut bytes = binary(RICH);
    bytes[8..11].copy_from_slice(&[0, 3, 0]);
    std::fs::write(&path, bytes).expect("a file");
    let refused = native(&Case::new(&path, None), &Diagnostics::default());
    let message = refused.expect_err("too old").to_string();
    assert!(
        message.contains("old.usdc") && message.contains("--usd usd-core"),
        "{message}"
    );
}

/// Found by the fuzz run of seed 501, case 22407: the crate composes without end.
#[test]
fn relocates_into_what_their_prim_refers_to_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let text = "#usda 1.0\n( relocates = { </W/A/x>: </W/moved> } )\n\
        def \"W\" { def \"A\" ( references = </W/moved> ) {} }\n";
    let bytes = text.as_bytes().to_vec();
    for (name, bytes) in [("circle.usda", bytes), ("circle.usdc", binary(text))] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a file");
        let refused = native(&Case::new(&path, None), &Diagnostics::default());
        let message = refused.expect_err("it runs in circles").to_string();
        assert!(
            message.contains(name) && message.contains("--usd usd-core"),
            "{message}"
        );
    }
}

/// The crate composes them without end or until the stack overflows; usd-core ignores an arc and warns.
#[test]
fn circles_of_several_kinds_of_arcs_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, format!("#usda 1.0\n{text}")).expect("a file");
        path
    };
    write(
        "moves.usda",
        "( relocates = { </W/A/x>: </W/moved> } )\ndef \"W\" {}\n",
    );
    write(
        "refers.usda",
        "def \"W\" { def \"A\" ( references = @top.usda@</W/moved> ) {} }\n",
    );
    let layers = write(
        "top.usda",
        "( subLayers = [@moves.usda@, @refers.usda@] )\n",
    );
    let classes = write(
        "classes.usda",
        "def \"W\" { def \"c\" ( specializes = </W/b> ) {} def \"b\" { def \"a\" ( references = </W/c/a> ) {} } }\n",
    );
    for path in [layers, classes] {
        let refused = native(&Case::new(&path, None), &Diagnostics::default());
        let message = refused.expect_err("it runs in circles").to_string();
        assert!(
            message.contains("hold itself") && message.contains("--usd usd-core"),
            "{message}"
        );
    }
}

/// Found by the fuzz run of seed 501, case 18425: the crate's stack overflows at the path `/}`.
#[test]
fn prims_with_names_that_usd_does_not_allow_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let text = "#usda 1.0\ndef Xform \"Zqx\" {\n}\n";
    let mut bytes = binary(text);
    let at = bytes.windows(3).position(|name| name == b"Zqx");
    let at = at.expect("short tokens are stored as they are");
    bytes[at..at + 3].copy_from_slice(b"a-}");
    let text = text.replace("Zqx", "a-}").into_bytes();
    for (name, bytes) in [("name.usda", text), ("name.usdc", bytes)] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a file");
        let refused = native(&Case::new(&path, None), &Diagnostics::default());
        let message = refused.expect_err("no name of a prim").to_string();
        assert!(
            message.contains(name) && message.contains("a-}"),
            "{message}"
        );
    }
}

#[test]
fn bit_flips_are_survived() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let binary = binary(RICH);
    for at in (0..binary.len()).step_by(3) {
        for flip in [0x01, 0xff] {
            let mut bytes = binary.clone();
            bytes[at] ^= flip;
            survive(folder.path(), "flipped.usdc", &bytes);
        }
    }
}

#[test]
fn class_arcs_in_circles_are_an_error_that_names_the_layer() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("circle.usda");
    for text in [
        "def \"W\" { def \"a\" (inherits = </W/b>) {} def \"b\" (inherits = </W/a>) {} }",
        "def \"W\" (inherits = </K> references = </K/P>) {}\n\
         class \"K\" { def \"P\" (inherits = </K/B>) {} class \"B\" {} }",
        // found by fuzzing: the crate overflows its stack where an arc leads into the circle
        "def \"I\" (inherits = </J>) {} def \"J\" (inherits = </I>) {} def \"R\" (references = </I>) {}",
        "class \"K\" (specializes = </K>) {} def \"Q\" (specializes = </K> references = </R>) {} def \"R\" {}",
    ] {
        std::fs::write(&path, format!("#usda 1.0\n{text}\n")).expect("a file");
        let result = native(&Case::new(&path, None), &Diagnostics::default());
        let message = result.expect_err("a circle").to_string();
        let named = message.contains("circle.usda") && message.contains("run in circles");
        assert!(named, "{message}");
    }
}

#[test]
fn an_unreadable_referenced_layer_is_an_error_and_a_missing_one_a_warning() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let root = folder.path().join("root.usda");
    let write = |reference: &str| {
        let text = format!("#usda 1.0\ndef \"P\" (references = @./{reference}@</A>) {{}}\n");
        std::fs::write(&root, text).expect("a file");
        let diagnostics = Diagnostics::default();
        let result = native(&Case::new(&root, None), &diagnostics);
        (result, diagnostics.warnings())
    };
    std::fs::write(
        folder.path().join("bad.usda"),
        "#usda 1.0\ndef \"A\" { int a = }\n",
    )
    .expect("a file");
    let message = write("bad.usda").0.expect_err("a parse error").to_string();
    assert!(
        message.contains("bad.usda") && message.contains("--usd usd-core"),
        "{message}"
    );
    let (stage, warnings) = write("gone.usda");
    assert_eq!(stage.expect("the rest is read").prims.len(), 1);
    assert_eq!(warnings[0].kind, "missing-layer");
    assert!(
        warnings[0].message.contains("gone.usda"),
        "{}",
        warnings[0].message
    );
}
