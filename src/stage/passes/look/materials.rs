//! Material prims → [`Material`]: finds the surface shader and reads its inputs.

use super::network::{Source, shader_id, source};
use super::paths::Paths;
use super::reduce;
use super::textures::{primvar_read, texture_read};
use super::values::color;
use crate::diagnostics::Diagnostics;
use crate::scene::{Input, Material};
use glam::{Vec3, Vec4};

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
    let mut material = reader.surface(prim);
    material.path = path.to_owned();
    material
}

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
            return self.preview_surface(shader, prim);
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

    fn preview_surface(&self, shader: usize, material: usize) -> Material {
        let default = Material::default();
        let scalar = |name: &str, default: Input| self.input(shader, name, Kind::Scalar, default);
        let color = |name: &str, default: Input| self.input(shader, name, Kind::Color, default);
        let displaces = source(self.paths, material, "outputs:displacement") != Source::Nothing;
        Material {
            path: String::new(),
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
            displacement: match displaces {
                true => scalar("displacement", default.displacement),
                false => default.displacement,
            },
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
                let found = self.node(node, output);
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

    fn node(&self, node: usize, output: &str) -> Option<Input> {
        if let Some((name, fallback)) = primvar_read(self.paths, node) {
            return Some(Input::Primvar { name, fallback });
        }
        let texture = texture_read(self.paths, node, output);
        texture.map(|read| Input::Texture(Box::new(read)))
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

fn constant(value: Vec4, kind: Kind) -> Input {
    match kind {
        Kind::Scalar => Input::scalar(value.x),
        Kind::Color => Input::Constant(Vec3::from(value.truncate()).extend(1.0)),
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
