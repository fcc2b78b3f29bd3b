//! Normals of the limit surface at the vertices of a refined level, one for every smooth sector around a vertex.
//!
//! Tangents are the eigenvectors of the subdivision rules: Halstead et al., *Efficient, Fair Interpolation using
//! Catmull-Clark Surfaces* (1993) for smooth Catmull-Clark vertices, Loop (1987) for smooth Loop vertices, Biermann
//! et al., *Piecewise Smooth Subdivision Surfaces with Normal Control* (2000) and Hoppe et al., *Piecewise Smooth
//! Surface Reconstruction* (1994) along creases and boundaries. Other vertices (pinned without sharp edges, between
//! turned faces) and vanishing tangents take the angle-weighted mean of the sector's faces at their limit.

use super::authored::Scheme;
use glam::{DVec3, Vec3};
use opensubdiv_rs::far::TopologyLevel;
use std::f64::consts::{PI, TAU};

/// One normal a sector, and the sector of every face-vertex.
#[derive(Debug, Clone, Default)]
pub(super) struct SectorNormals {
    /// Unit; zero where nothing spans a surface.
    pub(super) normals: Vec<Vec3>,
    /// For face-vertex `offset(face) + corner` of the level its index into `normals`.
    pub(super) sector_of_corner: Vec<u32>,
    /// Vertex of every sector.
    pub(super) vertex_of_sector: Vec<u32>,
}

/// A refined level and the values on it.
#[derive(Clone, Copy)]
pub(super) struct LevelData<'a> {
    pub(super) level: TopologyLevel<'a>,
    pub(super) scheme: Scheme,
    /// Control positions of the level: what the tangent rules weigh.
    pub(super) control: &'a [[f64; 3]],
    /// The same vertices on the limit surface.
    pub(super) limit: &'a [[f64; 3]],
    /// Number of vertices of every face: 4, or 3 for Loop.
    pub(super) face_size: usize,
    /// False for faces that are not drawn.
    pub(super) is_drawn: &'a [bool],
}

/// Faces around a vertex between two sharp edges, in order of rotation.
#[derive(Default)]
struct Sector {
    faces: Vec<usize>,
    /// The faces go all the way around (no sharp edge ends them).
    is_closed: bool,
}

impl SectorNormals {
    pub(super) fn of(data: &LevelData) -> Self {
        let corner_count = data.level.num_faces() * data.face_size;
        let mut result = Self {
            normals: Vec::with_capacity(data.level.num_vertices()),
            sector_of_corner: vec![u32::MAX; corner_count],
            vertex_of_sector: Vec::with_capacity(data.level.num_vertices()),
        };
        // One for all: an allocation a vertex costs more than its tangents.
        let mut sector = Sector::default();
        for vertex in 0..data.level.num_vertices() {
            let faces = data.level.vertex_faces(vertex);
            for &face in faces {
                let corner = data.corner_of(face as usize, vertex);
                let slot = face as usize * data.face_size + corner;
                if result.sector_of_corner[slot] != u32::MAX || !data.is_drawn[face as usize] {
                    continue;
                }
                data.find_sector(vertex, face as usize, &mut sector);
                result.add_sector(data, vertex, &sector);
            }
        }
        result
    }

    fn add_sector(&mut self, data: &LevelData, vertex: usize, sector: &Sector) {
        let index = u32::try_from(self.normals.len()).expect("fewer sectors than corners");
        for &face in &sector.faces {
            let corner = data.corner_of(face, vertex);
            self.sector_of_corner[face * data.face_size + corner] = index;
        }
        let normal = data.tangent_normal(vertex, sector);
        let normal = normal.unwrap_or_else(|| data.mean_normal(vertex, sector));
        self.normals.push(normal.as_vec3());
        self.vertex_of_sector
            .push(u32::try_from(vertex).expect("opensubdiv-rs numbers vertices in u32"));
    }
}

impl LevelData<'_> {
    fn corner_of(&self, face: usize, vertex: usize) -> usize {
        let points = self.level.face_vertices(face).iter();
        let mut points = points.map(|&point| point as usize);
        points
            .position(|point| point == vertex)
            .expect("faces of a vertex contain it")
    }

    /// Edge of `face` that leaves `vertex` (next in the face's order), and the one that arrives.
    fn edges_at(&self, face: usize, vertex: usize) -> (usize, usize) {
        let corner = self.corner_of(face, vertex);
        let edges = self.level.face_edges(face);
        let arriving = (corner + self.face_size - 1) % self.face_size;
        (edges[corner] as usize, edges[arriving] as usize)
    }

    /// The face on the other side of `edge`, unless the surface is split there. Holes count: they support the surface.
    /// Faces that run along the edge in the same direction as `face` do not follow on it.
    fn across(&self, edge: usize, face: usize, vertex: usize) -> Option<usize> {
        if self.level.edge_sharpness(edge) > 0.0 {
            return None;
        }
        let &[a, b] = self.level.edge_faces(edge) else {
            return None;
        };
        let other = if a as usize == face { b } else { a } as usize;
        let (leaving, arriving) = self.edges_at(face, vertex);
        let (other_leaving, other_arriving) = self.edges_at(other, vertex);
        let follows = (edge == leaving && edge == other_arriving)
            || (edge == arriving && edge == other_leaving);
        follows.then_some(other)
    }

    /// Make `sector` the one of `vertex` that contains face `seed`, counter-clockwise.
    fn find_sector(&self, vertex: usize, seed: usize, sector: &mut Sector) {
        let mut first = seed;
        // Backwards (clockwise) over leaving edges to the sector's start, or once around.
        while let Some(previous) = self.across(self.edges_at(first, vertex).0, first, vertex) {
            first = previous;
            if first == seed {
                break;
            }
        }
        sector.faces.clear();
        sector.faces.push(first);
        sector.is_closed = false;
        let mut last = first;
        while let Some(next) = self.across(self.edges_at(last, vertex).1, last, vertex) {
            if next == first {
                sector.is_closed = true;
                return;
            }
            sector.faces.push(next);
            last = next;
        }
    }

    fn position(&self, vertex: usize) -> DVec3 {
        DVec3::from_array(self.control[vertex])
    }

    fn opposite(&self, edge: usize, vertex: usize) -> DVec3 {
        let [a, b] = self.level.edge_vertices(edge).map(|v| v as usize);
        self.position(if a == vertex { b } else { a })
    }

    /// Vertex of a quad across from `vertex`.
    fn diagonal(&self, face: usize, vertex: usize) -> DVec3 {
        let corner = self.corner_of(face, vertex);
        self.position(self.level.face_vertices(face)[(corner + 2) % self.face_size] as usize)
    }

    /// Normal from the tangent rules; `None` where they do not hold or vanish.
    fn tangent_normal(&self, vertex: usize, sector: &Sector) -> Option<DVec3> {
        let edges = self.level.vertex_edges(vertex).iter();
        let sharp = edges
            .filter(|&&edge| self.level.edge_sharpness(edge as usize) > 0.0)
            .count();
        let is_corner = sharp > 2 || self.level.vertex_sharpness(vertex) > 0.0;
        let all_faces = self.level.vertex_faces(vertex).len();
        let (across, along) = match (sector.is_closed, sharp, self.scheme) {
            (true, ..) if is_corner => return None,
            (false, ..) if is_corner => self.corner(vertex, sector),
            (true, 0, Scheme::CatmullClark) => self.smooth_quads(vertex, sector),
            (true, 0, Scheme::Loop) => self.smooth_triangles(vertex, sector),
            // A dart: one sharp edge, around which the rule is smooth.
            (false, 1, Scheme::CatmullClark) if sector.faces.len() == all_faces => {
                self.smooth_quads(vertex, sector)
            }
            (false, 1, Scheme::Loop) if sector.faces.len() == all_faces => {
                self.smooth_triangles(vertex, sector)
            }
            (false, 2, Scheme::CatmullClark) => self.crease_quads(vertex, sector),
            (false, 2, Scheme::Loop) => self.crease_triangles(vertex, sector),
            _ => return None,
        };
        let normal = across.cross(along).try_normalize()?;
        // The rules fix the plane; which side is front is what the faces say.
        let front = self.front(vertex, sector);
        Some(if normal.dot(front) < 0.0 {
            -normal
        } else {
            normal
        })
    }

    /// A pinned vertex: the sharp edges that bound the sector leave it straight at every level.
    fn corner(&self, vertex: usize, sector: &Sector) -> (DVec3, DVec3) {
        let spokes = self.spokes(vertex, sector);
        let center = self.position(vertex);
        (spokes[0] - center, spokes[spokes.len() - 1] - center)
    }

    fn smooth_quads(&self, vertex: usize, sector: &Sector) -> (DVec3, DVec3) {
        let count = sector.faces.len();
        let step = TAU / as_f64(count);
        let half = (PI / as_f64(count)).cos();
        let edge_weight = 1.0 + step.cos() + half * (2.0 * (9.0 + step.cos())).sqrt();
        let mut tangents = (DVec3::ZERO, DVec3::ZERO);
        for (i, &face) in sector.faces.iter().enumerate() {
            let edge = self.opposite(self.edges_at(face, vertex).0, vertex);
            let diagonal = self.diagonal(face, vertex);
            let (s0, c0) = (step * as_f64(i)).sin_cos();
            let (s1, c1) = (step * as_f64(i + 1)).sin_cos();
            tangents.0 += edge_weight * c0 * edge + (c0 + c1) * diagonal;
            tangents.1 += edge_weight * s0 * edge + (s0 + s1) * diagonal;
        }
        tangents
    }

    fn smooth_triangles(&self, vertex: usize, sector: &Sector) -> (DVec3, DVec3) {
        let step = TAU / as_f64(sector.faces.len());
        let mut tangents = (DVec3::ZERO, DVec3::ZERO);
        for (i, &face) in sector.faces.iter().enumerate() {
            let edge = self.opposite(self.edges_at(face, vertex).0, vertex);
            let (s, c) = (step * as_f64(i)).sin_cos();
            tangents.0 += c * edge;
            tangents.1 += s * edge;
        }
        tangents
    }

    /// Ends of the sector's edges: leaving of the first face, then arriving of every face.
    fn spokes(&self, vertex: usize, sector: &Sector) -> Vec<DVec3> {
        let first = self.edges_at(sector.faces[0], vertex).0;
        let arriving = sector.faces.iter();
        let arriving = arriving.map(|&face| self.edges_at(face, vertex).1);
        std::iter::once(first)
            .chain(arriving)
            .map(|edge| self.opposite(edge, vertex))
            .collect()
    }

    fn crease_quads(&self, vertex: usize, sector: &Sector) -> (DVec3, DVec3) {
        let spokes = self.spokes(vertex, sector);
        let [first, .., last] = spokes.as_slice() else {
            return (DVec3::ZERO, DVec3::ZERO);
        };
        if sector.faces.len() == 1 {
            // The rule below vanishes: in one face both tangents but the crease's shrink by a quarter a level.
            return (*first + *last - 2.0 * self.position(vertex), *last - *first);
        }
        let step = PI / as_f64(sector.faces.len());
        let (sine, cosine) = step.sin_cos();
        let ratio = (cosine + 1.0) / sine;
        let mut across = 4.0 * ratio * (cosine - 1.0) * self.position(vertex)
            - ratio * (1.0 + 2.0 * cosine) * (*first + *last)
            + sine * self.diagonal(sector.faces[0], vertex);
        let inner = sector.faces.iter().zip(&spokes).enumerate().skip(1);
        for (i, (&face, spoke)) in inner {
            let (here, next) = ((step * as_f64(i)).sin(), (step * as_f64(i + 1)).sin());
            across += 4.0 * here * *spoke + (here + next) * self.diagonal(face, vertex);
        }
        (across, *last - *first)
    }

    fn crease_triangles(&self, vertex: usize, sector: &Sector) -> (DVec3, DVec3) {
        let spokes = self.spokes(vertex, sector);
        let [first, .., last] = spokes.as_slice() else {
            return (DVec3::ZERO, DVec3::ZERO);
        };
        let along = *last - *first;
        let center = self.position(vertex);
        let across = match sector.faces.len() {
            1 => *first + *last - 2.0 * center,
            2 => spokes[1] - center,
            3 => 2.0 * (spokes[1] + spokes[2] - center) - *first - *last,
            count => {
                let step = PI / as_f64(count);
                let ends = step.sin() * (*first + *last);
                let inner = (1..count).map(|i| (step * as_f64(i)).sin() * spokes[i]);
                ends + (2.0 * step.cos() - 2.0) * inner.sum::<DVec3>()
            }
        };
        (across, along)
    }

    /// From the limit of `vertex` to those of the next and the previous vertex of `face`.
    fn sides(&self, vertex: usize, face: usize) -> (DVec3, DVec3) {
        let at = |i: u32| DVec3::from_array(self.limit[i as usize]);
        let points = self.level.face_vertices(face);
        let corner = self.corner_of(face, vertex);
        let center = at(points[corner]);
        let next = at(points[(corner + 1) % self.face_size]) - center;
        let previous = at(points[(corner + self.face_size - 1) % self.face_size]) - center;
        (next, previous)
    }

    /// Any vector on the front side of the sector's faces as a whole.
    fn front(&self, vertex: usize, sector: &Sector) -> DVec3 {
        let faces = sector.faces.iter().map(|&face| {
            let (next, previous) = self.sides(vertex, face);
            next.cross(previous)
        });
        faces.sum()
    }

    /// Angle-weighted mean of the sector's face normals at the limit positions.
    fn mean_normal(&self, vertex: usize, sector: &Sector) -> DVec3 {
        let faces = sector.faces.iter().map(|&face| {
            let (next, previous) = self.sides(vertex, face);
            let normal = next.cross(previous);
            normal.normalize_or_zero() * normal.length().atan2(next.dot(previous))
        });
        faces.sum::<DVec3>().normalize_or_zero()
    }
}

#[expect(clippy::cast_precision_loss, reason = "valences are far below 2^52")]
fn as_f64(count: usize) -> f64 {
    count as f64
}
