//! The stage to look at: the bake sublayered over the asset, with a material that shows `displayColor` as it is.
//!
//! Viewers show `displayColor` only where no material is bound, and Blender not even then. So every baked mesh is
//! bound here, and only here, to a preview surface whose emission is that primvar: black diffuse and specular, so that
//! no light of the scene is added. The binding is stronger than that of a `GeomSubset`, and made for both purposes since a
//! binding for a purpose beats one without. What may still win: collection bindings, and an ancestor's binding that
//! is itself stronger than its descendants.

use super::opinions::{Declaration, Opinions};
use super::{Error, Provenance, save};
use crate::scene::{StageInfo, UpAxis};
use openusd::gf;
use openusd::sdf::{FieldKey, Path as SdfPath, PathListOp, SpecType, TokenListOp, Value};
use openusd::tf::Token;
use std::collections::{BTreeMap, HashMap};
use std::path::{Component, Path, PathBuf};

/// Write `DIR/NAME_baked.usda` for the bake at `bake` = `DIR/NAME.*`, which comes from `provenance`; `shown` are the prims whose `displayColor` it
/// shows (none = the asset's own look). Returns its path.
///
/// # Errors
/// When the file cannot be written.
pub(super) fn write(
    stage: &StageInfo,
    bake: &Path,
    shown: &[String],
    provenance: &Provenance,
) -> Result<PathBuf, Error> {
    let path = path_for(bake);
    let mut layer = Opinions::new();
    author_stage(&mut layer, stage, bake, &path);
    let made = Value::Dictionary(provenance.dictionary(&stage.path));
    layer.set(&SdfPath::abs_root(), FieldKey::CustomLayerData, made);
    choose_variants(&mut layer, stage)?;
    if !shown.is_empty() {
        let material = author_material(&mut layer, stage)?;
        for prim in shown {
            bind(&mut layer, prim, &material)?;
        }
    }
    save(layer, &path)?;
    Ok(path)
}

/// The variants that were baked: the asset's own choice may have other points.
fn choose_variants(layer: &mut Opinions, stage: &StageInfo) -> Result<(), Error> {
    let mut by_prim: BTreeMap<&str, HashMap<String, String>> = BTreeMap::new();
    for [prim, set, variant] in &stage.variants {
        let chosen = by_prim.entry(prim.as_str()).or_default();
        chosen.insert(set.clone(), variant.clone());
    }
    for (prim, chosen) in by_prim {
        let prim = layer.over(prim)?;
        let chosen = Value::VariantSelectionMap(chosen);
        layer.set(&prim, FieldKey::VariantSelection, chosen);
    }
    Ok(())
}

/// `DIR/NAME_baked.usda` for `DIR/NAME.usdc`.
pub fn path_for(bake: &Path) -> PathBuf {
    let stem = bake.file_stem().unwrap_or_default().to_string_lossy();
    bake.with_file_name(format!("{stem}_baked.usda"))
}

fn author_stage(layer: &mut Opinions, stage: &StageInfo, bake: &Path, path: &Path) {
    let root = SdfPath::abs_root();
    let up_axis = match stage.up_axis {
        UpAxis::Y => "Y",
        UpAxis::Z => "Z",
    };
    let sublayers = vec![asset_path(bake, path), asset_path(&stage.path, path)];
    layer.set(&root, FieldKey::SubLayers, Value::StringVec(sublayers));
    if let Some(prim) = &stage.default_prim {
        layer.set(
            &root,
            FieldKey::DefaultPrim,
            Value::Token(prim.as_str().into()),
        );
    }
    layer.set(&root, "upAxis", Value::Token(Token::new(up_axis)));
    layer.set(&root, "metersPerUnit", Value::Double(stage.meters_per_unit));
    let rate = Value::Double(stage.time_codes_per_second);
    layer.set(&root, FieldKey::TimeCodesPerSecond, rate);
    super::layer::author_range(layer, stage);
}

/// How the layer at `from` names `file`: relative where both are files of this machine, else as it was given.
pub fn asset_path(file: &Path, from: &Path) -> String {
    let text = || file.to_string_lossy().into_owned();
    if file.to_string_lossy().contains("://") {
        return text();
    }
    let folder = from.parent().and_then(absolute);
    match folder.zip(absolute(file)) {
        Some((folder, file)) => relative(&file, &folder).unwrap_or_else(text),
        None => text(),
    }
}

/// Absolute and free of `.` and `..`, by the words of the path alone, as USD anchors paths.
fn absolute(path: &Path) -> Option<PathBuf> {
    let path = if path.as_os_str().is_empty() {
        Path::new(".")
    } else {
        path
    };
    let mut clean = PathBuf::new();
    for component in std::path::absolute(path).ok()?.components() {
        match component {
            Component::CurDir => {}
            Component::ParentDir => {
                clean.pop();
            }
            other => clean.push(other),
        }
    }
    Some(clean)
}

/// `file` seen from `folder`, starting with `./` or `../`; `None` if they share no root (Windows drives).
fn relative(file: &Path, folder: &Path) -> Option<String> {
    let shared = file.components().zip(folder.components());
    let shared = shared.take_while(|(a, b)| a == b).count();
    if shared == 0 {
        return None;
    }
    let ups = folder.components().count() - shared;
    let start = if ups == 0 {
        "./".to_owned()
    } else {
        "../".repeat(ups)
    };
    let rest = file.components().skip(shared);
    let rest: Vec<_> = rest
        .map(|part| part.as_os_str().to_string_lossy())
        .collect();
    Some(start + &rest.join("/"))
}

/// The unlit material. It lies below the default prim, so that it comes along when the stage is referenced.
pub(super) fn author_material(layer: &mut Opinions, stage: &StageInfo) -> Result<SdfPath, Error> {
    let parent = stage
        .default_prim
        .as_deref()
        .unwrap_or_default()
        .trim_matches('/');
    let slash = if parent.is_empty() { "" } else { "/" };
    let path = format!("{slash}{parent}/surflux_display");
    let material = layer.define(&path, "Material")?;
    let surface = layer.define(&format!("{path}/surface"), "Shader")?;
    let reader = layer.define(&format!("{path}/color"), "Shader")?;
    let word = |word: &'static str| Value::Token(Token::new(word));
    let black = || Value::Vec3f(gf::Vec3f::from([0.0; 3]));

    layer.uniform(&surface, "info:id", "token", word("UsdPreviewSurface"))?;
    input(
        layer,
        &surface,
        ("inputs:diffuseColor", "color3f"),
        Some(black()),
    )?;
    input(
        layer,
        &surface,
        ("inputs:useSpecularWorkflow", "int"),
        Some(Value::Int(1)),
    )?;
    input(
        layer,
        &surface,
        ("inputs:specularColor", "color3f"),
        Some(black()),
    )?;
    input(
        layer,
        &surface,
        ("inputs:roughness", "float"),
        Some(Value::Float(1.0)),
    )?;
    let emissive = input(layer, &surface, ("inputs:emissiveColor", "color3f"), None)?;
    let out = input(layer, &surface, ("outputs:surface", "token"), None)?;

    layer.uniform(&reader, "info:id", "token", word("UsdPrimvarReader_float3"))?;
    let name = Value::String("displayColor".to_owned());
    input(layer, &reader, ("inputs:varname", "string"), Some(name))?;
    let result = input(layer, &reader, ("outputs:result", "float3"), None)?;

    let surface_out = input(layer, &material, ("outputs:surface", "token"), None)?;
    for (from, to) in [(&emissive, result), (&surface_out, out)] {
        let connection = Value::PathListOp(PathListOp::explicit([to]));
        layer.set(from, FieldKey::ConnectionPaths, connection);
    }
    Ok(material)
}

fn input(
    layer: &mut Opinions,
    shader: &SdfPath,
    (name, type_name): (&str, &str),
    value: Option<Value>,
) -> Result<SdfPath, Error> {
    let declaration = Declaration {
        name,
        type_name,
        interpolation: None,
    };
    let path = layer.attribute(shader, declaration)?;
    if let Some(value) = value {
        layer.set(&path, FieldKey::Default, value);
    }
    Ok(path)
}

/// Bind `material` to `prim`, stronger than what is below.
pub(super) fn bind(layer: &mut Opinions, prim: &str, material: &SdfPath) -> Result<(), Error> {
    let prim = layer.over(prim)?;
    let schema = TokenListOp::prepended([Token::new("MaterialBindingAPI")]);
    layer.set(&prim, FieldKey::ApiSchemas, Value::TokenListOp(schema));
    for name in [
        "material:binding",
        "material:binding:full",
        "material:binding:preview",
    ] {
        let binding = layer.property(&prim, name, SpecType::Relationship)?;
        let target = Value::PathListOp(PathListOp::explicit([material.clone()]));
        layer.set(&binding, FieldKey::TargetPaths, target);
        let stronger = Value::Token(Token::new("strongerThanDescendants"));
        layer.set(&binding, "bindMaterialAs", stronger);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_named_from_the_folder_of_the_layer() {
        let name = |file, from| asset_path(Path::new(file), Path::new(from));
        assert_eq!(name("/a/b/asset.usd", "/a/b/x_baked.usda"), "./asset.usd");
        assert_eq!(
            name("/a/b/asset.usd", "/a/c/d/x_baked.usda"),
            "../../b/asset.usd"
        );
        assert_eq!(
            name("/a/./b/../asset.usd", "/a/x_baked.usda"),
            "./asset.usd"
        );
        assert_eq!(name("asset.usd", "x_baked.usda"), "./asset.usd");
        assert_eq!(name("asset://shot/1", "/a/x_baked.usda"), "asset://shot/1");
    }

    #[test]
    fn the_stage_to_look_at_stands_beside_its_bake() {
        assert_eq!(
            path_for(Path::new("d/out.usdc")),
            Path::new("d/out_baked.usda")
        );
    }
}
