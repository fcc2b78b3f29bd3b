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
