//! What every command does alike: examples in `--help` that parse, messages as JSON, statistics as their schemas say, and
//! who made each output, read back by other programs.

use crate::program::{ROOM, json, run, stderr, surflux};
use crate::python::run_python;
use serde_json::Value;
use std::fs;
use std::path::Path;

/// A sheet in the dark.
const SHEET: &str = r#"def Mesh "sheet" {
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)]
    uniform token subdivisionScheme = "none"
}
"#;

const COMMANDS: [&str; 11] = [
    "points",
    "bake",
    "render",
    "info",
    "validate",
    "verify",
    "view",
    "convert",
    "run",
    "completions",
    "man",
];

/// The words of a line as a shell has them: quotes kept together, redirections left out.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quoted) = (Vec::new(), String::new(), false);
    for letter in line.chars() {
        match letter {
            '\'' => quoted = !quoted,
            ' ' if !quoted => words.push(std::mem::take(&mut word)),
            letter => word.push(letter),
        }
    }
    words.push(word);
    let end = words.iter().position(|word| word == ">");
    words.truncate(end.unwrap_or(words.len()));
    words.retain(|word| !word.is_empty());
    words
}

/// Lines of examples in what `surflux COMMAND --help` prints.
fn examples(help: &str) -> Vec<String> {
    let (_, after) = help.split_once("Example:").expect("an example");
    let mut lines: Vec<String> = Vec::new();
    for line in after.lines().map(str::trim) {
        match line.starts_with("surflux ") {
            true => lines.push(line.to_owned()),
            // what does not fit goes on in the next line
            false if line.starts_with("--") || line.ends_with("--dry-run") => {
                if let Some(last) = lines.last_mut() {
                    *last += " ";
                    *last += line;
                }
            }
            false => {}
        }
    }
    lines
}

#[test]
fn the_examples_of_help_parse() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for command in COMMANDS {
        let help = run(&[command, "--help"]);
        let help = String::from_utf8(help.stdout).expect("UTF-8");
        let examples = examples(&help);
        assert!(!examples.is_empty(), "{command}");
        for example in examples {
            let mut words = words(&example);
            assert_eq!(words[1], command, "{example}");
            if !matches!(command, "completions" | "man") {
                // settings are told where everything is parsed, whether the files are there or not
                words.extend([
                    "--print-config".to_owned(),
                    "--usd".to_owned(),
                    "native".to_owned(),
                ]);
                if command == "run" {
                    words.truncate(words.len() - 2);
                }
                if matches!(command, "points" | "bake" | "render") {
                    words.extend(["--settings".to_owned(), "none".to_owned()]);
                }
            } else if command == "man" {
                words[2] = folder.path().to_string_lossy().into_owned();
            }
            let output = surflux()
                .args(&words[1..])
                .output()
                .expect("the program starts");
            assert!(output.status.success(), "{example}: {}", stderr(&output));
        }
    }
    let whole = String::from_utf8(run(&["--help"]).stdout).expect("UTF-8");
    assert!(whole.contains("Example:"), "{whole}");
}

/// Checks files against schemas, given in pairs.
const CHECK: &str = "
import sys, json, jsonschema
for schema, name in zip(sys.argv[1::2], sys.argv[2::2]):
    schema = json.load(open(schema))
    jsonschema.Draft202012Validator.check_schema(schema)
    for line in ([open(name).read()] if not name.endswith('.log') else open(name)):
        jsonschema.validate(json.loads(line), schema)
";

fn schema(name: &str) -> String {
    format!("{}/schemas/{name}.schema.json", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn what_verify_run_info_and_validate_tell_is_as_their_schemas_say() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    fs::write(
        at("r.json"),
        r#"{"steps": [{"name": "cloud", "command": "points", "outputs": ["c.usda"],
            "arguments": ["s.usda", "-o", "c.usda", "--surfels", "90", "--dome", "1", "--usd", "native"]},
            {"name": "wrong", "command": "bake", "arguments": ["gone.usda", "-o", "b.usda"], "outputs": ["b.usda"]}]}"#,
    )
    .expect("writable");
    let sheet = format!("#usda 1.0\n(upAxis = \"Y\")\n{SHEET}");
    fs::write(at("s.usda"), sheet).expect("writable");
    let stage = at("s.usda");
    let commands: [(&str, Vec<&str>); 4] = [
        ("run", vec!["r.json"]),
        ("info", vec![&stage, "--usd", "native"]),
        ("validate", vec!["c.usda", "--usd", "native"]),
        (
            "verify",
            vec![
                &stage,
                "--usd",
                "native",
                "--aov",
                "visibility",
                "--sets",
                "points",
                "--receivers",
                "16",
                "--truth-rays",
                "256",
                "--tolerance",
                "0.2",
                "--surfels",
                "200",
                "--only-auto",
            ],
        ),
    ];
    let mut checked: Vec<String> = Vec::new();
    for (command, args) in commands {
        let mut program = surflux();
        program
            .current_dir(folder.path())
            .args([command, "--json"])
            .args(&args);
        let output = program.output().expect("the program starts");
        let told: Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|_| panic!("{command}: {}", stderr(&output)));
        assert_eq!(told["surflux"], env!("CARGO_PKG_VERSION"), "{command}");
        assert_eq!(told["command"][1], command);
        let file = at(&format!("{command}.json"));
        fs::write(&file, &output.stdout).expect("writable");
        checked.extend([schema(command), file]);
    }
    run_python(CHECK, &checked);
}

#[test]
fn messages_are_json_lines_on_stderr_and_in_the_log() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let stage = at("s.usda");
    // a unit that is none, and nothing that shines
    let text = format!("#usda 1.0\n(upAxis = \"Y\"\n metersPerUnit = -1)\n{SHEET}");
    fs::write(&stage, text).expect("writable");
    let (out, log) = (at("b.usda"), at("l.log"));
    let args = [
        "bake",
        &stage,
        "-o",
        &out,
        "--aov",
        "irradiance",
        "--rays",
        "16",
        "--usd",
        "native",
        "--log-json",
        "--log-file",
        &log,
    ];
    let output = run(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    let lines = |text: &str| -> Vec<Value> {
        let lines = text.lines();
        lines
            .map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("{line}")))
            .collect()
    };
    let told = lines(&stderr(&output));
    let warning = |kind: &str| {
        told.iter()
            .any(|line| line["kind"] == kind && line["level"] == "warn")
    };
    assert!(warning("no-light") && warning("invalid-units"), "{told:?}");
    let kept = lines(&fs::read_to_string(&log).expect("a log"));
    assert!(
        told.iter()
            .all(|line| kept.iter().any(|other| other["message"] == line["message"]))
    );
    run_python(CHECK, &[schema("log"), log]);

    let failed = run(&[
        "bake",
        "gone.usda",
        "-o",
        &out,
        "--usd",
        "native",
        "--log-json",
    ]);
    assert_eq!(failed.status.code(), Some(1));
    let told = lines(&stderr(&failed));
    assert_eq!(told.len(), 1);
    assert_eq!(told[0]["level"], "error");
    let usage = run(&["bake", ROOM, "--log-json"]);
    assert_eq!(usage.status.code(), Some(2));
    assert_eq!(lines(&stderr(&usage))[0]["level"], "error");
}

#[test]
fn the_log_of_a_run_has_its_warnings_and_its_error() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let (out, log) = (at("b.usda"), at("l.log"));
    let failed = run(&[
        "bake",
        "gone.usda",
        "-o",
        &out,
        "--usd",
        "native",
        "--log-file",
        &log,
    ]);
    assert_eq!(failed.status.code(), Some(1));
    assert!(
        fs::read_to_string(&log)
            .expect("a log")
            .contains("gone.usda")
    );
}

/// What programs that know each format find of who made it.
const MADE: &str = r"
import sys, os, json, struct
import OpenEXR, OpenImageIO as oiio
from pxr import Usd, Sdf
folder = sys.argv[1]
def png(path):
    spec = oiio.ImageInput.open(path).spec()
    return str(spec.get_string_attribute('Software')) + ' ' + str(spec.get_string_attribute('ImageDescription')) + ' ' + ' '.join(str(a.value) for a in spec.extra_attribs)
def glb(path):
    data = open(path, 'rb').read()
    size = struct.unpack('<I', data[12:16])[0]
    return json.dumps(json.loads(data[20:20 + size])['asset'])
def ply(path):
    return open(path, 'rb').read(4000).split(b'end_header')[0].decode()
def exr(path):
    return ' '.join(str(value) for value in OpenEXR.File(path).header().values())
def usd(path):
    return str(Sdf.Layer.FindOrOpen(path).customLayerData)
def text(path):
    return open(path, encoding='utf-8').read()
read = {'.png': png, '.glb': glb, '.ply': ply, '.exr': exr, '.usdc': usd, '.usda': usd, '.html': text}
for name in sorted(os.listdir(folder)):
    ending = os.path.splitext(name)[1]
    told = read[ending](os.path.join(folder, name))
    command = {'i.png': 'render', 'i_thumbnail.png': 'render'}.get(name)
    assert 'surflux' in told and sys.argv[2] in told, (name, told[:2000])
    assert 'out-of-words' in told, (name, told[:2000])
print(len(os.listdir(folder)))
";

#[test]
fn every_output_says_which_command_of_which_version_made_it() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let work = |args: &[&str]| {
        // a word that only the command line has
        let output = run(&[args, &["--variant", "/out{of=out-of-words}"]].concat());
        assert!(output.status.success(), "{args:?}: {}", stderr(&output));
    };
    for line in [
        "points ROOM -o c.usdc",
        "bake ROOM -o b.usdc --aov occlusion --rays 16",
        "render ROOM -o i.exr --aov occlusion --rays 16 --image-width 16 --preview --thumbnail --report r.html",
    ] {
        let word = |word: &str| match word {
            "ROOM" => ROOM.to_owned(),
            file if file.contains('.') => at(file),
            other => other.to_owned(),
        };
        let words: Vec<String> = line.split(' ').map(word).collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        work(&[&words[..], &["--usd", "native", "--surfels", "300"]].concat());
    }
    let cloud = at("c.usdc");
    let baked = at("b_baked.usda");
    for (command, from, to) in [
        ("view", &cloud, "v.png"),
        ("view", &cloud, "v.html"),
        ("convert", &cloud, "c.ply"),
        ("convert", &baked, "b.glb"),
    ] {
        let to = at(to);
        match command {
            "view" => work(&["view", from, "-o", &to, "--usd", "native"]),
            _ => work(&[command, from, &to, "--usd", "native"]),
        }
    }
    let found = run_python(
        MADE,
        &[
            folder.path().to_str().expect("UTF-8"),
            env!("CARGO_PKG_VERSION"),
        ],
    );
    assert_eq!(found.trim(), "11");
}

#[test]
fn what_is_printed_as_configuration_is_json_for_every_command() {
    for command in ["info", "validate", "view"] {
        let told = json(&run(&[command, ROOM, "--print-config"]));
        assert!(told[command]["usd"]["value"].is_string(), "{command}");
    }
    assert!(Path::new(ROOM).exists());
}
