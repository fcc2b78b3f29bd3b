//! The passes that turn a composed stage into a [`Scene`], the same for both doors.

pub mod flatten;
pub mod geometry;
pub mod hermite;
pub mod look;
pub mod skinning;
pub mod xform;

pub use geometry::Surfaces;
pub use look::light_groups::{LightGroupChoice, light_groups};

use super::raw::{RawAttribute, RawMeta, RawPrim, RawStage};
use super::{Error, ReadSettings, VariantChoice};
use crate::diagnostics::Diagnostics;
use crate::scene::{Scene, StageInfo, UpAxis};
use geometry::{Detail, Lent, Making};

/// USD's `metersPerUnit` where none is authored.
const DEFAULT_METERS_PER_UNIT: f64 = 0.01;
/// USD's `timeCodesPerSecond` where none is authored.
const DEFAULT_TIME_CODES_PER_SECOND: f64 = 24.0;

/// Resolve `raw` into a scene.
///
/// # Errors
/// Meshes with invalid topology or points that are not finite; cancellation.
pub fn scene(
    raw: &RawStage,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Result<Scene, Error> {
    let making = Making::Once(Detail::Full);
    Ok(scene_in(Lent::Whole(raw), settings, making, diagnostics)?.0)
}

/// [`scene`] that takes long arrays of meshes out of `raw` as it goes on: it needs little more memory than what comes of it.
///
/// # Errors
/// As [`scene`].
pub fn scene_of_spent(
    raw: &mut RawStage,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Result<Scene, Error> {
    let making = Making::Once(Detail::Full);
    Ok(scene_in(Lent::Spent(raw), settings, making, diagnostics)?.0)
}

/// [`scene`] where several of one stage are made, at different times: the same scene, but surfaces that do not vary are
/// refined for the first of them only, and kept in `surfaces`.
///
/// # Errors
/// As [`scene`].
pub fn scene_keeping(
    raw: &RawStage,
    settings: &ReadSettings,
    surfaces: &mut Surfaces,
    diagnostics: &Diagnostics,
) -> Result<Scene, Error> {
    let making = Making::Keeping(surfaces);
    Ok(scene_in(Lent::Whole(raw), settings, making, diagnostics)?.0)
}

/// [`scene`] with the cages of subdivision surfaces in their place, and how many triangles all that is drawn has in
/// [`scene`]: what there is to tell of a stage, without refining it.
///
/// # Errors
/// As [`scene`].
pub fn outline(
    raw: &RawStage,
    settings: &ReadSettings,
    diagnostics: &Diagnostics,
) -> Result<(Scene, usize), Error> {
    let making = Making::Once(Detail::Cages);
    scene_in(Lent::Whole(raw), settings, making, diagnostics)
}

fn scene_in(
    raw: Lent<'_>,
    settings: &ReadSettings,
    making: Making<'_>,
    diagnostics: &Diagnostics,
) -> Result<(Scene, usize), Error> {
    if settings.time.is_none() {
        warn_of_unread_samples(&raw, diagnostics);
    }
    warn_of_unloaded(&raw, diagnostics);
    let occurrences = flatten::flatten(&raw, settings, diagnostics);
    let layout = geometry::lay_out(&raw, &occurrences, settings, diagnostics)?;
    let look = look::resolve(&raw, &occurrences, layout.origin(), settings, diagnostics);
    let origin = layout.origin();
    let stage = stage_info(&raw.meta, settings, diagnostics);
    let built = layout.build(raw, &look, making, diagnostics)?;
    let of_prims = built
        .prims
        .iter()
        .map(|prim| built.triangles[prim.mesh.index()]);
    let triangles = of_prims.sum();
    let mut scene = Scene {
        stage,
        origin,
        meshes: built.meshes,
        prims: built.prims,
        materials: look.materials,
        lights: look.lights,
        cameras: look.cameras,
        render_settings: look.render_settings,
    };
    look::links::apply(&mut scene, &look.links);
    look::mesh_lights::shine(&mut scene, &look.mesh_lights, diagnostics);
    Ok((scene, triangles))
}

/// Who forgets `--frames` gets an animated stage without what moves: as USD's default time has it, but not in silence.
fn warn_of_unread_samples(raw: &RawStage, diagnostics: &Diagnostics) {
    let unread = |prim: &RawPrim| {
        let attributes = prim.attributes.iter();
        let is_unread = |(name, attribute): &(&String, &RawAttribute)| {
            attribute.varying && attribute.value.is_none() && *name != "extent"
        };
        attributes.filter(is_unread).count()
    };
    let found = raw.prims.iter().map(|prim| (prim, unread(prim)));
    let found: Vec<_> = found.filter(|(_, count)| *count > 0).collect();
    let Some((first, _)) = found.first() else {
        return;
    };
    let count: usize = found.iter().map(|(_, count)| count).sum();
    let prims = found.len();
    let start = raw.meta.start_time_code.unwrap_or(1.0);
    diagnostics.warn(
        "time-samples",
        first.path.clone(),
        format!(
            "{count} attributes of {prims} prims, this one first, have time samples only and no value at the default \
             time; they count as not authored: --frames {start} reads them"
        ),
    );
}

/// Payloads left out by `--load none`: asked for, but what is missing shows in the result.
fn warn_of_unloaded(raw: &RawStage, diagnostics: &Diagnostics) {
    if let Some(first) = raw.meta.unloaded.first() {
        let count = raw.meta.unloaded.len();
        diagnostics.warn(
            "unloaded-payload",
            first.clone(),
            format!(
                "payloads of {count} prims, this one first, are not loaded: what they hold is neither drawn nor lit, and \
                 casts no shadow (--load all brings it in)"
            ),
        );
    }
}

fn stage_info(meta: &RawMeta, settings: &ReadSettings, diagnostics: &Diagnostics) -> StageInfo {
    let positive = |name: &str, authored: Option<f64>, fallback: f64| match authored {
        Some(number) if !(number.is_finite() && number > 0.0) => {
            let message = format!("{name} is {number}, not above 0: {fallback} is used");
            diagnostics.warn("invalid-units", meta.path.to_string_lossy(), message);
            fallback
        }
        authored => authored.unwrap_or(fallback),
    };
    StageInfo {
        path: meta.path.clone(),
        up_axis: match meta.up_axis.as_deref() {
            Some("Z") => UpAxis::Z,
            _ => UpAxis::Y,
        },
        meters_per_unit: positive(
            "metersPerUnit",
            meta.meters_per_unit,
            DEFAULT_METERS_PER_UNIT,
        ),
        default_prim: meta.default_prim.clone(),
        time_range: meta.start_time_code.zip(meta.end_time_code),
        time_codes_per_second: positive(
            "timeCodesPerSecond",
            meta.time_codes_per_second,
            DEFAULT_TIME_CODES_PER_SECOND,
        ),
        time: settings.time,
        layers: meta.layers.clone(),
        variants: settings
            .composition
            .variants
            .iter()
            .map(VariantChoice::parts)
            .collect(),
        reader: meta.reader.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unauthored_metadata_has_usd_fallbacks() {
        let info = stage_info(
            &RawMeta::default(),
            &ReadSettings::default(),
            &Diagnostics::default(),
        );
        assert_eq!(info.up_axis, UpAxis::Y);
        assert_eq!(info.meters_per_unit, 0.01);
        assert_eq!(info.time_codes_per_second, 24.0);
        assert_eq!(info.time_range, None);
    }
}
