//! Points of meshes as receivers: one a point of the cage, or one a face-vertex where shading normals split.
//!
//! Points on open edges, and corners at which shading normals split, are pulled a little inwards on one of the
//! triangles around them: the last row of a floor's points often lies exactly in the plane of a wall, from where the
//! room cannot be seen. They stay on their surface, so that it does not shadow them.
//!
//! Points that no triangle uses have no surface to receive light on, but USD wants a value for each: they take that
//! of the last used point before them in the authored order (of the first used one, if there is none before).

use super::Receivers;
use crate::math::parts::in_parts;
use crate::results::{BakeInterpolation, PrimvarSpan, Target};
use crate::scene::{Cage, PlacedMesh, PrimId, Scene, on_the_side_of};
use crate::shading::SurfacePoint;
use glam::Vec3;
use rayon::prelude::*;

/// How far points are pulled inwards, as a part of the way to the centroid of the largest triangle around them: far
/// enough from a wall for rays to pass, near enough to be the same place (about 1 % of an edge).
const PULL: f32 = 0.015;

/// Receivers at the points of the cages of `prims`, in their order, at limit positions. Prims without a cage
/// (implicit shapes) or without triangles are left out; each of the others has a [`PrimvarSpan`].
pub fn place(scene: &Scene, prims: &[PrimId], interpolation: BakeInterpolation) -> Receivers {
    let placed: Vec<Placed> = prims
        .par_iter()
        .filter_map(|&id| place_prim(scene, id, interpolation))
        .collect();
    let mut first = 0;
    let span = |prim: &Placed| {
        let values = prim.receiver_of_value.iter();
        let receiver_of_value = values.map(|receiver| first + receiver).collect();
        first += number(prim.vertices.len());
        PrimvarSpan {
            prim: prim.id,
            interpolation,
            receiver_of_value,
        }
    };
    let spans = placed.iter().map(span).collect();
    let places = || {
        rayon::join(
            || column(&placed, |vertex| vertex.position),
            || column(&placed, |vertex| vertex.normal),
        )
    };
    let surfaces = || {
        rayon::join(
            || column(&placed, |vertex| vertex.geometric_normal),
            || column(&placed, |vertex| vertex.surface),
        )
    };
    let ((position, normal), (geometric_normal, surface)) = rayon::join(places, surfaces);
    Receivers {
        origin: scene.origin,
        position,
        normal,
        geometric_normal,
        prim: surface.iter().map(|point| point.prim.0).collect(),
        surface,
        depth: Vec::new(),
        toward_eye: Vec::new(),
        target: Target::Primvars(spans),
    }
}

/// What `of` tells of each vertex, one prim after the other.
fn column<T>(placed: &[Placed], of: impl Fn(&Vertex) -> T) -> Vec<T> {
    let count = placed.iter().map(|prim| prim.vertices.len()).sum();
    let mut column = Vec::with_capacity(count);
    for prim in placed {
        column.extend(prim.vertices.iter().map(&of));
    }
    column
}

/// A point of a cage as a receiver.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Vertex {
    position: Vec3,
    normal: Vec3,
    geometric_normal: Vec3,
    surface: SurfacePoint,
}

/// Receivers of one prim and which of them each of its values takes.
struct Placed {
    id: PrimId,
    vertices: Vec<Vertex>,
    receiver_of_value: Vec<u32>,
}

fn place_prim(scene: &Scene, id: PrimId, interpolation: BakeInterpolation) -> Option<Placed> {
    let world = PlacedMesh::new(scene, &scene.prims[id.index()]);
    let cage = world.mesh.cage.as_ref()?;
    let slots = Slots::new(cage, interpolation);
    let surroundings = surroundings(&world, &slots);
    let mut receiver_of_slot = Vec::with_capacity(slots.slots.len());
    let mut used = Vec::with_capacity(slots.slots.len());
    for (slot, around) in slots.slots.iter().zip(&surroundings) {
        used.extend(around.as_ref().map(|around| (slot, around)));
        receiver_of_slot.push(number(used.len()).saturating_sub(1));
    }
    let vertices: Vec<Vertex> = (used.par_iter())
        .map(|(slot, around)| vertex(&world, id, slot, around))
        .collect();
    let receiver = |slot: &u32| receiver_of_slot[*slot as usize];
    (!vertices.is_empty()).then(|| Placed {
        id,
        receiver_of_value: slots.slot_of_value.iter().map(receiver).collect(),
        vertices,
    })
}

fn number(length: usize) -> u32 {
    u32::try_from(length).expect("points and face-vertices are numbered with 32 bits")
}

/// A place for a value on a cage: a point, or one of several corners at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Slot {
    point: u32,
    /// Object space; zero if unknown.
    normal: Vec3,
    /// At an open edge, or where shading normals split.
    is_on_edge: bool,
}

/// The distinct places of a cage's values.
struct Slots<'a> {
    cage: &'a Cage,
    slots: Vec<Slot>,
    slot_of_value: Vec<u32>,
    /// For split corners: number of the first face-vertex of every face; else empty, as slots are points then.
    first_corner_of_face: Vec<u32>,
}

impl<'a> Slots<'a> {
    fn new(cage: &'a Cage, interpolation: BakeInterpolation) -> Self {
        let corners = cage.face_vertex_indices.len();
        match interpolation {
            BakeInterpolation::FaceVarying
                if cage.corner_normals.len() == corners && corners > 0 =>
            {
                Self::of_corners(cage)
            }
            BakeInterpolation::FaceVarying => {
                Self::of_points(cage, cage.face_vertex_indices.clone())
            }
            BakeInterpolation::Vertex => {
                Self::of_points(cage, (0..number(cage.point_count)).collect())
            }
        }
    }

    fn of_points(cage: &'a Cage, slot_of_value: Vec<u32>) -> Self {
        let slot = |point: u32| Slot {
            point,
            normal: cage
                .point_normals
                .get(point as usize)
                .copied()
                .unwrap_or_default(),
            is_on_edge: cage.on_boundary.get(point as usize) == Some(&true),
        };
        Self {
            cage,
            slots: (0..number(cage.point_count)).map(slot).collect(),
            slot_of_value,
            first_corner_of_face: Vec::new(),
        }
    }

    /// Distinct pairs of point and corner normal, by point, then by first appearance.
    fn of_corners(cage: &'a Cage) -> Self {
        let point_of = |corner: &u32| cage.face_vertex_indices[*corner as usize];
        let mut order: Vec<u32> = (0..number(cage.face_vertex_indices.len())).collect();
        order.sort_by_key(point_of);
        let mut slot_of_value = vec![0; order.len()];
        let mut slots: Vec<Slot> = Vec::new();
        for corners in order.chunk_by(|a, b| point_of(a) == point_of(b)) {
            let first = slots.len();
            for &corner in corners {
                let normal = cage.corner_normals[corner as usize];
                let known = slots[first..].iter().position(|slot| slot.normal == normal);
                let slot = first + known.unwrap_or(slots.len() - first);
                if slot == slots.len() {
                    let point = point_of(&corner);
                    let is_on_edge = cage.on_boundary.get(point as usize) == Some(&true);
                    slots.push(Slot {
                        point,
                        normal,
                        is_on_edge,
                    });
                }
                slot_of_value[corner as usize] = number(slot);
            }
            if slots.len() > first + 1 {
                slots[first..]
                    .iter_mut()
                    .for_each(|slot| slot.is_on_edge = true);
            }
        }
        let mut next = 0;
        let first_corner = |count: &u32| {
            next += count;
            next - count
        };
        Self {
            cage,
            slots,
            slot_of_value,
            first_corner_of_face: cage.face_vertex_counts.iter().map(first_corner).collect(),
        }
    }

    /// The slot of cage point `point` as a corner of a triangle that comes from face `face`.
    fn find(&self, face: u32, point: u32) -> Option<usize> {
        if self.first_corner_of_face.is_empty() {
            return Some(point as usize);
        }
        let first = *self.first_corner_of_face.get(face as usize)? as usize;
        let count = *self.cage.face_vertex_counts.get(face as usize)? as usize;
        let corners = self.cage.face_vertex_indices.get(first..first + count)?;
        let corner = corners.iter().position(|other| *other == point)?;
        Some(self.slot_of_value[first + corner] as usize)
    }
}

/// What the triangles around a slot are like, in object space.
#[derive(Debug, Clone, Copy)]
struct Around {
    /// Sum of their plane normals times twice their areas.
    normal: Vec3,
    /// The largest of them.
    triangle: u32,
    /// Which corner of it the point is.
    corner: u8,
    /// Square of twice its area.
    size: f32,
}

/// For every slot; `None` without any triangle.
fn surroundings(world: &PlacedMesh<'_>, slots: &Slots<'_>) -> Vec<Option<Around>> {
    let mesh = world.mesh;
    let mut all: Vec<Option<Around>> = vec![None; slots.slots.len()];
    in_parts(&mut all, mesh.triangles.len(), |mut part| {
        let range = part.range();
        for (t, corners) in (0_u32..).zip(&mesh.triangles) {
            let face = mesh.triangle_faces[t as usize];
            // Refined surfaces have positions beyond the cage's points.
            let on_cage = |&point: &u32| (point as usize) < slots.cage.point_count;
            let slot = |point: u32| {
                let point = Some(point).filter(on_cage)?;
                slots.find(face, point).filter(|slot| range.contains(slot))
            };
            let found = corners.map(slot);
            if found == [None; 3] {
                continue;
            }
            let [a, b, c] = mesh.corners(t as usize);
            let normal = (b - a).cross(c - a);
            let size = normal.length_squared();
            for (corner, slot) in (0_u8..).zip(found) {
                let Some(around) = slot.and_then(|slot| part.get_mut(slot)) else {
                    continue;
                };
                let this = Around {
                    normal,
                    triangle: t,
                    corner,
                    size,
                };
                *around = Some(match *around {
                    None => this,
                    Some(other) => Around {
                        normal: other.normal + normal,
                        ..if size > other.size { this } else { other }
                    },
                });
            }
        }
    });
    all
}

#[expect(clippy::cast_possible_truncation, reason = "a length, rounded to f32")]
fn vertex(world: &PlacedMesh<'_>, id: PrimId, slot: &Slot, around: &Around) -> Vertex {
    let t = around.triangle;
    let pull = if slot.is_on_edge { PULL } else { 0.0 };
    let weight = |corner: u8| {
        pull / 3.0
            + if around.corner == corner {
                1.0 - pull
            } else {
                0.0
            }
    };
    let (u, v) = (weight(1), weight(2));
    let plane = world.normal(around.normal);
    let shading = world.normal(slot.normal);
    // Around a point the planes may cancel, or all be without area: the shading normal must do, at last any.
    let geometric = [plane, shading]
        .into_iter()
        .find(|normal| *normal != Vec3::ZERO);
    let geometric = geometric.unwrap_or(Vec3::Y);
    let position = if slot.is_on_edge {
        world.position(t, u, v)
    } else {
        world.point(world.mesh.positions[slot.point as usize])
    };
    Vertex {
        position,
        normal: on_the_side_of(geometric, shading),
        geometric_normal: geometric,
        surface: SurfacePoint {
            prim: id,
            triangle: around.triangle,
            u,
            v,
            footprint: world.area(t).sqrt() as f32,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::scene_of;
    use super::*;
    use crate::scene::{Mesh, Normals};
    use glam::Affine3A;

    /// Two unit squares at a right angle: floor in XZ facing +Y, wall in XY facing +Z, sharing the X axis; and one
    /// loose point in front.
    fn corner_of_a_room() -> Mesh {
        let positions = [
            [9.0, 9.0, 9.0],
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [0.0, 1.0, 0.0],
            [1.0, 1.0, 0.0],
        ];
        let indices = vec![1, 3, 4, 2, 1, 2, 6, 5];
        let slanted = Vec3::new(0.0, 1.0, 1.0).normalize();
        Mesh {
            positions: positions.map(Vec3::from).to_vec(),
            triangles: vec![[1, 3, 4], [1, 4, 2], [1, 2, 6], [1, 6, 5]],
            triangle_faces: vec![0, 0, 1, 1],
            normals: Normals::Flat,
            primvars: vec![],
            double_sided: false,
            closed: false,
            cage: Some(Cage {
                point_count: 7,
                face_vertex_counts: vec![4, 4],
                face_vertex_indices: indices,
                point_normals: vec![
                    Vec3::ZERO,
                    slanted,
                    slanted,
                    Vec3::Y,
                    Vec3::Y,
                    Vec3::Z,
                    Vec3::Z,
                ],
                corner_normals: [[Vec3::Y; 4], [Vec3::Z; 4]].concat(),
                on_boundary: vec![false, true, true, true, true, true, true],
            }),
            scheme: "none".into(),
        }
    }

    fn spans(receivers: &Receivers) -> &[PrimvarSpan] {
        match &receivers.target {
            Target::Primvars(spans) => spans,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn every_point_has_a_value_and_edges_are_pulled_inwards() {
        let scene = scene_of(vec![(
            corner_of_a_room(),
            Affine3A::from_translation(Vec3::X),
        )]);
        let receivers = place(&scene, &[PrimId(0)], BakeInterpolation::Vertex);
        // The loose point takes the value of the first used one.
        assert_eq!(
            spans(&receivers)[0].receiver_of_value,
            [0, 0, 1, 2, 3, 4, 5]
        );
        assert_eq!(receivers.len(), 6);
        let mesh = corner_of_a_room();
        for i in 0..6 {
            let point = mesh.positions[i + 1] + Vec3::X;
            let distance = receivers.position[i].distance(point);
            assert!((0.005..0.02).contains(&distance), "{distance}");
            assert!(receivers.geometric_normal[i].dot(receivers.normal[i]) > 0.7);
        }
        // The floor's far corner moves along the floor, away from both edges.
        let far = receivers.position[3];
        assert!(far.y == 0.0 && far.x < 2.0 && far.z < 1.0, "{far}");
        // Surface points say the same place.
        let world = PlacedMesh::new(&scene, &scene.prims[0]);
        for (position, point) in receivers.position.iter().zip(&receivers.surface) {
            let again = world.position(point.triangle, point.u, point.v);
            assert!(position.distance(again) < 1e-6);
        }
    }

    #[test]
    fn corners_with_distinct_normals_have_receivers_of_their_own() {
        let scene = scene_of(vec![(corner_of_a_room(), Affine3A::IDENTITY)]);
        let receivers = place(&scene, &[PrimId(0)], BakeInterpolation::FaceVarying);
        assert_eq!(receivers.len(), 8);
        let values = &spans(&receivers)[0].receiver_of_value;
        for (corner, &value) in values.iter().enumerate() {
            let expected = if corner < 4 { Vec3::Y } else { Vec3::Z };
            assert_eq!(receivers.normal[value as usize], expected);
            assert_eq!(receivers.geometric_normal[value as usize], expected);
            // On its own face, off the fold.
            let position = receivers.position[value as usize];
            let (height, inwards) = if corner < 4 {
                (position.y, position.z)
            } else {
                (position.z, position.y)
            };
            assert!(height == 0.0 && inwards > 0.0, "{position}");
        }
    }

    #[test]
    fn without_split_normals_face_vertices_share_the_receivers_of_points() {
        let mut mesh = corner_of_a_room();
        mesh.cage.as_mut().unwrap().corner_normals.clear();
        let scene = scene_of(vec![(mesh, Affine3A::IDENTITY)]);
        let receivers = place(&scene, &[PrimId(0)], BakeInterpolation::FaceVarying);
        assert_eq!(receivers.len(), 6);
        assert_eq!(
            spans(&receivers)[0].receiver_of_value,
            [0, 2, 3, 1, 0, 1, 5, 4]
        );
    }

    #[test]
    fn normals_of_mirrored_and_stretched_instances_keep_their_side() {
        let mirror = Affine3A::from_scale(Vec3::new(-1.0, 3.0, 1.0));
        let scene = scene_of(vec![(corner_of_a_room(), mirror)]);
        let receivers = place(&scene, &[PrimId(0)], BakeInterpolation::FaceVarying);
        let values = &spans(&receivers)[0].receiver_of_value;
        assert_eq!(receivers.geometric_normal[values[0] as usize], Vec3::Y);
        assert_eq!(receivers.geometric_normal[values[7] as usize], Vec3::Z);
    }

    #[test]
    fn shapes_without_cage_or_triangles_have_no_receivers() {
        let mut implicit = corner_of_a_room();
        implicit.cage = None;
        let mut empty = corner_of_a_room();
        empty.triangles.clear();
        let scene = scene_of(vec![
            (implicit, Affine3A::IDENTITY),
            (empty, Affine3A::IDENTITY),
            (corner_of_a_room(), Affine3A::IDENTITY),
        ]);
        let receivers = place(
            &scene,
            &[PrimId(0), PrimId(1), PrimId(2)],
            BakeInterpolation::Vertex,
        );
        assert_eq!(spans(&receivers).len(), 1);
        assert_eq!(spans(&receivers)[0].prim, PrimId(2));
        assert!(place(&scene, &[], BakeInterpolation::Vertex).is_empty());
    }
}
