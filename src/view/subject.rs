//! What is shown: disks or triangles, and the values at them.

use super::NORMAL_CHANNEL;
use super::channels::{self, Channel, ChannelKind};
use crate::diagnostics::Diagnostics;
use crate::math::Bounds3;
use crate::scene::{Interpolation, Mesh, Normals, Prim, Primvar, Scene, StageInfo};
use crate::surfels::points::PointSet;
use glam::{Affine3A, DVec3, Mat3A, Vec3};

/// Radius of points whose file says none, over the bounds' diagonal.
const DEFAULT_RADIUS: f32 = 0.002;

/// Geometry with one value of every channel at each element.
#[derive(Debug, Clone, PartialEq)]
pub struct Subject {
    /// The file's name.
    pub title: String,
    /// Unit, up on the stage.
    pub up: Vec3,
    /// World position that `positions` are relative to.
    pub origin: DVec3,
    /// One an element.
    pub positions: Vec<Vec3>,
    /// Unit; zero where there is none.
    pub normals: Option<Vec<Vec3>>,
    /// What the elements are.
    pub shape: Shape,
    /// At least one unless there is neither color nor normal.
    pub channels: Vec<Channel>,
    /// Index into `owner_paths` for each element.
    pub owners: Vec<u32>,
    /// Paths of the prims.
    pub owner_paths: Vec<String>,
}

/// What is drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A disk an element, or a ball where there are no normals, of these radii.
    Disks(Vec<f32>),
    /// Indices of elements.
    Triangles(Vec<[u32; 3]>),
}

impl Subject {
    /// The points of a cloud.
    pub fn of_points(points: PointSet, stage: &StageInfo) -> Self {
        let bounds = Bounds3::around(points.position.iter().copied());
        let default = if points.is_empty() {
            0.0
        } else {
            bounds.diagonal() * DEFAULT_RADIUS
        };
        let columns = points.columns.iter();
        let mut channels: Vec<Channel> = columns
            .map(|column| Channel::of_column(&column.name, &column.values))
            .collect();
        put_first(&mut channels, "displayColor");
        let count = points.len();
        let mut subject = Self {
            title: title(stage),
            up: stage.up_axis.direction(),
            origin: points.origin,
            normals: points.normal,
            shape: Shape::Disks(points.radius.unwrap_or_else(|| vec![default; count])),
            positions: points.position,
            channels,
            owners: vec![0; count],
            owner_paths: vec![String::new()],
        };
        subject.finish();
        subject
    }

    /// The meshes of `scene` with the primvars that it was read with. Values of texture coordinates are left out.
    /// Prims that do not fit 2³² vertices in all are left out with a warning.
    pub fn of_scene(scene: &Scene, diagnostics: &Diagnostics) -> Self {
        let names = channel_names(scene);
        let mut subject = Self {
            title: title(&scene.stage),
            up: scene.stage.up_axis.direction(),
            origin: scene.origin,
            positions: Vec::new(),
            normals: Some(Vec::new()),
            shape: Shape::Triangles(Vec::new()),
            channels: names
                .into_iter()
                .map(|(name, kind)| Channel {
                    name,
                    kind,
                    values: Vec::new(),
                })
                .collect(),
            owners: Vec::new(),
            owner_paths: Vec::new(),
        };
        for prim in &scene.prims {
            if !subject.add(scene.mesh_of(prim), prim) {
                let message = "it is not shown: there are 2^32 vertices without it";
                diagnostics.warn("too-large", prim.path.to_string(), message);
            }
        }
        subject.finish();
        subject
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// True without elements.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The channel called `name`.
    pub fn channel(&self, name: &str) -> Option<&Channel> {
        self.channels.iter().find(|channel| channel.name == name)
    }

    /// Bounds of what is drawn, relative to the origin.
    pub fn bounds(&self) -> Bounds3 {
        match &self.shape {
            Shape::Triangles(_) => Bounds3::around(self.positions.iter().copied()),
            Shape::Disks(radii) => {
                let disks = self.positions.iter().zip(radii);
                Bounds3::around(disks.flat_map(|(&p, &r)| [p - r, p + r]))
            }
        }
    }

    fn finish(&mut self) {
        channels::add_derived(&mut self.channels);
        if let Some(normals) = &self.normals
            && self.channel(NORMAL_CHANNEL).is_none()
        {
            let values = normals.iter().flat_map(|n| n.to_array()).collect();
            self.channels.push(Channel {
                name: NORMAL_CHANNEL.to_owned(),
                kind: ChannelKind::Direction,
                values,
            });
        }
    }

    /// False if there is no room for it.
    fn add(&mut self, mesh: &Mesh, prim: &Prim) -> bool {
        let corners = Corners::of(mesh);
        let first = self.positions.len();
        let (Ok(first), Ok(_)) = (u32::try_from(first), u32::try_from(first + corners.count()))
        else {
            return false;
        };
        let world = prim.world_from_object;
        let positions = corners.positions(mesh);
        self.positions
            .extend(positions.map(|p| world.transform_point3(p)));
        if let Some(normals) = &mut self.normals {
            normals.extend(world_normals(mesh, world, &corners));
        }
        if let Shape::Triangles(triangles) = &mut self.shape {
            let flips = world.matrix3.determinant() < 0.0;
            triangles.extend(corners.triangles(mesh).map(|[a, b, c]| {
                let [a, b, c] = [first + a, first + b, first + c];
                if flips { [a, c, b] } else { [a, b, c] }
            }));
        }
        for channel in &mut self.channels {
            corners.extend(mesh, channel);
        }
        let owner = u32::try_from(self.owner_paths.len()).unwrap_or(u32::MAX);
        self.owners.resize(self.positions.len(), owner);
        self.owner_paths.push(prim.path.to_string());
        true
    }
}

fn title(stage: &StageInfo) -> String {
    let name = stage.path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

fn put_first(channels: &mut [Channel], name: &str) {
    if let Some(at) = channels.iter().position(|channel| channel.name == name) {
        channels[..=at].rotate_right(1);
    }
}

/// Names of primvars of one, three or four numbers on any mesh, what is shown as `displayColor` first.
fn channel_names(scene: &Scene) -> Vec<(String, ChannelKind)> {
    let mut names: Vec<(String, ChannelKind)> = Vec::new();
    let primvars = scene.meshes.iter().flat_map(|mesh| &mesh.primvars);
    for primvar in primvars.filter(|primvar| primvar.components != 2) {
        if names.iter().all(|(name, _)| *name != primvar.name) {
            names.push((primvar.name.clone(), kind_of(primvar)));
        }
    }
    names.sort_by_key(|(name, _)| (name != "displayColor", name.clone()));
    names
}

/// By the number of components, and by names for directions and ids: types are not kept on scenes.
fn kind_of(primvar: &Primvar) -> ChannelKind {
    let directions = [
        "bent_normal",
        "illumination_direction",
        NORMAL_CHANNEL,
        "normals",
    ];
    match primvar.components {
        1 if ["primId", "instanceId", "sourcePrim"].contains(&primvar.name.as_str()) => {
            ChannelKind::Id
        }
        1 => ChannelKind::Scalar,
        _ if directions.contains(&primvar.name.as_str()) => ChannelKind::Direction,
        _ => ChannelKind::Color,
    }
}

/// Which vertices a mesh is drawn with: its own, or those of every triangle apart where values split.
enum Corners {
    Shared(usize),
    Apart(usize),
}

impl Corners {
    fn of(mesh: &Mesh) -> Self {
        let splits = |primvar: &Primvar| {
            let layout = &primvar.interpolation;
            primvar.components != 2
                && matches!(layout, Interpolation::Corner(_) | Interpolation::Uniform)
        };
        match mesh.primvars.iter().any(splits) {
            true => Self::Apart(3 * mesh.triangles.len()),
            false => Self::Shared(mesh.positions.len()),
        }
    }

    fn count(&self) -> usize {
        match *self {
            Self::Shared(count) | Self::Apart(count) => count,
        }
    }

    fn positions<'a>(&self, mesh: &'a Mesh) -> Box<dyn Iterator<Item = Vec3> + 'a> {
        match self {
            Self::Shared(_) => Box::new(mesh.positions.iter().copied()),
            Self::Apart(_) => {
                let indices = mesh.triangles.iter().flatten();
                Box::new(indices.map(|&i| mesh.positions[i as usize]))
            }
        }
    }

    fn triangles<'a>(&self, mesh: &'a Mesh) -> Box<dyn Iterator<Item = [u32; 3]> + 'a> {
        match self {
            Self::Shared(_) => Box::new(mesh.triangles.iter().copied()),
            Self::Apart(count) => {
                let count = u32::try_from(*count).unwrap_or(u32::MAX);
                Box::new((0..count).step_by(3).map(|i| [i, i + 1, i + 2]))
            }
        }
    }

    /// Add the values of `mesh` to `channel`; NaN where it has none.
    fn extend(&self, mesh: &Mesh, channel: &mut Channel) {
        let width = channel.kind.components();
        let Some(primvar) = mesh.primvar(&channel.name) else {
            let more = channel.values.len() + self.count() * width;
            channel.values.resize(more, f32::NAN);
            return;
        };
        let mut push = |index: u32| {
            let value = primvar.values[index as usize].to_array();
            channel.values.extend_from_slice(&value[..width]);
        };
        match (self, &primvar.interpolation) {
            (_, Interpolation::Constant) => (0..self.count()).for_each(|_| push(0)),
            (Self::Shared(_), _) => {
                let count = u32::try_from(self.count()).unwrap_or(u32::MAX);
                (0..count).for_each(push);
            }
            (Self::Apart(_), Interpolation::Vertex) => {
                mesh.triangles.iter().flatten().for_each(|&i| push(i));
            }
            (Self::Apart(_), Interpolation::Corner(corners)) => {
                corners.iter().flatten().for_each(|&i| push(i));
            }
            (Self::Apart(_), Interpolation::Uniform) => {
                for &face in &mesh.triangle_faces {
                    (0..3).for_each(|_| push(face));
                }
            }
        }
    }
}

/// Shading normals in world space; where they split at vertices that are drawn shared, their mean.
fn world_normals(mesh: &Mesh, world: Affine3A, corners: &Corners) -> Vec<Vec3> {
    let shared = matches!(corners, Corners::Shared(_));
    let object = match &mesh.normals {
        Normals::Vertex(values) if shared => values.clone(),
        Normals::Vertex(_) | Normals::Corner { .. } if !shared => {
            let normals = (0..mesh.triangles.len()).filter_map(|t| mesh.corner_normals(t));
            normals.flatten().collect()
        }
        _ if !shared => {
            let planes = (0..mesh.triangles.len()).map(|t| [mesh.plane_normal(t); 3]);
            planes.flatten().collect()
        }
        _ => mean_normals(mesh),
    };
    let m = world.matrix3;
    let cofactor = Mat3A::from_cols(
        m.y_axis.cross(m.z_axis),
        m.z_axis.cross(m.x_axis),
        m.x_axis.cross(m.y_axis),
    ) * m.determinant().signum();
    object
        .into_iter()
        .map(|n| (cofactor * n).normalize_or_zero())
        .collect()
}

/// Mean of the normals at each vertex, weighted by area.
fn mean_normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = mesh.corners(t);
        let double_area = (b - a).cross(c - a).length();
        let normals = mesh
            .corner_normals(t)
            .unwrap_or_else(|| [mesh.plane_normal(t); 3]);
        for (&vertex, normal) in triangle.iter().zip(normals) {
            sums[vertex as usize] += normal * double_area;
        }
    }
    sums.into_iter().map(Vec3::normalize_or_zero).collect()
}
