//! One scene against what usd-core computes of the stage.

mod look;
mod normals;

use crate::truth::{Truth, list, number};
use glam::{DMat4, DVec3};
use serde_json::Value;
use std::collections::HashMap;
use surflux::diagnostics::Warning;
use surflux::scene::{FaceMaterials, Interpolation, Mesh, Prim, Scene, UpAxis};

/// Part of the largest number beside it by which a number may be off: positions are `f32`, after one product of
/// matrices and in the space of a mesh far from the origin 16 rounding errors of 6e-8.
const ROUNDING: f64 = 1e-6;

/// Gprims are polyhedra inside their extents: this part of the size may be missing at a side (a polygon of 24 edges
/// falls 1 − cos(π/24) short).
const CHORD: f64 = 0.01;

/// Prisms around curves stand out of the round tube by this part of what is around them at most.
const PRISM: f64 = 0.05;

/// What became of the values of a scene.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    pub(crate) prims: usize,
    pub(crate) equal: usize,
    /// Not equal, and a warning names the prim.
    pub(crate) unsupported: usize,
    /// Not judged: usd-core of `PyPI` has no opinion (looks in `.mtlx` files, light inputs from before USD 21).
    pub(crate) unjudged: usize,
    /// In silence.
    pub(crate) different: usize,
    /// One line for each field of them.
    pub(crate) differences: Vec<String>,
    /// What the unsupported ones are, and how many values.
    pub(crate) reasons: HashMap<String, usize>,
}

/// Compares one scene.
pub(crate) struct Comparison<'a> {
    scene: &'a Scene,
    truth: &'a Truth,
    warnings: &'a [Warning],
    tally: Tally,
    /// Our paths of materials in prototypes.
    shared: HashMap<String, String>,
}

/// Compare `scene`, read with `warnings`.
pub(crate) fn compare(scene: &Scene, truth: &Truth, warnings: &[Warning]) -> Tally {
    let mut comparison = Comparison {
        scene,
        truth,
        warnings,
        tally: Tally::default(),
        shared: HashMap::new(),
    };
    comparison.stage();
    comparison.drawn();
    comparison.lights();
    comparison.cameras();
    comparison.settings();
    comparison.tally
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or("")
}

fn close(a: f64, b: f64, scale: f64) -> bool {
    a == b || (a - b).abs() <= ROUNDING * scale || (a.is_nan() && b.is_nan())
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most, value| value.abs().max(most))
}

impl Comparison<'_> {
    /// Count `found` values that agree, out of `all`.
    fn count(&mut self, path: &str, field: &str, (agreeing, all): (usize, usize)) {
        self.tally.equal += agreeing;
        if agreeing == all {
            return;
        }
        let missing = all - agreeing;
        match self.warning_of(path) {
            Some(kind) => {
                self.tally.unsupported += missing;
                *self.tally.reasons.entry(kind).or_default() += missing;
            }
            None => {
                self.tally.different += missing;
                let line = format!("{path} {field}: {missing} of {all} values differ in silence");
                self.tally.differences.push(line);
            }
        }
    }

    fn one(&mut self, path: &str, field: &str, is_equal: bool) {
        self.count(path, field, (usize::from(is_equal), 1));
    }

    fn numbers(&mut self, path: &str, field: &str, found: &[f64], expected: &[f64]) {
        let scale = largest(expected);
        let pairs = found.iter().zip(expected);
        let agreeing = pairs.filter(|(a, b)| close(**a, **b, scale)).count();
        self.count(path, field, (agreeing, expected.len().max(found.len())));
    }

    /// Kind of a warning that names `path`, an ancestor of it, the instancer that draws it, or the same prim in a
    /// prototype.
    fn warning_of(&self, path: &str) -> Option<String> {
        let names = |warning: &&Warning| {
            let prim = warning.prim.as_str();
            let leads = path
                .strip_prefix(prim)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with(['/', '[', '.']));
            let below_prototype = prim
                .strip_prefix("/__Prototype_")
                .and_then(|rest| rest.split_once('/'));
            (leads && prim.len() > 1)
                || below_prototype.is_some_and(|(_, rest)| path.ends_with(rest))
        };
        self.warnings
            .iter()
            .find(names)
            .map(|warning| warning.kind.clone())
    }

    fn stage(&mut self) {
        let is_z = text(&self.truth.index["up"]) == "Z";
        self.one(
            "/",
            "upAxis",
            (self.scene.stage.up_axis == UpAxis::Z) == is_z,
        );
        let meters = number(&self.truth.index["meters"]);
        let default_prim = self.scene.stage.default_prim.as_deref();
        self.one(
            "/",
            "defaultPrim",
            default_prim == self.truth.index["default"].as_str(),
        );
        self.one(
            "/",
            "metersPerUnit",
            self.scene.stage.meters_per_unit == meters,
        );
    }

    fn drawn(&mut self) {
        let mut ours: HashMap<&str, &Prim> = HashMap::new();
        for prim in &self.scene.prims {
            ours.insert(&*prim.path, prim);
        }
        let truth = self.truth;
        for theirs in truth.index["drawn"].as_array().expect("a list") {
            let path = text(&theirs["path"]);
            if theirs["empty"].as_bool() == Some(true) {
                continue;
            }
            self.tally.prims += 1;
            let found = ours.remove(path);
            self.one(path, text(&theirs["type"]), found.is_some());
            if let Some(prim) = found {
                self.prim(prim, theirs);
            }
        }
        let extra: Vec<&str> = ours.into_keys().collect();
        for path in extra {
            self.one(path, "drawn, but not by usd-core", false);
        }
    }

    fn prim(&mut self, prim: &Prim, theirs: &Value) {
        let path = &*prim.path;
        let purpose = format!("{:?}", prim.purpose).to_lowercase();
        self.one(path, "purpose", purpose == text(&theirs["purpose"]));
        let mesh = self.scene.mesh_of(prim);
        if theirs["counts"].is_null() {
            self.extent(prim, theirs);
            self.hull(prim, theirs);
            let material = self.material(prim, 0);
            self.bound(
                path,
                material.as_deref(),
                &theirs["material"],
                &theirs["dangling"],
            );
            return;
        }
        self.one(
            path,
            "doubleSided",
            Some(mesh.double_sided) == theirs["double_sided"].as_bool(),
        );
        self.one(
            path,
            "subdivisionScheme",
            mesh.scheme == text(&theirs["scheme"]),
        );
        self.topology(path, mesh, theirs);
        self.positions(prim, theirs);
        self.primvars(path, mesh, theirs);
        self.normals(prim, theirs);
        self.materials(prim, theirs);
    }

    fn world(&self, prim: &Prim, position: glam::Vec3) -> DVec3 {
        let matrix = prim.world_from_object.matrix3;
        let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|axis| axis.as_dvec3());
        let [x, y, z] = position.as_dvec3().to_array();
        let translation = prim.world_from_object.translation.as_dvec3();
        self.scene.origin + translation + columns[0] * x + columns[1] * y + columns[2] * z
    }

    /// Implicit gprims: their extents, in object space by usd-core's matrix.
    fn extent(&mut self, prim: &Prim, theirs: &Value) {
        if theirs["extent"].is_null() {
            return;
        }
        let expected = list(&theirs["extent"]);
        let rows: [f64; 16] = list(&theirs["matrix"]).try_into().expect("16 numbers");
        let matrix = DMat4::from_cols_array(&rows);
        if matrix.determinant() == 0.0 {
            return;
        }
        let object_from_world = matrix.inverse();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &position in &self.scene.mesh_of(prim).positions {
            let position = object_from_world.transform_point3(self.world(prim, position));
            (low, high) = (low.min(position), high.max(position));
        }
        let found = [low.to_array(), high.to_array()].concat();
        let slack = CHORD * (largest(&expected) + ROUNDING);
        let agreeing = found
            .iter()
            .zip(&expected)
            .filter(|(a, b)| (*a - *b).abs() <= slack)
            .count();
        self.count(&prim.path, "extent", (agreeing, 6));
    }

    /// Curves and patches: inside the box of what they are made of.
    fn hull(&mut self, prim: &Prim, theirs: &Value) {
        if theirs["hull"].is_null() {
            return;
        }
        let hull = list(&theirs["hull"]);
        let rows: [f64; 16] = list(&theirs["matrix"]).try_into().expect("16 numbers");
        let object_from_world = DMat4::from_cols_array(&rows).inverse();
        let slack = PRISM * (largest(&hull) + ROUNDING);
        let positions = &self.scene.mesh_of(prim).positions;
        let is_inside = |&position: &glam::Vec3| {
            let position = object_from_world.transform_point3(self.world(prim, position));
            (0..3).all(|axis| {
                let range = hull[axis] - slack..=hull[axis + 3] + slack;
                range.contains(&position[axis])
            })
        };
        let inside = positions
            .iter()
            .filter(|position| is_inside(position))
            .count();
        self.count(
            &prim.path,
            "positions inside the hull",
            (inside, positions.len()),
        );
        // Hermite curves are read as the Bézier curves of the same shape.
        let drawn_as = match text(&theirs["type"]) {
            "HermiteCurves" => "BasisCurves",
            other => other,
        };
        self.one(
            &prim.path,
            "scheme",
            self.scene.mesh_of(prim).scheme == drawn_as,
        );
    }

    fn topology(&mut self, path: &str, mesh: &Mesh, theirs: &Value) {
        let (counts, indices) = match &mesh.cage {
            Some(cage) => (
                cage.face_vertex_counts.as_slice(),
                cage.face_vertex_indices.as_slice(),
            ),
            None => (&[][..], &[][..]),
        };
        let wide = |values: &[u32]| {
            values
                .iter()
                .map(|&value| f64::from(value))
                .collect::<Vec<_>>()
        };
        let (truth, name) = (self.truth, ["faceVertexCounts", "faceVertexIndices"]);
        self.numbers(path, name[0], &wide(counts), truth.array(&theirs["counts"]));
        self.numbers(
            path,
            name[1],
            &wide(indices),
            truth.array(&theirs["indices"]),
        );
        let holes = truth.indices(&theirs["holes"]);
        let drawn_holes = mesh
            .triangle_faces
            .iter()
            .filter(|&&face| holes.contains(&(face as usize)));
        let drawn_holes = drawn_holes.count();
        self.count(
            path,
            "holeIndices",
            (holes.len().saturating_sub(drawn_holes), holes.len()),
        );
    }

    fn positions(&mut self, prim: &Prim, theirs: &Value) {
        let which = self.truth.indices(&theirs["which"]);
        let expected = self.truth.array(&theirs["points"]);
        let scale = largest(expected);
        let positions = &self.scene.mesh_of(prim).positions;
        let agrees = |(&point, expected): (&usize, &[f64])| {
            let Some(&position) = positions.get(point) else {
                return 0;
            };
            let found = self.world(prim, position).to_array();
            found
                .iter()
                .zip(expected)
                .filter(|(a, b)| close(**a, **b, scale))
                .count()
        };
        let agreeing = which.iter().zip(expected.chunks_exact(3)).map(agrees).sum();
        self.count(&prim.path, "world positions", (agreeing, expected.len()));
    }

    /// At every corner of every triangle. Of refined meshes only what is constant over a face can be told.
    fn primvars(&mut self, path: &str, mesh: &Mesh, theirs: &Value) {
        let Some(cage) = &mesh.cage else { return };
        let starts: Vec<usize> = (cage.face_vertex_counts.iter())
            .scan(0, |start, &count| {
                let this = *start;
                *start += count as usize;
                Some(this)
            })
            .collect();
        for (name, entry) in theirs["primvars"].as_object().expect("an object") {
            let values = self.truth.array(&entry[2]);
            let width = number(&entry[1]);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "1 to 4"
            )]
            let width = width as usize;
            let interpolation = text(&entry[0]);
            let Some(primvar) = mesh.primvar(name) else {
                self.one(path, &format!("primvar {name}"), values.is_empty());
                continue;
            };
            let is_constant = ["constant", "uniform"].contains(&interpolation);
            if width > 4 || (mesh.scheme != "none" && !is_constant) {
                continue;
            }
            let (mut agreeing, mut all) = (0, 0);
            for t in 0..mesh.triangles.len() {
                let face = mesh.triangle_faces[t] as usize;
                for k in 0..3 {
                    let point = mesh.triangles[t][k];
                    let corners =
                        starts[face]..starts[face] + cage.face_vertex_counts[face] as usize;
                    let mut slots = match interpolation {
                        "constant" => 0..1,
                        "uniform" => face..face + 1,
                        "vertex" | "varying" => point as usize..point as usize + 1,
                        _ => corners,
                    };
                    let found = corner_value(primvar, mesh, t, k);
                    let equals = |slot: usize| {
                        let same_point = interpolation != "faceVarying"
                            || cage.face_vertex_indices[slot] == point;
                        let expected = values.get(slot * width..(slot + 1) * width);
                        same_point
                            && expected.is_some_and(|expected| {
                                expected
                                    .iter()
                                    .zip(found)
                                    .all(|(a, b)| close(*a, f64::from(b), largest(expected)))
                            })
                    };
                    all += width;
                    agreeing += if slots.any(equals) { width } else { 0 };
                }
            }
            self.count(path, &format!("primvar {name}"), (agreeing, all));
        }
    }

    fn material(&self, prim: &Prim, face: usize) -> Option<String> {
        let face = u32::try_from(face).expect("faces are numbered with 32 bits");
        let id = match &prim.materials {
            FaceMaterials::Whole(material) => *material,
            per_face => per_face.of_face(face),
        };
        let path = id.map(|id| self.scene.materials[id.index()].path.clone());
        // of a mesh light that nothing is bound to
        path.filter(|path| !path.is_empty())
    }

    fn materials(&mut self, prim: &Prim, theirs: &Value) {
        let count = self.truth.array(&theirs["counts"]).len();
        let mut expected = vec![Some((&theirs["material"], &theirs["dangling"])); count];
        let mut taken = vec![false; count];
        for subset in theirs["subsets"].as_array().expect("a list") {
            for face in self.truth.indices(&subset[2]) {
                // a face in two subsets has no defined material
                let is_new = face < count && !std::mem::replace(&mut taken[face], true);
                if face < count {
                    expected[face] = is_new.then_some((&subset[0], &subset[1]));
                }
            }
        }
        if theirs["subsets"].as_array().is_none_or(Vec::is_empty) {
            expected.truncate(1);
        }
        for (face, expected) in expected.into_iter().enumerate() {
            if let Some((material, dangling)) = expected {
                let found = self.material(prim, face);
                self.bound(&prim.path, found.as_deref(), material, dangling);
            }
        }
    }

    /// All instances share a material, which has one path here: that of one of them, and always the same.
    fn bound(&mut self, path: &str, found: Option<&str>, expected: &Value, dangling: &Value) {
        let last = |path: &str| path.rsplit('/').next().unwrap_or("").to_owned();
        if let (Some(found), true, Some(target)) = (found, expected.is_null(), dangling.as_str())
            && last(found) == last(target)
        {
            self.tally.unjudged += 1;
            return;
        }
        let is_equal = match (found, expected[1].as_str()) {
            (Some(found), Some(in_prototype)) => {
                let known = self.shared.entry(in_prototype.to_owned());
                known.or_insert_with(|| found.to_owned()) == found
                    && last(found) == last(in_prototype)
            }
            _ => found == expected[0].as_str(),
        };
        self.one(path, "material", is_equal);
    }
}

fn corner_value(primvar: &surflux::scene::Primvar, mesh: &Mesh, t: usize, k: usize) -> [f32; 4] {
    let slot = match &primvar.interpolation {
        Interpolation::Constant => 0,
        Interpolation::Uniform => mesh.triangle_faces[t],
        Interpolation::Vertex => mesh.triangles[t][k],
        Interpolation::Corner(corners) => corners[t][k],
    };
    primvar
        .values
        .get(slot as usize)
        .map_or([f32::NAN; 4], |value| value.to_array())
}
