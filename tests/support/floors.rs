//! The stage of many closed forms: a floor, and what stands above it.

/// A floor at the origin, facing up, its points at (±`half`, 0, ±`half`), of the gray `albedo`, and `more`; below `/World`.
pub(crate) fn floor(half: f32, albedo: f32, more: &str) -> String {
    format!(
        r#"#usda 1.0
( defaultPrim = "World"
  metersPerUnit = 1
  upAxis = "Y" )
def Xform "World"
{{
    def Mesh "floor"
    {{
        point3f[] points = [(-{half}, 0, {half}), ({half}, 0, {half}), ({half}, 0, -{half}), (-{half}, 0, -{half})]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token subdivisionScheme = "none"
        color3f[] primvars:displayColor = [({albedo}, {albedo}, {albedo})]
    }}
    {more}
}}
"#
    )
}
