//! What a camera sees as receivers: one for every distinct surface in a pixel.
//!
//! Every pixel is looked through at fixed, stratified places. Hits on the same prim, side and material, whose normals
//! and planes agree, become one receiver that stands for their share of the samples: light is computed once where
//! pixels are smooth, and separately on both sides of an edge.

use super::Receivers;
use super::lens::{Frame, Lens};
use crate::results::{PixelShare, Target};
use crate::scene::camera::Projection;
use crate::scene::{Camera, MaterialId, PlacedMesh, Scene, on_the_side_of};
use crate::shading::SurfacePoint;
use crate::trace::{Hit, Tracer};
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
    let cast = |origin, direction, length| tracer.closest(origin, direction, length);
    place_with(scene, &cast, camera, frame, samples_per_axis)
}

/// First hit along a ray from an origin (relative to the scene's) in a unit direction within a length.
pub type Cast<'a> = &'a (dyn Fn(Vec3, Vec3, f32) -> Option<Hit> + Sync);

/// [`place`] with rays of one's own: `cast` leaves out what other things (lights) hide from the camera.
///
/// # Panics
/// With more than 2³² pixels and parts of pixels.
pub fn place_with(
    scene: &Scene,
    cast: Cast<'_>,
    camera: &Camera,
    frame: Frame,
    samples_per_axis: u32,
) -> Receivers {
    let view = View::new(scene, cast, camera, frame, samples_per_axis);
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
/// [`place`].
pub fn backdrop(
    scene: &Scene,
    glow: Glow<'_>,
    camera: &Camera,
    frame: Frame,
    samples_per_axis: u32,
) -> Vec<Vec4> {
    let nothing = |_, _, _| None;
    let view = View::new(scene, &nothing, camera, frame, samples_per_axis);
    let count = view.samples * view.samples;
    let pixel = |x: u32, y: u32| {
        let sum: Vec4 = (0..count)
            .map(|sample| {
                let [dx, dy] = place_of_sample(sample, view.samples);
                let ray = view.ray(f64::from(x) + dx, f64::from(y) + dy);
                glow(ray.origin, ray.direction, ray.length)
            })
            .sum();
        sum / count as f32
    };
    (0..frame.height)
        .into_par_iter()
        .flat_map_iter(|y| (0..frame.width).map(move |x| (x, y)))
        .map(|(x, y)| pixel(x, y))
        .collect()
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
    front: bool,
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
    samples: u32,
}

impl<'a> View<'a> {
    fn new(
        scene: &'a Scene,
        cast: Cast<'a>,
        camera: &Camera,
        frame: Frame,
        samples_per_axis: u32,
    ) -> Self {
        View {
            scene,
            cast,
            lens: Lens::new(camera, frame),
            world_from_camera: DAffine3 {
                matrix3: camera.world_from_camera.matrix3,
                translation: camera.world_from_camera.translation - scene.origin,
            },
            samples: samples_per_axis.max(1),
        }
    }

    fn row(&self, y: u32, width: u32) -> Row {
        let mut row = Vec::with_capacity(width as usize);
        let mut clusters = Vec::new();
        for x in 0..width {
            clusters.clear();
            for sample in 0..self.samples * self.samples {
                let [dx, dy] = place_of_sample(sample, self.samples);
                if let Some(seen) = self.look(f64::from(x) + dx, f64::from(y) + dy) {
                    self.add(&mut clusters, seen);
                }
            }
            let share = 1.0 / (self.samples * self.samples) as f32;
            for cluster in &clusters {
                row.push((
                    y * width + x,
                    share * cluster.len() as f32,
                    self.merge(cluster),
                ));
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

    /// What is seen through image point `(x, y)`, in pixels.
    #[expect(clippy::cast_possible_truncation, reason = "distances, rounded to f32")]
    fn look(&self, x: f64, y: f64) -> Option<Seen> {
        let ray = self.ray(x, y);
        let (direction, scale) = (ray.direction, ray.scale);
        let hit = (self.cast)(ray.origin, direction, ray.length)?;
        let along = f64::from(hit.distance) / scale * ray.axial;
        let depth = self.lens.near() + along;
        let world = PlacedMesh::of(self.scene, hit.prim);
        let t = hit.triangle;
        let side = if hit.front { 1.0 } else { -1.0 };
        let geometric = world.normal(world.mesh.plane_normal(t as usize)) * side;
        let shading = world.shading_normal(t, hit.u, hit.v) * side;
        // A pixel covers its area at that depth × cosine to the axis / cosine to the surface.
        let slant = geometric.dot(-direction).abs() / ray.axial as f32;
        let stretch = slant.max(MOST_STRETCH.powi(-2)).sqrt().recip();
        Some(Seen {
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
            front: hit.front,
        })
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
    /// nearest to the mean (the mean itself would be off the surface); with the mean shading normal.
    fn merge(&self, cluster: &[Seen]) -> Seen {
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
        merged.surface.footprint *= (count / (self.samples * self.samples) as f32).sqrt();
        merged
    }
}

/// Where sample `index` of `n`² looks through its pixel, 0…1: in every cell of an `n` × `n` grid once, and in every
/// of `n`² columns and rows once, so that edges near an axis are resolved `n` times finer than by a plain grid.
fn place_of_sample(index: u32, n: u32) -> [f64; 2] {
    let (i, j, n) = (f64::from(index % n), f64::from(index / n), f64::from(n));
    [(i + (j + 0.5) / n) / n, (j + (i + 0.5) / n) / n]
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
    let bounds = scene.bounds();
    let (low, high) = if bounds.is_empty() {
        (DVec3::splat(-0.5), DVec3::splat(0.5))
    } else {
        (bounds.min.as_dvec3(), bounds.max.as_dvec3())
    };
    let up = scene.stage.up_axis.direction().as_dvec3();
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
        DAffine3::from_mat3_translation(axes, scene.origin + center + back * distance);
    // Nothing is clipped that the bounds contain.
    camera.clipping_range = (
        0.5 * (distance - reach).max(0.0),
        2.0 * (distance + (high - low).length()),
    );
    camera
}

#[cfg(test)]
mod tests {
    use super::super::lens::tests::camera as turned_camera;
    use super::super::testing::scene_of;
    use super::*;
    use crate::scene::{Mesh, Normals, PrimId};
    use glam::Affine3A;

    /// A quadrangle from corner `a` along `u` and `v`, facing `u × v`.
    fn quad(a: Vec3, u: Vec3, v: Vec3) -> Mesh {
        Mesh {
            positions: vec![a, a + u, a + u + v, a + v],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            triangle_faces: vec![0, 0],
            normals: Normals::Flat,
            primvars: vec![],
            double_sided: false,
            closed: false,
            cage: None,
            scheme: "none".into(),
        }
    }

    /// First hit by trying all triangles, in f64.
    #[expect(clippy::cast_possible_truncation, reason = "rounded to f32")]
    fn cast(scene: &Scene, origin: Vec3, direction: Vec3, length: f32) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        for (id, prim) in (0..).zip(&scene.prims) {
            let mesh = scene.mesh_of(prim);
            for (t, _) in (0..).zip(&mesh.triangles) {
                let [a, b, c] = mesh
                    .corners(t as usize)
                    .map(|p| prim.world_from_object.transform_point3(p).as_dvec3());
                let (u_axis, v_axis, d) = (b - a, c - a, direction.as_dvec3());
                let normal = u_axis.cross(v_axis);
                let (offset, facing) = (origin.as_dvec3() - a, -d.dot(normal));
                let distance = offset.dot(normal) / facing;
                let q = offset + d * distance;
                let area = normal.length_squared();
                let (u, v) = (
                    q.cross(v_axis).dot(normal) / area,
                    u_axis.cross(q).dot(normal) / area,
                );
                let limit = best.map_or(f64::from(length), |hit| f64::from(hit.distance));
                if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > 0.0 && distance < limit {
                    best = Some(Hit {
                        distance: distance as f32,
                        prim: PrimId(id),
                        triangle: t,
                        u: u as f32,
                        v: v as f32,
                        front: facing > 0.0,
                    });
                }
            }
        }
        best
    }

    fn look(scene: &Scene, camera: &Camera, frame: Frame, samples: u32) -> Receivers {
        let cast = |origin, direction, length| cast(scene, origin, direction, length);
        place_with(scene, &cast, camera, frame, samples)
    }

    fn shares(receivers: &Receivers) -> &[PixelShare] {
        match &receivers.target {
            Target::Image { shares, .. } => shares,
            other => panic!("{other:?}"),
        }
    }

    /// At (0, 0, 5) looking along −Z; the window at distance 5 is 4 × 2 units.
    fn simple_camera() -> Camera {
        Camera {
            world_from_camera: DAffine3::from_translation(DVec3::Z * 5.0),
            horizontal_aperture: 40.0,
            vertical_aperture: 20.0,
            horizontal_aperture_offset: 0.0,
            vertical_aperture_offset: 0.0,
            focal_length: 50.0,
            clipping_range: (1.0, 100.0),
            ..turned_camera(Projection::Perspective)
        }
    }

    fn wall(half_width: f32) -> Mesh {
        quad(
            Vec3::new(-half_width, -1.5, 0.0),
            Vec3::X * 2.0 * half_width,
            Vec3::Y * 3.0,
        )
    }

    #[test]
    fn pixel_centers_fall_where_the_window_says() {
        let scene = scene_of(vec![(wall(2.5), Affine3A::IDENTITY)]);
        for samples in [1, 3] {
            let receivers = look(&scene, &simple_camera(), Frame::new(40, 20), samples);
            // One receiver a pixel, but two where the diagonal of the quadrangle is not crossed at the mean.
            assert_eq!(receivers.len(), 800);
            for share in shares(&receivers) {
                let (x, y) = (share.pixel % 40, share.pixel / 40);
                let center = Vec3::new(
                    -2.0 + (x as f32 + 0.5) / 10.0,
                    1.0 - (y as f32 + 0.5) / 10.0,
                    0.0,
                );
                let receiver = share.receiver as usize;
                // A third of a pixel: the representative hit where a pixel spans both triangles.
                let tolerance = if samples == 1 { 1e-5 } else { 0.034 };
                assert!(receivers.position[receiver].distance(center) < tolerance);
                assert!((receivers.depth[receiver] - 5.0).abs() < 1e-5);
                assert_eq!(receivers.normal[receiver], Vec3::Z);
                assert!((share.weight - 1.0).abs() < 1e-6);
                // A pixel is 0.1 × 0.1 units.
                assert!((receivers.surface[receiver].footprint - 0.1).abs() < 2e-3);
            }
        }
    }

    #[test]
    fn shares_sum_to_the_exact_coverage_of_an_edge() {
        // The wall ends at x = 0.133…: pixel 21 of 40 is covered for a third.
        let mut wall = wall(1.0);
        wall.positions[1].x = 2.0 / 15.0;
        wall.positions[2].x = 2.0 / 15.0;
        let scene = scene_of(vec![(wall, Affine3A::IDENTITY)]);
        let receivers = look(&scene, &simple_camera(), Frame::new(40, 20), 4);
        let coverage = |pixel: u32| {
            shares(&receivers)
                .iter()
                .filter(|s| s.pixel == pixel)
                .map(|s| s.weight)
                .sum::<f32>()
        };
        assert_eq!(coverage(10 * 40 + 20), 1.0);
        // 16 distinct columns: to 1/32.
        assert!((coverage(10 * 40 + 21) - 1.0 / 3.0).abs() <= 1.0 / 32.0 + 1e-6);
        assert_eq!(coverage(10 * 40 + 22), 0.0);
    }

    #[test]
    fn a_fold_and_a_step_in_one_pixel_are_receivers_of_their_own() {
        let floor = quad(Vec3::new(-9.0, 0.0, 0.0), Vec3::Z * 4.0, Vec3::X * 18.0);
        let back = quad(Vec3::new(-9.0, 0.0, 0.0), Vec3::X * 18.0, Vec3::Y * 9.0);
        let camera = Camera {
            world_from_camera: DAffine3::from_translation(DVec3::new(0.0, 1.0, 5.0)),
            ..simple_camera()
        };
        let scene = scene_of(vec![
            (floor, Affine3A::IDENTITY),
            (back, Affine3A::IDENTITY),
        ]);
        // One pixel: sees the fold through its lower half.
        let receivers = look(
            &scene,
            &camera,
            Frame {
                pixel_aspect_ratio: 1.0,
                ..Frame::new(1, 1)
            },
            8,
        );
        assert_eq!(receivers.len(), 2);
        assert_eq!(receivers.prim.iter().sum::<u32>(), 1);
        assert!(receivers.normal.contains(&Vec3::Y) && receivers.normal.contains(&Vec3::Z));
        // Two parallel walls, one far behind the other's edge.
        let step = scene_of(vec![
            (
                quad(Vec3::new(-9.0, -9.0, 0.0), Vec3::X * 9.0, Vec3::Y * 18.0),
                Affine3A::IDENTITY,
            ),
            (
                wall(50.0),
                Affine3A::from_scale_rotation_translation(
                    Vec3::splat(30.0),
                    glam::Quat::IDENTITY,
                    Vec3::Z * -60.0,
                ),
            ),
        ]);
        let receivers = look(&step, &simple_camera(), Frame::new(1, 1), 4);
        assert_eq!(receivers.len(), 2);
        assert!(
            shares(&receivers)
                .iter()
                .all(|share| (share.weight - 0.5).abs() < 0.13)
        );
    }

    #[test]
    fn backs_are_lit_on_the_side_that_is_seen_and_clipping_is_honored() {
        let away = quad(Vec3::new(-2.5, -1.5, 0.0), Vec3::Y * 3.0, Vec3::X * 5.0);
        let scene = scene_of(vec![(away, Affine3A::IDENTITY)]);
        let receivers = look(&scene, &simple_camera(), Frame::new(4, 2), 2);
        assert_eq!(receivers.len(), 8);
        assert!(
            receivers
                .normal
                .iter()
                .chain(&receivers.geometric_normal)
                .all(|n| *n == Vec3::Z)
        );
        for clipping_range in [(5.01, 100.0), (1.0, 4.99)] {
            let clipped = Camera {
                clipping_range,
                ..simple_camera()
            };
            assert!(look(&scene, &clipped, Frame::new(4, 2), 2).is_empty());
        }
    }

    #[test]
    fn scenes_far_from_the_origin_are_seen_like_near_ones() {
        let near = scene_of(vec![(wall(2.5), Affine3A::IDENTITY)]);
        let shift = DVec3::splat(1e7);
        let far = Scene {
            origin: shift,
            ..scene_of(vec![(wall(2.5), Affine3A::IDENTITY)])
        };
        let moved = Camera {
            world_from_camera: DAffine3::from_translation(shift + DVec3::Z * 5.0),
            ..simple_camera()
        };
        let (a, b) = (
            look(&near, &simple_camera(), Frame::new(8, 4), 2),
            look(&far, &moved, Frame::new(8, 4), 2),
        );
        assert_eq!(a.position, b.position);
        assert_eq!(b.origin, shift);
    }

    #[test]
    fn the_automatic_camera_sees_every_corner_and_fills_the_frame() {
        for up_axis in [crate::scene::UpAxis::Y, crate::scene::UpAxis::Z] {
            let mut scene = scene_of(vec![(
                quad(
                    Vec3::new(3.0, -1.0, 2.0),
                    Vec3::X * 4.0,
                    Vec3::new(0.0, 1.0, 7.0),
                ),
                Affine3A::IDENTITY,
            )]);
            scene.stage.up_axis = up_axis;
            scene.origin = DVec3::new(1e6, 0.0, 0.0);
            let camera = framing_camera(&scene);
            let lens = Lens::new(&camera, Frame::new(13_704, 10_000));
            let bounds = scene.bounds();
            let mut reach = 0.0_f64;
            for corner in 0..8 {
                let pick = |axis: usize| {
                    if corner >> axis & 1 == 0 {
                        bounds.min[axis]
                    } else {
                        bounds.max[axis]
                    }
                };
                let point = Vec3::new(pick(0), pick(1), pick(2)).as_dvec3() + scene.origin;
                let clip = lens.world_to_ndc() * point.extend(1.0);
                let ndc = clip.truncate() / clip.w;
                assert!(clip.w > camera.clipping_range.0 && clip.w < camera.clipping_range.1);
                reach = reach.max((ndc.x - 0.5).abs()).max((ndc.y - 0.5).abs());
            }
            assert!((0.45..0.5).contains(&reach), "{reach}");
            // Upright: the up axis points up in the image.
            let up = camera.world_from_camera.matrix3.transpose() * up_axis.direction().as_dvec3();
            assert!(up.y > 0.5 && up.x.abs() < 1e-12);
        }
        assert!(
            framing_camera(&scene_of(vec![]))
                .world_from_camera
                .is_finite()
        );
    }

    #[test]
    fn samples_of_a_pixel_lie_in_distinct_columns_and_rows() {
        for n in 1..6 {
            for axis in 0..2 {
                let mut columns: Vec<_> = (0..n * n)
                    .map(|i| (place_of_sample(i, n)[axis] * f64::from(n * n)).floor())
                    .collect();
                columns.sort_unstable_by(f64::total_cmp);
                assert_eq!(columns, (0..n * n).map(f64::from).collect::<Vec<_>>());
            }
        }
        assert_eq!(place_of_sample(0, 1), [0.5, 0.5]);
    }
}
