//! What a camera sees as receivers: one for every distinct surface in a pixel.
//!
//! Every pixel is looked through at fixed, stratified places. Hits on the same prim, side and material, whose normals
//! and planes agree, become one receiver that stands for their share of the samples: light is computed once where
//! pixels are smooth, and separately on both sides of an edge. Where a surface lets light through, a sample is shared between
//! it and what is behind.

mod backdrop;
mod one_face;

use super::Receivers;
use super::lens::{Frame, Lens};
use super::sampling::{Sampling, place_of_sample};
use crate::math::Bounds3;
use crate::results::{PixelShare, Target};
use crate::scene::camera::Projection;
use crate::scene::{Camera, MaterialId, Normals, PlacedMesh, PrimId, Scene, on_the_side_of};
use crate::shading::SurfacePoint;
use crate::trace::{Beam, Hit, Layer, Tracer};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;
use std::cell::OnceCell;

pub use backdrop::{Glow, backdrop};

/// Cosine of the angle (15°) beyond which normals in one pixel are different surfaces.
const SAME_NORMAL_COSINE: f32 = 0.966;

/// Hits farther than this many pixels off the plane of the first are a different surface.
const SAME_PLANE_PIXELS: f32 = 2.0;

/// Cameras whose axes are unit and upright to each other to this measure space as the world does.
const RIGID: f64 = 1e-9;

/// A pixel on a surface seen edge-on is as long as this many pixels at most, for texture filtering.
const MOST_STRETCH: f32 = 8.0;

/// Receivers at what `camera` sees through `samples_per_axis`² places a pixel (at least 1; 1 = the pixel's center).
///
/// Surfaces are lit on the side that is seen: normals of back faces are turned to the viewer. Nothing nearer or
/// farther than the clipping range is seen. The shares of a pixel sum to its coverage.
pub fn place(
    scene: &Scene,
    tracer: &Tracer,
    camera: &Camera,
    frame: Frame,
    samples_per_axis: u32,
) -> Receivers {
    let cast = |sights: &mut Sights| sights.see_through(tracer);
    let sampling = Sampling::uniform(samples_per_axis);
    place_with(scene, &cast, (camera, frame), &sampling)
}

/// A ray from a camera, relative to the scene's origin.
#[derive(Debug, Clone, Copy)]
pub struct CameraRay {
    /// On the near clipping plane.
    pub origin: Vec3,
    /// Unit.
    pub direction: Vec3,
    /// To the far clipping plane.
    pub length: f32,
}

/// The rays of a pixel and what they meet. Kept from one pixel to the next, it allocates nothing.
#[derive(Debug, Default)]
pub struct Sights {
    /// All that look through the pixel.
    pub rays: Vec<CameraRay>,
    /// What each of them meets, in order, up to the first surface that nothing passes through.
    pub layers: Vec<Vec<Layer>>,
    beam: Beam,
}

impl Sights {
    /// Fill [`Self::layers`] with what there is in the scene.
    pub fn see_through(&mut self, tracer: &Tracer) {
        self.look(tracer);
        for (i, (ray, found)) in self.rays.iter().zip(&mut self.layers).enumerate() {
            let solid = self.beam.hit(i);
            let end = solid.map_or(ray.length, |hit| hit.distance);
            let open = tracer.layers((ray.origin, ray.direction), end, found);
            let solid = solid.filter(|_| open > 0.0);
            found.extend(solid.map(|hit| Layer { hit, opacity: 1.0 }));
        }
    }

    /// Find what stops each ray.
    fn look(&mut self, tracer: &Tracer) {
        self.beam.clear();
        for ray in &self.rays {
            self.beam.push(ray.origin, ray.direction, ray.length);
        }
        tracer.solid_closest_in(&mut self.beam);
    }
}

/// Fills the layers of the rays of a pixel, one list a ray, empty before.
pub type Cast<'a> = &'a (dyn Fn(&mut Sights) + Sync);

/// Layers that give less than this part of a sample are not looked at.
const LEAST_PART: f32 = 1e-3;

/// [`place`] with rays of one's own (`cast` leaves out what other things, lights, hide from the camera) at the places
/// that `sampling` says.
///
/// # Panics
/// With more than 2³² pixels and parts of pixels.
pub fn place_with(
    scene: &Scene,
    cast: Cast<'_>,
    (camera, frame): (&Camera, Frame),
    sampling: &Sampling,
) -> Receivers {
    let view = View::new(scene, cast, (camera, frame), sampling);
    let rows: Vec<Row> = (0..frame.height)
        .into_par_iter()
        .map(|y| view.row(y, frame.width))
        .collect();
    let mut shares = Vec::new();
    let mut receivers = Receivers {
        origin: scene.origin,
        position: Vec::new(),
        normal: Vec::new(),
        geometric_normal: Vec::new(),
        prim: Vec::new(),
        surface: Vec::new(),
        depth: Vec::new(),
        toward_eye: Vec::new(),
        target: Target::Image {
            width: 0,
            height: 0,
            shares: Vec::new(),
        },
    };
    for (pixel, weight, seen) in rows.into_iter().flatten() {
        let receiver = u32::try_from(receivers.len())
            .expect("pixels and their parts are numbered with 32 bits");
        shares.push(PixelShare {
            pixel,
            receiver,
            weight,
        });
        receivers.position.push(seen.position);
        receivers.normal.push(seen.normal);
        receivers.geometric_normal.push(seen.geometric_normal);
        receivers.prim.push(seen.surface.prim.0);
        receivers.surface.push(seen.surface);
        receivers.depth.push(seen.depth);
        receivers.toward_eye.push(seen.toward_eye);
    }
    receivers.target = Target::Image {
        width: frame.width,
        height: frame.height,
        shares,
    };
    receivers
}

/// [`Sampling`] of `camera`'s image, finer where the shape of a light ends: rays meet it there (`is_lit`) and not beside it.
pub fn finer_at_lights(
    scene: &Scene,
    is_lit: &(dyn Fn(&CameraRay) -> bool + Sync),
    (camera, frame): (&Camera, Frame),
    samples_per_axis: u32,
) -> Sampling {
    let uniform = Sampling::uniform(samples_per_axis);
    let view = View::new(scene, &|_| (), (camera, frame), &uniform);
    let is_lit = |x, y| is_lit(&view.ray(x, y).ray);
    Sampling::finer_at_edges(samples_per_axis, frame, &is_lit)
}

/// Pixel, share of its samples, what is seen there.
type Row = Vec<(u32, f32, Seen)>;

/// A point of a surface as a camera sees it.
#[derive(Debug, Clone, Copy)]
struct Seen {
    position: Vec3,
    normal: Vec3,
    geometric_normal: Vec3,
    surface: SurfacePoint,
    /// Along the viewing axis.
    depth: f32,
    /// Unit.
    toward_eye: Vec3,
    front: bool,
    /// Of its sample, above 0: the rest is of what is before and behind it.
    part: f32,
}

/// The surfaces of a pixel: what its samples see, and how many there are. Lists beyond are kept for the next pixel.
#[derive(Debug, Default)]
struct Clusters {
    lists: Vec<Vec<Seen>>,
    count: usize,
}

impl Clusters {
    fn clear(&mut self) {
        self.count = 0;
    }

    fn all(&self) -> &[Vec<Seen>] {
        &self.lists[..self.count]
    }

    /// Add to the list `index`, or to a new one after the last.
    fn push(&mut self, index: usize, seen: Seen) {
        if index == self.count {
            if self.lists.len() == self.count {
                self.lists.push(Vec::new());
            }
            self.lists[index].clear();
            self.count += 1;
        }
        self.lists[index].push(seen);
    }
}

/// One side of a triangle.
struct Face<'a> {
    prim: PrimId,
    triangle: u32,
    front: bool,
    world: PlacedMesh<'a>,
    /// Unit, of the plane, on this side.
    normal: Vec3,
    /// Its edges from its first corner if all its normals belong to one surface; found out when it is asked for.
    even: OnceCell<Option<[Vec3; 2]>>,
}

/// What tells one [`Face`] from another.
const fn key_of(hit: &Hit) -> (PrimId, u32, bool) {
    (hit.prim, hit.triangle, hit.front)
}

impl<'a> Face<'a> {
    fn of(scene: &'a Scene, hit: &Hit) -> Self {
        let world = PlacedMesh::of(scene, hit.prim);
        let plane = world.mesh.plane_normal(hit.triangle as usize);
        let (prim, triangle, front) = key_of(hit);
        Self {
            prim,
            triangle,
            front,
            world,
            normal: world.normal(plane) * side(front),
            even: OnceCell::new(),
        }
    }

    /// Unit, on this side.
    fn shading_normal(&self, hit: &Hit) -> Vec3 {
        if matches!(self.world.mesh.normals, Normals::Flat) {
            return self.normal;
        }
        let normal = self.world.shading_normal(hit.triangle, hit.u, hit.v);
        normal * side(self.front)
    }
}

const fn side(front: bool) -> f32 {
    if front { 1.0 } else { -1.0 }
}

/// A ray and how the camera measures along it.
struct WorldRay {
    ray: CameraRay,
    /// World units in one unit of camera space.
    scale: f64,
    /// Cosine to the viewing axis.
    axial: f64,
}

/// A camera in a scene.
struct View<'a> {
    scene: &'a Scene,
    cast: Cast<'a>,
    lens: Lens,
    /// Relative to the scene's origin.
    world_from_camera: DAffine3,
    /// True if it keeps lengths.
    is_rigid: bool,
    sampling: &'a Sampling,
}

impl<'a> View<'a> {
    fn new(
        scene: &'a Scene,
        cast: Cast<'a>,
        (camera, frame): (&Camera, Frame),
        sampling: &'a Sampling,
    ) -> Self {
        let axes = camera.world_from_camera.matrix3;
        View {
            scene,
            cast,
            lens: Lens::new(camera, frame),
            is_rigid: (axes.transpose() * axes).abs_diff_eq(DMat3::IDENTITY, RIGID),
            world_from_camera: DAffine3 {
                matrix3: camera.world_from_camera.matrix3,
                translation: camera.world_from_camera.translation - scene.origin,
            },
            sampling,
        }
    }

    /// Rays through all samples of a pixel.
    fn look_through(&self, (x, y): (u32, u32), rays: &mut Vec<WorldRay>, sights: &mut Sights) {
        let n = self.sampling.per_axis(x, y);
        let through = |sample: u32| {
            let [dx, dy] = place_of_sample(sample, n);
            self.ray(f64::from(x) + dx, f64::from(y) + dy)
        };
        rays.clear();
        rays.extend((0..n * n).map(through));
        sights.rays.clear();
        sights.rays.extend(rays.iter().map(|ray| ray.ray));
        sights.layers.iter_mut().for_each(Vec::clear);
        sights.layers.resize_with(rays.len(), Vec::new);
    }

    fn row(&self, y: u32, width: u32) -> Row {
        let mut row = Vec::with_capacity(width as usize);
        let (mut rays, mut sights) = (Vec::new(), Sights::default());
        let (mut clusters, mut face) = (Clusters::default(), None);
        for x in 0..width {
            self.look_through((x, y), &mut rays, &mut sights);
            (self.cast)(&mut sights);
            if let Some(seen) = self.of_one_face(&rays, &sights.layers, &mut face) {
                row.push((y * width + x, 1.0, seen));
                continue;
            }
            self.cluster(&rays, &sights.layers, &mut face, &mut clusters);
            for cluster in clusters.all() {
                let samples = rays.len() as f32;
                let share = cluster.iter().map(|seen| seen.part).sum::<f32>() / samples;
                let merged = self.merge(cluster, cluster.len() as f32 / samples);
                row.push((y * width + x, share, merged));
            }
        }
        row
    }

    /// Sort what the samples of a pixel meet by surface.
    fn cluster(
        &self,
        rays: &[WorldRay],
        layers: &[Vec<Layer>],
        last: &mut Option<Face<'a>>,
        clusters: &mut Clusters,
    ) {
        clusters.clear();
        for (ray, layers) in rays.iter().zip(layers) {
            let mut open = 1.0;
            for layer in layers {
                let part = open * layer.opacity;
                open -= part;
                if part >= LEAST_PART {
                    let face = self.face(last, &layer.hit);
                    self.add(clusters, self.seen(ray, (&layer.hit, face), part));
                }
            }
        }
    }

    /// The ray through image point `(x, y)`, in pixels.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "places and distances, rounded to f32"
    )]
    fn ray(&self, x: f64, y: f64) -> WorldRay {
        let ray = self.lens.ray(x, y);
        let direction = self.world_from_camera.transform_vector3(ray.direction);
        // Scaled cameras measure distances in world units too: USD's cameras should not be scaled, some are.
        let scale = if self.is_rigid {
            1.0
        } else {
            direction.length()
        };
        let origin = self.world_from_camera.transform_point3(ray.origin);
        WorldRay {
            ray: CameraRay {
                origin: origin.as_vec3(),
                direction: (direction / scale).as_vec3(),
                length: (ray.length * scale).min(f64::from(f32::MAX)) as f32,
            },
            scale,
            axial: -ray.direction.z,
        }
    }

    /// The face that is hit; `last` is the one before, which most often is the same.
    fn face<'f>(&self, last: &'f mut Option<Face<'a>>, hit: &Hit) -> &'f Face<'a> {
        let is_same = |face: &Face<'_>| (face.prim, face.triangle, face.front) == key_of(hit);
        if !last.as_ref().is_some_and(is_same) {
            *last = None;
        }
        last.get_or_insert_with(|| Face::of(self.scene, hit))
    }

    /// What `ray` meets at `hit` on `face`, which gives `part` of what is seen.
    #[expect(clippy::cast_possible_truncation, reason = "distances, rounded to f32")]
    fn seen(&self, ray: &WorldRay, (hit, face): (&Hit, &Face<'_>), part: f32) -> Seen {
        let direction = ray.ray.direction;
        let depth = self.depth_in_full(ray, hit);
        let geometric = face.normal;
        let shading = face.shading_normal(hit);
        // A pixel covers its area at that depth × cosine to the axis / cosine to the surface.
        let slant = geometric.dot(-direction).abs() / ray.axial as f32;
        let stretch = slant.max(MOST_STRETCH.powi(-2)).sqrt().recip();
        Seen {
            position: face.world.position(hit.triangle, hit.u, hit.v),
            normal: on_the_side_of(geometric, shading),
            geometric_normal: geometric,
            surface: SurfacePoint::of_hit(hit, self.lens.pixel_size(depth) as f32 * stretch),
            depth: depth as f32,
            toward_eye: -direction,
            front: hit.front,
            part,
        }
    }

    /// From the camera to `hit` along the viewing axis, units of camera space.
    fn depth_in_full(&self, ray: &WorldRay, hit: &Hit) -> f64 {
        self.lens.near_distance() + f64::from(hit.distance) / ray.scale * ray.axial
    }

    #[expect(clippy::cast_possible_truncation, reason = "distances, rounded to f32")]
    fn depth(&self, ray: &WorldRay, hit: &Hit) -> f32 {
        self.depth_in_full(ray, hit) as f32
    }

    /// Put `seen` to the first cluster of the same surface, or into a new one.
    fn add(&self, clusters: &mut Clusters, seen: Seen) {
        let known = (clusters.all().iter())
            .position(|cluster| self.is_same_surface(&cluster[0], &seen))
            .unwrap_or(clusters.count);
        clusters.push(known, seen);
    }

    fn is_same_surface(&self, a: &Seen, b: &Seen) -> bool {
        let off_plane = (b.position - a.position).dot(a.geometric_normal).abs();
        let is_same_material = || {
            a.surface.triangle == b.surface.triangle
                || self.material(&a.surface) == self.material(&b.surface)
        };
        a.surface.prim == b.surface.prim
            && a.front == b.front
            && a.normal.dot(b.normal) > SAME_NORMAL_COSINE
            && off_plane < SAME_PLANE_PIXELS * a.surface.footprint
            && is_same_material()
    }

    fn material(&self, point: &SurfacePoint) -> Option<MaterialId> {
        let prim = &self.scene.prims[point.prim.index()];
        let mesh = self.scene.mesh_of(prim);
        prim.materials
            .of_face(mesh.triangle_faces[point.triangle as usize])
    }

    /// One receiver for a cluster: at the mean of its points if they lie on one triangle, else at the one that is
    /// nearest to the mean (the mean itself would be off the surface); with the mean shading normal. `share`: of the
    /// samples of its pixel.
    fn merge(&self, cluster: &[Seen], share: f32) -> Seen {
        let count = cluster.len() as f32;
        let mean = cluster.iter().map(|seen| seen.position).sum::<Vec3>() / count;
        let distance = |seen: &&Seen| seen.position.distance_squared(mean);
        let nearest = cluster
            .iter()
            .min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let mut merged = *nearest.expect("a cluster has a hit");
        let normal = cluster.iter().map(|seen| seen.normal).sum::<Vec3>();
        merged.normal = on_the_side_of(merged.geometric_normal, normal.normalize_or_zero());
        if cluster
            .iter()
            .all(|seen| seen.surface.triangle == merged.surface.triangle)
        {
            let mean_of = |value: fn(&Seen) -> f32| cluster.iter().map(value).sum::<f32>() / count;
            merged.surface.u = mean_of(|seen| seen.surface.u);
            merged.surface.v = mean_of(|seen| seen.surface.v);
            merged.depth = mean_of(|seen| seen.depth);
            let world = PlacedMesh::of(self.scene, merged.surface.prim);
            merged.position =
                world.position(merged.surface.triangle, merged.surface.u, merged.surface.v);
        }
        merged.surface.footprint *= share.sqrt();
        merged
    }
}

/// Elevation of the automatic camera over the horizon, radians.
const ELEVATION: f64 = 0.4;
/// Its azimuth from the front (+Z when Y is up, −Y when Z is up) to the right, radians.
const AZIMUTH: f64 = 0.6;
/// It stands this much farther than where the bounds touch the frame.
const MARGIN: f64 = 1.05;

/// A camera that shows the whole scene in three-quarter view from above, for stages without one. Of an empty scene
/// it shows the unit box. It stands outside of everything: of a closed room it shows the walls.
pub fn framing_camera(scene: &Scene) -> Camera {
    camera_around(
        scene.bounds(),
        scene.origin,
        scene.stage.up_axis.direction(),
    )
}

/// A camera that sees all of `bounds` (relative to `origin`), from the front and a little above of what stands along
/// `up` (+Y or +Z); path empty.
pub fn camera_around(bounds: Bounds3, origin: DVec3, up: Vec3) -> Camera {
    let (low, high) = if bounds.is_empty() {
        (DVec3::splat(-0.5), DVec3::splat(0.5))
    } else {
        (bounds.min.as_dvec3(), bounds.max.as_dvec3())
    };
    let up = up.as_dvec3();
    let front = if up == DVec3::Y {
        DVec3::Z
    } else {
        DVec3::NEG_Y
    };
    let right = up.cross(front);
    let level = front * AZIMUTH.cos() + right * AZIMUTH.sin();
    let back = level * ELEVATION.cos() + up * ELEVATION.sin();
    let x = up.cross(back).normalize();
    let axes = DMat3::from_cols(x, back.cross(x), back);
    let mut camera = Camera {
        path: String::new(),
        world_from_camera: DAffine3::IDENTITY,
        projection: Projection::Perspective,
        horizontal_aperture: 20.955,
        vertical_aperture: 15.2908,
        horizontal_aperture_offset: 0.0,
        vertical_aperture_offset: 0.0,
        focal_length: 35.0,
        clipping_range: (0.0, f64::INFINITY),
        exposure: 0.0,
    };
    let slopes = 0.5 / camera.focal_length
        * DVec3::new(camera.horizontal_aperture, camera.vertical_aperture, 0.0);
    let center = 0.5 * (low + high);
    let corners = (0..8).map(|corner| {
        let pick = |axis: usize| {
            if corner >> axis & 1 == 0 {
                low[axis]
            } else {
                high[axis]
            }
        };
        axes.transpose() * (DVec3::new(pick(0), pick(1), pick(2)) - center)
    });
    // Farther away than where each corner meets a side of the frame; for a flat or single point, off it at least.
    let reach = corners.clone().map(|c| c.z).fold(0.0, f64::max);
    let fit = |c: DVec3| c.z + (c.x.abs() / slopes.x).max(c.y.abs() / slopes.y);
    let distance = (corners.map(fit).fold(0.0, f64::max) * MARGIN).max(reach * MARGIN);
    let distance = if distance > 0.0 { distance } else { 1.0 };
    camera.world_from_camera =
        DAffine3::from_mat3_translation(axes, origin + center + back * distance);
    // Nothing is clipped that the bounds contain.
    camera.clipping_range = (
        0.5 * (distance - reach).max(0.0),
        2.0 * (distance + (high - low).length()),
    );
    camera
}

#[cfg(test)]
mod tests;
