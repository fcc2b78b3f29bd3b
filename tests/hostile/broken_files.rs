//! Files that are missing, cut off, damaged or refer in circles.

use super::program::{ROOM, json, stage, stderr};
use super::python::run_python;
use super::trial::{DOORS, bake, surflux_by};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// No run may take longer: the stages are small.
const PATIENCE: Duration = Duration::from_secs(60);

/// Memory a run may use, KiB: the native reader reserves 1 GiB of stack that it does not touch.
const MEMORY_KIB: u32 = 6 << 20;

#[test]
fn a_missing_file_is_named() {
    for door in DOORS {
        let output = surflux_by(door, "info").arg("no/such.usda").output();
        let output = output.expect("the program starts");
        assert_eq!(output.status.code(), Some(1));
        assert!(
            stderr(&output).contains("no/such.usda"),
            "{}",
            stderr(&output)
        );
    }
}

#[test]
fn a_missing_texture_is_a_warning_that_names_file_and_material() {
    let text = r#"#usda 1.0
def Mesh "quad" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    point3f[] points = [(0,0,0),(0,0,1),(1,0,1),(1,0,0)]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0,1,2,3]
    uniform token subdivisionScheme = "none"
    texCoord2f[] primvars:st = [(0,0),(0,1),(1,1),(1,0)] (interpolation = "vertex")
    rel material:binding = </m>
}
def Material "m"
{
    token outputs:surface.connect = </m/s.outputs:surface>
    def Shader "s"
    {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </m/t.outputs:rgb>
        token outputs:surface
    }
    def Shader "t"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./lost.png@
        float3 outputs:rgb
    }
}
def DomeLight "sky"
{
}
"#;
    for door in DOORS {
        bake(door, "lost texture", text).warned(&["missing-texture", "/m", "lost.png"]);
    }
}

#[test]
fn references_in_circles_end() {
    let text = r#"#usda 1.0
( defaultPrim = "a" )
def Xform "a" (references = </b>)
{
    def Mesh "m"
    {
        point3f[] points = [(0,0,0),(0,0,1),(1,0,1)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0,1,2]
    }
}
def Xform "b" (references = @./stage.usda@)
{
}
"#;
    for door in DOORS {
        let trial = bake(door, "circle", text);
        let said = stderr(&trial.output).to_lowercase();
        assert!(
            said.contains("cycl") || said.contains("circ"),
            "{door}: {said}"
        );
    }
}

/// The room in the other formats of USD, as Pixar's library writes it, in a folder of its own.
fn formats() -> (tempfile::TempDir, [PathBuf; 3]) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let script = "import sys
from pxr import Usd, UsdUtils
Usd.Stage.Open(sys.argv[1]).Export(sys.argv[2])
assert UsdUtils.CreateNewUsdzPackage(sys.argv[2], sys.argv[3])
Usd.Stage.Open(sys.argv[1]).Export(sys.argv[4])";
    let files = [path("room.usdc"), path("room.usdz"), path("room.usda")];
    let args = [Path::new(ROOM), &files[0], &files[1], &files[2]];
    run_python(script, &args);
    (folder, files)
}

/// `info` on `path` in a bounded memory: it ends in time, with 0 or 1, and without a panic that a user would see.
fn survives(path: &Path, what: &str) -> bool {
    let mut child = Command::new("sh")
        .args(["-c", &format!("ulimit -v {MEMORY_KIB}; exec \"$0\" \"$@\"")])
        .arg(env!("CARGO_BIN_EXE_surflux"))
        .args([
            "bake",
            "--usd",
            "native",
            "--rays",
            "16",
            "--surfels",
            "50",
            "-q",
        ])
        .args(["--aov", "irradiance", "-o"])
        .arg(path.with_extension("out.usda"))
        .arg(path)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let start = Instant::now();
    while child.try_wait().expect("waitable").is_none() {
        if start.elapsed() > PATIENCE {
            child.kill().expect("killed");
            panic!("{what}: no end after {PATIENCE:?}");
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let output = child.wait_with_output().expect("ended");
    let said = stderr(&output);
    let code = output.status.code();
    assert!(matches!(code, Some(0 | 1)), "{what}: {code:?} {said}");
    assert!(!said.contains("panicked"), "{what}: {said}");
    code == Some(0)
}

#[test]
fn files_cut_off_anywhere_are_refused() {
    let (folder, files) = formats();
    for file in files {
        let whole = fs::read(&file).expect("readable");
        let cut = folder
            .path()
            .join("cut")
            .with_extension(file.extension().expect("an extension"));
        for part in 0..24 {
            let length = whole.len() * part / 24;
            fs::write(&cut, &whole[..length]).expect("written");
            let what = format!("{} cut at {length} of {}", cut.display(), whole.len());
            let read = survives(&cut, &what);
            let is_text = file.extension().is_some_and(|kind| kind == "usda");
            assert!(!read || is_text, "{what} was read");
        }
    }
}

#[test]
fn damaged_crate_files_are_read_or_refused() {
    const SEED: u64 = 0x5EED_0001;
    const FILES: u64 = 240;
    let (folder, [crate_file, ..]) = formats();
    let whole = fs::read(&crate_file).expect("readable");
    println!("seed {SEED:#x}, {FILES} files of {} bytes", whole.len());
    let damaged = folder.path().join("damaged.usdc");
    let mut read = 0;
    for file in 0..FILES {
        let mut random = Random(SEED.wrapping_add(file.wrapping_mul(0x9E37_79B9_7F4A_7C15)));
        let mut bytes = whole.clone();
        for _ in 0..1 + file % 8 {
            let place = random.below(bytes.len() as u64 * 8);
            bytes[usize::try_from(place / 8).expect("in memory")] ^= 1 << (place % 8);
        }
        fs::write(&damaged, &bytes).expect("written");
        read += u32::from(survives(
            &damaged,
            &format!("file {file} of seed {SEED:#x}"),
        ));
    }
    println!("{read} of {FILES} were read");
    let info = surflux_by("native", "info")
        .arg(&crate_file)
        .arg("--json")
        .output();
    json(&info.expect("the program starts"));
}

/// Steele, Lea and Flood 2014, `SplitMix64`.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % limit
    }
}

#[test]
fn text_that_is_no_usd_is_refused() {
    for text in [
        "",
        "#usda",
        "#usda 1.0\ndef Mesh \"",
        "PXR-USDC",
        "\u{0}\u{1}",
    ] {
        let (_folder, path) = stage(text);
        for door in DOORS {
            let output = surflux_by(door, "points")
                .arg(&path)
                .args(["-o", "out.usdc"])
                .output();
            let output = output.expect("the program starts");
            assert_eq!(output.status.code(), Some(1), "{text:?} by {door}");
            assert!(
                stderr(&output).contains("stage.usda"),
                "{}",
                stderr(&output)
            );
        }
    }
}
