//! Meshes → `Mesh`, `BasisCurves` and `Points` prims, one a primitive.

use super::accessor::{indices, numbers};
use super::lines;
use super::nodes::Job;
use super::skins::{self, Bound};
use crate::exchange::Error;
use crate::writers::usd::author::Data;
use glam::{Vec2, Vec3, Vec4};
use gltf::Semantic;
use gltf::accessor::Dimensions;
use gltf::mesh::Mode;

/// Write every primitive of `mesh` at the path that `place` gives its name, deformed by what it is `bound` to.
pub(super) fn write(
    job: &mut Job<'_>,
    mesh: &gltf::Mesh<'_>,
    place: &mut dyn FnMut(&str) -> String,
    name: &str,
    bound: Option<&Bound>,
) -> Result<(), Error> {
    let is_one = mesh.primitives().len() == 1;
    for primitive in mesh.primitives() {
        let name = match is_one {
            true => name.to_owned(),
            false => format!("{name}_{}", primitive.index()),
        };
        let path = place(&name);
        let wrong = job.wrong();
        let place = path.clone();
        let columns = Columns::read(job, &primitive, &path)
            .map_err(|message| wrong(format!("mesh {} ({place}): {message}", mesh.index())))?;
        let count = columns.positions.len();
        if bound.is_none() && primitive.morph_targets().next().is_some() {
            let message = "the morph targets of instances are left out: it is shown without them";
            job.lost(&path, message);
        }
        let mode = primitive.mode();
        if mode == Mode::Points {
            write_points(job, &primitive, columns, &path)?;
        } else {
            let corners = corners(job, &primitive, count)
                .map_err(|message| wrong(format!("mesh {} ({place}): {message}", mesh.index())))?;
            if matches!(mode, Mode::Lines | Mode::LineStrip | Mode::LineLoop) {
                lines::write(job, &primitive, (columns, corners), &path)?;
                if bound.is_some() {
                    let message = "what deforms its lines is left out: they are shown at rest";
                    job.lost(&path, message);
                }
                continue;
            }
            write_mesh(job, &primitive, (columns, triangles(mode, &corners)), &path)?;
        }
        if let Some(bound) = bound {
            skins::attach(job, &primitive, (count, &path), bound)?;
        }
    }
    Ok(())
}

/// Values at the vertices of a primitive.
pub(super) struct Columns {
    pub(super) positions: Vec<Vec3>,
    pub(super) normals: Option<Vec<Vec3>>,
    colors: Option<Vec<Vec4>>,
    has_alpha: bool,
    coordinates: Vec<(u32, Vec<Vec2>)>,
    radii: Option<Vec<f32>>,
}

impl Columns {
    fn read(job: &Job<'_>, primitive: &gltf::Primitive<'_>, path: &str) -> Result<Self, String> {
        let document = job.document;
        let accessor = primitive
            .get(&Semantic::Positions)
            .ok_or("it has no POSITION")?;
        let vectors = |values: Vec<f32>| values.chunks_exact(3).map(Vec3::from_slice).collect();
        let mut columns = Self {
            positions: vectors(numbers(document, &accessor, &[Dimensions::Vec3])?),
            normals: None,
            colors: None,
            has_alpha: false,
            coordinates: Vec::new(),
            radii: None,
        };
        for (semantic, accessor) in primitive.attributes() {
            if accessor.count() != columns.positions.len() {
                let (count, right) = (accessor.count(), columns.positions.len());
                return Err(format!(
                    "{semantic:?} has {count} values where {right} are needed"
                ));
            }
            let read = |dimensions: &[Dimensions]| numbers(document, &accessor, dimensions);
            match semantic {
                Semantic::Positions | Semantic::Tangents => {}
                Semantic::Normals => {
                    let normals: Vec<Vec3> = vectors(read(&[Dimensions::Vec3])?);
                    columns.normals =
                        Some(normals.into_iter().map(Vec3::normalize_or_zero).collect());
                }
                Semantic::TexCoords(set) => {
                    let values = read(&[Dimensions::Vec2])?;
                    let upright = |uv: &[f32]| Vec2::new(uv[0], 1.0 - uv[1]);
                    let values = values.chunks_exact(2).map(upright).collect();
                    columns.coordinates.push((set, values));
                }
                Semantic::Colors(0) => {
                    let values = read(&[Dimensions::Vec3, Dimensions::Vec4])?;
                    columns.has_alpha = accessor.dimensions() == Dimensions::Vec4;
                    let width = accessor.dimensions().multiplicity();
                    let color =
                        |c: &[f32]| Vec4::new(c[0], c[1], c[2], c.get(3).copied().unwrap_or(1.0));
                    columns.colors = Some(values.chunks_exact(width).map(color).collect());
                }
                // the crate hands over names of an application's own without their underscore
                Semantic::Extras(name) if name == "RADIUS" || name == "_RADIUS" => {
                    columns.radii = Some(read(&[Dimensions::Scalar])?);
                }
                Semantic::Joints(_) | Semantic::Weights(_) => {}
                other => job.lost(path, format!("its {other:?} are left out")),
            }
        }
        Ok(columns)
    }

    /// The values of these vertices, in this order.
    pub(super) fn at(&self, vertices: &[u32]) -> Self {
        fn each<T: Copy>(values: &[T], vertices: &[u32]) -> Vec<T> {
            vertices.iter().map(|&v| values[v as usize]).collect()
        }
        let coordinates = self.coordinates.iter();
        Self {
            positions: each(&self.positions, vertices),
            normals: self.normals.as_ref().map(|all| each(all, vertices)),
            colors: self.colors.as_ref().map(|all| each(all, vertices)),
            has_alpha: self.has_alpha,
            coordinates: coordinates
                .map(|(set, all)| (*set, each(all, vertices)))
                .collect(),
            radii: self.radii.as_ref().map(|all| each(all, vertices)),
        }
    }
}

/// Indices of the vertices that are connected.
fn corners(
    job: &Job<'_>,
    primitive: &gltf::Primitive<'_>,
    count: usize,
) -> Result<Vec<u32>, String> {
    let corners = match primitive.indices() {
        Some(accessor) => indices(job.document, &accessor)?,
        None => (0..u32::try_from(count).map_err(|_| "it has more than 2^32 vertices")?).collect(),
    };
    match corners.iter().find(|&&index| index as usize >= count) {
        Some(index) => Err(format!(
            "index {index} is out of range, there are {count} vertices"
        )),
        None => Ok(corners),
    }
}

/// Corners of all triangles; those that use a vertex twice, which strips are turned with, are left out.
fn triangles(mode: Mode, corners: &[u32]) -> Vec<[u32; 3]> {
    let mut triangles: Vec<[u32; 3]> = match mode {
        Mode::TriangleStrip => {
            let windows = corners.windows(3).enumerate();
            windows
                .map(|(k, w)| {
                    if k % 2 == 0 {
                        [w[0], w[1], w[2]]
                    } else {
                        [w[1], w[0], w[2]]
                    }
                })
                .collect()
        }
        Mode::TriangleFan => {
            let first = corners.first().copied().unwrap_or(0);
            let pairs = corners.get(1..).unwrap_or_default().windows(2);
            pairs.map(|w| [w[0], w[1], first]).collect()
        }
        _ => corners
            .chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]])
            .collect(),
    };
    triangles.retain(|[a, b, c]| a != b && b != c && c != a);
    triangles
}

/// Lowest and highest of `positions`; zero where there are none.
pub(super) fn bounds(positions: &[Vec3]) -> (Vec3, Vec3) {
    let positions = || positions.iter().copied();
    let low = positions().reduce(Vec3::min).unwrap_or_default();
    (low, positions().reduce(Vec3::max).unwrap_or_default())
}

fn extent(positions: &[Vec3], radius: f32) -> Data {
    let (low, high) = bounds(positions);
    Data::Vec3s(vec![low - radius, high + radius])
}

fn write_mesh(
    job: &mut Job<'_>,
    primitive: &gltf::Primitive<'_>,
    (columns, triangles): (Columns, Vec<[u32; 3]>),
    path: &str,
) -> Result<(), Error> {
    job.converted.triangles += triangles.len();
    let material = primitive.material();
    let author = &mut job.author;
    author.define(path, "Mesh")?;
    author.attribute(
        path,
        ("extent", "float3[]"),
        extent(&columns.positions, 0.0),
    )?;
    let counts = Data::Ints(vec![3; triangles.len()]);
    author.attribute(path, ("faceVertexCounts", "int[]"), counts)?;
    let corners = triangles.into_iter().flatten();
    let corners = corners
        .map(|index| i32::try_from(index).unwrap_or(i32::MAX))
        .collect();
    author.attribute(path, ("faceVertexIndices", "int[]"), Data::Ints(corners))?;
    author.uniform(
        path,
        ("subdivisionScheme", "token"),
        Data::Token("none".to_owned()),
    )?;
    author.uniform(
        path,
        ("doubleSided", "bool"),
        Data::Bool(material.double_sided()),
    )?;
    write_columns(job, &material, columns, path)?;
    bind(job, primitive, path)
}

/// Bind the material of `primitive` to the prim at `path`.
pub(super) fn bind(
    job: &mut Job<'_>,
    primitive: &gltf::Primitive<'_>,
    path: &str,
) -> Result<(), Error> {
    let has_colors = primitive.get(&Semantic::Colors(0)).is_some();
    let look = job.looks.path_of(&primitive.material(), has_colors);
    job.author.apply(path, &["MaterialBindingAPI"])?;
    Ok(job.author.relate(path, "material:binding", &[look])?)
}

/// What meshes, lines and points have alike.
pub(super) fn write_columns(
    job: &mut Job<'_>,
    material: &gltf::Material<'_>,
    columns: Columns,
    path: &str,
) -> Result<(), Error> {
    let base = Vec4::from_array(material.pbr_metallic_roughness().base_color_factor());
    let has_texture = material
        .pbr_metallic_roughness()
        .base_color_texture()
        .is_some();
    if has_texture && columns.colors.is_some() {
        job.lost(
            path,
            "its vertex colors do not multiply the texture: a UsdPreviewSurface cannot",
        );
    }
    let author = &mut job.author;
    author.attribute(
        path,
        ("points", "point3f[]"),
        Data::Vec3s(columns.positions),
    )?;
    if let Some(normals) = columns.normals {
        author.interpolated(
            path,
            ("normals", "normal3f[]"),
            "vertex",
            Data::Vec3s(normals),
        )?;
    }
    for (set, values) in columns.coordinates {
        let name = format!("primvars:{}", coordinates_name(set));
        author.interpolated(path, (&name, "texCoord2f[]"), "vertex", Data::Vec2s(values))?;
    }
    match columns.colors {
        Some(colors) => write_colors(job, (colors, columns.has_alpha), base, path),
        None => {
            let color = Data::Vec3s(vec![base.truncate()]);
            let name = ("primvars:displayColor", "color3f[]");
            Ok(author.interpolated(path, name, "constant", color)?)
        }
    }
}

/// Vertex colors as they are, and times the color of the material, as they are shown.
fn write_colors(
    job: &mut Job<'_>,
    (colors, has_alpha): (Vec<Vec4>, bool),
    base: Vec4,
    path: &str,
) -> Result<(), Error> {
    let author = &mut job.author;
    let shown = colors.iter().map(|color| (color * base).truncate());
    let shown = Data::Vec3s(shown.collect());
    let name = ("primvars:displayColor", "color3f[]");
    author.interpolated(path, name, "vertex", shown)?;
    if has_alpha {
        let opacity = colors.iter().map(|color| color.w * base.w);
        let opacity = Data::Floats(opacity.collect());
        let name = ("primvars:displayOpacity", "float[]");
        author.interpolated(path, name, "vertex", opacity)?;
    }
    let name = ("primvars:COLOR_0", "color4f[]");
    Ok(author.interpolated(path, name, "vertex", Data::Vec4s(colors))?)
}

/// `st`, `st1`, `st2` …
pub(super) fn coordinates_name(set: u32) -> String {
    match set {
        0 => "st".to_owned(),
        set => format!("st{set}"),
    }
}

fn write_points(
    job: &mut Job<'_>,
    primitive: &gltf::Primitive<'_>,
    mut columns: Columns,
    path: &str,
) -> Result<(), Error> {
    if primitive.indices().is_some() {
        job.lost(
            path,
            "the indices of its points are left out: every vertex is a point",
        );
    }
    let radii = columns.radii.take();
    let largest = radii.iter().flatten().copied().fold(0.0, f32::max);
    job.author.define(path, "Points")?;
    job.author.attribute(
        path,
        ("extent", "float3[]"),
        extent(&columns.positions, largest),
    )?;
    if let Some(radii) = radii {
        let widths = Data::Floats(radii.iter().map(|radius| 2.0 * radius).collect());
        job.author
            .interpolated(path, ("widths", "float[]"), "vertex", widths)?;
    }
    write_columns(job, &primitive.material(), columns, path)
}
