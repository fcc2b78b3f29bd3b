//! Where rays read the radiance of what they hit: the surfels. Shading is never evaluated at a hit.

use crate::surfels::{DiceMap, NearestMap, SurfelCloud};
use crate::trace::Hit;
use glam::{DVec3, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Radiance that leaves a surface towards one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outgoing {
    /// Reflected radiance.
    pub reflected: Vec3,
    /// Emitted radiance.
    pub emitted: Vec3,
}

impl Outgoing {
    /// No light, the radiance of sides that have no surfel.
    pub const BLACK: Self = Self {
        reflected: Vec3::ZERO,
        emitted: Vec3::ZERO,
    };

    /// Of surfel `i`, a diffuse one: radiosity / π, the same in all directions.
    fn of_surfel(cloud: &SurfelCloud, i: u32) -> Self {
        let i = i as usize;
        Self {
            reflected: cloud.reflected(i) * FRAC_1_PI,
            emitted: cloud.emission[i] * FRAC_1_PI,
        }
    }
}

/// A cloud from a file, indexed by place.
#[derive(Debug, Clone)]
pub struct LoadedCloud<'a> {
    cloud: &'a SurfelCloud,
    map: NearestMap,
    /// From positions relative to the scene's origin to those relative to the cloud's.
    shift: Vec3,
}

impl<'a> LoadedCloud<'a> {
    /// Index `cloud` for rays whose positions are relative to `scene_origin` (world space).
    pub fn new(cloud: &'a SurfelCloud, scene_origin: DVec3) -> Self {
        Self {
            cloud,
            map: NearestMap::new(cloud),
            shift: (scene_origin - cloud.origin).as_vec3(),
        }
    }
}

/// Surfels that rays read radiance from.
#[derive(Debug, Clone)]
pub enum RadianceSource<'a> {
    /// The cloud diced from the very scene that rays are traced in: found by triangle.
    Baked {
        /// The surfels.
        cloud: &'a SurfelCloud,
        /// Which of them covers which part of a triangle.
        dice: &'a DiceMap,
    },
    /// Clouds from elsewhere, found by place; their light adds up (light groups).
    Loaded(Vec<LoadedCloud<'a>>),
}

impl RadianceSource<'_> {
    /// Radiance from `hit` back to `origin`, from which the unit `direction` met it; black on a side without surfels.
    pub fn radiance(&self, hit: &Hit, origin: Vec3, direction: Vec3) -> Outgoing {
        match self {
            Self::Baked { cloud, dice } => dice
                .surfel_at(hit.prim.0, hit.triangle, hit.u, hit.v, hit.front)
                .map_or(Outgoing::BLACK, |i| Outgoing::of_surfel(cloud, i)),
            Self::Loaded(clouds) => {
                let position = origin + direction * hit.distance;
                clouds.iter().fold(Outgoing::BLACK, |sum, loaded| {
                    // Facing the ray is what tells the two sides of a surface apart.
                    let found =
                        loaded
                            .map
                            .surfel_at(loaded.cloud, position + loaded.shift, -direction);
                    let more =
                        found.map_or(Outgoing::BLACK, |i| Outgoing::of_surfel(loaded.cloud, i));
                    Outgoing {
                        reflected: sum.reflected + more.reflected,
                        emitted: sum.emitted + more.emitted,
                    }
                })
            }
        }
    }
}
