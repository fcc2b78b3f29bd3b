//! `surflux view`: pictures against rendered ones, pages in a browser against what usd-core reads.

#[allow(dead_code, reason = "every test file uses some of the helpers")]
#[path = "support/program.rs"]
mod program;
#[path = "support/python.rs"]
mod python;

use program::{ROOM, files, json, run, stderr};
use serde_json::Value as Json;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A cloud of the example, with usd-core not needed.
fn cloud(folder: &Path, surfels: &str) -> PathBuf {
    let path = folder.join("cloud.usdc");
    let args = [
        "points",
        ROOM,
        "--usd",
        "native",
        "--surfels",
        surfels,
        "-q",
        "-o",
    ];
    let output = program::surflux()
        .args(args)
        .arg(&path)
        .output()
        .expect("it starts");
    assert!(output.status.success(), "{}", stderr(&output));
    path
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn bake(folder: &Path) -> PathBuf {
    let path = folder.join("bake.usdc");
    let args = [
        "bake",
        ROOM,
        "--usd",
        "native",
        "--rays",
        "32",
        "--surfels",
        "4000",
        "-q",
        "--aov",
        "irradiance,irradiance_indirect,occlusion",
        "-o",
    ];
    let output = program::surflux()
        .args(args)
        .arg(&path)
        .output()
        .expect("it starts");
    assert!(output.status.success(), "{}", stderr(&output));
    folder.join("bake_baked.usda")
}

fn picture(path: &Path) -> image::RgbImage {
    image::open(path).expect("a PNG").to_rgb8()
}

/// What Chromium prints once `page` has loaded, which is when it is drawn; nothing where there is no Chromium.
#[expect(clippy::print_stderr, reason = "a skipped test says so")]
fn browse(page: &Path, fragment: &str, more: &[String]) -> Option<String> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let url = format!("file://{}#{fragment}", page.display());
    for name in names {
        let output = Command::new(name)
            .args([
                "--headless=new",
                "--no-sandbox",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--hide-scrollbars",
                "--window-size=800,600",
            ])
            .args(more)
            .arg(&url)
            .output();
        match output {
            Ok(output) => return Some(String::from_utf8_lossy(&output.stdout).into_owned()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => panic!("{name}: {error}"),
        }
    }
    eprintln!("skipped: there is no Chromium");
    None
}

#[test]
fn normals_of_a_bake_are_seen_where_a_render_sees_them() {
    let folder = tempfile::tempdir().unwrap();
    let stage = bake(folder.path());
    let shown = folder.path().join("shown.png");
    let args = [
        "view",
        text(&stage),
        "-o",
        text(&shown),
        "--aov",
        "N",
        "--camera",
        "cam",
        "-w",
        "256",
        "--usd",
        "native",
    ];
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
    let exr = folder.path().join("n.exr");
    let args = [
        "render",
        ROOM,
        "-o",
        text(&exr),
        "--aov",
        "N",
        "--camera",
        "cam",
        "--image-width",
        "256",
        "--usd",
        "native",
        "--preview",
        "-q",
    ];
    let result = run(&args);
    assert!(result.status.success(), "{}", stderr(&result));
    let preview = files(folder.path())
        .into_iter()
        .find(|name| name.ends_with(".png") && name != "shown.png");
    let preview = folder.path().join(preview.expect("a preview"));
    let (a, b) = (picture(&shown), picture(&preview));
    // the legend is below
    assert_eq!(a.width(), b.width());
    assert!(a.height() > b.height());
    // the walls: where the render has one of the axes. It turns normals to the viewer, and edges of walls are means here.
    let is_axis =
        |pixel: [u8; 3]| pixel != [128; 3] && pixel.iter().all(|part| [0, 128, 255].contains(part));
    let walls = b
        .enumerate_pixels()
        .filter(|(_, _, pixel)| is_axis(pixel.0));
    let walls: Vec<_> = walls
        .map(|(x, y, pixel)| (pixel.0, a.get_pixel(x, y).0))
        .collect();
    let near = |(b, a): &&([u8; 3], [u8; 3])| {
        let same = a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 1);
        same || a.iter().zip(b).all(|(a, b)| (255 - a).abs_diff(*b) <= 1)
    };
    let same = walls.iter().filter(near).count();
    assert!(walls.len() > 30_000, "{}", walls.len());
    assert!(same * 100 > walls.len() * 95, "{same} of {}", walls.len());
}

#[test]
fn values_picked_on_a_page_are_those_that_usd_core_reads() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(folder.path(), "3000");
    let page = folder.path().join("cloud.html");
    let result = run(&["view", text(&cloud), "-o", text(&page)]);
    assert!(result.status.success(), "{}", stderr(&result));
    let Some(dom) = browse(&page, "pick=400,330", &["--dump-dom".to_owned()]) else {
        return;
    };
    let start = dom.find("id=\"values\"").expect("the panel of values");
    let shown = &dom[start..];
    let shown = &shown[shown.find('>').expect("a tag") + 1..shown.find("</pre>").expect("its end")];
    let row = |name: &str| {
        let line = shown
            .lines()
            .find(|line| line.split_whitespace().next() == Some(name));
        let line = line.unwrap_or_else(|| panic!("no {name} in {shown}"));
        let numbers = line.split_whitespace().skip(1);
        numbers
            .map(|number| number.parse::<f64>().expect("a number"))
            .collect::<Vec<_>>()
    };
    const READ: &str = "
import sys, json
from pxr import Usd, UsdGeom
stage = Usd.Stage.Open(sys.argv[1])
prim = stage.GetPrimAtPath('/root/surfels')
i = int(sys.argv[2])
def at(name):
    value = prim.GetAttribute(name).Get()[i]
    return list(value) if hasattr(value, '__len__') else [value]
names = {'P': 'points', 'N': 'normals'}
for name in ['displayColor', 'radiosity', 'albedo', 'area', 'sourcePrim']:
    names[name] = 'primvars:' + name
print(json.dumps({name: at(full) for name, full in names.items()} | {'radius': [at('widths')[0] / 2]}))
";
    let surfel = row("surfel")[0].to_string();
    let truth: Json =
        serde_json::from_str(&python::run_python(READ, &[text(&cloud), &surfel])).unwrap();
    for (name, values) in truth.as_object().unwrap() {
        let shown = row(name);
        assert_eq!(shown.len(), values.as_array().unwrap().len());
        for (shown, value) in shown.iter().zip(values.as_array().unwrap()) {
            let value = value.as_f64().unwrap();
            // P: 16 bits of a box of 4 units; N: 8 bits; the rest: half precision; all shown with 4 digits
            let tolerance = match name.as_str() {
                "P" => 1e-4,
                "N" => 8e-3,
                _ => 1e-3 * value.abs() + 1e-6,
            };
            assert!(
                (shown - value).abs() <= tolerance,
                "{name}: {shown} {value}"
            );
        }
    }
}

#[test]
fn a_page_shows_light_with_and_without_reflections_beside_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let stage = bake(folder.path());
    let page = folder.path().join("bake.html");
    let result = run(&[
        "view",
        text(&stage),
        "-o",
        text(&page),
        "--aov",
        "irradiance",
        "--usd",
        "native",
        "--json",
    ]);
    let report = json(&result);
    let known = report["settings"]["aovs"].as_array().unwrap();
    assert!(known.contains(&Json::from("irradiance_without_indirect")));
    let screen = folder.path().join("screen.png");
    if browse(&page, "", &[format!("--screenshot={}", screen.display())]).is_none() {
        return;
    }
    let screen = picture(&screen);
    // the ceiling is lit by reflections alone: the left half shows it, the right half leaves it black
    let mean = |left: u32| {
        let pixels = (left..left + 400).flat_map(|x| (100..500).map(move |y| (x, y)));
        pixels
            .map(|(x, y)| u64::from(screen.get_pixel(x, y).0[0]))
            .sum::<u64>()
    };
    assert!(mean(0) > mean(400) * 11 / 10, "{} {}", mean(0), mean(400));
    // nothing is fetched: no addresses but those of namespaces
    let text = fs::read_to_string(&page).unwrap();
    assert!(!text.contains("http://") && !text.contains("https://"));
}

#[test]
fn what_cannot_be_shown_is_an_error_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = cloud(folder.path(), "500");
    let out = folder.path().join("x.png");
    let fails = |args: &[&str], code: i32, word: &str| {
        let result = run(args);
        assert_eq!(result.status.code(), Some(code), "{}", stderr(&result));
        assert!(
            stderr(&result).contains(word),
            "no {word:?} in {}",
            stderr(&result)
        );
        assert_eq!(
            files(folder.path())
                .iter()
                .filter(|name| *name != "cloud.usdc" && *name != "cut.usdc")
                .count(),
            0
        );
    };
    let (c, o) = (text(&cloud), text(&out));
    fails(
        &["view", c, "-o", o, "--aov", "nonsense"],
        1,
        "displayColor",
    );
    fails(&["view", c, "-o", o, "--camera", "cam"], 1, "no cameras");
    fails(&["view", c, "-o", o, "--range", "3:1"], 2, "lower first");
    fails(&["view", c, "-o", "x.gif"], 2, ".png or .html");
    fails(&["view", c], 2, "--output");
    let bytes = fs::read(&cloud).unwrap();
    let cut = folder.path().join("cut.usdc");
    for part in [0, 8, 100, bytes.len() / 2, bytes.len() - 10] {
        fs::write(&cut, &bytes[..part]).unwrap();
        fails(
            &["view", text(&cut), "-o", o, "--usd", "native"],
            1,
            "cut.usdc",
        );
    }
    fs::write(&out, "mine").unwrap();
    let result = run(&["view", c, "-o", o, "--no-clobber"]);
    assert_eq!(result.status.code(), Some(1));
    assert_eq!(fs::read(&out).unwrap(), b"mine");
}

#[test]
fn statistics_of_every_command_that_writes_are_as_their_schema_says() {
    const CHECK: &str = "
import sys, json, jsonschema
schema = json.load(open(sys.argv[1]))
jsonschema.Draft202012Validator.check_schema(schema)
for name in sys.argv[2:]:
    jsonschema.validate(json.load(open(name)), schema)
";
    let folder = tempfile::tempdir().unwrap();
    let in_folder = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let small = ["--surfels", "500", "--usd", "native"];
    let mut files =
        vec![concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/report.schema.json").to_owned()];
    let (cloud, bake, render) = (in_folder("c.usdc"), in_folder("b.usdc"), in_folder("r.exr"));
    let (shown, ply) = (in_folder("s.png"), in_folder("p.ply"));
    let commands: [(&str, Vec<&str>); 5] = [
        ("points", [&[ROOM, "-o", &cloud][..], &small].concat()),
        (
            "bake",
            [&[ROOM, "-o", &bake, "--rays", "16"][..], &small].concat(),
        ),
        (
            "render",
            [
                &[ROOM, "-o", &render, "--rays", "16", "--image-width", "16"][..],
                &small,
            ]
            .concat(),
        ),
        ("view", vec![&cloud, "-o", &shown, "-w", "32"]),
        ("convert", vec![&cloud, &ply]),
    ];
    for (command, args) in commands {
        let output = run(&[&[command, "--json"][..], &args].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let statistics = in_folder(&format!("{command}.json"));
        fs::write(&statistics, &output.stdout).unwrap();
        files.push(statistics);
    }
    python::run_python(CHECK, &files);
}
