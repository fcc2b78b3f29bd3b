//! Geometry of the benchmarks: a diced box around a ball, all faces along the axes, and a ball with bumps.

use glam::{Affine3A, DVec3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};
use surflux::scene::{
    FaceMaterials, Input, Light, LightKind, Linked, Material, MaterialId, Mesh, MeshId, Normals,
    Prim, PrimSource, Purpose, Scene, StageInfo, UpAxis,
};

/// A box from −1 to 1 with `n × n` quads a side, seen from the inside.
pub(crate) fn diced_box(n: u32) -> Mesh {
    let mut mesh = Indexed::default();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            mesh.grid(n, n, |u, v| {
                let mut p = [0.0; 3];
                p[axis] = side;
                p[(axis + 1) % 3] = side * (1.0 - 2.0 * u);
                p[(axis + 2) % 3] = 2.0 * v - 1.0;
                Vec3::from(p)
            });
        }
    }
    mesh.finish()
}

/// A ball of radius 0.6 with waves of 5 % on it, `4 n²` triangles.
pub(crate) fn displaced_ball(n: u32) -> Mesh {
    let mut mesh = Indexed::default();
    mesh.grid(2 * n, n, |u, v| {
        let around = Vec2::from_angle(TAU * u);
        let (sine, cosine) = (PI * v).sin_cos();
        let unit = Vec3::new(sine * around.x, cosine, sine * around.y);
        let wave = (23.0 * unit.x).sin() * (19.0 * unit.y).sin() * (29.0 * unit.z).sin();
        unit * 0.6 * (1.0 + 0.05 * wave)
    });
    mesh.finish()
}

#[derive(Default)]
struct Indexed {
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Indexed {
    fn grid(&mut self, columns: u32, rows: u32, at: impl Fn(f32, f32) -> Vec3) {
        let first = u32::try_from(self.positions.len()).expect("a small mesh");
        for j in 0..=rows {
            for i in 0..=columns {
                let place = at(i as f32 / columns as f32, j as f32 / rows as f32);
                self.positions.push(place);
            }
        }
        for j in 0..rows {
            for i in 0..columns {
                let a = first + j * (columns + 1) + i;
                let (b, d) = (a + 1, a + columns + 1);
                self.triangles.extend([[a, b, d + 1], [a, d + 1, d]]);
            }
        }
    }

    fn finish(self) -> Mesh {
        let faces = u32::try_from(self.triangles.len()).expect("a small mesh");
        Mesh {
            positions: self.positions,
            triangles: self.triangles,
            triangle_faces: (0..faces).collect(),
            normals: Normals::Flat,
            primvars: Vec::new(),
            double_sided: true,
            closed: false,
            cage: None,
            scheme: "none".into(),
        }
    }
}

/// A gray scene of `meshes` with a square light of side 0.5 below the ceiling.
pub(crate) fn scene(meshes: Vec<Mesh>) -> Scene {
    let prims = (0..).zip(&meshes).map(|(i, _)| Prim {
        path: format!("/p{i}").into(),
        mesh: MeshId(i),
        world_from_object: Affine3A::IDENTITY,
        materials: FaceMaterials::Whole(Some(MaterialId(0))),
        purpose: Purpose::Default,
        source: PrimSource::Direct,
    });
    let down = Affine3A::from_rotation_x(-PI / 2.0);
    Scene {
        stage: StageInfo {
            path: "bench".into(),
            up_axis: UpAxis::Y,
            meters_per_unit: 1.0,
            default_prim: None,
            time_range: None,
            time_codes_per_second: 24.0,
            time: None,
            layers: Vec::new(),
            variants: Vec::new(),
            reader: "bench".into(),
        },
        origin: DVec3::ZERO,
        prims: prims.collect(),
        meshes,
        materials: vec![Material {
            diffuse_color: Input::color(0.5, 0.5, 0.5),
            ..Material::default()
        }],
        lights: vec![Light {
            path: "/light".into(),
            kind: LightKind::Rect {
                width: 0.5,
                height: 0.5,
                texture: None,
            },
            radiance: Vec3::ONE,
            normalize: false,
            world_from_light: Affine3A::from_translation(Vec3::new(0.0, 0.99, 0.0)) * down,
            shaping: None,
            casts_shadows: true,
            lit: Linked::All,
            blockers: Linked::All,
        }],
        cameras: Vec::new(),
        render_settings: Vec::new(),
    }
}

/// A point and its unit normal.
pub(crate) type Receiver = (Vec3, Vec3);

/// About `count` receivers at the centroids of `mesh`, neighbors next to each other.
pub(crate) fn receivers(mesh: &Mesh, count: usize) -> Vec<Receiver> {
    let step = (mesh.triangles.len() / count).max(1);
    (0..mesh.triangles.len())
        .step_by(step)
        .filter_map(|t| {
            let [a, b, c] = mesh.corners(t);
            let normal = (b - a).cross(c - a).try_normalize()?;
            let center = (a + b + c) / 3.0;
            Some((center + normal * 1e-5, normal))
        })
        .collect()
}
