//! `surflux run`: order, what is up to date, failures, crashes, and the recipes in `pipelines/`.

use crate::program::{ROOM, files, json, run, stderr, surflux};
use crate::python::{python, run_python};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// A sheet under a lid, which hides half of its sky.
fn asset(height: f32) -> String {
    let quad = |name: &str, y: f32| {
        format!(
            "def Mesh \"{name}\" {{\n int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0, 1, 2, 3]\n \
             point3f[] points = [(0, {y}, 0), (0, {y}, 1), (1, {y}, 1), (1, {y}, 0)]\n \
             uniform token subdivisionScheme = \"none\"\n}}\n"
        )
    };
    format!(
        "#usda 1.0\n(upAxis = \"Y\")\n{}{}",
        quad("sheet", 0.0),
        quad("lid", height)
    )
}

/// Bakes each asset, and makes a PLY of the cloud of each.
const RECIPE: &str = r#"{
  "settings": {"rays": 64},
  "steps": [
    {"name": "ply", "command": "convert", "each": {"step": "cloud"},
     "arguments": ["{each}", "out/{each.stem}.ply"], "outputs": ["out/{each.stem}.ply"]},
    {"name": "cloud", "command": "points", "each": "*.usda",
     "arguments": ["{each}", "-o", "out/{each.stem}.usdc", "--surfels", "200", "--dome", "1", "--usd", "native"],
     "outputs": ["out/{each.stem}.usdc"]},
    {"name": "bake", "command": "bake", "each": "*.usda",
     "arguments": ["{each}", "-o", "bake/{each.stem}.usdc", "--aov", "occlusion", "--rays", "{rays}", "--usd", "native"],
     "outputs": ["bake/{each.stem}.usdc"]}]}"#;

/// A folder with two assets and [`RECIPE`].
fn kitchen() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    fs::write(folder.path().join("a.usda"), asset(1.0)).expect("writable");
    fs::write(folder.path().join("b.usda"), asset(0.5)).expect("writable");
    fs::write(folder.path().join("r.json"), RECIPE).expect("writable");
    folder
}

fn cook(folder: &Path, more: &[&str]) -> Output {
    let mut command = surflux();
    command
        .current_dir(folder)
        .args(["run", "r.json", "--json"]);
    command.args(more).output().expect("the program starts")
}

/// `step label state` of each task.
fn states(output: &Output) -> Vec<String> {
    let report: Value = serde_json::from_slice(&output.stdout).expect("stdout is JSON");
    let tasks = report["tasks"].as_array().expect("tasks");
    let text = |value: &Value| value.as_str().expect("text").to_owned();
    let state = |task: &Value| {
        [&task["step"], &task["label"], &task["state"]]
            .map(text)
            .join(" ")
    };
    let mut states: Vec<String> = tasks.iter().map(state).collect();
    states.sort();
    states
}

/// What a change of `a.usda` makes due.
const OF_A: [&str; 3] = ["bake a.usda", "cloud a.usda", "ply out/a.usdc"];

/// Tasks of `output` that were run.
fn done(output: &Output) -> Vec<String> {
    let mut done = states(output);
    done.retain_mut(|state| match state.strip_suffix(" done") {
        Some(task) => {
            *state = task.to_owned();
            true
        }
        None => false,
    });
    done
}

fn all(state: &str) -> Vec<String> {
    [
        "bake a.usda",
        "bake b.usda",
        "cloud a.usda",
        "cloud b.usda",
        "ply out/a.usdc",
        "ply out/b.usdc",
    ]
    .map(|task| format!("{task} {state}"))
    .to_vec()
}

#[test]
fn only_what_changed_is_run_again() {
    let folder = kitchen();
    let here = folder.path();
    assert_eq!(states(&cook(here, &[])), all("done"));
    assert_eq!(
        files(&here.join("out")),
        ["a.ply", "a.usdc", "b.ply", "b.usdc"]
    );
    assert_eq!(states(&cook(here, &[])), all("up_to_date"));

    // Written anew with the same in it: nothing to do.
    fs::write(here.join("a.usda"), asset(1.0)).unwrap();
    assert_eq!(states(&cook(here, &[])), all("up_to_date"));

    let before = fs::read(here.join("out/a.ply")).unwrap();
    fs::write(here.join("a.usda"), asset(0.25)).unwrap();
    assert_eq!(done(&cook(here, &[])), OF_A);
    assert_ne!(fs::read(here.join("out/a.ply")).unwrap(), before);

    // Another setting is another command, but only where it is used.
    let other = cook(here, &["--set", "rays=32"]);
    assert_eq!(done(&other), ["bake a.usda", "bake b.usda"]);

    // What is gone is made again.
    fs::remove_file(here.join("out/b.ply")).unwrap();
    let gone = states(&cook(here, &["--set", "rays=32"]));
    assert!(gone.contains(&"ply out/b.usdc done".to_owned()), "{gone:?}");
    assert_eq!(
        states(&cook(here, &["--force", "--set", "rays=32"])),
        all("done")
    );
}

#[test]
fn a_layer_that_an_asset_refers_to_counts_as_read() {
    let folder = kitchen();
    let here = folder.path();
    fs::create_dir(here.join("parts")).unwrap();
    fs::write(here.join("parts/a.usda"), asset(1.0)).unwrap();
    let over = "#usda 1.0\n(subLayers = [@./parts/a.usda@])\n";
    fs::write(here.join("a.usda"), over).unwrap();
    assert_eq!(states(&cook(here, &[])), all("done"));
    fs::write(here.join("parts/a.usda"), asset(0.1)).unwrap();
    assert_eq!(done(&cook(here, &[])), OF_A);
}

#[test]
fn a_dry_run_lists_what_is_due_and_writes_nothing() {
    let folder = kitchen();
    let here = folder.path();
    assert_eq!(states(&cook(here, &["--dry-run"])), all("due"));
    assert_eq!(files(here), ["a.usda", "b.usda", "r.json"]);
    cook(here, &[]);
    fs::write(here.join("b.usda"), asset(0.75)).unwrap();
    let due = states(&cook(here, &["--dry-run"]));
    let due: Vec<&String> = due.iter().filter(|state| state.ends_with(" due")).collect();
    assert_eq!(
        due,
        ["bake b.usda due", "cloud b.usda due", "ply out/b.usdc due"]
    );
}

#[test]
fn what_fails_takes_only_those_with_it_that_need_it() {
    let folder = kitchen();
    let here = folder.path();
    fs::write(here.join("a.usda"), "#usda 1.0\ndef Mesh \"broken\" {").unwrap();
    let output = cook(here, &["--jobs", "2"]);
    assert_eq!(output.status.code(), Some(1));
    let message = stderr(&output);
    assert!(
        message.contains("2 of 6 tasks failed, 1 were left out"),
        "{message}"
    );
    assert!(message.contains("a.usda"), "{message}");
    assert_eq!(
        states(&output),
        [
            "bake a.usda failed",
            "bake b.usda done",
            "cloud a.usda failed",
            "cloud b.usda done",
            "ply out/a.usdc left_out",
            "ply out/b.usdc done",
        ]
    );
    fs::write(here.join("a.usda"), asset(2.0)).unwrap();
    assert_eq!(done(&cook(here, &[])), OF_A);
}

#[cfg(unix)]
#[test]
fn a_run_that_was_ended_goes_on_where_it_was() {
    let folder = kitchen();
    let here = folder.path();
    let slow = r#"{"steps": [
        {"name": "quick", "command": "points", "arguments": ["a.usda", "-o", "a.usdc", "--surfels", "100", "--usd", "native"],
         "outputs": ["a.usdc"]},
        {"name": "slow", "command": "bake", "after": ["quick"],
         "arguments": ["b.usda", "-o", "b.usdc", "--aov", "irradiance_indirect,occlusion", "--rays", "1048576", "--surfels", "{surfels}",
                       "--gather", "rays", "--dome", "1", "--usd", "native", "--interpolation", "vertex"], "outputs": ["b.usdc"]}],
        "settings": {"surfels": 4000000}}"#;
    fs::write(here.join("r.json"), slow).unwrap();
    let mut command = surflux();
    command
        .current_dir(here)
        .args(["run", "r.json"])
        .stderr(Stdio::piped());
    let child = command.spawn().expect("the program starts");
    let start = Instant::now();
    while !here.join("r.manifest.json").exists() {
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "the quick step does not end"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
    // The slow step runs by now, or is about to.
    std::thread::sleep(Duration::from_millis(300));
    let ended = Command::new("kill")
        .args(["-TERM", &child.id().to_string()])
        .status();
    assert!(ended.expect("kill starts").success());
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("--resume"), "{}", stderr(&output));
    assert_eq!(
        files(here),
        ["a.usda", "a.usdc", "b.usda", "r.json", "r.manifest.json"]
    );
    let resumed = cook(here, &["--resume", "--set", "surfels=100"]);
    assert_eq!(
        states(&resumed),
        ["quick  up_to_date", "slow  done"],
        "{}",
        stderr(&resumed)
    );
}

#[test]
fn mistakes_in_a_recipe_are_named() {
    let folder = kitchen();
    let here = folder.path();
    let says = |recipe: &str, more: &[&str], words: &[&str]| {
        fs::write(here.join("r.json"), recipe).unwrap();
        let output = cook(here, more);
        assert_eq!(output.status.code(), Some(1));
        for word in words.iter().chain(&["r.json"]) {
            assert!(
                stderr(&output).contains(word),
                "no {word:?} in: {}",
                stderr(&output)
            );
        }
    };
    says("{", &[], &["is no recipe", "line 1"]);
    says(r#"{"steps": [], "stepz": 1}"#, &[], &["stepz"]);
    says(
        r#"{"steps": [{"name": "a", "command": "cook", "arguments": []}]}"#,
        &[],
        &["`cook`", "bake"],
    );
    says(
        r#"{"settings": {"shot": null}, "steps": []}"#,
        &[],
        &["--set shot="],
    );
    says(
        r#"{"settings": {"shot": "x"}, "steps": []}"#,
        &["--set", "shoot=y"],
        &["shoot", "shot"],
    );
    fs::remove_file(here.join("r.json")).unwrap();
    let output = cook(here, &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("cannot be read"),
        "{}",
        stderr(&output)
    );
    assert_eq!(run(&["run", "r.json", "--set", "x"]).status.code(), Some(2));
}

/// A recipe of `pipelines/`.
fn ready(name: &str) -> String {
    format!("{}/pipelines/{name}.json", env!("CARGO_MANIFEST_DIR"))
}

/// Run one in `folder`.
fn cook_ready(folder: &Path, name: &str, sets: &[(&str, &str)]) -> Value {
    let mut command = surflux();
    command.env("SURFLUX_USD_PYTHON", python());
    command
        .current_dir(folder)
        .args(["run", &ready(name), "--json"]);
    for (key, value) in sets {
        command.args(["--set", &format!("{key}={value}")]);
    }
    json(&command.output().expect("the program starts"))
}

#[test]
fn ready_recipes_are_as_their_schema_says() {
    const CHECK: &str = "
import sys, json, jsonschema
schema = json.load(open(sys.argv[1]))
jsonschema.Draft202012Validator.check_schema(schema)
for name in sys.argv[2:]:
    jsonschema.validate(json.load(open(name)), schema)
print(len(sys.argv) - 2)
";
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let pipelines = files(&root.join("pipelines"));
    let recipes = pipelines.iter().filter(|name| name.ends_with(".json"));
    let recipes: Vec<String> = recipes
        .map(|name| ready(name.trim_end_matches(".json")))
        .collect();
    let schema = root
        .join("schemas/recipe.schema.json")
        .to_string_lossy()
        .into_owned();
    let arguments: Vec<String> = [schema].into_iter().chain(recipes.clone()).collect();
    let checked = run_python(CHECK, &arguments);
    assert_eq!(checked.trim(), recipes.len().to_string());
    assert!(recipes.len() >= 5);
}

#[test]
fn the_recipes_for_assets_and_models_run_as_they_are() {
    let folder = kitchen();
    let here = folder.path();
    let sets = [("assets", "?.usda"), ("tolerance", "0.1")];
    cook_ready(here, "occlusion_library", &sets);
    let made = files(&here.join("occlusion"));
    for name in ["a.usdc", "a_baked.usda", "a.png", "b.png"] {
        assert!(made.iter().any(|file| file == name), "{name} in {made:?}");
    }
    let glb = here.join("m.glb").to_string_lossy().into_owned();
    let from = here.join("a.usda").to_string_lossy().into_owned();
    assert!(run(&["convert", &from, &glb]).status.success());
    cook_ready(
        here,
        "gltf_ingest",
        &[("models", "m.glb"), ("tolerance", "0.1")],
    );
    assert!(here.join("ingest/m_occlusion.glb").exists());
}

#[test]
fn the_recipe_of_a_shot_runs_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let sets = [
        ("shot", ROOM),
        ("tolerance", "0.3"),
        ("bounces", "1"),
        ("width", "24"),
        ("frames", "1,2"),
    ];
    let report = cook_ready(folder.path(), "gi_shot", &sets);
    assert_eq!(report["tasks"].as_array().unwrap().len(), 5);
    let made = files(&folder.path().join("gi"));
    for name in [
        "cloud.html",
        "cloud.usdc",
        "shot.0001.exr",
        "shot.0002.exr",
        "shot_gi.usdc",
    ] {
        assert!(made.iter().any(|file| file == name), "{name} in {made:?}");
    }
}

/// A room with a warm and a cold lamp, each in a collection of its own.
const LAMPS: &str = r#"#usda 1.0
(upAxis = "Y")
def Mesh "floor" {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)]
    uniform token subdivisionScheme = "none"
}
def SphereLight "fire" (prepend apiSchemas = ["CollectionAPI:warm"]) {
    color3f inputs:color = (1, 0.5, 0)
    float inputs:intensity = 10
    float inputs:radius = 0.1
    double3 xformOp:translate = (0.5, 1, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    rel collection:warm:includes = </fire>
}
def SphereLight "moon" (prepend apiSchemas = ["CollectionAPI:cold"]) {
    color3f inputs:color = (0, 0.5, 1)
    float inputs:intensity = 10
    float inputs:radius = 0.1
    double3 xformOp:translate = (-0.5, 1, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    rel collection:cold:includes = </moon>
}
"#;

/// What each group adds to the red of the image, and all of it.
fn reds(exr: &Path) -> BTreeMap<String, f64> {
    let image = exr::prelude::read_first_flat_layer_from_file(exr).expect("an EXR");
    let channels = image.layer_data.channel_data.list;
    let reds = channels.iter().filter_map(|channel| {
        let name = channel.name.to_string();
        let values = channel.sample_data.values_as_f32();
        let group = match name.strip_suffix("irradiance.R").is_some() {
            true => "all",
            false => name.strip_suffix(".R")?.strip_prefix("irradiance_")?,
        };
        Some((group.to_owned(), values.map(f64::from).sum()))
    });
    reds.collect()
}

#[test]
fn the_recipe_of_light_groups_tells_lamps_apart() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let here = folder.path();
    fs::write(here.join("shot.usda"), LAMPS).expect("writable");
    let sets = [
        ("shot", "shot.usda"),
        ("groups", "warm,cold"),
        ("tolerance", "0.2"),
        ("bounces", "1"),
        ("width", "24"),
    ];
    let report = cook_ready(here, "light_groups", &sets);
    assert_eq!(report["tasks"].as_array().map(Vec::len), Some(3));
    let made = files(&here.join("groups"));
    let expected = ["shot.0001.exr", "shot.html", "shot.usdc", "shot_baked.usda"];
    assert_eq!(made, expected);
    let reds = reds(&here.join("groups/shot.0001.exr"));
    assert_eq!(reds["cold"], 0.0, "{reds:?}");
    assert!(reds["warm"] > 0.0, "{reds:?}");
    assert!((reds["warm"] / reds["all"] - 1.0).abs() < 1e-3, "{reds:?}");
}

#[test]
fn the_turntable_turns() {
    let folder = kitchen();
    let sets = [
        ("asset", "a.usda"),
        ("count", "4"),
        ("frames", "1:2"),
        ("width", "24"),
        ("tolerance", "0.3"),
    ];
    cook_ready(folder.path(), "turntable", &sets);
    let exr = |frame: u32| {
        let path = folder
            .path()
            .join(format!("turntable/turntable.{frame:04}.exr"));
        let image = exr::prelude::read_first_flat_layer_from_file(path).expect("an EXR");
        let layer = image.layer_data.channel_data.list;
        layer
            .iter()
            .map(|channel| {
                channel
                    .sample_data
                    .values_as_f32()
                    .map(f64::from)
                    .sum::<f64>()
            })
            .sum::<f64>()
    };
    // A quarter turn of a square is the same again; what is in front changes nothing of the sum.
    let (first, second) = (exr(1), exr(2));
    assert!(first > 0.0, "the asset is in the picture");
    assert!((first / second - 1.0).abs() < 0.05, "{first} {second}");
}
