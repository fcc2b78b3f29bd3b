//! End to end: a stage in, files out; exit codes and messages of bad input.

use crate::program::{ROOM, files, json, run, stage, stderr, surflux};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Runs a bake of `text` that must fail: exit code 1, every word in the message, nothing written.
fn must_fail(text: &str, words: &[&str]) {
    let (folder, path) = stage(text);
    let output = folder.path().join("out.usdc");
    let result = run(&[
        "bake",
        path.to_str().expect("UTF-8"),
        "-o",
        output.to_str().expect("UTF-8"),
        "--usd",
        "native",
    ]);
    assert_eq!(result.status.code(), Some(1), "{}", stderr(&result));
    for word in words {
        assert!(
            stderr(&result).contains(word),
            "no {word:?} in: {}",
            stderr(&result)
        );
    }
    assert_eq!(files(folder.path()), ["stage.usda"]);
}

const QUAD: &str = "int[] faceVertexCounts = [4]\nuniform token subdivisionScheme = \"none\"\n";

#[test]
fn a_render_of_the_example_writes_an_exr_a_preview_and_statistics() {
    let folder = tempfile::tempdir().unwrap();
    let exr = folder.path().join("room.exr");
    let result = run(&[
        "render",
        ROOM,
        "-o",
        exr.to_str().unwrap(),
        "--usd",
        "native",
        "--image-width",
        "48",
        "--rays",
        "64",
        "--surfels",
        "5000",
        "--aov",
        "color,occlusion,irradiance_indirect,N,depth,primId",
        "--preview",
        "--json",
    ]);
    let report = json(&result);
    for key in [
        "surflux",
        "command",
        "usd",
        "seconds",
        "counts",
        "peak_memory_bytes",
        "settings",
        "error",
        "outputs",
        "warnings",
    ] {
        assert!(report.get(key).is_some(), "no {key} in the statistics");
    }
    assert_eq!(report["usd"], "native");
    assert_eq!(report["warnings"], serde_json::json!([]));
    assert!(report["counts"]["receivers"].as_u64().unwrap() >= 48 * 48 / 2);
    assert_eq!(files(folder.path()), ["room.exr", "room.png"]);
}

#[test]
fn a_bake_writes_overs_and_a_stage_that_shows_them() {
    let folder = tempfile::tempdir().unwrap();
    let layer = folder.path().join("room.usdc");
    let result = run(&[
        "bake",
        ROOM,
        "-o",
        layer.to_str().unwrap(),
        "--usd",
        "native",
        "--rays",
        "64",
        "--surfels",
        "5000",
        "--json",
    ]);
    assert_eq!(json(&result)["outputs"].as_array().unwrap().len(), 2);
    assert_eq!(files(folder.path()), ["room.usdc", "room_baked.usda"]);
}

#[test]
fn a_cloud_can_be_baked_and_gathered_from() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = folder.path().join("cloud.usdc");
    let points = run(&[
        "points",
        ROOM,
        "-o",
        cloud.to_str().unwrap(),
        "--usd",
        "native",
        "--surfels",
        "5000",
        "--json",
    ]);
    assert!(json(&points)["counts"]["surfels"].as_u64().unwrap() >= 4000);
    let layer = folder.path().join("room.usdc");
    let bake = run(&[
        "bake",
        ROOM,
        "-o",
        layer.to_str().unwrap(),
        "--usd",
        "native",
        "--rays",
        "64",
        "--cloud",
        cloud.to_str().unwrap(),
        "--aov",
        "irradiance_indirect",
        "--json",
    ]);
    assert_eq!(
        json(&bake)["counts"]["surfels"],
        json(&points)["counts"]["surfels"]
    );
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let mut results = Vec::new();
    for engine in ["rays", "paper", "raster"] {
        for threads in ["1", "2", "8"] {
            let exr = folder.path().join("room.exr");
            let result = run(&[
                "render",
                ROOM,
                "-o",
                exr.to_str().unwrap(),
                "--usd",
                "native",
                "--image-width",
                "24",
                "--rays",
                "64",
                "--surfels",
                "3000",
                "--bounces",
                "2",
                "--threads",
                threads,
                "--gather",
                engine,
                "--aov",
                "color,occlusion,bent_normal",
            ]);
            assert!(result.status.success(), "{}", stderr(&result));
            results.push(pixels(&exr));
        }
        assert!(
            results.windows(2).all(|pair| pair[0] == pair[1]),
            "{engine}: bits depend on the number of threads"
        );
        results.clear();
    }
}

/// All samples of an EXR, as bits.
fn pixels(path: &Path) -> Vec<u32> {
    let image = exr::prelude::read_all_flat_layers_from_file(path).expect("a readable EXR");
    let channels = image
        .layer_data
        .iter()
        .flat_map(|layer| &layer.channel_data.list);
    channels
        .flat_map(|channel| {
            channel
                .sample_data
                .values_as_f32()
                .map(f32::to_bits)
                .collect::<Vec<_>>()
        })
        .collect()
}

#[test]
fn info_tells_what_is_in_a_stage() {
    let result = run(&["info", ROOM, "--usd", "native"]);
    let text = String::from_utf8_lossy(&result.stdout).into_owned();
    for word in [
        "RectLight /Room/lamp",
        "/Room/cam",
        "point instances",
        "catmullClark",
    ] {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }
    let info = json(&run(&["info", ROOM, "--usd", "native", "--json"]));
    assert_eq!(info["cameras"], serde_json::json!(["/Room/cam"]));
}

#[test]
fn a_dry_run_lists_outputs_and_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let exr = folder.path().join("room.####.exr");
    let result = run(&[
        "render",
        ROOM,
        "-o",
        exr.to_str().unwrap(),
        "--frames",
        "1:3",
        "--dry-run",
        "--json",
    ]);
    let outputs = json(&result)["outputs"].as_array().unwrap().len();
    assert_eq!((outputs, files(folder.path()).len()), (3, 0));
}

#[test]
fn a_bake_of_a_variant_with_unloaded_payloads_selects_that_variant() {
    let mesh = |height: u8| {
        format!(
            "def Mesh \"m\" {{ point3f[] points = [(0,0,0),(1,0,0),(1,1,{height}),(0,1,0)]
{QUAD}int[] faceVertexIndices = [0,1,2,3]
}}\n"
        )
    };
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("car.usda");
    let text = format!(
        "#usda 1.0
def Xform \"Car\" ( variants = {{
        string shape = \"short\"
    }}
    prepend variantSets = \"shape\" ) {{
    variantSet \"shape\" = {{
        \"short\" {{ {} }}
        \"tall\" {{ {} }}
    }}
}}
def Xform \"heavy\" ( payload = @gone.usda@ ) {{ }}",
        mesh(1),
        mesh(5)
    );
    fs::write(&stage, text).unwrap();
    let out = folder.path().join("out.usdc");
    let result = run(&[
        "bake",
        stage.to_str().unwrap(),
        "-o",
        out.to_str().unwrap(),
        "--aov",
        "occlusion",
        "--rays",
        "16",
        "--usd",
        "native",
        "--load",
        "none",
        "--variant",
        "/Car{shape=tall}",
    ]);
    assert!(result.status.success(), "{}", stderr(&result));
    let told = stderr(&result);
    assert!(
        told.contains("payloads of 1 prims") && told.contains("/heavy"),
        "{told}"
    );
    let baked = fs::read_to_string(folder.path().join("out_baked.usda")).unwrap();
    assert!(baked.contains("\"shape\" = \"tall\""), "{baked}");
    let wrong = run(&[
        "info",
        stage.to_str().unwrap(),
        "--usd",
        "native",
        "--variant",
        "/Car{shape=round}",
    ]);
    assert_eq!(wrong.status.code(), Some(1));
    assert!(stderr(&wrong).contains("short, tall"), "{}", stderr(&wrong));
}

#[test]
fn no_clobber_keeps_an_existing_file() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = folder.path().join("cloud.usdc");
    fs::write(&cloud, "precious").unwrap();
    let result = run(&[
        "points",
        ROOM,
        "-o",
        cloud.to_str().unwrap(),
        "--no-clobber",
    ]);
    assert_eq!(result.status.code(), Some(1));
    assert_eq!(fs::read_to_string(&cloud).unwrap(), "precious");
}

#[test]
fn usage_errors_exit_with_two() {
    for args in [
        &["bake", ROOM][..],
        &["bake", ROOM, "-o", "x.usdc", "--aov", "oclusion"],
        &["bake", ROOM, "-o", "x.png"],
        &["render", ROOM, "-o", "x.exr", "--frames", "1:2"],
        &["render", ROOM, "-o", "x.exr", "--frames", "abc"],
        &["info", ROOM, "--variant", "Car{shape=tall}"],
        &["info", ROOM, "--load", "some"],
        &["bake", ROOM, "-o", "x.usdc", "--falloff", "linear"],
        &[
            "bake",
            ROOM,
            "-o",
            "x.usdc",
            "--falloff",
            "cubic",
            "--max-distance",
            "1",
        ],
        &["bake", ROOM, "-o", "x.usdc", "--cone-angle", "91"],
        &["paint", ROOM],
    ] {
        let result = run(args);
        assert_eq!(
            result.status.code(),
            Some(2),
            "{args:?}: {}",
            stderr(&result)
        );
    }
}

#[test]
fn completions_and_manual_pages_name_every_command_and_flag() {
    let folder = tempfile::tempdir().unwrap();
    let result = run(&["man", folder.path().to_str().unwrap()]);
    assert!(result.status.success(), "{}", stderr(&result));
    let help = String::from_utf8(run(&["--help"]).stdout).unwrap();
    let commands = ["points", "bake", "render", "info", "validate", "verify"];
    let bash = String::from_utf8(run(&["completions", "bash"]).stdout).unwrap();
    for command in commands {
        assert!(help.contains(&format!("  {command} ")), "{help}");
        assert!(bash.contains(command));
        let page = folder.path().join(format!("surflux-{command}.1"));
        let page = fs::read_to_string(page).unwrap();
        assert!(
            page.contains("\\-\\-frames") || command == "validate",
            "{page}"
        );
    }
    assert!(bash.contains("--cone-angle"));
    // A shell that reads them has nothing to say.
    let script = folder.path().join("surflux.bash");
    fs::write(&script, &bash).unwrap();
    let read = Command::new("bash").arg("-n").arg(&script).output();
    assert!(read.is_ok_and(|read| read.status.success() && read.stderr.is_empty()));
    let missing = run(&["man", "no/such/folder"]);
    assert_eq!(missing.status.code(), Some(1));
    assert!(stderr(&missing).contains("no/such/folder"));
}

#[test]
fn a_missing_file_is_named() {
    for door in ["native", "auto"] {
        let result = run(&["info", "no/such/stage.usda", "--usd", door]);
        assert_eq!(result.status.code(), Some(1));
        assert!(
            stderr(&result).contains("no/such/stage.usda"),
            "{}",
            stderr(&result)
        );
    }
}

#[test]
fn nan_points_are_refused_by_name() {
    must_fail(
        &format!(
            "#usda 1.0\ndef Mesh \"m\" {{ point3f[] points = [(0,0,0),(1,0,0),(nan,1,0),(0,1,0)]\n{QUAD}int[] faceVertexIndices = [0,1,2,3] }}"
        ),
        &["/m", "2"],
    );
}

#[test]
fn indices_out_of_range_are_refused_with_the_range() {
    must_fail(
        &format!(
            "#usda 1.0\ndef Mesh \"m\" {{ point3f[] points = [(0,0,0),(1,0,0),(1,1,0),(0,1,0)]\n{QUAD}int[] faceVertexIndices = [0,1,2,9] }}"
        ),
        &["/m", "9", "4"],
    );
}

#[test]
fn an_empty_stage_is_refused() {
    must_fail("#usda 1.0\n", &["no visible surface"]);
}

#[test]
fn a_layer_that_is_no_usd_is_refused() {
    must_fail("PNG not usd", &["stage.usda"]);
}

#[test]
fn an_output_folder_that_does_not_exist_is_named() {
    let result = run(&[
        "points",
        ROOM,
        "-o",
        "no/such/folder/c.usdc",
        "--surfels",
        "1000",
        "--usd",
        "native",
    ]);
    assert_eq!(result.status.code(), Some(1));
    assert!(
        stderr(&result).contains("no/such/folder"),
        "{}",
        stderr(&result)
    );
}

#[test]
fn an_interrupt_ends_the_run_with_a_message_and_no_partial_file() {
    let folder = tempfile::tempdir().unwrap();
    let layer = folder.path().join("room.usdc");
    let mut child = surflux()
        .args([
            "bake",
            ROOM,
            "-o",
            layer.to_str().unwrap(),
            "--usd",
            "native",
            "--rays",
            "1048576",
        ])
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    std::thread::sleep(Duration::from_secs(3));
    let killed = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .expect("kill runs");
    assert!(killed.success());
    let mut ended = None;
    for _ in 0..300 {
        ended = child.try_wait().expect("waitable");
        if ended.is_some() {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    if ended.is_none() {
        child.kill().expect("killable");
    }
    let output = child.wait_with_output().expect("ended");
    assert_eq!(
        ended.and_then(|status| status.code()),
        Some(1),
        "{}",
        stderr(&output)
    );
    assert!(stderr(&output).contains("cancelled"), "{}", stderr(&output));
    assert_eq!(files(folder.path()), Vec::<String>::new());
}

#[test]
fn maps_and_rays_share_a_run_and_tell_who_did_what() {
    let folder = tempfile::tempdir().unwrap();
    let layer = folder.path().join("room.usdc");
    let output = layer.to_str().unwrap();
    let asked = "occlusion,bent_normal,error_occlusion,irradiance_indirect";
    let flags = "--usd native --gather maps --directions 64 --rays 64 --surfels 5000 --json";
    let mut args = vec!["bake", ROOM, "-o", output, "--aov", asked];
    args.extend(flags.split(' '));
    let report = json(&run(&args));
    let settings = &report["settings"];
    assert_eq!(settings["gather"], "maps");
    assert_eq!(settings["directions"], 64);
    assert_eq!(settings["engines"]["occlusion"], "maps");
    assert_eq!(settings["engines"]["bent_normal"], "maps");
    assert_eq!(settings["engines"]["error_occlusion"], "maps");
    assert_eq!(settings["engines"]["irradiance_indirect"], "rays");
    let share = settings["handed_over"]["share"].as_f64().unwrap();
    assert!((0.0..0.5).contains(&share), "{settings}");
    assert!(
        report["error"]["aovs"]["irradiance_indirect"]
            .as_f64()
            .is_some_and(|e| e < 0.5)
    );
}

#[test]
fn points_tell_reflected_light_and_rays_what_is_open() {
    let folder = tempfile::tempdir().unwrap();
    let layer = folder.path().join("room.usdc");
    let output = layer.to_str().unwrap();
    let asked = "occlusion,irradiance_direct,irradiance_indirect";
    let flags =
        "--usd native --gather raster --max-solid-angle 0.1 --rays 64 --surfels 20000 --json";
    let mut args = vec!["bake", ROOM, "-o", output, "--aov", asked];
    args.extend(flags.split(' '));
    let report = json(&run(&args));
    let settings = &report["settings"];
    assert_eq!(settings["gather"], "raster");
    assert_eq!(settings["engines"]["occlusion"], "rays");
    assert_eq!(settings["engines"]["irradiance_indirect"], "raster");
    // Judged by 1024 rays; the points of this small stage are far apart and many lie in corners.
    let error = &report["error"]["aovs"]["irradiance_indirect"];
    assert!(error.as_f64().is_some_and(|e| e < 0.1), "{report}");
    assert!(report["counts"]["nodes"].as_u64() > Some(0));
}

#[test]
fn points_of_another_cloud_are_not_rastered() {
    let flags = "--aov irradiance_indirect --gather raster --cloud cloud.usdc";
    let mut args = vec!["bake", ROOM, "-o", "x.usdc"];
    args.extend(flags.split(' '));
    let result = run(&args);
    assert_eq!(result.status.code(), Some(2));
    assert!(stderr(&result).contains("--cloud"), "{}", stderr(&result));
}

#[test]
fn a_tolerance_is_met_by_maps_and_rays_alike_and_covers_the_surfels() {
    let folder = tempfile::tempdir().unwrap();
    let layer = folder.path().join("room.usdc");
    let output = layer.to_str().unwrap();
    for (engine, aov) in [
        ("maps", "occlusion"),
        ("maps", "irradiance,occlusion"),
        ("auto", "irradiance_indirect"),
    ] {
        let flags = "--usd native --tolerance 0.05 --json";
        let mut args = vec!["bake", ROOM, "-o", output, "--aov", aov, "--gather", engine];
        args.extend(flags.split(' '));
        let report = json(&run(&args));
        let estimate = report["error"]["estimate"].as_f64().unwrap();
        let is_told = |warning: &serde_json::Value| warning["kind"] == "tolerance-missed";
        let told = report["warnings"].as_array().unwrap().iter().any(is_told);
        // Met, or said to be missed: never more than allowed in silence.
        assert_eq!(estimate > 0.05, told, "{report}");
        assert!(engine == "maps" || !told, "rays can always do it: {report}");
        // The reference saw no lights: what holds their light is not compared with it.
        let error = report["error"]["aovs"]["irradiance"].as_f64();
        assert!(error.is_none_or(|error| error <= 0.05), "{report}");
    }
    // Surfels are as fine as the tolerance asks for; those of few, asked for by name, are so wide that most hits are too
    // near to read them, and are lit anew.
    let error = |surfels: &[&str]| {
        let mut args = vec!["bake", ROOM, "-o", output, "--aov", "irradiance_indirect"];
        args.extend("--usd native --tolerance 0.02 --json".split(' '));
        args.extend(surfels);
        let report = json(&run(&args));
        let surfels = report["settings"]["surfel_error"].as_f64().unwrap();
        let estimate = report["error"]["estimate"].as_f64().unwrap();
        assert!((surfels..=0.02).contains(&estimate), "{report}");
        surfels
    };
    let (usual, few) = (error(&[]), error(&["--surfels", "300"]));
    // Whatever is in doubt about them, half of the tolerance is left to rays: √(1 − ½²).
    assert!(usual.max(few) <= 0.866 * 0.02, "{usual} {few}");
}

#[test]
fn the_papers_engine_is_not_asked_for_errors_that_it_cannot_tell() {
    let result = run(&[
        "bake",
        ROOM,
        "-o",
        "x.usdc",
        "--aov",
        "error_occlusion",
        "--gather",
        "paper",
    ]);
    assert_eq!(result.status.code(), Some(2));
    assert!(
        stderr(&result).contains("error_occlusion"),
        "{}",
        stderr(&result)
    );
}
