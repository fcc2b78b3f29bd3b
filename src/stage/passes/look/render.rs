//! UsdRender settings → [`RenderSettings`], each product carrying what it inherits from its settings.

use super::paths::{Paths, name};
use super::values::{Values, narrow};
use crate::diagnostics::Diagnostics;
use crate::scene::{RenderProduct, RenderSettings, RenderVar};
use crate::stage::bake_settings;
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
    let is_settings = |prim: &&RawPrim| {
        matches!(
            &*prim.type_name,
            "RenderSettings" | bake_settings::TYPE_NAME
        )
    };
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
                .map(var)
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

    fn read_settings(stage: &Fixture) -> (Vec<RenderSettings>, usize) {
        let occurrences = stage.occurrences();
        let diagnostics = Diagnostics::default();
        let paths = Paths::new(&stage.raw, &occurrences);
        let all = read(&stage.raw, &paths, &diagnostics);
        (all, diagnostics.warnings().len())
    }

    #[test]
    fn products_inherit_from_settings_what_they_do_not_author() {
        let stage = Fixture::default()
            .prim("/s", "RenderSettings")
            .rel("camera", &["/cam"])
            .rel("products", &["/p", "/q", "/gone"])
            .value("resolution", Value::Vec2(DVec2::new(640.0, 480.0)))
            .number("pixelAspectRatio", 2.0)
            .prim("/p", "RenderProduct")
            .prim("/q", "RenderProduct")
            .rel("camera", &["/cam2"])
            .token("productName", "beauty.exr")
            .value("resolution", Value::Vec2(DVec2::new(32.0, 16.0)));
        let (all, warnings) = read_settings(&stage);
        let [p, q] = all[0].products.as_slice() else {
            panic!("two products")
        };
        assert_eq!(
            (p.name.as_str(), p.camera.as_deref()),
            ("p.exr", Some("/cam"))
        );
        assert_eq!(
            (q.name.as_str(), q.camera.as_deref()),
            ("beauty.exr", Some("/cam2"))
        );
        assert_eq!((p.resolution, q.resolution), ((640, 480), (32, 16)));
        assert_eq!(
            (q.pixel_aspect_ratio, q.product_type.as_str()),
            (2.0, "raster")
        );
        assert_eq!(warnings, 1, "the product that is gone");
    }

    #[test]
    fn the_settings_that_the_stage_names_come_first_and_fallbacks_are_the_schemas() {
        let mut stage = Fixture::default()
            .prim("/a", "RenderSettings")
            .value("resolution", Value::Vec2(DVec2::new(-1.0, 5.0)))
            .prim("/b", "RenderSettings");
        stage.raw.meta.render_settings_prim_path = Some("/b".to_owned());
        let (all, warnings) = read_settings(&stage);
        assert_eq!([&all[0].path, &all[1].path], ["/b", "/a"]);
        assert_eq!((all[1].resolution, warnings), ((2048, 1080), 1));
        assert_eq!(all[0].material_binding_purposes, ["full", ""]);
        assert_eq!(all[0].included_purposes, ["default", "render"]);
    }

    #[test]
    fn vars_are_named_by_the_driver_else_by_their_prim() {
        let stage = Fixture::default()
            .prim("/s", "RenderSettings")
            .rel("products", &["/p"])
            .prim("/p", "RenderProduct")
            .rel("orderedVars", &["/N", "/ao"])
            .prim("/N", "RenderVar")
            .token("sourceName", "Neye")
            .prim("/ao", "RenderVar")
            .token("driver:parameters:aov:name", "occlusion");
        let (all, _) = read_settings(&stage);
        let vars = all[0].products[0].vars.iter();
        let vars: Vec<_> = vars
            .map(|var| [&var.name, &var.source_name, &var.data_type].map(String::as_str))
            .collect();
        assert_eq!(
            vars,
            [["N", "Neye", "color3f"], ["occlusion", "", "color3f"]]
        );
    }
}
