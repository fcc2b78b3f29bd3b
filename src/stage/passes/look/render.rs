//! UsdRender settings → [`RenderSettings`], each product carrying what it inherits from its settings.

use super::paths::{Paths, name};
use super::values::{Values, narrow};
use crate::diagnostics::Diagnostics;
use crate::scene::{RenderProduct, RenderSettings, RenderVar};
use crate::stage::raw::{RawPrim, RawStage, Value};
use glam::DVec2;

/// Largest width or height accepted, pixels.
const MAX_RESOLUTION: f64 = 65536.0;

/// All RenderSettings prims in traversal order, the one the stage's metadata name first.
pub(super) fn read(
    raw: &RawStage,
    paths: &Paths<'_>,
    diagnostics: &Diagnostics,
) -> Vec<RenderSettings> {
    let is_settings = |prim: &&RawPrim| prim.type_name == "RenderSettings";
    let reader = Reader { paths, diagnostics };
    let stage = &raw.prims[..raw.prototype_start.min(raw.prims.len())];
    let mut all: Vec<RenderSettings> = stage
        .iter()
        .filter(is_settings)
        .map(|prim| reader.settings(prim))
        .collect();
    if let Some(chosen) = &raw.meta.render_settings_prim_path {
        if !all.iter().any(|settings| settings.path == *chosen) {
            let message = "renderSettingsPrimPath names no RenderSettings prim: it is ignored";
            diagnostics.warn("invalid-render-settings", chosen, message);
        }
        all.sort_by_key(|settings| settings.path != *chosen);
    }
    all
}

/// Attributes that settings and products share.
#[derive(Debug, Clone)]
struct Base {
    camera: Option<String>,
    resolution: (u32, u32),
    pixel_aspect_ratio: f32,
    aspect_ratio_conform_policy: String,
    data_window_ndc: [f32; 4],
}

impl Default for Base {
    fn default() -> Self {
        Self {
            camera: None,
            resolution: (2048, 1080),
            pixel_aspect_ratio: 1.0,
            aspect_ratio_conform_policy: "expandAperture".to_owned(),
            data_window_ndc: [0.0, 0.0, 1.0, 1.0],
        }
    }
}

struct Reader<'a> {
    paths: &'a Paths<'a>,
    diagnostics: &'a Diagnostics,
}

impl Reader<'_> {
    fn settings(&self, prim: &RawPrim) -> RenderSettings {
        let base = self.base(prim, Base::default());
        let tokens = |name: &str, fallback: [&str; 2]| match prim.tokens(name) {
            Some(tokens) => tokens.to_vec(),
            None => fallback.map(str::to_owned).to_vec(),
        };
        RenderSettings {
            path: prim.path.clone(),
            camera: base.camera.clone(),
            resolution: base.resolution,
            included_purposes: tokens("includedPurposes", ["default", "render"]),
            material_binding_purposes: tokens("materialBindingPurposes", ["full", ""]),
            products: (self.targets(prim, "products", "RenderProduct").into_iter())
                .map(|product| self.product(product, &base))
                .collect(),
        }
    }

    fn product(&self, prim: &RawPrim, inherited: &Base) -> RenderProduct {
        let base = self.base(prim, inherited.clone());
        let authored_name = prim.token("productName").filter(|name| !name.is_empty());
        RenderProduct {
            path: prim.path.clone(),
            name: authored_name.map_or_else(|| format!("{}.exr", name(&prim.path)), str::to_owned),
            product_type: prim.token("productType").unwrap_or("raster").to_owned(),
            camera: base.camera,
            resolution: base.resolution,
            pixel_aspect_ratio: base.pixel_aspect_ratio,
            aspect_ratio_conform_policy: base.aspect_ratio_conform_policy,
            data_window_ndc: base.data_window_ndc,
            vars: (self.targets(prim, "orderedVars", "RenderVar").into_iter())
                .map(|prim| var(prim))
                .collect(),
        }
    }

    /// What `prim` authors, over `inherited`.
    fn base(&self, prim: &RawPrim, inherited: Base) -> Base {
        let camera = prim
            .relationships
            .get("camera")
            .and_then(|camera| camera.targets.first());
        Base {
            camera: camera.cloned().or(inherited.camera),
            resolution: self.resolution(prim).unwrap_or(inherited.resolution),
            pixel_aspect_ratio: (prim.number("pixelAspectRatio").map(narrow))
                .filter(|ratio| ratio.is_finite() && *ratio > 0.0)
                .unwrap_or(inherited.pixel_aspect_ratio),
            aspect_ratio_conform_policy: prim
                .token("aspectRatioConformPolicy")
                .map_or(inherited.aspect_ratio_conform_policy, str::to_owned),
            data_window_ndc: match prim.value("dataWindowNDC") {
                Some(Value::Vec4(window)) if window.is_finite() => window.as_vec4().to_array(),
                _ => inherited.data_window_ndc,
            },
        }
    }

    fn resolution(&self, prim: &RawPrim) -> Option<(u32, u32)> {
        let Value::Vec2(size) = prim.value("resolution")? else {
            return None;
        };
        let limit = DVec2::splat(MAX_RESOLUTION);
        if size.cmpge(DVec2::ONE).all() && size.cmple(limit).all() {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "1 to 65536"
            )]
            return Some((size.x as u32, size.y as u32));
        }
        let message = format!(
            "resolution {} × {} is not within 1 to 65536: it is ignored",
            size.x, size.y
        );
        self.diagnostics
            .warn("invalid-render-settings", &prim.path, message);
        None
    }

    /// Prims of type `type_name` that relationship `relationship` names, in order; others are warnings.
    fn targets(&self, prim: &RawPrim, relationship: &str, type_name: &str) -> Vec<&RawPrim> {
        let targets = prim.relationships.get(relationship);
        let targets = targets.map_or(&[][..], |relationship| &relationship.targets);
        let found = targets.iter().filter_map(|path| {
            let target = self.paths.find(path).map(|index| self.paths.prim(index));
            let target = target.filter(|target| target.type_name == type_name);
            if target.is_none() {
                let message =
                    format!("{relationship} names {path}, which is no {type_name}: it is left out");
                self.diagnostics
                    .warn("invalid-render-settings", &prim.path, message);
            }
            target
        });
        found.collect()
    }
}

fn var(prim: &RawPrim) -> RenderVar {
    let token = |name: &str, fallback: &str| prim.token(name).unwrap_or(fallback).to_owned();
    let aov = prim
        .token("driver:parameters:aov:name")
        .filter(|aov| !aov.is_empty());
    RenderVar {
        name: aov.unwrap_or(name(&prim.path)).to_owned(),
        source_name: token("sourceName", ""),
        source_type: token("sourceType", "raw"),
        data_type: token("dataType", "color3f"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::Fixture;
    use super::*;

    #[test]
    fn products_inherit_from_settings_what_they_do_not_author() {
        let mut stage = Fixture::default()
            .prim("/Render", "Scope")
            .prim("/Render/other", "RenderSettings")
            .value("resolution", Value::Vec2(DVec2::new(-1.0, 5.0)))
            .prim("/Render/main", "RenderSettings")
            .rel("camera", &["/cam"])
            .rel("products", &["/Render/p", "/Render/q", "/Render/gone"])
            .value("resolution", Value::Vec2(DVec2::new(640.0, 480.0)))
            .number("pixelAspectRatio", 2.0)
            .prim("/Render/p", "RenderProduct")
            .rel("orderedVars", &["/Render/N", "/Render/ao"])
            .prim("/Render/q", "RenderProduct")
            .rel("camera", &["/cam2"])
            .token("productName", "beauty.exr")
            .value("resolution", Value::Vec2(DVec2::new(32.0, 16.0)))
            .prim("/Render/N", "RenderVar")
            .token("sourceName", "Neye")
            .prim("/Render/ao", "RenderVar")
            .token("driver:parameters:aov:name", "occlusion");
        stage.raw.meta.render_settings_prim_path = Some("/Render/main".to_owned());
        let occurrences = stage.occurrences();
        let diagnostics = Diagnostics::default();
        let all = read(
            &stage.raw,
            &Paths::new(&stage.raw, &occurrences),
            &diagnostics,
        );

        assert_eq!(
            all.iter().map(|s| s.path.as_str()).collect::<Vec<_>>(),
            ["/Render/main", "/Render/other"]
        );
        assert_eq!(all[1].resolution, (2048, 1080));
        assert_eq!(all[0].material_binding_purposes, ["full", ""]);
        let [p, q] = all[0].products.as_slice() else {
            panic!("two products")
        };
        assert_eq!(
            (p.name.as_str(), p.camera.as_deref(), p.resolution),
            ("p.exr", Some("/cam"), (640, 480))
        );
        assert_eq!(
            (q.name.as_str(), q.camera.as_deref(), q.resolution),
            ("beauty.exr", Some("/cam2"), (32, 16))
        );
        assert_eq!(q.pixel_aspect_ratio, 2.0);
        let vars: Vec<_> = p
            .vars
            .iter()
            .map(|v| {
                (
                    v.name.as_str(),
                    v.source_name.as_str(),
                    v.data_type.as_str(),
                )
            })
            .collect();
        assert_eq!(
            vars,
            [("N", "Neye", "color3f"), ("occlusion", "", "color3f")]
        );
        assert_eq!(diagnostics.warnings().len(), 2);
    }
}
