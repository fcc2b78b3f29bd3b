//! Where rays read the radiance of what they hit: the surfels, or the light found anew at hits too near for these.

use super::at_hits::HitLight;
use crate::math::sequence;
use crate::receivers::Receivers;
use crate::surfels::{DiceMap, NearestMap, SurfelCloud};
use crate::trace::{Hit, Tracer};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::sync::Arc;

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

    /// This and `other` together.
    pub(super) fn plus(self, other: Self) -> Self {
        Self {
            reflected: self.reflected + other.reflected,
            emitted: self.emitted + other.emitted,
        }
    }

    /// The part `share` of it.
    pub(super) fn times(self, share: f32) -> Self {
        Self {
            reflected: self.reflected * share,
            emitted: self.emitted * share,
        }
    }

    fn less(self, other: Self) -> Self {
        Self {
            reflected: self.reflected - other.reflected,
            emitted: self.emitted - other.emitted,
        }
    }

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

/// What a hit reads of a surfel, side by side in memory: hits come in no order.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(16))]
struct Shine {
    /// Radiance.
    reflected: Vec3,
    radius: f32,
}

/// The surfels diced from the very scene that rays are traced in: found by triangle.
#[derive(Debug, Clone)]
pub struct DicedSurfels<'a> {
    shine: Arc<[Shine]>,
    /// Of the cloud, if any is not zero.
    emission: Option<&'a [Vec3]>,
    dice: &'a DiceMap,
    near: Option<HitLight<'a>>,
}

impl<'a> DicedSurfels<'a> {
    /// The surfels of `cloud`, of which `dice` tells which one covers which part of a triangle. `near` lights hits too near
    /// for surfels; `None`: surfels tell it all. It knows no bounces. Copies 16 bytes a surfel.
    pub fn new(cloud: &'a SurfelCloud, dice: &'a DiceMap, near: Option<HitLight<'a>>) -> Self {
        let shine = |i: usize| Shine {
            reflected: cloud.reflected(i) * FRAC_1_PI,
            radius: cloud.radius[i],
        };
        let emits = cloud.emission.par_iter().any(|&light| light != Vec3::ZERO);
        Self {
            shine: (0..cloud.len()).into_par_iter().map(shine).collect(),
            emission: emits.then_some(&cloud.emission),
            dice,
            near,
        }
    }

    /// Which of them covers which part of a triangle.
    pub(super) fn dice(&self) -> &'a DiceMap {
        self.dice
    }

    /// What lights hits too near for surfels.
    pub fn near(&self) -> Option<HitLight<'a>> {
        self.near
    }

    /// The place of the surfel that `hit` met, and that surfel.
    fn found(&self, hit: &Hit) -> Option<(usize, Shine)> {
        let i = surfel_of(self.dice, hit)? as usize;
        Some((i, self.shine[i]))
    }

    /// What lights `hit` anew, where it is too near to its surfel.
    fn anew(&self, hit: &Hit, surfel: Shine) -> Option<&HitLight<'a>> {
        (self.near.as_ref()).filter(|hits| hits.is_near(hit, surfel.radius))
    }

    fn radiance(&self, hit: &Hit) -> Outgoing {
        let Some((i, surfel)) = self.found(hit) else {
            return Outgoing::BLACK;
        };
        let anew = self.anew(hit, surfel).map(|hits| hits.reflected(hit));
        Outgoing {
            reflected: anew.unwrap_or(surfel.reflected),
            emitted: self
                .emission
                .map_or(Vec3::ZERO, |emission| emission[i] * FRAC_1_PI),
        }
    }
}

/// Surfels that rays read radiance from.
#[derive(Debug, Clone)]
pub enum RadianceSource<'a> {
    /// Those of the scene, found by triangle.
    Baked(DicedSurfels<'a>),
    /// No surfels: every hit is lit anew.
    AtHits(HitLight<'a>),
    /// What [`Self::Baked`] errs by: radiance of surfels less that found anew, where they are read.
    ErrorOf {
        /// The surfels.
        cloud: &'a SurfelCloud,
        /// Which of them covers which part of a triangle.
        dice: &'a DiceMap,
        /// Tells which hits are too near to read surfels, and the light at the others.
        anew: HitLight<'a>,
    },
    /// Clouds from elsewhere, found by place; their light adds up (light groups).
    Loaded(Vec<LoadedCloud<'a>>),
}

/// The surfel on the side that `hit` met; `None` where that side has none.
pub(crate) fn surfel_of(dice: &DiceMap, hit: &Hit) -> Option<u32> {
    dice.surfel_at(hit.prim.0, hit.triangle, hit.u, hit.v, hit.front)
}

/// Rays a receiver that [`RadianceSource::relit_share`] looks along.
const SHARE_RAYS: u32 = 32;

impl RadianceSource<'_> {
    /// Share of the rays from `receivers` that meet something to be lit anew, 0…1: what sets their cost apart.
    pub fn relit_share(&self, tracer: &Tracer, receivers: &Receivers) -> f64 {
        let is_relit = |(origin, direction)| {
            let hit = tracer.closest(origin, direction, f32::INFINITY);
            hit.is_some_and(|hit| self.is_relit(&hit))
        };
        let rays = (0..receivers.len()).flat_map(|i| {
            let origin = tracer.lift(receivers.position[i], receivers.geometric_normal[i]);
            let frame = sequence::transported_frame(receivers.normal[i]);
            (0..SHARE_RAYS).map(move |ray| {
                let place = sequence::fibonacci(ray, SHARE_RAYS);
                (origin, frame.to_world(sequence::cosine_hemisphere(place)))
            })
        });
        let count = receivers.len().max(1) as f64 * f64::from(SHARE_RAYS);
        rays.filter(|&ray| is_relit(ray)).count() as f64 / count
    }

    /// True if `hit` has light found anew, not read.
    fn is_relit(&self, hit: &Hit) -> bool {
        match self {
            Self::Baked(surfels) => {
                let found = surfels.found(hit);
                found.is_some_and(|(_, surfel)| surfels.anew(hit, surfel).is_some())
            }
            Self::AtHits(light) => light.reflects(hit),
            Self::ErrorOf { .. } | Self::Loaded(_) => false,
        }
    }

    /// Radiance from `hit` back to `origin`, from which the unit `direction` met it; black on a side without surfels.
    pub fn radiance(&self, hit: &Hit, origin: Vec3, direction: Vec3) -> Outgoing {
        match self {
            Self::Baked(surfels) => surfels.radiance(hit),
            Self::AtHits(light) => light.radiance(hit),
            Self::ErrorOf { cloud, dice, anew } => {
                let found = surfel_of(dice, hit);
                match found.filter(|&i| !anew.is_near(hit, cloud.radius[i as usize])) {
                    Some(i) => Outgoing::of_surfel(cloud, i).less(anew.radiance(hit)),
                    None => Outgoing::BLACK,
                }
            }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::PrimId;
    use std::f32::consts::PI;

    /// A sheet at the cloud's origin: its upper side reflects 1 and emits 2, its lower side reflects 5 (radiances).
    fn sheet(origin: DVec3) -> SurfelCloud {
        SurfelCloud {
            origin,
            position: vec![Vec3::ZERO; 2],
            normal: vec![Vec3::Y, -Vec3::Y],
            radius: vec![0.1; 2],
            area: vec![0.01; 2],
            radiosity: vec![Vec3::splat(3.0 * PI), Vec3::splat(5.0 * PI)],
            albedo: vec![Vec3::ONE; 2],
            emission: vec![Vec3::splat(2.0 * PI), Vec3::ZERO],
            prim: vec![0; 2],
            ..SurfelCloud::default()
        }
    }

    fn hit(distance: f32) -> Hit {
        Hit {
            distance,
            prim: PrimId(0),
            triangle: 0,
            u: 0.3,
            v: 0.3,
            front: true,
        }
    }

    #[test]
    fn rays_read_the_side_they_meet_wherever_the_cloud_has_its_origin() {
        let scene_origin = DVec3::new(1e6, 5.0, 0.0);
        let cloud = sheet(scene_origin + DVec3::new(3.0, 0.0, 0.0));
        let source = RadianceSource::Loaded(vec![LoadedCloud::new(&cloud, scene_origin)]);
        let above = source.radiance(&hit(2.0), Vec3::new(3.0, 2.0, 0.0), -Vec3::Y);
        assert!(above.reflected.abs_diff_eq(Vec3::splat(1.0), 1e-5));
        assert!(above.emitted.abs_diff_eq(Vec3::splat(2.0), 1e-5));
        let below = source.radiance(&hit(1.0), Vec3::new(3.0, -1.0, 0.0), Vec3::Y);
        assert!(below.reflected.abs_diff_eq(Vec3::splat(5.0), 1e-5));
        assert_eq!(below.emitted, Vec3::ZERO);
        let beside = source.radiance(&hit(2.0), Vec3::new(4.0, 2.0, 0.0), -Vec3::Y);
        assert_eq!(beside, Outgoing::BLACK);
    }

    #[test]
    fn light_of_several_clouds_adds_up_and_none_is_black() {
        let cloud = sheet(DVec3::ZERO);
        let twice = RadianceSource::Loaded(vec![
            LoadedCloud::new(&cloud, DVec3::ZERO),
            LoadedCloud::new(&cloud, DVec3::ZERO),
        ]);
        let seen = twice.radiance(&hit(1.0), Vec3::Y, -Vec3::Y);
        assert!(seen.reflected.abs_diff_eq(Vec3::splat(2.0), 1e-5));
        let dice = DiceMap::default();
        let nothing = RadianceSource::Baked(DicedSurfels::new(&cloud, &dice, None));
        assert_eq!(
            nothing.radiance(&hit(1.0), Vec3::Y, -Vec3::Y),
            Outgoing::BLACK
        );
    }
}
