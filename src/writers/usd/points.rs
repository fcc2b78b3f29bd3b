//! [`PointSet`] → a UsdGeomPoints file with all its columns, or a mesh that shows it where points are not drawn.
//!
//! ```text
//! def Xform "root"            translated by the set's origin, in double precision
//!   def Points "surfels"      widths, normals, a primvar for each column
//!   def Mesh "surfels"        (instead) a square for each point, as wide as its disk, colored by displayColor
//! ```
//! Only types of primvars are used that Blender keeps.

use super::cloud::{author_root, extent};
use super::opinions::{Array, Declaration, Opinions};
use super::{Error, Provenance, author_metadata, baked, save};
use crate::scene::StageInfo;
use crate::surfels::points::{ColumnValues, PointSet, VectorKind};
use glam::Vec3;
use openusd::gf;
use openusd::sdf::{FieldKey, Path as SdfPath, Value};
use openusd::tf::Token;
use rayon::prelude::*;
use std::path::Path;

/// How far squares are off their points along the normal, in radii: surfels of the two sides of a wall are in one place, and
/// what lies in one plane is drawn in a pattern of both.
const LIFT: f32 = 0.01;

/// Write `points` to `path` as `Points`.
///
/// # Errors
/// When the file cannot be written; nothing is left behind then.
pub fn write(
    points: PointSet,
    stage: &StageInfo,
    provenance: &Provenance,
    path: &Path,
) -> Result<(), Error> {
    let mut layer = begin(&points, stage, provenance)?;
    let prim = layer.define("/root/surfels", "Points")?;
    let zero = Vec::new();
    let radii = points.radius.as_ref().unwrap_or(&zero);
    author(
        &mut layer,
        &prim,
        ("extent", "float3[]"),
        extent(&points.position, radii),
    )?;
    if let Some(mut widths) = points.radius {
        widths.par_iter_mut().for_each(|width| *width *= 2.0);
        let widths = Array::Floats(widths);
        author_arrays(&mut layer, &prim, (&["widths"], "float[]"), widths)?;
    }
    let position = Array::Vectors(points.position);
    author_arrays(&mut layer, &prim, (&["points"], "point3f[]"), position)?;
    if let Some(normals) = points.normal {
        let names = &["normals", "primvars:N"];
        let normals = Array::Vectors(normals);
        author_arrays(&mut layer, &prim, (names, "normal3f[]"), normals)?;
    }
    for column in points.columns {
        let name = format!("primvars:{}", primvar_name(&column.name));
        let (type_name, array) = match column.values {
            ColumnValues::Ints(values) => {
                author(&mut layer, &prim, (&name, "int[]"), Value::IntVec(values))?;
                continue;
            }
            ColumnValues::Floats(values) => ("float[]", Array::Floats(values)),
            ColumnValues::Vectors(kind, values) => (type_name(kind), Array::Vectors(values)),
        };
        author_arrays(&mut layer, &prim, (&[&name], type_name), array)?;
    }
    save(layer, path)
}

/// Write `points` to `path` as a mesh of squares, with a material that shows `displayColor` as it is. Points without a
/// normal face +Y or +Z, what is up.
///
/// # Errors
/// When the file cannot be written; nothing is left behind then.
pub fn write_display_mesh(
    points: &PointSet,
    stage: &StageInfo,
    provenance: &Provenance,
    path: &Path,
) -> Result<(), Error> {
    let mut layer = begin(points, stage, provenance)?;
    let prim = layer.define("/root/surfels", "Mesh")?;
    let count = points.len();
    let corners = squares(points, stage.up_axis.direction());
    let indices = i32::try_from(corners.len()).map_err(|_| Error::Format {
        path: path.to_owned(),
        message: format!("{count} points are too many for one mesh (most: 536 870 911)"),
    })?;
    author(
        &mut layer,
        &prim,
        ("extent", "float3[]"),
        extent(&corners, &[]),
    )?;
    let counts = Value::IntVec(vec![4; count]);
    author(&mut layer, &prim, ("faceVertexCounts", "int[]"), counts)?;
    let indices = Value::IntVec((0..indices).collect());
    author(&mut layer, &prim, ("faceVertexIndices", "int[]"), indices)?;
    author(&mut layer, &prim, ("points", "point3f[]"), vectors(corners))?;
    layer.uniform(
        &prim,
        "subdivisionScheme",
        "token",
        Value::Token(Token::new("none")),
    )?;
    layer.uniform(&prim, "doubleSided", "bool", Value::Bool(true))?;
    let colors = points.vectors("displayColor").map(<[Vec3]>::to_vec);
    let colors = colors.unwrap_or_else(|| vec![Vec3::splat(0.5); count]);
    let declaration = Declaration {
        name: "primvars:displayColor",
        type_name: "color3f[]",
        interpolation: Some("uniform"),
    };
    let attribute = layer.attribute(&prim, declaration)?;
    layer.set(&attribute, FieldKey::Default, vectors(colors));
    let root = StageInfo {
        default_prim: Some("root".to_owned()),
        ..stage.clone()
    };
    let material = baked::author_material(&mut layer, &root)?;
    baked::bind(&mut layer, "/root/surfels", &material)?;
    save(layer, path)
}

fn begin(points: &PointSet, stage: &StageInfo, provenance: &Provenance) -> Result<Opinions, Error> {
    let mut layer = Opinions::new();
    author_metadata(&mut layer, stage, provenance);
    let root = Value::Token(Token::new("root"));
    layer.set(&SdfPath::abs_root(), FieldKey::DefaultPrim, root);
    author_root(&mut layer, points.origin)?;
    Ok(layer)
}

/// Declare an array with a value a point, or one that says so itself.
pub(super) fn author(
    layer: &mut Opinions,
    prim: &SdfPath,
    (name, type_name): (&str, &str),
    value: Value,
) -> Result<(), Error> {
    let attribute = declare(layer, prim, (name, type_name))?;
    layer.set(&attribute, FieldKey::Default, value);
    Ok(())
}

/// [`author`] of attributes that all have the values of `array`.
pub(super) fn author_arrays(
    layer: &mut Opinions,
    prim: &SdfPath,
    (names, type_name): (&[&str], &str),
    array: Array,
) -> Result<(), Error> {
    let declared = names
        .iter()
        .map(|name| declare(layer, prim, (name, type_name)));
    let attributes = declared.collect::<Result<_, _>>()?;
    layer.set_array(attributes, array);
    Ok(())
}

fn declare(
    layer: &mut Opinions,
    prim: &SdfPath,
    (name, type_name): (&str, &str),
) -> Result<SdfPath, Error> {
    let has_one_a_point = matches!(name, "widths" | "normals") || name.starts_with("primvars:");
    let declaration = Declaration {
        name,
        type_name,
        interpolation: has_one_a_point.then_some("vertex"),
    };
    layer.attribute(prim, declaration)
}

fn type_name(kind: VectorKind) -> &'static str {
    match kind {
        VectorKind::Color => "color3f[]",
        VectorKind::Normal => "normal3f[]",
        VectorKind::Vector => "vector3f[]",
    }
}

/// Letters that USD does not take in names become `_`.
fn primvar_name(name: &str) -> String {
    let is_fine = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let name: String = name
        .chars()
        .map(|c| if is_fine(c) { c } else { '_' })
        .collect();
    match name.starts_with(|c: char| c.is_alphabetic() || c == '_') {
        true => name,
        false => format!("_{name}"),
    }
}

/// Four corners a point, counter-clockwise about its normal.
fn squares(points: &PointSet, up: Vec3) -> Vec<Vec3> {
    let mut corners = Vec::with_capacity(4 * points.len());
    for (i, &center) in points.position.iter().enumerate() {
        let normal = points.normal.as_ref().map(|normals| normals[i]);
        let normal = normal.filter(|normal| normal.is_normalized()).unwrap_or(up);
        let radius = points.radius.as_ref().map_or(0.0, |radii| radii[i]);
        let center = center + normal * (LIFT * radius);
        let (u, v) = normal.any_orthonormal_pair();
        let (u, v) = (u * radius, v * radius);
        let turned = [
            center - u - v,
            center + u - v,
            center + u + v,
            center - u + v,
        ];
        match u.cross(v).dot(normal) >= 0.0 {
            true => corners.extend(turned),
            false => corners.extend(turned.into_iter().rev()),
        }
    }
    corners
}

fn vectors(values: Vec<Vec3>) -> Value {
    Value::Vec3fVec(bytemuck::cast_vec::<Vec3, gf::Vec3f>(values))
}
