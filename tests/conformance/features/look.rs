//! Materials, lights, cameras and render settings.

use super::*;
use crate::scene_of;
use surflux::scene::Input;

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

/// Four meshes, two of them below an instance, and a light with `body` that has the collection `link`.
fn linked(light: &str, link: &str, body: &str) -> String {
    format!(
        "{}{}def Xform \"group\" {{ {} }}
class Xform \"_class\" {{ {} }}
def Xform \"copy\" ( instanceable = true; inherits = </_class> ) {{
}}
def Scope \"sets\" ( apiSchemas = [\"CollectionAPI:some\"] ) {{
    uniform token collection:some:expansionRule = \"expandPrims\"
    rel collection:some:includes = [</m>, </group>]
    rel collection:some:excludes = </group/inner>
}}
def {light} \"l\" ( apiSchemas = [\"CollectionAPI:{link}\"] ) {{
    {body}
}}\n",
        mesh("m", 1.0),
        mesh("n", 2.0),
        mesh("inner", 3.0),
        mesh("proxy", 4.0)
    )
}

#[test]
fn lights_are_linked_to_the_prims_their_collections_hold() {
    for (light, link) in [
        ("SphereLight", "lightLink"),
        ("SphereLight", "shadowLink"),
        ("DomeLight", "lightLink"),
        ("DomeLight", "shadowLink"),
    ] {
        let name = |part: &str| format!("collection:{link}:{part}");
        let (includes, excludes) = (name("includes"), name("excludes"));
        let no_root = format!("uniform bool {} = 0\n", name("includeRoot"));
        let rule = |rule: &str| format!("uniform token {} = \"{rule}\"\n", name("expansionRule"));
        for body in [
            String::new(),
            format!("rel {excludes} = </m>"),
            format!("rel {excludes} = [</group>, </copy>]"),
            format!("rel {excludes} = </copy/proxy>\nrel {includes} = </m>"),
            format!("rel {excludes} = </group>\nrel {includes} = </group/inner>"),
            format!("{no_root}rel {includes} = [</m>, </copy>]"),
            format!("{no_root}rel {includes} = </sets.collection:some>"),
            format!("rel {includes} = </sets.collection:some>"),
            no_root.clone(),
            format!("{}rel {includes} = [</m>, </group>]", rule("explicitOnly")),
            format!(
                "{no_root}{}rel {includes} = [</m>, </group>]",
                rule("expandPrimsAndProperties")
            ),
        ] {
            equal(&linked(light, link, &body), None, 5);
        }
    }
}

#[test]
fn mesh_lights_are_linked_to_the_prims_their_collections_hold() {
    let others = format!("{}{}", mesh("m", 1.0), mesh("n", 2.0));
    for link in ["lightLink", "shadowLink"] {
        let excludes = |paths: &str| format!("rel collection:{link}:excludes = {paths}");
        let only = format!("uniform bool collection:{link}:includeRoot = 0\n");
        for body in [
            excludes("</m>"),
            excludes("[</n>, </x>]"),
            format!("{only}rel collection:{link}:includes = </n>"),
            only.clone(),
        ] {
            equal(&format!("{others}{}", mesh_light(&body)), None, 4);
        }
    }
}

/// A mesh light with `body`, below a transform that doubles lengths.
fn mesh_light(body: &str) -> String {
    format!(
        "def Material \"glow\" {{
    token outputs:surface.connect = </glow/s.outputs:surface>
    def Shader \"s\" {{
        uniform token info:id = \"UsdPreviewSurface\"
        color3f inputs:emissiveColor = (0.5, 1, 0.25)
        token outputs:surface
    }}
}}
def Xform \"x\" {{
    float3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = [\"xformOp:scale\"]
    def Mesh \"m\" ( apiSchemas = [\"MeshLightAPI\", \"MaterialBindingAPI\"] ) {{
        {}
        float inputs:intensity = 3
        float inputs:exposure = 1
        color3f inputs:color = (1, 0.5, 0.25)
        bool inputs:enableColorTemperature = 1
        float inputs:colorTemperature = 3200
        {body}
    }}
}}",
        quad(1.0)
    )
}

#[test]
fn mesh_lights_shine_with_their_radiance() {
    equal(&mesh_light(""), None, 2);
    equal(&mesh_light("bool inputs:normalize = 1"), None, 2);
    let bound = "rel material:binding = </glow>";
    for sync in [
        "independent",
        "noMaterialResponse",
        "materialGlowTintsLight",
    ] {
        let sync = format!("{bound}\n uniform token light:materialSyncMode = \"{sync}\"");
        equal(&mesh_light(&sync), None, 2);
    }
}

#[test]
fn volume_and_geometry_lights_are_named() {
    for light in [
        "Volume \"v\" ( apiSchemas = [\"VolumeLightAPI\"] )",
        "GeometryLight \"g\"",
    ] {
        for outcome in outcomes(&[("root.usda", &format!("def {light} {{ }}"))], None) {
            let Outcome::Unsupported(kinds) = outcome else {
                panic!("{outcome:?}");
            };
            let of_light = kinds.iter().any(|kind| kind == "unsupported-light");
            assert!(of_light || kinds == ["unsupported-prim"], "{kinds:?}");
        }
    }
}

#[test]
fn lights_normalized_shaped_and_colored_by_temperature() {
    let all = [
        "SphereLight",
        "RectLight",
        "DiskLight",
        "CylinderLight",
        "DistantLight",
        "DomeLight",
    ];
    let light = |(index, kind): (usize, &&str)| {
        format!(
            "def {kind} \"l{index}\" ( apiSchemas = [\"ShapingAPI\", \"ShadowAPI\"] ) {{
    bool inputs:normalize = {}
    bool inputs:enableColorTemperature = 1
    float inputs:colorTemperature = {}
    float inputs:exposure = {index}
    float inputs:diffuse = 0.25
    color3f inputs:color = (0.1, 0.2, 0.9)
    float inputs:shaping:cone:angle = {}
    float inputs:shaping:cone:softness = 0.5
    float inputs:shaping:focus = {index}
    color3f inputs:shaping:focusTint = (0.5, 0, 0)
    bool inputs:shadow:enable = {}
    float3 xformOp:rotateXYZ = (10, {index}, 30)
    uniform token[] xformOpOrder = [\"xformOp:rotateXYZ\"]
}}\n",
            index % 2,
            1000 + 1700 * index,
            20 * index,
            (index + 1) % 2,
        )
    };
    let text: String = all.iter().enumerate().map(light).collect();
    equal(&text, None, all.len());
}

#[test]
fn domes_turn_with_the_up_axis_and_other_formats_are_named() {
    for up in ["Y", "Z"] {
        for dome in ["DomeLight", "DomeLight_1"] {
            for pole in ["scene", "Y", "Z"] {
                let pole = match dome {
                    "DomeLight_1" => format!("token poleAxis = \"{pole}\""),
                    _ => String::new(),
                };
                let text = format!(
                    "( upAxis = \"{up}\" )
def {dome} \"d\" {{
    {pole}
    float xformOp:rotateZ = 25
    uniform token[] xformOpOrder = [\"xformOp:rotateZ\"]
}}"
                );
                equal(&text, None, 1);
            }
        }
    }
    for (format, is_read) in [
        ("automatic", true),
        ("latlong", true),
        ("mirroredBall", false),
        ("angular", false),
    ] {
        let text = format!(
            "def DomeLight \"d\" {{
    asset inputs:texture:file = @./sky.hdr@
    token inputs:texture:format = \"{format}\"
}}"
        );
        let files = [("root.usda", &*text), ("sky.hdr", "not opened here")];
        let expected = match is_read {
            true => Outcome::Equal(1),
            false => Outcome::Unsupported(vec!["unsupported-light".to_owned()]),
        };
        for outcome in outcomes(&files, None) {
            assert_eq!(outcome, expected, "{format}");
        }
    }
}

#[test]
fn cameras_of_both_projections_with_offsets_and_exposure() {
    let text = r#"
( upAxis = "Z"
metersPerUnit = 1
defaultPrim = "cams" )
def Xform "cams" {
    float3 xformOp:scale = (1, 1, 2)
    double3 xformOp:translate = (1e6, 3, 4)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
    def Camera "a" {
        token projection = "orthographic"
        float horizontalAperture = 120.5
        float verticalAperture = 60
        float horizontalApertureOffset = -3
        float verticalApertureOffset = 1.5
        float exposure = -2.5
        float2 clippingRange = (0.001, 1e7)
    }
    def Camera "b" {
        float focalLength = 85
        float exposure.timeSamples = { 0: 0, 10: 5 }
    }
    def Camera "c" {
    }
}"#
    .replace(" }\n    }", "\n }\n    }");
    for time in [None, Some(3.3)] {
        equal(&text, time, 3);
    }
}

#[test]
fn render_products_inherit_and_list_their_vars() {
    let text = r#"
( renderSettingsPrimPath = "/R/main" )
def Camera "cam" { }
def Camera "other" { }
def Scope "R" {
    def RenderSettings "main" {
        rel camera = </cam>
        uniform int2 resolution = (1920, 800)
        uniform float4 dataWindowNDC = (0.25, 0, 0.75, 1)
        uniform token aspectRatioConformPolicy = "cropAperture"
        rel products = [</R/beauty>, </R/deep>, </R/small>]
    }
    def RenderSettings "empty" { }
    def RenderProduct "beauty" {
        token productName = "out/beauty.exr"
        rel orderedVars = [</R/v/color>, </R/v/n>, </R/v/lpe>]
    }
    def RenderProduct "deep" {
        uniform token productType = "deepRaster"
        token productName = "deep.exr"
        rel orderedVars = </R/v/color>
    }
    def RenderProduct "small" {
        uniform int2 resolution = (64, 32)
        rel camera = </other>
        uniform token aspectRatioConformPolicy = "expandAperture"
        uniform float4 dataWindowNDC = (0, 0, 1, 0.5)
        rel orderedVars = [</R/v/n>, </R/v/color>]
    }
    def Scope "v" {
        def RenderVar "color" {
            uniform string sourceName = "Ci"
        }
        def RenderVar "n" {
            uniform token dataType = "normal3f"
            uniform string sourceName = "N"
            uniform token sourceType = "primvar"
        }
        def RenderVar "lpe" {
            uniform token dataType = "color4f"
            uniform string sourceName = "C<RD>[<L.>O]"
            uniform token sourceType = "lpe"
        }
    }
}"#;
    equal(text, None, 4);
}

/// Makes `sys.argv[2]`.usdz of the file `sys.argv[1]` and what it uses.
const PACK: &str = "import sys; from pxr import UsdUtils; assert UsdUtils.CreateNewUsdzPackage(sys.argv[1], sys.argv[2])";

/// An asset with a part beside it, a picture and a sky.
const ASSET: &str = r#"#usda 1.0
( defaultPrim = "Asset" )
def Xform "Asset" ( references = @./geo/part.usda@ ) {
    def Material "m" {
        token outputs:surface.connect = </Asset/m/s.outputs:surface>
        def Shader "s" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </Asset/m/t.outputs:rgb>
            token outputs:surface
        }
        def Shader "t" {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./maps/color.png@
            float3 outputs:rgb
        }
    }
    over "part" ( apiSchemas = ["MaterialBindingAPI"] ) { rel material:binding = </Asset/m>
    }
    def DomeLight "sky" { asset inputs:texture:file = @./maps/sky.hdr@
    }
}"#;

#[test]
fn packages_hold_layers_and_textures() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = |name: &str| folder.path().join(name);
    let part = format!(
        "#usda 1.0\n( defaultPrim = \"P\" )\ndef Xform \"P\" {{ {} }}",
        mesh("part", 1.0)
    );
    for sub in ["geo", "maps"] {
        fs::create_dir(file(sub)).expect("made");
    }
    fs::write(file("asset.usda"), ASSET).expect("written");
    fs::write(file("geo/part.usda"), part).expect("written");
    fs::write(file("maps/color.png"), b"a picture").expect("written");
    fs::write(file("maps/sky.hdr"), b"a sky").expect("written");
    crate::python::run_python(PACK, &[file("asset.usda"), file("asset.usdz")]);
    for removed in ["geo", "maps"] {
        fs::remove_dir_all(file(removed)).expect("removed");
    }
    let user = "#usda 1.0\ndef \"a\" ( references = @asset.usdz@ ) { }";
    fs::write(file("root.usda"), user).expect("written");
    let mut evaluator = Evaluator::start();
    for root in ["asset.usdz", "root.usda"] {
        for door in [Door::UsdCore, Door::Native] {
            let tally = judge(&mut evaluator, &file(root), door, &Reading::default());
            let tally = tally.expect("both read packages");
            assert!(
                tally.differences.is_empty(),
                "{door:?} {root}: {:?}",
                tally.differences
            );
            assert_eq!((tally.prims, tally.unsupported), (2, 0), "{door:?} {root}");
            let scene = scene_of(&file(root), door, &Reading::default())
                .expect("read")
                .0;
            let Input::Texture(read) = &scene.materials[0].diffuse_color else {
                panic!("{door:?} {root}: {:?}", scene.materials[0].diffuse_color);
            };
            let texture = read.file.to_string_lossy();
            assert!(
                texture.ends_with("asset.usdz[maps/color.png]"),
                "{door:?} {root}: {texture}"
            );
        }
    }
}

#[test]
fn materialx_documents_and_their_images_inside_packages() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let package = folder.path().join("p.usdz");
    let mut writer = openusd::usdz::ArchiveWriter::create(&package).expect("a package");
    let root = format!(
        "#usda 1.0\ndef Scope \"L\" ( references = @./looks/look.mtlx@</MaterialX> ) {{ }}\n{}",
        mesh("m", 0.5)
            .replace(
                "def Mesh \"m\"",
                "def Mesh \"m\" ( apiSchemas = [\"MaterialBindingAPI\"] )"
            )
            .replacen('{', "{\nrel material:binding = </L/Materials/paint>\n", 1)
    );
    let look = r#"<?xml version="1.0"?><materialx version="1.38">
        <nodegraph name="g"><image name="i" type="color3"><input name="file" type="filename" value="../tex/a.png"/></image>
            <output name="out" type="color3" nodename="i"/></nodegraph>
        <standard_surface name="s" type="surfaceshader"><input name="base_color" type="color3" nodegraph="g" output="out"/></standard_surface>
        <surfacematerial name="paint" type="material"><input name="surfaceshader" type="surfaceshader" nodename="s"/></surfacematerial>
    </materialx>"#;
    for (name, bytes) in [
        ("root.usda", root.as_bytes()),
        ("looks/look.mtlx", look.as_bytes()),
        ("tex/a.png", b"png"),
    ] {
        writer.add_layer(name, bytes).expect("an entry");
    }
    writer.finish().expect("a package");
    for door in [Door::UsdCore, Door::Native] {
        let (scene, warnings) = scene_of(&package, door, &Reading::default()).expect("read");
        let images: Vec<_> = (scene.materials.iter())
            .filter_map(|material| match &material.diffuse_color {
                Input::Texture(read) => Some(read.file.clone()),
                _ => None,
            })
            .collect();
        let inside = format!("{}[tex/a.png]", package.display());
        assert_eq!(images, [Path::new(&inside)], "{door:?} {warnings:?}");
    }
}
