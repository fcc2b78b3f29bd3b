//! Skins and morph targets → `Skeleton`, `SkelAnimation` and `BlendShape` prims below a `SkelRoot`.
//!
//! The joints of a skeleton are those of the skin and every node above them, so that the skeleton's space is that of the
//! scene, which glTF skins in: the transform of the node that shows the mesh has no say there, and none in `UsdSkel`. Only
//! joints that move are in the animation, whose scales USD keeps in half precision. A mesh with morph targets and no skin
//! has a skeleton of one joint that moves nothing: `UsdSkel` finds the weights of shapes through skeletons.

use super::accessor::numbers;
use super::motion::{Track, Tracks};
use super::nodes::{DEEPEST, Job, Names, unit};
use crate::exchange::Error;
use crate::writers::usd::author::{Author, Data};
use glam::{DMat4, DVec3, Mat4, Quat, Vec3};
use gltf::Semantic;
use gltf::accessor::Dimensions;
use gltf::mesh::Mode;
use std::collections::BTreeMap;

/// Where skeletons are.
pub(super) const SKELETONS: &str = "Skeletons";

/// Most values of a skeleton's animation: keys of one joint are keys of all that move.
const MOST_VALUES: usize = 1 << 26;

/// All skeletons of a file.
#[derive(Default)]
pub(super) struct Rigs {
    rigs: Vec<Rig>,
    of_skin: BTreeMap<usize, usize>,
    names: Names,
}

/// A skeleton to be written when it is known who uses it.
struct Rig {
    path: String,
    joints: Vec<Joint>,
    /// The joint of each joint of the skin; empty without a skin.
    slots: Vec<i32>,
    shapes: Vec<Shape>,
    shape_names: Names,
}

struct Joint {
    /// Names from the root, `Hips/Spine`.
    name: String,
    bind: DMat4,
    rest: (Vec3, Quat, Vec3),
    tracks: Option<Tracks>,
}

/// A morph target as a node shows it.
struct Shape {
    name: String,
    weight: f32,
    track: Option<Track>,
}

/// What the mesh of a node is bound to.
pub(super) struct Bound {
    skeleton: String,
    /// The skeleton's joint of each joint of the skin, if there is a skin.
    slots: Option<Vec<i32>>,
    /// Names of the morph targets.
    shapes: Vec<String>,
}

/// True if `document` has anything that is deformed.
pub(super) fn any(document: &gltf::Document) -> bool {
    document.nodes().any(|node| node.skin().is_some())
        || document.meshes().any(|mesh| morphs(&mesh))
}

/// True if `mesh` has morph targets.
pub(super) fn morphs(mesh: &gltf::Mesh<'_>) -> bool {
    let mut primitives = mesh.primitives();
    primitives.any(|primitive| primitive.morph_targets().next().is_some())
}

impl Job<'_> {
    /// The skeleton and the shapes of the mesh that `node` shows; `None` where nothing deforms it.
    pub(super) fn bind(
        &mut self,
        node: &gltf::Node<'_>,
        mesh: &gltf::Mesh<'_>,
    ) -> Result<Option<Bound>, Error> {
        let rig = match node.skin() {
            Some(skin) => self.rig_of_skin(&skin)?,
            None if morphs(mesh) => self.rig_of_shapes(node),
            None => return Ok(None),
        };
        let weights = node.weights().or_else(|| mesh.weights());
        let tracks = self.motion.weights_of(node.index());
        let targets = mesh.primitives().map(|part| part.morph_targets().count());
        let count = targets.max().unwrap_or(0);
        let names = target_names(mesh, count);
        let rig = &mut self.rigs.rigs[rig];
        let mut shapes = Vec::new();
        for (k, name) in names.into_iter().enumerate() {
            let name = rig.shape_names.unique(&name);
            shapes.push(name.clone());
            rig.shapes.push(Shape {
                name,
                weight: weights
                    .and_then(|weights| weights.get(k))
                    .copied()
                    .unwrap_or(0.0),
                track: tracks.and_then(|tracks| tracks.get(k)).cloned(),
            });
        }
        Ok(Some(Bound {
            skeleton: rig.path.clone(),
            slots: node.skin().map(|_| rig.slots.clone()),
            shapes,
        }))
    }

    fn rig_of_shapes(&mut self, node: &gltf::Node<'_>) -> usize {
        let still = Joint {
            name: "still".to_owned(),
            bind: DMat4::IDENTITY,
            rest: (Vec3::ZERO, Quat::IDENTITY, Vec3::ONE),
            tracks: None,
        };
        let name = format!("{}_shapes", node.name().unwrap_or("node"));
        self.rigs.add(&name, vec![still], Vec::new())
    }

    fn rig_of_skin(&mut self, skin: &gltf::Skin<'_>) -> Result<usize, Error> {
        if let Some(&rig) = self.rigs.of_skin.get(&skin.index()) {
            return Ok(rig);
        }
        let wrong = self.wrong();
        let made = joints(self, skin);
        let (joints, slots) =
            made.map_err(|message| wrong(format!("skin {}: {message}", skin.index())))?;
        let rig = self.rigs.add(skin.name().unwrap_or("skin"), joints, slots);
        self.rigs.of_skin.insert(skin.index(), rig);
        Ok(rig)
    }

    /// Write all skeletons with their animations.
    pub(super) fn skeletons(&mut self) -> Result<(), Error> {
        let rigs = std::mem::take(&mut self.rigs.rigs);
        if !rigs.is_empty() {
            self.author.define(&format!("/root/{SKELETONS}"), "Scope")?;
        }
        let wrong = self.wrong();
        for rig in rigs {
            let movers = rig.joints.iter().filter(|joint| joint.tracks.is_some());
            let times = times(
                movers
                    .clone()
                    .flat_map(|joint| joint.tracks.iter())
                    .flat_map(Tracks::all),
            );
            let weight_times = times_of_shapes(&rig.shapes);
            let values = times.len().saturating_mul(movers.count());
            let weights = weight_times.len().saturating_mul(rig.shapes.len());
            if values.max(weights) > MOST_VALUES {
                return Err(wrong(format!(
                    "the animation of {} has more than {MOST_VALUES} values",
                    rig.path
                )));
            }
            rig.write(self.author, (&times, &weight_times))?;
        }
        Ok(())
    }
}

impl Rigs {
    fn add(&mut self, name: &str, joints: Vec<Joint>, slots: Vec<i32>) -> usize {
        self.rigs.push(Rig {
            path: format!("/root/{SKELETONS}/{}", self.names.unique(name)),
            joints,
            slots,
            shapes: Vec::new(),
            shape_names: Names::default(),
        });
        self.rigs.len() - 1
    }
}

/// The joints of `skin` and all nodes above them, parents first, and which of them each joint of the skin is.
fn joints(job: &Job<'_>, skin: &gltf::Skin<'_>) -> Result<(Vec<Joint>, Vec<i32>), String> {
    let nodes: Vec<gltf::Node<'_>> = job.document.gltf.nodes().collect();
    let mut parents = vec![None; nodes.len()];
    for node in &nodes {
        for child in node.children() {
            parents[child.index()] = Some(node.index());
        }
    }
    let mut depths: BTreeMap<usize, usize> = BTreeMap::new();
    for joint in skin.joints() {
        let line = std::iter::successors(Some(joint.index()), |&at| parents[at]);
        let line: Vec<usize> = line.take(DEEPEST + 2).collect();
        if line.len() > DEEPEST + 1 {
            return Err(format!("its joints are more than {DEEPEST} nodes deep"));
        }
        for (above, &node) in line.iter().enumerate() {
            depths.insert(node, line.len() - above);
        }
    }
    let mut order: Vec<usize> = depths.keys().copied().collect();
    order.sort_by_key(|node| (depths[node], *node));
    let slot_of: BTreeMap<usize, usize> = order
        .iter()
        .enumerate()
        .map(|(slot, &node)| (node, slot))
        .collect();
    let mut joints: Vec<Joint> = Vec::with_capacity(order.len());
    let mut worlds: Vec<DMat4> = Vec::with_capacity(order.len());
    let mut names: BTreeMap<Option<usize>, Names> = BTreeMap::new();
    for &at in &order {
        let parent = parents[at].map(|parent| slot_of[&parent]);
        let default = format!("node_{at}");
        let own = names.entry(parent).or_default();
        let own = own.unique(nodes[at].name().unwrap_or(&default));
        let rest = rest(&nodes[at])?;
        let world = parent.map_or(DMat4::IDENTITY, |parent| worlds[parent]) * matrix(rest);
        worlds.push(world);
        joints.push(Joint {
            name: match parent {
                Some(parent) => format!("{}/{own}", joints[parent].name),
                None => own,
            },
            bind: world,
            rest,
            tracks: job.motion.of(at).cloned(),
        });
    }
    let slots: Vec<usize> = skin.joints().map(|joint| slot_of[&joint.index()]).collect();
    for (k, bind) in binds(job, skin, slots.len())?.into_iter().enumerate() {
        joints[slots[k]].bind = bind;
    }
    let slots = slots
        .into_iter()
        .map(|slot| i32::try_from(slot).unwrap_or(i32::MAX));
    Ok((joints, slots.collect()))
}

/// Where each joint was in the scene when the mesh was bound.
fn binds(job: &Job<'_>, skin: &gltf::Skin<'_>, count: usize) -> Result<Vec<DMat4>, String> {
    let Some(accessor) = skin.inverse_bind_matrices() else {
        return Ok(vec![DMat4::IDENTITY; count]);
    };
    let values = numbers(job.document, &accessor, &[Dimensions::Mat4])?;
    let matrices = values
        .chunks_exact(16)
        .map(|m| Mat4::from_cols_slice(m).as_dmat4());
    let matrices: Vec<DMat4> = matrices.take(count).collect();
    if matrices.len() < count {
        return Err(format!(
            "it has {} inverse bind matrices for {count} joints",
            matrices.len()
        ));
    }
    let inverses = matrices.iter().map(DMat4::inverse).collect::<Vec<_>>();
    match inverses.iter().position(|inverse| !inverse.is_finite()) {
        Some(k) => Err(format!(
            "inverse bind matrix {k} is not the inverse of anything"
        )),
        None => Ok(inverses),
    }
}

/// Translation, rotation and scale of `node`.
fn rest(node: &gltf::Node<'_>) -> Result<(Vec3, Quat, Vec3), String> {
    let (translation, rotation, scale) = node.transform().decomposed();
    let (translation, scale) = (Vec3::from_array(translation), Vec3::from_array(scale));
    let rotation = Quat::from_array(rotation);
    match translation.is_finite() && rotation.is_finite() && scale.is_finite() {
        true => Ok((translation, unit(rotation), scale)),
        false => Err(format!(
            "the transform of node {} is not finite",
            node.index()
        )),
    }
}

fn matrix((translation, rotation, scale): (Vec3, Quat, Vec3)) -> DMat4 {
    let (translation, scale): (DVec3, DVec3) = (translation.as_dvec3(), scale.as_dvec3());
    DMat4::from_scale_rotation_translation(scale, rotation.as_dquat().normalize(), translation)
}

/// Names of the morph targets: `extras.targetNames`, where most programs write them, or `MESH_0` and so on.
fn target_names(mesh: &gltf::Mesh<'_>, count: usize) -> Vec<String> {
    let extras = mesh.extras().as_ref();
    let extras = extras.and_then(|raw| serde_json::from_str::<serde_json::Value>(raw.get()).ok());
    let named = |k: usize| {
        let name = extras.as_ref()?.get("targetNames")?.get(k)?.as_str()?;
        Some(name.to_owned())
    };
    let mesh = mesh.name().unwrap_or("shape");
    let names = (0..count).map(|k| named(k).unwrap_or_else(|| format!("{mesh}_{k}")));
    names.collect()
}

/// All times of `tracks`, rising.
fn times<'a>(tracks: impl Iterator<Item = &'a Track>) -> Vec<f64> {
    let mut times: Vec<f64> = tracks.flat_map(Track::times).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    times
}

fn times_of_shapes(shapes: &[Shape]) -> Vec<f64> {
    times(shapes.iter().filter_map(|shape| shape.track.as_ref()))
}

impl Rig {
    fn write(&self, author: &mut Author, times: (&[f64], &[f64])) -> Result<(), Error> {
        let path = &self.path;
        author.define(path, "Skeleton")?;
        let names = Data::Names(self.joints.iter().map(|joint| joint.name.clone()).collect());
        author.uniform(path, ("joints", "token[]"), names)?;
        let binds = self.joints.iter().map(|joint| joint.bind).collect();
        author.uniform(
            path,
            ("bindTransforms", "matrix4d[]"),
            Data::Matrices(binds),
        )?;
        let rests = self.joints.iter().map(|joint| matrix(joint.rest)).collect();
        author.uniform(
            path,
            ("restTransforms", "matrix4d[]"),
            Data::Matrices(rests),
        )?;
        let movers: Vec<&Joint> = self
            .joints
            .iter()
            .filter(|joint| joint.tracks.is_some())
            .collect();
        if movers.is_empty() && self.shapes.is_empty() {
            return Ok(());
        }
        let animation = format!("{path}/Animation");
        author.define(&animation, "SkelAnimation")?;
        author.apply(path, &["SkelBindingAPI"])?;
        author.relate(
            path,
            "skel:animationSource",
            std::slice::from_ref(&animation),
        )?;
        if !movers.is_empty() {
            write_motion(author, &animation, &movers, times.0)?;
        }
        if !self.shapes.is_empty() {
            self.write_weights(author, &animation, times.1)?;
        }
        Ok(())
    }

    fn write_weights(&self, author: &mut Author, path: &str, times: &[f64]) -> Result<(), Error> {
        let names = self.shapes.iter().map(|shape| shape.name.clone());
        let names = Data::Names(names.collect());
        author.uniform(path, ("blendShapes", "token[]"), names)?;
        let at = |time: f64| {
            let weight = |shape: &Shape| match &shape.track {
                Some(track) => track.vector_at(time).x,
                None => shape.weight,
            };
            Data::Floats(self.shapes.iter().map(weight).collect())
        };
        let name = ("blendShapeWeights", "float[]");
        if times.is_empty() {
            author.attribute(path, name, at(0.0))?;
        } else {
            let samples = times.iter().map(|&time| (time, at(time)));
            author.samples(path, name, samples.collect())?;
        }
        Ok(())
    }
}

fn write_motion(
    author: &mut Author,
    path: &str,
    movers: &[&Joint],
    times: &[f64],
) -> Result<(), Error> {
    let names = movers.iter().map(|joint| joint.name.clone()).collect();
    author.uniform(path, ("joints", "token[]"), Data::Names(names))?;
    let vectors = |time: f64, track: fn(&Tracks) -> &Option<Track>, rest: fn(&Joint) -> Vec3| {
        let value = |joint: &&Joint| match joint.tracks.as_ref().and_then(|t| track(t).as_ref()) {
            Some(track) => track.vector_at(time),
            None => rest(joint),
        };
        movers.iter().map(value).collect::<Vec<Vec3>>()
    };
    let turn = |joint: &Joint, time: f64| {
        let track = joint.tracks.as_ref().and_then(|t| t.rotation.as_ref());
        track.map_or(joint.rest.1, |track| track.rotation_at(time))
    };
    let samples = |at: &dyn Fn(f64) -> Data| times.iter().map(|&t| (t, at(t))).collect::<Vec<_>>();
    let moved =
        samples(&|time| Data::Vec3s(vectors(time, |t| &t.translation, |joint| joint.rest.0)));
    author.samples(path, ("translations", "float3[]"), moved)?;
    let turned =
        samples(&|time| Data::Quats(movers.iter().map(|joint| turn(joint, time)).collect()));
    author.samples(path, ("rotations", "quatf[]"), turned)?;
    let scaled =
        samples(&|time| Data::HalfVec3s(vectors(time, |t| &t.scale, |joint| joint.rest.2)));
    Ok(author.samples(path, ("scales", "half3[]"), scaled)?)
}

/// Bind the prim that `primitive` of `count` vertices was written to.
pub(super) fn attach(
    job: &mut Job<'_>,
    primitive: &gltf::Primitive<'_>,
    (count, path): (usize, &str),
    bound: &Bound,
) -> Result<(), Error> {
    let wrong = job.wrong();
    let wrong = |message: String| wrong(format!("{path}: {message}"));
    let apis: &[&str] = match primitive.mode() {
        Mode::Points => &["SkelBindingAPI"],
        _ => &["MaterialBindingAPI", "SkelBindingAPI"],
    };
    job.author.apply(path, apis)?;
    let skeleton = std::slice::from_ref(&bound.skeleton);
    job.author.relate(path, "skel:skeleton", skeleton)?;
    if let Some(slots) = &bound.slots {
        let found = influences(job, primitive, slots).map_err(&wrong)?;
        let (width, indices, weights) = found;
        let width = i32::try_from(width).unwrap_or(i32::MAX);
        let name = ("primvars:skel:jointIndices", "int[]");
        job.author.grouped(path, name, width, Data::Ints(indices))?;
        let name = ("primvars:skel:jointWeights", "float[]");
        job.author
            .grouped(path, name, width, Data::Floats(weights))?;
    }
    let mut targets = Vec::new();
    let mut names = Vec::new();
    for (target, name) in primitive.morph_targets().zip(&bound.shapes) {
        let shape = format!("{path}/{name}");
        write_shape(job, &target, (count, &shape), &wrong)?;
        targets.push(shape);
        names.push(name.clone());
    }
    if !targets.is_empty() {
        job.author
            .uniform(path, ("skel:blendShapes", "token[]"), Data::Names(names))?;
        job.author
            .relate(path, "skel:blendShapeTargets", &targets)?;
    }
    Ok(())
}

/// Influences a vertex, the joint of each, and its weight; weights of a vertex add up to 1.
fn influences(
    job: &Job<'_>,
    primitive: &gltf::Primitive<'_>,
    slots: &[i32],
) -> Result<(usize, Vec<i32>, Vec<f32>), String> {
    let mut sets = Vec::new();
    for set in 0.. {
        let joints = primitive.get(&Semantic::Joints(set));
        let weights = primitive.get(&Semantic::Weights(set));
        match (joints, weights) {
            (Some(joints), Some(weights)) => sets.push((
                numbers(job.document, &joints, &[Dimensions::Vec4])?,
                numbers(job.document, &weights, &[Dimensions::Vec4])?,
            )),
            (None, None) => break,
            _ => {
                return Err(format!(
                    "it has one of JOINTS_{set} and WEIGHTS_{set}, not both"
                ));
            }
        }
    }
    let Some((first, _)) = sets.first() else {
        return Err("its node has a skin, but it has no JOINTS_0".to_owned());
    };
    let vertices = first.len() / 4;
    let (mut indices, mut weights) = (Vec::new(), Vec::new());
    for vertex in 0..vertices {
        let place = 4 * vertex..4 * vertex + 4;
        let own = sets.iter().flat_map(|(joints, weights)| {
            joints[place.clone()].iter().zip(&weights[place.clone()])
        });
        let sum: f32 = own.clone().map(|(_, weight)| weight.max(0.0)).sum();
        for (k, (&joint, &weight)) in own.enumerate() {
            weights.push(match sum > 0.0 {
                true => weight.max(0.0) / sum,
                // moved by nothing: it goes with the first joint
                false => f32::from(u8::from(k == 0)),
            });
            indices.push(slot(joint, slots).or_else(|message| match weight > 0.0 {
                true => Err(message),
                false => Ok(0),
            })?);
        }
    }
    Ok((4 * sets.len(), indices, weights))
}

/// The skeleton's joint of the skin's joint `joint`.
fn slot(joint: f32, slots: &[i32]) -> Result<i32, String> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates; whole numbers of up to 16 bits are what files hold"
    )]
    let index = joint as usize;
    slots.get(index).copied().ok_or_else(|| {
        format!(
            "joint {index} is out of range, its skin has {}",
            slots.len()
        )
    })
}

/// A `BlendShape` of the vertices that `target` moves.
fn write_shape(
    job: &mut Job<'_>,
    target: &gltf::mesh::MorphTarget<'_>,
    (count, path): (usize, &str),
    wrong: &dyn Fn(String) -> Error,
) -> Result<(), Error> {
    let read = |accessor: Option<gltf::Accessor<'_>>| -> Result<Option<Vec<Vec3>>, String> {
        let Some(accessor) = accessor else {
            return Ok(None);
        };
        let values = numbers(job.document, &accessor, &[Dimensions::Vec3])?;
        match values.len() == 3 * count {
            true => Ok(Some(values.chunks_exact(3).map(Vec3::from_slice).collect())),
            false => Err(format!(
                "a morph target has {} values where {count} are needed",
                values.len() / 3
            )),
        }
    };
    let offsets = read(target.positions()).map_err(wrong)?;
    let offsets = offsets.unwrap_or_else(|| vec![Vec3::ZERO; count]);
    let normals = read(target.normals()).map_err(wrong)?;
    let moves = |k: &usize| {
        offsets[*k] != Vec3::ZERO || normals.as_ref().is_some_and(|n| n[*k] != Vec3::ZERO)
    };
    // an empty list would mean all of them
    let mut moved: Vec<usize> = (0..count).filter(moves).collect();
    if moved.is_empty() {
        moved.extend((count > 0).then_some(0));
    }
    let of_moved = |values: &[Vec3]| Data::Vec3s(moved.iter().map(|&k| values[k]).collect());
    let author = &mut job.author;
    author.define(path, "BlendShape")?;
    author.uniform(path, ("offsets", "vector3f[]"), of_moved(&offsets))?;
    if let Some(normals) = &normals {
        author.uniform(path, ("normalOffsets", "vector3f[]"), of_moved(normals))?;
    }
    let indices = moved.iter().map(|&k| i32::try_from(k).unwrap_or(i32::MAX));
    let indices = Data::Ints(indices.collect());
    Ok(author.uniform(path, ("pointIndices", "int[]"), indices)?)
}
