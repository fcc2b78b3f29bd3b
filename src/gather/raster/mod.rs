//! The fast gather of reflected light: one cut through the octree for a window full of neighbors, areas instead of
//! directions. PBGI §6.1, modernized.
//!
//! Receivers that stand and look alike, and see each other, share a window (`windows`), however many they are: what it costs is
//! what some of them cost that are spread over it, the group, through whose light a smooth function goes that tells that of all
//! others (`fit`). Where it does not fit the group itself, the window is cut in parts. The group shares a cut (`cut`). What it
//! sees of a cluster is found out by a few rays from its members to surfels of the cluster (`probe`), large clusters first: where
//! they agree the whole cluster is seen or not, where they differ it is opened, and of what is small and still partly hidden
//! more rays tell a share that changes evenly across the group (`doubt`). How much light a cluster sends to a member is then not
//! sampled but computed, of parts of it that are smaller still, for each member from its own place (`transport`), so that
//! sharing costs no parallax and errors are those of shadow borders alone. Surfels nearer than a few radii are seen by short
//! rays in directions that all members share (`near`). All rays meet the scene's own geometry: nothing leaks through thin walls.
//!
//! Windows overlap, and what they tell of a receiver is averaged, so that no borders between them are seen. They are small
//! where things that cast shadows are near, and the smaller the finer the knobs: what neighbors may say for each other is a
//! knob like the others. Receivers that have too few neighbors for that stand alone, and rays see for them.
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
//! And at 512² with AVX-512, 0.4 sr and a raster of 12 pixels (the box; two teapots; `examples/room.usda`), seconds of two
//! cores and error:
//! - groups of 64 neighbors and all their guests, each of which gets its own light: 2.5 and 1.7 %, 5.4 and 1.9, 4.6 and 3.1;
//!   windows, small ones as such groups: 0.9 and 2.1 %, 3.6 and 3.0, 3.0 and 3.8; rays in place of small ones, 1.0 and 2.1, 1.9
//!   and 3.0, 2.3 and 3.6. At 0.1 sr: 3.9 and 1.6 %, 8.1 and 1.7, 6.8 and 2.3, with rays 1.7 and 1.7 %, 2.8 and 2.0, 3.6 and 2.4;
//! - rays alone where receivers stand alone, without what windows near by tell of them: a twentieth less of an error, and
//!   borders that are seen;
//! - groups of 25: 0.75 of the time, 1.2 times the error.
//!
//! And in an earlier form of it, with other errors on top:
//! - blocked shares times the mean light of a cluster: 1 to 2 % too dark, since shadows of the light and what a receiver
//!   does not see are behind the same things; the light of the surfels that rays reach, 0.1 to 0.5 %;
//! - the softened A/(πd² + A) instead of A/πd²: up to 0.8 % too dark;
//! - distances from the group's ball instead of from its nearest member: 855 clusters instead of 447, 1.5 times the time;
//! - near surfels by the group's ball instead of pair by pair: 56 instead of 4 of them, 4 times the rays.

mod cut;
mod doubt;
mod fit;
mod group;
mod near;
mod probe;
mod transport;
mod windows;

use super::known::{KnownEngine, two_directions};
use super::{DicedSurfels, Engine, Hemisphere, RadianceSource, RaysEngine, RaysSettings};
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::octree::{NodeKind, Octree};
use crate::receivers::Receivers;
use crate::trace::Tracer;
use fearless_simd::{Level, dispatch};
use fit::Fit;
use glam::Vec3;
use group::Group;
use rayon::prelude::*;
use std::f32::consts::FRAC_1_PI;
use std::ops::Range;
use windows::{Core, Sizes, Sorted, Window, Windows};

/// How finely the engine looks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RasterSettings {
    /// Largest solid angle, sr, of a cluster that part of a group may see, from the nearest receiver of the group.
    pub max_solid_angle: f32,
    /// Three times the rays that ask whether a group sees a cluster, twice the square root of those that ask how much of
    /// it, half of that of the directions to what is near, 0.7 of that of the rays of receivers that stand alone; at least 1.
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
    /// See [`MISFIT`], of the group's own light.
    misfit: f32,
    max_distance: f32,
    /// Surfels closer than this many of their radii are near.
    near_radii: f32,
}

/// Light is computed of areas this many times smaller than what is asked for: that costs 1 ns a receiver and area, and a
/// ray 150. At 0.2 sr and 4 rays, 16 more, a ratio of 2 errs by 2.5 %, of 4 by 2.0 %, of 10 by 1.9 %.
const AREA_RATIO: f32 = 5.0;

/// Largest solid angle of what light is computed of, sr: with 0.08, one bounce in a box is 0.6 % too dark; with 0.04 it is so by
/// 0.9 % in `examples/room.usda`, in as much time.
const MAX_AREA: f32 = 0.02;

/// Surfels count as points: the finer clusters are, the farther are those that do.
const NEAR_ANGLE: f32 = 0.03;

/// Larger clusters are opened before any ray is sent: their surfels are too different to speak for each other.
const MAX_ASKED: f32 = 0.5;

/// Solid angle of clusters that are asked over that of the last ones.
const ASKED_RATIO: f32 = 5.0;

/// Radius of the largest group over that of its smallest cluster, half the scene's diagonal away. What the group sees of it
/// is taken to change evenly from one end of the group to the other.
const GROUP_RATIO: f32 = 0.5;

/// What members of a group see may be this far off what is told of them, rms over their mean, times the root of the largest
/// solid angle: else the group is too large.
const MISFIT: f32 = 0.016;

/// Rays of a receiver that stands alone: so many, and some a pixel of the raster.
const RAYS_ALONE: u32 = 144;
const RAYS_A_PIXEL: u32 = 2;

/// Weight of the windows that a receiver which stands alone is a guest of from which on it believes these: what members at
/// the edge of a core have. Less of it and it believes its own rays the more.
const BELIEVED: f32 = 0.17;

/// Rays that find out how much room there is, a ninth of the pixels of the raster: at least and at most.
const ROOM_RAYS: [u32; 2] = [16, 256];

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
                probes: ((resolution / 3).saturating_pow(2)).clamp(ROOM_RAYS[0], ROOM_RAYS[1]),
            },
            misfit: MISFIT * max_solid_angle.sqrt(),
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
    surfels: DicedSurfels<'a>,
    /// Sees for receivers that stand alone.
    rays: RaysEngine<'a>,
    /// Surfels below each node, in leaf order.
    below: Vec<Range<u32>>,
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
    /// An engine over `octree`, which is that of the cloud of `surfels`, diced from the scene of `tracer`.
    ///
    /// # Panics
    /// If the octree does not hold as many surfels as there are.
    pub fn new(
        octree: &'a Octree,
        tracer: &'a Tracer,
        surfels: DicedSurfels<'a>,
        settings: RasterSettings,
    ) -> Self {
        let leaves = octree.surfels();
        let count = surfels.dice().surfel_count();
        assert_eq!(leaves.len(), count, "surfels of one cloud");
        let mut place = vec![0; leaves.len()];
        for (leaf_place, i) in (0..).zip(0..leaves.len()) {
            place[leaves.id(i) as usize] = leaf_place;
        }
        let below = surfels_of_nodes(octree);
        let resolution = settings.raster_resolution.max(1);
        let pixels = resolution.saturating_pow(2);
        let source = RadianceSource::Baked(surfels.clone());
        let alone = RaysSettings {
            rays: RAYS_ALONE.saturating_add(pixels.saturating_mul(RAYS_A_PIXEL)),
            max_distance: settings.max_distance,
            ..RaysSettings::default()
        };
        Self {
            octree,
            tracer,
            surfels,
            rays: RaysEngine::new(tracer, Some(source), alone),
            heights: heights(octree, &below),
            below,
            place,
            targets: probe::Targets::new(leaves),
            knobs: Knobs::of(settings, octree),
            directions: near::Directions::new(resolution),
            level: Level::new(),
        }
    }

    /// Irradiance of all `receivers`.
    fn irradiance(
        &self,
        receivers: &Receivers,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Vec3>, Cancelled> {
        let (windows, sorted) = Windows::new(self.tracer, receivers, self.knobs.sizes);
        let Sorted {
            mut cores,
            mut alone,
        } = sorted;
        let mut sums = vec![(Vec3::ZERO, 0.0_f32); receivers.len()];
        let phase = diagnostics.phase("survey", "receivers", receivers.len() as u64);
        while !cores.is_empty() {
            let mut parts = Sorted::default();
            for batch in cores.chunks(BATCH) {
                let look = |core: &Core| {
                    diagnostics.check()?;
                    let looked = self.look(receivers, (&windows, core));
                    if let Looked::Told(window, _) = &looked {
                        phase.advance(window.core as u64);
                    }
                    Ok(looked)
                };
                let looked: Vec<Looked> = batch.par_iter().map(look).collect::<Result<_, _>>()?;
                for looked in looked {
                    match looked {
                        Looked::Told(window, light) => window.add(&light, &mut sums),
                        Looked::Split(sorted) => parts.extend(sorted),
                    }
                }
            }
            cores = parts.cores;
            alone.extend(parts.alone);
        }
        drop(phase);
        // The others believe their windows alone.
        alone.retain(|&i| sums[i].1 < BELIEVED);
        let by_rays = super::irradiance(&self.rays, &receivers.subset(&alone), diagnostics)?;
        for (i, own) in alone.into_iter().zip(by_rays) {
            let (sum, all) = &mut sums[i];
            let more = BELIEVED - *all;
            *sum += own * more;
            *all += more;
        }
        Ok(sums.into_iter().map(|(sum, all)| sum / all).collect())
    }

    /// What the window about a core receives, told by some of its members, or its parts if these do not tell it.
    fn look(&self, receivers: &Receivers, (windows, core): (&Windows, &Core)) -> Looked {
        let window = windows.window(core);
        let group = Group::new(self.tracer, receivers, &window);
        let light = self.light(&group);
        let fit = Fit::through(&group.across, &light);
        let [mut off, mut sum, mut all] = [0.0_f32; 3];
        for ((&member, &place), light) in group.picked.iter().zip(&group.across).zip(&light) {
            let weight = window.weights[member];
            off += weight * (fit.at(place) - *light).element_sum().powi(2);
            sum += weight * light.element_sum();
            all += weight;
        }
        if (off / all).sqrt() > self.knobs.misfit * sum / all {
            return Looked::Split(windows.split(core));
        }
        let told = |&place: &[f32; 2]| fit.at(place).max(Vec3::ZERO);
        let light = window.across.iter().map(told).collect();
        Looked::Told(window, light)
    }

    /// Irradiance of the members of `group`.
    fn light(&self, group: &Group) -> Vec<Vec3> {
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
        let mut light = seen(&cut.seen);
        doubt::add(self, group, &cut, &seen, &mut light);
        let near = near::irradiance(self, group, &cut.near);
        light
            .iter_mut()
            .zip(near)
            .for_each(|(light, near)| *light += near);
        light
    }
}

impl Window {
    /// Adds the `light` of its members, by their weights, to `sums` over all receivers, and the weights.
    fn add(&self, light: &[Vec3], sums: &mut [(Vec3, f32)]) {
        for ((&i, &weight), &light) in self.members.iter().zip(&self.weights).zip(light) {
            sums[i].0 += light * weight;
            sums[i].1 += weight;
        }
    }
}

/// What came of looking at a window.
enum Looked {
    /// Irradiance of its members.
    Told(Window, Vec<Vec3>),
    /// Its core's parts.
    Split(Sorted),
}

/// Windows that are looked at before their light is added up, in their order.
const BATCH: usize = 1024;

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
