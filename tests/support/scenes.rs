//! Scenes made by code, and closed forms to judge them by.

use glam::{Affine3A, DVec3, Vec3};
use surflux::math::Bounds3;
use surflux::receivers::Receivers;
use surflux::results::Target;
use surflux::scene::{
    Cage, FaceMaterials, Input, Light, LightKind, Linked, Material, MaterialId, Mesh, MeshId,
    Normals, Prim, PrimId, PrimSource, Purpose, Scene, StageInfo, UpAxis,
};
use surflux::shading::SurfacePoint;

/// A scene in the making.
#[derive(Debug)]
pub(crate) struct SceneBuilder {
    scene: Scene,
}

impl SceneBuilder {
    /// Nothing yet; Y up, metres.
    pub(crate) fn new() -> Self {
        Self {
            scene: Scene {
                stage: StageInfo {
                    path: "made-by-code.usda".into(),
                    up_axis: UpAxis::Y,
                    meters_per_unit: 1.0,
                    default_prim: Some("World".to_owned()),
                    time_range: None,
                    time_codes_per_second: 24.0,
                    time: None,
                    layers: Vec::new(),
                    variants: Vec::new(),
                    reader: "native".to_owned(),
                },
                origin: DVec3::ZERO,
                meshes: Vec::new(),
                prims: Vec::new(),
                materials: Vec::new(),
                lights: Vec::new(),
                cameras: Vec::new(),
                render_settings: Vec::new(),
            },
        }
    }

    /// A Lambertian material.
    pub(crate) fn material(&mut self, albedo: Vec3, emission: Vec3) -> MaterialId {
        let id = u32::try_from(self.scene.materials.len()).expect("few materials");
        self.scene.materials.push(Material {
            path: format!("/World/Looks/m{id}"),
            diffuse_color: Input::color(albedo.x, albedo.y, albedo.z),
            emissive_color: Input::color(emission.x, emission.y, emission.z),
            specular_workflow: true,
            ..Material::default()
        });
        MaterialId(id)
    }

    /// A mesh prim at `/World/NAME`, in world space.
    pub(crate) fn mesh(&mut self, name: &str, mesh: Mesh, material: MaterialId) -> PrimId {
        let id = u32::try_from(self.scene.prims.len()).expect("few prims");
        self.scene.meshes.push(mesh);
        self.scene.prims.push(Prim {
            path: format!("/World/{name}").into(),
            mesh: MeshId(id),
            world_from_object: Affine3A::IDENTITY,
            materials: FaceMaterials::Whole(Some(material)),
            purpose: Purpose::Default,
            source: PrimSource::Direct,
        });
        PrimId(id)
    }

    /// A dome light of the same radiance everywhere.
    pub(crate) fn sky(&mut self, radiance: Vec3) {
        self.scene.lights.push(Light {
            path: "/World/sky".to_owned(),
            kind: LightKind::Dome { texture: None },
            radiance,
            normalize: false,
            world_from_light: Affine3A::IDENTITY,
            shaping: None,
            casts_shadows: true,
            lit: Linked::All,
            blockers: Linked::All,
        });
    }

    /// The scene.
    pub(crate) fn build(self) -> Scene {
        self.scene
    }
}

/// A double-sided triangle mesh with the given smooth (or, if empty, flat) normals.
pub(crate) fn triangle_mesh(
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    normals: Vec<Vec3>,
    closed: bool,
) -> Mesh {
    let normal_of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| positions[i as usize]);
        (b - a).cross(c - a)
    };
    let mut point_normals = vec![Vec3::ZERO; positions.len()];
    for t in &triangles {
        t.iter()
            .for_each(|&i| point_normals[i as usize] += normal_of(t));
    }
    if !normals.is_empty() {
        point_normals.clone_from(&normals);
    }
    Mesh {
        triangle_faces: (0..).take(triangles.len()).collect(),
        normals: if normals.is_empty() {
            Normals::Flat
        } else {
            Normals::Vertex(normals)
        },
        primvars: Vec::new(),
        double_sided: true,
        closed,
        cage: Some(Cage {
            point_count: positions.len(),
            face_vertex_counts: vec![3; triangles.len()],
            face_vertex_indices: triangles.iter().flatten().copied().collect(),
            point_normals: point_normals
                .into_iter()
                .map(Vec3::normalize_or_zero)
                .collect(),
            corner_normals: Vec::new(),
            on_boundary: vec![false; positions.len()],
        }),
        scheme: "none".to_owned(),
        positions,
        triangles,
    }
}

/// A flat parallelogram of `cells`² quads from `corner` along `u` and `v`; its front looks along u × v.
pub(crate) fn plate(corner: Vec3, u: Vec3, v: Vec3, cells: u16) -> Mesh {
    let (positions, triangles) = grid(corner, u, v, cells);
    triangle_mesh(positions, triangles, Vec::new(), false)
}

fn grid(corner: Vec3, u: Vec3, v: Vec3, cells: u16) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let at = |i: u16, cells: u16| f32::from(i) / f32::from(cells);
    let positions = (0..=cells)
        .flat_map(|j| (0..=cells).map(move |i| corner + u * at(i, cells) + v * at(j, cells)))
        .collect();
    let row = u32::from(cells) + 1;
    let triangles = (0..u32::from(cells))
        .flat_map(|j| (0..u32::from(cells)).map(move |i| j * row + i))
        .flat_map(|q| [[q, q + 1, q + row + 1], [q, q + row + 1, q + row]])
        .collect();
    (positions, triangles)
}

/// The six sides of a box, each of `cells`² quads, with their fronts inside; edges are not welded.
pub(crate) fn room(bounds: Bounds3, cells: u16) -> Mesh {
    let size = bounds.max - bounds.min;
    let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
    let sides = [
        (bounds.min, y, z),
        (bounds.max, -z, -y),
        (bounds.min, z, x),
        (bounds.max, -x, -z),
        (bounds.min, x, y),
        (bounds.max, -y, -x),
    ];
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for (corner, u, v) in sides {
        let first = u32::try_from(positions.len()).expect("small mesh");
        let (more, faces) = grid(corner, u, v, cells);
        positions.extend(more);
        triangles.extend(faces.into_iter().map(|t| t.map(|i| i + first)));
    }
    triangle_mesh(positions, triangles, Vec::new(), true)
}

/// The part of a sphere about `center` from the pole −Y up to `polar` radians from it, with smooth normals, `rings`
/// high; its front is outside, or inside if `inward`. `polar` = π closes it.
pub(crate) fn bowl(center: Vec3, radius: f32, polar: f32, rings: u16, side: Side) -> Mesh {
    let columns = 2 * rings;
    let closed = polar >= std::f32::consts::PI;
    let mut directions = Vec::new();
    for ring in 0..=rings {
        let (sin, cos) = (polar * f32::from(ring) / f32::from(rings)).sin_cos();
        for column in 0..columns {
            let (s, c) = (std::f32::consts::TAU * f32::from(column) / f32::from(columns)).sin_cos();
            directions.push(Vec3::new(sin * c, -cos, sin * s));
        }
    }
    let (rings, columns) = (u32::from(rings), u32::from(columns));
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for column in 0..columns {
            let next = (column + 1) % columns;
            let (a, b) = (ring * columns + column, ring * columns + next);
            let (c, d) = (a + columns, b + columns);
            if ring > 0 {
                triangles.push([a, c, b]);
            }
            if !(closed && ring + 1 == rings) {
                triangles.push([b, c, d]);
            }
        }
    }
    // The rows at the poles are one point each: weld them onto their first column.
    for i in triangles.iter_mut().flatten() {
        let ring = *i / columns;
        if ring == 0 || (closed && ring == rings) {
            *i = ring * columns;
        }
    }
    triangles.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
    if side == Side::Inside {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    let sign = if side == Side::Inside { -1.0 } else { 1.0 };
    triangle_mesh(
        directions.iter().map(|d| center + *d * radius).collect(),
        triangles,
        directions.iter().map(|d| *d * sign).collect(),
        closed,
    )
}

/// From −1 to 1.
pub(crate) const BOX: Bounds3 = Bounds3 {
    min: Vec3::splat(-1.0),
    max: Vec3::splat(1.0),
};

/// A closed box, its walls of so many cells across, with a ball on its floor; prim 0 and 1.
pub(crate) fn ball_in_a_box(cells: u16) -> Scene {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    builder.mesh("walls", room(BOX, cells), gray);
    let center = Vec3::new(0.2, -0.6, 0.1);
    builder.mesh(
        "ball",
        bowl(center, 0.4, std::f32::consts::PI, 24, Side::Outside),
        gray,
    );
    builder.build()
}

/// Which side of a round surface is its front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    /// Away from the center.
    Outside,
    /// Towards the center.
    Inside,
}

/// Receivers on the front of prims, at barycentric `(u, v)` of triangles.
pub(crate) fn receivers_at(scene: &Scene, points: &[(PrimId, u32, f32, f32)]) -> Receivers {
    let mut receivers = Receivers {
        origin: scene.origin,
        position: Vec::new(),
        normal: Vec::new(),
        geometric_normal: Vec::new(),
        prim: Vec::new(),
        surface: Vec::new(),
        depth: Vec::new(),
        toward_eye: Vec::new(),
        target: Target::Surfels,
    };
    for &(prim, triangle, u, v) in points {
        let mesh = scene.mesh_of(&scene.prims[prim.index()]);
        let [a, b, c] = mesh.corners(triangle as usize);
        receivers.position.push(a * (1.0 - u - v) + b * u + c * v);
        receivers
            .normal
            .push(mesh.shading_normal(triangle as usize, u, v));
        receivers
            .geometric_normal
            .push(mesh.plane_normal(triangle as usize));
        receivers.prim.push(prim.0);
        receivers.surface.push(SurfacePoint {
            prim,
            triangle,
            u,
            v,
            footprint: 0.0,
        });
    }
    receivers
}

/// One receiver in the middle of every `step`-th triangle of a prim.
pub(crate) fn receivers_in(scene: &Scene, prim: PrimId, step: usize) -> Receivers {
    let count = scene.mesh_of(&scene.prims[prim.index()]).triangles.len();
    let points: Vec<_> = (0..)
        .take(count)
        .step_by(step)
        .map(|triangle| (prim, triangle, 0.3, 0.3))
        .collect();
    receivers_at(scene, &points)
}

/// Irradiance, as a multiple of the radiance, at a point from a polygon wholly above its horizon. Lambert 1760: half
/// the sum over the edges of the angle each subtends times the cosine of its plane's tilt.
pub(crate) fn polygon_irradiance(position: Vec3, normal: Vec3, corners: &[Vec3]) -> f64 {
    let to = |k: usize| {
        (corners[k % corners.len()] - position)
            .as_dvec3()
            .normalize()
    };
    let sum: f64 = (0..corners.len())
        .map(|k| {
            let (a, b) = (to(k), to(k + 1));
            let across = a.cross(b);
            let angle = across.length().atan2(a.dot(b));
            angle * across.normalize_or_zero().dot(normal.as_dvec3())
        })
        .sum();
    0.5 * sum.abs()
}

/// A floor of 2 × 2 in as many rows, and one above its middle a roof of half its width with these corners, under a sky of radiance 1.
pub(crate) fn floor_under_a_roof(rows: u16) -> (Scene, PrimId, [Vec3; 4]) {
    let mut builder = SceneBuilder::new();
    let gray = builder.material(Vec3::splat(0.5), Vec3::ZERO);
    let corner = Vec3::new(-1.0, 0.0, -1.0);
    let (u, v) = (2.0 * Vec3::Z, 2.0 * Vec3::X);
    let floor = builder.mesh("floor", plate(corner, u, v, rows), gray);
    let (roof, u, v) = (0.5 * corner + Vec3::Y, 0.5 * u, 0.5 * v);
    builder.mesh("roof", plate(roof, u, v, 1), gray);
    builder.sky(Vec3::ONE);
    (
        builder.build(),
        floor,
        [roof, roof + u, roof + u + v, roof + v],
    )
}
