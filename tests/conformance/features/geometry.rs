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
