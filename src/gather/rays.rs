//! The rays engine: a fixed low-discrepancy set of cosine-distributed rays against the scene, radiance read from the
//! surfels they hit. The in-house truth of the other engines, and the better choice in open scenes.
//!
//! Two patterns: directions that all receivers share (`shared`), and for few rays a cosine-distributed set about each
//! receiver's own normal. Both are the same everywhere, so there is error but no noise, and no seams.

pub mod cone;
mod glossy;
pub mod lobe;
mod shared;
mod stand;
mod through;

use super::radiance::{DicedSurfels, RadianceSource};
use super::ray_query::RayQuery;
use super::{Class, CloudGather, Engine, Glance, Hemisphere, Pass};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::math::sequence;
use crate::receivers::Receivers;
use crate::surfels::{DiceMap, SurfelCloud};
use crate::trace::Tracer;
use cone::Cone;
use glam::{Vec2, Vec3};
use lobe::Lobes;
use shared::Looks;
use stand::Stand;
use std::f32::consts::PI;
use std::ops::Range;
use through::Look;

/// How receivers are sampled by rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RaysSettings {
    /// Rays a receiver; 0 counts as 1.
    pub rays: u32,
    /// Nothing beyond this distance, stage units, covers or lights; `None` = no limit.
    pub max_distance: Option<f32>,
    /// Turn of the pattern about the normal, in turns. Another turn gives another error of the same size.
    pub turn: f32,
    /// Part of the hemisphere, for kinds of occlusion; `None` = all of it, and light.
    pub cone: Option<Cone>,
}

impl Default for RaysSettings {
    fn default() -> Self {
        Self {
            rays: 1024,
            max_distance: None,
            turn: 0.0,
            cone: None,
        }
    }
}

impl RaysSettings {
    /// For surfels as receivers: the errors of many average out. In a box with two spheres the
    /// irradiance of two bounces is then 0.46 % off, when 1024 rays gather it.
    pub const SURFEL: Self = Self {
        rays: 128,
        max_distance: None,
        turn: 0.0,
        cone: None,
    };

    /// Power of the number of rays (or light samples) that their error falls with: measured from 64 to 4096 lattice rays.
    pub const LAW: f64 = 0.75;

    /// Rays of a reference over those of the run it judges.
    pub const REFERENCE_RATIO: u32 = 4;

    /// Share of the reference's expected squared error in that of the run: the error of the pattern falls with the
    /// number of rays to the power 0.75 (measured: 64 to 4096 rays), so 4^(−2·0.75).
    pub const REFERENCE_ERROR_SHARE: f64 = 0.125;

    /// As many rays, turned away from those of a run, of its reference and of the pilot's: the mean of both errs by 0.7 of
    /// what each does.
    #[must_use]
    pub fn again(self) -> Self {
        Self {
            turn: self.turn + AGAIN,
            ..self
        }
    }

    /// The same, turned away from these and all others named here.
    #[must_use]
    pub fn otherwise(self) -> Self {
        Self {
            turn: self.turn + OTHERWISE,
            ..self
        }
    }

    /// As many of these as receivers of `class` need, of a pattern of its own.
    #[must_use]
    pub fn thinned(self, class: Class, glance: Glance) -> Self {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "part of a count"
        )]
        let rays = (f64::from(self.rays) * class.share()).ceil() as u32;
        Self {
            rays: rays.max(self.rays.min(LEAST_SHARED)),
            turn: self.turn
                + class.pattern()
                + match glance {
                    Glance::First => THINNED,
                    Glance::Again => THINNED_AGAIN,
                },
            ..self
        }
    }

    /// Settings of a reference for a run with these: four times the rays, turned away from the run's own.
    #[must_use]
    pub fn reference(self) -> Self {
        Self {
            rays: self.rays.saturating_mul(Self::REFERENCE_RATIO),
            // An irrational turn, so that the reference's spiral arms do not repeat those of the run.
            turn: self.turn + std::f32::consts::FRAC_1_SQRT_2,
            ..self
        }
    }
}

/// Turn of [`RaysSettings::again`]: 0.08 off the nearest of the first five multiples of 1/√2.
const AGAIN: f32 = 0.33;

/// Turn of [`RaysSettings::otherwise`]: 0.08 off the nearest of the others.
const OTHERWISE: f32 = 0.625;

/// Turns of the first pattern of [`RaysSettings::thinned`], of other numbers than all others, and of the next look.
const THINNED: f32 = 0.05;
const THINNED_AGAIN: f32 = 0.16;

/// Rays between two looks at whether the run was cancelled, a fraction of a second; four times as many where those are of
/// fewer receivers than gain from looking together.
const RAYS_A_BLOCK: usize = 1 << 18;
const TOGETHER: usize = 16;

/// Sees the scene by rays.
#[derive(Debug)]
pub struct RaysEngine<'a> {
    query: &'a dyn RayQuery,
    source: Option<RadianceSource<'a>>,
    max_distance: f32,
    pattern: Pattern<'a>,
}

#[derive(Debug, Clone)]
enum Pattern<'a> {
    /// Cosine-distributed directions about +Z, put about each receiver's normal in a frame that follows it
    /// continuously ([`sequence::transported_frame`]).
    Local(Vec<Vec3>),
    /// Directions over the whole sphere, twice as many.
    Shared(Vec<Vec3>),
    /// Directions of a cone about +Z, put about each receiver's axis.
    Cone(Cone, Vec<Vec3>),
    /// Points that lobes make directions of.
    Lobes(Lobes<'a>, Vec<Vec2>),
}

impl Pattern<'_> {
    fn of(settings: RaysSettings) -> Self {
        let count = settings.rays.max(1);
        if let Some(cone) = settings.cone {
            return Self::Cone(cone, cone.pattern(count, settings.turn));
        }
        if count >= LEAST_SHARED {
            return Self::Shared(shared::directions(count.saturating_mul(2), settings.turn));
        }
        let direction = |i| {
            let point = sequence::fibonacci(i, count);
            let turned = (point.y + settings.turn).rem_euclid(1.0);
            sequence::cosine_hemisphere(Vec2::new(point.x, turned))
        };
        Self::Local((0..count).map(direction).collect())
    }

    /// Rays a receiver, about.
    fn rays(&self) -> usize {
        match self {
            Self::Local(pattern) | Self::Cone(_, pattern) => pattern.len(),
            Self::Shared(directions) => directions.len() / 2,
            Self::Lobes(_, points) => points.len(),
        }
    }
}

/// Fewer rays than this are not shared: above some horizons there would be none.
const LEAST_SHARED: u32 = 16;

impl<'a> RaysEngine<'a> {
    /// Rays against `tracer`, radiance from `source`. Without a source every ray only asks whether anything is there:
    /// faster, and enough for occlusion; distances are then 0 where something is.
    pub fn new(
        tracer: &'a Tracer,
        source: Option<RadianceSource<'a>>,
        settings: RaysSettings,
    ) -> Self {
        Self::with_query(tracer, source, settings)
    }

    /// The same about what receivers reflect towards the eye: the hemispheres hold the light that does, not all of it.
    #[must_use]
    pub fn of_lobes(self, lobes: Lobes<'a>, settings: RaysSettings) -> Self {
        let points = lobe::points(settings.rays.max(1), settings.turn);
        Self {
            pattern: Pattern::Lobes(lobes, points),
            ..self
        }
    }

    fn with_query(
        query: &'a dyn RayQuery,
        source: Option<RadianceSource<'a>>,
        settings: RaysSettings,
    ) -> Self {
        Self {
            query,
            source,
            max_distance: settings.max_distance.unwrap_or(f32::INFINITY),
            pattern: Pattern::of(settings),
        }
    }

    fn fill_local(
        &self,
        pattern: &[Vec3],
        (receivers, i): (&Receivers, usize),
        seen: &mut Hemisphere,
    ) {
        seen.clear();
        let stand = Stand::of(receivers, i);
        let origin = self.query.lift(receivers.position[i], stand.lift);
        let frame = sequence::transported_frame(receivers.normal[i]);
        let weight = PI / pattern.len() as f32;
        let (look, mut layers) = (self.look(), Vec::new());
        for &local in pattern {
            let direction = stand.above_horizon(frame.to_world(local));
            let sight = look.along(origin, direction, &mut layers);
            seen.direction.push(direction);
            seen.weight.push(weight);
            seen.coverage.push(sight.coverage);
            seen.distance.push(sight.distance);
            seen.reflected.push(sight.light.reflected);
            seen.emitted.push(sight.light.emitted);
        }
    }

    fn look(&self) -> Look<'_> {
        Look {
            query: self.query,
            source: self.source.as_ref(),
            max_distance: self.max_distance,
        }
    }
}

impl Engine for RaysEngine<'_> {
    fn max_distance(&self) -> f32 {
        self.max_distance
    }

    fn see(
        &self,
        receivers: &Receivers,
        block: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    ) {
        match &self.pattern {
            Pattern::Local(pattern) => {
                for i in block {
                    self.fill_local(pattern, (receivers, i), scratch);
                    visit(i, scratch);
                }
            }
            Pattern::Cone(cone, pattern) => {
                for i in block {
                    self.fill_cone((cone, pattern), (receivers, i), scratch);
                    visit(i, scratch);
                }
            }
            Pattern::Lobes(lobes, points) => {
                for i in block {
                    self.fill_lobes((lobes, points), (receivers, i), scratch);
                    visit(i, scratch);
                }
            }
            Pattern::Shared(directions) => {
                let looks = Looks {
                    look: self.look(),
                    directions,
                };
                looks.see(receivers, block, scratch, visit);
            }
        }
    }

    fn name(&self) -> &'static str {
        "rays"
    }

    fn block_size(&self) -> usize {
        let rays = self.pattern.rays();
        (RAYS_A_BLOCK / rays).max((4 * RAYS_A_BLOCK / rays).min(TOGETHER))
    }

    fn tells_distances(&self) -> bool {
        self.source.is_some()
    }

    fn gains_from_neighbors(&self) -> bool {
        matches!(self.pattern, Pattern::Shared(_))
    }
}

/// Rays against clouds that share one [`DiceMap`]: the bounces of a baked cloud.
#[derive(Debug, Clone, Copy)]
pub struct CloudRays<'a> {
    /// Rays.
    pub tracer: &'a Tracer,
    /// The way from triangles to the surfels of every cloud asked for.
    pub dice: &'a DiceMap,
    /// Rays a receiver, in the last pass; before half of them.
    pub settings: RaysSettings,
}

impl<'a> CloudRays<'a> {
    /// The engine that reads `cloud`.
    pub fn engine(&self, cloud: &'a SurfelCloud, pass: Pass) -> RaysEngine<'a> {
        let source = RadianceSource::Baked(DicedSurfels::new(cloud, self.dice, None));
        let rays = match pass {
            Pass::Early => self.settings.rays.div_ceil(2),
            Pass::Last => self.settings.rays,
        };
        let settings = RaysSettings {
            rays,
            ..self.settings
        };
        RaysEngine::new(self.tracer, Some(source), settings)
    }
}

impl CloudGather for CloudRays<'_> {
    fn irradiance(
        &self,
        cloud: &SurfelCloud,
        receivers: &Receivers,
        pass: Pass,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Vec3>, Cancelled> {
        super::irradiance(&self.engine(cloud, pass), receivers, diagnostics)
    }
}

#[cfg(test)]
mod tests;
