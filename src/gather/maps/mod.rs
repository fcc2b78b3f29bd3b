//! Scene → visibility of many receivers at once, by depth maps: the gather turned inside out.
//!
//! Instead of one hemisphere a receiver, there is one orthographic map a direction, fixed in the world and shared by
//! all receivers: what lies farthest along the direction at each pixel. Whoever stands farther sees the sky there. No
//! hierarchy is built, one look costs a few nanoseconds. Far occluders need no more triangles than the maps have
//! pixels, so meshes are decimated to them first. Only the sky is seen: light reflected by surfaces needs another
//! engine, and so do shadows of suns and small bright areas in an image of the sky.
//!
//! Measured on one thread, visibility of all vertices of a bumpy ball of 1.09 M triangles on a ground: 1.4 % error at
//! 0.7 µs a vertex, set-up included, 35 times less than rays that share their directions between neighbors; on three
//! scans 2 to 12 times less at 1 to 3 %, with an estimate of what is handed over and of the hierarchy for it
//! (`tests/support/maps_speed.rs`).
//! Rays are better below 1 % on rough scans, for few receivers, and for small bright lights.
//!
//! What maps cannot decide is told: each receiver knows the share of its verdicts that hung on the bias, and
//! [`gather()`] hands those with too many to another engine.

mod axes;
mod borders;
mod cost;
mod crowd;
mod decimate;
mod flat;
mod handover;
mod look;
#[cfg(test)]
mod plain;
mod plan;
mod raster;
mod results;
mod shell;
mod sky;
mod wide;

pub use cost::seconds;
pub use plan::MapsPlan;
pub use results::{Ask, gather, gather_sky, needs_sky, supports};
pub use sky::{MapsSky, SkyWanted};

use crate::diagnostics::{Cancelled, Diagnostics};
use crate::math::Bounds3;
use crate::math::sh::{COEFFICIENT_COUNT, Sh9};
use crate::receivers::Receivers;
use axes::Axis;
use crowd::Crowd;
use fearless_simd::Level;
use glam::Vec3;
use look::{Rules, View};
use raster::{DepthMap, MOST_PIXELS, Piece};
use rayon::prelude::*;
use shell::Shell;
use sky::SkyCell;
use std::f32::consts::PI;
use std::sync::Arc;

/// How maps are drawn and looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapsSettings {
    /// Directions over each receiver's horizon, at least 1. The error of smooth visibility falls as its power −0.75.
    pub directions: u32,
    /// Width of a pixel, in mean edges of the meshes in a map, above 0. 3 for dense smooth meshes, 1 to 0.5 for scans.
    pub pixel: f32,
    /// Width of the cells of the decimation, in mean edges; below 1: meshes are drawn as they are.
    pub cell: f32,
    /// How far the receiver's own patch may rise above its tangent plane, in pixels: smaller for rough surfaces,
    /// larger for coarsely drawn ones.
    pub bias: f32,
    /// Nothing beyond this distance, stage units, covers; `None` = no limit. Maps know the last surface along a
    /// direction and not the first: receivers with a direction that ends beyond are ambiguous.
    pub max_distance: Option<f32>,
    /// Share of uncertain verdicts, 0…1, above which a receiver is ambiguous.
    pub ambiguous: f32,
}

impl Default for MapsSettings {
    fn default() -> Self {
        Self {
            directions: 256,
            pixel: 1.0,
            cell: 0.0,
            bias: 0.5,
            max_distance: None,
            ambiguous: 0.25,
        }
    }
}

impl MapsSettings {
    /// For meshes whose edges are far shorter than their features.
    pub const SMOOTH: Self = Self {
        directions: 128,
        pixel: 3.0,
        cell: 3.0,
        bias: 1.0,
        max_distance: None,
        ambiguous: 0.25,
    };
}

/// What to compute besides visibility.
#[derive(Debug, Clone, Copy, Default)]
pub struct Wanted<'a> {
    /// The mean open direction.
    pub bent_normal: bool,
    /// Spherical harmonics of the visibility.
    pub harmonics: bool,
    /// Light of the even part of an environment, divided for the same number of directions.
    pub environment: Option<SkyWanted<'a>>,
}

/// What all receivers see, one value each, in their order. Columns that were not asked for are empty.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Visibility {
    /// Cosine-weighted open fraction of the hemisphere, 0…1; exactly 1 where all is open.
    pub visibility: Vec<f32>,
    /// Share of the directions, weighted by the cosine, whose verdict hung on the bias, 0…1; 1 where a surface beyond
    /// the distance asked for may hide one before it.
    pub uncertain: Vec<f32>,
    /// True where maps cannot tell: another engine should look.
    pub ambiguous: Vec<bool>,
    /// Mean over the hemisphere of open directions, weighted by the cosine: its length is at most the visibility.
    pub open_direction: Vec<Vec3>,
    /// Coefficients of the function that is 1 in open directions over the horizon and 0 elsewhere, without the cosine.
    pub harmonics: Vec<Sh9>,
    /// Irradiance from the even part of the environment, radiance·sr: exact where all is open.
    pub environment: Vec<Vec3>,
    /// Mean direction of that light, weighted by luminance; of any length.
    pub illumination: Vec<Vec3>,
}

/// Memory that the maps drawn at once may take, bytes. Independent of threads, though results are as well.
const MAP_BYTES: usize = 64 << 20;

/// Memory for triangles in the order in which they are drawn, bytes.
const BLOCK_BYTES: usize = 256 << 20;

/// Most axes drawn at once: receivers are passed over once for all of them.
const MOST_AXES: usize = 16;

/// Blocks of receivers a unit of parallel work: their sums stay in the first cache while they look along many axes.
const BLOCKS: usize = 64;

/// Maps are at least this many pixels across, so that outlines of coarse meshes show.
const LEAST_PIXELS: f32 = 192.0;

/// The directions that `count` maps are drawn across, unit; every receiver looks along each one or against it.
pub fn directions(count: u32) -> impl Iterator<Item = Vec3> {
    axes::axes(count).into_iter().map(|axis| axis.direction)
}

/// What every receiver sees of the sky. The same bits for any number of threads.
///
/// # Errors
/// When cancelled.
///
/// # Panics
/// If the sky of `wanted` was divided for another number of directions.
pub fn visibility(
    plan: &MapsPlan<'_>,
    receivers: &Receivers,
    settings: &MapsSettings,
    wanted: &Wanted<'_>,
    diagnostics: &Diagnostics,
) -> Result<Visibility, Cancelled> {
    let count = settings.directions.max(1);
    if let Some(wanted) = wanted.environment {
        let fits = wanted.sky.directions().len() == count as usize;
        assert!(fits, "the sky is divided for {count} directions");
    }
    let phase = diagnostics.phase("maps", "directions", u64::from(count));
    let stage = Stage::new(plan, settings);
    let channels = Channels::of(wanted);
    let rows = (channels.count, sky::row_count(wanted.environment));
    let mut crowd = Crowd::new(plan, receivers, rows);
    let rules = Rules {
        bias: settings.bias,
        max_distance: settings.max_distance.unwrap_or(f32::INFINITY),
        flat_margin: Rules::flat_margin(plan.radius, plan.center.abs().max_element() + plan.radius),
        weighted_channels: channels.weighted,
    };
    let level = Level::new();
    let mut all_views = Vec::new();
    for batch in axes::axes(count).chunks(stage.axes_at_once()) {
        diagnostics.check()?;
        all_views.resize_with(batch.len().max(all_views.len()), View::default);
        let views = &mut all_views[..batch.len()];
        (views.par_iter_mut().zip(batch))
            .for_each(|(view, axis)| stage.look_along(level, (plan, wanted), axis, view));
        let views = &*views;
        (
            crowd.blocks.par_chunks(BLOCKS),
            crowd.sums.par_chunks_mut(BLOCKS),
        )
            .into_par_iter()
            .for_each(|(blocks, sums)| wide::look(level, (views, &rules), blocks, sums));
        phase.advance(batch.len() as u64);
    }
    let mut visibility = channels.read(&crowd, wanted, count);
    handover::mark(
        (plan, &stage.pixels(plan)),
        receivers,
        (settings, rules.flat_margin),
        &mut visibility,
    );
    Ok(visibility)
}

/// What is drawn, at the settings' detail.
struct Stage<'a> {
    classes: Vec<DrawnClass<'a>>,
}

struct DrawnClass<'a> {
    shells: Vec<Arc<Shell<'a>>>,
    /// Index into `shells`, and how it stands.
    pieces: Vec<(usize, plan::Occluder)>,
    bounds: Bounds3,
    pixel: f32,
}

impl<'a> Stage<'a> {
    fn new(plan: &MapsPlan<'a>, settings: &MapsSettings) -> Self {
        plan.expect_detail(settings.cell);
        let classes = plan.classes.par_iter();
        let stage = Self {
            classes: classes
                .map(|class| DrawnClass::new(plan, class, settings))
                .collect(),
        };
        stage.keep_blocks();
        stage
    }

    /// As many as fit.
    fn keep_blocks(&self) {
        let mut free = BLOCK_BYTES;
        let shells = self.classes.iter().flat_map(|class| &class.shells);
        let kept: Vec<&Arc<Shell<'_>>> = shells
            .filter(|shell| {
                let fits = shell.block_bytes() <= free;
                free -= if fits { shell.block_bytes() } else { 0 };
                fits
            })
            .collect();
        kept.into_par_iter().for_each(|shell| shell.keep_blocks());
    }

    fn axes_at_once(&self) -> usize {
        let bytes: f32 = self.classes.iter().map(DrawnClass::map_bytes).sum();
        let fit = MAP_BYTES as f32 / bytes.max(1.0);
        (1..=MOST_AXES)
            .rev()
            .find(|&n| (n as f32) < fit)
            .unwrap_or(1)
    }

    /// Width of the pixels that each prim is drawn at, stage units; 0 where it is in no map.
    fn pixels(&self, plan: &MapsPlan<'_>) -> Vec<f32> {
        let mut pixels = vec![0.0; plan.scene.prims.len()];
        for class in &self.classes {
            for (_, occluder) in &class.pieces {
                pixels[occluder.prim.index()] = class.pixel;
            }
        }
        pixels
    }

    fn look_along(
        &self,
        level: Level,
        (plan, wanted): (&MapsPlan<'_>, &Wanted<'_>),
        axis: &Axis,
        view: &mut View,
    ) {
        view.axis = *axis;
        view.maps.resize_with(self.classes.len(), DepthMap::default);
        for (class, map) in self.classes.iter().zip(&mut view.maps) {
            class.draw(level, axis, map);
        }
        view.flats.clear();
        let flats = plan.flats.iter();
        view.flats.extend(flats.filter_map(|flat| flat.view(axis)));
        view.channels =
            [axis.direction, -axis.direction].map(|direction| Channels::values(wanted, direction));
        view.sky = (wanted.environment).map(|wanted| wanted.sky.pair(axis.number).map(SkyCell::of));
    }
}

impl<'a> DrawnClass<'a> {
    fn new(plan: &MapsPlan<'a>, class: &plan::Class, settings: &MapsSettings) -> Self {
        let mut slot_of_mesh = vec![usize::MAX; plan.scene.meshes.len()];
        let mut shells = Vec::new();
        let mut pieces = Vec::with_capacity(class.occluders.len());
        for occluder in &class.occluders {
            let mesh = plan.scene.prims[occluder.prim.index()].mesh.index();
            if slot_of_mesh[mesh] == usize::MAX {
                slot_of_mesh[mesh] = shells.len();
                shells.push(if settings.cell >= 1.0 {
                    plan.thinned(occluder, settings.cell * class.edge / occluder.scale)
                } else {
                    let mesh = &plan.scene.meshes[mesh];
                    let center = mesh.bounds().center();
                    Arc::new(Shell::new(&mesh.positions, &mesh.triangles, center))
                });
            }
            pieces.push((slot_of_mesh[mesh], *occluder));
        }
        let diagonal = class.bounds.diagonal();
        let wished = settings.pixel * class.edge;
        Self {
            shells,
            pieces,
            bounds: class.bounds,
            pixel: wished
                .min(diagonal / LEAST_PIXELS)
                .max(diagonal / MOST_PIXELS),
        }
    }

    /// About, of one map.
    fn map_bytes(&self) -> f32 {
        8.0 * (self.bounds.diagonal() / self.pixel).powi(2)
    }

    fn draw(&self, level: Level, axis: &Axis, map: &mut DepthMap) {
        let piece = |(slot, occluder): &(usize, plan::Occluder)| Piece {
            shell: &self.shells[*slot],
            local_from_object: occluder.local_from_object,
            prim: occluder.prim.0,
            is_solid: occluder.is_solid,
        };
        let pieces: Vec<Piece<'_>> = self.pieces.iter().map(piece).collect();
        map.draw(level, &pieces, (self.bounds, self.pixel), axis);
    }
}

/// Where what was asked for lies among the sums.
struct Channels {
    count: usize,
    /// The first ones are weighted by the cosine.
    weighted: usize,
}

impl Channels {
    fn of(wanted: &Wanted<'_>) -> Self {
        let weighted = if wanted.bent_normal { 3 } else { 0 };
        let harmonics = if wanted.harmonics {
            COEFFICIENT_COUNT
        } else {
            0
        };
        Self {
            count: weighted + harmonics,
            weighted,
        }
    }

    fn values(wanted: &Wanted<'_>, direction: Vec3) -> Vec<f32> {
        let mut values = Vec::new();
        if wanted.bent_normal {
            values.extend(direction.to_array());
        }
        if wanted.harmonics {
            values.extend(Sh9::basis(direction).0);
        }
        values
    }

    fn read(&self, crowd: &Crowd, wanted: &Wanted<'_>, count: u32) -> Visibility {
        let share = |part: f32, whole: f32| if whole > 0.0 { part / whole } else { 0.0 };
        let three = |rows: &[crowd::Lanes], first: usize, lane: usize| {
            Vec3::new(
                rows[first][lane],
                rows[first + 1][lane],
                rows[first + 2][lane],
            )
        };
        let open = |s: &crowd::Sums, lane: usize| share(s.open[lane], s.weight[lane]);
        let solid_angle = 2.0 * PI / count as f32;
        Visibility {
            visibility: crowd.values(open),
            uncertain: crowd.values(|s, lane| share(s.uncertain[lane], s.weight[lane]).min(1.0)),
            ambiguous: Vec::new(),
            open_direction: if wanted.bent_normal {
                crowd.values(|s, lane| three(&s.channels, 0, lane) * share(1.0, s.weight[lane]))
            } else {
                Vec::new()
            },
            environment: if wanted.environment.is_some() {
                crowd.values(|s, lane| {
                    three(&s.sky, sky::SEEN, lane)
                        + three(&s.sky, sky::SUNKEN, lane) * open(s, lane)
                })
            } else {
                Vec::new()
            },
            illumination: if wanted.environment.is_some_and(|sky| sky.with_direction) {
                crowd.values(|s, lane| three(&s.sky, sky::TOWARDS, lane))
            } else {
                Vec::new()
            },
            harmonics: if wanted.harmonics {
                let at = |s: &crowd::Sums, lane: usize| {
                    let coefficient = |k: usize| s.channels[self.weighted + k][lane];
                    Sh9(std::array::from_fn(|k| coefficient(k) * solid_angle))
                };
                crowd.values(at)
            } else {
                Vec::new()
            },
        }
    }
}

#[cfg(test)]
mod tests;
