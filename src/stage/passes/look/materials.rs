//! Material prims → [`Material`]: finds the surface shader and reads its inputs.

use super::network::{Source, shader_id, source, value};
use super::paths::Paths;
use super::reduce;
use super::textures::{primvar_read, texture_read};
use super::values::{color, number};
use crate::diagnostics::Diagnostics;
use crate::scene::{Input, Material};
use glam::Vec4;

/// Deepest chain of computing nodes followed.
const MAX_NODES: usize = 16;

/// What an input is, which decides how a single number or a color is understood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// One number in x.
    Scalar,
    /// Three in xyz.
    Color,
}

/// Reads the inputs of shaders.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reader<'a> {
    /// The stage.
    pub(super) paths: &'a Paths<'a>,
    /// Where flaws go.
    pub(super) diagnostics: &'a Diagnostics,
    /// Stage path of the material being read.
    pub(super) material: &'a str,
}

/// Read the Material prim at index `prim`, named `path` on the stage.
pub(super) fn read(
    paths: &Paths<'_>,
    prim: usize,
    path: &str,
    diagnostics: &Diagnostics,
) -> Material {
    let reader = Reader {
        paths,
        diagnostics,
        material: path,
    };
    let surface = reader.surface(prim);
    Material {
        path: path.to_owned(),
        displacement: reader.displacement(prim),
        ..surface
    }
}

/// Outputs whose displacement counts, the one understood best first.
const DISPLACEMENTS: [&str; 3] = [
    "outputs:glslfx:displacement",
    "outputs:displacement",
    "outputs:mtlx:displacement",
];

/// Render contexts whose surface is understood best, then the universal one, then whatever there is.
fn surface_outputs<'a>(paths: &Paths<'a>, prim: usize) -> Vec<&'a str> {
    let rank = |name: &str| match name {
        "outputs:glslfx:surface" => 0,
        "outputs:surface" => 1,
        "outputs:mtlx:surface" => 2,
        _ => 3,
    };
    let names = paths.prim(prim).attributes.keys().map(String::as_str);
    let is_surface = |name: &&str| {
        *name == "outputs:surface" || (name.starts_with("outputs:") && name.ends_with(":surface"))
    };
    let mut outputs: Vec<&str> = names.filter(is_surface).collect();
    outputs.sort_by_key(|name| (rank(name), *name));
    outputs
}

/// True for the shader every renderer knows, also under its MaterialX name.
fn is_preview_surface(id: &str) -> bool {
    id == "UsdPreviewSurface" || id == "ND_UsdPreviewSurface_surfaceshader"
}

impl Reader<'_> {
    fn surface(&self, prim: usize) -> Material {
        let shaders: Vec<usize> = surface_outputs(self.paths, prim)
            .into_iter()
            .filter_map(|output| match source(self.paths, prim, output) {
                Source::Node { prim, .. } => Some(prim),
                _ => None,
            })
            .collect();
        let id = |shader: usize| shader_id(self.paths.prim(shader));
        if let Some(&shader) = shaders
            .iter()
            .find(|&&shader| is_preview_surface(id(shader)))
        {
            return self.preview_surface(shader);
        }
        if let Some(reduced) = shaders
            .iter()
            .find_map(|&shader| reduce::surface(self, shader))
        {
            return reduced;
        }
        let why = match shaders.first() {
            Some(&shader) => format!("surface shader `{}` is not known", id(shader)),
            None => "it has no surface shader".to_owned(),
        };
        let consequence = "it is shaded as 0.18 gray without emission";
        self.diagnostics.warn(
            "unsupported-material",
            self.material,
            format!("{why}: {consequence}"),
        );
        Material::default()
    }

    /// What moves the surface of the material `prim`; with a warning nothing, where that is no UsdPreviewSurface.
    fn displacement(&self, prim: usize) -> Input {
        let default = Input::scalar(0.0);
        let of = |output: &&str| match source(self.paths, prim, output) {
            Source::Node { prim, .. } => Some(prim),
            _ => None,
        };
        let Some(shader) = DISPLACEMENTS.iter().find_map(of) else {
            return default;
        };
        let id = shader_id(self.paths.prim(shader));
        if is_preview_surface(id) {
            return self.input(shader, "displacement", Kind::Scalar, default);
        }
        let message =
            format!("displacement shader `{id}` is not known: the surface stays where it is");
        self.diagnostics
            .warn("unsupported-displacement", self.material, message);
        default
    }

    fn preview_surface(&self, shader: usize) -> Material {
        let default = Material::default();
        let scalar = |name: &str, default: Input| self.input(shader, name, Kind::Scalar, default);
        let color = |name: &str, default: Input| self.input(shader, name, Kind::Color, default);
        Material {
            diffuse_color: color("diffuseColor", default.diffuse_color),
            emissive_color: color("emissiveColor", default.emissive_color),
            metallic: scalar("metallic", default.metallic),
            roughness: scalar("roughness", default.roughness),
            opacity: scalar("opacity", default.opacity),
            opacity_threshold: scalar("opacityThreshold", default.opacity_threshold),
            specular_workflow: matches!(
                scalar("useSpecularWorkflow", Input::scalar(0.0)),
                Input::Constant(value) if value.x != 0.0
            ),
            specular_color: color("specularColor", default.specular_color),
            ior: scalar("ior", default.ior),
            clearcoat: scalar("clearcoat", default.clearcoat),
            clearcoat_roughness: scalar("clearcoatRoughness", default.clearcoat_roughness),
            normal: match source(self.paths, shader, "inputs:normal") {
                Source::Node { prim, output } => {
                    texture_read(self.paths, prim, output).map(Box::new)
                }
                _ => None,
            },
            ..default
        }
    }

    /// Input `name` of shader `prim`, `default` where it is not given or cannot be understood (then with a warning).
    pub(super) fn input(&self, prim: usize, name: &str, kind: Kind, default: Input) -> Input {
        self.authored_input(prim, name, kind).unwrap_or(default)
    }

    /// Input `name` of shader `prim`, if it is given and can be understood.
    pub(super) fn authored_input(&self, prim: usize, name: &str, kind: Kind) -> Option<Input> {
        match source(self.paths, prim, &format!("inputs:{name}")) {
            Source::Nothing => None,
            Source::Value(value, _) => {
                let found = color(value).filter(|value| value.is_finite());
                if found.is_none() {
                    self.warn_of_input(
                        prim,
                        name,
                        "has a value that is not a finite number or color",
                    );
                }
                found.map(|value| constant(value, kind))
            }
            Source::Node { prim: node, output } => {
                let found = self.node(node, output, 0);
                if found.is_none() {
                    let id = shader_id(self.paths.prim(node));
                    self.warn_of_input(
                        prim,
                        name,
                        &format!("comes from a node that is not understood (`{id}`)"),
                    );
                }
                found
            }
        }
    }

    fn node(&self, node: usize, output: &str, depth: usize) -> Option<Input> {
        if let Some((name, fallback)) = primvar_read(self.paths, node) {
            return Some(Input::Primvar { name, fallback });
        }
        let texture = texture_read(self.paths, node, output);
        let texture = texture.map(|read| Input::Texture(Box::new(read)));
        texture.or_else(|| self.computed(node, depth))
    }

    /// MaterialX nodes that a reduced input can express: constants, products with one, and those that pass a value on.
    fn computed(&self, node: usize, depth: usize) -> Option<Input> {
        let id = shader_id(self.paths.prim(node));
        let operation = id.strip_prefix("ND_")?.split('_').next()?;
        let operand = |name: &str| match source(self.paths, node, &format!("inputs:{name}")) {
            Source::Value(value, _) => {
                Some(Input::Constant(color(value).filter(|v| v.is_finite())?))
            }
            Source::Node { prim, output } if depth < MAX_NODES => {
                self.node(prim, output, depth + 1)
            }
            _ => None,
        };
        match operation {
            "constant" => operand("value"),
            "convert" | "dot" => operand("in"),
            "multiply" => match (operand("in1")?, operand("in2")?) {
                (input, Input::Constant(factor)) | (Input::Constant(factor), input)
                    if !matches!(input, Input::Primvar { .. }) =>
                {
                    Some(reduce::multiplied(input, factor))
                }
                _ => None,
            },
            "extract" => {
                let index = value(self.paths, node, "index")
                    .and_then(number)
                    .unwrap_or(0.0);
                channel_of(operand("in")?, index)
            }
            _ => None,
        }
    }

    fn warn_of_input(&self, prim: usize, name: &str, flaw: &str) {
        let shader = &self.paths.prim(prim).path;
        self.diagnostics.warn(
            "unsupported-material-input",
            self.material,
            format!("input `{name}` of {shader} {flaw}: its default is used"),
        );
    }
}

/// Component `index` of `input`.
fn channel_of(input: Input, index: f64) -> Option<Input> {
    let channels = [0_u8, 1, 2, 3];
    let channel = channels
        .into_iter()
        .find(|&channel| f64::from(channel) == index)?;
    match input {
        Input::Constant(value) => Some(Input::scalar(value[usize::from(channel)])),
        Input::Texture(mut read) if read.channel.is_none() => {
            read.channel = Some(channel);
            Some(Input::Texture(read))
        }
        _ => None,
    }
}

fn constant(value: Vec4, kind: Kind) -> Input {
    match kind {
        Kind::Scalar => Input::scalar(value.x),
        Kind::Color => Input::Constant(value.truncate().extend(1.0)),
    }
}

/// Names of the primvars that `material` reads.
pub(super) fn primvars(material: &Material) -> impl Iterator<Item = &str> {
    material
        .inputs()
        .into_iter()
        .filter_map(|(_, input)| match input {
            Input::Constant(_) => None,
            Input::Primvar { name, .. } => Some(name.as_str()),
            Input::Texture(read) => Some(read.uv.primvar.as_str()),
        })
}

#[cfg(test)]
mod tests {
    use super::super::fixture::Fixture;
    use super::*;
    use crate::scene::{ColorSpace, Wrap};
    use crate::stage::raw::Value;
    use glam::{DVec3, Vec2};

    fn read_material(stage: &Fixture) -> (Material, Vec<String>) {
        let occurrences = stage.occurrences();
        let paths = Paths::new(&stage.raw, &occurrences);
        let diagnostics = Diagnostics::default();
        let prim = stage.raw.find("/M").unwrap();
        let material = read(&paths, prim, "/M", &diagnostics);
        let kinds = diagnostics.warnings().into_iter().map(|w| w.kind).collect();
        (material, kinds)
    }

    fn preview() -> Fixture {
        Fixture::default()
            .prim("/M", "Material")
            .connect("outputs:surface", "/M/S.outputs:surface")
            .prim("/M/S", "Shader")
            .token("info:id", "UsdPreviewSurface")
    }

    fn asset(path: &str) -> Value {
        Value::Asset {
            authored: path.to_owned(),
            resolved: path.to_owned(),
        }
    }

    fn rgb(r: f64, g: f64, b: f64) -> Value {
        Value::Vec3(DVec3::new(r, g, b))
    }

    #[test]
    fn constants_and_defaults_are_those_of_the_specification() {
        let stage = preview()
            .value("inputs:diffuseColor", rgb(0.5, 0.25, 0.125))
            .number("inputs:metallic", 0.75)
            .value("inputs:useSpecularWorkflow", Value::Int(1));
        let (material, warnings) = read_material(&stage);
        let expected = Material {
            path: "/M".to_owned(),
            diffuse_color: Input::color(0.5, 0.25, 0.125),
            metallic: Input::scalar(0.75),
            specular_workflow: true,
            ..Material::default()
        };
        assert_eq!(material, expected);
        assert!(warnings.is_empty());
    }

    #[test]
    fn values_pass_through_interface_inputs_and_node_graphs() {
        let stage = Fixture::default()
            .prim("/M", "Material")
            .connect("outputs:surface", "/M/G.outputs:out")
            .value("inputs:tint", rgb(0.1, 0.2, 0.3))
            .prim("/M/G", "NodeGraph")
            .connect("outputs:out", "/M/G/S.outputs:surface")
            .connect("inputs:color", "/M.inputs:tint")
            .prim("/M/G/S", "Shader")
            .token("info:id", "UsdPreviewSurface")
            .connect("inputs:diffuseColor", "/M/G.inputs:color");
        let (material, warnings) = read_material(&stage);
        assert_eq!(material.diffuse_color, Input::color(0.1, 0.2, 0.3));
        assert!(warnings.is_empty());
    }

    #[test]
    fn textures_carry_their_file_channel_wrap_and_transformed_coordinates() {
        let stage = preview()
            .connect("inputs:diffuseColor", "/M/T.outputs:rgb")
            .connect("inputs:opacity", "/M/T.outputs:a")
            .prim("/M/T", "Shader")
            .token("info:id", "UsdUVTexture")
            .value("inputs:file", asset("/tex/a.png"))
            .token("inputs:wrapS", "repeat")
            .token("inputs:wrapT", "mirror")
            .token("inputs:sourceColorSpace", "sRGB")
            .connect("inputs:st", "/M/X.outputs:result")
            .prim("/M/X", "Shader")
            .token("info:id", "UsdTransform2d")
            .value("inputs:scale", Value::Vec2(glam::DVec2::new(2.0, 4.0)))
            .number("inputs:rotation", 90.0)
            .value(
                "inputs:translation",
                Value::Vec2(glam::DVec2::new(10.0, 20.0)),
            )
            .connect("inputs:in", "/M/R.outputs:result")
            .prim("/M/R", "Shader")
            .token("info:id", "UsdPrimvarReader_float2")
            .token("inputs:varname", "map1");
        let (material, warnings) = read_material(&stage);
        assert!(warnings.is_empty(), "{warnings:?}");
        let Input::Texture(color) = &material.diffuse_color else {
            panic!("no texture")
        };
        assert_eq!(color.file.to_str(), Some("/tex/a.png"));
        assert_eq!((color.wrap_s, color.wrap_t), (Wrap::Repeat, Wrap::Mirror));
        assert_eq!((color.channel, color.color_space), (None, ColorSpace::SRgb));
        assert_eq!(color.uv.primvar, "map1");
        // (1, 1) scaled is (2, 4), turned a quarter counter-clockwise (-4, 2), moved (6, 22).
        let moved = color.uv.transform.transform_point2(Vec2::ONE);
        assert!(moved.distance(Vec2::new(6.0, 22.0)) < 1e-5, "{moved}");
        let Input::Texture(opacity) = &material.opacity else {
            panic!("no texture")
        };
        assert_eq!(opacity.channel, Some(3));
        assert_eq!(primvars(&material).collect::<Vec<_>>(), ["map1", "map1"]);
    }

    #[test]
    fn primvar_readers_take_names_from_the_interface() {
        let stage = preview()
            .connect("inputs:emissiveColor", "/M/R.outputs:result")
            .prim("/M/R", "Shader")
            .token("info:id", "UsdPrimvarReader_float3")
            .connect("inputs:varname", "/M.inputs:name")
            .value("inputs:fallback", rgb(1.0, 2.0, 3.0));
        let mut stage = stage;
        let name = crate::stage::raw::RawAttribute::from(Value::Token("glow".to_owned()));
        stage.raw.prims[0]
            .attributes
            .insert("inputs:name".to_owned(), name);
        let (material, _) = read_material(&stage);
        let expected = Input::Primvar {
            name: "glow".to_owned(),
            fallback: Vec4::new(1.0, 2.0, 3.0, 1.0),
        };
        assert_eq!(material.emissive_color, expected);
    }

    #[test]
    fn other_shaders_are_reduced_by_the_names_of_their_inputs() {
        let stage = Fixture::default()
            .prim("/M", "Material")
            .connect("outputs:mtlx:surface", "/M/S.outputs:out")
            .prim("/M/S", "Shader")
            .token("info:id", "ND_standard_surface_surfaceshader")
            .value("inputs:base_color", rgb(0.5, 0.5, 1.0))
            .number("inputs:base", 0.5)
            .number("inputs:emission", 3.0)
            .value("inputs:emission_color", rgb(1.0, 0.0, 0.0))
            .number("inputs:specular_roughness", 0.3)
            .number("inputs:metalness", 0.2);
        let (material, warnings) = read_material(&stage);
        assert_eq!(material.diffuse_color, Input::color(0.25, 0.25, 0.5));
        assert_eq!(material.emissive_color, Input::color(3.0, 0.0, 0.0));
        assert_eq!(material.roughness, Input::scalar(0.3));
        assert_eq!(material.metallic, Input::scalar(0.2));
        assert_eq!(warnings, ["reduced-material"]);
    }

    #[test]
    fn what_cannot_be_read_is_default_with_one_warning() {
        let bare = Fixture::default().prim("/M", "Material");
        let unknown = Fixture::default()
            .prim("/M", "Material")
            .connect("outputs:surface", "/M/S.outputs:out")
            .prim("/M/S", "Shader")
            .token("info:id", "Mystery");
        let cycle = Fixture::default()
            .prim("/M", "Material")
            .connect("outputs:surface", "/M.inputs:a")
            .connect("inputs:a", "/M.inputs:a");
        for stage in [bare, unknown, cycle] {
            let (material, warnings) = read_material(&stage);
            let expected = Material {
                path: "/M".to_owned(),
                ..Material::default()
            };
            assert_eq!(material, expected);
            assert_eq!(warnings, ["unsupported-material"]);
        }
        let nan = preview().value("inputs:diffuseColor", rgb(f64::NAN, 0.0, 0.0));
        let (material, warnings) = read_material(&nan);
        assert_eq!(material.diffuse_color, Material::default().diffuse_color);
        assert_eq!(warnings, ["unsupported-material-input"]);
    }

    fn standard() -> Fixture {
        Fixture::default()
            .prim("/M", "Material")
            .connect("outputs:mtlx:surface", "/M/S.outputs:out")
            .prim("/M/S", "Shader")
            .token("info:id", "ND_standard_surface_surfaceshader")
    }

    #[test]
    fn a_standard_surface_without_inputs_has_the_defaults_of_its_definition() {
        let (material, _) = read_material(&standard());
        assert_eq!(material.diffuse_color, Input::color(0.8, 0.8, 0.8));
        assert_eq!(material.roughness, Input::scalar(0.2));
        assert_eq!(material.metallic, Input::scalar(0.0));
    }

    #[test]
    fn images_of_materialx_are_multiplied_split_and_placed() {
        let stage = standard()
            .connect("inputs:base_color", "/M/mul.outputs:out")
            .connect("inputs:specular_roughness", "/M/part.outputs:out")
            .prim("/M/mul", "Shader")
            .token("info:id", "ND_multiply_color3")
            .connect("inputs:in1", "/M/image.outputs:out")
            .value("inputs:in2", rgb(0.5, 0.25, 1.0))
            .prim("/M/part", "Shader")
            .token("info:id", "ND_extract_color3")
            .connect("inputs:in", "/M/image.outputs:out")
            .value("inputs:index", Value::Int(2))
            .prim("/M/image", "Shader")
            .token("info:id", "ND_image_color3")
            .value("inputs:file", asset("/a.png"))
            .connect("inputs:texcoord", "/M/place.outputs:out")
            .prim("/M/place", "Shader")
            .token("info:id", "ND_place2d_vector2")
            .value("inputs:scale", Value::Vec2(glam::DVec2::new(0.5, 0.25)))
            .value("inputs:offset", Value::Vec2(glam::DVec2::new(0.1, 0.0)));
        let (material, warnings) = read_material(&stage);
        assert_eq!(warnings, ["reduced-material"]);
        let Input::Texture(base) = material.diffuse_color else {
            panic!("a texture");
        };
        assert_eq!(base.scale, Vec4::new(0.5, 0.25, 1.0, 1.0));
        assert_eq!(base.wrap_s, Wrap::Repeat);
        // By the definition of place2d: (0.5, 0.5) / (0.5, 0.25) - (0.1, 0).
        let placed = base.uv.transform.transform_point2(Vec2::splat(0.5));
        assert!(placed.distance(Vec2::new(0.9, 2.0)) < 1e-6, "{placed}");
        let Input::Texture(roughness) = material.roughness else {
            panic!("a texture");
        };
        assert_eq!(roughness.channel, Some(2));
    }
}
