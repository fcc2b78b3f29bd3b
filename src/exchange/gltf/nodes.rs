//! Nodes → prims: transforms, cameras, lights, instances.

use super::accessor::numbers;
use super::document::Document;
use super::materials::Looks;
use super::meshes;
use super::motion::{Motion, Track};
use super::skins::{self, Rigs};
use super::{Converted, malformed};
use crate::diagnostics::Diagnostics;
use crate::exchange::Error;
use crate::writers::usd::author::{Author, Data, prim_name};
use glam::{DVec3, Quat, Vec2, Vec3};
use gltf::accessor::Dimensions;
use gltf::khr_lights_punctual::Kind;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};

/// Nodes below nodes at most: paths of prims grow with every one.
pub(super) const DEEPEST: usize = 256;

/// Height of the film of cameras, tenths of a unit: 24 mm where a unit is a meter, which is what files mean.
const FILM: f64 = 0.24;

/// What is being made.
pub(super) struct Job<'a> {
    pub(super) document: &'a Document,
    pub(super) author: &'a mut Author,
    pub(super) diagnostics: &'a Diagnostics,
    pub(super) looks: Looks,
    pub(super) motion: Motion,
    pub(super) rigs: Rigs,
    pub(super) converted: Converted,
}

/// Names used below one prim.
#[derive(Default)]
pub(super) struct Names(BTreeSet<String>);

impl Names {
    /// `name` as a prim's, with a number behind it where it is taken.
    pub(super) fn unique(&mut self, name: &str) -> String {
        let base = prim_name(name);
        let mut found = base.clone();
        let mut count = 1;
        while !self.0.insert(found.clone()) {
            found = format!("{base}_{count}");
            count += 1;
        }
        found
    }
}

/// What the walk over the nodes knows.
struct Walk {
    visited: Vec<bool>,
    /// Uses of each mesh.
    uses: Vec<usize>,
    /// Class of each mesh that is shared, once it is authored.
    classes: BTreeMap<usize, String>,
    class_names: Names,
}

impl Job<'_> {
    /// The default scene, else the first, else every node that none is above.
    pub(super) fn scene(&mut self) -> Result<(), Error> {
        let gltf = &self.document.gltf;
        let scene = gltf.default_scene().or_else(|| gltf.scenes().next());
        let roots: Vec<gltf::Node<'_>> = match &scene {
            Some(scene) => scene.nodes().collect(),
            None => {
                let below: BTreeSet<usize> = gltf
                    .nodes()
                    .flat_map(|node| node.children().map(|child| child.index()))
                    .collect();
                gltf.nodes()
                    .filter(|node| !below.contains(&node.index()))
                    .collect()
            }
        };
        let mut uses = vec![0; gltf.meshes().count()];
        for mesh in gltf.nodes().filter_map(|node| node.mesh()) {
            uses[mesh.index()] += 1;
        }
        let mut walk = Walk {
            visited: vec![false; gltf.nodes().count()],
            uses,
            classes: BTreeMap::new(),
            class_names: Names::default(),
        };
        let mut names = Names::default();
        names.unique("Looks");
        if skins::any(gltf) {
            names.unique(skins::SKELETONS);
        }
        for node in roots {
            self.node(&node, ("/root", &mut names), 0, &mut walk)?;
        }
        self.skeletons()
    }

    /// A warning that something is lost.
    pub(super) fn lost(&self, place: &str, message: impl Into<String>) {
        self.diagnostics.warn("lost", place, message);
    }

    /// What is wrong with the file as an error.
    pub(super) fn wrong(&self) -> impl Fn(String) -> Error + use<> {
        let path = self.document.path.clone();
        move |message| malformed(&path)(message)
    }

    fn node(
        &mut self,
        node: &gltf::Node<'_>,
        (parent, names): (&str, &mut Names),
        depth: usize,
        walk: &mut Walk,
    ) -> Result<(), Error> {
        if std::mem::replace(&mut walk.visited[node.index()], true) {
            return Err(self.wrong()(format!(
                "node {} is below itself, or below two others",
                node.index()
            )));
        }
        if depth > DEEPEST {
            return Err(self.wrong()(format!(
                "its nodes are more than {DEEPEST} deep"
            )));
        }
        let default = format!("node_{}", node.index());
        let path = format!("{parent}/{}", names.unique(node.name().unwrap_or(&default)));
        self.author.define(&path, "Xform")?;
        self.transform(node, &path)?;
        let mut names = Names::default();
        for child in node.children() {
            self.node(&child, (&path, &mut names), depth + 1, walk)?;
        }
        if let Some(camera) = node.camera() {
            self.camera(&camera, &format!("{path}/{}", names.unique("Camera")))?;
        }
        if let Some(light) = node.light() {
            self.light(&light, &format!("{path}/{}", names.unique("Light")))?;
        }
        if let Some(mesh) = node.mesh() {
            self.shape(node, &mesh, (&path, &mut names), walk)?;
        }
        Ok(())
    }

    /// The mesh of a node: its own, shared, or scattered.
    fn shape(
        &mut self,
        node: &gltf::Node<'_>,
        mesh: &gltf::Mesh<'_>,
        (path, names): (&str, &mut Names),
        walk: &mut Walk,
    ) -> Result<(), Error> {
        let name = mesh
            .name()
            .map_or_else(|| format!("mesh_{}", mesh.index()), str::to_owned);
        if let Some(instancing) = node.extension_value("EXT_mesh_gpu_instancing") {
            if node.skin().is_some() {
                let message =
                    "the skin of instances is left out: they are shown as they were bound";
                self.lost(path, message);
            }
            let path = format!("{path}/{}", names.unique("Instances"));
            return self.instancer(instancing, mesh, (&path, &name));
        }
        self.converted.prims += 1;
        let bound = self.bind(node, mesh)?;
        if walk.uses[mesh.index()] < 2 || bound.is_some() {
            let mut place = |name: &str| format!("{path}/{}", names.unique(name));
            return meshes::write(self, mesh, &mut place, &name, bound.as_ref());
        }
        let class = match walk.classes.get(&mesh.index()) {
            Some(class) => class.clone(),
            None => {
                let class = format!("/_meshes/{}", walk.class_names.unique(&name));
                self.author.class("/_meshes")?;
                self.author.define(&class, "Xform")?;
                let mut below = Names::default();
                meshes::write(
                    self,
                    mesh,
                    &mut |name| format!("{class}/{}", below.unique(name)),
                    &name,
                    None,
                )?;
                walk.classes.insert(mesh.index(), class.clone());
                class
            }
        };
        let path = format!("{path}/{}", names.unique(&name));
        self.author.define(&path, "Xform")?;
        Ok(self.author.instance(&path, &class)?)
    }

    fn transform(&mut self, node: &gltf::Node<'_>, path: &str) -> Result<(), Error> {
        let (translation, rotation, scale) = node.transform().decomposed();
        let values = [&translation[..], &rotation[..], &scale[..]].concat();
        if values.iter().any(|value| !value.is_finite()) {
            return Err(self.wrong()(format!(
                "the transform of node {} is not finite",
                node.index()
            )));
        }
        let tracks = self.motion.of(node.index()).cloned().unwrap_or_default();
        let rotation = unit(Quat::from_array(rotation));
        let is_identity =
            translation == [0.0; 3] && rotation.is_near_identity() && scale == [1.0; 3];
        let is_still =
            tracks.translation.is_none() && tracks.rotation.is_none() && tracks.scale.is_none();
        if is_identity && is_still {
            return Ok(());
        }
        let ops = [
            (
                ("xformOp:translate", "double3"),
                Data::DVec3(Vec3::from_array(translation).as_dvec3()),
                tracks.translation,
            ),
            (
                ("xformOp:orient", "quatf"),
                Data::Quat(rotation),
                tracks.rotation,
            ),
            (
                ("xformOp:scale", "float3"),
                Data::Vec3(Vec3::from_array(scale)),
                tracks.scale,
            ),
        ];
        let mut order = Vec::new();
        for (declaration, rest, track) in ops {
            order.push(declaration.0);
            match track {
                None => self.author.attribute(path, declaration, rest)?,
                Some(track) => {
                    self.author
                        .samples(path, declaration, samples(track, declaration.1))?;
                }
            }
        }
        Ok(self
            .author
            .uniform(path, ("xformOpOrder", "token[]"), Data::Tokens(order))?)
    }

    fn camera(&mut self, camera: &gltf::Camera<'_>, path: &str) -> Result<(), Error> {
        let author = &mut self.author;
        author.define(path, "Camera")?;
        let float = |x: f64| Data::Float(single(x));
        let (near, far) = match camera.projection() {
            gltf::camera::Projection::Perspective(lens) => {
                let aspect = f64::from(lens.aspect_ratio().unwrap_or(1.5));
                let focal = FILM / (2.0 * (0.5 * f64::from(lens.yfov())).tan());
                author.attribute(path, ("focalLength", "float"), float(focal))?;
                author.attribute(path, ("verticalAperture", "float"), float(FILM))?;
                author.attribute(path, ("horizontalAperture", "float"), float(FILM * aspect))?;
                (lens.znear(), lens.zfar().unwrap_or(1e6))
            }
            gltf::camera::Projection::Orthographic(lens) => {
                // half sizes; apertures are tenths of a unit
                let aperture = |half: f32| float(20.0 * f64::from(half.abs()));
                author.attribute(
                    path,
                    ("projection", "token"),
                    Data::Token("orthographic".to_owned()),
                )?;
                author.attribute(path, ("horizontalAperture", "float"), aperture(lens.xmag()))?;
                author.attribute(path, ("verticalAperture", "float"), aperture(lens.ymag()))?;
                (lens.znear(), lens.zfar())
            }
        };
        let range = Data::Vec2(Vec2::new(near, far));
        Ok(author.attribute(path, ("clippingRange", "float2"), range)?)
    }

    /// Units as the module says.
    fn light(
        &mut self,
        light: &gltf::khr_lights_punctual::Light<'_>,
        path: &str,
    ) -> Result<(), Error> {
        let author = &mut self.author;
        let intensity = match light.kind() {
            Kind::Directional => {
                author.define(path, "DistantLight")?;
                author.attribute(path, ("inputs:angle", "float"), Data::Float(0.0))?;
                light.intensity()
            }
            Kind::Point | Kind::Spot { .. } => {
                author.define(path, "SphereLight")?;
                author.attribute(path, ("inputs:radius", "float"), Data::Float(0.001))?;
                author.attribute(path, ("treatAsPoint", "bool"), Data::Bool(true))?;
                4.0 * light.intensity()
            }
        };
        author.attribute(path, ("inputs:intensity", "float"), Data::Float(intensity))?;
        author.attribute(path, ("inputs:normalize", "bool"), Data::Bool(true))?;
        let color = Data::Vec3(Vec3::from_array(light.color()));
        author.attribute(path, ("inputs:color", "color3f"), color)?;
        if let Kind::Spot {
            inner_cone_angle,
            outer_cone_angle,
        } = light.kind()
        {
            author.apply(path, &["ShapingAPI"])?;
            let softness = 1.0 - inner_cone_angle / outer_cone_angle.max(f32::MIN_POSITIVE);
            let angle = Data::Float(outer_cone_angle.to_degrees());
            author.attribute(path, ("inputs:shaping:cone:angle", "float"), angle)?;
            let softness = Data::Float(softness.clamp(0.0, 1.0));
            author.attribute(path, ("inputs:shaping:cone:softness", "float"), softness)?;
        }
        if light.range().is_some() {
            self.lost(path, "its range is left out: light reaches everywhere");
        }
        Ok(())
    }

    /// `EXT_mesh_gpu_instancing`.
    fn instancer(
        &mut self,
        instancing: &Value,
        mesh: &gltf::Mesh<'_>,
        (path, name): (&str, &str),
    ) -> Result<(), Error> {
        let places = self.places(instancing, path)?;
        let count = places.count;
        let author = &mut self.author;
        author.define(path, "PointInstancer")?;
        author.attribute(
            path,
            ("positions", "point3f[]"),
            Data::Vec3s(places.positions),
        )?;
        if let Some(rotations) = places.rotations {
            // half precision is what older programs read
            let half = Data::HalfQuats(rotations.clone());
            author.attribute(path, ("orientations", "quath[]"), half)?;
            author.attribute(path, ("orientationsf", "quatf[]"), Data::Quats(rotations))?;
        }
        if let Some(scales) = places.scales {
            author.attribute(path, ("scales", "float3[]"), Data::Vec3s(scales))?;
        }
        let indices = Data::Ints(vec![0; count]);
        author.attribute(path, ("protoIndices", "int[]"), indices)?;
        let prototype = format!("{path}/{}", prim_name(name));
        author.define(&prototype, "Xform")?;
        author.relate(path, "prototypes", std::slice::from_ref(&prototype))?;
        self.converted.prims += count;
        let mut below = Names::default();
        let mut place = |name: &str| format!("{prototype}/{}", below.unique(name));
        meshes::write(self, mesh, &mut place, name, None)
    }

    fn places(&self, instancing: &Value, path: &str) -> Result<Places, Error> {
        let wrong = self.wrong();
        let attributes = instancing.get("attributes").and_then(Value::as_object);
        let attributes = attributes
            .ok_or_else(|| wrong("EXT_mesh_gpu_instancing has no attributes".to_owned()))?;
        for key in attributes.keys().filter(|key| key.starts_with('_')) {
            self.lost(
                path,
                format!("the values {key} of its instances are left out"),
            );
        }
        let column = |key: &str, dimensions| -> Result<Option<Vec<f32>>, Error> {
            let Some(index) = attributes.get(key).and_then(Value::as_u64) else {
                return Ok(None);
            };
            let index = usize::try_from(index).unwrap_or(usize::MAX);
            let accessor = self.document.gltf.accessors().nth(index);
            let accessor =
                accessor.ok_or_else(|| wrong(format!("there is no accessor {index}")))?;
            let values = numbers(self.document, &accessor, &[dimensions]);
            values.map(Some).map_err(&wrong)
        };
        let vectors = |values: Vec<f32>| {
            values
                .chunks_exact(3)
                .map(Vec3::from_slice)
                .collect::<Vec<_>>()
        };
        let turns = |values: Vec<f32>| {
            let turns = values.chunks_exact(4).map(|q| unit(Quat::from_slice(q)));
            turns.collect::<Vec<_>>()
        };
        let positions = column("TRANSLATION", Dimensions::Vec3)?.map(vectors);
        let scales = column("SCALE", Dimensions::Vec3)?.map(vectors);
        let rotations = column("ROTATION", Dimensions::Vec4)?.map(turns);
        let lengths = [
            positions.as_ref().map(Vec::len),
            scales.as_ref().map(Vec::len),
            rotations.as_ref().map(Vec::len),
        ];
        let mut lengths = lengths.into_iter().flatten();
        let count = lengths.next().unwrap_or(0);
        if lengths.any(|length| length != count) {
            let message = "the attributes of EXT_mesh_gpu_instancing differ in length";
            return Err(wrong(message.to_owned()));
        }
        Ok(Places {
            count,
            positions: positions.unwrap_or_else(|| vec![Vec3::ZERO; count]),
            rotations,
            scales,
        })
    }
}

/// Where the instances of a node are.
struct Places {
    count: usize,
    positions: Vec<Vec3>,
    rotations: Option<Vec<Quat>>,
    scales: Option<Vec<Vec3>>,
}

/// No rotation where there is none to make unit.
pub(super) fn unit(turn: Quat) -> Quat {
    match turn.length_squared() > 0.0 {
        true => turn.normalize(),
        false => Quat::IDENTITY,
    }
}

fn samples(track: Track, type_name: &str) -> Vec<(f64, Data)> {
    match track {
        Track::Rotations(samples) => samples
            .into_iter()
            .map(|(time, value)| (time, Data::Quat(value)))
            .collect(),
        Track::Vectors(samples) => {
            let value = |value: Vec3| match type_name {
                "double3" => Data::DVec3(DVec3::from(value)),
                _ => Data::Vec3(value),
            };
            samples
                .into_iter()
                .map(|(time, v)| (time, value(v)))
                .collect()
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "USD's cameras are single precision"
)]
fn single(value: f64) -> f32 {
    value as f32
}
