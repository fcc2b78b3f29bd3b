//! What a camera sees as receivers: one for every distinct surface in a pixel.
//!
//! Every pixel is looked through at fixed, stratified places. Hits on the same prim, side and material, whose normals
//! and planes agree, become one receiver that stands for their share of the samples: light is computed once where
//! pixels are smooth, and separately on both sides of an edge. Where a surface lets light through, a sample is shared between
//! it and what is behind.

use super::Receivers;
use super::lens::{Frame, Lens};
use super::sampling::{Sampling, place_of_sample};
use crate::math::Bounds3;
use crate::results::{PixelShare, Target};
use crate::scene::camera::Projection;
use crate::scene::{Camera, MaterialId, PlacedMesh, Scene, on_the_side_of};
use crate::shading::SurfacePoint;
use crate::trace::{Hit, Layer, Tracer};
use glam::{DAffine3, DMat3, DVec3, Vec3, Vec4};
use rayon::prelude::*;

/// Cosine of the angle (15°) beyond which normals in one pixel are different surfaces.
const SAME_NORMAL_COSINE: f32 = 0.966;

/// Hits farther than this many pixels off the plane of the first are a different surface.
const SAME_PLANE_PIXELS: f32 = 2.0;

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
    let cast = |origin: Vec3, direction: Vec3, length: f32, found: &mut Vec<Layer>| {
        see_through(tracer, (origin, direction), length, found);
    };
    let sampling = Sampling::uniform(samples_per_axis);
    place_with(scene, &cast, (camera, frame), &sampling)
}

/// Appends what is met along a ray from an origin (relative to the scene's) in a unit direction within a length, in order, up
/// to the first that nothing passes through.
pub type Cast<'a> = &'a (dyn Fn(Vec3, Vec3, f32, &mut Vec<Layer>) + Sync);

/// Fills `found` with all that a ray from an origin in a unit direction meets within `length`, up to the first surface that
/// nothing passes through. Returns the part of what is beyond that is seen, 0…1.
pub fn see_through(
    tracer: &Tracer,
    (origin, direction): (Vec3, Vec3),
    length: f32,
    found: &mut Vec<Layer>,
) -> f32 {
    let solid = tracer.solid_closest(origin, direction, length);
    let end = solid.map_or(length, |hit| hit.distance);
    let open = tracer.layers((origin, direction), end, found);
    let Some(hit) = solid.filter(|_| open > 0.0) else {
        return open;
    };
    found.push(Layer { hit, opacity: 1.0 });
    0.0
}

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

/// Color and coverage along a ray from an origin in a unit direction within a length.
pub type Glow<'a> = &'a (dyn Fn(Vec3, Vec3, f32) -> Vec4 + Sync);

/// What `camera` sees besides surfaces, a pixel each, rows from the top: the mean of `glow` over the samples of
/// [`place_with`].
pub fn backdrop(
    scene: &Scene,
    glow: Glow<'_>,
    (camera, frame): (&Camera, Frame),
    sampling: &Sampling,
) -> Vec<Vec4> {
    let nothing = |_: Vec3, _: Vec3, _: f32, _: &mut Vec<Layer>| {};
    let view = View::new(scene, &nothing, (camera, frame), sampling);
    let pixel = |x: u32, y: u32| {
        let n = sampling.per_axis(x, y);
        let sum: Vec4 = (0..n * n)
            .map(|sample| {
                let [dx, dy] = place_of_sample(sample, n);
                let ray = view.ray(f64::from(x) + dx, f64::from(y) + dy);
                glow(ray.origin, ray.direction, ray.length)
            })
            .sum();
        sum / (n * n) as f32
    };
    (0..frame.height)
        .into_par_iter()
        .flat_map_iter(|y| (0..frame.width).map(move |x| (x, y)))
        .map(|(x, y)| pixel(x, y))
        .collect()
}

/// [`Sampling`] of `camera`'s image, finer where the shape of a light ends: `glow` covers there and not beside it.
pub fn finer_at_lights(
    scene: &Scene,
    glow: Glow<'_>,
    (camera, frame): (&Camera, Frame),
    samples_per_axis: u32,
) -> Sampling {
    let nothing = |_: Vec3, _: Vec3, _: f32, _: &mut Vec<Layer>| {};
    let uniform = Sampling::uniform(samples_per_axis);
    let view = View::new(scene, &nothing, (camera, frame), &uniform);
    let is_lit = |x, y| {
        let ray = view.ray(x, y);
        glow(ray.origin, ray.direction, ray.length).w > 0.0
    };
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

/// A camera ray relative to the scene's origin.
struct WorldRay {
    /// On the near clipping plane.
    origin: Vec3,
    /// Unit.
    direction: Vec3,
    /// To the far clipping plane.
    length: f32,
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
    sampling: &'a Sampling,
}

impl<'a> View<'a> {
    fn new(
        scene: &'a Scene,
        cast: Cast<'a>,
        (camera, frame): (&Camera, Frame),
        sampling: &'a Sampling,
    ) -> Self {
        View {
            scene,
            cast,
            lens: Lens::new(camera, frame),
            world_from_camera: DAffine3 {
                matrix3: camera.world_from_camera.matrix3,
                translation: camera.world_from_camera.translation - scene.origin,
            },
            sampling,
        }
    }

    fn row(&self, y: u32, width: u32) -> Row {
        let mut row = Vec::with_capacity(width as usize);
        let (mut clusters, mut found) = (Vec::new(), Vec::new());
        for x in 0..width {
            clusters.clear();
            let n = self.sampling.per_axis(x, y);
            for sample in 0..n * n {
                let [dx, dy] = place_of_sample(sample, n);
                let ray = self.ray(f64::from(x) + dx, f64::from(y) + dy);
                found.clear();
                (self.cast)(ray.origin, ray.direction, ray.length, &mut found);
                let mut open = 1.0;
                for layer in &found {
                    let part = open * layer.opacity;
                    open -= part;
                    if part >= LEAST_PART {
                        self.add(&mut clusters, self.seen(&ray, &layer.hit, part));
                    }
                }
            }
            for cluster in &clusters {
                let samples = (n * n) as f32;
                let share = cluster.iter().map(|seen| seen.part).sum::<f32>() / samples;
                let merged = self.merge(cluster, cluster.len() as f32 / samples);
                row.push((y * width + x, share, merged));
            }
        }
        row
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
        let scale = direction.length();
        WorldRay {
            origin: self
                .world_from_camera
                .transform_point3(ray.origin)
                .as_vec3(),
            direction: (direction / scale).as_vec3(),
            length: (ray.length * scale).min(f64::from(f32::MAX)) as f32,
            scale,
            axial: -ray.direction.z,
        }
    }

    /// What `ray` meets at `hit`, which gives `part` of what is seen.
    #[expect(clippy::cast_possible_truncation, reason = "distances, rounded to f32")]
    fn seen(&self, ray: &WorldRay, hit: &Hit, part: f32) -> Seen {
        let (direction, scale) = (ray.direction, ray.scale);
        let along = f64::from(hit.distance) / scale * ray.axial;
        let depth = self.lens.near_distance() + along;
        let world = PlacedMesh::of(self.scene, hit.prim);
        let t = hit.triangle;
        let side = if hit.front { 1.0 } else { -1.0 };
        let geometric = world.normal(world.mesh.plane_normal(t as usize)) * side;
        let shading = world.shading_normal(t, hit.u, hit.v) * side;
        // A pixel covers its area at that depth × cosine to the axis / cosine to the surface.
        let slant = geometric.dot(-direction).abs() / ray.axial as f32;
        let stretch = slant.max(MOST_STRETCH.powi(-2)).sqrt().recip();
        Seen {
            position: world.position(t, hit.u, hit.v),
            normal: on_the_side_of(geometric, shading),
            geometric_normal: geometric,
            surface: SurfacePoint {
                prim: hit.prim,
                triangle: hit.triangle,
                u: hit.u,
                v: hit.v,
                footprint: self.lens.pixel_size(depth) as f32 * stretch,
            },
            depth: depth as f32,
            toward_eye: -direction,
            front: hit.front,
            part,
        }
    }

    /// Put `seen` to the first cluster of the same surface, or into a new one.
    fn add(&self, clusters: &mut Vec<Vec<Seen>>, seen: Seen) {
        match clusters
            .iter_mut()
            .find(|cluster| self.is_same_surface(&cluster[0], &seen))
        {
            Some(cluster) => cluster.push(seen),
            None => clusters.push(vec![seen]),
        }
    }

    fn is_same_surface(&self, a: &Seen, b: &Seen) -> bool {
        let off_plane = (b.position - a.position).dot(a.geometric_normal).abs();
        a.surface.prim == b.surface.prim
            && a.front == b.front
            && a.normal.dot(b.normal) > SAME_NORMAL_COSINE
            && off_plane < SAME_PLANE_PIXELS * a.surface.footprint
            && self.material(&a.surface) == self.material(&b.surface)
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
