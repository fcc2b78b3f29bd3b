//! What is drawn, and where.

use super::*;

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
fn what_is_not_drawn_is_named() {
    for shape in [
        "TetMesh \"x\" { point3f[] points = [(0, 0, 0)]\n}",
        "Volume \"x\" { float3[] extent = [(0, 0, 0), (1, 1, 1)]\n}",
    ] {
        unsupported(&format!("def {shape}"), "unsupported-prim");
    }
}

/// A sheet with a hole.
#[test]
fn trim_curves_are_named_with_what_follows() {
    let text = r#"#usda 1.0
def NurbsPatch "patch" {
    int uVertexCount = 2
    int vVertexCount = 2
    int uOrder = 2
    int vOrder = 2
    double[] uKnots = [0, 0, 1, 1]
    double[] vKnots = [0, 0, 1, 1]
    double2 uRange = (0, 1)
    double2 vRange = (0, 1)
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 0, 1), (1, 0, 1)]
    int[] trimCurve:counts = [1]
    int[] trimCurve:orders = [2]
    int[] trimCurve:vertexCounts = [4]
    double[] trimCurve:knots = [0, 0, 1, 2, 3, 3]
    double2[] trimCurve:ranges = [(0, 3)]
    double3[] trimCurve:points = [(0.25, 0.25, 1), (0.75, 0.25, 1), (0.5, 0.75, 1), (0.25, 0.25, 1)]
}"#;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("root.usda");
    fs::write(&path, text).expect("written");
    for door in [Door::UsdCore, Door::Native] {
        let (_, warnings) = crate::scene_of(&path, door, &Reading::default()).expect("it is read");
        let told = warnings.iter().any(|warning| {
            warning.kind == "trim-curves"
                && warning.prim == "/patch"
                && warning.message.contains("drawn whole")
        });
        assert!(told, "{door:?}: {warnings:#?}");
    }
}

/// As usd-core writes them: no place in the file, and types of their own.
#[test]
fn empty_arrays_of_binary_layers() {
    let make = r#"
import sys
from pxr import Usd
stage = Usd.Stage.CreateInMemory()
stage.GetRootLayer().ImportFromString(open(sys.argv[1]).read())
stage.GetRootLayer().Export(sys.argv[2])
"#;
    let empty = "int[] holeIndices = []
        int[] creaseIndices = []
        int[] creaseLengths = []
        float[] creaseSharpnesses = []
        normal3f[] primvars:normals = []
        texCoord2f[] primvars:st = [] ( interpolation = \"faceVarying\" )
        int[] primvars:st:indices = []
        float3[] extent = []
        uniform token[] xformOpOrder = []\n";
    let text = format!(
        "#usda 1.0
def Mesh \"m\" {{ {} {empty} }}
def Mesh \"nothing\" {{ point3f[] points = []
    int[] faceVertexCounts = []
    int[] faceVertexIndices = []
}}
def PointInstancer \"some\" {{
    rel prototypes = [</some/proto>]
    int[] protoIndices = [0, 0]
    point3f[] positions = [(0, 0, 0), (5, 0, 0)]
    int64[] invisibleIds = []
    int64[] ids = []
    vector3f[] velocities = []
    quath[] orientations = []
    float3[] scales = []
    def Mesh \"proto\" {{ {} }}
}}
def PointInstancer \"none\" {{
    rel prototypes = []
    int[] protoIndices = []
    point3f[] positions = []
}}\n",
        quad(1.0),
        quad(2.0)
    );
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [from, path] = ["root.usda", "root.usdc"].map(|name| folder.path().join(name));
    fs::write(&from, text).expect("written");
    crate::python::run_python(make, &[&from, &path]);
    let mut evaluator = Evaluator::start();
    for door in [Door::UsdCore, Door::Native] {
        let tally = judge(&mut evaluator, &path, door, &Reading::default()).expect("it is read");
        assert_eq!(tally.differences, Vec::<String>::new(), "{door:?}");
        let kinds: Vec<String> = tally.reasons.into_keys().collect();
        assert_eq!((kinds, tally.prims), (Vec::new(), 3), "{door:?}");
    }
}

#[test]
fn purposes_and_visibility_come_from_above() {
    let text = format!(
        "def Xform \"render\" {{
    uniform token purpose = \"render\"
    def Xform \"within\" {{
        {}
    }}
    def Xform \"guide\" {{
        uniform token purpose = \"guide\"
        {}
    }}
    def Scope \"again\" {{
        uniform token purpose = \"default\"
        {}
    }}
}}
def Xform \"hidden\" {{
    token visibility = \"invisible\"
    def Xform \"still\" {{
        token visibility = \"inherited\"
        {}
    }}
}}
def Xform \"seen\" {{
    {}
}}\n",
        mesh("a", 1.0),
        mesh("b", 2.0),
        mesh("c", 3.0),
        mesh("d", 4.0),
        mesh("e", 5.0)
    );
    equal(&text, None, 3);
}

#[test]
fn points_with_and_without_widths_and_normals() {
    let points = "point3f[] points = [(0, 0, 0), (3, 0, 1), (1, 2, 0)]";
    let widths = "float[] widths = [0.5, 1, 0.25]";
    let text = format!(
        "def Points \"even\" {{ {points}\nfloat[] widths = [0.5] ( interpolation = \"constant\" )\n}}
        def Points \"balls\" {{ {points}\n{widths}\nmatrix4d xformOp:transform = ( (2, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (5, 6, 7, 1) )
            uniform token[] xformOpOrder = [\"xformOp:transform\"]\n}}
        def Points \"disks\" {{ {points}\n{widths}\nnormal3f[] normals = [(0, 1, 0), (1, 0, 0), (0, 0, 1)]\n}}"
    );
    equal(&text, None, 3);
    equal(&format!("def Points \"x\" {{ {points}\n}}"), None, 1);
}

#[test]
fn curves_of_every_type_basis_and_wrap() {
    let points = "[(0, 0, 0), (1, 0, 0), (2, 1, 0), (3, 1, 0), (4, 0, 1), (5, 0, 2), (6, 1, 1)]";
    let forms = [
        ("linear", "bezier", "nonperiodic", 7),
        ("linear", "bezier", "periodic", 7),
        ("cubic", "bezier", "nonperiodic", 7),
        ("cubic", "bezier", "periodic", 6),
        ("cubic", "bspline", "nonperiodic", 7),
        ("cubic", "bspline", "periodic", 7),
        ("cubic", "bspline", "pinned", 7),
        ("cubic", "catmullRom", "nonperiodic", 7),
        ("cubic", "catmullRom", "periodic", 7),
        ("cubic", "catmullRom", "pinned", 7),
    ];
    for (kind, basis, wrap, count) in forms {
        let points = points
            .split_inclusive("), ")
            .take(count)
            .collect::<String>();
        let points = format!("{}]", points.trim_end_matches(&[',', ' ', ']'][..]));
        let text = format!(
            "def Xform \"x\" {{
    float3 xformOp:scale = (1, 2, -3)
    uniform token[] xformOpOrder = [\"xformOp:scale\"]
    def BasisCurves \"c\" {{
        uniform token type = \"{kind}\"
        uniform token basis = \"{basis}\"
        uniform token wrap = \"{wrap}\"
        int[] curveVertexCounts = [{count}]
        point3f[] points = {points}
        float[] widths = [0.2] ( interpolation = \"constant\" )
        color3f[] primvars:displayColor = [(1, 0, 0)] ( interpolation = \"uniform\" )
    }}
}}"
        );
        equal(&text, None, 1);
    }
}

/// A circle and a polyline in one prim, moving and turned.
#[test]
fn nurbs_curves() {
    let text = "def NurbsCurves \"c\" {
    int[] curveVertexCounts = [9, 3]
    int[] order = [3, 2]
    double[] knots = [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 4, 0, 0, 1, 2, 2]
    double2[] ranges = [(0, 4), (0.5, 2)]
    double[] pointWeights = [1, 0.70710678, 1, 0.70710678, 1, 0.70710678, 1, 0.70710678, 1, 1, 1, 1]
    point3f[] points.timeSamples = {
        0: [(1, 0, 0), (1, 1, 0), (0, 1, 0), (-1, 1, 0), (-1, 0, 0), (-1, -1, 0), (0, -1, 0), (1, -1, 0), (1, 0, 0), (4, 0, 0), (5, 0, 0), (5, 2, 0)],
        10: [(1, 0, 1), (1, 1, 1), (0, 1, 1), (-1, 1, 1), (-1, 0, 1), (-1, -1, 1), (0, -1, 1), (1, -1, 1), (1, 0, 1), (4, 0, 0), (5, 0, 0), (5, 2, 8)]
    }
    float[] widths = [0.2] ( interpolation = \"constant\" )
    color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0)] ( interpolation = \"uniform\" )
    double3 xformOp:rotateXYZ = (10, 20, 30)
    uniform token[] xformOpOrder = [\"xformOp:rotateXYZ\"]
}";
    equal(text, Some(2.5), 1);
}

#[test]
fn hermite_curves() {
    let text = "def HermiteCurves \"c\" {
    int[] curveVertexCounts = [2, 3]
    point3f[] points = [(0, 0, 0), (3, 3, 0), (0, 0, 1), (3, 0, 1), (3, 3, 1)]
    vector3f[] tangents = [(3, 0, 0), (0, 3, 0), (3, 0, 0), (0, 0, 0), (0, 3, 0)]
    float[] widths = [0.2, 0.1, 0.2, 0.3, 0.1] ( interpolation = \"vertex\" )
    color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0)] ( interpolation = \"uniform\" )
}";
    equal(text, None, 1);
}

#[test]
fn ribbons_and_patches() {
    let text = r#"
def BasisCurves "ribbon" {
    uniform token type = "linear"
    int[] curveVertexCounts = [2, 3]
    point3f[] points.timeSamples = { 0: [(0, 0, 0), (1, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)], 10: [(0, 5, 0), (1, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)] }
    normal3f[] normals = [(0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0)]
    float[] widths = [0.1, 0.2, 0.1, 0.5, 0.1] ( interpolation = "varying" )
}
def NurbsPatch "patch" {
    uniform token orientation = "leftHanded"
    int uVertexCount = 3
    int vVertexCount = 2
    int uOrder = 3
    int vOrder = 2
    double[] uKnots = [0, 0, 0, 1, 1, 1]
    double[] vKnots = [0, 0, 1, 1]
    double2 uRange = (0, 1)
    double2 vRange = (0, 1)
    double[] pointWeights = [1, 0.7, 1, 1, 0.7, 1]
    point3f[] points = [(1, 0, 0), (1, 1, 0), (0, 1, 0), (1, 0, 4), (1, 1, 4), (0, 1, 4)]
}"#;
    for time in [None, Some(2.5)] {
        let prims = if time.is_some() { 2 } else { 1 };
        let expected = [Outcome::Equal(prims), Outcome::Equal(prims)];
        assert_eq!(
            outcomes(
                &[(
                    "root.usda",
                    &text.replace(" }\n    normal", "\n }\n    normal")
                )],
                time
            ),
            expected
        );
    }
}

#[test]
fn native_instances_nest_and_share() {
    let asset = format!(
        "( defaultPrim = \"A\" )
def Xform \"A\" {{
    def Xform \"inner\" ( instanceable = true
        references = </Leaf> ) {{ double3 xformOp:translate = (0, 1, 0)
        uniform token[] xformOpOrder = [\"xformOp:translate\"]
    }}
    def Xform \"twin\" ( instanceable = true
        references = </Leaf> ) {{ double3 xformOp:translate = (0, 0, 3)
        uniform token[] xformOpOrder = [\"xformOp:translate\"]
    }}
}}
def Xform \"Leaf\" {{ {} }}",
        mesh("m", 1.0)
    );
    let root = "def Xform \"W\" {
    def \"a\" ( instanceable = true
        references = @asset.usda@ ) { float xformOp:rotateX = 30
        uniform token[] xformOpOrder = [\"xformOp:rotateX\"]
    }
    def \"b\" ( instanceable = true
        references = @asset.usda@ ) { token visibility = \"invisible\"
    }
    def \"c\" ( instanceable = true
        references = @asset.usda@ ) { token purpose = \"render\"
        float3 xformOp:scale = (-1, 2, 1)
        uniform token[] xformOpOrder = [\"xformOp:scale\"]
    }
    def \"d\" ( references = @asset.usda@ ) { }
}";
    equal_files(&[("root.usda", root), ("asset.usda", &asset)], None, 6);
}

/// A grid of 2 × 2 quads.
const GRID: &str = "int[] faceVertexCounts = [4, 4, 4, 4]
    int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 4, 3, 4, 7, 6, 4, 5, 8, 7]
    point3f[] points = [(0, 0, 0), (1, 0, 0.5), (2, 0, 0), (0, 1, 0), (1, 1, 1), (2, 1, 0), (0, 2, 0), (1, 2, 0), (2, 2, 3)]";

#[test]
fn subdivision_with_holes_left_hands_and_face_varying_data() {
    let mut text = String::new();
    let linear = [
        "none",
        "cornersOnly",
        "cornersPlus1",
        "cornersPlus2",
        "boundaries",
        "all",
    ];
    for (index, rule) in linear.into_iter().enumerate() {
        let boundary = ["none", "edgeOnly", "edgeAndCorner"][index % 3];
        text += &format!(
            "def Mesh \"m{index}\" {{
    {GRID}
    uniform token orientation = \"{}\"
    int[] holeIndices = [{}]
    token faceVaryingLinearInterpolation = \"{rule}\"
    token interpolateBoundary = \"{boundary}\"
    int[] cornerIndices = [4]
    float[] cornerSharpnesses = [1.5]
    color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)] ( interpolation = \"uniform\" )
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1), (1, 1)] ( interpolation = \"faceVarying\" )
    int[] primvars:st:indices = [0, 1, 3, 2, 2, 0, 1, 3, 0, 1, 3, 2, 3, 2, 0, 1]
}}\n",
            ["rightHanded", "leftHanded"][index % 2],
            index % 4
        );
    }
    equal(&text, None, linear.len());
}

#[test]
fn subsets_overlap_and_leave_faces_unassigned() {
    let text = format!(
        "def Material \"a\" {{ }}
def Material \"b\" {{ }}
def Mesh \"m\" {{
    {GRID}
    def GeomSubset \"one\" ( apiSchemas = [\"MaterialBindingAPI\"] ) {{
        uniform token elementType = \"face\"
        uniform token familyName = \"materialBind\"
        int[] indices = [0, 1]
        rel material:binding = </a>
    }}
    def GeomSubset \"two\" ( apiSchemas = [\"MaterialBindingAPI\"] ) {{
        uniform token elementType = \"face\"
        uniform token familyName = \"materialBind\"
        int[] indices = [1, 2]
        rel material:binding = </b>
    }}
}}"
    );
    equal(&text, None, 1);
}

/// Samples at the same times move the points; others, or too many or too few, do not.
#[test]
fn velocities_move_points_between_samples_as_usd_core_does() {
    let instancer = |name: &str, more: &str| {
        format!(
            "def PointInstancer \"{name}\" {{
    int[] protoIndices = [0, 0]
    point3f[] positions.timeSamples = {{ 1: [(0, 0, 0), (5, 0, 0)], 3: [(1, 0, 0), (5, 1, 0)]
    }}
    quath[] orientations.timeSamples = {{ 1: [(1, 0, 0, 0), (0.5, 0.5, 0.5, 0.5)], 3: [(0, 1, 0, 0), (0.5, 0.5, 0.5, 0.25)]
    }}
    float3[] scales.timeSamples = {{ 0: [(1, 1, 1), (1, 2, 3)], 2: [(2, 2, 2), (3, 2, 1)]
    }}
    {more}
    rel prototypes = </{name}/p>
    def Xform \"p\" {{ {} }}
}}\n",
            mesh("m", 1.0)
        )
    };
    let samples = |name: &str, times: [f64; 2]| {
        let [first, last] = times;
        format!(
            "vector3f[] {name}.timeSamples = {{ {first}: [(48, 0, 0), (0, 0, 96)], {last}: [(24, 0, 7), (0, 24, 0)]
    }}\n"
        )
    };
    let velocities = samples("velocities", [1.0, 3.0]);
    let accelerations = samples("accelerations", [1.0, 3.0]);
    let spins = samples("angularVelocities", [1.0, 3.0]);
    let late = samples("velocities", [1.5, 3.0]);
    let text = [
        "( timeCodesPerSecond = 25 )\n".to_owned(),
        instancer("plain", ""),
        instancer("moving", &velocities),
        instancer(
            "accelerated",
            &(velocities.clone() + &accelerations + &spins),
        ),
        instancer("late", &late),
        instancer("turning", &spins),
        instancer("steady", "vector3f[] velocities = [(1, 2, 3), (4, 5, 6)]"),
        instancer(
            "fewer",
            "vector3f[] velocities.timeSamples = { 1: [(1, 2, 3)], 3: [(4, 5, 6)]
    }",
        ),
    ]
    .concat();
    for time in [0.0, 1.0, 1.5, 2.75, 4.0] {
        equal(&text, Some(time), 14);
    }
}
