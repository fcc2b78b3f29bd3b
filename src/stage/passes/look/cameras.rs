//! `Camera` prims → [`Camera`]s, with the schema's fallbacks.

use super::paths::Paths;
use super::values::Values;
use crate::diagnostics::Diagnostics;
use crate::scene::Camera;
use crate::scene::camera::Projection;
use crate::stage::raw::{RawPrim, Value};
use glam::DAffine3;

/// All cameras, visible or not, in traversal order. One whose transform is not finite or flat is left out with a
/// warning; attributes that make no sense are replaced by the schema's fallback with a warning.
pub(super) fn read(paths: &Paths<'_>, diagnostics: &Diagnostics) -> Vec<Camera> {
    let occurrences = paths.occurrences().iter().enumerate();
    occurrences
        .filter(|(index, _)| paths.prim_of(*index).type_name == "Camera")
        .filter_map(|(index, occurrence)| {
            let world_from_camera = DAffine3::from_mat4(occurrence.world_from_local);
            let determinant = world_from_camera.matrix3.determinant();
            if !world_from_camera.is_finite() || !determinant.is_normal() {
                let message = "its transform is not invertible: the camera is left out";
                diagnostics.warn("invalid-camera", &occurrence.path, message);
                return None;
            }
            let reader = Reader {
                prim: paths.prim_of(index),
                path: &occurrence.path,
                diagnostics,
            };
            Some(reader.camera(world_from_camera))
        })
        .collect()
}

struct Reader<'a> {
    prim: &'a RawPrim,
    path: &'a str,
    diagnostics: &'a Diagnostics,
}

impl Reader<'_> {
    fn camera(&self, world_from_camera: DAffine3) -> Camera {
        Camera {
            path: self.path.to_owned(),
            world_from_camera,
            projection: match self.prim.token("projection") {
                Some("orthographic") => Projection::Orthographic,
                _ => Projection::Perspective,
            },
            horizontal_aperture: self.size("horizontalAperture", 20.955),
            vertical_aperture: self.size("verticalAperture", 15.2908),
            horizontal_aperture_offset: self.number(
                "horizontalApertureOffset",
                0.0,
                f64::is_finite,
            ),
            vertical_aperture_offset: self.number("verticalApertureOffset", 0.0, f64::is_finite),
            focal_length: self.size("focalLength", 50.0),
            clipping_range: self.clipping_range(),
            exposure: self.number("exposure", 0.0, f64::is_finite),
        }
    }

    fn size(&self, name: &str, fallback: f64) -> f64 {
        self.number(name, fallback, |size| size.is_finite() && size > 0.0)
    }

    fn number(&self, name: &str, fallback: f64, is_valid: impl Fn(f64) -> bool) -> f64 {
        let Some(authored) = self.prim.number(name) else {
            return fallback;
        };
        if is_valid(authored) {
            return authored;
        }
        self.warn(&format!("`{name}` is {authored}: {fallback} is used"));
        fallback
    }

    fn clipping_range(&self) -> (f64, f64) {
        let fallback = (1.0, 1e6);
        match self.prim.value("clippingRange") {
            Some(Value::Vec2(range)) if range.x >= 0.0 && range.x < range.y => (range.x, range.y),
            Some(_) => {
                self.warn("`clippingRange` is not near < far: 1 to 1e6 is used");
                fallback
            }
            None => fallback,
        }
    }

    fn warn(&self, message: &str) {
        self.diagnostics.warn("invalid-camera", self.path, message);
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::Fixture;
    use super::*;
    use glam::{DMat4, DVec2};

    fn read_cameras(stage: &Fixture, world: DMat4) -> (Vec<Camera>, usize) {
        let mut occurrences = stage.occurrences();
        occurrences[0].world_from_local = world;
        let paths = Paths::new(&stage.raw, &occurrences);
        let diagnostics = Diagnostics::default();
        let cameras = read(&paths, &diagnostics);
        (cameras, diagnostics.warnings().len())
    }

    #[test]
    fn fallbacks_are_those_of_the_schema() {
        let (cameras, warnings) =
            read_cameras(&Fixture::default().prim("/C", "Camera"), DMat4::IDENTITY);
        let camera = &cameras[0];
        assert_eq!(warnings, 0);
        assert_eq!(camera.projection, Projection::Perspective);
        assert_eq!(
            (camera.horizontal_aperture, camera.vertical_aperture),
            (20.955, 15.2908)
        );
        assert_eq!(
            (camera.focal_length, camera.clipping_range),
            (50.0, (1.0, 1e6))
        );
    }

    #[test]
    fn nonsense_falls_back_with_warnings() {
        let stage = Fixture::default()
            .prim("/C", "Camera")
            .number("focalLength", 0.0)
            .number("horizontalAperture", f64::NAN)
            .value("clippingRange", Value::Vec2(DVec2::new(5.0, 1.0)));
        let (cameras, warnings) = read_cameras(&stage, DMat4::IDENTITY);
        assert_eq!(
            (cameras[0].focal_length, cameras[0].clipping_range),
            (50.0, (1.0, 1e6))
        );
        assert_eq!(warnings, 3);
        let flat = DMat4::from_scale(glam::DVec3::new(1.0, 1.0, 0.0));
        assert_eq!(read_cameras(&stage, flat).0.len(), 0);
    }
}
