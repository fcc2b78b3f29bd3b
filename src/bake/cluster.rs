//! A cluster of small triangles as one surfel.
//!
//! Area and normal are those of all its triangles. It stands, and is lit, at the centroid of the triangle that is
//! nearest to the middle of all: a point on the surface. What is averaged over it is taken at some of its triangles,
//! each for the run of triangles around it.

use super::light::{Look, Side, plane_normal};
use crate::lighting::ShadePoint;
use crate::scene::{FaceMaterials, PlacedMesh};
use crate::shading::{Surface, SurfacePoint};
use glam::{DVec3, Vec3};

/// Triangles of a cluster at which the surface is evaluated; all of them where materials differ by face.
const SURFACE_SAMPLES: usize = 16;

/// Triangles of a cluster at which light is evaluated where it is steep.
const LIGHT_SAMPLES: usize = 8;

/// Weights of the corners at a triangle's middle.
const MIDDLE: Vec3 = Vec3::splat(1.0 / 3.0);

/// Shape of a cluster, world space, front side.
pub(super) struct Cluster<'a> {
    world: &'a PlacedMesh<'a>,
    members: &'a [u32],
    /// The triangle at whose middle the surfel stands.
    pub(super) central: u32,
    pub(super) area: f64,
    /// Unit, weighted by area.
    pub(super) normal: Vec3,
}

impl<'a> Cluster<'a> {
    pub(super) fn new(world: &'a PlacedMesh<'a>, members: &'a [u32]) -> Self {
        let (mut area, mut normal, mut moment) = (0.0, DVec3::ZERO, DVec3::ZERO);
        for &t in members {
            let cross = world.front_cross(t);
            let size = 0.5 * cross.length();
            area += size;
            normal += cross;
            moment += size * middle(world, t).as_dvec3();
        }
        let mean = (moment / area.max(f64::MIN_POSITIVE)).as_vec3();
        let distance = |t: u32| middle(world, t).distance_squared(mean);
        let nearest = members
            .iter()
            .min_by(|a, b| distance(**a).total_cmp(&distance(**b)));
        let central = *nearest.expect("a cluster has triangles");
        let normal = normal.try_normalize().map(|normal| normal.as_vec3());
        Self {
            normal: normal.unwrap_or_else(|| plane_normal(world, central)),
            world,
            members,
            central,
            area,
        }
    }

    /// Distance from `position` to the farthest corner.
    pub(super) fn reach(&self, position: Vec3) -> f32 {
        let corners = self.members.iter().flat_map(|t| self.world.corners(*t));
        corners
            .map(|corner| corner.distance_squared(position))
            .fold(0.0, f32::max)
            .sqrt()
    }

    /// Albedo, emission and where light is to be evaluated: at the central triangle, with the mean shading normal.
    pub(super) fn shade(
        &self,
        look: &Look<'_>,
        side: &Side<'_>,
        materials: &FaceMaterials,
    ) -> (ShadePoint, Surface) {
        let most = match materials {
            FaceMaterials::Whole(_) => SURFACE_SAMPLES,
            FaceMaterials::PerFace(_) => self.members.len(),
        };
        let mut mean = Surface {
            albedo: Vec3::ZERO,
            emission: Vec3::ZERO,
            opacity: 0.0,
        };
        let mut normal = Vec3::ZERO;
        for (t, share, footprint) in samples(self.world, self.members, most) {
            let surface = (look.surface)(&SurfacePoint {
                prim: side.prim,
                triangle: t,
                u: MIDDLE.y,
                v: MIDDLE.z,
                footprint,
            });
            let covered = share * surface.opacity;
            mean.albedo += covered * surface.albedo;
            mean.emission += covered * surface.emission;
            mean.opacity += covered;
            normal += share * side.middle(t).normal;
        }
        if mean.opacity > 0.0 {
            mean.albedo /= mean.opacity;
            mean.emission /= mean.opacity;
        }
        let mut point = side.middle(self.central);
        let normal = normal.normalize_or(point.normal);
        if normal.dot(point.geometric_normal) > 0.0 {
            point.normal = normal;
        }
        (point, mean)
    }
}

/// Irradiance of `look.lights` on one side of a cluster, the mean over some of its triangles.
pub(super) fn mean_light(look: &Look<'_>, side: &Side<'_>, members: &[u32]) -> Vec3 {
    samples(side.world, members, LIGHT_SAMPLES)
        .map(|(t, share, _)| share * (look.lights)(&side.middle(t)))
        .sum()
}

fn middle(world: &PlacedMesh<'_>, t: u32) -> Vec3 {
    let [a, b, c] = world.corners(t);
    (a + b + c) / 3.0
}

/// At most `most` triangles that stand for runs of `members`, with their shares of the area (together 1) and the edge
/// length of a square of their run's area.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a share and a length, rounded to f32"
)]
fn samples<'a>(
    world: &'a PlacedMesh<'a>,
    members: &'a [u32],
    most: usize,
) -> impl Iterator<Item = (u32, f32, f32)> + 'a {
    // Instances may be so much flatter than the one the table was made for that rounding leaves no area.
    let area_of = |run: &[u32]| {
        let area: f64 = run.iter().map(|t| world.area(*t)).sum();
        area.max(f64::MIN_POSITIVE)
    };
    let length = members.len().div_ceil(most.max(1)).max(1);
    let all: f64 = members.chunks(length).map(area_of).sum();
    members.chunks(length).map(move |run| {
        let area = area_of(run);
        (run[run.len() / 2], (area / all) as f32, area.sqrt() as f32)
    })
}
