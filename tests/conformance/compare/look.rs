//! Lights, cameras and render settings.

use super::{Comparison, text};
use crate::truth::{list, number};
use glam::{DAffine3, DMat4, DVec3};
use serde_json::Value;
use std::collections::HashSet;
use std::path::PathBuf;
use surflux::scene::camera::Projection;
use surflux::scene::{
    Camera, FaceMaterials, Input, Light, LightKind, Linked, PrimId, PrimSource, RenderProduct,
};

/// Paths of gprims that the collection `link` of a light does not hold.
fn unlinked<'a>(light: &'a Value, link: &str) -> HashSet<&'a str> {
    let paths = light["unlinked"][link].as_array().expect("a list");
    paths.iter().map(text).collect()
}

impl Comparison<'_> {
    pub(super) fn lights(&mut self) {
        let scene = self.scene;
        let truth = self.truth;
        for theirs in truth.index["lights"].as_array().expect("a list") {
            let path = text(&theirs["path"]);
            self.tally.prims += 1;
            if !theirs["mesh"].is_null() {
                self.mesh_light(path, theirs);
                continue;
            }
            let found = scene.lights.iter().find(|light| light.path == path);
            self.one(path, text(&theirs["type"]), found.is_some());
            let Some(light) = found else { continue };
            self.links(path, [&light.lit, &light.blockers], theirs);
            if theirs["old"].as_bool() == Some(true) {
                self.tally.unjudged += 1;
                continue;
            }
            self.light(light, theirs);
        }
    }

    /// On every face the emission is the light's radiance, which the material's may tint.
    fn mesh_light(&mut self, path: &str, theirs: &Value) {
        let Some(prim) = self.scene.prims.iter().find(|prim| &*prim.path == path) else {
            return self.one(path, "mesh light", false);
        };
        let mut expected = list(&theirs["radiance"]);
        if theirs["normalize"].as_bool() == Some(true) {
            let area = number(&theirs["mesh"]["area"]);
            expected.iter_mut().for_each(|radiance| *radiance /= area);
        }
        let FaceMaterials::Whole(Some(material)) = &prim.materials else {
            return self.one(path, "mesh light", false);
        };
        let material = &self.scene.materials[material.index()];
        let links = &material.emission_links;
        self.links(path, [&links.lit, &links.blockers], theirs);
        let Input::Constant(emission) = &material.emissive_color else {
            return self.one(path, "emission", false);
        };
        let found = emission.truncate().as_dvec3().to_array();
        let is_own = text(&theirs["mesh"]["sync"]) != "materialGlowTintsLight";
        if is_own || material.path.is_empty() {
            self.numbers(path, "emission", &found, &expected);
        }
    }

    /// Prims that the light lights, and that block it; points of instancers are not told apart by usd-core.
    fn links(&mut self, path: &str, [lit, blockers]: [&Linked; 2], theirs: &Value) {
        let scene = self.scene;
        for (link, linked) in [("lightLink", lit), ("shadowLink", blockers)] {
            let unlinked = unlinked(theirs, link);
            for (id, prim) in (0..).map(PrimId).zip(&scene.prims) {
                if !matches!(prim.source, PrimSource::PointInstance { .. }) {
                    let expected = !unlinked.contains(&*prim.path);
                    self.one(path, link, linked.contains(id) == expected);
                }
            }
        }
    }

    fn light(&mut self, light: &Light, theirs: &Value) {
        let path = light.path.as_str();
        let radiance = light.radiance.as_dvec3().to_array();
        self.numbers(path, "radiance", &radiance, &list(&theirs["radiance"]));
        self.one(
            path,
            "normalize",
            Some(light.normalize) == theirs["normalize"].as_bool(),
        );
        self.one(
            path,
            "shadow:enable",
            Some(light.casts_shadows) == theirs["shadows"].as_bool(),
        );
        self.shape(light, theirs);
        let shaping = light.shaping.map(|s| {
            [
                s.cone_angle,
                s.cone_softness,
                s.focus,
                s.focus_tint.x,
                s.focus_tint.y,
                s.focus_tint.z,
            ]
            .map(f64::from)
        });
        match (shaping, theirs["shaping"].is_null()) {
            (Some(found), false) => {
                self.numbers(path, "shaping", &found, &list(&theirs["shaping"]));
            }
            (found, missing) => self.one(path, "shaping", found.is_none() == missing),
        }
        if let LightKind::Rect { texture, .. } | LightKind::Dome { texture } = &light.kind {
            let is_packed = |path: &PathBuf| path.to_string_lossy().contains('[');
            let real = texture.as_ref().and_then(|path| match is_packed(path) {
                true => Some(path.clone()),
                false => std::fs::canonicalize(path).ok(),
            });
            let real = real.map(|path| path.to_string_lossy().into_owned());
            self.one(
                path,
                "texture",
                real.as_deref() == theirs["texture"].as_str(),
            );
        }
        let affine = light.world_from_light;
        let mut matrix = DAffine3::from_mat4(glam::Mat4::from(affine).as_dmat4());
        matrix.translation += self.scene.origin;
        if theirs["dome"].is_null() {
            self.matrix(path, matrix, &theirs["matrix"]);
        } else {
            matrix.translation = DVec3::ZERO;
            self.matrix(path, matrix, &theirs["dome"]);
        }
    }

    fn shape(&mut self, light: &Light, theirs: &Value) {
        let shape = |name: &str| number(&theirs["shape"][name]);
        let (found, expected): (Vec<f32>, Vec<f64>) = match &light.kind {
            LightKind::Distant { angle } => (vec![*angle], vec![shape("angle").to_radians()]),
            LightKind::Sphere { radius, .. } | LightKind::Disk { radius } => {
                (vec![*radius], vec![shape("radius")])
            }
            LightKind::Rect { width, height, .. } => {
                (vec![*width, *height], vec![shape("width"), shape("height")])
            }
            LightKind::Cylinder { radius, length } => (
                vec![*radius, *length],
                vec![shape("radius"), shape("length")],
            ),
            LightKind::Dome { .. } | LightKind::Particles(_) => (vec![], vec![]),
        };
        let wide: Vec<f64> = found.into_iter().map(f64::from).collect();
        self.numbers(&light.path, "shape", &wide, &expected);
    }

    fn matrix(&mut self, path: &str, found: DAffine3, expected: &Value) {
        let found = DMat4::from(found).to_cols_array();
        self.numbers(path, "world matrix", &found, &list(expected));
    }

    pub(super) fn cameras(&mut self) {
        let (scene, truth) = (self.scene, self.truth);
        for theirs in truth.index["cameras"].as_array().expect("a list") {
            let path = text(&theirs["path"]);
            self.tally.prims += 1;
            let found = scene.cameras.iter().find(|camera| camera.path == path);
            self.one(path, "Camera", found.is_some());
            if let Some(camera) = found {
                self.camera(camera, theirs);
            }
        }
    }

    fn camera(&mut self, camera: &Camera, theirs: &Value) {
        let path = camera.path.as_str();
        self.matrix(path, camera.world_from_camera, &theirs["matrix"]);
        let is_flat = text(&theirs["projection"]) == "orthographic";
        self.one(
            path,
            "projection",
            (camera.projection == Projection::Orthographic) == is_flat,
        );
        let (near, far) = camera.clipping_range;
        let found = [
            camera.horizontal_aperture,
            camera.vertical_aperture,
            camera.horizontal_aperture_offset,
            camera.vertical_aperture_offset,
            camera.focal_length,
            near,
            far,
            camera.exposure,
        ];
        for (index, expected) in list(&theirs["lens"]).into_iter().enumerate() {
            self.numbers(
                path,
                &format!("lens number {index}"),
                &found[index..=index],
                &[expected],
            );
        }
    }

    pub(super) fn settings(&mut self) {
        let (scene, truth) = (self.scene, self.truth);
        for theirs in truth.index["settings"].as_array().expect("a list") {
            let path = text(&theirs["path"]);
            self.tally.prims += 1;
            let found = scene
                .render_settings
                .iter()
                .find(|settings| settings.path == path);
            self.one(path, "RenderSettings", found.is_some());
            let Some(ours) = found else { continue };
            self.one(
                path,
                "camera",
                ours.camera.as_deref() == theirs["camera"].as_str(),
            );
            let (width, height) = ours.resolution;
            let found = [f64::from(width), f64::from(height)];
            self.numbers(path, "resolution", &found, &list(&theirs["resolution"]));
            let products = theirs["products"].as_array().expect("a list");
            self.one(path, "products", ours.products.len() == products.len());
            for (ours, theirs) in ours.products.iter().zip(products) {
                self.product(ours, theirs);
            }
        }
    }

    fn product(&mut self, ours: &RenderProduct, theirs: &Value) {
        let path = ours.path.as_str();
        self.one(path, "path", path == text(&theirs["path"]));
        // where the stage names no file, one is made of the prim's name
        let name = text(&theirs["name"]);
        let last = path.rsplit('/').next().unwrap_or("");
        let is_equal = ours.name == name || (name.is_empty() && ours.name == format!("{last}.exr"));
        self.one(path, "productName", is_equal);
        self.one(
            path,
            "productType",
            ours.product_type == text(&theirs["type"]),
        );
        self.one(
            path,
            "camera",
            ours.camera.as_deref() == theirs["camera"].as_str(),
        );
        let policy = ours.aspect_ratio_conform_policy == text(&theirs["policy"]);
        self.one(path, "aspectRatioConformPolicy", policy);
        let (width, height) = ours.resolution;
        let found = [f64::from(width), f64::from(height)];
        self.numbers(path, "resolution", &found, &list(&theirs["resolution"]));
        let window = ours.data_window_ndc.map(f64::from);
        self.numbers(path, "dataWindowNDC", &window, &list(&theirs["window"]));
        let vars: Vec<[&str; 3]> = (ours.vars.iter())
            .map(|var| [&*var.source_name, &*var.source_type, &*var.data_type])
            .collect();
        self.one(
            path,
            "orderedVars",
            serde_json::json!(vars) == theirs["vars"],
        );
    }
}
