//! UsdLux prims → [`Light`]s, with the schemas' fallbacks and their older names without `inputs:`.
//!
//! What point-based light cannot honour (IES profiles, filters, portals, geometry lights) is left out
//! with a warning that says what follows.

use super::blackbody;
use super::links::Links;
use super::mesh_lights::{MaterialSync, MeshLight};
use super::paths::Paths;
use super::values::{Values, color, narrow, number};
use crate::diagnostics::Diagnostics;
use crate::scene::{Light, LightKind, Linked, Shaping, UpAxis};
use crate::stage::passes::flatten::Occurrence;
use crate::stage::raw::{RawPrim, Value};
use glam::{Affine3A, DAffine3, DMat4, DVec3, Vec3};
use std::f32::consts::PI;

/// Fallback of `DistantLight.inputs:intensity`, alone among the lights.
const DISTANT_INTENSITY: f32 = 50_000.0;

/// All lights of `occurrences` that `is_shown`, relative to `origin`. Lights below point instancers are left out.
pub(super) fn read(
    paths: &Paths<'_>,
    is_shown: impl Fn(&Occurrence) -> bool,
    origin: DVec3,
    up_axis: UpAxis,
    diagnostics: &Diagnostics,
) -> Vec<(Light, Links)> {
    readers(paths, is_shown, up_axis, diagnostics)
        .filter_map(|(index, reader)| {
            let kind = reader.kind()?;
            if below_instancer(paths, index) {
                reader
                    .warn("it is below a PointInstancer: lights are not instanced, it is left out");
                return None;
            }
            let world_from_local = paths.occurrences()[index].world_from_local;
            let light = reader.light(kind, world_from_local, origin)?;
            Some((light, Links::read(paths, index, diagnostics)))
        })
        .collect()
}

/// A reader for each of the occurrences that `is_shown`, and which it is.
fn readers<'a>(
    paths: &'a Paths<'_>,
    is_shown: impl Fn(&Occurrence) -> bool,
    up_axis: UpAxis,
    diagnostics: &'a Diagnostics,
) -> impl Iterator<Item = (usize, Reader<'a>)> {
    let occurrences = paths.occurrences().iter().enumerate();
    let shown = occurrences.filter(move |(_, occurrence)| is_shown(occurrence));
    shown.map(move |(index, occurrence)| {
        let reader = Reader {
            prim: paths.prim_of(index),
            path: &occurrence.path,
            up_axis,
            diagnostics,
        };
        (index, reader)
    })
}

/// All meshes of `occurrences` that `is_shown` and are lights by `MeshLightAPI`.
pub(super) fn read_meshes(
    paths: &Paths<'_>,
    is_shown: impl Fn(&Occurrence) -> bool,
    diagnostics: &Diagnostics,
) -> Vec<MeshLight> {
    // Which way is up matters to domes alone.
    readers(paths, is_shown, UpAxis::Y, diagnostics)
        .filter_map(|(index, reader)| {
            if !reader.is_mesh_light() {
                return None;
            }
            if below_instancer(paths, index) {
                reader.warn(
                    "it is below a PointInstancer: lights are not instanced, it does not shine",
                );
                return None;
            }
            let links = Links::read(paths, index, diagnostics);
            reader.mesh_light(links)
        })
        .collect()
}

fn below_instancer(paths: &Paths<'_>, occurrence: usize) -> bool {
    let parent = |at: &usize| paths.occurrences()[*at].parent;
    std::iter::successors(parent(&occurrence), parent)
        .any(|at| paths.prim_of(at).type_name == "PointInstancer")
}

struct Reader<'a> {
    prim: &'a RawPrim,
    path: &'a str,
    up_axis: UpAxis,
    diagnostics: &'a Diagnostics,
}

impl Reader<'_> {
    fn warn(&self, message: &str) {
        self.diagnostics
            .warn("unsupported-light", self.path, message);
    }

    fn has_api(&self, name: &str) -> bool {
        self.prim.api_schemas.iter().any(|api| api == name)
    }

    /// `inputs:NAME`, else NAME as files before USD 21 have it.
    fn input(&self, name: &str) -> Option<&Value> {
        self.prim
            .value(&format!("inputs:{name}"))
            .or_else(|| self.prim.value(name))
    }

    fn number(&self, name: &str, fallback: f32) -> f32 {
        self.input(name).and_then(number).map_or(fallback, narrow)
    }

    fn flag(&self, name: &str) -> Option<bool> {
        self.input(name)
            .and_then(number)
            .map(|number| number != 0.0)
    }

    fn color(&self, name: &str, fallback: Vec3) -> Vec3 {
        self.input(name)
            .and_then(color)
            .map_or(fallback, |color| color.truncate())
    }

    /// A length or angle: negative is 0, with a warning.
    fn size(&self, name: &str, fallback: f32) -> f32 {
        let size = self.number(name, fallback);
        if size < 0.0 {
            self.warn(&format!("`{name}` is {size}, below 0: it counts as 0"));
        }
        if size.is_nan() { size } else { size.max(0.0) }
    }

    /// Shape of the light; `None` if the prim is no light, or (with a warning) none that can be used.
    fn kind(&self) -> Option<LightKind> {
        Some(match self.prim.type_name.as_str() {
            "DistantLight" => LightKind::Distant {
                angle: self.size("angle", 0.53).to_radians(),
            },
            "SphereLight" => LightKind::Sphere {
                radius: self.size("radius", 0.5),
                treat_as_point: self.prim.flag("treatAsPoint").unwrap_or(false),
            },
            "RectLight" => LightKind::Rect {
                width: self.size("width", 1.0),
                height: self.size("height", 1.0),
                texture: self.input("texture:file").and_then(super::values::asset),
            },
            "DiskLight" => LightKind::Disk {
                radius: self.size("radius", 0.5),
            },
            "CylinderLight" => LightKind::Cylinder {
                radius: self.size("radius", 0.5),
                length: self.size("length", 1.0),
            },
            "DomeLight" | "DomeLight_1" => LightKind::Dome {
                texture: self.dome_texture(),
            },
            other => {
                self.warn_of_other(other);
                return None;
            }
        })
    }

    fn is_mesh_light(&self) -> bool {
        self.prim.type_name == "Mesh" && self.has_api("MeshLightAPI")
    }

    fn mesh_light(&self, links: Links) -> Option<MeshLight> {
        let light = MeshLight {
            path: self.path.to_owned(),
            radiance: self.radiance(1.0),
            normalize: self.flag("normalize").unwrap_or(false),
            sync: MaterialSync::read(self.prim, self.path, self.diagnostics),
            links,
        };
        if !light.radiance.is_finite() {
            self.diagnostics.warn(
                "invalid-light",
                self.path,
                "an intensity or color is not finite: the mesh does not shine",
            );
            return None;
        }
        if self.shaping().is_some() {
            self.warn("shaping of mesh lights is not applied: it shines in all directions");
        }
        if self.flag("shadow:enable") == Some(false) {
            self.warn("shadow:enable of mesh lights is not applied: it casts shadows");
        }
        self.warn_of_the_rest();
        Some(light)
    }

    fn warn_of_other(&self, type_name: &str) {
        if self.is_mesh_light() {
            return;
        }
        let is_light = matches!(type_name, "GeometryLight" | "PluginLight")
            || self.has_api("MeshLightAPI")
            || self.has_api("VolumeLightAPI")
            || self.has_api("LightAPI");
        if type_name == "PortalLight" {
            self.warn("portals only guide sampling: it is left out, without effect on the light");
        } else if type_name.ends_with("LightFilter") {
            self.warn(
                "light filters are not applied: the lights that use it are brighter than meant",
            );
        } else if is_light {
            let what = if type_name.is_empty() {
                "LightAPI"
            } else {
                type_name
            };
            self.warn(&format!(
                "a light made of a {what} is not supported: it emits nothing (emissive materials are)"
            ));
        }
    }

    fn dome_texture(&self) -> Option<std::path::PathBuf> {
        let texture = self.input("texture:file").and_then(super::values::asset)?;
        let format = self.input("texture:format").and_then(super::values::token);
        match format {
            None | Some("automatic" | "latlong" | "") => Some(texture),
            Some(format) => {
                self.warn(&format!(
                    "texture format `{format}` is not supported, only latlong is: the dome has its plain color"
                ));
                None
            }
        }
    }

    fn light(&self, kind: LightKind, world_from_local: DMat4, origin: DVec3) -> Option<Light> {
        let light = Light {
            path: self.path.to_owned(),
            radiance: self.radiance(match kind {
                LightKind::Distant { .. } => DISTANT_INTENSITY,
                _ => 1.0,
            }),
            normalize: self.flag("normalize").unwrap_or(false),
            world_from_light: self.placed(&kind, world_from_local, origin),
            shaping: self.shaping(),
            casts_shadows: self.flag("shadow:enable").unwrap_or(true),
            lit: Linked::All,
            blockers: Linked::All,
            kind,
        };
        if !is_finite(&light) {
            self.diagnostics.warn(
                "invalid-light",
                self.path,
                "an intensity, color, size, shaping or transform is not finite: the light is left out",
            );
            return None;
        }
        self.warn_of_the_rest();
        Some(light)
    }

    /// The product of the inputs; `intensity` is what the schema has where none is authored.
    fn radiance(&self, intensity: f32) -> Vec3 {
        let strength = self.number("intensity", intensity) * self.number("exposure", 0.0).exp2();
        let temperature = match self.flag("enableColorTemperature") {
            Some(true) => blackbody::color(self.number("colorTemperature", 6500.0)),
            _ => Vec3::ONE,
        };
        let color = self.color("color", Vec3::ONE) * temperature;
        let radiance = color * (strength * self.number("diffuse", 1.0));
        if radiance.min_element() < 0.0 {
            self.warn(&format!("its radiance is {radiance}: below 0 counts as 0"));
            return Vec3::select(radiance.cmplt(Vec3::ZERO), Vec3::ZERO, radiance);
        }
        radiance
    }

    fn shaping(&self) -> Option<Shaping> {
        let applied = self.has_api("ShapingAPI");
        let authored = ["cone:angle", "cone:softness", "focus", "focusTint"]
            .iter()
            .any(|name| self.input(&format!("shaping:{name}")).is_some());
        if self
            .input("shaping:ies:file")
            .and_then(super::values::asset)
            .is_some()
        {
            self.warn(
                "IES profiles are not read: it shines the same in all directions of its cone",
            );
        }
        let fallback_angle = if applied { 90.0 } else { 180.0 };
        (applied || authored).then(|| Shaping {
            cone_angle: self
                .number("shaping:cone:angle", fallback_angle)
                .to_radians()
                .clamp(0.0, PI),
            cone_softness: self.number("shaping:cone:softness", 0.0).clamp(0.0, 1.0),
            focus: self.size("shaping:focus", 0.0),
            focus_tint: self.color("shaping:focusTint", Vec3::ZERO),
        })
    }

    /// Transform relative to `origin`; domes turned so that their pole is +Y of light space.
    fn placed(&self, kind: &LightKind, world_from_local: DMat4, origin: DVec3) -> Affine3A {
        let mut world = DAffine3::from_mat4(world_from_local);
        world.translation -= origin;
        let pole = self.prim.token("poleAxis").unwrap_or("scene");
        let z_up = pole == "Z" || (pole == "scene" && self.up_axis == UpAxis::Z);
        if matches!(kind, LightKind::Dome { .. }) && self.prim.type_name == "DomeLight_1" && z_up {
            // The pole is +Z, the image's centre −Y: a quarter turn about X brings +Y there, and +Z to −Y.
            world *= DAffine3::from_rotation_x(std::f64::consts::FRAC_PI_2);
        }
        Affine3A::from_cols(
            world.matrix3.x_axis.as_vec3a(),
            world.matrix3.y_axis.as_vec3a(),
            world.matrix3.z_axis.as_vec3a(),
            world.translation.as_vec3a(),
        )
    }

    fn warn_of_the_rest(&self) {
        let targets = |name: &str| {
            let relationship = self.prim.relationships.get(name);
            relationship.is_some_and(|relationship| !relationship.targets.is_empty())
        };
        if targets("light:filters") || targets("filters") {
            self.warn("its light filters are not applied: it is brighter than meant");
        }
        if self.color("shadow:color", Vec3::ZERO) != Vec3::ZERO {
            self.warn("shadow:color is not applied: its shadows are black");
        }
    }
}

fn is_finite(light: &Light) -> bool {
    let sizes = match &light.kind {
        LightKind::Distant { angle } => [*angle, 0.0],
        LightKind::Sphere { radius, .. } | LightKind::Disk { radius } => [*radius, 0.0],
        LightKind::Rect { width, height, .. } => [*width, *height],
        LightKind::Cylinder { radius, length } => [*radius, *length],
        LightKind::Dome { .. } | LightKind::Particles(_) => [0.0, 0.0],
    };
    let shaping = light.shaping.is_none_or(|shaping| {
        shaping.focus_tint.is_finite()
            && [shaping.cone_angle, shaping.cone_softness, shaping.focus]
                .iter()
                .all(|x| x.is_finite())
    });
    shaping
        && sizes.iter().all(|size| size.is_finite())
        && light.radiance.is_finite()
        && light.world_from_light.is_finite()
}

#[cfg(test)]
mod tests {
    use super::super::fixture::Fixture;
    use super::*;
    use glam::DVec2;

    fn read_lights(stage: &Fixture, up_axis: UpAxis) -> (Vec<Light>, Vec<String>) {
        let mut occurrences = stage.occurrences();
        for occurrence in &mut occurrences {
            occurrence.world_from_local = DMat4::from_translation(DVec3::new(1e6 + 1.0, 2.0, 3.0));
        }
        let paths = Paths::new(&stage.raw, &occurrences);
        let diagnostics = Diagnostics::default();
        let origin = DVec3::new(1e6, 0.0, 0.0);
        let lights = read(
            &paths,
            |occurrence| occurrence.visible,
            origin,
            up_axis,
            &diagnostics,
        );
        let messages = diagnostics
            .warnings()
            .into_iter()
            .map(|w| w.message)
            .collect();
        let lights = lights.into_iter().map(|(light, _)| light).collect();
        (lights, messages)
    }

    fn one(stage: &Fixture) -> Light {
        let (lights, warnings) = read_lights(stage, UpAxis::Y);
        assert_eq!((lights.len(), warnings.len()), (1, 0), "{warnings:?}");
        lights[0].clone()
    }

    #[test]
    fn fallbacks_are_those_of_the_schemas() {
        let kind = |name: &str| one(&Fixture::default().prim("/L", name));
        let distant = kind("DistantLight");
        assert_eq!(distant.radiance, Vec3::splat(50_000.0));
        assert_eq!(
            distant.kind,
            LightKind::Distant {
                angle: 0.53_f32.to_radians()
            }
        );
        let sphere = kind("SphereLight");
        assert_eq!(
            sphere.kind,
            LightKind::Sphere {
                radius: 0.5,
                treat_as_point: false
            }
        );
        assert_eq!((sphere.radiance, sphere.normalize), (Vec3::ONE, false));
        assert_eq!((sphere.shaping, sphere.casts_shadows), (None, true));
        let rect = LightKind::Rect {
            width: 1.0,
            height: 1.0,
            texture: None,
        };
        assert_eq!(kind("RectLight").kind, rect);
        let cylinder = LightKind::Cylinder {
            radius: 0.5,
            length: 1.0,
        };
        assert_eq!(kind("CylinderLight").kind, cylinder);
        assert_eq!(kind("DomeLight").kind, LightKind::Dome { texture: None });
    }

    #[test]
    fn radiance_is_the_product_of_its_inputs_under_both_names() {
        for prefix in ["inputs:", ""] {
            let name = |input: &str| format!("{prefix}{input}");
            let stage = Fixture::default()
                .prim("/L", "DiskLight")
                .number(&name("intensity"), 3.0)
                .number(&name("exposure"), 2.0)
                .number(&name("diffuse"), 0.5)
                .value(&name("color"), Value::Vec3(DVec3::new(1.0, 0.5, 0.0)))
                .value(&name("enableColorTemperature"), Value::Bool(true))
                .number(&name("colorTemperature"), 2000.0)
                .number(&name("radius"), 4.0);
            let light = one(&stage);
            // 3 · 2² · ½ = 6 times usd-core's color of 2000 K.
            let expected = Vec3::new(6.0 * 2.520_566_2, 3.0 * 0.646_888_26, 0.0);
            assert!(
                light.radiance.distance(expected) < 1e-4,
                "{}",
                light.radiance
            );
            assert_eq!(light.kind, LightKind::Disk { radius: 4.0 });
        }
    }

    #[test]
    fn positions_are_relative_to_the_origin() {
        let light = one(&Fixture::default().prim("/L", "SphereLight"));
        let position = Vec3::from(light.world_from_light.translation);
        assert_eq!(position, Vec3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn domes_turn_their_pole_to_z_where_the_schema_says() {
        let directions = |type_name: &str, up: UpAxis, pole: &str| {
            let stage = Fixture::default()
                .prim("/L", type_name)
                .token("poleAxis", pole);
            let light = read_lights(&stage, up).0.remove(0);
            let turned = |v: Vec3| light.world_from_light.transform_vector3(v).round();
            (turned(Vec3::Y), turned(Vec3::Z), turned(Vec3::X))
        };
        let y_pole = (Vec3::Y, Vec3::Z, Vec3::X);
        // UsdLux: with the pole on Z, latitude 0, longitude 0 points into negative Y.
        let z_pole = (Vec3::Z, Vec3::NEG_Y, Vec3::X);
        assert_eq!(directions("DomeLight", UpAxis::Z, "scene"), y_pole);
        assert_eq!(directions("DomeLight_1", UpAxis::Y, "scene"), y_pole);
        assert_eq!(directions("DomeLight_1", UpAxis::Z, "scene"), z_pole);
        assert_eq!(directions("DomeLight_1", UpAxis::Y, "Z"), z_pole);
        assert_eq!(directions("DomeLight_1", UpAxis::Z, "Y"), y_pole);
    }

    #[test]
    fn shaping_has_a_cone_of_90_degrees_only_where_the_api_is_applied() {
        let applied = one(&Fixture::default()
            .prim("/L", "SphereLight")
            .api("ShapingAPI"));
        let angle = applied.shaping.unwrap().cone_angle;
        assert!((angle - PI / 2.0).abs() < 1e-6);
        let focus = Fixture::default()
            .prim("/L", "SphereLight")
            .number("inputs:shaping:focus", 2.0);
        let shaping = one(&focus).shaping.unwrap();
        assert_eq!((shaping.cone_angle, shaping.focus), (PI, 2.0));
    }

    #[test]
    fn nonfinite_lights_are_left_out_and_negative_ones_clamped() {
        let light = |name: &str, value: f64| {
            read_lights(
                &Fixture::default()
                    .prim("/L", "SphereLight")
                    .number(name, value),
                UpAxis::Y,
            )
        };
        for (name, value) in [
            ("inputs:intensity", f64::NAN),
            ("inputs:exposure", 1e9),
            ("inputs:radius", f64::INFINITY),
            ("inputs:radius", f64::NAN),
            ("inputs:shaping:cone:angle", f64::NAN),
        ] {
            let (lights, warnings) = light(name, value);
            assert_eq!((lights.len(), warnings.len()), (0, 1), "{name} {value}");
        }
        let (lights, warnings) = light("inputs:intensity", -1.0);
        assert_eq!((lights[0].radiance, warnings.len()), (Vec3::ZERO, 1));
    }

    #[test]
    fn what_is_not_applied_is_warned_of() {
        let stage = Fixture::default()
            .prim("/G", "GeometryLight")
            .prim("/P", "PortalLight")
            .prim("/M", "Points")
            .api("LightAPI")
            .prim("/F", "LightFilter")
            .prim("/I", "PointInstancer")
            .prim("/I/L", "SphereLight")
            .prim("/L", "DomeLight")
            .rel("collection:lightLink:excludes", &["/M"])
            .rel("light:filters", &["/F"])
            .prim("/C", "Cube")
            .value("size", Value::Vec2(DVec2::ONE));
        let (lights, warnings) = read_lights(&stage, UpAxis::Y);
        assert_eq!(lights.len(), 1);
        assert_eq!(warnings.len(), 6, "{warnings:#?}");
    }
}
