//! What a gather of one frame stands on: the scene, its light, its receivers, and the engines over them.

use super::gather::Light;
use super::interpolated::InterpolatedMethod;
use super::job::{GatherJob, Part};
use super::maps::{MapsKnobs, MapsMethod, Promise, Rays};
use super::raster::RasterMethod;
use super::spacing::{Lit, Relit};
use super::world::World;
use crate::bounce::Bounces;
use crate::gather::maps::MapsPlan;
use crate::gather::paper::{PaperEngine, PaperSettings};
use crate::gather::rays::lobe::Lobes;
use crate::gather::{
    Engine, GatherScene, HitLight, RadianceSource, RaysEngine, RaysSettings, ThinEngines, Thinning,
};
use crate::lighting::Lighting;
use crate::octree::Octree;
use crate::pilot::Method;
use crate::receivers::Receivers;
use crate::results::Aov;
use crate::scene::PrimId;
use crate::surfels::SurfelCloud;
use std::cell::OnceCell;

/// Rays into a cone at least: all receivers have the same, and fewer print their pattern into what fades with distance (16
/// in the room of `examples`, whose error they kept below 2 %).
const LEAST_CONE_RAYS: u32 = 64;

/// Everything a gather of one frame stands on.
pub(super) struct Stand<'a> {
    world: &'a World<'a>,
    light: &'a Light,
    /// Surfels only tell which sides reflect.
    at_hits: bool,
    /// Of each AOV.
    pub(super) surfel_errors: Vec<f64>,
    source: Option<RadianceSource<'a>>,
    octree: OnceCell<Octree>,
    maps_plan: OnceCell<MapsPlan<'a>>,
    thinning: OnceCell<Option<Thinning>>,
    /// Part of the hemisphere that is asked about: by rays alone, if it is not the whole.
    pub(super) part: Part,
    pub(super) receivers: &'a Receivers,
    pub(super) aovs: &'a [Aov],
    pub(super) job: &'a GatherJob,
}

impl<'a> Stand<'a> {
    pub(super) fn new(
        world: &'a World<'a>,
        lit: &'a Lit,
        receivers: &'a Receivers,
        aovs: &'a [Aov],
        job: &'a GatherJob,
    ) -> Self {
        Self {
            world,
            light: &lit.light,
            at_hits: lit.relit == Relit::All,
            surfel_errors: aovs.iter().map(|&aov| lit.error_of(aov)).collect(),
            source: match lit.relit {
                Relit::All => lit.light.at_hits(world, &world.lighting),
                Relit::Near(radii) => lit.light.source(world, (job.bounces, radii)),
            },
            octree: OnceCell::new(),
            maps_plan: OnceCell::new(),
            thinning: OnceCell::new(),
            part: Part::Whole,
            receivers,
            aovs,
            job,
        }
    }

    /// The same, asked as `job` does.
    pub(super) fn asked_as(self, job: &'a GatherJob) -> Self {
        Self { job, ..self }
    }

    /// The same, asked about `part`.
    pub(super) fn about(self, part: Part) -> Self {
        Self { part, ..self }
    }

    /// True if a part of the hemisphere is asked about.
    pub(super) fn is_partial(&self) -> bool {
        self.part != Part::Whole
    }

    /// True if only rays know about what is asked about: a part of the hemisphere, surfaces that let light through, or places
    /// on no surface.
    pub(super) fn needs_rays(&self) -> bool {
        let is_on_surfaces = self.receivers.prim.first() != Some(&PrimId::NONE.0);
        self.is_partial() || self.world.tracer.has_screens() || !is_on_surfaces
    }

    pub(super) fn world(&self) -> &'a World<'a> {
        self.world
    }

    pub(super) fn light(&self) -> &'a Light {
        self.light
    }

    /// What lights hits anew that are too near to read surfels.
    pub(super) fn near_light(&self) -> Option<HitLight<'a>> {
        match &self.source {
            Some(RadianceSource::Baked(surfels)) => surfels.near(),
            _ => None,
        }
    }

    pub(super) fn scene(&self) -> GatherScene<'a> {
        GatherScene {
            shader: self.world.shader,
            tracer: &self.world.tracer,
            lighting: Some(&self.world.lighting),
        }
    }

    pub(super) fn rays_settings(&self, rays: u32) -> RaysSettings {
        let (cone, least) = match self.part {
            Part::Cone(cone) => (Some(cone), LEAST_CONE_RAYS),
            Part::Whole | Part::Lobes => (None, 1),
        };
        RaysSettings {
            rays: rays.max(least),
            max_distance: self.job.max_distance,
            cone,
            ..RaysSettings::default()
        }
    }

    pub(super) fn rays_with(&self, settings: RaysSettings) -> RaysEngine<'a> {
        let engine = RaysEngine::new(&self.world.tracer, self.source.clone(), settings);
        if self.part != Part::Lobes {
            return engine;
        }
        let lobes = Lobes {
            shader: self.world.shader,
            lighting: Some(&self.world.lighting),
            tracer: &self.world.tracer,
        };
        engine.of_lobes(lobes, settings)
    }

    /// How rays see where pixels have many receivers, if a tolerance of these is to be met, as far as it is known before any errors
    /// are.
    pub(super) fn thinning(&self) -> Option<&Thinning> {
        self.thinning
            .get_or_init(|| self.thinned(RaysSettings::LAW))
            .as_ref()
    }

    fn thinned(&self, law: f64) -> Option<Thinning> {
        let asks_error = self.aovs.iter().any(|aov| aov.error_of().is_some());
        let is_asked = self.job.tolerance.is_some() && self.job.interpolate;
        if !is_asked || asks_error || self.is_partial() {
            return None;
        }
        Thinning::of(&self.receivers.target, self.receivers.len(), law)
    }

    /// Who sees where pixels have many receivers, with part of so many rays, of which errors fall by this `law`.
    pub(super) fn thin_rays(&self, (rays, law): (u32, f64)) -> Option<ThinEngines<'a>> {
        let settings = self.rays_settings(rays);
        let engine = |class, glance| {
            let engine = self.rays_with(settings.thinned(class, glance));
            Box::new(engine) as Box<dyn Engine + 'a>
        };
        Some(ThinEngines::new(self.thinned(law)?, &engine))
    }

    /// Rays that find light anew at whatever they hit: truth for one reflection, but for noise. `None` where a few rays
    /// can't light a place.
    pub(super) fn rays_lit_at_hits<'s>(
        &'s self,
        lighting: &'s Lighting,
        settings: RaysSettings,
    ) -> Option<RaysEngine<'s>> {
        let source = (self.job.bounces == Bounces::Count(1))
            .then(|| self.light.at_hits(self.world, lighting))
            .flatten()?;
        Some(RaysEngine::new(&self.world.tracer, Some(source), settings))
    }

    /// The paper's engine with these knobs: solid angle and resolution. Builds the octree if nobody has.
    pub(super) fn paper(
        &self,
        (max_solid_angle, raster_resolution): (f32, u32),
    ) -> PaperEngine<'_> {
        let settings = PaperSettings {
            max_solid_angle,
            raster_resolution,
            max_distance: self.job.max_distance,
        };
        PaperEngine::new(self.octree(), settings)
    }

    /// The raster engine with these knobs, solid angle and resolution, and rays for what it does not tell. Builds the
    /// octree if nobody has.
    pub(super) fn raster(&self, knobs: (f32, u32), rays: u32) -> RasterMethod<'_> {
        let others = self.rays_with(self.rays_settings(rays));
        RasterMethod::new(self, knobs, others)
    }

    /// Maps with these knobs, and rays for the rest.
    pub(super) fn maps<'s>(
        &'s self,
        knobs: &MapsKnobs,
        promise: Option<Promise>,
    ) -> MapsMethod<'s> {
        // Whoever is handed over asks for the sky alone: rays that need not know what they hit are faster.
        let of_sky = |settings| RaysEngine::new(&self.world.tracer, None, settings);
        let of_light = |settings| self.rays_with(settings);
        let tolerance = self.job.tolerance.filter(|_| self.job.interpolate);
        let seen = |rays: u32, speak: bool, engine: &dyn Fn(RaysSettings) -> RaysEngine<'s>| {
            let settings = self.rays_settings(rays);
            match tolerance.filter(|_| speak) {
                Some(tolerance) => {
                    let (seeing, promise) = ((settings, engine), promise.clone());
                    let method = InterpolatedMethod::between(seeing, (tolerance, 0), promise);
                    Box::new(method) as Box<dyn Method + 's>
                }
                None => Box::new(engine(settings)),
            }
        };
        let rays = Rays {
            handed_over: of_sky(self.rays_settings(knobs.handed_over)),
            instead: seen(knobs.handed_over, knobs.few_see, &of_sky),
            others: seen(knobs.others, true, &of_light),
        };
        MapsMethod::new((self.maps_plan(), knobs), rays, promise)
    }

    /// What maps draw, looked at when first asked for.
    pub(super) fn maps_plan(&self) -> &MapsPlan<'a> {
        self.maps_plan
            .get_or_init(|| MapsPlan::new(self.world.scene()))
    }

    /// Surfels that tell light: 0 where none is asked for, or hits are lit anew.
    pub(super) fn surfel_count(&self) -> usize {
        if self.at_hits { 0 } else { self.light.len() }
    }

    /// The octree over all surfels, built when first asked for.
    pub(super) fn octree(&self) -> &Octree {
        self.octree
            .get_or_init(|| Octree::new(&whole_cloud(self.light)))
    }

    pub(super) fn node_count(&self) -> usize {
        self.octree.get().map_or(0, Octree::node_count)
    }
}

/// All surfels as one cloud for the octree.
fn whole_cloud(light: &Light) -> SurfelCloud {
    match light {
        Light::None => SurfelCloud::default(),
        Light::Baked(baked) => baked.cloud.clone(),
        Light::Loaded(clouds) => SurfelCloud::joined(clouds),
    }
}
