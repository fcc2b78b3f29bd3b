//! Lights of which only some are looked at.

use super::*;
use crate::lighting::beacons::Beacons;
use crate::lighting::lights::{AreaLight, Patterns};

/// Small spheres strewn over a floor.
fn lamps(count: usize) -> Vec<Light> {
    let mut random = Random(7);
    let mut lamp = || {
        let [x, y, z] = [0; 3].map(|_| random.next());
        let place = Vec3::new(6.0 * x - 3.0, 1.5 + y, 6.0 * z - 3.0);
        let kind = LightKind::Sphere {
            radius: 0.05,
            treat_as_point: false,
        };
        light(kind, Affine3A::from_translation(place))
    };
    (0..count).map(|_| lamp()).collect()
}

#[test]
fn a_few_looks_at_many_lights_are_true_in_the_mean() {
    let block = quad(
        Vec3::new(-0.5, 1.0, -0.5),
        Vec3::new(-0.5, 1.0, 0.5),
        Vec3::new(0.5, 1.0, 0.5),
        Vec3::new(0.5, 1.0, -0.5),
    );
    let point = up_at(Vec3::new(0.1, 0.0, 0.0));
    for count in [30, 300] {
        let mut scene = scene(vec![mesh(&block)], &[(0, Affine3A::IDENTITY)]);
        scene.lights = lamps(count);
        let diagnostics = Diagnostics::default();
        let shader = Shader::new(&scene, &diagnostics);
        let tracer = Tracer::new(&scene);
        let lighting = Lighting::new(&shader, ONE_LIGHT, &diagnostics);
        let exact = each_alone(&scene, std::slice::from_ref(&point))[0];
        let looks = 4096;
        let mean = (0..looks)
            .map(|number| lighting.glimpse(&tracer, &point, number * 977).x)
            .sum::<f32>()
            / looks as f32;
        assert!(
            exact > 0.0 && (mean / exact - 1.0).abs() < 0.02,
            "{mean} {exact}"
        );
    }
}

#[test]
fn surfels_look_at_strong_lights_and_at_some_of_the_weak_ones_which_are_true_in_the_mean() {
    let block = quad(
        Vec3::new(-0.5, 1.0, -0.5),
        Vec3::new(-0.5, 1.0, 0.5),
        Vec3::new(0.5, 1.0, 0.5),
        Vec3::new(0.5, 1.0, -0.5),
    );
    // Without a strong light, with one nearby, and with a sun.
    let strong = LightKind::Sphere {
        radius: 0.05,
        treat_as_point: false,
    };
    let sun = LightKind::Distant { angle: 0.01 };
    let above = Affine3A::from_translation(Vec3::new(1.0, 0.7, 0.0));
    let down = Affine3A::from_rotation_x(-FRAC_PI_2);
    let extra = [None, Some((strong, above)), Some((sun, down))];
    for extra in extra {
        let mut scene = scene(vec![mesh(&block)], &[(0, Affine3A::IDENTITY)]);
        scene.lights = lamps(100);
        scene.lights.extend(extra.map(|(kind, place)| {
            let mut strong = light(kind, place);
            strong.radiance *= 10.0;
            strong
        }));
        let diagnostics = Diagnostics::default();
        let shader = Shader::new(&scene, &diagnostics);
        let tracer = Tracer::new(&scene);
        let lighting = Lighting::new(&shader, ONE_LIGHT, &diagnostics);
        let points: Vec<ShadePoint> = (0..2000_u16)
            .map(|i| {
                up_at(Vec3::new(
                    f32::from(i) * 1e-4,
                    0.0,
                    f32::from(i % 44) * 2e-3,
                ))
            })
            .collect();
        let (some, all) = (lighting.for_surfels(false), lighting.for_surfels(true));
        let chance = some.wide(&shader, &tracer, &points);
        let looked: Vec<f32> = (points.iter().zip(&chance))
            .map(|(point, light)| (some.lights(&tracer, point) + *light).x)
            .collect();
        let exact: Vec<f32> = (points.iter())
            .map(|point| all.lights(&tracer, point).x)
            .collect();
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        assert!(
            (mean(&looked) / mean(&exact) - 1.0).abs() < 0.005,
            "{} {}",
            mean(&looked),
            mean(&exact)
        );
        let squared: Vec<f32> = looked
            .iter()
            .zip(&exact)
            .map(|(a, b)| (a - b).powi(2))
            .collect();
        let noise = mean(&squared).sqrt() / mean(&exact);
        assert!(noise < 0.3, "{noise}");
        assert!(noise > 0.0, "some are left out");
    }
}

#[test]
fn lights_weighed_in_rows_weigh_what_each_does() {
    let mut scene = scene(Vec::new(), &[]);
    scene.lights = lamps(137);
    let diagnostics = Diagnostics::default();
    let lights: Vec<AreaLight> = (scene.lights.iter())
        .filter_map(|light| AreaLight::new(light, &diagnostics))
        .collect();
    let beacons = Beacons::new(lights.iter().map(AreaLight::beacon));
    let point = up_at(Vec3::new(0.3, 1.9, -0.2));
    let mut weights = [0.0; 137];
    beacons.weigh(&point, 0, &mut weights);
    let mut by_rows = Vec::new();
    beacons.for_each(&point, |index, weight| by_rows.push((index, weight)));
    assert!(by_rows.into_iter().eq(weights.into_iter().enumerate()));
    let mut all = Vec2::ZERO;
    for (index, weight) in weights.into_iter().enumerate() {
        assert_eq!(weight, beacons.at(index, &point));
        let light = &lights[index];
        let patterns = Patterns::new(16);
        let open = light.open(&patterns, &point).element_sum();
        assert!(weight >= 0.2 * open, "{weight} {open}");
        all += Vec2::new(weight, open);
    }
    // A ball shows a quarter of its area, and low ones are taken for higher than they are.
    assert!(all.y > 0.0 && all.x < 8.0 * all.y, "{all}");
}

#[test]
fn the_light_that_a_ray_meets_first_is_the_nearest_of_all_asked_one_by_one() {
    let mut random = Random(23);
    let mut direction = || Vec3::from_array([0; 3].map(|_| random.next() - 0.5)).normalize();
    let kinds = [
        LightKind::Rect {
            width: 0.4,
            height: 0.3,
            texture: None,
        },
        LightKind::Disk { radius: 0.3 },
        LightKind::Cylinder {
            radius: 0.1,
            length: 0.5,
        },
        LightKind::Distant { angle: 0.02 },
    ];
    let mut scene = scene(Vec::new(), &[]);
    scene.lights = lamps(200);
    for (lamp, kind) in scene.lights.iter_mut().zip(kinds.iter().cycle()).skip(3) {
        let turn = Quat::from_rotation_arc(Vec3::Z, direction());
        lamp.world_from_light *= Affine3A::from_quat(turn);
        lamp.kind = kind.clone();
    }
    // Two at one place: the first counts.
    let mut twin = scene.lights[0].clone();
    twin.radiance *= 2.0;
    scene.lights.push(twin);
    let diagnostics = Diagnostics::default();
    let lights: Vec<AreaLight> = (scene.lights.iter())
        .filter_map(|light| AreaLight::new(light, &diagnostics))
        .collect();
    let shader = Shader::new(&scene, &diagnostics);
    let lighting = Lighting::new(&shader, ONE_LIGHT, &diagnostics);
    let center = |light: &Light| Vec3::from(light.world_from_light.translation);
    let (mut met, mut nearer) = (0, 0);
    for i in 0..4000 {
        let origin = 5.0 * direction() + Vec3::Y;
        let toward = center(&scene.lights[i % scene.lights.len()]) + 0.1 * direction() - origin;
        let (way, far) = (toward.normalize(), toward.length());
        for max_distance in [f32::INFINITY, far] {
            let one_by_one = (lights.iter())
                .filter_map(|light| light.seen(origin, way))
                .filter(|(distance, _)| *distance < max_distance)
                .min_by(|a, b| a.0.total_cmp(&b.0));
            assert_eq!(lighting.seen(origin, way, max_distance), one_by_one);
            met += u32::from(one_by_one.is_some());
            nearer += u32::from(one_by_one.is_some_and(|(distance, _)| distance < far - 1.0));
        }
    }
    assert!(met > 2000 && nearer > 100, "{met} {nearer}");
}

/// The light of each of the lights of `scene` alone, summed, at `points`.
fn each_alone(scene: &Scene, points: &[ShadePoint]) -> Vec<f32> {
    let (diagnostics, tracer) = (Diagnostics::default(), Tracer::new(scene));
    let mut sums = vec![0.0; points.len()];
    for light in &scene.lights {
        let mut one = scene.clone();
        one.lights = vec![light.clone()];
        let shader = Shader::new(&one, &diagnostics);
        let lighting = Lighting::new(&shader, LightSamples::default(), &diagnostics);
        let light = lighting.lights_at(&tracer, points);
        (sums.iter_mut().zip(light)).for_each(|(sum, light)| *sum += light.x);
    }
    sums
}

/// Lamps over a floor on which a block throws a shadow, and the light at places along a line through it: by all lights together, and
/// each on its own, summed.
fn along_a_line(lights: Vec<Light>, places: u16) -> Vec<(f32, f32)> {
    under_a_block(1.0, lights, places)
}

/// The same, the block at this height.
fn under_a_block(height: f32, lights: Vec<Light>, places: u16) -> Vec<(f32, f32)> {
    let block = quad(
        Vec3::new(-0.5, height, -0.5),
        Vec3::new(-0.5, height, 0.5),
        Vec3::new(0.5, height, 0.5),
        Vec3::new(0.5, height, -0.5),
    );
    let mut scene = scene(vec![mesh(&block)], &[(0, Affine3A::IDENTITY)]);
    scene.lights = lights;
    let diagnostics = Diagnostics::default();
    let shader = Shader::new(&scene, &diagnostics);
    let tracer = Tracer::new(&scene);
    let points: Vec<ShadePoint> = (0..places)
        .map(|i| {
            up_at(Vec3::new(
                6.0 * f32::from(i) / f32::from(places) - 3.0,
                0.0,
                0.05,
            ))
        })
        .collect();
    let samples = LightSamples::default();
    let together = Lighting::new(&shader, samples, &diagnostics).lights_at(&tracer, &points);
    let alone = each_alone(&scene, &points);
    together
        .into_iter()
        .map(|light| light.x)
        .zip(alone)
        .collect()
}

#[test]
fn many_lights_light_a_receiver_as_each_does_alone() {
    for count in [5, 40, 300] {
        let found = along_a_line(lamps(count), 200);
        let mean = found.iter().map(|(_, alone)| alone).sum::<f32>() / 200.0;
        let off = |(a, b): &(f32, f32)| (a - b) / mean;
        let worst = found.iter().map(|it| off(it).abs()).fold(0.0, f32::max);
        let rms = (found.iter().map(|it| off(it).powi(2)).sum::<f32>() / 200.0).sqrt();
        let steps = found.windows(2).map(|w| (off(&w[1]) - off(&w[0])).powi(2));
        let noise = (steps.sum::<f32>() / 200.0).sqrt();
        assert!(rms < 0.007 && worst < 0.025, "{count}: {rms} {worst}");
        // Groups that followed the receivers would make noise of 1.3 %.
        assert!(noise < 0.005, "{count}: {noise}");
    }
}

#[test]
fn little_light_deep_in_a_shadow_is_as_exact_as_much() {
    let found = under_a_block(0.25, lamps(300), 300);
    let open = found.iter().map(|(_, alone)| *alone).fold(0.0, f32::max);
    let is_deep = |(_, alone): &&(f32, f32)| *alone > 0.004 * open && *alone < 0.2 * open;
    let deep: Vec<_> = found.iter().filter(is_deep).collect();
    let squares = deep.iter().map(|(a, b)| (a / b - 1.0).powi(2));
    #[expect(clippy::cast_precision_loss, reason = "a few places")]
    let rms = (squares.sum::<f32>() / deep.len() as f32).sqrt();
    assert!(deep.len() > 20 && rms < 0.03, "{} {rms}", deep.len());
}

#[test]
fn lights_that_nothing_hides_are_exact_however_many_there_are() {
    let mut lights = lamps(300);
    for light in &mut lights {
        light.world_from_light.translation.x += 20.0;
    }
    for (together, alone) in along_a_line(lights, 50) {
        assert!(
            alone > 0.0 && (together / alone - 1.0).abs() < 1e-5,
            "{together} {alone}"
        );
    }
}

#[test]
fn a_lamp_in_the_shadow_of_a_sun_is_looked_at_as_if_there_were_no_sun() {
    // The sun stands below the floor's horizon for the block: it is hidden under the block alone.
    let lamp = || {
        let kind = LightKind::Sphere {
            radius: 0.4,
            treat_as_point: false,
        };
        light(kind, Affine3A::from_translation(Vec3::new(0.9, 2.0, 0.0)))
    };
    let mut sun = light(
        LightKind::Distant { angle: 0.01 },
        Affine3A::from_rotation_x(-FRAC_PI_2),
    );
    sun.radiance *= 1e7;
    let mut dim: Vec<Light> = lamps(30);
    dim.iter_mut().for_each(|light| light.radiance *= 1e-6);
    let with_sun: Vec<Light> = [sun, lamp()].into_iter().chain(dim.clone()).collect();
    let without: Vec<Light> = std::iter::once(lamp()).chain(dim).collect();
    let (with, without) = (along_a_line(with_sun, 120), along_a_line(without, 120));
    let in_shadow = 52..68;
    // In its penumbra and out of it.
    let open = without.iter().map(|(light, _)| *light).fold(0.0, f32::max);
    let found: Vec<_> = in_shadow.map(|i| (with[i].0, without[i].0)).collect();
    assert!(
        found
            .iter()
            .any(|(_, light)| (0.1..0.5).contains(&(light / open))),
        "{found:?}"
    );
    for (a, b) in found {
        assert!((a - b).abs() < 0.01 * open, "{a} {b} {open}");
    }
}
