//! A sky as an image, made by code.

use crate::scenes::SceneBuilder;
use glam::Vec3;
use surflux::scene::{LightKind, Scene};
use tempfile::TempDir;

/// Blue above, white at the horizon, gray below, with a sun of one texel, as bright as the sky together, and four areas
/// of 2 to 6 degrees.
fn sun_and_four_areas(x: usize, y: usize) -> Vec3 {
    let pi = std::f32::consts::PI;
    let (longitude, polar) = (
        pi - 2.0 * pi * (x as f32 + 0.5) / 512.0,
        pi * (y as f32 + 0.5) / 256.0,
    );
    let level = polar.sin();
    let way = Vec3::new(
        level * longitude.sin(),
        polar.cos(),
        level * longitude.cos(),
    );
    if (x, y) == (400, 80) {
        return Vec3::splat(2e4);
    }
    let areas = [
        (
            Vec3::new(1.0, 1.2, 0.4),
            2.0_f32,
            Vec3::new(400.0, 380.0, 330.0),
        ),
        (Vec3::new(-1.0, 0.7, 0.3), 4.0, Vec3::new(40.0, 20.0, 10.0)),
        (Vec3::new(0.2, 0.6, -1.0), 6.0, Vec3::new(15.0, 20.0, 30.0)),
        (Vec3::new(-0.2, 1.5, 0.9), 3.0, Vec3::splat(80.0)),
    ];
    for (towards, degrees, radiance) in areas {
        if way.dot(towards.normalize()) > degrees.to_radians().cos() {
            return radiance;
        }
    }
    let up = way.y.max(0.0);
    Vec3::new(0.25, 0.4, 0.7) * up + Vec3::splat(0.5 * (1.0 - up))
}

/// `scene` under [`sun_and_four_areas`]; keep the folder as long as the scene.
pub(crate) fn lit(mut scene: Scene) -> (Scene, TempDir) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("sky.exr");
    let pixel = |x, y| <(f32, f32, f32)>::from(sun_and_four_areas(x, y));
    exr::prelude::write_rgb_file(&path, 512, 256, pixel).expect("written");
    let mut builder = SceneBuilder::new();
    builder.sky(Vec3::ONE);
    scene.lights = builder.build().lights;
    scene.lights[0].kind = LightKind::Dome {
        texture: Some(path),
    };
    (scene, folder)
}
