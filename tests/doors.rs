//! One scene, whichever door it came through: every field of what `stage::read` makes, native against usd-core.
//!
//! Stages are those of the shared assets (skipped with a note where they are missing) and small ones written here for
//! what the assets have not. `cargo test --test doors -- --nocapture` prints the table.

#![expect(
    clippy::print_stdout,
    reason = "the table of stages is what people run it for"
)]

#[path = "support/stages.rs"]
mod stages;

#[path = "support/python.rs"]
#[expect(dead_code, reason = "shared with tests that run scripts of their own")]
mod python;

use glam::DVec3;
use python::python;
use stages::stages_below;
use std::collections::BTreeSet;
use std::fmt::Debug;
use std::fs;
use std::path::{Path, PathBuf};
use surflux::diagnostics::Diagnostics;
use surflux::scene::{Mesh, Purpose, Scene};
use surflux::stage::native::NativeSource;
use surflux::stage::worker::WorkerSource;
use surflux::stage::{self, Error, ReadSettings, Source};

/// Numbers that come out of composed transforms may differ by this part of the largest number beside them.
const ROUNDING: f64 = 1e-6;

/// What became of the fields of two scenes.
#[derive(Debug, Default)]
struct Tally {
    /// Bit by bit (paths after canonicalisation).
    equal: usize,
    /// Within [`ROUNDING`].
    close: usize,
    /// The others, with both values.
    different: Vec<String>,
}

impl Tally {
    fn of(native: &Scene, core: &Scene) -> Self {
        let mut tally = Self::default();
        tally.stage_info(native, core);
        tally.all("origin", &[native.origin], &[core.origin]);
        tally.meshes(&native.meshes, &core.meshes);
        tally.all("prim", &native.prims, &core.prims);
        tally.all("material", &native.materials, &core.materials);
        tally.all("light", &native.lights, &core.lights);
        tally.all("camera", &native.cameras, &core.cameras);
        let settings = (&native.render_settings, &core.render_settings);
        tally.all("render settings", settings.0, settings.1);
        tally
    }

    fn stage_info(&mut self, native: &Scene, core: &Scene) {
        let plain = |scene: &Scene| {
            let mut info = scene.stage.clone();
            info.layers.clear();
            info.reader.clear();
            info
        };
        self.field("stage info", &plain(native), &plain(core));
        let layers = |scene: &Scene| -> BTreeSet<PathBuf> {
            let layers = scene.stage.layers.iter();
            layers
                .filter(|layer| !layer.starts_with("anon:"))
                .map(|layer| fs::canonicalize(layer).unwrap_or_else(|_| layer.into()))
                .collect()
        };
        let (native_layers, core_layers) = (layers(native), layers(core));
        // A stage of nothing but overs: usd-core composes their arcs and so lists layers that give it no prim.
        if core.prims.is_empty() && native_layers.is_subset(&core_layers) {
            self.equal += 1;
        } else {
            self.field("layers", &native_layers, &core_layers);
        }
    }

    fn meshes(&mut self, native: &[Mesh], core: &[Mesh]) {
        self.field("number of meshes", &native.len(), &core.len());
        for (index, (a, b)) in native.iter().zip(core).enumerate() {
            let name = |field: &str| format!("mesh {index} {field}");
            // Cheap first: printing a million positions is not.
            if a == b {
                self.equal += 6;
                continue;
            }
            self.field(&name("positions"), &a.positions, &b.positions);
            let topology = |mesh: &Mesh| (mesh.triangles.clone(), mesh.triangle_faces.clone());
            self.field(&name("topology"), &topology(a), &topology(b));
            self.field(&name("normals"), &a.normals, &b.normals);
            self.field(&name("primvars"), &a.primvars, &b.primvars);
            self.field(&name("cage"), &a.cage, &b.cage);
            let rest = |mesh: &Mesh| (mesh.double_sided, mesh.closed, mesh.scheme.clone());
            self.field(&name("rest"), &rest(a), &rest(b));
        }
    }

    fn all<T: Debug>(&mut self, name: &str, native: &[T], core: &[T]) {
        self.field(&format!("number of {name}s"), &native.len(), &core.len());
        for (index, (a, b)) in native.iter().zip(core).enumerate() {
            self.field(&format!("{name} {index}"), a, b);
        }
    }

    /// Debug shows every field, and floats with all the digits that tell them apart.
    fn field<T: Debug>(&mut self, name: &str, native: &T, core: &T) {
        let (a, b) = (format!("{native:?}"), format!("{core:?}"));
        if a == b {
            self.equal += 1;
        } else if let Some(is_rounded) = alike(&a, &b) {
            self.equal += usize::from(!is_rounded);
            self.close += usize::from(is_rounded);
        } else {
            let cut = |text: &str| text.chars().take(600).collect::<String>();
            let difference = format!("{name}:\n  native   {}\n  usd-core {}", cut(&a), cut(&b));
            self.different.push(difference);
        }
    }
}

/// True in it if numbers are rounded differently; `None` if more than that differs.
fn alike(a: &str, b: &str) -> Option<bool> {
    let words = |text: &str| -> Vec<String> {
        let is_border = |c: char| " ,()[]{}".contains(c);
        let words = text.split(is_border).filter(|word| !word.is_empty());
        words.map(str::to_owned).collect()
    };
    let (a, b) = (words(a), words(b));
    if a.len() != b.len() {
        return None;
    }
    let number = |word: &String| word.parse::<f64>().ok().filter(|x| x.is_finite());
    let largest = a.iter().filter_map(number).fold(0.0, |m, x| x.abs().max(m));
    let mut is_rounded = false;
    for (a, b) in a.iter().zip(&b).filter(|(a, b)| a != b) {
        match (number(a), number(b)) {
            (Some(x), Some(y)) if (x - y).abs() <= ROUNDING * largest => is_rounded = true,
            (None, None) if file(a).is_some() && file(a) == file(b) => {}
            _ => return None,
        }
    }
    Some(is_rounded)
}

fn file(word: &str) -> Option<PathBuf> {
    let path = word.strip_prefix('"')?.strip_suffix('"')?;
    fs::canonicalize(path).ok()
}

/// A stage read through both doors.
enum Outcome {
    Compared(Box<Scene>, Tally),
    /// Native's message; usd-core reads it.
    Refused(String),
    /// Both do.
    BothRefuse,
}

/// Both doors, opened once.
struct Doors<'a> {
    path: &'a Path,
    native: Result<NativeSource, Error>,
    core: Result<WorkerSource, Error>,
}

impl<'a> Doors<'a> {
    fn open(path: &'a Path) -> Self {
        Self {
            path,
            native: NativeSource::open(path),
            core: WorkerSource::open_with(&python(), path, &Diagnostics::default()),
        }
    }

    fn read(&mut self, settings: &ReadSettings) -> Outcome {
        let native = read(&mut self.native, settings);
        match (native, read(&mut self.core, settings)) {
            (Ok(native), Ok(core)) => {
                let tally = Tally::of(&native, &core);
                Outcome::Compared(Box::new(native), tally)
            }
            (Err(refusal), Ok(_)) => Outcome::Refused(refusal),
            (Err(_), Err(_)) => Outcome::BothRefuse,
            (Ok(_), Err(problem)) => {
                panic!("{}: only usd-core fails: {problem}", self.path.display())
            }
        }
    }
}

fn read<S: Source>(door: &mut Result<S, Error>, settings: &ReadSettings) -> Result<Scene, String> {
    let source = door.as_mut().map_err(|error| error.to_string())?;
    let scene = stage::read(source, settings, &Diagnostics::default());
    scene.map_err(|error| error.to_string())
}

/// Cages are not refined further than they must be: both doors share what comes after the cage.
fn coarse(time: Option<f64>) -> ReadSettings {
    ReadSettings {
        time,
        refine_edge: Some(f32::MAX),
        ..ReadSettings::default()
    }
}

fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("SURFLUX_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")),
        PathBuf::from,
    );
    folder.join("assets").is_dir().then_some(folder)
}

/// Those of `paths` that no other of them brings in: what lies below is compared with them.
fn root_stages(paths: &[PathBuf]) -> Vec<PathBuf> {
    let real = |path: &Path| fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let mut below = BTreeSet::new();
    for path in paths {
        let mut native = NativeSource::open(path);
        let Ok(scene) = read(&mut native, &coarse(None)) else {
            continue;
        };
        let layers = scene
            .stage
            .layers
            .iter()
            .map(|layer| real(Path::new(layer)));
        below.extend(layers.filter(|layer| *layer != real(path)));
    }
    let roots = paths.iter().filter(|path| !below.contains(&real(path)));
    roots.cloned().collect()
}

#[test]
fn shared_assets_make_the_same_scene_through_both_doors() {
    let Some(shared) = shared() else {
        println!("skipped: no shared assets (SURFLUX_SHARED)");
        return;
    };
    let mut paths = Vec::new();
    stages_below(&shared.join("assets"), &mut paths);
    let (mut equal, mut close, mut prims) = (0, 0, 0);
    let (mut different, mut refused) = (Vec::new(), Vec::new());
    println!(
        "{:>7} {:>8} {:>6} {:>5}  stage",
        "prims", "equal", "close", "diff"
    );
    let roots = root_stages(&paths);
    for path in &roots {
        let mut doors = Doors::open(path);
        for time in [None, Some(12.5)] {
            let name = path.strip_prefix(&shared).unwrap_or(path).display();
            let label = format!("{name} at {time:?}");
            match doors.read(&coarse(time)) {
                Outcome::Compared(scene, tally) => {
                    let diff = tally.different.len();
                    let (same, near) = (tally.equal, tally.close);
                    println!(
                        "{:7} {same:8} {near:6} {diff:5}  {label}",
                        scene.prims.len()
                    );
                    equal += same;
                    close += near;
                    prims += scene.prims.len();
                    let found = tally.different.into_iter();
                    different.extend(found.map(|found| format!("{label}: {found}")));
                }
                Outcome::Refused(message) => {
                    println!("{:>29}  {label}: {message}", "refused by native");
                    refused.push(label);
                }
                Outcome::BothRefuse => println!("{:>29}  {label}", "refused by both"),
            }
        }
    }
    println!(
        "{} stages, {prims} prims; values: {equal} equal, {close} within {ROUNDING}, {} different; {} refused by native",
        2 * roots.len(),
        different.len(),
        refused.len()
    );
    assert!(different.is_empty(), "{}", different.join("\n"));
}

/// How many prims, meshes, materials, lights, cameras and render settings a stage has.
type Counts = [usize; 6];

/// Read `text` both ways at `time`; equal in everything, with `expected` counts.
#[track_caller]
fn same(text: &str, settings: &ReadSettings, expected: Counts) -> Scene {
    let folder = tempfile::tempdir().expect("temp folder");
    fs::write(folder.path().join("map.png"), "not read here").expect("written");
    let path = folder.path().join("stage.usda");
    fs::write(&path, format!("#usda 1.0\n{text}")).expect("written");
    match Doors::open(&path).read(settings) {
        Outcome::Compared(scene, tally) => {
            assert!(tally.different.is_empty(), "{}", tally.different.join("\n"));
            let Scene {
                prims,
                meshes,
                materials,
                lights,
                cameras,
                render_settings,
                ..
            } = &*scene;
            let counts = [
                prims.len(),
                meshes.len(),
                materials.len(),
                lights.len(),
                cameras.len(),
                render_settings.len(),
            ];
            assert_eq!(counts, expected);
            *scene
        }
        Outcome::Refused(message) => panic!("native refuses it: {message}"),
        Outcome::BothRefuse => panic!("both refuse it"),
    }
}

const QUAD: &str = "
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0.1), (0, 1, 0)]
";

#[test]
fn polygons_with_holes_sides_normals_and_primvars() {
    let text = r#"
(
    upAxis = "Z"
    metersPerUnit = 0.1
)
def Mesh "m" {
    int[] faceVertexCounts = [4, 5, 3]
    int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 6, 4, 3, 4, 7]
    int[] holeIndices = [2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0), (1.5, 2, 0), (0.5, 2, 0.3)]
    uniform token subdivisionScheme = "none"
    uniform token orientation = "leftHanded"
    uniform bool doubleSided = 1
    normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0.6, 0.8)] ( interpolation = "uniform" )
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (0.3333333, 1)] ( interpolation = "faceVarying" )
    int[] primvars:st:indices = [0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2]
    color3f[] primvars:displayColor = [(1, 0.1, 0), (0, 1, 0), (0, 0, 1)] ( interpolation = "uniform" )
    float[] primvars:displayOpacity = [0.7]
}
def Mesh "creased" {
    int[] faceVertexCounts = [4, 4]
    int[] faceVertexIndices = [0, 1, 4, 3, 1, 2, 5, 4]
    point3f[] points = [(0, 0, 0), (1, 0, 1), (2, 0, 0), (0, 1, 0), (1, 1, 1), (2, 1, 0)]
    int[] creaseIndices = [1, 4]
    int[] creaseLengths = [2]
    float[] creaseSharpnesses = [1.5]
    int[] cornerIndices = [0]
    float[] cornerSharpnesses = [10]
    uniform token interpolateBoundary = "edgeOnly"
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)] ( interpolation = "vertex" )
}
def Mesh "loop" {
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 1, 2, 2, 1, 3]
    point3f[] points = [(5, 0, 0), (6, 0, 0), (5, 1, 0), (6, 1, 1)]
    uniform token subdivisionScheme = "loop"
}
"#;
    let scene = same(text, &coarse(None), [3, 3, 0, 0, 0, 0]);
    assert!(scene.meshes[0].double_sided);
    assert_eq!(scene.meshes[0].triangles.len(), 2 + 3);
}

#[test]
fn every_implicit_gprim() {
    let text = r#"
def Cube "a" { double size = 3 }
def Sphere "b" { double radius = 0.25 }
def Cylinder "c" {
    uniform token axis = "X"
    double height = 3
}
def Cone "d" { uniform token axis = "Y" }
def Capsule "e" { double radius = 0.1 }
def Plane "f" {
    double width = 7
    uniform token axis = "X"
}
def Cylinder_1 "g" {
    double radiusTop = 0.2
    double radiusBottom = 0.6
}
def Capsule_1 "h" { double radiusTop = 0.2 }
def Sphere "again" {
    double radius = 0.25
    double3 xformOp:translate = (9, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"#;
    let text = text.replace(" }\n", "\n}\n");
    same(&text, &coarse(None), [9, 8, 0, 0, 0, 0]);
}

#[test]
fn transforms_visibility_and_purpose() {
    let text = format!(
        r#"
def Xform "a" {{
    double3 xformOp:translate = (1.1, 2.2, 3.3)
    float3 xformOp:rotateXYZ = (10, 20, 30)
    double xformOp:rotateZ:spin = 33.3
    half3 xformOp:scale = (1, 2, 0.3)
    quatf xformOp:orient = (0.5, 0.1, 0.2, 0.3)
    matrix4d xformOp:transform = ((1, 0.2, 0, 0), (0, 1, 0, 0), (0, 0.1, 1, 0), (4, 5, 6, 1))
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:transform", "xformOp:orient", "xformOp:rotateZ:spin", "xformOp:scale", "!invert!xformOp:rotateZ:spin"]
    def Mesh "m" {{ {QUAD} }}
    def Mesh "reset" {{
        {QUAD}
        float3 xformOp:rotateZYX = (1, 2, 3)
        uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:rotateZYX"]
    }}
    def Mesh "hidden" {{
        {QUAD}
        token visibility = "invisible"
    }}
}}
def Xform "render" {{
    uniform token purpose = "render"
    def Mesh "m" {{ {QUAD} }}
}}
def Xform "proxy" {{
    uniform token purpose = "proxy"
    def Mesh "m" {{ {QUAD} }}
}}
def Xform "far" {{
    double3 xformOp:translate = (1e6, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "m" {{ {QUAD} }}
}}
"#
    );
    same(&text, &coarse(None), [4, 4, 0, 0, 0, 0]);
    let settings = ReadSettings {
        purposes: vec![Purpose::Proxy],
        ..coarse(None)
    };
    same(&text, &settings, [4, 4, 0, 0, 0, 0]);
    let settings = ReadSettings {
        mask: vec!["/far".to_owned()],
        ..coarse(None)
    };
    let far = same(&text, &settings, [1, 1, 0, 0, 0, 0]);
    assert!(far.origin.distance(DVec3::X * 1e6) < 10.0);
}

#[test]
fn nested_native_instances_and_point_instancers() {
    let text = format!(
        r#"
def Xform "Library" {{
    token visibility = "invisible"
    def Xform "leaf" {{
        color3f[] primvars:displayColor = [(0.2, 0.4, 0.6)]
        def Mesh "m" {{ {QUAD} }}
    }}
    def Xform "branch" {{
        def "x" ( instanceable = true
            references = </Library/leaf> ) {{
            double3 xformOp:translate = (3, 0, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}
        def "y" ( instanceable = true
            references = </Library/leaf> ) {{
        }}
    }}
}}
def "one" ( instanceable = true
    references = </Library/branch> ) {{
}}
def "two" ( instanceable = true
    references = </Library/branch> ) {{
    double3 xformOp:translate = (0, 7, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
def PointInstancer "points" {{
    int[] protoIndices = [0, 1, 1, 0]
    point3f[] positions = [(0, 0, 0), (1, 0.1, 0), (2, 0, 0), (3, 0, 0)]
    quath[] orientations = [(1, 0, 0, 0), (0.7, 0.7, 0, 0), (0.5, 0.5, 0.5, 0.5), (1, 0, 0, 0)]
    float3[] scales = [(1, 1, 1), (2, 1, 1), (1, 1, 0.5), (1, 1, 1)]
    int64[] ids = [10, 11, 12, 13]
    int64[] invisibleIds = [13]
    rel prototypes = [<Protos/ball>, <Protos/bush>]
    def Scope "Protos" {{
        def Cube "ball" {{
            double size = 0.1
        }}
        def "bush" ( instanceable = true
            references = </Library/branch> ) {{
        }}
    }}
}}
"#
    );
    // The leaf once for each of the two that hand down a color, and the ball.
    same(&text, &coarse(None), [4 + 1 + 2 * 2, 3, 0, 0, 0, 0]);
}

const SHADED: &str = r#"
def Scope "Looks" {
    def Material "Red" {
        token outputs:surface.connect = </Looks/Red/s.outputs:surface>
        def Shader "s" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </Looks/Red/t.outputs:rgb>
            float inputs:roughness.connect = </Looks/Red/t.outputs:a>
            color3f inputs:emissiveColor.connect = </Looks/Red/c.outputs:result>
            float inputs:metallic = 0.3
            token outputs:surface
        }
        def Shader "t" {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @./map.png@ ( colorSpace = "sRGB" )
            float2 inputs:st.connect = </Looks/Red/x.outputs:result>
            token inputs:wrapS = "repeat"
            float4 inputs:scale = (0.5, 0.6, 0.7, 1)
            token inputs:sourceColorSpace = "raw"
            float3 outputs:rgb
            float outputs:a
        }
        def Shader "x" {
            uniform token info:id = "UsdTransform2d"
            float2 inputs:in.connect = </Looks/Red/r.outputs:result>
            float inputs:rotation = 30
            float2 inputs:scale = (2, 3)
            float2 inputs:translation = (0.1, 0.2)
            float2 outputs:result
        }
        def Shader "r" {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "uv"
            float2 outputs:result
        }
        def Shader "c" {
            uniform token info:id = "UsdPrimvarReader_float3"
            string inputs:varname = "glow"
            float3 outputs:result
        }
    }
    def Material "Blue" {
        token outputs:surface.connect = </Looks/Blue/s.outputs:surface>
        def Shader "s" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.1, 0.2, 0.9)
            float inputs:opacity = 0.5
            token outputs:surface
        }
    }
    def Material "Unused" {
    }
}
"#;

#[test]
fn materials_subsets_and_collections() {
    let text = format!(
        r#"
{SHADED}
def Xform "W" ( prepend apiSchemas = ["CollectionAPI:bound", "MaterialBindingAPI"] ) {{
    rel collection:bound:includes = [</W/byCollection>]
    rel material:binding:collection:bound = [</W.collection:bound>, </Looks/Blue>]
    def Mesh "direct" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {{
        {QUAD}
        rel material:binding = </Looks/Red>
        texCoord2f[] primvars:uv = [(0, 0), (1, 0), (1, 1), (0, 1)] ( interpolation = "vertex" )
        color3f[] primvars:glow = [(0, 0, 1)]
    }}
    def Mesh "byCollection" {{ {QUAD} }}
    def Mesh "parts" {{
        int[] faceVertexCounts = [3, 3]
        int[] faceVertexIndices = [0, 1, 2, 2, 1, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]
        uniform token subdivisionScheme = "none"
        def GeomSubset "half" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [1]
            rel material:binding = </Looks/Red>
        }}
    }}
}}
"#
    );
    let scene = same(&text, &coarse(None), [3, 3, 2, 0, 0, 0]);
    let of_parts = &scene.prims[2].materials;
    assert_eq!(
        (of_parts.of_face(0), of_parts.of_face(1).is_some()),
        (None, true)
    );
    let settings = ReadSettings {
        materials: false,
        ..coarse(None)
    };
    same(&text, &settings, [3, 3, 0, 0, 0, 0]);
}

const LIT: &str = r#"
(
    renderSettingsPrimPath = "/Render/final"
)
def Xform "rig" {
    double3 xformOp:translate = (1, 2, 3)
    float xformOp:rotateX = -30
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]
    def DistantLight "sun" {
        float inputs:angle = 1
        float inputs:intensity = 3.3
    }
    def SphereLight "bulb" ( prepend apiSchemas = ["ShapingAPI", "ShadowAPI"] ) {
        float inputs:radius = 0.1
        float inputs:exposure = 2.5
        bool inputs:enableColorTemperature = 1
        float inputs:colorTemperature = 3000
        float inputs:shaping:cone:angle = 40
        float inputs:shaping:cone:softness = 0.2
        float inputs:shaping:focus = 1.5
        bool inputs:shadow:enable = 0
    }
    def RectLight "panel" {
        float inputs:width = 2
        asset inputs:texture:file = @./map.png@
        bool inputs:normalize = 1
    }
    def DiskLight "disk" { color3f inputs:color = (1, 0.5, 0.1)
    }
    def CylinderLight "tube" { float inputs:length = 3
    }
    def DomeLight "sky" { asset inputs:texture:file = @./map.png@
    }
    def DomeLight_1 "sky1" { uniform token poleAxis = "Z"
    }
    def SphereLight "old" {
        float intensity = 7
        float exposure = 1
        float radius = 0.2
        bool normalize = 1
        color3f color = (1, 0, 0)
        bool enableColorTemperature = 1
        float colorTemperature = 2500
        float shaping:cone:angle = 20
    }
    def SphereLight "off" { token visibility = "invisible"
    }
    def Camera "cam" {
        float focalLength = 35
        float horizontalAperture = 36
        float verticalAperture = 24.3
        float2 clippingRange = (0.01, 500)
        float exposure = 0.5
    }
    def Camera "flat" { token projection = "orthographic"
    }
}
def Scope "Render" {
    def RenderSettings "final" {
        rel camera = </rig/cam>
        uniform int2 resolution = (320, 200)
        uniform token[] includedPurposes = ["default", "proxy"]
        rel products = [</Render/beauty>]
    }
    def RenderSettings "other" {
    }
    def RenderProduct "beauty" {
        token productName = "out.exr"
        rel orderedVars = [</Render/color>, </Render/n>]
        uniform float pixelAspectRatio = 1.5
    }
    def RenderVar "color" { uniform string sourceName = "Ci"
    }
    def RenderVar "n" {
        uniform token dataType = "normal3f"
        uniform string sourceName = "N"
    }
}
"#;

#[test]
fn lights_cameras_and_render_settings() {
    let scene = same(LIT, &coarse(None), [0, 0, 0, 8, 2, 2]);
    assert_eq!(scene.render_settings[0].products[0].vars.len(), 2);
    let settings = ReadSettings {
        lights: false,
        ..coarse(None)
    };
    same(LIT, &settings, [0, 0, 0, 0, 2, 2]);
}

#[test]
fn time_samples_between_frames() {
    let text = r#"
(
    startTimeCode = 1
    endTimeCode = 4
    timeCodesPerSecond = 25
)
def Xform "a" {
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (1, 0.3, 7) }
    quatf xformOp:orient.timeSamples = { 1: (1, 0, 0, 0), 4: (0.5, 0.5, 0.5, 0.5) }
    float3 xformOp:rotateXYZ.timeSamples = { 0: (0, 0, 0), 4: (10, 20, 400) }
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient", "xformOp:rotateXYZ"]
    token visibility.timeSamples = { 1: "inherited", 3: "invisible" }
    def Mesh "m" {
        int[] faceVertexCounts.timeSamples = { 1: [3], 2: [4] }
        int[] faceVertexIndices.timeSamples = { 1: [0, 1, 2], 2: [0, 1, 2, 3] }
        point3f[] points.timeSamples = { 1: [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], 3: [(0, 0, 0), (1, 0, 0), (1, 1, 0.7), (0, 1.1, 0)] }
        color3f[] primvars:displayColor.timeSamples = { 1: [(0, 0, 0)], 3: [(1, 0.3, 0.1)] }
    }
}
def SphereLight "l" {
    float inputs:intensity.timeSamples = { 1: 1, 3: 4 }
    color3f inputs:color.timeSamples = { 1: (1, 1, 1), 2: None }
}
def Camera "c" { float focalLength.timeSamples = { 1: 20, 2: 50 }
}
"#;
    same(text, &coarse(Some(1.7)), [1, 1, 0, 1, 1, 0]);
    same(text, &coarse(Some(2.25)), [1, 1, 0, 1, 1, 0]);
    same(text, &coarse(Some(-5.0)), [1, 1, 0, 1, 1, 0]);
    same(text, &coarse(Some(100.0)), [0, 0, 0, 1, 1, 0]);
}

#[test]
fn the_comparison_tells_equal_from_rounded_from_different() {
    assert_eq!(alike("a(1.0, 2.0)", "a(1.0, 2.0)"), Some(false));
    assert_eq!(alike("a(1.0, 2.0)", "a(1.0000001, 2.0)"), Some(true));
    assert_eq!(alike("a(0.0, 2.0)", "a(1e-9, 2.0)"), Some(true));
    assert_eq!(alike("a(1.0, 2.0)", "a(1.00001, 2.0)"), None);
    assert_eq!(alike("a(1.0, 2.0)", "b(1.0, 2.0)"), None);
    assert_eq!(alike("a(1.0)", "a(1.0, 2.0)"), None);
    assert_eq!(alike("a(NaN)", "a(1.0)"), None);
}
