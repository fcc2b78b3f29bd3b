//! A stage read at one time and made ready to be lit: scene, materials, rays, lights.

use super::report::{Report, timed};
use super::{Dome, Error, StageJob};
use crate::diagnostics::Diagnostics;
use crate::displacement;
use crate::lighting::{LightSamples, Lighting};
use crate::results::Aov;
use crate::scene::{Light, LightGroup, LightKind, Linked, ParticleSet, Scene};
use crate::shading::Shader;
use crate::stage::passes::Surfaces;
use crate::stage::raw::RawStage;
use crate::stage::{self, ReadSettings, Source};
use crate::trace::Tracer;
use glam::{Affine3A, Vec3};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a job has to read besides geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Needs {
    /// Materials, display colors, textures.
    pub materials: bool,
    /// What lets light through or is displaced.
    pub solidity: bool,
    /// Lights.
    pub lights: bool,
    /// What is glossy about materials.
    pub gloss: bool,
    /// What results may err by.
    pub tolerance: Option<f64>,
}

impl Needs {
    /// Materials and lights.
    pub(super) const ALL: Self = Self {
        materials: true,
        solidity: true,
        lights: true,
        gloss: true,
        tolerance: None,
    };

    /// The same for results that may err by `tolerance`.
    pub(super) fn within(self, tolerance: Option<f64>) -> Self {
        Self { tolerance, ..self }
    }

    /// The same where receivers are looked at: `color` holds what they reflect glossily.
    pub(super) fn of_seen(aovs: &[Aov]) -> Self {
        let needs = Self::of(aovs);
        Self {
            gloss: needs.gloss || aovs.contains(&Aov::Color),
            ..needs
        }
    }

    /// What `aovs` need: occlusion reads neither lights nor, where nothing lets light through or is displaced, materials.
    pub(super) fn of(aovs: &[Aov]) -> Self {
        let light = aovs
            .iter()
            .any(|aov| aov.needs_direct() || aov.needs_environment() || aov.needs_indirect());
        Self {
            materials: light || aovs.iter().any(|aov| aov.needs_material()),
            solidity: true,
            lights: light,
            gloss: aovs.iter().any(|aov| aov.needs_gloss()),
            tolerance: None,
        }
    }
}

/// The reader's settings for `job` at `time`.
pub(super) fn read_settings(job: &StageJob, time: Option<f64>, needs: Needs) -> ReadSettings {
    ReadSettings {
        time,
        purposes: job.purposes.clone(),
        mask: job.mask.clone(),
        composition: job.composition.clone(),
        materials: needs.materials,
        solidity: needs.solidity,
        lights: needs.lights,
        render_settings: job.settings.clone(),
        ..ReadSettings::default()
    }
}

/// The stage of `source` as [`stage::compose`] has it; where only solidity is asked for, `settings` ask for materials from here
/// on if something lets light through or is displaced.
///
/// # Errors
/// Whatever reading reports.
pub(super) fn compose(
    source: &mut dyn Source,
    settings: &mut ReadSettings,
    diagnostics: &Diagnostics,
) -> Result<RawStage, Error> {
    let raw = stage::compose(source, settings, diagnostics)?;
    let matters = || stage::opacity::may_pass(&raw) || stage::displacement::may_displace(&raw);
    if settings.materials || !settings.solidity || !matters() {
        return Ok(raw);
    }
    settings.materials = true;
    let mut whole = stage::compose(source, settings, diagnostics)?;
    whole.meta.read.attributes += raw.meta.read.attributes;
    whole.meta.read.bytes += raw.meta.read.bytes;
    Ok(whole)
}

/// A scene with everything that is made from it once.
#[derive(Debug)]
pub(super) struct World<'a> {
    /// Materials of [`Self::scene`].
    pub shader: &'a Shader<'a>,
    /// Rays.
    pub tracer: Arc<Tracer>,
    /// Lights; none when the job needs none.
    pub lighting: Lighting,
    /// Those of `lighting`.
    pub samples: LightSamples,
    /// Sources told apart, all of them in one group each; empty where nobody asks for that.
    pub groups: &'a [LightGroup],
}

impl<'a> World<'a> {
    /// The scene.
    pub(super) fn scene(&self) -> &'a Scene {
        self.shader.scene()
    }

    /// The same world where nothing but what `shader` lets shine does.
    pub(super) fn lit_by<'b>(
        &self,
        shader: &'b Shader<'b>,
        diagnostics: &Diagnostics,
    ) -> World<'b> {
        World {
            shader,
            tracer: Arc::clone(&self.tracer),
            lighting: Lighting::new(shader, self.samples, diagnostics),
            samples: self.samples,
            groups: &[],
        }
    }
}

/// A stage that is read at several times, and what these have in common.
#[derive(Debug)]
pub(super) struct Frames {
    source: Box<dyn Source>,
    /// None where there is one time only.
    surfaces: Option<Surfaces>,
}

impl Frames {
    /// The stage of `source`, to be read at `count` times.
    pub(super) fn of(mut source: Box<dyn Source>, count: usize) -> Self {
        source.expect_loads(count);
        Self {
            source,
            surfaces: (count > 1).then(Surfaces::default),
        }
    }

    /// Where it is read from.
    pub(super) fn source(&self) -> &dyn Source {
        self.source.as_ref()
    }

    fn scene(
        &mut self,
        raw: &mut RawStage,
        settings: &ReadSettings,
        diagnostics: &Diagnostics,
    ) -> Result<Scene, stage::Error> {
        match &mut self.surfaces {
            Some(kept) => stage::passes::scene_keeping(raw, settings, kept, diagnostics),
            None => stage::passes::scene_of_spent(raw, settings, diagnostics),
        }
    }
}

/// Read `job`'s stage from `source` at `time`, prepare it, and hand it to `work`. Seconds count as `read`.
pub(super) fn with_world<T>(
    source: &mut Frames,
    (job, time, needs): (&StageJob, Option<f64>, Needs),
    report: &mut Report,
    diagnostics: &Diagnostics,
    work: impl FnOnce(&World<'_>, &mut Report) -> Result<T, Error>,
) -> Result<T, Error> {
    let mut seconds = 0.0;
    let (scene, groups) = timed(&mut seconds, || {
        let _phase = diagnostics.phase("read", "stage", 0);
        let mut settings = read_settings(job, time, needs);
        settings.materials |= report.reads_materials;
        let mut raw = compose(source.source.as_mut(), &mut settings, diagnostics)?;
        report.reads_materials = settings.materials;
        report.read.add(&raw.meta);
        let mut scene = source.scene(&mut raw, &settings, diagnostics)?;
        report
            .read
            .add_images(displacement::displace(&mut scene, diagnostics).into_iter());
        let mut groups = Vec::new();
        if needs.lights {
            scene.lights.extend(job.dome.as_ref().map(dome_light));
            for path in &job.emitters {
                let found = stage::cloud::read_particles(path, scene.origin, diagnostics)?;
                scene.lights.extend(found.into_iter().map(particle_light));
            }
            groups = stage::passes::light_groups((&raw, &scene), &job.light_groups, diagnostics);
        }
        Ok::<_, Error>((scene, groups))
    })?;
    if scene.triangle_count() == 0 {
        return Err(Error::NothingToLight {
            path: scene.stage.path,
        });
    }
    let shader = timed(&mut seconds, || match needs {
        Needs { gloss: true, .. } => Shader::glossy(&scene, diagnostics),
        Needs {
            materials: true, ..
        } => Shader::new(&scene, diagnostics),
        _ => Shader::of_opacity(&scene, diagnostics),
    });
    let samples = LightSamples::within(needs.tolerance);
    let world = timed(&mut seconds, || World {
        tracer: Arc::new(Tracer::among(&scene, shader.opacity(), |_| true)),
        lighting: Lighting::new(&shader, samples, diagnostics),
        samples,
        shader: &shader,
        groups: &groups,
    });
    let images = shader.images().map(Path::to_owned);
    report
        .read
        .add_images(images.chain(light_images(&scene.lights)));
    report.seconds.read += seconds;
    report.usd.clone_from(&scene.stage.reader);
    report.counts.prims = report.counts.prims.max(scene.prims.len());
    report.counts.triangles = report.counts.triangles.max(scene.triangle_count());
    if needs.lights && world.lighting.is_dark() {
        let message = "nothing on the stage shines: all light is black (--dome 1 adds a white sky)";
        diagnostics.warn("no-light", scene.stage.path.display().to_string(), message);
    }
    diagnostics.check()?;
    work(&world, report)
}

/// Image files that `lights` shine with.
pub(super) fn light_images(lights: &[Light]) -> impl Iterator<Item = PathBuf> {
    lights.iter().filter_map(|light| match &light.kind {
        LightKind::Rect { texture, .. } | LightKind::Dome { texture } => texture.clone(),
        _ => None,
    })
}

/// Particles of a cloud as a light of the scene.
fn particle_light((path, set): (String, ParticleSet)) -> Light {
    Light {
        path,
        kind: LightKind::Particles(Arc::new(set)),
        ..dome_light(&Dome::Uniform(1.0))
    }
}

/// `--dome` as a light of the scene.
fn dome_light(dome: &Dome) -> Light {
    let (radiance, texture) = match dome {
        Dome::Uniform(radiance) => (*radiance, None),
        Dome::Image(path) => (1.0, Some(path.clone())),
    };
    Light {
        path: "--dome".to_owned(),
        kind: LightKind::Dome { texture },
        radiance: Vec3::splat(radiance),
        normalize: false,
        world_from_light: Affine3A::IDENTITY,
        shaping: None,
        casts_shadows: true,
        lit: Linked::All,
        blockers: Linked::All,
    }
}
