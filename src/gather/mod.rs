//! Octree or scene × [`Receivers`] → [`Results`]. PBGI §6.
//!
//! An [`Engine`] fills a [`Hemisphere`] for every receiver; the [`quantities`] read all AOVs off it in one pass.

mod at_hits;
mod environment;
pub mod estimate;
mod known;
mod neighbors;
pub mod quantities;
pub mod radiance;
mod ray_query;
pub mod rays;
#[cfg(test)]
pub(crate) mod testing;

pub use at_hits::HitLight;
pub use estimate::{ErrorEstimate, Reference, estimate};
pub use known::KnownEngine;
pub use radiance::{DicedSurfels, LoadedCloud, RadianceSource};
pub use raster::{RasterEngine, RasterSettings};
pub use rays::{CloudRays, RaysEngine, RaysSettings};
pub use thin::{Class, Glance, ThinEngines, Thinning};

pub mod maps;
pub mod paper;
pub mod raster;
mod thin;
pub mod traverse;

use crate::diagnostics::{Cancelled, Diagnostics};
use crate::lighting::{Lighting, ShadePoint, SkyLight};
use crate::receivers::Receivers;
use crate::results::{Aov, AovBuffer, Results};
use crate::shading::{Shader, Surface};
use crate::surfels::SurfelCloud;
use crate::trace::Tracer;
use environment::Environment;
use glam::Vec3;
use quantities::{Seen, irradiance};
use rayon::prelude::*;
use std::fmt::Debug;
use std::ops::Range;

/// What one receiver sees: directions that share its hemisphere.
#[derive(Debug, Clone, Default)]
pub struct Hemisphere {
    /// Unit world directions from the receiver.
    pub direction: Vec<Vec3>,
    /// Cosine-weighted solid angle of each, sr; all sum to π.
    pub weight: Vec<f32>,
    /// How much of it is covered by surfaces, 0…1 (rays: 0 or 1).
    pub coverage: Vec<f32>,
    /// Distance to what covers it, `INFINITY` where nothing does.
    pub distance: Vec<f32>,
    /// Reflected radiance (without emission) that arrives from what covers it, already times `coverage`.
    pub reflected: Vec<Vec3>,
    /// Emitted radiance that arrives from what covers it, already times `coverage`.
    pub emitted: Vec<Vec3>,
}

impl Hemisphere {
    /// Forget all directions, keep the memory.
    pub fn clear(&mut self) {
        self.direction.clear();
        self.weight.clear();
        self.coverage.clear();
        self.distance.clear();
        self.reflected.clear();
        self.emitted.clear();
    }
}

/// How receivers see the scene.
pub trait Engine: Sync + Debug {
    /// Fill a hemisphere for each receiver of `block` in turn and hand it to `visit` with the receiver's index.
    /// `scratch` is reused between blocks of one thread.
    fn see(
        &self,
        receivers: &Receivers,
        block: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    );

    /// `rays`, `paper`, …
    fn name(&self) -> &'static str;

    /// Nothing beyond this distance, stage units, covers or lights.
    fn max_distance(&self) -> f32 {
        f32::INFINITY
    }

    /// Receivers a unit of parallel work: few where each takes long, so that a run can be cancelled soon. At most
    /// 64.
    fn block_size(&self) -> usize {
        BLOCK
    }

    /// Look at all of `receivers` before any block is seen, where what one sees is found out together with others: an
    /// engine that knows the answers. `None`: every block is seen for itself.
    ///
    /// # Errors
    /// When cancelled.
    fn survey(
        &self,
        _receivers: &Receivers,
        _diagnostics: &Diagnostics,
    ) -> Result<Option<Box<dyn Engine + '_>>, Cancelled> {
        Ok(None)
    }

    /// True if hemispheres tell how far away what covers a direction is; else that is 0.
    fn tells_distances(&self) -> bool {
        false
    }

    /// True if a block is seen the faster the nearer to each other its receivers are: [`gather`] then hands neighbors
    /// over together, in receivers of their own. What one sees must not depend on the others beyond the engine's error.
    fn gains_from_neighbors(&self) -> bool {
        false
    }
}

/// What comes of a gather at a cloud.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pass {
    /// It is reflected and gathered again, so that surfaces take most of its error away.
    Early,
    /// It stays.
    Last,
}

/// Gathers the light that a cloud reflects; for `bounce`, whose clouds change from one iteration to the next.
pub trait CloudGather: Sync + Debug {
    /// Irradiance, radiance·sr, at each of `receivers` from the light that `cloud` reflects.
    ///
    /// # Errors
    /// When cancelled.
    fn irradiance(
        &self,
        cloud: &SurfelCloud,
        receivers: &Receivers,
        pass: Pass,
        diagnostics: &Diagnostics,
    ) -> Result<Vec<Vec3>, Cancelled>;
}

/// What a gather works with.
#[derive(Debug, Clone, Copy)]
pub struct GatherScene<'a> {
    /// Materials.
    pub shader: &'a Shader<'a>,
    /// Rays.
    pub tracer: &'a Tracer,
    /// Sources; `None` when no AOV asks for light.
    pub lighting: Option<&'a Lighting>,
}

/// Receivers a unit of parallel work: enough to hide its overhead, few enough to balance small runs and to be
/// cancelled between.
pub(crate) const BLOCK: usize = 64;

/// Compute `aovs` at every receiver, one buffer each in the order given. The same bits for any number of threads.
///
/// Light of a kind that `scene` has no sources for is black. `depth` is 0 for receivers that no camera placed.
///
/// # Errors
/// When cancelled.
pub fn gather(
    scene: GatherScene<'_>,
    engine: &dyn Engine,
    receivers: &Receivers,
    aovs: &[Aov],
    diagnostics: &Diagnostics,
) -> Result<Results, Cancelled> {
    let work = Work::plan(scene, aovs);
    let surveyed = match work.hemisphere {
        true => engine.survey(receivers, diagnostics)?,
        false => None,
    };
    let is_surveyed = surveyed.is_some();
    let engine = surveyed.as_deref().unwrap_or(engine);
    let phase = diagnostics.phase("gather", "receivers", receivers.len() as u64);
    let mut results = empty_results(aovs, receivers.len());
    let order = (work.gains_from_neighbors(engine))
        .then(|| neighbors::order(&receivers.position, &receivers.normal));
    let size = block_size(engine, receivers.len());
    split(&mut results, receivers.len(), size)
        .into_par_iter()
        .try_for_each_init(Hemisphere::default, |scratch, mut block| {
            diagnostics.check()?;
            let count = block.range.len();
            if let Some(order) = &order {
                let places = &order[block.range];
                let block_receivers = receivers.subset(places);
                block.range = 0..count;
                let placed = Placed {
                    engine,
                    receivers,
                    places,
                };
                let engine = if is_surveyed { &placed } else { engine };
                work.fill(engine, &block_receivers, &mut block, scratch);
            } else {
                work.fill(engine, receivers, &mut block, scratch);
            }
            phase.advance(count as u64);
            Ok(())
        })?;
    if let Some(order) = order {
        for buffer in &mut results.buffers {
            buffer.data = neighbors::undo(&order, &buffer.data, buffer.aov.components());
        }
    }
    Ok(results)
}

/// What [`read`] takes from each receiver's hemisphere: so many floats, written by a function of the receiver's index.
pub type Reading<'a> = (usize, &'a (dyn Fn(usize, &Hemisphere, &mut [f32]) + Sync));

/// Hand the hemisphere of every receiver to a function and collect what that makes of it, one receiver after the other. The
/// same bits for any number of threads.
///
/// # Errors
/// When cancelled.
pub fn read(
    engine: &dyn Engine,
    receivers: &Receivers,
    (floats, reading): Reading<'_>,
    diagnostics: &Diagnostics,
) -> Result<Vec<f32>, Cancelled> {
    let surveyed = engine.survey(receivers, diagnostics)?;
    let engine = surveyed.as_deref().unwrap_or(engine);
    let order = match engine.gains_from_neighbors() {
        true => neighbors(receivers),
        false => (0..receivers.len()).collect(),
    };
    let phase = diagnostics.phase("gather", "receivers", receivers.len() as u64);
    let block_size = block_size(engine, receivers.len());
    let mut values = vec![0.0; floats * receivers.len()];
    (values.par_chunks_mut(floats * block_size))
        .zip(order.par_chunks(block_size))
        .try_for_each_init(Hemisphere::default, |scratch, (values, places)| {
            diagnostics.check()?;
            let placed = Placed {
                engine,
                receivers,
                places,
            };
            let few = receivers.subset(places);
            let engine = if surveyed.is_some() { &placed } else { engine };
            engine.see(&few, 0..places.len(), scratch, &mut |i, hemisphere| {
                reading(places[i], hemisphere, &mut values[i * floats..][..floats]);
            });
            phase.advance(places.len() as u64);
            Ok(())
        })?;
    Ok(neighbors::undo(&order, &values, floats))
}

/// Irradiance, radiance·sr, at each of `receivers` from the light that surfaces reflect, as `engine` sees it.
///
/// # Errors
/// When cancelled.
pub fn irradiance(
    engine: &dyn Engine,
    receivers: &Receivers,
    diagnostics: &Diagnostics,
) -> Result<Vec<Vec3>, Cancelled> {
    let reading = |_: usize, seen: &Hemisphere, out: &mut [f32]| {
        out.copy_from_slice(&irradiance::indirect(seen).to_array());
    };
    let values = read(engine, receivers, (3, &reading), diagnostics)?;
    Ok(bytemuck::cast_slice(&values).to_vec())
}

/// An engine that knows what all of `receivers` see, asked about those in `places`.
#[derive(Debug)]
struct Placed<'a> {
    engine: &'a dyn Engine,
    receivers: &'a Receivers,
    places: &'a [usize],
}

impl Engine for Placed<'_> {
    fn see(
        &self,
        _few: &Receivers,
        block: Range<usize>,
        scratch: &mut Hemisphere,
        visit: &mut dyn FnMut(usize, &Hemisphere),
    ) {
        for i in block {
            let place = self.places[i];
            let mut visit = |_: usize, seen: &Hemisphere| visit(i, seen);
            (self.engine).see(self.receivers, place..place + 1, scratch, &mut visit);
        }
    }

    fn name(&self) -> &'static str {
        self.engine.name()
    }

    fn max_distance(&self) -> f32 {
        self.engine.max_distance()
    }
}

/// Indices of `receivers` in the order in which [`gather`] hands them over where an engine gains from neighbors: those next
/// to each other in space follow each other.
pub fn neighbors(receivers: &Receivers) -> Vec<usize> {
    neighbors::order(&receivers.position, &receivers.normal)
}

/// Receivers that tell what some of them see where neighbors share work: as many as do so in a run, if there are enough for
/// that, and at least and at most.
const ONE_GROUP_OF: usize = 640;
pub(crate) const GROUP: usize = 2 * BLOCK;
const LARGEST_GROUP: usize = 16 * GROUP;

/// The groups of neighbors, cut from [`neighbors`], that have any of `picks` in them, each a 640th of all, of 128 to 2048:
/// indices of all their members among `receivers`, whole groups in order, and where among these each of `picks` is.
pub fn groups(receivers: &Receivers, picks: &[usize]) -> (Vec<usize>, Vec<usize>) {
    let size = (receivers.len() / ONE_GROUP_OF).clamp(GROUP, LARGEST_GROUP);
    let order = neighbors(receivers);
    let mut place_of = vec![0; order.len()];
    for (place, &i) in order.iter().enumerate() {
        place_of[i] = place;
    }
    let mut groups: Vec<usize> = picks.iter().map(|&i| place_of[i] / size).collect();
    groups.sort_unstable();
    groups.dedup();
    let members = |group: &usize| group * size..((group + 1) * size).min(order.len());
    let all: Vec<usize> = groups.iter().flat_map(members).collect();
    let place = |&i: &usize| all.partition_point(|&place| place < place_of[i]);
    let places = picks.iter().map(place).collect();
    (all.iter().map(|&place| order[place]).collect(), places)
}

/// Receivers a block of `count`: as many as `engine` takes, or fewer where that would leave threads without work.
fn block_size(engine: &dyn Engine, count: usize) -> usize {
    let most = engine.block_size().clamp(1, BLOCK);
    let threads = rayon::current_num_threads();
    let rounds = count.div_ceil(threads * most).max(1);
    count.div_ceil(threads * rounds).max(1)
}

/// Zeros for `count` receivers.
fn empty_results(aovs: &[Aov], count: usize) -> Results {
    let buffer = |&aov: &Aov| AovBuffer {
        aov,
        data: vec![0.0; count * aov.components()],
    };
    Results {
        buffers: aovs.iter().map(buffer).collect(),
        ..Results::default()
    }
}

/// Some neighboring receivers and the places for their values.
struct Block<'a> {
    range: Range<usize>,
    /// One slice an AOV.
    values: Vec<(Aov, &'a mut [f32])>,
}

/// Cut the buffers of `results` into blocks, so that threads write into their places without copies.
fn split(results: &mut Results, count: usize, block_size: usize) -> Vec<Block<'_>> {
    let mut blocks: Vec<_> = (0..count)
        .step_by(block_size)
        .map(|start| Block {
            range: start..(start + block_size).min(count),
            values: Vec::new(),
        })
        .collect();
    for buffer in &mut results.buffers {
        let chunks = buffer.data.chunks_mut(block_size * buffer.aov.components());
        for (block, chunk) in blocks.iter_mut().zip(chunks) {
            block.values.push((buffer.aov, chunk));
        }
    }
    blocks
}

/// True if `aov`, under `lighting`, hangs on which directions are open and not only on the light that surfaces reflect.
pub fn asks_open(aov: Aov, lighting: Option<&Lighting>) -> bool {
    let environment = lighting.filter(|lighting| lighting.has_environment());
    let is_even = environment.is_some_and(|light| light.uniform_environment().is_some());
    let is_unlit = environment.is_none() && aov == Aov::IlluminationDirection;
    aov.is_openness()
        || aov.error_of().is_some()
        || is_unlit
        || (is_even && aov.needs_environment())
}

/// What has to be computed at every receiver for the AOVs asked for, and nothing else.
struct Work<'a> {
    scene: GatherScene<'a>,
    material: bool,
    direct: Option<&'a Lighting>,
    environment: Environment<'a>,
    indirect: bool,
    hemisphere: bool,
}

impl<'a> Work<'a> {
    fn plan(scene: GatherScene<'a>, aovs: &[Aov]) -> Self {
        let any = |asks: fn(Aov) -> bool| aovs.iter().any(|&aov| asks(aov));
        let asked = any(Aov::needs_environment);
        let environment = Environment::plan(scene.lighting.filter(|_| asked), aovs);
        let indirect = any(Aov::needs_indirect);
        let openness = any(|aov| {
            aov.is_openness() || aov == Aov::ReflectionOcclusion || aov.error_of().is_some()
        });
        Self {
            scene,
            material: any(Aov::needs_material),
            direct: scene.lighting.filter(|_| any(Aov::needs_direct)),
            environment,
            indirect,
            hemisphere: indirect || openness || environment.needs_hemisphere(),
        }
    }

    /// True if a block takes the less time the nearer to each other its receivers are.
    fn gains_from_neighbors(&self, engine: &dyn Engine) -> bool {
        let sees = self.hemisphere && engine.gains_from_neighbors();
        sees || self.environment.looks_together()
    }

    fn fill(
        &self,
        engine: &dyn Engine,
        receivers: &Receivers,
        block: &mut Block<'_>,
        scratch: &mut Hemisphere,
    ) {
        let start = block.range.start;
        let points: Vec<ShadePoint> = (block.range.clone())
            .map(|i| self.point(receivers, i))
            .collect();
        let reach = engine.max_distance();
        let sky = (self.environment).look(self.scene.tracer, &points, reach);
        let direct = self.direct(&points);
        let mut visit = |i: usize, hemisphere: &Hemisphere| {
            let light = (self.environment).light(&sky, i - start, hemisphere);
            let direct = direct.get(i - start).copied().unwrap_or_default();
            let seen = self.seen(receivers, i, (direct, light), hemisphere);
            for (aov, values) in &mut block.values {
                let place = (i - start) * aov.components();
                quantities::write(*aov, &seen, &mut values[place..place + aov.components()]);
            }
        };
        if self.hemisphere {
            engine.see(receivers, block.range.clone(), scratch, &mut visit);
        } else {
            scratch.clear();
            block.range.clone().for_each(|i| visit(i, scratch));
        }
    }

    fn point(&self, receivers: &Receivers, i: usize) -> ShadePoint {
        let normals = (receivers.normal[i], receivers.geometric_normal[i]);
        let (scene, position) = (self.scene.shader.scene(), receivers.position[i]);
        ShadePoint::on_mesh(scene, &receivers.surface[i], position, normals)
    }

    fn seen<'s>(
        &self,
        receivers: &'s Receivers,
        i: usize,
        (direct, light): (Vec3, SkyLight),
        hemisphere: &'s Hemisphere,
    ) -> Seen<'s> {
        let seen = Seen {
            receivers,
            index: i,
            hemisphere,
            surface: self.surface(receivers, i),
            direct,
            environment: light.irradiance,
            illumination: light.direction,
            indirect: if self.indirect {
                irradiance::indirect(hemisphere)
            } else {
                Vec3::ZERO
            },
        };
        debug_assert!(
            (seen.direct + seen.environment + seen.indirect).is_finite(),
            "receiver {i} receives light that is not finite: {seen:?}"
        );
        seen
    }

    fn surface(&self, receivers: &Receivers, i: usize) -> Surface {
        if self.material {
            self.scene.shader.surface(&receivers.surface[i])
        } else {
            quantities::BLACK_SURFACE
        }
    }

    /// Irradiance from lights and emissive surfaces at each of `points`; none where nobody asks.
    fn direct(&self, points: &[ShadePoint]) -> Vec<Vec3> {
        let Some(lighting) = self.direct else {
            return Vec::new();
        };
        let mut light = lighting.lights_at(self.scene.tracer, points);
        if lighting.has_emitters() {
            for (light, point) in light.iter_mut().zip(points) {
                *light += lighting.emitters(self.scene.shader, self.scene.tracer, point);
            }
        }
        light
    }
}
