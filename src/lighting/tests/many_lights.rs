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
        let exact = lighting.lights(&tracer, &point).x;
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
fn lights_weighed_in_rows_weigh_what_each_does_and_rays_beside_their_balls_meet_nothing() {
    let mut scene = scene(Vec::new(), &[]);
    scene.lights = lamps(37);
    let diagnostics = Diagnostics::default();
    let lights: Vec<AreaLight> = (scene.lights.iter())
        .filter_map(|light| AreaLight::new(light, &diagnostics))
        .collect();
    let beacons = Beacons::new(lights.iter().map(AreaLight::beacon));
    let point = up_at(Vec3::new(0.3, 1.9, -0.2));
    let mut weights = [0.0; 37];
    beacons.weigh(&point, &mut weights);
    let mut all = Vec2::ZERO;
    for (index, weight) in weights.into_iter().enumerate() {
        assert_eq!(weight, beacons.at(index, &point));
        let light = &lights[index];
        let patterns = Patterns::new(16);
        let open = light.open(&patterns, &point).element_sum();
        // Toward its middle, its rim, and past it.
        let ball = light.beacon().expect("near");
        let way = (ball.center - point.position).normalize();
        assert!(weight >= 0.2 * open, "{weight} {open}");
        all += Vec2::new(weight, open);
        let side = way.any_orthonormal_vector();
        for (off, is_met) in [(0.0, true), (0.048, true), (0.052, false), (0.3, false)] {
            let direction = (ball.center + off * side - point.position).normalize();
            assert_eq!(
                light.seen(point.position, direction).is_some(),
                is_met,
                "{off}"
            );
        }
    }
    // A ball shows a quarter of its area, and low ones are taken for higher than they are.
    assert!(all.y > 0.0 && all.x < 8.0 * all.y, "{all}");
}
