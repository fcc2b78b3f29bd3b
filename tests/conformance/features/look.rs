//! Materials, lights, cameras and render settings.

use super::*;

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
