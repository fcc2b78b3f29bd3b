//! `--report` and `--thumbnail`: what the page shows against renders read by OpenEXR and developed by numpy.

use crate::program::{ROOM, files, json, run, stderr};
use std::path::Path;

/// Runs `command` on the example natively, writing `file` of `folder`.
fn made(folder: &Path, command: &str, file: &str, more: &[&str]) -> serde_json::Value {
    let output = folder.join(file);
    let output = output.to_str().expect("UTF-8");
    let fixed = [command, ROOM, "--usd", "native", "--json", "-o", output];
    let args: Vec<&str> = fixed.iter().chain(more).copied().collect();
    json(&run(&args))
}

/// Compares the page in a folder with the renders there: `told.exr`, made with it, `same.exr` and `plain.exr` without.
const AS_RENDERED: &str = r#"
import base64, io, os, re, sys
import numpy as np, OpenEXR
from html.parser import HTMLParser
import OpenImageIO as oiio
folder = sys.argv[1]

def channels(name):
    file = OpenEXR.File(os.path.join(folder, name), separate_channels=True)
    return {k: np.array(v.pixels, np.float32) for k, v in file.channels().items()}

def png(data):
    path = os.path.join(folder, 'shot.png')
    open(path, 'wb').write(data)
    return oiio.ImageBuf(path).get_pixels(oiio.UINT8)[..., :3].astype(int)

told, same, plain = channels('told.exr'), channels('same.exr'), channels('plain.exr')
assert told.keys() == same.keys()
for name in told:
    assert (told[name] == same[name]).all(), f'{name} changes with --report'

class Page(HTMLParser):
    images, links, text = [], [], ''
    def handle_starttag(self, tag, attributes):
        a = dict(attributes)
        if tag == 'img': self.images.append((a['alt'], a['src']))
        if tag == 'a': self.links.append(a['href'])
        assert tag not in ('script', 'link') and not a.get('src', 'data:').startswith('http')
    def handle_data(self, data): self.text += data
page = Page(); page.feed(open(os.path.join(folder, 'told.html'), encoding='utf-8').read())
titles = [title for title, _ in page.images]
assert titles == ['color', 'color without reflected light', 'occlusion'], titles
assert page.links == ['told.exr', 'told_thumbnail.png'], page.links
for word in ('receivers', 'image', '48', 'rays', 'Warnings', '--pixel-samples'):
    assert word in page.text, word
shots = [png(base64.b64decode(src.split(',', 1)[1])) for _, src in page.images]

def rgb(c): return np.stack([c[k] for k in 'RGB'], -1).astype(np.float64)
bright = np.sort(rgb(told).max(-1).ravel()); bright = bright[bright > 0]
white = bright[int(np.floor((len(bright) - 1) * 0.95 + 0.5))]
def develop(linear):
    x = np.clip(linear / white, 0, 1)
    return 255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
for shot, linear in ((shots[0], rgb(told)), (shots[1], rgb(plain))):
    # EXR keeps half precision: 5e-4 of a value is up to 0.1 of a code; rounding is 0.5, a table's step 0.5 more
    off = np.abs(shot - develop(linear)).max()
    assert off <= 1.2, off
assert shots[1].mean() < shots[0].mean() - 5
assert png(open(os.path.join(folder, 'told_thumbnail.png'), 'rb').read()).shape == shots[0].shape
"#;

#[test]
fn a_page_shows_light_with_and_without_reflections_as_renders_have_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let page = folder.join("told.html");
    let page = page.to_str().expect("UTF-8");
    let asked = [
        "--image-width",
        "48",
        "--rays",
        "64",
        "--pixel-samples",
        "2",
        "--surfels",
        "2000",
    ];
    let aov = ["--aov", "color,occlusion"];
    let shown = ["--report", page, "--thumbnail"];
    let told = made(
        folder,
        "render",
        "told.exr",
        &[&asked[..], &aov, &shown].concat(),
    );
    let outputs = told["outputs"].as_array().expect("a list").len();
    assert_eq!(outputs, 3, "{told}");
    assert_eq!(
        files(folder),
        ["told.exr", "told.html", "told_thumbnail.png"]
    );
    made(folder, "render", "same.exr", &[&asked[..], &aov].concat());
    let plain = [
        "--image-width",
        "48",
        "--pixel-samples",
        "2",
        "--aov",
        "color",
        "--bounces",
        "0",
    ];
    made(
        folder,
        "render",
        "plain.exr",
        &[&plain[..], &["--rays", "256"]].concat(),
    );
    crate::python::run_python(AS_RENDERED, &[folder.to_str().expect("UTF-8")]);
}

#[test]
fn pages_of_bakes_and_clouds_show_what_was_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let page = |name: &str| folder.join(name).to_str().expect("UTF-8").to_owned();
    let (bake, points) = (page("bake.html"), page("points.html"));
    let asked = [
        "--aov",
        "irradiance,occlusion",
        "--rays",
        "16",
        "--surfels",
        "2000",
    ];
    let told = made(
        folder,
        "bake",
        "b.usdc",
        &[&asked[..], &["--report", &bake, "--thumbnail"]].concat(),
    );
    assert!(told["seconds"]["pictures"].as_f64().expect("seconds") > 0.0);
    made(
        folder,
        "points",
        "c.usdc",
        &["--surfels", "2000", "--report", &points],
    );
    let written = [
        "b.usdc",
        "b_baked.usda",
        "b_thumbnail.png",
        "bake.html",
        "c.usdc",
        "points.html",
    ];
    assert_eq!(files(folder), written);
    let titles = |page: &str| -> Vec<String> {
        let text = std::fs::read_to_string(page).expect("readable");
        let figures = text.split("<figcaption>").skip(1);
        figures
            .map(|figure| figure.split('<').next().unwrap_or_default().to_owned())
            .collect()
    };
    let pair = [
        "irradiance",
        "irradiance without reflected light",
        "occlusion",
    ];
    assert_eq!(titles(&bake), pair);
    assert_eq!(titles(&points)[..2], ["displayColor", "albedo"]);
    let seen = folder.join("seen.png");
    let seen = seen.to_str().expect("UTF-8");
    let baked = page("b_baked.usda");
    let viewed = ["--aov", "occlusion", "--camera", "cam"];
    let wide = ["--image-width", "640", "-q", "--usd", "native", "-o", seen];
    let result = run(&[&["view", &baked][..], &viewed, &wide].concat());
    assert!(result.status.success(), "{}", stderr(&result));
    crate::python::run_python(SAME_PICTURE, &[bake.as_str(), "occlusion", seen]);
}

/// The picture called so on a page has the pixels of the file.
const SAME_PICTURE: &str = r#"
import base64, re, sys
import numpy as np, OpenImageIO as oiio
page, title, seen = sys.argv[1:]
text = open(page, encoding='utf-8').read()
src, = [m for m in re.findall(r'<img[^>]*>', text) if f'alt="{title}"' in m]
open(seen + '.shown.png', 'wb').write(base64.b64decode(re.search(r'base64,([^"]+)"', src).group(1)))
codes = lambda path: oiio.ImageBuf(path).get_pixels(oiio.UINT8)[..., :3].astype(int)
a, b = codes(seen + '.shown.png'), codes(seen)
assert a.shape == b.shape and (a == b).all(), (a.shape, b.shape)
"#;

#[test]
fn a_page_that_cannot_be_written_is_told_before_anything_is_computed() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("o.exr");
    let output = output.to_str().expect("UTF-8");
    let missing = folder.path().join("missing/page.html");
    let missing = missing.to_str().expect("UTF-8");
    let failed = run(&["render", ROOM, "-o", output, "--report", missing]);
    assert_eq!(failed.status.code(), Some(1));
    assert!(
        stderr(&failed).contains("missing is not a folder"),
        "{}",
        stderr(&failed)
    );
    let usage = run(&["render", ROOM, "-o", output, "--report", "page.txt"]);
    assert_eq!(usage.status.code(), Some(2));
    assert!(stderr(&usage).contains("--report page.txt: the name must end in .html"));
    assert!(files(folder.path()).is_empty());
}

#[test]
fn flags_are_environment_variables_and_what_is_typed_wins() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("o.exr");
    let render = |variables: &[(&str, &str)], more: &[&str]| {
        let mut command = crate::program::surflux();
        let typed = [
            "render",
            ROOM,
            "--usd",
            "native",
            "--surfels",
            "500",
            "--rays",
            "16",
            "-o",
        ];
        command.args(typed).arg(&output).args(more);
        command.envs(variables.iter().copied());
        command.output().expect("it starts")
    };
    let variables = [
        ("SURFLUX_IMAGE_WIDTH", "8"),
        ("SURFLUX_AOV", "occlusion,N"),
        ("SURFLUX_JSON", "1"),
    ];
    let told = json(&render(&variables, &[]));
    assert_eq!(told["settings"]["image"][0], 8, "{told}");
    assert_eq!(
        told["settings"]["aov"],
        serde_json::json!(["occlusion", "N"])
    );
    let told = json(&render(&variables, &["--image-width", "6"]));
    assert_eq!(told["settings"]["image"][0], 6);
    let wrong = render(&[("SURFLUX_PIXEL_SAMPLES", "many")], &[]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(
        stderr(&wrong).contains("'many' for '--pixel-samples"),
        "{}",
        stderr(&wrong)
    );
}
