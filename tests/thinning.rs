//! Few rays where a pixel has many receivers, against a closed form.

#[allow(dead_code, reason = "shared with other tests, which use the rest")]
#[path = "support/scenes.rs"]
mod scenes;

use glam::Vec3;
use scenes::{floor_under_a_roof, polygon_irradiance, receivers_in};
use std::cell::Cell;
use std::f32::consts::PI;
use surflux::diagnostics::Diagnostics;
use surflux::gather::{
    Engine, GatherScene, RaysEngine, RaysSettings, ThinEngines, Thinning, gather,
};
use surflux::interpolate::{self, Gathering, InterpolateSettings};
use surflux::receivers::Receivers;
use surflux::results::{Aov, PixelShare, Results, Target};
use surflux::shading::Shader;
use surflux::trace::Tracer;

/// Rays of a receiver that has a pixel of its own.
const RAYS: RaysSettings = RaysSettings {
    rays: 256,
    max_distance: None,
    turn: 0.0,
    cone: None,
};

/// Put `receivers` into pixels, four that are far from each other in each.
fn put_into_pixels(receivers: &mut Receivers) {
    let pixels = receivers.len() / 4;
    let share = |i: usize| PixelShare {
        pixel: u32::try_from(i / 4).expect("few"),
        receiver: u32::try_from(i / 4 + i % 4 * pixels).expect("few"),
        weight: 0.25,
    };
    receivers.target = Target::Image {
        width: u32::try_from(pixels).expect("few"),
        height: 1,
        shares: (0..4 * pixels).map(share).collect(),
    };
}

/// What pixels show of `all`.
fn in_pixels(all: &[f32]) -> Vec<f32> {
    let pixels = all.len() / 4;
    let mean = |i| (0..4).map(|k| 0.25 * all[i + k * pixels]).sum();
    (0..pixels).map(mean).collect()
}

fn relative_rmse(found: &[f32], truth: &[f32]) -> f64 {
    let off = |(&a, &b): (&f32, &f32)| f64::from(a - b).powi(2);
    let square: f64 = found.iter().zip(truth).map(off).sum();
    let mean = truth.iter().map(|&x| f64::from(x)).sum::<f64>() / truth.len() as f64;
    (square / truth.len() as f64).sqrt() / mean
}

/// Receivers of which none may speak for another, four in each pixel: with half of the rays each, pixels are off by no more than
/// one receiver with all rays. Where that is refused these look once more, in other directions, and in the end all rays see for
/// everyone.
#[test]
fn a_pixel_of_many_receivers_takes_few_rays_of_each() {
    let (scene, floor, corners) = floor_under_a_roof(96);
    let (tracer, diagnostics) = (Tracer::new(&scene), Diagnostics::default());
    let mut receivers = receivers_in(&scene, floor, 1);
    put_into_pixels(&mut receivers);
    let thinning = Thinning::of(&receivers.target, receivers.len(), RaysSettings::LAW);
    let thinning = thinning.expect("it pays");
    assert!(thinning.cost() < 0.51, "{}", thinning.cost());
    let engine = |settings| RaysEngine::new(&tracer, None, settings);
    let thin = |class, glance| Box::new(engine(RAYS.thinned(class, glance))) as Box<dyn Engine>;
    let (shader, all) = (Shader::new(&scene, &diagnostics), engine(RAYS));
    let gathering = Gathering {
        scene: GatherScene {
            shader: &shader,
            tracer: &tracer,
            lighting: None,
        },
        engine: &all,
        again: None,
        fewer: None,
        thin: Some(&ThinEngines::new(thinning, &thin)),
        receivers: &receivers,
        kinds: Some(&vec![None; receivers.len()]),
        aovs: &[Aov::Visibility],
    };
    let settings = InterpolateSettings {
        tolerance: 0.02,
        refusals: 0,
    };
    let open = |results: &Results| results.get(Aov::Visibility).expect("asked").data.clone();
    let seen = |refused: u32| {
        let offers = Cell::new(0);
        let accepts = |_: &Results| offers.replace(offers.get() + 1) >= refused;
        let found = interpolate::gather(gathering, settings, &accepts, &diagnostics);
        let found = found.expect("not cancelled");
        assert!(found.gathered >= receivers.len() && found.is_refused == (refused > 9));
        open(&found.results)
    };
    let (few, twice, all_rays) = (seen(0), seen(1), seen(10));
    let whole = gather(
        gathering.scene,
        &all,
        &receivers,
        gathering.aovs,
        &diagnostics,
    );
    assert!(all_rays == open(&whole.expect("not cancelled")));
    #[expect(clippy::cast_possible_truncation, reason = "compared with f32")]
    let truth = |&place: &Vec3| 1.0 - polygon_irradiance(place, Vec3::Y, &corners) as f32 / PI;
    let truth: Vec<f32> = receivers.position.iter().map(truth).collect();
    let alone = relative_rmse(&all_rays, &truth);
    let together = relative_rmse(&in_pixels(&few), &in_pixels(&truth));
    let again = relative_rmse(&in_pixels(&twice), &in_pixels(&truth));
    assert!(again < 0.85 * together, "{again} {together}");
    let each = relative_rmse(&few, &truth);
    assert!(
        together < 1.1 * alone && each > 1.4 * alone,
        "{together} {each} {alone}"
    );
}
