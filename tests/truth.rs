//! Bakes and a render of the reference scenes against their reference values, at the bounds that the project promises.
//!
//! The scenes and values lie outside the repository, in `truth/` of the folder that `SURFLUX_SHARED` names, else
//! `../shared`; without them these tests say that they are skipped.
#![expect(
    clippy::print_stdout,
    reason = "measured errors are what these tests are read for"
)]

#[path = "support/python.rs"]
mod python;

#[allow(dead_code, reason = "every test file uses some of the helpers")]
#[path = "support/program.rs"]
mod program;

use program::{json, surflux};
use python::{python, run_python};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// The folder of reference scenes, values and scripts, if it is there.
fn truth() -> Option<PathBuf> {
    let shared = std::env::var_os("SURFLUX_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"),
        PathBuf::from,
    );
    let folder = shared.join("truth");
    let found = folder.join("values").is_dir();
    if !found {
        println!(
            "skipped: there are no reference values in {}",
            folder.display()
        );
    }
    found.then_some(folder)
}

/// A baked scene, as a stage that shows it.
struct Baked {
    truth: PathBuf,
    _folder: TempDir,
    stage: PathBuf,
}

impl Baked {
    fn new(truth: &Path, scene: &str, options: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let result = surflux()
            .arg("bake")
            .arg(truth.join("scenes").join(scene))
            .arg("-o")
            .arg(folder.path().join("out.usdc"))
            .args(["--usd", "native", "--json", "--quiet"])
            .args(options)
            .output()
            .expect("the program starts");
        let report = json(&result);
        println!(
            "{scene} {options:?}: {} {}",
            report["seconds"], report["error"]["aovs"]
        );
        Self {
            truth: truth.to_owned(),
            stage: folder.path().join("out_baked.usda"),
            _folder: folder,
        }
    }

    /// Relative RMSE of `primvar` against `quantity` of `values`, at most `bound`.
    fn check(&self, values: &str, quantity: &str, primvar: &str, bound: f64) {
        let mut command = Command::new(python());
        command
            .arg(self.truth.join("scripts/compare.py"))
            .arg(self.truth.join("values").join(values))
            .arg(&self.stage)
            .args(["--quantity", quantity, "--primvar", primvar]);
        if quantity == "ao_vis" {
            command.arg("--invert");
        }
        let compared = json(&command.output().expect("Python starts"));
        let total = &compared["total"];
        println!("  {values} {quantity}: {total}");
        assert_eq!(total["nonfinite"], 0);
        let error = total["relRMSE"].as_f64().expect("a number");
        assert!(
            error <= bound,
            "{values} {quantity}: {error}, bound {bound}"
        );
    }
}

#[test]
fn rays_in_the_cornell_box() {
    let Some(truth) = truth() else { return };
    let aovs = "occlusion,irradiance_direct,irradiance_indirect";
    let options = ["--gather", "rays", "--aov", aovs];
    let baked = Baked::new(&truth, "cornell_spheres.usdc", &options);
    let values = "cornell_spheres.npz";
    baked.check(values, "ao_vis", "occlusion", 0.02);
    baked.check(values, "e_direct", "irradiance_direct", 0.015);
    baked.check(values, "e_ind1", "irradiance_indirect", 0.02);
}

#[test]
fn the_papers_engine_in_the_cornell_box() {
    let Some(truth) = truth() else { return };
    let options = [
        "--gather",
        "paper",
        "--aov",
        "occlusion,irradiance_indirect",
    ];
    let baked = Baked::new(&truth, "cornell_spheres.usdc", &options);
    baked.check("cornell_spheres.npz", "ao_vis", "occlusion", 0.08);
    baked.check("cornell_spheres.npz", "e_ind1", "irradiance_indirect", 0.05);
}

#[test]
fn a_furnace_of_twelve_bounces_holds_a_geometric_series() {
    let Some(truth) = truth() else { return };
    let options = ["--bounces", "12", "--aov", "irradiance"];
    let baked = Baked::new(&truth, "furnace_box.usda", &options);
    // Emission 1, albedo 0.6: bounce k brings π · 0.6^k.
    let script = "import sys
import numpy as np
from pxr import Usd, UsdGeom
want = np.pi * sum(0.6**k for k in range(13))
errors = []
stage = Usd.Stage.Open(sys.argv[1])
for prim in stage.Traverse():
    values = UsdGeom.PrimvarsAPI(prim).GetPrimvar('irradiance')
    if values and values.HasValue():
        errors.append(np.array(values.Get()).ravel() / want - 1)
print(np.abs(np.concatenate(errors)).max())";
    let error: f64 = run_python(script, &[&baked.stage])
        .trim()
        .parse()
        .expect("a number");
    println!("  furnace: largest error of all points {error}");
    assert!(error > 0.0 && error <= 1e-3, "{error}");
}

#[test]
fn light_of_emitting_surfaces_is_exact() {
    let Some(truth) = truth() else { return };
    for (scene, values) in [
        ("wedge90.usdc", "analytic_wedge90.npz"),
        ("perp_squares.usda", "analytic_perp_squares.npz"),
        ("disk_plane.usdc", "analytic_disk_plane.npz"),
    ] {
        let baked = Baked::new(&truth, scene, &["--aov", "irradiance_direct"]);
        baked.check(values, "e_direct", "irradiance_direct", 0.01);
    }
}

#[test]
fn a_sphere_alone_in_the_sky_is_open_and_lit_by_pi() {
    let Some(truth) = truth() else { return };
    let aovs = "occlusion,irradiance_environment";
    let baked = Baked::new(&truth, "env_sphere.usdc", &["--aov", aovs]);
    baked.check("analytic_env_sphere.npz", "ao_vis", "occlusion", 0.01);
    baked.check(
        "analytic_env_sphere.npz",
        "e_env",
        "irradiance_environment",
        0.01,
    );
}

/// Compares block means of an image of fewer pixels with those of the truth, the lamp among them.
const COMPARE_IMAGE: &str = "import sys, json
import numpy as np
import OpenEXR
def read(path):
    channels = OpenEXR.File(path, separate_channels=True).channels()
    return {name: np.asarray(channel.pixels, float) for name, channel in channels.items()}
def blocks(image):
    size = len(image) // 64
    return image.reshape(64, size, 64, size, -1).mean((1, 3))
def layer_of(image, name):
    return np.stack([image[f'{name}.{c}'] for c in 'RGB'], -1)
truth, render = read(sys.argv[1]), read(sys.argv[2])
errors = {}
indirect = layer_of(render, 'diffuse_indirect')
direct = np.stack([render[c] for c in 'RGB'], -1) - indirect
for ours, layer in ((direct, 'direct'), (indirect, 'ind1')):
    want, got = blocks(layer_of(truth, layer)), blocks(ours)
    errors[layer] = np.sqrt(((got - want) ** 2).mean()) / want.mean()
print(json.dumps(errors))";

/// Render the Cornell box to `image`; the report.
fn render_box(truth: &Path, image: &Path, options: &[&str]) -> serde_json::Value {
    let result = surflux()
        .arg("render")
        .arg(truth.join("scenes/cornell_spheres.usdc"))
        .arg("-o")
        .arg(image)
        .args(["--usd", "native", "--json", "--quiet"])
        .args(["--camera", "/World/cam"])
        .args(options)
        .output()
        .expect("the program starts");
    json(&result)
}

#[test]
fn a_camera_sees_the_light_of_the_reference_image() {
    let Some(truth) = truth() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let image = folder.path().join("out.exr");
    let aovs = "color,diffuse_direct,diffuse_indirect";
    let options = [
        "--image-width",
        "128",
        "--pixel-samples",
        "4",
        "--rays",
        "512",
    ];
    let report = render_box(&truth, &image, &[&options[..], &["--aov", aovs]].concat());
    println!("image: {}", report["seconds"]);
    let values = truth.join("values/cornell_spheres.image.exr");
    let paths: [OsString; 2] = [values.into(), image.into()];
    let compared = run_python(COMPARE_IMAGE, &paths);
    println!("  {compared}");
    let errors: serde_json::Value = serde_json::from_str(&compared).expect("JSON");
    let error = |name: &str| errors[name].as_f64().expect("a number");
    assert!(error("direct") <= 0.02, "{compared}");
    assert!(error("ind1") <= 0.03, "{compared}");
}

/// Relative RMSE of the reflected light of the first image, the second being the truth.
const COMPARE_IRRADIANCE: &str = "
import sys, numpy as np, OpenEXR
def light(path):
    channels = OpenEXR.File(path).channels()
    together = channels.get('irradiance_indirect')
    if together is not None:
        return together.pixels.astype(float)
    return np.stack([channels['irradiance_indirect.' + c].pixels.astype(float) for c in 'RGB'], -1)
ours, truth = (light(path) for path in sys.argv[1:3])
print(np.sqrt(((ours - truth) ** 2).mean()) / truth.mean())";

#[test]
fn where_every_pixel_looks_for_itself_clusters_are_tried_and_the_tolerance_is_kept() {
    let Some(truth) = truth() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let render = |name: &str, options: &[&str]| {
        let image = folder.path().join(name);
        let usual = ["--image-width", "384", "--aov", "irradiance_indirect"];
        let report = render_box(&truth, &image, &[&usual[..], options].concat());
        (OsString::from(image), report)
    };
    let options = ["--tolerance", "0.03", "--interpolate", "never"];
    let (ours, report) = render("ours.exr", &options);
    let (settings, error) = (&report["settings"], &report["error"]["estimate"]);
    println!("{} {} {error}", report["seconds"], settings["engines"]);
    // Which of them is cheaper hangs on the machine.
    let trials = settings["pilot"]["trials"].as_array().expect("trials");
    let is_raster = |trial: &&serde_json::Value| trial["engine"] == "raster";
    let tried = trials.iter().find(is_raster).expect("clusters are tried");
    println!("  {tried}");
    let (rays, _) = render("rays.exr", &["--rays", "1024", "--surfels", "200000"]);
    let compared = run_python(COMPARE_IRRADIANCE, &[ours, rays]);
    println!("  {compared}");
    let off: f64 = compared.trim().parse().expect("a number");
    assert!(off <= 0.03, "{off}, estimated {error}");
}
