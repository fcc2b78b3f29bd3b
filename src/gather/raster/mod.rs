//! The fast gather of reflected light: one cut through the octree for a group of neighbors, areas instead of
//! directions. PBGI §6.1, modernized.
//!
//! Receivers that stand and look alike, and see each other, share a cut (`cut`). What the group sees of a cluster is found
//! out by a few rays from its members to surfels of the cluster (`probe`), large clusters first: where they agree the whole
//! cluster is seen or not, where they differ it is opened, and of what is small and still partly hidden more rays tell a share
//! that changes evenly across the group (`doubt`). How much light a cluster sends to a receiver is then not sampled but
//! computed, of parts of it that are smaller still, for each receiver from its own place (`transport`), so that sharing costs
//! no parallax and errors are those of shadow borders alone. Surfels nearer than a few radii are seen by short rays in
//! directions that all receivers share (`near`). All rays meet the scene's own geometry: nothing leaks through thin walls.
//! Groups overlap, and what they tell of a receiver is averaged, so that no borders between them are seen (`windows`). They
//! are small where things that cast shadows are near, and the smaller the finer the knobs: what neighbors may say for each
//! other is a knob like the others.
//!
//! What lost, in a Cornell box with two balls, 105 472 surfels, pixels of a 256² picture, µs a receiver and error of the
//! indirect irradiance:
//! - light computed of the very clusters that are asked for, where rays are what costs: 10.3 and 2.8 %; of parts a fifth of
//!   their size, with as many rays, 13.6 and 1.9 %;
//! - every receiver its own ray to what is partly hidden (0.2 sr): 15.5 and 2.9 %, four of them 23 and 1.7 %; a plane
//!   through 32 answers of the group 13.4 and 1.6 %;
//! - groups of 64 whatever their size: an error of 1.5 % with 531 receivers in the box, however fine all else is;
//! - balls around clusters for what is below the horizon, or averted: 160 of 220 clusters asked had nothing to see; slabs
//!   across their normals: 19 of 80;
//! - an eighth of the solid angle for clusters that are not flat: no less of an error, 1.2 times the time;
//! - two rays instead of four to ask whether a cluster is seen: 9.6 and 3.9 % instead of 12 and 2.2 %.
//!
//! And in an earlier form of it, with other errors on top:
//! - blocked shares times the mean light of a cluster: 1 to 2 % too dark, since shadows of the light and what a receiver
//!   does not see are behind the same things; the light of the surfels that rays reach, 0.1 to 0.5 %;
//! - the softened A/(πd² + A) instead of A/πd²: up to 0.8 % too dark;
//! - distances from the group's ball instead of from its nearest member: 855 clusters instead of 447, 1.5 times the time;
//! - near surfels by the group's ball instead of pair by pair: 56 instead of 4 of them, 4 times the rays.

mod cut;
mod doubt;
mod group;
mod near;
mod probe;
mod transport;
mod windows;

use super::known::{KnownEngine, two_directions};
use super::{Engine, Hemisphere, HitLight};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::octree::{NodeKind, Octree};
use crate::receivers::Receivers;
use crate::surfels::DiceMap;
use crate::trace::Tracer;
use fearless_simd::{Level, dispatch};
use glam::Vec3;
use group::Group;
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::ops::Range;
use windows::{Sizes, Window, Windows};

/// How finely the engine looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RasterSettings {
    /// Largest solid angle, sr, of a cluster that part of a group may see, from the nearest receiver of the group.
    pub max_solid_angle: f32,
    /// Three times the rays that ask whether a group sees a cluster, twice the square root of those that ask how much of
    /// it, half of that of the directions to what is near; at least 1.
    pub raster_resolution: u32,
    /// Nothing beyond this distance lights, stage units; `None` = no limit.
    pub max_distance: Option<f32>,
}

impl Default for RasterSettings {
    fn default() -> Self {
        Self {
            max_solid_angle: 0.03,
            raster_resolution: 12,
            max_distance: None,
        }
    }
}

/// What follows from the settings.
#[derive(Debug, Clone, Copy)]
struct Knobs {
    /// Up to this solid angle a cluster may be seen in part, sr: larger ones are opened.
    max_solid_angle: f32,
    /// Largest solid angle of what light is computed of, sr.
    max_area: f32,
    /// Up to this solid angle clusters are asked whether they are seen as a whole, sr.
    max_asked: f32,
    /// Rays of a group that ask whether a cluster is seen.
    rays: usize,
    /// Rays of a group to a cluster that is seen in part, if its light is as much as such clusters usually have.
    more_rays: f32,
    sizes: Sizes,
    max_distance: f32,
    /// Surfels closer than this many of their radii are near.
    near_radii: f32,
}

/// Light is computed of areas this many times smaller than what is asked for: that costs 1 ns a receiver and area, and a
/// ray 150. At 0.2 sr and 4 rays, 16 more, a ratio of 2 errs by 2.5 %, of 4 by 2.0 %, of 10 by 1.9 %.
const AREA_RATIO: f32 = 5.0;

/// Largest solid angle of what light is computed of, sr: with 0.08, one bounce in a box is 0.6 % too dark.
const MAX_AREA: f32 = 0.04;

/// Surfels count as points: the finer clusters are, the farther are those that do.
const NEAR_ANGLE: f32 = 0.03;

/// Larger clusters are opened before any ray is sent: their surfels are too different to speak for each other.
const MAX_ASKED: f32 = 0.5;

/// Solid angle of clusters that are asked over that of the last ones.
const ASKED_RATIO: f32 = 5.0;

/// Radius of the largest group over that of its smallest cluster, half the scene's diagonal away. What the group sees of it
/// is taken to change evenly from one end of the group to the other.
const GROUP_RATIO: f32 = 0.5;

/// Radius of a core over that of its smallest cluster as far away as what is seen there, in the harmonic mean.
const ROOM_RATIO: f32 = 1.5;

impl Knobs {
    fn of(settings: RasterSettings, octree: &Octree) -> Self {
        let resolution = settings.raster_resolution.max(1);
        let max_solid_angle = settings.max_solid_angle;
        let cluster = (max_solid_angle * FRAC_1_PI).sqrt();
        let bounds = octree.bounds();
        let away = if bounds.is_empty() {
            0.0
        } else {
            0.5 * bounds.diagonal()
        };
        Self {
            max_solid_angle,
            max_area: (max_solid_angle / AREA_RATIO).min(MAX_AREA),
            max_asked: (ASKED_RATIO * max_solid_angle).min(MAX_ASKED),
            rays: (resolution / 3).clamp(2, 64) as usize,
            more_rays: 0.25 * (resolution * resolution) as f32,
            sizes: Sizes {
                max_radius: GROUP_RATIO * cluster * away,
                max_share: ROOM_RATIO * cluster,
            },
            max_distance: settings.max_distance.unwrap_or(f32::INFINITY),
            near_radii: cut::NEAR_RADII * (NEAR_ANGLE / max_solid_angle).sqrt().clamp(1.0, 4.0),
        }
    }
}

/// Gathers reflected light from an octree over the surfels of the scene at hand.
///
/// It tells [`Hemisphere::reflected`] alone, as one direction for all: what is open it does not look at.
/// What a receiver sees depends on its neighbors within the engine's error: they share rays.
#[derive(Debug)]
pub struct RasterEngine<'a> {
    octree: &'a Octree,
    tracer: &'a Tracer,
    dice: &'a DiceMap,
    near_light: Option<HitLight<'a>>,
    /// Surfels below each node, in leaf order.
    surfels: Vec<Range<u32>>,
    /// How far parts of each node rise from the plane through its center across its normal.
    heights: Vec<f32>,
    /// Place in leaf order of each surfel of the cloud.
    place: Vec<u32>,
    targets: probe::Targets,
    knobs: Knobs,
    directions: near::Directions,
    level: Level,
}

impl<'a> RasterEngine<'a> {
    /// An engine over `octree`, which is that of the cloud that `dice` numbers, diced from the scene of `tracer`.
    ///
    /// # Panics
    /// If the octree does not hold as many surfels as `dice` numbers.
    pub fn new(
        octree: &'a Octree,
        tracer: &'a Tracer,
        dice: &'a DiceMap,
        settings: RasterSettings,
    ) -> Self {
        let surfels = octree.surfels();
        assert_eq!(surfels.len(), dice.surfel_count(), "surfels of one cloud");
        let mut place = vec![0; surfels.len()];
        for (leaf_place, i) in (0..).zip(0..surfels.len()) {
            place[surfels.id(i) as usize] = leaf_place;
        }
        let surfels = surfels_of_nodes(octree);
        Self {
            octree,
            tracer,
            dice,
            near_light: None,
            heights: heights(octree, &surfels),
            surfels,
            place,
            targets: probe::Targets::new(octree.surfels()),
            knobs: Knobs::of(settings, octree),
            directions: near::Directions::new(settings.raster_resolution.max(1)),
            level: Level::new(),
        }
    }

    /// The same, but hits nearer than surfels can tell are lit anew, as rays do. `light` knows no bounces.
    #[must_use]
    pub fn with_near_light(self, light: Option<HitLight<'a>>) -> Self {
        Self {
            near_light: light,
            ..self
        }
    }

    /// Irradiance of all `receivers`.
    fn irradiance(
        &self,
        receivers: &Receivers,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Vec3>, Cancelled> {
        let windows = Windows::new(self.tracer, receivers, self.knobs.sizes);
        let mut near = vec![Vec3::ZERO; receivers.len()];
        let mut far = vec![(Vec3::ZERO, 0.0_f32); receivers.len()];
        let phase = diagnostics.phase("survey", "receivers", receivers.len() as u64);
        let all: Vec<usize> = (0..windows.len()).collect();
        for batch in all.chunks(BATCH) {
            let look = |&index: &usize| {
                diagnostics.check()?;
                let window = windows.window(index);
                let light = self.look(&Group::new(self.tracer, receivers, &window));
                phase.advance(window.core as u64);
                Ok((window, light))
            };
            let seen: Vec<(Window, Light)> =
                batch.par_iter().map(look).collect::<Result<_, _>>()?;
            for (window, light) in seen {
                for (&i, light) in window.members.iter().zip(light.near) {
                    near[i] = light;
                }
                for ((&i, weight), light) in
                    window.members.iter().zip(window.weights).zip(light.far)
                {
                    far[i].0 += light * weight;
                    far[i].1 += weight;
                }
            }
        }
        let sum = |(near, (far, weight)): (Vec3, (Vec3, f32))| near + far / weight;
        Ok(near.into_iter().zip(far).map(sum).collect())
    }

    fn look(&self, group: &Group) -> Light {
        let cut = dispatch!(self.level, simd => {
            let _ = simd;
            cut::find(self, group)
        });
        let max_distance = self.knobs.max_distance;
        let seen = |areas: &[transport::Area]| -> Vec<Vec3> {
            dispatch!(self.level, simd => {
                let _ = simd;
                transport::irradiance(group, areas, max_distance)
            })
        };
        let mut far = seen(&cut.seen);
        doubt::add(self, group, &cut, &seen, &mut far);
        Light {
            near: near::irradiance(self, group, &cut.near),
            far,
        }
    }
}

/// What members of a group receive.
struct Light {
    /// Of surfels near to them; only the core.
    near: Vec<Vec3>,
    far: Vec<Vec3>,
}

/// Windows that are looked at before their light is added up, in their order.
const BATCH: usize = 4096;

/// Surfels below each node.
fn surfels_of_nodes(octree: &Octree) -> Vec<Range<u32>> {
    let mut all = vec![0..0; octree.node_count()];
    let number = |i: usize| u32::try_from(i).expect("a cloud has less than 2³² surfels");
    // Children stand behind their parents.
    for (i, node) in octree.nodes().enumerate().rev() {
        all[i] = match node.kind() {
            NodeKind::Leaf(surfels) => number(surfels.start)..number(surfels.end),
            NodeKind::Inner(children) => all[children.start].start..all[children.end - 1].end,
        };
    }
    all
}

/// How far parts of each node rise from the plane through its center across its normal.
fn heights(octree: &Octree, ranges: &[Range<u32>]) -> Vec<f32> {
    let surfels = octree.surfels();
    let height = |(index, range): (usize, &Range<u32>)| {
        let node = octree.node(index);
        let rise = |i: usize| {
            let slope = node.normal.cross(surfels.normal(i)).length();
            let middle = node.normal.dot(surfels.position(i) - node.center).abs();
            middle + slope * surfels.radius(i)
        };
        let all = range.start as usize..range.end as usize;
        all.map(rise).fold(0.0, f32::max).min(node.radius)
    };
    ranges.par_iter().enumerate().map(height).collect()
}

impl Engine for RasterEngine<'_> {
    fn max_distance(&self) -> f32 {
        self.knobs.max_distance
    }

    fn see(
        &self,
        receivers: &Receivers,
        block: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    ) {
        let alone = receivers.subset(&block.clone().collect::<Vec<_>>());
        let irradiance = (self.irradiance(&alone, &Diagnostics::default()))
            .expect("nobody holds the token to cancel it with");
        for (i, irradiance) in block.zip(irradiance) {
            two_directions(receivers.normal[i], (1.0, irradiance), scratch);
            visit(i, scratch);
        }
    }

    fn name(&self) -> &'static str {
        NAME
    }

    fn survey(
        &self,
        receivers: &Receivers,
        diagnostics: &Diagnostics,
    ) -> Result<Option<Box<dyn Engine + '_>>, Cancelled> {
        Ok(Some(Box::new(KnownEngine {
            occlusion: None,
            indirect: Some(self.irradiance(receivers, diagnostics)?.into()),
            max_distance: self.knobs.max_distance,
            name: NAME,
        })))
    }
}

const NAME: &str = "raster";
