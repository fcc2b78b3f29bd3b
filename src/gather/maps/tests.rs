use super::crowd::{Block, LANES, Sums};
use super::*;
use crate::gather::testing::receivers_at;
use crate::scene::Scene;
use crate::trace::testing::{Random, mesh, scene};
use glam::Affine3A;

/// A soup of triangles about as large as their distances, and a flat prim.
fn soup(random: &mut Random) -> Scene {
    let triangles: Vec<[Vec3; 3]> = (0..300)
        .map(|_| {
            let at = random.vector();
            [0; 3].map(|_| at + 0.2 * random.vector())
        })
        .collect();
    let flat = [Vec3::ZERO, Vec3::X, Vec3::Y].map(|v| v - 0.5 * Vec3::Z);
    let turned = Affine3A::from_rotation_y(0.7);
    scene(
        vec![mesh(&triangles), mesh(&[flat])],
        &[(0, Affine3A::IDENTITY), (1, turned), (0, turned)],
    )
}

fn anywhere(random: &mut Random, count: usize) -> Receivers {
    let points: Vec<_> = (0..count)
        .map(|_| (1.2 * random.vector(), random.direction()))
        .collect();
    receivers_at(&points)
}

#[test]
fn sixteen_at_a_time_see_bit_for_bit_what_the_definition_sees_at_any_level() {
    let mut random = Random(7);
    let scene = soup(&mut random);
    let receivers = anywhere(&mut random, 100);
    let plan = MapsPlan::new(&scene);
    assert_eq!(plan.flats.len(), 1);
    let settings = MapsSettings::default();
    let wanted = Wanted {
        bent_normal: true,
        harmonics: true,
        environment: Some(&|d| Vec3::ONE + d),
    };
    let stage = Stage::new(&plan, &settings);
    let views: Vec<View> = axes::axes(8)
        .iter()
        .map(|axis| {
            let mut view = View::default();
            stage.look_along(Level::new(), (&plan, &wanted), axis, &mut view);
            view
        })
        .collect();
    let channels = Channels::of(&wanted);
    let rules = Rules {
        bias: 0.5,
        max_distance: 1.0,
        flat_margin: Rules::flat_margin(plan.radius, plan.radius),
        weighted_channels: channels.weighted,
    };
    let bits = |blocks: &[Block], sums: &[Sums]| -> Vec<u32> {
        assert_eq!(blocks.len(), sums.len());
        let rows = |s: &Sums| -> Vec<f32> {
            let rows = [s.weight, s.open, s.uncertain];
            rows.iter().chain(&s.channels).flatten().copied().collect()
        };
        sums.iter().flat_map(rows).map(f32::to_bits).collect()
    };
    let mut plainly = Crowd::new(&plan, &receivers, channels.count);
    for view in &views {
        for (block, sums) in plainly.blocks.iter().zip(&mut plainly.sums) {
            (0..LANES).for_each(|lane| plain::look(view, &rules, block, lane, sums));
        }
    }
    let expected = bits(&plainly.blocks, &plainly.sums);
    for level in [Level::baseline(), Level::new()] {
        let mut widely = Crowd::new(&plan, &receivers, channels.count);
        wide::look(level, (&views, &rules), &widely.blocks, &mut widely.sums);
        assert_eq!(bits(&widely.blocks, &widely.sums), expected, "{level:?}");
    }
    let open: f32 = plainly.sums.iter().flat_map(|s| s.open).sum();
    let weight: f32 = plainly.sums.iter().flat_map(|s| s.weight).sum();
    assert!(open > 0.1 * weight && open < 0.9 * weight);
}

#[test]
fn an_empty_scene_is_open_everywhere_and_no_receivers_see_nothing() {
    let scene = scene(Vec::new(), &[]);
    let plan = MapsPlan::new(&scene);
    assert_eq!(plan.edge(), 0.0);
    let look = |receivers: &Receivers| {
        let settings = MapsSettings {
            directions: 7,
            ..MapsSettings::default()
        };
        let wanted = Wanted {
            bent_normal: true,
            ..Wanted::default()
        };
        visibility(
            &plan,
            receivers,
            &settings,
            &wanted,
            &Diagnostics::default(),
        )
        .unwrap()
    };
    let seen = look(&receivers_at(&[
        (Vec3::ZERO, Vec3::Y),
        (Vec3::ONE, Vec3::X),
    ]));
    assert_eq!(seen.visibility, [1.0, 1.0]);
    assert_eq!(seen.ambiguous, [false, false]);
    assert!(look(&receivers_at(&[])).visibility.is_empty());
}

#[test]
fn an_open_receiver_gets_the_full_irradiance_harmonics_and_bent_normal() {
    let scene = scene(Vec::new(), &[]);
    let plan = MapsPlan::new(&scene);
    let normal = Vec3::new(0.3, 0.8, -0.2).normalize();
    let receivers = receivers_at(&[(Vec3::ZERO, normal)]);
    let settings = MapsSettings {
        directions: 1024,
        ..MapsSettings::default()
    };
    let wanted = Wanted {
        bent_normal: true,
        harmonics: true,
        environment: Some(&|d| Vec3::new(1.0, 1.0 + d.y, 0.0)),
    };
    let quiet = Diagnostics::default();
    let seen = visibility(&plan, &receivers, &settings, &wanted, &quiet).unwrap();
    // ∫ L cos = π + (2π/3)·n.y for L = 1 + y; mean of ω by cosine = 2/3 n; the 0th coefficient is 2π·Y₀.
    let environment = seen.environment[0];
    assert!((environment.x - PI).abs() < 1e-4 && environment.z == 0.0);
    assert!((environment.y - PI * (1.0 + 2.0 / 3.0 * normal.y)).abs() < 5e-3);
    assert!((seen.open_direction[0] - 2.0 / 3.0 * normal).length() < 2e-3);
    assert!((seen.harmonics[0].0[0] - 2.0 * PI * 0.282_094_8).abs() < 5e-3);
}

#[test]
fn cancelled_runs_end() {
    let scene = scene(Vec::new(), &[]);
    let plan = MapsPlan::new(&scene);
    let diagnostics = Diagnostics::default();
    diagnostics.cancel_token().cancel();
    let receivers = receivers_at(&[(Vec3::ZERO, Vec3::Y)]);
    let settings = MapsSettings::default();
    let result = visibility(
        &plan,
        &receivers,
        &settings,
        &Wanted::default(),
        &diagnostics,
    );
    assert_eq!(result, Err(Cancelled));
}
