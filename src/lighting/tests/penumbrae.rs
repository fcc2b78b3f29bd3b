//! Penumbrae of straight edges: where they begin and end, and how even they are.

use super::*;

/// Where nothing stands in the way.
const FAR: Vec3 = Vec3::splat(1e3);

/// Unit, along an edge at `angle` and at right angles to it.
fn axes(angle: f32) -> (Vec3, Vec3) {
    let (sine, cosine) = angle.sin_cos();
    (Vec3::new(cosine, 0.0, sine), Vec3::new(-sine, 0.0, cosine))
}

/// On a line across the edge.
fn places(angle: f32) -> Vec<ShadePoint> {
    let (_, across) = axes(angle);
    (0..160_u16)
        .map(|i| up_at((f32::from(i) / 40.0 - 2.0) * across))
        .collect()
}

/// Light at [`places`] behind a half-plane at half of its height.
fn across(light: &Light, angle: f32, samples: LightSamples) -> Vec<f32> {
    let (along, across) = axes(angle);
    let at = |x: f32, y: f32| 50.0 * (x * along + y * across) + 2.0 * Vec3::Y;
    let block = quad(at(-1.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(-1.0, 1.0));
    let light = lit_by(light.clone(), &block, samples, &places(angle));
    light.into_iter().map(|light| light.x).collect()
}

#[test]
fn penumbrae_begin_softly_whatever_way_an_edge_runs_and_few_rays_find_them() {
    let kinds = [
        LightKind::Rect {
            width: 2.0,
            height: 1.0,
            texture: None,
        },
        LightKind::Disk { radius: 0.8 },
        LightKind::Sphere {
            radius: 0.8,
            treat_as_point: false,
        },
        LightKind::Cylinder {
            radius: 0.4,
            length: 2.0,
        },
    ];
    for kind in kinds {
        let light = light(kind.clone(), above(4.0));
        for angle in [0.0, 0.3, FRAC_PI_2 / 2.0, 1.2] {
            let with = |per_light| {
                let usual = LightSamples::default();
                across(&light, angle, LightSamples { per_light, ..usual })
            };
            let truth = with(4096);
            let open = truth.iter().copied().fold(0.0, f32::max);
            let is_dark = truth.contains(&0.0);
            let is_soft = truth
                .iter()
                .any(|light| (0.01..0.05).contains(&(light / open)));
            assert!(is_dark && is_soft, "the whole penumbra is looked at");
            let free = lit_by(
                light.clone(),
                &quad(FAR, FAR, FAR, FAR),
                LightSamples::default(),
                &places(angle),
            );
            for (rays, most, most_at_ends) in [(64, 0.065, 0.03), (256, 0.03, 0.012)] {
                let (mut worst, mut worst_at_ends) = (0.0_f32, 0.0_f32);
                for ((found, truth), free) in with(rays).into_iter().zip(&truth).zip(&free) {
                    let off = (found - truth).abs() / open;
                    worst = worst.max(off);
                    if found == 0.0 || found == free.x {
                        worst_at_ends = worst_at_ends.max(off);
                    }
                }
                assert!(worst < most, "{kind:?} {angle} {rays}: {worst}");
                assert!(
                    worst_at_ends < most_at_ends,
                    "{kind:?} {angle} {rays}: {worst_at_ends}"
                );
            }
        }
    }
}
