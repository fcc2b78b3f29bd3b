//! Small stages, one for each feature of composition and of the schemas that the shared assets lack, through both doors.

use crate::judge;
use crate::truth::Evaluator;
use std::fs;
use surflux::stage::Door;

/// A file of a stage: name and text; the first is the root.
type File<'a> = (&'a str, &'a str);

/// What a door makes of a feature.
#[derive(Debug, PartialEq, Eq)]
enum Outcome {
    /// All values equal; how many drawables, lights, cameras and settings were compared.
    Equal(usize),
    /// Some are not, and a warning of these kinds names the prims.
    Unsupported(Vec<String>),
    /// The door's message.
    Refused(String),
}

/// How both doors, usd-core's first, read `files` at `time`. Panics at silent differences.
#[track_caller]
fn outcomes(files: &[File], time: Option<f64>) -> [Outcome; 2] {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, text) in files {
        let is_layer = name.ends_with(".usda");
        let text = if is_layer {
            format!("#usda 1.0\n{text}")
        } else {
            (*text).to_owned()
        };
        fs::write(folder.path().join(name), text).expect("written");
    }
    let root = folder.path().join(files[0].0);
    let mut evaluator = Evaluator::start();
    [Door::UsdCore, Door::Native].map(|door| match judge(&mut evaluator, &root, door, time) {
        Err(refusal) => Outcome::Refused(refusal),
        Ok(tally) => {
            let silent = tally.differences;
            assert!(
                silent.is_empty(),
                "{door:?} at {time:?}:\n{}",
                silent.join("\n")
            );
            let mut kinds: Vec<String> = tally.reasons.into_keys().collect();
            kinds.sort();
            match kinds.is_empty() {
                true => Outcome::Equal(tally.prims),
                false => Outcome::Unsupported(kinds),
            }
        }
    })
}

/// Both doors read `text` without a difference, with `prims` things compared.
#[track_caller]
fn equal(text: &str, time: Option<f64>, prims: usize) {
    equal_files(&[("root.usda", text)], time, prims);
}

#[track_caller]
fn equal_files(files: &[File], time: Option<f64>, prims: usize) {
    assert_eq!(
        outcomes(files, time),
        [Outcome::Equal(prims), Outcome::Equal(prims)]
    );
}

/// Both doors name what they leave out of `text` by warnings of `kind`.
#[track_caller]
fn unsupported(text: &str, kind: &str) {
    for outcome in outcomes(&[("root.usda", text)], None) {
        assert_eq!(outcome, Outcome::Unsupported(vec![kind.to_owned()]));
    }
}

/// A mesh's body; its points can be told from those of other meshes by `height`.
fn quad(height: f32) -> String {
    format!(
        "int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = \"none\"
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, {height}), (0, 1, 0)]\n"
    )
}

fn mesh(name: &str, height: f32) -> String {
    format!("def Mesh \"{name}\" {{\n {} }}\n", quad(height))
}

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

#[test]
fn instancers_nested_masked_and_moving() {
    let text = format!(
        r#"
( timeCodesPerSecond = 24 )
def PointInstancer "outer" ( inactiveIds = [21] ) {{
    int[] protoIndices = [0, 1, 0, 1]
    int64[] ids = [20, 21, 22, 23]
    int64[] invisibleIds = [22]
    point3f[] positions = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0.5, 0)]
    vector3f[] velocities = [(24, 0, 0), (0, 24, 0), (0, 0, 24), (1, 1, 1)]
    rel prototypes = [</outer/P/a>, </outer/P/inner>]
    double3 xformOp:translate = (0, 0, 7)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Scope "P" {{
        token visibility = "invisible"
        {mesh}
        def PointInstancer "inner" {{
            int[] protoIndices = [0, 0]
            point3f[] positions = [(0, 1, 0), (0, 2, 0)]
            float3[] scales = [(1, 2, 3), (-1, 1, 1)]
            rel prototypes = </outer/P/inner/b>
            def Xform "b" {{
                double xformOp:rotateZ = 30
                uniform token[] xformOpOrder = ["xformOp:rotateZ"]
                {mesh2}
            }}
        }}
    }}
}}"#,
        mesh = mesh("a", 1.0),
        mesh2 = mesh("m", 2.0)
    );
    // points 20 and 23, the latter with two of its own
    equal(&text, None, 3);
}

#[test]
fn transform_ops_with_inverses_and_resets() {
    let text = format!(
        r#"
( upAxis = "Z"
metersPerUnit = 1 )
def Xform "a" {{
    double3 xformOp:translate = (1, 2, 3)
    double3 xformOp:translate:pivot = (0.5, 0.5, 0.5)
    float3 xformOp:rotateZXY = (10, 20, 30)
    float3 xformOp:scale = (1, -2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:translate:pivot", "xformOp:rotateZXY", "xformOp:scale", "!invert!xformOp:translate:pivot"]
    {m}
    def Xform "b" {{
        quatf xformOp:orient = (0.5, 0.5, 0.5, 0.5)
        matrix4d xformOp:transform = ( (1, 0, 0, 0), (0, 2, 0, 0), (0, 0.5, 1, 0), (7, 8, 9, 1) )
        uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:transform", "!invert!xformOp:orient"]
        {m}
    }}
}}"#,
        m = mesh("m", 1.0)
    );
    equal(&text, None, 2);
}

#[test]
fn meshes_of_every_scheme_and_primvars_of_every_interpolation() {
    let grid = "int[] faceVertexCounts = [4, 4, 4, 4]
        int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 4, 3, 4, 7, 6, 4, 5, 8, 7]
        point3f[] points = [(0, 0, 0), (1, 0, 0.5), (2, 0, 0), (0, 1, 0), (1, 1, 1), (2, 1, 0), (0, 2, 0), (1, 2, 0), (2, 2, 3)]";
    let text = format!(
        r#"
def Xform "top" {{
    color3f[] primvars:displayColor = [(0.5, 0.25, 1)]
    def Mesh "smooth" {{
        {grid}
    }}
    def Mesh "creased" {{
        {grid}
        int[] creaseIndices = [3, 4, 5]
        int[] creaseLengths = [3]
        float[] creaseSharpnesses = [2]
        int[] cornerIndices = [8]
        float[] cornerSharpnesses = [10]
        int[] holeIndices = [3]
    }}
    def Mesh "bilinear" {{
        {grid}
        uniform token subdivisionScheme = "bilinear"
    }}
    def Mesh "left" {{
        {grid}
        uniform token subdivisionScheme = "none"
        uniform token orientation = "leftHanded"
        bool doubleSided = 1
        color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)] ( interpolation = "uniform" )
        float[] primvars:displayOpacity = [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8] ( interpolation = "vertex" )
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1), (1, 1)] ( interpolation = "faceVarying" )
        int[] primvars:st:indices = [0, 1, 3, 2, 2, 0, 1, 3, 0, 1, 3, 2, 3, 2, 0, 1]
    }}
}}"#
    );
    equal(&text, None, 4);
}

#[test]
fn subsets_collections_and_material_purposes() {
    let text = format!(
        r#"
def Scope "L" {{
    def Material "all" {{ }}
    def Material "full" {{ }}
    def Material "preview" {{ }}
    def Material "part" {{ }}
}}
def Xform "W" ( apiSchemas = ["MaterialBindingAPI", "CollectionAPI:some"] ) {{
    rel material:binding = </L/all> ( bindMaterialAs = "strongerThanDescendants" )
    rel material:binding:full = </L/full>
    rel material:binding:preview = </L/preview>
    rel collection:some:includes = </W/c>
    rel material:binding:collection:some = [</W.collection:some>, </L/part>]
    {a}
    {c}
}}
def Mesh "faces" ( apiSchemas = ["MaterialBindingAPI"] ) {{
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [3, 3, 3]
    int[] faceVertexIndices = [0, 1, 2, 2, 1, 3, 3, 1, 0]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]
    rel material:binding = </L/all>
    def GeomSubset "one" ( apiSchemas = ["MaterialBindingAPI"] ) {{
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [1]
        rel material:binding = </L/part>
    }}
}}"#,
        a = mesh("a", 1.0),
        c = mesh("c", 1.0)
    );
    for outcome in outcomes(&[("root.usda", &text)], None) {
        // materials without a surface are named, bindings are equal all the same
        assert_eq!(outcome, Outcome::Equal(3));
    }
}

#[test]
fn gprims_lights_cameras_and_settings() {
    let text = r#"
def Xform "g" {
    float3 xformOp:rotateXYZ = (10, 20, 30)
    uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    def Cube "cube" { double size = 3
    }
    def Sphere "sphere" { double radius = 0.5
    }
    def Cylinder "cylinder" { uniform token axis = "X"
    }
    def Cone "cone" { double height = 5
    }
    def Capsule "capsule" { uniform token axis = "Y"
    }
    def Plane "plane" { double width = 4
    }
}
def SphereLight "key" ( apiSchemas = ["ShapingAPI", "ShadowAPI"] ) {
    float inputs:intensity = 30
    float inputs:exposure = -1.5
    float inputs:diffuse = 0.5
    bool inputs:enableColorTemperature = 1
    float inputs:colorTemperature = 4300
    bool inputs:normalize = 1
    float inputs:radius = 0.25
    float inputs:shaping:cone:angle = 35
    float inputs:shaping:focus = 2
    bool inputs:shadow:enable = 0
}
def RectLight "rect" { float inputs:width = 3
    color3f inputs:color = (1, 0.5, 0.25)
}
def DiskLight "disk" {
}
def CylinderLight "tube" { float inputs:length = 4
}
def DistantLight "sun" { float inputs:angle = 2
}
def DomeLight "sky" { asset inputs:texture:file = @./sky.hdr@
}
def Camera "cam" {
    float horizontalAperture = 30
    float verticalApertureOffset = 2
    float focalLength.timeSamples = { 1: 20, 2: 40 }
    float2 clippingRange = (0.5, 200)
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 2: (0, 1, 3) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def RenderSettings "rs" { rel camera = </cam>
    uniform int2 resolution = (640, 360)
    rel products = </rs/p>
    def RenderProduct "p" {
    }
}
"#;
    let files = [("root.usda", text), ("sky.hdr", "not opened here")];
    equal_files(&files, Some(1.37), 6 + 6 + 1 + 1);
}

/// A mesh of four points below a `SkelRoot`, with a skeleton of two joints; `{binding}` and `{joints}` vary.
fn skinned(binding: &str, animation: &str) -> String {
    format!(
        r#"
( startTimeCode = 1
endTimeCode = 11 )
def SkelRoot "root" ( apiSchemas = ["SkelBindingAPI"] ) {{
    double3 xformOp:translate = (0, 0, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    rel skel:skeleton = </root/skel>
    def Skeleton "skel" ( apiSchemas = ["SkelBindingAPI"] ) {{
        float xformOp:rotateX = 25
        uniform token[] xformOpOrder = ["xformOp:rotateX"]
        uniform token[] joints = ["a", "a/b"]
        uniform matrix4d[] bindTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0.5, 0, 0, 1)), ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0.5, 1, 0, 1))]
        uniform matrix4d[] restTransforms = [((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0.5, 0, 0, 1)), ((0, 1, 0, 0), (-1, 0, 0, 0), (0, 0, 1, 0), (0, 1, 0, 1))]
        {animation}
    }}
    def Mesh "m" ( apiSchemas = ["SkelBindingAPI"] ) {{
        {quad}
        float xformOp:rotateY = 40
        uniform token[] xformOpOrder = ["xformOp:rotateY"]
        {binding}
    }}
}}"#,
        quad = quad(0.25)
    )
}

const MOVED: &str = r#"rel skel:animationSource = </root/skel/anim>
        def SkelAnimation "anim" {
            uniform token[] joints = ["a/b"]
            float3[] translations.timeSamples = { 1: [(0, 1, 0)], 11: [(0.5, 2, 0.25)] }
            quatf[] rotations.timeSamples = { 1: [(1, 0, 0, 0)], 11: [(0.6, 0, 0, 0.8)] }
            half3[] scales.timeSamples = { 1: [(1, 1, 1)], 11: [(1, 2, 1)] }
            uniform token[] blendShapes = ["up", "side"]
            float[] blendShapeWeights.timeSamples = { 1: [0, 0], 11: [1, 0.5] }
        }"#;

const WEIGHTS: &str = r#"int[] primvars:skel:jointIndices = [0, 1, 1, 0, 1, 0, 0, 1] ( interpolation = "vertex"
            elementSize = 2 )
        float[] primvars:skel:jointWeights = [1, 0, 0.25, 0.75, 0.5, 0.5, 1, 0] ( interpolation = "vertex"
            elementSize = 2 )
        matrix4d primvars:skel:geomBindTransform = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0.125, 0, 0, 1))
"#;

#[test]
fn skinned_meshes_at_rest_moved_remapped_rigid_and_with_blend_shapes() {
    equal(&skinned(WEIGHTS, ""), None, 1);
    for time in [1.0, 4.7, 11.0] {
        equal(&skinned(WEIGHTS, MOVED), Some(time), 1);
        let remapped = format!("{WEIGHTS} uniform token[] skel:joints = [\"a/b\", \"a\"]");
        equal(&skinned(&remapped, MOVED), Some(time), 1);
        let rigid = "int[] primvars:skel:jointIndices = [1] ( elementSize = 1 )
        float[] primvars:skel:jointWeights = [1] ( elementSize = 1 )";
        equal(&skinned(rigid, MOVED), Some(time), 1);
        let shaped = format!(
            "{WEIGHTS}
        uniform token[] skel:blendShapes = [\"side\", \"up\"]
        rel skel:blendShapeTargets = [</root/m/side>, </root/m/up>]
        def BlendShape \"side\" {{
            uniform vector3f[] offsets = [(1, 0, 0)]
            uniform int[] pointIndices = [2]
        }}
        def BlendShape \"up\" {{
            uniform vector3f[] offsets = [(0, 1, 0), (0, 2, 0), (0, 3, 0), (0, 0.5, 0)]
        }}"
        );
        equal(&skinned(&shaped, MOVED), Some(time), 1);
    }
}

#[test]
fn skinning_by_dual_quaternions_is_named() {
    let method = "uniform token primvars:skel:skinningMethod = \"dualQuaternion\"";
    let text = skinned(&format!("{WEIGHTS} {method}"), MOVED);
    for outcome in outcomes(&[("root.usda", &text)], Some(11.0)) {
        assert_eq!(
            outcome,
            Outcome::Unsupported(vec!["unsupported-skinning".to_owned()])
        );
    }
}

#[test]
fn what_is_not_drawn_is_named() {
    let shapes = [
        "NurbsPatch \"x\" { point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]
            int uVertexCount = 2
            int vVertexCount = 2
            int uOrder = 2
            int vOrder = 2
            double[] uKnots = [0, 0, 1, 1]
            double[] vKnots = [0, 0, 1, 1] }",
        "BasisCurves \"x\" { int[] curveVertexCounts = [4]
            point3f[] points = [(0, 0, 0), (1, 0, 0), (2, 1, 0), (3, 1, 0)] }",
        "Points \"x\" { point3f[] points = [(0, 0, 0)] }",
    ];
    for shape in shapes {
        unsupported(
            &format!("def {shape}").replace(" }", "\n}"),
            "unsupported-prim",
        );
    }
}

#[test]
fn linked_lights_and_mesh_lights_are_named() {
    let linked = "def SphereLight \"l\" ( apiSchemas = [\"CollectionAPI:lightLink\"] ) {
        rel collection:lightLink:excludes = </m>
    }\n";
    unsupported(&format!("{linked}{}", mesh("m", 1.0)), "unsupported-light");
    let glowing = format!(
        "def Mesh \"m\" ( apiSchemas = [\"MeshLightAPI\"] ) {{ {} }}",
        quad(1.0)
    );
    unsupported(&glowing, "unsupported-light");
}

#[test]
fn a_difference_in_silence_is_found() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [one, other] = [1.0, 1.5].map(|height| {
        let path = folder.path().join(format!("{height}.usda"));
        fs::write(&path, format!("#usda 1.0\n{}", mesh("m", height))).expect("written");
        path
    });
    let mut evaluator = Evaluator::start();
    let truth = evaluator.evaluate(&other, None).expect("usd-core reads it");
    let scene = crate::scene_of(&one, Door::Native, None)
        .expect("so do we")
        .0;
    let tally = crate::compare(&scene, &truth, &[]);
    assert_eq!(
        tally.different, 1,
        "one coordinate: {:?}",
        tally.differences
    );
    assert!(tally.differences[0].starts_with("/m world positions"));
}
