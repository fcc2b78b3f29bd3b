//! A cut mesh moved along its normals.

use super::cut::{Cut, Piece, length};
use crate::scene::{Cage, Interpolation, Mesh, Normals, PrimId, Primvar};
use crate::shading::{Heights, SurfacePoint};
use glam::{DMat3, DVec3, Vec2, Vec3};
use rayon::prelude::*;
use std::collections::HashMap;

/// Corners at one position whose normals differ by less (1 − cosine; 2.6°) lie on one smooth surface.
const SMOOTH: f32 = 1e-3;

/// Where the mean of the normals at a place is shorter, surfaces lie back to back there: each moves by itself.
const FACING: f64 = 0.1;

/// What makes a displaced mesh of a cut one.
pub(super) struct Relief<'a> {
    prim: PrimId,
    mesh: &'a Mesh,
    cut: Cut,
    /// For every position the first that lies in the same place: meshes may have points of their own for each face.
    firsts: Vec<u32>,
    /// Positions after the move.
    moved: Vec<Vec3>,
    /// Shading normals at the corners of pieces before it, unit or zero.
    normals: Vec<[Vec3; 3]>,
    heights: &'a Heights<'a>,
    metric: &'a DMat3,
}

impl<'a> Relief<'a> {
    /// Move the positions of `cut`, of the `mesh` of `prim`, whose vectors are as long in the world as `metric` says.
    pub(super) fn new(
        heights: &'a Heights<'a>,
        (prim, mesh): (PrimId, &'a Mesh),
        metric: &'a DMat3,
        cut: Cut,
    ) -> Self {
        let normals = cut.pieces.par_iter().map(|piece| {
            piece
                .at
                .map(|at| mesh.shading_normal(piece.base as usize, at.x, at.y))
        });
        let mut relief = Self {
            prim,
            mesh,
            normals: normals.collect(),
            firsts: firsts(&cut.positions, mesh.closed),
            moved: Vec::new(),
            cut,
            heights,
            metric,
        };
        relief.moved = relief.moves();
        relief
    }

    /// Positions moved by the mean height of the corners there along the mean normal, both weighted by the angles.
    fn moves(&self) -> Vec<Vec3> {
        let heights = self.corner_heights();
        let mut own = vec![Sum::default(); self.cut.positions.len()];
        for ((piece, normals), heights) in self.cut.pieces.iter().zip(&self.normals).zip(&heights) {
            let angles = self.angles(piece);
            for k in 0..3 {
                let corner = Sum {
                    normal: angles[k] * normals[k].as_dvec3(),
                    height: angles[k] * f64::from(heights[k]),
                    weight: angles[k],
                };
                own[piece.corners[k] as usize].add(&corner);
            }
        }
        let mut shared = vec![Sum::default(); own.len()];
        for (first, sum) in self.firsts.iter().zip(&own) {
            shared[*first as usize].add(sum);
        }
        let to_object = self.metric.inverse();
        let moved = (0..own.len()).map(|i| {
            let position = self.cut.positions[i];
            let shared = &shared[self.firsts[i] as usize];
            let sum = match shared.normal.length() >= FACING * shared.weight {
                true => shared,
                false => &own[i],
            };
            // M⁻¹ of the unit world normal, which is M⁻ᵀ n over its length.
            let along = to_object * sum.normal;
            let unit = along / sum.normal.dot(along).sqrt();
            let by = unit * (sum.height / sum.weight);
            let to = (position.as_dvec3() + by).as_vec3();
            if to.is_finite() { to } else { position }
        });
        moved.collect()
    }

    /// Heights at the corners of all pieces, each position of a base looked at once.
    fn corner_heights(&self) -> Vec<[f32; 3]> {
        let of_base = |pieces: &[Piece]| {
            let face = self.mesh.triangle_faces[pieces[0].base as usize];
            let material = self.heights.material_of(self.prim, face);
            let Some(material) = material.filter(|&id| self.heights.displaces(id)) else {
                return vec![[0.0; 3]; pieces.len()];
            };
            let mut known: HashMap<u32, f32> = HashMap::new();
            let mut height = |piece: &Piece, k: usize| {
                let place = || {
                    let point = self.surface(piece, piece.at[k]);
                    self.heights.at(material, &point)
                };
                *known.entry(piece.corners[k]).or_insert_with(place)
            };
            let of_piece = |piece: &Piece| [0, 1, 2].map(|k| height(piece, k));
            pieces.iter().map(of_piece).collect()
        };
        let bases = self.cut.pieces.par_chunk_by(|a, b| a.base == b.base);
        bases.flat_map_iter(of_base).collect()
    }

    /// A corner of `piece`, which stands for as much as its edges are long.
    fn surface(&self, piece: &Piece, at: Vec2) -> SurfacePoint {
        let [a, b, c] = piece.corners.map(|i| self.cut.positions[i as usize]);
        let edges = [b - a, c - b, a - c].map(|edge| length(self.metric, edge));
        #[expect(clippy::cast_possible_truncation, reason = "lengths are single")]
        let footprint = (edges.iter().sum::<f64>() / 3.0) as f32;
        SurfacePoint {
            prim: self.prim,
            triangle: piece.base,
            u: at.x,
            v: at.y,
            footprint,
        }
    }

    /// World angles of `piece` at its corners; zero where it has none.
    fn angles(&self, piece: &Piece) -> [f64; 3] {
        let at = piece.corners.map(|i| self.cut.positions[i as usize]);
        [0, 1, 2].map(|k| {
            let [one, other] = [1, 2].map(|step| at[(k + step) % 3] - at[k]);
            let across = one.as_dvec3().dot(*self.metric * other.as_dvec3());
            let cosine = across / (length(self.metric, one) * length(self.metric, other));
            if cosine.is_nan() {
                0.0
            } else {
                cosine.clamp(-1.0, 1.0).acos()
            }
        })
    }

    /// The mesh.
    pub(super) fn mesh(self) -> Mesh {
        let corners = self.turned_normals();
        let cage = self
            .mesh
            .cage
            .as_ref()
            .map(|cage| self.cage(cage, &corners));
        let pieces = &self.cut.pieces;
        let faces = pieces
            .iter()
            .map(|piece| self.mesh.triangle_faces[piece.base as usize]);
        Mesh {
            triangles: pieces.iter().map(|piece| piece.corners).collect(),
            triangle_faces: faces.collect(),
            normals: self.shared(corners),
            primvars: self
                .mesh
                .primvars
                .iter()
                .map(|primvar| self.primvar(primvar))
                .collect(),
            double_sided: self.mesh.double_sided,
            closed: self.mesh.closed,
            cage,
            scheme: self.mesh.scheme.clone(),
            positions: self.moved,
        }
    }

    /// Shading normals after the move, unit: those of before, turned as the smooth surface around them has turned.
    fn turned_normals(&self) -> Vec<[Vec3; 3]> {
        let area = |positions: &[Vec3], piece: &Piece| {
            let [a, b, c] = piece.corners.map(|i| positions[i as usize].as_dvec3());
            (b - a).cross(c - a)
        };
        let areas: Vec<[DVec3; 2]> = (self.cut.pieces.par_iter())
            .map(|piece| [area(&self.cut.positions, piece), area(&self.moved, piece)])
            .collect();
        let around = self.around();
        let mut turned = self.normals.clone();
        for corners in around.chunk_by(|a, b| self.place(*a) == self.place(*b)) {
            for &corner in corners {
                let normal = self.normals[corner.0][corner.1];
                let smooth = corners
                    .iter()
                    .filter(|other| 1.0 - self.normals[other.0][other.1].dot(normal) < SMOOTH);
                let mut sums = [DVec3::ZERO; 2];
                for other in smooth {
                    sums[0] += areas[other.0][0];
                    sums[1] += areas[other.0][1];
                }
                let [before, after] = sums.map(DVec3::normalize_or_zero);
                let by = (after - before).as_vec3();
                turned[corner.0][corner.1] = (normal + by).try_normalize().unwrap_or(normal);
            }
        }
        turned
    }

    /// All corners (piece, corner), those in one place one after the other.
    fn around(&self) -> Vec<(usize, usize)> {
        let corners = || (0..self.cut.pieces.len()).flat_map(|piece| [0, 1, 2].map(|k| (piece, k)));
        let mut places = vec![0; self.moved.len() + 1];
        for corner in corners() {
            places[self.place(corner) as usize + 1] += 1;
        }
        for i in 1..places.len() {
            places[i] += places[i - 1];
        }
        let mut sorted = vec![(0, 0); 3 * self.cut.pieces.len()];
        for corner in corners() {
            let place = &mut places[self.place(corner) as usize];
            sorted[*place] = corner;
            *place += 1;
        }
        sorted
    }

    fn place(&self, (piece, k): (usize, usize)) -> u32 {
        self.firsts[self.cut.pieces[piece].corners[k] as usize]
    }

    /// Normals at corners as the mesh keeps them: one a position where no two differ there.
    fn shared(&self, corners: Vec<[Vec3; 3]>) -> Normals {
        let mut at_positions = vec![Vec3::ZERO; self.moved.len()];
        let mut are_split = false;
        for (piece, normals) in self.cut.pieces.iter().zip(&corners) {
            for (&position, &normal) in piece.corners.iter().zip(normals) {
                let known = &mut at_positions[position as usize];
                are_split |= *known != Vec3::ZERO && 1.0 - known.dot(normal) > SMOOTH;
                *known = normal;
            }
        }
        if !are_split {
            return Normals::Vertex(at_positions);
        }
        let numbers = (0_u32..).step_by(3).take(corners.len());
        Normals::Corner {
            corners: numbers.map(|first| [first, first + 1, first + 2]).collect(),
            values: corners.into_flattened(),
        }
    }

    /// The same primvar on the pieces.
    fn primvar(&self, primvar: &Primvar) -> Primvar {
        let mut made = primvar.clone();
        match &primvar.interpolation {
            Interpolation::Constant | Interpolation::Uniform => {}
            Interpolation::Vertex => {
                for &[a, b] in &self.cut.ends {
                    let middle = 0.5 * (made.values[a as usize] + made.values[b as usize]);
                    made.values.push(middle);
                }
            }
            Interpolation::Corner(corners) => {
                let mut known: HashMap<(u32, u32), u32> = HashMap::new();
                let mut index = |piece: &Piece, k: usize| {
                    let own = [Vec2::ZERO, Vec2::X, Vec2::Y];
                    if let Some(own) = own.iter().position(|at| *at == piece.at[k]) {
                        return corners[piece.base as usize][own];
                    }
                    *known
                        .entry((piece.base, piece.corners[k]))
                        .or_insert_with(|| {
                            let at = piece.at[k];
                            let value = primvar.sample(self.mesh, piece.base as usize, at.x, at.y);
                            made.values.push(value);
                            u32::try_from(made.values.len() - 1).unwrap_or(u32::MAX)
                        })
                };
                let pieces = self.cut.pieces.iter();
                let on_pieces = pieces
                    .map(|piece| [0, 1, 2].map(|k| index(piece, k)))
                    .collect();
                made.interpolation = Interpolation::Corner(on_pieces);
            }
        }
        made
    }

    /// The cage with the normals that its points and corners have now, weighted by angles.
    fn cage(&self, cage: &Cage, normals: &[[Vec3; 3]]) -> Cage {
        let mut at_points = vec![DVec3::ZERO; cage.point_count];
        let mut at_corners: HashMap<(u32, u32), DVec3> = HashMap::new();
        for (piece, normals) in self.cut.pieces.iter().zip(normals) {
            let face = self.mesh.triangle_faces[piece.base as usize];
            let angles = self.angles(piece);
            for k in 0..3 {
                let normal = angles[k] * normals[k].as_dvec3();
                if let Some(sum) = at_points.get_mut(piece.corners[k] as usize) {
                    *sum += normal;
                    *at_corners.entry((face, piece.corners[k])).or_default() += normal;
                }
            }
        }
        let unit = |sum: DVec3| sum.normalize_or_zero().as_vec3();
        let point_normals: Vec<Vec3> = at_points.into_iter().map(unit).collect();
        let counts = (0_u32..).zip(&cage.face_vertex_counts);
        let faces = counts.flat_map(|(face, &count)| std::iter::repeat_n(face, count as usize));
        let corners = faces.zip(&cage.face_vertex_indices).map(|(face, &point)| {
            let own = at_corners.get(&(face, point)).copied().map(unit);
            own.unwrap_or(
                point_normals
                    .get(point as usize)
                    .copied()
                    .unwrap_or_default(),
            )
        });
        let corner_normals: Vec<Vec3> = corners.collect();
        let is_split = |(normal, &point): (&Vec3, &u32)| {
            let at_point = point_normals
                .get(point as usize)
                .copied()
                .unwrap_or_default();
            1.0 - normal.dot(at_point) > SMOOTH && at_point != Vec3::ZERO
        };
        let mut pairs = corner_normals.iter().zip(&cage.face_vertex_indices);
        let are_split = pairs.any(is_split);
        Cage {
            corner_normals: if are_split {
                corner_normals
            } else {
                Vec::new()
            },
            point_normals,
            ..cage.clone()
        }
    }
}

/// What corners in one place say together, weighted by their angles.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    normal: DVec3,
    height: f64,
    weight: f64,
}

impl Sum {
    fn add(&mut self, other: &Self) {
        self.normal += other.normal;
        self.height += other.height;
        self.weight += other.weight;
    }
}

/// For each of `positions` the first of those that equal it; of a closed mesh, which shares them, itself.
fn firsts(positions: &[Vec3], is_closed: bool) -> Vec<u32> {
    let numbers = (0_u32..).take(positions.len());
    if is_closed {
        return numbers.collect();
    }
    let mut known: HashMap<[u32; 3], u32> = HashMap::with_capacity(positions.len());
    let first = |(number, position): (u32, &Vec3)| {
        // −0 is 0.
        let place = (*position + 0.0).to_array().map(f32::to_bits);
        *known.entry(place).or_insert(number)
    };
    numbers.zip(positions).map(first).collect()
}
