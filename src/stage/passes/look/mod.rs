//! Materials and their bindings, lights, cameras, render settings.

mod bindings;
mod blackbody;
mod cameras;
mod collections;
#[cfg(test)]
mod fixture;
pub mod light_groups;
mod lights;
pub(super) mod links;
mod materials;
pub(super) mod mesh_lights;
mod network;
mod paths;
mod reduce;
mod render;
mod textures;
mod values;

use super::super::ReadSettings;
use super::super::raw::RawStage;
use super::flatten::Occurrence;
use crate::diagnostics::Diagnostics;
use crate::scene::{Camera, Light, Material, MaterialId, Purpose, RenderSettings, UpAxis};
use bindings::{ALL_PURPOSE, Bindings};
use glam::DVec3;
use paths::Paths;
use std::collections::{BTreeSet, HashMap};

/// Everything of a stage that is not geometry.
#[derive(Debug, Clone, Default)]
pub struct Look {
    /// Materials that some prim binds, in order of first use.
    pub materials: Vec<Material>,
    /// For each occurrence, the material that applies to it (meaningful for gprims and GeomSubset prims: the strongest of
    /// direct, inherited and collection bindings, purposes `full` then all-purpose).
    pub binding: Vec<Option<MaterialId>>,
    /// Visible lights, not yet linked to prims.
    pub lights: Vec<Light>,
    /// What links each of them.
    pub links: Vec<links::Links>,
    /// Visible meshes that are lights.
    pub mesh_lights: Vec<mesh_lights::MeshLight>,
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// Render settings, the stage's own choice first.
    pub render_settings: Vec<RenderSettings>,
    /// Names of primvars (without prefix) that the bound materials read, sorted; always includes `displayColor` and
    /// `displayOpacity` when materials are wanted.
    pub primvars: Vec<String>,
}

/// Resolve the look of the flattened stage. `origin` is subtracted from light transforms.
pub fn resolve(
    raw: &RawStage,
    occurrences: &[Occurrence],
    origin: DVec3,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Look {
    let paths = Paths::new(raw, occurrences);
    let render_settings = render::read(raw, &paths, diagnostics);
    let mut look = Look {
        binding: vec![None; occurrences.len()],
        cameras: cameras::read(&paths, diagnostics),
        ..Look::default()
    };
    if settings.materials {
        let chosen = raw.meta.render_settings_prim_path.as_ref();
        let chosen = render_settings
            .iter()
            .find(|settings| Some(&settings.path) == chosen);
        bind(&mut look, &paths, &binding_purposes(chosen), diagnostics);
    }
    if settings.lights {
        let is_shown = |occurrence: &Occurrence| {
            let purpose = occurrence.purpose;
            occurrence.visible
                && (purpose == Purpose::Default || settings.purposes.contains(&purpose))
        };
        let lights = lights::read(&paths, is_shown, origin, up_axis(raw), diagnostics);
        (look.lights, look.links) = lights.into_iter().unzip();
        look.mesh_lights = lights::read_meshes(&paths, is_shown, diagnostics);
    }
    look.render_settings = render_settings;
    look
}

fn up_axis(raw: &RawStage) -> UpAxis {
    match raw.meta.up_axis.as_deref() {
        Some("Z") => UpAxis::Z,
        _ => UpAxis::Y,
    }
}

/// Material purposes by priority: those of the stage's own render settings, else `full`; always all-purpose last.
fn binding_purposes(chosen: Option<&RenderSettings>) -> Vec<&str> {
    let mut purposes = match chosen {
        Some(settings) => settings
            .material_binding_purposes
            .iter()
            .map(String::as_str)
            .collect(),
        None => vec!["full"],
    };
    purposes.retain(|purpose| *purpose != ALL_PURPOSE);
    purposes.push(ALL_PURPOSE);
    purposes
}

/// Fill `look.binding`, `look.materials` and `look.primvars`.
fn bind(look: &mut Look, paths: &Paths<'_>, purposes: &[&str], diagnostics: &Diagnostics) {
    let mut bindings = Bindings::new(paths, purposes, diagnostics);
    let mut ids: HashMap<usize, MaterialId> = HashMap::new();
    for index in 0..paths.occurrences().len() {
        if !takes_material(&paths.prim_of(index).type_name) {
            continue;
        }
        let Some(bound) = bindings.of(index) else {
            continue;
        };
        let path = paths.stage_path(bound.material, bound.at);
        let material = paths.find(bound.material);
        let material = material.filter(|&prim| paths.prim(prim).type_name == "Material");
        let Some(material) = material else {
            let message = format!(
                "binding to {path}, which is no Material: prims bound to it have their displayColor"
            );
            diagnostics.warn(
                "missing-material",
                &paths.occurrences()[bound.at].path,
                message,
            );
            continue;
        };
        let id = *ids.entry(material).or_insert_with(|| {
            let read = materials::read(paths, material, &path, diagnostics);
            look.materials.push(read);
            let id = u32::try_from(look.materials.len() - 1);
            MaterialId(id.expect("fewer materials than prims, and those fit in memory"))
        });
        look.binding[index] = Some(id);
    }
    let mut primvars = BTreeSet::from(["displayColor", "displayOpacity"]);
    primvars.extend(look.materials.iter().flat_map(materials::primvars));
    primvars.remove("");
    look.primvars = primvars.into_iter().map(str::to_owned).collect();
}

/// Gprims and GeomSubset prims: what a material can show on.
fn takes_material(type_name: &str) -> bool {
    matches!(
        type_name,
        "Mesh"
            | "GeomSubset"
            | "Cube"
            | "Sphere"
            | "Cylinder"
            | "Cylinder_1"
            | "Capsule"
            | "Capsule_1"
            | "Cone"
            | "Plane"
            | "BasisCurves"
            | "HermiteCurves"
            | "NurbsCurves"
            | "NurbsPatch"
            | "Points"
            | "TetMesh"
            | "Volume"
    )
}

#[cfg(test)]
mod tests {
    use super::fixture::Fixture;
    use super::*;
    use crate::scene::Input;

    fn stage() -> Fixture {
        Fixture::default()
            .prim("/L", "Scope")
            .prim("/L/unused", "Material")
            .prim("/L/M", "Material")
            .connect("outputs:surface", "/L/M/S.outputs:surface")
            .prim("/L/M/S", "Shader")
            .token("info:id", "UsdPreviewSurface")
            .connect("inputs:diffuseColor", "/L/M/R.outputs:result")
            .prim("/L/M/R", "Shader")
            .token("info:id", "UsdPrimvarReader_float3")
            .token("inputs:varname", "tint")
            .prim("/W", "Xform")
            .rel("material:binding", &["/L/M"])
            .prim("/W/a", "Mesh")
            .prim("/W/b", "Sphere")
            .prim("/W/light", "SphereLight")
            .prim("/W/c", "Mesh")
            .rel("material:binding", &["/L/gone"])
    }

    fn resolved(settings: &ReadSettings) -> (Look, usize) {
        let stage = stage();
        let mut occurrences = stage.occurrences();
        let light = occurrences
            .iter_mut()
            .find(|o| o.path == "/W/light")
            .unwrap();
        light.purpose = Purpose::Guide;
        let diagnostics = Diagnostics::default();
        let look = resolve(
            &stage.raw,
            &occurrences,
            DVec3::ZERO,
            settings,
            &diagnostics,
        );
        (look, diagnostics.warnings().len())
    }

    #[test]
    fn only_bound_materials_are_read_and_once() {
        let (look, warnings) = resolved(&ReadSettings::default());
        assert_eq!(look.materials.len(), 1);
        assert_eq!(look.materials[0].path, "/L/M");
        assert!(
            matches!(&look.materials[0].diffuse_color, Input::Primvar { name, .. } if name == "tint")
        );
        let bound = [6, 7].map(|gprim| look.binding[gprim]);
        assert_eq!(bound, [Some(MaterialId(0)); 2]);
        assert_eq!(look.binding.iter().flatten().count(), 2);
        assert_eq!(look.primvars, ["displayColor", "displayOpacity", "tint"]);
        assert_eq!(warnings, 1, "the missing material");
    }

    #[test]
    fn lights_of_other_purposes_and_unwanted_looks_are_left_out() {
        assert!(resolved(&ReadSettings::default()).0.lights.is_empty());
        let purposes = vec![Purpose::Guide];
        let with_guides = ReadSettings {
            purposes,
            ..ReadSettings::default()
        };
        assert_eq!(resolved(&with_guides).0.lights.len(), 1);
        let bare = ReadSettings {
            materials: false,
            lights: false,
            ..ReadSettings::default()
        };
        let (look, warnings) = resolved(&bare);
        assert!(look.materials.is_empty() && look.lights.is_empty() && look.primvars.is_empty());
        assert_eq!(
            (look.binding.len(), warnings),
            (stage().occurrences().len(), 0)
        );
    }
}
