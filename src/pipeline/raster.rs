//! The raster engine in a run: reflected light by it, and by rays what asks which directions are open.

use super::gather::Light;
use super::report::Report;
use super::stand::Stand;
use crate::diagnostics::{Cancelled, Diagnostics};
use crate::gather::{self, DicedSurfels, GatherScene, RasterEngine, RasterSettings, RaysEngine};
use crate::pilot::Method;
use crate::receivers::Receivers;
use crate::results::{Aov, Results};

/// Settings that a sweep shows, cheap ones first: solid angle and resolution.
pub(super) const RASTER_KNOBS: [(f32, u32); 5] =
    [(0.4, 8), (0.4, 12), (0.1, 12), (0.05, 16), (0.02, 24)];

/// Rays that judge where no pilot has.
pub(super) const REFERENCE_RAYS: u32 = 1024;

/// What a receiver of the reference costs over one of this engine: measured between 2 and 7.
pub(super) const REFERENCE_COST: u32 = 6;

/// Gathers by the raster engine and rays.
#[derive(Debug)]
pub(super) struct RasterMethod<'a> {
    /// None where there are no surfels.
    engine: Option<RasterEngine<'a>>,
    others: RaysEngine<'a>,
}

impl<'a> RasterMethod<'a> {
    /// Over the surfels of `stand`, with these knobs: solid angle and resolution. Rays for `others`.
    pub(super) fn new(
        stand: &'a Stand<'_>,
        (max_solid_angle, raster_resolution): (f32, u32),
        others: RaysEngine<'a>,
    ) -> Self {
        let settings = RasterSettings {
            max_solid_angle,
            raster_resolution,
            max_distance: stand.job.max_distance,
        };
        let engine = match stand.light() {
            Light::Baked(baked) => {
                let (octree, tracer) = (stand.octree(), &stand.world().tracer);
                let surfels = DicedSurfels::new(&baked.cloud, &baked.dice, stand.near_light());
                Some(RasterEngine::new(octree, tracer, surfels, settings))
            }
            Light::None | Light::Loaded(_) => None,
        };
        Self { engine, others }
    }

    /// Tell `report` who computes what.
    pub(super) fn record(&self, stand: &Stand<'_>, report: &mut Report) {
        let engine = |aov: Aov| {
            let is_open = gather::asks_open(aov, stand.scene().lighting);
            let name = if self.engine.is_none() || is_open {
                "rays"
            } else {
                "raster"
            };
            (aov.name().to_owned(), name.into())
        };
        let asked = stand.aovs.iter().filter(|aov| aov.needs_hemisphere());
        let engines: serde_json::Map<_, _> = asked.map(|&aov| engine(aov)).collect();
        report.set("engines", engines);
    }
}

impl Method for RasterMethod<'_> {
    fn gather(
        &self,
        scene: GatherScene<'_>,
        receivers: &Receivers,
        aovs: &[Aov],
        diagnostics: &Diagnostics,
    ) -> Result<Results, Cancelled> {
        let Some(engine) = &self.engine else {
            return gather::gather(scene, &self.others, receivers, aovs, diagnostics);
        };
        let (by_rays, by_raster): (Vec<Aov>, Vec<Aov>) = aovs
            .iter()
            .partition(|&&aov| gather::asks_open(aov, scene.lighting));
        let mut found = Results::default();
        if !by_raster.is_empty() {
            found = gather::gather(scene, engine, receivers, &by_raster, diagnostics)?;
        }
        if !by_rays.is_empty() {
            let open = gather::gather(scene, &self.others, receivers, &by_rays, diagnostics)?;
            found.buffers.extend(open.buffers);
        }
        Ok(found.in_order_of(aovs))
    }
}
