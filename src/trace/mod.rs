//! Rays against a scene: closest hits and occlusion, two-level where meshes are shared.
//!
//! Prims that own their mesh are in one hierarchy in world space; a shared mesh has one in its object space, under a
//! top level over its occurrences. Both levels are the same eight-way tree, `wide`. Boxes and triangles are plain loops
//! over lanes; the whole search is compiled once for every instruction set and the widest one that the machine has is
//! taken. No operation is fused or reordered, so that the results are the same bits on all of them.

mod ray;
mod triangles;
mod wide;

use crate::math::Bounds3;
use crate::scene::{Mesh, PrimId, Scene};
use fearless_simd::{Level, dispatch};
use glam::{Affine3A, Vec3};
use ray::Ray;
use rayon::prelude::*;
use triangles::Triangles;
use wide::{Item, LEAF_SIZE, Wide};

/// Where a ray meets the scene first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Along the unit direction, stage units.
    pub distance: f32,
    /// The prim.
    pub prim: PrimId,
    /// Triangle of its mesh.
    pub triangle: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2.
    pub v: f32,
    /// True if the ray came from the front side (counter-clockwise in world space after undoing mirroring: the side
    /// the object-space normal points to).
    pub front: bool,
}

/// Acceleration structure over all prims of a scene.
#[derive(Debug)]
pub struct Tracer {
    /// Prims that own their mesh and need no transform, in world space.
    world: Group,
    /// Shared or transformed meshes, in object space.
    shared: Vec<Triangles>,
    occurrences: Vec<Occurrence>,
    top: Wide,
    /// Largest coordinate of the scene, absolute.
    magnitude: f32,
    /// Instructions of this machine.
    level: Level,
}

/// Several prims in one hierarchy.
#[derive(Debug, Default)]
struct Group {
    triangles: Triangles,
    /// First triangle of every prim, ascending, and the prim.
    firsts: Vec<(u32, PrimId)>,
}

#[derive(Debug)]
struct Occurrence {
    prim: PrimId,
    /// Index into `Tracer::shared`.
    mesh: usize,
    object_from_world: Affine3A,
}

/// Lifting height over the magnitude of the coordinates: 8 times the rounding of a position that was interpolated
/// or transformed, 50 times below a contact of 1e-4 of the scene.
const LIFT: f32 = 16.0 * f32::EPSILON;
/// Edge functions of triangles that span the scene are rounded relative to the scene, wherever the position is.
const SCENE_SHARE: f32 = 0.25;

impl Tracer {
    /// Build it; cost O(n log n) in triangles, instances share theirs. Prims whose transform cannot be inverted have
    /// no area and are left out.
    pub fn new(scene: &Scene) -> Self {
        let (mut owned, mut transformed) = (Vec::new(), Vec::new());
        let mut uses = vec![0_u32; scene.meshes.len()];
        for prim in &scene.prims {
            uses[prim.mesh.index()] += 1;
        }
        for (index, prim) in (0_u32..).zip(&scene.prims) {
            if uses[prim.mesh.index()] == 1 && prim.world_from_object == Affine3A::IDENTITY {
                owned.push(PrimId(index));
            } else {
                transformed.push(PrimId(index));
            }
        }
        let (world, (shared, occurrences)) = rayon::join(
            || Group::new(scene, &owned),
            || build_shared(scene, &transformed),
        );
        let top = Wide::build(top_items(scene, &occurrences));
        let bounds = scene.bounds();
        let magnitude = if bounds.is_empty() {
            0.0
        } else {
            bounds.min.abs().max(bounds.max.abs()).max_element()
        };
        Self {
            world,
            shared,
            occurrences,
            top,
            magnitude,
            level: Level::new(),
        }
    }

    /// First hit along the unit `direction` with distance in (0, `max_distance`). None if a number is not finite
    /// (`max_distance` may be infinite).
    pub fn closest(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit> {
        dispatch!(self.level, _simd => self.find_closest(origin, direction, max_distance))
    }

    /// The scalar definition of [`Self::closest`].
    #[inline(always)]
    fn find_closest(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit> {
        let mut ray = Ray::new(origin, direction, max_distance)?;
        let mut best = self.world.closest(&mut ray);
        self.top.traverse(&mut ray, |block, ray| {
            for occurrence in self.block(block) {
                let Some(mut local) = occurrence.local(ray) else {
                    continue;
                };
                if let Some(hit) = self.shared[occurrence.mesh].closest(&mut local) {
                    ray.max_distance = hit.distance;
                    best = Some(Hit {
                        distance: hit.distance,
                        prim: occurrence.prim,
                        triangle: hit.triangle,
                        u: hit.u,
                        v: hit.v,
                        front: hit.front,
                    });
                }
            }
            false
        });
        best
    }

    /// True if anything lies along the unit `direction` closer than `max_distance`.
    pub fn occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        dispatch!(self.level, _simd => self.find_any(origin, direction, max_distance))
    }

    /// The scalar definition of [`Self::occluded`].
    #[inline(always)]
    fn find_any(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        let Some(mut ray) = Ray::new(origin, direction, max_distance) else {
            return false;
        };
        if self.world.triangles.occluded(&mut ray) {
            return true;
        }
        let mut hit = false;
        self.top.traverse(&mut ray, |block, ray| {
            hit = self.block(block).any(|occurrence| {
                (occurrence.local(ray))
                    .is_some_and(|mut local| self.shared[occurrence.mesh].occluded(&mut local))
            });
            hit
        });
        hit
    }

    /// [`Self::occluded`] for up to 64 rays of one unit `direction`: bit i of the result is set where bit i of `active` is
    /// and the ray from `origins[i]` is blocked closer than `max_distance`.
    ///
    /// # Panics
    /// With more than 64 origins.
    pub fn occluded_along(
        &self,
        direction: Vec3,
        origins: &[Vec3],
        max_distance: f32,
        active: u64,
    ) -> u64 {
        assert!(origins.len() <= 64, "a packet holds at most 64 rays");
        dispatch!(self.level, _simd => {
            let is_blocked = |&(i, &origin): &(usize, &Vec3)| {
                active >> i & 1 == 1 && self.find_any(origin, direction, max_distance)
            };
            (origins.iter().enumerate().filter(is_blocked)).fold(0, |mask, (i, _)| mask | 1 << i)
        })
    }

    /// `position` lifted off its surface along the unit `geometric_normal` just enough that rays do not meet the
    /// surface itself: relative to the magnitude of the coordinates and the scene, far below 1e-4 of its size.
    pub fn lift(&self, position: Vec3, geometric_normal: Vec3) -> Vec3 {
        position + geometric_normal * self.lift_height(position)
    }

    /// How far [`Self::lift`] moves `position`, stage units.
    pub fn lift_height(&self, position: Vec3) -> f32 {
        let local = position.abs().max_element();
        LIFT * local.max(SCENE_SHARE * self.magnitude)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let shared: usize = self.shared.iter().map(Triangles::bytes).sum();
        self.world.triangles.bytes()
            + self.world.firsts.capacity() * size_of::<(u32, PrimId)>()
            + shared
            + self.occurrences.capacity() * size_of::<Occurrence>()
            + self.top.bytes()
    }

    #[inline(always)]
    fn block(&self, block: usize) -> impl Iterator<Item = &Occurrence> {
        let first = block * LEAF_SIZE;
        (self.top.order[first..first + LEAF_SIZE].iter())
            .filter_map(|&index| self.occurrences.get(index as usize))
    }
}

impl Group {
    fn new(scene: &Scene, prims: &[PrimId]) -> Self {
        let mut corners = Vec::new();
        let mut firsts = Vec::with_capacity(prims.len());
        for &prim in prims {
            let first =
                u32::try_from(corners.len()).expect("Wide::build holds at most 2^29 triangles");
            firsts.push((first, prim));
            corners.extend(corners_of(scene.mesh_of(&scene.prims[prim.index()])));
        }
        Self {
            triangles: Triangles::new(&corners),
            firsts,
        }
    }

    #[inline(always)]
    fn closest(&self, ray: &mut Ray) -> Option<Hit> {
        let hit = self.triangles.closest(ray)?;
        let after = self
            .firsts
            .partition_point(|&(first, _)| first <= hit.triangle);
        let (first, prim) = self.firsts[after - 1];
        Some(Hit {
            distance: hit.distance,
            prim,
            triangle: hit.triangle - first,
            u: hit.u,
            v: hit.v,
            front: hit.front,
        })
    }
}

impl Occurrence {
    /// The ray in object space; the direction keeps its image's length, so that distances stay world distances.
    #[inline(always)]
    fn local(&self, ray: &Ray) -> Option<Ray> {
        Ray::new(
            self.object_from_world.transform_point3(ray.origin),
            self.object_from_world.transform_vector3(ray.direction),
            ray.max_distance,
        )
    }
}

fn corners_of(mesh: &Mesh) -> impl Iterator<Item = [Vec3; 3]> {
    (0..mesh.triangles.len()).map(|t| mesh.corners(t))
}

/// One hierarchy a mesh, in order of first use, and the prims that use them.
fn build_shared(scene: &Scene, prims: &[PrimId]) -> (Vec<Triangles>, Vec<Occurrence>) {
    let mut slots = vec![None; scene.meshes.len()];
    let mut meshes = Vec::new();
    let mut occurrences = Vec::new();
    for &id in prims {
        let prim = &scene.prims[id.index()];
        let object_from_world = prim.world_from_object.inverse();
        if scene.mesh_of(prim).triangles.is_empty() || !object_from_world.is_finite() {
            continue;
        }
        let mesh = *slots[prim.mesh.index()].get_or_insert_with(|| {
            meshes.push(prim.mesh);
            meshes.len() - 1
        });
        occurrences.push(Occurrence {
            prim: id,
            mesh,
            object_from_world,
        });
    }
    let build = |mesh: &crate::scene::MeshId| -> Triangles {
        let corners: Vec<_> = corners_of(&scene.meshes[mesh.index()]).collect();
        Triangles::new(&corners)
    };
    (meshes.par_iter().map(build).collect(), occurrences)
}

/// World boxes of the occurrences, grown by the rounding of the transform.
fn top_items(scene: &Scene, occurrences: &[Occurrence]) -> Vec<Item> {
    (0_u32..)
        .zip(occurrences)
        .map(|(index, occurrence)| {
            let bounds = scene.bounds_of(&scene.prims[occurrence.prim.index()]);
            let margin = LIFT * bounds.min.abs().max(bounds.max.abs()).max_element();
            let bounds = Bounds3 {
                min: bounds.min - margin,
                max: bounds.max + margin,
            };
            Item { bounds, index }
        })
        .collect()
}

#[cfg(test)]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "numbers of tests are small"
)]
pub(crate) mod testing;
#[cfg(test)]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "numbers of tests are small"
)]
mod tests;
