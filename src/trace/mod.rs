//! Rays against a scene: closest hits and occlusion, two-level where meshes are shared.
//!
//! Prims that own their mesh, and shared ones as long as their copies are few, are in one hierarchy in world space: boxes
//! of leaves and branches overlap less than those of whole plants. A mesh shared more often has a hierarchy in its object
//! space, under a top level over its occurrences. Both levels are the same eight-way tree, `wide`. Boxes and triangles are plain loops
//! over lanes; the whole search is compiled once for every instruction set and the widest one that the machine has is
//! taken. No operation is fused or reordered, so that the results are the same bits on all of them.

mod beam;
mod bodies;
mod packet;
mod ray;
mod screens;
mod triangles;
mod wide;

use crate::math::Bounds3;
use crate::scene::{MeshId, PlacedMesh, Prim, PrimId, Scene};
pub use beam::{Beam, TOGETHER, Way};
pub use bodies::Bodies;
use fearless_simd::{Level, Simd, dispatch};
use glam::{Affine3A, Vec3};
use ray::Ray;
use rayon::prelude::*;
use screens::Screens;
pub use screens::{Layer, Opacity};
use std::sync::Arc;
use triangles::{LocalHit, Triangles};
use wide::{FARTHEST_FIRST, Item, LEAF_SIZE, Leaf, NEAREST_FIRST, Wide};

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
    /// Prims that own their mesh and copies of shared ones, in world space.
    world: Group,
    /// Meshes shared too often for copies, in object space.
    shared: Vec<Triangles>,
    occurrences: Vec<Occurrence>,
    top: Wide,
    /// Largest coordinate of the scene, absolute.
    magnitude: f32,
    /// Instructions of this machine.
    level: Level,
    /// Prims that let light through, which are in none of the above; `None` where none does.
    screens: Option<Screens>,
}

/// Several prims in one hierarchy.
#[derive(Debug, Default)]
struct Group {
    triangles: Triangles,
    /// Every prim, in order of its first triangle.
    members: Vec<Member>,
}

/// A prim of a [`Group`].
#[derive(Debug, Clone, Copy)]
struct Member {
    first: u32,
    prim: PrimId,
    /// Counter-clockwise in the world is the back.
    is_mirrored: bool,
}

#[derive(Debug)]
struct Occurrence {
    prim: PrimId,
    /// Index into `Tracer::shared`.
    mesh: usize,
    /// Rows: factors of x, y and z, and the offset.
    object_from_world: [[f32; 4]; 3],
}

/// Lifting height over the magnitude of the coordinates: 8 times the rounding of a position that was interpolated
/// or transformed, 50 times below a contact of 1e-4 of the scene.
const LIFT: f32 = 16.0 * f32::EPSILON;
/// Most triangles that copies of shared meshes add to the world: 60 MB. Rays among 400 plants whose boxes overlap (foliage of
/// `tests/bench/make_scenes.py`, 144 000 triangles) take 0.55 of the time for visibility, 0.66 for one bounce.
const MOST_COPIES: usize = 1 << 20;

/// Positions on triangles that span the scene are rounded relative to its corners, wherever they are.
const SCENE_SHARE: f32 = 0.25;

impl Tracer {
    /// Build it; cost O(n log n) in triangles, instances share theirs. Prims whose transform cannot be inverted have
    /// no area and are left out. Every surface stops all light.
    pub fn new(scene: &Scene) -> Self {
        Self::among(scene, None, |_| true)
    }

    /// [`Self::new`] of the prims for which `is_in` holds; all else lets rays pass. Surfaces stop as much light as `opacity`
    /// says, all of it without one.
    pub fn among(
        scene: &Scene,
        opacity: Option<Arc<dyn Opacity>>,
        is_in: impl Fn(PrimId) -> bool,
    ) -> Self {
        let is_screen = |prim| opacity.as_ref().is_some_and(|all| all.is_screen(prim));
        let solid = Self::with_copies(scene, MOST_COPIES, |prim| is_in(prim) && !is_screen(prim));
        let has_screens = ids(scene).any(|prim| is_in(prim) && is_screen(prim));
        let screens = opacity.as_ref().filter(|_| has_screens).map(|opacity| {
            let is_in = |prim| is_in(prim) && is_screen(prim);
            Screens {
                prims: Box::new(Self::with_copies(scene, MOST_COPIES, is_in)),
                opacity: Arc::clone(opacity),
            }
        });
        Self { screens, ..solid }
    }

    /// [`Self::new`] with at most so many triangles of copies in the world.
    fn with_copies(scene: &Scene, most_copies: usize, is_in: impl Fn(PrimId) -> bool) -> Self {
        let is_copied = copied(scene, most_copies);
        let prims = ids(scene).zip(&scene.prims);
        let prims = prims.filter(|(id, _)| is_in(*id));
        let (owned, transformed): (Vec<_>, Vec<_>) =
            prims.partition(|(_, prim)| is_copied[prim.mesh.index()]);
        let ids_of = |prims: Vec<(PrimId, &Prim)>| -> Vec<PrimId> {
            prims.into_iter().map(|(id, _)| id).collect()
        };
        let (owned, transformed) = (ids_of(owned), ids_of(transformed));
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
            screens: None,
        }
    }

    /// First hit along the unit `direction` with distance in (0, `max_distance`); of several at the same distance that of
    /// the first prim and its first triangle. None if a number is not finite
    /// (`max_distance` may be infinite). A surface that lets light through counts where, with those before it, it stops at
    /// least half.
    #[inline]
    pub fn closest(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit> {
        let solid = self.solid_closest(origin, direction, max_distance);
        let Some(screens) = &self.screens else {
            return solid;
        };
        let (end, mut layers) = (end_of(solid, max_distance), Vec::new());
        screens.pass((origin, direction), end, &mut layers);
        Self::hides_most(&layers, solid)
    }

    /// [`Self::closest`] among surfaces that let nothing through.
    pub fn solid_closest(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> Option<Hit> {
        dispatch!(self.level, simd => self.find_closest(simd, origin, direction, max_distance))
    }

    #[inline(always)]
    fn find_closest<S: Simd>(
        &self,
        simd: S,
        origin: Vec3,
        direction: Vec3,
        max_distance: f32,
    ) -> Option<Hit> {
        let mut ray = Ray::new(origin, direction, max_distance)?;
        let own = self.world.closest(simd, &mut ray);
        self.nearer_occurrence(simd, &mut ray, own)
    }

    /// The first hit of a ray among prims of shared meshes, which it shortens to it, or `best` if that is nearer.
    #[inline(always)]
    fn nearer_occurrence<S: Simd>(
        &self,
        simd: S,
        ray: &mut Ray,
        mut best: Option<Hit>,
    ) -> Option<Hit> {
        self.top.traverse::<NEAREST_FIRST, S>(
            simd,
            ray,
            #[inline(always)]
            |leaf, ray| {
                for occurrence in self.occurrences_of(leaf) {
                    let Some(mut local) = occurrence.local(ray) else {
                        continue;
                    };
                    local.before = occurrence.before(best.map_or(0, |hit| hit.prim.0));
                    if let Some(hit) = self.shared[occurrence.mesh].closest(simd, &mut local) {
                        ray.max_distance = hit.distance;
                        best = Some(hit.of_prim(occurrence.prim, hit.triangle));
                    }
                }
                false
            },
        );
        best
    }

    /// True if what lies along the unit `direction` closer than `max_distance` stops at least half of the light.
    #[inline]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        self.solid_occluded(origin, direction, max_distance)
            || (self.screens.as_ref()).is_some_and(|screens| {
                let ray = (origin, direction);
                screens.pass(ray, max_distance, &mut Vec::new()) <= screens::MOST_OPEN
            })
    }

    /// [`Self::occluded`] by surfaces that let nothing through.
    pub fn solid_occluded(&self, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        dispatch!(self.level, simd => self.find_any(simd, origin, direction, max_distance))
    }

    #[inline(always)]
    fn find_any<S: Simd>(&self, simd: S, origin: Vec3, direction: Vec3, max_distance: f32) -> bool {
        let Some(mut ray) = Ray::new(origin, direction, max_distance) else {
            return false;
        };
        self.world.triangles.occluded(simd, &mut ray) || self.meets_occurrence(simd, &mut ray)
    }

    /// True if `ray` meets one of several occurrences of a mesh.
    #[inline(always)]
    fn meets_occurrence<S: Simd>(&self, simd: S, ray: &mut Ray) -> bool {
        let mut hit = false;
        self.top.traverse::<FARTHEST_FIRST, S>(
            simd,
            ray,
            #[inline(always)]
            |leaf, ray| {
                for occurrence in self.occurrences_of(leaf) {
                    if let Some(mut local) = occurrence.local(ray) {
                        hit |= self.shared[occurrence.mesh].occluded(simd, &mut local);
                    }
                }
                hit
            },
        );
        hit
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
            + self.world.members.capacity() * size_of::<Member>()
            + shared
            + self.occurrences.capacity() * size_of::<Occurrence>()
            + self.top.bytes()
            + (self.screens.as_ref()).map_or(0, |screens| screens.prims.bytes())
    }

    #[inline(always)]
    fn occurrences_of(&self, leaf: Leaf) -> impl Iterator<Item = &Occurrence> {
        let first = leaf.block * LEAF_SIZE;
        (self.top.order[first..first + leaf.count].iter())
            .map(|&index| &self.occurrences[index as usize])
    }
}

impl Group {
    fn new(scene: &Scene, prims: &[PrimId]) -> Self {
        let mut members: Vec<Member> = Vec::with_capacity(prims.len());
        let mut placed: Vec<PlacedMesh> = Vec::with_capacity(prims.len());
        let mut count = 0_u32;
        for &prim in prims {
            let transform = scene.prims[prim.index()].world_from_object;
            if !transform.inverse().is_finite() {
                continue;
            }
            members.push(Member {
                first: count,
                prim,
                is_mirrored: transform.matrix3.determinant() < 0.0,
            });
            let mesh = PlacedMesh::of(scene, prim);
            let total = count.checked_add(mesh.triangle_count());
            count = total.expect("Wide::build holds at most 2^29 triangles");
            placed.push(mesh);
        }
        let corners = |triangle: u32| {
            let member = member_of(&members, triangle);
            placed[member].corners(triangle - members[member].first)
        };
        Self {
            triangles: Triangles::new(count, &corners),
            members,
        }
    }

    #[inline(always)]
    fn closest<S: Simd>(&self, simd: S, ray: &mut Ray) -> Option<Hit> {
        self.triangles
            .closest(simd, ray)
            .map(|hit| self.resolve(hit))
    }

    /// The hit with its prim.
    #[inline(always)]
    fn resolve(&self, hit: LocalHit) -> Hit {
        let member = &self.members[member_of(&self.members, hit.triangle)];
        Hit {
            front: hit.front != member.is_mirrored,
            ..hit.of_prim(member.prim, hit.triangle - member.first)
        }
    }
}

/// Which of `members` has `triangle`.
#[inline(always)]
fn member_of(members: &[Member], triangle: u32) -> usize {
    members.partition_point(|member| member.first <= triangle) - 1
}

impl LocalHit {
    #[inline(always)]
    fn of_prim(&self, prim: PrimId, triangle: u32) -> Hit {
        Hit {
            distance: self.distance,
            prim,
            triangle,
            u: self.u,
            v: self.v,
            front: self.front,
        }
    }
}

impl Occurrence {
    /// The ray in object space; the direction keeps its image's length, so that distances stay world distances.
    #[inline(always)]
    fn local(&self, ray: &Ray) -> Option<Ray> {
        let origin = self.object_from_world.map(|[x, y, z, offset]| {
            x * ray.origin.x + y * ray.origin.y + z * ray.origin.z + offset
        });
        let direction = self.local_direction(ray.line.direction);
        Ray::new(Vec3::from(origin), direction, ray.max_distance)
    }

    #[inline(always)]
    fn local_direction(&self, direction: Vec3) -> Vec3 {
        let turn = |[x, y, z, _]: [f32; 4]| x * direction.x + y * direction.y + z * direction.z;
        Vec3::from(self.object_from_world.map(turn))
    }

    /// As [`Ray::before`], for a ray whose nearest hit so far is of `prim`: prims that come first win ties.
    #[inline(always)]
    fn before(&self, prim: u32) -> u32 {
        if self.prim.0 < prim { u32::MAX } else { 0 }
    }
}

/// For every mesh of `scene`, whether its prims have copies in the world: those used once, and as many of the others, those
/// with the fewest triangles in all first, as have no more than `most_copies` triangles together.
fn copied(scene: &Scene, most_copies: usize) -> Vec<bool> {
    let mut uses = vec![0_usize; scene.meshes.len()];
    for prim in &scene.prims {
        uses[prim.mesh.index()] += 1;
    }
    let triangles = |mesh: usize| uses[mesh] * scene.meshes[mesh].triangles.len();
    let mut shared: Vec<usize> = (0..uses.len()).filter(|&mesh| uses[mesh] > 1).collect();
    shared.sort_by_key(|&mesh| triangles(mesh));
    let mut is_copied: Vec<bool> = uses.iter().map(|&uses| uses <= 1).collect();
    let mut left = most_copies;
    for mesh in shared {
        let Some(rest) = left.checked_sub(triangles(mesh)) else {
            break;
        };
        (left, is_copied[mesh]) = (rest, true);
    }
    is_copied
}

fn ids(scene: &Scene) -> impl Iterator<Item = PrimId> {
    (0_u32..).map(PrimId).take(scene.prims.len())
}

/// Where a ray that meets `solid`, or nothing before `max_distance`, ends.
fn end_of(solid: Option<Hit>, max_distance: f32) -> f32 {
    solid.map_or(max_distance, |hit| hit.distance)
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
            object_from_world: rows_of(object_from_world),
        });
    }
    let build = |mesh: &MeshId| {
        let mesh = &scene.meshes[mesh.index()];
        let count = u32::try_from(mesh.triangles.len());
        let count = count.expect("triangles are numbered with 32 bits");
        Triangles::new(count, &|t| mesh.corners(t as usize))
    };
    (meshes.par_iter().map(build).collect(), occurrences)
}

fn rows_of(transform: Affine3A) -> [[f32; 4]; 3] {
    let [x, y, z, offset] = transform.to_cols_array_2d();
    [0, 1, 2].map(|i| [x[i], y[i], z[i], offset[i]])
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
