//! A job reads what it needs and nothing else: files by what the system saw opened, values by the statistics.

use crate::program::{json, run};
use crate::python::{python, run_python};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const DOORS: [&str; 2] = ["native", "usd-core"];

/// Runs the program after the folder in `sys.argv`, and prints the names in the folder that anything opened
/// meanwhile.
const WATCH: &str = r#"
import ctypes, json, os, struct, subprocess, sys
IN_OPEN, IN_NONBLOCK, IN_ISDIR = 0x20, 0o4000, 0x40000000
libc = ctypes.CDLL(None, use_errno=True)
watch = libc.inotify_init1(IN_NONBLOCK)
assert watch >= 0 and libc.inotify_add_watch(watch, sys.argv[1].encode(), IN_OPEN) >= 0
done = subprocess.run(sys.argv[2:], capture_output=True, text=True)
assert done.returncode == 0, done.stderr
opened = set()
while True:
    try:
        events = os.read(watch, 1 << 20)
    except BlockingIOError:
        break
    while events:
        _, mask, _, length = struct.unpack("iIII", events[:16])
        if not mask & IN_ISDIR:
            opened.add(events[16:16 + length].rstrip(b"\0").decode())
        events = events[16 + length:]
print(json.dumps(sorted(opened)))
"#;

const QUAD: &str = r#"
    def Mesh "quad"
    {
        point3f[] points = [(0,0,0),(0,0,1),(1,0,1),(1,0,0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0,1,2,3]
        uniform token subdivisionScheme = "none"
        texCoord2f[] primvars:st = [(0,0),(0,1),(1,1),(1,0)] (interpolation = "vertex")
    }
"#;

/// A shot of two props in files of their own, a textured material, and a sky with an image.
fn shot() -> TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["a", "b"] {
        let text = format!("#usda 1.0\n( defaultPrim = \"p\" )\ndef Xform \"p\"\n{{{QUAD}}}\n");
        fs::write(folder.path().join(format!("{name}.usda")), text).expect("written");
    }
    let text = r#"#usda 1.0
( defaultPrim = "shot"
  startTimeCode = 1
  endTimeCode = 3 )
def Xform "shot"
{
    def "a" ( payload = @./a.usda@ )
    {
        double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (0, 2, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
        over "quad" (prepend apiSchemas = ["MaterialBindingAPI"])
        {
            rel material:binding = </shot/m>
        }
    }
    def "b" ( references = @./b.usda@ )
    {
        over "quad" (prepend apiSchemas = ["MaterialBindingAPI"])
        {
            rel material:binding = </shot/m>
        }
    }
    def Material "m"
    {
        token outputs:surface.connect = </shot/m/s.outputs:surface>
        def Shader "s"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </shot/m/t.outputs:rgb>
            token outputs:surface
        }
        def Shader "t"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./color.png@
            float3 outputs:rgb
        }
    }
}
def DomeLight "sky"
{
    asset inputs:texture:file = @./sky.png@
}
"#;
    fs::write(folder.path().join("shot.usda"), text).expect("written");
    let images = "import sys, numpy, OpenImageIO as oiio
for name, width in (('color', 4), ('sky', 8)):
    image = oiio.ImageBuf(oiio.ImageSpec(width, 4, 3, 'uint8'))
    oiio.ImageBufAlgo.fill(image, (0.5, 0.5, 0.5))
    assert image.write('%s/%s.png' % (sys.argv[1], name))";
    run_python(images, &[folder.path()]);
    folder
}

/// Names in `folder` that a run of the program with `args` opens.
fn opened(folder: &Path, door: &str, args: &[&str]) -> Vec<String> {
    let program = env!("CARGO_BIN_EXE_surflux");
    let folder = folder.to_string_lossy();
    let python = format!("SURFLUX_USD_PYTHON={}", python().display());
    let start = [&folder, "env", &python, program];
    let names = run_python(WATCH, &[&start[..], args, &["--usd", door]].concat());
    serde_json::from_str(&names).expect("names")
}

fn bake<'a>(stage: &'a str, output: &'a str, aov: &'a str) -> Vec<&'a str> {
    vec![
        "bake",
        stage,
        "-o",
        output,
        "--aov",
        aov,
        "--rays",
        "16",
        "--surfels",
        "100",
        "-q",
    ]
}

#[test]
fn an_occlusion_bake_opens_no_image_and_a_mask_opens_no_layer_besides() {
    let folder = shot();
    let stage = folder
        .path()
        .join("shot.usda")
        .to_string_lossy()
        .into_owned();
    let elsewhere = tempfile::tempdir().expect("a folder");
    let output = elsewhere
        .path()
        .join("o.usda")
        .to_string_lossy()
        .into_owned();
    for door in DOORS {
        let light = opened(folder.path(), door, &bake(&stage, &output, "irradiance"));
        assert_eq!(
            light,
            ["a.usda", "b.usda", "color.png", "shot.usda", "sky.png"],
            "{door}"
        );
        let occlusion = opened(folder.path(), door, &bake(&stage, &output, "occlusion"));
        assert_eq!(occlusion, ["a.usda", "b.usda", "shot.usda"], "{door}");
        let mut masked = bake(&stage, &output, "occlusion");
        masked.extend(["--mask", "/shot/b"]);
        let masked = opened(folder.path(), door, &masked);
        assert_eq!(masked, ["b.usda", "shot.usda"], "{door}");
    }
}

#[test]
fn statistics_count_what_was_read_and_info_says_it_before() {
    let folder = shot();
    let stage = folder
        .path()
        .join("shot.usda")
        .to_string_lossy()
        .into_owned();
    let output = folder.path().join("o.usda").to_string_lossy().into_owned();
    let ask = |door: &str, args: &[&str]| {
        let mut program = crate::program::surflux();
        program.env("SURFLUX_USD_PYTHON", python());
        program.args(args).args(["--usd", door, "--json"]);
        json(&program.output().expect("the program starts"))
    };
    for door in DOORS {
        for (aov, textures) in [("occlusion", 0), ("irradiance", 2)] {
            let told = ask(door, &["info", &stage, "--for", "bake", "--aov", aov]);
            let done = ask(door, &bake(&stage, &output, aov));
            let (job, read) = (&told["job"], &done["read"]);
            assert_eq!(read["layers"], 3, "{door} {aov}: {read}");
            assert_eq!(read["textures"], textures, "{door} {aov}: {read}");
            assert_eq!(job["layers"].as_array().map(Vec::len), Some(3));
            assert_eq!(job["textures"].as_array().map(Vec::len), Some(textures));
            for key in ["attributes", "bytes", "texture_bytes"] {
                assert_eq!(job[key], read[key], "{door} {aov} {key}");
            }
            assert_eq!(job["lights"], textures > 0);
            assert_eq!(told["lights"].as_array().map(Vec::len), Some(textures / 2));
        }
    }
}

#[test]
fn frames_read_again_only_what_moves_and_bake_the_same_values() {
    let folder = shot();
    let stage = folder
        .path()
        .join("shot.usda")
        .to_string_lossy()
        .into_owned();
    let read = |door: &str, frames: &str| {
        let output = folder.path().join("o.usda").to_string_lossy().into_owned();
        let mut program = crate::program::surflux();
        program.env("SURFLUX_USD_PYTHON", python());
        program.args(bake(&stage, &output, "occlusion"));
        program.args(["--usd", door, "--frames", frames, "--json"]);
        let report = json(&program.output().expect("the program starts"));
        let count = report["read"]["attributes"].as_u64().expect("a number");
        (count, fs::read_to_string(&output).expect("a layer"))
    };
    let (one, _) = read("usd-core", "1");
    let (three, moved) = read("usd-core", "1:3");
    // the translation of /shot/a is all that varies
    assert_eq!(three, one + 2);
    let (one, _) = read("native", "1");
    let (three, native) = read("native", "1:3");
    assert_eq!(three, one + 2);
    let values = |layer: &str| {
        let lines = layer
            .lines()
            .filter(|line| line.trim_start().starts_with(['1', '2', '3']));
        lines.map(str::to_owned).collect::<Vec<_>>()
    };
    assert!(!values(&moved).is_empty(), "{moved}");
    assert_eq!(values(&moved), values(&native));
}

#[test]
fn info_keeps_to_its_schema_and_names_what_is_broken() {
    let folder = shot();
    let stage = folder
        .path()
        .join("shot.usda")
        .to_string_lossy()
        .into_owned();
    fs::remove_file(folder.path().join("color.png")).expect("removed");
    fs::remove_file(folder.path().join("b.usda")).expect("removed");
    let schema = concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/info.schema.json");
    let validate = "import json, jsonschema, sys
schema = json.load(open(sys.argv[1]))
jsonschema.Draft202012Validator.check_schema(schema)
jsonschema.validate(json.loads(sys.argv[2]), schema)";
    for args in [&[][..], &["--for", "bake", "--aov", "occlusion"]] {
        let mut program = crate::program::surflux();
        program.env("SURFLUX_USD_PYTHON", python());
        program
            .args(["info", &stage, "--usd", "usd-core", "--json"])
            .args(args);
        let output = program.output().expect("the program starts");
        let info = json(&output);
        run_python(
            validate,
            &[schema, &String::from_utf8_lossy(&output.stdout)],
        );
        let broken = info["broken_references"].as_array().expect("a list");
        assert_eq!(broken.len(), 1, "{info}");
        assert_eq!(broken[0]["prim"], "/shot/b");
        assert!(broken[0]["message"].to_string().contains("b.usda"));
        let odd = info["suspicions"].as_array().expect("a list");
        assert!(
            odd.iter()
                .any(|odd| odd["message"].to_string().contains("metersPerUnit"))
        );
        assert_eq!(info["animation"]["transforms"], 1);
        if args.is_empty() {
            let textures = info["textures"].as_array().expect("a list");
            assert_eq!(textures.len(), 2);
            // What USD does not find it leaves as it is written.
            let of = |name: &str| {
                let is = |texture: &&serde_json::Value| {
                    (texture["file"].as_str()).is_some_and(|file| file.ends_with(name))
                };
                textures.iter().find(is).expect("listed")
            };
            let lost = of("color.png")["problem"].to_string();
            assert!(lost.contains("color.png"), "{lost}");
            let sky = of("sky.png");
            assert_eq!((&sky["width"], &sky["height"]), (&8.into(), &4.into()));
        }
    }
    let room = json(&run(&[
        "info",
        crate::program::ROOM,
        "--usd",
        "native",
        "--json",
    ]));
    run_python(validate, &[schema, &room.to_string()]);
}

#[test]
fn odd_units_and_intensities_are_told() {
    let text = r#"#usda 1.0
( metersPerUnit = 1000
  upAxis = "Y" )
def Mesh "big"
{
    point3f[] points = [(0,0,0),(0,0,1000),(1000,0,0)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0,1,2]
}
def DistantLight "sun"
{
    float inputs:intensity = 1
}
def DistantLight "right"
{
}
def DomeLight "bright"
{
    float inputs:intensity = 50000
}
def SphereLight "off"
{
    float inputs:intensity = 0
}
"#;
    let (_folder, path) = crate::program::stage(text);
    let info = json(&run(&[
        "info",
        &path.to_string_lossy(),
        "--usd",
        "native",
        "--json",
    ]));
    let odd = info["suspicions"].as_array().expect("a list");
    let prims: Vec<&str> = odd.iter().filter_map(|odd| odd["prim"].as_str()).collect();
    assert_eq!(prims, ["/", "/sun", "/bright", "/off"], "{odd:?}");
}
