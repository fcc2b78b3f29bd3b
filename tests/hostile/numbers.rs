//! Values that make no sense: each is refused or warned of by prim, and what is written stays finite.

use super::trial::{DOORS, Trial, bake, render};

/// A quad with a material, a lamp in its corner, a sky and a camera, to be broken one part at a time.
struct Stage {
    points: &'static str,
    counts: &'static str,
    indices: &'static str,
    mesh: &'static str,
    lamp: &'static str,
    camera: &'static str,
    shader: &'static str,
    more: &'static str,
}

const PLAIN: Stage = Stage {
    points: "(0,0,0),(0,0,1),(1,0,1),(1,0,0)",
    counts: "4",
    indices: "0,1,2,3",
    mesh: "",
    lamp: "float inputs:intensity = 3",
    camera: "float focalLength = 35\ndouble3 xformOp:translate = (0.5, 0.2, 3)\nuniform token[] xformOpOrder = [\"xformOp:translate\"]",
    shader: "color3f inputs:diffuseColor = (0.5, 0.5, 0.5)",
    more: "",
};

impl Stage {
    fn text(&self) -> String {
        let Self {
            points,
            counts,
            indices,
            mesh,
            lamp,
            camera,
            shader,
            more,
        } = self;
        let scheme = if mesh.contains("subdivisionScheme") {
            ""
        } else {
            "uniform token subdivisionScheme = \"none\""
        };
        format!(
            r#"#usda 1.0
( metersPerUnit = 1
  upAxis = "Y" )
def Mesh "quad" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    point3f[] points = [{points}]
    int[] faceVertexCounts = [{counts}]
    int[] faceVertexIndices = [{indices}]
    {scheme}
    rel material:binding = </Looks/gray>
    {mesh}
}}
def SphereLight "lamp"
{{
    {lamp}
}}
def DomeLight "sky"
{{
}}
def Camera "cam"
{{
    {camera}
}}
def Scope "Looks"
{{
    def Material "gray"
    {{
        token outputs:surface.connect = </Looks/gray/preview.outputs:surface>
        def Shader "preview"
        {{
            uniform token info:id = "UsdPreviewSurface"
            {shader}
            token outputs:surface
        }}
    }}
}}
{more}
"#
        )
    }

    /// Bake through both doors.
    fn bake(&self, what: &str, check: impl Fn(Trial)) {
        for door in DOORS {
            check(bake(door, what, &self.text()));
        }
    }

    /// Render through both doors.
    fn render(&self, what: &str, check: impl Fn(Trial)) {
        for door in DOORS {
            check(render(door, what, &self.text()));
        }
    }
}

#[test]
fn the_stage_that_the_others_break_is_fine() {
    PLAIN.bake("plain", |trial| trial.fine());
    PLAIN.render("plain", |trial| trial.fine());
}

#[test]
fn points_that_are_not_numbers_are_refused_by_prim_and_index() {
    for bad in ["nan", "inf", "-inf"] {
        let points = format!("(0,0,0),(0,0,1),(1,{bad},1),(1,0,0)").leak();
        let stage = Stage { points, ..PLAIN };
        stage.bake(bad, |trial| trial.refused(&["/quad", "2"]));
    }
}

#[test]
fn broken_topology_is_refused_by_prim_and_number() {
    let cases: [(&str, &str, &[&str]); 7] = [
        ("4", "0,1,2,4", &["/quad", "4", "4 points"]),
        ("4", "0,1,2,-1", &["/quad", "-1"]),
        ("4", "0,1,2", &["/quad", "3", "4"]),
        ("4", "0,1,2,3,0", &["/quad", "5", "4"]),
        ("-4", "0,1,2,3", &["/quad", "-4"]),
        ("2000000000", "0,1,2,3", &["/quad", "2000000000"]),
        ("2147483647,2147483647,2147483647", "0,1,2,3", &["/quad"]),
    ];
    for (counts, indices, words) in cases {
        let stage = Stage {
            counts,
            indices,
            ..PLAIN
        };
        stage.bake(&format!("{counts}; {indices}"), |trial| {
            trial.refused(words);
        });
    }
}

#[test]
fn primvars_and_normals_of_wrong_length_or_without_numbers_are_warned_of() {
    let cases = [
        (
            "color3f[] primvars:displayColor = [(1,0,0),(0,1,0),(0,0,1)] (interpolation = \"vertex\")",
            "",
        ),
        (
            "color3f[] primvars:displayColor = [(nan,0,0)] (interpolation = \"constant\")",
            "",
        ),
        (
            "normal3f[] normals = [(0,1,0),(0,1,0)] (interpolation = \"vertex\")",
            "normals",
        ),
        (
            "normal3f[] normals = [(0,nan,0),(0,inf,0),(0,1,0),(0,0,0)] (interpolation = \"vertex\")",
            "",
        ),
        (
            "texCoord2f[] primvars:st = [(0,0)] (interpolation = \"faceVarying\")",
            "",
        ),
        (
            "int[] primvars:st:indices = [9,9,9,9]\ntexCoord2f[] primvars:st = [(0,0)] (interpolation = \"faceVarying\")",
            "",
        ),
    ];
    for (mesh, word) in cases {
        let stage = Stage { mesh, ..PLAIN };
        stage.bake(mesh, |trial| trial.warned(&[word]));
    }
}

#[test]
fn transforms_that_are_not_finite_leave_the_prim_out_with_a_warning() {
    for scale in ["nan,1,1", "inf,1,1"] {
        let mesh = format!(
            "double3 xformOp:scale = ({scale})\nuniform token[] xformOpOrder = [\"xformOp:scale\"]"
        )
        .leak();
        let stage = Stage { mesh, ..PLAIN };
        stage.bake(scale, |trial| {
            trial.refused(&["/quad", "no visible surface"]);
        });
    }
}

#[test]
fn prims_of_no_size_have_finite_values() {
    for scale in ["(0, 0, 0)", "(1, 0, 1)", "(1e-300, 1, 1)"] {
        let mesh = format!(
            "double3 xformOp:scale = {scale}\nuniform token[] xformOpOrder = [\"xformOp:scale\"]"
        );
        let more = "def Cube \"other\" {\ndouble size = 1\n}";
        let stage = Stage {
            mesh: mesh.leak(),
            more,
            ..PLAIN
        };
        stage.bake(scale, |trial| trial.fine());
        stage.render(scale, |trial| trial.fine());
    }
}

#[test]
fn prims_beyond_single_precision_are_refused_or_left_out() {
    for op in [
        "double3 xformOp:scale = (1e200, 1e200, 1e200)",
        "double3 xformOp:scale = (1e38, 1e38, 1e38)",
        "double3 xformOp:translate = (1e200, 0, 0)",
        "double3 xformOp:translate = (1e308, 1e308, 1e308)",
    ] {
        let name = op.split([' ', '=']).nth(1).unwrap_or_default();
        let mesh = format!("{op}\nuniform token[] xformOpOrder = [\"{name}\"]").leak();
        let more = "def Cube \"other\" {\ndouble size = 1\n}";
        let stage = Stage {
            mesh,
            more,
            ..PLAIN
        };
        stage.bake(op, |trial| trial.says(&["/quad"]));
        stage.render(op, |trial| trial.says(&["/quad"]));
    }
}

#[test]
fn lights_without_sense_are_left_out_with_a_warning() {
    let cases = [
        "float inputs:intensity = nan",
        "float inputs:intensity = inf",
        "float inputs:exposure = 1e30",
        "float inputs:exposure = nan",
        "color3f inputs:color = (1, nan, 1)",
        "float inputs:radius = nan",
        "float inputs:radius = inf",
        "float inputs:radius = -1",
        "float inputs:intensity = -3",
        "double3 xformOp:translate = (nan, 0, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"]",
    ];
    for lamp in cases {
        let stage = Stage { lamp, ..PLAIN };
        stage.bake(lamp, |trial| trial.warned(&["/lamp"]));
    }
}

#[test]
fn materials_without_numbers_use_defaults_with_a_warning() {
    let cases = [
        "color3f inputs:diffuseColor = (nan, 0, 0)",
        "color3f inputs:emissiveColor = (inf, 0, 0)",
        "float inputs:opacity = nan",
    ];
    for shader in cases {
        let stage = Stage { shader, ..PLAIN };
        stage.bake(shader, |trial| trial.warned(&["/Looks/gray"]));
    }
}

#[test]
fn a_shader_network_that_runs_in_circles_is_no_endless_loop() {
    for door in DOORS {
        bake(door, "circle", &circle()).warned(&[]);
    }
}

/// Two shaders that feed on each other.
fn circle() -> String {
    let shaders = r#"color3f inputs:diffuseColor.connect = </Looks/gray/preview/a.outputs:rgb>
            def Shader "a"
            {
                uniform token info:id = "UsdUVTexture"
                float2 inputs:st.connect = </Looks/gray/preview/b.outputs:result>
                float3 outputs:rgb
            }
            def Shader "b"
            {
                uniform token info:id = "UsdTransform2d"
                float2 inputs:in.connect = </Looks/gray/preview/b.outputs:result>
                float2 outputs:result
            }"#;
    Stage {
        shader: shaders,
        ..PLAIN
    }
    .text()
}

#[test]
fn cameras_without_sense_still_make_a_picture() {
    for camera in [
        "float focalLength = nan",
        "float focalLength = 0",
        "float focalLength = -35",
        "float horizontalAperture = inf",
        "float verticalAperture = 0",
        "float2 clippingRange = (nan, 1)",
        "float2 clippingRange = (10, 1)",
    ] {
        let stage = Stage { camera, ..PLAIN };
        stage.render(camera, |trial| trial.warned(&["/cam"]));
    }
}

#[test]
fn a_camera_that_is_nowhere_is_left_out_with_a_warning() {
    for value in ["nan", "inf"] {
        let camera = format!("double3 xformOp:translate = ({value}, 0, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"]").leak();
        let stage = Stage { camera, ..PLAIN };
        stage.render(value, |trial| trial.warned(&["/cam"]));
    }
}

#[test]
fn subdivision_with_wrong_creases_is_subdivided_without_them() {
    let stage = Stage {
        mesh: "uniform token subdivisionScheme = \"catmullClark\"\nint[] creaseIndices = [0, 9, 1]\nint[] creaseLengths = [2, 5]\nfloat[] creaseSharpnesses = [nan]\nint[] cornerIndices = [-4]\nfloat[] cornerSharpnesses = [inf]",
        ..PLAIN
    };
    stage.bake("creases", |trial| trial.warned(&["/quad"]));
}

#[test]
fn instancers_that_contradict_themselves_are_left_out_with_a_warning() {
    let cases = [
        "int[] protoIndices = [0, 7, -2]\npoint3f[] positions = [(0,0,0),(0,1,0),(0,2,0)]",
        "int[] protoIndices = [0, 0, 0]\npoint3f[] positions = [(0,0,0)]",
        "int[] protoIndices = [0]\npoint3f[] positions = [(nan,0,0)]",
        "int[] protoIndices = [0]\npoint3f[] positions = [(0,0,0)]\nfloat3[] scales = [(nan,0,0)]",
        "int[] protoIndices = [0]\npoint3f[] positions = [(0,0,0)]\nquath[] orientations = [(0,0,0,0),(1,0,0,0)]",
    ];
    for lists in cases {
        let more = format!(
            "def PointInstancer \"many\"\n{{\nrel prototypes = </many/ball>\n{lists}\ndef Sphere \"ball\"\n{{\ndouble radius = 0.1\n}}\n}}"
        )
        .leak();
        let stage = Stage { more, ..PLAIN };
        stage.bake(lists, |trial| trial.warned(&["/many"]));
    }
}

#[test]
fn gprims_without_size_are_left_out_with_a_warning() {
    for radius in ["nan", "inf", "-1", "0"] {
        let more = format!("def Sphere \"ball\"\n{{\ndouble radius = {radius}\n}}").leak();
        let stage = Stage { more, ..PLAIN };
        stage.bake(radius, |trial| trial.warned(&["/ball"]));
    }
}

#[test]
fn faces_without_area_are_harmless() {
    let cases = [
        ("4,3", "0,1,2,3,0,0,0"),
        ("4,4", "0,1,2,3,0,1,2,3"),
        ("4,4", "0,1,2,3,3,2,1,0"),
        ("4,3,2,1,0", "0,1,2,3,0,1,1,0,1,0"),
    ];
    for (counts, indices) in cases {
        let stage = Stage {
            counts,
            indices,
            ..PLAIN
        };
        stage.bake(indices, |trial| trial.warned(&[]));
    }
}

#[test]
fn a_mesh_of_faces_without_area_has_nothing_to_light() {
    let stage = Stage {
        points: "(1,1,1),(1,1,1),(1,1,1),(1,1,1)",
        ..PLAIN
    };
    stage.bake("all points in one", |_| ());
}

#[test]
fn a_single_triangle_is_a_scene() {
    let stage = Stage {
        counts: "3",
        indices: "0,1,2",
        ..PLAIN
    };
    stage.bake("one triangle", |trial| {
        trial.fine();
        let occlusion = trial.values("occlusion");
        assert!(
            occlusion.iter().all(|&covered| covered == 0.0),
            "{occlusion:?}"
        );
    });
}

#[test]
fn a_stage_with_nothing_but_an_empty_mesh_is_refused() {
    let stage = Stage {
        points: "",
        counts: "",
        indices: "",
        ..PLAIN
    };
    stage.bake("empty mesh", |trial| {
        trial.refused(&["no visible surface", "/quad"]);
    });
    for door in DOORS {
        bake(door, "empty stage", "#usda 1.0\n").refused(&["no visible surface"]);
    }
}

#[test]
fn units_without_sense_are_warned_of() {
    for units in [
        "metersPerUnit = nan",
        "metersPerUnit = 0",
        "metersPerUnit = -1",
    ] {
        let text = PLAIN.text().replace("metersPerUnit = 1", units);
        for door in DOORS {
            bake(door, units, &text).warned(&["metersPerUnit"]);
        }
    }
}
