//! Dense meshes: displaced balls made by code, scans read from OBJ files; every vertex a receiver.

use crate::scenes::{SceneBuilder, plate, triangle_mesh};
use glam::Vec3;
use std::path::PathBuf;
use surflux::diagnostics::Diagnostics;
use surflux::receivers::{Receivers, primvar};
use surflux::results::BakeInterpolation;
use surflux::scene::{Mesh, PrimId, Scene};

/// A ball of about `6 · cells²` quads (a cube's grid blown up), displaced by bumps of several sizes, radius about 1.
pub(crate) fn bumpy_ball(cells: u16, center: Vec3) -> Mesh {
    let (positions, triangles) = cube_sphere(cells);
    let positions = positions
        .into_iter()
        .map(|p| center + p * (1.0 + bumps(p)))
        .collect();
    triangle_mesh(positions, triangles, Vec::new(), true).smooth()
}

/// Height over the unit sphere.
fn bumps(p: Vec3) -> f32 {
    let wave = |k: f32, a: f32| {
        a * ((k * p.x + 1.3).sin() * (k * p.y + 0.4).cos()
            + (k * p.z * 1.1 + 2.0).sin() * (k * p.x * 0.9).cos())
    };
    wave(3.0, 0.12) + wave(8.0, 0.05) + wave(21.0, 0.015)
}

fn cube_sphere(cells: u16) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let n = u32::from(cells);
    let at = |i: u32| 2.0 * i as f32 / n as f32 - 1.0;
    let mut index = std::collections::HashMap::new();
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for face in 0..6_usize {
        let (axis, sign) = (face % 3, if face < 3 { 1.0 } else { -1.0 });
        let mut id = |i: u32, j: u32| {
            let mut p = Vec3::ZERO;
            p[axis] = sign;
            p[(axis + 1) % 3] = at(i);
            p[(axis + 2) % 3] = at(j);
            let key = p.to_array().map(f32::to_bits);
            *index
                .entry(key.map(|b| if b == 1 << 31 { 0 } else { b }))
                .or_insert_with(|| {
                    let even = p.map(|x| (x * std::f32::consts::FRAC_PI_4).tan());
                    positions.push(even.normalize());
                    u32::try_from(positions.len() - 1).expect("a few million")
                })
        };
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let (a, b, c, d) = (id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1));
            if sign > 0.0 {
                triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                triangles.extend([[a, c, b], [a, d, c]]);
            }
        }
    }
    (positions, triangles)
}

/// Shading normals for a mesh.
pub(crate) trait Smooth {
    /// With smooth normals.
    fn smooth(self) -> Self;
}

impl Smooth for Mesh {
    /// With the cage's point normals as shading normals.
    fn smooth(mut self) -> Self {
        let cage = self.cage.as_ref().expect("made with a cage");
        self.normals = surflux::scene::Normals::Vertex(cage.point_normals.clone());
        self
    }
}

/// `mesh` on a square ground of `cells`² quads just below it.
pub(crate) fn on_ground(mesh: Mesh, cells: u16) -> Scene {
    let bounds = mesh.bounds();
    let size = bounds.diagonal();
    let corner = Vec3::new(
        bounds.center().x - size,
        bounds.min.y - 0.002 * size,
        bounds.center().z + size,
    );
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    builder.mesh(
        "ground",
        plate(
            corner,
            Vec3::X * 2.0 * size,
            Vec3::NEG_Z * 2.0 * size,
            cells,
        ),
        gray,
    );
    builder.mesh("object", mesh, gray);
    builder.build()
}

/// The triangles of `meshes/NAME.obj` of the shared assets; `None` (said aloud) without them.
#[expect(clippy::print_stderr, reason = "a skipped test says so")]
pub(crate) fn shared_mesh(name: &str) -> Option<Mesh> {
    let folder = std::env::var("SURFLUX_SHARED").map_or_else(
        |_| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")),
        PathBuf::from,
    );
    let Ok(text) = std::fs::read_to_string(folder.join(format!("assets/meshes/{name}.obj"))) else {
        eprintln!("skipped: no shared asset {name}");
        return None;
    };
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let p: Vec<f32> = words.map(|w| w.parse().expect("number")).collect();
                positions.push(Vec3::new(p[0], p[1], p[2]));
            }
            Some("f") => {
                let corner = |w: &str| {
                    w.split('/')
                        .next()
                        .and_then(|i| i.parse::<u32>().ok())
                        .expect("index")
                        - 1
                };
                let face: Vec<u32> = words.map(corner).collect();
                triangles.extend((2..face.len()).map(|k| [face[0], face[k - 1], face[k]]));
            }
            _ => {}
        }
    }
    let closed = is_closed(&triangles);
    Some(triangle_mesh(positions, triangles, Vec::new(), closed).smooth())
}

/// Every directed edge has its opposite.
fn is_closed(triangles: &[[u32; 3]]) -> bool {
    let edges: std::collections::HashSet<_> = triangles
        .iter()
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
        .collect();
    edges.len() == 3 * triangles.len() && edges.iter().all(|&(a, b)| edges.contains(&(b, a)))
}

/// All vertices of all prims.
pub(crate) fn vertices(scene: &Scene) -> Receivers {
    let prims: Vec<PrimId> = (0..).take(scene.prims.len()).map(PrimId).collect();
    primvar::place(scene, &prims, BakeInterpolation::Vertex)
}

/// No progress, no cancelling.
pub(crate) fn quiet() -> Diagnostics {
    Diagnostics::default()
}
