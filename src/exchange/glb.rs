//! A scene → GLB for engines: positions, normals, vertex colors, texture coordinates, materials with their textures.
//!
//! Meshes that several prims show are shared. `displayColor` becomes `COLOR_0` where no texture stands for the color;
//! coordinates that textures read, and `st`, `TEXCOORD_0`, `TEXCOORD_1` … with v turned over. A root node turns +Z up to
//! +Y up and units to meters. What GLB has here is what surfaces reflect: lights, cameras and animation are left out, with a
//! warning.

mod textures;

use self::textures::{COORDINATES, Maps, SETS, Textures, coordinates_of, factor, read_of};
use super::Error;
use crate::diagnostics::Diagnostics;
use crate::scene::{
    Input, Interpolation, Material, MaterialId, Mesh, Prim, Primvar, Scene, UpAxis,
};
use crate::writers::usd::Provenance;
use crate::writers::write_whole;
use glam::{Affine3A, Mat3, Quat, Vec2, Vec3, Vec4};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Component types and targets of glTF.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Largest cosine between axes of a transform that is taken as translation, rotation and scale; others are applied to the
/// points.
const SKEW: f32 = 1e-4;

/// Write `scene` to `path`.
///
/// # Errors
/// Scenes of more than 4 GiB, which GLB cannot hold; files that cannot be written. Nothing is left behind then.
pub fn write(
    scene: &Scene,
    path: &Path,
    provenance: &Provenance,
    diagnostics: &Diagnostics,
) -> Result<(), Error> {
    let mut file = File {
        scene,
        provenance,
        diagnostics,
        bytes: Vec::new(),
        views: Vec::new(),
        accessors: Vec::new(),
        meshes: Vec::new(),
        materials: Vec::new(),
        textures: Textures::default(),
        material_of: BTreeMap::new(),
        mesh_of: BTreeMap::new(),
    };
    let mut nodes: Vec<Value> = scene
        .prims
        .iter()
        .filter_map(|prim| file.node(prim))
        .collect();
    let children: Vec<usize> = (0..nodes.len()).collect();
    let mut root = json!({ "name": "root", "children": children });
    if scene.stage.up_axis == UpAxis::Z {
        root["rotation"] = json!(Quat::from_rotation_x(-std::f32::consts::FRAC_PI_2).to_array());
    }
    if scene.stage.meters_per_unit != 1.0 {
        let unit = scene.stage.meters_per_unit;
        root["scale"] = json!([unit, unit, unit]);
    }
    if children.is_empty() {
        root.as_object_mut().map(|root| root.remove("children"));
    }
    nodes.push(root);
    if !scene.lights.is_empty() || !scene.cameras.is_empty() {
        let message = "lights and cameras are left out: surfaces are written";
        diagnostics.warn("lost", scene.stage.path.to_string_lossy(), message);
    }
    let bytes = file.finish(nodes, path)?;
    write_whole(path, &bytes).map_err(|source| Error::Unwritable {
        path: path.to_owned(),
        source,
    })
}

/// The file being made.
struct File<'a> {
    scene: &'a Scene,
    provenance: &'a Provenance,
    diagnostics: &'a Diagnostics,
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    textures: Textures,
    /// Index of each material that is used, by whether vertex colors stand for its color.
    material_of: BTreeMap<(Option<MaterialId>, bool), usize>,
    /// Index of each mesh with the materials it has.
    mesh_of: BTreeMap<(u32, String), usize>,
}

/// Vertices of a part of a mesh that has one material.
#[derive(Default)]
struct Part {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    colors: Vec<Vec4>,
    /// Of each set.
    coordinates: [Vec<Vec2>; SETS],
    indices: Vec<u32>,
    /// Vertex with these values.
    known: HashMap<[u32; 9 + 2 * SETS], u32>,
}

impl File<'_> {
    fn node(&mut self, prim: &Prim) -> Option<Value> {
        let mesh = self.scene.mesh_of(prim);
        if mesh.triangles.is_empty() {
            return None;
        }
        let name = prim.path.rsplit('/').next().unwrap_or_default();
        let placed = trs(prim.world_from_object);
        let index = match placed {
            Some(_) => {
                let key = (prim.mesh.0, format!("{:?}", prim.materials));
                match self.mesh_of.get(&key) {
                    Some(&index) => index,
                    None => {
                        let index = self.mesh(mesh, prim, Affine3A::IDENTITY);
                        self.mesh_of.insert(key, index);
                        index
                    }
                }
            }
            None => self.mesh(mesh, prim, prim.world_from_object),
        };
        let mut node = json!({ "name": name, "mesh": index });
        let (scale, rotation, translation) =
            placed.unwrap_or((Vec3::ONE, Quat::IDENTITY, Vec3::ZERO));
        let origin = self.scene.origin;
        let translation = (origin + translation.as_dvec3()).as_vec3();
        if translation != Vec3::ZERO {
            node["translation"] = json!(translation.to_array());
        }
        if rotation != Quat::IDENTITY {
            node["rotation"] = json!(rotation.to_array());
        }
        if scale != Vec3::ONE {
            node["scale"] = json!(scale.to_array());
        }
        Some(node)
    }

    /// Write `mesh` as `prim` shows it, its points moved by `place`; returns its index.
    fn mesh(&mut self, mesh: &Mesh, prim: &Prim, place: Affine3A) -> usize {
        let colors = mesh.primvar("displayColor");
        let mut parts: BTreeMap<Option<MaterialId>, Part> = BTreeMap::new();
        let turned = normal_matrix(place);
        let flips = place.matrix3.determinant() < 0.0;
        let mut sets_of: BTreeMap<Option<MaterialId>, Vec<Option<&Primvar>>> = BTreeMap::new();
        for t in 0..mesh.triangles.len() {
            let material = prim.materials.of_face(mesh.triangle_faces[t]);
            let part = parts.entry(material).or_default();
            let sets = sets_of
                .entry(material)
                .or_insert_with(|| self.coordinates(mesh, material));
            let normals = mesh
                .corner_normals(t)
                .unwrap_or_else(|| [mesh.plane_normal(t); 3]);
            let order = if flips { [0, 2, 1] } else { [0, 1, 2] };
            for k in order {
                let position = mesh.positions[mesh.triangles[t][k] as usize];
                let color = colors.map(|colors| at(colors, mesh, t, k));
                let coordinates = sets.iter().map(|set| {
                    let st = set.map_or(Vec4::ZERO, |set| at(set, mesh, t, k));
                    Vec2::new(st.x, 1.0 - st.y)
                });
                part.push(
                    place.transform_point3(position),
                    (turned * normals[k]).normalize_or_zero(),
                    color,
                    coordinates,
                );
            }
        }
        // colors of several primvars are one: a constant is a color of the material
        let has_colors =
            colors.is_some_and(|colors| colors.interpolation != Interpolation::Constant);
        let primitives: Vec<Value> = parts
            .into_iter()
            .map(|(material, part)| self.primitive(prim, material, (part, colors, has_colors)))
            .collect();
        let name = prim.path.rsplit('/').next().unwrap_or_default();
        self.meshes
            .push(json!({ "name": name, "primitives": primitives }));
        self.meshes.len() - 1
    }

    /// The primvar of each set of coordinates of what is made of `material`: what it reads (`None` where `mesh` has none,
    /// and readers see their fallback, 0), and `st` where there is one.
    fn coordinates<'m>(
        &self,
        mesh: &'m Mesh,
        material: Option<MaterialId>,
    ) -> Vec<Option<&'m Primvar>> {
        let material = material.map(|id| &self.scene.materials[id.index()]);
        let names = material.map(coordinates_of).unwrap_or_default();
        let mut sets: Vec<_> = names.iter().map(|name| coordinates(mesh, name)).collect();
        let more = coordinates(mesh, COORDINATES).filter(|_| !names.contains(&COORDINATES));
        if more.is_some() && sets.len() < SETS {
            sets.push(more);
        }
        sets
    }

    fn primitive(
        &mut self,
        prim: &Prim,
        material: Option<MaterialId>,
        (part, colors, has_colors): (Part, Option<&Primvar>, bool),
    ) -> Value {
        let low = part
            .positions
            .iter()
            .copied()
            .reduce(Vec3::min)
            .unwrap_or_default();
        let high = part
            .positions
            .iter()
            .copied()
            .reduce(Vec3::max)
            .unwrap_or_default();
        let position = self.accessor(part.positions.iter().flat_map(|p| p.to_array()), "VEC3", 3);
        self.accessors[position]["min"] = json!(low.to_array());
        self.accessors[position]["max"] = json!(high.to_array());
        let normal = self.accessor(part.normals.iter().flat_map(|n| n.to_array()), "VEC3", 3);
        let mut attributes = json!({ "POSITION": position, "NORMAL": normal });
        let mesh = self.scene.mesh_of(prim);
        let is_textured = material.is_some_and(|id| {
            read_of(&self.scene.materials[id.index()].diffuse_color)
                .is_some_and(|read| coordinates(mesh, &read.uv.primvar).is_some())
        });
        let has_colors = has_colors && !is_textured;
        if has_colors {
            let color = self.accessor(part.colors.iter().flat_map(|c| c.to_array()), "VEC4", 4);
            attributes["COLOR_0"] = json!(color);
        }
        for (k, set) in part.coordinates.iter().enumerate() {
            if !set.is_empty() {
                let set = self.accessor(set.iter().flat_map(|c| c.to_array()), "VEC2", 2);
                attributes[format!("TEXCOORD_{k}")] = json!(set);
            }
        }
        let start = self.bytes.len();
        self.bytes
            .extend(part.indices.iter().flat_map(|index| index.to_le_bytes()));
        self.views.push(json!({
            "buffer": 0, "byteOffset": start, "byteLength": 4 * part.indices.len(), "target": ELEMENT_ARRAY_BUFFER,
        }));
        self.accessors.push(json!({
            "bufferView": self.views.len() - 1, "componentType": UNSIGNED_INT, "count": part.indices.len(), "type": "SCALAR",
        }));
        let indices = self.accessors.len() - 1;
        let shown = match has_colors {
            true => None,
            false => colors.and_then(|colors| colors.values.first()).copied(),
        };
        let material = self.material(material, (prim, has_colors, shown));
        json!({ "attributes": attributes, "indices": indices, "material": material })
    }

    fn accessor(&mut self, numbers: impl Iterator<Item = f32>, kind: &str, width: usize) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(numbers.flat_map(f32::to_le_bytes));
        let length = self.bytes.len() - start;
        self.views.push(json!({
            "buffer": 0, "byteOffset": start, "byteLength": length, "target": ARRAY_BUFFER,
        }));
        self.accessors.push(json!({
            "bufferView": self.views.len() - 1, "componentType": FLOAT, "count": length / 4 / width, "type": kind,
        }));
        self.accessors.len() - 1
    }

    /// Index of the material `id` where vertex colors stand for its color (or not), or of one of the color `shown`.
    fn material(
        &mut self,
        id: Option<MaterialId>,
        (prim, has_colors, shown): (&Prim, bool, Option<Vec4>),
    ) -> usize {
        let known = self
            .material_of
            .get(&(id, has_colors))
            .filter(|_| id.is_some());
        if let Some(&index) = known {
            return index;
        }
        let gray = Material {
            path: prim.path.to_string(),
            diffuse_color: Input::Constant(shown.unwrap_or(Vec4::new(0.18, 0.18, 0.18, 1.0))),
            ..Material::default()
        };
        let material = id.map_or(&gray, |id| &self.scene.materials[id.index()]);
        let mut value = self.values(material, has_colors);
        value["doubleSided"] = json!(self.scene.mesh_of(prim).double_sided);
        self.materials.push(value);
        self.material_of
            .insert((id, has_colors), self.materials.len() - 1);
        self.materials.len() - 1
    }

    /// What a material says, its textures written.
    fn values(&mut self, material: &Material, has_colors: bool) -> Value {
        let diagnostics = self.diagnostics;
        let lost = |input: &str, why: String| {
            let message = format!("the texture of its {input} is left out: {why}");
            diagnostics.warn("lost", material.path.clone(), message);
        };
        if material.displaces() {
            let message = "its displacement is left out: surfaces lie where their meshes say";
            diagnostics.warn("lost", material.path.clone(), message);
        }
        let (bytes, views) = (&mut self.bytes, &mut self.views);
        let mut data = |image: &[u8]| {
            views.push(json!({
                "buffer": 0, "byteOffset": bytes.len(), "byteLength": image.len(),
            }));
            bytes.extend(image);
            bytes.resize(bytes.len().next_multiple_of(4), 0);
            views.len() - 1
        };
        let maps = self.textures.of_material(material, &mut data, &lost);
        let mut value = self.base_values(material, (&maps, has_colors));
        let surface = &mut value["pbrMetallicRoughness"];
        let is_color_twice = has_colors && read_of(&material.diffuse_color).is_some();
        if let Some(base) = maps.base.filter(|_| !is_color_twice) {
            surface["baseColorTexture"] = base;
        }
        if let Some(map) = maps.metallic_roughness {
            surface["metallicRoughnessTexture"] = map;
        }
        if let Some(map) = maps.emissive {
            value["emissiveTexture"] = map;
        }
        if let Some(map) = maps.normal {
            value["normalTexture"] = map;
        }
        value
    }

    fn base_values(&self, material: &Material, (maps, has_colors): (&Maps, bool)) -> Value {
        let constant = |name: &str, input: &Input, varying: Vec4| match input {
            Input::Constant(value) => *value,
            Input::Primvar { .. } if name == "diffuseColor" && has_colors => Vec4::ONE,
            Input::Primvar { fallback, .. } => {
                let message =
                    format!("its {name} varies over the surface: the material has one value of it");
                self.diagnostics
                    .warn("lost", material.path.clone(), message);
                *fallback
            }
            Input::Texture(_) => varying,
        };
        let white = Vec4::ONE;
        let color = match has_colors {
            true => white,
            false => constant("diffuseColor", &material.diffuse_color, white),
        };
        let opacity = constant("opacity", &material.opacity, white).x;
        let emission = match &material.emissive_color {
            // what shows a bake: its colors are there already
            Input::Primvar { .. } if has_colors => Vec4::ZERO,
            Input::Texture(_) if maps.emissive.is_some() => {
                Vec3::splat(maps.emissive_strength).extend(1.0)
            }
            input => constant("emissiveColor", input, Vec4::ZERO),
        };
        let strength = emission.truncate().max_element().max(1.0);
        let name = material.path.rsplit('/').next().unwrap_or_default();
        let is_display = matches!(&material.emissive_color, Input::Primvar { .. }) && has_colors;
        let has_map = maps.metallic_roughness.is_some();
        let number = |name: &str, input: &Input| match input {
            Input::Primvar { .. } => constant(name, input, white).x,
            _ => factor(input, has_map),
        };
        let mut value = json!({
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": color.truncate().clamp(Vec3::ZERO, Vec3::ONE).extend(opacity.clamp(0.0, 1.0)).to_array(),
                "metallicFactor": number("metallic", &material.metallic).clamp(0.0, 1.0),
                "roughnessFactor": number("roughness", &material.roughness).clamp(0.0, 1.0),
            },
            "emissiveFactor": (emission.truncate() / strength).clamp(Vec3::ZERO, Vec3::ONE).to_array(),
        });
        blend(&mut value, material, (maps.has_alpha, opacity));
        let mut extensions = serde_json::Map::new();
        if strength > 1.0 {
            let strength = json!({ "emissiveStrength": strength });
            extensions.insert("KHR_materials_emissive_strength".to_owned(), strength);
        }
        if is_display {
            extensions.insert("KHR_materials_unlit".to_owned(), json!({}));
        }
        if !extensions.is_empty() {
            value["extensions"] = Value::Object(extensions);
        }
        value
    }

    /// Extensions that something uses.
    fn extensions(&self) -> Vec<&'static str> {
        let of_materials = ["KHR_materials_emissive_strength", "KHR_materials_unlit"];
        let mut used: Vec<&str> = of_materials
            .into_iter()
            .filter(|name| {
                self.materials
                    .iter()
                    .any(|material| material["extensions"].get(name).is_some())
            })
            .collect();
        if self.textures.has_transforms {
            used.push("KHR_texture_transform");
        }
        used
    }

    fn finish(self, nodes: Vec<Value>, path: &Path) -> Result<Vec<u8>, Error> {
        let used = self.extensions();
        let root = nodes.len() - 1;
        let mut value = json!({
            "asset": {
                "version": "2.0",
                "generator": self.provenance.program(),
                "extras": { "command": self.provenance.words() },
            },
            "scene": 0,
            "scenes": [{ "nodes": [root] }],
            "nodes": nodes,
        });
        let lists = [
            ("meshes", self.meshes),
            ("materials", self.materials),
            ("images", self.textures.images),
            ("samplers", self.textures.samplers),
            ("textures", self.textures.textures),
            ("accessors", self.accessors),
            ("bufferViews", self.views),
        ];
        for (name, list) in lists {
            if !list.is_empty() {
                value[name] = Value::Array(list);
            }
        }
        if !used.is_empty() {
            value["extensionsUsed"] = json!(used);
        }
        if !self.bytes.is_empty() {
            value["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        }
        let mut text = value.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut data = self.bytes;
        data.resize(data.len().next_multiple_of(4), 0);
        let total = 12 + 8 + text.len() + 8 + data.len();
        let size = |size: usize| {
            u32::try_from(size).map_err(|_| Error::Unsuitable {
                path: path.to_owned(),
                message: format!("{total} bytes are more than a GLB holds (4 GiB): convert parts of the stage (--mask)"),
            })
        };
        let mut bytes = Vec::with_capacity(total);
        bytes.extend(b"glTF");
        bytes.extend(2_u32.to_le_bytes());
        bytes.extend(size(total)?.to_le_bytes());
        for (kind, chunk) in [(b"JSON", text), (b"BIN\0", data)] {
            bytes.extend(size(chunk.len())?.to_le_bytes());
            bytes.extend(kind);
            bytes.extend(chunk);
        }
        Ok(bytes)
    }
}

/// How what lies behind shows through: not where the alpha of a texture is below the threshold, or in part.
fn blend(value: &mut Value, material: &Material, (has_alpha, opacity): (bool, f32)) {
    match &material.opacity_threshold {
        Input::Constant(cut) if has_alpha && cut.x > 0.0 => {
            value["alphaMode"] = json!("MASK");
            value["alphaCutoff"] = json!(cut.x);
        }
        _ if has_alpha || opacity < 1.0 => value["alphaMode"] = json!("BLEND"),
        _ => {}
    }
}

impl Part {
    fn push(
        &mut self,
        position: Vec3,
        normal: Vec3,
        color: Option<Vec4>,
        coordinates: impl Iterator<Item = Vec2> + Clone,
    ) {
        let shown = color.unwrap_or(Vec4::ONE);
        let mut key = [0; 9 + 2 * SETS];
        let values = position.to_array().into_iter().chain(normal.to_array());
        let values = values
            .chain(shown.truncate().to_array())
            .chain(coordinates.clone().flat_map(|place| place.to_array()));
        for (key, value) in key.iter_mut().zip(values) {
            *key = value.to_bits();
        }
        let next = u32::try_from(self.positions.len()).unwrap_or(u32::MAX);
        let index = *self.known.entry(key).or_insert(next);
        if index == next {
            self.positions.push(position);
            self.normals.push(normal);
            self.colors
                .push(shown.truncate().max(Vec3::ZERO).extend(1.0));
            for (set, place) in self.coordinates.iter_mut().zip(coordinates) {
                set.push(place);
            }
        }
        self.indices.push(index);
    }
}

/// The primvar `name` of `mesh`, if it holds texture coordinates.
fn coordinates<'m>(mesh: &'m Mesh, name: &str) -> Option<&'m Primvar> {
    mesh.primvar(name).filter(|primvar| primvar.components == 2)
}

/// Value of a primvar at corner `k` of triangle `t`.
fn at(primvar: &Primvar, mesh: &Mesh, t: usize, k: usize) -> Vec4 {
    let index = match &primvar.interpolation {
        Interpolation::Constant => 0,
        Interpolation::Uniform => mesh.triangle_faces[t],
        Interpolation::Vertex => mesh.triangles[t][k],
        Interpolation::Corner(corners) => corners[t][k],
    };
    primvar.values[index as usize]
}

fn normal_matrix(place: Affine3A) -> Mat3 {
    let m = Mat3::from(place.matrix3);
    let cofactor = Mat3::from_cols(
        m.y_axis.cross(m.z_axis),
        m.z_axis.cross(m.x_axis),
        m.x_axis.cross(m.y_axis),
    );
    cofactor * m.determinant().signum()
}

/// Scale, rotation and translation of `place`; `None` where it shears or flattens.
fn trs(place: Affine3A) -> Option<(Vec3, Quat, Vec3)> {
    let m = Mat3::from(place.matrix3);
    let axes = [m.x_axis, m.y_axis, m.z_axis].map(Vec3::try_normalize);
    let [x, y, z] = [axes[0]?, axes[1]?, axes[2]?];
    let skew = x.dot(y).abs().max(y.dot(z).abs()).max(z.dot(x).abs());
    (skew < SKEW).then(|| place.to_scale_rotation_translation())
}
