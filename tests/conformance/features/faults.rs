//! What the `openusd` crate reads wrongly or not at all: solved by the native door, or refused with the layer's name and
//! the way out. What is refused here is read by usd-core.

use super::*;

/// usd-core reads `prims` things; the native door refuses, naming `layer` and the other door.
#[track_caller]
fn refused(files: &[File], time: Option<f64>, (prims, layer): (usize, &str)) {
    let [core, native] = outcomes(files, time);
    assert_eq!(core, Outcome::Equal(prims));
    assert_names(&native, layer);
}

#[track_caller]
fn assert_names(outcome: &Outcome, layer: &str) {
    let Outcome::Refused(message) = outcome else {
        panic!("not refused: {outcome:?}");
    };
    let is_told = message.contains(layer) && message.contains("--usd usd-core");
    assert!(is_told, "{message}");
}

#[test]
fn numbers_without_digits_before_or_after_the_point() {
    let root = "( metersPerUnit = .01 )
def \"a\" ( references = @part.usda@</P> ) { }";
    let part = "def Mesh \"P\" {
    uniform token subdivisionScheme = \"none\"
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(.5, 0., -.25), (1., .125, 0), (0, 1.e0, -.5)]
    double3 xformOp:translate.timeSamples = { .5: (.5, 1., 2), 1.: (1., .5, 0.)
    }
    uniform token[] xformOpOrder = [\"xformOp:translate\"]
}";
    equal_files(&[("root.usda", root), ("part.usda", part)], Some(0.75), 1);
}

#[test]
fn quoted_assets_comments_and_capital_booleans() {
    let text = format!(
        "def \"off\" ( active = False ) {{ {} }}
// a comment
def DomeLight \"d\" {{ asset inputs:texture:file = \"./sky.hdr\" /* inside */
    bool inputs:normalize = True
}}
{}",
        mesh("m", 1.0),
        mesh("n", 2.0)
    );
    equal_files(
        &[("root.usda", &*text), ("sky.hdr", "not opened here")],
        None,
        2,
    );
}

#[test]
fn several_statements_for_one_relationship() {
    let part = format!(
        "def Material \"a\" {{ }}
def Material \"b\" {{ }}
def Xform \"P\" ( apiSchemas = [\"MaterialBindingAPI\"] ) {{
    prepend rel material:binding = </a>
    delete rel material:binding = </b>
    {}
}}",
        mesh("m", 1.0)
    );
    let root = "( subLayers = [@part.usda@] )";
    refused(
        &[("root.usda", root), ("part.usda", &*part)],
        None,
        (1, "part.usda"),
    );
}

#[test]
fn several_sets_of_value_clips() {
    let set = |name: &str, file: &str| {
        format!(
            "dictionary {name} = {{
        asset[] assetPaths = [@{file}@]
        asset manifestAssetPath = @manifest.usda@
        string primPath = \"/a\"
        double2[] active = [(0, 0)]
        double2[] times = [(0, 0), (10, 10)]
    }}\n"
        )
    };
    let root = format!(
        "def Xform \"a\" ( clips = {{
    {}    {}}}
    clipSets = [\"two\", \"one\"] ) {{
    double3 xformOp:translate
    uniform token[] xformOpOrder = [\"xformOp:translate\"]
    {}
}}",
        set("one", "c1.usda"),
        set("two", "c2.usda"),
        mesh("m", 1.0)
    );
    let clip = |x: u8| {
        format!(
            "over \"a\" {{\ndouble3 xformOp:translate.timeSamples = {{ 0: (0, {x}, 0), 10: (9, {x}, 0) }}\n}}"
        )
    };
    let (one, two) = (clip(1), clip(2));
    let files = [
        ("root.usda", &*root),
        (
            "manifest.usda",
            "over \"a\" {\n double3 xformOp:translate\n}",
        ),
        ("c1.usda", &*one),
        ("c2.usda", &*two),
    ];
    refused(&files, Some(2.5), (1, "root.usda"));
}

#[test]
fn quaternions_of_half_precision_between_samples() {
    let text = format!(
        "def PointInstancer \"i\" {{
    int[] protoIndices = [0]
    point3f[] positions = [(1, 2, 3)]
    quath[] orientations.timeSamples = {{ 0: [(1, 0, 0, 0)], 10: [(0.5, 0.5, 0.5, 0.5)]
    }}
    rel prototypes = </i/p>
    def Xform \"p\" {{ {} }}
}}",
        mesh("m", 1.0)
    );
    equal(&text, Some(3.7), 1);
}

#[test]
fn frames_by_their_old_names() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("root.usda");
    let text = format!(
        "#usda 1.0\n( startFrame = 3\nendFrame = 12 )\n{}",
        mesh("m", 1.0)
    );
    fs::write(&path, text).expect("written");
    for door in [Door::UsdCore, Door::Native] {
        let scene = crate::scene_of(&path, door, &Reading::default())
            .expect("read")
            .0;
        assert_eq!(scene.stage.time_range, Some((3.0, 12.0)), "{door:?}");
    }
}

/// Makes the package `sys.argv[1]` of the files that follow, each under its name below the working folder.
const ZIP: &str = "
import os, sys
from pxr import Sdf
os.chdir(os.path.dirname(sys.argv[1]))
with Sdf.ZipFileWriter.CreateNew(sys.argv[1]) as package:
    for name in sys.argv[2:]:
        package.AddFile(name, name)
";

#[track_caller]
fn package(files: &[File], packages: &[(&str, &[&str])]) -> [Outcome; 2] {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("in the folder")).expect("made");
        fs::write(path, format!("#usda 1.0\n{text}")).expect("written");
    }
    for (name, inside) in packages {
        let path = folder.path().join(name);
        let mut args = vec![path.to_string_lossy().into_owned()];
        args.extend(inside.iter().map(|&name| name.to_owned()));
        crate::python::run_python(ZIP, &args);
    }
    let root = folder.path().join(packages[packages.len() - 1].0);
    let mut evaluator = Evaluator::start();
    [Door::UsdCore, Door::Native].map(|door| {
        match judge(&mut evaluator, &root, door, &Reading::default()) {
            Err(refusal) => Outcome::Refused(refusal),
            Ok(tally) => {
                assert!(
                    tally.differences.is_empty(),
                    "{door:?}: {:?}",
                    tally.differences
                );
                Outcome::Equal(tally.prims)
            }
        }
    })
}

#[test]
fn search_paths_inside_packages() {
    let root = "( defaultPrim = \"A\" )\ndef \"A\" ( references = @lib/part.usda@ ) { }";
    let part = "( defaultPrim = \"P\" )\ndef \"P\" ( references = @lib/other.usda@ ) { }";
    let other = format!(
        "( defaultPrim = \"O\" )\ndef Xform \"O\" {{ {} }}",
        mesh("m", 1.0)
    );
    let files = [
        ("root.usda", root),
        ("lib/part.usda", part),
        ("lib/other.usda", &*other),
    ];
    let names = ["root.usda", "lib/part.usda", "lib/other.usda"];
    let found = package(&files, &[("out.usdz", &names)]);
    assert_eq!(found, [Outcome::Equal(1), Outcome::Equal(1)]);
}

#[test]
fn packages_that_start_with_a_package() {
    let inner = format!("( defaultPrim = \"A\" )\n{}", mesh("A", 1.0));
    let files = [("inner.usda", &*inner)];
    let packages: [(&str, &[&str]); 2] = [
        ("inner.usdz", &["inner.usda"]),
        ("outer.usdz", &["inner.usdz"]),
    ];
    let [core, native] = package(&files, &packages);
    assert_eq!(core, Outcome::Equal(1));
    if native != core {
        assert_names(&native, "outer.usdz");
    }
}

#[test]
fn integers_with_a_point_and_configured_attributes() {
    for statement in ["int a = 5.0", "config token a"] {
        let part = format!("def Xform \"P\" {{\n{statement}\n{} }}", mesh("m", 1.0));
        let root = "( subLayers = [@part.usda@] )";
        let [core, native] = outcomes(&[("root.usda", root), ("part.usda", &*part)], None);
        assert_eq!(core, Outcome::Equal(1), "{statement}");
        if native != core {
            assert_names(&native, "part.usda");
        }
    }
}
