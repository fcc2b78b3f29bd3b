//! Composition and value resolution.

use super::*;
use surflux::stage::{Composition, Load};

#[test]
fn sublayers_with_offsets_scale_and_move_samples() {
    let root = r#"( subLayers = [ @strong.usda@ (offset = 10; scale = 2), @weak.usda@ ] )"#;
    let strong = "over \"a\" {
        double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 10: (5, 0.25, 0) }
    }";
    let weak = format!(
        "def Xform \"a\" {{
            double3 xformOp:translate = (9, 9, 9)
            uniform token[] xformOpOrder = [\"xformOp:translate\"]
            {}
        }}",
        mesh("m", 0.5)
    );
    let files = [
        ("root.usda", root),
        ("strong.usda", strong),
        ("weak.usda", &*weak),
    ];
    for time in [None, Some(0.0), Some(17.3), Some(40.0)] {
        equal_files(&files, time, 1);
    }
}

#[test]
fn references_payloads_inherits_specializes_and_variants() {
    let root = format!(
        r#"
class "_base" {{
    uniform token purpose = "render"
    color3f[] primvars:displayColor = [(1, 0, 0)]
}}
def "referenced" ( references = [@asset.usda@</Asset>, @asset.usda@ (offset = 3)] ) {{ }}
def "loaded" ( payload = @asset.usda@ ) {{ }}
def "child" ( references = @asset.usda@</Asset/inner> ) {{ }}
def Xform "heir" ( inherits = </_base> ) {{ {m} }}
def Xform "special" ( specializes = </_base> ) {{
    color3f[] primvars:displayColor = [(0, 1, 0)]
    {m}
}}
def "choice" (
    references = @asset.usda@
    variants = {{ string shape = "tall" }}
) {{ }}
def "none" ( references = @asset.usda@
    variants = {{ string shape = "missing" }} ) {{ }}
"#,
        m = mesh("m", 1.0)
    );
    let asset = format!(
        r#"( defaultPrim = "Asset" )
def Xform "Asset" (
    variants = {{ string shape = "short" }}
    prepend variantSets = "shape"
) {{
    def Xform "inner" {{ {} }}
    variantSet "shape" = {{
        "short" {{ {} }}
        "tall" {{ {} }}
    }}
}}"#,
        mesh("own", 0.1),
        mesh("short", 0.2),
        mesh("tall", 0.9)
    );
    let files = [("root.usda", &*root), ("asset.usda", &*asset)];
    // own and a variant for referenced, loaded, choice; own for none; child, heir, special
    equal_files(&files, None, 3 * 2 + 1 + 3);
}

#[test]
fn list_ops_of_references_and_deactivated_prims() {
    let root = "( subLayers = [@strong.usda@, @weak.usda@] )";
    let strong = "over \"a\" ( delete references = @b.usda@</B>
        append references = @b.usda@</C> ) { }
    over \"off\" ( active = false ) { }";
    let weak = format!(
        "def \"a\" ( prepend references = @b.usda@</B> ) {{ }}\n{}",
        mesh("off", 1.0)
    );
    let parts = format!(
        "def Xform \"B\" {{ {} }}\ndef Xform \"C\" {{ {} }}",
        mesh("b", 1.0),
        mesh("c", 2.0)
    );
    let files = [
        ("root.usda", root),
        ("strong.usda", strong),
        ("weak.usda", &*weak),
        ("b.usda", &*parts),
    ];
    equal_files(&files, None, 1);
}

#[test]
fn relocates_move_prims_of_references() {
    let root = "( relocates = { </r/inner/m>: </r/moved> } )
def \"r\" ( references = @asset.usda@</A> ) { }";
    let asset = format!(
        "def Xform \"A\" {{
            def Xform \"inner\" {{
                double3 xformOp:translate = (5, 0, 0)
                uniform token[] xformOpOrder = [\"xformOp:translate\"]
                {}
            }}
        }}",
        mesh("m", 1.0)
    );
    equal_files(&[("root.usda", root), ("asset.usda", &asset)], None, 1);
}

#[test]
fn value_clips_between_frames() {
    let root = format!(
        "( startTimeCode = 0
endTimeCode = 10 )
def Xform \"a\" ( clips = {{ dictionary default = {{
    asset[] assetPaths = [@c1.usda@, @c2.usda@]
    asset manifestAssetPath = @manifest.usda@
    string primPath = \"/a\"
    double2[] active = [(0, 0), (5, 1)]
    double2[] times = [(0, 0), (5, 5), (10, 10)]
}} }} ) {{
    double3 xformOp:translate
    uniform token[] xformOpOrder = [\"xformOp:translate\"]
    {}
}}",
        mesh("m", 1.0)
    );
    let manifest = "over \"a\" {
        double3 xformOp:translate
    }";
    let clip = |x: f32| {
        format!(
            "over \"a\" {{\ndouble3 xformOp:translate.timeSamples = {{ 0: (0, {x}, 0), 5: (1, {x}, 0), 10: (9, {x}, 0) }}\n}}"
        )
    };
    let (one, two) = (clip(1.0), clip(2.0));
    let files = [
        ("root.usda", &*root),
        ("manifest.usda", manifest),
        ("c1.usda", &*one),
        ("c2.usda", &*two),
    ];
    for time in [Some(2.5), Some(5.0), Some(7.25)] {
        equal_files(&files, time, 1);
    }
}

#[test]
fn held_samples_of_topology_and_blocked_values() {
    let text = "
def Xform \"a\" {
    token visibility.timeSamples = { 1: \"inherited\", 3: \"invisible\", 4: \"inherited\" }
    float xformOp:rotateX.timeSamples = { 1: 0, 2: None, 3: 90 }
    uniform token[] xformOpOrder = [\"xformOp:rotateX\"]
    def Mesh \"m\" {
        uniform token subdivisionScheme = \"none\"
        int[] faceVertexCounts.timeSamples = { 1: [3], 2: [4] }
        int[] faceVertexIndices.timeSamples = { 1: [0, 1, 2], 2: [0, 1, 2, 3] }
        point3f[] points.timeSamples = { 1: [(0, 0, 0), (1, 0, 0), (1, 1, 0)], 2: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 3: [(0, 0, 0), (2, 0, 0), (2, 2, 1), (0, 2, 0)] }
    }
}";
    for (time, prims) in [(0.5, 1), (1.5, 1), (2.5, 1), (3.5, 0), (9.0, 1)] {
        equal(text, Some(time), prims);
    }
}

/// A reading by `composition`, at the default time.
fn composed(composition: Composition) -> Reading {
    Reading {
        composition,
        ..Reading::default()
    }
}

/// Both doors read `files` as `composition` of their folder says.
#[track_caller]
fn composed_alike(files: &[File], composition: impl Fn(&Path) -> Composition) -> [Outcome; 2] {
    outcomes_of(files, |folder| composed(composition(folder)))
}

fn payload_files() -> [(&'static str, String); 2] {
    let root = format!(
        "def Xform \"W\" {{
    def \"heavy\" ( payload = @asset.usda@ ) {{ {} }}
    def \"ref\" ( references = @asset.usda@</B> ) {{ }}
    {}
}}",
        mesh("inside", 3.0),
        mesh("light", 1.0)
    );
    let asset = format!(
        "( defaultPrim = \"A\" )
def Xform \"A\" {{ {} }}
def Xform \"B\" {{ {}
    def \"nested\" ( payload = </A> ) {{ }}
}}",
        mesh("a", 0.5),
        mesh("b", 2.0)
    );
    [("root.usda", root), ("asset.usda", asset)]
}

#[test]
fn payloads_are_loaded_all_or_none() {
    let [root, asset] = payload_files();
    let files = [(root.0, &*root.1), (asset.0, &*asset.1)];
    for (load, prims) in [(Load::All, 5), (Load::None, 2)] {
        let found = composed_alike(&files, |_| Composition {
            load,
            ..Composition::default()
        });
        assert_eq!(found, [Outcome::Equal(prims), Outcome::Equal(prims)]);
    }
}

#[test]
fn unloaded_payloads_are_told_once() {
    let [root, asset] = payload_files();
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in [root, asset] {
        fs::write(folder.path().join(name), format!("#usda 1.0\n{text}")).expect("written");
    }
    let reading = composed(Composition {
        load: Load::None,
        ..Composition::default()
    });
    for door in [Door::UsdCore, Door::Native] {
        let read = crate::scene_of(&folder.path().join("root.usda"), door, &reading);
        let (_, warnings) = read.expect("the rest is read");
        let told = warnings
            .iter()
            .filter(|warning| warning.kind == "unloaded-payload");
        let told: Vec<_> = told.collect();
        assert_eq!(told.len(), 1, "{door:?}: {warnings:?}");
        assert_eq!(told[0].prim, "/W/heavy");
        assert!(told[0].message.contains("2 prims"), "{}", told[0].message);
    }
}

const CAR: &str = r#"( defaultPrim = "Car" )
def Xform "Car" (
    variants = { string shape = "short" string paint = "red" }
    prepend variantSets = ["shape", "paint"]
) {
    variantSet "shape" = {
        "short" { MESH1 }
        "tall" ( prepend variantSets = "hat" variants = { string hat = "no" } ) {
            MESH2
            variantSet "hat" = {
                "no" { }
                "yes" { MESH3 }
            }
        }
    }
    variantSet "paint" = {
        "red" { color3f[] primvars:displayColor = [(1, 0, 0)]
        }
        "blue" { color3f[] primvars:displayColor = [(0, 0, 1)]
        }
    }
}"#;

fn car_files() -> [(&'static str, String); 2] {
    let car = (CAR.replace("MESH1", &mesh("m", 1.0)))
        .replace("MESH2", &mesh("m", 2.0))
        .replace("MESH3", &mesh("hat", 3.0))
        .replace(" string ", "\n string ")
        .replace("\" }", "\"\n }")
        .replace("hat\" variants", "hat\"\n variants");
    let root = "def Xform \"W\" {
    def \"a\" ( references = @car.usda@ ) { }
    def \"b\" ( references = @car.usda@ ) { }
    def \"i\" ( references = @car.usda@
        instanceable = true ) { }
}";
    [("root.usda", root.to_owned()), ("car.usda", car)]
}

fn choices(all: &[&str]) -> Composition {
    let parsed = all
        .iter()
        .map(|choice| choice.parse().expect("well formed"));
    Composition {
        variants: parsed.collect(),
        ..Composition::default()
    }
}

#[test]
fn chosen_variants_are_opinions_of_the_session() {
    let [root, car] = car_files();
    let files = [(root.0, &*root.1), (car.0, &*car.1)];
    let cases: [(&[&str], usize); 5] = [
        (&["/W/a{shape=tall}"], 3),
        (
            &["/W/a{shape=tall}", "/W/a{hat=yes}", "/W/a{paint=blue}"],
            4,
        ),
        (&["/W/b{shape=tall}", "/W/b{shape=short}"], 3),
        (&["/W/i{shape=tall}", "/W/i{hat=yes}"], 4),
        (&["/W/gone{shape=tall}"], 3),
    ];
    for (all, prims) in cases {
        let found = composed_alike(&files, |_| choices(all));
        assert_eq!(
            found,
            [Outcome::Equal(prims), Outcome::Equal(prims)],
            "{all:?}"
        );
    }
}

#[test]
fn variants_that_do_not_exist_are_refused_with_those_that_do() {
    let [root, car] = car_files();
    let files = [(root.0, &*root.1), (car.0, &*car.1)];
    for (choice, known) in [
        ("/W/a{shape=big}", "it has: short, tall"),
        ("/W/a{model=x}", "it has: paint, shape"),
        ("/W/i/m{shape=tall}", "it has: none"),
    ] {
        for found in composed_alike(&files, |_| choices(&[choice])) {
            let Outcome::Refused(message) = found else {
                panic!("{choice}: {found:?}");
            };
            assert!(
                message.contains(choice) && message.contains(known),
                "{message}"
            );
        }
    }
}

#[test]
fn session_layers_are_stronger_than_the_stage_and_weaker_than_choices() {
    let [root, car] = car_files();
    let session = r#"( startTimeCode = 1
    subLayers = [@./more.usda@] )
over "W" {
    over "a" ( variants = {
        string shape = "tall"
        string paint = "blue"
    } ) { }
    over "b" ( active = false ) { }
}"#;
    let more = format!("def Xform \"X\" {{ {} }}", mesh("m", 7.0));
    let files = [
        (root.0, &*root.1),
        (car.0, &*car.1),
        ("session.usda", session),
        ("more.usda", &more),
    ];
    for (all, prims) in [
        (&[][..], 3),
        (&["/W/a{hat=yes}"][..], 4),
        (&["/W/a{shape=short}"], 3),
    ] {
        let found = composed_alike(&files, |folder| Composition {
            session_layer: Some(folder.join("session.usda")),
            ..choices(all)
        });
        assert_eq!(
            found,
            [Outcome::Equal(prims), Outcome::Equal(prims)],
            "{all:?}"
        );
    }
    for found in composed_alike(&files, |folder| Composition {
        session_layer: Some(folder.join("none.usda")),
        ..Composition::default()
    }) {
        assert!(
            matches!(&found, Outcome::Refused(message) if message.contains("none.usda")),
            "{found:?}"
        );
    }
}

#[test]
fn muted_layers_are_left_out_wherever_they_are_used() {
    let root = "( subLayers = [@./strong.usda@, @weak.usda@] )
def \"r\" ( references = @asset.usda@</A> ) { }";
    let strong = "over \"w\" ( active = false ) { }";
    let weak = mesh("w", 1.0);
    let asset = format!(
        "( subLayers = [@asset_more.usda@] )\ndef Xform \"A\" {{ {} }}",
        mesh("a", 2.0)
    );
    let more = format!("over \"A\" {{ {} }}", mesh("more", 3.0));
    let files = [
        ("root.usda", root),
        ("strong.usda", strong),
        ("weak.usda", &weak),
        ("asset.usda", &*asset),
        ("asset_more.usda", &*more),
    ];
    let cases: [(&[&str], usize); 5] = [
        (&[], 2),
        (&["strong.usda"], 3),
        (&["./weak.usda", "strong.usda"], 2),
        (&["asset_more.usda"], 1),
        (&["asset.usda"], 0),
    ];
    for (muted, prims) in cases {
        let found = composed_alike(&files, |_| Composition {
            muted_layers: muted.iter().map(|&layer| layer.to_owned()).collect(),
            ..Composition::default()
        });
        assert_eq!(
            found,
            [Outcome::Equal(prims), Outcome::Equal(prims)],
            "{muted:?}"
        );
    }
    for wrong in ["gone.usda", "root.usda"] {
        for found in composed_alike(&files, |_| Composition {
            muted_layers: vec![wrong.to_owned()],
            ..Composition::default()
        }) {
            assert!(matches!(&found, Outcome::Refused(_)), "{wrong}: {found:?}");
        }
    }
}

#[test]
fn muted_layers_may_be_broken() {
    let root = format!("( subLayers = [@broken.usda@] )\n{}", mesh("m", 1.0));
    let files = [("root.usda", &*root), ("broken.usda", "def def def")];
    let found = composed_alike(&files, |folder| Composition {
        muted_layers: vec![folder.join("broken.usda").to_string_lossy().into_owned()],
        ..Composition::default()
    });
    assert_eq!(found, [Outcome::Equal(1), Outcome::Equal(1)]);
}

/// A stage that has no session layer of its own is composed with an empty one, of which nobody needs to hear.
#[test]
fn missing_layers_are_told_with_names_that_the_user_knows() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let root = folder.path().join("root.usda");
    let text = "#usda 1.0\ndef \"a\" ( references = @./gone.usda@ ) { }\n";
    fs::write(&root, format!("{text}{}", mesh("m", 1.0))).expect("written");
    let (_, warnings) =
        crate::scene_of(&root, Door::Native, &Reading::default()).expect("it is read");
    let told = warnings
        .iter()
        .find(|warning| warning.kind == "missing-layer");
    let told = &told.expect("a warning").message;
    assert!(
        told.contains("gone.usda") && told.contains("root.usda"),
        "{told}"
    );
    assert!(!told.contains("surflux:"), "{told}");
}
