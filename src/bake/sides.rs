//! Which sides of a prim can be seen, and so need surfels.
//!
//! Front only where the back cannot be seen or shows no light: the inside of a closed mesh that nothing is in. A
//! closed mesh turned inside out (negative volume) with something inside is a room: its front is the inside, which
//! is all that is seen. Everything else gets both sides, and so do prims that are seen through. "Something inside" is the center of another prim's bounds,
//! a light or a camera within the mesh's bounds: cautious, as it costs a few surfels where it is wrong.

use crate::math::Bounds3;
use crate::scene::{Light, LightKind, Mesh, Prim, PrimId, Scene};
use crate::surfels::Sides;
use glam::Vec3;

/// The sides of every prim, in order. O(n log n) to O(n^(5/3)) in prims, plus one pass over all distinct meshes.
pub(super) fn of_prims(scene: &Scene, is_screen: &dyn Fn(PrimId) -> bool) -> Vec<Sides> {
    let bounds: Vec<Bounds3> = scene
        .prims
        .iter()
        .map(|prim| scene.bounds_of(prim))
        .collect();
    let contents = Contents::new(scene, &bounds);
    let volumes: Vec<f64> = scene.meshes.iter().map(signed_volume).collect();
    let side_of = |(id, prim): (u32, &Prim)| {
        let mesh = scene.mesh_of(prim);
        let is_room = volumes[prim.mesh.index()] < 0.0;
        let is_empty = !mesh.closed || !contents.any_in(&bounds[id as usize], PrimId(id));
        // Closed: outside of a solid, inside of a room. A solid turned inside out by mistake shows its back.
        if mesh.closed && is_room != is_empty && !is_screen(PrimId(id)) {
            Sides::Front
        } else {
            Sides::Both
        }
    };
    (0..).zip(&scene.prims).map(side_of).collect()
}

/// Volume that the triangles enclose, object space; negative when they face inwards. Meaningless for open meshes.
fn signed_volume(mesh: &Mesh) -> f64 {
    if !mesh.closed {
        return 0.0;
    }
    let origin = mesh.bounds().center().as_dvec3();
    let cone = |t: usize| {
        let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3() - origin);
        a.dot(b.cross(c)) / 6.0
    };
    (0..mesh.triangles.len()).map(cone).sum()
}

/// A point of the scene, and the prim it is the center of.
#[derive(Debug, Clone, Copy)]
struct Content {
    position: Vec3,
    prim: Option<PrimId>,
}

/// Centers of prims, lights and cameras as an implicit k-d tree: the median of a range is its root.
struct Contents(Vec<Content>);

impl Contents {
    fn new(scene: &Scene, bounds: &[Bounds3]) -> Self {
        let prims = (0..)
            .zip(bounds)
            .filter(|(_, bounds)| !bounds.is_empty())
            .map(|(id, bounds)| Content {
                position: bounds.center(),
                prim: Some(PrimId(id)),
            });
        let places = |light: &Light| match &light.kind {
            LightKind::Distant { .. } | LightKind::Dome { .. } => Vec::new(),
            LightKind::Particles(set) => set.position.clone(),
            _ => vec![Vec3::from(light.world_from_light.translation)],
        };
        let lights = scene.lights.iter().flat_map(places);
        let cameras = scene.cameras.iter();
        let cameras =
            cameras.map(|camera| (camera.world_from_camera.translation - scene.origin).as_vec3());
        let places = lights.chain(cameras).map(|position| Content {
            position,
            prim: None,
        });
        let mut contents: Vec<_> = prims.chain(places).collect();
        sort_as_tree(&mut contents, 0);
        Self(contents)
    }

    /// True if anything but the center of `prim` itself lies in `bounds`.
    fn any_in(&self, bounds: &Bounds3, prim: PrimId) -> bool {
        let found =
            |content: &Content| content.prim != Some(prim) && bounds.contains(content.position);
        any_in_tree(&self.0, 0, bounds, &found)
    }
}

fn sort_as_tree(contents: &mut [Content], axis: usize) {
    if contents.len() < 2 {
        return;
    }
    let middle = contents.len() / 2;
    contents.select_nth_unstable_by(middle, |a, b| a.position[axis].total_cmp(&b.position[axis]));
    let (low, high) = contents.split_at_mut(middle);
    sort_as_tree(low, (axis + 1) % 3);
    sort_as_tree(&mut high[1..], (axis + 1) % 3);
}

fn any_in_tree(
    tree: &[Content],
    axis: usize,
    bounds: &Bounds3,
    found: &impl Fn(&Content) -> bool,
) -> bool {
    let middle = tree.len() / 2;
    let Some(root) = tree.get(middle) else {
        return false;
    };
    let (split, next) = (root.position[axis], (axis + 1) % 3);
    found(root)
        || (bounds.min[axis] <= split && any_in_tree(&tree[..middle], next, bounds, found))
        || (bounds.max[axis] >= split && any_in_tree(&tree[middle + 1..], next, bounds, found))
}
