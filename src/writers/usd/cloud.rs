//! [`SurfelCloud`] → a UsdGeomPoints file, as `stage::cloud` reads it back.
//!
//! ```text
//! def Xform "root"            translated by the cloud's origin, in double precision
//!   def Points "surfels"      SurfluxCloudAPI; one value of everything for each surfel
//! ```
//! `normals` is what renderers read, `primvars:N` the copy that Blender keeps. `displayColor` is radiosity / π: the
//! radiance a viewer would see. Every interpolation is authored, for lack of it means `constant` to some readers.

use super::opinions::{Array, Declaration, Opinions};
use super::points::{author, author_arrays};
use super::{Error, Provenance, author_metadata, save};
use crate::scene::StageInfo;
use crate::surfels::SurfelCloud;
use glam::Vec3;
use openusd::gf;
use openusd::sdf::{FieldKey, Path as SdfPath, TokenListOp, Value};
use openusd::tf::Token;
use rayon::prelude::*;
use std::collections::HashMap;
use std::f32::consts::FRAC_1_PI;
use std::path::Path;

/// What a cloud says of itself besides its surfels.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CloudOptions {
    /// Version, command line, comment.
    pub provenance: Provenance,
    /// Light group whose light it holds; `None` = all light.
    pub light_group: Option<String>,
}

/// Write `cloud`, baked from the stage that `scene_stage` tells of, to `path`.
///
/// # Errors
/// When the file cannot be written; nothing is left behind then.
pub fn write(
    cloud: &SurfelCloud,
    scene_stage: &StageInfo,
    path: &Path,
    options: &CloudOptions,
) -> Result<(), Error> {
    let mut layer = Opinions::new();
    author_metadata(&mut layer, scene_stage, &options.provenance);
    layer.set(
        &SdfPath::abs_root(),
        FieldKey::DefaultPrim,
        Value::Token(Token::new("root")),
    );
    author_root(&mut layer, cloud.origin)?;
    let surfels = layer.define("/root/surfels", "Points")?;
    author_about(&mut layer, &surfels, cloud, (scene_stage, options))?;
    author_columns(&mut layer, &surfels, cloud)?;
    save(layer, path)
}

/// `/root`, moved to `origin`.
pub(super) fn author_root(layer: &mut Opinions, origin: glam::DVec3) -> Result<(), Error> {
    let root = layer.define("/root", "Xform")?;
    if origin == glam::DVec3::ZERO {
        return Ok(());
    }
    let name = "xformOp:translate";
    let declaration = Declaration {
        name,
        type_name: "double3",
        interpolation: None,
    };
    let translate = layer.attribute(&root, declaration)?;
    let origin = gf::Vec3d::from(origin.to_array());
    layer.set(&translate, FieldKey::Default, Value::Vec3d(origin));
    let order = Value::TokenVec(vec![Token::new(name)]);
    layer.uniform(&root, "xformOpOrder", "token[]", order)?;
    Ok(())
}

/// Schema, source, spacing and the paths that `primvars:sourcePrim` counts.
fn author_about(
    layer: &mut Opinions,
    surfels: &SdfPath,
    cloud: &SurfelCloud,
    (stage, options): (&StageInfo, &CloudOptions),
) -> Result<(), Error> {
    let schemas = TokenListOp::prepended([Token::new("SurfluxCloudAPI")]);
    layer.set(surfels, FieldKey::ApiSchemas, Value::TokenListOp(schemas));
    let paths = Value::StringVec(cloud.prim_paths.clone());
    let surflux = HashMap::from([("primPaths".to_owned(), paths)]);
    let custom = HashMap::from([("surflux".to_owned(), Value::Dictionary(surflux))]);
    layer.set(surfels, FieldKey::CustomData, Value::Dictionary(custom));
    let string = |text: &str| Value::String(text.to_owned());
    let source = stage.path.to_string_lossy();
    let version = string(&options.provenance.version);
    layer.uniform(
        surfels,
        "surflux:spacing",
        "float",
        Value::Float(cloud.spacing),
    )?;
    layer.uniform(surfels, "surflux:sourceStage", "string", string(&source))?;
    layer.uniform(surfels, "surflux:version", "string", version)?;
    if let Some(group) = &options.light_group {
        layer.uniform(surfels, "surflux:lightGroup", "string", string(group))?;
    }
    Ok(())
}

fn author_columns(
    layer: &mut Opinions,
    surfels: &SdfPath,
    cloud: &SurfelCloud,
) -> Result<(), Error> {
    let display = cloud.radiosity.iter().map(|&b| b * FRAC_1_PI).collect();
    let widths = cloud.radius.iter().map(|radius| 2.0 * radius).collect();
    let sources = cloud.prim.iter();
    let sources = sources.map(|&prim| i32::try_from(prim).unwrap_or(i32::MAX));
    let extent = extent(&cloud.position, &cloud.radius);
    author(layer, surfels, ("extent", "float3[]"), extent)?;
    let vectors = |values: &[Vec3]| Array::Vectors(values.to_vec());
    let columns: [(&[&str], _, _); 8] = [
        (&["points"], "point3f[]", vectors(&cloud.position)),
        (&["widths"], "float[]", Array::Floats(widths)),
        (
            &["normals", "primvars:N"],
            "normal3f[]",
            vectors(&cloud.normal),
        ),
        (
            &["primvars:displayColor"],
            "color3f[]",
            Array::Vectors(display),
        ),
        (
            &["primvars:radiosity"],
            "color3f[]",
            vectors(&cloud.radiosity),
        ),
        (&["primvars:albedo"], "color3f[]", vectors(&cloud.albedo)),
        (
            &["primvars:emission"],
            "color3f[]",
            vectors(&cloud.emission),
        ),
        (
            &["primvars:area"],
            "float[]",
            Array::Floats(cloud.area.clone()),
        ),
    ];
    for (names, type_name, array) in columns {
        author_arrays(layer, surfels, (names, type_name), array)?;
    }
    let sources = Value::IntVec(sources.collect());
    author(layer, surfels, ("primvars:sourcePrim", "int[]"), sources)
}

/// Bounds of all disks taken as spheres, as USD's own `ComputeExtent` has it; a point at 0 for none. Radii that are
/// missing are 0.
pub(super) fn extent(position: &[Vec3], radius: &[f32]) -> Value {
    const CHUNK: usize = 1 << 16;
    let of_chunk = |(chunk, position): (usize, &[Vec3])| {
        let radii = radius.get(chunk * CHUNK..).unwrap_or_default();
        let radii = radii.iter().copied().chain(std::iter::repeat(0.0));
        let spheres = position.iter().zip(radii);
        spheres
            .map(|(&center, radius)| (center - radius, center + radius))
            .reduce(both)
    };
    let chunks = position.par_chunks(CHUNK).enumerate();
    let bounds = chunks.filter_map(of_chunk).reduce_with(both);
    let (low, high) = bounds.unwrap_or_default();
    let bounds = [low, high].map(|corner| gf::Vec3f::from(corner.to_array()));
    Value::Vec3fVec(bounds.to_vec())
}

fn both(a: (Vec3, Vec3), b: (Vec3, Vec3)) -> (Vec3, Vec3) {
    (a.0.min(b.0), a.1.max(b.1))
}
