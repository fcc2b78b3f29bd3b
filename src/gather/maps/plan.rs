//! Scene → what the maps draw: prims sorted by how dense their triangles are, and the few flat ones that are better
//! tested exactly.

use super::borders::{self, Edges, Turn};
use super::decimate::decimate;
use super::flat::{self, Flat};
use super::handover;
use super::shell::Shell;
use crate::math::Bounds3;
use crate::math::parts::{in_parts, takes_threads};
use crate::scene::{Mesh, Prim, PrimId, Scene};
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Prims whose edges are this many times longer than those of the densest prim in a map get a map of their own.
const CLASS_RATIO: f32 = 4.0;

/// Edges are measured on at most about this many triangles a mesh: their mean is then known to within 1 %.
const EDGE_SAMPLES: usize = 1 << 14;

/// Occluders of one scene, ready for any [`super::MapsSettings`]. Cost: one pass over the triangles.
#[derive(Debug)]
pub struct MapsPlan<'a> {
    pub(super) scene: &'a Scene,
    /// Everything is drawn relative to this point, so that numbers are as small as the scene.
    pub(super) center: Vec3,
    /// Half the diagonal of the scene's bounds.
    pub(super) radius: f32,
    /// Prims of alike density, the densest first.
    pub(super) classes: Vec<Class>,
    /// Flat prims, tested exactly, relative to `center`.
    pub(super) flats: Vec<Flat>,
    /// Of each mesh: see [`Self::normals`].
    normals: Vec<OnceLock<Vec<Vec3>>>,
    /// Of each mesh: see [`Self::turns`].
    turns: Vec<OnceLock<Vec<Turn>>>,
    /// Of each mesh: see [`Self::edges`].
    edges: Vec<OnceLock<Edges>>,
    /// Of each mesh: see [`Self::creases`].
    creases: Vec<OnceLock<Vec<bool>>>,
    /// See [`Self::thinned`].
    thinned: Mutex<Thinned>,
}

/// Meshes thinned to cells of one detail.
#[derive(Debug, Default)]
struct Thinned {
    /// Width of the cells, in mean edges.
    detail: f32,
    /// By mesh, and width of the cells in object units.
    shells: HashMap<(usize, u32), Arc<Shell<'static>>>,
}

/// Prims that share a map.
#[derive(Debug)]
pub(super) struct Class {
    pub(super) occluders: Vec<Occluder>,
    /// Mean edge of their triangles, stage units.
    pub(super) edge: f32,
    /// Relative to the plan's center.
    pub(super) bounds: Bounds3,
}

/// A prim in a map.
#[derive(Debug, Clone, Copy)]
pub(super) struct Occluder {
    pub(super) prim: PrimId,
    /// To coordinates relative to the plan's center.
    pub(super) local_from_object: DAffine3,
    /// Mean edge, stage units.
    pub(super) edge: f32,
    /// Stage units an object unit.
    pub(super) scale: f32,
    /// True if it is closed and its fronts look outwards: then no ray meets a back before a front.
    pub(super) is_solid: bool,
}

/// What a mesh is like, in object space.
#[derive(Debug, Clone, Copy)]
struct Form {
    edge: f32,
    is_solid: bool,
    bounds: Bounds3,
}

impl<'a> MapsPlan<'a> {
    /// Look at all prims of `scene`.
    pub fn new(scene: &'a Scene) -> Self {
        let bounds = scene.bounds();
        let (center, radius) = if bounds.is_empty() {
            (Vec3::ZERO, 0.0)
        } else {
            (bounds.center(), 0.5 * bounds.diagonal())
        };
        let forms: Vec<Form> = scene.meshes.par_iter().map(form).collect();
        let local_from_world = DAffine3::from_translation(-center.as_dvec3());
        let mut flats = Vec::new();
        let mut occluders = Vec::new();
        for (index, prim) in (0_u32..).zip(&scene.prims) {
            let occluder = occluder(
                PrimId(index),
                prim,
                forms[prim.mesh.index()],
                local_from_world,
            );
            let mesh = scene.mesh_of(prim);
            match flat::find(mesh, &occluder) {
                Some(flat) if flats.len() < flat::MOST => flats.push(flat),
                _ if occluder.edge > 0.0 => occluders.push(occluder),
                _ => {}
            }
        }
        Self {
            scene,
            center,
            radius,
            classes: classify(scene, &forms, occluders),
            flats,
            normals: scene.meshes.iter().map(|_| OnceLock::new()).collect(),
            turns: scene.meshes.iter().map(|_| OnceLock::new()).collect(),
            edges: scene.meshes.iter().map(|_| OnceLock::new()).collect(),
            creases: scene.meshes.iter().map(|_| OnceLock::new()).collect(),
            thinned: Mutex::default(),
        }
    }

    /// Make ready to thin to cells of `detail` mean edges. What was thinned to that before is kept, as a pilot tries what the
    /// run then takes; all else is forgotten.
    pub(super) fn expect_detail(&self, detail: f32) {
        let mut known = self.thinned.lock().unwrap_or_else(PoisonError::into_inner);
        if known.detail.to_bits() != detail.to_bits() {
            *known = Thinned {
                detail,
                shells: HashMap::new(),
            };
        }
        drop(known);
        let occluders = self.classes.iter().flat_map(|class| &class.occluders);
        // By all threads together: see below.
        for occluder in occluders.filter(|o| takes_threads(self.mesh(o).triangles.len())) {
            self.normals(self.scene.prims[occluder.prim.index()].mesh.index());
        }
    }

    /// The mesh of `occluder` with cells of `cell` object units, of the detail that is expected.
    pub(super) fn thinned(&self, occluder: &Occluder, cell: f32) -> Arc<Shell<'static>> {
        let mesh = self.scene.prims[occluder.prim.index()].mesh.index();
        let key = (mesh, cell.to_bits());
        let known = || self.thinned.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(shell) = known().shells.get(&key) {
            return Arc::clone(shell);
        }
        let shell = decimate(self.mesh(occluder), self.normals(mesh), cell);
        Arc::clone(known().shells.entry(key).or_insert_with(|| Arc::new(shell)))
    }

    /// Area-weighted normals of the positions of a mesh, twice the area long, zero where nothing is attached.
    pub(super) fn normals(&self, mesh: usize) -> &[Vec3] {
        self.normals[mesh].get_or_init(|| normals(&self.scene.meshes[mesh]))
    }

    // What follows is found by all threads together: whoever asks first must not be one of several at work, or it could
    // wait for itself.

    /// How far the faces around each position of a mesh are turned away from each other.
    fn turns(&self, mesh: usize) -> &[Turn] {
        let turns = || borders::turns(&self.scene.meshes[mesh], self.normals(mesh));
        self.turns[mesh].get_or_init(turns)
    }

    /// Edges of the mesh of a prim that maps are blind at.
    pub(super) fn edges(&self, occluder: &Occluder) -> &Edges {
        let mesh = self.scene.prims[occluder.prim.index()].mesh.index();
        self.edges[mesh].get_or_init(|| Edges::of(&self.scene.meshes[mesh], self.turns(mesh)))
    }

    /// Which positions of a mesh the faces around them cover.
    pub(super) fn creases(&self, mesh: usize) -> &[bool] {
        let known = || (self.normals(mesh), self.turns(mesh));
        let creases = || handover::creases(&self.scene.meshes[mesh], known());
        self.creases[mesh].get_or_init(creases)
    }

    /// Mean edge of the densest prims, stage units: the unit of [`super::MapsSettings::pixel`]. 0 if nothing is drawn
    /// into maps.
    pub fn edge(&self) -> f32 {
        self.classes.first().map_or(0.0, |class| class.edge)
    }

    /// Triangles that are drawn into maps at full density, instances counted each.
    pub fn triangle_count(&self) -> usize {
        let of_prim = |occluder: &Occluder| self.mesh(occluder).triangles.len();
        let classes = self.classes.iter();
        classes
            .flat_map(|class| class.occluders.iter().map(of_prim))
            .sum()
    }

    pub(super) fn mesh(&self, occluder: &Occluder) -> &'a Mesh {
        self.scene.mesh_of(&self.scene.prims[occluder.prim.index()])
    }
}

fn occluder(id: PrimId, prim: &Prim, form: Form, local_from_world: DAffine3) -> Occluder {
    let affine = prim.world_from_object;
    let world_from_object = DAffine3 {
        matrix3: glam::Mat3::from(affine.matrix3).as_dmat3(),
        translation: Vec3::from(affine.translation).as_dvec3(),
    };
    let scale = affine.matrix3.determinant().abs().cbrt();
    Occluder {
        prim: id,
        local_from_object: local_from_world * world_from_object,
        edge: form.edge * scale,
        scale,
        is_solid: form.is_solid,
    }
}

fn form(mesh: &Mesh) -> Form {
    let step = (mesh.triangles.len() / EDGE_SAMPLES).max(1);
    let (mut sum, mut count) = (0.0_f64, 0.0_f64);
    for t in (0..mesh.triangles.len()).step_by(step) {
        let [a, b, c] = mesh.corners(t);
        sum += f64::from(a.distance(b) + b.distance(c) + c.distance(a));
        count += 3.0;
    }
    let mean = if count > 0.0 { sum / count } else { 0.0 };
    #[expect(clippy::cast_possible_truncation, reason = "rounded once, at its end")]
    let edge = mean as f32;
    Form {
        edge,
        is_solid: mesh.closed && signed_volume(mesh) > 0.0,
        bounds: mesh.bounds(),
    }
}

/// Six times the volume that the fronts enclose, negative if they look inwards: the columns between the triangles and
/// a plane across x.
fn signed_volume(mesh: &Mesh) -> f64 {
    let origin = mesh.positions.first().copied().unwrap_or_default();
    let columns = |t: &[u32; 3]| {
        let [a, b, c] = corners(mesh, t);
        let (u, v) = (b - a, c - a);
        let across = f64::from(u.y) * f64::from(v.z) - f64::from(u.z) * f64::from(v.y);
        let far = |p: Vec3| f64::from(p.x - origin.x);
        (far(a) + far(b) + far(c)) * across
    };
    mesh.triangles.iter().map(columns).sum()
}

fn corners(mesh: &Mesh, t: &[u32; 3]) -> [Vec3; 3] {
    let p = &mesh.positions;
    [p[t[0] as usize], p[t[1] as usize], p[t[2] as usize]]
}

pub(super) fn normals(mesh: &Mesh) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; mesh.positions.len()];
    in_parts(&mut normals, mesh.triangles.len(), |mut part| {
        let range = part.range();
        for t in &mesh.triangles {
            if !t.iter().any(|&i| range.contains(&(i as usize))) {
                continue;
            }
            let [a, b, c] = corners(mesh, t);
            let normal = (b - a).cross(c - a);
            for &i in t {
                if let Some(sum) = part.get_mut(i as usize) {
                    *sum += normal;
                }
            }
        }
    });
    normals
}

fn classify(scene: &Scene, forms: &[Form], mut occluders: Vec<Occluder>) -> Vec<Class> {
    occluders.sort_by(|a, b| a.edge.total_cmp(&b.edge).then(a.prim.cmp(&b.prim)));
    let mut classes: Vec<Vec<Occluder>> = Vec::new();
    for occluder in occluders {
        match classes.last_mut() {
            Some(class) if occluder.edge < CLASS_RATIO * class[0].edge => class.push(occluder),
            _ => classes.push(vec![occluder]),
        }
    }
    let class = |occluders: Vec<Occluder>| {
        let triangles =
            |o: &Occluder| scene.mesh_of(&scene.prims[o.prim.index()]).triangles.len() as f32;
        let count: f32 = occluders.iter().map(triangles).sum();
        let sum: f32 = occluders.iter().map(|o| o.edge * triangles(o)).sum();
        let bounds = occluders.iter().fold(Bounds3::EMPTY, |all, o| {
            all.union(bounds_of(scene, forms, o))
        });
        Class {
            edge: sum / count,
            occluders,
            bounds,
        }
    };
    classes.into_iter().map(class).collect()
}

/// Bounds of the transformed box of a prim.
fn bounds_of(scene: &Scene, forms: &[Form], occluder: &Occluder) -> Bounds3 {
    let local = forms[scene.prims[occluder.prim.index()].mesh.index()].bounds;
    let half = (local.max - local.min).as_dvec3() * 0.5;
    let matrix = occluder.local_from_object.matrix3;
    let center = occluder
        .local_from_object
        .transform_point3(local.center().as_dvec3());
    let reach: DVec3 =
        matrix.x_axis.abs() * half.x + matrix.y_axis.abs() * half.y + matrix.z_axis.abs() * half.z;
    Bounds3 {
        min: (center - reach).as_vec3(),
        max: (center + reach).as_vec3(),
    }
}
