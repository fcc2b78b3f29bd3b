//! Meshes that skeletons deform.

use super::*;

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

const DUAL: &str = "uniform token primvars:skel:skinningMethod = \"dualQuaternion\"\n";

const RIGID: &str = "int[] primvars:skel:jointIndices = [1] ( elementSize = 1 )
        float[] primvars:skel:jointWeights = [1] ( elementSize = 1 )\n";

#[test]
fn dual_quaternions_blend_motions_and_stretches() {
    equal(&skinned(&format!("{WEIGHTS} {DUAL}"), ""), None, 1);
    for time in [4.7, 11.0] {
        equal(&skinned(&format!("{WEIGHTS} {DUAL}"), MOVED), Some(time), 1);
        equal(&skinned(&format!("{RIGID} {DUAL}"), MOVED), Some(time), 1);
        let of_two = "int[] primvars:skel:jointIndices = [0, 1] ( elementSize = 2 )
        float[] primvars:skel:jointWeights = [0.3, 0.7] ( elementSize = 2 )\n";
        equal(&skinned(&format!("{of_two} {DUAL}"), MOVED), Some(time), 1);
    }
}

#[test]
fn a_method_that_usd_does_not_know_deforms_nothing() {
    let method = "uniform token primvars:skel:skinningMethod = \"delta\"";
    equal(
        &skinned(&format!("{WEIGHTS} {method}"), MOVED),
        Some(11.0),
        1,
    );
}

/// Two joints for the whole mesh, where the width says one.
#[test]
fn influences_that_do_not_fit_their_width_are_named() {
    let of_two = "int[] primvars:skel:jointIndices = [0, 1]
        float[] primvars:skel:jointWeights = [0.3, 0.7]";
    for outcome in outcomes(&[("root.usda", &skinned(of_two, MOVED))], Some(11.0)) {
        assert_eq!(
            outcome,
            Outcome::Unsupported(vec!["unsupported-skinning".to_owned()])
        );
    }
}

#[test]
fn shapes_in_between_are_blended_and_gone_beyond() {
    let shape = "uniform token[] skel:blendShapes = [\"up\"]
        rel skel:blendShapeTargets = [</root/m/up>]
        def BlendShape \"up\" {
            uniform vector3f[] offsets = [(0, 1, 0), (0, 2, 0), (0, 3, 0)]
            uniform int[] pointIndices = [3, 0, 1]
            uniform vector3f[] inbetweens:late = [(1, 0, 0), (0, 0, 2), (0, 0, 1)] ( weight = 0.75 )
            uniform vector3f[] inbetweens:early = [(2, 0, 0), (0, 4, 2), (0, 0, 1)] ( weight = 0.25 )
            uniform vector3f[] inbetweens:never = [(9, 9, 9), (9, 9, 9), (9, 9, 9)]
        }";
    for weight in [-0.5, 0.1, 0.25, 0.4, 1.75] {
        let animation = format!(
            "rel skel:animationSource = </root/skel/anim>
        def SkelAnimation \"anim\" {{
            uniform token[] blendShapes = [\"up\"]
            float[] blendShapeWeights = [{weight}]
        }}"
        );
        equal(&skinned(&format!("{WEIGHTS} {shape}"), &animation), None, 1);
    }
}

#[test]
fn normals_follow_shapes_and_those_in_between() {
    let shape = "normal3f[] normals = [(0, 0, 1), (1, 0, 0), (0.6, 0, 0.8), (0, -1, 0)]
        uniform token[] skel:blendShapes = [\"up\"]
        rel skel:blendShapeTargets = [</root/m/up>]
        def BlendShape \"up\" {
            uniform vector3f[] offsets = [(0, 1, 0), (0, 2, 0), (0, 3, 0)]
            uniform vector3f[] normalOffsets = [(0, 1, 0), (0.5, 0, 0), (0, 0, 2)]
            uniform int[] pointIndices = [3, 0, 1]
            uniform vector3f[] inbetweens:late = [(1, 0, 0), (0, 0, 2), (0, 0, 1)] ( weight = 0.75 )
            uniform vector3f[] inbetweens:late:normalOffsets = [(0, 0.25, 1), (0, 1, 0), (0.5, 0, 0)]
            uniform vector3f[] inbetweens:early = [(2, 0, 0), (0, 4, 2), (0, 0, 1)] ( weight = 0.25 )
        }";
    for weight in [-0.5, 0.1, 0.4, 0.75, 1.0, 1.75] {
        let animation = format!(
            "rel skel:animationSource = </root/skel/anim>
        def SkelAnimation \"anim\" {{
            uniform token[] blendShapes = [\"up\"]
            float[] blendShapeWeights = [{weight}]
        }}"
        );
        for influences in [WEIGHTS, ""] {
            let text = skinned(&format!("{influences} {shape}"), &animation);
            equal(&text, None, 1);
        }
    }
}

#[test]
fn normals_follow_the_joints() {
    let of_points = "normal3f[] normals = [(0, 0, 1), (1, 0, 0), (0.6, 0, 0.8), (0, -1, 0)]\n";
    let of_corners = "normal3f[] primvars:normals = [(0, 0, 1), (1, 0, 0), (0.6, 0, 0.8)] ( interpolation = \"faceVarying\" )
        int[] primvars:normals:indices = [2, 0, 1, 1]\n";
    for normals in [of_points, of_corners] {
        for method in ["", DUAL] {
            for influences in [WEIGHTS, RIGID] {
                let text = skinned(&format!("{influences} {normals} {method}"), MOVED);
                equal(&text, Some(4.7), 1);
            }
        }
    }
}

/// What binds may stand above, curves are deformed too, gprims without points are moved whole, and what nothing acts on
/// stays where it is.
#[test]
fn bindings_are_inherited_and_reach_every_gprim() {
    let others = format!(
        "}}
    def Xform \"above\" ( apiSchemas = [\"SkelBindingAPI\"] ) {{
        double3 xformOp:translate = (0, 5, 0)
        uniform token[] xformOpOrder = [\"xformOp:translate\"]
        {RIGID}
        {DUAL}
        def Cube \"cube\" {{
            double3 xformOp:translate = (7, 7, 7)
            uniform token[] xformOpOrder = [\"xformOp:translate\"]
        }}
        def BasisCurves \"curves\" {{
            point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
            int[] curveVertexCounts = [4]
            uniform token type = \"linear\"
            float[] widths = [0.1] ( interpolation = \"constant\" )
        }}
        def Mesh \"own\" {{
            {}
        }}
    }}
    def Sphere \"still\" {{
        double3 xformOp:translate = (0, 5, 0)
        uniform token[] xformOpOrder = [\"xformOp:translate\"]
    ",
        quad(2.0)
    );
    let text = skinned(&format!("{WEIGHTS} {others}"), MOVED);
    equal(&text, Some(4.7), 5);
}
